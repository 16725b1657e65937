"""The logger for work that takes long, and reports of its progress.

The logger is silent unless the program that uses the library configures logging.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

log = logging.getLogger("loewner")
log.addHandler(logging.NullHandler())

# Work on meshes with fewer triangles, and calls that fit fewer pieces, are not logged.
MANY_TRIANGLES, MANY_PIECES = 100_000, 100


@contextmanager
def logged(work: str, *values: Any, least: int = 0) -> Iterator[None]:
    """Log the beginning of work, and its end with the time taken, if the last of `values` is at least `least`."""
    if values[-1] < least:
        yield
        return
    log.info(f"{work} ...", *values)
    began = time.perf_counter()
    yield
    log.info(f"{work}: %.3g s", *values, time.perf_counter() - began)


class Percentage:
    """A percentage of work that is reported to a callback and never decreases."""

    def __init__(self, progress: Callable[[int, int], None]) -> None:
        self._progress, self._told = progress, 0

    def report(self, share: float = 0.0) -> None:
        """Report a share of the work, at most 99 %, or the last report again, so that the callback may interrupt."""
        self._told = max(self._told, min(99, int(100 * share)))
        self._progress(self._told, 100)

    def done(self) -> None:
        """Report that the work is done."""
        self._told = 100
        self.report()
