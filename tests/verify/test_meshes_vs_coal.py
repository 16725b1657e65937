"""Two real meshes from files: decomposed, fitted, saved, loaded, and compared with Coal on the same pieces."""

import warnings
from pathlib import Path

import numpy as np
import pytest

import loewner
from families import random_poses
from loewner import Body, Verdict
from oracles import hull, naive_distance, pack, signed_distances

pytestmark = pytest.mark.verify

POSES = 1000


def panda(kind: str, name: str) -> Path:
    """A mesh of the Panda robot, from the example-robot-data package."""
    prefix = pytest.importorskip("cmeel").__path__[0]
    path = Path(prefix).parent / "cmeel.prefix/share/example-robot-data/robots/panda_description/meshes" / kind / name
    if not path.exists():
        pytest.skip("example-robot-data is not installed")
    return path


# The collision meshes are convex as they come; the visual ones are real parts, to be decomposed.
@pytest.fixture(scope="module", params=["collision/link5.stl collision/hand.stl", "visual/link5.dae visual/finger.dae"])
def bodies(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> list[Body]:
    """Read, decomposed, fitted, saved and loaded."""
    pytest.importorskip("coacd")
    folder = tmp_path_factory.mktemp("bodies")
    out = []
    for source in request.param.split():
        kind, name = source.split("/")
        with warnings.catch_warnings():
            # The visual meshes are not closed, which is told; their pieces are what is compared here.
            warnings.filterwarnings("ignore", r".*: has holes")
            made = Body.from_mesh(panda(kind, name))
        assert (len(made.pieces) > 1) == (kind == "visual")
        made.save(folder / f"{name}.npz")
        out.append(Body.load(folder / f"{name}.npz"))
    return out


def poses(a: Body, b: Body, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Poses about contact: b's centre within twice the reach of a's."""
    rng = np.random.default_rng(31)
    Ta, Tb = random_poses(rng, count, 1.0), random_poses(rng, count, 1.0)
    clouds = [np.concatenate([p.vertices for p in body.pieces]) for body in (a, b)]
    middle = [(cloud.min(axis=0) + cloud.max(axis=0)) / 2 for cloud in clouds]
    reach = sum(np.ptp(cloud, axis=0).max() for cloud in clouds) / 2
    along = rng.normal(size=(count, 3))
    along *= (rng.uniform(0, 1.3, size=count) * reach / np.linalg.norm(along, axis=1))[:, None]
    centre_a = Ta[:, :3, :3] @ middle[0] + Ta[:, :3, 3]
    Tb[:, :3, 3] = centre_a + along - Tb[:, :3, :3] @ middle[1]
    return Ta, Tb


def test_no_disagreement_with_coal(bodies: list[Body]):
    """On 1,000 poses every exact answer is Coal's, every certified verdict is consistent with it."""
    coal = pytest.importorskip("coal")
    a, b = bodies
    Ta, Tb = poses(a, b, POSES)

    def convex(piece: loewner.Piece) -> object:
        points = coal.StdVec_Vec3s()
        for x in piece.vertices:
            points.append(x)
        return coal.Convex.convexHull(points, True, None)

    parts = [[convex(p) for p in body.pieces] for body in bodies]
    nearest = np.full(POSES, np.inf)
    request, result = coal.DistanceRequest(), coal.DistanceResult()
    for k in range(POSES):
        Xa, Xb = (coal.Transform3s(T[k, :3, :3], T[k, :3, 3]) for T in (Ta, Tb))
        for p in parts[0]:
            for q in parts[1]:
                result.clear()
                # The signed distance is Coal's path without known wrong answers; its boolean has some.
                nearest[k] = min(nearest[k], coal.distance(p, Xa, q, Xb, request, result))
    # What Coal's tolerance of 1e-6 m cannot tell is judged by the separating axes.
    pools = [pack(hull(p.vertices) for p in body.pieces) for body in bodies]
    doubtful = np.flatnonzero(np.abs(nearest) < 1e-5)
    for k in doubtful:
        nearest[k] = signed(pools, Ta[k], Tb[k])
    coal_says = nearest <= 0

    verdict = loewner.classify(a, Ta, b, Tb)
    exact = loewner.collide(a, Ta, b, Tb)
    distances = loewner.distance(a, Ta, b, Tb, exact=True)
    tiers = np.bincount(verdict, minlength=3)
    print(
        f"\n{len(a.pieces)} x {len(b.pieces)} pieces, {POSES} poses: free {tiers[0]}, colliding {tiers[1]}, "
        f"ambiguous {tiers[2]}; colliding by Coal {coal_says.sum()}, judged by axes {len(doubtful)}, "
        f"disagreements {(exact != coal_says).sum()}"
    )
    assert 0.2 < coal_says.mean() < 0.8
    assert np.array_equal(exact, coal_says)
    assert not ((verdict == Verdict.FREE) & coal_says).any()
    assert not ((verdict == Verdict.COLLIDING) & ~coal_says).any()
    apart = ~coal_says
    assert distances.distance[apart] == pytest.approx(nearest[apart], abs=1e-5)
    assert (distances.lower <= distances.distance + 1e-12).all()
    assert (distances.distance <= distances.upper + 1e-12).all()


def signed(pools, Ta: np.ndarray, Tb: np.ndarray) -> float:
    """Least signed distance over all piece pairs, by the oracles."""
    a, b = pools
    i, j = (x.ravel() for x in np.meshgrid(np.arange(a.size), np.arange(b.size)))
    many = [np.repeat(T[None], len(i), axis=0) for T in (Ta, Tb)]
    gap, _ = signed_distances(a, i, many[0], b, j, many[1])
    for p in np.flatnonzero(gap > 0):
        gap[p] = naive_distance(a.hull(i[p]), Ta, b.hull(j[p]), Tb)[0]
    return float(gap.min())


def test_fits_survive_the_file(bodies: list[Body]):
    """After the round trip every piece still lies between its ellipsoids."""
    for body in bodies:
        for k, piece in enumerate(body.pieces):
            u = np.linalg.solve(body.outer.factor[k], (piece.vertices - body.outer.center[k]).T)
            assert np.linalg.norm(u, axis=0).max() <= 1 + 1e-13
            reach = piece.normals @ body.inner.center[k]
            reach = reach + np.linalg.norm(piece.normals @ body.inner.factor[k], axis=1)
            assert (reach <= piece.offsets + 1e-14).all()
