"""Pick-and-place tasks from poses to files for controllers, which the command line proves again."""

import numpy as np
import pytest

from handed_on import KINDS, TOLERANCE, broken, cells, done

MARGIN = 0.002


@pytest.mark.verify  # seven audits of a robot with meshes, and samples at 10 kHz
@pytest.mark.parametrize("seed", [0, 5])
def test_what_is_handed_on_is_what_was_proven(tmp_path, seed):
    """All five files of a task are FREE, and no verdict about a changed carry is refuted by samples."""
    cell = cells(tmp_path)[seed % 2]
    task = done(cell, KINDS[seed % 3], seed, tmp_path)
    assert not task.refused
    assert [file.status for file in task.handed_on] == [0] * 5
    assert not any(file.refuted for file in task.handed_on)
    assert not any(file.wrong for file in task.changed)


def test_the_oracle_knows_the_rules():
    """Distances in closed form: contact may end once, no deeper than at its start, and begin at most a little deep."""
    away = np.linspace(0.0, 0.05, 501)
    sliding = np.concatenate([np.zeros(100), away])
    for d in (away, sliding, sliding + 1e-3, sliding - 1e-3, away + 0.01):
        assert broken(d, MARGIN, np.inf)[0] <= 0
    for d, by, at in (
        (np.concatenate([[0.0, -1e-3], away]), 1e-3, 1),
        (np.concatenate([away, away[::-1]]), MARGIN, len(away)),
        (np.concatenate([[0.01], away]), MARGIN, 1),
    ):
        found = broken(d, MARGIN, np.inf)
        assert found[0] == pytest.approx(by, abs=2 * TOLERANCE)
        assert found[1] == pytest.approx(at, abs=500)
    assert broken(away - 1e-3, MARGIN, TOLERANCE)[0] == pytest.approx(1e-3, abs=2 * TOLERANCE)
