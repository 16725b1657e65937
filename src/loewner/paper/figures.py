"""Draw figures 1 to 4 of the paper from the experiment's own pairs (figure 3 is a flow chart).

Figures 1 and 2 are sections along a plane that contains the near-point line, so every marked point lies in the section.
Drawing needs matplotlib (extra "plots").
"""

from __future__ import annotations

import io
from dataclasses import dataclass
from typing import Any

import numpy as np

from loewner._base._validate import Floats
from loewner._kernels.tolerances import PAPER_ANGLE
from loewner.ellipsoids.ellipsoid_pairs import near_points
from loewner.ellipsoids.ellipsoids import Ellipsoids
from loewner.errors import imported
from loewner.paper.results import Experiment

FIGURES = ("figure-1", "figure-2", "figure-3", "figure-4")
FORMATS = ("png", "svg")

BLUE, RED, GREY = "#2f6db3", "#c8492f", "#555555"
DOTS_PER_INCH = 110


def require_matplotlib() -> Any:
    """Import the drawing packages; figures do not use pyplot, so no window system is needed.

    Raises
    ------
    MissingExtraError
    """
    return imported("matplotlib.figure", "figures need matplotlib", "plots").Figure


def draw(experiment: Experiment) -> dict[str, Any]:
    """Draw the four figures.

    Returns
    -------
    dict of str to matplotlib.figure.Figure
        The figures, under the names in `FIGURES`.
    """
    require_matplotlib()
    k, with_polyhedra = _clear_pair(experiment, True), _clear_pair(experiment, False)
    return {
        "figure-1": _section(experiment, with_polyhedra, "heuristic"),
        "figure-2": _section(experiment, k, "inner"),
        "figure-3": _flow_chart(),
        "figure-4": _samples(experiment),
    }


def render(figure: Any, kind: str) -> bytes:
    """Encode a figure as "png" or "svg"; the same figure gives the same bytes."""
    import matplotlib

    stream = io.BytesIO()
    with matplotlib.rc_context({"svg.hashsalt": "loewner"}):
        # By default, an SVG file contains the date.
        figure.savefig(stream, format=kind, dpi=DOTS_PER_INCH, metadata={"Date": None} if kind == "svg" else None)
    return stream.getvalue()


# -- figures 1 and 2: the points that f and the earlier method use ---------------------------------


@dataclass(frozen=True)
class Line:
    """The near-point line of one pair: v1 at 0 and v2 at L, in metres along the unit vector e."""

    v1: Floats
    e: Floats
    L: float
    beta: float
    alpha: float


def line_of_pair(inner: tuple[Ellipsoids, Ellipsoids], outer: tuple[Ellipsoids, Ellipsoids], method: str) -> Line:
    """Find a pair's near-point line, its exit from outer ellipsoid 1 (beta) and its entry into outer 2 (alpha)."""
    near = near_points(*inner, method=method, angle=PAPER_ANGLE)
    L = float(near.distance)
    away = near.point_2 - near.point_1 if L > 0 else inner[1].center - inner[0].center
    e = away / np.linalg.norm(away)
    beta = _exit(outer[0], near.point_1, e)
    return Line(near.point_1, e, L, beta, L - _exit(outer[1], near.point_2, -e))


def _exit(E: Ellipsoids, p: Floats, e: Floats) -> float:
    """Compute the parameter t at which the ray p + t e leaves an ellipsoid that contains p."""
    v, w = np.linalg.solve(E.factor, np.stack([e, p - E.center], axis=1)).T
    a, b, c = v @ v, v @ w, min(w @ w - 1.0, 0.0)
    return float((-b + np.sqrt(b * b - a * c)) / a)


def _polytope_exit(normals: Floats, offsets: Floats, p: Floats, e: Floats) -> float:
    """Compute the parameter t at which the ray p + t e leaves a polytope that contains p."""
    speed, slack = normals @ e, offsets - normals @ p
    ahead = speed > 0
    return float((slack[ahead] / speed[ahead]).min())


