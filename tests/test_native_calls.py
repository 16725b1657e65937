"""Queries that are one call of the extension: the same answers and the same errors as the long way has."""

import contextlib
import copy
import dataclasses
import gc
import os
import pickle
import sys
import threading
import tracemalloc

import numpy as np
import pytest

import loewner
from checker_oracle import composed_bodies, pose, random_robot, random_scene, robot_of, simple_bodies
from families import FAMILIES, pieces, random_poses, translation
from loewner import Bodies, Body, CollisionChecker, Distance, LoewnerError, Scene
from loewner._kernels import records
from loewner._native import entries, library, singles
from loewner.robots.checking import edges
from sampling import quick, quick_of

native = pytest.mark.skipif(library.level() is None, reason=f"no native library: {library.why_not()}")

CURVED = [
    Body.sphere(0.4), Body.ellipsoid([0.2, 0.5, 0.9]), Body.cylinder(0.5, 1.0), Body.capsule(0.4, 1.0),
    Body.cone(0.5, 1.0),
]  # fmt: skip


@pytest.fixture
def long_way(monkeypatch):
    """Call a function with the extension's queries switched off."""

    def call(function, *args, **options):
        with monkeypatch.context() as patch:
            for name in singles.PAIRS:
                patch.setattr(singles, name, singles.none)
            patch.setattr(singles, "configurations", lambda *_: singles.LongWay())
            return function(*args, **options)

    return call


def outcome(function, *args, **options):
    """What a call returns, or the class and text of what it raises."""
    try:
        return function(*args, **options)
    except LoewnerError as error:
        return type(error), str(error)


def same(one, other):
    """Tell whether two answers are of the same kind and equal to the last bit."""
    if isinstance(one, Distance):
        return type(one) is type(other) and all(
            same(getattr(one, f.name), getattr(other, f.name)) for f in dataclasses.fields(one)
        )
    if isinstance(one, np.ndarray):
        return type(other) is np.ndarray and one.shape == other.shape and one.tobytes() == other.tobytes()
    if isinstance(one, float):
        return type(other) is float and np.float64(one).tobytes() == np.float64(other).tobytes()
    return type(one) is type(other) and one == other


def calls(a, Ta, b, Tb, margin):
    """All queries of one pair."""
    return (
        (loewner.classify, (a, Ta, b, Tb), {}),
        (loewner.classify, (a, Ta, b, Tb), {"margin": margin}),
        (loewner.collide, (a, Ta, b, Tb), {}),
        (loewner.collide, (a, Ta, b, Tb), {"margin": margin}),
        (loewner.distance, (a, Ta, b, Tb), {}),
        (loewner.distance, (a, Ta, b, Tb), {"exact": True}),
    )


def unions(rng, count):
    """Bodies of many pieces: with and without a tree."""
    return [
        Body.union([Body.from_points(p + k) for k, p in enumerate(pieces("boxes", int(rng.integers(2, 14)), seed))])
        for seed in range(count)
    ]


def bodies_of(kind, rng):
    """Bodies of a family, or of all kinds."""
    if kind == "curved":
        return CURVED
    if kind == "unions":
        return unions(rng, 6)
    if kind == "all":
        some = [Body.from_points(pieces(name, 1, 5)[0]) for name in sorted(FAMILIES)]
        return [*CURVED, *unions(rng, 2), *some]
    return [Body.from_points(p) for p in pieces(kind, 12, 3)]


@pytest.mark.parametrize("kind", [*sorted(FAMILIES), "curved", "unions", "all"])
@pytest.mark.parametrize("count", quick(15, 40))
def test_answers_are_those_of_the_long_way(kind, rng, long_way, count):
    """To the last bit: far, near, in contact, with margins, with None for a pose, of one body with itself."""
    bodies = bodies_of(kind, rng)
    poses = random_poses(rng, count, 3.0 if kind == "unions" else 1.2)
    for k, T in enumerate(poses):
        a, b = bodies[rng.integers(len(bodies))], bodies[rng.integers(len(bodies))]
        a = b if k % 10 == 0 else a
        Ta = [None, np.eye(4), poses[k - 1]][k % 3]
        Tb = None if k % 7 == 0 else T
        for query, args, options in calls(a, Ta, b, Tb, float(rng.uniform(0, 0.3))):
            assert same(query(*args, **options), long_way(query, *args, **options)), (query.__name__, k, options)


