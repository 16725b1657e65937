"""Meshes: read whole or refused; the pieces hold the mesh; convex meshes are left alone."""

import struct
import subprocess
import sys
from importlib.metadata import distribution

import numpy as np
import pytest
import trimesh
from scipy.optimize import nnls

import loewner
from loewner import FileError, GeometryError, InputError, MissingExtraError, Verdict, meshes
from loewner.polytopes import Polytope

SUFFIXES = ("stl", "obj", "ply", "off", "glb", "dae")


def l_shape(scale=1.0, shift=0.0):
    """A closed, non-convex mesh of 12 vertices: three unit squares, extruded by 1."""
    outline = np.array([[0, 0], [2, 0], [2, 1], [1, 1], [1, 2], [0, 2]], dtype=float)
    ring = [[0, 1, 3], [1, 2, 3], [0, 3, 5], [3, 4, 5]]
    low = np.c_[outline, np.zeros(6)]
    high = np.c_[outline, np.ones(6)]
    walls = [f for i in range(6) for f in ([i, (i + 1) % 6, i + 6], [(i + 1) % 6, (i + 1) % 6 + 6, i + 6])]
    faces = [t[::-1] for t in ring] + [[a + 6, b + 6, c + 6] for a, b, c in ring] + walls
    return trimesh.Trimesh(np.vstack([low, high]) * scale + shift, faces, process=False)


def two_boxes():
    """Two unit boxes, two metres apart, as one mesh."""
    return trimesh.util.concatenate(
        [trimesh.creation.box((1, 1, 1)), trimesh.creation.box((1, 1, 1)).apply_translation([3, 0, 0])]
    )


def panda(name):
    robots = distribution("example-robot-data").locate_file("cmeel.prefix/share/example-robot-data/robots")
    return robots / "panda_description" / "meshes" / name


def surface_points(mesh, count, seed=0):
    """Random points of a mesh's surface, and its vertices."""
    rng = np.random.default_rng(seed)
    corners = np.asarray(mesh.vertices)[np.asarray(mesh.faces)]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    weights = rng.dirichlet(np.ones(3), count)
    chosen = corners[rng.choice(len(corners), count, p=area / area.sum())]
    return np.concatenate([np.einsum("ij,ijk->ik", weights, chosen), mesh.vertices])


def excess(points, pieces):
    """How far each point sticks out of the nearest piece beyond its faces; a naive lower bound."""
    least = np.full(len(points), np.inf)
    for vertices in pieces:
        hull = Polytope.from_points(vertices)
        least = np.minimum(least, (points @ hull.normals.T - hull.offsets).max(axis=1))
    return least


# -- reading ------------------------------------------------------------------------------------


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_every_format_gives_the_same_mesh(suffix, tmp_path):
    """A mesh comes back from each format with its volume and its bounds."""
    mesh = l_shape()
    path = tmp_path / f"part.{suffix}"
    mesh.export(path)
    vertices, triangles = meshes.load(path)
    again = trimesh.Trimesh(vertices, triangles)
    np.testing.assert_allclose(again.bounds, mesh.bounds, atol=1e-6)
    assert again.volume == pytest.approx(3.0, rel=1e-6)
    assert vertices.dtype == np.float64
    assert triangles.dtype == np.int64


def test_text_stl(tmp_path):
    """STL in text is read too."""
    path = tmp_path / "part.stl"
    path.write_text(trimesh.exchange.stl.export_stl_ascii(l_shape()))
    assert len(meshes.load(str(path))[1]) == len(l_shape().faces)


def test_scene_is_placed_and_joined(tmp_path):
    """The transforms of a scene apply, from a file and from memory."""
    scene = trimesh.Scene()
    T = np.eye(4)
    T[0, 3] = 10.0
    box = trimesh.creation.box((1, 1, 1))
    scene.add_geometry(box)
    scene.add_geometry(box, transform=T)
    scene.export(tmp_path / "scene.glb")
    for source in (scene, tmp_path / "scene.glb"):
        vertices, triangles = meshes.load(source)
        assert len(triangles) == 24
        np.testing.assert_allclose(
            [vertices.min(axis=0), vertices.max(axis=0)], [[-0.5] * 3, [10.5, 0.5, 0.5]], atol=1e-6
        )


def test_stated_unit_is_converted(tmp_path):
    """A Collada file in centimetres gives metres."""
    path = tmp_path / "part.dae"
    l_shape().export(path)
    text = path.read_text()
    assert 'meter="1' in text or "<unit" not in text
    if "<unit" in text:
        text = text.replace("<unit", '<unit meter="0.01" name="centimeter"/><!-- ', 1).replace("/>", "/> -->", 2)
    else:
        text = text.replace("<asset>", '<asset><unit meter="0.01" name="centimeter"/>')
    path.write_text(text)
    assert meshes.load(path)[0].max() == pytest.approx(0.02)


