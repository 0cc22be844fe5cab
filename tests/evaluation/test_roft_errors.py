"""ROFT's errors of a track, on motions with hand-computed values."""

from __future__ import annotations

import numpy as np
import pytest

from huepose.evaluation.metrics import roft_figures
from huepose.geometry import se3

STAMPS = [round(i * 1e8) for i in range(6)]  # ten frames a second


def at(x: float, angle: float = 0.0) -> np.ndarray:
    return se3.make(se3.rotation_exp([0, 0, angle]), [x, 0, 1])


TRUTHS = [at(0.02 * i, 0.1 * i) for i in range(6)]


def test_a_true_track_has_no_error() -> None:
    figures = roft_figures(TRUTHS, TRUTHS, STAMPS)
    assert all(v == pytest.approx(0.0, abs=1e-6) for v in figures.values())


def test_an_offset_and_a_rotation_are_measured() -> None:
    """30 mm off in half of the frames and 0.2 rad in all frames: sqrt(9 / 2) cm, 11.46 degrees."""
    poses = [at(0.02 * i + 0.03 * (i % 2), 0.1 * i + 0.2) for i in range(6)]
    figures = roft_figures(poses, TRUTHS, STAMPS)
    assert figures["rmse_cm"] == pytest.approx(np.sqrt(4.5))
    assert figures["rmse_deg"] == pytest.approx(np.degrees(0.2))
    assert figures["rmse_deg_s"] == pytest.approx(0.0, abs=1e-6)
    assert figures["rmse_cm_s"] == pytest.approx(30.0)  # 3 cm to and fro in a tenth of a second


def test_a_published_velocity_is_used() -> None:
    """The truth moves at 20 cm/s and 1 rad/s; 25 cm/s and no rotation are published."""
    published = [np.array([0.25, 0, 0, 0, 0, 0])] * 6
    figures = roft_figures(TRUTHS, TRUTHS, STAMPS, published)
    assert figures["rmse_cm_s"] == pytest.approx(5.0)
    assert figures["rmse_deg_s"] == pytest.approx(np.degrees(1.0))


def test_missing_poses_repeat_the_last_and_frames_before_the_first_are_left_out() -> None:
    poses = [None, TRUTHS[1], None, None, TRUTHS[4], TRUTHS[5]]
    figures = roft_figures(poses, TRUTHS, STAMPS)
    assert figures["rmse_cm"] == pytest.approx(np.sqrt((2**2 + 4**2) / 5))  # 2 and 4 cm behind, of 5 frames
    assert roft_figures([None] * 6, TRUTHS, STAMPS)["rmse_cm"] is None


def test_frames_with_the_same_timestamp_have_no_velocity() -> None:
    """Of frames 1 to 4, those with a frame before of the same time have no published velocity."""
    stamps = [0, 100_000_000, 100_000_000, 300_000_000, 300_000_000, 300_000_000]
    figures = roft_figures(TRUTHS, TRUTHS, stamps)
    assert figures["rmse_cm"] == pytest.approx(0.0, abs=1e-6)
    assert figures["rmse_cm_s"] is not None
    assert np.isfinite(figures["rmse_cm_s"])
    assert roft_figures(TRUTHS, TRUTHS, [0] * 6)["rmse_cm_s"] is None
