"""Draw bodies, pairs of bodies, robots in scenes, and statistics of queries, with matplotlib.

matplotlib is imported only when a function here is called: ``pip install "loewner[plots]"``.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from loewner._base import _validate
from loewner._base._files import replacing
from loewner._base._proportions import wilson
from loewner._base._validate import Bools, Floats
from loewner.bodies import Body, packed_of
from loewner.bodies.triangulated import of_pieces
from loewner.errors import FileError, InputError, imported
from loewner.meshes.triangles import halved, longest_edges
from loewner.queries.pairs import Verdict, classify, collide, distance
from loewner.robots import ClosestApproach, CollisionChecker, Robot, Settled
from loewner.robots.description.robot import first_shown
from loewner.robots.proofs import approaches, curves
from loewner.robots.proofs.courses import configurations

COLOURS = ("#4477aa", "#cc6677")
INNER, OUTER = "#228833", "#777777"
NEAR = "#111111"
SCENE, COLLIDING = "#bbbbbb", "#cc3311"
# Legend and background colour of the pieces of a trajectory that are not proven free.
SPANS = {
    Verdict.COLLIDING: ("collides in this piece", "#f9ddd4"),
    Verdict.AMBIGUOUS: ("ambiguous in this piece", "#e4e4e4"),
}

# For pictures of covers: SMALL is the size of a link's largest triangle, as a share of the link's diagonal, and POINT
# is the radius of a point [m].
SMALL, POINT = 0.03, 1e-9

# Colours and markers of successive curves; the colours also differ in lightness.
CURVES = (("#0072b2", "o"), ("#d55e00", "s"), ("#009e73", "D"), ("#cc79a7", "^"), ("#e69f00", "v"), ("#000000", "P"))
LEVEL = "#555555"

# Number of nearest pairs whose distances are drawn along a curve.
MOST_PAIRS = 6

# Label and colour of each field of `Settled`: blue for free, orange for colliding, and darker for costlier tests.
TIERS = {
    "free_by_bounds": ("free: bounds", "#d6e9f5"),
    "free_by_ellipsoids": ("free: outer ellipsoids", "#8fc3e3"),
    "free_by_planes": ("free: planes", "#3a94cb"),
    "free_by_search": ("free: exact search", "#004c78"),
    "colliding_by_ellipsoids": ("colliding: inner ellipsoids", "#f3b58a"),
    "colliding_by_search": ("colliding: exact search", "#b04a00"),
}


def body(
    body: Body,
    T_world_body: ArrayLike | None = None,
    *,
    ax: Any = None,
    colour: str = COLOURS[0],
    ellipsoids: bool = True,
) -> Any:
    """Draw a body: its pieces and, as wire frames, the inner and outer ellipsoid of each piece.

    Parameters
    ----------
    body : Body
        Curved pieces, such as cylinders and cones, are represented by their ellipsoids.
    T_world_body : array_like, shape (4, 4), optional
        Pose; translation in metres. None is the identity.
    ax : matplotlib 3-D axes, optional
        Axes to draw into; a new figure by default.
    colour : str
    ellipsoids : bool
        Also draw the ellipsoids.

    Returns
    -------
    matplotlib 3-D axes

    Raises
    ------
    InputError
        If `body` is not a body, or the pose does not have shape (4, 4); PoseError if the pose is not a rigid motion.
    MissingExtraError
        If matplotlib is not installed.

    Examples
    --------
    >>> from loewner import Body, plots
    >>> ax = plots.body(Body.cone(radius=0.1, length=0.3))
    >>> ax.get_xlabel()
    'x, m'
    """
    _validate.instance(body, "body", Body)
    T, ellipsoids = _validate.pose(T_world_body, "T_world_body"), _validate.flag(ellipsoids, "ellipsoids")
    ax = _axes(ax)
    _draw(ax, body, T, _colour(colour), ellipsoids)
    _frame(ax, _corners(body, T))
    return ax


def pair(
    a: Body,
    T_world_a: ArrayLike | None,
    b: Body,
    T_world_b: ArrayLike | None,
    *,
    ax: Any = None,
    ellipsoids: bool = True,
    near: bool = True,
) -> Any:
    """Draw two bodies with their ellipsoids; the title is the certified verdict and, if AMBIGUOUS, the exact answer.

    Parameters
    ----------
    a, b : Body
    T_world_a, T_world_b : array_like, shape (4, 4), or None
        Poses; translation in metres. None is the identity.
    ax : matplotlib 3-D axes, optional
    ellipsoids : bool
    near : bool
        Also draw the near points, or the ends of the penetration depth, and the line that joins them.

    Returns
    -------
    matplotlib 3-D axes

    Raises
    ------
    InputError
        As for `body`.
    ConvergenceError
        If the near points could not be settled.
    MissingExtraError
        If matplotlib is not installed.

    Examples
    --------
    >>> from loewner import Body, plots
    >>> T = np.eye(4)
    >>> T[0, 3] = 1.2
    >>> ax = plots.pair(Body.box([1, 1, 1]), None, Body.box([1, 1, 1]), T)
    >>> ax.get_title()
    'AMBIGUOUS, exact: free'
    """
    for operand, name in ((a, "a"), (b, "b")):
        _validate.instance(operand, name, Body)
    Ta, Tb = _validate.pose(T_world_a, "T_world_a"), _validate.pose(T_world_b, "T_world_b")
    ellipsoids, near = _validate.flag(ellipsoids, "ellipsoids"), _validate.flag(near, "near")
    ax = _axes(ax)
    _draw(ax, a, Ta, COLOURS[0], ellipsoids)
    _draw(ax, b, Tb, COLOURS[1], ellipsoids)
    _frame(ax, np.concatenate([_corners(a, Ta), _corners(b, Tb)]))
    # View perpendicular to the line between the two bodies, so that neither hides the other.
    way = _corners(b, Tb).mean(axis=0) - _corners(a, Ta).mean(axis=0)
    ax.view_init(elev=15, azim=np.degrees(np.arctan2(way[1], way[0])) - 90)
    verdict = Verdict(int(classify(a, Ta, b, Tb)))
    title = verdict.name
    if verdict == Verdict.AMBIGUOUS:
        title += ", exact: " + ("colliding" if collide(a, Ta, b, Tb) else "free")
    ax.set_title(title)
    entries = [("a", COLOURS[0]), ("b", COLOURS[1])] + ([("inner", INNER), ("outer", OUTER)] if ellipsoids else [])
    if near:
        gap = distance(a, Ta, b, Tb, exact=True)
        ax.plot(*np.array([gap.witness_a, gap.witness_b]).T, color=NEAR, marker="o", markersize=4, zorder=10)
        what = "distance" if gap.distance >= 0 else "depth"
        entries.append((f"{what} {abs(gap.distance):.4g} m", NEAR))
    _legend(ax, entries)
    return ax


def configuration(checker: CollisionChecker, q: ArrayLike, *, ax: Any = None) -> Any:
    """Draw a robot in its scene, with colliding bodies in red and the number of colliding pairs in the title.

    Parameters
    ----------
    checker : CollisionChecker
    q : array_like, shape (dof,)
        Entries as in `Robot.configuration_names`, in radians and metres.
    ax : matplotlib 3-D axes, optional

    Returns
    -------
    matplotlib 3-D axes

    Raises
    ------
    InputError
        If `checker` is not a checker, or `q` is invalid, as for `CollisionChecker.collide`.
    MissingExtraError
        If matplotlib is not installed.

    Examples
    --------
    >>> from loewner import CollisionChecker, Robot, plots
    >>> plots.configuration(CollisionChecker(Robot.from_urdf("arm.urdf")), [0.5, 0.0]).get_title()
    'free'
    """
    _validate.instance(checker, "checker", CollisionChecker)
    robot, scene = checker.robot, checker.scene
    q = robot.checked_one(q)
    meeting = [pair for pair, meets in zip(checker.checked_pairs, checker.collide_by_pair(q), strict=True) if meets]
    touching = {name for pair in meeting for name in pair}
    poses = dict(zip(robot.link_names, robot.forward_kinematics(q), strict=True))
    drawn = [(name, body, poses[name], COLOURS[0]) for name, body in robot.bodies.items()]
    drawn += [
        (name, scene[name], poses[held.link] @ held.T_link_body, COLOURS[0]) for name, held in scene.attachments.items()
    ]
    drawn += [(name, scene[name], scene.pose(name), SCENE) for name in scene.static_names]
    ax = _axes(ax)
    for name, body, T, colour in drawn:
        curved = any(piece.triangles is None for piece in body.pieces)
        _draw(ax, body, T, COLLIDING if name in touching else colour, curved)
    _frame(ax, np.concatenate([_corners(body, T) for _, body, T, _ in drawn]))
    pairs = "1 pair" if len(meeting) == 1 else f"{len(meeting)} pairs"
    ax.set_title(f"colliding, {pairs}" if meeting else "free")
    return ax


def cover(robot: Robot, model: Robot, q: ArrayLike | None = None, *, ax: Any = None) -> Any:
    """Draw a robot with the shapes that should contain its links; parts of links outside their shapes are red.

    The triangles are at most 3 % as large as their link, and each has one colour, so the picture may miss smaller
    holes. `Robot.covered_by` proves whether there are holes.

    Parameters
    ----------
    robot : Robot
    model : Robot
        A robot whose links have the same names, for instance from `Robot.with_cover`.
    q : array_like, shape (dof,), optional
        The configuration. By default, the robot's state that sets the most joints (zero for all joints if there are no
        states), moved into the limits.
    ax : matplotlib 3-D axes, optional

    Returns
    -------
    matplotlib 3-D axes

    Raises
    ------
    InputError
        If `robot` or `model` is not a robot, the robot has no bodies, or `q` is invalid, as for
        `CollisionChecker.collide`.
    MissingExtraError
        If matplotlib is not installed.

    Examples
    --------
    >>> from loewner import Robot, plots
    >>> robot = Robot.from_urdf("arm.urdf")
    >>> plots.cover(robot, robot.cover("boxes", protrusion=0.05)).get_title()
    'arm: no part of 3 links is outside'
    """
    for name, operand in (("robot", robot), ("model", model)):
        _validate.instance(operand, name, Robot)
    if not robot.bodies:
        raise InputError("robot: expected one with bodies, found one without")
    q = first_shown(robot)[1] if q is None else robot.checked_one(q)
    poses = dict(zip(robot.link_names, robot.forward_kinematics(q), strict=True))
    ax, outside, framed = _axes(ax), 0, []
    for link, body in robot.bodies.items():
        triangles = _small_triangles(body)
        hidden = _inside(triangles.mean(axis=1), model.bodies.get(link))
        outside += not hidden.all()
        placed = triangles @ poses[link][:3, :3].T + poses[link][:3, 3]
        for these, colour in ((hidden, SCENE), (~hidden, COLLIDING)):
            if these.any():
                _add_triangles(ax, placed[these], colour, 0.9)
        if link in model.bodies:
            _draw_outlines(ax, model.bodies[link], poses[link])
        framed.append(_corners(body, poses[link]))
    _frame(ax, np.concatenate(framed))
    _legend(ax, [("covered", SCENE), ("outside of all shapes", COLLIDING), ("shapes", COLOURS[0])])
    parts = f"parts of {outside}" if outside else "no part"
    ax.set_title(f"{robot.name}: {parts} of {len(robot.bodies)} links {'are' if outside else 'is'} outside")
    return ax


def _small_triangles(body: Body) -> Floats:
    """Return the triangles of a body, shape (n, 3, 3), divided until they are small relative to the body."""
    triangles = np.concatenate([vertices[corners] for vertices, corners in of_pieces(packed_of(body))])
    limit = float(np.linalg.norm(np.ptp(triangles.reshape(-1, 3), axis=0))) * SMALL
    small = []
    while len(triangles):
        length, edge = longest_edges(triangles)
        small.append(triangles[length <= limit])
        triangles = halved(triangles[length > limit], edge[length > limit])
    return np.concatenate(small)


def _inside(points: Floats, model: Body | None) -> Bools:
    """Return which points are in a body, up to the size of a point."""
    if model is None:
        return np.zeros(len(points), dtype=bool)
    T = np.tile(np.eye(4), (len(points), 1, 1))
    T[:, :3, 3] = points
    return np.asarray(collide(Body.sphere(POINT), T, model, None))


def _draw_outlines(ax: Any, body: Body, T: Floats) -> None:
    """Draw spheres and ellipsoids as circles, and other pieces as their triangles."""
    moved = body.outer.transformed(T)
    for k, (piece, (vertices, corners)) in enumerate(zip(body.pieces, of_pieces(packed_of(body)), strict=True)):
        if piece.kind in ("sphere", "ellipsoid"):
            _add_wires(ax, moved.center[k], moved.factor[k], colors=COLOURS[0], linewidths=0.3, alpha=0.5)
        else:
            _add_triangles(ax, (vertices @ T[:3, :3].T + T[:3, 3])[corners], COLOURS[0], 0.1)


def _add_wires(ax: Any, center: Floats, factor: Floats, **look: Any) -> None:
    from mpl_toolkits.mplot3d.art3d import Line3DCollection

    ax.add_collection3d(Line3DCollection(center + _WIRES @ factor.T, **look))


def _add_triangles(ax: Any, corners: Floats, colour: str, alpha: float) -> None:
    from mpl_toolkits.mplot3d.art3d import Poly3DCollection

    ax.add_collection3d(Poly3DCollection(corners, facecolors=colour, linewidths=0, alpha=alpha, shade=True))


def trajectory(checker: CollisionChecker, curve: Any, *, joint_error: ArrayLike = 0.0, ax: Any = None) -> Any:
    """Draw the distances of the nearest pairs along a curve; mark the least distance and the parts not proven free.

    A line shows the distance between two bodies in millimetres, measured at equal steps in time; a negative distance is
    a depth. Lines are drawn for the nearest pairs, and for each pair that stopped the proof of a piece of the curve. A
    coloured background marks each piece in which a pair collides or is ambiguous. A dot marks the least measured
    distance.

    Parameters
    ----------
    checker : CollisionChecker
    curve : PPoly, BPoly, BSpline, planners.Trajectory, planners.ControllerPoints, or ndarray, shape (k, dof)
        A curve, as for `CollisionChecker.certify_trajectory`, or a path, as for `CollisionChecker.certify_edges`. A
        path has no times and is drawn over the indices of its configurations.
    joint_error : float or array_like, shape (dof,)
        As for `CollisionChecker.certify_trajectory`, in radians or metres.
    ax : matplotlib axes, optional
        Axes to draw into; a new figure by default.

    Returns
    -------
    matplotlib axes
        The axes, titled with the verdict of the whole curve. The vertical axis ends slightly above the largest distance
        that the nearest pair has at any time.

    Raises
    ------
    InputError
        If `checker` is not a checker; otherwise as for `CollisionChecker.certify_trajectory`, or for
        `CollisionChecker.certify_edges` if the curve is a path.
    ConvergenceError
        As for `CollisionChecker.distance`.
    MissingExtraError
        If matplotlib is not installed.

    Examples
    --------
    >>> from loewner import CollisionChecker, Robot, Scene, planners, plots
    >>> scene = Scene()
    >>> scene.add("post", Body.box([0.2, 0.2, 0.2]), [[1, 0, 0, 1], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
    >>> checker = CollisionChecker(Robot.from_urdf("arm.urdf"), scene)
    >>> points = planners.ControllerPoints([0.0, 1.0, 2.0], [[0.0, 1.57], [1.0, 1.57], [0.0, 1.57]])
    >>> ax = plots.trajectory(checker, points)
    >>> ax.get_title(), ax.get_lines()[0].get_label(), ax.get_lines()[-2].get_label()  # doctest: +ELLIPSIS
    ('COLLIDING', 'cart and post', '200 mm deep at ... s')
    """
    _validate.instance(checker, "checker", CollisionChecker)
    courses, certified = curves.proven(checker, curve, joint_error)
    ticks, _, Q = curves.sampled(checker.robot, courses, certified)
    near = None
    if checker.checked_pairs:
        near = approaches.along(checker, courses, np.flatnonzero(certified.segments.verdict != Verdict.FREE)).near
        k = near.nearest
        share = (near.time[k] - certified.times[k]) / (certified.times[k + 1] - certified.times[k])
        q = configurations(checker.robot, courses.courses[k : k + 1], np.array([share]).clip(0.0, 1.0))
        ticks, Q = np.append(ticks, near.time[k]), np.concatenate([Q, q])
    order = np.argsort(ticks, kind="stable")
    ticks, Q = ticks[order], Q[order]
    ax = _flat_axes(ax)
    for verdict, (label, colour) in SPANS.items():
        for k in np.flatnonzero(certified.segments.verdict == verdict).tolist():
            ax.axvspan(certified.times[k], certified.times[k + 1], color=colour, linewidth=0, label=label)
            label = "_"  # so that the legend names the colour only once
    if near is not None:
        _draw_distances(ax, checker, (ticks, Q), certified, near, "" if isinstance(curve, np.ndarray) else " s")
    ax.axhline(0.0, color=LEVEL, linewidth=0.8)
    ax.set(xlim=(certified.times[0], certified.times[-1]), ylabel="distance, mm", title=certified.verdict.name)
    ax.set_xlabel("number of the configuration" if isinstance(curve, np.ndarray) else "time, s")
    ax.legend(loc="upper center", bbox_to_anchor=(0.5, -0.15), ncols=2, fontsize="small", frameon=False)
    return ax


def _draw_distances(
    ax: Any, checker: CollisionChecker, samples: tuple[Floats, Floats], found: Any, near: ClosestApproach, unit: str
) -> None:
    """Draw the distances of the nearest pairs and of all pairs that are not proven free; mark the least distance."""
    ticks, Q = samples
    nearest = checker.distance(Q, ticks, exact=True).distance
    top = 1.05 * max(float(nearest.max()), 0.0) + 1e-3
    by_pair = checker.distance_by_pair(Q, ticks, within=top)
    distances: dict[tuple[str, ...], Floats] = {}
    for names, k, found_there in zip(by_pair.names.tolist(), by_pair.configuration, by_pair.distance, strict=True):
        distances.setdefault(tuple(names), np.full(len(ticks), np.nan))[k] = found_there
    unproven = {tuple(names) for names in found.segments.names.tolist()}
    ranked = sorted(distances, key=lambda names: float(np.nanmin(distances[names])))
    shown = [names for number, names in enumerate(ranked) if number < MOST_PAIRS or names in unproven]
    for number, names in enumerate(shown):
        ax.plot(ticks, 1e3 * distances[names], color=f"C{number}", linewidth=1.2, label=" and ".join(names))
    least, t = 1e3 * float(near.distance[near.nearest]), float(near.time[near.nearest])
    label = f"{abs(least):.3g} mm {'deep' if least < 0 else 'apart'} at {t:.6g}{unit}"
    ax.plot(t, least, "o", color=NEAR, markersize=6, label=label)
    low = min(least, 0.0)
    ax.set_ylim(low - 0.05 * (1e3 * top - low), 1e3 * top)


def tiers(counts: Mapping[str, Settled | Mapping[str, int]], *, ax: Any = None) -> Any:
    """Draw each test's share of the answers: one bar per group, with parts from the cheapest test to the costliest.

    Parameters
    ----------
    counts : mapping of str to Settled, or to mapping of str to int
        For each group, either the result of `CollisionChecker.tiers`, or your own counts (of pairs, for instance),
        keyed by the field names of `Settled`; omitted fields count as 0.
    ax : matplotlib axes, optional
        Axes to draw into; a new figure by default.

    Returns
    -------
    matplotlib axes
        The axes; shares are in percent of each group.

    Raises
    ------
    InputError
        If there is no group, or if a group has no counts, a negative count, or only zeros; UnknownNameError if a tier
        is not a field of `Settled`.
    MissingExtraError
        If matplotlib is not installed.

    Examples
    --------
    For a robot, and for pairs of bodies:

    >>> import loewner
    >>> from loewner import CollisionChecker, Robot, Verdict, plots
    >>> robot = Robot.from_urdf("arm.urdf")
    >>> ax = plots.tiers({"arm": CollisionChecker(robot).tiers(robot.random_configurations(100))})
    >>> poses = np.tile(np.eye(4), (100, 1, 1))
    >>> poses[:, 0, 3] = np.linspace(0.0, 2.5, 100)
    >>> cube = loewner.Body.box([1, 1, 1])
    >>> verdicts, colliding = (ask(cube, None, cube, poses) for ask in (loewner.classify, loewner.collide))
    >>> counts = {
    ...     "free_by_ellipsoids": (verdicts == Verdict.FREE).sum(),
    ...     "free_by_search": ((verdicts == Verdict.AMBIGUOUS) & ~colliding).sum(),
    ...     "colliding_by_ellipsoids": (verdicts == Verdict.COLLIDING).sum(),
    ...     "colliding_by_search": ((verdicts == Verdict.AMBIGUOUS) & colliding).sum(),
    ... }
    >>> ax = plots.tiers({"two cubes": counts})
    >>> [group.get_text() for group in ax.get_yticklabels()]
    ['two cubes']
    """
    groups = {str(name): _tiers_of(group, name) for name, group in _named(counts, "counts").items()}
    total = np.array([sum(group.values()) for group in groups.values()])
    ax = _flat_axes(ax)
    left = np.zeros(len(groups))
    for tier in [tier for tier in TIERS if any(tier in group for group in groups.values())]:
        share = np.array([group.get(tier, 0) for group in groups.values()]) * 100 / total
        label, colour = TIERS[tier]
        ax.barh(list(groups), share, left=left, color=colour, label=label)
        left += share
    ax.set(xlim=(0, 100), xlabel="%", ylim=(len(groups) - 0.5, -0.5))  # puts the first group on top
    ax.legend(loc="upper center", bbox_to_anchor=(0.5, -0.15), ncols=2, fontsize="small", frameon=False)
    return ax


def costs(
    sizes: ArrayLike, seconds: Mapping[str, ArrayLike], *, size: str = "vertices", item: str = "pair", ax: Any = None
) -> Any:
    """Draw the cost per item against a size, such as vertices per hull or pairs per call, on logarithmic axes.

    Parameters
    ----------
    sizes : array_like, shape (k,)
        Positive numbers; lines join the points in this order.
    seconds : mapping of str to array_like, shape (k,) or ()
        Times per item in seconds, keyed by their label in the legend; NaN where a time was not measured. A single
        number is drawn as a dashed horizontal line; it represents a time that does not depend on the size.
    size, item : str
        Names of the size and of the item, for the labels of the axes.
    ax : matplotlib axes, optional
        Axes to draw into; a new figure by default.

    Returns
    -------
    matplotlib axes

    Raises
    ------
    InputError
        If there are no sizes or no times, if the number of times differs from the number of sizes, or if a value is not
        above zero.
    MissingExtraError
        If matplotlib is not installed.

    Examples
    --------
    >>> from loewner import plots
    >>> ax = plots.costs([8, 20, 8000], {"ours": [50e-9, 51e-9, np.nan], "theirs": 600e-9})
    >>> [text.get_text() for text in ax.get_legend().get_texts()]
    ['ours', 'theirs']
    """
    x = _validate.positive_array(sizes, "sizes", (None,))
    if len(x) == 0:
        raise InputError("sizes: expected one or more, found none")
    curves = {name: _times(times, name, len(x)) for name, times in _named(seconds, "seconds").items()}
    _expect_text(size, "size")
    _expect_text(item, "item")
    ax = _flat_axes(ax)
    from matplotlib.ticker import EngFormatter

    styles = 0
    with np.errstate(over="ignore"):  # near the largest floats the axis ends at infinity
        for name, times in curves.items():
            if times.ndim == 0:
                ax.axhline(float(times), color=LEVEL, linestyle="--", label=name)
                continue
            colour, marker = CURVES[styles % len(CURVES)]
            ax.plot(x, times, color=colour, marker=marker, markersize=4, label=name)
            styles += 1
        ax.set(xscale="log", yscale="log", xlabel=size, ylabel=f"time per {item}")
        ax.yaxis.set_major_formatter(EngFormatter("s"))
        ax.grid(alpha=0.3)
        ax.legend(frameon=False)
    return ax


def accuracy(counts: Mapping[str, Mapping[str, tuple[int, int]]], *, ax: Any = None) -> Any:
    """Draw how often rules were right, by family of shapes, with 95 % confidence intervals (Wilson's score).

    Parameters
    ----------
    counts : mapping of str to mapping of str to (int, int)
        For each rule and each family, the number of right answers and the total number of answers.
    ax : matplotlib axes, optional
        Axes to draw into; a new figure by default.

    Returns
    -------
    matplotlib axes
        The axes, with families from top to bottom; each family has a line and a dot for every rule with answers.

    Raises
    ------
    InputError
        If there is no rule or no family, or a pair of numbers does not satisfy 0 <= right <= total.
    MissingExtraError
        If matplotlib is not installed.

    References
    ----------
    Wilson (1927), doi:10.1080/01621459.1927.10502953.

    Examples
    --------
    How often the default estimate is right about ambiguous pairs of cubes:

    >>> import loewner
    >>> from loewner import Body, Verdict, plots
    >>> cube, poses = Body.box([1, 1, 1]), np.tile(np.eye(4), (100, 1, 1))
    >>> poses[:, 0, 3] = np.linspace(0.8, 1.4, 100)
    >>> unsure = poses[loewner.classify(cube, None, cube, poses) == Verdict.AMBIGUOUS]
    >>> guessed = loewner.collide(cube, None, cube, unsure, method="estimate")
    >>> right = int((guessed == loewner.collide(cube, None, cube, unsure)).sum())
    >>> ax = plots.accuracy({"contact-product": {"cubes": (right, len(unsure))}})
    >>> ax.get_xlabel()
    'right, %'
    """
    checked = {
        str(rule): {
            str(name): _counted(pair, f"counts[{rule!r}][{name!r}]")
            for name, pair in _named(by_family, f"counts[{rule!r}]").items()
        }
        for rule, by_family in _named(counts, "counts").items()
    }
    families = list(dict.fromkeys(name for by_family in checked.values() for name in by_family))
    ax = _flat_axes(ax)
    for k, (rule, by_family) in enumerate(checked.items()):
        answered = {name: pair for name, pair in by_family.items() if pair[1] > 0}
        share = np.array([right / total for right, total in answered.values()])
        low, high = np.array([wilson(*pair) for pair in answered.values()]).reshape(-1, 2).T
        # The marks of a family's rules are side by side in half of the family's space.
        at = np.array([families.index(name) for name in answered]) + 0.5 * ((k + 0.5) / len(checked) - 0.5)
        colour, marker = CURVES[k % len(CURVES)]
        ends = 100 * np.array([share - low, high - share])
        ax.errorbar(
            100 * share, at, xerr=ends, fmt=marker, color=colour, markersize=4, capsize=2, linewidth=1, label=rule
        )
    ax.set_yticks(range(len(families)), families)
    ax.set(xlabel="right, %", ylim=(len(families) - 0.5, -0.5))
    ax.grid(axis="x", alpha=0.3)
    ax.legend(loc="upper center", bbox_to_anchor=(0.5, -0.15), ncols=2, fontsize="small", frameon=False)
    return ax


def save(figure: Any, path: str | os.PathLike[str]) -> Path:
    """Write a figure, or the figure of given axes, atomically; the same figure always gives the same bytes.

    Parameters
    ----------
    figure : matplotlib figure or axes
    path : str or path
        The extension, such as .png, .svg or .pdf, determines the format.

    Returns
    -------
    pathlib.Path
        The path of the written file.

    Raises
    ------
    InputError
        If `figure` is not a figure or axes, or `path` is not a path.
    FileError
        If the file cannot be written.

    Examples
    --------
    >>> from loewner import Body, plots
    >>> plots.save(plots.body(Body.sphere(0.5)), "sphere.png").name
    'sphere.png'
    """
    target = _validate.path(path, "path")
    figure = getattr(figure, "figure", figure)
    if not hasattr(figure, "savefig"):
        raise InputError(f"figure: expected a matplotlib figure or axes, found {type(figure).__name__}")
    from matplotlib import rc_context

    # By default, an SVG file contains the date and random identifiers.
    metadata = {"Date": None} if target.suffix == ".svg" else None
    with replacing(target) as temporary, rc_context({"svg.hashsalt": "loewner"}):
        try:
            figure.savefig(temporary, dpi=120, bbox_inches="tight", metadata=metadata)
        except ValueError as error:  # a suffix that matplotlib does not support
            raise FileError(f"{target}: could not be written ({error})") from None
    return target


def _axes(given: Any, projection: str = "3d") -> Any:
    """Return the given axes, or new axes in space ("3d") or in the plane ("rectilinear")."""
    height, method, where = (6, "add_collection3d", "space") if projection == "3d" else (4, "barh", "the plane")
    if given is None:
        # Figures are made without pyplot, which would keep every figure alive and choose a window system.
        figures = imported("matplotlib.figure", "figures need matplotlib", "plots")
        return figures.Figure(figsize=(6, height)).add_subplot(projection=projection)
    if getattr(given, "name", None) != projection or not hasattr(given, method):
        raise InputError(f"ax: expected matplotlib axes in {where}, found {_validate.short(given)}")
    return given


_flat_axes = partial(_axes, projection="rectilinear")


def _colour(x: Any) -> Any:
    from matplotlib.colors import is_color_like

    try:
        is_colour = isinstance(x, (str, tuple)) and is_color_like(x)
    except Exception:  # an error from the caller's object
        is_colour = False
    if not is_colour:
        raise InputError(f"colour: expected a colour of matplotlib, found {_validate.short(x)}")
    return x


def _expect_text(x: Any, name: str) -> None:
    if not isinstance(x, str):
        raise InputError(f"{name}: expected text, found {_validate.short(x)}")


def _named(x: Any, name: str) -> Mapping[Any, Any]:
    """Check a mapping, which must not be empty."""
    named = _validate.mapping(x, name, "by name")
    if not named:
        raise InputError(f"{name}: expected one entry or more, found none")
    return named


def _tiers_of(group: Any, name: Any) -> dict[str, int]:
    """Return the counts of one group, by tier."""
    counts = asdict(group) if isinstance(group, Settled) else dict(_named(group, f"counts[{name!r}]"))
    for tier, count in counts.items():
        _validate.known(tier, f"counts[{name!r}]", TIERS)
        _validate.whole_number(count, f"counts[{name!r}][{tier!r}]", 0)
    if not any(counts.values()):
        raise InputError(f"counts[{name!r}]: expected counts above zero, found none")
    return counts


def _times(x: Any, name: str, count: int) -> Floats:
    """Check one time, or one time per size; NaN if a time was not measured."""
    times = _validate.float_array(x, f"seconds[{name!r}]")
    if times.shape not in ((), (count,)):
        shape = _validate.shape_text(times.shape)
        raise InputError(f"seconds[{name!r}]: expected shape ({count},), as sizes, or a number; found shape {shape}")
    measured = times[~np.isnan(times)]
    if not len(measured) or not (np.isfinite(measured) & (measured > 0)).all():
        raise InputError(
            f"seconds[{name!r}]: expected times above zero, or NaN but not for all; found {_validate.short(x)}"
        )
    return times


def _counted(x: Any, name: str) -> tuple[int, int]:
    """Check the number of right answers and the total number of answers."""
    try:
        right, total = (_validate.whole_number(n, name, 0) for n in x)
    except Exception:  # not two numbers, or an error from the caller's object
        raise InputError(f"{name}: expected two whole numbers (right, asked), found {_validate.short(x)}") from None
    if right > total:
        raise InputError(f"{name}: expected right <= asked, found {right} of {total}")
    return right, total


def _draw(ax: Any, body: Body, T: Floats, colour: str, ellipsoids: bool) -> None:
    for piece in body.pieces:
        if piece.vertices is not None and piece.triangles is not None:
            _add_triangles(ax, (piece.vertices @ T[:3, :3].T + T[:3, 3])[piece.triangles], colour, 0.55)
    if ellipsoids:
        for fitted, line, width in ((body.outer, OUTER, 0.4), (body.inner, INNER, 0.6)):
            moved = fitted.transformed(T)
            for center, factor in zip(moved.center, moved.factor, strict=True):
                if factor.any():  # otherwise the ellipsoid is a point, since a surface has no inside
                    _add_wires(ax, center, factor, colors=line, linewidths=width)


def _legend(ax: Any, entries: list[tuple[str, str]]) -> None:
    from matplotlib.lines import Line2D

    handles = [Line2D([], [], color=colour, linewidth=4, label=label) for label, colour in entries]
    ax.legend(handles=handles, loc="upper left", fontsize="small", frameon=False)


def _wires() -> Floats:
    """Return six meridians and five parallels of the unit sphere, shape (11, 49, 3)."""
    turn = np.linspace(0, 2 * np.pi, 49)
    x, y, flat = np.cos(turn), np.sin(turn), np.ones(49)
    meridians = [(np.cos(angle) * y, np.sin(angle) * y, x) for angle in np.arange(6) * np.pi / 6]
    parallels = [(np.cos(h) * x, np.cos(h) * y, np.sin(h) * flat) for h in np.linspace(-np.pi / 3, np.pi / 3, 5)]
    return np.array(meridians + parallels).transpose(0, 2, 1)


_WIRES = _wires()


def _corners(body: Body, T: Floats) -> Floats:
    low, high = body.outer.transformed(T).bounding_box()
    return np.concatenate([low, high])


def _frame(ax: Any, corners: Floats) -> None:
    """Fit the axes to all corners, with the same scale along all axes."""
    middle, half = (corners.max(axis=0) + corners.min(axis=0)) / 2, np.ptp(corners, axis=0).max() / 2
    for name, center in zip("xyz", middle, strict=True):
        ax.set(**{f"{name}lim": (center - half, center + half), f"{name}label": f"{name}, m"})
        getattr(ax, f"{name}axis").labelpad = 12  # clear of the tick labels
    ax.set_box_aspect((1, 1, 1))
    ax.locator_params(nbins=3)
