"""Answers of other programs: what is wrong is caught by its true error, and what is right is never accused."""

import contextlib
import io
import json
import re
from types import MappingProxyType

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st

import loewner
from families import FAMILIES, near_contact, pieces, random_poses, stretch, translation
from loewner import Bodies, Body, ConvergenceError, InputError, PoseError, cli, judging
from loewner._base._rotations import from_quaternion
from loewner.judging import PARTS, Finding, judge_answers
from loewner.reproductions import reproduction
from oracles import exact_squared_distance, hull, pack, signed_distance
from sampling import examples, quick

TOLERANCE = 1e-6

# The accuracy of our answers, relative to the lengths involved, and a bound on these lengths.
ACCURACY, SIZE = 1e-9, 20.0


def distances(a, Ta, b, Tb):
    """Exact distances; NaN, which is no answer, for the few that rounding leaves open at contact."""
    try:
        return loewner.distance(a, Ta, b, Tb, exact=True)
    except ConvergenceError as error:
        return error.partial


def answers(a, Ta, b, Tb) -> dict:
    """The right answers of all kinds."""
    found = distances(a, Ta, b, Tb)
    return {
        "colliding": loewner.collide(a, Ta, b, Tb), "distance": found.distance,
        "depth": np.maximum(-found.distance, 0.0), "witness_a": found.witness_a, "witness_b": found.witness_b,
        "normal": found.normal,
    }  # fmt: skip


def pairs_of(family: str, count: int, seed: int = 0):
    """Hulls of a family at poses near contact."""
    points = pieces(family, 2 * count, seed)
    pool, index = pack(map(hull, points)), np.arange(count)
    Ta, Tb = near_contact(
        np.random.default_rng(seed), pool, index, pool, count + index, deep=0.1, stretch=stretch(family)
    )
    return points, Bodies.from_points(points[:count]), Ta, Bodies.from_points(points[count:]), Tb


def kind(said, part: str):
    return said.kinds[..., PARTS.index(part)]


def excess(said, part: str):
    return said.excess[..., PARTS.index(part)]


def run(code: str) -> dict[Finding, float]:
    """Run a program that proves answers wrong; its errors by kind, the largest of each."""
    out = io.StringIO()
    with contextlib.redirect_stdout(out):
        exec(compile(code, "reproduction", "exec"), {"__name__": "reproduction"})
    found: dict[Finding, float] = {}
    for name, number in re.findall(r"^(\w+): wrong by at least (\S+) m$", out.getvalue(), flags=re.M):
        found[Finding[name]] = max(float(number), found.get(Finding[name], 0.0))
    return found


# -- right answers ------------------------------------------------------------------------------

CURVED = {
    "box": Body.box([0.4, 0.3, 0.2]),
    "ball": Body.sphere(0.2),
    "capsule": Body.capsule(0.1, 0.4),
    "cylinder": Body.cylinder(0.15, 0.3),
    "cone": Body.cone(0.2, 0.3),
    "ellipsoid": Body.ellipsoid([0.3, 0.2, 0.1]),
    "union": Body.boxes([[0, 0, 0], [0.3, 0, 0]], [[0.3, 0.3, 0.3], [0.4, 0.1, 0.5]]),
    "balls": Body.spheres([[0, 0, 0], [0.2, 0, 0]], [0.15, 0.2]),
    "solid": Body.from_surface(trimesh.creation.icosphere(subdivisions=1, radius=0.2)),
    "surface": Body.from_surface(trimesh.creation.box((0.3, 0.2, 0.4)), solid=False),
}


@examples(25, 60)
@given(st.sampled_from(sorted(CURVED)), st.sampled_from(sorted(CURVED)), st.integers(0, 2**32 - 1))
def test_right_answers_of_all_bodies_are_never_accused(one: str, other: str, seed: int):
    """Our answers, off by less than the tolerance, are never proven wrong, in contact and far away too."""
    rng = np.random.default_rng(seed)
    a, b = CURVED[one], CURVED[other]
    Ta, Tb = (random_poses(rng, 40, 0.3) for _ in range(2))
    far = rng.choice([0.0, 0.0, 1e3]) * np.ones(3)
    Ta[:, :3, 3] += far
    Tb[:, :3, 3] += far
    near = distances(a, Ta, b, Tb)
    gap = rng.choice([-1, 1], size=40) * 10 ** rng.uniform(-13, -3, size=40)
    Tb[::2, :3, 3] += ((gap - near.distance)[:, None] * near.normal)[::2]  # to contact, or nearly
    right = answers(a, Ta, b, Tb)
    for name in ("distance", "depth"):
        right[name] = right[name] + rng.uniform(-0.2, 0.2, size=40) * TOLERANCE
    right["depth"] = np.maximum(right["depth"], 0.0)
    for name in ("witness_a", "witness_b", "normal"):
        right[name] = right[name] + rng.uniform(-0.2, 0.2, size=(40, 3)) * TOLERANCE
    said = judge_answers(a, Ta, b, Tb, **right, tolerance=TOLERANCE)
    assert not said.wrong.any(), said.counts()
    assert (said.lower <= said.upper).all()
    assert not said.excess.any()


