"""Errors and average recall compared with bop_toolkit's own functions. BOP_TOOLKIT names a checkout."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from huepose.datasets.bop_detections import BopDetection, BopDetections
from huepose.evaluation.bop_errors import BopObject
from huepose.evaluation.targets import Targets
from huepose.geometry import RgbdFrame, se3
from huepose.rendering import render_depth

from .bop_toolkit import Question, Toolkit, compare
from .conftest import CAMERA, MemoryScene, box_mesh, reference_model, truth

CHECKOUT = os.environ.get("BOP_TOOLKIT", "")

SIZES = {5: (0.06, 0.1, 0.16), 7: (0.05, 0.05, 0.1), 9: (0.08, 0.08, 0.08)}
INFOS = {
    "5": {"diameter": 197.99},
    "7": {"diameter": 122.47, "symmetries_continuous": [{"axis": [0, 0, 1], "offset": [3.0, -2.0, 0]}]},
    "9": {
        "diameter": 138.56,
        "symmetries_continuous": [{"axis": [0, 1, 0], "offset": [0, 0, 1.0]}],
        "symmetries_discrete": [[1, 0, 0, 2.0, 0, -1, 0, 0, 0, 0, -1, -4.0, 0, 0, 0, 1]],
    },
}


@dataclass(frozen=True, eq=False)
class DepthScene(MemoryScene):
    """Depth of the labelled objects and of a wall, with holes."""

    def frame(self, image: int) -> RgbdFrame:
        depth = np.full((120, 160), 0.9, np.float32)
        for label in self.labels[image]:
            drawn = render_depth(box_mesh(SIZES[label.object_id]), label.T_cam_obj, CAMERA)
            depth = np.where((drawn > 0) & (drawn < depth), drawn, depth)
        depth[np.random.default_rng(image).random(depth.shape) < 0.1] = 0.0
        return RgbdFrame(np.zeros((120, 160, 3), np.uint8), depth, CAMERA, image, 0)


@pytest.mark.skipif(not CHECKOUT, reason="BOP_TOOLKIT names no checkout of bop_toolkit")
def test_errors_and_average_recall_equal_those_of_bop_toolkit() -> None:
    """Up to three instances of an object in an image; rotated, shifted, missing and surplus poses."""
    rng = np.random.default_rng(3)
    scenes, wanted, poses = [], {}, {}
    for number in (1, 2):
        labels = {}
        for image in range(4):
            numbers = rng.choice(list(SIZES), 6)
            labels[image] = tuple(
                truth(k, int(o), _pose(rng), float(rng.random())) for k, o in enumerate(numbers)
            )
            counts = {o: int((numbers == o).sum()) for o in SIZES if o in numbers}
            wanted[number, image] = {o: max(1, n - int(rng.random() < 0.3)) for o, n in counts.items()}
            near = [(t.object_id, se3.perturb(t.T_cam_obj, _step(rng))) for t in labels[image]]
            kept = [pose for pose in [*near, near[0]] if rng.random() < 0.85]
            found = [BopDetection(o, None, float(rng.random()), T) for o, T in kept]
            poses[number, image] = sorted(found, key=lambda d: -d.score)
        scenes.append(DepthScene(f"{number:06d}", labels))
    models = {f"object_{o}": reference_model(f"object_{o}", o, size) for o, size in SIZES.items()}
    objects = {o: BopObject.of(box_mesh(size), INFOS[str(o)]) for o, size in SIZES.items()}
    question = Question(scenes, wanted, objects, INFOS, Targets(models), BopDetections(poses))
    result = compare(Toolkit(Path(CHECKOUT)), question)
    assert result.measured > 25
    assert max(result.apart.values()) < 1e-6
    assert 10 < result.theirs["ar"] < 90
    for key, value in result.theirs.items():
        assert result.ours[key] == pytest.approx(value, abs=1e-6)


def _pose(rng: np.random.Generator) -> np.ndarray:
    return se3.make(se3.rotation_exp(rng.normal(0, 2, 3)), rng.uniform([-0.2, -0.15, 0.5], [0.2, 0.15, 0.8]))


def _step(rng: np.random.Generator) -> np.ndarray:
    return rng.normal(0, [0.008] * 3 + [0.15] * 3)
