"""Swept volumes: what links pass is inside, at real times and in extended precision; nothing sticks out farther."""

import warnings
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from scipy.interpolate import CubicSpline
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation, Slerp

import loewner
from checker_oracle import random_robot, robot_of, simple_bodies
from families import rotations, translation
from loewner import (
    Body,
    CollisionChecker,
    GeometryError,
    InputError,
    Joint,
    Robot,
    Scene,
    UnknownNameError,
    cli,
    planners,
)
from loewner._native import entries
from loewner.robots import swept
from loewner.robots.proofs.courses import straight
from loewner.robots.proofs.curves import curve_of
from motion_oracle import AFLOAT, FINGERS, example, points_of, real_poses, written
from motion_oracle import rates as measured_rates
from sampling import quick

# A box between 0.3 and 0.5 m from the axis about which it turns.
TURNTABLE = """<robot name="turntable"><link name="base"/><link name="arm"><collision><origin xyz="0.4 0 0"/>
<geometry><box size="0.2 0.04 0.1"/></geometry></collision></link>
<joint name="turn" type="continuous"><parent link="base"/><child link="arm"/><axis xyz="0 0 1"/></joint></robot>"""
HALF = np.array([0.1, 0.02, 0.05])


def outside(body: Body, points: np.ndarray) -> np.ndarray:
    """The points that are in no piece."""
    left = np.arange(len(points))
    for piece in body.pieces:
        low, high = piece.vertices.min(axis=0), piece.vertices.max(axis=0)
        near = left[((points[left] >= low) & (points[left] <= high)).all(axis=1)]
        inside = near[(points[near] @ piece.normals.T <= piece.offsets).all(axis=1)]
        left = np.setdiff1d(left, inside, assume_unique=True)
    return left


def on_surfaces(rng: np.random.Generator, body: Body, count: int) -> np.ndarray:
    """Points of a body: vertices, and points of inner ellipsoids."""
    found = []
    for piece in body.pieces:
        u = rng.normal(size=(count, 3))
        found.append(piece.inner.center + u / np.linalg.norm(u, axis=1, keepdims=True) @ piece.inner.factor.T)
        found.append(piece.inner.center[None] if piece.vertices is None else piece.vertices)
    points = np.concatenate(found)
    return points[rng.integers(0, len(points), count)]


def passed(rng, robot, courses, link, points) -> np.ndarray:
    """Where points of a link are, each at a random real time of random courses."""
    found = []
    for course in courses:
        T = real_poses(robot, course, rng.random(len(points)))[:, robot.link_names.index(link)]
        found.append(np.einsum("nij,nj->ni", T[:, :3, :3], points) + T[:, :3, 3])
    return np.concatenate(found).astype(np.float64)


def off_box(points: np.ndarray, angles: np.ndarray) -> np.ndarray:
    """The least distance of each point from the turntable's box at any of some angles."""
    least = np.full(len(points), np.inf)
    for a in angles:
        x = np.cos(a) * points[:, 0] + np.sin(a) * points[:, 1] - 0.4
        y = -np.sin(a) * points[:, 0] + np.cos(a) * points[:, 1]
        away = np.maximum(np.abs(np.column_stack([x, y, points[:, 2]])) - HALF, 0.0)
        least = np.minimum(least, np.linalg.norm(away, axis=1))
    return least


