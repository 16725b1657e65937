"""The paper's experiment: data set, detectors against naive ones, tables, report."""

import json
import math
import re
import stat
import sys

import numpy as np
import pytest
from scipy.stats import binomtest, chi2_contingency, kstest

from loewner import (
    Bodies,
    Body,
    ConvergenceError,
    FileError,
    InputError,
    MissingExtraError,
    UnknownNameError,
    Verdict,
    classify,
    contact_function,
    distance,
    mvce,
    near_points,
    paper,
)
from loewner._base._files import write_atomically
from loewner._base._proportions import wilson
from loewner.paper import Confusion, detectors, figures, fitting, report, sheets, tables
from oracles import hull, pack, signed_distances
from sampling import quick


@pytest.fixture(scope="module", params=quick(250, 1000))
def outcome(request, tmp_path_factory):
    """One run of that many pairs with every file written, and what it told about its progress."""
    folder = tmp_path_factory.mktemp("paper")
    told = []
    experiment = paper.run(
        request.param,
        seed=0,
        out=folder / "new" / "out",
        json=folder / "counts.json",
        progress=lambda *step: told.append(step),
    )
    return experiment, folder, told


@pytest.fixture(scope="module")
def experiment(outcome):
    return outcome[0]


# -- the data set ----------------------------------------------------------------------------------


def test_same_seed_same_pairs_and_a_longer_set_begins_with_the_shorter():
    """Equal seeds make equal pairs, and a longer data set begins with the shorter one."""
    short, long = paper.sample(10, 7), paper.sample(25, 7)
    assert len(short) == 10
    assert (short.points_1 == long.points_1[:10]).all()
    assert (short.points_2 == long.points_2[:10]).all()
    assert (paper.sample(10, 8).points_1 != short.points_1).all()


@pytest.mark.parametrize(("name", "power"), [("radius", 1), ("volume", 3)])
def test_points_are_spread_as_named(name, power):
    """|x|^power is uniform, the direction isotropic, the shift uniform along [1, 1, 1]."""
    data = paper.sample(500, 3, name)
    assert data.points_1.shape == data.points_2.shape == (500, 20, 3)
    own = data.points_2 - (data.shift / np.sqrt(3))[:, None, None]
    for points in (data.points_1, own):
        radius = np.linalg.norm(points, axis=-1).ravel()
        assert kstest(radius**power, "uniform").pvalue > 1e-3
        direction = points.reshape(-1, 3) / radius[:, None]
        for axis in np.vstack([np.eye(3), np.ones(3) / np.sqrt(3)]):
            assert kstest(direction @ axis, "uniform", args=(-1, 2)).pvalue > 1e-3
    assert kstest(data.shift / 2, "uniform").pvalue > 1e-3


# -- truth and detectors ---------------------------------------------------------------------------


@pytest.mark.slow("the first with the experiment of all tests here, and its oracle compiles")
@pytest.mark.parametrize("n", quick(60, 200))
def test_truth_agrees_with_separating_axes(experiment, n):
    """The experiment's exact answers are those of the separating-axis oracle."""
    data = experiment.data
    pool_1, pool_2 = (pack(hull(p) for p in points[:n]) for points in (data.points_1, data.points_2))
    index, identity = np.arange(n), np.broadcast_to(np.eye(4), (n, 4, 4))
    gap, _ = signed_distances(pool_1, index, identity, pool_2, index, identity)
    assert ((gap <= 0) == experiment.truth[:n]).all()


def test_certain_answers_are_never_wrong(experiment):
    """Errors occur in the ambiguous case only, but for the finite precision of detectors 2 and 4's line check."""
    for result in (experiment.detectors[2], experiment.estimate):
        sure = ~result.answers.ambiguous
        assert (result.answers.collides[sure] == experiment.truth[sure]).all()
        assert (result.all.fp, result.all.fn) == (result.ambiguous.fp, result.ambiguous.fn)


def hit(E, start, e):
    """Where the ray leaves an ellipsoid, as a root of its quadratic."""
    p, q = np.linalg.solve(E.factor, start - E.center), np.linalg.solve(E.factor, e)
    return max(np.roots([q @ q, 2 * p @ q, p @ p - 1]).real)


