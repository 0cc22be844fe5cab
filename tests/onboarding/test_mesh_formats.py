"""Known meshes written as OBJ, PLY and glTF are read back the same."""

from __future__ import annotations

import base64
import struct
import unicodedata
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from huepose.geometry import Camera, Mesh, se3
from huepose.onboarding.meshes import read_mesh
from huepose.rendering import render_depth
from huepose.support.errors import InputError
from tests.onboarding import mesh_files as files
from tests.onboarding.mesh_checks import assert_same, assert_well_formed, colors_at


def test_all_formats_of_one_box_read_alike(tmp_path: Path, printed_box: Mesh) -> None:
    files.write_obj(tmp_path / "a.obj", printed_box)
    files.write_glb(tmp_path / "b.glb", printed_box)
    paths = [tmp_path / "a.obj", tmp_path / "b.glb"]
    for binary in (False, True):
        for lists in (False, True):
            for order in ("<", ">")[: 1 + binary]:
                path = tmp_path / f"c{binary}{lists}{ord(order)}.ply"
                files.write_ply(path, printed_box, binary=binary, lists=lists, order=order)
                paths.append(path)
    for path in paths:
        mesh = read_mesh(path)
        assert_well_formed(mesh)
        assert_same(mesh, printed_box)


@pytest.mark.parametrize("face", ["1/1 2/2 3/3 4/4", "1/1/1 2/2/1 3/3/1 4/4/1", "-8/-4 -7/-3 -6/-2 -5/-1"])
def test_all_forms_of_obj_faces_are_read(tmp_path: Path, face: str) -> None:
    corners = ["0 0 0", "50 0 0", "50 30 0", "0 30 0", "0 0 20", "50 0 20", "50 30 20", "0 30 20"]
    lines = ["mtllib m.mtl", "usemtl p", *(f"v {c}" for c in corners), "vn 0 0 1"]
    lines += ["vt 0 0", "vt 1 0", "vt 1 1", "vt 0 1", f"f {face}", "f 5/1 6/2 7/3"]
    (tmp_path / "m.obj").write_text("\n".join(lines))
    (tmp_path / "m.mtl").write_text("newmtl p\nmap_Kd my print.png\n")
    picture = np.zeros((32, 32, 3), np.uint8)
    picture[:16], picture[16:] = (250, 0, 0), (0, 0, 250)  # red above
    files.write_png(tmp_path / "my print.png", picture)
    mesh = read_mesh(tmp_path / "m.obj")
    assert mesh.faces.tolist() == [[0, 1, 2], [0, 2, 3], [4, 5, 6]]
    np.testing.assert_allclose(mesh.vertices[2], [0.05, 0.03, 0.0], atol=1e-9)
    np.testing.assert_allclose(mesh.uv[1], [[0, 1], [1, 0], [0, 0]], atol=1e-6)
    low, high = colors_at(mesh, (0.9, 0.05, 0.05))[0], colors_at(mesh, (0.05, 0.05, 0.9))[0]
    assert low[2] > 240 > 10 > low[0]
    assert high[0] > 240 > 10 > high[2]


def test_keywords_of_a_material_file_may_be_upper_case(tmp_path: Path, printed_box: Mesh) -> None:
    files.write_obj(tmp_path / "m.obj", printed_box)
    plain = read_mesh(tmp_path / "m.obj")
    text = (tmp_path / "m.mtl").read_text()
    (tmp_path / "m.mtl").write_text(text.replace("newmtl", "NEWMTL").replace("map_Kd", "MAP_KD"))
    assert_same(read_mesh(tmp_path / "m.obj"), plain)


def test_the_texture_of_the_ambient_colour_is_used_if_it_is_the_only_one(
    tmp_path: Path, printed_box: Mesh
) -> None:
    files.write_obj(tmp_path / "m.obj", printed_box)
    plain = read_mesh(tmp_path / "m.obj")
    (tmp_path / "m.mtl").write_text("newmtl print\nKd 1 1 1\nmap_Ka m.png\nmap_Ks gone.png\n")
    notes: list[str] = []
    assert_same(read_mesh(tmp_path / "m.obj", note=notes.append), plain)
    assert notes == []


