"""Thousands of surfaces at contact on a lattice, and the depths of surfaces, judged in whole numbers."""

from collections import Counter
from collections.abc import Callable

import numpy as np
import pytest

from lattice_soups import Pair, judged, not_parted, pair

pytestmark = [pytest.mark.verify, pytest.mark.filterwarnings("ignore:.*all lengths being metres.*:UserWarning")]

PAIRS = 5_000


Judge = Callable[[Pair, Counter[str]], str]


def campaign(judge: Judge, seed: int, hulls: bool, count: int) -> tuple[list[str], Counter[str]]:
    """What a judge finds wrong of so many pairs, each of a seed of its own, and what it counted."""
    wrong, counts = [], Counter[str]()
    for k in range(count):
        text = judge(pair(np.random.default_rng([seed, k]), hulls), counts)
        if text:
            wrong.append(f"pair {seed, k}: {text}")
    return wrong, counts


def test_no_surface_at_contact_is_judged_wrongly():
    """Verdicts of surfaces at contact plus or minus 1e-18 to 1e-6, sizes up to 1e6 : 1, are those of whole numbers."""
    wrong, counts = campaign(judged, 1, False, PAIRS)
    print("surfaces at contact:", dict(counts))
    assert not wrong
    assert min(counts["free"], counts["colliding"]) > PAIRS / 10


@pytest.mark.parametrize("hulls", [False, True], ids=["surfaces", "hulls"])
def test_less_than_the_depth_does_not_part(hulls: bool):
    """A depth is a lower bound: bodies moved by 0.999999 of it along the normal still meet, in whole numbers."""
    wrong, counts = campaign(not_parted, 2, hulls, PAIRS)
    print("depths:", dict(counts))
    assert not wrong
    assert counts["depths"] > PAIRS / 10
