"""The RealSense source on the SDK's software device, and on a recording made of it."""

import gc
import socket
import time
from contextlib import suppress

import numpy as np
import pytest

from huepose.support.errors import InputError
from huepose_protos.client import Reader
from huepose_protos.local import endpoint
from huepose_protos.messages import CameraMessage, HealthMessage
from huepose_services.camera import realsense
from huepose_services.camera.live import CameraError
from huepose_services.camera.realsense import (
    RealSenseCamera,
    Rectification,
    apply_options,
    made_filters,
    source_of,
)
from huepose_services.runtime.config import Config
from huepose_services.runtime.config_perception import CameraConfig, DeviceConfig
from tests.services.camera.realsense_device import FOCAL, HEIGHT, WIDTH, SoftwareCamera, depth_of, intrinsics

rs = pytest.importorskip("pyrealsense2", reason="pyrealsense2, the RealSense SDK, is not installed")


def _settings(path=None, **device):
    device = {"width": WIDTH, "height": HEIGHT, **device}
    return CameraConfig(source="realsense", path=path, device=DeviceConfig(**device))


def _first_shot(software, camera, numbers):
    """The first complete pair; the syncer gives single images until it knows both streams."""
    for number in numbers:
        software.push(number)
        if (shot := camera.read(0.5)) is not None:
            return shot
    raise AssertionError("no image came")


@pytest.fixture
def software():
    return SoftwareCamera(rs)


def test_depth_is_aligned_to_the_pixels_of_colour(software):
    camera = RealSenseCamera(rs, software.device, _settings())
    shot = _first_shot(software, camera, range(1, 6))
    camera.close()
    assert shot.color[0, 0].tolist() == [shot.number, 2 * shot.number, 3 * shot.number]
    assert shot.device_ns == round((1000.0 + shot.number * 1000 / 30) * 1e6)
    assert (shot.camera.fx, shot.camera.cx, shot.camera.width) == (FOCAL, 31.5, WIDTH)
    # The colour lens is 30 mm to the right: a surface 0.3 m away moves 6 pixels to the left.
    near = np.argwhere(np.isclose(shot.depth, 0.3))
    assert near.min(0).tolist() == [10, 14]
    assert near.max(0).tolist() == [19, 23]
    assert set(np.unique(shot.depth).round(3)) == {0.0, np.float32(0.3).round(3), np.float32(0.6).round(3)}


def test_without_align_depth_is_unchanged(software):
    camera = RealSenseCamera(rs, software.device, _settings(align=False))
    shot = _first_shot(software, camera, range(1, 6))
    camera.close()
    assert np.allclose(shot.depth, depth_of(0) * 0.001)


def test_colour_without_depth_gives_no_shot_and_read_returns_in_time(software):
    camera = RealSenseCamera(rs, software.device, _settings())
    _first_shot(software, camera, range(1, 6))
    software.push_color(20, np.zeros((HEIGHT, WIDTH, 3), np.uint8))
    start = time.monotonic()
    assert camera.read(0.2) is None
    assert time.monotonic() - start < 5.0
    camera.close()


def test_a_size_that_is_not_offered_is_refused_with_those_that_are(software):
    with pytest.raises(CameraError, match="no depth of 640 x 480 at 30 Hz; it offers 64 x 48 at 30"):
        RealSenseCamera(rs, software.device, _settings(width=640, height=480))


def test_an_option_that_it_does_not_have_is_refused_with_those_that_it_has(software):
    with pytest.raises(CameraError, match=r"no option depth\.laser_power; it has .*depth\.depth_units"):
        apply_options(rs, software.device.query_sensors(), {"depth.laser_power": 150.0})


def test_depth_is_filtered_as_configured(software):
    """A wall with a step: depth beyond 0.5 m is removed, and then filled from its neighbours."""
    filters = {"hole_filling": {"holes_fill": 1}, "threshold": {"max_distance": 0.5}}
    farthest = {}
    for chosen in ({}, {"threshold": filters["threshold"]}, filters):
        camera = RealSenseCamera(rs, software.device, _settings(align=False, filters=chosen))
        shot = _first_shot(software, camera, range(20 * len(farthest) + 1, 20 * len(farthest) + 20))
        camera.close()
        assert shot.depth_ns == shot.device_ns
        farthest[len(chosen)] = (shot.depth.max(), (shot.depth > 0).mean())
    assert farthest[0] == (pytest.approx(0.6), 1.0)
    assert farthest[1] == (pytest.approx(0.3), pytest.approx(100 / 3072))
    assert farthest[2][0] == pytest.approx(0.3)
    assert farthest[2][1] > farthest[1][1]


@pytest.mark.parametrize(
    ("filters", "said"),
    [
        (
            {"spatial": {"magnitude": 2}},
            "no option magnitude of the filter spatial; it has .*filter_magnitude",
        ),
        (
            {"temporal": {"filter_smooth_alpha": 3}},
            "filter_smooth_alpha = 3 of the filter temporal is outside",
        ),
    ],
)
def test_a_wrong_option_of_a_filter_is_refused_with_the_reason(filters, said):
    with pytest.raises(CameraError, match=said):
        made_filters(rs, filters)


def test_filters_are_applied_in_a_fixed_order_with_disparity_around_temporal():
    names = [
        type(f).__name__ for f in made_filters(rs, {"hole_filling": {}, "temporal": {}, "decimation": {}})
    ]
    assert names == [
        *("decimation_filter", "disparity_transform", "temporal_filter", "disparity_transform"),
        "hole_filling_filter",
    ]


