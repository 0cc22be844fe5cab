"""A kernel that is compiled at the first frame that needs it holds the estimator up for seconds."""

from __future__ import annotations

import gc
from collections.abc import Callable

import numpy as np
import pytest
from numba.core.dispatcher import Dispatcher

from huepose.estimation import Estimator, EstimatorConfig, ObjectQuery
from huepose.estimation.config import Method
from huepose.geometry import Box, RgbdFrame
from huepose.model.types import ReferenceModel
from huepose.rendering.render import render_depth


def compiled() -> dict[str, int]:
    """How often each kernel was compiled, or read from the cache: once for each layout of its arrays."""
    kernels = [k for k in gc.get_objects() if isinstance(k, Dispatcher)]
    return {f"{k.py_func.__module__}.{k.py_func.__name__}": len(k.signatures) for k in kernels}


@pytest.mark.parametrize("method", ["full", "colorpair"])
def test_no_kernel_is_compiled_after_the_warm_up(
    method: Method, tea_box: ReferenceModel, take_picture: Callable[..., RgbdFrame], standing: np.ndarray
) -> None:
    estimator = Estimator({"tea_box": tea_box}, EstimatorConfig(method=method))
    estimator.warm_up()
    before = compiled()
    if method == "colorpair":
        assert before["huepose.matching.ppf._vote"] >= 1  # asked only where few classes are in sight
    frame = take_picture([(tea_box.mesh, standing)])
    outline = render_depth(tea_box.mesh, standing, frame.camera) > 0
    corner = outline.copy()
    corner[:, int(np.median(np.nonzero(outline)[1])) :] = False
    for mask in (outline, corner):
        (answer,) = estimator.estimate(frame, [ObjectQuery("tea_box", Box.of_mask(mask))])
        assert answer.found
    assert compiled() == before
