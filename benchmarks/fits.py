"""Fits of hulls of 20 random points, loewner beside cvxpy + Clarabel, in one run, on one thread.

    python benchmarks/fits.py [hulls]
    python benchmarks/fits.py large      only smallest ellipsoids in high dimension, and of many points
    python benchmarks/fits.py inside     only largest ellipsoids in many half-spaces, in high dimension
    python benchmarks/fits.py outliers   only outliers among points, beside scikit-learn's MinCovDet
    python benchmarks/fits.py many       only bodies of very many points, beside SciPy's hull alone

Prints medians per fit and their ratios. Large fits are compared with the ascent of Wolfe and Atwood, as Todd and
Yıldırım give it, in plain NumPy and in processor time. cvxpy is timed as a first user writes it, the problem built anew
for each hull with the faces in one vectorised constraint, and by the solver's own clock alone. MinCovDet answers a like
question, where most of the points are, by another ellipsoid; scikit-learn is in requirements/bench.txt.
"""

import argparse
import os
import time
from collections.abc import Callable, Iterable

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("RAYON_NUM_THREADS", "1")

import cvxpy as cp
import numpy as np
from scipy.spatial import ConvexHull

import loewner
from loewner._kernels.fits.mvce import fit_outer
from loewner.ellipsoids import fits, polytopes

TOL = 1e-4
# Points and dimension of the large fits, their tolerance, and the seconds after which the rival is stopped.
LARGE = ((300, 100), (2000, 100), (5000, 500), (100_000, 30), (1_000_000, 10), (10_000_000, 3))
LARGE_TOL, PATIENCE = 1e-6, 60.0
# Half-spaces and dimension of the large fits inside them, and whether conic solvers are asked as well.
INSIDE = ((100, 10, True), (500, 20, True), (1000, 50, False), (100_000, 10, False), (10_000, 100, False))
# Points of the bodies of very many: on a sphere, where all are vertices, and in a ball, where few are.
ON_SPHERE, IN_BALL = (2_000, 20_000, 200_000), (100_000, 1_000_000, 5_000_000)


def hull_points(rng: np.random.Generator, count: int = 20) -> np.ndarray:
    """Points uniform in the unit ball."""
    return sphere_points(rng, count) * rng.uniform(size=(count, 1)) ** (1 / 3)


def sphere_points(rng: np.random.Generator, count: int) -> np.ndarray:
    """Points uniform on the unit sphere."""
    x = rng.normal(size=(count, 3))
    return x / np.linalg.norm(x, axis=1, keepdims=True)


def conic_inside(A: np.ndarray, b: np.ndarray, solver: str) -> float:
    """Log-volume that cvxpy reports, by its vectorised model."""
    n = A.shape[1]
    E, c = cp.Variable((n, n), PSD=True), cp.Variable(n)
    problem = cp.Problem(cp.Maximize(cp.log_det(E)), [cp.norm(A @ E, axis=1) + A @ c <= b])
    return float(problem.solve(solver=solver))


def median_time(run: Callable[[object], object], items: Iterable[object]) -> float:
    times = []
    for item in items:
        start = time.perf_counter()
        run(item)
        times.append(time.perf_counter() - start)
    return float(np.median(times))


def conic_inner(piece: polytopes.Polytope) -> float:
    E, c = cp.Variable((3, 3), PSD=True), cp.Variable(3)
    rows = [cp.norm(piece.normals @ E, axis=1) + piece.normals @ c <= piece.offsets]
    problem = cp.Problem(cp.Maximize(cp.log_det(E)), rows)
    problem.solve(solver=cp.CLARABEL)
    return float(problem.solver_stats.solve_time)


def conic_outer(piece: polytopes.Polytope) -> float:
    H, g = cp.Variable((3, 3), PSD=True), cp.Variable((1, 3))
    problem = cp.Problem(cp.Maximize(cp.log_det(H)), [cp.norm(piece.vertices @ H - g, axis=1) <= 1])
    problem.solve(solver=cp.CLARABEL)
    return float(problem.solver_stats.solve_time)


