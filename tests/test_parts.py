"""Surfaces in parts: proofs of motions among clouds, surfaces and solids, and what stays inside a solid all the way."""

from fractions import Fraction
from itertools import product
from operator import is_

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial import Delaunay

from families import translation
from gantry import RADIUS, gantry, gantry_robot
from loewner import Body, CollisionChecker, InputError, PlanningError, Robot, Scene, Verdict, planners
from loewner.bodies import layout, parts
from loewner.bodies.flat_faces import flat_faces
from loewner.ellipsoids.polytopes import Polytope
from loewner.planners.judge import Judge
from motion_oracle import assert_true, steps
from sampling import quick

FREE, COLLIDING = Verdict.FREE, Verdict.COLLIDING


@pytest.fixture
def machine(tmp_path):
    """A ball that slides along x and y, and a rod that turns beside it."""
    return gantry_robot(tmp_path)


def bumpy(rng, size=1.0):
    """A closed mesh that is not convex: a ball with dents, 1,280 triangles."""
    mesh = trimesh.creation.icosphere(subdivisions=3, radius=size)
    mesh.vertices *= 1 + 0.25 * np.sin(5 * mesh.vertices @ rng.normal(size=3) / size)[:, None]
    return mesh.vertices, mesh.faces


def shelf():
    """A cupboard without a front, as one surface: five walls of 2 x 2 x 0.6 m, of two triangles each."""
    box = trimesh.creation.box((2.0, 2.0, 0.6))
    middles = box.triangles_center
    return box.vertices, box.faces[middles[:, 1] > -0.9]


def kinds(rng):
    """Bodies about the origin, within which or in whose box the gantry fits."""
    return {
        "cloud": Body.from_cloud(np.array(shelf_points(rng)), radius=0.03),
        "open": Body.from_surface(shelf(), solid=False),
        "thick": Body.from_surface(shelf(), radius=0.02, solid=False),
        "solid": Body.from_surface(bumpy(rng, 0.4)),
        "terrain": Body.height_field(hills(), 0.1).transformed(translation(-1.15, -1.15, -0.25)),
    }


def hills():
    """Heights of 24 by 24 points, from -0.5 to 0.5."""
    x = np.linspace(0, 2.3, 24)
    return 0.5 * np.sin(4 * x)[:, None] * np.cos(3 * x)


def shelf_points(rng):
    vertices, faces = shelf()
    a, b, c = vertices[faces].transpose(1, 0, 2)
    u, v = np.sort(rng.uniform(size=(2, 300, len(faces), 1)), axis=0)
    return (a * u + b * (v - u) + c * (1 - v)).reshape(-1, 3)


# -- proofs ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["cloud", "open", "thick", "solid", "terrain"])
@pytest.mark.parametrize("count", quick(25, 60))
def test_motions_within_the_box_of_a_surface(machine, kind, rng, count):
    """None that is proven is refuted by 2,000 samples; each that collides does; and most are decided."""
    scene = Scene()
    scene.add("body", kinds(rng)[kind], translation(0.05, 0.02, 0.0))
    checker = CollisionChecker(machine, scene)
    Q = machine.random_configurations(300, 1)
    Q[:, :2] = rng.uniform(-0.95, 0.95, (300, 2))
    Q = Q[~checker.collide(Q)][:count]
    assert len(Q) >= 20
    verdicts = assert_true(checker, Q, steps(machine, rng, Q, 0.2))
    assert (verdicts == FREE).mean() > 0.2
    assert (verdicts == COLLIDING).any()


def test_what_begins_inside_a_solid_is_not_free(machine, rng):
    """Though it never meets the surface: the motion collides at its start, and the pair is named."""
    vertices, faces = bumpy(rng, 3.0)
    scene = Scene()
    scene.add("asteroid", Body.from_surface((vertices, faces)))
    checker = CollisionChecker(machine, scene)
    a, b = np.array([[-0.2, 0.1, 0.0]] * 3), np.array([[0.2, 0.1, 0.3]] * 3)
    found = checker.certify_edges(a, b)
    assert (found.verdict == COLLIDING).all()
    assert (found.fraction == 0.0).all()
    assert set(found.names[:, 1]) == {"asteroid"}
    assert checker.certify_edges(a[0], b[0]).names[1] == "asteroid"
    # The surface alone is empty: there the same motion is free.
    scene.remove("asteroid")
    scene.add("bubble", Body.from_surface((vertices, faces), solid=False))
    assert (checker.certify_edges(a, b).verdict == FREE).all()


