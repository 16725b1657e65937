"""Simulated chunks behind a gate: does a robot meet anything before it stands still?

    python benchmarks/gate_chunks.py [--chunks 1000000] [--seed 0] [--gates both]

A Panda, a UR5e of capsules (from its published lengths) and a base on two slides and a turn that carries the same arm
run chunks of random kinds among boxes, voxels of a cloud and a person, who goes and turns towards the nearest link as
fast as the bounds allow. The person was seen away from the robot by all of the error, the robot is off its commands by
all of its errors, towards what is nearest, and now and then the world or the robot leaves its bounds. Each check of a
gate, in Python or C, is a chunk. What the robot and the person really did is judged afterwards, by exact tests at eight
moments of each period, until the robot stands. A brake joint by joint is computed anew here, from the real velocity.
"""

from __future__ import annotations

import argparse
import ctypes
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

sys.path.append(str(Path(__file__).parents[1] / "tests"))
import capi
from loewner import Body, CollisionChecker, Joint, Robot, Scene
from loewner._base._rotations import rotations_of
from loewner.planners import Gate, GateState
from robot_samples import panda
from samples import Array

DT, MOMENTS, EPISODES, TICKS, MOST = 0.02, 8, 100, 60, 60
BOTH = (*7 * ("c",), "python")  # gates of worlds, twelve worlds each
SHOWN = 20_000  # chunks between two lines of progress
ROBOTS, WORLDS, STEPS = ("panda", "ur5e", "mobile"), ("boxes", "cloud", "person", "all"), 200_000
# Events after which earlier proofs do not hold: the first two are of the scene, the next ones of the person, and the
# last ones of the robot. An answer that is not proven ends what is claimed.
EVENTS = ("structure", "moved", "cone", "faster", "turns", "error", "forecast", "pushed", "kicked")
FAR = np.array([0.0, 0.0, 50.0])


def at(place: Any, turn: Array | None = None) -> Array:
    """Poses at places, shape (..., 3), with the rotations of quaternions, shape (..., 4)."""
    places = np.asarray(place)
    T = np.zeros((*places.shape[:-1], 4, 4))
    T[..., :3, 3], T[..., 3, 3] = places, 1.0
    T[..., :3, :3] = np.eye(3) if turn is None else rotations_of(turn)
    return T


