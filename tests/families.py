"""Families of random convex pieces, and pairs of them at poses near contact. Same seed, same data."""

from collections.abc import Callable

import numba
import numpy as np

from oracles import Differences, HullPool, signed_distances

Maker = Callable[[np.random.Generator], np.ndarray]


def _ball(count: int) -> Maker:
    """Points uniform in the unit ball: 8, 20, 50 or 200 of them give 8 to about 80 hull vertices."""

    def make(rng: np.random.Generator) -> np.ndarray:
        x = rng.normal(size=(count, 3))
        x /= np.linalg.norm(x, axis=1, keepdims=True)
        return x * rng.uniform(size=(count, 1)) ** (1 / 3)

    return make


def box_corners(size: np.ndarray) -> np.ndarray:
    """The eight corners of a box of full edges `size` about the origin."""
    signs = np.array(np.meshgrid([-0.5, 0.5], [-0.5, 0.5], [-0.5, 0.5])).reshape(3, 8).T
    return signs * size


def _scaled(maker: Maker, scale: tuple[float, float, float]) -> Maker:
    return lambda rng: maker(rng) * scale


def _either(first: Maker, second: Maker) -> Maker:
    return lambda rng: first(rng) if rng.uniform() < 0.5 else second(rng)


def _box(rng: np.random.Generator) -> np.ndarray:
    return box_corners(rng.uniform(0.3, 1.5, size=3))


def _cube(rng: np.random.Generator) -> np.ndarray:
    return box_corners(np.ones(3))


def _tetrahedron(rng: np.random.Generator) -> np.ndarray:
    while True:
        x = _ball(4)(rng)
        edges = x[1:] - x[0]
        # Flat ones belong to the slivers.
        if abs(np.linalg.det(edges)) > 0.02:
            return x


def polygon(sides: int, radius: float = 1.0) -> np.ndarray:
    turn = 2 * np.pi * np.arange(sides) / sides
    return np.stack([radius * np.cos(turn), radius * np.sin(turn)], axis=1)


def prism(sides: int, height: float) -> np.ndarray:
    ring = polygon(sides)
    return np.concatenate([np.c_[ring, np.full(sides, z)] for z in (-0.5 * height, 0.5 * height)])


def pyramid(sides: int, height: float) -> np.ndarray:
    ring = polygon(sides)
    return np.concatenate([np.c_[ring, np.full(sides, -0.5 * height)], [[0, 0, 0.5 * height]]])


def _prism(rng: np.random.Generator) -> np.ndarray:
    return prism(int(rng.integers(3, 13)), rng.uniform(0.2, 2))


def _cone(rng: np.random.Generator) -> np.ndarray:
    return pyramid(int(rng.integers(8, 25)), rng.uniform(0.3, 2))


def _sliver(rng: np.random.Generator) -> np.ndarray:
    """A tetrahedron whose four corners lie within 1e-3 of a plane."""
    return rng.uniform(-1, 1, size=(4, 3)) * [1, 1, 1e-3]


def _mixed_scale(rng: np.random.Generator) -> np.ndarray:
    return _ball(20)(rng) * 10 ** rng.uniform(-3, 0)


def _nested(rng: np.random.Generator) -> np.ndarray:
    """Large ones and small ones, so that one of a pair fits deep into the other."""
    return _ball(20)(rng) * (1.0 if rng.uniform() < 0.5 else 0.05)


def _plate(s: float) -> Maker:
    scale = (1.0, 1.0, s)
    return _either(lambda rng: box_corners(np.array(scale)), _scaled(_ball(20), scale))


def _rod(s: float) -> Maker:
    scale = (1.0, s, s)
    return _either(lambda rng: box_corners(np.array(scale)), _scaled(_ball(20), scale))


EIGHT: dict[str, Maker] = {
    "ball 8": _ball(8),
    "ball 20": _ball(20),
    "ball 50": _ball(50),
    "ball 200": _ball(200),
    "boxes": _box,
    "plates 1:1:0.05": _plate(0.05),
    "rods 1:0.05:0.05": _rod(0.05),
    "tetrahedra": _tetrahedron,
}

MORE: dict[str, Maker] = {
    "cubes": _cube,
    "prisms": _prism,
    "cones": _cone,
    "needles 1:1e-3:1e-3": _rod(1e-3),
    "slivers": _sliver,
    "mixed scales": _mixed_scale,
    "one inside the other": _nested,
}

FAMILIES = {**EIGHT, **MORE}

# How far apart pairs are placed, see `near_contact`; long thin pieces must come closer to meet at all.
STRETCH = {
    "rods 1:0.05:0.05": (0.0, 0.65),
    "needles 1:1e-3:1e-3": (0.0, 0.03),
    "one inside the other": (0.0, 1.0),
}


def stretch(family: str) -> tuple[float, float]:
    return STRETCH.get(family, (0.0, 1.6))


def pieces(family: str, count: int, seed: int = 0) -> list[np.ndarray]:
    """`count` vertex arrays of one family, sizes within a factor of four of each other."""
    rng = np.random.default_rng([seed, sum(family.encode())])
    return [FAMILIES[family](rng) * 2 ** rng.uniform(-1, 1) for _ in range(count)]


