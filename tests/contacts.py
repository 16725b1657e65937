"""Pairs of ellipsoids built to sit at contact, and a judge of them that does not round."""

from collections.abc import Iterator
from fractions import Fraction
from typing import NamedTuple

import numpy as np
from scipy.optimize import minimize

from exact import ExactEllipsoid, gap_bounds, rational
from families import rotations
from loewner import Bodies, Body, Ellipsoids, distance
from oracles import exact_ellipsoid_verdict

APART, MEETING, UNDECIDED = 1, -1, 0

SEMI_AXES = {
    "balls": lambda rng, n: np.ones((n, 3)),
    "round": lambda rng, n: 10 ** rng.uniform(-0.5, 0, size=(n, 3)),
    "needles": lambda rng, n: [1, 1e-3, 1e-3] * 10 ** rng.uniform(-0.2, 0, size=(n, 3)),
    "discs": lambda rng, n: [1, 1, 1e-3] * 10 ** rng.uniform(-0.2, 0, size=(n, 3)),
    "thin": lambda rng, n: 10 ** rng.uniform(-6, 0, size=(n, 3)),
}


class Setting(NamedTuple):
    """Where pairs stand and how large they are; lengths in metres."""

    shapes: tuple[str, str]
    size_a: float = 1.0
    size_b: float = 1.0
    offset: float = 0.0  # of a's ellipsoids from the origin of their body
    world: float = 1.0  # of the bodies from the origin of the world
    turn: str = "double"  # "float32": entries that went through single precision; "bent": within the pose tolerance


class Contacts(NamedTuple):
    """Posed pairs: body k[p] of a and of b, at poses Ta[p] and Tb[p]."""

    k: np.ndarray
    Ta: np.ndarray
    Tb: np.ndarray
    normal: np.ndarray  # unit, from a to b: square to both ellipsoids where they are nearest


def ellipsoid_bodies(rng: np.random.Generator, shape: str, count: int, size: float, offset: float) -> Bodies:
    """Ellipsoids about the origins of their bodies, or turned and away from them for good."""
    axes = SEMI_AXES[shape](rng, count) * size
    if offset == 0:
        return Bodies.ellipsoids(axes)
    T = np.tile(np.eye(4), (count, 1, 1))
    T[:, :3, :3] = rotations(rng, count)
    T[:, :3, 3] = rng.uniform(-offset, offset, size=(count, 3)) / 3**0.5
    return Bodies([Body.ellipsoid(s).transformed(P) for s, P in zip(axes, T, strict=True)])


def _turned(rng: np.random.Generator, count: int, turn: str) -> np.ndarray:
    R = rotations(rng, count)
    if turn == "float32":
        return R.astype(np.float32).astype(float)
    if turn == "bent":
        return R + rng.uniform(-1.5e-7, 1.5e-7, size=R.shape)
    return R


def _single(T: np.ndarray) -> np.ndarray:
    return T.astype(np.float32).astype(float)


def contacts(
    rng: np.random.Generator,
    A: Ellipsoids,
    B: Ellipsoids,
    each: int,
    setting: Setting,
    margin: float,
    exponents: tuple[float, float],
) -> Contacts:
    """Poses at which ellipsoid k of A and of B are apart by the margin, plus or minus 10**exponents of their size.

    Instead of searching for the near points they are chosen: where the normal of a is n, and that of b is -n. Half of
    the directions are drawn so that the tips of needles get their share.
    """
    k = np.tile(np.arange(len(A)), each)
    n = len(k)
    Ta, Tb = (np.tile(np.eye(4), (n, 1, 1)) for _ in "ab")
    Ta[:, :3, :3], Tb[:, :3, :3] = _turned(rng, n, setting.turn), _turned(rng, n, setting.turn)
    Ta[:, :3, 3] = rng.uniform(-1, 1, size=(n, 3)) * setting.world
    if setting.turn == "float32":
        Ta = _single(Ta)
    Fa, Fb = Ta[:, :3, :3] @ A.factor[k], Tb[:, :3, :3] @ B.factor[k]
    normal = rng.normal(size=(n, 3))
    normal[::2] = np.linalg.solve(Fa.transpose(0, 2, 1)[::2], normal[::2, :, None])[..., 0]
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    out_a, out_b = (_support(F, normal) for F in (Fa, Fb))
    gap = np.minimum(np.linalg.norm(out_a, axis=1), np.linalg.norm(out_b, axis=1))
    gap *= rng.choice([-1, 1], size=n) * 10 ** rng.uniform(*exponents, size=n)
    center_a, center_b = ((T[:, :3, :3] @ E.center[k][:, :, None])[..., 0] for T, E in ((Ta, A), (Tb, B)))
    Tb[:, :3, 3] = Ta[:, :3, 3] + (center_a - center_b + out_a + out_b + (margin + gap)[:, None] * normal)
    if setting.turn == "float32" and margin == 0:
        Tb = _single(Tb)
    return Contacts(k, Ta, Tb, normal)


