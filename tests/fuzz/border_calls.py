"""Every public callable, with arguments that are right, and the values that are bad for most of them.

A callable is a `Call`: what it is, and a right argument of each parameter, as an `Arg`. That says too which of the bad
values are right for this parameter after all, since a name may be any text and a margin may be 0.
"""

from __future__ import annotations

import contextlib
import dataclasses
import enum
import inspect
import io
import json
import os
import shutil
import sys
import typing
import warnings
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from decimal import Decimal
from fractions import Fraction
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import octomap
import pinocchio
import pytest

import loewner
from families import box_corners, translation
from gantry import gantry
from loewner import (  # fmt: skip
    Bodies,
    Body,
    CollisionChecker,
    Ellipsoids,
    LoewnerError,
    PosePath,
    Robot,
    Scene,
    cli,
    judging,
    paper,
    planners,
    reproductions,
)
from loewner import cluster as clustering
from loewner import depth as depths
from loewner import gpu as on_gpus
from loewner import jax as for_jax
from loewner import plots as drawing
from loewner import torch as for_torch
from loewner import viewer as viewing
from loewner.cli import compilation as compiling
from loewner.meshes import decomposition as meshes  # fmt: skip
from loewner.queries.pose_paths import path_of

# Modules for frameworks that are there.
OF_DRAKE = ("Robot.from_drake", "planners.Trajectory.to_drake")
FRAMEWORKS = {name: module for name, module in {"jax": for_jax, "torch": for_torch}.items() if find_spec(name)}

# -- bad values ----------------------------------------------------------------------------------------------------


class Sulky:
    """An object that fails at whatever it is asked."""

    def __fail(self, *_: object, **__: object) -> None:
        raise RuntimeError("not today")

    __float__ = __index__ = __array__ = __bool__ = __len__ = __iter__ = __getitem__ = __repr__ = __fspath__ = __fail
    __eq__ = __fail  # type: ignore[assignment]
    __hash__ = None  # type: ignore[assignment]


class Text(str):
    """A child of str."""


class Frame:
    """An object that makes an array of itself, as a data frame does."""

    def __init__(self, array: np.ndarray) -> None:
        self.array = array

    def __array__(self, dtype: Any = None, copy: Any = None) -> np.ndarray:
        return np.array(self.array, dtype=dtype)


def _closed_file() -> object:
    with open(os.devnull, "rb") as stream:
        pass
    return stream


def _self_containing() -> list[Any]:
    x: list[Any] = []
    x.append(x)
    return x


# Name: how it is made. Numbers that some parameters take stand first.
BAD: dict[str, Callable[[], Any]] = {
    "0": lambda: 0,
    "-0.0": lambda: -0.0,
    "-1": lambda: -1,
    "1.5": lambda: 1.5,
    "1e308": lambda: 1e308,
    "5e-324": lambda: 5e-324,
    "2**70": lambda: 2**70,
    "10**400": lambda: 10**400,
    "-10**400": lambda: -(10**400),
    "NaN": lambda: float("nan"),
    "inf": lambda: float("inf"),
    "-inf": lambda: -np.inf,
    "float32 NaN": lambda: np.float32("nan"),
    "Decimal NaN": lambda: Decimal("NaN"),
    "Fraction": lambda: Fraction(1, 2),
    "complex": lambda: 1j,
    "True": lambda: True,
    "False": lambda: False,
    "NumPy True": lambda: np.True_,
    "None": lambda: None,
    "Ellipsis": lambda: ...,
    "NotImplemented": lambda: NotImplemented,
    "text of a number": lambda: "1",
    "text nan": lambda: "nan",
    "text": lambda: Text("what"),
    "empty text": lambda: "",
    "NUL": lambda: "a\0b",
    "surrogate": lambda: "\ud800",
    "long text": lambda: "x" * 3000,
    "bytes": lambda: b"1",
    "bytearray": lambda: bytearray(b"1"),
    "folder": Path.cwd,
    "missing file": lambda: Path("missing", "file.npz"),
    "empty list": list,
    "empty tuple": tuple,
    "empty dict": dict,
    "empty set": set,
    "empty generator": lambda: (x for x in ()),
    "generator": lambda: (x for x in (1.0, "a")),
    "list of None": lambda: [None],
    "list of text": lambda: ["a", "b"],
    "ragged lists": lambda: [[1.0, 2.0], [3.0]],
    "list in itself": _self_containing,
    "dict of numbers": lambda: {"a": 1.0},
    "masked": lambda: np.ma.masked,
    "empty (0, 3)": lambda: np.empty((0, 3)),
    "empty (3, 0)": lambda: np.empty((3, 0)),
    "5 axes": lambda: np.ones((1, 1, 1, 1, 1)),
    "array of None": lambda: np.full((4, 4), None),
    "array of text": lambda: np.full((4, 4), "1"),
    "array of booleans": lambda: np.eye(4, dtype=bool),
    "records": lambda: np.rec.fromarrays([[1.0, 2.0], [1, 2]], names="x,y"),
    "date": lambda: np.datetime64("2026-01-01"),
    "100,000 zeros": lambda: np.broadcast_to(0.0, (100_000, 7)),
    "object": object,
    "object that fails": Sulky,
    "type": lambda: float,
    "function": lambda: lambda *arguments: None,
    "closed file": _closed_file,
    "Body": lambda: ball(),
    "Bodies": lambda: Bodies([ball(), ball()]),
    "Ellipsoids": lambda: ball().outer,
    "Scene": Scene,
    "Robot": lambda: robot(),
}

# What an array that is right can be spoilt by. A name that begins with "=": it says the same numbers, another way.
SPOILT: dict[str, Callable[[np.ndarray], Any]] = {
    "one NaN": lambda x: _with(x, np.nan),
    "one inf": lambda x: _with(x, np.inf),
    "one 1e308": lambda x: _with(x, 1e308),
    "one 5e-324": lambda x: _with(x, 5e-324),
    "one masked": lambda x: np.ma.array(x, mask=_with(np.zeros(x.shape), 1.0) > 0),
    "all as text": lambda x: x.astype(str),
    "all as bytes": lambda x: x.astype("S"),
    "all as booleans": lambda x: x.astype(bool),
    "all as complex numbers": lambda x: x.astype(complex),
    "all as dates": lambda x: x.astype("datetime64[s]"),
    "all None": lambda x: np.full(x.shape, None),
    "one integer beyond floats": lambda x: _with(x.astype(object), 10**400),
    "without the last column": lambda x: x[..., :-1],
    "without the first row": lambda x: x[1:],
    "a column more": lambda x: np.concatenate([x, x[..., :1]], axis=-1),
    "turned over": lambda x: x.T.copy(),
    "two axes more": lambda x: x[None, None],
    "none of them": lambda x: x[:0],
    "a number alone": lambda x: x.flat[0],
    "in a dict": lambda x: dict(enumerate(x.tolist())),
    "as a set": lambda x: set(x.flat),
    "as a generator": lambda x: (row for row in x),
    "=list": lambda x: x.tolist(),
    "=tuple": lambda x: tuple(x),
    "=Fortran order": np.asfortranarray,
    "=big-endian": lambda x: x.astype(x.dtype.newbyteorder(">")),
    "=negative strides": lambda x: x[::-1].copy()[::-1],
    "=every second": lambda x: np.repeat(x, 2, axis=-1)[..., ::2],
    "=broadcast": lambda x: np.broadcast_to(x, x.shape),
    "=read-only": lambda x: _read_only(x),
    "=not aligned": lambda x: np.frombuffer(b"x" + x.tobytes(), dtype=np.uint8)[1:].view(x.dtype).reshape(x.shape),
    "=objects": lambda x: x.astype(object),
    "=masked array without a mask": np.ma.array,
    "=a frame": Frame,
}
# Of floats only: the numbers below are multiples of 1/8, so that these lose nothing.
SPOILT_FLOATS: dict[str, Callable[[np.ndarray], Any]] = {
    "=float32": lambda x: x.astype(np.float32),
    "=float16": lambda x: x.astype(np.float16),
    "=longdouble": lambda x: x.astype(np.longdouble),
    "=fractions": lambda x: np.vectorize(Fraction, otypes=[object])(x),
}


def _with(x: np.ndarray, value: Any) -> np.ndarray:
    x = x.copy() if x.dtype.kind in "fO" else x.astype(float)
    x.flat[0] = value
    return x


def _read_only(x: np.ndarray) -> np.ndarray:
    x = x.copy()
    x.setflags(write=False)
    return x


# -- right arguments -----------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Arg:
    """A right argument: how it is made, which of the bad values are right too, and which of the spoilt arrays."""

    make: Callable[[], Any]
    takes: frozenset[str] = frozenset()
    array: bool = False
    skips: frozenset[str] = frozenset()


@dataclass(frozen=True)
class Call:
    """A public callable, called with all arguments by name."""

    ask: Callable[..., Any]
    arguments: dict[str, Arg]
    # The answer need not be the same twice: there are times in it.
    varies: bool = False


NUMBERS = frozenset({"1.5", "1e308", "5e-324", "2**70", "Fraction"})
ZERO = frozenset({"0", "-0.0"})
NEGATIVE = frozenset({"-1"})
NONE = frozenset({"None"})
TEXTS = frozenset({"text of a number", "text nan", "text", "NUL", "surrogate", "long text"})
# Texts of plain letters and digits.
NUMERAL = frozenset({"text of a number", "text nan", "text"})
# A scene without bodies is a sequence of no names.
NOTHING = frozenset(
    {"empty list", "empty tuple", "empty dict", "empty set", "empty generator", "empty (0, 3)", "Scene"}
)
# What a message calls an argument may be anything.
LABEL = frozenset(BAD) - {"object that fails"}
# An object that makes an array of itself is no list of arrays.
FRAME = frozenset({"=a frame"})
FLAGS = frozenset({"True", "False", "NumPy True"})
# Numbers that a spoilt array may hold, and shapes that a batch may have.
FINITE = frozenset({"one 1e308", "one 5e-324"})
BATCHES = frozenset({"two axes more", "none of them", "without the first row"})


def arg(value: Any, *takes: frozenset[str] | str, **more: Any) -> Arg:
    """An argument, made anew for each call if it is made by a function."""
    names = frozenset().union(*(t if isinstance(t, frozenset) else frozenset({t}) for t in takes))
    return Arg(value if callable(value) else (lambda: value), names, **more)


def positive(value: Any = 0.5, *takes: Any) -> Arg:
    return arg(value, NUMBERS, *takes)


def margin(value: Any = 0.125, *takes: Any) -> Arg:
    return arg(value, NUMBERS, ZERO, *takes)


def count(value: Any, *takes: Any) -> Arg:
    return arg(value, *takes)


def flag(value: bool = True) -> Arg:
    return arg(value, FLAGS)


def choice(value: str) -> Arg:
    return arg(value)


def callback() -> Arg:
    return arg(None, NONE, "function", skips=frozenset({"type"}))  # a type is called, and fails in its own way


def array(value: Any, *takes: Any, **more: Any) -> Arg:
    numbers = np.asarray(value)
    return arg(lambda: numbers.copy(), *takes, array=True, **more)


def pose(x: float = 0.0, *takes: Any) -> Arg:
    return array(translation(x), NONE, FINITE, "turned over", *takes)


def poses(*takes: Any) -> Arg:
    T = np.tile(np.eye(4), (2, 1, 1))
    T[1, 0, 3] = 3.0
    return array(T, NONE, FINITE, BATCHES, *takes)


@cache
def ball() -> Body:
    return Body.sphere(0.5)


@cache
def cube() -> Body:
    return Body.from_points(CUBE)


