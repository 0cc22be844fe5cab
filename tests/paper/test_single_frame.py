"""The paper's method as it is: it finds a printed box, and its answer has nothing of our additions."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from huepose.estimation import Estimator, EstimatorConfig, ObjectQuery
from huepose.geometry import Box, RgbdFrame, se3
from huepose.model.types import ReferenceModel
from huepose.paper import single_frame
from huepose.paper.single_frame import PaperConfig, PaperMethod, fitness_of
from huepose.paper.tables import reference_cloud, tables_of
from huepose.rendering.render import render_depth
from huepose.support.errors import InputError
from huepose.support.stages import listening


@pytest.fixture(scope="module")
def outline(tea_box: ReferenceModel, standing: np.ndarray, box_frame: RgbdFrame) -> np.ndarray:
    return render_depth(tea_box.mesh, standing, box_frame.camera) > 0


def test_the_box_is_found(
    tea_box: ReferenceModel, box_frame: RgbdFrame, outline: np.ndarray, standing: np.ndarray
) -> None:
    estimator = Estimator({"tea_box": tea_box}, EstimatorConfig(method="paper"))
    query = ObjectQuery("tea_box", Box.of_mask(outline))
    with listening() as clock:
        (answer,) = estimator.estimate(box_frame, [query])
    assert answer.T_cam_obj is not None
    assert np.linalg.norm(answer.T_cam_obj[:3, 3] - standing[:3, 3]) < 0.005
    assert se3.rotation_angle(answer.T_cam_obj, standing) < np.radians(3.0)
    # the other fields of the answer, and the steps of the method
    assert answer.state == "SUSPECT"
    assert 0.0 < answer.quality <= 1.0
    assert answer.covariance is None
    assert answer.terms is None
    assert answer.alternatives == ()
    assert answer.mask is not None
    steps = set(clock.totals())
    assert {"extract", "classes", "votes", "semantic_icp", "judge"} <= steps
    assert steps <= {"evidence", "masks", "extract", "classes", "votes", "semantic_icp", "judge", "answer"}
    (again,) = estimator.estimate(box_frame, [query])
    np.testing.assert_array_equal(again.T_cam_obj, answer.T_cam_obj)


def test_point_pairs_vote_only_if_triangles_cannot(
    tea_box: ReferenceModel, box_frame: RgbdFrame, outline: np.ndarray, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[str] = []
    for name in ("triangle_votes", "ppf_votes"):
        real = getattr(single_frame, name)
        monkeypatch.setattr(
            single_frame, name, lambda *args, name=name, real=real: asked.append(name) or real(*args)
        )
    for classes, config, expected in (
        (3, PaperConfig(), "triangle_votes"),
        (2, PaperConfig(), "ppf_votes"),
        (2, PaperConfig(ppf=False), "triangle_votes"),
        (3, PaperConfig(triangles=False), "ppf_votes"),
    ):
        asked.clear()
        monkeypatch.setattr(single_frame, "classes_in_sight", lambda cloud, n=classes: n)
        poses, fitness = PaperMethod(config).in_mask(tea_box, box_frame, outline, np.random.default_rng(0))
        assert asked == [expected]
        assert len(poses) == len(fitness) > 0
        assert (np.diff(fitness) <= 0.0).all()
    asked.clear()
    silent = PaperMethod(PaperConfig(triangles=False, ppf=False))
    assert not len(silent.in_mask(tea_box, box_frame, outline, np.random.default_rng(0))[0])
    assert not asked


def test_an_empty_mask_gives_no_pose(tea_box: ReferenceModel, box_frame: RgbdFrame) -> None:
    nothing = np.zeros(box_frame.depth.shape, bool)
    poses, fitness = PaperMethod().in_mask(tea_box, box_frame, nothing, np.random.default_rng(0))
    assert poses.shape == (0, 4, 4)
    assert len(fitness) == 0


def test_a_model_without_tables_is_refused_before_the_first_frame(tea_box: ReferenceModel) -> None:
    bare = replace(tea_box, tables=None)
    for method in ("paper", "colorpair"):
        with pytest.raises(InputError, match="--paper"):
            Estimator({"tea_box": bare}, EstimatorConfig(method=method)).warm_up()


def test_fitness_is_one_on_the_cloud_itself_and_falls_with_distance_and_wrong_classes(
    tea_box: ReferenceModel,
) -> None:
    tables = tables_of(tea_box)
    T = se3.make(se3.rotation_exp(np.array([0.3, -0.2, 0.9])), np.array([0.1, 0.0, 0.7]))
    points = se3.apply(T, tables.cloud_points)
    scene = replace(reference_cloud(tables), points=points)
    shifted = se3.compose(se3.make(np.eye(3), np.array([0.004, 0.0, 0.0])), T)
    far = se3.compose(se3.make(np.eye(3), np.array([1.0, 0.0, 0.0])), T)
    exact, near, none = fitness_of(tables, scene, np.stack([T, shifted, far]))
    assert exact == pytest.approx(1.0, abs=1e-6)
    assert 0.3 < near < 0.95
    assert none == 0.0
    count = len(tables.centers)
    other = replace(scene, classes=((tables.cloud_classes + 1) % count).astype(np.uint8))
    (wrong,) = fitness_of(tables, other, T[None])
    assert 1.0 / 3.0 - 1e-6 < wrong < 0.9  # all points have partners, few of their class
