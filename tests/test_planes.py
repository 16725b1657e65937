"""Planes beside moving pieces: gaps, what joints may stray along normals, and the proofs that rest on them."""

from dataclasses import replace
from functools import cache
from itertools import islice, product
from typing import Any, NamedTuple

import numpy as np
import pytest
from scipy.interpolate import BPoly, CubicHermiteSpline, PPoly

from checker_oracle import pose, robot_of, simple_bodies
from families import translation
from loewner import Body, CollisionChecker, Robot, Scene, Verdict
from loewner._kernels import columns
from loewner._kernels._jit import njit
from loewner._kernels.robots.motion_bounds import rates_of, uncertainty, ways_between, write_strays
from loewner._kernels.robots.motion_path import write_part
from loewner._kernels.robots.planes import write_gaps
from loewner._kernels.robots.strays import error_of_strays, longest_lever, write_strays_along
from loewner.robots.proofs import courses
from motion_oracle import (
    AFLOAT,
    Real,
    bent,
    empty_rates,
    example,
    free_configurations,
    real_configurations,
    real_places,
    ring,
    steps,
    straight,
    written,
)
from sampling import quick

FREE, AMBIGUOUS = Verdict.FREE, Verdict.AMBIGUOUS

far_outside = pytest.mark.filterwarnings("ignore:.*is it in .*:UserWarning")

# Ball joints, which no URDF has, on one branch after a sliding joint and on another one before a hinge.
LIMIT = '<limit lower="-2" upper="2"/>'

BALLS = """<mujoco model="balls"><worldbody><body name="trunk" pos="0.1 0 0.2">
<joint type="hinge" axis="1 2 3"/><geom type="box" size="0.1 0.05 0.08"/>
<body name="left" pos="0.3 0.1 0"><joint type="slide" axis="0 1 1"/><joint type="ball" pos="0.02 0.1 0"/>
  <geom type="box" size="0.2 0.02 0.05" pos="0.2 0 0"/>
  <body name="left hand" pos="0.4 0 0"><joint type="hinge" axis="0 1 0"/><geom type="box" size="0.1 0.1 0.02"/></body>
</body>
<body name="right" pos="-0.3 0.1 0"><joint type="ball" pos="0 0.05 0"/>
  <geom type="capsule" fromto="0 0 0 -0.4 0 0" size="0.05"/>
  <body name="right hand" pos="-0.4 0 0"><joint type="hinge" axis="1 1 0"/><geom type="box" size="0.1 0.1 0.02"/></body>
</body></body></worldbody></mujoco>"""

# Two arms of 1 m that point away from each other, each with one joint at its end.
TWO_ARMS = """<robot name="arms"><link name="base"/><link name="left"/><link name="right"/>
<joint name="a" type="continuous"><parent link="base"/><child link="left"/><origin xyz="-1 0 0"/><axis xyz="0 0 1"/>
</joint>
<joint name="b" type="continuous"><parent link="base"/><child link="right"/><origin xyz="1 0 0"/><axis xyz="0 0 1"/>
</joint></robot>"""


@njit()
def gaps_along(pieces, W, link, fixed, poses, row, i, j, n, strays, count, out):
    """`write_gaps`, which can only be called by kernels."""
    write_gaps(pieces, W, link, fixed, poses, row, i, j, n, strays, count, out)


# -- robots, courses and views ------------------------------------------------------------------


def various_bodies(rng):
    """Bodies of all kinds, beside their origins: hulls of few and of many vertices, curved ones and surfaces."""
    many, corners = rng.normal(size=(300, 3)), Body.box(rng.uniform(0.1, 0.4, 3)).pieces[0]
    bodies = [
        *simple_bodies(rng), Body.from_points(0.2 * many / np.linalg.norm(many, axis=1, keepdims=True)),
        Body.from_surface((corners.vertices, corners.triangles)),
        Body.from_surface((corners.vertices, corners.triangles[2:]), radius=0.03),
    ]  # fmt: skip
    return [body.transformed(pose(rng, 0.2)) for body in bodies]


def mixed_robot(rng, folder, links=6):
    """A tree of joints of all kinds of a URDF, of which some mimic another one, with a body on each link."""
    joints, single = [], []
    for k in range(1, links):
        kind = str(
            rng.choice(["revolute", "continuous", "prismatic", "planar", "floating"], p=[0.3, 0.1, 0.25, 0.2, 0.15])
        )
        mimic = ""
        if kind in ("revolute", "continuous", "prismatic"):
            if single and rng.random() < 0.3:
                mimic = f'<mimic joint="j{rng.choice(single)}" multiplier="{rng.uniform(-2, 2)}" offset="0.2"/>'
            else:
                single.append(k)
        x, turn, axis = rng.normal(size=3) * 0.3, rng.uniform(-3, 3, 3), rng.normal(size=3)
        joints.append((
            kind, rng.integers(max(0, k - 3), k),
            f'<origin xyz="{x[0]} {x[1]} {x[2]}" rpy="{turn[0]} {turn[1]} {turn[2]}"/>'
            f'<axis xyz="{axis[0]} {axis[1]} {axis[2]}"/>{LIMIT if kind in ("revolute", "prismatic") else ""}{mimic}',
        ))  # fmt: skip
    bodies = various_bodies(rng)
    return robot_of(folder, joints, {f"l{k}": bodies[rng.integers(len(bodies))] for k in range(1, links)})


