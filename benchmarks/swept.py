"""Swept volumes of a robot beside the union of 1,000 placed meshes: time, size, and points that are outside.

    python benchmarks/swept.py [--quick]

The other way of making a swept volume is to place the meshes of the links at many times and to unite them. `trimesh`
unites by the engine manifold if it is there (pip install manifold3d); the meshes are concatenated otherwise, which
takes no time and leaves a thousand overlapping meshes. A point counts as outside if no placed mesh, or no piece,
contains it.
"""

from __future__ import annotations

import argparse
import time
from importlib.util import find_spec

import numpy as np
import trimesh
from scipy.interpolate import CubicSpline

from loewner import Body, Robot
from robot_samples import panda
from samples import Array

TOLERANCES = (0.05, 0.02, 0.01)
LINK = "panda_hand"
POINTS, SHARE = 1_000_000, 100_000


def outside(body: Body, points: Array) -> int:
    """How many points no convex piece contains."""
    left = np.arange(len(points))
    for piece in body.pieces:
        low, high = piece.vertices.min(axis=0), piece.vertices.max(axis=0)
        near = left[((points[left] >= low) & (points[left] <= high)).all(axis=1)]
        inside = near[(points[near] @ piece.normals.T <= piece.offsets).all(axis=1)]
        left = np.setdiff1d(left, inside, assume_unique=True)
    return len(left)


def placed(robot: Robot, Q: Array) -> Array:
    """Poses of the link, some at a time for the sake of memory."""
    parts = np.split(Q, range(SHARE, len(Q), SHARE))
    return np.concatenate([robot.forward_kinematics(part)[:, robot.link_names.index(LINK)] for part in parts])


def rows(quick: bool = False) -> list[tuple[str, float, int, int]]:
    """Name, processor seconds, number of triangles and points outside, for each way."""
    robot, rng = panda().robot, np.random.default_rng(0)
    postures = np.random.default_rng(1).uniform(robot.lower, robot.upper, (4, robot.dof))
    curve, link = CubicSpline(np.arange(4.0), postures), robot.bodies[LINK].pieces[0]
    T = placed(robot, curve(rng.uniform(0.0, 3.0, 1000 if quick else POINTS)))
    corners = link.vertices[rng.integers(0, len(link.vertices), len(T))]
    points = np.einsum("nij,nj->ni", T[:, :3, :3], corners) + T[:, :3, 3]
    found = []
    for tolerance in TOLERANCES[: 1 if quick else None]:
        start = time.process_time()
        body = robot.swept(curve, links=LINK, tolerance=tolerance)
        spent = time.process_time() - start
        count = sum(len(piece.triangles) for piece in body.pieces)
        found.append((f"loewner, {1e3 * tolerance:g} mm", spent, count, outside(body, points)))
    start = time.process_time()
    mesh = trimesh.Trimesh(link.vertices, link.triangles)
    many = [mesh.copy().apply_transform(T) for T in placed(robot, curve(np.linspace(0.0, 3.0, 50 if quick else 1000)))]
    engine = find_spec("manifold3d") is not None
    whole = trimesh.boolean.union(many, engine="manifold") if engine else trimesh.util.concatenate(many)
    spent = time.process_time() - start
    pieces = Body.from_pieces([one.vertices for one in many])  # for the same test of points
    name = f"trimesh, {'union' if engine else 'concatenation'} of {len(many)}"
    return [*found, (name, spent, len(whole.faces), outside(pieces, points))]


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true")
    print(f"{'way':<32} {'s':>8} {'triangles':>10} {'points outside':>15}")
    for name, spent, triangles, missed in rows(parser.parse_args().quick):
        print(f"{name:<32} {spent:8.2f} {triangles:10d} {missed:15d}")


if __name__ == "__main__":
    main()