def printed_f(outer_1, outer_2, v1i, v2i):
    """The paper's f with its two branches."""
    e = v2i - v1i
    v1c, v2c = v1i + hit(outer_1, v1i, e) * e, v2i - hit(outer_2, v2i, -e) * e
    near, far = np.linalg.norm(v1i - v2i), np.linalg.norm(v1c - v2c)
    return (near + far) / 2 if (v1i - v2i) @ (v1c - v2c) >= 0 else (near - far) / 2


def naive_flow(pairs, k, method, overlaps):
    """Figure 3 for one pair: (collides, ambiguous)."""
    inner_1, outer_1, inner_2, outer_2 = (getattr(pairs, name)[k] for name in ELLIPSOIDS)
    if not overlaps(outer_1, outer_2):
        return False, False
    if overlaps(inner_1, inner_2):
        return True, False
    near = near_points(inner_1, inner_2, method=method)
    return printed_f(outer_1, outer_2, near.point_1, near.point_2) <= 0, True


METHODS = {2: "lin-han", 3: "rimon-boyd", 4: "center-line"}
ELLIPSOIDS = ("inner_1", "outer_1", "inner_2", "outer_2")


@pytest.mark.parametrize(("detector", "method"), METHODS.items())
def test_detectors_follow_the_paper(experiment, detector, method):
    """Each compiled detector is figure 3 with its near points and its own overlap check."""
    overlaps = {
        2: lambda a, b: near_points(a, b, method="lin-han").distance == 0,
        3: lambda a, b: contact_function(a, b) <= 1,
        4: lambda a, b: near_points(a, b, method="center-line").distance == 0,
    }[detector]
    answers = experiment.detectors[detector - 1].answers
    for k in range(150):
        assert (answers.collides[k], answers.ambiguous[k]) == naive_flow(experiment.pairs, k, method, overlaps)


@pytest.mark.parametrize("detector", METHODS)
def test_ambiguous_answers_are_the_sign_of_f(experiment, detector):
    """Where a detector's own checks leave a pair open, it says what the distance estimate of its near points says."""
    answers = experiment.detectors[detector - 1].answers
    p = experiment.pairs.take(np.flatnonzero(answers.ambiguous))
    f = paper.distance_estimate(p.inner_1, p.outer_1, p.inner_2, p.outer_2, METHODS[detector])
    assert ((f <= 0) == answers.collides[answers.ambiguous]).all()


@pytest.mark.parametrize("method", METHODS.values())
def test_f_within_the_bounds_is_better_than_a_coin(experiment, method):
    """Within the certified bounds f obeys every certified verdict, and is right about most of the other pairs."""
    p, a, b = experiment.pairs, experiment.bodies_1, experiment.bodies_2
    bounds, verdict = distance(a, None, b, None), classify(a, None, b, None)
    f = np.clip(paper.distance_estimate(p.inner_1, p.outer_1, p.inner_2, p.outer_2, method), bounds.lower, bounds.upper)
    assert (f[verdict == Verdict.FREE] > 0).all()
    assert (f[verdict == Verdict.COLLIDING] <= 0).all()
    unsure = verdict == Verdict.AMBIGUOUS
    assert ((f <= 0) == experiment.truth)[unsure].mean() > 0.8


@pytest.mark.parametrize("method", METHODS.values())
def test_f_is_a_number_at_extreme_sizes(method):
    """A cube of 7 cm inside a cone of 5 cm by 8 km: f says that they collide, in either order."""
    cube, spike = Body.box([0.066] * 3), Body.cone(0.046, 8428.4)
    one, other = (cube.inner, cube.outer), (spike.inner, spike.outer)
    assert paper.distance_estimate(*one, *other, method) <= 0
    assert paper.distance_estimate(*other, *one, method) <= 0


def test_detector_1_follows_section_2(experiment):
    """Inner overlap, then the two printed conditions with vectors instead of places on a line."""
    pairs, answers = experiment.pairs, experiment.detectors[0].answers
    for k in range(150):
        inner_1, outer_1, inner_2, outer_2 = (
            getattr(pairs, name)[k] for name in ("heuristic_1", "outer_1", "heuristic_2", "outer_2")
        )
        near = near_points(inner_1, inner_2, method="rimon-boyd")
        if near.distance == 0:
            expected = (True, False)
        else:
            v1i, v2i = near.point_1, near.point_2
            e = v2i - v1i
            v1c, v2c = v1i + hit(outer_1, v1i, e) * e, v2i - hit(outer_2, v2i, -e) * e
            pieces = experiment.bodies_1[k].pieces[0], experiment.bodies_2[k].pieces[0]
            v1, v2 = (face_hit(p, v, d) for p, v, d in zip(pieces, (v1i, v2i), (e, -e), strict=True))
            enclosing = (v1c - v2c) @ (v1 - v2) <= 0
            near_enough = np.linalg.norm(v1 - v2) <= min(np.linalg.norm(v1c - v1), np.linalg.norm(v2c - v2))
            expected = (enclosing and near_enough, enclosing)
        assert (answers.collides[k], answers.ambiguous[k]) == expected


