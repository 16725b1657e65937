"""Equal files and equal seeds give equal plans and hashes on every processor, as far as one processor can tell."""

import subprocess
import sys
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

import other_machines
from loewner._base import _low_discrepancy, _matrices

HERE = Path(__file__).parent

# A robot whose frames and axes are oblique, so that its products are rounded; hashes of what machines compare.
PROGRAM = """
import hashlib, sys, tempfile
from pathlib import Path
sys.path.insert(0, sys.argv[1])
import numpy as np
import trimesh
import answers
from loewner import Body, CollisionChecker, Robot, Scene


def told(name, *arrays):
    data = b"".join(np.ascontiguousarray(array).tobytes() for array in arrays)
    print(hashlib.sha256(data).hexdigest()[:16], name)


parts = [
    f'<link name="l{k}"><collision><origin rpy="{k} 0.4 -0.7" xyz="0.1 0.02 {k / 9}"/>'
    '<geometry><box size="0.1 0.07 0.2"/></geometry></collision></link>'
    for k in range(5)
]
for k, kind in enumerate(("revolute", "prismatic", "planar", "fixed")):
    parts.append(
        f'<joint name="j{k}" type="{kind}"><parent link="l{k}"/><child link="l{k + 1}"/><axis xyz="0.3 {k - 0.7} 0.9"/>'
        f'<origin rpy="0.3 {k + 0.2} -1.1" xyz="0.2 0.1 0.3"/>'
        + '<limit lower="-2" upper="2"/>' * (kind in ("revolute", "prismatic")) + "</joint>"
    )
with tempfile.TemporaryDirectory() as folder:
    path = Path(folder, "oblique.urdf")
    path.write_text('<robot name="oblique">' + "".join(parts) + "</robot>")
    robot = Robot.from_urdf(path)
T = np.array([[0.36, 0.48, -0.8, 1], [-0.8, 0.6, 0, 2], [0.48, 0.64, 0.6, 3], [0, 0, 0, 1]])
for one in (robot, robot.placed(T)):
    scene = Scene()
    for k in range(3):
        S = np.vstack([np.roll(T[:3], k, axis=0), T[3:]])
        scene.add(f"box{k}", Body.box([0.1, 0.2, 0.3]).transformed(T), S)
    scene.add("mug", Body.from_points(np.random.default_rng(1).normal(size=(20, 3)) / 20).transformed(T))
    scene.attach("mug", "l4", T)
    print(CollisionChecker(one, scene).model_hash, "model")
    told("tree", *one.tree)

outline = ((0, 0), (3, 0), (3, 1), (1, 1), (1, 3), (0, 3))
vertices = np.array([[x, y, z] for x, y in outline for z in (0, 1)]) / 7
low = [(0, 4, 2), (0, 6, 4), (0, 8, 6), (0, 10, 8)]
high = [(a + 1, c + 1, b + 1) for a, b, c in low]
around = [(2 * k, (2 * k + 2) % 12, (2 * k + 3) % 12) for k in range(6)]
around += [(2 * k, (2 * k + 3) % 12, 2 * k + 1) for k in range(6)]
turned = (vertices[:, None] * T[:3, :3]).sum(axis=2)
body = Body.from_mesh(trimesh.Trimesh(turned, around + low + high, process=False), tolerance=0.004)
told("pieces of a mesh", *[piece.vertices for piece in body.pieces])

answers.PAIRS, answers.CONFIGURATIONS, answers.MOTIONS = 40, 40, 20
answers.HULLS, answers.ROBOTS, answers.PATHS = 6, 2, 5
for line in answers.table():
    print(line)
"""


