"""Gates: what they let through is free until the robot stands still, and what they know is used only where it holds."""

import numpy as np
import pytest

import loewner
from loewner import Body, CollisionChecker, InputError, Joint, Robot, Scene, UnknownNameError, Verdict, planners
from loewner.planners import Gate, GateState
from loewner.queries.pose_paths import PackedPaths

ACCELERATION, JERK = 4.0, 60.0
DT = 0.02


def arm(**limits) -> Robot:
    """A slide with two links that turn, all of them capsules."""
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = [[0, 0, 1], [0, 1, 0], [-1, 0, 0]], [0.25, 0, 0]  # along x
    links = {"base": None, "cart": [(Body.sphere(0.05), None)]}
    links |= {name: [(Body.capsule(0.04, 0.5), T)] for name in ("upper", "lower")}
    step = np.eye(4)
    step[0, 3] = 0.55
    rates = {"velocity": 3.0, "acceleration": ACCELERATION} | limits
    joints = [
        Joint("rail", "prismatic", "base", "cart", axis=(1, 0, 0), lower=-2, upper=2, **rates),
        Joint("hip", "revolute", "cart", "upper", axis=(0, 0, 1), lower=-3, upper=3, **rates),
        Joint("knee", "revolute", "upper", "lower", T_parent_joint=step, axis=(0, 1, 0), lower=-3, upper=3, **rates),
    ]
    return Robot.from_links(links, joints)


def at(x: float, y: float = 0.0, z: float = 0.0) -> np.ndarray:
    """A pose without a turn."""
    T = np.eye(4)
    T[:3, 3] = x, y, z
    return T


def wall(x: float = 2.0) -> Scene:
    """A scene with a wall across the rail."""
    scene = Scene()
    scene.add("wall", Body.box([0.1, 4.0, 4.0]), at(x))
    return scene


def along_the_rail(speed: float, n: int, start: float = 0.0) -> np.ndarray:
    """Targets at a constant speed, with the arm to the side."""
    return np.column_stack([start + speed * DT * np.arange(1, n + 1), np.full(n, np.pi / 2), np.zeros(n)])


Q0, V0 = np.array([0.0, np.pi / 2, 0.0]), np.array([1.0, 0.0, 0.0])


def test_known_answers():
    """At 1 m/s and 4 m/s² a brake takes 0.25 s and 0.125 m; the cart's ball of 0.05 m stops at the wall's face."""
    gate = Gate(CollisionChecker(arm(), wall(1.1 + 0.05)))  # the face is at 1.1 m
    answer = gate.check(Q0, V0, along_the_rail(1.0, 60), DT)
    # The last target from which 0.125 m and a radius of 0.05 m are left of 1.1 m: below 0.925 m.
    assert (answer.state, answer.steps, answer.reason) == (GateState.PREFIX, 46, "brake")
    assert answer.names[1] == "wall"
    assert answer.is_proven
    assert answer.brake.duration == pytest.approx(0.25)
    assert answer.brake.knots[-1] == pytest.approx([0.92 + 0.125, np.pi / 2, 0.0])
    np.testing.assert_allclose(np.abs(answer.normal), [1, 0, 0], atol=1e-9)
    assert answer.distance <= 0.0
    # At half the speed, the brake takes a quarter of the way, so the chunk of 60 targets still ends in the wall.
    assert answer.scale == 0.0
    short = Gate(CollisionChecker(arm(), wall(1.1 + 0.05))).check(Q0, V0, along_the_rail(1.0, 50), DT)
    assert (short.state, short.steps, short.scale) == (GateState.PREFIX, 46, 0.5)
    free = Gate(CollisionChecker(arm(), wall(2.5))).check(Q0, V0, along_the_rail(1.0, 50), DT)
    assert (free.state, free.steps, free.scale, free.reason, free.names) == (GateState.GO, 50, 1.0, "", ())
    assert np.isnan(free.distance)


