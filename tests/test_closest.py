"""The closest approach on curves: bounds beside closed forms, dense samples and moments that are known."""

import json
import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.interpolate import BPoly, CubicSpline, PPoly

from checker_oracle import composed_bodies, random_robot, random_scene, simple_bodies
from loewner import Body, CollisionChecker, Robot, Scene, planners
from loewner.errors import InputError
from loewner.robots.proofs import approaches, curves
from sampling import examples, quick_of

SLIDE = """<robot name="slide"><link name="base"/><link name="ball"><collision><geometry><sphere radius="0.1"/>
</geometry></collision></link><joint name="x" type="prismatic"><parent link="base"/><child link="ball"/>
<axis xyz="1 0 0"/>
<limit lower="-1e4" upper="1e4" effort="1" velocity="1"/></joint></robot>"""

PENDULUM = """<robot name="pendulum"><link name="base"/><link name="bob"><collision><origin xyz="1 0 0"/><geometry>
<sphere radius="0.1"/></geometry></collision></link><joint name="turn" type="continuous"><parent link="base"/>
<child link="bob"/><axis xyz="0 0 1"/></joint></robot>"""


def at(x, y, z):
    T = np.eye(4)
    T[:3, 3] = x, y, z
    return T


def slide_past(x, gap, radius=0.15, margin=0.0):
    """A ball that slides past a standing cylinder at x, whose least distance is the gap."""
    scene = Scene(margin=margin)
    scene.add("post", Body.cylinder(radius=radius, length=1.0), at(x, 0.1 + radius + gap, 0))
    return CollisionChecker(Robot.from_urdf(text=SLIDE), scene)


@examples(16, 40)
@given(
    st.floats(-6, 0), st.booleans(), st.floats(-3, 2.8), st.floats(0.02, 0.98), st.sampled_from([1, 2, 7]), st.data()
)
def test_the_distance_of_a_ball_that_passes_a_post_is_known(power, deep, duration, share, pieces, data):
    """The truth lies between the proven bound and the distance that was found, for gaps of 1 µm to 1 m."""
    gap = 10.0**power if not deep else -min(10.0**power, 0.09)
    length, duration = 2.0, 10.0**duration
    checker = slide_past(share * length, gap)
    times = np.linspace(0.0, duration, pieces + 1)
    if data.draw(st.booleans(), label="straight"):
        rate = length / duration
        curve = PPoly(np.array([np.full(pieces, rate), rate * times[:-1]])[..., None], times)
    else:
        curve = CubicSpline([0.0, duration], [[0.0], [length]], bc_type="clamped")
    found = checker.closest(curve)
    k = found.nearest
    assert found.lower[k] <= gap + 1e-12
    assert gap - 1e-9 <= found.distance[k]
    assert found.close.all()
    assert found.names[k].tolist() == ["ball", "post"]
    assert found.times[k] <= found.time[k] <= found.times[k + 1]
    x = curve(found.time[k])[0] - share * length
    assert math.hypot(x, 0.25 + gap) - 0.25 == pytest.approx(found.distance[k], abs=1e-9)


@settings(max_examples=25)
@given(st.floats(-3.0, 3.0), st.floats(0.2, 6.0), st.floats(1e-5, 0.3))
def test_the_distance_of_a_pendulum_is_known(begin, turned, gap):
    """The bob passes the post's axis at the angle 0, or comes nearest to it at one end."""
    scene = Scene()
    scene.add("post", Body.sphere(0.05), at(1.15 + gap, 0, 0))
    checker = CollisionChecker(Robot.from_urdf(text=PENDULUM), scene)
    found = checker.closest(CubicSpline([0.0, 1.0], [[begin], [begin + turned]], bc_type="clamped"))
    passes = math.floor((begin + turned) / (2 * math.pi)) != math.floor(begin / (2 * math.pi)) or begin == 0
    angle = 0.0 if passes else min(abs(math.remainder(a, 2 * math.pi)) for a in (begin, begin + turned))
    truth = math.sqrt(1 + (1.15 + gap) ** 2 - 2 * (1.15 + gap) * math.cos(angle)) - 0.15
    assert found.lower[0] <= truth + 1e-12
    assert truth - 1e-9 <= found.distance[0]
    assert found.close.all()


