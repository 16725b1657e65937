"""The second checker of proofs, in C, which was written from the page about the format alone."""

import os
import random
import shlex
import struct
import subprocess
from pathlib import Path

import numpy as np
import pytest

from checker_oracle import composed_bodies, simple_bodies
from families import pieces, translation
from loewner import Body, Verdict, prove
from loewner.verify import Refused, verify
from motion_oracle import ring
from sampling import quick
from test_pair_proofs import at_gap, mutants
from test_verify import (
    ALONG_Y,
    BELOW,
    FROM_CONTACT,
    INTO_CONTACT,
    LIFTED,
    ROD,
    TURNING,
    body,
    bound,
    box,
    common,
    doubles,
    hull,
    leaving,
    link,
    model,
    plane,
    proof,
    resealed,
    sealed,
    turning,
)  # fmt: skip
from test_written_proofs import around, panda  # noqa: F401

SOURCE = Path(__file__).parents[1] / "examples" / "verify.c"


def compiled(folder, level):
    """The second program in a folder: all files of tests in a process have the same folder, and compile it once."""
    program = folder / f"second-checker{level}"
    if not program.exists():
        compiler = shlex.split(os.environ.get("CC") or "cc")
        flags = ["-std=c11", level, "-Wall", "-Wextra", "-Wpedantic", "-Wconversion"]
        told = subprocess.run([*compiler, *flags, SOURCE, "-o", program, "-lm"], capture_output=True, text=True)
        assert (told.returncode, told.stderr) == (0, "")
    return program


@pytest.fixture(scope="module", params=quick("-O0", "-O2"))
def agrees(request, tmp_path_factory):
    """Return a function of the bytes of a file: whether both programs verify it; an error if they differ.

    Only the first program decides all common points exactly; unless `exactly`, the second one may refuse more.
    """
    program = compiled(tmp_path_factory.getbasetemp(), request.param)
    file = tmp_path_factory.mktemp("second") / "made.proof"

    def both(data, exactly=True):
        file.write_bytes(data)
        told = subprocess.run([program, file], capture_output=True, text=True, check=False)
        assert told.returncode in (0, 1), told
        said = told.stdout.startswith("verified")
        assert (told.returncode == 0) == told.stdout.startswith("verified: FREE")
        try:
            report = verify(data)
        except Refused:
            report = None
        assert said == (report is not None) or not (exactly or said), told.stdout
        assert report is None or not said or report.model in told.stdout
        assert not said or ("COLLIDING" in told.stdout) == (report.common is not None)
        assert not said or told.stdout.count("\ncontact: ") == len(report.contacts)
        assert not said or ("except for" in told.stdout) == bool(report.contacts)
        return report is not None and said

    return both


def test_they_agree_about_a_turning_rod(agrees):
    """Both verify a gap just above what is required, and refuse one just below."""
    assert agrees(turning())
    assert agrees(turning(margin=0.1, motions=[[(0.0,), (0.5,)], [(0.5,), (0.1,), (0.2,)]], tree=ALONG_Y * 2))
    low = 0.2 * np.sin(0.5) - 0.05 * np.cos(0.5)
    least = min(low, -0.05) + 0.5 - bound([0.0, 0.5])
    assert agrees(turning(margin=least - 1e-11))
    assert not agrees(turning(margin=least + 1e-11))
    assert not agrees(turning(tree=b"\x04"))
    assert not agrees(turning(tree=ALONG_Y + b"\0"))
    assert not agrees(turning(motions=[], tree=b"", deviations=[0.0]))
    assert not agrees(sealed(model([], [], []), proof([], b"", [])))


CONTACT, BACK = (0, 0, 1, 0, 5, -1e-3), LIFTED[::-1]


def test_they_agree_about_contacts(agrees, rng):
    """Both allow the same depths, at the same leaves, and refuse the same lists."""
    least = -bound([0.0, 0.5]) / 32**2
    assert agrees(leaving([(0, 0, 1, 0, 5, least - 1e-11)]))
    assert not agrees(leaving([(0, 0, 1, 0, 5, least + 1e-11)]))
    assert agrees(leaving([(0, 0, 1, 1, 5, -1e-3)], ((0, 1, 2),), (BACK,), INTO_CONTACT))
    assert agrees(leaving([(0, 0, 1, 0, 0, 5e-4)], motions=[((0.01,), (0.01,))], tree=ALONG_Y, margin=0.1))
    assert not agrees(leaving([(0, 0, 1, 0, 0, 2.1e-3)], motions=[((0.01,), (0.01,))], tree=ALONG_Y, margin=0.1))
    down = FROM_CONTACT + b"\0\3" * 5 + b"\3"
    assert agrees(leaving([CONTACT, (1, 0, 1, 1, 5, -1e-3)], ((0, 1, 3),), (LIFTED, BACK), down))
    for k in (29, 30, 31, 63, 64):  # the leaf at the end in contact has the length 2^-30
        deep = b"\0" * 30 + ALONG_Y + b"\3" * 30, (b"\0" + ALONG_Y) * 30 + b"\3"
        for end, motion in enumerate((LIFTED, BACK)):
            assert agrees(leaving([(0, 0, 1, end, k, -1e-6)], ((0, 1, 3),), (motion,), deep[end])) == (k <= 30)
    whole = b"\0" * 64 + ALONG_Y + b"\3" * 64, (b"\0" + ALONG_Y) * 64 + b"\3"
    assert all(agrees(leaving([(0, 0, 1, 0, 0, -1.0)], tree=tree)) for tree in whole)
    # Any lists: ordered or not, of one motion or of two that may join.
    verified = 0
    for _ in range(60):
        motions = [(LIFTED, BACK)[n] for n in rng.integers(2, size=rng.integers(1, 4))]
        rows = {
            (int(rng.integers(len(motions))), 0, 1, int(rng.integers(2)), int(rng.choice([0, 1, 5]))) for _ in range(3)
        }
        rows = sorted((*row, -float(rng.choice([1.0, 1.0, 2.0]))) for row in rows)
        if rng.integers(6) == 0:
            rows.reverse()
        tree = b"".join(ALONG_Y if rng.integers(2) else (INTO_CONTACT, FROM_CONTACT)[x is LIFTED] for x in motions)
        verified += agrees(leaving(rows, ((0, 1, int(rng.integers(1, 4))),), motions, tree))
    assert 0 < verified < 60


