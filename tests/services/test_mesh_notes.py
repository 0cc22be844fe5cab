"""What is noted about a mesh before it is onboarded."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from huepose.onboarding.batch import Job
from huepose.onboarding.texture import used_texels
from huepose_services.cli.mesh_unit import with_unit
from tests.onboarding import mesh_files as files
from tests.onboarding import solids


def test_the_meshes_of_a_file_that_are_taken_as_one_object_are_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    box = solids.box((0.06, 0.04, 0.03))
    for names in (["carton"], ["carton", "second"], [f"part {k}" for k in range(8)]):
        w = files.GlbWriter()
        mesh = w.mesh(w.corners(box), material=w.textured_material(box.texture))
        nodes = [{"name": name, "mesh": mesh, "translation": [0.1 * k, 0, 0]} for k, name in enumerate(names)]
        nodes.append({"name": "a light"})
        w.write(tmp_path / f"{len(names)}.glb", nodes, list(range(len(nodes))))

    def said(count: int) -> str:
        with_unit(Job(tmp_path / f"{count}.glb", "m"))
        return capsys.readouterr().err

    assert said(1) == ""
    assert "note: the file has 2 meshes: carton, second; they are taken as one object. If they" in said(2)
    assert "8 meshes: part 0, part 1, part 2, part 3, part 4 and 3 more; they" in said(8)


@pytest.mark.parametrize(
    ("form", "mode", "everywhere", "noted"),
    [
        ("obj", "", True, "note: 100 % of the surface is transparent; it is read as opaque, in the colour"),
        ("obj", "", False, ""),
        ("glb", "MASK", True, "note: 100 % of the surface is transparent"),
        ("glb", "OPAQUE", True, ""),
    ],
)
def test_transparency_is_noted_only_where_the_surface_uses_the_texture(
    form: str, mode: str, everywhere: bool, noted: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A texture atlas is often transparent between its parts."""
    box = solids.box((0.06, 0.04, 0.03))
    used = cv2.dilate(used_texels(box.uv, *box.texture.shape[:2]), np.ones((3, 3), np.uint8))
    alpha = np.zeros_like(used) if everywhere else 255 * used
    clear = cv2.imencode(".png", np.dstack([box.texture[..., ::-1], alpha]))[1].tobytes()
    if form == "obj":
        files.write_obj(tmp_path / "m.obj", box)
        (tmp_path / "m.png").write_bytes(clear)
    else:
        w = files.GlbWriter()
        material = w.textured_material(box.texture)
        w.tree["images"][0]["bufferView"] = w.view(clear)
        w.tree["materials"][0]["alphaMode"] = mode
        w.write(tmp_path / "m.glb", [{"mesh": w.mesh(w.corners(box), material=material)}], [0])
    with_unit(Job(tmp_path / f"m.{form}", "m", unit="mm" if form == "obj" else "m"))
    said = capsys.readouterr().err
    assert said.startswith(noted) if noted else said == ""


def clear_window(path: Path, opacity: str, mode: str = "BLEND") -> None:
    """Writes a cube without a texture, one side of which has another material. opacity: of that material, as
    lines of an MTL file or as the alpha of a glTF."""
    box = solids.box((0.06, 0.06, 0.06))
    if path.suffix == ".obj":
        corners = [f"v {x * 1000:g} {y * 1000:g} {z * 1000:g}" for x, y, z in box.vertices]
        faces = [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in box.faces]
        lines = [f"mtllib {path.stem}.mtl", *corners, "usemtl wall", *faces[2:], "usemtl window", *faces[:2]]
        path.write_text("\n".join(lines))
        path.with_suffix(".mtl").write_text(
            f"newmtl window\n{opacity}\nKd 1 0 0\nnewmtl wall\nKd 0 1 0\nd 1\n"
        )
        return
    w, primitives = files.GlbWriter(), []
    for number, faces in enumerate((box.faces[2:], box.faces[:2])):
        place = w.accessor(box.vertices[faces].reshape(-1, 3).astype("<f4"), "VEC3")
        primitives.append({"attributes": {"POSITION": place}, "material": number})
    colors = [[0.0, 1.0, 0.0, 1.0], [1.0, 0.0, 0.0, float(opacity)]]
    w.tree["materials"] = [
        {"pbrMetallicRoughness": {"baseColorFactor": color}, "alphaMode": mode} for color in colors
    ]
    w.tree["meshes"] = [{"primitives": primitives}]
    w.write(path, [{"mesh": 0}], [0])


@pytest.mark.parametrize(
    ("file", "opacity", "mode", "noted"),
    [
        ("m.obj", "d 0", "", True),
        ("m.obj", "Tr 1", "", True),
        ("m.obj", "d -halo 0.1", "", True),
        ("m.obj", "Tr 1\nd 1", "", False),
        ("m.obj", "d 0.9", "", False),
        ("m.glb", "0.0", "BLEND", True),
        ("m.glb", "0.9", "BLEND", False),
        ("m.glb", "0.0", "OPAQUE", False),
    ],
)
def test_a_material_that_is_transparent_is_noted(
    file: str, opacity: str, mode: str, noted: bool, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    clear_window(tmp_path / file, opacity, mode)
    with_unit(Job(tmp_path / file, "m", unit="mm" if file == "m.obj" else "m"))
    said = capsys.readouterr().err
    assert said.startswith("note: 17 % of the surface is transparent;") if noted else said == ""


@pytest.mark.parametrize(("away_m", "noted"), [(0.1, ""), (5.4, "5.4 m")])
def test_a_mesh_whose_origin_is_far_from_it_is_noted(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], away_m: float, noted: str
) -> None:
    box = solids.box((0.06, 0.04, 0.03))
    moved = replace(box, vertices=box.vertices + np.array([0.0, away_m, 0.0], np.float32))
    files.write_obj(tmp_path / "m.obj", moved, scale=1000.0)
    with_unit(Job(tmp_path / "m.obj", "m", unit="mm"))
    said = capsys.readouterr().err
    note = f"note: the mesh's origin lies {noted} from the object; poses are poses of that origin."
    assert said.startswith(note) if noted else said == ""
