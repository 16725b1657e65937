"""Bodies: what they hold, that they travel through files unharmed, that moving one never fits again."""

import dataclasses
import inspect
import itertools
import os
import re
import zipfile
from pathlib import Path

import numpy as np
import pytest
import trimesh

import loewner
from exact import halfspaces_crossed, hull_planes, points_outside, rational
from families import FAMILIES, box_corners, pieces, random_poses
from loewner import Bodies, Body
from loewner._kernels import columns
from loewner._kernels.pieces.shapes import unit_support
from loewner.bodies import CURVED, exports
from loewner.bodies.triangulated import of_piece
from loewner.ellipsoids import polytopes
from loewner.meshes import decomposition as meshes
from oracles import hull
from sampling import quick

ALL_KINDS = {
    "polytope": lambda: Body.from_points(pieces("ball 20", 1)[0]),
    "union": lambda: Body.from_pieces(pieces("boxes", 3)),
    "box": lambda: Body.box([1, 2, 3]),
    "sphere": lambda: Body.sphere(0.5),
    "cylinder": lambda: Body.cylinder(0.5, 2),
    "capsule": lambda: Body.capsule(0.5, 2),
    "cone": lambda: Body.cone(0.5, 2),
    "ellipsoid": lambda: Body.ellipsoid([3, 2, 1]),
    "mixed": lambda: Body.union([Body.sphere(0.5), Body.box([1, 1, 1]), Body.cone(1, 2)]),
}


@pytest.mark.parametrize("family", FAMILIES)
def test_inner_in_piece_in_outer(family: str):
    """Inner ellipsoid inside every face plane, every vertex inside the outer one."""
    points = pieces(family, 5, seed=6)
    for body, P in zip(Bodies.from_points(points), points, strict=True):
        assert len(body.pieces) == 1
        h = hull(P)
        c, F = body.inner.center[0], body.inner.factor[0]
        reach = h.normals @ c + np.linalg.norm(h.normals @ F, axis=1)
        offset = (h.vertices @ h.normals.T).max(axis=0)
        # Two hulls of the same points differ by rounding in the normals of thin facets.
        assert (reach <= offset + 1e-12 * np.abs(P).max()).all()
        u = np.linalg.solve(body.outer.factor[0], (P - body.outer.center[0]).T)
        assert np.linalg.norm(u, axis=0).max() <= 1 + 1e-13


@pytest.mark.parametrize("number", CURVED)
def test_a_kind_is_known_wherever_kinds_are_told_apart(number, tmp_path):
    """Its row makes the body anew from what is stored of it; files, meshes, scenes and MJCF know it."""
    kind = CURVED[number]
    given, body = [0.3, 0.5][: len(kind.size_names)] or [0.1, 0.2, 0.3], made_by(number)
    packed = body._packed
    assert (int(packed.layout[0, columns.KIND]), body.pieces[0].kind) == (number, kind.name)
    assert list(kind.sizes(packed.frames[0, 0], packed.frames[0, 4::4].tolist())) == given
    assert (packed.frames[0, 0] > 0) == (kind.core is not None)
    body.save(tmp_path / "body.npz")
    loaded = Body.load(tmp_path / "body.npz")
    points, triangles = of_piece(loaded._packed, 0)
    assert (
        np.linalg.norm((points - body.outer.center) @ np.linalg.inv(body.outer.factor[0]).T, axis=1) < 1 + 1e-9
    ).all()
    assert trimesh.Trimesh(points, triangles).volume > np.pi * np.linalg.det(body.inner.factor[0])
    scene = loewner.Scene()
    scene.add("body", loaded)
    loewner.save_scene(scene, tmp_path / "scene.yaml")
    assert f"{kind.name}:" in (tmp_path / "scene.yaml").read_text()
    assert f'type="{kind.name if kind.name in exports.MJCF else "mesh"}"' in body.to_mjcf()


def test_no_kind_stands_for_an_unknown_one():
    """A number without a row is an error where a shape is asked for, not another shape."""
    packed = Body.cone(1.0, 1.0)._packed
    layout = packed.layout.copy()
    layout[0, columns.KIND] = 9
    packed = dataclasses.replace(packed, layout=layout)
    for ask in (lambda: of_piece(packed, 0), lambda: Body(packed).to_mjcf(), lambda: Body(packed).pieces):
        with pytest.raises(KeyError):
            ask()


