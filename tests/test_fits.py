"""Löwner–John fits: closed forms, certificates, containment, laws, and every bad input by itself."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from exact import halfspaces_crossed, hull_planes, points_outside
from families import affine, polygon, rotation
from loewner import ConvergenceError, GeometryError, InputError, mvce, mvie
from loewner.ellipsoids import fits, polytopes
from loewner.paper import mvce_by_lifted_mvie

TIGHT = 1e-9


def ball_points(rng: np.random.Generator, count: int, n: int = 3) -> np.ndarray:
    x = rng.normal(size=(count, n))
    return x / np.linalg.norm(x, axis=1, keepdims=True) * rng.uniform(size=(count, 1)) ** (1 / n)


def signs(n: int) -> np.ndarray:
    return np.array(np.meshgrid(*[[-1.0, 1.0]] * n)).reshape(n, -1).T


def fit_one(points: np.ndarray, tol: float) -> tuple[np.ndarray, ...]:
    """Hull and both fits of one 3-D piece by the batched way: vertices, normals and the six results."""
    h = polytopes.hulls([points])
    result = fits.fit_pieces(h.vert_start, h.vertices, h.face_start, h.normals, tol)
    return h.vertices, h.normals, *(r[0] for r in result)


# -- closed forms ---------------------------------------------------------------------------------


def closed_forms() -> dict[str, tuple[np.ndarray, tuple, tuple]]:
    """Points, then center and semi-axes (along the axes) of the inner and of the outer ellipsoid."""
    forms = {}
    zero = np.zeros(3)
    for n in (2, 3, 4, 5):
        forms[f"box {n}"] = signs(n), (np.zeros(n), np.ones(n)), (np.zeros(n), np.full(n, np.sqrt(n)))
        cross = np.concatenate([np.eye(n), -np.eye(n)])
        forms[f"cross {n}"] = cross, (np.zeros(n), np.full(n, 1 / np.sqrt(n))), (np.zeros(n), np.ones(n))
    for k in (3, 4, 5, 8, 17):
        r, H = np.cos(np.pi / k), 0.7
        ring = polygon(k)
        prism = np.concatenate([np.c_[ring, np.full(k, z)] for z in (-H, H)])
        outer = [np.sqrt(1.5), np.sqrt(1.5), np.sqrt(3) * H]
        forms[f"prism {k}"] = prism, (zero, np.array([r, r, H])), (zero, np.array(outer))
        bipyramid = np.concatenate([np.c_[ring, np.zeros(k)], [[0, 0, H], [0, 0, -H]]])
        inner = [r * np.sqrt(2 / 3), r * np.sqrt(2 / 3), H / np.sqrt(3)]
        forms[f"bipyramid {k}"] = bipyramid, (zero, np.array(inner)), (zero, np.array([1, 1, H]))
        pyramid = np.concatenate([np.c_[ring, np.zeros(k)], [[0, 0, H]]])
        center, s8 = np.array([0, 0, H / 4]), 3 / np.sqrt(8)
        inner = [r / np.sqrt(2), r / np.sqrt(2), H / 4]
        forms[f"pyramid {k}"] = pyramid, (center, np.array(inner)), (center, np.array([s8, s8, 0.75 * H]))
    return forms


CLOSED_FORMS = closed_forms()


@pytest.mark.parametrize("name", CLOSED_FORMS)
def test_closed_forms_under_affine_maps(name: str, rng: np.random.Generator) -> None:
    """Fits follow affine maps: center and shape matrix of both are the mapped closed forms, to 1e-8."""
    points, (inner_c, inner_axes), (outer_c, outer_axes) = CLOSED_FORMS[name]
    n = points.shape[1]
    for _ in range(3):
        A, b = affine(rng, n)
        moved = rng.permutation(np.concatenate([points, points[:3]]) @ A.T + b)
        inner, outer = mvie(moved, tol=TIGHT), mvce(moved, tol=TIGHT)
        for fit, c, axes in ((inner, inner_c, inner_axes), (outer, outer_c, outer_axes)):
            assert fit.gap <= TIGHT
            Q = A @ np.diag(axes**2) @ A.T
            # Compared where the ellipsoid is the unit ball: a relative error in every direction.
            unit = np.linalg.inv(np.linalg.cholesky(Q))
            assert np.abs(unit @ fit.ellipsoid.shape_matrix @ unit.T - np.eye(n)).max() < 1e-4
            assert np.abs(unit @ (fit.ellipsoid.center - A @ c - b)).max() < 1e-4
            volume = 0.5 * np.linalg.slogdet(Q)[1]
            found = np.linalg.slogdet(fit.ellipsoid.factor)[1]
            error = found - volume if fit is outer else volume - found
            assert -1e-12 <= error <= fit.gap + 1e-12


@pytest.mark.parametrize("n", [2, 3, 4, 7])
def test_simplex(n: int, rng: np.random.Generator) -> None:
    """Both ellipsoids of a simplex sit at its centroid, and the inner one is the outer one shrunk by n."""
    points = rng.normal(size=(n + 1, n))
    inner, outer = mvie(points, tol=TIGHT).ellipsoid, mvce(points, tol=TIGHT).ellipsoid
    np.testing.assert_allclose(inner.center, points.mean(axis=0), atol=1e-8)
    np.testing.assert_allclose(outer.center, points.mean(axis=0), atol=1e-8)
    np.testing.assert_allclose(n * inner.factor, outer.factor, atol=1e-7)


@pytest.mark.parametrize("n", range(1, 21))
def test_parallelepiped_in_any_dimension(n: int, rng: np.random.Generator) -> None:
    """From half-spaces alone, the inner ellipsoid of c ± g_i has the volume of G, for n = 1..20."""
    G, c = affine(rng, n)
    A = np.concatenate([np.linalg.inv(G), -np.linalg.inv(G)])
    b = A @ c + 1
    fit = mvie(A, b, tol=TIGHT)
    assert abs(np.linalg.slogdet(fit.ellipsoid.factor)[1] - np.linalg.slogdet(G)[1]) <= 2 * TIGHT
    # The start is the optimum there; off it, with a corner cut off and faces said twice, there is work to do.
    cut = np.concatenate([A, A[:n], [A[:n].sum(axis=0)]]), np.concatenate([b, b[:n], [b[:n].sum() - 0.5 * n]])
    harder = mvie(*cut, tol=TIGHT)
    assert harder.gap <= TIGHT
    assert harder.ellipsoid.log_volume < fit.ellipsoid.log_volume + TIGHT


@pytest.mark.parametrize("n", [1, 2, 3, 6, 11, 20])
def test_cross_polytope_in_any_dimension(n: int, rng: np.random.Generator) -> None:
    """The outer ellipsoid of c ± g_i's cross-polytope is G, by both methods."""
    G, c = affine(rng, n)
    points = np.concatenate([c + G.T, c - G.T, c + 0.4 * ball_points(rng, 30, n) @ G.T / np.sqrt(n)])
    for fitted in (mvce, mvce_by_lifted_mvie):
        fit = fitted(points, tol=TIGHT)
        assert abs(np.linalg.slogdet(fit.ellipsoid.factor)[1] - np.linalg.slogdet(G)[1]) <= 2 * TIGHT


