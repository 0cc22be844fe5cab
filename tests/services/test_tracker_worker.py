"""What the tracker worker lets out: no old pose to act on, nothing that is no pose, nothing that is over."""

import time
from dataclasses import replace
from types import SimpleNamespace

import msgspec
import numpy as np
import pytest

from huepose import tracking
from huepose.geometry import se3
from huepose.judge.terms import NOTHING
from huepose.onboarding.onboard import onboard_mesh
from huepose.tracking.hypothesis import Hypothesis
from huepose.tracking.types import Applied, State, TrackedPose
from huepose_protos import decode, encode
from huepose_protos.buffers import pack
from huepose_protos.examples import images, messages
from huepose_protos.messages import CorrectionMessage, FrameHeader, MaskRuns, ObjectEntry, PoseMessage
from huepose_services.camera.publish import packed
from huepose_services.convert import frame_from_wire
from huepose_services.doubts import DISAGREES, RELIT, TOO_OLD
from huepose_services.following import Change
from huepose_services.runtime.clock import SECOND, now_ns
from huepose_services.runtime.config import CameraConfig, Config, TrackerConfig
from huepose_services.runtime.health import Health
from huepose_services.runtime.log import Log
from huepose_services.tracker import TrackerWork
from tests.conftest import standing_pose
from tests.onboarding import solids

HEADER = next(m for m in messages() if isinstance(m, FrameHeader))
CORRECTION = next(m for m in messages() if isinstance(m, CorrectionMessage))
MS = 1_000_000
WARM = (1.15, 1.0, 0.6)


class _Tracker:
    """Says of every frame that one object is tracked at the given pose."""

    instances: tuple[tuple[str, int], ...] = ()
    config = tracking.TrackerConfig()
    reach_s = 4.0

    def __init__(self, T_cam_obj):
        self.T_cam_obj, self.corrections = T_cam_obj, []
        self.answer = Applied.APPLIED

    def step(self, frame):
        return [
            TrackedPose(
                *("mug", 0, frame.epoch, frame.frame_id, frame.stamp_ns, State.TRACKING),
                *(self.T_cam_obj, None, 0.99, np.eye(6) * 1e-6, 0),
            )
        ]

    def poses(self):
        return []

    def surface(self, name):
        return SimpleNamespace(diameter_m=0.12)

    def doubt(self, name, instance):
        return None

    def hypotheses(self, name, instance):
        turned = se3.make(se3.rotation_exp(np.array([0.0, 0.0, 1.0])), self.T_cam_obj[:3, 3])
        opinion = Hypothesis(self.T_cam_obj, NOTHING, np.eye(6), "flow", log_odds=np.log(3.0))
        return opinion, Hypothesis(turned, NOTHING, np.eye(6), "turn", log_odds=0.0)

    def correct(self, correction):
        self.corrections.append(correction.instance)
        return self.answer


class _Loser(_Tracker):
    """Says of every frame that the object is not seen."""

    def step(self, frame):
        return [
            replace(pose, state=State.LOST, T_cam_obj=None, covariance=None) for pose in super().step(frame)
        ]


class _Bus:
    """The bus as far as the work sees it: what is to be taken, and what was put, as bytes."""

    def __init__(self):
        self.health, self.log = Health("tracker"), Log("tracker")
        self.inbox = self.keys = self
        self.frame, self.correction = "frame", "correction"
        self.intake, self.hypotheses = "intake", "hypotheses"
        self.waiting = {"frame": [], "correction": []}
        self.out = []
        self.heard, self.aside = set(), {}
        self.skipped = 0

    def ring(self, key):
        self.place = key
        return self

    queue = ring

    def frames(self):
        return self

    def is_heard(self, key):
        return key in self.heard

    def put_aside(self, key, message):
        self.aside[key] = decode(encode(message), type(message))

    def pose(self, name, instance):
        return f"pose/{name}/{instance}"

    def take(self, place, kind):
        return self.waiting["correction"].pop(0) if self.waiting["correction"] else None

    def take_with_payload(self, place, kind):
        return self.waiting["frame"].pop(0) if self.waiting["frame"] else None

    def refuse(self, key, error):
        self.health.count("wire_errors")

    def put(self, key, message):
        self.out.append(decode(encode(message), PoseMessage))


class _Objects:
    def __init__(self):
        self.next = []

    def changes(self):
        out, self.next = self.next, []
        return out


