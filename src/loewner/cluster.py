"""Use Dask to fit many meshes, and to run checkers on large arrays, in several processes or on several machines.

Install Dask with ``pip install "loewner[cluster]"``; it is imported only when a function here is called.

Each task uses one thread, and a worker runs as many tasks at a time as it has threads. Outside Dask, a call uses all
processors; if tasks did the same, they would compete with one another.
"""

from __future__ import annotations

import hashlib
import json
import os
import pickle
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from loewner._base import _json, _validate
from loewner._base._archives import LARGEST_CONTENT
from loewner._base._files import made_folder, read_regular, shown, write_atomically
from loewner._base._guard import guarded
from loewner._base._outcomes import TETRAHEDRON, Outcome, outcome_of
from loewner._base._plausible import told_to
from loewner._base._threads import at_most
from loewner._base._validate import Bools, Floats, Progress
from loewner.bodies import Body
from loewner.errors import FileError, GeometryError, InputError, LoewnerError, imported
from loewner.meshes import files as mesh_files
from loewner.robots import CollisionChecker, Robot
from loewner.robots.description.robot import expect_width

__all__ = ["Fitted", "certify_edges", "collide", "distance", "fit"]

# Longest time for a scheduler's answer [s].
PATIENCE = 10

# Number of files sent to the scheduler in one message.
AT_A_TIME = 4096

# If the work is cancelled while the scheduler runs, it is requested again, up to this many times in all.
ATTEMPTS = 4

# Largest size of a record [bytes]. A record takes a few hundred bytes, including a name of at most 255 letters.
LARGEST_RECORD = 2**16

# Files with these endings may refer to other files for their meshes; their own bytes then do not identify the mesh.
LINKING = (".gltf", ".glb")

# Functions that convert options to plain values for a record.
PLAIN: dict[str, Callable[[Any], Any]] = {
    "decompose": bool, "tol": float, "scale": lambda scale: np.asarray(scale, dtype=np.float64).tolist(), "cover": bool,
    "tolerance": float, "threshold": float, "max_pieces": int, "seed": int,
}  # fmt: skip

HOW_TO_START = "start one by `dask scheduler`, and its workers by `dask worker ADDRESS --nworkers auto`"


# -- corpora of meshes ----------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Fitted:
    """The outcome for each mesh in a call to `fit`; each dict is in the order of the call's `paths`.

    Attributes
    ----------
    done : dict of Path to Path
        For each mesh whose body this call made: the file of the body.
    skipped : dict of Path to Path
        For each mesh whose body already existed and had been made from the same mesh file with the same options: the
        file of the body.
    failed : dict of Path to str
        For each remaining mesh: the reason for the failure.
    warned : dict of Path to tuple of str
        For each mesh that was fitted with warnings, now or earlier: the warnings of `Body.from_mesh`, for instance
        about holes or an unusual size.

    Examples
    --------
    >>> from pathlib import Path
    >>> Fitted({Path("a.stl"): Path("a.npz")}, {}, {Path("b.stl"): "b.stl: there is no such file"}, {})
    Fitted(1 done, 0 skipped, 1 failed)
    """

    done: Mapping[Path, Path]
    skipped: Mapping[Path, Path]
    failed: Mapping[Path, str]
    warned: Mapping[Path, tuple[str, ...]]

    def __repr__(self) -> str:
        return f"Fitted({len(self.done)} done, {len(self.skipped)} skipped, {len(self.failed)} failed)"