def batch_time(packed: polytopes.Hulls, tol: float = TOL) -> float:
    start = time.perf_counter()
    fits.fit_pieces(packed.vert_start, packed.vertices, packed.face_start, packed.normals, tol)
    return (time.perf_counter() - start) / len(packed)


def outer_time(packed: polytopes.Hulls) -> float:
    """The kernel's outer fits alone; what is left of the batch is the inner fits."""
    center, factor = np.empty(3), np.empty((3, 3))
    pieces = [packed.vertices[i:j] for i, j in zip(packed.vert_start[:-1], packed.vert_start[1:], strict=True)]
    start = time.perf_counter()
    for V in pieces:
        fit_outer(V, TOL, polytopes.FLATNESS, center, factor)
    return (time.perf_counter() - start) / len(packed)


def ascent(points: np.ndarray, tol: float) -> float:
    """Gap that Wolfe and Atwood's ascent, from Kumar and Yıldırım's points, reaches within `PATIENCE`."""
    m, n = points.shape
    N = n + 1
    Q = np.column_stack([np.ones(m), points])
    u = np.zeros(m)
    u[spread(points)] = 1.0
    u /= u.sum()
    inverse = np.linalg.inv((Q * u[:, None]).T @ Q)
    w = np.einsum("ij,ij->i", Q @ inverse, Q)
    gap = np.inf
    start = time.process_time()
    while time.process_time() < start + PATIENCE:
        j = int(w.argmax())
        gap = 0.5 * n * np.log((w[j] - 1) / n)
        if gap <= tol:
            break
        support = np.flatnonzero(u)
        k = int(support[w[support].argmin()])
        if N - w[k] > w[j] - N:
            j = k
        step = max((w[j] - N) / (N * (w[j] - 1)), -u[j] / (1 - u[j]))
        g = inverse @ Q[j]
        z = Q @ g
        share = step / (1 - step + step * w[j])
        inverse = (inverse - share * np.outer(g, g)) / (1 - step)
        w = (w - share * z * z) / (1 - step)
        u *= 1 - step
        u[j] += step
        if u[j] < 1e-15:
            u[j] = 0.0
    return float(gap)


def spread(points: np.ndarray) -> np.ndarray:
    """The two points farthest apart along each of n directions, orthogonal to the differences before."""
    rng, n = np.random.default_rng(0), points.shape[1]
    basis, chosen = np.zeros((0, n)), []
    for _ in range(n):
        direction = rng.normal(size=n)
        direction -= basis.T @ (basis @ direction)
        along = points @ direction
        chosen += [along.argmin(), along.argmax()]
        difference = points[chosen[-1]] - points[chosen[-2]]
        difference -= basis.T @ (basis @ difference)
        basis = np.concatenate([basis, difference[None] / np.linalg.norm(difference)])
    return np.unique(chosen)


def large_fits() -> None:
    rng = np.random.default_rng(0)
    fits.mvce(rng.normal(size=(50, 20)))  # import what it imports
    print(f"mvce of normal points to {LARGE_TOL:g}, processor seconds, beside Wolfe and Atwood's ascent in NumPy")
    for m, n in LARGE:
        points = rng.normal(size=(m, n))
        times = []
        for _ in range(5 if m * n < 1e6 else 2):
            start = time.process_time()
            gap = fits.mvce(points, tol=LARGE_TOL).gap
            times.append(time.process_time() - start)
        start = time.process_time()
        reached = ascent(points, LARGE_TOL)
        rival = time.process_time() - start
        more = "" if reached <= LARGE_TOL else f", stopped at a gap of {reached:.1e}"
        own = min(times)
        print(f"{m:9} points, dimension {n:4}: {own:8.3f}, gap {gap:.0e}; ", end="")
        print(f"ascent {rival:.2f}{more}, {rival / own:.1f} times", flush=True)


