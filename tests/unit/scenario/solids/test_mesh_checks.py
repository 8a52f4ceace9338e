"""Sound files of every kind pass the look at what they announce; see tests/unit/scenario/load/test_hostile_files.py for those that lie."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from uwserver.physics.geometry.shapes import BadSolid
from uwserver.scenario.solids import mesh_checks
from uwserver.scenario.solids.assets import read_mesh
from uwserver.scenario.solids.mesh_checks import checked


@pytest.mark.parametrize("kind", ["stl", "stl_ascii", "ply", "ply_ascii", "obj", "glb", "gltf"])
def test_a_sound_file_is_read_and_counted(kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import trimesh

    box = trimesh.creation.box((4.0, 2.0, 1.0))
    path = tmp_path / f"box.{kind.partition('_')[0]}"
    if kind == "gltf":
        for name, data in box.export(file_type="gltf").items():
            (tmp_path / name).write_bytes(data)
        path = tmp_path / "model.gltf"
    elif kind == "ply_ascii":
        path.write_bytes(box.export(file_type="ply", encoding="ascii"))
    else:
        box.export(path, file_type=kind)
    (mesh,) = read_mesh(path, "z", 1.0, lambda text: None)
    assert np.ptp(mesh.vertices, axis=0) == pytest.approx([4.0, 2.0, 1.0])
    assert len(mesh.faces) == 12
    monkeypatch.setattr(mesh_checks, "MOST_TRIANGLES", 11)
    with pytest.raises(BadSolid, match=r"12 triangles; at most 11 are allowed: simplify it"):
        checked(path, path.read_bytes())


def test_an_stl_text_with_a_name_of_another_encoding_is_read(tmp_path: Path) -> None:
    import trimesh

    text = trimesh.creation.box((4.0, 2.0, 1.0)).export(file_type="stl_ascii").replace("solid", "solid B\xf6je", 1)
    (tmp_path / "a.stl").write_bytes(text.encode("latin-1"))
    (mesh,) = read_mesh(tmp_path / "a.stl", "z", 1.0, lambda text: None)
    assert len(mesh.faces) == 12
