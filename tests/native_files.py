"""Files of `native/`, which is no package, as modules; and the mark of tests that need the native library."""

import importlib.util
import os
from pathlib import Path
from types import ModuleType

import pytest

from loewner._native import library

NATIVE = Path(__file__).parent.parent / "native"

OFFERED = library.level() is not None or os.environ.get("LOEWNER_NATIVE") == "required"
needs_library = pytest.mark.skipif(not OFFERED, reason=f"no native library here: {library.why_not()}")


def module(name: str) -> ModuleType:
    """A file of `native/` as a module."""
    spec = importlib.util.spec_from_file_location(f"native_{name}", NATIVE / f"{name}.py")
    loaded = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(loaded)
    return loaded
