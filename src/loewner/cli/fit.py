"""``loewner fit``: meshes to bodies, saved as ``.npz``."""

from __future__ import annotations

import argparse
import warnings
from pathlib import Path
from typing import Any

import loewner
from loewner import _validate
from loewner._files import shown
from loewner.cli import inputs
from loewner.cli.output import ERROR, model_text, new_table, print_table, progress_bar
from loewner.errors import FileError, InputError
from loewner.fits import DEFAULT_TOLERANCE

EXAMPLES = """examples:
  loewner fit upper_arm.stl forearm.dae -o bodies
  loewner fit gripper.obj -o bodies --threshold 0.02    more pieces, a closer fit
  loewner fit mug.stl -o bodies --tolerance 0.002       pieces that stick out by at most 2 mm
  loewner fit table.glb -o bodies --hull                one piece: the convex hull
  loewner fit cup.stl -o bodies --model surface         the triangles as they are, no fit of pieces
  loewner fit parts/*.stl -o bodies --scheduler tcp://host:8786    on the workers of a Dask cluster
"""


def add(commands: Any) -> None:
    """Add the command."""
    fit = inputs.command(commands, "fit", "meshes to bodies, saved as .npz", EXAMPLES)
    fit.add_argument(
        "meshes", nargs="+", type=Path, metavar="MESH", help="STL, OBJ, PLY, OFF, GLB, glTF or DAE, in metres"
    )
    fit.add_argument("-o", "--out", type=Path, required=True, metavar="DIR", help="folder for the .npz files")
    inputs.add_mesh_options(fit, "pieces")
    fit.add_argument("--tol", type=float, help="certified log-volume gap of the fits of pieces and hulls (1e-4)")
    fit.add_argument(
        "--scheduler",
        metavar="ADDRESS",
        help="of a Dask cluster whose workers do it; what they did before with the same options is not done again, and "
        "meshes that fail are listed in the end",
    )
    fit.set_defaults(run=_run)


def _run(options: argparse.Namespace) -> int:
    targets = [options.out / f"{mesh.stem}.npz" for mesh in options.meshes]
    twice = {t.name for t in targets if targets.count(t) > 1}
    if twice:
        raise InputError(f"MESH: expected meshes with different names, found two for {', '.join(sorted(twice))}")
    if options.tol is not None and inputs.model(options) == "surface":
        raise InputError("--tol: expected it with pieces or hulls only, found it with --model surface")
    tol = DEFAULT_TOLERANCE if options.tol is None else options.tol
    return _on_this_machine(options, targets, tol) if options.scheduler is None else _on_a_cluster(options, tol)


def _on_this_machine(options: argparse.Namespace, targets: list[Path], tol: float) -> int:
    """One mesh after the other, up to the first that fails."""
    table = new_table(
        "body", "pieces", "vertices", "inner, litres", "outer, litres", "gap", "model", title="loewner fit"
    )
    with progress_bar() as progress:
        task = progress.add_task("meshes", total=len(targets))
        part = progress.add_task("", total=None)

        def report(done: int, total: int) -> None:
            progress.update(part, completed=done, total=total)

        for mesh, target in zip(options.meshes, targets, strict=True):
            progress.update(part, description=mesh.name, completed=0, total=None)
            body = inputs.from_mesh(mesh, options, tol=tol, progress=report)
            _make_folder(options.out)
            body.save(target)
            table.add_row(*_fit_row(target, body))
            progress.advance(task)
    print_table(table)
    return 0


def _on_a_cluster(options: argparse.Namespace, tol: float) -> int:
    """All meshes on the workers of a cluster; what failed is a table."""
    from loewner import cluster

    model = inputs.model(options)
    if model == "surface":
        raise InputError("--scheduler: expected pieces or hulls to fit, found --model surface, which fits nothing")
    with progress_bar() as progress:
        task = progress.add_task("meshes", total=len(options.meshes))
        fitted = cluster.fit(
            options.meshes,
            options.scheduler,
            options.out,
            decompose=model == "pieces",
            scale=options.scale,
            tol=tol,
            progress=lambda done, total: progress.update(task, completed=done, total=total),
            **inputs.given(options, inputs.OF_PIECES),
        )
    for text in (text for texts in fitted.warned.values() for text in texts):
        warnings.warn(text, stacklevel=1)
    print(f"{len(fitted.done)} done, {len(fitted.skipped)} done before, {len(fitted.failed)} failed")
    if fitted.failed:
        table = new_table("mesh", "what is wrong", title="loewner fit: failed")
        for mesh, text in fitted.failed.items():
            table.add_row(str(mesh), text.removeprefix(f"{shown(mesh)}: "))
        print_table(table)
    return ERROR if fitted.failed else 0


def _fit_row(target: Path, body: loewner.Body) -> tuple[str, ...]:
    vertices = sum(len(p.vertices) for p in body.pieces if p.vertices is not None)
    inner, outer = body.inner.volume.sum() * 1e3, body.outer.volume.sum() * 1e3
    return (
        str(target), str(len(body.pieces)), str(vertices), f"{inner:.4g}", f"{outer:.4g}",
        f"{body.gaps.max():.1e}", model_text(body),
    )  # fmt: skip


def _make_folder(folder: Path) -> None:
    _validate.path(folder, "--out")
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise FileError(f"{folder}: expected a folder, could not make it ({error.strerror or error})") from None
