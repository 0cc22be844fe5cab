from __future__ import annotations

import json
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest

from huepose.geometry import se3
from huepose.model import load_model
from huepose.model.types import ReferenceModel
from huepose.onboarding.batch import Failed, Job, Onboarded, StageBegun, onboard_many
from huepose.onboarding.bop_folder import bop_models, safe_name
from huepose.onboarding.declared import read_symmetries
from huepose.onboarding.onboard import onboard_mesh
from huepose.onboarding.reference import STAGES, diameter_of
from huepose.support.errors import InputError
from tests.onboarded import few_views
from tests.onboarding import mesh_files as files
from tests.onboarding import solids


def arrays_of(part: object, prefix: str = "") -> dict[str, np.ndarray]:
    """All arrays of nested dataclasses by name."""
    out = {}
    for f in fields(part):
        value = getattr(part, f.name)
        if isinstance(value, np.ndarray):
            out[prefix + f.name] = value
        elif hasattr(value, "__dataclass_fields__"):
            out |= arrays_of(value, f"{prefix}{f.name}.")
    return out


def test_onboarding_is_deterministic_reports_its_stages_and_makes_tables_on_request_only(
    tea_box: ReferenceModel,
) -> None:
    stages: list[str] = []
    bare = onboard_mesh(tea_box.mesh, "tea_box", report=stages.append)
    assert stages == list(STAGES[1:])  # the first stage is to read the mesh
    assert bare.tables is None
    with_tables, without = arrays_of(tea_box), arrays_of(bare)
    assert without.keys() == {name for name in with_tables if not name.startswith("tables.")}
    for name, array in without.items():
        assert array.dtype == with_tables[name].dtype, name
        np.testing.assert_array_equal(array, with_tables[name], err_msg=name)


def test_a_model_has_all_parts(tea_box: ReferenceModel) -> None:
    assert tea_box.diameter_m == pytest.approx(np.linalg.norm([0.09, 0.06, 0.15]), rel=1e-3)
    assert len(tea_box.surface.points) == 2000
    assert tea_box.surface.directions.shape == (642, 3)
    assert tea_box.templates.planes.shape == (162, 24, 5, 16, 16)
    assert len(tea_box.near_symmetries) == 4
    assert len(tea_box.equivalents) == 1
    assert len(tea_box.pairs.points) > 300
    assert tea_box.eval_points.dtype == np.float32
    np.testing.assert_array_equal(tea_box.symmetries, np.eye(4)[None])


def test_given_symmetries_diameter_and_offset_are_kept() -> None:
    half_turn = np.diag([1.0, -1.0, -1.0, 1.0])
    half_turn[1, 3] = 8.0
    info = {"diameter": 72.0, "symmetries_discrete": [half_turn.reshape(-1).tolist()]}
    about_z = {"symmetries_continuous": [{"axis": [0, 0, 1], "offset": [0, 0, 0]}]}
    with few_views():
        model = onboard_mesh(
            solids.box((0.05, 0.04, 0.03)),
            "brick",
            object_id=7,
            info=info,
            symmetric=about_z,
            frame_offset_m=np.array([0.001, 0.0, -0.002]),
        )
    assert (model.object_id, model.diameter_m) == (7, pytest.approx(0.072))
    with pytest.raises(InputError, match=r"7200 cm \(models_info.json\) and 7.071 cm \(mesh\)"):
        onboard_mesh(solids.box((0.05, 0.04, 0.03)), "brick", info={"diameter": 72_000.0})
    assert len(model.symmetries) == 2
    np.testing.assert_allclose(model.symmetries[1, :3, 3], [0, 0.008, 0])
    assert len(model.equivalents) == 72
    np.testing.assert_allclose(model.equivalents[:, 2], np.tile([0, 0, 1, 0], (72, 1)), atol=1e-12)
    np.testing.assert_array_equal(model.frame_offset_m, [0.001, 0, -0.002])


