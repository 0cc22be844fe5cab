"""What the doctor reports about images: of the built-in scene, unchanged and changed in known ways."""

from __future__ import annotations

import json
import re
import tracemalloc
from dataclasses import replace

import msgspec
import numpy as np
import pytest

from huepose.datasets.bop_writer import BopWriter
from huepose.geometry import Camera
from huepose.model.io import model_path, save_model
from huepose.scenes.builtin import SyntheticScene
from huepose_services.camera.faulty import Orders
from huepose_services.camera.live import LiveSource
from huepose_services.cli.main import main
from huepose_services.doctor import pictures
from huepose_services.doctor.pictures import alignment, brightness, depth, edge_offset
from huepose_services.runtime.config_perception import CameraConfig


@pytest.fixture(scope="module")
def frames():
    scene = SyntheticScene(0)
    return [scene.frame(i) for i in range(0, 240, 48)]


def shifted(frames, dx, dy):
    return [replace(f, depth=np.roll(f.depth, (dy, dx), (0, 1))) for f in frames]


def test_aligned_depth_is_ok(frames):
    assert alignment(frames, "realsense").state == "ok"


@pytest.mark.parametrize(
    ("dx", "dy", "words"),
    [(6, 0, r"\d px to the left"), (0, -5, r"\d px below"), (-4, 4, r"\d px to the right and \d px above")],
)
def test_misaligned_depth_is_reported_with_its_offset(frames, dx, dy, words):
    moved = shifted(frames, dx, dy)
    right, down, sigmas = edge_offset(moved)
    assert right == pytest.approx(-dx, abs=1.0)
    assert down == pytest.approx(-dy, abs=1.0)
    assert sigmas > 4.0
    finding = alignment(moved, "realsense")
    assert finding.bad
    assert re.search(words, finding.found)
    assert not re.search(r"[-+]\d", finding.found), "the words say the direction"


@pytest.mark.parametrize("dx", [5, 20])
@pytest.mark.parametrize(
    ("source", "fix"),
    [
        ("realsense", "set camera.device.align to true"),
        ("python", "frames() must return depth in the pixels of the colour image"),
        ("oak", "calibrate the camera"),
        ("bop", "the calibration of the recording"),
    ],
)
def test_the_fix_of_misaligned_depth_depends_on_the_source(frames, dx, source, fix):
    said = alignment(shifted(frames, dx, 0), source).fix
    assert fix in said
    assert ("device.align" in said) == (source == "realsense"), "others have no such key"


def noisy(frames, share):
    rng = np.random.default_rng(0)
    noise = [1.0 + share * rng.standard_normal(f.depth.shape).astype(np.float32) for f in frames]
    return [replace(f, depth=f.depth * n) for f, n in zip(frames, noise, strict=True)]


@pytest.mark.parametrize("share", [0.01, 0.02, 0.04])
def test_noisy_depth_with_edges_everywhere_is_not_reported_as_shifted_and_takes_little_memory(frames, share):
    with_noise = noisy(frames, share)
    tracemalloc.start()
    offset = edge_offset(with_noise)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert alignment(with_noise, "realsense").state == "ok", offset
    assert peak < 150e6  # every edge of these five frames would take up to ten times as much


def test_a_shift_of_noisy_depth_is_measured(frames):
    right, down, sigmas = edge_offset(shifted(noisy(frames, 0.005), 6, 0))
    assert (right, down) == pytest.approx((-6.0, 0.0), abs=1.0)
    assert sigmas > 4.0


def test_a_wall_says_nothing_about_alignment(frames):
    assert alignment([replace(f, depth=np.ones_like(f.depth)) for f in frames], "oak").state == "none"


@pytest.mark.parametrize(
    ("change", "state", "fix"),
    [
        (lambda d: d, "ok", ""),
        (lambda d: d * 1000.0, "bad", "another unit"),
        (lambda d: d * 0.001, "bad", "another unit"),
        (lambda d: d * 0.1, "note", "is the depth scale wrong"),
        (lambda d: d * 0.0, "bad", "Check lenses"),
        (
            lambda d: np.where(np.arange(d.shape[1]) % 3 == 0, d, 0.0).astype(np.float32),
            "note",
            "Much of it is missing",
        ),
    ],
)
def test_depth_in_another_unit_or_missing_is_reported(frames, change, state, fix):
    finding = next(iter(depth([replace(f, depth=change(f.depth)) for f in frames], CameraConfig())))
    assert (finding.state, fix in finding.fix) == (state, True)


