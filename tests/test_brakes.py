"""Brakes: from a state to rest, within limits, as short as can be; on the path every point is on it."""

import math

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from families import translation
from loewner import (
    Body,
    CollisionChecker,
    InputError,
    LoewnerError,
    PlanningError,
    Scene,
    UnknownNameError,
    Verdict,
)
from loewner._kernels.robots.brakes import NEAR
from loewner.planners import JointLimits, Trajectory, brake, limit_use, trajectory
from loewner.planners.brakes import Brakes
from loewner.robots.proofs.curves import curve_of, form_of
from motion_oracle import AFLOAT, written
from sampling import examples
from test_trajectories import dense, in_blend, off_polyline, paths

rates = arrays(np.float64, 3, elements=st.floats(-3.0, 3.0).map(lambda x: round(x, 3)))
shares = arrays(np.float64, 3, elements=st.floats(-1.0, 1.0))
strengths = arrays(np.float64, 3, elements=st.floats(0.1, 20.0))
steeps = arrays(np.float64, 3, elements=st.floats(1.0, 5e3))
moments = st.floats(0.0, 1.0)

# Limits hold up to the rounding of pieces that are as short as a billionth of a brake.
OF_LIMITS = 1e-5


def long_enough(moved):
    """Times on pieces that are not so short that rounding affects accelerations."""
    wide = np.diff(moved.times) > 1e-4 * moved.duration
    return [np.linspace(a, b, 23)[1:-1] for a, b in zip(moved.times[:-1][wide], moved.times[1:][wide], strict=True)]


def assert_lawful(moved, q, dq, strongest, jerk=None):
    """It begins in the state and ends at rest, and between, derivatives are those of the curve and within limits."""
    assert moved.positions(0.0) == pytest.approx(q, abs=1e-15)
    assert moved.velocities(0.0) == pytest.approx(dq, abs=1e-12)
    assert not moved.velocities(moved.duration).any()
    for t in long_enough(moved):
        q, v, a = moved.positions(t), moved.velocities(t), moved.accelerations(t)
        step = t[2] - t[0]
        assert (np.abs(a) <= strongest * (1 + OF_LIMITS)).all()
        # Simpson's rule is exact for polynomials of degree 3.
        assert np.diff(q[::2], axis=0) == pytest.approx((v[:-2:2] + 4 * v[1::2] + v[2::2]) / 6 * step, abs=1e-9)
        assert np.diff(v[::2], axis=0) == pytest.approx(a[1::2] * step, abs=1e-7)
        if jerk is not None:
            assert (np.abs(np.diff(a[::2], axis=0)) <= jerk * step + OF_LIMITS * strongest).all()


def controls(moved):
    """The control points of its pieces: the curve that is proven."""
    return form_of(moved, "curve").courses


# -- joint by joint -----------------------------------------------------------------------------


@examples(16, 40)
@given(q=shares, dq=rates, strongest=strengths)
def test_joints_brake_in_closed_form(robot, q, dq, strongest):
    """Each joint covers v²/2a in v/a seconds, within its limit, and rests from then on."""
    moved = brake(robot, q, dq, acceleration=strongest)
    assert_lawful(moved, q, dq, strongest)
    alone = np.abs(dq) / strongest
    assert moved.duration == pytest.approx(alone.max(), rel=1e-12)
    assert moved.knots[-1] == pytest.approx(q + dq * np.abs(dq) / (2 * strongest), abs=1e-12)
    assert len(moved.times) <= 4
    t = dense(moved)
    left = np.sign(dq) * np.maximum(np.abs(dq) - t[:, None] * strongest, 0.0)
    assert moved.velocities(t) == pytest.approx(left, abs=1e-8)
    assert moved.positions(t) == pytest.approx(q + (dq * np.abs(dq) - left * np.abs(left)) / (2 * strongest), abs=1e-8)


