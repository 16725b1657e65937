"""How far pieces stick out of a mesh: a proven bound beside samples; closed parts; pieces within a tolerance."""

import functools
import itertools
import sys
from types import SimpleNamespace

import numpy as np
import pytest
import trimesh

import loewner
from families import translation
from loewner import InputError
from loewner.ellipsoids.polytopes import Polytope
from loewner.meshes import decomposition as meshes
from loewner.meshes import plane_cuts
from loewner.meshes.closed_parts import closed_parts
from loewner.meshes.protrusion import Solid, _smaller, protrusion_of_hulls, protrusions
from sampling import quick
from test_meshes import l_shape, surface_points, two_boxes

CAVITY_RADIUS, WALL, HEIGHT = 0.036, 0.004, 0.095


def ring():
    """A torus of few triangles."""
    return trimesh.creation.torus(1, 0.3, major_sections=12, minor_sections=8)


@functools.cache
def pieces_within(make, tolerance):
    """Pieces of a mesh within a tolerance, what they cover, and the calls that report the progress."""
    told = []
    pieces, covering = meshes.convex_pieces(make(), tolerance=tolerance, progress=lambda *step: told.append(step))
    return pieces, covering, told


def mug(sections=32):
    """A mug of 80 mm and a handle in one mesh: closed parts that overlap."""
    wall = trimesh.creation.annulus(CAVITY_RADIUS, CAVITY_RADIUS + WALL, HEIGHT, sections=sections)
    floor = trimesh.creation.cylinder(CAVITY_RADIUS + WALL, WALL, sections=sections)
    floor.apply_translation([0, 0, (WALL - HEIGHT) / 2])
    handle = trimesh.creation.torus(0.025, 0.005, major_sections=sections * 3 // 4, minor_sections=sections * 3 // 8)
    handle.apply_transform(trimesh.transformations.rotation_matrix(np.pi / 2, [1, 0, 0]))
    return trimesh.util.concatenate([wall, floor, handle.apply_translation([0.067, 0, 0])])


def hollow_box():
    """A box of edge 2 with a cavity of edge 1 in its middle."""
    inner = trimesh.creation.box((1, 1, 1))
    inner.invert()
    return trimesh.util.concatenate([trimesh.creation.box((2, 2, 2)), inner])


def boxes_at(offset):
    """Two unit boxes, welded where they meet, as files of triangles are."""
    boxes = [trimesh.creation.box((1, 1, 1)), trimesh.creation.box((1, 1, 1)).apply_translation(offset)]
    mesh = trimesh.util.concatenate(boxes)
    mesh.merge_vertices()
    return mesh


def corners(mesh):
    return np.asarray(mesh.vertices, dtype=float)[np.asarray(mesh.faces)]


def sampled_protrusion(mesh, pieces, count=400):
    """Greatest distance of random points of the pieces, on and in them, from the solid: brute force, by trimesh."""
    rng = np.random.default_rng(0)
    points = np.concatenate(
        [
            *(surface_points(trimesh.convex.convex_hull(piece), count) for piece in pieces),
            *(rng.dirichlet(np.full(len(piece), 0.3), count) @ piece for piece in pieces),
        ]
    )
    distance = trimesh.proximity.closest_point_naive(mesh, points)[1]
    return float(np.where(turns(points, corners(mesh)) != 0, 0.0, distance).max())


def turns(points, triangles):
    """Winding numbers by solid angles (Van Oosterom and Strackee), point by point."""
    found = []
    for x in points:
        a, b, c = (triangles - x).transpose(1, 0, 2)
        la, lb, lc = (np.linalg.norm(v, axis=1) for v in (a, b, c))
        below = la * lb * lc + (a * b).sum(1) * lc + (b * c).sum(1) * la + (c * a).sum(1) * lb
        found.append(np.arctan2((a * np.cross(b, c)).sum(1), below).sum() / (2 * np.pi))
    return np.round(found).astype(int)


# -- distances ----------------------------------------------------------------------------------


@pytest.mark.parametrize("make", [l_shape, mug, hollow_box, ring])
@pytest.mark.parametrize("count", quick(100, 300))
def test_signed_distances(make, count):
    """Distances of random points, and which are inside, as brute force finds them."""
    mesh = make()
    low, high = mesh.bounds
    points = np.random.default_rng(1).uniform(low - 0.2 * (high - low), high + 0.2 * (high - low), (count, 3))
    found, nearest = Solid(corners(mesh), closed=True).signed_distances(points)
    expected = trimesh.proximity.closest_point_naive(mesh, points)[1]
    np.testing.assert_allclose(np.abs(found), expected, atol=1e-8 * mesh.scale)
    np.testing.assert_array_equal(found < 0, turns(points, corners(mesh)) != 0)
    alone = [
        Solid(corners(mesh)[[k]], closed=False).signed_distances(x[None])[0][0]
        for x, k in zip(points, nearest, strict=True)
    ]
    np.testing.assert_allclose(np.abs(found), alone, atol=1e-12 * mesh.scale)


def test_points_that_rays_meet_edges_from():
    """A ray through edges and corners of the mesh tells inside from outside all the same."""
    mesh = trimesh.creation.box((2, 2, 2))
    solid = Solid(corners(mesh), closed=True)
    up = np.array([0.017_320_508_07, 0.031_415_926_53, 1.0])
    aims = np.concatenate([mesh.vertices, mesh.vertices[mesh.edges].mean(axis=1)])
    points = (aims[:, None] - np.linspace(0.1, 3, 20)[:, None] * up).reshape(-1, 3)
    np.testing.assert_array_equal(solid.winding_numbers(points) != 0, (np.abs(points) < 1).all(axis=1))


# -- the bound ----------------------------------------------------------------------------------


def test_convex_mesh_does_not_stick_out():
    """Nothing sticks out of a convex mesh, whichever way its faces are cut into triangles."""
    for mesh in (trimesh.creation.box((1, 2, 3)), trimesh.creation.icosphere(3), trimesh.creation.cylinder(1, 2)):
        assert meshes.convex_pieces(mesh)[1].max_protrusion == 0


@pytest.mark.parametrize("scale", [1e-3, 1.0, 100.0])
def test_hull_of_an_l(scale):
    """The hull of an L sticks out by half an edge: the middle of its slope is so far from both walls."""
    covering = meshes.convex_pieces(l_shape(scale), decompose=False)[1]
    assert covering.max_protrusion == pytest.approx(0.5 * scale, rel=0.01)
    assert covering.max_protrusion >= 0.5 * scale


def test_cavities_are_filled_inside_of_a_piece():
    """The farthest point of a hull may lie within it: in the middle of a cavity."""
    covering = meshes.convex_pieces(hollow_box(), decompose=False)[1]
    assert 0.5 <= covering.max_protrusion <= 0.505 + 1e-9


def test_open_mesh_has_distance_from_its_surface():
    """Without a lid a box has no inside: the hull's points are as far as from its walls."""
    mesh = trimesh.creation.box((2, 2, 2))
    mesh.update_faces(mesh.triangles_center[:, 2] < 0.99)
    reached = meshes.convex_pieces(mesh, decompose=False)[1].max_protrusion
    assert 1 <= reached <= 1.01 + 1e-9


@pytest.mark.parametrize(
    "make", [l_shape, hollow_box, *(pytest.param(k, marks=pytest.mark.verify) for k in (mug, ring))]
)
def test_bound_is_above_samples_and_near(make):
    """No point of any piece is farther from the solid than the bound, and the bound is near what was found."""
    mesh = make()
    hull = Polytope.from_points(mesh.vertices)
    found = protrusions([hull], Solid(corners(mesh), closed=True))
    sampled = sampled_protrusion(mesh, [hull.vertices])
    assert sampled <= found.bounds[0]
    assert sampled <= found.found[0] * 1.001 + 1e-4 * mesh.scale
    assert found.found[0] <= found.bounds[0] <= max(found.found[0] * 1.01, found.found[0] + 1.01e-4 * mesh.scale)
    at_point = Solid(corners(mesh), closed=True).signed_distances(found.points)[0]
    np.testing.assert_allclose(at_point, found.found)


def test_hulls_of_parts_are_measured_apart():
    """What another part covers counts, so that parts in contact do not disturb each other."""
    parts = [corners(l_shape()), corners(trimesh.creation.box((1, 1, 1)).apply_translation([1.5, 1.5, 0.5]))]
    hulls = [Polytope.from_points(part.reshape(-1, 3)) for part in parts]
    assert protrusion_of_hulls(parts, hulls) == pytest.approx(0.5, rel=0.01)


# -- closed parts -------------------------------------------------------------------------------


@pytest.mark.parametrize("offset", [(1, 1, 0), (1, 0, 0), (1, 1, 1), (3, 0, 0)])
def test_boxes_that_meet(offset):
    """Two boxes that share an edge, a face or a corner are two closed convex parts, not one fat one."""
    mesh = boxes_at(offset)
    pieces, covering = meshes.convex_pieces(mesh)
    assert len(pieces) == 2
    assert (covering.kind, covering.exact, covering.max_protrusion) == ("convex", True, 0.0)
    assert covering.excess_volume == pytest.approx(0, abs=1e-12)


def test_overlapping_parts_have_a_volume():
    """Parts of a mug overlap: each is a solid of its own, and the volumes add up."""
    mesh = mug()
    parts = closed_parts(np.asarray(mesh.vertices), np.asarray(mesh.faces))
    assert len(parts) == 3
    assert sum(part.volume for part in parts) == pytest.approx(mesh.volume)


def test_cavity_belongs_to_the_part_around_it():
    """A part of negative volume is a cavity; what lies in the cavity is a part again."""
    stone = trimesh.creation.box((0.5, 0.5, 0.5))
    mesh = trimesh.util.concatenate([hollow_box(), stone])
    for faces in (mesh.faces, mesh.faces[:, ::-1]):
        parts = closed_parts(np.asarray(mesh.vertices), np.asarray(faces))
        assert sorted(part.volume for part in parts) == pytest.approx([0.125, 7.0])


def test_part_turned_inside_out():
    """A part of negative volume in no other part is turned back."""
    mesh = two_boxes()
    mesh.faces[12:] = mesh.faces[12:, ::-1]
    source = SimpleNamespace(vertices=mesh.vertices, faces=mesh.faces)
    _, covering = meshes.convex_pieces(source)
    assert covering.kind == "convex"
    assert covering.excess_volume == pytest.approx(0, abs=1e-12)


def test_open_surface_has_no_closed_parts():
    """A surface that ends somewhere, or changes its orientation, is not closed."""
    mesh = trimesh.creation.box((1, 1, 1))
    faces = np.array(mesh.faces)
    assert closed_parts(mesh.vertices, faces[1:]) is None
    faces[0] = faces[0, ::-1]
    assert closed_parts(mesh.vertices, faces) is None


# -- tolerance ----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("make", "tolerance", "count"),
    [
        *((l_shape, 0.02, 30), (ring, 0.2, 30)),
        *(
            pytest.param(make, tolerance, 100, marks=pytest.mark.verify)
            for make in (l_shape, hollow_box, ring)
            for tolerance in (0.2, 0.02)
        ),
    ],
)
def test_tolerance_is_kept(make, tolerance, count):
    """Pieces stick out by no more than was asked for, by the bound and by samples, and hold the surface."""
    mesh = make()
    pieces, covering, _ = pieces_within(make, tolerance)
    assert covering.exact
    assert covering.max_protrusion <= tolerance
    assert sampled_protrusion(mesh, pieces, count) <= covering.max_protrusion + 1e-12