def made_by(number: int) -> Body:
    """A body of a curved kind, made by the constructor and the sizes that its row names."""
    kind = CURVED[number]
    sizes = [0.3, 0.5][: len(kind.size_names)] or [0.1, 0.2, 0.3]
    return getattr(Body, kind.name)(*(sizes if kind.size_names else [sizes]))


def heights(number: int, body: Body, normals: np.ndarray) -> np.ndarray:
    """How far the piece of a curved body reaches along unit directions, by the kernels' support function."""
    frame = body._packed.frames[0]
    local = normals @ frame[4:].reshape(3, 3)
    corners = np.array([unit_support.py_func(number, *n) for n in local]) if number != columns.POINT else 0 * local
    return normals @ frame[1:4] + (corners * local).sum(axis=1) + frame[0]


@pytest.mark.parametrize("number", CURVED)
def test_a_row_agrees_with_its_support_function(number):
    """Inner ellipsoid and corners are in the piece, in turn inside the outer ellipsoid and the enlarged mesh."""
    kind, body = CURVED[number], made_by(number)
    normals = np.random.default_rng(number).normal(size=(2000, 3))
    normals = np.concatenate([normals / np.linalg.norm(normals, axis=1, keepdims=True), np.eye(3), -np.eye(3)])
    reach = heights(number, body, normals)
    for fit, sign in ((body.inner, 1), (body.outer, -1)):
        beyond = normals @ fit.center[0] + np.linalg.norm(normals @ fit.factor[0], axis=1) - reach
        assert (sign * beyond).max() <= 1e-15
    corners, triangles = of_piece(body._packed, 0)
    assert (normals @ corners.T).max(axis=1) == pytest.approx(reach, abs=3e-3)
    assert ((normals @ corners.T).max(axis=1) <= reach + 1e-15).all()
    mesh = trimesh.Trimesh(corners, triangles)
    mesh.update_faces(mesh.nondegenerate_faces())
    assert mesh.is_volume
    if kind.inradii is not None:
        image = body._packed.frames[0, 4:].reshape(3, 3)
        wider = np.linalg.solve(image, corners.T).T / kind.inradii @ image.T
        normals = np.concatenate([normals, trimesh.Trimesh(wider, triangles).face_normals])
        assert ((normals @ wider.T).max(axis=1) >= heights(number, body, normals) - 1e-15).all()


@pytest.mark.parametrize("number", CURVED)
def test_ellipsoids_of_a_row_are_optimal(number):
    """They nearly have the volumes and centers of the ellipsoids fitted to the inscribed mesh, which are smaller."""
    body = made_by(number)
    hull = Body.from_points(of_piece(body._packed, 0)[0])
    for fit, best in ((hull.inner, body.inner), (hull.outer, body.outer)):
        assert 0.98 * best.volume <= fit.volume <= best.volume * (1 + 1e-4)  # to the accuracy of a fit
        assert fit.center == pytest.approx(best.center, abs=5e-3)


def test_ellipsoids_of_primitives():
    """Known optimal ellipsoids: sphere and ellipsoid are their own; box, cylinder and cone by formula."""
    half3 = 3**0.5
    for body, inner, outer in [
        (Body.sphere(0.5), [0.5] * 3, [0.5] * 3),
        (Body.ellipsoid([3, 2, 1]), [3, 2, 1], [3, 2, 1]),
        (Body.box([2, 4, 6]), [3, 2, 1], [3 * half3, 2 * half3, half3]),
        (Body.cylinder(1, 4), [2, 1, 1], [2 * half3, 1.5**0.5, 1.5**0.5]),
    ]:
        assert body.inner.semi_axes[0] == pytest.approx(inner, rel=1e-3)
        assert body.outer.semi_axes[0] == pytest.approx(outer, rel=1e-3)
    cone = Body.cone(1, 4)  # the limit of the k-pyramid: both centred a quarter of the way up
    assert cone.inner.center[0] == pytest.approx([0, 0, -1], abs=1e-3)
    assert cone.outer.center[0] == pytest.approx([0, 0, -1], abs=1e-3)
    assert cone.inner.semi_axes[0] == pytest.approx([1, 0.5**0.5, 0.5**0.5], rel=1e-3)
    assert cone.outer.semi_axes[0] == pytest.approx([3, 3 / 8**0.5, 3 / 8**0.5], rel=1e-3)


BOXES = [
    (1, 1, 1),
    (2, 4, 6),
    (0.1, 0.2, 0.3),
    (3e-30, 2e-29, 3e-30),
    (1e29, 1e28, 3e29),
    (1e-3, 1e8, 7),
    (1, 3e-12, 1),
]