def _clear_pair(experiment: Experiment, colliding: bool) -> int:
    """Pick an ambiguous pair whose four points are well apart on its near-point line, as in the paper's drawings."""
    chosen = np.flatnonzero(experiment.detectors[1].answers.ambiguous & (experiment.truth == colliding))
    if not len(chosen):
        chosen = np.arange(len(experiment))

    def room(k: int) -> float:
        line = line_of_pair(*_ellipsoids(experiment, k, "inner"), method="lin-han")
        return min(line.L, line.beta - line.L, -line.alpha)

    return int(max(chosen[:200].tolist(), key=room))


def _ellipsoids(
    experiment: Experiment, k: int, kind: str
) -> tuple[tuple[Ellipsoids, Ellipsoids], tuple[Ellipsoids, Ellipsoids]]:
    pairs = experiment.pairs
    inner = (getattr(pairs, f"{kind}_1")[k], getattr(pairs, f"{kind}_2")[k])
    return inner, (pairs.outer_1[k], pairs.outer_2[k])


def _section(experiment: Experiment, k: int, kind: str) -> Any:
    """Cut pair k along a plane through its near-point line; `kind` names the inner ellipsoids to use."""
    from matplotlib.colors import to_rgba

    earlier = kind == "heuristic"
    inner, outer = _ellipsoids(experiment, k, kind)
    line = line_of_pair(inner, outer, "rimon-boyd" if earlier else "lin-han")
    # The plane also contains the direction from the line to the mean of the outer centers, so that both bodies are
    # clearly visible.
    across = (outer[0].center + outer[1].center) / 2 - line.v1
    across = across - (across @ line.e) * line.e
    if np.linalg.norm(across) < 1e-9:
        across = np.cross(line.e, np.eye(3)[np.argmin(np.abs(line.e))])
    across /= np.linalg.norm(across)

    figure = require_matplotlib()(figsize=(7.5, 4.6), layout="constrained")
    ax = figure.add_subplot(aspect="equal")
    faces_1, faces_2 = (faces[np.array([k])] for faces in (experiment.pairs.faces_1, experiment.pairs.faces_2))
    for side, (faces, color) in enumerate(((faces_1, BLUE), (faces_2, RED))):
        for E, style in ((outer[side], "-"), (inner[side], "--")):
            curve = _ellipse(E, line.v1, line.e, across)
            if curve is not None:
                ax.plot(*curve, style, color=color, lw=1.4)
        polygon = _polygon(faces.normals, faces.offsets, line.v1, line.e, across)
        if len(polygon):
            ax.fill(*polygon.T, facecolor=to_rgba(color, 0.22), edgecolor=to_rgba(color, 0.8), lw=1.0)
    marks = {
        "$v_1^i$": (0.0, BLUE),
        "$v_2^i$": (line.L, RED),
        "$v_1^c$": (line.beta, BLUE),
        "$v_2^c$": (line.alpha, RED),
    }
    if earlier:
        v2 = line.v1 + line.L * line.e
        marks["$v_1$"] = (_polytope_exit(faces_1.normals, faces_1.offsets, line.v1, line.e), BLUE)
        marks["$v_2$"] = (line.L - _polytope_exit(faces_2.normals, faces_2.offsets, v2, -line.e), RED)
    ax.axhline(0.0, color=GREY, lw=0.7, zorder=0)
    # Successive labels are alternately above and below the line, so that close labels stay legible.
    for place, (name, (t, color)) in enumerate(sorted(marks.items(), key=lambda item: item[1][0])):
        ax.plot([t], [0.0], "o", ms=5, color=color)
        ax.annotate(
            name, (t, 0.0), (0, 9 if place % 2 else -9), textcoords="offset points", ha="center",
            va="bottom" if place % 2 else "top", color=color,
            bbox={"boxstyle": "round,pad=0.1", "fc": "white", "ec": "none", "alpha": 0.75},
        )  # fmt: skip
    what = "earlier method: heuristic inner ellipsoids" if earlier else "largest inner ellipsoids"
    ax.set(xlabel="along the near-point line, m", ylabel="across, m", title=f"Pair {k}, {what}")
    ax.title.set_fontsize(10)
    return figure


