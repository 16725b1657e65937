"""Which pairs collide where, and which of them need no check."""

import numpy as np
import pytest

from gantry import gantry
from loewner import Body, CollisionChecker, InputError, Robot, Scene, UnknownNameError, pairs_by_sampling

BALL = '<collision><origin xyz="{} 0 0"/><geometry><sphere radius="0.1"/></geometry></collision>'

# Balls of radius 0.1 about a turning base: "near" overlaps the base's always, "arm" sweeps over "post", and "far"
# reaches nothing. "bar" is joined to the base by a link without geometry.
CAROUSEL = (
    '<robot name="carousel"><link name="base">' + BALL.format(0) + "</link>"
    '<link name="hub"/><link name="near">' + BALL.format(0.15) + "</link>"
    '<link name="arm">' + BALL.format(0.8) + '</link><link name="post">' + BALL.format(-0.8) + "</link>"
    '<link name="far">' + BALL.format(3) + "</link>"
    + "".join(
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        '<axis xyz="0 0 1"/></joint>'
        for name, kind, parent, child in (
            ("j0", "fixed", "base", "post"),
            ("j1", "continuous", "base", "hub"),
            ("j2", "continuous", "hub", "arm"),
            ("j3", "continuous", "arm", "near"),
            ("j4", "continuous", "near", "far"),
        )
    )
    + "</robot>"
)  # fmt: skip


@pytest.fixture
def carousel(tmp_path):
    (tmp_path / "carousel.urdf").write_text(CAROUSEL)
    return Robot.from_urdf(tmp_path / "carousel.urdf")


def test_pairs_are_told_apart(carousel):
    """Adjacent by joints, always within reach, never within reach; what meets now and then is not in it."""
    assert pairs_by_sampling(carousel, 500) == {
        ("arm", "near"): "adjacent",
        ("far", "near"): "adjacent",
        ("base", "near"): "always",
        ("arm", "base"): "never",  # two moving joints apart, though the hub between them has no body
        ("arm", "far"): "never",
        ("base", "far"): "never",
        ("far", "post"): "never",
        ("near", "post"): "never",
    }


def test_what_collides_where_the_robot_is_free_overlaps_by_design(carousel):
    """The arm over the post, at half a turn."""
    q = carousel.configuration({"j1": np.pi})
    found = pairs_by_sampling(carousel, 500, known_free=q)
    assert found["arm", "post"] == "default"
    assert found["base", "near"] == "default"
    assert pairs_by_sampling(carousel, 500, known_free=[q, q]) == found
    found.pop(("arm", "post"))
    assert found.keys() == pairs_by_sampling(carousel, 500).keys()


def test_disabled_pairs_of_the_robot_do_not_matter(carousel):
    """Sampling finds the same pairs whatever the robot has disabled before."""
    found = pairs_by_sampling(carousel, 500)
    assert pairs_by_sampling(carousel.disabling([("arm", "post")]), 500) == found


def test_share_from_which_on_a_pair_always_collides(carousel):
    """The arm meets the post on 2 asin(0.1 / 0.8) / pi of its turn, 8 %."""
    assert ("arm", "post") not in pairs_by_sampling(carousel, 4000, always=0.1)
    assert pairs_by_sampling(carousel, 4000, always=0.06)["arm", "post"] == "always"


def test_disabling(carousel):
    """The pairs are not checked, in either order of their names, and the first robot is as it was."""
    found = pairs_by_sampling(carousel, 500)
    robot = carousel.disabling((b, a) for a, b in found)
    assert robot.disabled_pairs == found.keys()
    assert carousel.disabled_pairs == frozenset()
    assert {frozenset(pair) for pair in CollisionChecker(robot).checked_pairs} == {frozenset(("arm", "post"))}
    with pytest.raises(UnknownNameError, match="did you mean 'post'"):
        carousel.disabling([("arm", "pist")])


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"samples": 0}, "samples: expected an integer >= 1, found 0"),
        ({"samples": 2.5}, "samples: expected an integer"),
        ({"always": 1.5}, "always: expected a share"),
        ({"always": 0}, "always: expected"),
        ({"known_free": [0, 0]}, r"known_free: expected shape \(\.\.\., 4\)"),
    ],
)
def test_bad_options(carousel, options, message):
    """Every bad option is refused by its name, with what was expected."""
    with pytest.raises(InputError, match=message):
        pairs_by_sampling(carousel, **options)


def test_collide_by_pair_is_collide(tmp_path):
    """Any pair collides where the configuration does; one pair by geometry, all by `pairs`; batches keep shape."""
    urdf, srdf = gantry(tmp_path)
    scene = Scene()
    scene.add("wall", Body.box([0.1, 4.0, 1.0]))
    scene.add(
        "pole", Body.cylinder(0.05, 1.0), np.array([[1, 0, 0, 0.5], [0, 1, 0, 0.5], [0, 0, 1, 0], [0, 0, 0, 1.0]])
    )
    checker = CollisionChecker(Robot.from_urdf(urdf, srdf=srdf), scene)
    Q = checker.robot.random_configurations(3000, 1)
    hits = checker.collide_by_pair(Q.reshape(2, 1500, 3))
    assert hits.shape == (2, 1500, 4)
    hits = hits.reshape(3000, 4)
    np.testing.assert_array_equal(hits.any(axis=1), checker.collide(Q))
    at = checker.checked_pairs.index(("ball", "pole"))
    np.testing.assert_array_equal(hits[:, at], np.hypot(Q[:, 0] - 0.5, Q[:, 1] - 0.5) <= 0.15)
    for q, row in zip(Q[:50], hits, strict=False):
        np.testing.assert_array_equal(checker.collide_by_pair(q), row)
        named = {(c.name_a, c.name_b) for c in checker.pairs(q)}
        assert named == {pair for pair, hit in zip(checker.checked_pairs, row, strict=True) if hit}
    assert checker.collide_by_pair(Q[:0]).shape == (0, 4)
