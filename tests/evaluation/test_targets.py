"""Labels to models, and errors with equivalent poses."""

from __future__ import annotations

import numpy as np
import pytest

from huepose.datasets.types import GroundTruth
from huepose.evaluation import metrics
from huepose.evaluation.targets import Targets, object_number
from huepose.geometry import se3
from huepose.support.errors import InputError

from .conftest import HALF_TURN, pose_at, reference_model, truth


def test_models_are_found_by_id_and_by_name(models) -> None:
    targets = Targets(models)
    assert targets.model_of(truth(0, 5, np.eye(4))) is models["box"]
    assert targets.model_of(GroundTruth(0, np.eye(4), object="brick")) is models["brick"]
    assert targets.model_of(truth(0, 16, np.eye(4))) is None
    assert targets.named("7") is targets.named("brick")
    assert [object_number(m) for m in targets.models] == [5, 7]
    assert object_number(reference_model("own", None)) == "own"


def test_only_wanted_objects_count(models) -> None:
    targets = Targets(models, [7, "box"])
    assert targets.wants(truth(0, 7, np.eye(4)))
    assert targets.wants(truth(0, 5, np.eye(4)))  # by the name of its model
    assert not targets.wants(truth(0, 16, np.eye(4)))
    assert [m.name for m in Targets(models, ["7"]).models] == ["brick"]
    with pytest.raises(InputError, match="mug"):
        Targets(models, ["mug"])


def test_errors_are_those_of_the_metrics(models) -> None:
    T, points = pose_at(0.1), models["box"].eval_points
    T_estimate = se3.perturb(T, np.array([0.004, 0, 0.003, 0, 0.1, 0]))
    error = Targets(models).error(models["box"], T_estimate, T)
    assert error.add_m == error.official_add_m == pytest.approx(metrics.add(points, T_estimate, T))
    assert error.adds_m == pytest.approx(metrics.adds(points, T_estimate, T))
    assert error.right


def test_a_declared_equivalent_counts_in_add_but_not_officially(models) -> None:
    T = pose_at(0.0)
    error = Targets(models).error(models["box"], T @ HALF_TURN, T, [np.eye(4), HALF_TURN])
    assert error.add_m == pytest.approx(0, abs=1e-9)
    assert error.official_add_m > 0.04
    assert error.right
    assert not Targets(models).error(models["box"], T @ HALF_TURN, T).right


def test_an_equivalent_rotation_is_right_though_add_counts_it(models) -> None:
    T = pose_at(0.0)
    error = Targets(models).error(models["brick"], T @ HALF_TURN, T)
    assert error.right
    assert error.add_m > 0.03
    assert error.adds_m == pytest.approx(0, abs=1e-9)


def test_no_pose_is_infinitely_wrong(models) -> None:
    error = Targets(models).error(models["box"], None, np.eye(4))
    assert (error.add_m, error.adds_m, error.official_add_m, error.right) == (np.inf, np.inf, np.inf, False)
