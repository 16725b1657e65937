"""Copies and pickles of what the library returns: what is read-only stays read-only, and is the same."""

import copy
import inspect
import pickle
import warnings
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

import border_calls as border
import loewner
from loewner import planners
from loewner.queries import pose_paths

# Classes that users have objects of. What these objects hold is compared as well.
PUBLIC = {
    one
    for module in (loewner, loewner.robots, planners, pose_paths)
    for one in vars(module).values()
    if inspect.isclass(one) and one.__module__.startswith("loewner.")
}

# Calls that are left out: they take seconds, or return pictures and numbers alone.
SLOW = ("planners.plan", "planners.plan_in_time", "paper.", "plots.", "viewer", "cluster.")


def held(value: Any, way: str, seen: set[int]) -> Iterator[tuple[str, Any]]:
    """All arrays and objects of the library in a value, with the ways to them."""
    if id(value) in seen:
        return
    seen.add(id(value))
    if isinstance(value, np.ndarray):
        yield way, value
    elif isinstance(value, dict):
        for key, entry in value.items():
            yield from held(entry, f"{way}[{key!r}]", seen)
    elif isinstance(value, (list, tuple)):
        for k, entry in enumerate(value):
            yield from held(entry, f"{way}[{k}]", seen)
    elif type(value).__module__.startswith("loewner.") and not inspect.isclass(value):
        yield way, value
        for name, entry in getattr(value, "__dict__", {}).items():
            yield from held(entry, f"{way}.{name}", seen)


def arrays(value: Any) -> dict[str, bool]:
    """The ways to all arrays of a value, and whether one can write into them."""
    return {way: one.flags.writeable for way, one in held(value, "", set()) if isinstance(one, np.ndarray)}


@pytest.fixture(scope="module")
def answers(tmp_path_factory: pytest.TempPathFactory) -> dict[type, Any]:
    """One object of each public class, among the answers of all public calls and what they hold."""
    found: dict[type, Any] = {}
    with pytest.MonkeyPatch.context() as patched, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        patched.chdir(tmp_path_factory.mktemp("copies"))
        border.write_files()
        for name, call in border.CALLS.items():
            if name == "Robot.cover" or name.startswith(SLOW):
                continue
            try:
                answer = call.ask(**{key: right.make() for key, right in call.arguments.items()})
            except ImportError:  # an optional package
                continue
            pieces = [one.pieces for _, one in held(answer, "", set()) if isinstance(one, loewner.Body)]
            for _, one in held([answer, pieces], "", set()):
                if type(one) in PUBLIC:
                    found.setdefault(type(one), one)
    return found


def test_read_only_arrays_stay_read_only_in_copies(answers: dict[type, Any]) -> None:
    """Nothing that is checked once and trusted later can be changed in a shallow or deep copy, or in a pickle."""
    protected = set()
    for made, one in answers.items():
        kept = {way for way, writeable in arrays(one).items() if not writeable}
        protected |= {made} if kept else set()
        for name, again in (
            ("copy", copy.copy(one)),
            ("deep copy", copy.deepcopy(one)),
            ("pickle", pickle.loads(pickle.dumps(one))),
        ):
            # Prepared data may be left out, to be made anew.
            lost = [way for way, writeable in arrays(again).items() if writeable and way in kept]
            assert not lost, (made, name, lost)
    names = {made.__name__ for made in protected}
    assert names >= {"Attachment", "Bodies", "Body", "Ellipsoids", "Fit", "JointLimits", "Piece", "Polytope"}, names
    assert names >= {"CollisionChecker", "PosePath", "Roadmap", "Robot", "Trajectory"}, names
