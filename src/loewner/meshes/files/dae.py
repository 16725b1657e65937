"""Read Collada files: the triangles of the scene, with each geometry placed by its nodes."""

import math
from collections.abc import Callable, Iterator, Sequence
from typing import NoReturn

import numpy as np
from numpy.typing import NDArray

from loewner._base import _elementary
from loewner._base._matrices import product
from loewner._base._rotations import pose_of
from loewner._base._validate import Floats, Ints
from loewner._base._xml import Element, XmlError, parse
from loewner.meshes.files import parts
from loewner.meshes.files.parts import Refusal, Tell, Triangles, expect, quoted
from loewner.meshes.files.text import T, floats, integers

# Limits on the nesting of elements, on their number, on the nodes of a scene and their contents (counted at each
# placement), and on the inputs of vertices. Exporters stay far below these limits.
MOST_DEPTH, MOST_ELEMENTS, MOST_PLACED, MOST_INPUTS = 200, 2_000_000, 200_000, 100

_NO_SURFACE = frozenset(["source", "vertices", "extra", "lines", "linestrips", "points", "asset"])


def _listed(**names_by_tag: str) -> dict[str, frozenset[str]]:
    """Split the names that are listed for each tag."""
    return {tag: frozenset(names.split()) for tag, names in names_by_tag.items()}


# Children and attributes ("@") that the standard defines; any other name may be a misspelt unit, transform or count.
_PARTS = _listed(
    COLLADA="asset scene extra @base @version",  # and libraries of any name
    # The last five children belong inside a <contributor>, an element that old exporters leave out.
    asset="contributor coverage created extra keywords modified revision subject title unit up_axis "
    "author authoring_tool comments copyright source_data",
    unit="extra @meter @name",
    scene="instance_visual_scene instance_physics_scene instance_kinematics_scene extra @sid @name",
    visual_scene="asset evaluate_scene extra node @id @name",
    node="asset extra instance_camera instance_controller instance_geometry instance_light instance_node lookat "
    "matrix node rotate scale skew translate @id @name @sid @type @layer",
    instance_visual_scene="extra @sid @name @url",
    instance_geometry="bind_material extra @sid @name @url",
    instance_node="extra @sid @name @url @proxy",
    **dict.fromkeys(("matrix", "translate", "rotate", "scale"), "@sid"),
    geometry="asset convex_mesh mesh spline brep extra @id @name",
    vertices="input extra @id @name",
    **dict.fromkeys(("triangles", "trifans", "tristrips"), "input p extra @name @count @material"),
    polylist="input vcount p extra @name @count @material",
    polygons="input p ph extra @name @count @material",
    input="@offset @semantic @source @set",
    **dict.fromkeys(("p", "vcount"), ""),
)
# Children and attributes of a source of points; other sources, such as normals, are not read.
_PARTS_OF_POINTS = _listed(
    source="asset float_array technique_common technique extra @id @name",
    float_array="@count @digits @id @magnitude @name",
    technique_common="accessor",
    accessor="param @count @offset @source @stride",
    param="@name @semantic @sid @type",
)

_NAMES = frozenset(["@id", "@name"])
_OF_NUMBERS = ("matrix", "translate", "rotate", "scale", "p", "vcount", "float_array")

# Metres per unit, for the names of units that exporters write.
_USUAL = {"meter": 1.0, "decimeter": 0.1, "centimeter": 0.01, "millimeter": 0.001, "inch": 0.0254, "foot": 0.3048}

# A function that cuts polygons, with the arguments of `parts.fans`.
_Cut = Callable[[Ints, Ints], Triangles]


class _Element(Element):
    """An XML element without its namespace."""

    __slots__ = ()

    def fault(self, expected: str, found: str) -> NoReturn:
        raise Refusal(f"expected {expected}, found {found}", self.line)

    def expect(self, holds: object, message: str) -> None:
        """Refuse the file, with the element's tag and line, unless a condition holds."""
        expect(holds, f"<{self.tag}>: {message}", self.line)

    def text(self, name: str) -> str:
        """Return an attribute, which must exist."""
        value = self.get(name)
        if value is None:
            self.fault(f"an attribute {name} of <{self.tag}>", "none")
        return value

    def number(self, name: str, default: int | None = None) -> int:
        text = self.get(name) if default is not None else self.text(name)
        if text is None:
            return default or 0
        right = text.strip().isascii() and text.strip().isdigit() and len(text) < 16
        self.expect(right, f"expected {name}, a whole number, found {quoted(text)}")
        return int(text)

    def reference(self, name: str) -> str:
        """Return the name of the object in the same file to which an attribute refers."""
        value = self.text(name)
        self.expect(value[:1] == "#", f"expected {name} in this file, found {quoted(value)}")
        return value[1:]

    def _tokens(self, convert: Callable[[Sequence[bytes]], NDArray[T]]) -> NDArray[T]:
        self.expect(not self.children, "expected numbers alone, found elements in it")
        try:
            return convert("".join(self.texts).encode("ascii").split())
        except Refusal as refusal:
            raise Refusal(f"<{self.tag}>: {refusal}", self.line) from None
        except UnicodeError:
            raise Refusal(f"<{self.tag}>: expected numbers, found other letters", self.line) from None

    def floats(self, count: int) -> Floats:
        numbers = self._tokens(floats)
        self.expect(len(numbers) == count, f"expected {count} numbers, found {len(numbers)}")
        return numbers

    def integers(self) -> Ints:
        return self._tokens(integers)