@pytest.fixture(scope="module")
def mug_body():
    """The mug in pieces that stick out by at most 2 mm."""
    return loewner.Body.from_mesh(mug(), tolerance=0.002)


def test_tolerance_of_an_open_mesh():
    """The walls of a box without a lid become plates; what is in the box stays free."""
    mesh = trimesh.creation.box((2, 2, 2))
    mesh.update_faces(mesh.triangles_center[:, 2] < 0.99)
    with pytest.warns(UserWarning, match="mesh: has holes"):
        pieces, covering = meshes.convex_pieces(mesh, tolerance=0.1)
    assert len(pieces) == 5
    assert covering.exact
    assert covering.max_protrusion <= 0.1
    body = loewner.Body.from_pieces(pieces)
    assert not loewner.collide(body, None, loewner.Body.sphere(0.9), None)


@pytest.mark.parametrize("make", quick(trimesh.creation.box, l_shape))
def test_an_open_mesh_is_cut_with_planes(monkeypatch, make):
    """Without CoACD, to 2 % of its size; one warning names the mesh and what is exact."""
    monkeypatch.setitem(sys.modules, "coacd", None)
    mesh = make()
    mesh.update_faces(np.arange(len(mesh.faces)) != 5)
    with pytest.warns(UserWarning, match="mesh: has holes, .* may be FREE; .*--model surface") as told:
        _, covering = meshes.convex_pieces(mesh)
    assert len(told) == 1
    assert covering.exact
    assert covering.max_protrusion <= 0.02 * np.linalg.norm(mesh.extents)


