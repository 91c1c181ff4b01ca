"""Meshes in 3MF and glTF, which a library reads; hostile ones are bounded, and named."""

from __future__ import annotations

import struct
import sys
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from nodes.environment.shapes import mesh_file
from nodes.environment.shapes.mesh_file import read_mesh
from nodes.environment.surfaces import parse_surface
from nodes.parameters.store import ParameterError

MODEL = """<?xml version="1.0" encoding="UTF-8"?>
<model unit="UNIT" xmlns="http://schemas.microsoft.com/3dmanufacturing/core/2015/02">
<resources><object id="1" type="model"><mesh><vertices>
<vertex x="0" y="0" z="0"/><vertex x="2" y="0" z="0"/><vertex x="0" y="3" z="0"/>
<vertex x="0" y="0" z="1"/></vertices><triangles><triangle v1="0" v2="2" v3="1"/>
<triangle v1="0" v2="1" v3="3"/><triangle v1="1" v2="2" v3="3"/><triangle v1="2" v2="0" v3="3"/>
</triangles></mesh></object></resources><build><item objectid="1"/></build></model>"""
POINTS = np.array([[0.0, 0.0, 0.0], [0.2, 0.0, 0.0], [0.0, 0.3, 0.0], [0.0, 0.0, 0.1]])
FACES = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]])


def archive(folder: Path, unit: str = "centimeter", more: int = 0) -> Path:
    file = folder / "corner.3mf"
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as made:
        made.writestr("3D/3dmodel.model", MODEL.replace("UNIT", unit))
        if more:
            made.writestr("more", bytes(more))
    return file


def binary(folder: Path) -> Path:
    """Write glTF 2.0 in one file, by its specification: JSON, then corners and numbers."""
    data = POINTS.astype("<f4").tobytes() + FACES.astype("<u2").tobytes()
    text = (
        b'{"asset":{"version":"2.0"},"scene":0,"scenes":[{"nodes":[0]}],"nodes":[{"mesh":0}],'
        b'"meshes":[{"primitives":[{"attributes":{"POSITION":0},"indices":1}]}],'
        b'"buffers":[{"byteLength":72}],"bufferViews":[{"buffer":0,"byteLength":48},'
        b'{"buffer":0,"byteOffset":48,"byteLength":24}],"accessors":['
        b'{"bufferView":0,"componentType":5126,"count":4,"type":"VEC3","min":[0,0,0],'
        b'"max":[0.2,0.3,0.1]},{"bufferView":1,"componentType":5123,"count":12,"type":"SCALAR"}]}'
    )
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text
    chunks += struct.pack("<I4s", len(data), b"BIN\0") + data
    file = folder / "corner.glb"
    file.write_bytes(struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks)
    return file


@pytest.mark.parametrize(
    ("kind", "given", "width", "how"),
    [
        (archive, {}, 0.03, "unit cm; the file names cm"),
        (archive, {"unit": "mm"}, 0.003, "unit mm; the file names cm"),
        (archive, {"width": 0.06}, 0.06, "width 0.06 m; the file names cm"),
        (binary, {}, 0.3, "unit m; the file names m"),
    ],
)
def test_a_corner_is_read_in_its_unit(
    kind: Any, given: dict[str, Any], width: float, how: str, tmp_path: Path
) -> None:
    pytest.importorskip("trimesh", reason="pip install 'haptic-nodes[meshes]'")
    file = kind(tmp_path)
    found = read_mesh(file, "file")
    assert len(found.corners) == 4
    # glTF has single precision.
    size = np.ptp(found.corners.reshape(-1, 3), axis=0)
    assert size / size.max() == pytest.approx(np.array([2.0, 3.0, 1.0]) / 3.0, rel=1e-7)
    numbers = parse_surface({"kind": "mesh", "file": str(file), **given}, "s").numbers(
        1e-3
    )
    assert numbers is not None
    assert how in numbers.widths[0]
    assert f"{1e3 * width:.4g} mm wide" in numbers.widths[0]


def test_hostile_files_of_a_library_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("trimesh", reason="pip install 'haptic-nodes[meshes]'")
    monkeypatch.setattr(mesh_file, "LARGEST", 2_000_000)
    bomb = archive(tmp_path, more=3_000_000)
    assert bomb.stat().st_size < 10_000
    with pytest.raises(ParameterError, match="unpacks to 3 MB, more than 2"):
        read_mesh(bomb, "file")
    named = tmp_path / "other.gltf"
    named.write_text(
        '{"asset":{"version":"2.0"},"buffers":[{"uri":"/etc/passwd","byteLength":9}]}'
    )
    whole = {".3mf": archive(tmp_path), ".glb": binary(tmp_path)}
    for kind, data in (
        (".gltf", b""),
        (".glb", b"glTF"),
        (".3mf", b"PK"),
        (".gltf", b"{}"),
    ):
        file = tmp_path / f"bad{kind}"
        file.write_bytes(data)
        with pytest.raises(ParameterError, match="file: "):
            read_mesh(file, "file")
    with pytest.raises(ParameterError, match=r"read as \.glb|no triangles"):
        read_mesh(named, "file")
    for kind, good in whole.items():
        content = good.read_bytes()
        for end in range(0, len(content), 149):
            cut = tmp_path / f"cut{kind}"
            cut.write_bytes(content[:end])
            with pytest.raises(ParameterError):
                read_mesh(cut, "file")


def test_a_missing_library_is_named_with_the_way_out(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "trimesh", None)
    why = r"\.3mf needs a library .*pip install 'haptic-nodes\[meshes\]', or export the mesh as"
    with pytest.raises(ParameterError, match=why):
        read_mesh(archive(tmp_path), "file")


def test_an_archive_of_an_unknown_version_is_refused(tmp_path: Path) -> None:
    """Damaged by one bit, it raised NotImplementedError."""
    pytest.importorskip("trimesh")
    path = tmp_path / "box.3mf"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("3D/3dmodel.model", "")
    data = bytearray(path.read_bytes())
    data[data.rindex(b"PK\x01\x02") + 6] = 255  # version needed to extract
    path.write_bytes(data)
    with pytest.raises(
        ParameterError, match=r"is no 3MF archive.*export the mesh again"
    ):
        read_mesh(path, "file")
