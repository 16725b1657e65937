"""A pair's answer does not depend on what else is asked: blocks, waiting lists, threads, order and repeats."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import NamedTuple

import numpy as np
import pytest

import loewner
from contacts import SEMI_AXES, Setting, contacts
from families import pieces, random_poses
from loewner import Bodies, Body, PoseError, Verdict
from oracles import exact_ellipsoid_verdict
from sampling import quick, quick_of

FREE, COLLIDING = Verdict.FREE, Verdict.COLLIDING

COUNT, EACH = 40, 30
EDGES = (1, 2, 15, 16, 17, 63, 64, 65, 127, 128, 129, 255, 256, 257, 383, 384, 385)

FIELDS = ("lower", "upper", "estimate", "distance", "witness_a", "witness_b", "normal")


class Crowd(NamedTuple):
    """Pairs, row by row, and what is said about them all at once: by `classify` and by `collide`."""

    a: Bodies
    Ta: np.ndarray
    b: Bodies
    Tb: np.ndarray
    verdict: np.ndarray
    colliding: np.ndarray

    def ask(self, which: np.ndarray | slice) -> tuple[np.ndarray, np.ndarray]:
        operands = self.a[which], self.Ta[which], self.b[which], self.Tb[which]
        return loewner.classify(*operands), loewner.collide(*operands)


@contextmanager
def threads(count: int) -> Iterator[None]:
    before = loewner.get_num_threads()
    loewner.set_num_threads(count)
    try:
        yield
    finally:
        loewner.set_num_threads(before)


def bodies(kind: str, seed: int) -> Bodies:
    if kind in SEMI_AXES:
        return Bodies.ellipsoids(SEMI_AXES[kind](np.random.default_rng(seed), COUNT))
    return Bodies.from_points(pieces(kind, COUNT, seed=seed))


def grazing(kind: str, which: str) -> Crowd:
    """Pairs whose outer or inner ellipsoids touch but for 1e-7 .. 1e-3: single precision is sure of hardly any.

    Stretches of pairs far apart come in between, of every share: whole blocks then are settled by spheres, and others
    leave few or many pairs to wait for those of the next.
    """
    rng = np.random.default_rng(5)
    a, b = bodies(kind, 1), bodies(kind, 2)
    c = contacts(rng, getattr(a, which), getattr(b, which), EACH, Setting(("", "")), 0.0, (-7, -3))
    order = rng.permutation(len(c.k))
    k, Ta, Tb = c.k[order], c.Ta[order], c.Tb[order]
    far = rng.uniform(size=len(k)) < np.repeat(rng.choice([0, 0.3, 0.55, 0.9, 1], size=len(k) // 100), 100)
    Tb[far, :3, 3] += 20.0
    operands = a[k], Ta, b[k], Tb
    return Crowd(*operands, loewner.classify(*operands), loewner.collide(*operands))


@pytest.fixture(
    scope="module",
    params=[("round", "outer"), ("discs", "outer"), ("ball 20", "outer"), ("ball 20", "inner"), ("boxes", "inner")],
    ids=" ".join,
)
def crowd(request: pytest.FixtureRequest) -> Crowd:
    return grazing(*request.param)


@pytest.mark.parametrize("every", quick(61, 7))
def test_alone(crowd: Crowd, every: int):
    """A pair asked about alone gets the answer that it gets among all the others."""
    for n in range(0, len(crowd.Ta), every):
        operands = crowd.a[n], crowd.Ta[n], crowd.b[n], crowd.Tb[n]
        assert loewner.classify(*operands) == crowd.verdict[n]
        assert loewner.collide(*operands) == crowd.colliding[n]


@pytest.mark.parametrize("count", quick_of(EDGES, (1, 15, 16, 17, 64, 127, 129, 256, 385)))
@pytest.mark.parametrize("step", quick(570, 190))
def test_batches_around_whole_blocks(crowd: Crowd, count: int, step: int):
    """Batches just below, at and above whole blocks give the answers of the whole batch."""
    for first in range(0, len(crowd.Ta) - count, step):
        some = slice(first, first + count)
        verdict, colliding = crowd.ask(some)
        assert np.array_equal(verdict, crowd.verdict[some])
        assert np.array_equal(colliding, crowd.colliding[some])


def test_any_order_and_repeats(crowd: Crowd):
    """Neither the order of the pairs nor asking about one repeatedly changes an answer."""
    rows = np.random.default_rng(1).integers(len(crowd.Ta), size=(3, 700))
    pairs = np.stack([rows, rows], axis=-1)
    operands = crowd.a, crowd.Ta, crowd.b, crowd.Tb
    assert np.array_equal(loewner.classify(*operands, pairs=pairs), crowd.verdict[rows])
    assert np.array_equal(loewner.collide(*operands, pairs=pairs), crowd.colliding[rows])
    for some, verdict in zip(rows, crowd.verdict[rows], strict=True):
        assert np.array_equal(crowd.ask(some)[0], verdict)


@pytest.mark.parametrize("pairs", quick(9_001, 13_001))
def test_any_number_of_threads(crowd: Crowd, pairs: int):
    """Enough pairs that several threads get some, each starting a range of its own."""
    rows = np.random.default_rng(2).integers(len(crowd.Ta), size=pairs)
    operands = crowd.a[rows], crowd.Ta[rows], crowd.b[rows], crowd.Tb[rows]
    for count in (1, 2):
        with threads(count):
            verdict, colliding = loewner.classify(*operands), loewner.collide(*operands)
        assert np.array_equal(verdict, crowd.verdict[rows])
        assert np.array_equal(colliding, crowd.colliding[rows])


def test_the_two_answers_agree(crowd: Crowd):
    """`collide` never contradicts a certified verdict of `classify`."""
    assert not crowd.colliding[crowd.verdict == FREE].any()
    assert crowd.colliding[crowd.verdict == COLLIDING].all()


# -- poses that are none ----------------------------------------------------------------------


@pytest.mark.parametrize("apart", [0.0, 40.0], ids=["near", "far"])
def test_a_faulty_pose_anywhere_is_found_and_named(apart: float):
    """One faulty pose anywhere in a batch is refused, and the error gives its index."""
    rng = np.random.default_rng(4)
    a, b = bodies("ball 20", 1)[np.zeros(700, dtype=int)], Body.box([1, 2, 1])
    several = Body.union([Body.box([1, 1, 1]), Body.sphere(0.7)])
    Ta, Tb = random_poses(rng, 700), random_poses(rng, 700)
    Tb[:, :3, 3] += apart
    for at in (0, 15, 16, 127, 128, 383, 639, 699):
        for fault in ("scaled", "infinite", "nan"):
            wrong = Tb.copy()
            if fault == "scaled":
                wrong[at, :3, :3] *= 1 + 1e-5
            else:
                wrong[at, 1, 3] = np.inf if fault == "infinite" else np.nan
            for body in (a, several):
                with pytest.raises(PoseError, match=rf"T_world_b\[{at}\]"):
                    loewner.classify(body, Ta, b, wrong)
                with pytest.raises(PoseError, match=rf"T_world_a\[{at}\]"):
                    loewner.collide(b, wrong, body, Ta)


# -- sizes far apart --------------------------------------------------------------------------


@pytest.mark.parametrize("shape", ["needles", *(pytest.param(k, marks=pytest.mark.verify) for k in ("balls", "round"))])
@pytest.mark.parametrize("every", quick(9, 3))
def test_sizes_far_apart_never_lie(shape: str, every: int):
    """From 1e-15 to 1e12 m in one batch: every verdict is that of rational arithmetic, or AMBIGUOUS."""
    rng = np.random.default_rng(6)
    sizes = np.array([1e-29, 1e-15, 1e-6, 1.0, 1e3, 1e12])
    size_a, size_b = (x.ravel() for x in np.meshgrid(sizes, sizes))
    a, b = (Bodies.ellipsoids(SEMI_AXES[shape](rng, 36) * s[:, None]) for s in (size_a, size_b))
    c = contacts(rng, a.outer, b.outer, 4, Setting((shape, shape), world=0.0), 0.0, (-6, -1))
    A, B = a[c.k], b[c.k]
    verdict, colliding = loewner.classify(A, c.Ta, B, c.Tb), loewner.collide(A, c.Ta, B, c.Tb)
    bounds = loewner.distance(A, c.Ta, B, c.Tb)
    for n in range(0, len(c.k), every):
        truth = exact_ellipsoid_verdict(
            A.outer.center[n], A.outer.factor[n], c.Ta[n], B.outer.center[n], B.outer.factor[n], c.Tb[n]
        )
        assert truth != 0
        assert verdict[n] != (COLLIDING if truth > 0 else FREE)
        assert colliding[n] or truth > 0
        assert not (bounds.upper[n] < 0 if truth > 0 else bounds.lower[n] > 0)
    assert np.isfinite([bounds.lower, bounds.upper, bounds.estimate]).all()


# -- distances --------------------------------------------------------------------------------


def curved(rng: np.random.Generator, count: int) -> list[Body]:
    """Pieces whose depths the fast searches leave to the expanding polytope."""
    makers = (Body.cylinder, Body.cone, Body.capsule)
    return [makers[n % 3](*rng.uniform(0.2, 1, size=2)) for n in range(count)]


def same(found: loewner.Distance, other: loewner.Distance, which: np.ndarray | slice) -> bool:
    return all(np.array_equal(getattr(found, name), getattr(other, name)[which]) for name in FIELDS)


def test_deep_distances_in_any_company():
    """Most of these need more than the fast search: to the last bit as alone, listed, in part and by two threads."""
    rng = np.random.default_rng(9)
    k = rng.integers(30, size=4200)
    a, b = (Bodies(curved(rng, 30))[k] for _ in "ab")
    Ta, Tb = random_poses(rng, len(k), 0.3), random_poses(rng, len(k), 0.3)
    found = loewner.distance(a, Ta, b, Tb, exact=True)
    assert (found.distance < 0).mean() > 0.5
    assert ((found.lower <= found.distance) & (found.distance <= found.upper)).all()
    offset = found.distance[:, None] * found.normal
    assert found.witness_b - found.witness_a == pytest.approx(offset, abs=1e-8)
    with threads(2):
        assert same(loewner.distance(a, Ta, b, Tb, exact=True), found, slice(None))
    rows = rng.integers(len(k), size=300)
    pairs = np.stack([rows, rows], axis=-1)
    assert same(loewner.distance(a, Ta, b, Tb, exact=True, pairs=pairs), found, rows)
    for count in (1, 31, 32, 33, 64, 65):
        assert same(loewner.distance(a[:count], Ta[:count], b[:count], Tb[:count], exact=True), found, slice(count))
    for n in range(0, len(k), 60):
        one = loewner.distance(a[n], Ta[n], b[n], Tb[n], exact=True)
        assert all(np.array_equal(getattr(one, name), getattr(found, name)[n]) for name in FIELDS)


@pytest.mark.parametrize("counts", [(2, 3), (20, 20), (100, 1)], ids=str)
def test_distance_of_a_union_is_the_least(counts: tuple[int, int]):
    """Of many pieces many wait for the careful search, and what they find must reach their own pair."""
    rng = np.random.default_rng(3)
    parts = []
    for count in counts:
        at = random_poses(rng, count, 0.4 * count ** (1 / 3))
        parts.append([piece.transformed(T) for piece, T in zip(curved(rng, count), at, strict=True)])
    a, b = (Body.union(p) for p in parts)
    Ta, Tb = random_poses(rng, 8, 0.1), random_poses(rng, 8, 0.1)
    Tb[:, 0, 3] += 0.4 * np.arange(8)
    found = loewner.distance(a, Ta, b, Tb, exact=True)
    every = np.indices(counts).T.reshape(-1, 2)
    for n in range(8):
        each = loewner.distance(Bodies(parts[0]), Ta[n], Bodies(parts[1]), Tb[n], exact=True, pairs=every)
        assert found.distance[n] == pytest.approx(each.distance.min(), abs=1e-9)
    offset = found.distance[:, None] * found.normal
    assert found.witness_b - found.witness_a == pytest.approx(offset, abs=1e-8)


@pytest.mark.parametrize("ratio", [1e3, 1e5])
def test_order_of_bodies_of_very_different_size(ratio: float):
    """The larger first or the smaller first: as many verdicts, with a margin too, and the same."""
    rng = np.random.default_rng(1)
    a, b = (Bodies.ellipsoids(SEMI_AXES["round"](rng, COUNT) * s) for s in (ratio**0.5, ratio**-0.5))
    c = contacts(rng, a.outer, b.outer, EACH, Setting(("", ""), world=0.0), 0.0, (-4, -2))
    for margin in (0.0, 1e-9 * ratio**-0.5):
        one = loewner.classify(a[c.k], c.Ta, b[c.k], c.Tb, margin=margin)
        other = loewner.classify(b[c.k], c.Tb, a[c.k], c.Ta, margin=margin)
        assert (one != Verdict.AMBIGUOUS).all()
        assert np.array_equal(one, other)
