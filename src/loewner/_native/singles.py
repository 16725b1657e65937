"""Queries that are a single call of the extension: the usual cases, without Python in between (`native/pairs.c`).

Each of these returns an answer, or None if an argument is unusual or the answer takes more work. The caller then takes
the long way, which checks and reports everything. Without a library they always return None.
"""

from typing import Any

from numpy.typing import NDArray

from loewner._native import entries, library

# Queries of one pair of bodies: names of this module.
PAIRS = ("collide", "classify", "distance")

# Kernels behind them, as the extension takes them; of the last two it takes the results.
NEEDED = (
    "settle_range", "distance_range", "measure_left", "first_fault", "workspace_size", "memory_of_distances",
)  # fmt: skip


def __getattr__(name: str) -> Any:
    """Look a query up at its first use, as `entries` does with kernels."""
    if name not in PAIRS:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    call = library.extension()
    if call is None:
        made = dict.fromkeys(PAIRS, none)
    elif any(library.is_missing(entries.ENTRIES[kernel]) for kernel in NEEDED):
        return none  # the library is being built, and other calls need less of it
    else:
        *kernels, workspace, distances = (getattr(entries, kernel) for kernel in NEEDED)
        pairs = call.Pairs(*kernels, workspace(), distances())
        made = {query: getattr(pairs, query) for query in PAIRS}
    globals().update(made)
    return made[name]


def none(*_: Any) -> None:
    """Return None: the caller takes the long way."""


class LongWay:
    """Replacement for queries of configurations if there are none."""

    collide = classify = motion = staticmethod(none)


def configurations(
    pack: int, problem: int, memory: int, piece_pairs: int, plain: Any, hits: NDArray[Any], held: Any
) -> Any:
    """Queries of one configuration of a robot, and of one motion (`native/configurations.c`).

    Parameters
    ----------
    pack, problem, hits
        As for `check_configurations`.
    memory : int
        Number of scratch bytes that it needs.
    piece_pairs : int
        Number of pairs of pieces to check; if there are many, the interpreter lock is released.
    plain : ndarray, shape (2, dof), or None
        Smallest and largest values of usual configurations; None if none is usual.
    held : object
        Owner of the memory behind the handles.

    Returns
    -------
    object
        With ``collide(q)``: a bool, or None. ``classify(q)``: the number of a verdict, or None. ``motion(q0, q1,
        resolution, order)``: the number of configurations checked, negative if the last ones collide, or None;
        order(steps) returns the fractions of the motion in the order in which they are checked.
    """
    call = library.extension()
    if call is None or plain is None:
        return LongWay()
    return call.Configurations(
        entries.check_configurations, entries.check_motion, pack, problem, memory, piece_pairs, plain, hits, held
    )
