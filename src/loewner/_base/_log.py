"""The logger of work that takes long; silent unless the program that uses the library configures logging."""

from __future__ import annotations

import logging
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

log = logging.getLogger("loewner")
log.addHandler(logging.NullHandler())

# Meshes with fewer triangles, and fits of fewer pieces at once, are not logged.
MANY_TRIANGLES, MANY_PIECES = 100_000, 100


@contextmanager
def logged(work: str, *values: Any, least: int = 0) -> Iterator[None]:
    """Log the beginning of some work, and its end with the time that it took, if its last value is `least` or more."""
    if values[-1] < least:
        yield
        return
    log.info(f"{work} ...", *values)
    began = time.perf_counter()
    yield
    log.info(f"{work}: %.3g s", *values, time.perf_counter() - began)