@examples(16, 40)
@given(q=shares, dq=rates, share=shares, strongest=strengths, jerk=steeps)
@example(  # a ramp of a billionth of the brake's duration, which becomes a jump
    q=np.zeros(3), dq=np.array([0.0, 0.0, -1.0]), share=np.full(3, 0.99999), strongest=np.full(3, 0.1),
    jerk=np.full(3, 100.0),
)  # fmt: skip
def test_joints_brake_with_limited_jerk(robot, q, dq, share, strongest, jerk):
    """From any acceleration within limits, positions, velocities and accelerations are continuous and within limits."""
    ddq = share * strongest
    moved = brake(robot, q, dq, ddq, acceleration=strongest, jerk=jerk)
    assert_lawful(moved, q, dq, strongest, jerk)
    # A ramp that is shorter than this share of the brake becomes a jump.
    assert (np.abs(moved.bends[0] - ddq) <= 1e-12 + NEAR * moved.duration * jerk).all()
    assert not moved.bends[-1].any()
    assert len(moved.times) <= 10
    T = np.diff(moved.times)[:, None]
    bent = (moved.bends[1:] + moved.bends[:-1]) * T / 2
    assert np.diff(moved.rates, axis=0) == pytest.approx(bent, abs=1e-7)
    way = moved.rates[:-1] * T + (2 * moved.bends[:-1] + moved.bends[1:]) * T**2 / 6
    assert np.diff(moved.knots, axis=0) == pytest.approx(way, abs=1e-7)


@given(v=st.floats(-3.0, 3.0), share=st.floats(-1.0, 1.0), strongest=st.floats(0.5, 5.0), jerk=st.floats(2.0, 50.0))
@examples(12, 30)
def test_no_stop_within_limits_is_shorter(robot, v, share, strongest, jerk):
    """In a time that is shorter by a hundredth, no acceleration within limits leads to rest: linear programming."""
    from scipy.optimize import linprog

    a, n = share * strongest, 60
    found = brake(robot, [0, 0, 0], [v, 0, 0], [a, 0, 0], acceleration=strongest, jerk=jerk).duration

    def least_speed(T):
        """The least speed at the end, over all accelerations that change linearly in n steps of T/n, and end at 0."""
        step = T / n
        # The unknowns are the jerk of each step, and a bound on the speed at the end.
        sums = np.tril(np.full((n, n), step))
        to_end = step * (n - 0.5 - np.arange(n)) * step
        rows = [np.append(to_end, -1), np.append(-to_end, -1)]
        inside = np.hstack([np.vstack([sums, -sums]), np.zeros((2 * n, 1))])
        A, b = np.vstack([*rows, inside]), [-(v + a * T), v + a * T, *[strongest - a] * n, *[strongest + a] * n]
        return linprog(
            [0] * n + [1], A_ub=A, b_ub=b, A_eq=[[step] * n + [0]], b_eq=[-a], bounds=[(-jerk, jerk)] * n + [(0, None)]
        )

    if found > 0.02:
        shorter = least_speed(0.99 * found)
        assert shorter.status == 2 or shorter.fun > 1e-9
        assert least_speed(1.05 * found).fun < 1e-7


def test_known_brakes(robot):
    """From 1 m/s, 2 m/s² take 0.5 s and 0.25 m; with 8 m/s³ there are three phases of a quarter of a second."""
    moved = brake(robot, [0, 0, 0], [1, 0, 0], acceleration=2.0)
    assert (moved.times == [0, 0.5]).all()
    assert (moved.knots[-1] == [0.25, 0, 0]).all()
    moved = brake(robot, [0, 0, 0], [1, 0, 0], acceleration=2.0, jerk=8.0)
    assert moved.times == pytest.approx([0, 0.25, 0.5, 0.75], abs=1e-15)
    assert moved.bends[:, 0] == pytest.approx([0, -2, -2, 0], abs=1e-15)
    assert moved.knots[-1] == pytest.approx([0.375, 0, 0], abs=1e-15)
    at_rest = brake(robot, [0.5, 0, 0], [0, 0, 0])
    assert (at_rest.duration, at_rest.knots.tolist()) == (0.0, [[0.5, 0, 0]])


