"""Two ellipsoids: overlap, contact function, near points, and the paper's estimate f."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation

from loewner import (
    ConvergenceError,
    Ellipsoids,
    InputError,
    UnknownNameError,
    contact_function,
    near_points,
    overlap,
)
from loewner._kernels import codes
from loewner._kernels.ellipsoids import contact_robust
from loewner._kernels.ellipsoids import near_points as kernel
from loewner._native import entries
from loewner.paper import distance_estimate, overlap_by_eigenvalue
from oracles import exact_ellipsoid_verdict
from sampling import quick

METHODS = ["lin-han", "rimon-boyd", "center-line"]


def ball(center, radius):
    return Ellipsoids.from_semi_axes(center, [radius] * 3)


def random_ellipsoids(rng, count, thinnest=0.1, spread=1.0):
    R = Rotation.random(count, rng=rng).as_matrix()
    semi_axes = np.exp(rng.uniform(np.log(thinnest), 0.0, size=(count, 3)))
    return Ellipsoids(rng.normal(size=(count, 3)) * spread, R * semi_axes[:, None, :])


def random_pairs(rng, count, thinnest=0.1, spread=1.0):
    """Pairs whose centers are some `spread` apart."""
    return random_ellipsoids(rng, count, thinnest, spread), random_ellipsoids(rng, count, thinnest, spread)


def level(E, x):
    """|F⁻¹(x - c)|: 1 on the surface."""
    return np.linalg.norm(np.linalg.solve(E.factor, (x - E.center)[..., None])[..., 0], axis=-1)


def outward_normal(E, x):
    G = np.linalg.inv(E.factor)
    w = np.einsum("...ji,...jk,...k->...i", G, G, x - E.center)
    return w / np.linalg.norm(w, axis=-1, keepdims=True)


def angle_between(a, b):
    return 2 * np.arcsin(np.clip(np.linalg.norm(a - b, axis=-1) / 2, 0, 1))


# -- overlap and the contact function --------------------------------------------------------------


@given(st.floats(0.01, 5), st.floats(0.01, 5), st.floats(0, 10))
def test_contact_function_of_spheres(p, q, distance):
    """F = (d / (p + q))²."""
    F = contact_function(ball([0, 0, 0], p), ball([0, 0, distance], q))
    np.testing.assert_allclose(F, (distance / (p + q)) ** 2, rtol=1e-9, atol=1e-15)


def test_touching_spheres_overlap():
    """Touching counts, where float64 can say touching."""
    assert overlap(ball([0, 0, 0], 1.0), ball([2, 0, 0], 1.0))
    assert not overlap(ball([0, 0, 0], 1.0), ball([2 + 1e-9, 0, 0], 1.0))
    assert overlap(ball([0, 0, 0], 1.0), ball([0, 0, 0], 3.0))


def test_contact_function_along_a_common_axis():
    """Ellipsoids with parallel axes, offset along one of them: F = (d / (a1 + a2))²."""
    A = Ellipsoids.from_semi_axes([1, 2, 3], [0.5, 2, 1])
    B = Ellipsoids.from_semi_axes([1, 2, 6.5], [3, 1, 0.25])
    assert contact_function(A, B) == pytest.approx((3.5 / 1.25) ** 2)


@pytest.mark.parametrize("thinnest", [0.5, 0.1, 0.02])
def test_appendix_a_agrees_with_the_contact_function(rng, thinnest):
    """The paper's eigenproblem and Perram-Wertheim decide alike."""
    A, B = random_pairs(rng, 2000, thinnest, spread=0.4)
    by_contact = overlap(A, B)
    assert 0.05 < by_contact.mean() < 0.95
    assert (overlap_by_eigenvalue(A, B) == by_contact).all()


def test_appendix_a_holds_far_apart_and_one_inside_the_other(rng):
    """The eigenvalue test is right for ellipsoids far apart and for one inside the other."""
    A = random_ellipsoids(rng, 200)
    for k in (10.0, 1e3, 1e5):
        B = Ellipsoids(A.center + k * np.array([0.6, 0.0, 0.8]), A.factor[::-1])
        assert not overlap_by_eigenvalue(A, B).any()
    small = Ellipsoids(A.center, 1e-3 * A.factor[::-1])
    assert overlap_by_eigenvalue(A, small).all()
    assert overlap_by_eigenvalue(small, A).all()


