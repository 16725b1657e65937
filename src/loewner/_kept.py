"""Values that an object computes once and keeps, the same for all threads."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Generic, TypeVar, overload

T = TypeVar("T")


class kept(Generic[T]):
    """A property that is computed when it is first needed, and kept.

    `functools.cached_property` has no lock from Python 3.12 on: of two threads that meet in it each gets a value of its
    own, and that of one dies with the next word. Kernels get addresses of what is in such values. Here both may
    compute, but the first value that is kept is the one that all get.

    Parameters
    ----------
    compute : callable
        From the object to the value.
    """

    def __init__(self, compute: Callable[[Any], T]) -> None:
        self._compute, self._name, self.__doc__ = compute, compute.__name__, compute.__doc__

    @overload
    def __get__(self, instance: None, owner: type) -> kept[T]: ...
    @overload
    def __get__(self, instance: object, owner: type) -> T: ...
    def __get__(self, instance: Any, owner: type) -> kept[T] | T:
        if instance is None:
            return self
        # From now on found before this: what an object has itself goes before what its class has but does not set.
        value: T = vars(instance).setdefault(self._name, self._compute(instance))
        return value
