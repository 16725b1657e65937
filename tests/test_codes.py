"""Codes: one table, no name and no number with two meanings where it counts."""

import ast
from pathlib import Path

import numpy as np
import pytest

from loewner._kernels import codes
from loewner._kernels.columns import CONE, SEGMENT
from loewner._kernels.pieces.shapes import unit_support

KERNELS = Path(codes.__file__).parent
NAMES = {name for name in vars(codes) if name.isupper()}
MODULES = [path for path in sorted(KERNELS.rglob("*.py")) if path.name != "codes.py"]


@pytest.mark.parametrize("path", MODULES, ids=lambda path: path.relative_to(KERNELS).as_posix())
def test_no_module_has_a_code_of_its_own_by_the_same_name(path):
    """A code is written in `codes.py` alone: APART was once 0 in one search and 1 in another."""
    assigned = {
        target.id
        for statement in ast.parse(path.read_text()).body if isinstance(statement, ast.Assign)
        for targets in statement.targets
        for target in ast.walk(targets) if isinstance(target, ast.Name)
    }  # fmt: skip
    assert not assigned & NAMES


@pytest.mark.parametrize(
    "family",
    [
        ("FREE", "COLLIDING", "AMBIGUOUS", "INEXACT", "LEFT", "TOO_LONG", "BY_CARE"),
        ("UNSETTLED", "APART", "TOUCHING", "NEAREST", "OVERLAPPING", "DEPTH_FOUND"),
        ("BY_SPHERE", "BY_OUTER", "BY_INNER", "BY_PLANE", "BY_SEARCH", "OPEN", "UNSURE"),
    ],
)
def test_no_number_means_two_things(family):
    """Codes that can stand in the same place differ."""
    assert len({getattr(codes, name) for name in family}) == len(family)


def test_a_kind_without_a_branch_proves_nothing():
    """The support point of a kind that nobody wrote is no number; it was once that of a cone."""
    assert np.isfinite(unit_support.py_func(CONE, 0.1, 0.2, 0.3)).all()
    assert np.isnan(unit_support.py_func(max(CONE, SEGMENT) + 100, 0.1, 0.2, 0.3)).all()
