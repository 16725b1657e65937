"""What a mesh file says beside its surface: read, refused with its line, or told; never passed over in silence."""

import base64
import json
import re
import struct
import warnings

import numpy as np
import pytest

from loewner import FileError, GeometryError
from loewner.meshes import decomposition as meshes

CUBE = [(x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)]
FACES = [
    *((0, 1, 3), (0, 3, 2), (4, 6, 7), (4, 7, 5), (0, 4, 5), (0, 5, 1)),
    *((2, 3, 7), (2, 7, 6), (0, 2, 6), (0, 6, 4), (1, 5, 7), (1, 7, 3)),
]


def load(tmp_path, name, content):
    """Number of triangles, the corners of the box of a file's surface, and the warnings."""
    (tmp_path / name).write_bytes(content if isinstance(content, bytes) else content.encode())
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        vertices, triangles = meshes.load(tmp_path / name)
    used = vertices[triangles].reshape(-1, 3)
    return (len(triangles), used.min(axis=0).tolist(), used.max(axis=0).tolist()), [str(one.message) for one in told]


def refused(tmp_path, name, content, match):
    with pytest.raises(FileError, match=f"{re.escape(name)}.*{match}"):
        load(tmp_path, name, content)


WHOLE = (12, [0, 0, 0], [1, 1, 1])

# -- OBJ ----------------------------------------------------------------------------------------

OBJ = ["v " + " ".join(map(str, p)) for p in CUBE] + ["f " + " ".join(str(i + 1) for i in f) for f in FACES]


@pytest.mark.parametrize(
    "line",
    ["# part of C:\\work\\", "mtllib C:\\parts\\", "usemtl a\\", "g left\\", "o part\\", "vt 0 0 \\", "f 1 2 3 # a\\"],
)
@pytest.mark.parametrize("at", [0, 8, 19])
def test_a_backslash_behind_what_is_passed_over(line, at, tmp_path):
    """The next line would be passed over, too: refused with the line. At the end of the file there is none."""
    text = "\n".join([*OBJ[:at], line, *OBJ[at:]])
    refused(
        tmp_path, "part.obj", text, f"line {at + 1}: expected a vertex or a face where a backslash continues a line"
    )
    assert load(tmp_path, "part.obj", "\n".join([*OBJ, "g part\\"])) == (WHOLE, [])


@pytest.mark.parametrize("word", ["x", "1_0", "9" * 19, "9" * 30])
def test_the_number_that_is_refused_is_named(word, tmp_path):
    """An index with many leading zeros is read; the refusal names the first word that is not a number of 64 bits."""
    zeros = "f 1 2 " + "0" * 30 + "3"
    assert load(tmp_path, "part.obj", "\n".join([*OBJ, zeros]))[0][0] == len(FACES) + 1
    match = f"line {len(OBJ) + 2}: expected a whole number, found '{word}'"
    refused(tmp_path, "part.obj", "\n".join([*OBJ, zeros, f"f 1 2 {word}"]), match)


def test_vertices_and_faces_may_continue(tmp_path):
    """A line that ends in a backslash goes on in the next one, for vertices and faces."""
    text = "\n".join([OBJ[0].replace(" ", " \\\n"), *OBJ[1:-1], OBJ[-1].replace(" ", "\\\n ") + " # the last"])
    assert load(tmp_path, "part.obj", text) == (WHOLE, [])


# -- STL and PLY --------------------------------------------------------------------------------


def text_stl(normal="0 0 0", name="part"):
    facets = [
        f"facet normal {normal}\nouter loop\n" + "".join(f"vertex {x} {y} {z}\n" for x, y, z in (CUBE[i] for i in f))
        for f in FACES
    ]
    return f"solid {name}\n" + "".join(facet + "endloop\nendfacet\n" for facet in facets) + "endsolid\n"


