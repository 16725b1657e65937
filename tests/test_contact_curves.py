"""`Scene.leave` and `Scene.reach` on curves: contact at the beginning and the end of a whole trajectory."""

from math import comb
from pathlib import Path

import numpy as np
import pytest
from scipy.interpolate import CubicSpline, PchipInterpolator, make_interp_spline

import loewner
from families import translation
from loewner import Body, CollisionChecker, ConvergenceError, InputError, Robot, Scene, Verdict, planners
from loewner.cli.main import main
from loewner.queries import pairs as queries
from loewner.robots.proofs import contacts
from sampling import quick
from test_contacts import HAND, START, TOLERANCE, can_on_table, height

FREE, COLLIDING = Verdict.FREE, Verdict.COLLIDING
BOTH = {"leave": ["table"], "reach": ["table"]}

# From the table, along it, up, across, down and along it again; the hand turns only where the can is high.
CARRY = np.array(
    [[0, 0, 0], [0.05, 0, 0], [0.05, 0.1, 0], [0.2, 0.3, 0.2], [0.4, 0.1, 0], [0.4, 0, 0], [0.5, 0, 0]], dtype=float
)


def points_of(curve, rate=1000.0):
    """The points that a controller gets, which it joins by straight lines."""
    times = np.linspace(curve.x[0], curve.x[-1], int(rate * (curve.x[-1] - curve.x[0])) + 1)
    return planners.ControllerPoints(times, curve(times))


FORMS = {
    "linear": planners.ControllerPoints,
    "monotone": PchipInterpolator,
    "one thousand points a second": lambda t, q: points_of(PchipInterpolator(t, q)),
    "trapezoidal": lambda t, q: planners.trajectory(Robot.from_urdf(text=HAND), q, acceleration=1.0),
    "limited jerk": lambda t, q: planners.trajectory(Robot.from_urdf(text=HAND), q, acceleration=1.0, jerk=10.0),
}


def timed(form, rows):
    """A curve of a form through rows that are half a second apart."""
    return FORMS[form](0.5 * np.arange(len(rows)), np.asarray(rows, dtype=float))


def dense(curve, rate=5000.0):
    """Times and configurations of a curve, evaluated without the code that proves it."""
    if isinstance(curve, planners.Trajectory):
        times = np.linspace(0.0, curve.duration, int(rate * curve.duration))
        return times, curve.positions(times)
    if isinstance(curve, planners.ControllerPoints):
        times = np.linspace(curve.times[0], curve.times[-1], int(rate * (curve.times[-1] - curve.times[0])))
        return times, np.stack([np.interp(times, curve.times, column) for column in curve.positions.T], axis=1)
    first, last = (curve.t[[curve.k, -1 - curve.k]]) if hasattr(curve, "t") else curve.x[[0, -1]]
    times = np.linspace(first, last, int(rate * (last - first)))
    return times, curve(times)


def leaves(distances, margin, parted, deepest=np.inf):
    """Whether samples of the signed distance of one pair of pieces, or several (N, pairs), follow the rule of leave."""
    distances = distances.reshape(len(distances), -1)
    nearest, start = distances.min(axis=1), distances[0]
    last = np.flatnonzero(nearest <= margin).max(initial=-1)
    if last < 0:
        return True
    allowed = np.where(start <= margin + TOLERANCE, np.minimum(start, margin) - 1.02 * TOLERANCE, margin - 1e-12)
    kept = (distances[: last + 1] >= allowed).all() and start.min() >= -deepest - 1e-12
    return bool(kept and nearest[0] <= margin + TOLERANCE and (nearest[: last + 1] <= parted).all())


