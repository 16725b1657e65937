"""The benchmarks run, on tiny sizes, and count what they claim to count. Nothing is said here about speed."""

import csv
import itertools
import json
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

sys.path.append(str(Path(__file__).parents[1] / "benchmarks"))

import accuracy
import bases
import camera
import clearance
import clock
import covers
import crowd
import executed_curves
import frameworks
import gate
import gpu
import growth
import judge
import loewner
import memory
import motion_bench_maker
import pairs
import ratios
import report
import rivals
import robot_rivals
import robot_samples
import robots
import run
import samples
import seen_frames
import singles
import stops
import surface_samples
import surfaces
import swept
import threads
import trajectories
from gpu_stand_in import StandIn, put_in
from loewner import paper
from loewner.depth import SeenSpace
from loewner.gpu import driver
from loewner.robots.proofs import courses, curves
from sampling import quick


@pytest.fixture(autouse=True)
def no_compiler(monkeypatch: pytest.MonkeyPatch) -> None:
    """The C++ loop is left out: it takes ten seconds to build."""

    def missing(folder: Path) -> Path:
        raise rivals.Missing("no C++ compiler")

    for module in (pairs, growth, crowd):
        monkeypatch.setattr(module, "build_loop", missing)


@pytest.mark.parametrize("there", [False, pytest.param(True, marks=pytest.mark.verify)])
def test_a_gpu_is_measured(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], there: bool) -> None:
    """Without a GPU the benchmark says so; with one, here a stand-in, it counts, and compares all answers."""
    few = ["--pairs", "500", "--configurations", "300", "--motions", "20"]
    monkeypatch.setattr(gpu, "SIZES", (1, 10))
    monkeypatch.setattr(gpu, "ROUNDS", 2)
    monkeypatch.setattr(driver, "_opened", {})
    monkeypatch.setattr(driver, "LIBRARY", "none.so")
    assert gpu.main(few) == 0
    assert "no GPU to measure: expected NVIDIA's driver" in capsys.readouterr().out
    if not there:  # the kernels of a GPU are compiled for the stand-in
        return
    made = StandIn()
    put_in(monkeypatch, made)
    monkeypatch.setattr(gpu, "copied", lambda device: 1e9)
    assert gpu.main(few) == 0
    said = capsys.readouterr().out
    assert said.count("; all as on the CPU") == 2 + len(gpu.SHARES)
    assert "10 motions: " in said


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


def test_depths_of_a_crowd_are_those_by_copies():
    """Each way of measuring a crowd or listed pairs has a cost, and no depth differs between them."""
    rows = clearance.crowd(quick=True)
    assert rows[0].items > 50
    assert rows[0].differing == 0
    assert {row.case.split(", ")[1] for row in rows[1:]} == {"bounds", "exact"}
    assert all(row.ours.cpu > 0 and row.theirs.cpu > 0 for row in rows)


def test_timed_is_per_item(monkeypatch: pytest.MonkeyPatch):
    """What each clock gains during the run is divided by the number of items."""
    now = {"wall": 100.0, "cpu": 20.0}

    def work() -> None:
        now["wall"] += 8.0
        now["cpu"] += 12.0

    clocks = SimpleNamespace(perf_counter=lambda: now["wall"], process_time=lambda: now["cpu"])
    monkeypatch.setattr(clock, "time", clocks)
    assert clock.timed(work, 4)() == clock.Cost(wall=2.0, cpu=3.0)


def test_a_ratio_below_the_required_one_is_said():
    """A ratio below the required one is reported as NO, and an absent rival as not run."""
    row = report.Row("case", "us", cost(2.0), "rival", cost(5.0), 10, required=3.0)
    assert (row.ratio, row.met) == (2.5, "NO")
    absent = report.Row("case", "us", cost(2.0), "rival", None, 10, required=3.0)
    assert (absent.ratio, absent.met) == (None, "not run")


