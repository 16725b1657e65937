"""What hostile callers hand to the extension: odd arrays, forged bodies, arrays that change, calls in between.

Whatever that is, the call answers or raises an exception, the process lives, and the next usual call has its usual
answer. A handle is an address, which is followed: none that is a number of 64 bits is forged here.
`make sanitize` runs this file with an extension that reports any access to memory that is not its own.
"""

import contextlib
import os
import signal
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import loewner
from checker_oracle import robot_of
from families import random_poses
from loewner import Body, CollisionChecker, LoewnerError, Scene
from loewner._native import entries, library
from loewner.robots.checking.edges import coarse_first
from native_files import needs_library

pytestmark = [
    needs_library,
    pytest.mark.filterwarnings("ignore:.*is it in .*:UserWarning"),
]

# Rounds of the quick suite, and of the campaign.
ROUNDS = [100, pytest.param(3000, marks=pytest.mark.fuzz)]


class Asked:
    """Bodies, poses and a checker, and what the usual calls say of them."""

    def __init__(self, folder: Path) -> None:
        rng = np.random.default_rng(0)
        union = Body.union([Body.from_points(rng.normal(size=(8, 3)) + 3 * k) for k in range(10)])
        self.bodies = [Body.box([1, 1, 1]), Body.cylinder(0.5, 1.0), union]
        self.poses = random_poses(rng, 12, 1.5)
        limits = '<axis xyz="1 0 0"/><limit lower="-1" upper="1"/>'
        joints = [("prismatic", 0, limits), ("prismatic", 1, limits)]
        scene = Scene()
        scene.add("post", Body.box([0.2, 0.2, 0.2]), [[1, 0, 0, 0.5], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
        self.checker = CollisionChecker(robot_of(folder, joints, {"l2": Body.box([0.2, 0.2, 0.2])}), scene)
        self.Q = self.checker.robot.random_configurations(12, 0)
        self.right = self.answers()

    def answers(self) -> list[Any]:
        """Of every usual query."""
        found: list[Any] = []
        for k, T in enumerate(self.poses):
            a, b = self.bodies[k % 3], self.bodies[(k + 1) % 3]
            measured = loewner.distance(a, None, b, T, exact=True)
            found += [loewner.collide(a, None, b, T), loewner.classify(a, T, b, None), measured.distance]
            found += measured.normal.tolist()
        for q, end in zip(self.Q, self.Q[::-1], strict=True):
            found += [self.checker.collide(q), self.checker.classify(q), self.checker.valid_edges(q, end, 0.05)]
        return found

    def calls(self, T: Any, q: Any, body: Any) -> Iterator[Callable[[], Any]]:
        """Every query with something hostile in it."""
        box, end, single = self.bodies[0], self.Q[0], self.checker._ready().single
        yield lambda: loewner.collide(box, T, body, None)
        yield lambda: loewner.collide(body, None, box, T, margin=0.1)
        yield lambda: loewner.classify(box, T, body, T)
        yield lambda: loewner.distance(body, T, box, None, exact=True)
        yield lambda: loewner.distance(box, None, body, T)
        yield lambda: self.checker.collide(q)
        yield lambda: self.checker.classify(q)
        yield lambda: self.checker.valid_edges(q, end, 0.05)
        yield lambda: single.motion(end, q, 0.05, coarse_first)
        yield lambda: single.motion(q, end, 0.05, lambda steps: T)
        yield lambda: single.collide(T)
        yield lambda: entries.first_fault(T)


@pytest.fixture(scope="module")
def asked(tmp_path_factory: pytest.TempPathFactory) -> Asked:
    return Asked(tmp_path_factory.mktemp("hostile"))


def odd_array(rng: np.random.Generator) -> Any:
    """An array that may or may not pass for a pose or a configuration: of any shape, type, order and alignment."""
    shape = [(4, 4), (2,), (1, 4, 4), (0, 4), (4, 0), (), (16,), (3, 3), (2, 1), (5, 4, 4)][rng.integers(10)]
    array = np.zeros(shape, rng.choice(["f8", "f8", "f8", ">f8", "f4", "i8", "?", "c16", "O", "U3", "V8"]))
    with contextlib.suppress(TypeError, ValueError, OverflowError), np.errstate(all="ignore"):
        array[...] = np.eye(4)[: shape[-2], : shape[-1]] if len(shape) > 1 else rng.choice([0.1, np.nan, -np.inf])
    change = rng.integers(8)
    if change == 0 and array.dtype.kind == "f":
        array = np.frombuffer(b"\0" + array.tobytes(), np.uint8)[1:].view(array.dtype).reshape(shape)  # not aligned
    elif change == 1 and array.ndim:
        array = np.repeat(array, 2, axis=-1)[..., ::2]
    elif change == 2:
        array = array[::-1] if array.ndim else array
    elif change == 3:
        array = np.asfortranarray(array)
    elif change == 4:
        array = np.broadcast_to(array.ravel()[:1], shape) if array.size and shape else array
    elif change == 5:
        array.setflags(write=False)
    elif change == 6:
        array = array.view(np.recarray)
    return array


class Subclass(Body):
    """A user's own kind of body."""


class Handle:
    """What stands where a body keeps its arrays: its handle is of any kind, or raises."""

    def __init__(self, handle: Any) -> None:
        self._handle = handle

    @property
    def handle(self) -> Any:
        if isinstance(self._handle, BaseException):
            raise self._handle
        return self._handle


def forged(rng: np.random.Generator, body: Body) -> Any:
    """A body that never was made, of another class, or with no address where one belongs."""
    handles = [None, 2**70, 1.5, "1", ValueError("no"), KeyError("no"), np.array([1, 2]), NotImplemented]
    kind = rng.integers(5)
    if kind == 0:
        return Subclass(body._packed)
    if kind == 1:
        return [None, "box", Body, body._packed, loewner.Bodies([body]), object()][rng.integers(6)]
    made = object.__new__(Body)
    if kind > 2:
        object.__setattr__(made, "_packed", Handle(handles[rng.integers(len(handles))]))
    return made


def bear(call: Callable[[], Any]) -> None:
    """Call, whatever comes of it: a private attribute that was forged may raise anything."""
    with contextlib.suppress(Exception):
        call()


@pytest.mark.parametrize("rounds", ROUNDS)
def test_odd_arrays_and_forged_bodies(asked: Asked, rounds: int):
    """Any arrays and bodies are answered or refused, and usual calls are answered as before."""
    rng = np.random.default_rng(rounds)
    for _ in range(rounds):
        for call in asked.calls(odd_array(rng), odd_array(rng), forged(rng, asked.bodies[0])):
            bear(call)
    assert asked.answers() == asked.right


@pytest.mark.parametrize("rounds", ROUNDS)
def test_arrays_and_bodies_that_change_meanwhile(asked: Asked, rounds: int):
    """Numbers that another thread overwrites give some answer or a LoewnerError, and so does a body it replaces."""
    rng, ended = np.random.default_rng(rounds), threading.Event()
    T, q, body = asked.poses[0].copy(), asked.Q[0].copy(), Body(asked.bodies[2]._packed)

    def overwrite() -> None:
        values = [np.nan, np.inf, 1e300, 0.0, -1.0]
        while not ended.is_set():
            T[:] = asked.poses[rng.integers(12)]
            q[:] = asked.Q[rng.integers(12)]
            T[rng.integers(4), rng.integers(4)] = q[rng.integers(2)] = values[rng.integers(5)]
            object.__setattr__(body, "_packed", Body.from_points(rng.normal(size=(9, 3)))._packed)

    thread = threading.Thread(target=overwrite)
    thread.start()
    try:
        for _ in range(rounds):
            for call in asked.calls(T, q, body):
                with contextlib.suppress(LoewnerError, TypeError):  # TypeErrors are those of kernels, for odd shapes
                    call()
    finally:
        ended.set()
        thread.join()
    assert asked.answers() == asked.right


@pytest.mark.skipif(not hasattr(signal, "setitimer"), reason="the system has no such timers")
@pytest.mark.parametrize("rounds", [5, pytest.param(200, marks=pytest.mark.fuzz)])
def test_a_handler_that_queries(asked: Asked, rounds: int):
    """A signal's handler that comes every 2 ms and queries gets right answers, and so does what it interrupts."""
    wrong: list[str] = []
    calls = 0

    def handler(*_: Any) -> None:
        nonlocal calls
        calls += 1
        signal.setitimer(signal.ITIMER_REAL, 0)
        if asked.answers() != asked.right:
            wrong.append("handler")
        signal.setitimer(signal.ITIMER_REAL, 0.002)

    before = signal.signal(signal.SIGALRM, handler)
    signal.setitimer(signal.ITIMER_REAL, 0.002)
    try:
        while calls < rounds:
            if asked.answers() != asked.right:
                wrong.append("interrupted")
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)
    assert not wrong


@pytest.mark.skipif(not hasattr(os, "fork"), reason="the system has no fork")
@pytest.mark.filterwarnings("ignore:.*fork.*:DeprecationWarning")
@pytest.mark.parametrize("rounds", [2, pytest.param(15, marks=pytest.mark.fuzz)])
def test_forks_under_load(asked: Asked, rounds: int):
    """A child that is forked while other threads query answers as its parent does."""
    ended = threading.Event()
    wrong: list[int] = []

    def load() -> None:
        while not ended.is_set():
            if asked.answers() != asked.right:
                wrong.append(-1)

    threads = [threading.Thread(target=load) for _ in range(2)]
    for thread in threads:
        thread.start()
    try:
        for _ in range(rounds):
            child = os.fork()
            if child == 0:
                os._exit(0 if asked.answers() == asked.right else 1)
            if status := os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]):
                wrong.append(status)
    finally:
        ended.set()
        for thread in threads:
            thread.join()
    assert not wrong


