"""A 3-D page in the browser: two bodies, or a robot in a scene, with their verdicts while they are moved (viser).

By default only this machine can open the page (see `host`), and it needs no other address.
"""

from loewner.viewer.pair import PairViewer, show_pair
from loewner.viewer.robot import RobotViewer, show_robot
from loewner.viewer.screenshots import save_screenshot

__all__ = ["PairViewer", "RobotViewer", "save_screenshot", "show_pair", "show_robot"]
