"""What a limit of steps costs and saves: stops of a Panda proven from C, one a call, on one thread.

    python benchmarks/bounded_work.py [motions]

Among ten boxes and a person; with the voxels of a heap on the floor, and with those of the boxes' faces; with the heap
and a person who moves before each call; and with the boxes as solids of triangles. Prints how many steps proofs take;
then for each limit how many motions are given up, the most steps that one took, and the processor time of the thread
for a call, which includes taking over the body that moved. Last, the time of the exact test of one configuration, which
is what a proof may take besides its steps. Calls go through ctypes; an empty one is beside them.
"""

from __future__ import annotations

import argparse
import ctypes
import os
import sys
import tempfile
import time
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from clouds import VOXEL, seen
from loewner import Body, CollisionChecker, Scene
from robot_samples import obstacles, panda
from samples import Array

sys.path.append(str(Path(__file__).parents[1] / "tests"))
import capi

LIMITS = [100, 300, 1_000, 0]
BRAKE, FASTEST = 5.0, 1.5  # rad/s² and rad/s
SWAY = 0.3  # metres that the person moves to each side


def worlds() -> dict[str, tuple[Scene, bool]]:
    """Scenes, and whether the person moves before each call."""
    boxes, heap, faces = obstacles(0), obstacles(0), obstacles(0)
    points = np.random.default_rng(0).uniform([0.2, -0.8, 0.0], [1.0, 0.8, 0.2], (11_000, 3))
    heap.add("heap", Body.from_cloud(points, voxel=VOXEL))
    faces.add("faces", Body.from_cloud(seen(20_000), voxel=VOXEL))
    solids = Scene()
    for name in boxes.names:
        solids.add(name, Body.from_surface(boxes[name].to_trimesh()), boxes.pose(name))
    for scene in (boxes, heap, faces, solids):
        scene.add("person", Body.capsule(0.3, 1.2), standing())
    return {
        "ten boxes": (boxes, False), "and a heap of voxels": (heap, False), "and a person who moves": (heap, True),
        "voxels of the boxes' faces": (faces, False), "the boxes as solids": (solids, False),
    }  # fmt: skip


def standing(x: float = 1.6) -> Array:
    T = np.eye(4)
    T[:3, 3] = x, 0.0, 0.9
    return T


class Loop:
    """Calls for single motions, with their options prepared."""

    def __init__(self, checker: CollisionChecker, moves: bool) -> None:
        with tempfile.TemporaryDirectory() as folder:
            checker.save(Path(folder, "cell.lwn"))
            self.mine = capi.Checker(Path(folder, "cell.lwn"))
        self.moves, self.body = moves, np.array([self.mine.body("person")], dtype=np.int32)
        self.library = capi.functions()

    def run(self, a: Array, b: Array, limit: int) -> tuple[Array, Array, Array]:
        """Verdicts, steps and processor microseconds of all motions."""
        verdicts, steps, spent = np.full(len(a), 9, np.int8), np.zeros(len(a), np.int64), np.empty(len(a))
        certify, move = self.library.loewner_checker_certify_edges, self.library.loewner_checker_move
        checker, workspace, one = self.mine._as_parameter_, self.mine.workspace._as_parameter_, ctypes.c_size_t(1)
        for k in range(len(a)):
            options = capi.ProofOptions(steps=limit, steps_taken=steps.ctypes.data + 8 * k)
            start, end = (ctypes.c_void_p(x.ctypes.data + x.strides[0] * k) for x in (a, b))
            to, given = ctypes.c_void_p(verdicts.ctypes.data + k), ctypes.byref(options)
            if self.moves:
                T = standing(1.6 + SWAY * np.sin(1e-2 * k))
                move(checker, ctypes.c_void_p(self.body.ctypes.data), ctypes.c_void_p(T.ctypes.data), one)
            before = time.thread_time_ns()
            certify(checker, workspace, start, end, one, given, to, None, None)
            spent[k] = (time.thread_time_ns() - before) / 1e3
        return verdicts, steps, spent

    def collide(self, Q: Array) -> Array:
        """Processor microseconds of the exact test of each configuration."""
        test, found, hit = self.library.loewner_checker_collide, np.empty(len(Q)), np.zeros(1, np.int8)
        checker, workspace, one = self.mine._as_parameter_, self.mine.workspace._as_parameter_, ctypes.c_size_t(1)
        for k in range(len(Q)):
            q, to = ctypes.c_void_p(Q.ctypes.data + Q.strides[0] * k), ctypes.c_void_p(hit.ctypes.data)
            before = time.thread_time_ns()
            test(checker, workspace, q, one, to)
            found[k] = (time.thread_time_ns() - before) / 1e3
        return found

    def empty(self, count: int) -> float:
        """Median processor microseconds of a call for no motion."""
        certify, found = self.library.loewner_checker_certify_edges, []
        checker, workspace, none = self.mine._as_parameter_, self.mine.workspace._as_parameter_, ctypes.c_size_t(0)
        for _ in range(count):
            before = time.thread_time_ns()
            certify(checker, workspace, None, None, none, None, None, None, None)
            found.append((time.thread_time_ns() - before) / 1e3)
        return float(np.median(found))


def stops(count: int) -> tuple[Array, Array]:
    """Motions from random configurations until standstill, each joint by itself."""
    robot, rng = panda().robot, np.random.default_rng(1)
    a, v = robot.random_configurations(count, seed=1), rng.uniform(-FASTEST, FASTEST, (count, robot.dof))
    return a, a + v * abs(v) / (2 * BRAKE)


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("motions", type=int, nargs="?", default=100_000)
    count = parser.parse_args(arguments).motions
    a, b = stops(count)
    for name, (scene, moves) in worlds().items():
        loop = Loop(CollisionChecker(panda().robot, scene), moves)
        loop.run(a[:100], b[:100], 0)
        whole, steps, _ = loop.run(a, b, 0)
        middle, most = np.percentile(steps, [50, 99.9]), steps.max()
        print(
            f"\n{name}: {count:,} stops, {(whole == 0).mean():.1%} free; an empty call takes {loop.empty(1000):.1f} us"
        )
        print(f"steps: {middle[0]:,.0f} at the median, {middle[1]:,.0f} at 99.9 %, {most:,} at most")
        print("| limit | given up | most steps | us, median | us, 99.9 % | us, most |")
        for limit in LIMITS:
            verdicts, taken, spent = loop.run(a, b, limit)
            given_up = int(((verdicts != whole) & (verdicts == 2)).sum())
            shown = f"{limit:,}" if limit else "none"
            p = np.percentile(spent, [50, 99.9])
            print(
                f"| {shown} | {given_up:,} | {taken.max():,} | {p[0]:.1f} | {p[1]:.0f} | {spent.max():.0f} |",
                flush=True,
            )
            assert (verdicts[verdicts != 2] == whole[verdicts != 2]).all()
        spent = loop.collide(np.concatenate([a, b]))
        middle = np.percentile(spent, [50, 99.9])
        print(f"one configuration, exactly: {middle[0]:.1f} us, {middle[1]:.0f} us, {spent.max():.0f} us", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
