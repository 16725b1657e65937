"""Parts of machines as mesh files: gears, brackets, mugs, screws; a tenth of them open or damaged."""

import numpy as np
import trimesh


def extruded(outline, height):
    """A solid over an outline that is star-shaped about the mean of its corners, shape (n, 2)."""
    n = len(outline)
    low, high = (np.column_stack([outline, np.full(n, z)]) for z in (0.0, height))
    middles = np.column_stack([np.tile(outline.mean(axis=0), (2, 1)), [0.0, height]])
    k = np.arange(n)
    after = (k + 1) % n
    sides = [np.column_stack([k, after, after + n]), np.column_stack([k, after + n, k + n])]
    ends = [np.column_stack([after, k, np.full(n, 2 * n)]), np.column_stack([k + n, after + n, np.full(n, 2 * n + 1)])]
    return trimesh.Trimesh(np.concatenate([low, high, middles]), np.concatenate([*sides, *ends]))


def plate(cells, edge, thick, holes, sections):
    """A row of square cells, some of them with a round hole, in one closed surface."""
    made = []
    turn = 2 * np.pi * np.arange(sections) / sections
    circle = 0.3 * edge * np.column_stack([np.cos(turn), np.sin(turn)])
    square = circle / np.abs(circle).max(axis=1, keepdims=True) * edge / 2
    for cell in range(cells):
        if not holes[cell]:
            part = trimesh.creation.box((edge, edge, thick))
        else:
            k = np.arange(sections)
            after, n = (k + 1) % sections, sections
            rings = [
                np.column_stack([ring, np.full(n, z)]) for z in (-thick / 2, thick / 2) for ring in (square, circle)
            ]
            quads = [(0, n, n, 0), (n, 3 * n, 3 * n, n), (3 * n, 2 * n, 2 * n, 3 * n), (2 * n, 0, 0, 2 * n)]
            faces = []
            for a, b, c, d in quads:
                faces += [np.column_stack([k + a, k + b, after + c]), np.column_stack([k + a, after + c, after + d])]
            part = trimesh.Trimesh(np.concatenate(rings), np.concatenate(faces))
            part.fix_normals()
        made.append(part.apply_translation([cell * edge, 0, 0]))
    return trimesh.util.concatenate(made)


def gear(rng):
    """Teeth around a disk."""
    teeth, radius = int(rng.integers(6, 10)), rng.uniform(0.01, 0.04)
    reach = np.tile([radius, radius, 1.2 * radius, 1.2 * radius], teeth)
    turn = 2 * np.pi * np.arange(4 * teeth) / (4 * teeth)
    return extruded(reach[:, None] * np.column_stack([np.cos(turn), np.sin(turn)]), rng.uniform(0.004, 0.01))


def bracket(rng):
    """Two plates with holes, at a right angle."""
    edge, thick, sections = rng.uniform(0.02, 0.03), rng.uniform(0.004, 0.006), 4 * int(rng.integers(2, 4))
    flat, upright = (
        plate(3, edge, thick, holes, sections) for holes in (rng.permutation([True, False, False]), [False] * 3)
    )
    upright.apply_transform(trimesh.transformations.rotation_matrix(-np.pi / 2, [0, 1, 0]))
    return trimesh.util.concatenate([flat, upright.apply_translation([(thick - edge) / 2, 0, (edge - thick) / 2])])


def mug(rng):
    """A wall, a floor and a handle that overlap."""
    radius, height, wall = rng.uniform(0.03, 0.05), rng.uniform(0.08, 0.12), rng.uniform(0.003, 0.005)
    sections = int(rng.integers(10, 16))
    body = trimesh.creation.annulus(radius - wall, radius, height, sections=sections)
    floor = trimesh.creation.cylinder(radius, wall, sections=sections)
    handle = trimesh.creation.torus(0.3 * height, wall, major_sections=12, minor_sections=6)
    handle.apply_transform(trimesh.transformations.rotation_matrix(np.pi / 2, [1, 0, 0]))
    floor.apply_translation([0, 0, (wall - height) / 2])
    return trimesh.util.concatenate([body, floor, handle.apply_translation([radius, 0, 0])])


def screw(rng):
    """A head on a shank."""
    radius, length = rng.uniform(0.002, 0.006), rng.uniform(0.01, 0.05)
    head = trimesh.creation.cylinder(2 * radius, 1.2 * radius, sections=6)
    shank = trimesh.creation.cylinder(radius, length, sections=16).apply_translation([0, 0, -length / 2])
    return trimesh.util.concatenate([head, shank])


MAKERS = (gear, bracket, mug, screw)


def part(number):
    """The part that `write` makes as that number, whole."""
    rng = np.random.default_rng(0)
    for k in range(number + 1):
        made = MAKERS[k % len(MAKERS)](rng)
        if k % 20 == 1:
            rng.choice(len(made.faces), 2, replace=False)
    return made


def write(folder, count):
    """Write parts; return the paths of all, and of those that are damaged, which nothing can be made of.

    Every tenth is open or damaged, by turns: two triangles are missing, or the file is cut short.
    """
    folder.mkdir()
    rng, paths, damaged = np.random.default_rng(0), [], []
    for k in range(count):
        make = MAKERS[k % len(MAKERS)]
        mesh = make(rng)
        path = folder / f"{make.__name__}{k:03}.stl"
        if k % 20 == 1:
            keep = np.ones(len(mesh.faces), dtype=bool)
            keep[rng.choice(len(mesh.faces), 2, replace=False)] = False
            mesh.update_faces(keep)
        mesh.export(path)
        if k % 20 == 10:
            path.write_bytes(path.read_bytes()[:-30])
            damaged.append(path)
        paths.append(path)
    return paths, damaged
