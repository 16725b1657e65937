"""The oracle of surfaces on known answers, and its two halves against each other."""

from fractions import Fraction
from itertools import permutations, product

import numpy as np
import pytest

import surface_oracle
from families import random_poses, translation
from sampling import quick
from surface_oracle import Mesh, collides, collides_exactly, contains, squared_distance, triangles_meet

trimesh = pytest.importorskip("trimesh")

T0 = ((0, 0, 0), (4, 0, 0), (0, 4, 0))


def box(size: float | tuple = 1.0, center: tuple = (0, 0, 0), solid: bool | None = None, inwards: bool = False) -> Mesh:
    made = trimesh.creation.box(np.broadcast_to(size, 3))
    return Mesh(made.vertices + center, made.faces[:, ::-1] if inwards else made.faces, solid)


def joined(*meshes: Mesh, solid: bool | None = None) -> Mesh:
    starts = np.cumsum([0, *(len(m.vertices) for m in meshes)])
    faces = [m.faces + start for m, start in zip(meshes, starts, strict=False)]
    return Mesh(np.concatenate([m.vertices for m in meshes]), np.concatenate(faces), solid)


MEETING = {
    "crossing": ((1, 1, -1), (1, 1, 1), (2, 1, 1)),
    "an edge through the inside": ((1, 1, -1), (1, 1, 1), (9, 9, 1)),
    "a vertex on the face": ((1, 1, 0), (1, 1, 5), (2, 1, 5)),
    "a vertex on an edge": ((2, 0, 0), (2, -1, 5), (3, -1, 5)),
    "vertex to vertex": ((4, 0, 0), (5, 0, 1), (5, 1, 1)),
    "edges that cross": ((2, -1, -1), (2, 1, 1), (2, -3, 1)),
    "a common edge": ((0, 0, 0), (4, 0, 0), (0, 0, 4)),
    "coplanar, overlapping": ((1, 1, 0), (5, 1, 0), (1, 5, 0)),
    "coplanar, within": ((1, 1, 0), (2, 1, 0), (1, 2, 0)),
    "coplanar, around": ((-9, -9, 0), (40, -9, 0), (-9, 40, 0)),
    "coplanar, vertex to edge": ((2, 2, 0), (5, 5, 0), (5, 6, 0)),
    "coplanar, the same": T0,
    "a point in it": ((1, 1, 0), (1, 1, 0), (1, 1, 0)),
    "a point on a vertex": ((4, 0, 0), (4, 0, 0), (4, 0, 0)),
    "a segment through it": ((1, 1, -1), (1, 1, 1), (1, 1, 0)),
    "a segment in its plane": ((-1, 1, 0), (5, 1, 0), (2, 1, 0)),
    "a segment along an edge": ((3, 0, 0), (7, 0, 0), (5, 0, 0)),
}
PARTED = {
    "above": ((0, 0, 1), (4, 0, 1), (0, 4, 1)),
    "its plane crossed beside it": ((3, 3, -1), (3, 3, 1), (5, 5, 1)),
    "coplanar, beside": ((3, 2, 0), (6, 2, 0), (3, 6, 0)),
    "coplanar, on the edge's line": ((5, 0, 0), (6, 0, 0), (5, -1, 0)),
    "a point beside it": ((3, 3, 0), (3, 3, 0), (3, 3, 0)),
    "a point above it": ((1, 1, 1), (1, 1, 1), (1, 1, 1)),
    "a segment beyond an edge": ((5, 0, 0), (7, 0, 0), (6, 0, 0)),
    "a segment above it": ((0, 0, 1), (2, 2, 1), (1, 1, 1)),
}


@pytest.mark.parametrize("name", [*MEETING, *PARTED])
def test_triangles_of_known_answer(name: str):
    """Known answers, for every order of the corners and of the triangles, and moved in whole numbers."""
    other = (MEETING | PARTED)[name]
    for order, turned, shift in product(permutations(range(3)), permutations(range(3)), (0, 7)):
        s = tuple(tuple(T0[k][i] + shift for i in turned) for k in order)
        t = tuple(tuple(p[i] + shift for i in turned) for p in other)
        assert triangles_meet(s, t) == triangles_meet(t, s) == (name in MEETING)
        assert (squared_distance(s, t) == 0) == (squared_distance(t, s) == 0) == (name in MEETING)


