"""Mesh files from untrusted sources: files that they name, limits of size, damaged content."""

from __future__ import annotations

import json
import os
import struct
import zlib
from pathlib import Path

import numpy as np
import pytest

from huepose.geometry import Mesh
from huepose.onboarding import mesh_files, raw_mesh, texture
from huepose.onboarding.meshes import read_mesh
from huepose.onboarding.texture import used_texels
from huepose.support.errors import InputError
from tests.onboarding import mesh_files as files
from tests.onboarding import solids

CORNERS = "v 0 0 0\nv 60 0 0\nv 0 60 0\nv 0 0 60\nvt 0 0\nvt 1 0\nvt 0 1\n"
FACES = "f 1/1 2/2 3/3\nf 1/1 2/2 4/3\n"


def write_obj(folder: Path, mtl: str = "newmtl p\nmap_Kd print.png\n", body: str = FACES) -> Path:
    """A small OBJ of material `p`; `print.png` lies beside it."""
    path = folder / "m.obj"
    path.write_text("mtllib m.mtl\n" + CORNERS + "usemtl p\n" + body)
    path.with_suffix(".mtl").write_text(mtl)
    files.write_png(folder / "print.png", np.full((8, 8, 3), 90, np.uint8))
    return path


def naming(folder: Path, mesh: Mesh, kind: str, name: str) -> Path:
    """A mesh file that names `name` as its texture, material file or buffer."""
    if kind == "texture of obj":
        return write_obj(folder, mtl=f"newmtl p\nmap_Kd {name}\n")
    if kind == "material file":
        path = write_obj(folder)
        path.write_text(path.read_text().replace("m.mtl", name))
        return path
    if kind == "texture of ply":
        files.write_ply(folder / "m.ply", mesh, binary=True, lists=False)
        data = (folder / "m.ply").read_bytes()
        (folder / "m.ply").write_bytes(data.replace(b"File m.png", f"File {name}".encode()))
        return folder / "m.ply"
    if kind == "texture of gltf":
        return files.write_gltf(folder, mesh, images=[{"uri": name}])
    return files.write_gltf(folder, mesh, buffers=[{"uri": name}])


KINDS = ("texture of obj", "material file", "texture of ply", "texture of gltf", "buffer")


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("name", ["/dev/zero", "../{}", "{outside}/{}", "sub/../../{}", "link/{}", "{}"])
def test_only_files_under_the_mesh_folder_are_read(
    tmp_path: Path, printed_box: Mesh, kind: str, name: str
) -> None:
    inside, outside = tmp_path / "in", tmp_path / "out"
    inside.mkdir()
    outside.mkdir()
    write_obj(outside)
    files.write_gltf(outside, printed_box)
    good = {"material file": "m.mtl", "buffer": "m.bin"}.get(kind, "print.png")
    secret = f"secret{Path(good).suffix}"
    (outside / good).rename(tmp_path / secret)
    (inside / "sub").mkdir()
    (inside / "link").symlink_to(tmp_path, target_is_directory=True)
    if name == "{}":
        (inside / secret).symlink_to(tmp_path / secret)
    path = naming(inside, printed_box, kind, name.format(secret, outside=tmp_path))
    with pytest.raises(InputError, match=r"outside of the mesh's folder; expected .* Copy the .* there"):
        read_mesh(path)


def test_wrong_folders_and_case_in_file_names_are_ignored(tmp_path: Path, printed_box: Mesh) -> None:
    for kind, good in zip(KINDS, ("print.png", "m.mtl", "m.png", "print.png", "m.bin"), strict=True):
        for folder in ("/home/somebody/", "../", "sub/", "C:\\Users\\somebody\\", ""):
            read_mesh(naming(tmp_path, printed_box, kind, folder + good.upper()))


def test_a_folder_of_symbolic_links_is_read(tmp_path: Path) -> None:
    store, shown = tmp_path / "store", tmp_path / "shown"
    store.mkdir()
    shown.mkdir()
    write_obj(store)
    for file in store.iterdir():
        (shown / file.name).symlink_to(file)
    assert len(read_mesh(shown / "m.obj").faces) == 2


