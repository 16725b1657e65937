"""Tasks of reaching and placing in MuJoCo, with noisy chunks of our planner: without a gate, with ours, a coarse one.

    python benchmarks/reach_and_place.py [--models FOLDER] [--tasks 100] [--robots panda ur5e] [--noise 20]

The arms are a Panda and a UR5e as robosuite ships them (`pip install --no-deps robosuite==1.5.2`; FOLDER is its
`robosuite/models/assets`); both carry the Panda's hand, open and rigid. Their collision meshes collide.

*A task.* A block stands on a table among boxes. The hand reaches over the block from a home configuration, so that the
block is between its fingers, and then carries it into a bin or above a shelf, where it stops 40 mm above the floor.
Nothing is grasped by friction: at the end of the first motion the block becomes part of the hand where it is. Contact
between block and hand, and between block and table, is wanted and not counted; all else is.

*The policy* plans a path that keeps 15 mm from everything, gives it times, and sends chunks of 32 targets at 50 Hz of
it, anew every 8 targets from where the command is. Their offset from the plan tends to a random one, which wanders from
chunk to chunk. When it was stopped it plans again from where the robot stands.

*The controller* is MuJoCo's: a position and a velocity actuator for each joint, which follow straight motions between
targets with a step of 2 ms, and gravity compensated. By how much it departs from its commands is measured beforehand,
in other tasks without obstacles, with stops; the gate is given 1.5 times the largest departures.

*Gates.* All execute what passes of a chunk, and then a brake joint by joint. A chunk of which fewer than 8 targets pass
is drawn again up to twice; meanwhile the last one goes on as far as it passed. "ours" is `Gate`, with the commands as
the state, from which the robot departs by `joint_error`; "voxels" examines the targets only: a bounding box for each
link against the cells of 25 mm that obstacles touch.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections import Counter
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from loewner import Body, CollisionChecker, Gate, PlanningError, Robot, Scene, Verdict, planners
from samples import Array

PERIOD, STEP, TARGETS, RUN = 0.02, 0.002, 32, 8  # of targets and of physics [s]; of a chunk, and of those executed
MARGINS = (0.015, 0.008, 0.003, 0.0)  # of plans [m]; a smaller one if the robot stands nearer to something
GUARD, CELL = 0.001, 0.025  # the gate's margin, and the edge of a voxel [m]
SAMPLES, STOPS, LONGEST = 3, 25, 60.0  # draws of a chunk; a segment is given up after so many stops, or seconds
BLEND, MEMORY = 0.4, 0.8  # seconds in which a chunk takes its offset, and what chunks keep of it
DEEP = 0.03  # how far the fingers reach below the top of the block [m]
NEAR, TURNED, STILL = 0.02, 0.15, 0.2  # when a pose is reached [m, rad], and the rest after each stop [s]
TIP = 0.1124  # from the hand's origin to the ends of its fingers [m]
HAND, BLOCK, TABLE, REST = "grip/right_gripper", "block", "table", "rest"
BASES = {"panda": "link0", "ur5e": "fixed_base_link"}  # stand on the table
GATES = ("none", "ours", "voxels")
Boxes = dict[str, tuple[Array, Array]]  # edges and poses


class Arm(NamedTuple):
    """What a data sheet says of an arm, and gains of its controller."""

    home: Array
    velocity: Array  # rad/s
    deceleration: Array  # of brakes [rad/s²]
    torque: Array  # N m
    stiffness: Array  # N m/rad
    damping: Array  # N m s/rad


ARMS = {
    "panda": Arm(
        np.array([0, -np.pi / 4, 0, -3 * np.pi / 4, 0, np.pi / 2, np.pi / 4]),
        np.array([2.175, 2.175, 2.175, 2.175, 2.61, 2.61, 2.61]),
        np.array([7.5, 3.75, 5.0, 6.25, 7.5, 10.0, 10.0]),
        np.array([87, 87, 87, 87, 12, 12, 12.0]),
        np.array([6000, 6000, 5000, 5000, 2000, 2000, 1000.0]),
        np.array([400, 400, 300, 300, 80, 80, 40.0]),
    ),
    "ur5e": Arm(
        np.array([-0.6, -np.pi / 2, np.pi / 2, -np.pi / 2, -np.pi / 2, 0.0]),
        np.full(6, np.pi),
        np.full(6, 7.0),
        np.array([150, 150, 150, 28, 28, 28.0]),
        np.array([8000, 8000, 6000, 2000, 2000, 1000.0]),
        np.array([500, 500, 300, 80, 80, 40.0]),
    ),
}  # fmt: skip


# -- robots ---------------------------------------------------------------------------------------


def installed() -> Path | None:
    """The folder of robosuite's models; its code is not run."""
    found = find_spec("robosuite")
    return None if found is None else Path(next(iter(found.submodule_search_locations or ())), "models", "assets")