@pytest.mark.parametrize("dim", [1, 2, 4])
def test_appendix_a_in_other_dimensions(rng, dim):
    """Of two balls F = (d / (p + q))² in any dimension, and overlap is affine-invariant."""
    n = 500
    p, q = rng.uniform(0.1, 1, size=(2, n, 1))
    a, b = rng.normal(size=(2, n, dim))
    A, B = Ellipsoids(a, p[..., None] * np.eye(dim)), Ellipsoids(b, q[..., None] * np.eye(dim))
    M, t = rng.normal(size=(dim, dim)) + 2 * np.eye(dim), rng.normal(size=dim)
    truth = np.linalg.norm(a - b, axis=1) <= (p + q)[:, 0]
    assert (overlap_by_eigenvalue(A, B) == truth).all()
    assert (overlap_by_eigenvalue(A.affine(M, t), B.affine(M, t)) == truth).all()


def test_appendix_a_refuses_where_its_digits_are_gone(rng):
    """Needles and discs break the eigenproblem: an error, never a wrong answer."""
    A, B = random_pairs(rng, 3000, thinnest=1e-4, spread=0.1)
    with pytest.raises(ConvergenceError, match=r"loewner\.overlap"):
        overlap_by_eigenvalue(A, B)
    answered = 0
    truth = overlap(A, B)
    for k in range(300):
        try:
            answer = overlap_by_eigenvalue(A[k], B[k])
        except ConvergenceError:
            continue
        answered += 1
        assert answer == truth[k]
    assert answered > 100


def test_scaling_by_root_f_makes_them_touch(rng):
    """F is homogeneous of degree -2 in the ellipsoids' size."""
    A, B = random_pairs(rng, 500)
    F = contact_function(A, B)
    grow = np.sqrt(F)[:, None, None]
    np.testing.assert_allclose(
        contact_function(Ellipsoids(A.center, grow * A.factor), Ellipsoids(B.center, grow * B.factor)), 1.0, rtol=1e-9
    )


@pytest.mark.parametrize("thinnest", [0.3, 1e-3, 1e-6])
def test_contact_function_is_symmetric_and_affine_invariant(rng, thinnest):
    """The contact function changes neither with the order of the pair nor under an affine map of both."""
    A, B = random_pairs(rng, 500, thinnest)
    F = contact_function(A, B)
    # The rounding of the factors' own entries moves F by a rounding of the squared axis ratio.
    own = 1e-15 / thinnest**2
    np.testing.assert_allclose(contact_function(B, A), F, rtol=1e-8 + own)
    M = Rotation.random(rng=rng).as_matrix() * [1.0, 3.0, 0.2]
    np.testing.assert_allclose(
        contact_function(A.affine(M, [0, 0, 0]), B.affine(M, [0, 0, 0])), F, rtol=1e-7 + 10 * own
    )


@pytest.mark.parametrize("thinnest", [1e-5, pytest.param(0.3, marks=pytest.mark.verify)])
@pytest.mark.parametrize("count", quick(70, 500))
def test_fast_and_careful_paths_agree(rng, thinnest, monkeypatch, count):
    """The polynomial path is taken only where it is as good as the diagonal one."""
    A, B = random_pairs(rng, count, thinnest)
    for a, b in zip(A, B, strict=True):
        F1, F2 = tuple(a.factor.ravel()), tuple(b.factor.ravel())
        value, s = contact_robust.contact_of_pair(F1, F2, tuple(b.center - a.center))
        K = (1 - s) * a.shape_matrix + s * b.shape_matrix
        r = b.center - a.center
        here = s * (1 - s) * (r @ np.linalg.solve(K, r))
        assert value == pytest.approx(here, rel=1e-6)
        for t in (0.9 * s, s + 0.1 * (1 - s)):  # a maximum: no value beside it is above
            K = (1 - t) * a.shape_matrix + t * b.shape_matrix
            assert t * (1 - t) * (r @ np.linalg.solve(K, r)) <= value * (1 + 1e-6)


