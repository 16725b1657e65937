"""Parts pass an arm on a conveyor: when may it reach down, and when does it touch them?

python examples/conveyor.py [--out PICTURE.png]

The arm plans its motion in the scene without the parts. Then the trajectory is proven against the moving parts, for
one start after another, at every instant. For a start at which the arm would touch a part, it plans among the parts.
"""

import argparse
from dataclasses import replace

import numpy as np

import loewner
from loewner import Body, Verdict, planners, plots
from robot_meshes import panda_robot

HAND = "panda_hand"
SPEED, GAP, PARTS = 0.25, 0.9, 4  # of the belt [m/s], from part to part [m]


def main() -> None:
    """Plan, prove at several starts, and draw the contacts of a start at which the arm touches a part."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", help="draw the contacts of one start along time (.png or .svg)")
    options = parser.parse_args()

    robot, scene = panda_robot(), loewner.Scene(margin=0.005)
    scene.add("belt", Body.box([0.4, 3.0, 0.1]), at(0.55, 0.0, 0.0))
    home = robot.configuration("default")
    T = robot.forward_kinematics(home)[robot.link_names.index(HAND)]
    T[:3, 3] = 0.55, 0.0, 0.25
    low = robot.reach(HAND, T, start=home).configuration
    path = planners.plan(loewner.CollisionChecker(robot, scene), home, low)
    moved = planners.trajectory(robot, np.concatenate([path, path[-2::-1]]))  # down, and back

    for k in range(PARTS):
        scene.add(f"part {k}", Body.box([0.12, 0.12, 0.12]))
        first = -2.0 - k * GAP
        way = PARTS * GAP + 4.0
        scene.follow(f"part {k}", [0.0, way / SPEED], [at(0.55, first, 0.11), at(0.55, first + way, 0.11)])
    checker = loewner.CollisionChecker(robot, scene)

    starts = np.arange(0.0, way / SPEED, 1.0)
    found = [checker.certify_trajectory(moved, t0=t0) for t0 in starts]
    print(f"a motion of {moved.duration:.1f} s, {PARTS} parts at {SPEED} m/s, {len(starts)} starts")
    free = [f"{t0:g}" for t0, one in zip(starts, found, strict=True) if is_free(one)]
    print(f"proven free if started at {', '.join(free)} s")
    for t0, one in zip(starts, found, strict=True):
        if not is_free(one):
            contact = checker.first_contact(moved, t0=t0)
            print(
                f"started at {t0:g} s: {' and '.join(contact.names)} touch at {contact.touching_at:.6f} s, "
                f"free until {contact.free_until:.6f} s"
            )
            among = planners.plan_in_time(checker, home, low, t0)
            verdict = checker.certify_trajectory(among).verdict
            print(f"planned among the parts from {t0:g} s on: {among}, {verdict.name}")
            break
    if options.out:
        plots.save(plots.trajectory(checker, replace(moved, start_time=t0)), options.out)
        print(f"wrote {options.out}")


def is_free(found: loewner.CertifiedTrajectory) -> bool:
    """Whether a trajectory is proven free."""
    return found.verdict == Verdict.FREE


def at(x: float, y: float, z: float) -> np.ndarray:
    """A pose that is not turned."""
    T = np.eye(4)
    T[:3, 3] = x, y, z
    return T


if __name__ == "__main__":
    main()