@pytest.mark.parametrize("seed", quick_of(range(8), range(2)))
def test_random_robots_are_never_nearer_than_proven(seed, tmp_path):
    """Dense samples are no nearer than the lower bound, and what was found is a moment of the curve."""
    rng = np.random.default_rng(seed)
    pool = [*simple_bodies(rng), *composed_bodies(rng)]
    robot = random_robot(rng, tmp_path, int(rng.integers(2, 6)), pool)
    checker = CollisionChecker(robot, random_scene(rng, robot, 4, pool))
    Q = robot.random_configurations(3, seed)
    if robot._quaternions:  # a straight path, whose orientations a controller would turn at a constant rate
        curve = planners.ControllerPoints([0.0, 1.0, 2.0], robot.between(Q[0], Q[[0, 1, 2]], 0.5))
    else:
        curve = CubicSpline([0.0, 1.0, 2.0], Q[0] + 0.5 * (Q - Q[0]))
    found = checker.closest(curve)
    assert found.close.all()
    times = np.append(np.linspace(0.0, 2.0, 2001), found.time)
    points = curves.cut_in_time(robot, checker._ready(timed=True), curves.started(robot, curve, "curve"))
    k = np.clip(np.searchsorted(points.times, times, side="right") - 1, 0, len(points.courses) - 1)
    shares = (times - points.times[k]) / np.diff(points.times)[k]
    distance = checker.distance(curves.configurations(robot, points.courses[k], shares), exact=True).distance
    for piece in range(len(found.distance)):
        inside = distance[: len(times) - len(found.time)][k[: len(times) - len(found.time)] == piece]
        assert found.lower[piece] <= inside.min() + 1e-9
    np.testing.assert_allclose(distance[-len(found.time) :], found.distance, atol=1e-7)


def test_margins_do_not_count():
    """Distances are those without margins, also where the proof would end at a margin."""
    checker = slide_past(1.0, 0.004, margin=0.05)
    found = checker.closest(CubicSpline([0.0, 1.0], [[0.0], [2.0]], bc_type="clamped"))
    assert found.lower[0] <= 0.004 <= found.distance[0] + 1e-12
    assert found.close[0]


def test_bodies_that_move_are_met_where_they_are_then():
    """A box that comes along a belt passes the ball at half time, at a distance that only then is small."""
    scene = Scene()
    scene.add("box", Body.box([0.2, 0.2, 0.2]), at(0, 0, 0))
    scene.follow("box", [0.0, 2.0], [at(-2.0, 0.25, 0), at(2.0, 0.25, 0)])
    checker = CollisionChecker(Robot.from_urdf(text=SLIDE), scene)
    found = checker.closest(PPoly(np.zeros((1, 1, 1)), [0.0, 2.0]))
    k = found.nearest
    assert found.distance[k] == pytest.approx(0.05, abs=1e-6)
    assert abs(found.time[k] - 1.0) <= 0.051  # one face of the box is beside the ball for a tenth of a second
    late = checker.closest(PPoly(np.zeros((1, 1, 1)), [0.0, 2.0]), t0=1.5)
    assert late.distance[late.nearest] > 0.5
    points = planners.ControllerPoints([0.0, 2.0], [[0.0], [0.0]])
    curve, verdict = curves.proven(checker, points, 0.0)
    near = approaches.along(checker, curve, np.flatnonzero(verdict.segments.verdict)).near
    assert near.distance.min() == pytest.approx(0.05, abs=1e-6)


def test_depths_of_surfaces_have_no_upper_bound(tmp_path):
    """Where a closed surface is entered, the bound from below is infinite; apart from it, distances are proven."""
    trimesh = pytest.importorskip("trimesh")
    file = tmp_path / "box.stl"
    trimesh.creation.box((0.2, 0.2, 0.2)).export(file)
    for y, inside in ((0.1, True), (0.25, False)):
        scene = Scene()
        scene.add("box", Body.from_surface(file), at(1.0, y, 0))
        found = CollisionChecker(Robot.from_urdf(text=SLIDE), scene).closest(CubicSpline([0, 1.0], [[0.0], [2.0]]))
        assert (found.lower[0] == -np.inf) == inside
        assert (found.distance[0] < 0) == inside
        if not inside:
            assert found.lower[0] <= 0.05 <= found.distance[0] + 1e-7  # the file has single precision
            assert found.close[0]


