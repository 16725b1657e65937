"""`loewner fit` on a folder of 500 parts, a tenth of them open or damaged."""

import numpy as np
import pytest

import made_parts
from loewner import Body, cli

pytestmark = pytest.mark.verify


def test_a_folder_of_parts_is_fitted(tmp_path, capsys):
    """None is lost: each part has a body that holds its mesh, or is listed as failed."""
    meshes, damaged = made_parts.write(tmp_path / "parts", 500)
    arguments = [*map(str, meshes), "-o", str(tmp_path / "bodies"), "-j", "2", "--tolerance", "0.002"]
    assert cli.main(["fit", *arguments]) == 2
    out = capsys.readouterr().out
    assert f"{len(meshes) - len(damaged)} done, {len(damaged)} failed" in out
    assert {p.stem for p in (tmp_path / "bodies").iterdir()} == {p.stem for p in meshes} - {p.stem for p in damaged}
    for mesh in damaged:
        assert mesh.name in out.split("failed", 1)[1]
    for path in (tmp_path / "bodies").iterdir():
        covering = Body.load(path).covering
        assert covering.exact
        assert np.isfinite(covering.max_protrusion)