def balls(folder):
    """A robot with ball joints on both of its branches."""
    path = folder / "balls.xml"
    path.write_text(BALLS)
    return Robot.from_mjcf(path)


class Case(NamedTuple):
    """A part of a course, with what the kernels make of it."""

    checker: Any
    ready: Any
    robot: Any
    course: Any
    tables: Any
    rates: Any
    slack: float


class View(NamedTuple):
    """A piece of a moving body and one of another body, with a normal in the other body's frame.

    Attributes
    ----------
    body : number of the moving body
    i, j : rows of the pieces
    link, fixed : their links, -1 for the world
    row : number of the other body among those that stand
    n : unit normal from j to i
    """

    body: int
    i: int
    j: int
    link: int
    fixed: int
    row: int
    n: Any


def case_of(checker, course, low=0.0, high=1.0):
    part, robot, ready, made = np.empty_like(course), checker.robot, checker._ready(), empty_rates(checker.robot)
    write_part(course, low, high, np.empty(len(course)), part)
    tables = ready.tables
    # Twice for two bodies, and once more for the normal, which turns with one of them.
    off, _, turned = uncertainty(tables, *rates_of(robot.tree, course, 1.0, made))
    rates_of(robot.tree, part, high - low, made)
    return Case(checker, ready, robot, course, tables, made, 4.0 * off + turned)


def view_of(case, body, other, n, number=0):
    """The view of a body's piece from the first piece of another body."""
    ready, moving, start = case.ready, len(case.ready.link), case.ready.packed.piece_start
    n = np.asarray(n, dtype=float)
    fixed, row = (int(ready.link[other]), 0) if other < moving else (-1, other - moving)
    return View(
        body, int(start[body]) + number, int(start[other]), int(ready.link[body]), fixed, row,
        tuple(n / np.linalg.norm(n)),
    )  # fmt: skip


def views(case, rng, count):
    """Views at random, from static bodies and from moving ones."""
    moving, every = len(case.ready.link), len(case.ready.names)
    for _ in range(count):
        body = int(rng.integers(moving))
        other = int(rng.integers(moving, every)) if rng.random() < 0.4 else int(rng.integers(moving))
        yield view_of(case, body, other, rng.normal(size=3))


def eight(a, b):
    """Eight fractions, as the kernels choose them."""
    return np.append(a + (b - a) * (np.arange(7) / 7), b)


def placed(case, times):
    """Poses of all links at eight fractions, as kernels store them, and as matrices."""
    Q = courses.configurations(case.robot, np.broadcast_to(case.course, (8, *case.course.shape)), times)
    poses = case.robot.forward_kinematics(Q)
    twelve = np.concatenate([poses[..., :3, :3].reshape(8, -1, 9), poses[..., :3, 3]], axis=2)
    return np.ascontiguousarray(twelve.transpose(1, 2, 0)).ravel(), poses


def ways(case, view, given=None):
    return ways_between(case.tables, case.rates if given is None else given, view.body, view.link, view.fixed)


def kernel_gaps(case, view, W, planes=None, count=-1, still=None, n=None):
    """What `write_gaps` writes."""
    out, planes = np.empty(32), np.empty(16) if planes is None else planes
    still = case.ready.standing.poses.reshape(-1, 4, 4) if still is None else still
    gaps_along(
        case.ready.packed.kernel, W, view.link, view.fixed, still, view.row, view.i, view.j, view.n if n is None else n,
        planes, count, out,
    )  # fmt: skip
    return out[:8]


def extent(packed, piece, D):
    """How far a piece of a body reaches along directions, shape (..., 3), from its definition in extended precision."""
    kind, start, stop = packed.layout[piece, :3]
    frame = packed.frames[piece].astype(Real)
    if kind <= columns.POLYTOPE:
        far = (D @ packed.points[start:stop].T.astype(Real)).max(axis=-1)
    else:
        U = D @ frame[4:].reshape(3, 3)
        across, along = np.sqrt((U[..., :2] ** 2).sum(axis=-1)), U[..., 2]
        far = (
            D @ frame[1:4]
            + {
                columns.ELLIPSOID: np.sqrt((U**2).sum(axis=-1)),
                columns.CYLINDER: across + np.abs(along),
                columns.CONE: np.maximum(along, across - along),
                columns.SEGMENT: np.abs(along),
                columns.POINT: 0 * along,
            }[kind]
        )
    return far + frame[0] * np.sqrt((D**2).sum(axis=-1))


