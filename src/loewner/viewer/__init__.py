"""A 3-D page in the browser: two bodies, or a robot in a scene, with their verdicts while they are moved (viser).

The page is served from this machine alone and needs no other address.

Examples
--------
>>> from loewner import Body, viewer
>>> page = viewer.show_pair(Body.box([1, 1, 1]), None, Body.sphere(0.5), T)  # doctest: +SKIP
>>> page.url  # doctest: +SKIP
'http://localhost:40123'
>>> page.T_world_b = other_T  # doctest: +SKIP
"""

from loewner.viewer.pair import PairViewer, show_pair
from loewner.viewer.robot import RobotViewer, show_robot

__all__ = ["PairViewer", "RobotViewer", "show_pair", "show_robot"]