def test_lifted_mvie_agrees_with_the_direct_way(rng: np.random.Generator) -> None:
    """The paper's Appendix B and the dual interior point find the same ellipsoid."""
    for n in (2, 3, 5):
        for _ in range(10):
            points = ball_points(rng, 6 * n, n) @ affine(rng, n)[0].T
            a, b = mvce(points, tol=TIGHT), mvce_by_lifted_mvie(points, tol=TIGHT)
            assert abs(a.ellipsoid.log_volume - b.ellipsoid.log_volume) <= TIGHT
            unit = np.linalg.inv(a.ellipsoid.factor)
            assert np.abs(unit @ (a.ellipsoid.center - b.ellipsoid.center)).max() < 1e-4


# -- containment ----------------------------------------------------------------------------------

SHAPES = {
    "plain": lambda rng, x: x,
    "squashed": lambda rng, x: x * [1, 1e-2, 1e-4] @ rotation(rng, 3).T,
    "paper thin": lambda rng, x: x * [1, 1, 1e-8] @ rotation(rng, 3).T,
    "needle": lambda rng, x: x * [1, 1e-8, 1e-8] @ rotation(rng, 3).T,
    "far away": lambda rng, x: x + 1e6 * rng.normal(size=3),
    "tiny": lambda rng, x: x * 1e-6,
    "huge": lambda rng, x: x * 1e6,
    "on a grid": lambda rng, x: np.round(3 * x),
}


