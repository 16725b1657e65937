"""Queries that are one call of the extension: what is usual, without Python between (`native/pairs.c`).

Each of these answers, or returns None: an argument is not of the usual kind, or the answer takes more than that. The
caller then goes the long way, which checks and says everything. Without a library they always return None.
"""

from typing import Any

from numpy.typing import NDArray

from loewner._native import entries, library

# Of one pair of bodies: names of this module.
PAIRS = ("collide", "classify", "distance")


def __getattr__(name: str) -> Any:
    """Look a query up at its first use, as `entries` does with kernels."""
    if name not in PAIRS:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    call = library.extension()
    if call is None:
        made = dict.fromkeys(PAIRS, none)
    else:
        pairs = call.Pairs(
            entries.settle_range, entries.distance_range, entries.measure_left, entries.first_fault,
            entries.workspace_size(), entries.memory_of_distances(),
        )  # fmt: skip
        made = {query: getattr(pairs, query) for query in PAIRS}
    globals().update(made)
    return made[name]


def none(*_: Any) -> None:
    """Whatever is asked: the long way."""


class LongWay:
    """Stands for queries of configurations where there are none."""

    collide = classify = motion = staticmethod(none)


def configurations(
    pack: int, problem: int, memory: int, piece_pairs: int, plain: Any, hits: NDArray[Any], held: Any
) -> Any:
    """Queries of one configuration of a robot, and of one motion (`native/configurations.c`).

    Parameters
    ----------
    pack, problem, hits
        What `check_configurations` takes.
    memory : int
        Bytes that it writes to.
    piece_pairs : int
        How many pairs of pieces there are to check; if many, other threads run meanwhile.
    plain : ndarray, shape (2, dof), or None
        Least and largest values of usual configurations; None if none is usual.
    held : object
        What owns the memory behind the handles.

    Returns
    -------
    object
        With ``collide(q)``: a bool, or None. ``classify(q)``: the number of a verdict, or None. ``motion(q0, q1,
        resolution, order)``: how many configurations were looked at, less than 0 if the last ones collide, or None;
        order(steps) returns the fractions of the way in the order in which they are looked at.
    """
    call = library.extension()
    if call is None or plain is None:
        return LongWay()
    return call.Configurations(
        entries.check_configurations, entries.check_motion, pack, problem, memory, piece_pairs, plain, hits, held
    )
