"""Scenes: what the names stand for, which rules hold, and that queries by name agree with queries by body."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import loewner
from families import random_poses, translation
from loewner import Body, Contact, InputError, PoseError, Scene, UnknownNameError
from sampling import examples

SEEDS = st.integers(0, 2**32 - 1)


@pytest.fixture
def scene() -> Scene:
    """A unit box, and balls of radius 0.5 whose surfaces are 0.1 and 0.4 from it along x."""
    scene = Scene()
    scene.add("box", Body.box([1, 1, 1]))
    scene.add("near", Body.sphere(0.5), translation(1.1))
    scene.add("far", Body.sphere(0.5), translation(-1.4))
    return scene


def met(scene: Scene) -> list[tuple[str, str]]:
    return [(contact.name_a, contact.name_b) for contact in scene.pairs()]


def clutter(rng: np.random.Generator, n: int) -> Scene:
    """Bodies of several kinds, close together, with margins and allowed pairs."""
    makers = (
        lambda: Body.box(rng.uniform(0.1, 0.5, 3)),
        lambda: Body.sphere(rng.uniform(0.1, 0.3)),
        lambda: Body.cylinder(0.1, rng.uniform(0.1, 0.6)),
        lambda: Body.from_points(rng.uniform(-0.3, 0.3, (12, 3))),
        lambda: Body.union([Body.sphere(0.1), Body.box([0.6, 0.1, 0.1])]),
    )
    scene = Scene(margin=float(rng.choice([0.0, 0.05])))
    poses = random_poses(rng, n)
    poses[:, :3, 3] = rng.uniform(-0.8, 0.8, (n, 3))
    for k, T in enumerate(poses):
        margin = float(rng.uniform(0, 0.2)) if rng.random() < 0.3 else None
        scene.add(f"b{k}", makers[k % len(makers)](), T, margin=margin)
    for _ in range(n):
        a, b = (f"b{k}" for k in rng.choice(n, 2, replace=False))
        if rng.random() < 0.5:
            scene.allow(a, b)
        else:
            scene.set_margin(float(rng.uniform(0, 0.3)), a, b)
    return scene


@examples(8, 40)
@given(SEEDS)
def test_pairs_are_those_that_collide_one_by_one(seed):
    """A pair is reported exactly if it is not allowed and `collide` with its own margin says so."""
    scene = clutter(np.random.default_rng(seed), 9)
    names = scene.names
    expected = [
        (a, b)
        for i, a in enumerate(names)
        for b in names[i + 1 :]
        if tuple(sorted((a, b))) not in scene.allowed
        and loewner.collide(scene[a], scene.pose(a), scene[b], scene.pose(b), margin=scene.margin_of(a, b))
    ]
    assert met(scene) == expected
    assert scene.collide() == bool(expected)


@examples(16, 40)
@given(SEEDS)
def test_contacts_are_consistent(seed):
    """witness_b - witness_a = distance * normal, the normal is a unit vector, the distance that of the two bodies."""
    scene = clutter(np.random.default_rng(seed), 7)
    for c in scene.pairs():
        assert isinstance(c, Contact)
        np.testing.assert_allclose(c.witness_b - c.witness_a, c.distance * c.normal, atol=1e-9)
        assert abs(np.linalg.norm(c.normal) - 1) < 1e-9
        assert c.distance == scene.distance(c.name_a, c.name_b, exact=True).distance
        assert c.distance <= scene.margin_of(c.name_a, c.name_b) + 1e-12


@examples(8, 40)
@given(SEEDS, st.floats(0, 0.5))
def test_larger_margin_loses_no_pair(seed, more):
    """Margin monotone: what meets within a margin meets within a larger one."""
    scene = clutter(np.random.default_rng(seed), 7)
    before = set(met(scene))
    larger = scene.copy()
    larger.set_margin(scene.margin + more)
    for names, margin in scene.margins.items():
        larger.set_margin(margin + more, *names)
    assert before <= set(met(larger))


def test_touching_is_a_contact():
    """A box that stands on another, face to face, is reported, though its distance may round to above zero."""
    scene = Scene()
    scene.add("table", Body.box([1, 1, 0.1]), translation(z=0.35))
    scene.add("can", Body.box([0.1, 0.1, 0.3]), translation(z=0.55))
    assert met(scene) == [("table", "can")]
    assert abs(scene.pairs()[0].distance) < 1e-12


def test_lowered_margins_from_the_pair_then_the_bodies_then_the_scene(scene):
    """A lowered margin of a pair precedes the larger one of its bodies, and that, if lowered, precedes the scene's."""
    assert met(scene) == []
    scene.set_margin(0.2)
    assert met(scene) == [("box", "near")]
    scene.set_margin(0.5, "far")
    assert scene.margin_of("far", "box") == 0.5
    assert met(scene) == [("box", "near"), ("box", "far")]
    scene.set_margin(0.05, "box", lower=True)
    assert (scene.margin_of("box", "near"), scene.margin_of("box", "far")) == (0.05, 0.5)
    assert met(scene) == [("box", "far")]
    scene.set_margin(0.15, "near", "box")
    assert met(scene) == [("box", "near"), ("box", "far")]
    scene.set_margin(0.01, "near", "box", lower=True)
    scene.set_margin(0.3, "near")
    assert scene.margin_of("near", "box") == 0.01
    assert met(scene) == [("box", "far")]
    scene.set_margin(None, "near")
    scene.set_margin(None, "box", "near")
    scene.set_margin(None, "far")
    assert (scene.margins, scene.lowered) == ({("box",): 0.05}, {("box",)})
    assert met(scene) == []


