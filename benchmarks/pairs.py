"""100,000 pairs in one call, beside Coal in a C++ loop, Coal and python-fcl from Python; all on one thread."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

import loewner
from clock import race, timed
from loewner import Bodies, Body, Ellipsoids, Verdict
from loewner.paper import overlap_by_eigenvalue
from report import REQUIRED, Row, differences
from rivals import CoalLoop, CoalPython, FclPython, Missing, Settings, all_settings, build_loop
from samples import Array, Pairs, clearance, paper_pairs, poses, repeated_pairs, world_vertices

COUNT, QUICK = 100_000, 2_000
ELLIPSOIDS = 5_000  # pairs of them; the times are per pair
# Pairs on which the ways to ask Coal are first compared, and how many of the fastest then run on all pairs.
TRIAL, FINALISTS = 2_000, 4
# The data that the required ratios are about, and the same with every hull turned; the others' ratios are shown beside.
DECISIVE = ("distinct hulls, volume, shifted only", "distinct hulls, volume")
# Most differing answers that are judged by linear programs.
JUDGED = 200
# Distances that differ by less than Coal's own tolerance (1e-6, relative) agree.
COAL_TOLERANCE = 1e-5


def run(quick: bool, folder: Path) -> list[Row]:
    count = QUICK if quick else COUNT
    rows = []
    for p in (
        paper_pairs(count, turned=False),
        paper_pairs(count),
        paper_pairs(count // 5, "radius"),
        repeated_pairs(count // 5),
    ):
        rows += compare(p, quick, folder)
    return rows


@dataclass(frozen=True)
class Contest:
    """One query of ours beside the ways to ask Coal the same.

    Attributes
    ----------
    query : callable
        Ours, over all chosen pairs.
    truth : ndarray, shape (n,)
        What Coal's answers are compared with: booleans or distances.
    chosen : ndarray of int, shape (n,), or None
        Numbers of the pairs it is about; None for all.
    judge : callable
        Says for Coal's answers who is wrong where they differ.
    """

    case: str
    us: str
    query: Callable[[], Any]
    rival: str
    ways: list[Settings]
    truth: Array
    required: float | None
    judge: Callable[[Array], str]
    chosen: Array | None = None


def compare(p: Pairs, quick: bool, folder: Path) -> list[Row]:
    """All comparisons on one set of pairs."""
    rounds = 2 if quick else 5
    colliding = loewner.collide(*p.arguments())
    verdicts = loewner.classify(*p.arguments())
    assert not (colliding & (verdicts == Verdict.FREE)).any(), "a colliding pair was certified free"
    assert not (~colliding & (verdicts == Verdict.COLLIDING)).any(), "a free pair was certified colliding"
    listed = contests(p, colliding)
    try:
        with CoalLoop(build_loop(folder), p, folder) as loop:
            rows = [row for c in listed for row in beside_loop(c, loop, rounds)]
    except Missing as missing:
        rows = [alone(c, str(missing), rounds) for c in listed]

    shares = ", ".join(f"{(verdicts == v).mean():.1%} {v.name.lower()}" for v in Verdict)
    guess = timed(lambda: loewner.collide(*p.arguments(), method="estimate"), len(p))
    guessed = loewner.collide(*p.arguments(), method="estimate")
    cost = race({"us": guess}, rounds)["us"]
    differing, note = differences(colliding, guessed), f"classify says {shares}"
    case, us = f"{p.name}: boolean", "collide, estimate"
    rows.append(Row(case, us, cost, "our exact answer", None, len(p), None, differing, note))
    return rows + beside_python(p, colliding, rounds)


def contests(p: Pairs, colliding: Array) -> list[Contest]:
    ellipsoids = p.bodies.outer[p.a].transformed(p.Ta), p.bodies.outer[p.b].transformed(p.Tb)
    overlapping = loewner.overlap(*ellipsoids)

    def needed(key: str) -> float | None:
        return REQUIRED[key] if p.name in DECISIVE else None

    def nearest(case: str, key: str, where: Array, ways: list[Settings]) -> Contest:
        some = p.part(where)
        query = partial(loewner.distance, *some.arguments(), exact=True)
        exact = query().distance
        judge = partial(largest_difference, exact)
        return Contest(
            f"{p.name}: {case}", "distance, exact", query, "Coal C++ hulls", ways, exact, needed(key), judge, where
        )

    return [
        *ellipsoid_contests(p),
        Contest(
            f"{p.name}: verdict",
            "classify",
            partial(loewner.classify, *p.arguments()),
            "Coal C++ ellipsoids",
            all_settings("ellipsoid-collide", "ellipsoid-solver"),
            overlapping,
            needed("classify vs Coal C++ ellipsoids"),
            partial(judged_by_eigenvalues, *ellipsoids, overlapping),
        ),
        Contest(
            f"{p.name}: boolean",
            "collide",
            partial(loewner.collide, *p.arguments()),
            "Coal C++ hulls",
            all_settings("hull-collide", "hull-solver"),
            colliding,
            needed("collide vs Coal C++"),
            partial(judged_by_programs, p, colliding),
        ),
        nearest(
            "distance", "distance vs Coal C++", np.flatnonzero(~colliding), all_settings("hull-distance", early=(0,))
        ),
        nearest(
            "penetration",
            "penetration vs Coal C++",
            np.flatnonzero(colliding),
            all_settings("hull-signed", "hull-contact", early=(0,)),
        ),
    ]


def ellipsoid_contests(p: Pairs) -> list[Contest]:
    """Distance and depth of the outer ellipsoids themselves, on the first pairs."""
    some = p.part(slice(0, ELLIPSOIDS))
    placed = [
        (Bodies([Body.ellipsoid(s) for s in E.semi_axes]), poses(E.rotation, E.center))
        for E in (p.bodies.outer[some.a].transformed(some.Ta), p.bodies.outer[some.b].transformed(some.Tb))
    ]

    def query(where: Array) -> Callable[[], Any]:
        (a, Ta), (b, Tb) = placed
        return partial(loewner.distance, a[where], Ta[where], b[where], Tb[where], exact=True)

    depths = query(np.arange(len(some)))().distance
    rows = []
    for case, where, asked in (
        ("ellipsoids apart", np.flatnonzero(depths > 0), "ellipsoid-distance"),
        ("ellipsoids overlapping", np.flatnonzero(depths <= 0), "ellipsoid-signed"),
    ):
        judge = partial(largest_difference, depths[where])
        ways = all_settings(asked, early=(0,))
        rows.append(
            Contest(
                f"{p.name}: {case}", "distance, exact", query(where), "Coal C++ ellipsoids", ways, depths[where], None,
                judge, where,
            )
        )  # fmt: skip
    return rows


def beside_loop(c: Contest, loop: CoalLoop, rounds: int) -> list[Row]:
    """Ours beside Coal's fastest settings, and beside its fastest with the fewest wrong answers if those are others."""
    n = len(c.truth)
    selection = loop.select(c.chosen)
    ways = list(dict.fromkeys(fastest(c, loop, selection)))
    cost = race({"us": timed(c.query, n)} | {str(s): loop.measured(s, selection) for s in ways}, rounds)
    rows = []
    for s in ways:
        said = loop.answers(s, selection)
        note = f"{s}{c.judge(said)}"
        differing = int(far(c.truth, said).sum())
        rows.append(Row(c.case, c.us, cost["us"], c.rival, cost[str(s)], n, c.required, differing, note))
    return rows


