"""What `import loewner` brings in, and what it must not."""

import functools
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

import loewner
import loewner.jax
import loewner.torch
from gantry import gantry
from loewner._kernels._sources import source_hash

NATIVE = Path(__file__).resolve().parents[1] / "native"

OPTIONAL = (
    "trimesh", "coacd", "matplotlib", "mpl_toolkits", "rich", "collada", "lxml", "networkx", "ompl", "viser", "jax",
    "torch", "dask", "distributed", "xacro",
)  # fmt: skip


@functools.cache
def all_after(code: str) -> frozenset[str]:
    """Modules loaded by a fresh interpreter after running `code`."""
    ask = f"import json, sys; {code}; print(json.dumps(list(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", ask], capture_output=True, text=True, check=True)
    return frozenset(json.loads(done.stdout.splitlines()[-1]))


def modules_after(code: str) -> set[str]:
    """Top-level modules among them."""
    return {name.split(".")[0] for name in all_after(code)}


def test_import_is_light():
    """No optional package is imported by `import loewner`."""
    assert modules_after("import loewner").isdisjoint(OPTIONAL)


# Each in a fork of its own, so that no other one has loaded it.
FIRST_USE = """
import os, sys, loewner
for name in sys.argv[1:]:
    if not os.fork():
        assert 'loewner.' + name not in sys.modules
        getattr(loewner, name)
        try:
            getattr(loewner, name + 's')
        except AttributeError as error:
            print(error, flush=True)
        os._exit(0)
    os.wait()
"""


def test_modules_are_there_at_first_use():
    """After a plain `import loewner`, which does not load them; and what is misspelt is an AttributeError as ever."""
    names = list(loewner._AT_FIRST_USE)
    done = subprocess.run([sys.executable, "-c", FIRST_USE, *names], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines() == [f"module 'loewner' has no attribute '{name}s'" for name in names], done.stderr


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
    """All of this works where SciPy and PyYAML cannot be imported, and loads nothing of SciPy.

    Numba imports both by itself where they are there.
    """
    gantry(tmp_path)
    code = f"FOLDER = {str(tmp_path)!r}{WITHOUT_HULLS}"
    blocked = f"import sys; sys.modules |= {{'scipy': None, 'yaml': None}}\n{code}"
    assert "loewner" in modules_after(f"exec({blocked!r}); del sys.modules['scipy'], sys.modules['yaml']")
    loaded = modules_after(f"exec({code!r})")
    assert "numba" in loaded or "scipy" not in loaded


def test_the_command_line_begins_without_scipy():
    """Its parser imports all commands, and each of them waits for what it needs."""
    loaded = modules_after("import loewner.cli.main")
    assert "numba" in loaded or "scipy" not in loaded


def test_the_first_example_loads_qhull_alone():
    """What the README's first example loads of SciPy is what SciPy's Qhull needs, and nothing of it before the hull."""
    example = (Path(__file__).parent.parent / "README.md").read_text().split("```python\n")[1].split("```")[0]
    before, hull, _ = example.partition("a = loewner.Body.from_points")
    assert hull

    ask = "import sys\nprint(*(name for name in sys.modules if name.split('.')[0] == 'scipy'))\n"
    code = f"{before}\n{ask}\n{example.removeprefix(before)}\n{ask}"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    lines = done.stdout.splitlines()
    started, ended = set(lines[0].split()), set(lines[-1].split())
    assert not started or "numba" in modules_after("import loewner")  # which imports it by itself
    assert ended
    assert ended - started <= all_after("import numpy, scipy.spatial")


# Of loewner itself: for one purpose each, or for files only.
LATE = (
    "cli",
    "cluster",
    "cli.compilation",
    "paper",
    "planners",
    "plots",
    "viewer",
    "jax",
    "torch",
    "gpu",
    "gpu._ptx",
    "robots.gradients",
    "bodies.files",
    "bodies.exports",
    "bodies.cover_fits",
    "bodies.cover_proofs",
    "robots.description.exports",
    "meshes.files.gltf",
    "meshes.files.dae",
)


def test_import_leaves_modules_of_one_purpose():
    """They wait for their use, with what they need of the standard library."""
    loaded = {name.removeprefix("loewner.") for name in all_after("import loewner")}
    assert {"bodies", "robots", "meshes.files"} <= loaded
    assert loaded.isdisjoint(LATE)


def test_checking_saved_bodies_needs_no_optional_package(tmp_path):
    """`loewner check` on two saved bodies works without trimesh, CoACD, matplotlib and Rich, and so does its parser."""
    loewner.Body.box([1, 1, 1]).save(tmp_path / "a.npz")
    path = str(tmp_path / "a.npz")
    loaded = modules_after(f"import loewner.cli; assert loewner.cli.main(['check', {path!r}, {path!r}]) == 1")
    assert loaded.isdisjoint(OPTIONAL)


@pytest.mark.parametrize(("module", "package"), [(loewner.jax, "JAX"), (loewner.torch, "PyTorch")])
def test_missing_frameworks_are_named(module, package, tmp_path, monkeypatch):
    """Without them, modules that need them can be imported, and their functions name what to install."""
    name = module.__name__.removeprefix("loewner.")
    loewner.torch._function_class.cache_clear()
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


def test_the_build_does_not_import_scipy(tmp_path):
    """In a fresh clone, pip writes SciPy's files during the build; whoever loads half a library dies of a bus error."""
    (tmp_path / "scipy").mkdir()
    (tmp_path / "scipy" / "__init__.py").write_text("import os\nos.abort()\n")
    (tmp_path / "sources").write_text(source_hash())
    (tmp_path / "groups.json").write_text('{"some": ["irrationals"]}')
    command = [sys.executable, str(NATIVE / "emit.py"), str(tmp_path), "x86-64-v3", "0"]
    switches = {"PYTHONPATH": str(tmp_path), "LOEWNER_CACHE_DIR": str(tmp_path)}
    subprocess.run(command, env=os.environ | switches, stdout=subprocess.DEVNULL, check=True)
    assert (tmp_path / "x86-64-v3-some.o").exists()


def test_the_build_begins_before_other_packages_are_there():
    """In a fresh clone it runs while pip still installs SciPy; with an import of it, users would have no library."""
    blocked = ["scipy", "yaml", "rich", "matplotlib"]
    run = "; ".join(f"runpy.run_path({str(NATIVE / name)!r}, run_name='imported')" for name in ("build.py", "emit.py"))
    code = f"import runpy, sys; sys.modules.update(dict.fromkeys({blocked})); {run}"
    subprocess.run([sys.executable, "-c", code], check=True)
