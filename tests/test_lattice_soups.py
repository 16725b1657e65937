"""Surfaces at contact on a lattice: what whole numbers say of them."""

from collections import Counter

import numpy as np
import pytest

from lattice_soups import judged, pair
from sampling import quick

pytestmark = pytest.mark.filterwarnings("ignore:.*all lengths being metres.*:UserWarning")


@pytest.mark.parametrize("seed", [0, *(pytest.param(k, marks=pytest.mark.verify) for k in range(1, 8))])
@pytest.mark.parametrize("count", quick(12, 25))
def test_surfaces_at_contact(seed: int, count: int):
    """Verdicts are those of whole numbers, alone, swapped and in a batch; distances are right to the last digits."""
    rng, counts = np.random.default_rng(seed), Counter[str]()
    wrong = [text for _ in range(count) if (text := judged(pair(rng), counts))]
    assert not wrong
    assert counts["colliding"] > 0
    assert counts["free"] > 0
    assert counts["whole"] > 0, "or floating point settled all of them"
