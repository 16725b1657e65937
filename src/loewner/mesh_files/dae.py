"""Read Collada files: the triangles of the scene, with each geometry placed by its nodes."""

import math
from collections.abc import Callable, Iterator
from typing import Any
from xml.parsers import expat

import numpy as np

from loewner._matrices import product
from loewner._validate import Floats, Ints
from loewner.mesh_files.parts import (
    Refusal,
    Triangles,
    check_range,
    expect,
    fans,
    floats,
    integers,
    joined,
    placed,
    quoted,
    strip,
)

# Limits on the nesting of elements, the number of elements, the nodes of a scene and their contents counted at each
# placement, and the inputs of vertices. Exporters stay far below.
MOST_DEPTH, MOST_ELEMENTS, MOST_PLACED, MOST_INPUTS = 200, 2_000_000, 200_000, 100

_NO_SURFACE = frozenset(["source", "vertices", "extra", "lines", "linestrips", "points", "asset"])


class _Element:
    """An XML element without its namespace."""

    __slots__ = ("attributes", "children", "line", "tag", "texts")

    def __init__(self, tag: str, attributes: dict[str, str], line: int) -> None:
        self.tag, self.attributes, self.line = tag, attributes, line
        self.children: list[_Element] = []
        self.texts: list[str] = []

    def all(self, tag: str) -> list["_Element"]:
        return [child for child in self.children if child.tag == tag]

    def one(self, tag: str) -> "_Element":
        found = self.all(tag)
        expect(len(found) == 1, f"<{self.tag}>: expected one <{tag}>, found {len(found)}", self.line)
        return found[0]

    def get(self, name: str) -> str:
        value = self.attributes.get(name)
        if value is None:
            raise Refusal(f"<{self.tag}>: expected an attribute {name}, found none", self.line)
        return value

    def number(self, name: str, default: int | None = None) -> int:
        text = self.attributes.get(name) if default is not None else self.get(name)
        if text is None:
            return default or 0
        right = text.strip().isascii() and text.strip().isdigit() and len(text) < 16
        expect(right, f"<{self.tag}>: expected {name}, a whole number, found {quoted(text)}", self.line)
        return int(text)

    def reference(self, name: str) -> str:
        """Return the name of the object in the same file to which an attribute refers."""
        value = self.get(name)
        expect(value[:1] == "#", f"<{self.tag}>: expected {name} in this file, found {quoted(value)}", self.line)
        return value[1:]

    def _tokens(self, convert: Callable[[list[bytes]], Any]) -> Any:
        expect(not self.children, f"<{self.tag}>: expected numbers alone, found elements in it", self.line)
        try:
            return convert("".join(self.texts).encode("ascii").split())
        except Refusal as refusal:
            raise Refusal(f"<{self.tag}>: {refusal}", self.line) from None
        except UnicodeError:
            raise Refusal(f"<{self.tag}>: expected numbers, found other letters", self.line) from None

    def floats(self, count: int) -> Floats:
        numbers: Floats = self._tokens(floats)
        expect(len(numbers) == count, f"<{self.tag}>: expected {count} numbers, found {len(numbers)}", self.line)
        return numbers

    def integers(self) -> Ints:
        numbers: Ints = self._tokens(integers)
        return numbers


def read(data: bytes) -> tuple[Floats, Triangles]:
    """Read vertices in metres and triangles of the file's scene; the file's up axis is not applied."""
    root = _parsed(data)
    expect(root.tag == "COLLADA", f"expected <COLLADA>, found <{quoted(root.tag)}>", root.line)
    vertices, triangles = joined(_Scene(root).meshes())
    return vertices * _metres(root), triangles


def _parsed(data: bytes) -> _Element:
    """Parse the tree of elements; entities and other declarations are refused."""
    parser = expat.ParserCreate(namespace_separator="}")
    parser.buffer_text = True
    parser.buffer_size = 1 << 20
    top = _Element("", {}, 0)
    path = [top]
    total = 0

    def start(name: str, attributes: dict[str, str]) -> None:
        nonlocal total
        total += 1
        line = parser.CurrentLineNumber
        expect(len(path) <= MOST_DEPTH, f"expected elements at most {MOST_DEPTH} deep, found more", line)
        expect(total <= MOST_ELEMENTS, f"expected at most {MOST_ELEMENTS} elements, found more", line)
        element = _Element(name.rpartition("}")[2], attributes, line)
        path[-1].children.append(element)
        path.append(element)

    def end(_: str) -> None:
        path.pop()

    def text(words: str) -> None:
        path[-1].texts.append(words)

    def doctype(*_: Any) -> None:
        raise Refusal("expected no document type or entities, found some", parser.CurrentLineNumber)

    parser.StartElementHandler, parser.EndElementHandler = start, end
    parser.CharacterDataHandler, parser.StartDoctypeDeclHandler = text, doctype
    try:
        parser.Parse(data, True)
    except expat.ExpatError as error:
        raise Refusal(
            f"expected XML, found {expat.ErrorString(error.code) or 'something else'}", error.lineno
        ) from None
    except (LookupError, ValueError) as error:
        raise Refusal(f"expected XML, found what cannot be read ({type(error).__name__})") from None
    return top.children[0]


