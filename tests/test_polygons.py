"""Polygons of mesh files: their triangles are the polygon, each point once, whatever notches it has."""

import re
import warnings

import numpy as np
import pytest

import loewner
from loewner.meshes import decomposition as meshes
from loewner.meshes.files import parts
from sampling import quick

# An L, which its first corner does not see whole; a square with a hole, joined by a slit; a comb.
L = [(2, 0), (2, 1), (1, 1), (1, 2), (0, 2), (0, 0)]
HOLE = [(0, 0), (4, 0), (4, 4), (0, 4), (0, 0), (1, 1), (1, 2), (2, 2), (2, 1), (1, 1)]
COMB = [p for i in range(20) for p in ((i, 0), (i + 0.5, 10))] + [(20, -1), (-1, -1)]
U = [(0, 0), (3, 0), (3, 3), (2, 3), (2, 1), (1, 1), (1, 3), (0, 3)]


def cut(polygon):
    """Triangles of one polygon, as numbers of its corners, and the texts that reading it gives."""
    points, told = np.asarray(polygon, dtype=np.float64), []
    points = np.c_[points, np.zeros((len(points), 3 - points.shape[1]))]
    found = parts.cut(
        points, np.arange(len(points)), np.array([len(points)]), lambda text, place: told.append((text, place)), str
    )
    return found, told


def areas(polygon, triangles):
    """Twice the areas of triangles in the plane, positive if they turn to the left."""
    a, b, c = np.moveaxis(np.asarray(polygon, dtype=np.float64)[triangles], 1, 0)
    return (b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0])


def edges(loops):
    """How often each edge is passed one way more than the other; equal for triangles and the polygon they fill."""
    passed = {}
    for loop in loops:
        for a, b in zip(loop, np.roll(loop, -1), strict=True):
            passed[min(a, b), max(a, b)] = passed.get((min(a, b), max(a, b)), 0) + (1 if a < b else -1)
    return {edge: times for edge, times in passed.items() if times}


def simple_polygon(rng, n):
    """Random points, joined by a line that two edges that cross are turned over to untangle."""
    points, order, again = rng.random((n, 2)), list(range(n)), True

    def side(a, b, c):
        return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])

    while again:
        again = False
        for i in range(n - 1):
            for j in range(i + 2, n - (i == 0)):
                a, b, c, d = (points[order[k % n]] for k in (i, i + 1, j, j + 1))
                if side(a, b, c) * side(a, b, d) < 0 and side(c, d, a) * side(c, d, b) < 0:
                    order[i + 1 : j + 1] = order[i + 1 : j + 1][::-1]
                    again = True
    return points[order]


def assert_filled(polygon, placed=None):
    """The triangles have the polygon's boundary, and none is turned over: then they cover it once."""
    triangles, told = cut(polygon if placed is None else placed)
    assert told == []
    assert len(triangles) == len(polygon) - 2
    assert edges(triangles) == edges([range(len(polygon))])
    found = areas(np.asarray(polygon)[:, :2], triangles)
    assert (found * np.sign(found.sum())).min() >= 0


@pytest.mark.parametrize("shape", [L, HOLE, COMB, U], ids=["L", "hole", "comb", "U"])
def test_known_shapes_from_every_first_corner(shape):
    """In either direction, in planes across each axis and in a slanted one."""
    for k in range(len(shape)):
        polygon = np.roll(np.array(shape, dtype=float), k, axis=0)
        assert_filled(polygon)
        assert_filled(polygon[::-1])
        x, y = polygon.T
        for placed in ([y * 0, x, y], [y, x * 0, x], [x, y, x + 2 * y]):
            assert_filled(polygon, np.stack(placed, axis=1))


@pytest.mark.parametrize("n", [4, 5, 6, 8, 12, 20, 40])
@pytest.mark.parametrize("count", quick(8, 20))
def test_random_simple_polygons(n, rng, count):
    """Triangles of a polygon have its area, and all face one side."""
    for _ in range(count):
        assert_filled(simple_polygon(rng, n))


