"""OMPL's RRT-Connect in C++ on MotionBenchMaker's problems: motions proven, and sampled with loewner and with FCL.

    python benchmarks/ompl_cpp.py --data FILE [--every N] [--seeds N] [--fraction F] [--out FOLDER]

Needs g++, and OMPL, FCL and Eigen for C++ (Debian: libompl-dev libfcl-dev); says so where one is missing. All three get
the same shapes, pairs, seeds and ranges, and OMPL's defaults otherwise; FCL the link poses that loewner computes, and
hulls in the form in which FCL is fastest. Their verdicts are compared before anything is timed. Times are processor
time of `solve`, the best of the rounds. Every path is proven again from Python.
"""

from __future__ import annotations

import argparse
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.spatial import ConvexHull

import report
from loewner import Verdict, read_motion_bench_maker
from loewner._native import library
from loewner.bodies import Piece
from motion_bench_maker import ALL, Task
from rivals import Missing
from robot_samples import panda_for
from samples import Array

HERE = Path(__file__).parent
SOURCE = HERE / "ompl_cpp.cpp"
NAMES = ("proven", "sampled", "fcl")
# FCL's ways with hulls, by what agree says of them.
WAYS = ("convex", "convex-indep", "mesh")
RANDOM = 1000  # configurations a problem whose verdicts are compared
# Verdicts that differ nearer to contact than this, in metres, are rounding's.
CONTACT = 1e-5
ROUNDS = 2
LIMIT = 20.0  # seconds; what is not solved by then counts as having taken them
FASTER = 10.0  # what is asked of the proven motions


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, required=True, help="the problems, in JSON")
    parser.add_argument("--every", type=int, default=8, help="take every Nth solvable problem")
    parser.add_argument("--seeds", type=int, default=2, help="plans of each problem")
    parser.add_argument(
        "--fraction", type=float, default=0.01, help="of the space between samples: OMPL's own; MoveIt writes 0.005"
    )
    parser.add_argument("--out", type=Path, help="folder for results")
    options = parser.parse_args(arguments)
    facts = report.machine()
    arm = panda_for(options.data)
    if arm is None:
        return 0
    with tempfile.TemporaryDirectory() as made:
        folder = Path(made)
        try:
            program = build(folder)
        except Missing as missing:
            print(f"not run: {missing}")
            return 0
        every = [Task.of(problem, arm.robot) for problem in read_motion_bench_maker(options.data)]
        tasks = {f"{task.problem.group}-{task.problem.index}": task for task in every if task.solvable}
        tasks = dict(list(tasks.items())[:: options.every])
        for number, (name, task) in enumerate(tasks.items()):
            write(folder / name, task, number)
        shapes = agreement(said(program, "agree", folder, *tasks), folder, tasks)
        print(f"FCL's hulls: {shapes}", flush=True)
        words = shapes, options.seeds, ROUNDS, LIMIT, options.fraction
        runs = list(runs_of(said(program, "plan", folder, *words, *tasks), tasks))
    lines = list(table(runs, tasks))
    print("\n".join(lines))
    out = (options.out or HERE / "results" / report.machine_name(facts)) / "ompl-cpp.csv"
    out.parent.mkdir(parents=True, exist_ok=True)
    with out.open("w", encoding="utf-8", newline="\n") as file:
        file.write("fraction,problem,motions judged by,seed,solved,seconds,motions,states,path\n")
        for run in runs:
            numbers = f"{run.seed},{int(run.solved)},{run.seconds:.9g},{run.motions},{run.states},{run.proof}"
            file.write(f"{options.fraction:g},{run.problem},{run.name},{numbers}\n")
    return 0


def build(folder: Path) -> Path:
    """Compile the program against the system's OMPL and FCL, and the library of this installation."""
    for tool in ("g++", "pkg-config"):
        if shutil.which(tool) is None:
            raise Missing(f"{tool} is not installed")
    found = subprocess.run(["pkg-config", "--cflags", "ompl", "fcl", "eigen3"], capture_output=True, text=True)
    if found.returncode:
        raise Missing(f"OMPL, FCL and Eigen for C++ were not found: {found.stderr.strip().splitlines()[0]}")
    flags = [flag for flag in found.stdout.split() if not flag.startswith("-std=")]
    # Alignment as in FCL's library, which is built for plain x86-64.
    ours = ["-std=c++17", "-O3", "-DNDEBUG", "-march=native", "-DEIGEN_MAX_ALIGN_BYTES=16"]
    include = Path(library.HOME).parent / "include"
    # Not pkg-config's --libs: Debian's ompl.pc names files of other packages that OMPL's headers do not need.
    link = [
        f"-I{include}",
        f"-L{library.HOME}",
        "-lloewner",
        "-Xlinker",
        "-rpath",
        "-Xlinker",
        str(library.HOME),
        "-lompl",
        "-lfcl",
        "-lccd",
    ]
    program = folder / "ompl_cpp"
    command = ["g++", *ours, str(SOURCE), "-o", str(program), *link, *flags]
    made = subprocess.run(command, capture_output=True, text=True)
    if made.returncode:
        raise Missing(f"g++ could not build {SOURCE.name}: {made.stderr.strip().splitlines()[0]}")
    return program


