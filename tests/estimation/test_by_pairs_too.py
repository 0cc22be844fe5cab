"""Colour pairs decide what the dense score leaves as a near-tie, and nothing else."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from huepose.estimation.by_pairs_too import WEIGHT, ordered_by_pairs_too, pair_colors
from huepose.geometry import Box, RgbdFrame
from huepose.model.types import ReferenceModel
from huepose.rendering.render import render_depth
from huepose.verification.region import prepare_region


def test_a_near_tie_is_decided_and_a_clear_lead_is_not(
    tea_box: ReferenceModel, take_picture: Callable[..., RgbdFrame], standing: np.ndarray
) -> None:
    frame = take_picture([(tea_box.mesh, standing)], light=(0.9, 0.7, 0.6))
    mask = render_depth(tea_box.mesh, standing, frame.camera) > 0
    box = Box.of_mask(mask)
    assert box is not None
    region = prepare_region(frame, mask, box, tea_box.diameter_m)
    assert region is not None
    poses = np.stack([standing @ tea_box.turns[1], standing])  # the wrong way round first
    wrong, right = pair_colors(tea_box, region, poses)
    assert right > wrong + 0.3

    clear = np.array([2.0, 1.0])
    same, totals = ordered_by_pairs_too(tea_box, region, poses, clear)
    np.testing.assert_array_equal(same, poses)
    np.testing.assert_array_equal(totals, clear)

    near = np.array([2.0, 1.99])
    found, totals = ordered_by_pairs_too(tea_box, region, poses, near)
    np.testing.assert_array_equal(found, poses[::-1])
    assert totals[0] == 1.99  # its own
    assert totals[0] - totals[1] == pytest.approx(WEIGHT * (right - wrong) - 0.01)
    alone, one = ordered_by_pairs_too(tea_box, region, poses[:1], near[:1])
    assert (len(alone), one[0]) == (1, 2.0)