@given(q=shares, dq=rates, share=shares, strongest=strengths, jerk=steeps | st.none(), later=st.floats(0.0, 2.0))
def test_whole_courses_hold_brakes(q, dq, share, strongest, jerk, later):
    """At every fraction of its time a brake, and the rest behind it, are within the bounds of one course."""
    cubic = jerk is not None
    steep = jerk if cubic else np.full(3, np.inf)
    made = Brakes.by_joint(q[None], dq[None], share[None] * strongest if cubic else np.zeros((1, 3)), strongest, steep)
    if made.counts[0] < 2:
        return
    courses, off = made.whole(cubic, made.durations * later)
    T = float(made.durations[0] * max(later, 1.0))
    allowed = off[0] + 1e-15 * (1.0 + np.abs(q) + np.abs(dq) * T)
    pieces, seconds, _ = made.courses(cubic)
    for begin, piece, duration in zip(made.times[0], pieces, seconds, strict=False):
        s = np.linspace(0.0, 1.0, 33)
        gap = np.abs(bezier(piece, s) - bezier(courses[0], (begin + s * duration) / T))
        assert (gap <= allowed).all()
    rest = bezier(courses[0], np.linspace(made.durations[0] / T, 1.0, 33))
    assert (
        np.abs(made.states[0, made.counts[0] - 1, 0] - rest) <= off + 1e-15 * (1.0 + np.abs(q) + np.abs(dq) * T)
    ).all()
    moves = np.abs(np.diff(np.concatenate(pieces), axis=0)).sum(axis=0)
    assert (off[0] <= 2 * moves + 1e-13 * (1.0 + np.abs(q))).all()


def bezier(points, s):
    """A course of degree 2 or 3 at fractions."""
    points = np.repeat(points[:, None], len(s), axis=1)
    while len(points) > 1:
        points = points[:-1] + s[:, None] * np.diff(points, axis=0)
    return points[0]


@pytest.mark.parametrize("jerk", [None, 1e3])
def test_a_joint_that_hardly_moves(robot, jerk):
    """Beside a long brake, a joint at a trillionth of a radian per second stops where it should."""
    moved = brake(robot, [0, 0, 0], [1, 0, 1e-12], acceleration=[0.1, 0.1, 1e3], jerk=jerk)
    assert moved.duration > 10 - 1e-9
    assert np.abs(moved.positions(dense(moved))[:, 2]).max() < 1e-18
    assert moved.velocities(0.0) == pytest.approx([1, 0, 1e-12], abs=1e-24)


def test_off_the_path(robot):
    """Joints that stop at different times leave the straight line by as much as plane geometry says."""
    moved = brake(robot, [0, 0, 0], [1, 1, 0], acceleration=[1.0, 2.0, 1.0])
    assert (moved.knots[-1] == [0.5, 0.25, 0]).all()
    line = Trajectory.of_targets(robot, [[0, 0, 0], [1, 1, 0]], 1.0).stop_at(0.0, acceleration=[1.0, 2.0, 1.0])
    assert (line.knots[-1] == [0.5, 0.5, 0]).all()


# -- on the path --------------------------------------------------------------------------------


