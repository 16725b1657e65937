"""Fit few convex elements that hold a whole body and stick out of it little (docs/design/covers.md)."""

from __future__ import annotations

import numpy as np

from loewner._kernels import columns
from loewner._low_discrepancy import points as even_points
from loewner._matrices import lengths
from loewner._validate import Bools, Floats, Ints, Progress
from loewner.bodies.boxes import least_box_axes
from loewner.bodies.cover_proofs import Target, excess_of, first_failures, prove
from loewner.bodies.elements import Elements
from loewner.bodies.pack import Packed, as_one, moved
from loewner.bodies.primitives import primitives
from loewner.bodies.sensed import ball_pieces, box_pieces
from loewner.bodies.triangulated import of_piece
from loewner.errors import GeometryError, InputError
from loewner.fits import mvce
from loewner.triangles import halved, longest_edges, unit_normals

# Points of the surface, corners, and points of the inside that balls have to hold at first.
SURFACE, CORNERS, INSIDE = 6000, 1500, 500

# Candidates for the centers of balls.
CANDIDATES = 2500

# Steps of the local search for the fewest balls; its rounds, in which points that the proof misses are added, and more of
# them until there is a proof; and in each round, steps in which balls are added for such points.
STEPS, ROUNDS, MORE_ROUNDS, REPAIRS = 1000, 5, 8, 5

# Halvings of the interval of protrusions for a number of balls, steps of the search in each, and steps of 2 % by which
# the protrusion grows until the number is proven to suffice.
HALVINGS, FEW_STEPS, GROWTHS = 12, 100, 40

# Largest edge of the cells of clusters, relative to the size of the body; and about their largest number.
CELL, MOST_CELLS = 0.02, 20_000

# Capsules, boxes and ellipsoids grow by this share of the size, so that decimals of their axes are precise enough.
WRITTEN = 1e-6

# Share of the protrusion that is kept for what is between the points.
RESERVE = 0.04

# Numbers are multiples of the largest coordinate's power of two times this, so that they are the same in float32.
GRID = 2.0**-22

# The least protrusion, relative to the size of the body, and the most elements.
LEAST_PROTRUSION, MOST = 1e-4, 4096


def grid_of(target: Target) -> float:
    """Return the step of the numbers of a fit [m], a power of two."""
    return float(2.0 ** np.ceil(np.log2(2.0 * (target.reach + target.size)))) * GRID


