"""What the estimator worker reports about frames, the camera and the sizes of objects."""

from types import SimpleNamespace

import numpy as np
import pytest
from msgspec.structs import replace

from huepose.estimation.apparent_size import QUARTERS, SCALES
from huepose.estimation.depth_offset import DepthOffset
from huepose.estimation.types import PoseEstimate
from huepose.geometry import Camera, RgbdFrame
from huepose_protos.examples import example
from huepose_protos.messages import Estimates, Masks, ObjectEntry, Prior
from huepose_services import camera_doubts
from huepose_services import estimator as worker
from huepose_services.camera_doubts import LOOK_EVERY_NS
from huepose_services.estimator import EstimatorWork, make
from huepose_services.following import Change
from huepose_services.runtime.config import CameraConfig, Config, EstimatorConfig
from tests.services.fake_bus import FakeBus, sent

CAMERA = Camera(300.0, 300.0, 79.5, 59.5, 160, 120)


class _Estimator:
    """An estimator that knows a cup and gives fixed answers."""

    objects, diameters_m = ("cup",), (0.12,)
    answers: tuple[PoseEstimate, ...] = ()

    def estimate(self, frame, queries):
        self.asked = queries
        return list(self.answers)

    def middle_obj(self, name):
        return np.zeros(3)

    def add_object(self, model):
        self.objects = (*self.objects, model)

    def remove_object(self, name):
        self.objects = ()

    larger = 0.0  # by what share a cup looks larger
    others = ()  # instances of it that fit

    def sizes_seen(self, frame, answers):
        self.looked = [answer.instance for answer in answers]
        sizes = [0.0 if number in self.others else self.larger for number in self.looked]
        return [np.tile(np.where(np.isclose(SCALES, size), 9.0, 0.0), (1 + QUARTERS, 1)) for size in sizes]


def begun(*answers):
    """A worker with its bus and with an estimator that gives these answers."""
    bus, estimator = FakeBus("estimator"), _Estimator()
    estimator.answers = answers
    return EstimatorWork(bus, estimator, SimpleNamespace(changes=lambda: [])), bus, estimator


def masks(times, *names):
    """Masks of these objects in a frame of a wall 1 m away, whose depth is `times` too large."""
    color = np.random.default_rng(0).integers(20, 220, (120, 160, 3), dtype=np.uint8)
    depth = np.full((120, 160), 1.0 * times, np.float32)
    header, payload = sent(RgbdFrame(color, depth, CAMERA), 0.0002)
    seen = example(Masks).objects[0]
    asked = [replace(seen.detection.request, object=name, prior=None) for name in names]
    objects = [replace(seen, detection=replace(seen.detection, request=one), masks=[]) for one in asked]
    return replace(example(Masks), frame=header, objects=objects), payload


@pytest.mark.parametrize("times", [10.0, 0.05, 20.0])
def test_depth_of_another_unit_is_named_in_answer_health_and_log(times):
    work, bus, _ = begun()
    bus.arriving[Masks] = [masks(times), masks(1.0)]
    work.step()
    (answer,) = bus.said
    assert isinstance(answer, Estimates)
    assert "depth scale" in answer.picture
    assert bus.health.message().warnings == [answer.picture]
    assert [said.warnings for said in bus.healths] == [[answer.picture]], (
        "published at once, not with the next heartbeat"
    )
    assert bus.logged["picture"] == [f"nothing is found: {answer.picture}"]
    work.step()
    assert bus.said[-1].picture == ""
    assert bus.health.message().warnings == []


def test_all_but_tracking_instances_are_checked_for_identity():
    work, bus, estimator = begun(PoseEstimate("cup"), PoseEstimate("cup"))
    message, payload = masks(1.0, "cup", "cup")
    known, new = message.objects
    detection = known.detection
    known = replace(known, detection=replace(detection, request=replace(detection.request, known=True)))
    bus.arriving[Masks] = [(replace(message, objects=[known, new]), payload)]
    work.step()
    assert [query.searched for query in estimator.asked] == [False, True]


