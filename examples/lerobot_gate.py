"""A gate as a processor step of LeRobot: chunks of actions become as much of them as can be stopped, and a brake.

python examples/lerobot_gate.py [--chunks 12]

LeRobot is not imported: `ProcessorStep` below is a stub of its interface, with the methods that are used here, and
actions are NumPy arrays. Against LeRobot itself, derive `GateStep` from its `lerobot.processor.ProcessorStep`, convert
tensors at both ends, and put the step behind the one that undoes the normalisation of the policy.

LeRobot's robots give no velocities. The step takes those that were commanded, and `velocity_error` has to cover what
the drives make of them.
"""

import argparse
from typing import Any, NamedTuple

import numpy as np

from loewner import Body, CollisionChecker, Joint, Robot, Scene, Verdict, planners
from loewner.planners import GateState

DT = 1 / 30  # s
BRAKE = 4.0  # rad/s²
TRACKING, VELOCITY_ERROR = 2e-3, 0.05  # rad, rad/s


class ProcessorStep:
    """A stub of LeRobot's class of this name: from a transition to a transition."""

    def __call__(self, transition: dict[str, Any]) -> dict[str, Any]:
        """Return the transition for the next step."""
        raise NotImplementedError

    def transform_features(self, features: dict[str, Any]) -> dict[str, Any]:
        """Return the features of the transitions that the step returns."""
        return features

    def reset(self) -> None:
        """Forget the episode."""


class Unit(NamedTuple):
    """How a joint's value for LeRobot becomes radians or metres: sign * scale * value + offset."""

    sign: int
    scale: float
    offset: float


class GateStep(ProcessorStep):
    """Cut chunks of actions where they are not proven free with a brake, and append this brake.

    Parameters
    ----------
    checker : CollisionChecker
    map : dict of str to Unit
        For each joint of the robot. It is required, since LeRobot's values are degrees or normalised, per robot and per
        joint, and a wrong sign or offset makes every proof worthless: compare poses of the real arm with the model.
    dt : float
        Seconds between two actions.
    acceleration : float
        Rad/s² of the brakes, which the drives can follow.
    tracking, velocity_error : float
        Rad and rad/s by which the arm departs from its commands.

    Attributes
    ----------
    answer : GateAnswer or None
        The answer about the last chunk.
    """

    def __init__(
        self, checker: CollisionChecker, map: dict[str, Unit], dt: float, *, acceleration: float,
        tracking: float, velocity_error: float,
    ) -> None:  # fmt: skip
        names = checker.robot.configuration_names
        if set(map) != set(names):
            raise ValueError(f"map: expected the joints {', '.join(names)}, found {', '.join(map)}")
        if any(unit.sign not in (-1, 1) or not unit.scale > 0.0 for unit in map.values()):
            raise ValueError("map: expected signs of -1 or 1, and scales above zero")
        self._scales = np.array([map[name].sign * map[name].scale for name in names])
        self._offsets = np.array([map[name].offset for name in names])
        self._dt = dt
        # The robot goes to the first action from its last command, which is off the measured state by this error, too.
        # A brake that is sampled every dt and joined by lines is off by at most a dt² / 8.
        self._gate = planners.Gate(
            checker, acceleration=acceleration, joint_error=2 * tracking + acceleration * dt**2 / 8,
            velocity_error=velocity_error,
        )  # fmt: skip
        self.answer: planners.GateAnswer | None = None
        self.reset()

    def reset(self) -> None:
        """Begin an episode with an arm that rests."""
        self._rate = np.zeros(len(self._scales))

    def __call__(self, transition: dict[str, Any]) -> dict[str, Any]:
        """Return a transition whose action, of at least as many rows as before, may be executed.

        It is executed as a whole before the next chunk is given, as by a policy with `n_action_steps` of all rows. If
        no chunk arrives after one that ends in motion, execute `answer.brake`.
        """
        q = self.to_radians(transition["observation"]["observation.state"])
        wanted = self.to_radians(transition["action"])
        self.answer = answer = self._gate.check(q, self._rate, wanted, self._dt)
        brake = np.empty((0, len(q)))
        if answer.state != GateState.GO:
            ends = self._dt * np.arange(1, int(np.ceil(answer.brake.duration / self._dt)) + 1)
            brake = answer.brake.positions(np.minimum(ends, answer.brake.duration))
        allowed = np.vstack([q, wanted[: answer.steps], brake])
        rows = allowed[1:] if len(allowed) > 1 else allowed  # an arm that rests stays
        rest = np.repeat(rows[-1:], max(len(wanted) - len(rows), 0), axis=0)
        self._rate = (allowed[-1] - allowed[-2]) / self._dt if answer.state == GateState.GO else np.zeros(len(q))
        return transition | {"action": self.from_radians(np.vstack([rows, rest]))}

    def to_radians(self, values: np.ndarray) -> np.ndarray:
        """From LeRobot's values to the model's."""
        return np.asarray(np.asarray(values, dtype=float) * self._scales + self._offsets)

    def from_radians(self, q: np.ndarray) -> np.ndarray:
        """From the model's values to LeRobot's."""
        return np.asarray((q - self._offsets) / self._scales)


