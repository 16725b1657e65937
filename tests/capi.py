"""Call `libloewner` from Python, through nothing but `loewner.h`: the tests hold it against Python."""

from __future__ import annotations

import ctypes
import re
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import loewner
from loewner._native import library
from native_files import OFFERED

HEADER = Path(loewner.__file__).parent / "include" / "loewner.h"
LIBRARY = library.HOME / "libloewner.so"

STATUS = {0: "ok", 1: "bad argument", 2: "bad file", 3: "other version", 4: "no kernels", 5: "no memory"}


class Error(Exception):
    """A status other than OK, and the text."""

    def __init__(self, status: int, text: str) -> None:
        super().__init__(text)
        self.status = status


class Distance(ctypes.Structure):
    _fields_ = [
        ("lower", ctypes.c_double), ("upper", ctypes.c_double), ("distance", ctypes.c_double),
        ("bodies", ctypes.c_int32 * 2), ("witness_a", ctypes.c_double * 3), ("witness_b", ctypes.c_double * 3),
        ("normal", ctypes.c_double * 3),
    ]  # fmt: skip


class ProofOptions(ctypes.Structure):
    _fields_ = [
        ("tolerance", ctypes.c_double), ("joint_error", ctypes.c_void_p), ("t0", ctypes.c_void_p),
        ("t1", ctypes.c_void_p), ("steps", ctypes.c_int64), ("steps_taken", ctypes.c_void_p),
    ]  # fmt: skip


class Bounds(ctypes.Structure):
    _fields_ = [(name, ctypes.c_double) for name in ("metres", "radians", "speed", "turn", "since")]


class GateOptions(ctypes.Structure):
    _fields_ = [
        ("brake", ctypes.c_int32), ("acceleration", ctypes.c_void_p), ("jerk", ctypes.c_void_p),
        ("velocity", ctypes.c_void_p), ("joint_error", ctypes.c_void_p), ("velocity_error", ctypes.c_void_p),
        ("latency", ctypes.c_double), ("horizon", ctypes.c_double), ("tolerance", ctypes.c_double),
        ("steps", ctypes.c_int64), ("wants_scale", ctypes.c_int32),
    ]  # fmt: skip


class GateAnswer(ctypes.Structure):
    _fields_ = [
        ("state", ctypes.c_int32), ("reason", ctypes.c_int32), ("steps", ctypes.c_size_t), ("scale", ctypes.c_double),
        ("bodies", ctypes.c_int32 * 2), ("joint", ctypes.c_int32), ("is_proven", ctypes.c_int32),
        ("work", ctypes.c_int64), ("begins", ctypes.c_double), ("brake_count", ctypes.c_size_t),
        ("times", ctypes.POINTER(ctypes.c_double)),
        ("positions", ctypes.POINTER(ctypes.c_double)), ("velocities", ctypes.POINTER(ctypes.c_double)),
        ("accelerations", ctypes.POINTER(ctypes.c_double)),
    ]  # fmt: skip


def options_of(tolerance: float, errors: Any, steps: int, taken: Any, t0: Any = None, t1: Any = None) -> ProofOptions:
    address, begin, end, to = (None if x is None else x.ctypes.data for x in (errors, t0, t1, taken))
    return ProofOptions(tolerance, address, begin, end, steps, to)


class PlanOptions(ctypes.Structure):
    _fields_ = [
        ("joints", ctypes.c_void_p), ("joint_error", ctypes.c_void_p), ("max_iterations", ctypes.c_int64),
        ("timeout", ctypes.c_double), ("cuts", ctypes.c_int64), ("seed", ctypes.c_uint32),
    ]  # fmt: skip


class Side(ctypes.Structure):
    _fields_ = [("bodies", ctypes.c_void_p), ("body", ctypes.c_int64), ("poses", ctypes.c_void_p),
                ("pose_count", ctypes.c_size_t)]  # fmt: skip