def parted(checker, Q, margin):
    """The distance from which on the pair has parted."""
    ready = checker._ready()
    run = contacts.Run.whole(np.stack([Q[:-1], Q[1:]], axis=1), np.zeros_like(Q[1:]))
    return margin + TOLERANCE + contacts.PARTED * contacts._reach(ready, int(ready.ruled[0]), run) + 1e-9


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("margin", [0.004, pytest.param(0.0, marks=pytest.mark.verify)])
def test_a_carry_is_free_and_keeps_the_rule_at_5_khz(form, margin):
    """A can is lifted from the table and put back; dense samples agree with the proof, and with the first contact."""
    checker = can_on_table(margin, **BOTH)
    curve = timed(form, CARRY)
    found = checker.certify_trajectory(curve)
    assert found.verdict == FREE
    assert (found.segments.verdict == FREE).all()
    assert checker.first_contact(curve).verdict == FREE
    _, Q = dense(curve)
    distances, top = height(Q), height(Q).argmax()
    far = parted(checker, Q, margin)
    assert leaves(distances[: top + 1], margin, far)
    assert leaves(distances[top:][::-1], margin, far, TOLERANCE)
    without = can_on_table(margin).certify_trajectory(curve)
    assert (without.verdict, without.first) == (COLLIDING, 0.0)


SHORT = FORMS | {"one thousand points a second": lambda t, q: points_of(PchipInterpolator(t, q), 50.0)}


def keeps_what_is_told(report, margin, sunk=0.0):
    """Whether the motions of a proof keep its distances in dense samples, by plane geometry."""
    for number, points in enumerate(report.points):
        rows, shares = np.array(points), np.unique([*np.linspace(0, 1, 21), 2.0**-12, 1 - 2.0**-12])
        t, degree = shares[:, None], len(points) - 1
        Q = sum(comb(degree, k) * t**k * (1 - t) ** (degree - k) * rows[k] for k in range(degree + 1))
        own = [(since, until, least) for _, _, which, since, until, least in report.contacts if which == number]
        for share, distance in zip(shares.tolist(), height(Q, sunk).tolist(), strict=True):
            if distance <= min((least for low, high, least in own if low <= share <= high), default=margin) - 1e-12:
                return False
    return True


@pytest.mark.parametrize("form", SHORT)
@pytest.mark.parametrize("margin", [0.004, pytest.param(0.0, marks=pytest.mark.verify)])
def test_the_proof_of_a_carry_has_two_stretches(form, margin):
    """Its contacts last from its start and to its end, over many segments, and get deeper by the tolerance once."""
    checker = can_on_table(margin, **BOTH)
    curve = SHORT[form](0.5 * np.arange(len(CARRY)), CARRY)
    proof = checker.certify_trajectory(curve, proof=True).proof
    report = proof.verify()
    assert proof.model_hash == checker.model_hash
    (*pair, start, until, least), (*same, since, end, other) = report.stretches
    assert sorted(pair) == sorted(same) == ["can", "table"]
    assert (start, end) == ((0, 0), (len(report.motions) - 1, 1))
    assert 0 < until[0] < since[0]
    assert least == other == pytest.approx(-TOLERANCE, abs=1e-12)
    assert all(joined for _, joined, *_ in report.motions)
    assert f"from t = 0 in motion 0 until t = {until[1]} in motion {until[0]}\n" in str(report)
    assert keeps_what_is_told(report, margin)
    assert can_on_table(margin).certify_trajectory(curve, proof=True).proof is None


def test_the_tolerance_counts_once_along_a_curve():
    """Points that sink a little each time keep the depth of the first one, and have no proof beyond it."""
    checker = can_on_table(0.0, 0.002, **BOTH)
    rows = np.zeros((60, 3))
    rows[:, 0] = np.linspace(0.0, 0.1, 60)
    for depth, verdict in ((0.5, FREE), (1.5, COLLIDING)):
        rows[:40, 1] = -depth * TOLERANCE * np.linspace(0.0, 1.0, 40)
        rows[40:, 1] = np.linspace(0.0, 0.1, 20)
        found = checker.certify_trajectory(planners.ControllerPoints(0.01 * np.arange(60), rows), proof=True)
        assert found.verdict == verdict
        if verdict == FREE:
            report = found.proof.verify()
            (stretch,) = report.stretches
            assert stretch[-1] == pytest.approx(-0.002 - TOLERANCE, abs=1e-9)
            assert stretch[3][0] == 40
            assert len(report.contacts) == 41
            assert keeps_what_is_told(report, 0.0, 0.002)
        else:
            assert found.proof is None


