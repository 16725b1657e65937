"""Robots whose links are surfaces of all kinds, and motions that bring them near each other or one into another."""

from pathlib import Path

import numpy as np
import trimesh

from checker_oracle import robot_of
from families import translation
from loewner import Body, CollisionChecker, Robot, Scene
from surface_oracle import Mesh, collides

# A carriage that moves along three axes and turns about two, twice: each has a body.
SLIDES = [f'<axis xyz="{axis}"/><limit lower="-3" upper="3"/>' for axis in ("1 0 0", "0 1 0", "0 0 1")]
TURNS = ['<origin xyz="0.1 0 0"/><axis xyz="0 0.6 0.8"/>', '<origin xyz="0 0.1 0"/><axis xyz="1 0 0"/>']
KINDS = [("prismatic", slide) for slide in SLIDES] + [("continuous", turn) for turn in TURNS]


def joints(branches: int) -> list[tuple[str, int, str]]:
    """Joints of as many carriages, for `checker_oracle.robot_of`."""
    made, last = [], 0
    for _ in range(branches):
        above = 0
        for kind, inside in KINDS:
            made.append((kind, above, inside))
            last += 1
            above = last
    return made


def inverted(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    mesh = mesh.copy()
    mesh.invert()
    return mesh


def joined(*meshes: trimesh.Trimesh) -> tuple[np.ndarray, np.ndarray]:
    both = trimesh.util.concatenate(meshes)
    return np.asarray(both.vertices), np.asarray(both.faces)


def meshes() -> dict[str, tuple[tuple[np.ndarray, np.ndarray], bool]]:
    """Meshes about 1 m wide, and whether they are solid."""
    make = trimesh.creation
    ball, inner = make.icosphere(2, 0.5), make.icosphere(1, 0.4)
    bent = make.icosphere(2, 0.5)
    bent.vertices *= 1 + 0.3 * np.sin(9 * bent.vertices[:, :1] + 4 * bent.vertices[:, 1:2])
    cup = make.revolve([(0, -0.5), (0.4, -0.5), (0.4, 0.5), (0.38, 0.5), (0.38, -0.48), (0, -0.48)], sections=10)
    box = make.box((1, 0.8, 0.6))
    return {
        "box": (joined(box), True),
        "bent": (joined(bent), True),
        "cup": (joined(cup), True),
        "ring": (joined(make.torus(0.4, 0.08, 12, 6)), True),
        "cave": (joined(ball, inverted(inner)), True),
        "cave with a kernel": (joined(ball, inverted(inner), make.icosphere(1, 0.15)), True),
        "two": (joined(make.box((0.2, 0.2, 1)).apply_translation([0.4, 0, 0]), make.box((0.2, 0.9, 0.2))), True),
        "skin": (joined(ball), False),
        "open": ((np.asarray(box.vertices), np.asarray(box.faces)[2:]), False),
        "sheet": ((np.array([[-0.5, -0.5, 0], [0.5, -0.5, 0.1], [0.5, 0.5, 0], [-0.5, 0.5, 0.1]]),
                   np.array([[0, 1, 2], [0, 2, 3]])), False),
    }  # fmt: skip


class Case:
    """A robot of one or two bodies, each on a carriage of its own, and maybe one that stands.

    Attributes
    ----------
    checker : CollisionChecker
    meshes : dict of str to Mesh
        The bodies that are surfaces without a radius, for the oracle.
    """

    def __init__(self, folder: Path, rng: np.random.Generator) -> None:
        known, self.meshes, bodies = meshes(), dict[str, Mesh](), dict[str, Body]()
        branches = 1 + int(rng.random() < 0.6)
        names = [f"l{len(KINDS) * (k + 1)}" for k in range(branches)]
        if branches == 1 or rng.random() < 0.4:
            names.append("standing")
        for name in names:
            (vertices, faces), solid = known[str(rng.choice(list(known)))]
            vertices = vertices * 10.0 ** rng.uniform(-0.9, 0.3)
            if rng.random() < 0.2:
                bodies[name] = Body.from_points(vertices)
                continue
            radius = 0.0 if solid or rng.random() < 0.7 else rng.uniform(0.01, 0.05)
            bodies[name] = Body.from_surface((vertices, faces), solid=solid, radius=radius)
            if radius == 0.0:
                self.meshes[name] = Mesh(vertices, faces, solid)
        self.scene = Scene()
        if "standing" in bodies:
            self.scene.add("standing", bodies.pop("standing"), translation(*rng.uniform(-0.3, 0.3, 3)))
        self.robot: Robot = robot_of(folder, joints(branches), bodies)
        self.checker = CollisionChecker(self.robot, self.scene)

    def starts(self, rng: np.random.Generator, count: int) -> np.ndarray:
        """Configurations with the bodies near each other, some of them with one inside the other."""
        Q = self.robot.random_configurations(count, int(rng.integers(2**31)))
        slides = [k for k in range(Q.shape[1]) if k % len(KINDS) < 3]
        Q[:, slides] = rng.normal(size=(count, len(slides))) * rng.choice([0.02, 0.2, 0.8], (count, 1))
        return Q

    def collides(self, Q: np.ndarray) -> np.ndarray:
        """Whether configurations collide: by whole numbers, or for other bodies than meshes, by the checker."""
        ready, hit = self.checker._ready(), np.zeros(len(Q), dtype=bool)
        poses, rest = ready.poses(np.ascontiguousarray(Q)), False
        for a, b in ready.pairs.tolist():
            one, other = self.meshes.get(ready.names[a]), self.meshes.get(ready.names[b])
            if one is None or other is None:
                rest = True
            else:
                hit |= collides(one, poses[:, a], other, poses[:, b])
        return hit | self.checker.collide(Q) if rest else hit