@pytest.mark.parametrize("family", FAMILIES)
@pytest.mark.parametrize("count", quick(8, 60))
def test_right_answers_of_hulls_are_right(family: str, count: int):
    """Every part of our own answers about hulls is proven right, near contact as well, one by one as in a batch."""
    _, a, Ta, b, Tb = pairs_of(family, count)
    right = answers(a, Ta, b, Tb)
    said = judge_answers(a, Ta, b, Tb, **right, tolerance=TOLERANCE)
    assert (said.kinds == Finding.OK).all(), said.counts()
    for k in range(0, count, 20):
        one = judge_answers(a[k], Ta[k], b[k], Tb[k], **{name: x[k] for name, x in right.items()})
        assert one.kinds.tolist() == said.kinds[k].tolist()
        assert (one.lower, one.upper) == (said.lower[k], said.upper[k])


def test_touching_and_zero():
    """0 is right for all that overlap, and any normal is right in contact; there no witness is asked for."""
    a = Body.box([1, 1, 1])
    said = judge_answers(
        a, None, a, translation(1.0), colliding=[True, False], distance=0.0, normal=[[0, 1, 0], [1, 0, 0]]
    )
    assert said.kinds[:, PARTS.index("distance")].tolist() == [Finding.OK, Finding.OK]
    assert not said.wrong.any()
    said = judge_answers(a, None, a, translation(0.5), distance=0.0, witness_a=[0, 0, 0], witness_b=[0.5, 0.25, 0])
    assert kind(said, "distance") == Finding.OK
    assert kind(said, "witnesses") == Finding.NOT_GIVEN
    assert said.upper == pytest.approx(-0.5)


def test_depths_of_several_pieces():
    """For a union, the depth of the deepest pieces and the way that separates all are both right."""
    comb = Body.boxes([[0, 0, 0], [0, 0, 1]], [[1, 1, 0.2], [1, 1, 0.2]])
    tooth = Body.boxes([[0, 0, 0.05], [0, 0, 0.95]], [[0.1, 0.1, 0.2], [0.1, 0.1, 0.2]])
    said = judge_answers(comb, None, tooth, None, depth=[0.15, 0.55, 0.05, 5.0], normal=[0, 1, 0])
    assert kind(said, "depth").tolist() == [2, 2, Finding.DEPTH_TOO_SMALL, 2]
    assert (kind(said, "normal") == Finding.UNDECIDED).all()
    assert excess(said, "depth")[2] == pytest.approx(0.1)
    # Here the deepest pieces are all that is in the way.
    said = judge_answers(comb, None, Body.box([0.1, 0.1, 0.1]), translation(0, 0, 0.05), depth=[0.1, 0.3])
    assert kind(said, "depth").tolist() == [Finding.OK, Finding.DEPTH_TOO_LARGE]


# -- wrong answers ------------------------------------------------------------------------------

# Exact distances of the others, which have more corners or more extreme ones, take longer.
QUICK = ("ball 8", "ball 20", "boxes", "tetrahedra", "slivers", "mixed scales")


