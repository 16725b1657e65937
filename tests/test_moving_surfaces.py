"""Motions of links that are surfaces: what is proven holds at samples, and every caller tests where they start."""

import functools

import numpy as np
import pytest
import trimesh

import capi
from checker_oracle import robot_of
from families import translation
from loewner import Body, CollisionChecker, Joint, LoewnerError, Robot, Scene, Verdict, planners
from loewner._kernels import columns
from loewner.bodies import parts
from loewner.robots.checking.problem import Problem
from moving_surfaces import SLIDES, Case, inverted, joined
from sampling import quick

FREE, COLLIDING, AMBIGUOUS = Verdict.FREE, Verdict.COLLIDING, Verdict.AMBIGUOUS


def campaign(folder, seed, cases, motions, samples):
    """Hold motions against samples; returns how many of all verdicts were free, colliding and ambiguous."""
    counts = np.zeros(3, dtype=int)
    for number in range(cases):
        rng = np.random.default_rng([seed, number])
        case = Case(folder, rng)
        Q = case.starts(rng, motions)
        step = rng.normal(size=Q.shape) * rng.choice([1e-3, 0.05, 0.5], (motions, 1))
        found = case.checker.certify_edges(Q, Q + step)
        counts += np.bincount(found.verdict, minlength=3)
        free, hit = found.verdict == FREE, found.verdict == COLLIDING
        t = np.sort(rng.uniform(size=samples))
        t[[0, -1]] = 0.0, 1.0
        at = np.concatenate([case.robot.between(a, b, t) for a, b in zip(Q[free], (Q + step)[free], strict=True)])
        refuted = case.collides(at).reshape(-1, samples).any(axis=1)
        assert not refuted.any(), (number, np.flatnonzero(free)[refuted])
        where = case.robot.between(Q[hit], (Q + step)[hit], found.fraction[hit])
        assert case.collides(where).all(), number
    return counts


@pytest.mark.parametrize("count", quick(10, 24))
def test_motions_hold_at_samples(tmp_path, count):
    """Of bodies of all kinds, both moving, one inside the other, in whole numbers; and nearly all are decided."""
    free, colliding, ambiguous = campaign(tmp_path, 1, cases=count, motions=25, samples=40)
    assert min(free, colliding) > 100 / 24 * count
    assert ambiguous < 0.03 * (free + colliding)


@pytest.mark.verify
def test_motions_hold_at_many_samples(tmp_path):
    """A hundred thousand of them."""
    free, colliding, ambiguous = campaign(tmp_path, 2, cases=1000, motions=100, samples=100)
    print(f"{free} free, {colliding} colliding, {ambiguous} ambiguous")
    assert ambiguous < 0.03 * (free + colliding)


def test_a_part_that_is_missing_is_noticed(tmp_path, monkeypatch):
    """The campaign above fails if a part of each surface is left out."""
    whole = parts._cut

    def without_one(*arguments):
        cut = whole(*arguments)
        if cut is None:
            return None
        first = np.arange(len(cut.layout) - 1)
        return parts.some(cut, first, np.array([0, len(first)])).packed()

    monkeypatch.setattr(parts, "_cut", without_one)
    with pytest.raises(AssertionError):
        campaign(tmp_path, 1, cases=24, motions=25, samples=40)


# -- starts ---------------------------------------------------------------------------------------


BALL, ROOM = trimesh.creation.icosphere(1, 0.1), trimesh.creation.icosphere(2, 1.0)


@functools.cache
def room(solid=None):
    """The large ball, with an inside or as a skin."""
    return Body.from_surface(ROOM, solid=solid)


@functools.cache
def ball():
    """The small one."""
    return Body.from_surface(BALL)


@functools.cache
def hollow():
    """The large ball with a cavity."""
    return Body.from_surface(trimesh.util.concatenate([ROOM, inverted(trimesh.creation.icosphere(2, 0.8))]))


