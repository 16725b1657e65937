"""Meshes: read whole or refused; the pieces hold the mesh; convex meshes are left alone."""

import base64
import json
import os
import re
import signal
import struct
import subprocess
import sys
import threading
import tracemalloc
import warnings
from importlib.metadata import distribution
from types import SimpleNamespace

import numpy as np
import pytest
import trimesh
from scipy.optimize import nnls

import loewner
import made_parts
from families import translation
from loewner import FileError, GeometryError, InputError, MissingExtraError, Verdict
from loewner.ellipsoids.polytopes import Polytope
from loewner.meshes import coverage, plane_cuts
from loewner.meshes import decomposition as meshes
from sampling import quick

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
    path.write_bytes(path.read_bytes().replace(b"Y_UP", b"Z_UP"))
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
    text = path.read_text().replace("Y_UP", "Z_UP")
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


# -- whole or refused ---------------------------------------------------------------------------


def refused(tmp_path, name, data, match):
    """Both `load` and a body refuse the file, naming it and what is wrong."""
    path = tmp_path / name
    path.write_bytes(data if isinstance(data, bytes) else data.encode())
    for read in (meshes.load, lambda p: loewner.Body.from_mesh(p, decompose=False)):
        with pytest.raises((FileError, GeometryError), match=f"{path.name}.*{match}"):
            read(path)


def icosphere_obj():
    return trimesh.creation.icosphere(subdivisions=1).export(file_type="obj").splitlines()


def test_ragged_obj_is_refused(tmp_path):
    """A coordinate moved from one vertex to the next is no other body: the line with another count is named."""
    lines = icosphere_obj()
    first = next(i for i, line in enumerate(lines) if line.startswith("v "))
    x, y, z = lines[first + 2].split()[1:]
    lines[first + 2] = f"v {x} {y}"
    lines[first + 5] += f" {z}"
    refused(tmp_path, "part.obj", "\n".join(lines), f"line {first + 3}: expected a vertex of 3 numbers.*found 2")


@pytest.mark.parametrize(
    ("old", "new", "match"),
    [
        ("f 1 2 3", "f 0 2 3", r"line 5: expected a vertex counted from 1"),
        ("f 1 2 3", "f -5 2 3", r"line 5: .* found -5"),
        ("f 1 2 3", "f 1 2 5", r"line 5: expected a face of vertices 1\.\.4, found 5"),
        ("f 1 2 3", "f 1 2", r"line 5: expected a face of at least 3 corners"),
        ("f 1 2 3", "f 1 2 x", r"line 5: expected a whole number, found 'x'"),
        ("f 1 2 3", "f 1 2 3.0", r"line 5: expected a whole number, found '3.0'"),
        ("f 1 2 3", "f 1/1 2/x 3", r"line 5: expected a corner .* found '2/x'"),
        ("f 1 2 3", "f 1 f 2 3", r"line 5: expected a whole number, found 'f'"),
        ("v 0 1 0", "v 0 1\nv 0 v 0 1 0", r"line 3: expected a vertex of 3 numbers"),
        ("f 1 2 3", "f 1 2 99999999999999999999", r"line 5: expected a whole number"),
        ("v 0 1 0", "v 0 1_0 0", r"line 3: expected a number, found '1_0'"),
        ("v 0 1 0", "v 0 one 0", r"line 3: expected a number, found 'one'"),
        ("v 0 1 0", "v 0 1e400 0", r"expected finite vertices.* at vertex 2"),
        ("v 0 1 0", "w 0 1 0", r"line 3: expected a line of an OBJ file, found one that begins with 'w'"),
        ("v 0 1 0", "v 0 1 0 1 1", r"line 3: expected a vertex of 3 numbers"),
    ],
)
def test_wrong_lines_of_an_obj(old, new, match, tmp_path):
    """An index that no vertex has, a word that is no number, a line that is none of the format: named by line."""
    lines = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\nf 1 2 4\nf -3 -2 -1\nf 1 3 4\n"
    (tmp_path / "whole.obj").write_text(lines)
    assert len(meshes.load(tmp_path / "whole.obj")[1]) == 4
    refused(tmp_path, "part.obj", lines.replace(old, new), match)