@pytest.mark.parametrize("count", quick(24, 60))
def test_overlap_against_rational_arithmetic(rng, count):
    """Pairs scaled to within 1e-7 of touching: the sign agrees with exact rational arithmetic."""
    A, B = random_pairs(rng, count)
    grow = np.sqrt(contact_function(A, B) * rng.choice([1 - 1e-7, 1 + 1e-7], size=count))[:, None, None]
    A, B = Ellipsoids(A.center, grow * A.factor), Ellipsoids(B.center, grow * B.factor)
    found = overlap(A, B)
    assert count / 6 < found.sum() < 5 * count / 6
    for k in range(count):
        exact = exact_ellipsoid_verdict(A.center[k], A.factor[k], None, B.center[k], B.factor[k], None)
        assert exact == (-1 if found[k] else 1)


def test_batches_broadcast(rng):
    """Batches of ellipsoids broadcast as arrays do, empty ones included."""
    A, B = random_pairs(rng, 6)
    table = Ellipsoids(A.center.reshape(6, 1, 3), A.factor.reshape(6, 1, 3, 3))
    for overlaps in (overlap, overlap_by_eigenvalue):
        found = overlaps(table, B)
        assert found.shape == (6, 6)
        assert (np.diag(found) == overlaps(A, B)).all()
        assert np.shape(overlaps(A[0], B[0])) == ()
    near = near_points(table, B)
    assert near.point_1.shape == (6, 6, 3)
    assert near.distance.shape == near.iterations.shape == (6, 6)
    none = Ellipsoids(np.zeros((0, 3)), np.zeros((0, 3, 3)))
    for overlaps in (overlap, overlap_by_eigenvalue):
        assert overlaps(none, A[0]).shape == (0,)
    assert near_points(none, A[0]).distance.shape == (0,)


# -- near points -----------------------------------------------------------------------------------


@pytest.mark.parametrize("method", METHODS)
@given(st.floats(0.1, 2), st.floats(0.1, 2), st.floats(0.01, 50))
def test_near_points_of_spheres(method, p, q, gap):
    """All three rules agree on spheres: on the line of centers, p and q from them."""
    d = p + q + gap
    near = near_points(ball([1, 1, 1], p), ball([1, 1 + d, 1], q), method=method)
    assert near.distance == pytest.approx(gap, rel=1e-9)
    np.testing.assert_allclose(near.point_1, [1, 1 + p, 1], atol=1e-12 * d)
    np.testing.assert_allclose(near.point_2, [1, 1 + d - q, 1], atol=1e-12 * d)


def test_near_points_along_a_common_axis():
    """Every method finds the near points of two ellipsoids whose poles face each other."""
    A = Ellipsoids.from_semi_axes([0, 0, 0], [0.5, 2, 1])
    B = Ellipsoids.from_semi_axes([0, 0, 4], [3, 1, 0.25])
    for method in METHODS:
        near = near_points(A, B, method=method)
        np.testing.assert_allclose(near.point_1, [0, 0, 1], atol=1e-12)
        np.testing.assert_allclose(near.point_2, [0, 0, 3.75], atol=1e-12)


def slow_distance(A, B):
    """Minimise |x - y|² over two unit balls by SLSQP."""

    def gap(z):
        return A.center + A.factor @ z[:3] - B.center - B.factor @ z[3:]

    def gradient(z):
        w = gap(z)
        return 2 * np.concatenate([A.factor.T @ w, -B.factor.T @ w])

    found = minimize(
        lambda z: gap(z) @ gap(z),
        np.zeros(6),
        jac=gradient,
        method="SLSQP",
        constraints=[
            {"type": "ineq", "fun": lambda z: 1 - z[:3] @ z[:3], "jac": lambda z: np.r_[-2 * z[:3], 0, 0, 0]},
            {"type": "ineq", "fun": lambda z: 1 - z[3:] @ z[3:], "jac": lambda z: np.r_[0, 0, 0, -2 * z[3:]]},
        ],
        options={"maxiter": 500, "ftol": 1e-15},
    )
    return np.sqrt(found.fun)


