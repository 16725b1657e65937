"""Pick-and-place tasks from poses to a controller's files, the audits of the files, and dense samples against them.

    python tests/handed_on.py [--tasks 100]

A Panda or a UR5 takes a can from a table and puts it on the table or on a shelf, or the table is a point cloud, as
voxels. Each of the five motions of a task is written as a message for the controller of its joints, with a file of the
scene. `loewner audit` has to prove each file again. Then each carry is changed by a millimetre, and by five per cent of
time. The oracle interpolates a message by SciPy and measures exact distances at 10 kHz.
"""

import argparse
import contextlib
import io
import json
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path
from typing import NamedTuple

import numpy as np
import yaml
from scipy.interpolate import BPoly

import loewner
from families import translation
from loewner import Body, CollisionChecker, PlanningError, Robot, Scene, planners
from loewner.cli.main import main as command
from loewner.queries import pairs as queries
from robot_oracle import robots_folder

RADIUS, LENGTH = 0.03, 0.12  # of the can [m]
OPEN, CLOSED = 0.04, 0.0305  # closed, half a millimetre is left, which is less than the margin
RISE, GRASPS, HIGHER = 0.1, 8, 0.04
TABLE, SHELF, VOXEL, MARGIN = 0.1, 0.3, 0.02, 0.002
ACCELERATION, JERK = 2.0, 20.0
MILLIMETRE, STRETCH = 1e-3, 1.05
KINDS = ("table", "shelf", "voxels")

# Samples per second of carries and of other files, how many at once, and the tolerance of proofs [m].
RATE, SLOW, AT_ONCE, TOLERANCE = 10_000.0, 1000.0, 20_000, 1e-5

# Two bodies have parted if they are farther apart than their margin by this distance, which is a ten-thousandth of more
# than the reach of an arm [m].
PARTED = 2e-3

# Samples per second at which the near pairs are found, by how much these can approach each other in half this time, at
# ten metres per second, and the accuracy of exact distances [m].
COARSE, MOVED, MEASURED = 1000.0, 0.005, 1e-8

# Two fingers with inner faces at y = v and y = -v, below a palm at the flange of a UR5.
GRIPPER = """<link name="palm"><collision><origin xyz="0 0 0.03"/><geometry><box size="0.06 0.14 0.05"/></geometry>
</collision></link>
<joint name="mount" type="fixed"><parent link="tool0"/><child link="palm"/></joint>
<link name="left"><collision><origin xyz="0 0.005 0.09"/><geometry><box size="0.02 0.01 0.06"/></geometry></collision>
</link>
<link name="right"><collision><origin xyz="0 -0.005 0.09"/><geometry><box size="0.02 0.01 0.06"/></geometry></collision>
</link>
<joint name="opening" type="prismatic"><parent link="palm"/><child link="left"/><axis xyz="0 1 0"/>
  <limit lower="0" upper="0.06" effort="1" velocity="0.1"/></joint>
<joint name="other" type="prismatic"><parent link="palm"/><child link="right"/><axis xyz="0 -1 0"/>
  <limit lower="0" upper="0.06" effort="1" velocity="0.1"/><mimic joint="opening"/></joint>
<link name="world"/>"""


class Cell(NamedTuple):
    """A robot with its files; the last of its values opens the fingers.

    Attributes
    ----------
    options : tuple of str
        The robot's files, as options of the command line.
    tips : float
        From the hand's origin to the middle between the finger tips [m].
    """

    robot: Robot
    options: tuple[str, ...]
    home: np.ndarray
    hand: str
    fingers: tuple[str, str]
    tips: float

    @property
    def arm(self):
        return self.robot.configuration_names[:-1]


class Step(NamedTuple):
    """A motion of a task as it is handed on: files of its scene and trajectory, and the values of the other joints."""

    name: str
    scene: Path
    points: Path
    rest: np.ndarray


class Found(NamedTuple):
    """The worst sample: by how much it breaks the rules [m], its pair and the end of the motion, and its time [s]."""

    excess: float
    where: tuple[str, ...] = ()
    time: float = np.nan


