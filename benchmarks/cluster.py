"""A corpus of meshes on two workers and on one, and with a worker killed; checkers on arrays; what a task costs.

    python benchmarks/cluster.py             1,000 meshes, minutes
    python benchmarks/cluster.py --quick     a few

Each worker is a process of one thread. The ratio of two workers to one is that of this machine at this moment: plain
arithmetic in two processes, timed right before, says what it allows.
"""

from __future__ import annotations

import argparse
import os
import pickle
import signal
import tempfile
import time
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import dask.array as da
import numpy as np
import trimesh
from distributed import Client, LocalCluster

import loewner
from loewner import Body, CollisionChecker, Verdict, cluster
from robot_samples import obstacles, panda

MESHES, QUICK = 1000, 12
CONFIGURATIONS, MOTIONS = 2_000_000, 10_000


def corpus(folder: Path, count: int) -> list[Path]:
    """Meshes of random rocks, two or three to a file, each of 320 triangles: in random places."""
    rng, meshes = np.random.default_rng(0), []
    for k in range(count):
        parts = []
        for _ in range(2 + k % 2):
            rock = trimesh.creation.icosphere(subdivisions=2)
            rock.vertices *= rng.uniform(0.05, 0.2, 3)
            parts.append(rock.apply_translation(rng.uniform(-1, 1, 3)))
        meshes.append(folder / f"rocks{k:04}.stl")
        trimesh.util.concatenate(parts).export(meshes[-1])
    return meshes


@contextmanager
def workers(count: int) -> Iterator[Client]:
    """A client of so many processes of one thread, which have loaded what they need."""
    with (
        LocalCluster(n_workers=count, threads_per_worker=1, dashboard_address=":0") as started,
        Client(started, set_as_default=False) as client,
    ):
        client.wait_for_workers(count)
        client.run(warm_up)
        yield client


def warm_up() -> None:
    """Import and load all that a fit needs."""
    with tempfile.TemporaryDirectory() as folder:
        for mesh in corpus(Path(folder), 2):
            Body.from_mesh(mesh)


def seconds_to_fit(client: Client, meshes: list[Path], out: Path, **more: Any) -> tuple[float, cluster.Fitted]:
    start = time.perf_counter()
    fitted = cluster.fit(meshes, client, out, **more)
    return time.perf_counter() - start, fitted


def differing(fitted: cluster.Fitted, folder: Path) -> int:
    """How many bodies are not, byte for byte, those of the serial call."""
    serial, wrong = folder / "serial.npz", 0
    for mesh, made in fitted.done.items():
        Body.from_mesh(mesh).save(serial)
        wrong += serial.read_bytes() != made.read_bytes()
    return wrong


def plain(steps: int) -> float:
    """Arithmetic that nothing but the machine keeps from running twice as fast in two processes."""
    total = 0.0
    for k in range(steps):
        total += (k % 7) ** 0.5
    return total


def machine_allows(steps: int) -> float:
    """How many times as fast two processes do plain arithmetic here and now."""
    with ProcessPoolExecutor(2) as pool:
        list(pool.map(plain, [1000, 1000]))
        start = time.perf_counter()
        list(pool.map(plain, [steps]))
        alone = time.perf_counter() - start
        start = time.perf_counter()
        list(pool.map(plain, [steps, steps]))
        return 2 * alone / (time.perf_counter() - start)


