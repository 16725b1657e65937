"""Plans in time of one Panda and of two among five moving boxes, and plans of two arms among nothing that moves.

python benchmarks/plans_in_time.py [PROBLEMS]

Then times for paths that were planned without the boxes, and for paths across a belt with boxes on it: by
`planners.time_path`, and by trying a start every quarter of a second.

Each plan is proven again by `certify_edges` and `certify_trajectory`, and sampled in steps of 1e-3 of each motion.
OMPL's planner for space and time, STRRTstar, is not in its wheel of version 2.0.1, so nothing is beside ours.
"""

from __future__ import annotations

import sys
import time
import warnings
from collections.abc import Iterator

import numpy as np
from scipy.spatial.transform import Rotation

from clock import threads_set_to
from loewner import Body, CollisionChecker, PlanningError, Robot, Scene, Verdict, planners
from robot_samples import example, panda
from samples import Array

BODIES, PROBLEMS = 5, 100
# Distance of the axis of a box's way from the axes of bases, and from the middle between them [m].
NEAREST, FARTHEST = 0.3, 1.0
APART = 0.7  # of two Pandas opposite each other [m]
SAMPLES = np.linspace(0.0, 1.0, 1001)
BOXES, SPEED, STEP = 20, 0.3, 0.25  # on a belt, its speed [m/s], and between tried starts [s]


def moving_scene(rng: np.random.Generator, bases: Array) -> Scene:
    """Boxes that wander and turn, and whose ways keep clear of the bases."""
    scene = Scene()
    shares = np.linspace(0.0, 1.0, 60)[:, None, None]
    for k in range(BODIES):
        count, edges = int(rng.integers(2, 5)), rng.uniform(0.05, 0.2, 3)
        while True:
            way = rng.normal(size=(count, 3))
            X = way / np.linalg.norm(way, axis=1)[:, None] * rng.uniform(0.4, FARTHEST, (count, 1))
            X += [bases.mean(), 0.0, 0.4]
            Y = ((1 - shares) * X[:-1] + shares * X[1:]).reshape(-1, 3)
            Y = Y[Y[:, 2] < 0.75]
            apart = np.hypot(Y[:, 0] - bases[:, None], Y[:, 1]).min(initial=np.inf)
            if apart > NEAREST + np.linalg.norm(edges) / 2:
                break
        T = np.tile(np.eye(4), (count, 1, 1))
        T[:, :3, :3] = Rotation.from_rotvec(rng.normal(size=3) * 0.5 * np.arange(count)[:, None]).as_matrix()
        T[:, :3, 3] = X
        scene.add(f"box {k}", Body.box(edges))
        scene.follow(f"box {k}", np.cumsum(rng.uniform(1.0, 3.0, count)) - 2.0, T)
    return scene


def problems(robot: Robot, bases: Array, count: int) -> Iterator[tuple[CollisionChecker, Array, Array]]:
    """Random scenes, starts that are free at 0 s, and goals that are free at 5 s."""
    for seed in range(count):
        checker = CollisionChecker(robot, moving_scene(np.random.default_rng(seed), bases))
        Q = robot.random_configurations(2000, seed)
        yield checker, Q[~checker.collide(Q, 0.0)][0], Q[~checker.collide(Q, 5.0)][-1]


