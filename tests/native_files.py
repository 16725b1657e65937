"""Files of `native/`, which is no package, as modules."""

import importlib.util
from pathlib import Path
from types import ModuleType

NATIVE = Path(__file__).parent.parent / "native"


def module(name: str) -> ModuleType:
    """A file of `native/` as a module."""
    spec = importlib.util.spec_from_file_location(f"native_{name}", NATIVE / f"{name}.py")
    loaded = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(loaded)
    return loaded
