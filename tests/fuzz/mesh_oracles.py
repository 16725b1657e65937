"""Slow readers of mesh files, from the formats' descriptions: nothing of loewner, no NumPy, one triangle at a time.

Each takes the bytes of a file and returns its triangles and polygons, points of three coordinates in metres each, in
the order of the file; or raises Refused, if the bytes are not one whole mesh.
"""

import base64
import json
import math
import re
import struct
from urllib.parse import unquote
from xml.etree import ElementTree


class Refused(Exception):
    """The bytes are no whole mesh of the format."""


def read(suffix, data, folder=None):
    """Triangles of a file with that suffix; `folder` holds the files that a glTF file names."""
    try:
        if suffix in (".glb", ".gltf"):
            return _Gltf(data, folder, suffix == ".glb").triangles()
        return {".stl": _stl, ".obj": _obj, ".off": _off, ".ply": _ply, ".dae": _dae}[suffix](data)
    except (
        *(ValueError, LookupError, TypeError, AttributeError, OverflowError, struct.error, RecursionError),
        *(ElementTree.ParseError, OSError),
    ) as error:
        raise Refused(f"{type(error).__name__}: {error}") from error


def need(holds, message="not as the format says"):
    if not holds:
        raise Refused(message)


_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?|[+-]?(nan|inf|infinity)", re.ASCII | re.IGNORECASE)
_WHOLE = re.compile(r"[+-]?\d{1,19}", re.ASCII)


def number(token):
    need(_NUMBER.fullmatch(token), f"{token!r} is no number")
    return float(token)


def whole(token):
    need(_WHOLE.fullmatch(token), f"{token!r} is no whole number")
    return int(token)


def fan(polygon):
    need(len(polygon) >= 3, "a polygon of fewer than three corners")
    return [(polygon[0], polygon[k], polygon[k + 1]) for k in range(1, len(polygon) - 1)]


def whole_polygon(polygon):
    need(len(polygon) >= 3, "a polygon of fewer than three corners")
    return [tuple(polygon)]


def pick(points, index):
    need(0 <= index < len(points), f"no vertex {index}")
    return points[index]


def text_lines(data):
    """Lines in ASCII, blanks at both ends removed."""
    text = data.decode("latin-1").replace("\r\n", "\n").replace("\r", "\n")
    # Only these are blanks in such files; Python's own split knows more of them.
    return [
        re.split(r"[ \t\v\f]+", line.strip(" \t\v\f")) if line.strip(" \t\v\f") else [] for line in text.split("\n")
    ]


# -- STL ----------------------------------------------------------------------------------------


def _stl(data):
    if len(data) >= 84 and len(data) == 84 + 50 * int.from_bytes(data[80:84], "little"):
        found = []
        for start in range(84, len(data), 50):
            values = struct.unpack("<12fH", data[start : start + 50])
            found.append((values[3:6], values[6:9], values[9:12]))
        return found
    lines = [line for line in text_lines(data) if line]
    found, inside, k, corners = [], False, 0, []
    shape = ["facet normal", "outer loop", "vertex", "vertex", "vertex", "endloop", "endfacet"]
    need(lines and lines[-1][0].lower() == "endsolid", "no endsolid")
    for line in lines:
        head = line[0].lower()
        if not inside:
            need(head == "solid", "no solid")
            inside = True
        elif k == 0 and head == "endsolid":
            inside = False
        else:
            words = shape[k].split()
            need([w.lower() for w in line[: len(words)]] == words, f"{line} where {words} belongs")
            values = [0.0 if k == 0 else number(w) for w in line[len(words) :]]  # any words for a normal
            need(len(values) == (3 if k in (0, 2, 3, 4) else 0), f"{line}: another count of numbers")
            if words == ["vertex"]:
                corners.append(tuple(values))
            k = (k + 1) % 7
            if k == 0:
                found.append(tuple(corners))
                corners = []
    need(not inside, "not closed")
    return found


# -- OBJ and OFF --------------------------------------------------------------------------------

_OBJ_OTHER = "vt vn vp g o s mg l p usemtl mtllib usemap maplib bevel c_interp d_interp lod shadow_obj trace_obj"