def _worker(T_cam_obj, once=False, clock=now_ns):
    config = Config(tracker=TrackerConfig(max_age_ms=300.0), camera=CameraConfig(once=once))
    bus, objects = _Bus(), _Objects()
    return TrackerWork(bus, _Tracker(T_cam_obj), objects, config, clock), bus, objects


def _frame(number, age_ms):
    specs, payload = pack(images())
    capture_ns = now_ns() - round(age_ms * MS)
    return msgspec.structs.replace(HEADER, frame_id=number, capture_ns=capture_ns, buffers=specs), payload


def test_hypotheses_are_said_while_somebody_listens():
    work, bus, _ = _worker(se3.make(np.eye(3), np.array([0.0, 0.0, 0.5])))
    work._tracker.instances = (("mug", 0),)
    bus.waiting["frame"] = [_frame(1, 0.0), _frame(2, 0.0)]
    work.step()
    assert bus.aside == {}
    bus.heard.add("hypotheses")
    work.step()
    said = bus.aside["hypotheses"]
    assert said.frame_id == 2
    (mug,) = said.objects
    assert [(h.share, h.source) for h in mug.hypotheses] == [
        (pytest.approx(0.75), "flow"),
        (pytest.approx(0.25), "turn"),
    ]
    assert mug.hypotheses[1].quaternion == pytest.approx((0.0, 0.0, np.sin(0.5), np.cos(0.5)))


@pytest.mark.parametrize(("age_ms", "state"), [(0.0, "TRACKING"), (400.0, "SUSPECT")])
def test_an_old_pose_is_never_one_to_act_on(age_ms, state):
    work, bus, _ = _worker(se3.make(np.eye(3), np.array([0.0, 0.0, 0.5])))
    bus.waiting["frame"] = [_frame(1, 0.0), _frame(2, age_ms)]
    work.step()
    work.step()
    assert [p.state for p in bus.out] == ["TRACKING", state]
    assert [p.reason for p in bus.out] == ["", "" if state == "TRACKING" else TOO_OLD]
    assert bus.health.counters.get("poses_too_old", 0) == (state == "SUSPECT")


def test_the_first_frame_of_a_recording_stands_and_does_not_get_old():
    work, bus, _ = _worker(se3.make(np.eye(3), np.array([0.0, 0.0, 0.5])), once=True)
    bus.waiting["frame"] = [_frame(1, 2000.0), _frame(2, 400.0)]
    work.step()
    work.step()
    assert [p.state for p in bus.out] == ["TRACKING", "SUSPECT"]


@pytest.mark.parametrize(
    ("scale", "y"), [((1, 1, 1), np.nan), ((1, 1, 1), np.inf), ((1, 1, -1), 0.0), ((1.01, 1, 1), 0.0)]
)
def test_what_is_no_pose_is_not_published(scale, y, capfd):
    T_cam_obj = se3.make(np.diag(scale), np.array([0.0, y, 0.5]))
    work, bus, _ = _worker(T_cam_obj)
    bus.waiting["frame"] = [_frame(1, 0.0)]
    work.step()
    assert bus.out == []
    assert bus.health.counters["poses_refused"] == 1
    assert "pose of mug/0" in capfd.readouterr().err


def test_a_correction_of_an_instance_that_is_over_is_not_applied():
    work, bus, objects = _worker(np.eye(4))
    name, epoch = CORRECTION.object, CORRECTION.camera_epoch
    entry = ObjectEntry(object=name, max_instances=1, searching=1, resets=1, retired=(epoch, 4))
    objects.next = [Change(entry)]
    bus.waiting["correction"] = [msgspec.structs.replace(CORRECTION, instance=i) for i in (3, 4)]
    work.step()
    assert work._tracker.corrections == [4]
    assert bus.health.counters["corrections_of_retired"] == 1


