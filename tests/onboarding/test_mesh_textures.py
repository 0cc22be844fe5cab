"""All colours of a mesh (textures, materials, vertices) become one texture."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from huepose.geometry import Camera, Mesh, se3
from huepose.onboarding.meshes import read_mesh
from huepose.rendering.render import render
from huepose.support.errors import InputError
from tests.onboarding import mesh_files as files
from tests.onboarding import solids
from tests.onboarding.mesh_checks import assert_well_formed, colors_at

CAMERA = Camera(600.0, 600.0, 159.5, 119.5, 320, 240)


def test_faces_without_texture_coordinates_have_the_material_colour(tmp_path: Path) -> None:
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


@pytest.mark.parametrize("form", ["obj", "ply"])
def test_colors_of_vertices_may_be_a_little_over_one(tmp_path: Path, form: str) -> None:
    rows = [f"{at} 1.0000001 0.5 0" for at in ("0 0 0", "30 0 0", "0 30 0", "0 0 30")]
    if form == "obj":
        text = "".join(f"v {row}\n" for row in rows) + "f 1 2 3\nf 1 2 4\n"
    else:
        text = "ply\nformat ascii 1.0\nelement vertex 4\n"
        text += "".join(f"property float {name}\n" for name in ("x", "y", "z", "red", "green", "blue"))
        text += "element face 2\nproperty list uchar int vertex_indices\nend_header\n"
        text += "\n".join([*rows, "3 0 1 2", "3 0 1 3"]) + "\n"
    (tmp_path / f"m.{form}").write_text(text)
    colors = colors_at(read_mesh(tmp_path / f"m.{form}"))
    np.testing.assert_allclose(colors, np.tile([255, 128, 0], (2, 1)), atol=1)


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("white", [255, 65535])
def test_colors_of_vertices_may_have_16_bits(tmp_path: Path, white: int, order: str) -> None:
    form = "binary_little_endian" if order == "<" else "binary_big_endian"
    text = f"ply\nformat {form} 1.0\nelement vertex 4\n" + "".join(f"property float {k}\n" for k in "xyz")
    text += "".join(f"property ushort {name}\n" for name in ("red", "green", "blue"))
    text += "element face 2\nproperty list uchar int vertex_indices\nend_header\n"
    vertices = np.zeros(4, [("at", f"{order}f4", 3), ("color", f"{order}u2", 3)])
    vertices["at"][1:] = 30.0 * np.eye(3)
    vertices["color"] = white, round(0.4 * white), 0
    faces = np.array([(3, (0, 1, 2)), (3, (0, 1, 3))], [("count", "u1"), ("corners", f"{order}i4", 3)])
    (tmp_path / "m.ply").write_bytes(text.encode() + vertices.tobytes() + faces.tobytes())
    colors = colors_at(read_mesh(tmp_path / "m.ply"))
    np.testing.assert_allclose(colors, np.tile([255, 102, 0], (2, 1)), atol=1)


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


@pytest.mark.parametrize("colored", [False, True])
def test_a_ply_of_several_textures_may_have_faces_without_one(tmp_path: Path, colored: bool) -> None:
    """Faces with texnumber -1 have the colours of their vertices, or are grey."""
    text = "ply\nformat ascii 1.0\ncomment TextureFile red.png\ncomment TextureFile blue.png\n"
    text += "element vertex 4\n" + "".join(f"property float {name}\n" for name in "xyz")
    text += "".join(f"property uchar {name}\n" for name in ("red", "green", "blue")) if colored else ""
    text += "element face 3\nproperty list uchar int vertex_indices\nproperty list uchar float texcoord\n"
    text += "property int texnumber\nend_header\n"
    green = " 10 200 10" if colored else ""
    text += "".join(f"{place}{green}\n" for place in ("0 0 0", "60 0 0", "0 60 0", "0 0 60"))
    for corners, number in (("0 1 2", 0), ("0 1 3", -1), ("0 2 3", 1)):
        text += f"3 {corners} 6 0 0 1 0 0 1 {number}\n"
    (tmp_path / "m.ply").write_text(text)
    files.write_png(tmp_path / "red.png", np.full((32, 32, 3), (200, 10, 10), np.uint8))
    files.write_png(tmp_path / "blue.png", np.full((32, 32, 3), (10, 10, 200), np.uint8))
    mesh = read_mesh(tmp_path / "m.ply")
    assert_well_formed(mesh)
    expected = [[200, 10, 10], [10, 200, 10] if colored else [200, 200, 200], [10, 10, 200]]
    np.testing.assert_allclose(colors_at(mesh), expected, atol=2)
    (tmp_path / "m.ply").write_text(text.replace("0 0 1 0 0 1 1\n", "0 0 1 0 0 1 2\n"))
    with pytest.raises(InputError, match=r"a texnumber without texture; expected 0 to 1"):
        read_mesh(tmp_path / "m.ply")


@pytest.mark.parametrize("materials", [1, 3])
def test_faces_without_a_texture_are_rendered_in_the_material_colour(tmp_path: Path, materials: int) -> None:
    """Near the camera, and so far away that the coarsest texture levels are read."""
    colors = [(51, 76, 204), (230, 26, 26), (26, 204, 51)][:materials]
    lines = ["mtllib m.mtl"]
    for k in range(materials):
        # One fan of small triangles for each material, side by side.
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
    uv = (0.3 + 0.4 * mesh.uv).astype(np.float32)  # the middle of the texture is used; the rest is magenta
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


@pytest.mark.parametrize("width", [16, 100])
@pytest.mark.parametrize("tile", [0, 1, -2])
def test_a_palette_texture_is_read_in_every_tile(tmp_path: Path, width: int, tile: int) -> None:
    palette = np.random.default_rng(width).integers(0, 256, (1, width, 3)).astype(np.uint8)
    texels = np.linspace(1, width - 1, 12).astype(int)
    uv = np.full((12, 3, 2), 0.5, np.float32)
    uv[..., 0] = ((texels + 0.5) / width + tile)[:, None]
    mesh = solids.box((0.08, 0.06, 0.04))
    files.write_obj(tmp_path / "m.obj", Mesh(mesh.vertices, mesh.faces, uv, palette))
    np.testing.assert_allclose(colors_at(read_mesh(tmp_path / "m.obj")), palette[0, texels], atol=1)


def shown(wrap: int | None, u: float) -> float:
    """The texture coordinate in [0, 1] that is shown at `u`."""
    if wrap == 33071:
        return min(max(u, 0.0), 1.0)
    return abs((u + 1) % 2 - 1) if wrap == 33648 else u % 1


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("wrap", [None, 10497, 33648, 33071])
def test_textures_of_a_gltf_wrap_as_their_sampler_says(tmp_path: Path, wrap: int | None, axis: int) -> None:
    ramp = np.repeat(np.arange(0, 256, 4, dtype=np.uint8)[None, :, None], 64, axis=0).repeat(3, axis=2)
    mesh = solids.box((0.08, 0.06, 0.04))
    uv = np.tile(np.array([[-1, 0.2], [2, 0.2], [2, 0.8]], np.float32), (12, 1, 1))
    uv[6:, :, 0] = [1.2, 1.4, 1.4]  # wholly outside
    if axis == 1:
        ramp, uv = ramp.transpose(1, 0, 2), uv[..., ::-1]
    sampler = {} if wrap is None else {"wrapS" if axis == 0 else "wrapT": wrap}
    files.write_glb(tmp_path / "m.glb", Mesh(mesh.vertices, mesh.faces, uv, ramp), sampler=sampler)
    read = read_mesh(tmp_path / "m.glb")
    assert_well_formed(read)
    for u in (-0.7, -0.3, 0.4, 1.3, 1.8):
        expected = np.clip(256 * shown(wrap, u) - 2, 0, 252)
        t = (u + 1) / 3
        np.testing.assert_allclose(colors_at(read, (1 - t, t, 0))[0], expected, atol=1.5)
    expected = np.clip(256 * shown(wrap, 1.3) - 2, 0, 252)
    np.testing.assert_allclose(colors_at(read, (0.5, 0.5, 0))[6], expected, atol=1.5)


@pytest.mark.parametrize(("option", "value"), [("", 0), ("-clamp off", 0), ("-clamp on", 200)])
def test_a_texture_of_an_obj_may_be_clamped(tmp_path: Path, option: str, value: int) -> None:
    picture = np.zeros((16, 16, 3), np.uint8)
    picture[:, 8:] = 200
    mesh = solids.box((0.08, 0.06, 0.04))
    uv = np.tile(np.array([[1.1, 0.5], [1.4, 0.5], [1.4, 0.6]], np.float32), (12, 1, 1))
    files.write_obj(tmp_path / "m.obj", Mesh(mesh.vertices, mesh.faces, uv, picture))
    (tmp_path / "m.mtl").write_text(f"newmtl print\nmap_Kd {option} m.png\n")
    np.testing.assert_allclose(colors_at(read_mesh(tmp_path / "m.obj")), value, atol=1)


@pytest.mark.parametrize("whites", [False, True])
def test_vertex_colours_are_used_for_faces_without_a_texture(tmp_path: Path, whites: bool) -> None:
    """If all vertices are white, the faces without a texture keep the material colour."""
    ends = ["1 1 1"] * 4 if whites else ["1 0 0", "0 1 0", "0 0 1", "1 0 1"]
    places = ("0 0 0", "60 0 0", "0 60 0", "0 0 60")
    text = "mtllib m.mtl\n" + "".join(f"v {v} {c}\n" for v, c in zip(places, ends, strict=True))
    text += "vt 0 0\nvt 1 0\nvt 0 1\nusemtl print\nf 1/1 2/2 3/3\nusemtl plain\nf 1 4 2\nf 1 3 4\n"
    (tmp_path / "m.obj").write_text(text)
    (tmp_path / "m.mtl").write_text("newmtl print\nmap_Kd m.png\nnewmtl plain\nKd 0.2 0.4 0.6\n")
    files.write_png(tmp_path / "m.png", np.full((64, 64, 3), (200, 10, 10), np.uint8))
    mesh = read_mesh(tmp_path / "m.obj")
    assert_well_formed(mesh)
    expected = np.array([[200, 10, 10], [204, 51, 76.5], [178.5, 0, 127.5]])
    if whites:
        expected[1:] = [51, 102, 153]
    np.testing.assert_allclose(colors_at(mesh, (0.5, 0.3, 0.2)), expected, atol=2)


_WHITE, _MESHLAB, _RED = "1 1 1", "0.752941 0.752941 0.752941", "1 0 0"


@pytest.mark.parametrize(
    ("ends", "kinds", "shown"),
    [
        (_WHITE, ("Kd 1 0 0", "Kd 0 0 1"), [(255, 0, 0), (0, 0, 255)]),
        (_MESHLAB, ("Kd 1 0 0", "Kd 0 0 1"), [(255, 0, 0), (0, 0, 255)]),
        (_MESHLAB, ("Kd 0.2 0.2 0.2", "Kd 0.8 0.8 0.8"), [(51, 51, 51), (204, 204, 204)]),
        (_WHITE, ("Kd 1 0 0", "Kd 1 0 0"), [(255, 0, 0), (255, 0, 0)]),
        (_MESHLAB, ("Kd 0.8 0.8 0.8", "Kd 0.8 0.8 0.8"), [(192, 192, 192), (192, 192, 192)]),
        (_WHITE, ("illum 2", "illum 2"), [(255, 255, 255), (255, 255, 255)]),
        (_RED, ("Kd 0 1 0", "Kd 0 0 1"), [(255, 0, 0), (255, 0, 0)]),
    ],
)
def test_uniform_grey_vertex_colours_do_not_replace_material_colours(
    ends: str, kinds: tuple[str, str], shown: list[tuple[int, int, int]], tmp_path: Path
) -> None:
    """Exporters write one grey or white if there are no vertex colours; any other colour counts."""
    places = ("0 0 0", "60 0 0", "0 60 0", "0 0 60")
    text = "mtllib m.mtl\n" + "".join(f"v {v} {ends}\n" for v in places)
    (tmp_path / "m.obj").write_text(text + "usemtl a\nf 1 2 3\nusemtl b\nf 1 4 2\n")
    (tmp_path / "m.mtl").write_text("newmtl a\n{}\nnewmtl b\n{}\n".format(*kinds))
    colors = colors_at(read_mesh(tmp_path / "m.obj"), (0.5, 0.3, 0.2))
    np.testing.assert_allclose(colors, shown, atol=1)


def test_a_gltf_may_mix_textured_and_vertex_coloured_parts(tmp_path: Path) -> None:
    box = solids.box((0.08, 0.06, 0.04))
    w = files.GlbWriter()
    at = w.accessor(box.vertices[box.faces].reshape(-1, 3).astype("<f4"), "VEC3")
    uv = w.accessor(box.uv.reshape(-1, 2).astype("<f4"), "VEC2")
    green = w.accessor(np.tile(np.array([[0, 1, 0]], "<f4"), (36, 1)), "VEC3")
    white = w.accessor(np.ones((36, 3), "<f4"), "VEC3")
    printed = w.textured_material(np.full((64, 64, 3), (200, 10, 10), np.uint8))
    w.tree["materials"].append({})
    a = w.mesh({"POSITION": at, "TEXCOORD_0": uv, "COLOR_0": white}, material=printed)
    b = w.mesh({"POSITION": at, "COLOR_0": green}, material=1)
    w.write(tmp_path / "m.glb", [{"mesh": a}, {"mesh": b, "translation": [0.1, 0, 0]}], [0, 1])
    colors = colors_at(read_mesh(tmp_path / "m.glb"))
    np.testing.assert_allclose(colors[:12], np.tile([200, 10, 10], (12, 1)), atol=1)
    np.testing.assert_array_equal(colors[12:], np.tile([0, 255, 0], (12, 1)))