def test_with_joint_errors_curves_have_no_contacts_in_proofs():
    """Bounds of the format may be coarser than the proof; then no contact takes the place of the margin."""
    checker = can_on_table(0.0, -1e-3, **BOTH)
    curve = timed("linear", np.array([[0, 0, 0], [0.1, 0, 0], [0.2, 0, 0]], dtype=float))
    options = {"tolerance": 2e-3, "joint_error": [2e-3, 0.0, 0.0]}
    assert checker.certify_trajectory(curve, **options).verdict == FREE
    with pytest.raises(ConvergenceError, match="can and table .* bound on joint errors"):
        checker.certify_trajectory(curve, **options, proof=True)


CHANGES = {
    "deeper by a millimetre before the lift": lambda rows: rows[1].__setitem__(1, -1e-3),
    "deeper by a millimetre where it is put down": lambda rows: rows[5].__setitem__(1, -1e-3),
    "ends deeper by a millimetre": lambda rows: rows[5:, 1].__isub__(1e-3),
    "touches between": lambda rows: rows[3].__setitem__(1, 0.0),
    "slides through the table": lambda rows: rows[2:5, 1].__imul__(-1.0),
    "lifts a corner into the table": lambda rows: rows[1].__setitem__(2, 0.05),
}


@pytest.mark.parametrize("form", ["limited jerk", pytest.param("linear", marks=pytest.mark.verify)])
@pytest.mark.parametrize("change", CHANGES)
def test_a_changed_carry_is_not_free(form, change):
    """A carry that gets deeper, or that touches the table again on its way, is refused."""
    rows = CARRY.copy()
    CHANGES[change](rows)
    checker, curve = can_on_table(**BOTH), timed(form, rows)
    found = checker.certify_trajectory(curve, proof=True)
    assert found.verdict != FREE
    assert found.proof is None
    assert checker.first_contact(curve).verdict != FREE


def test_rules_about_other_pairs_or_ends_do_not_help():
    """A carry needs the rule of the pair that touches, at the end at which it touches, and no joint error."""
    curve = timed("monotone", CARRY)
    for rules in ({"leave": ["table"]}, {"reach": ["table"]}, {"leave": ["shelf"], "reach": ["shelf"]}):
        checker = can_on_table(**rules)
        checker.scene.add("shelf", Body.box([0.1, 0.1, 0.1]), translation(z=3.0))
        assert checker.certify_trajectory(curve).verdict == COLLIDING
    assert can_on_table(**BOTH).certify_trajectory(curve, joint_error=1e-12).verdict != FREE
    checker = can_on_table(**BOTH)
    checker.scene.add("wall", Body.box([0.05, 0.05, 0.05]), translation(x=0.2, z=0.35))
    found = checker.certify_trajectory(curve)
    assert found.verdict == COLLIDING
    assert "wall" in found.names
    assert (found.segments.verdict == FREE).sum() >= 3  # with those that the rules allow


@pytest.mark.parametrize("seed", quick(*range(20)))
def test_random_curves_keep_the_rules_in_dense_samples(seed):
    """FREE curves keep the rules by plane geometry, and nearly all curves that keep them are FREE."""
    rng = np.random.default_rng(seed)
    forms = [PchipInterpolator, CubicSpline, planners.ControllerPoints, make_interp_spline]
    verdicts = []
    for _ in range(10):
        margin, sunk = rng.choice([0.0, 0.004]), rng.choice([0.0, 1e-17, 0.002, -0.003])
        rows = np.zeros((4, 3))
        rows[1:] = np.cumsum(rng.normal(size=(3, 3)) * [0.1, 0.0, rng.choice([0.0, 1e-3, 0.1])], axis=0)
        rise = np.abs(rng.normal(size=3)) * 10.0 ** rng.uniform(-4, -1, size=3) * (rng.random(3) < 0.7)
        rows[1:, 1] = np.cumsum(rise * rng.choice([1.0, 1.0, 1.0, -1.0], size=3))
        ends = bool(rng.integers(2))
        curve = rng.choice(np.array(forms, dtype=object))(np.arange(4.0), rows[::-1] if ends else rows)
        checker = can_on_table(margin, sunk, **{"reach" if ends else "leave": ["table"]})
        found, contact = checker.certify_trajectory(curve, tolerance=TOLERANCE), checker.first_contact(curve)
        times, Q = dense(curve, 1000.0)
        distances, far = height(Q, sunk), parted(checker, Q, margin)
        kept = leaves(distances[::-1], margin, far, TOLERANCE) if ends else leaves(distances, margin, far)
        assert kept or found.verdict != FREE
        assert kept or contact.verdict != FREE
        free = times < contact.free_until
        assert ends or not free.any() or leaves(distances[free], margin, far)
        assert contact.free_until <= contact.touching_at
        verdicts.append((found.verdict == FREE, kept))
    assert np.equal(*zip(*verdicts, strict=True)).sum() >= 8


