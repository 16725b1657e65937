"""Queries of one pair, each as one call of the extension: what is usual, without Python between (`native/singles.c`).

Each of these answers, or returns None: the arguments are not of the usual kind, or the answer takes more than that. The
caller then goes the long way, which checks and says everything. Without a library they always return None.
"""

from typing import Any

from loewner._native import entries, library

NAMES = ("collide", "classify", "distance")


def __getattr__(name: str) -> Any:
    """Look a query up at its first use, as `entries` does with kernels."""
    if name not in NAMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    call = library.call_module()
    if call is None:
        made = dict.fromkeys(NAMES, _none)
    else:
        pairs = call.Pairs(
            entries.settle_range, entries.distance_range, entries.measure_left, entries.first_fault,
            entries.workspace_size(),
        )  # fmt: skip
        made = {query: getattr(pairs, query) for query in NAMES}
    globals().update(made)
    return made[name]


def _none(*_: Any) -> None:
    """Whatever is asked: the long way."""