@pytest.mark.verify
def test_work_on_an_open_mesh_is_limited(monkeypatch):
    """Where the limit is reached the pieces hold the mesh all the same, and stick out farther."""
    mesh = mug()
    mesh.update_faces(np.arange(len(mesh.faces)) != 7)
    monkeypatch.setattr(meshes, "WORK", 1_000_000)
    with pytest.warns(UserWarning, match="has holes"):
        pieces, covering = meshes.convex_pieces(mesh)
    assert covering.exact
    assert len(pieces) <= 1_000_000 / 22_000
    assert covering.max_protrusion > 0.02 * np.linalg.norm(mesh.extents)


def test_plates_in_one_plane_are_not_joined():
    """Cells whose common hull cannot be made stay as they are: here two plates that only rounding makes thick."""
    thin = np.array([[[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[1.1, 0, 0], [2, 0, 0], [1.1, 1, 0]]], dtype=float)
    solid = Solid(thin, closed=False)
    cells = [plane_cuts.replace(plane_cuts._cell(part[None], 1e-3), bound=0.0) for part in thin]
    flat = [
        plane_cuts.replace(cell, hull=plane_cuts.replace(cell.hull, vertices=part))
        for cell, part in zip(cells, thin, strict=True)
    ]
    assert plane_cuts._merged(flat, solid, 1.0, np.random.default_rng(0)) == flat


@pytest.mark.verify
def test_tolerance_of_a_mug(mug_body):
    """A ball in a mug is as far from the walls as the cavity says, to the tolerance."""
    mesh, body = mug(), mug_body
    assert body.covering.exact
    assert body.covering.max_protrusion <= 0.002
    assert not np.isnan(body.covering.excess_volume)
    assert len(body.pieces) <= 60
    assert sampled_protrusion(mesh, [piece.vertices for piece in body.pieces], 30) <= 0.002
    gap = float(loewner.distance(body, None, loewner.Body.sphere(0.001), None, exact=True).distance)
    true = CAVITY_RADIUS * np.cos(np.pi / 32) - 0.001
    assert true - 0.002 <= gap <= true + 1e-6


def test_tolerance_that_is_not_reached_is_told():
    """With too few pieces a warning says how near they came."""
    with pytest.warns(UserWarning, match=r"tolerance=0.01 m, found 1 that stick out by up to 0.5 m"):
        pieces, covering = meshes.convex_pieces(l_shape(), tolerance=0.01, max_pieces=1)
    assert len(pieces) == 1
    assert covering.max_protrusion > 0.01
    with pytest.warns(UserWarning, match="decompose=True"):
        meshes.convex_pieces(l_shape(), tolerance=0.01, decompose=False)


@pytest.mark.parametrize("most", [1, *(pytest.param(k, marks=pytest.mark.verify) for k in (2, 3, 7))])
def test_max_pieces_counts_all_parts(most):
    """Whether parts are decomposed apart or together, the limit is on all of their pieces."""
    mesh = trimesh.util.concatenate([l_shape(), l_shape(shift=3.0), l_shape(shift=6.0)])
    assert len(meshes.convex_pieces(mesh, max_pieces=most)[0]) <= most
    if most < 6:
        with pytest.warns(UserWarning, match="stick out"):
            assert len(meshes.convex_pieces(mesh, tolerance=0.01, max_pieces=most)[0]) <= most


@pytest.mark.parametrize("tolerance", [0, -1.0, np.nan, np.inf, "1", True])
def test_bad_tolerance(tolerance):
    """A tolerance is a positive length."""
    with pytest.raises(InputError, match="tolerance"):
        meshes.convex_pieces(l_shape(), tolerance=tolerance)


@pytest.mark.parametrize("tolerance", quick(0.2, 0.1))
def test_pieces_within_a_tolerance_need_no_coacd(monkeypatch, tolerance):
    """Cutting with planes is done here; and the same mesh gives the same pieces."""
    monkeypatch.setitem(sys.modules, "coacd", None)
    again = meshes.convex_pieces(ring(), tolerance=tolerance)[0]
    for a, b in zip(pieces_within(ring, tolerance)[0], again, strict=True):
        np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize("options", [{}, {"tolerance": 0.05}, {"decompose": False}])
def test_progress_ends_with_all(options):
    """Progress counts up to its total, which ends as it is."""
    told = []
    loewner.Body.from_mesh(l_shape(), progress=lambda done, total: told.append((done, total)), **options)
    assert told[-1][0] == told[-1][1]
    assert all(done <= total for done, total in told)
    with pytest.raises(InputError, match="progress"):
        loewner.Body.from_mesh(l_shape(), progress=3)


def test_progress_of_cuts_never_goes_back():
    """What is done, and its share of the total, grow from call to call."""
    told = pieces_within(ring, 0.2)[2]
    assert len(told) > 4
    for step, later in itertools.pairwise(told):
        assert step[0] <= later[0]
        assert step[0] / step[1] <= later[0] / later[1]


def test_covering_of_an_older_file(tmp_path):
    """A file of before `max_protrusion` loads, with NaN for not measured; what is saved now comes back."""
    from loewner.bodies import files

    body = loewner.Body.from_mesh(l_shape(), decompose=False)
    body.save(tmp_path / "l.npz")
    assert loewner.Body.load(tmp_path / "l.npz").covering == body.covering
    old = files._covering(["hull", "True", "0.0", "0.25", "12"])
    assert np.isnan(old.max_protrusion)
    assert old.samples == 12
    for last in ("-1.0", "inf", "much"):
        with pytest.raises(InputError, match="covering"):
            files._covering(["hull", "True", "0.0", "0.25", "12", last])


@pytest.mark.parametrize("sections", quick(12, 32))
@pytest.mark.parametrize("tolerance", quick(0.01, 0.002))
def test_eye_of_the_handle(sections, tolerance):
    """What the hull of everything would fill stays free within the tolerance: the eye of the handle."""
    body = loewner.Body.from_mesh(mug(sections), tolerance=tolerance)
    assert not loewner.collide(body, None, loewner.Body.sphere(0.005), translation(0.067))


# -- kernels ------------------------------------------------------------------------------------


def naive_distances(points, triangles):
    """Distances of points from triangles, the least of three edges and of the foot where it lies inside."""
    found = np.full(len(points), np.inf)
    for a, b, c in triangles:
        for start, edge in ((a, b - a), (b, c - b), (c, a - c)):
            along = (points - start) @ edge / max(edge @ edge, np.finfo(float).tiny)
            off = points - start - np.clip(along, 0, 1)[:, None] * edge
            found = np.minimum(found, np.linalg.norm(off, axis=1))
        normal = np.cross(b - a, c - a)
        if np.linalg.norm(normal) > 1e-10 * np.ptp([a, b, c], axis=0).max() ** 2:  # else the edges are all there is
            inside = np.ones(len(points), dtype=bool)
            for start, end in ((a, b), (b, c), (c, a)):
                inside &= (points - start) @ np.cross(normal, end - start) >= 0
            height = np.abs((points - a) @ normal) / np.linalg.norm(normal)
            found = np.where(inside, np.minimum(found, height), found)
    return found


@pytest.mark.parametrize("offset", [1e6, pytest.param(0.0, marks=pytest.mark.verify)])
@pytest.mark.parametrize(
    ("count", "scale"),
    [
        *((count, scale) for count in (1, 8, 9) for scale in (1e-20, 1.0, 1e20)),
        (80, 1.0),
        *(pytest.param(400, scale, marks=pytest.mark.verify) for scale in (1e-20, 1.0, 1e20)),
    ],
)
def test_distances_of_a_soup(count, scale, offset):
    """Distances of triangles at random, some without area, are those of all triangles one by one, wherever they are."""
    rng = np.random.default_rng(count)
    triangles = rng.uniform(-1, 1, (count, 1, 3)) + rng.normal(size=(count, 3, 3)) * rng.choice(
        [0.01, 0.3], (count, 1, 1)
    )
    triangles[::5, 2] = triangles[::5, 0] + 0.3 * (triangles[::5, 1] - triangles[::5, 0])
    triangles[::7, 1] = triangles[::7, 0]
    weights = rng.dirichlet(np.ones(3), count)
    on = np.einsum("tk,tki->ti", weights, triangles)
    points = np.concatenate(
        [rng.uniform(-3, 3, (300, 3)), on, triangles[:, 0], (triangles[:, 0] + triangles[:, 1]) / 2]
    )
    triangles, points = scale * (triangles + offset), scale * (points + offset)
    solid = Solid(triangles, closed=False)
    found, nearest = solid.signed_distances(points)
    assert solid.rounding <= scale * (1e-11 + 2e-14 * offset)
    np.testing.assert_allclose(found, naive_distances(points, triangles), rtol=0, atol=solid.rounding)
    assert found[300:].max() <= solid.rounding
    alone = np.array([naive_distances(x[None], triangles[[k]])[0] for x, k in zip(points, nearest, strict=True)])
    np.testing.assert_allclose(found, alone, rtol=0, atol=solid.rounding)


@pytest.mark.parametrize("thin", [1e-3, 1e-6, 1e-9, 1e-12, 1e-15])
def test_distances_of_thin_triangles(thin):
    """However thin a triangle is, distances are those of its long edge, but for its height and for rounding."""
    rng = np.random.default_rng(0)
    apex = np.array([[0.3, thin, 0.0], [0.0, thin, 0.0], [-1.0, thin, 0.0], [1.2, thin, 0.0]])
    triangles = np.array([[[0, 0, 0], [1, 0, 0], a] for a in apex])
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    points = rng.uniform(-1, 2, (300, 3)) * rng.choice([1.0, 1e-4], (300, 1))
    for triangle in triangles:
        low, high = min(0.0, triangle[2, 0]), max(1.0, triangle[2, 0])
        line = np.column_stack([np.clip(points[:, 0], low, high), np.zeros((300, 2))])
        solid = Solid((triangle @ turn)[None], closed=False)
        found = solid.signed_distances(points @ turn)[0]
        expected = np.linalg.norm(points - line, axis=1)
        np.testing.assert_allclose(found, expected, rtol=0, atol=2 * thin + solid.rounding)


@pytest.mark.parametrize(
    "make", [l_shape, hollow_box, *(pytest.param(k, marks=pytest.mark.verify) for k in (mug, ring))]
)
def test_winding_numbers_of_lattices(make):
    """Rays from lattice points run through edges and corners of meshes that are on the lattice; turns are counted."""
    mesh = make()
    low, high = mesh.bounds
    lattice = np.stack(np.meshgrid(*np.linspace(low, high, 13).T, indexing="ij"), axis=-1).reshape(-1, 3)
    lattice = np.concatenate([lattice, lattice + [0.5, 0.0, 0.0] * (high - low) / 13])
    solid = Solid(corners(mesh), closed=True)
    clear = lattice[np.abs(solid.signed_distances(lattice)[0]) > 1e-9 * mesh.scale]
    assert len(clear) > 1000
    np.testing.assert_array_equal(solid.winding_numbers(clear), turns(clear, corners(mesh)))


def test_winding_numbers_of_shells_in_shells():
    """Shells that are wound alike add up, and one wound inwards takes away."""
    shells = [trimesh.creation.box((k, k, k)) for k in (6, 5, 4, 3, 2)]
    for shell in shells[2:4]:
        shell.invert()
    solid = Solid(np.concatenate([corners(shell) for shell in shells]), closed=True)
    points = np.array([[x, 0.1, 0.2] for x in (0.5, 1.25, 1.75, 2.25, 2.75, 3.5)])
    np.testing.assert_array_equal(solid.winding_numbers(points), [1, 0, 1, 2, 1, 0])


def test_facing_one_way():
    """About a face and an edge that sticks out all is on one side; in a groove between two walls it is not."""
    solid = Solid(corners(hollow_box()), closed=True)
    points = np.array([[1.2, 0, 0], [1.1, 1.1, 1.1], [0, 0, 0], [0.3, 0.3, 0.3], [1.5, 0, 0]])
    reach = np.array([0.3, 0.3, 0.6, 0.35, 0.4])
    expected = [True, True, False, True, False]  # the last one reaches nothing
    np.testing.assert_array_equal(solid.face_one_way(points, reach, np.ones(5, dtype=bool)), expected)
    plates = corners(trimesh.creation.box((2, 2, 2)))
    plates = plates[np.abs(np.cross(plates[:, 1] - plates[:, 0], plates[:, 2] - plates[:, 0])[:, 2]) > 0.5]
    open_mesh = Solid(plates, closed=False)  # floor and ceiling
    points = np.array([[0, 0, 0.9], [0, 0, 0.0], [0, 0, 0.9]])
    answers = open_mesh.face_one_way(points, np.array([0.2, 1.2, 0.2]), np.array([True, True, False]))
    np.testing.assert_array_equal(answers, [True, False, False])


# -- cuts that lead nowhere ---------------------------------------------------------------------


def test_cells_that_stand_on_an_edge_get_smaller():
    """A piece's triangle in the upright plane through an edge of the mesh's triangle is divided like any other."""
    rng = np.random.default_rng(0)
    for _ in range(200):
        mesh = rng.normal(size=(1, 3, 3))
        solid = Solid(mesh, closed=False)
        a, b = mesh[0, 0], mesh[0, 1]
        cell = np.array([[a, b, (a + b) / 2 - 0.1 * solid.normals[0]]])
        parts, origin, _ = _smaller(cell, np.zeros(1, dtype=np.int64), np.ones(1), solid)
        areas = np.linalg.norm(np.cross(parts[:, 1] - parts[:, 0], parts[:, 2] - parts[:, 0]), axis=1)
        whole = np.linalg.norm(np.cross(cell[0, 1] - cell[0, 0], cell[0, 2] - cell[0, 0]))
        assert not origin.any()
        assert areas.max(initial=0.0) <= 0.9 * whole


@pytest.mark.verify
@pytest.mark.parametrize("sections", [32, 48])
def test_tolerance_of_a_thin_wall(sections):
    """A thin wall of many facets is cut across, not into slices, however near the tolerance its pieces come."""
    wall = trimesh.creation.annulus(0.037, 0.04, 0.1, sections=sections)
    pieces, covering = meshes.convex_pieces(wall, tolerance=0.002)
    assert covering.exact
    assert covering.max_protrusion <= 0.002
    assert len(pieces) <= sections


@pytest.mark.parametrize(
    ("make", "tolerance", "times"),
    [(ring, 0.2, 2), *(pytest.param(mug, 0.002, times, marks=pytest.mark.verify) for times in (2, 10))],
)
def test_a_limit_that_suffices_costs_nothing(make, tolerance, times):
    """With twice as many pieces allowed as come out without a limit, or more, the tolerance is kept too."""
    most = times * len(pieces_within(make, tolerance)[0])
    pieces, covering = meshes.convex_pieces(make(), tolerance=tolerance, max_pieces=most)
    assert len(pieces) <= most
    assert covering.max_protrusion <= tolerance


@pytest.mark.parametrize("limits", [(1, 4), pytest.param((1, 4, 8, 16), marks=pytest.mark.verify)])
def test_a_limit_that_is_too_small(limits):
    """There are no more pieces than are allowed, and with more of them it does not get worse."""
    out = []
    for most in limits:
        with pytest.warns(UserWarning, match="mesh: expected pieces that stick out by at most tolerance=0.002 m"):
            pieces, covering = meshes.convex_pieces(mug(), tolerance=0.002, max_pieces=most)
        assert len(pieces) <= most
        out.append(covering.max_protrusion)
    assert all(later <= 1.3 * sooner for sooner, later in itertools.pairwise(out))  # bounds are known to a quarter


@pytest.mark.verify
def test_tolerances_near_rounding_end():
    """Where the deepest point lies on the mesh but for rounding, planes are found without dividing by nothing."""
    with pytest.warns(UserWarning, match="mesh: expected pieces that stick out"):
        meshes.convex_pieces(mug(), tolerance=1e-6, max_pieces=60)