@pytest.mark.parametrize("solid", [True, False])
def test_planners_inside_a_closed_surface(machine, rng, solid):
    """In a solid nothing is planned, shortened or blended; in the same surface without inside all of it is."""
    scene = Scene()
    scene.add("body", Body.from_surface(bumpy(rng, 3.0), solid=solid))
    checker = CollisionChecker(machine, scene)
    path = [[-0.2, -0.1, 0.0], [0.2, -0.1, 0.0], [0.2, 0.2, 0.3]]
    for call in (
        lambda: planners.plan(checker, path[0], path[2]),
        lambda: planners.shorten(checker, path),
        lambda: planners.trajectory(machine, path, velocity=1.0, acceleration=1.0, checker=checker),
    ):
        if solid:
            with pytest.raises((InputError, PlanningError), match="and body"):
                call()
        else:
            call()
    free = Judge.of(checker, 0.0).proven(np.stack([path[:-1], path[1:]], axis=1), np.full((2, 3), 1e-3))
    assert free.tolist() == [not solid] * 2


@pytest.mark.parametrize("solid", [True, False])
def test_links_that_stand_are_cut(tmp_path, rng, solid):
    """A surface that is fixed to the root, or attached to such a link, is as well proven as one in the scene."""
    mesh = trimesh.Trimesh(*(bumpy(rng, 0.4) if solid else shelf()))
    mesh.export(tmp_path / "body.stl")
    urdf, _ = gantry(tmp_path)
    hold = """<link name="stand"/><link name="body"><collision><geometry><mesh filename="body.stl"/></geometry>
    </collision></link><joint name="s" type="fixed"><parent link="base"/><child link="stand"/>
    <origin xyz="0.05 0.02 0"/></joint>
    <joint name="t" type="fixed"><parent link="stand"/><child link="body"/></joint></robot>"""
    (tmp_path / "held.urdf").write_text(urdf.read_text().replace("</robot>", hold))
    whole = Robot.from_urdf(urdf), Scene(), "body"
    linked = Robot.from_urdf(tmp_path / "held.urdf", meshes="surface"), Scene(), "body"
    attached = whole[0], Scene(), "held"
    body = Body.from_surface(tmp_path / "body.stl")
    whole[1].add("body", body, translation(0.05, 0.02, 0.0))
    attached[1].add("held", body)
    attached[1].attach("held", "base", translation(0.05, 0.02, 0.0))
    Q = whole[0].random_configurations(300, 1)
    Q[:, :2] = rng.uniform(-0.95, 0.95, (300, 2))
    found = []
    for robot, scene, name in (whole, linked, attached):
        checker = CollisionChecker(robot, scene, allowed=[("ball", "rod")])
        ready = checker._ready()
        assert ready.starts_matter == solid
        k = ready.names.index(name)
        assert np.diff(ready.in_parts.bodies._packed.piece_start)[k] > 4
        free = Q[~checker.collide(Q)][:60]
        found.append(assert_true(checker, free, steps(robot, np.random.default_rng(3), free, 0.2)))
    assert (found[0] == FREE).mean() > 0.4
    assert [(verdicts == FREE).sum() for verdicts in found[1:]] == [(found[0] == FREE).sum()] * 2


def test_a_plan_in_a_cupboard_of_one_mesh(machine):
    """From one corner to another, around a wall in the middle: proven, within the box of the surface."""
    vertices, faces = shelf()
    wall = trimesh.creation.box((0.05, 1.2, 0.6))
    wall.apply_translation([0.0, 0.4, 0.0])
    both = np.concatenate([vertices, wall.vertices]), np.concatenate([faces, wall.faces + len(vertices)])
    scene = Scene()
    scene.add("cupboard", Body.from_surface(both, solid=False))
    checker = CollisionChecker(machine, scene)
    path = planners.plan(checker, [-0.5, 0.5, np.pi], [0.5, 0.5, 0.0])
    assert (checker.certify_edges(path[:-1], path[1:]).verdict == FREE).all()
    assert path[:, 1].min() < -0.2 + RADIUS


