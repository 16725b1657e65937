"""Curves in time are proven as SciPy, controllers and trajectories define them."""

import json
import math
import warnings as warns
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from scipy.interpolate import (
    Akima1DInterpolator,
    BPoly,
    BSpline,
    CubicHermiteSpline,
    CubicSpline,
    PchipInterpolator,
    PPoly,
    make_interp_spline,
)

from families import translation
from loewner import Body, CollisionChecker, FileError, InputError, Robot, Scene, Verdict, plots
from loewner.planners import ControllerPoints, Trajectory, trajectory
from loewner.robots.proofs.courses import configurations
from loewner.robots.proofs.curves import curve_of
from motion_oracle import AFLOAT, example, free_configurations, read_example, ring, steps, written
from sampling import quick

FREE, COLLIDING, AMBIGUOUS = Verdict.FREE, Verdict.COLLIDING, Verdict.AMBIGUOUS


@pytest.fixture(scope="module")
def arm():
    return example("panda_description/urdf/panda.urdf", "panda_description/srdf/panda.srdf")


@pytest.fixture
def checker(arm, rng):
    return CollisionChecker(arm, ring(rng, 10, 0.4, 0.9, 0.25))


def paths(checker, rng, count, corners=5, length=0.4):
    """Paths of free configurations, as an array of shape (count, corners, dof)."""
    rows = [free_configurations(checker, count)]
    for _ in range(corners - 1):
        rows.append(steps(checker.robot, rng, rows[-1], length))
    return np.stack(rows, axis=1)


FORMS = {
    "clamped": lambda t, q: CubicSpline(t, q, bc_type="clamped"),
    "akima": Akima1DInterpolator,
    "pchip": PchipInterpolator,
    "b-spline": lambda t, q: make_interp_spline(t, q, k=3),
    "linear": ControllerPoints,
    "power": lambda t, q: PPoly(CubicSpline(t, q, bc_type="natural").c, t),
}


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("count", quick(15, 40))
def test_curves_against_samples(checker, rng, form, count):
    """No curve that is proven collides at one of 2,000 times, as its own library evaluates it; collisions are such."""
    times = np.array([0.0, 0.7, 1.0, 2.5, 3.0])
    given = [FORMS[form](times, q) for q in paths(checker, rng, count)]
    found = checker.certify_trajectory(given)
    t = np.linspace(times[0], times[-1], 2000)
    for curve, one in zip(given, found, strict=True):
        if form == "linear":
            Q = np.stack([np.interp(t, times, q) for q in curve.positions.T], axis=1)
            at = np.stack([np.interp(one.time, times, q) for q in curve.positions.T])
        else:
            Q, at = curve(t), curve(one.time)
        assert one.verdict != AMBIGUOUS
        assert one.verdict != FREE or not checker.collide(Q).any()
        if one.verdict == COLLIDING:
            assert checker.collide(at)
            assert one.names in checker.checked_pairs
    verdicts = [one.verdict for one in found]
    assert FREE in verdicts
    assert COLLIDING in verdicts


@pytest.mark.filterwarnings("ignore:.*is it in degrees:UserWarning")  # what is drawn knows no limits
@pytest.mark.parametrize("degree", range(1, 8))
def test_courses_are_the_curves(arm, rng, degree):
    """Courses have the values that SciPy computes from powers, Bernstein polynomials and B-splines of any degree."""
    x = np.array([-1.0, 0.5, 0.6, 4.0])
    power = PPoly(rng.normal(size=(degree + 1, 3, 8)), x)
    for k in (1, 2):  # continuous
        power.c[-1, k] = power(x[k] - 1e-13)
    knots = np.concatenate([np.full(degree + 1, -1.0), [0.0, 0.25, 0.25, 2.0], np.full(degree + 1, 3.0)])
    knots = knots if degree > 2 else np.delete(knots, degree + 2)
    spline = BSpline(knots, rng.normal(size=(len(knots) - degree - 1, 8)), degree)
    for given in (power, BPoly.from_power_basis(power), spline):
        curve = curve_of(arm, given, "curve")
        for k, course in enumerate(curve.courses):
            share = rng.random(20)
            t = curve.times[k] + share * (curve.times[k + 1] - curve.times[k])
            values = configurations(arm, np.broadcast_to(course, (20, *course.shape)), share)
            assert values == pytest.approx(given(t), rel=1e-9, abs=1e-9)


BALL = '<collision><geometry><sphere radius="0.05"/></geometry></collision>'
SLIDES = "".join(
    f'<joint name="s{k}" type="prismatic"><parent link="l{k}"/><child link="l{k + 1}"/><axis xyz="{axis}"/>'
    f'<limit lower="-9" upper="9"/></joint><link name="l{k + 1}">{"" if k < 3 else BALL}</link>'
    for k, axis in enumerate(("1 0 0", "0 1 0", "0 0 1", "1 1 1"))
)


@pytest.fixture(scope="module")
def slides():
    """Four joints that slide, and a ball at the end."""
    return Robot.from_urdf(text=f'<robot name="slides"><link name="l0"/>{SLIDES}</robot>')


