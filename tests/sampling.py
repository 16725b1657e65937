"""How much of a law the quick suite tries: a part of its samples, of which `make verify` tries all."""

from collections.abc import Callable, Collection, Iterable
from typing import Any

import pytest
from hypothesis import settings

# Whether cases with the mark `verify` are left out; `conftest.py` sets it before tests are imported.
quick_suite = False


def quick_of(values: Iterable[Any], chosen: Collection[Any]) -> list[Any]:
    """Return the values of a parameter, of which the quick suite tries those chosen."""
    return [value if value in chosen else pytest.param(value, marks=pytest.mark.verify) for value in values]


def quick(first: Any, *others: Any) -> list[Any]:
    """Return the values of a parameter, of which the quick suite tries the first: numbers of samples, or seeds."""
    return quick_of((first, *others), (first,))


def examples(few: int, whole: int) -> Callable[[Any], Any]:
    """Have Hypothesis draw few examples in the quick suite; `make verify` runs the same test with all of them."""

    def drawing(test: Any) -> Any:
        if quick_suite:
            return settings(max_examples=few)(test)
        return pytest.mark.verify(settings(max_examples=whole)(test))

    return drawing
