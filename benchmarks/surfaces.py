"""Triangle meshes as they are: built, asked, and held against whole numbers; beside Coal and python-fcl.

    python benchmarks/surfaces.py [--only SECTION ...] [--poses N] [--quick] [--decomposition] [--out FOLDER]

Sections, all on one thread:

    pair       two visual meshes of the Panda: building, loading, collide, distance, memory; beside Coal and python-fcl
    million    a million triangles built; 100,000 poses of a terrain and a part
    answers    ten pairs of meshes in N poses, every tenth of them grazing: what differs from rational arithmetic
    tiers      for the same pairs, how many poses the ellipsoids settle
    mug        how far the pieces of a decomposition stand out, and what is left of a cavity

Tables go to the terminal; surfaces.csv and surfaces.json to benchmarks/results/<machine>/, or to FOLDER. A quick run
is small and writes to out/benchmarks.
"""

from __future__ import annotations

import argparse
import inspect
import json
import sys
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

import loewner
import report
import surface_samples as samples
from clock import Cost, Measure, race, threads_set_to, timed
from loewner import Body, Verdict
from report import Row
from rivals import Missing
from samples import Array
from surface_samples import Mesh, Pair, collides, distance, distances_of_points

SECTIONS = ("pair", "million", "answers", "tiers", "mug")
# Poses: of the pair, one a call, of the terrain, of all ten pairs; and of a quick run.
PAIR_POSES, SINGLE_POSES, TERRAIN_POSES, ANSWERS = 2_000, 500, 100_000, 100_000
QUICK = 20
# Subdivisions of a sphere of 1,310,720 triangles, and triangles of terrains.
SUBDIVISIONS, LARGE, MIDDLE = 8, 1_000_000, 200_000
# Every so many poses of `answers` are at contact, to this share of the smaller mesh's size.
GRAZING, TOLERANCE = 10, 1e-9
# Distances of two libraries differ if by more than this, metres; Coal's own tolerance is 1e-6.
AGREES = 1e-6
# What a decomposition of the mug is asked for, the ball in its cavity, and samples on its pieces.
MUG_TOLERANCE, BALL, SAMPLES = 0.002, 0.001, 20_000


class Options(NamedTuple):
    quick: bool
    poses: int
    decomposition: bool

    @property
    def rounds(self) -> int:
        return 1 if self.quick else 5


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", type=lambda text: text.split(","), help=f"some of {','.join(SECTIONS)}")
    parser.add_argument("--poses", type=int, help="poses of all ten pairs together, in answers and tiers")
    parser.add_argument("--quick", action="store_true", help="small sizes: shows that it works, measures little")
    parser.add_argument(
        "--decomposition", action="store_true", help="beside the pair's decomposition, which takes a minute"
    )
    parser.add_argument("--out", type=Path, help="folder for results")
    asked = parser.parse_args(arguments)
    wrong = set(asked.only or ()) - set(SECTIONS)
    if wrong:
        parser.error(f"--only: expected some of {', '.join(SECTIONS)}, found {', '.join(sorted(wrong))}")
    options = Options(asked.quick, asked.poses or (10 * QUICK if asked.quick else ANSWERS), asked.decomposition)
    facts = report.machine()
    kept = Path("out/benchmarks") if asked.quick else Path(__file__).parent / "results" / report.machine_name(facts)
    results = asked.out or kept
    rows: list[Row] = []
    figures: dict[str, Any] = {"machine": facts}
    with threads_set_to(1):
        for name in asked.only or SECTIONS:
            run: Callable[[Options], tuple[list[Row], Any]] = globals()[f"run_{name}"]
            try:
                found, figures[name] = run(options)
            except Missing as missing:
                print(f"{name}: not run: {missing}\n", flush=True)
                continue
            if found:
                report.show(f"{name}: one thread", found)
            show(name, figures[name])
            rows += found
    if rows:
        report.write(results / "surfaces.csv", rows, facts)
    results.mkdir(parents=True, exist_ok=True)
    (results / "surfaces.json").write_text(json.dumps(figures, indent=1) + "\n", encoding="utf-8")
    return 0


