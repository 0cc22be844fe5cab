"""The re-initialisation worker publishes at once what it searches for, without reasons of an older search."""

from dataclasses import asdict

import msgspec
import pytest

from huepose.geometry.image_faults import IF_IN_PLAIN_VIEW
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
from huepose_services.following import reading_text
from huepose_services.reinit import ReinitWork, make, slow_text
from huepose_services.runtime.clock import SECOND, now_ns
from huepose_services.runtime.config import Config, ObjectConfig
from huepose_services.runtime.one_camera import OneCamera
from huepose_services.steering import ObjectList
from tests.services.fake_bus import FakeBus

EPOCH = 5


class _Bus(FakeBus):
    def mug(self):
        """The mug's entry in the last published list."""
        return [m for m in self.said if isinstance(m, ObjectsMessage)][-1].objects[0]


@pytest.fixture
def bus():
    return _Bus("reinit")


@pytest.fixture
def objects():
    return ObjectList([ObjectEntry(object="mug", max_instances=1, searching=1)], ObjectSlot)


@pytest.fixture
def step(bus, objects, monkeypatch):
    """Steps the worker, a tick later each time."""
    bus.work = work = ReinitWork(bus, ReinitLoop(ReinitConfig(), [ObjectSlot("mug", 1, 0.1)]), objects)

    def once():
        work._next_tick_ns = 0
        work.step()

    return once


def pose(instance):
    now = now_ns()
    return msgspec.structs.replace(
        example(PoseMessage),
        **{
            "object": "mug",
            "instance": instance,
            "camera_epoch": EPOCH,
            "capture_ns": now,
            "publish_ns": now,
        },
    )


def answer(bus, **changes):
    """Perception's answer to the request of the worker: nothing found, unless changed."""
    request = next(m for m in bus.said if not isinstance(m, ObjectsMessage))
    now = now_ns()
    message = Estimates(
        publish_ns=now, request_seq=request.seq, camera_epoch=EPOCH, frame_id=9, capture_ns=now, estimates=[]
    )
    return msgspec.structs.replace(message, **changes)


def health(worker, **changes):
    return msgspec.structs.replace(example(HealthMessage), worker=worker, **changes)


def found():
    """The estimate of a new mug, TRACKING."""
    return msgspec.structs.replace(
        example(Estimates).estimates[0],
        object="mug",
        instance=None,
        found=True,
        state="TRACKING",
        quality=0.99,
    )


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


def test_a_found_object_that_was_never_tracked_is_reported_as_not_confirmed(bus, objects, step):
    step()
    bus.arriving[Estimates].append(answer(bus, estimates=[found()]))
    step()
    objects.decide(ControlRequest(publish_ns=1, action="add", object="mug", max_instances=2))
    step()
    said = "Something was found, but the tracker has not confirmed it."
    assert (bus.mug().searching, bus.mug().reason) == (2, said)
    bus.arriving[PoseMessage].append(pose(0))
    step()
    assert (bus.mug().searching, bus.mug().reason) == (1, "")