def described(models: Path, arm: str) -> Any:
    """MuJoCo's description of an arm with a hand, without what only is seen, and with the actuators of a controller."""
    import mujoco

    spec = mujoco.MjSpec.from_file(str(models / "robots" / arm / "robot.xml"))
    hand = mujoco.MjSpec.from_file(str(models / "grippers" / "panda_gripper.xml"))
    for part in (spec, hand):
        unseen = [g for g in part.geoms if g.contype == 0 and g.conaffinity == 0]
        used = {g.meshname for g in part.geoms if g not in unseen}
        parts = [m for m in part.meshes if m.name not in used]
        for one in [*unseen, *parts, *part.materials, *part.textures, *part.actuators, *part.sensors, *part.cameras]:
            part.delete(one)
    for name, side in (("leftfinger", -0.04), ("rightfinger", 0.04)):
        finger = hand.body(name)
        finger.pos = finger.pos + np.array([side, 0.0, 0.0])
        for joint in list(finger.joints):
            hand.delete(joint)
    spec.body("right_hand").add_frame().attach_body(hand.body("right_gripper"), "grip/", "")
    # They overlap, and MuJoCo checks them, since the base does not move.
    spec.add_exclude(bodyname1=BASES[arm], bodyname2=spec.joints[0].parent.name)
    given = ARMS[arm]
    for body in spec.bodies[1:]:
        body.gravcomp = 1.0
    for k, joint in enumerate(spec.joints):
        joint.armature = 0.1
        joint.actfrclimited, joint.actfrcrange = True, [-given.torque[k], given.torque[k]]
        joint.range = np.clip(joint.range, -np.pi, np.pi)
    for joint, gain in zip(spec.joints, given.stiffness, strict=True):
        spec.add_actuator(trntype=mujoco.mjtTrn.mjTRN_JOINT, target=joint.name).set_to_position(kp=gain)
    for joint, gain in zip(spec.joints, given.damping, strict=True):
        spec.add_actuator(trntype=mujoco.mjtTrn.mjTRN_JOINT, target=joint.name).set_to_velocity(kv=gain)
    spec.option.timestep, spec.option.integrator = STEP, mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    return spec


def in_boxes(models: Path, arm: str, robot: Robot) -> Robot:
    """The same robot, each of whose links is one box about its shapes in the link's frame."""
    spec = described(models, arm)
    for geom in list(spec.geoms):
        spec.delete(geom)
    for name, body in robot.bodies.items():
        corners = np.vstack([piece.vertices for piece in body.pieces])
        low, high = corners.min(axis=0), corners.max(axis=0)
        spec.body(name).add_geom(type=6, size=(high - low) / 2, pos=(high + low) / 2)  # mjGEOM_BOX
    return Robot.from_mujoco(spec.compile())


# -- scenes ---------------------------------------------------------------------------------------


