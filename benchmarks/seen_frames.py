"""Ray-cast frames of robots in random worlds: points of the robot that stay, points lost, plans into unseen cells.

    python benchmarks/seen_frames.py [--frames 10000] [--plans 1000] [--after 1 3] [--seed 0]

Ten frames of each world, of 64 x 48 pixels, are cast by formulas of boxes, balls, capsules, cylinders and triangles,
which share nothing with the library; nor do the distances, the cells that rays have passed, and the poses of the robots
made here. Every fourth robot is a Panda or a UR5, whose poses and triangles are the library's. Frames have noise or
none, single or double precision, and pixels without an echo. Counted are

- points of the robot, or of what it carries, that `off_the_robot` keeps;
- points of obstacles that it removes although they are farther than `clear` from the robot;
- plans, proven by `planners.plan`, at which a point of the robot is in a cell that no ray has passed, and that is not
  at the start.

Cells are wider than the spacing of the pixels, so that at least one ray passes each cell in an image.
"""

from __future__ import annotations

import argparse
import os
import time
from dataclasses import dataclass
from itertools import combinations
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

import loewner
from camera import looking
from loewner import Body, CollisionChecker, Joint, Robot, Scene, planners
from loewner.depth import SeenSpace, points_of
from robot_samples import example, panda
from samples import Array

WIDTH, HEIGHT, FRAMES = 64, 48, 10
CELL, CELLS, LOW = 0.1, 26, np.array([-1.3, -1.3, -1.0])  # metres, and the lowest corner of the grid
VOXEL, MARGIN = 0.02, 0.005
SURE = 1e-9  # metres that the formulas of this file may be off


@dataclass(frozen=True)
class Shape:
    """A shape and its pose, for which this file has its own formulas.

    Attributes
    ----------
    kind : str
        "box" with half edges as its size; "ball" with a radius; "capsule" and "cylinder" with radius and half length,
        along z; "mesh" without a size.
    pose : ndarray, shape (4, 4)
        In the world, or in a link.
    triangles : ndarray, shape (n, 3, 3), optional
    """

    kind: str
    size: tuple[float, ...]
    pose: Array
    triangles: Any = None

    def at(self, T: Array) -> Shape:
        return Shape(self.kind, self.size, T @ self.pose, self.triangles)

    def local(self, points: Array) -> Array:
        return np.asarray((points - self.pose[:3, 3]) @ self.pose[:3, :3])

    def body(self) -> Body:
        """The library's body, in the frame of the shape."""
        if self.kind == "box":
            return Body.box([2.0 * h for h in self.size])
        if self.kind == "ball":
            return Body.sphere(*self.size)
        return getattr(Body, self.kind)(self.size[0], 2.0 * self.size[1])  # type: ignore[no-any-return]

    def hit(self, origin: Array, rays: Array) -> Array:
        """Where each ray enters the shape, as a multiple of it; infinite if it does not."""
        o, d = self.local(origin), rays @ self.pose[:3, :3]
        if self.kind == "box":
            return entered(*inside(np.concatenate([np.eye(3), -np.eye(3)]), np.tile(self.size, 2), o, d))
        if self.kind == "mesh":
            corners, found = self.triangles.reshape(-1, 3), np.full(len(d), np.inf)
            center = corners.mean(axis=0)
            reach = np.linalg.norm(corners - center, axis=1).max()
            near = np.linalg.norm(np.cross(d, center - o), axis=1) <= reach * np.linalg.norm(d, axis=1)
            found[near] = first_triangle(self.triangles, o, d[near])
            return found
        radius = self.size[0]
        if self.kind == "ball":
            return entered(*round_(o, d, radius))
        half = self.size[1]
        sides = round_(o * [1, 1, 0], d * [1, 1, 0], radius)
        ends = inside(np.array([[0.0, 0, 1], [0, 0, -1]]), np.array([half, half]), o, d)
        middle = entered(np.maximum(sides[0], ends[0]), np.minimum(sides[1], ends[1]))
        if self.kind == "cylinder":
            return middle
        caps = [entered(*round_(o - [0, 0, z], d, radius)) for z in (-half, half)]
        return np.minimum.reduce([middle, *caps])

    def distance(self, points: Array) -> Array:
        """Distances of points, 0 inside; of meshes, those from the surface."""
        p = np.abs(self.local(points))
        if self.kind == "box":
            return np.asarray(np.linalg.norm(np.maximum(p - self.size, 0.0), axis=1))
        if self.kind == "mesh":
            return np.array([np.sqrt(nearest(self.triangles, one)) for one in self.local(points)])
        if self.kind == "ball":
            return np.maximum(np.linalg.norm(p, axis=1) - self.size[0], 0.0)
        radius, half = self.size
        out, along = np.hypot(p[:, 0], p[:, 1]), np.maximum(p[:, 2] - half, 0.0)
        if self.kind == "capsule":
            return np.maximum(np.hypot(out, along) - radius, 0.0)
        return np.hypot(np.maximum(out - radius, 0.0), along)

    def samples(self, rng: np.random.Generator, count: int) -> Array:
        """Random points of the shape in its frame; corners are among them."""
        if self.kind == "box":
            signs = np.array(np.meshgrid(*[[-1.0, 1.0]] * 3)).reshape(3, -1).T
            return np.concatenate([signs, rng.uniform(-1, 1, (count, 3))]) * self.size
        if self.kind == "mesh":
            some = self.triangles[rng.integers(len(self.triangles), size=count)]
            on = np.einsum("nk,nkj->nj", rng.dirichlet(np.ones(3), count), some)
            return np.concatenate([np.unique(self.triangles.reshape(-1, 3), axis=0), on])
        d = rng.normal(size=(count, 3))
        flat = np.array([1.0, 1.0, 0.0 if self.kind == "cylinder" else 1.0])
        points = (
            d * flat / np.linalg.norm(d * flat, axis=1)[:, None] * (self.size[0] * rng.uniform(0, 1, (count, 1)) ** 0.3)
        )
        if self.kind != "ball":
            points[:, 2] += rng.uniform(-self.size[1], self.size[1], count)
        return np.asarray(points)