@pytest.mark.parametrize("size", BOXES)
def test_ellipsoids_of_boxes_are_certified(size):
    """Exactly: the inner ellipsoid lies in the box and the corners in the outer one, and neither gap is exceeded."""
    body = Body.box(size)
    piece, half = body.pieces[0], rational(np.array(size, dtype=float)) / 2
    assert halfspaces_crossed(*hull_planes(piece.vertices), body.inner.center[0], body.inner.factor[0]) == 0
    assert halfspaces_crossed(piece.normals, piece.offsets, body.inner.center[0], body.inner.factor[0]) == 0
    assert points_outside(piece.vertices, body.outer.center[0], body.outer.factor[0]) == 0
    # The optima have the volumes of the balls of radius 1 and 3 ** 0.5, times that of the half edges.
    inner, outer = (np.prod(rational(np.diag(F[0]))) / np.prod(half) for F in (body.inner.factor, body.outer.factor))
    inner_gap, outer_gap = rational(body.gaps[0])
    assert 0 < outer_gap == inner_gap < 2e-14
    assert inner >= 1 - inner_gap + inner_gap**2 / 2  # more than exp(-gap)
    assert outer**2 <= 27 * (1 + 2 * outer_gap)  # less than 27 exp(2 gap)


@pytest.mark.parametrize("size", [size for size in BOXES if max(size) < 1e3 * min(size)])
def test_ellipsoids_of_boxes_are_those_that_a_fit_finds(size):
    """The general fits of the corners end at the closed form, within their tolerance, and are not better than it."""
    body, tol = Body.box(size), 1e-9
    corners = box_corners(np.array(size, dtype=float))
    for fit, ellipsoids, gap, sign in [
        (loewner.mvie(corners, tol=tol), body.inner, body.gaps[0, 0], 1),
        (loewner.mvce(corners, tol=tol), body.outer, body.gaps[0, 1], -1),
    ]:
        larger = np.log(np.linalg.det(fit.ellipsoid.factor / max(size)))
        larger -= np.log(np.linalg.det(ellipsoids.factor[0] / max(size)))
        assert -tol - gap - 1e-14 <= sign * larger <= gap + 1e-14
        np.testing.assert_allclose(fit.ellipsoid.factor, ellipsoids.factor[0], atol=1e-4 * max(size))
        np.testing.assert_allclose(fit.ellipsoid.center, 0, atol=1e-4 * max(size))


@pytest.mark.parametrize("size", BOXES)
def test_a_box_is_the_hull_of_its_corners(size):
    """Vertices, faces and surface are those that Qhull finds for the corners, to the last bit."""
    box, found = polytopes.box_hull(np.array(size) / 2, "size"), polytopes.hulls([box_corners(np.array(size))])
    assert np.array_equal(box.vertices, Body.box(size).pieces[0].vertices)
    for name in ("vert_start", "face_start", "triangle_start"):
        assert np.array_equal(getattr(box, name), getattr(found, name))
    for ours, theirs in [
        (box.vertices, found.vertices),
        (np.column_stack([box.normals, box.offsets]), np.column_stack([found.normals, found.offsets])),
    ]:
        assert sorted(ours.tolist()) == sorted(theirs.tolist())
    # Each triangle lies in a face, in its orientation, and together they are all of the surface.
    a, b, c = (box.vertices[box.triangles[:, k]] / np.array(size) for k in range(3))
    doubled = np.cross(b - a, c - a)
    for n, offset in zip(box.normals, box.offsets, strict=True):
        here = (box.vertices[box.triangles] @ n == offset).all(axis=1)
        assert here.sum() == 2
        assert (doubled[here] == n).all()
    edges = {tuple(np.roll(triangle, k)[:2].tolist()) for triangle in box.triangles for k in range(3)}
    assert len(edges) == 36
    assert edges == {(q, p) for p, q in edges}


