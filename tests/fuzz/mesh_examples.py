"""Small mesh files of every format and variant that is read, and random damage to them."""

import base64
import io
import json
import re
import struct

import numpy as np
import trimesh

POINTS = [(0, 0), (2, 0), (2, 1), (1, 1), (1, 2), (0, 2)]


def l_shape():
    """An L as an extruded outline: twelve vertices, two polygons of six corners, six of four."""
    vertices = [(x / 8, y / 8, z / 8) for z in (0, 1) for x, y in POINTS]
    # Fans about the inner corner (3) stay within the L.
    caps = [[3, 2, 1, 0, 5, 4], [9, 10, 11, 6, 7, 8]]
    walls = [[i, (i + 1) % 6, (i + 1) % 6 + 6, i + 6] for i in range(6)]
    return vertices, caps + walls


def l_triangles():
    vertices, faces = l_shape()
    return trimesh.Trimesh(
        vertices, [[f[0], f[k], f[k + 1]] for f in faces for k in range(1, len(f) - 1)], process=False
    )


def examples():
    """Name: (files, main file's suffix); files are name: bytes, the first being the main one."""
    return {**_simple(), **_ply(), **_gltf(), **_dae()}


def _lines(*lines):
    return ("\n".join(lines) + "\n").encode()


def _simple():
    vertices, faces = l_shape()
    mesh = l_triangles()
    v = [f"v {x:g} {y:g} {z:g}" for x, y, z in vertices]
    f = ["f " + " ".join(f"{i + 1}" for i in face) for face in faces]
    full = ["f " + " ".join(f"{i + 1}/{i % 3 + 1}/1" for i in face) for face in faces]
    back = [
        line for k, face in enumerate(faces) for line in ([f"g part{k}"] + ["f " + " ".join(f"{i - 12}" for i in face)])
    ]
    colour = [line + " 0.5 0.25 1" for line in v]
    off = [f"{x:g} {y:g} {z:g}" for x, y, z in vertices]
    off_faces = [f"{len(face)} " + " ".join(map(str, face)) for face in faces]
    found = {
        "stl-binary": (mesh.export(file_type="stl"), ".stl"),
        "stl-text": (trimesh.exchange.stl.export_stl_ascii(mesh).encode(), ".stl"),
        "obj": (_lines("# an L", "o l", *v, *f), ".obj"),
        "obj-textured": (
            _lines("mtllib l.mtl", *v, "vt 0 0", "vt 1 0", "vt 1 1", "vn 0 0 1", "usemtl m", *full),
            ".obj",
        ),
        "obj-relative": (_lines(*colour, "s off", *back).replace(b"v 0.25", b"v \\\n 0.25"), ".obj"),
        "off": (_lines("OFF", "12 8 0", "# vertices", *off, *off_faces), ".off"),
        "off-colour": (
            _lines(
                "COFF 12 8 0", *(line + " 1 0.5 0.25 1" for line in off), *(line + " 255 0 0" for line in off_faces)
            ),
            ".off",
        ),
    }
    return {name: ({"part" + suffix: data}, suffix) for name, (data, suffix) in found.items()}


def _ply():
    vertices, faces = l_shape()
    mesh = l_triangles()
    found = {
        "ply-binary": mesh.export(file_type="ply"),
        "ply-text": mesh.export(file_type="ply", encoding="ascii"),
    }
    header = [
        "ply",
        "format {} 1.0",
        "comment an L",
        "element vertex 12",
        *("property double x", "property float w", "property float y", "property double z", "property uchar red"),
        "element face 8",
        *("property short flag", "property list uchar int vertex_indices", "property list uint16 float weights"),
        "element edge 1",
        *("property int a", "property int b"),
        "end_header",
    ]
    text = [f"{x:g} 0 {y:g} {z:g} 200" for x, y, z in vertices]
    text += [f"-1 {len(face)} {' '.join(map(str, face))} 2 0.5 0.25" for face in faces]
    found["ply-rich-text"] = _lines(*header, *text, "0 1").replace(b"{}", b"ascii")
    for order, name in (("<", "little"), (">", "big")):
        body = b"".join(struct.pack(order + "dffdB", x, 0, y, z, 200) for x, y, z in vertices)
        for face in faces:
            body += struct.pack(f"{order}hB{len(face)}iHff", -1, len(face), *face, 2, 0.5, 0.25)
        found[f"ply-rich-{name}"] = _lines(*header).replace(b"{}", f"binary_{name}_endian".encode()) + body
        found[f"ply-rich-{name}"] += struct.pack(order + "ii", 0, 1)
    return {name: ({"part.ply": data}, ".ply") for name, data in found.items()}