def test_depth_in_another_unit_from_a_python_camera_is_to_be_given_in_metres(frames):
    in_millimetres = [replace(f, depth=1000.0 * f.depth) for f in frames]
    (finding,) = depth(in_millimetres, CameraConfig(source="python"))
    assert finding.fix == "Depth is in another unit: frames() must return metres."


def test_depth_that_is_too_far_to_be_sent_is_reported(frames):
    far = [replace(f, depth=f.depth * np.float32(10.0)) for f in frames]
    findings = list(depth(far, CameraConfig()))
    assert "is over 6.6 m and is not sent" in findings[1].found
    assert len(list(depth(far, CameraConfig(depth_scale_m=1e-3)))) == 1


@pytest.mark.parametrize(("factor", "state"), [(1.0, "ok"), (0.05, "bad"), (8.0, "note")])
def test_too_dark_and_too_bright_images_are_reported(frames, factor, state):
    lit = [replace(f, color=np.clip(f.color * factor, 0, 255).astype(np.uint8)) for f in frames]
    assert brightness(lit).state == state


def test_images_without_colour_are_reported(frames):
    grey = [replace(f, color=np.repeat(f.color[..., 1:2], 3, axis=2)) for f in frames]
    found = brightness(grey)
    assert (found.state, found.fix[:24]) == ("bad", "The image has no colour:")
    assert brightness([*grey, frames[0]]).state == "ok", "one image with colours is enough"


def _doctor(tmp_path, capsys, monkeypatch, **orders):
    monkeypatch.setattr(pictures, "LOOK_S", 2.0)
    path = tmp_path / "orders.json"
    path.write_bytes(msgspec.json.encode(msgspec.convert(orders, Orders)))
    pipeline = tmp_path / "pipeline.yaml"
    # Slow, so that a busy machine keeps the rate.
    pipeline.write_text(json.dumps({"camera": {"source": "faulty", "path": str(path), "rate": 4}}))
    code = main(["doctor", str(pipeline), "--camera", "--json"])
    return code, {f["subject"]: f for f in json.loads(capsys.readouterr().out)}


def test_a_live_camera_is_opened_and_checked(tmp_path, capsys, monkeypatch):
    _, found = _doctor(tmp_path, capsys, monkeypatch)
    assert found["camera"]["found"] == "640 x 480, fx 614.2 fy 614.6"
    assert (found["image"]["state"], found["depth"]["state"], found["alignment"]["state"]) == ("ok",) * 3


def test_the_complaints_of_the_camera_worker_are_reported(tmp_path, capsys, monkeypatch):
    code, found = _doctor(tmp_path, capsys, monkeypatch, dark=True, depth="zero")
    assert code == 1
    assert found["image"]["state"] == found["depth"]["state"] == "bad"


def test_a_missing_camera_is_reported(tmp_path, capsys, monkeypatch):
    code, found = _doctor(tmp_path, capsys, monkeypatch, unplugged=True)
    assert code == 1
    assert "Plug it in" in found["camera"]["found"]


def test_timestamps_of_wall_time_are_reported(tmp_path, capsys, monkeypatch, python_camera):
    monkeypatch.setattr(pictures, "LOOK_S", 1.5)
    python_camera("stamp_ns = time.time_ns()", every_s=0.2)
    camera = {"source": "python", "path": "cam.py", "rate": 4}
    (tmp_path / "pipeline.yaml").write_text(json.dumps({"camera": camera, "workers": ["camera"]}))
    assert main(["doctor", str(tmp_path / "pipeline.yaml"), "--camera", "--json"]) == 1
    (said,) = [f for f in json.loads(capsys.readouterr().out) if "timestamps" in f["found"]]
    assert said["state"] == "bad"
    assert "Give the time.monotonic_ns()" in said["found"]


def test_timestamps_that_are_too_old_for_any_pose_are_reported(tmp_path, capsys, monkeypatch, python_camera):
    monkeypatch.setattr(pictures, "LOOK_S", 1.5)
    python_camera("stamp_ns = time.monotonic_ns() - 10**9", every_s=0.2)
    camera = {"source": "python", "path": "cam.py", "rate": 4}
    (tmp_path / "pipeline.yaml").write_text(json.dumps({"camera": camera, "workers": ["camera"]}))
    assert main(["doctor", str(tmp_path / "pipeline.yaml"), "--camera", "--json"]) == 1
    (said,) = [f for f in json.loads(capsys.readouterr().out) if "timestamps" in f["found"]]
    assert said["state"] == "bad"
    assert "no pose older than tracker.max_age_ms (300) is TRACKING" in said["found"]


def _checked(tmp_path, capsys, camera):
    (tmp_path / "pipeline.yaml").write_text(json.dumps({"camera": camera, "workers": ["camera"]}))
    main(["doctor", str(tmp_path / "pipeline.yaml"), "--camera", "--json"])
    return {f["subject"]: f for f in json.loads(capsys.readouterr().out)}


