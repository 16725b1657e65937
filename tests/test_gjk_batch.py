"""Open pairs sixteen side by side in single precision: what is said is true, and of the right pair."""

from typing import NamedTuple

import numpy as np
import pytest
from numba.core.errors import NumbaError

import loewner
from families import box_corners, pieces, posed_near_contact, random_poses, rotations
from loewner import Bodies, Body, PoseError
from loewner._base._workspaces import Memory
from loewner._kernels import codes, columns
from loewner._kernels._jit import njit
from loewner._kernels.narrow import gjk_batch
from loewner._kernels.simd.vectors import broadcast, store
from loewner.queries.pairs import _prepare, _settle
from oracles import differences, hull, pack, posed_gaps

ROUNDOFF = 2.0**-24
EACH = 12  # pieces of a family
COUNT = 640  # pairs that are asked together, at least

FAMILIES = [
    ("ball 20", "ball 20"),
    ("boxes", "tetrahedra"),
    ("cubes", "cubes"),
    ("prisms", "rods 1:0.05:0.05"),
    ("plates 1:1:0.05", "slivers"),
    ("needles 1:1e-3:1e-3", "ball 50"),
]


@njit()
def _ask(sa, la, xa, ia, Ta, moved_a, sb, lb, xb, ib, Tb, moved_b, N, width, found, free, memory):
    """What `gjk_batch.settle` says in groups of `width`, and `gjk_batch.plane` of each pair by itself."""
    for first in range(0, len(N), width):
        count = min(width, len(N) - first)
        for n in range(count):
            k = first + n
            ka, kb = k if moved_a else 0, k if moved_b else 0
            gjk_batch.put(memory, n, k, ia[k], ib[k], ka, kb, (N[k, 0], N[k, 1], N[k, 2]))
            free[k] = gjk_batch.plane(sa, la, xa, ia[k], Ta, ka, sb, lb, xb, ib[k], Tb, kb, (N[k, 0], N[k, 1], N[k, 2]))
        gjk_batch.settle(count, sa, la, xa, Ta, moved_a, sb, lb, xb, Tb, moved_b, memory)
        found[first : first + count] = gjk_batch.workspace_at(memory).found[:count]


class Crowd(NamedTuple):
    """Pairs of small polytopes, piece by piece."""

    a: Bodies
    ia: np.ndarray
    Ta: np.ndarray | None
    b: Bodies
    ib: np.ndarray
    Tb: np.ndarray | None

    def ask(self, directions: np.ndarray, which: np.ndarray | slice = slice(None), width: int = 16):
        """Answers of the walk, and of the plane, to some of the pairs."""
        operands = []
        for bodies, rows, T in ((self.a, self.ia, self.Ta), (self.b, self.ib, self.Tb)):
            kernel = bodies._packed.kernel
            layout, single, vertices = kernel.layout, kernel.single, kernel.vertices
            assert (layout[rows, columns.KIND] == columns.POLYTOPE).all()
            assert len(vertices) > 0
            assert (layout[rows, columns.POINTS_TO] - layout[rows, columns.POINTS_FROM]).max() <= gjk_batch.MOST
            poses = np.eye(4)[None] if T is None else np.ascontiguousarray(T[which])
            operands += [single, layout, vertices, np.ascontiguousarray(rows[which]), poses, T is not None]
        N = np.ascontiguousarray(directions[which])
        found, free = np.full(len(N), -1, dtype=np.int8), np.zeros(len(N), dtype=bool)
        memory = Memory(gjk_batch.WORKSPACE.size())
        _ask(*operands, N, width, found, free, memory.address)
        return found, free

    def lengths(self, poses: bool) -> np.ndarray:
        """What positions are made of: the reaches of both pieces, and the translations if asked for."""
        total = np.zeros(len(self.ia))
        for bodies, rows, T in ((self.a, self.ia, self.Ta), (self.b, self.ib, self.Tb)):
            total += bodies._packed.kernel[0][rows, columns.REACH]
            total += np.abs(T[:, :3, 3]).sum(axis=1) if poses and T is not None else 0.0
        return total


def crowd(rng: np.random.Generator, names: tuple[str, str], off: float, world: float, turned: bool, exponents):
    """Pairs whose gap or depth is a power of ten of what single precision rounds; the gap of each and its axis.

    Parameters
    ----------
    off : float
        How far vertices are from the origin of their bodies.
    world : float
        How far bodies are from that of the world.
    exponents : tuple of float
        Between which powers of ten.
    """
    points = [[p + off * rng.normal(size=3) for p in pieces(name, EACH, seed=k)] for k, name in enumerate(names)]
    rows = np.arange(EACH)
    turns = rotations(rng, EACH) if turned else np.tile(np.eye(3), (EACH, 1, 1))
    faces = differences(*(x for p in points for x in (pack(map(hull, p)), rows)), turns)
    pair = rng.integers(EACH, size=COUNT)
    Ta, Tb = posed_near_contact(rng, faces, pair, grazing=1.0, spread=world)
    if not turned:
        Ta[:, :3, :3] = Tb[:, :3, :3] = np.eye(3)
    gap, axis = posed_gaps(faces, pair, Ta, Tb)
    at = Crowd(Bodies.from_points(points[0]), pair, Ta, Bodies.from_points(points[1]), pair, Tb)
    sizes = np.where(rng.uniform(size=COUNT) < 0.5, at.lengths(True), at.lengths(False))
    wanted = ROUNDOFF * sizes * 10 ** rng.uniform(*exponents, size=COUNT) * rng.choice([-1, 1], size=COUNT)
    Tb[:, :3, 3] += (wanted - gap)[:, None] * axis
    return at, *posed_gaps(faces, pair, Ta, Tb)


