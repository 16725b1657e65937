"""Cover robot links with simple shapes, and judge covers from other programs, link by link."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import replace
from typing import Literal, get_args

import numpy as np

from loewner._base import _validate
from loewner._base._plausible import warn
from loewner._base._threads import at_most, in_shares
from loewner._base._validate import Floats, Named, Pair, Progress
from loewner.bodies import Body, packed_of
from loewner.bodies.layout import arrays_of
from loewner.errors import InputError
from loewner.meshes.coverage import CoverReport
from loewner.robots.checker import CollisionChecker
from loewner.robots.description.pair_verdicts import Terms
from loewner.robots.description.robot import Robot, answers
from loewner.robots.proofs.pair_ranges import prove_pairs

Kind = Literal["spheres", "capsules", "boxes", "ellipsoids"]
KINDS: tuple[Kind, ...] = get_args(Kind)

# How far shapes may stick out of links by default [m].
USUAL = 0.02

# Number of configurations in the search for pairs that meet only because of a cover's shapes. If a pair meets in one
# percent of all configurations, a sample of 1,000 configurations misses it with a probability of 1 in 23,000.
TRIED = 1000

# Maximum number of boxes of configurations in the proof that a pair of links never collides. Most pairs take a few
# thousand.
BOXES = 200_000

# Number of links that are covered at the same time. Each link takes 100 MB of memory.
MOST_THREADS = 4

# Parameters of the search for the protrusion that gives n shapes. FIRST is the protrusion [m] of the first step; every
# protrusion is between LEAST and LARGEST. The search ends after STEPS steps, or as soon as a cover has at least the
# share ENOUGH of n shapes. The number of shapes is roughly proportional to the protrusion to the power of -1 / POWER.
LEAST, LARGEST, FIRST, STEPS, ENOUGH, POWER = 1e-4, 10.0, 0.03, 8, 0.92, 0.8


def cover(self: Robot, kind: Kind, *, n: int | None, protrusion: float | None, progress: Progress | None) -> Robot:
    """Implement `Robot.cover`, whose signature has the defaults."""
    report = _validate.reporter(progress)
    if not self.bodies:
        raise InputError("expected a robot with bodies, found one without")
    if n is None:
        bodies = _covered(self, kind, USUAL if protrusion is None else protrusion, report, 0, 1)
    elif protrusion is not None:
        raise InputError("n: expected none with protrusion, found both")
    else:
        bodies = _of_number(self, kind, _validate.whole_number(n, "n", 1), report)
    model = with_bodies(self, bodies)
    contacts = new_contacts(self, model)
    pairs = [pair for pair, _, _ in contacts]
    never = _never(self, pairs)
    always = [f"{a} and {b}" for (a, b), _, share in contacts if share == 1.0 and (a, b) not in never]
    if always:
        warn(
            f"shapes of links that may collide meet in all of {TRIED} configurations, so no motion of this cover is "
            f"free: {', '.join(always)}; take a smaller protrusion"
        )
    return model.disabling(exempt_pairs(model) | never)


def with_bodies(robot: Robot, bodies: Mapping[str, Body], ignored: frozenset[Pair] | None = None) -> Robot:
    """Return the robot with other bodies.

    If given, `ignored` replaces the robot's disabled pairs and rules about pairs.
    """
    variant = replace(robot, bodies=Named("link with a body", bodies), shapes=Named("link with shapes of a URDF", {}))
    return variant if ignored is None else replace(variant, disabled_pairs=ignored, _ruled=True)


def exempt_pairs(robot: Robot) -> frozenset[Pair]:
    """Return the pairs of links that a checker of this robot does not check by default."""
    return robot._usually_skipped


def new_contacts(robot: Robot, model: Robot) -> list[tuple[Pair, float, float]]:
    """Find the pairs that meet in sampled configurations with the model's bodies, but not with the robot's own bodies.

    Return two shares of the configurations for each pair. In the first share, the model's bodies meet but the robot's
    own bodies do not. In the second share, the model's bodies meet.
    """
    Q = robot.random_configurations(TRIED)
    theirs = CollisionChecker(model)
    meets = theirs.collide_by_pair(Q)
    ours = CollisionChecker(with_bodies(robot, robot.bodies, exempt_pairs(model)))
    own_hits = dict(zip(ours.checked_pairs, ours.collide_by_pair(Q).T, strict=True))
    none = np.zeros(TRIED, dtype=bool)
    shares = [
        ((min(pair), max(pair)), float((hits & ~own_hits.get(pair, none)).mean()), float(hits.mean()))
        for pair, hits in zip(theirs.checked_pairs, meets.T, strict=True)
    ]
    return [row for row in shares if row[1] > 0]


def _never(robot: Robot, pairs: list[Pair]) -> frozenset[Pair]:
    """Prove which of the given pairs of links never collide."""
    if not pairs:
        return frozenset()
    terms = Terms(margin=0.0, limits=None, scene=None, boxes=BOXES, only_free=True)
    proven = prove_pairs(robot, pairs, terms, cache=True, progress=None, proof=False)
    return frozenset(row.names for row in proven.with_verdict("NEVER"))


def _covered(
    robot: Robot, kind: Kind, protrusion: float, progress: Progress, before: int, steps: int
) -> dict[str, Body]:
    """Cover all links; progress is reported as if `before` of `steps` covers were already done."""
    # Several links of a robot, such as fingers, may have the same shape.
    shapes: dict[tuple[bytes, ...], int] = {}
    links = {link: shapes.setdefault(_bytes_of(body), len(shapes)) for link, body in robot.bodies.items()}
    different = [next(robot.bodies[link] for link, shape in links.items() if shape == k) for k in range(len(shapes))]

    def some(first: int, last: int) -> list[Body]:
        with at_most(1):
            return [body.cover(kind, protrusion=protrusion) for body in different[first:last]]

    def report(done: int, total: int) -> None:
        progress(before * total + done, steps * total)

    with at_most(MOST_THREADS):
        covers = list(itertools.chain(*in_shares(some, len(different), 1, most=1, progress=report)))
    return {link: covers[shape] for link, shape in links.items()}


def _bytes_of(body: Body) -> tuple[bytes, ...]:
    return tuple(array.tobytes() for array in arrays_of(packed_of(body)).values())


def _of_number(robot: Robot, kind: Kind, n: int, progress: Progress) -> dict[str, Body]:
    """Cover all links with at most n shapes, nearly n if possible, with the same bound on each link's protrusion."""
    low, high, best, protrusion = LEAST, LARGEST, None, FIRST
    for step in range(STEPS):
        if n < len(robot.bodies):
            break
        bodies = _covered(robot, kind, protrusion, progress, step, STEPS)
        count = sum(len(body.pieces) for body in bodies.values())
        if count > n:
            low = protrusion
        else:
            high, best = protrusion, bodies
            if count >= ENOUGH * n:
                break
        guess = protrusion * (count / (0.96 * n)) ** POWER
        protrusion = guess if low < guess < high else float(np.sqrt(low * high))
    if best is None:
        raise InputError(f"n: expected more shapes for {len(robot.bodies)} links, found {n}")
    progress(1, 1)
    return best


def covered_by(self: Robot, model: Robot, tolerance: float | None, progress: Progress | None) -> dict[str, CoverReport]:
    """Implement `Robot.covered_by`, whose signature has the defaults."""
    _validate.instance(model, "model", Robot)
    report = _validate.reporter(progress)
    reports = {}
    for number, (link, body) in enumerate(self.bodies.items(), 1):
        if link in model.bodies:
            reports[link] = body.covered_by(model.bodies[link], tolerance=tolerance)
        else:
            reports[link] = CoverReport("uncovered", (1.0, 1.0), (np.inf, np.inf), _point_of(body), (0.0, 0.0))
        report(number, len(self.bodies))
    return reports


def _point_of(body: Body) -> Floats:
    """Return a point of a body."""
    vertices = body.pieces[0].vertices
    return np.array(body.inner.center[0] if vertices is None else vertices[0])


answers |= {"cover": cover, "covered_by": covered_by}