def test_segments_and_points():
    """Triangles of no area are the segments and points that they are, on both sides."""
    x, y = ((-1, 0, 0), (1, 0, 0), (0, 0, 0)), ((0, -1, 0), (0, 1, 0), (0, 1, 0))
    assert triangles_meet(x, y)
    assert not triangles_meet(x, tuple((p[0], p[1], 1) for p in y))
    assert not triangles_meet(x, tuple((p[0] + 2, p[1], 0) for p in y))
    assert triangles_meet(x, ((1, 0, 0), (3, 0, 0), (2, 0, 0)))
    assert not triangles_meet(x, ((2, 0, 0), (3, 0, 0), (2, 0, 0)))
    assert not triangles_meet(x, ((-1, 1, 0), (1, 1, 0), (0, 1, 0)))
    assert triangles_meet(((1, 1, 1),) * 3, ((1, 1, 1),) * 3)
    assert not triangles_meet(((1, 1, 1),) * 3, ((1, 1, 2),) * 3)


def test_squared_distances():
    """Vertex to face, vertex to edge, vertex to vertex, edge to edge, and between triangles of no area."""
    assert squared_distance(T0, ((1, 1, 3), (1, 1, 9), (2, 1, 9))) == 9
    assert squared_distance(T0, ((2, -3, 4), (2, -9, 9), (3, -9, 9))) == 25
    assert squared_distance(T0, ((-1, -2, -2), (-9, -9, -9), (-9, -9, -8))) == 9
    assert squared_distance(T0, ((3, 3, 0), (9, 3, 0), (3, 9, 0))) == 2
    edges = ((2, -1, -5), (2, -1, 5), (2, -9, 0))
    assert squared_distance(T0, edges) == 1
    skew = ((0, 0, 0), (2, 0, 0), (1, 0, 0)), ((0, -1, 1), (3, 2, 1), (0, -1, 1))
    assert squared_distance(*skew) == 1
    assert squared_distance(T0, ((3, 3, 1),) * 3) == Fraction(3)


@pytest.mark.parametrize("count", quick(60, 3000))
def test_random_triangles_agree_with_their_distance(count: int, rng: np.random.Generator):
    """On a small grid, where every degeneracy occurs, two triangles meet exactly where no axis of theirs parts them."""
    met = 0
    for _ in range(count):
        s, t = (tuple(tuple(int(x) for x in p) for p in rng.integers(0, 4, (3, 3))) for _ in range(2))
        A, B = np.array(s), np.array(t)
        ea, eb = A - np.roll(A, 1, axis=0), B - np.roll(B, 1, axis=0)
        na, nb = np.cross(ea[0], ea[1]), np.cross(eb[0], eb[1])
        axes = [na, nb, *np.cross(ea[:, None], eb[None]).reshape(-1, 3), *np.cross(na, ea), *np.cross(nb, eb)]
        axes += [*ea, *eb, *(B[:, None] - A[None]).reshape(-1, 3)]
        # Between a vertex and a parallel edge, the axis is square to the edge.
        for e in (*ea, *eb):
            axes += [np.cross(np.cross(e, d), e) for d in (B[:, None] - A[None]).reshape(-1, 3)]
        parted = any((A @ n).max() < (B @ n).min() or (B @ n).max() < (A @ n).min() for n in axes)
        assert triangles_meet(s, t) == (not parted), (s, t)
        met += not parted
    assert count / 7 < met < count * 6 / 7


@pytest.mark.parametrize("count", quick(150, 400))
def test_compiled_and_whole_numbers_agree(rng: np.random.Generator, count: int):
    """Where floating point settles a pair of triangles, whole numbers say the same; and it settles most."""
    settled = 0
    eye = np.eye(4)
    for k in range(count):
        corners = rng.integers(0, 5, (2, 3, 3)) / 4 if k % 2 else rng.normal(size=(2, 3, 3))
        a, b = (Mesh(c, [[0, 1, 2]], False) for c in corners)
        T = random_poses(rng, 1, 0.3)[0]
        answer, _ = surface_oracle._listed(surface_oracle._surfaces, a.tree, T, b.tree, eye if k % 4 else T, False)
        placed = surface_oracle.Placed((a, b), (T, eye if k % 4 else T))
        exact = triangles_meet(placed.triangle(0, 0), placed.triangle(1, 0))
        if answer != surface_oracle.OPEN:
            settled += 1
            assert (answer == surface_oracle.MEET) == exact
    assert settled > max(count - 150, 50)