def test_a_margin_is_not_lowered_by_accident():
    """The larger margin holds, whichever was set last, be it the scene's, a body's, a link's or a pair's."""
    scene = Scene(margin=0.05)
    scene.add("p", Body.sphere(1.0))
    scene.add("q", Body.sphere(1.0), translation(5), margin=0.01)
    scene.set_margin(0.001, "panda_hand")
    scene.set_margin(0.002, "p", "q")
    assert [scene.margin_of("p", other) for other in ("panda_hand", "q")] == [0.05, 0.05]
    scene.set_margin(0.001, "panda_hand", lower=True)
    assert scene.margin_of("p", "panda_hand") == 0.001
    assert scene.margin_of("q", "panda_hand") == 0.01  # what q keeps is not lowered by another's
    scene.set_margin(0.001, "panda_hand")
    assert scene.margin_of("p", "panda_hand") == 0.05


def test_links_have_margins_of_their_own(scene):
    """Margins against links hold for no two bodies, those among links for no body, and the scene's for no two links."""
    scene.set_margin(0.05)
    assert scene.margin_of("hand", "arm") == 0.0
    scene.set_margin(0.01, against="links")
    scene.set_margin(0.2, "hand", against="links")
    scene.set_margin(0.3, "near", against="links")
    pairs = ("hand", "arm"), ("tip", "arm"), ("box", "hand"), ("near", "hand"), ("near", "box")
    assert [scene.margin_of(*pair) for pair in pairs] == [0.2, 0.01, 0.05, 0.3, 0.05]
    scene.set_margin(0.0, "tip", against="links", lower=True)
    assert [scene.margin_of("tip", other) for other in ("arm", "hand", "box")] == [0.0, 0.2, 0.05]
    assert scene.margins == {(None, None): 0.01, ("hand", None): 0.2, ("near", None): 0.3, ("tip", None): 0.0}
    scene.remove("near")
    scene.set_margin(None, against="links")
    assert scene.margins == {("hand", None): 0.2, ("tip", None): 0.0}


