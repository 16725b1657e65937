"""The libraries we run beside: Coal from Python and in a C++ loop, python-fcl."""

from __future__ import annotations

import hashlib
import itertools
import os
import shutil
import subprocess
from collections.abc import Iterator
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from clock import Cost, Measure, timed
from samples import Array, Pairs

SOURCE = Path(__file__).with_name("coal_loop.cpp")


class Missing(Exception):
    """A rival that cannot run here; the message says what it lacks and is shown in the table."""


# -- Coal in a C++ loop ------------------------------------------------------------------------


def build_loop(folder: Path) -> Path:
    """Compile `coal_loop.cpp` against the wheels of Coal and Eigen, unless this very program is there already."""
    compiler = os.environ.get("CXX") or next(filter(shutil.which, ("g++", "clang++", "c++")), None)
    if compiler is None:
        raise Missing("no C++ compiler")
    if find_spec("coal") is None:
        raise Missing("package coal is not installed")
    import coal

    prefix = Path(coal.__file__).parents[4]
    eigen = prefix / "include" / "eigen3"
    if not (prefix / "include" / "coal").is_dir() or not eigen.is_dir():
        raise Missing("no C++ headers of Coal or Eigen (pip install cmeel-eigen)")
    # Alignment as in the library, which is built for plain x86-64.
    flags = ["-std=c++17", "-O3", "-DNDEBUG", "-march=native", "-DEIGEN_MAX_ALIGN_BYTES=16"]
    paths = [
        f"-I{prefix / 'include'}",
        f"-I{eigen}",
        f"-L{prefix / 'lib'}",
        "-lcoal",
        "-Xlinker",
        "-rpath",
        "-Xlinker",
        str(prefix / "lib"),
    ]
    key = hashlib.sha256(repr((SOURCE.read_bytes(), compiler, flags, paths, coal.__version__)).encode()).hexdigest()
    program = folder / f"coal_loop-{key[:12]}"
    if not program.exists():
        folder.mkdir(parents=True, exist_ok=True)
        half = program.with_suffix(f".{os.getpid()}")
        made = subprocess.run([compiler, *flags, str(SOURCE), "-o", str(half), *paths], capture_output=True, text=True)
        if made.returncode:
            raise Missing(f"{compiler} could not build coal_loop.cpp: {made.stderr.strip().splitlines()[0]}")
        half.replace(program)
    return program


@dataclass(frozen=True)
class Settings:
    """One way to ask Coal, in the numbers that coal_loop.cpp takes."""

    query: str
    variant: int = 0
    criterion: int = 0
    type: int = 0
    guess: int = 0
    early: int = 0

    def __str__(self) -> str:
        words = [
            self.query.split("-", 1)[1],
            ("default GJK", "Polyak", "Nesterov")[self.variant],
            ("default criterion", "duality gap", "hybrid")[self.criterion],
            ("relative", "absolute")[self.type],
            ("default guess", "cached guess", "bounding volume guess")[self.guess],
        ]
        return ", ".join(words + ["early out"] * self.early)


def all_settings(*queries: str, early: tuple[int, ...] = (0, 1)) -> list[Settings]:
    return [Settings(*s) for s in itertools.product(queries, range(3), range(3), range(2), range(3), early)]


