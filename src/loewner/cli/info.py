"""``loewner info``: print the version, the way in which kernels run, and the installed optional packages."""

from __future__ import annotations

import argparse
import os
import platform
from collections.abc import Callable
from importlib.metadata import PackageNotFoundError, version
from typing import Any

import loewner
from loewner._base._threads import get_num_threads
from loewner._kernels._sources import cache_folder
from loewner._native import entries, library
from loewner.errors import LoewnerError

# Packages that each extra installs.
EXTRAS = {
    "jit": ("numba",),
    "cli": ("rich",),
    "meshes": ("trimesh", "coacd"),
    "robots": ("pyyaml",),
    "planners": ("ompl",),
    "plots": ("matplotlib",),
    "viewer": ("viser",),
    "screenshots": ("playwright",),
    "mujoco": ("mujoco",),
    "jax": ("jax",),
    "torch": ("torch",),
    "cluster": ("dask", "distributed"),
}

MISSING = "not installed"


def add(commands: Any) -> None:
    """Add the command."""
    told = commands.add_parser("info", help="versions, how the kernels run, threads, optional packages")
    told.set_defaults(run=_run)


def _run(options: argparse.Namespace) -> int:
    lines = [
        ("loewner", loewner.__version__),
        ("kernels", _told(_kernels)),
        ("processor", f"{platform.machine()}, levels of the library: {', '.join(library.levels()) or 'not known'}"),
        ("threads", _told(lambda: str(get_num_threads()))),
        ("python", f"{platform.python_version()}, numpy {installed('numpy')}, scipy {installed('scipy')}"),
        ("cache", str(cache_folder())),
        *((name, value) for name, value in sorted(os.environ.items()) if name.startswith("LOEWNER_")),
        *((f"[{extra}]", ", ".join(f"{name} {installed(name)}" for name in names)) for extra, names in EXTRAS.items()),
    ]
    width = max(len(name) for name, _ in lines) + 3
    for name, text in lines:
        print(f"{name + ':':<{width}}{text}")
    return 0


def _told(what: Callable[[], str]) -> str:
    """Return a text, or the error in a setting on which the text depends."""
    try:
        return what()
    except LoewnerError as error:
        return f"error: {error}"


def _kernels() -> str:
    """Describe how the kernels run."""
    if (level := library.level()) is not None:
        without = f", without {len(missing)} kernels" if (missing := entries.missing()) else ""
        return f"native library, {level}, built with Numba {library.built_with()}{without}"
    if installed("numba") == MISSING:
        return f"none: no library ({library.why_not()}), and no Numba; pip install 'loewner[jit]'"
    return f"compiled by Numba on this machine; no native library ({library.why_not()})"


def installed(package: str) -> str:
    """Return the version of a package, or `MISSING`."""
    try:
        return version(package)
    except PackageNotFoundError:
        return MISSING
