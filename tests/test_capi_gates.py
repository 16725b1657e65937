"""Gates of the library for C hold their answers against Python's, tick by tick."""

import ctypes
from pathlib import Path

import numpy as np
import pytest
import trimesh

from loewner import Body, CollisionChecker, Robot, Scene
from loewner.planners import Gate, GateState
from native_files import needs_library
from sampling import quick
from test_gates import DT, JERK, LATER, Q0, SEEN, V0, along_the_rail, arm, at, person_behind, wall

pytestmark = needs_library

capi = pytest.importorskip("capi")
REASONS = ("", "contact", "brake", "may be hit", "limits", "budget")
MOST, OVERFLOW = 60, 9


class Both:
    """A gate of Python and one of the library, for the same scene."""

    def __init__(self, scene: Scene, folder: Path, robot=None, **options) -> None:
        self.robot, self.scene = robot or arm(), scene
        still = scene.copy()
        for name in list(scene.bounds):
            still.detach(name, at(*scene.following[name].positions[0]))
        CollisionChecker(self.robot, still).save(folder / "cell.lwn")
        self.python = Gate(CollisionChecker(self.robot, scene), **options)
        self.checker = capi.Checker(folder / "cell.lwn")
        for name in scene.bounds:
            self.see(name)
        given = {"acceleration": self.robot.acceleration, "wants_scale": 1} | options
        self.mine = capi.Gate(self.checker, MOST, **given)
        self.states: list[GateState] = []

    def see(self, name: str) -> None:
        """Let the library know what Python does of a body that rests."""
        its = self.scene.bounds[name]
        self.checker.move(name, at(*self.scene.following[name].positions[0]))
        numbers = {key: getattr(its, key) for key in ("metres", "radians", "speed", "turn", "since")}
        self.checker.set_bounds(name, **numbers)

    def check(self, q, dq, targets, dt=DT, time=0.0):
        """Ask both, and expect the same answers."""
        wanted = self.python.check(q, dq, targets, dt, time=time)
        found = self.mine.check(q, dq, targets, dt, time)
        got = (found.state, found.steps, REASONS[found.reason], found.is_proven, found.scale)
        assert got == (wanted.state, wanted.steps, wanted.reason, wanted.is_proven, wanted.scale)
        self.states.append(wanted.state)
        if wanted.state != GateState.INSIDE:  # of several pairs in contact, Python names the deepest one
            names = tuple(capi.ask("checker_body_name", self.checker, b).decode() for b in found.bodies if b >= 0)
            if found.joint >= 0:
                names = (capi.ask("checker_value_name", self.checker, found.joint).decode(),)
            assert names == wanted.names
        if wanted.state == GateState.GO:  # otherwise Python goes on behind what is not free
            assert found.work == (pytest.approx(wanted.work, rel=0.1) if self.scene.bounds else wanted.work)
        brake = wanted.brake
        assert found.begins == pytest.approx(brake.start_time - time, abs=1e-9)
        times, positions, velocities, accelerations = self.mine.brake(found)
        assert np.array_equal(times, brake.times)
        assert np.array_equal(positions, brake.knots)
        assert np.array_equal(velocities, brake.rates)
        if brake.bends is not None:
            assert np.array_equal(accelerations, brake.bends)
        return wanted, found


def random_scene(rng) -> Scene:
    scene = Scene()
    for k in range(4):
        scene.add(f"box {k}", Body.box(rng.uniform(0.1, 0.4, 3)), at(*rng.uniform(-1.5, 1.5, 3)))
    return scene


