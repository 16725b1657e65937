"""The border: array-likes in, checked C-order float64 arrays out.

Everything past this module may assume finite float64 in C order and rigid poses.
"""

from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from loewner.errors import InputError, PoseError

Floats = NDArray[np.float64]

# How far RᵀR may be from the identity (largest entry). Wide enough for poses that went through
# float32 (about 1e-7 a product), far too narrow for a scale or a shear that anybody meant.
ROTATION_TOLERANCE = 1e-6

IDENTITY: Floats = np.eye(4)
IDENTITY.setflags(write=False)


def float_array(x: ArrayLike, name: str) -> Floats:
    """Return `x` as a C-order float64 array; anything that is not real numbers is an error."""
    try:
        array = np.asarray(x)
    except ValueError as error:
        raise InputError(f"{name}: expected an array of numbers, found a ragged sequence ({error})") from None
    if array.dtype == np.float64 and array.flags.c_contiguous:
        return array
    if array.dtype.kind not in "fiub":
        raise InputError(f"{name}: expected real numbers, found dtype {array.dtype}")
    return np.ascontiguousarray(array, dtype=np.float64).reshape(array.shape)


def shape_text(shape: Iterable[int | None | str]) -> str:
    """Write a shape for people, with letters or dots where any length will do."""
    parts = ["n" if s is None else str(s) for s in shape]
    return "(" + ", ".join(parts) + ("," if len(parts) == 1 else "") + ")"


def finite_array(x: ArrayLike, name: str, shape: tuple[int | None | str, ...]) -> Floats:
    """Check shape and finiteness.

    Parameters
    ----------
    x : array_like
    name : str
        What the caller calls it, for the message.
    shape : tuple
        Expected shape; ``None`` matches any length, a leading ``"..."`` any batch shape.

    Raises
    ------
    InputError
        With the shape expected and the one found, or the first entry that is not finite.
    """
    array = float_array(x, name)
    tail = shape[1:] if shape and shape[0] == "..." else shape
    fits = array.ndim >= len(tail) if len(tail) < len(shape) else array.ndim == len(tail)
    if fits and tail:
        fits = all(want is None or want == have for want, have in zip(tail, array.shape[-len(tail) :], strict=True))
    if not fits:
        raise InputError(f"{name}: expected shape {shape_text(shape)}, found {shape_text(array.shape)}")
    # One reduction is quicker than isfinite().all() on small arrays; a NaN or inf survives a sum times zero.
    if array.size and not np.isfinite(array).all():
        where = tuple(int(i) for i in np.argwhere(~np.isfinite(array))[0])
        raise InputError(f"{name}: expected finite numbers, found {array[where]} at index {where}")
    return array


def positive_scalar(x: Any, name: str, *, zero: bool = False) -> float:
    """Check a finite number above zero (or not below it, with `zero`)."""
    try:
        value = float(x)
    except (TypeError, ValueError):
        raise InputError(f"{name}: expected a number, found {x!r}") from None
    if not np.isfinite(value) or value < 0 or (value == 0 and not zero):
        raise InputError(f"{name}: expected a finite number {'>= 0' if zero else '> 0'}, found {x!r}")
    return value


def positive_vector(x: ArrayLike, name: str, length: int | None) -> Floats:
    """Check a vector of finite numbers above zero."""
    vector = finite_array(x, name, (length,))
    if not (vector > 0).all():
        raise InputError(f"{name}: expected numbers > 0, found {vector.tolist()}")
    return vector


def poses(T: ArrayLike | None, name: str) -> Floats:
    """Check rigid motions.

    Parameters
    ----------
    T : array_like, shape (..., 4, 4), or None
        Homogeneous matrices; ``None`` is the identity.

    Raises
    ------
    PoseError
        If the shape is wrong, an entry is not finite, the last row is not (0, 0, 0, 1), or the
        rotation part is not orthonormal to `ROTATION_TOLERANCE` with determinant +1.
    """
    if T is None:
        return IDENTITY
    try:
        array = float_array(T, name)
    except InputError as error:
        raise PoseError(str(error)) from None
    if array.shape[-2:] != (4, 4):
        raise PoseError(f"{name}: expected shape (..., 4, 4), found {shape_text(array.shape)}")
    if array.size == 0:
        return array
    R = array[..., :3, :3]
    # NaN and inf make the comparison false too, so one test on the way in serves all three.
    with np.errstate(all="ignore"):
        defect = np.abs(np.swapaxes(R, -1, -2) @ R - np.eye(3)).max(axis=(-1, -2))
        last_row = np.abs(array[..., 3, :] - (0.0, 0.0, 0.0, 1.0)).max(axis=-1)
        good = (defect <= ROTATION_TOLERANCE) & (last_row == 0) & np.isfinite(array[..., :3, 3]).all(axis=-1)
    if good.all() and (_determinant(R) > 0).all():
        return array
    raise _pose_error(array, name, defect, last_row)


def _determinant(R: Floats) -> Floats:
    a, b, c = R[..., 0, :], R[..., 1, :], R[..., 2, :]
    return (
        a[..., 0] * (b[..., 1] * c[..., 2] - b[..., 2] * c[..., 1])
        - a[..., 1] * (b[..., 0] * c[..., 2] - b[..., 2] * c[..., 0])
        + a[..., 2] * (b[..., 0] * c[..., 1] - b[..., 1] * c[..., 0])
    )


def _pose_error(array: Floats, name: str, defect: Floats, last_row: Floats) -> PoseError:
    """Say which pose is wrong and how."""
    flat = array.reshape(-1, 4, 4)
    bad = ~(
        (defect.reshape(-1) <= ROTATION_TOLERANCE)
        & (last_row.reshape(-1) == 0)
        & np.isfinite(flat).all(axis=(-1, -2))
        & (_determinant(flat[:, :3, :3]) > 0)
    )
    k = int(np.flatnonzero(bad)[0])
    where = f"{name}[{k}]" if len(flat) > 1 else name
    T = flat[k]
    if not np.isfinite(T).all():
        return PoseError(f"{where}: expected finite numbers, found NaN or inf")
    if last_row.reshape(-1)[k] != 0:
        return PoseError(f"{where}: expected last row (0, 0, 0, 1), found {T[3].tolist()}")
    if defect.reshape(-1)[k] > ROTATION_TOLERANCE:
        return PoseError(
            f"{where}: expected a rotation (RᵀR = 1 within {ROTATION_TOLERANCE:g}), "
            f"found a departure of {defect.reshape(-1)[k]:.3g}"
        )
    return PoseError(f"{where}: expected a rotation with determinant +1, found a reflection (determinant -1)")
