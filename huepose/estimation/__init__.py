"""Estimation: from a frame and boxes to poses."""

from typing import TYPE_CHECKING

from huepose.support.deferred import deferred

if TYPE_CHECKING:
    from huepose.estimation.config import EstimatorConfig, FullPathConfig
    from huepose.estimation.estimator import Estimator
    from huepose.estimation.types import ObjectQuery, PoseEstimate, PosePrior

__all__ = ["Estimator", "EstimatorConfig", "FullPathConfig", "ObjectQuery", "PoseEstimate", "PosePrior"]

__getattr__ = deferred(
    __name__,
    {
        **dict.fromkeys(("EstimatorConfig", "FullPathConfig"), "huepose.estimation.config"),
        "Estimator": "huepose.estimation.estimator",
        **dict.fromkeys(("ObjectQuery", "PoseEstimate", "PosePrior"), "huepose.estimation.types"),
    },
)