def _metres(root: _Element) -> float:
    """Read the metres per unit of length."""
    for asset in root.all("asset"):
        for unit in asset.all("unit"):
            text = unit.attributes.get("meter", "1").strip()
            try:
                metres = float(floats([text.encode()])[0])
            except Refusal:
                metres = math.nan
            expect(0 < metres < math.inf, f"<unit>: expected metres > 0, found {quoted(text)}", unit.line)
            return metres
    return 1.0


class _Scene:
    """The objects of a file by identifier; geometries are made when a node first uses them."""

    def __init__(self, root: _Element) -> None:
        self.root = root
        self.named: dict[tuple[str, str], list[_Element]] = {}
        waiting = [root]
        while waiting:
            element = waiting.pop()
            name = element.attributes.get("id")
            if name is not None:
                self.named.setdefault((element.tag, name), []).append(element)
            waiting += element.children
        self.made: dict[str, tuple[Floats, Triangles]] = {}
        self.points: dict[str, Floats] = {}

    def find(self, tag: str, name: str, line: int) -> _Element:
        found = self.named.get((tag, name), [])
        expect(len(found) == 1, f"expected one <{tag}> with id {quoted(name)}, found {len(found)}", line)
        return found[0]

    def meshes(self) -> Iterator[tuple[Floats, Triangles]]:
        """Return the geometries of the scene, each at its place, in the order of the file."""
        shown = self.root.one("scene").one("instance_visual_scene")
        scene = self.find("visual_scene", shown.reference("url"), shown.line)
        waiting: list[tuple[_Element, Floats, int]] = [(node, np.eye(4), 0) for node in scene.all("node")[::-1]]
        visits = 0
        while waiting:
            node, T_parent, depth = waiting.pop()
            visits += 1 + len(node.children)
            expect(
                visits <= MOST_PLACED, f"expected at most {MOST_PLACED} nodes and parts of nodes, found more", node.line
            )
            expect(depth <= MOST_DEPTH, f"expected nodes at most {MOST_DEPTH} deep, found more, or a cycle", node.line)
            T, inside = T_parent, []
            for child in node.children:
                if child.tag in _TRANSFORMS:
                    T = product(T, _TRANSFORMS[child.tag](child))
                elif child.tag in ("lookat", "skew"):
                    # Usually for cameras; a mesh placed by it becomes NaN, and is refused.
                    T = T * np.nan
                elif child.tag == "node":
                    inside.append(child)
                elif child.tag == "instance_node":
                    inside.append(self.find("node", child.reference("url"), child.line))
                elif child.tag == "instance_controller":
                    raise Refusal("expected a rigid mesh, found one with a controller", child.line)
            for child in node.all("instance_geometry"):
                expect(np.isfinite(T).all(), "<node>: expected finite transforms, without lookat and skew", node.line)
                yield placed(T, *self.geometry(child.reference("url"), child.line))
            waiting += [(child, T, depth + 1) for child in inside[::-1]]

    def geometry(self, name: str, line: int) -> tuple[Floats, Triangles]:
        if name not in self.made:
            mesh = self.find("geometry", name, line).one("mesh")
            parts = []
            for child in mesh.children:
                if child.tag in _PRIMITIVES:
                    parts.append(self.primitive(child, _PRIMITIVES[child.tag]))
                else:
                    known = child.tag in _NO_SURFACE
                    expect(known, f"<mesh>: expected triangles or polygons, found <{quoted(child.tag)}>", child.line)
            self.made[name] = joined(parts)
        return self.made[name]

    def primitive(
        self, element: _Element, assemble: Callable[[_Element, list[Ints]], Triangles]
    ) -> tuple[Floats, Triangles]:
        inputs = [(i.get("semantic"), i.number("offset"), i) for i in element.all("input")]
        at = [(offset, i) for semantic, offset, i in inputs if semantic == "VERTEX"]
        if not at and not element.number("count", 0):
            return np.empty((0, 3)), np.empty((0, 3), dtype=np.int64)
        expect(len(at) == 1, f"<{element.tag}>: expected one input VERTEX, found {len(at)}", element.line)
        offset, link = at[0]
        step = 1 + max(o for _, o, _ in inputs)
        expect(step <= 1000, f"<{element.tag}>: expected small offsets, found {step - 1}", element.line)
        holder = self.find("vertices", link.reference("source"), link.line)
        expect(len(holder.children) <= MOST_INPUTS, f"<vertices>: expected at most {MOST_INPUTS} inputs", holder.line)
        positions = [i for i in holder.all("input") if i.get("semantic") == "POSITION"]
        expect(len(positions) == 1, f"<vertices>: expected one input POSITION, found {len(positions)}", holder.line)
        points = self.source(positions[0].reference("source"), positions[0].line)
        runs = []
        for p in element.all("p"):
            numbers = p.integers()
            expect(
                len(numbers) % step == 0, f"<p>: expected {step} numbers a corner, found {len(numbers)} in all", p.line
            )
            runs.append(numbers[offset::step])
            check_range(runs[-1], len(points), "<p>", p.line)
        expect(not element.all("ph"), f"<{element.tag}>: expected polygons without holes, found <ph>", element.line)
        return points, assemble(element, runs)

    def source(self, name: str, line: int) -> Floats:
        """Return the points of a source, shape (n, 3); each call returns the same array."""
        if name in self.points:
            return self.points[name]
        source = self.find("source", name, line)
        accessor = source.one("technique_common").one("accessor")
        array = source.one("float_array")
        if "id" in array.attributes:
            expect(accessor.reference("source") == array.get("id"), "<accessor>: expected this source's", accessor.line)
        numbers = array.floats(array.number("count"))
        count, stride = accessor.number("count"), accessor.number("stride", 1)
        offset = accessor.number("offset", 0)
        expect(len(accessor.all("param")) == 3 <= stride, "<accessor>: expected three params and stride", accessor.line)
        needed = offset + count * stride
        expect(needed <= len(numbers), f"<accessor>: expected {needed} numbers, found {len(numbers)}", accessor.line)
        self.points[name] = numbers[offset:needed].reshape(count, stride)[:, :3]
        return self.points[name]


