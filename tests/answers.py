"""Hashes of answers to every kind of question: one table for all levels of processors, for the library and for Numba.

    python tests/answers.py            print the table
    python tests/answers.py --write    replace `answers.txt`, after a change that is meant to alter last bits

`test_answers.py` compares the table with `answers.txt`. Processors without fused products have other last bits, and so
has code that Numba compiles with checks of bounds.
"""

import dataclasses
import hashlib
import sys
import tempfile
from collections.abc import Callable, Iterator
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from scipy.interpolate import PPoly

sys.path.insert(0, str(Path(__file__).parent))

from checker_oracle import composed_bodies, random_robot, random_scene, simple_bodies
from families import FAMILIES, pieces
from loewner import (
    Bodies,
    Body,
    CertifiedMotions,
    CollisionChecker,
    Ellipsoids,
    LoewnerError,
    Robot,
    Scene,
    classify,
    collide,
    contact_function,
    distance,
    first_contact,
    mvce,
    mvie,
    near_points,
    overlap,
    overlapping_pairs,
    paper,
    planners,
    prove,
)

TABLE = Path(__file__).with_name("answers.txt")
PAIRS, CONFIGURATIONS, MOTIONS = 1500, 1000, 300
HULLS, ROBOTS, PATHS = 30, 6, 8  # of each family; and paths of each robot


def questions() -> dict[str, Callable[[], list]]:
    """Name the kinds of questions, each with a function that answers it."""
    return {
        **{f"pairs of {family}": partial(of_family, family, number) for number, family in enumerate(FAMILIES)},
        "curved pairs": lambda: of_pairs(Bodies(simple_bodies(Steady(1))), near=1.0),
        "unions": lambda: of_pairs(Bodies(composed_bodies(Steady(2))), near=1.0),
        "surfaces": of_surfaces,
        "clouds": of_clouds,
        "crowds": of_crowds,
        "first contacts": of_first_contacts,
        "ellipsoids": of_ellipsoids,
        "ellipsoids around points": lambda: of_fits(mvce),
        "ellipsoids in polytopes": lambda: of_fits(mvie),
        "pieces of meshes": of_meshes,
        "bodies that moved": of_moved_bodies,
        "the paper": of_the_paper,
        **{f"robot {seed}": partial(of_robot, seed) for seed in range(ROBOTS)},
        "models": of_models,
        "an arm's poses": of_poses,
        "an arm's lines": of_lines,
        "an arm's plans": of_plans,
        "an arm's trajectories": of_trajectories,
        "an arm's curves": of_curves,
        "an arm among moving bodies": of_times,
        "written proofs": of_proofs,
    }


# -- questions that are the same everywhere -----------------------------------------------------


def steady(x: np.ndarray) -> np.ndarray:
    """Round to 2^-26 of the largest number, so that last bits of the C library do not matter."""
    unit = np.ldexp(1.0, np.frexp(np.abs(x).max())[1] - 26)
    return np.round(np.asarray(x) / unit) * unit


class Steady:
    """A generator of random numbers whose normal ones do not depend on the C library."""

    def __init__(self, seed: int) -> None:
        self._rng = np.random.default_rng(seed)

    def normal(self, *, size: tuple[int, ...] | int) -> np.ndarray:
        return steady(self._rng.normal(size=size))

    def rotation(self) -> np.ndarray:
        return random_poses(self, 1, 0.0)[0, :3, :3]

    def __getattr__(self, name: str) -> Any:
        return getattr(self._rng, name)


def random_poses(rng: Steady, count: int, spread: float) -> np.ndarray:
    """Random rotations with translations uniform in a cube, shape (count, 4, 4)."""
    q = rng.normal(size=(count, 4))
    w, x, y, z = (q / np.sqrt((q * q).sum(axis=1))[:, None]).T
    T = np.tile(np.eye(4), (count, 1, 1))
    T[:, 0, :3] = np.stack([1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)], axis=1)
    T[:, 1, :3] = np.stack([2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)], axis=1)
    T[:, 2, :3] = np.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)], axis=1)
    T[:, :3, 3] = rng.uniform(-spread, spread, size=(count, 3))
    return T


# -- pairs of bodies ----------------------------------------------------------------------------


def of_family(family: str, number: int) -> list:
    """Answers on convex hulls of one family."""
    return of_pairs(
        Bodies([Body.from_points(steady(points)) for points in pieces(family, HULLS)]), near=0.8, seed=number
    )


