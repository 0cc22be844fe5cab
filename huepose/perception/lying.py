"""Finds thin objects that were taken away with the plane they lie on: phones, cards, bars of chocolate.

Depth hardly shows them. So they are found by keypoints alone, in the whole picture, and judged as if what
they explain of the plane stood out of it.
"""

from __future__ import annotations

import threading
from collections.abc import Sequence
from functools import cached_property

import numpy as np

from huepose.geometry.arrays import Float64
from huepose.geometry.frame import RgbdFrame
from huepose.judge.silhouette import taken_by
from huepose.model.types import ReferenceModel
from huepose.perception.clear_view import ClearView, whole_view
from huepose.perception.scouting import Proposal, proposals_from
from huepose.propose.features import FeatureSource
from huepose.propose.keypoints import ModelKeypoints, PictureFeatures, consensus_poses, match
from huepose.support.stages import stage


class Lying:
    """What lies on the planes of one frame, looked at when first asked for; thread-safe. largest_m: diameter
    of the largest known object."""

    def __init__(self, source: FeatureSource, frame: RgbdFrame, largest_m: float) -> None:
        self._source, self._frame, self._largest_m = source, frame, largest_m
        self._lock = threading.Lock()

    def places(
        self, model: ReferenceModel, sought: ModelKeypoints, known: Sequence[Float64], count: int
    ) -> tuple[ClearView, list[Proposal]] | None:
        """The view in which an object's places were found, and at most `count` of these, none where it is
        `known` to be (poses T_cam_obj, 4 x 4). None where its keypoints are not found."""
        with self._lock:
            view, seen = self._view, self._spots
        if view is None:
            return None
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
    def _view(self) -> ClearView | None:
        with stage("clear view"):
            return whole_view(self._frame, self._largest_m)

    @cached_property
    def _spots(self) -> PictureFeatures:
        with stage("features"):
            return PictureFeatures.of(self._source.extract(np.ascontiguousarray(self._frame.color)))
