"""Thousands of configurations of models of Drake, pinocchio and MuJoCo: poses, verdicts, pairs and distances."""

import logging
import warnings
from importlib.util import find_spec
from pathlib import Path

import pytest

from other_models import TOUCHING, Drake, MuJoCo, Pinocchio, compare, every_joint, example, parsed
from test_models import MODELS

pytestmark = pytest.mark.verify

CONFIGURATIONS, DETAILS = 10_000, 300

# Drake's search for the distance may end this far from it [m]: for a foot and a leg of Solo, it returns 12.09 mm, while
# `oracles.naive_distance`, which tries all vertices, edges and triangles, returns our 8.35 mm.
DRAKE_ENDS_EARLY = 5e-3

PLANTS = {
    "panda": ("panda_description/urdf/panda_collision.urdf",),
    "allegro": ("allegro_hand_description/urdf/allegro_left_hand.urdf",),
    "anymal": ("anymal_b_simple_description/robots/anymal.urdf",),
    "a1": ("a1_description/urdf/a1.urdf",),
    "solo": ("solo_description/robots/solo.urdf",),
    "alex": ("alex_description/urdf/alex_nub_hands.urdf",),
    "fingers": ("examples/planar_gripper/planar_gripper.sdf",),
    "desk": (
        "examples/kuka_iiwa_arm/models/desk/transcendesk55inch.sdf",
        "examples/kuka_iiwa_arm/models/objects/simple_cylinder.urdf",
        "iris_description/robots/iris_simple.urdf",
    ),
}
CORNER = "v 0 0 0\nv .3 0 0\nv 0 .3 0\nv 0 0 .3\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"

URDFS = {
    "panda_description/urdf/panda.urdf": "panda_description/srdf/panda.srdf",
    "panda_description/urdf/panda_collision.urdf": None,
    "allegro_hand_description/urdf/allegro_left_hand.urdf": None,
    "ur_description/urdf/ur5_gripper.urdf": "ur_description/srdf/ur5_gripper.srdf",
    "anymal_b_simple_description/robots/anymal.urdf": "anymal_b_simple_description/srdf/anymal.srdf",
    "talos_data/robots/talos_reduced_box.urdf": "talos_data/srdf/talos.srdf",
    "a1_description/urdf/a1.urdf": "a1_description/srdf/a1.srdf",
    "solo_description/robots/solo12.urdf": "solo_description/srdf/solo.srdf",
    "hyq_description/robots/hyq_no_sensors.urdf": "hyq_description/srdf/hyq.srdf",
    "tiago_description/robots/tiago_no_hand.urdf": None,
}


def expect_agreement(theirs, capsys, *, over=TOUCHING, measured=True):
    """No verdict and no pair differs, but within the tolerance of touching; distances are as near as given."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        told = compare(theirs, CONFIGURATIONS, details=DETAILS)
    with capsys.disabled():
        print(f"\n{told}")
    assert told["wrong"] == []
    assert told["near"] <= 5
    assert told["off"] < 1e-13
    if measured:
        assert told["split"] == 0
        assert told["over"] < over
        assert told["under"] < TOUCHING


@pytest.mark.parametrize("name", [*PLANTS, 1, 2, 3])
def test_plants_of_drake(name, capsys, tmp_path):
    """Robots that Drake parses, one of them on a floor, and random plants with joints and shapes of every kind."""
    pytest.importorskip("pydrake")
    logging.getLogger("drake").setLevel(logging.ERROR)
    (tmp_path / "corner.obj").write_text(CORNER)
    if name in PLANTS:
        build = parsed(*PLANTS[name], floor=name == "a1")
    else:
        build = every_joint(name, 6 + 2 * name, tmp_path / "corner.obj")
    expect_agreement(Drake(build), capsys, over=DRAKE_ENDS_EARLY)


@pytest.mark.parametrize("urdf", URDFS)
def test_models_of_pinocchio(urdf, capsys):
    """Robots of example-robot-data with their meshes as triangles, without what closed ones enclose."""
    expect_agreement(Pinocchio(*example(urdf, URDFS[urdf]), hollow=True), capsys)


@pytest.mark.parametrize("name", MODELS)
def test_models_of_mujoco(name, capsys, tmp_path, monkeypatch):
    """Models that packages ship. MuJoCo's distances between meshes of a Jaco contradict its own verdicts."""
    mujoco = pytest.importorskip("mujoco")
    package, _, inside = name.partition("/")
    found = find_spec(package)
    if found is None or not found.submodule_search_locations:
        pytest.skip(f"{package} is not installed: make test-models")
    monkeypatch.chdir(tmp_path)  # where MuJoCo logs what it warns of
    model = mujoco.MjModel.from_xml_path(str(Path(next(iter(found.submodule_search_locations)), inside)))
    expect_agreement(MuJoCo(model), capsys, measured="jaco" not in name)
