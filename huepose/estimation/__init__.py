"""Estimation: from a frame and boxes to poses."""

from huepose.estimation.config import EstimatorConfig, FullPathConfig
from huepose.estimation.estimator import Estimator
from huepose.estimation.types import ObjectQuery, PoseEstimate, PosePrior

__all__ = ["Estimator", "EstimatorConfig", "FullPathConfig", "ObjectQuery", "PoseEstimate", "PosePrior"]
