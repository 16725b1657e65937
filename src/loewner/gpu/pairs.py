"""Compute verdicts of pairs of bodies on a GPU."""

from __future__ import annotations

import weakref
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from loewner._base import _validate
from loewner._base._guard import guarded
from loewner._base._validate import Floats, Ints
from loewner._kernels import codes
from loewner.bodies import Bodies, Body, Packed, packed_of
from loewner.errors import InputError, PoseError
from loewner.gpu import driver
from loewner.gpu.arrays import DeviceArray, View, is_on_gpu, taken
from loewner.gpu.driver import Device, Memory
from loewner.gpu.work import FALLBACKS, Left, attempted, expect_few, gathered, number_of, scattered
from loewner.queries import pairs as queries
from loewner.queries._settle import NO_ROWS, settle
from loewner.queries.pairs import Plan, Verdict

# The plan for settling a single pair, which is listed by the row numbers of its bodies.
_ONE_LISTED = np.array([[1], [1], [0], [1], [0]], dtype=np.int64)


@guarded
def classify(
    a: Body | Bodies,
    T_world_a: Any,
    b: Body | Bodies,
    T_world_b: Any,
    *,
    pairs: ArrayLike | None = None,
    refine: bool = True,
    fallback: str = "error",
    device: int = 0,
) -> Any:
    """Compute the verdicts of `loewner.classify` with margin 0 on a GPU.

    Parameters
    ----------
    a, b : Body or Bodies
        A `Bodies` of length n broadcasts with the last batch axis of the poses. The bodies' ellipsoids stay on the GPU
        as long as the bodies exist.
    T_world_a, T_world_b : array_like or array on the GPU, shape (..., 4, 4), or None
        Poses, broadcast together; translation in metres. None is the identity. An array on the GPU must be float32 in C
        order, from CuPy, PyTorch, JAX or any other library that supports ``__cuda_array_interface__`` or DLPack; the
        answers then hold for exactly these float32 numbers. Any other array is copied to the GPU.
    pairs : array_like of int, shape (..., 2), optional
        Pairs of rows to compare, as in `loewner.classify`. This array must not be on the GPU.
    refine : bool
        Whether the CPU settles the pairs that single precision leaves open; for round pieces, these are about half a
        percent of all pairs. If false, such pairs, and pairs whose poses are not rigid motions, are AMBIGUOUS; a call
        with poses on the GPU then returns without waiting for the GPU.
    fallback : {"error", "cpu"}
        What to do if there is no GPU, its driver is too old, its memory is too small, or its work was lost. "error"
        raises an error; "cpu" warns once and uses the CPU. With poses on a GPU, "cpu" raises an error as well, since
        the CPU cannot read them.
    device : int
        Index of the GPU among those visible to the driver.

    Returns
    -------
    Verdict, or ndarray of int8, shape (...), or DeviceArray of int8
        The verdicts of `loewner.classify`. If any poses are on the GPU, the verdicts are a `DeviceArray`, which other
        libraries can use without copying.

    Raises
    ------
    GpuError
        If the GPU cannot do the work.
    PoseError
        If the shape of a pose does not end in (4, 4), a pose is not a rigid motion, or batches do not broadcast.
    InputError
        If an operand is not a body; if an array on the GPU has the wrong type or layout, or is on a different GPU; if
        pieces are smaller than 1e-3 m or larger than 1e3 m; or if there are more than 2^31 - 1 pairs.

    Notes
    -----
    The formulas are the same as on the CPU, and are compiled to use only correctly rounded operations. FREE and
    COLLIDING are therefore proven as in docs/certified.md. It is not worthwhile to transfer poses to the GPU only for
    this call, since the poses take 128 bytes per pair.

    Examples
    --------
    >>> import numpy as np
    >>> import loewner
    >>> from loewner import Body, gpu
    >>> T = np.tile(np.eye(4), (3, 1, 1))
    >>> T[:, 0, 3] = 0.5, 1.2, 3.0
    >>> try:
    ...     verdicts = gpu.classify(Body.sphere(1.0), None, Body.box([1, 1, 1]), T)
    ... except loewner.GpuError:
    ...     verdicts = loewner.classify(Body.sphere(1.0), None, Body.box([1, 1, 1]), T)
    >>> verdicts
    array([1, 1, 0], dtype=int8)
    """
    queries.expect_bodies(a, b)
    number = number_of(device)
    refined, instead = _validate.flag(refine, "refine"), _validate.choice(fallback, "fallback", FALLBACKS) == "cpu"
    for bodies in (a, b):
        single_rows(packed_of(bodies))  # refuses pieces that are too small or too large, even if there is no GPU
    poses = {"T_world_a": T_world_a, "T_world_b": T_world_b}
    checked = [T if is_on_gpu(T) else _validate.poses(T, name, check=False) for name, T in poses.items()]
    there = any(map(is_on_gpu, checked))
    if not there:
        queries.plan_of(a, checked[0].shape, b, checked[1].shape, each=5, chosen=pairs)  # raises errors about arguments

    def on_gpu() -> Any:
        gpu = driver.opened(number)
        held = [taken(T, name, gpu) if is_on_gpu(T) else T for name, T in zip(poses, checked, strict=True)]
        operands = [_Operand(*each) for each in zip((a, b), held, strict=True)]
        plan = queries.plan_of(a, operands[0].shape, b, operands[1].shape, each=5, chosen=pairs)
        return _classified(gpu, plan, operands, refined, there)

    def on_cpu() -> Any:
        ask: Any = queries.classify  # Any, because there is one signature for each kind of operands
        return ask(a, checked[0], b, checked[1], pairs=pairs)

    return attempted(on_gpu, on_cpu if instead and not there else None)


