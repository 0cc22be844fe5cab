"""When the frames of a source are due, what the camera worker reports if they are late, and how a recording
that is played once waits for its subscribers."""

import io
import time
from types import SimpleNamespace

import pytest

from huepose.datasets.bop import BopScene
from huepose.scenes.builtin import SyntheticScene
from huepose.scenes.camera import CAMERA
from huepose.support.errors import InputError
from huepose_protos.examples import example
from huepose_protos.messages import FrameHeader, PoseMessage
from huepose_services.camera.ingest import Busy, Ingest, Schedule, make
from huepose_services.camera.publish import packed
from huepose_services.runtime.clock import SECOND
from huepose_services.runtime.config import BusConfig, Config, ObjectConfig
from huepose_services.runtime.config_perception import CameraConfig
from huepose_services.runtime.health import Health
from huepose_services.runtime.log import Log
from tests.meshes import demo_objects
from tests.services.conftest import until
from tests.services.fake_bus import FakeBus
from tests.services.sessions import close_bus, open_bus

POSE = example(PoseMessage)
STAMPS = {3: 0, 4: 40_000_000, 7: 140_000_000, 9: 150_000_000}


def _source(stamps=STAMPS):
    return SimpleNamespace(image_ids=tuple(stamps), stamp_ns=stamps.__getitem__)


def _schedule(stamps=STAMPS, **camera):
    return Schedule(_source(stamps), CameraConfig(source="bop", **camera), 1000)


def test_recorded_times_are_kept_exactly():
    schedule = _schedule(rate="recorded", once=True)
    assert [schedule.due_ns(i) - 1000 for i in range(4)] == list(STAMPS.values())


def test_once_ends_and_a_loop_does_not():
    once, loop = _schedule(once=True), _schedule()
    assert [once.image(i) for i in range(5)] == [3, 4, 7, 9, None]
    assert [loop.image(i) for i in range(6)] == [3, 4, 7, 9, 3, 4]
    assert [i for i in range(12) if loop.begins_again(i)] == [4, 8]
    assert not any(once.begins_again(i) for i in range(12))


def test_the_first_pass_has_the_images_numbers_and_later_ones_new_ones():
    schedule = _schedule()
    ids = [schedule.frame_id(i) for i in range(12)]
    assert ids[:4] == [3, 4, 7, 9]
    assert ids == sorted(set(ids))


def test_a_loop_at_a_fixed_rate_never_drifts():
    schedule = _schedule(rate=30.0)
    for i in (1, 4, 4001):
        assert schedule.due_ns(i) - 1000 == pytest.approx(i * SECOND / 30, abs=i / 4 + 1)


def test_time_never_goes_back_and_a_jump_in_the_recorded_times_is_limited():
    schedule = _schedule({0: 5, 1: 3, 2: 10**15}, rate="recorded")
    dues = [schedule.due_ns(i) for i in range(6)]
    assert dues == sorted(dues)
    assert dues[2] - dues[1] == 10 * SECOND


@pytest.mark.parametrize("stamps", [(0, 30, 60, 20, 50), (0, 30, 30, 60, 90), (7, 7, 7)])
def test_no_two_frames_have_one_time(stamps):
    schedule = _schedule(dict(enumerate(stamps)), rate="recorded")
    dues = [schedule.due_ns(i) - 1000 for i in range(len(stamps) + 1)]
    usual = 30 if len(stamps) > 3 else SECOND // 30
    assert dues == [usual * i for i in range(len(stamps) + 1)]


def test_a_loop_at_recorded_times_goes_on_with_the_usual_gap():
    schedule = _schedule({0: 0, 1: 30, 2: 60, 3: 90}, rate="recorded")
    assert [schedule.due_ns(i) - 1000 for i in (3, 4, 5)] == [90, 120, 150]


def test_an_image_without_a_timestamp_does_not_move_others():
    def stamp_ns(image):
        if image in (4, 9):
            raise InputError("scene_camera.json", found="no such picture")
        return STAMPS[image]

    camera = CameraConfig(source="bop", rate="recorded")
    schedule = Schedule(SimpleNamespace(image_ids=tuple(STAMPS), stamp_ns=stamp_ns), camera, 0)
    assert [schedule.due_ns(i) for i in (0, 2)] == [STAMPS[3], STAMPS[7]]


def test_postponing_moves_only_later_frames():
    schedule = _schedule(rate="recorded")
    schedule.postpone(500)
    assert schedule.due_ns(1) == 1000 + 500 + STAMPS[4]


def test_a_camera_that_is_late_repeatedly_warns_of_a_busy_computer():
    busy = Busy()
    assert busy.late(104_000_000, 0) == "frames come 104 ms late: this computer is busy"
    assert busy.warning(SECOND) is None, "once is no reason to warn"
    for k in range(1, 5):
        busy.late(150_000_000, k * SECOND)
    warning = busy.warning(6 * SECOND)
    assert warning.startswith(
        "this computer is busy: the camera was late 5 times in the last minute, by up to 150"
    )
    assert busy.warning(70 * SECOND) is None


def _said_while_played(config, source, seconds, lines):
    """The lines of the camera's log, after so many lines or seconds."""

    def said():
        texts = [line.split("camera ", 1)[1].strip() for line in out.getvalue().splitlines()]
        return [text for text in texts if not text.startswith("frames come ")]  # late on a busy computer

    out, taken = io.StringIO(), SimpleNamespace(put=lambda *_: None, put_pixels=lambda *_: None)
    bus = SimpleNamespace(
        **vars(taken), keys=config.keys, inbox=None, health=Health("camera"), log=Log("camera", out)
    )
    ingest, until = Ingest(bus, config, source), time.monotonic() + seconds
    while time.monotonic() < until and len(said()) < lines:
        ingest.step()
        time.sleep(0.005)
    return said()