def _obj(data):
    text = data.decode("latin-1").replace("\r\n", "\n").replace("\r", "\n").replace("\\\n", " ")
    points, faces = [], []
    for line in text.removeprefix("\xef\xbb\xbf").split("\n"):
        words = line.split("#")[0].encode("latin-1").split()  # bytes: blanks of ASCII only
        words = [word.decode("latin-1") for word in words]
        if not words:
            continue
        if words[0] == "v":
            points.append([number(w) for w in words[1:]])
            need(len(points[-1]) in (3, 4, 6, 7) and len(points[-1]) == len(points[0]), "a ragged vertex")
        elif words[0] == "f":
            need(len(words) >= 4, "a face of fewer than three corners")
            face = []
            for word in words[1:]:
                parts = word.split("/")
                need(len(parts) <= 3, "too many slashes")
                for part in parts[1:]:
                    need(re.fullmatch(r"[+-]?\d*", part, re.ASCII), f"{word!r} is no corner")
                index = whole(parts[0])
                need(index != 0, "an index 0")
                face.append(index - 1 if index > 0 else len(points) + index)
                need(face[-1] >= 0, "an index too far back")
            faces.append(face)
        else:
            need(words[0] in _OBJ_OTHER.split(), f"an unknown line {words[0]!r}")
    return [tuple(tuple(p[:3]) for p in t) for face in faces for t in whole_polygon([pick(points, i) for i in face])]


def _off(data):
    lines = [" ".join(words).split("#")[0].split(" ") for words in text_lines(data)]
    lines = [[w for w in line if w] for line in lines]
    lines = [line for line in lines if line]
    kind = lines[0].pop(0)
    widths = {"OFF": [3], "NOFF": [6], "COFF": [6, 7], "CNOFF": [9, 10]}[kind]
    if not lines[0]:
        lines.pop(0)
    v, f, _ = (whole(w) for w in lines[0])
    need(v >= 0 and f >= 0 and len(lines) == 1 + v + f, "another count of lines")
    points = [[number(w) for w in line] for line in lines[1 : 1 + v]]
    need(all(len(p) in widths and len(p) == len(points[0]) for p in points), "a ragged vertex")
    found = []
    for line in lines[1 + v :]:
        size = whole(line[0])
        need(3 <= size <= len(line) - 1 and len(line) - 1 - size in (0, 1, 3, 4), "a face of another length")
        [number(w) for w in line[1 + size :]]
        found += whole_polygon([tuple(pick(points, whole(w))[:3]) for w in line[1 : 1 + size]])
    return found


# -- PLY ----------------------------------------------------------------------------------------

_PLY_TYPES = {
    name: letter
    for names, letter in (
        ("char int8", "b"),
        ("uchar uint8", "B"),
        ("short int16", "h"),
        ("ushort uint16", "H"),
        ("int int32", "i"),
        ("uint uint32", "I"),
        ("float float32", "f"),
        ("double float64", "d"),
    )
    for name in names.split()
}


def _ply(data):
    form, elements, start = None, [], 0
    for first in (True, *(False for _ in range(1000))):
        end = data.index(b"\n", start)
        words = data[start:end].decode("latin-1").split()
        start = end + 1
        if first:
            need(words == ["ply"], "no ply")
        elif words == ["end_header"]:
            break
        elif words and words[0] == "format":
            need(form is None and words[2:] == ["1.0"], "another format")
            form = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}[words[1]]
        elif words and words[0] == "element":
            need(len(words) == 3 and re.fullmatch(r"\d+", words[2], re.ASCII), "another element")
            elements.append((words[1], int(words[2]), []))
        elif words and words[0] == "property":
            types = words[2:4] if words[1] == "list" else words[1:2]
            need(len(words) == (5 if words[1] == "list" else 3), "another property")
            elements[-1][2].append((words[-1], [_PLY_TYPES[t] for t in types]))
        else:
            need(not words or words[0] in ("comment", "obj_info"), "an unknown line of the header")
    else:
        raise Refused("no end of the header")
    need(form is not None, "no format")
    rows = _ply_text(data[start:], elements) if form == "" else _ply_binary(data, start, elements, form)
    names = [name for name, _, _ in elements]
    need(names.count("vertex") == 1 and names.count("face") <= 1, "not one of vertex and face")
    points = [(row["x"], row["y"], row["z"]) for row in rows[names.index("vertex")]]
    found = []
    for row in rows[names.index("face")] if "face" in names else []:
        (indices,) = (row[k] for k in ("vertex_indices", "vertex_index") if k in row)
        found += whole_polygon([pick(points, i) for i in indices])
    return found


