"""Named settings of detector, estimator and tracker, one set for each use.

The workers of a pipeline, the command line and the evaluation load the same objects, so that what is
measured is what runs. `live` is for a stream of frames, where time is short; `patient` is for single
frames, where an answer may take longer.

>>> profile("live").tracker.tries_per_s
30.0
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Literal, get_args

from huepose.estimation.config import EstimatorConfig
from huepose.perception.config import DetectorConfig
from huepose.support.errors import InputError
from huepose.tracking.config import TrackerConfig

ProfileName = Literal["live", "patient"]
NAMES: tuple[ProfileName, ...] = get_args(ProfileName)


@dataclass(frozen=True)
class Profile:
    """How much each part may spend on an answer. The defaults of the parts are those of a live pipeline.

    Settings that depend on the machine or the task are separate: threads, number of kept frames, the
    method."""

    detector: DetectorConfig = field(default_factory=DetectorConfig)
    estimator: EstimatorConfig = field(default_factory=EstimatorConfig)
    tracker: TrackerConfig = field(default_factory=TrackerConfig)


PROFILES: Mapping[ProfileName, Profile] = MappingProxyType(
    {
        "live": Profile(),
        "patient": Profile(
            DetectorConfig(proposals=3, min_score=0.02),
            EstimatorConfig(),
            TrackerConfig(tries_per_s=None, catch_up_stride=5),
        ),
    }
)
"""All profiles by name."""


def profile(name: str) -> Profile:
    """The profile of that name. Raises InputError for an unknown one."""
    for known in NAMES:
        if name == known:
            return PROFILES[known]
    raise InputError("profile", found=f"'{name}'", expected=" or ".join(f"'{known}'" for known in NAMES))
