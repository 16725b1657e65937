"""Prove the verdict about two bodies at two poses: by a plane between them, or by a common point."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from loewner._base import _validate
from loewner._base._guard import guarded
from loewner.bodies import Body, packed_of
from loewner.bodies.parts import in_small_parts
from loewner.errors import ConvergenceError, FileError
from loewner.queries import pairs as queries
from loewner.robots.proofs import common_points, separations
from loewner.robots.proofs.proof_models import Model, model_of_pair
from loewner.robots.proofs.written_proofs import COMMON, FREE, Proof, assembled


@guarded
def prove(a: Body, T_world_a: ArrayLike | None, b: Body, T_world_b: ArrayLike | None, *, margin: float = 0.0) -> Proof:
    """Decide whether two bodies collide, and write a proof of the answer.

    The answer agrees with `collide`, except for bodies that are apart by less than rounding errors: `collide` counts
    these bodies as touching, but `prove` proves that they are FREE.

    Parameters
    ----------
    a, b : Body
    T_world_a, T_world_b : array_like, shape (4, 4), or None
        Poses; translation in metres. None is the identity.
    margin : float
        Distance in metres that the bodies have to keep. If the bodies are farther apart than the margin, the proof
        shows this.

    Returns
    -------
    Proof
        The `verdict` of the proof is FREE or COLLIDING. A proof of FREE contains planes between the bodies, or a single
        plane if both bodies are single pieces. A proof of COLLIDING contains a common point.

    Raises
    ------
    PoseError, InputError
        As for `collide`; also if more than one pair is given.
    ConvergenceError
        If the format cannot express a proof of the answer, for one of four reasons. The bodies may be apart, but not by
        more than the margin. They may touch or nearly touch, so that rounding leaves no point inside both bodies, or no
        plane between them. One of two colliding bodies may be a surface. Hulls of parts of surfaces and clouds may meet
        although the bodies do not.

    Examples
    --------
    >>> from loewner import Body, prove
    >>> T = np.eye(4)
    >>> T[0, 3] = 1.2
    >>> proof = prove(Body.sphere(1.0), None, Body.box([1, 1, 1]), T)
    >>> proof.verdict
    <Verdict.COLLIDING: 1>
    >>> proof.verify().common
    ('a', 'b')
    """
    keep = _validate.positive_scalar(margin, "margin", zero=True)
    for name, body in (("a", a), ("b", b)):
        _validate.instance(body, name, Body)
    poses = np.stack([_validate.pose(T_world_a, "T_world_a"), _validate.pose(T_world_b, "T_world_b")])
    packs = packed_of(a), packed_of(b)
    cut = in_small_parts(packs)
    model, parts = model_of_pair(packs, cut, poses, keep), any(pack.trees for pack in cut)
    if not queries.collide(a, poses[0], b, poses[1], margin=keep):
        return _apart(model, parts, lambda: queries.distance(a, poses[0], b, poses[1], exact=True))
    gap = queries.distance(a, poses[0], b, poses[1], exact=True)
    if 0.0 < gap.distance <= keep:
        raise ConvergenceError(
            f"proof: expected bodies that have a common point, or are apart by more than the margin of {keep:g} m, "
            f"found a distance of {gap.distance:.3g} m"
        )
    for block in common_points.blocks(cut, poses, np.stack([gap.witness_a, gap.witness_b])):
        proof = assembled(COMMON, model.data, block)
        if _holds(proof):
            return proof
    if gap.distance > keep:  # `collide` counts bodies as touching if only rounding errors separate them
        return _apart(model, parts, lambda: gap)
    raise ConvergenceError(
        f"proof: expected a point that is inside both bodies by more than rounding, found none; their overlap is "
        f"{-gap.distance:.3g} m deep{', and a surface has no inside' if any(pack.trees for pack in packs) else ''}"
    )


def _apart(model: Model, parts: bool, measured: Callable[[], queries.Distance]) -> Proof:
    """Write a proof with planes that leave room for checkers that round or, if there are none, with any planes.

    The search for planes may fail near contact, so the last attempt begins with the normal from the careful search for
    the distance.
    """
    for room, careful in ((separations.ROOM, False), (0.0, False), (0.0, True)):
        tree = separations.still(model, room, np.asarray(measured().normal) if careful else None)
        if tree is not None:
            proof = assembled(FREE, model.data, tree)
            if room > 0.0 or _holds(proof):
                return proof
    why = "the hulls of parts of a surface or a cloud are nearer" if parts else "their gap is too small"
    raise ConvergenceError(f"proof: expected planes between the bodies, which are apart, found none: {why}")


def _holds(proof: Proof) -> bool:
    try:
        proof.verify()
    except FileError:
        return False
    return True
