"""``loewner compile``: compile all kernels now instead of on their first use."""

from __future__ import annotations

import argparse
import sys
from typing import Any

from loewner._native import entries, library
from loewner.cli.compilation import PARTS, compile_kernels
from loewner.cli.output import progress_of


def add(commands: Any) -> None:
    """Add the command."""
    compiling = commands.add_parser("compile", help="compile all kernels now, on all cores, instead of at first use")
    compiling.add_argument("--only", nargs="+", choices=PARTS, default=PARTS, help="parts to compile (default: all)")
    compiling.set_defaults(run=_run)


def _run(options: argparse.Namespace) -> int:
    if (level := library.level()) is not None:
        text = f"the native library is in use ({level})"
        if not (missing := entries.missing()):
            print(f"nothing to compile: {text}")
        elif library.is_being_built():
            print(f"{text}, and {len(missing)} of its {len(entries.ENTRIES)} kernels are still being built")
        else:
            print(f"{text} without {len(missing)} of its {len(entries.ENTRIES)} kernels; run native/build.py again")
        return 0
    if sys.stderr.isatty():
        with progress_of("compiling") as progress:
            folder = compile_kernels(options.only, progress=progress)
    else:  # print a log if no bar is shown
        _log(f"compiling {', '.join(options.only)}; takes a few minutes")
        folder = compile_kernels(options.only, progress=lambda done, total: _log(f"{done} of {total} parts compiled"))
    print(f"compiled into {folder}")
    return 0


def _log(text: str) -> None:
    """Print a line immediately to standard error, so that standard output contains only the answer."""
    print(f"loewner: {text}", file=sys.stderr, flush=True)
