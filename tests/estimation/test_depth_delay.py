"""Depth that is older than colour is noticed on moving objects, and its delay is measured. Wrong
registration, static objects and objects without depth steps are not mistaken for it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest

from huepose.estimation.depth_delay import DepthDelay, EdgeLag, delay, edge_lag
from huepose.geometry import RgbdFrame, se3
from huepose.judge.borders import Contours
from huepose.model.types import ReferenceModel
from tests.conftest import TakePicture, standing_pose

HZ, LOOKS = 15, 24
Path = Callable[[float], np.ndarray]


def about(t: float) -> np.ndarray:
    """To and fro on a table, up to 0.3 m/s."""
    return standing_pose(0.6 + 0.3 * t, 0.06 * np.sin(5.0 * t), 0.04 * np.cos(4.0 * t))


def straight(t: float) -> np.ndarray:
    """One way at one speed."""
    return standing_pose(0.6, 0.25 * t - 0.2, 0.0)


@lru_cache(maxsize=LOOKS)
def pictured(model: ReferenceModel, take_picture: TakePicture, path: Path, t: float) -> RgbdFrame:
    """The frame of an object on its path."""
    return take_picture([(model.mesh, path(t))])


def looks(
    model: ReferenceModel, take_picture: TakePicture, late_s: float, path: Path = about, right_px: int = 0
) -> tuple[list[EdgeLag], list[str]]:
    """Looks at an object on its path. late_s: the delay of depth; right_px: its offset to the right."""
    found, blocks = [], []
    for k in range(LOOKS):
        t = k / HZ
        frame = pictured(model, take_picture, path, t)
        depth = frame.depth if late_s == 0.0 else take_picture([(model.mesh, path(t - late_s))]).depth
        velocity = se3.difference(path(t - 0.005), path(t + 0.005)) / 0.01
        seen = replace(frame, depth=np.roll(depth, right_px, axis=1))
        one = edge_lag(Contours.of(model), path(t), velocity, seen)
        if one is not None:
            found.append(one)
            blocks.append(str(6 * k // HZ))
    return found, blocks


@pytest.mark.parametrize("late_ms", [-33.0, 0.0, 17.0, 33.0, 66.0])
def test_the_delay_of_depth_is_measured(
    tea_box: ReferenceModel, take_picture: TakePicture, late_ms: float
) -> None:
    found = delay(*looks(tea_box, take_picture, late_ms / 1000))
    assert found is not None
    assert 1000 * found.seconds == pytest.approx(late_ms, abs=3.0)
    assert found.error_s < 0.006
    assert found.none == (late_ms == 0.0)
    assert found.clear == (abs(late_ms) > 20.0)


@pytest.mark.parametrize(("late_ms", "right_px"), [(0.0, 4), (33.0, 4), (33.0, -4)])
def test_depth_that_lies_beside_the_colours_is_not_late(
    tea_box: ReferenceModel, take_picture: TakePicture, late_ms: float, right_px: int
) -> None:
    found = delay(*looks(tea_box, take_picture, late_ms / 1000, right_px=right_px))
    assert found is not None
    assert 1000 * found.seconds == pytest.approx(late_ms, abs=4.0)
    assert found.clear == (late_ms > 0.0)


def test_motion_one_way_at_one_speed_does_not_distinguish_delay_from_offset(
    tea_box: ReferenceModel, take_picture: TakePicture
) -> None:
    found = delay(*looks(tea_box, take_picture, 0.0, straight, right_px=-5))
    assert found is not None
    assert not found.clear
    assert not found.none


def test_a_static_object_or_one_without_a_background_says_nothing(
    tea_box: ReferenceModel, box_frame: RgbdFrame, standing: np.ndarray
) -> None:
    contours = Contours.of(tea_box)
    moving = np.array([0.2, 0.0, 0.0, 0.0, 0.0, 0.0])
    assert edge_lag(contours, standing, moving, box_frame) is not None
    assert edge_lag(contours, standing, np.zeros(6), box_frame) is None
    assert (
        edge_lag(contours, standing, moving, replace(box_frame, depth=np.zeros_like(box_frame.depth))) is None
    )
    assert (
        edge_lag(contours, standing, moving, replace(box_frame, depth=np.full_like(box_frame.depth, 0.7)))
        is None
    )
    outside = standing.copy()
    outside[0, 3] += 2.0
    assert edge_lag(contours, outside, moving, box_frame) is None


def test_few_looks_and_those_of_one_moment_say_nothing() -> None:
    many = [(100.0 + k, 1.0, 0.0, 3.0) for k in range(30)]
    assert delay(many[:7], [str(k) for k in range(7)]) is None
    assert delay(many, ["0"] * 10 + ["1"] * 10 + ["2"] * 10) is None


def test_looks_that_agree_on_nothing_are_not_clear() -> None:
    rng = np.random.default_rng(0)
    for _ in range(20):
        angle, off = rng.uniform(0, 2 * np.pi, 60), rng.uniform(-20, 20, 60)
        rows = zip(rng.uniform(60, 400, 60), np.cos(angle), np.sin(angle), off, strict=True)
        found = delay([tuple(map(float, row)) for row in rows], [str(k // 4) for k in range(60)])
        assert found is None or not found.clear


def test_the_finding_is_said_in_words() -> None:
    late = DepthDelay(0.0331, 0.002, 0.9)
    assert late.said().startswith("Depth is about 35 ms older than colour")
    assert DepthDelay(-0.0331, 0.002, 0.9).said().startswith("Depth is about 35 ms newer than colour")
    assert late.clear
    assert not replace(late, share=0.4).clear
    assert not replace(late, error_s=0.007).clear
    assert not replace(late, seconds=0.007, error_s=0.0).clear