def test_the_diameter_is_measured_and_flat_meshes_are_refused() -> None:
    rng = np.random.default_rng(0)
    ball = solids.sphere(0.05)
    assert diameter_of(ball) == pytest.approx(0.1, rel=1e-5)
    many = solids.joined(*[ball] * 21)
    assert len(many.vertices) > 40_000
    assert diameter_of(many) == pytest.approx(0.1, rel=1e-4)
    flat = solids.box((0.1, 0.1, 0.0))
    with pytest.raises(InputError, match="in one plane"):
        diameter_of(flat)
    assert diameter_of(solids.moved(ball, tuple(rng.normal(size=3)))) == pytest.approx(0.1, rel=1e-4)


def bop_folder(folder: Path) -> Path:
    """Two boxes, one as PLY and one as OBJ, with BOP's and our metadata."""
    folder.mkdir()
    small, tall = solids.printed_box((0.08, 0.06, 0.04)), solids.printed_box((0.05, 0.05, 0.09))
    files.write_ply(folder / "obj_000003.ply", small, binary=True, lists=False)
    files.write_obj(folder / "obj_000012.obj", tall)
    infos = {"3": {"diameter": 107.7, "name": "Sugar Box (small)"}, "12": {"diameter": 114.5}}
    (folder / "models_info.json").write_text(json.dumps(infos))
    offsets = {"021_tall": {"bop_obj_id": 12, "posecnn_to_bop_t_mm": [1.5, -2.0, 3.0]}}
    (folder / "frame_offsets.json").write_text(json.dumps(offsets))
    return folder


def test_a_bop_folder_is_read(tmp_path: Path) -> None:
    small, tall = bop_models(bop_folder(tmp_path / "models"))
    assert (small.object_id, small.name, small.mesh_path.name) == (3, "sugar_box_small", "obj_000003.ply")
    assert small.frame_offset_m is None
    assert small.info["diameter"] == 107.7
    assert (tall.object_id, tall.name, tall.mesh_path.name) == (12, "021_tall", "obj_000012.obj")
    np.testing.assert_allclose(tall.frame_offset_m, [0.0015, -0.002, 0.003])
    assert [m.object_id for m in bop_models(tmp_path / "models", [12])] == [12]
    (tmp_path / "models" / "frame_offsets.json").unlink()
    assert bop_models(tmp_path / "models", [12])[0].name == "obj_000012"
    ycbv = {"3": {"diameter": 198.38}, "12": {"diameter": 259.57}}
    (tmp_path / "models" / "models_info.json").write_text(json.dumps(ycbv))
    sugar, bleach = bop_models(tmp_path / "models")
    assert (sugar.name, bleach.name) == ("004_sugar_box", "021_bleach_cleanser")
    np.testing.assert_allclose(bleach.frame_offset_m, [0.004979, -0.002456, -0.013279])


def test_wrong_bop_folders_are_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such folder"):
        bop_models(tmp_path / "nothing")
    with pytest.raises(InputError, match=r"no obj_NNNNNN.*huepose onboard MESH"):
        bop_models(tmp_path)
    folder = bop_folder(tmp_path / "models")
    with pytest.raises(InputError, match=r"no mesh of object 5; expected one of 3, 12\. Choose one"):
        bop_models(folder, [3, 5])
    (folder / "models_info.json").write_text("{")
    with pytest.raises(InputError, match=r"models_info.json: found no valid JSON"):
        bop_models(folder)
    for info, message in (
        ("[" * 100_000, "models_info.json: found no valid JSON"),
        ('{"3": 5}', "models_info.json object 3: found 5"),
        ('{"3": {"diameter": "large"}}', "models_info.json object 3: found 'diameter': 'large'"),
        ('{"3": {"symmetries_discrete": [[1, 2]]}}', r"object 3 symmetries_discrete\[0\]: found \[1, 2\]"),
    ):
        (folder / "models_info.json").write_text(info)
        with pytest.raises(InputError, match=message):
            bop_models(folder)
    (folder / "models_info.json").unlink()
    offsets = {"021_tall": {"bop_obj_id": 12, "posecnn_to_bop_t_mm": [1, 2]}}
    (folder / "frame_offsets.json").write_text(json.dumps(offsets))
    with pytest.raises(
        InputError, match=r"frame_offsets.json 021_tall: found 'posecnn_to_bop_t_mm': \[1, 2\]"
    ):
        bop_models(folder)


