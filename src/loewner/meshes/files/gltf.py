"""Read glTF 2.0 files, text or binary: the triangles of the scene, with each mesh placed by its nodes."""

import base64
import json
import math
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.parse import unquote_to_bytes

import numpy as np
from numpy.typing import NDArray

from loewner._base import _json
from loewner._base._files import read_regular
from loewner._base._matrices import lengths, product
from loewner._base._rotations import pose_of, rotations_of
from loewner._base._validate import Floats, some
from loewner.errors import FileError
from loewner.meshes.files import parts
from loewner.meshes.files.parts import Refusal, Tell, Triangles, expect, quoted

_TYPES = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_INDICES = (5121, 5123, 5125)
_SHAPES = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}
_TRIANGLES, _STRIP, _FAN = 4, 5, 6

# Beginnings of the names of extensions that do not affect the shape. A file is refused if it requires any other
# extension, or uses any other extension between the scene and a buffer.
_HARMLESS = (
    "KHR_materials_",
    "KHR_texture_",
    "EXT_texture_",
    "MSFT_texture_",
    "KHR_lights_",
    "EXT_lights_",
    "KHR_audio",
    "KHR_animation_",  # a file is read as if it had no animations
    "KHR_mesh_quantization",  # coordinates as integers, which are read
    "KHR_xmp",  # authors and licences
    "EXT_mesh_features",  # properties of parts
    "EXT_structural_metadata",
    "FB_geometry_metadata",  # counts of vertices, and a box
    "CESIUM_primitive_outline",  # edges that a program draws
)

# Keys of each kind of object between the scene and a buffer: first the keys that are read, then the harmless keys.
_EVERYWHERE = frozenset(["extensions", "extras", "name"])
_KEYS = {
    kind: _EVERYWHERE.union(read.split(), harmless.split())
    for kind, read, harmless in (
        (
            "the file",
            "asset extensionsRequired scene scenes nodes meshes accessors bufferViews buffers",
            # A list of skins is harmless, since a node that uses a skin is refused.
            "extensionsUsed animations cameras images materials samplers skins textures",
        ),
        ("asset", "version minVersion", "copyright generator"),
        ("scenes", "nodes", ""),
        ("nodes", "children matrix mesh rotation scale skin translation weights", "camera"),
        ("meshes", "primitives weights", ""),
        # Without weights, which are refused, the targets of a morph have no effect.
        ("primitives", "attributes indices mode", "material targets"),
        # The bounds "max" and "min" may be wider than the numbers.
        ("accessors", "bufferView byteOffset componentType count normalized sparse type", "max min"),
        ("sparse", "count indices values", ""),
        ("sparse indices", "bufferView byteOffset componentType", ""),
        ("sparse values", "bufferView byteOffset", ""),
        # The target is a hint for graphics cards: vertices or indices.
        ("bufferViews", "buffer byteLength byteOffset byteStride", "target"),
        ("buffers", "byteLength uri", ""),
    )
}
_UNKNOWN = "expected keys of glTF 2.0, found others, which are not read"

# Number of keys that a warning names.
_LISTED = 10

# Allowed deviation of a rotation's quaternion from length 1.
_UNIT = 1e-2


def read(data: bytes, folder: Path, binary: bool, limit: int, tell: Tell) -> tuple[Floats, Triangles]:
    """Read the vertices, in metres, and the triangles of the file's scene."""
    text, body = _chunks(data) if binary else (data, None)
    reader = _Reader(_parsed(text), body, folder, limit)
    mesh = parts.joined(reader.meshes())
    if reader.unknown:
        names = some((f"{quoted(key)} in {where}" for key, where in reader.unknown.items()), _LISTED)
        tell(f"{_UNKNOWN}: {names}", "")
    return mesh


def _chunks(data: bytes) -> tuple[bytes, bytes | None]:
    """Return the JSON of a GLB file and its first binary chunk, if there is one."""
    expect(len(data) >= 20 and data[:4] == b"glTF", "expected a GLB file, found something else")
    version, length = struct.unpack("<II", data[4:12])
    expect(version == 2, f"expected glTF 2, found version {version}")
    expect(length == len(data), f"expected {length} bytes as its header says, found {len(data)}")
    chunks: list[tuple[bytes, bytes]] = []
    start = 12
    while start < len(data):
        expect(start + 8 <= len(data), "expected a chunk, found the file's end")
        size, kind = struct.unpack("<I4s", data[start : start + 8])
        whole = size % 4 == 0 and start + 8 + size <= len(data)
        expect(whole, f"expected a chunk of {size} bytes, found the file's end")
        chunks.append((kind, data[start + 8 : start + 8 + size]))
        start += 8 + size
    expect(chunks[0][0] == b"JSON", f"expected a chunk JSON, found {quoted(chunks[0][0])}")
    return chunks[0][1], chunks[1][1] if len(chunks) > 1 and chunks[1][0] == b"BIN\0" else None


