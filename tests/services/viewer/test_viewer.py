"""The files that the viewer writes, read back."""

import re
import subprocess
import sys
from collections import Counter
from dataclasses import replace

import msgspec
import numpy as np
import pytest

from huepose_protos.buffers import pack
from huepose_protos.examples import example, images
from huepose_protos.messages import FrameHeader, HypothesesMessage, ObjectsMessage, PoseMessage
from huepose_services.viewer.shapes import (
    Body,
    drawable,
)
from tests.meshes import demo_objects
from tests.services.conftest import until
from tests.services.fake_bus import FakeBus, listed

SIZE = msgspec.structs.replace(example(FrameHeader).intrinsics, width=4, height=2)


def _frame(intrinsics=SIZE, **fields):
    """A small frame as it is sent."""
    specs, payload = pack(images())
    fields |= {"intrinsics": intrinsics, "buffers": specs}
    return msgspec.structs.replace(example(FrameHeader), **fields), payload


def _box():
    return demo_objects(0)["tea_box"]


@pytest.fixture
def shown(tmp_path):
    """A function that makes a Show of bodies; its `written` completes the file and gives its path."""
    pytest.importorskip("rerun", reason="rerun is not installed")
    from huepose_services.viewer.show import Show
    from huepose_services.viewer.sinks import saved

    recording = saved(tmp_path / "out.rrd")

    def show(bodies):
        return Show(recording, bodies)

    def written():
        recording.flush()
        recording.disconnect()
        return tmp_path / "out.rrd"

    show.written = written
    yield show
    recording.disconnect()


def test_frames_poses_and_changes_are_in_the_file(shown):
    from rerun.chunk import RrdReader

    show = shown({"006_mustard_bottle": Body(_box(), 0.2)})
    (header, _), pose = _frame(), example(PoseMessage)
    show.at(10**18, 42)
    show.frame(header, *images().values(), with_cloud=True)
    show.pose(pose)
    show.beliefs([pose])
    show.hypotheses(example(HypothesesMessage))
    show.pairs(np.array([[1.0, 1.0], [2.0, 0.0]]), np.array([False, True]))
    show.latency(12.0)
    show.event("006_mustard_bottle/3 TRACKING", "TRACKING")
    gone = {"translation": None, "quaternion": None, "state": "LOST", "covariance": None}
    show.at(10**18 + 10**9, 72)
    show.pose(msgspec.structs.replace(pose, **gone))
    counts: Counter[str] = Counter()
    for chunk in RrdReader(shown.written()).stream():
        counts[str(chunk.entity_path)] += chunk.to_record_batch().num_rows
    name = "006_mustard_bottle_3"
    assert counts[f"/world/objects/{name}"] == counts[f"/plots/quality/{name}"] - 1 == 2
    for once in (
        "/world/camera/color",
        "/depth",
        "/world/cloud",
        f"/world/objects/{name}/mesh",
        "/world/camera/overlay/outlines",
        "/world/camera/overlay/hypotheses/outlines",
        "/world/camera/overlay/pairs",
        "/events",
    ):
        assert counts[once] == 1, once


def test_instances_of_one_object_differ_in_colour(shown):
    show = shown({"box": Body(_box(), 0.2), "can": Body(_box(), 0.2)})
    instances = [
        ("box", 0),
        ("box", 1),
        ("can", 0),
        ("can", 5),
        ("unknown", 0),
        ("box", 2),
        ("can", 1),
        ("can", 2),
    ]
    colours = [show.colour_of(instance) for instance in instances]
    assert len(set(colours)) == len(instances), "as many as there are colours"
    assert [show.colour_of(instance) for instance in instances] == colours
    assert show.colour_of(("box", 3)) == colours[0], "then that of its object again"


def test_a_taken_port_is_named():
    pytest.importorskip("rerun", reason="rerun is not installed")
    import socket

    from huepose.support.errors import InputError
    from huepose_services.runtime.config import ViewerConfig
    from huepose_services.viewer.sinks import served

    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        port = other.getsockname()[1]
        with pytest.raises(InputError, match=f"viewer.web_port {port}"):
            served(ViewerConfig(web_port=port))


def test_without_a_screen_it_says_what_to_do(monkeypatch):
    pytest.importorskip("rerun", reason="rerun is not installed")
    from huepose.support.errors import InputError
    from huepose_services.viewer.sinks import window

    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    with pytest.raises(InputError, match="--web PORT"):
        window(100)


@pytest.mark.parametrize("name", ["v.png", "run"])
def test_a_file_with_another_extension_is_refused_first(name, tmp_path, refused):

    said = refused(["view", "--save", tmp_path / name, "--config", tmp_path / "none.yaml"])
    assert "expected a file for the rerun viewer, FILE.rrd" in said
    assert "huepose estimate --image" in said
    assert not (tmp_path / name).exists()