def real_gaps(case, view, poses):
    """The gap between both pieces along n, for poses of all links in extended precision, shape (N, links, 4, 4)."""
    packed, n = case.ready.packed, np.broadcast_to(np.asarray(view.n, dtype=Real), (len(poses), 3))
    still = case.ready.standing.poses.reshape(-1, 4, 4)
    if view.fixed >= 0:
        there, below = poses[:, view.fixed, :3, 3], extent(packed, view.j, n)
        n = (poses[:, view.fixed, :3, :3] @ n[..., None])[..., 0]
    else:
        T = still[view.row].astype(Real)
        there, below = T[:3, 3], extent(packed, view.j, n @ T[:3, :3])
    low = -extent(packed, view.i, -(n[:, None] @ poses[:, view.link, :3, :3])[:, 0])
    return (n * (poses[:, view.link, :3, 3] - there)).sum(axis=1) + low - below


def cases(checker, rng, seed, degree, count, wide=False):
    """Parts of courses of a degree, and the ends of an interval in each; a wide one is all of a long course."""
    robot = checker.robot
    for q in robot.random_configurations(count, seed):
        length, low, high = 6.0 if wide else rng.choice([0.1, 1.0, 4.0]), 0.0, 1.0
        if degree == 1:
            course = straight(robot, q, steps(robot, rng, q[None], length)[0])
        else:
            course = bent(robot, rng, q, degree, length)
            low, high = rng.choice([[0.0, 1.0], [0.25, 0.375], [0.9, 1.0]])
        a, b = low + (high - low) * np.sort(rng.random(2)) * rng.choice([1.0, 0.2])
        if wide:
            low, high, a, b = 0.0, 1.0, 0.0, 1.0
        yield case_of(checker, course, low, high), a, max(b, a + 1e-3 * (high - low))


def mixed(folder, seed):
    """A random robot beside bodies that stand; every fourth one is the robot with ball joints."""
    rng = np.random.default_rng(seed)
    scene = Scene()
    for k, body in enumerate(rng.permutation(np.array(various_bodies(rng), dtype=object))[:4]):
        scene.add(f"b{k}", body, pose(rng, 0.6))
    robot = balls(folder) if seed % 4 == 3 else mixed_robot(rng, folder)
    return rng, CollisionChecker(robot, scene, skip_adjacent=False)


# -- the law of gaps ----------------------------------------------------------------------------


def check_gaps(case, view, times):
    """Hold gaps against those of the kernel's poses and of the real ones; return how much they are too small."""
    W, poses = placed(case, times)
    found, true = kernel_gaps(case, view, W), real_gaps(case, view, poses.astype(Real))
    assert (found <= true).all()
    radii = case.ready.packed.frames[[view.i, view.j], 0].sum()
    size = 1.0 + case.tables.chain[1] + np.abs(poses[:, [view.link, view.fixed], :3, 3]).sum()
    assert (found >= true - 1e-5 * radii - 1e-13 * size).all()
    real = real_gaps(
        case, view, real_places(case.robot, real_configurations(case.robot, case.course, times.astype(Real)))
    )
    assert (found <= real + case.slack * (1.0 + size)).all()
    assert (found >= real - 1e-5 * radii - 1e-9 * size).all()
    return float((true - found).max())


@pytest.mark.parametrize("seed", quick(*range(24)))
@far_outside
@pytest.mark.slow("its first case compiles the search for planes, which it calls directly")
def test_gaps(tmp_path, seed):
    """Gaps along random normals are lower bounds of the real ones, and hardly smaller."""
    rng, checker = mixed(tmp_path, seed)
    for degree in (1, 3):
        for case, a, b in cases(checker, rng, seed, degree, 2):
            for view in views(case, rng, 10):
                check_gaps(case, view, eight(a, b))


@cache
def every_kind():
    """One body of each kind."""
    return various_bodies(np.random.default_rng(0))


@pytest.mark.parametrize("count", quick(1, 8))
@pytest.mark.parametrize("kind", range(12))
def test_gaps_of_every_kind(tmp_path, kind, count):
    """The same for every kind of piece, as the one that moves and as the other, which moves or stands."""
    rng = np.random.default_rng(kind)
    body, other = every_kind()[kind], Body.from_points(rng.normal(size=(12, 3)) * 0.1)
    turn = '<origin xyz="0.3 0.1 0.2" rpy="0.3 0.5 -0.8"/><axis xyz="0.4 -0.2 1"/><limit lower="-2" upper="2"/>'
    robot = robot_of(tmp_path, [("revolute", 0, turn), ("revolute", 0, turn), ("prismatic", 2, turn)])
    scene = Scene()
    scene.add("still", body, pose(rng, 0.5))
    checker = CollisionChecker(replace(robot, bodies={"l1": body, "l3": other}), scene)
    case = case_of(checker, straight(robot, np.full(3, -1.0), np.array([1.5, 0.7, -0.3])))
    for one, second in ((0, 1), (1, 0), (0, 2), (1, 2)):
        for n in [*np.eye(3), *-np.eye(3), *rng.normal(size=(count, 3))]:
            check_gaps(case, view_of(case, one, second, n), eight(0.2, 0.9))


