"""Every robot of example-robot-data that has an SRDF: it loads, and its links are where pinocchio sees them."""

import re
import warnings

import numpy as np
import pytest

from loewner import Robot
from robot_oracle import PAIRS, disagreement, robots_folder

pytestmark = pytest.mark.verify

CONFIGURATIONS = 1000

WITHOUT_URDF = {"cassie_v2"}  # an SDF file only


def test_no_robot_is_left_out():
    """Each SRDF of the package is in the list."""
    files = {path.stem for path in robots_folder().glob("*/srdf/*.srdf")}
    assert files == {srdf for _, srdf in PAIRS} | WITHOUT_URDF


@pytest.mark.parametrize(("urdf", "srdf"), PAIRS)
def test_robot_loads_and_agrees_with_pinocchio(urdf, srdf):
    """Its links with collision geometry get bodies, and all poses agree to 1e-9 at 1,000 configurations."""
    path = robots_folder() / urdf
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # names that the files get wrong
        robot = Robot.from_urdf(path, srdf=robots_folder() / urdf.split("/")[0] / "srdf" / f"{srdf}.srdf")
        worst = disagreement(robot, path, CONFIGURATIONS)
    with_geometry = re.findall(r"<link\s+name=\"([^\"]+)\"(?:(?!</link>|<link\s).)*<collision", path.read_text(), re.S)
    commented = "".join(re.findall(r"<!--.*?-->", path.read_text(), re.S))
    assert set(robot.bodies) >= {name for name in with_geometry if f'"{name}"' not in commented}
    assert all(set(pair) <= set(robot.link_names) for pair in robot.disabled_pairs)
    assert all(set(group) <= set(robot.joint_names) for group in robot.groups.values())
    for state in robot.states:
        assert np.isfinite(robot.configuration(state)).all()
    print(f"{robot}: {worst:.1e}")
    assert worst < 1e-9
