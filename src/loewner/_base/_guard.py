"""Handle interrupts and exhausted memory, which can occur in any call regardless of its arguments.

The handler of a signal may raise an exception (`KeyboardInterrupt` on Ctrl+C) while Numba converts a kernel's arrays to
Python objects. Numba continues with the next array, and Python raises two nested SystemErrors, the inner one caused by
the KeyboardInterrupt. A caller's ``except Exception`` would swallow the interrupt. If memory runs out in NumPy, in a
kernel or in Qhull, a raw MemoryError results. Guarded calls raise the interrupt itself, or `MemoryLimitError`.
"""

from __future__ import annotations

import inspect
from functools import wraps
from typing import Any, TypeVar, cast

from loewner._base import _memory
from loewner.errors import LoewnerError, MemoryLimitError

T = TypeVar("T")

# NumPy's message if an interrupt occurs while Numba determines the type of arrays, in which case the interrupt is lost.
LOST_INTERRUPT = "subtype is NULL in PyArray_NewFromDescr"

# Exceptions that `meant` inspects; a clause "except GUARDED" costs nothing unless one of them is raised.
GUARDED = (SystemError, MemoryError)


def meant(error: BaseException) -> BaseException:
    """Return the exception behind an error of a class in GUARDED, or the error itself if nothing caused it."""
    cause: BaseException | None = error
    while isinstance(cause, SystemError):
        cause = cause.__cause__
    if cause is None:
        return error
    if isinstance(cause, ValueError) and str(cause) == LOST_INTERRUPT:
        return KeyboardInterrupt()
    if isinstance(cause, MemoryError) and not isinstance(cause, LoewnerError):
        there, which = _memory.left()
        return MemoryLimitError(
            f"expected enough memory for this call, found too little: {str(cause) or 'an allocation failed'} "
            f"({there / 2**30:.3g} GiB{which}); ask for less at a time"
        )
    return cause


def guarded(thing: T) -> T:
    """Guard a function, or the constructor and all public methods that a class defines itself.

    The guard adds a tenth of a microsecond to a call. Properties, and the fast path of queries about single
    configurations, are guarded individually where this is worthwhile.
    """
    if not isinstance(thing, type):
        return cast(T, _guarded(thing))
    for name, member in list(vars(thing).items()):
        if name.startswith("_") and name not in ("__init__", "__getitem__"):
            continue
        if isinstance(member, (classmethod, staticmethod)):
            setattr(thing, name, type(member)(_guarded(member.__func__)))
        elif inspect.isfunction(member) and not inspect.isgeneratorfunction(member):
            setattr(thing, name, _guarded(member))
    return thing


def _guarded(function: Any) -> Any:
    @wraps(function)
    def call(*args: Any, **kwargs: Any) -> Any:
        try:
            return function(*args, **kwargs)
        except GUARDED as error:
            cause = meant(error)
            if cause is error:
                raise
        # Raise outside the except clause, and delete the name `cause`. Neither the earlier error nor this frame then
        # refers to the exception, and all objects in its traceback are freed together with it.
        try:
            raise cause
        finally:
            del cause

    return call