def test_a_query_for_a_new_instance_has_the_predicted_poses_of_the_others():
    work, bus, estimator = begun(PoseEstimate("cup"))
    message, payload = masks(1.0, "cup")
    (new,) = message.objects
    other = Prior(
        stamp_ns=message.frame.capture_ns - 100_000_000,
        translation=(0.0, 0.0, 1.0),
        quaternion=(0.0, 0.0, 0.0, 1.0),
        velocity_linear=(1.0, 0.0, 0.0),
        velocity_angular=(0.0, 0.0, 0.0),
    )
    request = replace(new.detection.request, others=[other])
    new = replace(new, detection=replace(new.detection, request=request))
    bus.arriving[Masks] = [(replace(message, objects=[new]), payload)]
    work.step()
    (query,) = estimator.asked
    assert [T[:3, 3].tolist() for T in query.others] == [[pytest.approx(0.1), 0.0, 1.0]]


@pytest.fixture
def warned_after(monkeypatch):
    """A function of seconds: steps a worker after them, and gives the fault of the camera that it
    publishes."""
    (work, bus, estimator), now = begun(), [0]
    monkeypatch.setattr(worker, "now_ns", lambda: now[0])

    def warned(seconds, camera=""):
        now[0] += int(seconds * 1e9)
        message, payload = masks(1.0, *(["cup"] * len(estimator.answers)))
        bus.arriving[Masks] = [(replace(message, camera=camera), payload)]
        work.step()
        said = [text for text in bus.health.message().warnings if "camera.check" in text]
        (text,) = [text for text in said if not text.startswith("cup/")] or [""]
        assert bus.said[-1].camera == (camera or text.partition(" No pose is")[0])
        return bus.said[-1].camera

    def asked(*instances):
        """The reasons in the estimates of these instances, None a new one."""
        message, payload = masks(1.0, *(["cup"] * len(instances)))
        for number, item in enumerate(message.objects):
            request = replace(item.detection.request, instance=instances[number])
            message.objects[number] = replace(item, detection=replace(item.detection, request=request))
        before = estimator.answers
        estimator.answers = tuple(cup("TRACKING", -1 if i is None else i) for i in instances)
        bus.arriving[Masks] = [(message, payload)]
        work.step()
        estimator.answers = before
        return [item.reason for item in bus.said[-1].estimates]

    def list_changes(*changes):
        """The changes of the list of objects that come with the next frame."""
        left = list(changes)
        work._objects.changes = lambda: [left.pop(0) for _ in changes if left]

    warned.estimator, warned.asked, warned.list_changes = estimator, asked, list_changes
    warned.warnings = lambda: bus.health.message().warnings
    return warned


def cup(state, instance=0):
    return PoseEstimate("cup", instance, T_cam_obj=np.eye(4), found=True, state=state)


EVERY_S = LOOK_EVERY_NS * 1e-9


def test_a_wrong_camera_matrix_is_reported_after_some_looks(warned_after):
    warned_after.estimator.answers = (cup("TRACKING"),)
    warned_after.estimator.larger = 0.1
    assert [warned_after(s) for s in (0.0, 0.2)] == [""] * 2
    said = warned_after(0.2)
    assert said.startswith("The image shows objects 10 % larger"), "the first three looks follow each other"
    warned_after.estimator.larger = 0.0
    assert [warned_after(EVERY_S) for _ in range(3)][-1] == ""


def test_a_warning_ends_with_its_cause_also_while_the_detector_doubts_the_colours(warned_after):
    warned_after.estimator.answers = (cup("TRACKING"),)
    warned_after.estimator.larger = 0.1
    assert [warned_after(0.2) for _ in range(3)][-1] != ""
    assert len(warned_after.warnings()) == 1
    warned_after.estimator.larger = 0.0
    assert [warned_after(EVERY_S, "Blue for red.") for _ in range(3)] == ["Blue for red."] * 3
    assert warned_after.warnings() == []


def test_sizes_of_suspect_poses_are_measured_only_if_none_is_tracking(warned_after):
    """Sizes of new instances are not: they may be the background."""
    warned_after.estimator.answers = (cup("SUSPECT", -1),)
    warned_after.estimator.larger = 0.2
    assert [warned_after(EVERY_S) for _ in range(4)] == [""] * 4
    warned_after.estimator.answers = (cup("SUSPECT"),)
    warned_after.estimator.larger = -0.15
    assert "15 % smaller" in [warned_after(EVERY_S) for _ in range(3)][-1]
    warned_after.estimator.answers = (cup("TRACKING"),)
    warned_after.estimator.larger = 0.0
    said = [warned_after(EVERY_S) for _ in range(3)]
    assert "15 % smaller" in said[0], "one sure pose may be wrong itself"
    assert said[-1] == ""