def test_every_kind_is_there():
    """The kinds above are all that there are; a hull of many vertices is one of its own."""
    kinds = {int(body._packed.kernel.layout[0, columns.KIND]) for body in every_kind()}
    assert kinds == set(range(columns.SOLID, columns.POINT + 1))


# -- gaps that are no numbers -------------------------------------------------------------------


@pytest.fixture
def still_and_moving(tmp_path):
    """A case with views of a hull and of a curved piece, from a static body and from a moving one."""
    bodies = [Body.box([0.1, 0.2, 0.3]).transformed(translation(1.0, 1.0, 1.0)), Body.cylinder(0.1, 0.2)]
    turn = '<axis xyz="0 0 1"/><limit lower="-2" upper="2"/>'
    robot = robot_of(
        tmp_path, [("revolute", 0, turn), ("revolute", 0, turn)], dict(zip(("l1", "l2"), bodies, strict=True))
    )
    scene = Scene()
    scene.add("still", Body.sphere(0.1))
    case = case_of(CollisionChecker(robot, scene), straight(robot, np.zeros(2), np.ones(2)))
    return case, [view_of(case, one, other, [0.6, 0.64, 0.48]) for one, other in ((0, 1), (1, 0), (0, 2), (1, 2))]


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_no_gap_without_numbers(still_and_moving, bad):
    """A pose with an entry that is not a number, or infinitely far away, has no gap, but the other lanes have."""
    case, seen = still_and_moving
    W, _ = placed(case, eight(0.0, 1.0))
    for view in seen:
        good = kernel_gaps(case, view, W)
        for link in {view.link, max(view.fixed, 0)} - {0}:
            for entry in range(0 if np.isnan(bad) else 9, 12):
                for lane in (0, 3, 7):
                    spoiled = W.copy()
                    spoiled[(12 * link + entry) * 8 + lane] = bad
                    found = kernel_gaps(case, view, spoiled)
                    assert not found[lane] > -np.inf
                    assert (np.delete(found, lane) == np.delete(good, lane)).all()
        if view.fixed < 0:
            still = case.ready.standing.poses.reshape(-1, 4, 4).copy()
            still[view.row, 1, 3] = bad
            assert not (kernel_gaps(case, view, W, still=still) > -np.inf).any()
        if np.isnan(bad):
            for k in range(3):
                n = tuple(np.where(np.arange(3) == k, bad, view.n))
                assert not (kernel_gaps(case, view, W, n=n) > -np.inf).any()


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_no_gap_for_strays_without_numbers(still_and_moving, bad):
    """Nor is there one if joints may stray by infinity, or by what is not a number."""
    case, seen = still_and_moving
    W, _ = placed(case, eight(0.0, 1.0))
    for view, joint in product(seen, (1, 2)):
        strays = strays_of(case, np.full(2, 0.01))
        planes, count = strays_along(case, view, W, strays)
        assert (kernel_gaps(case, view, W, planes, count) > -np.inf).all()
        if joint in (view.link, view.fixed):
            strays.turn[joint] = bad
            planes, count = strays_along(case, view, W, strays)
            assert np.isnan(bad) or not (kernel_gaps(case, view, W, planes, count) > -np.inf).any()
            assert not error_of(case, view, strays, 0.1) < np.inf  # which is added to what a gap must exceed


# -- the law of strays --------------------------------------------------------------------------


def strays_of(case, off):
    strays = empty_rates(case.robot)
    write_strays(case.robot.tree, off, case.rates, strays)
    return strays


def strays_along(case, view, W, strays):
    """What `write_strays_along` writes and returns."""
    planes = np.zeros((2 + 4 * len(case.robot.link_names)) * 8)
    lever = longest_lever(case.tables, ways(case, view), ways(case, view, strays))
    count = write_strays_along(
        case.robot.tree, case.tables, case.ready.packed.kernel.hot, W, strays, lever, view.link, view.fixed, view.i,
        view.n, planes,
    )  # fmt: skip
    return planes, count


def error_of(case, view, strays, width):
    """`error_of_strays` for a view."""
    seen, astray = ways(case, view), ways(case, view, strays)
    lever = longest_lever(case.tables, seen, astray) + case.ready.packed.kernel.hot[view.i, columns.OUTER_RADIUS]
    return error_of_strays(seen, astray, lever, width)


def told(case, view, times, off, W=None, strays=None, change=None, chord=1.0, between=1.0, second=1.0):
    """The gap that a proof counts on in an interval, from the parts that it adds up; some may be left out."""
    W, width = placed(case, times)[0] if W is None else W, np.diff(times).max()
    planes, count = strays_along(case, view, W, strays_of(case, off) if strays is None else strays)
    if change is not None:
        change(planes, count)
    least = kernel_gaps(case, view, W, planes, count).min()
    if not off.any():
        between = second = 0.0
    allowed = strays_of(case, off)
    lost = between * error_of(case, view, allowed, width) + second * ways(case, view, allowed).bend
    return least - chord * ways(case, view).bend * width * width / 8.0 - lost


