"""YCB-Video as published: the MATLAB files are written here as the data set's are."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.io import savemat

from huepose.datasets.types import Sample
from huepose.datasets.ycb_video import YcbVideoSequence
from huepose.geometry import se3
from huepose.support.errors import InputError

from .conftest import HEIGHT, OFFSET_M, WIDTH, color_of, depth_of, pose_of, write


@pytest.fixture
def sequence(tmp_path: Path) -> Path:
    folder = tmp_path / "0048"
    labels = np.zeros((HEIGHT, WIDTH), np.uint8)
    labels[1:4, 2:9], labels[6:9, 5:] = 5, 16
    for n, ids in ((1, [5, 16]), (12, [5])):
        write(folder / f"{n:06d}-color.png", color_of(n))
        write(folder / f"{n:06d}-depth.png", depth_of(n))
        write(folder / f"{n:06d}-label.png", labels)
        poses = np.stack([pose_of(n, i)[:3] for i in range(len(ids))], axis=2)
        meta = {
            "cls_indexes": np.array(ids, np.uint8)[:, None],
            "factor_depth": np.array([[10000]], np.uint16),
            "intrinsic_matrix": np.array([[1066.778, 0, 312.9869], [0, 1067.487, 241.3109], [0, 0, 1]]),
            "poses": poses if len(ids) > 1 else poses[:, :, 0],
        }
        savemat(folder / f"{n:06d}-meta.mat", meta)
    return folder


def test_frames_are_what_was_written(sequence: Path) -> None:
    reader = YcbVideoSequence(sequence, {5: OFFSET_M})
    assert reader.image_ids == (1, 12)
    frame = reader.frame(12)
    np.testing.assert_array_equal(frame.color, color_of(12))
    np.testing.assert_allclose(frame.depth, depth_of(12) / 10000, atol=1e-7)
    assert frame.camera.fx == pytest.approx(1066.778)
    assert frame.stamp_ns == round(12e9 / 30)


@pytest.mark.parametrize("image", [1, 12])
def test_labels_are_moved_to_the_reference_frame(sequence: Path, image: int) -> None:
    truth = YcbVideoSequence(sequence, {5: OFFSET_M}).truths(image)[0]
    expected = pose_of(image, 0) @ se3.make(np.eye(3), -OFFSET_M)
    assert truth.object_id == 5
    np.testing.assert_allclose(truth.T_cam_obj, expected, atol=1e-9)
    assert truth.mask().sum() == 3 * 7


def test_an_object_without_offset_has_a_mask_but_no_pose(sequence: Path) -> None:
    truth = YcbVideoSequence(sequence, {5: OFFSET_M}).truths(1)[1]
    assert (truth.object_id, truth.T_cam_obj) == (16, None)
    assert truth.mask()[6, 5]


@pytest.mark.parametrize(
    ("name", "data"),
    [("000001-meta.mat", b"nothing"), ("000001-depth.png", b"nothing"), ("000001-meta.mat", None)],
)
def test_what_is_broken_is_named(sequence: Path, name: str, data: bytes | None) -> None:
    (sequence / name).unlink()
    if data is not None:
        (sequence / name).write_bytes(data)
    with pytest.raises(InputError, match=name):
        Sample.of(YcbVideoSequence(sequence, {5: OFFSET_M}), 1)


def test_a_folder_without_images_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="color"):
        YcbVideoSequence(tmp_path, {})
