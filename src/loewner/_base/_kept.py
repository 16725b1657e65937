"""Values that an object computes once and keeps, shared by all threads."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from typing import Any, TypeVar, overload

T = TypeVar("T")


class kept(cached_property[T]):
    """A property that is computed when it is first needed and then kept.

    `functools.cached_property` has no lock in Python 3.12 and later. Two threads that compute a property at once get
    different values, one of which is soon freed although kernels may have received addresses in it. With this class,
    several threads may compute a value, but all of them get the first value that was kept.

    Parameters
    ----------
    func : callable
        Function from the object to the value.
    """

    @overload
    def __get__(self, instance: None, owner: type[Any] | None = None) -> kept[T]: ...
    @overload
    def __get__(self, instance: object, owner: type[Any] | None = None) -> T: ...
    def __get__(self, instance: Any, owner: type[Any] | None = None) -> kept[T] | T:
        if instance is None:
            return self
        # Later look-ups find the instance's attribute first, since it takes precedence over a non-data descriptor of
        # the class.
        value: T = vars(instance).setdefault(self.func.__name__, self.func(instance))
        return value

    def hand_on(self, old: Any, new: Any, change: Callable[[T], T] | None = None) -> None:
        """Give a new object the value of an old object, if already computed, after applying `change` if given."""
        if self.func.__name__ in vars(old):
            value = vars(old)[self.func.__name__]
            vars(new)[self.func.__name__] = value if change is None else change(value)
