"""Proofs that are true are verified, and files that are not proofs are refused, whatever is wrong with them."""

import ast
import hashlib
import math
import random
import struct
import subprocess
import sys
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from loewner import verify as checker
from loewner.verify import Refused, main, verify
from sampling import quick

SOURCE = Path(checker.__file__)

# A writer of files, from the page about the format alone.

EYE = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)


def doubles(*numbers):
    return struct.pack(f"<{len(numbers)}d", *numbers)


def name(text):
    return struct.pack("<H", len(text.encode())) + text.encode()


def listed(form, rows):
    return struct.pack("<I", len(rows)) + b"".join(form(*row) for row in rows)


def link(above=-1, kind=0, value=-1, by=1.0, off=0.0, turn=(1, 0, 0, 0), shift=(0, 0, 0), axis=(0, 0, 1)):
    return name("link") + struct.pack("<iBi", above, kind, value) + doubles(by, off, *turn, *shift, *axis)


def hull(points, radius=0.0):
    return b"\0" + doubles(radius) + listed(doubles, points)


def curved(kind, center, matrix, radius=0.0):
    return bytes([kind]) + doubles(radius, *center, *matrix)


def balls(rows, radius=0.0):
    return b"\4" + doubles(radius) + listed(doubles, rows)


def body(where, *pieces, matrix=EYE, shift=(0, 0, 0), inside=0, called="body"):
    head = name(called) + struct.pack("<iB", where, inside) + doubles(*matrix, *shift)
    return head + struct.pack("<I", len(pieces)) + b"".join(pieces)


def box(low, high):
    corners = [(x, y, z) for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (low[2], high[2])]
    return hull(corners)


def model(links, values, bodies, apart=(), margin=0.0, margins=(), rules=None):
    parts = [struct.pack("<I", len(links)), *links]
    parts.append(listed(lambda low, high: name("value") + doubles(low, high), values))
    parts += [struct.pack("<I", len(bodies)), *bodies]
    parts += [listed(lambda i, j: struct.pack("<2I", i, j), apart), doubles(margin)]
    parts.append(listed(lambda i, j, m: struct.pack("<2Id", i, j, m), margins))
    parts += [] if rules is None else [listed(lambda i, j, ends: struct.pack("<2IB", i, j, ends), rules)]
    return b"".join(parts)


def proof(motions, trees, deviations=None, contacts=None):
    deviations = [0.0] * len(motions[0][0]) if deviations is None else deviations
    heads = [bytes([len(points) - 1]) + b"".join(doubles(*row) for row in points) for points in motions]
    listing = b"" if contacts is None else listed(lambda *row: struct.pack("<3I2Bd", *row), contacts)
    return doubles(*deviations) + struct.pack("<I", len(motions)) + b"".join(heads) + listing + trees


def plane(normal, frame=16):
    return bytes([frame]) + struct.pack("<3h", *normal)


def sealed(model, proof, claim=1, version=1):
    data = b"LOEWNERP" + struct.pack("<4I", version, claim, len(model), len(proof)) + model + proof
    return data + hashlib.sha256(data).digest()


def resealed(data):
    return data[:-32] + hashlib.sha256(data[:-32]).digest()


# A rod that turns about z, from 0.2 m to 1 m along x, and a post in the world.

ROD = box((0.2, -0.05, -0.05), (1.0, 0.05, 0.05))
TURNING = link(kind=1, value=0)
BELOW = box((0.0, -0.9, -0.1), (1.0, -0.5, 0.1))
ALONG_Y = b"\x0b"  # a plane in the frame of the second body, with the normal y


def turning(post=BELOW, tree=ALONG_Y, motions=(((0.0,), (0.5,)),), deviations=None, **options):
    pieces = post if isinstance(post, tuple) else (post,)
    given = model([TURNING], [(-3.0, 3.0)], [body(0, ROD), body(-1, *pieces, called="post")], **options)
    return sealed(given, proof(motions, tree, deviations))


# The rod rests on a post, turns away from it, and has left it after 1/32 of the motion.

RESTED = box((0.0, -0.9, -0.1), (1.0, -0.05, 0.1))
LIFTED = ((0.0,), (0.5,))
FROM_CONTACT, INTO_CONTACT = b"\0" * 5 + ALONG_Y + b"\3" * 5, (b"\0" + ALONG_Y) * 5 + b"\3"


def leaving(contacts, rules=((0, 1, 1),), motions=(LIFTED,), tree=FROM_CONTACT, margin=0.0):
    """A file of the second version."""
    bodies = [body(0, ROD, called="can"), body(-1, RESTED, called="table")]
    given = model([TURNING], [(-3.0, 3.0)], bodies, margin=margin, rules=rules)
    return sealed(given, proof(motions, tree, contacts=contacts), version=2)


def bound(degree_points):
    """The term A/8 for the rod: R from the ball about its middle."""
    reach = math.hypot(0.4, 0.05, 0.05) + 0.6
    first, second = np.diff(degree_points), np.diff(degree_points, 2)
    d = len(degree_points) - 1
    w, bend = d * abs(first).max(), d * (d - 1) * abs(second).max(initial=0.0)
    return reach * (w * w + bend) / 8


