"""Public calls under a limit on the address space, as ``ulimit -v`` sets it: a right answer, or a `MemoryLimitError`.

Never a raw MemoryError, a crash or a hang. Some limits leave place for the operands alone, some for the results but not
for what a call needs on the way.
"""

import pickle
import random
import sys
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

import driver
import loewner
from families import random_poses
from gantry import gantry
from loewner import Bodies, Body, CollisionChecker, Ellipsoids, MemoryLimitError, Robot, Scene, paper
from sampling import quick

resource = pytest.importorskip("resource")

# What a limit leaves beside the memory in use, in MiB: drawn between these two, evenly in the logarithm.
LEAST, MOST = 0.25, 128.0


def calls(folder: Path) -> dict[str, Callable[[], Any]]:
    """Public calls that make arrays, each of 1 to some 500 MB."""
    rng = np.random.default_rng(0)
    sets = rng.normal(size=(1000, 20, 3))
    rock, rocks, drum = Body.from_points(sets[0]), Bodies.from_points(sets[:50]), Body.cylinder(0.5, 2.0)
    T = random_poses(rng, 2000)
    list_of_poses = T.tolist()
    many = np.tile(T, (200, 1, 1)).astype(np.float32)
    cloud, flat = rng.normal(size=(5000, 20)), rng.normal(size=(300_000, 3))
    E = Ellipsoids.from_semi_axes(rng.normal(size=(100_000, 3)), rng.uniform(0.2, 1, size=(100_000, 3)))
    urdf, _ = gantry(folder)
    robot, scene = Robot.from_urdf(urdf), Scene(margin=0.01)
    for i in range(20):
        scene.add(f"rock {i}", rocks[i], random_poses(rng, 1, spread=4.0)[0])
    checker = CollisionChecker(robot, scene)
    Q = robot.random_configurations(200_000, seed=1)
    ball = trimesh.creation.icosphere(subdivisions=4)
    # Operands are made here, or by the first call, which has no limit: what they take is not the library's.
    thousand, hundred = np.indices((1000, 1000)).T, np.indices((100, 100)).T
    normals, offsets = np.concatenate([cloud, -cloud])[:, :8].copy(), np.ones(10_000)
    sphere = flat[:5000] / np.linalg.norm(flat[:5000], axis=1, keepdims=True)
    ones, which, backwards = np.ones(100_000), np.arange(20_000) % 50, E[::-1]

    @cache
    def list_of_states() -> list[list[float]]:
        return Q.tolist()

    @cache
    def balls() -> Path:
        Bodies.spheres(np.ones(100_000)).save(folder / "balls.npz")
        return folder / "balls.npz"

    heap = [rock] * 10_000
    return {
        "classify": lambda: loewner.classify(rock, T[:, None], rock, T),
        "classify lists": lambda: loewner.classify(rock, list_of_poses, rock, None),
        "classify single precision": lambda: loewner.classify(rock, many, rock, None),
        "collide": lambda: loewner.collide(rock, T[:500, None], drum, T),
        "collide by the estimate": lambda: loewner.collide(rock, T[:500, None], drum, T, method="estimate"),
        "collide pairs": lambda: loewner.collide(rock, T, rock, T, pairs=thousand),
        "distance": lambda: loewner.distance(rock, T[:500, None], rock, T),
        "distance, exact": lambda: loewner.distance(rock, T[:50, None], rock, T, exact=True),
        "distance of pairs": lambda: loewner.distance(rock, T, rock, T, pairs=hundred, exact=True),
        "overlapping_pairs": lambda: loewner.overlapping_pairs(rock, T[:1000]),
        "mvce": lambda: loewner.mvce(cloud),
        "mvce of many": lambda: loewner.mvce(flat),
        "mvce, lifted": lambda: paper.mvce_by_lifted_mvie(cloud[:2000, :10]),
        "mvie": lambda: loewner.mvie(normals, offsets),
        "Bodies.from_points": lambda: Bodies.from_points(sets),
        "Body.from_points": lambda: Body.from_points(sphere),
        "Body.from_mesh": lambda: Body.from_mesh(ball, decompose=False),
        "Polytope.from_points": lambda: loewner.Polytope.from_points(flat),
        "Bodies.spheres": lambda: Bodies.spheres(ones),
        "Bodies[...]": lambda: rocks[which],
        "union": lambda: Body.union(heap),
        "Bodies.load": lambda: Bodies.load(balls()),
        "Bodies.save": lambda: rocks.save(folder / "saved.npz"),
        "contact_function": lambda: loewner.contact_function(E, backwards),
        "near_points": lambda: loewner.near_points(E, backwards),
        "paper.distance_estimate": lambda: paper.distance_estimate(E, E, backwards, backwards),
        "shape_matrix": lambda: E.shape_matrix,
        "random_configurations": lambda: robot.random_configurations(3_000_000),
        "forward_kinematics": lambda: robot.forward_kinematics(Q),
        "checker.collide": lambda: checker.collide(Q),
        "checker.classify": lambda: checker.classify(list_of_states()),
        "checker.distance": lambda: checker.distance(Q[:20_000]),
        "checker.distance, exact": lambda: checker.distance(Q[:3000], exact=True),
        "checker.collide_by_pair": lambda: checker.collide_by_pair(Q[:5000]),
        "checker.valid_edges": lambda: checker.valid_edges(Q[:2000], Q[2000:4000], resolution=0.005),
    }