def test_collisions_begin_and_end_where_they_do():
    """Two posts are passed through on one piece: each contact has both of its times."""
    scene = Scene()
    for number, x in enumerate((0.5, 1.5)):
        scene.add(f"post {number}", Body.cylinder(radius=0.15, length=1.0), at(x, 0.24, 0))
    checker = CollisionChecker(Robot.from_urdf(text=SLIDE), scene)
    curve = PPoly(np.array([[[1.0]], [[0.0]]]), [0.0, 2.0])
    ready = checker._ready(timed=True)
    given_curve = curves.started(checker.robot, curve, "curve")
    found = approaches.contacts(ready, given_curve, np.array([0]), checker.closest(curve))
    half = math.sqrt(0.25**2 - 0.24**2)
    np.testing.assert_allclose(found, [[0.5 - half, 0.5 + half], [1.5 - half, 1.5 + half]], atol=1e-8)
    for begin, end in found:
        assert checker.collide([[begin], [end]]).all()
        assert not checker.collide([[np.nextafter(begin, 0) - 1e-9], [np.nextafter(end, 2) + 1e-9]]).any()


def test_lists_and_bad_curves():
    """A list gives a tuple; what is no curve is refused as by `certify_trajectory`, and so is a scene without pairs."""
    checker = slide_past(1.0, 0.1)
    curve = CubicSpline([0.0, 1.0], [[0.0], [2.0]])
    first, second = checker.closest([curve, curve])
    assert first.distance.tolist() == second.distance.tolist()
    assert "distance=" in repr(first)
    with pytest.raises(InputError, match="expected a PPoly"):
        checker.closest([[0.0], [1.0]][0])
    with pytest.raises(InputError, match="closest: expected a robot and a scene with pairs"):
        CollisionChecker(Robot.from_urdf(text=SLIDE)).closest(curve)


# -- limits -------------------------------------------------------------------------------------


def audited(capsys, tmp_path, table, *arguments, urdf=SLIDE):
    """Run `loewner audit` on a table, with a wall far away."""
    from loewner.cli.main import main

    (tmp_path / "s.urdf").write_text(urdf)
    (tmp_path / "s.yaml").write_text("bodies:\n  wall: {box: [1, 1, 1], position: [0, 9, 0]}\n")
    (tmp_path / "m.csv").write_text(table)
    files = [str(tmp_path / name) for name in ("s.urdf", "m.csv")]
    status = main(["audit", *files, "--scene", str(tmp_path / "s.yaml"), "--json", *map(str, arguments)])
    return status, json.loads(capsys.readouterr().out)


def test_velocities_are_the_extremes_of_the_polynomials(capsys, tmp_path):
    """A cubic from rest to rest is fastest in the middle, by one and a half times its mean."""
    status, answer = audited(capsys, tmp_path, "time,x,x velocity\n0,0,0\n2,1.2,0\n")
    use = next(use for use in answer["limits"] if use["quantity"] == "velocity")
    assert (status, answer["verdict"]) == (0, "FREE")
    assert use["ratio"] == pytest.approx(0.9)
    assert use["time"] == pytest.approx(1.0)
    status, answer = audited(capsys, tmp_path, "time,x,x velocity\n0,0,0\n1,1.2,0\n")
    assert (status, answer["verdict"], answer["exceeded"][0]["quantity"]) == (4, "FREE", "velocity")
    assert answer["exceeded"][0]["ratio"] == pytest.approx(1.8)