def cross(a: Array, b: Array) -> Array:
    """The product of two vectors, for which NumPy's takes long."""
    return np.array([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


def turned(quaternion: Array, axis: Array, angle: float) -> Array:
    """A quaternion after a turn about an axis of the world."""
    length = float(np.linalg.norm(axis))
    if length < 1e-9:
        return quaternion
    c, s = np.cos(angle / 2), np.sin(angle / 2) * axis / length
    w, v = quaternion[0], quaternion[1:]
    made = np.array([c * w - s @ v, *(c * v + w * s + cross(s, v))])
    return made / np.linalg.norm(made)


# -- robots and worlds -----------------------------------------------------------------------------

# d, a and alpha of a UR5e, and the capsules of its links: along z or x, length, offset along z, radius.
UR5E = (
    ("shoulder", 0.1625, 0.0, np.pi / 2, "z", 0.0, 0.06), ("upper", 0.0, -0.425, 0.0, "x", 0.138, 0.055),
    ("fore", 0.0, -0.3922, 0.0, "x", 0.007, 0.05), ("wrist 1", 0.1333, 0.0, np.pi / 2, "z", 0.0, 0.045),
    ("wrist 2", 0.0997, 0.0, -np.pi / 2, "z", 0.0, 0.045), ("wrist 3", 0.0996, 0.0, 0.0, "z", 0.0, 0.04),
)  # fmt: skip


def ur5e(on_base: bool) -> Robot:
    """A UR5e of capsules, on the ground, or on a base with two slides and a turn."""
    links: dict[str, Any] = {"ground": None}
    joints, parent, T = [], "ground", np.eye(4)
    if on_base:
        rates = {"velocity": 1.5, "acceleration": 3.0}
        links |= {"x": None, "y": None, "base": [(Body.box([0.7, 0.5, 0.5]), at([0.0, 0.0, 0.27]))]}
        joints = [
            Joint("x", "prismatic", "ground", "x", axis=(1, 0, 0), lower=-3, upper=3, **rates),
            Joint("y", "prismatic", "x", "y", axis=(0, 1, 0), lower=-3, upper=3, **rates),
            Joint("turn", "revolute", "y", "base", axis=(0, 0, 1), lower=-3, upper=3, **rates),
        ]
        parent, T = "base", at([0.15, 0.0, 0.55])
    for name, d, a, alpha, along, offset, radius in UR5E:
        # A capsule lies along z; the joint's frame is turned by alpha about x at its end.
        body = at([0.0, 0.0, offset + d / 2])
        if along == "x":
            body = at([a / 2, 0.0, offset], np.array([np.sqrt(0.5), 0.0, np.sqrt(0.5), 0.0]))
        links[name] = [(Body.capsule(radius, abs(d + a)), body)]
        joints.append(
            Joint(name, "revolute", parent, name, T_parent_joint=T, axis=(0, 0, 1), lower=-3.1, upper=3.1,
                  velocity=3.14, acceleration=6.0)
        )  # fmt: skip
        T = at([a, 0.0, d], np.array([np.cos(alpha / 2), np.sin(alpha / 2), 0.0, 0.0]))
        parent = name
    return Robot.from_links(links, joints)


SAMPLES: dict[str, Robot] = {}


def robot_of(name: str) -> Robot:
    """A robot by its name."""
    if name not in SAMPLES:
        SAMPLES[name] = panda().robot if name == "panda" else ur5e(name == "mobile")
    return SAMPLES[name]


class World:
    """A robot among bodies: what a gate is given, and what is true.

    Attributes
    ----------
    scene, truth : Scene
        In the first one, bodies are where they were seen, and have bounds. The second one has no bounds, and bodies
        that move follow what they really did.
    nearest : dict of CollisionChecker
        Of the static bodies alone, and of the person, without pairs of the robot's own.
    """

    def __init__(self, robot: str, kind: str, rng: np.random.Generator) -> None:
        self.robot, self.kind, self.has_person = robot_of(robot), kind, kind in ("person", "all")
        self.scene, self.truth = Scene(), Scene()
        reach = 2.0 if robot == "mobile" else 0.9
        for k in range(5 if kind in ("boxes", "all") else 2):
            box, place = Body.box(rng.uniform(0.05, 0.4, 3)), self.around(rng, reach)
            off = rng.normal(size=3)
            self.scene.add(f"box {k}", box)
            self.scene.move(f"box {k}", at(place), error=(0.01, 0.0) if k == 0 else None)
            self.truth.add(f"box {k}", box, at(place + 0.00999 * off / np.linalg.norm(off) * (k == 0)))
        if kind in ("cloud", "all"):
            self.add("cloud", Body.from_cloud(self.seen_points(rng, reach), voxel=0.04), np.zeros(3))
        self.crate = self.around(rng, reach)
        self.add("crate", Body.box([0.04, 0.04, 0.04]), self.crate)
        self.large = Body.box(rng.uniform(0.3, 0.6, 3))
        static = self.truth.copy()
        self.truth.add("large", self.large, at(FAR))
        bodies = [Body.capsule(0.2, 1.2), Body.sphere(0.25), Body.box([0.3, 0.5, 1.6])]
        self.person = bodies[int(rng.integers(3))]
        alone = Scene()
        alone.add("person", self.person, at(FAR))
        if self.has_person:
            self.add("person", self.person, FAR)
        self.nearest = {
            name: CollisionChecker(self.robot, scene) for name, scene in (("static", static), ("person", alone))
        }
        own = [pair for pair in self.nearest["person"].checked_pairs if "person" not in pair]
        for checker in self.nearest.values():
            for pair in own:
                checker.scene.allow(*pair)
        Q = self.robot.random_configurations(4000, seed=int(rng.integers(2**31)))
        if robot == "mobile":
            Q[:, :2] *= 0.6
        self.free = Q[~CollisionChecker(self.robot, self.scene).collide(Q)]
        self.judge = CollisionChecker(self.robot, self.truth)

    def add(self, name: str, body: Body, place: Array) -> None:
        self.scene.add(name, body, at(place))
        self.truth.add(name, body, at(place))

    @staticmethod
    def around(rng: np.random.Generator, reach: float) -> Array:
        """A place within a robot's reach, and not within its base."""
        angle, radius = rng.uniform(-np.pi, np.pi), rng.uniform(0.35, reach)
        return np.array([radius * np.cos(angle), radius * np.sin(angle), rng.uniform(0.0, 1.1)])

    @staticmethod
    def seen_points(rng: np.random.Generator, reach: float) -> Array:
        """A shelf of two boards and a wall behind it, as a sensor sees their faces."""
        ends = [
            ([-0.4, 0.0, 0.3], [0.4, 0.3, 0.3]),
            ([-0.4, 0.0, 0.8], [0.4, 0.3, 0.8]),
            ([-0.4, 0.3, 0.0], [0.4, 0.3, 1.2]),
        ]
        points = np.vstack([rng.uniform(low, high, (600, 3)) for low, high in ends])
        angle, away = rng.uniform(-np.pi, np.pi), rng.uniform(0.45, reach)
        c, s = np.cos(angle), np.sin(angle)
        return (points + [0.0, away, 0.0]) @ np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])


