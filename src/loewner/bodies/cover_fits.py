"""Fit a few convex elements that contain a whole body and stick out only slightly (docs/design/covers.md)."""

from __future__ import annotations

import numpy as np

from loewner._base._log import Percentage
from loewner._base._low_discrepancy import points as even_points
from loewner._base._matrices import dot, lengths
from loewner._base._rotations import pose_of
from loewner._base._validate import Bools, Floats, Ints, Progress
from loewner._kernels import columns
from loewner._native import entries
from loewner.bodies.boxes import least_box_axes
from loewner.bodies.cover_proofs import OCTANTS, Target, excess_of, first_failures, prove
from loewner.bodies.elements import Elements
from loewner.bodies.pack import Packed, as_one, moved
from loewner.bodies.primitives import primitives
from loewner.bodies.sensed import ball_pieces, box_pieces
from loewner.bodies.triangulated import of_piece
from loewner.ellipsoids.fits import mvce
from loewner.errors import GeometryError, InputError
from loewner.meshes.triangles import halved, longest_edges, unit_normals

# Initial numbers of points that the balls must contain: on the surface, at corners, and in the interior.
SURFACE, CORNERS, INSIDE = 6000, 1500, 500

# DENSITY is the number of surface points in a square whose edges are as long as the protrusion. A small surface needs
# fewer points and candidates, but at least the share LEAST_SHARE of the usual numbers.
DENSITY, LEAST_SHARE = 8.0, 0.2

# Number of candidates for the centers of balls.
CANDIDATES = 2500

# The local search for the fewest balls takes STEPS steps in each of ROUNDS rounds. Up to REPAIRS times, a round adds
# the points at which the proof fails, and balls for these points. If there is no proof after these rounds, at most
# MORE_ROUNDS rounds follow.
STEPS, ROUNDS, MORE_ROUNDS, REPAIRS = 1000, 5, 8, 5

# PAIRS is the number of pairs of centers that are tried as the ends of a capsule's axis. An axis is accepted if its
# depth is nowhere less than FALL times the depth of its shallower end. The depth of a capsule is measured at
# AXIS_POINTS points of its axis.
PAIRS, FALL, AXIS_POINTS = 16_384, 0.7, 24

# Number of bits in a word. Each point, and each candidate, takes one bit.
WORD = 64

# If the number of balls is given, the protrusion is found by halving an interval HALVINGS times, with FEW_STEPS search
# steps each time. The protrusion then grows by 3 %, at most GROWTHS times, until a cover with this number of balls is
# proven.
HALVINGS, FEW_STEPS, GROWTHS = 12, 100, 40

# CELL is the largest edge of a cluster's cells, relative to the size of the body. MOST_CELLS is an approximate limit on
# the number of cells.
CELL, MOST_CELLS = 0.04, 20_000

# Once there are JUDGED elements, the final number is estimated: an element that sticks out by k times the protrusion is
# expected to need k elements. The fit ends if the estimate exceeds HOPELESS times MOST.
JUDGED, HOPELESS = 512, 4

# Half the edge of the cubes that are added where the proof fails, relative to the size of the body.
AROUND = 0.005

# Boxes and ellipsoids grow by this share of the body's size, so that they still cover the body when a file rounds their
# axes to decimals.
WRITTEN = 1e-6

# This share of the protrusion is held back, because balls that contain all points may miss the gaps between the points.
RESERVE = 0.04

# Centers and radii are multiples of GRID times a power of two above all coordinates, so that float32 represents them
# exactly.
GRID = 2.0**-22

# The least and the largest protrusion, relative to the size of the body, and the largest number of elements.
LEAST_PROTRUSION, LARGEST_PROTRUSION, MOST = 1e-4, 1e4, 4096


