"""Read scenes from files: loewner's YAML format, MuJoCo models, and MotionBenchMaker's planning problems in JSON.

`yaml_scenes` reads and writes the YAML format, `mjcf_scenes` reads MuJoCo models, and `motion_bench_maker` reads
MotionBenchMaker's problems. For the YAML format, `sensor_shapes` reads clouds, voxels and terrain, and `schema` defines
the keys.
"""

from loewner.scenes.files.motion_bench_maker import Problem, read_motion_bench_maker
from loewner.scenes.files.yaml_scenes import load_scene, save_scene

__all__ = ["Problem", "load_scene", "read_motion_bench_maker", "save_scene"]