DISTANCE = np.dtype(
    [("lower", float), ("upper", float), ("distance", float), ("bodies", np.int32, 2), ("witness_a", float, 3),
     ("witness_b", float, 3), ("normal", float, 3)]
)  # fmt: skip
assert DISTANCE.itemsize == ctypes.sizeof(Distance)


@cache
def functions() -> ctypes.CDLL:
    """The library; every function of the header is one of its symbols. A test that needs it ends here without it."""
    if not OFFERED:
        pytest.skip(f"no native library here: {library.why_not()}")
    loaded = ctypes.CDLL(str(LIBRARY))
    for name in re.findall(r"\b(loewner_\w+)\(", HEADER.read_text(encoding="utf-8")):
        function = getattr(loaded, name)
        function.restype = ctypes.c_int
        if "_name" in name or name in ("loewner_error_text", "loewner_level", "loewner_version"):
            function.restype = ctypes.c_char_p
        if name in ("loewner_checker_pair_count", "loewner_bodies_count"):
            function.restype = ctypes.c_int64
    return loaded


def ask(name: str, *arguments: Any) -> Any:
    """Call a function; arrays are passed as their addresses, and a status other than OK is raised."""
    function = getattr(functions(), f"loewner_{name}")
    given = [ctypes.c_void_p(x.ctypes.data) if isinstance(x, np.ndarray) else x for x in arguments]
    found = function(*given)
    if (
        function.restype is ctypes.c_int
        and found != 0
        and "count" not in name
        and "dof" not in name
        and "find" not in name
    ):
        raise Error(found, functions().loewner_error_text().decode())
    return found


class Handle:
    """Something that is opened and closed."""

    _leave: str | None = None  # also where opening it fails

    def __init__(self, make: str, leave: str, *arguments: Any) -> None:
        made = ctypes.c_void_p()
        ask(make, *arguments, ctypes.byref(made))
        self._as_parameter_ = made
        self._leave = leave

    def close(self) -> None:
        if self._leave:
            getattr(functions(), f"loewner_{self._leave}")(self._as_parameter_)
            self._leave = None

    def __del__(self) -> None:
        self.close()


def size(n: int) -> ctypes.c_size_t:
    return ctypes.c_size_t(n)


class Workspace(Handle):
    def __init__(self) -> None:
        super().__init__("workspace_new", "workspace_free")


class Bodies(Handle):
    def __init__(self, path: Path) -> None:
        super().__init__("bodies_open", "bodies_close", str(path).encode())


