"""How often the O(1) estimate is right where the ellipsoids settle nothing, by family of shapes.

    python benchmarks/accuracy.py [--quick] [--out FOLDER]

The paper's own pairs, and eight families of shapes (tests/families.py) turned at random and about as far apart as they
reach; every piece is used once. Each rule, the library's and the paper's three, answers the pairs that are ambiguous,
and the exact answers judge it. Takes two minutes on one core; table and picture go to benchmarks/results/<machine>/, or
to FOLDER.
"""

from __future__ import annotations

import argparse
import csv
import sys
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

import figures
import report
from clock import threads_set_to
from loewner import Bodies, Verdict, classify, collide, distance, paper
from loewner._base._proportions import wilson
from loewner.ellipsoids.ellipsoid_pairs import NEAR_POINT_METHODS
from samples import Array

HERE = Path(__file__).parent
sys.path.append(str(HERE.parent / "tests"))

from families import EIGHT, near_contact, pieces, stretch  # noqa: E402
from oracles import hull, pack  # noqa: E402

PAIRS, QUICK = 5_000, 60
PAPER = "the paper's"
OWN = "contact-product"  # the library's rule; the others are named by their near points
SEED = 7


@dataclass(frozen=True)
class Found:
    """What one rule said of the ambiguous pairs of one family.

    Attributes
    ----------
    family, rule : str
    pairs, ambiguous, colliding : int
        Drawn; of these ambiguous; of these colliding.
    right, missed, false_alarms : int
        Of the ambiguous: right answers, collisions called free, free pairs called colliding.
    percent, low, high : float
        Right answers and their 95 % Wilson interval.
    error_median, error_90 : float
        Of |estimate - exact distance|: half, and nine in ten, are below. In percent of the pair's size, the mean of the
        longest semi-axes of its two outer ellipsoids.
    """

    family: str
    rule: str
    pairs: int
    ambiguous: int
    colliding: int
    right: int
    missed: int
    false_alarms: int
    percent: float
    low: float
    high: float
    error_median: float
    error_90: float


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="few pairs: shows that it works")
    parser.add_argument("--out", type=Path, help="folder for table and picture")
    options = parser.parse_args(arguments)
    facts = report.machine()
    results = options.out or HERE / "results" / report.machine_name(facts)
    with threads_set_to(1):
        rows = [row for family in (PAPER, *EIGHT) for row in judged(family, QUICK if options.quick else PAIRS)]
    show(rows)
    write(results / "accuracy.csv", rows, facts)
    figures.accuracy(counts(rows), results / "accuracy.svg")
    return 0


def judged(family: str, count: int) -> Iterator[Found]:
    """Each rule on the ambiguous pairs of one family, beside the exact answers."""
    a, Ta, b, Tb = of_the_paper(count) if family == PAPER else near(family, count)
    unsure = np.flatnonzero(classify(a, Ta, b, Tb) == Verdict.AMBIGUOUS)
    asked = a[unsure], Ta[unsure], b[unsure], Tb[unsure]
    truth = collide(*asked)
    size = (asked[0].outer.semi_axes.max(axis=1) + asked[2].outer.semi_axes.max(axis=1)) / 2
    exact = distance(*asked, exact=True).distance
    for rule, said, guess in guesses(*asked):
        error = 100 * np.abs(guess - exact) / size
        right = int((said == truth).sum())
        yield Found(
            family,
            rule,
            count,
            len(unsure),
            int(truth.sum()),
            right,
            int((truth & ~said).sum()),
            int((said & ~truth).sum()),
            *(100 * np.array([right / len(unsure), *wilson(right, len(unsure))])).tolist(),
            *np.quantile(error, [0.5, 0.9]).tolist(),
        )


def guesses(a: Bodies, Ta: Array, b: Bodies, Tb: Array) -> Iterator[tuple[str, Array, Array]]:
    """What each rule says of ambiguous pairs: its name, which of them collide, and distances within the bounds."""
    bounds = distance(a, Ta, b, Tb)
    yield OWN, collide(a, Ta, b, Tb, method="estimate"), bounds.estimate
    ellipsoids = a.inner.transformed(Ta), a.outer.transformed(Ta), b.inner.transformed(Tb), b.outer.transformed(Tb)
    for method in NEAR_POINT_METHODS:
        guess = np.clip(paper.distance_estimate(*ellipsoids, method), bounds.lower, bounds.upper)
        yield method, guess <= 0, guess


def of_the_paper(count: int) -> tuple[Bodies, Array, Bodies, Array]:
    """Its data set: hulls of 20 points, radius uniform, the second shifted."""
    data = paper.sample(count, SEED)
    bodies = Bodies.from_points([*data.points_1, *data.points_2])
    still = np.tile(np.eye(4), (count, 1, 1))
    return bodies[:count], still, bodies[count:], still


def near(family: str, count: int) -> tuple[Bodies, Array, Bodies, Array]:
    """Pieces of one family, turned at random, from one inside the other to well apart."""
    points = pieces(family, 2 * count, SEED)
    pool, index = pack(map(hull, points)), np.arange(count)
    Ta, Tb = near_contact(
        np.random.default_rng(SEED), pool, index, pool, count + index, grazing=0, deep=0, stretch=stretch(family)
    )
    bodies = Bodies.from_points(points)
    return bodies[:count], Ta, bodies[count:], Tb


def counts(rows: Sequence[Found]) -> dict[str, dict[str, tuple[int, int]]]:
    """Right answers and questions by rule and family, as `plots.accuracy` takes them."""
    found: dict[str, dict[str, tuple[int, int]]] = {}
    for row in rows:
        found.setdefault(row.rule, {})[row.family] = row.right, row.ambiguous
    return found


def show(rows: Sequence[Found]) -> None:
    table = Table(
        *("family", "ambiguous", "rule", "right, %", "95 % interval", "collisions missed, %"),
        *("error of half below, % of size", "of nine in ten"),
    )
    for row in rows:
        table.add_row(
            row.family,
            f"{row.ambiguous} of {row.pairs}",
            row.rule,
            f"{row.percent:.1f}",
            f"{row.low:.1f} to {row.high:.1f}",
            f"{100 * row.missed / row.colliding:.1f}" if row.colliding else "-",
            f"{row.error_median:.1f}",
            f"{row.error_90:.1f}",
        )
    Console(width=max(Console().width, 140)).print(table)


def write(path: Path, rows: Sequence[Found], facts: dict[str, Any]) -> None:
    origin = {name: facts[name] for name in ("commit", "date")}
    lines = [{k: f"{v:.4g}" if isinstance(v, float) else v for k, v in asdict(row).items()} | origin for row in rows]
    path.parent.mkdir(parents=True, exist_ok=True)
    with open(path, "w", newline="", encoding="utf-8") as out:
        writer = csv.DictWriter(out, list(lines[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows(lines)


if __name__ == "__main__":
    sys.exit(main())