def test_exposure_is_set_through_the_options():
    software = SoftwareCamera(rs)
    sensor = software.device.query_sensors()[1]
    allowed = rs.option_range()
    allowed.min, allowed.max, allowed.step, allowed.default = 1.0, 10_000.0, 1.0, 156.0
    software._color.add_option(rs.option.exposure, allowed, True)
    apply_options(rs, software.device.query_sensors(), {"color.exposure": 80.0})
    assert sensor.get_option(rs.option.exposure) == 80.0
    with pytest.raises(CameraError, match=r"color.exposure = 0 is outside 1 to 10000"):
        apply_options(rs, software.device.query_sensors(), {"color.exposure": 0.0})


def test_a_missing_camera_is_named_at_once_with_what_to_do():
    start = time.monotonic()
    with pytest.raises(CameraError, match="udev rules"):
        source_of(rs, _settings()).open()
    assert time.monotonic() - start < 5.0, "the SDK alone would take over 11 s"


def test_rectified_pixels_agree_with_the_projection_of_the_sdk():
    coefficients = [-0.055, 0.065, -0.0006, 0.0004, -0.02]
    distorted = intrinsics(rs, coefficients)
    # The colours are columns and rows: after rectification, each pixel says where it came from.
    rows, columns = np.mgrid[0:HEIGHT, 0:WIDTH]
    image = np.stack([columns * 4, rows * 4, rows * 0], -1).astype(np.uint8)
    out = Rectification(rs, distorted).color(image)
    for u, v in ((10, 8), (50, 40), (31, 24)):
        ray = [(u - 31.5) / FOCAL, (v - 23.5) / FOCAL, 1.0]
        expected = rs.rs2_project_point_to_pixel(distorted, ray)
        assert out[v, u, :2] / 4 == pytest.approx(expected, abs=0.2)
    plain = Rectification(rs, intrinsics(rs))
    assert plain.color(image) is image


@pytest.fixture
def recording(tmp_path):
    """30 images, pushed through the SDK's recorder."""
    path = tmp_path / "recording.db3"
    software = SoftwareCamera(rs, record_to=str(path))
    sensors = software.recorder.query_sensors()
    for sensor in sensors:
        sensor.open(sensor.get_stream_profiles()[0])
        sensor.start(lambda frame: None)
    for number in range(1, 31):
        software.push(number)
        time.sleep(0.005)
    for sensor in sensors:
        sensor.stop()
        sensor.close()
    # The file is complete when the last reference to the recorder is gone.
    del sensors, sensor
    software.recorder = None
    del software
    gc.collect()
    return path


def test_a_recording_gives_its_images_and_its_end(recording):
    camera = source_of(rs, _settings(str(recording))).open()
    shots = []
    with suppress(CameraError):
        shots.extend(shot for shot in iter(lambda: camera.read(0.3), rs) if shot is not None)
    with pytest.raises(CameraError, match="has ended"):
        camera.read(0.1)
    camera.close()
    numbers = [s.number for s in shots]
    assert len(shots) >= 3  # it plays in real time, and a busy machine misses some
    assert numbers == sorted(set(numbers))
    assert all(s.color[0, 0, 0] == s.number for s in shots)
    assert np.isclose(shots[0].depth[24, 40], 0.6)


def test_a_recording_that_has_ended_is_played_again(recording):
    source = source_of(rs, _settings(str(recording)))
    once = source.open()
    with suppress(CameraError):
        while True:
            once.read(0.3)
    once.close()
    again = source.open()  # while the first one is still referenced, as by a reader
    assert again.read(2.0) is not None
    again.close()


def test_a_recording_that_is_not_there_is_refused():
    config = Config(camera=_settings("/nowhere/recording.db3"))
    with pytest.raises(InputError, match="no such recording"):
        realsense.open_source(config)


def _device(**settings):
    return {"source": "realsense", "rate": 30, "once": False, "truth": False, **settings}


@pytest.mark.live
def test_the_camera_worker_publishes_a_recording_and_the_cameras_intrinsics(
    pipeline, huepose, base_port, recording
):
    path = pipeline(**_device(path=str(recording), device={"width": WIDTH, "height": HEIGHT}))
    process = huepose("run", "camera", path)
    with Reader([endpoint(base_port)], "huepose/*/*/camera") as reader:
        info = reader.next(30.0)
    assert isinstance(info, CameraMessage), process.poll()
    assert (info.intrinsics.fx, info.intrinsics.width) == (FOCAL, WIDTH)


@pytest.mark.live
def test_the_camera_worker_says_that_no_camera_is_there(pipeline, huepose, base_port, tmp_path, monkeypatch):
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as systemd:
        systemd.bind(str(tmp_path / "notify"))
        systemd.settimeout(30.0)
        monkeypatch.setenv("NOTIFY_SOCKET", str(tmp_path / "notify"))
        camera = huepose("run", "camera", pipeline(**_device(path=None)))
        status = ""
        while not status.startswith("STATUS=RealSense"):
            status = systemd.recv(4096).decode()
    with Reader([endpoint(base_port)], "huepose/*/*/health/*") as reader:
        deadline = time.monotonic() + 30.0
        while time.monotonic() < deadline:
            health = reader.next(5.0)
            if isinstance(health, HealthMessage) and health.warnings:
                break
    assert health.state == "waiting"
    assert "no RealSense camera is connected" in health.warnings[0]
    assert status == f"STATUS={health.warnings[0]}"
    camera.terminate()
    assert "camera    ready" not in camera.communicate(timeout=10.0)[1]