def read(data: bytes, tell: Tell) -> tuple[Floats, Triangles]:
    """Read vertices in metres and triangles of the file's scene; the file's up axis is not applied."""
    root = _parsed(data)
    expect(root.tag == "COLLADA", f"expected <COLLADA>, found <{quoted(root.tag)}>", root.line)
    asset = root.one("asset")
    unit, up = (asset.one("unit"), asset.one("up_axis")) if asset else (None, None)
    axis = "Z_UP" if up is None else "".join(up.texts).strip()
    if up is not None and axis != "Z_UP":
        tell(f"expected <up_axis> Z_UP, found {quoted(axis)}, which is not applied: z stays up", f"line {up.line}")
    metres = 1.0 if unit is None else _metres(unit)
    if unit is not None:
        name = (unit.get("name") or "").lower().rstrip("s")
        usual = _USUAL.get(name.replace("metre", "meter"), metres)
        if abs(usual - metres) > 0.01 * usual:
            tell(f"expected {usual:g} m as a {name}, found meter={metres:g}, which counts", f"line {unit.line}")
    vertices, triangles = parts.joined(_Scene(root, metres, tell).meshes())
    return vertices * metres, triangles


def _parsed(data: bytes) -> _Element:
    """Parse the tree of elements; refuse entities and other declarations."""
    try:
        return parse(
            data, "a Collada file", _Element, deepest=MOST_DEPTH, most=MOST_ELEMENTS, texts=True, doctype=False,
            strip=True,
        )  # fmt: skip
    except XmlError as error:
        raise Refusal(str(error), error.line) from None


def _metres(unit: _Element) -> float:
    """Read the metres of a <unit>."""
    text = unit.attributes.get("meter", "1").strip()
    try:
        metres = float(floats([text.encode()])[0])
    except Refusal:
        metres = math.nan
    unit.expect(0 < metres < math.inf, f"expected metres > 0, found {quoted(text)}")
    return metres