class CoalLoop:
    """The C++ program, loaded with pairs and waiting for orders; ends with the `with` block."""

    def __init__(self, program: Path, p: Pairs, folder: Path) -> None:
        self.pairs = p
        self.folder = folder
        folder.mkdir(parents=True, exist_ok=True)
        self._selections = 0
        data = folder / f"pairs-{os.getpid()}.bin"
        with open(data, "wb") as out:
            for array in _loop_data(p):
                array.tofile(out)
        self._process = subprocess.Popen([program, data], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        ready = self._read()
        data.unlink()
        if ready != "ready":
            raise Missing("coal_loop did not start")

    def __enter__(self) -> CoalLoop:
        return self

    def __exit__(self, *_: object) -> None:
        self._process.stdin.close()
        self._process.wait(timeout=60)
        for left in self.folder.glob(f"*-{os.getpid()}-*.bin"):
            left.unlink()

    def _read(self) -> str:
        return self._process.stdout.readline().strip()

    def _ask(self, line: str) -> Cost:
        print(line, file=self._process.stdin, flush=True)
        answer = self._read().split()
        if len(answer) != 3:
            raise RuntimeError(f"coal_loop stopped at: {line}")
        wall, cpu, count = map(int, answer)
        return Cost(wall * 1e-9 / count, cpu * 1e-9 / count)

    def select(self, chosen: Array | None) -> str:
        """Hand over a choice of pair numbers, to be named in later calls."""
        if chosen is None:
            return "-"
        self._selections += 1
        path = self.folder / f"chosen-{os.getpid()}-{self._selections}.bin"
        np.asarray(chosen, dtype=np.int64).tofile(path)
        return str(path)

    def measure(self, s: Settings, selection: str = "-", answers: str = "-", task: str = "pairs") -> Cost:
        numbers = f"{s.variant} {s.criterion} {s.type} {s.guess} {s.early}"
        return self._ask(f"{task} {s.query} {numbers} {selection} {answers}")

    def measured(self, s: Settings, selection: str = "-", task: str = "pairs") -> Measure:
        return lambda: self.measure(s, selection, task=task)

    def answers(self, s: Settings, selection: str = "-", task: str = "pairs") -> Array:
        """Booleans; for a distance rows of distance, two witnesses, normal; for a crowd pairs of numbers."""
        path = self.folder / f"answers-{os.getpid()}-0.bin"
        self.measure(s, selection, str(path), task)
        if task in ("crowd", "step"):
            return np.fromfile(path, dtype=np.int64).reshape(-1, 2)
        if s.query.endswith(("collide", "solver")):
            return np.fromfile(path, dtype=np.int8).astype(bool)
        return np.fromfile(path).reshape(-1, 10)


def _loop_data(p: Pairs) -> Iterator[Array]:
    packed = p.bodies._packed  # vertices and triangles end to end; the public pieces would be 200,000 objects
    layout = packed.layout
    vertex_start = np.append(layout[:, 1], len(packed.points))
    if not (np.diff(p.bodies.piece_start) == 1).all() or not (vertex_start[1:] == layout[:, 2]).all():
        raise ValueError("coal_loop takes bodies of one polytope each")
    sizes = [len(p.bodies), len(packed.points), len(packed.triangles), len(p)]
    outer = p.bodies.outer
    yield np.array(sizes, dtype=np.int64)
    for integers in (vertex_start, packed.triangle_start):
        yield integers.astype(np.int64)
    yield packed.points
    yield packed.triangles.astype(np.int64)
    yield outer.center
    yield outer.semi_axes
    yield np.ascontiguousarray(outer.rotation)
    for integers in (p.a, p.b):
        yield integers.astype(np.int64)
    yield p.Ta
    yield p.Tb


# -- from Python -------------------------------------------------------------------------------


class CoalPython:
    """Coal called pair by pair from Python; all its objects are made beforehand."""

    def __init__(self, p: Pairs) -> None:
        if find_spec("coal") is None:
            raise Missing("package coal is not installed")
        import coal

        self._collide, self._distance = coal.collide, coal.distance
        hulls = {int(i): _coal_hull(coal, p, int(i)) for i in np.unique([p.a, p.b])}
        self._calls = [
            (hulls[int(i)], coal.Transform3s(A[:3, :3], A[:3, 3]), hulls[int(j)], coal.Transform3s(B[:3, :3], B[:3, 3]))
            for i, A, j, B in zip(p.a, p.Ta, p.b, p.Tb, strict=True)
        ]
        self._request, self._result = coal.CollisionRequest(), coal.CollisionResult()
        self._request.enable_contact = False
        self._request.distance_upper_bound = 0.0
        self._request.gjk_initial_guess = coal.GJKInitialGuess.BoundingVolumeGuess
        self._signed, self._nearest = coal.DistanceRequest(), coal.DistanceResult()

    def collide(self) -> list[bool]:
        """Boolean answers, with early out and the bounding volumes' guess."""
        collide, request, result = self._collide, self._request, self._result
        out = []
        for a, A, b, B in self._calls:
            result.clear()
            out.append(collide(a, A, b, B, request, result) > 0)
        return out

    def distance(self) -> list[float]:
        """Signed distances."""
        distance, request, result = self._distance, self._signed, self._nearest
        out = []
        for a, A, b, B in self._calls:
            result.clear()
            out.append(distance(a, A, b, B, request, result))
        return out

    def measured(self, query: str) -> Measure:
        return timed(getattr(self, query), len(self._calls))


def _coal_hull(coal: Any, p: Pairs, i: int) -> Any:
    points = coal.StdVec_Vec3s()
    points.extend(p.bodies[i].pieces[0].vertices)
    hull = coal.Convex.convexHull(points, True, None)
    hull.computeLocalAABB()
    return hull


class FclPython:
    """python-fcl, with its default solver."""

    def __init__(self, p: Pairs) -> None:
        if find_spec("fcl") is None:
            raise Missing("package python-fcl is not installed")
        import fcl

        self._fcl = fcl
        hulls = {int(i): _fcl_hull(fcl, p, int(i)) for i in np.unique([p.a, p.b])}

        def placed(i: int, T: Array) -> Any:
            return fcl.CollisionObject(hulls[int(i)], fcl.Transform(T[:3, :3], T[:3, 3]))

        self._calls = [
            (placed(i, A), placed(j, B)) for i, A, j, B in zip(p.a, p.Ta, p.b, p.Tb, strict=True)
        ]  # fmt: skip
        self._request = fcl.CollisionRequest()

    def collide(self) -> list[bool]:
        collide, request, fresh = self._fcl.collide, self._request, self._fcl.CollisionResult
        return [collide(a, b, request, fresh()) > 0 for a, b in self._calls]

    def measured(self, query: str) -> Measure:
        return timed(getattr(self, query), len(self._calls))


def _fcl_hull(fcl: Any, p: Pairs, i: int) -> Any:
    piece = p.bodies[i].pieces[0]
    faces = np.column_stack([np.full(len(piece.triangles), 3), piece.triangles]).astype(np.int32)
    return fcl.Convex(piece.vertices, len(piece.triangles), faces.ravel())
