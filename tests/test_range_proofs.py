"""Proofs that pairs are never nearer than a margin over ranges: two checkers verify true ones and refuse false ones."""

import itertools
import json
import math
import struct
import subprocess

import numpy as np
import pytest

import loewner
import mechanisms
from families import translation
from loewner import Body, CollisionChecker, ConvergenceError, InputError, Proof, Scene, cli
from loewner.errors import FileError
from loewner.robots.proofs import range_proofs
from loewner.robots.proofs.proof_models import model_of as model_of_problem
from loewner.verify import Refused, verify
from mechanisms import ARM, BALL, HINGE_TOUCHES, ball, box, joint, link
from sampling import quick, quick_of
from test_pair_ranges import example_robot, refuted
from test_second_checker import agrees, compiled  # noqa: F401
from test_verify import ROD, TURNING, body, doubles, hull, plane, resealed, sealed
from test_verify import box as box_of
from test_verify import link as link_of
from test_verify import model as model_of

# -- proofs that the library writes -------------------------------------------------------------


def proven(robot, *pairs, **options):
    """The rows about some pairs, with their proof."""
    return robot.prove_pairs(list(pairs), cache=False, proof=True, **options)


def expect_stated(robot, found, both, **options):
    """Both checkers verify a proof, and the report has the pairs, margins and ranges of the rows."""
    assert both(found.proof.data)
    report = found.proof.verify()
    assert len(report.ranges) == len(found)
    for a, b, margin, ends in report.ranges:
        row = found[a, b]
        assert margin == row.margin
        assert [name for name, *_ in ends] == list(row.columns)
        assert [(low, high) for _, low, high, _ in ends] == list(
            zip(row.lower.tolist(), row.upper.tolist(), strict=True)
        )
    assert found.proof.model_hash == CollisionChecker(robot, **options).model_hash
    assert report.sizes["boxes"] >= len(found)
    return report


# Mechanisms with a pair, its options, and the value that collides just outside the range or the margin.
MECHANISMS = {
    "hinge": (mechanisms.hinge, ("crank", "frame"), {"limits": {"hinge": (-2.7, 2.7)}}),
    "hinge near contact": (
        mechanisms.hinge, ("crank", "frame"), {"limits": {"hinge": (-1.0, HINGE_TOUCHES - 1e-4)}},
    ),
    "a full turn": (
        lambda: mechanisms.hinge("continuous", None, 2 * BALL + 0.005), ("crank", "frame"), {"margin": 0.004},
    ),
    "gears": (lambda: mechanisms.gears(-1.0, math.pi), ("first", "second"), {}),
    "parallelogram": (mechanisms.parallelogram, ("frame", "coupler"), {"margin": 0.149}),
    "rack": (mechanisms.rack_and_pinion, ("frame", "rack"), {"limits": {"pinion": (-3.0, 9.9)}}),
}  # fmt: skip


@pytest.mark.parametrize("what", MECHANISMS)
def test_both_checkers_verify_mechanisms(what, agrees):  # noqa: F811
    """The proof of a mechanism has its range, and whether this is all of it."""
    make, pair, options = MECHANISMS[what]
    robot = make()
    found = proven(robot, pair, **options)
    report = expect_stated(robot, found, agrees)
    ((*_, ends),) = report.ranges
    assert all(whole for *_, whole in ends) == ("limits" not in options)
    assert ("NOT all of its range" in str(report)) == ("limits" in options)
    assert f"farther apart than {1000 * options.get('margin', 0.0):.12g} mm" in str(report)


@pytest.mark.filterwarnings("ignore:pairs that are exempt")
def test_both_checkers_verify_pairs_of_a_panda(agrees):  # noqa: F811
    """Pairs with one, two and three values between their bodies, in two kilobytes."""
    robot = example_robot("panda")
    pairs = ("panda_link0", "panda_link1"), ("panda_link2", "panda_link4"), ("panda_link1", "panda_link4")
    found = proven(robot, *pairs)
    report = expect_stated(robot, found, agrees)
    assert sorted(len(ends) for *_, ends in report.ranges) == [1, 2, 3]
    assert all(whole for *_, ends in report.ranges for *_, whole in ends)
    assert found.proof.size < 2000
    assert found.proof.differences(CollisionChecker(robot)) == []
    assert found.proof.verdict == loewner.Verdict.FREE
    with pytest.raises(InputError, match="expected motions, found ranges"):
        _ = found.proof.motions


