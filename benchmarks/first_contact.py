"""First contacts of bodies that move and turn, in one batch, beside python-fcl's continuous collisions, one by one.

    python benchmarks/first_contact.py [--quick] [--out FOLDER]

FCL samples the motion: it names the first sample in contact, so it is late by up to a step. Pairs for which it and the
bracket differ by more than two of its steps are counted.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path

import numpy as np

import report
from clock import race, threads_set_to, timed
from loewner import Bodies, Body, FirstContact, Verdict, first_contact
from report import Row
from samples import Array, poses, rotations

PAIRS, QUICK = 100_000, 500
FCL_PAIRS, QUICK_FCL = 1_000, 20
BODIES = 100  # different ones in a batch
STEPS = 1_000  # samples of a motion by FCL

KINDS: dict[str, Callable[[np.random.Generator], Body]] = {
    "hull": lambda rng: Body.from_points(rng.normal(size=(20, 3)) * 0.3),
    "box": lambda rng: Body.box(rng.uniform(0.2, 1.0, 3)),
    "ball": lambda rng: Body.sphere(rng.uniform(0.1, 0.5)),
    "capsule": lambda rng: Body.capsule(rng.uniform(0.1, 0.2), rng.uniform(0.2, 1.0)),
    "cylinder": lambda rng: Body.cylinder(rng.uniform(0.1, 0.4), rng.uniform(0.2, 1.0)),
}
CASES = (("hull", "hull"), ("box", "box"), ("ball", "box"), ("ball", "ball"), ("capsule", "box"), ("cylinder", "box"))


def motion(rng: np.random.Generator, count: int, start: Array) -> tuple[Array, Array]:
    """Motions of a meter or two that turn by up to a radian and a half, shape (rows, BODIES, 4, 4)."""
    turns = rng.normal(size=(count, 3))
    turns *= rng.uniform(0.0, 1.5, (count, 1)) / np.linalg.norm(turns, axis=1, keepdims=True)
    angle = np.linalg.norm(turns, axis=1)[:, None, None]
    K = np.cross(np.eye(3), turns[:, None] / angle)
    turn = np.eye(3) - np.sin(angle) * K + (1.0 - np.cos(angle)) * K @ K
    R = rotations(rng, count)
    ends = poses(R, start), poses(R @ turn, rng.normal(size=(count, 3)) * 0.5 - 0.3 * start)
    return ends[0].reshape(-1, BODIES, 4, 4), ends[1].reshape(-1, BODIES, 4, 4)


def row(first: str, second: str, quick: bool) -> Row:
    rng = np.random.default_rng(0)
    count = QUICK if quick else PAIRS
    a, b = ([KINDS[kind](rng) for _ in range(BODIES)] for kind in (first, second))
    way = rng.normal(size=(count, 3))
    start = 2.0 * way / np.linalg.norm(way, axis=1, keepdims=True)
    Ma, Mb = motion(rng, count, np.zeros((count, 3))), motion(rng, count, start)
    arguments = Bodies(a), Ma, Bodies(b), Mb
    us = timed(lambda: first_contact(*arguments), count)
    if find_spec("fcl") is None or "box" not in (first, second) or first not in ("box", "ball"):
        cost = race({"us": us}, 2 if quick else 5)
        return Row(f"{first}, {second}", "first_contact", cost["us"], "python-fcl", None, count, note="not run")
    few = QUICK_FCL if quick else FCL_PAIRS
    found = np.empty(few)
    theirs = timed(lambda: fcl_times(a, Ma, b, Mb, found), few)
    cost = race({"us": us, "fcl": theirs}, 2 if quick else 5)
    return Row(
        f"{first}, {second}", "first_contact", cost["us"], "python-fcl, 1,000 samples", cost["fcl"], count, None,
        differing(first_contact(*arguments), found),
    )  # fmt: skip


def differing(ours: FirstContact, theirs: Array) -> int:
    """Number of pairs whose times are more than two samples apart."""
    times = np.minimum(np.asarray(ours.touching_at).reshape(-1)[: len(theirs)], 1.0)
    settled = np.asarray(ours.verdict).reshape(-1)[: len(theirs)] != Verdict.AMBIGUOUS
    return int((settled & (np.abs(times - theirs) > 2.0 / STEPS)).sum())


def fcl_times(a: list[Body], Ma: tuple[Array, Array], b: list[Body], Mb: tuple[Array, Array], out: Array) -> None:
    """Times of contact by FCL; 1 for never."""
    import fcl

    def shape(body: Body) -> object:
        piece = body.pieces[0]
        return (
            fcl.Sphere(float(piece.outer.semi_axes.max()))
            if piece.kind == "sphere"
            else fcl.Box(*np.ptp(piece.vertices, axis=0))
        )

    shapes = [[shape(body) for body in side] for side in (a, b)]
    request = fcl.ContinuousCollisionRequest(STEPS, 1e-6, fcl.CCDMotionType.CCDM_LINEAR, fcl.CCDSolverType.CCDC_NAIVE)
    for k in range(len(out)):
        at = divmod(k, BODIES)
        ends = [[fcl.Transform(T[at][:3, :3], T[at][:3, 3]) for T in M] for M in (Ma, Mb)]
        objects = [fcl.CollisionObject(shapes[side][at[1]], ends[side][0]) for side in (0, 1)]
        result = fcl.ContinuousCollisionResult()
        fcl.continuousCollide(objects[0], ends[0][1], objects[1], ends[1][1], request, result)
        out[k] = result.time_of_contact


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="small sizes: shows that it works, measures little")
    parser.add_argument("--out", type=Path, default=Path("out/benchmarks"), help="folder for results")
    asked = parser.parse_args(arguments)
    with threads_set_to(1):
        rows = [row(*kinds, asked.quick) for kinds in CASES]
    report.show("first contacts: pairs in one batch, one thread", rows)
    report.write(asked.out / "first_contact.csv", rows, report.machine())
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