def cells(folder):
    """The Panda, and the UR5 with a gripper."""
    data = robots_folder()
    packages = ("--package-dir", str(data.parents[1]))
    made = folder / "ur5_with_gripper.urdf"
    text = (data / "ur_description/urdf/ur5_robot.urdf").read_text()
    made.write_text(text.replace('<link name="world"/>', GRIPPER))
    panda, srdf = data / "panda_description/urdf/panda.urdf", data / "panda_description/srdf/panda.srdf"
    of_ur5 = data / "ur_description/srdf/ur5.srdf"
    robots = [Robot.from_urdf(a, srdf=b, package_dirs=[packages[1]]) for a, b in ((panda, srdf), (made, of_ur5))]
    home = robots[0].configuration("default")
    home[-1] = OPEN
    fingers = ("panda_leftfinger", "panda_rightfinger")
    above = np.array([0.0, -1.6, 1.6, -1.57, -1.57, 0.0, OPEN])
    return [
        Cell(robots[0], (str(panda), "--srdf", str(srdf), *packages), home, "panda_hand", fingers, 0.1034),
        Cell(robots[1], (str(made), "--srdf", str(of_ur5), *packages), above, "palm", ("left", "right"), 0.105),
    ]


# -- tasks -----------------------------------------------------------------------------------------


def world(rng, kind):
    """A scene, the bodies that the can leaves and reaches, where it is, and where it is to be."""
    can = translation(rng.uniform(0.4, 0.55), rng.uniform(-0.4, -0.2), TABLE + LENGTH / 2)
    place = translation(rng.uniform(0.4, 0.55), rng.uniform(0.0, 0.2), TABLE + LENGTH / 2)
    if kind == "shelf":
        place = translation(rng.uniform(0.35, 0.5), rng.uniform(0.35, 0.45), SHELF + LENGTH / 2)
    spots = rng.uniform([0.3, -0.45], [0.75, 0.3], size=(6, 2))
    spots = [spot for spot in spots if min(np.hypot(*(spot - T[:2, 3])) for T in (can, place)) > 0.14]
    scene = Scene(margin=MARGIN)
    scene.add("can", Body.cylinder(RADIUS, LENGTH), can)
    if kind == "voxels":
        points = [rng.uniform([0.2, -0.5, TABLE - 0.5 * VOXEL], [0.8, 0.4, TABLE - 1e-3], size=(20_000, 3))]
        points += [np.append(spot, TABLE) + rng.uniform(-1, 1, (500, 3)) * [0.03, 0.03, 0.1] for spot in spots]
        points = np.concatenate(points)
        scene.add("seen", Body.from_cloud(points[points[:, 2] > TABLE - 0.5 * VOXEL], voxel=VOXEL))
        return scene, "seen", "seen", can, place
    scene.add("table", Body.box([0.6, 0.9, 0.02]), translation(0.5, -0.05, TABLE - 0.01))
    for k, spot in enumerate(spots):
        scene.add(f"box {k}", Body.box([0.06, 0.06, 0.1]), translation(*spot, TABLE + 0.051))
    if kind == "shelf":
        boards = np.array([[0.45, 0.5, SHELF - 0.01, 0.3, 0.4, 0.02], [0.45, 0.71, 0.3, 0.3, 0.02, 0.6]])
        scene.add("shelf", Body.boxes(*np.split(boards, 2, axis=1)))
    return scene, "table", "shelf" if kind == "shelf" else "table", can, place


def hands(cell, can):
    """Poses of the hand that holds a can from above, shape (8, 4, 4)."""
    T = np.tile(can @ translation(z=HIGHER + cell.tips), (GRASPS, 1, 1))
    turns = 2 * np.pi * np.arange(GRASPS) / GRASPS
    c, s, zero, one = np.cos(turns), np.sin(turns), np.zeros(GRASPS), np.ones(GRASPS)
    T[:, :3, :3] = np.stack([c, s, zero, s, -c, zero, zero, zero, -one], axis=-1).reshape(-1, 3, 3)
    return T


def pose(cell, q):
    """The pose of the hand."""
    return cell.robot.forward_kinematics(q)[cell.robot.link_names.index(cell.hand)]


