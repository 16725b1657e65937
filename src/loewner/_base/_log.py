"""The logger for work that takes long; it is silent unless the program that uses the library configures logging."""

from __future__ import annotations

import logging
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

log = logging.getLogger("loewner")
log.addHandler(logging.NullHandler())

# Work on meshes with fewer triangles, and fits of fewer pieces at once, are not logged.
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
