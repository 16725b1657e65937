"""Which answers of other libraries are proven wrong, by kind: hulls of fifteen families near contact.

    python benchmarks/judge.py [--pairs N] [--only NAME ...] [--tolerance M] [--quick] [--out FOLDER]

Every library gets the same hulls (tests/families.py) at the same poses, or what it makes of them: MuJoCo keeps corners
as float32, so it is judged on the corners that it keeps. `judging.judge_answers` judges verdicts, distances, witnesses
and normals. Of each kind of error, the largest ones are proven once more by programs in fractions
(`loewner.reproductions`); a program that did not agree would end the run. The table goes to the terminal, judge.csv and
judge.md to benchmarks/results/<machine>/, or to FOLDER, with the program of the largest error of each kind.
"""

from __future__ import annotations

import argparse
import contextlib
import csv
import io
import sys
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from rich.console import Console
from rich.table import Table

import loewner
import report
from loewner import Bodies
from loewner.judging import Finding, judge_answers
from loewner.reproductions import reproduction
from rivals import CoalPython, FclPython, Missing
from samples import Array, Pairs

HERE = Path(__file__).parent
sys.path.append(str(HERE.parent / "tests"))

from families import FAMILIES, near_contact, pieces, stretch  # noqa: E402
from oracles import hull, pack  # noqa: E402

PAIRS, QUICK, HULLS = 100_000, 300, 200
# Pairs for libraries that take a millisecond or more for each.
SLOW = {"trimesh": 100, "pinocchio": 10}
TOLERANCE = 1e-4  # metres; the hulls are about a metre large
PROGRAMS = 1000  # of each library and kind
# Libraries that are asked about ever smaller bodies, for a short program.
REDUCED = ("coal", "coal, fastest")
SEED = 11


class Said(NamedTuple):
    """Answers of one library, and the bodies that they are about."""

    a: Bodies
    b: Bodies
    answers: dict[str, Array]