def test_obj_line_numbers_behind_continued_lines_and_comments(tmp_path):
    """A line goes on behind a backslash; the lines behind it keep their numbers; line ends may be any."""
    lines = "# one\nv 0 \\\n0 0\nv 1 0 0 # x\nv 0 1 0\nf 1 2 3\nf 1 2 0\n"
    for end in ("\n", "\r\n", "\r"):
        refused(tmp_path, "part.obj", lines.replace("\n", end).encode(), "line 7: expected a vertex counted from 1")
        (tmp_path / "whole.obj").write_bytes(lines.replace("f 1 2 0\n", "").replace("\n", end).encode())
        assert meshes.load(tmp_path / "whole.obj")[0].tolist() == [[0, 0, 0], [1, 0, 0], [0, 1, 0]]


PLY = """ply
format ascii 1.0
element vertex 4
property float x
property float y
property float z
element face 4
property list uchar int vertex_indices
end_header
0 0 0
1 0 0
0 1 0
0 0 1
3 0 1 2
3 0 1 3
3 1 2 3
3 0 2 3
"""
OFF = "OFF\n4 4 0\n0 0 0\n1 0 0\n0 1 0\n0 0 1\n3 0 1 2\n3 0 1 3\n3 1 2 3\n3 0 2 3\n"


@pytest.mark.parametrize(
    ("name", "old", "new", "match"),
    [
        ("ply", "vertex 4", "vertex 5", "expected 9 lines as its header says, found 8"),
        ("ply", "face 4", "face 3", "expected 7 lines as its header says, found 8"),
        ("ply", "vertex 4\n", "vertex 3\n", "expected 7 lines"),
        ("ply", "1 0 0", "1 0", "line 11: expected 3 numbers for a vertex, found 2"),
        ("ply", "1 0 0", "1 0 x", "line 11: expected a number, found 'x'"),
        ("ply", "3 0 1 3", "3 0 1", "line 15: expected a list of 3 numbers, found 2"),
        ("ply", "3 0 1 3", "3 0 1 -1", "expected a face to name vertices 0..3, found -1"),
        ("ply", "3 0 1 3", "2 0 1", "face 1: expected at least 3 corners"),
        ("ply", "property float z", "property float w", "x, y and z"),
        ("off", "4 4 0", "4 3 0", "expected 7 lines"),
        ("off", "4 4 0", "5 4 0", "expected 9 lines"),
        ("off", "1 0 0", "1 0", "line 4: expected a vertex of 3 numbers"),
        ("off", "3 0 1 3", "3 0 1 4", r"line 8: expected a face to name vertices 0\.\.3, found 4"),
        ("off", "3 0 1 3", "3 0 1 -2", "line 8: .* found -2"),
        ("off", "OFF", "4OFF", "found one that begins with '4OFF'"),
    ],
)
def test_counts_and_indices_of_ply_and_off(name, old, new, match, tmp_path):
    """What a header declares is there, no more and no less; indices are of vertices that are there."""
    text = {"ply": PLY, "off": OFF}[name]
    (tmp_path / f"whole.{name}").write_text(text)
    assert len(meshes.load(tmp_path / f"whole.{name}")[1]) == 4
    refused(tmp_path, f"part.{name}", text.replace(old, new, 1), match)


@pytest.mark.parametrize("suffix", ["stl", "ply", "off"])
def test_absurd_counts_take_no_memory(suffix, tmp_path):
    """A header that declares four thousand million faces is refused before anything is allocated for them."""
    mesh = l_shape()
    data = mesh.export(file_type=suffix)
    if suffix == "stl":
        data = data[:80] + struct.pack("<I", 4_000_000_000) + data[84:]
    else:
        data = data.encode() if isinstance(data, str) else data
        data = data.replace(
            b"face 20" if suffix == "ply" else b"12 20", b"face 4000000000" if suffix == "ply" else b"12 4000000000"
        )
        assert b"4000000000" in data
    tracemalloc.start()
    try:
        refused(tmp_path, f"part.{suffix}", data, "expected")
        assert tracemalloc.get_traced_memory()[1] < 2**20
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize("extra", [b"\0", b"\0" * 50, b"more"])
@pytest.mark.parametrize("suffix", ["stl", "ply", "glb"])
def test_bytes_behind_the_end_are_refused(suffix, extra, tmp_path):
    """More bytes than a binary file declares: its counts may be what is damaged."""
    refused(tmp_path, f"part.{suffix}", l_shape().export(file_type=suffix) + extra, "found")


