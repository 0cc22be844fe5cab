"""Scores the poses that a live pipeline published against the labels of the scene that it played.

The input is the output of `huepose poses --json`: one pose message per line. In its first pass, a source that
plays a scene uses the image numbers as frame ids. Later passes do not count. Timestamps are those of the
scene.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from huepose.believe.state import State
from huepose.datasets import files
from huepose.datasets.types import Scene
from huepose.evaluation.instances import PublishedPose, has_labels, instance_counts, places
from huepose.evaluation.summary import grouped
from huepose.evaluation.targets import Targets
from huepose.evaluation.track_rows import TrackResult, TrackRow, rows_of_frame
from huepose.geometry import se3
from huepose.geometry.arrays import Float64
from huepose.support.errors import InputError

_STATES = {state.value for state in State}


@dataclass(frozen=True, eq=False)
class LivePose:
    """One pose message."""

    pose: PublishedPose
    epoch: int
    frame_id: int
    capture_ns: int
    publish_ns: int


def read_messages(path: Path | str) -> list[LivePose]:
    """The pose messages of a file, one JSON object per line. Messages of other kinds are skipped, and so is
    an incomplete last line, as when the recording was stopped. Raises InputError, naming the line."""
    text = files.read_bytes(Path(path)).decode("utf-8", "replace")
    if "\ufffd" in text:
        raise InputError(
            path,
            found="bytes that are no text",
            expected="one JSON message per line, as `huepose poses --json` prints",
            fix="For a recording, `huepose replay RUN.mcap --bop DIR` writes DIR/poses.jsonl.",
        )
    lines = text.splitlines()
    messages = []
    for number, line in enumerate(lines, 1):
        if not line.strip():
            continue
        where = f"{path}, line {number}"
        try:
            record = json.loads(line)
        except json.JSONDecodeError:
            if number == len(lines) and not text.endswith("\n"):
                continue
            raise InputError(
                where, found=line[:60], expected="one JSON message per line, as `huepose poses --json` prints"
            ) from None
        if isinstance(record, dict) and {"object", "instance", "state"} <= record.keys():
            messages.append(_message(record, where))
    if not messages:
        raise InputError(
            path, found="no pose message", fix="Record one with `huepose poses --json > POSES.jsonl`."
        )
    return messages


def _message(record: dict[str, Any], where: str) -> LivePose:
    state = record["state"]
    if state not in _STATES:
        raise InputError(where, found=f"state {state!r}", expected=", ".join(sorted(_STATES)))
    T_cam_obj: Float64 | None = None
    if record.get("translation") is not None:
        q = files.numbers(record, "quaternion", (4,), where)
        if abs(np.linalg.norm(q) - 1.0) > 0.01:
            raise InputError(where, found=f"quaternion {q.tolist()}", expected="length 1, order xyzw")
        t_m = files.numbers(record, "translation", (3,), where)
        T_cam_obj = se3.make(se3.rotation_from_quaternion(q), t_m)
    velocity: Float64 | None = None
    if record.get("velocity_linear") is not None:
        keys = ("velocity_linear", "velocity_angular")
        velocity = np.concatenate([files.numbers(record, key, (3,), where) for key in keys])
    counts = {}
    for key in ("camera_epoch", "frame_id", "capture_ns", "publish_ns", "instance"):
        value = files.field(record, key, where)
        if not isinstance(value, int):
            raise InputError(where, found=f"'{key}': {value!r}", expected="a whole number")
        counts[key] = value
    quality = float(files.numbers(record, "quality", (), where))
    return LivePose(
        PublishedPose(str(record["object"]), counts["instance"], T_cam_obj, state, quality, velocity),
        counts["camera_epoch"],
        counts["frame_id"],
        counts["capture_ns"],
        counts["publish_ns"],
    )


def first_pass(messages: Sequence[LivePose], image_ids: Sequence[int]) -> list[LivePose]:
    """The messages about the scene's images, by capture time: those of the first camera epoch, until the
    frame numbers start again. Of several about the same track and frame, the first published one."""
    images = set(image_ids)
    kept: dict[tuple[str, int, int], LivePose] = {}
    for message in _until_it_begins_again(messages, max(images)):
        if message.frame_id in images:
            kept.setdefault((message.pose.object, message.pose.track, message.frame_id), message)
    return list(kept.values())


def _until_it_begins_again(messages: Sequence[LivePose], last_image: int) -> list[LivePose]:
    """The messages, by capture time, before the first of a later pass."""
    ordered = sorted(messages, key=lambda m: (m.capture_ns, m.publish_ns))
    newest = -1
    for k, message in enumerate(ordered):
        if message.epoch != ordered[0].epoch or not newest <= message.frame_id <= last_image:
            return ordered[:k]
        newest = message.frame_id
    return ordered


def evaluate_poses(messages: Sequence[LivePose], scene: Scene, targets: Targets) -> TrackResult:
    """Score published poses like those of a tracker. An image without a message has no pose; an unlabelled
    image has no row.

    Raises InputError if no message is about the scene, or the scene has no label of an onboarded object."""
    counts = instance_counts(scene, scene.image_ids, targets)
    if not counts:
        raise InputError(f"scene {scene.name}", found="no labelled pose of an onboarded object")
    kept = first_pass(messages, scene.image_ids)
    if not kept:
        raise InputError(
            f"scene {scene.name}",
            found="no message about any of its images",
            expected="frame ids that are image numbers of this scene",
            fix="Score the poses of the first pass (camera.once: true) of the scene that was played.",
        )
    by_image = grouped(kept, lambda m: m.frame_id)
    rows: list[TrackRow] = []
    phantoms = 0
    for image in scene.image_ids:
        if not has_labels(scene, image):
            continue
        here = places(scene.truths(image), targets, counts)
        published = [m.pose for m in by_image.get(image, []) if m.pose.object in targets.models_by_name]
        new, spare = rows_of_frame(scene.name, image, scene.stamp_ns(image), here, published, targets)
        rows += new
        phantoms += spare
    due = [row for row in rows if not row.gone]
    with_pose = sum(row.T_cam_obj is not None for row in due)
    first = _until_it_begins_again(messages, max(scene.image_ids))
    measured = {
        "poses_for_frames": 100.0 * with_pose / len(due) if due else None,
        "messages": len(messages),
        "messages_of_first_pass": len(first),
        "messages_before_scene": sum(m.frame_id < min(scene.image_ids) for m in first),
        **_times(kept),
    }
    return TrackResult(rows, {(scene.name, 0): phantoms}, {"frames": len(scene.image_ids)}, measured)


def _times(kept: Sequence[LivePose]) -> dict[str, Any]:
    """Rate of the frames with a message, and latency from capture to publishing."""
    captures = np.array(sorted({m.capture_ns for m in kept}))
    latencies_ms = np.array([(m.publish_ns - m.capture_ns) * 1e-6 for m in kept])
    took_s = (captures[-1] - captures[0]) * 1e-9
    return {
        "fps": float((len(captures) - 1) / took_s) if took_s > 0 else None,
        "latency_ms_p50": float(np.percentile(latencies_ms, 50)),
        "latency_ms_p99": float(np.percentile(latencies_ms, 99)),
    }
