"""Define the page: its server, the thread that answers user actions, and the parts that both kinds of page share."""

from __future__ import annotations

import atexit
import logging
import math
import os
import queue
import secrets
import socket
import sys
import threading
import time
import traceback
from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from html import escape
from typing import Any, Self

import numpy as np
from scipy.spatial.transform import Rotation

from loewner._base import _validate
from loewner._base._rotations import from_quaternion, from_rpy, pose_of
from loewner._base._validate import Floats
from loewner.errors import InputError, LoewnerError, MissingExtraError, installing
from loewner.queries.pairs import Verdict
from loewner.viewer import guard
from loewner.viewer.drawing import LABELS, NearPoints, Rgb, light, place
from loewner.viewer.framing import add_ground, aim, diagonal, round_length

# Seconds between two checks for changes made in Python.
LOOK_EVERY = 0.1

# The largest port number.
LAST = 65535

# Length of a gizmo's arrows, as a multiple of the longest side of its body.
GIZMO = 0.5

# The largest size of a gizmo, as a fraction of the diagonal of the first view.
MOST_GIZMO = 1 / 6

TEXT = "padding:0.4em 0.8em;font-size:0.85em;line-height:1.5"

BAD: Rgb = (102, 102, 102)


class Viewer(ABC):
    """An open page, which `show_pair` or `show_robot` made.

    `_answer` handles actions on the page and calls from Python, one at a time, under `lock`. If several moves are
    waiting, only the last one is answered, so that the page does not lag behind the mouse.

    Attributes
    ----------
    server : viser.ViserServer
        The server, which can be used to draw more on the same page.
    lock : threading.RLock
        Other threads must hold this lock while they change the scene that the page shows.
    answered : int
        Number of updates of the page so far.
    seconds : float
        Duration of the last update.
    verdict : Verdict
        The certified answer that the page shows; AMBIGUOUS if no answer could be computed.
    colliding : bool
        The exact answer; True if no answer could be computed.
    """

    verdict: Verdict
    colliding: bool

    def __init__(self, title: str, host: str, port: int) -> None:
        self.server, self._guard = _serve(title, guard.listening(host), _validate.whole_number(port, "port", 0, LAST))
        self.lock = threading.RLock()
        self.answered, self.seconds = 0, 0.0
        self._events: queue.SimpleQueue[tuple[str, Any] | None] = queue.SimpleQueue()
        self._closed = threading.Event()
        self._thread = threading.Thread(target=self._run, name="loewner viewer", daemon=True)
        self.server.scene.set_up_direction("+z")
        light(self.server.scene)
        self._verdict = self.server.gui.add_html("")
        self._pictured = False
        try:
            self._build()
        except BaseException:
            _stop(self.server)
            raise
        self.refresh()
        self._thread.start()
        # At exit, `close` runs before viser's own function, which prints that it stops the server.
        atexit.register(self.close)
        if self._guard.token is not None:
            print(self._warning(), flush=True)

    def __repr__(self) -> str:
        # The token is omitted, because users share notebooks.
        where = "closed" if self._closed.is_set() else self._guard.where.url(self._guard.port, None)
        return f"{type(self).__name__}({where})"

    # -- for the caller ---------------------------------------------------------------------------

    @property
    def url(self) -> str:
        """Address of the page on this machine, with the token if others can reach the page."""
        self._check_open()
        return self._guard.where.url(self._guard.port, self._guard.token)

    def close(self) -> None:
        """Close the page and stop its server; a second call does nothing."""
        if not self._closed.is_set():
            self._closed.set()
            self._events.put(None)
            atexit.unregister(self.close)
            if self._thread.is_alive() and threading.current_thread() is not self._thread:
                self._thread.join()
            _stop(self.server)

    def wait(self) -> None:
        """Wait until `close` or a keyboard interrupt closes the page."""
        try:
            self._closed.wait()
        except KeyboardInterrupt:
            self.close()

    def refresh(self) -> None:
        """Update the page now. Raise an InputError if the page is closed."""
        self._check_open()
        with self.lock:
            self._apply({})

    def __enter__(self) -> Self:
        self._check_open()
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _warning(self) -> str:
        """Return a warning that others can open this page, which is not restricted to this machine."""
        where, port = self._guard.where, self._guard.port
        reach = "any of this machine's addresses" if where.everywhere else where.host
        address = where.url(port, self._guard.token, socket.gethostname() if where.everywhere else where.host)
        return (
            f"loewner viewer: anyone who can reach {reach} and has this address can see and move the bodies: {address}"
        )

    # -- for the two kinds of page ----------------------------------------------------------------

    def _check_open(self) -> None:
        if self._closed.is_set():
            raise InputError("page: expected an open page, found a closed one; show_pair and show_robot open another")

    @contextmanager
    def _changing(self) -> Iterator[None]:
        """Let Python change an open page, and update the page."""
        self._check_open()
        with self.lock:
            yield
            self.refresh()

    def _add_layers(self, offered: Iterable[str]) -> None:
        """Add check boxes for layers of bodies, for the near points and for the grid."""
        gui, marks = self.server.gui, {"near": "near points", "ground": "grid"}
        self._layers = {k: self._watch(gui.add_checkbox(LABELS[k], k == "pieces"), "layers") for k in offered}
        self._marks = {k: self._watch(gui.add_checkbox(label, True), "marks") for k, label in marks.items()}

    def _which(self) -> dict[str, bool]:
        """Return which layers are shown."""
        return {name: box.value for name, box in self._layers.items()}

    def _frame_view(self, box: Floats) -> None:
        """Aim the camera at a box. Add a grid, a label for its check box, and near points of matching size."""
        self._size = diagonal(box)
        aim(self.server, box)
        self._ground, cell = add_ground(self.server.scene, box)
        self._marks["ground"].label = f"grid, {cell:g} m"
        self._near = NearPoints(self.server.scene, self._size)

    @abstractmethod
    def _build(self) -> None:
        """Put everything on the page."""

    @abstractmethod
    def _take(self, done: dict[str, Any]) -> None:
        """Apply the actions on the page. `done` maps the name of each control that was used to its last value."""

    @abstractmethod
    def _answer(self) -> None:
        """Compute the verdict and show it."""

    @abstractmethod
    def _show_gizmos(self) -> None:
        """Show the handles of the bodies that can be dragged, unless a picture is being taken."""

    @contextmanager
    def _without_gizmos(self) -> Iterator[None]:
        """Hide the handles of all bodies, for a picture."""
        try:
            self._set_pictured(True)
            yield
        finally:
            self._set_pictured(False)

    def _set_pictured(self, pictured: bool) -> None:
        with self.lock, self.server.atomic():
            self._pictured = pictured
            self._show_gizmos()

    def _changed(self) -> bool:
        """Return whether Python code has changed the contents of the page without notifying it."""
        return False

    def _look_every(self) -> float:
        """Return the seconds until the next check for changes, unless a user acts earlier."""
        return LOOK_EVERY

    def _tell(self, name: str, value: Any = None) -> None:
        """Record that a control of the page was used; may be called from any thread."""
        self._events.put((name, value))

    def _watch(self, handle: Any, name: str) -> Any:
        """Record each change that a user makes to a control. Changes by Python have no client and are ignored."""
        handle.on_update(lambda event: self._tell(name) if event.client is not None else None)
        return handle

    def _show_verdict(
        self, name: str, colour: Rgb, rows: list[tuple[str, str]], notes: list[str], swatches: Mapping[str, Rgb] = {}
    ) -> None:
        """Fill the panel's first block: a coloured bar, a table, and lines of text.

        Strings are escaped here, since names come from files.
        """
        cells = "".join(
            f'<tr><th scope="row" style="padding:0 0.8em 0 0;font-weight:400;text-align:left;vertical-align:top;'
            f'opacity:0.8;white-space:nowrap">{_swatch(swatches.get(key))}{escape(key)}</th>'
            f'<td data-loewner="{escape(key)}" style="font-variant-numeric:tabular-nums;padding:0;'
            f'overflow-wrap:anywhere">{escape(text)}</td></tr>'
            for key, text in rows
        )
        content = (
            f'<div style="{TEXT}">'
            f'<div role="status" data-loewner="verdict" style="background:rgb{colour};color:white;font-weight:700;'
            f'text-align:center;font-size:1.3em;border-radius:4px;margin-bottom:0.4em">{escape(name)}</div>'
            f"<table>{cells}</table>{_lines(notes)}</div>"
        )
        if self._verdict.content != content:
            self._verdict.content = content

    def _show_failure(self, error: Exception) -> None:
        # The attributes must not keep old answers: nothing is proven, and an unknown answer counts as colliding.
        self.verdict, self.colliding = Verdict.AMBIGUOUS, True
        kind = "UNDECIDED" if isinstance(error, LoewnerError) else "ERROR"
        self._show_verdict(kind, BAD, [], [f"{type(error).__name__}: {error}", "Treat it as colliding."])
        self._near.hide()

    # -- inside -----------------------------------------------------------------------------------

    def _run(self) -> None:
        while not self._closed.is_set():
            done = self._drained()
            if self._closed.is_set():
                return
            with self.lock:
                if done or self._changed():
                    self._apply(done)

    def _drained(self) -> dict[str, Any]:
        """Wait for an action, and then take all actions that have occurred."""
        done: dict[str, Any] = {}
        try:
            event = self._events.get(timeout=self._look_every())
            while event is not None:
                done[event[0]] = event[1]
                event = self._events.get_nowait()
        except queue.Empty:
            pass
        return done

    def _apply(self, done: dict[str, Any]) -> None:
        started = time.perf_counter()
        with self.server.atomic():
            try:
                if "marks" in done:
                    self._ground.visible = self._marks["ground"].value
                self._take(done)
                self._answer()
            except Exception as error:
                # An outdated verdict must not stay on the page.
                self._show_failure(error)
                if not isinstance(error, LoewnerError):
                    traceback.print_exc(file=sys.stderr)
        self.seconds = time.perf_counter() - started
        self.answered += 1