def _support(F: np.ndarray, n: np.ndarray) -> np.ndarray:
    """Where ellipsoids about the origin reach farthest along n, in batches."""
    h = (F.swapaxes(-1, -2) @ n[..., None])[..., 0]
    return (F @ (h / np.linalg.norm(h, axis=-1, keepdims=True))[..., None])[..., 0]


def judge(A: Ellipsoids, B: Ellipsoids, c: Contacts, p: int, margin: float) -> int:
    """Whether pair p is APART by more than the margin or MEETING within it, proven in rationals; or UNDECIDED."""
    k = c.k[p]
    a = ExactEllipsoid(A.center[k], A.factor[k], c.Ta[p])
    b = ExactEllipsoid(B.center[k], B.factor[k], c.Tb[p])
    found = _judge_along(a, b, c.normal[p], margin)
    if found != UNDECIDED:
        return found
    # The chosen normal tells nothing where the pair reaches deep, or rounding moved it aside.
    verdict = exact_ellipsoid_verdict(A.center[k], A.factor[k], c.Ta[p], B.center[k], B.factor[k], c.Tb[p])
    if margin == 0 or verdict == MEETING:
        return verdict
    for n in _parting(a, b, c.normal[p]):
        found = _judge_along(a, b, n, margin)
        if found != UNDECIDED:
            break
    return found


def _judge_along(a: ExactEllipsoid, b: ExactEllipsoid, n: np.ndarray, margin: float) -> int:
    """What the planes square to n, and the points where they touch, prove."""
    if gap_bounds(a, b, n)[0] > margin:
        return APART
    # The points are rounded, and must lie in their ellipsoids: thin ones need more of a push inward than round ones.
    for inward in (1 - 1e-13, 1 - 1e-14, 1 - 1e-15):
        x = a.center + rational(inward * _support(a.factor.astype(float), n))
        y = b.center - rational(inward * _support(b.factor.astype(float), n))
        middle = (x + y) / 2
        if a.contains(middle) and b.contains(middle):
            return MEETING
        if sum((x - y) * (x - y)) <= Fraction(margin) ** 2 and a.contains(x) and b.contains(y):
            return MEETING
    return UNDECIDED


def _parting(a: ExactEllipsoid, b: ExactEllipsoid, start: np.ndarray) -> Iterator[np.ndarray]:
    """Directions in which the gap may be the largest, from a minimiser and from the library: guesses, no proofs."""
    Fa, Fb, r = (np.array(x, dtype=float) for x in (a.factor, b.factor, b.center - a.center))

    def overlap(n: np.ndarray) -> float:
        return float((np.linalg.norm(Fa.T @ n) + np.linalg.norm(Fb.T @ n) - r @ n) / np.linalg.norm(n))

    for n in (r, start):
        for method in ("Nelder-Mead", "BFGS", "Nelder-Mead"):
            n = minimize(overlap, n / np.linalg.norm(n), method=method, tol=1e-14).x
        yield n / np.linalg.norm(n)
    yield distance(*_alone(Fa, np.zeros(3)), *_alone(Fb, r), exact=True).normal


def _alone(F: np.ndarray, center: np.ndarray) -> tuple[Body, np.ndarray]:
    """An ellipsoid along its axes, and the pose that puts it where it is."""
    axes, lengths, _ = np.linalg.svd(F)
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = axes * [1, 1, np.linalg.det(axes)], center
    return Body.ellipsoid(lengths), T