@pytest.mark.parametrize("seed", quick(*range(4)))
@pytest.mark.filterwarnings("ignore:.*is it in .*:UserWarning")
def test_points_of_random_links_are_inside(seed: int, tmp_path):
    """All kinds of joints and shapes, on straight paths and on cubics; also of a body that is carried."""
    rng = np.random.default_rng(seed)
    robot = random_robot(rng, tmp_path, 5, simple_bodies(rng))
    scene = Scene()
    scene.add("held", Body.box([0.1, 0.2, 0.05]))
    scene.attach("held", "l4", translation(0.1, 0.0, 0.2))
    Q = robot.random_configurations(3, seed=seed)
    Q = np.where(np.isfinite(Q), Q, 0.0)
    for at in robot._quaternions.values():
        Q[:, at] = Q[:1, at] + rng.normal(size=(3, 4)) * 0.1
        Q[:, at] /= np.linalg.norm(Q[:, at], axis=1)[:, None]
    curve = CubicSpline([0.0, 1.0, 2.5], Q)
    for given, courses in ((Q, straight(robot, Q[:-1], Q[1:])), (curve, curve_of(robot, curve, "curve").courses)):
        body = robot.swept(given, scene=scene, tolerance=0.1)
        assert 0 < body.covering.max_protrusion <= 0.1
        for name, link in robot.bodies.items():
            assert len(outside(body, passed(rng, robot, courses, name, on_surfaces(rng, link, 1000)))) == 0
        corners = on_surfaces(rng, scene["held"], 500) + [0.1, 0.0, 0.2]
        assert len(outside(body, passed(rng, robot, courses, "l4", corners))) == 0


def test_floating_and_planar_joints_are_swept_with_their_errors(tmp_path):
    """Each value may deviate from the curve by the joint errors."""
    bodies = {"hand": Body.box([0.1, 0.1, 0.3]), "cart": Body.sphere(0.1)}
    rng, robot = np.random.default_rng(0), replace(written(tmp_path, AFLOAT), bodies=bodies)
    q = np.array([0.0, 0.0, 0.5, 1.0, 0.0, 0.0, 0.0, 0.1, 0.2, 0.3, 0.4, 0.1])
    Q = np.stack([q, q + [0.3, 0.1, 0, 0, 0, 0, 0, 0.1, 0.2, 0.5, -0.6, -0.1]])
    Q[1, 3:7] = np.array([0.9, 0.1, 0.0, 0.2]) / np.linalg.norm([0.9, 0.1, 0.0, 0.2])
    off = np.full(12, 2e-3)
    off[3:7] = 0.0
    body = robot.swept(Q, joint_error=off, tolerance=0.05)
    for name in ("hand", "cart"):
        points = on_surfaces(rng, robot.bodies[name], 2000)
        for _ in range(10):
            ends = straight(robot, Q[:1] + rng.choice([-1, 1], 12) * off, Q[1:] + rng.choice([-1, 1], 12) * off)
            assert len(outside(body, passed(rng, robot, ends, name, points))) == 0
    assert robot.swept(Q, tolerance=0.05).covering.max_protrusion <= 0.05
    with pytest.raises(InputError, match="tolerance: expected more than"):
        robot.swept(Q, joint_error=0.1 * (off > 0), tolerance=0.05)


@pytest.mark.parametrize("tolerance", [0.2, 0.01, *(pytest.param(k, marks=pytest.mark.verify) for k in (0.05, 1e-3))])
@pytest.mark.parametrize("count", quick(6_000, 25_000))
def test_turns_fill_a_ring_and_no_more(tolerance: float, count: int, tmp_path):
    """A box that turns sweeps part of a ring; no point of the body's surface is farther from it than stated."""
    rng, robot = np.random.default_rng(1), written(tmp_path, TURNTABLE)
    body = robot.swept([[0.0], [2.5]], tolerance=tolerance)
    points = rng.uniform(-HALF, HALF, (count, 3)) + [0.4, 0.0, 0.0]
    assert len(outside(body, passed(rng, robot, straight(robot, np.zeros((1, 1)), np.full((1, 1), 2.5)), "arm",
                                    points))) == 0  # fmt: skip
    corners = np.concatenate([piece.vertices[piece.triangles] for piece in body.pieces])
    corners = corners[rng.integers(0, len(corners), 1000)]
    found = off_box(
        (rng.dirichlet([0.5] * 3, 1000)[..., None] * corners).sum(axis=1), np.linspace(0.0, 2.5, 3001)
    ).max()
    assert found - 2.5 / 3000 * 0.5 < body.covering.max_protrusion <= tolerance
    assert found > 0.1 * body.covering.max_protrusion  # the bound is of some use


