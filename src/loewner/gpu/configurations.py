"""Check configurations of a robot on a GPU."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from loewner import _validate
from loewner._guard import guarded
from loewner._kernels import codes, columns, tolerances
from loewner._validate import Floats, Ints
from loewner.errors import InputError
from loewner.gpu import driver
from loewner.gpu.arrays import DeviceArray, is_on_gpu, taken
from loewner.gpu.driver import Device, Memory
from loewner.gpu.pairs import single_rows
from loewner.gpu.work import FALLBACKS, Left, attempted, expect_few, gathered, number_of, scattered
from loewner.robots import CollisionChecker
from loewner.robots.checker import prepared_of
from loewner.robots.problem import Problem
from loewner.robots.verdicts import classified, expect_settled

# Number of configurations in a tile, a power of two: tens of megabytes, which fit into the caches of large GPUs.
LOG_TILE = 14
TILE = 1 << LOG_TILE

# Average number of pairs of bodies that bounds may leave open per configuration of a tile; the CPU gets the rest.
SURVIVORS = 64

KINDS = columns.FIXED, columns.REVOLUTE, columns.PRISMATIC


class _Tables(NamedTuple):
    """Kernel input for a robot and its scene; `loewner._kernels.threads.configurations` describes the fields."""

    version: int
    moving: int
    pair_count: int
    links: int
    joints: Memory
    constants: Memory
    bodies: Memory
    balls: Memory
    rows: Memory
    pairs: Memory
    margins: Memory
    standing: Memory


class _Tile(NamedTuple):
    """Kernel output for one tile of configurations."""

    placed: Memory
    bounds: Memory
    state: Memory
    survivors: Memory
    capacity: int


class Checker:
    """A collision checker whose ellipsoids are on a GPU. Experimental: not yet run on hardware.

    The GPU places the robot, compares bounds and ellipsoids, and returns FREE or COLLIDING for configurations for which
    this is proven. The checker itself decides all remaining configurations, so the answers equal the checker's. Near
    obstacles, the ellipsoids leave many configurations open, and the exact searches do not run on the GPU.

    Parameters
    ----------
    checker : CollisionChecker
        Its scene may change between calls.
    fallback : {"error", "cpu"}
        What to do if there is no GPU, its driver is too old, its memory is too small, or its work was lost: raise an
        error, or warn once and use the checker.
    device : int
        Index of the GPU among those visible to the driver.

    Raises
    ------
    InputError
        If `checker` is not a checker, or its robot has planar, floating or ball joints.

    Examples
    --------
    >>> from loewner import Body, CollisionChecker, Robot, Scene, gpu
    >>> robot = Robot.from_urdf("arm.urdf")
    >>> checker = CollisionChecker(robot, Scene())
    >>> on_gpu = gpu.Checker(checker)
    >>> on_gpu
    <loewner.gpu.Checker of 2 joints on GPU 0>
    """

    def __init__(self, checker: CollisionChecker, *, fallback: str = "error", device: int = 0) -> None:
        if not isinstance(checker, CollisionChecker):
            raise InputError(f"checker: expected a loewner.CollisionChecker, found {type(checker).__name__}")
        self._number = number_of(device)
        self._instead = _validate.choice(fallback, "fallback", FALLBACKS) == "cpu"
        if not np.isin(checker.robot.tree.kind, KINDS).all():
            raise InputError("checker: expected joints that turn or slide, found planar, floating or ball joints")
        self._checker = checker
        self._tables: dict[Device, _Tables] = {}

    def __repr__(self) -> str:
        return f"<loewner.gpu.Checker of {self._checker.robot.dof} joints on GPU {self._number}>"

    @guarded
    def collide(self, Q: Any) -> Any:
        """Decide exactly which configurations are in collision, with the answers of `CollisionChecker.collide`.

        Parameters
        ----------
        Q : array_like or array on the GPU, shape (..., dof)
            An array on the GPU must be float32 in C order; the answers then refer to exactly these float32 numbers.

        Returns
        -------
        bool, or ndarray of bool, shape (...), or DeviceArray of bool
            A `DeviceArray` if the configurations are on the GPU.

        Raises
        ------
        GpuError
            If the GPU cannot do the work.
        InputError
            If the width is not dof, an entry is not finite, an array on the GPU has the wrong type or layout or is on a
            different GPU, or pieces are smaller than 1e-3 m or larger than 1e3 m.
        UnknownNameError, ConvergenceError
            As for `CollisionChecker.collide`.
        """
        there = is_on_gpu(Q)
        checked = None if there else self._checker.robot.checked(Q)

        def on_gpu() -> Any:
            gpu = driver.opened(self._number)
            if checked is None:
                return self._of_array(gpu, Q)
            out = self._of_host(gpu, checked.reshape(math.prod(checked.shape[:-1]), checked.shape[-1]))
            return bool(out[0]) if checked.ndim == 1 else out.reshape(checked.shape[:-1])

        def on_cpu() -> Any:
            return self._checker.collide(Q)

        return attempted(on_gpu, on_cpu if self._instead and not there else None)

    # -- inside -------------------------------------------------------------------------------

    def _of_host(self, gpu: Device, Q: Floats) -> NDArray[np.bool_]:
        """Decide configurations in CPU memory, shape (N, dof)."""
        ready = prepared_of(self._checker)
        with np.errstate(over="ignore"):  # infinite, and then left to the CPU
            there = gpu.upload(Q.astype(np.float32))
        verdicts, left = self._asked(gpu, ready, there.address, len(Q))
        out = np.empty(len(Q), dtype=np.int8)
        gpu.download(verdicts.address, out)
        out[left] = self._settled(ready, Q[left])
        return np.asarray(out == codes.COLLIDING)

    def _of_array(self, gpu: Device, Q: Any) -> DeviceArray:
        """Decide configurations in GPU memory."""
        view, robot, ready = taken(Q, "Q", gpu), self._checker.robot, prepared_of(self._checker)
        if len(view.shape) == 0 or view.shape[-1] != robot.dof:
            raise InputError(f"Q: expected shape (..., {robot.dof}), found {_validate.shape_text(view.shape)}")
        verdicts, left = self._asked(gpu, ready, view.address, math.prod(view.shape[:-1]))
        settled = self._settled(ready, robot.checked(gathered(gpu, view.address, robot.dof, left)))
        scattered(gpu, left, settled, verdicts)
        return DeviceArray(verdicts, view.shape[:-1], np.bool_)

    def _settled(self, ready: Problem, Q: Floats) -> NDArray[np.int8]:
        """Let the checker decide the given configurations, in the state of the scene that the GPU used."""
        if len(Q) == 0:
            return np.empty(0, dtype=np.int8)
        Q = np.ascontiguousarray(Q)
        found, _ = classified(ready, codes.EXACT, Q)
        expect_settled(ready, Q, found)
        return found

    def _asked(self, gpu: Device, ready: Problem, Q: int, total: int) -> tuple[Memory, Ints]:
        """Return the verdicts of configurations at an address, and the indices of those that are left to the CPU."""
        expect_few(total, "configurations")
        tables = self._tables_of(gpu, ready)
        expect_few(tables.pair_count * TILE, "pairs of bodies, times 16384,")
        verdicts, left = gpu.memory(total), Left(gpu, total)
        tile = _tile(gpu, tables)
        for first in range(0, total, TILE):
            self._run(gpu, tables, tile, Q, first, min(TILE, total - first), verdicts, left)
        return verdicts, left.numbers()

    def _run(
        self, gpu: Device, tables: _Tables, tile: _Tile, Q: int, first: int, count: int, verdicts: Memory, left: Left
    ) -> None:
        """Run the kernels on one tile, one after the other."""
        dof, t = self._checker.robot.dof, tables
        gpu.clear(tile.state.address, 4 * TILE)
        gpu.clear(tile.survivors.address, 4)
        gpu.launch(
            "place_links", count, TILE, Q + 4 * dof * first, dof, t.links, t.joints.address, t.constants.address,
            tile.placed.address,
        )  # fmt: skip
        gpu.launch(
            "place_body", t.moving * TILE, TILE, LOG_TILE, tile.placed.address, t.bodies.address, t.balls.address,
            t.rows.address, tile.bounds.address,
        )  # fmt: skip
        gpu.launch(
            "cull_pair", t.pair_count * TILE, TILE, LOG_TILE, count, t.moving, t.pairs.address, t.margins.address,
            tile.bounds.address, t.standing.address, tile.state.address, tile.survivors.address, tile.capacity,
        )  # fmt: skip
        gpu.launch(
            "certify_survivor", tile.capacity, TILE, LOG_TILE, t.moving, t.bodies.address, t.pairs.address,
            t.margins.address, tile.placed.address, tile.bounds.address, t.rows.address, tile.state.address,
            tile.survivors.address, tile.capacity,
        )  # fmt: skip
        gpu.launch("conclude", count, first, tile.state.address, verdicts.address, left.list.address)

    def _tables_of(self, gpu: Device, ready: Problem) -> _Tables:
        """Return the kernels' input, copied to the GPU again if the scene has changed."""
        tables = self._tables.get(gpu)
        if tables is None or tables.version != ready.version:
            tables = self._tables[gpu] = _tables(gpu, ready)
        return tables