def of_pieces(kind, c, t, axis):
    """A curve of coefficients of shape (degree + 1, pieces, dof), which are given with time on an axis."""
    return kind(np.moveaxis(c, 2, 0) if axis else c, t, axis=axis)


# Each makes a curve of SciPy from times, and values whose times lie on an axis.
OF_SCIPY = {
    "cubic": lambda t, q, axis: CubicSpline(t, q, axis=axis),
    "periodic": lambda t, q, axis: CubicSpline(t, closed(q, axis), axis=axis, bc_type="periodic"),
    "hermite": lambda t, q, axis: CubicHermiteSpline(t, q, 0.3 * q, axis=axis),
    "akima": lambda t, q, axis: Akima1DInterpolator(t, q, axis=axis),
    "pchip": lambda t, q, axis: PchipInterpolator(t, q, axis=axis),
    "linear b-spline": lambda t, q, axis: make_interp_spline(t, q, k=1, axis=axis),
    "cubic b-spline": lambda t, q, axis: make_interp_spline(t, q, k=3, axis=axis),
    "periodic b-spline": lambda t, q, axis: make_interp_spline(
        t, closed(q, axis), k=3, axis=axis, bc_type="periodic"
    ),
    "own knots": lambda t, q, axis: BSpline([*t[:1], *t, *t[-1:]], q, 1, axis=axis),
    "powers": lambda t, q, axis: of_pieces(PPoly, CubicSpline(t, q, axis=axis).c, t, axis),
    "bernstein": lambda t, q, axis: of_pieces(BPoly, BPoly.from_power_basis(CubicSpline(t, q, axis=axis)).c, t, axis),
}  # fmt: skip


def closed(q, axis):
    q = q.copy()
    np.moveaxis(q, axis, 0)[-1] = np.moveaxis(q, axis, 0)[0]
    return q


@pytest.mark.parametrize("extrapolate", [True, False, "periodic"])
@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("form", OF_SCIPY)
def test_courses_are_the_values_of_scipy_on_every_axis(slides, rng, form, axis, extrapolate):
    """What is proven is the curve as SciPy evaluates it at a time, also if its coefficients are a square or a cube."""
    for count in (4, 5):  # so many coefficients of a B-spline, or one polynomial less, as there are joints
        t = np.cumsum(rng.uniform(0.5, 2.0, count)) - 3.0
        q = rng.normal(size=(count, 4) if axis == 0 else (4, count))
        given = OF_SCIPY[form](t, q, axis)
        given.extrapolate = extrapolate
        curve = curve_of(slides, given, "curve")
        assert curve.times[[0, -1]].tolist() == t[[0, -1]].tolist()
        for k, course in enumerate(curve.courses):
            for share in (0.0, *rng.random(5)):
                at = curve.times[k] + share * (curve.times[k + 1] - curve.times[k])
                value = configurations(slides, course[None], np.array([share]))[0]
                assert value == pytest.approx(given(at), rel=1e-9, abs=1e-9)


def test_a_spline_with_values_in_columns_collides_where_it_goes(slides):
    """A square array of coefficients whose columns are the times is not taken for one whose rows are."""
    scene = Scene()
    scene.add("ball", Body.sphere(0.1), translation(1.0))
    checker = CollisionChecker(slides, scene)
    ends = np.array([[0.0, 2.0 / 3, 4.0 / 3, 2.0], [0] * 4, [0] * 4, [0] * 4])
    given = BSpline([0, 0, 1 / 3, 2 / 3, 1, 1], ends, 1, axis=1)
    assert checker.collide(given(0.5))
    found = checker.certify_trajectory(given, proof=True)
    assert (found.verdict, found.proof) == (COLLIDING, None)
    contact = checker.first_contact(given)
    assert contact.verdict == COLLIDING
    assert contact.free_until == pytest.approx(0.425, abs=1e-4)
    along = BSpline([0, 0, 1 / 3, 2 / 3, 1, 1], ends.T.copy(), 1)
    assert checker.first_contact(along).free_until == contact.free_until


class _Slower(CubicSpline):
    def __call__(self, x, nu=0, extrapolate=None):
        return super().__call__(0.5 * np.asarray(x), nu, extrapolate)


class _Wrapped(BSpline):
    def __call__(self, x, nu=0, extrapolate=None):
        return np.clip(super().__call__(x, nu, extrapolate), -0.5, 0.5)


def _of_own_samples(t, q):
    given = CubicSpline(t, q)
    given._evaluate = lambda x, nu, extrapolate, out: out.fill(0.0)
    return given


@pytest.mark.parametrize(
    "made",
    [
        lambda t, q: _Slower(t, q),
        lambda t, q: _Wrapped([*t[:1], *t, *t[-1:]], q, 1),
        _of_own_samples,
    ],
)
def test_curves_with_an_evaluation_of_their_own_are_refused(slides, made):
    """Where other code than SciPy's computes values, samples cannot show that they are those of the coefficients."""
    t, q = np.arange(5.0), np.linspace(0.0, 1.0, 5)[:, None] * [1.0, -1.0, 0.5, 0.2]
    given = made(t, q)
    checker = CollisionChecker(slides)
    for take in (checker.certify_trajectory, checker.first_contact, partial(plots.trajectory, checker)):
        with pytest.raises(InputError, match="expected a curve that SciPy evaluates, found .* with its own"):
            take(given)


