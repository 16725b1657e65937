"""Show two bodies, or a robot in a scene, in the browser (viser), with their verdicts while they move.

By default, only this machine can open the page (see `host` of `show_pair`). The page loads nothing from other
addresses. `pair` and `robot` are the two pages, built from `page`, `visuals`, `drawing`, `framing` and `style`.
`playing` plays back trajectories, `screenshots` takes pictures, and `guard` controls access.
"""

from loewner.viewer.pair import PairViewer, show_pair
from loewner.viewer.robot import RobotViewer, show_robot
from loewner.viewer.screenshots import save_screenshot

__all__ = ["PairViewer", "RobotViewer", "save_screenshot", "show_pair", "show_robot"]