def deviated(robot, Q, D):
    """Configurations of extended precision that deviate by D, with unit quaternions."""
    there = Q + D
    for at in robot._quaternions.values():
        there[:, at] /= np.sqrt((there[:, at] ** 2).sum(axis=1))[:, None]
    return there


class Strayed(NamedTuple):
    """Samples of an interval: configurations on the course, poses there and with each value a little larger, and poses
    with random deviations."""

    Q: Any
    poses: Any
    beside: Any
    there: Any


SMALL = 1e-6


def strayed(case, rng, a, b, off, count=8, deviations=8):
    robot = case.robot
    t = rng.uniform(a, b, count)
    t[:2] = a, b
    Q = real_configurations(robot, case.course, t.astype(Real))
    columns_off = np.flatnonzero(off)
    step = SMALL * np.eye(robot.dof)[columns_off]
    beside = deviated(robot, np.repeat(Q, len(step), axis=0), np.tile(step, (count, 1)))
    D = off * rng.choice([-1.0, 1.0], (deviations, len(off)))
    D[::3] *= rng.random((len(D[::3]), len(off)))
    there = deviated(robot, np.repeat(Q, deviations, axis=0), np.tile(D, (count, 1)))
    places = real_places(robot, np.concatenate([Q, beside, there]))
    return Strayed(Q, *np.split(places, [count, count + len(beside)]))


def least_gap(case, view, samples, off):
    """The least gap of the samples, and of the corners to which the gap falls most steeply; and the course's own."""
    columns_off = np.flatnonzero(off)
    here = real_gaps(case, view, samples.poses)
    rates = (real_gaps(case, view, samples.beside).reshape(len(here), -1) - here[:, None]) / SMALL
    D = np.zeros((len(here), len(off)))
    D[:, columns_off] = -off[columns_off] * np.sign(rates)
    steepest = real_gaps(case, view, real_places(case.robot, deviated(case.robot, samples.Q, D)))
    return float(min(real_gaps(case, view, samples.there).min(), steepest.min())), float(here.min())


def deviations(rng, dof):
    """Allowed deviations of some values, in a third of the cases large ones."""
    off = rng.uniform(0.0, rng.choice([1e-3, 0.03, 0.3]), dof) * (rng.random(dof) < 0.6)
    off[rng.integers(dof)] = 0.01
    return off


@pytest.mark.parametrize("degree", [1, 2, 3, 5])
@pytest.mark.parametrize("seed", quick(*range(34)))
@far_outside
def test_strays(tmp_path, seed, degree):
    """Where joints deviate within an interval, no gap is less than what a proof counts on."""
    rng, checker = mixed(tmp_path, seed)
    shares = []
    for case, a, b in cases(checker, rng, seed, degree, 2):
        off, times = deviations(rng, case.robot.dof), eight(a, b)
        W, samples = placed(case, times)[0], strayed(case, rng, a, b, off)
        for view in views(case, rng, 5):
            least, own = least_gap(case, view, samples, off)
            counted = told(case, view, times, off, W)
            assert least >= counted - 1e-12
            if least < own - 1e-9:
                shares.append((own - least) / (own - counted))
    print(f"shares of the bound: largest {max(shares, default=0):.3f}, median {np.median(shares or [0]):.3f}")
    assert max(shares, default=1.0) > 0.2 or seed >= 4  # a robot at random may have joints that turn freely everywhere


# -- robots for which a length is easily taken too short ----------------------------------------


def strays_at(case, view, times, strays, x):
    """What is written for eight configurations: how far a point of the moving body strays along n, to first order."""
    planes, count = strays_along(case, view, placed(case, times)[0], strays)
    planes = planes.reshape(-1, 8)
    return planes[0] + sum(np.abs(x @ planes[k : k + 3] + planes[k + 3]) for k in range(2, 2 + 4 * count, 4))


def two_arms(folder, a, b):
    """A ball at each of two joints that are 2 m apart, on a course of two polynomials: a case."""
    ball = Body.sphere(0.01)
    robot = replace(written(folder, TWO_ARMS), bodies={"left": ball, "right": ball})
    course = np.zeros((5, 2))
    for c, value in enumerate((a, b)):
        padded = np.zeros(5)
        padded[: len(value.coef)] = value.coef
        course[:, c] = BPoly.from_power_basis(PPoly(padded[::-1, None], [0.0, 1.0])).c[:, 0]
    return case_of(CollisionChecker(robot, skip_adjacent=False), course)


@pytest.mark.parametrize("h", [0.02, 0.05, 0.1, 0.5])
@pytest.mark.parametrize("n", [*np.eye(3)[:2], *-np.eye(3)[:2], [0.6, 0.8, 0.0]])
def test_the_remainder_between_two_arms(tmp_path, h, n):
    """Between configurations, strays exceed those at both ends by no more than is added for points as far from a joint
    as both arms together are long.
    """
    # The left joint has the acceleration a - 12 t² from -3.5 h to 3.5 h: largest between two of eight configurations.
    half = 3.5 * h
    way = np.polynomial.Polynomial([-half, 2 * half])
    case = two_arms(tmp_path, np.polynomial.Polynomial([0, 0, 6 * half**2, 0, -1])(way), way)
    left, right = (case.ready.names.index(name) for name in ("left", "right"))
    view, strays = view_of(case, right, left, n), strays_of(case, np.array([0.02, 0.01]))
    excess, added = excess_between(case, view, eight(0.0, 1.0), strays, np.zeros(3))
    assert excess <= added


