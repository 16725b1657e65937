"""Largest ellipsoids in high dimension and in many half-spaces, and ellipsoids about given centers."""

from itertools import product

import numpy as np
import pytest

from exact import halfspaces_crossed, points_outside
from families import affine, rotation
from loewner import ConvergenceError, GeometryError, InputError, mvce, mvie
from loewner.ellipsoids import fits
from loewner.ellipsoids.large_fits import inner
from sampling import quick_of


@pytest.fixture
def always_large(monkeypatch: pytest.MonkeyPatch) -> None:
    """Every fit of half-spaces takes the way for many of them."""
    monkeypatch.setattr(fits, "MANY_HALFSPACES", 0.0)


def moved(A: np.ndarray, b: np.ndarray, M: np.ndarray, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The half-spaces of {M x + t : A x <= b}."""
    rows = np.linalg.solve(M.T, A.T).T
    return rows, b + rows @ t


def nearest(A: np.ndarray, b: np.ndarray, fit: fits.Fit, count: int) -> np.ndarray:
    """The half-spaces that the ellipsoid is nearest to, or cuts: where rounding decides."""
    reach = np.linalg.norm(A @ fit.ellipsoid.factor, axis=1)
    return np.argsort((b - A @ fit.ellipsoid.center) / reach)[:count]


def solid(name: str, n: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
    """Half-spaces, and the center and log |det factor| of the ellipsoid inside."""
    if name == "simplex":
        # About the centroid: n + 1 unit normals whose sum is zero, all at distance 1; the inscribed ball.
        corners = np.eye(n + 1) - 1 / (n + 1)
        basis = np.linalg.svd(corners)[2][:n]
        normals = corners @ basis.T
        return normals / np.linalg.norm(normals, axis=1)[:, None], np.ones(n + 1), np.zeros(n), 0.0
    if name == "box":
        half = rng.uniform(0.3, 3, size=n)
        far = rng.normal(size=(5 * n, n))
        far *= rng.uniform(0.1, 0.8, size=(5 * n, 1)) / np.linalg.norm(far * half, axis=1)[:, None]
        A = np.concatenate([np.eye(n) / half[:, None], -np.eye(n) / half[:, None], far])
        return A, np.ones(len(A)), np.zeros(n), float(np.log(half).sum())
    # The ball's tangents: with enough of them, each axis among them, nothing larger is inside. n (n + 1) / 2 weights
    # suffice for the identity to be a sum of squares; those of the axes are.
    A = rng.normal(size=(20 * n, n))
    A /= np.linalg.norm(A, axis=1)[:, None]
    return np.concatenate([np.eye(n), -np.eye(n), A]), np.ones(22 * n), np.zeros(n), 0.0


@pytest.mark.parametrize("n", [2, 3, 10, *(pytest.param(n, marks=pytest.mark.verify) for n in (50, 100))])
@pytest.mark.parametrize("name", ["simplex", "box", "ball"])
@pytest.mark.usefixtures("always_large")
def test_closed_forms_under_affine_maps(name: str, n: int, rng: np.random.Generator) -> None:
    """Volume and center are the mapped closed forms, to 1e-8, and never is the volume off by more than the gap says."""
    A, b, center, log_det = solid(name, n, rng)
    M, t = affine(rng, n)
    order = rng.permutation(len(A))
    A, b = moved(A[order], b[order], M, t)
    fit = mvie(A, b, tol=1e-8)
    error = log_det + np.linalg.slogdet(M)[1] - np.linalg.slogdet(fit.ellipsoid.factor)[1]
    assert -1e-11 * n <= error <= fit.gap + 1e-11 * n
    assert fit.gap <= 1e-8
    assert np.linalg.norm(np.linalg.solve(fit.ellipsoid.factor, fit.ellipsoid.center - M @ center - t)) < 1e-3


@pytest.mark.usefixtures("always_large")
def test_the_cross_polytope_holds_a_ball(rng: np.random.Generator) -> None:
    """All 1,024 faces of the cross-polytope in dimension 10 touch the ball of radius 1 / √10."""
    A = np.array(list(product([-1.0, 1.0], repeat=10)))
    M, t = affine(rng, 10)
    fit = mvie(*moved(A, np.ones(1024), M, t), tol=1e-8)
    assert abs(np.linalg.slogdet(fit.ellipsoid.factor)[1] - np.linalg.slogdet(M)[1] + 5 * np.log(10)) < 1e-8


@pytest.mark.parametrize(("n", "m"), [(3, 60), (10, 300), pytest.param(50, 1500, marks=pytest.mark.verify)])
@pytest.mark.parametrize("about", [False, True])
@pytest.mark.usefixtures("always_large")
def test_the_ellipsoid_is_inside_exactly(n: int, m: int, about: bool, rng: np.random.Generator) -> None:
    """In rational arithmetic, of the half-spaces nearest to the boundary, after a turn and far from the origin."""
    t = np.full(n, 100.0)
    A, b = moved(rng.normal(size=(m, n)), rng.uniform(1, 2, size=m), affine(rng, n)[0], t)
    fit = mvie(A, b, tol=1e-6, center=t if about else None)
    near = nearest(A, b, fit, 20)
    assert halfspaces_crossed(A[near], b[near], fit.ellipsoid.center, fit.ellipsoid.factor) == 0
    if about:
        assert (fit.ellipsoid.center == t).all()


@pytest.mark.parametrize("n", quick_of([4, 15, 40], [4, 15]))
@pytest.mark.usefixtures("always_large")
def test_gap_bounds_the_distance_to_the_optimum(n: int, rng: np.random.Generator) -> None:
    """Loose fits are smaller than a tight one by no more than their gaps, and some are smaller indeed."""
    A, b = rng.normal(size=(40 * n, n)), rng.uniform(1, 3, size=40 * n)
    best = mvie(A, b, tol=1e-8)
    missing = []
    for tol in (1.0, 0.1, 1e-3, 1e-5):
        fit = mvie(A, b, tol=tol)
        missing.append(best.ellipsoid.log_volume - fit.ellipsoid.log_volume)
        assert -best.gap <= missing[-1] <= fit.gap <= tol
    assert max(missing) > 1e-6


@pytest.mark.parametrize("n", [2, 5, 8, 14])
@pytest.mark.parametrize("m", [40, 3000])
def test_both_ways_agree(m: int, n: int, rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch) -> None:
    """The kernel for low dimension and the working set find the same ellipsoid."""
    A, b = moved(rng.normal(size=(m, n)), rng.uniform(1, 2, size=m), *affine(rng, n))
    found = []
    for many in (np.inf, 0.0):
        monkeypatch.setattr(fits, "MANY_HALFSPACES", many)
        found.append(mvie(A, b, tol=1e-8).ellipsoid)
    a, b = found
    assert abs(a.log_volume - b.log_volume) <= 1e-8
    assert np.linalg.norm(np.linalg.solve(a.factor, a.center - b.center)) < 1e-3


HARD = {
    "one face close": lambda rng, n: (
        np.concatenate([rng.normal(size=(20 * n, n)), np.eye(n)[:1]]),
        np.concatenate([np.ones(20 * n), [1e-6]]),
    ),
    "scales of 1 to 1e-6": lambda rng, n: (rng.normal(size=(20 * n, n)) * np.logspace(0, 6, n), np.ones(20 * n)),
    "each face fifty times": lambda rng, n: (np.repeat(rng.normal(size=(10 * n, n)), 50, axis=0), np.ones(500 * n)),
    "n + 1 faces, some again": lambda rng, n: (
        solid("simplex", n, rng)[0][np.arange(3 * n + 1) % (n + 1)],
        np.ones(3 * n + 1),
    ),
    "around a sphere": lambda rng, n: (solid("ball", n, rng)[0][2 * n :], np.ones(20 * n)),
    "many around a sphere": lambda rng, n: (
        np.concatenate([solid("ball", n, rng)[0] for _ in range(40)]),
        np.ones(880 * n),
    ),
    "nearest faces on one side": lambda rng, n: (
        np.concatenate([np.abs(rng.normal(size=(60 * n, n))), -np.eye(n), -np.ones((1, n))]),
        np.concatenate([np.full(60 * n, 0.01), np.full(n + 1, 50.0)]),
    ),
    "heavy tails": lambda rng, n: (rng.standard_cauchy(size=(3000, n)), np.ones(3000)),
    "the origin outside": lambda rng, n: moved(
        rng.normal(size=(20 * n, n)), np.ones(20 * n), np.eye(n), np.full(n, 1e3)
    ),
    "rows of all lengths": lambda rng, n: tuple(
        x * s for s in [np.exp(rng.uniform(-20, 20, size=(30 * n, 1)))] for x in (rng.normal(size=(30 * n, n)), 1.0)
    ),
}


@pytest.mark.parametrize("n", [10, *(pytest.param(k, marks=pytest.mark.verify) for k in (2, 30))])
@pytest.mark.parametrize("name", HARD)
@pytest.mark.usefixtures("always_large")
def test_hard_cases(name: str, n: int, rng: np.random.Generator) -> None:
    """Each reaches 1e-5 inside every half-space; in rational arithmetic for those nearest to the boundary."""
    A, b = HARD[name](rng, n)
    b = np.broadcast_to(np.asarray(b).reshape(-1), len(A)) if np.size(b) in (1, len(A)) else b
    fit = mvie(A, b, tol=1e-5)
    assert fit.gap <= 1e-5
    reach = np.linalg.norm(A @ fit.ellipsoid.factor, axis=1)
    assert ((b - A @ fit.ellipsoid.center) / reach).min() >= 1 - 1e-9
    near = nearest(A, b, fit, 5)
    assert halfspaces_crossed(A[near], b[near], fit.ellipsoid.center, fit.ellipsoid.factor) == 0


def test_a_first_set_without_bounds_gets_some(rng: np.random.Generator) -> None:
    """Where the nearest half-spaces are all on one side, those that close the rest are added."""
    n = 6
    R = np.concatenate([np.abs(rng.normal(size=(2000, n))), -1e-3 * np.abs(rng.normal(size=(300, n)))])
    first = inner._first(R)
    assert len(first.index) < len(R)
    assert inner._way_out(R[first.index]) is None
    direction = inner._way_out(R[:2000])
    assert (R[:2000] @ direction <= 1e-9).all()


@pytest.mark.parametrize("n", [3, 12])
def test_a_wrong_guess_is_taken_back(n: int, rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where half-spaces leave that matter, they come back, and in the end none leaves any more."""
    monkeypatch.setattr(fits, "MANY_HALFSPACES", 0.0)
    A, b = rng.normal(size=(3000, n)), rng.uniform(1, 2, size=3000)
    right = mvie(A, b, tol=1e-7)
    monkeypatch.setattr(inner, "FAR", 1e-3)
    monkeypatch.setattr(inner, "CLOSE", 10.0)
    monkeypatch.setattr(inner, "LOSS", 0.9)
    solve, bold = inner._solve, []

    def spied(rows: np.ndarray, x: np.ndarray, active: inner._WorkingSet, *rest: object) -> object:
        bold.append(active.bold)
        return solve(rows, x, active, *rest)

    monkeypatch.setattr(inner, "_solve", spied)
    fit = mvie(A, b, tol=1e-7)
    assert bold[0]
    assert not bold[-1]
    assert abs(fit.ellipsoid.log_volume - right.ellipsoid.log_volume) <= 1e-7


@pytest.mark.parametrize("n", [2, 3, 5, 8])
@pytest.mark.parametrize("rows", ["signs", "whole numbers", "few again and again"])
@pytest.mark.usefixtures("always_large")
def test_rows_that_repeat_change_nothing(rows: str, n: int, rng: np.random.Generator) -> None:
    """Thousands of rows of which few differ: the same ellipsoid as of those that differ, each once."""
    if rows == "signs":
        A = rng.choice([-1.0, 1.0], size=(4000, n))
    elif rows == "whole numbers":
        A = rng.integers(-1, 2, size=(4000, n)).astype(float)
    else:
        few = rng.normal(size=(20 * n, n))
        A = few[rng.integers(20 * n, size=4000)]
    fit = mvie(A, np.ones(4000), tol=1e-8)
    once = np.unique(A, axis=0)
    assert abs(fit.ellipsoid.log_volume - mvie(once, np.ones(len(once)), tol=1e-8).ellipsoid.log_volume) <= 1e-8


@pytest.mark.parametrize(("k", "n"), [(40, 3), (9, 5), (200, 8)])
def test_both_factorisations_solve_the_same_system(
    k: int, n: int, rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Directly and by Woodbury's identity, as the matrix written out."""
    T, diagonal, B = rng.normal(size=(k, n)), rng.uniform(0.1, 2, size=k), rng.normal(size=(k, 2))
    expected = np.linalg.solve(np.diag(diagonal) + (T @ T.T) ** 2, B)
    for largest in (0, 10**6):
        monkeypatch.setattr(inner, "LARGEST_SYSTEM", largest)
        np.testing.assert_allclose(inner._factorised(T, diagonal)(B), expected, rtol=1e-8, atol=1e-10)
        np.testing.assert_allclose(inner._factorised(T, diagonal)(B[:, 0]), expected[:, 0], rtol=1e-8, atol=1e-10)


def test_a_proof_does_not_believe_a_wrong_ellipsoid(rng: np.random.Generator) -> None:
    """One too large is scaled down; one that is not the largest has the gap it has; a center outside proves nothing."""
    A, b = np.concatenate([np.eye(4), -np.eye(4)]), np.ones(8)
    factor, gap = inner.proven(A, b, np.zeros(4), 3.0 * np.eye(4), np.r_[np.ones(8)])
    assert halfspaces_crossed(A, b, np.zeros(4), factor) == 0
    assert 0 <= gap < 1e-12
    flat = np.diag([0.5, 1, 1, 1])
    assert np.log(2) <= inner.proven(A, b, np.zeros(4), flat, np.ones(8))[1] < 2
    shifted = inner.proven(A, b, np.array([0.5, 0, 0, 0]), np.diag([0.5, 1, 1, 1]), np.ones(8))[1]
    assert np.log(2) <= shifted < 2
    assert inner.proven(A, b, np.array([2.0, 0, 0, 0]), np.eye(4), np.ones(8))[1] == np.inf
    assert inner.proven(A, b, np.zeros(4), np.eye(4), np.r_[np.ones(4), np.zeros(4)])[1] == np.inf


# -- about a given center -------------------------------------------------------------------------


@pytest.mark.parametrize("n", quick_of([1, 2, 5, 20, 60], [1, 2, 5, 20]))
def test_about_a_center_reflections_change_nothing(n: int, rng: np.random.Generator) -> None:
    """The smallest ellipsoid about c is the one around the points and their reflections, of which c is the center."""
    points, c = rng.normal(size=(8 * n, n)) @ affine(rng, n)[0].T, rng.normal(size=n)
    about = mvce(points, tol=1e-8, center=c)
    both = mvce(np.concatenate([points, 2 * c - points]), tol=1e-8)
    assert (about.ellipsoid.center == c).all()
    assert abs(about.ellipsoid.log_volume - both.ellipsoid.log_volume) <= 2e-8
    assert about.ellipsoid.log_volume >= mvce(points, tol=1e-8).ellipsoid.log_volume - 1e-8
    assert points_outside(points[:5], c, about.ellipsoid.factor) == 0


@pytest.mark.parametrize("n", [2, 10, 40])
def test_about_a_center_the_weights_are_a_design_without_constant(n: int, rng: np.random.Generator) -> None:
    """Second moments with these weights are the shape matrix over n (Kiefer and Wolfowitz)."""
    points = rng.normal(size=(10 * n, n)) + 2
    fit = mvce(points, tol=1e-8, center=0, weights=True)
    y = np.linalg.solve(fit.ellipsoid.factor, points.T).T
    assert np.abs(n * (y * fit.weights[:, None]).T @ y - np.eye(n)).max() < 1e-3


def test_about_a_center_n_points_are_enough() -> None:
    """A parallelogram from half its corners; a flat through the center is an error, one beside it is none."""
    np.testing.assert_allclose(mvce([[3.0, 0], [0, 1]], center=[0, 0]).ellipsoid.semi_axes, [3, 1], rtol=1e-4)
    np.testing.assert_allclose(mvce([[1.0, 5], [-1, 5]], center=0).ellipsoid.factor.prod(), 0.0, atol=0)
    with pytest.raises(GeometryError, match="on a line"):
        mvce([[1.0, 1], [2, 2], [3, 3]], center=0)
    with pytest.raises(GeometryError, match="at least 3 points in dimension 3"):
        mvce(np.eye(3)[:2], center=0)


@pytest.mark.parametrize("n", [2, 7, 30])
def test_about_its_center_the_largest_is_the_largest(n: int, rng: np.random.Generator) -> None:
    """About the center that the free fit finds, the ellipsoid is the free one; about any other it is smaller."""
    A, b = rng.normal(size=(30 * n, n)), rng.uniform(1, 2, size=30 * n)
    free = mvie(A, b, tol=1e-8)
    there = mvie(A, b, tol=1e-8, center=free.ellipsoid.center)
    assert abs(there.ellipsoid.log_volume - free.ellipsoid.log_volume) <= 2e-8
    elsewhere = mvie(A, b, tol=1e-8, center=0.5 * free.ellipsoid.center + 0.02 / n)
    assert elsewhere.ellipsoid.log_volume < free.ellipsoid.log_volume


def test_about_a_center_one_side_is_enough() -> None:
    """Half-spaces without bounds hold a largest ellipsoid about a point, unless a line is inside; outside none."""
    A = np.array([[1.0, 0], [0, 1]])
    np.testing.assert_allclose(mvie(A, [2.0, 3.0], center=[1, 1]).ellipsoid.semi_axes, [2, 1], rtol=1e-4)
    np.testing.assert_allclose(mvie([[1.0], [2.0], [-1.0]], [3, 5, 7], center=0).ellipsoid.factor, [[2.5]])
    np.testing.assert_allclose(mvce([[1.0], [1.5]], center=-100).ellipsoid.factor, [[101.5]])
    with pytest.raises(GeometryError, match="unbounded"):
        mvie([[1.0, 0], [-1, 0]], [1, 1], center=0)
    with pytest.raises(GeometryError, match="center: expected a point inside every half-space, found row 1"):
        mvie(A, [2.0, 3.0], center=[1, 3])


@pytest.mark.parametrize("bad", [[0, 0, 0], np.nan, "0", [[0, 0]]])
def test_centers_that_are_none(bad: object) -> None:
    """Of the wrong length, not finite, not numbers; or without half-spaces."""
    with pytest.raises(InputError, match="center"):
        mvce(np.eye(2), center=bad)
    with pytest.raises(InputError, match="center"):
        mvie(np.eye(2), [1, 1], center=bad)
    with pytest.raises(InputError, match="found no b"):
        mvie([[0, 0], [1, 0], [0, 1]], center=0)


# -- progress, errors -----------------------------------------------------------------------------


def test_progress_rises_to_all(rng: np.random.Generator) -> None:
    """It never falls, ends at 100 percent, and whoever raises in it stops the fit."""

    class StopHere(Exception):
        pass

    def stop(done: int, total: int) -> None:
        raise StopHere

    A, points = rng.normal(size=(2000, 20)), rng.normal(size=(3000, 20))
    calls = (
        lambda progress: mvie(A, np.ones(2000), progress=progress),
        lambda progress: mvie(A, np.ones(2000), center=0, progress=progress),
        lambda progress: mvce(points, progress=progress),
        lambda progress: mvce(points[:, :3], progress=progress),
        lambda progress: mvie(points[:100, :3], progress=progress),
    )
    for call in calls:
        told: list[tuple[int, int]] = []
        call(lambda done, total, told=told: told.append((done, total)))
        done = [d for d, _ in told]
        assert done == sorted(done)
        assert told[-1] == (100, 100)
        with pytest.raises(StopHere):
            call(stop)


@pytest.mark.usefixtures("always_large")
def test_no_polytope_is_an_error(rng: np.random.Generator) -> None:
    """Empty, flat and unbounded ones are named as they are in low dimension."""
    A = rng.normal(size=(600, 12))
    with pytest.raises(GeometryError, match="unbounded"):
        mvie(np.c_[A, np.zeros(600)], np.ones(600))
    with pytest.raises(GeometryError, match="unbounded"):
        mvie(np.abs(A), np.ones(600))
    with pytest.raises(GeometryError, match="empty"):
        mvie(np.r_[A, -A[:1]], np.r_[np.ones(600), -2.0])
    with pytest.raises(GeometryError, match="flat"):
        mvie(np.r_[A, A[:1], -A[:1]], np.r_[np.ones(600), 0.5, -0.5])


@pytest.mark.usefixtures("always_large")
def test_a_gap_out_of_reach_is_an_error(rng: np.random.Generator) -> None:
    """A turned sheet of aspect 1e-8 in dimension 20 has no eleven digits to give."""
    A = np.concatenate([np.eye(20), -np.eye(20)]) / np.r_[1e-8, np.ones(19)] @ rotation(rng, 20)
    with pytest.raises(ConvergenceError, match="reached a gap of"):
        mvie(A, np.ones(40), tol=1e-11)