@pytest.mark.verify  # it compiles the search, which it calls directly
@pytest.mark.parametrize("names", FAMILIES, ids=" and ".join)
def test_what_is_said_is_true(names: tuple[str, str]):
    """Gaps and depths from a fifth of a rounding to where every answer is given."""
    rng = np.random.default_rng(3)
    said = dict.fromkeys(("apart", "touching", "plane"), 0)
    for off in (0.0, 3.0):
        for world in (0.0, 3.0):
            for turned in (False, True):
                pairs, gap, axis = crowd(rng, names, off, world, turned, (-0.7, 4.5))
                if world == 0.0 and not turned:
                    pairs = pairs._replace(Ta=None)
                doubt = 1e-13 * pairs.lengths(True)
                for noise in (0.0, 0.3):
                    directions = axis + noise * rng.normal(size=axis.shape)
                    directions *= 10 ** rng.uniform(-6, 6, size=(COUNT, 1))
                    found, free = pairs.ask(directions)
                    assert not (gap[free] < -doubt[free]).any()
                    assert not (gap < -doubt)[found == codes.APART].any()
                    assert not (gap > doubt)[found == codes.TOUCHING].any()
                    assert np.isin(found, (codes.UNSETTLED, codes.APART, codes.TOUCHING)).all()
                    said["apart"] += (found == codes.APART).sum()
                    said["touching"] += (found == codes.TOUCHING).sum()
                    said["plane"] += free.sum()
    assert min(said.values()) > 100, said


@pytest.mark.verify  # it compiles the search, which it calls directly
def test_directions_that_are_none():
    """Zero, not a number, infinite, or out of range: never a lie, and the walk finds its way."""
    rng = np.random.default_rng(5)
    pairs, gap, axis = crowd(rng, ("ball 20", "boxes"), 0.0, 1.0, True, (4, 6))
    for size in (0.0, np.nan, np.inf, -np.inf, 1e-40, 1e-16, 1e18, 1e25, 1e36):
        found, free = pairs.ask(np.full_like(axis, size) if not 0 < abs(size) < np.inf else axis * size)
        assert (gap[free] > 0).all()
        assert (found == np.where(gap > 0, codes.APART, codes.TOUCHING)).mean() > 0.8, size
        assert not (found == np.where(gap > 0, codes.TOUCHING, codes.APART)).any()


@pytest.mark.verify  # it compiles the search, which it calls directly
def test_a_plane_does_not_overflow():
    """Two boxes on top of each other, far from the origins of their bodies; every product is below single precision."""
    corners = box_corners(np.ones(3)) - [500.0, 0.0, 0.0]
    boxes, T = Bodies.from_points([corners]), np.tile(np.eye(4), (16, 1, 1))
    rows = np.zeros(16, dtype=np.int64)
    for size in 10.0 ** np.arange(10, 160, 5):
        found, free = Crowd(boxes, rows, T, boxes, rows, T).ask(np.tile([size, 0.0, 0.0], (16, 1)))
        assert not free.any(), size
        assert not (found == codes.APART).any(), size


@pytest.mark.verify  # it compiles the search, which it calls directly
def test_lanes_know_nothing_of_each_other():
    """In any place, among any others, with few or many vertices: the same answer."""
    rng = np.random.default_rng(6)
    points = (
        [box_corners(rng.uniform(0.3, 1, size=3)) for _ in range(4)] + pieces("ball 50", 4) + pieces("ball 200", 24)
    )
    small = [p for p in points if 4 <= len(hull(p).vertices) <= gjk_batch.MOST]
    bodies = Bodies.from_points(small)
    assert max(len(body.pieces[0].vertices) for body in bodies) > gjk_batch.MOST - 8
    k, j = rng.integers(len(small), size=(2, COUNT))
    pairs = Crowd(bodies, k, random_poses(rng, COUNT, 0.9), bodies, j, random_poses(rng, COUNT, 0.9))
    directions = rng.normal(size=(COUNT, 3))
    alone, _ = pairs.ask(directions, width=1)
    assert min(np.bincount(alone, minlength=3)[[codes.APART, codes.TOUCHING]]) > 100
    for width in (2, 3, 15, 16):
        order = rng.permutation(COUNT)
        assert np.array_equal(pairs.ask(directions, order, width)[0], alone[order])