@pytest.mark.parametrize(
    ("made", "attributes", "text"),
    [
        (lambda t, q: CubicSpline(t, q), {"c": np.zeros((4, 4, 5))}, "expected"),
        (lambda t, q: CubicSpline(t, q), {"c": None}, "expected a curve that SciPy can evaluate"),
        (lambda t, q: BSpline([*t[:1], *t, *t[-1:]], q, 1), {"k": -3}, "expected a curve that SciPy can evaluate"),
        (lambda t, q: BSpline([*t[:1], *t, *t[-1:]], q, 1), {"c": np.zeros((1, 4))}, "expected a curve that SciPy can"),
    ],
)
def test_curves_with_changed_attributes_are_refused(slides, made, attributes, text):
    """What was changed after SciPy had checked it is refused, if its values are others or cannot be computed."""
    t, q = np.arange(5.0), np.linspace(0.0, 1.0, 5)[:, None] * [1.0, -1.0, 0.5, 0.2]
    given = made(t, q)
    for name, value in attributes.items():
        setattr(given, name, value)
    with pytest.raises(InputError, match=text):
        CollisionChecker(slides).certify_trajectory(given)


@pytest.mark.parametrize("scale", [1e-150, 1e-9, 1.0, 1e9])
@pytest.mark.parametrize("begin", [0.0, -1e9, 1e6])
@pytest.mark.parametrize("form", OF_SCIPY)
def test_rounding_of_values_refuses_no_curve(slides, rng, form, begin, scale):
    """Curves that begin late, of small and large values, agree with SciPy within the bounds of rounding."""
    t = begin + np.cumsum(rng.uniform(1e-3, 2.0, 12))
    given = OF_SCIPY[form](t, scale * rng.normal(size=(12, 4)), 0)
    for extrapolate in (True, "periodic"):
        given.extrapolate = extrapolate
        with warns.catch_warnings():
            warns.simplefilter("ignore")
            curve_of(slides, given, "curve")


def test_controllers_interpolate_points(arm, rng):
    """Positions, velocities and accelerations at the points are those that were given."""
    times = np.array([0.0, 0.5, 2.0])
    q, v, a = rng.normal(size=(3, 3, 8))
    for given, known in (((q,), 1), ((q, v), 2), ((q, v, a), 3)):
        curve = curve_of(arm, ControllerPoints(times, *given), "curve")
        piece = BPoly(np.moveaxis(curve.courses, 1, 0), times)
        for order in range(known):
            for k in range(2):
                T = 1e-12
                assert piece(times[k] + T, order) == pytest.approx((q, v, a)[order][k], abs=1e-6)
                assert piece(times[k + 1] - T, order) == pytest.approx((q, v, a)[order][k + 1], abs=1e-6)


def test_trajectories(checker, rng):
    """A blended trajectory is proven again, and so are its knots in a controller that takes velocities."""
    Q = paths(checker, rng, 30, corners=3, length=0.3)
    a, b = Q[:, :-1].reshape(-1, 8), Q[:, 1:].reshape(-1, 8)
    free = (checker.certify_edges(a, b).verdict == FREE).reshape(30, 2).all(axis=1)
    moved = [trajectory(checker.robot, q, velocity=1.0, acceleration=3.0, checker=checker) for q in Q[free]]
    assert sum(len(one.blends) for one in moved) > 0
    assert all(one.certify(checker).verdict == FREE for one in moved)
    points = [ControllerPoints(one.times, one.knots, one.rates, names=one.names) for one in moved]
    assert all(one.verdict == FREE for one in checker.certify_trajectory(points))


def test_joint_errors(checker, rng):
    """No configuration that is off a proven curve by the joint error collides; a larger error proves less."""
    times = np.arange(4.0)
    given = [CubicSpline(times, q) for q in paths(checker, rng, 30, corners=4, length=0.3)]
    counts = []
    for error in (0.0, 1e-3, 1e-2):
        found = checker.certify_trajectory(given, joint_error=error)
        free = [curve for curve, one in zip(given, found, strict=True) if one.verdict == FREE]
        counts.append(len(free))
        for curve in free:
            Q = curve(rng.uniform(0, 3, 500))
            assert not checker.collide(Q + error * rng.choice([-1.0, 1.0], Q.shape)).any()
    assert counts[0] >= counts[1] > counts[2]