@cache
def pair_of_cubes() -> Bodies:
    return Bodies([cube(), cube()])


@cache
def robot() -> Robot:
    return Robot.from_urdf("gantry.urdf", srdf="gantry.srdf")


def scene() -> Scene:
    made = Scene(margin=0.125)
    made.add("post", ball(), translation(2.0))
    made.add("can", ball(), translation(4.0))
    made.add("box", cube(), translation(8.0))
    made.attach("can", "rod", translation(1.0))
    made.allow("post", "box")
    return made


def checker() -> CollisionChecker:
    return CollisionChecker(robot(), scene())


def checker_in_time() -> CollisionChecker:
    """A checker in whose scene a body follows a motion."""
    moving = scene().copy()
    moving.add("part", ball(), translation(50.0))
    moving.follow("part", [0.0, 1.0], np.stack([translation(50.0), translation(51.0)]))
    return CollisionChecker(robot(), moving)


def two_robots() -> CollisionChecker:
    return CollisionChecker(Robot.join({"a": robot(), "b": robot()}, {"b": translation(50.0)}))


def judgement() -> judging.Judgement:
    return judging.judge_answers(cube(), None, ball(), None, colliding=[True, False])


def seen_space() -> depths.SeenSpace:
    """Cells around the robot, some of them seen."""
    space = depths.SeenSpace([-0.5, -0.5, 0.5], (4, 4, 4), 0.25)
    space.see(np.full((24, 32), 2.0), [[20.0, 0.0, 15.5], [0.0, 20.0, 11.5], [0.0, 0.0, 1.0]])
    return space


def pose_path() -> PosePath:
    return path_of([0.0, 1.0], np.stack([translation(), translation(1.0)]), False)


def moved() -> planners.Trajectory:
    return planners.trajectory(robot(), PATH, velocity=1.0)


def footprint(bounds: Any = None) -> Robot:
    return Robot.footprint([[0.5, 0.25], [-0.5, 0.25], [-0.5, -0.25], [0.5, -0.25]], height=0.5, bounds=bounds)


def driven() -> planners.Drive:
    return planners.Drive.of(footprint(), [0.0, 0.0, 0.0], [[1.0, 0.5]])


def gate() -> planners.Gate:
    made = planners.Gate(checker(), acceleration=1.0)
    made.check(PATH[0], np.zeros(3), [PATH[0], PATH[0]], 0.5)
    return made


def proof() -> loewner.Proof:
    made: loewner.Proof = checker().certify_edges(PATH[0], PATH[0], proof=True).proof
    return made


def joint_limits() -> planners.JointLimits:
    return planners.JointLimits.load("limits.yaml", robot())


def pose_goal() -> planners.PoseGoal:
    return planners.PoseGoal("ball", translation(-0.5, 0.5), approach=[0.0, 0.125, 0.0], retreat=[0.0, -0.125, 0.0])


def roadmap() -> planners.Roadmap:
    return planners.roadmap(checker(), 20, joints="y", fixed=[-0.5, 0.25, 0.0])


@cache
def experiment() -> paper.Experiment:
    return paper.run(20)


def client() -> Any:
    """What passes for a client of Dask: a real one has threads and locks, which do not survive a fork."""
    import distributed

    class Here(distributed.Client):
        asynchronous, status = False, "running"

        def __init__(self) -> None:
            pass

        __del__ = __init__

    return Here()


def fit_here(**arguments: Any) -> clustering.Fitted:
    """`cluster.fit`, with the tasks of its workers done by this process one after the other."""

    def outcomes(_: Any, targets: Mapping[Path, Path], options: dict[str, Any], progress: Any) -> dict[Path, Any]:
        return {m: clustering._fit_one(str(m.absolute()), str(t.absolute()), options, "") for m, t in targets.items()}

    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(clustering, "_outcomes", outcomes)
        return clustering.fit(**arguments)


def in_chunks() -> Any:
    import dask.array

    return dask.array.from_array(np.array(Q), chunks=1)


def flat_axes() -> Any:
    from matplotlib.figure import Figure

    return Figure().add_subplot()


def axes_in_space() -> Any:
    from matplotlib.figure import Figure

    return Figure().add_subplot(projection="3d")


CUBE = box_corners(np.ones(3))
TRIANGLES = """f 1 3 4
f 1 4 2
f 5 6 8
f 5 8 7
f 1 2 6
f 1 6 5
f 3 7 8
f 3 8 4
f 1 5 7
f 1 7 3
f 2 4 8
f 2 8 6
"""


def clean() -> None:
    """Take away what earlier calls wrote into the working directory, which must be the one of `write_files`."""
    if [Path.cwd()] != PLACE:
        raise RuntimeError(f"expected the folder of write_files, found {Path.cwd()}, which would be emptied")
    for entry in os.scandir():
        if entry.name not in FILES:
            shutil.rmtree(entry.path) if entry.is_dir() else os.unlink(entry.path)


FILES: set[str] = set()
PLACE: list[Path] = []


def write_files() -> None:
    """What the calls below read, into the working directory, which is emptied of all else between calls."""
    PLACE[:] = [Path.cwd()]
    gantry(Path())
    Path("part.obj").write_text("".join(f"v {x} {y} {z}\n" for x, y, z in CUBE) + TRIANGLES)
    cube().save("part.npz")
    tree = octomap.OcTree(0.5)
    tree.updateNode(np.array([0.25, 0.25, 0.25]), True)
    tree.writeBinary(b"map.bt")
    pair_of_cubes().save("parts.npz")
    roadmap().save("roadmap.npz")
    loewner.save_scene(scene(), "scene.yaml")
    Path("floor.pgm").write_bytes(b"P5 2 2 255\n\x00\xff\xcd\xff")
    Path("floor.yaml").write_text(
        "{image: floor.pgm, resolution: 0.5, origin: [0, 0, 0], negate: 0, occupied_thresh: 0.65, free_thresh: 0.196}"
    )
    problem = {
        "index": 1,
        "sphere": [{"name": "a", "position": [9, 0, 0], "orientation_euler_xyz": [0, 0, 0], "radius": 0.5}],
        "start": [0.0, 0.0],
        "goals": [[0.5, 0.5]],
        "valid": True,
    }
    Path("problems.json").write_text(
        json.dumps({"robot": "gantry", "joints": ["x", "y"], "problems": {"g": [problem]}})
    )
    Path("pole.xml").write_text("<mujoco><worldbody><body><joint/><geom size='0.5'/></body></worldbody></mujoco>")
    np.save("configs.npy", np.zeros((2, 3)))
    Path("balls.json").write_text(
        json.dumps({link: {"centers": [[0, 0, 0]], "radii": [1]} for link in ("ball", "rod")})
    )
    moved().save("moved.json")
    proof().save("plan.proof")
    Path("limits.yaml").write_text("joint_limits: {x: {max_velocity: 1.0, max_jerk: 9.0}}")
    FILES.update(os.listdir())


# -- the calls -----------------------------------------------------------------------------------------------------


def on(make: Callable[[], Any], method: str) -> Callable[..., Any]:
    """A method of an object that is made anew for each call; the object is part of the answer."""

    def ask(**arguments: Any) -> Any:
        made = make()
        return getattr(made, method)(**arguments), made

    return ask


def item(make: Callable[[], Any]) -> Callable[..., Any]:
    return lambda index: make()[index]


class Reached(Exception):
    """A page would have been served: all arguments were accepted."""


def page(show: Callable[..., Any]) -> Callable[..., Any]:
    """The function that shows a page, up to where it would listen."""

    def ask(**arguments: Any) -> str:
        import viser

        def reached(*_: Any, **__: Any) -> None:
            raise Reached

        viser.ViserServer = reached  # in this process alone, which is a child
        try:
            show(**arguments)
        except Reached:
            return "served"
        raise AssertionError("expected the page to be served at the end")

    return ask


def quietly(ask: Callable[..., Any]) -> Callable[..., Any]:
    """The same without warnings."""

    def asked(**arguments: Any) -> Any:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return ask(**arguments)

    return asked


class Refused(LoewnerError):
    """The command line said what is wrong, on standard error, and ended with status 2."""


def command(arguments: Any) -> str:
    """The command line; its status and what it writes."""
    out = io.TextIOWrapper(io.BytesIO(), "utf-8", errors="strict", write_through=True)
    err = io.TextIOWrapper(io.BytesIO(), "utf-8", errors="backslashreplace", write_through=True)
    sys.argv = ["loewner", "check", "part.npz", "part.npz"]
    try:
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            status = cli.main(arguments)
    except SystemExit as end:  # argparse
        status = end.code
    said = err.buffer.getvalue().decode()  # type: ignore[attr-defined]
    if status == 2 and "error" in said and "Traceback" not in said:
        raise Refused(said)
    if status not in (0, 1, 3):
        raise AssertionError(f"status {status!r}: {said}")
    return f"{status}\n{out.buffer.getvalue().decode()}"  # type: ignore[attr-defined]


def line(*words: str) -> Callable[..., str]:
    """A command line whose words in capitals are parameters."""

    def ask(**arguments: Any) -> str:
        return command([arguments[word.lower()] if word.isupper() else word for word in words])

    return ask


def word(value: str, *takes: Any) -> Arg:
    """A word of a command line."""
    return arg(value, *takes)


E3 = dict(E1=arg(lambda: ball().outer, "Ellipsoids"), E2=arg(lambda: cube().outer, "Ellipsoids"))  # noqa: C408
OPERANDS = {
    "a": arg(cube, "Body", "Bodies"),
    "T_world_a": poses("100,000 zeros"),
    "b": arg(ball, "Body", "Bodies"),
    "T_world_b": pose(0.5, BATCHES),
}
ROWS = array(
    np.array([[0, 0], [1, 0]]), NONE, BATCHES, "empty (3, 0)", NOTHING - {"empty dict", "empty set", "empty generator"}
)
# Other values of the right shapes that stand for no answer, or for one answer about all pairs.
NO_ANSWER = ("NaN", "float32 NaN", "5 axes", "without the last column", "a number alone")
Q = [[0.5, 0.25, 0.125], [-0.5, 0.25, 0.0]]
CONFIGURATIONS = array(Q, FINITE, BATCHES, "empty (0, 3)", "turned over")
ONE = array(Q[0], FINITE)
IMAGE = {
    "image": array(np.full((3, 4), 2.0), FINITE, "one NaN", "one inf", "without the last column",
                   "without the first row", "a column more", "turned over", "100,000 zeros"),
    "K": array([[20.0, 0.0, 1.5], [0.0, 20.0, 1.0], [0.0, 0.0, 1.0]]),
    "T_world_camera": pose(0.0, NONE),
}  # fmt: skip
AT = array([0.25, 0.5], FINITE, NONE, NUMBERS, ZERO, NEGATIVE, BATCHES, "a number alone", "5 axes",
           "without the last column", "without the first row", "two axes more")  # fmt: skip


def _one_ellipsoid() -> Ellipsoids:
    return Ellipsoids.from_semi_axes([0.0, 0.0, 0.0], [1.0, 2.0, 3.0])


def _ellipsoids() -> Ellipsoids:
    return Ellipsoids.from_semi_axes(np.zeros((2, 3)), [1.0, 2.0, 3.0])