def test_a_source_that_is_played_once_and_soon_ends_is_checked(tmp_path, capsys):
    (tmp_path / "cam.py").write_text(
        "import numpy as np\nfrom huepose import Camera, RgbdFrame\n"
        "def frames():\n    for k in range(3):\n        yield RgbdFrame(np.full((48, 64, 3), k, np.uint8), "
        "np.ones((48, 64), np.float32), Camera(60.0, 60.0, 31.5, 23.5, 64, 48))\n"
    )
    found = _checked(tmp_path, capsys, {"source": "python", "path": "cam.py", "once": True})
    assert found["camera"]["found"] == "64 x 48, fx 60.0 fy 60.0"


def test_images_of_several_sizes_are_checked_by_the_last_size(tmp_path, capsys):
    scene = BopWriter(tmp_path / "scene", {})
    for image, (width, height) in enumerate([(96, 64)] * 5 + [(64, 48)] * 5):
        camera = Camera(60.0, 60.0, (width - 1) / 2, (height - 1) / 2, width, height)
        color, depth = np.full((height, width, 3), 90, np.uint8), np.ones((height, width), np.float32)
        scene.add(image, color, depth, camera, [])
    found = _checked(tmp_path, capsys, {"source": "bop", "path": "scene"})
    assert found["camera"]["found"] == "64 x 48, fx 60.0 fy 60.0"


def test_an_error_of_the_sdk_is_reported(tmp_path, capsys, monkeypatch):
    def fails():
        raise RuntimeError("failed to set power state")

    monkeypatch.setattr(pictures, "open_source", lambda config: LiveSource("cam", "", fails))
    found = _checked(tmp_path, capsys, {"source": "oak"})
    assert (found["camera"]["state"], found["camera"]["found"]) == ("bad", "cam: failed to set power state")


def test_a_camera_that_does_not_answer_is_reported(tmp_path, capsys):
    (tmp_path / "cam.py").write_text("import time\ndef frames():\n    time.sleep(60)\n    yield\n")
    found = _checked(tmp_path, capsys, {"source": "python", "path": "cam.py"})
    assert found["camera"]["state"] == "bad"
    assert found["camera"]["found"].startswith("cam.py: reading it takes longer than 1.5 s. frames() waits")


def test_each_of_several_cameras_is_checked(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(pictures, "LOOK_S", 2.0)
    orders = {"left": {}, "right": {"unplugged": True}}
    for name, faults in orders.items():
        (tmp_path / name).write_bytes(msgspec.json.encode(msgspec.convert(faults, Orders)))
    cameras = [{"name": n, "source": "faulty", "path": str(tmp_path / n), "rate": 4} for n in orders]
    path = tmp_path / "pipeline.yaml"
    path.write_text(json.dumps({"cameras": cameras}))
    assert main(["doctor", str(path), "--camera", "--json"]) == 1
    found = {f["subject"]: f for f in json.loads(capsys.readouterr().out)}
    assert found["left camera"]["found"] == "640 x 480, fx 614.2 fy 614.6"
    assert "Plug it in" in found["right camera"]["found"]
    assert "right picture" not in found


def test_a_camera_cannot_be_checked_without_a_pipeline(refused):
    assert "huepose doctor PIPELINE.yaml --camera" in refused(["doctor", "--camera"])


@pytest.mark.parametrize(("unit", "depth_state"), [("1.0", "bad"), ("0.01", "ok")])
def test_if_depth_is_wrong_there_is_no_advice_to_bring_an_object_nearer(
    tmp_path, capsys, monkeypatch, tea_box, python_camera, unit, depth_state
):
    """At 7.5 m the box is really small; with depth in a wrong unit it only seems so."""
    monkeypatch.setattr(pictures, "LOOK_S", 1.5)
    save_model(tea_box, model_path(tmp_path / "models", "tea_box"))
    python_camera(f"depth *= np.float32({unit} * 1075.0)", 640, 0.2)
    camera = {"source": "python", "path": "cam.py", "rate": 4, "depth_scale_m": 0.001}
    (tmp_path / "pipeline.yaml").write_text(json.dumps({"camera": camera, "bundles": "models"}))
    main(["doctor", str(tmp_path / "pipeline.yaml"), "--camera", "--json"])
    found = {f["subject"]: f for f in json.loads(capsys.readouterr().out)}
    assert found["depth"]["state"] == depth_state
    assert ("distance" in found) == (depth_state == "ok")
    assert ("Correct depth first" in found["objects"]["fix"]) == (depth_state == "bad")