def test_csv_holds_what_the_table_holds(tmp_path: Path):
    """A row that is written to CSV is read back with the same columns and numbers."""
    rows = [report.Row("a, b", "us", cost(1e-9), "rival", cost(4e-9), 10, 3.0, 0, "note")]
    report.write(tmp_path / "x" / "rows.csv", rows, {"commit": "abc", "date": "now"})
    with open(tmp_path / "x" / "rows.csv", newline="", encoding="utf-8") as file:
        (read,) = csv.DictReader(file)
    assert tuple(read) == report.COLUMNS
    assert (read["case"], float(read["ratio"]), read["met"], read["differing"]) == ("a, b", 4.0, "yes", "0")


def test_machine_name_is_a_folder_name():
    """The machine's name consists of lower-case letters, digits and hyphens only."""
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
    """Coal and FCL, called from Python, say of each pair what loewner says."""
    pytest.importorskip({"CoalPython": "coal", "FclPython": "fcl"}[rival.__name__])
    assert np.array_equal(rival(few).collide(), loewner.collide(*few.arguments()))


def test_what_could_not_run_is_in_the_table(few: samples.Pairs, tmp_path: Path):
    """Without a compiler the rows of the C++ loop are there, with our time and the reason."""
    rows = pairs.compare(few, True, tmp_path)
    lost = [r for r in rows if r.rival.startswith("Coal C++")]
    assert len(lost) == len(pairs.contests(few, loewner.collide(*few.arguments())))
    assert all(r.theirs is None and r.ours is not None and "no C++ compiler" in r.note for r in lost)
    report.show("pairs", rows)


@pytest.mark.slow("several programs, one after another")
def test_a_camera_leaves_no_point_of_the_robot(capsys: pytest.CaptureFixture[str]) -> None:
    """Simulated frames: no point of the robot stays, none of a box is lost, and plans stay in seen cells."""
    assert camera.main(["--frames", "4", "--points", "6000"]) == 0
    out = capsys.readouterr().out
    assert "points of the robot that stay: 0; points of boxes lost beyond 0.03 m: 0" in out
    assert "in a cell that no ray has passed: 0" in out