def _ellipse(E: Ellipsoids, origin: Floats, x: Floats, y: Floats) -> Floats | None:
    """Cut an ellipsoid by the plane origin + s x + t y; return the outline, shape (2, 200), or None if it is empty."""
    u, v, w = np.linalg.solve(E.factor, np.stack([x, y, origin - E.center], axis=1)).T
    M = np.array([[u @ u, u @ v], [u @ v, v @ v]])
    middle = -np.linalg.solve(M, [u @ w, v @ w])
    rest = w + middle[0] * u + middle[1] * v
    room = 1.0 - rest @ rest
    if room <= 0:
        return None
    turn = np.linspace(0.0, 2 * np.pi, 200)
    circle = np.sqrt(room) * np.stack([np.cos(turn), np.sin(turn)])
    outline: Floats = middle[:, None] + np.linalg.solve(np.linalg.cholesky(M).T, circle)
    return outline


def _polygon(normals: Floats, offsets: Floats, origin: Floats, x: Floats, y: Floats) -> Floats:
    """Cut a polytope by a plane: clip a square by every face (Sutherland-Hodgman); return the corners, shape (n, 2)."""
    size = 10.0 + np.abs(offsets).max()
    corners = np.array([[-size, -size], [size, -size], [size, size], [-size, size]])
    for n, b in zip(normals, offsets, strict=True):
        line, room = np.array([n @ x, n @ y]), b - n @ origin
        kept: list[Floats] = []
        for p, q in zip(corners, np.roll(corners, -1, axis=0), strict=True):
            at_p, at_q = room - line @ p, room - line @ q
            if at_p >= 0:
                kept.append(p)
            if (at_p >= 0) != (at_q >= 0):
                kept.append(p + at_p / (at_p - at_q) * (q - p))
        corners = np.array(kept).reshape(-1, 2)
        if not len(corners):
            break
    return corners


# -- figure 3: the flow ----------------------------------------------------------------------------

# Boxes by name: x, y, half width, half height, text, and whether it is a question; each box has room for its text.
BOXES = {
    "outer": (0.0, 3.0, 0.62, 0.24, "outer ellipsoids\n(MVCEs) overlap?", True),
    "inner": (0.0, 2.0, 0.62, 0.24, "inner ellipsoids\n(MVIEs) overlap?", True),
    "near": (0.0, 1.0, 0.68, 0.27, "near points $v_1^i$, $v_2^i$;\nray hits $v_1^c$, $v_2^c$", False),
    "f": (0.0, 0.0, 0.72, 0.18, "$f(v_1^i, v_2^i, v_1^c, v_2^c) \\leq 0$ ?", True),
    "free": (-2.4, 0.0, 0.48, 0.18, "no collision", False),
    "hit": (2.4, 0.0, 0.48, 0.18, "collision", False),
}
ARROWS = (
    ("outer", "inner", "yes"),
    ("inner", "near", "no"),
    ("near", "f", ""),
    ("outer", "free", "no"),
    ("inner", "hit", "yes"),
    ("f", "free", "no"),
    ("f", "hit", "yes"),
)


def arrow_path(start: str, end: str) -> Floats:
    """Return the corners of an arrow from the border of one box to the border of a second box, shape (2 or 3, 2).

    The arrow runs straight down or sideways. An arrow that skips the questions below runs sideways, then down.
    """
    x0, y0, width_0, height_0 = BOXES[start][:4]
    x1, y1, width_1, height_1 = BOXES[end][:4]
    if x0 == x1:
        return np.array([(x0, y0 - height_0), (x1, y1 + height_1)])
    side = np.sign(x1 - x0)
    leaves = (x0 + side * width_0, y0)
    if y0 == y1:
        return np.array([leaves, (x1 - side * width_1, y1)])
    return np.array([leaves, (x1, y0), (x1, y1 + height_1)])


