"""Your own detector: anything that gives boxes. This one searches for the colours of the object.

huepose new tea_box examples/tea_box.obj
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
from huepose.support.errors import InputError

BINS, RANGES = [32, 32], [0, 256, 0, 256]
PLACES = 8  # boxes for each object: by colours alone the first is seldom right; the pose decides


class ByColour:
    """The boxes with the largest share of the object's colours; size: the object's at their distance."""

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
            likely[frame.depth <= 0] = 0.0
            for _ in range(PLACES):
                middle = cv2.GaussianBlur(likely, (0, 0), 8.0)
                row, column = np.unravel_index(np.argmax(middle), middle.shape)
                near = frame.depth[max(row - 8, 0) : row + 9, max(column - 8, 0) : column + 9]
                if not (near > 0).any():
                    break
                side = frame.camera.fx * self.models[name].diameter_m / float(np.median(near[near > 0]))
                box = Box(column - side / 2, row - side / 2, side, side)
                rows, columns = box.slices(frame.camera.width, frame.camera.height)
                found.append(Detection(name, box, float(likely[rows, columns].mean())))
                likely[rows, columns] = 0.0
        return sorted(found, key=lambda detection: -detection.score)


if len(sys.argv) < 2:
    sys.exit(__doc__)
folder = Path(sys.argv[1])
try:
    models = load_models(folder / "bundles")
    frame = read_frame(folder / "color.png", folder / "depth.png", folder / "camera.json")
except InputError as error:  # says what to do
    sys.exit(str(error))
queries = [
    ObjectQuery(d.object, d.box, searched=True) for d in ByColour(models).detect(frame, sorted(models))
]
estimator = Estimator(models)
answers = [pose for query in queries for pose in estimator.estimate(frame, [query])]
for name in sorted(models):
    best = max((pose for pose in answers if pose.object == name), key=lambda pose: pose.quality, default=None)
    if best is None or best.T_cam_obj is None:
        print(name, f"not found at {PLACES} places of its colours")
    else:
        print(name, best.state, f"{best.quality:.2f}", best.T_cam_obj[:3, 3].round(3))