POINTS = array(CUBE, FINITE, "without the first row")
FLAT_POINTS = array(CUBE, FINITE, "without the first row", "without the last column")  # in the plane
TOL = arg(1e-4, "5e-324", "Fraction")
PATH_OUT = arg("out.npz", TEXTS)
PATH = [[-0.5, 0.25, 0.0], [-0.5, 0.5, 0.0], [-0.25, 0.5, 0.5]]
TIMES = array([[0.0, 0.125], [0.25, 0.5]], FINITE, BATCHES, ZERO, "5e-324", "Fraction", "1.5", "empty list",
              "empty tuple", "Scene", "empty (0, 3)", "empty (3, 0)", "5 axes", "100,000 zeros", "turned over",
              "without the last column", "a column more", "a number alone")  # fmt: skip
VECTORS = array([[1.0, 0.5, 0.25], [0.5, -0.25, 0.125]], FINITE, BATCHES, "empty (0, 3)")

CALLS: dict[str, Call] = {
    "get_num_threads": Call(loewner.get_num_threads, {}),
    "set_num_threads": Call(loewner.set_num_threads, {"n": count(2)}),
    # -- ellipsoids and fits
    "Ellipsoids": Call(
        Ellipsoids,
        {
            "center": array(np.zeros((2, 3)), FINITE, "one 1e308"),
            "factor": array(np.tile(np.eye(3), (2, 1, 1)), FINITE),
        },
    ),
    "Ellipsoids.from_shape_matrix": Call(
        Ellipsoids.from_shape_matrix,
        {"center": array(np.zeros(3), FINITE), "shape_matrix": array(np.eye(3) * 4, FINITE, "turned over")},
    ),
    "Ellipsoids.from_semi_axes": Call(
        Ellipsoids.from_semi_axes,
        {
            "center": array(np.zeros((2, 3)), FINITE, BATCHES, "empty (0, 3)"),
            "semi_axes": array([3.0, 2.0, 1.0], FINITE, BATCHES),
            "rotation": array(np.eye(3), NONE, FINITE, BATCHES, "turned over"),
        },
    ),
    "Ellipsoids.support": Call(on(_ellipsoids, "support"), {"direction": VECTORS}),
    "Ellipsoids.contains": Call(on(_ellipsoids, "contains"), {"points": VECTORS}),
    "Ellipsoids.transformed": Call(on(_ellipsoids, "transformed"), {"T": poses()}),
    "Ellipsoids.affine": Call(
        on(_ellipsoids, "affine"),
        {"A": array(np.eye(3) * 2, FINITE, BATCHES, "turned over"), "b": array([1.0, 2.0, 3.0], FINITE, BATCHES)},
    ),
    "Ellipsoids.bounding_box": Call(on(_ellipsoids, "bounding_box"), {}),
    "Ellipsoids.__getitem__": Call(
        item(_ellipsoids),
        {"index": arg(1, "0", "-1", "None", "Ellipsis", FLAGS, "empty list", "empty tuple", "Scene")},
    ),
    "mvce": Call(
        loewner.mvce,
        {
            "points": FLAT_POINTS,
            "tol": TOL,
            "center": array(np.zeros(3), NONE, NUMBERS, ZERO, NEGATIVE, "a number alone", "one 5e-324"),
            "weights": flag(),
            "progress": callback(),
        },
    ),
    "mvie": Call(
        loewner.mvie,
        {
            "A": array(np.concatenate([np.eye(3), -np.eye(3)]), FINITE, "without the last column"),
            "b": array(np.ones(6), NONE, FINITE),
            "tol": TOL,
            "center": array(np.zeros(3), NONE, NUMBERS, ZERO, NEGATIVE, "a number alone", "one 5e-324"),
            "progress": callback(),
        },
    ),
    "Polytope.from_points": Call(loewner.Polytope.from_points, {"points": FLAT_POINTS}),
    "Polytope.from_halfspaces": Call(
        loewner.Polytope.from_halfspaces,
        {
            "A": array(np.concatenate([np.eye(3), -np.eye(3)]), FINITE, "without the last column"),
            "b": array(np.ones(6), FINITE),
        },
    ),
    "overlap": Call(loewner.overlap, {**E3}),
    "contact_function": Call(loewner.contact_function, E3),
    "near_points": Call(loewner.near_points, {**E3, "method": choice("lin-han"), "angle": positive(0.125)}),
    # -- bodies
    "Body.from_points": Call(Body.from_points, {"points": POINTS, "tol": TOL}),
    "Body.from_pieces": Call(
        Body.from_pieces,
        {
            "point_sets": array([CUBE, CUBE + 2], FINITE, "without the first row", "as a generator", skips=FRAME),
            "tol": TOL,
        },
    ),
    "Body.from_mesh": Call(
        Body.from_mesh,
        {
            "source": arg("part.obj"),
            "decompose": flag(False),
            "tol": TOL,
            "scale": arg(2.0, NUMBERS, NEGATIVE),
            "cover": flag(),
            "tolerance": positive(0.25, NONE),
            "threshold": arg(0.125, "Fraction"),
            "max_pieces": count(3, NONE),
            "seed": count(1, "0", "2**70"),
            "progress": callback(),
        },
    ),
    "Body.from_surface": Call(
        Body.from_surface,
        {
            "source": arg("part.obj"),
            "radius": positive(0.25, ZERO),
            "solid": arg(True, FLAGS, NONE),
            "scale": arg(2.0, NUMBERS, NEGATIVE),
        },
    ),
    "Body.spheres": Call(
        Body.spheres,
        {
            "centers": array([[0.0, 0, 0], [1, 0, 0]], FINITE),
            "radii": array([0.5, 0.25], FINITE, NUMBERS, "a number alone"),
        },
    ),
    "Body.boxes": Call(
        Body.boxes,
        {
            "centers": array([[0.0, 0, 0], [1, 0, 0]], "one 5e-324"),
            "edges": array([[1.0, 2, 3], [1, 1, 1]], NUMBERS, "a number alone"),
        },
    ),
    "Body.from_cloud": Call(
        Body.from_cloud,
        {
            "points": array(CUBE, FINITE, "without the first row", "without the last row"),
            "radius": positive(0.25),
            "voxel": arg(None, NONE),
        },
    ),
    "Body.from_depth": Call(
        Body.from_depth,
        {
            **IMAGE,
            "radius": positive(0.25),
            "voxel": arg(None, NONE),
            "checker": arg(checker_in_time),
            "q": ONE,
            "clear": positive(0.125),
        },
    ),
    "Body.from_voxels": Call(
        Body.from_voxels,
        {"grid": arg(lambda: np.ones((2, 3, 4), bool)), "size": positive(), "origin": array([1.0, 2.0, 3.0], FINITE)},
    ),
    "Body.height_field": Call(
        Body.height_field,
        {
            "heights": array(
                [[0.0, 1, 0], [0, 0.5, 0]],
                FINITE,
                "100,000 zeros",
                "without the last column",
                "a column more",
                "turned over",
            ),
            "spacing": array([1.0, 2.0], FINITE, NUMBERS, "a number alone"),
            "base": arg(-1.0, NONE, NEGATIVE),
        },
    ),
    "Body.half_space": Call(
        Body.half_space,
        {"normal": array([0.0, 0.0, 1.0], FINITE), "offset": arg(1.0, NUMBERS, NEGATIVE, ZERO), "extent": positive()},
    ),
    "Body.from_octree": Call(Body.from_octree, {"path": arg("map.bt")}),
    "Body.box": Call(Body.box, {"size": array([1.0, 2.0, 3.0], FINITE)}),
    "Body.sphere": Call(Body.sphere, {"radius": positive()}),
    "Body.ellipsoid": Call(Body.ellipsoid, {"semi_axes": array([1.0, 2.0, 3.0], FINITE)}),
    "Body.cylinder": Call(Body.cylinder, {"radius": positive(), "length": positive()}),
    "Body.cone": Call(Body.cone, {"radius": positive(), "length": positive()}),
    "Body.capsule": Call(Body.capsule, {"radius": positive(), "length": positive()}),
    "Body.union": Call(Body.union, {"bodies": arg(lambda: [ball(), cube()], "Bodies")}),
    "Body.transformed": Call(on(cube, "transformed"), {"T": pose(1.0)}),
    "Body.covered_by": Call(
        on(cube, "covered_by"),
        {
            "model": arg(lambda: Body.box([4.0, 4, 4]), "Body"),
            "tolerance": positive(0.125, NONE),
            "progress": callback(),
        },
    ),
    "Body.cover": Call(
        on(cube, "cover"),
        {"kind": choice("boxes"), "n": count(1, "2**70"), "protrusion": arg(None, NONE), "progress": callback()},
    ),
    "Body.save": Call(on(cube, "save"), {"path": PATH_OUT}),
    "Body.to_mjcf": Call(
        on(cube, "to_mjcf"),
        {
            "path": arg("out.xml", NONE, TEXTS),
            "ellipsoids": arg("outer", NONE),
            "name": arg("cube", NUMERAL, "long text"),
        },
    ),
    "Body.to_urdf": Call(
        on(cube, "to_urdf"),
        {
            "path": arg("out.urdf", NUMERAL),
            "ellipsoids": arg("outer", NONE),
            "mesh_prefix": arg("", TEXTS, "empty text"),
        },
    ),
    "Body.to_stl": Call(on(cube, "to_stl"), {"path": arg("out.stl", NUMERAL)}),
    "Body.to_trimesh": Call(on(cube, "to_trimesh"), {"what": choice("pieces")}),
    "Body.load": Call(Body.load, {"path": arg("part.npz")}),
    "Bodies": Call(Bodies, {"bodies": arg(lambda: [ball(), cube()], NOTHING, "Bodies")}),
    "Bodies.from_points": Call(
        Bodies.from_points,
        {
            "point_sets": array(
                [CUBE, CUBE + 2],
                FINITE,
                "without the first row",
                "none of them",
                "as a generator",
                NOTHING,
                skips=FRAME,
            ),
            "tol": TOL,
            "progress": callback(),
        },
    ),
    "Bodies.spheres": Call(
        Bodies.spheres,
        {
            "radii": array(
                [1.0, 0.5],
                FINITE,
                "without the first row",
                "without the last column",
                "none of them",
                "a column more",
                "turned over",
                "empty list",
                "empty tuple",
                "Scene",
            )
        },
    ),
    "Bodies.ellipsoids": Call(
        Bodies.ellipsoids,
        {"semi_axes": array([[1.0, 2.0, 3.0]] * 2, FINITE, "without the first row", "none of them", "empty (0, 3)")},
    ),
    "Bodies.save": Call(on(pair_of_cubes, "save"), {"path": PATH_OUT}),
    "Bodies.load": Call(Bodies.load, {"path": arg("parts.npz")}),
    "Bodies.__getitem__": Call(
        item(pair_of_cubes), {"index": arg(1, "0", "-1", "empty list", "empty tuple", "Scene", "Ellipsis")}
    ),
    # -- queries
    "classify": Call(loewner.classify, {**OPERANDS, "margin": margin(), "pairs": arg(None, ROWS.takes)}),
    "collide": Call(
        loewner.collide,
        {
            **OPERANDS,
            "method": choice("exact"),
            "margin": margin(),
            "pairs": arg(None, ROWS.takes),
        },
    ),
    "distance": Call(
        loewner.distance,
        {**OPERANDS, "exact": flag(), "pairs": arg(None, ROWS.takes)},
    ),
    "judging.judge_answers": Call(
        judging.judge_answers,
        {
            **OPERANDS,
            **{
                name: array(value, NONE, FINITE, BATCHES, "one NaN", *more)
                for name, value, *more in (
                    ("colliding", [0.0, 1.0], "all as booleans", FLAGS, ZERO, *NO_ANSWER),
                    ("distance", [0.5, -0.25], NUMBERS, ZERO, NEGATIVE, *NO_ANSWER),
                    ("depth", [0.0, 0.25], NUMBERS, ZERO, *NO_ANSWER),
                    ("witness_a", [0.5, 0.0, 0.0]),
                    ("witness_b", [0.5, 0.0, 0.0]),
                    ("normal", [1.0, 0.0, 0.0]),
                )
            },
            "tolerance": margin(),
        },
    ),
    "judging.Judgement.counts": Call(lambda: judgement().counts(), {}),
    "judging.Judgement.worst": Call(lambda kind: judgement().worst(kind), {"kind": arg(None, NONE)}),
    "reproductions.reproduction": Call(
        reproductions.reproduction,
        {
            "a": arg(cube, "Body"),
            "T_world_a": pose(),
            "b": arg(cube, "Body"),
            "T_world_b": pose(3.0),
            "colliding": arg(True, FLAGS, NONE, ZERO, "NaN", "float32 NaN"),
            "distance": arg(0.5, NUMBERS, ZERO, NEGATIVE, NONE, "NaN", "float32 NaN"),
            "depth": arg(0.5, NUMBERS, ZERO, NONE, "NaN", "float32 NaN"),
            "witness_a": array([0.5, 0.0, 0.0], NONE, FINITE, "one NaN"),
            "witness_b": array([0.5, 0.0, 0.0], NONE, FINITE, "one NaN"),
            "normal": array([1.0, 0.0, 0.0], NONE, FINITE, "one NaN"),
            "tolerance": margin(),
            "engine": callback(),
        },
    ),
    "first_contact": Call(
        loewner.first_contact,
        {
            "a": OPERANDS["a"],
            "motion_a": pose(0.0, BATCHES),
            "b": OPERANDS["b"],
            "motion_b": arg(lambda: (translation(3.0), translation(0.5)), NONE),
            "tolerance": positive(),
            "margin": margin(),
        },
    ),
    "push": Call(
        loewner.push,
        {"T_world_body": poses(), "wrench": array(np.ones((2, 6)), FINITE, BATCHES), "radius": positive()},
    ),
    "prove": Call(
        loewner.prove,
        {
            "a": arg(cube, "Body"),
            "T_world_a": pose(0.0),
            "b": arg(ball, "Body"),
            "T_world_b": pose(0.5),
            "margin": margin(),
        },
    ),
    "overlapping_pairs": Call(
        loewner.overlapping_pairs,
        {
            "bodies": arg(pair_of_cubes, "Body", "Bodies"),
            "T_world": poses(),
            "margin": margin(),
            "method": choice("exact"),
            "depth": flag(),
        },
    ),
    # -- scenes
    "Scene": Call(Scene, {"margin": margin()}),
    "Scene.from_map": Call(
        Scene.from_map, {"path": arg("floor.yaml"), "height": positive(), "unknown": flag(), "margin": margin()}
    ),
    "Scene.pose": Call(on(scene, "pose"), {"name": arg("post")}),
    "Scene.snapshot": Call(on(scene, "snapshot"), {}),
    "Scene.copy": Call(on(scene, "copy"), {}),
    "Scene.add": Call(
        on(scene, "add"),
        {
            "name": arg("new", TEXTS),
            "body": arg(ball, "Body"),
            "T_world_body": pose(),
            "margin": margin(0.5, NONE),
            "error": array([0.01, 0.1], FINITE, NONE),
        },
    ),
    "Scene.remove": Call(on(scene, "remove"), {"name": arg("post")}),
    "Scene.replace": Call(on(scene, "replace"), {"name": arg("post"), "body": arg(ball, "Body")}),
    "Scene.move": Call(
        on(scene, "move"),
        {"name": arg("post"), "T_world_body": pose(), "error": array([0.01, 0.1], FINITE, NONE)},
    ),
    "Scene.move_all": Call(
        on(scene, "move_all"),
        {
            "names": arg(lambda: ["post", "box"]),
            "Ts": array(np.tile(np.eye(4), (2, 1, 1)), FINITE),
            "error": array([0.01, 0.1], FINITE, NONE),
        },
    ),
    "Scene.follow": Call(
        on(scene, "follow"),
        {
            "name": arg("post"),
            "times": array([0.0, 1.0], FINITE),
            "poses": array(np.tile(np.eye(4), (2, 1, 1)), FINITE),
            "repeat": flag(),
            "twist": arg(None, NONE),
            "speed": margin(),
            "turn": margin(),
            "since": arg(0.5, NUMBERS, ZERO, NEGATIVE, NONE),
            "error": array([0.01, 0.1], FINITE, NONE),
        },
    ),
    "PosePath.poses": Call(on(pose_path, "poses"), {"t": Arg(TIMES.make, TIMES.takes | AT.takes - NONE, array=True)}),
    "Scene.attach": Call(
        on(scene, "attach"),
        {
            "name": arg("post"),
            "link": arg("rod", TEXTS),
            "T_link_body": pose(),
            "touch_links": arg(lambda: ["ball"], NOTHING, "list of text", "dict of numbers"),
            "leave": arg(lambda: ["box"], NOTHING, "list of text", "dict of numbers"),
            "reach": arg(lambda: ["box"], NOTHING, "list of text", "dict of numbers"),
        },
    ),
    "Scene.leave": Call(on(scene, "leave"), {"a": arg("post", TEXTS), "b": arg("can", TEXTS)}),
    "Scene.reach": Call(on(scene, "reach"), {"a": arg("post", TEXTS), "b": arg("can", TEXTS)}),
    "Scene.detach": Call(on(scene, "detach"), {"name": arg("can"), "T_world_body": pose()}),
    "Scene.allow": Call(on(scene, "allow"), {"a": arg("post", TEXTS), "b": arg("can", TEXTS)}),
    "Scene.forbid": Call(on(scene, "forbid"), {"a": arg("box"), "b": arg("post")}),
    "Scene.set_margin": Call(
        on(scene, "set_margin"),
        {
            "margin": margin(0.5, NONE),
            "a": arg("post", TEXTS),
            "b": arg("can", TEXTS, NONE),
            "against": arg(None, NONE),
            "lower": flag(),
        },
    ),
    "Scene.widen": Call(on(scene, "widen"), {"least": margin(0.5)}),
    "Scene.margin_of": Call(on(scene, "margin_of"), {"a": arg("post", TEXTS), "b": arg("can", TEXTS)}),
    "Scene.pairs": Call(on(scene, "pairs"), {"time": arg(0.5, NUMBERS, ZERO, NEGATIVE, NONE)}),
    "Scene.collide": Call(on(scene, "collide"), {"time": arg(0.5, NUMBERS, ZERO, NEGATIVE, NONE)}),
    "Scene.distance": Call(on(scene, "distance"), {"a": arg("post"), "b": arg("box"), "exact": flag()}),
    "Scene.__getitem__": Call(lambda name: scene()[name], {"name": arg("post")}),
    "Contact.from_distances": Call(
        loewner.Contact.from_distances,
        {
            "names": arg(lambda: [("a", "b")], NOTHING),
            "found": arg(lambda: loewner.distance(ball(), translation(0.0)[None], ball(), None, exact=True)),
        },
    ),
    "load_scene": Call(loewner.load_scene, {"path": arg("scene.yaml")}),
    "save_scene": Call(loewner.save_scene, {"scene": arg(scene, "Scene"), "path": arg("out.yaml", TEXTS)}),
    "read_motion_bench_maker": Call(loewner.read_motion_bench_maker, {"path": arg("problems.json")}),
    # -- robots
    "Robot.from_urdf": Call(
        Robot.from_urdf,
        {
            "path": arg("gantry.urdf"),
            "text": arg(None, NONE),
            "xacro_args": arg(None, NONE, "empty dict", "dict of numbers"),
            "srdf": arg("gantry.srdf", NONE),
            "package_dirs": arg(list, NOTHING, "folder"),
            "meshes": choice("hull"),
            "decompose": flag(False),
            "pairs": arg(None, NONE, "list"),
            "tol": TOL,
            "cache": flag(False),
            "progress": callback(),
        },
    ),
    "Robot.from_mjcf": Call(Robot.from_mjcf, {"path": arg("pole.xml"), "tol": TOL}),
    "Joint": Call(
        lambda **given: Robot.from_links({"a": None, "b": ball()}, [loewner.Joint(**given)]),
        {
            "name": arg("j", TEXTS),
            "kind": choice("revolute"),
            "parent": arg("a"),
            "child": arg("b"),
            "T_parent_joint": pose(),
            "T_joint_child": pose(1.0),
            "axis": array([0.0, 0.0, 1.0], FINITE),
            "lower": arg(-1.0, NUMBERS, ZERO, NEGATIVE, "-inf"),
            "upper": arg(np.inf, NUMBERS, ZERO, NEGATIVE, "inf"),
            "velocity": positive(0.5, NONE),
            "acceleration": positive(0.5, NONE),
            "jerk": positive(0.5, NONE),
            "mimic": arg(None, NONE),
            "reference": arg(0.5, NUMBERS, ZERO, NEGATIVE),
        },
    ),
    "Robot.footprint": Call(
        Robot.footprint,
        {
            "polygon": array([[0.0, 0.0], [1.0, 0.0], [1.0, 0.5], [0.0, 0.5]], FINITE, "without the first row"),
            "height": positive(),
            "bounds": arg(((-1.0, 1.0), (-1.0, 1.0)), NONE),
        },
    ),
    "Robot.from_links": Call(
        Robot.from_links,
        {
            "links": arg(lambda: {"a": None, "b": ball()}),
            "joints": arg(lambda: [loewner.Joint("j", "ball", "a", "b")]),
            "disabled": arg(lambda: [("a", "b")], NONE, NOTHING),
            "name": arg("arm", TEXTS),
        },
    ),
    "Robot.from_pinocchio": Call(
        lambda **given: Robot.from_pinocchio(**given),
        {
            "model": arg(lambda: pinocchio.Model()),
            "geometry_model": arg(lambda: pinocchio.GeometryModel()),
            "meshes": choice("hull"),
            "tol": TOL,
        },
    ),
    "Robot.from_mujoco": Call(
        Robot.from_mujoco,
        {
            "model": arg(lambda: mujoco.MjModel.from_xml_path("pole.xml")),
            "data": arg(None, NONE),
            "couplings": flag(),
            "tol": TOL,
        },
    ),
    "Robot.exported": Call(
        on(lambda: Robot.from_mjcf("pole.xml"), "exported"), {"Q": array([[0.25], [0.5]], FINITE, BATCHES, "5 axes")}
    ),
    "Robot.imported": Call(
        on(lambda: Robot.from_mjcf("pole.xml"), "imported"),
        {"q": array([[0.25], [0.5]], FINITE, BATCHES, "5 axes"), "tolerance": margin()},
    ),
    "Robot.as_scene": Call(on(robot, "as_scene"), {"q": ONE}),
    "Robot.placed": Call(on(robot, "placed"), {"T_world_base": pose(1.0)}),
    "Robot.to_urdf": Call(
        on(robot, "to_urdf"), {"path": arg("out.urdf", NUMERAL), "mesh_prefix": arg("", TEXTS, "empty text")}
    ),
    "Robot.swept": Call(
        on(robot, "swept"),
        {
            "curve": arg(lambda: [[-0.5, 0.25, 0.0], [-0.5, 0.5, 0.0]]),
            "links": arg("rod", NONE),
            "tolerance": positive(0.1),
            "joint_error": array([2**-10, 0.0, 2**-10], FINITE, NUMBERS, ZERO, "a number alone"),
            "scene": arg(None, NONE, "Scene"),
            "progress": callback(),
        },
    ),
    "Robot.cover": Call(
        on(robot, "cover"),
        {"kind": choice("spheres"), "n": arg(None, NONE), "protrusion": margin(0.25, NONE), "progress": callback()},
    ),
    "Robot.covered_by": Call(
        on(robot, "covered_by"),
        {"model": arg(robot, "Robot"), "tolerance": positive(0.5, NONE), "progress": callback()},
    ),
    "Robot.with_cover": Call(on(robot, "with_cover"), {"path": arg("balls.json"), "format": arg(None, NONE)}),
    "Robot.save_cover": Call(
        on(lambda: robot().with_cover("balls.json"), "save_cover"),
        {"path": arg("out.json", NUMERAL), "format": arg(None, NONE)},
    ),
    "Robot.prove_pairs": Call(
        on(robot, "prove_pairs"),
        {
            "pairs": arg(lambda: [("ball", "rod")], NOTHING, NONE),
            "margin": margin(0.0),
            "limits": arg(None, NONE, "empty dict"),
            "scene": arg(None, NONE, "Scene"),
            "boxes": count(10),
            "cache": flag(False),
            "progress": callback(),
            "proof": flag(False),
        },
    ),
    "Robot.free_range": Call(
        on(robot, "free_range"),
        {
            "joints": arg(lambda: [robot().configuration_names[0]]),
            "about": arg(None, NONE),
            "pairs": arg(lambda: [("ball", "rod")], NOTHING, NONE),
            "margin": margin(0.0),
            "limits": arg(None, NONE, "empty dict"),
            "scene": arg(None, NONE, "Scene"),
            "boxes": count(10),
        },
    ),
    "Robot.disabling": Call(on(robot, "disabling"), {"pairs": arg(lambda: [("ball", "rod")], NOTHING)}),
    "Robot.join": Call(
        Robot.join, {"parts": arg(lambda: {"a": robot(), "b": robot()}), "poses": arg(None, NONE, "empty dict")}
    ),
    "Robot.part": Call(on(lambda: Robot.join({"a": robot()}), "part"), {"name": arg("a")}),
    "Robot.add_base": Call(
        on(robot, "add_base"),
        {
            "kind": choice("planar"),
            "bounds": array([[-1.0, 1.0], [0.0, 0.5]], NONE, FINITE, "turned over"),
            "name": arg("wheels", TEXTS, skips=frozenset({"object that fails"})),
        },
    ),
    "Robot.with_body": Call(
        on(robot, "with_body"),
        {
            "name": arg("door", TEXTS),
            "body": arg(ball, "Body"),
            "T_parent_joint": pose(),
            "joint": choice("revolute"),
            "parent": arg("rod", NONE),
            "axis": array([0.0, 0.0, 1.0], FINITE),
            "limits": array([0.0, 1.0], FINITE),
            "velocity": positive(0.5, NONE),
            "mimic": arg(None, NONE),
        },
    ),
    "Robot.link_pairs": Call(
        on(robot, "link_pairs"),
        {
            "pairs": arg(lambda: [("ball", "rod")], NOTHING),
            "name": arg("pairs", LABEL, skips=frozenset({"object that fails"})),
        },
    ),
    "Robot.forward_kinematics": Call(on(robot, "forward_kinematics"), {"Q": CONFIGURATIONS}),
    "Robot.jacobian": Call(
        on(robot, "jacobian"),
        {"Q": CONFIGURATIONS, "link": arg("rod"), "point": array(np.ones(3), NONE, FINITE)},
    ),
    "Robot.reach": Call(
        on(robot, "reach"),
        {
            "link": arg("rod"),
            "T": poses(),
            "joints": arg(lambda: ["x", "turn"], NONE),
            "start": array(Q, NONE, FINITE, BATCHES, "turned over"),
            "seeds": count(8),
            "checker": arg(None, NONE),
            "all": flag(),
            "tolerance": array([0.125, 0.125, 0.0, 0.25, 0.25, 0.5], NONE, FINITE, "one inf"),
        },
    ),
    "Robot.checked": Call(
        on(robot, "checked"), {"Q": CONFIGURATIONS, "name": arg("Q", LABEL, skips=frozenset({"object that fails"}))}
    ),
    "Robot.checked_one": Call(
        on(robot, "checked_one"), {"q": ONE, "name": arg("q", LABEL, skips=frozenset({"object that fails"}))}
    ),
    "Robot.configuration": Call(on(robot, "configuration"), {"values": arg(lambda: {"x": 0.5}, NONE, "empty dict")}),
    "Robot.random_configurations": Call(
        on(robot, "random_configurations"), {"n": count(3, "0"), "seed": count(1, "0", "2**70")}
    ),
    "Robot.usual_range": Call(on(robot, "usual_range"), {"reach": positive()}),
    "Robot.distances": Call(on(robot, "distances"), {"Q0": CONFIGURATIONS, "Q1": CONFIGURATIONS}),
    "Robot.between": Call(
        on(robot, "between"),
        {
            "Q0": CONFIGURATIONS,
            "Q1": CONFIGURATIONS,
            "t": array(
                [0.25, 0.5],
                "5 axes",
                FINITE,
                BATCHES,
                NUMBERS,
                ZERO,
                NEGATIVE,
                "a number alone",
                "turned over",
                "without the last column",
            ),
        },
    ),
    "CollisionChecker": Call(
        CollisionChecker,
        {
            "robot": arg(robot, "Robot"),
            "scene": arg(scene, "Scene", NONE),
            "allowed": arg(lambda: [("ball", "rod")], NOTHING),
            "skip_adjacent": arg(False, FLAGS, NONE),
        },
    ),
    "CollisionChecker.collide": Call(on(checker_in_time, "collide"), {"Q": CONFIGURATIONS, "t": AT}),
    "CollisionChecker.classify": Call(on(checker_in_time, "classify"), {"Q": CONFIGURATIONS, "t": AT}),
    "CollisionChecker.settle": Call(on(checker, "settle"), {"Q": CONFIGURATIONS}),
    "CollisionChecker.save": Call(on(checker, "save"), {"path": arg("out.lwn", TEXTS)}),
    "CollisionChecker.tiers": Call(on(checker, "tiers"), {"Q": CONFIGURATIONS}),
    "CollisionChecker.valid_edges": Call(
        on(checker, "valid_edges"),
        {"Q0": CONFIGURATIONS, "Q1": CONFIGURATIONS, "resolution": positive()},
    ),
    "CollisionChecker.certify_edges": Call(
        on(checker_in_time, "certify_edges"),
        {
            "Q0": CONFIGURATIONS,
            "Q1": CONFIGURATIONS,
            "tolerance": positive(),
            "joint_error": array([1e-3, 0.0, 1e-3], FINITE, NUMBERS, ZERO, "a number alone"),
            "t0": AT,
            "t1": array(
                [1.25, 1.5],
                FINITE,
                NUMBERS,
                BATCHES,
                "a number alone",
                "5 axes",
                "without the last column",
                "without the first row",
                "two axes more",
            ),
            "steps": count(1000, NONE),
            "proof": flag(False),
        },
    ),
    "CollisionChecker.first_contact": Call(
        on(checker_in_time, "first_contact"),
        {
            "curve": arg(moved, "empty list", "empty tuple"),
            "tolerance": positive(1e-6),
            "t0": arg(0.5, NUMBERS, ZERO, NEGATIVE, NONE),
        },
    ),
    "CollisionChecker.closest": Call(
        on(checker_in_time, "closest"),
        {"curve": arg(moved, "empty list", "empty tuple"), "t0": arg(0.5, NUMBERS, ZERO, NEGATIVE, NONE)},
    ),
    "CollisionChecker.off_the_robot": Call(
        on(checker_in_time, "off_the_robot"),
        {
            "points": array(np.eye(3), FINITE, BATCHES, "one NaN", "one inf", "turned over", "empty (0, 3)"),
            "q": ONE,
            "clear": positive(0.125),
            "time": arg(0.5, NUMBERS, ZERO, NEGATIVE, NONE),
            "mask": flag(False),
        },
    ),
    "depth.points_of": Call(depths.points_of, IMAGE),
    "depth.SeenSpace": Call(
        depths.SeenSpace,
        {"low": array([0.0, 0.0, 0.0], FINITE), "shape": arg((4, 3, 2)), "size": positive(0.25)},
    ),
    "depth.SeenSpace.see": Call(on(seen_space, "see"), {**IMAGE, "time": arg(0.5, NUMBERS, ZERO, NEGATIVE, NONE)}),
    "depth.SeenSpace.forget": Call(on(seen_space, "forget"), {"older_than": count(1, "0")}),
    "depth.SeenSpace.body": Call(
        on(seen_space, "body"),
        {"checker": arg(checker_in_time), "q": ONE, "clear": positive(0.125, ZERO), "closed": flag()},
    ),
    "CollisionChecker.joint_error": Call(
        on(checker, "joint_error"),
        {
            "path": array([[-0.5, 0.25, 0.0], [-0.5, 0.5, 0.0]], FINITE, "without the first row"),
            "weights": array([1.0, 0.5, 0.0], FINITE, NUMBERS, "a number alone"),
            "most": positive(0.125),
            "tolerance": positive(),
        },
    ),
    "CollisionChecker.certify_trajectory": Call(
        on(checker_in_time, "certify_trajectory"),
        {
            "curve": arg(moved, "empty list", "empty tuple"),
            "tolerance": positive(),
            "joint_error": array([1e-3, 0.0, 1e-3], FINITE, NUMBERS, ZERO, "a number alone"),
            "t0": arg(0.5, NUMBERS, ZERO, NEGATIVE, NONE),
            "steps": count(1000, NONE),
            "proof": flag(False),
        },
    ),
    "Proof": Call(loewner.Proof, {"data": arg(lambda: proof().data)}),
    "Proof.save": Call(on(proof, "save"), {"path": PATH_OUT}),
    "Proof.verify": Call(on(proof, "verify"), {}),
    "Proof.differences": Call(on(proof, "differences"), {"checker": arg(checker)}),
    "Proof.load": Call(loewner.Proof.load, {"path": arg("plan.proof")}),
    "CollisionChecker.pairs": Call(on(checker_in_time, "pairs"), {"q": ONE, "t": arg(0.5, NUMBERS, ZERO, NEGATIVE)}),
    "CollisionChecker.collide_by_pair": Call(on(checker_in_time, "collide_by_pair"), {"Q": CONFIGURATIONS, "t": AT}),
    "CollisionChecker.distance": Call(
        on(checker_in_time, "distance"), {"Q": CONFIGURATIONS, "t": AT, "exact": flag(), "gradient": flag()}
    ),
    "CollisionChecker.clearance": Call(
        on(checker, "clearance"),
        {"Q": CONFIGURATIONS, "softness": positive(0.005), "gradient": flag()},
    ),
    "CollisionChecker.distance_by_pair": Call(
        on(checker_in_time, "distance_by_pair"),
        {"Q": CONFIGURATIONS, "t": AT, "within": margin(0.5), "gradient": flag()},
    ),
    "pairs_by_sampling": Call(
        loewner.pairs_by_sampling,
        {
            "robot": arg(robot, "Robot"),
            "samples": count(100),
            "seed": count(1, "0", "2**70"),
            "known_free": array(Q, FINITE, BATCHES, NONE, "empty (0, 3)", "turned over"),
            "always": arg(0.5, "Fraction", "5e-324"),
        },
    ),
    "planners.plan": Call(
        planners.plan,
        {
            "checker": arg(checker),
            "start": array([-0.5, 0.25, 0.0], FINITE),
            "goal": array([[-0.5, 0.5, 0.0]], FINITE),
            "joints": arg("y", NONE),
            "keep": arg(None, NONE),
            "planner": arg("RRTConnect", NONE, skips=frozenset({"type"})),
            "certified": flag(),
            "joint_error": array([1e-3, 0.0, 1e-3], FINITE, NUMBERS, ZERO, "a number alone"),
            "search": arg(planners.Search(), NONE),
            "resolution": positive(0.125),
            "max_iterations": count(1000, NONE),
            "timeout": arg(5.0, NUMBERS),
            "simplify": flag(False),
            "seed": count(1, "0"),
            "full": flag(),
            "proof": flag(),
            "improve_for": arg(0.0, NUMBERS, NONE, ZERO),
            "improve_iterations": count(0, "0", NONE),
            "weights": array([1.0, 0.5, 1.0], NONE),
            "clearance": arg(None, NONE),
            "start_time": arg(None, NONE),
            "velocity": arg(None, NONE),
            "arrive_by": arg(None, NONE),
            "base": arg(None, NONE),
            "radius": arg(None, NONE),
            "reverse": flag(True),
        },
        varies=True,
    ),
    "planners.plan_full": Call(
        planners.plan_full,
        {
            "checker": arg(checker),
            "start": array([-0.5, 0.25, 0.0], FINITE),
            "goal": array([[-0.5, 0.5, 0.0]], FINITE),
            "improve": arg(planners.Improve(), NONE),
            "joints": arg("y", NONE),
            "keep": arg(None, NONE),
            "joint_error": array([1e-3, 0.0, 1e-3], FINITE, NUMBERS, ZERO, "a number alone"),
            "search": arg(planners.Search(timeout=5.0), NONE),
            "seed": count(1, "0"),
            "proof": flag(),
        },
        varies=True,
    ),
    "planners.plan_in_time": Call(
        planners.plan_in_time,
        {
            "checker": arg(checker),
            "start": array([-0.5, 0.25, 0.0], FINITE),
            "goal": array([[-0.5, 0.5, 0.0]], FINITE),
            "start_time": arg(0.5, NUMBERS, ZERO, NEGATIVE),
            "velocity": arg(0.5, NUMBERS),
            "arrive_by": arg(9.0, NUMBERS, NONE),
            "joints": arg("y", NONE),
            "joint_error": array([1e-3, 0.0, 1e-3], FINITE, NUMBERS, ZERO, "a number alone"),
            "search": arg(planners.Search(timeout=5.0), NONE),
            "seed": count(1, "0"),
        },
        varies=True,
    ),
    "planners.plan_drive": Call(
        planners.plan_drive,
        {
            "checker": arg(lambda: CollisionChecker(footprint([[-1.0, 2.0], [-1.0, 2.0]]))),
            "start": array([0.0, 0.5, 0.25], FINITE),
            "goal": array([0.5, 0.5, 0.25], FINITE),
            "base": arg("car"),
            "radius": positive(0.5),
            "reverse": flag(),
            "joint_error": array([1e-3, 0.0, 1e-3], FINITE, NUMBERS, ZERO, "a number alone"),
            "search": arg(planners.Search(timeout=5.0), NONE),
            "proof": flag(),
        },
        varies=True,
    ),
    "planners.Search": Call(
        lambda **given: planners.Search(**given),
        {
            "planner": arg(None, NONE, "function", skips=frozenset({"type"})),
            "certified": flag(),
            "resolution": positive(0.125),
            "max_iterations": count(1000, NONE),
            "timeout": positive(5.0),
            "simplify": flag(False),
        },
    ),
    "planners.Improve": Call(
        lambda **given: planners.plan_full(checker(), PATH[0], PATH[0], planners.Improve(**given)).path,
        {
            "seconds": arg(0.0, NONE, NUMBERS, ZERO),
            "iterations": count(1, "0", NONE),
            "weights": array([1.0, 0.5, 1.0], NONE),
            "clearance": positive(0.125, NONE),
        },
    ),
    "planners.Drive.of": Call(
        lambda **given: planners.Drive.of(**given),
        {
            "robot": arg(footprint, "Robot"),
            "start": array([0.0, 0.5, 0.25], "one 5e-324"),
            "motions": array([[0.5, 0.25], [1.0, 0.0]], FINITE, "without the first row", "turned over"),
        },
    ),
    "planners.Drive.positions": Call(on(driven, "positions"), {"t": TIMES}),
    "planners.PoseGoal": Call(
        lambda **given: planners.PoseGoal(**given).configurations(checker(), PATH[0]),
        {
            "link": arg("ball"),
            "T": array(
                [translation(-0.5, 0.5), translation(9.0)], NONE, FINITE, "without the first row", "two axes more"
            ),
            "tolerance": array([0.125, 0.125, 0.0, 0.25, 0.25, 0.5], NONE, FINITE, "one inf"),
            "seeds": count(8),
            "approach": array([0.0, 0.125, 0.0], NONE, "one 5e-324", "5e-324"),
            "retreat": array([0.0, -0.125, 0.0], NONE, "one 5e-324", "5e-324"),
        },
    ),
    **{
        f"planners.PoseGoal.{name}": Call(
            on(pose_goal, name),
            {"checker": arg(checker), "q": array([-0.5, 0.5, 0.0], FINITE), "joints": arg("y", NONE)},
        )
        for name in ("approach_path", "retreat_path")
    },
    "planners.PoseGoal.configurations": Call(
        on(pose_goal, "configurations"),
        {"checker": arg(checker), "start": array(PATH[0], FINITE), "joints": arg("y", NONE)},
    ),
    "planners.straight": Call(
        planners.straight,
        {
            "checker": arg(checker),
            "start": array(PATH[0], FINITE),
            "link": arg("rod"),
            "T": array(translation(-0.25, 0.5), NONE, FINITE),
            "position": positive(1e-3),
            "rotation": positive(1e-3),
            "joints": arg("slide", NONE),
            "keep": arg(lambda: ("z", [0.0, 0.0, 1.0], 0.5), NONE),
        },
    ),
    "planners.coordinate": Call(
        planners.coordinate,
        {
            "checker": arg(two_robots),
            "paths": arg(lambda: {"a": PATH, "b": PATH[::-1]}),
            "steps": count(4),
            "joint_error": array(np.full(6, 1e-3), FINITE, NUMBERS, ZERO, "a number alone"),
        },
    ),
    "planners.shorten": Call(
        planners.shorten,
        {
            "checker": arg(checker),
            "path": array([[-0.5, 0.25, 0.0], [-0.5, 0.5, 0.0], [-0.5, 0.75, 0.0]], FINITE, "without the first row"),
            "certified": flag(),
            "joint_error": array([1e-3, 0.0, 1e-3], FINITE, NUMBERS, ZERO, "a number alone"),
            "resolution": positive(0.125),
            "max_iterations": count(20, "0"),
            "seed": count(1, "0"),
        },
    ),
    "planners.trajectory": Call(
        planners.trajectory,
        {
            "robot": arg(robot, "Robot"),
            "path": array(PATH, FINITE, "without the first row", "turned over"),
            "velocity": array([1.0, 0.5, 2.0], FINITE, NUMBERS, "a number alone"),
            "acceleration": array([1.0, 0.5, 2.0], FINITE, NUMBERS, NONE, "a number alone"),
            "jerk": array([8.0, 5.0, 20.0], FINITE, NUMBERS, NONE, "a number alone"),
            "limits": arg(joint_limits, NONE),
            "checker": arg(checker, NONE),
            "blend": arg(0.25, ZERO, "5e-324"),
            "line": arg(lambda: planners.Line("ball", 0, 1), NOTHING, NONE),
        },
    ),
    "planners.Line": Call(
        lambda **given: planners.trajectory(robot(), PATH, velocity=1.0, line=planners.Line(**given)),
        {
            "link": arg("ball"),
            "first": count(0, "0"),
            "last": count(1, "-1"),
            "position": positive(1e-3),
            "rotation": positive(1e-3),
        },
    ),
    "planners.Trajectory.positions": Call(on(moved, "positions"), {"t": TIMES}),
    "planners.Trajectory.velocities": Call(on(moved, "velocities"), {"t": TIMES}),
    "planners.Trajectory.accelerations": Call(on(moved, "accelerations"), {"t": TIMES}),
    "planners.Trajectory.sample": Call(on(moved, "sample"), {"rate": positive(), "full": flag()}),
    "planners.Trajectory.save": Call(
        on(moved, "save"),
        {
            "path": arg("out.json"),
            "rate": positive(0.5, NONE),
            "message": flag(),
            "joints": arg(["turn", "x"], NONE),
            "names": arg({"x": "slide"}, NONE, "empty dict", "list of text"),
            "controllers": arg(None, NONE),
        },
    ),
    "planners.Trajectory.part": Call(
        lambda name: planners.trajectory(two_robots().robot, np.zeros((2, 6)), velocity=1.0).part(name),
        {"name": arg("a")},
    ),
    "planners.Trajectory.of_targets": Call(
        planners.Trajectory.of_targets,
        {
            "robot": arg(robot, "Robot"),
            "targets": array(PATH, FINITE, "without the first row", "turned over"),
            "dt": positive(0.02),
            "start_time": arg(0.5, NUMBERS, ZERO, NEGATIVE),
        },
    ),
    "planners.Trajectory.stop_at": Call(
        on(moved, "stop_at"),
        {
            "t": arg(0.25, ZERO, "5e-324", "1.5", "Fraction"),
            "how": arg("joints"),
            "acceleration": array([1.0, 2.0, 4.0], FINITE, NUMBERS, "a number alone"),
            "jerk": array([8.0, 5.0, 20.0], FINITE, NUMBERS, NONE, "a number alone"),
            "limits": arg(joint_limits, NONE),
            "beyond": flag(),
        },
    ),
    "planners.brake": Call(
        planners.brake,
        {
            "robot": arg(robot, "Robot"),
            "q": array(PATH[0], FINITE),
            "dq": array([1.0, -0.5, 0.25], FINITE),
            "ddq": array([0.5, 0.25, -0.5], NONE, "one 5e-324"),
            "acceleration": array([1.0, 0.5, 2.0], FINITE, NUMBERS, NONE, "a number alone"),
            "jerk": array([8.0, 5.0, 20.0], FINITE, NUMBERS, NONE, "a number alone"),
            "limits": arg(joint_limits, NONE),
            "start_time": arg(0.5, NUMBERS, ZERO, NEGATIVE),
        },
    ),
    "planners.Gate": Call(
        planners.Gate,
        {
            "checker": arg(checker, "CollisionChecker"),
            "limits": arg(joint_limits, NONE),
            "brake": choice("path"),
            "horizon": positive(0.5, NONE),
            "interpolation": choice("linear"),
            "joint_error": array([1e-3, 0.0, 1e-3], FINITE, NUMBERS, ZERO, "a number alone"),
            "velocity_error": array([1e-3, 0.0, 1e-3], FINITE, NUMBERS, ZERO, "a number alone"),
            "latency": margin(0.02),
            "steps": count(1000, NONE),
            "acceleration": array([1.0, 0.5, 2.0], FINITE, NUMBERS, NONE, "a number alone"),
            "jerk": array([8.0, 5.0, 20.0], FINITE, NUMBERS, NONE, "a number alone"),
            "tolerance": positive(),
        },
    ),
    "planners.Gate.check": Call(
        lambda **given: planners.Gate(checker(), acceleration=1.0).check(**given),
        {
            "q": array(PATH[0], FINITE),
            "dq": array([0.5, -0.5, 0.25], FINITE),
            "targets": array(PATH[1:], FINITE, "without the first row", "turned over"),
            "dt": positive(0.5),
            "time": arg(0.5, NUMBERS, ZERO, NEGATIVE, NONE),
        },
    ),
    "planners.Gate.proof": Call(on(gate, "proof"), {}),
    "planners.ControllerPoints.save": Call(
        lambda **given: planners.ControllerPoints([0.0, 1.0], PATH[:2], names=("x", "y", "turn")).save(**given),
        {
            "path": arg("out.json"),
            "joints": arg(["turn", "x"], NONE),
            "names": arg({"x": "slide"}, NONE, "empty dict", "list of text"),
            "controllers": arg(None, NONE),
        },
    ),
    "planners.time_path": Call(
        planners.time_path,
        {
            "checker": arg(checker_in_time),
            "path": array(PATH, FINITE, "without the first row", "turned over"),
            "start_time": arg(0.0, NUMBERS, NONE, NEGATIVE, ZERO),
            "arrive_by": arg(900.0, NUMBERS, NONE),
            "arrive_at": arg(None, NUMBERS, NONE, ZERO),
            "end_velocity": arg(None, NONE, NUMBERS, ZERO),
            "velocity": array([1.0, 0.5, 2.0], FINITE, NUMBERS, "a number alone"),
            "acceleration": array([1.0, 0.5, 2.0], FINITE, NUMBERS, NONE, "a number alone"),
            "jerk": array([8.0, 5.0, 20.0], FINITE, NUMBERS, NONE, "a number alone"),
            "limits": arg(joint_limits, NONE),
            "joint_error": array([1e-3, 0.0, 1e-3], FINITE, NUMBERS, ZERO, NONE, "a number alone"),
            "blend": arg(0.25, ZERO, "5e-324"),
        },
    ),
    "planners.JointLimits.load": Call(
        planners.JointLimits.load, {"path": arg("limits.yaml"), "robot": arg(robot, "Robot"), "scaled": flag()}
    ),
    "planners.Trajectory.certify": Call(
        on(moved, "certify"),
        {
            "checker": arg(checker),
            "tolerance": positive(),
            "joint_error": array([1e-3, 0.0, 1e-3], FINITE, NUMBERS, ZERO, "a number alone"),
            "proof": flag(False),
        },
    ),
    "planners.ControllerPoints": Call(
        planners.ControllerPoints,
        {
            "times": array([0.0, 1.0, 2.0], FINITE, "turned over"),
            "positions": array(PATH, FINITE, "turned over"),
            "velocities": array(PATH, FINITE, NONE, "turned over"),
            "accelerations": array(PATH, FINITE, NONE, "turned over"),
            "names": arg(lambda: ["y", "turn", "x"], NONE),
            "start_time": arg(0.5, NUMBERS, ZERO, NEGATIVE),
        },
    ),
    "planners.ControllerPoints.load": Call(
        planners.ControllerPoints.load,
        {"path": arg("moved.json"), "robot": arg(robot, "Robot"), "others": array(Q[0], FINITE, NONE)},
    ),
    "planners.ControllerPoints.load_all": Call(
        planners.ControllerPoints.load_all,
        {"path": arg("moved.json"), "robot": arg(robot, "Robot"), "others": array(Q[0], FINITE, NONE)},
    ),
    "planners.Trajectory.load": Call(planners.Trajectory.load, {"path": arg("moved.json")}),
    "planners.space_information": Call(
        planners.space_information,
        {
            "checker": arg(checker),
            "joints": arg("y", NONE),
            "fixed": array([0.5, 0.25, 0.0], FINITE, NONE),
            "certified": flag(),
            "resolution": positive(0.125),
        },
        varies=True,
    ),
    "planners.roadmap": Call(
        planners.roadmap,
        {
            "checker": arg(checker),
            "samples": array(
                [[-0.5, 0.25, 0.0], [-0.5, 0.5, 0.0], [-0.5, 0.75, 0.0], [-0.5, 1.0, 0.0]],
                FINITE,
                "without the first row",
            ),
            "joints": arg("y", NONE),
            "fixed": array([-0.5, 0.25, 0.0], FINITE, NONE),
            "neighbours": count(2, NONE),
            "seed": count(1, "0"),
        },
    ),
    "planners.Roadmap.path": Call(
        on(roadmap, "path"),
        {
            "start": array([-0.5, 0.25, 0.0], FINITE),
            "goal": array([[-0.5, 0.5, 0.0], [-0.5, 0.75, 0.0]], FINITE, "without the first row"),
            "joint_error": array([1e-3, 0.0, 1e-3], FINITE, NUMBERS, ZERO, "a number alone"),
            "simplify": flag(False),
        },
    ),
    "planners.Roadmap.save": Call(on(roadmap, "save"), {"path": PATH_OUT}),
    "planners.Roadmap.load": Call(planners.Roadmap.load, {"path": arg("roadmap.npz"), "checker": arg(checker)}),
    # -- files of meshes
    "meshes.load": Call(meshes.load, {"source": arg("part.obj")}),
    "meshes.convex_pieces": Call(
        meshes.convex_pieces,
        {
            "source": arg("part.obj"),
            "scale": array([1.0, 2.0, 0.5], FINITE, NUMBERS, NEGATIVE, "a number alone"),
            "decompose": flag(False),
            "cover": flag(),
            "tolerance": positive(0.25, NONE),
            "threshold": arg(0.125, "Fraction"),
            "max_pieces": count(3, NONE),
            "seed": count(1, "0", "2**70"),
            "progress": callback(),
        },
    ),
    # -- faces
    "plots.body": Call(
        drawing.body,
        {
            "body": arg(cube, "Body"),
            "T_world_body": pose(),
            "ax": arg(axes_in_space, NONE),
            "colour": arg("tab:red", "text of a number"),
            "ellipsoids": flag(),
        },
        varies=True,
    ),
    "plots.pair": Call(
        drawing.pair,
        {
            "a": arg(cube, "Body"),
            "T_world_a": pose(),
            "b": arg(ball, "Body"),
            "T_world_b": pose(2.0),
            "ax": arg(axes_in_space, NONE),
            "ellipsoids": flag(),
            "near": flag(),
        },
        varies=True,
    ),
    "plots.configuration": Call(
        drawing.configuration, {"checker": arg(checker), "q": ONE, "ax": arg(axes_in_space, NONE)}, varies=True
    ),
    "plots.cover": Call(
        drawing.cover,
        {
            "robot": arg(robot, "Robot"),
            "model": arg(robot, "Robot"),
            "q": array(Q[0], FINITE, NONE),
            "ax": arg(axes_in_space, NONE),
        },
        varies=True,
    ),
    "plots.trajectory": Call(
        drawing.trajectory,
        {
            "checker": arg(checker),
            "curve": arg(moved),
            "joint_error": array([1e-3, 0.0, 1e-3], FINITE, NUMBERS, ZERO, "a number alone"),
            "ax": arg(flat_axes, NONE),
        },
        varies=True,
    ),
    "plots.tiers": Call(
        drawing.tiers,
        {"counts": arg(lambda: {"a": {"free_by_search": 3}}), "ax": arg(flat_axes, NONE)},
        varies=True,
    ),
    "plots.costs": Call(
        drawing.costs,
        {
            "sizes": array([8.0, 20.0], FINITE),
            "seconds": arg(lambda: {"ours": [0.5, 0.25]}, "dict of numbers"),
            "size": arg("vertices", TEXTS, "empty text"),
            "item": arg("pair", TEXTS, "empty text"),
            "ax": arg(flat_axes, NONE),
        },
        varies=True,
    ),
    "plots.accuracy": Call(
        drawing.accuracy,
        {"counts": arg(lambda: {"rule": {"cubes": (3, 4)}}), "ax": arg(flat_axes, NONE)},
        varies=True,
    ),
    "plots.save": Call(drawing.save, {"figure": arg(flat_axes), "path": arg("out.svg")}, varies=True),
    "compile_kernels": Call(compiling.compile_kernels, {"parts": arg(list, NOTHING), "progress": callback()}),
    "paper.sample": Call(
        paper.sample, {"pairs": count(5), "seed": count(1, "0", "2**70"), "dataset": choice("radius")}
    ),
    "paper.run": Call(
        paper.run,
        {
            "pairs": count(5),
            "seed": count(1, "0", "2**70"),
            "dataset": choice("radius"),
            "out": arg(None, NONE, TEXTS, "folder", "missing file", skips=frozenset({"text nan", "text"})),
            "json": arg("out.json", NONE, TEXTS),
            "progress": callback(),
        },
        varies=True,
    ),
    "paper.detect": Call(
        paper.detect, {"detector": arg(3), "pairs": arg(lambda: experiment().pairs), "angle": positive()}
    ),
    "paper.estimate": Call(paper.estimate, {"pairs": arg(lambda: experiment().pairs)}),
    "paper.distance_estimate": Call(
        paper.distance_estimate,
        {
            "inner_1": arg(lambda: ball().inner, "Ellipsoids"),
            "outer_1": arg(lambda: ball().outer, "Ellipsoids"),
            "inner_2": arg(lambda: cube().inner, "Ellipsoids"),
            "outer_2": arg(lambda: cube().outer, "Ellipsoids"),
            "method": choice("rimon-boyd"),
        },
    ),
    "paper.overlap_by_eigenvalue": Call(paper.overlap_by_eigenvalue, E3),
    "paper.mvce_by_lifted_mvie": Call(paper.mvce_by_lifted_mvie, {"points": FLAT_POINTS, "tol": TOL}),
    "paper.Pairs.from_bodies": Call(
        paper.Pairs.from_bodies,
        {"a": arg(pair_of_cubes), "b": arg(pair_of_cubes), "heuristic": choice("centroid")},
    ),
    "paper.Pairs.take": Call(
        on(lambda: experiment().pairs, "take"),
        {
            "index": array(
                np.array([2, 0]),
                "without the first row",
                "without the last column",
                "none of them",
                "a column more",
                "turned over",
                "empty list",
                "empty tuple",
                "Scene",
            )
        },
    ),
    "paper.Confusion.of": Call(
        paper.Confusion.of,
        {"collides": arg(lambda: np.array([True, False])), "truth": arg(lambda: np.array([True, True]))},
    ),
    "paper.Experiment.as_dict": Call(on(experiment, "as_dict"), {}),
    "viewer.show_pair": Call(
        page(viewing.show_pair),
        {
            "a": arg(cube, "Body"),
            "T_world_a": pose(),
            "b": arg(ball, "Body"),
            "T_world_b": pose(2.0),
            "margin": margin(),
            "mesh_a": arg("part.obj", NONE),
            "mesh_b": arg(None, NONE),
            "host": arg("127.0.0.1"),
            "port": arg(0, "0"),
            "block": flag(False),
        },
    ),
    "viewer.show_robot": Call(
        page(viewing.show_robot),
        {
            "checker": arg(checker),
            "q": array(Q[0], FINITE, NONE),
            "path": arg(moved, NONE),
            "trajectory": arg(None, NONE),
            "host": arg("127.0.0.1"),
            "port": arg(0, "0"),
            "block": flag(False),
        },
    ),
    # -- on a GPU, which is not there: the CPU answers, and nobody needs to hear that
    "gpu.why_not": Call(on_gpus.why_not, {"device": count(0, "0")}),
    "gpu.classify": Call(
        quietly(on_gpus.classify),
        {
            **OPERANDS,
            "pairs": arg(None, ROWS.takes),
            "refine": flag(),
            "fallback": choice("cpu"),
            "device": count(0, "0"),
        },
    ),
    "gpu.Checker": Call(on_gpus.Checker, {"checker": arg(checker), "fallback": choice("cpu"), "device": count(0, "0")}),
    "gpu.Checker.collide": Call(
        quietly(lambda Q: on_gpus.Checker(checker(), fallback="cpu").collide(Q)), {"Q": CONFIGURATIONS}
    ),
    "gpu.Checker.certify_edges": Call(
        quietly(lambda **of: on_gpus.Checker(checker(), fallback="cpu").certify_edges(**of)),
        {"Q0": CONFIGURATIONS, "Q1": CONFIGURATIONS, "tolerance": positive(1e-3)},
    ),
    # -- the command line
    "cli.main": Call(command, {"arguments": arg(lambda: ["check", "part.npz", "part.npz"], NONE)}),
}

