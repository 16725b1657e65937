"""The native library and the compiler on this machine give the same answers, bit for bit."""

import hashlib
import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from loewner._native import library
from native_files import module

pytestmark = pytest.mark.verify

PAIRS, CONFIGURATIONS, FITS = 1_000_000, 100_000, 1_000
POOL = 400  # bodies of each family

build = module("build")


def digest(*arrays: np.ndarray) -> str:
    """Hash of the bytes of arrays."""
    summed = hashlib.sha256()
    for array in arrays:
        summed.update(np.ascontiguousarray(array).tobytes())
    return summed.hexdigest()[:16]


def answers() -> dict[str, str]:
    """Hashes of all answers, by what was asked."""
    import loewner
    from families import FAMILIES, pieces, random_poses
    from robot_oracle import robots_folder

    found = {}
    count = -(-PAIRS // len(FAMILIES))
    for family in sorted(FAMILIES):
        rng = np.random.default_rng([11, sum(family.encode())])
        a, b = (loewner.Bodies.from_points(pieces(family, POOL, seed)) for seed in (1, 2))
        rows = rng.integers(POOL, size=(count, 2))
        T = random_poses(rng, POOL, 1.5)
        found[f"{family}: verdicts"] = digest(loewner.classify(a, None, b, T, pairs=rows))
        found[f"{family}: exact"] = digest(
            loewner.collide(a, None, b, T, pairs=rows),
            loewner.collide(a, None, b, T, pairs=rows, margin=0.05),
        )
        few = rows[: count // 20, 0], rows[: count // 20, 1]
        d = loewner.distance(a[few[0]], None, b[few[1]], T[few[1]], exact=True)
        found[f"{family}: distances"] = digest(d.lower, d.upper, d.estimate, d.distance, d.witness_a, d.normal)
        near = T[few[1]].copy()  # at contact, to a part in ten thousand
        away = near[:, :3, 3] / np.linalg.norm(near[:, :3, 3], axis=1)[:, None]
        near[:, :3, 3] -= away * (np.maximum(d.distance, 0.0) * 0.9999)[:, None]
        found[f"{family}: near contact"] = digest(
            loewner.classify(a[few[0]], None, b[few[1]], near), loewner.collide(a[few[0]], None, b[few[1]], near)
        )
    rng = np.random.default_rng(12)
    for number, family in enumerate(sorted(FAMILIES)):
        fits = [
            part
            for points in pieces(family, -(-FITS // len(FAMILIES)), 13 + number)
            for part in (loewner.mvce(points), loewner.mvie(points))
        ]
        found[f"{family}: fits"] = digest(
            *(array for fit in fits for array in (fit.ellipsoid.center, fit.ellipsoid.factor, np.array(fit.gap)))
        )
    robot = loewner.Robot.from_urdf(robots_folder() / "panda_description/urdf/panda.urdf")
    scene = loewner.Scene(margin=0.01)
    for number, T in enumerate(random_poses(rng, 10, 1.0)):
        scene.add(f"thing {number}", loewner.Body.box(rng.uniform(0.1, 0.6, 3)), T)
    checker = loewner.CollisionChecker(robot, scene)
    Q = robot.random_configurations(CONFIGURATIONS, seed=1)
    found["configurations"] = digest(checker.collide(Q), checker.classify(Q))
    found["motions"] = digest(checker.valid_edges(Q[:300], Q[300:600], 0.05))
    grains = loewner.Bodies.ellipsoids(rng.uniform(0.2, 1.0, size=(3000, 3)))
    found["crowd"] = digest(loewner.overlapping_pairs(grains, random_poses(rng, 3000, 12.0)))
    return found


def asked(**environment: str) -> dict[str, str]:
    """`answers` of a process with these settings."""
    code = f"""
import json, sys
sys.path[:0] = {[str(Path(__file__).parent), str(Path(__file__).parent.parent)]!r}
import test_library_verify
print(json.dumps(test_library_verify.answers()))
"""
    kept = {name: value for name, value in os.environ.items() if not name.startswith(("LOEWNER_", "NUMBA_"))}
    kept |= {name: os.environ[name] for name in ("LOEWNER_CACHE_DIR",) if name in os.environ}
    done = subprocess.run(
        [sys.executable, "-c", code], env=kept | environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr[-3000:]
    return json.loads(done.stdout.splitlines()[-1])


@pytest.fixture(scope="module")
def here() -> dict[str, str]:
    """The answers of the best level of the library."""
    if library.level() is None:
        pytest.skip(f"no native library here: {library.why_not()}")
    return asked()


def test_library_and_compiler_agree(here):
    """A million pairs of fifteen families, a hundred thousand configurations, a thousand fits."""
    assert len(here) >= 15 * 5 + 3
    assert asked(LOEWNER_JIT="1") == here


@pytest.mark.parametrize("level", [level for levels in build.LEVELS.values() for level in levels])
def test_every_level_agrees_with_the_compiler_for_it(level):
    """The same of each level that is built, beside Numba limited to that level."""
    if level not in library.levels() or not (library.HOME / f"kernels-{level}.so").exists():
        pytest.skip(f"no library of {level} here")
    mine = asked(LOEWNER_LEVEL=level)
    compiled = asked(LOEWNER_JIT="1", **build.told(level))
    assert mine == compiled
