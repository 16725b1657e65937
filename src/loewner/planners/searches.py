"""Define `Search`, the search options of all functions that plan, and find OMPL's planners by name."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from loewner._base import _validate
from loewner.errors import InputError, imported

# A number of iterations that no search reaches.
UNLIMITED = 2**40

# Options that select plans with a different search, and the reason why options of other searches do not apply.
OF_ITS_OWN = {"start_time": "plans in time are proven and shortened", "base": "drives are proven"}


@dataclass(frozen=True)
class Search:
    """Options for the searches of `plan`, `plan_full`, `plan_in_time` and `plan_drive`.

    Parameters
    ----------
    planner : str or callable, optional
        The name of a class of ``ompl.geometric``, such as "BITstar" or "PRM". Alternatively, a function that takes the
        ``SpaceInformation`` and returns an OMPL planner that you have set up. Default: the compiled RRT-Connect.
    certified : bool
        If true, prove every motion free with `CollisionChecker.certify_edges`; otherwise, sample motions in steps.
    resolution : float
        Largest Euclidean distance between two successive samples of a motion that is not proven, in the units of the
        joints. OMPL planners that divide motions themselves always use this resolution.
    max_iterations : int, optional
        Maximum number of random configurations that the compiled planner tries or, for a drive, of poses from which the
        search continues. Default: no limit except the timeout.
    timeout : float
        Time limit of the search, in seconds. OMPL planners that seek a shortest path always use all of this time.
        Simplifying takes additional time.
    simplify : bool
        Shorten the path. Paths of OMPL planners are also smoothed by OMPL's path simplifier.

    Raises
    ------
    InputError
        If a value is wrong.
    UnknownNameError
        If OMPL has no such planner.
    MissingExtraError
        If an OMPL planner is requested but OMPL is not installed.

    Examples
    --------
    >>> from loewner import CollisionChecker, Robot
    >>> from loewner.planners import Search, plan
    >>> quick = Search(max_iterations=1000, timeout=0.5)
    >>> plan(CollisionChecker(Robot.from_urdf("arm.urdf")), [0.0, 0.0], [2.0, 0.0], joints="rail", search=quick)
    array([[0., 0.],
           [2., 0.]])
    """

    planner: str | Callable[[Any], Any] | None = None
    certified: bool = True
    resolution: float = 0.05
    max_iterations: int | None = None
    timeout: float = 10.0
    simplify: bool = True

    def __post_init__(self) -> None:
        numbers, flags = ("resolution", "timeout"), ("simplify", "certified")
        checked: dict[str, float] = {name: _validate.positive_scalar(getattr(self, name), name) for name in numbers}
        checked |= {name: _validate.flag(getattr(self, name), name) for name in flags}
        if self.max_iterations is not None:
            most = _validate.whole_number(self.max_iterations, "max_iterations", 1, UNLIMITED)
            checked["max_iterations"] = most
        if self.planner is not None:
            named(self.planner)
        for name, value in checked.items():
            object.__setattr__(self, name, value)

    @property
    def _step(self) -> float:
        """Distance between samples of a motion, or 0 if motions are proven."""
        return 0.0 if self.certified else self.resolution

    @property
    def _most(self) -> int:
        """Number of iterations."""
        return UNLIMITED if self.max_iterations is None else self.max_iterations

    def _refuse(self, name: str, others: Sequence[str] = ()) -> None:
        """If an option selects another kind of plan, refuse options that apply only to paths."""
        refused = ["planner"] * (self.planner is not None) + ["certified=False"] * (not self.certified) + [*others]
        if refused:
            raise InputError(
                f"{name}: expected no {' or '.join(refused)} with it; {OF_ITS_OWN[name]}, by their own search"
            )


def checked_search(search: Search | None) -> Search:
    """Check the argument `search`."""
    return _validate.instance(Search() if search is None else search, "search", Search, "planners")


def checked_seed(seed: int) -> int:
    """Check the argument `seed`."""
    return _validate.whole_number(seed, "seed", 0, 2**32 - 2)


def named(planner: str | Callable[[Any], Any] | None) -> Callable[[Any], Any]:
    """Return a function that makes the planner of this name."""
    if callable(planner):
        return planner
    base, geometric = ompl("base"), ompl("geometric")
    planners = {
        name: each
        for name, each in sorted(vars(geometric).items())
        if isinstance(each, type) and issubclass(each, base.Planner)
    }
    factory: Callable[[Any], Any] = planners[_validate.known(planner, "planner", planners)]
    return factory


def ompl(part: str) -> Any:
    """Import a part of OMPL."""
    return [imported(name, "planners need OMPL", "planners") for name in ("ompl", f"ompl.{part}")][-1]