FULL = """
import sys
from pathlib import Path
import numpy as np, rerun as rr
from huepose.support.errors import InputError
from huepose_services.viewer import sinks
from huepose_services.viewer.sinks import flushed, saved
from tests.disk import full_disk
sinks.MOST_S = 3.0  # rerun's writer is gone
with full_disk():
    try:
        saved(Path(sys.argv[1]) / "none.rrd")
    except InputError as error:
        print(error)
with full_disk(100_000):
    recording = saved(Path(sys.argv[1]) / "out.rrd")
    assert flushed(recording) == ""
    print("begun")
    for k in range(50):
        recording.log(f"a/{k}", rr.Image(np.random.default_rng(k).integers(0, 255, (99, 99, 3), np.uint8)))
        if why := flushed(recording):
            print(why, flush=True)
            __import__("os")._exit(0)
"""


def test_a_full_disk_is_reported_at_the_start_of_a_file_and_later(tmp_path):
    pytest.importorskip("rerun", reason="rerun is not installed")
    # In a process of its own: rerun never gives up a file that it could not write.
    program = [sys.executable, "-c", FULL, str(tmp_path)]
    done = subprocess.run(program, capture_output=True, text=True, timeout=60.0)
    first, begun, last = done.stdout.splitlines()
    assert re.search("none.rrd: found .*; expected a place that can be written", first)
    assert begun == "begun"
    assert "cannot be written any further" in last


@pytest.mark.parametrize("begins_with_picture", [True, False])
def test_a_file_begins_with_an_image_and_loses_no_state_change(begins_with_picture):
    from unittest.mock import MagicMock

    from huepose_services.viewer import work

    poses, frames = [example(PoseMessage)], []
    bus, show = MagicMock(), MagicMock()
    bus.take = lambda source, kind: poses.pop() if poses else None
    bus.take_with_payload = lambda source, kind: frames.pop() if frames else None
    bus.inbox.liveliness.return_value.take = lambda: None
    viewer = work.ViewerWork(bus, show, {}, MagicMock(), 1e6, begins_with_picture=begins_with_picture)
    viewer.step()
    assert show.pose.called is not begins_with_picture
    frames.append(_frame(capture_ns=example(PoseMessage).capture_ns))
    viewer.step()
    assert show.frame.called
    later = msgspec.structs.replace(example(PoseMessage), capture_ns=example(PoseMessage).capture_ns + 1)
    poses.append(later)
    viewer.step()
    assert show.method_calls[0][0] == "at"
    shown = [name for name, *_ in show.method_calls if name in ("frame", "pose", "event")]
    assert shown == (
        ["frame", "event", "pose"] if begins_with_picture else ["event", "pose", "frame", "pose"]
    )


@pytest.mark.parametrize(
    "wrong",
    [{"cx": 1.5e308, "cy": 1.5e308}, {"width": 5}],
    ids=["no camera has it", "does not fit its pixels"],
)
def test_a_frame_with_wrong_intrinsics_is_refused_and_the_next_one_shown(wrong):
    from unittest.mock import MagicMock

    from huepose_services.viewer.work import ViewerWork

    frames = [_frame(), _frame(msgspec.structs.replace(SIZE, **wrong))]
    bus, show = MagicMock(), MagicMock()
    bus.take = lambda source, kind: None
    bus.take_with_payload = lambda source, kind: frames.pop() if frames else None
    bus.inbox.liveliness.return_value.take = lambda: None
    viewer = ViewerWork(bus, show, {}, MagicMock(), 1e9)
    until(lambda: viewer.step() or show.frame.called)
    assert bus.refuse.call_count == 1
    assert [call.args[0].intrinsics for call in show.frame.call_args_list] == [SIZE]


def _rows(path, entity, column):
    """The values of a column that were logged at an entity, in order of time."""
    from rerun.chunk import RrdReader

    out = []
    for chunk in RrdReader(path).stream():
        if str(chunk.entity_path) == entity:
            batch = chunk.to_record_batch()
            timed = "time" in batch.schema.names
            times = [at.value for at in batch.column("time")] if timed else range(batch.num_rows)
            for name in batch.schema.names:
                if column in name:
                    out += zip(times, batch.column(name).to_pylist(), strict=True)
    return [value for _, value in sorted(out, key=lambda one: one[0])]


def test_a_mesh_that_comes_after_the_first_pose_or_replaces_another_is_drawn(shown):
    bodies = {}
    show, pose = shown(bodies), example(PoseMessage)
    show.at(10**18, 1)
    show.pose(pose)
    can = demo_objects(0)["soup_can"]
    for first, mesh in ((2, _box()), (4, can)):
        bodies[pose.object] = Body(mesh, 0.2)
        for frame in (first, first + 1):
            show.at(10**18 + frame, frame)
            show.pose(pose)
    mesh = f"/world/objects/{pose.object}_{pose.instance}/mesh"
    drawn = _rows(shown.written(), mesh, "vertex_positions")
    assert [len(rows) for rows in drawn] == [len(drawable(m)["vertex_positions"]) for m in (_box(), can)]