# -- gates -----------------------------------------------------------------------------------------


class Answer(NamedTuple):
    """What a gate answers, with the brake at its beginning, and a function for its positions."""

    state: int
    steps: int
    is_proven: bool
    work: int
    begins: Array
    rates: Array
    duration: float
    positions: Any


class InPython:
    """A gate of Python."""

    def __init__(self, world: World, make: type[Gate] = Gate, **options: Any) -> None:
        self.world, self.scene = world, world.scene.copy()
        self.gate = make(CollisionChecker(world.robot, self.scene), steps=STEPS, **options)

    def see(self, T: Array, drift: Array, since: float, errors: tuple[float, float], speed: float, turn: float) -> None:
        """The person was seen, and is expected to go on at some velocity."""
        bounds = {"speed": speed, "turn": turn} | ({"since": since} if speed or turn else {})
        times = [since, since + 9.0] if drift.any() else [since]
        poses = [T, T + 9.0 * np.pad(drift[:, None], ((0, 1), (3, 0)))][: len(times)]
        self.scene.follow("person", times, poses, error=errors, **bounds)

    def move(self, name: str, T: Array) -> None:
        self.scene.move(name, T)

    def grow(self, large: bool) -> None:
        """The crate becomes a large one, in the same place, or a small one again."""
        self.scene.replace("crate", self.world.large if large else Body.box([0.04, 0.04, 0.04]))

    def check(self, q: Array, dq: Array, targets: Array, t: float) -> Answer:
        found = self.gate.check(q, dq, targets, DT, time=t)
        brake = found.brake
        return Answer(int(found.state), found.steps, found.is_proven, found.work, brake.knots[0], brake.rates[0],
                      brake.duration, brake.positions)  # fmt: skip


