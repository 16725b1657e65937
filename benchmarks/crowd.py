"""Which of many ellipsoids overlap: broad phase and narrow phase together, from poses to pairs.

Coal: its dynamic AABB tree in C++, once built from nothing, once brought up to date from an earlier step.
ellipsoid_tree: its own tree, from Python in one call. Making the shapes is not counted, making the trees is.
"""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path

import numpy as np

import loewner
from clock import race, timed
from report import REQUIRED, Row
from rivals import CoalLoop, Missing, Settings, all_settings, build_loop
from samples import Array, Pairs, dataset, fitted, poses, rotations

COUNTS, QUICK = (5_000, 100_000), 500
LARGE = 100_000  # the size that a ratio is asked for at
FRACTION = 0.1  # of the volume is filled, overlaps counted twice
TREES = {"crowd": "Coal C++ AABB tree, built", "step": "Coal C++ AABB tree, updated"}


def run(quick: bool, folder: Path) -> list[Row]:
    return [row for n in ((QUICK,) if quick else COUNTS) for row in compare(n, 2 if quick else 5, folder)]


def compare(n: int, rounds: int, folder: Path) -> list[Row]:
    """One crowd beside every rival."""
    rng = np.random.default_rng(0)
    # Outer ellipsoids of the paper's hulls, turned and strewn in a cube.
    hulls = fitted(dataset.sample(n, 0, "volume").points_1)
    outer = hulls.outer
    side = np.cbrt(outer.volume.sum() / FRACTION)
    T = poses(rotations(rng, n), rng.uniform(0, side, size=(n, 3)))
    # The same ellipsoids about their own origins, which is how both we and Coal take them.
    ellipsoids = loewner.Bodies.ellipsoids(outer.semi_axes)
    placed = T @ poses(outer.rotation, outer.center)

    def ours() -> Array:
        return loewner.overlapping_pairs(ellipsoids, placed)

    found = _ordered(ours(), n)
    us, case = "overlapping_pairs", f"{n} ellipsoids"
    required = REQUIRED["crowd"] if n >= LARGE else None
    rows = []
    everyone = np.arange(n)
    try:
        with CoalLoop(build_loop(folder), Pairs("crowd", hulls, everyone, everyone, T, T), folder) as loop:
            ways = [s for s in all_settings("ellipsoid-collide", early=(1,)) if s.guess != 1]
            for task, rival in TREES.items():
                way: Settings = min(ways, key=lambda s: loop.measure(s, task=task).cpu)
                cost = race({"us": timed(ours, n), "rival": loop.measured(way, task=task)}, rounds)
                said = _ordered(loop.answers(way, task=task), n)
                note = f"{way}; {len(found)} overlapping pairs; differing pairs"
                rows.append(Row(case, us, cost["us"], rival, cost["rival"], n, required, _differing(found, said), note))
    except Missing as missing:
        rows += [Row(case, us, None, rival, None, n, required, note=f"not run: {missing}") for rival in TREES.values()]
    if find_spec("ellipsoid_tree") is None:
        rows.append(
            Row(case, us, None, "ellipsoid_tree", None, n, note="not run: package ellipsoid-tree not installed")
        )
        return rows
    import ellipsoid_tree

    world = outer.transformed(T)
    centers, matrices = np.asfortranarray(world.center), world.shape_matrix

    def tree() -> Array:
        return np.array(
            ellipsoid_tree.EllipsoidTree(centers, matrices, 1.0, 1).self_collision_pairs(), dtype=np.int64
        ).reshape(-1, 2)

    cost = race({"us": timed(ours, n), "rival": timed(tree, n)}, rounds)
    said = _ordered(tree(), n)
    note = f"one thread asked of both; {len(found)} overlapping pairs; differing pairs"
    rows.append(Row(case, us, cost["us"], "ellipsoid_tree", cost["rival"], n, required, _differing(found, said), note))
    return rows


def _ordered(found: Array, n: int) -> Array:
    """Pairs as one number each, smaller index first, without a body's pair with itself."""
    i, j = np.sort(found, axis=1).T
    return np.unique((i * n + j)[i != j])


def _differing(ours: Array, theirs: Array) -> int:
    return len(np.setxor1d(ours, theirs))