def test_one_curve_and_its_segments(tmp_path, arm):
    """The verdict of the whole is that of its worst segment, at a time of the curve; names decide the columns."""
    scene = Scene()
    q = np.array([0.0, 0.0, 0.0, -1.5, 0.0, 1.5, 0.0, 0.02])
    other = q.copy()
    other[0] = 1.0
    hand = arm.forward_kinematics(q)[arm.link_names.index("panda_hand"), :3, 3]
    scene.add("ball", Body.sphere(0.05), translation(*hand))
    checker = CollisionChecker(arm, scene)
    points = np.stack([other, other + 0.01, q, other])
    found = checker.certify_trajectory(ControllerPoints([1.0, 2.0, 3.0, 5.0], points))
    assert found.verdict == COLLIDING
    assert 2.0 < found.time <= 3.0
    assert "ball" in found.names
    assert found.segments.verdict.tolist() == [FREE, COLLIDING, COLLIDING]
    assert found.times.tolist() == [1.0, 2.0, 3.0, 5.0]
    names = arm.configuration_names
    turned = ControllerPoints([1.0, 2.0, 3.0, 5.0], points[:, ::-1].copy(), names=names[::-1])
    assert checker.certify_trajectory(turned).time == found.time


@pytest.mark.parametrize(
    ("given", "text"),
    [
        (3.0, "expected a PPoly"),
        (ControllerPoints, "expected a PPoly"),
        (CubicSpline([0, 1, 2], np.zeros((3, 9))), "expected 8 values"),
        (CubicSpline([0, 1, 2], np.zeros((3, 2, 8))), "values of shape"),
        (PPoly(np.full((2, 1, 8), np.nan), [0, 1]), "finite"),
        (PPoly(np.zeros((2, 2, 8)), [2, 1, 0]), "increase"),
        (PPoly(np.zeros((9, 1, 8)), [0, 1]), "degree 7"),
        (PPoly(np.arange(16.0).reshape(1, 2, 8), [0, 1, 2]), "jump"),
        (PPoly(np.zeros((2, 1, 8), dtype=complex), [0, 1]), "real"),
        (ControllerPoints([0, 1], np.zeros((2, 8)), names=list("abcdefgh")), "expected the joints"),
    ],
)
def test_what_is_no_curve_of_the_robot(checker, given, text):
    """One clear error for each."""
    with pytest.raises(InputError, match=text):
        checker.certify_trajectory(given)


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (([0.0], np.zeros((1, 9))), "two or more"),
        (([0.0, 0.0], np.zeros((2, 9))), "increase"),
        (([0.0, 1.0], np.zeros((3, 9))), "positions"),
        (([0.0, 1.0], np.zeros((2, 9)), None, np.zeros((2, 9))), "velocities"),
        (([0.0, 1.0], np.zeros((2, 9)), np.full((2, 9), np.inf)), "velocities"),
    ],
)
def test_bad_points(arguments, text):
    """Points of no controller are refused where they are made."""
    with pytest.raises(InputError, match=text):
        ControllerPoints(*arguments)


def test_bad_joint_errors(checker):
    """A joint error is one number or one for each joint, and none is negative."""
    curve = CubicSpline([0, 1, 2], np.zeros((3, 8)))
    for bad in (-1.0, [1.0, 2.0], math.nan):
        with pytest.raises(InputError, match="joint_error"):
            checker.certify_trajectory(curve, joint_error=bad)


@pytest.fixture
def floating(tmp_path):
    """A bar on a floating base, with a ball near its end."""
    scene = Scene()
    scene.add("ball", Body.sphere(0.1), translation(1.0, 0.205))
    robot = replace(written(tmp_path, AFLOAT), bodies={"base": Body.box([2.0, 0.2, 0.2])})
    return CollisionChecker(robot, scene)


def resting(checker, norm, count=3):
    """A curve along which nothing moves, with quaternions of some norm."""
    q = np.zeros(checker.robot.dof)
    q[checker.robot._quaternions["base"].start] = norm
    return CubicSpline(np.arange(count), np.tile(q, (count, 1)))


def test_the_norm_of_quaternions_does_not_matter(floating):
    """The joint error of a quaternion is that of the unit quaternion, whatever the norm on the curve is."""
    at = floating.robot._quaternions["base"]
    error = np.zeros(floating.robot.dof)
    for size, expected in ((1e-4, FREE), (4e-3, AMBIGUOUS)):
        error[at] = size
        for norm in (0.5, 1.0, 2.0):
            assert floating.certify_trajectory(resting(floating, norm), joint_error=error).verdict == expected


def test_quaternions_far_from_norm_one_are_refused(floating):
    """They are no orientations as `collide` takes them, and a curve through zero has none at all."""
    for norm in (0.0, 1e-9, 0.4, 3.0):
        with pytest.raises(InputError, match="norm 1"):
            floating.certify_trajectory(resting(floating, norm))


def test_a_piece_that_turns_too_far(floating):
    """A piece on which the orientation turns by half a turn is refused by its times, not called free."""
    rows = np.zeros((2, floating.robot.dof))
    at = floating.robot._quaternions["base"]
    rows[0, at], rows[1, at] = [1, 0, 0, 0], [0, 0, 0, 1]
    with pytest.raises(InputError, match="80 degrees.*from 1 s to 4 s of curve 0"):
        floating.certify_trajectory(ControllerPoints([1.0, 4.0], rows))


