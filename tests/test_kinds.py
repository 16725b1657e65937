"""Kinds of pieces: one that a place does not know is refused there or left undecided, and never taken for another."""

import numpy as np
import pytest

from checker_oracle import robot_of
from interpreted_kernels import interpreted
from loewner import (
    Body,
    CollisionChecker,
    ConvergenceError,
    InputError,
    Scene,
    Verdict,
    classify,
    collide,
    distance,
    judging,
)
from loewner._kernels import columns
from loewner._kernels.pieces.shapes import unit_support
from loewner.bodies import CURVED, kinds
from loewner.bodies.primitives import primitives
from loewner.robots import swept
from loewner.robots.proofs import common_points, proof_models

NUMBER = max(CURVED) + 1
# A place at which the outer ellipsoids of a mock body and a box meet, and the inner ones do not.
NEAR = np.array([[1.0, 0, 0, 0.0], [0, 1, 0, 0.09], [0, 0, 1, 0.09], [0, 0, 0, 1]])


@pytest.fixture
def mock(monkeypatch: pytest.MonkeyPatch) -> Body:
    """A body of a kind that only has a row: two cones, base to base."""
    row = kinds.Kind(
        "spindle", CURVED[columns.CONE].sizes, lambda: kinds.revolved((0, -1), (1, 0), (0, 1)),
        kinds._image((0.5, 0.5, 0.5)), kinds._UNIT, inradii=(0.99, 0.99, 0.99),
    )  # fmt: skip
    monkeypatch.setitem(CURVED, NUMBER, row)
    monkeypatch.setitem(kinds.KIND_NAMES, NUMBER, row.name)
    return Body(primitives(NUMBER, np.zeros(1), np.full((1, 3), 0.1)))


def test_kernels_leave_an_unknown_kind_undecided(mock):
    """Where ellipsoids do not decide, no search does: the verdict is open, and there is no exact answer."""
    for other in (Body.box([0.1, 0.1, 0.1]), Body.cone(0.05, 0.1), Body.cylinder(0.07, 0.1), mock):
        assert classify(mock, None, other, NEAR) == Verdict.AMBIGUOUS
        with pytest.raises(ConvergenceError):
            collide(mock, None, other, NEAR)
        with pytest.raises(ConvergenceError):
            distance(mock, None, other, NEAR, exact=True)


def test_threads_of_a_gpu_know_the_kinds_of_the_cpu_or_nothing():
    """Farthest points are those of the CPU's support function, or no numbers."""
    module = interpreted("threads.searches")
    vars(module).update(
        number_at=lambda array, at: array[at], lane_of=float, sqrt=np.sqrt, maximum=max,
        select=lambda condition, x, y: x if condition else y, signed_one=lambda x: np.copysign(1.0, x),
    )  # fmt: skip
    numbers = np.zeros(columns.CORE_NUMBERS)
    numbers[columns.CORE_FACTOR : columns.CORE_FACTOR + 9 : 4] = 1.0
    known = set()
    for kind in (*CURVED, NUMBER):
        for n in np.random.default_rng(kind).normal(size=(100, 3)):
            point = module._farthest_of_curve(module.Core(kind, 0, 0, numbers, None), tuple(n))
            expected = np.zeros(3) if kind == columns.POINT else unit_support.py_func(kind, *n)
            if not np.isnan(point).any():
                known.add(kind)
                assert np.dot(point, n) == pytest.approx(np.dot(expected, n), abs=1e-12)
    assert {columns.ELLIPSOID, columns.CYLINDER, columns.CONE, columns.SEGMENT, columns.POINT} <= known <= {*CURVED}


def test_covers_refuse_kinds_without_a_gauge(mock):
    """Neither is such a piece covered, nor does it cover another one."""
    box = Body.box([0.1, 0.1, 0.1])
    for a, b in ((mock, box), (box, mock)):
        with pytest.raises(InputError, match="kinds with a gauge"):
            a.covered_by(b)


def test_written_proofs_refuse_kinds_that_the_format_lacks(mock, tmp_path):
    """The model of a robot is refused by the kind's name, and so are points that two pieces share."""
    robot = robot_of(tmp_path, [("revolute", 0, '<limit lower="-1" upper="1"/>')], {"l1": mock})
    checker = CollisionChecker(robot, Scene())
    with pytest.raises(InputError, match="proof: expected pieces of a kind that the format has, found a spindle"):
        proof_models.model_of(checker._ready(timed=True))
    with pytest.raises(KeyError):
        common_points._Piece(mock._packed, 0, np.eye(4), np.zeros(3)).planes(np.ones(3))


def test_a_row_is_enough_for_polytopes_around_pieces(mock):
    """Bodies that move, MJCF and judges of answers need no more than a row."""
    points, out = swept._around(NUMBER, 0.0, np.zeros(3), 0.1 * np.eye(3), 1.0)
    assert np.abs(points).max() >= 0.1
    assert 0 < out < 0.01
    assert 'type="mesh"' in mock.to_mjcf()
    assert not judging._Pairs(mock, np.eye(4), mock, NEAR).kinds()[1]


@pytest.mark.parametrize("number", CURVED)
def test_gauges_and_support_functions_agree(number):
    """A row has both or a ball; the gauge is 1 on the mesh, at most 1 in it, less in the middle, and hardly steep."""
    kind = CURVED[number]
    assert (kind.gauge is kinds._missing) == (kind.support is kinds._missing) == (kind.core is not None)
    if kind.core is not None:
        return
    corners, triangles = kind.mesh()
    directions = np.random.default_rng(number).normal(size=(1000, 3))
    reach = kind.support(directions)
    assert (directions @ corners.T <= reach[:, None] + 1e-12).all()
    assert (directions @ corners.T).max(axis=1) == pytest.approx(reach, rel=5e-3)
    assert kind.gauge(corners[np.unique(triangles)]) == pytest.approx(1.0, abs=1e-12)
    assert kind.gauge(np.zeros((1, 3))) < 1
    points = directions[:500] * 0.7
    slope = np.abs(kind.gauge(points) - kind.gauge(directions[500:])) / np.linalg.norm(
        points - directions[500:], axis=1
    )
    assert slope.max() <= 1 + 1e-12
    outside = np.flatnonzero(kind.gauge(points) > 1)
    shares = kind.share(points[outside])
    assert (kind.gauge(shares[:, None] * points[outside]) <= 1 + 1e-12).all()
    # Inside, no direction separates.
    within = points[kind.gauge(points) <= 1]
    assert (within @ directions.T <= reach + 1e-12).all()