def alone(c: Contest, missing: str, rounds: int) -> Row:
    """Ours without the rival, which could not run."""
    cost = race({"us": timed(c.query, len(c.truth))}, rounds)["us"]
    return Row(c.case, c.us, cost, c.rival, None, len(c.truth), c.required, note=f"not run: {missing}")


def beside_python(p: Pairs, colliding: Array, rounds: int) -> list[Row]:
    rows = []
    for name, make, key in (("Coal Python", CoalPython, "collide vs Coal Python"), ("python-fcl", FclPython, None)):
        required = REQUIRED[key] if key and p.name in DECISIVE else None
        case = f"{p.name}: boolean"
        try:
            rival = make(p)
        except Missing as missing:
            rows.append(Row(case, "collide", None, name, None, len(p), required, note=f"not run: {missing}"))
            continue
        cost = race(
            {"us": timed(lambda: loewner.collide(*p.arguments()), len(p)), "rival": rival.measured("collide")},
            3 * rounds,
        )
        said = np.array(rival.collide())
        note = f"one call per pair{judged_by_programs(p, colliding, said)}"
        rows.append(
            Row(case, "collide", cost["us"], name, cost["rival"], len(p), required, differences(colliding, said), note)
        )
    return rows


# -- choosing how to ask Coal ------------------------------------------------------------------