def in_time(name: str, robot: Robot, bases: Array, count: int) -> None:
    """Print how long plans take, and how many fail, arrive at the earliest, or are refuted."""
    seconds, solved, direct, refuted, ratios = [], 0, 0, 0, []
    for checker, start, goal in problems(robot, bases, count):
        began = time.process_time()
        try:
            plan = planners.plan(checker, start, goal, start_time=0.0)
        except PlanningError:
            seconds.append(time.process_time() - began)
            continue
        seconds.append(time.process_time() - began)
        solved += 1
        direct += len(plan.times) == 2
        ratios.append(plan.duration / (np.abs(goal - start) / robot.velocity).max())
        a, b, t0, t1 = plan.knots[:-1], plan.knots[1:], plan.times[:-1], plan.times[1:]
        proven = (checker.certify_edges(a, b, t0=t0, t1=t1).verdict == Verdict.FREE).all()
        proven &= checker.certify_trajectory(plan).verdict == Verdict.FREE
        Q = a[:, None] + SAMPLES[:, None] * (b - a)[:, None]
        hit = checker.collide(Q, t0[:, None] + SAMPLES * (t1 - t0)[:, None]).any()
        fast = (np.abs(b - a) > robot.velocity * (t1 - t0)[:, None]).any()
        refuted += bool(not proven or hit or fast)
    ms = 1e3 * np.array(seconds)
    print(
        f"{name}: {solved} of {count} solved, {direct} by the direct motion, {refuted} refuted; ms: median "
        f"{np.median(ms):.1f}, 90 % {np.quantile(ms, 0.9):.1f}, max {ms.max():.0f}; arrival at "
        f"{np.exp(np.mean(np.log(ratios))):.2f} times the earliest without obstacles"
    )


def still(name: str, robot: Robot, joints: list[str], count: int) -> None:
    """Print how long plans of a robot alone take, between random free configurations."""
    checker = CollisionChecker(robot)
    Q = robot.random_configurations(20 * count, 1)
    frozen = [k for k, joint in enumerate(robot.configuration_names) if joint not in joints]
    Q[:, frozen] = robot.configuration()[frozen]
    Q = Q[~checker.collide(Q)][: 2 * count]
    seconds, proven = [], 0
    for start, goal in zip(Q[::2], Q[1::2], strict=True):
        began = time.process_time()
        try:
            path = planners.plan(checker, start, goal, joints=joints)
        except PlanningError:  # as from a posture in which the arms are entangled
            continue
        finally:
            seconds.append(time.process_time() - began)
        proven += bool((checker.certify_edges(path[:-1], path[1:]).verdict == Verdict.FREE).all())
    ms = 1e3 * np.array(seconds)
    print(f"{name}: {proven} of {count} proven; ms: median {np.median(ms):.2f}, 90 % {np.quantile(ms, 0.9):.2f}")


def belts(robot: Robot, count: int) -> Iterator[tuple[CollisionChecker, Array, Array]]:
    """An arm that reaches across a belt, with boxes at random distances on it."""
    home = robot.configuration("default")
    T = robot.forward_kinematics(home)[robot.link_names.index("panda_hand")]
    for seed in range(count):
        rng, scene = np.random.default_rng(seed), Scene(margin=0.005)
        scene.add("belt", Body.box([0.4, 6.0, 0.1]), at(0.55, 0.0, 0.0))
        way = -np.cumsum(rng.uniform(0.25, 0.6, BOXES))
        for k, y in enumerate(way - 0.3):
            scene.add(f"box {k}", Body.box([0.12, 0.12, rng.uniform(0.1, 0.3)]))
            scene.follow(f"box {k}", [0.0, 20.0], [at(0.55, y, 0.25), at(0.55, y + 20.0 * SPEED, 0.25)])
        ends = []
        while len(ends) < 2:
            T[:3, 3] = rng.uniform([0.45, -0.4, 0.22], [0.65, 0.4, 0.4])
            T[1, 3] = abs(T[1, 3]) * (1, -1)[len(ends)]
            found = robot.reach("panda_hand", T, start=home)
            checker = CollisionChecker(robot, scene)
            if found.reached and not checker.collide(found.configuration, 5.0 * len(ends)):
                ends.append(found.configuration)
        yield checker, *ends


