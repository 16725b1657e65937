"""A trajectory of another program is checked at every instant, as a controller executes it, before a robot moves.

python examples/audit_trajectory.py [FILE] [--out PICTURE.svg]

FILE contains points for the Panda: a message trajectory_msgs/JointTrajectory in JSON or YAML, or a table in CSV.
Without FILE, the example writes a message itself: points of a smooth curve through the corners of a free path.
"""

import argparse
import json
from pathlib import Path

import numpy as np
from scipy.interpolate import CubicSpline

import loewner
from loewner import Body, Verdict, planners, plots, verify
from robot_meshes import panda_robot

# Sizes and centers of boxes around the arm [m].
BODIES = {
    "board": ([0.3, 0.8, 0.02], [0.65, 0.0, 0.5]),
    "table": ([0.8, 1.2, 0.04], [0.6, 0.0, -0.03]),
    "post": ([0.08, 0.08, 0.8], [0.35, -0.45, 0.4]),
}

# By how much a controller may miss each value [rad or m].
ERROR = 2e-4


def main() -> None:
    """Audit the trajectory in the file, then one that is made to be proven."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("file", nargs="?", type=Path, help="points (.json, .yaml or .csv)")
    parser.add_argument("--out", help="draw the pairs that are not proven free along the time (.svg or .png)")
    options = parser.parse_args()

    robot, scene = panda_robot(), loewner.Scene()
    for name, (size, at) in BODIES.items():
        T = np.eye(4)
        T[:3, 3] = at
        scene.add(name, Body.box(size), T)
    checker = loewner.CollisionChecker(robot, scene)
    Q = robot.random_configurations(200, seed=0)
    start, goal = Q[~checker.collide(Q)][31:33]
    path = planners.plan(checker, start, goal)

    file = options.file or Path("theirs.json")
    if options.file is None:
        write_message(file, robot.configuration_names, path)
    points = planners.ControllerPoints.load(file)
    report(str(file), checker, points)
    if options.out:
        plots.trajectory(checker, points).figure.savefig(options.out)

    ours = planners.trajectory(robot, path, checker=checker)
    report("made from the same path", checker, ours)
    proof = checker.certify_trajectory(ours, joint_error=ERROR, proof=True).proof
    checked = verify.verify(proof.data)
    print(f"  its proof has {len(proof.data):,} bytes and covers {ERROR:g} rad or m around every value")
    print(f"  verified by a second program: {len(checked.motions)} pieces")


def write_message(file: Path, names: tuple[str, ...], path: np.ndarray) -> None:
    """Write points of a smooth curve through the corners of a path, one corner each second, as a ROS program may."""
    curve = CubicSpline(np.arange(len(path)), path, bc_type="clamped")
    points = [
        {
            "positions": curve(t).tolist(),
            "velocities": curve(t, 1).tolist(),
            "time_from_start": {"sec": int(t), "nanosec": int(1e9 * (t % 1))},
        }
        for t in np.arange(0.0, len(path) - 0.75, 0.25)
    ]
    file.write_text(json.dumps({"joint_names": names, "points": points}))


def report(
    title: str, checker: loewner.CollisionChecker, curve: planners.ControllerPoints | planners.Trajectory
) -> None:
    """Print the verdict on a curve, and each piece that is not proven free with its pair and its least distance."""
    found = checker.certify_trajectory(curve)
    verdicts = found.segments.verdict
    print(f"{title}: {found.verdict.name}, {(verdicts == Verdict.FREE).sum()} of {len(verdicts)} pieces proven free")
    for k in np.flatnonzero(verdicts != Verdict.FREE):
        begin, end = found.times[k : k + 2]
        print(f"  {begin:.2f} .. {end:.2f} s: {' and '.join(found.segments.names[k])}")


if __name__ == "__main__":
    main()
