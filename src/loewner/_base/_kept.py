"""Values that an object computes once and keeps, shared by all threads."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from typing import Any, TypeVar, overload

T = TypeVar("T")


class kept(cached_property[T]):
    """A property that is computed when it is first needed and then kept.

    `functools.cached_property` has no lock in Python 3.12 and later. If two threads compute a property at the same
    time, they get different values. One of these values is soon freed, although kernels may have received addresses in
    it. With this class, several threads may compute the value, but all threads get the value that was stored first.

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
        """Give a new object the value that an old object has computed, if any, after applying `change` if given."""
        if self.func.__name__ in vars(old):
            value = vars(old)[self.func.__name__]
            vars(new)[self.func.__name__] = value if change is None else change(value)
