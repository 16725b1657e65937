"""Values that an object computes once and keeps, the same for all threads."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from typing import Any, TypeVar, overload

T = TypeVar("T")


class kept(cached_property[T]):
    """A property that is computed when it is first needed, and kept.

    `functools.cached_property` has no lock from Python 3.12 on: of two threads that meet in it each gets a value of its
    own, and that of one dies with the next word. Kernels get addresses of what is in such values. Here both may
    compute, but the first value that is kept is the one that all get.

    Parameters
    ----------
    func : callable
        From the object to the value.
    """

    @overload
    def __get__(self, instance: None, owner: type[Any] | None = None) -> kept[T]: ...
    @overload
    def __get__(self, instance: object, owner: type[Any] | None = None) -> T: ...
    def __get__(self, instance: Any, owner: type[Any] | None = None) -> kept[T] | T:
        if instance is None:
            return self
        # From now on found before this: what an object has itself goes before what its class has but does not set.
        value: T = vars(instance).setdefault(self.func.__name__, self.func(instance))
        return value

    def hand_on(self, old: Any, new: Any, change: Callable[[T], T] | None = None) -> None:
        """Give a new object the value of an old one, or what `change` makes of it, if it has been computed."""
        if self.func.__name__ in vars(old):
            value = vars(old)[self.func.__name__]
            vars(new)[self.func.__name__] = value if change is None else change(value)
