"""Long proofs of the fits: exact containment on 500 hulls, real solids at 1e-9, a conic solver, dimensions to 20."""

import numpy as np
import pytest

from exact import halfspaces_crossed, hull_planes, points_outside
from loewner import mvce, mvie
from loewner.ellipsoids import fits, polytopes
from loewner.paper import mvce_by_lifted_mvie

pytestmark = pytest.mark.verify
TIGHT = 1e-9


def rotation(rng: np.random.Generator, n: int = 3) -> np.ndarray:
    return np.linalg.qr(rng.normal(size=(n, n)))[0]


def ball_points(rng: np.random.Generator, count: int, n: int = 3) -> np.ndarray:
    x = rng.normal(size=(count, n))
    return x / np.linalg.norm(x, axis=1, keepdims=True) * rng.uniform(size=(count, 1)) ** (1 / n)


MAPS = {
    "plain": lambda rng, x: x,
    "squashed": lambda rng, x: x * [1, 1e-2, 1e-4] @ rotation(rng).T,
    "far away": lambda rng, x: x + 1e4 * rng.normal(size=3),
    "tiny": lambda rng, x: x * 1e-6,
}


def test_exact_containment_of_500_hulls(rng: np.random.Generator) -> None:
    """Rational arithmetic over plain, squashed, far and tiny hulls at two tolerances: 0 outside, 0 across."""
    outside = crossed = tried = 0
    for tol in (1e-4, 1e-8):
        for make in MAPS.values():
            sets = [make(rng, ball_points(rng, 20)) for _ in range(63)]
            h = polytopes.hulls(sets)
            inner_c, inner_F, outer_c, outer_F, *_ = fits.fit_pieces(
                h.vert_start, h.vertices, h.face_start, h.normals, tol
            )
            for i in range(len(sets)):
                V = h.vertices[h.vert_start[i] : h.vert_start[i + 1]]
                outside += points_outside(V, outer_c[i], outer_F[i])
                crossed += halfspaces_crossed(*hull_planes(V), inner_c[i], inner_F[i])
                tried += 1
    assert tried >= 500
    assert (outside, crossed) == (0, 0)


@pytest.mark.parametrize("where", MAPS)
def test_named_solids(where: str, rng: np.random.Generator) -> None:
    """All 123 Platonic, Archimedean, Catalan and Johnson solids, certified to 1e-9, contained exactly."""
    from coxeter import families

    solids = {}
    for family in ("PlatonicFamily", "ArchimedeanFamily", "CatalanFamily", "JohnsonFamily"):
        shapes = getattr(families, family)
        solids.update({name: shapes.get_shape(name).vertices for name in shapes.names})
    assert len(solids) == 123
    for name, vertices in solids.items():
        points = MAPS[where](rng, vertices)
        h = polytopes.hulls([points])
        result = fits.fit_pieces(h.vert_start, h.vertices, h.face_start, h.normals, TIGHT)
        inner_c, inner_F, outer_c, outer_F, inner_gap, outer_gap = (r[0] for r in result)
        assert max(inner_gap, outer_gap) <= TIGHT, name
        assert points_outside(h.vertices, outer_c, outer_F) == 0, name
        assert len(h.vertices) == len(vertices), name
        if len(vertices) <= 20:
            assert halfspaces_crossed(*hull_planes(h.vertices), inner_c, inner_F) == 0, name


def conic_log_volumes(points: np.ndarray, A: np.ndarray, b: np.ndarray) -> tuple[float, float]:
    """log det of the optimal inner and outer factors by cvxpy and Clarabel at their tightest."""
    import cvxpy as cp

    n = points.shape[1]
    tight = dict.fromkeys(("tol_gap_abs", "tol_gap_rel", "tol_feas"), 1e-9)
    E, c = cp.Variable((n, n), PSD=True), cp.Variable(n)
    inner = cp.Problem(cp.Maximize(cp.log_det(E)), [cp.norm(E @ A.T, axis=0) + A @ c <= b])
    inner.solve(solver=cp.CLARABEL, **tight)
    H, g = cp.Variable((n, n), PSD=True), cp.Variable(n)
    outer = cp.Problem(cp.Maximize(cp.log_det(H)), [cp.norm(H @ points.T - g[:, None], axis=0) <= 1])
    outer.solve(solver=cp.CLARABEL, **tight)
    return inner.value, -outer.value


