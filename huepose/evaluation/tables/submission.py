"""Results of other methods in the format of the BOP challenge, for the same labels and figures."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path

from huepose.believe.state import State
from huepose.datasets.bop_detections import BopDetection, BopDetections
from huepose.estimation.types import ObjectQuery, PoseEstimate, PosePrior
from huepose.evaluation.pose_files import read_bop_csv
from huepose.geometry.frame import RgbdFrame
from huepose.support.errors import InputError


@dataclass(frozen=True)
class Submission:
    """poses: by image, in order of decreasing score; notes: on lines of the file that do not count."""

    name: str
    poses: BopDetections
    notes: tuple[str, ...]


def read_submission(named: str, known_ids: Collection[int]) -> Submission:
    """`NAME=FILE.csv`. known_ids: of the objects with a reference model. Raises InputError."""
    name, _, path = named.partition("=")
    if not name or not path:
        raise InputError("--submission", found=named, expected="NAME=FILE.csv")
    broken: list[str] = []
    found = []
    unknown = 0
    for result in read_bop_csv(Path(path), broken):
        unknown += result.object_id not in known_ids
        if result.scene.isdigit():
            pose = BopDetection(result.object_id, None, result.score, result.T_cam_obj)
            found.append((int(result.scene), result.image, pose))
    notes = []
    if broken:
        notes.append(f"{name}: {len(broken)} lines have no valid pose ({broken[0]}); their labels are missed")
    if unknown:
        notes.append(f"{name}: {unknown} poses are of objects without a reference model")
    return Submission(name, BopDetections.ordered(found), tuple(notes))


class AsGiven:
    """An estimator that returns the prior of each query; its quality is unknown. Queries come in order of
    decreasing score, so earlier ones get a higher score."""

    def estimate(self, frame: RgbdFrame, queries: Sequence[ObjectQuery]) -> list[PoseEstimate]:
        """One estimate for each query."""
        return [_answer(query, query.prior) for query in queries]


def _answer(query: ObjectQuery, prior: PosePrior | None) -> PoseEstimate:
    if prior is None:
        return PoseEstimate(query.object)
    return PoseEstimate(
        object=query.object,
        instance=query.instance,
        found=True,
        T_cam_obj=prior.T_cam_obj,
        state=State.SUSPECT,
        score=-float(query.instance),
        box=query.box,
    )
