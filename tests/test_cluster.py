"""Work on several processes: nothing is lost, nothing is done twice, and each answer is that of the serial call."""

import json
import os
import pickle
import signal
import sys
import time
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
import trimesh

import loewner
from gantry import gantry_robot, wall
from loewner import Body, CollisionChecker, InputError, Verdict, cli, cluster, planners
from loewner._base import _threads
from loewner._base._plausible import told_to

distributed = pytest.importorskip("distributed")
da = pytest.importorskip("dask.array")


@pytest.fixture(scope="module")
def workers():
    """Two processes with a scheduler; workers that die are started anew."""
    with distributed.LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=":0") as started:
        yield started


@pytest.fixture
def client(workers):
    """A client of these, whose workers are all there."""
    with distributed.Client(workers, set_as_default=False) as connected:
        connected.wait_for_workers(2)
        yield connected


@pytest.fixture
def threads():
    """A client of one worker with two threads, in this process."""
    with (
        distributed.LocalCluster(n_workers=1, threads_per_worker=2, processes=False, dashboard_address=":0") as started,
        distributed.Client(started, set_as_default=False) as connected,
    ):
        yield connected


def corpus(folder: Path, count: int) -> list[Path]:
    """Meshes of different shapes, some of two parts, one of them unusually large."""
    meshes = []
    for k in range(count):
        mesh = trimesh.creation.icosphere(subdivisions=1).apply_scale([1, 1 + k / 10, 2])
        if k % 3 == 0:
            mesh = trimesh.util.concatenate([mesh, mesh.copy().apply_translation([5 if k else 5000, 0, 0])])
        meshes.append(folder / f"mesh{k:03}.stl")
        mesh.export(meshes[-1])
    return meshes


# What the serial call writes, by the content of a mesh and the options: many tests have the same meshes.
SERIAL: dict[tuple[bytes, str, str], bytes] = {}


def assert_serial(fitted: dict[Path, Path], **options) -> None:
    """Each file is that which the serial call would write, byte for byte."""
    for mesh, made in fitted.items():
        key = mesh.read_bytes(), mesh.suffix, repr(options)
        if key not in SERIAL:
            with told_to([]):
                Body.from_mesh(mesh, **options).save(made.parent / "serial.npz")
            SERIAL[key] = (made.parent / "serial.npz").read_bytes()
        assert made.read_bytes() == SERIAL[key]


def inodes(paths) -> dict[Path, int]:
    """What changes when a file is written anew."""
    return {path: path.stat().st_ino for path in paths}


def records(made: Path) -> list[Path]:
    """What is written about each body that is done; names with a dot before are files that somebody still writes."""
    return [path for path in made.glob("*.fit.json") if not path.name.startswith(".")]


# -- corpora ------------------------------------------------------------------------------------


def test_bodies_are_those_of_serial_calls(client, tmp_path):
    """Bodies are equal to the last byte; a file that is no mesh is listed; progress counts every file once."""
    meshes = corpus(tmp_path, 8)
    bad, told = tmp_path / "bad.stl", []
    bad.write_bytes(b"no mesh")
    found = cluster.fit([*meshes[:4], bad, *meshes[4:]], client, tmp_path / "made", progress=lambda *p: told.append(p))
    assert list(found.done) == meshes
    assert found.done[meshes[3]] == tmp_path / "made" / "mesh003.npz"
    assert list(found.failed) == [bad]
    with pytest.raises(loewner.FileError) as serial:
        Body.from_mesh(bad)
    assert found.failed[bad] == str(serial.value)
    assert told == [(k, 9) for k in range(1, 10)]
    assert repr(found) == "Fitted(8 done, 0 skipped, 1 failed)"
    assert not (tmp_path / "made" / "bad.npz").exists()
    assert_serial(found.done)


