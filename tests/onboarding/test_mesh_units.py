"""The unit of a mesh: from its size, the file format or the user."""

from __future__ import annotations

import tracemalloc
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from huepose.geometry import Mesh
from huepose.onboarding.meshes import Unit, look_at, read_mesh
from huepose.support.errors import InputError
from tests.onboarding import mesh_files as files
from tests.onboarding import solids


@pytest.mark.parametrize(("size", "expected"), [(0.2, 0.2), (200.0, 0.2), (1.5, 1.5), (15.0, 0.015)])
def test_the_unit_is_inferred_from_a_clear_size(tmp_path: Path, size: float, expected: float) -> None:
    files.write_obj(tmp_path / "m.obj", solids.box((1.0, 0.5, 0.5)), scale=size)
    np.testing.assert_allclose(np.ptp(read_mesh(tmp_path / "m.obj").vertices[:, 0]), expected, rtol=1e-5)


@pytest.mark.parametrize(("unit", "metres"), [("mm", 0.015), ("cm", 0.15), ("in", 0.381)])
def test_the_unit_can_be_given(tmp_path: Path, unit: Unit, metres: float) -> None:
    files.write_obj(tmp_path / "m.obj", solids.box((15.0, 8.0, 6.0)), scale=1.0)
    assert np.ptp(read_mesh(tmp_path / "m.obj", unit).vertices[:, 0]) == pytest.approx(metres)


@pytest.mark.parametrize(
    ("size", "unit", "said"),
    [
        (
            5.0,
            None,
            "5 m if it is in metres or 5 mm if it is in millimetres or 5 cm if it is in centimetres "
            "or 12.7 cm if it is in inches or 1.524 m if it is in feet; "
            "expected an object of 1 cm to 2 m. Give --unit cm or --unit in or --unit ft.",
        ),
        (
            15.0,
            "m",
            "(taken as m): 15 m if it is in metres or 1.5 cm if it is in millimetres or 15 cm if it is in "
            "centimetres or 38.1 cm if it is in inches; expected an object of 1 cm to 2 m. "
            "Did you mean --unit mm or --unit cm or --unit in?",
        ),
        (
            0.2,
            "mm",
            "20 cm if it is in metres or 6.096 cm if it is in feet; expected an object of 1 cm to 2 m. "
            "Did you mean --unit m or --unit ft?",
        ),
        (4000.0, None, "No --unit (mm, cm, m, in, ft) gives that size: scale the mesh."),
    ],
)
def test_implausible_sizes_are_refused_with_all_plausible_units(
    tmp_path: Path, size: float, unit: Unit | None, said: str
) -> None:
    files.write_obj(tmp_path / "m.obj", solids.box((1.0, 0.5, 0.5)), scale=size)
    with pytest.raises(InputError) as caught:
        read_mesh(tmp_path / "m.obj", unit)
    assert "m.obj: found a largest side of" in str(caught.value)
    assert str(caught.value).endswith(said)


@pytest.mark.parametrize("write", [files.write_obj, files.write_glb])
def test_sizes_are_read_without_decoding_a_texture(
    tmp_path: Path, write: Callable[[Path, Mesh], None]
) -> None:
    """Decoding a texture with 8192 texels a side takes seconds."""
    texture = np.full((4096, 4096, 3), 90, np.uint8)
    path = tmp_path / f"m.{'obj' if write is files.write_obj else 'glb'}"
    write(path, replace(solids.box((0.2, 0.1, 0.1)), texture=texture))
    tracemalloc.start()
    sizes = look_at(path).sizes
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert sizes["mm" if write is files.write_obj else "m"] == pytest.approx(0.2)
    assert peak < texture.nbytes / 8


@pytest.mark.parametrize("unit", [None, "mm"])
def test_a_mesh_whose_points_coincide_has_no_size(tmp_path: Path, unit: Unit | None) -> None:
    files.write_obj(tmp_path / "m.obj", solids.box((1.0, 0.5, 0.5)), scale=0.0)
    with pytest.raises(InputError, match=r"m\.obj: .*all its points are in one place") as caught:
        read_mesh(tmp_path / "m.obj", unit)
    assert "unit" not in str(caught.value)


def test_a_mesh_whose_triangles_have_no_area_is_refused(tmp_path: Path) -> None:
    corners = np.array(
        [[0.0, 0.0, 0.0], [100.0, 0.0, 0.0], [0.0, 70.0, 0.0], [0.0, 0.0, 50.0], [50.0, 35.0, 0.0]]
    )
    faces = [[0, 1, 1], [2, 2, 2], [0, 3, 0], [1, 4, 2]]
    files.write_colored_ply(tmp_path / "m.ply", corners, np.full((5, 3), 90), faces)
    with pytest.raises(InputError, match=r"m\.ply: found triangles without area"):
        read_mesh(tmp_path / "m.ply")


def test_feet_can_be_given(tmp_path: Path) -> None:
    files.write_obj(tmp_path / "m.obj", solids.box((0.4, 0.3, 0.2)), scale=1.0)
    assert look_at(tmp_path / "m.obj").sizes == pytest.approx({"m": 0.4, "ft": 0.12192, "in": 0.01016})
    assert np.ptp(read_mesh(tmp_path / "m.obj", "ft").vertices[:, 0]) == pytest.approx(0.12192)


def test_gltf_is_in_metres_unless_a_unit_is_given(tmp_path: Path) -> None:
    files.write_glb(tmp_path / "m.glb", solids.box((80.0, 60.0, 40.0)))
    with pytest.raises(
        InputError, match=r"8 cm if it is in millimetres or 80 cm if it is in centi.*--unit mm or --unit cm"
    ):
        read_mesh(tmp_path / "m.glb")
    np.testing.assert_allclose(
        np.ptp(read_mesh(tmp_path / "m.glb", "mm").vertices, axis=0), [0.08, 0.06, 0.04]
    )
