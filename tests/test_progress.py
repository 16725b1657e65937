"""What long calls tell of how far they are: a share that never falls, and all of it in the end."""

from collections import defaultdict
from fractions import Fraction
from itertools import pairwise

import numpy as np
import pytest
import trimesh

import border_calls
import loewner
from gantry import GANTRY
from loewner import cluster, paper
from loewner.cli import compilation
from loewner.meshes import decomposition as meshes

RNG = np.random.default_rng(5)


def several():
    """Parts that are cut: two that are closed, apart from each other, and one more that is convex."""
    parts = [
        trimesh.creation.annulus(0.5, 1.0, 0.4, sections=12),
        trimesh.creation.annulus(0.2, 0.9, 0.3, sections=8),
        trimesh.creation.box(),
    ]
    return trimesh.util.concatenate([part.apply_translation([3.0 * k, 0, 0]) for k, part in enumerate(parts)])


def with_a_hole():
    mesh = trimesh.creation.box((2.0, 2.0, 2.0))
    return trimesh.Trimesh(mesh.vertices, mesh.faces[2:])


def compiled(progress):
    """The groups of parts as they are, with processes that tell a part at a time and then end."""

    def answers(entry, tasks, jobs):
        for place, task in enumerate(tasks):
            for number in range(len(task["parts"])):
                yield compilation.jobs.Event("progress", place, [number + 1, len(task["parts"])])
            yield compilation.jobs.Event("answer", place, "")

    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(compilation.jobs, "answers", answers)
        patched.setattr(compilation.library, "level", lambda: None)
        patched.setattr(compilation.entries, "expect_numba", lambda: None)
        compilation.compile_kernels(progress=progress)


def fitted_by_a_cluster(progress):
    distributed = pytest.importorskip("distributed")
    paths = [f"part{k}.stl" for k in range(5)]
    for path in paths:
        trimesh.creation.box((1, 1, 1)).export(path)
    with (
        distributed.LocalCluster(n_workers=1, processes=False, dashboard_address=":0") as workers,
        distributed.Client(workers) as client,
    ):
        cluster.fit([*paths, "none.stl"], client, "made", progress=progress)


POINTS, A = RNG.normal(size=(3000, 20)), RNG.normal(size=(2000, 20))
SETS = RNG.normal(size=(300, 30, 3))

# All public calls that take `progress`, by the names that the reference has for them, each in several ways.
WATCHED = {
    "mvce": [
        lambda progress: loewner.mvce(POINTS, progress=progress),
        lambda progress: loewner.mvce(POINTS, center=np.zeros(20), weights=True, progress=progress),
        lambda progress: loewner.mvce(POINTS[:, :3], tol=1e-9, progress=progress),
    ],
    "mvie": [
        lambda progress: loewner.mvie(A, np.ones(len(A)), progress=progress),
        lambda progress: loewner.mvie(A, np.ones(len(A)), center=np.zeros(20), progress=progress),
        lambda progress: loewner.mvie(POINTS[:100, :3], progress=progress),
    ],
    "Body.from_mesh": [
        lambda progress: loewner.Body.from_mesh(several(), tolerance=0.2, progress=progress),
        lambda progress: loewner.Body.from_mesh(several(), threshold=0.5, progress=progress),
        lambda progress: loewner.Body.from_mesh(several(), tolerance=0.2, max_pieces=2, progress=progress),
        lambda progress: loewner.Body.from_mesh(several(), decompose=False, progress=progress),
    ],
    "meshes.convex_pieces": [
        lambda progress: meshes.convex_pieces(with_a_hole(), progress=progress),
    ],
    "Bodies.from_points": [lambda progress: loewner.Bodies.from_points(SETS, progress=progress)],
    "Robot.swept": [
        lambda progress: loewner.Robot.from_urdf(text=GANTRY).swept([[0.0] * 3, [0.3] * 3], progress=progress)
    ],
    "Body.cover": [lambda progress: loewner.Body.box([3, 2, 1]).cover("boxes", n=2, progress=progress)],
    "Body.covered_by": [
        lambda progress: loewner.Body.box([3, 2, 1]).covered_by(loewner.Body.sphere(1.9), progress=progress)
    ],
    "Robot.from_urdf": [lambda progress: loewner.Robot.from_urdf(text=GANTRY, progress=progress)],
    "Robot.prove_pairs": [lambda progress: loewner.Robot.from_urdf(text=GANTRY).prove_pairs(progress=progress)],
    "Robot.cover": [
        lambda progress: loewner.Robot.from_urdf(text=GANTRY).cover("boxes", protrusion=0.1, progress=progress),
        lambda progress: loewner.Robot.from_urdf(text=GANTRY).cover("boxes", n=4, progress=progress),
    ],
    "Robot.covered_by": [
        lambda progress: loewner.Robot.from_urdf(text=GANTRY).covered_by(
            loewner.Robot.from_urdf(text=GANTRY), progress=progress
        ),
    ],
    "compile_kernels": [compiled],
    "paper.run": [lambda progress: paper.run(30, progress=progress)],
    "cluster.fit": [fitted_by_a_cluster],
}


def test_all_that_take_progress_are_watched():
    """A public callable that comes to take `progress` has to be among those below."""
    assert set(WATCHED) == {name for name, parameters in border_calls.public_callables() if "progress" in parameters}


@pytest.mark.filterwarnings("ignore:.*(has holes|stick out):UserWarning")
@pytest.mark.parametrize(
    "call",
    [
        pytest.param(call, id=f"{name} {k}", marks=[pytest.mark.verify] * ((name, k) == ("Robot.cover", 1)))
        for name, calls in WATCHED.items()
        for k, call in enumerate(calls)
    ],
)
def test_the_share_that_is_told_never_falls(call, tmp_path, monkeypatch):
    """Of a stage, where there are several: the share of what is done grows or stays, from 0 on, and ends with all."""
    monkeypatch.chdir(tmp_path)
    told = defaultdict(list)
    call(lambda *step: told[step[:-2]].append(step[-2:]))
    for steps in told.values():
        shares = [Fraction(done, total) for done, total in steps]
        assert shares[0] >= 0
        assert shares[-1] == 1
        assert all(share <= later for share, later in pairwise(shares)), steps
    assert told
