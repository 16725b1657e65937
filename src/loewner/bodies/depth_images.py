"""Check depth images, and convert them to points."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from loewner._base import _validate
from loewner._base._guard import guarded
from loewner._base._plausible import warn
from loewner._base._validate import Floats
from loewner.errors import InputError

# SMALLEST is the least focal length of a camera in pixels, and LARGEST the largest entry of its intrinsic matrix.
SMALLEST, LARGEST = 1e-3, 1e9

# Depths above this number are probably in millimetres, not in metres.
FARTHEST = 100.0

# If an image is wider or higher than this many focal lengths (170 degrees), its intrinsic matrix is probably wrong.
WIDEST = 23.0

# Distances of the principal point from the middle of the image, as shares of the image's width or height. For a camera,
# the distance is at most OFF. If the matrix belongs to a transposed image, the distance exceeds OFF, but falls below
# CENTRAL if width and height are exchanged.
OFF, CENTRAL = 0.1, 0.05


@guarded
def points_of(image: ArrayLike, K: ArrayLike, T_world_camera: ArrayLike | None = None) -> Floats:
    """Convert a depth image to points.

    Parameters
    ----------
    image : array_like of float, shape (H, W)
        Depths along the optical axis, in metres. An entry that is not finite or not positive stands for a pixel without
        an echo.
    K : array_like, shape (3, 3)
        Intrinsic matrix ``[[fx, s, cx], [0, fy, cy], [0, 0, 1]]``, in pixels; (0, 0) is the middle of the first pixel.
    T_world_camera : array_like, shape (4, 4), optional
        Pose of the camera, which looks along its z axis; x points to the right in the image, and y points down.

    Returns
    -------
    ndarray, shape (H, W, 3)
        Points in world coordinates, NaN where there is no echo.

    Raises
    ------
    InputError
        If the image is not an array of floating-point numbers with two axes, or the matrix is not an intrinsic matrix.
        Depths that are integers are usually in millimetres: divide them by 1000.
    PoseError
        If the pose is not a rigid motion.

    Examples
    --------
    >>> from loewner.depth import points_of
    >>> points = points_of(np.full((3, 3), 2.0), [[100.0, 0, 1], [0, 100.0, 1], [0, 0, 1]])
    >>> points[1, 2]
    array([0.02, 0.  , 2.  ])
    """
    depths, intrinsics, T = camera_of(image, K, T_world_camera)
    v, u = np.indices(depths.shape)
    (fx, skew, cx), (_, fy, cy), _ = intrinsics
    y = (v - cy) / fy
    x = (u - cx - skew * y) / fx
    rays = np.stack([x, y, np.ones(depths.shape)], axis=-1)
    with np.errstate(over="ignore", invalid="ignore"):
        points = np.asarray((depths[..., None] * rays) @ T[:3, :3].T + T[:3, 3])
    for at in np.argwhere(np.isfinite(depths) & ~np.isfinite(points).all(axis=-1))[:1].tolist():
        raise InputError(f"image: expected depths whose points are finite, found {depths[tuple(at)]:g} m in pixel {at}")
    return points


def camera_of(image: ArrayLike, K: ArrayLike, T_world_camera: ArrayLike | None) -> tuple[Floats, Floats, Floats]:
    """Check a depth image, its intrinsic matrix and the camera's pose; pixels without an echo become NaN."""
    depths = _depths(image)
    matrix = _intrinsics(K)
    height, width = depths.shape
    if width > WIDEST * matrix[0, 0] or height > WIDEST * matrix[1, 1]:
        warn(
            f"K: focal lengths of {matrix[0, 0]:.3g} and {matrix[1, 1]:.3g} pixels make an image of {width} x {height} "
            "pixels wider than 170 degrees; is the matrix normalised or inverted?"
        )
    elif doubt := _doubt_about_middle(matrix[0, 2], matrix[1, 2], width, height):
        warn(f"K: a principal point of {matrix[0, 2]:.6g}, {matrix[1, 2]:.6g} {doubt}")
    return depths, matrix, _validate.pose(T_world_camera, "T_world_camera")


def _doubt_about_middle(cx: float, cy: float, width: int, height: int) -> str:
    """Explain why a principal point may belong to another image; empty if the point is plausible."""

    def off(width: int, height: int) -> float:
        return max(abs((cx + 0.5) / width - 0.5), abs((cy + 0.5) / height - 0.5))

    if off(width, height) > OFF and off(height, width) < CENTRAL:
        return f"is the middle of an image of {height} x {width} pixels, found {width} x {height}; is it transposed?"
    if off(width, height) > 0.5:
        return f"is outside an image of {width} x {height} pixels; is the matrix for another resolution, or cropped?"
    return ""


def _depths(image: ArrayLike) -> Floats:
    """Check the image of a depth camera."""
    kind, depths = _validate.plain_array(image, "image").dtype, _validate.float_array(image, "image")
    if depths.ndim != 2 or 0 in depths.shape or kind.kind in "iu":
        hint = (
            "is the image in colour?" if depths.ndim == 3 else "divide millimetres by 1000" if kind.kind in "iu" else ""
        )
        raise InputError(
            "image: expected floating-point depths in metres with two axes, found "
            f"{kind} of shape {_validate.shape_text(depths.shape)}{hint and f'; {hint}'}"
        )
    echoes = np.isfinite(depths) & (depths > 0.0)
    if 2 * np.count_nonzero(echoes & (depths > FARTHEST)) > np.count_nonzero(echoes):
        warn(f"image: half of the depths are above {FARTHEST:g} m; are they in millimetres?")
    return np.where(echoes, depths, np.nan)


def _intrinsics(K: ArrayLike) -> Floats:
    """Check an intrinsic matrix."""
    matrix = _validate.finite_array(K, "K", (3, 3))
    shaped = matrix[1, 0] == 0.0 and (matrix[2] == [0.0, 0.0, 1.0]).all() and (np.abs(matrix) <= LARGEST).all()
    if not (shaped and min(matrix[0, 0], matrix[1, 1]) >= SMALLEST):
        raise InputError(
            "K: expected an intrinsic matrix [[fx, s, cx], [0, fy, cy], [0, 0, 1]] in pixels, with positive fx and "
            f"fy, found {matrix.tolist()}"
        )
    return matrix