@example(path=np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 1.0]]), moment=1.0, strongest=np.ones(3), jerk=None)
@given(path=paths, moment=moments, strongest=strengths, jerk=st.none() | steeps)
def test_brakes_through_targets(robot, path, moment, strongest, jerk):
    """Every control point is on the path, in order; limits hold within pieces; the end is at rest."""
    chunk = Trajectory.of_targets(robot, path, 0.25)
    at = moment * chunk.duration
    limits = {"acceleration": strongest, "jerk": jerk}
    try:
        moved = chunk.stop_at(at, **limits)
    except PlanningError:
        moved = chunk.stop_at(at, beyond=True, **limits)
        path = np.vstack([path, path[-1] + 1e3 * (path[-1] - path[-2])])
    if moved.duration == 0:
        return
    # At its last target the chunk is at rest, and a brake from there goes on with the motion that led there.
    before = min(at, np.nextafter(chunk.duration, 0.0))
    assert_lawful(moved, chunk.positions(at), chunk.velocities(before), strongest, jerk)
    points = controls(moved).reshape(-1, 3)
    assert off_polyline(path, points).max() <= 1e-12 * max(1.0, np.abs(points).max())
    if jerk is not None:  # from one piece to the next, the path's time changes its rate continuously
        assert len(moved.times) <= len(path) + 4


@pytest.mark.parametrize("count", [12, pytest.param(50, marks=pytest.mark.verify)])
def test_brakes_through_targets_beside_small_steps(robot, count):
    """Without limits of jerk, the brake is the one of an integration in small steps of the path's time."""

    @settings(max_examples=count)
    @given(path=paths, moment=moments, strongest=strengths)
    def holds(path, moment, strongest):
        chunk = Trajectory.of_targets(robot, path, 2.0)
        at = moment / 2 * chunk.duration
        s, v, step, t = at, 1.0, 1e-3, 0.0
        while v > 0 and s < chunk.duration - 1e-3:
            rate = np.abs(chunk.velocities(s))
            gain = min((strongest[rate > 0] / rate[rate > 0]).tolist(), default=np.inf)
            s, v, t = s + v * step, v - gain * step, t + step
        if v > 0:
            return
        moved = chunk.stop_at(at, acceleration=strongest)
        assert moved.knots[-1] == pytest.approx(chunk.positions(s), abs=2e-3 * np.abs(chunk.rates).max() + 1e-9)

    holds()


@pytest.mark.parametrize("count", [10, pytest.param(40, marks=pytest.mark.verify)])
def test_brakes_on_trajectories(robot, alone, count):
    """With limits no lower than the trajectory's, the brake is on its path, also on blends."""

    @settings(max_examples=count)
    @given(path=paths, moment=moments, factor=st.floats(1.0, 4.0), jerk=st.none() | st.floats(5.0, 500.0))
    @example(  # long, so the chords of the samples are far from it
        path=np.array([[0, 0, 0], [1, 0, 0], [0, 0, 0], [0, 1, -1], [0, 0, 1], [0, 0, 0]], dtype=float), moment=0.125,
        factor=1.0, jerk=5.0,
    )  # fmt: skip
    def holds(path, moment, factor, jerk):
        limits = {"acceleration": 2.0, "jerk": jerk}
        moved = trajectory(robot, path, velocity=1.0, checker=alone, **limits)
        at = moment * moved.duration
        found = moved.stop_at(at, **{name: limit and factor * limit for name, limit in limits.items()})
        if found.duration == 0:
            return
        assert_lawful(
            found, moved.positions(at), moved.velocities(at), 2.0 * factor, None if jerk is None else jerk * factor
        )
        samples, step = np.linspace(at, moved.duration, 4000, retstep=True)
        chords = math.sqrt(3) * 2.0 * step**2 / 8  # are off by this where all three joints accelerate
        assert off_polyline(moved.positions(samples), found.positions(dense(found, 10))).max() <= 1e-8 + chords
        smooth = np.diff(found.knots, axis=0) - np.diff(found.times)[:, None] * (found.rates[1:] + found.rates[:-1]) / 2
        if jerk is None:
            assert np.abs(smooth).max() <= 1e-9

    holds()