def _viewer(show):
    """A function that gives a viewer poses, and an image unless told not to, of a time in seconds."""
    from unittest.mock import MagicMock

    from huepose_services.viewer import work

    arrived = {PoseMessage: [], FrameHeader: []}
    bus = MagicMock()
    bus.take = lambda source, kind: arrived[kind].pop(0) if arrived.get(kind) else None
    bus.take_with_payload = lambda source, kind: arrived[kind].pop() if arrived[kind] else None
    bus.inbox.liveliness.return_value.take = lambda: None
    viewer = work.ViewerWork(bus, show, {}, MagicMock(), 1e9)

    def step(at_s, *poses, picture=True):
        at_ns = round(at_s * 1e9)
        arrived[PoseMessage] += [msgspec.structs.replace(pose, capture_ns=at_ns) for pose in poses]
        viewer.step()
        if picture:
            arrived[FrameHeader].append(_frame(capture_ns=at_ns))
            while arrived[FrameHeader] or viewer._waiting is not None:
                viewer.step()

    return step


def test_an_object_without_poses_for_a_second_of_images_disappears(shown, monkeypatch):
    monkeypatch.setattr("huepose_services.viewer.work._PATIENCE_NS", 0)
    step = _viewer(shown({}))
    stays = example(PoseMessage)
    goes = msgspec.structs.replace(stays, object="can", instance=0)
    for k in range(30):
        step(10.0 + 0.1 * k, *([stays, goes] if k < 10 else [stays]))
    step(13.0, stays, goes)
    path = shown.written()
    scales = _rows(path, "/world/objects/can_0", "scale")
    assert scales == [[[1.0] * 3]] * 10 + [[[0.0] * 3]] + [[[1.0] * 3]]
    trails = _rows(path, "/world/trails/can_0", "strips")
    assert [len(rows[0]) if rows else 0 for rows in trails[8:]] == [9, 10, 0, 0]
    name = f"{stays.object}_{stays.instance}"
    assert _rows(path, f"/world/objects/{name}", "scale") == [[[1.0] * 3]] * 31
    said = [text for (text,) in _rows(path, "/events", "text")]
    assert sum("can/0  is no longer" in text for text in said) == 1


def test_an_object_whose_poses_come_late_does_not_disappear(monkeypatch):
    """Poses over a second after their images, as from a tracker on a computer that is much too slow."""
    from unittest.mock import MagicMock

    monkeypatch.setattr("huepose_services.viewer.work._PATIENCE_NS", 0)
    show = MagicMock()
    step = _viewer(show)
    for k in range(40):
        step(10.0 + 0.1 * k)
        if k >= 15:
            step(8.5 + 0.1 * k, example(PoseMessage), picture=False)
    assert not show.gone.called
    for k in range(40, 55):
        step(10.0 + 0.1 * k)
    assert show.gone.call_args_list == [((("006_mustard_bottle", 3),),)]


def test_an_object_that_is_added_later_is_drawn_with_its_colour_pairs(tea_box, tmp_path, monkeypatch):
    from argparse import Namespace

    from huepose.model.io import model_path, save_model
    from huepose_services.cli.view import _drawn
    from huepose_services.runtime.config import WORKERS, Config, ObjectConfig
    from huepose_services.runtime.running import Pipeline, noted

    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    monkeypatch.chdir(tmp_path)
    for name in ("can", "tea_box"):
        save_model(replace(tea_box, name=name), model_path(tmp_path / "bundles", name))
    config = Config(bundles=str(tmp_path / "bundles"), objects=[ObjectConfig(name="can")], workers=WORKERS)
    arguments = Namespace(config=None, pipeline=None, pairs=True)
    bus = FakeBus("view")
    with noted(Pipeline(base_port=29347, file=str(tmp_path / "pipeline.yaml"), workers=("camera",))):
        drawn, follower = _drawn(bus, config, True, arguments)
    assert list(drawn) == ["can"]
    bus.arriving[ObjectsMessage].append(listed("can", "tea_box"))
    body = until(lambda: follower.keep_up(drawn) or drawn.get("tea_box"))
    assert body.whole is not None
    assert (body.mesh.vertices == tea_box.mesh.vertices).all()


def test_a_running_pipeline_is_shown_without_models_if_its_file_is_wrong_now(tmp_path, monkeypatch):
    from argparse import Namespace

    from huepose_services.cli import view
    from huepose_services.runtime.running import Pipeline, noted

    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "pipeline.yaml"
    path.write_text("camera: {rte: 3}\n")
    arguments = Namespace(config=None, pipeline=None, pairs=False, save=tmp_path / "a.rrd", seconds=None)
    shown, bus = [], FakeBus("view")
    for name in ("single_threaded", "catch_stop_signals"):
        monkeypatch.setattr(view, name, lambda: None)
    monkeypatch.setattr(view, "_run", lambda config, valid, *more: (shown.append((config, valid)) or 0, ""))
    running = Pipeline(base_port=29347, site="lab", camera="cam0", file=str(path), workers=("camera",))
    with noted(running):
        assert view.call(arguments) == 1, "no image came"
        drawn, follower = view._drawn(bus, *shown[0], arguments)
        assert (shown[0][0].keys.site, drawn) == ("lab", {})
        bus.arriving[ObjectsMessage].append(listed("tea_box"))
        (said,) = until(lambda: follower.keep_up(drawn) or bus.logged["load"])
    assert said.startswith("the model of tea_box, which is not drawn: found an error in")