NAMES = st.sampled_from(("a", "b", "c", "l", "m"))
# A margin and what it is for, as arguments of `set_margin`; a, b and c are bodies.
SETTINGS = st.tuples(
    st.sampled_from((0.0, 0.01, 0.02, 0.05)),
    st.one_of(
        st.just(((), {})),
        st.just(((), {"against": "links"})),
        NAMES.map(lambda name: ((name,), {})),
        NAMES.map(lambda name: ((name,), {"against": "links"})),
        st.lists(NAMES, min_size=2, max_size=2, unique=True).map(lambda pair: (sorted(pair), {})),
    ),
)


@given(st.lists(st.tuples(SETTINGS, st.booleans())), SETTINGS)
def test_only_lowering_lowers(settings, last):
    """One more margin, or a larger one for the same, makes no pair's smaller and, unless lowered, is what they keep."""
    scene = Scene(margin=0.02)
    for name in "abc":
        scene.add(name, Body.sphere(1.0))
    for (margin, (names, options)), lower in settings:
        scene.set_margin(margin, *names, **options, lower=lower)
    margin, (names, options) = last
    key = (None,) * (2 - len(names)) + tuple(names) if options else tuple(names)
    replaced = scene.margins.get(key[::-1] if options else key, 0.0) if key else scene.margin
    before = {(x, y): scene.margin_of(x, y) for x in "abclm" for y in "abclm" if x != y}
    lowered = scene.lowered
    scene.set_margin(max(margin, replaced), *names, **options)
    after = {pair: scene.margin_of(*pair) for pair in before}
    assert all(after[pair] >= kept for pair, kept in before.items())
    assert lowered - scene.lowered <= {key[::-1] if options else key}
    if len(names) == 2:
        assert after[tuple(names)] >= margin


def test_widening_raises_margins_of_bodies_only(scene):
    """After `widen`, a pair with a body keeps the larger of its old margin and the least one; two links keep theirs."""
    scene.set_margin(0.01)
    for lower, margin, *names in (
        (True, 0.05, "box"),
        (False, 0.3, "far"),
        (True, 0.0, "near", "far"),
        (True, 0.002, "wrist"),
        (False, 0.4, "hand"),
        (False, 0.02, "base"),
        (True, 0.0, "tip", "box"),
        (False, 0.07, "tip", "near"),
        (True, 0.03, "wrist", "near"),
    ):
        scene.set_margin(margin, *names, lower=lower)
    scene.set_margin(0.0, "far", against="links", lower=True)
    scene.set_margin(0.005, "base", against="links", lower=True)
    scene.set_margin(0.004, against="links")
    links = ("wrist", "hand", "tip", "base")
    with_bodies = [(a, b) for a in scene for b in (*scene, *links) if a != b]
    before = {pair: scene.margin_of(*pair) for pair in with_bodies}
    of_links = {pair: scene.margin_of(*pair) for pair in (("wrist", "hand"), ("wrist", "tip"), ("base", "tip"))}
    version = scene.structure_version
    scene.widen(0.1)
    assert {pair: scene.margin_of(*pair) for pair in with_bodies} == {p: max(m, 0.1) for p, m in before.items()}
    assert {pair: scene.margin_of(*pair) for pair in of_links} == of_links
    assert (scene.margin, scene.structure_version > version) == (0.1, True)


def test_added_margin_is_that_of_the_body(scene):
    """A margin given with a new body holds for all pairs of that body."""
    scene.add("shy", Body.sphere(0.5), translation(z=1.3), margin=0.35)
    assert met(scene) == [("box", "shy")]


def test_allow_and_forbid(scene):
    """An allowed pair is not reported until it is forbidden again, in either order of the names."""
    scene.move("near", translation(0.5))
    assert met(scene) == [("box", "near")]
    scene.allow("near", "box")
    assert scene.allowed == {("box", "near")}
    assert met(scene) == []
    assert not scene.collide()
    with pytest.raises(UnknownNameError, match=r"\(box, near\); found '\(bux, near\)' \(did you mean"):
        scene.forbid("near", "bux")
    scene.forbid("box", "near")
    assert met(scene) == [("box", "near")]