@pytest.mark.parametrize("family", [pytest.param(k, marks=[pytest.mark.verify] * (k not in QUICK)) for k in FAMILIES])
@pytest.mark.parametrize("count", quick(8, 60))
def test_forged_answers_are_caught_by_their_true_error(family: str, count: int):
    """Each kind of error is named, and its bound is below the exact error by no more than the stated accuracy."""
    points, a, Ta, b, Tb = pairs_of(family, count, seed=1)
    rng, right, room = np.random.default_rng(2), answers(a, Ta, b, Tb), 4 * ACCURACY * SIZE
    off = rng.choice([-1, 1], size=count) * rng.uniform(1e-4, 0.3, size=count)
    step = rng.normal(size=(count, 3)) * 0.1
    false = {
        "colliding": ~right["colliding"], "distance": right["distance"] + off,
        "depth": right["depth"] + np.abs(off), "witness_a": right["witness_a"] + step, "witness_b": right["witness_b"],
    }  # fmt: skip
    said = judge_answers(a, Ta, b, Tb, **false, tolerance=TOLERANCE)
    for k in range(count):
        A, B = hull(points[k]), hull(points[count + k])
        squared = exact_squared_distance(points[k], Ta[k], points[count + k], Tb[k])
        truth = float(squared) ** 0.5 if squared else signed_distance(A, Ta[k], B, Tb[k])[0]
        if abs(truth) > 2 * TOLERANCE:
            assert kind(said, "colliding")[k] == (Finding.WRONG_COLLIDING if truth > 0 else Finding.WRONG_FREE)
            assert abs(truth) - room <= excess(said, "colliding")[k] <= abs(truth) + 1e-12
        claim, error = false["distance"][k], excess(said, "distance")[k]
        if claim < 0 < truth or claim >= 0:
            real = claim - max(truth, 0.0)
            named = Finding.DISTANCE_TOO_LARGE if real > 0 else Finding.DISTANCE_TOO_SMALL
        else:
            real = max(-truth, 0.0) + claim
            named = Finding.DEPTH_TOO_SMALL if real > 0 else Finding.DEPTH_TOO_LARGE
        if abs(real) > 2 * TOLERANCE and abs(truth) > room:  # in contact, a distance may be a depth
            assert kind(said, "distance")[k] == named
        assert error <= abs(real) + 1e-12
        assert error >= abs(real) - room or abs(real) <= 2 * TOLERANCE
        assert kind(said, "depth")[k] == Finding.DEPTH_TOO_LARGE
        assert excess(said, "depth")[k] == pytest.approx(abs(off[k]), abs=room)
        outside = float(exact_squared_distance(points[k], Ta[k], false["witness_a"][k][None], None)) ** 0.5
        assert outside - room <= excess(said, "witness_a")[k] + 2 * TOLERANCE
        assert excess(said, "witness_a")[k] <= outside + 1e-12


@pytest.mark.parametrize(
    "family",
    [
        *("cones", "slivers"),
        *(pytest.param(k, marks=pytest.mark.verify) for k in ("ball 20", "boxes", "tetrahedra", "plates 1:1:0.05")),
    ],
)
@pytest.mark.parametrize("count", quick(3, 12))
def test_programs_prove_it_in_fractions(family: str, count: int):
    """The program of each wrong answer names the same kinds of errors, in exact arithmetic."""
    _, a, Ta, b, Tb = pairs_of(family, count, seed=3)
    rng, right = np.random.default_rng(4), answers(a, Ta, b, Tb)
    off, step = rng.uniform(-0.1, 0.1, size=count), rng.normal(size=(count, 3)) * 0.1
    seen = set()
    for k in range(count):
        false = {
            "colliding": not right["colliding"][k], "distance": right["distance"][k] + off[k],
            "depth": max(right["depth"][k] - off[k], 0.0), "witness_a": right["witness_a"][k] + step[k],
            "witness_b": right["witness_b"][k] - step[k], "normal": right["normal"][k] + 5 * step[k],
        }  # fmt: skip
        said = judge_answers(a[k], Ta[k], b[k], Tb[k], **false, tolerance=1e-5)
        proven = run(reproduction(a[k], Ta[k], b[k], Tb[k], **false, tolerance=1e-5))
        assert set(proven) == set(said.counts()) - {Finding.OK, Finding.UNDECIDED}
        for found in said.counts():
            if found in (Finding.DEPTH_TOO_LARGE, Finding.DEPTH_TOO_SMALL, Finding.DISTANCE_TOO_SMALL):
                ours = said.excess[said.kinds == found].max()
                assert proven[found] == pytest.approx(ours, abs=4 * ACCURACY * SIZE)
        seen |= set(proven)
    assert len(seen) >= count // 2


def test_known_errors():
    """Balls, capsules and boxes whose distances are known: each kind, with its error."""
    ball, box, capsule = Body.sphere(0.5), Body.box([1, 1, 1]), Body.capsule(0.5, 2.0)
    said = judge_answers(ball, None, ball, translation(3.0), colliding=True, distance=[1.5, 2.25, -0.5])
    assert kind(said, "distance").tolist() == [Finding.DISTANCE_TOO_SMALL, Finding.DISTANCE_TOO_LARGE, 6]
    assert excess(said, "distance") == pytest.approx([0.5, 0.25, 2.5])
    assert excess(said, "colliding") == pytest.approx(2.0)
    said = judge_answers(ball, None, box, translation(0.9), colliding=False, depth=[0.05, 0.3], normal=[0, 0, 2])
    assert kind(said, "depth").tolist() == [Finding.DEPTH_TOO_SMALL, Finding.DEPTH_TOO_LARGE]
    assert 0.79 * 0.1 <= excess(said, "colliding")[0] <= 0.1
    assert excess(said, "depth")[1] == pytest.approx(0.2)
    assert (kind(said, "normal") == Finding.NORMAL_WRONG).all()
    said = judge_answers(capsule, None, capsule, translation(0.999), colliding=False)
    assert 0.79e-3 <= excess(said, "colliding") <= 1e-3  # far below a thousandth of their lengths
    said = judge_answers(box, None, box, translation(3.0), normal=[[1, 1, 0], [0, 0, 0], [1, 0, 0]])
    assert kind(said, "normal").tolist() == [Finding.NORMAL_WRONG, Finding.NOT_GIVEN, Finding.OK]
    said = judge_answers(box, None, box, translation(2.0), witness_a=[0.5, 0.6, 0], witness_b=[1.5, 0, 0], distance=1.0)
    assert [Finding(int(k)).name for k in said.kinds[3:6]] == ["WITNESS_OFF_BODY", "OK", "WITNESSES_DO_NOT_MATCH"]
    assert excess(said, "witness_a") == pytest.approx(0.1)
    assert excess(said, "witnesses") == pytest.approx(1.36**0.5 - 1)