@pytest.mark.parametrize("brake", ["joints", "path"])
@pytest.mark.parametrize("jerk", [None, JERK])
@pytest.mark.parametrize(("x", "count"), [(0.5, 30), pytest.param(1.15, 60, marks=pytest.mark.verify)])
def test_the_last_chunk_has_a_proof_for_a_log(brake, jerk, x, count):
    """Another program proves the motions and the brakes from their ends again, with all deviations."""
    scene = wall(x)
    gate = Gate(CollisionChecker(arm(), scene), brake=brake, jerk=jerk, joint_error=1e-3, velocity_error=1e-2)
    with pytest.raises(InputError, match="expected a chunk that may run, found none"):
        gate.proof()
    targets = along_the_rail(1.0, count)
    answer = gate.check(Q0, V0, targets, DT)
    assert 0 < answer.steps < count  # the wall is in the way of the rest
    report = gate.proof().verify()
    points = [np.array(motion) for motion in report.points]
    assert all(np.all(ends[[0, -1], 0] <= x) for ends in points)
    for k in range(answer.steps):  # the chunk as it was given, and brakes that begin where its motions end
        np.testing.assert_array_equal(points[k][-1], targets[k])
        assert any(np.array_equal(piece[0], targets[k]) for piece in points[answer.steps :])
    assert all(error >= 1e-3 for _, error in report.deviations)
    scene.move("wall", at(x + 0.05))
    with pytest.raises(InputError, match="expected the scene of the last chunk that may run"):
        gate.proof()
    scene.follow("wall", [0.0], at(x)[None], speed=0.1, since=0.0)
    with pytest.raises(InputError, match="expected bodies at rest"):
        gate.proof()


def test_brakes_on_the_path_go_on_along_the_last_motion():
    """A chunk that ends in motion needs a stop behind its end; one that ends at rest does not."""
    for brake in ("path", "joints"):
        gate = Gate(CollisionChecker(arm(), wall(1.1 + 0.05)), brake=brake)
        answer = gate.check(Q0, V0, along_the_rail(1.0, 47), DT)
        assert (answer.steps, answer.reason) == (46, "brake"), brake
    targets = along_the_rail(1.0, 50)
    targets[40:] = targets[39]
    gate = Gate(CollisionChecker(arm(), wall(1.1 + 0.05)), brake="path")
    answer = gate.check(Q0, V0, targets, DT)
    assert (answer.state, answer.steps, answer.brake.duration) == (GateState.GO, 50, 0.0)


def test_latency_and_velocity_error_take_their_share():
    """Two periods more on the way, and the longer brake of 1.2 m/s: 0.18 m."""
    checker = CollisionChecker(arm(), wall(1.1 + 0.05))
    late = Gate(checker, latency=2 * DT).check(Q0, V0, along_the_rail(1.0, 60), DT)
    assert late.steps == 44
    assert late.brake.knots[0, 0] == pytest.approx(0.92)
    faster = Gate(checker, velocity_error=0.2).check(Q0, V0, along_the_rail(1.0, 60), DT)
    assert faster.steps == 43  # below 1.05 - 0.18 = 0.87 m
    off = Gate(checker, joint_error=[0.03, 0, 0]).check(Q0, V0, along_the_rail(1.0, 60), DT)
    assert off.steps == 44  # below 0.895 m
    jerky = Gate(checker, jerk=JERK).check(Q0, V0, along_the_rail(1.0, 60), DT)
    assert jerky.steps == 44  # 1 / 4 + 4 / 60 s: 0.158 m, below 0.892 m


def test_a_chunk_needs_more_targets_than_the_latency_has_periods():
    """Otherwise no order to brake would take effect within it: nothing passes, and nothing is called proven."""
    targets = along_the_rail(1.0, 4, start=1.0)  # the wall's face is 0.05 m in front of the cart
    gate = Gate(CollisionChecker(arm(), wall(1.15)), latency=4 * DT)
    for n in (1, 3, 4):
        answer = gate.check([1.0, np.pi / 2, 0.0], V0, targets[:n], DT)
        assert (answer.state, answer.steps, answer.scale, answer.is_proven) == (GateState.BRAKE, 0, 0.0, False)
    gate = Gate(CollisionChecker(arm(), wall(3.0)), latency=4 * DT)
    for n in (1, 4, 5):
        answer = gate.check(Q0, V0, along_the_rail(1.0, n), DT)
        assert (answer.state == GateState.GO, answer.steps) == (n == 5, max(n - 4, 0))
        assert answer.reason == ("" if n == 5 else "brake")