def test_slides_are_prisms(tmp_path):
    """A straight slide is one hull for each piece, however many rows the path has, and grows by next to nothing."""
    robot = written(tmp_path, FINGERS)
    bodies = [robot.swept(np.linspace(0.0, 0.1, rows)[:, None], tolerance=0.01) for rows in (2, 51)]
    for body in bodies:
        assert len(body.pieces) == 2
        assert body.covering.max_protrusion < 1e-5
        spans = np.sort([np.ptp(piece.vertices, axis=0) for piece in body.pieces], axis=0)
        np.testing.assert_allclose(spans, [[0.2, 0.02, 0.05]] * 2, atol=2e-5)


@pytest.mark.parametrize("count", quick(5_000, 20_000))
def test_solids_are_swept_with_their_inside(count: int, tmp_path):
    """A thick tube that turns: points within its wall are inside, and its bore is left open where it stays so."""
    mesh = trimesh.creation.annulus(0.1, 0.2, 0.3)
    solid = Body.from_surface((mesh.vertices, mesh.faces))
    robot = robot_of(tmp_path, [("revolute", 0, '<axis xyz="0 0 1"/><limit lower="-2" upper="2"/>')], {"l1": solid})
    body = robot.swept([[0.0], [1.0]], tolerance=0.04)
    rng = np.random.default_rng(2)
    angle, radius = rng.uniform(0, 2 * np.pi, count), rng.uniform(0.1, 0.195, count)
    points = np.column_stack([radius * np.cos(angle), radius * np.sin(angle), rng.uniform(-0.15, 0.15, count)])
    courses = straight(robot, np.zeros((1, 1)), np.ones((1, 1)))
    assert len(outside(body, passed(rng, robot, courses, "l1", points))) == 0
    assert not loewner.collide(body, None, Body.sphere(0.05), None)


@pytest.mark.parametrize(("radius", "tolerance"), [(0.01, 0.04), (0.03, 0.05), (1e-7, 0.05)])
def test_clouds_are_swept(radius: float, tolerance: float, tmp_path, monkeypatch):
    """All balls of a carried cloud are inside, and corners are near one; without the balls, some points are out."""
    rng, robot, scene = np.random.default_rng(3), written(tmp_path, TURNTABLE), Scene()
    points = np.concatenate([rng.uniform(-0.1, 0.1, (20, 3)), [[0.3, 0.0, 0.0]], rng.normal(size=(5, 3)) * 1e-3])
    scene.add("seen", Body.from_cloud(points, radius=radius))
    scene.attach("seen", "arm", translation(0.5, 0.0, 0.0))
    body = robot.swept([[0.0], [0.5]], scene=scene, links="seen", tolerance=tolerance)
    assert body.covering.max_protrusion <= tolerance
    course = straight(robot, np.zeros((1, 1)), np.full((1, 1), 0.5))
    u = rng.normal(size=(2000, 3))
    within = points[rng.integers(0, len(points), 2000)] + radius * u / np.linalg.norm(u, axis=1)[:, None]
    assert len(outside(body, passed(rng, robot, course, "arm", within + [0.5, 0.0, 0.0]))) == 0
    corners, angles = np.concatenate([piece.vertices for piece in body.pieces]), np.linspace(0.0, 0.5, 101)
    centers = np.concatenate(
        [
            (points + [0.5, 0.0, 0.0]) @ np.array([[np.cos(a), np.sin(a), 0], [-np.sin(a), np.cos(a), 0], [0, 0, 1]])
            for a in angles
        ]
    )
    away = KDTree(centers).query(corners)[0] - radius
    assert away.max() <= body.covering.max_protrusion + 0.5 / 100 * 0.9
    grown = swept._grown_ball
    monkeypatch.setattr(swept, "_grown_ball", lambda radius, room: grown(radius / 100, room))
    body = robot.swept([[0.0], [0.5]], scene=scene, links="seen", tolerance=tolerance)
    lost = len(outside(body, passed(rng, robot, course, "arm", within + [0.5, 0.0, 0.0])))
    assert (lost > 0) == (radius > 1e-3)  # the smallest balls are within the growth for chords