class Checker(Handle):
    """A checker of the library, with the names of Python's."""

    def __init__(self, path: Path) -> None:
        super().__init__("checker_open", "checker_close", str(path).encode())
        self.workspace = Workspace()
        self.dof = ask("checker_dof", self)
        self.links = ask("checker_link_count", self)

    def _rows(self, Q: Any) -> np.ndarray:
        return np.ascontiguousarray(np.atleast_2d(np.asarray(Q, dtype=float)))

    def verdicts(self, query: str, Q: Any) -> np.ndarray:
        rows = self._rows(Q)
        out = np.full(len(rows), 9, dtype=np.int8)
        ask(f"checker_{query}", self, self.workspace, rows, size(len(rows)), out)
        return out

    def body(self, name: str) -> int:
        return int(ask("checker_find_body", self, name.encode()))

    def link(self, name: str) -> int:
        return int(ask("checker_find_link", self, name.encode()))

    def pairs(self) -> list[tuple[str, str]]:
        names = []
        for k in range(ask("checker_pair_count", self)):
            found = np.zeros(2, dtype=np.int32)
            ask("checker_pair", self, ctypes.c_int64(k), found)
            names.append(tuple(ask("checker_body_name", self, int(b)).decode() for b in found))
        return names

    def collide_by_pair(self, q: Any) -> np.ndarray:
        out = np.full(ask("checker_pair_count", self), 9, dtype=np.int8)
        ask("checker_collide_by_pair", self, self.workspace, self._rows(q), out)
        return out

    def placed(self, T: Any) -> tuple[int, np.ndarray]:
        one, out = np.full(1, 9, dtype=np.int8), np.full(ask("checker_pair_count", self), 9, dtype=np.int8)
        ask("checker_collide_placed", self, self.workspace, np.ascontiguousarray(T), one, out)
        return int(one[0]), out

    def link_poses(self, Q: Any) -> np.ndarray:
        rows = self._rows(Q)
        out = np.empty((len(rows), self.links, 4, 4))
        ask("checker_link_poses", self, rows, size(len(rows)), out)
        return out

    def distance(self, Q: Any) -> tuple[np.ndarray, np.ndarray]:
        rows = self._rows(Q)
        out, slopes = np.zeros(len(rows), dtype=DISTANCE), np.empty_like(rows)
        ask("checker_distance", self, self.workspace, rows, size(len(rows)), out, slopes)
        return out, slopes

    def clearance(self, Q: Any, softness: float = 0.005) -> tuple[np.ndarray, np.ndarray]:
        rows = self._rows(Q)
        out, slopes = np.empty(len(rows)), np.empty_like(rows)
        ask("checker_clearance", self, self.workspace, rows, size(len(rows)), ctypes.c_double(softness), out, slopes)
        return out, slopes

    def certify(
        self,
        Q0: Any,
        Q1: Any,
        tolerance: float = 1e-5,
        joint_error: Any = None,
        steps: int = 0,
        taken: Any = None,
        times: Any = None,
    ) -> tuple[np.ndarray, ...]:
        a, b = self._rows(Q0), self._rows(Q1)
        out, at = np.full(len(a), 9, dtype=np.int8), np.empty(len(a))
        bodies = np.empty((len(a), 2), dtype=np.int32)
        errors = None if joint_error is None else np.array(joint_error, dtype=float)
        t0, t1 = (None, None) if times is None else np.ascontiguousarray(times, dtype=float)
        options = options_of(tolerance, errors, steps, taken, t0, t1)
        ask("checker_certify_edges", self, self.workspace, a, b, size(len(a)), ctypes.byref(options), out, at, bodies)
        return out, at, bodies

    def free(
        self, Q0: Any, Q1: Any, tolerance: float = 1e-5, joint_error: Any = None, steps: int = 0, taken: Any = None
    ) -> np.ndarray:
        a, b = self._rows(Q0), self._rows(Q1)
        out = np.full(len(a), 9, dtype=np.int8)
        errors = None if joint_error is None else np.array(joint_error, dtype=float)
        options = options_of(tolerance, errors, steps, taken)
        ask("checker_motions_free", self, self.workspace, a, b, size(len(a)), ctypes.byref(options), out)
        return out

    def certify_curves(self, points: Any, steps: int = 0, taken: Any = None) -> tuple[np.ndarray, np.ndarray]:
        points = np.ascontiguousarray(points)
        out, at = np.full(len(points), 9, dtype=np.int8), np.empty(len(points))
        shape = size(len(points)), points.shape[1] - 1
        options = options_of(0.0, None, steps, taken)
        ask("checker_certify_curves", self, self.workspace, points, *shape, ctypes.byref(options), out, at, None)
        return out, at

    def plan(self, start: Any, goals: Any, seed: int = 0, joints: Any = None, cuts: int = 0) -> np.ndarray:
        moves = None if joints is None else np.array(joints, dtype=np.uint8)
        options = PlanOptions(None if moves is None else moves.ctypes.data, None, 0, 0.0, cuts, seed)
        rows = self._rows(goals)
        return self._path("plan", self._rows(start), rows, size(len(rows)), ctypes.byref(options))

    def shorten(self, path: Any) -> np.ndarray:
        rows = self._rows(path)
        return self._path("shorten", rows, size(len(rows)), None)

    def _path(self, name: str, *arguments: Any) -> np.ndarray:
        path, count = ctypes.c_void_p(), ctypes.c_size_t()
        ask(f"checker_{name}", self, self.workspace, *arguments, ctypes.byref(path), ctypes.byref(count))
        numbers = ctypes.cast(path, ctypes.POINTER(ctypes.c_double * (count.value * self.dof))).contents
        return np.array(numbers).reshape(-1, self.dof)

    def move(self, body: str, T: Any) -> None:
        ask("checker_move", self, np.array([self.body(body)], np.int32), np.ascontiguousarray(T, dtype=float), size(1))

    def add(self, name: str, bodies: Bodies, which: int, T: Any) -> int:
        made = np.zeros(1, dtype=np.int32)
        ask(
            "checker_add",
            self,
            name.encode(),
            bodies,
            ctypes.c_int64(which),
            np.ascontiguousarray(T, dtype=float),
            made,
        )
        return int(made[0])

    def attach(self, body: str, link: str, T: Any, touch: tuple[str, ...] = ()) -> None:
        links = np.array([self.link(name) for name in touch], dtype=np.int32)
        ask("checker_attach", self, self.body(body), self.link(link), np.ascontiguousarray(T, dtype=float), links,
            size(len(links)))  # fmt: skip

    def detach(self, body: str, T: Any) -> None:
        ask("checker_detach", self, self.body(body), np.ascontiguousarray(T, dtype=float))

    def set_present(self, body: str, present: bool) -> None:
        ask("checker_set_present", self, self.body(body), int(present))

    def allow(self, a: str, b: str, allowed: bool = True) -> None:
        ask("checker_allow", self, self.body(a), self.body(b), int(allowed))

    def set_bounds(self, body: str, **bounds: float) -> None:
        given = ctypes.byref(Bounds(**bounds)) if bounds else None
        ask("checker_set_bounds", self, self.body(body), given)

    def set_margin(self, a: str, b: str, margin: float) -> None:
        ask("checker_set_margin", self, self.body(a), self.body(b), ctypes.c_double(margin))