@pytest.mark.verify
def test_other_processors_give_the_same_bits():
    """Models' hashes, answers, pieces of meshes and plans are the same with every library's routines for others."""
    machines = {
        name: switches for name, switches in other_machines.machines().items() if name in ("with AVX2", "before AVX")
    }
    found = {}
    running = {
        name: subprocess.Popen(
            [sys.executable, "-c", PROGRAM, str(HERE)], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
            env=other_machines.environment(switches) | {"OPENBLAS_NUM_THREADS": "1"},
        )
        for name, switches in ({"this one": {}} | machines).items()
    }  # fmt: skip
    for name, process in running.items():
        out, error = process.communicate()
        assert process.returncode == 0, f"{name}: {error}"
        found[name] = out.splitlines()
    assert len(found["this one"]) > 25
    other = {name: sorted(set(lines) - set(found["this one"])) for name, lines in found.items()}
    assert other == dict.fromkeys(found, [])


def test_switches_are_those_of_this_machine():
    """NumPy takes the names without a warning, and a switch of the process that asks is not handed on."""
    made = other_machines.environment(other_machines.without_wide_registers())
    command = [sys.executable, "-W", "error", "-c", "import numpy"]
    done = subprocess.run(command, env=made, capture_output=True, check=False)
    assert (done.returncode, done.stderr) == (0, b"")
    assert "OPENBLAS_CORETYPE" not in made


def test_the_core_consists_of_files_that_exist():
    """Each file that `make other-machines` runs is there."""
    assert [name for name in other_machines.CORE if not (HERE / f"test_{name}.py").exists()] == []


@pytest.mark.parametrize("dimension", [1, 2, 7, 30])
def test_strides_are_powers_of_the_root(dimension):
    """The root is the number of float64 below which x^(d + 1) < x + 1, in rational arithmetic up to its rounding."""
    strides = _low_discrepancy.strides(dimension)
    root = Fraction(1 / strides[0])
    assert abs(root ** (dimension + 1) - root - 1) < (dimension + 2) * 2 ** (dimension + 1) * Fraction(2) ** -50
    wanted = np.array([float(root**-k) for k in range(1, dimension + 1)])
    assert np.abs(strides / wanted - 1).max() < (dimension + 2) * 2.0**-52


def test_singular_values_are_those_of_the_batch(rng):
    """They agree with LAPACK's within half of the 32 roundings that bodies allow, alone or in a batch to the bit."""
    A = rng.normal(size=(300, 3, 3)) * 10.0 ** rng.uniform(-9, 3, (300, 1, 3))
    A[::3] = A[::3] @ rng.normal(size=(3, 3))
    A[5], A[6, :, 1], A[7] = 0.0, A[6, :, 0], 1.0
    values, wanted = _matrices.singular_values(A), np.linalg.svd(A, compute_uv=False)
    assert (np.abs(values - wanted) <= 16 * 2.0**-53 * wanted[:, :1]).all()
    assert np.array_equal(np.concatenate([_matrices.singular_values(a[None]) for a in A]), values)
    turned = np.linalg.qr(rng.normal(size=(1000, 3, 3)))[0]  # no column is ever longer than another but by rounding
    assert np.abs(_matrices.singular_values(turned) - 1).max() <= 16 * 2.0**-53


def test_products_are_products(rng):
    """Products, images, lengths, powers, axes and roots agree with NumPy's to rounding."""
    A, B, x = rng.normal(size=(4, 3, 3)), rng.normal(size=(3, 3)), rng.normal(size=(4, 7, 3))
    assert np.allclose(_matrices.product(A, B), A @ B, rtol=0, atol=1e-14)
    assert np.allclose(_matrices.image(B, x), x @ B.T, rtol=0, atol=1e-14)
    assert np.allclose(_matrices.lengths(x), np.linalg.norm(x, axis=-1), rtol=1e-15)
    assert np.array_equal(_matrices.power(x, 2), x * x)
    shape = A @ A.transpose(0, 2, 1) + np.eye(3)
    assert np.allclose(_matrices.cholesky(shape), np.linalg.cholesky(shape), rtol=0, atol=1e-13)
    axes = _matrices.principal_axes(x[0])
    spread = (x[0] - x[0].mean(axis=0)) @ axes.T
    assert np.allclose(axes @ axes.T, np.eye(3), rtol=0, atol=1e-14)
    square = spread.T @ spread
    assert np.allclose(square, np.diag(-np.sort(-np.diag(square))), rtol=0, atol=1e-13)
