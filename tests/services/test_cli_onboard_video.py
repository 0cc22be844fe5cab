"""`huepose onboard --from-video`: a recording instead of a mesh."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable
from functools import partial
from importlib import import_module
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from huepose.datasets.bop_writer import BopWriter
from huepose.geometry import RgbdFrame
from huepose.onboarding import read_mesh
from huepose_protos.buffers import frame_images
from huepose_protos.examples import example
from huepose_protos.messages import PoseMessage
from huepose_services.cli.main import main
from tests.services.conftest import Says
from tests.services.fake_bus import sent
from tests.services.recording.conftest import KEY, parts


def bop_scene(path: Path, frames: list[RgbdFrame]) -> None:
    """Frames as a BOP scene's folder."""
    writer = BopWriter(path, {})
    for k, frame in enumerate(frames):
        writer.add(k, frame.color, frame.depth, frame.camera, [])


def recorded(path: Path, frames: list[RgbdFrame], jpeg: bool = False) -> None:
    """Frames as `huepose record` writes them, with poses between them and one frame twice."""
    out = parts(path, jpeg=jpeg)
    for frame in [frames[0], *frames]:
        stamps = {"capture_ns": frame.stamp_ns, "publish_ns": frame.stamp_ns}
        header, payload = sent(frame, frame_id=frame.frame_id, **stamps)
        out.frame(header, *frame_images(header, payload), KEY + "frame")
        out.message(KEY + "pose/other/0", example(PoseMessage))
    out.close()


def bag(path: Path, frames: list[RgbdFrame]) -> None:
    """Frames as a bag of ROS; one of ROS 2 is a folder."""
    from tests.datasets.test_rosbag import COLOR, DEPTH, INFO, Ros

    ros, at = Ros(path.name), 1_700_000_000_000_000_000
    messages = []
    for k, frame in enumerate(frames):
        now = at + k * 33_000_000
        messages += [
            (INFO, now, ros.info(frame.camera)),
            (COLOR, now, ros.image(frame.color, "rgb8", now)),
            (DEPTH, now, ros.image(frame.depth, "32FC1", now)),
        ]
    ros.write(path, messages)


def file_of_bag(path: Path, frames: list[RgbdFrame]) -> None:
    """The file of a bag of ROS 2 without its folder."""
    folder = path.with_name(f"bag_{path.suffix[1:]}")
    bag(folder, frames)
    (folder / folder.name).with_suffix(path.suffix).rename(path)


def rotating() -> list[RgbdFrame]:
    """Three frames of an object that rotates by 12 degrees."""
    from tests.onboarding.test_from_video import pose, rendered

    return [rendered(pose(np.radians(6.0 * k)), k) for k in range(3)]


def given_for(recording: Path, out: Path) -> list[str]:
    """The command that onboards it."""
    from tests.onboarding.test_from_video import box_of, pose

    box = [f"{x:.0f}" for x in box_of(pose(0.0)).box or ()]
    return ["onboard", "--from-video", str(recording), "--box", *box, "--name", "tea", "--out", str(out)]