def said(program: Path, *words: object) -> Iterator[list[str]]:
    """The words of each line that the program prints."""
    with subprocess.Popen([program, *map(str, words)], stdout=subprocess.PIPE, text=True) as process:
        for line in process.stdout:
            yield line.split()
    if process.returncode:
        raise RuntimeError(f"ompl_cpp stopped with status {process.returncode}")


# -- what the program reads --------------------------------------------------------------------


def write(path: Path, task: Task, seed: int) -> None:
    """The checker, the problem with all shapes, and configurations to compare verdicts at."""
    checker, robot = task.checker, task.checker.robot
    checker.save(path.with_name(path.name + ".lwn"))
    columns = [robot.configuration_names.index(name) for name in task.problem.joint_names]
    bodies = [(name, body, np.eye(4)) for name, body in robot.bodies.items()]
    bodies += [(name, checker.scene[name], checker.scene.pose(name)) for name in checker.scene.static_names]
    lines = [f"{len(columns)} {len(task.usable_goals)} {sum(len(body.pieces) for _, body, _ in bodies)}"]
    lines += [" ".join(map(str, columns)), *map(_numbers, [task.start, *task.usable_goals])]
    for name, body, pose in bodies:
        for kind, numbers, triangles in map(shape, body.pieces):
            lines += [name, f"{kind} {len(numbers)} {len(triangles)}", _numbers(numbers)]
            lines += [" ".join(map(str, np.ravel(triangles))), _numbers(np.ravel(pose))]
    path.with_name(path.name + ".txt").write_text("\n".join(lines), encoding="utf-8")
    Q = robot.random_configurations(RANDOM, seed)
    path.with_name(path.name + ".configurations").write_text("\n".join(map(_numbers, Q)), encoding="utf-8")


def _numbers(values: Iterable[float]) -> str:
    return " ".join(repr(float(value)) for value in values)


def shape(piece: Piece) -> tuple[str, Array, Array]:
    """Kind, sizes or coordinates, and triangles of a piece; round ones are about the origin, as `Body` makes them."""
    none = np.zeros((0, 3), dtype=int)
    if piece.kind == "cylinder":
        radius, _, half = np.sqrt(np.diag(piece.inner.shape_matrix))
        return "cylinder", np.array([radius, 2 * half]), none
    if piece.kind == "sphere":
        return "sphere", piece.inner.semi_axes[:1], none
    if piece.vertices is None:
        raise Missing(f"no shape of FCL's is taken for a {piece.kind}")
    half = piece.vertices.max(axis=0)
    if len(piece.vertices) == 8 and (np.abs(piece.vertices) == half).all():
        return "box", 2 * half, none
    hull = ConvexHull(piece.vertices)
    corners = piece.vertices[hull.simplices]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    inward = (normals * hull.equations[:, :3]).sum(axis=1) < 0
    triangles = np.where(inward[:, None], hull.simplices[:, ::-1], hull.simplices)
    return "hull", piece.vertices.ravel(), triangles


# -- what it says ------------------------------------------------------------------------------