def test_lin_han_against_a_slow_reference(rng):
    """The Lin-Han distance is the one that a slow reference finds."""
    A, B = random_pairs(rng, 60, thinnest=0.2, spread=1.5)
    near = near_points(A, B, angle=1e-9)
    for k in range(60):
        assert near.distance[k] == pytest.approx(slow_distance(A[k], B[k]), rel=1e-5, abs=1e-4)


@pytest.mark.parametrize("thinnest", [0.3, 0.05, 1e-3, 1e-6])
@pytest.mark.parametrize("angle", [0.01, 1e-8])
def test_lin_han_keeps_its_angle_and_its_certificate(rng, thinnest, angle):
    """On both surfaces, normals within `angle` of the line; the supporting planes bound the distance from below."""
    A, B = random_pairs(rng, 1000, thinnest, spread=1.2)
    near = near_points(A, B, angle=angle)
    apart = ~overlap(A, B)
    if angle < 1e-3:
        assert ((near.distance > 0) == apart).all()
    assert (near.distance[~apart] < 0.05).all()
    A, B, d = A[apart], B[apart], near.distance[apart]
    x, y = near.point_1[apart], near.point_2[apart]
    np.testing.assert_allclose(np.linalg.norm(y - x, axis=1), d, rtol=1e-9, atol=1e-14)
    # Thin factors amplify the rounding of a point in its level.
    np.testing.assert_allclose(level(A, x), 1.0, atol=1e-13 / thinnest)
    np.testing.assert_allclose(level(B, y), 1.0, atol=1e-13 / thinnest)
    e = (y - x) / d[:, None]
    # The normal of a rounded point is uncertain by a rounding times the squared axis ratio.
    seen = angle + 1e-14 / thinnest**2 / np.minimum(d, 1)
    assert (angle_between(e, outward_normal(A, x)) <= seen).all()
    assert (angle_between(-e, outward_normal(B, y)) <= seen).all()
    lower = (e * (B.support(-e) - A.support(e))).sum(axis=1)
    assert (lower <= d * (1 + 1e-12)).all()
    assert (d - lower <= 4 * angle + 1e-12).all()


def test_tighter_angles_never_lengthen_the_distance_by_much(rng):
    """The distance at any angle is at least the best one, and at most twice the angle longer."""
    A, B = random_pairs(rng, 500, spread=1.2)
    best = near_points(A, B, angle=1e-10).distance
    for angle in (0.1, 0.01, 1e-4):
        d = near_points(A, B, angle=angle).distance
        # A shallow overlap that a wide angle does not see is a small distance; what is apart is never shorter.
        assert (d >= best * (1 - 1e-9)).all()
        assert (d - best <= 2 * angle).all()


def test_rimon_boyd_point_is_where_level_surfaces_touch_first(rng):
    """No point of E1 lies on a lower level of E2 than the near point; normals are opposite there."""
    A, B = random_pairs(rng, 300, spread=1.2)
    near = near_points(A, B, method="rimon-boyd")
    apart = ~overlap(A, B)
    assert ((near.distance > 0) == apart).all()
    A, B, x, y = A[apart], B[apart], near.point_1[apart], near.point_2[apart]
    u = rng.normal(size=(500, 1, 3))
    u /= np.linalg.norm(u, axis=-1, keepdims=True)
    for E, other, point in ((A, B, x), (B, A, y)):
        np.testing.assert_allclose(level(E, point), 1.0, rtol=1e-10)
        samples = E.center + np.einsum("kij,skj->ski", E.factor, np.broadcast_to(u, (500, len(E), 3)))
        assert (level(other, samples) >= level(other, point) * (1 - 1e-12)).all()
        # At the touching point the two level surfaces share a tangent plane.
        np.testing.assert_allclose(outward_normal(E, point), -outward_normal(other, point), atol=1e-6)