def glb(tree, body=b""):
    """A binary glTF file of a tree and a buffer."""
    text = json.dumps(tree).encode()
    text += b" " * (-len(text) % 4)
    body += b"\0" * (-len(body) % 4)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text
    if body:
        chunks += struct.pack("<I4s", len(body), b"BIN\0") + body
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


def gltf_parts(data):
    """Tree and buffer of a binary glTF file."""
    size = struct.unpack("<I", data[12:16])[0]
    return json.loads(data[20 : 20 + size]), data[28 + size :]


def _gltf():
    mesh = l_triangles()
    scene = trimesh.Scene()
    turned = trimesh.transformations.rotation_matrix(0.7, [1, 2, 3], [0.1, 0.2, 0.3])
    scene.add_geometry(mesh, node_name="a", transform=turned)
    scene.add_geometry(mesh, node_name="b", parent_node_name="a", transform=np.diag([-0.5, 0.5, 0.5, 1]))
    points = np.asarray(mesh.vertices, dtype="<f4")
    faces = np.asarray(mesh.faces, dtype="<u2")
    # Sixteen bytes a vertex; indices; a strip; two vertices moved; the same points in short numbers.
    body = np.c_[points, np.ones(12, "<f4")].astype("<f4").tobytes() + faces.tobytes()
    at = {"points": 0, "faces": len(body) - faces.nbytes, "strip": len(body)}
    body += np.array([0, 1, 6, 7, 8, 2], "<u4").tobytes()
    at["places"] = len(body)
    body += np.array([3, 9], "u1").tobytes() + b"\0\0"
    at["moved"] = len(body)
    body += np.array([[1, 1, 0], [1, 1, 1]], "<f4").tobytes()
    at["short"] = len(body)
    body += (np.c_[points, np.zeros(12)] * 4 * 32767).astype("<i2").tobytes()
    sizes = [*list(at.values())[1:], len(body)]
    views = [
        {"buffer": 0, "byteOffset": start, "byteLength": end - start}
        for start, end in zip(at.values(), sizes, strict=True)
    ]
    views[0]["byteStride"] = 16
    views[5]["byteStride"] = 8
    sparse = {
        "count": 2,
        "indices": {"bufferView": 3, "componentType": 5121},
        "values": {"bufferView": 4, "componentType": 5126},
    }
    tree = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0, 2]}],
        "nodes": [
            {"mesh": 0, "translation": [1, 2, 3], "rotation": [0.6, 0, 0, 0.8], "scale": [1, 2, -1], "children": [1]},
            {"mesh": 1, "matrix": [0, 1, 0, 0, -1, 0, 0, 0, 0, 0, 1, 0, 4, 5, 6, 1]},
            {"mesh": 0},
        ],
        "meshes": [
            {"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}, {"attributes": {"POSITION": 0}, "mode": 0}]},
            {
                "primitives": [
                    {"attributes": {"POSITION": 2}, "indices": 3, "mode": 5},
                    {"attributes": {"POSITION": 4}, "indices": 3, "mode": 6},
                    {"attributes": {"POSITION": 4}},
                ]
            },
        ],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 12, "type": "VEC3"},
            {"bufferView": 1, "componentType": 5123, "count": faces.size, "type": "SCALAR"},
            {"bufferView": 0, "componentType": 5126, "count": 12, "type": "VEC3", "sparse": sparse},
            {"bufferView": 2, "componentType": 5125, "count": 6, "type": "SCALAR"},
            {"bufferView": 5, "componentType": 5122, "count": 12, "type": "VEC3", "normalized": True},
        ],
        "bufferViews": views,
        "buffers": [{"byteLength": len(body)}],
    }
    inline = json.loads(json.dumps(tree))
    inline["buffers"][0]["uri"] = "data:application/octet-stream;base64," + base64.b64encode(body).decode()
    outside = json.loads(json.dumps(tree))
    outside["buffers"][0]["uri"] = "the%20part.bin"
    return {
        "glb": ({"part.glb": scene.export(file_type="glb")}, ".glb"),
        "glb-rich": ({"part.glb": glb(tree, body)}, ".glb"),
        "gltf-inline": ({"part.gltf": json.dumps(inline, indent=1).encode()}, ".gltf"),
        "gltf-outside": ({"part.gltf": json.dumps(outside).encode(), "the part.bin": body}, ".gltf"),
    }