def timed(name: str, given: Iterator[tuple[CollisionChecker, Array, Array]]) -> None:
    """Print how many paths get times, when they arrive, and how long that takes; and the same for tried starts."""
    total, seconds, tried, ours, theirs, around, saved, refuted = 0, [], [], 0, 0, 0, [], 0
    for checker, start, goal in given:
        still = checker.scene.copy()
        for body in still.following:
            still.remove(body)
        alone = CollisionChecker(checker.robot, still)
        try:
            path = planners.plan(alone, start, goal)
        except PlanningError:
            continue
        total += 1
        began = time.process_time()
        found = times_for(checker, path)
        seconds.append(time.process_time() - began)
        if found is None:
            around += times_for(checker, way_around(checker, start, goal)) is not None
        began = time.process_time()
        moved = planners.trajectory(checker.robot, path, checker=alone)
        waits = np.arange(0.0, 20.0, STEP)
        free = (t for t in waits if checker.certify_trajectory(moved, t0=t).verdict == Verdict.FREE)
        first = next(free, None)
        if first and checker.certify_edges(start, start, t0=0.0, t1=first).verdict != Verdict.FREE:
            first = None
        tried.append(time.process_time() - began)
        ours, theirs = ours + (found is not None), theirs + (first is not None)
        if found is not None:
            x = np.linspace(0.0, found.duration, 2001)
            hit = checker.collide(found.positions(x), x).any()
            over = (np.abs(found.accelerations(x)) > checker.robot.velocity * (1.0 + 1e-9)).any()
            refuted += bool(hit or over or found.certify(checker).verdict != Verdict.FREE)
        if found is not None and first is not None:
            saved.append(first + moved.duration - found.duration)
    ms, others, less = 1e3 * np.array(seconds), 1e3 * np.array(tried), np.array(saved)
    print(
        f"{name}: times for {ours} of {total}, and for {around} more along plans in time, {refuted} refuted; ms: "
        f"median {np.median(ms):.0f}, 90 % {np.quantile(ms, 0.9):.0f}, max {ms.max():.0f}. By tried starts {theirs} of "
        f"{total}, ms: median {np.median(others):.0f}, max {others.max():.0f}; of {len(less)} with both, time_path "
        f"arrives earlier by more than 10 ms in {(less > 0.01).sum()}, later in {(less < -0.01).sum()}, and "
        f"{less.mean():.3f} s earlier on average (from {less.min():.2f} to {less.max():.2f})"
    )


def times_for(checker: CollisionChecker, path: Array | None) -> planners.Trajectory | None:
    """Times for a path from 0 s on, if there are any."""
    if path is None:
        return None
    try:
        return planners.time_path(checker, path, start_time=0.0)
    except PlanningError:
        return None


def way_around(checker: CollisionChecker, start: Array, goal: Array) -> Array | None:
    """The path of a plan in time."""
    try:
        return planners.plan(checker, start, goal, start_time=0.0).knots
    except PlanningError:
        return None


def at(x: float, y: float, z: float) -> Array:
    """The pose of something that is not turned."""
    T = np.eye(4)
    T[:3, 3] = x, y, z
    return T


def main() -> None:
    """Print one line for each robot."""
    count, arm = int(sys.argv[1]) if len(sys.argv) > 1 else PROBLEMS, panda().robot
    facing = np.diag([-1.0, -1.0, 1.0, 1.0])
    facing[0, 3] = APART
    both = Robot.join({"left": arm, "right": arm}, {"right": facing})
    warnings.filterwarnings("ignore", message=".*baxter_manipulation.srdf: left out")
    baxter = example("baxter_description/urdf/baxter.urdf", "baxter_description/srdf/baxter_manipulation.srdf").robot
    arms = [f"{side}_{joint}" for side in ("left", "right") for joint in ("s0", "s1", "e0", "e1", "w0", "w1", "w2")]
    with threads_set_to(1):
        in_time(f"a Panda among {BODIES} moving boxes", arm, np.array([0.0]), count)
        in_time(f"two Pandas among {BODIES} moving boxes", both, np.array([0.0, APART]), count)
        timed("times for a Panda's paths among them", problems(arm, np.array([0.0]), count))
        timed("times for a Panda's paths across a belt", belts(arm, count))
        still("two Pandas, nothing moves", both, list(both.joint_names), count)
        still("Baxter's two arms, nothing moves", baxter, arms, count)


if __name__ == "__main__":
    main()
