"""Gates of the library for C hold their answers against Python's, tick by tick."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from loewner import Body, CollisionChecker, Scene
from loewner._native import library
from loewner.planners import Gate, GateState
from test_gates import ACCELERATION, DT, JERK, Q0, V0, along_the_rail, arm, at, wall

OFFERED = library.level() is not None or os.environ.get("LOEWNER_NATIVE") == "required"
pytestmark = pytest.mark.skipif(not OFFERED, reason=f"no native library here: {library.why_not()}")

capi = pytest.importorskip("capi")
HERE = Path(__file__).parent
REASONS = ("", "contact", "brake", "may be hit", "limits", "budget")
MOST = 60


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
        fastest = self.robot.velocity
        given = {"acceleration": self.robot.acceleration, "velocity": fastest} | options
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
        brake = wanted.brake
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
def test_chunks_are_judged_as_in_python(tmp_path, brake, jerk, grows):
    """Random chunks, tick by tick: states, steps, reasons, pairs, scales and brakes."""
    states = set()
    for seed in range(12):
        rng = np.random.default_rng(seed)
        scene = random_scene(rng)
        if grows:
            scene.add("person", Body.sphere(0.1))
            place = rng.uniform(-1.5, 1.5, 3)
            scene.follow("person", [0.0], at(*place)[None], speed=0.3, since=0.0, error=(0.01, 0.0))
        late = int(rng.integers(0, 3)) * DT
        both = Both(
            scene, tmp_path, brake=brake, jerk=jerk, joint_error=2e-3, velocity_error=2e-2, latency=late
        )
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
    assert len(states) >= 3
