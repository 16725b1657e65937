"""Ctrl+C at random times in every public call that takes a while, on one thread, on two, and with the call on another.

It is a KeyboardInterrupt and nothing else, it comes soon, and the same call is right afterwards.
"""

import ast
import gc
import os
import pickle
import random
import signal
import subprocess
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

import driver
import loewner
from families import random_poses
from gantry import LEFT, RIGHT, gantry, wall
from loewner import Bodies, Body, CollisionChecker, Ellipsoids, Robot, Scene, paper, planners
from sampling import quick

# Processor time from the signal to the exception, at most [s]: shares take a tenth, and machines of tests are slow.
SOON = 2.0

LAYOUTS = ("alone", "shared", "elsewhere")


def calls(folder: Path) -> dict[str, Callable[[], Any]]:
    """Public calls, each long enough to be interrupted; compiled, or loaded, by one small call before."""
    rng = np.random.default_rng(0)
    sets = rng.normal(size=(300, 40, 3))
    rock, rocks, drum = Body.from_points(sets[0]), Bodies.from_points(sets[:50]), Body.cylinder(0.5, 2.0)
    heap = Body.union([rock.transformed(T) for T in random_poses(rng, 12)])
    Ta, Tb = random_poses(rng, 40_000), random_poses(rng, 40_000)
    cloud, flat = rng.normal(size=(20_000, 12)), rng.normal(size=(400_000, 3))
    sides = np.concatenate([np.eye(30), -np.eye(30), rng.normal(size=(100, 30))])
    A, B = (
        Ellipsoids.from_semi_axes(rng.normal(size=(20_000, 3)), rng.uniform(0.2, 1, size=(20_000, 3))) for _ in "ab"
    )
    urdf, _ = gantry(folder)
    robot, scene = Robot.from_urdf(urdf), Scene(margin=0.01)
    for i, T in enumerate(random_poses(rng, 20, spread=4.0)):
        scene.add(f"rock {i}", rocks[i], T)
    checker = CollisionChecker(robot, scene)
    Q = robot.random_configurations(20_000, seed=1)
    beside, number = CollisionChecker(robot, wall()), robot.link_names.index("rod")
    rods = robot.forward_kinematics(Q)[:, number]
    turned = robot.forward_kinematics([-0.9, 0.9, 3.0])[number]
    ball = trimesh.creation.icosphere(subdivisions=3)
    rocks.save(folder / "rocks.npz")
    loewner.save_scene(scene, folder / "scene.yaml")
    return {
        "classify": lambda: loewner.classify(rocks[:40], Ta.reshape(-1, 40, 4, 4), heap, Tb.reshape(-1, 40, 4, 4)),
        "collide": lambda: loewner.collide(rock, Ta, drum, Tb),
        "collide, many pieces": lambda: loewner.collide(heap, Ta[:3000], heap, Tb[:3000]),
        "collide by the estimate": lambda: loewner.collide(rock, Ta, drum, Tb, method="estimate"),
        "collide pairs": lambda: loewner.collide(rocks, Ta[:50], rocks, Tb[:50], pairs=np.indices((50, 50)).T),
        "distance": lambda: loewner.distance(rock, Ta, drum, Tb),
        "distance, exact": lambda: loewner.distance(rock, Ta[:8000], rock, Tb[:8000], exact=True),
        "distance, few": lambda: loewner.distance(heap, Ta[:400], heap, Tb[:400], exact=True),
        "distance of pairs": lambda: loewner.distance(
            rocks, Ta[:50], rocks, Tb[:50], pairs=np.indices((50, 50)).T, exact=True
        ),
        "overlapping_pairs": lambda: loewner.overlapping_pairs(rock, Ta[:1000]),
        "mvce": lambda: loewner.mvce(cloud),
        "mvce of many": lambda: loewner.mvce(flat),
        "mvie": lambda: loewner.mvie(sides, np.ones(len(sides))),
        "Bodies.from_points": lambda: Bodies.from_points(sets),
        "Body.from_mesh": lambda: Body.from_mesh(ball, decompose=False),
        "Polytope.from_points": lambda: loewner.Polytope.from_points(flat[:100_000]),
        "Bodies[...]": lambda: rocks[np.arange(3000) % 50],
        "union": lambda: Body.union([rock] * 1000),
        "Bodies.load": lambda: Bodies.load(folder / "rocks.npz"),
        "Bodies.save": lambda: rocks.save(folder / "saved.npz"),
        "contact_function": lambda: loewner.contact_function(A, B),
        "near_points": lambda: loewner.near_points(A, B),
        "paper.distance_estimate": lambda: paper.distance_estimate(A, A, B, B, "lin-han"),
        "forward_kinematics": lambda: robot.forward_kinematics(Q),
        "checker.collide": lambda: checker.collide(Q),
        "checker.classify": lambda: checker.classify(Q),
        "checker.tiers": lambda: checker.tiers(Q),
        "checker.distance": lambda: checker.distance(Q[:2000]),
        "checker.distance, exact": lambda: checker.distance(Q[:300], exact=True),
        "checker.collide_by_pair": lambda: checker.collide_by_pair(Q[:2000]),
        "checker.valid_edges": lambda: checker.valid_edges(Q[:500], Q[500:1000], resolution=0.05),
        "robot.reach": lambda: robot.reach("rod", rods, checker=checker).reached,
        "robot.reach, all": lambda: robot.reach("rod", rods[:2000], seeds=16, all=True, checker=checker).free,
        "planners.straight": lambda: planners.straight(beside, LEFT, "rod", turned, position=1e-9, rotation=1e-9),
        "plan, improve_for": lambda: planners.plan(beside, LEFT, RIGHT, improve_for=60.0, improve_iterations=300),
        "pairs_by_sampling": lambda: loewner.pairs_by_sampling(robot, 20_000),
        "checker.pairs": lambda: [contact.name_a for q in Q[:100] for contact in checker.pairs(q)],
        "Scene.pairs": lambda: [contact.distance for contact in scene.pairs()],
        "load_scene": lambda: pickle.dumps(loewner.load_scene(folder / "scene.yaml").names),
        "save_scene": lambda: loewner.save_scene(scene, folder / "saved.yaml"),
        "Robot.from_urdf": lambda: Robot.from_urdf(urdf).link_names,
    }


