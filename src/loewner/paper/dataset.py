"""Draw the paper's data set: pairs of hulls of twenty random points, with the second hull shifted along [1, 1, 1].

Two phrases of the paper are ambiguous. Points "sampled from a unit ball" may be uniform in radius or in volume, and the
shift "in the direction [1, 1, 1] by a random number" may use a vector of length 1 or sqrt(3). Uniform radius with the
unit vector is the default, since it reproduces the paper's share of collisions and its four exact classes
(docs/design/paper.md). Uniform volume is the second data set.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from loewner._base import _validate
from loewner._base._validate import Floats

POINTS_PER_BODY = 20
LARGEST_SHIFT = 2.0  # metres
BYTES_PER_PAIR = 4 * 8 * (2 * POINTS_PER_BODY * 3 + 1)  # uniform numbers, and three times as many temporarily
DATA_SETS = {"radius": "radius uniform in [0, 1]", "volume": "uniform in the volume of the ball"}


@dataclass(frozen=True, repr=False)
class DataSet(_validate.Brief):
    """Pairs of point clouds.

    Attributes
    ----------
    name : str
        Key of `DATA_SETS`.
    seed : int
    points_1, points_2 : ndarray, shape (pairs, 20, 3)
        Points in metres; the points of the second bodies are already shifted.
    shift : ndarray, shape (pairs,)
        Distance between the centers of the two balls, in metres.

    Examples
    --------
    >>> from loewner import paper
    >>> data = paper.sample(10)
    >>> len(data), data.points_1.shape, bool(data.shift.max() <= 2.0)
    (10, (10, 20, 3), True)
    """

    name: str
    seed: int
    points_1: Floats
    points_2: Floats
    shift: Floats

    def __len__(self) -> int:
        return len(self.shift)


def sample(pairs: int = 1000, seed: int = 0, dataset: str = "radius") -> DataSet:
    """Draw the data set; its first k pairs do not depend on the total number of pairs.

    Parameters
    ----------
    pairs : int
        Number of pairs, at least 1.
    seed : int
        Seed of the random numbers, at least 0.
    dataset : {"radius", "volume"}
        Distribution of the points in the unit ball: uniform in radius, or uniform in volume.

    Returns
    -------
    DataSet
        Points in metres.

    Raises
    ------
    InputError
        If `pairs` or `seed` is out of range, or the pairs do not fit into memory.
    UnknownNameError
        If the data set is neither "radius" nor "volume".

    Examples
    --------
    >>> from loewner import paper
    >>> small, large = paper.sample(5, seed=1), paper.sample(50, seed=1)
    >>> np.array_equal(small.points_2, large.points_2[:5])
    True
    """
    n, seed = _validate.whole_number(pairs, "pairs", 1), _validate.whole_number(seed, "seed", 0, _validate.LARGEST_SEED)
    _validate.choice(dataset, "dataset", DATA_SETS)
    _validate.fits_memory(n * BYTES_PER_PAIR, f"{n} pairs of hulls")
    # Each pair has its own row of numbers, so that a pair does not depend on the number of pairs.
    uniform = np.random.default_rng(seed).random((n, 2 * POINTS_PER_BODY * 3 + 1))
    balls = _points_in_ball(uniform[:, :-1].reshape(n, 2, POINTS_PER_BODY, 3), dataset)
    shift = LARGEST_SHIFT * uniform[:, -1]
    balls[:, 1] += (shift / np.sqrt(3.0))[:, None, None]
    return DataSet(dataset, seed, balls[:, 0].copy(), balls[:, 1].copy(), shift)


def _points_in_ball(uniform: Floats, dataset: str) -> Floats:
    """Map uniform triples, which determine radius, height and longitude, to points of the unit ball."""
    radius = uniform[..., 0] if dataset == "radius" else np.cbrt(uniform[..., 0])
    z = 2.0 * uniform[..., 1] - 1.0
    longitude = 2.0 * np.pi * uniform[..., 2]
    across = np.sqrt(1.0 - z * z)
    points: Floats = radius[..., None] * np.stack([across * np.cos(longitude), across * np.sin(longitude), z], axis=-1)
    return points
