"""``loewner fit``: convert meshes to bodies, saved as ``.npz``."""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
import warnings
from collections.abc import Mapping
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any

import loewner
from loewner._base import _validate
from loewner._base._files import made_folder, replacing, shown
from loewner._base._outcomes import TETRAHEDRON, Outcome, outcome_of
from loewner._base._plausible import told_to
from loewner._base._threads import MOST_THREADS
from loewner._base._validate import Progress
from loewner.cli import inputs, jobs
from loewner.cli.output import ERROR, model_text, print_table, progress_bar, progress_of
from loewner.ellipsoids.fits import DEFAULT_TOLERANCE
from loewner.errors import GeometryError, InputError

EXAMPLES = """examples:
  loewner fit upper_arm.stl forearm.dae -o bodies
  loewner fit parts/*.stl -o bodies -j 8                eight at a time
  loewner fit gripper.obj -o bodies --threshold 0.02    more pieces, a closer fit
  loewner fit mug.stl -o bodies --tolerance 0.002       pieces that stick out by at most 2 mm
  loewner fit table.glb -o bodies --hull                one piece: the convex hull
  loewner fit cup.stl -o bodies --model surface         the triangles as they are, exact, in milliseconds
  loewner fit parts/*.stl -o bodies --scheduler tcp://host:8786    on the workers of a Dask cluster

A mesh that cannot be fitted is reported, and the others are still fitted.
Failed meshes are listed at the end.

exit status: 0 all meshes are fitted, 2 one or more failed, or another error
"""

# Options that affect the body of a mesh.
MAKING = ("model", "hull", "usual_model", "scale", "tol", *inputs.OF_PIECES, *inputs.OF_SURFACES)


def add(commands: Any) -> None:
    """Add the command."""
    fit = inputs.command(commands, "fit", "meshes to bodies, saved as .npz", EXAMPLES, _run)
    option, file, _, _ = inputs.adders(fit)
    file("meshes", nargs="+", metavar="MESH", help="STL, OBJ, PLY, OFF, GLB, glTF or DAE, in metres")
    file("-o", "--out", required=True, metavar="DIR", help="folder for the .npz files")
    inputs.add_mesh_options(fit, "pieces")
    fit.set_defaults(makes_folder=True)
    option("--tol", type=float, help="certified log-volume gap of the fits of pieces and hulls (1e-4)")
    option("-j", "--jobs", type=int, metavar="N", help="number of meshes at a time, each in a separate process (1)")
    cluster = "Dask cluster whose workers fit the meshes; meshes already fitted with these options are skipped"
    option("--scheduler", metavar="ADDRESS", help=cluster)


def _run(options: argparse.Namespace) -> int:
    targets = [options.out / f"{mesh.stem}.npz" for mesh in options.meshes]
    twice = {t.name for t in targets if targets.count(t) > 1}
    if twice:
        raise InputError(f"MESH: expected meshes with different names, found two for {', '.join(sorted(twice))}")
    if options.tol is not None and inputs.model(options) == "surface":
        raise InputError("--tol: expected it with pieces or hulls only, found it with --model surface")
    if options.tol is None:
        options.tol = DEFAULT_TOLERANCE
    if options.scheduler is None:
        return _on_this_machine(options, targets)
    if options.jobs is not None:
        raise InputError("--jobs: expected it without --scheduler, whose workers are as many as there are; found both")
    return _on_a_cluster(options)


