"""MJCF models that packages ship: MuJoCo puts their bodies where `Robot` does, and finds the same contacts.

The packages are those of `requirements/models.txt`, which `make test-models` installs; their files alone are used.
"""

from importlib.util import find_spec
from pathlib import Path

import pytest

from loewner import Robot
from mjcf_oracle import compare

GYMNASIUM, HANDS = "gymnasium/envs/mujoco/assets", "gymnasium_robotics/envs/assets"
MODELS = (
    f"{GYMNASIUM}/ant.xml",
    f"{GYMNASIUM}/half_cheetah.xml",
    f"{GYMNASIUM}/humanoid.xml",
    f"{GYMNASIUM}/pusher_v5.xml",
    f"{HANDS}/adroit_hand/adroit_door.xml",
    f"{HANDS}/fetch/pick_and_place.xml",
    f"{HANDS}/hand/manipulate_egg.xml",
    f"{HANDS}/kitchen_franka/kitchen_assets/kitchen_env_model.xml",
    "dm_control/suite/dog.xml",
    "dm_control/suite/fish.xml",
    "dm_control/suite/humanoid_CMU.xml",
    "dm_control/suite/manipulator.xml",
    "dm_control/suite/quadruped.xml",
    "dm_control/mujoco/testing/assets/model_with_ball_joints.xml",
    "dm_control/third_party/kinova/jaco_arm.xml",
    "dm_control/locomotion/walkers/assets/rodent.xml",
    "dm_control/locomotion/walkers/assets/fruitfly_v2/fruitfly.xml",
)


@pytest.mark.parametrize("name", MODELS)
def test_agrees_with_mujoco(name, capsys, tmp_path, monkeypatch):
    """At 1,000 configurations all bodies are where MuJoCo has them, and the same pairs touch.

    Pairs within `mjcf_oracle.TOUCHING` of touching that only one of the two finds are counted apart, and told.
    """
    package, _, inside = name.partition("/")
    found = find_spec(package)
    if found is None or not found.submodule_search_locations:
        pytest.skip(f"{package} is not installed: make test-models")
    path = Path(next(iter(found.submodule_search_locations)), inside)
    monkeypatch.chdir(tmp_path)  # where MuJoCo logs what it warns of
    robot = Robot.from_mjcf(path)
    told = compare(robot, path, robot.random_configurations(1000, seed=1))
    with capsys.disabled():
        print(f"\n{name}: {robot.dof} values, {len(robot.bodies)} bodies, {told}")
    assert told["off"] < 1e-13
    assert told["ours"] == told["theirs"] == 0
