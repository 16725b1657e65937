"""Kernels run by Python, with one lane that is a float, so that a change to their source takes no compilation.

With ``LOEWNER_TRACE=1`` in the environment, they print each exit from a loop or a function, with its condition.
"""

import builtins
import functools
import os
import sys
import types

import numpy as np

from loewner._kernels._sources import sources

INTERPRETED = {"linalg3", "narrow.simplex", "robots.kinematics", "robots.reach", "robots.lines"}
PREFIX = "loewner._kernels."
LINES = {}  # of the text of each interpreted module

STAND_INS = {
    "_jit": {
        "njit": lambda **options: lambda function: function,
        "inline": lambda function: function,
        "apart": lambda function: function,
        "borrowed": lambda array: array,
    },
    "simd.trig": {"sine_cosine": lambda x: (np.sin(x), np.cos(x))},
    "simd.vectors": {
        "LANES": 1,
        "ALL": 1,
        "absolute": abs,
        "broadcast": float,
        "load": lambda array, at: float(array[at]),
        "store": lambda array, at, x: array.__setitem__(at, x),
        "maximum": max,
        "minimum": min,
        "select": lambda condition, x, y: x if condition else y,
        "sqrt": lambda x: float(np.sqrt(x)),
    },
}


texts = functools.cache(sources)
code_of = functools.cache(compile)


def source_of(name):
    """The text of a module of kernels, which a wheel has in an archive."""
    return texts()[name.replace(".", "/") + ".py"].decode()


def interpreted(name, text=None):
    """A module of kernels as functions of Python, from its own text or a changed one."""
    module = types.ModuleType(PREFIX + name)
    module.__dict__["__builtins__"] = vars(builtins) | {"__import__": _imported}
    text = text or source_of(name)
    LINES[name] = text.splitlines()
    exec(code_of(text, name, "exec"), module.__dict__)
    if os.environ.get("LOEWNER_TRACE"):
        sys.settrace(tracing(print))
    return module


def tracing(write):
    """A function for `sys.settrace` that writes where interpreted kernels leave loops or return early, and why."""

    def trace(frame, event, _):
        file, number = frame.f_code.co_filename, frame.f_lineno
        if file not in LINES:
            return None
        line = LINES[file][number - 1]
        if event == "line" and line.split()[0] in ("break", "return"):
            above = [text.split() for text in LINES[file][: number - 1] if text.strip() and _depth(text) < _depth(line)]
            values = {name: frame.f_locals[name] for name in ("r", "k", "status") if name in frame.f_locals}
            if above[-1][0] != "def":
                write(f"{file}:{number} {frame.f_code.co_name} {values}: {' '.join(above[-1])} {line.strip()}")
        return trace

    return trace


def _depth(text):
    return len(text) - len(text.lstrip())


def _imported(name, globals=None, locals=None, fromlist=(), level=0):
    kernel = name.removeprefix(PREFIX)
    if kernel in INTERPRETED:
        return interpreted(kernel)
    if kernel not in STAND_INS:
        return __import__(name, globals, locals, fromlist, level)
    module = types.ModuleType(name)
    module.__dict__.update(dict.fromkeys(fromlist), **STAND_INS[kernel])
    return module