def inside() -> None:
    rng = np.random.default_rng(0)
    fits.mvie(rng.normal(size=(3000, 10)), np.ones(3000))  # import what it imports
    print(f"mvie of normal half-spaces to {TOL:g}, processor seconds, beside cvxpy")
    for m, n, conic in INSIDE:
        A, b = rng.normal(size=(m, n)), rng.uniform(1, 2, size=m)
        times, log_det = [], 0.0
        for _ in range(5 if m * n < 1e6 else 1):
            start = time.process_time()
            fit = fits.mvie(A, b, tol=TOL)
            times.append(time.process_time() - start)
            log_det = np.linalg.slogdet(fit.ellipsoid.factor)[1]
        print(f"{m:9} half-spaces, dimension {n:4}: {min(times):8.4f}, gap {fit.gap:.0e}", end="", flush=True)
        for solver in (cp.CLARABEL, cp.SCS) if conic else ():
            start = time.process_time()
            value = conic_inside(A, b, solver)
            rival = time.process_time() - start
            print(
                f"; {solver} {rival:.2f}, off by {value - log_det:+.0e}, {rival / min(times):.0f} times",
                end="",
                flush=True,
            )
        print()


def outliers() -> None:
    from sklearn.covariance import MinCovDet

    rng = np.random.default_rng(0)
    print("normal points, a share of them four times as wide: how many of these are found, processor seconds")
    for m, n, share in ((500, 5, 0.1), (2000, 10, 0.1), (2000, 30, 0.2)):
        points = rng.normal(size=(m, n))
        bad = np.arange(m) < share * m
        points[bad] *= 4.0
        start = time.process_time()
        kept = peeled(points, int((1 - share) * m))
        own = time.process_time() - start
        start = time.process_time()
        distance = MinCovDet(support_fraction=1 - share, random_state=0).fit(points).mahalanobis(points)
        rival = time.process_time() - start
        named = np.argsort(-distance)[: int(bad.sum())]
        print(f"{m} points, dimension {n}, {share:.0%} wide: ", end="")
        print(f"mvce, peeled: {bad[~kept].sum() / bad.sum():.0%} in {own:.2f}; ", end="")
        print(f"MinCovDet: {bad[named].sum() / bad.sum():.0%} in {rival:.2f}, {rival / own:.1f} times", flush=True)