def test_removed_name_takes_its_rules_along(scene):
    """Another body under an old name may touch nothing, and keeps the scene's margin."""
    scene.allow("box", "near")
    scene.allow("box", "hand")
    scene.set_margin(0.3, "near")
    scene.set_margin(0.3, "near", "far")
    scene.remove("near")
    assert scene.names == ("box", "far")
    assert scene.margins == {}
    assert scene.allowed == {("box", "hand")}
    scene.add("near", Body.sphere(0.5), translation(0.9))
    assert met(scene) == [("box", "near")]


def test_a_body_is_replaced_where_it_is(scene):
    """Pose, order, margins and allowed pairs stay; what is asked next is asked of the new body."""
    scene.allow("box", "near")
    scene.set_margin(0.3, "near")
    scene.set_margin(0.2, "near", "far")
    before = scene.names, scene.allowed, scene.margins, scene.pose("near").tolist()
    version, ball = scene.version, Body.sphere(0.01)
    scene.replace("near", ball)
    assert scene["near"] is ball
    assert scene.version > version
    assert (scene.names, scene.allowed, scene.margins, scene.pose("near").tolist()) == before
    scene.forbid("box", "near")
    scene.set_margin(None, "near")
    met(scene)
    scene.replace("near", Body.sphere(30.0))
    assert ("box", "near") in met(scene)
    scene.replace("near", ball)
    assert ("box", "near") not in met(scene)


def test_what_hangs_on_a_link_is_replaced_there(scene):
    """It hangs on it as before."""
    scene.attach("near", "hand", translation(0.1), touch_links=["arm"])
    before = scene.attachments
    scene.replace("near", Body.sphere(0.3))
    assert scene.attachments == before
    with pytest.raises(UnknownNameError, match="attached body: expected one of near; found 'naer'"):
        before["naer"]


def test_only_what_is_there_is_replaced(scene):
    """By bodies alone; else nothing changes."""
    version = scene.version
    with pytest.raises(UnknownNameError, match="nobody"):
        scene.replace("nobody", Body.sphere(1))
    with pytest.raises(InputError, match="body of 'near': expected loewner.Body, found str"):
        scene.replace("near", "far")
    assert scene.version == version


def test_attached_bodies_leave_the_world(scene):
    """An attached body has no place in the world, and none of its pairs is reported until it is detached."""
    scene.move("near", translation(0.5))
    assert scene.collide()
    scene.attach("near", "hand", translation(z=0.1), touch_links=["right_finger", "left_finger"])
    assert scene.static_names == ("box", "far")
    assert scene.names == ("box", "near", "far")
    assert not scene.collide()
    held = scene.attachments["near"]
    assert (held.link, held.touch_links) == ("hand", ("hand", "left_finger", "right_finger"))
    np.testing.assert_array_equal(held.T_link_body, translation(z=0.1))
    for ask in (
        lambda: scene.move("near", translation(1)),
        lambda: scene.pose("near"),
        lambda: scene.distance("box", "near"),
        lambda: scene.move({"far": translation(5), "near": translation(1)}),
    ):
        with pytest.raises(InputError, match="'near': expected a body that stands in the world.*'hand'"):
            ask()
    np.testing.assert_array_equal(scene.pose("far"), translation(-1.4))
    scene.attach("near", "other_hand")
    assert scene.attachments["near"].touch_links == ("other_hand",)
    scene.detach("near", translation(0.6))
    assert scene.attachments == {}
    assert met(scene) == [("box", "near")]
    with pytest.raises(InputError, match="'near': expected an attached body"):
        scene.detach("near", translation())


