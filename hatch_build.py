"""Hatchling's build hook: a wheel gets the native library, for all levels of this architecture's processors.

The kernels' sources, which only Numba reads, go into an archive: see `loewner._kernels._sources`.

``LOEWNER_BUILD=pure`` makes a wheel without it, for any platform: there Numba compiles the kernels (`loewner[jit]`).
An editable installation builds nothing: `python native/build.py` does, for this machine.
"""

import os
import runpy
import subprocess
import sys
import tempfile
import zipfile
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

ROOT = Path(__file__).parent
KERNELS = ROOT / "src" / "loewner" / "_kernels"
ARCHIVE, LOOSE = (runpy.run_path(str(KERNELS / "_sources.py"))[name] for name in ("ARCHIVE", "LOOSE"))
NEEDED = ("numpy", "numba", "llvmlite")
HELP = """
Install what is missing and build again; or set LOEWNER_BUILD=pure for a wheel without the library, which needs Numba
where it is used: pip install 'loewner[jit]'."""


class NativeLibraryHook(BuildHookInterface):
    """Builds the library in a folder of its own, so that what lies in a clone is neither taken nor replaced."""

    def dependencies(self) -> list[str]:
        """Return what building needs, in the versions that everything is tested with."""
        lines = (ROOT / "requirements" / "core.txt").read_text(encoding="utf-8").split()
        return [] if _pure() else [line for line in lines if line.split("==")[0] in NEEDED]

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Build the library and add it to the wheel."""
        if version == "editable":
            return
        included, kernels = build_data["force_include"], sorted(KERNELS.rglob("*.py"))
        names = {path: path.relative_to(KERNELS).as_posix() for path in kernels}
        loose = kernels if _pure() else [path for path in kernels if names[path] in LOOSE]
        included.update({str(path): f"loewner/_kernels/{names[path]}" for path in loose})
        if _pure():
            return
        self._folder = tempfile.TemporaryDirectory(prefix="loewner-")
        home = Path(self._folder.name)
        _build(str(home))
        included.update({str(path): f"loewner/_native/{path.name}" for path in sorted(home.iterdir())})
        with zipfile.ZipFile(home / ARCHIVE, "w", zipfile.ZIP_DEFLATED) as archive:
            for path in kernels:
                if path not in loose:
                    archive.writestr(zipfile.ZipInfo(names[path]), path.read_bytes(), zipfile.ZIP_DEFLATED)
        included[str(home / ARCHIVE)] = f"loewner/_kernels/{ARCHIVE}"
        # One wheel for all Pythons from 3.11 on: the extension needs their limited API alone.
        platform = self.build_config.builder.get_best_matching_tag().rpartition("-")[2]
        build_data.update(pure_python=False, tag=f"cp311-abi3-{platform}")

    def finalize(self, version: str, build_data: dict[str, Any], artifact_path: str) -> None:
        """Remove the folder."""
        if hasattr(self, "_folder"):
            self._folder.cleanup()


def _pure() -> bool:
    """Tell whether the library is left out."""
    asked = os.environ.get("LOEWNER_BUILD", "native")
    if asked not in ("native", "pure"):
        raise SystemExit(f"LOEWNER_BUILD: expected native or pure, found {asked!r}")
    return asked == "pure"


def _build(folder: str) -> None:
    """Build the library, or end with one message that says what is missing."""
    if missing := [name for name in NEEDED if not _installed(name)]:
        raise SystemExit(f"expected {', '.join(NEEDED)} to build with, found no {', '.join(missing)}{HELP}")
    command = [sys.executable, str(ROOT / "native" / "build.py"), "--levels", "all", "--gpu", "--to", folder]
    if subprocess.run(command, check=False).returncode:
        raise SystemExit(f"the native library cannot be built, as said above.{HELP}")


def _installed(name: str) -> bool:
    try:
        return bool(version(name))
    except PackageNotFoundError:
        return False
