"""Check configurations of a robot on a GPU."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from loewner._base import _validate
from loewner._base._guard import guarded
from loewner._base._validate import Floats, Ints
from loewner._kernels import codes, columns
from loewner.errors import InputError
from loewner.gpu import driver, motions
from loewner.gpu.arrays import DeviceArray, View, is_on_gpu, taken
from loewner.gpu.driver import Device, Memory
from loewner.gpu.pairs import single_rows
from loewner.gpu.tables import Tables, tables_of
from loewner.gpu.tiles import Tile, check, most_of, place, tile_of
from loewner.gpu.work import FALLBACKS, Left, attempted, expect_few, gathered, number_of, scattered
from loewner.robots import CollisionChecker
from loewner.robots.checker import prepared_of
from loewner.robots.checking import edges
from loewner.robots.checking.problem import Problem
from loewner.robots.checking.verdicts import classified, expect_settled
from loewner.robots.description.robot import expect_width
from loewner.robots.proofs.proofs import ProofOptions, prove_by_rules

KINDS = columns.FIXED, columns.REVOLUTE, columns.PRISMATIC

# An `Ask` function queries a GPU about rows at addresses; it returns the verdicts, and the indices of the rows that are
# left to the CPU. A `Settle` function returns the CPU's answers for these rows.
Ask = Callable[..., tuple[Memory, Ints]]
Settle = Callable[..., NDArray[np.int8]]


class Checker:
    """A collision checker on a GPU.

    The GPU places the robot, and compares bounds and ellipsoids. If the comparisons are inconclusive, the GPU runs
    exact searches. For about one configuration or motion in a thousand, single precision proves nothing; the
    `CollisionChecker` then decides on the CPU. The answers are therefore equal to the answers of the
    `CollisionChecker`.

    Parameters
    ----------
    checker : CollisionChecker
        The checker of the robot and its scene. The scene may change between calls.
    fallback : {"error", "cpu"}
        What to do if there is no GPU, its driver is too old, its memory is too small, or its work was lost. "error"
        raises an error; "cpu" warns once and uses the `CollisionChecker`.
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
        _validate.instance(checker, "checker", CollisionChecker)
        self._number = number_of(device)
        self._instead = _validate.choice(fallback, "fallback", FALLBACKS) == "cpu"
        if not np.isin(checker.robot.tree.kind, KINDS).all():
            raise InputError("checker: expected joints that turn or slide, found planar, floating or ball joints")
        self._checker = checker
        self._tables: dict[Device, Tables] = {}
        self._tiles: dict[Device, Tile] = {}
        self._lock = threading.Lock()  # protects tables and tiles

    def __repr__(self) -> str:
        return f"<loewner.gpu.Checker of {self._checker.robot.dof} joints on GPU {self._number}>"

    @guarded
    def collide(self, Q: Any) -> Any:
        """Decide exactly which configurations are in collision, with the same answers as `CollisionChecker.collide`.

        Parameters
        ----------
        Q : array_like or array on the GPU, shape (..., dof)
            The configurations. An array on the GPU must be float32 in C order; the answers then hold for exactly these
            float32 numbers.

        Returns
        -------
        bool, or ndarray of bool, shape (...), or DeviceArray of bool
            True for collisions; a `DeviceArray` if the configurations are on the GPU.

        Raises
        ------
        GpuError
            If the GPU cannot do the work.
        InputError
            If the width is not dof, or an entry is not finite; if an array on the GPU has the wrong type or layout, or
            is on a different GPU; if pieces are smaller than 1e-3 m or larger than 1e3 m; or if poses of the scene have
            errors.
        UnknownNameError, ConvergenceError
            As for `CollisionChecker.collide`.
        """
        ready, there = self._ready(), is_on_gpu(Q)
        checked = None if there else self._checker.robot.checked(Q)

        ask, settle = partial(self._asked, ready), partial(_settled, ready)

        def on_gpu() -> Any:
            gpu = driver.opened(self._number)
            if checked is None:
                return DeviceArray(*self._decided_there(gpu, {"Q": Q}, ask, settle), np.bool_)
            rows = checked.reshape(math.prod(checked.shape[:-1]), checked.shape[-1])
            out = self._decided_here(gpu, [rows], ask, settle) == codes.COLLIDING
            return bool(out[0]) if checked.ndim == 1 else out.reshape(checked.shape[:-1])

        on_cpu = partial(self._checker.collide, Q)
        return attempted(on_gpu, on_cpu if self._instead and not there else None)

    @guarded
    def certify_edges(self, Q0: Any, Q1: Any, *, tolerance: float = 1e-5) -> Any:
        """Prove which straight motions are free, with the same verdicts as `CollisionChecker.certify_edges`.

        Parameters
        ----------
        Q0, Q1 : array_like or array on the GPU, shape (..., dof)
            Ends of the motions, broadcast together. If one array is on the GPU, the other must be on the GPU, too, and
            both must be float32 arrays in C order with the same shape. The verdicts then hold for exactly these float32
            numbers.
        tolerance : float
            Distance in metres, used for the motions that are left to the CPU: a motion that comes within this distance
            of a collision may be AMBIGUOUS.

        Returns
        -------
        ndarray of int8, shape (...), or DeviceArray of int8
            FREE, COLLIDING or AMBIGUOUS for each motion; a `DeviceArray` if the ends are on the GPU.

        Raises
        ------
        GpuError
            If the GPU cannot do the work.
        InputError
            As for `collide` and for `CollisionChecker.certify_edges`; or if pairs may be in contact at the ends of
            motions (`Scene.leave`, `Scene.reach`).

        Notes
        -----
        A motion is cut into intervals. As on the CPU, a plane proves two bodies free in an interval if it separates
        them at both ends with enough room for the bend of the paths in between. All computations are in single
        precision, with bounds on the errors (docs/certified.md). The CPU decides the remaining motions, about one in a
        thousand; these motions come within a few hundredths of a millimetre of contact.

        Examples
        --------
        >>> import loewner
        >>> from loewner import Body, CollisionChecker, Robot, Scene, gpu
        >>> scene = Scene()
        >>> scene.add("post", Body.box([0.2, 0.2, 0.2]), [[1, 0, 0, 1], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
        >>> checker = CollisionChecker(Robot.from_urdf("arm.urdf"), scene)
        >>> goals = [[0.5, 1.57], [2.0, 1.57]]  # the post is in the way of the second
        >>> try:
        ...     verdicts = gpu.Checker(checker).certify_edges([0.0, 1.57], goals)
        ... except loewner.GpuError:
        ...     verdicts = checker.certify_edges([0.0, 1.57], goals).verdict
        >>> verdicts
        array([0, 1], dtype=int8)
        """
        tolerance = _validate.positive_scalar(tolerance, "tolerance")
        there = is_on_gpu(Q0), is_on_gpu(Q1)
        if there[0] != there[1]:
            raise InputError("Q0, Q1: expected both on the GPU or neither, found one there")
        ready = self._ready()
        if len(ready.ruled):
            raise InputError("expected no pairs that may be in contact at the ends of motions, found some")
        ends = None if there[0] else edges.ends(self._checker.robot, Q0, Q1)

        ask, settle = partial(self._asked_motions, ready), partial(_proven, ready, tolerance)

        def on_gpu() -> Any:
            gpu = driver.opened(self._number)
            if ends is None:
                return DeviceArray(*self._decided_there(gpu, {"Q0": Q0, "Q1": Q1}, ask, settle), np.int8)
            return self._decided_here(gpu, ends[:2], ask, settle).reshape(ends[2])

        def on_cpu() -> Any:
            return self._checker.certify_edges(Q0, Q1, tolerance=tolerance).verdict

        return attempted(on_gpu, on_cpu if self._instead and not there[0] else None)

    # -- inside -------------------------------------------------------------------------------

    def _ready(self) -> Problem:
        """Prepare the pairs for the scene's present state.

        Pieces that are too small or too large are refused even if there is no GPU.
        """
        ready = prepared_of(self._checker)
        if ready.given is not None:
            names = ", ".join(self._checker.scene.bounds)
            raise InputError(
                f"expected bodies at known poses on a GPU, found errors of poses ({names}); use the CollisionChecker, "
                "or give these bodies larger margins"
            )
        single_rows(ready.packed)
        return ready

    def _decided_here(self, gpu: Device, given: Sequence[Floats], ask: Ask, settle: Settle) -> NDArray[np.int8]:
        """Decide about the rows of one or two arrays in CPU memory; `settle` decides the rows that `ask` leaves."""
        with np.errstate(over="ignore"):  # infinite numbers are left to the CPU
            there = [gpu.upload(Q.astype(np.float32)) for Q in given]
        verdicts, left = ask(gpu, len(given[0]), *(memory.address for memory in there))
        out = np.empty(len(given[0]), dtype=np.int8)
        gpu.download(verdicts.address, out)
        if len(left):
            out[left] = settle(*(np.ascontiguousarray(Q[left]) for Q in given))
        return out

    def _decided_there(
        self, gpu: Device, given: dict[str, Any], ask: Ask, settle: Settle
    ) -> tuple[Memory, tuple[int, ...]]:
        """Decide about the rows of one or two arrays in GPU memory; return verdicts on the GPU, and their shape."""
        robot, views = self._checker.robot, [self._taken(gpu, Q, name) for name, Q in given.items()]
        shapes = [view.shape for view in views]
        if shapes[0] != shapes[-1]:
            raise InputError(f"expected {' and '.join(given)} of the same shape, found {shapes[0]} and {shapes[-1]}")
        verdicts, left = ask(gpu, math.prod(shapes[0][:-1]), *(view.address for view in views))
        if len(left):
            rows = [robot.checked(gathered(gpu, view.address, robot.dof, left)) for view in views]
            scattered(gpu, left, settle(*rows), verdicts)
        return verdicts, shapes[0][:-1]

    def _taken(self, gpu: Device, Q: Any, name: str) -> View:
        """Check configurations in GPU memory, and return their address."""
        view = taken(Q, name, gpu)
        expect_width(self._checker.robot, view.shape, name)
        return view

    def _asked(self, ready: Problem, gpu: Device, total: int, Q: int) -> tuple[Memory, Ints]:
        """Return the verdicts of configurations at an address, and the indices that are left to the CPU."""
        expect_few(total, "configurations")
        verdicts, left, dof = gpu.memory(total), Left(gpu, total), self._checker.robot.dof
        with self._lock:
            tables = self._tables_of(gpu, ready)
            tile = self._tile_of(gpu, tables, total)
            for first in range(0, total, tile.most):
                count, at = min(tile.most, total - first), Q + 4 * dof * first
                place(gpu, tables, tile, at, 0, dof, count)
                check(gpu, tables, tile, count)
                gpu.launch("conclude", count, first, tile.state, dof, at, at, verdicts, left.list)
            return verdicts, left.numbers()

    def _asked_motions(self, ready: Problem, gpu: Device, total: int, *ends: int) -> tuple[Memory, Ints]:
        """Return the verdicts of motions between two addresses, and the indices that are left to the CPU."""
        expect_few(total, "motions")
        with self._lock:
            tables = self._tables_of(gpu, ready)
            tile = self._tile_of(gpu, tables, motions.slots(total))
            return motions.certified(gpu, tables, tile, self._checker.robot.dof, ends, total)

    def _tile_of(self, gpu: Device, tables: Tables, count: int) -> Tile:
        """Return a tile for up to `count` configurations: the last call's tile, if it is large enough."""
        most, shape, tile = most_of(tables, count), (tables.links, tables.moving), self._tiles.get(gpu)
        if tile is None or tile.shape != shape or tile.most < most:
            tile = None
            self._tiles.pop(gpu, None)  # frees the old memory before new memory is allocated
            tile = self._tiles[gpu] = tile_of(gpu, tables, most)
        return tile._replace(most=most)

    def _tables_of(self, gpu: Device, ready: Problem) -> Tables:
        """Return the kernels' input, which is copied to the GPU again whenever the scene has changed."""
        tables = self._tables.get(gpu)
        if tables is None or tables.version != ready.version:
            tables = self._tables[gpu] = tables_of(gpu, ready)
        return tables


def _settled(ready: Problem, Q: Floats) -> NDArray[np.int8]:
    """Let the CPU decide configurations, for the state of the scene that the GPU used."""
    verdicts, _ = classified(ready, codes.EXACT, Q)
    expect_settled(ready, Q, verdicts)
    return verdicts


def _proven(ready: Problem, tolerance: float, a: Floats, b: Floats) -> NDArray[np.int8]:
    """Let the CPU prove motions, for the state of the scene that the GPU used."""
    answers = prove_by_rules(ready, a, b, ProofOptions(tolerance))
    answers.expect_short(a, b)
    return np.asarray(answers.verdicts, dtype=np.int8)