@pytest.mark.parametrize("since", [0, SECOND // 2])
def test_a_second_instance_is_mentioned_only_while_the_first_is_tracked(bus, objects, step, since):
    """since: how long before perception's frame the tracker died."""
    objects.decide(ControlRequest(publish_ns=1, action="add", object="mug", max_instances=2))
    step()
    last = pose(0)
    bus.arriving[PoseMessage].append(last)
    bus.arriving[Estimates].append(answer(bus, capture_ns=last.capture_ns + since))
    step()
    objects.decide(ControlRequest(publish_ns=1, action="add", object="mug", max_instances=3))
    step()
    said = "No place in the image looks like the object." if since else "No second instance is visible."
    assert (bus.mug().searching, bus.mug().reason) == (2, said)


def test_an_object_that_is_no_longer_tracked_has_no_older_reason(bus, objects, step):
    """As after a restart of the tracker, which finds another object first."""
    objects.decide(ControlRequest(publish_ns=1, action="add", object="mug", max_instances=2))
    step()
    last = pose(0)
    bus.arriving[PoseMessage].append(last)
    bus.arriving[Estimates].append(answer(bus, capture_ns=last.capture_ns))
    step()
    objects.decide(ControlRequest(publish_ns=1, action="add", object="mug", max_instances=3))
    step()
    assert (bus.mug().searching, bus.mug().reason) == (2, "No second instance is visible.")
    old = msgspec.structs.replace(pose(0), capture_ns=now_ns() - 3 * SECOND)
    bus.arriving[PoseMessage] += [old, msgspec.structs.replace(pose(0), object="can")]
    step()
    assert (bus.mug().searching, bus.mug().reason) == (3, "")


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


def test_an_answer_to_a_request_from_before_a_reset_gives_no_reason_after_it(bus, objects, step):
    step()
    objects.decide(ControlRequest(publish_ns=1, action="reset", object="mug"))
    bus.arriving[Estimates].append(answer(bus))
    step()
    assert (bus.mug().searching, bus.mug().reason) == (1, "")


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


def test_a_reset_forgets_the_reason_of_the_search_before(bus, objects, step):
    step()
    bus.arriving[Estimates].append(answer(bus))
    step()
    objects.decide(ControlRequest(publish_ns=1, action="add", object="mug", max_instances=2))
    step()
    assert bus.mug().reason == "No place in the image looks like the object."
    objects.decide(ControlRequest(publish_ns=1, action="reset", object="mug"))
    step()
    assert (bus.mug().searching, bus.mug().reason) == (2, "")


@pytest.mark.parametrize(
    ("after_s", "state", "advised"),
    [(12, "", True), (5, "", False), (12, "SUSPECT", True), (12, "TRACKING", False)],
)
def test_if_nothing_was_ever_tracking_the_reason_says_what_to_check(
    bus, objects, monkeypatch, after_s, state, advised
):
    """As with a focal length of twice the right value: nothing is found in good images."""
    at = [now_ns()]
    monkeypatch.setattr("huepose_services.reinit.now_ns", lambda: at[0])
    slots = [ObjectSlot("mug", 2, 0.1)]
    work = ReinitWork(bus, ReinitLoop(ReinitConfig(), slots), objects)
    if state:
        bus.arriving[PoseMessage].append(msgspec.structs.replace(pose(0), object="can", state=state))
    for passed_s in (0, after_s):
        at[0] += passed_s * SECOND
        work.step()
        asked = [m for m in bus.said if isinstance(m, PerceptionRequest)][-1]
        bus.arriving[Estimates].append(answer(bus, request_seq=asked.seq))
        at[0] += SECOND // 5
        work.step()
    at[0] += SECOND
    work.step()
    said = "No place in the image looks like the object."
    assert bus.mug().reason == (f"{said} {IF_IN_PLAIN_VIEW}" if advised else said)


def test_a_fault_of_the_image_is_the_reason_why_nothing_is_found_in_it(bus, objects, step):
    step()
    said = "All depth is 6.4 m away or farther: is the depth scale right?"
    bus.arriving[Estimates].append(answer(bus, picture=said))
    step()
    objects.decide(ControlRequest(publish_ns=1, action="add", object="mug", max_instances=2))
    step()
    assert bus.mug().reason == said


def test_a_fault_that_the_camera_reports_comes_before_one_that_perception_reports(bus, step):
    step()
    said = "cam.py: depth looks like millimetres read as metres"
    bus.arriving[HealthMessage].append(health("camera", picture=said))
    bus.arriving[Estimates].append(answer(bus, picture="The frame has no depth."))
    step()
    assert bus.mug().reason == said
    bus.arriving[HealthMessage].append(health("camera"))
    step()
    assert bus.mug().reason == "The frame has no depth."


def test_that_the_detector_reads_the_model_is_the_reason_of_an_object_that_was_added(bus, step):
    step()
    bus.arriving[HealthMessage].append(health("detector", warnings=[reading_text("mug")]))
    bus.arriving[Estimates].append(answer(bus))
    step()
    bus.work._next_objects_ns = 0
    step()
    assert bus.mug().reason == "The detector is still reading its reference model."
    bus.arriving[HealthMessage] += [health("detector"), health("tracker", warnings=[reading_text("mug")])]
    bus.work._next_objects_ns = 0
    step()
    assert bus.mug().reason == "No place in the image looks like the object."


def test_that_no_image_comes_is_also_the_reason_of_an_object_that_was_found(bus, step):
    bus.arriving[PoseMessage].append(pose(0))
    step()
    assert (bus.mug().searching, bus.mug().reason) == (0, "")
    bus.arriving[HealthMessage].append(health("camera", picture="No image comes."))
    step()
    assert (bus.mug().searching, bus.mug().reason) == (0, "No image comes.")


@pytest.mark.parametrize(
    ("age_s", "took_s", "warns"), [(3.0, 2.9, True), (11.0, 0.1, False), (0.3, 0.2, False)]
)
def test_perception_is_called_slow_only_if_it_took_long_itself(age_s, took_s, warns):
    """Not if a stopped camera leaves it an old image."""
    assert bool(slow_text(age_s, took_s)) == warns


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
