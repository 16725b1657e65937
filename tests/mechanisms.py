"""Mechanisms whose ranges without contact have closed forms, and random trees of joints."""

import math

import numpy as np

import loewner


def link(name, *shapes):
    """A link with shapes, each an element of URDF and the place of its origin."""
    parts = "".join(
        f'<collision><origin xyz="{x!r} {y!r} {z!r}"/><geometry>{shape}</geometry></collision>'
        for shape, (x, y, z) in shapes
    )
    return f'<link name="{name}">{parts}</link>'


def ball(radius, place=(0.0, 0.0, 0.0)):
    return f'<sphere radius="{radius!r}"/>', place


def box(size, place=(0.0, 0.0, 0.0)):
    return f'<box size="{size[0]!r} {size[1]!r} {size[2]!r}"/>', place


def joint(name, kind, parent, child, place=(0.0, 0.0, 0.0), axis=(0, 0, 1), limits=None, mimic=None):
    more = "" if limits is None else f'<limit lower="{limits[0]!r}" upper="{limits[1]!r}" effort="1" velocity="1"/>'
    if mimic is not None:
        more += f'<mimic joint="{mimic[0]}" multiplier="{mimic[1]!r}" offset="{mimic[2]!r}"/>'
    x, y, z = place
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{x!r} {y!r} {z!r}"/><axis xyz="{axis[0]} {axis[1]} {axis[2]}"/>{more}</joint>'
    )


def robot(*parts, name="mechanism", **options):
    return loewner.Robot.from_urdf(text=f'<robot name="{name}">{"".join(parts)}</robot>', **options)


# Radius of the balls, and their distance from the axis.
BALL, ARM = 0.1, 0.5


def hinge(kind="revolute", limits=(-3.1, 3.1), gap=0.0):
    """A ball at rest at (ARM, 0), and one on a hinge at the origin that begins opposite; `gap` lifts the first one.

    Without a gap they touch where the angle is π - 2 asin(BALL / ARM).
    """
    return robot(
        link("frame", ball(BALL, (ARM, 0.0, gap))), link("crank", ball(BALL, (-ARM, 0.0, 0.0))),
        joint("hinge", kind, "frame", "crank", limits=limits),
    )  # fmt: skip


HINGE_TOUCHES = math.pi - 2 * math.asin(BALL / ARM)


def rack_and_pinion():
    """A rack that slides by 0.05 m for each radian of the pinion; its ball touches the frame's after 10 rad."""
    return robot(
        link("frame", ball(BALL, (0.7, 0.0, 0.0))), link("pinion"), link("rack", ball(BALL)),
        joint("pinion", "revolute", "frame", "pinion", limits=(-3.0, 12.0)),
        joint("rack", "prismatic", "frame", "rack", axis=(1, 0, 0), limits=(-5.0, 5.0), mimic=("pinion", 0.05, 0.0)),
    )  # fmt: skip


def gears(ratio, offset):
    """Two gears with one tooth each, a ball, at a distance at which the teeth meet between the axes."""
    return robot(
        link("frame"), link("first", ball(BALL, (ARM, 0.0, 0.0))), link("second", ball(BALL, (-ARM, 0.0, 0.0))),
        joint("first", "continuous", "frame", "first"),
        joint("second", "continuous", "frame", "second", place=(2 * ARM, 0.0, 0.0), mimic=("first", ratio, offset)),
    )  # fmt: skip


def parallelogram(length=0.5, away=0.25, radius=0.05):
    """A coupler that does not turn: its ball moves on a circle of this length about a point that is `away`.

    A ball of the frame is at the origin; the least distance of the centers is abs(length - away).
    """
    return robot(
        link("frame", ball(radius)), link("crank"), link("coupler", ball(radius)),
        joint("crank", "revolute", "frame", "crank", place=(away, 0.0, 0.0), limits=(-3.1, 3.1)),
        joint(
            "coupler", "revolute", "crank", "coupler", place=(-length, 0.0, 0.0), limits=(-4.0, 4.0),
            mimic=("crank", -1.0, 0.0),
        ),
    )  # fmt: skip


def random_tree(seed):
    """A random robot: joints of all kinds with one value, joints that follow others, bodies with several shapes."""
    rng = np.random.default_rng(seed)
    count, parts, driven = int(rng.integers(3, 7)), [], []

    def place(scale):
        return tuple(float(x) for x in scale * rng.normal(size=3))

    for k in range(count):
        size = float(10 ** rng.uniform(-1.5, -0.3))
        shapes = [
            box((size, size * float(rng.uniform(0.2, 1)), size * float(rng.uniform(0.2, 2))), place(0.7 * size)),
            ball(size / 2, place(0.7 * size)),
            (f'<cylinder radius="{size / 3!r}" length="{size * float(rng.uniform(0.5, 3))!r}"/>', place(0.7 * size)),
            box((0.1 * size, 2 * size, 0.3 * size), place(0.7 * size)),
        ]
        chosen = [shapes[int(rng.integers(4))]] + ([ball(size / 4, place(size))] if rng.random() < 0.3 else [])
        parts.append(link(f"link{k}", *chosen))
    for k in range(1, count):
        kind = str(rng.choice(["revolute", "revolute", "revolute", "continuous", "prismatic", "fixed"]))
        axis = rng.normal(size=3)
        axis = tuple(float(x) for x in axis / np.linalg.norm(axis))
        far = {"revolute": 3.0, "prismatic": 0.5}.get(kind)
        mimic = None
        if driven and kind != "fixed" and rng.random() < 0.3:
            factor = float(rng.choice([1.0, -1.0, 2.0, -0.5, 1.5, 0.333]))
            mimic = str(rng.choice(driven)), factor, float(rng.uniform(-1, 1)) if rng.random() < 0.5 else 0.0
        elif kind != "fixed":
            driven.append(f"joint{k}")
        # Limits of a joint that follows another one must leave that one its range.
        ends = (-8.0, 8.0) if mimic is not None else sorted(float(x) for x in rng.uniform(-1, 1, 2) * (far or 0.0))
        limits = None if far is None else tuple(ends)
        parent = f"link{int(rng.integers(max(0, k - 3), k))}"
        parts.append(joint(f"joint{k}", kind, parent, f"link{k}", place(0.4), axis, limits, mimic))
    return robot(*parts, name=f"tree{seed}")
