"""A small robot whose collisions can be told by plane geometry."""

from pathlib import Path

RADIUS = 0.1

# A ball of radius 0.1 that slides along x and y, with a rod of 0.3 m to its side that turns about z.
GANTRY = """<robot name="gantry">
<link name="base"/><link name="rail"/>
<link name="ball"><collision><geometry><sphere radius="0.1"/></geometry></collision></link>
<link name="rod"><collision><origin xyz="0.3 0 0"/><geometry><box size="0.3 0.02 0.02"/></geometry></collision></link>
<joint name="x" type="prismatic"><parent link="base"/><child link="rail"/>
  <axis xyz="1 0 0"/><limit lower="-1" upper="1"/></joint>
<joint name="y" type="prismatic"><parent link="rail"/><child link="ball"/>
  <axis xyz="0 1 0"/><limit lower="-1" upper="1"/></joint>
<joint name="turn" type="continuous"><parent link="ball"/><child link="rod"/><axis xyz="0 0 1"/></joint>
</robot>"""
GROUPS = """<robot name="gantry">
<group name="slide"><joint name="x"/><joint name="y"/></group><group name="nothing"/>
<group_state name="left" group="slide"><joint name="x" value="-0.5"/><joint name="y" value="-0.5"/></group_state>
<group_state name="wall" group="slide"><joint name="x" value="0.02"/><joint name="y" value="-0.5"/></group_state>
<disable_collisions link1="ball" link2="rod"/></robot>"""


def gantry(folder: Path) -> tuple[Path, Path]:
    """Write the robot's URDF and SRDF."""
    paths = folder / "gantry.urdf", folder / "gantry.srdf"
    for path, text in zip(paths, (GANTRY, GROUPS), strict=True):
        path.write_text(text)
    return paths
