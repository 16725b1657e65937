"""Compute the paper's estimate f of the distance between two pieces, from the near points of detectors 2 to 4.

f <= 0 counts as a collision. The library's own estimate (`loewner.collide` with ``method="estimate"``, and the
`estimate` of `loewner.distance`) is different: docs/design/estimate_rule.md compares them.
"""

from __future__ import annotations

import math

import numpy as np

from loewner._base import _validate
from loewner._base._guard import guarded
from loewner._base._validate import Floats
from loewner._native import entries
from loewner.ellipsoids.ellipsoid_pairs import NEAR_POINT_METHODS
from loewner.ellipsoids.ellipsoids import Ellipsoids
from loewner.errors import ConvergenceError, InputError

BYTES_PER_PAIR = 8 * (4 * 12 + 1)  # copies of four centers and factors, and f


@guarded
def distance_estimate(
    inner_1: Ellipsoids, outer_1: Ellipsoids, inner_2: Ellipsoids, outer_2: Ellipsoids, method: str = "rimon-boyd"
) -> Floats:
    """Estimate the distance between convex pieces by the paper's f, from the two ellipsoids of each piece.

    On the line through near points of the inner ellipsoids, each piece is assumed to end halfway between its inner and
    outer ellipsoids.

    Parameters
    ----------
    inner_1, outer_1, inner_2, outer_2 : Ellipsoids
        Ellipsoids in 3-D, all in one frame, in metres; batches broadcast.
    method : {"rimon-boyd", "lin-han", "center-line"}
        Method of `loewner.near_points`. Detector 2 uses "lin-han" (to 0.01 rad), and detector 3 uses "rimon-boyd".
        Detector 4 uses "center-line", which misses many collisions of thin pieces.

    Returns
    -------
    ndarray, shape (...)
        f in metres; values of at most 0 count as collisions. The values are never proofs, even if the ellipsoids settle
        a pair; use `loewner.classify` for proofs.

    Raises
    ------
    InputError
        If an argument is not 3-D or batch shapes do not broadcast.
    UnknownNameError
        If the method is unknown.
    ConvergenceError
        If the squares of sizes or distances exceed the range of float64.

    References
    ----------
    The paper, section 4.

    Examples
    --------
    >>> from loewner import Body, paper
    >>> a, b, T = Body.box([1, 1, 1]), Body.box([1, 1, 1]), np.eye(4)
    >>> T[0, 3] = 1.3  # faces 0.3 m apart
    >>> f = paper.distance_estimate(a.inner, a.outer, b.inner.transformed(T), b.outer.transformed(T))
    >>> f.round(3)
    array([-0.066])
    """
    code = NEAR_POINT_METHODS[_validate.choice(method, "method", NEAR_POINT_METHODS)]
    ellipsoids = {"inner_1": inner_1, "outer_1": outer_1, "inner_2": inner_2, "outer_2": outer_2}
    for name, E in ellipsoids.items():
        if _validate.instance(E, name, Ellipsoids).dim != 3:
            raise InputError(f"{name}: expected ellipsoids in 3-D, found dimension {E.dim}")
    batch = _validate.broadcast({name: E.batch_shape for name, E in ellipsoids.items()})
    n = math.prod(batch)
    _validate.fits_memory(BYTES_PER_PAIR * n, f"{n} pairs of pieces")
    centers, factors, f = np.empty((4, *batch, 3)), np.empty((4, *batch, 3, 3)), np.empty(n)
    for k, E in enumerate(ellipsoids.values()):
        centers[k], factors[k] = E.center, E.factor
    entries.estimates_of_pairs(code, centers.reshape(4, n, 3), factors.reshape(4, n, 3, 3), f)
    beyond = np.flatnonzero(~np.isfinite(f))
    if beyond.size:
        raise ConvergenceError(
            "distance_estimate: expected sizes and distances that float64 can square, found a pair beyond that "
            f"(first at index {beyond[0]})"
        )
    return f.reshape(batch)[()]