def test_spiral_of_a_thousand_corners():
    """A long spiral is cut right, and soon."""
    turns = np.linspace(0, 8 * np.pi, 500)
    arms = [np.c_[(1 + turns + width) * np.cos(turns), (1 + turns + width) * np.sin(turns)] for width in (0, 3)]
    assert_filled(np.r_[arms[0], arms[1][::-1]])


def test_convex_polygons_are_fans(rng):
    """As they always were: about the first corner, in any pose, also with corners on an edge or in one place."""
    for n in range(4, 12):
        angles = np.sort(rng.uniform(0, 2 * np.pi, n))
        while np.diff(np.r_[angles, angles[0] + 2 * np.pi]).max() >= np.pi:
            angles = np.sort(rng.uniform(0, 2 * np.pi, n))
        polygon = np.c_[np.cos(angles), np.sin(angles), np.zeros(n)] @ np.linalg.qr(rng.normal(size=(3, 3)))[0] + 5
        fan = [[0, k, k + 1] for k in range(1, n - 1)]
        assert cut(polygon)[0].tolist() == fan
    for polygon in (
        [(0, 0), (1, 0), (2, 0), (2, 2), (0, 2)],
        [(0, 0), (2, 0), (2, 0), (2, 2)],
        [(0, 0), (1, 0), (2, 0), (3, 0)],
    ):
        triangles, told = cut(polygon)
        assert triangles.tolist() == [[0, k, k + 1] for k in range(1, len(polygon) - 1)]
        assert told == []


def test_quads_that_are_not_flat_keep_their_fans(rng):
    """If they are convex as seen along their normal; bent about the other diagonal, too."""
    square = np.array([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)], dtype=float)
    for height in (0.3, -0.3):
        for k in range(4):
            bent = square.copy()
            bent[k, 2] = height
            assert cut(bent)[0].tolist() == [[0, 1, 2], [0, 2, 3]]


def test_polygons_of_many_sizes_stay_in_their_order(rng):
    """Each polygon's triangles are where its fan would be."""
    shapes = [simple_polygon(rng, n) for n in rng.integers(3, 9, 200)]
    points = np.concatenate(shapes)
    points = np.c_[points, np.zeros(len(points))]
    sizes = np.array([len(shape) for shape in shapes])
    triangles = parts.cut(points, np.arange(len(points)), sizes, pytest.fail, str)
    starts = np.cumsum(sizes) - sizes
    for k, (shape, start) in enumerate(zip(shapes, starts, strict=True)):
        mine = triangles[start - 2 * k : start - 2 * k + len(shape) - 2] - start
        assert mine.tolist() == cut(shape)[0].tolist()


@pytest.mark.parametrize(
    "polygon",
    [
        [(0, 0), (1, 1), (1, 0), (0, 1)],  # its halves cancel
        [(0, 0), (2, 1), (2, 0), (0, 2)],
        [(np.cos(a), np.sin(a)) for a in 4 * np.pi / 5 * np.arange(5)],
    ],
)
def test_polygons_that_cross_themselves_are_told(polygon):
    """Such a polygon keeps its fan, and a warning names it."""
    triangles, ((text, place),) = cut(polygon)
    assert triangles.tolist() == [[0, k, k + 1] for k in range(1, len(polygon) - 1)]
    assert "flat polygons that do not cross themselves" in text
    assert place == "0"


def test_noise_is_no_notch(rng):
    """Corners on a line, but for the digits of a file, far from the origin: no word, and no triangle of any area."""
    for _ in range(20):
        line = np.c_[np.sort(rng.random(8)), np.zeros(8)] + 100
        noisy = np.asarray(line + rng.normal(scale=1e-6, size=line.shape), dtype=np.float32)
        triangles, told = cut(np.r_[noisy, [(100.5, 101)]])
        assert told == []
        assert areas(np.r_[noisy, [(100.5, 101)]], triangles).min() > -1e-4


def test_too_many_corners():
    """A notched polygon with more corners than can be cut is refused."""
    polygon = [p for i in range(5000) for p in ((i, 0), (i + 0.5, 10))] + [(5000, -1), (-1, -1)]
    with pytest.raises(parts.Refusal, match="polygons with notches of 10000 corners, found 10002"):
        cut(polygon)


# -- files --------------------------------------------------------------------------------------