def test_a_slow_robot_brakes_from_the_nearest_tick():
    """Several ticks are within the tube of a slow chunk; the brake begins at the one where it is."""
    gate = Gate(CollisionChecker(arm(), wall(3.0)), joint_error=2.5e-3, velocity_error=1e-2)
    slow, targets = 0.05 * V0, along_the_rail(0.05, 40)
    assert gate.check(Q0, slow, targets[:20], DT).state == GateState.GO
    answer = gate.check(targets[9], slow, targets[10:30] + [9.0, 0.0, 0.0], DT)
    assert (answer.state, answer.reason, answer.is_proven) == (GateState.BRAKE, "limits", True)
    np.testing.assert_allclose(answer.brake.knots[0], targets[9], rtol=0, atol=1e-12)


def test_the_time_decides_where_a_slow_robot_is():
    """Off its command by two ticks, it is nearest to another one; the time of the tick has the one that it runs."""
    for time in (9 * DT, 0.0):  # a time that does not run on decides nothing
        gate = Gate(CollisionChecker(arm(), wall(3.0)), joint_error=2.5e-3, velocity_error=1e-2, latency=2 * DT)
        slow, targets = 0.05 * V0, along_the_rail(0.05, 40)
        assert gate.check(Q0, slow, targets[:30], DT, time=0.0).state == GateState.GO
        q = targets[10] + [1e-4, 0.0, 0.0]
        answer = gate.check(q, slow, targets[10:30] + [9.0, 0.0, 0.0], DT, time=time)
        assert answer.is_proven == (time > 0.0)
        np.testing.assert_allclose(answer.brake.knots[0], targets[10] if time > 0.0 else q, rtol=0, atol=1e-12)


def person_behind(gap: float) -> Scene:
    """A person who may come at 1 m/s, at a distance from the cart at its start."""
    scene = Scene()
    scene.add("person", Body.sphere(0.2))
    scene.follow("person", [0.0], at(-0.25 - gap)[None], speed=1.0, since=0.0)
    return scene


# At rest, a robot may go on at 0.4 m/s: 0.02 m and 0.1 s, with limits of jerk 0.033 m and 0.167 s. Meanwhile a person
# comes nearer, so that 0.31 m are enough for 9 periods of 0.02 m, or 5.
LATER = [(None, 9), (JERK, 5)]


@pytest.mark.parametrize(("jerk", "steps"), LATER)
def test_a_robot_that_is_faster_by_the_error_stands_later(jerk, steps):
    """A brake is proven until the robot stands, also if it lasts longer than at the velocities of the chunk."""
    gate = Gate(CollisionChecker(arm(), person_behind(0.31)), velocity_error=[0.4, 0.0, 0.0], jerk=jerk)
    answer = gate.check(Q0, 0.0 * V0, along_the_rail(0.0, 15), DT, time=0.0)
    assert (answer.state, answer.steps, answer.reason) == (GateState.PREFIX, steps, "may be hit")


def test_a_robot_at_rest_may_go_on():
    """At 0.5 m/s, it takes 0.03125 m to stand, in a world at rest as well."""
    for gap, state in ((0.031, GateState.BRAKE), (0.0315, GateState.GO)):
        gate = Gate(CollisionChecker(arm(), wall(0.1 + gap)), velocity_error=[0.5, 0.0, 0.0])
        answer = gate.check(Q0, 0.0 * V0, along_the_rail(0.0, 15), DT)
        assert answer.state == state
        assert answer.is_proven == (state == GateState.GO)


def test_targets_that_go_on_are_proven_again_from_the_last_command():
    """If the world has left its bounds: the velocity of the motion is the commands', not from the measured place."""
    scene = wall(3.0)
    scene.add("ball", Body.sphere(0.1), at(0.0, -1.0))
    gate, targets = gate_in_motion(scene)
    scene.move("ball", at(0.0, -1.001))
    off = targets[0] - [9e-4, 0.0, 0.0]  # by the motion from here, the velocity is 1.045 m/s
    answer = gate.check(off, V0, targets[1:2], DT, time=DT)
    assert answer.steps == 1
    np.testing.assert_allclose(answer.brake.rates[0], V0, rtol=0, atol=1e-9)
    other = gate.check(targets[1], V0, targets[2:3] + 1e-9, DT, time=2 * DT)  # others begin where the robot is
    assert other.brake.rates[0, 0] != pytest.approx(1.0, abs=1e-9)