# The functions that they make have tests of their own: JAX and PyTorch do not run in forked processes.
for _name, _module in FRAMEWORKS.items():
    CALLS[f"{_name}.clearance"] = Call(_module.clearance, {"checker": arg(checker), "softness": positive(0.005)})
    CALLS[f"{_name}.distance"] = Call(_module.distance, {"checker": arg(checker)})

# The parameters of commands are words. What may come as one, whatever it is wanted for:
WORDS = {
    text: (lambda text=text: text)
    for text in (
        "", " ", "0", "-0.0", "-1", "1", "0.5", "1e308", "5e-324", "1e400", "nan", "inf", "-inf", "1,5", "0x10", "1_0",
        str(2**70), "1" * 400, "True", "None", "[]", "what", "a\0b", "\ud800", "\udcff", "x" * 3000, "~", "/", ".",
        "/dev/null", "missing/file.npz", "part.txt", "-", "--", "@file", "1 2 3 4 5 6 7 8", "1 0 0 0 0 0 0", "é",
    )
}  # fmt: skip
LINE_NUMBERS = frozenset({"0", "-0.0", "1", "0.5", "1e308", "5e-324", "1_0", str(2**70)})
LINE_COUNTS = frozenset({"1", "1_0"})
LINE_SEEDS = LINE_COUNTS | {"0", str(2**70)}
LINES: dict[str, Call] = {
    "loewner fit": Call(
        line(
            "fit", "MESH", "--out", "OUT", "--tol", "TOL", "--threshold", "0.1", "--max-pieces", "MAX", "--seed", "SEED"
        ),
        {
            "mesh": word("part.obj"),
            "out": word("fitted", frozenset(WORDS)),
            "tol": word("1e-4", LINE_NUMBERS),
            "max": word("3", LINE_COUNTS),
            "seed": word("1", LINE_SEEDS),
        },
    ),
    "loewner check": Call(
        line("check", "A", "B", "--pose-a", "POSE", "--margin", "MARGIN", "--method", "METHOD", "--json"),
        {
            "a": word("part.npz"),
            "b": word("part.obj"),
            "pose": word("1 0 0", "1 0 0 0 0 0 0"),
            "margin": word("0.5", LINE_NUMBERS),
            "method": word("exact"),
        },
    ),
    "loewner robot info": Call(
        line("robot", "info", "URDF", "--srdf", "SRDF", "--package-dir", "FOLDER"),
        {"urdf": word("gantry.urdf"), "srdf": word("gantry.srdf"), "folder": word(".", "/", ".", "")},
    ),
    "loewner robot check": Call(
        line("robot", "check", "URDF", "--scene", "SCENE", "--random", "COUNT", "--seed", "SEED", "--margin", "MARGIN"),
        {
            "urdf": word("gantry.urdf"),
            "scene": word("scene.yaml"),
            "count": word("5", LINE_COUNTS),
            "seed": word("1", LINE_SEEDS),
            "margin": word("0.125", LINE_NUMBERS),
        },
    ),
    "loewner robot check --configs": Call(
        line("robot", "check", "gantry.urdf", "--scene", "scene.yaml", "--configs", "CONFIGS"),
        {"configs": word("configs.npy")},
    ),
    "loewner robot check --state": Call(
        line("robot", "check", "gantry.urdf", "--srdf", "gantry.srdf", "--scene", "scene.yaml", "--state", "STATE"),
        {"state": word("left")},
    ),
    "loewner audit": Call(
        line(
            "audit",
            "gantry.urdf",
            "moved.json",
            "--srdf",
            "gantry.srdf",
            "--scene",
            "SCENE",
            "--others",
            "OTHERS",
            "--joint-error",
            "ERROR",
            "--out",
            "OUT",
        ),
        {
            "scene": word("scene.yaml"),
            "others": word("left"),
            "error": word("0.01", LINE_NUMBERS),
            "out": word("drawn.svg"),
        },
    ),
    "loewner plan": Call(
        line(
            "plan",
            "gantry.urdf",
            "--srdf",
            "gantry.srdf",
            "--scene",
            "SCENE",
            "--start",
            "START",
            "--goal",
            "GOAL",
            "--joints",
            "JOINTS",
            "--seed",
            "SEED",
            "--max-iterations",
            "COUNT",
            "--timeout",
            "SECONDS",
            "--out",
            "OUT",
            "--proof",
            "PROOF",
        ),
        {
            "scene": word("scene.yaml"),
            "start": word("left"),
            "goal": word("left", "configs.npy"),
            "joints": word("slide"),
            "seed": word("1", LINE_SEEDS),
            "count": word("50", LINE_COUNTS),
            "seconds": word("5", LINE_NUMBERS),
            "out": word("path.csv"),
            "proof": word("out.proof", frozenset(WORDS)),
        },
    ),
    "loewner verify": Call(
        line("verify", "FILE", "--robot", "ROBOT", "--srdf", "gantry.srdf", "--scene", "SCENE"),
        {"file": word("plan.proof"), "robot": word("gantry.urdf"), "scene": word("scene.yaml")},
    ),
    "loewner paper": Call(
        line("paper", "--pairs", "PAIRS", "--seed", "SEED", "--dataset", "DATA", "--json", "JSON"),
        {
            "pairs": word("5", LINE_COUNTS),
            "seed": word("1", LINE_SEEDS),
            "data": word("radius"),
            "json": word("out.json", frozenset(WORDS)),
        },
        varies=True,
    ),
}