def _tile(gpu: Device, tables: _Tables) -> _Tile:
    """Allocate the kernel output for a tile."""
    capacity = TILE * max(1, min(SURVIVORS, tables.pair_count))
    return _Tile(
        gpu.memory(4 * columns.LINK_NUMBERS * tables.links * TILE),
        gpu.memory(4 * columns.BOUNDS * tables.moving * TILE),
        gpu.memory(4 * TILE),
        gpu.memory(4 * (1 + capacity)),
        capacity,
    )


def _tables(gpu: Device, ready: Problem) -> _Tables:
    """Copy the kernels' input about a robot and its scene to the GPU."""
    tree, packed, moving = ready.robot.tree, ready.packed, len(ready.link)
    start = packed.piece_start
    rows = single_rows(packed).copy()
    rows[start[moving] :] = ready.standing.rows

    joints = np.zeros((len(tree.parent), columns.LINK_INTEGERS), dtype=np.int32)
    joints[:, columns.PARENT_OF_LINK], joints[:, columns.KIND_OF_LINK] = tree.parent, tree.kind
    joints[:, columns.COLUMN_OF_LINK] = tree.column
    constants = np.zeros((len(tree.parent), columns.LINK_CONSTANTS))
    constants[:, : columns.CONSTANTS] = tree.constants
    constants[:, columns.MULTIPLIER], constants[:, columns.OFFSET] = tree.multiplier, tree.offset

    bodies = np.zeros((len(start) - 1, columns.BODY_INTEGERS), dtype=np.int32)
    bodies[:moving, columns.LINK_OF_BODY] = ready.link
    bodies[:, columns.FIRST_PIECE], bodies[:, columns.LAST_PIECE] = start[:-1], start[1:]
    balls = np.zeros((moving, columns.BALL_NUMBERS))
    balls[:, :5] = ready.balls
    balls[:, [columns.BALL_RADIUS, columns.BALL_REACH]] *= tolerances.UP
    with np.errstate(over="ignore"):  # infinite, and then left to the CPU
        floats = [x.astype(np.float32) for x in (constants, balls, ready.margins * tolerances.UP)]
    return _Tables(
        version=ready.version,
        moving=moving,
        pair_count=len(ready.pairs),
        links=len(tree.parent),
        joints=gpu.upload(joints),
        constants=gpu.upload(floats[0]),
        bodies=gpu.upload(bodies),
        balls=gpu.upload(floats[1]),
        rows=gpu.upload(rows),
        pairs=gpu.upload(ready.pairs.astype(np.int32)),
        margins=gpu.upload(floats[2]),
        standing=gpu.upload(ready.standing.bounds),
    )