@pytest.mark.parametrize("word", ["0", "nan", "-nan", "-nan(ind)", "nan(snan)", "-1.#IND", "1.#QNAN", "none"])
def test_normals_of_a_text_stl_are_any_three_words(word, tmp_path):
    """Normals are not read, so words that are no numbers are no fault."""
    assert load(tmp_path, "part.stl", text_stl(f"{word} {word} {word}")) == (WHOLE, [])
    refused(tmp_path, "part.stl", text_stl(f"{word} {word}"), "line 2: expected facet normal and 3 numbers")
    refused(tmp_path, "part.stl", text_stl().replace("vertex 0 0 0", f"vertex 0 0 {word}x", 1), "line 4: .* number")


def ply(element="face", head="", vertex="", more=0):
    return (
        f"ply\nformat ascii 1.0\n{head}element vertex {8 + more}\nproperty float x\nproperty float y\n"
        f"property float z\nelement {element} 12\nproperty list uchar int vertex_indices\nend_header\n"
        + "".join(f"{x} {y} {z}\n" for x, y, z in CUBE)
        + vertex
        + "".join(f"3 {a} {b} {c}\n" for a, b, c in FACES)
    )


@pytest.mark.parametrize("element", ["Face", "faces", "polygon", "triangle", "tristrips"])
def test_polygons_in_another_element_of_a_ply(element, tmp_path):
    """Half of a cube would be there, or nothing; corners in a texture are no polygons, and no rows are none."""
    assert load(tmp_path, "part.ply", ply()) == (WHOLE, [])
    rest = f"element {element} {{}}\nproperty list uchar int {{}}\n"
    more = ply(head=rest.format(1, "vertex_indices"))
    refused(tmp_path, "part.ply", more, f"line 3: expected faces, found lists in '{element}'")
    assert load(tmp_path, "part.ply", ply(head=rest.format(0, "vertex_indices"))) == (WHOLE, [])
    texture = ply(head="element multi_texture_face 1\nproperty list uchar int texture_vertex_indices\n")
    assert load(tmp_path, "part.ply", texture.replace("end_header\n", "end_header\n3 0 1 2\n")) == (WHOLE, [])


@pytest.mark.parametrize("word", ["nan", "inf"])
def test_vertices_without_faces_need_not_be_finite(word, tmp_path):
    """They are left out, and the others keep their order; a vertex of a face is refused by its number."""
    whole = load(tmp_path, "part.ply", ply(vertex=f"{word} 0 0\n", more=1))
    assert whole == (WHOLE, [])
    lines = [f"v {word} 0 0", *OBJ[:8], *(re.sub(r"\d+", lambda i: str(int(i[0]) + 1), face) for face in OBJ[8:])]
    assert load(tmp_path, "part.obj", "\n".join(lines)) == (WHOLE, [])
    assert meshes.load(tmp_path / "part.obj")[0].tolist() == [list(p) for p in CUBE]
    with pytest.raises(
        GeometryError, match=rf"part.obj: expected finite vertices, found \[{word}, 0.0, 0.0\] at vertex 0"
    ):
        load(tmp_path, "part.obj", "\n".join([*lines, "f 1 2 3"]))
    vertices, triangles = meshes.load(([(np.nan, 0, 0), *CUBE], np.array(FACES) + 1))
    assert (vertices.tolist(), triangles.tolist()) == ([list(p) for p in CUBE], [list(f) for f in FACES])


# -- units in comments --------------------------------------------------------------------------


def binary_stl(header):
    facets = b"".join(struct.pack("<12fH", 0, 0, 0, *CUBE[a], *CUBE[b], *CUBE[c], 0) for a, b, c in FACES)
    return header.ljust(80) + struct.pack("<I", 12) + facets


OFF = "OFF\n8 12 0\n" + "".join(f"{x} {y} {z}\n" for x, y, z in CUBE) + "".join(f"3 {a} {b} {c}\n" for a, b, c in FACES)


