"""Smallest ellipsoids in high dimension, and of many points: closed forms, proofs, hard cases, weights."""

import tracemalloc

import numpy as np
import pytest
from scipy.linalg import hadamard

from exact import points_outside
from families import affine, rotation
from loewner import ConvergenceError, GeometryError, InputError, mvce
from loewner._native import entries
from loewner.ellipsoids import fits
from loewner.ellipsoids.large_fits import outer
from loewner.ellipsoids.polytopes import FLATNESS
from sampling import quick, quick_of

DIMENSIONS = (3, 10, 50, 100)


def on_sphere(rng: np.random.Generator, m: int, n: int) -> np.ndarray:
    x = rng.normal(size=(m, n))
    return x / np.linalg.norm(x, axis=1, keepdims=True)


def farthest(points: np.ndarray, fit: fits.Fit, count: int) -> np.ndarray:
    """The points nearest to the boundary, or outside: where rounding decides."""
    y = np.linalg.solve(fit.ellipsoid.factor, (points - fit.ellipsoid.center).T)
    return points[np.argsort(-np.linalg.norm(y, axis=0))[:count]]


def solid(name: str, n: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, float]:
    """Points, and the center and log |det factor| of the ellipsoid around them."""
    if name == "simplex":
        points = np.concatenate([np.zeros((1, n)), np.eye(n)])
        # Its covariance with equal weights is (1 - 1 1ᵀ / (n + 1)) / (n + 1), of determinant (n + 1)^-(n + 1).
        return points, points.mean(axis=0), 0.5 * (n * np.log(n) - (n + 1) * np.log(n + 1))
    if name == "cross":
        return np.concatenate([np.eye(n), -np.eye(n), 0.7 * np.eye(n) / np.sqrt(n)]), np.zeros(n), 0.0
    # Vertices of the cube whose covariance is the identity, and some more: their ellipsoid is the cube's.
    H = hadamard(2 ** int(np.ceil(np.log2(n + 1))))[:, 1 : n + 1].astype(float)
    return np.concatenate([H, -H, rng.choice([-1.0, 1.0], size=(2 * n, n))]), np.zeros(n), 0.5 * n * np.log(n)


@pytest.mark.parametrize("n", DIMENSIONS)
@pytest.mark.parametrize("name", ["simplex", "cube", "cross"])
def test_closed_forms_under_affine_maps(name: str, n: int, rng: np.random.Generator) -> None:
    """Volume and center are the mapped closed forms, to 1e-8, and never is the volume off by more than the gap says."""
    points, center, log_det = solid(name, n, rng)
    A, b = affine(rng, n)
    fit = mvce(rng.permutation(points @ A.T + b), tol=1e-8, weights=True)
    error = np.linalg.slogdet(fit.ellipsoid.factor)[1] - log_det - np.linalg.slogdet(A)[1]
    assert -1e-12 * n <= error <= fit.gap + 1e-12 * n
    assert fit.gap <= 1e-8
    offset = np.linalg.solve(fit.ellipsoid.factor, fit.ellipsoid.center - A @ center - b)
    assert np.linalg.norm(offset) < 2e-4


@pytest.mark.parametrize(("n", "m"), [(3, 200), (10, 100), pytest.param(50, 400, marks=pytest.mark.verify)])
def test_every_point_is_inside_exactly(n: int, m: int, rng: np.random.Generator) -> None:
    """In rational arithmetic, of the points nearest to the boundary, after a turn and far from the origin."""
    points = rng.normal(size=(m, n)) @ affine(rng, n)[0].T + 100.0
    fit = mvce(points, tol=1e-6, weights=True)
    assert points_outside(farthest(points, fit, 20), fit.ellipsoid.center, fit.ellipsoid.factor) == 0


@pytest.mark.parametrize("n", quick_of([4, 15, 40], [4, 15]))
def test_gap_bounds_the_distance_to_the_optimum(n: int, rng: np.random.Generator) -> None:
    """Loose fits are larger than a tight one by no more than their gaps, and some are larger indeed."""
    points = rng.normal(size=(30 * n, n))
    best = mvce(points, tol=1e-8, weights=True)
    excess = []
    for tol in (1.0, 0.1, 1e-3, 1e-5):
        fit = mvce(points, tol=tol, weights=True)
        excess.append(fit.ellipsoid.log_volume - best.ellipsoid.log_volume)
        assert -best.gap <= excess[-1] <= fit.gap <= tol
    assert max(excess) > 1e-6


