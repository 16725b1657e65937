"""Paths from start to goal whose motions are proven free, and what is made of them."""

from loewner.planners.ompl_planners import space_information
from loewner.planners.planning import plan, shorten
from loewner.planners.roadmaps import Roadmap, roadmap

__all__ = ["Roadmap", "plan", "roadmap", "shorten", "space_information"]
