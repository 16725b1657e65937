"""The main job, start to end: meshes, poses checked, a picture; the paper's experiment; a robot plans in a shelf.

python examples/demo.py [--poses 1000] [--pairs 1000] [--configurations 10000] [--out demo-out] [--hull]
"""

import argparse
import os
import sys
import time
import warnings
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

import loewner
from loewner import Verdict, cli, planners, plots
from robot_meshes import panda, panda_robot

console = Console(width=None if sys.stdout.isatty() else 160)


def main() -> None:
    """Run the demo."""
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--poses", type=int, default=1000)
    options.add_argument("--pairs", type=int, default=1000)
    options.add_argument("--configurations", type=int, default=10_000)
    options.add_argument("--out", type=Path, default=Path("demo-out"))
    options.add_argument("--hull", action="store_true", help="convex hulls: no decomposition")
    chosen = options.parse_args()
    started = time.perf_counter()
    out = chosen.out
    out.mkdir(parents=True, exist_ok=True)

    console.rule("1. Two meshes of the Panda arm become bodies")
    link, hand = (fitted(name, out, not chosen.hull) for name in ("link7", "hand"))

    console.rule(f"2. Are they in collision, at {chosen.poses:,} poses?")
    poses = random_poses(link, hand, chosen.poses)
    verdicts = check(link, hand, poses)

    console.rule("3. A picture of one pose of each kind")
    picture = draw(link, hand, poses, verdicts, out / "verdicts.png")
    console.print(f"{picture}: grey wires are outer ellipsoids, green ones inner\n")

    console.rule(f"4. The paper's experiment, {chosen.pairs:,} pairs")
    cli.main(["paper", "--pairs", str(chosen.pairs), "--out", str(out / "paper"), "--json", str(out / "paper.json")])

    console.rule(f"5. A whole robot in a shelf, {chosen.configurations:,} configurations")
    checker = loewner.CollisionChecker(panda_robot(), shelf())
    shelf_picture = robot_in_shelf(checker, chosen.configurations, out / "shelf.png")
    console.print(f"{shelf_picture}: what collides is red\n")

    console.rule("6. From one compartment to the other: a path whose motions are proven")
    path_picture = path_in_shelf(checker, out / "path.png")
    console.print(f"{path_picture}: the arm on its way; the line is the way of its hand\n")

    command = f"{os.path.relpath(sys.executable)} -m loewner"
    console.rule(f"Done in {time.perf_counter() - started:.0f} s. What next?")
    console.print(
        f"look at       {picture}, {shelf_picture}, {path_picture}, {out / 'paper' / 'report.html'}\n"
        f"your meshes   {command} fit a.stl b.stl -o bodies\n"
        f'              {command} check bodies/a.npz bodies/b.npz --pose-b "0.1 0 0"\n'
        f"your robot    {command} robot check robot.urdf --srdf robot.srdf --scene scene.yaml --random 10000\n"
        f"              {command} plan robot.urdf --srdf robot.srdf --scene scene.yaml --start home --goal away\n"
        f"in Python     examples/plan_with_grasped_object.py, examples/panda_in_clutter.py,\n"
        f"              examples/two_meshes.py, examples/batch.py, README.md\n"
        f"the tests     make test",
        markup=False,
        highlight=False,
    )


def fitted(name: str, out: Path, decompose: bool) -> loewner.Body:
    """Decompose a link into convex pieces, fit them, save the body, and print how it was made."""
    mesh = panda(f"visual/{name}.dae")
    started = time.perf_counter()
    with warnings.catch_warnings(record=True) as told:
        warnings.filterwarnings("always", "mesh: has holes")
        body = loewner.Body.from_mesh(mesh, decompose=decompose, tolerance=0.015 if decompose else None)
    seconds = time.perf_counter() - started
    body.save(out / f"{name}.npz")
    vertices = sum(len(p.vertices) for p in body.pieces if p.vertices is not None)
    covering = body.covering
    assert covering is not None  # the body was made of a mesh
    holds = "hold the whole mesh" if covering.exact else f"miss up to {covering.max_uncovered:.2g} m of it"
    if decompose:
        holds += f" and stick out of it by at most {1e3 * covering.max_protrusion:.0f} mm"
    holes = "the mesh has holes (it was made to be looked at); what is checked are its convex pieces"
    console.print(
        f"{name}: {len(body.pieces)} convex pieces, {vertices:,} vertices, {holds}; "
        f"{seconds:.1f} s; saved as {out / name}.npz",
        *(f"{name}: {holes if 'has holes' in str(one.message) else one.message}" for one in told),
        sep="\n",
        markup=False,
    )
    return body


def random_poses(a: loewner.Body, b: loewner.Body, count: int) -> np.ndarray:
    """Turn b at random and put it between deep inside a and just clear of it."""
    rng = np.random.default_rng(5)
    Q, R = np.linalg.qr(rng.normal(size=(count, 3, 3)))
    Q *= np.sign(np.diagonal(R, axis1=1, axis2=2))[:, None, :]
    Q[np.linalg.det(Q) < 0, :, 0] *= -1
    low, high = a.outer.bounding_box()
    middle_a = (low.min(axis=0) + high.max(axis=0)) / 2
    middle_b = b.outer.center.mean(axis=0)
    way = rng.normal(size=(count, 3))
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    poses = np.tile(np.eye(4), (count, 1, 1))
    poses[:, :3, :3] = Q
    poses[:, :3, 3] = middle_a + way * rng.uniform(0, 0.3, (count, 1)) - Q @ middle_b
    return poses