@guarded
def fit(
    paths: Iterable[str | os.PathLike[str]],
    client: Any,
    out: str | os.PathLike[str],
    *,
    root: str | os.PathLike[str] | None = None,
    decompose: bool = True,
    tol: float = 1e-4,
    scale: ArrayLike = 1.0,
    cover: bool = True,
    tolerance: float | None = None,
    threshold: float = 0.05,
    max_pieces: int | None = None,
    seed: int = 0,
    progress: Progress | None = None,
) -> Fitted:
    """Fit many mesh files as `Body.from_mesh` does, on the workers of a cluster, and save the bodies.

    Parameters
    ----------
    paths : iterable of path
        Mesh files. The workers read the meshes and write the bodies under the same paths as the caller, so several
        machines need shared folders. Duplicate paths count once.
    client : distributed.Client or str
        Client of the cluster, or the address of its scheduler.
    out : path
        Folder for the bodies; it is created if it does not exist. The body of ``part.stl`` is ``part.npz``. The file
        ``part.fit.json`` next to it records the mesh and the options.
    root : path, optional
        A folder that contains all meshes. With `root`, the body of ``root/a/part.stl`` is ``out/a/part.npz``. By
        default, all bodies are written to `out` itself.
    decompose, tol, scale, cover, tolerance, threshold, max_pieces, seed
        As for `Body.from_mesh`; `tolerance` is in metres.
    progress : callable, optional
        Called as ``progress(done, total)`` after each file.

    Returns
    -------
    Fitted
        The outcomes. A file that cannot be fitted is listed as failed; it causes no error.

    Raises
    ------
    InputError
        If an option has the wrong type or value; if two meshes would have the same body file, or a mesh is not in
        `root`; or if `client` is not a Dask client, is closed, or is an address at which no scheduler answers.
    FileError
        If the folder cannot be created.
    MissingExtraError
        If Dask is not installed.
    LoewnerError
        If the scheduler is lost, or the work is cancelled repeatedly. A later call skips finished files.

    See Also
    --------
    loewner.Body.from_mesh : Fit one mesh.

    Notes
    -----
    Each body equals the body that `Body.from_mesh` makes. A body is written under a temporary name, and the file is
    then renamed.

    A mesh is skipped under three conditions: its body and its record exist; the body has not changed since it was
    written; and the record has the checksum of the mesh file, the same options and the same version of loewner. If a
    call was interrupted, or its workers died, repeating the call therefore continues where it stopped. A glTF file that
    refers to other files is always fitted again.

    If a worker dies, Dask gives its files to the remaining workers, including finished files whose outcome was lost
    with the worker. If four workers die while fitting the same file, the file counts as failed, since it may need more
    memory than the workers have. While there are no workers, the call waits for a worker.

    Tasks may be cancelled, for instance because a connection breaks or the scheduler is restarted. Cancelled tasks are
    requested again, up to four times in all. After an interrupt, files in progress are finished, and no further file is
    started.

    Examples
    --------
    >>> import trimesh
    >>> from distributed import Client, LocalCluster
    >>> from loewner import Body, cluster
    >>> for k in range(3):
    ...     _ = trimesh.creation.box((0.1, 0.2, 0.1 + 0.1 * k)).export(f"box{k}.stl")
    >>> meshes = [f"box{k}.stl" for k in range(3)]
    >>> with LocalCluster(n_workers=1, processes=False, dashboard_address=":0") as workers, Client(workers) as client:
    ...     cluster.fit(meshes, client, "bodies")
    ...     cluster.fit([*meshes, "none.stl"], client, "bodies")
    Fitted(3 done, 0 skipped, 0 failed)
    Fitted(0 done, 3 skipped, 1 failed)
    >>> Body.load("bodies/box2.npz")
    Body(polytope, 8 vertices)
    """
    options = _checked_options({
        "decompose": decompose, "tol": tol, "scale": scale, "cover": cover, "tolerance": tolerance,
        "threshold": threshold, "max_pieces": max_pieces, "seed": seed,
    })  # fmt: skip
    targets = _targets(paths, _validate.path(out, "out", wanted="a folder"), root)
    report = _validate.reporter(progress)
    with _connected(client) as connected:
        for folder in dict.fromkeys(target.parent for target in targets.values()):
            made_folder(folder)
        outcomes = _outcomes(connected, targets, options, report)
    return _told(targets, outcomes)


def _checked_options(options: dict[str, Any]) -> dict[str, Any]:
    """Check options of `Body.from_mesh`, and convert them to plain numbers for a record.

    Raises
    ------
    InputError
        If `Body.from_mesh` would refuse an option. The options are tried on a tiny body, so that a bad option is
        reported once, not for each file.
    """
    with told_to([]), suppress(GeometryError):  # the scale may suit the meshes, but not the tiny body
        Body.from_mesh(TETRAHEDRON, **options)
    return {name: None if value is None else PLAIN[name](value) for name, value in options.items()}