def _ply_text(data, elements):
    lines = [line for line in text_lines(data) if line]
    tables = []
    for _, count, properties in elements:
        table = []
        for _ in range(count if properties else 0):
            words, row = lines.pop(0), {}
            for name, types in properties:
                if len(types) == 1:
                    row[name] = number(words.pop(0))
                    continue
                size = whole(words.pop(0))
                need(0 <= size <= len(words), "a list of another length")
                convert = whole if name in ("vertex_indices", "vertex_index") else number
                row[name] = [convert(words.pop(0)) for _ in range(size)]
            need(not words, "more numbers than properties")
            table.append(row)
        tables.append(table)
    need(not lines, "more lines than elements")
    return tables


def _ply_binary(data, at, elements, order):
    def take(letter):
        nonlocal at
        (value,) = struct.unpack_from(order + letter, data, at)
        at += struct.calcsize(order + letter)
        return value

    tables = []
    for _, count, properties in elements:
        table = []
        for _ in range(count if properties else 0):
            row = {}
            for name, types in properties:
                if len(types) == 1:
                    row[name] = take(types[0])
                else:
                    size = take(types[0])
                    need(0 <= size <= len(data), "a list of another length")
                    row[name] = [take(types[1]) for _ in range(size)]
            table.append(row)
        tables.append(table)
    need(at == len(data), "more bytes than elements")
    return tables


# -- placing ------------------------------------------------------------------------------------


def times(A, B):
    return [[sum(A[i][k] * B[k][j] for k in range(4)) for j in range(4)] for i in range(4)]


def identity():
    return [[float(i == j) for j in range(4)] for i in range(4)]


def place(T, triangles):
    """Triangles moved by a map; turned over if it mirrors."""
    m = T
    det = (
        m[0][0] * (m[1][1] * m[2][2] - m[1][2] * m[2][1])
        - m[0][1] * (m[1][0] * m[2][2] - m[1][2] * m[2][0])
        + m[0][2] * (m[1][0] * m[2][1] - m[1][1] * m[2][0])
    )
    moved = [
        tuple(tuple(sum(T[i][j] * p[j] for j in range(3)) + T[i][3] for i in range(3)) for p in t) for t in triangles
    ]
    return [t[::-1] for t in moved] if det < 0 else moved


def strip(points):
    need(len(points) >= 3, "a short strip")
    triangles = [tuple(points[k : k + 3]) for k in range(len(points) - 2)]
    return [t[::-1] if k % 2 else t for k, t in enumerate(triangles)]


# -- glTF ---------------------------------------------------------------------------------------

_GLTF_TYPES = {5120: "b", 5121: "B", 5122: "h", 5123: "H", 5125: "I", 5126: "f"}


