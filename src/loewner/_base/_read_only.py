"""Objects whose arrays stay read-only in copies and pickles."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray


class KeepsReadOnly:
    """A class whose attributes may be read-only arrays, or tuples of them; they are checked once and then trusted.

    NumPy makes arrays writeable when it copies or unpickles them. In this class, the state of an object lists its
    read-only arrays. When `copy` or `pickle` makes a new object from the state, these arrays become read-only again.
    """

    def __getstate__(self) -> tuple[dict[str, Any], list[int]]:
        held = dict(vars(self))
        return held, [k for k, array in enumerate(_arrays(held)) if not array.flags.writeable]

    def __setstate__(self, state: tuple[dict[str, Any], list[int]]) -> None:
        held, protected = state
        arrays = list(_arrays(held))
        read_only(*(arrays[k] for k in protected))
        vars(self).update(held)


def read_only(*arrays: NDArray[Any]) -> None:
    """Protect arrays from changes."""
    for array in arrays:
        array.setflags(write=False)


Kept = TypeVar("Kept", bound=KeepsReadOnly)


def protected(thing: Kept) -> Kept:
    """Make all arrays of an object read-only, and return the same object."""
    read_only(*_arrays(vars(thing)))
    return thing


def _arrays(held: dict[str, Any]) -> Iterator[NDArray[Any]]:
    """List the arrays among the attributes of an object and in their tuples, always in the same order."""
    for value in held.values():
        yield from (one for one in (value if isinstance(value, tuple) else (value,)) if isinstance(one, np.ndarray))