def test_appendix_a_point_is_the_rimon_boyd_point(rng):
    """The 6x6 eigenproblem of the paper and the secular equation give one point."""
    A, B = random_pairs(rng, 50, thinnest=0.3, spread=1.5)
    for a, b in zip(A, B, strict=True):
        if level(b, a.center) <= 1:
            continue
        # "a scaled E1 touches E2": the point of E2 on the lowest level of E1.
        Q, P = a.shape_matrix, np.linalg.inv(b.shape_matrix)
        w, U = np.linalg.eigh(Q)
        root, inverse_root = (U / np.sqrt(w)) @ U.T, (U * np.sqrt(w)) @ U.T
        B_bar = inverse_root @ P @ inverse_root
        w, U = np.linalg.eigh(B_bar)
        b_bar = root @ (b.center - a.center)
        b_tilde = (U / np.sqrt(w)) @ U.T @ b_bar
        B_tilde = np.linalg.inv(B_bar)
        lam = min(np.linalg.eigvals(np.block([[B_tilde, -np.eye(3)], [-np.outer(b_tilde, b_tilde), B_tilde]])).real)
        point = a.center + lam * inverse_root @ np.linalg.solve(lam * np.eye(3) - B_tilde, b_bar)
        x, _ = kernel.touch(tuple(b.factor.ravel()), tuple(np.linalg.inv(a.factor).ravel()), tuple(a.center - b.center))
        np.testing.assert_allclose(b.center + x, point, atol=1e-6)


def test_center_line_points_lie_on_the_segment(rng):
    """Center-line points lie on the segment of the centers, on the surfaces of ellipsoids that it finds apart."""
    A, B = random_pairs(rng, 300, spread=1.5)
    near = near_points(A, B, method="center-line")
    apart = near.distance > 0
    r = B.center - A.center
    t = ((near.point_1 - A.center) * r).sum(1) / (r * r).sum(1)
    np.testing.assert_allclose(near.point_1, A.center + t[:, None] * r, atol=1e-12)
    np.testing.assert_allclose(level(A, near.point_1)[apart], 1.0, rtol=1e-10)
    np.testing.assert_allclose(level(B, near.point_2)[apart], 1.0, rtol=1e-10)
    # Its overlaps are proven by a point; the other way round it can miss some.
    assert (overlap(A, B)[~apart]).all()


@pytest.mark.parametrize("method", METHODS)
def test_overlapping_pairs_give_a_common_point(rng, method):
    """At distance zero both near points are one point, and it is in both ellipsoids."""
    A, B = random_pairs(rng, 500, spread=0.1)
    near = near_points(A, B, method=method)
    found = near.distance == 0
    assert found.sum() > 300
    assert (near.point_1[found] == near.point_2[found]).all()
    assert (level(A, near.point_1)[found] <= 1 + 1e-9).all()
    assert (level(B, near.point_1)[found] <= 1 + 1e-9).all()


@pytest.mark.parametrize("method", ["rimon-boyd", "center-line"])
def test_no_rule_is_nearer_than_the_nearest(rng, method):
    """The other rules never give a smaller distance than the exact one."""
    A, B = random_pairs(rng, 1000, thinnest=0.02, spread=1.2)
    best = near_points(A, B, angle=1e-9).distance
    assert (near_points(A, B, method=method).distance >= best * (1 - 1e-9)).all()