class InC:
    """A gate of the library for C."""

    def __init__(self, world: World, folder: Path, **options: Any) -> None:
        scene = world.scene.copy()
        scene.add("large", world.large, at(world.crate))
        bounds = scene.bounds
        for name in bounds:
            scene.move(name, scene.pose(name))
        CollisionChecker(world.robot, scene).save(folder / "cell.lwn")
        self.checker = capi.Checker(folder / "cell.lwn")
        for name, off in bounds.items():
            self.checker.set_bounds(name, metres=off.metres, radians=off.radians, speed=0.0, turn=0.0, since=0.0)
        self.grow(False)
        given = {"velocity": world.robot.velocity, "acceleration": world.robot.acceleration, "steps": STEPS}
        self.gate = capi.Gate(self.checker, MOST, **given | options)

    def see(self, T: Array, drift: Array, since: float, errors: tuple[float, float], speed: float, turn: float) -> None:
        self.checker.move("person", T)
        self.checker.set_bounds("person", metres=errors[0], radians=errors[1], speed=speed, turn=turn, since=since)

    def move(self, name: str, T: Array) -> None:
        self.checker.move(name, T)
        if name == "crate":
            self.checker.move("large", T)

    def grow(self, large: bool) -> None:
        self.checker.set_present("large", large)

    def check(self, q: Array, dq: Array, targets: Array, t: float) -> Answer:
        found = self.gate.check(q, dq, targets, DT, t)
        rows = (found.positions, found.velocities, found.accelerations)
        n, dof = found.brake_count, self.checker.dof
        times = np.frombuffer(ctypes.string_at(found.times, 8 * n))
        P, V, A = (np.frombuffer(ctypes.string_at(x, 8 * n * dof)).reshape(n, dof) for x in rows)

        def positions(s: Array) -> Array:
            k = np.clip(np.searchsorted(times, s, side="right") - 1, 0, max(len(times) - 2, 0))
            if len(times) < 2:
                return np.repeat(P[:1], len(s), axis=0)
            h, u = (times[k + 1] - times[k])[:, None], (s - times[k])[:, None]
            cubic = (P[k + 1] - P[k] - V[k] * h - A[k] * h * h / 2) / h**3
            return P[k] + V[k] * u + A[k] * u * u / 2 + cubic * u**3

        return Answer(
            found.state, found.steps, bool(found.is_proven), found.work, P[0], V[0], float(times[-1]), positions
        )


# -- runs ------------------------------------------------------------------------------------------


def stopping(v: Array, strongest: Array, jerk: Array | None, s: Array) -> tuple[Array, float]:
    """Ways of joints that brake from velocities v at times s, shape (n, dof), and the time until all stand."""
    v, sign, s = np.abs(v), np.sign(v), s[:, None]
    if jerk is None:
        u = np.minimum(s, v / strongest)
        return sign * (v * u - strongest * u * u / 2), float((v / strongest).max())
    ramp = np.minimum(strongest, np.sqrt(v * jerk)) / jerk
    hold = np.maximum(v / np.maximum(ramp * jerk, 1e-300) - ramp, 0.0)
    u = np.minimum(s, 2 * ramp + hold)
    ends = (np.zeros_like(v), ramp, ramp + hold, 2 * ramp + hold)
    lost = sum(c * np.maximum(u - end, 0.0) ** 3 for c, end in zip((1, -1, -1, 1), ends, strict=True))
    return sign * (v * u - jerk / 6 * lost), float((2 * ramp + hold).max())


class Programme(NamedTuple):
    """What the robot does if it hears no more: targets, and then a brake."""

    rows: Array
    answer: Answer


