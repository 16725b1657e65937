"""Answer usual queries, each by a single call of the extension, without Python in between (`native/pairs.c`).

A query returns an answer, or None if an argument is unusual or the answer takes more work. If the query returns None,
the caller takes the long way in Python, which checks and reports everything. Without a library, every query returns
None.
"""

from typing import Any

from numpy.typing import NDArray

from loewner._native import entries, library

# The queries about one pair of bodies, by their names in this module.
PAIRS = ("collide", "classify", "distance")

# Kernels that these queries need, in the order of the extension's arguments. The last two kernels are called first, and
# the extension takes their results.
NEEDED = (
    "settle_range", "distance_range", "measure_left", "first_fault", "workspace_size", "memory_of_distances",
)  # fmt: skip


def __getattr__(name: str) -> Any:
    """Look up a query at its first use, as `entries` does for kernels."""
    if name not in PAIRS:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    call = library.extension()
    if call is None:
        queries = dict.fromkeys(PAIRS, none)
    elif any(library.is_missing(entries.ENTRIES[kernel]) for kernel in NEEDED):
        return none  # the library is still being built, and other calls need fewer of its kernels
    else:
        *kernels, workspace, distances = (getattr(entries, kernel) for kernel in NEEDED)
        pairs = call.Pairs(*kernels, workspace(), distances())
        queries = {query: getattr(pairs, query) for query in PAIRS}
    globals().update(queries)
    return queries[name]


def none(*_: Any) -> None:
    """Return None, so that the caller takes the long way."""


class LongWay:
    """Replacement for the queries of configurations if there is no library."""

    collide = classify = motion = staticmethod(none)


def configurations(
    pack: int, problem: int, memory: int, piece_pairs: int, plain: Any, hits: NDArray[Any], held: Any
) -> Any:
    """Make the queries about one configuration of a robot, and about one motion (`native/configurations.c`).

    Parameters
    ----------
    pack, problem, hits
        As for `check_configurations`.
    memory : int
        Number of scratch bytes that a query needs.
    piece_pairs : int
        Number of pairs of pieces to check; if there are many, the interpreter lock is released.
    plain : ndarray, shape (2, dof), or None
        Smallest and largest values of usual configurations; None if no configuration is usual.
    held : object
        Owner of the memory behind the handles.

    Returns
    -------
    object
        An object with three methods, each of which may return None instead of an answer. ``collide(q)`` returns a bool,
        and ``classify(q)`` the number of a verdict. ``motion(q0, q1, resolution, order)`` returns the number of
        configurations checked, negative if the last ones collide. order(steps) returns the fractions of the motion in
        the order in which they are checked.
    """
    call = library.extension()
    if call is None or plain is None:
        return LongWay()
    return call.Configurations(
        entries.check_configurations, entries.check_motion, pack, problem, memory, piece_pairs, plain, hits, held
    )