@pytest.mark.parametrize("suffix", SUFFIXES)
@pytest.mark.parametrize("keep", [0.0, 0.3, 0.6, 0.95])
def test_cut_file_is_refused(suffix, keep, tmp_path):
    """A file cut anywhere is a FileError that names it, never a smaller mesh; cut OBJs only inside a line."""
    path = tmp_path / f"part.{suffix}"
    l_shape().export(path)
    data = path.read_bytes()
    cut = data[: int(len(data) * keep)]
    if suffix == "obj":
        cut = cut[: cut.rfind(b" ")] if b" " in cut else cut
    path.write_bytes(cut)
    with pytest.raises((FileError, GeometryError), match="part") as caught:
        meshes.load(path)
    assert isinstance(caught.value, FileError) or suffix == "obj"


@pytest.mark.parametrize("keep", [0.3, 0.6, 0.95])
def test_cut_text_stl_is_refused(keep, tmp_path):
    """trimesh reads the facets before the cut; here it is an error."""
    text = trimesh.exchange.stl.export_stl_ascii(l_shape())
    path = tmp_path / "part.stl"
    path.write_text(text[: int(len(text) * keep)])
    with pytest.raises(FileError, match="cut"):
        meshes.load(path)


@pytest.mark.parametrize("suffix", SUFFIXES)
@pytest.mark.parametrize("content", [b"hello, this is no mesh\n" * 20, bytes(range(256)) * 4, b"\0" * 500])
def test_no_mesh_is_refused(suffix, content, tmp_path):
    """Text, noise and zeros under the name of a mesh are FileErrors (an empty STL is a mesh without triangles)."""
    path = tmp_path / f"part.{suffix}"
    path.write_bytes(content)
    with pytest.raises((FileError, GeometryError), match="part") as caught:
        meshes.load(path)
    assert isinstance(caught.value, FileError) or (suffix == "stl" and not any(content))


def test_missing_folder_and_unknown_suffix(tmp_path):
    """Each says what was expected and what was found."""
    (tmp_path / "part.step").write_text("ISO-10303-21;")
    (tmp_path / "folder.stl").mkdir()
    for name, found in (("none.stl", "no such file"), ("folder.stl", "directory"), ("part.step", r"found \.step")):
        with pytest.raises(FileError, match=found):
            meshes.load(tmp_path / name)


@pytest.mark.parametrize("bad", [np.nan, np.inf])
@pytest.mark.parametrize("suffix", ["stl", "obj", "ply"])
def test_vertices_that_are_not_finite(suffix, bad, tmp_path):
    """NaN and infinity are a GeometryError, not a vertex less."""
    mesh = l_shape()
    vertices = np.array(mesh.vertices)
    vertices[3, 1] = bad
    broken = trimesh.Trimesh(vertices, mesh.faces, process=False)
    path = tmp_path / f"part.{suffix}"
    with np.errstate(all="ignore"):
        broken.export(path)
    for source in (path, broken):
        with pytest.raises(GeometryError, match="finite"):
            meshes.load(source)


def test_no_triangles(tmp_path):
    """Points alone are no mesh."""
    path = tmp_path / "points.ply"
    path.write_text(
        "ply\nformat ascii 1.0\nelement vertex 2\nproperty float x\nproperty float y\nproperty float z\nend_header\n"
        "0 0 0\n1 1 1\n"
    )
    with pytest.raises((GeometryError, FileError), match="points.ply"):
        meshes.load(path)
    with pytest.raises(GeometryError, match="no triangle"):
        meshes.load(trimesh.Trimesh(np.eye(3), np.empty((0, 3), dtype=int)))


def test_something_else():
    """Neither path nor mesh is an InputError that names its type."""
    with pytest.raises(InputError, match="found int"):
        meshes.load(3)


def test_indices_out_of_range():
    """Triangles that name vertices that are not there are refused."""
    mesh = trimesh.Trimesh(np.eye(3), [[0, 1, 7]], process=False, validate=False)
    with pytest.raises(GeometryError, match=r"0\.\.2"):
        meshes.load(mesh)


# -- pieces -------------------------------------------------------------------------------------


@pytest.mark.parametrize("flip", [False, True])
def test_convex_mesh_is_its_hull(flip):
    """A convex mesh, inside out or not, is one piece, exact, without decomposition."""
    mesh = trimesh.creation.icosphere(subdivisions=2)
    if flip:
        mesh.invert()
    pieces, covering = meshes.convex_pieces(mesh)
    assert covering.kind == "convex"
    assert covering.exact
    assert covering.max_uncovered == 0
    assert covering.excess_volume == pytest.approx(0, abs=1e-12)
    assert len(pieces) == 1
    assert len(pieces[0]) == len(mesh.vertices)


