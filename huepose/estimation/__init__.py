"""Estimation: from a frame and boxes to poses."""

from typing import TYPE_CHECKING

from huepose.support.deferred import deferred

if TYPE_CHECKING:
    from huepose.estimation.config import EstimatorConfig
    from huepose.estimation.estimator import Estimator
    from huepose.estimation.types import ObjectQuery, PoseEstimate, PosePrior

__all__ = ["Estimator", "EstimatorConfig", "ObjectQuery", "PoseEstimate", "PosePrior"]

__getattr__ = deferred(
    __name__,
    {
        "EstimatorConfig": "huepose.estimation.config",
        "Estimator": "huepose.estimation.estimator",
        **dict.fromkeys(("ObjectQuery", "PoseEstimate", "PosePrior"), "huepose.estimation.types"),
    },
)
