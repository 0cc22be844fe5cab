"""Result files of known content, written as the evaluations write theirs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from huepose.evaluation.estimate_rows import EstimateResult, EstimateRow, FalsePose
from huepose.evaluation.result_files import write_json
from huepose.evaluation.targets import PoseError
from huepose.evaluation.track_rows import TrackResult, TrackRow
from huepose.geometry import se3

DIAMETER_M = 0.2
RIGHT_M, WRONG_M = 0.01, 0.05
"""ADD of a right and of a wrong pose: AUC 90 and 50."""

Answers = Mapping[tuple[int, int], bool | None]


def pose(x_m: float = 0.0, turn: float = 0.0) -> np.ndarray:
    """A pose in front of the camera, moved along x and rotated about z."""
    return se3.make(se3.rotation_exp([0.0, 0.0, turn]), [x_m, 0.0, 0.6])


def error_of(right: bool | None) -> PoseError:
    """The error of a right, wrong or missing pose."""
    if right is None:
        return PoseError.missing()
    return (
        PoseError(RIGHT_M, RIGHT_M, RIGHT_M, True) if right else PoseError(WRONG_M, RIGHT_M, WRONG_M, False)
    )


def write_estimates(
    path: Path,
    answers: Answers,
    false: Sequence[tuple[int, int]] = (),
    method: str = "full",
    x_m: float = 0.0,
    turn: float = 0.0,
) -> Path:
    """answers: is the pose right (None: no pose), by (instance, seed), four instances a frame;
    false: (frame, seed) of poses without a label."""
    rows = [
        EstimateRow(
            scene="000001" if instance < 20 else "000002",
            image=instance // 4,
            instance=instance % 4,
            object=5,
            visib_fract=0.8,
            T_cam_obj=None if right is None else pose(x_m, turn),
            error=error_of(right),
            diameter_m=DIAMETER_M,
            quality=0.0 if right is None else 0.9,
            state="LOST" if right is None else "TRACKING",
            seconds=0.1,
            seed=seed,
            box=None,
        )
        for (instance, seed), right in answers.items()
    ]
    wrong = [FalsePose("000001", image, 5, pose(), 0.6, "SUSPECT", seed) for image, seed in false]
    seeds = sorted({seed for _, seed in answers})
    record = EstimateResult(rows, wrong, 0, "perturbed", "auto", seeds).as_json()
    write_json(path, {**record, "summary": {**record["summary"], "method": method}})
    return path


def write_track(
    path: Path, right: Sequence[bool], states: Sequence[str], sequences: int = 1, phantoms: int = 0
) -> Path:
    """One object at 30 Hz, the same in all sequences; right: is the pose of each frame right."""
    rows = [
        TrackRow(
            sequence=f"run{k}",
            frame=i,
            stamp_ns=round(i * 1e9 / 30),
            object=5,
            ordinal=0,
            gt_instance=0,
            track=0,
            T_cam_obj=None if state == "LOST" else pose(),
            error=error_of(None if state == "LOST" else good),
            diameter_m=DIAMETER_M,
            visible=True,
            gone=False,
            visib_fract=None,
            state=state,
            quality=0.9,
            seconds=0.01,
            seed=0,
        )
        for k in range(sequences)
        for i, (good, state) in enumerate(zip(right, states, strict=True))
    ]
    settings = {"protocol": "free", "every": 1, "init": "gt", "delayed": None}
    result = TrackResult(rows, {("run0", 0): phantoms}, settings)
    write_json(path, result.as_json())
    return path


def write_perception(
    path: Path, found: Sequence[bool], false: Sequence[int] = (), frames: int | None = None
) -> Path:
    """One instance a frame, with masks of IoU 0.8 where it is found; false: frames of false boxes; frames:
    number of all frames, by default those with an instance."""
    rows = [
        {
            "scene": "000001",
            "image": i,
            "instance": 0,
            "object": 5,
            "name": "box",
            "visib_fract": 0.9,
            "box": [0, 0, 10, 10],
            "rank": 1 if yes else None,
            "best_iou": 0.8 if yes else 0.2,
            "mask_iou": 0.8 if yes else None,
            "final_mask_iou": 0.9 if yes else None,
            "found": yes,
            "quality": 0.9 if yes else 0.0,
        }
        for i, yes in enumerate(found)
    ]
    wrong = [{"scene": "000001", "image": i, "object": 7} for i in false]
    summary = {"asked_for": 3, "frames": len(found) if frames is None else frames}
    write_json(path, {"summary": summary, "rows": rows, "false": wrong})
    return path
