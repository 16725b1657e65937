"""An arm takes a box from a moving belt: it meets the box at the belt's speed, closes its fingers, and lifts it.

python examples/belt_pick.py [--out PICTURE.png]

Three curves follow each other, and each is proven free at every instant among the bodies that move: the way to the
place above the box, which ends there at the belt's speed and in time; the way down with the box, until the fingers are
closed; and the way up, until the arm rests. Velocities and accelerations are polynomials of time, so that their largest
values are computed, not sampled. The box is on the belt and touches it. The fingers may touch the box at the end of the
second curve and not before, and the box may touch the belt at the start of the third and not afterwards.
"""

import argparse
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline, PPoly

import loewner
from loewner import Body, planners, plots
from robot_meshes import panda_robot

HAND, TIPS = "panda_hand", "panda_hand_tcp"  # the tips are a frame between the fingers
FINGERS, FINGER = ("panda_leftfinger", "panda_rightfinger"), 7
BOX, OPEN, CLOSED = 0.06, 0.04, 0.030019  # edges of the box; positions of the fingers; closed, they touch it [m]
SPEED, BELT_TOP, HIGH = 0.2, 0.1, 0.12  # of the belt [m/s]; its height, and that of the tips above the box [m]
MEET, FIRST = 3.0, -0.25  # when the arm is above the box [s], and where along the belt [m]
DOWN, CLOSE, UP, STOP = 1.0, 0.4, 0.8, 0.8  # how long the arm takes for it [s]
STEP, RUN_UP = 0.05, 0.3  # between configurations on the belt, and of the last straight motion towards it [s]
ACCELERATION = 4.0  # limit for all joints [rad/s² and m/s²]


