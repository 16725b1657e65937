"""Proofs of the verdicts of pairs are verified, near contact too, and what was changed in them is refused."""

import hashlib
import itertools
import struct

import numpy as np
import pytest

import loewner
from checker_oracle import composed_bodies, simple_bodies
from families import FAMILIES, pieces, random_poses, translation
from loewner import (
    Bodies,
    Body,
    ConvergenceError,
    FileError,
    InputError,
    PoseError,
    Proof,
    Verdict,
    cli,
    collide,
    prove,
)
from loewner.bodies import packed_of
from loewner.robots.proofs import common_points, proof_models, separations, written_proofs
from loewner.verify import verify
from sampling import quick

SPHERE, BOX = Body.sphere(0.5), Body.box([1.0, 1.0, 1.0])


def at_gap(rng, a, b, gap):
    """Poses at which two bodies have a signed distance close to the given one; for unions, their deepest pieces."""
    Ta, Tb = random_poses(rng, 2, 0.3)
    found = loewner.distance(a, Ta, b, Tb, exact=True)
    Tb[:3, 3] += (gap - found.distance) * found.normal
    return Ta, Tb


def proven(a, Ta, b, Tb, **options):
    """Prove, verify, and compare with `collide`."""
    proof = prove(a, Ta, b, Tb, **options)
    report = verify(proof.data)
    assert (proof.verdict == Verdict.COLLIDING) == collide(a, Ta, b, Tb, **options) == (report.common is not None)
    assert report.sizes["bodies"] == 2
    assert report.sizes["planes"] > 0 or report.common == ("a", "b")
    return proof


def bodies(family, rng):
    if family == "curved and flat":
        return simple_bodies(rng)
    if family == "unions":
        return composed_bodies(rng)
    return [Body.from_points(points) for points in pieces(family, 4)]


@pytest.mark.parametrize("family", ["curved and flat", "unions", *FAMILIES])
@pytest.mark.parametrize("count", quick(3, 10))
def test_verdicts_near_contact_are_proven(family, rng, count):
    """From 1 mm to 1e-12 m of gap or overlap, and at random, every verdict has a proof."""
    made, seen = bodies(family, rng), set()
    for k in range(3 * count if family == "curved and flat" else count):
        i, j = rng.integers(len(made), size=2)
        gap = (-1) ** k * 10.0 ** rng.uniform(-12, -3) if family != "unions" else (-1) ** k * 10 ** rng.uniform(-9, -3)
        poses = at_gap(rng, made[i], made[j], gap) if k % 5 else random_poses(rng, 2, 0.3)
        seen.add(proven(made[i], poses[0], made[j], poses[1]).verdict)
    assert seen == {Verdict.FREE, Verdict.COLLIDING}


def test_margins(rng):
    """FREE is proven by more than the margin; bodies that are apart, but nearer, have no proof."""
    for gap in (1e-9, 1e-3):
        Ta, Tb = at_gap(rng, SPHERE, BOX, 0.1 + gap)
        proof = proven(SPHERE, Ta, BOX, Tb, margin=0.1)
        assert verify(proof.data).margins == (0.1, 0)
        assert 0 < float(verify(proof.data).tightest[-1]) < 1.01 * gap
    with pytest.raises(ConvergenceError, match=r"more than the margin of 0.102 m, found a distance of 0.101"):
        prove(SPHERE, None, BOX, translation(1.101), margin=0.102)
    proven(SPHERE, None, BOX, translation(0.9), margin=0.2)


def test_exact_contact():
    """Bodies that touch have a common point: if it is a sum of two doubles, that is a proof."""
    assert proven(SPHERE, None, SPHERE, translation(1.0)).verdict == Verdict.COLLIDING
    assert proven(BOX, None, BOX, translation(1.0, 0.25)).verdict == Verdict.COLLIDING
    turn = np.eye(4)
    turn[:2, :2] = [[0.8, -0.6], [0.6, 0.8]]
    shifted = turn.copy()
    shifted[:3, 3] = turn[:3, 0]
    with pytest.raises(ConvergenceError, match="inside both bodies by more than rounding|gap is too small"):
        prove(BOX, turn, BOX, shifted)


def test_normals_of_doubles_only_where_they_are_needed(rng):
    """Far apart, an axis or 16 bits suffice; near contact, a plane takes 25 bytes."""
    hulls = [Body.from_points(points) for points in pieces("ball 50", 4)]
    for gap, size, token in (
        (0.1, 7, separations.NORMAL),
        (1e-3, 7, separations.NORMAL),
        (1e-8, 25, separations.DOUBLES),
    ):
        for a, b in zip(hulls, hulls[::-1], strict=True):
            Ta, Tb = at_gap(rng, a, b, gap)
            tree = (proof := proven(a, Ta, b, Tb)).data[-27 - proof.size : -32]
            assert len(tree) in (1, size)
            assert len(tree) == 1 or tree[0] in (token, token + 1)
    assert len(tree) == 25