@pytest.mark.parametrize("finer", [0, 2])
@pytest.mark.parametrize("turned", [False, True])
def test_no_part_hangs_over_an_opening(finer, turned, rng):
    """Boards go through each other, and their front edges lie in one plane: a part of all of these were a curtain."""
    boards = [((0.35, 0.8, 0.02), (0, 0, z)) for z in (-0.3, 0.0, 0.3)]
    boards += [((0.35, 0.02, 0.62), (0, y, 0)) for y in (-0.4, 0.0, 0.4)]
    boards += [((0.02, 0.8, 0.62), (0.175, 0, 0))]
    mesh = trimesh.util.concatenate([trimesh.creation.box(size).apply_translation(at) for size, at in boards])
    for _ in range(finer):
        mesh = mesh.subdivide()
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0] if turned else np.eye(3)
    body = Body.from_surface((mesh.vertices @ turn.T, mesh.faces), solid=False)
    (cut,) = parts.in_small_parts([body._packed])
    for i in cut.trees:
        corners, triangles = _part(cut, i)
        sides = np.ptp(corners @ turn, axis=0)
        a, b, c = corners[triangles].transpose(1, 0, 2)
        assert sides @ np.roll(sides, 1) < 2 * np.linalg.norm(np.cross(b - a, c - a), axis=1).sum()


def test_terrain_is_cut_where_its_surface_is():
    """Its sides and its base, which few triangles close, are in no box with the ground."""
    x = np.linspace(0, 2, 60)
    body = Body.height_field(0.1 * np.sin(7 * x)[:, None] * np.cos(6 * x), x[1], base=-2.0)
    (cut,) = parts.in_small_parts([body._packed])
    high = [np.ptp(vertices[:, 2]) for vertices, _ in (_part(cut, i) for i in cut.trees) if vertices[:, 2].max() > -1]
    sides = [height for height in high if height > 1]
    assert len(high) > 100
    assert len(sides) < 20


def _part(packed, i):
    """Vertices and triangles of a surface in a pack."""
    vertices = packed.points[packed.layout[i, 1] : packed.layout[i, 2]]
    return vertices, packed.triangles[packed.triangle_start[i] : packed.triangle_start[i + 1]]


def test_parts_follow_a_body_that_moves(machine, rng):
    """What was prepared is moved along; a body that is replaced is cut anew; links that hold one see it as it is."""
    scene = Scene()
    scene.add("body", Body.from_surface(bumpy(rng, 0.4)))
    checker = CollisionChecker(machine, scene)
    a = machine.random_configurations(100, 2)
    b = steps(machine, rng, a, 0.3)
    for at in (translation(0.0, 0.0), translation(0.6, 0.2), translation(-0.5, 0.1, 0.1)):
        scene.move("body", at)
        fresh = CollisionChecker(machine, scene)
        np.testing.assert_array_equal(checker.certify_edges(a, b).verdict, fresh.certify_edges(a, b).verdict)
    scene.remove("body")
    scene.add("body", Body.from_surface(bumpy(rng, 0.2)))
    fresh = CollisionChecker(machine, scene)
    np.testing.assert_array_equal(checker.certify_edges(a, b).verdict, fresh.certify_edges(a, b).verdict)


# -- the parts --------------------------------------------------------------------------------------


def test_parts_hold_each_triangle_once(rng):
    """Of all surfaces of bodies, also between other pieces; bodies without surfaces stay as they are."""
    vertices, faces = bumpy(rng)
    mixed = Body.union([Body.box([1, 1, 1]), Body.from_surface((vertices, faces)), Body.sphere(1.0)])
    packed = CollisionChecker(_lone(), _scene(mixed=mixed, cloud=Body.from_cloud(vertices, radius=0.1)))._ready()
    whole, cut = packed.bodies._packed, packed.in_parts.bodies._packed
    assert cut.piece_start.tolist() == [0, 1, 1 + 2 + parts.PARTS, 1 + 2 + 2 * parts.PARTS]
    assert sorted(_corners(whole).tolist()) == sorted(_corners(cut).tolist())
    assert np.unique(cut.frames[:, 0]).tolist() == [0.0, 0.1, 1.0]
    assert parts.in_parts(packed.packs)[0] is packed.packs[0]