@pytest.mark.filterwarnings("ignore:pairs that are exempt")
@pytest.mark.verify
@pytest.mark.parametrize("name", ["panda", "ur5"])
def test_both_checkers_verify_all_pairs_of_a_robot(name, agrees):  # noqa: F811
    """All pairs that are NEVER have a proof of less than 100 kB."""
    robot = example_robot(name, meshes="hull")
    never = robot.prove_pairs(cache=False).with_verdict("NEVER")
    found = proven(robot, *(row.names for row in never))
    expect_stated(robot, found, agrees)
    assert len(found.proof.data) < 100_000


@pytest.mark.parametrize("seed", quick(*range(8)))
def test_random_trees(seed, agrees):  # noqa: F811
    """Both checkers verify all proofs that can be written of trees with joints of all kinds, and no search refutes."""
    expect_random_tree(seed, agrees)


@pytest.mark.verify
@pytest.mark.parametrize("seed", range(100, 160))
def test_many_random_trees(seed, agrees):  # noqa: F811
    """The same law for more trees."""
    expect_random_tree(seed, agrees)


def expect_random_tree(seed, both):
    robot = mechanisms.random_tree(seed)
    margin = (0.0, 0.0, 0.02)[seed % 3]
    every = list(itertools.combinations(robot.bodies, 2))
    never = robot.prove_pairs(every, margin=margin, boxes=2000, cache=False).with_verdict("NEVER")
    for row in never:
        try:
            found = proven(robot, row.names, margin=margin, boxes=2000)
        except ConvergenceError:  # too near to the margin
            continue
        expect_stated(robot, found, both)
        assert refuted(robot, found[0], 10) < 0


def test_pieces_are_divided(agrees):  # noqa: F811
    """Two forks whose teeth pass between each other: no plane separates all pieces of both."""
    teeth = [box((0.02, 0.02, 1.0), (0.1 * k, 0.0, 0.0)) for k in range(-3, 4)]
    robot = mechanisms.robot(
        link("frame", *teeth), link("comb", *(box((0.02, 0.02, 1.0), (0.1 * k + 0.05, 0.0, 0)) for k in range(-3, 3))),
        joint("slide", "prismatic", "frame", "comb", axis=(0, 1, 0), limits=(-0.5, 0.5)),
    )  # fmt: skip
    expect_stated(robot, proven(robot, ("frame", "comb"), margin=0.02), agrees)


def test_bodies_of_all_shapes(agrees):  # noqa: F811
    """A ball, an ellipsoid, a cylinder, a cone, a capsule and a box at rest, past which a rod with a ball turns."""
    robot = mechanisms.robot(
        link("frame"), link("rod", box((0.5, 0.05, 0.05), (0.25, 0.0, 0.0)), ball(0.05, (0.5, 0.0, 0.0))),
        joint("turn", "continuous", "frame", "rod"),
    )  # fmt: skip
    shapes = {
        "ball": Body.sphere(0.1), "ellipsoid": Body.ellipsoid([0.1, 0.2, 0.1]), "cylinder": Body.cylinder(0.1, 0.3),
        "cone": Body.cone(0.1, 0.2), "capsule": Body.capsule(0.1, 0.3), "box": Body.box([0.2, 0.1, 0.2]),
    }  # fmt: skip
    scene = Scene()
    for k, (name, shape) in enumerate(shapes.items()):
        T = np.eye(4)
        T[:2, 3] = 0.8 * math.cos(k), 0.8 * math.sin(k)
        scene.add(name, shape, T)
    found = proven(robot, *((name, "rod") for name in shapes), scene=scene)
    expect_stated(robot, found, agrees, scene=scene)