def test_each_time_a_recording_begins_again_the_log_says_that_objects_jump(scene):
    camera = CameraConfig(source="bop", path=str(scene), rate=12.0)
    said = _said_while_played(Config(workers=("camera",), camera=camera), BopScene(scene), 20.0, 2)
    assert len(said) == 2
    assert {text.split(":")[0] for text in said} == {
        "the recording begins again, and objects jump to where they were in its first image"
    }


def test_the_log_says_once_that_a_rendered_scene_occludes_objects(tmp_path, monkeypatch):
    monkeypatch.setattr("huepose.scenes.plan._ATTEMPTS", 1)  # any plan does
    mesh = {"tea_box": demo_objects(0)["tea_box"]}
    rendered = SyntheticScene(3, 1.0, mesh, CAMERA.scaled(0.25), cache=tmp_path)
    config = Config(workers=("camera",), camera=CameraConfig(source="synthetic", rate=30.0))
    (said,) = _said_while_played(config, rendered, 2.5, 2)
    assert said.startswith("a rendered scene, repeated every 1 s: objects rotate fast, pass in front of")


def _ingest(scene, **camera):
    """The camera worker of a scene, its bus and its log."""
    settings = CameraConfig(source="bop", path=str(scene), rate=200.0, first_frame_s=0.0, **camera)
    config, out = Config(workers=("camera",), camera=settings), io.StringIO()
    bus = FakeBus("camera", config.keys)
    bus.log = Log("camera", out)
    return Ingest(bus, config, BopScene(scene)), bus, out


def _step_to_the_end(ingest):
    until(lambda: ingest.finished, 20.0, ingest.step)


def test_unreadable_images_are_left_out_and_counted(scene):
    (scene / "depth" / "000005.png").unlink()
    (scene / "rgb" / "000014.png").write_bytes(b"no picture")
    ingest, bus, out = _ingest(scene, once=True)
    _step_to_the_end(ingest)
    assert ingest.fault is None
    assert [h.frame_id for h in bus.headers] == [3, 4, *range(6, 14)]
    assert bus.health.counters["frames_unread"] == 2
    said = out.getvalue()
    assert f"an image is left out: {scene / 'depth' / '000005.png'}: found no such file." in said
    assert "the recording has ended after 10 of 12 frames: 2 could not be read\n" in said


def test_a_pass_without_any_readable_image_ends_with_the_error(scene):
    ingest, bus, _ = _ingest(scene)
    for path in (scene / "depth").iterdir():
        path.unlink()
    _step_to_the_end(ingest)
    assert [h.frame_id for h in bus.headers] == [3]
    assert "no such file" in str(ingest.fault)


def test_after_an_error_the_previous_image_is_not_sent_as_the_next_one(scene):
    ingest, bus, _ = _ingest(scene, once=True)
    read, shown = ingest._source.frame, []
    ingest._source.frame = lambda image: 1 / 0 if image == 7 else read(image)
    bus.put_pixels = lambda key, header, payload: shown.append((header.frame_id, payload[0]))
    with pytest.raises(ZeroDivisionError):
        _step_to_the_end(ingest)
    _step_to_the_end(ingest)
    # The colour of image n is n - 3; image 8 is red.
    assert shown == [(n, 255 if n == 8 else n - 3) for n in range(3, 15) if n != 7]


@pytest.mark.live
def test_the_camera_waits_for_poses_and_for_its_last_subscriber(scene, base_port, wait_until):
    """With real sessions; the test itself is the tracker."""
    config = Config(
        workers=("camera", "tracker"),
        objects=[ObjectConfig(name=POSE.object)],
        bundles=str(scene),
        camera=CameraConfig(source="bop", path=str(scene), rate="recorded", once=True, first_frame_s=60.0),
        bus=BusConfig(base_port=base_port),
    )
    camera, tracker = (open_bus(config, worker) for worker in config.workers)
    frames = tracker.inbox.queue(config.keys.frame)
    ingest, seen = make(camera, config), []

    def step():
        ingest.step()
        time.sleep(0.005)
        while (taken := tracker.take_with_payload(frames, FrameHeader)) is not None:
            seen.append(taken[0])
        return seen

    for _ in range(20):
        assert step() == [], "the tracker is not there yet"
    token = tracker.session.liveliness().declare_token(config.keys.live("tracker"))
    wait_until(lambda: len(step()) >= 3)
    assert {h.frame_id for h in seen} == {3}, "it repeats its first frame"
    tracker.put(config.keys.pose(POSE.object, 0), POSE)
    wait_until(lambda: step()[-1].frame_id == 14)
    assert list(dict.fromkeys(h.frame_id for h in seen)) == list(range(3, 15))
    for _ in range(10):
        step()
    assert not ingest.finished, "no subscriber has reported the last frame"
    tracker.health.camera_epoch, tracker.health.frame_id = seen[-1].camera_epoch, 14
    tracker.say_health()
    wait_until(lambda: step() and ingest.finished)
    token.undeclare()
    for bus in (camera, tracker):
        close_bus(bus)


def test_a_scene_whose_folder_name_is_no_utf8_can_be_sent(scene):
    frame = BopScene(scene).frame(3)
    assert packed(frame, 1e-4, (), "caf\udce9").scene == r"caf\udce9"
