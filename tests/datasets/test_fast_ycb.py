"""Fast-YCB sequences: layout, model frame, timestamps, broken files."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from huepose.datasets.fast_ycb import FastYcbSequence, axis_angle_poses
from huepose.datasets.types import Sample
from huepose.geometry import se3
from huepose.support.errors import InputError

from .conftest import HEIGHT, OFFSET_M, WIDTH, color_of, depth_of, mask_of, pose_of


def test_a_frame_is_read_as_it_was_written(fast_sequence: Path) -> None:
    sequence = FastYcbSequence(fast_sequence, OFFSET_M)
    assert sequence.image_ids == (0, 1, 2)
    frame = sequence.frame(1)
    np.testing.assert_array_equal(frame.color, color_of(1))
    expected = depth_of(1).astype(np.float32) / 10000
    expected[1, 1] = 0  # not a number on disk
    np.testing.assert_array_equal(frame.depth, expected)
    assert (frame.camera.width, frame.camera.height, frame.camera.fy) == (WIDTH, HEIGHT, 21.0)
    np.testing.assert_array_equal(sequence.truths(2)[0].mask(), mask_of(2) > 0)


def test_the_object_has_the_folder_name_without_real_and_poses_are_in_the_reference_frame(
    fast_sequence: Path,
) -> None:
    sequence = FastYcbSequence(fast_sequence, OFFSET_M)
    (truth,) = sequence.truths(1)
    assert truth.object == "006_mustard_bottle"
    # A point of the reference frame, taken back to PoseCNN's frame, is where the file's pose puts it.
    point_posecnn = np.array([0.02, 0.01, -0.05])
    np.testing.assert_allclose(
        se3.apply(truth.T_cam_obj, point_posecnn + OFFSET_M),
        se3.apply(pose_of(1, 1), point_posecnn),
        atol=1e-9,
    )


def test_a_row_of_zeros_is_a_missing_pose(fast_sequence: Path) -> None:
    assert FastYcbSequence(fast_sequence, OFFSET_M).truths(2)[0].T_cam_obj is None


def test_without_an_offset_or_poses_nothing_is_labelled(fast_sequence: Path) -> None:
    assert FastYcbSequence(fast_sequence, None).truths(0)[0].T_cam_obj is None
    (fast_sequence / "gt" / "poses_ycb.txt").unlink()
    assert FastYcbSequence(fast_sequence, OFFSET_M).truths(0)[0].T_cam_obj is None


def test_timestamps_come_from_data_txt(fast_sequence: Path) -> None:
    sequence = FastYcbSequence(fast_sequence, OFFSET_M)
    assert [sequence.stamp_ns(i) for i in sequence.image_ids] == [0, 33_333_000, 81_000_000]


@pytest.mark.parametrize("text", ["0\n1\n2\n", "5.0\n5.0\n5.0\n", "a\nb\nc\n", "0.1\n"])
def test_without_valid_timestamps_30_hz_is_assumed(fast_sequence: Path, text: str) -> None:
    (fast_sequence / "data.txt").write_text(text)
    assert FastYcbSequence(fast_sequence, OFFSET_M).stamp_ns(2) == round(2e9 / 30)


def test_axis_angle_rows_are_converted_to_rotations(tmp_path: Path) -> None:
    path = tmp_path / "poses.txt"
    path.write_text("0.1 0.2 0.3 0 0 2 1.5707963267948966\n0 0 1 0 0 0 0\n")
    poses = axis_angle_poses(path)
    np.testing.assert_allclose(poses[0][:3, :3] @ [1, 0, 0], [0, 1, 0], atol=1e-12)
    np.testing.assert_allclose(poses[1], se3.make(np.eye(3), [0, 0, 1]))


def truncate(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-3])


def packed_depth(sequence: Path) -> None:
    (sequence / "depth/1.float").unlink()
    cv2.imwrite(str(sequence / "depth/1.png"), depth_of(1))


@pytest.mark.parametrize(
    ("breakage", "named"),
    [
        (lambda s: truncate(s / "depth/1.float"), "depth/1.float"),
        (lambda s: (s / "depth/1.float").write_bytes(b"abc"), "depth/1.float"),
        (packed_depth, "unpacked first"),
        (lambda s: (s / "cam_K.json").unlink(), "cam_K.json"),
        (lambda s: (s / "cam_K.json").write_text('{"fx": 1}'), "fy"),
        (lambda s: (s / "gt/poses_ycb.txt").write_text("1 2 3\n"), "poses_ycb.txt, line 1"),
        (lambda s: (s / "gt/poses_ycb.txt").write_text("1 2 3 0 0 0 1\n"), "poses_ycb.txt, line 1"),
        (lambda s: (s / "gt/poses_ycb.txt").write_text("1 2 3 0 0 1 1\n"), "1 poses"),
        (lambda s: (s / "data.txt").unlink(), "data.txt"),
    ],
)
def test_the_error_names_what_is_broken(fast_sequence: Path, breakage, named: str) -> None:
    breakage(fast_sequence)
    with pytest.raises(InputError, match=named):
        Sample.of(FastYcbSequence(fast_sequence, OFFSET_M), 1)


def test_the_error_names_a_camera_file_with_another_image_size(fast_sequence: Path) -> None:
    path = fast_sequence / "cam_K.json"
    path.write_text(path.read_text().replace('"width": 16', '"width": 32'))
    with pytest.raises(InputError, match=r"cam_K\.json"):
        FastYcbSequence(fast_sequence, OFFSET_M).frame(0)


def test_images_of_a_distorted_lens_are_refused(fast_sequence: Path) -> None:
    path = fast_sequence / "cam_K.json"
    lens = {"distortion_model": "plumb_bob", "distortion": [-0.2, 0.05, 0.0, 0.0, 0.0]}
    path.write_text(json.dumps(json.loads(path.read_text()) | lens))
    with pytest.raises(InputError, match=r"cam_K\.json: found a distorted lens; expected rectified images"):
        FastYcbSequence(fast_sequence, OFFSET_M)


def test_gaps_name_the_first_image_that_is_incomplete(fast_sequence: Path) -> None:
    assert FastYcbSequence(fast_sequence, None).gaps() == []
    packed_depth(fast_sequence)
    assert FastYcbSequence(fast_sequence, None).with_depth == (0, 2)
    assert FastYcbSequence(fast_sequence, None).gaps() == [
        f"{fast_sequence}: depth/ lacks 1 of 3 images, the first is number 1; they are left out when "
        "it is played"
    ]