def main() -> None:
    """Meet, take and lift the box; report proofs and limits, and draw the speed and height of the finger tips."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", help="draw speed and height of the finger tips (.png or .svg)")
    options = parser.parse_args()

    robot, scene = panda_robot(), loewner.Scene()
    scene.add("belt", Body.box([0.4, 3.0, 0.1]), at(0.55, 0.0, BELT_TOP - 0.05))
    for name, ahead in (("box", 0.0), ("next", -0.2), ("last", 0.2)):
        scene.add(name, Body.box([BOX, BOX, BOX]))
        scene.follow(name, [0.0, 10.0], [box_at(0.0) @ at(0, ahead, 0), box_at(10.0) @ at(0, ahead, 0)])
    checker = loewner.CollisionChecker(robot, scene)
    home = robot.configuration("default")
    home[FINGER] = OPEN

    # With the box, and up: the configurations on the way are joined by a cubic spline.
    carried = tracked(robot, home)
    grasp = MEET + DOWN + CLOSE
    k = int(np.searchsorted(carried.x, grasp - 1e-9))
    down, up = (PPoly(carried.c[:, part], carried.x[ends]) for part, ends in parts(k, len(carried.x)))

    # To the first of them: the last motion has its direction, and the robot arrives in time, at its velocity.
    above, velocity = carried(MEET), carried(MEET, 1).round(9)
    still = scene.copy()
    for name in scene.following:
        still.remove(name)
    path = planners.plan(loewner.CollisionChecker(robot, still), home, above - RUN_UP * velocity)
    path = np.concatenate([path, [above]])
    options_of_times = {"arrive_at": MEET, "end_velocity": velocity, "acceleration": ACCELERATION}
    meet = planners.time_path(checker, path, start_time=0.0, **options_of_times)
    print(f"meet: {meet.certify(checker).verdict.name}, {meet}")
    for finger in FINGERS:
        scene.reach("box", finger)
    touching = [f"{contact.name_a} and {contact.name_b}" for contact in checker.pairs(down(grasp), grasp)]
    print(f"down and close: {checker.certify_trajectory(down).verdict.name}, then in contact: {', '.join(touching)}")

    # The box moves with the hand from now on, and leaves the belt.
    T_hand = robot.forward_kinematics(carried(grasp))[robot.link_names.index(HAND)]
    scene.attach("box", HAND, np.linalg.inv(T_hand) @ box_at(grasp), touch_links=FINGERS, leave=["belt"])
    print(f"up: {checker.certify_trajectory(up).verdict.name}")

    speeds, pushes = np.stack([largest(curve) for curve in (down, up)]).max(axis=0)
    speeds = np.maximum(speeds, np.abs(meet.rates).max(axis=0))
    pushes = np.maximum(pushes, np.abs(np.diff(meet.rates, axis=0) / np.diff(meet.times)[:, None]).max(axis=0))
    shares = (speeds / robot.velocity).max(), (pushes / ACCELERATION).max()
    print(f"largest velocity {shares[0]:.3f}, largest acceleration {shares[1]:.3f} of the limits")
    if options.out:
        draw(robot, meet, carried, options.out)


def tracked(robot: loewner.Robot, start: np.ndarray) -> CubicSpline:
    """The arm above the box, down and up with it, and to rest, from `MEET` on."""
    times = MEET + STEP * np.arange(round((DOWN + CLOSE + UP + STOP) / STEP) + 1)
    rows, q = [], start
    for t in times:
        T = tips_at(t - MEET)
        found = robot.reach(TIPS, T, joints="arm", start=q)
        if not found.reached:
            raise SystemExit(f"no configuration within the limits was found for {T[:3, 3]}")
        q = found.configuration.copy()
        q[FINGER] = OPEN + (CLOSED - OPEN) * smooth((t - MEET - DOWN) / CLOSE)
        rows.append(q)
    return CubicSpline(times, rows, bc_type=("not-a-knot", "clamped"))


def tips_at(t: float) -> np.ndarray:
    """Where the finger tips are to be, in seconds after `MEET`: above the box, down, up, and slower to a stop."""
    T: np.ndarray = box_at(MEET)
    slowing = min(max(t - DOWN - CLOSE - UP, 0.0), STOP)
    T[1, 3] += SPEED * (t - slowing**2 * (1 - slowing / STOP / 3) / STOP)
    T[2, 3] += HIGH * (1 - smooth(t / DOWN) + smooth((t - DOWN - CLOSE) / UP))
    T[:3, :3] = np.diag([1.0, -1.0, -1.0])  # from above
    return T


def smooth(x: float) -> float:
    """From 0 to 1, with neither velocity nor acceleration at both ends."""
    x = min(max(x, 0.0), 1.0)
    return x**3 * (10 - 15 * x + 6 * x**2)


def box_at(t: float) -> np.ndarray:
    """Where the box is on the belt."""
    return at(0.55, FIRST + SPEED * (t - MEET), BELT_TOP + BOX / 2)


def at(x: float, y: float, z: float) -> np.ndarray:
    """A pose that is not turned."""
    T = np.eye(4)
    T[:3, 3] = x, y, z
    return T


def parts(k: int, count: int) -> tuple[tuple[slice, slice], tuple[slice, slice]]:
    """The pieces and the times of a spline before and after one of its times."""
    return (slice(0, k), slice(0, k + 1)), (slice(k, count - 1), slice(k, count))


def largest(curve: PPoly) -> np.ndarray:
    """The largest velocities and accelerations of cubic pieces, at their ends or where the acceleration is 0."""
    push = curve.derivative(2)
    speeds = np.abs(curve.derivative()(curve.x))
    with np.errstate(divide="ignore", invalid="ignore"):
        turns = -push.c[1] / push.c[0]  # after the start of each piece
    inside = (turns > 0) & (turns < np.diff(curve.x)[:, None])
    three, two, one = (curve.c[k] for k in range(3))
    turning = np.where(inside, np.abs(one + turns * (2 * two + 3 * turns * three)), 0.0)
    at_start, at_end = push.c[1], push.c[1] + push.c[0] * np.diff(curve.x)[:, None]
    pushes = np.abs(np.concatenate([at_start, at_end])).max(axis=0)
    return np.stack([np.maximum(speeds.max(axis=0), turning.max(axis=0)), pushes])


def draw(robot: loewner.Robot, meet: planners.Trajectory, carried: Any, out: str) -> None:
    """Draw how fast the finger tips move along the belt, and how high they are."""
    import matplotlib.pyplot as plt

    t = np.linspace(0.0, carried.x[-1], 600)
    Q = np.where(t[:, None] <= MEET, meet.positions(np.minimum(t, MEET)), carried(np.maximum(t, MEET)))
    tips = robot.forward_kinematics(Q)[:, robot.link_names.index(TIPS), :3, 3]
    figure, (upper, lower) = plt.subplots(2, 1, sharex=True, figsize=(7, 4), layout="constrained")
    upper.plot(t, np.gradient(tips[:, 1], t), label="finger tips")
    upper.axhline(SPEED, linestyle="--", color="gray", label="belt")
    upper.set_ylabel("speed along the belt, m/s")
    upper.legend(frameon=False)
    lower.plot(t, tips[:, 2])
    lower.axhspan(BELT_TOP, BELT_TOP + BOX, color="tab:orange", alpha=0.3)
    lower.set(ylabel="height, m", xlabel="time, s")
    for axes in (upper, lower):
        for time in (MEET, MEET + DOWN, MEET + DOWN + CLOSE):
            axes.axvline(time, linewidth=0.5, color="gray")
    plots.save(figure, out)
    print(f"wrote {out}")


if __name__ == "__main__":
    main()
