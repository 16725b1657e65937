"""Proofs of motions that begin or end in contact tell each concession, and concede only what rules allow."""

import hashlib
import struct
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import loewner
from checker_oracle import robot_of
from families import translation
from gantry import gantry, wall
from loewner import Body, CollisionChecker, Scene, Verdict, cli, planners
from loewner.verify import Refused, verify
from sampling import examples

# A hand that slides along x and z, and turns about z and y.
HAND = [
    ("prismatic", 0, '<axis xyz="1 0 0"/><limit lower="-2" upper="2"/>'),
    ("prismatic", 1, '<axis xyz="0 0 1"/><limit lower="-2" upper="2"/>'),
    ("revolute", 2, '<axis xyz="0 0 1"/><limit lower="-3" upper="3"/>'),
    ("revolute", 3, '<axis xyz="0 1 0"/><limit lower="-3" upper="3"/>'),
]
REST, TOLERANCE = np.zeros(4), 1e-5
SHAPES = {
    "can": Body.cylinder(radius=0.03, length=0.12),
    "box": Body.box([0.1, 0.06, 0.12]),
    "ball": Body.sphere(0.06),
    "feet": Body.union([Body.box([0.02, 0.02, 0.12]).transformed(translation(x)) for x in (-0.05, 0.0, 0.05)]),
}


@pytest.fixture(scope="module")
def hand(tmp_path_factory):
    return robot_of(tmp_path_factory.mktemp("hand"), HAND, {"l4": Body.sphere(0.01).transformed(translation(z=0.3))})


def carrying(hand, body="can", height=0.06, margin=0.0, **rules):
    """A checker of the hand with a body, whose middle is in the hand and at some height above a table."""
    scene = Scene(margin=margin)
    scene.add("table", Body.box([2, 2, 0.1]), translation(z=-0.05))
    scene.add("can", SHAPES[body])
    scene.attach("can", "l4", translation(z=height), **rules)
    return CollisionChecker(hand, scene)


def proven(checker, a, b, **options):
    """The proof of motions, and its report."""
    proof = checker.certify_edges(a, b, proof=True, **options).proof
    report = proof.verify()
    assert report.model == proof.model_hash == checker.model_hash
    assert proof.differences(checker) == []
    assert np.allclose([points[0] for points in proof.motions], np.atleast_2d(a), atol=0)
    return proof, report


def listed(proof):
    """The proof without its model, where the list of contacts begins in it, and the contacts, 22 bytes each."""
    block, at = proof.data[-32 - proof.size : -32], 8 * 4 + 4 + 65 * len(proof.motions)
    (count,) = struct.unpack_from("<I", block, at)
    return block, at, [block[at + 4 + 22 * k : at + 26 + 22 * k] for k in range(count)]


def changed(proof, contacts, rules=None):
    """The file with other contacts, and possibly rules, and a good checksum."""
    block, at, rows = listed(proof)
    block = block[:at] + struct.pack("<I", len(contacts)) + b"".join(contacts) + block[at + 4 + 22 * len(rows) :]
    model = proof.model if rules is None else proof.model[:-13] + rules
    head = b"LOEWNERP" + struct.pack("<4I", 2, 1, len(model), len(block)) + model + block
    return head + hashlib.sha256(head).digest()


def contact(proof, which=0, **new):
    """The bytes of one of the contacts of a proof, with other numbers."""
    names = "motion", "i", "j", "end", "k", "least"
    fields = dict(zip(names, struct.unpack("<3I2Bd", listed(proof)[2][which]), strict=True)) | new
    return struct.pack("<3I2Bd", *fields.values())