@native
def test_the_usual_case_is_answered_by_the_extension(rng):
    """Otherwise the test above compares the long way with itself."""
    a, b = Body.box([1, 1, 1]), CURVED[2]
    T = random_poses(rng, 1, 3.0)[0]
    assert singles.collide(Body, a, None, b, T, "exact", 0.0, None) in (True, False)
    assert singles.classify(Body, a, T, b, None, 0.0, None) in (0, 1, 2)
    for exact in (True, False):
        assert type(singles.distance(Body, Distance, a, None, b, T, exact, None)) is Distance


class Subclass(Body):
    """A user's own kind of body."""


class Pose(np.ndarray):
    """A user's own kind of array."""


def unusual_poses(T):
    """Poses that the extension leaves to Python, whether or not they are good ones; and some that it may take."""
    wide = np.zeros((4, 8))
    wide[:, ::2] = T
    frozen = T.copy()
    frozen.setflags(write=False)
    askew = np.frombuffer(b"\0" + T.tobytes(), dtype=np.uint8)[1:].view(np.float64).reshape(4, 4)
    swapped = T.astype(">f8")
    bad = {name: T.copy() for name in ("nan", "row", "bent", "mirrored")}
    bad["nan"][1, 2] = np.nan
    bad["row"][3, 0] = 0.5
    bad["bent"][:3, 0] *= 1.01
    bad["mirrored"][:3, 0] *= -1
    return {
        **bad, "frozen": frozen, "strided": wide[:, ::2], "fortran": np.asfortranarray(T), "single": T.astype("f4"),
        "swapped": swapped, "askew": askew, "own": T.copy().view(Pose), "list": T.tolist(), "flat": T.ravel(),
        "batch": T[None], "two": np.stack([T, T]), "three": T[:3], "text": "identity", "whole": np.eye(4, dtype=int),
        "objects": T.astype(object), "masked": np.ma.masked_array(T, mask=np.eye(4) > 0), "number": 1.0, "none": None,
    }  # fmt: skip


@pytest.mark.parametrize("name", sorted(unusual_poses(np.eye(4))))
@pytest.mark.parametrize("side", [0, 1])
def test_unusual_poses(name, side, rng, long_way):
    """A pose of any other kind gets the answer, or the error, that the long way has for it."""
    T = random_poses(rng, 1, 0.8)[0]
    given = [T, T]
    given[side] = unusual_poses(T)[name]
    for query, args, options in calls(CURVED[2], given[0], Body.box([1, 1, 1]), given[1], 0.1):
        assert same_outcome(query, args, options, long_way), query.__name__


def same_outcome(query, args, options, long_way):
    """Tell whether a query answers, or raises, what it does the long way."""
    one, other = outcome(query, *args, **options), long_way(outcome, query, *args, **options)
    return same(one, other)


UNUSUAL = {
    "margin int": {"margin": 1}, "margin zero": {"margin": 0}, "margin -0.0": {"margin": -0.0},
    "margin NaN": {"margin": float("nan")}, "margin inf": {"margin": float("inf")}, "margin < 0": {"margin": -1.0},
    "margin of NumPy": {"margin": np.float64(0.1)}, "margin text": {"margin": "1"}, "margin bool": {"margin": True},
    "margin None": {"margin": None}, "margin array": {"margin": np.array(0.1)},
    "pairs": {"pairs": [[0, 0]]}, "pairs wrong": {"pairs": [[0, 1]]}, "pairs empty": {"pairs": np.empty((0, 2), int)},
    "method": {"method": "estimate"}, "method named": {"method": "".join(["ex", "act"])},
    "method of NumPy": {"method": np.str_("exact")}, "method unknown": {"method": "best"},
    "method array": {"method": np.array(["exact"])}, "method None": {"method": None}, "method list": {"method": []},
    "exact 1": {"exact": 1}, "exact of NumPy": {"exact": np.True_}, "exact text": {"exact": "no"},
    "exact None": {"exact": None},
}  # fmt: skip