@pytest.mark.parametrize("method", METHODS)
def test_swap_offset_and_scale_change_nothing(rng, method):
    """(b, a) mirrors (a, b); an offset of 1e6 m costs its own rounding only; scales of 1e±6 and beyond cost nothing."""
    A, B = random_pairs(rng, 200, spread=1.5)
    near, F = near_points(A, B, method=method), contact_function(A, B)
    back = near_points(B, A, method=method)
    apart = near.distance > 1e-3
    np.testing.assert_allclose(back.distance, near.distance, rtol=1e-9 if method != "lin-han" else 1e-3, atol=1e-12)
    if method != "lin-han":
        np.testing.assert_allclose(back.point_1[apart], near.point_2[apart], atol=1e-9)
    for scale in (1e-6, 1e6, 1e-100, 1e100):
        a, b = Ellipsoids(scale * A.center, scale * A.factor), Ellipsoids(scale * B.center, scale * B.factor)
        np.testing.assert_allclose(near_points(a, b, method=method).distance / scale, near.distance, rtol=1e-9)
        np.testing.assert_allclose(contact_function(a, b), F, rtol=1e-9)
    shift = np.array([1e6, -1e6, 1e6])
    a, b = Ellipsoids(A.center + shift, A.factor), Ellipsoids(B.center + shift, B.factor)
    # Only the shifted centers themselves are rounded, by about 1e-10.
    np.testing.assert_allclose(near_points(a, b, method=method).distance[apart], near.distance[apart], atol=1e-7)
    np.testing.assert_allclose(contact_function(a, b), F, rtol=1e-7)
    assert (overlap(a, b) == overlap(A, B))[np.abs(F - 1) > 1e-6].all()


def test_rigid_motion_moves_the_near_points(rng):
    """A rigid motion of both ellipsoids moves their near points along and keeps the distance."""
    A, B = random_pairs(rng, 100, spread=1.5)
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = Rotation.random(rng=rng).as_matrix(), rng.normal(size=3)
    for method in METHODS:
        near, moved = near_points(A, B, method=method), near_points(A.transformed(T), B.transformed(T), method=method)
        np.testing.assert_allclose(moved.point_1, near.point_1 @ T[:3, :3].T + T[:3, 3], atol=1e-9)
        np.testing.assert_allclose(moved.distance, near.distance, atol=1e-9)


def test_needles_that_nearly_touch_end(rng):
    """Aspect 1e-8, gaps down to 1e-12: every call returns, and the distance is right to rounding."""
    for gap in (1.0, 1e-6, 1e-12):
        A = Ellipsoids.from_semi_axes([0, 0, 0], [1, 1e-8, 1e-8])
        B = Ellipsoids.from_semi_axes([2 + gap, 0, 0], [1, 1e-8, 1e-8])
        assert near_points(A, B, angle=1e-8).distance == pytest.approx(gap, rel=1e-3)
        plate = Ellipsoids.from_semi_axes([0, 0, 1e-8 + gap + 1], [1, 1, 1])
        flat = Ellipsoids.from_semi_axes([0, 0, 0], [1, 1, 1e-8])
        assert near_points(flat, plate, angle=1e-8).distance == pytest.approx(gap, rel=1e-3)


@pytest.mark.parametrize("thinnest", [0.1, 1e-2, 1e-4, 1e-6])
@pytest.mark.parametrize("gap", [0.0, 1e-15, 1e-13, 1e-11, 1e-9, 1e-6, 1e-3])
def test_pairs_that_nearly_touch_converge_to_the_gap(rng, thinnest, gap):
    """Common tangent planes a known gap apart: no exception, and the gap comes back to rounding."""
    A, B = random_ellipsoids(rng, 300, thinnest), random_ellipsoids(rng, 300, thinnest)
    d = rng.normal(size=(300, 3))
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    B = Ellipsoids(B.center - B.support(-d) + A.support(d) + gap * d, B.factor)
    # The last entry: what the rounded centers and factors of thin ellipsoids are uncertain by.
    np.testing.assert_allclose(near_points(A, B, angle=1e-9).distance, gap, rtol=1e-9, atol=1e-12)
    coarse = near_points(A, B).distance
    assert (coarse >= gap * (1 - 1e-9) - 1e-12).all()
    assert (coarse <= gap + 0.01).all()


@pytest.mark.parametrize("method", METHODS)
def test_coincident_ellipsoids(method):
    """An ellipsoid overlaps itself, at distance zero."""
    A = Ellipsoids.from_semi_axes([1, 2, 3], [1, 0.5, 0.2])
    near = near_points(A, A, method=method)
    assert near.distance == 0
    assert A.contains(near.point_1)
    assert overlap(A, A)
    assert overlap_by_eigenvalue(A, A)


# -- the estimate f --------------------------------------------------------------------------------