def _dae():
    vertices, faces = l_shape()
    exported = io.BytesIO(l_triangles().export(file_type="dae")).getvalue()
    # Names and dates that are new each time would make another campaign of the same seeds.
    for k, name in enumerate(dict.fromkeys(re.findall(rb"[0-9a-f]{32}", exported))):
        exported = exported.replace(name, b"id%d" % k)
    exported = re.sub(rb"\d{4}-\d\d-\d\d[T ][\d:.]+", b"2020-01-01T00:00:00", exported)
    numbers = " ".join(f"{x:g}" for p in vertices for x in p)
    pairs = [" ".join(f"{i} {i % 4}" for i in face) for face in faces]
    caps = "".join(f"<p>{pair}</p>\n" for pair in pairs[:2])
    inputs = '<input semantic="VERTEX" source="#v" offset="0"/>\n<input semantic="NORMAL" source="#n" offset="1"/>\n'
    rich = f"""<?xml version="1.0" encoding="utf-8"?>
<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
<asset><unit meter="0.01" name="centimeter"/></asset>
<library_geometries>
<geometry id="g"><mesh>
<source id="p"><float_array id="pa" count="36">{numbers}</float_array>
<technique_common><accessor source="#pa" count="12" stride="3">
<param name="X" type="float"/><param name="Y" type="float"/><param name="Z" type="float"/>
</accessor></technique_common></source>
<source id="n"><float_array id="na" count="12">0 0 1 0 1 0 1 0 0 0 0 -1</float_array>
<technique_common><accessor source="#na" count="4" stride="3">
<param name="X" type="float"/><param name="Y" type="float"/><param name="Z" type="float"/>
</accessor></technique_common></source>
<vertices id="v"><input semantic="POSITION" source="#p"/></vertices>
<polylist count="6">
{inputs}<vcount>4 4 4 4 4 4</vcount>
<p>{" ".join(pairs[2:])}</p>
</polylist>
<polygons count="2">
{inputs}{caps}</polygons>
<tristrips count="1">
<input semantic="VERTEX" source="#v" offset="0"/>
<p>0 1 6 7 8</p>
</tristrips>
<!-- a comment -->
</mesh></geometry>
</library_geometries>
<library_nodes>
<node id="shared"><scale>1 -2 3</scale>
<instance_geometry url="#g"/></node>
</library_nodes>
<library_visual_scenes>
<visual_scene id="s">
<node id="a">
<translate>1 2 3</translate>
<rotate>0 1 1 30</rotate>
<matrix>0 -1 0 4 1 0 0 5 0 0 1 6 0 0 0 1</matrix>
<instance_geometry url="#g"/>
<instance_node url="#shared"/>
<node id="b"><scale>2 2 2</scale><instance_node url="#shared"/></node>
</node>
<node id="camera"><lookat>0 0 0 1 1 1 0 0 1</lookat></node>
</visual_scene>
</library_visual_scenes>
<scene><instance_visual_scene url="#s"/></scene>
</COLLADA>
"""
    return {
        "dae": ({"part.dae": re.sub(rb"><", b">\n<", exported)}, ".dae"),
        "dae-rich": ({"part.dae": rich.encode()}, ".dae"),
    }