def excess_between(case, view, times, strays, x):
    """How much strays between configurations exceed those on the chords, at most, and what is added for that."""
    ends, most, s = strays_at(case, view, times, strays, x), 0.0, np.arange(8) / 7
    for k in range(7):
        inside = strays_at(case, view, eight(times[k], times[k + 1]), strays, x)
        most = max(most, (inside - (1 - s) * ends[k] - s * ends[k + 1]).max())
    return most, error_of(case, view, strays, np.diff(times).max())


@pytest.mark.parametrize("degree", [1, 2, 3, 5])
@pytest.mark.parametrize("seed", quick(*range(34)))
@far_outside
def test_remainders(tmp_path, seed, degree):
    """The same for random robots, in wide intervals too."""
    rng, checker = mixed(tmp_path, seed)
    largest = 0.0
    for wide in (False, True):
        for case, a, b in cases(checker, rng, seed, degree, 1, wide):
            strays = strays_of(case, deviations(rng, case.robot.dof))
            for view in views(case, rng, 3):
                piece = case.ready.packed.outer_center[view.i]
                excess, added = excess_between(case, view, eight(a, b), strays, piece)
                assert excess <= added + 1e-15
                largest = max(largest, excess / max(added, 1e-9))
    print(f"largest share: {largest:.3f}")


def orientation_off(folder, n):
    """A cart 5 m from its floating base, whose orientation is off: the case, the deviations, and a view along n."""
    robot = replace(written(folder, AFLOAT), bodies={"cart": Body.sphere(0.05)})
    q = robot.configuration({"cart/x": 5.0})
    end = robot.configuration({"cart/x": 6.0})
    scene = Scene()
    scene.add("plate", Body.box([0.1, 0.1, 0.1]), translation(0.0, 0.0, -9.0))
    case = case_of(CollisionChecker(robot, scene), straight(robot, q, end))
    off = np.zeros(robot.dof)
    off[robot._quaternions["base"]] = 0.01
    return case, off, view_of(case, 0, 1, n)


@pytest.mark.parametrize("n", [*np.eye(3), *-np.eye(3)])
@far_outside
def test_strays_of_an_orientation_far_from_its_joint(tmp_path, n):
    """A deviation of an orientation moves links in proportion to their distance, to which sliding joints add."""
    case, off, view = orientation_off(tmp_path, n)
    samples = strayed(case, np.random.default_rng(0), 0.0, 1.0, off, 4, 60)
    least, own = least_gap(case, view, samples, off)
    counted = told(case, view, eight(0.0, 1.0), off)
    assert counted <= least < own
    print(f"share of the bound: {(own - least) / (own - counted):.3f}")


@pytest.mark.parametrize("above", [1e-3, 5e-3, 1e-2, 1.5e-2])
@far_outside
def test_a_plate_within_the_strays_of_an_orientation(tmp_path, above):
    """No motion is free for such deviations beside a plate that the cart reaches with one of them."""
    case, off, _ = orientation_off(tmp_path, [0.0, 1.0, 0.0])
    robot, cart = case.robot, case.robot.link_names.index("cart")
    Q = case.course[1] + off * np.random.default_rng(0).choice([-1.0, 1.0], (100, robot.dof))
    Q[:, robot._quaternions["base"]] /= np.linalg.norm(Q[:, robot._quaternions["base"]], axis=1, keepdims=True)
    low = robot.forward_kinematics(Q)[:, cart, 1, 3].min() - 0.05
    scene = Scene()
    scene.add("plate", Body.box([20.0, 1e-4, 20.0]), translation(0.0, low + above, 0.0))
    checker = CollisionChecker(robot, scene)
    assert checker.collide(Q).any()
    assert checker.certify_edges(*case.course).verdict == FREE
    assert checker.certify_edges(*case.course, joint_error=off).verdict != FREE


# -- mutants of the bounds ----------------------------------------------------------------------


class Sample(NamedTuple):
    """An interval and a view in it, with the least gap met, on the course alone if `off` is 0."""

    case: Any
    view: Any
    times: Any
    off: Any
    least: float


@pytest.fixture(scope="module", params=quick(1, 4))
def samples(request, tmp_path_factory):
    """Samples of the law of strays with fixed seeds, for random robots and small ones, in wide and narrow intervals."""
    made = []
    for number, (degree, wide) in enumerate(product((1, 3), (False, True))):
        for seed in range(request.param):
            rng, checker = mixed(tmp_path_factory.mktemp("robot"), seed)
            add_samples(made, checker, rng, seed, degree, wide)
        rng = np.random.default_rng(number)
        for name in MACHINES:
            scene = Scene()
            scene.add("post", Body.box([0.1, 0.1, 0.1]), pose(rng, 0.5))
            checker = CollisionChecker(machine(MACHINES[name][0]), scene, skip_adjacent=False)
            add_samples(made, checker, rng, number, degree, wide, 0.5)
    return made