@pytest.mark.parametrize(
    "words",
    [
        "Units: millimeters",
        "UNITS=mm",
        "unit mm",
        "File units = centimeters",
        "length_unit: cm",
        "units in mm",
        "unit is inch",
        "Units: in",
    ],
)
def test_units_in_comments_are_told(words, tmp_path):
    """Once for each file, with the words; the lengths stay what they are."""
    for name, content in (
        ("part.obj", "\n".join([f"# made by hand, {words}", *OBJ])),
        ("end.obj", "\n".join([*OBJ, f"# {words}", f"# {words}"])),
        ("part.off", OFF.replace("OFF\n", f"OFF # {words}\n")),
        ("part.ply", ply(head=f"comment {words}\nobj_info {words}\n")),
        ("part.stl", binary_stl(words.encode())),
        ("text.stl", text_stl(name=f"part {words}")),
    ):
        found, told = load(tmp_path, name, content)
        assert found == WHOLE
        (text,) = told
        assert re.search(f"{name}: expected lengths in metres, found .* in a comment, which is not read", text), text


@pytest.mark.parametrize(
    "words",
    [
        "Units: meters",
        "unit = m",
        "units",
        "the unit in question",
        "a community inch by inch",
        "unity mm",
        "unit normals",
        "units in scene",
        "7 mm",
    ],
)
def test_comments_without_another_unit_are_not_told(words, tmp_path):
    """Only a unit that differs from metres causes a warning."""
    assert load(tmp_path, "part.obj", "\n".join([f"# {words}", *OBJ])) == (WHOLE, [])
    assert load(tmp_path, "part.stl", binary_stl(words.encode())) == (WHOLE, [])


# -- Collada ------------------------------------------------------------------------------------


def dae(
    unit='<unit meter="1"/>', node="", geometry="", visual="", names="XYZ", before="", up="Z_UP", points=None, extra=""
):
    numbers = points or " ".join(str(x) for p in CUBE for x in p)
    params = "".join(f'<param name="{name}" type="float"/>' if name else "<param/>" for name in names)
    return f"""<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">{before}
<asset>{unit}<up_axis>{up}</up_axis></asset>
<library_geometries><geometry id="g">{geometry}<mesh>
<source id="s"><float_array id="f" count="24">{numbers}</float_array>
<technique_common><accessor source="#f" count="8" stride="3">{params}</accessor></technique_common></source>
<vertices id="v"><input semantic="POSITION" source="#s"/></vertices>
<triangles count="12"><input semantic="VERTEX" source="#v" offset="0"/>
<p>{" ".join(str(i) for f in FACES for i in f)}</p></triangles></mesh></geometry></library_geometries>
<library_visual_scenes><visual_scene id="w">{visual}<node>{node}<instance_geometry url="#g"/></node></visual_scene>
</library_visual_scenes><scene><instance_visual_scene url="#w"/></scene>{extra}</COLLADA>"""


MM = '<unit name="millimeter" meter="0.001"/>'


@pytest.mark.parametrize(
    ("options", "match"),
    [
        ({"geometry": f"<asset>{MM}</asset>"}, "expected the file's unit, 1 m, found 0.001 m"),
        ({"visual": f"<asset>{MM}</asset>"}, "expected the file's unit, 1 m, found 0.001 m"),
        ({"node": f"<asset>{MM}</asset>"}, "expected the file's unit, 1 m, found 0.001 m"),
        ({"unit": "", "before": MM}, "line 1: <COLLADA>: expected elements of Collada .*, found <'unit'>"),
        ({"unit": '<unit meter="1"/>' + MM}, "line 2: expected one <unit> in <asset>, found another one in line 2"),
        ({"before": "<asset/>"}, "line 2: expected one <asset> in <COLLADA>"),
        ({"unit": '<unit Meter="0.001"/>'}, "line 2: <unit>: expected attributes of Collada .*, found 'Meter'"),
        ({"unit": '<Unit meter="0.001"/>'}, "line 2: <asset>: expected elements of Collada .*, found <'Unit'>"),
        ({"node": "<Translate>5 0 0</Translate>"}, "<node>: expected elements of Collada .*, found <'Translate'>"),
        ({"visual": "<Node/>"}, "<visual_scene>: expected elements of Collada .*, found <'Node'>"),
        ({"unit": "<unit>0.01</unit>"}, "line 2: <unit>: expected elements and attributes alone, found '0.01'"),
        ({"node": "5 0 0"}, "<node>: expected elements and attributes alone, found '5 0 0'"),
        ({"geometry": "<brep/>"}, "<geometry>: expected a mesh alone, found another shape"),
        (
            {"extra": '<library_lights meter="1"/>'},
            "<library_lights>: expected attributes of Collada .*, found 'meter'",
        ),
        ({"names": "XXY"}, "<param>: expected X, Y and Z"),
        ({"names": ["X", "", "Z"]}, "<param>: expected X, Y and Z"),
    ],
)
def test_collada_that_states_something_elsewhere(options, match, tmp_path):
    """Units that would be passed over, and names that Collada does not have: refused, with the line."""
    refused(tmp_path, "part.dae", dae(**options), match)