# -- damage -------------------------------------------------------------------------------------

_TOKEN = re.compile(rb"[^\s<>\"=,\[\]{}:]+")
_NUMBERS = re.compile(rb"(?<![\w.#])[+-]?\d+(?:\.\d*)?(?:[eE][+-]?\d+)?(?![\w.])")
_WORSE = (
    b"nan inf -inf 1e400 -1 0 1 2 7 11 12 13 255 256 65535 65536 4294967295 4294967296 -2147483648 1e30 -1e-30".split()
)
_WORSE += [
    b"1_0",
    b"0x10",
    b"1,5",
    b"1.5.2",
    b"--1",
    b"1e",
    b".",
    b"-",
    b"1d0",
    b"9" * 30,
    b"1" + b"0" * 5000,
    b"abc",
    b"\xc2\xb2",
]
_JSON = [
    None,
    True,
    False,
    -1,
    0,
    1,
    2,
    3,
    7,
    1.5,
    1e300,
    2**31,
    2**32 - 1,
    2**63,
    10**40,
    "",
    "x",
    "VEC3",
    [],
    {},
    [0],
    [[]],
]


def damaged(files, suffix, rng):
    """The same files with one to three faults in one of them."""
    files = dict(files)
    names = list(files)
    name = names[0] if len(names) == 1 or rng.random() < 0.8 else names[1]
    data = files[name]
    for _ in range(int(rng.integers(1, 4)) if rng.random() < 0.4 else 1):
        kinds = [_flip, _cut, _delete, _repeat, _swap, _overwrite]
        if _is_text(data):
            kinds += 2 * [
                _number,
                _number,
                _drop_token,
                _add_token,
                _swap_tokens,
                _drop_line,
                _repeat_line,
                _swap_lines,
            ]
        elif name.endswith(".glb") and data[:4] == b"glTF":
            kinds += 8 * [_edit_glb]
        else:
            kinds += 4 * [_header_number]
        if name.endswith(".gltf"):
            kinds += 12 * [_edit_gltf]
        if data:
            data = kinds[int(rng.integers(len(kinds)))](data, rng)
    files[name] = data
    return files


def _is_text(data):
    return b"\0" not in data and max(data, default=0) < 128


def _span(data, rng, most=64):
    start = int(rng.integers(len(data)))
    return start, start + int(rng.integers(1, most))


def _flip(data, rng):
    k = int(rng.integers(len(data)))
    return data[:k] + bytes([data[k] ^ (1 << int(rng.integers(8)))]) + data[k + 1 :]


def _cut(data, rng):
    return data[: int(rng.integers(len(data)))]


def _delete(data, rng):
    start, end = _span(data, rng)
    return data[:start] + data[end:]


def _repeat(data, rng):
    start, end = _span(data, rng)
    return data[:end] + data[start:]


def _swap(data, rng):
    a, b = sorted(int(k) for k in rng.integers(len(data), size=2))
    size = int(rng.integers(1, 16))
    return data[:a] + data[b : b + size] + data[a + size : b] + data[a : a + size] + data[b + size :]


def _overwrite(data, rng):
    k = int(rng.integers(len(data)))
    new = [b"\0\0\0\0", b"\xff\xff\xff\xff", struct.pack("<f", np.nan), struct.pack("<f", np.inf), b"\x7f\xff\xff\xff"]
    return data[:k] + new[int(rng.integers(5))] + data[k + 4 :]