class Mover:
    """The gizmo with which users drag one body on the page.

    The gizmo's node has the body's pose, so that the browser moves the body with the mouse.
    """

    def __init__(self, page: Viewer, node: str, name: str, T: Floats) -> None:
        self.T = T
        self._name = name
        self.gizmo = page.server.scene.add_transform_controls(node, depth_test=False, line_width=3.0)
        place(self.gizmo, T)
        page._watch(self.gizmo, f"drag {name}")

    def fit(self, box: Floats, view: float) -> None:
        """Fit the gizmo to the box of its body and to the diagonal of the view [m]."""
        self.gizmo.scale = min(GIZMO * float(np.ptp(box, axis=0).max()), MOST_GIZMO * view)

    def show(self, on: bool) -> None:
        """Show or hide the handles of the gizmo."""
        if self.gizmo.disable_axes == on:
            self.gizmo.disable_axes = self.gizmo.disable_sliders = self.gizmo.disable_rotations = not on

    def take(self) -> Floats:
        """Read the pose to which the gizmo was dragged."""
        self.T = pose_of(from_quaternion(self.gizmo.wxyz, self._name), self.gizmo.position)
        return self.T

    def move(self, T: Floats) -> None:
        """Put the gizmo, and with it the body, at a pose."""
        if not np.array_equal(T, self.T):
            self.T = T
            place(self.gizmo, T)