def test_joint_errors_of_straight_motions(checker, rng):
    """`certify_edges` proves what it says for a line of a controller; no corner of the errors collides."""
    a, b = np.swapaxes(paths(checker, rng, 200, corners=2), 0, 1)
    error = np.where(np.arange(checker.robot.dof) % 2, 5e-3, 2e-3)
    found = checker.certify_edges(a, b, joint_error=error)
    given = [ControllerPoints([0, 1], ends) for ends in np.stack([a, b], axis=1)]
    lines = checker.certify_trajectory(given, joint_error=error)
    assert found.verdict.tolist() == [one.verdict for one in lines]
    exact = checker.certify_edges(a, b).verdict
    assert ((found.verdict == FREE) <= (exact == FREE)).all()
    assert ((found.verdict == COLLIDING) <= (exact == COLLIDING)).all()
    free = found.verdict == FREE
    assert 0 < free.sum() < (exact == FREE).sum()
    Q = checker.robot.between(a[free, None], b[free, None], np.linspace(0, 1, 50))
    assert not checker.collide(Q + error * rng.choice([-1.0, 1.0], Q.shape)).any()
    assert checker.certify_edges(a[0], b[0], joint_error=0.0).verdict == exact[0]
    with pytest.raises(InputError, match="joint_error"):
        checker.certify_edges(a, b, joint_error=-1e-3)


MESSAGE = {
    "header": {"frame_id": "base"},
    "joint_names": ["rail", "elbow"],
    "points": [
        {"positions": [0, 0], "velocities": [0, 0.5], "accelerations": [], "time_from_start": {"sec": 0, "nanosec": 0}},
        {"positions": [1, 2], "velocities": [1, 0], "accelerations": [], "time_from_start": {"sec": 1, "nanosec": 5e8}},
    ],
}  # fmt: skip


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("points.json", json.dumps(MESSAGE)),
        ("wrapped.json", json.dumps([{"trajectory": {"joint_trajectory": MESSAGE}, "error_code": {"val": 1}}])),
        ("points.yaml", json.dumps(MESSAGE) + "\n---\n"),
        ("old.json", json.dumps(MESSAGE).replace('"sec"', '"secs"').replace('"nanosec"', '"nsecs"')),
        ("points.csv", "time,rail,elbow,rail velocity,elbow velocity\n0,0,0,0,0.5\n1.5,1,2,1,0\n"),
        ("order.csv", "time_from_start,elbow,elbow velocity,rail velocity,rail\n0,0,0.5,0,0\n1.5,2,0,1,1\n"),
    ],
)
def test_points_from_files(tmp_path, monkeypatch, name, text):
    """Messages of ROS, wrapped or not, and tables give the same points."""
    monkeypatch.chdir(tmp_path)
    Path(name).write_text(text)
    found = ControllerPoints.load(name)
    order = [found.names.index(joint) for joint in ("rail", "elbow")]
    assert found.times.tolist() == [0.0, 1.5]
    assert found.positions[:, order].tolist() == [[0, 0], [1, 2]]
    assert found.velocities[:, order].tolist() == [[0, 0.5], [1, 0]]
    assert found.accelerations is None


@pytest.mark.parametrize("ending", ["csv", "json"])
def test_saved_trajectories_are_points(checker, rng, tmp_path, monkeypatch, ending):
    """A controller that gets the knots and velocities of a saved trajectory follows it."""
    monkeypatch.chdir(tmp_path)
    moved = trajectory(checker.robot, paths(checker, rng, 1)[0], acceleration=2.0)
    moved.save(f"moved.{ending}")
    points = ControllerPoints.load(f"moved.{ending}")
    curve = curve_of(checker.robot, points, "curve")
    middle = configurations(checker.robot, curve.courses, np.full(len(curve.courses), 0.5))
    times = (points.times[1:] + points.times[:-1]) / 2
    np.testing.assert_allclose(middle, moved.positions(times), rtol=0, atol=1e-12)


def test_saved_messages_are_proven(checker, rng, tmp_path, monkeypatch):
    """A trajectory that is free is free as a message, whose rows are the trajectory's at whole nanoseconds."""
    monkeypatch.chdir(tmp_path)
    one = next(path for path in paths(checker, rng, 60, corners=3, length=0.2) if _is_free(checker, path))
    one[1, 0] += 1e-5  # values with an exponent, which YAML may read as text
    moved = trajectory(checker.robot, np.vstack([one, one[:1] * 1e-5]), acceleration=2.0)
    moved.save("moved.yaml", rate=10.0)
    points, knots = ControllerPoints.load("moved.yaml"), moved._with_ticks(10.0)
    assert points.names == moved.names
    assert np.abs(points.times - knots.times)[:-1].max() <= 0.5e-9 * (1 + 1e-6)
    assert 0 <= points.times[-1] - moved.duration <= 1e-9
    at = np.minimum(points.times, moved.duration)
    np.testing.assert_allclose(points.positions, moved.positions(at), rtol=0, atol=1e-14)
    np.testing.assert_allclose(points.velocities, moved.velocities(at), rtol=0, atol=4e-9)  # 4 rad/s² and 1 ns
    assert points.positions[[0, -1]].tolist() == moved.knots[[0, -1]].tolist()
    assert not points.velocities[[0, -1]].any()
    assert points.accelerations is None
    trajectory(checker.robot, one, acceleration=2.0).save("moved.yaml")
    assert checker.certify_trajectory(ControllerPoints.load("moved.yaml")).verdict == FREE
    with pytest.raises(InputError, match="ends in"):
        Trajectory.load("moved.yaml")