def test_warnings_come_back(client, tmp_path):
    """What a fit warns of on a worker is in the result, also when the body was made before."""
    meshes = corpus(tmp_path, 2)
    with pytest.warns(UserWarning, match="in millimetres") as serial:
        Body.from_mesh(meshes[0])
    for _ in range(2):
        found = cluster.fit(meshes, client, tmp_path / "made")
        assert found.warned == {meshes[0]: (str(serial[0].message),)}
    assert not found.done


def test_options_reach_the_fit(client, tmp_path):
    """Options are those of the serial call."""
    options = {"decompose": False, "tol": 1e-6, "scale": [1.0, -2.0, 0.5]}
    found = cluster.fit(corpus(tmp_path, 3), client, tmp_path / "made", **options)
    assert_serial(found.done, **options)
    assert len(Body.load(tmp_path / "made" / "mesh000.npz").pieces) == 1


def test_what_is_done_is_not_done_again(client, tmp_path):
    """A second call skips all but what is new, changed, damaged, gone, or of another version."""
    meshes, made = corpus(tmp_path, 6), tmp_path / "made"
    files = list(cluster.fit(meshes[:5], client, made).done.values())
    assert len(files) == 5
    before = inodes(files)
    trimesh.creation.box((1, 1, 1)).export(meshes[0])
    files[1].write_bytes(files[1].read_bytes()[:-1])
    (made / "mesh002.fit.json").unlink()
    record = json.loads((made / "mesh003.fit.json").read_text())
    (made / "mesh003.fit.json").write_text(json.dumps(record | {"loewner": "0.0.1"}))
    found = cluster.fit(meshes, client, made)
    assert list(found.done) == [*meshes[:4], meshes[5]]
    assert found.skipped == {meshes[4]: files[4]}
    assert inodes(files[4:]) == {files[4]: before[files[4]]}
    assert_serial(found.done)
    assert len(cluster.fit(meshes, client, made).skipped) == 6


def test_other_options_are_other_bodies(client, tmp_path):
    """With other options nothing counts as done; a failed mesh is tried again."""
    meshes = corpus(tmp_path, 2)
    assert len(cluster.fit(meshes, client, tmp_path / "made").done) == 2
    assert len(cluster.fit(meshes, client, tmp_path / "made", tol=1e-5).done) == 2
    assert len(cluster.fit(meshes, client, tmp_path / "made", tol=1e-5, max_pieces=4).done) == 2
    again = cluster.fit(meshes, client, tmp_path / "made", tol=np.float64(1e-5), max_pieces=np.int64(4))
    assert len(again.skipped) == 2


def test_an_old_record_does_not_speak_for_a_new_body(client, tmp_path):
    """A worker that dies between the body and its record leaves what no call takes for done."""
    (mesh,), made = corpus(tmp_path, 1), tmp_path / "made"
    cluster.fit([mesh], client, made)
    old = (made / "mesh000.fit.json").read_bytes()
    cluster.fit([mesh], client, made, decompose=False)
    (made / "mesh000.fit.json").write_bytes(old)
    found = cluster.fit([mesh], client, made)
    assert list(found.done) == [mesh]
    assert_serial(found.done)


def test_files_in_other_files_are_read_again(client, tmp_path):
    """A glTF file that names a buffer does not tell whether that has changed."""
    box = trimesh.creation.box((1, 1, 1))
    for name, data in box.export(file_type="gltf").items():
        (tmp_path / name).write_bytes(data)
    box.export(tmp_path / "alone.glb")
    meshes = [tmp_path / "model.gltf", tmp_path / "alone.glb"]
    assert len(cluster.fit(meshes, client, tmp_path / "made").done) == 2
    found = cluster.fit(meshes, client, tmp_path / "made")
    assert (list(found.done), list(found.skipped)) == ([meshes[0]], [meshes[1]])


def kill_one(client) -> None:
    """End a worker, as lack of memory would."""
    os.kill(next(iter(client.run(os.getpid).values())), signal.SIGKILL)