def test_models_with_rules_and_margins(agrees):  # noqa: F811
    """The model is that of a checker, whose rules of contact and margins do not matter for the pairs."""
    robot, scene = mechanisms.hinge(), Scene(margin=0.01)
    scene.add("post", Body.box([0.1, 0.1, 0.1]), translation(5.0))
    scene.leave("crank", "post")
    found = proven(robot, ("crank", "post"), margin=0.02, scene=scene)
    report = expect_stated(robot, found, agrees, scene=scene)
    assert report.rules == (("crank", "post", 1),)
    assert report.ranges[0][2] == 0.02


# -- false proofs -------------------------------------------------------------------------------


def expect_refused(data, both):
    """Both checkers refuse a file."""
    assert not both(resealed(data))


def changed(data, old, new):
    """The data with a number in place of another one, which occurs once."""
    old, new = struct.pack("<d", old), struct.pack("<d", new)
    assert data.count(old) == 1
    return data.replace(old, new)


def test_a_wider_range_is_refused(agrees):  # noqa: F811
    """A range that is wider by a hundredth reaches contact; one that is narrower is still true."""
    end = HINGE_TOUCHES - 1e-3
    data = proven(mechanisms.hinge(), ("crank", "frame"), limits={"hinge": (-1.0, end)}).proof.data
    expect_refused(changed(data, end, 1.01 * end), agrees)
    assert agrees(resealed(changed(data, end, 0.99 * end)))


def test_a_larger_margin_is_refused(agrees):  # noqa: F811
    """The coupler comes within 0.15 m."""
    data = proven(mechanisms.parallelogram(), ("frame", "coupler"), margin=0.1493).proof.data
    expect_refused(changed(data, 0.1493, 0.1501), agrees)
    assert agrees(resealed(changed(data, 0.1493, 0.1492)))


def follower(factor):
    """A crank that turns as a knob does, times a factor; with 3 it comes to the other side and collides."""
    return mechanisms.robot(
        link("frame", ball(BALL, (-ARM, 0.0, 0.0))), link("knob"), link("crank", ball(BALL, (ARM, 0.0, 0.0))),
        joint("knob", "revolute", "frame", "knob", limits=(0.0, 1.0)),
        joint("crank", "revolute", "frame", "crank", limits=(0.0, 3.0), mimic=("knob", factor, 0.0)),
    )  # fmt: skip


@pytest.mark.parametrize("factor", [3.0, -3.0, 6.0])
def test_another_multiplier_is_refused(factor, agrees):  # noqa: F811
    """The same planes and ranges, with a crank that turns farther."""
    data = proven(follower(0.703125), ("frame", "crank")).proof.data
    expect_refused(changed(data, 0.703125, factor), agrees)


def least_distance(low, high):
    """The least distance of the two balls of a hinge in a range."""
    angles = np.append(np.linspace(low, high, 20_001), [low, high])
    return (2 * ARM * np.abs(np.cos(angles / 2))).min() - 2 * BALL


@pytest.mark.parametrize("count", quick(10, 60))
def test_changed_bytes_are_refused_or_still_true(agrees, rng, count):  # noqa: F811
    """Both checkers agree about each changed byte, and a changed proof that they verify is true."""
    data = proven(mechanisms.hinge(), ("crank", "frame"), margin=0.01, limits={"hinge": (-2.7, 2.5)}).proof.data
    size = Proof(data).size
    verified = 0
    for at in [*range(len(data) - 32 - size, len(data) - 32), *rng.integers(24, len(data) - 32 - size, count).tolist()]:
        mutant = bytearray(data)
        mutant[at] ^= 1 << int(rng.integers(8))
        if agrees(resealed(bytes(mutant))):
            verified += 1
            if at >= len(data) - 32 - size:
                ((_, _, margin, ((_, low, high, _),)),) = verify(resealed(bytes(mutant))).ranges
                assert least_distance(low, high) > margin
    assert verified > 0