@pytest.mark.parametrize("order", [1, 2, 3])
def test_extremes_of_quintics_are_those_of_dense_samples(order):
    """No sample exceeds the extreme value, and one comes near it, for each derivative."""
    from loewner.planners import limit_use

    rng = np.random.default_rng(order)
    times = np.cumsum(rng.uniform(0.1, 2.0, 12))
    curve = BPoly(rng.normal(size=(6, 11, 1)), times)
    courses = curves.Curve(None, times, np.moveaxis(curve.c, 0, 1), np.zeros((11, 1)))
    (low, when_low), (high, when_high) = limit_use.extremes(limit_use._rates(courses, order)[..., 0], times)
    dense = np.concatenate([np.linspace(a, b, 2001)[1:-1] for a, b in zip(times[:-1], times[1:], strict=True)])
    values = curve(dense, order)[:, 0]
    assert low <= values.min() + 1e-9 * abs(low)
    assert high >= values.max() - 1e-9 * abs(high)
    assert values.max() == pytest.approx(high, rel=1e-2)
    for value, when in ((low, when_low), (high, when_high)):
        sides = [curve(np.nextafter(when, way), order)[0] for way in (-np.inf, np.inf)]
        assert min(abs(side - value) for side in sides) <= 1e-6 * abs(value)


@pytest.mark.parametrize(
    ("table", "told"),
    [
        ("time,x\n0,0\n800,0.4\n1600,0.9\n", "times may be in milliseconds"),
        ("time,x,x velocity\n0,0,0\n1,0.5,-0.5\n2,1,-0.5\n3,1.5,0\n", "velocities disagree with positions"),
        ("time,x,x velocity\n0,0,0\n1,0.1,0.5\n2,0.2,0.5\n3,0.3,0.5\n", "velocities disagree with positions"),
    ],
)
def test_what_is_odd_is_told(capsys, tmp_path, table, told):
    """Milliseconds for seconds, and velocities that are not those of the positions."""
    assert any(told in doubt for doubt in audited(capsys, tmp_path, table)[1]["doubts"])


def test_usual_trajectories_are_not_doubted(capsys, tmp_path):
    """Rest to rest, a turn within a piece, and points of a smooth curve."""
    times = np.linspace(0, 4, 21)
    x, v = np.sin(times), np.cos(times)
    smooth = "".join(f"{a},{b},{c}\n" for a, b, c in zip(times, x, v, strict=True))
    turned = "0,0,0.6728\n1,0.0638,-0.5452\n"  # a parabola
    for rows in (turned, "0,0,0\n1,0.5,0\n", "0,0,0\n1,0.5,0.6\n2,0.6,-0.2\n3,0.2,0\n", smooth):
        assert audited(capsys, tmp_path, f"time,x,x velocity\n{rows}")[1]["doubts"] == []


def test_corners_are_named(capsys, tmp_path):
    """A file without velocities has corners; a cubic through rest has none in velocity."""
    answer = audited(capsys, tmp_path, "time,x\n0,0\n1,0.5\n2,0.5\n3,0.2\n")[1]
    (jump,) = answer["jumps"]
    assert (jump["quantity"], jump["often"], jump["time"]) == ("velocity", 2, 1.0)
    assert jump["size"] == pytest.approx(0.5)
    answer = audited(capsys, tmp_path, "time,x,x velocity\n0,0,0\n1,0.5,0.2\n2,0.6,0\n")[1]
    assert [jump["quantity"] for jump in answer["jumps"]] == ["acceleration"]


def test_the_way_to_the_first_point_is_proven(capsys, tmp_path):
    """From where the robot stands, through a wall or not; too far for the time, or at once."""
    table = "time,x\n2,0\n3,0.5\n"
    assert audited(capsys, tmp_path, table, "--from", "0.5")[1]["before"]["verdict"] == "FREE"
    wall = SLIDE.replace("</robot>", "")
    assert wall
    status, answer = audited(capsys, tmp_path, table, "--from", "-3")
    assert "1.5 times" in answer["before"]["text"] or "1.5 of the velocity limit" in answer["before"]["text"]
    text = audited(capsys, tmp_path, "time,x\n0,0\n3,0.5\n", "--from", "-3")[1]["before"]["text"]
    assert "due at once" in text
    (tmp_path / "t.yaml").write_text("bodies:\n  wall: {box: [1, 1, 1], position: [-2, 0, 0]}\n")
    status, answer = audited(capsys, tmp_path, table, "--from", "-3", "--scene", tmp_path / "t.yaml")
    assert (status, answer["verdict"], answer["before"]["verdict"]) == (1, "FREE", "COLLIDING")