def test_a_straight_curve_is_a_motion_of_certify_edges():
    """One segment has the verdict of the same motion, and so have seven, whose stretch ends in another place."""
    rng = np.random.default_rng(3)
    ends = rng.uniform([-0.4, -0.05, -0.2], [0.4, 0.1, 0.2], size=(9, 3)) * 10.0 ** rng.uniform(-3, 0, size=(9, 1))
    for rules in ({"leave": ["table"]}, BOTH):
        checker = can_on_table(0.004, 0.002, **rules)
        wanted = checker.certify_edges(START, ends).verdict
        for count in (2, 8):
            rows = np.linspace(START, ends, count)
            given = [planners.ControllerPoints(np.arange(count), rows[:, k]) for k in range(9)]
            found = np.array([one.verdict for one in checker.certify_trajectory(given)])
            np.testing.assert_array_equal(found == FREE, wanted == FREE)


def test_first_contact_is_the_first_that_is_not_allowed():
    """Known times: after the contact that is allowed, the can comes down at 3.5 s, or is pushed in from 1 s on."""
    checker = can_on_table(leave=["table"])
    rows = np.array([[0, 0, 0], [0.1, 0, 0], [0.1, 0.1, 0], [0.1, 0.1, 0], [0.1, -0.1, 0]], dtype=float)
    found = checker.first_contact(planners.ControllerPoints(np.arange(5.0), rows))
    assert (found.verdict, found.names) == (COLLIDING, ("can", "table"))
    assert found.free_until < 3.5
    assert found.free_until == pytest.approx(3.5, abs=1e-4)
    assert found.touching_at == pytest.approx(3.5, abs=1e-9)
    rows[2:, 1] = -0.01, 0.1, 0.1
    found = checker.first_contact(planners.ControllerPoints(np.arange(5.0), rows), tolerance=1e-4)
    assert (found.verdict, found.names) == (COLLIDING, ("can", "table"))
    assert 1.0 <= found.free_until < 1.01 <= found.touching_at < 1.0101


@pytest.mark.parametrize("seed", quick(*range(20)))
def test_bodies_of_several_pieces_and_thin_tables(seed):
    """Each pair of pieces keeps the rule in dense exact distances: with flanges, a table of 1 mm, and deep starts."""
    rng = np.random.default_rng(seed)
    cans = [
        Body.boxes([[0, 0, 0.1], [0.06, 0, 0.12]], [[0.06, 0.06, 0.2], [0.1, 0.02, 0.02]]),
        Body.boxes([[0, 0, 0.1], [0, 0, 0.005]], [[0.02, 0.02, 0.2], [0.12, 0.12, 0.01]]),
        Body.cylinder(0.03, 0.2).transformed(translation(z=0.1)),
    ]
    free = 0
    for number in range(8):
        scene, thin, sunk = Scene(margin=rng.choice([0, 0.003])), rng.choice([0.1, 0.001]), rng.choice([0, 0.003, 0.02])
        boxes = [[0, 0, -thin / 2], [0.3, 0, 0.1], [-0.5, 0, -0.2]], [[0.5, 0.5, thin], [0.05, 0.3, 0.2], [0.3] * 3]
        scene.add("table", Body.boxes(*boxes))
        scene.add("can", rng.choice(np.array(cans, dtype=object)))
        scene.attach("can", "hand", translation(z=-sunk), leave=["table"])
        checker = CollisionChecker(Robot.from_urdf(text=HAND), scene)
        rows = np.zeros((4, 3))
        rise = np.abs(rng.normal(size=(3, 1))) * 10.0 ** rng.uniform(-3.5, -1, size=(3, 1))
        across = rng.normal(size=(3, 2)) * [rng.choice([0, 0.02, 0.2]), rng.choice([0, 1e-3, 0.05, 0.5])]
        across *= number > 0
        rows[1:] = np.cumsum(np.concatenate([across[:, :1], rise, across[:, 1:]], axis=1), axis=0)
        form = CubicSpline if number else PchipInterpolator  # the first one goes straight up
        curve = form(np.arange(4.0), rows)
        if checker.certify_trajectory(curve, tolerance=TOLERANCE).verdict != FREE:
            continue
        free += 1
        ready, (_, Q) = checker._ready(), dense(curve, 300.0)
        i, j = ready.pairs[ready.ruled[0]].tolist()
        ours, theirs, T = contacts._pieces(ready, i), contacts._pieces(ready, j), ready.poses(Q)
        every = [(a, b) for a in range(len(ours)) for b in range(len(theirs))]
        distances = [queries.distance(ours[a], T[:, i], theirs[b], T[:, j], exact=True).distance for a, b in every]
        assert leaves(np.stack(distances, axis=1), scene.margin, parted(checker, Q, scene.margin))
    assert free > 0


