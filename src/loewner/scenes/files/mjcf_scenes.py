"""Convert MuJoCo models to scenes of static bodies."""

from pathlib import Path

from loewner.ellipsoids.fits import DEFAULT_TOLERANCE
from loewner.scenes.mjcf_models import read_mjcf
from loewner.scenes.scene import Scene

# Extensions of model files; other scene files are YAML.
MJCF_SUFFIXES = (".xml", ".mjcf")


def mjcf_scene(file: Path) -> Scene:
    """Make a scene of all colliding geoms, with joints at their references; allow the pairs that MuJoCo skips."""
    model, scene = read_mjcf(file, DEFAULT_TOLERANCE), Scene()
    for body in model.bodies:
        for name, part in body.parts.items():
            scene.add(name, part, body.T_world_body)
    for pair in sorted(model.related_pairs | model.excluded_pairs):
        scene.allow(*pair)
    return scene