@cache
def made(folder: Path) -> dict[str, Callable[[], Any]]:
    return calls(folder)


@cache
def prepared(folder: Path, name: str) -> tuple[Callable[[], Any], bytes]:
    """A call, and what it answers, as bytes."""
    call = made(folder)[name]
    return call, pickle.dumps(call())


def campaign(folder: Path, count: int, seed: int) -> tuple[list[driver.Outcome], Counter[str]]:
    """Outcomes of `count` interrupted calls, all names and layouts in turn, and how they ended."""
    draw = random.Random(seed)
    names = list(made(folder))
    first = draw.randrange(len(names))
    cases = [
        (names[(first + k) % len(names)], LAYOUTS[k % len(LAYOUTS)], draw.random(), str(folder)) for k in range(count)
    ]
    for name, *_ in cases:
        prepared(folder, name)  # here, once: the driver's processes are forks of this one
    outcomes = driver.run(interrupted, cases, limit=60.0)
    told = (folder / "endings").read_text().split() if (folder / "endings").exists() else []
    return outcomes, Counter(told)


def interrupted(case: tuple[str, str, float, str]) -> str | None:
    """Interrupt a call when a share of its usual time is over; say what is wrong, or write down how it ended."""
    name, layout, part, folder = case
    call, answer = prepared(Path(folder), name)
    loewner.set_num_threads(1 if layout == "alone" else 2)
    start = time.perf_counter()
    call()
    usual, waited, worked, ending = time.perf_counter() - start, 0.0, 0.0, "late"
    sent: list[float] = []
    spent: list[float] = []  # processor time: a busy machine has calls wait, and nothing is wrong with them
    gone: list[None] = []
    raised: list[float] = []

    def interrupt(*_: Any) -> None:
        raised.append(time.perf_counter())
        raise KeyboardInterrupt

    def send() -> None:
        time.sleep(part * usual)
        sent.append(time.perf_counter())
        spent.append(time.process_time())
        os.kill(os.getpid(), signal.SIGINT)
        gone.append(None)  # on a busy machine long after the line before

    signal.signal(signal.SIGINT, interrupt)
    sender = threading.Thread(target=send)
    # Not waited for by join: a thread whose join is interrupted counts as ended in Python 3.11.
    answers: list[bytes] = []
    worker = threading.Thread(target=lambda: answers.append(pickle.dumps(call())))
    try:
        try:
            if layout == "elsewhere":
                worker.start()
            sender.start()
            if layout == "elsewhere":
                until(lambda: answers)
            else:
                call()
        finally:
            waited, worked = time.perf_counter(), time.process_time()
        until(lambda: gone)
        time.sleep(SOON)
        if not raised:
            return "the signal did not arrive"
        return f"the interrupt was lost: raised {waited - raised[0]:.3g} s before the call ended"
    except KeyboardInterrupt:
        ending = "interrupted" if sent and sent[0] <= waited and not answers else "late"
        if spent and worked - spent[0] > SOON:
            return f"the call went on for {worked - spent[0]:.2f} s of processor time"
    sender.join()
    if layout == "elsewhere":
        until(lambda: answers)
        if answers != [answer]:
            return "the call on another thread did not come to its answer"
    if pickle.dumps(call()) != answer:
        return "the same call answered otherwise afterwards"
    with open(Path(folder) / "endings", "a") as file:
        file.write(ending + "\n")
    return None