if find_spec("distributed"):
    CHUNKS = {"checker": arg(checker), "Q": arg(in_chunks)}
    CALLS |= {
        "cluster.fit": Call(
            fit_here,
            {
                "paths": arg(lambda: ["part.obj"], NOTHING, "list of text", "dict of numbers"),
                "client": arg(client),
                "out": arg("made", TEXTS - {"NUL", "surrogate", "long text"}, "folder", "missing file"),
                "root": arg(".", NONE, "folder"),
                "decompose": flag(),
                "tol": positive(0.125, "1e308"),
                "scale": arg(2.0, NUMBERS, NEGATIVE),
                "cover": flag(),
                "tolerance": positive(0.5, NONE),
                "threshold": arg(0.125, "Fraction"),
                "max_pieces": count(4, NONE),
                "seed": count(0, "0"),
                "progress": callback(),
            },
        ),
        "cluster.collide": Call(clustering.collide, CHUNKS),
        "cluster.distance": Call(clustering.distance, CHUNKS),
        "cluster.certify_edges": Call(
            clustering.certify_edges,
            {"checker": arg(checker), "Q0": arg(in_chunks), "Q1": arg(in_chunks), "tolerance": positive(0.125)},
        ),
    }

# Records that the library makes and hands out: whoever makes one by hand gets what was put in.
RECORDS = {
    "Attachment", "Contact", "CoverReport", "Covering", "Distance", "FirstContact", "Fit", "judging.Judgement",
    "NearPoints", "Part", "Piece", "Polytope", "Problem",
    "Robot",
    "CertifiedMotions", "CertifiedTrajectory", "TrajectoryContact", "ClosestApproach",
    "Overlaps", "PairDistances",
    "PosePath", "Reached", "Settled", "StateDistance", "paper.Answers", "paper.Confusion",
    "paper.DataSet", "paper.Experiment", "paper.Fitting", "paper.Pairs", "paper.Result", "planners.JointLimits",
    "planners.GateAnswer", "planners.Drive", "planners.Plan", "planners.Trajectory",
    "cluster.Fitted",
}  # fmt: skip
# Likewise, but no record: it is made by its class methods.
MADE = {"Body", "gpu.DeviceArray", "planners.Roadmap"}
# Not called: pages are opened by the functions that show them; what acts on an open page has tests of its own.
PAGES = {"viewer.PairViewer", "viewer.RobotViewer", "viewer.save_screenshot"}
# Text in, text out; given an experiment, as the report is.
TABLES = "paper.tables"


