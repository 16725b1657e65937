"""Every public callable refuses what is no right argument, by a child of LoewnerError, or answers rightly.

Each parameter gets each of some sixty bad values, and an array moreover what it can be spoilt by: `border_calls`. As a
script this file writes the table of outcomes into docs/verification.md.
"""

from __future__ import annotations

import dataclasses
import itertools
import os
import random
import sys
import tempfile
import warnings
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

if __name__ == "__main__":
    sys.path[:0] = [str(Path(__file__).parent.parent), str(Path(__file__).parent)]

import numpy as np
import pytest

import border_calls as border
import driver
from loewner import Bodies, Body, LoewnerError, Scene, Verdict
from sampling import quick

# A documented warning, among outcomes.
WARNED = "warned"
WARNING = "with a warning: "

# Left out of the sample: seconds each.
SLOW = ("planners.plan", "paper.run", "loewner paper", "Robot.cover")


class Case(NamedTuple):
    """One call, one parameter (none: the right arguments as they are), one value by name."""

    call: str
    parameter: str
    value: str


def cases() -> list[Case]:
    """All of them, in the order of the table."""
    return [Case(*case) for case in _cases()]


def _cases() -> Iterator[tuple[str, str, str]]:
    for name, call in (border.CALLS | border.LINES).items():
        yield name, "", ""
        for parameter, right in call.arguments.items():
            for value in border.WORDS if name in border.LINES else border.BAD:
                if value not in right.skips:
                    yield name, parameter, value
            if right.array:
                spoilt = border.SPOILT | (border.SPOILT_FLOATS if right.make().dtype.kind == "f" else {})
                for value in spoilt:
                    if value not in right.skips and (value != "turned over" or right.make().ndim > 1):
                        yield name, parameter, value


def ask(case: Case) -> str | None:
    """The task of one case: None if it is well, or what is wrong with it, or WARNING and what was said."""
    border.clean()
    call = (border.CALLS | border.LINES)[case.call]
    arguments = {name: right.make() for name, right in call.arguments.items()}
    must, plain = case.value.startswith("=") or not case.parameter, None
    if case.parameter:
        right = call.arguments[case.parameter]
        arguments[case.parameter] = _value(case, right)
        if case.value not in right.takes and not must:
            plain = "nothing"  # is right here
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        try:
            answer = call.ask(**arguments)
        except LoewnerError as error:
            if must:
                return f"expected an answer, found {type(error).__name__}: {error}"
            raise
    said = [f"{warning.category.__name__}: {warning.message}" for warning in told]
    if any(warning.category is not UserWarning for warning in told):
        return f"undocumented warnings: {said}"
    if plain is not None:
        return f"accepted, with the answer {answer!r:.300}"
    if must and case.parameter and not call.varies:
        wanted = call.ask(**{name: right.make() for name, right in call.arguments.items()})
        if not same(answer, wanted):
            return f"expected {wanted!r:.300}, found {answer!r:.300}"
    return WARNING + str(said) if said else None


def _value(case: Case, right: border.Arg) -> Any:
    if case.call in border.LINES:
        return border.WORDS[case.value]()
    if case.value in border.BAD:
        return border.BAD[case.value]()
    return (border.SPOILT | border.SPOILT_FLOATS)[case.value](right.make())