def test_many_bodies_move_at_once_or_not_at_all(scene):
    """If one of many moves is faulty, no body moves."""
    with pytest.raises(UnknownNameError, match="did you mean 'far'"):
        scene.move({"near": translation(0.5), "fra": translation()})
    with pytest.raises(PoseError, match="T_world_body of 'far'"):
        scene.move({"near": translation(0.5), "far": np.zeros((4, 4))})
    np.testing.assert_array_equal(scene.pose("near"), translation(1.1))
    scene.move({"near": translation(0.5), "far": None})
    np.testing.assert_array_equal(scene.static_poses, [translation(), translation(0.5), translation()])


def test_versions_tell_of_every_change(scene):
    """`version` grows with each change; `structure_version` with each but those by `move`."""
    changes = (
        lambda: scene.add("new", Body.sphere(1.0), translation(9)),
        lambda: scene.attach("new", "hand"),
        lambda: scene.detach("new", translation(9)),
        lambda: scene.allow("new", "box"),
        lambda: scene.forbid("new", "box"),
        lambda: scene.set_margin(0.1),
        lambda: scene.set_margin(0.1, "new"),
        lambda: scene.remove("new"),
    )
    for change in changes:
        before = scene.version, scene.structure_version
        change()
        assert (scene.version, scene.structure_version) > before
        assert scene.structure_version > before[1]
    packed, before = scene.static_bodies, (scene.version, scene.structure_version)
    scene.move("box", translation(0.1))
    assert scene.version > before[0]
    assert scene.structure_version == before[1]
    assert scene.static_bodies is packed


def test_failed_changes_change_nothing(scene):
    """A refused change leaves the scene and its version as they were."""
    before = scene.version
    for change in (
        lambda: scene.add("box", Body.sphere(1.0)),
        lambda: scene.add("new", Body.sphere(1.0), margin=-1),
        lambda: scene.attach("near", "hand", np.zeros((4, 4))),
        lambda: scene.set_margin(float("nan"), "near"),
        lambda: scene.remove("new"),
    ):
        with pytest.raises(loewner.LoewnerError):
            change()
    assert scene.version == before
    assert scene.static_names == ("box", "near", "far")
    assert scene.margins == {}


def test_copies_part_ways(scene):
    """Changes of a copy do not reach the original."""
    scene.allow("box", "near")
    other = scene.copy()
    other.remove("near")
    other.move("far", translation(7))
    other.attach("box", "hand")
    assert scene.static_names == ("box", "near", "far")
    assert scene.allowed == {("box", "near")}
    np.testing.assert_array_equal(scene.pose("far"), translation(-1.4))


def test_poses_are_the_scenes_own(scene):
    """Neither what was handed in nor what is handed out is a way into the scene."""
    T = translation(0.3)
    scene.move("near", T)
    T[0, 3] = 5
    scene.pose("near")[0, 3] = 6
    np.testing.assert_array_equal(scene.pose("near"), translation(0.3))


def test_scene_is_a_collection_of_names(scene):
    """A scene has a length, iterates over its names, and is indexed by them."""
    assert len(scene) == 3
    assert list(scene) == ["box", "near", "far"]
    assert "near" in scene
    assert "nearer" not in scene
    assert isinstance(scene["box"], Body)


def test_empty_scenes_answer():
    """A scene with fewer than two bodies has no pairs and no collision."""
    scene = Scene()
    assert scene.pairs() == ()
    assert not scene.collide()
    scene.add("one", Body.sphere(1.0))
    assert scene.pairs() == ()
    scene.attach("one", "hand")
    assert scene.static_poses.shape == (0, 4, 4)
    assert scene.pairs() == ()


