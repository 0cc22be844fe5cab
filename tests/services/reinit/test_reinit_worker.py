"""The re-initialisation worker publishes at once what it searches for, and asks again when it must."""

from dataclasses import asdict

import msgspec
import pytest

from huepose.reinit import ReinitConfig, ReinitLoop
from huepose.reinit.types import ObjectSlot
from huepose.support.errors import InputError
from huepose_protos import decode, encode
from huepose_protos.examples import example
from huepose_protos.messages import (
    CameraMessage,
    ControlReply,
    ControlRequest,
    CorrectionMessage,
    Estimates,
    HealthMessage,
    ObjectEntry,
    ObjectsMessage,
    PerceptionRequest,
    PoseMessage,
)
from huepose_services.reinit import ReinitWork, make
from huepose_services.runtime.clock import SECOND, now_ns
from huepose_services.runtime.config import Config, ObjectConfig
from huepose_services.runtime.one_camera import OneCamera
from huepose_services.steering import ObjectList
from tests.services.fake_bus import FakeBus

from .conftest import EPOCH, answer, found, health, pose


def test_that_an_object_is_found_is_published_at_once(bus, step):
    step()
    assert bus.mug().searching == 1
    bus.arriving[PoseMessage].append(pose(0))
    step()
    assert bus.mug().searching == 0


@pytest.mark.parametrize("older_s", [0.1, 1000.0])
def test_an_answer_to_a_loop_that_has_died_is_not_judged_before_its_tracks_are_known(
    bus, objects, step, older_s, monkeypatch
):
    """It is about the second of two mugs, and would be given to the first one."""
    late, before = msgspec.structs.replace(found(), instance=1), FakeBus("reinit")
    with monkeypatch.context() as patch:
        patch.setattr("huepose_services.reinit.now_ns", lambda: now_ns() - round(older_s * SECOND))
        died = ReinitWork(before, ReinitLoop(ReinitConfig(), [ObjectSlot("mug", 1, 0.1)]), objects)
        died.step()
    step()
    bus.arriving[Estimates].append(answer(before, estimates=[late]))
    step()
    assert not any(isinstance(message, CorrectionMessage) for message in bus.said)
    bus.arriving[Estimates].append(answer(bus, estimates=[found()]))
    step()
    assert any(isinstance(message, CorrectionMessage) for message in bus.said)


