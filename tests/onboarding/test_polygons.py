"""Polygons with recesses and holes become triangles that cover them and nothing else."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from huepose.onboarding import polygons
from huepose.onboarding.meshes import read_mesh
from huepose.support.errors import InputError
from tests.onboarding import mesh_files as files

L = np.array([[0, 0], [120, 0], [120, 30], [45, 30], [45, 90], [0, 90]], float)
"""6,300 square millimetres. The fan from corner 0 stays inside; the fan from corner 1 does not."""
RING = np.array(
    [[0, 0], [90, 0], [90, 90], [0, 90], [0, 0], [30, 30], [30, 60], [60, 60], [60, 30], [30, 30]], float
)
"""A square with a square hole, joined by a cut between their first corners."""


def _area(points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    a, b, c = (points[triangles[:, k]] for k in range(3))
    return 0.5 * ((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0])


@pytest.mark.parametrize(("points", "area"), [(L, 6300.0), (RING, 7200.0)])
@pytest.mark.parametrize("first", range(6))
def test_triangulation_covers_a_polygon_from_every_first_corner(
    points: np.ndarray, area: float, first: int
) -> None:
    points = np.roll(points, first, 0)
    for axes in ([0, 1, 2], [1, 2, 0], [2, 0, 1], [1, 0, 2]):
        there = np.c_[points, np.full(len(points), 7.0)][:, axes]
        triangles = polygons.ears(there, Path("m.obj"))
        areas = _area(points, triangles)
        assert len(triangles) == len(points) - 2
        assert (areas >= 0).all(), "all triangles have the winding of the polygon"
        assert areas.sum() == pytest.approx(area)


def test_a_star_of_a_thousand_corners_is_covered() -> None:
    turn = np.linspace(0.0, 2.0 * np.pi, 1000, endpoint=False)
    star = np.c_[np.cos(turn), np.sin(turn)] * np.where(np.arange(1000) % 2, 1.0, 0.5)[:, None]
    areas = _area(star, polygons.ears(np.c_[star, np.zeros(1000)], Path("m.obj")))
    x, y = star.T
    assert (areas >= 0).all()
    assert areas.sum() == pytest.approx(0.5 * (x * np.roll(y, -1) - np.roll(x, -1) * y).sum())
    with pytest.raises(InputError, match=r"m.obj: found a polygon with a recess and 3000 corners; .*Export"):
        polygons.ears(np.zeros((3000, 3)), Path("m.obj"))


@pytest.mark.parametrize("form", ["obj", "ply"])
def test_a_bracket_keeps_its_recess(form: str, tmp_path: Path) -> None:
    """Modelling programs write it without triangulation: two L shapes and six rectangles."""
    vertices = np.r_[np.c_[L, np.zeros(6)], np.c_[L, np.full(6, 35.0)]]
    top, bottom = [(k + 1) % 6 + 6 for k in range(6)], [5, 4, 3, 2, 1, 0]
    faces = [top, bottom, *([k, (k + 1) % 6, (k + 1) % 6 + 6, k + 6] for k in range(6))]
    path = tmp_path / f"m.{form}"
    if form == "ply":
        files.write_colored_ply(path, vertices, np.full((12, 3), 90), faces)
    else:
        rows = ["v {} {} {} 0.3 0.3 0.3".format(*v) for v in vertices]
        path.write_text("\n".join(rows + ["f " + " ".join(str(k + 1) for k in face) for face in faces]))
    mesh = read_mesh(path, "mm")
    a, b, c = (mesh.vertices[mesh.faces[:, k]].astype(float) for k in range(3))
    areas = np.cross(b - a, c - a) / 2.0
    assert np.linalg.norm(areas, axis=1).sum() == pytest.approx(2 * 0.0063 + 0.42 * 0.035, rel=1e-5)
    assert (a * areas).sum() / 3.0 == pytest.approx(0.0063 * 0.035, rel=1e-5), "the volume"


def test_lines_among_the_polygons_do_not_fill_a_recess(tmp_path: Path) -> None:
    """Some programs write edges as polygons of two corners."""
    for lines in range(6):
        faces = [[0, 1]] * lines + [[1, 2, 3, 4, 5, 0]]
        files.write_colored_ply(tmp_path / "m.ply", np.c_[L, np.zeros(6)], np.full((6, 3), 90), faces)
        areas = read_mesh(tmp_path / "m.ply", "mm").face_normals()[1]
        assert areas.sum() == pytest.approx(0.0063, rel=1e-5)


def test_corners_keep_their_texture_coordinates(tmp_path: Path) -> None:
    picture = np.zeros((90, 120, 3), np.uint8)
    picture[:, :, 0] = np.arange(120)
    files.write_png(tmp_path / "m.png", picture)
    (tmp_path / "m.mtl").write_text("newmtl a\nmap_Kd m.png\n")
    rows = ["mtllib m.mtl", *("v {} {} 0".format(*p) for p in L), "v 0 0 50"]
    rows += ["vt {} {}".format(*p / [120, 90]) for p in L]
    rows += ["usemtl a", "f 2/2 3/3 4/4 5/5 6/6 1/1", "f 1/1 2/2 7/1"]
    (tmp_path / "m.obj").write_text("\n".join(rows))
    mesh = read_mesh(tmp_path / "m.obj", "mm")
    at = mesh.vertices[mesh.faces[:-1]][..., :2] * 1000.0 / [120, 90]
    wide = mesh.uv[:-1] - np.c_[at[..., :1], 1.0 - at[..., 1:]].reshape(-1, 3, 2)
    assert np.abs(wide).max() < 0.02, "off by a texel or two at most"