@pytest.mark.verify
def test_a_worker_that_dies_loses_nothing(client, tmp_path):
    """All bodies are there and right; none that was reported by then is made anew; none is reported twice."""
    meshes, made, seen, counts = corpus(tmp_path, 30), tmp_path / "made", {}, []

    def progress(done: int, total: int) -> None:
        counts.append((done, total))
        if done == 10:
            seen.update(inodes(records(made)))
            kill_one(client)

    found = cluster.fit(meshes, client, made, progress=progress)
    assert len(seen) >= 10
    assert inodes(seen) == seen
    assert counts == [(k, 30) for k in range(1, 31)]
    assert list(found.done) == meshes
    assert not found.failed
    assert_serial(found.done)


def until(happened) -> None:
    """Wait for something that is sure to come, at some time."""
    while not happened():
        time.sleep(0.001)


def states(client) -> dict[str, str]:
    """What has become of each task, by its key."""
    return {key: state.status for key, state in client.futures.items()}


@pytest.mark.verify
def test_results_that_are_lost_are_made_again(tmp_path):
    """All files are done, and the one worker dies with their outcomes: these are fetched from the next, none anew."""
    meshes, made, seen, counts = corpus(tmp_path, 6), tmp_path / "made", {}, []

    def progress(done: int, total: int) -> None:
        counts.append((done, total))
        if done == 1:
            until(lambda: set(states(connected).values()) == {"finished"})
            seen.update(inodes(records(made)))
            kill_one(connected)
            until(lambda: "lost" in states(connected).values())

    with (
        distributed.LocalCluster(n_workers=1, threads_per_worker=1, dashboard_address=":0") as started,
        distributed.Client(started, set_as_default=False) as connected,
    ):
        found = cluster.fit(meshes, connected, made, progress=progress)
    assert len(seen) == 6
    assert inodes(seen) == seen
    assert counts == [(k, 6) for k in range(1, 7)]
    assert list(found.done) == meshes


def cancel_all(client) -> None:
    """Cancel what is requested, as somebody else who has a client of the scheduler may."""
    client.cancel([distributed.Future(key, client) for key in client.futures], force=True)


def test_results_that_are_cancelled_are_requested_again(threads, tmp_path):
    """While the scheduler lives every file is done and told of once, also if all of them are cancelled on the way."""
    meshes, counts = corpus(tmp_path, 8), []

    def progress(done: int, total: int) -> None:
        counts.append((done, total))
        if done in (1, 5):
            cancel_all(threads)

    found = cluster.fit(meshes, threads, tmp_path / "made", progress=progress)
    assert counts == [(k, 8) for k in range(1, 9)]
    assert list(found.done) == meshes
    assert_serial(found.done)


def test_work_that_is_always_cancelled_is_an_error(threads, tmp_path, monkeypatch):
    """The call ends: requests are counted."""
    requests, ask = [], threads.map

    def cancelled(*given, **named):
        requests.append(len(given[1]))
        futures = ask(*given, **named)
        threads.cancel(futures)
        return futures

    monkeypatch.setattr(threads, "map", cancelled)
    with pytest.raises(loewner.LoewnerError, match="cancelled the work 4 times.*make the same call again"):
        cluster.fit(corpus(tmp_path, 3), threads, tmp_path / "made")
    assert requests == [3] * 4


def test_an_interrupt_leaves_what_is_done(client, tmp_path):
    """It comes through, and nobody begins another file; the next call does the rest only."""
    meshes, made, before = corpus(tmp_path, 40), tmp_path / "made", {}

    def progress(done: int, total: int) -> None:
        if done == 5:
            before.update(inodes(path.with_name(path.name.replace(".fit.json", ".npz")) for path in records(made)))
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        cluster.fit(meshes, client, made, progress=progress)
    found = cluster.fit(meshes, client, made)
    assert 5 <= len(before) <= len(found.skipped) < 40
    assert sorted([*found.done, *found.skipped]) == meshes
    assert inodes(before) == before
    assert_serial({**found.done, **found.skipped})