def test_true_proofs_are_verified():
    """One plane proves a motion, and the report tells what was proven."""
    report = verify(turning(margin=0.1, motions=[[(0.0,), (0.5,)], [(0.5,), (0.1,), (0.2,)]], tree=ALONG_Y * 2))
    assert report.sizes == {"links": 1, "values": 1, "bodies": 2, "pieces": 2, "pairs": 1, "planes": 2, "intervals": 2}
    assert report.motions == ((1, True, True, 2), (2, True, True, 2))
    assert report.tightest[:3] == ("body", "post", 1)
    assert report.margins == (0.1, 0)
    assert report.points == (((0.0,), (0.5,)), ((0.5,), (0.1,), (0.2,)))
    for line in ("begins at    value 0.0\n", "ends at      value 0.2\n", "margin       100 mm; 0 ", "joint error  0\n"):
        assert line in f"{report}\n"
    assert "body and post, motion 1, t in [0, 1]" in str(report)
    assert report.common is None
    low = min(x * math.sin(a) + y * math.cos(a) for a in (0.5, 0.2) for x in (0.2, 1.0) for y in (-0.05, 0.05))
    assert abs(float(report.tightest[-1]) - (low + 0.5 - 0.1 - bound([0.5, 0.1, 0.2]))) < 1e-12
    elsewhere = verify(turning(motions=[[(0.0,), (0.5,)], [(3.0,), (3.0 + 1e-9,)]], tree=ALONG_Y + b"\3"))
    assert elsewhere.motions == ((1, True, True, 2), (1, False, False, 2))


def test_contacts_at_ends():
    """A contact is proven and told in words, at the start, at the end, at both ends and all along motions."""
    least = -bound([0.0, 0.5]) / 32**2
    report = verify(leaving([(0, 0, 1, 0, 5, least - 1e-12)]))
    assert report.rules == (("can", "table", 1),)
    assert report.contacts == (("can", "table", 0, 0, Fraction(1, 32), least - 1e-12),)
    assert "\nrule         can and table may be in contact at the start of motions\ncontact      can and" in str(report)
    assert f"table may overlap by {-1000 * (least - 1e-12):.12g} mm in motion 0 until t = 1/32\n" in str(report)
    assert str(report).endswith("claim        FREE, except for the contacts above")
    with pytest.raises(Refused, match="can and table: the plane for motion 0, .* fails by"):
        verify(leaving([(0, 0, 1, 0, 5, least + 1e-12)]))
    # A leaf that reaches beyond the contact needs the margin.
    with pytest.raises(Refused, match=r"motion 0, t in \[0, 1/32\], fails by"):
        verify(leaving([(0, 0, 1, 0, 6, -1.0)]))
    with pytest.raises(Refused, match=r"motion 0, t in \[0, 1/32\], fails by"):
        verify(leaving([]))
    verify(leaving([(0, 0, 1, 0, 4, -1.0)]))  # a concession that is not needed is told like others
    back = LIFTED[::-1]
    report = verify(leaving([(0, 0, 1, 1, 5, -1e-3)], ((0, 1, 2),), (back,), INTO_CONTACT))
    assert "can and table may overlap by 1 mm in motion 0 from t = 31/32 on\n" in str(report)
    # Up, and down again in a motion that starts there; then the same as one motion of two halves.
    both = [(0, 0, 1, 0, 5, -1e-3), (1, 0, 1, 1, 5, -2e-3)]
    verify(leaving(both, ((0, 1, 3),), (LIFTED, back), FROM_CONTACT + b"\0\3" * 5 + b"\3"))
    arch = ((0.0,), (1.0,), (0.0,))
    half = bound([0.0, 1.0, 0.0]) / 64**2
    tree = b"\0" + b"\0" * 5 + ALONG_Y + b"\3" * 5 + b"\0\3" * 5 + b"\3"
    both = [(0, 0, 1, 0, 6, -1e-9 - half), (0, 0, 1, 1, 6, -1e-9 - half)]
    report = verify(leaving(both, ((0, 1, 3),), (arch,), tree))
    assert [row[3:5] for row in report.contacts] == [(0, Fraction(1, 64)), (Fraction(63, 64), 1)]
    # A margin is kept but where the contact may be nearer.
    near = "can and table may come as near as 0.5 mm all along motion 0"
    raised = [((0.01,), (0.01,))]
    assert near in str(verify(leaving([(0, 0, 1, 0, 0, 5e-4)], motions=raised, tree=ALONG_Y, margin=0.1)))
    with pytest.raises(Refused, match="fails by"):
        verify(leaving([(0, 0, 1, 0, 0, 2.1e-3)], motions=raised, tree=ALONG_Y, margin=0.1))


