"""What the camera worker reports about images in which nothing can be found."""

import re
import time
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from huepose.geometry import Camera
from huepose_services.camera.live import CameraError, LiveSource, Shot
from huepose_services.camera.live_ingest import LiveIngest
from huepose_services.camera.python import open_source
from huepose_services.runtime.config import Config
from huepose_services.runtime.config_file import load
from huepose_services.runtime.config_perception import CameraConfig
from tests.services.fake_bus import FakeBus


@pytest.fixture
def ingest_of(tmp_path: Path, python_camera):
    """A function: the camera worker of a Python camera that runs `change` for each frame, and its bus."""
    made = []

    def make(change, check="true"):
        python_camera(change)
        (tmp_path / "pipeline.yaml").write_text(
            f"camera: {{source: python, path: cam.py, check: {check}}}\nworkers: [camera]\nbundles: bundles\n"
        )
        config = load(tmp_path / "pipeline.yaml")
        made.append(LiveIngest(FakeBus("camera", config.keys), config, open_source(config)))
        return made[-1], made[-1]._bus

    yield make
    for ingest in made:
        ingest.close()


def _step_for(ingest, seconds, until=lambda: False):
    """Steps for some seconds, or until a condition holds."""
    end = time.monotonic() + seconds
    while not until() and time.monotonic() < end:
        ingest.step()


def _reported_fault(ingest, bus, seconds=3.0):
    """The fault of the images in the worker's health, as soon as there is one; empty if there is none in
    time."""
    _step_for(ingest, seconds, lambda: bus.health.picture)
    return bus.health.message().picture


def test_depth_in_millimetres_is_reported(ingest_of):
    said = _reported_fault(*ingest_of("depth *= 1000.0"))
    assert said.startswith("cam.py: depth looks like millimetres")


def test_if_every_image_is_refused_health_says_that_none_comes_and_why(ingest_of):
    ingest, bus = ingest_of("color = color[:24]")
    why = "No image comes, and perception waits for the next. cam.py: Input"
    assert _reported_fault(ingest, bus).startswith(why)
    assert bus.headers == []


def test_if_every_image_is_too_large_health_says_so_with_the_limit(ingest_of, monkeypatch):
    monkeypatch.setattr("huepose_services.convert.MOST_PIXELS", 2_000)
    ingest, bus = ingest_of("pass")
    said = _reported_fault(ingest, bus)
    assert "cam.py: image: found 64 x 48 pixels; expected at most 0.0 million of them. Set a smaller" in said
    assert bus.headers == []


@pytest.mark.parametrize("change", ["pass", "depth[0] = np.nan", "depth[0, :9] = np.inf"])
def test_no_fault_is_reported_for_good_images(ingest_of, change):
    ingest, bus = ingest_of(change)
    assert _reported_fault(ingest, bus, 1.0) == ""
    assert len(bus.headers) > 5


def test_the_log_states_the_rate_of_a_camera_that_has_become_slow(ingest_of):
    ingest, bus = ingest_of(
        "began = locals().get('began', time.monotonic())\n"
        "        time.sleep(0.48 if time.monotonic() - began > 1.5 else 0.0)"
    )
    said = []
    bus.log.seldom = lambda kind, text: said.append((kind, text))
    _step_for(ingest, 8.0, lambda: said)
    ((kind, text),) = said
    assert kind == "pictures: rate"
    assert any(f"it gives {rate} images a second instead of 30" in text for rate in (1, 2, 3)), text


def test_a_camera_that_hangs_is_reported_as_giving_no_image_not_as_slow(ingest_of):
    """After 1.5 s it gives no image for 2.6 s, then goes on."""
    ingest, bus = ingest_of(
        "began = locals().get('began', time.monotonic())\n"
        "        hung = locals().get('hung', False)\n"
        "        if not hung and time.monotonic() - began > 1.5:\n"
        "            hung = True\n"
        "            time.sleep(2.6)"
    )
    logged, sent, pictures, warnings, steps = [], [], set(), set(), []
    bus.log.seldom = lambda kind, text: logged.append(kind)
    bus.say_health = lambda: sent.append((len(bus.headers), bus.health.message()))
    end = time.monotonic() + 20.0
    while time.monotonic() < end and not (pictures - {""} and sent[-1][1].state == "ready"):
        began_ns = time.monotonic_ns()
        ingest.step()
        steps.append((began_ns, time.monotonic_ns()))
        pictures.add(bus.health.picture)
        warnings.update(bus.health.message().warnings)
    said = [(frames, message) for frames, message in sent if "no image for" in message.picture]
    ((frames, message),) = said
    late_ns = bus.headers[frames - 1].capture_ns + 1_250_000_000
    # It is said in the first step that begins so late, at the latest.
    assert late_ns - 250_000_000 < message.publish_ns < next(over for began, over in steps if began > late_ns)
    assert message.state == "waiting"
    assert message.picture.startswith("No image comes, and perception waits for the next. cam.py: no ima")
    assert message.warnings[0] == "cam.py: no image for 1 s"
    assert sent[-1][1].state == "ready"
    assert sent[-1][1].picture == ""
    known = "No image has come for 2 s, and perception waits for the next. cam.py: reading it takes longer"
    assert any(picture.startswith(known) for picture in pictures)
    assert "pictures: rate" not in logged
    assert not [text for text in warnings if "images a second" in text]