@pytest.mark.parametrize("name", sorted(UNUSUAL))
def test_unusual_options(name, rng, long_way):
    """Any other margin, method, list of pairs or choice gets the answer, or the error, that the long way has for it."""
    T, options = random_poses(rng, 1, 0.8)[0], UNUSUAL[name]
    for query in (loewner.classify, loewner.collide, loewner.distance):
        if next(iter(options)) in query.__kwdefaults__:
            assert same_outcome(query, (CURVED[2], None, Body.box([1, 1, 1]), T), options, long_way)


def test_unusual_bodies(rng, long_way):
    """Batches, subclasses, no bodies at all, and bodies that were never made."""
    T, box = random_poses(rng, 1, 0.8)[0], Body.box([1, 1, 1])
    others = (
        Bodies([box]), Bodies([box, box]), Bodies([]), Subclass(box._packed), None, "box", 3, Body, box._packed,
        box.outer,
    )  # fmt: skip
    for other in others:
        for given in ((box, other), (other, box), (other, other)):
            for query, args, options in calls(given[0], T, given[1], None, 0.1):
                assert same_outcome(query, args, options, long_way)
    with pytest.raises(loewner.InputError, match="expected a Body made by its constructors"):
        loewner.collide(object.__new__(Body), None, box, None)


def test_a_measured_distance_is_as_the_class_makes_it(rng):
    """Frozen, with its fields in order, and as good as any other to copy, pickle, print and compare."""
    T = random_poses(rng, 1, 3.0)[0]
    for exact in (True, False):
        found = loewner.distance(Body.box([1, 1, 1]), None, CURVED[0], T, exact=exact)
        made = Distance(**found.__dict__)
        names = [f.name for f in dataclasses.fields(Distance)]
        assert list(found.__dict__) == names
        assert repr(found) == repr(made)
        assert found != made  # by identity, as eq=False has it
        assert isinstance(hash(found), int)
        assert dataclasses.replace(found, lower=0.0).upper == found.upper
        for other in (copy.copy(found), copy.deepcopy(found), pickle.loads(pickle.dumps(found))):
            assert same(found, other)
        with pytest.raises(dataclasses.FrozenInstanceError):
            found.lower = 0.0
        with pytest.raises(dataclasses.FrozenInstanceError):
            del found.lower
        for name in names[4:] if exact else ():
            array = getattr(found, name)
            assert array.dtype == np.float64
            assert array.flags.writeable
            assert array.flags.owndata or library.level() is None


def left_behind(many, rounds, held):
    """References of things before and after so many rounds of calls, and bytes by which memory has grown."""
    many(10)
    gc.collect()
    before = [sys.getrefcount(thing) for thing in held]
    tracemalloc.start()
    many(10)
    start = tracemalloc.get_traced_memory()[0]
    many(rounds)
    grown = tracemalloc.get_traced_memory()[0] - start
    tracemalloc.stop()
    return before, [sys.getrefcount(thing) for thing in held], grown


@native
def test_nothing_leaks(rng):
    """After a hundred thousand calls arguments have the references that they had, and memory has not grown."""
    a, b = Body.box([1, 1, 1]), CURVED[2]
    poses = [random_poses(rng, 1, 3.0)[0], np.full((4, 4), np.nan)]
    held = [a, b, a._packed, b._packed, Body, Distance, None, True, "exact", *poses]

    def many(rounds):
        for _ in range(rounds):
            loewner.collide(a, None, b, poses[0])
            loewner.classify(a, poses[0], b, None)
            loewner.distance(a, None, b, poses[0])
            loewner.distance(a, None, b, poses[0], exact=True)
            singles.collide(Body, a, None, b, poses[1], "exact", 0.0, None)
            singles.collide(Body, a, None, None, poses[0], "exact", 0.0, None)
            singles.distance(Body, Distance, a, None, b, poses[1], True, None)
            singles.classify(Body, a, None, b, poses[0], -1.0, None)

    before, after, grown = left_behind(many, 12_500, held)
    assert max(abs(x - y) for x, y in zip(before, after, strict=True)) < 50  # None and True are everybody's
    assert grown < 10_000