def test_limits_end_a_chunk():
    """A target outside the limits, and one that is too fast, with the name of the joint."""
    gate = Gate(CollisionChecker(arm(), Scene()))
    targets = along_the_rail(1.0, 30)
    targets[20:, 1] = 3.2
    answer = gate.check(Q0, V0, targets, DT)
    assert (answer.state, answer.steps, answer.reason, answer.names) == (GateState.PREFIX, 20, "limits", ("hip",))
    answer = gate.check(Q0, V0, along_the_rail(3.5, 30), DT)
    assert (answer.state, answer.steps, answer.names) == (GateState.BRAKE, 0, ("rail",))
    assert answer.is_proven  # from the measured state
    assert answer.brake.duration == pytest.approx(0.25)


def test_position_limits_of_a_file_end_a_chunk(tmp_path):
    """They replace the robot's limits, as for trajectories."""
    limits = "{has_position_limits: true, min_position: 0, max_position: 0.1}"
    (tmp_path / "l.yaml").write_text(f"joint_limits: {{rail: {limits}}}")
    robot = arm()
    gate = Gate(CollisionChecker(robot, Scene()), planners.JointLimits.load(tmp_path / "l.yaml", robot))
    answer = gate.check(Q0, V0, along_the_rail(1.0, 30), DT)
    assert (answer.state, answer.steps, answer.reason) == (GateState.PREFIX, int(0.1 / DT), "limits")
    assert (answer.names, answer.scale) == (("rail",), 0.0)


def test_a_gate_is_a_name_of_the_library():
    """Also without an import of the planners."""
    assert loewner.Gate is Gate


def test_inside():
    """In contact already: nothing is proven."""
    answer = Gate(CollisionChecker(arm(), wall(0.05))).check(Q0, V0, along_the_rail(1.0, 5), DT)
    assert (answer.state, answer.steps, answer.reason, answer.is_proven) == (GateState.INSIDE, 0, "contact", False)
    assert answer.names == ("cart", "wall")
    assert answer.distance < 0.0


def test_a_chunk_that_goes_on_is_proven_only_where_it_is_new():
    """Tick by tick, with the same answers as a gate that knows nothing, for a small part of the work."""
    checker = CollisionChecker(arm(), wall(1.1 + 0.05))
    gate, targets = Gate(checker, velocity_error=1e-6), along_the_rail(1.0, 60)
    first = gate.check(Q0, V0, targets[:20], DT)
    for k in range(1, 30):
        q, dq = targets[k - 1], V0
        answer = gate.check(q, dq, targets[k : k + 20], DT)
        anew = Gate(checker, velocity_error=1e-6).check(q, dq, targets[k : k + 20], DT)
        assert (answer.state, answer.steps, answer.reason) == (anew.state, anew.steps, anew.reason)
        assert answer.work <= first.work / 4 or answer.reason == "brake"


def gate_in_motion(scene: Scene, **options) -> tuple[Gate, np.ndarray]:
    """A gate that has let a chunk through, and its targets."""
    gate = Gate(CollisionChecker(arm(), scene), joint_error=1e-3, velocity_error=1e-2, **options)
    targets = along_the_rail(1.0, 60)
    answer = gate.check(Q0, V0, targets[:20], DT, time=0.0)
    assert answer.state == GateState.GO
    return gate, targets


@pytest.mark.parametrize("change", ["position", "velocity", "targets", "structure", "moved", "margin", "period"])
def test_what_was_proven_is_used_only_where_it_holds(change):
    """A state outside the tube, other targets, or a body that moved: everything is proven again."""
    scene = wall(3.0)
    scene.add("ball", Body.sphere(0.1), at(0.0, -1.0))
    gate, targets = gate_in_motion(scene)
    q, dq, dt, rest = targets[0].copy(), V0.copy(), DT, targets[1:21].copy()
    if change == "position":
        q[2] += 1.1e-3
    elif change == "velocity":
        dq[2] += 1.1e-2
    elif change == "targets":
        rest[4, 2] += 1e-9
    elif change == "structure":
        scene.add("other", Body.sphere(0.1), at(0.0, -2.0))
    elif change == "moved":
        scene.move("ball", at(0.0, -1.001))
    elif change == "margin":
        scene.set_margin(0.01, "ball")
    else:
        dt *= 1.001
    again = gate.check(q, dq, rest, dt, time=DT)
    assert again.state == GateState.GO
    gate, targets = gate_in_motion(wall(3.0))
    same = gate.check(targets[0], V0, targets[1:21], DT, time=DT)
    assert same.state == GateState.GO
    assert again.work > 5 * same.work