@cache
def made(folder: Path) -> dict[str, Callable[[], Any]]:
    return calls(folder)


@cache
def answer(folder: Path, name: str) -> bytes:
    return pickle.dumps(made(folder)[name]())


def campaign(folder: Path, count: int, seed: int, every: int = 1) -> list[driver.Outcome]:
    """Outcomes of `count` calls under limits, all names in turn, or each `every`-th."""
    draw = random.Random(seed)
    names = list(made(folder))[::every]
    for name in names:
        answer(folder, name)  # here, once: the driver's processes are forks of this one
    cases = []
    for k in range(count):
        room = LEAST * (MOST / LEAST) ** draw.random()
        cases.append((names[k % len(names)], 1 + k // len(names) % 2, room, str(folder)))
    return driver.run(limited, cases, limit=60.0)


def address_space() -> int:
    """Bytes in use."""
    return int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()


def limited(case: tuple[str, int, float, str]) -> str | None:
    """Call under a limit; then again without."""
    name, threads, room, folder = case
    call, expected = made(Path(folder))[name], answer(Path(folder), name)
    loewner.set_num_threads(threads)
    _, hard = resource.getrlimit(resource.RLIMIT_AS)
    # What earlier calls freed and the allocator kept is no place to hide in: fill it.
    resource.setrlimit(resource.RLIMIT_AS, (address_space(), hard))
    ballast: list[bytearray] = []
    for size in (2**24, 2**20, 2**17):
        with suppress(MemoryError):
            while True:
                ballast.append(bytearray(size))
    resource.setrlimit(resource.RLIMIT_AS, (address_space() + int(room * 2**20), hard))
    refused: Exception | None = None
    found = None
    try:
        found = call()
    except MemoryLimitError as error:
        refused = error
    except loewner.LoewnerError as error:
        return f"another error: {error!r}"
    finally:
        resource.setrlimit(resource.RLIMIT_AS, (hard, hard))
        ballast.clear()
    if refused is None and pickle.dumps(found) != expected:
        return "another answer than without a limit"
    if pickle.dumps(call()) != expected:
        return "another answer after the limit was lifted"
    if refused is not None:
        raise refused
    return None


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("memory")


@pytest.mark.skipif(sys.platform != "linux", reason="other systems do not enforce the limit")
@pytest.mark.parametrize("every", quick(14, 5))
def test_calls_with_little_memory(folder: Path, every: int):
    """A right answer or a `MemoryLimitError`; and a right answer once there is memory."""
    assert not driver.faults(campaign(folder, 40 // every, seed=1, every=every))


@pytest.mark.fuzz
@pytest.mark.skipif(sys.platform != "linux", reason="other systems do not enforce the limit")
def test_many_calls_with_little_memory(folder: Path):
    """A right answer or a `MemoryLimitError`; and a right answer once there is memory."""
    outcomes = campaign(folder, 204, seed=2)
    counts = {kind: sum(outcome.kind == kind for outcome in outcomes) for kind in (driver.OK, driver.REFUSED)}
    print(f"\nmemory: {len(outcomes)} of {len(made(folder))} calls, {counts}")
    assert not driver.faults(outcomes)
    assert counts[driver.REFUSED] >= 30