def solve(cell, kind, seed, folder):
    """Plan all motions of a task from poses, give them times, and write them with their scenes."""
    rng = np.random.default_rng(seed)
    scene, source, target, can, place = world(rng, kind)
    robot, checker, steps = cell.robot, CollisionChecker(cell.robot, scene), []
    jerk = JERK if rng.random() < 0.5 else None
    up = ("world", [0.0, 0.0, RISE])

    def hand_on(name, path, joints):
        moved = planners.trajectory(robot, path, acceleration=ACCELERATION, jerk=jerk, checker=checker)
        files = folder / f"{name} scene.yaml", folder / f"{name}.yaml"
        loewner.save_scene(scene, files[0])
        moved.save(files[1], joints=joints)
        steps.append(Step(name, *files, path[0]))

    def from_above(q, poses):
        goal = planners.PoseGoal(cell.hand, poses, approach=("world", [0.0, 0.0, -RISE]))
        return planners.plan(checker, q, goal, joints=cell.arm, seed=seed)

    approach = from_above(cell.home, hands(cell, can))
    hand_on("approach", approach, cell.arm)
    closed = np.append(approach[-1, :-1], CLOSED)
    for finger in cell.fingers:
        scene.reach("can", finger)
    hand_on("close", np.stack([approach[-1], closed]), robot.configuration_names[-1:])

    T_can_hand = np.linalg.inv(can) @ pose(cell, closed)
    scene.attach("can", cell.hand, np.linalg.inv(T_can_hand), touch_links=cell.fingers, leave=[source], reach=[target])
    lift = planners.straight(checker, closed, cell.hand, translation(z=RISE) @ pose(cell, closed), joints=cell.arm)
    turned = hands(cell, np.eye(4)) @ np.linalg.inv(hands(cell, np.eye(4))[0])  # about the can's axis
    carry = np.concatenate([lift[:-1], from_above(lift[-1], place @ turned @ T_can_hand)])
    hand_on("carry", carry, cell.arm)

    scene.detach("can", pose(cell, carry[-1]) @ np.linalg.inv(T_can_hand))
    for finger in cell.fingers:
        scene.leave("can", finger)
    opened = np.append(carry[-1, :-1], OPEN)
    hand_on("open", np.stack([carry[-1], opened]), robot.configuration_names[-1:])
    away = planners.PoseGoal(cell.hand, pose(cell, opened), retreat=up).retreat_path(checker, opened, cell.arm)
    home = planners.plan(checker, away[-1], cell.home, joints=cell.arm, seed=seed)
    hand_on("retreat", np.concatenate([away[:-1], home]), cell.arm)
    return steps


# -- the command and the oracle --------------------------------------------------------------------


def audit(cell, step, points, *, apart=False):
    """The exit status and the answer of `loewner audit`, perhaps in a process apart."""
    others = " ".join(map(repr, step.rest.tolist()))
    words = ["audit", *cell.options, str(points), "--scene", str(step.scene), f"--others={others}", "--json"]
    if apart:
        done = subprocess.run([sys.executable, "-m", "loewner", *words], capture_output=True, text=True, check=False)
        return done.returncode, json.loads(done.stdout)
    out = io.StringIO()
    with contextlib.redirect_stdout(out):
        status = command(words)
    return status, json.loads(out.getvalue())


def curve_of(message):
    """The curve that a controller interpolates between the points of a message, from SciPy."""
    points = message["points"]
    times = [p["time_from_start"]["sec"] + 1e-9 * p["time_from_start"]["nanosec"] for p in points]
    given = [[p[key] for key in ("positions", "velocities", "accelerations") if p.get(key)] for p in points]
    return BPoly.from_derivatives(np.array(times), np.array(given))


def oracle(cell, step, points, rate):
    """Hold samples of a message against the rules of its scene; returns the worst one."""
    message = yaml.load(points.read_text(), yaml.CSafeLoader)
    columns = [cell.robot.configuration_names.index(name) for name in message["joint_names"]]
    curve, checker = curve_of(message), CollisionChecker(cell.robot, loewner.load_scene(step.scene))
    count = int(rate / COARSE)
    times = np.linspace(curve.x[0], curve.x[-1], count * int(COARSE * (curve.x[-1] - curve.x[0]) + 1) + 1)
    Q = np.tile(step.rest, (len(times), 1))
    Q[:, columns] = curve(times)
    ready, found = checker._ready(), [Found(0.0)]
    for pair, names in enumerate(ready.names_of_pairs[:-1].tolist()):
        d, margin = distances(ready, pair, Q, count), float(ready.margins[pair])
        leaves, reaches = bool(ready.leaving[pair]), bool(ready.reaching[pair])
        top = int(d.argmax()) if reaches and leaves else (len(d) - 1) * (not reaches)
        runs = [(np.arange(top, len(d))[::-1], "to", True, TOLERANCE)] if reaches else []
        if leaves or not reaches:
            runs.append((np.arange(top + 1), "from", leaves, np.inf))
        for run, way, allowed, deepest in runs:
            excess, at = broken(d[run], margin, deepest) if allowed else (margin - d[run].min(), d[run].argmin())
            found.append(Found(float(excess), (*names, way), float(times[run[at]])))
    return max(found)


