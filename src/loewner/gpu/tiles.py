"""Memory of a GPU for a tile of configurations, and their placement."""

from __future__ import annotations

from typing import NamedTuple

from loewner._kernels import columns
from loewner.gpu.driver import Device, Memory
from loewner.gpu.tables import Tables

# Number of configurations in a tile, a power of two. A launch takes microseconds, and a large GPU has 270,000 threads.
LOG_TILE = 16
TILE = 1 << LOG_TILE

# Average number of pairs of bodies that bounds may leave open per configuration of a tile, and of pairs of pieces that
# ellipsoids may; the CPU gets the rest.
SURVIVORS = 32


class Tile(NamedTuple):
    """Kernel output for one tile of configurations."""

    placed: Memory
    bounds: Memory
    state: Memory
    survivors: Memory
    searches: Memory
    capacity: int


def place(gpu: Device, tables: Tables, tile: Tile, Q: int, spans: int, dof: int, count: int) -> None:
    """Place links and bodies at the configurations at an address."""
    t = tables
    gpu.launch(
        "place_links", count, TILE, Q, spans, dof, t.links, t.joints.address, t.constants.address, tile.placed.address
    )
    gpu.launch(
        "place_body", t.moving * TILE, TILE, LOG_TILE, tile.placed.address, t.bodies.address, t.balls.address,
        t.rows.address, tile.bounds.address,
    )  # fmt: skip


def tile_of(gpu: Device, tables: Tables) -> Tile:
    """Allocate the kernel output for a tile."""
    capacity = TILE * SURVIVORS
    return Tile(
        gpu.memory(4 * columns.LINK_NUMBERS * tables.links * TILE),
        gpu.memory(4 * columns.BOUNDS * tables.moving * TILE),
        gpu.memory(4 * TILE),
        gpu.memory(4 * (1 + capacity)),
        gpu.memory(4 * (1 + 3 * capacity)),
        capacity,
    )