def until(happened: Callable[[], Any]) -> None:
    """Wait as a program does that can be interrupted."""
    while not happened():
        time.sleep(0.0005)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("interrupts")


@pytest.mark.parametrize("count", quick(2, 5))
def test_some_interrupts(folder: Path, count: int):
    """A KeyboardInterrupt each, and right answers afterwards."""
    outcomes, _ = campaign(folder, count, seed=1)
    assert not driver.faults(outcomes)


def interrupted_at(call: Callable[[], Any], line: int) -> int:
    """Raise a KeyboardInterrupt before a line of Python that a call executes, ours or not; return the lines so far."""
    lines = 0

    def trace(frame: Any, event: str, _: Any) -> Any:
        nonlocal lines
        lines += event == "line"
        if event == "line" and lines == line:
            sys.settrace(None)
            raise KeyboardInterrupt
        return trace

    before = sys.gettrace()
    sys.settrace(trace)
    try:
        call()
    finally:
        sys.settrace(before)
    return lines


@pytest.mark.parametrize("name", ["collide", "checker.collide", "certify_edges"])
@pytest.mark.parametrize("count", quick(150, 400))
def test_an_interrupt_at_any_line(name: str, folder: Path, count: int):
    """NumPy drops errors in some Python code that it calls; an interrupt is not among them."""
    rng = np.random.default_rng(0)
    rocks, robot = Bodies.from_points(rng.normal(size=(2, 8, 3))), Robot.from_urdf(gantry(folder)[0])
    checker, Q, T = CollisionChecker(robot), robot.random_configurations(2, seed=1), random_poses(rng, 3)
    call = {
        "collide": lambda: loewner.collide(rocks[0], None, rocks[1], T),
        "checker.collide": lambda: checker.collide(Q),
        "certify_edges": lambda: checker.certify_edges(Q[:1], Q[1:]),
    }[name]
    call()
    # Garbage of tests before this one may have finalizers in Python, and Python drops what is raised in these.
    gc.collect()
    gc.disable()
    try:
        lines = interrupted_at(call, 0)
        for line in range(1, lines + 1, 1 + lines // count):
            with pytest.raises(KeyboardInterrupt):
                interrupted_at(call, line)
    finally:
        gc.enable()


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")  # of zipfile, about what is unfinished
def test_an_interrupt_while_a_file_is_written(folder: Path, monkeypatch: pytest.MonkeyPatch):
    """As an entry of the archive is closed: zipfile raises an error about it, which does not replace the interrupt."""
    rocks = Bodies.from_points(np.random.default_rng(0).normal(size=(2, 8, 3)))

    def interrupt(*_: Any, **__: Any) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("zipfile._ZipWriteFile.close", interrupt)
    with pytest.raises(KeyboardInterrupt):
        rocks.save(folder / "interrupted.npz")
    assert not (folder / "interrupted.npz").exists()


def losses_in_a_new_process(count: int, seed: int) -> tuple[int, list[str]]:
    """Count where nothing else ran: Hypothesis, for one, leaves a callback of the collector, which drops interrupts."""
    program = (
        f"import sys; sys.path[:0] = {sys.path!r}; from lost_interrupts import losses; print(losses({count}, {seed}))"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return ast.literal_eval(done.stdout)


@pytest.mark.parametrize("count", quick(10, 25))
def test_no_interrupt_is_lost(count: int):
    """Each KeyboardInterrupt that is raised during a call arrives at the caller: none is dropped."""
    assert losses_in_a_new_process(count, seed=1) == (0, [])


@pytest.mark.fuzz
def test_none_of_many_interrupts_is_lost():
    """Each KeyboardInterrupt that is raised during a call arrives at the caller: none of 10,000 is dropped."""
    assert losses_in_a_new_process(10_000, seed=2) == (0, [])
    print("\ninterrupts: 10000 of one call, 0 lost")


@pytest.mark.fuzz
def test_many_interrupts(folder: Path):
    """A KeyboardInterrupt each, and right answers afterwards."""
    (folder / "endings").unlink(missing_ok=True)
    outcomes, endings = campaign(folder, 600, seed=2)
    print(f"\ninterrupts: {len(outcomes)} of {len(made(folder))} calls, {dict(endings)}, 0 faults")
    assert not driver.faults(outcomes)
    assert endings["interrupted"] >= 100