def _is_free(checker, path):
    return (checker.certify_edges(path[:-1], path[1:], joint_error=1e-4).verdict == FREE).all()


def test_joints_that_differ_are_named(arm):
    """The joints of another robot, and those that are missing, are listed apart; a negative error has its joint."""
    names = ["other", *arm.configuration_names[1:]]
    checker = CollisionChecker(arm)
    points = ControllerPoints([0.0, 1.0], np.zeros((2, arm.dof)), names=names)
    with pytest.raises(InputError, match=f"found none for {arm.configuration_names[0]}, and the unknown other$"):
        checker.certify_trajectory(points)
    last = arm.configuration_names[-1]
    with pytest.raises(InputError, match=f"expected one number >= 0 or {arm.dof} of them, found -0.001 for {last}$"):
        checker.certify_trajectory(points, joint_error=[1e-3] * (arm.dof - 1) + [-1e-3])
    with pytest.raises(InputError, match="joint_error: expected finite numbers, found nan$"):
        checker.certify_trajectory(points, joint_error=np.nan)


def test_curves_in_degrees_cause_a_warning():
    """As for motions; a curve within the limits causes none."""
    for scale, warnings in ((1.0, 0), (180 / np.pi, 1)):  # each robot warns once
        robot = read_example("panda_description/urdf/panda.urdf", "panda_description/srdf/panda.srdf")
        path = scale * np.linspace(robot.lower * 0.5, robot.upper * 0.5, 3)
        with warns.catch_warnings(record=True) as told:
            warns.simplefilter("always")
            CollisionChecker(robot).certify_trajectory(CubicSpline([0.0, 1.0, 2.0], path))
        assert [("is it in degrees" in str(one.message), one.filename) for one in told] == [(True, __file__)] * warnings


def _without(key):
    return {name: value for name, value in MESSAGE.items() if name != key}


@pytest.mark.parametrize(
    ("name", "text", "told"),
    [
        ("a.csv", "", "header"),
        ("a.csv", "rail,elbow\n0,1\n", "header"),
        ("a.csv", "time,rail,rail\n0,1,2\n", "different joints"),
        ("a.csv", "time,rail\n0,1\n1,2,3\n", "row 2 below the header: expected 2 cells, found 3"),
        ("a.csv", "time,rail\n0,1\n1,x\n", "'x'"),
        ("a.csv", "time,rail\n0,1\n0,2\n", "times"),
        ("a.csv", "time,rail\n0,1\n1,nan\n", "finite"),
        ("a.csv", "time,rail\n0,1\n1,nan\n", r"positions: expected finite numbers, found nan at index \(1, 0\)$"),
        ("a.csv", "time,rail,elbow,rail velocity\n0,1,1,1\n1,1,1,1\n", "elbow velocity"),
        ("a.csv", "time,rail\n0,0,0.5,0.1\n", "row 1 below the header: expected 2 cells, found 4"),
        ("a.csv", "time,rail\n0,1_0\n1,1\n", "expected a number, found '1_0'"),
        ("a.json", "{", "line 1: expected JSON"),
        ("a.json", json.dumps(_without("points")), "points"),
        ("a.json", json.dumps(_without("joint_names")), "expected the key joint_names"),
        ("a.json", json.dumps(MESSAGE | {"points": [{}]}), "time_from_start"),
        ("a.json", json.dumps(MESSAGE | {"points": [{"time_from_start": 0}, {"time_from_start": 1}]}), "positions"),
        ("a.json", json.dumps(MESSAGE | {"points": [1, 2]}), r"points\[0\]: expected a mapping, found 1"),
        ("a.json", json.dumps(MESSAGE).replace("[1, 0]", "[]"), "points.1.: expected velocities of all points"),
        ("a.yaml", "points: [", "line 1"),
        ("a.yaml", 2 * (json.dumps(MESSAGE) + "\n---\n"), "found several, .* write each to a file of its own"),
        ("a.json", "[" * 100_000, "expected points of a trajectory"),
    ],
)  # fmt: skip
def test_bad_files_of_points(tmp_path, monkeypatch, name, text, told):
    """One clear error, which names the file."""
    monkeypatch.chdir(tmp_path)
    Path(name).write_text(text)
    with pytest.raises(FileError, match=told) as caught:
        ControllerPoints.load(name)
    assert str(caught.value).startswith(name)
    with pytest.raises(InputError, match="path"):
        ControllerPoints.load("points.txt")


# -- messages that contain more than one trajectory ------------------------------------------------

