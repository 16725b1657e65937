"""Compute the points of depth images, and the space that depth images show to be empty."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from loewner._base import _validate
from loewner._base._guard import guarded
from loewner._base._validate import Bools, Floats, Ints
from loewner.bodies import Body, camera_of, points_of
from loewner.errors import InputError
from loewner.robots import CollisionChecker

__all__ = ["SeenSpace", "points_of"]

# A cell counts as seen only if it is nearer than the measured depths by this relative margin. The margin is far larger
# than the rounding error of a projection.
ROUNDING = 1e-9

# Memory that a call of `see` uses, in bytes per cell corner.
BYTES = 200


@guarded
class SeenSpace:
    """A grid of cells, each either unknown or seen to be empty by a depth camera.

    A cell is seen if depths were measured at all pixels onto which it projects, and it lies completely in front of all
    these depths. All other cells are unknown: they are behind a surface, in the shadow of the robot, outside the image,
    or where no depth was measured. Seen cells count as seen until `forget` makes them unknown again.

    Parameters
    ----------
    low : array_like, shape (3,)
        The lowest corner of the grid in world coordinates, in metres.
    shape : sequence of int
        Number of cells along each axis.
    size : float
        Edge of a cell, in metres.

    Attributes
    ----------
    centers : ndarray, shape (p, q, r, 3)
    age : ndarray of int64, shape (p, q, r)
        How many images ago each cell was last seen; -1 for unknown cells.
    time : float or None
        The time of the last image that was passed with a time, in seconds.

    Raises
    ------
    InputError
        If a number is not finite or not positive.
    MemoryLimitError
        If the grid would not fit into memory.

    Examples
    --------
    >>> space = SeenSpace([-1, -1, 0.5], (20, 20, 20), 0.1)
    >>> space.see(np.full((240, 320), 1.5), [[300.0, 0, 160], [0, 300.0, 120], [0, 0, 1]])
    >>> space
    SeenSpace(20 x 20 x 20 cells of 0.1 m, 522 seen)
    >>> len(space.body().pieces)
    540
    """

    def __init__(self, low: ArrayLike, shape: Any, size: float) -> None:
        self._low = _validate.finite_array(low, "low", (3,))
        counts = tuple(_validate.whole_number(n, "shape", 1) for n in _validate.listed(shape, "shape"))
        if len(counts) != 3:
            raise InputError(f"shape: expected three numbers, found {len(counts)}")
        self._size = _validate.positive_scalar(size, "size")
        _validate.fits_memory(BYTES * int(np.prod([n + 1.0 for n in counts])), f"{counts} cells")
        self.age: Ints = np.full(counts, -1, dtype=np.int64)
        self.time: float | None = None

    def __repr__(self) -> str:
        p, q, r = self.age.shape
        return f"SeenSpace({p} x {q} x {r} cells of {self._size:g} m, {int((self.age >= 0).sum())} seen)"

    @property
    def unknown(self) -> Bools:
        """Whether each cell is unknown, shape (p, q, r)."""
        return self.age < 0

    @property
    def centers(self) -> Floats:
        """Centers of the cells, shape (p, q, r, 3)."""
        return self._middles(self._low, np.moveaxis(np.indices(self.age.shape), 0, -1))

    def _middles(self, low: Floats, cells: Ints) -> Floats:
        return np.asarray(low + self._size * (cells + 0.5))

    def see(
        self, image: ArrayLike, K: ArrayLike, T_world_camera: ArrayLike | None = None, *, time: float | None = None
    ) -> None:
        """Add the cells in front of a depth image.

        Parameters
        ----------
        image, K, T_world_camera
            As for `points_of`. Subtract the noise of the sensor from the depths beforehand.
        time : float, optional
            When the image was taken, in seconds.

        Raises
        ------
        InputError, PoseError
            As for `points_of`. An image older than the last image with a time also raises InputError, because a body
            may since have moved into cells that this image shows as empty.
        """
        depths, intrinsics, T = camera_of(image, K, T_world_camera)
        now = None if time is None else float(_validate.finite_array(time, "time", ()))
        if now is not None and self.time is not None and now < self.time:
            raise InputError(f"time: expected {self.time:g} s, the time of the last image, or more, found {now:g}")
        depths = np.nan_to_num(depths)
        # Before the division by depth, the projection of a corner is affine in its indices: a sum of one term per axis.
        turn = intrinsics @ T[:3, :3].T
        first = turn @ (self._low - T[:3, 3])
        steps = self._size * turn
        along = [np.arange(n + 1) for n in self.age.shape]
        scaled_u, scaled_v, z = (
            (x + row[0] * along[0])[:, None, None] + (row[1] * along[1])[:, None] + row[2] * along[2]
            for x, row in zip(first, steps, strict=True)
        )
        with np.errstate(divide="ignore", invalid="ignore"):
            u, v = scaled_u / z, scaled_v / z
        (least_u, most_u), (least_v, most_v) = _over_cells(u), _over_cells(v)
        nearest = z[:-1, :-1, :-1] + np.minimum(steps[2], 0.0).sum()
        farthest = z[:-1, :-1, :-1] + np.maximum(steps[2], 0.0).sum()
        height, width = depths.shape
        # A pixel covers half a pixel on each side of its center, and a seen cell must be completely inside the image.
        inside = (nearest > 0.0) & (least_u >= 0.0) & (most_u <= width - 1) & (least_v >= 0.0) & (most_v <= height - 1)
        some = np.nonzero(inside)
        ends = [np.floor(x[some]).astype(np.int64) for x in (least_v, least_u)]
        tops = [np.ceil(x[some]).astype(np.int64) for x in (most_v, most_u)]
        clear = _least_in(depths, *ends, *tops) > farthest[some] * (1.0 + ROUNDING)
        self.age[self.age >= 0] += 1
        self.age[tuple(axis[clear] for axis in some)] = 0
        self.time = self.time if now is None else now

    def forget(self, older_than: int) -> None:
        """Make cells unknown again if they were last seen long ago.

        Parameters
        ----------
        older_than : int
            The largest `age` at which a cell still counts as seen. If it is 0, only the cells that were seen in the
            last image still count.

        Raises
        ------
        InputError
            If the number is not an integer, or is negative.
        """
        self.age[self.age > _validate.whole_number(older_than, "older_than", 0)] = -1

    def body(
        self,
        checker: CollisionChecker | None = None,
        q: ArrayLike | None = None,
        *,
        clear: float = 0.03,
        closed: bool = True,
    ) -> Body:
        """Make a body of the unknown cells.

        Parameters
        ----------
        checker : CollisionChecker, optional
            The checker of a robot. Cells that contain the robot or a body that it carries are left out, since the robot
            would otherwise collide with them.
        q : array_like, shape (dof,), optional
            The robot's configuration; required with `checker`.
        clear : float
            Cells within this distance of the robot, in metres, are left out. Some cells that are up to one cell
            diagonal farther away are also left out.
        closed : bool
            Whether to put a layer of cells around the grid. Without this layer, the space outside the grid counts as
            free although it is unseen.

        Returns
        -------
        Body
            A body like the result of `Body.from_voxels`.

        Raises
        ------
        GeometryError
            If no cell is left.
        InputError
            If only one of `checker` and `q` is given, or for the reasons listed at `CollisionChecker.off_the_robot`.
        """
        cells, low = self.unknown, self._low
        if _validate.flag(closed, "closed"):
            cells, low = np.pad(cells, 1, constant_values=True), low - self._size
        if (checker is None) != (q is None):
            raise InputError("checker, q: expected both or none, found one")
        if checker is not None and q is not None:
            _validate.instance(checker, "checker", CollisionChecker)
            reach = _validate.positive_scalar(clear, "clear", zero=True) + np.sqrt(0.75) * self._size
            where = np.nonzero(cells)
            centers = self._middles(low, np.stack(where, axis=-1))
            cells[where] = checker.off_the_robot(centers, q, clear=reach, mask=True)
        return Body.from_voxels(cells, self._size, origin=low)


def _over_cells(x: Floats) -> tuple[Floats, Floats]:
    """Compute the least and the largest value at the eight corners of each cell."""
    least, most = x, x
    for axis in range(3):
        low = tuple(slice(None, -1) if k == axis else slice(None) for k in range(3))
        high = tuple(slice(1, None) if k == axis else slice(None) for k in range(3))
        least, most = np.minimum(least[low], least[high]), np.maximum(most[low], most[high])
    return least, most


def _least_in(depths: Floats, v0: Ints, u0: Ints, v1: Ints, u1: Ints) -> Floats:
    """Find the least depth in rectangles of pixels, ends included, from minima over windows of 2^k by 2^m pixels."""
    least = np.empty(len(v0))
    rows, cols = ((np.frexp(ends - starts + 1)[1] - 1).astype(np.int8) for starts, ends in ((v0, v1), (u0, u1)))
    by_rows = depths
    for k in range(int(rows.max(initial=0)) + 1):
        if k > 0:
            by_rows = np.minimum(by_rows[: len(by_rows) - 2 ** (k - 1)], by_rows[2 ** (k - 1) :])
        window = by_rows
        for m in range(int(cols.max(initial=0)) + 1):
            if m > 0:
                half = 2 ** (m - 1)
                window = np.minimum(window[:, : window.shape[1] - half], window[:, half:])
            mine = np.flatnonzero((rows == k) & (cols == m))
            if len(mine):
                top, left = v1[mine] - 2**k + 1, u1[mine] - 2**m + 1
                pairs = [(v, u) for v in (v0[mine], top) for u in (u0[mine], left)]
                least[mine] = np.minimum.reduce([window[v, u] for v, u in pairs])
    return least