@pytest.mark.parametrize(
    ("wrong", "error", "message"),
    [
        (lambda s: Scene(margin=-1), InputError, "margin: expected a finite number >= 0, found -1"),
        (lambda s: s.add("box", Body.sphere(1.0)), InputError, "expected a new name, found 'box'"),
        (lambda s: s.add("", Body.sphere(1.0)), InputError, "name: expected a name, found ''"),
        (lambda s: s.add(3, Body.sphere(1.0)), InputError, "name: expected a name, found 3"),
        (lambda s: s.add("x", np.eye(4)), InputError, "body of 'x': expected loewner.Body, found ndarray"),
        (lambda s: s.add("x", Body.sphere(1.0), np.eye(3)), PoseError, "T_world_body of 'x': expected shape"),
        (lambda s: s.add("x", Body.sphere(1.0), np.eye(4)[None]), PoseError, r"expected shape \(4, 4\), found \(1,"),
        (lambda s: s.add("x", Body.sphere(1.0), np.full((4, 4), np.nan)), PoseError, "found NaN or inf"),
        (lambda s: s.remove("bxo"), UnknownNameError, "one of box, near, far; found 'bxo' .did you mean 'box'"),
        (lambda s: s["nothing at all"], UnknownNameError, "one of box, near, far; found 'nothing at all'$"),
        (lambda s: s.pose(["box"]), UnknownNameError, "body: expected one of"),
        (lambda s: s.move({"box": None}, np.eye(4)), InputError, "with a mapping"),
        (lambda s: s.attach("bxo", "hand"), UnknownNameError, "did you mean 'box'"),
        (lambda s: s.attach("box", None), InputError, "link: expected a name, found None"),
        (lambda s: s.attach("box", "hand", touch_links="finger"), InputError, "found one text, 'finger'"),
        (lambda s: s.attach("box", "hand", touch_links=[1]), InputError, "touch_links: expected a name, found 1"),
        (lambda s: s.allow("box", "box"), InputError, "found 'box' twice"),
        (lambda s: s.allow("box", 3), InputError, "b: expected a name, found 3"),
        (lambda s: s.set_margin("wide"), InputError, "margin: expected a number, found 'wide'"),
        (lambda s: s.set_margin(None), InputError, "whole scene, found None"),
        (lambda s: s.set_margin(1.0, b="box"), InputError, "with b = 'box'"),
        (lambda s: s.set_margin(1.0, "box", "near", against="links"), InputError, "against: expected none with a pair"),
        (lambda s: s.set_margin(1.0, "box", against="link"), UnknownNameError, "against: expected one of links"),
        (lambda s: s.set_margin(1.0, "box", lower="yes"), InputError, "lower: expected True or False"),
        (lambda s: s.distance("box", "nir"), UnknownNameError, "found 'nir'"),
    ],
)
def test_bad_input_is_named(scene, wrong, error, message):
    """Every bad argument is refused by a message that names it and what was found."""
    with pytest.raises(error, match=message):
        wrong(scene)


def test_long_lists_of_names_are_cut():
    """An error lists the first thirty of many names, and still suggests the nearest one."""
    scene = Scene()
    ball = Body.sphere(1.0)
    for k in range(200):
        scene.add(f"ball{k}", ball)
    with pytest.raises(UnknownNameError, match=r"ball0, .*ball29, and 170 more; found 'bal150' \(did you mean"):
        scene.remove("bal150")


def test_bounds_on_a_distance_hold_for_all_poses_within_the_error():
    """The lower bound was that of the given poses; the exact distance still is."""
    scene = Scene()
    scene.add("a", Body.box([1.0, 1.0, 1.0]))
    scene.add("b", Body.box([1.0, 1.0, 1.0]), translation(2.0))
    known = scene.distance("a", "b", exact=True)
    scene.move("b", translation(2.0), error=(0.9, 0.0))
    found = scene.distance("a", "b", exact=True)
    assert found.distance == known.distance
    assert found.lower == pytest.approx(known.lower - 0.9)
    assert found.upper == pytest.approx(known.upper + 0.9)
    scene.move("b", translation(1.11))
    assert found.lower <= scene.distance("a", "b", exact=True).distance <= found.upper
