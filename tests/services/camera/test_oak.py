"""The OAK source: its host part with real host nodes, its device part against the installed package."""

import inspect
import time

import numpy as np
import pytest

from huepose.support.errors import InputError
from huepose_services.camera.live import CameraError
from huepose_services.camera.oak import OakCamera, build, check_options, shot_of, source_of, synchronised
from huepose_services.runtime.config_perception import CameraConfig, DeviceConfig

dai = pytest.importorskip("depthai", reason="depthai, the OAK SDK, is not installed")

K = [[60.0, 0.0, 31.5], [0.0, 61.0, 23.5], [0.0, 0.0, 1.0]]


def _images(number, size=(48, 64)):
    color, depth = dai.ImgFrame(), dai.ImgFrame()
    color.setCvFrame(
        np.full((48, 64, 3), (3 * number, 2 * number, number), np.uint8), dai.ImgFrame.Type.BGR888i
    )
    depth.setCvFrame(np.full(size, 600 + number, np.uint16), dai.ImgFrame.Type.RAW16)
    transformation = color.getTransformation()
    transformation.setIntrinsicMatrix(K)
    color.setTransformation(transformation)
    for image in (color, depth):
        image.setSequenceNum(number)
        image.setTimestamp(dai.Clock.now())
    return color, depth


class Producer(dai.node.ThreadedHostNode):
    """What the device's nodes would give, at 50 Hz."""

    def __init__(self):
        super().__init__()
        self.color, self.depth = self.createOutput(), self.createOutput()

    def run(self):
        for number in range(1, 30):
            if not self.isRunning():
                return
            color, depth = _images(number)
            self.color.send(color)
            if number != 5:  # colour without its depth must not be paired with other depth
                self.depth.send(depth)
            time.sleep(0.02)


def _end(pipeline):
    """Waits for nodes that are written in Python: destroying a pipeline holds the lock that they need."""
    pipeline.stop()
    pipeline.wait()


def test_groups_of_colour_and_depth_become_shots_until_the_pipeline_ends():
    pipeline = dai.Pipeline(createImplicitDevice=False)
    producer = pipeline.create(Producer)
    queue = synchronised(dai, pipeline, producer.color, producer.depth, 50.0, on_host=True)
    before = time.monotonic_ns()
    pipeline.start()
    camera = OakCamera(pipeline, queue)
    shots = [shot for _ in range(12) if (shot := camera.read(1.0)) is not None]
    numbers = [s.number for s in shots]
    assert len(shots) >= 3  # a busy machine misses some
    assert 5 not in numbers
    assert numbers == sorted(set(numbers))
    for shot in shots:
        assert shot.color[0, 0].tolist() == [shot.number, 2 * shot.number, 3 * shot.number]
        assert np.allclose(shot.depth, 0.6 + 0.001 * shot.number)
        assert before < shot.device_ns <= shot.arrived_ns
        assert (shot.camera.fx, shot.camera.fy, shot.camera.cx, shot.camera.width) == (60.0, 61.0, 31.5, 64)
    camera.close()
    with pytest.raises(CameraError, match="connection is lost"):
        camera.read(0.2)
    _end(pipeline)


def test_read_returns_in_time_when_nothing_comes():
    class Silent(dai.node.ThreadedHostNode):
        def __init__(self):
            super().__init__()
            self.color, self.depth = self.createOutput(), self.createOutput()

        def run(self):
            while self.isRunning():
                time.sleep(0.01)

    pipeline = dai.Pipeline(createImplicitDevice=False)
    silent = pipeline.create(Silent)
    queue = synchronised(dai, pipeline, silent.color, silent.depth, 30.0, on_host=True)
    pipeline.start()
    camera = OakCamera(pipeline, queue)
    start = time.monotonic()
    assert camera.read(0.2) is None
    assert time.monotonic() - start < 5.0
    camera.close()
    _end(pipeline)


def test_colour_and_depth_of_different_sizes_are_refused():
    with pytest.raises(CameraError, match="depth is 32 x 24, colour 64 x 48"):
        shot_of(*_images(1, (24, 32)), 0)


def test_a_missing_camera_is_named_at_once_with_what_to_do():
    start = time.monotonic()
    with pytest.raises(CameraError, match="udev rules"):
        source_of(dai, CameraConfig(source="oak")).open()
    assert time.monotonic() - start < 5.0, "the SDK alone would take over 11 s"


def test_options_are_checked():
    check_options({"depth.subpixel": 0.0, "color.exposure_us": 8000.0, "color.iso": 400.0})
    with pytest.raises(InputError, match=r"expected one of depth\.left_right_check"):
        check_options({"depth.sub_pixel": 1.0})
    with pytest.raises(InputError, match=r"expected color\.exposure_us and color\.iso"):
        check_options({"color.iso": 400.0})


class Checked:
    """Stands for an object of the package: every name and keyword that is used must exist there."""

    def __init__(self, kind, calls):
        self._kind, self._calls = kind, calls

    def __getattr__(self, name):
        found = getattr(self._kind, name)  # raises where the package has no such name
        if not callable(found):
            return Checked(_RETURNS.get((self._kind.__name__, name), dai.Node.Output), self._calls)

        def call(*arguments, **keywords):
            text = inspect.getdoc(found) or ""
            assert all(f"{keyword}:" in text for keyword in keywords), f"{name}: {sorted(keywords)}"
            self._calls.append(name)
            return Checked(_RETURNS.get((self._kind.__name__, name), self._kind), self._calls)

        return call

    def __getitem__(self, name):
        return Checked(dai.Node.Input, self._calls)


_RETURNS = {
    ("Camera", "initialControl"): dai.CameraControl,
    ("Camera", "requestOutput"): dai.Node.Output,
    ("StereoDepth", "inputAlignTo"): dai.Node.Input,
    ("Sync", "inputs"): dai.Node.InputMap,
    ("Output", "createOutputQueue"): dai.MessageQueue,
}


@pytest.mark.parametrize("platform", ["RVC2", "RVC4"])
def test_the_devices_pipeline_uses_only_what_the_package_has(platform):
    calls = []

    class Package:
        """depthai, but a pipeline needs no device."""

        def __getattr__(self, name):
            return getattr(dai, name)

        class Pipeline:
            def __init__(self, device):
                pass

            def create(self, kind):
                calls.append(kind.__name__)
                return Checked(kind, calls)

    class Device:
        def getPlatform(self):
            return getattr(dai.Platform, platform)

    options = {"depth.extended_disparity": 1.0, "color.exposure_us": 8000.0, "color.iso": 400.0}
    settings = CameraConfig(source="oak", device=DeviceConfig(options=options))
    _, queue = build(Package(), Device(), settings)
    assert queue._kind is dai.MessageQueue
    assert calls.count("Camera") == 3
    assert ("ImageAlign" in calls) == (platform == "RVC4")
    assert {"setManualExposure", "setExtendedDisparity", "setSubpixel", "setSyncThreshold"} <= set(calls)