def test_collada_that_states_the_same_elsewhere(tmp_path):
    """The file's own unit again; another program's elements; and all children that the standard has."""
    assert load(tmp_path, "part.dae", dae()) == (WHOLE, [])
    same = dae(
        unit=MM, geometry=f"<asset>{MM}</asset>", extra='<extra><technique><unit meter="9"/></technique></extra>'
    )
    assert load(tmp_path, "part.dae", same)[0] == (12, [0, 0, 0], [0.001] * 3)
    profile = '<library_lights><light id="l"><technique profile="x"><node scale="2">5</node></technique></light>'
    assert load(tmp_path, "part.dae", dae(extra=f"{profile}</library_lights>")) == (WHOLE, [])
    nodes = "<translate>5 0 0</translate><instance_light url='#l'/><extra/><node/>"
    assert load(tmp_path, "part.dae", dae(node=nodes))[0][1] == [5, 0, 0]


def test_a_unit_that_contradicts_its_name_is_told(tmp_path):
    """The number counts."""
    found, told = load(tmp_path, "part.dae", dae(unit='<unit name="millimeter" meter="1"/>'))
    assert found == WHOLE
    assert len(told) == 1
    assert "expected 0.001 m as a millimeter, found meter=1, which counts" in told[0]


@pytest.mark.parametrize("names", ["XYZ", "xyz", ["", "", ""], "ZYX", "YZX"])
def test_axes_of_collada_go_by_their_names(names, tmp_path):
    """Coordinates are in the order of their names, not in that of the file."""
    order = "".join(names).upper() or "XYZ"
    points = " ".join(str(p["XYZ".index(axis)] * (1 + "XYZ".index(axis))) for p in CUBE for axis in order)
    assert load(tmp_path, "part.dae", dae(names=names, points=points)) == ((12, [0, 0, 0], [1, 2, 3]), [])


@pytest.mark.parametrize("axis", ["Y_UP", "X_UP", "y_up"])
def test_up_axes_are_told(axis, tmp_path):
    """An up axis other than z is not applied, and a warning says so."""
    found, (text,) = load(tmp_path, "part.dae", dae(up=axis))
    assert found == WHOLE
    assert f"part.dae, line 2: expected <up_axis> Z_UP, found '{axis}', which is not applied" in text
    assert load(tmp_path, "part.dae", dae().replace("<up_axis>Z_UP</up_axis>", "")) == (WHOLE, [])


# -- glTF ---------------------------------------------------------------------------------------


def gltf(change=lambda tree: None):
    data = np.array(CUBE, "<f4").tobytes() + np.array(FACES, "<u2").tobytes()
    tree = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"children": [1]}, {"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 8, "type": "VEC3"},
            {"bufferView": 1, "componentType": 5123, "count": 36, "type": "SCALAR"},
        ],
        "bufferViews": [
            {"buffer": 0, "byteOffset": 0, "byteLength": 96},
            {"buffer": 0, "byteOffset": 96, "byteLength": 72},
        ],
        "buffers": [{"byteLength": 168, "uri": "data:;base64," + base64.b64encode(data).decode()}],
    }
    change(tree)
    return json.dumps(tree)