def near_corners(count: int, seed: int = 0) -> list[np.ndarray]:
    """Points of `count` hulls, some 1e-4 to 1e-13 of the size apart: on a line up to rounding, repeated, or in planes.

    Qhull keeps most of them as corners, of triangles that are as short as they are near.
    """
    rng, made = np.random.default_rng([seed, 500]), []
    for k in range(count):
        size = 10 ** rng.uniform(-2, 0, size=3)
        base = rng.normal(size=(int(rng.integers(5, 10)), 3)) * size
        at, apart = base[rng.integers(len(base))], 10 ** rng.uniform(-13, -4)
        near = at + apart * size * rng.normal(size=(int(rng.integers(2, 6)), 3))
        if k % 4 == 0:
            along = apart * rng.uniform(-1, 1, size=(4, 1)) * (base[0] - base[1])
            near = at + along + 10 ** rng.uniform(-17, -12) * rng.normal(size=(4, 3))
        elif k % 4 == 1:
            grid = np.stack(np.meshgrid(*[np.linspace(-1, 1, 3)] * 3), axis=-1).reshape(-1, 3)
            base = (grid + apart * rng.normal(size=grid.shape)) * size
        elif k % 4 == 2:
            near = np.concatenate([near, base])
        made.append(np.concatenate([base, near]) + rng.normal(size=3) * (k % 3))
    return made


# A piece of a mug, as it was cut along planes. Corners 5 and 6 are 4e-10 m apart, and 7 to 9 are on a line up to
# rounding, 5e-10 and 1e-8 m apart.
CUT_FROM_A_MUG = np.array(
    [
        [0.07538595076687633, 0.0031788532150197335, 0.009580476814833053],
        [0.0753833982647521, 0.00318173566570714, 0.009596213680221961],
        [0.07536017204055201, 0.0032079642221012096, 0.009739409629114442],
        [0.07530797156274664, 0.0031218245811520076, 0.009748619813477135],
        [0.07528716634963958, 0.003140199962725163, 0.009865859236734508],
        [0.06365234887594322, 3.2895275917680553e-09, 0.023977271033950785],
        [0.063652348324368, 3.063578854515976e-09, 0.023977271407326053],
        [0.06304001851366138, 3.533631289389459e-09, 0.024589601390598525],
        [0.06304001813387002, 3.3786402518665516e-09, 0.02458960164815244],
        [0.06304000985482157, 1.0412061695431356e-18, 0.0245896072625543],
        [0.06259241510113418, -0.0002860702822192989, 0.02526281858005541],
        [0.06230106064191886, -0.00019240995935221585, 0.025480305314931343],
        [0.06182308814794367, -0.00031686596597814816, 0.026056433094811045],
        [0.061884110455525665, -0.0004772392493890746, 0.026121893334552775],
    ]
)


def rotations(rng: np.random.Generator, count: int) -> np.ndarray:
    """Uniform rotations, shape (count, 3, 3)."""
    q = rng.normal(size=(count, 4))
    q /= np.linalg.norm(q, axis=1, keepdims=True)
    w, x, y, z = q.T
    return np.stack(
        [
            np.stack([1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)], axis=-1),
            np.stack([2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)], axis=-1),
            np.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)], axis=-1),
        ],
        axis=1,
    )


def random_poses(rng: np.random.Generator, count: int, spread: float = 2.0) -> np.ndarray:
    """Uniform rotations with translations uniform in a cube, shape (count, 4, 4)."""
    T = np.tile(np.eye(4), (count, 1, 1))
    T[:, :3, :3] = rotations(rng, count)
    T[:, :3, 3] = rng.uniform(-spread, spread, size=(count, 3))
    return T


def translation(x: float = 0.0, y: float = 0.0, z: float = 0.0) -> np.ndarray:
    """The pose that moves by (x, y, z) and rotates nothing, shape (4, 4)."""
    T = np.eye(4)
    T[:3, 3] = x, y, z
    return T


def sizes(pool: HullPool) -> np.ndarray:
    """Largest distance of a vertex from the centroid, for each hull."""
    out = np.empty(pool.size)
    for k in range(pool.size):
        v = pool.vertices[pool.vertex_start[k] : pool.vertex_start[k + 1]]
        out[k] = np.linalg.norm(v - v.mean(axis=0), axis=1).max()
    return out


