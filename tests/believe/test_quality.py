"""Quality and its parts in cases with a known answer: near ties, look-alikes, boxes without the object."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from huepose.estimation import Estimator, EstimatorConfig, ObjectQuery
from huepose.geometry import Box, Mesh, RgbdFrame, se3
from huepose.judge.texture_evidence import texture_evidence
from huepose.model.types import ReferenceModel
from huepose.rendering.render import render_depth
from huepose.select.distinct import RIGHT, different_answers
from tests.conftest import TakePicture
from tests.judge.regions import region_in
from tests.meshes import demo_objects

UPSIDE_DOWN = np.diag([-1.0, -1.0, 1.0])


def asked(model: ReferenceModel, frame: RgbdFrame, T: np.ndarray, **config: float) -> object:
    box = Box.of_mask(render_depth(model.mesh, T, frame.camera) > 0)
    estimator = Estimator({model.name: model}, EstimatorConfig(**config))
    return estimator.explain(frame, ObjectQuery(model.name, box))[0]


def test_poses_within_a_tenth_of_the_diameter_are_one_answer(tea_box: ReferenceModel) -> None:
    here = se3.make(np.eye(3), np.array([0.0, 0.0, 0.6]))
    step = tea_box.diameter_m * RIGHT
    near, far = here.copy(), here.copy()
    near[0, 3] += 0.9 * step
    far[0, 3] += 1.1 * step
    turned = here @ se3.make(UPSIDE_DOWN, np.zeros(3))
    poses = np.stack([here, near, far, turned])
    assert different_answers(tea_box, poses).tolist() == [0, 2, 3]
    same_texture = replace(tea_box, equivalents=np.stack([np.eye(4), se3.make(UPSIDE_DOWN, np.zeros(3))]))
    assert different_answers(same_texture, poses).tolist() == [0, 2]


def test_the_texture_is_complete_in_its_own_image_and_lacks_in_another(
    tea_box: ReferenceModel, take_picture: TakePicture, standing: np.ndarray
) -> None:
    other = demo_objects(1)["tea_box"]
    grey = replace(tea_box.mesh, texture=np.full_like(tea_box.mesh.texture, 128))
    found = {}
    yellow, blue = ((0.9, 0.8, 0.6), (0.5, 0.8, 1.0))
    for name, mesh, light in (
        ("own", tea_box.mesh, yellow),
        ("in blue light", tea_box.mesh, blue),
        ("other", other, yellow),
        ("grey", grey, yellow),
    ):
        frame = take_picture([(mesh, standing)], light=light)
        mask = render_depth(mesh, standing, frame.camera) > 0
        found[name] = texture_evidence(tea_box, region_in(frame, mask, tea_box.diameter_m), standing)
    assert found["own"].missing < 0.15
    assert found["own"].detail > 0.6
    assert found["other"].missing > 0.4
    assert found["other"].foreign > 2.0 * found["own"].foreign
    assert found["grey"].detail < 0.2
    # Light shifts all hues alike; those of the other texture are rotated by 69 degrees.
    assert max(found["own"].turned, found["in blue light"].turned, found["grey"].turned) < 0.1
    assert found["other"].turned > 0.4


def test_a_look_alike_is_doubted_and_an_empty_box_holds_nothing(
    tea_box: ReferenceModel, take_picture: TakePicture, standing: np.ndarray
) -> None:
    own = asked(tea_box, take_picture([(tea_box.mesh, standing)]), standing)
    alike = asked(tea_box, take_picture([(demo_objects(1)["tea_box"], standing)]), standing)
    assert own.state == "TRACKING"
    assert alike.quality < 0.6 * own.quality
    assert alike.state != "TRACKING"
    assert own.terms.otherwise < 0.2 < 0.5 < alike.terms.otherwise
    assert own.terms.agreed > 1.0 > 0.6 > alike.terms.agreed
    ball = demo_objects(0)["soup_can"]
    small: Mesh = replace(ball, vertices=0.5 * ball.vertices)
    nothing = asked(tea_box, take_picture([(small, standing)]), standing)
    assert not nothing.found
    assert (nothing.T_cam_obj, nothing.quality, nothing.state) == (None, 0.0, "LOST")
    assert nothing.terms is not None
    forced = asked(tea_box, take_picture([(small, standing)]), standing, found_level=0.0)
    assert forced.found
    assert forced.quality < 0.3


def test_the_probabilities_of_a_tie_sum_to_at_most_one(
    tea_box: ReferenceModel, take_picture: TakePicture, standing: np.ndarray
) -> None:
    """A texture that is the same upside down gives two equally likely poses."""
    half = tea_box.mesh
    answer = asked(tea_box, take_picture([(half, standing)], light=(0.3, 0.3, 0.3)), standing)
    total = answer.quality + sum(p for _, p in answer.alternatives)
    assert total <= 1.0 + 1e-9
    assert all(p <= answer.quality for _, p in answer.alternatives)
    assert answer.alternatives == tuple(sorted(answer.alternatives, key=lambda item: -item[1]))
    assert answer.margin == pytest.approx(answer.terms.margin)