@pytest.mark.parametrize(
    ("still", "check", "doubted"),
    [("1 < age < 3", "true", True), ("1 < age < 3", "false", False), ("age >= 0", "true", False)],
)
def test_frames_say_that_their_camera_has_stopped_until_the_image_changes(ingest_of, still, check, doubted):
    """A camera that shows one image from the beginning has not stopped."""
    ingest, bus = ingest_of(
        "began = locals().get('began', time.monotonic())\n"
        "        age = time.monotonic() - began\n"
        f"        color = kept if {still} and 'kept' in locals() else color\n"
        "        kept = color",
        check,
    )
    _step_for(ingest, 4.0 if doubted else 2.5)
    begun_ns = bus.headers[0].capture_ns
    said_s = [1e-9 * (h.capture_ns - begun_ns) for h in bus.headers if h.camera]
    if not doubted:
        assert said_s == []
        return
    assert 1.3 < said_s[0] < 1.8
    assert 2.8 < said_s[-1] < 3.1
    late = next(h for h in bus.headers if h.capture_ns - begun_ns > 2.5e9)
    assert "cam.py: its image has changed before" in late.camera
    assert bus.headers[-1].camera == ""


def test_a_frame_states_the_fault_of_its_image(ingest_of):
    ingest, bus = ingest_of("depth *= 1000.0")
    assert _reported_fault(ingest, bus)
    _step_for(ingest, 0.3)
    assert bus.headers[-1].picture.startswith("cam.py: depth looks like millimetres")
    assert bus.headers[-1].camera == ""


def test_health_reports_at_once_that_a_fault_of_the_images_begins_and_ends(ingest_of):
    ingest, bus = ingest_of(
        "began = locals().get('began', time.monotonic())\n"
        "        depth *= 1000.0 if time.monotonic() - began < 1.5 else 1.0"
    )
    _step_for(ingest, 10.0, lambda: len(bus.healths) == 2)
    _step_for(ingest, 0.5)
    wrong, over = (said.picture for said in bus.healths)
    assert wrong.startswith("cam.py: depth looks like millimetres")
    assert over == ""


class Paired:
    """Colour and depth of 64 x 48 pixels at 50 Hz; apart: whether depth is 100 ms older; pictures: number of
    images after which it is unplugged."""

    device_clock_is_host = is_sensor = False

    def __init__(self, apart, pictures):
        self._apart, self._pictures, self._number = apart, pictures, 0

    def read(self, timeout_s):
        if self._number == self._pictures:
            raise CameraError("unplugged")
        time.sleep(0.02)
        self._number += 1
        color = np.random.default_rng(self._number).integers(60, 200, (48, 64, 3), np.uint8)
        now = time.monotonic_ns()
        depth_ns = now - 100_000_000 * self._apart
        camera = Camera(60.0, 60.0, 31.5, 23.5, 64, 48)
        return Shot(color, np.ones((48, 64), np.float32), camera, self._number, now, now, depth_ns)

    def close(self):
        pass


@pytest.mark.parametrize("good_before", [0, 10])
def test_it_is_reported_if_all_images_since_the_camera_was_opened_are_left_out(good_before):
    """Also if its images were good when it was opened before."""
    openings = iter([Paired(apart=False, pictures=good_before)] * bool(good_before))
    source = LiveSource("sensors", "", lambda: next(openings, Paired(apart=True, pictures=1000)))
    config = Config(camera=CameraConfig(source="python", path="x"))
    bus = FakeBus("camera", config.keys)
    ingest = LiveIngest(bus, config, source)
    try:
        _step_for(ingest, 5.0, lambda: "100 ms older" in bus.health.picture)
    finally:
        ingest.close()
    health = bus.health.message()
    assert health.picture.startswith("No image comes, and perception waits for the next. sensors: depth is")
    assert any("such images are left out" in warning for warning in health.warnings)
    assert (health.state, len(bus.headers)) == ("waiting", good_before)
    assert ingest.ready == (good_before > 0)


@pytest.mark.parametrize(("back_s", "epochs"), [(3.0, 2), (0.2, 1)])
def test_timestamps_that_go_far_back_begin_a_new_epoch(ingest_of, back_s, epochs):
    ingest, bus = ingest_of(
        "began = locals().get('began', time.monotonic())\n"
        f"        back_s = {back_s} if time.monotonic() - began > 0.5 else 0.0\n"
        "        stamp_ns = time.monotonic_ns() - int(back_s * 1e9)"
    )
    _step_for(ingest, 1.0)
    assert len({header.camera_epoch for header in bus.headers}) == epochs
    warnings = [text for text in bus.health.message().warnings if "timestamps went back by 3 s" in text]
    assert len(warnings) == len(bus.logged["pictures: back"]) == epochs - 1
    if epochs == 2:
        of_one = [(a, b) for a, b in pairwise(bus.headers) if a.camera_epoch == b.camera_epoch]
        assert all(a.capture_ns < b.capture_ns for a, b in of_one)


def test_intrinsics_that_change_with_each_image_are_logged_once_with_different_digits(ingest_of):
    ingest, bus = ingest_of("focal += 0.01")
    lines = []
    bus.log.say = lines.append
    _step_for(ingest, 0.5)
    assert len({header.camera_epoch for header in bus.headers}) > 5
    assert len(lines) == 1
    (said,) = bus.logged["pictures: change"]
    before, after = re.findall(r"64 x 48, fx ([\d.]+), fy", said)
    assert 60.0 < float(before) < float(after)