class PoseInputs:
    """A pose as numbers on the panel: its position in metres, and roll, pitch and yaw in degrees."""

    def __init__(self, page: Viewer, name: str, view: float) -> None:
        gui = page.server.gui
        # viser shows the same number of decimals as the step has.
        step = round_length(view / 5000)
        self._decimals = max(0, -math.floor(math.log10(step)))
        self.position = page._watch(gui.add_vector3("position, m", (0.0, 0.0, 0.0), step=step), f"type {name}")
        self.turn = page._watch(gui.add_vector3("roll, pitch, yaw, °", (0.0, 0.0, 0.0), step=0.01), f"type {name}")

    def take(self) -> Floats:
        """Read the pose that was typed."""
        return pose_of(from_rpy(*np.radians(self.turn.value)), self.position.value)

    def show(self, T: Floats) -> None:
        """Show a pose, rounded to the displayed decimals."""
        with np.errstate(all="ignore"):
            turn = Rotation.from_matrix(T[:3, :3]).as_euler("xyz", degrees=True)
        self.position.value = tuple((np.round(T[:3, 3], self._decimals) + 0.0).tolist())
        self.turn.value = tuple((np.round(turn, 2) + 0.0).tolist())


def cut_short(lines: list[str], most: int) -> list[str]:
    """Keep the first lines, and replace the other lines with their count."""
    return lines if len(lines) <= most else [*lines[:most], f"and {len(lines) - most} more"]