def test_convex_parts_are_pieces():
    """A mesh of separate boxes is as many pieces; the gap between them stays free."""
    body = loewner.Body.from_mesh(two_boxes())
    assert len(body.pieces) == 2
    assert body.covering.kind == "convex"
    T = np.eye(4)
    T[0, 3] = 1.5
    assert not loewner.collide(body, None, loewner.Body.sphere(0.5), T)


def test_cavity_is_no_convex_part():
    """A box with a hollow in it is not taken for two convex parts."""
    inner = trimesh.creation.box((1, 1, 1))
    inner.invert()
    mesh = trimesh.util.concatenate([trimesh.creation.box((2, 2, 2)), inner])
    _, covering = meshes.convex_pieces(mesh, threshold=1.0)
    assert covering.kind == "decomposition"


def test_hull_holds_the_mesh():
    """decompose=False gives one piece that holds every point of the surface."""
    pieces, covering = meshes.convex_pieces(l_shape(), decompose=False)
    assert len(pieces) == 1
    assert (covering.kind, covering.exact, covering.max_uncovered) == ("hull", True, 0.0)
    assert covering.excess_volume == pytest.approx(3.5 / 3 - 1)
    assert excess(surface_points(l_shape(), 500), pieces).max() < 1e-12


@pytest.mark.filterwarnings("ignore:mesh. 2e.04 m across")
@pytest.mark.parametrize(("scale", "shift"), [(1.0, 0.0), (1e-4, 0.0), (1e4, 1e6)])
def test_decomposition_covers_the_surface(scale, shift):
    """At any size and place, random points of the surface lie in the pieces; the hollow stays free."""
    mesh = l_shape(scale, shift)
    pieces, covering = meshes.convex_pieces(mesh)
    assert covering.kind == "decomposition"
    assert covering.exact
    size = scale + abs(shift)
    assert covering.max_uncovered <= 1e-9 * size
    assert excess(surface_points(mesh, 2000), pieces).max() <= 1e-9 * size
    assert 0 <= covering.excess_volume < 0.05
    hollow = np.array([[1.5, 1.5, 0.5]]) * scale + shift
    assert excess(hollow, pieces).max() > 0.3 * scale


@pytest.fixture(scope="module")
def bent():
    """A part of a real robot hand that is not convex, without and with covering."""
    path = panda("visual/finger.dae")
    return meshes.load(path), *(meshes.convex_pieces(path, threshold=0.3, cover=cover) for cover in (False, True))


def test_uncovered_bound_holds(bent):
    """No point of the surface is farther from CoACD's own pieces than `max_uncovered` says."""
    (vertices, triangles), (pieces, covering), _ = bent
    points = surface_points(trimesh.Trimesh(vertices, triangles, process=False), 20_000)
    # CoACD cuts corners: more points close to those of each triangle.
    weights = np.random.default_rng(1).dirichlet(np.full(3, 0.05), (60, len(triangles)))
    points = np.concatenate([points, np.einsum("nti,tik->ntk", weights, vertices[triangles]).reshape(-1, 3)])
    size = np.linalg.norm(np.ptp(vertices, axis=0))
    points = points[excess(points, pieces) > 1e-6 * size]
    assert len(points) >= 10
    farthest = np.min([naive_distance(points[:150], p) for p in pieces], axis=0).max()
    assert farthest <= covering.max_uncovered + 1e-7 * size
    assert covering.max_uncovered > 0
    assert not covering.exact


def test_covering_covers(bent):
    """With `cover`, random points of a real mesh's surface lie in the pieces, which grew little."""
    (vertices, triangles), (before, _), (pieces, covering) = bent
    mesh = trimesh.Trimesh(vertices, triangles, process=False)
    assert covering.exact
    assert excess(surface_points(mesh, 3000), pieces).max() <= 1e-9 * mesh.scale
    assert len(pieces) == len(before)
    volume = [sum(trimesh.convex.convex_hull(p).volume for p in some) for some in (before, pieces)]
    assert volume[0] <= volume[1] * (1 + 1e-9)
    assert volume[1] <= 1.1 * volume[0]


def naive_distance(points, vertices):
    """Distance to a hull by non-negative least squares over its vertices: no faces involved."""
    found = []
    for x in points:
        # The last row asks for weights that add up to one; at this weight it is kept to 1e-9.
        size = np.ptp(vertices, axis=0).max()
        rows = np.vstack([(vertices - x).T / size, np.full(len(vertices), 100.0)])
        weights = nnls(rows, [0, 0, 0, 100.0])[0]
        found.append(np.linalg.norm(weights @ (vertices - x)) / weights.sum())
    return np.array(found)


