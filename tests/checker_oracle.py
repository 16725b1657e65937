"""What a checker must say, pair by pair with the public queries; and robots and scenes made at random."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from loewner import Body, CollisionChecker, Robot, Scene
from loewner.queries import pairs as queries

KINDS = ("revolute", "continuous", "prismatic", "planar", "floating", "fixed")

# Curved pieces so close, relative to the lengths, may count as touching or not: see docs/certified.md.
TOUCHING = 1e-12


def pose(rng: np.random.Generator, spread: float, center=(0.0, 0.0, 0.0)) -> np.ndarray:
    T = np.eye(4)
    if isinstance(rng, np.random.Generator):
        T[:3, :3] = Rotation.random(random_state=int(rng.integers(2**31))).as_matrix()
    else:  # the generator of `answers.py`
        T[:3, :3] = rng.rotation()
    T[:3, 3] = center + rng.normal(size=3) * spread
    return T


def cluster(rng: np.random.Generator, pieces: int) -> Body:
    """Small hulls scattered over a third of a metre."""
    return Body.from_pieces(rng.normal(size=(9, 3)) * 0.03 + rng.normal(size=3) * 0.1 for _ in range(pieces))


def simple_bodies(rng: np.random.Generator) -> list[Body]:
    """One piece each, all kinds."""
    return [
        Body.box(rng.uniform(0.05, 0.3, 3)), Body.box([0.4, 0.3, 1e-4]), Body.sphere(0.1), Body.cylinder(0.05, 0.4),
        Body.cone(0.1, 0.2), Body.capsule(0.04, 0.3), Body.ellipsoid([0.05, 0.1, 0.2]),
        Body.from_points(rng.normal(size=(20, 3)) * 0.1), Body.from_points(rng.normal(size=(300, 3)) * 0.05),
    ]  # fmt: skip


def composed_bodies(rng: np.random.Generator) -> list[Body]:
    """Few pieces, which are all tried, and many, which have a tree; polytopes and curved ones."""
    mixed = [body.transformed(pose(rng, 0.1)) for body in simple_bodies(rng)[:6]]
    return [*(cluster(rng, pieces) for pieces in (2, 5, 20, 100)), Body.union(mixed)]


def robot_of(folder: Path, joints, bodies: dict[str, Body] | None = None) -> Robot:
    """Links l0, l1 ... with any bodies, on joints given as (kind, parent, inside of the tag)."""
    joints = [  # a range of a continuous joint causes a warning
        (kind, parent, re.sub("<limit[^>]*/>", "", inside) if kind == "continuous" else inside)
        for kind, parent, inside in joints
    ]
    links = "".join(f'<link name="l{k}"/>' for k in range(len(joints) + 1))
    tags = "".join(
        f'<joint name="j{k}" type="{kind}"><parent link="l{parent}"/><child link="l{k}"/>{inside}</joint>'
        for k, (kind, parent, inside) in enumerate(joints, 1)
    )
    path = folder / "robot.urdf"
    path.write_text(f'<robot name="r">{links}{tags}</robot>')
    return replace(Robot.from_urdf(path), bodies=bodies or {})


def random_robot(rng: np.random.Generator, folder: Path, links: int, bodies: list[Body]) -> Robot:
    joints = []
    for k in range(1, links):
        x, turn, axis = rng.normal(size=3) * 0.3, rng.uniform(-3, 3, 3), rng.normal(size=3)
        kind = KINDS[rng.integers(len(KINDS))]
        joints.append((
            kind, rng.integers(max(0, k - 2), k),
            f'<origin xyz="{x[0]} {x[1]} {x[2]}" rpy="{turn[0]} {turn[1]} {turn[2]}"/>'
            f'<axis xyz="{axis[0]} {axis[1]} {axis[2]}"/>'
            + '<limit lower="-2" upper="2"/>' * (kind in ("revolute", "prismatic")),
        ))  # fmt: skip
    chosen = {f"l{k}": bodies[rng.integers(len(bodies))] for k in range(links) if rng.random() < 0.85}
    return robot_of(folder, joints, chosen)


def random_scene(rng: np.random.Generator, robot: Robot, count: int, bodies: list[Body]) -> Scene:
    """Bodies about the robot, some of them attached, with margins of all kinds."""
    scene = Scene(margin=float(rng.choice([0.0, 0.02])))
    for k in range(count):
        scene.add(f"b{k}", bodies[rng.integers(len(bodies))], pose(rng, 0.6))
        if rng.random() < 0.2:
            scene.attach(f"b{k}", str(rng.choice(robot.link_names)), pose(rng, 0.2), touch_links=robot.link_names[:1])
    names = [*scene.names, *robot.link_names]
    for _ in range(rng.integers(0, 6)):
        against = "links" if rng.random() < 0.4 else None
        name = None if against and rng.random() < 0.3 else names[rng.integers(len(names))]
        lower = bool(rng.random() < 0.5)
        scene.set_margin(float(rng.choice([0.0, 1e-3, 0.05])), name, against=against, lower=lower)
    for _ in range(rng.integers(0, 4) if len(names) > 1 else 0):
        a, b = (str(name) for name in rng.choice(names, 2, replace=False))
        scene.set_margin(float(rng.choice([0.0, 1e-3, 0.05])), a, b, lower=bool(rng.random() < 0.5))
        if rng.random() < 0.3:
            scene.allow(a, b)
    return scene


def expected_pairs(robot: Robot, scene: Scene, skip: frozenset = frozenset()) -> set[frozenset[str]]:
    """Pairs of which one moves against the other, but for those that may touch; written from the documents."""
    held = scene.attachments
    carrier = {name: name for name in robot.bodies} | {name: how.link for name, how in held.items()}
    parent, kind = robot.tree.parent, robot.tree.kind
    at = {name: k for k, name in enumerate(robot.link_names)}
    thing = {name: int(parent[at[link]] if kind[at[link]] == 0 else at[link]) for name, link in carrier.items()}
    names = [*carrier, *scene.static_names]
    pairs = set()
    for i, a in enumerate(names):
        for b in names[i + 1 :]:
            if a not in carrier or (b in carrier and thing[a] == thing[b]):
                continue
            if tuple(sorted((a, b))) in robot.disabled_pairs | scene.allowed | skip:
                continue
            if any(x in held and y in held[x].touch_links for x, y in ((a, b), (b, a))):
                continue
            pairs.add(frozenset((a, b)))
    return pairs


def margin_of(scene: Scene, a: str, b: str) -> float:
    """The largest that holds, but for those that a more specific one was set to lower; written from the documents."""
    rules = {((), False): scene.margin, **{(key, key in scene.lowered): m for key, m in scene.margins.items()}}

    def holds(key) -> bool:
        if key in ((), (None, None)):
            return (a in scene or b in scene) == (key == ())
        x, y = (a, b) if key[0] == a else (b, a)
        return key[0] == x and (len(key) == 1 or key[1] == y or (key[1] is None and y not in scene))

    def rank(key) -> int:
        return 0 if key in ((), (None, None)) else 1 if len(key) == 1 or None in key else 2

    holding = [(rank(key), lower, margin) for (key, lower), margin in rules.items() if holds(key)]
    least = max((rank for rank, lower, _ in holding if lower), default=0)
    return max((margin for rank, _, margin in holding if rank >= least), default=0.0)


def pairwise(checker: CollisionChecker, Q: np.ndarray, query, **options):
    """Answers of a query for each pair and configuration, as a list with an entry a pair."""
    robot, scene = checker.robot, checker.scene
    poses = robot.forward_kinematics(Q)
    at = {name: k for k, name in enumerate(robot.link_names)}

    def placed(name):
        if name in at:
            return robot.bodies[name], poses[:, at[name]]
        if name in scene.attachments:
            how = scene.attachments[name]
            return scene[name].transformed(how.T_link_body), poses[:, at[how.link]]
        return scene[name], np.broadcast_to(scene.pose(name), (len(Q), 4, 4))

    out = []
    for a, b in checker.checked_pairs:
        keep = margin_of(scene, a, b)
        assert scene.margin_of(a, b) == keep
        margin = {} if query is queries.distance else {"margin": keep}
        out.append(query(*placed(a), *placed(b), **margin, **options))
    return out


def agrees(checker: CollisionChecker, Q: np.ndarray) -> np.ndarray:
    """Check collide and classify against the queries pair by pair; returns the answers of collide."""
    expected = np.array(pairwise(checker, Q, queries.collide)).reshape(-1, len(Q))
    verdicts = np.array(pairwise(checker, Q, queries.classify)).reshape(-1, len(Q))
    found, certified = checker.collide(Q), checker.classify(Q)
    np.testing.assert_array_equal(found, expected.any(axis=0))
    assert not (found & (certified == 0)).any()
    assert not (~found & (certified == 1)).any()
    # The checker has boxes and balls besides: it may prove more, and never less.
    assert (certified[(verdicts == 0).all(axis=0)] == 0).all()
    assert (certified[(verdicts == 1).any(axis=0)] == 1).all()
    return found
