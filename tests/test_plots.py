"""Figures show what they are given: what touches is red, bars and lines are where the numbers are, all is shown."""

import sys

import numpy as np
import pytest
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d.art3d import Poly3DCollection
from scipy.stats import binomtest

from families import translation
from gantry import gantry
from loewner import (
    Body,
    CollisionChecker,
    InputError,
    MissingExtraError,
    Robot,
    Scene,
    Settled,
    UnknownNameError,
    distance,
    planners,
    plots,
)


@pytest.fixture
def checker(tmp_path):
    urdf, srdf = gantry(tmp_path)
    scene = Scene()
    scene.add("wall", Body.box([0.1, 4.0, 1.0]))
    scene.add("held", Body.box([0.05, 0.05, 0.05]))
    scene.attach("held", "ball", translation(z=0.2))
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
    """The axes reach around the whole robot and the whole scene."""
    ax = plots.configuration(checker, [-0.6, 0.0, np.pi])
    assert ax.get_xlim()[0] < -1.05
    assert ax.get_ylim()[0] <= -2
    assert ax.get_ylim()[1] >= 2


def test_one_configuration_only(checker):
    """A figure shows one configuration; several are refused."""
    with pytest.raises(InputError, match=r"q: expected one configuration, shape \(3,\)"):
        plots.configuration(checker, np.zeros((2, 3)))


@pytest.mark.parametrize("x", [1.5, 0.25])
def test_near_points_of_a_pair(x):
    """The line drawn joins the exact near points, or the ends of the depth; the legend says which and how far."""
    a, b, T = Body.box([1, 1, 1]), Body.sphere(0.25), translation(x)
    ax = plots.pair(a, None, b, T)
    found = distance(a, None, b, T, exact=True)
    (line,) = ax.get_lines()
    np.testing.assert_allclose(np.array(line.get_data_3d()).T, [found.witness_a, found.witness_b])
    assert f"{'distance' if x > 1 else 'depth'} {abs(found.distance):.4g} m" in [
        text.get_text() for text in ax.get_legend().get_texts()
    ]
    assert not plots.pair(a, None, b, T, near=False).get_lines()


# -- what was counted and measured ---------------------------------------------------------------


def bars(ax):
    """Of each bar: the group it belongs to, and where it begins and ends, by the tier's label."""
    groups = [text.get_text() for text in ax.get_yticklabels()]
    return {
        (container.get_label(), groups[k]): (bar.get_x(), bar.get_x() + bar.get_width())
        for container in ax.containers
        for k, bar in enumerate(container)
        if bar.get_width()
    }


def test_tiers_are_shares_of_each_group():
    """Each bar begins where the cheaper tier ends, and the last ends at 100 %; the first group is on top."""
    ax = plots.tiers(
        {"arm": Settled(10, 20, 0, 10, 40, 20), "pairs": {"colliding_by_ellipsoids": 3, "free_by_ellipsoids": 1}}
    )
    drawn = bars(ax)
    expected = {
        ("free: bounds", "arm"): (0, 10),
        ("free: outer ellipsoids", "arm"): (10, 30),
        ("free: exact search", "arm"): (30, 40),
        ("colliding: inner ellipsoids", "arm"): (40, 80),
        ("colliding: exact search", "arm"): (80, 100),
        ("free: outer ellipsoids", "pairs"): (0, 25),
        ("colliding: inner ellipsoids", "pairs"): (25, 100),
    }
    assert drawn.keys() == expected.keys()
    for key, ends in expected.items():
        assert drawn[key] == pytest.approx(ends), key
    assert ax.get_ylim()[0] > ax.get_ylim()[1]
    legend = [text.get_text() for text in ax.get_legend().get_texts()]
    assert legend == [label for label, _ in plots.TIERS.values()]


def test_tiers_of_a_checker(checker):
    """What `CollisionChecker.tiers` returns can be drawn as it is."""
    settled = checker.tiers(checker.robot.random_configurations(200))
    ends = [end for _, end in bars(plots.tiers({"gantry": settled})).values()]
    assert max(ends) == pytest.approx(100)
    assert 100 * settled.free / settled.total in [pytest.approx(end) for end in ends]


def through_the_wall():
    """The ball slides along x through the middle of the wall in two pieces; the third piece is free."""
    return planners.ControllerPoints([0, 1, 2, 3], [[-0.5, 0, 1.5], [0, 0, 1.5], [0.5, 0, 1.5], [0.9, 0, 1.5]])


@pytest.fixture
def ball_and_wall(checker):
    """A wall 0.1 m thick and so short that only the ball meets it; the rod beside the ball passes its end."""
    scene = Scene()
    scene.add("wall", Body.box([0.1, 0.2, 1.0]))
    return CollisionChecker(checker.robot, scene)


