"""Memory of a GPU for a tile of configurations, and their placement."""

from __future__ import annotations

from typing import NamedTuple

from loewner._kernels import columns
from loewner.gpu.driver import Device, Memory
from loewner.gpu.tables import Tables

# Number of configurations in a tile, a power of two: as many as threads run on a large GPU, since each launch waits for
# its slowest thread.
LOG_TILE = 18
TILE = 1 << LOG_TILE
LEAST = 10  # the logarithm for few configurations

# Average number of pairs of bodies that bounds may leave open per configuration of a tile, and of pairs of pieces that
# ellipsoids may; the CPU gets the rest.
SURVIVORS = 32


class Tile(NamedTuple):
    """Kernel output for one tile of configurations; `shape` are the numbers of links and bodies it has room for."""

    shape: tuple[int, int]
    placed: Memory
    bounds: Memory
    state: Memory
    survivors: Memory
    searches: Memory
    capacity: int


def room_for(count: int) -> tuple[int, int]:
    """Number of configurations in a tile for `count` of them, at most TILE, and its logarithm."""
    log = max(LEAST, (count - 1).bit_length())
    return 1 << log, log


def place(gpu: Device, tables: Tables, tile: Tile, Q: int, spans: int, dof: int, count: int) -> None:
    """Place links and bodies at the configurations at an address."""
    t, (S, log_S) = tables, room_for(count)
    gpu.launch(
        "place_links", count, S, Q, spans, dof, t.links, t.joints.address, t.constants.address, tile.placed.address
    )
    gpu.launch(
        "place_body", t.moving * S, S, log_S, tile.placed.address, t.bodies.address, t.balls.address,
        t.rows.address, tile.bounds.address,
    )  # fmt: skip


def tile_of(gpu: Device, tables: Tables) -> Tile:
    """Allocate the kernel output for a tile."""
    capacity = TILE * SURVIVORS
    return Tile(
        (tables.links, tables.moving),
        gpu.memory(4 * columns.LINK_NUMBERS * tables.links * TILE),
        gpu.memory(4 * columns.BOUNDS * tables.moving * TILE),
        gpu.memory(4 * TILE),
        gpu.memory(4 * (1 + capacity)),
        gpu.memory(4 * (1 + 3 * capacity)),
        capacity,
    )


def check(gpu: Device, tables: Tables, tile: Tile, count: int) -> None:
    """Find the states of the first configurations of a tile, which have been placed."""
    t, (S, log_S) = tables, room_for(count)
    gpu.clear(tile.state.address, 4 * count)
    gpu.clear(tile.survivors.address, 4)
    gpu.clear(tile.searches.address, 4)
    gpu.launch(
        "cull_pair", t.pair_count * S, S, log_S, count, t.moving, t.pairs.address, t.margins.address,
        tile.bounds.address, t.standing.address, tile.state.address, tile.survivors.address, tile.capacity,
    )  # fmt: skip
    gpu.launch(
        "certify_survivor", min(tile.capacity, t.pair_count * count), S, log_S, t.moving, t.bodies.address,
        t.pairs.address, t.margins.address, tile.placed.address, tile.bounds.address, t.rows.address,
        tile.state.address, tile.survivors.address, tile.searches.address, tile.capacity,
    )  # fmt: skip
    gpu.launch(
        "search_survivor", min(tile.capacity, t.piece_pairs * count), S, log_S, t.cell.address,
        tile.placed.address, tile.state.address, tile.searches.address, tile.capacity,
    )  # fmt: skip