class Spheres:
    """Candidates for balls that hold a body, and the points that they have to hold.

    A ball around a point at the depth d in the body, with the radius d + e, sticks out by no more than e. If the point
    moves away from the nearest point of the surface, the ball grows to contain the old one, so that only points of the
    medial axis count, which have several nearest points.
    """

    def __init__(self, target: Target) -> None:
        self.target, self.grid = target, grid_of(target)
        triangles = target.boundary.triangles
        a, b, c = triangles.transpose(1, 0, 2)
        ends = np.cumsum(lengths(np.cross(b - a, c - a)))
        where = even_points(SURFACE, 3)
        at = np.minimum(np.searchsorted(ends, where[:, 0] * ends[-1]), len(triangles) - 1)
        u, v = where[:, 1], where[:, 2]
        turned = u + v > 1
        u, v = np.where(turned, 1 - u, u)[:, None], np.where(turned, 1 - v, v)[:, None]
        surface = a[at] + u * (b[at] - a[at]) + v * (c[at] - a[at])
        corners = np.unique(triangles.reshape(-1, 3), axis=0)
        corners = corners[:: -(-len(corners) // CORNERS)]
        inside = target.low + even_points(4 * INSIDE, 3) * (target.high - target.low)
        inside = inside[target.holds(inside)][:INSIDE]
        self.points = np.concatenate([surface, corners, inside])
        normals = unit_normals(triangles)[at]
        if target.solids:
            candidates = np.concatenate([self._medial(surface, -normals), inside, surface[::20]])
        else:
            candidates = surface
        self.centers = np.unique(np.rint(candidates / self.grid), axis=0) * self.grid
        self.depth = -target.far(self.centers)
        keep = (
            np.arange(0, len(self.depth), -(-len(self.depth) // CANDIDATES))
            if len(self.depth) > CANDIDATES
            else slice(None)
        )
        self.centers, self.depth = self.centers[keep], self.depth[keep]
        self.far = self._far(self.points)

    def _medial(self, points: Floats, inward: Floats) -> Floats:
        """Find the centers of the largest balls in the body that touch its surface at points, by halving."""
        low, high = np.zeros(len(points)), np.full(len(points), self.target.size)
        slack = 1e-3 * self.target.size / 10
        for _ in range(14):
            middle = (low + high) / 2
            touches = -self.target.far(points + middle[:, None] * inward) >= middle - slack
            low, high = np.where(touches, middle, low), np.where(touches, high, middle)
        return points + low[:, None] * inward

    def _far(self, points: Floats) -> Floats:
        """Compute the distances of points, in rows, from the candidates."""
        squared = (points**2).sum(axis=1)[:, None] + (self.centers**2).sum(axis=1) - 2 * points @ self.centers.T
        return np.asarray(np.sqrt(np.maximum(squared, 0.0)), dtype=np.float32)

    def chosen(self, protrusion: float, steps: int, start: Ints | None = None, reserve: float = RESERVE) -> Ints:
        """Choose few candidates whose balls hold all points, greedily and then by exchanges.

        Points that are missed again and again get weight, which leads the search out of local minima (Gao, Weise and
        Li: An efficient local search heuristic with row weighting for the unicost set covering problem, 2015).
        """
        holds = self.far <= (self.depth + (1 - reserve) * protrusion).astype(np.float32)
        if not holds.any(axis=1).all():
            # Points that no ball holds get candidates of their own.
            missed = self.points[~holds.any(axis=1)]
            self.add_candidates(missed)
            return self.chosen(protrusion, steps, start, reserve)
        found = _greedy(holds, start)
        return _exchanged(holds, found, steps)

    def add_candidates(self, centers: Floats) -> None:
        made = np.unique(np.rint(centers / self.grid), axis=0) * self.grid
        self.centers = np.concatenate([self.centers, made])
        self.depth = np.concatenate([self.depth, -self.target.far(made)])
        self.far = self._far(self.points)

    def add_points(self, points: Floats) -> None:
        self.points = np.concatenate([self.points, points])
        self.far = np.concatenate([self.far, self._far(points)])

    def balls(self, chosen: Ints, protrusion: float) -> tuple[Floats, Floats]:
        radii = np.floor((self.depth[chosen] + protrusion) / self.grid - 1e-6) * self.grid
        return self.centers[chosen], radii

    def proven(self, protrusion: float, steps: int, most: int | None = None) -> Packed | None:
        """Choose balls that are proven to hold the body; None if that takes more than `most`."""
        chosen, best, packed = None, None, None
        for round_ in range(ROUNDS + MORE_ROUNDS):
            # Without a proof, balls have to hold points with more room to spare.
            reserve = RESERVE * 1.5 ** max(0, round_ - ROUNDS + 1)
            chosen = trial = self.chosen(protrusion, steps, chosen, reserve)
            for _ in range(REPAIRS):
                if best is not None and len(trial) >= best or most is not None and len(trial) > most:
                    break
                made = Packed.of(ball_pieces(*self.balls(trial, protrusion)))
                missed = first_failures(self.target, made, protrusion)
                if len(missed) == 0:
                    best, packed = len(trial), made
                    break
                self.add_points(missed)
                trial = self.chosen(protrusion, 0, trial, reserve)
            if round_ >= ROUNDS - 1 and (packed is not None or most is not None and len(chosen) > most):
                return packed
        return packed


def _greedy(holds: Bools, start: Ints | None) -> Ints:
    """Take the candidate that holds most of the points that are left, until none is left."""
    left = np.ones(len(holds), dtype=bool)
    counts = holds.sum(axis=0, dtype=np.int32)
    found = []
    for k in start.tolist() if start is not None else ():
        if counts[k] > 0:
            gone = left & holds[:, k]
            counts -= holds[gone].sum(axis=0, dtype=np.int32)
            left &= ~gone
            found.append(k)
    while left.any():
        k = int(counts.argmax())
        gone = left & holds[:, k]
        counts -= holds[gone].sum(axis=0, dtype=np.int32)
        left &= ~gone
        found.append(k)
    return np.array(found, dtype=np.int64)


def _exchanged(holds: Bools, found: Ints, steps: int) -> Ints:
    """Replace candidates, to hold all points with fewer."""
    columns = [np.flatnonzero(column) for column in np.ascontiguousarray(holds.T)]
    chosen, best = found.tolist(), found
    # How many balls hold a point, and the sum of their numbers, which is the number of a single one.
    count, holder = np.zeros(len(holds), dtype=np.int64), np.zeros(len(holds), dtype=np.int64)
    weight, last = np.ones(len(holds)), np.full(len(columns), -10)

    def change(k: int, by: int, step: int) -> None:
        count[columns[k]] += by
        holder[columns[k]] += by * k
        last[k] = step

    def drop(step: int, waits: int) -> None:
        single = count == 1
        loss = np.bincount(holder[single], weight[single], len(columns))[chosen]
        loss[last[chosen] > step - waits] += 1e9
        change(chosen.pop(int(loss.argmin())), -1, step)

    for k in chosen:
        change(k, 1, -10)
    for step in range(steps):
        while count.all():
            best = np.array(chosen, dtype=np.int64)
            if len(chosen) == 1:
                return best
            drop(step, 0)
        if len(chosen) > 1:
            drop(step, 3)
        left = np.flatnonzero(count == 0)
        able = np.flatnonzero(holds[left[step * 7919 % len(left)]])
        gain = weight[left] @ holds[np.ix_(left, able)]
        gain[last[able] == step] = -1.0
        chosen.append(int(able[gain.argmax()]))
        change(chosen[-1], 1, step)
        weight[count == 0] += 1.0
    return best


def _spheres(target: Target, n: int | None, protrusion: float | None, report: Progress) -> Packed:
    fit = Spheres(target)
    report(10, 100)
    if protrusion is not None:
        found = fit.proven(protrusion, STEPS)
        if found is None:
            raise GeometryError(f"protrusion: expected one that spheres reach, found {protrusion:g} m, and no proof")
        return found
    assert n is not None
    low, high = LEAST_PROTRUSION * target.size, target.size
    for step in range(HALVINGS):
        middle = float(np.sqrt(low * high)) if low * 4 < high else (low + high) / 2
        reached = len(fit.chosen(middle, FEW_STEPS)) <= n
        low, high = (low, middle) if reached else (middle, high)
        report(10 + 3 * step, 100)
    for _ in range(GROWTHS):
        found = fit.proven(high, STEPS, n)
        if found is not None:
            return found
        high *= 1.02
    raise GeometryError(f"n: expected a number of spheres that suffices, found {n}, and no proof")


class _Clusters:
    """Cells of a body in clusters, each with an element around it; the one that sticks out most is divided."""

    def __init__(self, target: Target, kind: str) -> None:
        self.target, self.kind = target, kind
        cells = target.triangles
        for _ in range(20):
            length, edge = longest_edges(cells)
            long = length > target.size * CELL
            if not long.any() or len(cells) > MOST_CELLS:
                break
            cells = np.concatenate([cells[~long], halved(cells[long], edge[long])])
        inside = target.low + even_points(4 * INSIDE, 3) * (target.high - target.low)
        inside = inside[target.holds(inside)]
        self.cells = np.concatenate([cells, np.repeat(inside[:, None], 3, axis=1)])
        self.middles = self.cells.mean(axis=1)
        # What is added for rounding, and for numbers that are written to files.
        self.spare = WRITTEN * (target.reach + target.size) + float(target.radius.max())
        self.clusters = [np.arange(len(self.cells))]
        self.elements = [self.element(self.clusters[0])]
        self.excess = [self.sticks(self.elements[0])]

    def element(self, cluster: Ints) -> Packed:
        """Fit an element around cells."""
        points = np.unique(self.cells[cluster].reshape(-1, 3), axis=0)
        if self.kind == "ellipsoids":
            try:
                ball = mvce(points, tol=1e-2).ellipsoid
                axes, turn, center = ball.semi_axes, ball.rotation, ball.center
                least = self.spare + 1e-3 * axes.max()
            except GeometryError:  # flat
                turn, half, center = _box(points)
                axes, least = np.sqrt(3.0) * half, 1e-2 * half.max() + self.spare
            return _placed(
                primitives(columns.ELLIPSOID, np.zeros(1), np.maximum(axes + self.spare, least)[None]), turn, center
            )
        turn, half, center = _box(points)
        if self.kind == "boxes":
            half = np.maximum(half + self.spare, 1e-3 * half.max())
            return _placed(Packed.of(box_pieces(-half[None], half[None])), turn, center)
        tried = [_capsule(points, np.roll(turn, k, axis=1)) for k in range(3)]
        radius, half_length, turn, center = min(tried, key=lambda one: one[0] ** 2 * (4 * one[0] / 3 + 2 * one[1]))
        radius, half_length = radius + self.spare, max(half_length, self.spare)
        return _placed(
            primitives(columns.SEGMENT, np.array([radius]), np.array([[radius, radius, half_length]])), turn, center
        )

    def sticks(self, element: Packed) -> float:
        """Estimate how far an element sticks out, from points of its surface."""
        vertices, triangles = of_piece(element, 0)
        return float(self.target.below(np.concatenate([vertices, vertices[triangles].mean(axis=1)])).max())

    def divide(self, k: int) -> None:
        """Divide a cluster across one of its axes, where the parts' elements have the least volume."""
        cluster = self.clusters[k]
        away = self.middles[cluster] - self.middles[cluster].mean(axis=0)
        turn = np.linalg.eigh(away.T @ away)[1]
        best = None
        for axis in turn.T:
            height = away @ axis
            for share in (0.3, 0.5, 0.7):
                cut = height <= height.min() + share * np.ptp(height)
                if cut.all() or not cut.any():
                    continue
                parts = [cluster[cut], cluster[~cut]]
                made = [self.element(part) for part in parts]
                volume = sum(float(np.linalg.det(element.outer_factor[0])) for element in made)
                if best is None or volume < best[0]:
                    best = volume, parts, made
        if best is None:
            raise GeometryError(f"{self.kind}: expected cells that can be divided, found one; use a larger protrusion")
        self.clusters[k : k + 1], self.elements[k : k + 1] = best[1], best[2]
        self.excess[k : k + 1] = [self.sticks(element) for element in best[2]]

    def hold(self, points: Floats) -> None:
        """Add points to the clusters nearest to them."""
        first = len(self.cells)
        self.cells = np.concatenate([self.cells, np.repeat(points[:, None], 3, axis=1)])
        self.middles = np.concatenate([self.middles, points])
        for i, point in enumerate(points):
            off = [float(lengths(self.middles[cluster] - point).min()) for cluster in self.clusters]
            k = int(np.argmin(off))
            self.clusters[k] = np.append(self.clusters[k], first + i)
            self.elements[k] = self.element(self.clusters[k])
            self.excess[k] = self.sticks(self.elements[k])


def _box(points: Floats) -> tuple[Floats, Floats, Floats]:
    """Return the axes, half edges and center of a box around points that has little area."""
    turn = least_box_axes(np.ascontiguousarray(points.T[:, None, :]))
    if np.linalg.det(turn) < 0:
        turn = turn * [1.0, 1.0, -1.0]
    turned = points @ turn
    low, high = turned.min(axis=0), turned.max(axis=0)
    return turn, (high - low) / 2, turn @ (low / 2 + high / 2)


def _capsule(points: Floats, turn: Floats) -> tuple[float, float, Floats, Floats]:
    """Fit a capsule around points along the third axis; return radius, half the straight length, axes, center."""
    turned = points @ turn
    middle = (turned[:, :2].min(axis=0) + turned[:, :2].max(axis=0)) / 2
    for step in range(1, 60):  # towards the farthest point by ever smaller steps (Badoiu and Clarkson, 2003)
        off = turned[:, :2] - middle
        middle = middle + off[(off**2).sum(axis=1).argmax()] / (step + 1)
    across = np.hypot(*(turned[:, :2] - middle).T)
    radius = float(across.max())
    reach = np.sqrt(np.maximum(radius * radius - across * across, 0.0))
    low, high = float((turned[:, 2] + reach).min()), float((turned[:, 2] - reach).max())
    if low > high:
        low = high = (low + high) / 2
    return radius, (high - low) / 2, turn, turn @ np.append(middle, (low + high) / 2)


def _placed(packed: Packed, turn: Floats, center: Floats) -> Packed:
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = turn, center
    return moved(packed, T)


def _others(target: Target, kind: str, n: int | None, protrusion: float | None, report: Progress) -> Packed:
    """Fit capsules, boxes or ellipsoids by dividing clusters of cells."""
    fit = _Clusters(target, kind)
    limit = 0.0 if protrusion is None else 0.98 * protrusion
    for _ in range(ROUNDS + GROWTHS):
        while len(fit.elements) < (MOST if n is None else n) and max(fit.excess) > limit:
            fit.divide(int(np.argmax(fit.excess)))
            done = len(fit.elements) / n if n is not None else limit / max(max(fit.excess), limit)
            report(int(5 + 70 * done), 100)
        packed = as_one(fit.elements)
        missed = first_failures(target, packed, max(fit.excess) if protrusion is None else protrusion)
        if len(missed):
            fit.hold(missed[:: max(1, len(missed) // 20)])
            continue
        if protrusion is None:
            return packed
        sticks = excess_of(target, packed, Elements(packed), 0.005 * protrusion)[1]
        if sticks <= protrusion:
            return packed
        if len(fit.elements) >= MOST:
            break
        limit *= 0.95
        fit.divide(int(np.argmax(fit.excess)))
    asked = (
        f"n: expected a number of {kind} that suffices, found {n}"
        if protrusion is None
        else (f"protrusion: expected one that {kind} reach, found {protrusion:g} m")
    )
    raise GeometryError(f"{asked}, and no proof")


def cover(
    packed: Packed, kind: str, n: int | None, protrusion: float | None, progress: Progress | None
) -> tuple[Packed, float]:
    """Fit elements of a kind to a body, and bound how far they stick out; see `Body.cover`."""
    target, share = Target(packed), 0

    def report(done: int, total: int) -> None:
        nonlocal share
        share = max(share, min(done, 95))
        if progress is not None:
            progress(share, total)

    if protrusion is not None and protrusion < LEAST_PROTRUSION * target.size:
        raise InputError(
            f"protrusion: expected at least {LEAST_PROTRUSION * target.size:.3g} m, 1e-4 of the body's diagonal, "
            f"found {protrusion:g}"
        )
    report(0, 100)
    found = (
        _spheres(target, n, protrusion, report) if kind == "spheres" else _others(target, kind, n, protrusion, report)
    )
    proof = prove(packed, found, None)
    if proof.outcome != "covered":
        raise GeometryError(f"cover: expected a proof that the {kind} hold the body, found {proof.outcome}")
    if progress is not None:
        progress(100, 100)
    return found, proof.excess[1]