def _on_this_machine(options: argparse.Namespace, targets: list[Path]) -> int:
    """Fit the meshes in one or more processes. Print tables of the bodies and of the failures."""
    count = 1 if options.jobs is None else _validate.whole_number(options.jobs, "--jobs", 1, MOST_THREADS)
    with told_to([]), suppress(GeometryError):  # a refused option need not be reported for each mesh
        inputs.from_mesh(TETRAHEDRON, options, tol=options.tol, progress=_validate.silent)
    made_folder(_validate.path(options.out, "--out"))
    rows, failed = dict[int, list[str]](), dict[int, str]()
    # If a process is killed while it writes a file, the partial file remains in this temporary folder.
    with tempfile.TemporaryDirectory(prefix=".fit-", dir=options.out) as unfinished, progress_bar() as progress:
        temporary_files = [Path(unfinished) / target.name for target in targets]
        making = {name: getattr(options, name) for name in MAKING}
        tasks = [
            {"mesh": os.fspath(mesh), "target": os.fspath(target), "options": making}
            for mesh, target in zip(options.meshes, temporary_files, strict=True)
        ]
        whole, bars = progress.add_task("meshes", total=len(tasks)), dict[int, Any]()
        for kind, at, value in jobs.answers(__name__, tasks, count):
            mesh, target = options.meshes[at], targets[at]
            if kind == "begun":
                bars[at] = progress.add_task(mesh.name, total=None)
            elif kind == "progress":
                progress.update(bars[at], completed=value[0], total=value[1])
            else:
                progress.update(bars.pop(at), visible=False)
                progress.update(whole, advance=1)
                outcome, row = _outcome(mesh, value)
                for text in outcome.warnings:
                    warnings.warn(text, stacklevel=1)
                if outcome.status == "done":
                    outcome = outcome_of(mesh, partial(_moved, temporary_files[at], target))
                if outcome.status == "done":
                    rows[at] = [shown(target), *row]
                else:
                    failed[at] = outcome.message
                    print(f"loewner: error: {outcome.message}", file=sys.stderr, flush=True)
    if rows:
        columns = ("body", "pieces", "vertices", "inner, litres", "outer, litres", "gap", "model")
        print_table(columns, [rows[at] for at in sorted(rows)], "loewner fit")
    return _summary(f"{len(rows)} done", {options.meshes[at]: failed[at] for at in sorted(failed)})


def serve_task(task: dict[str, Any], progress: Progress) -> list[Any]:
    """Make the body of a mesh and save it, in a separate process. Return the outcome and a row for the table."""
    row: list[str] = []

    def fit() -> Outcome:
        options = argparse.Namespace(**task["options"])
        body = inputs.from_mesh(Path(task["mesh"]), options, tol=options.tol, progress=progress)
        body.save(task["target"])
        row.extend(_fit_row(body))
        return Outcome("done")

    return [*outcome_of(Path(task["mesh"]), fit), row]


def _outcome(mesh: Path, answer: list[Any] | None) -> tuple[Outcome, list[str]]:
    """Return the outcome of a process, and its row of the table. A process that died has failed."""
    if answer is None:
        text = f"{shown(mesh)}: the process that fitted it died; it may take more memory than there is"
        return Outcome("failed", text), []
    status, message, told, row = answer
    return Outcome(status, message, tuple(told)), row


def _moved(made: Path, target: Path) -> Outcome:
    """Rename a completed body to its final name."""
    with replacing(target) as temporary:
        os.replace(made, temporary)
    return Outcome("done")


def _on_a_cluster(options: argparse.Namespace) -> int:
    """Fit all meshes on the workers of a cluster. Print a table of the failures."""
    from loewner import cluster

    model = inputs.model(options)
    if model == "surface":
        raise InputError("--scheduler: expected pieces or hulls to fit, found --model surface, which fits nothing")
    with progress_of("meshes", len(options.meshes)) as progress:
        fitted = cluster.fit(
            options.meshes, options.scheduler, options.out, decompose=model == "pieces", scale=options.scale,
            tol=options.tol, progress=progress, **inputs.given(options, inputs.OF_PIECES),
        )  # fmt: skip
    for text in (text for texts in fitted.warned.values() for text in texts):
        warnings.warn(text, stacklevel=1)
    return _summary(f"{len(fitted.done)} done, {len(fitted.skipped)} done before", fitted.failed)


def _summary(done: str, failed: Mapping[Path, str]) -> int:
    """Print the number of finished meshes, and the failed meshes. Return the exit status."""
    print(f"{done}, {len(failed)} failed")
    if failed:
        rows = [(shown(mesh), text.removeprefix(f"{shown(mesh)}: ")) for mesh, text in failed.items()]
        print_table(("mesh", "what is wrong"), rows, "loewner fit: failed")
    return ERROR if failed else 0


def _fit_row(body: loewner.Body) -> tuple[str, ...]:
    vertices = sum(len(p.vertices) for p in body.pieces if p.vertices is not None)
    inner, outer = body.inner.volume.sum() * 1e3, body.outer.volume.sum() * 1e3
    return (
        str(len(body.pieces)), str(vertices), f"{inner:.4g}", f"{outer:.4g}",
        f"{body.gaps.max():.1e}", model_text(body),
    )  # fmt: skip