@pytest.mark.parametrize("what", ["pipe", "folder"])
def test_only_regular_files_are_read(tmp_path: Path, what: str) -> None:
    path = write_obj(tmp_path)
    (tmp_path / "print.png").unlink()
    if what == "pipe":
        os.mkfifo(tmp_path / "print.png")  # reading it would wait for ever
    else:
        (tmp_path / "print.png").mkdir()
    with pytest.raises(
        InputError, match=r"print.png: found no regular file; expected the texture, which m.mtl"
    ):
        read_mesh(path)


@pytest.mark.parametrize("name", ["m.obj", "m.mtl", "print.png"])
def test_the_size_of_a_file_is_checked_before_it_is_read(tmp_path: Path, name: str) -> None:
    path = write_obj(tmp_path)
    os.truncate(tmp_path / name, 3 * 2**30)  # a sparse file
    with pytest.raises(InputError, match=rf"{name}: found 3221 MB; expected at most 1074 MB"):
        read_mesh(path)


def png_of(width: int, height: int) -> bytes:
    """A PNG whose header announces this size, without pixels."""

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    parts = [chunk(b"IHDR", header), chunk(b"IDAT", zlib.compress(b"")), chunk(b"IEND", b"")]
    return b"\x89PNG\r\n\x1a\n" + b"".join(parts)


@pytest.mark.parametrize(
    ("width", "height", "found"),
    [(8193, 8192, "8193 x 8192"), (12000, 8000, "12000 x 8000"), (60000, 60000, "3600000000 pixels")],
)
def test_pictures_are_measured_before_they_are_decoded(
    tmp_path: Path, width: int, height: int, found: str
) -> None:
    path = write_obj(tmp_path)
    (tmp_path / "print.png").write_bytes(png_of(width, height))
    with pytest.raises(InputError, match=rf"print.png: found .*{found}.*at most 67 million texels"):
        read_mesh(path)