class _Gltf:
    def __init__(self, data, folder, binary):
        self.folder, self.body = folder, None
        if binary:
            magic, version, length = struct.unpack("<4sII", data[:12])
            need(magic == b"glTF" and version == 2 and length == len(data), "another header")
            chunks, at = [], 12
            while at < len(data):
                size, kind = struct.unpack("<I4s", data[at : at + 8])
                need(size % 4 == 0 and at + 8 + size <= len(data), "a chunk of another length")
                chunks.append((kind, data[at + 8 : at + 8 + size]))
                at += 8 + size
            need(chunks[0][0] == b"JSON", "no JSON")
            data = chunks[0][1]
            if len(chunks) > 1 and chunks[1][0] == b"BIN\0":
                self.body = chunks[1][1]
        self.tree = json.loads(data.decode("utf-8"))
        need(self.tree["asset"]["version"].startswith("2."), "another version")
        need(all(self.harmless(e) for e in self.tree.get("extensionsRequired", [])), "an extension")

    @staticmethod
    def harmless(name):
        return bool(
            re.match("KHR_materials_|KHR_texture_|EXT_texture_|KHR_lights_|KHR_mesh_quantization|KHR_xmp", name)
        )

    def get(self, kind, index):
        need(type(index) is int and index >= 0, "another index")
        found = self.tree[kind][index]
        need(type(found) is dict, "no object")
        for name in found.get("extensions", {}):
            need(self.harmless(name), "an extension")
        return found

    def triangles(self):
        self.seen, found = [], []
        for root in self.get("scenes", self.tree.get("scene", 0)).get("nodes", []):
            found += self.node(root, identity())
        return found

    def node(self, index, parent):
        node = self.get("nodes", index)
        need(index not in self.seen, "no tree")
        self.seen.append(index)
        T = times(parent, self.pose(node))
        found = []
        if "mesh" in node:
            need("skin" not in node and not any(node.get("weights", [])), "a skin or a morph")
            mesh = self.get("meshes", node["mesh"])
            need(mesh["primitives"] and not any(mesh.get("weights", [])), "no primitives, or a morph")
            for primitive in mesh["primitives"]:
                found += place(T, self.primitive(primitive))
        for child in node.get("children", []):
            found += self.node(child, T)
        return found

    def pose(self, node):
        def numbers(key, default):
            values = node.get(key, default)
            need(len(values) == len(default) and all(type(x) in (int, float) for x in values), "no numbers")
            need(all(abs(x) < 1e300 for x in values), "no finite numbers")
            return values

        if "matrix" in node:
            need(not {"translation", "rotation", "scale"} & set(node), "two transforms")
            m = numbers("matrix", [0] * 16)
            need([m[3], m[7], m[11], m[15]] == [0, 0, 0, 1], "no affine map")
            return [[float(m[4 * j + i]) for j in range(4)] for i in range(4)]
        x, y, z, w = numbers("rotation", [0, 0, 0, 1])
        length = math.sqrt(x * x + y * y + z * z + w * w)
        need(abs(length - 1) < 1e-2, "no rotation")
        # Rotate the axes, p -> q p q*, one by one.
        columns = []
        for p in ((1, 0, 0), (0, 1, 0), (0, 0, 1)):
            a, u = w / length, (x / length, y / length, z / length)
            dot = sum(i * j for i, j in zip(u, p, strict=True))
            cross = (u[1] * p[2] - u[2] * p[1], u[2] * p[0] - u[0] * p[2], u[0] * p[1] - u[1] * p[0])
            columns.append([2 * dot * u[i] + (2 * a * a - 1) * p[i] + 2 * a * cross[i] for i in range(3)])
        s, t = numbers("scale", [1, 1, 1]), numbers("translation", [0, 0, 0])
        rows = [[columns[j][i] * s[j] for j in range(3)] + [float(t[i])] for i in range(3)]
        return [*rows, [0.0, 0.0, 0.0, 1.0]]

    def primitive(self, primitive):
        need(not any(not self.harmless(e) for e in primitive.get("extensions", {})), "an extension")
        mode = primitive.get("mode", 4)
        need(mode in range(7) and type(mode) is int, "another mode")
        if mode < 4:
            return []
        points = self.accessor(primitive["attributes"]["POSITION"], "VEC3")
        if "indices" in primitive:
            kind = self.get("accessors", primitive["indices"])["componentType"]
            need(kind in (5121, 5123, 5125), "another type of indices")
            indices = [i for (i,) in self.accessor(primitive["indices"], "SCALAR")]
        else:
            indices = range(len(points))
        corners = [pick(points, i) for i in indices]
        if mode == 4:
            need(len(corners) % 3 == 0, "no triangles")
            return [tuple(corners[k : k + 3]) for k in range(0, len(corners), 3)]
        return strip(corners) if mode == 5 else fan(corners)

    def accessor(self, index, shape):
        a = self.get("accessors", index)
        need(a["type"] == shape and type(a["count"]) is int and 0 < a["count"] < 10**6, "another accessor")
        letter, width = _GLTF_TYPES[a["componentType"]], 3 if shape == "VEC3" else 1
        need("bufferView" in a or "sparse" in a, "no data")
        values = self.rows(a, a["count"], letter, width) if "bufferView" in a else [(0,) * width] * a["count"]
        if "sparse" in a:
            s = a["sparse"]
            need(type(s["count"]) is int and 0 < s["count"] <= len(values), "another count")
            need(s["indices"]["componentType"] in (5121, 5123, 5125), "another type of indices")
            places = [i for (i,) in self.rows(s["indices"], s["count"], _GLTF_TYPES[s["indices"]["componentType"]], 1)]
            need(places == sorted(set(places)), "indices that do not rise")
            for i, new in zip(places, self.rows(s["values"], s["count"], letter, width), strict=True):
                pick(values, i)
                values[i] = new
        if a.get("normalized") and shape == "VEC3":
            most = {"b": 127, "B": 255, "h": 32767, "H": 65535}[letter]
            values = [tuple(max(x / most, -1.0) for x in row) for row in values]
        return values

    def rows(self, holder, count, letter, width):
        view = self.get("bufferViews", holder["bufferView"])
        buffer = self.buffer(view["buffer"])
        start, length = view.get("byteOffset", 0), view["byteLength"]
        need(type(start) is int and type(length) is int and start >= 0 and length > 0, "another view")
        need(start + length <= len(buffer), "a view beyond the buffer")
        data = buffer[start : start + length]
        size = struct.calcsize("<" + letter) * width
        stride, offset = view.get("byteStride", size), holder.get("byteOffset", 0)
        need(type(stride) is int and type(offset) is int and stride >= size and offset >= 0, "another stride")
        return [struct.unpack_from(f"<{width}{letter}", data, offset + k * stride) for k in range(count)]

    def buffer(self, index):
        buffer = self.get("buffers", index)
        length = buffer["byteLength"]
        if "uri" not in buffer:
            data = self.body
            need(index == 0 and data is not None, "no data")
        elif buffer["uri"].startswith("data:"):
            head, text = buffer["uri"].split(",", 1)
            need(head.endswith(";base64"), "no base64")
            data = base64.b64decode(text, validate=True)
        else:
            name = unquote(buffer["uri"], errors="strict")
            need(re.fullmatch(r"[\w .-]+", name) and ".." not in name, "a name elsewhere")
            data = (self.folder / name).read_bytes()
        need(type(length) is int and 0 < length <= len(data) < length + 4, "a buffer of another length")
        return data[:length]