@pytest.mark.parametrize("shape", SHAPES)
def test_containment_is_exact(shape: str, rng: np.random.Generator) -> None:
    """In rational arithmetic: no vertex outside the outer, the inner across no plane of the exact hull; 40 hulls."""
    for _ in range(5):
        points = SHAPES[shape](rng, ball_points(rng, int(rng.integers(8, 20))))
        vertices, _, inner_c, inner_F, outer_c, outer_F, inner_gap, outer_gap = fit_one(points, 1e-4)
        assert points_outside(vertices, outer_c, outer_F) == 0
        assert halfspaces_crossed(*hull_planes(vertices), inner_c, inner_F) == 0
        assert max(inner_gap, outer_gap) <= 1e-4
        assert not np.triu(inner_F, 1).any()
        assert (np.diagonal(inner_F) > 0).all()


def test_mvce_holds_every_point_given_exactly(rng: np.random.Generator) -> None:
    """Not only the hull's vertices: duplicates and interior points too, by both methods, active set included."""
    for count in (5, 40, 400):
        points = ball_points(rng, count) @ affine(rng, 3)[0].T + 10
        for fitted in (mvce, mvce_by_lifted_mvie):
            fit = fitted(points)
            assert points_outside(points, fit.ellipsoid.center, fit.ellipsoid.factor) == 0


def test_mvie_of_halfspaces_is_inside_them_exactly(rng: np.random.Generator) -> None:
    """The rows as given, of any length, not the kernel's scaled ones."""
    for n in (2, 3, 6):
        for _ in range(5):
            A = np.concatenate([rng.normal(size=(4 * n, n)), 0.5 * np.eye(n), -0.5 * np.eye(n)])
            A *= np.exp(rng.uniform(-5, 5, size=(len(A), 1)))
            b = np.linalg.norm(A, axis=1) + A @ np.full(n, 100.0)
            E = mvie(A, b).ellipsoid
            assert halfspaces_crossed(A, b, E.center, E.factor) == 0


# -- laws -----------------------------------------------------------------------------------------

seeds = st.integers(0, 2**32 - 1)


@given(seeds)
def test_affine_equivariance(seed: int) -> None:
    """Moving the points moves both fits: log-volumes change by log |det A|, to the sum of the gaps."""
    rng = np.random.default_rng(seed)
    points = ball_points(rng, int(rng.integers(5, 40)))
    A, b = affine(rng, 3)
    for fit in (mvce, mvie):
        before, after = fit(points, tol=1e-7), fit(points @ A.T + b, tol=1e-7)
        change = after.ellipsoid.log_volume - before.ellipsoid.log_volume - np.linalg.slogdet(A)[1]
        assert abs(change) <= 2e-7


@given(seeds)
def test_order_and_repeats_do_not_matter(seed: int) -> None:
    """Shuffled and repeated points give the same ellipsoids."""
    rng = np.random.default_rng(seed)
    points = ball_points(rng, int(rng.integers(5, 30)))
    again = rng.permutation(np.concatenate([points, points[rng.integers(len(points), size=10)]]))
    for fit in (mvce, mvie):
        a, b = fit(points, tol=TIGHT).ellipsoid, fit(again, tol=TIGHT).ellipsoid
        assert abs(a.log_volume - b.log_volume) <= TIGHT
        np.testing.assert_allclose(a.center, b.center, atol=1e-4)


@given(seeds)
def test_inner_in_piece_in_outer(seed: int) -> None:
    """John's theorem: the outer one shrunk by n is inside the piece, so no larger than the inner one."""
    rng = np.random.default_rng(seed)
    points = ball_points(rng, int(rng.integers(5, 30))) @ affine(rng, 3)[0].T
    vertices, normals, inner_c, inner_F, outer_c, outer_F, _, _ = fit_one(points, 1e-4)
    inner_v, outer_v = (np.linalg.slogdet(F)[1] for F in (inner_F, outer_F))
    assert inner_v < outer_v <= inner_v + 3 * np.log(3) + 2e-4
    # Support of inner <= support of piece <= support of outer, in many directions.
    d = rng.normal(size=(200, 3))
    piece = (vertices @ d.T).max(axis=0)
    size = np.abs(vertices).max() * np.linalg.norm(d, axis=1)
    assert (d @ inner_c + np.linalg.norm(d @ inner_F, axis=1) <= piece + 1e-12 * size).all()
    assert (d @ outer_c + np.linalg.norm(d @ outer_F, axis=1) >= piece - 1e-12 * size).all()


