from __future__ import annotations

import base64
import json
import struct
from pathlib import Path

import numpy as np
import pytest

from huepose.geometry import Camera, Mesh, se3
from huepose.onboarding.meshes import Unit, read_mesh
from huepose.rendering.render import render
from huepose.support.errors import InputError
from tests.onboarding import mesh_files as files
from tests.onboarding import solids

CAMERA = Camera(600.0, 600.0, 159.5, 119.5, 320, 240)


@pytest.fixture(scope="module")
def printed_box() -> Mesh:
    """A box of 8 x 6 x 4 cm, all sides of noise: every texel is used."""
    rng = np.random.default_rng(3)
    pictures = {side: rng.integers(0, 256, (64, 64, 3)).astype(np.uint8) for side in solids.SIDES}
    return solids.box((0.08, 0.06, 0.04), pictures)


def colors_at(mesh: Mesh, weights: tuple[float, float, float] = (0.5, 0.3, 0.2)) -> np.ndarray:
    """Colours (F, 3) at a point of each face, bilinear, by the convention of Mesh."""
    uv = np.einsum("k,fkd->fd", np.array(weights), mesh.uv.astype(np.float64))
    height, width = mesh.texture.shape[:2]
    x, y = uv[:, 0] * width - 0.5, uv[:, 1] * height - 0.5
    x0, y0 = np.floor(x).astype(int), np.floor(y).astype(int)
    fx, fy = (x - x0)[:, None], (y - y0)[:, None]

    def texel(i: np.ndarray, j: np.ndarray) -> np.ndarray:
        return mesh.texture[np.clip(j, 0, height - 1), np.clip(i, 0, width - 1)].astype(np.float64)

    top = texel(x0, y0) * (1 - fx) + texel(x0 + 1, y0) * fx
    bottom = texel(x0, y0 + 1) * (1 - fx) + texel(x0 + 1, y0 + 1) * fx
    return top * (1 - fy) + bottom * fy


def assert_same(a: Mesh, b: Mesh) -> None:
    np.testing.assert_allclose(a.vertices[a.faces], b.vertices[b.faces], atol=1e-7)
    np.testing.assert_allclose(a.uv, b.uv, atol=1e-6)
    np.testing.assert_array_equal(a.texture, b.texture)


def assert_well_formed(mesh: Mesh) -> None:
    kinds = [a.dtype.name for a in (mesh.vertices, mesh.faces, mesh.uv, mesh.texture)]
    assert kinds == ["float32", "int32", "float32", "uint8"]
    assert mesh.uv.shape == (len(mesh.faces), 3, 2)
    assert mesh.uv.min() >= 0
    assert mesh.uv.max() <= 1


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
def test_forms_of_obj_faces(tmp_path: Path, face: str) -> None:
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


def test_faces_without_texture_coordinates(tmp_path: Path) -> None:
    head = "v 0 0 0 1 0 0\nv 30 0 0 0 1 0\nv 0 30 0 0 0 1\nv 0 0 30 1 1 1\n"
    (tmp_path / "m.obj").write_text(head + "vn 0 0 1\nf 1//1 2//1 3//1\nf 1 2 4\n")
    mesh = read_mesh(tmp_path / "m.obj")
    np.testing.assert_allclose(colors_at(mesh)[0], [127.5, 76.5, 51], atol=1.5)
    np.testing.assert_allclose(colors_at(mesh)[1], [178.5, 127.5, 51], atol=1.5)


@pytest.mark.parametrize("count", [1, 2, 12, 500, 20_000])
def test_colors_of_vertices_are_baked_exactly(tmp_path: Path, count: int) -> None:
    rng = np.random.default_rng(count)
    vertices = rng.uniform(-50, 50, (3 * count, 3))
    colors = rng.integers(86, 170, (3 * count, 3))  # where patches are small, starker contrasts are clipped
    files.write_colored_ply(
        tmp_path / "m.ply", vertices, colors, np.arange(3 * count).reshape(-1, 3).tolist()
    )
    mesh = read_mesh(tmp_path / "m.ply")
    assert_well_formed(mesh)
    assert max(mesh.texture.shape) <= 1024
    for weights in ((0.5, 0.3, 0.2), (1.0, 0.0, 0.0), (0.0, 0.0, 1.0), (0.1, 0.8, 0.1)):
        expected = np.einsum("k,fkc->fc", np.array(weights), colors.reshape(-1, 3, 3))
        np.testing.assert_allclose(colors_at(mesh, weights), expected, atol=1.5)