@pytest.mark.verify
def test_a_mesh_that_ends_workers_is_listed(workers, client, monkeypatch, tmp_path):
    """A file at which Dask has lost enough workers counts as failed."""
    monkeypatch.setattr(workers.scheduler, "allowed_failures", 0)
    lost = client.submit(os._exit, 1, pure=False)
    assert lost.exception()
    outcome = cluster._outcome(lost, tmp_path / "huge.stl")
    assert outcome.status == "failed"
    assert "huge.stl: the workers that fitted it died" in outcome.message


def test_a_scheduler_that_goes_away(tmp_path):
    """It is an error, not a wait without end; what is done stays done."""
    meshes = corpus(tmp_path, 30)
    started = distributed.LocalCluster(n_workers=1, processes=False, dashboard_address=":0")

    def progress(done: int, total: int) -> None:
        if done == 3:
            started.close()

    with (
        distributed.Client(started, set_as_default=False) as connected,
        pytest.raises(loewner.LoewnerError, match="make the same call again"),
    ):
        cluster.fit(meshes, connected, tmp_path / "made", progress=progress)
    assert len(records(tmp_path / "made")) >= 3


def test_threads_of_one_worker(threads, tmp_path, monkeypatch):
    """Two fits at once in one process use one thread each; warnings are not mixed up; the caller's setting stays."""
    used, fit = [], Body.from_mesh.__func__

    def watched(cls, mesh, **options):
        used.append(loewner.get_num_threads())
        return fit(cls, mesh, **options)

    meshes, before = corpus(tmp_path, 12), loewner.get_num_threads()
    monkeypatch.setattr(Body, "from_mesh", classmethod(watched))
    found = cluster.fit(meshes, threads, tmp_path / "made")
    monkeypatch.undo()
    assert used[1:] == [1] * 12  # the first is what tries the options
    assert loewner.get_num_threads() == before
    assert list(found.warned) == meshes[:1]
    assert_serial(found.done)


def test_at_most():
    """The number of threads is that of before when the block ends, also by an error; none becomes more."""
    before = _threads._setting.count
    loewner.set_num_threads(3)
    try:
        with _threads.at_most(8):
            assert loewner.get_num_threads() == 3
        with suppress(ZeroDivisionError), _threads.at_most(2):
            assert loewner.get_num_threads() == 2
            _ = 1 / 0
        assert loewner.get_num_threads() == 3
    finally:
        _threads._setting.count = before


# -- names --------------------------------------------------------------------------------------


def test_equal_names_are_refused_or_kept_apart(client, tmp_path):
    """Of two meshes with one name, neither is lost: refused before anything is done, or in folders of their own."""
    meshes = []
    for place in ("left", "right"):
        (tmp_path / place).mkdir()
        meshes += [tmp_path / place / "part.stl"]
        trimesh.creation.box((1, 1, len(place))).export(meshes[-1])
    with pytest.raises(InputError, match=r"left/part.stl and .*right/part.stl, both for .*part.npz; root="):
        cluster.fit(meshes, client, tmp_path / "made")
    assert not (tmp_path / "made").exists()
    found = cluster.fit([*meshes, *meshes], client, tmp_path / "made", root=tmp_path)
    assert list(found.done.values()) == [tmp_path / "made" / place / "part.npz" for place in ("left", "right")]
    assert_serial(found.done)


def test_a_mesh_outside_the_root_is_refused(client, tmp_path):
    """Else its body would be outside of the output folder."""
    with pytest.raises(InputError, match="expected meshes below root"):
        cluster.fit([tmp_path / "a" / ".." / "part.stl"], client, tmp_path / "made", root=tmp_path / "a")


def test_relative_paths_are_those_of_the_caller(client, tmp_path, monkeypatch):
    """Workers are in another folder."""
    corpus(tmp_path, 1)
    monkeypatch.chdir(tmp_path)
    Path("bad.stl").write_bytes(b"no mesh")
    found = cluster.fit(["mesh000.stl", "bad.stl"], client, "made")
    assert found.done == {Path("mesh000.stl"): Path("made/mesh000.npz")}
    assert (tmp_path / "made" / "mesh000.npz").exists()
    with pytest.raises(loewner.FileError) as serial:
        Body.from_mesh("bad.stl")
    assert found.failed == {Path("bad.stl"): str(serial.value)}
    with pytest.warns(UserWarning, match=r"^mesh000.stl: .* in millimetres") as warned:
        Body.from_mesh("mesh000.stl")
    assert found.warned == {Path("mesh000.stl"): (str(warned[0].message),)}