def add_samples(made, checker, rng, seed, degree, wide, large=0.0):
    for case, a, b in cases(checker, rng, seed, degree, 2, wide):
        off = np.zeros(case.robot.dof) if wide else deviations(rng, case.robot.dof) + large
        taken = strayed(case, rng, a, b, off, 40 if wide else 8)
        for view in views(case, rng, 5):
            made.append(Sample(case, view, eight(a, b), off, least_gap(case, view, taken, off)[0]))


def joints_of_the_other_side(case, view):
    """Joints between the two links that move the other body."""
    start, path = case.tables.path_start, case.tables.path_link
    up = path[start[view.link] : start[view.link + 1]].tolist()
    down = path[start[view.fixed] : start[view.fixed + 1]].tolist() if view.fixed >= 0 else []
    return [k for k in down if k not in up]


def as_it_is(one):
    return told(one.case, one.view, one.times, one.off)


def without_the_chord(one):
    """A w² / 8 left out."""
    return told(one.case, one.view, one.times, one.off, chord=0.0)


def without_second_order(one):
    return told(one.case, one.view, one.times, one.off, second=0.0)


def without_the_other_side(one):
    """The joints of the other body do not stray."""
    strays = strays_of(one.case, one.off)
    for joint in joints_of_the_other_side(one.case, one.view):
        strays.turn[joint] = strays.slide[joint] = 0.0
    return told(one.case, one.view, one.times, one.off, strays=strays)


def changed(change):
    return lambda one: told(one.case, one.view, one.times, one.off, change=change)


def without_slides(planes, count):
    """The rest, which is the same for all points, left out."""
    rest = planes[:8].copy()
    planes[:16] -= np.tile(rest, 2)


def without_constants(planes, count):
    """The constants of the functions left out, for hulls of few vertices."""
    planes.reshape(-1, 8)[5 : 2 + 4 * count : 4] = 0.0


def without_one_joint(planes, count):
    """The last joint that turns left out, likewise."""
    planes.reshape(-1, 8)[2 + 4 * (count - 1) : 2 + 4 * count] = 0.0


def without_whole(planes, count):
    """What joints that turn do to curved pieces left out."""
    planes[8:16] = planes[:8]


def with_half_of_each(planes, count):
    planes *= 0.5


def refuted_by(samples, mutant, most=None):
    """How many samples refute a mutant, up to a number with which it is refuted."""
    return sum(1 for _ in islice((one for one in samples if one.least < mutant(one) - 1e-9), most))


@far_outside
def test_bounds_as_they_are(samples):
    """None of the samples that refute the mutants refutes the bound itself."""
    assert len(samples) > 100
    assert refuted_by(samples, as_it_is) == 0


@pytest.mark.parametrize(
    "mutant",
    [
        without_the_chord, without_second_order, without_the_other_side, without_slides, without_constants,
        without_one_joint, without_whole, with_half_of_each,
    ],
    ids=lambda mutant: mutant.__name__,
)  # fmt: skip
@far_outside
def test_mutants_of_the_bound_are_noticed(samples, mutant):
    """The law of strays would fail if a part of the bound were left out."""
    change = mutant.__code__.co_varnames[0] == "planes"
    assert refuted_by(samples, changed(mutant) if change else mutant, most=2) == 2


def test_a_remainder_of_nothing_is_noticed(tmp_path):
    """Strays do exceed their chords between configurations, by a good part of what is added."""
    case = two_arms(tmp_path, np.polynomial.Polynomial([0.0, 6.0]), np.polynomial.Polynomial([0.0]))
    left, right = (case.ready.names.index(name) for name in ("left", "right"))
    view, strays = view_of(case, right, left, [1.0, 0.0, 0.0]), strays_of(case, np.array([0.02, 0.0]))
    excess, added = excess_between(case, view, eight(0.0, 1.0), strays, np.zeros(3))
    print(f"share {excess / added:.3f}")
    assert excess > 0.1 * added


# -- proofs that rest on the bounds -------------------------------------------------------------


def machine(joints):
    """A robot of joints given as name, parent, child, kind, origin along x, and axis; the link `ball` has a sphere."""
    tags = "".join(
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/><origin xyz="{x} 0 0"/>'
        f'<axis xyz="{axis}"/><limit lower="-3" upper="3"/></joint>'
        for name, parent, child, kind, x, axis in joints
    )
    links = "".join(f'<link name="{name}"/>' for name in {"base": 0, **{joint[2]: 0 for joint in joints}})
    robot = Robot.from_urdf(text=f'<robot name="m">{links}{tags}</robot>')
    return replace(robot, bodies={"ball": Body.sphere(RADIUS).transformed(translation(1.0))})