def test_threads(rng):
    """Two threads with pairs of their own and a third with batches get what one thread gets."""
    bodies = [*CURVED, *unions(rng, 3), Body.box([1, 1, 1])]
    packed = Bodies(bodies)
    n = 600
    i, j, T = rng.integers(len(bodies), size=n), rng.integers(len(bodies), size=n), random_poses(rng, n, 1.5)
    expected = loewner.collide(packed[i], None, packed[j], T)
    gaps = loewner.distance(packed[i], None, packed[j], T, exact=True).distance
    wrong = []

    def one_by_one(order):
        for k in order:
            a, b = Body(bodies[i[k]]._packed), Body(bodies[j[k]]._packed)  # gone as soon as they are asked about
            if loewner.collide(a, None, b, T[k]) is not bool(expected[k]):
                wrong.append(k)
            if loewner.distance(a, None, b, T[k], exact=True).distance != gaps[k]:
                wrong.append(k)

    def in_batches(order):
        for _ in range(10):
            if (loewner.collide(packed[i], None, packed[j], T) != expected).any():
                wrong.append(-1)

    threads = [
        threading.Thread(target=one_by_one, args=(range(n),)),
        threading.Thread(target=one_by_one, args=(range(n - 1, -1, -1),)),
        threading.Thread(target=in_batches, args=(None,)),
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert wrong == []


@pytest.mark.skipif(not hasattr(os, "fork"), reason="the system has no fork")
@pytest.mark.filterwarnings("ignore:.*fork.*:DeprecationWarning")
def test_after_a_fork(rng):
    """A child process answers as its parent does, with memory that is now its own."""
    a, b, poses = CURVED[2], Body.box([1, 1, 1]), random_poses(rng, 50, 1.2)
    expected = [loewner.collide(a, None, b, T) for T in poses]
    child = os.fork()
    if child == 0:
        os._exit(0 if [loewner.collide(a, None, b, T) for T in poses] == expected else 1)
    assert [loewner.collide(a, None, b, T) for T in poses] == expected
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0


@native
def test_kernels_of_other_signatures_are_refused():
    """The extension writes arguments by place: it must be the kernel that it was written for."""
    call = library.extension()
    good = [entries.settle_range, entries.distance_range, entries.measure_left, entries.first_fault]
    for place in range(len(good)):
        bad = [entries.estimate_range if k == place else kernel for k, kernel in enumerate(good)]
        with pytest.raises(TypeError, match=r"estimate_range: expected arguments .* and results"):
            call.Pairs(*bad, 1024, 1024)
        bad[place] = len
        with pytest.raises(TypeError, match="expected kernels"):
            call.Pairs(*bad, 1024, 1024)


def test_pieces_are_counted_by_the_first_array(rng):
    """The extension reads from a handle how many pieces a body has: rows of the first array behind it."""
    assert records.Pieces._fields[0] == "table"
    for body in (*CURVED, *unions(rng, 2)):
        assert body._packed.addresses[0, 1] == len(body.pieces)


# -- configurations and motions ------------------------------------------------------------------


def two_checkers(rng, folder):
    """A checker, and another one of the same robot and scene to ask the long way."""
    pool = [*simple_bodies(rng), *composed_bodies(rng)]
    robot = random_robot(rng, folder, int(rng.integers(2, 7)), pool)
    scene = random_scene(rng, robot, int(rng.choice([0, 1, 4, 9])), pool)
    return CollisionChecker(robot, scene), CollisionChecker(robot, scene)


@pytest.mark.parametrize("seed", quick_of(range(12), range(2)))
def test_configurations_are_answered_as_the_long_way_has_them(seed, tmp_path, long_way):
    """Of any robot and scene, while bodies move and are grasped, and pairs take another order."""
    rng = np.random.default_rng(seed)
    checker, other = two_checkers(rng, tmp_path)
    scene = checker.scene
    for k, q in enumerate(checker.robot.random_configurations(300, seed)):
        if k % 40 == 13 and scene.static_names:
            scene.move(scene.static_names[0], pose(rng, 0.6))
        if k == 150:
            scene.add("new", Body.sphere(0.1), pose(rng, 0.4))
            scene.attach("new", checker.robot.link_names[-1])
        assert same(checker.collide(q), long_way(other.collide, q))
        assert same(checker.classify(q), long_way(other.classify, q))
    assert same(checker._seen, other._seen)


@pytest.mark.parametrize("seed", [*range(2), *(pytest.param(k, marks=pytest.mark.verify) for k in range(2, 12))])
def test_motions_are_answered_as_the_long_way_has_them(seed, tmp_path, long_way):
    """Also those of no length, and those whose length is a whole number of steps, or all but."""
    rng = np.random.default_rng(seed)
    checker, other = two_checkers(rng, tmp_path)
    Q = checker.robot.random_configurations(60, seed)
    for k in range(59):
        length = float(checker.robot.distances(Q[k], Q[k + 1]))
        whole = length / int(rng.integers(1, 40))
        for end, step in (
            (Q[k + 1], 0.1), (Q[k], 0.1), (Q[k + 1], whole), (Q[k + 1], float(np.nextafter(whole, 0))),
            (Q[k + 1], float(np.nextafter(whole, 1))), (Q[k + 1], 2.0 * length),
        ):  # fmt: skip
            assert same(checker.valid_edges(Q[k], end, step), long_way(other.valid_edges, Q[k], end, step))


@pytest.fixture
def sliders(tmp_path):
    """Checkers of a box that slides along x beside a post, twice."""
    limits = '<axis xyz="1 0 0"/><limit lower="-1" upper="1"/>'
    robot = robot_of(tmp_path, [("prismatic", 0, limits), ("prismatic", 1, limits)], {"l2": Body.box([0.2, 0.2, 0.2])})
    scene = Scene()
    scene.add("post", Body.box([0.2, 0.2, 0.2]), [[1, 0, 0, 0.5], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
    return CollisionChecker(robot, scene), CollisionChecker(robot, scene)


def unusual_configurations():
    """Configurations that the extension leaves to Python, or may take; of a robot of two joints."""
    q = np.array([0.1, 0.4])
    frozen = q.copy()
    frozen.setflags(write=False)
    return {
        "nan": np.array([0.1, np.nan]), "inf": np.array([np.inf, 0.1]), "huge": np.array([0.1, 1e201]),
        "short": q[:1], "long": np.zeros(3), "batch": q[None], "two": np.stack([q, q]), "list": q.tolist(),
        "single": q.astype("f4"), "whole": np.array([0, 1]), "swapped": q.astype(">f8"), "frozen": frozen,
        "strided": np.zeros(4)[::2], "backwards": q[::-1], "own": q.copy().view(Pose), "text": "home", "none": None,
        "number": 0.1, "empty": np.empty((0, 2)), "masked": np.ma.masked_array(q, mask=[False, True]),
        "objects": q.astype(object), "zero": np.array([-0.0, 0.0]), "mapping": {"j0": 0.1},
    }  # fmt: skip


@pytest.mark.parametrize("name", sorted(unusual_configurations()))
def test_unusual_configurations(name, sliders, long_way):
    """A configuration of any other kind gets the answer, or the error, that the long way has for it."""
    checker, other = sliders
    q, plain = unusual_configurations()[name], np.array([0.3, 0.2])
    for _ in range(2):  # at the first the scene has to be prepared
        for query, args in (("collide", (q,)), ("classify", (q,)), ("valid_edges", (q, plain, 0.1)),
                            ("valid_edges", (plain, q, 0.1))):  # fmt: skip
            one, two = getattr(checker, query), getattr(other, query)
            assert same(outcome(one, *args), long_way(outcome, two, *args)), query


@pytest.mark.parametrize(
    "step", [0.0, -1.0, float("nan"), float("inf"), 1, np.float64(0.1), "0.1", None, 1e-5, 1e-300, 5e-324, 1e300, True]
)
def test_unusual_resolutions(step, sliders, long_way):
    """Any other resolution gets the answer, or the error, that the long way has for it."""
    a, b = np.array([-0.5, 0.0]), np.array([-0.4, 0.0])
    checker, other = sliders
    checker.collide(a)
    assert same(outcome(checker.valid_edges, a, b, step), long_way(outcome, other.valid_edges, a, b, step))


def test_far_outside_the_limits_there_is_one_warning(sliders):
    """From the first such configuration, though others were answered before; then they are usual ones, too."""
    checker, _ = sliders
    far = np.array([0.0, 500.0])
    assert checker.collide(np.zeros(2)) is False
    with pytest.warns(UserWarning, match="is it in millimetres"):
        assert checker.collide(far) is False
    assert checker.collide(far) is False
    if library.level() is not None:
        assert checker._ready().single.collide(far) is False


@native
def test_usual_configurations_are_answered_by_the_extension(sliders):
    """Otherwise the tests above compare the long way with itself."""
    checker, _ = sliders
    assert checker.collide([0.5, 0.0]) is True
    single = checker._ready().single
    assert single.collide(np.array([0.5, 0.0])) is True
    assert single.classify(np.array([-0.5, 0.0])) == 0
    assert single.motion(np.array([-0.5, 0.0]), np.array([0.5, 0.0]), 0.1, edges.coarse_first) < 0


def test_what_is_raised_on_the_way_reaches_the_caller(sliders):
    """An interrupt in Python's part of a motion is not taken for an unusual motion."""

    def interrupted(steps):
        raise KeyboardInterrupt

    checker, _ = sliders
    checker.collide([0.5, 0.0])
    a, b = np.array([-0.5, 0.0]), np.array([0.5, 0.0])
    with pytest.raises(KeyboardInterrupt) if library.level() is not None else contextlib.nullcontext():
        assert checker._ready().single.motion(a, b, 0.1, interrupted) is None
    for order in (lambda steps: None, lambda steps: np.zeros(3), lambda steps: np.zeros(steps + 1, dtype=int)):
        assert checker._ready().single.motion(a, b, 0.1, order) is None


@native
@pytest.mark.parametrize("rounds", quick(3_000, 10_000))
def test_configurations_leak_nothing(sliders, rounds):
    """After many calls arguments have the references that they had, and memory has not grown."""
    checker, _ = sliders
    checker.collide([0.5, 0.0])
    q = [np.array([-0.5, 0.0]), np.array([0.5, 0.0]), np.array([np.nan, 0.0])]
    held = [*q, checker._ready(), checker._ready().single, checker._ready().hits]

    def many(rounds):
        for _ in range(rounds):
            checker.collide(q[0])
            checker.classify(q[1])
            checker.valid_edges(q[0], q[1], 0.1)
            checker.valid_edges(q[0], q[1], 0.25)
            for x in q:
                held[4].motion(x, x, 0.1, edges.coarse_first)
                held[4].collide(x)

    checker._next_look = 10**9  # no other order of pairs meanwhile, which would be another object
    before, after, grown = left_behind(many, rounds, held)
    assert after == before
    assert grown < 10_000


def test_a_checker_is_asked_by_threads_while_its_scene_changes(tmp_path):
    """What a query was prepared with stays until it has ended, though another one prepares anew meanwhile."""
    rng = np.random.default_rng(3)
    checker, other = two_checkers(rng, tmp_path)
    checker.scene.add("wanderer", Body.box([0.2, 0.2, 0.2]), pose(rng, 50.0))  # never near: answers stay
    Q = checker.robot.random_configurations(2_000, 3)
    expected, wrong, ended = other.collide(Q), [], threading.Event()

    def ask(order):
        for k in order:
            if checker.collide(Q[k]) is not bool(expected[k]):
                wrong.append(k)

    def change():
        while not ended.is_set():
            checker.scene.move("wanderer", translation(50 + rng.uniform(), 0, 0))
            checker.collide(Q[:64])

    mover = threading.Thread(target=change)
    askers = [threading.Thread(target=ask, args=(order,)) for order in (range(2_000), range(1_999, -1, -1))]
    for thread in (mover, *askers):
        thread.start()
    for thread in askers:
        thread.join()
    ended.set()
    mover.join()
    assert wrong == []


@native
def test_arrays_of_other_kinds_are_refused():
    """The extension keeps the addresses of these two."""
    call, good = library.extension(), (np.zeros((2, 3)), np.zeros(5, dtype=np.int64))
    kernels = entries.check_configurations, entries.check_motion
    for plain, hits in ((np.zeros(6), good[1]), (np.zeros((3, 2)), good[1]), (good[0], np.zeros(5)), (good[0], None)):
        with pytest.raises(TypeError):
            call.Configurations(*kernels, 0, 0, 0, 0, plain, hits, None)
    with pytest.raises(TypeError, match="expected arguments"):
        call.Configurations(*reversed(kernels), 0, 0, 0, 0, *good, None)
