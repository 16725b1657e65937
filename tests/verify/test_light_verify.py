"""Cases with the mark `light` need no library: they run while it is built."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
BUILT = shutil.ignore_patterns("__pycache__", "*.so", "built.json", "threads.ptx.z", ".build-*")

pytestmark = pytest.mark.verify


def test_light_cases_compile_nothing(tmp_path):
    """All of them pass where no library was built, and neither they nor their processes leave a compiled kernel."""
    shutil.copytree(ROOT / "src" / "loewner", tmp_path / "src" / "loewner", ignore=BUILT)
    environment = {"PYTHONPATH": str(tmp_path / "src"), "LOEWNER_CACHE_DIR": str(tmp_path / "cache")}
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-m", "light", "tests"],
        cwd=ROOT,
        env=os.environ | environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout
    assert list((tmp_path / "cache").rglob("*.kernel")) == []
