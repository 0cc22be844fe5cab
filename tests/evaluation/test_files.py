"""Reading and writing files: JSON, BOP's CSV, poses of other programs, equivalent poses."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from huepose.datasets.ycb_objects import T_posecnn_obj
from huepose.evaluation.pose_files import (
    BopResult,
    read_bop_csv,
    read_dope_poses,
    read_pose_csv,
    read_pose_rows,
    write_bop_csv,
)
from huepose.evaluation.result_files import plain, write_json
from huepose.evaluation.targets import read_equivalents
from huepose.geometry import se3
from huepose.support.errors import InputError

T = se3.make(se3.rotation_exp([0.3, -1.2, 2.0]), [0.12, -0.034, 0.987])


def test_json_has_no_nan_and_is_read_back(tmp_path: Path) -> None:
    value = {
        "summary": {5: np.float32(1.5), "x": np.nan},
        "rows": [{"T": T, "e": np.inf}, {"n": np.int64(3)}],
        "f": [],
    }
    path = tmp_path / "new" / "result.json"
    write_json(path, value)
    read = json.loads(path.read_text())
    assert read["summary"] == {"5": 1.5, "x": None}
    np.testing.assert_array_equal(read["rows"][0]["T"], T)
    assert read["rows"][0]["e"] is None
    assert read["rows"][1] == {"n": 3}
    assert "NaN" not in path.read_text()
    assert [p.name for p in path.parent.iterdir()] == ["result.json"]


def test_plain_keeps_booleans_and_text() -> None:
    assert plain((np.bool_(True), "a", None, 2, {"k": float("-inf")})) == [True, "a", None, 2, {"k": None}]


def test_the_error_names_a_file_that_cannot_be_written(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="file/result"):
        write_json(tmp_path / "file" / "result.json", {})


def test_bop_csv_is_in_millimetres_row_by_row_and_is_read_back(tmp_path: Path) -> None:
    path = tmp_path / "huepose_ycbv-test.csv"
    write_bop_csv(path, [BopResult("000048", 36, 5, 0.75, T, 0.25), BopResult("box", 1, 2, 1.0, np.eye(4))])
    header, line, named = path.read_text().splitlines()
    assert header == "scene_id,im_id,obj_id,score,R,t,time"
    cells = line.split(",")
    assert cells[:4] == ["48", "36", "5", "0.75"]
    assert [float(v) for v in cells[4].split()] == T[:3, :3].ravel().tolist()
    assert [float(v) for v in cells[5].split()] == pytest.approx([120.0, -34.0, 987.0])
    assert named.startswith("box,1,2")
    first, second = read_bop_csv(path)
    np.testing.assert_allclose(first.T_cam_obj, T, atol=1e-12)
    assert (first.scene, first.image, first.object_id, first.score, first.seconds) == (
        "48",
        36,
        5,
        0.75,
        0.25,
    )
    assert second.seconds == -1.0


@pytest.mark.parametrize("header", ["scene_id,im_id,obj_id,score,R,t,time\n", ""])
def test_bop_csv_that_a_spreadsheet_saved_is_read(tmp_path: Path, header: str) -> None:
    path = tmp_path / "x.csv"
    path.write_text(f"{header}48,36,5,0.75,1 0 0 0 1 0 0 0 1,1 2 3,0.1\n", "utf-8-sig")
    (row,) = read_bop_csv(path)
    assert (row.scene, row.image) == ("48", 36)


@pytest.mark.parametrize(
    "line",
    [
        "48,36,5,0.75,1 0 0,1 2 3,0.1",
        "48,x,5,1,1 0 0 0 1 0 0 0 1,1 2 3,0.1",
        "48,36",
        "48,36,5,0.75,1 1 1 1 1 1 1 1 1,1 2 3,0.1",
    ],
)
def test_the_error_names_a_broken_line_of_bop_csv(tmp_path: Path, line: str) -> None:
    path = tmp_path / "x.csv"
    path.write_text(f"scene_id,im_id,obj_id,score,R,t,time\n{line}\n")
    with pytest.raises(InputError, match=r"x\.csv, line 2"):
        read_bop_csv(path)


@pytest.mark.parametrize("header", ["frame,object,x,y,z,qx,qy,qz,qw\n", ""])
def test_a_pose_csv_is_read(tmp_path: Path, header: str) -> None:
    q = se3.quaternion_from_rotation(T[:3, :3])
    row = ",".join(str(v) for v in (*T[:3, 3], *q))
    path = tmp_path / "poses.csv"
    path.write_text(f"{header}4,box,{row}\n6,7,{row}\n8,box,nan,nan,nan,nan,nan,nan,nan\n")
    table = read_pose_csv(path)
    np.testing.assert_allclose(table.pose(4, "box", 5), T, atol=1e-12)
    np.testing.assert_allclose(table.pose(6, "brick", 7), T, atol=1e-12)
    assert table.pose(8, "box", 5) is None
    assert table.pose(5, "box", 5) is None


@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
def test_a_pose_csv_of_a_spreadsheet_is_read(tmp_path: Path, end: str) -> None:
    path, row = tmp_path / "poses.csv", ",0,0,1,0,0,0,1,3,1700000000.5,0.9"
    lines = ["frame,object,x,y,z,qx,qy,qz,qw,instance,stamp,quality", f"4,box{row}", f"5,box{row}"]
    path.write_bytes(b"\xef\xbb\xbf" + (end.join(lines) + end).encode())
    assert [(row.frame, row.name) for row in read_pose_rows(path)] == [(4, "box/3"), (5, "box/3")]


@pytest.mark.parametrize(
    "text",
    [
        "",
        "1,box,0,0,1\n",
        "1;box;0;0;1;0;0;0;1\n",
        "\0\1\2",
        '"1,box\n',
        '1,"box' + "x" * 200_000,
        "1,box,0,0,1,2,0,0,0,0,0,1,0\n",
        "1,box,0,0,1,0,0,0,3\n",
        "a,box,0,0,1,0,0,0,1\n",
    ],
)
def test_the_error_names_a_broken_pose_csv(tmp_path: Path, text: str) -> None:
    path = tmp_path / "p.csv"
    path.write_text("frame,object,x,y,z,qx,qy,qz,qw\n" + text)
    with pytest.raises(InputError, match=r"p\.csv"):
        read_pose_csv(path)


def test_frame_numbers_may_be_floats_as_pandas_writes_them(tmp_path: Path) -> None:
    path = tmp_path / "poses.csv"
    path.write_text("100.0,box,0,0,1,0,0,0,1,2.0\n101.0,box,0,0,1,0,0,0,1,2.0\n")
    assert [(row.frame, row.instance) for row in read_pose_rows(path)] == [(100, 2), (101, 2)]
    for number in ("100.5", "nan", "inf"):
        path.write_text(f"{number},box,0,0,1,0,0,0,1\n")
        with pytest.raises(InputError, match="line 1"):
            read_pose_rows(path)


def test_dope_poses_are_converted_to_the_reference_frame(tmp_path: Path) -> None:
    """A point in the reference model's frame lands where DOPE's pose puts it in DOPE's model frame."""
    R, t, offset = (
        se3.rotation_exp([1.2, 0.4, -0.9]),
        np.array([0.01, -0.02, 0.003]),
        np.array([0.002, 0.001, 0.004]),
    )
    w = se3.rotation_log(T[:3, :3])
    angle = np.linalg.norm(w)
    path = tmp_path / "poses.txt"
    row = " ".join(f"{v:.12f}" for v in (*T[:3, 3], *(w / angle), angle))
    path.write_text(f"0 0 0 0 0 0 0\n{row}\n")
    table = read_dope_poses(path, "box").moved({"box": se3.compose(se3.make(R, t), T_posecnn_obj(offset))})
    assert table.pose(0, "box", None) is None
    point_posecnn = np.array([0.03, -0.01, 0.05])
    expected = se3.apply(T, R @ point_posecnn + t)
    np.testing.assert_allclose(
        se3.apply(table.pose(1, "box", None), point_posecnn + offset), expected, atol=1e-9
    )


def test_a_file_of_equivalent_poses_is_read(tmp_path: Path) -> None:
    path = tmp_path / "alternatives.json"
    path.write_text(json.dumps({"000001/0/3": {"object": 19, "T_obj_obj": [np.eye(4).tolist(), T.tolist()]}}))
    (key,) = read_equivalents(path)
    assert key == ("000001", 0, 3)
    np.testing.assert_allclose(read_equivalents(path)[key][1], T, atol=1e-12)


@pytest.mark.parametrize(
    "record",
    [
        {"000001/3": {"T_obj_obj": []}},
        {"a/b/c": {"T_obj_obj": []}},
        {"s/0/1": {}},
        {"s/0/1": {"T_obj_obj": [[1, 2], [3, 4]]}},
        {"s/0/1": {"T_obj_obj": [(np.eye(4) * 2).tolist()]}},
    ],
)
def test_the_error_names_a_broken_entry_of_equivalent_poses(tmp_path: Path, record: dict) -> None:
    path = tmp_path / "alternatives.json"
    path.write_text(json.dumps(record))
    with pytest.raises(InputError, match=r"alternatives\.json, '"):
        read_equivalents(path)