def test_a_lift(hand):
    """A can that is lifted from a table may overlap it by the tolerance, and only at first."""
    checker = carrying(hand, leave=["table"])
    proof, report = proven(checker, REST, [0.1, 0.1, 1.0, 0.2])
    ((*pair, motion, since, until, least),) = report.contacts
    assert (sorted(pair), motion, since, report.rules) == (["can", "table"], 0, 0, ((*pair, 1),))
    assert 0 < until <= Fraction(1, 1000)
    assert least == pytest.approx(-TOLERANCE, rel=1e-6)
    assert "can and table may overlap by 0.01" in str(report)
    assert str(report).endswith("\nclaim        FREE, except for the contacts above")
    # Without contact in the motion there is nothing to concede, and without rules the file is of the first version.
    away, none = proven(checker, [0.1, 0.1, 1.0, 0.2], [0.1, 0.2, 0.0, 0.0])
    assert (none.contacts, none.rules, away.data[8]) == ((), report.rules, 2)
    assert proven(carrying(hand, height=0.1), REST, [0.1, 0.1, 1.0, 0.2])[0].data[8] == 1


def test_sliding_and_setting_down(hand):
    """A can that slides is in contact all along; one that is set down, at the end; both, at both ends."""
    (row,) = proven(carrying(hand, leave=["table"]), REST, [0.3, 0.0, 1.0, 0.0])[1].contacts
    assert row[2:5] == (0, 0, 1)
    (row,) = proven(carrying(hand, reach=["table"]), [0.1, 0.1, 0.0, 0.2], REST)[1].contacts
    assert row[4] == 1
    assert row[3] >= Fraction(999, 1000)
    checker = carrying(hand, leave=["table"], reach=["table"])
    rows = proven(checker, REST, [0.3, 0.0, 1.0, 0.0])[1].contacts
    assert [row[3:5] for row in rows] == [(0, Fraction(1, 2)), (Fraction(1, 2), 1)]
    # A path that slides and then lifts: one stretch, of both motions.
    path = np.array([REST, [0.3, 0.0, 0.0, 0.0], [0.3, 0.2, 0.0, 0.0]])
    first, last = proven(carrying(hand, leave=["table"]), path[:-1], path[1:])[1].contacts
    assert (first[2:5], last[2:4]) == ((0, 0, 1), (1, 0))
    # Up and down again, with both rules: contact at the start of the first motion, and at the end of the second.
    up = np.array([REST, [0.3, 0.2, 0.0, 0.0], [0.6, 0.0, 0.0, 0.0]])
    first, last = proven(checker, up[:-1], up[1:])[1].contacts
    assert (first[2:4], last[2], last[4]) == ((0, 0), 1, 1)


def test_margins_and_depths(hand):
    """Bodies that start within their margin or within each other keep that distance less the tolerance."""
    for height, least in ((0.0605, 0.0005), (0.059, -0.001), (0.03, -0.03)):
        checker = carrying(hand, height=height, margin=0.002, leave=["table"])
        (row,) = proven(checker, REST, [0.0, 0.2, 0.5, 0.0])[1].contacts
        assert row[-1] == pytest.approx(least - TOLERANCE, abs=1e-9)
        assert row[4] < Fraction(1, 2)
    checker = carrying(hand, leave=["table"])
    assert proven(checker, REST, [0.0, 0.2, 0.5, 0.0], tolerance=1e-3)[1].contacts[0][-1] == pytest.approx(-1e-3)


@examples(12, 30)
@given(
    body=st.sampled_from(sorted(SHAPES)),
    turned=st.booleans(),
    motion=st.tuples(st.floats(-0.5, 0.5), st.floats(0.0, 0.5), st.floats(-2, 2), st.floats(-1, 1)),
    gap=st.sampled_from([0.0, 1e-6, -1e-6, 0.0005, -0.01]),
    margin=st.sampled_from([0.0, 0.002]),
    down=st.booleans(),
)
def test_lifts(hand, body, turned, motion, gap, margin, down):
    """Whatever is lifted or set down: if it is free, it has a proof, and sampled distances keep what is told."""
    height = 0.06 + gap
    checker = carrying(hand, body, height, margin, **({"reach": ["table"]} if down else {"leave": ["table"]}))
    a, b = REST, np.array(motion) * [1, 1, turned, turned]
    a, b = (b, a) if down else (a, b)
    if checker.certify_edges(a, b).verdict != Verdict.FREE:
        return
    _, report = proven(checker, a, b)
    shares = np.unique([*np.linspace(0, 1, 41), *2.0 ** -np.arange(1, 20), *1 - 2.0 ** -np.arange(1, 20)])
    Q = a + shares[:, None] * (b - a)
    T = hand.forward_kinematics(Q)[:, -1] @ translation(z=height)
    table = Body.box([2, 2, 0.1])
    distances = loewner.distance(SHAPES[body], T, table, translation(z=-0.05), exact=True).distance
    for share, distance in zip(shares.tolist(), np.ravel(distances).tolist(), strict=True):
        keep = [least for *_, since, until, least in report.contacts if since <= Fraction(share) <= until]
        assert distance > min(keep, default=margin) - 1e-12
    for *_, since, _, least in report.contacts:
        at_end = distances[0] if since == 0 and not down else distances[-1]
        assert least == pytest.approx(min(at_end, margin) - TOLERANCE, abs=1e-9)