CLOUDS = {
    "uniform": lambda rng: rng.uniform(size=(3000, 3)),
    "equal": lambda rng: np.ones((500, 3)),
    "many equal": lambda rng: np.repeat(rng.normal(size=(20, 3)), 50, axis=0),
    "on a line": lambda rng: rng.uniform(size=(700, 1)) * [1.0, 0.0, 0.0],
    "on a grid": lambda rng: np.stack(np.meshgrid(*[np.arange(9.0)] * 3), axis=-1).reshape(-1, 3),
    "few": lambda rng: rng.normal(size=(7, 3)),
    "far away": lambda rng: 1e5 + rng.normal(size=(900, 3)),
}


@pytest.mark.parametrize("cloud", CLOUDS)
def test_boxes_and_ellipsoids_hold_their_points(cloud, rng):
    """Each part of a cloud lies in its box and, with the radius, in its ellipsoid; each point is in one part."""
    points, radius = CLOUDS[cloud](rng), 0.01
    (cut,) = parts.in_small_parts([Body.from_cloud(points, radius=radius)._packed])
    sizes = np.diff(cut.triangle_start)
    assert sizes.min() > 0
    assert sizes.sum() == len(points)
    rounding = 1e-12 * np.abs(points).max()
    for i in range(len(sizes)):
        vertices, _ = _part(cut, i)
        box = cut.kernel.points[24 * i : 24 * i + 24].reshape(3, 8).T
        for side in box[[4, 2, 1]] - box[0]:
            length = np.linalg.norm(side)
            along = (vertices - box[0]) @ side / length if length > 1e3 * rounding else np.zeros(1)
            assert -10 * rounding <= along.min() <= along.max() <= length + 10 * rounding
        reach = np.linalg.norm(np.linalg.solve(cut.outer_factor[i], (vertices - cut.outer_center[i]).T), axis=0)
        assert reach.max() < 1.0


@pytest.mark.parametrize("shape", ["box", "ball", "thin", "flat", "edge", "far away", "needle"])
def test_hulls_of_parts_hold_their_corners(shape, rng):
    """None is outside the hull of the points that stand for its part, and these are few."""
    points = rng.normal(size=(400, 3))
    if shape != "box":
        points /= np.linalg.norm(points, axis=1)[:, None]
    widths = {"thin": [1.0, 1.0, 1e-6], "flat": [1.0, 1.0, 0.0], "edge": [1.0, 0.0, 0.0], "needle": [1.0, 1e-3, 1e-3]}
    points *= widths.get(shape, [1.0, 0.7, 0.4])
    turned = points @ np.linalg.qr(rng.normal(size=(3, 3)))[0] + 1e3 * (shape == "far away")
    box = np.array(list(product(*zip(turned.min(axis=0), turned.max(axis=0), strict=True))))
    found = parts._hull_around(turned, box)
    assert len(found) <= len(parts.WAYS)
    if shape in ("flat", "edge"):
        assert found is box
        return
    hull = Polytope.from_points(found)
    beyond = (turned @ hull.normals.T - hull.offsets).max()
    assert -1e-9 < beyond < 4 * np.spacing(np.abs(turned).max())


def test_no_part_holds_points_of_two_walls(rng):
    """However many points they have, although only some of these suggest the cut: it is between the walls."""
    points = np.tile(rng.uniform(size=(20000, 3)), (2, 1)) * [1.0, 1.0, 0.02]
    points[:20000, 2] += 0.3
    (cut,) = parts.in_small_parts([Body.from_cloud(points, radius=0.01)._packed])
    assert max(np.ptp(_part(cut, i)[0][:, 2]) for i in cut.trees) < 0.021


