"""Read scenes from files: our YAML format, MuJoCo models, and MotionBenchMaker's planning problems in JSON."""

from loewner.scene_files.motion_bench_maker import Problem, read_motion_bench_maker
from loewner.scene_files.yaml_scenes import load_scene, save_scene

__all__ = ["Problem", "load_scene", "read_motion_bench_maker", "save_scene"]
