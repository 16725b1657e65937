"""Plan paths whose motions are proven free from start to goal, and make trajectories from the paths.

Users call `planning` (with the options in `searches`), `roadmaps`, `trajectories`, `velocity_tuning`, `coordination`,
`gates`, `lines`, `pose_goals` and `controller_points`. `compiled` and `ompl_planners` search the joint space that
`space` defines; `improving` and `clearing` make paths better; `in_time` plans among moving bodies; `departures` plans
motions out of contact. `judge` decides whether a motion is free. `bases` plans for mobile bases: `drives` are sequences
of arcs and turns, and `steering` connects two poses. `straights`, `jerk_limited`, `profiles` and `brakes` compute
motions in time; `joint_limits` and `limit_use` handle the limits of joints. `kept_axes` and `kept_lines` check that
motions keep an axis or a line; `trajectory_files`, `messages` and `controllers` read and write files.
"""

from loewner.planners.bases import plan_drive
from loewner.planners.controller_points import ControllerPoints
from loewner.planners.coordination import coordinate
from loewner.planners.drives import Drive
from loewner.planners.gates import Gate, GateAnswer, GateState
from loewner.planners.improving import Improve, Plan
from loewner.planners.in_time import plan_in_time
from loewner.planners.joint_limits import JointLimits
from loewner.planners.kept_lines import Line
from loewner.planners.lines import straight
from loewner.planners.ompl_planners import space_information
from loewner.planners.planning import plan, plan_full, shorten
from loewner.planners.pose_goals import PoseGoal
from loewner.planners.roadmaps import Roadmap, roadmap
from loewner.planners.searches import Search
from loewner.planners.trajectories import Trajectory, brake, trajectory
from loewner.planners.velocity_tuning import time_path

__all__ = [
    "ControllerPoints",
    "Drive",
    "Gate",
    "GateAnswer",
    "GateState",
    "Improve",
    "JointLimits",
    "Line",
    "Plan",
    "PoseGoal",
    "Roadmap",
    "Search",
    "Trajectory",
    "brake",
    "coordinate",
    "plan",
    "plan_full",
    "plan_drive",
    "plan_in_time",
    "roadmap",
    "shorten",
    "space_information",
    "straight",
    "time_path",
    "trajectory",
]