def test_many_surfaces_have_few_small_parts_each(monkeypatch):
    """For proofs that checkers read: all together no more than so many, and one more among many changes no other."""
    monkeypatch.setattr(parts, "ALL_PARTS", 40)
    mesh = bumpy(np.random.default_rng(0))
    packs = [Body.from_surface(mesh, solid=False)._packed for _ in range(4)]
    three, four = parts.in_small_parts(packs[:3]), parts.in_small_parts(packs)
    assert [len(pack.layout) for pack in four] == [8] * 4
    assert all(map(is_, three, four))
    monkeypatch.setattr(parts, "ALL_PARTS", 7)
    assert [len(pack.layout) for pack in parts.in_small_parts(packs)] == [parts.PARTS] * 4


def test_problems_made_of_others_are_as_made_anew(rng):
    """At other poses, in another order and of fewer pairs: with the parts that were made before, and none by chance."""
    vertices, faces = bumpy(rng)
    scene = _scene(solid=Body.from_surface((vertices, faces)), cloud=Body.from_cloud(vertices, radius=0.1))
    checker = CollisionChecker(_lone(), scene)
    before = checker._ready()
    assert before.cut is not None
    scene.move("cloud", translation(2.0, 0.0, 1.0))
    moved, anew = checker._ready(), CollisionChecker(_lone(), scene)._ready()
    assert moved.cut.packed is before.cut.packed
    for one, other in ((moved, anew), (moved.cut, anew.cut), (moved.only([1]), anew.only([1]))):
        for arrays in ("link", "balls", "pairs", "margins", "order"):
            assert np.array_equal(getattr(one, arrays), getattr(other, arrays))
        assert all(map(np.array_equal, (*one.robot.tree, *one.standing), (*other.robot.tree, *other.standing)))
    assert moved.only([1]).cut.pairs.tolist() == moved.pairs[[1]].tolist()
    ordered = moved.with_order(np.array([1, 0]))
    assert ordered.cut is moved.cut
    assert ordered.order.tolist() == [1, 0]
    assert ordered.hits is moved.hits


def _lone():
    robot = """<robot name="lone"><link name="base"/><link name="ball"><collision><geometry><sphere radius="0.1"/>
    </geometry></collision></link><joint name="x" type="prismatic"><parent link="base"/><child link="ball"/>
    <limit lower="-1" upper="1" effort="1" velocity="1"/></joint></robot>"""
    return Robot.from_urdf(text=robot)


def _scene(**bodies):
    scene = Scene()
    for name, body in bodies.items():
        scene.add(name, body)
    return scene


def _corners(packed):
    rows = packed.layout[:, 1]
    lengths = np.diff(packed.triangle_start)
    return packed.points[packed.triangles + np.repeat(rows, lengths)[:, None]].reshape(-1, 9)


def test_slivers_of_rounding_stay_whole():
    """A large surface with triangles too small for a piece of their own is not cut, and works all the same."""
    vertices, faces = trimesh.creation.box((1, 1, 1)).vertices, trimesh.creation.box((1, 1, 1)).faces
    tiny = np.array([[0, 0, 0], [1e-14, 0, 0], [0, 1e-14, 0]])
    speck = np.concatenate([vertices, *([tiny] * 4)])
    body = Body.from_surface((speck, np.concatenate([faces, 8 + np.arange(12).reshape(4, 3)])), solid=False)
    checker = CollisionChecker(_lone(), _scene(box=body))
    assert checker.certify_edges([-0.2], [0.0]).verdict != FREE


@given(st.integers(0, 2**32 - 1), st.booleans())
def test_boxes_around_surfaces_hold_their_points_exactly(seed, single):
    """However they are turned, stretched, and far from the origin; in exact arithmetic."""
    rng = np.random.default_rng(seed)
    points = rng.normal(size=(20, 3)) * 10.0 ** rng.uniform(-9, 3, 3)
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    points = points @ turn.T + rng.normal(size=3) * 10.0 ** rng.uniform(-3, 4)
    triangles = rng.integers(20, size=(30, 1 if single else 3)) * np.ones(3, dtype=int)
    corners = [[Fraction(x) for x in row] for row in layout._box_corners(points, triangles)]
    edges = [[corners[k][j] - corners[0][j] for j in range(3)] for k in (4, 2, 1)]
    for a, b in ((0, 1), (1, 2), (2, 0)):
        n = [edges[a][i] * edges[b][j] - edges[a][j] * edges[b][i] for i, j in ((1, 2), (2, 0), (0, 1))]
        along = [sum(x * y for x, y in zip(n, c, strict=True)) for c in corners]
        assert all(min(along) <= sum(x * Fraction(y) for x, y in zip(n, p, strict=True)) <= max(along) for p in points)


