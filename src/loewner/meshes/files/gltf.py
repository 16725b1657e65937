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
from loewner._base._validate import Floats, Ints
from loewner.errors import FileError
from loewner.meshes.files.parts import (
    MOST,
    Refusal,
    Tell,
    Triangles,
    check_range,
    expect,
    joined,
    placed,
    quoted,
    strip,
)

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
    "KHR_animation_",  # a file is read as it is without animations
    "KHR_mesh_quantization",  # integers as coordinates, which are read
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
    mesh = joined(reader.meshes())
    if reader.unknown:
        names = ", ".join(f"{quoted(key)} in {where}" for key, where in list(reader.unknown.items())[:_LISTED])
        more = f" and {len(reader.unknown) - _LISTED} more" if len(reader.unknown) > _LISTED else ""
        tell(f"{_UNKNOWN}: {names}{more}", "")
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
        expect(
            size % 4 == 0 and start + 8 + size <= len(data), f"expected a chunk of {size} bytes, found the file's end"
        )
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
        raise Refusal(f"expected JSON, found what cannot be read ({type(error).__name__})") from None
    if not isinstance(tree, dict):
        raise Refusal(f"expected a JSON object, found {type(tree).__name__}")
    return tree


class _Reader:
    """The objects of a file by index, each checked when it is requested."""

    def __init__(self, tree: dict[str, Any], body: bytes | None, folder: Path, limit: int) -> None:
        self.tree, self.body, self.folder, self.limit = tree, body, folder, limit
        self.buffers: dict[int, bytes] = {}
        self.files: dict[str, bytes] = {}
        self.points: dict[int, Floats] = {}
        self.made: dict[int, tuple[Floats, Triangles]] = {}
        self.unknown: dict[str, str] = {}  # unknown keys, and the first object with each key
        self.check(tree, "the file", "the file")
        asset: Any = tree.get("asset")
        expect(isinstance(asset, dict), "expected an asset of version 2")
        self.check(asset, "asset", "asset")
        version, least = asset.get("version"), asset.get("minVersion", "2.0")
        expect(isinstance(version, str) and version.startswith("2."), "expected an asset of version 2")
        expect(
            least in ("1.0", "1.1", "2.0"),
            f"expected a file for readers of version 2.0, found minVersion {quoted(str(least))}",
        )
        for name in self.items(tree, "the file", "extensionsRequired", str):
            expect(name.startswith(_HARMLESS), f"expected no extension that changes the shape, found {quoted(name)}")

    # -- fields

    def item(self, kind: str, index: int) -> tuple[dict[str, Any], str]:
        """Return an object from one of the file's lists, and its name for messages."""
        objects = self.tree.get(kind, [])
        expect(isinstance(objects, list), f"{kind}: expected a list, found {type(objects).__name__}")
        expect(index < len(objects), f"expected one of {len(objects)} {kind}, found number {index}")
        where = f"{kind}[{index}]"
        expect(isinstance(objects[index], dict), f"{where}: expected an object, found {type(objects[index]).__name__}")
        self.check(objects[index], where, kind)
        return objects[index], where

    def check(self, holder: dict[str, Any], where: str, kind: str) -> None:
        """Refuse extensions of an object that may change the shape, and note keys that are unknown for its kind.

        A minor version of glTF may add keys, so unknown keys are not an error.
        """
        for key in holder.keys() - _KEYS[kind]:
            self.unknown.setdefault(key, where)
        extensions = holder.get("extensions", {})
        expect(isinstance(extensions, dict), f"{where}: expected extensions, an object")
        harmful = ", ".join(quoted(name) for name in extensions if not name.startswith(_HARMLESS))
        expect(not harmful, f"{where}: expected no extension that changes the shape, found {harmful}")

    @staticmethod
    def integer(holder: dict[str, Any], where: str, key: str, default: int | None = None, least: int = 0) -> int:
        value = holder.get(key, default)
        if type(value) is not int or not least <= value < 2**53:
            raise Refusal(f"{where}: expected {key}, a whole number of at least {least}, found {quoted(repr(value))}")
        return value

    @staticmethod
    def items(holder: dict[str, Any], where: str, key: str, kind: type) -> list[Any]:
        value = holder.get(key, [])
        right = isinstance(value, list) and all(type(x) is kind for x in value)
        expect(right, f"{where}: expected {key}, a list of {kind.__name__}, found {quoted(repr(value))}")
        return list(value)

    @staticmethod
    def floats(holder: dict[str, Any], where: str, key: str, default: list[float]) -> Floats:
        value = holder.get(key, default)
        right = isinstance(value, list) and len(value) == len(default)
        right = right and all(type(x) in (int, float) and abs(x) < 1e300 for x in value)
        expect(right, f"{where}: expected {key}, {len(default)} finite numbers, found {quoted(repr(value))}")
        return np.array(value, dtype=np.float64)

    # -- nodes

    def meshes(self) -> Iterator[tuple[Floats, Triangles]]:
        """Return the meshes of the scene, each at its place."""
        scenes = self.tree.get("scenes")
        if isinstance(scenes, list) and len(scenes) > 1 and "scene" not in self.tree:
            raise Refusal(f"expected scene, the number of the one of {len(scenes)} scenes to show, found none")
        scene, where = self.item("scenes", self.integer(self.tree, "the file", "scene", 0))
        waiting = [(index, np.eye(4)) for index in self.items(scene, where, "nodes", int)[::-1]]
        seen: set[int] = set()
        while waiting:
            index, T_parent = waiting.pop()
            expect(index >= 0, f"{where}: expected numbers of nodes, found {index}")
            expect(index not in seen, f"expected a tree of nodes, found nodes[{index}] in it twice")
            seen.add(index)
            node, name = self.item("nodes", index)
            T = product(T_parent, self.pose(node, name))
            waiting += [(child, T) for child in self.items(node, name, "children", int)[::-1]]
            if "mesh" in node:
                self.expect_rigid(node, name)
                for primitive in self.primitives(self.integer(node, name, "mesh")):
                    yield placed(T, *primitive)

    def pose(self, node: dict[str, Any], where: str) -> Floats:
        if "matrix" in node:
            expect(
                not {"translation", "rotation", "scale"} & node.keys(), f"{where}: expected matrix alone, found more"
            )
            T = self.floats(node, where, "matrix", [0.0] * 16).reshape(4, 4).T
            expect(
                (T[3] == [0, 0, 0, 1]).all(),
                f"{where}: expected an affine matrix, found {T[3].tolist()} as its last row",
            )
            return T
        quaternion = self.floats(node, where, "rotation", [0.0, 0.0, 0.0, 1.0])
        length = float(lengths(quaternion)) if abs(quaternion).max() < 2 else math.inf
        expect(abs(length - 1) < _UNIT, f"{where}: expected a rotation of length 1, found {length:g}")
        turn = rotations_of(np.roll(quaternion / length, 1))
        scale, shift = self.floats(node, where, "scale", [1.0] * 3), self.floats(node, where, "translation", [0.0] * 3)
        return pose_of(turn * scale, shift)

    def expect_rigid(self, holder: dict[str, Any], where: str) -> None:
        """Refuse features that deform a mesh or place it more than once."""
        expect("skin" not in holder, f"{where}: expected a rigid mesh, found one with a skin")
        weights = holder.get("weights", [])
        expect(isinstance(weights, list) and not any(weights), f"{where}: expected no morph, found weights of one")

    def primitives(self, index: int) -> Iterator[tuple[Floats, Triangles]]:
        mesh, where = self.item("meshes", index)
        self.expect_rigid(mesh, where)
        if index not in self.made:
            primitives = self.items(mesh, where, "primitives", dict)
            expect(primitives, f"{where}: expected primitives, found none")
            parts = (self.primitive(p, f"{where}.primitives[{k}]") for k, p in enumerate(primitives))
            self.made[index] = joined(part for part in parts if part is not None)
        yield self.made[index]

    def primitive(self, primitive: dict[str, Any], where: str) -> tuple[Floats, Triangles] | None:
        """Return the vertices and triangles of a primitive; None for points and lines."""
        self.check(primitive, where, "primitives")
        mode = self.integer(primitive, where, "mode", _TRIANGLES)
        expect(mode <= _FAN, f"{where}: expected a mode of 0 to 6, found {mode}")
        if mode < _TRIANGLES:
            return None
        attributes: Any = primitive.get("attributes")
        expect(isinstance(attributes, dict), f"{where}: expected attributes, an object")
        number = self.integer(attributes, where, "POSITION")
        if number not in self.points:
            self.points[number] = self.accessor(number, "VEC3")[0].astype(np.float64)
        vertices = self.points[number]
        if "indices" in primitive:
            indices, kind = self.accessor(self.integer(primitive, where, "indices"), "SCALAR")
            expect(kind in _INDICES, f"{where}: expected indices of unsigned whole numbers, found type {kind}")
            corners = indices.reshape(-1).astype(np.int64)
        else:
            corners = np.arange(len(vertices), dtype=np.int64)
        check_range(corners, len(vertices), f"{where}: indices")
        return vertices, _assembled(corners, mode, where)

    # -- bytes

    def accessor(self, index: int, shape: str) -> tuple[NDArray[Any], int]:
        """Return the numbers of an accessor, shape (count, n), and the type in which they are stored."""
        accessor, where = self.item("accessors", index)
        count = self.integer(accessor, where, "count", least=1)
        expect(count <= 3 * MOST, f"{where}: expected a count of at most {3 * MOST}, found {count}")
        kind = self.integer(accessor, where, "componentType")
        expect(kind in _TYPES, f"{where}: expected a componentType, found {kind}")
        element_type = accessor.get("type")
        expect(element_type == shape, f"{where}: expected type {shape}, found {quoted(repr(element_type))}")
        expect("bufferView" in accessor or "sparse" in accessor, f"{where}: expected a bufferView, found none")
        if "bufferView" in accessor:
            values = self.view(accessor, where, count, kind, _SHAPES[shape])
        else:
            values = np.zeros((count, _SHAPES[shape]), dtype=_TYPES[kind])
        if "sparse" in accessor:
            values = self.replaced(accessor["sparse"], f"{where}.sparse", values, kind)
        normalized = accessor.get("normalized", False)
        expect(isinstance(normalized, bool), f"{where}: expected normalized, true or false")
        if normalized and shape == "VEC3":
            expect(kind != 5126 and kind != 5125, f"{where}: expected short numbers to normalise, found type {kind}")
            values = np.maximum(values.astype(np.float64) / np.iinfo(values.dtype).max, -1.0)
        return values, kind

    def view(self, holder: dict[str, Any], where: str, count: int, kind: int, width: int) -> NDArray[Any]:
        """Return rows of numbers from a buffer view, at the offset that `holder` gives."""
        view, name = self.item("bufferViews", self.integer(holder, where, "bufferView"))
        data = self.buffer(self.integer(view, name, "buffer"))
        start, length = self.integer(view, name, "byteOffset", 0), self.integer(view, name, "byteLength", least=1)
        expect(start + length <= len(data), f"{name}: expected bytes {start} to {start + length}, found {len(data)}")
        row = np.dtype(_TYPES[kind]).itemsize * width
        stride = self.integer(view, name, "byteStride", row)
        expect(row <= stride, f"{name}: expected a byteStride of at least {row}, found {stride}")
        offset = self.integer(holder, where, "byteOffset", 0)
        needed = offset + (count - 1) * stride + row
        expect(needed <= length, f"{where}: expected {needed} bytes in {name}, found {length}")
        size = np.dtype(_TYPES[kind]).itemsize
        return np.ndarray((count, width), _TYPES[kind], data, start + offset, (stride, size))

    def replaced(self, sparse: Any, where: str, values: NDArray[Any], kind: int) -> NDArray[Any]:
        """Apply the replacements of a sparse accessor to `values`."""
        expect(isinstance(sparse, dict), f"{where}: expected an object")
        self.check(sparse, where, "sparse")
        count = self.integer(sparse, where, "count", least=1)
        expect(count <= len(values), f"{where}: expected a count of at most {len(values)}, found {count}")
        rows, new = sparse.get("indices"), sparse.get("values")
        expect(isinstance(rows, dict) and isinstance(new, dict), f"{where}: expected indices and values, objects")
        self.check(rows, f"{where}.indices", "sparse indices")
        self.check(new, f"{where}.values", "sparse values")
        row_kind = self.integer(rows, where, "componentType")
        expect(row_kind in _INDICES, f"{where}: expected indices of unsigned whole numbers, found type {row_kind}")
        places = self.view(rows, where, count, row_kind, 1).reshape(-1).astype(np.int64)
        rising = (np.diff(places) > 0).all() and places[-1] < len(values)
        expect(rising, f"{where}: expected indices that rise, below {len(values)}, found others")
        changed = np.array(values)
        changed[places] = self.view(new, where, count, kind, values.shape[1])
        return changed

    def buffer(self, index: int) -> bytes:
        if index not in self.buffers:
            buffer, where = self.item("buffers", index)
            length = self.integer(buffer, where, "byteLength", least=1)
            if "uri" in buffer:
                data = self.linked(buffer["uri"], where)
            else:
                if index or self.body is None:
                    raise Refusal(f"{where}: expected a uri, found none")
                data = self.body
            # Chunks and some exporters' files are padded to a multiple of four.
            right = length <= len(data) < length + 4
            expect(right, f"{where}: expected {length} bytes as it says, found {len(data)}")
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
            parts = name.replace("\\", "/").split("/")
            inside = ":" not in name and ".." not in parts and parts[0] != ""
            expect(inside, f"{where}: expected a file in the folder of this one or below, found {quoted(uri)}")
            room = self.limit - sum(map(len, self.files.values()))
            try:
                self.files[uri] = read_regular(self.folder / name, "a buffer of a glTF file", room)
            except FileError as error:
                raise Refusal(f"{where}: {error}") from None
        return self.files[uri]


def _assembled(corners: Ints, mode: int, where: str) -> Triangles:
    if mode == _TRIANGLES:
        expect(len(corners) % 3 == 0, f"{where}: expected three corners a triangle, found {len(corners)} corners")
        return corners.reshape(-1, 3)
    expect(len(corners) >= 3, f"{where}: expected at least 3 corners, found {len(corners)}")
    if mode == _STRIP:
        return strip(corners)
    return np.stack([np.broadcast_to(corners[0], len(corners) - 2), corners[1:-1], corners[2:]], axis=1)