class Gate(Handle):
    """A gate of the library, with the options of Python's."""

    def __init__(self, checker: Checker, most: int, *, brake: str = "joints", **options: Any) -> None:
        self.checker = checker
        numbers = {"latency", "horizon", "tolerance", "steps", "wants_scale"}
        self.kept = {k: np.zeros(checker.dof) + v for k, v in options.items() if k not in numbers and v is not None}
        given = {k: v for k, v in options.items() if k in numbers} | {k: v.ctypes.data for k, v in self.kept.items()}
        asked = GateOptions(brake=int(brake == "path"), **given)
        super().__init__("gate_new", "gate_free", checker, ctypes.byref(asked), size(most))

    def check(self, q: Any, dq: Any, targets: Any, dt: float, time: float = 0.0) -> GateAnswer:
        rows, answer = np.ascontiguousarray(targets, dtype=float), GateAnswer()
        state = (np.ascontiguousarray(x, dtype=float) for x in (q, dq))
        period, now = ctypes.c_double(dt), ctypes.c_double(time)
        ask("gate_check", self, *state, rows, size(len(rows)), period, now, ctypes.byref(answer))
        return answer

    def brake(self, answer: GateAnswer) -> tuple[np.ndarray, ...]:
        """Times, positions, velocities and accelerations."""
        n, shape = answer.brake_count, (answer.brake_count, self.checker.dof)
        rows = (answer.positions, answer.velocities, answer.accelerations)
        return np.ctypeslib.as_array(answer.times, (n,)).copy(), *(np.ctypeslib.as_array(x, shape).copy() for x in rows)


def pair_query(name: str, workspace: Workspace, a: Any, b: Any, n: int, *rest: Any) -> None:
    """Call one of the queries of pairs; sides are (bodies, body or -1, poses or None)."""
    sides = []
    for bodies, body, poses in (a, b):
        address = None if poses is None else poses.ctypes.data
        count = 0 if poses is None else len(poses.reshape(-1, 16))
        sides.append(Side(bodies._as_parameter_, body, address, count))
    ask(name, workspace, ctypes.byref(sides[0]), ctypes.byref(sides[1]), size(n), *rest)