def _flow_chart() -> Any:
    figure = require_matplotlib()(figsize=(7.0, 4.6), layout="constrained")
    from matplotlib.patches import FancyBboxPatch

    ax = figure.add_subplot()
    ax.set(xlim=(-3.0, 3.0), ylim=(-0.35, 3.35))
    ax.axis("off")
    for x, y, width, height, text, question in BOXES.values():
        style, colour = "round,pad=0,rounding_size=0.06", "#eef3f9" if question else "#f6f6f6"
        corner, size = (x - width, y - height), (2 * width, 2 * height)
        ax.add_patch(FancyBboxPatch(corner, *size, boxstyle=style, fc=colour, ec=GREY))
        ax.text(x, y, text, ha="center", va="center", fontsize=10)
    for start, end, answer in ARROWS:
        corners = arrow_path(start, end)
        ax.plot(*corners[:-1].T, color=GREY, lw=1.1)
        tip = {"arrowstyle": "-|>", "color": GREY, "lw": 1.1, "shrinkA": 0, "shrinkB": 0}
        ax.annotate("", corners[-1], corners[-2], arrowprops=tip)
        # The answer is next to the first segment: on the right if the segment runs down, and above it if it runs
        # sideways.
        (x, y), down = corners[:2].mean(axis=0), corners[0, 0] == corners[1, 0]
        ax.annotate(
            answer, (x, y), (5, 0) if down else (0, 4), textcoords="offset points",
            ha="left" if down else "center", va="center" if down else "bottom", fontsize=9,
        )  # fmt: skip
    return figure


# -- figure 4: one pair of each kind ---------------------------------------------------------------


def _samples(experiment: Experiment) -> Any:
    """Draw an ambiguous pair of detector 2 from each cell of Table 2 (b)."""
    from mpl_toolkits.mplot3d.art3d import Poly3DCollection

    figure = require_matplotlib()(figsize=(8.0, 7.6))
    answers, truth = experiment.detectors[1].answers, experiment.truth
    for place, (said, is_so) in enumerate(((True, True), (True, False), (False, True), (False, False))):
        ax = figure.add_subplot(2, 2, place + 1, projection="3d")
        words = f"says {'collision' if said else 'free'}, is {'colliding' if is_so else 'free'}"
        ax.set_title(f"cell ({place // 2 + 1},{place % 2 + 1}): {words}", fontsize=10)
        ax.set_axis_off()
        indices = np.flatnonzero(answers.ambiguous & (answers.collides == said) & (truth == is_so))
        if not len(indices):
            ax.text2D(0.5, 0.5, "no such pair", transform=ax.transAxes, ha="center")
            continue
        k = int(indices[0])
        corners: list[Floats] = []
        for bodies, color in ((experiment.bodies_1, BLUE), (experiment.bodies_2, RED)):
            piece = bodies[k].pieces[0]
            assert piece.vertices is not None  # all pieces of the experiment are polytopes
            look = {"facecolors": color, "edgecolors": color, "alpha": 0.22, "linewidths": 0.5}
            ax.add_collection3d(Poly3DCollection(piece.vertices[piece.triangles], **look))
            ax.plot_surface(*_surface(piece.inner), color=color, alpha=0.55, linewidth=0, rstride=1, cstride=1)
            corners.append(piece.vertices)
        _look_across(ax, np.concatenate(corners), experiment.pairs, k)
    figure.subplots_adjust(0.0, 0.0, 1.0, 0.96, 0.0, 0.06)
    return figure


def _surface(E: Ellipsoids) -> Floats:
    """Compute a grid of points on an ellipsoid, shape (3, 13, 25)."""
    polar, around = np.meshgrid(np.linspace(0, np.pi, 13), np.linspace(0, 2 * np.pi, 25), indexing="ij")
    ball = np.stack([np.sin(polar) * np.cos(around), np.sin(polar) * np.sin(around), np.cos(polar)])
    points: Floats = E.center[:, None, None] + np.einsum("ij,jab->iab", E.factor, ball)
    return points


def _look_across(ax: Any, points: Floats, pairs: Any, k: int) -> None:
    """Fit the axes to the points at equal scale, and view them perpendicular to the line of centers."""
    low, high = points.min(axis=0), points.max(axis=0)
    middle, half = (low + high) / 2, (high - low).max() / 2
    ax.set(xlim=middle[0] + half * np.array([-1, 1]), ylim=middle[1] + half * np.array([-1, 1]))
    ax.set_zlim(*(middle[2] + half * np.array([-1, 1])))
    ax.set_box_aspect((1, 1, 1), zoom=1.35)
    r = pairs.inner_2.center[k] - pairs.inner_1.center[k]
    ax.view_init(elev=12, azim=float(np.degrees(np.arctan2(r[1], r[0]))) - 90.0)
