"""Clusters that lose workers again and again: corpora and arrays come out whole, and as without a cluster."""

import os
import signal
import sys
from pathlib import Path

import numpy as np
import pytest
import trimesh

from gantry import gantry_robot, wall
from loewner import Body, CollisionChecker, cluster
from loewner._base._plausible import told_to

distributed = pytest.importorskip("distributed")
da = pytest.importorskip("dask.array")
pytestmark = pytest.mark.verify

# Files between two deaths of workers, and how many die.
APART, DEATHS = 25, 8


@pytest.fixture
def workers():
    """Two processes of two threads each."""
    with distributed.LocalCluster(n_workers=2, threads_per_worker=2, dashboard_address=":0") as started:
        yield started


@pytest.fixture
def client(workers):
    with distributed.Client(workers, set_as_default=False) as connected:
        connected.wait_for_workers(2)
        yield connected


def corpus(folder: Path) -> list[Path]:
    """Convex meshes, meshes of several parts, and rings, which CoACD decomposes."""
    rng, meshes = np.random.default_rng(0), []
    for k in range(240):
        if k % 24 == 0:
            mesh = trimesh.creation.annulus(0.5 + k / 1000, 1.0, 1.0, sections=8)
        else:
            rocks = [trimesh.creation.icosphere(subdivisions=1 + k % 2) for _ in range(1 + k % 4)]
            moved = [rock.apply_translation(rng.uniform(-3, 3, 3)) for rock in rocks]
            mesh = trimesh.util.concatenate(moved)
        meshes.append(folder / f"mesh{k:03}.stl")
        mesh.export(meshes[-1])
    return meshes


def kill_one(workers, rng) -> None:
    """End one of two workers, if both are up: one that dies while it starts is not started again by Dask."""
    there = workers.scheduler.workers
    pids = [nanny.pid for nanny in workers.workers.values() if nanny.worker_address in there and nanny.pid]
    if len(pids) == 2:
        os.kill(pids[rng.integers(len(pids))], signal.SIGKILL)


def test_a_corpus_survives_many_deaths(workers, client, tmp_path):
    """Each file is told of once, none that was done by then is done again, and all equal the serial ones."""
    meshes, made, rng, seen, counts = corpus(tmp_path), tmp_path / "made", np.random.default_rng(1), {}, []

    def progress(done: int, total: int) -> None:
        counts.append(done)
        if done % APART == 0 and done <= DEATHS * APART:
            seen.update({path: path.stat().st_ino for path in made.glob("*.json")})
            kill_one(workers, rng)

    found = cluster.fit(meshes, client, made, progress=progress)
    assert counts == list(range(1, len(meshes) + 1))
    assert not found.failed
    assert list(found.done) == meshes
    assert len(seen) >= APART * (DEATHS - 1)
    assert {path: path.stat().st_ino for path in seen} == seen
    for mesh, path in found.done.items():
        with told_to([]):
            Body.from_mesh(mesh).save(tmp_path / "serial.npz")
        assert path.read_bytes() == (tmp_path / "serial.npz").read_bytes()
    assert len(cluster.fit(meshes, client, made).skipped) == len(meshes)


def test_arrays_survive_a_death(workers, client, tmp_path):
    """A worker that has the checker and some chunks dies: the answers are the same."""
    checker = CollisionChecker(gantry_robot(tmp_path), wall())
    Q = checker.robot.random_configurations(400_000, seed=1)
    lazy = cluster.collide(checker, da.from_array(Q, chunks=(1000, 3)))
    for seed in range(3):
        future = client.compute(lazy)
        kill_one(workers, np.random.default_rng(seed))
        np.testing.assert_array_equal(future.result(), checker.collide(Q))


def test_the_benchmark_runs(tmp_path, capsys):
    """On a few meshes and configurations: nothing differs, nothing is lost. Nothing is said about speed."""
    sys.path.append(str(Path(__file__).parents[2] / "benchmarks"))
    import cluster as benchmark

    benchmark.fits(tmp_path, 6, 1)
    benchmark.overhead(10)
    benchmark.checkers(2000, 20)
    out = capsys.readouterr().out
    assert "6 skipped" in out
    assert "not those of the serial call: 0 of 6" in out
    assert "killed in the middle: Fitted(6 done, 0 skipped, 0 failed)" in out