@pytest.mark.parametrize("jerk", [None, 40.0])
def test_a_brake_slows_before_a_blend(robot, alone, jerk):
    """It passes a blend at the speed that is left, and stops before the place where a brake after the blend ends."""
    path = [[-1, 0, 0], [-0.4, 0, 0], [0.2, 0.6, 0], [1, 0.6, 0]]
    moved = trajectory(robot, path, velocity=1.0, acceleration=2.0, checker=alone, jerk=jerk)
    (begin, end), *_ = moved.blends
    limits = {"acceleration": 4.0, "jerk": None if jerk is None else 2 * jerk}
    found = moved.stop_at(begin - 0.1, **limits)
    assert_lawful(found, moved.positions(begin - 0.1), moved.velocities(begin - 0.1), *limits.values())
    trail = moved.positions(np.linspace(begin - 0.1, moved.duration, 20_000))
    assert off_polyline(trail, found.positions(dense(found, 10))).max() <= 1e-8
    assert found.blended.any()
    slowest = np.abs(found.velocities(found.times[found.blended.argmax()])).max()
    assert slowest < 0.95 * np.abs(moved.velocities(begin)).max()
    later = moved.stop_at(end, **limits)
    assert found.knots[-1, 0] < later.knots[-1, 0] - 0.01


def test_a_brake_does_not_creep(robot, alone):
    """From the first moment when it cannot stop before a blend, it takes about as long as from the moments after."""
    path = [[-1, 0, 0], [-0.4, 0, 0], [0.2, 0.6, 0], [1, 0.6, 0]]
    moved = trajectory(robot, path, velocity=1.0, acceleration=2.0, checker=alone)
    early, late = moved.blends[0, 0] - 0.3, moved.blends[0, 0]
    for _ in range(50):
        t = (early + late) / 2
        early, late = (early, t) if moved.stop_at(t, acceleration=4.0).blended.any() else (t, late)
    assert moved.stop_at(early, acceleration=4.0).duration < 0.3
    assert moved.stop_at(late, acceleration=4.0).duration < 2 * (moved.duration - late)


def test_a_brake_is_not_faster_than_the_trajectory(robot):
    """A line on which the trajectory slows down more strongly than the brake may is not left at a higher speed."""
    times, rates = [0.0, 0.1, 0.2], [[1.0, 0, 0], [0.5, 0, 0], [0.5, 0.01, 0]]
    knots = [[0, 0, 0], [0.075, 0, 0], [0.125, 0.0005, 0]]
    given = (np.array(rows, dtype=float) for rows in (times, knots, rates))
    moved = Trajectory(robot.configuration_names, *given, np.array([False, True]))
    assert moved.stop_at(0.0, acceleration=8.0, beyond=True).knots[-1, 0] == pytest.approx(1 / 16, abs=1e-12)
    with pytest.raises(PlanningError, match="limits: expected .* found lower ones than it needs 0 s after"):
        moved.stop_at(0.0, acceleration=2.0, beyond=True)


def test_known_brakes_through_targets(robot):
    """From 1 m/s, 2 m/s² take 0.5 s and 0.25 m, through targets each 0.1 m; a slow joint makes it longer."""
    targets = np.linspace([0, 0, 0], [1, 0.1, 0], 11)
    chunk = Trajectory.of_targets(robot, targets, 0.1, start_time=3.0)
    moved = chunk.stop_at(0.1, acceleration=2.0)
    assert moved.duration == pytest.approx(0.5, abs=1e-12)
    assert moved.knots[-1] == pytest.approx([0.35, 0.035, 0], abs=1e-12)
    assert moved.start_time == 3.1
    slow = chunk.stop_at(0.1, acceleration=[2.0, 0.1, 2.0])
    assert slow.knots[-1] == pytest.approx([0.6, 0.06, 0], abs=1e-12)
    smooth = chunk.stop_at(0.1, acceleration=2.0, jerk=8.0)
    assert smooth.duration == pytest.approx(0.75, abs=1e-12)
    assert smooth.knots[-1] == pytest.approx([0.475, 0.0475, 0], abs=1e-12)