@pytest.mark.parametrize("every", quick(3, 1))
def test_boxes_are_refused_as_their_corners_are(every: int):
    """Flat, tiny and huge boxes: the same error, under the name of the argument, wherever the thin edge is."""
    edges = [5e-324, 1e-200, 1e-141, 1e-140, 1e-30, 1e-12, 1e-3, 1.0, 1e3, 1e12, 1e30, 1e140, 1e141, 1e308]
    edges += [1 - 1e-3, 1e-12 * (1 - 1e-3), 1e-12 * (1 + 1e-3), 1e-15, 1.4e-15, 1.3e-15]
    told, corners = set(), np.array(list(itertools.product((-1.0, 1.0), repeat=3)))
    for size in itertools.islice(itertools.product(edges, repeat=3), 0, None, every):
        half = np.array(size) / 2

        def outcome(make):
            try:
                make()
            except loewner.LoewnerError as error:
                return f"{type(error).__name__}: {error}"
            return "a hull"

        ours = outcome(lambda half=half: polytopes.box_hull(half, "size"))
        assert ours == outcome(lambda half=half: polytopes.hulls([corners * half], names=["size"])), size
        told.add(re.sub("[0-9].*", "", ours))
    assert len(told) == 3
    for size in ([1, 1, 1e-13], [1, 1e-13, 1e-13], [1e31] * 3, [1e-31] * 3):
        with pytest.raises(loewner.GeometryError):
            Body.box(size)
    for size in ([1e-150] * 3, [1e150] * 3):
        with pytest.raises(loewner.InputError, match="size: expected sizes between"):
            Body.box(size)


@pytest.mark.parametrize("kind", ALL_KINDS)
def test_save_and_load(kind: str, tmp_path: Path):
    """What comes back answers like what was saved, bit by bit."""
    body = ALL_KINDS[kind]()
    path = tmp_path / "body.npz"
    body.save(path)
    again = Body.load(path)
    assert len(again.pieces) == len(body.pieces)
    assert np.array_equal(again.inner.factor, body.inner.factor)
    assert np.array_equal(again.outer.center, body.outer.center)
    for p, q in zip(body.pieces, again.pieces, strict=True):
        assert p.kind == q.kind
        for name in ("vertices", "normals", "offsets", "triangles"):
            x, y = getattr(p, name), getattr(q, name)
            assert (x is None) == (y is None)
            assert x is None or np.array_equal(x, y)
    T = random_poses(np.random.default_rng(0), 50, 1.5)
    other = Body.box([1, 0.5, 0.5])
    assert np.array_equal(loewner.classify(body, T, other, None), loewner.classify(again, T, other, None))
    one, two = (loewner.distance(x, T, other, None, exact=True) for x in (body, again))
    assert np.array_equal(one.distance, two.distance)


def test_bodies_save_and_load(tmp_path: Path):
    """Bodies of every kind survive saving and loading exactly, and queries answer the same afterwards."""
    bodies = Bodies([make() for make in ALL_KINDS.values()])
    bodies.save(tmp_path / "all.npz")
    again = Bodies.load(tmp_path / "all.npz")
    assert len(again) == len(bodies) == len(ALL_KINDS)
    assert np.array_equal(again.piece_start, bodies.piece_start)
    assert np.array_equal(again.inner.factor, bodies.inner.factor)
    T = random_poses(np.random.default_rng(0), len(bodies), 1.0)
    other = Body.sphere(0.5)
    assert np.array_equal(loewner.collide(bodies, T, other, None), loewner.collide(again, T, other, None))


def test_files_hold_plain_arrays_only(tmp_path: Path):
    """A body file is a zip of .npy arrays that loads without pickle: opening a stranger's file runs no code."""
    path = tmp_path / "body.npz"
    Body.from_pieces(pieces("boxes", 2)).save(path)
    assert zipfile.is_zipfile(path)
    with np.load(path, allow_pickle=False) as data:
        assert data.files
        for name in data.files:
            assert data[name].dtype != object


def test_save_leaves_the_old_file_or_the_new_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """A save that dies half way leaves the old file whole and no debris."""
    path = tmp_path / "body.npz"
    Body.sphere(1).save(path)
    before = path.read_bytes()

    def full_disc(*args: object, **kwargs: object) -> None:
        raise OSError(28, "No space left on device")

    for target in ("replace", "rename", "fsync"):
        with monkeypatch.context() as patch:
            patch.setattr(os, target, full_disc)
            failed = None
            try:
                Body.box([1, 2, 3]).save(path)
            except OSError as error:
                failed = error
        assert [p.name for p in tmp_path.iterdir()] == ["body.npz"]
        if failed is None:
            # That call is not part of a save: then the new file is whole.
            assert len(Body.load(path).pieces) == 1
            Body.sphere(1).save(path)
        else:
            assert isinstance(failed, loewner.FileError)
            assert path.read_bytes() == before
    with pytest.raises(loewner.FileError):
        Body.sphere(1).save(tmp_path / "no such folder" / "body.npz")
    assert [p.name for p in tmp_path.iterdir()] == ["body.npz"]