def test_one_body_is_swept_by_a_floating_joint():
    """A body at poses, straight in position and turning at a constant rate between them, as the page shows."""
    rng, rod = np.random.default_rng(4), Body.box([0.4, 0.05, 0.1])
    free = Robot.from_links({"world": None, "rod": rod}, [Joint("free", "floating", "world", "rod")])
    poses = np.array([[0, 0, 0, 1, 0, 0, 0], [0.3, 0, 0.2, 0.8, 0.6, 0, 0], [0.5, 0.4, 0.2, 0.6, 0, 0.8, 0]])
    zone = free.swept(poses, tolerance=0.02)
    assert zone.covering.max_protrusion <= 0.02
    courses = straight(free, poses[:-1], poses[1:])
    points = rng.uniform(-0.5, 0.5, (5000, 3)) * [0.4, 0.05, 0.1]
    assert len(outside(zone, passed(rng, free, courses, "rod", points))) == 0
    for start, end in zip(poses[:-1], poses[1:], strict=True):  # SciPy's motion, too
        f = rng.uniform(0.0, 1.0, 2000)
        turns = Slerp([0, 1], Rotation.from_quat(np.stack([start, end])[:, [4, 5, 6, 3]]))(f)
        points = turns.apply(rng.uniform(-0.5, 0.5, (2000, 3)) * [0.4, 0.05, 0.1])
        assert len(outside(zone, points + start[:3] + f[:, None] * (end - start)[:3])) == 0


@pytest.mark.filterwarnings("ignore:.*is it in degrees:UserWarning")
def test_wrong_arguments_are_refused(tmp_path):
    """Each message names the argument."""
    robot = written(tmp_path, TURNTABLE)
    path = [[0.0], [1.0]]
    for options in ({"tolerance": 0.0}, {"tolerance": np.nan}, {"links": []}, {"joint_error": -1.0}, {"scene": 3}):
        (name,) = options
        with pytest.raises(InputError, match=name):
            robot.swept(path, **options)
    with pytest.raises(UnknownNameError, match="hand"):
        robot.swept(path, links=["arm", "hand"])
    for wrong in ([], [[0.0]], [[np.nan], [0.0]], None, 3):
        with pytest.raises(InputError):
            robot.swept(wrong)
    with pytest.raises(InputError, match="divide the curve, or raise the tolerance"):
        robot.swept([[0.0], [1e6]], tolerance=1e-5)
    with pytest.raises(InputError, match="tolerance: expected more than"):
        robot.swept([[0.0], [1e-3]], tolerance=1e-8)


def test_bounds_are_those_of_proofs_of_motions(tmp_path):
    """What the entry returns is what the proof of motions computes."""
    rng = np.random.default_rng(4)
    robot = random_robot(rng, tmp_path, 6, simple_bodies(rng)[:3])
    checker = CollisionChecker(robot)
    ready, a, b = checker._ready(), rng.uniform(-1, 1, robot.dof), rng.uniform(-1, 1, robot.dof)
    for at in robot._quaternions.values():
        a[at], b[at] = [1.0, 0.0, 0.0, 0.0], [np.cos(0.1), np.sin(0.1), 0.0, 0.0]
    course, bounds = straight(robot, a[None], b[None]), np.empty((1, len(ready.link), 4))
    entries.course_bounds(ready.handle, ready.handle_of_motions, course, np.zeros((1, robot.dof)), bounds)
    _, rates, error = measured_rates(checker, course[0])
    assert (bounds[0, :, 2] == 0).all()
    assert (bounds[0, :, 3] >= error).all()
    _, points = points_of(checker)
    w = 1e-4
    poses = real_poses(robot, course[0], [0.5 - w, 0.5, 0.5 + w])
    for body, link in enumerate(ready.link):
        x = np.einsum("kij,nj->kni", poses[:, link, :3, :3], points[body]) + poses[:, link, None, :3, 3]
        bend = np.linalg.norm((x[0] - 2 * x[1] + x[2]).astype(float), axis=1).max() / w**2
        assert bend <= bounds[0, body, 0] * (1 + 1e-3) + 1e-6


