"""Every robot of example-robot-data that has an SRDF: it loads, and its links are where pinocchio sees them."""

import re
import warnings

import numpy as np
import pytest

from loewner import Robot
from robot_oracle import disagreement, robots_folder

pytestmark = pytest.mark.verify

CONFIGURATIONS = 1000

# URDF and SRDF, below the folder of all robots.
ROBOTS = """
a1_description/urdf/a1.urdf a1
alex_description/urdf/alex_nub_hands.urdf alex_nub_hands
alex_description/urdf/alex_psyonic_hands.urdf alex_psyonic_hands
alex_description/urdf/alex_sake_hands.urdf alex_sake_hands
alexander_description/urdf/alexander_v1.lowerBodyOnly.urdf alexander
anymal_b_simple_description/robots/anymal-kinova.urdf anymal-kinova
anymal_b_simple_description/robots/anymal.urdf anymal
anymal_c_simple_description/urdf/anymal.urdf anymal
b1_description/urdf/b1-z1.urdf b1-z1
b1_description/urdf/b1.urdf b1
baxter_description/urdf/baxter.urdf baxter_manipulation
bolt_description/robots/bolt.urdf bolt
borinot_description/urdf/borinot_flying_arm_2.urdf borinot_flying_arm_2
centauro_description/urdf/centauro.urdf centauro
finger_edu_description/robots/finger_edu.urdf finger_edu
go1_description/urdf/go1.urdf go1
go2_description/urdf/go2.urdf go2
hextilt_description/urdf/hextilt_flying_arm_5.urdf hextilt_flying_arm_5
hyq_description/robots/hyq_no_sensors.urdf hyq
icub_description/robots/icub.urdf icub
icub_description/robots/icub_reduced.urdf icub
kinova_description/robots/kinova.urdf kinova
panda_description/urdf/panda.urdf panda
panda_description/urdf/panda_collision.urdf panda
pr2_description/urdf/pr2.urdf pr2
pr2_description/urdf/pr2.urdf pr2_manipulation
romeo_description/urdf/romeo.urdf romeo
romeo_description/urdf/romeo.urdf romeo_moveit
romeo_description/urdf/romeo_small.urdf romeo_small
simple_humanoid_description/urdf/simple_humanoid.urdf simple_humanoid
simple_humanoid_description/urdf/simple_humanoid_classical.urdf simple_humanoid_classical
solo_description/robots/solo.urdf solo
solo_description/robots/solo12.urdf solo
talos_data/robots/talos_full_v2.urdf talos
talos_data/robots/talos_full_v2_box.urdf talos
talos_data/robots/talos_left_arm.urdf talos
talos_data/robots/talos_reduced.urdf talos
talos_data/robots/talos_reduced_box.urdf talos
talos_data/robots/talos_reduced_corrected.urdf talos
ur_description/urdf/ur3_gripper.urdf ur3_gripper
ur_description/urdf/ur5_gripper.urdf ur5_gripper
ur_description/urdf/ur5_joint_limited_robot.urdf ur5_joint_limited_robot
ur_description/urdf/ur5_robot.urdf ur5
xarm_description/urdf/xarm7.urdf xarm7
z1_description/urdf/z1.urdf z1
"""
PAIRS = [tuple(line.split()) for line in ROBOTS.strip().splitlines()]

WITHOUT_URDF = {"cassie_v2"}  # an SDF file only


def test_no_robot_is_left_out():
    """Each SRDF of the package is in the list above."""
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