def test_odd_contacts_are_refused():
    """Contacts without a rule, out of order, overlapping or in only one of two joined motions are refused."""
    whole = (0, 0, 1, 0, 0, -1.0)
    verify(leaving([whole]))
    for contacts, words in (
        ([(1, 0, 1, 0, 5, -1.0)], "No rule allows"),  # of a motion that does not exist
        ([(0, 0, 2, 0, 5, -1.0)], "No rule allows"),
        ([(0, 1, 0, 0, 5, -1.0)], "No rule allows"),
        ([(0, 0, 1, 1, 5, -1.0)], "No rule allows"),
        ([(0, 0, 1, 2, 5, -1.0)], "No rule allows|has the end 2"),
        ([whole, whole], "out of order"),
        ([(0, 0, 1, 0, 64, -1.0)], r"has the end 0, 2\^-64"),
        ([(0, 0, 1, 0, 5, 0.0)], r"0\.0 m"),  # no less than the margin
        ([(0, 0, 1, 0, 5, -math.inf)], "finite"),
        ([(0, 0, 1, 0, 5, math.nan)], "finite"),
        ([(0, 0, 1, 0, 5, -(2.0**32))], "too large"),
    ):
        with pytest.raises(Refused, match=words):
            verify(leaving(contacts))
    ends = ((0, 1, 3),)
    for contacts in ([whole, (0, 0, 1, 1, 5, -1.0)], [(0, 0, 1, 0, 1, -1.0), (0, 0, 1, 1, 0, -1.0)]):
        with pytest.raises(Refused, match="contacts in motion 0 overlap"):
            verify(leaving(contacts, ends))
    with pytest.raises(Refused, match="out of order"):
        verify(leaving([(0, 0, 1, 1, 5, -1.0), (0, 0, 1, 0, 5, -1.0)], ends))
    # Two joined motions: what ends in contact goes on in contact, and nothing begins in contact behind a gap.
    back = LIFTED[::-1]
    for contacts, rules, motions in (
        ([(0, 0, 1, 0, 5, -1.0), (1, 0, 1, 0, 0, -1.0)], ((0, 1, 1),), (LIFTED, back)),
        ([(0, 0, 1, 1, 0, -1.0), (1, 0, 1, 1, 5, -1.0)], ((0, 1, 2),), (LIFTED, back)),
        ([(1, 0, 1, 0, 0, -1.0)], ((0, 1, 3),), (LIFTED, back)),
        ([(0, 0, 1, 1, 5, -1.0)], ((0, 1, 3),), (back, LIFTED)),
        # Neither do two contacts that meet in the middle, and all of a stretch has one least distance.
        ([(0, 0, 1, 1, 5, -1.0), (1, 0, 1, 0, 5, -1.0)], ((0, 1, 3),), (back, LIFTED)),
        ([(0, 0, 1, 1, 0, -1.0), (1, 0, 1, 0, 5, -1.0)], ((0, 1, 3),), (back, LIFTED)),
        ([(0, 0, 1, 0, 0, -1.0), (1, 0, 1, 0, 5, -1.1)], ((0, 1, 1),), (LIFTED, back)),
        ([(0, 0, 1, 1, 5, -1.0), (1, 0, 1, 1, 0, -0.9)], ((0, 1, 2),), (LIFTED, back)),
    ):
        with pytest.raises(Refused, match="can and table: contact does not go on in motion [01]"):
            verify(leaving(contacts, rules, motions))
    verify(leaving([whole, (1, 0, 1, 0, 0, -1.0)], motions=(LIFTED, back), tree=ALONG_Y + b"\3"))
    # A contact may end, or begin, where motions join.
    still = ((0.5,), (0.5,))
    verify(leaving([whole], motions=(LIFTED, still), tree=ALONG_Y + b"\3"))
    verify(leaving([(1, 0, 1, 1, 0, -1.0)], ((0, 1, 2),), (still, back), ALONG_Y + b"\3"))
    # Motions that start anew are sequences of their own.
    verify(leaving([whole, (1, 0, 1, 0, 0, -1.0)], motions=(back, back), tree=ALONG_Y + b"\3"))
    for rules in (((0, 1, 0),), ((0, 1, 4),), ((0, 1, 1), (0, 1, 2)), ((1, 1, 1),), ((1, 0, 1),), ((0, 2, 1),)):
        with pytest.raises(Refused, match="a rule has the ends|out of order, does not exist or is named twice"):
            verify(leaving([whole], rules))
    for version, claim in ((1, 1), (2, 2), (3, 1)):
        data = leaving([whole])
        with pytest.raises(Refused, match="bytes too many|version|FREE"):
            verify(resealed(data[:8] + struct.pack("<2I", version, claim) + data[16:]))
    rigid = model([TURNING], [(-3.0, 3.0)], [body(0, ROD), body(0, RESTED)], rules=((0, 1, 1),))
    with pytest.raises(Refused, match="or the pair is not checked"):
        verify(sealed(rigid, proof([LIFTED], b"", contacts=[]), version=2))


def test_normals_of_doubles():
    """Tokens 18 and 19 name a plane by three doubles, of any size and in either frame; then it can be repeated."""
    for scale in (1.0, 2.0**31, 2.0**-1074):
        for token, sign in ((b"\x13", scale), (b"\x12", -scale)):
            verify(turning(tree=token + doubles(0.0, sign, -0.0)))
            with pytest.raises(Refused, match="fails by"):
                verify(turning(tree=token + doubles(0.0, -sign, 0.0)))
    verify(turning(tree=b"\0\x13" + doubles(1e-300, 1.0, 1e-17) + b"\3"))
    # Two boxes, turned by 0.3 rad, with a gap of 1e-9 m: 16 bits are too coarse for its normal.
    turn = np.array([[math.cos(0.3), -math.sin(0.3), 0], [math.sin(0.3), math.cos(0.3), 0], [0, 0, 1]])
    corners = np.array([(x, y, z) for x in (-1, 0) for y in (-1, 1) for z in (-1, 1)])
    placed = [hull(points @ turn.T) for points in (corners, -corners + (1e-9, 0, 0))]
    given = model([link()], [], [body(0, placed[0]), body(-1, placed[1])])
    verify(sealed(given, proof([[(), ()]], b"\x12" + doubles(*turn[:, 0]))))
    for normal in (turn[:, 0] + 1e-9 * turn[:, 1], np.rint(2.0**15 * turn[:, 0])):
        with pytest.raises(Refused, match="fails by"):
            verify(sealed(given, proof([[(), ()]], b"\x12" + doubles(*normal))))