@pytest.mark.parametrize("brake", ["joints", "path"])
@pytest.mark.parametrize("jerk", [None, JERK])
@pytest.mark.parametrize("grows", [False, True])
@pytest.mark.parametrize("count", quick(2, 12))
def test_chunks_are_judged_as_in_python(tmp_path, brake, jerk, grows, count):
    """Random chunks, tick by tick: states, steps, reasons, pairs, scales and brakes."""
    states = set()
    for seed in range(count):
        rng = np.random.default_rng(seed)
        scene = random_scene(rng)
        if grows:
            scene.add("person", Body.sphere(0.1))
            place = rng.uniform(-1.5, 1.5, 3)
            scene.follow("person", [0.0], at(*place)[None], speed=0.3, since=0.0, error=(0.01, 0.0))
        late = int(rng.integers(0, 3)) * DT
        both = Both(scene, tmp_path, brake=brake, jerk=jerk, joint_error=2e-3, velocity_error=2e-2, latency=late)
        q = both.robot.random_configurations(20, seed=seed)[int(rng.integers(20))]
        dq, t, running = np.zeros(3), 0.0, np.empty((0, 3))
        for _ in range(40):
            if len(running) < 4 or rng.random() < 0.1:
                s = DT * np.arange(1, int(rng.integers(8, 30)))[:, None]
                running = q + rng.normal(size=3) * rng.uniform(0.2, 2.0) * s + rng.normal(size=3) * s * s
            elif rng.random() < 0.7:  # the chunk goes on
                running = np.vstack([running, 2 * running[-1] - running[-2] + rng.uniform(-1e-3, 1e-3, 3)])[:MOST]
            if grows and rng.random() < 0.3:
                place = place + rng.uniform(-1, 1, 3) * 2e-3
                scene.follow("person", [t], at(*place)[None], speed=0.3, since=t, error=(0.01, 0.0))
                both.see("person")
            off = rng.uniform(-1, 1, 3)
            answer, _ = both.check(q + 2e-3 * off, dq + 2e-2 * off, running, time=t)
            if answer.steps == 0:
                break
            q, dq, running, t = running[0], (running[0] - q) / DT, running[1:], t + DT
        states |= set(both.states)
    assert len(states) >= min(3, count)


CHANGES = ["none", "position", "velocity", "targets", "structure", "moved", "margin", "period"]


@pytest.mark.parametrize("change", CHANGES)
def test_what_was_proven_is_used_as_in_python(tmp_path, change):
    """A state outside the tube, other targets, or a body that moved: everything is proven again."""
    scene = wall(3.0)
    scene.add("ball", Body.sphere(0.1), at(0.0, -1.0))
    both, targets = Both(scene, tmp_path, joint_error=1e-3, velocity_error=1e-2), along_the_rail(1.0, 60)
    whole, _ = both.check(Q0, V0, targets[:20])
    q, dq, dt, rest = targets[0].copy(), V0.copy(), DT, targets[1:21].copy()
    if change == "position":
        q[2] += 1.1e-3
    elif change == "velocity":
        dq[2] += 1.1e-2
    elif change == "targets":
        rest[4, 2] += 1e-9
    elif change == "structure":
        scene.remove("ball")
        both.checker.set_present("ball", False)
    elif change == "moved":
        scene.move("ball", at(0.0, -1.001))
        both.checker.move("ball", at(0.0, -1.001))
    elif change == "margin":
        scene.set_margin(0.01, "wall")
        for body in both.robot.link_names[1:]:
            both.checker.set_margin(body, "wall", 0.01)
    elif change == "period":
        dt *= 1.001
    _, found = both.check(q, dq, rest, dt, time=DT)
    assert (found.work < whole.work / 4) == (change == "none")


@pytest.mark.parametrize(("seen", "is_within"), SEEN)
@pytest.mark.parametrize("late", [0.0, 0.3 * DT])
def test_a_person_who_is_seen_again(tmp_path, seen, is_within, late):
    """What was proven holds if the new places were allowed before, and at a tick."""
    scene = wall(3.0)
    scene.add("person", Body.sphere(0.2))
    scene.follow("person", [0.0], at(0.0, -2.0)[None], speed=1.0, since=0.0)
    both, targets = Both(scene, tmp_path, joint_error=1e-3, velocity_error=1e-2), along_the_rail(1.0, 60)
    whole, _ = both.check(Q0, V0, targets[:20])
    given = {"speed": 1.0, "error": None} | seen
    scene.follow("person", [0.0], given.pop("T")[None], **given)
    both.see("person")
    _, found = both.check(targets[0], V0, targets[1:21], time=DT + late)
    assert (found.work < whole.work / 3) == (is_within and late == 0.0)