# The objects on the way from the file to a buffer, by their names in messages.
PLACES = {
    "the file": lambda t: t,
    "asset": lambda t: t["asset"],
    "scenes[0]": lambda t: t["scenes"][0],
    "nodes[0]": lambda t: t["nodes"][0],
    "nodes[1]": lambda t: t["nodes"][1],
    "meshes[0]": lambda t: t["meshes"][0],
    "meshes[0].primitives[0]": lambda t: t["meshes"][0]["primitives"][0],
    "accessors[1]": lambda t: t["accessors"][1],
    "bufferViews[0]": lambda t: t["bufferViews"][0],
    "buffers[0]": lambda t: t["buffers"][0],
}


@pytest.mark.parametrize("place", PLACES)
def test_extensions_and_keys_on_the_way_to_a_buffer(place, tmp_path):
    """On every object: an extension that may change the shape is refused, one that does not is read, a key is told."""
    at = PLACES[place]
    for name in ("CESIUM_RTC", "KHR_physics_rigid_bodies", "EXT_mesh_gpu_instancing"):
        match = re.escape(place) + f": expected no extension that changes the shape, found '{name}'"
        refused(tmp_path, "part.gltf", gltf(lambda t, name=name: at(t).update(extensions={name: {}})), match)
    known = {"KHR_materials_unlit": {}, "KHR_xmp_json_ld": {}, "EXT_structural_metadata": {}}
    same = gltf(lambda t: at(t).update(extensions=known, extras={"a": 1}, name="a"))
    assert load(tmp_path, "part.gltf", same) == (WHOLE, [])
    refused(tmp_path, "part.gltf", gltf(lambda t: at(t).update(extensions=[1])), "expected extensions, an object")
    found, (text,) = load(tmp_path, "part.gltf", gltf(lambda t: at(t).update(position=[1, 0, 0])))
    assert found == WHOLE
    assert text.endswith(
        f"part.gltf: expected keys of glTF 2.0, found others, which are not read: 'position' in {place}"
    )


def test_keys_are_one_warning(tmp_path):
    """Each key once, with its first place; a long list is cut."""

    def change(tree):
        tree["nodes"][0].update(position=[1, 0, 0], Scale=2)
        tree["nodes"][1].update(position=[1, 0, 0])
        tree["buffers"][0].update({f"key{k}": 0 for k in range(20)})

    _, (text,) = load(tmp_path, "part.gltf", gltf(change))
    assert "'position' in nodes[0]" in text
    assert "'Scale' in nodes[0]" in text
    assert text.endswith(" and 12 more")
    assert "nodes[1]" not in text


@pytest.mark.parametrize(
    ("change", "match"),
    [
        (lambda t: t["asset"].update(minVersion="2.1"), "for readers of version 2.0, found minVersion '2.1'"),
        (lambda t: t["asset"].update(minVersion=2), "found minVersion '2'"),
        (
            lambda t: (t.pop("scene"), t["scenes"].append({})),
            "expected scene, the number of the one of 2 scenes to show",
        ),
    ],
)
def test_gltf_for_another_reader(change, match, tmp_path):
    """A file that needs a newer reader, or has several scenes and chooses none, is refused."""
    refused(tmp_path, "part.gltf", gltf(change), match)


def test_gltf_that_states_what_is_read(tmp_path):
    """Values that equal the defaults change nothing."""
    assert load(tmp_path, "part.gltf", gltf(lambda t: t["asset"].update(version="2.1", minVersion="2.0")))[0] == WHOLE
    assert load(tmp_path, "part.gltf", gltf(lambda t: t.pop("scene"))) == (WHOLE, [])
