"""An operator steers an arm by the velocities of its joints, and a person walks in: a gate decides what is executed.

python examples/teleoperation.py [--ticks 400] [--view]

Operator and person are simulated. At each tick, 50 times a second, the operator's command becomes one target, and the
gate lets it through if the motion to it and the brake from it are proven free, wherever the person goes at up to
1.6 m/s. Otherwise the brake that was proven last is executed, and the operator gets the arm back when it stands. The
person is seen five times a second, with an error of 2 cm. The claim ends at standstill: then somebody may still walk
into the arm.
"""

import argparse
import time
from collections import Counter

import numpy as np

import loewner
from loewner import Body, planners, viewer
from loewner.planners import GateState
from robot_meshes import panda_robot

DT = 0.02  # s
SIGHT = 10  # ticks between two views of the person
SPEED, SEEN_WITHIN = 1.6, 0.02  # bounds on the person: m/s (ISO 13855), m
BRAKE = 5.0  # rad/s²: what all drives can do
JERKY = 2.0  # rad/s²: how fast commands change
JOINT_ERROR, VELOCITY_ERROR = 1e-3, 1e-2  # rad, rad/s: how far the robot is from its commands


def main() -> None:
    """Steer with the gate and without it, and print what happened."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--ticks", type=int, default=400, help="length of the simulation, 50 ticks a second (400)")
    parser.add_argument("--view", action="store_true", help="show the arm behind its gate in the browser")
    options = parser.parse_args()
    for gated in (False, True):
        cell = Cell(options.view and gated)
        counts = cell.run(options.ticks, gated)
        print("with the gate:" if gated else "without a gate:")
        print(f"  in motion at {counts['moving']} of {options.ticks} ticks, in contact at {counts['hit']} of these")
        if gated:
            print(f"  {counts['GO']} targets let through, {counts['brakes']} brakes, {counts['unproven']} not proven")
            print(f"  {counts['refused']} targets refused at standstill; the longest brake takes {cell.longest:.2f} s")
            for reason, names in sorted(cell.reasons):
                print(f"  braked for: {reason}, {' and '.join(names)}")


class Cell:
    """An arm at a table, with a post, and a person of whom only bounds are known.

    Attributes
    ----------
    checker, truth : CollisionChecker
        What the gate knows, and where everything is.
    """

    def __init__(self, view: bool) -> None:
        robot, known = panda_robot(), loewner.Scene(margin=0.01)
        known.add("table", Body.box([1.6, 1.6, 0.02]), at(0.0, 0.0, -0.02))
        known.allow("table", "panda_link0")
        known.add("post", Body.box([0.1, 0.1, 0.8]), at(0.35, 0.55, 0.4))
        known.add("person", Body.capsule(0.25, 1.3), at(*person(0.0)))
        truth = known.copy()
        truth.set_margin(0.0)
        self.checker, self.truth = loewner.CollisionChecker(robot, known), loewner.CollisionChecker(robot, truth)
        self.gate = planners.Gate(
            self.checker, acceleration=BRAKE, joint_error=JOINT_ERROR, velocity_error=VELOCITY_ERROR
        )
        self.page = viewer.show_robot(self.truth) if view else None
        self.longest = 0.0
        self.reasons = set[tuple[str, tuple[str, ...]]]()
        if self.page is not None:
            print(self.page.url)

    def run(self, ticks: int, gated: bool) -> Counter[str]:
        """Steer for some ticks; without the gate, all commands are executed."""
        robot, counts = self.checker.robot, Counter[str]()
        q, dq, brake, since = robot.configuration("default"), np.zeros(robot.dof), None, 0.0
        for k in range(ticks):
            t = k * DT
            if k % SIGHT == 0:
                self.checker.scene.follow(
                    "person", [t], at(*person(t))[None], speed=SPEED, since=t, error=(SEEN_WITHIN, 0.0)
                )
            wanted, reached = self.command(t, q, dq), None
            if brake is None and not gated:
                reached = wanted
            elif brake is None:
                answer = self.gate.check(q, dq, wanted[None], DT, time=t)
                if answer.state == GateState.GO:
                    counts["GO"] += 1
                    reached = wanted
                elif np.any(dq):
                    counts["brakes"] += 1
                    counts["unproven"] += not answer.is_proven
                    brake, since = answer.brake, t
                    self.longest = max(self.longest, brake.duration)
                    self.reasons.add((answer.reason, answer.names))
                else:
                    counts["refused"] += 1
            if brake is not None:
                after = min(t + DT - since, brake.duration)
                reached, dq = brake.positions(after), brake.velocities(after)
                if after == brake.duration:
                    brake, dq = None, np.zeros(robot.dof)
            elif reached is not None:
                dq = (reached - q) / DT
            if reached is not None and np.any(reached != q):
                counts["moving"] += 1
                counts["hit"] += self.meets(q, reached, t)
                q = reached
            else:
                dq = np.zeros(robot.dof)
            self.show(q, t)
        return counts

    def command(self, t: float, q: np.ndarray, dq: np.ndarray) -> np.ndarray:
        """The operator's next target: sweeps of the base and the shoulder, with changes that the drives can follow."""
        stick = np.zeros(len(q))
        stick[:4] = 0.9 * np.sin(0.9 * t), 0.4 * np.sin(0.7 * t), 0.0, 0.3 * np.sin(0.5 * t)
        rate = dq + np.clip(stick - dq, -JERKY * DT, JERKY * DT)
        robot = self.checker.robot
        return np.asarray(np.clip(q + DT * rate, robot.lower, robot.upper))

    def meets(self, a: np.ndarray, b: np.ndarray, t: float) -> bool:
        """Whether the arm touches anything on its way, at four moments."""
        for share in (0.25, 0.5, 0.75, 1.0):
            self.truth.scene.move("person", at(*person(t + share * DT)))
            if self.truth.collide(a + share * (b - a)):
                return True
        return False

    def show(self, q: np.ndarray, t: float) -> None:
        """Show the arm and the person in the viewer, if it is open."""
        if self.page is not None:
            self.page.move("person", at(*person(t + DT)))
            self.page.q = q
            time.sleep(DT)


def person(t: float) -> tuple[float, float, float]:
    """The middle of a person who walks in at 1.2 m/s, waits beside the table for two seconds, and leaves."""
    way = 1.2 * np.clip(t - 1.0, 0.0, 1.0) - 1.2 * np.clip(t - 4.0, 0.0, 1.0)
    return 1.9 - way, 0.1, 0.9


def at(x: float, y: float, z: float) -> np.ndarray:
    """A place without a turn."""
    T = np.eye(4)
    T[:3, 3] = x, y, z
    return T


if __name__ == "__main__":
    main()
