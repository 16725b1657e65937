"""The families and placements are what they claim, so that a million right answers mean something."""

import numpy as np
import pytest

import loewner
from families import EIGHT, FAMILIES, near_contact, pieces, sizes, stretch
from loewner import Bodies
from oracles import exact_squared_distance, hull, naive_distance, pack, signed_distances

pytestmark = pytest.mark.verify


@pytest.mark.parametrize("family", FAMILIES)
def test_oracles_agree(family: str):
    """Separating axes, naive distance and rational arithmetic give the same answers on 150 pairs."""
    rng = np.random.default_rng(21)
    points = pieces(family, 30, seed=3)
    pool = pack(map(hull, points))
    i, j = rng.integers(0, 30, size=(2, 150))
    Ta, Tb = near_contact(rng, pool, i, pool, j, grazing=0.3)
    gap, _ = signed_distances(pool, i, Ta, pool, j, Tb)
    for p in range(150 if len(pool.vertices) < 900 else 30):
        squared = exact_squared_distance(points[i[p]], Ta[p], points[j[p]], Tb[p])
        if abs(gap[p]) > 1e-14:
            assert (squared == 0) == (gap[p] <= 0)
        if gap[p] > 1e-14:
            d = naive_distance(pool.hull(i[p]), Ta[p], pool.hull(j[p]), Tb[p])[0]
            assert d == pytest.approx(float(squared) ** 0.5, abs=5e-15)


@pytest.mark.parametrize("family", EIGHT)
def test_pairs_are_near_contact(family: str):
    """About a third each is free, ambiguous and colliding, and a tenth grazes."""
    rng = np.random.default_rng(22)
    points = pieces(family, 100, seed=3)
    pool = pack(map(hull, points))
    i = np.tile(np.arange(100), 30)
    Ta, Tb = near_contact(rng, pool, i, pool, i[::-1], stretch=stretch(family))
    gap, _ = signed_distances(pool, i, Ta, pool, i[::-1], Tb)
    size = sizes(pool)[i] + sizes(pool)[i[::-1]]
    a = Bodies.from_points(points)
    b = Bodies([a[k] for k in range(100)][::-1])
    verdict = loewner.classify(a, Ta.reshape(30, 100, 4, 4), b, Tb.reshape(30, 100, 4, 4))
    shares = np.bincount(verdict.ravel(), minlength=3) / verdict.size
    print(f"\n{family:22s} free {shares[0]:.2f}, colliding {shares[1]:.2f}, ambiguous {shares[2]:.2f}")
    assert 0.2 < np.mean(gap <= 0) < 0.8
    assert (shares > 0.15).all()
    assert 0.05 < np.mean(np.abs(gap) < 1e-2 * size) < 0.4