def test_a_material_whose_textures_are_not_of_its_colour_is_noted(tmp_path: Path, printed_box: Mesh) -> None:
    files.write_obj(tmp_path / "m.obj", printed_box)
    lines = "map_Bump -bm 0.5 m.png\nmap_aat on\nnewmtl other\nmap_d m.png\n"
    (tmp_path / "m.mtl").write_text(f"newmtl print\nKd 1 0 0\n{lines}")
    notes: list[str] = []
    mesh = read_mesh(tmp_path / "m.obj", note=notes.append)
    assert (mesh.texture == [255, 0, 0]).all()
    (note,) = notes
    assert "material print has no colour texture (map_Kd), only map_Bump -bm 0.5 m.png;" in note


def test_one_line_of_an_obj_may_name_several_material_files(tmp_path: Path, printed_box: Mesh) -> None:
    files.write_obj(tmp_path / "m.obj", printed_box)
    text = (tmp_path / "m.obj").read_text()
    (tmp_path / "m.obj").write_text(text.replace("m.mtl", "other.mtl m.mtl"))
    (tmp_path / "other.mtl").write_text("newmtl other\nKd 1 0 0\n")
    assert_same(read_mesh(tmp_path / "m.obj"), printed_box)
    (tmp_path / "m.mtl").rename(tmp_path / "other.mtl m.mtl")  # a name with a space is one name
    assert_same(read_mesh(tmp_path / "m.obj"), printed_box)
    (tmp_path / "other.mtl m.mtl").unlink()
    with pytest.raises(
        InputError, match=r"m.mtl: found no such file; expected the material file, which m.ob"
    ):
        read_mesh(tmp_path / "m.obj")


@pytest.mark.parametrize("base", [{}, {"metallicFactor": 0.0}, {"baseColorFactor": [1.0, 0.0, 0.0, 1.0]}])
def test_a_gltf_may_have_a_diffuse_texture(tmp_path: Path, printed_box: Mesh, base: dict) -> None:
    """In KHR_materials_pbrSpecularGlossiness. Its diffuse texture is used, whatever the base colour is."""
    files.write_glb(tmp_path / "m.glb", printed_box)
    plain = read_mesh(tmp_path / "m.glb")
    material = {"pbrMetallicRoughness": base}
    diffuse = {"diffuseTexture": {"index": 0}}
    material["extensions"] = {"KHR_materials_pbrSpecularGlossiness": diffuse}
    files.write_glb(tmp_path / "m.glb", printed_box, material=material)
    assert_same(read_mesh(tmp_path / "m.glb"), plain)
    del diffuse["diffuseTexture"]
    diffuse["diffuseFactor"] = [0.0, 0.0, 1.0, 1.0]
    files.write_glb(tmp_path / "m.glb", printed_box, material=material)
    color = (255, 0, 0) if "baseColorFactor" in base else (0, 0, 255)
    assert (read_mesh(tmp_path / "m.glb").texture == color).all()


@pytest.mark.parametrize("light", [{}, {"emissiveFactor": [1.0, 1.0, 1.0]}])
def test_the_emissive_texture_of_a_black_gltf_is_used(tmp_path: Path, printed_box: Mesh, light: dict) -> None:
    files.write_glb(tmp_path / "m.glb", printed_box)
    plain = read_mesh(tmp_path / "m.glb")
    base = {"baseColorFactor": [0.0, 0.0, 0.0, 1.0]}
    material = {"pbrMetallicRoughness": base, "emissiveTexture": {"index": 0}, **light}
    files.write_glb(tmp_path / "m.glb", printed_box, material=material)
    assert_same(read_mesh(tmp_path / "m.glb"), plain)
    base["baseColorFactor"] = [1.0, 0.0, 0.0, 1.0]
    files.write_glb(tmp_path / "m.glb", printed_box, material=material)
    assert (read_mesh(tmp_path / "m.glb").texture == (255, 0, 0)).all()


def test_polygons_of_a_ply_become_fans(tmp_path: Path) -> None:
    square = np.array([[0, 0, 0], [40, 0, 0], [40, 40, 0], [0, 40, 0], [0, 0, 40]], float)
    files.write_colored_ply(tmp_path / "m.ply", square, np.full((5, 3), 90), [[0, 1, 2, 3], [0, 1, 4]])
    assert read_mesh(tmp_path / "m.ply").faces.tolist() == [[0, 1, 2], [0, 2, 3], [0, 1, 4]]


