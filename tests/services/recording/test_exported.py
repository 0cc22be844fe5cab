"""A recording is written as a BOP scene."""

import json
import signal
from pathlib import Path

import msgspec
import pytest

from huepose.datasets.bop import BopScene
from huepose.model.io import model_path, save_model
from huepose.support.errors import InputError
from huepose_protos.examples import example
from huepose_protos.messages import (
    PoseMessage,
    TruthMessage,
)
from huepose_services.cli.main import main
from huepose_services.recording.export import export_bop
from huepose_services.recording.read import Recording
from tests.disk import full_disk

from .conftest import KEY, parts, tiny_frame, written

POSE = example(PoseMessage)


def test_a_recording_is_exported_as_a_bop_scene(tmp_path):
    out = parts(tmp_path / "out")
    truth = msgspec.structs.replace(example(TruthMessage), frame_id=8)
    for epoch, number in ((1, 7), (1, 8), (2, 3)):
        header, color, depth = tiny_frame(number)
        out.frame(msgspec.structs.replace(header, camera_epoch=epoch), color, depth, KEY + "frame")
        out.message(KEY + "truth", msgspec.structs.replace(truth, camera_epoch=epoch, frame_id=number))
    out.message(KEY + "pose/x/1", msgspec.structs.replace(POSE, camera_epoch=2, frame_id=3))
    out.close()
    folder = tmp_path / "bop"
    assert main(["replay", str(out.path), "--bop", str(folder)]) == 0
    scene = BopScene(folder)
    # After the camera was opened again, the numbers go on.
    assert scene.image_ids == (7, 8, 12)
    for image, number in ((7, 7), (8, 8), (12, 3)):
        header, color, depth = tiny_frame(number)
        frame = scene.frame(image)
        assert (frame.color == color).all()
        assert frame.depth == pytest.approx(depth * 0.0001, abs=1e-6)
        assert frame.stamp_ns == header.capture_ns
        assert (frame.camera.fx, frame.camera.cy) == (header.intrinsics.fx, header.intrinsics.cy)
        (label,) = scene.truths(image)
        assert label.T_cam_obj[:3, 3] == pytest.approx(truth.objects[0].translation)
        assert (label.object_id, label.visib_fract) == (
            truth.objects[0].object_id,
            truth.objects[0].visib_fract,
        )
    pose = json.loads((folder / "poses.jsonl").read_text())
    assert (pose["camera_epoch"], pose["frame_id"]) == (1, 12)
    with pytest.raises(InputError, match="a new or empty folder"):
        export_bop([], folder)
    with pytest.raises(InputError, match=r"/proc/scene: found .*; expected a place that can be written"):
        export_bop([], Path("/proc/scene"))


def test_on_a_full_disk_an_export_names_its_file(tmp_path, capsys):
    out = parts(tmp_path / "out")
    header, color, depth = tiny_frame(7)
    out.frame(header, color, depth, KEY + "frame")
    out.message(KEY + "pose/x/1", msgspec.structs.replace(POSE, camera_epoch=header.camera_epoch, frame_id=7))
    out.close()
    folder = tmp_path / "bop"
    with full_disk(room_bytes=500):  # enough for an image, not for a pose
        assert main(["replay", str(out.path), "--bop", str(folder)]) == 2
    assert f"{folder / 'poses.jsonl'}: found File too large" in capsys.readouterr().err


def test_the_size_of_a_recording_that_filled_the_disk_is_that_of_its_file(tmp_path):
    out = parts(tmp_path / "out")
    for number in range(200):
        out.frame(*tiny_frame(number), KEY + "frame")
    with full_disk(2000), pytest.raises(OSError, match="File too large"):
        out.close()
    assert out.size == out.path.stat().st_size > 0


def test_poses_of_objects_without_numbers_are_scored(tmp_path, tea_box, capsys):
    """As in a recording of one's own objects, which have only names."""
    save_model(tea_box, model_path(tmp_path / "bundles", "tea_box"))
    out = parts(tmp_path / "out")
    one = msgspec.structs.replace(
        example(TruthMessage).objects[0], object="tea_box", object_id=None, visib_fract=1.0
    )
    numbered = msgspec.structs.replace(one, object=None, object_id=7, instance=1)
    unnamed = msgspec.structs.replace(numbered, object_id=None)
    for number, objects in ((0, [one, numbered]), (1, [one]), (2, [one, unnamed])):
        header, color, depth = tiny_frame(number)
        out.frame(header, color, depth, KEY + "frame")
        this = {"camera_epoch": header.camera_epoch, "frame_id": number}
        out.message(KEY + "truth", msgspec.structs.replace(example(TruthMessage), **this, objects=objects))
        pose = msgspec.structs.replace(
            POSE,
            **{**this, "object": "tea_box", "state": "TRACKING"},
            **{"translation": one.translation, "quaternion": one.quaternion},
            **{"capture_ns": header.capture_ns, "publish_ns": header.publish_ns},
        )
        out.message(KEY + "pose/tea_box/0", pose)
    out.close()
    folder, result = tmp_path / "bop", tmp_path / "result.json"
    assert main(["replay", str(out.path), "--bop", str(folder)]) == 0
    assert "3 frames; the truth of 2; that of 1 left out, in which an object has" in capsys.readouterr().out
    labels = BopScene(folder).truths(0)
    assert [(label.object, label.object_id) for label in labels] == [("tea_box", 8), (None, 7)]
    arguments = ["--bop", str(folder), "--bundles", str(tmp_path / "bundles"), "--json", str(result)]
    assert main(["eval", "poses", str(folder / "poses.jsonl"), *arguments]) == 0
    summary = json.loads(result.read_text())["summary"]
    assert (summary["instances"], summary["sequences"]["bop"]["recall_add"]) == (2, 100.0)
    result.unlink()
    capsys.readouterr()
    with full_disk():
        assert main(["eval", "poses", str(folder / "poses.jsonl"), *arguments]) == 2
    said = capsys.readouterr()
    assert "poses for 100.0 % of frames" in said.out, "the results are printed all the same"
    assert f"{result}: found File too large" in said.err


@pytest.mark.parametrize("error", [KeyboardInterrupt, InputError("out.mcap", found="an invalid message")])
def test_an_export_that_is_stopped_or_fails_leaves_no_files(tmp_path, error):
    event = next(Recording(written(tmp_path / "out").path).events())

    def stopped():
        yield event
        raise error

    kind = error if isinstance(error, type) else type(error)
    with pytest.raises(kind):
        export_bop(stopped(), tmp_path / "bop")
    assert not (tmp_path / "bop").exists()
    own = tmp_path / "own"
    own.mkdir()
    (tmp_path / "link").symlink_to(own)
    for folder in (own, tmp_path / "link"):
        with pytest.raises(kind):
            export_bop(stopped(), folder)
        assert list(folder.iterdir()) == []


@pytest.mark.usefixtures("same_handlers")
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_an_export_that_is_terminated_leaves_no_files(tmp_path, monkeypatch, number):
    monkeypatch.setattr(
        "huepose_services.recording.export._write_images", lambda *_: signal.raise_signal(number)
    )
    signal.signal(number, lambda *_: None)  # else, without a handler, this would end the tests
    recording, folder = written(tmp_path / "out").path, tmp_path / "bop"
    assert main(["replay", str(recording), "--bop", str(folder)]) == 130
    assert not folder.exists()
