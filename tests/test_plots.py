"""Figures of robots in scenes: what touches is red, nothing is left out."""

import numpy as np
import pytest
from matplotlib.colors import to_rgb
from mpl_toolkits.mplot3d.art3d import Poly3DCollection

from gantry import gantry
from loewner import Body, CollisionChecker, InputError, Robot, Scene, plots


@pytest.fixture
def checker(tmp_path):
    urdf, srdf = gantry(tmp_path)
    scene = Scene()
    scene.add("wall", Body.box([0.1, 4.0, 1.0]))
    scene.add("held", Body.box([0.05, 0.05, 0.05]))
    T = np.eye(4)
    T[2, 3] = 0.2
    scene.attach("held", "ball", T)
    return CollisionChecker(Robot.from_urdf(urdf, srdf=srdf), scene)


def colours(ax):
    """Hues of the flat pieces, in the order of drawing: rod, held, wall. Shading keeps the hue."""
    faces = [c.get_facecolor()[:, :3] for c in ax.collections if isinstance(c, Poly3DCollection)]
    brightest = [face[face.sum(axis=1).argmax()] for face in faces]
    return [face / face.max() for face in brightest]


def hue(colour):
    return np.array(to_rgb(colour)) / max(to_rgb(colour))


@pytest.mark.parametrize(
    ("q", "title", "red"),
    [
        ([-0.6, 0.0, np.pi], "free", [False, False, False]),
        ([-0.4, 0.0, 0.0], "colliding, 1 pair", [True, False, True]),
        ([0.0, 0.0, np.pi / 2], "colliding, 3 pairs", [True, True, True]),
    ],
)
def test_what_touches_is_red(checker, q, title, red):
    """The rod, the box that hangs on the ball, and the wall; the ball itself is round and shown by its ellipsoids."""
    ax = plots.configuration(checker, q)
    assert ax.get_title() == title
    usual = (plots.COLOURS[0], plots.COLOURS[0], plots.SCENE)
    expected = [hue(plots.COLLIDING if is_red else colour) for colour, is_red in zip(usual, red, strict=True)]
    np.testing.assert_allclose(colours(ax), expected, atol=1e-6)
    assert len(ax.collections) == 5  # and two of wires, for the ball


def test_all_of_it_is_in_the_frame(checker):
    ax = plots.configuration(checker, [-0.6, 0.0, np.pi])
    assert ax.get_xlim()[0] < -1.05
    assert ax.get_ylim()[0] <= -2
    assert ax.get_ylim()[1] >= 2


def test_one_configuration_only(checker):
    with pytest.raises(InputError, match=r"q: expected one configuration, shape \(3,\)"):
        plots.configuration(checker, np.zeros((2, 3)))