@pytest.mark.parametrize("binary", [False, True])
@pytest.mark.parametrize("newline", [b"\n", b"\r\n", b"\r"])
def test_lines_of_a_ply_may_end_as_on_any_system(
    tmp_path: Path, printed_box: Mesh, binary: bool, newline: bytes
) -> None:
    path = tmp_path / "m.ply"
    files.write_ply(path, printed_box, binary=binary, lists=True)
    header, end, body = path.read_bytes().partition(b"\nend_header\n")
    header = header.replace(b"\n", b"\ncomment before end_header\n", 1)
    body = body if binary else body.replace(b"\n", newline)
    path.write_bytes((header + end).replace(b"\n", newline) + body)
    assert_same(read_mesh(path), printed_box)


def test_a_binary_ply_may_mix_polygons(tmp_path: Path) -> None:
    header = "ply\nformat binary_little_endian 1.0\nelement vertex 5\n"
    header += "".join(f"property float {p}\n" for p in "xyz")
    header += "".join(f"property uchar {p}\n" for p in ("red", "green", "blue"))
    header += "element face 3\nproperty list uchar int vertex_indices\nend_header\n"
    corners = [(0, 0, 0), (40, 0, 0), (40, 40, 0), (0, 40, 0), (0, 0, 40)]
    body = b"".join(struct.pack("<3f3B", *c, 90, 90, 90) for c in corners)
    for polygon in ([0, 1, 2, 3], [0, 1, 4], [4, 3, 2, 1, 0]):
        body += struct.pack(f"<B{len(polygon)}i", len(polygon), *polygon)
    (tmp_path / "m.ply").write_bytes(header.encode() + body)
    fans = [[0, 1, 2], [0, 2, 3], [0, 1, 4], [4, 3, 2], [4, 2, 1], [4, 1, 0]]
    assert read_mesh(tmp_path / "m.ply").faces.tolist() == fans


@pytest.mark.parametrize("encoding", ["utf-8", "latin-1"])
def test_names_may_be_non_ascii(tmp_path: Path, printed_box: Mesh, encoding: str) -> None:
    files.write_obj(tmp_path / "m.obj", printed_box)
    files.write_ply(tmp_path / "m.ply", printed_box, binary=True, lists=False)
    (tmp_path / "m.png").rename(tmp_path / "Körper.png")
    for name in ("m.mtl", "m.ply"):
        file = tmp_path / name
        file.write_bytes(file.read_bytes().replace(b"m.png", "Körper.png".encode(encoding)))
    for name in ("m.obj", "m.ply"):
        assert_same(read_mesh(tmp_path / name), printed_box)


@pytest.mark.parametrize(("on_disk", "in_file"), [("NFC", "NFD"), ("NFD", "NFC")])
def test_accents_of_file_names_may_be_decomposed(
    tmp_path: Path, printed_box: Mesh, on_disk: Any, in_file: Any
) -> None:
    """macOS decomposes the names of files, other systems do not."""
    files.write_obj(tmp_path / "m.obj", printed_box)
    (tmp_path / "m.png").rename(tmp_path / unicodedata.normalize(on_disk, "Körper.png"))
    (tmp_path / "m.mtl").write_text(f"newmtl print\nmap_Kd {unicodedata.normalize(in_file, 'Körper.png')}\n")
    assert_same(read_mesh(tmp_path / "m.obj"), printed_box)


@pytest.mark.parametrize(("on_disk", "in_file"), [("textures", "Textures"), ("Körper", "Ko\u0308rper")])
def test_names_of_folders_may_differ_in_case_and_accents(
    tmp_path: Path, printed_box: Mesh, on_disk: str, in_file: str
) -> None:
    files.write_obj(tmp_path / "m.obj", printed_box)
    (tmp_path / on_disk).mkdir()
    (tmp_path / "m.png").rename(tmp_path / on_disk / "print.png")
    (tmp_path / "m.mtl").write_text(f"newmtl print\nmap_Kd {in_file}\\print.png\n")
    assert_same(read_mesh(tmp_path / "m.obj"), printed_box)


def test_names_of_textures_may_differ_in_case_and_folder(tmp_path: Path, printed_box: Mesh) -> None:
    files.write_obj(tmp_path / "m.obj", printed_box, texture_name="Print.PNG")
    mtl = tmp_path / "m.mtl"
    for name in ("print.png", "sub\\print.png", "C:\\Users\\me\\Print.PNG"):
        mtl.write_text(f"newmtl print\nmap_Kd {name}\n")
        assert_same(read_mesh(tmp_path / "m.obj"), printed_box)