# -- bad input ----------------------------------------------------------------------------------


def test_who_is_no_client(client, tmp_path, monkeypatch):
    """Each is told what was expected, and what to do."""
    monkeypatch.setattr(cluster, "PATIENCE", 0.2)
    for bad, told in (
        (None, "expected a distributed.Client or the address of a scheduler, found None"),
        ("tcp://127.0.0.1:1", "Timed out.*start one by `dask scheduler`"),
        ("nonsense://x", "unknown address scheme.*start one by `dask scheduler`"),
        ("localhost", "missing port.*start one by `dask scheduler`"),
    ):
        with pytest.raises(InputError, match=told):
            cluster.fit([], bad, tmp_path / "made")
    client.close()
    with pytest.raises(InputError, match="found one that is closed"):
        cluster.fit([], client, tmp_path / "made")
    assert not (tmp_path / "made").exists()


@pytest.mark.parametrize(
    "options",
    [{"threshold": 5}, {"tol": -1}, {"scale": 0}, {"scale": [1, 2]}, {"max_pieces": 0}, {"seed": -1}, {"tolerance": 0},
     {"decompose": "yes"}, {"cover": 2}, {"progress": 3}],
)  # fmt: skip
def test_bad_options_are_refused_at_once(client, tmp_path, options):
    """Not once for each mesh, and before anything is done."""
    with pytest.raises(InputError, match=next(iter(options))):
        cluster.fit([tmp_path / "none.stl"], client, tmp_path / "made", **options)
    assert not (tmp_path / "made").exists()


def test_no_folder_can_be_made(client, tmp_path):
    """Where a file is, no folder can be."""
    (tmp_path / "made").write_text("")
    with pytest.raises(loewner.FileError, match="expected a folder"):
        cluster.fit([tmp_path / "none.stl"], client, tmp_path / "made")


def test_without_dask(tmp_path, monkeypatch):
    """The module can be imported; its functions name what to install."""
    checker = gantry_checker(tmp_path)
    monkeypatch.setitem(sys.modules, "distributed", None)
    monkeypatch.setitem(sys.modules, "dask", None)
    told = pytest.raises(loewner.MissingExtraError, match=r'Dask: pip install "loewner\[cluster\]"')
    with told:
        cluster.fit([], None, tmp_path)
    for ask in (cluster.collide, cluster.distance):
        with told:
            ask(checker, None)
    with told:
        cluster.certify_edges(checker, None, None)


# -- checkers on arrays -------------------------------------------------------------------------


def gantry_checker(folder: Path) -> CollisionChecker:
    """A small robot before a wall."""
    return CollisionChecker(gantry_robot(folder), wall())


@pytest.mark.parametrize("chunks", [(7, 3), (50, 1), (120, 2), pytest.param((1, 3), marks=pytest.mark.verify)])
def test_arrays_are_answered_as_by_the_checker(client, checker, chunks):
    """Whatever the chunks, of configurations and of their entries: collisions and distances equal the checker's."""
    Q = checker.robot.random_configurations(120, seed=1)
    lazy = da.from_array(Q, chunks=chunks)
    hit, far = cluster.collide(checker, lazy), cluster.distance(checker, lazy)
    assert (hit.shape, hit.dtype, far.dtype) == ((120,), bool, float)
    assert hit.chunks == far.chunks == lazy.chunks[:1]
    hit, far = client.compute([hit, far], sync=True)
    np.testing.assert_array_equal(hit, checker.collide(Q))
    np.testing.assert_array_equal(far, checker.distance(Q, exact=True).distance)
    assert 0 < hit.sum() < 120


