"""The re-initialisation worker says why an object is not found."""

import msgspec
import pytest

from huepose.geometry.image_faults import IF_IN_PLAIN_VIEW
from huepose.reinit import ReinitConfig, ReinitLoop
from huepose.reinit.types import ObjectSlot
from huepose_protos.messages import (
    ControlRequest,
    Estimates,
    HealthMessage,
    PerceptionRequest,
    PoseMessage,
)
from huepose_services.following import reading_text
from huepose_services.reinit import ReinitWork, slow_text
from huepose_services.runtime.clock import SECOND, now_ns

from .conftest import answer, found, health, pose


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


def test_an_answer_to_a_request_from_before_a_reset_gives_no_reason_after_it(bus, objects, step):
    step()
    objects.decide(ControlRequest(publish_ns=1, action="reset", object="mug"))
    bus.arriving[Estimates].append(answer(bus))
    step()
    assert (bus.mug().searching, bus.mug().reason) == (1, "")


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