def test_an_order_that_shrinks_its_arrays(asked: Asked):
    """What gives the order of a motion may resize the ends of it: the motion is looked at anew, or left to Python."""
    single = asked.checker._ready().single
    for length in (0, 1, 3, 100_000):
        for which in (0, 1):
            ends = [asked.Q[0].copy(), asked.Q[1].copy()]

            def order(steps: int, end: np.ndarray = ends[which], length: int = length) -> np.ndarray:
                end.resize(length, refcheck=False)
                return coarse_first(steps)

            assert single.motion(*ends, 0.05, order) is None
    assert asked.answers() == asked.right


def test_types_of_the_extension_made_by_hand(asked: Asked):
    """A type of the extension refuses odd arguments by an exception, and is never half made."""
    call = library.extension()
    rng = np.random.default_rng(1)
    kernels = [entries.settle_range, entries.distance_range, entries.measure_left, entries.first_fault]
    odd = [None, 0, -1, 2**70, "", b"\0", "/", 1.5, len, call, kernels[0], np.zeros((2, 2)), np.zeros(3, np.int64), ()]
    made = [call.Library, call.Kernel, call.Pairs, call.Configurations, type(kernels[0])]
    for _ in range(2000):
        given = [odd[k] for k in rng.integers(len(odd), size=rng.integers(0, 11))]
        with pytest.raises((TypeError, ValueError, OverflowError, OSError)):
            made[rng.integers(5)](*given)
    opened, _ = library._opened()
    for text in ("F9", "A1", "i" * 200, "c", "F", " ", "F3 F3 F3", "\udcff", "i\0i", "F\x7f", "é"):
        for words in ((text, ""), ("", text), (text, text)):
            bear(lambda words=words: opened.kernel("first_fault", *words))
    assert asked.answers() == asked.right