@pytest.mark.parametrize(
    ("old", "new", "match"),
    [
        ("vertex", "vertx", "line 4: expected vertex and 3 numbers"),
        ("endloop", "", "line 8: expected endloop"),
        ("facet normal 0 0 1", "facet normal 0 0", "line 2: expected facet normal and 3 numbers"),
        ("vertex 1 0 0", "vertex 1 0 0 0", "line 5: expected vertex"),
        ("vertex 1 0 0", "vertex 1 0 zero", "line 5: expected a number, found 'zero'"),
        ("endfacet", "endfacet\nendsolid\nvertex 0 0 0", "elsewhere"),
        ("endsolid", "", "cut before its endsolid"),
    ],
)
def test_lines_of_a_text_stl(old, new, match, tmp_path):
    """Every line of a text STL is the one that belongs there."""
    facet = "facet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop\nendfacet\n"
    text = f"solid a part\n{facet}endsolid a part\n"
    (tmp_path / "whole.stl").write_text(2 * text.upper())
    assert len(meshes.load(tmp_path / "whole.stl")[1]) == 2
    refused(tmp_path, "part.stl", text.replace(old, new, 1), match)


def gltf(change=None):
    """A tetrahedron as glTF with its buffer inside, its tree changed."""
    body = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], "<f4").tobytes() + bytes(
        [0, 2, 1, 0, 1, 3, 1, 2, 3, 0, 3, 2]
    )
    tree = {
        "asset": {"version": "2.0"},
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, "children": [1]}, {"translation": [1, 0, 0]}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 4, "type": "VEC3"},
            {"bufferView": 1, "componentType": 5121, "count": 12, "type": "SCALAR"},
        ],
        "bufferViews": [{"buffer": 0, "byteLength": 48}, {"buffer": 0, "byteOffset": 48, "byteLength": 12}],
        "buffers": [{"byteLength": 60, "uri": "data:;base64," + base64.b64encode(body).decode()}],
    }
    if change is not None:
        change(tree)
    return json.dumps(tree)


@pytest.fixture(scope="module")
def sound_gltf(tmp_path_factory):
    """The body of the file without a change."""
    path = tmp_path_factory.mktemp("sound") / "whole.gltf"
    path.write_text(gltf())
    return loewner.Body.from_mesh(path)