def test_a_gap_must_exceed_what_is_required():
    """A gap equal to the margin, in exact numbers, is refused; 1e-15 m more is verified. So is the interval's term."""
    still = [[(0.0,), (0.0,)]]
    post = box((0.0, -0.9, -0.1), (1.0, -0.5625, 0.1))
    rod = box((0.25, -0.0625, 0.0), (1.0, 0.0625, 0.0625))
    for margin, free in ((0.5, False), (0.5 - 2.0**-50, True)):
        given = model([TURNING], [(-3.0, 3.0)], [body(0, rod), body(-1, post)], margin=margin)
        if free:
            verify(sealed(given, proof(still, ALONG_Y)))
        else:
            with pytest.raises(Refused, match="fails by"):
                verify(sealed(given, proof(still, ALONG_Y)))
    room = 0.45 - bound([0.0, 0.5])
    verify(turning(margin=room - 1e-12))
    with pytest.raises(Refused, match="fails by"):
        verify(turning(margin=room + 1e-12))
    reach = math.hypot(0.4, 0.05, 0.05) + 0.6
    verify(turning(margin=room - 0.01 * reach - 1e-12, deviations=[0.01]))
    with pytest.raises(Refused, match="fails by"):
        verify(turning(margin=room - 0.01 * reach + 1e-12, deviations=[0.01]))


@pytest.mark.parametrize(
    ("wrong", "match"),
    [
        (turning(tree=b"\x0e"), "fails by"),  # the plane points to the other side
        (turning(tree=b"\0" + ALONG_Y), "ends too early"),
        (turning(tree=b""), "too short|ends too early"),
        (turning(tree=b"\3"), "does not name a plane"),
        (turning(tree=b"\x14"), "does not name a plane"),
        (turning(tree=b"\x12" + doubles(0.0, -0.0, 0.0)), "does not name a plane"),
        (turning(tree=b"\x12" + doubles(0.0, math.nan, 0.0)), "not finite"),
        (turning(tree=b"\x12" + doubles(0.0, 1.0, 2.0**32)), "too large"),
        (turning(tree=plane((0, 0, 0))), "does not name a plane"),
        (turning(tree=b"\1" + ALONG_Y * 2), "divides one piece"),
        (turning(tree=b"\0" * 70 + ALONG_Y * 80), "nested"),
        (turning(tree=ALONG_Y * 2), "1 bytes too many"),
        (turning(margin=math.nan), "not finite"),
        (turning(margin=-1.0), "negative"),
        (turning(margins=[(0, 1, 0.44)]), "fails by"),
        (turning(margins=[(0, 1, 0.1), (0, 1, 0.1)]), "named twice"),
        (turning(margins=[(1, 0, 0.1)]), "out of order"),
        (turning(apart=[(0, 2)]), "does not exist"),
        (turning(motions=[], tree=b"", deviations=[0.0]), "cannot have 0 motions"),
        (turning(motions=[[(0.0,)]]), "degree 0"),
        (turning(motions=[[(0.0,)] * 33]), "degree 32"),
        (turning(motions=[[(0.0,), (math.inf,)]]), "Byte 21 of the proof: inf is not finite"),
        (turning(motions=[[(0.0,), (2e6,)]]), "1e6 rad"),
        (turning(deviations=[-0.1]), "negative"),
        (turning(post=BELOW[:-1]), "model"),
        (turning(post=b"\5" + BELOW[1:]), "Kinds of pieces"),
        (turning(post=balls([(0, -2, 0, -1)])), "negative radius"),
        (turning(post=()), "cannot have 0 pieces"),
        (turning()[:-1], "truncated or extended"),
        (turning() + b"\0", "truncated or extended"),
        (turning()[:8] + b"\x09" + turning()[9:], "version 9, claim 1; this program reads version 1"),
        (turning()[:8], "8 bytes"),
        (b"x" * 99, "not a proof file"),
        (turning()[:-33] + b"\3" + turning()[-32:], "damaged"),
        (b"", "not a proof file"),
    ],
)
def test_files_that_are_no_proofs_are_refused(wrong, match):
    """Each kind of error is refused for its own reason."""
    with pytest.raises(Refused, match=match):
        verify(wrong)


@pytest.mark.parametrize(
    "links",
    [
        [link(above=0)],
        [link(above=-2)],
        [link(kind=3, value=0)],
        [link(kind=1, value=-1)],
        [link(kind=1, value=1)],
        [link(kind=0, value=0)],
        [link(turn=(0, 0, 0, 0))],
        [link(kind=1, value=0, axis=(0, 0, -0.0))],
        [link(shift=(math.nan, 0, 0))],
        [link(by=1e300)],
        [link()] * 10_001,
    ],
)
def test_impossible_links_are_refused(links):
    """Links must form a tree of known joints, with numbers that are rotations."""
    given = model(links, [(-1, 1)], [body(-1, hull([(0, 0, 0)]))])
    with pytest.raises(Refused):
        verify(sealed(given, proof([[(0.0,), (0.0,)]], b"")))


def test_counts_that_a_file_cannot_hold_are_refused_at_once():
    """No count makes the checker fail in an unknown way, or allocate memory for more than the file contains."""
    data, refused = turning(), 0
    for at in range(24, len(data) - 36, 2):
        try:
            verify(resealed(data[:at] + b"\xf0\xff\xff\xff" + data[at + 4 :]))
        except Refused:
            refused += 1
    assert refused > 100


def test_work_is_bounded(monkeypatch):
    """A short file that announces much work is refused before it is done: many motions of high degree."""
    monkeypatch.setattr(checker, "MOST_WORK", 1 << 24)  # a 64th of what is allowed
    still = model([link()], [], [])
    with pytest.raises(Refused, match="steps"):
        verify(sealed(still, struct.pack("<I", 10**5) + b"\x1f" * 10**5))