def line_of(ax, label):
    """The line of a pair in millimetres, at its times."""
    (line,) = [line for line in ax.get_lines() if line.get_label() == label]
    return np.array(line.get_xydata()).T


def spans_of(ax):
    """From and to, of the coloured backgrounds."""
    return [(span.get_x(), span.get_x() + span.get_width()) for span in ax.patches]


def test_distances_along_a_trajectory(ball_and_wall):
    """Backgrounds are the pieces that collide, the line is the distance known from geometry, the dot its least."""
    ax = plots.trajectory(ball_and_wall, through_the_wall())
    assert ax.get_title() == "COLLIDING"
    assert spans_of(ax) == [(0, 1), (1, 2)]
    t, d = line_of(ax, "ball and wall")
    # At x the ball is 0.15 - |x| deep, as long as the way out along x is the shortest.
    wanted = 1e3 * (np.abs(np.where(t < 2, (t - 1) / 2, 0.5 + 0.4 * (t - 2))) - 0.15)
    np.testing.assert_allclose(d, wanted, atol=1e-5)
    at, least = line_of(ax, "150 mm deep at 1 s")
    np.testing.assert_allclose([at[0], least[0]], [1, -150], atol=1e-2)
    texts = [text.get_text() for text in ax.get_legend().get_texts()]
    assert texts.count("collides in this piece") == 1
    low, high = ax.get_ylim()
    assert low < -150
    assert high > d.max()


def test_a_path_is_drawn_by_numbers(ball_and_wall):
    """A path has the picture of the curve that reaches its configurations at the times 0, 1, 2, and so on."""
    points = through_the_wall()
    path, curve = plots.trajectory(ball_and_wall, points.positions), plots.trajectory(ball_and_wall, points)
    assert (path.get_xlabel(), curve.get_xlabel()) == ("number of the configuration", "time, s")
    assert spans_of(path) == spans_of(curve)
    np.testing.assert_allclose(*(line_of(ax, "ball and wall") for ax in (path, curve)), atol=1e-9)
    with pytest.raises(InputError, match=r"path: expected shape \(k, 3\) with k >= 2, found \(1, 3\)"):
        plots.trajectory(ball_and_wall, points.positions[:1])


def test_a_trajectory_may_be_free_or_ambiguous(ball_and_wall):
    """A free curve has distances and a worst moment, too; with an error of the joints it is ambiguous."""
    aside = planners.ControllerPoints([0, 2], [[-0.5, 0.5, 1.5], [0.5, 0.5, 1.5]])
    ax = plots.trajectory(ball_and_wall, aside)
    assert (ax.get_title(), ax.get_xlim(), spans_of(ax)) == ("FREE", (0, 2), [])
    t, d = line_of(ax, "ball and wall")
    gap = 1e3 * (np.hypot(np.maximum(np.abs((t - 1) / 2) - 0.05, 0), 0.4) - 0.1)
    np.testing.assert_allclose(d, gap, atol=1e-5)
    assert any(label.startswith("300 mm apart at ") for label in (line.get_label() for line in ax.get_lines()))
    ax = plots.trajectory(ball_and_wall, aside, joint_error=[0, 0.31, 0])
    assert ax.get_title() == "AMBIGUOUS"
    assert spans_of(ax) == [(0, 2)]
    np.testing.assert_allclose(line_of(ax, "ball and wall")[1].min(), 300, atol=1e-3)


def test_costs_are_where_they_were_measured():
    """Points at (size, seconds), none for NaN; a single number is a line across."""
    ax = plots.costs([1, 10, 100], {"ours": [3e-6, 4e-7, 5e-8], "theirs": [np.nan, 2e-6, 2e-6], "level": 1e-6})
    ours, theirs, level = ax.get_lines()
    np.testing.assert_array_equal(ours.get_xydata(), [[1, 3e-6], [10, 4e-7], [100, 5e-8]])
    np.testing.assert_array_equal(theirs.get_ydata(), [np.nan, 2e-6, 2e-6])
    assert set(level.get_ydata()) == {1e-6}
    assert (ours.get_color(), ours.get_marker()) != (theirs.get_color(), theirs.get_marker())
    assert (ax.get_xscale(), ax.get_yscale()) == ("log", "log")
    assert ax.yaxis.get_major_formatter()(4e-7) == "400 ns"
    assert [text.get_text() for text in ax.get_legend().get_texts()] == ["ours", "theirs", "level"]