def show(title: str, figures: Mapping[str, Any] | Sequence[Mapping[str, Any]]) -> None:
    """A table of figures, or a list of them."""
    console = Console(width=max(Console().width, 160))
    if isinstance(figures, Mapping):
        for name, value in figures.items():
            text = f"{value:.4g}" if isinstance(value, float) else value
            console.print(f"  {title}: {name}: {text}", markup=False, highlight=False)
    elif figures:
        table = Table(title=title, title_justify="left", title_style="bold", box=SIMPLE_HEAD)
        for name in figures[0]:
            table.add_column(name, justify="left" if name == "pair" else "right")
        for entry in figures:
            table.add_row(
                *(f"{v:.4g}" if isinstance(v, float) else "-" if v is None else str(v) for v in entry.values())
            )
        console.print(table)
    console.print()


# -- contestants -------------------------------------------------------------------------------


def our_body(mesh: Mesh) -> Body:
    """A mesh as a surface, solid where the oracle takes it to be."""
    build = getattr(Body, "from_surface", None)
    if build is None:
        raise Missing("this loewner has no Body.from_surface")
    body: Body = build(samples.trimesh_of(mesh.vertices, mesh.faces), solid=bool(mesh.solid))
    return body


def have_surfaces() -> str:
    """Why ours cannot run; nothing if it can."""
    return "" if hasattr(Body, "from_surface") else "this loewner has no Body.from_surface"


class CoalMeshes:
    """Coal's trees of oriented boxes, asked pose by pose from Python; its objects are made beforehand."""

    name = "Coal BVH OBBRSS"

    def __init__(self) -> None:
        if find_spec("coal") is None:
            raise Missing("package coal is not installed")
        import coal

        self._coal = coal
        self._request, self._result = coal.CollisionRequest(), coal.CollisionResult()
        self._request.num_max_contacts, self._request.security_margin = 1, 0.0
        self._near, self._nearest = coal.DistanceRequest(), coal.DistanceResult()

    def built(self, mesh: Mesh) -> Any:
        model = self._coal.BVHModelOBBRSS()
        model.beginModel(len(mesh.faces), len(mesh.vertices))
        model.addVertices(mesh.vertices)
        model.addTriangles(mesh.faces)
        model.endModel()
        model.computeLocalAABB()
        return model

    def calls(self, a: Any, Ta: Array, b: Any, Tb: Array) -> list[Any]:
        transform = self._coal.Transform3s
        return [
            (a, transform(A[:3, :3], A[:3, 3]), b, transform(B[:3, :3], B[:3, 3])) for A, B in zip(Ta, Tb, strict=True)
        ]

    def collide(self, calls: list[Any]) -> Array:
        out = []
        for call in calls:
            self._result.clear()
            out.append(self._coal.collide(*call, self._request, self._result) > 0)
        return np.array(out)

    def distance(self, calls: list[Any]) -> Array:
        out = []
        for call in calls:
            self._nearest.clear()
            out.append(self._coal.distance(*call, self._near, self._nearest))
        return np.array(out)


class FclMeshes:
    """The same for python-fcl."""

    name = "python-fcl BVH"

    def __init__(self) -> None:
        if find_spec("fcl") is None:
            raise Missing("package python-fcl is not installed")
        import fcl

        self._fcl = fcl
        self._request, self._near = fcl.CollisionRequest(), fcl.DistanceRequest()

    def built(self, mesh: Mesh) -> Any:
        model = self._fcl.BVHModel()
        model.beginModel(len(mesh.faces), len(mesh.vertices))
        model.addSubModel(mesh.vertices, mesh.faces)
        model.endModel()
        return model

    def calls(self, a: Any, Ta: Array, b: Any, Tb: Array) -> list[Any]:
        def at(model: Any, T: Array) -> Any:
            return self._fcl.CollisionObject(model, self._fcl.Transform(T[:3, :3], T[:3, 3]))

        return [(at(a, A), at(b, B)) for A, B in zip(Ta, Tb, strict=True)]

    def collide(self, calls: list[Any]) -> Array:
        fcl = self._fcl
        return np.array([fcl.collide(a, b, self._request, fcl.CollisionResult()) > 0 for a, b in calls])

    def distance(self, calls: list[Any]) -> Array:
        fcl = self._fcl
        return np.array([fcl.distance(a, b, self._near, fcl.DistanceResult()) for a, b in calls])


Rival = CoalMeshes | FclMeshes


def rivals() -> tuple[list[Rival], str]:
    """Those that can run, and why the others cannot."""
    found: list[Rival] = []
    lacking = []
    for kind in (CoalMeshes, FclMeshes):
        try:
            found.append(kind())
        except Missing as missing:
            lacking.append(str(missing))
    return found, "; ".join(lacking)