@pytest.mark.parametrize("n", [5, 8, 14])
@pytest.mark.parametrize("m", [40, 3000])
def test_both_ways_agree(m: int, n: int, rng: np.random.Generator) -> None:
    """The kernel for low dimension and the ascent find the same ellipsoid."""
    points = rng.normal(size=(m, n)) @ affine(rng, n)[0].T
    center, factor = np.empty(n), np.empty((n, n))
    assert entries.fit_outer(points, 1e-8, FLATNESS, center, factor)[0] == 0
    fit = mvce(points, tol=1e-8, weights=True)
    assert abs(np.linalg.slogdet(factor)[1] - np.linalg.slogdet(fit.ellipsoid.factor)[1]) <= 1e-8
    assert np.linalg.norm(np.linalg.solve(factor, center - fit.ellipsoid.center)) < 2e-4


HARD = {
    "one cluster far away": lambda rng, n: np.concatenate(
        [rng.normal(size=(20 * n, n)), 1e6 + 1e-3 * rng.normal(size=(10, n))]
    ),
    "scales of 1 to 1e-6": lambda rng, n: rng.normal(size=(20 * n, n)) * np.logspace(0, -6, n),
    "each point fifty times": lambda rng, n: np.repeat(rng.normal(size=(10 * n, n)), 50, axis=0),
    "n + 1 points": lambda rng, n: rng.normal(size=(n + 1, n)),
    "n + 1 points, some again": lambda rng, n: rng.normal(size=(n + 1, n))[np.arange(2 * n) % (n + 1)],
    "few on a sphere": lambda rng, n: on_sphere(rng, 4 * n, n),
    "many on a sphere": lambda rng, n: on_sphere(rng, 5000, n),
    "in a cube": lambda rng, n: rng.uniform(-1, 1, size=(3000, n)),
    "on a grid": lambda rng, n: np.round(2 * rng.normal(size=(3000, n))),
    "heavy tails": lambda rng, n: rng.standard_cauchy(size=(3000, n)),
    "far from the origin": lambda rng, n: rng.normal(size=(20 * n, n)) + 1e5,
}


@pytest.mark.parametrize("n", quick_of([2, 10, 30], [2, 10]))
@pytest.mark.parametrize("name", HARD)
def test_hard_cases(name: str, n: int, rng: np.random.Generator) -> None:
    """Each reaches 1e-5 with every point inside; in rational arithmetic for those nearest to the boundary."""
    points = HARD[name](rng, n)
    fit = mvce(points, tol=1e-5, weights=True)
    assert fit.gap <= 1e-5
    y = np.linalg.solve(fit.ellipsoid.factor, (points - fit.ellipsoid.center).T)
    assert np.linalg.norm(y, axis=0).max() <= 1 + 1e-8
    assert points_outside(farthest(points, fit, 5), fit.ellipsoid.center, fit.ellipsoid.factor) == 0


def test_points_left_out_do_not_matter(rng: np.random.Generator) -> None:
    """Of 100,000 points few may touch: a fit of those near the boundary alone has the same volume, to the gaps."""
    points = rng.normal(size=(100_000, 15))
    fit = mvce(points, tol=1e-7)
    radii = np.linalg.norm(np.linalg.solve(fit.ellipsoid.factor, (points - fit.ellipsoid.center).T), axis=0)
    assert radii.max() <= 1 + 1e-12
    few = mvce(points[radii > 0.8], tol=1e-7)
    assert abs(fit.ellipsoid.log_volume - few.ellipsoid.log_volume) <= 1e-7