def test_a_box_within_a_box():
    """Within a solid it collides, within a skin it does not, and either may be the larger."""
    large, small, eye = box(4.0), box(1.0), np.eye(4)
    skin = box(4.0, solid=False)
    for a, b, expected in ((large, small, True), (skin, small, False), (large, box(1.0, solid=False), True)):
        for T in (eye, translation(0.5), translation(1.25, 1.0, -1.0)):
            assert collides(a, eye, b, T) == collides(b, T, a, eye) == expected
            assert collides_exactly(a, eye, b, T) == collides_exactly(b, T, a, eye) == expected


def test_boxes_that_touch():
    """Faces, edges and vertices that touch collide; the next double beyond them is free."""
    a, eye = box(1.0), np.eye(4)
    for x, y, z in ((1, 0, 0), (1, 0.25, 0.5), (1, 1, 0), (1, 1, 1), (1, -1, 0.3)):
        T = translation(x, y, z)
        assert collides(a, eye, box(1.0), T)
        T[0, 3] = np.nextafter(1.0, 2)
        assert not collides(a, eye, box(1.0), T)
        T[0, 3] = np.nextafter(1.0, 0)
        assert collides(a, eye, box(1.0), T)


def test_cavities_and_shells():
    """In a cavity it is free, in the wall it collides, and in a shell within the cavity it collides again."""
    small, eye = box(0.1), np.eye(4)
    hollow = joined(box(4.0), box(2.0, inwards=True))
    nested = joined(box(4.0), box(3.0, inwards=True), box(2.0))
    doubled = joined(box(4.0), box(2.0))
    for mesh, answers in (
        (hollow, (False, True, False)),
        (nested, (True, False, False)),
        (doubled, (True, True, False)),
    ):
        assert mesh.closed
        for x, expected in zip((0.2, 1.25, 3.0), answers, strict=True):
            assert collides(mesh, eye, small, translation(x)) == expected
            assert contains(mesh, eye, [[x, 0.0, 0.0]]) == expected
    assert collides(hollow, eye, small, translation(1.0))  # on the wall


def test_winding_of_points_behind_edges_and_vertices():
    """Points whose rays meet vertices, edges and diagonals are in the solid or not, as they are; on it they collide."""
    cube = box(2.0)
    rays = [np.array(d) for d in product((-1.0, 0.0, 1.0), repeat=3) if any(d)] + [d[:3] for d in surface_oracle.RAYS]
    for d in rays:
        for scale, expected in ((0.5, True), (1.0, True), (1.0 + 2.0**-40, False), (3.0, False)):
            point = scale * d / np.abs(d).max()
            assert contains(cube, np.eye(4), [point]) == expected, (d, scale)


def test_exact_rays_meet_edges(monkeypatch: pytest.MonkeyPatch):
    """A ray that meets an edge or vertex, or lies in a face, is given up for another one."""
    cube, inside = box(2.0), Mesh([[0.0, 0, 0]], [[0, 0, 0]], False)
    tried = []

    def directions():
        for d in ((1 << 18, 1 << 18, 1 << 18), (1 << 18, 1 << 18, 12345), (123456, 234567, 98765)):
            tried.append(d)
            yield d

    monkeypatch.setattr(surface_oracle, "_directions", directions)
    assert collides_exactly(cube, np.eye(4), inside, np.eye(4))
    assert len(tried) == 3


def test_components_of_which_one_is_inside():
    """A mesh of two boxes collides if one of them is within the other mesh, and the order does not matter."""
    two, large, eye = joined(box(0.2), box(0.2, (9, 0, 0))), box(2.0), np.eye(4)
    assert len(two.seeds) == 2
    for x, expected in ((0.0, True), (-9.0, True), (-4.0, False), (9.0, False)):
        assert collides(two, translation(x), large, eye) == collides(large, eye, two, translation(x)) == expected


def test_an_open_mesh_is_no_solid():
    """A mesh without one face is open, whatever its orientation, and so is one with a face turned over."""
    cube = box()
    assert cube.closed
    assert not Mesh(cube.vertices, cube.faces[1:]).closed
    assert not Mesh(cube.vertices, np.vstack([cube.faces[1:], cube.faces[:1, ::-1]])).closed
    assert Mesh(cube.vertices, np.vstack([cube.faces, [[3, 3, 3], [1, 2, 2]]])).closed
    assert Mesh(cube.vertices[cube.faces].reshape(-1, 3), np.arange(36)).closed