def main() -> None:
    """Run chunks of a policy that does not know the post, with and without the gate."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--chunks", type=int, default=12, help="chunks of 50 actions (12)")
    count = parser.parse_args().chunks
    robot, scene = arm(), Scene(margin=0.005)
    scene.add("post", Body.box([0.04, 0.04, 0.5]), at(0.22, 0.12, 0.25))
    checker = CollisionChecker(robot, scene)
    degrees = np.pi / 180
    units = {
        "shoulder_pan": Unit(-1, degrees, 0.0),  # turns the other way than the model
        "shoulder_lift": Unit(1, degrees, -np.pi / 2),  # zero is where the arm is upright
        "elbow_flex": Unit(1, robot.upper[2] / 100, 0.0),  # from -100 to 100
    }
    step = GateStep(checker, units, DT, acceleration=BRAKE, tracking=TRACKING, velocity_error=VELOCITY_ERROR)
    rng, hits = np.random.default_rng(1), {"gated": 0, "raw": 0}
    state = step.from_radians(np.array([-0.6, 0.2, 0.6]))
    for k in range(count):
        action = policy(state, rng)
        transition = step({"observation": {"observation.state": state}, "action": action})
        done = transition["action"]
        for name, chunk in (("gated", done), ("raw", action)):
            rows = step.to_radians(np.vstack([state, chunk]))
            hits[name] += bool((checker.certify_edges(rows[:-1], rows[1:]).verdict == Verdict.COLLIDING).any())
        answer = step.answer
        assert answer is not None
        why = f": {answer.reason}, {' and '.join(answer.names)}" if answer.reason else ""
        print(f"chunk {k:2}: {answer.state.name}, {answer.steps} of {len(action)} actions{why}")
        state = done[-1]
    print(f"chunks that come nearer than 5 mm: {hits['raw']} of {count} as the policy has them, {hits['gated']} gated")


def policy(state: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Fifty actions that start and end at rest, somewhere, in the units of the robot."""
    goal = np.array([rng.uniform(-50, 50), rng.uniform(60, 110), rng.uniform(10, 40)])
    share = np.linspace(0.0, 1.0, 51)[1:, None]
    return np.asarray(state + (3 * share**2 - 2 * share**3) * (goal - state))


def arm() -> Robot:
    """A small arm of three joints."""
    lying = np.eye(4)
    lying[:3, :3], lying[:3, 3] = [[0, 0, 1], [0, 1, 0], [-1, 0, 0]], [0.075, 0, 0]  # along x
    links = {"base": None, "shoulder": None, "upper": [(Body.capsule(0.02, 0.15), lying)]}
    links["lower"] = [(Body.capsule(0.015, 0.15), lying)]
    limits: dict[str, Any] = {"velocity": 3.0, "lower": -1.9, "upper": 1.9}
    joints = [
        Joint("shoulder_pan", "revolute", "base", "shoulder", T_parent_joint=at(0, 0, 0.1), axis=(0, 0, 1), **limits),
        Joint("shoulder_lift", "revolute", "shoulder", "upper", axis=(0, 1, 0), **limits),
        Joint("elbow_flex", "revolute", "upper", "lower", T_parent_joint=at(0.17, 0, 0), axis=(0, 1, 0), **limits),
    ]
    return Robot.from_links(links, joints)


def at(x: float, y: float, z: float) -> np.ndarray:
    """A place without a turn."""
    T = np.eye(4)
    T[:3, 3] = x, y, z
    return T


if __name__ == "__main__":
    main()
