"""Mobile bases of a polygon: their body is the polygon with a height, and they plan on maps."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from loewner import Body, CollisionChecker, InputError, Robot, Scene, Verdict, collide, planners
from sampling import examples

BOX = [[0.3, 0.2], [-0.3, 0.2], [-0.3, -0.2], [0.3, -0.2]]
U = [(0, 0), (3, 0), (3, 3), (2, 3), (2, 1), (1, 1), (1, 3), (0, 3)]


def at(x, y, z):
    T = np.eye(4)
    T[:3, 3] = x, y, z
    return T


def inside(polygon, x, y):
    """By the number of sides that a ray to the right crosses."""
    p, q = np.asarray(polygon, float), np.roll(polygon, -1, axis=0)
    crosses = (p[:, 1] > y) != (q[:, 1] > y)
    with np.errstate(divide="ignore", invalid="ignore"):
        where = p[:, 0] + (y - p[:, 1]) / (q[:, 1] - p[:, 1]) * (q[:, 0] - p[:, 0])
    return bool((crosses & (where > x)).sum() % 2)


@examples(5, 15)
@given(st.integers(0, 10_000), st.booleans())
def test_the_body_is_the_polygon_with_its_height(seed, turned):
    """Points of stars with random radii are in the body if they are in the polygon and below its height."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(3, 12))
    angles = np.sort(rng.uniform(0.1, 1.0, n).cumsum())
    angles *= 2 * np.pi / (angles[-1] + 0.5)
    polygon = rng.uniform(0.5, 1.5, (n, 1)) * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    body = Robot.footprint(polygon[::-1] if turned else polygon, height=0.4).bodies["footprint"]
    for x, y in rng.uniform(-1.6, 1.6, (40, 2)):
        assert collide(Body.sphere(1e-9), at(x, y, 0.2), body, None) == inside(polygon, x, y)
        assert not collide(Body.sphere(1e-9), at(x, y, 0.41), body, None)


def test_pieces():
    """A convex polygon is one piece, and a U is not its hull."""
    assert len(Robot.footprint(BOX, height=1.0).bodies["footprint"].pieces) == 1
    body = Robot.footprint(U, height=1.0).bodies["footprint"]
    assert not collide(Body.sphere(0.1), at(1.5, 2.5, 0.5), body, None)


def test_a_base_goes_through_a_door(tmp_path):
    """A plan on a map is proven, and turns the base where it is too wide."""
    pixels = np.full((30, 40), 254, "u1")
    pixels[:, 20] = 0
    pixels[12:18, 20] = 254  # 0.6 m wide
    (tmp_path / "map.pgm").write_bytes(b"P5 40 30 255\n" + pixels.tobytes())
    (tmp_path / "map.yaml").write_text(
        "image: map.pgm\nresolution: 0.1\norigin: [0, 0, 0]\nnegate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.196\n"
    )
    checker = CollisionChecker(
        Robot.footprint([[0.2, 0.4], [-0.2, 0.4], [-0.2, -0.4], [0.2, -0.4]], height=0.5, bounds=[[0, 4], [0, 3]]),
        Scene.from_map(tmp_path / "map.yaml", height=1.0),
    )
    path = planners.plan(checker, [1.0, 1.5, 0.0], [3.2, 1.5, 0.0], seed=1)
    assert (checker.certify_edges(path[:-1], path[1:]).verdict == Verdict.FREE).all()
    assert checker.collide([2.05, 1.5, 0.0])
    assert not checker.collide([2.05, 1.5, np.pi / 2])


@pytest.mark.parametrize(
    ("polygon", "height", "text"),
    [
        ([[0, 0], [1, 0]], 1.0, "polygon: expected at least three corners around an area, found 2"),
        ([[0, 0], [1, 0], [2, 0]], 1.0, "polygon: expected at least three corners around an area"),
        ([[0, 0], [2, 2], [2, 0], [0, 1]], 1.0, "polygon: expected one that does not cross itself"),
        ([[0, 0, 0], [1, 0, 0], [0, 1, 0]], 1.0, "polygon: expected shape"),
        (np.zeros((5001, 2)), 1.0, "polygon: expected at most 5000 corners, found 5001"),
        (BOX, 0.0, "height"),
        (BOX, np.nan, "height"),
    ],
)
def test_bad_input(polygon, height, text):
    """Each error names what was expected and what was found."""
    with pytest.raises(InputError, match=text):
        Robot.footprint(polygon, height=height)


def test_a_thin_spike_on_a_large_platform_stays():
    """No part is dropped because it is small beside the whole."""
    spike = [[0, 0], [100, 0], [100, 49.999925], [100.1, 50], [100, 50.000075], [100, 100], [0, 100]]
    body = Robot.footprint(spike, height=1.0).bodies["footprint"]
    assert collide(Body.sphere(0.04), at(100.05, 50, 0.5), body, None)


@pytest.mark.parametrize(
    "polygon",
    [
        [[0, 0], [1, 0], [1, 0.5], [3, 0.5], [1, 0.5], [1, 1], [0, 1]],
        [[-1, 0], [3, 0], [0, -1], [-2, 1]],
        [[0, 0], [2, 0], [2, 2], [1, 0], [0, 2]],
        [[0, 0], [2, 2], [0, 2], [2, 0]],
    ],
)
def test_sides_that_meet_are_refused(polygon):
    """Antennas without a width, crossings, and corners on other sides."""
    with pytest.raises(InputError, match="polygon: expected"):
        Robot.footprint(polygon, height=1.0)