class Candidates:
    """Candidates for the balls or capsules of a cover, and the points that the cover must contain.

    A ball of radius d + e around a point at depth d in the body sticks out by no more than e. If the point moves away
    from the nearest point of the surface, the new ball contains the old ball. Centers are therefore needed only on the
    medial axis, whose points have several nearest points on the surface. A capsule is a union of balls; its d is the
    least depth of any point of its axis.
    """

    def __init__(self, target: Target, capsules: bool, protrusion: float | None = None) -> None:
        self.target = target
        self.grid = float(2.0 ** np.ceil(np.log2(2.0 * (target.reach + target.size)))) * GRID
        triangles = target.boundary.triangles
        a, b, c = triangles.transpose(1, 0, 2)
        ends = np.cumsum(lengths(np.cross(b - a, c - a)))
        share = 1.0
        if protrusion is not None:
            # If the surface is small relative to the squared protrusion, fewer points suffice.
            share = float(np.clip(DENSITY * ends[-1] / 2 / protrusion / protrusion / SURFACE, LEAST_SHARE, 1.0))
        where = even_points(int(SURFACE * share), 3)
        at = np.minimum(np.searchsorted(ends, where[:, 0] * ends[-1]), len(triangles) - 1)
        u, v = where[:, 1], where[:, 2]
        turned = u + v > 1
        u, v = np.where(turned, 1 - u, u)[:, None], np.where(turned, 1 - v, v)[:, None]
        surface = a[at] + u * (b[at] - a[at]) + v * (c[at] - a[at])
        whole = target.boundary is target.whole
        radius = target.radius[target.owner] if whole else np.full(len(triangles), target.radius.max())
        corners = np.unique(np.column_stack([triangles.reshape(-1, 3), np.repeat(radius, 3)]), axis=0)
        corners = corners[:: -(-len(corners) // CORNERS)]
        inside = target.low + even_points(4 * INSIDE, 3) * (target.high - target.low)
        inside = inside[target.holds(inside)][:INSIDE]
        # The points that must be covered. A fourth column has radii of balls about the points, which must be covered as
        # well; only points of surfaces with a radius have such balls.
        self.points = np.empty((0, 4))
        self.add_points(surface, radius[at])
        self.add_points(corners[:, :3], corners[:, 3])
        self.add_points(inside, np.zeros(len(inside)))
        middles = [(target.low / 2 + target.high / 2)[None], surface]
        if target.solids:
            normals = unit_normals(triangles)[at]
            middles = [middles[0], self._medial(surface, -normals), inside, surface[::20]]
        centers = np.concatenate(middles)
        centers = centers[:: -(-len(centers) // int(CANDIDATES * share))]
        self.centers, self.axes, self.depth = np.empty((0, 3)), np.empty((0, 3)), np.empty(0)
        # One bit for each candidate and each of the first `known` points: whether the candidate contains the point. The
        # candidates have the radii `radii`.
        self.radii, self.known = np.empty(0), 0
        self.by_point, self.by_candidate = np.empty((0, 0), dtype=np.int64), np.empty((0, 0), dtype=np.int64)
        self.add_candidates(centers, np.zeros((1, 3)))
        if capsules:
            self._add_segments()

    def _add_segments(self) -> None:
        """Join pairs of centers by segments, and keep segments along which the depth does not fall much."""
        pairs = (even_points(PAIRS, 2) * len(self.centers)).astype(np.int64)
        p, q = self.centers[pairs[:, 0]], self.centers[pairs[:, 1]]
        # Half of the segments are shortened.
        q = np.where((np.arange(PAIRS) % 2 == 0)[:, None], p + (q - p) / 4, q)
        shares = np.linspace(0.0, 1.0, 9)
        depth = np.min([-self.target.far(p + share * (q - p)) for share in shares], axis=0)
        least = np.minimum(self.depth[pairs[:, 0]], self.depth[pairs[:, 1]])
        best = np.argsort(-(lengths(q - p) * (depth >= FALL * least)), kind="stable")[: CANDIDATES // 2]
        self.add_candidates((p + q)[best] / 2, (q - p)[best] / 2)

    def _medial(self, points: Floats, inward: Floats) -> Floats:
        """Find, by halving, the centers of the largest balls in the body that touch its surface at the given points."""
        low, high = np.zeros(len(points)), np.full(len(points), self.target.size)
        slack = 1e-3 * self.target.size / 10
        for _ in range(14):
            middle = (low + high) / 2
            touches = -self.target.far(points + middle[:, None] * inward) >= middle - slack
            low, high = np.where(touches, middle, low), np.where(touches, high, middle)
        return points + low[:, None] * inward

    def chosen(self, protrusion: float, steps: int, start: Ints | None = None, reserve: float = RESERVE) -> Ints:
        """Choose a few candidates that together cover all points: first greedily, then by exchanges."""
        start = np.empty(0, dtype=np.int64) if start is None else start
        for _ in range(2):
            n = len(self.points)
            missed = self._hold(self.depth + (1 - reserve) * protrusion)
            if not missed.any():
                candidates = np.empty(n, dtype=np.int64)
                count = entries.choose_few(n, steps, start, self.by_point, self.by_candidate, candidates)
                return candidates[:count]
            # Each point that is in no ball becomes the center of a new candidate.
            self.add_candidates(self.points[missed, :3], np.zeros((1, 3)))
        differ = f"{np.ptp(self.target.radius):g} m, by which radii of surfaces differ"
        raise GeometryError(f"protrusion: expected more than {differ}, found {protrusion:g} m")

    def _hold(self, radii: Floats) -> Bools:
        """Find which candidates, with the given radii, contain which points; mark the points in no candidate."""
        n, m = -(-len(self.points) // WORD), -(-len(radii) // WORD)
        old_count = self.known if np.array_equal(radii, self.radii) else 0
        if m > self.by_point.shape[1] or n > self.by_candidate.shape[1]:
            # A third of the memory is for points of later rounds.
            self.by_point = np.empty((3 * n // 2 * WORD, m), dtype=np.int64)
            self.by_candidate = np.zeros((m * WORD, 3 * n // 2), dtype=np.int64)
            old_count = 0
        candidates = np.zeros((8, m * WORD))
        candidates[:3, : len(radii)], candidates[3:6, : len(radii)] = self.centers.T, self.axes.T
        squares = dot(self.axes, self.axes)
        candidates[6, : len(radii)] = np.divide(1.0, squares, out=np.zeros(len(radii)), where=squares > 0)
        candidates[7], candidates[7, : len(radii)] = -1.0, radii
        entries.find_held(
            old_count - old_count % WORD, self.points, candidates.ravel(), self.by_point, self.by_candidate
        )
        self.known, self.radii = len(self.points), radii
        return np.asarray(~self.by_point[: len(self.points)].any(axis=1))

    def add_candidates(self, centers: Floats, axes: Floats) -> None:
        """Add balls, or capsules with the given half axes."""
        centers = np.rint(centers / self.grid) * self.grid
        axes = np.broadcast_to(np.rint(axes / self.grid) * self.grid, centers.shape)
        depth, parts = np.full(len(centers), np.inf), 1 if not axes.any() else AXIS_POINTS
        for share in np.linspace(-1.0, 1.0, 2 * parts + 1)[1::2]:
            depth = np.minimum(depth, -self.target.far(centers + share * axes))
        self.centers, self.axes = np.concatenate([self.centers, centers]), np.concatenate([self.axes, axes])
        self.depth = np.concatenate([self.depth, depth - lengths(axes) / parts])

    def add_points(self, points: Floats, around: Floats) -> None:
        """Add points; the balls of the radii `around` about these points must be covered."""
        self.points = np.concatenate([self.points, np.column_stack([points, around])])

    def made(self, chosen: Ints, protrusion: float) -> Packed:
        """Make a body of the chosen candidates, with radii rounded down."""
        radii = np.floor((self.depth[chosen] + protrusion) / self.grid - 1e-6) * self.grid
        centers, axes = self.centers[chosen], self.axes[chosen]
        plain = ~axes.any(axis=1)
        bodies = [Packed.of(ball_pieces(centers[plain], radii[plain]))] if plain.any() else []
        for center, axis, radius in zip(centers[~plain], axes[~plain], radii[~plain], strict=True):
            length = float(lengths(axis))
            turn = np.linalg.qr(np.column_stack([axis / length, np.eye(3)]))[0]
            along = turn[:, 0] * np.sign(turn[:, 0] @ axis)
            turn = np.column_stack([turn[:, 1], np.cross(along, turn[:, 1]), along])
            capsule = primitives(columns.SEGMENT, np.array([radius]), np.array([[radius, radius, length]]))
            bodies.append(moved(capsule, pose_of(turn, center)))
        return as_one(bodies) if len(bodies) > 1 else bodies[0]

    def proven(self, protrusion: float, steps: int, most: int | None = None) -> Packed | None:
        """Choose at most `most` candidates that provably cover the body; return None if no proof is found."""
        chosen, best, packed = None, None, None
        for round_ in range(ROUNDS + MORE_ROUNDS):
            # As long as there is no proof, each further round requires the balls to contain the points with more room
            # to spare.
            reserve = min(RESERVE * 1.5 ** max(0, round_ - ROUNDS + 1), 0.9)
            chosen = trial = self.chosen(protrusion, steps, chosen, reserve)
            for _ in range(REPAIRS):
                if best is not None and len(trial) >= best or most is not None and len(trial) > most:
                    break
                model = self.made(trial, protrusion)
                missed, around = first_failures(self.target, model, protrusion)
                if len(missed) == 0:
                    best, packed = len(trial), model
                    break
                self.add_points(missed, around)
                trial = self.chosen(protrusion, 0, trial, reserve)
            if packed is not None and (most is not None or round_ >= ROUNDS - 1):
                return packed
            if most is not None and round_ >= 1 and len(chosen) > most:
                return None
        return packed


def _round(target: Target, kind: str, n: int | None, protrusion: float | None, percentage: Percentage) -> Packed:
    """Fit spheres or capsules."""
    fit = Candidates(target, kind == "capsules", protrusion)
    percentage.report(0.1)
    if protrusion is not None:
        model = fit.proven(protrusion, STEPS)
        if model is None:
            raise _no_proof(kind, n, protrusion)
        return model
    assert n is not None
    # The protrusion must exceed the differences between the radii of the body's surfaces, since elements must contain
    # whole balls about points of the surfaces.
    low, high = max(LEAST_PROTRUSION * target.size, 1.1 * float(np.ptp(target.radius))), target.size
    for step in range(HALVINGS):
        middle = float(np.sqrt(low * high)) if low * 4 < high else (low + high) / 2
        reached = len(fit.chosen(middle, FEW_STEPS)) <= n
        low, high = (low, middle) if reached else (middle, high)
        percentage.report(0.1 + 0.03 * step)
    for _ in range(GROWTHS):
        model = fit.proven(high, STEPS, n)
        if model is not None:
            return model
        high *= 1.03
    raise _no_proof(kind, n, protrusion)


class _Clusters:
    """Clusters of a body's cells, each with an element around it.

    The cluster whose element sticks out most is divided next.
    """

    def __init__(self, target: Target, kind: str, protrusion: float | None) -> None:
        self.target, self.kind = target, kind
        cells = target.triangles
        for _ in range(20):
            length, edge = longest_edges(cells)
            long = length > target.size * CELL
            if not long.any() or len(cells) > MOST_CELLS:
                break
            cells = np.concatenate([cells[~long], halved(cells[long], edge[long])])
        # The cells are triangles of the surface, and cubes in the interior that do not reach the surface. Every cell is
        # stored as eight corners; a triangle repeats some of its corners.
        step = target.size * max(0.025, min(1.5 * CELL, (protrusion or target.size) / target.size))
        self.cell = step
        counts = np.maximum(1, np.ceil((target.high - target.low) / step)).astype(np.int64)
        lattice = target.low + (np.indices(counts).reshape(3, -1).T + 0.5) * (target.high - target.low) / counts
        lattice = lattice[target.holds(lattice)]
        half = np.minimum(step / 2, -target.depths(lattice) / np.sqrt(3.0))
        inside = lattice[:, None] + OCTANTS * half[:, None, None]
        corners = np.concatenate([cells[:, [0, 1, 2, 0, 1, 2, 0, 1]], inside])
        self.points, cells_of = np.unique(corners.reshape(-1, 3), axis=0, return_inverse=True)
        self.cells = cells_of.reshape(-1, 8)
        self.middles = np.concatenate([cells.mean(axis=1), lattice])
        # Elements grow by this length, to allow for rounding and for the decimals in files.
        self.spare = WRITTEN * (target.reach + target.size) + float(target.radius.max())
        self.clusters = [np.arange(len(self.cells))]
        self.elements = [self.element(self.clusters[0])]
        self.excess = [self.sticks(self.elements[0])]

    def element(self, cluster: Ints, more: float = 0.0) -> Packed:
        """Fit an element around cells, enlarged by the length `more`."""
        used = np.zeros(len(self.points), dtype=bool)
        used[self.cells[cluster]] = True
        points = self.points[used]
        if self.kind == "ellipsoids":
            try:
                ball = mvce(points, tol=1e-2).ellipsoid
                axes, turn, center = ball.semi_axes, ball.rotation, ball.center
                least = self.spare + 1e-3 * axes.max()
            except GeometryError:  # the points are flat
                turn, half, center = _box(points)
                axes, least = np.sqrt(3.0) * half, 1e-2 * half.max() + self.spare
            semi_axes = np.maximum(axes + self.spare, least)[None] + more
            return moved(primitives(columns.ELLIPSOID, np.zeros(1), semi_axes), pose_of(turn, center))
        turn, half, center = _box(points)
        half = np.maximum(half + self.spare, 1e-3 * half.max()) + more
        return moved(Packed.of(box_pieces(-half[None], half[None])), pose_of(turn, center))

    def sticks(self, element: Packed) -> float:
        """Estimate how far an element sticks out, from points of its surface."""
        vertices, triangles = of_piece(element, 0)
        return float(self.target.below(np.concatenate([vertices, vertices[triangles].mean(axis=1)])).max())

    def divide(self, k: int) -> None:
        """Halve a cluster across the principal axis for which the two new elements have the least volume."""
        cluster = self.clusters[k]
        away = self.middles[cluster] - self.middles[cluster].mean(axis=0)
        turn = np.linalg.eigh(away.T @ away)[1]
        best = None
        for axis in turn.T:
            height = away @ axis
            cut = height <= height.min() + np.ptp(height) / 2
            if cut.all() or not cut.any():
                continue
            parts = [cluster[cut], cluster[~cut]]
            elements = [self.element(part) for part in parts]
            volume = sum(abs(float(np.linalg.det(element.outer_factor[0]))) for element in elements)
            if best is None or volume < best[0]:
                best = volume, parts, elements
        if best is None:
            raise GeometryError(f"{self.kind}: expected cells that can be divided, found one; use a larger protrusion")
        self.clusters[k : k + 1], self.elements[k : k + 1] = best[1], best[2]
        self.excess[k : k + 1] = [self.sticks(element) for element in best[2]]

    def grow(self, limit: float) -> list[Packed]:
        """Close gaps: grow elements until they stick out as far as allowed, but by no more than the size of a cell."""
        grown = []
        for cluster, element, excess in zip(self.clusters, self.elements, self.excess, strict=True):
            # If a box grows, its corners move farther than its faces.
            more = min((limit - excess) / (np.sqrt(3.0) if self.kind == "boxes" else 1.0), self.cell)
            larger = self.element(cluster, more) if more > 0 else element
            grown.append(larger if self.sticks(larger) <= limit else element)
        return grown

    def hold(self, points: Floats) -> None:
        """Add small cubes around points to the clusters nearest to them."""
        first, corner = len(self.cells), len(self.points) + np.arange(8 * len(points))
        around = points[:, None] + OCTANTS * (AROUND * self.target.size)
        self.points = np.concatenate([self.points, around.reshape(-1, 3)])
        self.cells = np.concatenate([self.cells, corner.reshape(-1, 8)])
        self.middles = np.concatenate([self.middles, points])
        off = [lengths(self.middles[cluster][None] - points[:, None]).min(axis=1) for cluster in self.clusters]
        nearest = np.argmin(off, axis=0)
        for k in np.unique(nearest).tolist():
            self.clusters[k] = np.append(self.clusters[k], first + np.flatnonzero(nearest == k))
            self.elements[k] = self.element(self.clusters[k])
            self.excess[k] = self.sticks(self.elements[k])


def _box(points: Floats) -> tuple[Floats, Floats, Floats]:
    """Return the axes, half edges and center of a box that encloses points and has little area."""
    turn = least_box_axes(np.ascontiguousarray(points.T[:, None, :]))
    if np.linalg.det(turn) < 0:
        turn = turn * [1.0, 1.0, -1.0]
    turned = points @ turn
    low, high = turned.min(axis=0), turned.max(axis=0)
    return turn, (high - low) / 2, turn @ (low / 2 + high / 2)


def _others(target: Target, kind: str, n: int | None, protrusion: float | None, percentage: Percentage) -> Packed:
    """Fit boxes or ellipsoids by dividing clusters of cells."""
    fit = _Clusters(target, kind, protrusion)
    limit = 0.0 if protrusion is None else (0.98 if kind == "boxes" else 0.94) * protrusion
    for _ in range(ROUNDS + GROWTHS):
        while len(fit.elements) < (MOST if n is None else n) and max(fit.excess) > limit:
            fit.divide(int(np.argmax(fit.excess)))
            needed = np.maximum(fit.excess, limit).sum() / limit if limit > 0 else 0.0
            if len(fit.elements) == JUDGED and needed > HOPELESS * MOST:
                break
            done = len(fit.elements) / n if n is not None else limit / max(max(fit.excess), limit)
            percentage.report(0.05 + 0.7 * done)
        if protrusion is not None and max(fit.excess) > limit:
            raise GeometryError(
                f"protrusion: expected one that at most {MOST} {kind} reach, found {protrusion:g} m; use a larger "
                "protrusion, or spheres"
            )
        packed = as_one(fit.elements if protrusion is None else fit.grow(limit))
        missed, _ = first_failures(target, packed, max(fit.excess) if protrusion is None else protrusion)
        if len(missed):
            fit.hold(missed[:: max(1, len(missed) // 60)])
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
    raise _no_proof(kind, n, protrusion)


def _no_proof(kind: str, n: int | None, protrusion: float | None) -> GeometryError:
    """Make the error for a search that found no proof within the number of elements or within the protrusion."""
    if protrusion is None:
        return GeometryError(f"n: expected a number of {kind} that suffices, found {n}, and no proof")
    return GeometryError(f"protrusion: expected one that {kind} reach, found {protrusion:g} m, and no proof")


def cover(
    packed: Packed, kind: str, n: int | None, protrusion: float | None, progress: Progress
) -> tuple[Packed, float]:
    """Fit elements of one kind to a body, and bound how far the elements stick out; see `Body.cover`."""
    target, percentage = Target(packed), Percentage(progress)
    least, most = LEAST_PROTRUSION * target.size, LARGEST_PROTRUSION * target.size
    if protrusion is not None and not least <= protrusion <= most:
        raise InputError(
            f"protrusion: expected at least {least:.3g} m and at most {most:.3g} m, 1e-4 and 1e4 times the body's "
            f"diagonal, found {protrusion:g}"
        )
    percentage.report()
    fit = _round if kind in ("spheres", "capsules") else _others
    model = fit(target, kind, n, protrusion, percentage)
    proof = prove(packed, model, None)
    if proof.outcome != "covered":
        raise GeometryError(f"cover: expected a proof that the {kind} hold the body, found {proof.outcome}")
    percentage.done()
    return model, proof.excess[1]