# How a person may be seen again, and whether earlier proofs then hold.
SEEN = [
    ({"T": at(0.0, -2.0), "since": 0.0}, True),  # as before
    ({"T": at(0.01, -2.0), "since": DT, "error": (0.0, 0.0)}, True),  # seen again within its cone
    ({"T": at(0.03, -2.0), "since": DT}, False),  # seen outside
    ({"T": at(0.01, -2.0), "since": DT, "error": (0.02, 0.0)}, False),  # an error that pokes out
    ({"T": at(0.0, -2.0), "since": DT, "speed": 1.1}, False),  # faster
    ({"T": at(0.0, -2.0), "since": DT, "turn": 0.1}, False),
    ({"T": at(0.0, -2.0), "since": DT, "error": (0.0, 0.1)}, False),
    ({"T": at(0.0, -2.0), "since": 2 * DT}, False),  # from the future
]


@pytest.mark.parametrize(("seen", "is_within"), SEEN)
def test_a_person_who_is_seen_again(seen, is_within):
    """What was proven holds if the new places were allowed before, and only then."""
    scene = wall(3.0)
    scene.add("person", Body.sphere(0.2))
    scene.follow("person", [0.0], at(0.0, -2.0)[None], speed=1.0, since=0.0)
    gate, targets = gate_in_motion(scene)
    given = {"speed": 1.0, "error": None} | seen
    T = given.pop("T")
    scene.follow("person", [0.0], T[None], **given)
    answer = gate.check(targets[0], V0, targets[1:21], DT, time=DT)
    alone, _ = gate_in_motion(wall(3.0))
    fresh = Gate(gate.checker, joint_error=1e-3, velocity_error=1e-2)
    whole = fresh.check(targets[0], V0, targets[1:21], DT, time=DT)
    assert (answer.work < whole.work / 3) == is_within
    assert answer.state == GateState.GO


def test_what_was_proven_after_a_sighting_holds_for_it_alone():
    """New targets are proven for the cone of the second sighting; the third one leaves it, but not the first cone.

    Seen at 0 s, the person may be 0.04 m away two periods later, and 0.02 m by what was seen after one period.
    """
    scene = wall(3.0)
    scene.add("person", Body.sphere(0.2))
    work = []
    for last in (0.01, 0.03):
        scene.follow("person", [0.0], at(0.0, -2.0)[None], speed=1.0, since=0.0)
        gate, targets = gate_in_motion(scene)
        scene.follow("person", [0.0], at(0.0, -2.0)[None], speed=1.0, since=DT)
        gate.check(targets[0], V0, targets[1:21], DT, time=DT)
        scene.follow("person", [0.0], at(last, -2.0)[None], speed=1.0, since=2 * DT)
        work.append(gate.check(targets[1], V0, targets[2:22], DT, time=2 * DT).work)
    assert work[1] > 3 * work[0]


def test_a_forecast_that_changes_is_proven_again():
    """A body that follows a motion, and then another one."""
    scene = wall(3.0)
    scene.add("ball", Body.sphere(0.1))
    scene.follow("ball", [0.0, 5.0], np.stack([at(0.0, -2.0), at(0.0, -1.5)]))
    gate, targets = gate_in_motion(scene)
    same = gate.check(targets[0], V0, targets[1:21], DT, time=DT)
    scene.follow("ball", [0.0, 5.0], np.stack([at(0.0, -2.0), at(0.0, -1.4)]))
    again = gate.check(targets[1], V0, targets[2:22], DT, time=2 * DT)
    assert again.work > 5 * same.work
    early = gate.check(targets[2], V0, targets[3:23], DT, time=2.5 * DT)  # between ticks
    assert early.work > 5 * same.work