# -- the pair ----------------------------------------------------------------------------------


def run_pair(options: Options) -> tuple[list[Row], dict[str, Any]]:
    files = [samples.robot_file(path) for path in (samples.LINK5, samples.HAND)]
    p = Pair("link 5 and hand", *(Mesh(*loewner.meshes.load(file)) for file in files))
    count = QUICK if options.quick else PAIR_POSES
    Ta, Tb = samples.drawn(p, count, 1)
    truth = collides(p.a, Ta, p.b, Tb)
    faces = len(p.a.faces) + len(p.b.faces)
    figures: dict[str, Any] = {
        "faces": faces,
        "poses": count,
        "colliding": float(truth.mean()),
        "how drawn": " ".join((samples.drawn.__doc__ or "").split()) + f" Here {samples.factor(p):.3g}.",
    }
    others, lacking = rivals()
    if lacking:
        print(f"not run: {lacking}")
    measures: dict[str, dict[str, Measure]] = {}
    sizes: dict[str, int] = {}
    answers: dict[str, dict[str, Array]] = {}

    def enter(case: str, who: str, run: Callable[[], Any], items: int) -> None:
        try:
            run()
        except loewner.LoewnerError as error:
            figures[f"{case}, {who}"] = f"not run: {type(error).__name__}: {error}"
            return
        measures.setdefault(case, {})[who] = timed(run, items)
        sizes[case] = items

    free = ~truth
    for rival in others:
        a, b = rival.built(p.a), rival.built(p.b)
        calls, apart = rival.calls(a, Ta, b, Tb), rival.calls(a, Ta[free], b, Tb[free])
        few = calls[:SINGLE_POSES]
        enter("built from arrays, per triangle", rival.name, partial(_both, rival.built, p), faces)
        enter("collide, a batch", rival.name, partial(rival.collide, calls), count)
        enter("collide, one pose a call", rival.name, partial(rival.collide, few), len(few))
        enter("distance, free poses", rival.name, partial(rival.distance, apart), len(apart))
        answers[rival.name] = {"collide": rival.collide(calls), "distance": rival.distance(apart)}
    missing = have_surfaces()
    if not missing:
        figures |= _enter_ours(enter, answers, p, files, Ta, Tb, free)
    rows = []
    for case, contestants in measures.items():
        costs = race(contestants, options.rounds)
        for who in [r.name for r in others if r.name in costs] or [""]:
            rows.append(_row(case, costs, who, answers, truth, sizes[case], missing))
    if options.decomposition:
        figures |= _decomposition(files, Ta, Tb, truth, options)
    return rows, figures


def _both(build: Callable[[Mesh], Any], p: Pair) -> list[Any]:
    return [build(p.a), build(p.b)]


def _row(
    case: str, costs: Mapping[str, Cost], who: str, answers: Mapping[str, Mapping[str, Array]], truth: Array,
    count: int, missing: str,
) -> Row:  # fmt: skip
    """Ours beside one rival; what it answers other than the oracle or, for a distance, than we is in the note."""
    note, differing = (f"ours not run: {missing}" if missing else ""), None
    ours, theirs = answers.get("us", {}), answers.get(who, {})
    if case.startswith("collide, a batch") and who:
        wrong = report.differences(theirs["collide"], truth)
        note = "; ".join(filter(None, [note, f"{who}: {wrong} of {count} differ from rational arithmetic"]))
        if ours:
            differing = report.differences(ours["collide"], truth)
    if case.startswith("distance") and who and ours:
        gap = np.abs(ours["distance"] - theirs["distance"])
        differing = int((gap > AGREES).sum())
        note = f"distances differ by up to {gap.max():.2g} m"
    return Row(case, "from_surface", costs.get("us"), who, costs.get(who), count, None, differing, note)