# A state agrees with the message if its values are those of the first point, and other joints are at 0.
STATE = {
    "joint_state": {"header": {}, "name": ["rail", "elbow", "lift"], "position": [0, 0, 0], "velocity": []},
    "multi_dof_joint_state": {"header": {}, "joint_names": [], "transforms": [], "twist": [], "wrench": []},
    "attached_collision_objects": [],
    "is_diff": False,
}  # fmt: skip
UNMOVED = {"translation": {"x": 0.0, "y": 0.0, "z": 0.0}, "rotation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}}
DRIVEN = {"joint_names": ["base"], "points": [{"transforms": [UNMOVED], "time_from_start": {"sec": 0, "nanosec": 0}}]}
EMPTY = {"header": {}, "joint_names": [], "points": []}
DISPLAYED = {
    "model_id": "r",
    "trajectory": [{"joint_trajectory": MESSAGE, "multi_dof_joint_trajectory": EMPTY}],
    "trajectory_start": STATE,
}
GOAL = {"trajectory": MESSAGE, "multi_dof_trajectory": EMPTY, "path_tolerance": [], "goal_time_tolerance": {"sec": 0}}
SOLVED = {
    "start_scene": {"robot_state": STATE, "world": {"collision_objects": [], "octomap": {"octomap": {"data": []}}}},
    "sub_trajectory": [
        {"trajectory": {"joint_trajectory": EMPTY}, "scene_diff": {"robot_state": STATE}},
        {"trajectory": {"joint_trajectory": MESSAGE}, "scene_diff": {"robot_state": {"is_diff": True}}},
    ],
}
THRICE = [{"joint_trajectory": each} for each in (MESSAGE, EMPTY, MESSAGE)]
POLE = {"link_name": "cart", "object": {"id": "pole", "operation": 0, "primitives": []}}


def _stating(names, positions, **more):
    return DISPLAYED | {"trajectory_start": {"joint_state": {"name": names, "position": positions}, **more}}


@pytest.mark.parametrize(
    "message",
    [
        MESSAGE,
        DISPLAYED,
        GOAL,
        SOLVED,
        DISPLAYED | {"trajectory_start": {}},
        DISPLAYED | {"trajectory_start": {"joint_state": {"name": [], "position": []}}},
        _stating(["rail", "lift"], []),
        _stating(["rail"], [0], multi_dof_joint_state={"joint_names": ["base"], "transforms": [UNMOVED]}),
    ],
)
@pytest.mark.parametrize("ending", ["json", "yaml"])
def test_messages_of_one_trajectory_are_read(tmp_path, ending, message):
    """Parts that are empty, or that agree with the points, are no reason to refuse a message or to warn."""
    path = tmp_path / f"message.{ending}"
    path.write_text(json.dumps(message))
    with warns.catch_warnings():
        warns.simplefilter("error")
        found = ControllerPoints.load(path)
    assert found.names == ("rail", "elbow")
    assert found.positions.tolist() == [[0, 0], [1, 2]]


@pytest.mark.parametrize(
    ("message", "told"),
    [
        (DISPLAYED | {"trajectory": THRICE}, r"expected one trajectory, found 2 .*trajectory\[2\]"),
        ([MESSAGE] * 3, "found 3 with points"),
        ({"sub_trajectory": [{"trajectory": {"joint_trajectory": MESSAGE}}] * 12}, "found 12 with points"),
        (MESSAGE | {"deep": [[[[[[[[MESSAGE]]]]]]]]}, "expected keys among header, joint_names, points, found 'deep'"),
        ([MESSAGE, MESSAGE | {"joint_names": []}], "expected a sequence of 0, found a sequence of 2"),
        ({"joint_trajectory": MESSAGE, "multi_dof_joint_trajectory": DRIVEN}, "multi-DOF .*base"),
        ({"joint_trajectory": EMPTY, "multi_dof_joint_trajectory": DRIVEN}, "multi-DOF .*base"),
        (GOAL | {"multi_dof_trajectory": DRIVEN}, "multi-DOF .*base"),
        (DRIVEN, "multi-DOF .*base"),
        (_stating(["rail", "lift"], [0, 0.8]), r"lift = 0\.8 \(trajectory_start/joint_state\); .*robot=.*others="),
        (MESSAGE | {"start": {"name": ["lift"], "position": [0.8]}}, "found 'start'"),
        (_stating(["rail", "lift"], [0]), "expected as many positions as names, found 1 and 2"),
        (
            _stating([], [], multi_dof_joint_state={"joint_names": ["base"], "transforms": [
                UNMOVED | {"translation": {"x": 1.0, "y": 0.0, "z": 0.0}}]}),
            "base away from the identity",
        ),
    ],
)  # fmt: skip
def test_messages_of_more_are_refused(tmp_path, message, told):
    """What a message says of the motion beyond one trajectory is never dropped."""
    for ending in ("json", "yaml"):
        path = tmp_path / f"message.{ending}"
        path.write_text(json.dumps(message))
        with pytest.raises(FileError, match=told):
            ControllerPoints.load(path)


def test_entries_that_contain_themselves_are_refused(tmp_path):
    """YAML may describe a list within itself, which the search for trajectories would never leave."""
    (tmp_path / "a.yaml").write_text("a: &a [*a, *a]\n")
    with pytest.raises(FileError, match="expected keys among .*, found 'a'"):
        ControllerPoints.load(tmp_path / "a.yaml")
    (tmp_path / "a.yaml").write_text("goal: &a {goal: *a}\n")
    with pytest.raises(FileError, match="expected keys among .*, found 'goal'"):
        ControllerPoints.load(tmp_path / "a.yaml")


TWO_SLIDES = """<robot name="r"><link name="base"/><link name="mast"/><link name="cart"/><link name="finger"/>
<joint name="lift" type="prismatic"><parent link="base"/><child link="mast"/><limit upper="1"/></joint>
<joint name="slide" type="prismatic"><parent link="mast"/><child link="cart"/><limit upper="3"/></joint>
<joint name="grip" type="prismatic"><parent link="cart"/><child link="finger"/><mimic joint="lift"/><limit upper="1"/>
</joint></robot>"""
SLID = {
    "joint_names": ["slide"],
    "points": [{"positions": [x], "velocities": [x], "time_from_start": x} for x in (0, 2)],
}


def test_values_of_other_joints_are_given_by_the_caller(tmp_path):
    """Values that the points lack are constant columns; a start state's values are replaced only by explicit ones."""
    robot, path = Robot.from_urdf(text=TWO_SLIDES), tmp_path / "m.json"
    path.write_text(json.dumps(SLID))
    assert ControllerPoints.load(path).names == ("slide",)
    for others, lift in ((None, 0.0), ([0.5, 3.0], 0.5)):
        found = ControllerPoints.load(path, robot=robot, others=others)
        assert found.names == ("slide", "lift")
        assert found.positions.tolist() == [[0, lift], [2, lift]]
        assert found.velocities.tolist() == [[0, 0], [2, 0]]
    state = {"name": ["lift", "grip", "slide"], "position": [0.8, 0.8, 0.0]}
    path.write_text(json.dumps({"trajectory": {"joint_trajectory": SLID}, "trajectory_start": {"joint_state": state}}))
    assert ControllerPoints.load(path, robot=robot).positions[:, 1].tolist() == [0.8, 0.8]
    assert ControllerPoints.load(path, robot=robot, others=[0.3, 0.0]).positions[:, 1].tolist() == [0.3, 0.3]
    state["name"][1] = "wheel"
    path.write_text(json.dumps({"trajectory": {"joint_trajectory": SLID}, "trajectory_start": {"joint_state": state}}))
    with pytest.raises(FileError, match="'r', .* it lacks: wheel; the state belongs to a larger robot: read that"):
        ControllerPoints.load(path, robot=robot, others=[0.8, 0.0])
    with pytest.raises(InputError, match="others: expected a configuration of robot="):
        ControllerPoints.load(path, others=[0.8, 0.0])


def test_bases_of_messages_are_given_by_the_caller(tmp_path):
    """A base that a state moves is refused with advice that works: place the robot there, or give the base values."""
    robot, path = Robot.from_urdf(text=TWO_SLIDES), tmp_path / "m.json"
    moved = {"joint_names": ["base"], "transforms": [UNMOVED | {"translation": {"x": 1.0, "y": 0.0, "z": 0.0}}]}
    path.write_text(
        json.dumps({"trajectory": {"joint_trajectory": SLID}, "trajectory_start": {"multi_dof_joint_state": moved}})
    )
    for others in (None, [0.5, 3.0]):
        with pytest.raises(FileError, match="base away from the identity .*Robot.placed .* remove .*add_base"):
            ControllerPoints.load(path, robot=robot, others=others)
    on_base = robot.add_base("planar")
    for others, x in ((None, 1.0), ([0.25, 0.0, 0.0, 0.5, 0.0], 0.25)):
        found = ControllerPoints.load(path, robot=on_base, others=others)
        assert found.positions[:, found.names.index("base/x")].tolist() == [x, x]
    path.write_text(json.dumps(SLID))
    T = [[1, 0, 0, 1], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]
    assert ControllerPoints.load(path, robot=robot.placed(T)).names == ("slide", "lift")


def test_worlds_and_other_starts_of_messages_are_told(tmp_path):
    """A message's own world and a start state elsewhere do not change the answer, so each is a warning."""
    path = tmp_path / "m.json"
    octree = {"octomap": {"octomap": {"resolution": 0.1, "data": [1]}}}
    world = {"world": {"collision_objects": [{"id": "wall"}], **octree}}
    path.write_text(json.dumps(SOLVED | {"start_scene": world}))
    with pytest.warns(UserWarning, match=r"a world of its own \(wall, an octree\), which is not read"):
        ControllerPoints.load(path)
    path.write_text(json.dumps(_stating(["elbow", "rail"], [0.2, 1e-3])))
    with pytest.warns(UserWarning, match=r"the start state has elbow = 0\.2, and the first point elbow = 0; the"):
        ControllerPoints.load(path)


@pytest.mark.parametrize("ending", ["json", "yaml"])
def test_keys_that_occur_twice_in_a_message_are_refused(tmp_path, ending):
    """Only the last of two values would be read; the line is that of the second key."""
    text = json.dumps(MESSAGE)
    path = tmp_path / f"m.{ending}"
    for key in ("points", "joint_names", "positions"):
        again = text.replace(f'"{key}":', f'"{key}": [],\n"{key}":', 1)
        path.write_text(again)
        with pytest.raises(FileError, match=rf"m\.{ending}, line 2: .*expected each key once .*, found '{key}' again"):
            ControllerPoints.load(path)