@pytest.mark.parametrize(
    ("name", "write", "colour_off", "depth_off_m"),
    [
        ("turned", bop_scene, 3, 0.00006),
        ("turned.mcap", recorded, 0, 0.00006),
        ("small.mcap", partial(recorded, jpeg=True), 3, 0.00006),
        ("turned.bag", bag, 0, 0),
        ("bag_mcap", bag, 0, 0),
        ("turned.db3", file_of_bag, 0, 0),
        ("of_ros.mcap", file_of_bag, 0, 0),
    ],
)
def test_all_frames_of_every_kind_of_recording_are_used(
    name: str,
    write: Callable[[Path, list[RgbdFrame]], None],
    colour_off: float,
    depth_off_m: float,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    pytest.importorskip("open3d", reason="open3d is not installed")
    read: list[RgbdFrame] = []

    def learn(frames: Iterable[RgbdFrame], *_: object) -> None:
        read.extend(frames)
        raise KeyboardInterrupt

    monkeypatch.setattr("huepose.onboarding.from_video.learn", learn)
    frames = rotating()
    write(tmp_path / name, frames)
    main(given_for(tmp_path / name, tmp_path / "bundles"))
    assert len(read) == len(frames)
    for frame, true in zip(read, frames, strict=True):
        assert frame.camera == true.camera
        assert np.abs(frame.color.astype(int) - true.color).mean() <= colour_off
        np.testing.assert_allclose(frame.depth, true.depth, rtol=0, atol=depth_off_m)


@pytest.mark.parametrize(
    ("name", "found"), [("film.mp4", "a file of another kind"), ("cut.mcap", "an empty file")]
)
def test_a_file_that_is_no_recording_is_not_taken_for_a_folder(
    name: str, found: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / name).touch()
    assert main(given_for(tmp_path / name, tmp_path / "bundles")) == 2
    said = capsys.readouterr().err
    assert f"{name}: found {found}; expected a recording" in said
    assert ("A video has no depth, which HuePose needs: record colour with depth" in said) == (
        name == "film.mp4"
    )


def test_a_recording_replaces_a_mesh(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("open3d", reason="open3d is not installed")
    from huepose_services.cli import onboard
    from tests.onboarding.test_from_video import BOX

    recording, out = tmp_path / "turned", tmp_path / "bundles"
    bop_scene(recording, rotating())
    jobs = []

    def made(job: object, bundles: Path, unit_known: bool) -> None:
        assert unit_known, "no unit was given, so none is questioned"
        jobs.append(job)
        raise KeyboardInterrupt

    monkeypatch.setattr(onboard, "onboard_one", made)
    monkeypatch.setattr(import_module("huepose.onboarding.from_video.learn"), "POLISHES", 1)
    main(given_for(recording, out))
    assert [(job.mesh_path, job.unit) for job in jobs] == [(out / "tea_mesh" / "tea.obj", "m")]
    mesh = read_mesh(out / "tea_mesh" / "tea.obj", "m")
    # Over 12 degrees the sides were not visible; the height was.
    assert np.ptp(mesh.vertices[:, 2]) == pytest.approx(np.ptp(BOX.vertices[:, 2]), abs=0.006)


@pytest.mark.parametrize(
    ("file", "said"),
    [
        ("bundles", "bundles: found a file; expected a folder, which may be new."),
        ("bundles/tea_mesh", "bundles/tea_mesh is no folder; expected a place that can be written."),
    ],
)
def test_a_file_instead_of_a_folder_is_refused_before_the_recording_is_read(
    file: str, said: str, tmp_path: Path, refused: Says
) -> None:
    (tmp_path / file).parent.mkdir(exist_ok=True)
    (tmp_path / file).touch()
    assert said in refused(given_for(tmp_path / "no_recording.mcap", tmp_path / "bundles"))


@pytest.mark.parametrize(("surface", "code"), [(0.59, 1), (0.6, 0)])
def test_an_object_seen_from_one_side_only_gives_exit_code_1(
    surface: float,
    code: int,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    from huepose.onboarding.batch import Onboarded
    from huepose_services.cli import onboard, onboard_video
    from tests.onboarding.test_from_video import BOX

    made = SimpleNamespace(
        mesh=BOX, frames=9, T_cam_obj={0: None}, views=1, directions=0.1, surface=surface, closing_m=None
    )
    result = Onboarded("tea", tmp_path / "tea", (0.1, 0.1, 0.1), 0.2, 1, 9, 1.0, False)
    tests = []
    monkeypatch.setattr(onboard_video, "_scene", lambda path: None)
    monkeypatch.setattr(onboard_video, "_learned", lambda *_: made)
    monkeypatch.setattr(onboard, "onboard_one", lambda *_, **__: result)
    monkeypatch.setattr(onboard, "self_test", lambda *given: tests.append(given) or ({}, "tried"))
    given = f"onboard --from-video t.mcap --click 1 2 --name tea --out {tmp_path}".split()
    assert main(given) == code
    assert tests == [(tmp_path, "tea", surface if code else None)]
    assert ("NOT ALL ROUND (exit code 1)" in capsys.readouterr().out) == bool(code)
    assert main([*given, "--json"]) == code
    assert json.loads(capsys.readouterr().out)["video"]["all_round"] == (not code)


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ([], "found neither MESH nor --from-video"),
        (["a.obj", "--from-video", "b.mcap"], "found MESH and --from-video"),
        (["--from-video", "b.mcap"], "found neither --box nor --click"),
        (["--from-video", "b.mcap", "--click", "1", "2", "--box", "1", "2", "3", "4"], "found both"),
        (["--from-video", "b.mcap", "--click", "1", "2"], "b.mcap: found No such file"),
        (
            ["--from-video", "b.mcap", "--click", "1", "2", "--unit", "in"],
            "found --unit in; expected no unit",
        ),
    ],
)
def test_missing_options_for_a_recording_are_named(
    given: list[str], said: str, tmp_path: Path, refused: Says
) -> None:
    assert said in refused(["onboard", *given, "--name", "tea", "--out", tmp_path / "bundles"])