def test_who_answers_too_late_is_told_what_to_do_until_it_is_in_time(capfd):
    work, bus, _ = _worker(se3.make(np.eye(3), np.array([0.0, 0.0, 0.5])))
    header, payload = _frame(1, 0.0)
    bus.waiting["frame"] = [(header, payload)]
    work.step()
    late = msgspec.structs.replace(
        CORRECTION, object="mug", instance=0, verdict="correct", capture_ns=header.capture_ns - 8_000 * MS
    )
    work._tracker.answer = Applied.REFUSED_OLD
    bus.waiting["correction"] = [late, late]
    work.step()
    (warning,) = bus.health.message().warnings
    assert "answers 8.0 s after" in warning
    assert "kept for 4.0 s" in warning
    # 1.3 times 8 s are to be reached: 6.4 s more than 4 s, two frames for each 4/15 s.
    assert "tracker.older_frames to 72" in warning
    said = "found another pose of mug/0 in a picture 8.0 s old; it is not taken over: perception answers"
    assert capfd.readouterr().err.count(said) == 1
    work._tracker.answer = Applied.CATCHING_UP
    bus.waiting["correction"] = [msgspec.structs.replace(late, seq=late.seq + 1)]
    work.step()
    assert bus.health.message().warnings == []
    work._tracker.answer, work._tracker.reach_s = Applied.REFUSED_OLD, None
    bus.waiting["correction"] = [msgspec.structs.replace(late, seq=late.seq + 2)]
    work.step()
    assert bus.health.message().warnings == [], "a tracker that has just begun remembers little"


@pytest.mark.parametrize(
    ("answer", "verdict", "reach_s", "said"),
    [
        (
            Applied.REFUSED_EPOCH,
            "acquire",
            4.0,
            "found mug/0 in a picture 0.3 s old; it is not taken over: the camera was opened anew since",
        ),
        (
            Applied.REFUSED_OLD,
            "agree",
            4.0,
            "mug/0 is where it is followed in a picture 0.3 s old; it is not taken over: it is not followed",
        ),
        (Applied.REFUSED_OLD, "correct", None, "not taken over: that was before the tracker began"),
    ],
)
def test_the_log_says_what_was_refused_and_why(capfd, answer, verdict, reach_s, said):
    """And only what comes too late makes perception slow."""
    work, bus, _ = _worker(se3.make(np.eye(3), np.array([0.0, 0.0, 0.5])))
    header, payload = _frame(1, 0.0)
    bus.waiting["frame"] = [(header, payload)]
    work.step()
    work._tracker.answer, work._tracker.reach_s = answer, reach_s
    bus.waiting["correction"] = [
        msgspec.structs.replace(
            CORRECTION, object="mug", instance=0, verdict=verdict, capture_ns=header.capture_ns - 300 * MS
        )
    ]
    work.step()
    assert said in capfd.readouterr().err
    assert bus.health.message().warnings == []


@pytest.fixture(scope="module")
def part():
    """Mesh and reference model of a box of one colour."""
    mesh = solids.box((0.09, 0.06, 0.15))
    mesh = replace(mesh, texture=np.full_like(mesh.texture, (200, 110, 40)))
    return mesh, onboard_mesh(mesh, "part")


@pytest.fixture
def light_changes(part, take_picture):
    """Headers and payloads of a part that moves slowly, from a warm light to a neutral one in the sixth; or
    instead of the light, the part is another thing from then on that looks as it would in the neutral one."""

    def shown(relit):
        mesh, rng, begun_ns = part[0], np.random.default_rng(0), now_ns()
        other = replace(mesh, texture=(mesh.texture / WARM).clip(0, 255).astype(np.uint8))
        for k in range(10):
            before = k < 5
            thing = (mesh if before or relit else other, standing_pose(0.6, 0.001 * k, 0.0))
            seen = take_picture([thing], WARM if before or not relit else (1.0, 1.0, 1.0))
            noisy = (seen.color + rng.normal(0.0, 2.0, seen.color.shape)).clip(0, 255).astype(np.uint8)
            picture = packed(replace(seen, color=noisy), 1e-4)
            fields = {"buffers": picture.buffers, "intrinsics": picture.intrinsics}
            stamp_ns = begun_ns + k * 33 * MS
            header = msgspec.structs.replace(HEADER, frame_id=k, capture_ns=stamp_ns, **fields)
            yield header, picture.payload

    return shown