def test_polygons_of_a_ply_become_fans(tmp_path: Path) -> None:
    square = np.array([[0, 0, 0], [40, 0, 0], [40, 40, 0], [0, 40, 0], [0, 0, 40]], float)
    files.write_colored_ply(tmp_path / "m.ply", square, np.full((5, 3), 90), [[0, 1, 2, 3], [0, 1, 4]])
    assert read_mesh(tmp_path / "m.ply").faces.tolist() == [[0, 1, 2], [0, 2, 3], [0, 1, 4]]


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
def test_names_may_be_of_any_letters(tmp_path: Path, printed_box: Mesh, encoding: str) -> None:
    files.write_obj(tmp_path / "m.obj", printed_box)
    files.write_ply(tmp_path / "m.ply", printed_box, binary=True, lists=False)
    (tmp_path / "m.png").rename(tmp_path / "Körper.png")
    for name in ("m.mtl", "m.ply"):
        file = tmp_path / name
        file.write_bytes(file.read_bytes().replace(b"m.png", "Körper.png".encode(encoding)))
    for name in ("m.obj", "m.ply"):
        assert_same(read_mesh(tmp_path / name), printed_box)


def test_several_materials_become_one_texture(tmp_path: Path) -> None:
    text = "mtllib m.mtl\nv 0 0 0\nv 60 0 0\nv 0 60 0\nv 0 0 60\nvt 0 0\nvt 1 0\nvt 0 1\n"
    text += "usemtl red\nf 1/1 2/2 3/3\nusemtl plain\nf 1 2 4\nusemtl blue\nf 1/1 3/2 4/3\n"
    (tmp_path / "m.obj").write_text(text)
    maps = "newmtl red\nmap_Kd red.png\nnewmtl plain\nKd 0 1 0\nnewmtl blue\nmap_Kd -clamp on blue.png\n"
    (tmp_path / "m.mtl").write_text(maps)
    files.write_png(tmp_path / "red.png", np.full((700, 900, 3), (200, 10, 10), np.uint8))
    files.write_png(tmp_path / "blue.png", np.full((800, 300, 3), (10, 10, 200), np.uint8))
    mesh = read_mesh(tmp_path / "m.obj")
    assert_well_formed(mesh)
    assert max(mesh.texture.shape) <= 1024
    for weights in ((1.0, 0, 0), (0.3, 0.3, 0.4), (0, 0, 1.0)):
        expected = [[200, 10, 10], [0, 255, 0], [10, 10, 200]]
        np.testing.assert_allclose(colors_at(mesh, weights), expected, atol=2)


@pytest.mark.parametrize("materials", [1, 3])
def test_what_has_colours_and_no_texture_is_drawn_in_them(tmp_path: Path, materials: int) -> None:
    """Near by and from so far away that the coarsest levels of the texture are read."""
    colors = [(51, 76, 204), (230, 26, 26), (26, 204, 51)][:materials]
    lines = ["mtllib m.mtl"]
    for k in range(materials):
        # A fan of small triangles for each, side by side.
        x, start = 0.05 * k, 42 * k + 1
        lines += [f"usemtl m{k}", f"v {x:g} 0 0"]
        lines += [f"v {x + 0.02 * np.cos(a):g} {0.02 * np.sin(a):g} 0" for a in np.linspace(0, 2 * np.pi, 41)]
        lines += [f"f {start} {start + i + 1} {start + i}" for i in range(1, 41)]
    (tmp_path / "m.obj").write_text("\n".join(lines))
    kinds = [f"newmtl m{k}\nKd {r / 255} {g / 255} {b / 255}\n" for k, (r, g, b) in enumerate(colors)]
    (tmp_path / "m.mtl").write_text("".join(kinds))
    mesh = read_mesh(tmp_path / "m.obj", "m")
    for distance_m in (0.5, 4.0):
        T = se3.make(np.eye(3), np.array([0.0, 0.0, distance_m]))
        picture = render([(mesh, T)], CAMERA)
        pixels = np.rint(CAMERA.project(se3.apply(T, [[0.05 * k, 0.0, 0.0] for k in range(materials)])))
        seen = [picture.color[int(v), int(u)] for u, v in pixels]
        np.testing.assert_allclose(np.array(seen), colors, atol=3)


def test_large_textures_are_reduced_without_their_background(tmp_path: Path) -> None:
    mesh = solids.box((0.08, 0.06, 0.04))
    uv = (0.3 + 0.4 * mesh.uv).astype(np.float32)  # the texture fills the middle; round it lies magenta
    size = 2560
    picture = np.full((size, size, 3), (255, 0, 255), np.uint8)
    a, b = int(0.3 * size), int(0.7 * size)
    picture[a - 1 : b + 1, a - 1 : b + 1] = (20, 140, 60)
    files.write_obj(tmp_path / "m.obj", Mesh(mesh.vertices, mesh.faces, uv, picture))
    read = read_mesh(tmp_path / "m.obj")
    assert read.texture.shape == (1024, 1024, 3)
    assert np.abs(read.texture.astype(int) - [20, 140, 60]).max() <= 2


