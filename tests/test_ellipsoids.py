"""Ellipsoids: what they hold, how far they reach, how they move."""

import contextlib

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

import loewner
from loewner import Ellipsoids, GeometryError, InputError, PoseError, paper


def random_ellipsoids(rng, count, dim=3, thinnest=0.05):
    """Centers normal, factors general: random axes, semi-axes log-uniform in [thinnest, 1], a random right turn."""
    turns = np.linalg.qr(rng.normal(size=(2, count, dim, dim)))[0]
    semi_axes = np.exp(rng.uniform(np.log(thinnest), 0.0, size=(count, dim)))
    return Ellipsoids(rng.normal(size=(count, dim)), (turns[0] * semi_axes[:, None, :]) @ turns[1])


def random_pose(rng):
    T = np.eye(4)
    T[:3, :3] = Rotation.random(rng=rng).as_matrix()
    T[:3, 3] = rng.normal(size=3)
    return T


@pytest.fixture
def ellipsoids(rng):
    return random_ellipsoids(rng, 50)


def test_factor_and_shape_matrix_describe_the_same_set(ellipsoids):
    """An ellipsoid made again from its shape matrix has the same shape matrix and semi-axes."""
    again = Ellipsoids.from_shape_matrix(ellipsoids.center, ellipsoids.shape_matrix)
    np.testing.assert_allclose(again.shape_matrix, ellipsoids.shape_matrix, rtol=1e-12, atol=1e-15)
    np.testing.assert_allclose(again.semi_axes, ellipsoids.semi_axes, rtol=1e-9)


@pytest.mark.parametrize("dim", [1, 2, 3, 5])
def test_semi_axes_and_rotation_rebuild_the_ellipsoid(rng, dim):
    """Semi-axes are in falling order, and with the rotation they make the same ellipsoid again."""
    E = random_ellipsoids(rng, 20, dim)
    assert E.dim == dim
    assert (np.diff(E.semi_axes, axis=-1) <= 0).all()
    np.testing.assert_allclose(np.linalg.det(E.rotation), 1.0)
    again = Ellipsoids.from_semi_axes(E.center, E.semi_axes, E.rotation)
    np.testing.assert_allclose(again.shape_matrix, E.shape_matrix, atol=1e-14)


def test_volume_of_ball_disc_and_interval():
    """V = 4/3 pi abc, pi ab, 2a."""
    assert Ellipsoids.from_semi_axes([0, 0, 0], [3, 2, 1]).volume == pytest.approx(8 * np.pi)
    assert Ellipsoids.from_semi_axes([0, 0], [3, 2]).volume == pytest.approx(6 * np.pi)
    assert Ellipsoids.from_semi_axes([0], [3]).volume == pytest.approx(6)
    tiny = Ellipsoids.from_semi_axes(np.zeros(3), np.full(3, 1e-150))
    assert tiny.log_volume == pytest.approx(np.log(4 * np.pi / 3) + 3 * np.log(1e-150))


def test_support_beats_every_point_of_the_ellipsoid(ellipsoids, rng):
    """The support point lies on the surface and nothing in E is farther along the direction."""
    u = rng.normal(size=(300, 1, 3))
    u /= np.linalg.norm(u, axis=-1, keepdims=True)
    points = ellipsoids.center + np.einsum("kij,skj->ski", ellipsoids.factor, np.broadcast_to(u, (300, 50, 3)))
    directions = rng.normal(size=(50, 3))
    best = ellipsoids.support(directions)
    assert (np.einsum("ki,ski->sk", directions, points) <= (directions * best).sum(-1) + 1e-12).all()
    level = np.linalg.norm(np.linalg.solve(ellipsoids.factor, (best - ellipsoids.center)[..., None])[..., 0], axis=-1)
    np.testing.assert_allclose(level, 1.0, rtol=1e-12)


@given(level=st.floats(0.0, 2.0), seed=st.integers(0, 1000))
def test_contains_by_level(level, seed):
    """c + F u lies in E exactly if |u| <= 1."""
    rng = np.random.default_rng(seed)
    E = random_ellipsoids(rng, 1)[0]
    u = rng.normal(size=3)
    point = E.center + E.factor @ (level * u / np.linalg.norm(u))
    if abs(level - 1) > 1e-12:
        assert E.contains(point) == (level < 1)


def test_bounding_box_is_tight(ellipsoids):
    """The bounding box ends at the support points along the axes."""
    low, high = ellipsoids.bounding_box()
    for axis in range(3):
        d = np.eye(3)[axis]
        np.testing.assert_allclose(high[:, axis], ellipsoids.support(d)[:, axis], rtol=1e-12)
        np.testing.assert_allclose(low[:, axis], ellipsoids.support(-d)[:, axis], rtol=1e-12)


