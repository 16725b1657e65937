"""No wrong certified verdict, no wrong exact answer, on a million pairs whose truth is known.

`LOEWNER_VERIFY_PAIRS` sets how many pairs in all (default 1,000,000); run with ``-s`` to see the counts.
"""

import os

import numpy as np
import pytest

import loewner
from families import EIGHT, MORE, near_contact, pieces, sizes, stretch
from loewner import Bodies, Verdict
from oracles import exact_collides, hull, naive_distance, pack, signed_distances

pytestmark = pytest.mark.verify

PAIRS = int(os.environ.get("LOEWNER_VERIFY_PAIRS", "1000000"))
POOL = 2000  # bodies of each family
GRAZING = 1e-9  # relative to the size of the pair; closer than this the exact answer is judged by rationals

# Below this gap the separating-axis oracle, itself in float64, cannot tell the sign either.
ORACLE_ROUNDING = 1e-13


def judged(points, i, Ta, j, Tb, gap: np.ndarray) -> np.ndarray:
    """Truth of every pair: separating axes, and rational arithmetic where those are within rounding."""
    collides = gap <= 0
    for p in np.flatnonzero(np.abs(gap) < ORACLE_ROUNDING):
        collides[p] = exact_collides(points[i[p]], Ta[p], points[j[p]], Tb[p])
    return collides


@pytest.mark.parametrize("family", [*EIGHT, *MORE])
def test_no_wrong_verdict(family: str):
    """Every FREE is apart and every COLLIDING meets, grazing pairs included; exact agrees wherever not grazing."""
    wanted = PAIRS // len(EIGHT) if family in EIGHT else PAIRS // (8 * len(MORE))
    pool_size = min(POOL, max(20, wanted // 10))
    points = pieces(family, pool_size, seed=7)
    pool = pack(map(hull, points))
    reach = sizes(pool)
    a = Bodies.from_points(points)
    rng = np.random.default_rng([7, sum(family.encode())])
    tiers, wrong, wrong_exact, grazing, worst, done = np.zeros(3, int), 0, 0, 0, 0.0, 0
    rounds_at_once = max(1, 20_000 // pool_size)
    while done < wanted:
        order = rng.permutation(pool_size)
        b = Bodies([a[k] for k in order])
        i, j = np.tile(np.arange(pool_size), rounds_at_once), np.tile(order, rounds_at_once)
        Ta, Tb = near_contact(rng, pool, i, pool, j, stretch=stretch(family))
        gap, _ = signed_distances(pool, i, Ta, pool, j, Tb)
        truth = judged(points, i, Ta, j, Tb, gap)
        size = reach[i] + reach[j]

        posed = [T.reshape(rounds_at_once, pool_size, 4, 4) for T in (Ta, Tb)]
        verdict = loewner.classify(a, posed[0], b, posed[1]).ravel()
        exact = loewner.collide(a, posed[0], b, posed[1]).ravel()
        tiers += np.bincount(verdict, minlength=3)
        wrong += int(((verdict == Verdict.FREE) & truth).sum() + ((verdict == Verdict.COLLIDING) & ~truth).sum())
        disagree = np.flatnonzero(exact != truth)
        for p in disagree:
            # Where apart, the axes give a lower bound only.
            d = gap[p] if truth[p] else naive_distance(pool.hull(i[p]), Ta[p], pool.hull(j[p]), Tb[p])[0]
            if abs(d) > GRAZING * size[p]:
                wrong_exact += 1
            else:
                grazing += 1
                worst = max(worst, abs(d) / size[p])
        done += len(i)
    print(
        f"\n{family:22s} {done:8d} pairs: free {tiers[0]:7d}, colliding {tiers[1]:7d}, ambiguous {tiers[2]:7d}; "
        f"wrong certified {wrong}, wrong exact {wrong_exact}, touching within rounding {grazing} (at most {worst:.1e})"
    )
    assert wrong == 0
    assert wrong_exact == 0
    assert (tiers > 0.1 * done).all()  # the mix is what it says: no tier is starved


def test_distances_hold_everywhere():
    """Bounds enclose, and the exact signed distance is the true one, on a hundredth of the pairs."""
    rng = np.random.default_rng(9)
    count = max(200, PAIRS // 100 // len(EIGHT))
    for family in [*EIGHT, *MORE]:
        points = pieces(family, 100, seed=8)
        pool = pack(map(hull, points))
        reach = sizes(pool)
        a = Bodies.from_points(points)
        rounds = -(-count // 100)
        i = np.tile(np.arange(100), rounds)
        Ta, Tb = near_contact(rng, pool, i, pool, i[::-1], stretch=stretch(family))
        truth, _ = signed_distances(pool, i, Ta, pool, i[::-1], Tb)
        for p in np.flatnonzero(truth > 0):
            truth[p] = naive_distance(pool.hull(i[p]), Ta[p], pool.hull(i[::-1][p]), Tb[p])[0]
        b = Bodies([a[k] for k in range(100)][::-1])
        shape = (rounds, 100, 4, 4)
        result = loewner.distance(a, Ta.reshape(shape), b, Tb.reshape(shape), exact=True)
        size = reach[i] + reach[i[::-1]]
        error = np.abs(result.distance.ravel() - truth) / size
        print(f"\n{family:22s} {len(i):6d} distances: largest error {error.max():.1e} of the size")
        assert (result.lower.ravel() <= truth + 1e-12 * size).all()
        assert (truth <= result.upper.ravel() + 1e-12 * size).all()
        assert error.max() <= 1e-9
