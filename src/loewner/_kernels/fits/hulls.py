"""Preparation and postprocessing for Qhull: coordinates of unit size in, merged faces and oriented simplices out."""

import numpy as np

from loewner._kernels._jit import njit
from loewner._kernels.codes import FACE_OFF, INSIDE_OUT, NOT_CLOSED
from loewner._kernels.fits.many import MANY, face_map, highest, lowest, reaches
from loewner._kernels.fits.mvce import ROUNDING, spread_points, to_frame
from loewner._kernels.tolerances import FACE_ROUNDING, FACE_WIDTH


@njit()
def to_unit_size(points, flatness):
    """Compute coordinates in which the points have unit size, regardless of their aspect ratio, scale and offset.

    Returns (code, axis, width, size, origin, frame, coordinates), as `spread_points` computes them.
    """
    m, n = points.shape
    chosen = np.empty(2 * n, np.int64)
    origin = np.empty(n)
    frame = np.empty((n, n))
    coordinates = np.empty((m, n))
    code, axis, width, size = spread_points(points, flatness, chosen, origin, frame)
    if code == 0:
        for i in range(m):
            to_frame(points[i], origin, frame, coordinates[i], n)
    return code, axis, width, size, origin, frame, coordinates


@njit()
def finish_hull(points, frame, coordinates, simplices, neighbors, equations):
    """Turn Qhull's facets, which were found in unit-size coordinates, into the faces of a polytope.

    Qhull gives every simplex of one flat face the same equation, so neighbours with equal equations are merged. The
    simplices are oriented outward together (n = 3): the largest simplex by its own normal, and the others across shared
    edges. In this way, slivers cannot point the wrong way.

    Returns (code, worst, used, face_of, normals, offsets), where used (m,) marks the points that are vertices;
    `simplices` is oriented in place.
    """
    m, n = points.shape
    count = len(simplices)
    used = np.zeros(m, np.bool_)
    face_of = np.full(count, -1, np.int64)
    stack = np.empty(count, np.int64)
    normals = np.empty((count, n))
    faces = 0
    for first in range(count):
        for k in range(n):
            used[simplices[first, k]] = True
        if face_of[first] >= 0:
            continue
        face_of[first] = faces
        stack[0] = first
        top = 1
        while top > 0:
            top -= 1
            here = stack[top]
            for k in range(n):
                there = neighbors[here, k]
                if face_of[there] < 0:
                    same = True
                    for j in range(n + 1):
                        same = same and equations[there, j] == equations[here, j]
                    if same:
                        face_of[there] = faces
                        stack[top] = there
                        top += 1
        # Transform the normal back to the caller's coordinates, where it is frame⁻ᵀ n, scaled to unit length.
        norm2 = 0.0
        for j in range(n - 1, -1, -1):
            value = equations[first, j]
            for k in range(j + 1, n):
                value -= frame[k, j] * normals[faces, k]
            value /= frame[j, j]
            normals[faces, j] = value
            norm2 += value * value
        norm = np.sqrt(norm2)
        for j in range(n):
            normals[faces, j] /= norm
        faces += 1

    code = turn_outward(simplices, neighbors, equations, coordinates, stack) if n == 3 else 0
    offsets = np.empty(faces)
    bottoms = np.empty(faces)
    reference = points[simplices[0, 0]]
    face_limits(points, frame, coordinates, used, normals[:faces], reference, offsets, bottoms)
    worst = 0.0
    for i in range(count):
        f = face_of[i]
        for k in range(n):
            value = 0.0
            for j in range(n):
                value += normals[f, j] * (points[simplices[i, k], j] - reference[j])
            worst = max(worst, bottoms[f] - value)
            if value < bottoms[f] and code == 0:
                code = FACE_OFF
    return code, worst, used, face_of, normals[:faces], offsets


