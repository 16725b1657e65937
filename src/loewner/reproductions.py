"""Turn a wrong answer about two convex bodies into a small program that needs no libraries and proves the error."""

from __future__ import annotations

import pprint
from collections.abc import Callable, Iterator, Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from loewner._base import _validate
from loewner._base._guard import guarded
from loewner._base._rotations import pose_of
from loewner._base._validate import Floats, Ints
from loewner.bodies import Body
from loewner.errors import GeometryError, InputError
from loewner.judging import PARTS, POINT, VECTORS, Finding, Judgement, judge_answers
from loewner.queries import pairs as queries

# Answers of another program, keyed by the names of arguments of `judging.judge_answers`.
Answers = Mapping[str, Any]

# Numbers of decimals to which corners are rounded, in the order in which they are tried.
DECIMALS = (1, 2, 3, 4, 6)

# Largest number of differences between corners of the two bodies from which a surface is made.
MOST_DIFFERENCES = 1_000_000

# The end of each program. Lengths are bounded by roots to 15 decimals, rounded up or down.
CHECKS = '''

def placed(points, pose):
    return [[sum(Fraction(r) * Fraction(x) for r, x in zip(row, p)) + Fraction(row[3]) for row in pose] for p in points]


def minus(p, q):
    return [x - y for x, y in zip(p, q)]


def dot(p, q):
    return sum(x * y for x, y in zip(p, q))


def cross(p, q):
    return [p[i - 2] * q[i - 1] - p[i - 1] * q[i - 2] for i in range(3)]


def root(square, up):
    return Fraction(isqrt(int(square * 10**30)) + up, 10**15)


def along(direction, a, b, up=False):
    """Gap of two bodies along a direction, negative for an overlap: rounded down, or up. Their distance is no less."""
    n = [Fraction(x) for x in direction]
    gap = min(dot(n, q) for q in b) - max(dot(n, p) for p in a)
    return root(gap * gap / dot(n, n), up) if gap >= 0 else -root(gap * gap / dot(n, n), not up)


def between(weights, a, b):
    """Distance of two points of the bodies, weighted means of corners, rounded up. Their distance is no more."""
    p, q = (
        [sum(Fraction(w) * x[i] for w, x in zip(share, corners)) / sum(map(Fraction, share)) for i in range(3)]
        for share, corners in zip(weights, (a, b))
    )
    return root(dot(minus(p, q), minus(p, q)), True)


def inside(corners, triangles, a, b):
    """How far 0 is inside a closed surface of triangles between differences of corners, rounded down.

    The bodies overlap: no shorter translation separates them.
    """
    points = [minus(a[i], b[j]) for i, j in corners]
    edges = {(t[k - 1], t[k]) for t in triangles for k in range(3)}
    assert len(edges) == 3 * len(triangles) and all((j, i) in edges for i, j in edges), "closed"
    least = None
    for p, q, r in ([points[k] for k in t] for t in triangles):
        n = cross(minus(q, p), minus(r, p))
        assert dot(n, p) > 0, "0 is behind each triangle"
        depth = root(dot(n, p) ** 2 / dot(n, n), False)
        least = depth if least is None else min(least, depth)
    return least


a, b = placed(A, POSE_OF_A), placed(B, POSE_OF_B)
'''


