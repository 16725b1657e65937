"""Which of many ellipsoids overlap: broad phase and narrow phase together.

We have no broad phase yet: SciPy's k-d tree on the centers, then one `overlap`. Coal: its dynamic AABB tree in C++.
ellipsoid_tree: its own tree, from Python in one call. Making the shapes is not counted, making the trees is.
"""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

import loewner
from clock import race, timed
from report import Row
from rivals import CoalLoop, Missing, Settings, all_settings, build_loop
from samples import Array, Pairs, dataset, fitted, poses, rotations

COUNT, QUICK = 5_000, 500
# Volume per ellipsoid, in cubic metres: each then overlaps some two others.
ROOM = 4.0


def run(quick: bool, folder: Path) -> list[Row]:
    n = QUICK if quick else COUNT
    rounds = 2 if quick else 5
    rng = np.random.default_rng(0)
    # Outer ellipsoids of the paper's hulls, turned and strewn in a cube.
    hulls = fitted(dataset.sample(n, 0, "volume").points_1)
    T = poses(rotations(rng, n), rng.uniform(0, np.cbrt(ROOM * n), size=(n, 3)))
    outer = hulls.outer
    placed = outer.transformed(T)
    reach = float(outer.semi_axes.max())

    def overlapping() -> Array:
        near = cKDTree(placed.center).query_pairs(2 * reach, output_type="ndarray")
        return near[loewner.overlap(placed[near[:, 0]], placed[near[:, 1]])]

    found = _ordered(overlapping(), n)
    us, case = "k-d tree + overlap", f"{n} ellipsoids"
    rows = []
    everyone = np.arange(n)
    try:
        with CoalLoop(build_loop(folder), Pairs("crowd", hulls, everyone, everyone, T, T), folder) as loop:
            ways = [s for s in all_settings("ellipsoid-collide", early=(1,)) if s.guess != 1]
            way: Settings = min(ways, key=lambda s: loop.measure(s, task="crowd").cpu)
            cost = race({"us": timed(overlapping, n), "rival": loop.measured(way, task="crowd")}, rounds)
            said = _ordered(loop.answers(way, task="crowd"), n)
        note = f"{way}; {len(found)} overlapping pairs; differing pairs"
        rows.append(
            Row(case, us, cost["us"], "Coal C++ AABB tree", cost["rival"], n, None, _differing(found, said), note)
        )
    except Missing as missing:
        rows.append(Row(case, us, None, "Coal C++ AABB tree", None, n, note=f"not run: {missing}"))
    if find_spec("ellipsoid_tree") is None:
        rows.append(
            Row(case, us, None, "ellipsoid_tree", None, n, note="not run: package ellipsoid-tree not installed")
        )
        return rows
    import ellipsoid_tree

    centers, matrices = np.asfortranarray(placed.center), placed.shape_matrix

    def tree() -> Array:
        return np.array(
            ellipsoid_tree.EllipsoidTree(centers, matrices, 1.0, 1).self_collision_pairs(), dtype=np.int64
        ).reshape(-1, 2)

    cost = race({"us": timed(overlapping, n), "rival": timed(tree, n)}, rounds)
    said = _ordered(tree(), n)
    note = f"one thread asked of both; {len(found)} overlapping pairs; differing pairs"
    rows.append(Row(case, us, cost["us"], "ellipsoid_tree", cost["rival"], n, None, _differing(found, said), note))
    return rows


def _ordered(found: Array, n: int) -> Array:
    """Pairs as one number each, smaller index first, without a body's pair with itself."""
    i, j = np.sort(found, axis=1).T
    return np.unique((i * n + j)[i != j])


def _differing(ours: Array, theirs: Array) -> int:
    return len(np.setxor1d(ours, theirs))