def test_the_size_limit_counts_all_textures_of_a_mesh(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = write_obj(
        tmp_path, "newmtl p\nmap_Kd print.png\nnewmtl q\nmap_Kd other.png\n", FACES + "usemtl q\n" + FACES
    )
    files.write_png(tmp_path / "other.png", np.full((8, 8, 3), 90, np.uint8))
    monkeypatch.setattr(mesh_files, "LARGEST_TEXTURES", 128)
    assert len(read_mesh(path).faces) == 4
    monkeypatch.setattr(mesh_files, "LARGEST_TEXTURES", 127)
    with pytest.raises(InputError, match=r"other.png: found too many texels"):
        read_mesh(path)


def test_textures_of_materials_that_no_face_uses_are_not_read(tmp_path: Path) -> None:
    path = write_obj(tmp_path, "newmtl p\nmap_Kd print.png\nnewmtl q\nmap_Kd gone.png\n")
    assert len(read_mesh(path).faces) == 2


@pytest.mark.parametrize("form", ["obj", "polygon", "ply", "glb"])
def test_triangles_are_counted_before_they_are_made(
    tmp_path: Path, printed_box: Mesh, monkeypatch: pytest.MonkeyPatch, form: str
) -> None:
    monkeypatch.setattr(raw_mesh, "LARGEST_FACES", 11)
    path = tmp_path / f"m.{'ply' if form == 'polygon' else form}"
    if form == "obj":
        files.write_obj(path, printed_box)
    elif form == "polygon":
        files.write_colored_ply(path, np.eye(3) * 50, np.full((3, 3), 9), [[0, 1, 2] * 5])
    elif form == "ply":
        files.write_ply(path, printed_box, binary=True, lists=False)
    else:
        files.write_glb(path, printed_box)
    with pytest.raises(InputError, match=r"found 1[23] triangles; expected at most 11. Simplify"):
        read_mesh(path)


def test_a_small_glb_cannot_show_its_mesh_without_end(
    tmp_path: Path, printed_box: Mesh, monkeypatch: pytest.MonkeyPatch
) -> None:
    twice = [{"children": [i + 1, i + 1]} for i in range(40)] + [{"mesh": 0}]
    with pytest.raises(InputError, match=r"node 40 is met twice"):
        read_mesh(files.write_gltf(tmp_path, printed_box, nodes=twice))
    many = [{"children": list(range(1, 500_001))}] + [{"mesh": 0}] * 500_000
    with pytest.raises(InputError, match=r"found 500001 nodes or meshes; expected at most 10000"):
        read_mesh(files.write_gltf(tmp_path, printed_box, nodes=many))
    monkeypatch.setattr(raw_mesh, "LARGEST_FACES", 12 * 99)
    with pytest.raises(InputError, match=r"found 1200 triangles"):
        read_mesh(
            files.write_gltf(
                tmp_path, printed_box, nodes=many[-1:] * 100, scenes=[{"nodes": list(range(100))}]
            )
        )


def test_a_byte_stride_of_0_is_refused(tmp_path: Path, printed_box: Mesh) -> None:
    path = files.write_gltf(tmp_path, printed_box)
    tree = json.loads(path.read_text())
    tree["bufferViews"][0]["byteStride"] = 0
    tree["accessors"][0]["count"] = 3_000_000  # 72 MB of 12 bytes
    path.write_text(json.dumps(tree))
    with pytest.raises(InputError, match=r"m.gltf: found damaged content .*byteStride of 0"):
        read_mesh(path)


def test_more_materials_than_fit_into_a_texture_are_refused(tmp_path: Path) -> None:
    names = [f"c{i}" for i in range(11_000)]
    body = "".join(f"usemtl {n}\nf 1 2 3\n" for n in names)
    path = write_obj(tmp_path, "".join(f"newmtl {n}\nKd 1 0 0\n" for n in names), body)
    with pytest.raises(InputError, match=r"found 11000 materials; expected at most 4096"):
        read_mesh(path)


def test_triangles_that_cover_a_texture_many_times_are_not_all_rasterised() -> None:
    whole = np.tile(np.array([[0, 0], [1, 0], [0, 1]], np.float32), (128, 1, 1))
    assert not used_texels(whole, 64, 64).all()
    assert used_texels(np.concatenate([whole, whole]), 64, 64).all()


def test_a_large_repeating_texture_is_reduced(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    picture = np.zeros((64, 64, 3), np.uint8)
    picture[:, :32] = 200
    mesh = solids.box((0.08, 0.06, 0.04))
    uv = np.tile(np.array([[0, 0], [4, 0], [4, 4]], np.float32), (12, 1, 1))
    files.write_obj(tmp_path / "m.obj", Mesh(mesh.vertices, mesh.faces, uv, picture))
    monkeypatch.setattr(texture, "LARGEST_TEXTURE", 4 * 4 * 32 * 32)
    read = read_mesh(tmp_path / "m.obj")
    assert read.texture.shape == (128, 128, 3)
    np.testing.assert_array_equal(read.texture[0, :, 0], np.tile(np.repeat([200, 0], 16), 4))
    np.testing.assert_allclose(read.uv.max((0, 1)), 1.0)


def test_a_texture_option_without_a_file_name_is_an_error(tmp_path: Path) -> None:
    for options in ("-clamp", "-clamp on", "-s 1 1", "-o", "-unknown"):
        path = write_obj(tmp_path, mtl=f"newmtl p\nmap_Kd {options}\n")
        with pytest.raises(InputError, match=r"m.mtl: found map_Kd -.*expected the name of a texture"):
            read_mesh(path)


DAMAGED_OBJ = {
    "a number that no computer holds": "f 99999999999999999999/1 2/2 3/3\n",
    "a line of letters": "f " + "1/1 " * 300_000 + "\n",
    "an index of nothing": "f / / /\n",
}


@pytest.mark.parametrize("how", DAMAGED_OBJ)
def test_damaged_faces_are_named_by_their_line(tmp_path: Path, how: str) -> None:
    with pytest.raises(InputError, match=r"m.obj line 12: found "):
        read_mesh(write_obj(tmp_path, body=FACES + DAMAGED_OBJ[how]))


@pytest.mark.parametrize("color", ["Kd inf 0 0", "Kd nan 0 0", "Kd red green blue", "Kd 1e999 0 0"])
def test_invalid_colours_are_refused(tmp_path: Path, color: str) -> None:
    with pytest.raises(InputError, match=r"m.mtl: found Kd .*expected Kd r g b"):
        read_mesh(write_obj(tmp_path, mtl=f"newmtl p\n{color}\n"))


HEADER = "ply\nformat ascii 1.0\nelement vertex 3\n{}element face 1\n{}end_header\n"
XYZ = "property float x\nproperty float y\nproperty float z\n"
RGB = "property uchar red\nproperty uchar green\nproperty uchar blue\n"
INDICES = "property list uchar int vertex_indices\n"
ROWS = "0 0 0 9 9 9\n50 0 0 9 9 9\n0 50 0 9 9 9\n"
DAMAGED_PLY = {
    "coordinates that are lists": HEADER.format(XYZ.replace("float x", "list uchar float x"), INDICES)
    + "1 0 0 0\n1 50 0 0\n1 0 50 0\n3 0 1 2\n",
    "faces that are no lists": HEADER.format(XYZ + RGB, "property int vertex_indices\n") + ROWS + "2\n",
    "colours that are no numbers": HEADER.format(XYZ + RGB, INDICES) + ROWS.replace("9", "nan") + "3 0 1 2\n",
    "indices that are no numbers": HEADER.format(XYZ + RGB, INDICES) + ROWS + "3 0 1 inf\n",
    "a list of negative length": HEADER.format(XYZ + RGB, INDICES.replace("uchar", "int"))
    + ROWS
    + "-3 0 1 2\n",
    "a list without end": HEADER.format(XYZ + RGB, INDICES.replace("uchar", "int"))
    + ROWS
    + "2000000000 0 1 2\n",
    "texture coordinates in threes": HEADER.format(XYZ, INDICES + "property list uchar float texcoord\n")
    + "0 0 0\n50 0 0\n0 50 0\n3 0 1 2 5 0 0 0 0 0\n",
    "texture coordinates too few": HEADER.format(XYZ, INDICES + "property list uchar float texcoord\n")
    + "0 0 0\n50 0 0\n0 50 0\n3 0 1 2 4 0 0 0 0\n",
    "a negative count": HEADER.replace("vertex 3", "vertex -3").format(XYZ + RGB, INDICES)
    + ROWS
    + "3 0 1 2\n",
    "a property of nothing": "ply\nformat ascii 1.0\nproperty float x\nend_header\n",
    "nothing": "ply\nformat ascii 1.0\nend_header\n",
    "spaces": HEADER.format(XYZ + RGB, INDICES) + "  \n",
}


@pytest.mark.parametrize("how", DAMAGED_PLY)
def test_damaged_ply_is_an_input_error(tmp_path: Path, how: str) -> None:
    (tmp_path / "m.ply").write_text(DAMAGED_PLY[how])
    with pytest.raises(InputError, match=r"m.ply: found "):
        read_mesh(tmp_path / "m.ply")


DAMAGED_GLTF = {
    "a list": "[]",
    "brackets without end": "[" * 100_000,
    "not UTF-8": b'{"asset": "\xff"}',
    "a number for a buffer": {"buffers": [{"uri": 7}]},
    "a word for the buffers": {"buffers": "m.bin"},
    "base64 that is none": {"buffers": [{"uri": "data:application/octet-stream;base64,A"}]},
    "a URI without data": {"buffers": [{"uri": "data:"}]},
    "a name without end": {"buffers": [{"uri": "x" * 100_000}]},
    "a name with a zero": {"buffers": [{"uri": "m.bin\0"}]},
    "no name": {"buffers": [{"uri": ""}]},
    "a word for the scenes": {"scenes": "all"},
    "a scene that is not there": {"scene": 5},
    "a matrix of words": {"nodes": [{"mesh": 0, "matrix": ["a"] * 16}]},
    "a scale that is no number": {"nodes": [{"mesh": 0, "scale": [1e308, 1e308, 1e308]}]},
    "a node that contains itself": {"nodes": [{"children": [0]}]},
    "an extension that is no word": {"extensionsRequired": [[]]},
    "an image without anything": {"images": [{}]},
}


@pytest.mark.parametrize("how", DAMAGED_GLTF)
def test_damaged_gltf_is_an_input_error(tmp_path: Path, printed_box: Mesh, how: str) -> None:
    damage = DAMAGED_GLTF[how]
    path = files.write_gltf(tmp_path, printed_box, **(damage if isinstance(damage, dict) else {}))
    if not isinstance(damage, dict):
        path.write_bytes(damage if isinstance(damage, bytes) else damage.encode())
    with pytest.raises(InputError, match=r"(m\.gltf|x{200}|/tmp.*): found "):
        read_mesh(path)