def test_limits_of_a_file_replace_those_of_the_robot(capsys, tmp_path):
    """--limits with a lower velocity, and an acceleration that the URDF does not know."""
    pytest.importorskip("yaml")
    Path(tmp_path / "l.yaml").write_text("joint_limits: {x: {max_velocity: 0.5, max_acceleration: 1.0}}")
    table = "time,x,x velocity\n0,0,0\n2,1.2,0\n"
    status, answer = audited(capsys, tmp_path, table, "--limits", tmp_path / "l.yaml")
    ratios = {use["quantity"]: use["ratio"] for use in answer["exceeded"]}
    assert status == 4
    assert ratios == {"velocity": pytest.approx(1.8), "acceleration": pytest.approx(1.8)}


@pytest.mark.verify
def test_a_thousand_curves_have_known_distances():
    """Slides and swings past a post, gaps and depths of 1 µm to 1 m, in 1 ms to 10 minutes, on 1 to 400 pieces."""
    rng, near = np.random.default_rng(59), 0
    for number in range(1000):
        gap = 10.0 ** rng.uniform(-6, 0)
        if number % 3 == 0:
            gap = -min(gap, 0.099)
        length, duration = 10.0 ** rng.uniform(-1, 2), 10.0 ** rng.uniform(-3, math.log10(600.0))
        share, knots = rng.uniform(0.01, 0.99), np.linspace(0.0, 1.0, int(rng.integers(2, 400)))
        checker = slide_past(share * length, gap)
        # Faster and slower along the same way, through the point beside the post.
        warped = np.clip(knots + rng.uniform(0, 0.15) * np.sin(2 * np.pi * knots), 0.0, 1.0)
        curve = CubicSpline(duration * knots, length * warped[:, None])
        found = checker.closest(curve)
        assert (found.lower <= found.distance).all()
        k = found.nearest
        assert found.lower.min() <= gap + 1e-12
        assert gap - 1e-9 <= found.distance[k] <= found.lower[k] + max(1e-5, 0.01 * abs(found.distance[k])) * (1 + 1e-9)
        near += found.close.mean()
    assert near >= 990


def test_the_thousand_curves_reach_the_post():
    """The warped ways of the long test pass every point between their ends."""
    knots = np.linspace(0.0, 1.0, 400)
    for size in (0.0, 0.075, 0.15):
        assert (np.diff(knots + size * np.sin(2 * np.pi * knots)) > 0).all()


def test_the_audit_measures_a_pair_that_may_touch_where_it_keeps_its_margin(tmp_path):
    """A ball that begins on a table is measured from it once it has left it; the contact is apart from that."""
    scene = Scene(margin=0.002)
    scene.add("post", Body.box([0.2, 0.2, 0.2]), at(-0.2, 0, 0))
    scene.leave("ball", "post")
    checker = CollisionChecker(Robot.from_urdf(text=SLIDE), scene)
    knots = [[0.0], [0.05], [0.5], [0.3], [0.6]]
    points = planners.ControllerPoints([0.0, 1.0, 2.0, 3.0, 4.0], knots)
    curve, found = curves.proven(checker, points, 0.0)
    assert found.verdict.name == "FREE"
    near, allowed, contacts = approaches.along(checker, curve, np.array([], dtype=np.int64))
    assert near.nearest == 1
    assert near.distance[1:] == pytest.approx([0.05, 0.3, 0.3], abs=1e-9)
    assert near.distance[0] == np.inf
    assert allowed["ball", "post"].distance[0] == pytest.approx(0.0, abs=1e-9)
    assert len(contacts) == 0