class _Operand(NamedTuple):
    """Bodies and their poses; a `View` stands for poses on the GPU."""

    bodies: Body | Bodies
    poses: Floats | View

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the poses."""
        shape = self.poses.shape
        if shape[-2:] != (4, 4):
            raise PoseError(f"expected poses of shape (..., 4, 4), found {_validate.shape_text(shape)}")
        return shape

    def poses_at(self, gpu: Device, rows: Ints) -> Floats:
        """Return the poses of some rows, in double precision and in CPU memory."""
        if isinstance(self.poses, View):
            return gathered(gpu, self.poses.address, 16, rows).reshape(-1, 4, 4)
        return np.ascontiguousarray(self.poses.reshape(-1, 4, 4)[rows])


class _Tables(NamedTuple):
    """Bodies on the GPU: the table's rows of their pieces, and the first piece of each body."""

    rows: Memory
    start: Memory


_tables: weakref.WeakKeyDictionary[Packed, dict[Device, _Tables]] = weakref.WeakKeyDictionary()


def _tables_of(gpu: Device, packed: Packed) -> _Tables:
    """Return the tables of bodies; the tables are copied to the GPU when they are first needed."""
    at = _tables.setdefault(packed, {})
    if gpu not in at:
        at[gpu] = _Tables(gpu.upload(single_rows(packed)), gpu.upload(packed.kernel.piece_start.astype(np.int32)))
    return at[gpu]


def single_rows(packed: Packed) -> NDArray[np.float32]:
    """Return the table's rows of pieces, in single precision.

    Raises
    ------
    InputError
        If a piece is too small or too large for single precision.
    """
    rows: NDArray[np.float32] = packed.kernel.single
    if len(rows) == 0 and len(packed.layout) > 0:
        raise InputError(
            "expected pieces between 1e-3 and 1e3 m for single precision, found others; use loewner.classify"
        )
    return rows