def distances(ready, pair, Q, count):
    """Exact distances of a pair; lower bounds where the nearest of every `count` configurations is far from contact."""
    (i, j), far = ready.pairs[pair].tolist(), float(ready.margins[pair]) + MOVED
    T = ready.poses(Q[::count].copy())
    coarse = queries.distance(ready.body(i), T[:, i], ready.body(j), T[:, j]).lower
    d = np.repeat(coarse, count)[count // 2 : count // 2 + len(Q)]
    near = np.flatnonzero(d <= far)
    for first in range(0, len(near), AT_ONCE):
        now = near[first : first + AT_ONCE]
        T = ready.poses(Q[now])
        d[now] = queries.distance(ready.body(i), T[:, i], ready.body(j), T[:, j], exact=True).distance
    return d


def broken(d, margin, deepest):
    """By how much distances break the rule of a motion that may begin in contact, and at which of them."""
    start, apart = d[0], np.flatnonzero(d > margin + TOLERANCE + PARTED)
    touches = start <= margin + TOLERANCE
    end = 0 if not touches else int(apart[0]) if len(apart) else len(d)
    excess = margin - d
    excess[:end] = min(start, margin) - 1.02 * TOLERANCE - d[:end]
    return max((excess.max(), excess.argmax()), (-1.02 * deepest - start, 0))


# -- changes ---------------------------------------------------------------------------------------


def a_millimetre(rng, cell, step, message):
    """Move the hand by a millimetre, down or anywhere: on the whole carry, at its end, or at one point."""
    points, rest = message["points"], step.rest.copy()
    way = np.array([0.0, 0.0, -1.0]) if rng.random() < 0.5 else rng.normal(size=3)
    rows = [range(len(points)), range(len(points) - 3, len(points)), [int(rng.integers(len(points)))]][rng.integers(3)]
    rest[:-1] = points[rows[-1]]["positions"]
    J = cell.robot.jacobian(rest, cell.hand)[:, :-1]
    off = np.linalg.pinv(J) @ np.concatenate([MILLIMETRE * way / np.linalg.norm(way), np.zeros(3)])
    for k in rows:
        points[k]["positions"] = (np.array(points[k]["positions"]) + off).tolist()


def five_per_cent(rng, cell, step, message):
    """Stretch half of the pieces by five per cent, or all velocities, or leave out velocities."""
    points, kind = message["points"], rng.integers(3)
    if kind == 0:
        nanoseconds = np.array([10**9 * p["time_from_start"]["sec"] + p["time_from_start"]["nanosec"] for p in points])
        pieces = np.diff(nanoseconds, prepend=0)
        slow = rng.random(len(pieces)) < 0.5
        pieces = np.where(slow, pieces * 105 // 100, pieces)
        for p, t in zip(points, np.cumsum(pieces).tolist(), strict=True):
            p["time_from_start"] = {"sec": t // 10**9, "nanosec": t % 10**9}
    for p in points:
        if kind == 1:
            p["velocities"] = (STRETCH * np.array(p["velocities"])).tolist()
        if kind == 2:
            p.pop("velocities")
            p.pop("accelerations", None)


CHANGES = {"1 mm": a_millimetre, "5 % of time": five_per_cent}


# -- all of it -------------------------------------------------------------------------------------


class Judged(NamedTuple):
    """A file with the verdict of its audit and the worst sample.

    Attributes
    ----------
    status : int
        The exit status of the command.
    """

    name: str
    verdict: str
    status: int
    worst: Found

    def __str__(self):
        refuted = f" (refuted by {self.worst.excess:.1e} m)" * self.refuted
        return f"{self.name} {self.verdict}{refuted}{' WRONG' * self.wrong}"

    @property
    def refuted(self):
        return self.worst.excess > MEASURED

    @property
    def wrong(self):
        """Whether samples refute FREE, or a collision that is deeper than the tolerance is not found."""
        deep = self.worst.excess > 2 * TOLERANCE
        return self.refuted and (self.verdict == "FREE" or (deep and self.verdict != "COLLIDING"))


class Task(NamedTuple):
    """What was found of a task: its files as planned and its changed carries, or why it was not solved."""

    name: str
    handed_on: tuple[Judged, ...] = ()
    changed: tuple[Judged, ...] = ()
    refused: str = ""


def judged(name, cell, step, points, *, rate=RATE, apart=False):
    """Audit a file, and hold it against samples, if there is a rate for them."""
    status, answer = audit(cell, step, points, apart=apart)
    return Judged(name, answer["verdict"], status, oracle(cell, step, points, rate) if rate else Found(0.0))


def done(cell, kind, seed, folder, *, closely=False):
    """Solve a task, audit its files, change its carry in each way, and audit this, too.

    `closely` means that the carry is audited in a process of its own, and that the other files are sampled as well.
    """
    name = f"task {seed}, {cell.robot.name}, {kind}"
    try:
        steps = solve(cell, kind, seed, folder)
    except PlanningError as error:
        return Task(name, refused=str(error))
    handed_on, changed, rng = [], [], np.random.default_rng([seed, 1])
    for step in steps:
        carries = step.name == "carry"
        rate = RATE if carries else SLOW * closely
        handed_on.append(judged(step.name, cell, step, step.points, rate=rate, apart=closely and carries))
        for how, change in CHANGES.items() if carries else ():
            message = yaml.load(step.points.read_text(), yaml.CSafeLoader)
            change(rng, cell, step, message)
            points = folder / f"{how}.yaml"
            points.write_text(yaml.dump(message, Dumper=yaml.CSafeDumper))
            changed.append(judged(how, cell, step, points))
    return Task(name, tuple(handed_on), tuple(changed))


def campaign(count, folder, *, first=0, closely=10):
    """Do tasks until so many are solved; others replace those that are not. The first ones are done closely."""
    robots, solved, seed = cells(folder), 0, first
    while solved < count:
        place = folder / str(seed)
        place.mkdir()
        found = done(robots[seed % 2], KINDS[seed % 3], seed, place, closely=solved < closely)
        yield found
        solved, seed = solved + (not found.refused), seed + 1


def report(tasks):
    """Lines about the tasks, the verdicts of their files, and wrong verdicts."""
    refused = [task for task in tasks if task.refused]
    yield f"{len(tasks) - len(refused)} tasks solved, {len(refused)} refused"
    yield from (f"    {task.name}: {task.refused}" for task in refused)
    for what in ("handed_on", "changed"):
        files = [(task.name, file) for task in tasks for file in getattr(task, what)]
        verdicts, refuted = Counter(file.verdict for _, file in files), [file for _, file in files if file.refuted]
        found = sum(file.verdict == "COLLIDING" for file in refuted)
        yield f"{len(files)} files {what}: {dict(verdicts)}; samples refute {len(refuted)}, {found} of them COLLIDING"
        yield f"    {sum(file.wrong for _, file in files)} wrong"
        yield from (f"    wrong: {name}, {file!r}" for name, file in files if file.wrong)
        yield from (f"    not proven: {name}, {file!r}" for name, file in files if what == "handed_on" and file.status)


def main():
    """Run the tasks and print the report."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--tasks", type=int, default=100)
    parser.add_argument("--first", type=int, default=0, help="the first seed")
    options = parser.parse_args()
    began, tasks = time.perf_counter(), []
    with tempfile.TemporaryDirectory() as folder:
        for task in campaign(options.tasks, Path(folder), first=options.first):
            tasks.append(task)
            found = task.refused or ", ".join(map(str, task.handed_on + task.changed))
            print(f"{task.name}: {found}", flush=True)
    print("\n".join(report(tasks)))
    print(f"{(time.perf_counter() - began) / 60:.1f} minutes")


if __name__ == "__main__":
    main()