@guarded
def reproduction(
    a: Body,
    T_world_a: ArrayLike | None,
    b: Body,
    T_world_b: ArrayLike | None,
    *,
    colliding: ArrayLike | None = None,
    distance: ArrayLike | None = None,
    depth: ArrayLike | None = None,
    witness_a: ArrayLike | None = None,
    witness_b: ArrayLike | None = None,
    normal: ArrayLike | None = None,
    tolerance: float = 1e-6,
    engine: Callable[[Floats, Floats], Answers] | None = None,
) -> str:
    """Write a one-page program that proves an answer wrong, using only Python's standard module ``fractions``.

    The program contains the corners, the poses and the answer, as decimals that are read back without loss. For each
    wrong part, it also contains a proof: a plane between the bodies, two of their points, or a surface whose corners
    are differences between their corners. The program prints a lower bound on the error of the answer. Include the
    program in a report to the other program's authors.

    Parameters
    ----------
    a, b : Body
        Convex hulls, that is, bodies with a single polytope each.
    T_world_a, T_world_b : array_like, shape (4, 4), or None
        Poses; translation in metres. None is the identity.
    colliding, distance, depth, witness_a, witness_b, normal, tolerance
        One answer, as for `judging.judge_answers`.
    engine : callable, optional
        Called as engine(corners_a, corners_b) with arrays of shapes (n, 3). It returns the other program's answers
        about these hulls at the same poses, in a dict keyed by names of parts. With an engine, the bodies are
        simplified: coordinates are rounded and corners are removed one by one, as long as the worst part remains wrong
        in the same way. If an engine is passed, no answer may be passed as an argument.

    Returns
    -------
    str
        Python code.

    Raises
    ------
    PoseError, InputError
        As for `judging.judge_answers`. InputError is also raised if a body is not a single polytope, or if nothing is
        proven wrong.

    Examples
    --------
    >>> from loewner import Body
    >>> T = np.eye(4)
    >>> T[0, 3] = 1.5
    >>> code = reproduction(Body.box([1, 1, 1]), None, Body.box([1, 1, 1]), T, distance=0.0)
    >>> exec(code)
    DISTANCE_TOO_SMALL: wrong by at least 0.5 m

    With an engine, here a function that always returns 0, the bodies are reduced to a few corners:

    >>> code = reproduction(Body.box([1, 1, 1]), None, Body.box([1, 1, 1]), T, engine=lambda a, b: {"distance": 0.0})
    >>> code.count("0.5]")  # of two tetrahedra
    8
    """
    poses = [_validate.pose(T, name) for T, name in ((T_world_a, "T_world_a"), (T_world_b, "T_world_b"))]
    corners = [_corners(body, name) for body, name in ((a, "a"), (b, "b"))]
    all_answers = {
        "colliding": colliding, "distance": distance, "depth": depth, "witness_a": witness_a, "witness_b": witness_b,
        "normal": normal,
    }  # fmt: skip
    answers = {name: value for name, value in all_answers.items() if value is not None}
    if _validate.callback(engine, "engine") is not None:
        if answers:
            raise InputError(f"engine: expected no answers beside it, found {', '.join(answers)}")
        corners, answers = _reduced(corners, poses, engine, tolerance)
    bodies, said = _judged(corners, poses, answers, tolerance)
    if not said.wrong:
        raise InputError(f"expected an answer that is proven wrong, found {_names(said)}")
    return _written(bodies, corners, poses, answers, said)


def _judged(
    corners: list[Floats], poses: list[Floats], answers: Answers, tolerance: float
) -> tuple[list[Body], Judgement]:
    """Make two hulls, and judge one answer about them; arrays of answers are refused unjudged, which saves seconds."""
    bodies = [Body.from_points(points) for points in corners]
    many = [x.shape for name, x in answers.items() if isinstance(x, np.ndarray) and x.ndim > (name in VECTORS)]
    if not many:
        said = judge_answers(bodies[0], poses[0], bodies[1], poses[1], **answers, tolerance=tolerance)
        many = [said.lower.shape] * (said.kinds.ndim > 1)
    if many:
        raise InputError(f"expected one answer about one pair, found shape {_validate.shape_text(many[0])}")
    return bodies, said


def _corners(body: Any, name: str) -> Floats:
    """Return the corners of a convex hull."""
    pieces = body.pieces if isinstance(body, Body) else ()
    if len(pieces) != 1 or pieces[0].kind != "polytope":
        kinds = ", ".join(sorted({piece.kind for piece in pieces})) or _validate.short(body)
        raise InputError(f"{name}: expected a body of one polytope, found {len(pieces)} pieces ({kinds})")
    return np.asarray(pieces[0].vertices)


def _names(said: Judgement, above: Finding = Finding.NOT_GIVEN) -> str:
    return ", ".join(str(kind) for kind in said.counts() if kind > above)