def solid(outline):
    """Corners and faces of an outline that is extruded by 1; its two ends are single polygons."""
    n = len(outline)
    corners = [(x, y, z) for z in (0, 1) for x, y in outline]
    walls = [[i, (i + 1) % n, (i + 1) % n + n, i + n] for i in range(n)]
    return corners, [list(range(n))[::-1], list(range(n, 2 * n)), *walls]


def files(corners, faces):
    """The same solid in each format that has polygons."""
    points = "".join(f"{x} {y} {z}\n" for x, y, z in corners)
    rows = "".join(f"{len(face)} {' '.join(map(str, face))}\n" for face in faces)
    yield (
        "part.obj",
        re.sub("^", "v ", points, flags=re.MULTILINE).removesuffix("v ")
        + "".join(f"f {' '.join(str(i + 1) for i in face)}\n" for face in faces),
    )
    yield "part.off", f"OFF\n{len(corners)} {len(faces)} 0\n{points}{rows}"
    yield (
        "part.ply",
        (
            f"ply\nformat ascii 1.0\nelement vertex {len(corners)}\n"
            + "".join(f"property double {axis}\n" for axis in "xyz")
            + f"element face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n{points}{rows}"
        ),
    )
    vertex, runs = '<input semantic="VERTEX" source="#v" offset="0"/>', [" ".join(map(str, face)) for face in faces]
    for name, primitive in (
        ("polylist", f"<vcount>{' '.join(str(len(f)) for f in faces)}</vcount><p>{' '.join(runs)}</p>"),
        ("polygons", "".join(f"<p>{run}</p>" for run in runs)),
    ):
        yield (
            f"{name}.dae",
            (
                f'<COLLADA><library_geometries><geometry id="g"><mesh><source id="s">'
                f'<float_array count="{3 * len(corners)}">{points}</float_array><technique_common>'
                f'<accessor count="{len(corners)}" stride="3"><param/><param/><param/></accessor>'
                "</technique_common></source>"
                f'<vertices id="v"><input semantic="POSITION" source="#s"/></vertices>'
                f'<{name} count="{len(faces)}">{vertex}{primitive}</{name}></mesh></geometry></library_geometries>'
                '<library_visual_scenes><visual_scene id="w"><node><instance_geometry url="#g"/></node></visual_scene>'
                '</library_visual_scenes><scene><instance_visual_scene url="#w"/></scene></COLLADA>'
            ),
        )


@pytest.mark.parametrize("name", ["part.obj", "part.off", "part.ply", "polylist.dae", "polygons.dae"])
def test_a_ball_in_the_notch_of_a_polygon(name, tmp_path):
    """In the notch of an L, level with its upper face: free by 0.2 - 0.05; the surface has the area of the solid's."""
    (tmp_path / name).write_text(dict(files(*solid(L)))[name])
    body, ball, T = loewner.Body.from_surface(tmp_path / name), loewner.Body.sphere(0.05), np.eye(4)
    T[:3, 3] = 1.2, 1.5, 1.0
    assert not loewner.collide(body, None, ball, T)
    assert loewner.distance(body, None, ball, T, exact=True).distance == pytest.approx(0.15, abs=1e-12)
    vertices, triangles = meshes.load(tmp_path / name)
    a, b, c = np.moveaxis(vertices[triangles], 1, 0)
    assert np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2 == pytest.approx(14)


@pytest.mark.parametrize(
    ("name", "place"),
    [
        ("part.obj", "line 13"),
        ("part.off", "line 15"),
        ("part.ply", "face 0"),
        ("polylist.dae", "line 1"),
        ("polygons.dae", "line 1"),
    ],
)
def test_warning_about_a_polygon_that_crosses_itself_has_its_place(name, place, tmp_path):
    """One warning for all of a file; its place is the first one's."""
    corners, faces = solid([(0, 0), (2, 1), (2, 0), (0, 2), (-1, 2), (-1, 0)])
    (tmp_path / name).write_text(dict(files(corners, faces))[name])
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        meshes.load(tmp_path / name)
    (text,) = [str(one.message) for one in told]
    assert re.search(rf"{name}, {place}.*: expected flat polygons .* \(1 more of this kind\)$", text)
