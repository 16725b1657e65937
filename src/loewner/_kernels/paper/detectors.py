"""The paper's four detectors, each over n pairs on one thread.

Arrays have one row per pair, all in one frame: centers (n, 3) and factors (n, 3, 3) of the inner and outer ellipsoids
of both bodies. Answers are uint8: `collides`, and `ambiguous` for pairs that the detector's estimate (and not an
overlap check) decided.
"""

import math

from loewner._kernels._jit import inline, njit
from loewner._kernels.ellipsoids import near_points as near
from loewner._kernels.linalg3 import dot, matrix, minus
from loewner._kernels.paper.estimates import f_from_near_points, offset


@inline
def _face_distance(normals, offsets, start, stop, origin, p, e):
    """Parameter t at which the ray origin + p + t e leaves a polytope {x : normals x <= offsets}."""
    t = math.inf
    for i in range(start, stop):
        n = (normals[i, 0], normals[i, 1], normals[i, 2])
        speed = dot(n, e)
        if speed > 0.0:
            t = min(t, (offsets[i] - dot(n, origin) - dot(n, p)) / speed)
    return t


@njit()
def detector_1(c1i, F1i, c1o, F1o, c2i, F2i, c2o, F2o, n1, b1, s1, n2, b2, s2, collides, ambiguous):
    """The earlier method (the paper, section 2), as read in docs/design/paper.md.

    The inner ellipsoids are its own heuristic ones. Faces are given by normals (f, 3), offsets (f,), and the first face
    of each body (n + 1,).
    """
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
        # Along the line from v1 (at 0) to v2 (at L): outer ellipsoids and polyhedra end or begin at
        outer_1 = near.exit_of_ray(near.inverse(matrix(F1o[k])), minus(v1, offset(c1o, k, c1i)), e)
        outer_2 = L - near.exit_of_ray(near.inverse(matrix(F2o[k])), minus(v2, offset(c2o, k, c1i)), back)
        origin = (c1i[k, 0], c1i[k, 1], c1i[k, 2])
        face_1 = _face_distance(n1, b1, s1[k], s1[k + 1], origin, v1, e)
        face_2 = L - _face_distance(n2, b2, s2[k], s2[k + 1], origin, v2, back)
        # The printed test for "the enclosing ellipsoids overlap". It is also false when the polyhedra overlap along the
        # line, which is a certain collision: this is the flaw that the paper corrects.
        if (outer_1 - outer_2) * (face_1 - face_2) > 0.0:
            collides[k], ambiguous[k] = 0, 0
            continue
        ambiguous[k] = 1
        collides[k] = abs(face_1 - face_2) <= min(abs(outer_1 - face_1), abs(outer_2 - face_2))


@njit()
def detector_2(c1i, F1i, c1o, F1o, c2i, F2i, c2o, F2o, angle, collides, ambiguous):
    """The paper's detector: Lin-Han for both overlap checks and for the near points of f."""
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
def detector_3(c1i, F1i, c1o, F1o, c2i, F2i, c2o, F2o, collides, ambiguous):
    """Level surfaces for both overlap checks (appendix A) and for the near points of f."""
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
def detector_4(c1i, F1i, c1o, F1o, c2i, F2i, c2o, F2o, collides, ambiguous):
    """Center lines, each ellipsoid pair's own, for both checks and for the near points of f."""
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