def test_names_are_made_safe() -> None:
    assert safe_name("Mustard Bottle (006)") == "mustard_bottle_006"
    assert safe_name("./\u00e4") == ""
    assert len(safe_name("x" * 200)) == 64


def test_declared_symmetries_are_checked(tmp_path: Path) -> None:
    path = tmp_path / "s.json"
    turn = np.diag([-1.0, -1.0, 1.0, 1.0]).reshape(-1).tolist()
    path.write_text(json.dumps({"symmetries_discrete": [turn]}))
    assert read_symmetries(path) == {"symmetries_discrete": [turn], "symmetries_continuous": []}
    wrong = [
        ("[1]", "a JSON list"),
        ("{}", "neither of the two lists"),
        ("{", "no valid JSON"),
        ("[" * 100_000, "no valid JSON"),
        (json.dumps({"symmetries_discrete": 5}), "symmetries_discrete: found 5; expected a list"),
        (json.dumps({"symmetries_discrete": [turn[:12]]}), r"symmetries_discrete\[0\]"),
        (json.dumps({"symmetries_discrete": [[2 * x for x in turn]]}), r"symmetries_discrete\[0\]"),
        (json.dumps({"symmetries_continuous": [{"axis": [0, 0, 0]}]}), r"symmetries_continuous\[0\]"),
        (json.dumps({"symmetries_continuous": [[0, 0, 1]]}), r"symmetries_continuous\[0\]"),
    ]
    for text, message in wrong:
        path.write_text(text)
        with pytest.raises(InputError, match=message):
            read_symmetries(path)
    with pytest.raises(InputError, match="no such file"):
        read_symmetries(tmp_path / "none.json")


def test_workers_onboard_what_they_can_and_name_what_they_cannot(tmp_path: Path) -> None:
    folder = bop_folder(tmp_path / "models")
    (folder / "obj_000012.png").unlink()
    jobs = [Job(m.mesh_path, m.name, m.object_id, "mm", info=m.info) for m in bop_models(folder)]
    events = list(onboard_many(jobs, tmp_path / "out", processes=2))
    done = [e for e in events if isinstance(e, Onboarded)]
    failed = [e for e in events if isinstance(e, Failed)]
    assert [e.stage for e in events if isinstance(e, StageBegun) and e.name == "sugar_box_small"] == list(
        STAGES
    )
    assert [f.name for f in failed] == ["021_tall"]
    assert "obj_000012.png: found no such file" in failed[0].reason
    assert [d.name for d in done] == ["sugar_box_small"]
    assert done[0].size_m == pytest.approx((0.08, 0.06, 0.04), rel=1e-5)
    assert [p.name for p in (tmp_path / "out").iterdir()] == ["sugar_box_small.huepose"]
    model = load_model(done[0].path)
    assert (model.object_id, model.diameter_m) == (3, 0.1077)
    assert se3.is_rigid(model.near_symmetries[-1])


def test_stopping_early_leaves_no_file(tmp_path: Path) -> None:
    folder = bop_folder(tmp_path / "models")
    jobs = [Job(m.mesh_path, m.name, m.object_id, "mm") for m in bop_models(folder)]
    events = onboard_many(jobs, tmp_path / "out", processes=1)
    for event in events:
        if isinstance(event, StageBegun) and event.stage == "surface":
            break
    events.close()
    assert not (tmp_path / "out").exists()