def _targets(paths: Any, out: Path, root: Any) -> dict[Path, Path]:
    """Determine the file for the body of each mesh.

    Raises
    ------
    InputError
        If two bodies would have the same file, or a mesh is not below the root.
    """
    meshes = [_validate.path(path, "paths") for path in _validate.listed(paths, "paths", wanted="paths of files")]
    base = None if root is None else _absolute(_validate.path(root, "root", wanted="a folder"))
    owners: dict[Path, Path] = {}
    for mesh in dict.fromkeys(meshes):
        target = out / _below(mesh, base).with_suffix(".npz")
        if target in owners:
            raise InputError(
                f"paths: expected meshes whose bodies have different names, found {shown(owners[target])} and "
                f"{shown(mesh)}, both for {shown(target)}; root= keeps folders apart"
            )
        owners[target] = mesh
    return {mesh: target for target, mesh in owners.items()}


def _below(mesh: Path, root: Path | None) -> Path:
    """Return the path of a mesh relative to the root."""
    if not mesh.name:
        raise InputError(f"paths: expected paths of files, found {shown(mesh)!r}")
    if root is None:
        return Path(mesh.name)
    try:
        return _absolute(mesh).relative_to(root)
    except ValueError:
        raise InputError(f"paths: expected meshes below root, {shown(root)}, found {shown(mesh)}") from None


def _absolute(path: Path) -> Path:
    """Make a path absolute, so that it is valid in a process with another working directory."""
    return Path(os.path.abspath(path))


# -- workers --------------------------------------------------------------------------------------


def _fit_one(mesh: str, target: str, options: dict[str, Any], run: str) -> Outcome:
    """Make the body of a mesh unless it exists; this is a worker's task, which returns errors about the file."""
    with at_most(1):
        return outcome_of(Path(mesh), lambda: _body_of(Path(mesh), Path(target), options, run))


def _body_of(mesh: Path, target: Path, options: dict[str, Any], run: str) -> Outcome:
    from loewner import __version__

    data = read_regular(mesh, "a mesh file", mesh_files.LIMIT)
    wanted = {"loewner": __version__, "mesh_sha256": _checksum(data), "options": options}
    alone = mesh.suffix.lower() not in LINKING or not (b"uri" in data or rb"\u" in data)
    del data
    record = _record(target)
    if record is not None and (alone or record.get("run") == run) and wanted.items() <= record.items():
        # Another worker may have made the body during this call, and have died before it could report the outcome.
        status = "done" if record.get("run") == run else "skipped"
        return Outcome(status, warnings=tuple(map(str, record.get("warnings", ()))))
    warnings: list[str] = []
    with told_to(warnings):
        body = Body.from_mesh(mesh, **options)
    # If a worker dies here, the old record has the checksum of the old body, so it does not match the new body.
    body.save(target)
    entry = {**wanted, "mesh": str(mesh), "warnings": warnings, "run": run, "body_sha256": _checksum_of_body(target)}
    write_atomically(_record_path(target), json.dumps(entry, indent=1).encode())
    return Outcome("done", warnings=tuple(warnings))


def _record(target: Path) -> dict[str, Any] | None:
    """Read the record next to a body; None if it does not exist or belongs to a different body."""
    with suppress(FileError, ValueError, RecursionError):  # missing or damaged
        record = _json.parsed(read_regular(_record_path(target), "a record", LARGEST_RECORD), "the record")
        if isinstance(record, dict) and record.get("body_sha256") == _checksum_of_body(target):
            return record
    return None


def _record_path(target: Path) -> Path:
    return target.with_suffix(".fit.json")


def _checksum_of_body(path: Path) -> str:
    return _checksum(read_regular(path, "a body", LARGEST_CONTENT))