def test_only_the_instance_of_another_size_than_the_others_is_doubted(warned_after):
    """The reason is in its estimate, and in that of a new instance of the same object."""
    estimator = warned_after.estimator
    estimator.answers = tuple(cup("TRACKING", number) for number in range(3))
    estimator.larger, estimator.others = 0.12, (0, 2)
    assert [warned_after(0.3) for _ in range(12)] == [""] * 12
    said = "The image shows it about 12 % larger than its mesh"
    asked = warned_after.asked(0, 1, 2, None)
    assert [reason[: len(said)] for reason in asked] == ["", said, "", said]
    (warning,) = warned_after.warnings()
    assert warning.startswith(f"cup/1: {said}")
    all_three, estimator.answers = estimator.answers, (cup("TRACKING", 0),)
    warned_after(20.0)
    assert warned_after.warnings() == [], "the instance is gone"
    assert warned_after.asked(None) == [""]
    estimator.answers = all_three
    warned_after(0.3)
    assert len(warned_after.warnings()) == 1, "it is known when the instance comes back"
    # A right one takes its place.
    estimator.others = (0, 1, 2)
    for _ in range(40):
        warned_after(0.3)
    assert (warned_after.asked(0, 1, 2, None), warned_after.warnings()) == ([""] * 4, [])


CUP = ObjectEntry(object="cup", max_instances=1, searching=1)


@pytest.mark.parametrize(
    "changes", [[Change(CUP)], [Change(CUP, removed=True)], [Change(CUP, removed=True), Change(CUP, "cup")]]
)
def test_a_doubt_about_an_object_is_forgotten_when_the_object_changes(warned_after, changes):
    """Also a doubt about the camera that came from this object alone; a change of another object keeps it."""
    estimator = warned_after.estimator
    estimator.answers = (cup("TRACKING"),)
    estimator.larger = 0.1
    assert [warned_after(0.2) for _ in range(3)][-1] != ""
    warned_after.list_changes(Change(replace(CUP, object="jar")))
    estimator.answers = ()
    assert warned_after(0.2) != ""
    warned_after.list_changes(*changes)
    assert warned_after(0.2) == ""
    if estimator.objects:
        estimator.answers, estimator.larger = (cup("TRACKING", 1),), 0.0
        assert [warned_after(0.2) for _ in range(3)] == [""] * 3
        assert warned_after.asked(1, None) == ["", ""]


def test_objects_are_looked_at_in_turn_and_later_seldom(warned_after):
    estimator, turns = warned_after.estimator, []
    estimator.answers = tuple(cup("TRACKING", number) for number in range(2))
    for _ in range(6):
        estimator.looked = []
        warned_after(0.5)
        turns += estimator.looked
    assert turns == [0, 1, 0, 1, 0, 1]
    for _ in range(60):
        estimator.looked = []
        warned_after(0.5)
        turns += estimator.looked
    assert 2 * 7 <= len(turns) <= 2 * 10


def test_misaligned_depth_is_reported_at_the_first_look(warned_after, monkeypatch):
    offsets = [DepthOffset(40.0, 0.0, 9.0, 400), None, None]
    monkeypatch.setattr(camera_doubts, "frame_offset", lambda frame: offsets.pop(0))
    warned_after.estimator.answers = (cup("TRACKING"),)
    assert "40.0 px to the right of where depth has them" in warned_after(0.0)
    assert [warned_after(EVERY_S) for _ in range(2)] == [""] * 2  # in one look of two, and of three


def test_with_the_check_off_a_camera_is_not_doubted(monkeypatch):
    bus = FakeBus("estimator")
    monkeypatch.setattr(worker.models, "load", lambda config: {})
    monkeypatch.setattr(worker, "Follower", lambda *_: SimpleNamespace(changes=lambda: []))
    configs = [
        Config(estimator=EstimatorConfig(threads=1), camera=CameraConfig(check=check))
        for check in (True, False)
    ]
    assert [make(bus, config)._doubts is None for config in configs] == [False, True]


def test_a_fault_of_the_camera_from_the_detector_is_passed_on():
    work, bus, _ = begun()
    message, payload = masks(1.0)
    bus.arriving[Masks] = [(replace(message, camera="Blue for red."), payload)]
    work.step()
    assert bus.said[-1].camera == "Blue for red."
