"""The paper's four detectors, each over n pairs on one thread.

Centers and factors are documented in `estimates.by_name`. Answers are uint8: `collides`, and `ambiguous` in the
detector's own sense: 1 where the detector's estimate decided, because neither overlap check did.
"""

import math

from loewner._kernels._jit import inline, njit
from loewner._kernels.ellipsoids import near_points as near
from loewner._kernels.linalg3 import dot, matrix, minus
from loewner._kernels.paper.estimates import by_name, f_from_near_points, offset


@inline
def _face_distance(faces, start, stop, origin, p, e):
    """Find where the ray origin + p + t e leaves a polytope {x : normals x <= offsets}."""
    t = math.inf
    for i in range(start, stop):
        n = (faces[i, 0], faces[i, 1], faces[i, 2])
        speed = dot(n, e)
        if speed > 0.0:
            t = min(t, (faces[i, 3] - dot(n, origin) - dot(n, p)) / speed)
    return t


@njit()
def detector_1(centers, factors, faces_1, start_1, faces_2, start_2, collides, ambiguous):
    """The earlier method (section 2 of the paper), as interpreted in docs/design/paper.md.

    The inner ellipsoids are the method's own heuristic ones. `faces_1` and `faces_2` (f, 4) hold normals and offsets;
    `start_1` and `start_2` (n + 1,) hold the first face of each body.
    """
    c1i, F1i, c1o, F1o, c2i, F2i, c2o, F2o = by_name(centers, factors)
    for k in range(len(c1i)):
        r = offset(c2i, k, c1i)
        F1, F2 = matrix(F1i[k]), matrix(F2i[k])
        v1, v2, L, status = near.rimon_boyd(F1, near.inverse(F1), F2, near.inverse(F2), r)
        if status == near.OVERLAP:
            collides[k], ambiguous[k] = 1, 0
            continue
        w = minus(v2, v1)
        e = (w[0] / L, w[1] / L, w[2] / L)
        back = (-e[0], -e[1], -e[2])
        # Positions on the line from v1 (at 0) to v2 (at L): the outer ellipsoid and the polyhedron of body 1 end at
        # outer_1 and face_1; the outer ellipsoid and the polyhedron of body 2 begin at outer_2 and face_2.
        outer_1 = near.exit_of_ray(near.inverse(matrix(F1o[k])), minus(v1, offset(c1o, k, c1i)), e)
        outer_2 = L - near.exit_of_ray(near.inverse(matrix(F2o[k])), minus(v2, offset(c2o, k, c1i)), back)
        origin = (c1i[k, 0], c1i[k, 1], c1i[k, 2])
        face_1 = _face_distance(faces_1, start_1[k], start_1[k + 1], origin, v1, e)
        face_2 = L - _face_distance(faces_2, start_2[k], start_2[k + 1], origin, v2, back)
        # This condition is the negation of the test that the paper prints for "the enclosing ellipsoids overlap". The
        # printed test also fails if the polyhedra overlap along the line, although they then certainly collide. The
        # paper corrects this flaw.
        if (outer_1 - outer_2) * (face_1 - face_2) > 0.0:
            collides[k], ambiguous[k] = 0, 0
            continue
        ambiguous[k] = 1
        collides[k] = abs(face_1 - face_2) <= min(abs(outer_1 - face_1), abs(outer_2 - face_2))


@njit()
def detector_2(centers, factors, angle, collides, ambiguous):
    """The paper's detector: Lin-Han for both overlap checks and for the near points of f."""
    c1i, F1i, c1o, F1o, c2i, F2i, c2o, F2o = by_name(centers, factors)
    for k in range(len(c1i)):
        r = offset(c2o, k, c1o)
        F1, F2 = matrix(F1o[k]), matrix(F2o[k])
        G1, G2 = near.inverse(F1), near.inverse(F2)
        _, _, _, _, status = near.lin_han(F1, G1, F2, G2, r, angle)
        if status == near.SEPARATE:
            collides[k], ambiguous[k] = 0, 0
            continue
        r = offset(c2i, k, c1i)
        F1, F2 = matrix(F1i[k]), matrix(F2i[k])
        v1, v2, L, _, status = near.lin_han(F1, near.inverse(F1), F2, near.inverse(F2), r, angle)
        if status == near.OVERLAP:
            collides[k], ambiguous[k] = 1, 0
            continue
        p1, p2 = offset(c1o, k, c1i), offset(c2o, k, c1i)
        ambiguous[k] = 1
        collides[k] = f_from_near_points(v1, v2, L, r, p1, G1, p2, G2) <= 0.0


@njit()
def detector_3(centers, factors, collides, ambiguous):
    """Level surfaces for both overlap checks (appendix A) and for the near points of f."""
    c1i, F1i, c1o, F1o, c2i, F2i, c2o, F2o = by_name(centers, factors)
    for k in range(len(c1i)):
        F1 = matrix(F1o[k])
        G2 = near.inverse(matrix(F2o[k]))
        _, level = near.touch(F1, G2, offset(c2o, k, c1o))
        if level > 1.0:
            collides[k], ambiguous[k] = 0, 0
            continue
        r = offset(c2i, k, c1i)
        A, B = matrix(F1i[k]), matrix(F2i[k])
        v1, v2, L, status = near.rimon_boyd(A, near.inverse(A), B, near.inverse(B), r)
        if status == near.OVERLAP:
            collides[k], ambiguous[k] = 1, 0
            continue
        p1, p2 = offset(c1o, k, c1i), offset(c2o, k, c1i)
        ambiguous[k] = 1
        collides[k] = f_from_near_points(v1, v2, L, r, p1, near.inverse(F1), p2, G2) <= 0.0


@njit()
def detector_4(centers, factors, collides, ambiguous):
    """Center lines for both overlap checks and for the near points of f; each ellipsoid pair has its own line."""
    c1i, F1i, c1o, F1o, c2i, F2i, c2o, F2o = by_name(centers, factors)
    for k in range(len(c1i)):
        G1, G2 = near.inverse(matrix(F1o[k])), near.inverse(matrix(F2o[k]))
        _, _, _, status = near.center_line(G1, G2, offset(c2o, k, c1o))
        if status == near.SEPARATE:
            collides[k], ambiguous[k] = 0, 0
            continue
        r = offset(c2i, k, c1i)
        v1, v2, L, status = near.center_line(near.inverse(matrix(F1i[k])), near.inverse(matrix(F2i[k])), r)
        if status == near.OVERLAP:
            collides[k], ambiguous[k] = 1, 0
            continue
        p1, p2 = offset(c1o, k, c1i), offset(c2o, k, c1i)
        ambiguous[k] = 1
        collides[k] = f_from_near_points(v1, v2, L, r, p1, G1, p2, G2) <= 0.0