@pytest.mark.parametrize("seed", [20, *(pytest.param(k, marks=pytest.mark.verify) for k in (21, 22, 25, 26, 29))])
@pytest.mark.parametrize("count", quick(1, 4))
def test_no_range_that_collides_is_proven(seed, agrees, monkeypatch, count):  # noqa: F811
    """Trees that would be proofs if points moved along straight lines are refused if bodies come within the margin."""
    near = range_proofs._Search._nearest
    monkeypatch.setattr(range_proofs._Joints, "bends", lambda self, *_: np.zeros(len(self.values)))
    monkeypatch.setattr(range_proofs._Search, "_nearest", lambda *args: (1.0 + near(*args)[0], near(*args)[1]))
    monkeypatch.setattr(range_proofs, "MOST_NODES", 400)
    robot, rng = mechanisms.random_tree(seed), np.random.default_rng(seed)
    ready, written = CollisionChecker(robot, skip_adjacent=False)._ready(), 0
    rows = robot.prove_pairs(itertools.combinations(robot.bodies, 2), margin=0.5, boxes=1000, cache=False)
    for row in rows:
        if not row.distance > 0 or not np.isfinite(row.lower).all():
            continue
        pair = tuple(sorted(ready.names.index(name) for name in row.names))
        columns = np.array([robot.configuration_names.index(name) for name in row.columns])
        for _ in range(count):  # a range about the nearest place
            low, high = row.nearest[columns] + rng.uniform(0.1, 0.6, (2, len(columns))) * [[-1.0], [1.0]]
            claim = range_proofs.Claim(pair, row.distance + 1e-9, columns, low, high)
            try:
                made = range_proofs.proof_of_ranges(model_of_problem(ready), ready, [claim])
            except (InputError, ConvergenceError):
                continue
            written += 1
            assert not agrees(made.data)
    assert written


@pytest.mark.parametrize("seed", quick(*range(10)))
def test_both_checkers_have_the_same_bounds(seed, agrees):  # noqa: F811
    """They verify proofs up to the same margin: up to rounding, where the plane with the least to spare fails."""
    robot, tried = mechanisms.random_tree(seed), 0
    rows = robot.prove_pairs(itertools.combinations(robot.bodies, 2), boxes=500, cache=False).with_verdict("NEVER")
    for row in rows[:6]:
        try:
            data = proven(robot, row.names, boxes=500).proof.data
        except ConvergenceError:  # too near to contact
            continue
        at, spare = len(data) - 32 - Proof(data).size + 12, float(verify(data).tightest[-1])
        for more, holds in ((-1e-9, True), (1e-9, False)):
            if spare + more >= 0:
                assert agrees(resealed(data[:at] + doubles(spare + more) + data[at + 8 :])) == holds
                tried += 1
    assert tried or not rows


# -- files made by hand -------------------------------------------------------------------------

BELOW = box_of((0.0, -0.9, -0.1), (1.0, -0.5, 0.1))
ALONG_Y = b"\x0b"  # a plane in the frame of the second body, with the normal y
LINKS, VALUES = [TURNING], [(-3.0, 3.0)]
BODIES = [body(0, ROD), body(-1, BELOW, called="post")]


def stated(ends=((0.0, 0.5),), tree=ALONG_Y, margin=0.1, pair=(0, 1), more=b"", given=None, count=1, **options):
    """A file of claim 3: a rod turns about z, above a post."""
    options = {"claim": 3, "version": 2} | options
    pairs = struct.pack("<IIId", count, *pair, margin) + b"".join(doubles(*two) for two in ends) + tree
    return sealed(model_of(LINKS, VALUES, BODIES) if given is None else given, pairs + more, **options)


def room(low, high):
    """The margin that the plane along y just proves, from the page: two corners, and R from the ball about the rod."""
    least = min(x * math.sin(a) + y * math.cos(a) for a in (low, high) for x in (0.2, 1.0) for y in (-0.05, 0.05))
    return least + 0.5 - (math.hypot(0.4, 0.05, 0.05) + 0.6) * (high - low) ** 2 / 8


def test_the_condition_is_exact(agrees):  # noqa: F811
    """A margin is verified up to the bound on the page, and no further; also after halving."""
    assert agrees(stated())
    for low, high in ((0.0, 0.5), (-0.3, 0.2), (0.1, 0.1)):
        least = room(low, high)
        assert agrees(stated([(low, high)], margin=least - 1e-11))
        assert not agrees(stated([(low, high)], margin=least + 1e-11))
    halves = min(room(-0.3, -0.05), room(-0.05, 0.2))
    for tree in (b"\0\0" + ALONG_Y + b"\3", b"\0\0" + ALONG_Y * 2):
        assert agrees(stated([(-0.3, 0.2)], tree, halves - 1e-11))
        assert not agrees(stated([(-0.3, 0.2)], tree, halves + 1e-11))
    report = verify(stated())
    assert report.ranges == (("body", "post", 0.1, (("value", 0.0, 0.5, False),)),)
    assert abs(float(report.tightest[-1]) - (room(0.0, 0.5) - 0.1)) < 1e-12
    assert report.tightest[:2] == ("body", "post")