def peeled(points: np.ndarray, count: int) -> np.ndarray:
    """Which points are left after those with most weight have been taken off, round by round (Titterington 1978)."""
    kept = np.ones(len(points), bool)
    while kept.sum() > count:
        weights = np.zeros(len(points))
        weights[kept] = fits.mvce(points[kept], tol=1e-2, weights=True).weights
        most = min(int(kept.sum()) - count, max(1, int((weights > 0).sum()) // 2))
        kept[np.argsort(-weights)[:most]] = False
    return kept


def many_points() -> None:
    rng = np.random.default_rng(0)
    available = loewner.get_num_threads()
    loewner.set_num_threads(1)
    loewner.Body.from_points(sphere_points(rng, 1_000))  # compile, and import what it imports
    print("Body.from_points, seconds on one thread, beside scipy.spatial.ConvexHull of the same points; best of two")
    for where, make, counts in (("on a sphere", sphere_points, ON_SPHERE), ("in a ball", hull_points, IN_BALL)):
        for count in counts:
            points = make(rng, count)
            own, hull = [], []
            for _ in range(2):
                start = time.perf_counter()
                body = loewner.Body.from_points(points)
                own.append(time.perf_counter() - start)
                start = time.perf_counter()
                ConvexHull(points)
                hull.append(time.perf_counter() - start)
            vertices = len(body.pieces[0].vertices)
            times = f"{min(own):7.3f}, hull alone {min(hull):7.3f}"
            print(f"{count:9} {where:11}, {vertices:6} vertices: {times}", flush=True)
    loewner.set_num_threads(available)


def main() -> None:
    sections = {"large": large_fits, "inside": inside, "outliers": outliers, "many": many_points}
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("asked", nargs="?", default="20000", help=f"{', '.join(sections)}, or a number of hulls")
    asked = parser.parse_args().asked
    if asked in sections:
        return sections[asked]()
    if not asked.isdecimal():
        parser.error(f"expected {', '.join(sections)}, or a number of hulls, found {asked!r}")
    count = int(asked)
    rng = np.random.default_rng(0)
    available = loewner.get_num_threads()
    loewner.set_num_threads(1)
    sets = [hull_points(rng) for _ in range(count)]
    polytopes.hulls(sets[:2])  # compile
    start = time.perf_counter()
    packed = polytopes.hulls(sets)
    hull = (time.perf_counter() - start) / count
    pieces = [polytopes.Polytope.from_points(x) for x in sets[:100]]
    vertices, faces = np.diff(packed.vert_start).mean(), np.diff(packed.face_start).mean()
    print(f"{count} hulls of 20 points, {vertices:.1f} vertices and {faces:.1f} faces on average")
    print(f"tolerance {TOL:g} in log-volume, one thread")

    # Once each beforehand: compile, and let cvxpy import what it imports.
    fits.mvce(sets[0]), fits.mvie(pieces[0].normals, pieces[0].offsets), batch_time(packed)
    conic_inner(pieces[0]), conic_outer(pieces[0])

    # Interleaved, so that all meet the same machine.
    both, outers, solver_inner, solver_outer = [batch_time(packed)], [outer_time(packed)], [], []
    conic_in = median_time(lambda p: solver_inner.append(conic_inner(p)), pieces)
    both.append(batch_time(packed))
    outers.append(outer_time(packed))
    conic_out = median_time(lambda p: solver_outer.append(conic_outer(p)), pieces)
    both.append(batch_time(packed))
    outers.append(outer_time(packed))
    outer = float(np.median(outers))
    inner = float(np.median(both)) - outer
    single_outer = median_time(fits.mvce, sets[:1000])
    single_inner = median_time(lambda p: fits.mvie(p.normals, p.offsets), pieces * 10)

    print(f"{'microseconds per fit':36}{'inner':>10}{'outer':>10}")
    rows = (
        ("loewner, batched", inner, outer),
        ("loewner, one call of mvie(A, b), mvce", single_inner, single_outer),
        ("cvxpy + Clarabel", conic_in, conic_out),
        ("Clarabel's own clock", float(np.median(solver_inner)), float(np.median(solver_outer))),
    )
    for name, *times in rows:
        print(f"{name:36}" + "".join(f"{t * 1e6:10.1f}" for t in times))
    print(f"{'ratio, cvxpy to batched':36}{conic_in / inner:10.0f}{conic_out / outer:10.0f}")
    print(f"{'ratio, cvxpy to one call':36}{conic_in / single_inner:10.0f}{conic_out / single_outer:10.0f}")
    print(f"{'ratio, solver alone to batched':36}{rows[3][1] / inner:10.0f}{rows[3][2] / outer:10.0f}")
    print(f"hull (Qhull, faces, checks): {hull * 1e6:.1f} us")
    print(f"both fits at tolerance 1e-9: {batch_time(packed, 1e-9) * 1e6:.1f} us")

    loewner.set_num_threads(available)
    many = float(np.median([batch_time(packed) for _ in range(3)]))
    speed_up = (inner + outer) / many
    print(f"both fits on {available} threads: {many * 1e6:.1f} us, {speed_up:.2f} times one thread")

    for m, n in ((100_000, 3), (100_000, 10), (1_000_000, 3)):
        x = rng.normal(size=(m, n))
        start = time.perf_counter()
        gap = fits.mvce(x, tol=1e-7).gap
        print(f"mvce of {m} normal points in dimension {n}: {time.perf_counter() - start:.3f} s, gap {gap:.1e}")
    large_fits()
    inside()
    many_points()


if __name__ == "__main__":
    main()
