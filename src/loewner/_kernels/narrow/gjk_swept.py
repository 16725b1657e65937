"""GJK between a piece and the hull of another piece at two poses: find a plane between them."""

from loewner._kernels._jit import inline
from loewner._kernels.codes import APART, OVERLAPPING, TOUCHING
from loewner._kernels.linalg3 import dot, minus, negated, plus
from loewner._kernels.narrow.gjk_fast import measuring, result_of, vertices_of
from loewner._kernels.narrow.gjk_robust import rounding_error, swollen_radii
from loewner._kernels.pieces.pack import shift_between
from loewner._kernels.pieces.shapes import placed_support, radius


@inline
def _supports(A, B, shift, W, ends, n):
    """Find the points of A, and of B at both of its poses, whose difference is least along n."""
    a = placed_support(A, negated(n))
    first, last = B
    b = plus(placed_support(first, n), shift[0])
    c = plus(placed_support(last, n), shift[1])
    if dot(minus(c, b), n) > 0.0:
        b = c
    return a, b


_search = measuring(_supports)


@inline
def separated(A, first, last, n, least, keep, stretch, memory):
    """Return whether a piece is proven to be farther than `keep` from the hull of another piece at two poses.

    Parameters
    ----------
    A, first, last : Placed
        The static piece, and the other piece at both poses.
    n : tuple of 3 float
        First direction, from A to the hull; any direction is valid.
    least, keep : float
        Distances, with 0 <= least <= keep. The search ends once the distance is certainly more than `keep`, or not more
        than `least`. For distances in between, it continues to the plane with the largest gap.
    stretch : float
        Amount by which intermediate poses may stretch radii more than the two poses do.
    memory : int
        Address of `gjk_fast.MEMORY`.

    Returns
    -------
    yes : bool
    n : tuple of 3 float
        The last direction of the search, a unit vector.
    open : bool
        If the distance is not proven to be more than `keep`, whether it may be more than `least`.
    """
    shift = shift_between(A, first), shift_between(A, last)
    error = max(rounding_error(A, first, shift[0]), rounding_error(A, last, shift[1]))
    radii = radius(A) + radius(last)
    lost = 0.0
    if radii > 0.0:
        lost = max(swollen_radii(A, first), swollen_radii(A, last)) + radii * stretch
    W, result = vertices_of(memory), result_of(memory)
    status, _, _, n = _search(A, (first, last), shift, W, 0, n, error, least + radii, keep + lost, result)
    return status == APART, n, status not in (TOUCHING, OVERLAPPING)
