"""Finds thin objects that were taken away with the plane they lie on: phones, cards, bars of chocolate.

Depth hardly shows them. So they are found by keypoints alone, in the whole picture, and judged as if what
they explain of the plane stood out of it.
"""

from __future__ import annotations

import threading
from collections.abc import Sequence
from functools import cached_property

from huepose.geometry.arrays import Float64
from huepose.judge.silhouette import taken_by
from huepose.model.types import ReferenceModel
from huepose.perception.clear_view import ClearView
from huepose.perception.scouting import Proposal, proposals_from
from huepose.propose.features import FeatureSource
from huepose.propose.keypoints import ModelKeypoints, PictureFeatures, consensus_poses, match
from huepose.support.stages import stage


class Lying:
    """What lies on the planes of one frame, looked at when first asked for; thread-safe. view: of it."""

    def __init__(self, source: FeatureSource, view: ClearView) -> None:
        self._source, self._cropped, self._frame = source, view, view.frame
        self._lock = threading.Lock()

    def places(
        self, model: ReferenceModel, sought: ModelKeypoints, known: Sequence[Float64], count: int
    ) -> tuple[ClearView, list[Proposal]] | None:
        """The view in which an object's places were found, and at most `count` of these, none where it is
        `known` to be (poses T_cam_obj, 4 x 4). None where its keypoints are not found."""
        with self._lock:
            view, seen = self._cropped.whole, self._spots
        free = view.without(taken_by(model, self._frame, known)) if known else view
        with stage("keypoints"):
            if known:
                seen = PictureFeatures.of(seen.features[free.free(seen.features.pixels)])
            poses = consensus_poses(match(sought, seen), free.depth, self._frame.camera).poses
        if not len(poses):
            return None
        raised = free.given_back(list(poses), model)
        return raised, proposals_from(model, raised, poses, count)

    @cached_property
    def _spots(self) -> PictureFeatures:
        with stage("features"):
            return PictureFeatures.of(self._source.extract(self._frame.color))