def _classified(gpu: Device, plan: Plan, operands: list[_Operand], refine: bool, there: bool) -> Any:
    """Classify pairs on the GPU, and undecided pairs on the CPU."""
    expect_few(plan.total, "pairs")
    packs = [packed_of(operand.bodies) for operand in operands]
    tables = [_tables_of(gpu, packed) for packed in packs]
    poses = [_poses_on(gpu, operand.poses) for operand in operands]
    steps = gpu.upload(plan.steps.astype(np.int32))
    rows = gpu.upload(plan.rows.astype(np.int32)) if plan.rows.size else None
    verdicts, left = gpu.memory(plan.total), Left(gpu, plan.total)
    # For surfaces, the CPU compares more ellipsoids than the GPU, so it may settle pairs that the GPU leaves open.
    of_open = codes.LEFT if any(len(packed.kernel.part_start) > 0 for packed in packs) else codes.AMBIGUOUS
    one_each = all(len(packed.piece_start) == len(packed.layout) + 1 for packed in packs)
    plan_arguments = steps.address, plan.steps.shape[1], 0 if rows is None else rows.address, plan.rows.shape[1]
    each: list[int] = []
    for table, pose in zip(tables, poses, strict=True):
        each += [table.rows.address, *([] if one_each else [table.start.address]), pose.address]
    told = of_open, verdicts.address, left.list.address
    gpu.launch("classify_pieces" if one_each else "classify_bodies", plan.total, *plan_arguments, *each, *told)
    if refine:
        numbers = left.numbers()
        settled = _settled(gpu, plan, operands, numbers)
        if there:
            scattered(gpu, numbers, settled, verdicts)
    if there:
        # The kernel's input remains valid until the kernel is done, because memory is freed in the order of the
        # stream's work.
        return DeviceArray(verdicts, plan.shape, np.int8)
    out = np.empty(plan.total, dtype=np.int8)
    gpu.download(verdicts.address, out)
    if refine:
        out[numbers] = settled
    return Verdict(int(out[0])) if plan.shape == () else out.reshape(plan.shape)


def _poses_on(gpu: Device, poses: Floats | View) -> View:
    """Copy poses to the GPU in single precision, unless they are there."""
    if isinstance(poses, View):
        return poses
    with np.errstate(over="ignore"):  # infinite numbers are left to the CPU
        memory = gpu.upload(poses.astype(np.float32))
    return View(memory.address, poses.shape, memory)


def _rows_of(plan: Plan, numbers: Ints) -> list[Ints]:
    """Return the rows of a, Ta, b and Tb for the pairs with these numbers."""
    if plan.rows.shape[1]:
        of_a, of_b = plan.rows[:, numbers]
        return [side * step for side, step in zip((of_a, of_a, of_b, of_b), plan.steps[1:, 0], strict=True)]
    places = np.array(np.unravel_index(numbers, plan.steps[0]))
    return [step @ places for step in plan.steps[1:]]


def _settled(gpu: Device, plan: Plan, operands: list[_Operand], numbers: Ints) -> NDArray[np.int8]:
    """Let the CPU decide the pairs with these numbers."""
    out = np.empty(len(numbers), dtype=np.int8)
    if len(numbers) == 0:
        return out
    a, b = (packed_of(operand.bodies).handle for operand in operands)
    body_a, pose_a, body_b, pose_b = _rows_of(plan, numbers)
    Ta, Tb = operands[0].poses_at(gpu, pose_a), operands[1].poses_at(gpu, pose_b)
    if not body_a.any() and not body_b.any():
        steps = np.array([[len(numbers)], [0], [1], [0], [1]], dtype=np.int64)
        if settle(codes.CERTIFY, 0.0, 0, len(numbers), (steps, NO_ROWS, a, Ta, b, Tb), out) is None:
            _refuse(Ta, Tb)
        return out
    rows = np.stack([body_a, body_b]).astype(np.int64)
    for k in range(len(numbers)):
        listed = np.ascontiguousarray(rows[:, k : k + 1])
        arguments = _ONE_LISTED, listed, a, Ta[k : k + 1], b, Tb[k : k + 1]
        if settle(codes.CERTIFY, 0.0, 0, 1, arguments, out[k : k + 1]) is None:
            _refuse(Ta[k : k + 1], Tb[k : k + 1])
    return out


def _refuse(Ta: Floats, Tb: Floats) -> None:
    """Raise an error that names the first pose that is not a rigid motion."""
    for T, name in ((Ta, "T_world_a"), (Tb, "T_world_b")):
        for one in T:
            _validate.rigid_motions(one, name)
    raise PoseError("expected rigid motions, found poses that changed during the call")