def near_contact(
    rng: np.random.Generator,
    a: HullPool,
    ia: np.ndarray,
    b: HullPool,
    ib: np.ndarray,
    *,
    grazing: float = 0.1,
    deep: float = 0.02,
    spread: float = 2.0,
    stretch: tuple[float, float] = (0.0, 1.6),
) -> tuple[np.ndarray, np.ndarray]:
    """Poses of pairs so that free, ambiguous and colliding are about a third each.

    The bodies lie along a random direction, a multiple in `stretch` of the sum of their supports
    apart (1 is where planes across that direction would touch). Of the pairs, the fraction `deep`
    has one centroid inside the other body, and `grazing` is moved along the separating axis to a
    gap of plus or minus 1e-12 to 1e-2 of the size.
    """
    count = len(ia)
    Ta, Tb = random_poses(rng, count, spread), random_poses(rng, count, spread)
    along = rng.normal(size=(count, 3))
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    reach, centre_a, centre_b = np.empty(count), np.empty((count, 3)), np.empty((count, 3))
    for p in range(count):
        A = a.vertices[a.vertex_start[ia[p]] : a.vertex_start[ia[p] + 1]] @ Ta[p, :3, :3].T
        B = b.vertices[b.vertex_start[ib[p]] : b.vertex_start[ib[p] + 1]] @ Tb[p, :3, :3].T
        centre_a[p], centre_b[p] = A.mean(axis=0), B.mean(axis=0)
        reach[p] = ((A - centre_a[p]) @ along[p]).max() - ((B - centre_b[p]) @ along[p]).min()
    factor = rng.uniform(*stretch, size=count)
    factor[rng.uniform(size=count) < deep] *= 0.05
    Tb[:, :3, 3] = Ta[:, :3, 3] + centre_a + (factor * reach)[:, None] * along - centre_b

    chosen = np.flatnonzero(rng.uniform(size=count) < grazing)
    gap, axis = signed_distances(a, ia[chosen], Ta[chosen], b, ib[chosen], Tb[chosen])
    wanted = rng.choice([-1, 1], size=len(chosen)) * 10 ** rng.uniform(-12, -2, size=len(chosen))
    wanted *= np.minimum(sizes(a)[ia[chosen]], sizes(b)[ib[chosen]])
    Tb[chosen, :3, 3] += (wanted - gap)[:, None] * axis
    return Ta, Tb


@numba.njit(cache=True, error_model="numpy")
def _place(normals, offsets, start, turns, inside, pair, toward, along, gap, size, Ta, Tb):
    for p in range(pair.shape[0]):
        k = pair[p]
        u, c = toward[p], inside[k]
        reach, face = np.inf, start[k]
        for f in range(start[k], start[k + 1]):
            speed = normals[0, f] * u[0] + normals[1, f] * u[1] + normals[2, f] * u[2]
            if speed > 0.0:
                left = offsets[f] - normals[0, f] * c[0] - normals[1, f] * c[1] - normals[2, f] * c[2]
                if left < reach * speed:
                    reach, face = left / speed, f
        for r in range(3):
            Tb[p, r, 3] = Ta[p, r, 3]
        for m in range(3):
            d = c[m] + along[p] * reach * u[m] + gap[p] * size[k] * normals[m, face]
            for r in range(3):
                Tb[p, r, 3] += Ta[p, r, m] * d
        for r in range(3):
            for m in range(3):
                Tb[p, r, m] = 0.0
                for q in range(3):
                    Tb[p, r, m] += Ta[p, r, q] * turns[k, q, m]


def posed_near_contact(
    rng: np.random.Generator,
    faces: Differences,
    pair: np.ndarray,
    *,
    along: tuple[float, float] = (0.0, 2.2),
    grazing: float = 0.25,
    deep: float = 0.02,
    spread: float = 2.0,
) -> tuple[np.ndarray, np.ndarray]:
    """Poses of pairs whose difference is known: millions a minute, each at a turn and a place of its own in the world.

    From where the centroids coincide b goes a random way, `along` times as far as where the two just touch. The
    fraction `deep` goes a twentieth of that; `grazing` goes to contact and from there, square to the faces or edges
    that touch, to a gap or an overlap of 2e-14 to 1e-1 of the size; one in a thousand of these to less, where only
    rational arithmetic can judge.
    """
    count = len(pair)
    toward = rng.normal(size=(count, 3))
    toward /= np.linalg.norm(toward, axis=1, keepdims=True)
    factor, gap, kind = rng.uniform(*along, size=count), np.zeros(count), rng.uniform(size=count)
    factor[kind < deep] *= 0.05
    graze = kind > 1 - grazing
    factor[graze] = 1.0
    exponent = rng.uniform(-13.7, -1, size=graze.sum())
    exponent[rng.uniform(size=len(exponent)) < 1e-3] -= 13
    gap[graze] = rng.choice([-1, 1], size=len(exponent)) * 10**exponent
    Ta, Tb = random_poses(rng, count, spread), np.tile(np.eye(4), (count, 1, 1))
    _place(*faces[:5], pair, toward, factor, gap, faces.size, Ta, Tb)
    return Ta, Tb


def rotation(rng: np.random.Generator, n: int) -> np.ndarray:
    """An orthogonal matrix."""
    return np.linalg.qr(rng.normal(size=(n, n)))[0]


def affine(rng: np.random.Generator, n: int) -> tuple[np.ndarray, np.ndarray]:
    """An invertible map of condition up to 100, and a shift."""
    stretch = np.exp(rng.uniform(-2.3, 2.3, size=n))
    return rotation(rng, n) @ np.diag(stretch) @ rotation(rng, n), rng.uniform(-3, 3, size=n)