@pytest.mark.parametrize(
    ("change", "match"),
    [
        (lambda t: t["nodes"][1].update(children=[0]), r"expected a tree of nodes, found nodes\[0\] in it twice"),
        (lambda t: t["nodes"][1].update(children=[1]), "twice"),
        (lambda t: t["nodes"][0].update(children=[1, 1]), "twice"),
        (lambda t: t["nodes"][0].update(children=[7]), "expected one of 2 nodes, found number 7"),
        (lambda t: t["accessors"][0].update(count=4_000_000_000), "count of at most"),
        (
            lambda t: t["accessors"][0].update(count=5),
            r"accessors\[0\]: expected 60 bytes in bufferViews\[0\], found 48",
        ),
        (lambda t: t["accessors"][0].update(count=3), r"indices to name vertices 0\.\.2, found 3"),
        (lambda t: t["accessors"][1].update(count=11), "three corners a triangle"),
        (lambda t: t["accessors"][1].update(componentType=5120), "indices of unsigned whole numbers"),
        (lambda t: t["accessors"][0].pop("bufferView"), "expected a bufferView"),
        (lambda t: t["bufferViews"][0].update(byteOffset=20), "bufferViews.0.: expected|found"),
        (lambda t: t["buffers"][0].update(byteLength=61), "expected 61 bytes as it says, found 60"),
        (lambda t: t["buffers"][0].update(uri="data:;base64,AAAA!"), "expected data in base64"),
        (lambda t: t["buffers"][0].update(uri="../secret.bin"), "in the folder of this one or below"),
        (lambda t: t["buffers"][0].update(uri="%2e%2e/secret.bin"), "in the folder of this one or below"),
        (lambda t: t["buffers"][0].update(uri="/etc/hostname"), "in the folder of this one or below"),
        (lambda t: t["buffers"][0].update(uri="https://a.example/b.bin"), "in the folder of this one or below"),
        (
            lambda t: t["buffers"][0].update(uri="none.bin"),
            "none.bin: expected a buffer of a glTF file, but there is no such file",
        ),
        (lambda t: t["buffers"][0].update(uri="%00.bin"), "a name that no file can have"),
        (lambda t: t.update(extensionsRequired=["KHR_draco_mesh_compression"]), "KHR_draco_mesh_compression"),
        (lambda t: t["meshes"][0]["primitives"][0].update(extensions={"KHR_draco_mesh_compression": {}}), "draco"),
        (lambda t: t["nodes"][0].update(skin=0), "a skin"),
        (lambda t: t["meshes"][0].update(weights=[0.5]), "morph"),
        (lambda t: t["nodes"][0].update(rotation=[0, 0, 0, 2]), "rotation of length 1"),
        (lambda t: t["nodes"][0].update(matrix=[1.0] * 16), "affine"),
        (lambda t: t["nodes"][0].update(translation=[1e200, 0, 10**400]), "3 finite numbers"),
        (lambda t: t["nodes"][0].update(translation=[float("nan"), 0, 0]), "expected JSON, found NaN"),
        (lambda t: t["nodes"][0].update(mesh=True), "expected mesh, a whole number"),
        (lambda t: t["asset"].update(version="1.0"), "version 2"),
    ],
)
def test_gltf_that_is_not_sound(sound_gltf, change, match, tmp_path):
    """Cycles, counts, ranges, links outside the folder, and what is not decoded: refused by name."""
    assert sound_gltf.covering.kind == "convex"
    refused(tmp_path, "part.gltf", gltf(change), match)


def test_deep_and_broken_json(tmp_path):
    """JSON nested without end, a key given twice, and what is no JSON."""
    refused(tmp_path, "part.gltf", "[" * 100_000, "expected JSON")
    refused(
        tmp_path,
        "part.gltf",
        gltf().replace('"scenes"', '"asset": 1, "scenes"'),
        "line 1: expected each key once.*'asset' again",
    )
    refused(tmp_path, "part.gltf", gltf()[:-40], "expected JSON")
    refused(tmp_path, "part.gltf", b"\xff\xfe", "expected JSON")


def test_vertices_of_a_gltf_file_that_are_not_finite(tmp_path):
    """NaN in a buffer is a GeometryError."""

    def spoil(tree):
        data = base64.b64decode(tree["buffers"][0]["uri"].partition(",")[2])
        tree["buffers"][0]["uri"] = "data:;base64," + base64.b64encode(data[:12] + b"\xff" * 4 + data[16:]).decode()

    refused(tmp_path, "part.gltf", gltf(spoil), "expected finite vertices.* at vertex 1")


def dae():
    mesh = trimesh.creation.box((1, 1, 1))
    return trimesh.Trimesh(mesh.vertices, mesh.faces).export(file_type="dae").decode().replace("Y_UP", "Z_UP")


