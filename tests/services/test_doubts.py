"""The reasons that are given for objects that are not TRACKING, in frames made for each reason."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from types import SimpleNamespace

import msgspec
import numpy as np
import pytest

from huepose.geometry import Camera, RgbdFrame, se3
from huepose.tracking.types import Doubt
from huepose_protos.examples import example
from huepose_protos.messages import HealthMessage, ObjectEntry, PoseMessage
from huepose_services import doubts as why
from huepose_services.cli.status import as_text
from huepose_services.runtime.running import Pipeline
from huepose_services.watch import View

CAMERA = Camera(600.0, 600.0, 319.5, 239.5, 640, 480)
DIAMETER_M = 0.1
PIPELINE = Pipeline(base_port=17447)
NONE_COMES = "No image comes. cam.py: depth has values that are not finite."
NORMALS = np.random.default_rng(0).normal(size=(500, 3))
NORMALS /= np.linalg.norm(NORMALS, axis=1, keepdims=True)


class Ball:
    """The used parts of a prepared surface: a hollow ball, whose inside also faces the camera."""

    points = np.concatenate([0.5 * DIAMETER_M * NORMALS, 0.45 * DIAMETER_M * NORMALS])
    arrays = SimpleNamespace(points=points, normals=np.concatenate([NORMALS, -NORMALS]))
    diameter_m = DIAMETER_M

    def centre_cam(self, T: np.ndarray) -> np.ndarray:
        return T[:3, 3]

    def shown(self, T: np.ndarray, count: int) -> np.ndarray:
        return np.flatnonzero(NORMALS @ T[:3, :3].T @ T[:3, 3] < 0.0)[:count]


BALL = Ball()


def at(x: float, y: float, z: float) -> np.ndarray:
    return se3.make(np.eye(3), np.array([x, y, z]))


def seen(T: np.ndarray) -> RgbdFrame:
    """The ball in front of a wall 2 m behind it, both brown."""
    rays = np.stack(np.meshgrid(np.arange(640), np.arange(480)), -1).astype(float)
    rays = np.append((rays - (319.5, 239.5)) / 600.0, np.ones((480, 640, 1)), axis=2)
    a, b = (rays**2).sum(-1), rays @ T[:3, 3]
    inside = b**2 - a * (T[:3, 3] @ T[:3, 3] - (0.5 * DIAMETER_M) ** 2)
    depth = np.where(inside > 0.0, (b - np.sqrt(np.maximum(inside, 0.0))) / a, T[2, 3] + 2.0)
    color = np.full((480, 640, 3), (120, 110, 90), np.uint8)
    return RgbdFrame(color, depth.astype(np.float32), CAMERA)


NEAR = at(0.0, 0.0, 0.8)


def without_colour(frame: RgbdFrame) -> RgbdFrame:
    return replace(frame, color=np.repeat(frame.color[..., :1], 3, axis=2))


Change = Callable[[RgbdFrame], RgbdFrame]
CASES: dict[str, tuple[np.ndarray | None, Change]] = {
    why.DISAGREES: (NEAR, lambda frame: frame),
    why.OUTSIDE: (at(0.45, 0.0, 0.8), lambda frame: frame),
    why.TOO_FAR: (at(0.0, 0.0, 6.0), lambda frame: frame),
    why.NO_DEPTH: (NEAR, lambda frame: replace(frame, depth=np.zeros_like(frame.depth))),
    why.COVERED: (NEAR, lambda frame: replace(frame, depth=np.full_like(frame.depth, 0.6))),
    why.CLOSE_IN_FRONT: (at(0.0, 0.0, 0.84), lambda frame: frame),
    why.NOT_THERE: (NEAR, lambda frame: replace(frame, depth=np.full_like(frame.depth, 2.8))),
    why.DARK: (NEAR, lambda frame: replace(frame, color=frame.color // 20)),
    why.NO_COLOUR: (NEAR, without_colour),
    why.NOT_FOUND: (None, lambda frame: frame),
}


@pytest.mark.parametrize("expected", CASES)
def test_each_frame_gives_the_reason_that_it_was_made_for(expected: str) -> None:
    T, change = CASES[expected]
    moved = T is None or expected == why.CLOSE_IN_FRONT
    frame = change(seen(NEAR if moved else T))
    assert why.why_doubted(BALL, frame, T) == expected


@pytest.mark.parametrize(
    ("doubt", "said"),
    [
        (Doubt.TURN, why.TURN),
        (Doubt.IDENTITY, why.UNCONFIRMED),
        (Doubt.ANOTHER, why.ANOTHER),
        (Doubt.LOOSE, why.LOOSE),
        (Doubt.FOUND, why.FOUND),
    ],
)
def test_the_trackers_reason_is_given_if_the_frame_shows_no_other(doubt: Doubt, said: str) -> None:
    frame = seen(NEAR)
    assert why.why_doubted(BALL, frame, NEAR, doubt) == said
    covered = replace(frame, depth=np.full_like(frame.depth, 0.6))
    assert why.why_doubted(BALL, covered, NEAR, doubt) == why.COVERED
    of_turn = why.NO_COLOUR if doubt is Doubt.TURN else said
    assert why.why_doubted(BALL, without_colour(frame), NEAR, doubt) == of_turn


def test_the_light_is_the_reason_only_for_poses_that_disagree_or_are_lost() -> None:
    frame = seen(NEAR)
    covered = replace(frame, depth=np.full_like(frame.depth, 0.6))
    assert why.why_doubted(BALL, frame, NEAR, relit=True) == why.RELIT
    assert why.why_doubted(BALL, frame, None, relit=True) == why.RELIT
    assert why.why_doubted(BALL, frame, NEAR, Doubt.TURN, relit=True) == why.TURN
    assert why.why_doubted(BALL, covered, NEAR, relit=True) == why.COVERED


@pytest.mark.parametrize("behind_m", [0.03, 0.05, 0.5])
def test_an_object_does_not_cover_itself(behind_m: float) -> None:
    """A pose behind the object, which is fully visible: the object itself is in front of the pose. So
    the reason always says that the pose may be wrong."""
    said = why.why_doubted(BALL, seen(NEAR), at(0.0, 0.0, 0.8 + behind_m), Doubt.TURN)
    assert said == (why.CLOSE_IN_FRONT if behind_m < DIAMETER_M else why.COVERED)
    assert "pose is" in said


def test_behind_the_camera_is_outside() -> None:
    frame = seen(NEAR)
    assert why.why_doubted(BALL, frame, at(0.0, 0.0, -1.0)) == why.OUTSIDE


def shown(
    workers: Sequence[HealthMessage] = (),
    objects: Sequence[ObjectEntry] = (),
    poses: Sequence[PoseMessage] = (),
    pipeline: Pipeline = PIPELINE,
) -> str:
    """What `huepose status` shows after these messages."""
    known = {message.worker: message for message in workers}
    placed = {(pose.object, pose.instance): pose for pose in poses}
    return as_text(View(pipeline, True, known, frozenset(), (), list(objects), placed))


def health_of(worker: str, **changes: object) -> HealthMessage:
    quiet = {"picture": "", "warnings": [], "last_error": ""}
    return msgspec.structs.replace(example(HealthMessage), worker=worker, **quiet | changes)


def pose_of(name: str, instance: int = 0, **changes: object) -> PoseMessage:
    """SUSPECT because it is covered, unless changed."""
    doubted = {"state": "SUSPECT", "reason": why.COVERED}
    return msgspec.structs.replace(example(PoseMessage), object=name, instance=instance, **doubted | changes)


def entry(name: str, reason: str = "", searching: int = 1) -> ObjectEntry:
    return ObjectEntry(object=name, max_instances=1, searching=searching, reason=reason)


def test_status_gives_the_reason_below_the_object() -> None:
    said = shown(poses=[pose_of("mug", 2)]).splitlines()
    (line,) = [number for number, text in enumerate(said) if text.startswith("mug/2")]
    assert said[line + 1] == f"  {why.COVERED}"


def test_status_gives_a_fault_of_the_camera_instead_of_its_consequences() -> None:
    poses = [pose_of("mug"), pose_of("jar", state="TRACKING", reason="")]
    text = shown([health_of("camera", picture=NONE_COMES)], poses=poses)
    assert text.count(NONE_COMES) == 1
    assert why.COVERED not in text


def test_status_gives_the_reason_of_the_newest_image_after_a_fault_of_the_camera() -> None:
    pose = pose_of("mug")
    text = shown([health_of("camera", picture=NONE_COMES, publish_ns=pose.capture_ns - 1)], poses=[pose])
    assert why.COVERED in text
    assert NONE_COMES not in text


@pytest.mark.parametrize("before", ["No image comes. ", ""])
def test_status_gives_the_sentence_of_the_camera_once(before: str) -> None:
    """Other workers and objects may repeat it a second late."""
    why_none = "cam.py: no image for 3 s"
    workers = [
        health_of("estimator", warnings=[why_none]),
        health_of("camera", warnings=[why_none], picture=before + why_none),
    ]
    entries = [entry(name, f"{before}cam.py: no image for 2 s") for name in ("jar", "can")]
    text = shown(workers, entries, [pose_of("mug", k, reason=before + why_none) for k in (0, 1)])
    assert text.count("no image for") == 1
    assert f"  camera: {why_none}\n" in text
    assert text.endswith(f"\n  These 4: {before}See the camera above.")
    assert text.count("See the camera above.") == 1


def test_status_refers_to_the_worker_that_gives_the_reason_above() -> None:
    far = "All depth is 6.5 m away or farther: is the depth scale right?"
    text = shown([health_of("camera"), health_of("estimator", warnings=[far])], [entry("mug", far)])
    assert f"  estimator: {far}\n" in text
    assert text.endswith("\n  See the estimator above.")


def test_status_says_of_a_recording_that_is_played_that_no_worker_runs() -> None:
    one = Pipeline(base_port=17447, site="local", camera="cam0", folder="/run", file="pipeline.yaml")
    for pipeline, played in ((one, True), (msgspec.structs.replace(one, workers=("camera",)), False)):
        text = shown([health_of("camera")], pipeline=pipeline)
        assert ("a recording is played: its workers are shown as they were then" in text) == played


def test_status_names_a_found_object_without_a_pose() -> None:
    entries = [entry(name, NONE_COMES, searching=0) for name in ("mug", "jar")]
    said = shown(objects=entries, poses=[pose_of("jar", state="TRACKING", reason="")]).splitlines()
    (line,) = [number for number, text in enumerate(said) if text.startswith("mug")]
    assert "no pose of it arrives now" in said[line]
    assert said[line + 1 :] == [f"  {NONE_COMES}"]


def test_status_gives_a_reason_that_several_objects_share_once() -> None:
    said_of = {"mug": NONE_COMES, "jar": NONE_COMES, "can": "", "cup": "", "tin": NONE_COMES}
    text = shown(objects=[entry(name, reason) for name, reason in said_of.items()])
    said = [line.split()[0] for line in text.splitlines()[3:]]
    assert said == ["mug", "jar", "These", "can", "cup", "tin", "No"]


def test_status_says_that_no_object_is_searched_for_only_if_that_is_known() -> None:
    for heard, said in (([], True), (None, False), ([entry("mug")], False)):
        view = View(PIPELINE, True, {}, frozenset(), (), heard, {})
        assert ("no object is searched for" in as_text(view)) == said


def test_status_does_not_report_a_worker_as_ended_that_may_be_starting() -> None:
    view = View(PIPELINE, True, {}, frozenset(), ("estimator",), [], {})
    (line,) = [text for text in as_text(view).splitlines() if text.startswith("estimator")]
    assert "starting, stopping or ended" in line


def test_a_narrow_terminal_shows_the_most_important_columns() -> None:
    busy = health_of("tracker", state="ready", errors=3, restarts=2)
    view = View(PIPELINE, True, {"tracker": busy}, frozenset(), (), [], {})
    wide, narrow = as_text(view).splitlines()[1:3], as_text(view, 60).splitlines()[1:3]
    assert "locked" in wide[0]
    assert all(len(line) <= 60 for line in narrow)
    assert narrow[0].split() == ["worker", "state", "rate", "CPU", "drops", "errors", "restarts"]
    assert narrow[1].split()[:2] == ["tracker", "ready"]
    assert narrow[1].split()[-2:] == ["3", "2"]
