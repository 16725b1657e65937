"""Paths from start to goal whose motions are proven free, and what is made of them."""

from loewner.planners.ompl_planners import space_information
from loewner.planners.planning import plan, shorten
from loewner.planners.trajectories import Trajectory, trajectory

__all__ = ["Trajectory", "plan", "shorten", "space_information", "trajectory"]