def agreement(lines: Iterable[list[str]], folder: Path, tasks: dict[str, Task]) -> str:
    """FCL's fastest way whose verdicts are ours, but for configurations at contact."""
    seconds: dict[str, list[float]] = {}
    differing = dict.fromkeys(WAYS, 0)
    deepest = dict.fromkeys(WAYS, 0.0)
    ours = np.zeros(0)
    for problem, way, spent, digits in lines:
        seconds.setdefault(way, []).append(float(spent))
        verdicts = np.array(list(digits)) == "1"
        if way == "loewner":
            ours = verdicts
            Q = np.loadtxt(folder / f"{problem}.configurations")
            if (tasks[problem].checker.collide(Q) != ours).any():
                raise RuntimeError(f"{problem}: C and Python judge differently")
            continue
        other = Q[verdicts != ours]
        differing[way] += len(other)
        if len(other):
            off = float(np.abs(tasks[problem].checker.distance(other, exact=True).distance).max())
            deepest[way] = max(deepest[way], off)
    total = RANDOM * len(tasks)
    print(f"{total} configurations of {len(tasks)} problems; loewner {1e6 * np.mean(seconds['loewner']):.2f} µs each")
    for way in WAYS:
        print(
            f"FCL, {way}: {1e6 * np.mean(seconds[way]):.1f} µs each, {differing[way]} judged otherwise, "
            f"at most {1e3 * deepest[way]:.3g} mm from contact"
        )
    sound = [way for way in WAYS if deepest[way] <= CONTACT]
    if not sound:
        raise RuntimeError("FCL judges otherwise in every way; there is nothing to compare")
    return min(sound, key=lambda way: np.mean(seconds[way]))


class Run(NamedTuple):
    """One plan; `proof` is the worst verdict of its motions in lower case, "none" without a path."""

    problem: str
    name: str
    seed: int
    solved: bool
    seconds: float
    motions: int
    states: int
    proof: str


def runs_of(lines: Iterable[list[str]], tasks: dict[str, Task]) -> Iterator[Run]:
    """The plans, with every path proven again."""
    for problem, name, seed, solved, seconds, motions, states, *values in lines:
        checker = tasks[problem].checker
        proof = "none"
        if values:
            path = np.array(values, dtype=float).reshape(-1, checker.robot.dof)
            found = checker.certify_edges(path[:-1], path[1:]).verdict
            worst = next((v for v in (Verdict.COLLIDING, Verdict.AMBIGUOUS) if (found == v).any()), Verdict.FREE)
            proof = worst.name.lower()
        spent = float(seconds) if solved == "1" else max(float(seconds), LIMIT)
        yield Run(problem, name, int(seed), solved == "1", spent, int(motions), int(states), proof)


def table(runs: Sequence[Run], tasks: dict[str, Task]) -> Iterator[str]:
    """Medians and means by group and by what became of FCL's paths, with numbers of plans; then of all paths."""
    plans: dict[tuple[str, int], dict[str, Run]] = {}
    for run in runs:
        plans.setdefault((run.problem, run.seed), {})[run.name] = run
    groups = dict.fromkeys(task.problem.group for task in tasks.values())
    chosen = {group: [p for (name, _), p in plans.items() if tasks[name].problem.group == group] for group in groups}
    for proof in ("free", "colliding"):
        chosen[f"FCL's path is {proof}"] = [p for p in plans.values() if p["fcl"].proof == proof]
    chosen[ALL] = list(plans.values())
    names = "".join(f"{name:>22}" for name in NAMES)
    yield f"{'ms a plan, median (mean)':26}{names}   fcl / proven, median of ratios"
    for title, mine in chosen.items():
        if not mine:
            continue
        seconds = {name: np.array([p[name].seconds for p in mine]) for name in NAMES}
        cells = "".join(f"{1e3 * np.median(s):12.3f} ({1e3 * s.mean():7.2f})" for s in seconds.values())
        ratio = np.median(seconds["fcl"]) / np.median(seconds["proven"])
        yield f"{title:26}{cells}{ratio:8.1f}, {np.median(seconds['fcl'] / seconds['proven']):.1f}  ({len(mine)})"
    for name in NAMES:
        each = [p[name] for p in plans.values()]
        proofs = {kind: sum(r.proof == kind for r in each) for kind in ("free", "colliding", "ambiguous")}
        yield (
            f"{name}: {sum(r.solved for r in each)} of {len(each)} solved; paths: {proofs['free']} proven, "
            f"{proofs['colliding']} collide somewhere, {proofs['ambiguous']} undecided; "
            f"{np.median([r.motions for r in each]):g} motions and {np.median([r.states for r in each]):g} states "
            f"at the median, {1e6 * sum(r.seconds for r in each) / sum(r.motions for r in each):.1f} µs a motion"
        )
    all_proven = all(p["proven"].proof == "free" for p in plans.values())
    kept = "reached" if ratio >= FASTER and all_proven else "missed"
    yield f"proven motions: {ratio:.1f} times as fast as FCL's samples at the median, {FASTER:g} asked: {kept}"


if __name__ == "__main__":
    sys.exit(main())