def _at(matches, rng):
    found = list(matches)
    return found[int(rng.integers(len(found)))] if found else None


def _number(data, rng):
    match = _at(_NUMBERS.finditer(data), rng)
    if match is None:
        return data
    if rng.random() < 0.3:  # a little more or less
        new = b"%d" % (int(re.match(rb"[+-]?\d{1,15}", match.group()).group()) + int(rng.integers(-2, 3)))
    else:
        new = _WORSE[int(rng.integers(len(_WORSE)))]
    return data[: match.start()] + new + data[match.end() :]


def _header_number(data, rng):
    """A number of a binary file's header: in PLY's text, or the count of an STL file."""
    end = data.find(b"end_header")
    if end > 0:
        return _number(data[:end], rng) + data[end:]
    if len(data) > 84 and not data.startswith(b"ply"):
        count = struct.unpack("<I", data[80:84])[0]
        new = [count - 1, count + 1, 0, 2**32 - 1, 2**31, count * 2][int(rng.integers(6))]
        return data[:80] + struct.pack("<I", new % 2**32) + data[84:]
    return data


def _drop_token(data, rng):
    match = _at(_TOKEN.finditer(data), rng)
    return data if match is None else data[: match.start()] + data[match.end() :]


def _add_token(data, rng):
    match = _at(_TOKEN.finditer(data), rng)
    new = match.group() if match and rng.random() < 0.5 else _WORSE[int(rng.integers(len(_WORSE)))]
    return data if match is None else data[: match.end()] + b" " + new + data[match.end() :]


def _swap_tokens(data, rng):
    found = list(_TOKEN.finditer(data))
    if len(found) < 2:
        return data
    a, b = sorted(int(k) for k in rng.choice(len(found), 2, replace=False))
    a, b = found[a], found[b]
    return data[: a.start()] + b.group() + data[a.end() : b.start()] + a.group() + data[b.end() :]


def _drop_line(data, rng):
    lines = data.split(b"\n")
    del lines[int(rng.integers(len(lines)))]
    return b"\n".join(lines)


def _repeat_line(data, rng):
    lines = data.split(b"\n")
    lines.insert(int(rng.integers(len(lines) + 1)), lines[int(rng.integers(len(lines)))])
    return b"\n".join(lines)


def _swap_lines(data, rng):
    lines = data.split(b"\n")
    a, b = (int(k) for k in rng.integers(len(lines), size=2))
    lines[a], lines[b] = lines[b], lines[a]
    return b"\n".join(lines)


def _edit_gltf(data, rng):
    try:
        tree = json.loads(data)
    except ValueError:
        return data
    return json.dumps(_edit(tree, rng)).encode()


def _edit_glb(data, rng):
    try:
        tree, body = gltf_parts(data)
    except (ValueError, struct.error):
        return data
    return glb(_edit(tree, rng), body)


def _edit(tree, rng):
    """One value of a tree changed, dropped, or put at another's place."""
    places = []

    def walk(holder):
        for key in holder if isinstance(holder, dict) else range(len(holder)):
            places.append((holder, key))
            if isinstance(holder[key], dict | list):
                walk(holder[key])

    walk(tree)
    if not places:
        return tree
    holder, key = places[int(rng.integers(len(places)))]
    kind = int(rng.integers(5))
    if kind == 0:
        del holder[key]
    elif kind == 1:
        other, name = places[int(rng.integers(len(places)))]
        holder[key] = json.loads(json.dumps(other[name]))
    elif kind == 2 and type(holder[key]) in (int, float):
        holder[key] += int(rng.integers(-2, 3))
    elif kind == 3 and isinstance(holder, list):
        holder.insert(key, json.loads(json.dumps(holder[key])))
    else:
        holder[key] = _JSON[int(rng.integers(len(_JSON)))]
    return tree
