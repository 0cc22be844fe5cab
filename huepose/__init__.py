"""HuePose: live 6D object poses from an RGB-D camera and textured CAD models.

The public names of the library. Each is imported at its first use, so importing this package is instant.
"""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

from huepose.support.deferred import deferred

if TYPE_CHECKING:
    from huepose.believe.state import State
    from huepose.estimation import Estimator, ObjectQuery, PoseEstimate
    from huepose.geometry import Box, Camera, RgbdFrame
    from huepose.model import ReferenceModel, load_models
    from huepose.tracking import Correction, Tracker

__version__ = "0.1.0"

# These libraries read this when they are loaded. Otherwise, if there is internet, ONNX Runtime and depthai
# send usage data to their makers, with a number that identifies this computer.
os.environ.setdefault("ORT_DISABLE_TELEMETRY", "1")
os.environ.setdefault("DEPTHAI_TELEMETRY", "0")

_HOMES = {
    "Box": "huepose.geometry",
    "Camera": "huepose.geometry",
    "Correction": "huepose.tracking",
    "Estimator": "huepose.estimation",
    "ObjectQuery": "huepose.estimation",
    "PoseEstimate": "huepose.estimation",
    "ReferenceModel": "huepose.model",
    "RgbdFrame": "huepose.geometry",
    "State": "huepose.believe.state",
    "Tracker": "huepose.tracking",
    "load_models": "huepose.model",
}

__all__ = [
    "Box",
    "Camera",
    "Correction",
    "Estimator",
    "ObjectQuery",
    "PoseEstimate",
    "ReferenceModel",
    "RgbdFrame",
    "State",
    "Tracker",
    "load_models",
]

__getattr__ = deferred(__name__, _HOMES)