def test_each_changed_byte_is_found():
    """A changed byte is refused by the hash; if this is repaired, the file is refused or is still a proof."""
    data, dice = turning(margin=0.3), random.Random(0)
    for at in range(dice.randrange(2), len(data), 2):
        other = data[:at] + bytes([data[at] ^ 1 << dice.randrange(8)]) + data[at + 1 :]
        with pytest.raises(Refused):
            verify(other)
        try:
            report = verify(resealed(other))
        except Refused:
            continue
        assert report.sizes["pairs"] == 1
        assert report.tightest[-1] > 0


def test_no_planes_prove_a_motion_that_collides():
    """A rod passes a post between two free ends: no tree and no plane is a proof."""
    post = box((0.5, 0.5, -0.1), (0.6, 0.6, 0.1))
    dice = random.Random(1)

    def tree(depth):
        if depth and dice.random() < 0.6:
            return b"\0" + tree(depth - 1) + tree(depth - 1)
        if dice.random() < 0.3:
            return bytes([dice.randrange(4, 16)])
        angle = dice.uniform(0, 2 * math.pi)
        normal = (round(3e4 * math.cos(angle)), round(3e4 * math.sin(angle)), dice.randrange(-2, 3))
        return plane(normal, dice.choice((16, 17)))

    for _ in range(150):
        with pytest.raises(Refused, match="fails by"):
            verify(turning(post, tree(5), [[(0.0,), (math.pi / 2,)]]))
    # Parts of the motion can be proven: up to an eighth, with a plane between the rod and the post.
    verify(turning(post, plane((0, 1, 0), 16), [[(0.0,), (math.pi / 16,)]]))


def test_pieces_are_divided():
    """A body that no plane separates is divided, and every piece counts."""
    posts = (BELOW, box((0.0, 0.9, -0.1), (1.0, 1.3, 0.1)))
    motion = [[(0.0,), (0.5,)]]
    with pytest.raises(Refused, match="fails by"):
        verify(turning(posts, ALONG_Y, motion))
    verify(turning(posts, b"\2" + ALONG_Y + b"\x0e", motion))
    with pytest.raises(Refused, match="fails by"):
        verify(turning(posts, b"\2" + b"\x0e" + ALONG_Y, motion))
    with pytest.raises(Refused):
        verify(turning(posts, b"\1" + ALONG_Y + b"\x0e", motion))


def test_pairs_left_out_are_reported():
    """Bodies on links that never move against each other are not checked; the others are, unless the model says so."""
    links = [TURNING, link(above=0, shift=(0.1, 0, 0))]
    bodies = [body(0, ROD), body(1, ROD, inside=1, called="lid"), body(-1, BELOW), body(-1, ROD)]
    given = model(links, [(-1, 1)], bodies, apart=[(0, 3), (1, 3)])
    report = verify(sealed(given, proof([[(0.0,), (0.5,)]], ALONG_Y * 2)))
    assert report.sizes["pairs"] == 2
    assert report.left_out == (("body", "body"), ("lid", "body"))
    assert report.uncovered == ("lid",)
    given = model(links, [(-1, 1)], bodies, apart=[(0, 3)])
    with pytest.raises(Refused):
        verify(sealed(given, proof([[(0.0,), (0.5,)]], ALONG_Y * 2)))


# Random chains, placed by NumPy: a few in the quick suite, many in `make verify`.

FEW_OR_MANY = pytest.mark.parametrize("chains", [25, pytest.param(1000, marks=pytest.mark.verify)])


def matrix_of(w, x, y, z):
    w, x, y, z = np.array([w, x, y, z]) / math.sqrt(w * w + x * x + y * y + z * z)
    rows = [[w * w + x * x - y * y - z * z, 2 * (x * y - w * z), 2 * (x * z + w * y)]]
    rows.append([2 * (x * y + w * z), w * w - x * x + y * y - z * z, 2 * (y * z - w * x)])
    rows.append([2 * (x * z - w * y), 2 * (y * z + w * x), w * w - x * x - y * y + z * z])
    return np.array(rows)


def values(control, t):
    """Values on a motion, by de Casteljau's scheme."""
    while len(control) > 1:
        control = (1 - t) * control[:-1] + t * control[1:]
    return control[0]


def placed(links, values):
    """Poses of links given as keywords of `link`; the world comes last."""
    poses = []
    for given in links:
        turn, shift = matrix_of(*given["turn"]), np.array(given["shift"], float)
        v = given["by"] * values[given["value"]] + given["off"]
        if given["kind"] == 1:
            half = np.array(given["axis"]) / np.linalg.norm(given["axis"]) * math.sin(v / 2)
            turn = turn @ matrix_of(math.cos(v / 2), *half)
        elif given["kind"] == 2:
            shift = shift + turn @ np.array(given["axis"]) * v
        if given["above"] >= 0:
            base, place = poses[given["above"]]
            turn, shift = base @ turn, place + base @ shift
        poses.append((turn, shift))
    return [*poses, (np.eye(3), np.zeros(3))]