@given(seeds)
def test_halfspaces_and_vertices_agree(seed: int) -> None:
    """`mvie(A, b)` of a hull's faces is `mvie(points)`."""
    rng = np.random.default_rng(seed)
    points = ball_points(rng, int(rng.integers(5, 25))) + rng.normal(size=3)
    piece = polytopes.Polytope.from_points(points)
    a, b = mvie(points, tol=1e-8), mvie(piece.normals, piece.offsets, tol=1e-8)
    assert abs(a.ellipsoid.log_volume - b.ellipsoid.log_volume) <= 1e-8


def test_many_points_take_the_active_set(rng: np.random.Generator) -> None:
    """100,000 points: the gap still bounds the distance to a fit of their hull's vertices alone."""
    points = ball_points(rng, 100_000) * [3, 2, 1]
    fit = mvce(points, tol=1e-8)
    radius = np.linalg.norm(np.linalg.solve(fit.ellipsoid.factor, (points - fit.ellipsoid.center).T), axis=0)
    assert radius.max() <= 1 + 1e-12
    # Only points near the boundary matter: their own fit has the same volume.
    few = mvce(points[radius > 0.9], tol=1e-8)
    assert abs(fit.ellipsoid.log_volume - few.ellipsoid.log_volume) <= 1e-8