def test_a_brake_that_does_not_fit(robot):
    """It is refused, or goes on along the last motion; a chunk that ends at rest is long enough at every time."""
    chunk = Trajectory.of_targets(robot, [[0, 0, 0], [0.1, 0, 0], [0.1, 0.1, 0]], 0.1)
    with pytest.raises(PlanningError, match=r"t: expected .* found one that is 0.1 s before the end; .*beyond=True"):
        chunk.stop_at(0.1, acceleration=1.0)
    moved = chunk.stop_at(0.1, acceleration=1.0, beyond=True)
    assert moved.knots[-1] == pytest.approx([0.1, 0.5, 0], abs=1e-12)
    curved = trajectory(robot, [[0, 0, 0], [1, 0, 0]], velocity=1.0, acceleration=2.0)
    with pytest.raises(PlanningError, match="limits: expected .* lower ones than it needs"):
        curved.stop_at(1.2, acceleration=1.0)


def test_jumps_at_targets_are_reported(robot):
    """The jump of velocities at a corner is lower on a brake, in proportion to the speed there."""
    chunk = Trajectory.of_targets(robot, [[0, 0, 0], [0.1, 0, 0], [0.1, 0.5, 0]], 0.1)
    sizes = [
        limit_use.jumps(robot, curve_of(robot, one, "curve"))[0].size
        for one in (chunk, chunk.stop_at(0.0, acceleration=4.0, beyond=True))
    ]
    assert sizes == pytest.approx([5.0, 5.0 * math.sqrt(1 - 2 * 4.0 * 0.1)], rel=1e-9)


# -- proofs -------------------------------------------------------------------------------------


def test_only_the_path_is_proven(robot):
    """Beside a box, the brake on the path is free, and joint by joint the robot hits it."""
    scene = Scene()
    scene.add("box", Body.box([0.2, 0.2, 1.0]), translation(0.75, 0.15))
    checker = CollisionChecker(robot, scene)
    targets = np.linspace([0, 0, np.pi / 2], [0.8, 0.8, np.pi / 2], 9)
    chunk = Trajectory.of_targets(robot, targets, 0.1)
    assert chunk.certify(checker).verdict == Verdict.FREE
    limits = {"acceleration": [1.0, 20.0, 1.0]}
    on, off = (chunk.stop_at(0.05, how=how, beyond=True, **limits) for how in ("path", "joints"))
    assert on.certify(checker).verdict == Verdict.FREE
    assert off.certify(checker).verdict == Verdict.COLLIDING


def test_a_brake_is_at_other_times(robot):
    """Behind a robot that runs through its targets, a body crosses; a brake is there at that time, and is hit."""
    scene = Scene()
    scene.add("cart", Body.box([0.3, 0.3, 1.0]))
    scene.follow("cart", [0.0, 2.0], np.stack([translation(0.0, 3.0), translation(0.0, -3.0)]))
    checker = CollisionChecker(robot, scene)
    chunk = Trajectory.of_targets(robot, np.linspace([-0.9, 0, np.pi / 2], [0.9, 0, np.pi / 2], 51), 0.02)
    assert chunk.certify(checker).verdict == Verdict.FREE
    moved = chunk.stop_at(0.1, acceleration=2.0)
    assert moved.certify(checker).verdict == Verdict.COLLIDING
    assert checker.certify_trajectory(moved, t0=5.0).verdict == Verdict.FREE


def test_with_jerk_the_robot_goes_farther(robot):
    """A wall beyond the stop without limits of jerk is hit by the stop with them."""
    scene = Scene()
    scene.add("wall", Body.box([0.1, 2.0, 1.0]), translation(0.25 + 0.1 + 0.05 + 0.05))
    checker = CollisionChecker(robot, scene)
    start = [0, 0, np.pi], [1, 0, 0]
    assert brake(robot, *start, acceleration=2.0).certify(checker).verdict == Verdict.FREE
    assert brake(robot, *start, acceleration=2.0, jerk=8.0).certify(checker).verdict == Verdict.COLLIDING


