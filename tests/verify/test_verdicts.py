"""No wrong certified verdict, no wrong exact answer, on ten million pairs whose truth is known.

`LOEWNER_VERIFY_PAIRS` sets how many pairs in all (default 10,000,000); run with ``-s`` to see the counts.
"""

import os
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import pytest

import loewner
from families import FAMILIES, pieces, posed_near_contact, rotations
from loewner import Bodies, Verdict
from oracles import (
    Differences,
    HullPool,
    differences,
    exact_collides,
    gap_along,
    hull,
    naive_distance,
    pack,
    posed_gaps,
)

pytestmark = pytest.mark.verify

PAIRS = int(os.environ.get("LOEWNER_VERIFY_PAIRS", "10000000"))
DISTANCES = max(1500, PAIRS // 100)
POOL = 2000  # bodies of each family, each paired with another at one turn
AT_ONCE = 100_000  # pairs
SINGLE_CALLS = 100  # one pair in so many is asked by itself too
ALIGNED = 0.05  # the share of turns by multiples of a right angle: parallel faces and edges

# Pairs apart by less than this share of the lengths may count as touching (docs/certified.md).
TOUCHING = 1e-12

# Below this gap, relative to the lengths, the separating axes, themselves in float64, cannot tell the sign: a gap is
# a product of three terms with numbers that took two more, and the turn rounds; all in all about thirty roundings.
ORACLE_ROUNDING = 1e-14

# What the mix of a family must have at least of each verdict; bodies inside each other are hardly ever free.
LEAST_SHARE = {"one inside the other": 0.0}


class World(NamedTuple):
    """Pairs of one family: body k of `a` and body k of `b`, always at turn k to each other."""

    points: list[np.ndarray]
    pool: HullPool
    order: np.ndarray
    a: Bodies
    b: Bodies
    faces: Differences


def world(family: str, count: int) -> World:
    rng = np.random.default_rng([7, sum(family.encode())])
    points = pieces(family, count, seed=7)
    pool = pack(map(hull, points))
    order = rng.permutation(count)
    turns = rotations(rng, count)
    aligned = rng.uniform(size=count) < ALIGNED
    turns[aligned] = np.eye(3)[:, rng.permutation(3)]
    turns[aligned] *= np.linalg.det(turns[aligned])[:, None, None]
    a = Bodies.from_points(points)
    b = Bodies([a[k] for k in order])
    return World(points, pool, order, a, b, differences(pool, np.arange(count), pool, order, turns))


def rounds(w: World, family: str, wanted: int) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Bodies and poses of at least `wanted` pairs, whole rounds over all bodies at a time."""
    rng = np.random.default_rng([8, sum(family.encode())])
    along = (0.0, 1.0) if family == "one inside the other" else (0.0, 2.2)
    each = max(1, min(AT_ONCE, wanted) // len(w.points))
    for _ in range(-(-wanted // (each * len(w.points)))):
        pair = np.tile(np.arange(len(w.points)), each)
        yield pair, *posed_near_contact(rng, w.faces, pair, along=along)


def judged(w: World, pair: np.ndarray, Ta: np.ndarray, Tb: np.ndarray) -> tuple[np.ndarray, np.ndarray, int]:
    """Truth of every pair, its gap in units of the lengths, and how many were left to rational arithmetic."""
    gap, _ = posed_gaps(w.faces, pair, Ta, Tb)
    gap /= w.faces.size[pair] + np.linalg.norm(Tb[:, :3, 3] - Ta[:, :3, 3], axis=1)
    collides = gap <= 0
    doubtful = np.flatnonzero(np.abs(gap) < ORACLE_ROUNDING)
    for p in doubtful:
        k = pair[p]
        collides[p] = exact_collides(w.points[k], Ta[p], w.points[w.order[k]], Tb[p])
    return collides, gap, len(doubtful)


def wrong_verdicts(verdict: np.ndarray, truth: np.ndarray) -> int:
    return int(((verdict == Verdict.FREE) & truth).sum() + ((verdict == Verdict.COLLIDING) & ~truth).sum())


@pytest.mark.parametrize("family", FAMILIES)
def test_no_wrong_verdict(family: str):
    """Every FREE is apart, every COLLIDING meets, exact answers are true: in batches, and one pair at a time."""
    wanted = -(-PAIRS // len(FAMILIES))
    w = world(family, min(POOL, max(20, wanted // 10)))
    shape = (-1, len(w.points), 4, 4)
    tiers, wrong, wrong_exact, touching, rational, done, single, worst = np.zeros(3, int), 0, 0, 0, 0, 0, 0, 0.0
    singles = {k: (w.a[k], w.b[k]) for k in range(0, len(w.points), SINGLE_CALLS)}
    for pair, Ta, Tb in rounds(w, family, wanted):
        truth, gap, doubtful = judged(w, pair, Ta, Tb)
        verdict = loewner.classify(w.a, Ta.reshape(shape), w.b, Tb.reshape(shape)).ravel()
        exact = loewner.collide(w.a, Ta.reshape(shape), w.b, Tb.reshape(shape)).ravel()
        wrong += wrong_verdicts(verdict, truth)
        # "Apart" is proven, "touching" is so within rounding.
        excused = exact & ~truth & (gap < TOUCHING)
        wrong_exact += int(((exact != truth) & ~excused).sum())
        alone = np.flatnonzero(pair % SINGLE_CALLS == 0)
        for p in alone:
            a, b = singles[int(pair[p])]
            one = np.array([loewner.classify(a, Ta[p], b, Tb[p])])
            wrong += wrong_verdicts(one, truth[[p]])
            met = loewner.collide(a, Ta[p], b, Tb[p])
            wrong_exact += met != truth[p] and not (met and gap[p] < TOUCHING)
        tiers += np.bincount(verdict, minlength=3)
        touching += int(excused.sum())
        worst = max(worst, float(gap[excused].max(initial=0)))
        rational, done, single = rational + doubtful, done + len(pair), single + len(alone)
    print(
        f"\n{family:22s} {done:8d} pairs ({single} one by one too, {rational} judged by rationals): "
        f"free {tiers[0]:7d}, colliding {tiers[1]:7d}, ambiguous {tiers[2]:7d}; "
        f"wrong certified {wrong}, wrong exact {wrong_exact}, touching within rounding {touching} "
        f"(at most {worst:.1e} of the lengths apart)"
    )
    assert wrong == 0
    assert wrong_exact == 0
    assert (tiers > LEAST_SHARE.get(family, 0.1) * done).all()  # the mix is what it says: no tier is starved


def outside(w: World, pair: np.ndarray, side: str, T: np.ndarray, x: np.ndarray) -> float:
    """How far points of the world, one for each pair, are outside the hulls they should be in, over the size."""
    worst = 0.0
    for p, k in enumerate(pair):
        h = w.pool.hull(k if side == "a" else w.order[k])
        local = T[p, :3, :3].T @ (x[p] - T[p, :3, 3])
        worst = max(worst, float((h.normals @ local - (h.normals @ h.vertices.T).max(axis=1)).max() / w.faces.size[k]))
    return worst


@pytest.mark.parametrize("family", FAMILIES)
def test_distances_are_true(family: str):
    """Signed distances to 1e-9 of the size, bounds about them, witnesses in their bodies: a hundredth of the pairs."""
    wanted = -(-DISTANCES // len(FAMILIES))
    w = world(family, 100)
    shape = (-1, len(w.points), 4, 4)
    error = bounds = inside = together = apart = done = 0.0
    for pair, Ta, Tb in rounds(w, family, wanted):
        # The largest gap over all faces is the depth where hulls meet; where they do not, only a lower bound.
        truth, _ = posed_gaps(w.faces, pair, Ta, Tb)
        free = np.flatnonzero(truth > 0)
        d = loewner.distance(w.a, Ta.reshape(shape), w.b, Tb.reshape(shape), exact=True)
        size = w.faces.size[pair]
        found = d.distance.ravel()
        near_a, near_b, normal = (x.reshape(-1, 3) for x in (d.witness_a, d.witness_b, d.normal))
        for p in free:
            k = pair[p]
            a, b = w.pool.hull(k), w.pool.hull(w.order[k])
            truth[p], _, _, proof = naive_distance(a, Ta[p], b, Tb[p])
            if proof < truth[p] - 1e-9 * size[p]:
                # The reference is a distance of two points, and does not prove that no others are nearer (almost
                # parallel edges). The gap along any direction is a lower bound; the witnesses give the upper one.
                truth[p] = max(proof, gap_along(normal[p], a, Ta[p], b, Tb[p]))
        error = max(error, float((np.abs(found - truth) / size).max()))
        bounds = max(bounds, float((np.maximum(d.lower.ravel() - truth, truth - d.upper.ravel()) / size).max()))
        inside = max(inside, outside(w, pair, "a", Ta, near_a), outside(w, pair, "b", Tb, near_b))
        step = near_b - near_a - found[:, None] * normal
        together = max(together, float((np.linalg.norm(step, axis=1) / size).max()))
        assert np.abs(np.linalg.norm(normal, axis=1) - 1).max() < 1e-12
        apart, done = apart + len(free), done + len(pair)
    print(
        f"\n{family:22s} {done:8.0f} distances ({apart:.0f} apart): largest error {error:.1e} of the size, "
        f"bounds broken by {bounds:.1e}, witnesses outside their bodies by {inside:.1e}, "
        f"off distance times normal by {together:.1e}"
    )
    assert error <= 1e-9
    assert bounds <= 1e-12
    assert inside <= 1e-9
    assert together <= 1e-9
