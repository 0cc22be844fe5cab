"""Published poses are scored against the scene that was played."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from huepose.evaluation.poses_protocol import evaluate_poses, first_pass, read_messages
from huepose.evaluation.targets import Targets
from huepose.geometry import se3
from huepose.support.errors import InputError

from .conftest import MemoryScene, PartlyLabelled, pose_at, truth


def motion(i: int) -> np.ndarray:
    return pose_at(0.005 * i)


SCENE = MemoryScene("000001", {i: (truth(0, 5, motion(i)),) for i in range(10)})


def message(i: int, T: np.ndarray | None, state: str = "TRACKING", **changes: object) -> dict:
    """A message in the wire format. Frame i is captured at second 50 + i / 30 and published 20 ms later."""
    capture = 50_000_000_000 + round(i * 1e9 / 30)
    return {
        "object": "box", "instance": 3, "camera_epoch": 77, "frame_id": i, "capture_ns": capture,
        "publish_ns": capture + 20_000_000, "frame": "camera", "clock_id": "boot", "realtime_offset_ns": 0,
        "translation": None if T is None else T[:3, 3].tolist(),
        "quaternion": None if T is None else se3.quaternion_from_rotation(T[:3, :3]).tolist(),
        "velocity_linear": None, "velocity_angular": None, "state": state, "quality": 0.9, "covariance": None,
        "applied_correction_seq": 0, "version": 1, **changes,
    }  # fmt: skip


def written(tmp_path: Path, *messages: dict) -> Path:
    path = tmp_path / "poses.jsonl"
    path.write_text("".join(json.dumps(m) + "\n" for m in messages))
    return path


def test_a_run_is_scored_by_frame_number(models, tmp_path: Path) -> None:
    messages = [message(0, None, "SEARCHING"), message(1, motion(1), "SUSPECT")]
    messages += [message(i, motion(i)) for i in (2, 3, 5, 6, 7)]  # 4, 8 and 9 were skipped
    messages += [{"worker": "tracker", "state": "ok"}]
    result = evaluate_poses(read_messages(written(tmp_path, *messages)), SCENE, Targets(models))
    summary = result.summary()
    assert len(result.rows) == 10
    assert [r.track for r in result.rows] == [3, 3, 3, 3, None, 3, 3, 3, None, None]
    assert summary["poses_for_frames"] == pytest.approx(60.0)
    assert summary["recall_add"] == pytest.approx(60.0)
    assert summary["acquired_after_s"] == pytest.approx(1 / 30)
    assert summary["confirmed_after_s"] == pytest.approx(2 / 30)
    assert summary["coverage_tracking"] == pytest.approx(100 * 5 / 8)
    assert summary["latency_ms_p50"] == pytest.approx(20.0)
    assert summary["fps"] == pytest.approx(6 / 7 * 30)  # one of eight frames is missing
    assert summary["frames"] == 10


def test_the_published_velocity_is_scored(models, tmp_path: Path) -> None:
    """The object moves by 5 mm in a thirtieth of a second; 10 cm/s and 0.1 rad/s are published."""
    said = {"velocity_linear": [0.1, 0.0, 0.0], "velocity_angular": [0.0, 0.1, 0.0]}
    messages = [message(i, motion(i), **said) for i in range(10)]
    summary = evaluate_poses(read_messages(written(tmp_path, *messages)), SCENE, Targets(models)).summary()
    assert summary["rmse_cm_s"] == pytest.approx(5.0, rel=1e-3)
    assert summary["rmse_deg_s"] == pytest.approx(np.degrees(0.1), rel=1e-3)


def test_an_image_without_labels_has_no_row(models, tmp_path: Path) -> None:
    sparse = PartlyLabelled("s", {i: SCENE.labels[i] if i in (0, 9) else () for i in SCENE.image_ids})
    messages = read_messages(written(tmp_path, *(message(i, motion(i)) for i in range(10))))
    result = evaluate_poses(messages, sparse, Targets(models))
    assert [row.frame for row in result.rows] == [0, 9]
    assert result.summary()["false_tracking_frames"] == 0


def test_only_the_first_pass_counts(models, tmp_path: Path) -> None:
    wrong = pose_at(0.5)
    first = [message(i, motion(i)) for i in range(10)]
    numbered_on = [message(10 + i, wrong) for i in range(10)]
    again = [message(i, wrong, capture_ns=message(20 + i, wrong)["capture_ns"]) for i in range(10)]
    reopened = [message(30 + i, motion(i), camera_epoch=78, frame_id=i) for i in range(10)]
    messages = read_messages(written(tmp_path, *reversed(first), *numbered_on, *again, *reopened))
    kept = first_pass(messages, SCENE.image_ids)
    assert sorted(m.frame_id for m in kept) == list(range(10))
    summary = evaluate_poses(messages, SCENE, Targets(models)).summary()
    assert summary["recall_add"] == 100.0
    assert (summary["messages_of_first_pass"], summary["messages"]) == (10, 40)


def test_a_first_pass_with_gaps_is_not_filled_from_the_second(tmp_path: Path) -> None:
    first = [message(i, motion(i)) for i in (0, 1, 8, 9)]
    again = [message(i, motion(i), capture_ns=message(20 + i, None)["capture_ns"]) for i in range(10)]
    messages = read_messages(written(tmp_path, *first, *again))
    assert len(first_pass(messages, SCENE.image_ids)) == 4


def test_poses_of_unknown_objects_are_ignored_and_phantoms_are_false(models, tmp_path: Path) -> None:
    messages = []
    for i in range(10):
        messages += [
            message(i, motion(i)),
            message(i, motion(i), object="mug"),
            message(i, pose_at(-0.2), instance=9),
        ]
    summary = evaluate_poses(read_messages(written(tmp_path, *messages)), SCENE, Targets(models)).summary()
    assert summary["false_tracking_frames"] == 10
    assert summary["recall_add"] == 100.0


def test_a_truncated_last_line_is_ignored(tmp_path: Path) -> None:
    path = written(tmp_path, message(0, motion(0)))
    path.write_text(path.read_text() + '{"object": "bo')
    assert len(read_messages(path)) == 1


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("", "no pose message"),
        ("nonsense\n{}\n", "line 1"),
        (json.dumps(message(0, None, "FINE")), "line 1.*FINE"),
        (json.dumps({**message(0, motion(0)), "quaternion": [0, 0, 0, 2]}), "quaternion"),
        (json.dumps({**message(0, motion(0)), "translation": [0, 0]}), "translation"),
        (json.dumps({k: v for k, v in message(0, None, "LOST").items() if k != "frame_id"}), "frame_id"),
        (json.dumps({**message(0, None, "LOST"), "frame_id": "0"}), "frame_id"),
    ],
)
def test_the_error_names_what_is_broken(tmp_path: Path, text: str, named: str) -> None:
    path = tmp_path / "poses.jsonl"
    path.write_text(text)
    with pytest.raises(InputError, match=named):
        read_messages(path)


def test_the_error_for_a_recording_says_how_to_get_its_poses(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    path.write_bytes(b"\x89MCAP0\r\n\x01\x04\x00" * 9)
    with pytest.raises(InputError, match=r"run.mcap: found bytes that are no text; .*DIR/poses.jsonl\.$"):
        read_messages(path)


def test_poses_of_another_scene_are_refused(models, tmp_path: Path) -> None:
    messages = read_messages(written(tmp_path, message(500, motion(0))))
    with pytest.raises(InputError, match="000001"):
        evaluate_poses(messages, SCENE, Targets(models))
    with pytest.raises(InputError, match="labelled"):
        evaluate_poses(messages, SCENE, Targets(models, [7]))