def random_piece(rng, matrix, shift):
    """A piece as bytes, and points of it in the frame of the link, its radius included."""
    kind, radius = int(rng.integers(5)), float(rng.choice([0.0, 0.05]))
    around = rng.normal(size=(60, 3))
    around /= np.linalg.norm(around, axis=1)[:, None]
    if kind == 0:
        points = rng.normal(size=(4, 3)) * 0.2
        found, core = hull(points, radius), points[np.arange(60) % 4]
    elif kind == 4:
        rows = np.c_[rng.normal(size=(2, 3)) * 0.2, rng.random(2) * 0.1]
        rows = rows[np.arange(60) % 2]
        return balls(rows[:2], radius), rows[:, :3] @ matrix.T + shift + around * (rows[:, 3:] + radius)
    else:
        center, skew = rng.normal(size=3) * 0.2, rng.normal(size=(3, 3)) * 0.2
        u, angle = around.copy(), rng.uniform(0, 2 * math.pi, 60)
        if kind > 1:
            u = np.c_[np.cos(angle), np.sin(angle), rng.choice([-1, 1], 60)]
            if kind == 3:
                u[u[:, 2] > 0] = 0, 0, 1
        found, core = curved(kind, center, skew.ravel(), radius), center + u @ skew.T
    return found, core @ matrix.T + shift + around * radius


def random_robot(rng):
    """Links, as keywords, bodies as bytes, and for each body its link and some of its points."""
    links, bodies, points = [], [], []
    for k in range(int(rng.integers(2, 6))):
        above = int(rng.integers(-1, k)) if k and rng.random() < 0.3 else k - 1
        kind = int(rng.choice([0, 1, 1, 1, 2]))
        given = {"above": above, "kind": kind, "value": int(rng.integers(2)) if kind else -1, "by": float(rng.normal())}
        given |= {
            "off": float(rng.normal()),
            "turn": rng.normal(size=4),
            "shift": rng.normal(size=3),
            "axis": rng.normal(size=3),
        }
        links.append(given)
    for _ in range(3):
        where = int(rng.integers(-1, len(links)))
        matrix = matrix_of(*rng.normal(size=4)) if rng.random() < 0.7 else rng.normal(size=(3, 3))
        shift = rng.normal(size=3) * 0.3
        pieces = [random_piece(rng, matrix, shift) for _ in range(int(rng.integers(1, 3)))]
        bodies.append(body(where, *(piece for piece, _ in pieces), matrix=matrix.ravel(), shift=shift))
        points.append((where, np.concatenate([some for _, some in pieces])))
    return links, bodies, points


@FEW_OR_MANY
def test_bounds_hold_for_random_chains(chains):
    """No point of a body has a larger second derivative than A, strays farther than V, or passes a support."""
    rng = np.random.default_rng(5)
    closest = 0.0
    for _ in range(chains):
        links, bodies, points = random_robot(rng)
        given = model([link(**some) for some in links], [(-1, 1)] * 2, bodies)
        control = rng.normal(size=(int(rng.integers(2, 5)), 2))
        off = rng.random(2) * 0.02
        found = checker._Checker(given, doubles(*off) + b"\0" * 4)
        motion = checker._Motion(0, control.tolist(), found.links, off.tolist())

        def seen(q, low, high, links=links, points=points):
            poses = placed(links, q)
            (a, s), (b, t) = poses[points[low][0]], poses[points[high][0]]
            return (points[high][1] @ b.T + t - s) @ a

        for low, high in ((0, 1), (1, 0), (0, 2), (2, 1)):
            if found.bodies[low].group == found.bodies[high].group:
                continue
            a, v = (x / 2**72 for x in found.bound(motion, points[low][0], high))
            for t in rng.uniform(0.01, 0.99, 6):
                at = seen(values(control, t), low, high)
                bent = seen(values(control, t - 1e-3), low, high) - 2 * at + seen(values(control, t + 1e-3), low, high)
                most = np.linalg.norm(bent, axis=1).max() / 1e-6
                assert most <= a * (1 + 1e-3) + 1e-3
                closest = max(closest, most / (a + 1e-3))
                strayed = seen(values(control, t) + off * rng.choice([-1, 1], 2), low, high) - at
                assert np.linalg.norm(strayed, axis=1).max() <= v * (1 + 1e-9) + 1e-12
    assert closest > 0.9  # the test can find a bound that is too small


@FEW_OR_MANY
def test_accepted_planes_separate(chains):
    """What is proven with random planes is true at random instants, deviations included."""
    rng = np.random.default_rng(6)
    accepted = 0
    for _ in range(chains):
        links, bodies, points = random_robot(rng)
        bodies = bodies[:2]
        control = rng.normal(size=(int(rng.integers(2, 4)), 2)) * 0.3
        off, margin = rng.random(2) * 0.005, float(rng.random() * 0.05)
        given = model([link(**some) for some in links], [(-1, 1)] * 2, bodies, margin=margin)
        for _ in range(6):
            normal = rng.integers(-9, 10, 3)
            try:
                report = verify(sealed(given, proof([control.tolist()], plane(normal), off.tolist())))
            except Refused:
                continue
            if report.sizes["pairs"] == 0:
                continue
            accepted += 1
            for t in rng.random(20):
                poses = placed(links, values(control, t) + rng.uniform(-1, 1, 2) * off)
                first, second = (some @ poses[k][0].T + poses[k][1] for k, some in points[:2])
                assert np.linalg.norm(first[:, None] - second[None], axis=2).min() > margin
    assert accepted > 5