def test_names_of_textures_may_be_in_quotes(tmp_path: Path, printed_box: Mesh) -> None:
    files.write_obj(tmp_path / "m.obj", printed_box, texture_name="my print.png")
    for name in ('"my print.png"', "'my print.png'", '-clamp on "C:\\me\\my print.png"'):
        (tmp_path / "m.mtl").write_text(f"newmtl print\nmap_Kd {name}\n")
        assert_same(read_mesh(tmp_path / "m.obj"), printed_box)
    (tmp_path / "m.mtl").write_text("newmtl print\nmap_Kd 'my print.png'\n")
    (tmp_path / "my print.png").rename(tmp_path / "'my print.png'")
    assert_same(read_mesh(tmp_path / "m.obj"), printed_box)


def test_a_mirrored_export_is_turned_outwards(tmp_path: Path) -> None:
    from tests.meshes import demo_objects

    closed = next(iter(demo_objects(0).values()))
    welded, index = np.unique(np.round(closed.vertices, 7), axis=0, return_inverse=True)
    faces = index.reshape(-1)[closed.faces].astype(np.int32)
    for flip in (1, -1):
        mesh = Mesh(welded.astype(np.float32), faces[:, ::flip], closed.uv[:, ::flip], closed.texture)
        files.write_obj(tmp_path / "m.obj", mesh)
        read = read_mesh(tmp_path / "m.obj")
        normals, areas = read.face_normals()
        centres = read.vertices[read.faces].astype(np.float64).mean(1)
        assert np.einsum("fd,fd,f->", normals, centres, areas) > 0
        np.testing.assert_allclose(read.face_normals()[1].sum(), areas.sum())


def test_a_mirrored_part_is_rendered_from_outside(tmp_path: Path) -> None:
    """As when an assembly is exported in which one part is a mirror image."""
    corners = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
    quads = np.array([[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]])
    vertices = np.concatenate([0.06 * corners, 0.03 * corners + [0.0, 0.0, 0.05]])
    camera = Camera(500.0, 500.0, 79.5, 79.5, 160, 160)
    from_above = se3.make(np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.0, 0.4]))
    for flip in (1, -1):
        faces = np.concatenate([quads, quads[:, ::flip] + 8]).tolist()
        files.write_colored_ply(tmp_path / "m.ply", vertices, np.full((16, 3), 90), faces)
        read = read_mesh(tmp_path / "m.ply", "m")
        assert render_depth(read, from_above, camera)[80, 80] == pytest.approx(0.4 - 0.065, abs=1e-5)


def test_nodes_place_scale_and_mirror_gltf_meshes(tmp_path: Path, printed_box: Mesh) -> None:
    q = se3.quaternion_from_rotation(se3.rotation_exp(np.array([0.0, 0.0, np.pi / 2])))
    node = {"rotation": q.tolist(), "translation": [0.1, 0.0, 0.0], "scale": [2.0, 1.0, -1.0]}
    files.write_glb(tmp_path / "m.glb", printed_box, node)
    read = read_mesh(tmp_path / "m.glb")
    extents = np.ptp(read.vertices, axis=0)
    np.testing.assert_allclose(extents, [0.06, 0.16, 0.04], atol=1e-6)
    np.testing.assert_allclose(read.vertices.mean(0), [0.1, 0, 0], atol=1e-6)
    normals = read.face_normals()[0]
    centres = read.vertices[read.faces].mean(1) - [0.1, 0, 0]
    assert (np.einsum("fd,fd->f", normals, centres) > 0).all()
    assert sorted(map(tuple, np.round(colors_at(read)))) == sorted(
        map(tuple, np.round(colors_at(printed_box, (0.2, 0.3, 0.5))))
    )


