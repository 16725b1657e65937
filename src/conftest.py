"""Where the examples in docstrings run: an empty folder with a small robot and a planning problem for it."""

from importlib.util import find_spec

import pytest

# PyTorch is too large to be there for the usual checks; where it is, its examples run.
collect_ignore = [] if find_spec("torch") else ["loewner/torch.py"]

# A cart on a rail of 2 m along x; on it an arm, beside the cart at y = 0.3, that turns without limit.
ARM = """<robot name="arm">
  <link name="rail">
    <collision><origin xyz="1 0 -0.5"/><geometry><box size="2 0.1 0.1"/></geometry></collision>
  </link>
  <link name="cart"><collision><geometry><box size="0.4 0.4 0.2"/></geometry></collision></link>
  <link name="forearm">
    <collision><origin xyz="0.2 0 0"/><geometry><box size="0.4 0.05 0.05"/></geometry></collision>
  </link>
  <joint name="rail" type="prismatic">
    <parent link="rail"/><child link="cart"/><axis xyz="1 0 0"/><limit lower="0" upper="2" effort="1" velocity="1"/>
  </joint>
  <joint name="elbow" type="continuous">
    <origin xyz="0 0.3 0"/><parent link="cart"/><child link="forearm"/><axis xyz="0 0 1"/>
  </joint>
</robot>
"""

PROBLEMS = """{"robot": "arm", "joints": ["rail", "elbow"], "problems": {"shelf": [{
  "index": 1, "problem": "shelf", "start": [0.0, 0.0], "goals": [[2.0, 0.0]], "cylinder": [], "sphere": [],
  "box": [{
    "name": "board", "half_extents": [0.1, 0.1, 0.01],
    "position": [1.0, 0.0, 1.0], "orientation_quat_xyzw": [0.0, 0.0, 0.0, 1.0]
  }]
}]}}
"""


@pytest.fixture(autouse=True, scope="session")
def no_greetings():
    """Keep viser's greetings out of what examples print; its threads say goodbye as late as in the next example."""
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr("rich.print", lambda *_, **__: None)
        yield


@pytest.fixture(autouse=True)
def folder_of_examples(tmp_path, monkeypatch):
    """Run each docstring's examples in a folder of its own."""
    (tmp_path / "arm.urdf").write_text(ARM)
    (tmp_path / "problems.json").write_text(PROBLEMS)
    monkeypatch.chdir(tmp_path)