@pytest.mark.parametrize("relit", [True, False])
def test_what_falls_when_the_light_changes_says_so_until_it_is_sure_again(part, light_changes, relit):
    frames = {(h.camera_epoch, h.frame_id): (h, payload) for h, payload in light_changes(relit)}
    decoded = {number: (h, frame_from_wire(h, payload)) for number, (h, payload) in frames.items()}
    at = []

    def begun():
        work = TrackerWork(
            _Bus(), tracking.Tracker({"part": part[1]}), _Objects(), Config(), lambda: at[-1].capture_ns
        )
        return work, work._bus

    work, bus = begun()
    first = tracking.Correction.first("part", standing_pose(0.6, 0.0, 0.0), next(iter(decoded.values()))[1])
    work._tracker.correct(first)
    for header, payload in frames.values():
        at.append(header)
        if header.frame_id == 8:  # another worker takes over
            memory, out = work.memory(), bus.out
            work, bus = begun()
            work.take_over(memory, lambda *key: decoded.get(key))
            bus.out = out
        bus.waiting["frame"] = [(header, payload)]
        work.step()
    assert [p.state for p in bus.out[:5]] == ["TRACKING"] * 5
    doubted = [p.reason for p in bus.out[5:] if p.state != "TRACKING"]
    assert len(doubted) == 5
    assert set(doubted) == {RELIT if relit else DISAGREES}


def test_a_change_of_state_is_in_the_log_once(capfd):
    work, bus, _ = _worker(se3.make(np.eye(3), np.array([0.0, 0.0, 0.5])))
    until = time.monotonic() + 0.4
    number = 0
    while time.monotonic() < until:
        number += 1
        bus.waiting["frame"] = [_frame(number, 0.0)]
        work.step()
        time.sleep(0.01)
    assert capfd.readouterr().err.count("mug/0 TRACKING") == 1


def test_no_correction_of_the_far_future_is_taken():
    """Its number would be above those of all that come after it."""
    work, bus, _ = _worker(np.eye(4))
    now = now_ns()
    bus.waiting["correction"] = [
        msgspec.structs.replace(CORRECTION, seq=2**63 - 1, instance=1),
        msgspec.structs.replace(CORRECTION, seq=now, instance=2),
    ]
    work.step()
    assert work._tracker.corrections == [2]
    assert bus.health.counters["wire_errors"] == 1


def test_a_correction_with_a_mask_of_another_size_than_the_frame_is_refused():
    work, bus, _ = _worker(se3.make(np.eye(3), np.array([0.0, 0.0, 0.5])))
    bus.waiting["frame"] = [_frame(1, 0.0)]
    work.step()
    large = MaskRuns(width=4096, height=3200, runs=[4096 * 3200])
    same = msgspec.structs.replace(CORRECTION, camera_epoch=HEADER.camera_epoch)
    bus.waiting["correction"] = [msgspec.structs.replace(same, mask=large), same]
    work.step()
    assert len(work._tracker.corrections) == 1
    assert bus.health.counters["wire_errors"] == 1


def test_without_a_new_frame_nothing_stays_to_be_acted_on():
    work, bus, _ = _worker(se3.make(np.eye(3), np.array([0.0, 0.0, 0.5])))
    assert work.due_ns() is None
    bus.waiting["frame"] = [_frame(1, 0.0)]
    work.step()
    due_ns = work.due_ns()
    assert due_ns is not None
    assert 0 < due_ns - now_ns() <= 300 * MS
    work.step()
    assert [p.state for p in bus.out] == ["TRACKING"], "not before its time"
    time.sleep((due_ns - now_ns()) * 1e-9 + 0.001)
    work.step()
    work.step()
    assert [p.state for p in bus.out] == ["TRACKING", "SUSPECT"]
    assert bus.out[1].frame_id == bus.out[0].frame_id
    assert SECOND // 2 < work.due_ns() - now_ns() <= SECOND
    bus.waiting["frame"] = [_frame(2, 0.0)]
    work.step()
    assert bus.out[-1].state == "TRACKING"


def test_who_comes_after_the_camera_stopped_hears_once_a_second_that_it_has():
    at = [now_ns()]
    work, bus, objects = _worker(se3.make(np.eye(3), np.array([0.0, 0.0, 0.5])), clock=lambda: at[0])
    bus.waiting["frame"] = [_frame(1, 0.0)]
    work.step()
    for _ in range(50):  # five seconds
        at[0] += SECOND // 10
        work.step()
    said = bus.out[1:]
    assert [p.publish_ns - said[0].publish_ns for p in said] == [k * SECOND for k in range(5)]
    assert {(p.state, p.frame_id, p.reason) for p in said} == {("SUSPECT", 1, "No new frame came.")}
    assert bus.health.counters["poses_too_old"] == 1
    objects.next = [Change(ObjectEntry(object="mug", max_instances=1, searching=1), removed=True)]
    work._tracker.remove_object = lambda name: None
    at[0] += 2 * SECOND
    work.step()
    assert bus.out[1:] == said, "nothing is said of an object that is gone"
    assert work.due_ns() is None