# -- mutants ----------------------------------------------------------------------------------


def misses(robot: Robot) -> int:
    """How many points of the turntable are outside what it sweeps."""
    rng = np.random.default_rng(5)
    body = robot.swept([[0.0], [2.5]], tolerance=0.05)
    points = rng.choice([-1.0, 1.0], (5000, 3)) * HALF + [0.4, 0.0, 0.0]
    return len(
        outside(body, passed(rng, robot, straight(robot, np.zeros((1, 1)), np.full((1, 1), 2.5)), "arm", points))
    )


def test_mutant_without_curvature_is_caught(tmp_path, monkeypatch):
    """Points are outside if chords count as the curve."""
    robot = written(tmp_path, TURNTABLE)
    assert misses(robot) == 0

    def none(problem, tables, courses, off, bounds):
        bounds[:] = 0.0

    monkeypatch.setattr(entries, "course_bounds", none)
    monkeypatch.setattr(swept, "_diameter", lambda points: 0.0)
    assert misses(robot) > 0


def test_mutant_without_growth_is_caught(tmp_path, monkeypatch):
    """Points are outside if hulls do not grow by the distances between knots and chords."""
    made = swept._Element
    monkeypatch.setattr(swept, "_Element", lambda p, i, j, growth, grown, out: made(p, i, j, 0.0, 1e-6, out))
    assert misses(written(tmp_path, TURNTABLE)) > 0


def test_mutant_with_half_the_growth_refuses_its_own_hulls(tmp_path, monkeypatch):
    """Each hull is proven to reach as far as it has to."""
    monkeypatch.setattr(swept, "OCTAHEDRON", swept.OCTAHEDRON / 2)
    with pytest.raises(GeometryError, match="falls short"):
        written(tmp_path, TURNTABLE).swept([[0.0], [2.5]], tolerance=0.05)


@pytest.mark.parametrize("count", quick(3, 8))
def test_lids_and_flat_cones_are_swept(count: int, tmp_path):
    """Their extreme points lie in the plane of the rim, and the apex comes as well."""
    turns = rotations(np.random.default_rng(0), count)
    angles = np.linspace(0, 2 * np.pi, 30, endpoint=False)
    rim = np.stack([0.3 * np.cos(angles), 0.3 * np.sin(angles), 0 * angles], axis=1)
    lid = np.concatenate([rim, [[0, 0, 0.03]]])
    for turn in turns:
        T = np.eye(4)
        T[:3, :3] = turn
        for body in (Body.from_points(lid @ turn.T), Body.cone(0.3, 0.03).transformed(T)):
            robot = loewner.Robot.from_links(
                {"base": None, "lid": body}, [loewner.Joint("turn", "revolute", "base", "lid", lower=-2, upper=2)]
            )
            assert robot.swept([[0.0], [0.5]], tolerance=0.05).covering.exact


# -- files ------------------------------------------------------------------------------------


def test_files_hold_the_body(tmp_path, capsys):
    """An STL file has the triangles of all pieces, bit for bit, and an .npz file the body with its covering."""
    robot, path = written(tmp_path, TURNTABLE), tmp_path / "path.csv"
    path.write_text("turn\n0.0\n1.0\n")
    body = robot.swept([[0.0], [1.0]], tolerance=0.02)
    assert cli.main(["swept", str(robot.urdf), str(path), "--tolerance", "0.02", "-o", str(tmp_path / "a.stl")]) == 0
    assert f"{len(body.pieces)} pieces" in capsys.readouterr().out
    vertices, triangles = loewner.meshes.load(tmp_path / "a.stl")
    wanted = np.concatenate([piece.vertices[piece.triangles] for piece in body.pieces])
    np.testing.assert_array_equal(vertices[triangles], wanted)
    assert Body.from_surface(tmp_path / "a.stl").pieces[0].kind == "solid"
    assert cli.main(["swept", str(robot.urdf), str(path), "--tolerance", "0.02", "-o", str(tmp_path / "a.npz")]) == 0
    loaded = Body.load(tmp_path / "a.npz")
    assert (loaded.covering.kind, loaded.covering.exact) == ("swept", True)
    assert loaded.covering.max_protrusion == body.covering.max_protrusion
    assert cli.main(["swept", str(robot.urdf), str(path), "-o", str(tmp_path / "a.obj")]) == 2
    assert "expected a .stl or .npz file" in capsys.readouterr().err