def face_hit(piece, start, e):
    speed = piece.normals @ e
    return start + min((piece.offsets - piece.normals @ start)[speed > 0] / speed[speed > 0]) * e


def test_heuristic_ellipsoids_are_inside_touch_and_are_smaller_than_the_largest(experiment):
    """Detector 1's inner ellipsoids: half to two thirds of the largest volume."""
    pairs = experiment.pairs
    ratio = np.exp(pairs.heuristic_1.log_volume - pairs.inner_1.log_volume)
    assert 0.45 < ratio.mean() < 0.65
    assert (ratio < 1).all()
    for k in range(50):
        piece, E = experiment.bodies_1[k].pieces[0], pairs.heuristic_1[k]
        reach = (piece.normals * E.support(piece.normals)).sum(axis=1) - piece.offsets
        assert abs(reach.max()) < 1e-9


def test_both_readings_of_the_heuristic_can_be_had(experiment):
    """The other reading of the paper's heuristic is available, and does not fit the paper's counts."""
    other = paper.Pairs.from_bodies(experiment.bodies_1, experiment.bodies_2, heuristic="center")
    np.testing.assert_allclose(other.heuristic_1.center, experiment.pairs.outer_1.center)
    counts = Confusion.of(detectors.detect(1, other).collides, experiment.truth).counts
    assert tables.homogeneity(counts, tables.PAPER[1][0].counts) > 1e-3


def test_detectors_see_pairs_one_by_one(experiment):
    """A subset in another order gets the same answers."""
    index = np.arange(len(experiment) - 1, -1, -7)
    some = experiment.pairs.take(index)
    for result in experiment.detectors:
        answers = detectors.detect(result.id, some)
        assert (answers.collides == result.answers.collides[index]).all()
        assert (answers.ambiguous == result.answers.ambiguous[index]).all()


def test_detectors_2_and_3_are_symmetric_in_the_bodies(experiment):
    """Detectors answer the same with the bodies swapped, except detector 2 for at most three pairs."""
    p = experiment.pairs
    swapped = paper.Pairs(
        p.inner_2, p.outer_2, p.inner_1, p.outer_1, p.heuristic_2, p.heuristic_1, p.faces_2, p.faces_1
    )
    for detector, allowed in ((1, 0), (3, 0), (4, 0), (2, 3)):  # Lin-Han at 0.01 rad is not quite its own mirror
        changed = detectors.detect(detector, swapped).collides != experiment.detectors[detector - 1].answers.collides
        assert changed.sum() <= allowed


def test_times_are_positive(experiment):
    """Every detector has a positive time for each check, and none where there is nothing to check."""
    for result in experiment.detectors:
        assert 0 < result.microseconds < math.inf
        assert 0 < result.ambiguous_microseconds < math.inf
    assert math.isnan(detectors.time_per_check(3, experiment.pairs.take(np.arange(0))))


# -- tables ----------------------------------------------------------------------------------------


def test_counts_are_consistent_with_the_paper(experiment):
    """Tables 1, 3 and 4 (a) and (b), and the four exact classes; table 2 is detector 4's in the paper."""
    for table in tables.tables(experiment)[:-2]:
        if not table.title.startswith("Table 2"):
            assert table.p_value > 1e-3, table
    assert tables.classes(experiment)[1] > 1e-3