def _reduced(
    corners: list[Floats], poses: list[Floats], engine: Any, tolerance: float
) -> tuple[list[Floats], dict[str, Any]]:
    """Round coordinates and remove corners as long as the other program's answer stays wrong in the same way."""

    def asked(trial: list[Floats]) -> tuple[dict[str, Any], Judgement]:
        answers = engine(trial[0], trial[1])
        if not isinstance(answers, Mapping) or not answers.keys() <= {*PARTS} - {"witnesses"}:
            raise InputError(f"engine: expected a dict of answers, found {_validate.short(answers)}")
        return dict(answers), _judged(trial, poses, answers, tolerance)[1]

    answers, said = asked(corners)
    worst = Finding(int(said.kinds[np.argmax(said.excess)]))
    if worst <= Finding.UNDECIDED:
        return corners, answers
    for trial in _smaller(corners):
        try:
            trial_answers, said = asked(trial)
        except GeometryError:  # too flat for a body
            continue
        if worst in said.kinds:
            corners[:], answers = trial, trial_answers
    return corners, answers


def _smaller(corners: list[Floats]) -> Iterator[list[Floats]]:
    """Propose smaller bodies; the caller puts the bodies that it accepts into `corners`."""
    for decimals in DECIMALS:
        rounded = [np.round(points, decimals) + 0.0 for points in corners]
        yield rounded
        if all(np.array_equal(p, q) for p, q in zip(corners, rounded, strict=True)):
            break
    for side in (0, 1):
        for k in reversed(range(len(corners[side]))):
            if len(corners[side]) > 4:
                trial = list(corners)
                trial[side] = np.delete(corners[side], k, axis=0)
                yield trial


def _written(
    bodies: list[Body], corners: list[Floats], poses: list[Floats], answers: dict[str, Any], said: Judgement
) -> str:
    """Write the program: the bodies, the answer, the checks, and a proof of each part that is wrong."""
    numbers = {name: np.asarray(value, dtype=float).tolist() for name, value in answers.items()}
    plain = {name: bool(x) if name == "colliding" else x for name, x in numbers.items() if not np.isnan(x).any()}
    measured = queries.distance(bodies[0], poses[0], bodies[1], poses[1], exact=True)
    plane = repr(np.asarray(measured.normal).tolist())
    lines = []
    for part, kind in zip(PARTS, map(Finding, said.kinds.tolist()), strict=True):
        if kind > Finding.UNDECIDED:
            error = _error(part, kind, plain, plane, measured, corners, poses)
            lines += [f"error = {error}", "assert error > 0", _PRINT.format(kind)]
    data = {"A": corners[0], "POSE_OF_A": poses[0][:3], "B": corners[1], "POSE_OF_B": poses[1][:3]}
    texts = [f"{name} = {pprint.pformat(x.tolist(), width=110)}" for name, x in data.items()]
    wrong = _names(said, above=Finding.UNDECIDED)
    intro = f'"""A wrong answer about the convex hulls of A and B at their poses, in metres: {wrong}."""'
    answer = f"ANSWER = {pprint.pformat(plain, width=110, sort_dicts=False)}"
    head = [intro, "", "from fractions import Fraction", "from math import isqrt", "", *texts, answer]
    return "\n".join(head) + CHECKS + "\n".join(lines) + "\n"


_PRINT = 'print(f"{}: wrong by at least {{float(error):.9g}} m")'