def test_a_joint_that_another_one_follows_moves_the_robot_farther():
    """The plane is wide enough for a joint that moves 200 times as far as the value: sliding 20 m stays FREE."""
    axis = '<axis xyz="1 0 0"/><limit lower="-100" upper="100" effort="1" velocity="1"/>'
    text = HAND.replace('<link name="base"/>', '<link name="base"/><link name="far"/>')
    text = text.replace('<parent link="base"/>', '<parent link="far"/>', 1).replace(
        "</robot>",
        f'<joint name="follows" type="prismatic"><parent link="base"/><child link="far"/>{axis}'
        '<mimic joint="x" multiplier="200"/></joint></robot>',
    )
    scene = Scene()
    scene.add("table", Body.box([100.0, 1.0, 2.0]), translation(z=-0.7))
    scene.leave("hand", "table")
    checker = CollisionChecker(Robot.from_urdf(text=text), scene)
    assert checker.certify_edges(START, [0.1, 0.0, 0.0], tolerance=1e-3).verdict == FREE
    assert checker.certify_edges(START, [0.1, -0.1, 0.0], tolerance=1e-3).verdict == COLLIDING
    down = planners.ControllerPoints([0, 1, 2], [START, [0.1, 0.0, 0.0], [0.1, -0.1, 0.0]])
    assert checker.certify_trajectory(down, tolerance=1e-3).verdict == COLLIDING


def belt(**rules):
    """A hand without turns above a box that moves along x at 0.5 m/s, with its top at z = 0.3."""
    scene = Scene(margin=0.001)
    scene.add("box", Body.box([0.1, 0.1, 0.1]))
    scene.follow("box", [0.0, 2.0, 4.0], [translation(x, z=0.25) for x in (-1.0, 0.0, 1.0)])
    for rule, pairs in rules.items():
        for pair in pairs:
            getattr(scene, rule)(*pair)
    return CollisionChecker(Robot.from_urdf(text=HAND), scene)


def test_a_hand_meets_a_box_on_a_belt():
    """A motion that follows the box may end in contact with it: neither deeper, nor earlier or later than the box."""
    checker, plain = belt(reach=[("box", "hand")]), belt()
    above, there, along = [-0.75, 0.2, 0.0], [-0.25, 0.0, 0.0], [0.25, 0.0, 0.0]
    found = checker.certify_edges(above, [there, [-0.25, -1e-3, 0.0]], t0=0.5, t1=1.5).verdict
    np.testing.assert_array_equal(found, [FREE, COLLIDING])
    assert plain.certify_edges(above, there, t0=0.5, t1=1.5).verdict == COLLIDING
    # From 1.5 s on the hand moves with the box; the box has a knot at 2 s.
    for rows, verdict in (
        ([above, there, along], FREE),
        ([above, there, [0.25, -1e-3, 0.0]], COLLIDING),
        ([above, [-0.25, -1e-3, 0.0], along], COLLIDING),
    ):
        curve = planners.ControllerPoints([0.5, 1.5, 2.5], rows)
        found = checker.certify_trajectory(curve)
        assert found.verdict == verdict
        assert len(found.times) == 4
        assert checker.first_contact(curve).verdict == verdict
        assert plain.certify_trajectory(curve).verdict == COLLIDING
        with pytest.raises(InputError, match=r"proof: .*Scene\.follow"):
            checker.certify_trajectory(curve, proof=True)
    parts = planners.ControllerPoints([0.5, 1.5, 2.0, 2.5], [above, there, [0.0, 0.01, 0.0], along])
    assert checker.certify_trajectory(parts).verdict == COLLIDING
    late = planners.ControllerPoints([0.6, 1.6, 2.6], [above, there, [0.25, 0.2, 0.0]])
    assert checker.certify_trajectory(late).verdict != FREE
    leaving = belt(leave=[("box", "hand")])
    up = planners.ControllerPoints([1.5, 2.5, 3.0], [there, along, [0.6, 0.3, 0.0]])
    assert leaving.certify_trajectory(up).verdict == leaving.first_contact(up).verdict == FREE
    assert leaving.certify_edges(there, along, t0=1.5, t1=2.5).verdict == FREE
    assert leaving.certify_edges(there, [0.25, -0.01, 0.0], t0=1.5, t1=2.5).verdict == COLLIDING