def public_callables() -> Iterator[tuple[str, list[str]]]:
    """Names and parameters of all that a user may call, but of Drake, which is too large to be there."""
    return ((name, parameters) for name, parameters in _public_callables() if name not in OF_DRAKE)


def _public_callables() -> Iterator[tuple[str, list[str]]]:
    groups: dict[str, Mapping[str, Any]] = {
        "planners.": {name: getattr(planners, name) for name in planners.__all__},
        "meshes.": _own(meshes),
        "plots.": _own(drawing),
        "viewer.": {name: getattr(viewing, name) for name in viewing.__all__},
        "cluster.": {name: getattr(clustering, name) for name in clustering.__all__}
        if find_spec("distributed")
        else {},
        **{f"{name}.": _own(module) for name, module in FRAMEWORKS.items()},
        "gpu.": {name: getattr(on_gpus, name) for name in on_gpus.__all__},
        "paper.": {name: getattr(paper, name) for name in paper.__all__},
        "reproductions.": {"reproduction": reproductions.reproduction},
        "judging.": {name: getattr(judging, name) for name in judging.__all__},
        "depth.": {name: getattr(depths, name) for name in depths.__all__},
        "cli.": {"main": cli.main},
        "": {name: getattr(loewner, name) for name in loewner.__all__} | {"compile_kernels": compiling.compile_kernels},
    }
    for place, members in groups.items():
        for name, member in members.items():
            if inspect.ismodule(member):
                assert place + name == TABLES
            elif not inspect.isclass(member):
                if place + name not in PAGES:
                    yield place + name, _parameters(member)
            elif not issubclass(member, (LoewnerError, enum.Enum)) and place + name not in PAGES:
                yield from _of_class(place + name, member)