def _parsed(text: bytes) -> dict[str, Any]:
    def constant(word: str) -> Any:
        raise Refusal(f"expected JSON, found {word}")

    try:
        tree = _json.loads(text.decode("utf-8"), constant)
    except _json.RepeatedKeyError as error:
        raise Refusal(str(error), error.line) from None
    except json.JSONDecodeError as error:
        raise Refusal(f"expected JSON, found {error.msg.lower()} at column {error.colno}", error.lineno) from None
    except (ValueError, RecursionError) as error:
        raise Refusal(f"expected JSON, found an unreadable text ({type(error).__name__})") from None
    if not isinstance(tree, dict):
        raise Refusal(f"expected a JSON object, found {type(tree).__name__}")
    return tree


class _Object:
    """An object of the file's JSON, with its place in the tree for messages."""

    def __init__(self, fields: dict[str, Any], where: str) -> None:
        self.fields, self.where = fields, where

    def expect(self, holds: object, message: str) -> None:
        """Refuse the file, with the object's place, unless a condition holds."""
        expect(holds, f"{self.where}: {message}")

    def integer(self, key: str, default: int | None = None, least: int = 0) -> int:
        value = self.fields.get(key, default)
        if type(value) is not int or not least <= value < 2**53:
            described = quoted(repr(value))
            raise Refusal(f"{self.where}: expected {key}, a whole number of at least {least}, found {described}")
        return value

    def items(self, key: str, kind: type) -> list[Any]:
        value = self.fields.get(key, [])
        right = isinstance(value, list) and all(type(x) is kind for x in value)
        self.expect(right, f"expected {key}, a list of {kind.__name__}, found {quoted(repr(value))}")
        return list(value)

    def floats(self, key: str, default: list[float]) -> Floats:
        value = self.fields.get(key, default)
        right = isinstance(value, list) and len(value) == len(default)
        right = right and all(type(x) in (int, float) and abs(x) < 1e300 for x in value)
        self.expect(right, f"expected {key}, {len(default)} finite numbers, found {quoted(repr(value))}")
        return np.array(value, dtype=np.float64)

    def expect_rigid(self) -> None:
        """Refuse features that deform a mesh or place it more than once."""
        self.expect("skin" not in self.fields, "expected a rigid mesh, found one with a skin")
        weights = self.fields.get("weights", [])
        self.expect(isinstance(weights, list) and not any(weights), "expected no morph, found weights of one")

    def pose(self) -> Floats:
        """Read the transform of a node."""
        if "matrix" in self.fields:
            others = {"translation", "rotation", "scale"} & self.fields.keys()
            self.expect(not others, "expected matrix alone, found more")
            T = self.floats("matrix", [0.0] * 16).reshape(4, 4).T
            last = T[3].tolist()
            self.expect(last == [0, 0, 0, 1], f"expected an affine matrix, found {last} as its last row")
            return T
        quaternion = self.floats("rotation", [0.0, 0.0, 0.0, 1.0])
        length = float(lengths(quaternion)) if abs(quaternion).max() < 2 else math.inf
        self.expect(abs(length - 1) < _UNIT, f"expected a rotation of length 1, found {length:g}")
        turn = rotations_of(np.roll(quaternion / length, 1))
        return pose_of(turn * self.floats("scale", [1.0] * 3), self.floats("translation", [0.0] * 3))


