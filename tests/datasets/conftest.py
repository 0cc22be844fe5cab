"""Small complete scenes on disk in the layouts that the readers support."""

from __future__ import annotations

import json
import struct
from pathlib import Path

import cv2
import numpy as np
import pytest

from huepose.geometry import se3

HEIGHT, WIDTH = 12, 16
OFFSET_M = np.array([0.01, -0.02, 0.03])


def color_of(number: int) -> np.ndarray:
    """An image with different channels: red counts columns, green rows, blue is the number."""
    image = np.zeros((HEIGHT, WIDTH, 3), np.uint8)
    image[..., 0], image[..., 1], image[..., 2] = (
        np.arange(WIDTH) * 10,
        np.arange(HEIGHT)[:, None] * 10,
        number,
    )
    return image


def depth_of(number: int) -> np.ndarray:
    """16 bit depth values; the first pixel has no reading."""
    depth = (5000 + 10 * np.arange(HEIGHT * WIDTH).reshape(HEIGHT, WIDTH) + number).astype(np.uint16)
    depth[0, 0] = 0
    return depth


def mask_of(instance: int) -> np.ndarray:
    """A block of the image for each instance."""
    mask = np.zeros((HEIGHT, WIDTH), np.uint8)
    mask[2:6, 3 + instance : 8 + instance] = 255
    return mask


def pose_of(number: int, instance: int) -> np.ndarray:
    """T_cam_obj in metres."""
    return se3.make(
        se3.rotation_exp([0.1 * number, 0.5 * instance, 0.3]), [0.01 * number, 0.1 * instance, 0.7]
    )


def write(path: Path, image: np.ndarray) -> None:
    """Write an RGB or one-channel image."""
    path.parent.mkdir(parents=True, exist_ok=True)
    assert cv2.imwrite(str(path), image[..., ::-1] if image.ndim == 3 else image)


@pytest.fixture
def bop_scene(tmp_path: Path) -> Path:
    """Images 2, 10 and 100; labels of ids 5 and 7; image 50 is labelled but not on disk."""
    scene = tmp_path / "000003"
    cameras, labels, details = {}, {}, {}
    for n in (100, 10, 2, 50):
        if n != 50:
            write(scene / "rgb" / f"{n:06d}.png", color_of(n))
            write(scene / "depth" / f"{n:06d}.png", depth_of(n))
            for i in range(2):
                write(scene / "mask_visib" / f"{n:06d}_{i:06d}.png", mask_of(i))
        cameras[n] = {"cam_K": [20 + n, 0, 7, 0, 21, 5, 0, 0, 1], "depth_scale": 0.1}
        labels[n] = [
            {
                "cam_R_m2c": pose_of(n, i)[:3, :3].ravel().tolist(),
                "cam_t_m2c": (pose_of(n, i)[:3, 3] * 1000).tolist(),
                "obj_id": object_id,
            }
            for i, object_id in enumerate((5, 7))
        ]
        details[n] = [{"bbox_visib": [3 + i, 2, 5, 4], "visib_fract": 0.5 + 0.1 * i} for i in range(2)]
    for name, value in (("camera", cameras), ("gt", labels), ("gt_info", details)):
        (scene / f"scene_{name}.json").write_text(json.dumps(value))
    return scene


@pytest.fixture
def fast_sequence(tmp_path: Path) -> Path:
    """Three frames of a mustard bottle; frame 1 has a depth of nan; frame 2 has no pose."""
    folder = tmp_path / "006_mustard_bottle_real"
    rows = []
    for n in range(3):
        write(folder / "rgb" / f"{n}.png", color_of(n))
        depth = depth_of(n).astype(np.float32) / 10000
        if n == 1:
            depth[1, 1] = np.nan
        (folder / "depth").mkdir(exist_ok=True)
        (folder / "depth" / f"{n}.float").write_bytes(struct.pack("<QQ", WIDTH, HEIGHT) + depth.tobytes())
        write(folder / "masks" / "gt" / f"006_mustard_bottle_{n}.png", mask_of(n))
        w = se3.rotation_log(pose_of(n, 1)[:3, :3])
        rows.append([*pose_of(n, 1)[:3, 3], *(w / np.linalg.norm(w)), np.linalg.norm(w)])
    rows[2] = [0.0] * 7
    (folder / "gt").mkdir()
    (folder / "gt" / "poses_ycb.txt").write_text(
        "\n".join(" ".join(f"{v:.12f}" for v in r) for r in rows) + "\n"
    )
    (folder / "data.txt").write_text("0.000000\n0.033333\n0.081000\n")
    camera = {"width": WIDTH, "height": HEIGHT, "fx": 20.0, "fy": 21.0, "cx": 7.5, "cy": 5.5}
    (folder / "cam_K.json").write_text(json.dumps(camera))
    return folder
