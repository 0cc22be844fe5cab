"""A network distinguishes images of an object in its pose from images of something else."""

from __future__ import annotations

import hashlib
import json

import numpy as np
import pytest

from huepose.geometry import icosphere
from huepose.geometry.arrays import Float32, UInt8
from huepose.model.types import ReferenceModel
from huepose.perception.verification import SUREST, WEIGHTS, verified
from huepose.propose.view_images import clean_view

LOOKS = [icosphere.look_at(d) for d in icosphere.directions(1)[:10]]


@pytest.fixture(scope="module")
def views(tea_box: ReferenceModel) -> tuple[UInt8, Float32]:
    rendered = [clean_view(tea_box.mesh, tea_box.diameter_m, R) for R in LOOKS]
    return np.stack([v.color for v in rendered]), np.stack([v.relief for v in rendered])


def before_a_wall(views: tuple[UInt8, Float32], brightness: float) -> tuple[UInt8, Float32]:
    """Windows that show the views in other light, in front of a grey wall, with camera noise."""
    rng = np.random.default_rng(0)
    there = np.isfinite(views[1])
    color = np.where(there[..., None], brightness * views[0], 110.0) + rng.normal(0.0, 4.0, views[0].shape)
    relief = np.where(there, views[1], np.float32(1.5)) + rng.normal(0.0, 0.01, views[1].shape)
    return np.clip(color, 0, 255).astype(np.uint8), relief.astype(np.float32)


@pytest.mark.parametrize("brightness", [0.6, 1.0])
def test_an_object_is_distinguished_from_one_of_other_colours_and_from_an_empty_place(
    views: tuple[UInt8, Float32], brightness: float
) -> None:
    windows = before_a_wall(views, brightness)
    right = verified(windows, views)
    assert np.median(right) > 3.0
    there = np.isfinite(views[1])[..., None]
    painted = np.where(there, 255 - views[0][..., ::-1], 0).astype(np.uint8), views[1]
    assert np.median(verified(windows, painted)) < np.median(right) - 4.0
    nothing = np.full_like(windows[0], 110), np.full_like(windows[1], 1.5)
    assert (verified(nothing, views) < 0.0).all()


def test_log_odds_are_bounded_and_do_not_depend_on_what_else_is_asked(
    views: tuple[UInt8, Float32],
) -> None:
    windows = before_a_wall(views, 1.0)
    all_at_once = verified(windows, views)
    assert (np.abs(all_at_once) <= SUREST).all()
    twice = (
        tuple(np.concatenate([part, part]) for part in windows),
        tuple(np.concatenate([p, p]) for p in views),
    )
    np.testing.assert_allclose(verified(*twice), np.tile(all_at_once, 2), atol=1e-5)
    assert verified((views[0][:0], views[1][:0]), (views[0][:0], views[1][:0])).shape == (0,)


def test_the_network_file_matches_its_record() -> None:
    record = json.loads((WEIGHTS / "verification.json").read_text())
    assert hashlib.sha256((WEIGHTS / "verification.onnx").read_bytes()).hexdigest() == record["sha256"]