@pytest.mark.parametrize(("deep", "status"), [(0.0, 0), (0.0005, 0), (0.03, 1)])
def test_the_audit_refuses_contact_that_is_far_too_deep(capsys, tmp_path, deep, status):
    """`leave` takes any depth at the start as a fact; one of 30 mm is a wrong pose, unless --overlap allows it."""
    (tmp_path / "t.yaml").write_text(
        f"leave: [[ball, wall]]\nbodies:\n  wall: {{box: [1, 1, 1], position: [{-0.6 + deep}, 0, 0]}}\n"
    )
    table = "time,x,x velocity\n0,0,0\n2,0.5,0\n"
    found, answer = audited(capsys, tmp_path, table, "--scene", tmp_path / "t.yaml")
    assert (found, answer["verdict"], len(answer["deep"])) == (status, "FREE", status)
    assert audited(capsys, tmp_path, table, "--scene", tmp_path / "t.yaml", "--overlap", 0.05)[0] == 0


@pytest.mark.parametrize("degree", [3, 5])
def test_extremes_are_found_where_the_leading_coefficients_are_rounding(degree):
    """Parabolas as cubics or quintics, as a controller has them for constant accelerations: the peak is known."""
    from loewner.planners import limit_use

    rng = np.random.default_rng(degree)
    for _ in range(500):
        x0, v0, a = rng.uniform(-1, 1), rng.uniform(0.1, 2), -rng.uniform(0.5, 4)
        T = rng.uniform(1.01, 3) * -v0 / a
        c = [x0, v0, a / 2, *[0.0] * (degree - 2)]
        points = BPoly.from_power_basis(PPoly(np.array(c[::-1])[:, None], [0.0, T])).c.T
        (_, _), (high, when) = limit_use.extremes(points, np.array([0.0, T]))
        assert high == pytest.approx(x0 - v0 * v0 / (2 * a), abs=1e-9)
        assert when == pytest.approx(-v0 / a, abs=1e-4)


def test_the_way_to_the_first_point_meets_what_is_carried_later(capsys, tmp_path):
    """A body that the robot takes at its first point still stands there on the way."""
    bodies = "  can: {box: [0.1, 0.1, 0.1], position: [-1, 0, 0]}\n  wall: {box: [1, 1, 1], position: [0, 9, 0]}\n"
    (tmp_path / "t.yaml").write_text(f"bodies:\n{bodies}")
    arguments = ("--scene", tmp_path / "t.yaml", "--from", "-3", "--attach", "can=ball")
    status, answer = audited(capsys, tmp_path, "time,x\n9,0\n12,0.5\n", *arguments)
    assert (status, answer["verdict"], answer["before"]["verdict"]) == (1, "FREE", "COLLIDING")


def test_a_file_of_limits_keeps_accelerations_that_only_the_robot_has(capsys, tmp_path):
    """A file with a velocity alone does not remove the URDF's limits of acceleration and jerk."""
    urdf = SLIDE.replace('velocity="1"', 'velocity="1" acceleration="1" jerk="1"').replace(
        "<robot", '<robot version="1.2"'
    )
    (tmp_path / "l.yaml").write_text("joint_limits: {x: {max_velocity: 5}}")
    table = "time,x,x velocity\n0,0,0\n2,1.2,0\n"
    found = [audited(capsys, tmp_path, table, *more, urdf=urdf) for more in ((), ("--limits", tmp_path / "l.yaml"))]
    for status, answer in found:
        ratios = {use["quantity"]: use["ratio"] for use in answer["exceeded"]}
        assert status == 4
        assert ratios == {"acceleration": pytest.approx(1.8), "jerk": pytest.approx(1.8)}


def test_rates_that_overflow_are_beyond_every_limit(capsys, tmp_path):
    """Of a piece of hardly any time, the acceleration is no number; that is no use of 0."""
    urdf = SLIDE.replace('velocity="1"', 'velocity="1" acceleration="1"').replace("<robot", '<robot version="1.2"')
    status, answer = audited(capsys, tmp_path, "time,x,x velocity\n0,0,0\n1e-200,1,0\n", urdf=urdf)
    assert status == 4
    assert {use["quantity"] for use in answer["exceeded"]} == {"velocity", "acceleration"}