def of_pairs(bodies: Bodies, near: float, count: int = PAIRS, seed: int = 0) -> list:
    """Verdicts, exact verdicts, estimates and distances of random pairs at random poses."""
    rng = Steady(seed)
    chosen = rng.integers(len(bodies), size=(count, 2))
    Ta, Tb = (random_poses(rng, count, near) for _ in range(2))
    a, b = bodies[chosen[:, 0]], bodies[chosen[:, 1]]
    shapes = [array for fit in (bodies[0].outer, bodies[0].inner) for array in (fit.center, fit.factor)]
    verdicts = [collide(a, Ta, b, Tb, margin=margin, method="exact") for margin in (0.0, 0.01)]
    estimates = attempted(lambda: collide(a, Ta, b, Tb, method="estimate"))
    return [
        classify(a, Ta, b, Tb),
        *verdicts,
        estimates,
        distance(a, Ta, b, Tb),
        distance(a, Ta, b, Tb, exact=True),
        *shapes,
    ]


def surface(rng: Steady) -> Body:
    """A closed surface of a few hundred triangles."""
    ball = trimesh.creation.icosphere(subdivisions=2)
    ball.vertices = steady(ball.vertices * rng.uniform(0.3, 1, size=(len(ball.vertices), 1)))
    return Body.from_surface(ball)


def of_surfaces() -> list:
    rng = Steady(3)
    return of_pairs(Bodies([surface(rng) for _ in range(6)]), near=0.8, count=200)


def of_clouds() -> list:
    rng = Steady(4)
    clouds = [Body.from_cloud(rng.normal(size=(200, 3)), radius=0.05) for _ in range(3)]
    return of_pairs(Bodies(clouds), near=1.5, count=300)


def of_crowds() -> list:
    """Pairs of a crowd that meet."""
    rng = Steady(5)
    bodies = Bodies(simple_bodies(rng)[:1] * 300)
    return [overlapping_pairs(bodies, random_poses(rng, 300, 1.0))]


def of_first_contacts() -> list:
    """Times at which bodies that move and turn first touch."""
    rng = Steady(6)
    answers = []
    for _ in range(40):
        a, b = (Body.from_points(rng.normal(size=(12, 3))) for _ in range(2))
        motions = [(poses[0], poses[1]) for poses in (random_poses(rng, 2, 3.0), random_poses(rng, 2, 3.0))]
        answers.append(first_contact(a, motions[0], b, motions[1]))
    return answers


def of_ellipsoids() -> list:
    """Overlaps, contact functions and near points of random ellipsoids, by each method."""
    rng = Steady(7)
    E, F = (Ellipsoids(rng.normal(size=(200, 3)) * 2, rng.normal(size=(200, 3, 3))) for _ in range(2))
    methods = ("lin-han", "rimon-boyd", "center-line")
    return [
        overlap(E, F),
        contact_function(E, F),
        *(attempted(partial(near_points, E, F, name)) for name in methods),
    ]


def of_fits(fit: Callable[[np.ndarray], Any]) -> list:
    """Fits in two to five dimensions."""
    rng = Steady(8)
    answers = []
    for dimension in (2, 3, 4, 5):
        for count in (dimension + 2, 60):
            found = fit(rng.normal(size=(count, dimension)))
            answers += [found.ellipsoid.center, found.ellipsoid.factor, found.gap]
    return answers


def of_meshes() -> list:
    """Pieces, with their ellipsoids, of meshes that are cut by planes, and of surfaces with ellipsoids inside."""
    cross = trimesh.util.concatenate([trimesh.creation.box([3, 1, 1]), trimesh.creation.box([1, 3, 0.8])])
    annulus = trimesh.creation.annulus(0.5, 1.0, 1.0, sections=12)
    torus = trimesh.creation.torus(1.0, 0.3, major_sections=24, minor_sections=12)
    capsule = trimesh.creation.capsule(1.0, 0.3)
    for mesh in (annulus, torus, capsule):
        mesh.vertices = steady(mesh.vertices)
    cut, parts = (Body.from_mesh(mesh, tolerance=0.05) for mesh in (annulus, cross))
    bodies = [cut, parts, Body.from_surface(torus), Body.from_mesh(capsule, decompose=False)]
    return [shapes_of(body) for body in bodies]


def shapes_of(body: Body) -> list:
    """Ellipsoids of all pieces, and the volumes that they miss."""
    return [body.outer.center, body.outer.factor, body.inner.center, body.inner.factor]


def of_moved_bodies() -> list:
    """Bodies whose pieces were turned and moved, and joined."""
    rng = Steady(9)
    bodies = simple_bodies(rng)
    return [shapes_of(body.transformed(random_poses(rng, 1, 1.0)[0])) for body in bodies]


def of_the_paper() -> list:
    """The paper's experiment: its detectors and estimates."""
    found = paper.run(60)
    results = [*found.detectors, found.estimate]
    return [found.truth, *([one.answers, one.all, one.ambiguous] for one in results)]


# -- random robots ------------------------------------------------------------------------------