def intervals(ax):
    """Of each rule and family: dot, and both ends of its line, in percent."""
    families = [text.get_text() for text in ax.get_yticklabels()]
    found = {}
    for container in ax.containers:
        dots, _, (lines,) = container.lines
        for x, y, ends in zip(*dots.get_data(), lines.get_segments(), strict=True):
            found[container.get_label(), families[round(y)]] = x, *ends[:, 0]
    return found


def test_accuracy_has_wilsons_intervals():
    """Dots at the shares, lines as far as scipy's intervals; who was asked nothing gets no dot."""
    counts = {"f": {"balls": (90, 100), "plates": (0, 5)}, "product": {"plates": (5, 5), "rods": (0, 0)}}
    ax = plots.accuracy(counts)
    drawn = intervals(ax)
    asked = {(rule, name): pair for rule, found in counts.items() for name, pair in found.items() if pair[1]}
    assert drawn.keys() == asked.keys()
    for key, (right, total) in asked.items():
        interval = binomtest(right, total).proportion_ci(0.95, method="wilson")
        np.testing.assert_allclose(drawn[key], [100 * right / total, 100 * interval.low, 100 * interval.high])
    assert [text.get_text() for text in ax.get_yticklabels()] == ["balls", "plates", "rods"]
    assert [text.get_text() for text in ax.get_legend().get_texts()] == ["f", "product"]


@pytest.mark.parametrize(
    ("call", "error", "message"),
    [
        (lambda: plots.tiers({}), InputError, "counts: expected one entry or more"),
        (lambda: plots.tiers([1, 2]), InputError, r"counts: expected a mapping by name, found \[1, 2\]"),
        (lambda: plots.tiers({"arm": {"free_by_search": -1}}), InputError, "'free_by_search'.*>= 0, found -1"),
        (lambda: plots.tiers({"arm": Settled(0, 0, 0, 0, 0, 0)}), InputError, "'arm'.*above zero, found none"),
        (lambda: plots.tiers({"arm": {"free_by_serch": 1}}), UnknownNameError, "did you mean 'free_by_search'"),
        (lambda: plots.costs([], {"x": 1.0}), InputError, "sizes: expected one or more"),
        (lambda: plots.costs([1, 0], {"x": 1.0}), InputError, "sizes: expected numbers > 0, found 0.0 at index"),
        (lambda: plots.costs([1, 2], {}), InputError, "seconds: expected one entry or more"),
        (lambda: plots.costs([1, 2], {"x": [1.0]}), InputError, r"\['x'\]: expected shape \(2,\).*found shape \(1,\)"),
        (lambda: plots.costs([1, 2], {"x": [1.0, -1.0]}), InputError, "above zero"),
        (lambda: plots.costs([1, 2], {"x": [np.nan] * 2}), InputError, "not for all"),
        (lambda: plots.accuracy({"rule": {}}), InputError, r"\['rule'\]: expected one entry or more"),
        (lambda: plots.accuracy({"rule": {"balls": (3, 2)}}), InputError, "right <= asked, found 3 of 2"),
        (lambda: plots.accuracy({"rule": {"balls": 0.9}}), InputError, r"\(right, asked\), found 0.9"),
        (lambda: plots.trajectory("arm", None), InputError, "checker: expected .*CollisionChecker, found str"),
        (lambda: plots.configuration("arm", [0]), InputError, "checker: expected .*CollisionChecker, found str"),
    ],
)
def test_bad_input_is_refused(call, error, message):
    """Every bad argument of a figure is refused by name, with what was found."""
    with pytest.raises(error, match=message):
        call()


@pytest.mark.parametrize(
    "draw",
    [
        lambda: plots.body(Body.sphere(1)),
        lambda: plots.tiers({"arm": {"free_by_search": 1}}),
        lambda: plots.costs([1], {"x": 1.0}),
        lambda: plots.accuracy({"rule": {"balls": (1, 2)}}),
    ],
)
def test_missing_matplotlib_is_told(draw, monkeypatch):
    """Without matplotlib every figure's error names the extra to install."""
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    with pytest.raises(MissingExtraError, match=r'pip install "loewner\[plots\]"'):
        draw()


def test_drawn_into_axes_of_ones_own():
    """A figure that is given axes draws into them and returns them."""
    one, two, three = Figure().subplots(1, 3)
    assert plots.costs([1], {"y": 1.0}, ax=one) is one
    assert plots.accuracy({"rule": {"balls": (1, 2)}}, ax=two) is two
    assert plots.tiers({"arm": {"free_by_search": 1}}, ax=three) is three


def test_the_same_figure_is_the_same_file(tmp_path):
    """SVG carries neither the date nor names drawn at random."""
    first, second = (
        plots.save(plots.tiers({"arm": {"free_by_search": 1}}), tmp_path / f"{k}.svg").read_bytes() for k in range(2)
    )
    assert first == second