@pytest.mark.parametrize(("frame_id", "counted"), [(9, "held"), (10, "expired")])
def test_a_request_expires_only_if_the_camera_has_given_another_frame(
    bus, objects, monkeypatch, frame_id, counted
):
    at = [now_ns()]
    monkeypatch.setattr("huepose_services.reinit.now_ns", lambda: at[0])
    loop = ReinitLoop(ReinitConfig(), [ObjectSlot("mug", 1, 0.1)])
    work = ReinitWork(bus, loop, objects)

    def step(after_ns):
        at[0] += after_ns
        work.step()

    bus.arriving[HealthMessage].append(health("camera", camera_epoch=EPOCH, frame_id=frame_id))
    for _ in range(3):  # the object is searched for everywhere by turns
        step(SECOND // 5)
        asked = [m for m in bus.said if isinstance(m, PerceptionRequest)][-1]
        bus.arriving[Estimates].append(answer(bus, request_seq=asked.seq))
    step(SECOND // 5)
    before = asdict(loop.counters)
    step(SECOND)
    assert {k for k, n in asdict(loop.counters).items() if n != before[k]} == {"requests", counted}


@pytest.mark.parametrize(("worker", "requests"), [("segmenter", 2), ("uplink", 2), ("viewer", 1)])
def test_a_request_is_sent_again_when_a_worker_that_it_needs_starts(bus, step, worker, requests):
    step()
    bus.begun.append(worker)
    step()
    assert sum(isinstance(m, PerceptionRequest) for m in bus.said) == requests


def test_a_fault_of_the_camera_is_passed_on_with_every_correction(bus, step):
    step()
    bus.arriving[Estimates].append(answer(bus, estimates=[found()], camera="Too large."))
    step()
    corrections = [m for m in bus.said if isinstance(m, CorrectionMessage)]
    assert {(c.object, c.verdict, c.camera) for c in corrections} == {("mug", "acquire", "Too large.")}


def test_a_doubt_about_an_object_is_passed_on_with_its_correction(bus, step):
    step()
    larger = msgspec.structs.replace(found(), reason="Larger than its mesh.")
    bus.arriving[Estimates].append(answer(bus, estimates=[larger]))
    step()
    (correction,) = [m for m in bus.said if isinstance(m, CorrectionMessage)]
    assert (correction.reason, correction.camera) == ("Larger than its mesh.", "")


def test_an_object_that_is_no_longer_tracked_is_searched_for_while_perception_gets_frames(bus, step):
    """As after a restart of the tracker in a static scene: estimates agree with the last pose, and nothing
    else is published."""
    last = msgspec.structs.replace(pose(0), capture_ns=now_ns() - 3 * SECOND)
    bus.arriving[PoseMessage].append(last)
    step()
    assert bus.mug().searching == 0, "no frame came since, so it may be tracked"
    bus.arriving[Estimates].append(answer(bus, capture_ns=last.capture_ns + SECOND))
    step()
    assert bus.mug().searching == 0, "its pose may be on its way"
    bus.arriving[Estimates].append(answer(bus, capture_ns=now_ns()))
    step()
    assert bus.mug().searching == 1
    bus.arriving[Estimates].append(answer(bus, estimates=[found()]))
    step()
    (correction,) = [m for m in bus.said if isinstance(m, CorrectionMessage)]
    assert (correction.instance, correction.verdict) == (1, "acquire")


def test_a_box_outside_the_cameras_image_is_refused(bus, objects, step):
    camera = example(CameraMessage)
    bus.arriving[CameraMessage].append(camera)
    step()
    width, height = camera.intrinsics.width, camera.intrinsics.height
    reset = ControlRequest(publish_ns=1, action="reset", object="mug", box=(float(width), 0.0, 9.0, 9.0))
    done, text = objects.decide(reset)
    assert (done, f"{width} x {height}" in text) == (False, True)


def test_a_reset_that_comes_within_a_step_is_published_with_the_retired_instances(
    bus, objects, step, monkeypatch
):
    bus.arriving[PoseMessage].append(pose(4))
    step()
    take, resets = objects.orders, [ControlRequest(publish_ns=1, action="reset", object="mug")]

    def orders():
        taken = take()
        if resets:
            assert objects.decide(resets.pop())[0]
        return taken

    monkeypatch.setattr(objects, "orders", orders)
    bus.work._next_objects_ns = 0
    step()
    step()
    published = [message.objects[0] for message in bus.said if isinstance(message, ObjectsMessage)]
    assert {(mug.resets, mug.retired) for mug in published} == {(0, None), (1, (EPOCH, 5))}


@pytest.mark.parametrize("changes", [{"camera_epoch": EPOCH + 1}, {"frame_id": 2**40}])
def test_poses_of_a_camera_whose_timestamps_begin_anew_count_at_once(bus, step, changes):
    """Opened again, or its clock set back, by a minute: its poses are not ignored as older ones."""
    now = now_ns()
    step()
    bus.arriving[PoseMessage] += [pose(0), msgspec.structs.replace(pose(7), object="can")]
    bus.arriving[Estimates].append(answer(bus, capture_ns=now))
    step()
    bus.arriving[PoseMessage].append(
        msgspec.structs.replace(pose(0), capture_ns=now - 60 * SECOND, **changes)
    )
    if "camera_epoch" in changes:
        bus.work._camera = OneCamera()  # the previous camera has been silent
    step()
    assert bus.mug().searching == 0
    assert list(bus.work._tracks) == [("mug", 0)]


def test_answers_about_a_camera_that_was_opened_again_count_despite_repeated_old_poses(
    bus, step, monkeypatch
):
    at = [now_ns()]
    monkeypatch.setattr("huepose_services.reinit.now_ns", lambda: at[0])
    last = pose(0)
    for _ in range(2):
        bus.arriving[PoseMessage].append(last)
        step()
        at[0] += SECOND
    bus.arriving[Estimates].append(answer(bus, capture_ns=at[0], camera_epoch=EPOCH + 1))
    step()
    assert "answers_of_another_camera" not in bus.health.counters
    assert not bus.work._tracks, "the old tracks have ended"


def test_the_largest_list_of_objects_fits_into_its_message(bus):
    """As many objects as it can have, with the largest values of an entry, in the longest characters of
    UTF-8."""
    entries = [
        ObjectEntry(
            object=f"{k:064d}",
            max_instances=64,
            searching=2**63 - 1,
            added=2**63 - 1,
            resets=2**31 - 1,
            retired=(2**63 - 1, 2**31 - 1),
            box=(0.1, 0.2, 0.3, 0.4),
        )
        for k in range(256)
    ]
    work = ReinitWork(bus, ReinitLoop(), ObjectList(entries, ObjectSlot))
    work._camera_fault = "\N{CAMERA}" * 2000
    work.step()
    message = [m for m in bus.said if isinstance(m, ObjectsMessage)][-1]
    assert all(entry.reason.endswith("\N{CAMERA}...") for entry in message.objects)
    assert decode(encode(message), ObjectsMessage) == message
    reply = ControlReply(publish_ns=1, done=False, text="\N{CAMERA}" * 2000, objects=message.objects)
    assert decode(encode(reply), ControlReply) == reply


def test_more_objects_than_a_list_can_have_are_refused(bus, monkeypatch):
    monkeypatch.setattr("huepose_services.reinit.recall", lambda bus: [])
    monkeypatch.setattr("huepose_services.models.load", lambda config: dict.fromkeys(names))
    names = [f"o{k}" for k in range(257)]
    for objects in ([ObjectConfig(name=name) for name in names], []):
        with pytest.raises(InputError, match="found 257 that are searched for; expected 256 or fewer"):
            make(bus, Config(objects=objects))


@pytest.mark.parametrize(
    ("names", "said"),
    [
        (["mug"], []),
        (["jar", "lid"], ["not in the file: mug; only in the file: jar, lid"]),
        (["mug", "lid"], ["only in the file: lid"]),
        ([], []),
    ],
)
def test_a_restarted_worker_says_how_its_objects_differ_from_the_file(bus, monkeypatch, names, said):
    entries = [ObjectEntry(object="mug", max_instances=1, searching=1)]
    published = []
    monkeypatch.setattr("huepose_services.reinit.recall", lambda bus: entries)
    monkeypatch.setattr("huepose_services.reinit._slot", lambda name, count, model: ObjectSlot(name, count))
    monkeypatch.setattr("huepose_services.models.load_one", lambda config, name: None)
    monkeypatch.setattr(bus.log, "say", published.append)
    work = make(bus, Config(objects=[ObjectConfig(name=name) for name in names]))
    assert [entry.object for entry in work._objects.entries()] == ["mug"]
    assert [text.split("; ", 1)[1] for text in published] == [
        f"{one} (huepose objects add, remove)" for one in said
    ]