class Run:
    """Episodes of a robot behind a gate in one world.

    Parameters
    ----------
    seed : int
        Chooses the world, the gate and its options, and all that happens.
    make : {"python", "c"} or type of Gate
        Which gate.
    fixed : dict
        Replaces what the seed chooses: robot, kind, brake, jerk, late, event.
    """

    def __init__(self, seed: int, make: Any, folder: Path, **fixed: Any) -> None:
        self.rng = rng = np.random.default_rng(seed)
        chosen: dict[str, Any] = {
            "robot": ROBOTS[seed % 3],
            "kind": WORLDS[seed // 3 % 4],
            "brake": ("joints", "path")[int(rng.integers(2))],
            "jerk": (None, 40.0)[int(rng.integers(2))],
            "late": float(rng.choice([0.0, 0.5, 1.0, 2.0])),
            "event": 0.1,
            "events": EVENTS,
        } | fixed
        self.world = world = World(chosen["robot"], chosen["kind"], rng)
        dof = world.robot.dof
        self.fastest = world.robot.velocity
        self.strongest = np.where(np.isnan(world.robot.acceleration), 5.0, world.robot.acceleration)
        self.jerk = None if chosen["jerk"] is None else chosen["jerk"] * np.ones(dof)
        self.error, self.rate_error = (
            np.full(dof, rng.choice([0.0, 2e-3, 1e-2])),
            np.full(dof, rng.choice([1e-6, 2e-2, 0.1])),
        )
        self.late, self.on_path = int(np.ceil(chosen["late"])), chosen["brake"] == "path"
        self.odds, self.events = chosen["event"], chosen["events"]
        options = {
            "brake": chosen["brake"],
            "jerk": self.jerk,
            "acceleration": self.strongest,
            "joint_error": self.error,
            "velocity_error": self.rate_error,
            "latency": chosen["late"] * DT,
        }
        python = {"make": Gate if make == "python" else make}
        self.gate: Any = InC(world, folder, **options) if make == "c" else InPython(world, **python, **options)
        self.count: Counter[str] = Counter()
        self.closest = np.inf
        self.tick, self.episode = 0, 0
        self.turn_of, self.place = np.array([1.0, 0.0, 0.0, 0.0]), FAR
        self.crate, self.is_large = at(world.crate), False
        self.segments: list[tuple[Any, ...]] = []

    # -- the person and the rest of the world ----------------------------------------------------

    def appear(self) -> None:
        """A person at a random distance, with other bounds."""
        rng = self.rng
        self.speed, self.turn = float(rng.choice([0.0, 0.3, 0.8, 1.6])), float(rng.choice([0.0, 0.5]))
        self.metres, self.radians = float(rng.choice([2e-3, 0.02, 0.05])), float(rng.choice([0.0, 0.1]))
        self.drift = rng.normal(size=3) * [0.3, 0.3, 0.0] * (isinstance(self.gate, InPython) and rng.random() < 0.3)
        away = rng.normal(size=3) * [1.0, 1.0, 0.2]
        self.place = away / np.linalg.norm(away) * rng.uniform(0.6, 2.5) + self.base()
        self.past = [(self.place, self.turn_of)]

    def base(self) -> Array:
        """Where the robot's first moving link is."""
        return self.world.robot.forward_kinematics(self.real)[3, :3, 3]

    def look(self) -> None:
        """Find what is nearest, in which way joints lead there, and in which way the person has to go."""
        found = [self.world.nearest["static"].distance(self.real, exact=True, gradient=True)]
        self.way = self.axis = np.zeros(3)
        if self.world.has_person:
            alone = self.world.nearest["person"]
            alone.scene.move("person", at(self.place, self.turn_of))
            near = alone.distance(self.real, exact=True, gradient=True)
            is_second = near.names[1] == "person"
            self.way = -near.normal if is_second else near.normal
            self.axis = cross((near.witness_b if is_second else near.witness_a) - self.place, self.way)
            found.append(near)
        nearest = min(found, key=lambda one: one.distance)
        self.slope = nearest.gradient
        self.gap = nearest.distance

    def see(self) -> None:
        """The person is seen, some ticks late, where it is off the real place by all of the error."""
        back = min(int(self.rng.integers(3)), len(self.past) - 1)
        place, turn_of = self.past[-1 - back]
        off = -self.way if self.rng.random() < 0.8 else self.rng.normal(size=3)
        off = off / max(float(np.linalg.norm(off)), 1e-9)
        seen = turned(turn_of, -self.axis, 0.999 * self.radians)
        self.gate.see(at(place + 0.999 * self.metres * off, seen), self.drift, (self.tick - back) * DT,
                      (self.metres, self.radians), self.speed, self.turn)  # fmt: skip

    def go(self, seconds: float) -> tuple[Any, ...]:
        """The person comes nearer; its places and turns before and after."""
        before = self.place, self.turn_of
        if self.world.has_person:
            self.place = self.place + seconds * (self.drift + 0.999999 * self.speed * self.way)
            self.turn_of = turned(self.turn_of, self.axis, 0.999999 * self.turn * seconds)
        return (*before, self.place, self.turn_of)

    def moves(self, begin: Array, end: Array, seconds: float, moments: int) -> None:
        """The robot moves straight between two configurations."""
        self.segments.append((begin, end, moments, *self.go(seconds), self.crate, self.is_large, self.episode))

    def next_tick(self) -> None:
        self.tick += 1
        self.past.append((self.place, self.turn_of))
        self.look()
        self.closest = min(self.closest, self.gap)

    # -- the robot -------------------------------------------------------------------------------

    def off(self) -> Array:
        """How far the robot is off a command: towards what is nearest, mostly."""
        side = -np.sign(self.slope) if self.rng.random() < 0.8 else self.rng.choice([-1.0, 1.0], len(self.slope))
        return 0.9999 * side * self.error

    def chunk(self) -> Array:
        """Targets from the command on: towards what is nearest, at random, or as someone steers."""
        rng, n = self.rng, int(self.rng.integers(5, 60))
        s, speed = DT * np.arange(1, n + 1)[:, None], self.fastest * rng.uniform(0.05, 0.9)
        kind = rng.integers(3)
        if kind == 0:
            way = -self.slope / max(float(np.abs(self.slope / speed).max()), 1e-9)
            rows = way * (s if rng.random() < 0.5 else np.where(s < 0.2, s * s / 0.4, s - 0.1))
        elif kind == 1:
            way, bend = rng.normal(size=len(speed)) * speed / 2, rng.normal(size=len(speed)) * speed
            rows = way * s + rng.uniform(0.0, 1.0) * bend * s * s
        else:
            steps = np.cumsum(rng.normal(size=(n, len(speed))), axis=0) * 0.1 * speed + self.rate
            rows = DT * np.cumsum(np.clip(steps, -speed, speed), axis=0)
        rows = np.clip(self.real + rows, self.world.robot.lower, self.world.robot.upper)
        if rng.random() < 0.2:
            rows[-(n // 3) :] = rows[-(n // 3) - 1]
        return rows

    def run_to(self, row: Array) -> None:
        """Run to the next target."""
        end = row + self.off()
        self.moves(self.real, end, DT, MOMENTS)
        self.rate = (row - self.command) / DT
        self.real, self.command = end, row
        self.next_tick()

    def brake(self, answer: Answer) -> None:
        """Brake as the answer has it, at velocities that are off, until the robot stands."""
        at_command, at_real = (np.abs(answer.begins - q).max() < 1e-9 for q in (self.command, self.real))
        self.count["brakes that begin elsewhere"] += not (at_command or at_real)
        if self.on_path:
            duration = answer.duration
        else:
            v = self.measured if at_real and np.array_equal(answer.rates, self.measured) else self.rate
            side = np.where(np.abs(self.slope) > 0, -np.sign(self.slope), np.sign(v))
            v = v + 0.9999 * self.rate_error * (side if self.rng.random() < 0.8 else -side)
            duration = stopping(v, self.strongest, self.jerk, np.zeros(1))[1]
        count = int(np.ceil(duration / DT * MOMENTS))
        s = np.minimum(np.arange(count + 1) * DT / MOMENTS, duration)
        path = answer.positions(s) if self.on_path else answer.begins + stopping(v, self.strongest, self.jerk, s)[0]
        start, goal = self.real - answer.begins, self.off()
        for k in range(1, count + 1):
            if k % MOMENTS == 1 and k > 1:
                self.next_tick()
                start, goal = goal, self.off()
            share = ((k - 1) % MOMENTS + 1) / MOMENTS
            real = path[k] + start + share * (goal - start)
            self.moves(self.real, real, s[k] - s[k - 1], 1)
            self.real = real
        self.count["brakes"] += 1
        self.next_tick()

    # -- episodes --------------------------------------------------------------------------------

    def happens(self, event: str, wanted: Array) -> Array:
        """Something happens that proofs do not allow for, and is seen; return the targets from here on."""
        rng = self.rng
        self.count["events"] += 1
        towards = self.world.robot.forward_kinematics(wanted[min(6, len(wanted) - 1)])
        spot = towards[int(rng.integers(2, len(towards))), :3, 3]
        if event == "structure":
            self.is_large = True
            self.gate.grow(True)
        elif event == "moved":
            self.crate = at(spot)
            self.gate.move("crate", self.crate)
        elif event == "pushed":
            self.real = self.real - rng.uniform(0.02, 0.3) * np.sign(self.slope)
            if (np.abs(self.real - self.command) > self.error).any():  # not where no joint leads to the nearest body
                self.command = self.real
        elif event == "kicked":
            self.rate = self.rate - rng.uniform(0.3, 0.8) * self.fastest * np.sign(self.slope)
            return np.vstack([wanted[0] + 1.0, wanted])
        elif self.world.has_person:
            if event == "cone":
                self.place = spot - self.way * rng.uniform(0.0, 0.5)
            elif event == "faster":
                self.speed = 3.0
            elif event == "turns":
                self.turn = 6.0
            elif event == "forecast":
                self.drift = 1.5 * self.way * isinstance(self.gate, InPython)
            elif event == "error":
                self.metres += 0.3
                self.place = self.place + 0.29 * self.way
            self.past = [(self.place, self.turn_of)]
            self.see()
        self.look()
        return wanted

    def follow(self, programme: Programme) -> None:
        """Run a programme to its end."""
        for row in programme.rows:
            self.run_to(row)
        self.brake(programme.answer)

    def begin(self) -> None:
        """Another place for the robot, at rest, and for all others."""
        self.episode += 1
        self.real = self.command = self.world.free[int(self.rng.integers(len(self.world.free)))]
        self.rate = np.zeros_like(self.real)
        if self.is_large:
            self.gate.grow(False)
        self.crate, self.is_large = at(self.world.crate), False
        self.gate.move("crate", self.crate)
        if self.world.has_person:
            self.appear()
            self.look()
            self.see()
        else:
            self.past = []
            self.look()

    def episode_of(self, most: int) -> None:
        """Run chunks until the robot has braked."""
        rng, programme, void = self.rng, None, False
        self.begin()
        wanted, anew, replaces, window = (
            np.empty((0, 0)),
            True,
            rng.choice([0.02, 0.1, 0.5]),
            int(rng.integers(6, MOST)),
        )
        for _ in range(most):
            if anew or len(wanted) < 4 or rng.random() < replaces:
                wanted, anew = self.chunk(), True
            if self.world.has_person and rng.random() < 0.4:
                self.see()
            given = wanted
            if programme is not None and rng.random() < self.odds:
                given, void = self.happens(str(rng.choice(self.events)), wanted), True
            self.count["chunks"] += 1
            noise = 0.9999 * rng.integers(-1, 2, len(self.rate)) * self.rate_error
            self.measured = self.rate + noise
            answer = self.gate.check(self.real, self.measured, given[:window], self.tick * DT)
            self.count[GateState(answer.state).name] += 1
            self.count["checks that go on"] += not anew
            self.count["reused"] += not anew and answer.work < self.anew_work / 2
            if anew:
                self.anew_work = answer.work
            if answer.steps == 0:
                break
            if anew:  # the controller begins at the measured state
                self.command = self.real
            programme, void = Programme(given[: answer.steps + self.late], answer), False
            if rng.random() < 0.02:  # nothing is heard any more
                break
            runs = min(1 if rng.random() < 0.8 else int(rng.integers(1, 5)), answer.steps)
            for row in wanted[:runs]:
                self.run_to(row)
            wanted, anew, programme = wanted[runs:], False, Programme(programme.rows[runs:], answer)
        if programme is None:
            return
        if answer.state == GateState.BRAKE and answer.is_proven:
            self.follow(Programme(programme.rows[: self.late], answer))
        elif not void:
            self.count["programmes run to the end"] += 1
            self.follow(programme)

    def run(self, episodes: int = EPISODES, ticks: int = TICKS) -> Counter[str]:
        """Run episodes, and judge them."""
        for _ in range(episodes if len(self.world.free) else 0):
            self.episode_of(ticks)
        if self.segments:
            begin, end, moments, *rest = (np.array(x) for x in zip(*self.segments, strict=True))
            place0, turn0, place1, turn1, crates, large, episodes = rest
            owner = np.repeat(np.arange(len(begin)), moments)
            first = np.cumsum(moments) - moments
            share = (np.arange(len(owner)) - first[owner] + 1) / moments[owner]
            Q, knots = begin[owner] + share[:, None] * (end - begin)[owner], np.arange(2.0 * len(begin))
            crates = np.repeat(crates, 2, axis=0)
            apart = np.where(np.repeat(large, 2)[:, None, None], crates, at(FAR))
            bodies = {"crate": crates, "large": apart}
            if self.world.has_person:
                both = (np.stack(x, axis=1).reshape(len(knots), -1) for x in ((place0, place1), (turn0, turn1)))
                bodies["person"] = at(*both)
            for name, T in bodies.items():
                self.world.truth.follow(name, knots, T)
            hits = self.world.judge.collide(Q, 2.0 * owner + share)
            self.hits = np.flatnonzero(hits)
            self.count["moments judged"] += len(Q)
            self.count["contacts"] += len(set(episodes[owner[hits]].tolist()))
        return self.count


class Totals:
    """What was counted in many worlds, and the nearest approach."""

    def __init__(self) -> None:
        self.counts, self.closest = Counter[str](), np.inf

    def add(self, chunks: int, seed: int, makes: tuple[Any, ...], folder: Path, **fixed: Any) -> int:
        """Run worlds, one after another, until there were as many chunks; return the next seed."""
        while self.counts["chunks"] < chunks:
            run = Run(seed, makes[seed // 12 % len(makes)], folder, **fixed)
            found = run.run()
            if found["contacts"]:
                print(f"seed {seed}: {found['contacts']} contacts", flush=True)
            self.counts.update(found)
            self.counts["worlds"] += 1
            self.closest, seed = min(self.closest, run.closest), seed + 1
        return seed


def main(arguments: list[str] | None = None) -> int:
    """Run chunks, and print what was counted, also if interrupted."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--chunks", type=int, default=1_000_000, help="number of checks (1,000,000)")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--gates", choices=("c", "python", "both"), default="both", help="both: one in eight of Python")
    asked = parser.parse_args(arguments)
    makes = BOTH if asked.gates == "both" else (asked.gates,)
    before, totals, seed = time.process_time(), Totals(), asked.seed
    with tempfile.TemporaryDirectory() as folder:
        try:
            for chunks in [*range(SHOWN, asked.chunks, SHOWN), asked.chunks]:
                seed = totals.add(chunks, seed, makes, Path(folder))
                print(f"{totals.counts['chunks']:,} chunks, {totals.counts['contacts']} contacts", flush=True)
        except KeyboardInterrupt:
            print("interrupted")
    for name, number in sorted(totals.counts.items()):
        print(f"{name:32}{number:12,}")
    spent = (time.process_time() - before) / max(totals.counts["chunks"], 1)
    print(f"nearest approach {1000 * totals.closest:.3f} mm; {spent * 1e6:.0f} us a chunk")
    return int(totals.counts["contacts"] > 0)


if __name__ == "__main__":
    sys.exit(main())
