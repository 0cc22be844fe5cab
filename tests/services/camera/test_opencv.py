"""A depth camera through OpenCV: what is done with what it grabs, and what is said without one."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from huepose.geometry import Camera
from huepose.support.errors import InputError
from huepose_services.camera.live import CameraError
from huepose_services.camera.opencv import open_source, source_of
from huepose_services.runtime.config import load
from huepose_services.runtime.config_perception import CameraConfig, DeviceConfig

BGR = np.arange(4 * 6 * 3, dtype=np.uint8).reshape(4, 6, 3)
MM = np.arange(24, dtype=np.uint16).reshape(4, 6) * 50
INTRINSICS = {
    **{cv2.CAP_PROP_OBSENSOR_INTRINSIC_FX: 500.0, cv2.CAP_PROP_OBSENSOR_INTRINSIC_FY: 501.0},
    **{cv2.CAP_PROP_OBSENSOR_INTRINSIC_CX: 3.0, cv2.CAP_PROP_OBSENSOR_INTRINSIC_CY: 2.0},
}
COLOR, DEPTH = cv2.CAP_OBSENSOR_BGR_IMAGE, cv2.CAP_OBSENSOR_DEPTH_MAP


class Capture:
    """In the place of cv2.VideoCapture: each grab has what the list says next, and the last again and again
    with the stamp that it has. This is no device."""

    def __init__(self, grabs: list[tuple[float, dict[int, Any]]], told: dict[int, float]) -> None:
        self._grabs, self._told, self._now = [(0.0, {}), *grabs], told, (0.0, {})
        self.released = False

    def __call__(self, index: int, backend: int) -> Capture:
        assert (index, backend) == (0, cv2.CAP_OBSENSOR)
        return self

    def isOpened(self) -> bool:
        return True

    def grab(self) -> bool:
        self._now = self._grabs.pop(0) if len(self._grabs) > 1 else self._grabs[0]
        return bool(self._now[1])

    def retrieve(self, flag: int) -> tuple[bool, Any]:
        return flag in self._now[1], self._now[1].get(flag)

    def get(self, key: int) -> float:
        return self._now[0] if key == cv2.CAP_PROP_POS_MSEC else self._told.get(key, 0.0)

    def release(self) -> None:
        self.released = True


def test_colour_and_depth_that_come_one_by_one_are_one_picture() -> None:
    capture = Capture([(0.0, {COLOR: BGR}), (0.0, {DEPTH: MM}), (0.0, {})], INTRINSICS)
    camera = source_of(CameraConfig(source="opencv"), capture).open()
    shot = camera.read(1.0)
    assert shot is not None
    np.testing.assert_array_equal(shot.color, BGR[..., ::-1])
    np.testing.assert_array_equal(shot.depth, MM.astype(np.float32) * np.float32(0.001))
    assert shot.camera == Camera(500.0, 501.0, 3.0, 2.0, 6, 4)
    assert shot.depth_ns is not None
    assert shot.device_ns < shot.depth_ns == shot.arrived_ns
    assert camera.read(0.05) is None
    camera.close()
    assert capture.released


def test_a_picture_is_not_given_twice_nor_with_old_depth() -> None:
    camera = source_of(
        CameraConfig(source="opencv"), Capture([(5.0, {COLOR: BGR, DEPTH: MM})], INTRINSICS)
    ).open()
    assert camera.read(1.0) is not None
    assert camera.read(0.05) is None  # the same stamp
    far_apart = Capture([(0.0, {COLOR: BGR}), *[(0.0, {})] * 40, (0.0, {DEPTH: MM}), (0.0, {})], INTRINSICS)
    assert source_of(CameraConfig(source="opencv"), far_apart).open().read(0.5) is None


def test_intrinsics_that_it_does_not_tell_are_given() -> None:
    grabs = [(0.0, {COLOR: BGR, DEPTH: MM})]
    silent = Capture(grabs, {})
    with pytest.raises(CameraError, match=r"set camera.device.intrinsics"):
        source_of(CameraConfig(source="opencv"), silent).open()
    assert silent.released
    device = DeviceConfig(intrinsics=(400.0, 400.0, 2.5, 1.5))
    shot = source_of(CameraConfig(source="opencv", device=device), Capture(grabs, {})).open().read(1.0)
    assert shot is not None
    assert shot.camera == Camera(400.0, 400.0, 2.5, 1.5, 6, 4)


def test_depth_of_another_size_is_refused() -> None:
    capture = Capture([(0.0, {COLOR: BGR, DEPTH: MM[:2]})], INTRINSICS)
    with pytest.raises(CameraError, match="6 x 2 uint16, colour 6 x 4"):
        source_of(CameraConfig(source="opencv"), capture).open().read(1.0)


def test_without_a_camera_the_real_call_says_so() -> None:
    with pytest.raises(CameraError, match="no depth camera of Orbbec"):
        source_of(CameraConfig(source="opencv", device=DeviceConfig(index=200))).open()


def test_a_webcam_is_refused_with_the_reason(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Path, "exists", lambda path: str(path) == "/dev/video200")
    with pytest.raises(CameraError, match=r"/dev/video200 is another camera. A webcam has no depth"):
        source_of(CameraConfig(source="opencv", device=DeviceConfig(index=200))).open()


@pytest.mark.skipif(cv2.videoio_registry.hasBackend(cv2.CAP_OBSENSOR), reason="this OpenCV has the backend")
def test_an_opencv_for_webcams_only_is_refused_before_anything_starts(tmp_path: Path) -> None:
    (tmp_path / "p.yaml").write_text("camera: {source: opencv}\nworkers: [camera]\nbundles: b\n")
    with pytest.raises(InputError, match=r"without its backend OBSENSOR.*A webcam has no depth"):
        open_source(load(tmp_path / "p.yaml"))