def test_changed_contacts(hand):
    """A file whose contacts are changed is refused, or tells the larger concession; each is within the rules."""
    checker = carrying(hand, leave=["table"])
    path = np.array([REST, [0.3, 0.0, 0.0, 0.0], [0.3, 0.2, 0.0, 0.0]])
    proof, report = proven(checker, path[:-1], path[1:])
    one, two = contact(proof), contact(proof, 1)
    assert changed(proof, [one, two]) == proof.data
    k = contact(proof, 1)[13]
    for contacts, words in (
        ([], "fails by"),
        ([two], "contact does not go on in motion 0"),
        ([contact(proof, least=-1.1e-5), two], "contact does not go on in motion 0"),
        ([contact(proof, k=1), two], "contact does not go on in motion 0"),
        ([one], "motion 1, .* fails by"),
        ([one, contact(proof, 1, k=k + 1)], "fails by"),
        ([one, contact(proof, 1, least=1e-12)], "has the end 0, .* 1e-12 m"),
        ([one, contact(proof, 1, end=1)], "No rule"),
        ([one, contact(proof, 1, i=0)], "No rule"),
        ([one, contact(proof, 1, motion=2)], "No rule"),
        ([two, one], "out of order"),
    ):
        with pytest.raises(Refused, match=words):
            verify(changed(proof, contacts))
    told = verify(changed(proof, [contact(proof, least=-0.5), contact(proof, 1, k=0, least=-0.5)]))
    assert "may overlap by 500 mm from t = 0 in motion 0 until t = 1 in motion 1\n" in str(told)
    assert told.contacts[1][3:5] == (0, 1)
    # A rule that the scene has not, so that the hash of the model is another.
    both = struct.pack("<I", 1) + one[4:12] + b"\3"
    data = changed(proof, [one, two], both)
    other = loewner.Proof(data)
    assert verify(data).rules != report.rules
    assert other.model_hash != checker.model_hash
    assert other.differences(checker) == [
        "ends of motions at which contact is allowed for can and table: 3 instead of 1"
    ]
    assert other.differences(carrying(hand)) == [
        "ends of motions at which contact is allowed for can and table: only in the proof"
    ]


def test_contact_does_not_begin_where_motions_join(hand):
    """A can that is put down and lifted again where motions join is told to be in contact all along until then."""
    checker = carrying(hand, leave=["table"], reach=["table"])
    path = np.array([[0.1 * k, 0.1 * (k % 2), 0.0, 0.0] for k in range(5)])
    proof, report = proven(checker, path[:-1], path[1:])
    first, last = report.stretches
    assert (first[2], last[3]) == ((0, 0), (3, 1))
    assert first[3] < last[2]
    assert [row[-1] for row in report.contacts] == pytest.approx([-TOLERANCE] * len(report.contacts))
    # Only the contacts at the end of one motion and at the start of the next one.
    short = [contact(proof, motion=k, end=k % 2, k=6) for k in (1, 2)]
    with pytest.raises(Refused, match="contact does not go on in motion 2"):
        verify(changed(proof, [short[0]]))
    with pytest.raises(Refused, match="contact does not go on in motion"):
        verify(changed(proof, short))