def test_the_command_names_values_that_the_file_lacks(tmp_path, capsys):
    """As the audit does: the body is of the robot's default for a joint without a column."""
    (tmp_path / "r.urdf").write_text(
        """<robot name="r"><link name="a"/><link name="b"><collision><geometry><box size="0.4 0.1 0.1"/></geometry>
        </collision></link><link name="c"><collision><geometry><sphere radius="0.1"/></geometry></collision></link>
        <joint name="j1" type="revolute"><parent link="a"/><child link="b"/><axis xyz="0 0 1"/>
        <limit lower="-2" upper="2" velocity="1" effort="1"/></joint>
        <joint name="j2" type="revolute"><parent link="b"/><child link="c"/><origin xyz="0.3 0 0"/><axis xyz="0 0 1"/>
        <limit lower="-2" upper="2" velocity="1" effort="1"/></joint></robot>"""
    )
    (tmp_path / "m.csv").write_text("time,j1\n0,0\n0.5,0.3\n1,1\n")
    words = ["swept", str(tmp_path / "r.urdf"), str(tmp_path / "m.csv"), "--tolerance", "0.05"]
    assert cli.main([*words, "-o", str(tmp_path / "a.npz")]) == 0
    out = capsys.readouterr().out
    assert "curve     linear between the points of the file" in out
    assert "assumed   j2 = 0: the file has no values of it" in out


def test_stl_files_are_of_bodies_that_triangles_bound(tmp_path):
    """Surfaces with a radius are refused, and other suffixes."""
    with pytest.raises(InputError, match="with a radius"):
        Body.from_cloud(np.eye(3), radius=0.1).to_stl(tmp_path / "a.stl")
    with pytest.raises(InputError, match="ends in .stl"):
        Body.box([1, 1, 1]).to_stl(tmp_path / "a.obj")
    Body.union([Body.box([1, 1, 1]), Body.sphere(1.0)]).to_stl(tmp_path / "a.stl")
    assert len(trimesh.load(tmp_path / "a.stl").faces) == 12 + 1280


def test_trajectories_are_swept(tmp_path):
    """A trajectory of a planner, with blends and its own times."""
    robot = written(tmp_path, FINGERS)
    moves = planners.trajectory(robot, [[0.0], [0.1], [0.05]], velocity=0.5, acceleration=1.0)
    body = robot.swept(moves, links="left")
    assert body.covering.max_protrusion < 0.01
    assert loewner.collide(body, None, robot.bodies["left"], translation(0.1, 0.0, 0.0))


@pytest.mark.verify
@pytest.mark.parametrize("tolerance", [0.05, 0.01])
def test_a_million_points_of_an_arm_are_inside(tolerance: float):
    """All links of the Panda on a spline, a million points in extended precision; vertices stick out as stated."""
    rng = np.random.default_rng(6)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        robot = example("panda_description/urdf/panda.urdf", "panda_description/srdf/panda.srdf")
    curve = CubicSpline([0.0, 1.0, 2.0, 3.0], robot.random_configurations(4, seed=1))
    body, courses = robot.swept(curve, tolerance=tolerance), curve_of(robot, curve, "curve").courses
    each = 1_000_000 // (len(courses) * len(robot.bodies)) + 1
    for name, link in robot.bodies.items():
        assert len(outside(body, passed(rng, robot, courses, name, on_surfaces(rng, link, each)))) == 0
