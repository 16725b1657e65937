"""What a batch holds in memory while it runs, and what a body holds."""

from __future__ import annotations

import tracemalloc
from collections.abc import Callable
from dataclasses import dataclass
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
        held("classify", p, lambda: loewner.classify(*p.arguments())),
        held("collide", p, lambda: loewner.collide(*p.arguments())),
        held("distance", part, lambda: loewner.distance(*part.arguments())),
        held("distance, exact", part, lambda: loewner.distance(*part.arguments(), exact=True)),
    ]


def held(query: str, p: Pairs, call: Callable[[], Any]) -> Held:
    call()  # compiles, and fills what is kept between calls
    resident = None
    if _reset_peak():
        before = _status("VmRSS")
        call()
        resident = (_status("VmHWM") - before) / len(p)
    tracemalloc.start()
    try:
        call()
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    return Held(query, len(p), peak / len(p), resident)


def _reset_peak() -> bool:
    """Make Linux forget the peak so far."""
    try:
        Path("/proc/self/clear_refs").write_text("5")
    except OSError:
        return False
    return True


def _status(field: str) -> int:
    """A line of /proc/self/status, in bytes."""
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith(field):
            return int(line.split()[1]) * 1024
    raise OSError(f"no {field} in /proc/self/status")