class _Reader:
    """The objects of a file by index, each checked when it is requested."""

    def __init__(self, tree: dict[str, Any], body: bytes | None, folder: Path, limit: int) -> None:
        self.body, self.folder, self.limit = body, folder, limit
        self.buffers: dict[int, bytes] = {}
        self.files: dict[str, bytes] = {}
        self.points: dict[int, Floats] = {}
        self.made: dict[int, tuple[Floats, Triangles]] = {}
        self.unknown: dict[str, str] = {}  # unknown keys, and the first object with each key
        self.top = self.object(tree, "the file", "the file")
        expect(isinstance(tree.get("asset"), dict), "expected an asset of version 2")
        asset = self.object(tree["asset"], "asset", "asset").fields
        version, least = asset.get("version"), asset.get("minVersion", "2.0")
        expect(isinstance(version, str) and version.startswith("2."), "expected an asset of version 2")
        right = least in ("1.0", "1.1", "2.0")
        expect(right, f"expected a file for readers of version 2.0, found minVersion {quoted(str(least))}")
        for name in self.top.items("extensionsRequired", str):
            expect(name.startswith(_HARMLESS), f"expected no extension that changes the shape, found {quoted(name)}")

    # -- objects

    def object(self, fields: Any, where: str, kind: str) -> _Object:
        """Check an object of a given kind: refuse extensions that may change the shape, and note unknown keys.

        A minor version of glTF may add keys, so unknown keys are not an error.
        """
        expect(isinstance(fields, dict), f"{where}: expected an object, found {type(fields).__name__}")
        for key in fields.keys() - _KEYS[kind]:
            self.unknown.setdefault(key, where)
        extensions = fields.get("extensions", {})
        expect(isinstance(extensions, dict), f"{where}: expected extensions, an object")
        harmful = ", ".join(quoted(name) for name in extensions if not name.startswith(_HARMLESS))
        expect(not harmful, f"{where}: expected no extension that changes the shape, found {harmful}")
        return _Object(fields, where)

    def item(self, kind: str, index: int) -> _Object:
        """Return an object from one of the file's lists."""
        objects = self.top.fields.get(kind, [])
        expect(isinstance(objects, list), f"{kind}: expected a list, found {type(objects).__name__}")
        expect(index < len(objects), f"expected one of {len(objects)} {kind}, found number {index}")
        return self.object(objects[index], f"{kind}[{index}]", kind)

    # -- nodes

    def meshes(self) -> Iterator[tuple[Floats, Triangles]]:
        """Return the meshes of the scene, each at its place."""
        scenes = self.top.fields.get("scenes")
        if isinstance(scenes, list) and len(scenes) > 1 and "scene" not in self.top.fields:
            raise Refusal(f"expected scene, the number of the one of {len(scenes)} scenes to show, found none")
        scene = self.item("scenes", self.top.integer("scene", 0))
        waiting = [(index, np.eye(4)) for index in scene.items("nodes", int)[::-1]]
        seen: set[int] = set()
        while waiting:
            index, T_parent = waiting.pop()
            scene.expect(index >= 0, f"expected numbers of nodes, found {index}")
            expect(index not in seen, f"expected a tree of nodes, found nodes[{index}] in it twice")
            seen.add(index)
            node = self.item("nodes", index)
            T = product(T_parent, node.pose())
            waiting += [(child, T) for child in node.items("children", int)[::-1]]
            if "mesh" in node.fields:
                node.expect_rigid()
                yield parts.placed(T, *self.mesh(node.integer("mesh")))

    def mesh(self, index: int) -> tuple[Floats, Triangles]:
        """Return the primitives of a mesh, joined."""
        mesh = self.item("meshes", index)
        mesh.expect_rigid()
        if index not in self.made:
            primitives = mesh.items("primitives", dict)
            mesh.expect(primitives, "expected primitives, found none")
            meshes = (self.primitive(fields, f"{mesh.where}.primitives[{k}]") for k, fields in enumerate(primitives))
            self.made[index] = parts.joined(each for each in meshes if each is not None)
        return self.made[index]

    def primitive(self, fields: dict[str, Any], where: str) -> tuple[Floats, Triangles] | None:
        """Return the vertices and triangles of a primitive; None for points and lines."""
        primitive = self.object(fields, where, "primitives")
        mode = primitive.integer("mode", _TRIANGLES)
        primitive.expect(mode <= _FAN, f"expected a mode of 0 to 6, found {mode}")
        if mode < _TRIANGLES:
            return None
        attributes: Any = fields.get("attributes")
        primitive.expect(isinstance(attributes, dict), "expected attributes, an object")
        number = _Object(attributes, where).integer("POSITION")
        if number not in self.points:
            self.points[number] = self.accessor(number, "VEC3")[0].astype(np.float64)
        vertices = self.points[number]
        if "indices" in fields:
            indices, kind = self.accessor(primitive.integer("indices"), "SCALAR")
            primitive.expect(kind in _INDICES, f"expected indices of unsigned whole numbers, found type {kind}")
            corners = indices.reshape(-1).astype(np.int64)
        else:
            corners = np.arange(len(vertices), dtype=np.int64)
        parts.check_range(corners, len(vertices), f"{where}: indices")
        count = len(corners)
        if mode == _TRIANGLES:
            primitive.expect(count % 3 == 0, f"expected three corners a triangle, found {count} corners")
            return vertices, corners.reshape(-1, 3)
        primitive.expect(count >= 3, f"expected at least 3 corners, found {count}")
        return vertices, parts.strip(corners) if mode == _STRIP else parts.fans(corners, np.array([count]))

    # -- bytes

    def accessor(self, index: int, shape: str) -> tuple[NDArray[Any], int]:
        """Return the numbers of an accessor, shape (count, n), and the type in which they are stored."""
        accessor = self.item("accessors", index)
        count = accessor.integer("count", least=1)
        accessor.expect(count <= 3 * parts.MOST, f"expected a count of at most {3 * parts.MOST}, found {count}")
        kind = accessor.integer("componentType")
        accessor.expect(kind in _TYPES, f"expected a componentType, found {kind}")
        element_type, sparse = accessor.fields.get("type"), accessor.fields.get("sparse")
        accessor.expect(element_type == shape, f"expected type {shape}, found {quoted(repr(element_type))}")
        if "bufferView" in accessor.fields:
            values = self.view(accessor, count, kind, _SHAPES[shape])
        else:
            accessor.expect("sparse" in accessor.fields, "expected a bufferView, found none")
            values = np.zeros((count, _SHAPES[shape]), dtype=_TYPES[kind])
        if "sparse" in accessor.fields:
            values = self.replaced(self.object(sparse, f"{accessor.where}.sparse", "sparse"), values, kind)
        normalized = accessor.fields.get("normalized", False)
        accessor.expect(isinstance(normalized, bool), "expected normalized, true or false")
        if normalized and shape == "VEC3":
            accessor.expect(kind not in (5125, 5126), f"expected short numbers to normalise, found type {kind}")
            values = np.maximum(values.astype(np.float64) / np.iinfo(values.dtype).max, -1.0)
        return values, kind

    def view(self, holder: _Object, count: int, kind: int, width: int) -> NDArray[Any]:
        """Return rows of numbers from a buffer view, at the offset that `holder` gives."""
        view = self.item("bufferViews", holder.integer("bufferView"))
        data = self.buffer(view.integer("buffer"))
        start, length = view.integer("byteOffset", 0), view.integer("byteLength", least=1)
        view.expect(start + length <= len(data), f"expected bytes {start} to {start + length}, found {len(data)}")
        size = np.dtype(_TYPES[kind]).itemsize
        row = size * width
        stride = view.integer("byteStride", row)
        view.expect(row <= stride, f"expected a byteStride of at least {row}, found {stride}")
        offset = holder.integer("byteOffset", 0)
        needed = offset + (count - 1) * stride + row
        holder.expect(needed <= length, f"expected {needed} bytes in {view.where}, found {length}")
        return np.ndarray((count, width), _TYPES[kind], data, start + offset, (stride, size))

    def replaced(self, sparse: _Object, values: NDArray[Any], kind: int) -> NDArray[Any]:
        """Apply the replacements of a sparse accessor to `values`."""
        count = sparse.integer("count", least=1)
        sparse.expect(count <= len(values), f"expected a count of at most {len(values)}, found {count}")
        rows = self.object(sparse.fields.get("indices"), f"{sparse.where}.indices", "sparse indices")
        new = self.object(sparse.fields.get("values"), f"{sparse.where}.values", "sparse values")
        row_kind = rows.integer("componentType")
        rows.expect(row_kind in _INDICES, f"expected indices of unsigned whole numbers, found type {row_kind}")
        places = self.view(rows, count, row_kind, 1).reshape(-1).astype(np.int64)
        rising = (np.diff(places) > 0).all() and places[-1] < len(values)
        rows.expect(rising, f"expected indices that rise, below {len(values)}, found others")
        changed = np.array(values)
        changed[places] = self.view(new, count, kind, values.shape[1])
        return changed

    def buffer(self, index: int) -> bytes:
        if index not in self.buffers:
            buffer = self.item("buffers", index)
            length = buffer.integer("byteLength", least=1)
            if "uri" in buffer.fields:
                data = self.linked(buffer.fields["uri"], buffer.where)
            else:
                if index or self.body is None:
                    raise Refusal(f"{buffer.where}: expected a uri, found none")
                data = self.body
            # Chunks and some exporters' files are padded to a multiple of four.
            right = length <= len(data) < length + 4
            buffer.expect(right, f"expected {length} bytes as it says, found {len(data)}")
            self.buffers[index] = data[:length]
        return self.buffers[index]

    def linked(self, uri: Any, where: str) -> bytes:
        """Return the bytes of a data URI, or of a file in this file's folder or below."""
        expect(isinstance(uri, str), f"{where}: expected a uri, found {type(uri).__name__}")
        if uri.startswith("data:"):
            head, _, text = uri.partition(",")
            expect(head.endswith(";base64"), f"{where}: expected data in base64, found {quoted(head)}")
            try:
                return base64.b64decode(text, validate=True)
            except ValueError:
                raise Refusal(f"{where}: expected data in base64, found something else") from None
        if uri not in self.files:
            try:
                name = unquote_to_bytes(uri).decode("utf-8")
            except UnicodeError:
                raise Refusal(f"{where}: expected a uri in UTF-8, found {quoted(uri)}") from None
            steps = name.replace("\\", "/").split("/")
            inside = ":" not in name and ".." not in steps and steps[0] != ""
            expect(inside, f"{where}: expected a file in the folder of this one or below, found {quoted(uri)}")
            room = self.limit - sum(map(len, self.files.values()))
            try:
                self.files[uri] = read_regular(self.folder / name, "a buffer of a glTF file", room)
            except FileError as error:
                raise Refusal(f"{where}: {error}") from None
        return self.files[uri]
