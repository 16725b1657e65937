"""Every error `loewner` raises on purpose, each a child of `LoewnerError`.

Each also derives from the built-in exception a caller would expect, so that
``except ValueError`` keeps working for people who never heard of this module.
"""


class LoewnerError(Exception):
    """Base of all errors raised by `loewner`."""


class InputError(LoewnerError, ValueError):
    """An argument has the wrong shape, type or value."""


class GeometryError(InputError):
    """The geometry is empty, flat, unbounded or too small to carry an ellipsoid."""


class PoseError(InputError):
    """A pose does not end in (4, 4), is not a rigid motion, or does not broadcast."""


class ConvergenceError(LoewnerError, ArithmeticError):
    """An iteration did not reach its certificate; nothing is returned instead of a guess."""


class PlanningError(LoewnerError, RuntimeError):
    """No motion can be given: start or goal is not free, or no path was found; the message says which and why."""


class FileError(LoewnerError, OSError):
    """A file is missing, empty, truncated, of the wrong kind, or could not be written."""


class UnknownNameError(LoewnerError, KeyError):
    """A name (link, joint, body, rule) is not known; the message lists the valid ones."""

    def __str__(self) -> str:
        # KeyError prints the repr of its argument; a message for people is a plain sentence.
        return str(self.args[0]) if self.args else ""


class BodyIndexError(LoewnerError, IndexError):
    """There is no body of this number."""


class MissingExtraError(LoewnerError, ImportError):
    """An optional package is needed; the message names the extra to install."""
