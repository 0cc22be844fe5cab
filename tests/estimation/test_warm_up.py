"""Compiling a kernel at the first frame that needs it would delay the estimator by seconds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from huepose.estimation import Estimator, EstimatorConfig, ObjectQuery
from huepose.estimation.config import Method
from huepose.estimation.types import PosePrior
from huepose.geometry import Box, Camera, RgbdFrame, se3
from huepose.model.types import ReferenceModel
from huepose.rendering.render import render_depth
from huepose.select.distinct import Ranked
from huepose.select.near_ties import decided
from tests.boxes import box_of
from tests.kernels import compiled


@pytest.mark.timeout(300)  # without `make collected` it compiles the kernels of colour pairs
@pytest.mark.parametrize("method", ["full", "colorpair"])
def test_no_kernel_is_compiled_after_the_warm_up(
    method: Method, tea_box: ReferenceModel, box_frame: RgbdFrame, standing: np.ndarray
) -> None:
    estimator = Estimator({"tea_box": tea_box}, EstimatorConfig(method=method))
    estimator.warm_up()
    before = compiled()
    if method == "colorpair":
        assert before["huepose.paper.ppf._vote"] >= 1  # used only if few classes are visible
    outline = render_depth(tea_box.mesh, standing, box_frame.camera) > 0
    corner = outline.copy()
    corner[:, int(np.median(np.nonzero(outline)[1])) :] = False
    for mask in (outline, corner):
        (answer,) = estimator.estimate(box_frame, [ObjectQuery("tea_box", Box.of_mask(mask))])
        assert answer.found
    assert compiled() == before


def test_no_near_tie_and_no_prior_waits_for_the_compiler(
    tea_box: ReferenceModel, box_frame: RgbdFrame, standing: np.ndarray
) -> None:
    estimator = Estimator({"tea_box": tea_box})
    estimator.warm_up()
    before = compiled()
    frame = replace(box_frame, frame_id=2)
    box = box_of(frame, tea_box, standing)
    prior = PosePrior(se3.perturb(standing, np.full(6, 0.002)))
    _, seen = estimator.explain(frame, ObjectQuery("tea_box", box, prior=prior))
    assert seen.evidence is not None
    rivals = np.stack([standing, se3.perturb(standing, np.array([0.0, 0.0, 0.0, 0.0, 0.2, 0.0]))])
    _, held = decided(tea_box, seen.evidence.region, Ranked.of(rivals, np.array([2.0, 1.99])))
    assert held is not None
    assert compiled() == before


def test_a_frame_as_drivers_and_slices_give_it_waits_for_no_compiler(
    tea_box: ReferenceModel, box_frame: RgbdFrame, standing: np.ndarray
) -> None:
    """Integers and float32 in the camera, images that are views, read-only images."""
    estimator = Estimator({"tea_box": tea_box})
    estimator.warm_up()
    before = compiled()
    c, depth = box_frame.camera, np.asfortranarray(box_frame.depth)
    depth.setflags(write=False)
    blue_first = np.ascontiguousarray(box_frame.color[..., ::-1])
    whole = Camera(round(c.fx), round(c.fy), np.float32(c.cx), np.int64(c.cy), np.int64(c.width), c.height)
    given = RgbdFrame(blue_first[..., ::-1], depth, whole)
    (answer,) = estimator.estimate(given, [ObjectQuery("tea_box", box_of(box_frame, tea_box, standing))])
    assert answer.found
    assert compiled() == before