@pytest.mark.parametrize(
    ("old", "new", "match"),
    [
        (r"<COLLADA", '<!DOCTYPE a [<!ENTITY b "c">]><COLLADA', "expected a Collada file, found a document type"),
        (r"<asset>", "<asset>" + "<a>" * 1000, "found more than 200 elements inside each other"),
        (r"(<float_array [^>]*>)\S+", r"\1NaN", "expected finite vertices"),
        (r"(<float_array [^>]*>)\S+", r"\1half", "<float_array>: expected a number, found 'half'"),
        (r"(<float_array [^>]*>)\S+", r"\1", "<float_array>: expected 24 numbers, found 23"),
        (r"<p>\S+", "<p>-1", r"<p>: expected <p>|<p> to name vertices 0\.\.7, found -1"),
        (r"<p>\S+", "<p>8", r"<p> to name vertices 0\.\.7, found 8"),
        (r"<p>\S+ \S+ \S+ ", "<p>", "corner"),
        (r'triangles count="12"', 'triangles count="11"', "expected 33 corners, found 36"),
        (r'meter="1[.0]*"', 'meter="0"', "expected metres > 0"),
        (r"<instance_geometry[^>]*>", '<instance_controller url="#x">', "rigid mesh|XML"),
        (
            r'instance_geometry url="#[^"]*"',
            'instance_geometry url="#none"',
            "expected one <geometry> with id 'none', found 0",
        ),
        (
            r"<node ",
            '<node id="loop"><instance_node url="#loop"/></node><node ',
            "at most 200 deep, found more, or a cycle",
        ),
        (
            r"<node ",
            "<node><skew>0 0 0 1 0 0 1</skew><instance_geometry url='#x'/></node><node ",
            "without lookat and skew",
        ),
    ],
)
def test_collada_that_is_not_sound(old, new, match, tmp_path):
    """Entities, depth, counts, ranges, cycles and what is not read: refused, with the line."""
    text = dae()
    if "<unit" not in text:
        text = text.replace("<asset>", '<asset><unit meter="1.0" name="meter"/>')
    (tmp_path / "whole.dae").write_text(text)
    assert meshes.convex_pieces(tmp_path / "whole.dae")[1].kind == "convex"
    changed = re.sub(old, new, text, count=1)
    assert changed != text
    refused(tmp_path, "part.dae", changed, match)


def test_nodes_shown_exponentially_often(tmp_path):
    """Thirty nodes, each showing the next twice, are 2^30 of them: refused at a stated number."""
    nodes = "".join(
        f'<node id="n{k}"><instance_node url="#n{k + 1}"/><instance_node url="#n{k + 1}"/></node>' for k in range(30)
    )
    text = re.sub(r"<node ", nodes.replace("\\", "") + '<node id="n30"/><node ', dae(), count=1)
    refused(tmp_path, "part.dae", text, "expected at most 200000 nodes and parts of nodes")


def test_absurdly_many_properties(tmp_path):
    """Ten thousand properties of a vertex are refused at the first too many, not compared with one another."""
    many = "".join(f"property float p{k}\n" for k in range(10_000))
    refused(
        tmp_path, "part.ply", PLY.replace("element face", many + "element face"), "line 1004: expected at most 1000"
    )


def test_one_mesh_shown_too_often(tmp_path):
    """A file may show a mesh many times, but not until it has more triangles than any machine holds."""

    def change(tree):
        tree["nodes"] = [{"mesh": 0}] * 400
        tree["scenes"][0]["nodes"] = list(range(400))

    (tmp_path / "part.gltf").write_text(gltf(change))
    assert len(meshes.load(tmp_path / "part.gltf")[1]) == 1600
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("loewner.meshes.files.parts.MOST", 1500)
        refused(tmp_path, "part.gltf", gltf(change), "expected at most 1500 vertices")


def test_what_is_no_regular_file(tmp_path):
    """A pipe without a writer, a device, and names that no file can have are FileErrors, at once."""
    os.mkfifo(tmp_path / "pipe.stl")
    (tmp_path / "zero.obj").symlink_to("/dev/zero")
    for name, match in (
        ("pipe.stl", "found a pipe"),
        ("zero.obj", "found a device"),
        ("a\0b.stl", "name that no file can have"),
        ("a\ud800.stl", "name that no file can have"),
        ("x" * 300 + ".stl", "too long"),
    ):
        for read in (meshes.load, loewner.Body.from_mesh):
            with pytest.raises(FileError, match=match) as caught:
                read(tmp_path / name)
            str(caught.value).encode()


def test_size_limit(tmp_path, monkeypatch):
    """A file larger than the limit is refused, and the message gives the limit."""
    monkeypatch.setattr("loewner.meshes.files.LIMIT", 1000)
    refused(
        tmp_path,
        "part.stl",
        l_shape().export(file_type="stl"),
        "expected a mesh file of at most 1000 bytes, found 1084",
    )