def test_tables_count_what_the_detectors_said(experiment):
    """The tables' cells are the counts of answers against the truth, inside their intervals."""
    found = tables.tables(experiment)
    assert [t.title for t in found] == [f"Table {k} ({p})" for k in (1, 2, 3, 4) for p in "ab"] + [
        "Estimate (a)",
        "Estimate (b)",
    ]
    for result, whole, part in zip(experiment.detectors, found[:8:2], found[1:8:2], strict=True):
        said, truth = result.answers.collides, experiment.truth
        assert (
            tuple(c.count for c in whole.cells)
            == result.all.counts
            == tuple(int(((said == s) & (truth == t)).sum()) for s in (True, False) for t in (True, False))
        )
        assert tuple(c.count for c in part.cells) == result.ambiguous.counts
        assert result.ambiguous.total == result.answers.ambiguous.sum()
        for cell in (*whole.cells, *part.cells):
            assert cell.low <= cell.share <= cell.high
    for row in tables.rows(experiment):
        assert len(row) == len(tables.COLUMNS)
    counts, _ = tables.classes(experiment)
    assert sum(counts) == len(experiment)


def test_the_paper_s_own_tables_add_up():
    """1000 pairs each, 542 of them colliding; errors of detectors 2 to 4 lie in the ambiguous case but for three."""
    for every, hard, *_ in tables.PAPER.values():
        assert every.total == 1000
        assert every.tp + every.fn == 542
        assert hard.total < 1000
    assert sum(tables.PAPER_CLASSES) == 1000


def test_errors_outside_the_ambiguous_pairs(experiment):
    """They are the wrong answers that a detector's own checks gave; the paper prints three for its detector 2."""
    printed = {k: tables.errors_outside(*tables.PAPER[k][:2]) for k in tables.PAPER}
    assert printed == {1: (162, 0), 2: (3, 0), 3: (0, 0), 4: (3, 0)}
    rows = {row[0]: row[1:] for row in sheets.outside(experiment).rows}
    for result in (*experiment.detectors, experiment.estimate):
        sure, said, truth = ~result.answers.ambiguous, result.answers.collides, experiment.truth
        own = int((sure & ~said & truth).sum()), int((sure & said & ~truth).sum())
        assert tables.errors_outside(result.all, result.ambiguous) == own
        missed, missed_printed, false, false_printed = rows[f"{result.id}: {result.name}" if result.id else result.name]
        assert (int(missed), int(false)) == own
        assert (missed_printed, false_printed) == tuple(map(str, printed.get(result.id, "--")))
    assert int(rows["1: earlier method, with polyhedra"][0]) > 0


# -- the tables as text ----------------------------------------------------------------------------


def leading(cell):
    """The number that a cell begins with."""
    return int(cell.split()[0])


def test_matrices_stand_beside_the_paper_s(experiment):
    """Rows are the detector, columns the truth, in ours as in the paper's."""
    for sheet, result in zip(sheets.counts(experiment), (*experiment.detectors, experiment.estimate), strict=True):
        own = [*result.all.counts, *result.ambiguous.counts]
        assert [leading(cell) for row in sheet.rows for cell in row[1:3]] == own
        printed = [count for part in tables.PAPER.get(result.id, ())[:2] for count in part.counts]
        assert [leading(cell) for row in sheet.rows for cell in row[3:]] == printed


def test_every_table_names_detectors_and_fits_eighty_columns(experiment):
    """With the lines that the terminal draws around it; where a table is about detectors, it says which."""
    every = (*sheets.in_order(experiment), *sheets.shares(experiment))
    for sheet in every:
        assert len(sheet.title) <= 80
        for row in sheet.aligned:
            assert sum(map(len, row)) + 3 * len(row) + 1 <= 80, sheet.title
    names = [result.name for result in (*experiment.detectors, experiment.estimate)]
    about_one = [sheet.title for sheet in (*sheets.counts(experiment), *sheets.shares(experiment))]
    assert all(name in title for name, title in zip(names * 2, about_one, strict=True))
    for sheet in (sheets.right(experiment), sheets.outside(experiment), sheets.times(experiment)):
        text = str(sheet.rows)
        assert all(f"{k}: {name}" in text for k, name in enumerate(names[:4], start=1))


def test_columns_of_a_table_are_aligned():
    """Every cell of a column has one width; numbers, with what follows in brackets, stand to the right."""
    head, *rows = sheets.Sheet("", ("a", "b", "c"), (("x", "9 (0.9)", "yes"), ("long", "-", "1 of 2")), "").aligned
    assert head == ("a   ", "      b", "c     ")
    assert rows == [("x   ", "9 (0.9)", "yes   "), ("long", "      -", "1 of 2")]
    for cell, numeric in (("2.5e-05", True), ("34.5 [31.6, 37.5]", True), ("yes (p = 1)", False), ("1: name", False)):
        assert sheets.Sheet("", ("a",), ((cell,),), "").numeric == (numeric,)