def test_the_last_proven_brake_is_executed():
    """A new chunk that leads into the wall at once: the robot brakes as it was proven to."""
    scene = wall(1.0)
    gate = Gate(CollisionChecker(arm(), scene))
    targets = along_the_rail(1.0, 20)
    first = gate.check(Q0, V0, targets, DT)
    assert first.state == GateState.GO
    bad = targets[5:].copy()
    bad[0, 0] += 0.05
    bad[1:, 0] = 1.2
    answer = gate.check(targets[4], V0, bad, DT)
    assert (answer.state, answer.is_proven) == (GateState.BRAKE, True)
    np.testing.assert_allclose(answer.brake.knots[0], targets[4])
    certified = answer.brake.certify(gate.checker)
    assert certified.verdict == Verdict.FREE


@pytest.mark.parametrize("jerk", [None, 50.0])
def test_brakes_far_from_few_bodies_take_one_proof(jerk):
    """With one body far away, a tick that goes on proves one motion and one brake."""
    gate = Gate(CollisionChecker(arm(), wall(5.0)), jerk=jerk)
    path = along_the_rail(0.5, 42) + 0.01 * np.arange(42)[:, None] * np.array([0.0, 0.7, 0.3])
    first = gate.check(path[0], V0, path[1:21], DT)
    on = gate.check(path[1], (path[1] - path[0]) / DT, path[2:22], DT)
    assert (first.state, on.state) == (GateState.GO, GateState.GO)
    assert 0 < on.work <= first.work / 10


def test_what_failed_is_forgotten_with_its_targets():
    """After a chunk with fewer targets, others may follow, which are proven anew."""
    gate = Gate(CollisionChecker(arm(), wall(1.0)))
    into = along_the_rail(1.0, 40)
    assert gate.check(Q0, V0, into, DT).state == GateState.PREFIX
    few = gate.check(Q0, V0, into[:3], DT)
    other = np.concatenate([into[:3], np.repeat(into[2:3], 37, axis=0)])
    anew = Gate(CollisionChecker(arm(), wall(1.0))).check(Q0, V0, other, DT)
    assert few.state == GateState.GO
    assert (gate.check(Q0, V0, other, DT).steps, GateState.GO) == (anew.steps, anew.state)


def test_budgets_end_the_work():
    """With too few steps nothing is let through, and the reason is the budget."""
    answer = Gate(CollisionChecker(arm(), wall(1.0)), steps=10).check(Q0, V0, along_the_rail(1.0, 40), DT)
    assert (answer.state, answer.reason) == (GateState.BRAKE, "budget")
    for steps in (100, 300, 1000):
        gate = Gate(CollisionChecker(arm(), wall(1.0)), steps=steps)
        answer = gate.check(Q0, V0, along_the_rail(1.0, 40), DT)
        assert answer.work <= steps + 200


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"q": [0.0, np.nan, 0.0]}, "q"),
        ({"dq": [0.0, 0.0]}, "dq"),
        ({"targets": np.zeros((0, 3))}, "targets"),
        ({"targets": [[0.0, 0.0, np.inf]]}, "targets"),
        ({"targets": [[1e308, 0.0, 0.0]]}, "finite velocities"),
        ({"q": [0.0, -1e308, 0.0]}, "finite velocities"),
        ({"dt": 0.0}, "dt"),
        ({"time": np.nan}, "time"),
        ({"time": -1.0}, "time: expected one that is no earlier"),
    ],
)
def test_bad_ticks_are_refused(arguments, words):
    """Each with the name of the argument; the gate goes on afterwards."""
    gate, targets = gate_in_motion(wall(3.0))
    given = {"q": targets[0], "dq": V0, "targets": targets[1:21], "dt": DT, "time": DT}
    with pytest.raises(InputError, match=words):
        gate.check(**given | arguments)
    assert gate.check(**given).state == GateState.GO