# Robots with a ball 1 m from its last joint, the directions in which their values change, and the plate's link.
RADIUS = 0.05
MACHINES = {
    "sliding": ([("a", "base", "ball", "prismatic", 0, "1 0 0")], [0.8], "base"),
    "turning": ([("a", "base", "ball", "revolute", 0, "0 0 1")], [1.2], "base"),
    "elbow": (
        [("a", "base", "upper", "revolute", 0, "0 0 1"), ("b", "upper", "ball", "revolute", 0.7, "0 1 1")],
        [0.5, 0.6],
        "base",
    ),
    "against": (
        [("a", "base", "table", "revolute", 0, "0 0 1"), ("b", "base", "ball", "revolute", 0, "0 0 1")],
        [-0.7, 0.6],
        "table",
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", MACHINES)
def test_thin_plates_beyond_an_overshoot(name):
    """A curve that overshoots is free before a plate 0.1 mm thin, and not if the plate is within its reach."""
    joints, way, holder = MACHINES[name]
    robot, way, start = machine(joints), np.array(way), np.full(len(way), -0.3)
    curve = CubicHermiteSpline([0.0, 1.0], [start, start + way], [1.5 * way, -2.5 * way])
    turn = curve.derivative().roots(extrapolate=False)[0]
    at = float(turn[(turn > 0) & (turn < 1)].max())
    link, held = robot.link_names.index("ball"), robot.link_names.index(holder)

    def center(Q):
        poses = robot.forward_kinematics(Q)
        seen = np.linalg.inv(poses[:, held]) @ poses[:, link] @ [1.0, 0.0, 0.0, 1.0]
        return seen[:, :3]

    ends = center(curve(at) + np.array([[-1e-6], [0.0], [1e-6]]) * way)
    n = (ends[2] - ends[0]) / np.linalg.norm(ends[2] - ends[0])
    heights = center(curve(np.linspace(0, 1, 5001))) @ n
    assert heights.max() <= ends[1] @ n + 1e-12
    assert heights[[0, -1]].max() < ends[1] @ n - 0.01
    axes, _ = np.linalg.qr(np.column_stack([n, np.eye(3)]))
    T = np.eye(4)
    T[:3, :3] = axes[:, :3] * [1.0, 1.0, np.linalg.det(axes[:, :3])]
    for gap in (1e-3, 1e-4, 2e-5, 1.1e-5, 5e-6, -1e-6, -1e-5, -1e-4, -1e-3):
        T[:3, 3] = ends[1] + (RADIUS + gap + 5e-5) * n
        scene = Scene()
        scene.add("plate", Body.box([1e-4, 0.3, 0.3]), T)
        if holder != "base":
            scene.attach("plate", holder, T)
        found = CollisionChecker(robot, scene).certify_trajectory(curve).verdict
        if gap > 1e-5:
            assert found == FREE, gap
        elif gap > 0:
            assert found in (FREE, AMBIGUOUS)
        else:
            assert found != FREE, gap


def sampled_error(checker, a, b, weights, most, count):
    """An error of the joints with which a motion from a to b collides, near the least such; `most` if none is found."""
    signs = np.array(list(product((-1.0, 1.0), repeat=int((weights > 0).sum()))))
    corners = np.zeros((len(signs), len(weights)))
    corners[:, weights > 0] = signs * weights[weights > 0]
    Q, low, high = checker.robot.between(a, b, np.linspace(0.0, 1.0, count))[:, None], 0.0, most
    for _ in range(12):
        error = 0.5 * (low + high)
        hit = checker.collide((Q + error * corners).reshape(-1, len(weights))).reshape(len(Q), -1).any(axis=1)
        if hit.any():
            Q, high = Q[hit], error
        else:
            low = error
    return high


@pytest.mark.parametrize("seed", [0, *(pytest.param(k, marks=pytest.mark.verify) for k in range(1, 6))])
@pytest.mark.parametrize("count", quick(100, 400))
def test_proven_errors_against_sampled_ones(seed, count):
    """No proven error of the joints is above one with which a motion collides."""
    rng = np.random.default_rng(seed)
    robot = example("panda_description/urdf/panda.urdf", "panda_description/srdf/panda.srdf")
    checker = CollisionChecker(robot, ring(rng, 10, 0.4, 0.9, 0.25))
    Q = free_configurations(checker, 12, seed)
    ends = steps(robot, rng, Q, 0.5)
    free = checker.certify_edges(Q, ends).verdict == FREE
    weights = np.array(["finger" not in name for name in robot.configuration_names], dtype=float)
    shares = []
    for a, b in zip(Q[free], ends[free], strict=True):
        proven = checker.joint_error([a, b], weights=weights, most=0.5)
        sampled = sampled_error(checker, a, b, weights, 0.5, count)
        if sampled < 0.5:
            assert proven < sampled
            shares.append(proven / sampled)
    print(f"{len(shares)} motions, median of proven over sampled: {np.median(shares):.3f}, least {min(shares):.3f}")
    assert len(shares) >= 4