def fastest(c: Contest, loop: CoalLoop, selection: str) -> tuple[Settings, Settings]:
    """Coal's fastest settings, whatever they answer, and the fastest among those with the fewest wrong answers.

    There are 216 ways to ask for a boolean. All run on a few pairs, the fastest of them on all pairs.
    """
    few = min(TRIAL, len(c.truth))
    trial = loop.select(np.arange(few) if c.chosen is None else c.chosen[:few])
    quick = sorted((loop.measure(s, trial).cpu, k) for k, s in enumerate(c.ways))
    finalists = [c.ways[k] for _, k in quick[:FINALISTS]]
    faultless = (c.ways[k] for _, k in quick if not far(c.truth[:few], loop.answers(c.ways[k], trial)).any())
    finalists += [s for s in itertools.islice(faultless, FINALISTS) if s not in finalists]
    full = {
        s: (min(loop.measure(s, selection).cpu for _ in range(2)), far(c.truth, loop.answers(s, selection)).sum())
        for s in finalists
    }
    return min(full, key=lambda s: full[s][0]), min(full, key=lambda s: (full[s][1], full[s][0]))


def far(truth: Array, said: Array) -> Array:
    """Which answers differ: booleans at all, distances by more than what Coal promises."""
    if said.ndim == 1:
        return said != truth
    return ~(np.abs(said[:, 0] - truth) <= COAL_TOLERANCE)


# -- who is wrong ------------------------------------------------------------------------------


def largest_difference(ours: Array, theirs: Array) -> str:
    return f"; largest difference {np.abs(theirs[:, 0] - ours).max():.1e} m"


def judged_by_programs(p: Pairs, ours: Array, theirs: Array) -> str:
    """Where answers differ, who is wrong by the linear program; pairs within its tolerance are left open."""
    where = np.flatnonzero(ours != theirs)
    if not len(where):
        return ""
    gaps = np.array([clearance(*world_vertices(p, int(k))) for k in where[:JUDGED]])
    sure = np.abs(gaps) > 1e-7
    wrong = int((ours[where[:JUDGED]] != (gaps <= 0))[sure].sum())
    judged = int(sure.sum())
    return f"; judged {judged}: us wrong {wrong}, rival wrong {judged - wrong}, deepest {np.abs(gaps).max():.2g} m"


def judged_by_eigenvalues(E1: Ellipsoids, E2: Ellipsoids, ours: Array, theirs: Array) -> str:
    """Where answers about ellipsoids differ, who is wrong by another algorithm, a 6 x 6 eigenproblem."""
    where = np.flatnonzero(ours != theirs)[:JUDGED]
    if not len(where):
        return ""
    truth = overlap_by_eigenvalue(E1[where], E2[where])
    factor = np.sqrt(loewner.contact_function(E1[where], E2[where]))
    wrong = int((ours[where] != truth).sum())
    return (
        f"; judged {len(where)}: us wrong {wrong}, rival wrong {len(where) - wrong}; "
        f"they touch if grown by a factor of {factor.min():.2g} to {factor.max():.2g}"
    )