def test_meshes_of_a_gltf_are_merged_and_strips_and_colors_read(tmp_path: Path) -> None:
    w = files.GlbWriter()
    strip = np.array([[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0], [0.1, 0.1, 0]], "<f4")
    white = np.full((4, 4), 255, "<u1")
    half = np.tile(np.array([[0.2140411, 0.0, 1.0]], "<f4"), (4, 1))  # linear; 0.5 in sRGB
    first = w.mesh({"POSITION": w.accessor(strip, "VEC3"), "COLOR_0": w.accessor(white, "VEC4")}, mode=5)
    second = w.mesh({"POSITION": w.accessor(strip, "VEC3"), "COLOR_0": w.accessor(half, "VEC3")}, mode=5)
    matrix = np.eye(4)
    matrix[2, 3] = 0.05
    nodes = [{"children": [1, 2]}, {"mesh": first}, {"mesh": second, "matrix": matrix.T.reshape(-1).tolist()}]
    w.write(tmp_path / "m.glb", nodes, [0])
    read = read_mesh(tmp_path / "m.glb")
    assert (len(read.faces), len(read.vertices)) == (4, 8)
    np.testing.assert_allclose(read.face_normals()[0], np.tile([0, 0, 1], (4, 1)), atol=1e-6)
    np.testing.assert_allclose(colors_at(read)[:2], 255)
    np.testing.assert_allclose(colors_at(read)[2:], np.tile([127.5, 0, 255], (2, 1)), atol=1)
    assert set(np.round(read.vertices[:, 2], 4)) == {0.0, np.float32(0.05)}


@pytest.mark.parametrize("mode", [4, 5, 6])
def test_an_empty_part_of_a_gltf_is_left_out(tmp_path: Path, printed_box: Mesh, mode: int) -> None:
    w = files.GlbWriter()
    own = {"material": w.textured_material(printed_box.texture)}
    box = w.mesh(w.corners(printed_box), **own)
    point = w.mesh({"POSITION": w.accessor(np.zeros((1, 3), "<f4"), "VEC3")}, mode=mode, **own)
    w.write(tmp_path / "m.glb", [{"mesh": box}, {"mesh": point}], [0, 1])
    assert_same(read_mesh(tmp_path / "m.glb"), printed_box)


@pytest.mark.parametrize("encoding", ["utf-16", "utf-16-be"])
def test_an_obj_may_be_in_utf_16(tmp_path: Path, printed_box: Mesh, encoding: str) -> None:
    """The shell of Windows writes it so."""
    path = tmp_path / "m.obj"
    files.write_obj(path, printed_box)
    for one in (path, path.with_suffix(".mtl")):
        mark = "" if encoding == "utf-16" else "\ufeff"
        one.write_text(mark + one.read_text(), encoding=encoding)
    assert_same(read_mesh(path), printed_box)


def test_gltf_may_be_in_parts(tmp_path: Path, printed_box: Mesh) -> None:
    images = [{"uri": "my%20print.png"}]
    path = files.write_gltf(tmp_path, printed_box, images=images)
    (tmp_path / "print.png").rename(tmp_path / "my print.png")
    assert_same(read_mesh(path), printed_box)
    inline = base64.b64encode((tmp_path / "m.bin").read_bytes()).decode()
    buffers = [{"uri": f"data:application/octet-stream;base64,{inline}"}]
    assert_same(
        read_mesh(files.write_gltf(tmp_path, printed_box, images=images, buffers=buffers)), printed_box
    )
    files.write_gltf(tmp_path, printed_box, images=images, buffers=[{"uri": "gone.bin"}])
    with pytest.raises(InputError, match=r"gone.bin: found no such file; expected the buffer, which m.gltf"):
        read_mesh(path)


def test_required_gltf_extensions_that_change_no_colour_are_accepted(
    tmp_path: Path, printed_box: Mesh
) -> None:
    names = ["clearcoat", "emissive_strength", "variants", "sheen", "transmission", "volume", "unlit"]
    required = ["KHR_lights_punctual", *(f"KHR_materials_{name}" for name in names)]
    assert_same(read_mesh(files.write_gltf(tmp_path, printed_box, extensionsRequired=required)), printed_box)


def test_a_gltf_texture_may_be_scaled_rotated_and_shifted(tmp_path: Path, printed_box: Mesh) -> None:
    """KHR_texture_transform: half and double scale, a quarter turn ((a, b) to (b, -a)), then (0, 1)."""
    u, v = printed_box.uv.reshape(-1, 2).T
    transform = {"scale": [0.5, 2.0], "rotation": np.pi / 2, "offset": [0.0, 1.0], "texCoord": 1}
    texture = {"index": 0, "extensions": {"KHR_texture_transform": transform}}
    path = files.write_gltf(
        tmp_path,
        printed_box,
        ("TEXCOORD_1", np.stack([2.0 * (1.0 - v), 0.5 * u], -1)),
        materials=[{"pbrMetallicRoughness": {"baseColorTexture": texture}}],
        extensionsRequired=["KHR_texture_transform"],
    )
    assert_same(read_mesh(path), printed_box)