def test_depths_that_geometry_exceeds(hand):
    """No planes prove less than the true depth: with any of the normals, the search finds none, nor do checkers."""
    checker = carrying(hand, leave=["table"], height=0.05)
    proof, report = proven(checker, REST, [0.0, 0.2, 0.5, 0.0])
    assert report.contacts[0][-1] == pytest.approx(-0.01 - TOLERANCE, abs=1e-9)
    verify(changed(proof, [contact(proof, least=-0.0101)]))
    for least in (-0.0099, -0.00999999, -1e-5, -1e-300):
        with pytest.raises(Refused, match="can and table: the plane for motion 0, .* fails by"):
            verify(changed(proof, [contact(proof, least=least)]))


def test_plans_and_commands(hand, tmp_path, capsys):
    """A plan from contact to contact has a proof, and the commands write it, tell contacts and refuse deep ones."""
    checker = carrying(hand, leave=["table"], reach=["table"])
    found = planners.plan(checker, REST, [0.5, 0.0, 0.5, 0.0], full=True, proof=True)
    assert len(found.proof.verify().contacts) >= 2
    file = str(tmp_path / "lift.proof")
    for height, options, status, words in (
        (0.06, [], 0, "every time except in 1 contacts, which are listed above\n"),
        (0.06, ["--overlap", "1e-6"], 1, "DEEP CONTACT: can and table may overlap by 0.0"),
        (0.05, [], 1, "mm in motion 0, and --overlap allows 1 mm\n"),
        (0.05, ["--overlap", "0.011"], 0, "which are listed above\n"),
        (0.05, ["--overlap", "nan"], 2, ""),
    ):
        proven(carrying(hand, leave=["table"], height=height), REST, [0.0, 0.2, 0.5, 0.0])[0].save(file)
        assert cli.main(["verify", file, *options]) == status
        out = capsys.readouterr().out
        assert words in out
        assert status == 2 or "\ncontact      can and table may overlap by " in out
        assert ("verified" in out) == (status == 0)


def test_commands_with_rules(tmp_path, capsys):
    """`plan` and `audit` write proofs of motions from contact, and `verify` compares their rules with a scene's."""
    urdf, srdf = gantry(tmp_path)
    file, path, proof = (str(tmp_path / name) for name in ("scene.yaml", "path.csv", "path.proof"))
    loewner.save_scene(wall(), file)
    robot, rule = [str(urdf), "--srdf", str(srdf), "--scene", file], ["--leave", "ball", "wall"]
    plan = ["plan", *robot, "--start", "-0.15 -0.5 1.57", "--goal", "-0.5 -0.5 1.57", "-o", path, "--proof", proof]
    assert cli.main([*plan, *rule]) == 0
    assert cli.main(["verify", proof, "--robot", *robot, *rule, "--path", path]) == 0
    assert "contact      ball and wall may overlap by 0.01" in capsys.readouterr().out
    assert cli.main(["verify", proof, "--robot", *robot, "--path", path]) == 1
    assert "at which contact is allowed for ball and wall: only in the proof" in capsys.readouterr().out
    assert cli.main(["verify", proof, "--robot", *robot, "--reach", "ball", "wall"]) == 1
    assert "for ball and wall: 1 instead of 2" in capsys.readouterr().out
    assert cli.main(["verify", proof, *rule]) == 2
    assert "--leave: expected --robot with it" in capsys.readouterr().err
    scene = wall()
    scene.leave("ball", "wall")
    loewner.save_scene(scene, file)
    assert cli.main(["audit", robot[0], path, *robot[1:], "--proof", proof]) == 0
    assert cli.main(["verify", proof, "--robot", *robot, "--path", path]) == 0


def test_joint_errors_have_no_contacts(hand):
    """With a joint error, rules of contact do not apply, and neither do they in proofs."""
    checker = carrying(hand, leave=["table"], height=0.061)
    _, report = proven(checker, REST, [0.0, 0.2, 0.0, 0.0], joint_error=1e-5)
    assert report.contacts == ()
    assert checker.certify_edges(REST, [0.0, -0.0005, 0.0, 0.0], joint_error=1e-3, proof=True).proof is None
