"""Gates of real robots among boxes, clouds and people: nothing is met before standstill, and wrong gates are found."""

import dataclasses
import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.append(str(Path(__file__).parents[1] / "benchmarks"))

from loewner.planners import Gate, gates
from loewner.planners.brakes import Brakes
from loewner.queries.pose_paths import PackedPaths
from native_files import needs_library
from sampling import quick, quick_of
from test_gates import OffAsOn, WithoutBrakes, WithoutJerk

pytestmark = needs_library
pytest.importorskip("capi")
gate_chunks = pytest.importorskip("gate_chunks")


class AnyPosition(Gate):
    """Uses proofs wherever the robot was measured."""

    def _here(self, world, state, now):
        real, self._error = self._error, np.full_like(self._error, np.inf)
        found = super()._here(world, state, now)
        self._error = real
        return found


class AnyVelocity(Gate):
    """Uses proofs at any measured velocity."""

    def _here(self, world, state, now):
        real, self._rate_error = self._rate_error, np.full_like(self._rate_error, np.inf)
        found = super()._here(world, state, now)
        self._rate_error = real
        return found


class WithoutRest(Gate):
    """Proves brakes for as long as they last at the velocities of the chunk."""

    def _pieces(self, ready, brakes, rates):
        return brakes.courses(self._jerk is not None or rates is None)


def world_of(**same):
    """A comparison of worlds that takes something as it was."""
    real = gates._is_within

    def is_within(new, old, now):
        return real(new._replace(**{name: getattr(old, name) for name in same if same[name](new, old)}), old, now)

    return is_within


def body_of(same_path=False, **same):
    """A comparison of a body's bounds that takes something as it was."""
    real = gates._path_is_within

    def is_within(path, bounds, old, allowed, now):
        if same and bounds is not None and allowed is not None:
            bounds = dataclasses.replace(bounds, **{name: getattr(allowed, name) for name in same})
        return real(old if same_path else path, bounds, old, allowed, now)

    return is_within


def as_before(new, old):
    return new.poses.shape == old.poses.shape


WRONG = {
    "structure": ("_is_within", world_of(structure=as_before)),
    "moved": ("_is_within", world_of(poses=as_before)),
    "cone": ("_path_is_within", body_of(same_path=True)),
    "faster": ("_path_is_within", body_of(speed=True)),
    "turns": ("_path_is_within", body_of(turn=True)),
    "error": ("_path_is_within", body_of(metres=True)),
    "forecast": ("_path_is_within", body_of(same_path=True)),
    "pushed": (None, AnyPosition),
    "kicked": (None, AnyVelocity),
}


def contacts(folder, wrong, given, name=None, how=None):
    """Runs in a few worlds until a wrong gate leads to contact; with the gate as it is, the same world has none."""
    for seed in range(8):
        with pytest.MonkeyPatch.context() as patch:
            if name is not None:
                patch.setattr(*name, how)
            found = gate_chunks.Run(seed, wrong, folder, robot=("ur5e", "mobile")[seed % 2], **given).run(30)
        if found["contacts"] > 0:
            right = gate_chunks.Run(seed, Gate, folder, robot=("ur5e", "mobile")[seed % 2], **given).run(30)
            return found["contacts"], right["contacts"]
    return 0, 0


@pytest.mark.parametrize("make", ["c", pytest.param("python", marks=pytest.mark.verify)])
@pytest.mark.parametrize("count", quick(6, 12))
def test_chunks_meet_nothing_before_standstill(tmp_path, make, count):
    """Each robot in each kind of world, whatever bodies and the robot do within their bounds."""
    totals = gate_chunks.Totals()
    for seed in range(count):
        totals.counts.update(gate_chunks.Run(seed, make, tmp_path).run(8, 30))
    assert totals.counts["contacts"] == 0
    assert totals.counts["chunks"] > 60 * count
    assert min(totals.counts[name] for name in ("GO", "PREFIX", "BRAKE", "INSIDE", "brakes", "events")) > 0
    assert 0.2 < totals.counts["reused"] / totals.counts["checks that go on"] < 1.0  # others are proven again


@pytest.mark.parametrize(
    "event",
    quick_of(WRONG, ("moved",)),
)
def test_gates_that_use_what_does_not_hold_are_found_out(tmp_path, event):
    """After an event, the use of earlier proofs leads to contact; the gate as it is does not use them."""
    name, wrong = WRONG[event]
    given = {"kind": "boxes" if event in ("structure", "moved", "pushed", "kicked") else "all"}
    given |= {"events": (event,), "event": 0.3} | ({"late": 0.0, "brake": "joints"} if event == "kicked" else {})
    if name is None:
        found, right = contacts(tmp_path, wrong, given)
    else:
        found, right = contacts(tmp_path, Gate, given, (gates, name), wrong)
    assert found > 0
    assert right == 0


@pytest.mark.verify  # a shorter simulation finds most of these in test_gates.py
@pytest.mark.parametrize(
    ("wrong", "given"),
    [
        (WithoutBrakes, {}),
        (OffAsOn, {"brake": "joints"}),
        (WithoutJerk, {"brake": "joints", "jerk": 40.0}),
        (WithoutRest, {"brake": "joints", "kind": "all"}),
    ],
)
def test_gates_that_prove_less_are_found_out(tmp_path, wrong, given):
    """Without events: no brakes, brakes on the path, brakes without limits of jerk, and brakes that end too early."""
    found, right = contacts(tmp_path, wrong, given | {"event": 0.0})
    assert found > 0
    assert right == 0


@pytest.mark.verify
def test_growth_that_is_dropped_is_found_out(tmp_path):
    """Likewise if bodies are taken to be where they were seen."""
    off = PackedPaths.off
    given = {"kind": "all", "event": 0.0}
    how = (PackedPaths, "off"), lambda self, *times: off(self, *times) * [1.0, 0.0, 0.0]
    found, right = contacts(tmp_path, Gate, given, *how)
    assert found > 0
    assert right == 0


@pytest.mark.parametrize("jerk", [None, 40.0])
def test_brakes_of_the_simulation_are_the_library_s(jerk):
    """The ways of joints that brake, from a formula of their own."""
    v, strongest = np.array([1.0, -0.3, 0.02, 0.0]), np.array([5.0, 4.0, 3.0, 2.0])
    steep = np.full(4, np.inf) if jerk is None else np.full(4, jerk)
    made = Brakes.by_joint(np.zeros((1, 4)), v[None], np.zeros((1, 4)), strongest, steep)
    times, positions, *_ = made.one()
    ways, duration = gate_chunks.stopping(v, strongest, None if jerk is None else steep, times)
    np.testing.assert_allclose(ways, positions, atol=1e-12)
    assert duration == pytest.approx(times[-1])


@pytest.mark.verify
def test_a_run_is_counted(capsys):
    """The benchmark prints what it counted."""
    assert gate_chunks.main(["--chunks", "200", "--gates", "python"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines if line.startswith("contacts")] == ["contacts"]
    assert lines[-1].startswith("nearest approach")


@pytest.mark.verify
def test_many_chunks_meet_nothing_before_standstill(tmp_path):
    """The same, a hundred thousand times."""
    totals = gate_chunks.Totals()
    totals.add(100_000, 1_000_000, gate_chunks.BOTH, tmp_path)
    print(dict(totals.counts), totals.closest)
    assert totals.counts["contacts"] == 0