def of_robot(seed: int) -> list:
    """Configurations, motions, distances, clearances and paths of a random robot in a random scene."""
    rng = Steady(seed)
    pool = [*simple_bodies(rng), *composed_bodies(rng)]
    with tempfile.TemporaryDirectory() as folder:
        robot = random_robot(rng, Path(folder), 3 + seed, pool)
    checker = CollisionChecker(robot, random_scene(rng, robot, 4, pool))
    Q = robot.random_configurations(CONFIGURATIONS, seed)
    start, end = Q[:MOTIONS], robot.between(Q[:MOTIONS], Q[1 : MOTIONS + 1], 0.3)
    proven = checker.certify_edges(start, end)
    measured = []
    if checker.checked_pairs:
        few = Q[:150]
        measured = [checker.distance(few, exact=True, gradient=True), checker.clearance(few, gradient=True)]
    ends = zip(Q[:PATHS], Q[PATHS : 2 * PATHS], strict=True)
    return [
        robot.forward_kinematics(Q[:50]), end, robot.distances(Q[:30], Q[-30:]), checker.classify(Q),
        checker.collide(Q), checker.valid_edges(start, Q[1 : MOTIONS + 1], 0.05), proven, *measured,
        *(attempted(lambda a=a, b=b: planners.plan(checker, a, b, max_iterations=500)) for a, b in ends),
    ]  # fmt: skip


def attempted(answer: Callable[[], Any]) -> Any:
    """Return an answer, or the name of the error."""
    try:
        return answer()
    except LoewnerError as error:
        return type(error).__name__


# -- an arm -------------------------------------------------------------------------------------

JOINT = """
  <joint name="j{n}" type="revolute"><parent link="l{n}"/><child link="l{m}"/>
    <origin xyz="{xyz}" rpy="{rpy}"/><axis xyz="{axis}"/>
    <limit lower="-2.8" upper="2.8" effort="1" velocity="2"/></joint>"""
LINK = """
  <link name="l{n}"><collision><origin xyz="0 0 0.12" rpy="{rpy}"/><geometry>{shape}</geometry></collision></link>"""
SHAPES = ('<box size="0.1 0.12 0.2"/>', '<cylinder radius="0.06" length="0.22"/>', '<sphere radius="0.09"/>')


@cache
def arm() -> Robot:
    """An arm of six joints, whose frames are parallel to no axis."""
    rng = Steady(10)

    def numbers(size: float) -> str:
        return " ".join(f"{x:.3f}" for x in rng.uniform(-size, size, 3))

    text = "".join(LINK.format(n=n, rpy=numbers(0.3), shape=SHAPES[n % 3]) for n in range(7))
    for n in range(6):
        axis = ("0 0 1", "0 1 0", "0.6 0.8 0")[n % 3]
        text += JOINT.format(n=n, m=n + 1, xyz=f"{rng.uniform(-0.05, 0.05):.3f} 0 0.3", rpy=numbers(0.4), axis=axis)
    return Robot.from_urdf(text=f'<robot name="arm">{text}</robot>')


@cache
def checker() -> CollisionChecker:
    """The arm beside a table and a post."""
    post = np.eye(4)
    post[:3, 3] = 0.7, 0.1, 0.5
    table = np.eye(4)
    table[:3, 3] = 0.0, 0.0, -0.35
    scene = Scene()
    scene.add("table", Body.box([2.0, 2.0, 0.1]), table)
    scene.add("post", Body.capsule(0.08, 0.6), post)
    return CollisionChecker(arm(), scene)


@cache
def free() -> np.ndarray:
    """Configurations of the arm that are free."""
    Q = arm().random_configurations(400, 1)
    return Q[~checker().collide(Q)]


def of_models() -> list:
    """The arm's model as its hash and its proofs have it, and a tree of all kinds of joints."""
    return [checker().model_hash, *arm().tree, arm().forward_kinematics(free()[:50]), arm().jacobian(free()[:20], "l6")]


def of_poses() -> list:
    """Configurations that reach poses, with and without tolerances, and all of them."""
    T = arm().forward_kinematics(free()[:20])[:, -1]
    loose = [0.01, 0.01, 0.01, 0.1, 0.1, np.inf]
    every = arm().reach("l6", T[:4], all=True, checker=checker())
    return [arm().reach("l6", T), arm().reach("l6", T, tolerance=loose), every]


def of_lines() -> list:
    """Straight lines of the last link."""
    answers = []
    for q in free()[:12]:
        T = arm().forward_kinematics(q)[-1].copy()
        T[:3, 3] += 0.05, -0.03, 0.02
        answers.append(attempted(lambda q=q, T=T: planners.straight(checker(), q, "l6", T)))
    return answers