def test_errors_at_the_tolerance():
    """What is wrong by less than the tolerance is right or undecided; a little more is wrong."""
    box = Body.box([1, 1, 1])
    claims = 1.0 + np.array([0.0, 0.99e-3, 1.01e-3, -0.99e-3, -1.01e-3])
    said = judge_answers(box, None, box, translation(2.0), distance=claims, tolerance=1e-3)
    assert kind(said, "distance").tolist() == [1, 1, Finding.DISTANCE_TOO_LARGE, 1, Finding.DISTANCE_TOO_SMALL]
    exact = judge_answers(box, None, box, translation(2.0), distance=1.0, tolerance=0.0)
    assert kind(exact, "distance") == Finding.UNDECIDED


def test_no_answers_are_not_judged():
    """NaN is no answer, of any part."""
    box, nan = Body.box([1, 1, 1]), np.nan
    said = judge_answers(
        box, None, box, None, colliding=[nan, 1], distance=nan, depth=nan, witness_a=[nan, 0, 0], normal=[0, 0, nan]
    )
    assert (said.kinds[0] == Finding.NOT_GIVEN).all()
    assert said.counts() == {Finding.OK: 1}
    assert said.worst().tolist() == []


def test_worst_first():
    """Answers are listed by their errors, all or those of one kind."""
    ball = Body.sphere(0.5)
    said = judge_answers(ball, None, ball, translation(2.0), distance=[1.1, 0.5, 1.0, 1.3], colliding=[0, 0, 1, 0])
    assert said.worst().tolist() == [2, 1, 3, 0]
    assert said.worst(Finding.DISTANCE_TOO_LARGE).tolist() == [3, 0]
    assert said.wrong.tolist() == [True] * 4
    assert said.counts()[Finding.WRONG_COLLIDING] == 1


# -- programs -----------------------------------------------------------------------------------


def test_the_smallest_bodies():
    """Another program is asked about ever smaller bodies, down to tetrahedra with few decimals."""
    points = pieces("ball 50", 2, seed=5)
    a, b = map(Body.from_points, points)
    asked = []

    def engine(A, B):
        asked.append(len(A) + len(B))
        return {"distance": 0.0}

    code = reproduction(a, None, b, translation(5.0), engine=engine)
    error = run(code)[Finding.DISTANCE_TOO_SMALL]
    assert error > 0.5
    assert asked[0] == len(a.pieces[0].vertices) + len(b.pieces[0].vertices)
    assert asked[-1] == 8
    A = eval(re.search(r"^A = (\[.*?\]\])$", code, flags=re.M | re.S)[1])
    assert len(A) == 4
    assert np.array_equal(np.round(A, 1), A)


def test_an_engine_that_errs_with_many_corners_only():
    """Corners without which the other program is right are kept."""
    points = pieces("ball 20", 2, seed=6)
    a, b = map(Body.from_points, points)
    code = reproduction(
        a, None, b, translation(5.0), engine=lambda A, B: {"colliding": True} if len(A) > 6 else {"colliding": False}
    )
    assert len(eval(re.search(r"^A = (\[.*?\]\])$", code, flags=re.M | re.S)[1])) == 7
    assert set(run(code)) == {Finding.WRONG_COLLIDING}


def test_a_changed_program_fails():
    """A program whose answer is set right, or whose proof is spoilt, fails."""
    box = Body.box([1, 1, 1])
    code = reproduction(box, None, box, translation(1.5), distance=0.25)
    with pytest.raises(AssertionError):
        run(code.replace("'distance': 0.25", "'distance': 0.5"))
    code = reproduction(box, None, box, translation(0.5, 0.1, 0.2), colliding=False)
    with pytest.raises(AssertionError):
        run(re.sub(r", \[\d, \d, \d\]\], a, b\)", "], a, b)", code))  # a hole in the surface
    with pytest.raises(AssertionError):
        run(code.replace("[[1.0, 0.0, 0.0, 0.5]", "[[1.0, 0.0, 0.0, 1.5]"))


