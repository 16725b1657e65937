"""Prove straight motions of a robot on a GPU."""

from __future__ import annotations

from loewner._base._validate import Ints
from loewner.gpu.driver import Device, Memory
from loewner.gpu.tables import Tables
from loewner.gpu.tiles import Tile, check, place, room_for
from loewner.gpu.work import Left, length_of

# MOTIONS limits how many motions have their intervals in one list. BENDS limits the number of bounds on their
# curvature; if there are many chains of joints, BENDS reduces the number of motions.
MOTIONS, BENDS = 1 << 18, 1 << 26

INTERVALS = 64  # entries of a list per motion; the probes of a motion need at least two


def slots(count: int) -> int:
    """Return how many configurations are placed together at first for `count` motions."""
    return 4 * count


def certified(
    gpu: Device, tables: Tables, tile: Tile, dof: int, ends: tuple[int, ...], total: int
) -> tuple[Memory, Ints]:
    """Return verdicts of motions whose ends are at two addresses, and the indices of motions left to the CPU."""
    verdicts, left = gpu.memory(total), Left(gpu, total)
    run = _Run(gpu, tables, dof, tile, max(1, min(total, MOTIONS, BENDS // max(1, tables.chains))))
    for first in range(0, total, run.most):
        count = min(run.most, total - first)
        Q0, Q1 = (end + 4 * dof * first for end in ends)
        run.prove(Q0, Q1, count)
        gpu.launch("conclude", count, first, run.state, dof, Q0, Q1, verdicts, left.list)
    return verdicts, left.numbers()


class _Run:
    """The proofs of several motions, with their memory on the GPU.

    Intervals without a proof are halved until none is left.
    """

    def __init__(self, gpu: Device, tables: Tables, dof: int, tile: Tile, most: int) -> None:
        self._gpu, self._tables, self._dof, self._tile, self.most = gpu, tables, dof, tile, most
        self._room = INTERVALS * most
        self.state = gpu.memory(4 * most)
        self._bends, self._flags = gpu.memory(4 * tables.chains * most), gpu.memory(2 * tile.most)
        self._items, self._halves = (gpu.memory(4 * (1 + 2 * self._room)) for _ in range(2))
        self._Q, self._spans = (gpu.memory(4 * dof * tile.most) for _ in range(2))

    def prove(self, Q0: int, Q1: int, count: int) -> None:
        """Compute the states of `count` motions."""
        gpu, t, bends = self._gpu, self._tables, self._bends
        gpu.clear(self.state.address, 4 * count)
        gpu.launch("bound_motion", t.chains * self.most, self.most, count, self._dof, Q0, Q1, t.cell, bends)
        self._probe(Q0, Q1, count)
        gpu.clear(self._items.address, 4)
        gpu.launch("begin_motion", count, self.most, t.moving, bends, self.state, self._items, self._room)
        listed = min(length_of(gpu, self._items), self._room)
        while listed > 0:
            gpu.clear(self._halves.address, 4)
            for first in range(0, listed, self._tile.most // 2):
                self._halve(Q0, Q1, self._items.address + 4 + 8 * first, min(self._tile.most // 2, listed - first))
            self._items, self._halves = self._halves, self._items
            listed = min(length_of(gpu, self._items), self._room)

    def _probe(self, Q0: int, Q1: int, count: int) -> None:
        """Check each motion at four configurations, which reveal most collisions."""
        gpu, tile = self._gpu, self._tile
        gpu.launch("list_probe", 2 * count, self._items.address + 4)
        for first in range(0, 2 * count, tile.most // 2):
            listed, items = min(tile.most // 2, 2 * count - first), self._items.address + 4 + 8 * first
            self._place(Q0, Q1, items, listed)
            check(gpu, self._tables, tile, 2 * listed)
            gpu.launch("strike_motion", 2 * listed, items, tile.state, self.state)

    def _place(self, Q0: int, Q1: int, items: int, count: int) -> None:
        """Place the robot at both ends of intervals."""
        self._gpu.launch("place_end", 2 * count * self._dof, self._dof, Q0, Q1, items, self._Q, self._spans)
        place(self._gpu, self._tables, self._tile, self._Q.address, self._spans.address, self._dof, 2 * count)

    def _halve(self, Q0: int, Q1: int, items: int, count: int) -> None:
        """Try to prove the intervals of a tile, and list the halves of intervals without a proof."""
        gpu, t, tile, state, flags = self._gpu, self._tables, self._tile, self.state, self._flags
        bends, survivors, searches = self._bends, tile.survivors, tile.searches
        S, log_S = room_for(2 * count)
        gpu.clear(flags.address, 4 * count)
        gpu.clear(survivors.address, 4)
        gpu.clear(searches.address, 4)
        self._place(Q0, Q1, items, count)
        gpu.launch(
            "cull_interval", t.pair_count * (S // 2), S, log_S, self.most, count, t.cell, items, tile.bounds,
            t.standing, bends, state, survivors, tile.capacity, flags,
        )  # fmt: skip
        gpu.launch(
            "certify_interval", min(tile.capacity, t.pair_count * count), S, log_S, self.most, t.cell, items,
            tile.placed, bends, state, survivors, searches, tile.capacity, flags,
        )  # fmt: skip
        gpu.launch(
            "search_interval", min(tile.capacity, t.piece_pairs * count), S, log_S, self.most, t.cell, items,
            tile.placed, bends, state, searches, tile.capacity, flags,
        )  # fmt: skip
        gpu.launch("halve_interval", count, items, state, flags, self._halves, self._room)