def test_motion_moves_points_along(ellipsoids, rng):
    """x in E exactly if T x in T E; volume and semi-axes stay."""
    T = random_pose(rng)
    moved = ellipsoids.transformed(T)
    points = rng.normal(size=(200, 1, 3))
    assert (moved.contains(points @ T[:3, :3].T + T[:3, 3]) == ellipsoids.contains(points)).all()
    np.testing.assert_allclose(moved.semi_axes, ellipsoids.semi_axes, rtol=1e-12)
    np.testing.assert_allclose(moved.volume, ellipsoids.volume, rtol=1e-12)


def test_motions_compose_and_none_is_the_identity(ellipsoids, rng):
    """Moving by A B is moving by B, then by A; None moves nothing."""
    A, B = random_pose(rng), random_pose(rng)
    once, twice = ellipsoids.transformed(A @ B), ellipsoids.transformed(B).transformed(A)
    np.testing.assert_allclose(once.center, twice.center, atol=1e-13)
    np.testing.assert_allclose(once.factor, twice.factor, atol=1e-13)
    assert (ellipsoids.transformed(None).factor == ellipsoids.factor).all()


def test_affine_image_holds_the_images(rng):
    """x in E exactly if A x + b in the image; the volume grows by |det A|."""
    E = random_ellipsoids(rng, 30, dim=4)
    A, b = rng.normal(size=(4, 4)), rng.normal(size=4)
    image = E.affine(A, b)
    points = rng.normal(size=(200, 1, 4)) * 0.5
    assert (image.contains(points @ A.T + b) == E.contains(points)).mean() > 0.999
    np.testing.assert_allclose(image.volume, abs(np.linalg.det(A)) * E.volume, rtol=1e-10)


def test_batches_index_and_have_lengths(ellipsoids):
    """A batch has a length and can be indexed and sliced; a single ellipsoid has neither."""
    assert len(ellipsoids) == 50
    assert ellipsoids.batch_shape == (50,)
    assert ellipsoids[3].batch_shape == ()
    assert (ellipsoids[3].center == ellipsoids.center[3]).all()
    assert (ellipsoids[10:20].factor == ellipsoids.factor[10:20]).all()
    with pytest.raises(TypeError):
        len(ellipsoids[0])
    with pytest.raises(IndexError):
        ellipsoids[0][0]
    assert "50" in repr(ellipsoids)
    assert "semi_axes" in repr(ellipsoids[0])


def test_results_and_fields_are_read_only_copies():
    """Fields are copies of what was handed in, and cannot be written."""
    center = np.zeros(3)
    E = Ellipsoids(center, np.eye(3))
    center[0] = 5.0
    assert E.center[0] == 0.0
    with pytest.raises(ValueError, match="read-only"):
        E.center[0] = 1.0


@pytest.mark.parametrize(
    ("center", "factor", "error"),
    [
        ([0, 0, np.nan], np.eye(3), InputError),
        ([0, 0, 0], np.diag([1, 1, np.inf]), InputError),
        ([0, 0, 0], np.diag([1.0, 1, 0]), GeometryError),
        ([0, 0], np.eye(3), InputError),
        ([0, 0, 0], np.ones(3), InputError),
        ([], np.zeros((0, 0)), InputError),
        (["a", 0, 0], np.eye(3), InputError),
        ([[0, 0, 0]], np.eye(3), InputError),
    ],
)
def test_bad_ellipsoids_are_refused(center, factor, error):
    """NaN, infinite, singular or misshapen centers and factors are refused."""
    with pytest.raises(error):
        Ellipsoids(center, factor)


def test_bad_shape_matrices_and_semi_axes_are_refused():
    """Shape matrices have to be symmetric positive definite, semi-axes positive, rotations orthogonal."""
    with pytest.raises(GeometryError, match="symmetric"):
        Ellipsoids.from_shape_matrix([0, 0], [[1, 0.5], [0, 1]])
    with pytest.raises(GeometryError, match="positive definite"):
        Ellipsoids.from_shape_matrix([0, 0], [[1, 0], [0, -1]])
    with pytest.raises(InputError, match="square"):
        Ellipsoids.from_shape_matrix([0, 0], [[1, 0, 0], [0, 1, 0]])
    with pytest.raises(GeometryError, match="> 0"):
        Ellipsoids.from_semi_axes([0, 0], [1, -1])
    with pytest.raises(InputError, match="orthogonal"):
        Ellipsoids.from_semi_axes([0, 0], [1, 1], [[1, 1], [0, 1]])


def test_bad_queries_are_refused(ellipsoids):
    """A zero direction, a point of another dimension and a motion that is not rigid are refused."""
    with pytest.raises(InputError, match="non-zero"):
        ellipsoids.support([0, 0, 0])
    with pytest.raises(InputError, match="shape"):
        ellipsoids.contains([0, 0])
    with pytest.raises(PoseError):
        ellipsoids.transformed(2 * np.eye(4))
    with pytest.raises(InputError, match="3-D"):
        Ellipsoids(np.zeros(2), np.eye(2)).transformed(np.eye(4))
    with pytest.raises(GeometryError, match="singular"):
        ellipsoids.affine(np.zeros((3, 3)), np.zeros(3))