def _checksum(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()


# -- client ---------------------------------------------------------------------------------------


def _outcomes(
    client: Any, targets: Mapping[Path, Path], options: dict[str, Any], progress: Progress
) -> dict[Path, Outcome]:
    """Let the workers make all bodies, and wait for the outcomes; cancelled work is requested again.

    Raises
    ------
    LoewnerError
        If the scheduler is lost, or the work was cancelled each time it was requested.
    """
    outcomes: dict[Path, Outcome] = {}
    run = os.urandom(8).hex()

    def report(mesh: Path, outcome: Outcome) -> None:
        outcomes[mesh] = outcome
        progress(len(outcomes), len(targets))

    for _ in range(ATTEMPTS):
        left = {mesh: target for mesh, target in targets.items() if mesh not in outcomes}
        _request(client, left, options, run, report)
        if len(outcomes) == len(targets):
            return outcomes
        if not _reconnected(client):
            break
    raise LoewnerError(
        "expected a scheduler that runs until the work is done, found that the scheduler was lost, or that another "
        f"client cancelled the work {ATTEMPTS} times; finished bodies are kept: make the same call again"
    )


def _request(
    client: Any,
    targets: Mapping[Path, Path],
    options: dict[str, Any],
    run: str,
    report: Callable[[Path, Outcome], None],
) -> None:
    """Request bodies of meshes, and report all outcomes but cancellations; if the wait ends early, cancel the work."""
    meshes, bodies = ([str(_absolute(path)) for path in some] for some in (targets, targets.values()))
    futures = client.map(_fit_one, meshes, bodies, options=options, run=run, pure=False, batch_size=AT_A_TIME)
    # A worker keeps an outcome as long as a reference to the outcome exists. If the worker dies, the outcome is
    # computed again.
    waiting = dict(zip(futures, targets, strict=True))
    del futures
    try:
        for future in _dask("distributed").as_completed(waiting, loop=client.loop):
            mesh = waiting.pop(future)
            outcome = _outcome(future, mesh)
            future.release()
            if outcome is not None:
                report(mesh, outcome)
    except BaseException:
        with suppress(Exception):  # the scheduler itself may be lost
            client.cancel(list(waiting))
        raise


def _outcome(future: Any, mesh: Path) -> Outcome | None:
    """Return a worker's result or error; None if the work was cancelled or the scheduler cannot be reached."""
    try:
        outcome: Outcome = future.result()  # if the worker has died, this waits until the outcome is computed again
    except _dask("distributed").KilledWorker:
        return Outcome(
            "failed", f"{shown(mesh)}: the workers that fitted it died, one after another; it may need too much memory"
        )
    except Exception as error:
        if future.status != "error" and (future.status == "cancelled" or isinstance(error, OSError)):
            return None
        return Outcome("failed", f"{shown(mesh)}: {type(error).__name__}: {error}")
    return outcome._replace(
        message=_as_called(outcome.message, mesh), warnings=tuple(_as_called(text, mesh) for text in outcome.warnings)
    )


def _reconnected(client: Any) -> bool:
    """Wait until a client that lost its scheduler has reconnected or given up; return whether it is connected."""
    while client.status == "connecting":
        time.sleep(0.05)
    return bool(client.status == "running")


def _as_called(text: str, mesh: Path) -> str:
    """Replace the name of a file in a worker's message with the caller's name."""
    there = f"{shown(_absolute(mesh))}: "
    return f"{shown(mesh)}: {text.removeprefix(there)}" if text.startswith(there) else text


def _told(targets: Mapping[Path, Path], outcomes: Mapping[Path, Outcome]) -> Fitted:
    """Collect all outcomes, in the order of the meshes."""

    def those(status: str) -> dict[Path, Path]:
        return {mesh: target for mesh, target in targets.items() if outcomes[mesh].status == status}

    return Fitted(
        done=those("done"),
        skipped=those("skipped"),
        failed={mesh: outcomes[mesh].message for mesh in those("failed")},
        warned={mesh: outcomes[mesh].warnings for mesh in targets if outcomes[mesh].warnings},
    )


@contextmanager
def _connected(client: Any) -> Iterator[Any]:
    """Provide a connected client; if it was made for an address, close it at the end.

    Raises
    ------
    InputError
        If the argument is neither an open client nor the address of a scheduler.
    """
    distributed = _dask("distributed")
    if isinstance(client, str):
        try:
            distributed.comm.resolve_address(client)  # a bad address would leave a half-initialised client
            new_client = distributed.Client(client, timeout=PATIENCE, set_as_default=False)
        except Exception as error:  # any error of a protocol, usually ValueError or OSError
            raise InputError(
                f"client: expected the address of a Dask scheduler, as tcp://host:8786, found "
                f"{_validate.short(client)} ({error}); {HOW_TO_START}"
            ) from None
        with new_client:
            yield new_client
        return
    if not isinstance(client, distributed.Client):
        raise InputError(
            f"client: expected a distributed.Client or the address of a scheduler, found {_validate.short(client)}; "
            "distributed.Client(address) makes one"
        )
    if client.asynchronous:
        raise InputError("client: expected a synchronous client, found one made with asynchronous=True")
    if client.status != "running":
        raise InputError(f"client: expected a client that is connected, found one that is {client.status}")
    yield client


# -- checkers on arrays ---------------------------------------------------------------------------


def collide(checker: CollisionChecker, Q: Any) -> Any:
    """Decide exactly which configurations of a Dask array are in collision; see `CollisionChecker.collide`.

    Parameters
    ----------
    checker : CollisionChecker
        The checker, with its robot and scene in their current state; later changes have no effect.
    Q : dask.array.Array, shape (..., dof)
        Configurations, in chunks of any shape. About ten thousand configurations per chunk are suitable.

    Returns
    -------
    dask.array.Array of bool, shape (...)
        A lazy array with the chunks of `Q`; each chunk is one task.

    Raises
    ------
    InputError
        If `checker` is not a checker, or if `Q` is not a Dask array, does not have width dof, or does not contain real
        numbers. Computing the result raises the errors of `CollisionChecker.collide`.
    MissingExtraError
        If Dask is not installed.

    Notes
    -----
    The checker is the result of a separate task: each worker receives and prepares it once per computation. Each task
    uses one thread, with any of Dask's schedulers.

    Examples
    --------
    >>> import dask.array as da
    >>> from loewner import CollisionChecker, Robot, cluster
    >>> robot = Robot.from_urdf("arm.urdf")
    >>> checker = CollisionChecker(robot)
    >>> Q = da.from_array(robot.random_configurations(1000), chunks=(250, -1))
    >>> hit = cluster.collide(checker, Q)
    >>> hit.shape, hit.numblocks, bool((hit.compute() == checker.collide(Q.compute())).all())
    ((1000,), (4,), True)
    """
    return _by_chunks(_collisions, np.bool_, checker, {"Q": Q})


def distance(checker: CollisionChecker, Q: Any) -> Any:
    """Compute exact distances at the configurations of a Dask array; see `CollisionChecker.distance`.

    Parameters
    ----------
    checker : CollisionChecker
    Q : dask.array.Array, shape (..., dof)

    Returns
    -------
    dask.array.Array of float64, shape (...)
        A lazy array of distances in metres; a negative value is a depth.

    Raises
    ------
    InputError, MissingExtraError
        As for `collide`.

    Notes
    -----
    As for `collide`.

    Examples
    --------
    >>> import dask.array as da
    >>> from loewner import Body, CollisionChecker, Robot, Scene, cluster
    >>> scene = Scene()
    >>> scene.add("post", Body.box([0.2, 0.2, 0.2]), [[1, 0, 0, 1.9], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
    >>> checker = CollisionChecker(Robot.from_urdf("arm.urdf"), scene)
    >>> cluster.distance(checker, da.from_array([[0.5, 0.0], [1.0, 0.0]])).compute().round(6)
    array([0.35, 0.35])
    """
    return _by_chunks(_distances, np.float64, checker, {"Q": Q})


def certify_edges(checker: CollisionChecker, Q0: Any, Q1: Any, *, tolerance: float = 1e-5) -> Any:
    """Prove which motions, such as a roadmap's edges, are free; see `CollisionChecker.certify_edges`.

    Parameters
    ----------
    checker : CollisionChecker
    Q0, Q1 : dask.array.Array, shape (..., dof)
        Starts and ends of the motions, as two arrays of equal shape; `Q1` is cut into the same chunks as `Q0`.
    tolerance : float
        Tolerance in metres; see `CollisionChecker.certify_edges`.

    Returns
    -------
    dask.array.Array of int8, shape (...)
        A lazy array with a `Verdict` for each motion; FREE is proven.

    Raises
    ------
    InputError, MissingExtraError
        As for `collide`. InputError is also raised if the shapes differ, or the tolerance is not positive.

    Notes
    -----
    As for `collide`. A motion takes dozens of times as long as a configuration, so about a thousand motions per chunk
    are suitable. Joint values change linearly from `Q0` to `Q1`. In a roadmap, however, joints without limits turn the
    shorter way around; for such joints, add the necessary whole turns to `Q1`.

    Examples
    --------
    >>> import dask.array as da
    >>> from loewner import CollisionChecker, Robot, Verdict, cluster, planners
    >>> checker = CollisionChecker(Robot.from_urdf("arm.urdf"))
    >>> made = planners.roadmap(checker, 100)
    >>> a, b = (da.from_array(made.nodes[ends], chunks=(500, -1)) for ends in made.edges.T)
    >>> free = cluster.certify_edges(checker, a, b) == Verdict.FREE
    >>> free.numblocks, bool(free.all().compute())
    ((3,), True)
    """
    tolerance = _validate.positive_scalar(tolerance, "tolerance")
    return _by_chunks(_verdicts, np.int8, checker, {"Q0": Q0, "Q1": Q1}, tolerance=tolerance)


def _by_chunks(
    task: Callable[..., Any], dtype: Any, checker: CollisionChecker, arrays: dict[str, Any], **more: Any
) -> Any:
    """Apply a task to each chunk; the last axis of a chunk contains the entries of a configuration."""
    da, delayed = _dask("dask.array"), _dask("dask").delayed
    _validate.instance(checker, "checker", CollisionChecker)
    for name, Q in arrays.items():
        _check_array(da, Q, name, checker.robot)
    (first, *others) = arrays.values()
    if any(Q.shape != first.shape for Q in others):
        shapes = " and ".join(str(Q.shape) for Q in arrays.values())
        raise InputError(f"expected Q0 and Q1 of one shape, found {shapes}")
    first = first.rechunk({-1: -1})
    # The checker is sent as bytes: a copy of its current state, named by its checksum. One task unpacks the bytes, and
    # its result is sent to each worker that has a chunk. If the checker were an argument of each task, it would be sent
    # with each task.
    packed = pickle.dumps(checker, protocol=pickle.HIGHEST_PROTOCOL)
    there = delayed(pickle.loads)(packed, dask_key_name=f"loewner-checker-{_checksum(packed)[:32]}")
    chunked, axes = [first, *(Q.rechunk(first.chunks) for Q in others)], first.ndim - 1
    meta = np.empty((0,) * axes, dtype=dtype)
    return da.map_blocks(task, *chunked, checker=there, **more, dtype=dtype, drop_axis=axes, meta=meta)


def _check_array(da: Any, Q: Any, name: str, robot: Robot) -> None:
    if not isinstance(Q, da.Array):
        raise InputError(
            f"{name}: expected a dask.array.Array, found {_validate.short(Q)}; dask.array.from_array makes one, and "
            "CollisionChecker takes all others"
        )
    expect_width(robot, Q.shape, name)
    if Q.dtype.kind not in "fiu":
        raise InputError(f"{name}: expected real numbers, found dtype {Q.dtype}")


def _collisions(Q: Floats, checker: CollisionChecker) -> Bools:
    with at_most(1):
        return np.asarray(checker.collide(Q))


def _distances(Q: Floats, checker: CollisionChecker) -> Floats:
    with at_most(1):
        return np.asarray(checker.distance(Q, exact=True).distance)


def _verdicts(Q0: Floats, Q1: Floats, checker: CollisionChecker, tolerance: float) -> Any:
    with at_most(1):
        return np.asarray(checker.certify_edges(Q0, Q1, tolerance=tolerance).verdict, dtype=np.int8)


def _dask(module: str) -> Any:
    return imported(module, "work on a cluster needs Dask", "cluster")