@pytest.mark.parametrize("shape", [(), (4, 6), (0,), (2, 0), (1, 2, 3)])
def test_shapes(checker, shape):
    """Any batch shape, none and empty ones among them."""
    Q = np.zeros((*shape, 3)) + np.random.default_rng(0).uniform(-1, 1, (*shape, 3))
    found = cluster.collide(checker, da.from_array(Q, chunks=2))
    assert found.shape == shape
    found = found.compute(scheduler="synchronous")
    np.testing.assert_array_equal(found, checker.collide(Q))
    assert np.shape(found) == shape


def test_results_go_on_into_other_work(client, checker):
    """What comes of configurations made by Dask needs no array in this process."""
    Q = da.random.default_rng(0).uniform(-1, 1, (1000, 3), chunks=(100, 3))
    assert client.compute(cluster.collide(checker, Q).mean(), sync=True) == checker.collide(Q.compute()).mean()


def test_motions_are_proven_as_by_the_checker(client, checker):
    """The edges of a roadmap: each verdict is the checker's, whatever the chunks of the second ends."""
    made = planners.roadmap(checker, 40, joints=["x", "y"], seed=2)
    Q0, Q1 = made.nodes[:20], made.nodes[[-b for b in range(1, 21)]]
    lazy = cluster.certify_edges(checker, da.from_array(Q0, chunks=(6, 3)), da.from_array(Q1, chunks=(20, 1)))
    found = client.compute(lazy, sync=True)
    expected = checker.certify_edges(Q0, Q1).verdict
    np.testing.assert_array_equal(found, expected)
    assert set(found) >= {Verdict.FREE, Verdict.COLLIDING}
    a, b = (da.from_array(made.nodes[ends], chunks=(50, 3)) for ends in made.edges.T)
    assert (client.compute(cluster.certify_edges(checker, a, b), sync=True) == Verdict.FREE).all()


def test_the_tolerance_of_motions_is_kept(checker):
    """With a coarse one more motions are left open than with the usual one, and the same as by the checker."""
    Q0, Q1 = (checker.robot.random_configurations(300, seed=seed) for seed in (4, 5))
    a, b = (da.from_array(Q, chunks=100) for Q in (Q0, Q1))
    coarse = cluster.certify_edges(checker, a, b, tolerance=0.1).compute(scheduler="synchronous")
    np.testing.assert_array_equal(coarse, checker.certify_edges(Q0, Q1, tolerance=0.1).verdict)
    assert (coarse != checker.certify_edges(Q0, Q1).verdict).any()


def test_the_scene_is_that_of_the_call(checker):
    """What changes before the result is computed does not change it: workers could not see it either."""
    Q = np.array([[0.0, -0.5, 1.5]])
    hit = cluster.collide(checker, da.from_array(Q))
    checker.scene.remove("wall")
    assert hit.compute(scheduler="synchronous")[0]
    assert not cluster.collide(checker, da.from_array(Q)).compute(scheduler="synchronous")[0]


def test_a_checker_is_unpacked_once_by_each_worker(client, checker, tmp_path):
    """Not once for each chunk: a task of its own has it, of which each worker gets a copy."""
    Q = da.from_array(checker.robot.random_configurations(400, seed=3), chunks=(10, 3))
    hit = cluster.collide(checker, Q)
    graph = dict(hit.__dask_graph__())
    size = len(pickle.dumps(checker, protocol=pickle.HIGHEST_PROTOCOL))
    sizes = [len(pickle.dumps(task)) for task in graph.values()]
    assert sum(each >= size for each in sizes) == 1  # of the 40 tasks and the configurations
    np.testing.assert_array_equal(client.compute(hit, sync=True), checker.collide(Q.compute()))