class Row(NamedTuple):
    """How often a library was proven wrong in one way."""

    library: str
    version: str
    pairs: int
    finding: str
    wrong: int
    largest: float
    families: str
    in_fractions: str


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--pairs", type=int, default=PAIRS, help="of all families together")
    parser.add_argument("--only", nargs="+", choices=LIBRARIES, default=list(LIBRARIES))
    parser.add_argument("--tolerance", type=float, default=TOLERANCE, help="allowed error, in metres")
    parser.add_argument("--quick", action="store_true", help="few pairs: shows that it works")
    parser.add_argument("--out", type=Path, help="folder for the tables and programs")
    options = parser.parse_args(arguments)
    facts = report.machine()
    results = options.out or HERE / "results" / report.machine_name(facts)
    results.mkdir(parents=True, exist_ok=True)
    each = max(1, (QUICK if options.quick else options.pairs) // len(FAMILIES))
    families = {family: pairs_of(family, each) for family in FAMILIES}
    rows = [row for name in options.only for row in judged(name, families, options.tolerance, results)]
    show(rows)
    write(results, rows, facts, options.tolerance)
    return 0


def pairs_of(family: str, count: int) -> Pairs:
    """Hulls of a family, each in many pairs, at poses near contact."""
    hulls = min(HULLS, 2 * count)
    points, rng = pieces(family, hulls, SEED), np.random.default_rng([SEED, sum(family.encode())])
    pool, a = pack(map(hull, points)), rng.integers(hulls, size=count)
    b = (a + rng.integers(1, hulls, size=count)) % hulls
    Ta, Tb = near_contact(rng, pool, a, pool, b, stretch=stretch(family))
    return Pairs(family, Bodies.from_points(points), a, b, Ta, Tb)


# -- libraries ----------------------------------------------------------------------------------


def ours(p: Pairs) -> Said:
    """Our own exact answers."""
    found = loewner.distance(p.first, p.Ta, p.second, p.Tb, exact=True)
    answers = {name: getattr(found, name) for name in ("distance", "witness_a", "witness_b", "normal")}
    return Said(p.first, p.second, {"colliding": loewner.collide(p.first, p.Ta, p.second, p.Tb), **answers})


class Coal(CoalPython):
    """Coal, pair by pair from Python: with its default settings or, for booleans, with its fastest ones."""

    def __init__(self, p: Pairs, *, fastest: bool = False) -> None:
        super().__init__(p)
        if not fastest:
            import coal

            self._request = coal.CollisionRequest()

    def said(self) -> dict[str, Array]:
        """Booleans, and signed distances with nearest points and normals."""
        rows = []
        for a, A, b, B in self._calls:
            self._nearest.clear()
            distance = self._distance(a, A, b, B, self._signed, self._nearest)
            result = self._nearest
            rows.append([distance, *result.getNearestPoint1(), *result.getNearestPoint2(), *result.normal])
        return {"colliding": np.array(self.collide()), **columns(rows)}


class Fcl(FclPython):
    """python-fcl, pair by pair, with its default solver; distances without depths.

    With depths (`enable_signed_distance`), version 0.7.0.11 ends the process at one of these pairs.
    """

    def said(self) -> dict[str, Array]:
        """Booleans, and distances with nearest points of hulls that it takes to be apart."""
        fcl, rows = self._fcl, []
        request = fcl.DistanceRequest(enable_nearest_points=True)
        for a, b in self._calls:
            result = fcl.DistanceResult()
            distance = fcl.distance(a, b, request, result)
            points = [*result.nearest_points[0], *result.nearest_points[1]]
            rows.append([distance, *points] if distance > 0.0 else [0.0, *[np.nan] * 6])
        return {"colliding": np.array(self.collide()), **columns(rows)}


def columns(rows: list[list[float]]) -> dict[str, Array]:
    """Distances, witnesses and, if there are any, normals."""
    x = np.array(rows, dtype=float)
    found = {"distance": x[:, 0], "witness_a": x[:, 1:4], "witness_b": x[:, 4:7]}
    return found | ({"normal": x[:, 7:]} if x.shape[1] > 7 else {})


def mujoco(p: Pairs) -> Said:
    """Signed distances and nearest points of `mj_geomDistance`, about the corners that the compiled model keeps."""
    if find_spec("mujoco") is None:
        raise Missing("package mujoco is not installed")
    import mujoco as mj

    spec = mj.MjSpec()
    for k, body in enumerate(p.bodies):
        spec.add_mesh(
            name=f"{k}", uservert=body.pieces[0].vertices.ravel(), userface=body.pieces[0].triangles.ravel(),
            inertia=mj.mjtMeshInertia.mjMESH_INERTIA_SHELL,
        )  # fmt: skip
        spec.worldbody.add_geom(name=f"{k}", type=mj.mjtGeom.mjGEOM_MESH, meshname=f"{k}")
    model = spec.compile()
    data, fromto, rows = mj.MjData(model), np.zeros(6), []
    for i, A, j, B in zip(p.a, p.Ta, p.b, p.Tb, strict=True):
        i, j = int(i), int(j)
        data.geom_xpos[i], data.geom_xmat[i] = A[:3, 3], A[:3, :3].ravel()
        data.geom_xpos[j], data.geom_xmat[j] = B[:3, 3], B[:3, :3].ravel()
        rows.append([mj.mj_geomDistance(model, data, i, j, 1e3, fromto), *fromto])
    starts = np.append(model.mesh_vertadr, len(model.mesh_vert))
    bodies = Bodies.from_points([model.mesh_vert[m:n].astype(float) for m, n in zip(starts, starts[1:], strict=False)])
    return Said(bodies[p.a], bodies[p.b], columns(rows))


def trimesh(p: Pairs) -> Said:
    """Booleans and distances of `CollisionManager`, which has python-fcl compare triangles."""
    if find_spec("trimesh") is None or find_spec("fcl") is None:
        raise Missing("trimesh or python-fcl is not installed")
    from trimesh import Trimesh
    from trimesh.collision import CollisionManager

    hulls = [body.pieces[0] for body in p.bodies]
    meshes = [Trimesh(piece.vertices, piece.triangles, process=False) for piece in hulls]
    met, apart = [], []
    for i, A, j, B in zip(p.a, p.Ta, p.b, p.Tb, strict=True):
        one, other = CollisionManager(), CollisionManager()
        one.add_object("a", meshes[int(i)], A)
        other.add_object("b", meshes[int(j)], B)
        met.append(one.in_collision_other(other))
        apart.append(max(one.min_distance_other(other), 0.0))  # -1 for bodies that meet
    return Said(p.first, p.second, {"colliding": np.array(met), "distance": np.array(apart)})


def pinocchio(p: Pairs) -> Said:
    """Booleans and distances of a geometry model with one pair, which has Coal compare hulls."""
    if find_spec("pinocchio") is None:
        raise Missing("package pin is not installed")
    import pinocchio as pin

    made, rows, met = CoalPython(p), [], []
    for (a, _, b, _), A, B in zip(made._calls, p.Ta, p.Tb, strict=True):
        model = pin.GeometryModel()
        for name, shape in (("a", a), ("b", b)):
            model.addGeometryObject(pin.GeometryObject(name, 0, pin.SE3.Identity(), shape))
        model.addCollisionPair(pin.CollisionPair(0, 1))
        data = pin.GeometryData(model)
        for k, T in enumerate((A, B)):
            data.oMg[k] = pin.SE3(T[:3, :3], T[:3, 3])
        met.append(pin.computeCollision(model, data, 0))
        found = pin.computeDistance(model, data, 0)
        rows.append([found.min_distance, *found.getNearestPoint1(), *found.getNearestPoint2(), *found.normal])
    return Said(p.first, p.second, {"colliding": np.array(met), **columns(rows)})


LIBRARIES = {
    "loewner": ours,
    "coal": lambda p: Said(p.first, p.second, Coal(p).said()),
    "coal, fastest": lambda p: Said(p.first, p.second, Coal(p, fastest=True).said()),
    "python-fcl": lambda p: Said(p.first, p.second, Fcl(p).said()),
    "mujoco": mujoco,
    "trimesh": trimesh,
    "pinocchio": pinocchio,
}


# -- judgement ----------------------------------------------------------------------------------


def judged(name: str, families: dict[str, Pairs], tolerance: float, results: Path) -> Iterator[Row]:
    """Ask a library about all pairs, and count what is proven wrong."""
    found: dict[Finding, list[tuple[float, str, int]]] = {}
    parts, pairs = {}, 0
    for family, every in families.items():
        p = every.part(slice(None, None, SLOW.get(name, 1)))
        try:
            said = LIBRARIES[name](p)
        except Missing as missing:
            print(f"{name}: {missing}")
            return
        judgement = judge_answers(said.a, p.Ta, said.b, p.Tb, **said.answers, tolerance=tolerance)
        parts[family], pairs = (p, said), pairs + len(p)
        for kind in Finding:
            if kind > Finding.UNDECIDED:
                error = np.where(judgement.kinds == kind, judgement.excess, 0.0).max(axis=-1)
                found.setdefault(kind, []).extend((float(error[k]), family, int(k)) for k in np.flatnonzero(error))
    for kind, cases in found.items():
        cases.sort(reverse=True)
        proven = sum(
            in_fractions(name, kind, *parts[family], k, tolerance, results) for _, family, k in cases[:PROGRAMS]
        )
        hit = [family for family in families if any(family == where for _, where, _ in cases)]
        yield Row(
            name, version(name), pairs, kind.name, len(cases), cases[0][0] if cases else 0.0,
            "; ".join(hit), f"{proven} of {min(len(cases), PROGRAMS)}",
        )  # fmt: skip


def in_fractions(name: str, kind: Finding, p: Pairs, said: Said, k: int, tolerance: float, results: Path) -> bool:
    """Prove one wrong answer by a program in fractions; keep the program if it is the first of its kind."""

    def engine(A: Array, B: Array) -> dict[str, Array]:
        one, two = np.zeros(1, dtype=int), np.ones(1, dtype=int)
        small = Pairs("", Bodies.from_points([A, B]), one, two, p.Ta[[k]], p.Tb[[k]])
        return {part: values[0] for part, values in LIBRARIES[name](small).answers.items()}

    answers = {part: values[k] for part, values in said.answers.items()}
    pair = said.a[k], p.Ta[k], said.b[k], p.Tb[k]
    code = reproduction(*pair, **answers, tolerance=tolerance)
    path, out = results / "judge" / f"{name.replace(', ', '-')}-{kind.name.lower()}.py", io.StringIO()
    path.parent.mkdir(exist_ok=True)
    if not path.exists():
        short = reproduction(*pair, engine=engine, tolerance=tolerance) if name in REDUCED else code
        path.write_text(short, encoding="utf-8")
    with contextlib.redirect_stdout(out):
        exec(compile(code, str(path), "exec"), {})
    return kind.name in out.getvalue()


def version(name: str) -> str:
    from importlib.metadata import version as installed

    return installed({"pinocchio": "pin"}.get(name, name.split(",")[0]))


def titled(row: Row) -> str:
    name, *settings = row.library.split(", ")
    return ", ".join([f"{name} {row.version}", *settings])


def show(rows: list[Row]) -> None:
    table = Table("library", "pairs", "proven wrong", "answers", "largest error, m", "families", "in fractions")
    for row in rows:
        if row.wrong:
            library = titled(row)
            numbers = f"{row.wrong:,}", f"{row.largest:.4g}", f"{len(row.families.split('; '))}", row.in_fractions
            table.add_row(library, f"{row.pairs:,}", row.finding, *numbers)
    for name in dict.fromkeys(row.library for row in rows):
        if not any(row.wrong for row in rows if row.library == name):
            table.add_row(name, f"{next(row.pairs for row in rows if row.library == name):,}", "none", "0")
    Console(width=max(Console().width, 140)).print(table)


def write(results: Path, rows: list[Row], facts: dict[str, Any], tolerance: float) -> None:
    with open(results / "judge.csv", "w", newline="", encoding="utf-8") as out:
        writer = csv.writer(out, lineterminator="\n")
        writer.writerow([*Row._fields, "tolerance", "commit", "date"])
        writer.writerows([*row, tolerance, facts["commit"], facts["date"]] for row in rows)
    lines = ["| library | pairs | proven wrong | answers | largest error, m |", "|---|---|---|---|---|"]
    lines += [
        f"| {titled(row)} | {row.pairs:,} | {row.finding} | {row.wrong:,} | {row.largest:.4g} |"
        for row in rows
        if row.wrong
    ]
    (results / "judge.md").write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    sys.exit(main())