# -- as users ask ---------------------------------------------------------------------------------------


def open_pairs(rng: np.random.Generator, count: int):
    """Pairs that overlap in their outer ellipsoids, of few vertices and of many, and of curved pieces; their gaps."""
    makers = [Body.from_points(p) for name in ("ball 8", "boxes", "prisms", "ball 200") for p in pieces(name, 5)]
    bodies = Bodies([*makers, Body.cylinder(0.5, 1.0), Body.cone(0.6, 1.0), Body.capsule(0.3, 0.8)])
    k, j = rng.choice(len(bodies), size=(2, count), p=np.r_[np.full(15, 0.06), np.full(8, 0.1 / 8)])
    Ta, Tb = random_poses(rng, count, 1.0), random_poses(rng, count, 1.0)
    found = loewner.distance(bodies[k], Ta, bodies[j], Tb, exact=True)
    wanted = 10 ** rng.uniform(-10, -1, size=count) * rng.choice([-1, 1], size=count)
    Tb[:, :3, 3] += (wanted - found.distance)[:, None] * found.normal
    return bodies[k], Ta, bodies[j], Tb, loewner.distance(bodies[k], Ta, bodies[j], Tb, exact=True).distance


def test_no_pair_is_lost_or_mixed_up():
    """Shares that end with any number of pairs waiting; every piece pair is counted once."""
    rng = np.random.default_rng(8)
    a, Ta, b, Tb, gap = open_pairs(rng, 1500)
    truth = gap < 0
    assert (np.abs(gap) > 1e-11).all()
    for count in (*range(1, 41), 127, 128, 129, 255, 256, 257, 383, 384, 385, 1500):
        first = int(rng.integers(1500 - count + 1))
        some = slice(first, first + count)
        out, tally = _settle(codes.EXACT, 0.0, _prepare(a[some], Ta[some], b[some], Tb[some], check=False))
        assert np.array_equal(out == codes.COLLIDING, truth[some])
        assert tally.sum() == count
    order = rng.permutation(1500)
    pairs = np.stack([order, order], axis=-1)
    assert np.array_equal(loewner.collide(a, Ta, b, Tb, pairs=pairs), truth[order])


def test_a_margin_is_kept():
    """The walk knows no margin: pairs within it collide, whatever is between them."""
    a, Ta, b, Tb, gap = open_pairs(np.random.default_rng(9), 400)
    for margin in (1e-9, 1e-4, 0.05):
        sure = np.abs(gap - margin) > 1e-11
        assert np.array_equal(loewner.collide(a, Ta, b, Tb, margin=margin)[sure], (gap < margin)[sure])


@pytest.mark.parametrize("counts", [(3, 5), (40, 2)], ids=str)
def test_bodies_of_many_pieces(counts: tuple[int, int]):
    """A body collides exactly if two of its pieces do, one by one."""
    rng = np.random.default_rng(10)
    parts = [
        [
            Body.from_points(p).transformed(T)
            for p, T in zip(pieces("ball 8", n), random_poses(rng, n, 1.0), strict=True)
        ]
        for n in counts
    ]
    Ta, Tb = random_poses(rng, 60, 0.1), random_poses(rng, 60, 3.0)
    every = np.indices(counts).T.reshape(-1, 2)
    truth = [
        loewner.collide(*map(Bodies, parts[:1]), T, Bodies(parts[1]), S, pairs=every).any()
        for T, S in zip(Ta, Tb, strict=True)
    ]
    assert np.array_equal(loewner.collide(Body.union(parts[0]), Ta, Body.union(parts[1]), Tb), truth)
    assert 0.1 < np.mean(truth) < 0.9


def test_a_faulty_pose_while_pairs_wait():
    """A faulty pose is found and named also while other pairs wait for the batched search."""
    rng = np.random.default_rng(11)
    a, Ta, b, Tb, _ = open_pairs(rng, 600)
    for at in (0, 5, 127, 128, 300, 599):
        wrong = Tb.copy()
        wrong[at, 0, 0] = np.nan
        with pytest.raises(PoseError, match=rf"T_world_b\[{at}\]"):
            loewner.collide(a, Ta, b, wrong)
    assert loewner.collide(a[:0], Ta[:0], b[:0], Tb[:0]).shape == (0,)


@njit()
def _ones(array):
    store(array, 0, broadcast(1.0))


def test_arrays_in_another_order_do_not_compile():
    """Vectors look at no strides: an array that is not in C order is refused, not misread."""
    array = np.zeros(16)
    _ones(array)
    assert array.tolist() == [1.0] * 8 + [0.0] * 8
    with pytest.raises(NumbaError, match="expected an array in C order"):
        _ones(np.zeros(32)[::2])
