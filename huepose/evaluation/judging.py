"""What a late estimate means offline: the rule of the live re-initialisation loop, for one instance."""

from __future__ import annotations

from collections.abc import Mapping

from huepose.evaluation.sources import SourcedPose
from huepose.model.types import ReferenceModel
from huepose.reinit.config import ReinitConfig
from huepose.reinit.judge import judge_tracked, usable
from huepose.reinit.types import ObjectSlot, Prior
from huepose.tracking.types import TrackedPose, Verdict


class LoopJudge:
    """Verdicts on late poses. Those without an estimate (labels, files) are taken as they are.

    The instance that an estimate is of is known here, so that an object without a pose takes every usable
    estimate at once; the tracker still verifies it on its own frame before it is published."""

    def __init__(self, models: Mapping[str, ReferenceModel], config: ReinitConfig | None = None) -> None:
        self._config = config or ReinitConfig()
        self._slots = {
            name: ObjectSlot(name, 1, model.diameter_m, tuple(model.equivalents))
            for name, model in models.items()
        }

    def __call__(self, pose: SourcedPose, tracked: TrackedPose | None) -> Verdict:
        """tracked: what was published at the frame that the estimate looked at, None without a pose."""
        if pose.estimate is None:
            return Verdict.CORRECT if tracked is not None else Verdict.ACQUIRE
        if tracked is None or tracked.T_cam_obj is None:
            return Verdict.ACQUIRE if usable(pose.estimate, self._config) else Verdict.REJECT
        slot = self._slots[pose.place.model.name]
        prior = Prior(tracked.T_cam_obj, tracked.velocity, tracked.covariance, tracked.stamp_ns)
        return judge_tracked(pose.estimate, prior, tracked.stamp_ns, tracked.state, slot, self._config)