def test_distance_to_a_piece():
    """Distance of points to a hull, from its faces, is the least over its convex combinations; 0 inside."""
    rng = np.random.default_rng(3)
    vertices = rng.normal(size=(40, 3))
    points = rng.normal(size=(200, 3)) * 1.5
    found = meshes._distances(points, Polytope.from_points(vertices), 1e-10)
    np.testing.assert_allclose(found, naive_distance(points, vertices), atol=1e-8)


def test_open_mesh_is_decomposed_and_covered():
    """A box without a lid is no solid, and that is said; its surface is covered all the same."""
    mesh = trimesh.creation.box((1, 1, 1))
    mesh.update_faces(mesh.triangles_center[:, 2] < 0.49)
    with pytest.warns(UserWarning, match="mesh: has holes, .* may be FREE"):
        pieces, covering = meshes.convex_pieces(mesh, threshold=1.0)
    assert covering.exact
    assert np.isnan(covering.excess_volume)
    assert excess(surface_points(mesh, 500), pieces).max() <= 1e-9


def test_same_seed_same_pieces():
    """Decomposition repeats."""
    first, second = (meshes.convex_pieces(l_shape())[0] for _ in range(2))
    assert len(first) == len(second)
    for a, b in zip(first, second, strict=True):
        np.testing.assert_array_equal(a, b)


def test_max_pieces():
    """`max_pieces` is kept."""
    body = loewner.Body.from_mesh(l_shape(), max_pieces=1)
    assert len(body.pieces) == 1
    assert body.covering.exact


def test_real_collision_mesh_is_convex():
    """The Panda's collision meshes, soups of float32 triangles, are recognised as convex."""
    for name in ("link5", "hand", "finger"):
        assert meshes.convex_pieces(panda(f"collision/{name}.stl"))[1].kind == "convex"


def test_flat_mesh_is_refused():
    """A flat mesh carries no ellipsoid."""
    flat = trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]], [[0, 1, 2], [1, 3, 2]])
    for decompose in (True, False):
        with pytest.raises(GeometryError, match="plane"):
            meshes.convex_pieces(flat, decompose=decompose)


@pytest.mark.parametrize("options", [{"threshold": 0}, {"threshold": 2}, {"threshold": np.nan}, {"max_pieces": 0}])
def test_bad_options(options):
    """Options out of range are refused by name."""
    with pytest.raises(InputError, match=next(iter(options))):
        meshes.convex_pieces(l_shape(), **options)


def test_surface_verdicts(tmp_path):
    """FREE says that the mesh itself is apart: a ball that touches a corner of the L is never FREE."""
    body = loewner.Body.from_mesh(l_shape())
    corners = np.tile(np.eye(4), (12, 1, 1))
    corners[:, :3, 3] = l_shape().vertices
    verdicts = loewner.classify(body, None, loewner.Body.sphere(1e-3), corners)
    assert (verdicts != Verdict.FREE).all()
    assert loewner.collide(body, None, loewner.Body.sphere(1e-3), corners).all()
    body.save(tmp_path / "l.npz")
    assert loewner.Body.load(tmp_path / "l.npz").covering == body.covering


def test_missing_packages(monkeypatch, tmp_path):
    """Without CoACD the message names the extra; reading a file, and a convex mesh, needs neither it nor trimesh."""
    for suffix in ("stl", "dae", "glb"):
        trimesh.creation.box((1, 1, 1)).export(tmp_path / f"part.{suffix}")
    monkeypatch.setitem(sys.modules, "coacd", None)
    with pytest.raises(MissingExtraError, match=r'coacd.*pip install "loewner\[meshes\]"'):
        meshes.convex_pieces(l_shape())
    assert meshes.convex_pieces(trimesh.creation.box((1, 1, 1)))[1].kind == "convex"
    for package in ("trimesh", "lxml", "collada", "networkx"):
        monkeypatch.setitem(sys.modules, package, None)
    for suffix in ("stl", "dae", "glb"):
        assert meshes.convex_pieces(tmp_path / f"part.{suffix}")[1].kind == "convex"


def test_decomposition_is_silent(tmp_path):
    """CoACD writes nothing to standard output or error."""
    l_shape().export(tmp_path / "part.obj")
    code = f"from loewner import meshes; meshes.convex_pieces({str(tmp_path / 'part.obj')!r})"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, env=None)
    noise = [line for line in (done.stdout + done.stderr).splitlines() if not line.startswith("loewner: compiling")]
    assert noise == []


def test_binary_stl_with_a_text_header(tmp_path):
    """A binary STL whose header begins with "solid" is read as binary, and noticed if cut."""
    path = tmp_path / "part.stl"
    l_shape().export(path)
    data = path.read_bytes()
    path.write_bytes(b"solid part".ljust(80, b" ") + data[80:])
    assert len(meshes.load(path)[1]) == struct.unpack("<I", data[80:84])[0]
    path.write_bytes(b"solid part".ljust(80, b" ") + data[80:-30])
    with pytest.raises(FileError):
        meshes.load(path)