def _error(
    part: str, kind: Finding, answers: dict[str, Any], plane: str, measured: Any, corners: list[Floats],
    poses: list[Floats],
) -> str:  # fmt: skip
    """Write the lower bound on an error as an expression of the checks."""
    claim = f'abs(Fraction(ANSWER["{part}"]))'
    if kind == Finding.WITNESS_OFF_BODY:
        side, place = part[-1], pose_of(np.eye(3), answers[part])
        k = "ab".index(side)
        away = queries.distance(Body.from_points(corners[k]), poses[k], Body.sphere(POINT), place, exact=True)
        return f'along({np.asarray(away.normal).tolist()}, {side}, [[Fraction(x) for x in ANSWER["{part}"]]])'
    if kind == Finding.WITNESSES_DO_NOT_MATCH:
        length = "distance" if answers.get("distance") else "depth" if "depth" in answers else "distance"
        step = 'minus(*[[Fraction(x) for x in ANSWER[name]] for name in ("witness_b", "witness_a")])'
        return f'abs(root(dot({step}, {step}), False) - abs(Fraction(ANSWER["{length}"]))) - Fraction(1, 10**15)'
    if kind == Finding.NORMAL_WRONG:
        return f'along({plane}, a, b) - along(ANSWER["normal"], a, b, up=True)'
    if kind == Finding.WRONG_COLLIDING:
        return f"along({plane}, a, b)"
    if kind == Finding.DISTANCE_TOO_SMALL:
        return f'along({plane}, a, b) - Fraction(ANSWER["{part}"])'
    if kind == Finding.DEPTH_TOO_LARGE:
        return f"{claim} + min(along({plane}, a, b), 0)"
    if kind == Finding.DISTANCE_TOO_LARGE and measured.distance > 0.0:
        weights = [
            _weights(points, T, np.asarray(near))
            for points, T, near in zip(corners, poses, (measured.witness_a, measured.witness_b), strict=True)
        ]
        return f"{claim} - between({weights}, a, b)"
    surface = _surface(corners, poses, small=kind != Finding.DEPTH_TOO_SMALL)
    proof = f"inside({surface[0].tolist()}, {surface[1].tolist()}, a, b)"
    if kind == Finding.DEPTH_TOO_SMALL:
        return f"{proof} - {claim}"
    return f"{proof} and {claim}" if kind == Finding.DISTANCE_TOO_LARGE else proof


def _weights(points: Floats, T: Floats, near: Floats) -> list[float]:
    """Return weights for which the weighted mean of the corners is close to a point of their hull."""
    from scipy.optimize import nnls

    x = points @ T[:3, :3].T + T[:3, 3] - near
    scale = max(float(np.abs(x).max()), np.finfo(float).tiny)
    weights, _ = nnls(np.vstack([x.T / scale, np.ones(len(x))]), np.array([0.0, 0.0, 0.0, 1.0]))
    return [float(weight) for weight in weights]


def _surface(corners: list[Floats], poses: list[Floats], *, small: bool) -> tuple[Ints, Ints]:
    """Find a surface around 0 whose corners are differences of corners: a hull or, if it may be small, a tetrahedron.

    Returns
    -------
    corners : ndarray of int, shape (m, 2)
        For each corner of the surface, the indices of the corners of a and b whose difference it is.
    triangles : ndarray of int, shape (t, 3)
        Counter-clockwise when seen from outside.
    """
    from scipy.spatial import ConvexHull

    a, b = (points @ T[:3, :3].T + T[:3, 3] for points, T in zip(corners, poses, strict=True))
    if len(a) * len(b) > MOST_DIFFERENCES:
        raise InputError(f"expected hulls with up to {MOST_DIFFERENCES} pairs of corners, found {len(a) * len(b)}")
    points = (a[:, None] - b[None]).reshape(-1, 3)
    hull = ConvexHull(points)
    triangles = _outward(points, hull.simplices, hull.equations)
    if small:
        best, chosen = -np.inf, triangles
        for vertex in hull.vertices:
            along = hull.equations[:, :3] @ -points[vertex]
            way = np.divide(-hull.equations[:, 3], along, out=np.full(len(along), np.inf), where=along > 0.0)
            four = np.append(triangles[int(way.argmin())], vertex)
            simplex = ConvexHull(points[four]) if np.abs(np.linalg.det(np.diff(points[four], axis=0))) > 0.0 else None
            if simplex is not None and -simplex.equations[:, 3].max() > best:
                best = -simplex.equations[:, 3].max()
                chosen = four[_outward(points[four], simplex.simplices, simplex.equations)]
        triangles = chosen
    used, places = np.unique(triangles, return_inverse=True)
    return np.column_stack(np.divmod(used, len(b))), places.reshape(-1, 3)


def _outward(points: Floats, triangles: Ints, planes: Floats) -> Ints:
    """Turn triangles so that they are counter-clockwise when seen from outside."""
    p, q, r = (points[triangles[:, k]] for k in range(3))
    turned = np.einsum("ti,ti->t", np.cross(q - p, r - p), planes[:, :3]) < 0.0
    return np.where(turned[:, None], triangles[:, ::-1], triangles)
