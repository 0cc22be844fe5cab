"""A changed scene has the same labels, and a colour image or a depth image that differs as its form says."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from huepose.datasets.bop import BopScene
from huepose.datasets.bop_writer import BopWriter, Label
from huepose.geometry import Box, Camera, se3
from studies.changed import COLORS, DEPTHS, FORMS, write_changed

WIDTH, HEIGHT = 96, 72


@pytest.fixture
def scene(tmp_path: Path) -> BopScene:
    rng = np.random.default_rng(0)
    color = rng.integers(40, 120, (HEIGHT, WIDTH, 3)).astype(np.uint8)
    depth = np.full((HEIGHT, WIDTH), 1.0, np.float32)
    depth[20:40, 30:60] = 0.8
    box = Box(30, 20, 30, 20)
    label = Label(5, se3.make(np.eye(3), np.array([0.0, 0.0, 0.8])), depth < 0.9, 600, box)
    writer = BopWriter(tmp_path / "set" / "000001", {}, ".png")
    writer.add(4, color, depth, Camera(100.0, 100.0, 47.5, 35.5, WIDTH, HEIGHT), [label])
    return BopScene(tmp_path / "set" / "000001")


@pytest.mark.parametrize("form", FORMS)
def test_labels_stay_and_one_of_colour_and_depth_changes(scene: BopScene, form: str, tmp_path: Path) -> None:
    write_changed(scene, form, tmp_path / form)
    before, changed = scene.frame(4), BopScene(tmp_path / form)
    after, (truth,), (label,) = changed.frame(4), changed.truths(4), scene.truths(4)
    np.testing.assert_array_equal(truth.T_cam_obj, label.T_cam_obj)
    assert (truth.box_visib, truth.visib_fract) == (label.box_visib, label.visib_fract)
    assert truth.mask is not None
    assert np.array_equal(after.color, before.color) == (form in DEPTHS)
    assert np.allclose(after.depth, before.depth, atol=5e-5) == (form in COLORS)


def test_light_and_borders_change_by_the_stated_amounts(scene: BopScene) -> None:
    frame = scene.frame(4)
    light = (np.array([100.0]) / 255.0) ** 2.2
    dark = COLORS["dark"](np.full((1, 1, 3), 100, np.uint8))
    assert dark[0, 0, 0] == round(255.0 * float(0.3 * light[0]) ** (1.0 / 2.2))
    red, green, blue = COLORS["warm"](np.full((1, 1, 3), 100, np.uint8))[0, 0]
    assert red > green == 100 > blue
    grown = DEPTHS["grown"](frame.depth)
    assert (grown < 0.9).sum() == (20 + 8) * (30 + 8), "four pixels on each side"
    error = DEPTHS["stereo"](frame.depth) - frame.depth
    assert 0.002 < error.std() < 0.008
    assert 0.05 < (DEPTHS["holes"](frame.depth) == 0.0).mean() < 0.35
