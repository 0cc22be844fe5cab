"""Every wrong pose, looked at: a page of pictures and a line why (`huepose eval estimate --failures`).

The frames with a wrong pose are estimated once more, with everything that led to the answers kept; with the
same seed the answers are the same.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from huepose.datasets.types import GroundTruth, Sample
from huepose.drawing.canvas import paragraph
from huepose.drawing.contact_sheet import contact_sheet
from huepose.estimation.estimator import Estimator
from huepose.estimation.explanation import Explanation
from huepose.estimation.panels import LEGEND, Panels
from huepose.estimation.types import ObjectQuery, PoseEstimate
from huepose.evaluation.diagnosis import Diagnosis, diagnose
from huepose.evaluation.estimate_rows import EstimateRow
from huepose.evaluation.result_files import write_json
from huepose.evaluation.targets import Key, Targets
from huepose.geometry.arrays import Bool, Float64, UInt8
from huepose.model.types import ReferenceModel
from huepose.support.files import write_picture, write_text

PANELS_A_ROW = 4
DEFAULT_TOLERANCE_M = 0.01


@dataclass(frozen=True, eq=False)
class Failure:
    """A wrong pose, and why it is."""

    row: EstimateRow
    name: str
    diagnosis: Diagnosis

    @property
    def key(self) -> str:
        """How the instance and its box are called, also in the name of its picture."""
        return f"{self.row.scene}_{self.row.image:06d}_{self.row.instance}_s{self.row.seed}"

    def as_json(self) -> dict[str, Any]:
        """In the form of `failures.json`."""
        d = self.diagnosis
        return {
            "key": self.key,
            "object": self.row.object,
            "name": self.name,
            "visib_fract": self.row.visib_fract,
            "add_diameters": self.row.error.add_m / self.row.diameter_m,
            "adds_diameters": self.row.error.adds_m / self.row.diameter_m,
            "quality": self.row.quality,
            "cause": d.cause,
            "line": d.line,
            "nearest_diameters": d.nearest,
            "mask_iou": d.mask_iou,
            "answer": None if d.answer is None else asdict(d.answer),
            "truth": None if d.truth is None else asdict(d.truth),
        }


class FailureFolder:
    """Writes `SCENE_IMAGE_INSTANCE_sSEED_NAME.png` for every wrong pose, and in the end `failures.txt` and
    `failures.json`."""

    def __init__(
        self,
        folder: Path,
        targets: Targets,
        estimator: Estimator,
        equivalents: Mapping[Key, Sequence[Float64]],
        true_masks: bool = False,
    ) -> None:
        """true_masks: the estimator is given those of the labels."""
        self._folder, self._targets, self._estimator = folder, targets, estimator
        self._equivalents, self._true_masks = equivalents, true_masks
        self._failures: list[Failure] = []

    def frame(self, sample: Sample, rows: Sequence[EstimateRow]) -> None:
        """Look at the wrong poses among the rows of a frame."""
        asked = [row for row in rows if row.box is not None]
        if all(row.error.right for row in asked):
            return
        truths = {truth.instance: truth for truth in sample.truths}
        queries = [self._query(row, truths[row.instance]) for row in asked]
        looks = self._estimator.explained(sample.frame, queries)
        for row, (answer, explanation) in zip(asked, looks, strict=True):
            if not row.error.right:
                self._look(sample, row, truths[row.instance], answer, explanation)

    def _query(self, row: EstimateRow, truth: GroundTruth) -> ObjectQuery:
        model = self._targets.named(row.object)
        assert model is not None  # a row is of one of the targets
        mask = truth.mask() if self._true_masks else None
        return ObjectQuery(model.name, row.box, () if mask is None else (mask,), instance=row.instance)

    def _look(
        self,
        sample: Sample,
        row: EstimateRow,
        truth: GroundTruth,
        answer: PoseEstimate,
        explanation: Explanation,
    ) -> None:
        model = self._targets.models_by_name[answer.object]
        assert truth.T_cam_obj is not None  # a row is of a label with a pose
        declared = [
            truth.T_cam_obj @ T for T in self._equivalents.get((row.scene, row.image, row.instance), ())
        ]
        right = [T @ turn for T in (truth.T_cam_obj, *declared) for turn in model.equivalents]
        mask = truth.mask()
        diagnosis = diagnose(model, answer, explanation, right, mask)
        failure = Failure(row, model.name, diagnosis)
        self._failures.append(failure)
        page = failure_page(sample, model, answer, explanation, right[0], mask, diagnosis)
        write_picture(self._folder / f"{failure.key}_{model.name}.png", page)

    def finish(self) -> str:
        """Write the lists; returns how often which cause was found, in a line."""
        lines = [
            f"{f.key} {f.name} (visible {_percent(f.row.visib_fract)}): {f.diagnosis.line}"
            for f in self._failures
        ]
        causes = Counter(failure.diagnosis.cause for failure in self._failures)
        counts = ", ".join(f"{count} {cause}" for cause, count in causes.most_common())
        summary = f"{len(self._failures)} wrong poses" + (f": {counts}" if counts else "")
        write_text(self._folder / "failures.txt", "\n".join([*lines, summary]) + "\n")
        write_json(
            self._folder / "failures.json",
            {"causes": dict(causes), "rows": [failure.as_json() for failure in self._failures]},
        )
        return summary


def failure_page(
    sample: Sample,
    model: ReferenceModel,
    answer: PoseEstimate,
    explanation: Explanation,
    T_truth: Float64,
    mask: Bool | None,
    diagnosis: Diagnosis,
) -> UInt8:
    """A page (H, W, 3) uint8 RGB: picture, depth, answer and truth; masks, and where the answer and the right
    pose agree with the frame."""
    frame, evidence = sample.frame, explanation.evidence
    tolerance = DEFAULT_TOLERANCE_M if evidence is None else evidence.region.tolerance_m
    masks = explanation.masks
    panels = Panels.around(
        frame, explanation.box, [m for m in (mask, answer.mask) if m is not None], tolerance
    )
    best = masks[0] if masks else None
    best_pose = T_truth if diagnosis.best is None else diagnosis.best
    pictures = [panels.photo(explanation.box), panels.worn(model, T_truth)]
    labels = [model.name, "the truth"]
    if answer.T_cam_obj is not None:
        pictures.append(panels.worn(model, answer.T_cam_obj))
        labels.append(f"the answer, quality {answer.quality:.2f}")
    pictures += [panels.depth(), panels.masks(best, mask), panels.judged(model, best_pose)]
    labels += [
        "depth",
        f"first of {len(masks)} masks, true outline",
        _scored("the right pose", diagnosis.truth),
    ]
    if answer.T_cam_obj is not None:
        pictures.append(panels.judged(model, explanation.ranked.poses[0]))
        labels.append(_scored("the answer", diagnosis.answer))
    sheet = contact_sheet(pictures, PANELS_A_ROW, labels)
    where = f"{sample.scene}, image {sample.image}, {model.name}"
    return np.vstack([paragraph(f"{where}\n{diagnosis.line}\n{LEGEND}", sheet.shape[1]), sheet])


def _scored(name: str, terms: Any) -> str:
    return name if terms is None else f"{name}: {terms.total:.2f}, texture {terms.color:.2f}"


def _percent(share: float | None) -> str:
    return "unknown" if share is None else f"{100 * share:.0f} %"