@pytest.mark.parametrize(("ends", "whole"), [
    ((-3.0, 3.0), True), ((-4.0, 3.5), True), ((-2.9, 3.0), False), ((-3.0, math.nextafter(3.0, 0)), False),
    ((1.0, 1.0 + 6.283185307179587), True), ((0.0, 6.283185307179586), False),
])  # fmt: skip
def test_whole_ranges(ends, whole):
    """A range is all that a value can be if it holds the limits, or a full turn; both checkers report the same."""
    far = [body(0, ROD), body(-1, box_of((0.0, -9.0, 50.0), (1.0, -8.0, 51.0)))]
    tree = plane((0, 0, -1), 17)
    ((*_, ((*_, found),)),) = verify(stated([ends], tree, 0.0, given=model_of(LINKS, VALUES, far))).ranges
    assert found == whole


def test_the_second_checker_reports_the_same(agrees, tmp_path, tmp_path_factory):  # noqa: F811
    """The lines about pairs and ranges have the same numbers."""
    data = proven(mechanisms.gears(-1.5, math.pi), ("first", "second"), limits={"first": (-0.5, 0.5)}).proof.data
    assert agrees(data)
    program = compiled(tmp_path_factory.getbasetemp(), "-O0")
    (tmp_path / "made.proof").write_bytes(data)
    told = subprocess.run([program, tmp_path / "made.proof"], capture_output=True, text=True, check=True).stdout
    assert "\npair: bodies 0 and 1 are farther apart than 0 m\n    for value 0 from -0.5 to 0.5, NOT all" in told


NESTED = b"\0\0" * 64 + ALONG_Y + b"\3" * 64
WIDE = model_of([link_of(kind=1, value=k, above=k - 1) for k in range(9)], [(0.0, 1.0)] * 9, [
    body(8, hull([(0.0, 0.0, 5.0)])), body(-1, hull([(0.0, 0.0, 0.0)])),
])  # fmt: skip
DOWN = plane((0, 0, 1), 17)


def test_files_that_are_taken(agrees):  # noqa: F811
    """Deep trees, normals of both kinds, values without a width, a model with rules, and pairs without values."""
    assert agrees(stated(tree=NESTED))
    assert agrees(stated(tree=plane((0, 300, 1), 17)))
    assert agrees(stated(tree=b"\x13" + doubles(0.0, 1e-30, 0.0)))
    assert agrees(stated([(0.1, 0.1)], b"\0\0" + ALONG_Y + b"\3"))
    assert agrees(stated(given=model_of(LINKS, VALUES, BODIES, rules=[(0, 1, 3)])))
    assert agrees(stated(given=model_of(LINKS, VALUES, BODIES, apart=[(0, 1)], margin=3.0)))
    assert agrees(stated([(0.0, 1e-3)] * 8 + [(0.5, 0.5)], DOWN, 4.9, given=WIDE))
    one = [body(-1, hull([(0.0, 0.0, 0.0)])), body(-1, hull([(0.0, 0.0, 5.0)]))]
    assert agrees(stated([], plane((0, 0, 1)), 4.9, given=model_of([], [], one)))
    assert agrees(stated(given=model_of([link_of(kind=2, value=0)], VALUES, BODIES), tree=b"\x0b"))


