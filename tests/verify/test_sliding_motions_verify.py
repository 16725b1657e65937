"""Tens of thousands of motions beside a wall, judged in fractions."""

from collections import Counter

import numpy as np
import pytest

from sliding_motions import judged, slide

pytestmark = [
    pytest.mark.verify,
    pytest.mark.filterwarnings("ignore:.*(is it in|all lengths being metres).*:UserWarning"),
]

ROBOTS, MOTIONS = 1_500, 32


def test_no_motion_beside_a_wall_is_judged_wrongly():
    """Of 48,000 motions no FREE one meets the wall, though many pass it within 1e-6, and no COLLIDING one is free."""
    wrong, total = [], Counter[str]()
    for seed in range(ROBOTS):
        found, counts = judged(slide(np.random.default_rng([1, seed]), MOTIONS))
        wrong += [f"robot {seed}: {text}" for text in found]
        total += counts
    print("motions beside a wall:", dict(total))
    assert not wrong
    assert total["FREE"] > ROBOTS * MOTIONS / 4
    assert total["COLLIDING"] > ROBOTS * MOTIONS / 10
    assert total["near"] > ROBOTS * MOTIONS / 10