def test_batch_equals_one_by_one_on_any_number_of_threads(rng: np.random.Generator) -> None:
    """Blocks and threads change nothing, bit for bit, and progress reaches the total."""
    sets = [ball_points(rng, int(rng.integers(4, 30))) for _ in range(3 * polytopes.BLOCK // 2)]
    h = polytopes.hulls(sets)
    seen: list[tuple[int, int]] = []
    packed = (h.vert_start, h.vertices, h.face_start, h.normals)
    batch = fits.fit_pieces(*packed, progress=lambda done, total: seen.append((done, total)))
    assert seen[-1] == (len(sets), len(sets))
    assert len(seen) > 1
    for i in range(0, len(sets), 150):
        alone = fit_one(sets[i], fits.DEFAULT_TOLERANCE)[2:]
        for one, many in zip(alone, batch, strict=True):
            assert (one == many[i]).all()


# -- bad input ------------------------------------------------------------------------------------

SQUARE = np.array([[1.0, 0], [-1, 0], [0, 1], [0, -1]])

BAD_POINTS = {
    "nan": ([[0, 0], [1, 0], [0, np.nan]], InputError, "finite"),
    "inf": ([[0, 0], [1, 0], [0, np.inf]], InputError, "finite"),
    "no points": (np.empty((0, 3)), GeometryError, "at least 4 points"),
    "no dimension": (np.empty((3, 0)), InputError, "dimension"),
    "one axis": ([1.0, 2.0], InputError, r"shape \(m, n\), found \(2,\)"),
    "too few": ([[0, 0, 0], [1, 0, 0], [0, 1, 0]], GeometryError, "at least 4 points"),
    "text": ([["a", "b"]], InputError, "numbers"),
    "ragged": ([[1, 2], [3]], InputError, "ragged"),
    "too small": (np.eye(4, 3) * 1e-200, InputError, "rescale"),
    "too large": (np.eye(4, 3) * 1e200, InputError, "rescale"),
    "one place": (np.ones((9, 3)), GeometryError, "in one place"),
    "on a line": (np.outer(np.arange(9.0), [1, 2, 3]), GeometryError, "on a line"),
    "in a plane": (np.c_[polygon(9), np.ones(9)] @ [[1, 2, 0], [0.3, 1, 1], [1, 0, 2]], GeometryError, "in a plane"),
    "plane far away": (polygon(9) @ [[1, 2, 1], [0.3, 1, 1]] + 1e6 / 3, GeometryError, "in a plane"),
}


@pytest.mark.parametrize("name", BAD_POINTS)
def test_bad_points_are_named(name: str) -> None:
    """Both fits say what is wrong with points that carry no ellipsoid."""
    points, error, message = BAD_POINTS[name]
    with pytest.raises(error, match=message):
        mvce(points)
    with pytest.raises(error, match=message):
        mvie(points)


BAD_HALFSPACES = {
    "nan": (SQUARE, [1, 1, np.nan, 1], InputError, "finite"),
    "lengths": (SQUARE, [1, 1, 1], InputError, "expected shape"),
    "none": (np.empty((0, 2)), [], InputError, "at least one"),
    "too large": (SQUARE, np.full(4, 1e200), InputError, "rescale"),
    "empty": (SQUARE, [1, -2, 1, 1], GeometryError, "empty: .* by 0.5"),
    "just empty": (SQUARE, [1, -1 - 1e-9, 1, 1], GeometryError, "empty: .* by 5e-10"),
    "impossible row": (np.r_[SQUARE, [[0, 0]]], [1, 1, 1, 1, -1], GeometryError, "empty: row 4"),
    "flat": (SQUARE, [1, -1, 1, 1], GeometryError, "flat"),
    "one half-space": ([[1, 0]], [1], GeometryError, "unbounded"),
    "slab": (SQUARE[:2], [1, 1], GeometryError, "unbounded"),
    "half-strip": (SQUARE[:3], [1, 1, 1], GeometryError, r"unbounded.*\[ *-?0. +-1.\]"),
    "wedge": ([[1, 1], [-1, 1]], [1, 1], GeometryError, "unbounded"),
}


@pytest.mark.parametrize("name", BAD_HALFSPACES)
def test_bad_halfspaces_are_named(name: str) -> None:
    """Empty, flat and unbounded are told apart, with a number or a direction."""
    A, b, error, message = BAD_HALFSPACES[name]
    with pytest.raises(error, match=message):
        mvie(A, b)


@pytest.mark.parametrize(
    ("A", "b", "found"),
    [
        (SQUARE, [1, 1, 1e308, 1], r"row 2 with a largest entry of 1 and the bound 1e\+308"),
        (np.array(SQUARE) * 5e-324, [1, 1, 1, 1], "row 0 with a largest entry of 4.94066e-324 and the bound 1"),
        (np.r_[[[0, 0]], SQUARE], [1, 1, 1, 1e200, 1], r"row 3 with a largest entry of 1 and the bound 1e\+200"),
    ],
)
def test_half_spaces_out_of_range_are_told_as_they_were_given(A: object, b: object, found: str) -> None:
    """The numbers of the message are the caller's, with or without a center, and the row is its row."""
    for options in ({}, {"center": 0}):
        with pytest.raises(InputError, match=found):
            mvie(A, b, **options)


@pytest.mark.parametrize("tol", [0, -1e-4, np.nan, np.inf, 1e-13, 2, "small", None])
def test_bad_tolerance(tol: object) -> None:
    """A tolerance is a number between the rounding of the certificate and one."""
    with pytest.raises(InputError, match="tol"):
        mvce(SQUARE, tol=tol)
    with pytest.raises(InputError, match="tol"):
        mvie(SQUARE, tol=tol)


def test_a_gap_out_of_reach_is_an_error(rng: np.random.Generator) -> None:
    """A turned sheet of aspect 1e-8 has no nine digits to give: the error says how far it came."""
    points = SHAPES["paper thin"](rng, ball_points(rng, 20))
    for fit in (mvce, mvie):
        with pytest.raises(ConvergenceError, match="reached a gap of"):
            fit(points, tol=1e-11)


def test_batch_names_the_piece(rng: np.random.Generator) -> None:
    """A flat piece, a gap out of reach and broken indices are errors that name their place."""
    sets = [ball_points(rng, 12) for _ in range(3)]
    h = polytopes.hulls(sets)
    packed = [h.vert_start, h.vertices.copy(), h.face_start, h.normals]
    with pytest.raises(InputError, match="vert_start"):
        fits.fit_pieces(h.vert_start[::-1], *packed[1:])
    with pytest.raises(InputError, match="face_start"):
        fits.fit_pieces(*packed[:2], h.face_start[[0, -1]], *packed[3:])
    packed[1][h.vert_start[1] : h.vert_start[2], 2] = 0
    with pytest.raises(GeometryError, match="piece 1.*flat"):
        fits.fit_pieces(*packed)
    sets[2] = SHAPES["paper thin"](rng, ball_points(rng, 20))
    h = polytopes.hulls(sets)
    with pytest.raises(ConvergenceError, match="piece 2.*gap"):
        fits.fit_pieces(h.vert_start, h.vertices, h.face_start, h.normals, tol=1e-11)


def test_no_pieces() -> None:
    """An empty batch is a batch."""
    empty = np.zeros(1, int), np.empty((0, 3)), np.zeros(1, int), np.empty((0, 3))
    assert [len(r) for r in fits.fit_pieces(*empty)] == [0] * 6


def test_results_are_frozen() -> None:
    """A fit and its arrays cannot be changed."""
    fit = mvce(SQUARE)
    with pytest.raises(ValueError, match="read-only"):
        fit.ellipsoid.center[0] = 1
    with pytest.raises(AttributeError):
        fit.gap = 0