def check(a: loewner.Body, b: loewner.Body, poses: np.ndarray) -> np.ndarray:
    """Classify all poses, decide the ambiguous ones, and print what came out."""
    loewner.classify(a, None, b, poses[:1])  # compiles, if this machine has not before
    loewner.collide(a, None, b, poses[:1])
    started = time.perf_counter()
    verdicts = np.asarray(loewner.classify(a, None, b, poses))
    middle = time.perf_counter()
    exact = loewner.collide(a, None, b, poses)
    ended = time.perf_counter()
    table = Table("certified verdict", "poses", "exactly: free", "exactly: colliding")
    for verdict in Verdict:
        here = verdicts == verdict
        table.add_row(verdict.name, f"{here.sum():,}", f"{(here & ~exact).sum():,}", f"{(here & exact).sum():,}")
    console.print(table)
    pieces = len(a.pieces) * len(b.pieces)
    per = 1e9 / len(poses)
    console.print(
        f"classify {per * (middle - started):,.0f} ns a pose ({per * (middle - started) / pieces:.0f} ns a pair of "
        f"pieces), collide with exact answers {per * (ended - middle):,.0f} ns a pose; this machine, this run"
    )
    wrong = ((verdicts == Verdict.FREE) & exact) | ((verdicts == Verdict.COLLIDING) & ~exact)
    console.print(f"certified verdicts that the exact answer contradicts: {wrong.sum()}\n")
    return verdicts


def draw(a: loewner.Body, b: loewner.Body, poses: np.ndarray, verdicts: np.ndarray, path: Path) -> Path:
    """Three poses side by side: free, ambiguous, colliding."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(15, 5.4))
    for k, verdict in enumerate((Verdict.FREE, Verdict.AMBIGUOUS, Verdict.COLLIDING)):
        of_kind = poses[verdicts == verdict]
        if len(of_kind):
            near = np.linalg.norm(of_kind[:, :3, 3], axis=1).argmin()
            ax = figure.add_subplot(1, 3, k + 1, projection="3d")
            plots.pair(a, None, b, of_kind[near], ax=ax, near=False)
    return plots.save(figure, path)


def robot_in_shelf(checker: loewner.CollisionChecker, count: int, path: Path) -> Path:
    """Check random configurations of the Panda arm before a shelf, and draw one of each kind."""
    robot = checker.robot
    Q = robot.random_configurations(count, seed=0)
    started = time.perf_counter()
    checker.collide(Q[:1])  # compiles, if this machine has not before
    compiled = time.perf_counter()
    colliding = checker.collide(Q)
    ended = time.perf_counter()
    settled = checker.tiers(Q)
    table = Table("settled by", "free", "colliding")
    table.add_row("bounding spheres and boxes", f"{settled.free_by_bounds:,}", "-")
    table.add_row("ellipsoids", f"{settled.free_by_ellipsoids:,}", f"{settled.colliding_by_ellipsoids:,}")
    table.add_row("planes about the pieces", f"{settled.free_by_planes:,}", "-")
    table.add_row("exact search", f"{settled.free_by_search:,}", f"{settled.colliding_by_search:,}")
    table.add_row("in all", f"{settled.free:,}", f"{settled.colliding:,}")
    console.print(table)
    console.print(
        f"{len(robot.bodies)} links, {len(checker.scene)} boards, {len(checker.checked_pairs)} pairs; "
        f"compiled {compiled - started:.1f} s, "
        f"{1e6 * (ended - compiled) / count:.2f} us a configuration"
    )
    return draw_shelf(checker, Q, colliding, path)


def shelf(margin: float = 0.01) -> loewner.Scene:
    """Three boards and two sides, in front of the arm, which keeps a centimetre."""
    scene = loewner.Scene(margin=margin)
    for name, size, position in (
        ("lower board", [0.3, 0.8, 0.02], [0.65, 0.0, 0.15]),
        ("middle board", [0.3, 0.8, 0.02], [0.65, 0.0, 0.5]),
        ("upper board", [0.3, 0.8, 0.02], [0.65, 0.0, 0.85]),
        ("left side", [0.3, 0.02, 0.9], [0.65, 0.4, 0.45]),
        ("right side", [0.3, 0.02, 0.9], [0.65, -0.4, 0.45]),
    ):
        T = np.eye(4)
        T[:3, 3] = position
        scene.add(name, loewner.Body.box(size), T)
    return scene


def draw_shelf(checker: loewner.CollisionChecker, Q: np.ndarray, colliding: np.ndarray, path: Path) -> Path:
    """Of each kind, the configuration that reaches deepest into the shelf, among the first thousand."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(12, 6))
    hand = checker.robot.link_names.index("panda_hand")
    depth = checker.robot.forward_kinematics(Q[:1000])[:, hand, :3, 3] @ [1.0, 0.0, 0.0]
    for k, kind in enumerate((False, True)):
        of_kind = np.flatnonzero(colliding[:1000] == kind)
        if len(of_kind):
            q = Q[of_kind[depth[of_kind].argmax()]]
            ax = plots.configuration(checker, q, ax=figure.add_subplot(1, 2, k + 1, projection="3d"))
            ax.view_init(elev=20, azim=-120)
    return plots.save(figure, path)