# -- Collada ------------------------------------------------------------------------------------


def _dae(data):
    need(b"<!" not in re.sub(rb"<!--.*?-->|<!\[CDATA\[", b"", data, flags=re.DOTALL), "a declaration")
    root = ElementTree.fromstring(data)
    for element in root.iter():
        element.tag = element.tag.rpartition("}")[2]
    need(root.tag == "COLLADA", "no COLLADA")
    units = [u for asset in root.findall("asset") for u in asset.findall("unit")]
    metres = number(units[0].get("meter", "1").strip()) if units else 1.0
    need(0 < metres < math.inf, "no unit")

    def named(tag, reference):
        need(reference[0] == "#", "a reference elsewhere")
        (found,) = (e for e in root.iter(tag) if e.get("id") == reference[1:])
        return found

    def tokens(element):
        need(len(element) == 0, "elements where numbers belong")
        words = (element.text or "").encode("ascii").split()
        return [word.decode() for word in words]

    def floats(element, count):
        values = [number(w) for w in tokens(element)]
        need(len(values) == count, "another count of numbers")
        return values

    def count_of(element, name, default=None):
        text = element.get(name, default)
        need(re.fullmatch(r"\s*\d{1,15}\s*", text, re.ASCII), "no count")
        return int(text)

    def one(element, tag):
        (found,) = element.findall(tag)
        return found

    def points_of(reference):
        source = named("source", reference)
        array, accessor = one(source, "float_array"), one(one(source, "technique_common"), "accessor")
        need(array.get("id") is None or accessor.get("source") == "#" + array.get("id"), "another array")
        values = floats(array, count_of(array, "count"))
        stride, offset = count_of(accessor, "stride", "1"), count_of(accessor, "offset", "0")
        names = [param.get("name", "").upper() for param in accessor.findall("param")]
        need(sorted(names) in (["X", "Y", "Z"], [""] * 3) and stride >= 3, "no three params")
        order = [names.index(axis) for axis in "XYZ"] if any(names) else [0, 1, 2]
        need(offset + count_of(accessor, "count") * stride <= len(values), "an accessor beyond its array")
        rows = range(offset, offset + count_of(accessor, "count") * stride, stride)
        return [tuple(values[row + k] for k in order) for row in rows]

    def triangles_of(element):
        inputs = element.findall("input")
        at = [i for i in inputs if i.get("semantic") == "VERTEX"]
        if not at and count_of(element, "count", "0") == 0:
            return []
        (vertex,) = at
        need(all(i.get("semantic") is not None for i in inputs), "no semantic")
        step = 1 + max(count_of(i, "offset") for i in inputs)
        holder = named("vertices", vertex.get("source"))
        (position,) = (i for i in holder.findall("input") if i.attrib["semantic"] == "POSITION")
        points = points_of(position.get("source"))
        runs = []
        for p in element.findall("p"):
            indices = [whole(w) for w in tokens(p)]
            need(len(indices) % step == 0, "no whole corners")
            runs.append([pick(points, i) for i in indices[count_of(vertex, "offset") :: step]])
        need(not element.findall("ph"), "a hole")
        count = count_of(element, "count")
        if element.tag in ("triangles", "polylist"):
            need(len(runs) == 1 or (not runs and not count), "not one list")
            corners = runs[0] if runs else []
            if element.tag == "triangles":
                sizes = [3] * count
            else:
                lists = element.findall("vcount")
                need(len(lists) == 1 or (not lists and not count), "not one vcount")
                sizes = [whole(w) for w in tokens(lists[0])] if lists else []
            need(len(sizes) == count and sum(sizes) == len(corners) and all(s >= 3 for s in sizes), "another count")
            found = []
            for size in sizes:
                found += whole_polygon(corners[:size])
                corners = corners[size:]
            return found
        need(len(runs) == count, "another count of lists")
        make = {"tristrips": strip, "trifans": fan, "polygons": whole_polygon}[element.tag]
        return [t for run in runs for t in make(run)]

    def transform(element):
        if element.tag == "matrix":
            m = floats(element, 16)
            need(m[12:] == [0, 0, 0, 1], "no affine map")
            return [m[4 * i : 4 * i + 4] for i in range(4)]
        T = identity()
        if element.tag == "translate":
            for i, x in enumerate(floats(element, 3)):
                T[i][3] = x
        elif element.tag == "scale":
            for i, x in enumerate(floats(element, 3)):
                T[i][i] = x
        elif element.tag == "rotate":
            *axis, angle = floats(element, 4)
            if angle != 0:
                length = math.sqrt(sum(x * x for x in axis))
                need(0 < length < math.inf, "no axis")
                u = [x / length for x in axis]
                c, s = math.cos(math.radians(angle)), math.sin(math.radians(angle))
                cross = [[0, -u[2], u[1]], [u[2], 0, -u[0]], [-u[1], u[0], 0]]
                for i in range(3):
                    for j in range(3):
                        T[i][j] = (i == j) * c + (1 - c) * u[i] * u[j] + s * cross[i][j]
        else:
            raise Refused(f"a transform {element.tag}")
        return T

    def node_triangles(node, parent, depth=0):
        need(depth < 250, "a cycle")
        T, found = parent, []
        shows = any(e.tag == "instance_geometry" for e in node)
        below = [e for e in node if e.tag in ("node", "instance_node")]
        for e in node:
            need(e.tag != "instance_controller", "a skin")
            if e.tag in ("matrix", "translate", "scale", "rotate") or (
                e.tag in ("lookat", "skew") and (shows or below)
            ):
                T = times(T, transform(e))
        for e in node.findall("instance_geometry"):
            mesh = one(named("geometry", e.get("url")), "mesh")
            for child in mesh:
                if child.tag in ("triangles", "polylist", "polygons", "trifans", "tristrips"):
                    found += place(T, triangles_of(child))
                else:
                    known = ("source", "vertices", "extra", "lines", "linestrips", "points", "asset")
                    need(child.tag in known, f"an unknown {child.tag}")
        for e in below:
            found += node_triangles(e if e.tag == "node" else named("node", e.get("url")), T, depth + 1)
        return found

    scene = named("visual_scene", one(one(root, "scene"), "instance_visual_scene").get("url"))
    found = [t for node in scene.findall("node") for t in node_triangles(node, identity())]
    return [tuple(tuple(x * metres for x in p) for p in t) for t in found]