def inside(normals: Array, offsets: Array, origin: Array, rays: Array) -> tuple[Array, Array]:
    """The multiples of rays at which they enter and leave half-spaces."""
    slopes, room = rays @ normals.T, offsets - normals @ origin
    with np.errstate(divide="ignore", invalid="ignore"):
        t = room / slopes
    enter = np.where(slopes < 0, t, np.where((slopes == 0) & (room < 0), np.inf, -np.inf)).max(axis=1)
    return enter, np.where(slopes > 0, t, np.inf).min(axis=1)


def round_(origin: Array, rays: Array, radius: float) -> tuple[Array, Array]:
    """The multiples of rays at which they enter and leave a ball, or a cylinder if nothing is along its axis."""
    a, b, c = np.square(rays).sum(axis=1), rays @ origin, origin @ origin - radius * radius
    with np.errstate(invalid="ignore", divide="ignore"):
        root = np.sqrt(b * b - a * c)
        low, high = (-b - root) / a, (-b + root) / a
    return np.where(np.isnan(low), np.inf, low), np.where(np.isnan(high), -np.inf, high)


def entered(enter: Array, leave: Array) -> Array:
    return np.where((enter < leave) & (enter > 0.0), enter, np.inf)


def first_triangle(triangles: Array, origin: Array, rays: Array) -> Array:
    """The multiples of rays at which they first meet a triangle, by Cramer's rule."""
    a, ab, ac = triangles[:, 0], triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    normal, out = np.cross(ab, ac), origin - a
    with np.errstate(divide="ignore", invalid="ignore"):
        scale = -1.0 / (rays @ normal.T)
        v = (rays @ np.cross(ac, out).T) * scale
        w = (rays @ np.cross(out, ab).T) * scale
        t = (out * normal).sum(axis=1) * scale
        hit = (v >= 0.0) & (w >= 0.0) & (v + w <= 1.0) & (t > 0.0)
    return np.asarray(np.where(hit, t, np.inf).min(axis=1, initial=np.inf))