def _enter_ours(
    enter: Callable[..., None], answers: dict[str, dict[str, Array]], p: Pair, files: list[Path], Ta: Array, Tb: Array,
    free: Array,
) -> dict[str, Any]:  # fmt: skip
    """Our contestants; returns what is a figure and no race."""
    faces = len(p.a.faces) + len(p.b.faces)
    source = [samples.trimesh_of(m.vertices, m.faces) for m in (p.a, p.b)]
    a, b = (Body.from_surface(s, solid=False) for s in source)
    folder = Path(tempfile.mkdtemp())
    saved = [folder / f"{side}.npz" for side in "ab"]
    for body, path in zip((a, b), saved, strict=True):
        body.save(path)
    singles = list(zip(Ta[:SINGLE_POSES], Tb[:SINGLE_POSES], strict=True))

    def one_by_one(query: Callable[..., Any]) -> None:
        for A, B in singles:
            query(a, A, b, B)

    enter("built from arrays, per triangle", "us", lambda: [Body.from_surface(s, solid=False) for s in source], faces)
    enter("built from .dae, per triangle", "us", lambda: [Body.from_surface(f) for f in files], faces)
    enter("loaded from .npz, per triangle", "us", lambda: [Body.load(f) for f in saved], faces)
    enter("collide, a batch", "us", partial(loewner.collide, a, Ta, b, Tb), len(Ta))
    enter("collide, one pose a call", "us", partial(one_by_one, loewner.collide), len(singles))
    enter(
        "distance, free poses", "us", partial(loewner.distance, a, Ta[free], b, Tb[free], exact=True), int(free.sum())
    )
    enter(
        "depth, colliding poses",
        "us",
        partial(loewner.distance, a, Ta[~free], b, Tb[~free], exact=True),
        int((~free).sum()),
    )
    enter("distance, bounds", "us", partial(loewner.distance, a, Ta, b, Tb), len(Ta))
    answers["us"] = {
        "collide": loewner.collide(a, Ta, b, Tb),
        "distance": loewner.distance(a, Ta[free], b, Tb[free], exact=True).distance,
    }
    verdicts = loewner.classify(a, Ta, b, Tb)
    return {
        "bytes per triangle": (a.nbytes + b.nbytes) / faces,
        "bytes per triangle in .npz": sum(path.stat().st_size for path in saved) / faces,
        **{f"classify {v.name}": float((verdicts == v).mean()) for v in Verdict},
        **{f"{name}, seconds, first call": seconds for name, seconds in _first(files).items()},
    }


def _first(files: list[Path]) -> dict[str, float]:
    """Seconds on the wall for each file, as a user waits for it."""
    found = {}
    for file in files:
        start = time.perf_counter()
        Body.from_surface(file)
        found[f"from_surface({file.name})"] = time.perf_counter() - start
    return found


def _decomposition(files: list[Path], Ta: Array, Tb: Array, truth: Array, options: Options) -> dict[str, Any]:
    """`Body.from_mesh` of the same files: what it takes, and how many answers are those of the meshes."""
    start = time.perf_counter()
    a, b = (Body.from_mesh(file) for file in files)
    built = time.perf_counter() - start
    cost = race({"us": timed(partial(loewner.collide, a, Ta, b, Tb), len(Ta))}, options.rounds)["us"]
    return {
        "from_mesh, seconds": built,
        "from_mesh, pieces": len(a.pieces) + len(b.pieces),
        "from_mesh, collide, us a pose": 1e6 * cost.cpu,
        "from_mesh, answers unlike those of the meshes": report.differences(loewner.collide(a, Ta, b, Tb), truth),
    }


# -- a million ---------------------------------------------------------------------------------