def printed_f(inner_1, outer_1, inner_2, outer_2, method):
    """The paper's formula with its two branches, from near points and quadratic equations."""
    near = near_points(inner_1, inner_2, method=method)
    v1i, v2i = near.point_1, near.point_2

    def hit(E, start, toward):
        e = toward - start
        p, q = np.linalg.solve(E.factor, start - E.center), np.linalg.solve(E.factor, e)
        return start + max(np.roots([q @ q, 2 * p @ q, p @ p - 1]).real) * e

    v1c, v2c = hit(outer_1, v1i, v2i), hit(outer_2, v2i, v1i)
    near_part, far_part = np.linalg.norm(v1i - v2i), np.linalg.norm(v1c - v2c)
    return (near_part + far_part) / 2 if (v1i - v2i) @ (v1c - v2c) >= 0 else (near_part - far_part) / 2


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("d", [8.0, 3.5, 2.5, 2.0, 0.5, 0.0])
def test_f_of_concentric_balls(method, d):
    """Inner radius 1, outer 1.5: f = d - 2.5 in all three cases of section 4, through L = 0 and beyond."""
    inner, outer = ball([0, 0, 0], 1), ball([0, 0, 0], 1.5)
    there = (ball([0, 0, d], 1), ball([0, 0, d], 1.5))
    expected = d - 2.5 if d >= 2 else -0.5 - (2 - d) / 2
    assert distance_estimate(inner, outer, *there, method) == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("count", quick(100, 300))
def test_f_is_the_printed_formula_in_both_branches(rng, method, count):
    """The kernel's f is the formula as the paper prints it, in either branch."""
    I1, I2 = random_pairs(rng, count, thinnest=0.3, spread=1.5)
    branches = set()
    for a, b in zip(I1, I2, strict=True):
        near = near_points(a, b, method=method)
        if near.distance == 0:
            continue
        # Outer ellipsoids that hold the inner ones: grown about a shifted center.
        k1, k2 = rng.uniform(1.3, 2.5, size=2)
        u1, u2 = rng.normal(size=(2, 3))
        u1, u2 = 0.9 * (k1 - 1) * u1 / np.linalg.norm(u1), 0.9 * (k2 - 1) * u2 / np.linalg.norm(u2)
        outer_1 = Ellipsoids(a.center + a.factor @ u1, k1 * a.factor)
        outer_2 = Ellipsoids(b.center + b.factor @ u2, k2 * b.factor)
        expected = printed_f(a, outer_1, b, outer_2, method)
        assert distance_estimate(a, outer_1, b, outer_2, method) == pytest.approx(expected, abs=1e-9)
        branches.add(expected > near.distance / 2)
    assert branches == {True, False}


@pytest.mark.parametrize("method", METHODS)
def test_f_is_never_positive_when_the_inner_ellipsoids_overlap(rng, method):
    """The estimate f is at most zero where the inner ellipsoids overlap."""
    I1, I2 = random_pairs(rng, 200, spread=0.1)
    for a, b in zip(I1, I2, strict=True):
        if near_points(a, b, method=method).distance > 0:
            continue
        grown = [Ellipsoids(E.center, 1.4 * E.factor) for E in (a, b)]
        value = distance_estimate(a, grown[0], b, grown[1], method)
        assert value <= 0


@pytest.mark.parametrize("method", ["rimon-boyd", "center-line"])
def test_f_is_positive_when_the_line_misses_the_outer_overlap(method):
    """An empty intersection along the line just makes f positive; alpha >= beta then."""
    inner, outer = ball([0, 0, 0], 1), ball([0, 0, 0], 1.2)
    there = (ball([3, 0, 0], 1), ball([3, 0, 0], 1.2))
    assert distance_estimate(inner, outer, *there, method) == pytest.approx((1 + 0.6) / 2)


def four(rng, count):
    """Inner and outer ellipsoids of pairs of pieces, the outer ones around the inner ones."""
    a, b = random_pairs(rng, count, thinnest=0.3, spread=1.5)
    return a, Ellipsoids(a.center, 1.6 * a.factor), b, Ellipsoids(b.center, 1.6 * b.factor)