def test_a_task_uses_one_thread(checker, monkeypatch):
    """Dask has as many tasks at a time as there are threads; the setting of who computes is as before."""
    used, ask = [], CollisionChecker.collide

    def watched(self, Q):
        used.append(loewner.get_num_threads())
        return ask(self, Q)

    monkeypatch.setattr(CollisionChecker, "collide", watched)
    before = loewner.get_num_threads()
    Q = da.from_array(checker.robot.random_configurations(40, seed=3), chunks=(10, 3))
    for scheduler in ("synchronous", "threads"):
        cluster.collide(checker, Q).compute(scheduler=scheduler)
    assert used == [1] * 8
    assert loewner.get_num_threads() == before


def test_bad_arrays(checker):
    """Refused at once where the array tells, else when it is computed, with the checker's own error."""
    good = da.zeros((4, 3), chunks=2)
    for bad, told in (
        (np.zeros((4, 3)), r"expected a dask\.array\.Array.*from_array makes one"),
        (None, "found None"),
        (da.zeros((4, 2)), r"expected shape \(\.\.\., 3\), .*found \(4, 2\)"),
        (da.zeros(()), "found "),
        (da.zeros((4, 3), dtype=complex), "expected real numbers, found dtype complex128"),
        (da.zeros((4, 3), dtype=bool), "expected real numbers"),
    ):
        for ask in (cluster.collide, cluster.distance):
            with pytest.raises(InputError, match=f"(?s)Q: .*{told}"):
                ask(checker, bad)
        with pytest.raises(InputError, match="Q1: "):
            cluster.certify_edges(checker, good, bad)
    with pytest.raises(InputError, match="checker: expected loewner.CollisionChecker"):
        cluster.collide(checker.robot, good)
    with pytest.raises(InputError, match="of one shape"):
        cluster.certify_edges(checker, good, da.zeros((5, 3)))
    with pytest.raises(InputError, match="tolerance"):
        cluster.certify_edges(checker, good, good, tolerance=0)
    with pytest.raises(InputError, match="expected finite numbers"):
        cluster.collide(checker, da.full((4, 3), np.nan)).compute(scheduler="synchronous")


# -- the command line ---------------------------------------------------------------------------


def run(capsys, *arguments) -> tuple[int, str, str]:
    """Exit status, standard output and standard error of a command."""
    status = cli.main([str(a) for a in arguments])
    captured = capsys.readouterr()
    return status, captured.out, captured.err


def test_fit_on_a_scheduler(workers, client, tmp_path, monkeypatch, capsys):
    """Counts, warnings as lines, and a table of what failed, with status 2; options reach the fit; again, it skips."""
    meshes = corpus(tmp_path, 3)
    monkeypatch.chdir(tmp_path)
    Path("odd[red].stl").write_bytes(b"no mesh")
    ask = ("fit", *(mesh.name for mesh in meshes), "-o", "made", "--hull", "--scheduler", workers.scheduler_address)
    status, out, err = run(capsys, *ask)
    assert (status, out) == (0, "3 done, 0 done before, 0 failed\n")
    assert err.startswith("loewner: warning: ")
    assert "millimetres" in err
    assert len(Body.load("made/mesh000.npz").pieces) == 1
    status, out, _ = run(capsys, "fit", "odd[red].stl", *ask[1:])
    assert status == 2
    assert out.startswith("0 done, 3 done before, 1 failed\n")
    assert "odd[red].stl" in out
    assert "expected an STL mesh" in out


def test_fit_on_a_scheduler_refuses(workers, tmp_path, monkeypatch, capsys):
    """A surface, which takes no fit, and an address without a scheduler: one line, with status 2."""
    monkeypatch.setattr(cluster, "PATIENCE", 0.2)
    monkeypatch.chdir(tmp_path)
    surface = run(capsys, "fit", "a.stl", "-o", "out", "--model", "surface", "--scheduler", workers.scheduler_address)
    nobody = run(capsys, "fit", "a.stl", "-o", "out", "--scheduler", "tcp://127.0.0.1:1")
    for (status, out, err), told in ((surface, "--model surface"), (nobody, "dask scheduler")):
        assert (status, out, err.count("\n")) == (2, "", 1)
        assert told in err
    assert not Path("out").exists()