# -- bad input ----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({}, "expected an answer to judge, one of colliding, distance, .* found none"),
        ({"colliding": 2}, "colliding: expected True or False, or NaN for no answer, found 2.0"),
        ({"colliding": "yes"}, "colliding: "),
        ({"distance": np.inf}, "distance: expected finite numbers, or NaN for no answer, found inf"),
        ({"depth": -1.0}, "depth: expected finite numbers of 0 or more, or NaN for no answer, found -1.0"),
        ({"normal": [1, 0]}, r"normal: expected shape \(..., 3\), found \(2,\)"),
        ({"witness_a": 1.0}, r"witness_a: expected shape \(..., 3\), found \(\)"),
        ({"distance": [1, 2, 3], "depth": [1, 2]}, "expected batch shapes that broadcast, found pairs"),
        ({"distance": 1.0, "tolerance": -1.0}, "tolerance: expected a finite number >= 0, found -1.0"),
    ],
)
def test_bad_answers_are_refused(wrong: dict, message: str):
    """Each message says what was expected and what was found."""
    with pytest.raises(InputError, match=message):
        judge_answers(Body.sphere(1.0), None, Body.sphere(1.0), None, **wrong)


def test_bad_bodies_are_refused():
    """Bodies, poses and choices are checked as elsewhere; programs need single polytopes and a wrong answer."""
    ball, box = Body.sphere(1.0), Body.box([1, 1, 1])
    with pytest.raises(InputError, match="a: expected loewner.Body or loewner.Bodies, found str"):
        judge_answers("ball", None, ball, None, distance=0.0)
    with pytest.raises(PoseError, match="T_world_b"):
        judge_answers(ball, None, ball, 2 * np.eye(4), distance=0.0)
    with pytest.raises(InputError, match="kind: expected a Finding or None, found 'OK'"):
        judge_answers(ball, None, ball, None, distance=0.0).worst("OK")
    with pytest.raises(InputError, match=r"b: expected a body of one polytope, found 1 pieces \(sphere\)"):
        reproduction(box, None, ball, None, distance=1.0)
    with pytest.raises(InputError, match="expected an answer that is proven wrong, found OK"):
        reproduction(box, None, box, None, colliding=True)
    with pytest.raises(InputError, match=r"expected one answer about one pair, found shape \(2,\)"):
        reproduction(box, None, box, None, colliding=[True, False])
    with pytest.raises(InputError, match="engine: expected no answers beside it, found depth"):
        reproduction(box, None, box, None, depth=1.0, engine=lambda a, b: {})


def test_many_answers_are_refused_unjudged(monkeypatch):
    """A program is about one answer; to judge 700,000 first would take many seconds."""
    monkeypatch.setattr("loewner.reproductions.judge_answers", None)
    box = Body.box([1, 1, 1])
    with pytest.raises(InputError, match=r"expected one answer about one pair, found shape \(100000, 7\)"):
        reproduction(box, None, box, None, depth=np.zeros((100_000, 7)))
    with pytest.raises(InputError, match=r"expected one answer about one pair, found shape \(2, 3\)"):
        reproduction(box, None, box, None, witness_a=np.zeros((2, 3)))


def test_engines_return_any_mapping():
    """Such as a view of a dict that cannot be changed."""
    box, answers = Body.box([1, 1, 1]), MappingProxyType({"distance": 0.0})
    assert "DISTANCE_TOO_SMALL" in reproduction(box, None, box, translation(1.5), engine=lambda a, b: answers)


@pytest.mark.parametrize(
    ("answers", "message"),
    [
        ({"distance": np.zeros(3)}, r"expected one answer about one pair, found shape \(3,\)"),
        ({"distance": [0.0, 0.0]}, r"expected one answer about one pair, found shape \(2,\)"),
        ({"witness_a": np.full((2, 3), 9.0)}, r"expected one answer about one pair, found shape \(2, 3\)"),
        ({"far": 1.0}, "engine: expected a dict of answers, found {'far': 1.0}"),
        ([1.0], r"engine: expected a dict of answers, found \[1.0\]"),
        ({}, "expected an answer to judge"),
    ],
)
def test_engines_that_return_something_else(answers, message):
    """An engine returns one answer about one pair, in a dict."""
    box = Body.box([1, 1, 1])
    with pytest.raises(InputError, match=message):
        reproduction(box, None, box, translation(1.5), engine=lambda a, b: answers)


# -- loewner judge --answers --------------------------------------------------------------------


@pytest.fixture
def table(tmp_path, monkeypatch):
    """A folder with two cubes and a ball, and a writer of tables."""
    monkeypatch.chdir(tmp_path)
    for name, body in (("a", Body.box([1, 1, 1])), ("b", Body.box([1, 1, 1])), ("ball", Body.sphere(0.5))):
        body.save(f"{name}.npz")
    return lambda text, name="said.csv": (tmp_path / name).write_text(text)