@pytest.mark.parametrize("method", METHODS)
def test_f_knows_no_frame(rng, method):
    """A rigid motion changes nothing, nor, where the inner ellipsoids are apart, does the order of the pieces.

    Lin-Han's points depend on the order by as much as its angle allows.
    """
    E = four(rng, 200)
    apart = near_points(E[0], E[2], method=method).distance > 0
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = Rotation.random(rng=rng).as_matrix(), rng.normal(size=3)
    value = distance_estimate(*E, method)
    assert value.shape == (200,)
    np.testing.assert_allclose(distance_estimate(*(x.transformed(T) for x in E), method), value, atol=1e-9)
    swapped = distance_estimate(E[2], E[3], E[0], E[1], method)
    np.testing.assert_allclose(swapped[apart], value[apart], atol=1e-2 if method == "lin-han" else 1e-9)


def test_batches_of_f_broadcast(rng):
    """One piece against many, none of them, and a single pair give arrays of the batch's shape."""
    a, outer_a, b, outer_b = four(rng, 6)
    value = distance_estimate(a[0], outer_a[0], b, outer_b)
    assert value.shape == (6,)
    for k in range(6):
        assert distance_estimate(a[0], outer_a[0], b[k], outer_b[k]) == value[k]
    assert distance_estimate(a[:0], outer_a[:0], b[0], outer_b[0]).shape == (0,)
    assert np.shape(distance_estimate(a[0], outer_a[0], b[0], outer_b[0])) == ()


# -- bad input -------------------------------------------------------------------------------------


def test_bad_input_is_refused(rng):
    """Operands of other types, dimensions or batch shapes, and unknown methods, are refused by name."""
    A = random_ellipsoids(rng, 3)
    disc = Ellipsoids(np.zeros(2), np.eye(2))
    for call in (overlap, contact_function, near_points):
        with pytest.raises(InputError, match="Ellipsoids"):
            call(A, np.eye(3))
        with pytest.raises(InputError, match="3-D"):
            call(disc, disc)
        with pytest.raises(InputError, match="one dimension"):
            call(A, disc)
        with pytest.raises(InputError, match="broadcast"):
            call(A, random_ellipsoids(rng, 2))
    with pytest.raises(UnknownNameError, match="lin-han"):
        near_points(A, A, method="nearest")
    with pytest.raises(InputError, match="outer_2: expected loewner.Ellipsoids"):
        distance_estimate(A, A, A, np.eye(3))
    with pytest.raises(InputError, match="inner_1: expected ellipsoids in 3-D"):
        distance_estimate(disc, disc, disc, disc)
    with pytest.raises(InputError, match="broadcast"):
        distance_estimate(A, A, A, random_ellipsoids(rng, 2))
    for angle in (0.0, -1.0, np.nan, np.inf, "wide"):
        with pytest.raises(InputError, match="angle"):
            near_points(A, A, angle=angle)
    far = Ellipsoids([1.7e308, 0, 0], np.eye(3)), Ellipsoids([-1.7e308, 0, 0], np.eye(3))
    with pytest.raises(InputError, match="infinite"):
        contact_function(*far)


def test_ratios_beyond_float64_are_an_error_not_a_number():
    """Sizes too far apart for float64 give a finite number or a ConvergenceError."""
    speck, giant = ball([0, 0, 0], 1e-200), ball([2e200, 0, 0], 1e200)
    for call in (contact_function, near_points, lambda a, b: distance_estimate(a, a, b, b)):
        try:
            value = call(speck, giant)
        except ConvergenceError:
            continue
        assert np.isfinite(getattr(value, "distance", value))


def test_a_pair_that_does_not_converge_is_an_error(monkeypatch, rng):
    """Pairs that do not converge raise a ConvergenceError that tells how many of them there are."""
    A, B = random_pairs(rng, 4)

    def stuck(*arguments):
        arguments[-1][:] = [0, codes.UNCONVERGED, 0, codes.UNCONVERGED]

    monkeypatch.setattr(entries, "near_points_of_pairs", stuck)
    with pytest.raises(ConvergenceError, match="2 of 4"):
        near_points(A, B)
