"""A detector of your own: whatever gives boxes will do. This one looks for the colours of the object.

huepose new tea_box tea_box.obj
python examples/05_own_detector.py tea_box
"""

import sys
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from huepose import Box, Estimator, ObjectQuery, ReferenceModel, RgbdFrame, load_models
from huepose.datasets.image_files import read_frame
from huepose.perception.types import Detection

BINS, RANGES = [32, 32], [0, 256, 0, 256]


class ByColour:
    """The box, of the size that the object may have, in which its colours are commonest."""

    def __init__(self, models: dict[str, ReferenceModel]) -> None:
        self.models = models

    def detect(self, frame: RgbdFrame, names: Sequence[str]) -> list[Detection]:
        lab = cv2.cvtColor(frame.color, cv2.COLOR_RGB2LAB)
        common = cv2.calcHist([lab], [1, 2], None, BINS, RANGES)
        found = []
        for name in names:
            texture = cv2.cvtColor(self.models[name].mesh.texture, cv2.COLOR_RGB2LAB)
            own = cv2.calcHist([texture], [1, 2], None, BINS, RANGES)
            ratio = own / own.sum() / (common / common.sum() + own / own.sum() + 1e-9)
            likely = cv2.calcBackProject([lab], [1, 2], ratio.astype(np.float32) * 255, RANGES, 1.0) / 255.0
            distance = np.median(frame.depth[frame.depth > 0])
            side = int(1.2 * frame.camera.fx * self.models[name].diameter_m / distance)
            summed = cv2.boxFilter(likely, -1, (side, side), borderType=cv2.BORDER_CONSTANT)
            row, column = np.unravel_index(np.argmax(summed), summed.shape)
            box = Box(float(column - side / 2), float(row - side / 2), float(side), float(side))
            found.append(Detection(name, box, float(summed.max())))
        return sorted(found, key=lambda detection: -detection.score)


if len(sys.argv) < 2:
    sys.exit(__doc__)
folder = Path(sys.argv[1])
models = load_models(folder / "bundles")
frame = read_frame(folder / "color.png", folder / "depth.png", folder / "camera.json")
queries = [ObjectQuery(d.object, d.box) for d in ByColour(models).detect(frame, sorted(models))]
for pose in Estimator(models).estimate(frame, queries):
    print(pose.object, pose.state, f"{pose.quality:.2f}", pose.reason or pose.T_cam_obj[:3, 3].round(3))