def test_meshes_in_memory_that_are_not_sound():
    """Shapes, types and scenes that cannot be joined are GeometryErrors or InputErrors."""
    for vertices, faces, match in (
        (np.eye(4), [[0, 1, 2]], r"mesh\.vertices: expected shape"),
        (np.eye(3), [[0, 1, 2, 3]], r"mesh\.faces: expected shape"),
        (np.eye(3), [[0.5, 1, 2]], "whole numbers"),
        ([["a", "b", "c"]], [[0, 0, 0]], "real numbers"),
    ):
        with pytest.raises(InputError, match=match):
            meshes.load(SimpleNamespace(vertices=vertices, faces=faces))

    class Broken:
        def to_mesh(self):
            raise ValueError("a cycle")

    with pytest.raises(GeometryError, match="a cycle"):
        meshes.load(Broken())


def test_polygons_and_every_kind_of_ply(tmp_path):
    """Binary PLY in both byte orders, with lists of different lengths and other properties, is what its text is."""
    vertices = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0.5, 0.5, 1]])
    faces = [[3, 2, 1, 0], [0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]]
    for name, order in (("little", "<"), ("big", ">")):
        data = PLY.split("end_header")[0].replace("vertex 4", "vertex 5").replace("face 4", "face 5").encode()
        data = data.replace(b"ascii", f"binary_{name}_endian".encode()) + b"end_header\n"
        data += np.asarray(vertices, order + "f4").tobytes()
        data += b"".join(struct.pack(f"{order}B{len(f)}i", len(f), *f) for f in faces)
        (tmp_path / "part.ply").write_bytes(data)
        found, triangles = meshes.load(tmp_path / "part.ply")
        assert found.tolist() == vertices.tolist()
        assert triangles.tolist() == [[3, 2, 1], [3, 1, 0], *faces[1:]]
        assert meshes.convex_pieces(tmp_path / "part.ply")[1].kind == "convex"


# -- units --------------------------------------------------------------------------------------


@pytest.mark.parametrize(("size", "match"), [(2500.0, "millimetres.*scale=0.001"), (5e-5, "scaled to metres twice")])
def test_size_of_another_unit_is_asked_about(size, match, tmp_path):
    """A mesh of kilometres, or of a twentieth of a millimetre, warns; scaled to a usual size it does not."""
    box = trimesh.creation.box((size, size / 2, size / 3))
    box.export(tmp_path / "part.stl")
    for source in (box, tmp_path / "part.stl"):
        with pytest.warns(UserWarning, match=match) as caught:
            loewner.Body.from_mesh(source)
        assert len(caught) == 1
        loewner.Body.from_mesh(source, scale=1 / size)
    with pytest.warns(UserWarning, match=match):
        loewner.Body.from_mesh(trimesh.creation.box((1, 1, 1)), scale=size)


@pytest.mark.parametrize("make", [loewner.Body.from_surface, loewner.Body.from_mesh])
def test_triangles_that_are_no_array(make):
    """Rows of different lengths, and entries that are masked, are no triangles."""
    box = trimesh.creation.box((1, 1, 1))
    for faces, told in (
        ([[0, 1, 2], [0, 1]], "mesh.faces: expected an array of numbers, found a ragged sequence"),
        (np.ma.array(box.faces, mask=np.eye(12, 3, dtype=bool)), "mesh.faces: expected numbers only, found masked"),
    ):
        with pytest.raises(InputError, match=told):
            make((box.vertices, faces))


def test_scale_that_overflows():
    """Finite vertices times a finite scale beyond all numbers are refused."""
    box = trimesh.creation.box((1, 1, 1))
    with pytest.raises(GeometryError, match="expected finite vertices"):
        loewner.Body.from_mesh(SimpleNamespace(vertices=box.vertices * 1e200, faces=box.faces), scale=1e200)


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
    assert not loewner.collide(body, None, loewner.Body.sphere(0.5), translation(1.5))


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
@pytest.mark.parametrize(
    ("scale", "shift"), [(1e4, 1e6), *(pytest.param(k, 0.0, marks=pytest.mark.verify) for k in (1e-4, 1.0))]
)
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