def test_moving_never_fits_again():
    """The moved body's ellipsoids are the moved ellipsoids; its answers are those of the moved pose."""
    rng = np.random.default_rng(2)
    for make in ALL_KINDS.values():
        body = make()
        T, S = random_poses(rng, 2, 1.0)
        moved = body.transformed(T)
        expected = body.outer.transformed(T)
        assert moved.outer.center == pytest.approx(expected.center, abs=1e-14)
        # Moving may inflate by roundings so that containment survives, no more.
        assert moved.outer.shape_matrix == pytest.approx(expected.shape_matrix, rel=1e-12, abs=1e-12)
        assert moved.inner.volume == pytest.approx(body.inner.volume, rel=1e-12)
        other = Body.box([1, 0.5, 0.5])
        one = loewner.distance(body, S @ T, other, None, exact=True)
        two = loewner.distance(moved, S, other, None, exact=True)
        assert float(one.distance) == pytest.approx(float(two.distance), abs=1e-9)


def test_moved_piece_still_nests():
    """After a move the outer ellipsoid still holds every vertex and the inner is still inside every face."""
    rng = np.random.default_rng(9)
    for family in FAMILIES:
        (P,) = pieces(family, 1, seed=5)
        moved = Body.from_points(P).transformed(random_poses(rng, 1)[0])
        piece = moved.pieces[0]
        u = np.linalg.solve(moved.outer.factor[0], (piece.vertices - moved.outer.center[0]).T)
        assert np.linalg.norm(u, axis=0).max() <= 1 + 1e-13
        reach = piece.normals @ moved.inner.center[0] + np.linalg.norm(piece.normals @ moved.inner.factor[0], axis=1)
        assert (reach <= piece.offsets + 1e-13).all()


def test_moved_by_a_pose_that_stretches():
    """A pose that is just accepted as rigid leaves a ball or a capsule between its inner and its outer ellipsoid."""
    rng = np.random.default_rng(3)
    for stretch in (1 - 4e-7, 1 + 4e-7):
        T = random_poses(rng, 1)[0]
        T[:3, :3] *= stretch
        ball, capsule = Body.sphere(2.0).transformed(T), Body.capsule(1.0, 2.0).transformed(T)
        assert ball.inner.semi_axes.max() <= 2.0 <= ball.outer.semi_axes.min()
        # Across its axis a capsule is as thick as its radius says.
        assert capsule.inner.semi_axes[0, 1:].max() <= 1.0
        across = np.linalg.svd(capsule.outer.factor[0])[0][:, 1]
        assert np.linalg.norm(across @ capsule.outer.factor[0]) >= 1.0


def test_packing():
    """Bodies are their bodies: pieces counted, rows in order, slices and single ones equal what went in."""
    each = [make() for make in ALL_KINDS.values()]
    bodies = Bodies(each)
    counts = [len(b.pieces) for b in each]
    assert bodies.piece_start.tolist() == np.cumsum([0, *counts]).tolist()
    assert len(bodies.inner) == len(bodies.outer) == sum(counts)
    for k, body in enumerate(each):
        rows = slice(bodies.piece_start[k], bodies.piece_start[k + 1])
        assert np.array_equal(bodies.inner.center[rows], body.inner.center)
        assert np.array_equal(bodies[k].outer.factor, body.outer.factor)
    part = bodies[2:5]
    assert isinstance(part, Bodies)
    assert len(part) == 3
    assert np.array_equal(part[0].outer.factor, each[2].outer.factor)
    assert isinstance(bodies[-1], Body)
    with pytest.raises(IndexError):
        bodies[len(bodies)]
    assert [len(b.pieces) for b in bodies] == counts


def test_batch_of_fits_equals_single_fits():
    """Fitted in one go or one by one: the same ellipsoids."""
    points = pieces("ball 20", 6) + pieces("boxes", 3) + pieces("needles 1:1e-3:1e-3", 3)
    for body, P in zip(Bodies.from_points(points), points, strict=True):
        one = Body.from_points(P)
        assert body.inner.log_volume == pytest.approx(one.inner.log_volume, abs=1e-9)
        assert body.outer.log_volume == pytest.approx(one.outer.log_volume, abs=1e-9)