class _Scene:
    """The objects of a file by identifier; geometries are made when a node first uses them."""

    def __init__(self, root: _Element, metres: float, tell: Tell) -> None:
        self.root, self.tell = root, tell
        self.named: dict[tuple[str, str], list[_Element]] = {}
        waiting = [root]
        while waiting:
            element = waiting.pop()
            name = element.attributes.get("id")
            if name is not None:
                self.named.setdefault((element.tag, name), []).append(element)
            if element.tag in _PARTS:
                _check_parts(element, _PARTS[element.tag])
            if element.tag == "unit":
                unit = _metres(element)
                element.expect(unit == metres, f"expected the file's unit, {metres:g} m, found {unit:g} m")
            if element.tag.startswith("library_") or element.tag == "mesh":
                _check_attributes(element, _NAMES)
            if element.tag not in ("extra", "technique"):  # in the standard, these hold other programs' data
                waiting += element.children
        self.made: dict[str, tuple[Floats, Triangles]] = {}
        self.points: dict[str, Floats] = {}

    def find(self, tag: str, name: str, line: int) -> _Element:
        elements = self.named.get((tag, name), [])
        expect(len(elements) == 1, f"expected one <{tag}> with id {quoted(name)}, found {len(elements)}", line)
        return elements[0]

    def meshes(self) -> Iterator[tuple[Floats, Triangles]]:
        """Return the geometries of the scene, each at its place, in the order of the file."""
        shown = self.root.the("scene").the("instance_visual_scene")
        scene = self.find("visual_scene", shown.reference("url"), shown.line)
        waiting: list[tuple[_Element, Floats, int]] = [(node, np.eye(4), 0) for node in scene.all("node")[::-1]]
        visits = 0
        while waiting:
            node, T_parent, depth = waiting.pop()
            visits += 1 + len(node.children)
            if visits > MOST_PLACED:
                raise Refusal(f"expected at most {MOST_PLACED} nodes and parts of nodes, found more", node.line)
            expect(depth <= MOST_DEPTH, f"expected nodes at most {MOST_DEPTH} deep, found more, or a cycle", node.line)
            T, inside = T_parent, []
            for child in node.children:
                if child.tag in _TRANSFORMS:
                    T = product(T, _TRANSFORMS[child.tag](child))
                elif child.tag in ("lookat", "skew"):
                    # Such a transform usually places a camera. A mesh that it places becomes NaN, and is refused.
                    T = T * np.nan
                elif child.tag == "node":
                    inside.append(child)
                elif child.tag == "instance_node":
                    inside.append(self.find("node", child.reference("url"), child.line))
                elif child.tag == "instance_controller":
                    raise Refusal("expected a rigid mesh, found one with a controller", child.line)
            for child in node.all("instance_geometry"):
                node.expect(np.isfinite(T).all(), "expected finite transforms, without lookat and skew")
                yield parts.placed(T, *self.geometry(child.reference("url"), child.line))
            waiting += [(child, T, depth + 1) for child in inside[::-1]]

    def geometry(self, name: str, line: int) -> tuple[Floats, Triangles]:
        if name not in self.made:
            geometry = self.find("geometry", name, line)
            mesh = geometry.the("mesh")
            other = [child for child in geometry.children if child.tag in ("brep", "convex_mesh", "spline")]
            geometry.expect(not other, "expected a mesh alone, found another shape")
            meshes = []
            for child in mesh.children:
                if child.tag in _PRIMITIVES:
                    meshes.append(self.primitive(child, _PRIMITIVES[child.tag]))
                elif child.tag not in _NO_SURFACE:
                    raise Refusal(f"<mesh>: expected triangles or polygons, found <{quoted(child.tag)}>", child.line)
            self.made[name] = parts.joined(meshes)
        return self.made[name]

    def primitive(
        self, element: _Element, assemble: Callable[[_Element, list[Ints], _Cut], Triangles]
    ) -> tuple[Floats, Triangles]:
        inputs = [(i.text("semantic"), i.number("offset"), i) for i in element.all("input")]
        at = [(offset, i) for semantic, offset, i in inputs if semantic == "VERTEX"]
        if not at and not element.number("count", 0):
            return np.empty((0, 3)), np.empty((0, 3), dtype=np.int64)
        element.expect(len(at) == 1, f"expected one input VERTEX, found {len(at)}")
        offset, link = at[0]
        step = 1 + max(o for _, o, _ in inputs)
        element.expect(step <= 1000, f"expected small offsets, found {step - 1}")
        holder = self.find("vertices", link.reference("source"), link.line)
        holder.expect(len(holder.children) <= MOST_INPUTS, f"expected at most {MOST_INPUTS} inputs")
        positions = [i for i in holder.all("input") if i.text("semantic") == "POSITION"]
        holder.expect(len(positions) == 1, f"expected one input POSITION, found {len(positions)}")
        points = self.source(positions[0].reference("source"), positions[0].line)
        runs = []
        for p in element.all("p"):
            numbers = p.integers()
            p.expect(len(numbers) % step == 0, f"expected {step} numbers a corner, found {len(numbers)} in all")
            runs.append(numbers[offset::step])
            parts.check_range(runs[-1], len(points), "<p>", p.line)
        element.expect(not element.all("ph"), "expected polygons without holes, found <ph>")
        place = f"line {element.line}"
        return points, assemble(element, runs, lambda c, sizes: parts.cut(points, c, sizes, self.tell, lambda _: place))

    def source(self, name: str, line: int) -> Floats:
        """Return the points of a source, shape (n, 3); each call returns the same array."""
        if name in self.points:
            return self.points[name]
        source = self.find("source", name, line)
        technique, array = source.the("technique_common"), source.the("float_array")
        accessor = technique.the("accessor")
        for element in (source, technique, array, accessor, *accessor.children):
            if element.tag in _PARTS_OF_POINTS:
                _check_parts(element, _PARTS_OF_POINTS[element.tag])
        if "id" in array.attributes:
            accessor.expect(accessor.reference("source") == array.text("id"), "expected this source's array")
        numbers = array.floats(array.number("count"))
        count, stride = accessor.number("count"), accessor.number("stride", 1)
        offset = accessor.number("offset", 0)
        params = accessor.all("param")
        if len(params) > 3:  # a param without a name skips a value
            accessor.expect(not any(param.get("name") for param in params[3:]), "expected three params")
            params = params[:3]
        accessor.expect(len(params) == 3 <= stride, "expected three params, and a stride of at least 3")
        needed = offset + count * stride
        accessor.expect(needed <= len(numbers), f"expected {needed} numbers, found {len(numbers)}")
        self.points[name] = numbers[offset:needed].reshape(count, stride)[:, _axes(params)]
        return self.points[name]