@pytest.mark.verify
def test_seen_frames_by_formulas(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    """Random robots and worlds: no point of a robot stays, none is lost, and plans enter only cells with rays."""
    few = ["--frames", "30", "--plans", "6", "--seed", "7"]
    assert seen_frames.main(few) == 0
    out = capsys.readouterr().out
    assert "that stay: 0" in out
    assert "farther than `clear`: 0" in out
    see = SeenSpace.see
    monkeypatch.setattr(
        SeenSpace, "see", lambda space, image, *given, **named: see(space, image + 0.3, *given, **named)
    )
    assert seen_frames.main(few) == 1  # depths that are too large are noticed


@pytest.mark.slow("plans, with proofs and samples")
def test_drives_are_proven_and_on_their_courses(capsys: pytest.CaptureFixture[str]) -> None:
    """Trips on a map: each drive is proven, and no sample is off its course or in collision."""
    assert bases.main(["--trips", "2", "--rival-trips", "0", "--samples", "1000", "--maps", "clutter"]) == 0
    assert "not proven: 0" in capsys.readouterr().out


@pytest.mark.parametrize("every", quick(2, 1))
def test_every_benchmark_runs(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, every: int):
    """`run.py --quick`, on still smaller sizes, of all benchmarks or of each second one: tables, CSV, figures."""
    for module, names in (
        (pairs, {"QUICK": 20}),
        (singles, {"QUICK": 20}),
        (threads, {"QUICK": 400}),
        (memory, {"QUICK": 400}),
        (crowd, {"QUICK": 60}),
        (growth, {"QUICK_VERTICES": (8,), "PAIRS": 200, "HULLS": 2}),
        (robots, {"QUICK": 20, "QUICK_SIZES": (1, 5)}),
    ):
        for name, value in names.items():
            monkeypatch.setattr(module, name, value)
    names = [*run.BENCHMARKS, "memory"][::every]
    assert run.main(["--quick", "--out", str(tmp_path), "--build", str(tmp_path), "--only", *names]) == 0
    written = {path.name for path in tmp_path.iterdir()}
    assert {f"{name}.csv" for name in names} | {"machine.json"} <= written
    assert {f"{name}.svg" for name in run.FIGURES if name in names} <= written


@pytest.mark.verify  # it compiles the oracle of surfaces
@pytest.mark.filterwarnings("ignore:.*nearly closed")  # the visual meshes of robots
def test_surfaces_are_benchmarked(monkeypatch: pytest.MonkeyPatch, tmp_path: Path):
    """Sections run on tiny sizes, their figures are in the file, and no answer differs from the oracle's."""
    pairs = [
        surface_samples.Pair(
            "mug and ball",
            surface_samples.Mesh(*surface_samples.mug(12)),
            surface_samples.Mesh(*surface_samples.sphere(0.012, 1)),
        ),
        surface_samples.Pair(
            "torus and terrain",
            surface_samples.Mesh(*surface_samples.torus(0.1, 0.03, 8, 6)),
            surface_samples.Mesh(*surface_samples.terrain(32, 1.0)),
        ),
    ]
    monkeypatch.setattr(surface_samples, "pairs", lambda: pairs)
    monkeypatch.setattr(surface_samples, "TRIAL", 30)
    monkeypatch.setattr(surfaces, "QUICK", 8)
    assert (
        surfaces.main(["--quick", "--only", "pair,million,answers,tiers", "--poses", "400", "--out", str(tmp_path)])
        == 0
    )
    found = json.loads((tmp_path / "surfaces.json").read_text())
    assert [entry["pair"] for entry in found["answers"]] == [pair.name for pair in pairs]
    for entry in found["answers"]:
        assert (entry["poses"], entry["grazing"]) == (36, 4)
        assert (entry["differing"], entry["grazing differing"], entry["certified wrongly"]) == (0, 0, 0)
    for entry in found["tiers"]:
        assert sum(entry[verdict.name] for verdict in loewner.Verdict) == 40


def test_frameworks_are_benchmarked(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]):
    """The checker and JAX are asked for values and gradients, of one configuration and of several, and agree."""
    jax = pytest.importorskip("jax")
    monkeypatch.setattr(frameworks, "SIZES", {1: 1, 3: 1})
    try:
        frameworks.main([])
    finally:
        jax.config.update("jax_enable_x64", False)
    lines = capsys.readouterr().out.splitlines()
    for who in ("checker", "JAX"):
        assert sum(who in line for line in lines) == 4


