"""Motions along a wall and towards it, at gaps down to 1e-12 of the size: fractions judge the verdicts."""

import numpy as np
import pytest

from sampling import quick_of
from sliding_motions import judged, slide

pytestmark = pytest.mark.filterwarnings("ignore:.*(is it in|all lengths being metres).*:UserWarning")


@pytest.mark.parametrize("seed", quick_of(range(40), range(15)))
def test_motions_beside_a_wall(seed: int):
    """FREE is free at every moment, COLLIDING meets the wall at the fraction given, whatever size, place and body."""
    wrong, counts = judged(slide(np.random.default_rng(seed), 16))
    assert not wrong
    assert counts["FREE"] + counts["COLLIDING"] > 0, "or nothing was judged"