def judge(capsys, *words: str) -> tuple[int, str, str]:
    """Exit status, output and error of the command."""
    status = cli.main(["judge", "--answers", *words])
    return status, *capsys.readouterr()


def test_a_table_is_judged(table, capsys):
    """Rows are numbered, errors are told by kind, and the worst one is written as a program that proves it."""
    table("pose_b,colliding,distance\n3 0 0,false,2\n0.5 0 0,no,0\n2 0 0 0.5 0.5 0.5 0.5,,0.25\n")
    status, out, _ = judge(capsys, "said.csv", "a.npz", "b.npz", "--program", "wrong.py")
    assert status == 1
    assert out.startswith("2 of 3 answers proven wrong\n")
    assert "row 2, A and B: colliding WRONG_FREE by 0.5 m; proven signed distance from -0.5" in out
    assert "row 3, A and B: distance DISTANCE_TOO_SMALL by 0.75 m" in out
    assert "wrong.py proves row 3 wrong in fractions" in out
    with open("wrong.py") as file:
        assert run(file.read()) == {Finding.DISTANCE_TOO_SMALL: pytest.approx(0.75)}


def test_bodies_are_named_in_json(table, capsys):
    """Several bodies are told apart by names; matrices, numbers and null are read; nothing wrong is status 0."""
    T = translation(2.0).ravel().tolist()
    rows = [
        {"body_a": "a", "body_b": "ball", "pose_b": T, "distance": 1.0, "normal": [1, 0, 0], "depth": None},
        {"body_a": "ball", "body_b": "b", "pose_a": [0, 2, 0], "colliding": False, "witness_a": [0, 1.5, 0]},
    ]
    table(json.dumps(rows), "said.json")
    status, out, _ = judge(capsys, "said.json", "a.npz", "b.npz", "ball.npz", "--json")
    found = json.loads(out)
    assert (status, found["pairs"], found["counts"], found["wrong"]) == (0, 2, {"OK": 4}, [])
    rows[1]["witness_a"] = [0, 1.75, 0]
    table(json.dumps(rows), "said.json")
    assert judge(capsys, "said.json", "a.npz", "b.npz", "ball.npz")[0] == 0  # inside is in the body
    rows[1]["colliding"] = True
    table(json.dumps(rows), "said.json")
    status, out, _ = judge(capsys, "said.json", "a.npz", "b.npz", "ball.npz", "--json", "--tolerance", "0.1")
    (wrong,) = json.loads(out)["wrong"]
    assert (status, wrong["row"], wrong["bodies"]) == (1, 2, ["ball", "b"])
    assert wrong["wrong"]["colliding"]["finding"] == "WRONG_COLLIDING"
    assert wrong["wrong"]["colliding"]["at_least"] == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "said.csv: expected answers, found none"),
        ("distance\n", "said.csv: expected answers, found none"),
        ("pose_b\n1 2 3\n", "said.csv: expected a column of answers, one of colliding, distance"),
        ("distence\n1\n", "said.csv: expected columns from body_a, .*; found 'distence'"),
        ("distance,distance\n1,2\n", "said.csv: expected each column once, found distance, distance"),
        ("distance\n1,2\n", "said.csv, row 1: expected 1 cells as in the header, found 2"),
        ("distance\nfar\n", "said.csv, row 1, distance: expected a number, found 'far'"),
        ("normal\n1 0\n", "said.csv, row 1, normal: expected 3 numbers, found 2"),
        ("distance,pose_b\n1,1 2\n", "said.csv, row 1, pose_b: expected 3, 7 or 16 numbers, found 2"),
        ("distance,pose_b\n1,0 0 0 1 1 0 0\n", "said.csv, row 1, pose_b: expected a unit quaternion"),
        ("distance,body_a\n1,c\n", "said.csv, row 1: body_a: expected one of A, B, a, b, found 'c'"),
    ],
)
def test_bad_tables_are_refused(text: str, message: str, table, capsys):
    """Each message says where, what was expected and what was found; the exit status is 2."""
    table(text)
    status, out, err = judge(capsys, "said.csv", "a.npz", "b.npz")
    assert (status, out) == (2, "")
    assert re.search(message, err), err


def test_other_bad_files_are_refused(table, capsys):
    """Endings, JSON of another form, keys twice, and text that is none."""
    for name, text, message in (
        ("said.txt", "1", "expected a .csv or .json file, found .txt"),
        ("said.json", '{"distance": 1}', "expected a list of objects, one for each pair"),
        ("said.json", '[{"distance": 1, "distance": 2}]', "distance"),
        ("said.json", '[{"distance": {"m": 1}}]', "expected numbers, found"),
        ("said.json", "[", "expected"),
    ):
        table(text, name)
        status, _, err = judge(capsys, name, "a.npz", "b.npz")
        assert status == 2
        assert message in err