def of_plans() -> list:
    """Paths, shorter ones, ones improved in rounds, a roadmap's, and a goal that is a pose."""
    Q = free()
    ends = [(Q[2 * k], Q[2 * k + 1]) for k in range(8)]
    answers = [
        attempted(lambda a=a, b=b, k=k: planners.plan(checker(), a, b, seed=k, max_iterations=3000))
        for k, (a, b) in enumerate(ends)
    ]
    better = planners.plan(checker(), *ends[0], max_iterations=3000, improve_iterations=2000, clearance=0.02, full=True)
    roads = planners.roadmap(checker(), 60)
    return [*answers, better.path, better.cost, *(attempted(lambda a=a, b=b: roads.path(a, b)) for a, b in ends[:4])]


def of_trajectories() -> list:
    """Times along paths, with blends, with limited acceleration and with limited jerk."""
    Q = free()
    path = np.array([Q[0], Q[1], Q[2], Q[3]])
    answers = []
    for jerk in (None, 20.0):
        found = planners.trajectory(arm(), path, velocity=1.0, acceleration=2.0, jerk=jerk)
        answers += [
            found.times,
            found.knots,
            found.rates,
            found.bends,
            found.positions(np.linspace(0.0, found.times[-1], 50)),
        ]
    return answers


def of_curves() -> list:
    """Proofs of curved motions."""
    coefficients = Steady(13).uniform(-0.05, 0.05, size=(12, 4, 1, 6))
    coefficients[:, 3, 0] = free()[:12]
    return [checker().certify_trajectory(PPoly(c, [0.0, 1.0]), proof=True) for c in coefficients]


def of_times() -> list:
    """Verdicts, proofs and a plan beside a body that moves and turns."""
    scene = Scene()
    scene.add("guest", Body.box([0.2, 0.1, 0.3]))
    scene.follow("guest", np.arange(5.0), random_poses(Steady(11), 5, 0.8))
    beside = CollisionChecker(arm(), scene)
    Q, t = free()[:100], np.linspace(0.0, 4.0, 100)
    near = arm().between(Q[:20], Q[1:21], 0.2)
    proven = beside.certify_edges(Q[:20], near, t0=t[:20], t1=t[:20] + 1.0)
    planned = attempted(
        lambda: planners.plan(beside, Q[0], Q[1], start_time=0.0, velocity=1.0, max_iterations=300).knots
    )
    return [beside.collide(Q, t), beside.distance(Q[:20], t[:20], exact=True), proven, planned]


def of_proofs() -> list:
    """Proofs for other programs, byte for byte: of motions, and of two bodies."""
    Q = free()
    proven = checker().certify_edges(Q[:6], arm().between(Q[:6], Q[1:7], 0.1), proof=True)
    rng = Steady(12)
    a, b = (Body.from_points(rng.normal(size=(15, 3))) for _ in range(2))
    Ta, Tb = np.eye(4), np.eye(4)
    Tb[:3, 3] = 4.5, 1.0, 0.0
    return [proven, prove(a, Ta, b, Tb)]


# -- the table ----------------------------------------------------------------------------------


def digest(answer: Any) -> str:
    """Hash an answer: arrays, numbers and texts, in lists and results; all NaN count as one."""
    found = hashlib.sha256()
    for leaf in leaves(answer):
        if isinstance(leaf, np.ndarray):
            clean = np.where(np.isnan(leaf), np.nan, leaf) if leaf.dtype.kind == "f" else leaf
            found.update(f"{leaf.shape} {leaf.dtype}".encode() + np.ascontiguousarray(clean).tobytes())
        else:
            found.update(repr(leaf).encode())
    return found.hexdigest()[:16]


def leaves(answer: Any) -> Iterator[np.ndarray | float | str | bytes | None]:
    """Yield what an answer holds, in order."""
    if isinstance(answer, list | tuple):
        for one in answer:
            yield from leaves(one)
    elif dataclasses.is_dataclass(answer):
        held = [field.name for field in dataclasses.fields(answer)]
        if isinstance(answer, CertifiedMotions):
            held.remove("steps")  # work, which may change where no answer does
        yield from leaves([getattr(answer, name) for name in held])
    elif isinstance(answer, np.ndarray) and answer.dtype == object:
        yield from leaves(answer.ravel().tolist())
    elif isinstance(answer, np.ndarray | np.generic | int | float | str | bytes | None):
        yield answer
    else:
        raise TypeError(f"expected an answer that can be hashed, found {type(answer).__name__}")


def table() -> Iterator[str]:
    """Yield the lines of the table: a hash and the kind of question."""
    for name, answer in questions().items():
        yield f"{digest(answer())}  {name}"


def main() -> None:
    """Print the table, or write it."""
    lines = []
    for line in table():
        print(line, flush=True)
        lines.append(line)
    if "--write" in sys.argv[1:]:
        TABLE.write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
