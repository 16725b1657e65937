"""Kernels run by Python: a trace shows by which of its exits a search ended."""

import sys

import numpy as np
import pytest

from families import box_corners
from interpreted_kernels import interpreted, tracing
from loewner._kernels.codes import APART, NEAREST, OVERLAPPING, TOUCHING, UNSETTLED

BOX = box_corners(np.array([1.0, 1.0, 1.0]))


def supports(A, B, shift, W, ends, n):
    """Vertices of two polytopes, the second one shifted, whose difference is least along n."""
    return tuple(A[(A @ n).argmin()]), tuple(B[(B @ n).argmax()] + shift)


@pytest.mark.parametrize(
    ("shift", "reach", "far", "status", "condition"),
    [
        ((3.0, 0.2, 0.1), -np.inf, np.inf, NEAREST, "if closed: break"),
        ((3.0, 0.2, 0.1), -np.inf, 1.0, APART, "if lower > far: break"),
        ((3.0, 0.2, 0.1), 2.5, np.inf, TOUCHING, "if length <= reach: break"),
        ((0.3, 0.2, 0.1), -np.inf, np.inf, OVERLAPPING, "if count == 0: break"),
        ((1.0, 0.2, 0.1), -np.inf, np.inf, UNSETTLED, "if count == 0: break"),
    ],
)
def test_each_exit_of_a_search_has_its_condition_in_a_trace(shift, reach, far, status, condition):
    """The trace names the condition that ended the walk, the round and the size of the simplex."""
    gjk_fast = interpreted("narrow.gjk_fast")
    search, trace, before = gjk_fast.measuring(supports), [], sys.gettrace()
    sys.settrace(tracing(trace.append))
    try:
        found = search(
            BOX, BOX, shift, np.empty(gjk_fast.ENTRIES), (0, 0), (1.0, 0.4, 0.3), 1e-14, reach, far, np.empty(9)
        )
    finally:
        sys.settrace(before)
    assert found[0] == status
    assert [line for line in trace if " search " in line][-1].endswith(condition)