def held(folder, inner, outer):
    """Checkers with one body inside the other: the inner one moves, the outer one moves, or both."""
    for moving in ("inner", "outer", "both"):
        scene, links = Scene(), {}
        if moving != "outer":
            links["l3"] = inner
        else:
            scene.add("still", inner, translation(0.1, 0.0, 0.0))
        if moving == "inner":
            scene.add("still", outer, translation(0.1, 0.0, 0.0))
        else:
            links["l6"] = outer
        slides = [("prismatic", k % 3 + 3 * (k // 3) if k % 3 else 0, SLIDES[k % 3]) for k in range(6)]
        yield CollisionChecker(robot_of(folder, slides, links), scene)


def edges(checker, a, b):
    return checker.certify_edges(a, b).verdict == FREE


def edges_with_errors(checker, a, b):
    return checker.certify_edges(a, b, joint_error=1e-3).verdict == FREE


def curves(checker, a, b):
    from scipy.interpolate import CubicSpline

    return checker.certify_trajectory(CubicSpline([0.0, 0.5, 1.0], [a, 0.4 * a + 0.6 * b, b])).verdict == FREE


def motions_in_time(checker, a, b):
    checker.scene.add("far", Body.sphere(0.1), translation(50.0, 0.0, 0.0))
    checker.scene.follow("far", [0.0, 1.0], [translation(50.0, 0.0, 0.0), translation(51.0, 0.0, 0.0)])
    return checker.certify_edges(a, b, t0=0.0, t1=1.0).verdict == FREE


def first_contact(checker, a, b):
    from scipy.interpolate import CubicSpline

    return checker.first_contact(CubicSpline([0.0, 0.5, 1.0], [a, 0.4 * a + 0.6 * b, b])).verdict == FREE


def plans(checker, a, b):
    return planned(lambda: planners.plan(checker, a, b))


def other_planners(checker, a, b):
    pytest.importorskip("ompl")
    return planned(lambda: planners.plan(checker, a, b, planner="RRTConnect"))


def shortened(checker, a, b):
    return planned(lambda: planners.shorten(checker, [a, (a + b) / 2 + 0.01, b]))


def blends(checker, a, b):
    path = [a, (a + b) / 2 + 0.01, b]
    return planned(lambda: planners.trajectory(checker.robot, path, velocity=1.0, acceleration=1.0, checker=checker))


def roadmaps(checker, a, b):
    return planned(lambda: planners.roadmap(checker, samples=np.stack([a, b])).path(a, b))


def planned(call, error=LoewnerError):
    try:
        call()
    except error:
        return False
    return True


CALLERS = (edges, edges_with_errors, curves, motions_in_time, first_contact, plans, other_planners, shortened, blends,
           roadmaps)  # fmt: skip


@pytest.mark.parametrize("caller", CALLERS)
@pytest.mark.parametrize("count", quick(1, 2))
def test_what_begins_inside_a_solid_is_not_free(tmp_path, caller, count):
    """Whichever of the two moves. In a surface without an inside, and in a cavity, it is free."""
    a, b = np.zeros(6), np.full(6, 0.1)
    for inner in (ball(), Body.sphere(0.1))[:count]:
        for checker in held(tmp_path, inner, room()):
            assert not caller(checker, a, b), "a solid"
        for outer in (room(False), hollow()):
            for checker in held(tmp_path, inner, outer):
                assert caller(checker, a, b), "no solid"


@pytest.mark.parametrize("caller", CALLERS)
def test_a_forgotten_start_is_noticed(tmp_path, monkeypatch, caller):
    """The test above fails for a caller that does not test the start; planners refuse such a start themselves."""
    monkeypatch.setattr(Problem, "starts_matter", False)
    a, b = np.zeros(6), np.full(6, 0.1)
    free = [caller(checker, a, b) for checker in held(tmp_path, ball(), room())]
    assert free == [caller not in (plans, other_planners, roadmaps)] * 3


def test_ranges_of_a_body_inside_another_one(tmp_path):
    """A body inside a solid collides over the whole range of its joint; in a surface without an inside, never."""
    robot = robot_of(tmp_path, [("prismatic", 0, SLIDES[0])], {"l1": Body.sphere(0.1)})
    limits = {robot.configuration_names[0]: (0.0, 0.02)}
    for solid in (True, False):
        scene = Scene()
        scene.add("room", room(solid))
        (row,) = robot.prove_pairs([("l1", "room")], limits=limits, scene=scene)
        assert str(row.verdict) in (("ALWAYS", "CAN", "SOMETIMES") if solid else ("NEVER",))


def test_c_tests_where_motions_start(tmp_path):
    """Edges, their short form, curves and plans; a saved cell, and one whose bodies have changed, decide as Python."""
    a, b = np.zeros(6), np.full(6, 0.1)
    curve = np.stack([a, 0.3 * a + 0.7 * b, b])[None]
    for solid in (True, False):
        for checker in held(tmp_path, ball(), room(solid)):
            checker.save(tmp_path / "cell.lwn")
            cell = capi.Checker(tmp_path / "cell.lwn")
            for _ in range(2):
                assert (cell.certify(a, b)[0] == FREE).all() != solid
                assert cell.free(a, b).all() != solid
                assert (cell.certify_curves(curve)[0] == FREE).all() != solid
                assert planned(lambda cell=cell: cell.plan(a, b), capi.Error) != solid
                if "still" in checker.scene:
                    cell.set_present("still", False)
                    assert cell.free(a, b).all()
                    cell.set_present("still", True)


def test_clearances_keep_clouds_in_parts_beside_solids(tmp_path):
    """A solid counts as a whole, since distances inside it are negative; other surfaces do not. C decides likewise."""
    rng = np.random.default_rng(0)
    robot = robot_of(tmp_path, [("prismatic", 0, SLIDES[0])], {"l1": Body.sphere(0.05)})
    points = rng.uniform([-1, -1, -0.1], [1, 1, 0.1], (500, 3))
    points = points[np.hypot(*points[:, :2].T) > 0.6]
    scene, alone = Scene(), Scene()
    for each in (scene, alone):
        each.add("cloud", Body.from_cloud(points, radius=0.01))
    scene.add("solid", room(), translation(0.0, 0.0, 3.0))
    Q = np.linspace(-0.3, 0.3, 7)[:, None]
    checker = CollisionChecker(robot, scene)
    bounds = checker.clearance(Q)
    np.testing.assert_allclose(bounds, CollisionChecker(robot, alone).clearance(Q), atol=1e-3)
    assert bounds.min() > 0.1
    checker.save(tmp_path / "cell.lwn")
    np.testing.assert_allclose(capi.Checker(tmp_path / "cell.lwn").clearance(Q)[0], bounds, rtol=1e-12)
    scene.move("solid", translation(0.0, 0.0, 0.0))
    assert checker.clearance(Q).max() < 0


def test_a_ball_in_a_tube_is_proven(tmp_path):
    """However fine the ball, with a hundredfold of the tolerance as play, over long and short ways."""
    tube = Body.from_surface(trimesh.creation.annulus(0.05, 0.07, 1.0, sections=64))
    for finer in (1, 3):
        ball = Body.from_surface(trimesh.creation.icosphere(finer, 0.05 * np.cos(np.pi / 64) - 1e-3))
        scene = Scene()
        scene.add("tube", tube)
        checker = CollisionChecker(robot_of(tmp_path, [("prismatic", 0, SLIDES[2])], {"l1": ball}), scene)
        found = checker.certify_edges([[-0.4], [0.0], [0.0]], [[0.4], [0.01], [1e-4]])
        assert (found.verdict == FREE).all()


def test_rounding_is_bounded_for_all_triangles(monkeypatch):
    """Shells near the origin, whose parts no plane parts, and far away cubes, two of which collide at a skew pose.

    If the bounds on rounding are for the parts alone, which are near, this contact is overlooked.
    """
    scale, far, depth, beside, skew = 0.01, 1000.3, 2e-4, 1e-4, 4.9e-7
    bowl = trimesh.creation.icosphere(3, 3.0)
    one = [trimesh.Trimesh(bowl.vertices, bowl.faces[bowl.triangles_center[:, 2] < 0.3], process=False)]
    other = [trimesh.creation.icosphere(3, 2.4).apply_translation([0, 0, -0.591])]
    for k in range(30):
        at, low = np.array([0.2 * (k % 6), 0.2 * (k // 6), far]), 0.015 * (k > 0)
        one.append(trimesh.creation.box((0.05,) * 3).apply_translation(at - [0, 0, 0.025 + low]))
        above = at + [0, 0, 0.025 - depth * (k == 0) - beside]
        other.append(trimesh.creation.box((0.04, 0.04, 0.05)).apply_translation(above))
    (a, faces), (b, others) = joined(*one), joined(*other)
    robot = Robot.from_links(
        {"base": None, "arm": Body.from_surface((b * scale, others), solid=False)},
        [Joint("s", "prismatic", "base", "arm", translation(z=beside * scale), axis=[1, 0, 0], lower=-1, upper=1)],
    )
    made = parts.kernel_of_parts

    def with_own_reaches(p, tree, around, _):
        kernel = made(p, tree, around, 0.0)
        for k, corners in enumerate(around):
            kernel.table[k, columns.REACH] = kernel.hot[k, columns.REACH] = np.linalg.norm(corners, axis=1).max()
        return kernel

    for forgetful in (False, True):
        if forgetful:
            monkeypatch.setattr(parts, "kernel_of_parts", with_own_reaches)
            parts._known.clear()
        surface = Body.from_surface((a * scale / [1, 1, 1 + skew], faces), solid=False)
        scene = Scene()
        scene.add("standing", surface, np.diag([1.0, 1.0, 1.0 + skew, 1.0]))
        checker = CollisionChecker(robot, scene)
        assert checker.collide([0.0])
        assert checker.certify_edges([0.0], [1e-3 * scale]).verdict == (FREE if forgetful else COLLIDING)
    parts._known.clear()