def at(x: float, y: float, z: float, angle: float = 0.0) -> Array:
    """The pose of something upright that is turned by an angle."""
    T = np.eye(4)
    T[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    T[:3, 3] = x, y, z
    return T


def world(rng: np.random.Generator, shelf: bool) -> tuple[Boxes, Array]:
    """A table with a block among boxes and a bin or a shelf; and where the middle of the block is to be."""
    tall = rng.uniform(0.08, 0.12)
    block = at(rng.uniform(0.38, 0.6), rng.uniform(-0.35, -0.08), tall / 2, rng.uniform(-np.pi, np.pi))
    boxes = {TABLE: (np.array([1.4, 1.6, 0.04]), at(0.35, 0, -0.02)),
             BLOCK: (np.array([0.04, 0.04, tall]), block)}  # fmt: skip
    frame, inner, wall = at(rng.uniform(0.38, 0.58), rng.uniform(0.15, 0.35), 0, rng.uniform(-0.5, 0.5)), 0.14, 0.012
    if shelf:
        level = rng.uniform(0.1, 0.25)
        parts = [((0.26, 0.3, 0.02), (0, 0, level - 0.01)), ((0.02, 0.3, level + 0.3), (0.14, 0, level / 2 + 0.15)),
                 ((0.26, 0.02, level + 0.3), (0, 0.16, level / 2 + 0.15))]  # fmt: skip
        goal = frame @ at(rng.uniform(-0.06, 0.0), rng.uniform(-0.08, 0.02), level + 0.04 + tall / 2)
    else:
        inner, high, parts = rng.uniform(0.13, 0.2), rng.uniform(0.08, 0.14), []
        for x, y in ((1, 0), (-1, 0), (0, 1), (0, -1)):
            middle = (x * (inner + wall) / 2, y * (inner + wall) / 2, high / 2)
            parts.append(((wall, inner + 2 * wall, high) if x else (inner + 2 * wall, wall, high), middle))
        goal = frame @ at(0, 0, 0.04 + tall / 2)
    boxes |= {f"part {k}": (np.array(size), frame @ at(*middle)) for k, (size, middle) in enumerate(parts)}
    while len(boxes) < 8 + len(parts):
        edges, place = rng.uniform([0.05, 0.05, 0.06], [0.1, 0.1, 0.24]), rng.uniform([0.3, -0.5], [0.75, 0.5])
        far = [np.hypot(*(place - T[:2, 3])) for T in (block, frame)]
        if far[0] > 0.11 + edges.max() / 4 and far[1] > 0.26:
            boxes[f"box {len(boxes)}"] = (edges, at(*place, edges[2] / 2, rng.uniform(-np.pi, np.pi)))
    return boxes, goal


def cells_of(boxes: list[tuple[Array, Array]], low: Array, shape: tuple[int, ...]) -> Array:
    """The cells of a grid that upright boxes touch: separated along no edge of either, shape (p, q, r)."""
    x, y, z = (low[k] + CELL * (np.arange(n) + 0.5) for k, n in enumerate(shape))
    filled = np.zeros(shape, dtype=bool)
    for edges, T in boxes:
        c, s = np.abs(T[:2, 0])
        turned = (T[:2, :2].T @ np.stack(np.meshgrid(x - T[0, 3], y - T[1, 3], indexing="ij")).reshape(2, -1)).T
        flat = (np.abs(turned) <= edges[:2] / 2 + CELL / 2 * (c + s)).all(axis=1).reshape(shape[:2])
        reach = np.array([c * edges[0] + s * edges[1], s * edges[0] + c * edges[1]]) / 2 + CELL / 2
        flat &= (np.abs(x - T[0, 3]) <= reach[0])[:, None] & (np.abs(y - T[1, 3]) <= reach[1])
        filled |= flat[:, :, None] & (np.abs(z - T[2, 3]) <= (edges[2] + CELL) / 2)
    return filled


def scene_of(boxes: Boxes, margin: float) -> Scene:
    scene = Scene(margin=margin)
    for name, (edges, T) in boxes.items():
        scene.add(name, Body.box(edges), T)
    return scene


def scene_of_cells(boxes: Boxes, rng: np.random.Generator) -> Scene:
    """The table, the block, and all else as bodies of cells, on a grid at a random place."""
    scene, low = Scene(), np.array([-0.5, -1.0, -0.2]) - rng.uniform(0, CELL, 3)
    others = [box for name, box in boxes.items() if name not in (TABLE, BLOCK)]
    for name, chosen in ((TABLE, [boxes[TABLE]]), (BLOCK, [boxes[BLOCK]]), (REST, others)):
        scene.add(name, Body.from_voxels(cells_of(chosen, low, (80, 80, 48)), CELL, origin=low))
    return scene


# -- physics --------------------------------------------------------------------------------------


class Simulation:
    """A robot in MuJoCo among boxes, its commands, and what happened."""

    def __init__(self, spec: Any, boxes: Boxes, start: Array) -> None:
        import mujoco

        self._mujoco = mujoco
        for name, (edges, T) in boxes.items():
            turn = np.arctan2(T[1, 0], T[0, 0])
            body = spec.worldbody.add_body(name=name, pos=T[:3, 3], quat=[np.cos(turn / 2), 0, 0, np.sin(turn / 2)])
            body.add_geom(name=name, type=mujoco.mjtGeom.mjGEOM_BOX, size=edges / 2)
        fingers = [body.name for body in spec.bodies if body.name.startswith("grip/")] if BLOCK in boxes else []
        self._wanted = [spec.add_exclude(bodyname1=finger, bodyname2=BLOCK) for finger in fingers]
        self._spec = spec
        self.model = spec.compile()
        self.data = mujoco.MjData(self.model)
        self.q, self.rate, self.n = start.copy(), np.zeros(len(start)), len(start)
        self.data.qpos[:] = start
        self.off, self.slow = np.zeros(self.n), np.zeros(self.n)  # largest departures from commands
        self.contacts: list[tuple[float, str, float, str]] = []
        self.doing, self.stops = "start", 0
        mujoco.mj_forward(self.model, self.data)

    @property
    def time(self) -> float:
        return float(self.data.time)

    def hand(self) -> Array:
        """The pose of the hand."""
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = self.data.body(HAND).xmat.reshape(3, 3), self.data.body(HAND).xpos
        return T

    def take(self, edges: Array, T: Array) -> None:
        """Make the block a part of the hand, at a pose in its frame."""
        quat = np.empty(4)
        self._mujoco.mju_mat2Quat(quat, T[:3, :3].ravel())
        for one in (*self._wanted, self._spec.body(BLOCK)):
            self._spec.delete(one)
        carried = self._spec.body(HAND).add_body(name="carried", pos=T[:3, 3], quat=quat)
        carried.add_geom(name="carried", type=self._mujoco.mjtGeom.mjGEOM_BOX, size=edges / 2, mass=0)
        self._spec.add_exclude(bodyname1="carried", bodyname2=TABLE)
        self.model, self.data = self._spec.recompile(self.model, self.data)

    def advance(self, q: Array, rate: Array) -> None:
        """Command a position and velocity for the end of a step of physics, and make it."""
        self.data.ctrl[: self.n], self.data.ctrl[self.n :] = q, rate
        self._mujoco.mj_step(self.model, self.data)
        self.q, self.rate = q, rate
        self.off = np.maximum(self.off, np.abs(self.data.qpos - q))
        for contact in self.data.contact[: self.data.ncon]:
            if contact.dist < 0:
                pair = " and ".join(self.model.geom(g).name for g in contact.geom)
                self.contacts.append((self.time, pair, float(contact.dist), self.doing))

    def follow(self, target: Array) -> None:
        """Go straight to the next target."""
        self.doing, begin, count = "targets", self.q, round(PERIOD / STEP)
        rate = (target - begin) / PERIOD
        for k in range(1, count + 1):
            self.advance(begin + k / count * (target - begin), rate)
        self.slow = np.maximum(self.slow, np.abs(self.data.qvel - rate))

    def brake(self, curve: planners.Trajectory) -> None:
        """Brake, and rest."""
        self.doing = "brake"
        for t in STEP * np.arange(1, np.ceil(curve.duration / STEP) + 1):
            at_end = min(t, curve.duration)
            self.advance(curve.positions(at_end), curve.velocities(at_end) * (t <= curve.duration))
        self.doing = "rest"
        for _ in range(round(STILL / STEP)):
            self.advance(self.q, np.zeros(self.n))


# -- policy and gates -----------------------------------------------------------------------------


class Policy:
    """Chunks of targets that follow a plan, with noise."""

    def __init__(self, checkers: list[CollisionChecker], limits: planners.JointLimits, rng: np.random.Generator,
                 spread: Array, error: Array) -> None:  # fmt: skip
        self._checkers, self._limits, self._rng, self._spread, self._error = checkers, limits, rng, spread, error
        self._robot = checkers[0].robot
        self._hand = self._robot.link_names.index(HAND)
        self.offset, self.s, self.apart = np.zeros(self._robot.dof), 0.0, list[float]()

    def plan(self, q: Array, goals: Array) -> None:
        """Plan from where the robot stands, with as much room as there is, and draw another offset."""
        self.offset, self.s = self._spread * self._rng.normal(size=len(q)), 0.0
        for checker in self._checkers:
            start = self._aside(q, checker)
            if start is None:
                continue
            try:
                seed = int(self._rng.integers(2**31))
                path = planners.plan(checker, start, planners.PoseGoal(HAND, goals), seed=seed, timeout=3.0)
            except PlanningError:
                continue
            blends = checker if start is q else None  # the way aside is within the margin
            path = path if start is q else np.vstack([q, path])
            self.way = planners.trajectory(self._robot, path, limits=self._limits, checker=blends)
            self.goal = self._robot.forward_kinematics(path[-1])[self._hand]
            return
        raise PlanningError("no plan with any margin")

    def _aside(self, q: Array, checker: CollisionChecker) -> Array | None:
        """The nearest of random configurations that are free with a margin, and to which the robot can go."""
        if not checker.collide(q):
            return q
        away = self._rng.normal(size=(400, len(q))) * self._rng.uniform(0.01, 0.2, (400, 1))
        near = np.clip(q + away, self._robot.hard_lower, self._robot.hard_upper)
        near = near[~checker.collide(near)]
        proofs = self._checkers[-1].certify_edges(np.tile(q, (len(near), 1)), near, joint_error=self._error)
        free = near[proofs.verdict == Verdict.FREE]
        return free[np.argmin(np.abs(free - q).max(axis=1))] if len(free) else None

    def chunk(self, q: Array) -> tuple[Array, Array]:
        """Targets from a command on, and the offset to which they tend."""
        offset = MEMORY * self.offset + np.sqrt(1 - MEMORY**2) * self._spread * self._rng.normal(size=len(q))
        t = PERIOD * np.arange(1, TARGETS + 1)
        x = np.minimum(t / BLEND, 1.0)[:, None]
        here, ahead = (self.way.positions(np.minimum(s, self.way.duration)) for s in (self.s, self.s + t))
        hands = self._robot.forward_kinematics(np.stack([q, here]))[:, self._hand]
        self.apart.append(float(np.linalg.norm(np.diff(hands[:, :3, 3] + TIP * hands[:, :3, 2], axis=0))))
        share = x * x * (3 - 2 * x)
        targets = ahead + (1 - share) * (q - here) + share * offset
        return np.clip(targets, self._robot.hard_lower, self._robot.hard_upper), offset

    def arrived(self, hand: Array) -> bool:
        """Whether the plan has ended and the hand is at its goal."""
        apart = self.goal[:3, :3].T @ hand[:3, :3]
        turn = np.arccos(np.clip((np.trace(apart) - 1) / 2, -1, 1))
        near = np.linalg.norm(hand[:3, 3] - self.goal[:3, 3]) < NEAR and turn < TURNED
        return bool(self.s >= self.way.duration and near)


class Passed(NamedTuple):
    """How many targets of a chunk may run, and the brake from the last of them."""

    targets: Array
    steps: int
    brake: planners.Trajectory | None


Judge = Callable[[Array, Array, Array], Passed]


class Cast:
    """A robot, what the tasks of it share, and by how much it departs from its commands."""

    def __init__(self, models: Path, name: str) -> None:
        self.models, self.name, self.arm = models, name, ARMS[name]
        self.robot = Robot.from_mujoco(described(models, name).compile())
        self.boxed = in_boxes(models, name, self.robot)
        self.fingers = [link for link in self.robot.link_names if link.startswith("grip/")]
        self.joint_error = self.velocity_error = np.zeros(self.robot.dof)

    def limits(self, share: float) -> planners.JointLimits:
        """The limits, or those of slower motions, which leave most of the acceleration to brakes."""
        none, accelerations = np.full(self.robot.dof, np.inf), self.arm.deceleration * min(1.0, 2 * share**2)
        ends = self.robot.hard_lower, self.robot.hard_upper
        return planners.JointLimits(
            self.robot.configuration_names, *ends, share * self.arm.velocity, accelerations, none
        )

    def spread(self, noise: float) -> Array:
        """Standard deviations of joints [rad] by which the fingertips are off by so much [m] at home."""
        J = np.asarray(self.robot.jacobian(self.arm.home, HAND, [0.0, 0.0, TIP]))
        return np.full(self.robot.dof, noise / np.sqrt((J[:3] ** 2).sum()))


class Task:
    """A world of a seed, as the planner, the gates and the tests have it."""

    def __init__(self, cast: Cast, seed: int) -> None:
        self.cast = cast
        self.boxes, self.place = world(np.random.default_rng([seed, 0]), shelf=bool(seed % 2))
        exact = [scene_of(self.boxes, margin) for margin in (*MARGINS, GUARD)]
        coarse = scene_of_cells(self.boxes, np.random.default_rng([seed, 2]))
        self.scenes = [*exact, coarse]
        *self.plans, self.guarded = (CollisionChecker(cast.robot, scene) for scene in exact)
        links = cast.boxed.link_names
        self.coarse = CollisionChecker(cast.boxed, coarse, allowed=[(a, b) for a in links for b in links if a < b])
        for scene in self.scenes:
            for link in cast.fingers:
                scene.allow(BLOCK, link)
            scene.allow(TABLE, BASES[cast.name])

    def grasps(self) -> Array:
        """Four poses of the hand over the block."""
        edges, T = self.boxes[BLOCK]
        turns = [at(0, 0, edges[2] / 2 - DEEP + TIP, turn) for turn in np.pi / 2 * np.arange(4)]
        return T @ turns @ np.diag([1.0, -1, -1, 1])

    def take(self, hand: Array) -> Array:
        """Attach the block to the hand; poses of the hand from which the block is where it is to be."""
        edges, T = self.boxes[BLOCK]
        hold = np.linalg.inv(hand) @ T
        for scene in self.scenes:
            scene.remove(BLOCK)
            scene.add("carried", Body.box(edges))
            scene.attach("carried", HAND, hold, touch_links=self.cast.fingers)
            scene.allow("carried", TABLE)
        turns = [at(0, 0, 0, turn) for turn in np.pi / 4 * np.arange(8)]
        return self.place @ turns @ np.linalg.inv(hold)

    def judge(self, gate: str, rng: np.random.Generator) -> Judge:
        """How far a gate lets chunks run; "random" stops some of them anywhere."""
        cast, arm = self.cast, self.cast.arm
        ours = Gate(self.guarded, cast.limits(1.0), acceleration=arm.deceleration,
                    joint_error=cast.joint_error, velocity_error=cast.velocity_error)  # fmt: skip

        def judged(q: Array, rate: Array, targets: Array) -> Passed:
            steps = len(targets)
            if gate == "ours":
                answer = ours.check(q, rate, targets, PERIOD)
                return Passed(targets, answer.steps, answer.brake)
            if gate == "voxels":
                steps = int(np.argmax(np.append(self.coarse.collide(targets), True)))
            elif gate == "random" and rng.random() < 0.5:
                steps = min(int(rng.integers(0, 3 * steps)), steps)
            rows = np.vstack([q, targets])
            speed = (rows[steps] - rows[steps - 1]) / PERIOD if steps else rate
            brake = planners.brake(cast.robot, rows[steps], speed, acceleration=arm.deceleration)  # is not proven
            return Passed(targets, steps, brake)

        return judged


class Outcome(NamedTuple):
    """What came of a task: why it was given up, or nothing; contacts; processor times of checks; departures."""

    why: str
    seconds: float
    stops: int
    contacts: list[tuple[float, str, float, str]]
    checks: list[float]
    off: Array
    slow: Array
    apart: list[float]

    @property
    def clean(self) -> bool:
        return not self.why and not self.contacts


def attempt(cast: Cast, seed: int, gate: str, noise: float) -> Outcome:
    """Run a task with a gate; with "random", in a world without boxes."""
    task, rng, checks, why = Task(cast, seed), np.random.default_rng([seed, 1]), list[float](), ""
    judge = task.judge(gate, rng)

    def timed(q: Array, rate: Array, targets: Array) -> Passed:
        begun = time.process_time()
        found = judge(q, rate, targets)
        checks.append(time.process_time() - begun)
        return found

    physical = {} if gate == "random" else task.boxes
    simulated = Simulation(described(cast.models, cast.name), physical, cast.arm.home)
    policy = Policy(task.plans, cast.limits(0.5), rng, cast.spread(noise), cast.joint_error)
    try:
        segment(simulated, policy, timed, task.grasps())
        goals = task.take(simulated.hand())
        if physical:
            edges, T = physical[BLOCK]
            simulated.take(edges, np.linalg.inv(simulated.hand()) @ T)
        segment(simulated, policy, timed, goals)
    except PlanningError as error:
        why = str(error).splitlines()[0]
    return Outcome(why, simulated.time, simulated.stops, simulated.contacts, checks,
                   simulated.off, simulated.slow, policy.apart)  # fmt: skip


def segment(simulated: Simulation, policy: Policy, judged: Judge, goals: Array) -> None:
    """Bring the hand to one of several poses, at rest, and count how often the robot was stopped on the way."""
    end, most = simulated.time + LONGEST, simulated.stops + STOPS
    policy.plan(simulated.q, goals)
    held, i = Passed(np.empty((0, simulated.n)), 0, None), 0
    while simulated.time < end and simulated.stops <= most:
        best, offset = held, policy.offset
        for draw in range(SAMPLES):
            targets, drawn = policy.chunk(simulated.q)
            found = judged(simulated.q, simulated.rate, targets)
            if draw == 0 or found.steps > best.steps:
                best, offset = found, drawn
            if found.steps >= RUN:
                break
        if best.steps >= min(RUN, held.steps - i + 1):
            held, i, policy.offset = best, 0, offset
        count = min(RUN, held.steps - i)
        for target in held.targets[i : i + count]:
            simulated.follow(target)
        i, policy.s = i + count, policy.s + PERIOD * count
        if policy.arrived(simulated.hand()):
            for target in held.targets[i : held.steps]:
                simulated.follow(target)
            simulated.brake(held.brake)
            if policy.arrived(simulated.hand()):
                return
        elif count > 0:
            continue
        elif held.brake is not None:
            simulated.brake(held.brake)
        simulated.stops += 1
        policy.plan(simulated.q, goals)
        held, i = Passed(np.empty((0, simulated.n)), 0, None), 0
    raise PlanningError("stopped too often" if simulated.stops > most else "took too long")


# -- figures --------------------------------------------------------------------------------------


def calibrate(cast: Cast, noise: float, tasks: int) -> None:
    """Measure by how much the robot departs from its commands, in tasks that are not those of the table."""
    runs = [attempt(cast, 10_000 + k, "random", noise) for k in range(tasks)]
    cast.joint_error = 1.5 * np.max([run.off for run in runs], axis=0)
    cast.velocity_error = 1.5 * np.max([run.slow for run in runs], axis=0)
    print(f"{cast.name}: joint_error {np.round(1e3 * cast.joint_error, 2)} mrad, "
          f"velocity_error {np.round(cast.velocity_error, 3)} rad/s", flush=True)  # fmt: skip


def main(arguments: list[str] | None = None) -> int:
    """Run the tasks and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--models", type=Path, help="folder of robosuite's robots and grippers, if it is not installed")
    parser.add_argument("--tasks", type=int, default=100, help="for each robot (100)")
    parser.add_argument("--first", type=int, default=0, help="seed of the first one (0)")
    parser.add_argument("--robots", nargs="+", choices=list(ARMS), default=list(ARMS))
    parser.add_argument("--noise", type=float, default=20.0, help="of the fingertips [mm, root mean square] (20)")
    parser.add_argument("--calibration", type=int, default=20, help="tasks in which departures are measured (20)")
    parser.add_argument("--gates", nargs="+", choices=GATES, default=list(GATES))
    parser.add_argument("--log", action="store_true", help="print every task")
    options = parser.parse_args(arguments)
    models = options.models if options.models is not None else installed()
    if models is None:
        print("not run: package robosuite is not installed")
        return 0
    total = Counter[str]()
    for name in options.robots:
        cast = Cast(models, name)
        calibrate(cast, options.noise / 1e3, options.calibration)
        found: dict[str, list[Outcome]] = {}
        for gate in options.gates:
            found[gate] = []
            for seed in range(options.first, options.first + options.tasks):
                one = attempt(cast, seed, gate, options.noise / 1e3)
                found[gate].append(one)
                if options.log:
                    print(name, gate, seed, one.why or "finished", f"{one.seconds:.1f} s, {one.stops} stops",
                          one.contacts[:1], flush=True)  # fmt: skip
            show(name, gate, found[gate], cast)
        clean = [one.clean for one in found.get("none", [])]
        for gate in found.keys() & {"ours", "voxels"} if clean else ():
            passes = [one.clean for one in found[gate]]
            total.update({gate: sum(passes), f"{gate}, the same": sum(np.array(clean) & passes)})
        total.update({"none": sum(clean)})
    for gate in total.keys() & {"ours", "voxels"}:
        print(f"{gate}: {total[gate]} without contact, {total['none']} without a gate; ratio "
              f"{total[gate] / max(total['none'], 1):.3f}; of these, {total[f'{gate}, the same']} too")  # fmt: skip
    return 0


def show(name: str, gate: str, found: list[Outcome], cast: Cast) -> None:
    """Print a row of the table."""
    done = [one for one in found if not one.why]
    clean = [one for one in done if one.clean]
    hit = [one for one in found if one.contacts]
    times, checks = [one.seconds for one in clean], 1e3 * np.concatenate([[0.0], *(one.checks for one in found)])
    left = sum(bool((one.off > cast.joint_error).any()) for one in found)
    slow = sum(bool((one.slow > cast.velocity_error).any()) for one in found)
    middle, late, most = np.percentile(checks, [50, 99, 100])
    print(f"{name:6} {gate:7} finished {len(done):4}, without contact {len(clean):4}, in contact {len(hit):4}, "
          f"gave up {len(found) - len(done):4}; s, median {np.median(times) if times else np.nan:5.1f}; "
          f"mm from the plan {1e3 * np.sqrt(np.mean(np.concatenate([one.apart for one in found]) ** 2)):.1f}; "
          f"stops {sum(one.stops for one in found):5}; a check, ms: {middle:.2f}, 99 % {late:.2f}, most {most:.2f}; "
          f"beyond joint_error {left}, velocity_error {slow}", flush=True)  # fmt: skip


if __name__ == "__main__":
    sys.exit(main())