def test_what_was_proven_after_a_sighting_holds_for_it_alone(tmp_path):
    """The third sighting is within the first cone, and outside the second one, for which new targets were proven."""
    scene, work = wall(3.0), []
    scene.add("person", Body.sphere(0.2))
    for last in (0.01, 0.03):
        scene.follow("person", [0.0], at(0.0, -2.0)[None], speed=1.0, since=0.0)
        both, targets = Both(scene, tmp_path, joint_error=1e-3, velocity_error=1e-2), along_the_rail(1.0, 60)
        both.check(Q0, V0, targets[:20])
        for k, x in ((1, 0.0), (2, last)):
            scene.follow("person", [0.0], at(x, -2.0)[None], speed=1.0, since=k * DT)
            both.see("person")
            _, found = both.check(targets[k - 1], V0, targets[k : k + 20], time=k * DT)
        work.append(found.work)
    assert work[1] > 3 * work[0]


@pytest.mark.parametrize("brake", ["joints", "path"])
def test_a_stop_is_remembered_while_the_world_is_the_same(tmp_path, brake):
    """A motion or a brake that failed is not tried again, until a body that was near is seen to be farther away."""
    scene, targets = wall(3.0), along_the_rail(1.0, 60)
    scene.add("person", Body.sphere(0.1))
    scene.follow("person", [0.0], at(1.1)[None], speed=0.05, since=0.0, error=(0.1, 0.0))
    given = {"joint_error": 1e-3, "velocity_error": 1e-2}
    both = Both(scene, tmp_path, brake=brake, **given)
    quiet = capi.Gate(both.checker, MOST, acceleration=both.robot.acceleration, brake=brake, **given)  # without scales
    first, _ = both.check(Q0, V0, targets)
    quiet.check(Q0, V0, targets, DT, 0.0)
    assert first.state == GateState.PREFIX
    for k in range(1, 5):  # the same targets, seen from later ticks
        wanted, _ = both.check(targets[k - 1], V0, targets[k:], time=k * DT)
        assert (wanted.steps, wanted.reason, wanted.names) == (first.steps - k, first.reason, first.names)
        assert wanted.distance == pytest.approx(first.distance)
        assert quiet.check(targets[k - 1], V0, targets[k:], DT, k * DT).work == 0
    scene.follow("person", [0.0], at(1.1)[None], speed=0.05, since=0.0, error=(0.02, 0.0))
    both.see("person")
    wanted, _ = both.check(targets[4], V0, targets[5:], time=5 * DT)
    assert wanted.steps > first.steps - 5
    assert quiet.check(targets[4], V0, targets[5:], DT, 5 * DT).work > 0


@pytest.mark.parametrize("more", [[0.02, 0.0, 0.0], [-0.02, 0.0, 0.0]])
def test_a_stop_behind_the_last_target_is_tried_again_with_more_targets(tmp_path, more):
    """A brake that went on along the last motion ends elsewhere if the next targets turn back."""
    both, targets = Both(wall(1.15), tmp_path, brake="path"), along_the_rail(1.0, 47)
    first, _ = both.check(Q0, V0, targets)
    assert (first.steps, first.reason) == (46, "brake")
    later = np.vstack([targets[1:], targets[-1] + np.arange(1, 11)[:, None] * more])
    wanted, _ = both.check(targets[0], V0, later)
    anew, _ = Both(wall(1.15), tmp_path, brake="path").check(targets[0], V0, later)
    assert (wanted.state, wanted.steps) == (anew.state, anew.steps)