def test_the_first_frame_of_a_recording_stands_for_as_long_as_it_takes():
    work, bus, _ = _worker(se3.make(np.eye(3), np.array([0.0, 0.0, 0.5])), once=True)
    bus.waiting["frame"] = [_frame(1, 2000.0)]
    work.step()
    assert bus.out[0].state == "TRACKING"
    assert work.due_ns() is None


def test_a_pose_of_the_future_is_not_one_to_act_on():
    work, bus, _ = _worker(se3.make(np.eye(3), np.array([0.0, 0.0, 0.5])))
    bus.waiting["frame"] = [_frame(1, -400.0)]
    work.step()
    assert [p.state for p in bus.out] == ["SUSPECT"]


def _other(number, color=0, depth=0, **intrinsics):
    """A frame with other pixels or intrinsics."""
    header, _ = _frame(number, 0.0)
    pictures = images()
    pictures["color"] = pictures["color"] + np.uint8(color)
    pictures["depth"] = np.where(depth < 0, 0, pictures["depth"] + np.uint16(max(depth, 0))).astype(np.uint16)
    specs, payload = pack(pictures)
    changed = msgspec.structs.replace(header.intrinsics, **intrinsics)
    return msgspec.structs.replace(header, buffers=specs, intrinsics=changed), payload


@pytest.mark.parametrize(
    ("bad", "reason"),
    [
        ({"color": 1, "depth": -1}, "no depth in the whole picture"),
        ({"depth": 1}, "colour picture stands still"),
        ({"color": 1, "depth": 1, "cx": 33.0}, "intrinsics changed"),
    ],
)
def test_a_frame_that_is_wrong_as_such_gives_no_pose_to_act_on_and_health_says_why(bad, reason):
    work, bus, _ = _worker(se3.make(np.eye(3), np.array([0.0, 0.0, 0.5])))
    bus.waiting["frame"] = [_other(1), _other(2, **bad)]
    work.step()
    assert bus.health.message().warnings == []
    work.step()
    assert [p.state for p in bus.out] == ["TRACKING", "SUSPECT"]
    (warning,) = bus.health.message().warnings
    assert reason in warning
    intrinsics = {"cx": bad["cx"]} if "cx" in bad else {}
    bus.waiting["frame"] = [_other(3, color=2, depth=2, **intrinsics)]
    work.step()
    assert bus.out[-1].state == "TRACKING"
    assert bus.health.message().warnings == []


def test_a_camera_that_states_another_focal_length_is_doubted_until_it_states_the_first_again():
    """Also in a new epoch, and for what perception adds between two frames: through the wrong lens a pose may
    fit and be elsewhere."""
    work, bus, _ = _worker(se3.make(np.eye(3), np.array([0.0, 0.0, 0.5])))
    header, payload = _other(1)
    fx = header.intrinsics.fx
    bus.waiting["frame"] = [(header, payload), _other(2, 1, 1, fx=1.5 * fx), _other(3, 2, 2, fx=1.5 * fx)]
    for _ in range(3):
        work.step()
    header, payload = _other(4, 3, 3, fx=1.5 * fx)
    bus.waiting["frame"] = [(msgspec.structs.replace(header, camera_epoch=header.camera_epoch + 1), payload)]
    work.step()
    work._publish_all(work._tracker.poses(), header, None)
    focused, back = _other(5, 4, 4, fx=1.04 * fx), _other(6, 5, 5, fx=1.04 * fx)
    bus.waiting["frame"] = [focused, back]
    for _ in range(2):
        work.step()
    states = [p.state for p in bus.out]
    assert set(states[1:-2]) == {"SUSPECT"}
    assert (states[0], *states[-2:]) == ("TRACKING",) * 3
    assert any("restart the tracker" in p.reason for p in bus.out)