def test_bad_gates_are_refused():
    """Errors of the constructor."""
    checker = CollisionChecker(arm(), Scene())
    for options in ({"latency": -1.0}, {"joint_error": [1.0]}, {"steps": 0}, {"horizon": 0.0}, {"velocity_error": -1}):
        with pytest.raises(InputError, match=next(iter(options))):
            Gate(checker, **options)
    with pytest.raises(UnknownNameError, match="brake"):
        Gate(checker, brake="hard")
    with pytest.raises(InputError, match="acceleration"):
        Gate(CollisionChecker(arm(acceleration=None), Scene()))
    with pytest.raises(InputError, match="checker"):
        Gate(arm())
    scene = wall(3.0)
    scene.add("person", Body.sphere(0.2))
    scene.follow("person", [0.0], np.eye(4)[None], speed=1.0)
    with pytest.raises(InputError, match="time: expected the time of the tick"):
        Gate(CollisionChecker(arm(), scene)).check(Q0, V0, along_the_rail(1.0, 5), DT)


# -- simulated chunks ------------------------------------------------------------------------------

ERROR, RATE_ERROR = np.full(3, 2e-3), np.full(3, 2e-2)
MOMENTS = 8  # per period, at which contact is looked for


class Course:
    """A robot that runs random chunks through a gate, beside a body that moves as badly as its bounds allow.

    Attributes
    ----------
    ticks, stops, hits : int
        How many ticks were run, how often the robot braked, and at how many moments it was in contact before it stood.
    """

    def __init__(self, seed: int, brake: str, jerk: float | None, gate: type[Gate] = Gate) -> None:
        self.rng = rng = np.random.default_rng(seed)
        self.robot, self.scene = arm(), Scene()
        for k in range(4):
            self.scene.add(f"box {k}", Body.box(rng.uniform(0.1, 0.4, 3)), at(*rng.uniform(-1.5, 1.5, 3)))
        still = self.scene.copy()
        person = Body.sphere(float(rng.uniform(0.05, 0.2)))
        self.scene.add("person", person)
        still.add("person", person)
        self.truth, self.place = CollisionChecker(self.robot, still), rng.uniform(-1.5, 1.5, 3)
        self.speed = float(rng.uniform(0.1, 0.6)) if seed % 3 else 0.0  # some stand, so that the world stands still
        self.scene.move("person", at(*self.place))
        self.see(0.0)
        self.checker, self.late = CollisionChecker(self.robot, self.scene), int(rng.integers(0, 3))
        self.gate = gate(
            self.checker, brake=brake, jerk=jerk, joint_error=ERROR, velocity_error=RATE_ERROR, latency=self.late * DT
        )
        self.ticks = self.stops = self.hits = 0

    def see(self, t: float) -> None:
        """The place of a person who moves is known at a time, with an error, and nothing later."""
        if self.speed == 0.0:
            return
        off = self.rng.normal(size=3)
        off *= self.rng.uniform(0.0, 0.01) / np.linalg.norm(off)
        self.scene.follow("person", [t], at(*(self.place + off))[None], speed=self.speed, since=t, error=(0.01, 0.0))

    def look(self, command: np.ndarray, seconds: float) -> None:
        """Whether the robot, off its command, touches anything, after the person has moved for some seconds."""
        links = self.robot.forward_kinematics(command)[1:, :3, 3]
        way = links[self.rng.integers(len(links))] - self.place if self.rng.random() < 0.8 else self.rng.normal(size=3)
        self.place = self.place + 0.999 * self.speed * seconds * way / max(float(np.linalg.norm(way)), 1e-9)
        self.truth.scene.move("person", at(*self.place))
        self.real = command + self.rng.uniform(-1.0, 1.0, 3) * ERROR
        self.hits += bool(self.truth.collide(self.real))

    def chunk(self, q: np.ndarray) -> np.ndarray:
        """Random targets, some of them towards nothing good."""
        s = DT * np.arange(1, int(self.rng.integers(8, 30)))[:, None]
        way, bend = self.rng.normal(size=3) * self.rng.uniform(0.2, 2.0), self.rng.normal(size=3)
        rows = q + way * s + self.rng.uniform(0.0, 2.0) * bend * s * s
        return np.clip(rows, self.robot.lower, self.robot.upper)

    def run(self, ticks: int) -> "Course":
        """Run until the robot has braked, or for some ticks."""
        free = self.robot.random_configurations(60, seed=int(self.rng.integers(2**31)))
        free = free[~self.checker.collide(free, 0.0)]
        if len(free) == 0:
            return self
        q, rate, t, running = free[0], np.zeros(3), 0.0, np.empty((0, 3))
        self.real = q
        while self.ticks < ticks:
            wanted = self.chunk(q) if len(running) < 4 or self.rng.random() < 0.1 else running
            if self.rng.random() < 0.4:
                self.see(t)
            noisy = rate + self.rng.uniform(-1.0, 1.0, 3) * RATE_ERROR
            answer = self.gate.check(self.real, noisy, wanted, DT, time=t)
            if answer.steps > 0:
                start = q if wanted is running else self.real
                running = wanted
                q, rate, running = self.motion(start, running)
                t, self.ticks = t + DT, self.ticks + 1
                continue
            if answer.state == GateState.BRAKE and answer.is_proven:
                for _ in range(self.late if len(running) else 0):
                    q, rate, running = self.motion(q, running)
                self.stops += 1
                brake = answer.brake
                for k in range(1, int(np.ceil(brake.duration / DT * MOMENTS)) + 1):
                    self.look(brake.positions(min(k * DT / MOMENTS, brake.duration)), DT / MOMENTS)
            break
        return self

    def motion(self, q: np.ndarray, running: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Go on to the next target."""
        for k in range(1, MOMENTS + 1):
            self.look(q + k / MOMENTS * (running[0] - q), DT / MOMENTS)
        return running[0], (running[0] - q) / DT, running[1:]


def courses(count: int, gate: type[Gate] = Gate, seed: int = 0) -> tuple[int, int, int]:
    """Ticks, stops and moments of contact of many runs."""
    made = [Course(seed + k, ("joints", "path")[k % 2], (None, JERK)[k // 2 % 2], gate).run(150) for k in range(count)]
    return sum(c.ticks for c in made), sum(c.stops for c in made), sum(c.hits for c in made)


@pytest.mark.verify
def test_chunks_meet_nothing_before_standstill():
    """Whatever bodies do within their bounds, and the robot within its errors."""
    ticks, stops, hits = courses(16)
    assert hits == 0
    assert ticks > 300
    assert stops > 10


class WithoutBrakes(Gate):
    """Counts every motion that is free as one from whose end the robot can brake."""

    def _proven(self, ready, chunk):
        chunk, block = super()._proven(ready, chunk)
        return chunk._replace(braked=chunk.motions), block if chunk.motions < len(chunk.rows) - 1 else None


class OffAsOn(Gate):
    """Proves brakes on the path, and brakes joint by joint."""

    def _proven(self, ready, chunk):
        self._on_path, real = True, self._on_path
        found = super()._proven(ready, chunk)
        self._on_path = real
        return found


class WithoutJerk(Gate):
    """Proves brakes whose accelerations jump, and brakes with limits of jerk."""

    def _proven(self, ready, chunk):
        self._jerk, real = None, self._jerk
        found = super()._proven(ready, chunk)
        self._jerk = real
        return found


@pytest.mark.parametrize(("mutant", "seed"), [(WithoutBrakes, 5000), (WithoutJerk, 5000), (OffAsOn, 5940)])
def test_gates_that_are_wrong_are_found_out(mutant, seed):
    """The same chunks meet something if a gate proves less, or something else; with each brake, four runs suffice."""
    assert courses(4, mutant, seed)[2] > 0


def test_growth_that_is_dropped_is_found_out(monkeypatch):
    """Likewise if bodies are taken to be where they were seen."""
    off = PackedPaths.off

    def none(self, *times):
        return off(self, *times) * [1.0, 0.0, 0.0]

    monkeypatch.setattr(PackedPaths, "off", none)
    assert courses(4, seed=5012)[2] > 0


@pytest.mark.verify
def test_many_chunks_meet_nothing_before_standstill():
    """The same, until a hundred thousand ticks have been run."""
    ticks = stops = 0
    for block in range(400):
        more, braked, hits = courses(100, seed=1000 + 100 * block)
        assert hits == 0
        ticks, stops = ticks + more, stops + braked
        if ticks > 100_000:
            break
    print(f"{ticks} ticks, {stops} brakes, no contact before standstill")
    assert ticks > 100_000
