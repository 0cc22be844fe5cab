"""Files that are no textured mesh are named, with what to do."""

from __future__ import annotations

from pathlib import Path

import pytest

from huepose.geometry import Mesh
from huepose.onboarding.meshes import read_mesh
from huepose.support.errors import InputError
from tests.onboarding import mesh_files as files


def broken(tmp_path: Path, mesh: Mesh, how: str) -> Path:
    obj, ply, binary = tmp_path / "m.obj", tmp_path / "m.ply", tmp_path / "m.glb"
    files.write_obj(obj, mesh)
    files.write_ply(ply, mesh, binary=True, lists=False)
    files.write_glb(binary, mesh)
    if how == "no mtl":
        obj.with_suffix(".mtl").unlink()
    elif how == "no texture":
        (tmp_path / "m.png").unlink()
    elif how == "broken texture":
        (tmp_path / "m.png").write_bytes(b"\x89PNG nothing")
    elif how == "no such material":
        obj.with_suffix(".mtl").write_text("newmtl other\n")
    elif how == "cut obj":
        obj.write_text(obj.read_text().replace("f 1/1", "f 999/1"))
    elif how == "no faces":
        obj.write_text("v 0 0 0\n")
    elif how == "words for numbers":
        obj.write_text(obj.read_text().replace("\nv ", "\nv forty ", 1))
    elif how == "cut ply":
        ply.write_bytes(ply.read_bytes()[:-30])
        return ply
    elif how == "no ply":
        ply.write_bytes(b"solid")
        return ply
    elif how == "ply without its texture":
        (tmp_path / "m.png").unlink()
        return ply
    elif how == "cut glb":
        binary.write_bytes(binary.read_bytes()[:200])
        return binary
    elif how == "no glb":
        binary.write_bytes(b"nothing")
        return binary
    elif how == "missing":
        return tmp_path / "other.obj"
    elif how == "foreign type":
        return obj.rename(tmp_path / "m.step")
    return obj


@pytest.mark.parametrize(
    ("how", "named"),
    [
        ("no mtl", "m.mtl: found no such file; expected the material file, which m.obj names"),
        ("no texture", "m.png: found no such file; expected the texture, which m.mtl names"),
        ("broken texture", "m.png: found 12 bytes that are no picture"),
        ("no such material", "m.obj: found usemtl print; expected that material in m.mtl"),
        ("cut obj", "m.obj: found a face that names vertex 998"),
        ("no faces", "m.obj: found 1 vertices and 0 faces"),
        ("words for numbers", "m.obj line 3: found v forty 39.9"),
        ("cut ply", "m.ply: found fewer values than its header announces"),
        ("no ply", "m.ply: found no PLY header"),
        ("ply without its texture", "m.png: found no such file; expected the texture, which m.ply names"),
        ("cut glb", "m.glb: found 200 of "),
        ("no glb", "m.glb: found no glTF header"),
        ("missing", "other.obj: found no such file; expected the mesh"),
        ("foreign type", "m.step: found a file of type '.step'; expected .obj, .ply, .glb, .gltf"),
    ],
)
def test_broken_files_are_named_with_the_fix(tmp_path: Path, printed_box: Mesh, how: str, named: str) -> None:
    path = broken(tmp_path, printed_box, how)
    with pytest.raises(InputError) as caught:
        read_mesh(path)
    assert named in str(caught.value)


def test_a_mesh_without_any_colour_is_refused(tmp_path: Path) -> None:
    (tmp_path / "m.obj").write_text("v 0 0 0\nv 30 0 0\nv 0 30 0\nv 0 0 30\nf 1 2 3\nf 1 2 4\n")
    with pytest.raises(InputError, match=r"no mtllib.*textured mesh"):
        read_mesh(tmp_path / "m.obj")


def test_draco_is_refused_by_name(tmp_path: Path) -> None:
    tree = {"asset": {"version": "2.0"}, "extensionsRequired": ["KHR_draco_mesh_compression"]}
    (tmp_path / "m.glb").write_bytes(files.glb(tree, b""))
    with pytest.raises(InputError, match=r"KHR_draco_mesh_compression.*without compression"):
        read_mesh(tmp_path / "m.glb")