def _own(module: Any) -> dict[str, Any]:
    public = getattr(module, "__all__", [name for name in vars(module) if not name.startswith("_")])
    members = {name: getattr(module, name) for name in public}
    return {n: m for n, m in members.items() if inspect.isfunction(m) and m.__module__ == module.__name__}


def _of_class(name: str, cls: type) -> Iterator[tuple[str, list[str]]]:
    made_by_hand = name not in RECORDS | MADE and cls.__init__ is not object.__init__
    assert name not in RECORDS or dataclasses.is_dataclass(cls), f"{name}: expected a record"
    if made_by_hand:
        yield name, _parameters(cls)
    for method in dir(cls):
        member = inspect.getattr_static(cls, method)
        if isinstance(member, property):
            assert member.fset is None, f"{name}.{method}: expected a property that is read only, found one to set"
        elif (method == "__getitem__" or not method.startswith("_")) and callable(getattr(cls, method)):
            yield f"{name}.{method}", [p for p in _parameters(getattr(cls, method)) if p != "self"]


def _parameters(member: Any) -> list[str]:
    named, more = [], []
    for p in inspect.signature(member).parameters.values():
        if p.kind is not p.VAR_KEYWORD:
            named.append(p.name)
        elif str(p.annotation).startswith("Unpack"):  # options that a TypedDict names
            options = typing.get_type_hints(inspect.unwrap(member))[p.name]
            more = sorted(typing.get_args(options)[0].__optional_keys__)
    return named + more
