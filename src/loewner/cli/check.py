"""``loewner check``: report whether two bodies touch, and their distance."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import loewner
from loewner import Body, Verdict
from loewner.cli import inputs
from loewner.cli.output import STATUS, covering_text, is_surface, model_text, print_answer, print_contact_points

# Fraction of the mesh's volume by which the volume of the pieces may differ without a note.
WORTH_TELLING = 0.01

EXAMPLES = """examples:
  loewner check cup.stl spoon.stl --pose-b "0 0 0.02"            the meshes themselves
  loewner check cup.stl spoon.stl --model pieces                 convex pieces of both
  loewner check arm.npz table.stl --pose-b "0.5 0 0"
  loewner check arm.npz table.npz --pose-b "0.5 0 0 0.924 0 0 0.383" --margin 0.01
  loewner check arm.npz table.npz --pose-a pose.npy --method certified --json

poses: "x y z" in metres, "x y z qw qx qy qz" (quaternion in the order wxyz), or a 4x4 matrix in a .npy or .txt file

exit status: 0 free, 1 colliding (touching is colliding), 2 error, 3 ambiguous (--method certified only)
"""


def add(commands: Any) -> None:
    """Add the command."""
    check = inputs.command(commands, "check", "whether two bodies touch, and their distance", EXAMPLES, _run)
    inputs.add_pair_options(check)
    check.add_argument("--method", choices=("certified", "estimate", "exact"), default="exact", help="default: exact")
    check.add_argument("--json", action="store_true", help="print JSON")


def _run(options: argparse.Namespace) -> int:
    Ta, Tb = inputs.pose(options.pose_a, "--pose-a"), inputs.pose(options.pose_b, "--pose-b")
    a, b = inputs.bodies((options.a, options.b), options)
    certified = Verdict(int(loewner.classify(a, Ta, b, Tb, margin=options.margin)))
    distance = loewner.distance(a, Ta, b, Tb, exact=options.method == "exact")
    verdict = certified
    if options.method != "certified" and certified == Verdict.AMBIGUOUS:
        colliding = loewner.collide(a, Ta, b, Tb, method=options.method, margin=options.margin)
        verdict = Verdict.COLLIDING if colliding else Verdict.FREE
    answer: dict[str, Any] = {
        "verdict": verdict.name,
        "method": options.method,
        "margin": options.margin,
        "certified": certified.name,
        "lower": distance.lower,
        "upper": distance.upper,
        "estimate": distance.estimate,
    }
    if distance.distance is not None:
        answer["distance"] = distance.distance
        answer["depth_is_lower_bound"] = distance.distance < 0 and (is_surface(a) or is_surface(b))
        answer |= {name: getattr(distance, name).tolist() for name in ("witness_a", "witness_b", "normal")}
    for name, body in (("a", a), ("b", b)):
        is_exact = None if body.covering is None else body.covering.exact
        answer[f"{name}_exact"] = True if is_surface(body) else is_exact
        answer[f"{name}_model"] = model_text(body)
    print_answer(options, answer, lambda: _print_answer(answer, [(options.a, a), (options.b, b)]))
    return STATUS[verdict.name]


def _print_answer(answer: dict[str, Any], bodies: list[tuple[Path, Body]]) -> None:
    verdict = answer["verdict"]
    how = {"certified": "the ellipsoids cannot tell", "estimate": "estimated", "exact": "exact"}[answer["method"]]
    if answer["certified"] == verdict != "AMBIGUOUS":
        how = "certified by the ellipsoids"
    relation = {"FREE": "by more than", "COLLIDING": "or closer than"}.get(verdict, "with a margin of")
    keep = f" {relation} {answer['margin']:g} m" if answer["margin"] else ""
    print(f"{verdict}{keep}  ({how})")
    print(f"distance    {answer['lower']:z.6g} .. {answer['upper']:z.6g} m, from the ellipsoids")
    if "distance" in answer:
        kind = _kind_of_distance(answer, [body for _, body in bodies])
        print(f"            {answer['distance']:z.9g} m, {kind}")
        print_contact_points(answer)
    if verdict == "AMBIGUOUS":
        print("            --method exact decides it")
    for name, body in bodies:
        if is_surface(body):
            print(f"model       {name}: {model_text(body)}")
        # An open mesh, for which the excess is NaN, also causes the note.
        if body.covering is not None and not (body.covering.exact and abs(body.covering.excess_volume) < WORTH_TELLING):
            print(f"note: {name}: {covering_text(body.covering)}; the answer is about the pieces")


def _kind_of_distance(answer: dict[str, Any], bodies: list[Body]) -> str:
    """Describe the accuracy of an exact distance or depth; the accuracy of a depth depends on the bodies."""
    if answer["distance"] >= 0:
        return "exact"
    if answer["depth_is_lower_bound"]:
        return "a lower bound on the depth; the way apart may be longer"
    several = any(len(body.pieces) > 1 for body in bodies)
    return f"exact (penetration depth{' of the deepest two pieces' if several else ''})"