def length_text(length: float) -> str:
    """Write a length in metres, or in millimetres if it is less than a metre."""
    return f"{1e3 * length:.4g} mm" if length < 1.0 else f"{length:.4g} m"


def certified_words(verdict: Verdict) -> str:
    """Describe the verdict of the ellipsoids alone."""
    return f"{verdict.name}, " + ("settled by the exact search" if verdict == Verdict.AMBIGUOUS else "proven")


def _swatch(colour: Rgb | None) -> str:
    return "" if colour is None else f'<span aria-hidden="true" style="color:rgb{colour}">■ </span>'


def note_lines(notes: list[str]) -> str:
    """Format lines of text as escaped HTML."""
    return f'<div style="{TEXT};overflow-wrap:anywhere">{_lines(notes)}</div>'


def _lines(notes: list[str]) -> str:
    return "".join(f'<div data-loewner="note">{escape(note)}</div>' for note in notes)


def _serve(title: str, where: guard.Listening, port: int) -> tuple[Any, guard.Guard]:
    """Start the server behind its guard."""
    try:
        import viser
    except ImportError as error:
        package = (error.name or "viser").partition(".")[0]
        raise MissingExtraError(f"the viewer needs {package}: {installing('viewer')}") from None
    # Check the port and the address first. Otherwise, viser would silently take another port, and would wait forever at
    # an invalid address.
    try:
        with socket.create_server((where.address, port), family=where.family):
            pass
    except OSError as error:
        raise InputError(
            f"port: expected a free port at {where.host}, could not have {port} "
            f"({os.strerror(error.errno) if error.errno and error.errno > 0 else error}); choose another, or 0 for any"
        ) from None
    # Browsers open connections in advance and drop them; a dropped connection is not worth a traceback.
    logging.getLogger("websockets.server").addFilter(_worth_logging)
    with _quiet():
        server = viser.ViserServer(host=where.address, port=port, label=title, verbose=False)
    try:
        if port not in (0, server.get_port()):
            raise InputError(
                f"port: expected a free port at {where.host}, found {port} in use; choose another, or 0 for any"
            )
        token = None if where.loopback else secrets.token_urlsafe(24)
        guarding = guard.Guard(where, server.get_port(), token, title)
        guard.install(server, guarding)
    except BaseException:
        _stop(server)
        raise
    server.gui.configure_theme(show_share_button=False)
    return server, guarding


def _stop(server: Any) -> None:
    """Stop the server."""
    with _quiet():
        server.stop()


@contextmanager
def _quiet() -> Iterator[None]:
    """Drop the messages that viser prints with Rich when a server starts and stops; viser has no option for this."""
    import rich

    everything = rich.print

    def others(*objects: Any, **options: Any) -> None:
        if not str(sys._getframe(1).f_globals.get("__name__")).startswith("viser."):
            everything(*objects, **options)

    rich.print = others
    try:
        yield
    finally:
        rich.print = everything


def _worth_logging(record: logging.LogRecord) -> bool:
    return record.getMessage() != "opening handshake failed"
