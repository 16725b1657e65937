"""The benchmarks run, on tiny sizes, and count what they claim to count. Nothing is said here about speed."""

import csv
import itertools
import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.append(str(Path(__file__).parents[1] / "benchmarks"))

import clock
import crowd
import growth
import loewner
import memory
import pairs
import report
import rivals
import run
import samples
import singles
import threads


@pytest.fixture(autouse=True)
def no_compiler(monkeypatch: pytest.MonkeyPatch) -> None:
    """The C++ loop is left out: it takes ten seconds to build."""

    def missing(folder: Path) -> Path:
        raise rivals.Missing("no C++ compiler")

    for module in (pairs, growth, crowd):
        monkeypatch.setattr(module, "build_loop", missing)


@pytest.fixture(scope="module")
def few() -> samples.Pairs:
    return samples.repeated_pairs(60, hulls=6)


def cost(seconds: float) -> clock.Cost:
    return clock.Cost(seconds, seconds)


def test_contestants_take_turns_and_the_best_counts():
    """A race runs A B A B, drops the first round, and keeps each clock's minimum."""
    order = []
    walls = itertools.count(10, -1)

    def contestant(name: str) -> clock.Measure:
        def measure() -> clock.Cost:
            order.append(name)
            return clock.Cost(next(walls), 1.0)

        return measure

    best = clock.race({"a": contestant("a"), "b": contestant("b")}, rounds=2)
    assert order == ["a", "b"] * 3
    assert (best["a"].wall, best["b"].wall) == (6, 5)


def test_timed_is_per_item():
    spent = clock.timed(lambda: sum(range(200_000)), 1000)()
    assert 0 < spent.cpu < 1e-2
    assert 0 < spent.wall < 1


def test_a_ratio_below_the_required_one_is_said():
    row = report.Row("case", "us", cost(2.0), "rival", cost(5.0), 10, required=3.0)
    assert (row.ratio, row.met) == (2.5, "NO")
    absent = report.Row("case", "us", cost(2.0), "rival", None, 10, required=3.0)
    assert (absent.ratio, absent.met) == (None, "not run")


def test_csv_holds_what_the_table_holds(tmp_path: Path):
    rows = [report.Row("a, b", "us", cost(1e-9), "rival", cost(4e-9), 10, 3.0, 0, "note")]
    report.write(tmp_path / "x" / "rows.csv", rows, {"commit": "abc", "date": "now"})
    with open(tmp_path / "x" / "rows.csv", newline="", encoding="utf-8") as file:
        (read,) = csv.DictReader(file)
    assert tuple(read) == report.COLUMNS
    assert (read["case"], float(read["ratio"]), read["met"], read["differing"]) == ("a, b", 4.0, "yes", "0")


def test_machine_name_is_a_folder_name():
    name = report.machine_name(report.machine())
    assert name
    assert set(name) <= set("abcdefghijklmnopqrstuvwxyz0123456789-")


def test_judge_of_hulls():
    """Widest slab between unit cubes: the gap along x; negative when they overlap."""
    cube = np.array([[x, y, z] for x in (0.0, 1) for y in (0.0, 1) for z in (0.0, 1)])
    for gap in (0.25, -0.25, 1.0):
        assert samples.clearance(cube, cube + [1 + gap, 0, 0]) == pytest.approx(gap, abs=1e-9)


def test_samples_are_the_pairs_they_say():
    """Shifts reach from 0 to 2, poses are rigid, and vertices asked for are all there."""
    p = samples.paper_pairs(50)
    assert len(p.first) == len(p.second) == len(p) == 50
    shift = np.linalg.norm(p.Tb[:, :3, 3], axis=1)
    assert shift.min() < 0.5
    assert 1.5 < shift.max() <= 2
    np.testing.assert_allclose(
        p.Ta[:, :3, :3] @ p.Ta[:, :3, :3].transpose(0, 2, 1), np.tile(np.eye(3), (50, 1, 1)), atol=1e-12
    )
    assert len(samples.many_vertices(30, 4.0, 2, 4).bodies[0].pieces[0].vertices) == 30


@pytest.mark.parametrize("rival", [rivals.CoalPython, rivals.FclPython])
def test_rivals_from_python_agree(few: samples.Pairs, rival: type):
    pytest.importorskip({"CoalPython": "coal", "FclPython": "fcl"}[rival.__name__])
    assert np.array_equal(rival(few).collide(), loewner.collide(*few.arguments()))


def test_what_could_not_run_is_in_the_table(few: samples.Pairs, tmp_path: Path):
    """Without a compiler the rows of the C++ loop are there, with our time and the reason."""
    rows = pairs.compare(few, True, tmp_path)
    lost = [r for r in rows if r.rival.startswith("Coal C++")]
    assert len(lost) == len(pairs.contests(few, loewner.collide(*few.arguments())))
    assert all(r.theirs is None and r.ours is not None and "no C++ compiler" in r.note for r in lost)
    report.show("pairs", rows)


def test_every_benchmark_runs(monkeypatch: pytest.MonkeyPatch, tmp_path: Path):
    """`run.py --quick`, on still smaller sizes: tables, CSV, figures."""
    for module, names in (
        (pairs, {"QUICK": 20}),
        (singles, {"QUICK": 20}),
        (threads, {"QUICK": 400}),
        (memory, {"QUICK": 400}),
        (crowd, {"QUICK": 60}),
        (growth, {"QUICK_VERTICES": (8,), "PAIRS": 200, "HULLS": 2}),
    ):
        for name, value in names.items():
            monkeypatch.setattr(module, name, value)
    assert run.main(["--quick", "--out", str(tmp_path), "--build", str(tmp_path)]) == 0
    written = {path.name for path in tmp_path.iterdir()}
    assert {f"{name}.csv" for name in [*run.BENCHMARKS, "memory"]} | {"machine.json"} <= written
    assert {f"{name}.png" for name in run.FIGURES} <= written