def nearest(triangles: Array, point: Array) -> float:
    """The squared distance of a point from triangles: from their planes where it is above them, else from edges."""
    a, b, c = triangles.transpose(1, 0, 2)
    normal = np.cross(b - a, c - a)
    square = np.maximum(np.square(normal).sum(axis=1), 1e-300)
    within, least = np.ones(len(a), bool), np.inf
    for p, q in ((a, b), (b, c), (c, a)):
        along, out = q - p, point - p
        within &= (np.cross(along, out) * normal).sum(axis=1) >= 0.0
        share = np.clip((out * along).sum(axis=1) / np.maximum(np.square(along).sum(axis=1), 1e-300), 0.0, 1.0)
        least = min(least, float(np.square(out - share[:, None] * along).sum(axis=1).min()))
    above = np.square(((point - a) * normal).sum(axis=1)) / square
    return min(least, float(np.where(within, above, np.inf).min()))


# -- robots and worlds --------------------------------------------------------------------------


class Arm:
    """A robot and its shapes in each configuration.

    Attributes
    ----------
    robot : Robot
    shapes : list of (int, Shape)
        The link and the shape in the link.
    """

    def __init__(self, robot: Robot, shapes: list[tuple[int, Shape]], chain: list[tuple[Array, Array]] | None) -> None:
        self.robot, self.shapes, self.chain = robot, shapes, chain

    @classmethod
    def random(cls, rng: np.random.Generator) -> Arm:
        """A chain of links along x, of random shapes and axes, that is at most 1 m long."""
        count = int(rng.integers(3, 6))
        lengths = rng.uniform(0.6, 0.95) * rng.dirichlet(np.full(count, 6.0))
        lengths[0] = 0.0
        along_z = placed([0.0, 0.0, 0.0])
        along_z[:3, :3] = [[0, 0, 1], [1, 0, 0], [0, 1, 0]]  # z of the shape becomes x of the link
        links, joints, shapes, chain = {}, [], [], []
        for k in range(count):
            size = rng.uniform(0.04, 0.08)
            half = max(lengths[k] / 2.0 - size, 0.02)
            kind = ["box", "capsule", "cylinder", "ball"][rng.integers(4)] if k else "box"
            sizes = {"box": (size, size, half + size), "ball": (size,)}.get(kind, (size, half))
            shape = Shape(kind, sizes, placed([lengths[k] / 2.0, 0.0, 0.0]) @ along_z)
            links[f"link {k}"] = [(shape.body(), shape.pose)]
            shapes.append((k, shape))
            if k:
                out, axis = placed([lengths[k - 1], 0.0, 0.0]), np.eye(3)[rng.integers(1, 3)]
                joints.append(Joint(f"j{k}", "revolute", f"link {k - 1}", f"link {k}", out, None, axis, -2.5, 2.5))
                chain.append((out, axis))
        robot = Robot.from_links(links, joints, disabled=combinations(links, 2))
        return cls(robot, shapes, chain)

    @classmethod
    def known(cls, robot: Robot) -> Arm:
        """A robot of a file, with the triangles of its links."""
        names = robot.link_names
        meshes = [(names.index(name), np.asarray(body.to_trimesh().triangles)) for name, body in robot.bodies.items()]
        return cls(robot, [(link, Shape("mesh", (), np.eye(4), triangles)) for link, triangles in meshes], None)

    def poses(self, q: Array) -> Array:
        if self.chain is None:
            return self.robot.forward_kinematics(q)
        T = [np.eye(4)]
        for (out, axis), angle in zip(self.chain, q, strict=True):
            x, y, z = axis
            K = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
            turn = np.eye(4)
            turn[:3, :3] += np.sin(angle) * K + (1 - np.cos(angle)) * K @ K
            T.append(T[-1] @ out @ turn)
        return np.stack(T)

    def at(self, q: Array) -> list[Shape]:
        poses = self.poses(q)
        return [shape.at(poses[link]) for link, shape in self.shapes]