# In the last one, the rod is below the other body at both ends of the range, and reaches into it in between.
REFUSED = {
    "a range upside down": {"ends": [(0.5, 0.0)]},
    "an infinite range": {"ends": [(0.0, math.inf)]},
    "no number": {"ends": [(math.nan, 0.5)]},
    "too far": {"ends": [(0.0, 2e6)], "tree": NESTED},
    "too few ranges": {"ends": []},
    "too many ranges": {"ends": [(0.0, 0.5)] * 2},
    "a negative margin": {"margin": -0.1},
    "an infinite margin": {"margin": math.inf},
    "no pair": {"count": 0},
    "two pairs": {"count": 2},
    "a pair twice": {"count": 2, "more": struct.pack("<IId", 0, 1, 0.1) + doubles(0.0, 0.5) + ALONG_Y},
    "a pair of one body": {"pair": (1, 1)},
    "a pair in another order": {"pair": (1, 0)},
    "a body that does not exist": {"pair": (0, 2)},
    "bytes too many": {"more": b"\3"},
    "a tree without an end": {"tree": b"\0\0" + ALONG_Y},
    "no such value": {"tree": b"\0\1" + ALONG_Y + b"\3"},
    "a piece in two": {"tree": b"\1" + ALONG_Y + b"\3"},
    "no plane yet": {"tree": b"\3"},
    "an unknown token": {"tree": b"\x14"},
    "no normal": {"tree": plane((0, 0, 0), 17)},
    "the wrong plane": {"tree": plane((0, -1, 0), 17)},
    "the wrong frame": {"tree": plane((0, 1, 0), 16)},
    "too deep": {"tree": b"\0\0" * 65 + ALONG_Y + b"\3" * 65},
    "the first version": {"version": 1},
    "another claim": {"claim": 2},
    "an unknown claim": {"claim": 4},
    "too many sides": {"ends": [(0.0, 1e-3)] * 9, "tree": DOWN, "margin": 4.9, "given": WIDE},
    "a bend that is not covered": {
        "ends": [(math.pi / 2 - 0.5, math.pi / 2 + 0.5)],
        "tree": plane((0, -1, 0), 17),
        "margin": 0.0,
        "given": model_of(LINKS, VALUES, [body(0, ROD), body(-1, box_of((-1.0, 0.95, -0.1), (1.0, 1.5, 0.1)))]),
    },
}


@pytest.mark.parametrize("what", REFUSED)
def test_files_that_are_refused(what, agrees):  # noqa: F811
    """Each is refused by both checkers."""
    assert agrees(stated())
    assert not agrees(stated(**REFUSED[what]))


# -- bounds -------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", quick_of(range(12), range(2)))
def test_bounds_of_second_derivatives(seed):
    """No second difference of a point exceeds the bound of writer and checker, which agree."""
    robot = mechanisms.random_tree(seed)
    ready, rng = CollisionChecker(robot, skip_adjacent=False)._ready(), np.random.default_rng(seed)
    given = model_of_problem(ready)
    for pair in itertools.combinations(range(len(ready.names)), 2):
        columns = np.arange(len(robot.configuration_names))
        low = rng.uniform(-2.0, 2.0, len(columns))
        claim = range_proofs.Claim(pair, 0.0, columns, low, low + rng.uniform(0.1, 3.0, len(columns)))
        joints = range_proofs._Joints(given, claim)
        count = len(joints.values)
        check = loewner.verify._Checker(given.data, b"", 2, 3)
        paths = check.paths(*(check.bodies[k].link for k in pair))
        ends = {int(v): [a, b] for v, a, b in zip(joints.values, joints.lower, joints.upper, strict=True)}
        made = loewner.verify._Box(0, 0.0, paths, ends, check.links, len(columns))
        for lower in (0, 1):
            shape = range_proofs._Shape(given, ready, pair[1 - lower])
            bends = joints.bends(lower, shape.center, shape.reach)
            for c in range(count):
                sides = [(0, (1 << 64) * (k == c)) for k in range(count)]
                term = check.bent(made, sides, check.bodies[pair[lower]].link, pair[1 - lower]) / 2**72
                assert term == pytest.approx(
                    bends[c] * (joints.upper[c] - joints.lower[c]) ** 2 / 8, rel=1e-9, abs=1e-15
                )
            if not count:
                continue
            share = rng.random((200, count))
            X = shape.center + shape.reach * rng.normal(size=(200, 3)) / 6
            X = np.where(np.linalg.norm(X - shape.center, axis=1)[:, None] > shape.reach, shape.center, X)
            step = 0.02 * (joints.upper - joints.lower)
            Q = joints.lower + step + share * (joints.upper - joints.lower - 2 * step)
            for c in range(count):
                moved = [placed(joints, lower, Q + k * step * (np.arange(count) == c), X) for k in (-1, 0, 1)]
                second = np.linalg.norm(moved[0] - 2 * moved[1] + moved[2], axis=1) / step[c] ** 2
                assert second.max() <= bends[c] * (1 + 1e-9) + 1e-9