@pytest.mark.parametrize("chains", quick(10, 1000))
def test_no_plane_proves_more_than_the_closest_approach(chains):
    """A margin that two balls miss by 1e-9 m, or by 1e-9 m with deviations, is proven by no plane in no interval."""
    rng, proven, meetings = np.random.default_rng(7), 0, 0
    while meetings < chains // 5:
        links, _, _ = random_robot(rng)
        where = [int(k) for k in rng.integers(-1, len(links), 2)]
        centers, control = rng.normal(size=(2, 3)) * 0.3, rng.normal(size=(int(rng.integers(2, 5)), 2)) * 0.7
        off = rng.random(2) * rng.choice([0.0, 0.01])

        def apart(q, links=links, where=where, centers=centers):
            poses = placed(links, q)
            (a, s), (b, t) = (poses[k] for k in where)
            return a, b, b @ centers[1] + t - a @ centers[0] - s

        times = np.linspace(0, 1, 101)
        distances = [np.linalg.norm(apart(values(control, t))[2]) for t in times]
        low, high = times[max(int(np.argmin(distances)) - 1, 0)], times[min(int(np.argmin(distances)) + 1, 100)]
        for _ in range(50):
            one, two = low + (high - low) * 0.382, low + (high - low) * 0.618
            if np.linalg.norm(apart(values(control, one))[2]) < np.linalg.norm(apart(values(control, two))[2]):
                high = two
            else:
                low = one
        meeting, corners = (low + high) / 2, [(x, y) for x in (-1, 0, 1) for y in (-1, 0, 1)]
        nearest = min(np.linalg.norm(apart(values(control, meeting) + off * corner)[2]) for corner in corners)
        if nearest < 0.05:
            continue
        for margin in (nearest / 2 + 1e-9, nearest / 4):
            bodies = [body(k, balls([(*c, nearest / 4)])) for k, c in zip(where, centers, strict=True)]
            found = checker._Checker(model([link(**x) for x in links], [(-9, 9)] * 2, bodies, margin=margin), b"")
            if found.bodies[0].group == found.bodies[1].group:
                break
            motion = checker._Motion(0, control.tolist(), found.links, off.tolist())
            start, end = 0, 1 << 64
            for _ in range(30):
                for t in (start, end, (start + end) // 2):
                    a, b, n = apart(values(control, t / 2**64))
                    for first, normal in ((True, a.T @ n), (False, -b.T @ n)):
                        rounded = (int(x) for x in np.round(normal / abs(normal).max() * 32767))
                        found.last[0, 1] = first, tuple(rounded)
                        try:
                            found.leaf(motion, (0, 1), [(start, end), (0, 1), (0, 1)])
                        except Refused:
                            continue
                        assert margin < nearest / 2
                        proven += 1
                half = (start + end) // 2
                start, end = (start, half) if meeting * 2**64 < half else (half, end)
        else:
            meetings += 1
    assert proven > 30 * meetings  # with a smaller margin, most intervals are proven


# Common points.

TOUCHING = [body(-1, box((0, 0, 0), (1, 1, 1))), body(-1, box((1, 0, 0), (2, 1, 1)))]


def common(bodies, first, second, point, links=(), values=(), more=(0.0, 0.0, 0.0)):
    content = struct.pack("<6I", *first) + struct.pack("<6I", *second) + doubles(*point, *more)
    return sealed(model(list(links), values, bodies), content, claim=2)


def test_common_points_are_exact():
    """Two boxes that share a face have a common point; one 2^-52 m beside it is none."""
    first, second = (0, 0, 4, 5, 6, 7), (1, 0, 0, 1, 2, 3)
    assert verify(common(TOUCHING, first, second, (1, 0.25, 0.5))).common == ("body", "body")
    for wrong in ((1 + 2.0**-52, 0.25, 0.5), (1 - 2.0**-53, 0.25, 0.5), (1, -(2.0**-60), 0.5), (1, 0.25, 1.5)):
        with pytest.raises(Refused, match="not shown"):
            verify(common(TOUCHING, first, second, wrong))
    # A point is the exact sum of two vectors: of a box that begins 2^-80 m before the other ends, and of no other.
    near = [body(-1, box((0, 0, 0), (1, 1, 1)), matrix=EYE, shift=(2.0**-80, 0, 0)), TOUCHING[1]]
    for off, good in ((2.0**-81, True), (2.0**-80, True), (2.0**-79, False), (-(2.0**-90), False)):
        data = common(near, (0, 0, 0, 4, 5, 7), (1, 0, 0, 1, 3, 7), (1, 0.25, 0.5), more=(off, 0.0, 0.0))
        if good:
            verify(data)
        else:
            with pytest.raises(Refused, match="not shown"):
                verify(data)
    for places in ((first, (1, 0, 0, 1, 2, 8)), (first, (1, 1, 0, 1, 2, 3)), ((0, 0, 0, 0, 0, 0), second)):
        with pytest.raises(Refused):
            verify(common(TOUCHING, *places, (1, 0.25, 0.5)))
    with pytest.raises(Refused, match="different"):
        verify(common(TOUCHING, first, first, (1, 0.25, 0.5)))
    with pytest.raises(Refused, match="different"):
        verify(common(TOUCHING, first, second, (1, 0.25, 0.5), [TURNING], [(-1, 1)]))


def test_common_points_of_all_kinds():
    """The surface of each core belongs to it, and what is beyond it does not."""
    wide = (2.0, 0.0, 0.0, 0.0, 2.0, 0.0, 0.0, 0.0, 2.0)
    cases = [
        (curved(1, (0, 0, 0), wide), (0, 0, 2), 0),
        (curved(2, (0, 0, 0), wide), (0, -2, 2), 0),
        (curved(3, (0, 0, 0), wide), (0, 1, 0), 0),
        (balls([(0, 0, 0, 1.5)], 0.5), (0, 2, 0), 0),
        (hull([(0, 0, 0)], 2.0), (0, 0, 2), 0),
        (hull([(-5, 0, 0), (5, 0, 0)], 2.0), (3, 2, 0), 1),
        (hull([(-1, 0, 0), (3, 0, 0)]), (2.5, 0, 0), 1),
    ]
    lamp = hull([(0.0, 0.0, 0.0)])
    for piece, point, other in cases:
        for factor, good in ((1.0, True), (1.25, False)):
            there = tuple(factor * x for x in point)
            pair = [body(-1, piece), body(-1, lamp, shift=there)]
            data = common(pair, (0, 0, 0, other, 0, 0), (1, 0, 0, 0, 0, 0), there)
            if good:
                verify(data)
            else:
                with pytest.raises(Refused):
                    verify(data)
    # A link's quaternion need not have the norm 1: this one turns x to y, exactly.
    half = [body(0, hull([(3.0, 0.0, 0.0)])), body(-1, hull([(0.0, 4.0, 0.0)]))]
    verify(common(half, (0, 0, 0, 0, 0, 0), (1, 0, 0, 0, 0, 0), (0, 4, 0), [link(turn=(7, 0, 0, 7), shift=(0, 1, 0))]))


# The program.


def test_it_runs_by_itself(tmp_path, capsys):
    """A copy of the file runs without the library; the exit status tells the result, and the table the contents."""
    copy, good, bad = tmp_path / "copied.py", tmp_path / "good.proof", tmp_path / "bad.proof"
    copy.write_text(SOURCE.read_text())
    good.write_bytes(turning(deviations=[0.25**9]))
    bad.write_bytes(turning(tree=b"\x0e"))
    command = [sys.executable, "-I", "-S", str(copy)]
    ran = subprocess.run([*command, str(good)], capture_output=True, text=True, check=True)
    assert ran.stdout.endswith("verified\n")
    assert verify(good.read_bytes()).model in ran.stdout
    assert main([str(good)]) == 0
    assert capsys.readouterr().out == ran.stdout
    assert main([str(bad)]) == 1
    assert main([str(tmp_path / "none")]) == 2
    assert "cannot read" in capsys.readouterr().err


@pytest.mark.verify
def test_a_reader_that_goes_early_changes_no_verdict(tmp_path):
    """If the pipe is closed before anything is printed, there is no traceback, and the status is the verdict's."""
    path = tmp_path / "good.proof"
    path.write_bytes(turning())
    for command in (["-m", "loewner.verify"], ["-m", "loewner", "verify"]):
        ran = subprocess.Popen(
            [sys.executable, *command, str(path)], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )
        ran.stdout.close()
        assert ran.stderr.read() == ""
        ran.stderr.close()
        assert ran.wait() == 0


def test_only_bytes_are_checked():
    """The name of a file, or an object of another type, is no proof that is refused, but a mistake."""
    for wrong in ("plan.proof", None):
        with pytest.raises(TypeError, match="expected the bytes of a file"):
            verify(wrong)


def test_names_cannot_forge_the_table(tmp_path, capsys):
    """Names with line breaks are printed as escapes."""
    bodies = [body(0, ROD, called="a\nverified"), body(-1, BELOW, inside=1, called="\x1b[2J")]
    path = tmp_path / "odd.proof"
    path.write_bytes(sealed(model([TURNING], [(-1, 1)], bodies), proof([[(0.0,), (0.5,)]], ALONG_Y)))
    assert main([str(path)]) == 0
    out = capsys.readouterr().out
    assert out.count("\nverified") == 1
    assert "\x1b" not in out


def test_the_checker_is_small_and_exact():
    """At most 900 lines that import only the standard library, with no decimal point and no function of floats."""
    text = SOURCE.read_text()
    tree = ast.parse(text)
    assert len(text.splitlines()) <= 900
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            assert {alias.name for alias in node.names} <= {"argparse", "hashlib", "os", "struct", "sys"}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0
            assert node.module in {
                "collections.abc",
                "dataclasses",
                "fractions",
                "itertools",
                "math",
                "pathlib",
                "typing",
            }
            assert node.module != "math" or [alias.name for alias in node.names] == ["isqrt"]
        elif isinstance(node, ast.Constant):
            assert not isinstance(node.value, float)
        elif isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
            assert node.func.id not in {"float", "round", "pow", "eval", "exec", "open"}


def test_sines_and_pi():
    """Sines and cosines are within two units of 2^-72 of their values, up to 1e6 rad; π comes from another series."""

    def arctan(n):
        total, term, k = 0, (1 << 256) // n, 1
        while term:
            total, term, k = total + term // k * (1 if k % 4 == 1 else -1), term // (n * n), k + 2
        return total

    half = 2 * (4 * arctan(5) - arctan(239)) >> 256 - checker.GUARD
    assert abs(half - checker.HALF_PI) <= 1
    dice = random.Random(2)
    for _ in range(200):
        angle = dice.randrange(-(10**6) << checker.GUARD, 10**6 << checker.GUARD)
        c, s = checker._cos_sin(angle)
        assert abs(c * c + s * s - checker.ONE**2) < 8 * checker.ONE
        twice = checker._cos_sin(2 * angle)
        assert abs((c * c - s * s >> 72) - twice[0]) < 12
        assert abs((2 * c * s >> 72) - twice[1]) < 12
        near = angle / 2**checker.GUARD
        assert abs(c / 2**72 - math.cos(near)) < 1e-9
        assert abs(s / 2**72 - math.sin(near)) < 1e-9
