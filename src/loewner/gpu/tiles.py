"""Allocate GPU memory for a tile of configurations, and place and check the robot at these configurations."""

from __future__ import annotations

from typing import NamedTuple

from loewner._kernels import columns
from loewner.gpu.driver import Device, Memory
from loewner.gpu.tables import Tables
from loewner.gpu.work import MOST, expect_few

# Base-2 logarithms of the largest and the smallest number of configurations in a tile. The largest number is the number
# of threads of a large GPU; since each launch waits for its slowest thread, smaller tiles would waste time.
LOG_TILE, LEAST = 18, 10

BYTES = 1 << 30  # limit on a tile's memory, which reduces the configurations in a tile for robots with very many links

# A tile has room for this many pairs per configuration, on average: pairs of bodies that bounds leave open, and also
# pairs of pieces that ellipsoids leave open. If the pairs of a configuration find no room, the CPU decides the
# configuration.
SURVIVORS = 32


class Tile(NamedTuple):
    """The kernels' output for up to `most` configurations; `shape` gives the numbers of links and moving bodies."""

    most: int
    shape: tuple[int, int]
    placed: Memory
    bounds: Memory
    state: Memory
    survivors: Memory
    searches: Memory
    capacity: int


def room_for(count: int) -> tuple[int, int]:
    """Return a power of two that is at least `count`, and its logarithm."""
    log = max(LEAST, (count - 1).bit_length())
    return 1 << log, log


def place(gpu: Device, tables: Tables, tile: Tile, Q: int, spans: int, dof: int, count: int) -> None:
    """Place links and bodies at the configurations that are stored at the address `Q`."""
    t, (S, log_S) = tables, room_for(count)
    gpu.launch("place_links", count, S, Q, spans, dof, t.links, t.joints, t.constants, tile.placed)
    gpu.launch("place_body", t.moving * S, S, log_S, tile.placed, t.bodies, t.balls, t.rows, tile.bounds)


def most_of(tables: Tables, count: int) -> int:
    """Return how many of `count` configurations a tile holds; very many pairs or links reduce this number."""
    each = 4 * (columns.LINK_NUMBERS * tables.links + columns.BOUNDS * tables.moving + 4 * SURVIVORS)
    log = min(LOG_TILE, room_for(count)[1])
    while log > LEAST and (tables.pair_count << log > MOST or each << log > BYTES):
        log -= 1
    expect_few(tables.pair_count << log, f"pairs of bodies, times {1 << log},")
    return 1 << log


def tile_of(gpu: Device, tables: Tables, most: int) -> Tile:
    """Allocate the memory of a tile."""
    capacity, placed, bounds = most * SURVIVORS, columns.LINK_NUMBERS * tables.links, columns.BOUNDS * tables.moving
    counts = placed * most, bounds * most, most, 1 + capacity, 1 + 3 * capacity
    at, boxes, state, survivors, searches = (gpu.memory(4 * count) for count in counts)
    return Tile(most, (tables.links, tables.moving), at, boxes, state, survivors, searches, capacity)


def check(gpu: Device, tables: Tables, tile: Tile, count: int) -> None:
    """Compute the states of the first `count` configurations of a tile, at which the robot has been placed."""
    t, (S, log_S) = tables, room_for(count)
    gpu.clear(tile.state.address, 4 * count)
    gpu.clear(tile.survivors.address, 4)
    gpu.clear(tile.searches.address, 4)
    gpu.launch(
        "cull_pair", t.pair_count * S, S, log_S, count, t.moving, t.pairs, t.margins, tile.bounds, t.standing,
        tile.state, tile.survivors, tile.capacity,
    )  # fmt: skip
    gpu.launch(
        "certify_survivor", min(tile.capacity, t.pair_count * count), S, log_S, t.moving, t.bodies, t.pairs, t.margins,
        tile.placed, tile.bounds, t.rows, tile.state, tile.survivors, tile.searches, tile.capacity,
    )  # fmt: skip
    gpu.launch(
        "search_survivor", min(tile.capacity, t.piece_pairs * count), S, log_S, t.cell, tile.placed, tile.state,
        tile.searches, tile.capacity,
    )  # fmt: skip
