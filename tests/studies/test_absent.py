"""The study requests only objects that are absent from the image."""

from __future__ import annotations

import numpy as np
import pytest

from huepose.datasets.types import GroundTruth
from huepose.evaluation.targets import Targets
from huepose.geometry import se3
from studies.absent import NOTHING, questions
from tests.evaluation.conftest import CAMERA, MemoryScene, reference_model


@pytest.fixture
def scene() -> MemoryScene:
    T = se3.make(np.eye(3), np.array([0.0, 0.0, 0.5]))
    return MemoryScene("s", {k: (GroundTruth(0, T, object_id=5, visib_fract=1.0),) for k in range(20)})


def test_only_absent_objects_are_requested(scene) -> None:
    models = {"box": reference_model("box", 5), "brick": reference_model("brick", 7)}
    asked = list(questions([scene], Targets(models)))
    assert len(asked) == 3 * 20
    assert {q.model.name for q in asked} == {"brick"}
    assert [q.shown for q in asked[:3]] == ["box", "box", NOTHING]
    for q in asked:
        assert q.box.area > 0
        assert q.box.x >= 0
        assert q.box.x1 <= CAMERA.width
    again = [(q.model.name, q.box) for q in questions([scene], Targets(models))]
    assert again == [(q.model.name, q.box) for q in asked]
    other = [q.box for q in questions([scene], Targets(models), seed=1)]
    assert other != [q.box for q in asked]