def test_clouds_and_surfaces(rng):
    """If their parts are apart, so are they; balls of a cloud can have a point in common with another body."""
    trimesh = pytest.importorskip("trimesh")
    cloud = Body.from_cloud(rng.normal(size=(300, 3)) * 0.1, radius=0.02)
    torus = Body.from_surface(trimesh.creation.torus(0.4, 0.1))
    proven(cloud, None, torus, translation(z=0.6))
    proof = proven(torus, None, Body.sphere(0.2), None)  # in the hole
    assert proof.verify().uncovered == ("a",)
    for other in simple_bodies(rng)[::2]:
        assert proven(other, None, cloud, translation(x=0.1)).verdict == Verdict.COLLIDING
    with pytest.raises(ConvergenceError, match="m deep, and a surface has no inside"):
        prove(SPHERE, None, torus, translation(x=0.4))
    dust = [Body.from_cloud(rng.random((1500, 3)), radius=1e-4) for _ in range(2)]
    with pytest.raises(ConvergenceError, match="hulls of parts of a surface or a cloud are nearer"):
        prove(dust[0], None, dust[1], None)


def test_bad_input():
    """One pair of bodies is asked for."""
    with pytest.raises(InputError, match="b: expected loewner.Body, found Bodies"):
        prove(SPHERE, None, Bodies([BOX]), None)
    with pytest.raises(PoseError, match=r"T_world_b: expected shape \(4, 4\)"):
        prove(SPHERE, None, BOX, np.tile(np.eye(4), (2, 1, 1)))
    with pytest.raises(InputError, match="margin"):
        prove(SPHERE, None, BOX, None, margin=-1.0)
    with pytest.raises(InputError, match="lengths below"):
        prove(SPHERE, None, BOX, translation(5e9))


def test_files(tmp_path, capsys):
    """They are saved, loaded and verified like proofs of motions; the table says that nothing moves."""
    path = tmp_path / "pair.proof"
    for x, words in (
        (1.5, "holds by 500 mm (a and b, which do not move)"),
        (0.8, "COLLIDING: a and b have a common point"),
    ):
        proof = prove(SPHERE, None, BOX, translation(x))
        proof.save(path)
        assert Proof.load(path) == proof
        assert cli.main(["verify", str(path)]) == (0 if proof.verdict == Verdict.FREE else 1)
        out = capsys.readouterr().out
        assert words in out
        assert "motion 0" not in out
        if proof.verdict == Verdict.FREE:
            assert [points.shape for points in proof.motions] == [(2, 0)]
    with pytest.raises(InputError, match="expected motions, found a common point"):
        _ = proof.motions


# -- mutants -----------------------------------------------------------------------------------


def changed(proof, at, data):
    """Change bytes of a proof, counted from the beginning of the file, and its checksum."""
    whole = proof.data[:at] + data + proof.data[at + len(data) : -32]
    return whole + hashlib.sha256(whole).digest()


def mutants():
    """Changes that make a claim false, of proofs of a sphere and a box in a free and in a colliding place."""
    free, common = prove(SPHERE, None, BOX, translation(1.25)), prove(SPHERE, None, BOX, translation(0.9))
    radius = free.data.index(struct.pack("<d", 0.5))
    yield changed(free, radius, struct.pack("<d", 0.8))
    begin = len(free.data) - 32 - free.size
    for token in {*range(16)} - {4, 13}:  # x in the frame of the sphere, -x in that of the box
        yield changed(free, begin + 5, bytes([token]))
    yield changed(free, begin - 12, struct.pack("<d", 0.5))  # the margin
    begin = len(common.data) - 32 - common.size
    yield changed(common, begin, struct.pack("<I", 1))  # twice the same body
    yield changed(common, begin + 4, struct.pack("<I", 1))  # no such piece
    yield changed(common, begin + 48, struct.pack("<d", 3.0))
    yield changed(common, begin + 72, struct.pack("<d", 3.0))
    yield changed(common, common.data.index(struct.pack("<d", 0.5)), struct.pack("<d", 0.01))


def test_changed_proofs_are_refused():
    """Each change that makes the claim false is refused."""
    made = list(mutants())
    assert len(made) == 21
    for data in made:
        with pytest.raises(FileError):
            Proof(data).verify()


@pytest.mark.parametrize("count", quick(10, 24))
def test_false_claims_are_refused(rng, count):
    """A nanometre from contact, no point is common to bodies that are apart, and no plane is between others."""
    made = simple_bodies(rng)
    for k in range(count):
        a, b = (made[n] for n in rng.integers(len(made), size=2))
        poses = np.stack(at_gap(rng, a, b, (-1) ** k * 1e-9))
        found, packs = loewner.distance(a, poses[0], b, poses[1], exact=True), (packed_of(a), packed_of(b))
        model = proof_models.model_of_pair(packs, packs, poses, 0.0).data
        assert Proof.verify(prove(a, poses[0], b, poses[1]))
        if found.distance > 0:
            near = np.stack([found.witness_a, found.witness_b])
            claims = list(itertools.islice(common_points.blocks(packs, poses, near), 6))
        else:
            planes = []
            for token, T, sign in ((18, poses[0], 1.0), (19, poses[1], -1.0)):
                normals = sign * (found.normal + rng.normal(size=(6, 3)) * [[0.0], *[[10.0**-n] for n in range(5, 10)]])
                planes += [bytes([token]) + (n @ T[:3, :3]).tobytes() for n in normals]
            claims = [struct.pack("<IB", 1, 1) + plane for plane in planes]
        assert claims
        for claim in claims:
            with pytest.raises(FileError):
                written_proofs.assembled(2 if found.distance > 0 else 1, model, claim).verify()