def test_right_answers_are_counted(experiment):
    """The shares of right answers are those of the confusion matrices; Table 2 is set against detector 4 too."""
    rows = {row[:2]: row[2:] for row in sheets.right(experiment).rows}
    assert len(rows) == 12
    second, fourth = experiment.detectors[1], experiment.detectors[3]
    for name, result in (("2: Lin-Han near points", second), ("4: center-line near points", fourth)):
        for letter, own, printed in zip("ab", (result.all, result.ambiguous), tables.PAPER[2][:2], strict=True):
            right, paper_right, consistent = rows[f"2 ({letter})", name]
            assert right == f"{100 * (own.tp + own.tn) / own.total:.1f}"
            assert paper_right == f"{100 * (printed.tp + printed.tn) / printed.total:.1f}"
            assert consistent == tables.statement(tables.homogeneity(own.counts, printed.counts))


# -- the fits --------------------------------------------------------------------------------------


def test_every_polyhedron_is_fitted_to_the_paper_s_tolerance(experiment):
    """None fails, and the gaps are certified to be within 1e-4."""
    assert [f.name for f in experiment.fittings] == list(fitting.FITS)
    for found in experiment.fittings:
        assert (found.tried, found.failed) == (2 * len(experiment), 0)
        assert 0 <= found.largest_gap <= 1e-4
        assert found.microseconds > 0


def test_fits_that_fail_are_counted(experiment, monkeypatch):
    """A fit that ends in an error is counted as failed, and the others are fitted all the same."""
    calls = []

    def every_third_fails(points):
        calls.append(points)
        if len(calls) % 3 == 0:
            raise ConvergenceError("too hard")
        return mvce(points)

    def fails(points):
        raise ConvergenceError("too hard")

    monkeypatch.setattr(fitting, "FITS", {"some": every_third_fails, "none": fails})
    some, none = fitting.fit_one_by_one(experiment.bodies_1[:6], experiment.bodies_2[:6])
    assert (some.tried, some.failed) == (12, 4)
    assert some.largest_gap <= 1e-4
    assert (none.tried, none.failed) == (12, 12)
    assert math.isnan(none.largest_gap)


@pytest.mark.parametrize(("count", "total"), [(0, 10), (10, 10), (1, 3), (375, 1000), (5, 237)])
def test_wilson_against_scipy(count, total):
    """The interval of a share is SciPy's Wilson interval."""
    expected = binomtest(count, total).proportion_ci(0.95, method="wilson")
    np.testing.assert_allclose(wilson(count, total), expected, atol=1e-12)


def test_wilson_of_nothing_says_nothing():
    """With nothing counted the interval is all of 0 to 1."""
    assert wilson(0, 0) == (0.0, 1.0)


def test_homogeneity_against_scipy(rng):
    """The p-value of two rows of counts is SciPy's, and columns of zeros do not matter."""
    for _ in range(20):
        a, b = rng.integers(1, 200, size=(2, 4))
        assert tables.homogeneity(a, b) == pytest.approx(chi2_contingency([a, b], correction=False).pvalue)
    assert tables.homogeneity((3, 0, 5, 0), (6, 0, 10, 0)) == pytest.approx(1.0)
    assert tables.homogeneity((3, 0), (9, 0)) == 1.0
    assert math.isnan(tables.homogeneity((0, 0), (1, 2)))


@pytest.mark.verify
def test_a_wrong_data_set_is_called_inconsistent():
    """Uniform volume is not the paper's data set, and the tables say so."""
    other = paper.run(400, seed=0, dataset="volume")
    assert tables.classes(other)[1] < 1e-6
    assert tables.statement(1e-7) == "no (p = 1e-07)"
    assert tables.statement(0.5) == "yes (p = 0.5)"
    assert tables.statement(math.nan) == "-"


# -- files -----------------------------------------------------------------------------------------