def placed(position: Any) -> Array:
    T = np.eye(4)
    T[:3, 3] = position
    return T


def obstacles(rng: np.random.Generator, near: list[Array]) -> list[Shape]:
    """Boxes, balls, capsules and cylinders, turned at random, around the robot, and small ones near given points."""
    made = []
    for k in range(len(near) + rng.integers(2, 7)):
        angle, out, height = rng.uniform(-np.pi, np.pi), rng.uniform(0.4, 1.2), rng.uniform(-0.6, 1.0)
        T = placed([out * np.cos(angle), out * np.sin(angle), height] if k >= len(near) else near[k])
        T[:3, :3] = np.linalg.qr(rng.normal(size=(3, 3)))[0]
        T[:3, 0] *= np.linalg.det(T[:3, :3])
        kind = ["box", "ball", "capsule", "cylinder"][rng.integers(4)]
        count = {"box": 3, "ball": 1}.get(kind, 2)
        made.append(Shape(kind, tuple(rng.uniform(0.02, 0.2 if k >= len(near) else 0.03, count).tolist()), T))
    return made


def cast(shapes: list[Shape], origin: Array, rays: Array) -> Array:
    return np.minimum.reduce([shape.hit(origin, rays) for shape in shapes])


def distance(shapes: list[Shape], points: Array) -> Array:
    return np.minimum.reduce([shape.distance(points) for shape in shapes])


def passed(origin: Array, rays: Array, depths: Array) -> Array:
    """The cells that rays enter and leave before their depths, shape (cells, cells, cells)."""
    planes = LOW[:, None] + CELL * np.arange(CELLS + 1)
    with np.errstate(divide="ignore"):
        t = np.concatenate([(planes[k] - origin[k]) / rays[:, k, None] for k in range(3)], axis=1)
    t.sort(axis=1)
    begins, ends = t[:, :-1], t[:, 1:]
    whole = (begins >= 0.0) & (ends <= depths[:, None]) & (ends - begins > 1e-12)
    ray, part = np.nonzero(whole)
    middles = origin + ((begins + ends)[ray, part] / 2.0)[:, None] * rays[ray]
    index = np.floor((middles - LOW) / CELL).astype(int)
    index = index[((index >= 0) & (index < CELLS)).all(axis=1)]
    found = np.zeros((CELLS,) * 3, bool)
    found[tuple(index.T)] = True
    return found


# -- frames and plans ---------------------------------------------------------------------------


@dataclass
class Counts:
    frames: int = 0
    mine: int = 0
    others: int = 0
    left: int = 0
    removed: int = 0
    lost: int = 0
    seen: int = 0
    tried: int = 0
    plans: int = 0
    visited: int = 0
    entered: int = 0
    unpassed: int = 0