@pytest.mark.parametrize("count", quick(20, 150))
def test_uncovered_bound_holds(bent, count):
    """No point of the surface is farther from CoACD's own pieces than `max_uncovered` says."""
    (vertices, triangles), (pieces, covering), _ = bent
    points = surface_points(trimesh.Trimesh(vertices, triangles, process=False), 100 * count)
    # CoACD cuts corners: more points close to those of each triangle.
    weights = np.random.default_rng(1).dirichlet(np.full(3, 0.05), (count, len(triangles)))
    points = np.concatenate([points, np.einsum("nti,tik->ntk", weights, vertices[triangles]).reshape(-1, 3)])
    size = np.linalg.norm(np.ptp(vertices, axis=0))
    points = points[excess(points, pieces) > 1e-6 * size]
    assert len(points) >= 10
    farthest = np.min([naive_distance(points[:count], p) for p in pieces], axis=0).max()
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
    found = coverage.distances_from(points, Polytope.from_points(vertices), 1e-10)
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


@pytest.mark.verify
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


def test_a_path_that_fails_is_refused():
    """An object of the caller's may raise anything when it is asked for its path."""

    class Sulky:
        def __fspath__(self):
            raise RuntimeError("not today")

    for make in (loewner.Body.from_mesh, loewner.Body.from_surface, meshes.convex_pieces, meshes.load):
        with pytest.raises(InputError, match="source: expected the path of a file, found .*not today"):
            make(Sulky())


def test_flat_mesh_is_refused(tmp_path):
    """A flat mesh carries no ellipsoid; the message begins with its name."""
    flat = trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]], [[0, 1, 2], [1, 3, 2]])
    for decompose in (True, False):
        with pytest.raises(GeometryError, match="^mesh: .*plane"):
            meshes.convex_pieces(flat, decompose=decompose)
        flat.export(tmp_path / "flat.stl")
        with pytest.raises(GeometryError, match="^[^:]*flat.stl: .*plane"):
            meshes.convex_pieces(tmp_path / "flat.stl", decompose=decompose)


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
    (tmp_path / "part.dae").write_text((tmp_path / "part.dae").read_text().replace("Y_UP", "Z_UP"))
    monkeypatch.setitem(sys.modules, "coacd", None)
    with pytest.raises(MissingExtraError, match=r'coacd.*pip install "loewner\[meshes\]"'):
        meshes.convex_pieces(l_shape())
    assert meshes.convex_pieces(trimesh.creation.box((1, 1, 1)))[1].kind == "convex"
    for package in ("trimesh", "lxml", "collada", "networkx"):
        monkeypatch.setitem(sys.modules, package, None)
    for suffix in ("stl", "dae", "glb"):
        assert meshes.convex_pieces(tmp_path / f"part.{suffix}")[1].kind == "convex"


@pytest.mark.verify
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


def test_a_decomposition_is_interrupted_at_once():
    """Foreign code that takes long does not keep an interrupt waiting; what it raises is raised."""
    started, end = threading.Event(), threading.Event()

    def long() -> None:
        started.set()
        end.wait(60)

    def interrupt() -> None:
        started.wait()
        os.kill(os.getpid(), signal.SIGINT)

    threading.Thread(target=interrupt).start()
    with pytest.raises(KeyboardInterrupt):
        meshes._interruptible(long)
    assert not end.is_set(), "the work has not ended"
    end.set()
    with pytest.raises(ZeroDivisionError):
        meshes._interruptible(lambda: 1 // 0)
    assert meshes._interruptible(lambda: 5) == 5


@pytest.mark.verify
def test_thin_cells_are_not_cut_across_their_width_without_end(tmp_path, monkeypatch):
    """Where floor and wall of a mug share edges, planes leave a ring as thin as rounding: it was cut into 2,000."""
    cuts, cut = [], plane_cuts._cut
    monkeypatch.setattr(plane_cuts, "_cut", lambda *given: cuts.append(given) or (len(cuts) < 500 and cut(*given)))
    made_parts.part(258).export(tmp_path / "mug.stl")  # in single precision, which is what makes edges shared
    with warnings.catch_warnings():
        # Rounding decides whether the last sliver is above the tolerance, and so named in a warning.
        warnings.filterwarnings("ignore", "(?s).*expected pieces that stick out by at most", UserWarning)
        body = loewner.Body.from_mesh(tmp_path / "mug.stl", tolerance=0.002)
    assert len(cuts) < 200
    assert len(body.pieces) < 50