def test_json_has_the_agreed_form(outcome):
    """The JSON file has the agreed keys, and its counts add up to the number of pairs."""
    experiment, folder, _ = outcome
    written = json.loads((folder / "counts.json").read_text())
    assert written == experiment.as_dict()
    assert list(written) == ["pairs", "seed", "dataset", "truth", "detectors", "estimate"]
    assert (written["pairs"], written["seed"], written["dataset"]) == (len(experiment), 0, "radius")
    assert written["truth"] == {"colliding": int(experiment.truth.sum())}
    assert [d["id"] for d in written["detectors"]] == [1, 2, 3, 4]
    for entry in written["detectors"]:
        assert set(entry) == {"id", "all", "ambiguous", "microseconds_per_check"}
        assert entry["microseconds_per_check"] > 0
    for entry in (*written["detectors"], written["estimate"]):
        for part in ("all", "ambiguous"):
            assert set(entry[part]) == {"tp", "fp", "fn", "tn"}
            assert all(isinstance(count, int) for count in entry[part].values())
        assert sum(entry["all"].values()) == len(experiment)
        assert entry["all"]["tp"] + entry["all"]["fn"] == written["truth"]["colliding"]


def test_report_and_figures_are_written_whole(outcome):
    """Every figure and report is in the folder, and each file is complete."""
    _, folder, _ = outcome
    out = folder / "new" / "out"
    expected = {f"{name}.{kind}" for name in figures.FIGURES for kind in figures.FORMATS}
    assert {p.name for p in out.iterdir()} == expected | {"report.md", "report.html"}
    for name in figures.FIGURES:
        png = (out / f"{name}.png").read_bytes()
        assert png.startswith(b"\x89PNG")
        assert png.rstrip().endswith(b"IEND\xaeB`\x82")
        svg = (out / f"{name}.svg").read_text()
        assert svg.startswith("<?xml")
        assert svg.rstrip().endswith("</svg>")
    if sys.platform != "win32":
        assert stat.S_IMODE((out / "report.md").stat().st_mode) & stat.S_IRUSR


def test_report_says_what_must_be_said(outcome):
    """The report states its caveats, and its page needs nothing from outside."""
    _, folder, _ = outcome
    text = (folder / "new" / "out" / "report.md").read_text()
    page = (folder / "new" / "out" / "report.html").read_text()
    for phrase in (
        "Detector 1's reading is inferred",
        "Tables 2 and 4 of the paper are the same numbers, and they are detector 4's",
        "Detector 4 does not generalise",
        "Table 1 (a)",
        "Estimate (b)",
        "Errors outside the ambiguous pairs",
        "How reliable the fits are",
    ):
        assert phrase in text
        assert phrase.replace("'", "&#x27;") in page
    # Self-contained: every image is inside, nothing is fetched.
    assert page.count("data:image/png;base64,") == 4
    assert not re.search(r'(src|href)="(?!data:)', page)
    for name in figures.FIGURES:
        assert f"({name}.svg)" in text


def test_progress_is_told_in_order(outcome):
    """Progress names the stages in order, and ends with the report complete."""
    _, _, told = outcome
    stages = list(dict.fromkeys(stage for stage, _, _ in told))
    assert [s for s in stages if s != "hulls and fits"] == ["exact answers", "detectors", "report"]
    assert all(0 <= done <= total for _, done, total in told)
    assert told[-1] == ("report", 1, 1)


@pytest.mark.verify
def test_one_pair_is_enough(tmp_path):
    """The smallest experiment runs, empty cells and all, figures included."""
    experiment = paper.run(1, seed=5, out=tmp_path)
    assert len(experiment) == 1
    assert len(list(tmp_path.iterdir())) == 10
    assert all(len(row) == len(tables.COLUMNS) for row in tables.rows(experiment))
    json.dumps(experiment.as_dict())


def test_figures_show_points_where_the_sections_are(experiment):
    """On the near-point line, f = (L + alpha - beta)/2 of the drawn points is the detector's answer."""
    answers = experiment.detectors[2].answers
    p = experiment.pairs
    for k in np.flatnonzero(answers.ambiguous)[:30]:
        line = figures.line_of_pair((p.inner_1[k], p.inner_2[k]), (p.outer_1[k], p.outer_2[k]), "rimon-boyd")
        assert ((line.L + line.alpha - line.beta) / 2 <= 0) == answers.collides[k]


def test_arrows_of_the_flow_chart_meet_their_boxes():
    """Each begins on the border of one box and ends, at right angles, on that of the next."""
    for start, end, _ in figures.ARROWS:
        path = figures.arrow_path(start, end)
        for name, (x, y) in ((start, path[0]), (end, path[-1])):
            middle_x, middle_y, width, height, *_ = figures.BOXES[name]
            off = abs(x - middle_x) / width, abs(y - middle_y) / height
            assert sorted(off) == pytest.approx([0.0, 1.0])
        assert all((a == b).any() for a, b in zip(path[:-1], path[1:], strict=True))