class World:
    """A robot, obstacles that do not move, a grid of cells, and the cells that rays have passed."""

    def __init__(self, rng: np.random.Generator, arm: Arm) -> None:
        Q = arm.robot.random_configurations(200, seed=int(rng.integers(2**31)))
        near: list[Array] = []  # of things that stand so near to the robot that some of their points are removed
        for q in Q[:8]:
            shapes = arm.at(q)
            shape = shapes[rng.integers(1, len(shapes))]
            around = shape.pose[:3, 3] + rng.uniform(-0.25, 0.25, (30, 3))
            point = around[np.abs(distance(shapes, around) - 0.045).argmin()]
            near += [point] if np.linalg.norm(point) > 0.25 else []  # not at the base
        self.rng, self.arm, self.things = rng, arm, obstacles(rng, near)
        self.clear, self.noise = rng.uniform(0.03, 0.06), float(rng.choice([0.0, 0.002, 0.01]))
        self.passed = np.zeros((CELLS,) * 3, bool)
        self.space = SeenSpace(LOW, (CELLS,) * 3, CELL)
        root = arm.robot.link_names[arm.shapes[0][0]]
        truth, scene = Scene(), Scene(margin=MARGIN)
        for k, thing in enumerate(self.things):
            truth.add(f"thing {k}", thing.body(), thing.pose)
        for name in ("camera", "unknown"):
            scene.add(name, Body.sphere(0.01), placed([9.0, 9.0, 9.0]))
            scene.allow(name, root)  # it stands on what no camera sees
        if arm.chain is not None and rng.uniform() < 0.5:  # a tool
            tip, tool = len(arm.chain), Shape("box", (0.02, 0.03, 0.05), placed([0.08, 0.02, 0.0]))
            for one in (truth, scene):
                one.add("tool", tool.body())
                one.attach("tool", f"link {tip}", tool.pose, touch_links=arm.robot.link_names)
            self.arm = Arm(arm.robot, [*arm.shapes, (tip, tool)], arm.chain)
        self.truth, self.checker = CollisionChecker(arm.robot, truth), CollisionChecker(arm.robot, scene)
        self.Q = Q[~self.truth.collide(Q)][:FRAMES]

    def run(self, counts: Counts, frames: int, plans: int, after: list[int]) -> None:
        """Cast frames, and plan after those of the given numbers, counted from 1."""
        for k, q in enumerate(self.Q, 1):
            if k > max(after) and counts.frames >= frames:
                return
            cloud = self.see(q, counts, 0.1 * k)
            if k in after and len(cloud) and counts.plans < plans:
                self.plan(q, cloud, counts)

    def see(self, q: Array, counts: Counts, now: float) -> Array:
        """Cast a frame, count, and return the points that stay."""
        rng = self.rng
        away = rng.normal(size=3)
        eye = rng.uniform(2.0, 2.6) * away / np.linalg.norm(away)
        T = looking(eye + [0, 0, 0.3], rng.normal(0, 0.15, 3) + [0, 0, 0.3])
        fx, fy = rng.uniform(70, 90, 2)
        K = np.array([[fx, 0, WIDTH / 2 + rng.uniform(-3, 3)], [0, fy, HEIGHT / 2 + rng.uniform(-3, 3)], [0, 0, 1]])
        v, u = np.indices((HEIGHT, WIDTH))
        local = np.stack([(u - K[0, 2]) / fx, (v - K[1, 2]) / fy, np.ones(u.shape)], axis=-1)
        rays = local.reshape(-1, 3) @ T[:3, :3].T
        shapes = self.arm.at(q)
        mine, others = (cast(some, T[:3, 3], rays) for some in (shapes, self.things))
        true = np.minimum(mine, others)
        wall = float(rng.choice([np.inf, 4.0, 6.0], p=[0.1, 0.45, 0.45]))
        image = np.where(np.isfinite(true), true, wall) + rng.uniform(-1, 1, true.shape) * self.noise
        gone = rng.uniform(size=true.shape) < float(rng.choice([0.0, 0.05]))
        image[gone] = rng.choice([np.nan, np.inf, -np.inf, 0.0, -1.0], int(gone.sum()))
        echo = np.isfinite(image) & (image > 0.0)
        image = image.reshape(HEIGHT, WIDTH)
        single = rng.uniform() < 0.5
        taken = image.astype(np.float32) if single else image
        cloud = points_of(taken, K, T)
        stays = self.checker.off_the_robot(cloud, q, clear=self.clear, mask=True).ravel()
        points = T[:3, 3] + np.where(echo, image.ravel(), 0.0)[:, None] * rays
        is_mine, is_other = echo & (mine < others), echo & (others < mine)
        gap = np.full(len(points), np.inf)
        removed = is_other & ~stays
        gap[removed] = distance(shapes, points[removed])
        counts.frames += 1
        counts.mine += int(is_mine.sum())
        counts.others += int(is_other.sum())
        counts.left += int((is_mine & stays).sum()) + int((stays & ~echo).sum())
        counts.removed += int(removed.sum())
        counts.lost += int((removed & (gap > self.clear + (1e-6 if single else SURE))).sum())
        self.space.see(taken - (self.noise + 1e-5 * single), K, T, time=now)
        depths = np.where(np.isfinite(true), true, wall)
        self.passed |= passed(T[:3, 3], rays, np.where(echo, depths, 0.0))
        counts.unpassed += int((~self.space.unknown & ~self.passed).sum())
        counts.seen = max(counts.seen, int((self.space.age >= 0).sum()))
        return np.asarray(cloud.reshape(-1, 3)[stays])

    def plan(self, q: Array, cloud: Array, counts: Counts) -> None:
        """Plan into the cells that were seen, and count the plans with a point of the robot in another cell."""
        scene, robot = self.checker.scene, self.arm.robot
        for name, body in (
            ("camera", Body.from_cloud(cloud, voxel=VOXEL)),
            ("unknown", self.space.body(self.checker, q, clear=self.clear)),
        ):
            scene.replace(name, body)
            scene.move(name, np.eye(4))
        if self.checker.collide(q):
            return
        goals = np.clip(q + self.rng.uniform(-1.2, 1.2, (60, len(q))), robot.lower, robot.upper)
        goals = goals[~self.checker.collide(goals)]
        if len(goals) == 0:
            return
        counts.tried += 1
        try:
            path = planners.plan(self.checker, q, goals[0], seed=counts.tried, max_iterations=2000)
        except loewner.PlanningError:
            return
        counts.plans += 1
        counts.entered += self.enters(q, path, counts)

    def enters(self, start: Array, path: Array, counts: Counts) -> bool:
        """Whether a point of the robot is in a cell that no ray has passed, other than those at the start."""
        shares = np.linspace(0, 1, 25)[:, None]
        Q = np.concatenate([a + (b - a) * shares for a, b in zip(path[:-1], path[1:], strict=True)])
        moving = [(link, shape, shape.samples(self.rng, 200)) for link, shape in self.arm.shapes[1:]]
        cells = []
        for q in Q:
            poses = self.arm.poses(q)
            for link, shape, points in moving:
                T = poses[link] @ shape.pose
                cells.append(np.floor((points @ T[:3, :3].T + T[:3, 3] - LOW) / CELL).astype(int))
        index = np.unique(np.concatenate(cells), axis=0)
        counts.visited += len(index)
        within = ((index >= 0) & (index < CELLS)).all(axis=1)
        known = within.copy()
        known[within] = self.passed[tuple(index[within].T)]
        reach = self.clear + np.sqrt(0.75) * CELL
        middles = LOW + CELL * (index[~known] + 0.5)
        if len(middles) == 0:
            return False
        return bool((distance(self.arm.at(start), middles) > reach + SURE).any())


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=10_000)
    parser.add_argument("--plans", type=int, default=1000)
    parser.add_argument("--after", type=int, nargs="+", default=[1, 3], help="frames of a world after which to plan")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args(arguments)
    began, busy, counts, world = time.perf_counter(), time.process_time(), Counts(), 0
    ur5 = example("ur_description/urdf/ur5_robot.urdf", "ur_description/srdf/ur5.srdf")
    files = [Arm.known(sample.robot) for sample in (panda(), ur5)]
    while counts.frames < options.frames or counts.plans < options.plans:
        rng = np.random.default_rng([options.seed, world])
        arm = Arm.random(rng) if world % 4 else files[world // 4 % 2]
        World(rng, arm).run(counts, options.frames, options.plans, options.after)
        world += 1
    print(f"worlds: {world:,}; frames: {counts.frames:,}; cells seen in one, at most: {counts.seen:,}")
    print(f"points of the robot: {counts.mine:,}; that stay: {counts.left}")
    print(f"points of obstacles: {counts.others:,}; removed: {counts.removed:,}; farther than `clear`: {counts.lost}")
    print(f"cells counted as seen that no ray has passed: {counts.unpassed}")
    print(
        f"plans: {counts.plans:,} of {counts.tried:,}; cells entered: {counts.visited:,}; plans with a cell that no "
        f"ray has passed: {counts.entered}"
    )
    print(f"{time.process_time() - busy:.0f} s of processor time, {time.perf_counter() - began:.0f} s")
    return 0 if counts.left == counts.lost == counts.entered == counts.unpassed == 0 else 1


if __name__ == "__main__":
    raise SystemExit(main())
