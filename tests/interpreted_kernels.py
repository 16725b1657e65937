"""Kernels run by Python, with one lane that is a float, so that a change to their source takes no compilation."""

import builtins
import types

import numpy as np

from loewner._kernels._sources import sources

INTERPRETED = {"linalg3", "robots.kinematics", "robots.reach", "robots.lines"}
PREFIX = "loewner._kernels."

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


def source_of(name):
    """The text of a module of kernels, which a wheel has in an archive."""
    return sources()[name.replace(".", "/") + ".py"].decode()


def interpreted(name, text=None):
    """A module of kernels as functions of Python, from its own text or a changed one."""
    module = types.ModuleType(PREFIX + name)
    module.__dict__["__builtins__"] = vars(builtins) | {"__import__": _imported}
    exec(compile(text or source_of(name), name, "exec"), module.__dict__)
    return module


def _imported(name, globals=None, locals=None, fromlist=(), level=0):
    kernel = name.removeprefix(PREFIX)
    if kernel in INTERPRETED:
        return interpreted(kernel)
    if kernel not in STAND_INS:
        return __import__(name, globals, locals, fromlist, level)
    module = types.ModuleType(name)
    module.__dict__.update(dict.fromkeys(fromlist), **STAND_INS[kernel])
    return module