@pytest.mark.parametrize("jerk", [None, [30.0, 50.0, 80.0]])
def test_courses_are_the_trajectories(robot, jerk):
    """Many brakes at a time have the control points of the trajectories, joint by joint and on a path."""
    rng = np.random.default_rng(3)
    Q, V = rng.uniform(-1, 1, (20, 3)), rng.uniform(-2, 2, (20, 3))
    V[3] = 0.0
    strongest, steep = np.array([2.0, 3.0, 5.0]), np.full(3, np.inf) if jerk is None else np.array(jerk)
    limits = {"acceleration": strongest, "jerk": jerk}
    courses, seconds, first = Brakes.by_joint(Q, V, np.zeros_like(V), strongest, steep).courses(jerk is not None)
    for n in range(20):
        moved = brake(robot, Q[n], V[n], **limits)
        part = slice(first[n], first[n + 1])
        assert len(seconds[part]) == len(moved.times) - 1
        if n != 3:
            assert seconds[part] == pytest.approx(np.diff(moved.times), rel=1e-9)
            assert courses[part] == pytest.approx(controls(moved), abs=1e-12)
    rows = np.cumsum(rng.uniform(-0.01, 0.02, (30, 3)), axis=0)
    at = 0.02 * np.arange(30)
    brakes = Brakes.on_path(rows, at, at, strongest, steep, beyond=False)
    courses, seconds, first = brakes.courses(True)
    chunk = Trajectory.of_targets(robot, rows, 0.02)
    assert (brakes.counts == 0).any()
    assert (brakes.counts > 0).any()
    for n in np.flatnonzero(brakes.counts).tolist():
        moved = chunk.stop_at(at[n], **limits)
        assert courses[first[n] : first[n + 1]] == pytest.approx(controls(moved), abs=1e-12)
    for n in np.flatnonzero(brakes.counts == 0).tolist():
        with pytest.raises(PlanningError):
            chunk.stop_at(at[n], **limits)


@pytest.mark.parametrize("jerk", [np.inf, 400.0, 4000.0])
def test_brakes_need_the_rows_by_which_they_end(jerk):
    """A brake is on the motions up to the row that it needs, later rows do not change it, and no row before would do.

    Without limits of jerk, the same holds of each piece but the last one, with a motion for each.
    """
    rng = np.random.default_rng(6)
    at = 0.02 * np.arange(40)
    short = 0
    for _ in range(40):
        steps = rng.uniform(-1, 1, (39, 3)) * rng.choice([1e-9, 1e-3, 0.02], (39, 1))
        steps[:, 0] = np.abs(steps[:, 0]) + 1e-12
        rows = np.vstack([np.zeros(3), np.cumsum(steps, axis=0)])
        strongest, steep = rng.uniform(0.5, 20, 3), np.full(3, jerk)
        whole = Brakes.on_path(rows, at, at[:-1], strongest, steep, beyond=True)
        known = int(rng.integers(5, 39))
        part = Brakes.on_path(rows[: known + 1], at[: known + 1], at[:known], strongest, steep, beyond=True)
        for n in range(39):
            pieces, needed = whole.counts[n] - 1, whole.needed[n]
            first = whole.states[n, : pieces + 1, 0, 0]
            if needed < 40:
                assert rows[needed - 1, 0] - 1e-12 <= first[-1] <= rows[needed, 0]
            else:
                assert first[-1] > rows[-1, 0]
            if np.isinf(jerk):
                assert (first[1:-1] <= rows[n + np.arange(1, pieces), 0] + 1e-12).all()
            if n < known:
                assert (part.needed[n] <= known) == (needed <= known)
                same = pieces if needed <= known else min(known - n, part.counts[n] - 2) if np.isinf(jerk) else 0
                assert (part.times[n, : same + 1] == whole.times[n, : same + 1]).all()
                assert (part.states[n, :same] == whole.states[n, :same]).all()
                short += 0 < same < pieces
    assert short > 0 or np.isfinite(jerk)