@pytest.mark.parametrize(("jerk", "steps"), LATER)
def test_a_robot_that_is_faster_by_the_error_stands_later(tmp_path, jerk, steps):
    """Brakes are proven until the robot stands, and at rest it may go on, in a world at rest as well."""
    both = Both(person_behind(0.31), tmp_path, velocity_error=[0.4, 0.0, 0.0], jerk=jerk)
    assert both.check(Q0, 0.0 * V0, along_the_rail(0.0, 15))[1].steps == steps
    for gap, state in ((0.031, GateState.BRAKE), (0.0315, GateState.GO)):
        both = Both(wall(0.1 + gap), tmp_path, velocity_error=[0.5, 0.0, 0.0])
        assert both.check(Q0, 0.0 * V0, along_the_rail(0.0, 15))[1].state == state


@pytest.mark.parametrize("time", [0.0, 9 * DT])
def test_the_time_decides_where_a_slow_robot_is(tmp_path, time):
    """Off its command by two ticks, it is nearest to another one."""
    options = {"joint_error": 2.5e-3, "velocity_error": 1e-2, "latency": 2 * DT}
    both, slow, targets = Both(wall(3.0), tmp_path, **options), 0.05 * V0, along_the_rail(0.05, 40)
    both.check(Q0, slow, targets[:30])
    bad = targets[10:30] + [9.0, 0.0, 0.0]
    _, found = both.check(targets[10] + [1e-4, 0.0, 0.0], slow, bad, time=time)
    q = targets[10] + (time == 0.0) * np.array([1e-4, 0.0, 0.0])
    assert both.mine.brake(found)[1][0] == pytest.approx(q, abs=1e-12)


@pytest.mark.parametrize("brake", ["joints", "path"])
def test_a_robot_that_ran_farther_than_it_may_is_looked_at_anew(tmp_path, brake):
    """Inside a solid, motions are free of its surface: only an exact test of the start finds that."""
    scene = Scene()
    scene.add("block", Body.from_surface(trimesh.creation.box([1.2, 4.0, 4.0])), at(1.4))
    both, targets = Both(scene, tmp_path, brake=brake, joint_error=1e-3, velocity_error=1e-2), along_the_rail(1.0, 60)
    assert both.check(Q0, V0, targets)[0].state == GateState.PREFIX
    wanted, _ = both.check(along_the_rail(1.0, 1, 1.38)[0], V0, along_the_rail(1.0, 8, 1.4))
    assert wanted.state == GateState.INSIDE
    both.check(Q0, V0, along_the_rail(1.0, 60), time=1.0)
    wanted, _ = both.check(targets[54], V0, targets[55:], time=1.0 + 55 * DT)  # the ball is in the block
    assert wanted.state == GateState.INSIDE


def test_slower_chunks_brake_after_the_same_latency(tmp_path):
    """At half of the speed it is half as many periods, and brakes from earlier targets count."""
    scene = Scene()
    for x in (-0.3, 0.3):
        scene.add(f"wall {x}", Body.box([0.1, 4.0, 4.0]), at(x))
    steps = np.r_[0.04 * np.ones(3), -0.004 * np.arange(1, 4), -0.02 * np.arange(1, 12)]  # quick, and slowly back
    x = np.r_[np.cumsum(steps[:3]), 0.12 + steps[3:6], 0.108 + steps[6:]]
    targets = np.column_stack([x, np.full(len(x), np.pi / 2), np.zeros(len(x))])
    for late in (0, 1, 3, 4):
        wanted, _ = Both(scene, tmp_path, latency=late * DT).check(Q0, 2.0 * V0, targets)
        if wanted.scale > 0.0:
            slower = Gate(CollisionChecker(arm(), scene), latency=late * DT)
            found = slower.check(Q0, 2.0 * wanted.scale * V0, targets, DT / wanted.scale)
            assert found.state == GateState.GO


@pytest.mark.parametrize("time", [0.0, 6 * DT])
def test_with_a_latency_the_tick_has_to_be_known(tmp_path, time):
    """A chunk rests, and then goes: where the robot will brake depends on how long it has rested."""
    both = Both(wall(1.15), tmp_path, latency=2 * DT)
    both.check(Q0, 0.0 * V0, np.vstack([np.tile(Q0, (6, 1)), along_the_rail(2.0, 8)]))
    wanted, _ = both.check(Q0, 0.0 * V0, along_the_rail(2.9, 30, 0.9), time=time)
    assert (wanted.state, wanted.is_proven) == (GateState.BRAKE, time > 0.0)
    assert wanted.brake.knots[0, 0] == pytest.approx(0.08 if time > 0.0 else 0.0)