def placed(joints, lower, Q, X):
    """Points of the upper body in the frame of the lower one."""
    turn, shift = joints.seen(Q)
    if lower == 0:
        return np.einsum("nij,nj->ni", turn, X) + shift
    return np.einsum("nji,nj->ni", turn, X - shift)


# -- what cannot be written ---------------------------------------------------------------------


def test_pairs_that_are_not_never_are_named():
    """The first row that is not NEVER, with its verdict; nothing to prove is refused, too."""
    robot = mechanisms.hinge()
    with pytest.raises(InputError, match="found SOMETIMES for crank and frame; leave it out"):
        proven(robot, ("crank", "frame"))
    with pytest.raises(InputError, match="found OPEN for first and second .*no common period"):
        proven(mechanisms.gears(math.sqrt(2), 0.0), ("first", "second"))
    plate = mechanisms.robot(
        link("frame", ball(0.1)), link("plate", ball(0.1)), joint("screw", "fixed", "frame", "plate")
    )  # fmt: skip
    with pytest.raises(InputError, match="nothing to prove"):
        plate.prove_pairs(cache=False, proof=True)
    with pytest.raises(InputError, match="proof"):
        robot.prove_pairs(proof=1)
    assert robot.prove_pairs(cache=False).proof is None


def test_joints_of_bases(agrees):  # noqa: F811
    """A planar base slides along two values and turns about a third; a floating one is refused."""
    robot, scene = mechanisms.hinge().add_base("planar"), Scene()
    scene.add("post", Body.box([0.1, 0.1, 1.0]), translation(3.0))
    x, y, _ = (name for name in robot.configuration_names if "/" in name)
    found = proven(robot, ("frame", "post"), scene=scene, limits={x: (-1.0, 1.0), y: (-1.0, 1.0)})
    expect_stated(robot, found, agrees, scene=scene)
    with pytest.raises(InputError, match="floating or ball joint"):
        proven(mechanisms.hinge().add_base("floating"), ("frame", "crank"))


@pytest.mark.filterwarnings("ignore:pairs that are exempt")
def test_planar_joints(agrees):  # noqa: F811
    """One joint with three values between the bodies."""
    robot = mechanisms.robot(
        link("frame", ball(BALL, (3.0, 0.0, 0.0))), link("cart", box((0.5, 0.2, 0.1))),
        joint("plane", "planar", "frame", "cart"),
    )  # fmt: skip
    x, y, _ = robot.configuration_names
    found = proven(robot, ("cart", "frame"), limits={x: (-1.0, 2.0), y: (-1.0, 1.0)})
    report = expect_stated(robot, found, agrees)
    assert [whole for *_, whole in report.ranges[0][3]] == [False, False, True]


def test_surfaces_are_refused():
    """A surface has no pieces that cover it; the message has the pair."""
    robot = example_robot("ur5", meshes="surface")
    with pytest.raises(InputError, match="found a surface in base_link and shoulder_link"):
        proven(robot, ("base_link", "shoulder_link"))


@pytest.mark.parametrize("gap", [1e-4, 1e-6, 1e-9, 1e-11])
def test_pairs_near_their_margin(gap, agrees):  # noqa: F811
    """They have a proof that both checkers verify, or are refused since they are too near."""
    options = {"limits": {"crank": (-0.25, 1.0)}, "margin": 0.15 - gap}
    if gap < 1e-10:
        with pytest.raises(ConvergenceError, match="between frame and coupler .* nearer than the room for rounding"):
            proven(mechanisms.parallelogram(), ("frame", "coupler"), **options)
    else:
        assert agrees(proven(mechanisms.parallelogram(), ("frame", "coupler"), **options).proof.data)