@pytest.mark.parametrize("option", [["--scale", "0.001"], ["--meshes", "hull"]])
def test_options_of_meshes_are_refused_for_saved_bodies(table, capsys, option):
    """A saved body has its size and its pieces; an ignored factor would make right answers wrong."""
    table("distance\n1\n")
    status, out, err = judge(capsys, "said.csv", "a.npz", "b.npz", *option)
    assert (status, out) == (2, "")
    assert f"{option[0]}: expected meshes to make bodies of, found saved bodies only" in err


# -- conventions --------------------------------------------------------------------------------


def in_frame(T: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Points of the world in the frames of poses."""
    return np.einsum("nji,nj->ni", T[:, :3, :3], points - T[:, :3, 3])


def test_conventions_that_explain_all_errors_are_named(monkeypatch):
    """Reversed normals, other units, exchanged witnesses and witnesses in other frames are named in one sentence."""
    _, a, Ta, b, Tb = pairs_of("ball 20", 40)
    right = answers(a, Ta, b, Tb)
    x, y = right["witness_a"], right["witness_b"]
    assert judge_answers(a, Ta, b, Tb, **right).hints == ()
    for changed, sentence in (
        ({"normal": -right["normal"]}, "wrong normals point the other way, from b to a."),
        ({"distance": 1000 * right["distance"]}, "wrong distances are right in millimetres."),
        ({"depth": 100 * right["depth"] * (1 + 1e-5)}, "wrong depths are right in centimetres."),
        ({"witness_a": x / 0.0254, "witness_b": y / 0.0254}, "wrong witnesses are right in inches."),
        ({"witness_a": y, "witness_b": x}, "wrong witnesses are right with a and b exchanged."),
        ({"witness_a": in_frame(Ta, x), "witness_b": in_frame(Ta, y)}, "wrong witnesses are right in the frame of a."),
        ({"witness_a": in_frame(Tb, x), "witness_b": in_frame(Tb, y)}, "wrong witnesses are right in the frame of b."),
        ({"witness_a": in_frame(Ta, x), "witness_b": in_frame(Tb, y)}, "are right in the frames of their own bodies."),
        ({"witness_a": in_frame(Tb, x), "witness_b": in_frame(Ta, y)}, "are right in the frames of the other bodies."),
    ):
        said = judge_answers(a, Ta, b, Tb, **{**right, **changed})
        (hint,) = said.hints
        # Units make no difference for pairs whose truth is nearly zero.
        count = r"(All|\d+ of) \d+ " if sentence.split()[-1].rstrip(".") in judging.UNITS else r"All \d+ "
        assert re.match(count, hint), hint
        assert hint.endswith(sentence)
        with monkeypatch.context() as without:  # the findings stay
            without.setattr(judging, "TRIED", np.inf)
            bare = judge_answers(a, Ta, b, Tb, **{**right, **changed})
        assert bare.hints == ()
        assert np.array_equal(bare.kinds, said.kinds)
        assert np.array_equal(bare.excess, said.excess)


def test_errors_that_no_convention_explains_have_no_hint():
    """Random normals, lengths off by random factors, single errors, and errors in both directions are not explained."""
    _, a, Ta, b, Tb = pairs_of("boxes", 40)
    right, rng = answers(a, Ta, b, Tb), np.random.default_rng(0)
    few, half = right["normal"].copy(), right["normal"].copy()
    few[:3] *= -1
    half[::2] *= -1
    for normal in (rng.normal(size=(40, 3)), few):
        assert judge_answers(a, Ta, b, Tb, **{**right, "normal": normal}).hints == ()
    (tried,) = judge_answers(a, Ta, b, Tb, normal=half).conventions
    assert tried.right == tried.wrong  # explains the reversed half, and spoils the other one
    assert tried.spoilt > 10
    assert judge_answers(a, Ta, b, Tb, normal=half).hints == ()
    factors = rng.uniform(2.0, 1000.0, 40)
    assert judge_answers(a, Ta, b, Tb, distance=factors * right["distance"]).hints == ()


@pytest.mark.parametrize(
    ("apart", "said"),
    [
        (3.0, {"distance": [7000.0, 9000.0, 5000.0]}),  # thousandths of them are wrong as well
        (3.0, {"depth": [2.0, 3.0, 6.0]}),
        (1.0, {"distance": [2e-4, 1e-4, 3e-4]}),  # noise: any large unit would make it right
    ],
)
def test_units_that_only_shrink_errors_are_no_hint(apart, said):
    """A unit explains an error only if the answer is right in it, and is not for being small."""
    ball = Body.sphere(1.0)
    judgement = judge_answers(ball, None, ball, translation(apart), **{k: np.array(v) for k, v in said.items()})
    assert (judgement.excess > 0).any(axis=-1).all()
    assert judgement.hints == ()


def test_hints_of_a_table(table, capsys):
    """Counts of rows about different bodies are added, and quaternions are tried in the other order."""
    box = Body.box([1.0, 0.5, 0.25])
    box.save("a.npz")
    rng, rows = np.random.default_rng(3), ["body_a,body_b,pose_b,distance,normal"]
    reordered = [rows[0]]
    for k in range(8):
        w, x, y, z = ((q := rng.normal(size=4)) / np.linalg.norm(q)).tolist()
        place, body, name = np.eye(4), *((box, "a") if k % 2 else (Body.box([1, 1, 1]), "b"))
        place[:3, :3] = from_quaternion([w, x, y, z], "q")
        place[:3, 3] = rng.normal(size=3) + 1.5
        found = loewner.distance(box, None, body, place, exact=True)
        head, place = f"a,{name},", " ".join(map(repr, place[:3, 3].tolist()))
        normal = " ".join(map(repr, (-found.normal).tolist()))
        rows.append(f"{head}{place} {w!r} {x!r} {y!r} {z!r},{float(found.distance)!r},{normal}")
        reordered.append(f"{head}{place} {x!r} {y!r} {z!r} {w!r},{float(found.distance)!r},")
    table("\n".join(rows))
    status, out, _ = judge(capsys, "said.csv", "a.npz", "b.npz", "ball.npz")
    assert status == 1
    assert "hint      All 8 wrong normals point the other way, from b to a.\n" in out
    table("\n".join(reordered))
    status, out, _ = judge(capsys, "said.csv", "a.npz", "b.npz", "ball.npz", "--json")
    assert status == 1
    assert json.loads(out)["hints"] == ["All 8 wrong rows are right with quaternions in the order qx qy qz qw."]


def test_a_program_of_a_chosen_row(table, capsys):
    """Any row with a finding can be written as a program; other rows, and the option alone, are refused."""
    text = "body_a,body_b,pose_b,distance\na,b,3 0 0,2\na,b,2 0 0,0.5\na,b,2 0 0,0.25\na,ball,2 0 0,0\n"
    table(text)
    files = ("a.npz", "b.npz", "ball.npz")
    status, out, _ = judge(capsys, "said.csv", *files, "--program", "wrong.py", "--row", "2")
    assert status == 1
    assert "wrong.py proves row 2 wrong in fractions" in out
    with open("wrong.py") as file:
        assert run(file.read()) == {Finding.DISTANCE_TOO_SMALL: pytest.approx(0.5)}
    for row, message in (
        ("1", r"--row: expected a row that is proven wrong \(\[2, 3, 4\]\), found 1"),
        ("0", r"--row: expected a row that is proven wrong \(\[2, 3, 4\]\), found 0"),
        ("4", "--row: expected a row whose errors can be proven in fractions: b: expected a body of one polytope"),
    ):
        status, out, err = judge(capsys, "said.csv", *files, "--program", "wrong.py", "--row", row)
        assert (status, out) == (2, "")
        assert re.search(message, err), err
    assert "--row: expected it with --program, found it alone" in judge(capsys, "said.csv", *files, "--row", "2")[2]
    table("pose_b,distance\n3 0 0,2\n")
    assert "row 1: expected body_a, or two files of bodies, found neither" in judge(capsys, "said.csv", "a.npz")[2]
    assert "is proven wrong (none), found 1" in judge(
        capsys, "said.csv", "a.npz", "b.npz", "--program", "wrong.py", "--row", "1"
    )[2]  # fmt: skip


def test_what_was_judged_is_stated(table, capsys):
    """A mesh is judged as its triangles, or as its hull on request; closed convex meshes come with this advice."""
    table("pose_b,depth\n0.75 0 0,0.25\n")
    trimesh.creation.box((1, 1, 1)).export("cube.stl")
    trimesh.creation.annulus(0.1, 0.2, 0.3).export("tube.stl")
    _, out, _ = judge(capsys, "said.csv", "cube.stl", "tube.stl")
    advice = "convex: with --meshes hull, its depths are proven, too"
    assert f"judged    cube: solid, 12 triangles ({advice}); tube: solid, " in out
    assert out.count(advice) == 1
    _, out, _ = judge(capsys, "said.csv", "cube.stl", "a.npz", "--meshes", "hull", "--json")
    found = json.loads(out)
    assert found["bodies"] == {"cube": "polytope, 8 vertices", "a": "polytope, 8 vertices"}
    assert found["counts"] == {"OK": 1}