def test_batches_are_their_poses(rng: np.random.Generator):
    """Many poses at once say what each of them says by whole numbers alone; a knot and a torus, with turns."""
    knot, ring = trimesh.creation.torus(1.0, 0.1, 12, 6), trimesh.creation.torus(1.0, 0.3, 10, 6)
    a, b = Mesh(knot.vertices, knot.faces), Mesh(ring.vertices, ring.faces)
    T = random_poses(rng, 60, 1.5)
    found = collides(a, np.eye(4), b, T)
    assert 10 < found.sum() < 50
    assert [collides_exactly(a, np.eye(4), b, t) for t in T] == found.tolist()
    assert (found == collides(b, T, a, np.eye(4))).all()


def by_whole_numbers_alone(a: Mesh, Ta: np.ndarray, b: Mesh, Tb: np.ndarray) -> bool:
    """Every pair of triangles, and every triangle against a ray from every component; nothing compiled."""
    placed = surface_oracle.Placed((a, b), (Ta, Tb))
    A, B = ([placed.triangle(side, f) for f in range(len(m.faces))] for side, m in enumerate((a, b)))
    if any(triangles_meet(s, t) for s in A for t in B):
        return True
    for side, mesh, other, triangles in ((0, a, b, B), (1, b, a, A)):
        for seed in mesh.seeds if other.solid else ():
            crossings = [None]
            directions = surface_oracle._directions()
            while None in crossings:
                d = next(directions)
                crossings = [surface_oracle._crossing(placed.vertex(side, int(seed)), d, t) for t in triangles]
            if sum(crossings) != 0:
                return True
    return False


@pytest.mark.parametrize("count", quick(60, 160))
def test_nothing_compiled_agrees(rng: np.random.Generator, count: int):
    """Boxes, shells and soups in random poses and on a grid: whole numbers alone, without any filter, say the same."""
    meshes = [
        box(),
        joined(box(2.0), box(1.5, inwards=True)),
        box(0.5, solid=False),
        joined(box(0.25), box(0.25, (1, 0, 0))),
    ]
    soup = rng.integers(0, 5, (6, 3, 3)) / 4
    meshes.append(Mesh(soup.reshape(-1, 3), np.arange(18), False))
    answers = []
    for k in range(count):
        a, b = (meshes[i] for i in rng.integers(len(meshes), size=2))
        Ta, Tb = random_poses(rng, 2, 1.0)
        if k % 2:
            Ta, Tb = (translation(*(rng.integers(-6, 7, 3) / 4)) for _ in range(2))
        answers.append(by_whole_numbers_alone(a, Ta, b, Tb))
        assert collides(a, Ta, b, Tb) == answers[-1]
    assert 3 * count / 16 < sum(answers) < 13 * count / 16


def test_distances_of_boxes():
    """Faces, edges and vertices of boxes are as far apart as they are, and as far when all is turned."""
    a, b, eye = box(), box(), np.eye(4)
    for x, y, z in ((3, 0, 0), (3, 3, 0), (3, 3, 3), (1 + 1e-9, 0.5, 0)):
        gap = [Fraction(float(s)) - 1 if s > 1 else Fraction(0) for s in (x, y, z)]
        exact = surface_oracle.root(sum(g * g for g in gap))
        assert surface_oracle.distance(a, eye, b, translation(x, y, z)) == exact
    assert surface_oracle.distance(a, eye, b, translation(0.5)) == 0
    turn = random_poses(np.random.default_rng(1), 1, 5.0)[0]
    assert surface_oracle.distance(a, turn, b, turn @ translation(3, 3, 3)) == pytest.approx(12**0.5, rel=1e-14)


def test_boundary_is_between():
    """Two poses near each other, of which the first collides and the second does not; None where there are none."""
    found = surface_oracle.boundary(box(), np.eye(4), box(), translation(0.3), np.array([2.0, 0.1, 0.2]), 1e-10)
    assert found is not None
    assert found[0][0, 3] <= 1.0 < found[1][0, 3] < 1.0 + 1e-9
    assert surface_oracle.boundary(box(), np.eye(4), box(), translation(0.3), np.array([0.1, 0, 0]), 1e-10) is None