def _check_parts(element: _Element, known: frozenset[str]) -> None:
    """Refuse children and attributes that Collada does not have, and text between children."""
    if element.tag not in _OF_NUMBERS and element.texts:
        text = "".join(element.texts).strip()
        element.expect(not text, f"expected elements and attributes alone, found {quoted(text)}")
    for child in element.children:
        if child.tag not in known and not (element.tag == "COLLADA" and child.tag[:8] == "library_"):
            listed = ", ".join(sorted(name for name in known if name[0] != "@")) or "none"
            child_tag = f"<{quoted(child.tag)}>"
            raise Refusal(f"<{element.tag}>: expected elements of Collada ({listed}), found {child_tag}", child.line)
    _check_attributes(element, known)


def _check_attributes(element: _Element, known: frozenset[str]) -> None:
    """Refuse attributes that Collada does not have; an attribute in its own namespace belongs to another program."""
    for name in element.attributes:
        if "@" + name not in known and "}" not in name:
            listed = ", ".join(sorted(one[1:] for one in known if one[0] == "@")) or "none"
            raise Refusal(
                f"<{element.tag}>: expected attributes of Collada ({listed}), found {quoted(name)}", element.line
            )


def _axes(params: list[_Element]) -> list[int]:
    """Return the columns of x, y and z; parameters without names are in this order."""
    names = [(param.get("name") or "").upper() for param in params]
    if not any(names):
        return [0, 1, 2]
    params[0].expect(sorted(names) == ["X", "Y", "Z"], f"expected X, Y and Z, found {names}")
    return [names.index(axis) for axis in "XYZ"]


# -- primitives ---------------------------------------------------------------------------------


def _one_run(element: _Element, runs: list[Ints]) -> Ints:
    if not runs and not element.number("count"):
        return np.empty(0, dtype=np.int64)
    element.expect(len(runs) == 1, f"expected one <p>, found {len(runs)}")
    return runs[0]


def _triangles(element: _Element, runs: list[Ints], _: _Cut) -> Triangles:
    corners, count = _one_run(element, runs), element.number("count")
    element.expect(len(corners) == 3 * count, f"expected {3 * count} corners, found {len(corners)}")
    return corners.reshape(-1, 3)


def _polylist(element: _Element, runs: list[Ints], cut_all: _Cut) -> Triangles:
    corners, count = _one_run(element, runs), element.number("count")
    sizes = element.the("vcount").integers() if count or element.all("vcount") else np.empty(0, dtype=np.int64)
    right = len(sizes) == count and (sizes >= 3).all() and (sizes <= len(corners)).all() and sizes.sum() == len(corners)
    element.expect(right, f"expected {count} polygons that vcount divides all corners into, found others")
    return cut_all(corners, sizes)


def _runs(element: _Element, runs: list[Ints]) -> list[Ints]:
    count = element.number("count")
    element.expect(len(runs) == count, f"expected {count} <p>, found {len(runs)}")
    for run in runs:
        element.expect(len(run) >= 3, f"expected at least 3 corners, found {len(run)}")
    return runs


def _polygons(element: _Element, runs: list[Ints], cut_all: _Cut) -> Triangles:
    runs = _runs(element, runs)
    corners = np.concatenate([np.empty(0, dtype=np.int64), *runs])
    return cut_all(corners, np.array([len(run) for run in runs], dtype=np.int64))


def _strips(element: _Element, runs: list[Ints], _: _Cut) -> Triangles:
    return np.concatenate([np.empty((0, 3), dtype=np.int64), *(parts.strip(run) for run in _runs(element, runs))])


_PRIMITIVES: dict[str, Callable[[_Element, list[Ints], _Cut], Triangles]] = {
    "triangles": _triangles,
    "polylist": _polylist,
    "polygons": _polygons,
    "trifans": lambda element, runs, _: _polygons(element, runs, parts.fans),
    "tristrips": _strips,
}

# -- transforms ---------------------------------------------------------------------------------


def _matrix(element: _Element) -> Floats:
    T = element.floats(16).reshape(4, 4)
    element.expect((T[3] == [0, 0, 0, 1]).all(), f"expected an affine matrix, found {T[3].tolist()} as its last row")
    return T


def _rotate(element: _Element) -> Floats:
    """Read a rotation about an axis by an angle in degrees."""
    *axis, angle = element.floats(4)
    if angle == 0:
        return np.eye(4)
    length = math.hypot(*axis)
    element.expect(0 < length < math.inf and math.isfinite(angle), "expected an axis and an angle")
    x, y, z = np.array(axis) / length
    K = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    turn = _elementary.sin(math.radians(angle)) * K + (1 - _elementary.cos(math.radians(angle))) * product(K, K)
    return pose_of(np.eye(3) + turn, 0.0)


_TRANSFORMS: dict[str, Callable[[_Element], Floats]] = {
    "matrix": _matrix,
    "translate": lambda element: pose_of(np.eye(3), element.floats(3)),
    "scale": lambda element: np.diag([*element.floats(3), 1.0]),
    "rotate": _rotate,
}