def test_large_files_are_refused(monkeypatch):
    """More nodes, or more bytes, than a file may have."""
    robot = mechanisms.parallelogram()
    with monkeypatch.context() as patched:
        patched.setattr(range_proofs, "MOST_NODES", 3)
        with pytest.raises(InputError, match="frame and coupler take more|coupler and frame take more"):
            proven(robot, ("frame", "coupler"), margin=0.14)
    monkeypatch.setattr(range_proofs, "MOST_BYTES", 500)
    with pytest.raises(InputError, match="at most 500 bytes"):
        proven(robot, ("frame", "coupler"), margin=0.14)


# -- command line -------------------------------------------------------------------------------


@pytest.fixture
def urdf(tmp_path, monkeypatch):
    """A hinge in an empty folder."""
    monkeypatch.chdir(tmp_path)
    mechanisms.hinge().to_urdf(tmp_path / "hinge.urdf")
    return "hinge.urdf"


def run(capsys, *words):
    status = cli.main(list(words))
    out, err = capsys.readouterr()
    return status, out, err


def test_clash_writes_and_verify_reads(urdf, capsys):
    """The file is verified against its robot, and refused against another one; JSON has pairs, margins and ranges."""
    words = "clash", urdf, "--all", "--margin", "0.001", "--limits", "hinge=-2,2", "--proof", "never.proof"
    assert run(capsys, *words)[0] == 0
    status, out, _ = run(capsys, "verify", "never.proof", "--robot", urdf)
    assert status == 0
    assert "frame and crank are farther apart than 1 mm" in out
    assert "for hinge from -2.0 to 2.0, NOT all of its range" in out
    assert out.rstrip().endswith("at all values in the ranges above")
    status, out, _ = run(capsys, "verify", "never.proof", "--json")
    told = json.loads(out)
    assert status == 0
    assert told["verified"]
    assert told["pairs"] == [
        {"names": ["frame", "crank"], "margin": 0.001, "range": {"hinge": [-2.0, 2.0]}, "whole_range": False}
    ]
    mechanisms.hinge(limits=(-3.0, 3.0)).to_urdf("other.urdf")
    status, out, _ = run(capsys, "verify", "never.proof", "--robot", "other.urdf", "--json")
    assert status == 1
    assert not json.loads(out)["verified"]
    assert any("limits of hinge" in words for words in json.loads(out)["different"])
    with open("path.csv", "w") as file:
        file.write("hinge\n0\n1\n")
    status, out, _ = run(capsys, "verify", "never.proof", "--path", "path.csv")
    assert status == 1
    assert "about ranges, not motions" in out
    data = Proof.load("never.proof").data
    with open("never.proof", "wb") as file:
        file.write(resealed(changed(data, 2.0, 3.0)))
    status, out, err = run(capsys, "verify", "never.proof", "--json")
    assert status == 1
    assert "fails by" in json.loads(out)["refused"]


def test_clash_writes_no_proof_of_pairs_that_collide(urdf, capsys, tmp_path):
    """The pair is named, an older proof is removed, and --largest takes no proof."""
    run(capsys, "clash", urdf, "--all", "--limits", "hinge=-2,2", "--proof", "never.proof")
    assert (tmp_path / "never.proof").exists()
    status, _, err = run(capsys, "clash", urdf, "--all", "--proof", "never.proof")
    assert status == 2
    assert "SOMETIMES for crank and frame" in err
    assert not (tmp_path / "never.proof").exists()
    status, _, err = run(capsys, "clash", urdf, "--all", "--largest", "hinge", "--proof", "never.proof")
    assert status == 2
    assert "--proof" in err


def test_files_are_saved_and_loaded(tmp_path):
    """A file is read again as it was; one that claims more is no file of a proof."""
    found = proven(mechanisms.hinge(), ("crank", "frame"), limits={"hinge": (-2.0, 2.0)}).proof
    found.save(tmp_path / "a.proof")
    assert Proof.load(tmp_path / "a.proof") == found
    with pytest.raises(InputError, match="version 1 or 2"):
        Proof(stated(claim=4))
    with pytest.raises(FileError, match="fails by"):
        Proof(resealed(changed(found.data, 2.0, 3.0))).verify()
    with pytest.raises(Refused, match="claims 1 and 3"):
        verify(stated(claim=4))