def test_no_pose_is_tracking_while_perception_speaks_against_the_camera():
    """Until it says otherwise, or the camera is opened anew."""
    work, bus, _ = _worker(se3.make(np.eye(3), np.array([0.0, 0.0, 0.5])))
    epoch, seq = _other(1)[0].camera_epoch, iter(range(1, 9))

    def after(frame, camera=None, epoch=epoch):
        if camera is not None:
            bus.waiting["correction"] = [
                msgspec.structs.replace(
                    CORRECTION, camera_epoch=epoch, camera=camera, seq=CORRECTION.seq + next(seq), mask=None
                )
            ]
        header, payload = _other(frame, frame, frame)
        bus.waiting["frame"] = [(msgspec.structs.replace(header, camera_epoch=epoch), payload)]
        work.step()
        return bus.out[-1].state, bus.out[-1].reason

    said = "The picture shows objects 10 % larger."
    assert after(1)[0] == "TRACKING"
    assert [after(2, said), after(3), after(4, said)] == [("SUSPECT", said)] * 3
    assert after(5, "")[0] == "TRACKING"
    assert [after(6, said)[0], after(7, epoch=epoch + 1)[0]] == ["SUSPECT", "TRACKING"]


def test_no_pose_is_tracking_while_a_frame_says_that_its_camera_has_stopped():
    work, bus, _ = _worker(se3.make(np.eye(3), np.array([0.0, 0.0, 0.5])))
    said = "cam.py: its picture stands still"
    for number, camera in enumerate(["", said, said, ""]):
        header, payload = _other(number + 1, number // 3, number // 3)
        bus.waiting["frame"] = [(msgspec.structs.replace(header, camera=camera), payload)]
        work.step()
    assert [(p.state, p.reason) for p in bus.out] == [
        ("TRACKING", ""),
        ("SUSPECT", said),
        ("SUSPECT", said),
        ("TRACKING", ""),
    ]


def test_what_the_camera_knows_of_a_picture_is_the_reason_and_no_doubt_of_a_pose_that_is_sure():
    work, bus, _ = _worker(se3.make(np.eye(3), np.array([0.0, 0.0, 0.5])))
    said = "cam.py: depth looks like millimetres"
    # The second has no depth at all, which the tracker sees itself.
    for header, payload in (_other(1), _other(2, 1, -1), _other(3, 2, 2)):
        bus.waiting["frame"] = [(msgspec.structs.replace(header, picture=said), payload)]
        work.step()
    assert [(p.state, p.reason) for p in bus.out] == [("TRACKING", ""), ("SUSPECT", said), ("TRACKING", "")]


def test_what_was_tracked_before_the_camera_was_opened_anew_is_not_to_be_acted_on():
    work, bus, _ = _worker(se3.make(np.eye(3), np.array([0.0, 0.0, 0.5])))
    bus.waiting["frame"] = [_frame(1, 0.0)]
    work.step()
    header, payload = _frame(2, 0.0)
    work._tracker.step = lambda frame: []
    bus.waiting["frame"] = [(msgspec.structs.replace(header, camera_epoch=header.camera_epoch + 1), payload)]
    work.step()
    assert [(p.state, p.camera_epoch) for p in bus.out] == [
        ("TRACKING", header.camera_epoch),
        ("SUSPECT", header.camera_epoch),
    ]


@pytest.mark.parametrize(
    ("times", "reason"),
    [(1, "It is not seen where it was"), (1000, "away or farther"), (0.005, "nearer than 0.0")],
)
def test_where_all_is_lost_and_depth_may_be_of_another_unit_that_is_the_reason(times, reason):
    work, bus, _ = _worker(None)
    work._tracker = _Loser(None)
    bus.waiting["frame"] = [_at(1.0 * times)]
    work.step()
    (pose,) = bus.out
    assert pose.state == "LOST"
    assert reason in pose.reason
    assert ("depth scale" in pose.reason) == (times != 1)


def _at(distance_m):
    """A frame all of which is so far away, in colour."""
    header, _ = _frame(1, 0.0)
    pictures = images()
    pictures["color"] = np.random.default_rng(0).integers(40, 200, pictures["color"].shape, np.uint8)
    pictures["depth"] = np.full_like(pictures["depth"], 1000)
    specs, payload = pack(pictures)
    wide = msgspec.structs.replace(header.intrinsics, fx=6.0, fy=6.0, depth_scale_m=distance_m / 1000.0)
    return msgspec.structs.replace(header, buffers=specs, intrinsics=wide), payload