def test_bodies_cannot_be_changed():
    """Arrays handed out are read-only, and the caller's own array is copied."""
    P = box_corners(np.ones(3))
    body = Body.from_points(P)
    before = body.outer.center.copy()
    P *= 10
    assert np.array_equal(body.outer.center, before)
    assert np.abs(body.pieces[0].vertices).max() == 0.5
    for array in (body.inner.center, body.outer.factor, body.pieces[0].vertices, body.pieces[0].normals):
        with pytest.raises(ValueError, match="read-only"):
            array[...] = 0
    with pytest.raises(AttributeError):
        body.pieces = ()


# An ordinary cloud of 17 points in a ball, on which the inner fit once stalled at a gap of 1.4e-3.
STALLED = [
    [-0.03142714314929224, 0.01890358760413895, -0.02857833095053299],
    [-0.03942424286108982, -0.004328748924142018, -0.026043855229903122],
    [0.0485952940328977, -0.011027951903474944, 0.009690491214938793],
    [0.007204889586456759, -0.0013283293399225797, 0.018203321747597444],
    [0.04279392206449421, -0.004653454579010953, -0.0018397795891463293],
    [-0.020314421524154025, -0.006134869330353004, -0.03267598432466044],
    [0.035421571681022286, 0.022099172018976685, 0.03359556512956291],
    [-0.027285159339564182, -0.02607078301239771, -0.026626962575824066],
    [-0.0012630611749074269, 0.015508351983275442, -0.03632433777977982],
    [-0.011381631594037005, 0.04164725515346478, -0.024715153075810816],
    [-0.02399818679943945, -0.008051221421613968, -0.03794757884690987],
    [0.004925022204698437, -0.00661120725843135, -0.0054625774483040394],
    [0.020190023247135976, 0.027440399067146633, -0.007103951900247611],
    [0.03588477331002496, -0.0024983633307725855, 0.03045314843721793],
    [-0.008840470224904256, -0.015387568010998864, 0.03443436836862088],
    [-0.01607553963931112, 0.016948227855822454, -0.039173182618089455],
    [0.024074436908467528, -0.022724462611116852, -0.02194638085129803],
]


def test_a_fit_that_once_stalled():
    """Body of an ordinary point cloud: both fits reach the tolerance asked for."""
    body = Body.from_points(STALLED)
    assert (body.gaps <= 1e-4).all()
    assert (body.inner.volume < body.outer.volume).all()


def test_errors_name_the_argument():
    """One set of points is called what the caller calls it; of several, the message gives the number."""
    flat = box_corners(np.array([1.0, 1.0, 0.0]))
    with pytest.raises(loewner.GeometryError, match=r"^points: expected .* in a plane"):
        Body.from_points(flat)
    with pytest.raises(loewner.InputError, match=r"^points: expected shape \(n, 3\), found \(8, 2\)"):
        Body.from_points(flat[:, :2])
    for several in (Body.from_pieces, Bodies.from_points):
        with pytest.raises(loewner.GeometryError, match=r"^point_sets\[1\]: expected .* in a plane"):
            several([box_corners(np.ones(3)), flat])


def test_hulls_of_a_mesh_are_computed_once(monkeypatch):
    """A convex mesh takes one hull on its way to a body; the two parts of another, theirs and one about both."""
    asked = []
    hull = polytopes._hull
    monkeypatch.setattr(polytopes, "_hull", lambda points, name: asked.append(len(points)) or hull(points, name))
    box = trimesh.creation.box((1, 1, 1))
    assert len(Body.from_mesh(box).pieces) == 1
    assert asked == [8]
    asked.clear()
    both = trimesh.util.concatenate([box, box.copy().apply_translation([3, 0, 0])])
    assert len(Body.from_mesh(both).pieces) == 2
    assert asked == [16, 8, 8]


def test_covering_is_read_only():
    """What is known of a mesh's covering stays with its body."""
    body = Body.from_mesh(trimesh.creation.box((1, 1, 1)))
    with pytest.raises(AttributeError):
        body.covering = None
    assert body.covering.kind == "convex"


def test_options_of_meshes_are_parameters():
    """`from_mesh` names all its options, with the defaults of `convex_pieces`, for tools to complete and check."""
    theirs = inspect.signature(meshes.convex_pieces).parameters
    ours = inspect.signature(Body.from_mesh).parameters
    assert {name: p.default for name, p in ours.items() if name not in ("source", "tol")} == {
        name: p.default for name, p in theirs.items() if name != "source"
    }
    with pytest.raises(TypeError, match="max_piece"):
        Body.from_mesh("part.stl", max_piece=3)