def fits(folder: Path, count: int, rounds: int) -> None:
    """Two workers and one, taking turns; then two of which one is killed in the middle."""
    meshes = corpus(folder, count)
    with workers(1) as one, workers(2) as two:
        for k in range(rounds):
            allowed = machine_allows(10_000 * count)
            slow, _ = seconds_to_fit(one, meshes, folder / f"one{k}")
            fast, fitted = seconds_to_fit(two, meshes, folder / f"two{k}")
            again, skipped = seconds_to_fit(two, meshes, folder / f"two{k}")
            print(
                f"{count} meshes: one worker {slow:.2f} s ({1e3 * slow / count:.2f} ms a mesh), two {fast:.2f} s, "
                f"{slow / fast:.2f} times as fast; the machine allows {allowed:.2f}; load {os.getloadavg()[0]:.1f}; "
                f"again {again:.2f} s, {len(skipped.skipped)} skipped"
            )
        print(f"not those of the serial call: {differing(fitted, folder)} of {len(fitted.done)}")
    start = time.perf_counter()
    for mesh in meshes:
        Body.from_mesh(mesh).save(folder / "serial.npz")
    print(f"in this process, without Dask, {1e3 * (time.perf_counter() - start) / count:.2f} ms a mesh on "
          f"{loewner.get_num_threads()} threads")  # fmt: skip
    with workers(2) as client:
        taken, fitted = seconds_to_fit(client, meshes, folder / "killed", progress=killer(client, count // 2))
    print(
        f"a worker killed in the middle: {fitted}, {taken:.2f} s; "
        f"not those of the serial call: {differing(fitted, folder)}"
    )


def killer(client: Client, when: int) -> Any:
    """Ends a worker after so many files."""
    victims = client.run(os.getpid)

    def progress(done: int, total: int) -> None:
        if done == when:
            os.kill(next(iter(victims.values())), signal.SIGKILL)

    return progress


def overhead(count: int) -> None:
    """What a task costs in which nothing is done."""
    with workers(2) as client:
        for _ in range(2):
            start = time.perf_counter()
            client.gather(client.map(abs, range(count), pure=False))
            taken = time.perf_counter() - start
        print(f"{count} empty tasks: {1e3 * taken / count:.2f} ms each")


def checkers(configurations: int, motions: int) -> None:
    """Configurations and motions of an arm among boxes: on one worker and on two, and in this process."""
    robot = panda().robot
    checker = CollisionChecker(robot, obstacles(0))
    packed = pickle.dumps(checker)
    start = time.perf_counter()
    pickle.loads(packed).collide(robot.configuration("default"))
    print(
        f"the checker: {len(packed)} bytes, unpacked and ready in {1e3 * (time.perf_counter() - start):.1f} ms; "
        f"{8 * robot.dof} bytes a configuration there, 1 back"
    )
    Q = robot.random_configurations(configurations, seed=0)
    ends = [da.from_array(part, chunks=(1000, -1)) for part in (Q[:motions], Q[motions : 2 * motions])]
    with workers(1) as one, workers(2) as two:
        for chunk in (5_000, 50_000):
            share = da.random.default_rng(0).random((configurations, robot.dof), chunks=(chunk, -1))
            made = robot.lower + share * (robot.upper - robot.lower)
            for name, lazy in (("made by the workers", made), ("sent to them", da.from_array(Q, chunks=(chunk, -1)))):
                hits = cluster.collide(checker, lazy).sum()
                report(f"configurations {name}, {chunk} a chunk", one, two, hits, configurations)
        report("motions", one, two, (cluster.certify_edges(checker, *ends) == Verdict.FREE).sum(), motions)
    for threads in (1, 2):
        loewner.set_num_threads(threads)
        start = time.perf_counter()
        checker.collide(Q)
        print(f"in this process on {threads} threads: {1e6 * (time.perf_counter() - start) / len(Q):.2f} us each")


def report(name: str, one: Client, two: Client, lazy: Any, items: int) -> None:
    """Times of a lazy result on one worker and on two; the second time counts."""
    taken = []
    for client in (one, two):
        for _ in range(2):
            start = time.perf_counter()
            client.compute(lazy, sync=True)
            last = time.perf_counter() - start
        taken.append(last)
    print(f"{name}: one worker {1e6 * taken[0] / items:.2f} us each, two workers {1e6 * taken[1] / items:.2f} us")


def main(quick: bool) -> None:
    count = QUICK if quick else MESHES
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        fits(folder, count, 1 if quick else 2)
        overhead(count)
        checkers(*(10_000, 100) if quick else (CONFIGURATIONS, MOTIONS))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true")
    main(parser.parse_args().quick)