def test_textures_that_repeat_are_unrolled(tmp_path: Path) -> None:
    picture = np.zeros((32, 32, 3), np.uint8)
    picture[:, :16] = 200
    mesh = solids.box((0.08, 0.06, 0.04))
    uv = np.tile(np.array([[-1, 3], [1, 3], [1, 4]], np.float32), (12, 1, 1))
    files.write_obj(tmp_path / "m.obj", Mesh(mesh.vertices, mesh.faces, uv, picture))
    read = read_mesh(tmp_path / "m.obj")
    assert_well_formed(read)
    for u, value in ((0.1, 200), (0.4, 0), (0.6, 200), (0.9, 0)):
        np.testing.assert_allclose(colors_at(read, (1 - u, u, 0))[0], value, atol=1)


def test_a_mirrored_export_is_turned_outwards(tmp_path: Path, printed_box: Mesh) -> None:
    from huepose.scenes.shapes import demo_objects

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


def test_gltf_may_be_in_parts(tmp_path: Path, printed_box: Mesh) -> None:
    w = files.GlbWriter()
    attributes = {
        "POSITION": w.accessor(printed_box.vertices[printed_box.faces].reshape(-1, 3).astype("<f4"), "VEC3"),
        "TEXCOORD_0": w.accessor(printed_box.uv.reshape(-1, 2).astype("<f4"), "VEC2"),
    }
    index = w.mesh(attributes, material=0)
    files.write_png(tmp_path / "my print.png", printed_box.texture)
    tree = {k: w.tree[k] for k in ("asset", "bufferViews", "accessors", "meshes")}
    tree |= {"images": [{"uri": "my%20print.png"}], "textures": [{"source": 0}]}
    tree |= {"materials": [{"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}]}
    tree |= {"nodes": [{"mesh": index}], "scenes": [{"nodes": [0]}]}
    inline = "data:application/octet-stream;base64," + base64.b64encode(w.chunk).decode()
    (tmp_path / "m.bin").write_bytes(w.chunk)
    for uri in ("m.bin", inline):
        (tmp_path / "m.gltf").write_text(json.dumps(tree | {"buffers": [{"uri": uri}]}))
        assert_same(read_mesh(tmp_path / "m.gltf"), printed_box)
    (tmp_path / "m.gltf").write_text(json.dumps(tree | {"buffers": [{"uri": "gone.bin"}]}))
    with pytest.raises(InputError, match=r"gone.bin: found no such file; expected the buffer, which m.gltf"):
        read_mesh(tmp_path / "m.gltf")


@pytest.mark.parametrize(("size", "expected"), [(0.2, 0.2), (200.0, 0.2), (1.5, 1.5), (15.0, 0.015)])
def test_units_are_found_where_the_size_tells(tmp_path: Path, size: float, expected: float) -> None:
    files.write_obj(tmp_path / "m.obj", solids.box((1.0, 0.5, 0.5)), scale=size)
    np.testing.assert_allclose(np.ptp(read_mesh(tmp_path / "m.obj").vertices[:, 0]), expected, rtol=1e-5)


@pytest.mark.parametrize(("unit", "metres"), [("mm", 0.015), ("cm", 0.15), ("in", 0.381)])
def test_what_the_size_does_not_tell_can_be_said(tmp_path: Path, unit: Unit, metres: float) -> None:
    files.write_obj(tmp_path / "m.obj", solids.box((15.0, 8.0, 6.0)), scale=1.0)
    assert np.ptp(read_mesh(tmp_path / "m.obj", unit).vertices[:, 0]) == pytest.approx(metres)


@pytest.mark.parametrize(("size", "unit"), [(5.0, None), (0.2, "mm"), (200.0, "m"), (4000.0, None)])
def test_implausible_sizes_are_refused_with_both_readings(
    tmp_path: Path, size: float, unit: str | None
) -> None:
    files.write_obj(tmp_path / "m.obj", solids.box((1.0, 0.5, 0.5)), scale=size)
    with pytest.raises(InputError, match=r"if it is in m or .* if it is in mm.*--unit") as caught:
        read_mesh(tmp_path / "m.obj", unit)
    assert "m.obj" in str(caught.value)


def test_gltf_is_metres_unless_told(tmp_path: Path) -> None:
    files.write_glb(tmp_path / "m.glb", solids.box((80.0, 60.0, 40.0)))
    with pytest.raises(InputError, match=r"80 m if it is in m or 8 cm if it is in mm.*Give --unit mm"):
        read_mesh(tmp_path / "m.glb")
    np.testing.assert_allclose(
        np.ptp(read_mesh(tmp_path / "m.glb", "mm").vertices, axis=0), [0.08, 0.06, 0.04]
    )


def test_names_of_textures_may_differ_in_case_and_folder(tmp_path: Path, printed_box: Mesh) -> None:
    files.write_obj(tmp_path / "m.obj", printed_box, texture_name="Print.PNG")
    mtl = tmp_path / "m.mtl"
    for name in ("print.png", "sub\\print.png", "C:\\Users\\me\\Print.PNG"):
        mtl.write_text(f"newmtl print\nmap_Kd {name}\n")
        assert_same(read_mesh(tmp_path / "m.obj"), printed_box)


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
