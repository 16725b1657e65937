"""What `import loewner` brings in, and what it must not."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

import loewner
import loewner.jax
import loewner.torch
from gantry import gantry

OPTIONAL = (
    "trimesh", "coacd", "matplotlib", "mpl_toolkits", "rich", "collada", "lxml", "networkx", "ompl", "viser", "jax",
    "torch", "dask", "distributed",
)  # fmt: skip


def modules_after(code: str) -> set[str]:
    """Top-level modules loaded by a fresh interpreter after running `code`."""
    ask = f"import json, sys; {code}; print(json.dumps(sorted({{m.split('.')[0] for m in sys.modules}})))"
    done = subprocess.run([sys.executable, "-c", ask], capture_output=True, text=True, check=True)
    return set(json.loads(done.stdout.splitlines()[-1]))


def test_import_is_light():
    """No optional package is imported by `import loewner`."""
    assert modules_after("import loewner").isdisjoint(OPTIONAL)


@pytest.mark.parametrize("name", loewner._AT_FIRST_USE)
def test_modules_are_there_at_first_use(name):
    """After a plain `import loewner`, which does not load them; and what is misspelt is an AttributeError as ever."""
    code = f"import sys, loewner; assert 'loewner.{name}' not in sys.modules; loewner.{name}; loewner.{name}s"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert f"module 'loewner' has no attribute '{name}s'" in done.stderr


def test_import_needs_no_yaml():
    """`import loewner` works without PyYAML. (Numba imports it by itself where it is there.)"""
    assert "loewner" in modules_after("import sys; sys.modules['yaml'] = None; import loewner; del sys.modules['yaml']")


def test_command_line_is_light_until_it_prints_tables():
    """The command line imports no optional package to parse its arguments."""
    assert modules_after("from loewner.cli.main import _parser; _parser()").isdisjoint(OPTIONAL)


# What needs no hull: primitives, boxes among them, surfaces, clouds, files, queries, crowds and a robot of primitives.
WITHOUT_HULLS = """
import numpy as np, loewner
from loewner import Body, Bodies
body = Body.union([Body.box([1, 2, 3]), Body.sphere(1), Body.capsule(1, 2), Body.cylinder(1, 2), Body.cone(1, 2),
                   Body.ellipsoid([1, 2, 3])]).transformed(np.eye(4))
body.save(FOLDER + "/body.npz")
body = Body.load(FOLDER + "/body.npz")
loewner.classify(body, None, body, None)
assert loewner.collide(Body.box([1, 1, 1]), None, Body.sphere(1.0), None)
loewner.distance(body, None, body, None, exact=True)
loewner.overlapping_pairs(Bodies([body, body]), None)
surface = Body.from_surface((np.eye(4, 3), [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]))
Body.union([surface, Body.from_cloud(np.eye(3), radius=0.1)]).save(FOLDER + "/surface.npz")
surface = Body.load(FOLDER + "/surface.npz")
loewner.distance(surface, None, body, None)
scene = loewner.Scene()
scene.add("body", body)
scene.add("surface", surface)
loewner.CollisionChecker(loewner.Robot.from_urdf(FOLDER + "/gantry.urdf"), scene).collide(np.zeros(3))
"""


def test_scipy_waits_for_a_hull(tmp_path):
    """All of this works where SciPy cannot be imported, and loads nothing of it. (Numba imports it by itself.)"""
    gantry(tmp_path)
    code = f"FOLDER = {str(tmp_path)!r}{WITHOUT_HULLS}"
    blocked = f"import sys; sys.modules['scipy'] = None\n{code}"
    assert "loewner" in modules_after(f"exec({blocked!r}); del sys.modules['scipy']")
    loaded = modules_after(f"exec({code!r})")
    assert "numba" in loaded or "scipy" not in loaded


def test_the_first_example_loads_qhull_alone():
    """What the README's first example loads of SciPy is what SciPy's Qhull needs, and nothing of it before the hull."""
    example = (Path(__file__).parent.parent / "README.md").read_text().split("```python\n")[1].split("```")[0]
    before, hull, _ = example.partition("a = loewner.Body.from_points")
    assert hull

    def of_scipy(code: str) -> set[str]:
        ask = f"{code}\nimport sys\nprint(*(name for name in sys.modules if name.split('.')[0] == 'scipy'))"
        done = subprocess.run([sys.executable, "-c", ask], capture_output=True, text=True, check=True)
        return set(done.stdout.splitlines()[-1].split())

    started = of_scipy(before)
    assert not started or "numba" in modules_after("import loewner")  # which imports it by itself
    assert of_scipy(example) - started <= of_scipy("import numpy, scipy.spatial")


# Of loewner itself: for one purpose each, or for files only.
LATE = (
    "cli",
    "cluster",
    "compilation",
    "paper",
    "planners",
    "plots",
    "viewer",
    "jax",
    "torch",
    "gpu",
    "_ptx",
    "_gradients",
    "bodies.files",
    "mesh_files.gltf",
    "mesh_files.dae",
)


def test_import_leaves_modules_of_one_purpose():
    """They wait for their use, with what they need of the standard library."""
    ask = "import sys, loewner; print(*(name for name in sys.modules if name.startswith('loewner.')))"
    done = subprocess.run([sys.executable, "-c", ask], capture_output=True, text=True, check=True)
    loaded = {name.removeprefix("loewner.") for name in done.stdout.split()}
    assert {"bodies", "robots", "mesh_files"} <= loaded
    assert loaded.isdisjoint(LATE)


def test_checking_saved_bodies_needs_no_optional_package(tmp_path):
    """`loewner check` on two saved bodies works without trimesh, CoACD, matplotlib and Rich."""
    loewner.Body.box([1, 1, 1]).save(tmp_path / "a.npz")
    path = str(tmp_path / "a.npz")
    loaded = modules_after(f"import loewner.cli; assert loewner.cli.main(['check', {path!r}, {path!r}]) == 1")
    assert loaded.isdisjoint(OPTIONAL)


@pytest.mark.parametrize(("module", "package"), [(loewner.jax, "JAX"), (loewner.torch, "PyTorch")])
def test_missing_frameworks_are_named(module, package, tmp_path, monkeypatch):
    """Without them, modules that need them can be imported, and their functions name what to install."""
    name = module.__name__.removeprefix("loewner.")
    loewner.torch._functions.cache_clear()
    monkeypatch.setitem(sys.modules, name, None)
    urdf, _ = gantry(tmp_path)
    checker = loewner.CollisionChecker(loewner.Robot.from_urdf(urdf), skip_adjacent=False)
    for make in (module.clearance, module.distance):
        with pytest.raises(loewner.MissingExtraError, match=rf'{package}: pip install "loewner\[{name}\]"'):
            make(checker)


def test_public_names_exist_and_are_listed_once():
    """Every name in __all__ is there, sorted, once."""
    assert sorted(set(loewner.__all__)) == sorted(loewner.__all__)
    assert all(hasattr(loewner, name) for name in loewner.__all__)
