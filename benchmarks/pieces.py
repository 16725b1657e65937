"""Two bodies of many pieces: their trees beside a trial of all piece pairs. No rival takes a union of convex pieces."""

from __future__ import annotations

from pathlib import Path

import numpy as np

import loewner
from clock import race, threads_set_to, timed
from loewner import Body, bodies
from loewner._kernels import codes, columns
from loewner.queries import pairs as queries
from report import Row
from samples import poses, rotations

PIECES, QUICK = 500, 40
POSES = 40
FARTHEST = 4.0  # metres between the centers: from one in the other to far apart


def run(quick: bool, folder: Path) -> list[Row]:
    count = QUICK if quick else PIECES
    rng = np.random.default_rng(0)
    a, b = shell(rng, count), shell(rng, count)
    T = poses(rotations(rng, POSES), np.linspace(0, FARTHEST, POSES)[:, None] * [1.0, 0.0, 0.0])
    plain_a, plain_b = without_trees(a), without_trees(b)
    _, tally = queries._settle(codes.EXACT, 0.0, queries._prepare(a, None, b, T, check=True))
    note = f"{tally.sum() / POSES:.0f} of {count**2} piece pairs settled by collide; differing answers"
    rows = []
    for name, answers in (
        ("collide", lambda x, y: loewner.collide(x, None, y, T)),
        ("distance, exact", lambda x, y: loewner.distance(x, None, y, T, exact=True).distance),
    ):
        cost = race(
            {
                "us": timed(lambda answers=answers: answers(a, b), POSES),
                "rival": timed(lambda answers=answers: answers(plain_a, plain_b), POSES),
            },
            1,
        )
        differing = int((np.abs(1.0 * answers(a, b) - answers(plain_a, plain_b)) > 1e-8).sum())
        case = f"{count} x {count} pieces"
        rows.append(Row(case, name, cost["us"], "all piece pairs", cost["rival"], POSES, None, differing, note))
    return rows


def shell(rng: np.random.Generator, count: int) -> Body:
    """Small hulls strewn over the unit sphere."""
    centers = rng.normal(size=(count, 3))
    centers /= np.linalg.norm(centers, axis=1, keepdims=True)
    with threads_set_to(None):
        return Body.from_pieces([c + 0.07 * rng.normal(size=(12, 3)) for c in centers])


def without_trees(body: Body) -> Body:
    """The same body, packed as if any number of pieces were few."""
    few, columns.FEW = columns.FEW, len(body._packed.layout) + 1
    try:
        return Body(bodies.Packed.of(bodies.PieceArrays(**bodies.arrays_of(body._packed))))
    finally:
        columns.FEW = few