def test_they_agree_about_an_arm(panda, agrees, rng):  # noqa: F811
    """Both verify the proofs that the library writes for motions of a Panda among boxes."""
    checker, Q, ends = around(panda, rng, ring(rng, 8, 0.5, 0.9, 0.3), 6, 0.5)
    free = checker.certify_edges(Q, ends).verdict == Verdict.FREE
    made = checker.certify_edges(Q[free], ends[free], proof=True).proof
    assert agrees(made.data)


@pytest.mark.parametrize("count", quick(12, 30))
def test_they_agree_about_pairs(agrees, rng, count):
    """Both verify the proofs of pairs, also of bodies a micrometre apart or within each other, and no false ones."""
    made = [*simple_bodies(rng), composed_bodies(rng)[1]]
    for k in range(count):
        a, b = (made[n] for n in rng.integers(len(made), size=2))
        Ta, Tb = at_gap(rng, a, b, (-1) ** k * 10.0 ** rng.uniform(-7, -1))
        assert agrees(prove(a, Ta, b, Tb).data)
    assert not any(agrees(data) for data in mutants())


MUTANTS = 60


@pytest.mark.parametrize(
    ("agrees", "count"),
    [
        pytest.param("-O0", MUTANTS, id="some"),
        pytest.param("-O2", 20_000, id="many", marks=pytest.mark.verify),
    ],
    indirect=["agrees"],
)
def test_they_agree_about_mutants(count, agrees):
    """Whatever is changed in a file, with its checksum made good, both give the same answer, mostly a refusal."""
    draw = random.Random(5)
    hulls = [Body.from_points(points) for points in pieces("ball 8", 2)]
    pair = [prove(hulls[0], None, hulls[1], translation(x)).data for x in (4.0, 0.1)]
    sound = [
        turning(margin=0.2),
        turning(tree=b"\0" + plane((0, 300, 1), 17) + b"\3", margin=0.3),
        turning(tree=b"\0\x13" + doubles(1e-3, 0.7, -1e-300) + b"\3", margin=0.3),
        turning((BELOW, box((-1.0, -0.8, 0.3), (-0.5, -0.5, 0.5))), b"\2" + ALONG_Y + ALONG_Y, margin=0.05),
        sealed(
            model([TURNING, link(0, 2, 1, axis=(1, 0, 0))], [(-3, 3), (-1, 1)], [body(1, ROD), body(-1, BELOW)]),
            proof([[(0.0, 0.0), (0.2, 0.1)]], ALONG_Y, [1e-4, 1e-3]),
        ),
        leaving([CONTACT]),
        leaving([CONTACT, (1, 0, 1, 1, 5, -1e-3)], ((0, 1, 3),), (LIFTED, BACK), FROM_CONTACT + INTO_CONTACT),
    ]
    sound += pair
    assert all(agrees(data) for data in sound)
    verified = 0
    for _ in range(count):
        data = bytearray(draw.choice(sound))
        for _ in range(draw.choice((1, 1, 1, 2))):
            at = draw.randrange(8, len(data) - 32)
            what = draw.randrange(4)
            if what == 0:
                data[at] ^= 1 << draw.randrange(8)
            elif what == 1:
                data[at] = draw.randrange(256)
            elif what == 2:
                del data[at : at + draw.choice((1, 4, 8))]
            else:
                data[at:at] = struct.pack("<d", draw.choice((0.0, 1.0, -1.0, 1e-300, float("nan"), 1e9)))
        if len(data) > 60:
            verified += agrees(resealed(bytes(data)), exactly=data[12] == 1)
    # Many bits of names, of corners inside the hull or of last places do not matter.
    assert 0 < verified < count / 2


def test_they_agree_about_common_points(agrees):
    """Both verify a point of two boxes, and refuse one that is outside of either."""
    corners = [(-1, -1, -1), (1, 1, -1), (1, -1, 1), (-1, 1, 1)]
    bodies = [body(-1, hull(corners)), body(-1, hull(corners), shift=(0.5, 0, 0))]
    assert agrees(common(bodies, (0, 0, 0, 1, 2, 3), (1, 0, 0, 1, 2, 3), (0.25, 0.0, 0.0)))
    assert not agrees(common(bodies, (0, 0, 0, 1, 2, 3), (1, 0, 0, 1, 2, 3), (-0.75, 0.0, 0.0)))
