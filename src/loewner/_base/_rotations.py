"""Convert rotation matrices to and from the forms that users and files use: quaternions, and roll, pitch and yaw."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from loewner._base import _elementary
from loewner._base._matrices import lengths
from loewner._base._validate import Floats
from loewner.errors import PoseError

# Allowed deviation of a quaternion's length from 1. A quaternion typed with three digits is accepted.
QUATERNION_TOLERANCE = 1e-2


def from_quaternion(wxyz: Sequence[float], name: str) -> Floats:
    """Compute the rotation, shape (3, 3), of a quaternion, real part first, after normalising it to length 1.

    Raises
    ------
    PoseError
        If the quaternion's length is not within `QUATERNION_TOLERANCE` of 1.
    """
    length = math.sqrt(sum(x * x for x in wxyz))
    if not abs(length - 1) <= QUATERNION_TOLERANCE:
        raise PoseError(f"{name}: expected a unit quaternion qw qx qy qz, found one of length {length:.4g}")
    return rotations_of(np.array(wxyz) / length)


def rotations_of(wxyz: Floats) -> Floats:
    """Compute the rotation matrices, shape (..., 3, 3), of unit quaternions, real part first, shape (..., 4)."""
    w, x, y, z = np.moveaxis(wxyz, -1, 0)
    rows = (
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def pose_of(rotation: Floats, translation: Any) -> Floats:
    """Make the pose, shape (4, 4), of a rotation matrix and a translation."""
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = rotation, translation
    return T


def from_rpy(roll: float, pitch: float, yaw: float) -> Floats:
    """Compute Rz(yaw) Ry(pitch) Rx(roll), shape (3, 3): turns [rad] about fixed axes x, then y, then z, as in URDF."""
    angles = np.array([roll, pitch, yaw])
    (cr, cp, cy), (sr, sp, sy) = _elementary.cos(angles).tolist(), _elementary.sin(angles).tolist()
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )


def to_rpy(R: Floats) -> tuple[float, float, float]:
    """Compute roll, pitch and yaw, from which `from_rpy` restores the rotation matrix, even at gimbal lock."""
    yaw = _elementary.arctan2(R[1, 0], R[0, 0])
    s, c = _elementary.sin(yaw), _elementary.cos(yaw)
    # Roll and pitch follow from the rotation with its yaw removed. If the pitch is a right angle, the yaw is arbitrary.
    roll = _elementary.arctan2(s * R[0, 2] - c * R[1, 2], c * R[1, 1] - s * R[0, 1])
    return roll, _elementary.arctan2(-R[2, 0], c * R[0, 0] + s * R[1, 0]), yaw


def quaternions_of(rotations: Floats) -> Floats:
    """Compute unit quaternions, real part first, of rotation matrices, shape (..., 3, 3), even for half turns."""
    R = rotations.reshape(-1, 3, 3)
    diagonal, trace = R[:, [0, 1, 2], [0, 1, 2]], np.trace(R, axis1=1, axis2=2)
    # Row k is the quaternion multiplied by four times its entry k; the row for the largest entry is well conditioned.
    rows = np.empty((len(R), 4, 4))
    rows[:, 0, 0] = 1.0 + trace
    rows[:, [1, 2, 3], [1, 2, 3]] = 1.0 + 2.0 * diagonal - trace[:, None]
    for k, (i, j) in enumerate(((2, 1), (0, 2), (1, 0)), 1):
        rows[:, 0, k] = rows[:, k, 0] = R[:, i, j] - R[:, j, i]
    for i, j in ((0, 1), (0, 2), (1, 2)):
        rows[:, i + 1, j + 1] = rows[:, j + 1, i + 1] = R[:, i, j] + R[:, j, i]
    best = np.diagonal(rows, axis1=1, axis2=2).argmax(axis=1)
    quaternions: Floats = rows[np.arange(len(R)), best]
    quaternions /= lengths(quaternions)[:, None]
    return quaternions.reshape(*rotations.shape[:-2], 4)
