"""Define the page for a robot in a scene, on which users move joints and bodies and see the contacts."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from time import monotonic
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from loewner._base import _validate
from loewner._base._rotations import quaternions_of
from loewner._base._validate import Floats, Ints
from loewner.bodies import Body
from loewner.bodies.kinds import Mesh
from loewner.errors import ConvergenceError, InputError, LoewnerError
from loewner.planners import Trajectory
from loewner.queries.pairs import Verdict
from loewner.robots import CollisionChecker, Robot, StateDistance
from loewner.robots.description.robot import first_shown
from loewner.scenes.scene import Contact
from loewner.viewer import playing as paths
from loewner.viewer.drawing import LABELS, VERDICT_COLOURS, Drawing, Rgb, add_mesh, place, spanned
from loewner.viewer.framing import framed, round_length
from loewner.viewer.page import Mover, PoseInputs, Viewer, certified_words, cut_short, length_text, note_lines
from loewner.viewer.visuals import visual_meshes

LINK, OBSTACLE, HELD = (187, 187, 187), (102, 153, 204), (170, 136, 187)

# Links larger than WORLD [m] count as ground. The first view shows all other links. It includes the ground and bodies
# of the scene if this makes the view at most WIDEST times as wide.
WORLD, WIDEST = 500.0, 4.0

# Ranges of sliders for values without limits: angles of joints [rad], and positions of mobile bases [m].
TURN, TRAVEL = math.pi, 2.0

# Seconds between two frames while a trajectory is played.
FRAME = 1 / 30

PLAY, PAUSE = "play", "pause"
SPEEDS = {"0.1 ×": 0.1, "0.25 ×": 0.25, "0.5 ×": 0.5, "1 ×": 1.0, "2 ×": 2.0, "5 ×": 5.0}

# Seconds for which the scene must stay unchanged before a path is proven, since a proof takes longer than samples.
STILL = 0.3

# Largest number of contacts, and of notes, that are listed.
MOST_LINES = 12

# Opacity of links that are not checked.
UNCHECKED = {"color": LINK, "opacity": 0.35, "side": "double"}

# Words for the verdict of a whole path.
ALONG = {
    Verdict.FREE: "free at every moment",
    Verdict.COLLIDING: "collides",
    Verdict.AMBIGUOUS: "not proven free at every moment",
}

NEUTRAL, OTHER, NOTHING = "neutral", "(other)", "(none)"


def show_robot(
    checker: CollisionChecker,
    q: ArrayLike | None = None,
    *,
    path: ArrayLike | Trajectory | None = None,
    trajectory: Any = None,
    host: str = "127.0.0.1",
    port: int = 0,
    block: bool = False,
) -> RobotViewer:
    """Open a page that shows a robot in its scene, with sliders for the joints and a list of the bodies that touch.

    Parameters
    ----------
    checker : CollisionChecker
        Checker of the robot and the scene to show. Moving a body on the page moves it in this scene.
    q : array_like, shape (dof,), optional
        The first configuration. The default is the start of the path. Without a path, the default is the SRDF state
        that names the most joints or, without such a state, 0 for all joints. Joints are kept within their limits.
    path : array_like, shape (n, dof), or planners.Trajectory, optional
        Two or more configurations of this robot. The page gets a time slider, a button to play the path, a bar that
        shows where samples of the path collide, and a bar that shows where the path is proven free. If bodies of the
        scene follow motions, the slider, the button and the bars also appear without a path. A path without times is
        played at a speed of 1 rad/s or 1 m/s, as measured by `Robot.distances`.
    trajectory : planners.Trajectory, planners.ControllerPoints, or a SciPy curve, optional
        A trajectory to play, as for `CollisionChecker.certify_trajectory`. Give either `trajectory` or `path`.
    host, port, block
        As for `show_pair`.

    Returns
    -------
    RobotViewer

    Raises
    ------
    MissingExtraError
        If viser is not installed, or its version cannot be made to refuse requests from other sites.
    InputError
        If the configuration or the path does not fit the robot, both `path` and `trajectory` are given, there is
        nothing to check, the host does not belong to this machine, or the port is taken.

    Examples
    --------
    >>> from loewner import viewer
    >>> page = viewer.show_robot(CollisionChecker(Robot.from_urdf("arm.urdf")), [1.0, 1.57])
    >>> page.url.startswith("http://localhost:"), page.verdict.name  # to be opened in a browser
    (True, 'FREE')
    >>> page.close()
    """
    waits = _validate.flag(block, "block")
    _validate.instance(checker, "checker", CollisionChecker)
    viewer = RobotViewer(checker, q, paths.checked_way(checker.robot, path, trajectory), host, port)
    if waits:
        viewer.wait()
    return viewer


@dataclass
class _Shown:
    """One body on the page: its drawing and its placement."""

    body: Body
    drawing: Drawing
    colour: Rgb
    node: Any
    link: int | None
    T_link_body: Floats | None
    mover: Mover | None


class RobotViewer(Viewer):
    """A page, made by `show_robot`, for a robot in a scene.

    Changes that Python code makes to the scene appear within a tenth of a second, or immediately after `refresh`.

    Attributes
    ----------
    checker : CollisionChecker
    trajectory : planners.Trajectory or None
        The trajectory that can be played, if it is a `planners.Trajectory`; None for any other path.
    verdict : Verdict
        The certified answer for the configuration that is shown; AMBIGUOUS if no answer could be computed.
    colliding : bool
        The exact answer for this configuration; True if no answer could be computed.
    path_verdict : Verdict or None
        The verdict for the whole path or trajectory, which the page shows instead of the verdict for one configuration.
        FREE only if the path is proven free at every moment; COLLIDING if a sample or the proof found a collision;
        AMBIGUOUS otherwise, including while the proof is running. Contact that `Scene.leave` or `Scene.reach` allows is
        not a collision. The verdict is None without a path, or while the robot is not on the path.
    contacts : tuple of Contact
        The pairs that touch or come within their margin.
    bounds : StateDistance
        Certified bounds on the distance of the nearest pair, its exact distance and its witnesses. If the exact search
        cannot settle the distance, only the bounds are present.

    Examples
    --------
    >>> from loewner import Scene, viewer
    >>> scene = Scene()
    >>> scene.add("post", Body.box([0.2, 0.2, 0.2]), [[1, 0, 0, 1], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
    >>> with viewer.show_robot(CollisionChecker(Robot.from_urdf("arm.urdf"), scene)) as page:
    ...     page.q = [1.0, 1.57]  # moves the robot on the page: the cart is in the post
    ...     print([(contact.name_a, contact.name_b) for contact in page.contacts])
    ...     page.move("post", [[1, 0, 0, 1.9], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
    ...     print(page.contacts)
    [('cart', 'post')]
    ()
    """

    contacts: tuple[Contact, ...]
    bounds: StateDistance
    path_verdict: Verdict | None
    _along: Ints

    def __init__(
        self, checker: CollisionChecker, q: ArrayLike | None, way: paths.Way | None, host: str, port: int
    ) -> None:
        robot = checker.robot
        self.checker, self._way = checker, way
        self.trajectory = self._way if isinstance(self._way, Trajectory) else None
        self._time = 0.0
        # The value of `monotonic` at time 0 of the path that is being played.
        self._began: float | None = None
        self._speed = 1.0
        if q is None and self._way is not None:
            q = self._way.positions(0.0)
        self._first_state: str | None = None
        if q is None:
            self._first_state, q = first_shown(robot)
        self._q = np.array(robot.checked_one(q))
        if self._way is None and checker.scene.following:
            self._way = paths.Standing(checker.scene.following.values(), self._q)
        if not checker.checked_pairs:
            raise InputError(
                "checker: expected pairs to check, found none; the robot has "
                f"{len(robot.bodies)} links with bodies and the scene {len(checker.scene)} bodies"
            )
        self._seen = self._seen_structure = -1
        self._seen_along: Any = None
        self._proof: paths.Proof | None = None
        # The value of `monotonic` at which the path will be proven.
        self._prove_at = math.inf
        self._size = math.inf
        self._shown: dict[str, _Shown] = {}
        self._unchecked: dict[str, Any] = {}
        self._numbers = 0
        self._draws = np.random.default_rng(0)
        super().__init__(f"loewner: {robot.name}", host, port)

    @property
    def q(self) -> Floats:
        """The configuration that is shown, shape (dof,). Set it to move the robot on the page."""
        return self._q.copy()

    @q.setter
    def q(self, q: ArrayLike) -> None:
        self._check_open()
        checked = np.array(self.checker.robot.checked_one(q))
        with self._changing():
            self._stop()
            self._state.value = OTHER
            self._set_configuration(checked)

    @property
    def time(self) -> float:
        """The position on the path, in seconds. Set it to move the robot along the path."""
        return self._time

    @time.setter
    def time(self, t: float) -> None:
        self._check_open()
        self._the_way().positions(_validate.real(t, "time"))
        with self._changing():
            self._stop()
            self._go_to(float(t))

    @property
    def playing(self) -> bool:
        """Whether the path is being played."""
        return self._began is not None

    def play(self) -> None:
        """Let the robot follow its path from the current position, or from the start if the robot is at the end.

        Raises
        ------
        InputError
            If there is no path.

        Examples
        --------
        >>> from loewner import planners, viewer
        >>> robot = Robot.from_urdf("arm.urdf")
        >>> moved = planners.trajectory(robot, [[0, 0], [2, 0]])
        >>> with viewer.show_robot(CollisionChecker(robot), trajectory=moved) as page:
        ...     page.time = 1.5
        ...     page.q, page.playing
        ...     page.play()
        ...     page.playing
        (array([1., 0.]), False)
        True
        """
        with self._changing():
            self._start(self._the_way())

    def go_to_worst(self) -> float:
        """Move the robot to the moment at which the distance of the nearest pair is smallest.

        For a path without times, the distances at 401 moments, and at all moments at which proofs ended, are compared.

        Returns
        -------
        float
            The position on the path, in seconds.

        Raises
        ------
        InputError
            If there is no path.
        ConvergenceError
            As for `CollisionChecker.distance`.

        Examples
        --------
        >>> from loewner import viewer
        >>> checker = CollisionChecker(Robot.from_urdf("arm.urdf"))
        >>> with viewer.show_robot(checker, path=[[0, 0], [2, 0]]) as page:
        ...     0.0 <= page.go_to_worst() <= 2.0, page.path_verdict.name
        (True, 'FREE')
        """
        self._check_open()
        way = self._the_way()
        with self._changing():
            self._prove()
            worst = paths.worst_along(self.checker, way, self._proof or paths.proven_along(self.checker, way))
            self._stop()
            self._go_to(worst)
        return worst

    def pause(self) -> None:
        """Stop the robot in place. Raise an InputError if there is no path."""
        with self._changing():
            self._the_way()
            self._stop()

    def move(self, name: str, T_world_body: ArrayLike | None) -> None:
        """Move a body of the scene, and show it immediately.

        Parameters
        ----------
        name : str
            Name of a static body in the world.
        T_world_body : array_like, shape (4, 4), or None
            The new pose, with its translation in metres. None is the identity.

        Raises
        ------
        InputError
            If the page is closed, or the body is attached to a link and moves with it.
        UnknownNameError, PoseError
            As for `Scene.move`.
        """
        with self._changing():
            self.checker.scene.move(name, T_world_body)

    # -- the page ---------------------------------------------------------------------------------

    def _build(self) -> None:
        gui, robot = self.server.gui, self.checker.robot
        if self._way is not None:
            self._build_path(self._way)
        with gui.add_folder("Show"):
            self._add_layers(LABELS)
            self._notes = gui.add_html("", visible=False)
        with gui.add_folder("Robot"):
            states = gui.add_dropdown(
                "state", (OTHER, NEUTRAL, *robot.states), initial_value=self._first_state or OTHER
            )
            self._state = self._watch(states, "state")
            gui.add_button("random configuration").on_click(lambda _: self._tell("random"))
            self._sliders = []
            for name, low, high, value in zip(
                robot.configuration_names, *_slider_ends(robot), self._q.tolist(), strict=True
            ):
                low, high = min(low, value), max(high, value)
                step = round_length(max((high - low) / 1000, 1e-6))
                slider = gui.add_slider(name, low, high, step, value, marks=(), hint=f"from {low:.6g} to {high:.6g}")
                self._sliders.append(self._watch(slider, "joints"))
        with gui.add_folder("Scene"):
            self._chosen = self._watch(gui.add_dropdown("move", (NOTHING,), initial_value=NOTHING), "chosen")
            self._inputs = PoseInputs(self, "body", 1.0)
        links = robot.forward_kinematics(self._q)
        self._links = [self.server.scene.add_frame(f"/robot/{k}", show_axes=False) for k in range(len(links))]
        for name, body in robot.bodies.items():
            self._add(name, body, LINK, robot.link_names.index(name), None)
        self._match_scene()
        self._frame(links)

    def _build_path(self, way: paths.Way) -> None:
        gui = self.server.gui
        with gui.add_folder("Path"):
            label = f"time since {way.start_time:g} s, s" if way.start_time else "time, s"
            end = max(way.duration, 1e-6)
            slider = gui.add_slider(label, 0.0, end, round_length(max(end / 1000, 1e-6)), 0.0, marks=())
            self._clock = self._watch(slider, "time")
            self._button = gui.add_button(PLAY)
            self._button.on_click(lambda _: self._tell("play"))
            self._pace = self._watch(gui.add_dropdown("speed", tuple(SPEEDS), initial_value="1 ×"), "speed")
            self._strip, self._proof_strip = gui.add_html(""), gui.add_html("")

    def _frame(self, links: Floats) -> None:
        """Aim the camera at the robot and nearby bodies, and add a grid below and gizmos of matching size."""
        boxes: dict[bool, list[Floats]] = {True: [], False: []}
        for shown in self._shown.values():
            T = shown.mover.T if shown.mover is not None else links[shown.link] @ _identity_or(shown.T_link_body)
            box = shown.drawing.box(T)
            # A plane in an MJCF file is a very large link of the robot.
            boxes[shown.mover is None and np.ptp(box, axis=0).max() < WORLD].append(box)
        box = framed(spanned(boxes[True]), boxes[False], WIDEST) if boxes[True] else spanned(boxes[False])
        self._frame_view(box)
        for shown in self._shown.values():
            if shown.mover is not None:
                shown.mover.fit(shown.drawing.box(np.eye(4)), self._size)

    def _add(self, name: str, body: Body, colour: Rgb, link: int | None, T_link_body: Floats | None) -> None:
        # Nodes have numbers, since a name may contain the slash that separates viser's nodes, and a removed name may be
        # used again.
        node, self._numbers = f"/body/{self._numbers}", self._numbers + 1
        mover, handle = None, None
        if link is None:
            scene = self.checker.scene
            T = scene.following[name].poses(self._clock_time()) if name in scene.following else scene.pose(name)
            mover = Mover(self, node, name, T)
            mover.show(False)
            handle = mover.gizmo
        else:
            node = f"/robot/{link}{node}"
            handle = self.server.scene.add_frame(node, show_axes=False)
            place(handle, _identity_or(T_link_body))
        is_link = link is not None and T_link_body is None  # only links have visual meshes
        mesh = (lambda: self._visuals[0].get(name)) if is_link else (lambda: None)
        drawing = Drawing(self.server.scene, node, body, colour, self._which(), mesh)
        if mover is not None:
            mover.fit(drawing.box(np.eye(4)), self._size)
            drawing.on_click(lambda _: self._tell("clicked", name))
        self._shown[name] = _Shown(body, drawing, colour, handle, link, T_link_body, mover)

    @cached_property
    def _visuals(self) -> tuple[dict[str, Mesh], list[str]]:
        """Return the links' visual meshes. Since reading takes time, the meshes are read when they are first shown."""
        return visual_meshes(self.checker.robot)

    def _show_layers(self) -> None:
        which = self._which()
        for shown in self._shown.values():
            shown.drawing.show(which)
        if which["meshes"] and not self._unchecked:
            self._show_unchecked()
        for node in self._unchecked.values():
            node.visible = which["meshes"]
        self._notes.visible = which["meshes"] and bool(self._notes.content)

    def _show_unchecked(self) -> None:
        """Draw links that have visual geometry but no body. Report missing visuals and links that are not checked."""
        robot, (looks, faults) = self.checker.robot, self._visuals
        self._unchecked = {
            name: add_mesh(self.server.scene, f"/robot/{robot.link_names.index(name)}/look", look, **UNCHECKED)
            for name, look in looks.items() if name not in robot.bodies
        }  # fmt: skip
        notes = [f"{name}: drawn, but not checked, for it has no collision geometry" for name in self._unchecked]
        if not looks and not faults:
            notes.append("The URDF has no visual geometry.")
        self._notes.content = note_lines(cut_short([*faults, *notes], MOST_LINES))

    def _match_scene(self) -> None:
        """Add, remove and move the bodies that have changed in the scene since the last check."""
        scene, robot = self.checker.scene, self.checker.robot
        version = scene.version
        if version == self._seen:
            return
        if scene.structure_version != self._seen_structure:
            structure_version, held = scene.structure_version, scene.attachments
            for name in [n for n in self._shown if n not in robot.bodies]:
                if not (name in scene and self._same_place(name, held.get(name))):
                    self._shown.pop(name).node.remove()
            for name in scene:
                if name not in self._shown and name in held:
                    link = robot.link_names.index(held[name].link)
                    self._add(name, scene[name], HELD, link, held[name].T_link_body)
                elif name not in self._shown:
                    self._add(name, scene[name], OBSTACLE, None, None)
            if self._chosen.value not in scene.static_names:  # it has been removed
                self._chosen.value = NOTHING
            self._chosen.options = (NOTHING, *scene.static_names)
            self._seen_structure = structure_version
        for name, T in zip(scene.static_names, scene.static_poses, strict=True):
            self._mover(name).move(T)
        self._show_chosen()
        self._seen = version

    def _same_place(self, name: str, held: Any) -> bool:
        shown, scene = self._shown[name], self.checker.scene
        if shown.body is not scene[name] or (held is None) != (shown.link is None):
            return False
        return held is None or (
            self.checker.robot.link_names[shown.link or 0] == held.link and shown.T_link_body is held.T_link_body
        )

    def _mover(self, name: str) -> Mover:
        mover = self._shown[name].mover
        assert mover is not None  # only bodies attached to links have no mover
        return mover

    def _show_gizmos(self) -> None:
        for name, shown in self._shown.items():
            if shown.mover is not None:
                shown.mover.show(name == self._chosen.value and not self._pictured)

    def _show_chosen(self) -> None:
        """Give the selected body its gizmo, and show its pose."""
        self._show_gizmos()
        if self._chosen.value != NOTHING:
            self._inputs.show(self._mover(self._chosen.value).T)

    # -- actions on the page ----------------------------------------------------------------------

    def _changed(self) -> bool:
        return self.playing or self.checker.scene.version != self._seen or monotonic() >= self._prove_at

    def _look_every(self) -> float:
        return FRAME if self.playing else super()._look_every()

    def _take(self, done: dict[str, Any]) -> None:
        robot, scene = self.checker.robot, self.checker.scene
        if "state" in done and self._state.value != OTHER:
            self._set_configuration(robot.configuration(None if self._state.value == NEUTRAL else self._state.value))
        elif "random" in done:
            self._state.value = OTHER
            self._set_configuration(robot.random_configurations(1, int(self._draws.integers(2**31)))[0])
        elif "joints" in done:
            self._state.value = OTHER
            self._q = _with_unit_quaternions(robot, np.array([slider.value for slider in self._sliders]))
        if self._way is not None:
            self._follow(self._way, done)
        if "clicked" in done and done["clicked"] in scene.static_names:
            self._chosen.value = done["clicked"]
        dragged = [name for name in scene.static_names if f"drag {name}" in done and name in self._shown]
        for name in dragged:
            scene.move(name, self._mover(name).take())
        if "type body" in done and self._chosen.value in scene.static_names and not dragged:
            scene.move(self._chosen.value, self._inputs.take())
        if "layers" in done:
            self._show_layers()
        if "chosen" in done or "clicked" in done:
            self._show_chosen()

    def _set_configuration(self, q: Floats) -> None:
        self._q = q
        for slider, value in zip(self._sliders, q.tolist(), strict=True):
            slider.min, slider.max = min(slider.min, value), max(slider.max, value)
            slider.value = value

    # -- the path ---------------------------------------------------------------------------------

    def _the_way(self) -> paths.Way:
        if self._way is None:
            raise InputError("page: expected one with a path or trajectory, found none; show_robot(path=...) takes it")
        return self._way

    def _follow(self, way: paths.Way, done: dict[str, Any]) -> None:
        """Continue the path that is being played. Moving a joint by hand stops the path, unless only bodies move."""
        if "speed" in done:
            self._set_speed(SPEEDS[self._pace.value])
        if {"state", "random", "joints"} & done.keys() and not isinstance(way, paths.Standing):
            self._stop()
            return
        if "time" in done:
            self._stop()
            self._go_to(min(max(float(self._clock.value), 0.0), way.duration))
        elif "play" in done:
            if self.playing:
                self._stop()
            else:
                self._start(way)
        if self._began is not None:
            self._go_to(min((monotonic() - self._began) * self._speed, way.duration))
            if self._time == way.duration:
                self._stop()

    def _start(self, way: paths.Way) -> None:
        begin = 0.0 if self._time >= way.duration else self._time
        self._began = monotonic() - begin / self._speed
        self._button.label = PAUSE

    def _set_speed(self, speed: float) -> None:
        if self._began is not None:
            now = monotonic()
            self._began = now - (now - self._began) * self._speed / speed
        self._speed = speed

    def _stop(self) -> None:
        self._began = None
        if self._way is not None:
            self._button.label = PLAY

    def _go_to(self, t: float) -> None:
        self._time = self._clock.value = t
        way = self._the_way()
        if not isinstance(way, paths.Standing):
            self._state.value = OTHER
            self._set_configuration(way.positions(t))

    def _answer(self) -> None:
        links = self.checker.robot.forward_kinematics(self._q)
        for node, wxyz, T in zip(self._links, quaternions_of(links[:, :3, :3]), links, strict=True):
            node.wxyz, node.position = wxyz, T[:3, 3]
        self._match_scene()
        self._look_along()
        t = self._now()
        self.verdict = self.checker.classify(self._q, t)
        self.colliding = self.checker.collide(self._q, t)
        self.contacts = self.checker.pairs(self._q, t) if self.colliding else ()
        self.bounds = self._distance()
        self._paint({name for contact in self.contacts for name in (contact.name_a, contact.name_b)})
        self.path_verdict = self._verdict_along()
        shown = self._here() if self.path_verdict is None else self.path_verdict
        self._show_verdict(shown.name, VERDICT_COLOURS[shown], list(self._rows()), self._contact_lines())
        self._show_near()

    def _clock_time(self) -> float:
        """Return the time on the clock of bodies that follow motions."""
        return self._time + (0.0 if self._way is None else self._way.start_time)

    def _now(self) -> float | None:
        """Move bodies that follow motions to the current time. Return the time, or None if no body follows a motion."""
        following = self.checker.scene.following
        for name, motion in following.items():
            if name in self._shown:
                self._mover(name).move(motion.poses(self._clock_time()))
        return self._clock_time() if following else None

    def _distance(self) -> StateDistance:
        try:
            return self.checker.distance(self._q, self._now(), exact=True)
        except ConvergenceError:  # the verdict on collisions does not depend on the distance
            return self.checker.distance(self._q, self._now())

    def _look_along(self) -> None:
        """Sample the path again if the scene has changed, and prove it once the scene has not changed for a while."""
        way = self._way
        if way is None:
            return
        if isinstance(way, paths.Standing):
            way.q = self._q
        seen = self._seen, self._q.tobytes() if isinstance(way, paths.Standing) else None
        if self._seen_along != seen:
            self._along = paths.found_along(self.checker, way)
            self._strip.content = paths.sampled_strip(self._along, way.duration)
            self._proof, self._proof_strip.content = None, ""
            self._seen_along, self._prove_at = seen, monotonic() + STILL
        elif monotonic() >= self._prove_at:
            self._prove_at = math.inf
            try:
                self._proof = paths.proven_along(self.checker, way)
                self._proof_strip.content = paths.proof_strip(self._proof)
            except LoewnerError as error:
                self._proof_strip.content = note_lines([f"proof: none; {error}"])

    def _prove(self) -> None:
        """Prove the path immediately, if a proof is due."""
        if self._prove_at < math.inf:
            self._prove_at = 0.0
            self.refresh()

    def _set_pictured(self, pictured: bool) -> None:
        if pictured:
            with self.lock:
                self._prove()
        super()._set_pictured(pictured)

    def _verdict_along(self) -> Verdict | None:
        """Return the verdict for the whole path, or None if the robot is not on the path."""
        if self._way is None or not np.array_equal(self._q, self._way.positions(self._time)):
            return None
        verdicts = np.array([Verdict.AMBIGUOUS]) if self._proof is None else self._proof.verdicts
        if (verdicts == Verdict.FREE).all():
            return Verdict.FREE
        scene = self.checker.scene
        # The scene may allow contact at the beginning or the end of the path, so the proof decides.
        sampled = (self._along == Verdict.COLLIDING).any() and not (scene.leaving or scene.reaching)
        return Verdict.COLLIDING if sampled or (verdicts == Verdict.COLLIDING).any() else Verdict.AMBIGUOUS

    def _show_near(self) -> None:
        a, b = self.bounds.witness_a, self.bounds.witness_b
        if a is None or b is None or not self._marks["near"].value:
            self._near.hide()
        else:
            self._near.show(a, b)

    def _show_failure(self, error: Exception) -> None:
        super()._show_failure(error)
        self.path_verdict = None
        self._paint(set())

    def _paint(self, touching: set[str]) -> None:
        for name, shown in self._shown.items():
            shown.drawing.colour = VERDICT_COLOURS[Verdict.COLLIDING] if name in touching else shown.colour

    def _here(self) -> Verdict:
        """Return the exact answer for the configuration that is shown."""
        return Verdict.COLLIDING if self.colliding else Verdict.FREE

    def _rows(self) -> Iterator[tuple[str, str]]:
        bounds = self.bounds
        if self.path_verdict is not None:
            yield "path", ALONG[self.path_verdict]
            yield "here", self._here().name
        if bounds.distance is None or bounds.names is None:
            yield "clearance", f"not settled: {bounds.lower:.4g} .. {bounds.upper:.4g} m"
        else:
            yield "depth" if bounds.distance < 0 else "clearance", length_text(abs(bounds.distance))
            yield "nearest pair", " – ".join(bounds.names)
        yield "ellipsoids", certified_words(self.verdict)
        yield "pairs", f"{len(self.contacts)} touch of {len(self.checker.checked_pairs)} checked"
        if self._way is not None:
            yield "time", f"{self._time:.3f} s of {self._way.duration:.6g} s"
            if self._proof is not None and np.array_equal(self._q, self._way.positions(self._time)):
                yield "proof", paths.proven_at(self._proof, self._time)

    def _contact_lines(self) -> list[str]:
        deepest = sorted(self.contacts, key=lambda contact: contact.distance)
        lines = [
            f"{c.name_a} – {c.name_b}: " + (f"{-1e3 * c.distance:.3g} mm deep" if c.distance < 0 else
                                            f"{1e3 * c.distance:z.3g} mm apart")
            for c in deepest
        ]  # fmt: skip
        return cut_short(lines, MOST_LINES)


def _identity_or(T: Floats | None) -> Floats:
    return np.eye(4) if T is None else T


def _slider_ends(robot: Robot) -> tuple[list[float], list[float]]:
    """Return the ends of the sliders: the limits of the joints, or a default range for joints without limits."""
    far = np.array([TRAVEL if name.endswith(("/x", "/y", "/z")) else TURN for name in robot.configuration_names])
    low = np.where(np.isfinite(robot.hard_lower), robot.hard_lower, -far)
    high = np.where(np.isfinite(robot.hard_upper), robot.hard_upper, far)
    # viser refuses a slider of zero length, as for a joint whose limits are equal.
    return low.tolist(), np.maximum(high, low + 1e-6).tolist()


def _with_unit_quaternions(robot: Robot, q: Floats) -> Floats:
    """Normalise quaternions, since sliders change their entries one by one."""
    for k, name in enumerate(robot.configuration_names):
        if name.endswith("/qw"):
            length = np.linalg.norm(q[k : k + 4])
            q[k : k + 4] = q[k : k + 4] / length if length > 1e-9 else (1.0, 0.0, 0.0, 0.0)
    return q