def path_in_shelf(checker: loewner.CollisionChecker, path: Path) -> Path:
    """Plan from the lower compartment of the shelf to the upper one, with proofs and with samples, and tell of both."""
    lower, upper = in_compartments(checker)
    planners.plan(checker, lower[0], upper[0])  # compiles, if this machine has not before
    started = time.perf_counter()
    way = planners.plan(checker, lower[0], upper[0])
    seconds = time.perf_counter() - started
    proofs = checker.certify_edges(way[:-1], way[1:])
    console.print(
        f"The arm goes from the lower compartment to the upper one by {len(way) - 1} motions, planned in "
        f"{1e3 * seconds:.1f} ms. {(proofs.verdict == Verdict.FREE).sum()} of them are proven to keep the centimetre "
        "at every configuration on the way, with nothing sampled."
    )
    broken, nearest = sampled_paths(checker, lower, upper)
    missed = f"{broken} are not free between two looks; the worst comes within {nearest} mm of the shelf."
    console.print(
        f"Of {len(lower) * len(upper)} such paths planned by looking at every 0.05 rad only, "
        + (missed if broken else "all are free between two looks as well.")
    )
    return draw_path(checker, way, path)


def in_compartments(checker: loewner.CollisionChecker) -> tuple[np.ndarray, np.ndarray]:
    """Five free configurations with the hand in the lower compartment, and five in the upper one."""
    Q = checker.robot.random_configurations(20_000, seed=0)
    free = Q[~checker.collide(Q)]
    at = hand_positions(checker.robot, free) - [0.65, 0.0, 0.5]  # the middle board
    inside = (np.abs(at[:, 0]) < 0.12) & (np.abs(at[:, 1]) < 0.35)
    lower, upper = (free[inside & (np.abs(at[:, 2] - height) < 0.12)][:5] for height in (-0.175, 0.175))
    return lower, upper


def sampled_paths(checker: loewner.CollisionChecker, lower: np.ndarray, upper: np.ndarray) -> tuple[int, int]:
    """How many sampled paths between these have a motion that is not free, and how near the shelf one gets [mm]."""
    search = planners.Search(certified=False, resolution=0.05)
    ways = [planners.plan(checker, start, goal, search=search) for start in lower for goal in upper]
    broken = [way for way in ways if (checker.certify_edges(way[:-1], way[1:]).verdict == Verdict.COLLIDING).any()]
    nearest = 10
    while nearest and comes_within(1e-3 * (nearest - 1), checker.robot, broken):
        nearest -= 1
    return len(broken), nearest


def comes_within(distance: float, robot: loewner.Robot, ways: list[np.ndarray]) -> bool:
    """Whether a motion on one of these paths provably comes within a distance [m] of the shelf."""
    checker = loewner.CollisionChecker(robot, shelf(distance))
    for way in ways:
        found = checker.certify_edges(way[:-1], way[1:])
        of_shelf = np.isin(found.names, checker.scene.names).any(axis=-1)
        if (of_shelf & (found.verdict == Verdict.COLLIDING)).any():
            return True
    return False


def hand_positions(robot: loewner.Robot, Q: np.ndarray) -> np.ndarray:
    """Where the middle between the finger tips is."""
    positions: np.ndarray = robot.forward_kinematics(Q)[..., robot.link_names.index("panda_hand_tcp"), :3, 3]
    return positions


def draw_path(checker: loewner.CollisionChecker, way: np.ndarray, path: Path) -> Path:
    """Four configurations on a path, at equal parts of its length, and the way of the hand."""
    from matplotlib.figure import Figure

    robot = checker.robot
    reached = np.append(0.0, robot.distances(way[:-1], way[1:]).cumsum())
    parts = np.linspace(0, reached[-1], 4)
    k = np.clip(np.searchsorted(reached, parts, side="right") - 1, 0, len(way) - 2)
    shown = robot.between(way[k], way[k + 1], (parts - reached[k]) / (reached[k + 1] - reached[k]))
    line = hand_positions(robot, robot.between(way[:-1, None], way[1:, None], np.linspace(0, 1, 50)))
    figure = Figure(figsize=(20, 5.4))
    for column, q in enumerate(shown):
        ax = plots.configuration(checker, q, ax=figure.add_subplot(1, 4, column + 1, projection="3d"))
        ax.plot(*line.reshape(-1, 3).T, color="tab:orange")
        ax.set_title(f"{reached[-1] * column / 3:.1f} of {reached[-1]:.1f} rad, {ax.get_title()}")
        ax.view_init(elev=20, azim=-120)
    return plots.save(figure, path)


if __name__ == "__main__":
    main()