def test_boxes_around_tilted_walls_are_as_large_as_they(rng):
    """However a rectangle lies, and however its triangles do: as thin, as long and as wide."""
    inside = rng.uniform(0.01, [0.99, 0.29], (50, 2))
    flat = np.concatenate([[[0, 0], [1, 0], [1, 0.3], [0, 0.3]], inside])
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    corners = layout._box_corners(np.pad(flat, [(0, 0), (0, 1)]) @ turn.T, Delaunay(flat).simplices)
    assert np.allclose(np.ptp(corners @ turn, axis=0), [1, 0.3, 0], atol=1e-12)


def test_of_one_triangle_the_box_is_along_its_legs():
    """Boxes along all its edges have one area; that along the longest stands out over both others."""
    points = np.array([[0.0, 0, 0], [3, 0, 0], [0, 4, 0]])
    corners = layout._box_corners(points, np.array([[0, 1, 2]]))
    assert sorted(np.ptp(corners, axis=0).tolist()) == [0, 3, 4]


def test_flat_faces_are_those_of_the_shape():
    """However finely they are cut; of a shape without flat faces each triangle is one; what only touches is another."""
    box, ball = trimesh.creation.box((1, 2, 3)), trimesh.creation.icosphere(subdivisions=2)
    fine = box.subdivide().subdivide()
    two = trimesh.util.concatenate([box, box.copy().apply_translation([1, 0, 0])])
    for mesh, count in ((box, 6), (fine, 6), (ball, len(ball.faces)), (two, 12)):
        faces = flat_faces(mesh.vertices, mesh.faces)
        assert len(np.unique(faces)) == count
        for face in np.unique(faces):
            normals = mesh.face_normals[faces == face]
            assert np.allclose(normals, normals[0])


def test_flat_faces_end_where_neighbours_turn():
    """At a thousandth of a radian; triangles that lie on each other, and those without area, are no obstacle."""
    strip = np.array([[0, 0, 0], [0, 1, 0], [1, 0, 0], [1, 1, 0], [2, 0, 0.0], [2, 1, 0.0]])
    triangles = np.array([[0, 2, 1], [1, 2, 3], [2, 4, 3], [3, 4, 5], [5, 4, 3], [0, 0, 2]])
    for slope, count in ((0.5e-3, 1), (2e-3, 2)):
        strip[4:, 2] = slope
        assert len(np.unique(flat_faces(strip, triangles))) == count


@pytest.mark.parametrize("faces", [0, 24, 288])
@pytest.mark.parametrize("every", quick(31, 7))
def test_a_triangle_that_is_a_point_is_a_part_as_well(faces, every):
    """Its corners coincide, so its ellipsoid has no extent; motions near the surface are proven nevertheless."""
    vertices, triangles = np.array([[0, 0, 1], [1, 0, 1], [0, 1, 1.0]]), np.array([[0, 1, 2]])
    if faces:
        made = trimesh.creation.icosphere(subdivisions=0 if faces == 24 else 2)
        vertices, triangles = made.vertices, made.faces
    urdf = (
        '<robot name="r"><link name="base"/><link name="l"><collision><geometry><sphere radius="0.1"/></geometry>'
        '</collision></link><joint name="j" type="prismatic"><parent link="base"/><child link="l"/>'
        '<axis xyz="1 0 0"/><limit lower="-1" upper="5"/></joint></robot>'
    )
    robot = Robot.from_urdf(text=urdf)
    for vertex in range(0, len(vertices), every):
        body = Body.from_surface((vertices, np.append(triangles, [[vertex] * 3], axis=0)))
        scene = Scene()
        scene.add("surface", body, translation(x=3.0))
        checker = CollisionChecker(robot, scene)
        assert checker.certify_edges([-1.0], [0.5]).verdict == Verdict.FREE
        assert np.isfinite(checker.clearance([0.0]))