def test_a_can_is_lifted_off_a_tray_that_turns():
    """The plane of contact is carried by a body that moves along a path and turns about its normal."""

    def turned(angle, x, z):
        T, (c, s) = translation(x, z=z), (np.cos(angle), np.sin(angle))
        T[:2, :2] = [[c, -s], [s, c]]
        return T

    scene = Scene()
    scene.add("tray", Body.box([0.5, 0.5, 0.02]))
    scene.follow("tray", [0.0, 1.0, 2.0], [turned(0, 0, -0.01), turned(1.0, 0.5, -0.01), turned(1.5, 0.6, 0.04)])
    scene.add("can", Body.cylinder(0.03, 0.2))
    scene.attach("can", "hand", translation(z=0.1), leave=["tray"])
    checker = CollisionChecker(Robot.from_urdf(text=HAND), scene)
    for end, last, verdict in (
        ([0.5, 0.0, 0.0], 1.0, FREE),
        ([0.6, 0.051, 0.0], 2.0, FREE),
        ([0.6, 0.045, 0.0], 2.0, COLLIDING),
        ([0.5, -1e-3, 0.0], 1.0, COLLIDING),
    ):
        curve = CubicSpline([0.0, last], [START, end], bc_type="natural")
        assert checker.certify_edges(START, end, t0=0.0, t1=last).verdict == verdict
        assert checker.certify_trajectory(curve).verdict == checker.first_contact(curve).verdict == verdict


def test_the_audit_of_a_carry_is_free(tmp_path: Path, capsys):
    """From the planner to the command line, by files: the scene with its rules, the trajectory, and exit status 0."""
    checker = can_on_table(0.002, **BOTH)
    path = planners.plan(checker, START, [0.5, 0.0, 0.0])
    carry = planners.trajectory(checker.robot, path, acceleration=1.0, jerk=10.0, checker=checker)
    assert carry.certify(checker).verdict == FREE
    told = carry.certify(checker, proof=True).proof.verify()
    carry.save(tmp_path / "carry.yaml")
    (tmp_path / "hand.urdf").write_text(HAND)
    loewner.save_scene(checker.scene, tmp_path / "scene.yaml")
    arguments = ["audit", str(tmp_path / "hand.urdf"), str(tmp_path / "carry.yaml"), "--scene"]
    proof = tmp_path / "carry.proof"
    assert main([*arguments, str(tmp_path / "scene.yaml"), "--proof", str(proof)]) == 0
    assert "FREE" in capsys.readouterr().out
    read = loewner.Proof.load(proof).verify()
    assert [row[:2] + row[-1:] for row in read.stretches] == [row[:2] + row[-1:] for row in told.stretches]
    model = ["--robot", str(tmp_path / "hand.urdf"), "--scene"]
    assert main(["verify", str(proof), *model, str(tmp_path / "scene.yaml")]) == 0
    assert "except in 2 contacts" in capsys.readouterr().out
    proof.unlink()
    checker.scene.attach("can", "hand", translation(z=0.1), leave=["table"])
    loewner.save_scene(checker.scene, tmp_path / "other.yaml")
    assert main([*arguments, str(tmp_path / "other.yaml"), "--proof", str(proof)]) == 1
    assert "can" in capsys.readouterr().out
    assert not proof.exists()