def same(a: Any, b: Any) -> bool:
    """Whether two answers say the same."""
    if isinstance(a, Body | Bodies):
        return same(a.outer, b.outer) and same(a.inner, b.inner)
    if isinstance(a, Scene):
        places = [(name, s.pose(name)) for s in (a, b) for name in s.static_names]
        return same(places[: len(places) // 2], places[len(places) // 2 :]) and a.margins == b.margins
    if dataclasses.is_dataclass(a):
        return all(same(getattr(a, f.name), getattr(b, f.name)) for f in dataclasses.fields(a) if f.name[0] != "_")
    if isinstance(a, np.ndarray):
        return a.dtype == b.dtype and np.array_equal(a, b, equal_nan=a.dtype.kind == "f")
    if isinstance(a, dict):
        return list(a) == list(b) and all(same(a[key], b[key]) for key in a)
    if isinstance(a, tuple | list):
        return len(a) == len(b) and all(map(same, a, b))
    if isinstance(a, float):
        return a == b or (a != a and b != b)
    if isinstance(a, str | int | np.number | np.bool_ | frozenset | Path | Verdict | None):
        return bool(a == b)
    return type(a) is type(b)


def outcomes(chosen: list[Case]) -> list[driver.Outcome]:
    """Of each case, in a folder of its own; a documented warning is an outcome too."""
    here = os.getcwd()
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        try:
            border.write_files()
            found = driver.run(ask, chosen)
        finally:
            os.chdir(here)
    return [
        dataclasses.replace(o, kind=WARNED) if o.kind == driver.WRONG and o.text.startswith(WARNING) else o
        for o in found
    ]


def table(found: list[driver.Outcome]) -> str:
    """Counts of outcomes by callable, as Markdown."""
    counts: dict[str, Counter[str]] = {}
    parameters: dict[str, set[str]] = {}
    for outcome in found:
        call, parameter, _ = outcome.case
        parameters.setdefault(call, set()).update({parameter} - {""})
        counts.setdefault(call, Counter())[outcome.kind if outcome.kind not in driver.FAULTS else "fault"] += 1
    kinds = (driver.REFUSED, driver.OK, WARNED, "fault")
    rows = [(name, len(parameters[name]), *(c[kind] for kind in kinds)) for name, c in counts.items()]
    rows.append(("all", *(sum(row[k] for row in rows) for k in range(1, 6))))
    lines = [
        "| callable | parameters | refused | answered rightly | with a warning | at fault |",
        "|---|---|---|---|---|---|",
    ]
    lines += [f"| {name} | " + " | ".join(f"{n:,}" for n in numbers) + " |" for name, *numbers in rows]
    return "\n".join(lines)


def test_every_public_callable_is_called():
    """What is public is found by introspection, with its parameters; each is in the table of calls, and no other."""
    public = {name: set(parameters) for name, parameters in border.public_callables()}
    called = {name: set(call.arguments) for name, call in border.CALLS.items()}
    missing = {name: parameters - called.get(name, set()) for name, parameters in public.items()}
    assert not {name: parameters for name, parameters in missing.items() if parameters or name not in called}
    assert set(called) <= set(public)
    assert not {name: p - public[name] for name, p in called.items() if p - public[name]}


@pytest.mark.parametrize("every", quick(6, 1))
def test_some_bad_arguments(every):
    """A sample of the calls below: of callables the right arguments, and of parameters one bad value each."""
    chosen = []
    groups = itertools.groupby(cases(), key=lambda case: case[:2])
    for _, group in itertools.islice(groups, 0, None, every):
        values = list(group)
        chosen.append(random.Random(str(values[0][:2])).choice(values))
    short = [case for case in chosen if case.call not in SLOW]
    assert not driver.faults(outcomes(short))


@pytest.mark.fuzz
def test_all_bad_arguments():
    """Refused by a child of LoewnerError, answered rightly or with a documented warning: no case is anything else."""
    found = outcomes(cases())
    print("\n" + table(found).splitlines()[-1])
    assert not driver.faults(found, most=50)


def _write() -> None:
    path = Path(__file__).parent.parent.parent / "docs" / "verification.md"
    begin, end = "<!-- border: begin -->\n", "<!-- border: end -->"
    found = outcomes(cases())
    before, rest = path.read_text().split(begin)
    path.write_text(before + begin + table(found) + "\n" + end + rest.split(end)[1])
    print(driver.faults(found, most=1000) or table(found).splitlines()[-1])


if __name__ == "__main__":
    _write()