# -- bad input, files ---------------------------------------------------------------------------


def test_bad_input(robot, tmp_path):
    """Each error names what was expected and what was found."""
    for options, message in [
        ({"acceleration": None}, r"acceleration: expected limits of all joints that move, found none for x; give .* 3"),
        ({"acceleration": [1.0, 2.0]}, r"acceleration: expected one number or shape \(3,\), found \(2,\)"),
        ({"acceleration": 0.0}, "acceleration: expected numbers > 0"),
        ({"acceleration": np.nan}, "acceleration: expected finite"),
        ({"jerk": -1.0}, "jerk: expected numbers > 0"),
        ({"ddq": [9, 0, 0], "jerk": 5.0}, "acceleration: expected a limit of x that is no lower than .* 9, found 1"),
        ({"acceleration": 1e-300, "dq": [1e300, 0, 0]}, "brake of finite length and time, found an overflow"),
        ({"limits": 3}, "limits: expected planners.JointLimits of x, y, turn, found int"),
    ]:
        with pytest.raises(InputError, match=message):
            brake(robot, **{"q": [0, 0, 0], "dq": [1, 0, 0], "acceleration": 1.0} | options)
    for bad in ([1, 0], [np.nan, 0, 0], "text"):
        with pytest.raises(LoewnerError, match="dq: expected"):
            brake(robot, [0, 0, 0], bad, acceleration=1.0)
    with pytest.raises(InputError, match="joints whose values run straight"):
        brake(written(tmp_path, AFLOAT), np.zeros(12), np.zeros(12), acceleration=1.0)
    moved = trajectory(robot, [[0, 0, 0], [1, 0, 0]], velocity=1.0, acceleration=2.0)
    with pytest.raises(InputError, match="t: expected times from 0 to"):
        moved.stop_at(9.0, acceleration=2.0)
    with pytest.raises(UnknownNameError, match="how: expected one of path, joints, found 'off'"):
        moved.stop_at(0.5, how="off", acceleration=2.0)
    with pytest.raises(InputError, match="jerk: expected limits of jerk if and only if .* without them"):
        moved.stop_at(0.5, acceleration=2.0, jerk=9.0)
    with pytest.raises(InputError, match="dt: expected a finite number > 0, found 0"):
        Trajectory.of_targets(robot, [[0, 0, 0], [1, 0, 0]], 0)


def test_limits_from_files(robot, tmp_path):
    """Limits of a file are those of a brake, and numbers replace them."""
    file = tmp_path / "limits.yaml"
    file.write_text("joint_limits: {x: {max_acceleration: 2.0, max_jerk: 8.0}}")
    limits = JointLimits.load(file, robot)
    state = [0, 0, 0], [1, 0, 0]
    assert brake(robot, *state, limits=limits).duration == 0.75
    assert brake(robot, *state, limits=limits, acceleration=100.0).duration == pytest.approx(2 * math.sqrt(1 / 8))


def test_brakes_in_files(robot, tmp_path):
    """A brake is saved and loaded, and begins in motion; through targets it is refused, and sampled."""
    moved = brake(robot, [0, 0, 0], [1, -0.5, 0], acceleration=2.0, jerk=9.0)
    for name in ("brake.csv", "brake.json"):
        moved.save(tmp_path / name)
        loaded = Trajectory.load(tmp_path / name)
        for attribute in ("times", "knots", "rates", "bends"):
            assert (getattr(loaded, attribute) == getattr(moved, attribute)).all()
    chunk = Trajectory.of_targets(robot, [[0, 0, 0], [1, 0, 0]], 1.0).stop_at(0.0, acceleration=2.0)
    with pytest.raises(InputError, match="found a brake through joint targets; use `sample`"):
        chunk.save(tmp_path / "chunk.csv")
    assert not in_blend(chunk, chunk.sample(10.0)[0]).any()