def test_targets_that_go_on_are_proven_again_from_the_last_command(tmp_path):
    """If the world has left its bounds, the velocity is that of the commands."""
    scene = wall(3.0)
    scene.add("ball", Body.sphere(0.1), at(0.0, -1.0))
    both, targets = Both(scene, tmp_path, joint_error=1e-3, velocity_error=1e-2), along_the_rail(1.0, 60)
    both.check(Q0, V0, targets[:20])
    scene.move("ball", at(0.0, -1.001))
    both.checker.move("ball", at(0.0, -1.001))
    _, found = both.check(targets[0] - [9e-4, 0.0, 0.0], V0, targets[1:2], time=DT)
    assert both.mine.brake(found)[2][0] == pytest.approx(V0, abs=1e-9)


def test_a_body_that_turns_is_known_by_its_turn(tmp_path):
    """A pose that is turned by less than was allowed, and by more."""
    scene = wall(3.0)
    scene.add("box", Body.box([0.2, 0.3, 0.4]))
    scene.follow("box", [0.0], at(0.0, -2.0)[None], turn=1.0, since=0.0)
    for angle in (0.9 * DT, 1.1 * DT):
        both, targets = Both(scene, tmp_path, joint_error=1e-3, velocity_error=1e-2), along_the_rail(1.0, 60)
        whole, _ = both.check(Q0, V0, targets[:20])
        T = at(0.0, -2.0)
        T[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
        both.checker.move("box", T)
        both.checker.set_bounds("box", metres=0.0, radians=0.0, speed=0.0, turn=1.0, since=DT)
        found = both.mine.check(targets[0], V0, targets[1:21], DT, DT)
        assert (found.work < whole.work / 3) == (angle < DT)


def test_a_brake_on_the_path_is_the_one_that_was_proven(tmp_path):
    """A brake that ended behind the last target does not turn with targets that came later."""
    both = Both(wall(1.5), tmp_path, brake="path")
    targets = along_the_rail(1.0, 20)
    both.check(Q0, V0, targets)
    bent = np.vstack([targets[1:], targets[-1] + [0.02, 0.04, 0.0]])
    both.check(targets[0], V0, bent)
    bad = np.vstack([targets[5:], np.full((1, 3), 1.4)])
    wanted, _ = both.check(targets[4], V0, bad)
    assert wanted.state == GateState.PREFIX
    assert wanted.brake.knots[:, 1] == pytest.approx(np.pi / 2)
    shorter, _ = both.check(targets[4], V0, targets[5:10])
    assert shorter.state == GateState.GO


def test_targets_that_end_before_a_brake_begins(tmp_path):
    """No brake can be proven, so nothing is let through."""
    wanted, _ = Both(wall(3.0), tmp_path, latency=5 * DT).check(Q0, V0, along_the_rail(1.0, 5))
    assert (wanted.state, wanted.reason, wanted.is_proven) == (GateState.BRAKE, "brake", False)
    wanted, _ = Both(wall(3.0), tmp_path, latency=5 * DT).check(Q0, V0, along_the_rail(1.0, 6))
    assert (wanted.state, wanted.steps) == (GateState.GO, 1)


def test_a_brake_before_the_first_proven_one_is_not_called_proven(tmp_path):
    """Another chunk at the same tick: the brake after the latency was never proven."""
    both, targets = Both(wall(3.0), tmp_path, latency=2 * DT), along_the_rail(1.0, 20)
    both.check(Q0, V0, targets)
    wanted, _ = both.check(Q0, V0, targets + [9.0, 0.0, 0.0])
    assert (wanted.state, wanted.is_proven) == (GateState.BRAKE, False)


def test_budgets_and_horizons(tmp_path):
    """With too few steps less is let through, and the work stays near them."""
    targets = along_the_rail(1.0, 40)
    both = Both(wall(1.3), tmp_path)
    whole, _ = both.check(Q0, V0, targets)
    for steps in (1, 10, 100, 300, 1000):
        mine = capi.Gate(both.checker, MOST, acceleration=both.robot.acceleration, steps=steps)
        found = mine.check(Q0, V0, targets, DT)
        assert found.work <= steps + 200
        assert found.steps <= whole.steps
        assert (REASONS[found.reason] == "budget") == (found.work < whole.work)
    near, _ = Both(wall(1.3), tmp_path, horizon=10 * DT).check(Q0, V0, targets)
    assert (near.state, near.steps) == (GateState.GO, 10)


@pytest.mark.parametrize("dt", [1e-300, 1e-310, 5e-324])
@pytest.mark.parametrize("late", [0.0, DT])
def test_periods_that_are_no_periods(tmp_path, dt, late):
    """The latency has more of them than there are targets, and the time has run on by more than there are ticks."""
    both = Both(wall(3.0), tmp_path, latency=late, joint_error=1e-3, velocity_error=1e-2)
    for time in (0.0, 1.0):
        wanted, _ = both.check(Q0, 0.0 * V0, np.tile(Q0, (3, 1)), dt, time=time)
        assert wanted.state == (GateState.GO if late == 0.0 else GateState.BRAKE)


def test_bad_ticks_are_refused(tmp_path):
    """Each with the name of the argument; the gate goes on afterwards."""
    both, targets = Both(wall(3.0), tmp_path), along_the_rail(1.0, 20)
    both.check(Q0, V0, targets, time=1.0)
    given = {"q": targets[0], "dq": V0, "targets": targets[1:], "dt": DT, "time": 1.0 + DT}
    for name, bad in (
        ("q", [0.0, np.nan, 0.0]), ("dq", [np.inf, 0.0, 0.0]), ("targets", np.zeros((0, 3))),
        ("targets", np.zeros((MOST + 1, 3))), ("targets", np.full((2, 3), np.nan)), ("dt", 0.0), ("dt", np.nan),
        ("time", np.nan), ("time", 0.5),
    ):  # fmt: skip
        with pytest.raises(capi.Error, match=name):
            both.mine.check(**given | {name: bad})
    assert both.mine.check(**given).state == GateState.GO


def test_bad_gates_are_refused(tmp_path):
    """Errors of the options."""
    CollisionChecker(arm(), Scene()).save(tmp_path / "cell.lwn")
    checker, good = capi.Checker(tmp_path / "cell.lwn"), {"acceleration": 1.0}
    for bad in (
        {"latency": -1.0}, {"horizon": np.nan}, {"tolerance": -1.0}, {"steps": -1}, {"joint_error": -1.0},
        {"velocity_error": np.inf}, {"acceleration": 0.0}, {"acceleration": None}, {"jerk": np.inf}, {"velocity": 0.0},
    ):  # fmt: skip
        with pytest.raises(capi.Error, match=next(iter(bad))):
            capi.Gate(checker, MOST, **good | bad)
    for most in (0, 10**7):
        with pytest.raises(capi.Error, match="most_targets"):
            capi.Gate(checker, most, **good)


def raw_check(gate, q, dq, targets, count, dt, time, answer):
    """The status of the bare function, which may get NULL."""
    given = [None if x is None else x.ctypes.data_as(ctypes.c_void_p) for x in (q, dq, targets)]
    numbers = capi.size(count), ctypes.c_double(dt), ctypes.c_double(time)
    return capi.functions().loewner_gate_check(gate, *given, *numbers, None if answer is None else ctypes.byref(answer))


LOUD = [np.nan, np.inf, -np.inf, -1e300]


def test_targets_may_be_between_soft_and_hard_limits(tmp_path):
    """In both languages, a gate refuses targets beyond the limits of the file, and soft limits are for plans."""
    text = """<robot name="slide"><link name="base"/>
      <link name="cart"><collision><geometry><sphere radius="0.1"/></geometry></collision></link>
      <joint name="rail" type="prismatic"><parent link="base"/><child link="cart"/><axis xyz="1 0 0"/>
      <limit lower="0" upper="1" velocity="1" effort="1"/>
      <safety_controller soft_lower_limit="0.2" soft_upper_limit="0.8" k_velocity="1"/></joint></robot>"""
    robot = Robot.from_urdf(text=text)
    assert robot.upper[0] == 0.8
    scene = Scene()
    scene.add("post", Body.box([0.1, 0.1, 0.1]), at(0.0, 3.0))
    both = Both(scene, tmp_path, robot, acceleration=[9.0])
    targets = 0.7 + 0.02 * np.arange(1.0, 21.0)[:, None]
    both.check([0.7], [0.0], targets, 0.05)
    assert both.states == [GateState.PREFIX]
    assert both.python.check([0.7], [0.0], targets[:15], 0.05, time=1.0).state == GateState.GO  # as far as 1 m


FORGED = {  # what is refused, and what is legal and lets no target through
    True: {
        "gate": [None], "q": [None, *LOUD], "dq": [None, *LOUD], "targets": [None, *LOUD], "answer": [None],
        "count": [0, MOST + 1, 2**40, 2**64 - 1], "dt": [*LOUD, 0.0, -DT], "time": [*LOUD, 0.0, np.nextafter(1.0, 0.0)],
    },
    False: {
        "q": [-4.0, 1e6, -1e18, 1e100], "targets": [-4.0, 1e6, -1e18, 1e100], "dt": [5e-324, 1e-310, 1e-20, 1e-4],
    },
}  # fmt: skip


@pytest.mark.parametrize("brake", ["joints", "path"])
@pytest.mark.parametrize("grows", [False, True])
def test_forged_ticks_let_nothing_through(tmp_path, brake, grows):
    """A thousand ticks with one to three forged arguments: an error, or no target; true ones in between pass."""
    scene = wall(3.0)
    if grows:
        scene.add("person", Body.sphere(0.1))
        scene.follow("person", [0.0], at(0.0, -2.0)[None], speed=0.1, since=0.0)
    both, targets = Both(scene, tmp_path, brake=brake, latency=DT), along_the_rail(1.0, 20)
    rng, answer, now = np.random.default_rng(7), capi.GateAnswer(), 1.0
    for k in range(1000):
        is_loud = k % 2 == 0
        given = {"gate": both.mine, "q": Q0, "dq": V0, "targets": targets, "count": 20, "dt": DT, "time": now}
        given["answer"] = answer
        pool = FORGED[is_loud]
        for name in rng.choice(list(pool), size=int(rng.integers(1, 4)), replace=False):
            value = pool[name][int(rng.integers(len(pool[name])))]
            if name in ("q", "dq", "targets") and value is not None:
                forged = given[name].copy()
                forged.flat[int(rng.integers(3))] = value
                value = forged
            given[name] = value
        status = raw_check(**given)
        assert (status != 0) == is_loud or (status == OVERFLOW and not is_loud), given
        assert status or (answer.state >= GateState.BRAKE and answer.steps == 0), given
        if k % 20 == 0:
            now += 1e-3 * (k % 40 == 0)
            assert raw_check(both.mine, Q0, V0, targets, 20, DT, now, answer) == 0
            assert (answer.state, answer.steps) == (GateState.GO, 19)


def test_velocities_are_limited_as_the_robot_says_unless_others_are_given(tmp_path):
    """A chunk faster than the URDF allows needs other limits, which a gate may be given."""
    targets = along_the_rail(50.0, 20)
    for velocity, is_allowed in ((None, False), ([100.0, 100.0, 100.0], True)):
        given = {} if velocity is None else {"velocity": velocity}
        robot = arm()
        CollisionChecker(robot, wall(3.0)).save(tmp_path / "cell.lwn")
        gate = capi.Gate(capi.Checker(tmp_path / "cell.lwn"), MOST, acceleration=robot.acceleration, **given)
        found = gate.check(Q0, np.zeros(3), targets, DT, 0.0)
        assert (REASONS[found.reason] != "limits") == is_allowed