# -- primitives ---------------------------------------------------------------------------------


def _one_run(element: _Element, runs: list[Ints]) -> Ints:
    if not runs and not element.number("count"):
        return np.empty(0, dtype=np.int64)
    expect(len(runs) == 1, f"<{element.tag}>: expected one <p>, found {len(runs)}", element.line)
    return runs[0]


def _triangles(element: _Element, runs: list[Ints]) -> Triangles:
    corners, count = _one_run(element, runs), element.number("count")
    expect(len(corners) == 3 * count, f"<triangles>: expected {3 * count} corners, found {len(corners)}", element.line)
    return corners.reshape(-1, 3)


def _polylist(element: _Element, runs: list[Ints]) -> Triangles:
    corners, count = _one_run(element, runs), element.number("count")
    sizes = element.one("vcount").integers() if count or element.all("vcount") else np.empty(0, dtype=np.int64)
    right = len(sizes) == count and (sizes >= 3).all() and (sizes <= len(corners)).all() and sizes.sum() == len(corners)
    expect(
        right, f"<polylist>: expected {count} polygons in all corners as its vcount says, found others", element.line
    )
    return fans(corners, sizes)


def _runs(element: _Element, runs: list[Ints]) -> list[Ints]:
    count = element.number("count")
    expect(len(runs) == count, f"<{element.tag}>: expected {count} <p>, found {len(runs)}", element.line)
    for run in runs:
        expect(len(run) >= 3, f"<{element.tag}>: expected at least 3 corners, found {len(run)}", element.line)
    return runs


def _polygons(element: _Element, runs: list[Ints]) -> Triangles:
    runs = _runs(element, runs)
    return fans(
        np.concatenate([np.empty(0, dtype=np.int64), *runs]), np.array([len(run) for run in runs], dtype=np.int64)
    )


def _strips(element: _Element, runs: list[Ints]) -> Triangles:
    return np.concatenate([np.empty((0, 3), dtype=np.int64), *(strip(run) for run in _runs(element, runs))])


_PRIMITIVES: dict[str, Callable[[_Element, list[Ints]], Triangles]] = {
    "triangles": _triangles,
    "polylist": _polylist,
    "polygons": _polygons,
    "trifans": _polygons,
    "tristrips": _strips,
}

# -- transforms ---------------------------------------------------------------------------------


def _matrix(element: _Element) -> Floats:
    T = element.floats(16).reshape(4, 4)
    expect(
        (T[3] == [0, 0, 0, 1]).all(),
        f"<matrix>: expected an affine one, found {T[3].tolist()} at its end",
        element.line,
    )
    return T


def _translate(element: _Element) -> Floats:
    T = np.eye(4)
    T[:3, 3] = element.floats(3)
    return T


def _scale(element: _Element) -> Floats:
    return np.diag([*element.floats(3), 1.0])


def _rotate(element: _Element) -> Floats:
    """Read a rotation about an axis by an angle in degrees."""
    *axis, angle = element.floats(4)
    if angle == 0:
        return np.eye(4)
    length = math.hypot(*axis)
    expect(0 < length < math.inf and math.isfinite(angle), "<rotate>: expected an axis and an angle", element.line)
    x, y, z = np.array(axis) / length
    K = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    T = np.eye(4)
    T[:3, :3] += math.sin(math.radians(angle)) * K + (1 - math.cos(math.radians(angle))) * product(K, K)
    return T


_TRANSFORMS: dict[str, Callable[[_Element], Floats]] = {
    "matrix": _matrix,
    "translate": _translate,
    "scale": _scale,
    "rotate": _rotate,
}
