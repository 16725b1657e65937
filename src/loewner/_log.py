"""The logger of work that takes long; silent unless the program that uses the library configures logging."""

from __future__ import annotations

import logging
import time
from collections.abc import Iterator
from contextlib import contextmanager

log = logging.getLogger("loewner")
log.addHandler(logging.NullHandler())


@contextmanager
def logged(work: str, *values: object) -> Iterator[None]:
    """Log the beginning of some work, and its end with the time that it took; `values` are formatted into `work`."""
    log.info(f"{work} ...", *values)
    began = time.perf_counter()
    yield
    log.info(f"{work}: %.3g s", *values, time.perf_counter() - began)