@pytest.mark.parametrize("n", [3, 12])
def test_a_wrong_guess_is_taken_back(n: int, rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where points are dropped that matter, they come back, and the theorem alone decides from then on."""
    points = rng.uniform(-1, 1, size=(20_000, n))
    right = mvce(points, tol=1e-7, weights=True)
    theorem = outer._least_of_support
    guesses = []

    def wrong(largest: float, N: int, bold: bool) -> float:
        guesses.append(bold)
        return N * (1 - 1e-4) if bold else theorem(largest, N, bold)

    monkeypatch.setattr(outer, "_least_of_support", wrong)
    fit = mvce(points, tol=1e-7, weights=True)
    assert abs(fit.ellipsoid.log_volume - right.ellipsoid.log_volume) <= 1e-7
    assert guesses[0]
    assert not guesses[-1]


def test_theorem_keeps_the_support() -> None:
    """All points of a simplex have weight at the optimum: none is below the bound, whatever its weight; guesses err."""
    guesses_err = False
    for n in (2, 10, 40):
        for share in (0.1, 0.2, 0.5, 0.9):
            # One point has this weight, the others the rest: w is the inverse of the weight.
            largest, least = n / (1 - share), 1 / share
            largest, least = max(largest, least), min(largest, least)
            assert least >= outer._least_of_support(largest, n + 1, False)
            guesses_err |= least < outer._least_of_support(largest, n + 1, True)
    assert guesses_err  # so that the theorem is needed


def test_temporary_memory_is_a_part_of_the_points(rng: np.random.Generator) -> None:
    """300,000 points in dimension 15 are fitted in less than half the memory that they take."""
    points = rng.normal(size=(300_000, 15))
    mvce(points[:100])
    tracemalloc.start()
    try:
        mvce(points)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < 0.5 * points.nbytes


def test_ascent_alone_gets_there(rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where too many points matter for the interior point's matrix, the ascent reaches the tolerance by itself."""
    points = on_sphere(rng, 500, 6)
    with monkeypatch.context() as patch:
        patch.setattr(outer, "LARGEST_SYSTEM", 20)
        patch.setattr(outer, "_interior_point", None)
        alone = mvce(points, tol=1e-5, weights=True)
    both = mvce(points, tol=1e-8, weights=True)
    assert abs(alone.ellipsoid.log_volume - both.ellipsoid.log_volume) <= 1e-5


@pytest.mark.parametrize("n", [1, 2, 5, 30, 60])
def test_weights_reproduce_the_ellipsoid(n: int, rng: np.random.Generator) -> None:
    """Weights are >= 0 with sum 1; the mean they give is the center, their covariance the shape matrix over n."""
    points = rng.normal(size=(20 * n + 5, n)) @ affine(rng, n)[0].T + 3
    fit = mvce(points, tol=1e-8, weights=True)
    u = fit.weights
    assert u.shape == (len(points),)
    assert u.min() >= 0
    assert abs(u.sum() - 1) < 1e-12
    y = np.linalg.solve(fit.ellipsoid.factor, (points - fit.ellipsoid.center).T).T
    assert np.linalg.norm(u @ y) < 1e-3
    assert np.abs(n * (y * u[:, None]).T @ y - np.eye(n)).max() < 1e-3
    # Weight is on the boundary only.
    assert np.linalg.norm(y[u > 1e-6], axis=1).min() > 1 - 1e-3
    with pytest.raises(ValueError, match="read-only"):
        u[0] = 1


def test_weights_are_of_the_points_in_their_order(rng: np.random.Generator) -> None:
    """Of a square with its middle, in any order, the corners have a quarter each."""
    order = rng.permutation(5)
    points = np.array([[1.0, 1], [1, -1], [-1, 1], [-1, -1], [0, 0]])[order]
    u = mvce(points, tol=1e-10, weights=True).weights
    np.testing.assert_allclose(u, np.where(order == 4, 0.0, 0.25), atol=1e-5)
    assert mvce(points).weights is None
    assert mvce(rng.normal(size=(50, 20))).weights is None
    with pytest.raises(InputError, match="weights"):
        mvce(points, weights=[1.0] * 5)


@pytest.mark.parametrize("count", quick(100, 300))
def test_triangles_are_enclosed_however_their_last_bits_fall(rng: np.random.Generator, count: int) -> None:
    """Where the proof's error is a few roundings, scaling by it must not be lost in rounding: fits in the plane."""
    for k in range(count):
        points = rng.standard_cauchy(size=(4 + k % 6, 2))
        fit = mvce(points, tol=1e-6, weights=True)
        assert points_outside(points, fit.ellipsoid.center, fit.ellipsoid.factor) == 0


def test_flat_points_are_named(rng: np.random.Generator) -> None:
    """A flat of any dimension is an error that says so; one point beside it, which no sample sees, is enough."""
    points = rng.normal(size=(5000, 12)) @ rng.normal(size=(12, 20))
    with pytest.raises(GeometryError, match="in a flat of dimension 12"):
        mvce(points)
    with pytest.raises(GeometryError, match="in one place"):
        mvce(np.ones((400, 20)))
    sheet = rng.normal(size=(5000, 20))
    sheet[:, 7] = 0.0
    with pytest.raises(GeometryError, match="in a flat of dimension 19"):
        mvce(sheet)
    sheet[1234, 7] = 0.01
    assert 1234 not in outer._spaced(5000, 10 * 21)
    assert mvce(sheet).ellipsoid.semi_axes.min() < 0.1


def test_a_gap_out_of_reach_is_an_error(rng: np.random.Generator) -> None:
    """A turned sheet of aspect 1e-8 in dimension 20 has no eleven digits to give."""
    sheet = rng.normal(size=(200, 20)) * np.r_[1e-8, np.ones(19)] @ rotation(rng, 20)
    with pytest.raises(ConvergenceError, match="reached a gap of"):
        mvce(sheet, tol=1e-11)


def test_read_only_points_are_taken_as_they_are(rng: np.random.Generator) -> None:
    """No copy, no change, the same answer."""
    points = rng.normal(size=(2000, 20))
    a = mvce(points)
    points.setflags(write=False)
    b = mvce(points)
    assert (a.ellipsoid.factor == b.ellipsoid.factor).all()