def test_empty_batch_gives_empty_answers():
    """A batch without ellipsoids gets answers without entries."""
    none = Ellipsoids(np.zeros((0, 3)), np.zeros((0, 3, 3)))
    assert none.contains([0, 0, 0]).shape == (0,)
    assert none.semi_axes.shape == (0, 3)
    assert len(none.transformed(np.eye(4))) == 0


# -- at the ends of the floats ------------------------------------------------------------------------------------

SIZES = [5e-324, 1e-308, 1e-200, 1e-160, 1e-120, 1.0, 1e120, 1e160, 1e200, 1e307]


# A float holds the ratio of two lengths too.
PAIRS_OF_SIZES = [(a, b) for a in SIZES for b in SIZES if max(a, b, 1) * 1e-250 <= min(a, b, 1)]


@pytest.mark.parametrize(("a", "b"), PAIRS_OF_SIZES)
def test_sizes_at_the_ends_of_the_floats(a: float, b: float):
    """Supports and boxes are right where squares of lengths leave the floats, and nothing warns."""
    E = Ellipsoids.from_semi_axes([0, 0, 0], [a, b, 1.0])
    for direction in np.eye(3) * [[1e-320], [1.0], [1e300]]:
        wanted = (direction > 0) * [a, b, 1.0]
        assert E.support(direction) == pytest.approx(wanted, rel=1e-12, abs=0)
    lower, upper = E.bounding_box()
    assert upper == pytest.approx([a, b, 1.0], rel=1e-12, abs=0)
    assert np.array_equal(lower, -upper)
    assert E.contains([0, 0, 0.5])
    assert not E.contains([0, 0, 1.5])
    assert E.volume >= 0
    assert (E.shape_matrix >= 0).all()


@pytest.mark.parametrize("size", SIZES)
def test_queries_at_the_ends_of_the_floats(size: float):
    """Each answer is right, or there is none: no warning, no answer from numbers that overflowed."""
    E, unit = Ellipsoids.from_semi_axes([0, 0, 0], [size, 1, 1]), Ellipsoids.from_semi_axes([0, 0, 0], [1, 1, 1])
    for query in (
        lambda: loewner.overlap(E, unit),
        lambda: loewner.overlap(unit, E),
        lambda: paper.overlap_by_eigenvalue(E, unit),
        lambda: paper.overlap_by_eigenvalue(unit, E),
        lambda: loewner.near_points(E, unit).distance == 0,
    ):
        with contextlib.suppress(loewner.LoewnerError):
            assert query()


def test_images_beyond_the_floats():
    """An image that no floats can say is an error, not an ellipsoid of infinite or no extent."""
    E = Ellipsoids.from_semi_axes([0, 0, 0], [1e200, 1, 1])
    for A, b in [(np.eye(3) * 1e200, [0, 0, 0]), (np.eye(3) * 5e-324 / 2, [0, 0, 0]), (np.eye(3), [np.inf, 0, 0])]:
        with pytest.raises(loewner.InputError):
            E.affine(A, b)
    with pytest.raises(loewner.GeometryError):
        Ellipsoids.from_semi_axes([0], [1e-300]).affine([[1e-300]], [0])


def test_batches_that_do_not_broadcast():
    """The lengths are named, whichever arguments they are of."""
    E = Ellipsoids.from_semi_axes(np.zeros((2, 3)), [1, 1, 1])
    three = np.tile(np.eye(4), (3, 1, 1))
    for ask in (
        lambda: E.support(np.ones((3, 3))),
        lambda: E.contains(np.ones((3, 3))),
        lambda: E.transformed(three),
        lambda: E.affine(three[:, :3, :3], np.zeros(3)),
        lambda: E.affine(np.eye(3), np.zeros((3, 3))),
        lambda: Ellipsoids.from_semi_axes(np.zeros((2, 3)), np.ones((3, 3))),
        lambda: Ellipsoids.from_semi_axes(np.zeros(3), np.ones((2, 3)), three[:, :3, :3]),
    ):
        with pytest.raises(loewner.InputError, match=r"broadcast.*\(3,\)"):
            ask()


@pytest.mark.parametrize("bad", [7, -3, "a", 1.5, (0, 0), (..., None), {}, [5], np.zeros(3)], ids=repr)
def test_bad_indices(bad: object):
    """Each is a child of IndexError, with which a loop over a batch ends."""
    E = Ellipsoids.from_semi_axes(np.zeros((2, 3)), [1, 1, 1])
    with pytest.raises(loewner.BodyIndexError):
        E[bad]
    assert len(list(E)) == 2
