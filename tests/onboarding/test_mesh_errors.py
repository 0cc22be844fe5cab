"""The error for a file that is no textured mesh names the file and says what to do."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from huepose.geometry import Mesh
from huepose.onboarding.meshes import read_mesh
from huepose.support.errors import InputError
from tests.onboarding import mesh_files as files
from tests.onboarding.mesh_checks import colors_at

POINTER = b"version https://git-lfs.github.com/spec/v1\noid sha256:4d7a2146\nsize 12345\n"


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
    elif how == "dds texture":
        (tmp_path / "m.png").write_bytes(b"DDS |\0\0\0")
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
        return obj.rename(tmp_path / "m.off")
    elif how == "page for a texture":
        (tmp_path / "m.png").write_bytes(b"<!DOCTYPE html>\n")
    elif how == "page for a material":
        obj.with_suffix(".mtl").write_text("<html>\n")
    elif how == "pointer to a texture":
        (tmp_path / "m.png").write_bytes(POINTER)
    return obj


@pytest.mark.parametrize(
    ("how", "named"),
    [
        ("no mtl", "m.mtl: found no such file; expected the material file, which m.obj names"),
        ("no texture", "m.png: found no such file; expected the texture, which m.mtl names"),
        ("broken texture", "m.png: found 12 bytes that are not an image"),
        ("dds texture", "m.png: found a DDS texture; expected a PNG or JPEG texture"),
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
        ("foreign type", "m.off: found a file of type '.off'; expected .obj, .ply, .glb, .gltf"),
        ("page for a texture", "m.png: found a web page (HTML); expected the texture, which m.mtl names"),
        ("page for a material", "m.mtl: found a web page (HTML); expected the material file, which m.obj"),
        (
            "pointer to a texture",
            "m.png: found a Git LFS pointer; expected the texture, which m.mtl names",
        ),
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


@pytest.mark.parametrize("library", ["mtllib gone.mtl\n", ""])
@pytest.mark.parametrize("colors", [("1 0 0", "0 0 1"), ("1 1 1", "1 1 1")])
def test_a_missing_material_file_is_noted_if_the_vertices_have_colours(
    tmp_path: Path, library: str, colors: tuple[str, str]
) -> None:
    """Exporters write white at all vertices if there are no colours."""
    places = ("0 0 0", "30 0 0", "0 30 0", "0 0 30")
    vertices = "".join(f"v {place} {colors[k % 2]}\n" for k, place in enumerate(places))
    (tmp_path / "m.obj").write_text(f"{library}{vertices}usemtl print\nf 1 2 3\nf 1 2 4\n")
    notes: list[str] = []
    if colors[0] == colors[1]:
        with pytest.raises(InputError, match=r"gone.mtl: found no such file|usemtl print; .* in no mtllib"):
            read_mesh(tmp_path / "m.obj", note=notes.append)
        return
    mesh = read_mesh(tmp_path / "m.obj", note=notes.append)
    np.testing.assert_allclose(colors_at(mesh, (0.5, 0.5, 0.0)), 127.5 * np.array([[1, 0, 1]] * 2), atol=1.5)
    assert len(notes) == bool(library)
    assert all("the material file gone.mtl, which the mesh names, is missing;" in n for n in notes)


def test_a_gltf_with_texture_and_vertex_colours_is_refused(tmp_path: Path, printed_box: Mesh) -> None:
    w = files.GlbWriter()
    attributes = w.corners(printed_box) | {
        "COLOR_0": w.accessor(np.tile(np.array([[0, 1, 0]], "<f4"), (36, 1)), "VEC3"),
    }
    index = w.mesh(attributes, material=w.textured_material(printed_box.texture))
    w.write(tmp_path / "m.glb", [{"mesh": index}], [0])
    with pytest.raises(InputError, match=r"a texture and colours at vertices.*bake both into one texture"):
        read_mesh(tmp_path / "m.glb")


@pytest.mark.parametrize("away_mm", [5e5, 5e6])
def test_a_mesh_kilometres_from_its_origin_is_refused(
    tmp_path: Path, printed_box: Mesh, away_mm: float
) -> None:
    """Half a kilometre away, a coordinate is rounded by 0.03 mm, 5 km away by half a millimetre."""
    files.write_obj(tmp_path / "m.obj", printed_box)
    lines = (tmp_path / "m.obj").read_text().splitlines()
    moved = [f"v {float(x.split()[1]) + away_mm} {' '.join(x.split()[2:])}" for x in lines if x[:2] == "v "]
    (tmp_path / "m.obj").write_text("\n".join([*moved, *(x for x in lines if x[:2] != "v ")]))
    if away_mm == 5e5:
        np.testing.assert_allclose(np.ptp(read_mesh(tmp_path / "m.obj").vertices, axis=0)[0], 0.08, atol=8e-5)
        return
    with pytest.raises(InputError, match=r"found a mesh 5000 m from its origin.*0.4883 mm.*Move the mesh"):
        read_mesh(tmp_path / "m.obj")


@pytest.mark.parametrize(
    ("required", "said"),
    [
        ("KHR_draco_mesh_compression", "Export again without compression"),
        ("EXT_meshopt_compression", "Export again without compression"),
        ("KHR_texture_basisu", "and with PNG or JPEG textures"),
        ("EXT_texture_webp", "and with PNG or JPEG textures"),
        ("EXT_mesh_gpu_instancing", "Export again without it"),
    ],
)
def test_extensions_that_change_the_mesh_are_refused_by_name(
    tmp_path: Path, required: str, said: str
) -> None:
    tree = {"asset": {"version": "2.0"}, "extensionsRequired": ["KHR_materials_ior", required]}
    (tmp_path / "m.glb").write_bytes(files.glb(tree, b""))
    with pytest.raises(InputError, match=rf"found the extension {required}; .*{said}"):
        read_mesh(tmp_path / "m.glb")


def test_instances_that_the_file_does_not_require_are_refused_too(tmp_path: Path) -> None:
    tree = {"asset": {"version": "2.0"}, "extensionsUsed": ["KHR_materials_ior", "EXT_mesh_gpu_instancing"]}
    (tmp_path / "m.glb").write_bytes(files.glb(tree, b""))
    with pytest.raises(InputError, match=r"found the extension EXT_mesh_gpu_instancing; .*Export again"):
        read_mesh(tmp_path / "m.glb")


@pytest.mark.parametrize(
    ("name", "content", "said"),
    [
        ("m.stl", b"", "found an STL mesh; expected .obj, .ply, .glb, .gltf. It holds no texture"),
        ("m.STP", b"", "found a STEP file; expected .obj, .ply, .glb, .gltf. It holds no texture"),
        ("m.blend", b"", "found a Blender file; expected .obj, .ply, .glb, .gltf. Open it in its program"),
        (
            "m.fbx",
            b"",
            "found an FBX file; expected .obj, .ply, .glb, .gltf. Open it in its program, and export",
        ),
        ("m.dae", b"", "found a COLLADA file; expected .obj, .ply, .glb, .gltf. Open it in its program"),
        ("m.png", b"", "found an image; expected .obj, .ply, .glb, .gltf. Give the mesh that it belongs to"),
        ("m.mtl", b"newmtl a", "found a material file; expected .obj, .ply, .glb, .gltf. Give the .obj that"),
        ("m.obj", b"BLENDER-v279", "found a Blender file by its first bytes, with the ending '.obj'"),
        ("m.glb", b"ISO-10303-21;", "found a STEP file by its first bytes, with the ending '.glb'"),
        ("m.ply", b"Kaydara FBX Binary", "found an FBX file by its first bytes, with the ending '.ply'"),
        ("m.glb", b"PK\x03\x04", "found a zip archive by its first bytes, with the ending '.glb'"),
        ("m.obj", b"solid cube\nfacet", "found an STL mesh by its first bytes, with the ending '.obj'"),
        ("m", b"PK\x03\x04", "found a zip archive by its first bytes, with the ending ''"),
        ("m", b"v 0 0 0", "found a file without an ending; expected .obj"),
        ("m.obj", POINTER, "found a Git LFS pointer; expected the mesh. Fetch it: git lfs pull."),
        ("m.glb", POINTER, "found a Git LFS pointer; expected the mesh. Fetch it: git lfs pull."),
        ("m.obj", b"\n\n<!DOCTYPE html>\n<html>", "found a web page (HTML); expected the mesh. The download"),
        (
            "m.ply",
            b"\xef\xbb\xbf<html lang='en'>",
            "found a web page (HTML); expected the mesh. The download",
        ),
        ("m.glb", b"<!doctype HTML><html>", "found a web page (HTML); expected the mesh. The download"),
        ("m.3mf", b"<!doctype html><html>", "found a web page (HTML); expected the mesh. The download"),
    ],
)
def test_the_type_of_a_file_that_is_no_mesh_is_named(
    tmp_path: Path, name: str, content: bytes, said: str
) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(InputError) as caught:
        read_mesh(tmp_path / name)
    assert str(caught.value).startswith(f"{tmp_path / name}: {said}")


def test_too_many_coloured_triangles_are_refused_with_how_to_simplify(
    tmp_path: Path,
) -> None:
    """One triangle more than 1024 x 1024, in a strip between two lines of vertices."""
    count = 1024**2 + 1
    k = np.arange(count + 2)
    vertices = np.stack([k // 2, k % 2, np.zeros(len(k))], 1) * 1e-3
    header = f"ply\nformat binary_little_endian 1.0\nelement vertex {len(k)}\n"
    header += "".join(f"property float {axis}\n" for axis in "xyz")
    header += "".join(f"property uchar {color}\n" for color in ("red", "green", "blue"))
    header += f"element face {count}\nproperty list uchar int vertex_indices\nend_header\n"
    rows = np.zeros(len(k), [("at", "<f4", 3), ("color", "u1", 3)])
    rows["at"], rows["color"] = vertices, 90
    faces = np.zeros(count, [("count", "u1"), ("of", "<i4", 3)])
    faces["count"], faces["of"] = 3, np.arange(count)[:, None] + np.arange(3)
    (tmp_path / "m.ply").write_bytes(header.encode() + rows.tobytes() + faces.tobytes())
    with pytest.raises(
        InputError, match="found 1048577 coloured triangles; expected at most 1048576"
    ) as caught:
        read_mesh(tmp_path / "m.ply", "mm")
    assert "Simplify the mesh (Blender: Decimate; MeshLab: Quadric Edge" in str(caught.value)


@pytest.mark.parametrize("faces", ["", "element face 0\nproperty list uchar int vertex_indices\n"])
def test_a_point_cloud_is_refused_as_one(tmp_path: Path, faces: str) -> None:
    header = "ply\nformat ascii 1.0\nelement vertex 2\nproperty float x\nproperty float y\nproperty float z\n"
    (tmp_path / "m.ply").write_text(f"{header}{faces}end_header\n0 0 0\n1 0 0\n")
    with pytest.raises(InputError, match=r"found 2 points and no faces; .*Screened Poisson.*--from-video"):
        read_mesh(tmp_path / "m.ply")