@pytest.mark.verify
def test_other_libraries_are_judged(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture):
    """Our answers are right, an answer that is always 0 is wrong, and programs in fractions prove it; files appear."""
    zeros = {"colliding": np.zeros(4), "distance": np.zeros(4)}
    monkeypatch.setitem(
        judge.LIBRARIES, "coal", lambda p: judge.Said(p.first, p.second, {k: v[: len(p)] for k, v in zeros.items()})
    )
    monkeypatch.setattr(judge, "FAMILIES", dict.fromkeys(("ball 8", "cones")))
    arguments = ["--only", "loewner", "mujoco", "coal", "--pairs", "8", "--tolerance", "1e-3", "--out", str(tmp_path)]
    assert judge.main(arguments) == 0
    with open(tmp_path / "judge.csv", newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 3 * 9
    for row in rows:
        wrong = int(row["wrong"])
        assert row["in_fractions"] == f"{wrong} of {wrong}"
        assert wrong == 0 or row["library"] != "loewner"
    assert sum(int(row["wrong"]) for row in rows if row["library"] == "coal") > 0
    assert "| coal" in (tmp_path / "judge.md").read_text()
    assert list((tmp_path / "judge").glob("coal-*.py"))
    assert "loewner" in capsys.readouterr().out


@pytest.mark.verify
def test_accuracy_counts_add_up(monkeypatch: pytest.MonkeyPatch, tmp_path: Path):
    """Right, missed and false alarms make all ambiguous pairs; the share is in its interval; files appear."""
    monkeypatch.setattr(accuracy, "QUICK", 30)
    monkeypatch.setattr(accuracy, "EIGHT", dict.fromkeys(("ball 8", "plates 1:1:0.05")))
    assert accuracy.main(["--quick", "--out", str(tmp_path)]) == 0
    with open(tmp_path / "accuracy.csv", newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert [row["family"] for row in rows[::4]] == [accuracy.PAPER, "ball 8", "plates 1:1:0.05"]
    for row in rows:
        ambiguous, right = int(row["ambiguous"]), int(row["right"])
        assert 0 < ambiguous < 30
        assert right + int(row["missed"]) + int(row["false_alarms"]) == ambiguous
        assert float(row["low"]) < float(row["percent"]) == pytest.approx(100 * right / ambiguous, rel=1e-3)
        assert float(row["percent"]) < float(row["high"]) or right == ambiguous
        assert 0 < float(row["error_median"]) <= float(row["error_90"])
    assert (tmp_path / "accuracy.svg").stat().st_size > 0


def test_accuracy_judges_by_the_exact_answer():
    """For two rows: the same numbers by hand, the paper's pairs one by one."""
    found = {row.rule: row for row in accuracy.judged(accuracy.PAPER, 40)}
    a, _, b, _ = accuracy.of_the_paper(40)
    open_pairs = [k for k in range(40) if loewner.classify(a[k], None, b[k], None) == loewner.Verdict.AMBIGUOUS]
    said = {
        "contact-product": lambda a, b: loewner.collide(a, None, b, None, method="estimate"),
        "center-line": lambda a, b: paper.distance_estimate(a.inner, a.outer, b.inner, b.outer, "center-line") <= 0,
    }
    for rule, collides in said.items():
        right = sum(bool(collides(a[k], b[k])) == loewner.collide(a[k], None, b[k], None) for k in open_pairs)
        assert (found[rule].ambiguous, found[rule].right) == (len(open_pairs), right)


# -- robots ------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def arm() -> robot_samples.Sample:
    try:
        return robot_samples.panda()
    except rivals.Missing as missing:
        pytest.skip(str(missing))


@pytest.fixture
def round_and_square() -> loewner.Scene:
    scene = loewner.Scene()
    for k, body in enumerate(
        (loewner.Body.box([0.1, 0.2, 0.3]), loewner.Body.cylinder(0.1, 0.5), loewner.Body.sphere(0.15))
    ):
        T = np.eye(4)
        T[:3, :3] = samples.rotations(np.random.default_rng(k), 1)[0]
        T[:3, 3] = 0.5 * np.cos(2 * k), 0.5 * np.sin(2 * k), 0.4
        scene.add(str(k), body, T)
    return scene


def test_obstacles_are_those_described():
    """Five boxes and five hulls, in the ring, of the sizes that the documents give."""
    scene = robot_samples.obstacles(3)
    assert len(scene) == 10
    for name in scene.names:
        x, y, z = scene.pose(name)[:3, 3]
        assert 0.45 <= np.hypot(x, y) <= 0.85
        assert 0 <= z <= 0.9
        vertices = scene[name].pieces[0].vertices
        if name.startswith("box"):
            assert ((np.ptp(vertices, axis=0) >= 0.05) & (np.ptp(vertices, axis=0) <= 0.25)).all()
        else:
            assert 0.06 < np.linalg.norm(vertices, axis=1).max() <= 0.12


def test_pinocchio_is_told_the_same(arm: robot_samples.Sample, round_and_square: loewner.Scene):
    """Distances to boxes, cylinders, balls and hulls are ours, and every way to ask gives our answers."""
    pytest.importorskip("pinocchio")
    checker = loewner.CollisionChecker(arm.robot, round_and_square)
    rival = robot_rivals.Pinocchio(checker, arm.urdf)
    Q = arm.robot.random_configurations(60, 5)
    X = rival.configurations(Q)
    ours = checker.collide(Q)
    assert 5 < ours.sum() < 55
    for way in rival.ways.values():
        assert np.array_equal(way(X), ours)
    free = np.flatnonzero(~ours)[:10]
    np.testing.assert_allclose(
        [rival.distance(x) for x in X[free]], checker.distance(Q[free], exact=True).distance, atol=1e-6
    )


def test_every_pair_is_asked_of_pinocchio(arm: robot_samples.Sample, round_and_square: loewner.Scene):
    """As many pairs of pieces as the pairs of bodies have."""
    pytest.importorskip("pinocchio")
    checker = loewner.CollisionChecker(arm.robot, round_and_square)
    pieces = {name: len(body.pieces) for name, body in arm.robot.bodies.items()}
    expected = sum(pieces.get(a, 1) * pieces.get(b, 1) for a, b in checker.checked_pairs)
    assert len(robot_rivals.Pinocchio(checker, arm.urdf).geometry.collisionPairs) == expected


def test_touching_configurations_are_set_apart():
    """Only answers that differ farther than 1e-7 m from touching count."""

    class Rival:
        def distance(self, gap: float) -> float:
            return gap

    gaps = np.array([5.0, 1e-8, -2e-6, 3e-5])
    count, note = robots.differing(Rival(), gaps, np.array([True] * 4), np.array([True, False, False, False]), "about")
    assert count == 2
    assert note.startswith("about; 1 more")


@pytest.fixture
def problems(tmp_path: Path) -> Path:
    """Problems for Panda: one with a pole in the way, one whose start is inside a box, one with a goal out of reach."""
    start, goal = [0.0, -0.785, 0, -2.356, 0, 1.571, 0.785], [1.2, -0.785, 0, -2.356, 0, 1.571, 0.785]

    def place(x: float, y: float, z: float) -> dict[str, list[float]]:
        return {"position": [x, y, z], "orientation_quat_xyzw": [0, 0, 0, 1], "orientation_euler_xyz": [0, 0, 0]}

    pole = {"name": "pole", "radius": 0.04, "length": 0.8, **place(0.33 * np.cos(0.6), 0.33 * np.sin(0.6), 0.4)}
    box = {"name": "box", "half_extents": [0.1, 0.1, 0.1], **place(0.3, 0, 0.6)}
    shared = {"problem": "pole", "start": start, "goals": [goal], "valid": True, "sphere": []}
    listed = [
        {**shared, "index": 1, "cylinder": [pole], "box": []},
        {**shared, "index": 2, "cylinder": [], "box": [box]},
        {**shared, "index": 3, "cylinder": [], "box": [], "goals": [[3.0, *goal[1:]]]},
    ]
    path = tmp_path / "problems.json"
    joints = [f"panda_joint{k}" for k in range(1, 8)]
    path.write_text(json.dumps({"robot": "panda", "joints": joints, "problems": {"pole": listed}}))
    return path


def test_planning_problems_are_judged_and_planned(arm: robot_samples.Sample, problems: Path, tmp_path: Path):
    """The straight way is blocked, all contestants find the same way around it; tiers add up."""
    for package in ("ompl", "pinocchio"):
        pytest.importorskip(package)
    assert motion_bench_maker.main(["--data", str(problems), "--every", "1", "--out", str(tmp_path)]) == 0

    def read(name: str) -> list[dict[str, str]]:
        with open(tmp_path / name, newline="", encoding="utf-8") as file:
            return list(csv.DictReader(file))

    (judged,) = read("mbm-validity.csv")
    assert [judged[k] for k in ("problems", "free_start", "free_goal", "solvable", "differing")] == list("32310")
    planned = read("mbm-planning.csv")
    ways = len(motion_bench_maker.RIVALS)
    assert [row["case"] for row in planned] == ["pole"] * ways + ["all groups"] * ways
    fastest = planned[ways]["rival"].removeprefix("pinocchio, ")  # of all groups: the fastest way comes first
    assert f"with {fastest} the fastest of its managers" in planned[ways]["note"]
    assert planned[ways]["required"] == f"{motion_bench_maker.REQUIRED['planner']}"
    assert all(row["differing"] == "0" and "1 of 1 problems solved" in row["note"] for row in planned)
    assert all(int(row["items"]) > 1 for row in planned)  # the straight way alone did not do
    tiers = read("mbm-tiers.csv")
    assert [row["states"] for row in tiers] == ["uniform", "straight line", "planner"]
    for row in tiers:
        assert int(row["configurations"]) == sum(int(row[k]) for k in row if k.startswith(("free", "colliding")))
    assert int(tiers[1]["colliding_by_ellipsoids"]) + int(tiers[1]["colliding_by_search"]) > 0
    assert (tmp_path / "mbm-tiers.svg").stat().st_size > 0


def test_trajectories_of_planned_paths(arm: robot_samples.Sample, problems: Path, tmp_path: Path, capsys):
    """Of the one problem that can be solved: blends save time, nothing collides, and toppra finds about the same."""
    assert trajectories.main(["--data", str(problems), "--every", "1", "--out", str(tmp_path)]) == 0
    with open(tmp_path / "mbm-trajectories.csv", newline="", encoding="utf-8") as file:
        found = list(csv.DictReader(file))
    assert [row["limits"] for row in found] == ["stated", "default"]
    for row in found:
        assert float(row["blended"]) <= float(row["stopping"])
        assert row["blends"] <= row["corners"]
        assert row["colliding"] == "0"
        assert row["toppra_share"] == "" or 0.8 < float(row["toppra_share"]) < 1.01
        assert float(row["blended"]) <= float(row["smooth_blended"]) <= float(row["smooth_stopping"])
        assert float(row["smooth_excess"]) <= 1
        assert row["smooth_verdict"] == "0"
        assert row["ruckig_share"] == "" or 0.95 < float(row["ruckig_share"]) < 1.01
    assert capsys.readouterr().out.count("1 paths") == 2
    assert trajectories.main(["--data", str(tmp_path / "none.json")]) == 0
    assert "not run" in capsys.readouterr().out


def test_executed_curves_of_planned_paths(
    arm: robot_samples.Sample, problems: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    """Verdicts add up and never contradict samples; the path and our saved trajectories are free; costs are there."""
    assert executed_curves.main(["--data", str(problems), "--out", str(tmp_path)]) == 0
    assert f"loewner {loewner.__version__}, numpy {np.__version__}" in capsys.readouterr().out
    with open(tmp_path / "executed-curves.csv", newline="", encoding="utf-8") as file:
        rows = {row["executed"]: row for row in csv.DictReader(file)}
    assert list(rows) == list(executed_curves.WAYS)
    for way, row in rows.items():
        if row["note"]:
            assert way.startswith(("TOPP-RA", "Ruckig"))
            assert row["note"].startswith("not run: package")
            assert row["plans"] == "0"
            continue
        assert row["plans"] == "1"
        assert sum(int(row[verdict.name.lower()]) for verdict in loewner.Verdict) == 1
        assert row["free_but_sampled_colliding"] == "0"
        assert (row["depth_largest_mm"] != "") == (row["sampled_colliding"] == "1")
        assert (row["proof_ms"] != "") == (row["free"] == "1")
    for way in ("polyline", "saved"):
        assert all(row["free"] == "1" for name, row in rows.items() if way in name)
    assert executed_curves.main(["--data", str(tmp_path / "none.json")]) == 0
    assert "not run" in capsys.readouterr().out


def test_executed_curves_are_proven_and_sampled_alike(arm: robot_samples.Sample, problems: Path):
    """What is sampled differs from what is proven by no more than the error that the proof covers."""
    problem = loewner.read_motion_bench_maker(problems)[0]
    plan = executed_curves.planned(motion_bench_maker.Task.of(problem, arm.robot))
    for way, make in executed_curves.WAYS.items():
        try:
            curve = make(plan)
        except rivals.Missing:
            continue
        course = curves.curve_of(arm.robot, curve.proven, way)
        np.testing.assert_array_equal(course.times, curve.times)
        numbers = np.arange(len(course.courses)).repeat(20)
        shares = np.tile(np.linspace(0.01, 0.99, 20), len(course.courses))
        t = course.times[numbers] + shares * np.diff(course.times)[numbers]
        proven = courses.configurations(arm.robot, course.courses[numbers], shares)
        np.testing.assert_allclose(curve.at(t), proven, rtol=0, atol=curve.error + 1e-9, err_msg=way)
        Q = curve.samples()
        assert np.linalg.norm(np.diff(Q, axis=0), axis=1).max() < 2 * executed_curves.STEP, way
        np.testing.assert_allclose(Q[[0, -1]], plan.path[[0, -1]], rtol=0, atol=1e-9, err_msg=way)


@pytest.mark.parametrize("tolerance", [0.01, 0.1, 10.0])
def test_arcs_touch_lines_and_stay_near_corners(tolerance: float):
    """Positions and directions are continuous; an arc is as far from its corner as allowed, or takes half a line."""
    path = np.random.default_rng(3).normal(size=(9, 5))
    made = executed_curves.parts(path, tolerance)
    for one, other in itertools.pairwise(made):
        for order in (0, 1):
            end, start = one.at(np.array([one.length]), order), other.at(np.zeros(1), order)
            np.testing.assert_allclose(end, start, atol=1e-9)
    arcs = [part for part in made if part.outward is not None]
    assert len(arcs) == len(path) - 2
    halves = np.linalg.norm(np.diff(path, axis=0), axis=1) / 2
    limited = 0
    for k, arc in enumerate(arcs):
        s = np.linspace(0.0, arc.length, 1001)
        away = np.linalg.norm(arc.at(s) - path[k + 1], axis=1)
        assert away.min() == pytest.approx(away[500])
        taken, half = away[0], min(halves[k : k + 2])
        assert away.min() <= tolerance * (1 + 1e-9)
        assert taken <= half * (1 + 1e-9)
        assert away.min() == pytest.approx(tolerance) or taken == pytest.approx(half)
        limited += taken == pytest.approx(half)
        speed = np.linalg.norm(np.diff(arc.at(s), axis=0), axis=1).sum()
        assert speed == pytest.approx(arc.length, rel=1e-5)
    assert (limited == len(arcs)) == (tolerance > 1)
    straight = executed_curves.parts(np.array([[0.0, 0], [1, 0], [3, 0], [2, 0]]), tolerance)
    assert [part.length for part in straight] == [1, 2, 1]


def test_both_sides_look_at_the_same_configurations(arm: robot_samples.Sample, round_and_square: loewner.Scene):
    """A motion is valid if and only if all that pinocchio is shown are free; they are as near as they should be."""
    checker = loewner.CollisionChecker(arm.robot, round_and_square)
    a, b = arm.robot.random_configurations(40, 1), arm.robot.random_configurations(40, 2)
    valid = checker.valid_edges(a, b, motion_bench_maker.RESOLUTION)
    for k in range(40):
        Q = motion_bench_maker.on_the_way(arm.robot, a[k], b[k])
        assert valid[k] == (not checker.collide(Q).any())
        along = np.sort(np.linalg.norm(Q - a[k], axis=1))
        assert along[0] == 0
        assert along[-1] == pytest.approx(np.linalg.norm(b[k] - a[k]))
        assert np.diff(along).max() <= motion_bench_maker.RESOLUTION * (1 + 1e-9)


def test_no_problems_no_benchmark(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    """Without the file it says so."""
    assert motion_bench_maker.main(["--data", str(tmp_path / "none.json")]) == 0
    assert "not run" in capsys.readouterr().out


def test_ratios_are_kept_once(tmp_path: Path) -> None:
    """A row for each ratio with a target, the smallest where a rival ran in two ways; reading again adds nothing."""
    folder, kept = tmp_path / "machine", tmp_path / "ratios.csv"
    cost = {factor: clock.Cost(factor, factor) for factor in (1.0, 3.0, 4.0)}
    rows = [
        report.Row("a", "collide", cost[1.0], "Coal", cost[4.0], 1, required=2.0, note="one way"),
        report.Row("a", "collide", cost[1.0], "Coal", cost[3.0], 1, required=2.0, note="another"),
        report.Row("a", "collide", cost[1.0], "FCL", cost[4.0], 1),
        report.Row("b", "collide", None, "Coal", cost[3.0], 1, required=2.0),
    ]
    facts = {"commit": "c1", "date": "2026-01-01 00:00 UTC"}
    for commit, lines in (("c1", 2), ("c1", 2), ("c2", 3)):
        report.write(folder / "pairs.csv", rows, facts | {"commit": commit})
        assert ratios.main(["--read", str(folder), "--out", str(kept)]) == 0
        assert len(kept.read_text().splitlines()) == lines
    with kept.open(newline="") as stream:
        first = next(csv.DictReader(stream))
    assert first == {
        "commit": "c1", "date": facts["date"], "machine": "machine", "load": "", "benchmark": "pairs", "case": "a",
        "us": "collide", "rival": "Coal", "ratio": "3", "required": "2.0",
    }  # fmt: skip


def test_ratios_are_measured(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A run of benchmarks gives rows with this machine and its load."""
    row = report.Row("a", "collide", clock.Cost(1.0, 1.0), "Coal", clock.Cost(5.0, 5.0), 1, required=2.0)
    monkeypatch.setitem(run.BENCHMARKS, "pairs", ("few", lambda quick, build: [row]))
    assert ratios.main(["--only", "pairs", "--quick", "--out", str(tmp_path / "r.csv")]) == 0
    with (tmp_path / "r.csv").open(newline="") as stream:
        (found,) = csv.DictReader(stream)
    assert (found["ratio"], found["machine"]) == ("5", report.machine_name(report.machine()))


def test_kept_ratios_are_of_runs() -> None:
    """The file in the sources has the columns, positive ratios, and each row once."""
    with ratios.KEPT.open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert tuple(rows[0]) == ratios.COLUMNS
    assert all(float(row["ratio"]) > 0 and row["commit"] and row["date"] for row in rows)
    assert len({tuple(row.values()) for row in rows}) == len(rows)


def test_stops_are_counted(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    """Stops on the path never leave it, and each stop joint by joint is counted beside them."""
    monkeypatch.setattr(sys, "argv", ["stops.py", "--chunks", "2"])
    stops.main()
    rows = [line for line in capsys.readouterr().out.splitlines() if line.startswith(("on the path", "joint by joint"))]
    counts = [line[42:].split() for line in rows]
    assert len(rows) == 6
    assert {row[0] for row in counts} == {counts[0][0]}
    assert [row[1] for row in counts[:2]] == ["0", "0"]
    assert all(int(row[1]) > 0 for row in counts[2:])


def test_swept_volumes_miss_nothing() -> None:
    """No point of the hand is outside the bodies; placed meshes miss some."""
    *ours, placed = swept.rows(quick=True)
    assert [row[3] for row in ours] == [0]
    assert placed[3] > 0


def test_checks_of_a_gate_are_counted(capsys: pytest.CaptureFixture[str]) -> None:
    """A new chunk takes more steps than its motions alone, and a tick that continues takes a small part of these."""
    gate.main(["--chunks", "3"])
    rows = {line[:52].strip(): line[52:].split() for line in capsys.readouterr().out.splitlines()[1:]}
    assert len(rows) == 1 + 3 * len(gate.BRAKES)
    median = {name: int(row[4].replace(",", "")) for name, row in rows.items() if len(row) > 4}
    for name in gate.BRAKES:
        assert median[f"{name}: new, passes"] > median["certify_edges of 50"]
        assert median[f"{name}: continues"] < median[f"{name}: new, passes"] / 10


@pytest.mark.verify
def test_covers_are_sampled_and_grown() -> None:
    """Points outside of a ball in a cube are counted as geometry says, and the ball grows to the corners."""
    cube, ball = loewner.Body.box([2, 2, 2]), loewner.Body.spheres([[0.0, 0.0, 0.0]], [1.2])
    circle = 1 - np.pi * (1.2**2 - 1) / 4  # of each face, outside of the ball's circle
    assert covers.uncovered(cube, ball, 20_000, False)[0] / 20_000 == pytest.approx(circle, abs=0.02)
    assert covers.uncovered(cube, loewner.Body.sphere(1.8), 2_000, True) == (0, 2_000)
    larger = covers.covering(cube, ball, 0.6)
    assert 3**0.5 <= larger.outer.semi_axes[0, 0] <= 3**0.5 + 0.01
