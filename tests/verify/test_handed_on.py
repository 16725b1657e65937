"""A hundred pick-and-place tasks: each file that a controller gets is proven again, and changed files are judged."""

import pytest

from handed_on import campaign, cells, report
from robot_oracle import disagreement

pytestmark = pytest.mark.verify

TASKS, REFUTED = 100, 30


def test_a_hundred_tasks(tmp_path):
    """All files are FREE, no FREE file is refuted by samples at 10 kHz, and all changed carries that are, collide."""
    tasks = []
    for task in campaign(TASKS, tmp_path):
        tasks.append(task)
        print(task.name, task.refused)
    print("\n".join(report(tasks)))
    handed_on = [file for task in tasks for file in task.handed_on]
    changed = [file for task in tasks for file in task.changed]
    assert len(handed_on) == 5 * TASKS
    assert all(file.status == 0 and not file.refuted for file in handed_on)
    refuted = [file for file in changed if file.refuted]
    assert len(refuted) >= REFUTED
    assert all(file.verdict == "COLLIDING" for file in refuted)
    assert not any(file.wrong for file in changed)


def test_samples_have_the_poses_of_pinocchio(tmp_path):
    """The oracle's poses of links agree with pinocchio, also for the gripper that is added to the UR5."""
    for cell in cells(tmp_path):
        assert disagreement(cell.robot, cell.options[0], 100) < 1e-12
