"""Finds thin objects that were removed with the plane that they lie on: phones, cards, bars of chocolate.

Depth hardly shows them. So they are searched for by keypoints alone, in the whole image, and judged as if
the part of the plane that they explain stood out of it.
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
from huepose.propose.keypoints import ImageFeatures, ModelKeypoints, consensus_poses, match
from huepose.support.stages import stage


class Lying:
    """Thin objects on the planes of one frame; features are extracted at the first request. Thread-safe.
    view: of that frame."""

    def __init__(self, source: FeatureSource, view: ClearView) -> None:
        self._source, self._cropped, self._frame = source, view, view.frame
        self._lock = threading.Lock()

    def places(
        self, model: ReferenceModel, keypoints: ModelKeypoints, known: Sequence[Float64], count: int
    ) -> tuple[ClearView, list[Proposal]] | None:
        """The view in which an object's places were found, and at most `count` of these, none of them where
        an instance is known (poses T_cam_obj, 4 x 4). None if no pose comes from its keypoints."""
        with self._lock:
            view, found = self._cropped.whole, self._spots
        free = view.without(taken_by(model, self._frame, known)) if known else view
        with stage("keypoints"):
            if known:
                found = ImageFeatures.of(found.features[free.free(found.features.pixels)])
            poses = consensus_poses(match(keypoints, found), free.depth, self._frame.camera).poses
        if not len(poses):
            return None
        raised = free.given_back(list(poses), model)
        return raised, proposals_from(model, raised, poses, count)

    @cached_property
    def _spots(self) -> ImageFeatures:
        with stage("features"):
            return ImageFeatures.of(self._source.extract(self._frame.color))