def run_million(options: Options) -> tuple[list[Row], dict[str, Any]]:
    rows: list[Row] = []
    figures: dict[str, Any] = {}
    missing = have_surfaces()
    others, _ = rivals()
    large = {
        "rock": samples.rock(4 if options.quick else SUBDIVISIONS),
        "terrain": samples.terrain(5_000 if options.quick else LARGE),
    }
    for name, (vertices, faces) in large.items():
        source = samples.trimesh_of(vertices, faces)
        mesh = _Arrays(np.ascontiguousarray(vertices), np.ascontiguousarray(faces))
        contestants = {r.name: timed(partial(r.built, mesh), len(faces)) for r in others}
        if not missing:
            contestants["us"] = timed(partial(Body.from_surface, source), len(faces))
            figures[f"{name}, bytes per triangle"] = Body.from_surface(source).nbytes / len(faces)
        costs = race(contestants, 1 if options.quick else 2)
        figures |= {f"{name}, {len(faces):,} triangles, seconds, {who}": c.cpu * len(faces) for who, c in costs.items()}
        for r in others:
            rows.append(
                Row(f"{name} built, per triangle", "from_surface", costs.get("us"), r.name, costs[r.name], len(faces))
            )

    p = Pair(
        "terrain and hand", Mesh(*samples.terrain(2_000 if options.quick else MIDDLE)), samples.robot_mesh(samples.HAND)
    )
    count = QUICK if options.quick else TERRAIN_POSES
    Ta, Tb = samples.drawn(p, count, 2)
    truth = collides(p.a, Ta, p.b, Tb)
    figures |= {
        "terrain and hand, faces": len(p.a.faces) + len(p.b.faces),
        "poses": count,
        "colliding": float(truth.mean()),
    }
    some = slice(0, count // 20 or 1)
    costs, answers = {}, {}
    if not missing:
        a, b = our_body(p.a), our_body(p.b)
        costs["us"] = race({"us": timed(partial(loewner.collide, a, Ta, b, Tb), count)}, 1 if options.quick else 2)[
            "us"
        ]
        answers["us"] = loewner.collide(a, Ta, b, Tb)
        figures["terrain and hand, differing"] = report.differences(answers["us"], truth)
        figures["terrain and hand, us a pose"] = 1e6 * costs["us"].cpu
    for r in others:
        calls = r.calls(r.built(p.a), Ta[some], r.built(p.b), Tb[some])
        cost = race({r.name: timed(partial(r.collide, calls), len(calls))}, options.rounds)[r.name]
        wrong = report.differences(r.collide(calls), truth[some])
        note = f"rival on the first {len(calls)}, {wrong} of which differ from rational arithmetic" + (
            f"; ours not run: {missing}" if missing else ""
        )
        differing = None if missing else report.differences(answers["us"], truth)
        rows.append(
            Row(
                "terrain and hand: collide", "from_surface", costs.get("us"), r.name, cost, count, None, differing, note
            )
        )
    return rows, figures


class _Arrays(NamedTuple):
    """What rivals need of a mesh, without the oracle's tree of it."""

    vertices: Array
    faces: Array


# -- answers -----------------------------------------------------------------------------------


def run_answers(options: Options) -> tuple[list[Row], list[dict[str, Any]]]:
    """Answers that differ from those of rational arithmetic, in random poses and on both sides of contact."""
    table = []
    missing = have_surfaces()
    if missing:
        print(f"answers: the oracle alone: {missing}")
    for k, p in enumerate(samples.pairs()):
        each = options.poses // 10
        near = each // GRAZING
        doubtful: list[int] = []
        start = time.perf_counter()
        Ta, Tb = samples.drawn(p, each - near, 10 * k)
        truth = collides(p.a, Ta, p.b, Tb, count=doubtful.append)
        A, B, sides = samples.grazing(p, near, 10 * k + 5, TOLERANCE)
        near = len(sides)
        seconds = time.perf_counter() - start
        entry: dict[str, Any] = {
            "pair": p.name, "poses": len(truth), "colliding": float(truth.mean()), "differing": None, "grazing": near,
            "grazing differing": None, "certified wrongly": None, "in whole numbers": sum(doubtful),
            "oracle s": seconds, "ours s": None,
        }  # fmt: skip
        if not missing:
            a, b = our_body(p.a), our_body(p.b)
            start = time.perf_counter()
            random, grazing = loewner.collide(a, Ta, b, Tb), loewner.collide(a, A, b, B)
            entry["ours s"] = time.perf_counter() - start
            entry["differing"] = report.differences(random, truth)
            entry["grazing differing"] = report.differences(grazing, sides)
            verdicts = np.concatenate([loewner.classify(a, Ta, b, Tb), loewner.classify(a, A, b, B)])
            both = np.concatenate([truth, sides])
            wrong = (both & (verdicts == Verdict.FREE)) | (~both & (verdicts == Verdict.COLLIDING))
            entry["certified wrongly"] = int(wrong.sum())
        table.append(entry)
        print(f"  {p.name}: {seconds:.1f} s of the oracle", flush=True)
    if not missing:
        total = sum(e["poses"] + e["grazing"] for e in table)
        wrong = sum(e["differing"] + e["grazing differing"] + e["certified wrongly"] for e in table)
        print(f"{total} poses, {sum(e['grazing'] for e in table)} of them grazing: {wrong} disagreements")
    return [], table


# -- tiers -------------------------------------------------------------------------------------


def run_tiers(options: Options) -> tuple[list[Row], list[dict[str, Any]]]:
    """What the outer and inner ellipsoids settle without a triangle."""
    missing = have_surfaces()
    if missing:
        raise Missing(missing)
    table = []
    for k, p in enumerate(samples.pairs()):
        Ta, Tb = samples.drawn(p, max(options.poses // 10, 1), 10 * k)
        a, b = our_body(p.a), our_body(p.b)
        verdicts = loewner.classify(a, Ta, b, Tb)
        entry: dict[str, Any] = {"pair": p.name, "poses": len(Ta), "solid": f"{p.a.solid}, {p.b.solid}"}
        entry |= {v.name: int((verdicts == v).sum()) for v in Verdict}
        hit = loewner.collide(a, Ta, b, Tb)
        entry |= {"open, colliding": int(hit[verdicts == Verdict.AMBIGUOUS].sum())}
        table.append(entry)
    return [], table


# -- the mug -----------------------------------------------------------------------------------


def run_mug(options: Options) -> tuple[list[Row], dict[str, Any]]:
    """A ball of a millimetre in the middle of a mug's cavity, to a decomposition, to the surface, and in truth."""
    mesh = Mesh(*samples.mug())
    ball, eye = Body.sphere(BALL), np.eye(4)
    at = np.eye(4)
    at[:3, 3] = samples.cavity()
    figures: dict[str, Any] = {"truth, clearance of the ball, m": distance(mesh, eye, _point(), at) - BALL}
    missing = have_surfaces()
    if missing:
        print(f"mug: from_surface not run: {missing}")
    else:
        surface = our_body(mesh)
        figures["from_surface, clearance, m"] = float(loewner.distance(surface, eye, ball, at, exact=True).distance)
    source = samples.trimesh_of(mesh.vertices, mesh.faces)
    if "tolerance" not in inspect.signature(Body.from_mesh).parameters:
        print("mug: decomposition not run: this loewner's Body.from_mesh has no tolerance=")
        return [], figures
    start = time.perf_counter()
    body = Body.from_mesh(source, tolerance=MUG_TOLERANCE)
    figures["from_mesh, seconds"] = time.perf_counter() - start
    figures["from_mesh, pieces"] = len(body.pieces)
    figures["from_mesh, clearance, m"] = float(loewner.distance(body, eye, ball, at, exact=True).distance)
    figures["from_mesh, protrusion of samples, m"] = protrusion(body, mesh, 500 if options.quick else SAMPLES)
    figures["from_mesh, protrusion asked for, m"] = MUG_TOLERANCE
    return [], figures


def _point() -> Mesh:
    return Mesh(np.zeros((1, 3)), np.zeros((1, 3), np.int64), False)


def protrusion(body: Body, mesh: Mesh, count: int) -> float:
    """How far points on the pieces' surfaces, at random by area, are outside of a solid mesh at most."""
    corners = np.concatenate([piece.vertices[piece.triangles] for piece in body.pieces])
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    rng = np.random.default_rng(3)
    weights = rng.dirichlet(np.ones(3), count)
    points = np.einsum("nk,nki->ni", weights, corners[rng.choice(len(corners), count, p=area / area.sum())])
    points = np.concatenate([points, *(piece.vertices for piece in body.pieces)])
    outside = windings(mesh, points) < 0.5
    return float(distances_of_points(mesh, points[outside]).max(initial=0.0))


def windings(mesh: Mesh, points: Array) -> Array:
    """How often a mesh winds around points, by the solid angles of its triangles; Van Oosterom and Strackee (1983)."""
    corners = mesh.vertices[mesh.faces]
    found = []
    for part in np.array_split(points, max(1, len(points) * len(corners) // 1_000_000)):
        a, b, c = np.moveaxis(corners[None] - part[:, None, None], 2, 0)
        la, lb, lc = (np.linalg.norm(x, axis=2) for x in (a, b, c))
        volume = np.einsum("nki,nki->nk", a, np.cross(b, c))
        ab, bc, ca = (np.einsum("nki,nki->nk", x, y) for x, y in ((a, b), (b, c), (c, a)))
        found.append(np.arctan2(volume, la * lb * lc + ab * lc + bc * la + ca * lb).sum(axis=1) / (2 * np.pi))
    return np.concatenate(found)


if __name__ == "__main__":
    sys.exit(main())