def test_text_of_the_flow_chart_stays_in_its_boxes():
    """Drawn, no text is wider or higher than the box that arrows end at."""
    figure = figures._flow_chart()
    figure.draw_without_rendering()
    ax = figure.axes[0]
    texts = {text.get_text(): text for text in ax.texts}
    for x, y, width, height, text, _ in figures.BOXES.values():
        extent = texts[text].get_window_extent().transformed(ax.transData.inverted())
        assert x - width < extent.x0 < extent.x1 < x + width
        assert y - height < extent.y0 < extent.y1 < y + height


def test_polyhedra_can_be_seen(experiment):
    """Figures 1 and 2 fill both polyhedra and draw their borders."""
    drawn = figures.draw(experiment)
    for name in ("figure-1", "figure-2"):
        polygons = drawn[name].axes[0].patches
        assert len(polygons) == 2
        for polygon in polygons:
            assert polygon.get_facecolor()[3] >= 0.2
            assert polygon.get_edgecolor()[3] >= 0.5
            assert polygon.get_linewidth() > 0


# -- bad input -------------------------------------------------------------------------------------


@pytest.mark.parametrize("pairs", [0, -1, 2.5, "many", None, True, math.nan])
def test_bad_pairs_are_refused(pairs):
    """The number of pairs has to be a whole number greater than zero."""
    with pytest.raises(InputError, match="pairs"):
        paper.run(pairs)


@pytest.mark.parametrize("seed", [-1, 0.5, "x", None])
def test_bad_seeds_are_refused(seed):
    """A seed has to be a whole number that is not negative."""
    with pytest.raises(InputError, match="seed"):
        paper.run(1, seed=seed)


def test_unknown_names_are_refused(experiment):
    """An unknown data set, detector or heuristic is refused by a message that lists the known ones."""
    with pytest.raises(UnknownNameError, match="radius, volume"):
        paper.run(1, dataset="ball")
    with pytest.raises(UnknownNameError, match="1, 2, 3, 4"):
        paper.detect(5, experiment.pairs)
    with pytest.raises(UnknownNameError, match="centroid"):
        paper.Pairs.from_bodies(experiment.bodies_1, experiment.bodies_2, heuristic="best")


def test_only_single_polytopes_are_paired(experiment):
    """Only equally many bodies, each of one polytope, can be paired."""
    round_bodies = Bodies([Body.box([1, 1, 1]), Body.sphere(1)])
    with pytest.raises(InputError, match=r"bodies\[1\]"):
        paper.Pairs.from_bodies(round_bodies, round_bodies)
    with pytest.raises(InputError, match="equally many"):
        paper.Pairs.from_bodies(experiment.bodies_1, experiment.bodies_2[:3])


def test_unwritable_places_are_an_error_and_leave_nothing(tmp_path):
    """A place that cannot be written is a FileError, and what was there stays."""
    blocked = tmp_path / "file"
    blocked.write_text("mine")
    with pytest.raises(FileError, match="file"):
        paper.run(1, out=blocked)
    with pytest.raises(FileError, match="nowhere"):
        paper.run(1, json=tmp_path / "nowhere" / "x.json")
    with pytest.raises(FileError):
        write_atomically(tmp_path, b"a folder cannot be replaced by a file")
    assert [p.name for p in tmp_path.iterdir()] == ["file"]
    assert blocked.read_text() == "mine"


def test_a_failed_write_keeps_the_older_file(tmp_path, monkeypatch):
    """When a write fails the older file stays, and no temporary one is left."""
    target = tmp_path / "report.md"
    target.write_text("old")

    def full_disk(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.replace", full_disk)
    with pytest.raises(FileError, match="No space left"):
        write_atomically(target, b"new")
    assert target.read_text() == "old"
    assert len(list(tmp_path.iterdir())) == 1


def test_missing_matplotlib_is_told_before_the_work(tmp_path, monkeypatch):
    """A missing matplotlib is reported before any work, and is not needed without figures."""
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    with pytest.raises(MissingExtraError, match=r"loewner\[plots\]"):
        paper.run(1, out=tmp_path / "out")
    assert not (tmp_path / "out").exists()
    assert len(paper.run(1)) == 1


def test_report_can_be_had_as_text(experiment):
    """The report is available as Markdown text."""
    assert report.markdown(experiment).startswith("# ")
