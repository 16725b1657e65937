"""What a batch holds in memory while it runs, and what a body holds."""

from __future__ import annotations

import ctypes
import gc
import tracemalloc
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import loewner
from samples import Pairs, repeated_pairs

COUNT, QUICK = 1_000_000, 20_000


@dataclass(frozen=True)
class Held:
    """Bytes per pair.

    Attributes
    ----------
    traced : float
        Peak of what Python and NumPy allocated during the call, results included, by tracemalloc.
    resident : float or None
        Growth of the process's peak resident memory during the call (Linux): sees kernels too, in pages.
    """

    query: str
    pairs: int
    traced: float
    resident: float | None


def run(quick: bool, folder: Path) -> list[Held]:
    p = repeated_pairs(QUICK if quick else COUNT)
    part = p.part(slice(0, len(p) // 10))
    return [
        held("classify", loewner.classify, p),
        held("collide", loewner.collide, p),
        held("distance", loewner.distance, part),
        held("distance, exact", partial(loewner.distance, exact=True), part),
    ]


def held(name: str, query: Callable[..., Any], p: Pairs) -> Held:
    query(*p.part(slice(0, 100)).arguments())  # compiles, and fills what is kept between calls
    operands = p.arguments()
    resident = None
    if _forget_peak():
        before = _status("VmRSS")
        query(*operands)
        resident = (_status("VmHWM") - before) / len(p)
    tracemalloc.start()
    try:
        query(*operands)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    return Held(name, len(p), peak / len(p), resident)


def _forget_peak() -> bool:
    """Hand unused memory back to Linux, or the call would fill it unseen, and make it forget the peak so far."""
    try:
        gc.collect()
        ctypes.CDLL("libc.so.6").malloc_trim(0)
        Path("/proc/self/clear_refs").write_text("5")
    except (OSError, AttributeError):
        return False
    return True


def _status(field: str) -> int:
    """A line of /proc/self/status, in bytes."""
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith(field):
            return int(line.split()[1]) * 1024
    raise OSError(f"no {field} in /proc/self/status")