@njit()
def face_limits(points, frame, coordinates, used, normals, reference, offsets, bottoms):
    """For each face, write the largest n·v to `offsets`, and the least n·(v - reference) of its vertices to `bottoms`.

    For a face's own vertices, the tolerance is half of FACE_WIDTH plus a quarter of FACE_ROUNDING. It is smaller
    because users of the faces measure from the center, which halves the noise.
    """
    n = points.shape[1]
    count = 0
    for i in range(len(points)):
        if used[i]:
            count += 1
    vertices = np.empty((count, n))
    y = np.empty((count, n))
    count = 0
    for i in range(len(points)):
        if used[i]:
            for k in range(n):
                vertices[count, k] = points[i, k]
                y[count, k] = coordinates[i, k]
            count += 1
    if n == 3 and count > MANY:
        _limits_by_map(vertices, y, frame, normals, reference, offsets, bottoms)
        return
    for f in range(len(normals)):
        top = -np.inf
        bottom = np.inf
        offset = -np.inf
        noise = 0.0
        for i in range(count):
            value = 0.0
            size = 0.0
            absolute = 0.0
            for k in range(n):
                t = normals[f, k] * (vertices[i, k] - reference[k])
                value += t
                size += abs(t)
                absolute += normals[f, k] * vertices[i, k]
            top = max(top, value)
            bottom = min(bottom, value)
            noise = max(noise, size)
            offset = max(offset, absolute)
        offsets[f] = offset
        bottoms[f] = top - (0.5 * FACE_WIDTH * (top - bottom) + 0.25 * FACE_ROUNDING * noise * ROUNDING)


@njit()
def _limits_by_map(vertices, y, frame, normals, reference, offsets, bottoms):
    """Do the work of `face_limits` for many vertices; their largest offsets along the axes bound the noise."""
    columns, nodes = face_map(y, frame)
    origin = np.zeros(3)
    reach = np.empty(3)
    reaches(vertices, reference, reach)
    for f in range(len(normals)):
        offsets[f] = highest(vertices, frame, columns, nodes, normals[f], origin)
        top = highest(vertices, frame, columns, nodes, normals[f], reference)
        bottom = lowest(vertices, frame, columns, nodes, normals[f], reference)
        noise = abs(normals[f, 0]) * reach[0] + abs(normals[f, 1]) * reach[1] + abs(normals[f, 2]) * reach[2]
        bottoms[f] = top - (0.5 * FACE_WIDTH * (top - bottom) + 0.25 * FACE_ROUNDING * noise * ROUNDING)


@njit()
def turn_outward(simplices, neighbors, equations, coordinates, stack):
    """Orient the triangles of a closed surface consistently and outward; return 0, or the code of a fault."""
    count = len(simplices)
    turned = np.zeros(count, np.bool_)
    # Start at the triangle with the largest area, because the orientation of this triangle is certain.
    start = 0
    largest = 0.0
    swap = False
    for i in range(count):
        a, b, c = simplices[i]
        dot = 0.0
        for k in range(3):
            k1 = (k + 1) % 3
            k2 = (k + 2) % 3
            cross = (coordinates[b, k1] - coordinates[a, k1]) * (coordinates[c, k2] - coordinates[a, k2]) - (
                coordinates[b, k2] - coordinates[a, k2]
            ) * (coordinates[c, k1] - coordinates[a, k1])
            dot += cross * equations[i, k]
        if abs(dot) > largest:
            largest = abs(dot)
            start = i
            swap = dot < 0.0
    if swap:
        flip(simplices, neighbors, start)
    turned[start] = True
    stack[0] = start
    top = 1
    seen = 1
    while top > 0:
        top -= 1
        here = stack[top]
        for k in range(3):
            there = neighbors[here, k]
            if there < 0:
                return NOT_CLOSED
            tail = simplices[here, (k + 1) % 3]
            head = simplices[here, (k + 2) % 3]
            # The neighbour must traverse the shared edge in the opposite direction.
            forward = False
            backward = False
            for r in range(3):
                p = simplices[there, r]
                q = simplices[there, (r + 1) % 3]
                forward = forward or (p == tail and q == head)
                backward = backward or (p == head and q == tail)
            if not (forward or backward):
                return NOT_CLOSED
            if not turned[there]:
                if forward:
                    flip(simplices, neighbors, there)
                turned[there] = True
                stack[top] = there
                top += 1
                seen += 1
            elif forward:
                return INSIDE_OUT
    return 0 if seen == count else NOT_CLOSED


@njit()
def flip(simplices, neighbors, i):
    simplices[i, 1], simplices[i, 2] = simplices[i, 2], simplices[i, 1]
    neighbors[i, 1], neighbors[i, 2] = neighbors[i, 2], neighbors[i, 1]