def test_certificate_against_a_conic_solver(rng: np.random.Generator) -> None:
    """The gap is never below the true distance from the optimum, and never above the tolerance."""
    for tol in (1e-2, 1e-4, 1e-7):
        for _ in range(8):
            points = ball_points(rng, 20) * [1, 0.6, 0.3] @ rotation(rng).T
            piece = polytopes.Polytope.from_points(points)
            best_inner, best_outer = conic_log_volumes(piece.vertices, piece.normals, piece.offsets)
            inner, outer = mvie(points, tol=tol), mvce(points, tol=tol)
            behind = best_inner - np.linalg.slogdet(inner.ellipsoid.factor)[1]
            above = np.linalg.slogdet(outer.ellipsoid.factor)[1] - best_outer
            accuracy = 1e-7  # what the solver itself is good for
            assert -accuracy <= behind <= inner.gap + accuracy
            assert -accuracy <= above <= outer.gap + accuracy
            assert max(inner.gap, outer.gap) <= tol


@pytest.mark.parametrize("n", range(2, 21))
def test_every_dimension(n: int, rng: np.random.Generator) -> None:
    """Random polytopes with 2n to 8n faces, and clouds, in dimensions 2 to 20, certified to 1e-9."""
    for faces in (2 * n + 1, 4 * n, 8 * n):
        A = np.concatenate([rng.normal(size=(faces, n)), np.eye(n), -np.eye(n)])
        x = rng.normal(size=n)
        fit = mvie(A, A @ x + rng.uniform(0.1, 1, size=len(A)), tol=TIGHT)
        assert fit.gap <= TIGHT
        assert fit.iterations < 40
        cloud = ball_points(rng, faces, n) @ rng.normal(size=(n, n))
        direct, lifted = mvce(cloud, tol=TIGHT), mvce_by_lifted_mvie(cloud, tol=TIGHT)
        assert abs(direct.ellipsoid.log_volume - lifted.ellipsoid.log_volume) <= TIGHT


@pytest.mark.parametrize("n", [2, 3, 10])
@pytest.mark.parametrize("kind", ["normal", "uniform", "sphere", "heavy", "ordered"])
def test_a_million_points(n: int, kind: str, rng: np.random.Generator) -> None:
    """Large clouds of every sort are certified to 1e-7, outliers, shells and sorted data included."""
    m = 1_000_000 if n < 10 else 100_000
    x = rng.normal(size=(m, n))
    if kind == "uniform":
        x = rng.uniform(size=(m, n))
    elif kind == "sphere":
        x /= np.linalg.norm(x, axis=1, keepdims=True)
    elif kind == "heavy":
        x = rng.standard_cauchy(size=(m, n))
    elif kind == "ordered":
        x = x[np.argsort(x[:, 0])]
    fit = mvce(x, tol=1e-7)
    assert fit.gap <= 1e-7
    radius = np.linalg.norm(np.linalg.solve(fit.ellipsoid.factor, (x - fit.ellipsoid.center).T), axis=0)
    assert radius.max() <= 1 + 1e-11


@pytest.mark.parametrize("aspect", [1e-2, 1e-4, 1e-6, 1e-8])
def test_thin_boxes_of_any_turn(aspect: float, rng: np.random.Generator) -> None:
    """A turned 1 : aspect : 1 box: both volumes are right to the gap plus what its own corners lost."""
    box = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, 8).T
    for _ in range(20):
        points = box * [1, aspect, 1] @ rotation(rng).T
        lost = 20 * np.finfo(float).eps / aspect
        inner, outer = mvie(points), mvce(points)
        assert abs(np.linalg.slogdet(inner.ellipsoid.factor)[1] - np.log(aspect)) <= inner.gap + lost
        expected = np.log(aspect) + 1.5 * np.log(3)
        assert abs(np.linalg.slogdet(outer.ellipsoid.factor)[1] - expected) <= outer.gap + lost
        A = np.concatenate([np.eye(3), -np.eye(3)]) @ rotation(rng).T
        direct = mvie(A, np.tile([1, aspect, 1], 2))
        assert abs(np.linalg.slogdet(direct.ellipsoid.factor)[1] - np.log(aspect)) <= direct.gap + lost
