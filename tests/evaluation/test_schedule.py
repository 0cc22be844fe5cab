"""When frames are estimated and when their results are delivered."""

from __future__ import annotations

import pytest

from huepose.evaluation.track_protocol import fed_images, late_deliveries
from huepose.support.errors import InputError


def at_30_hz(*numbers: int) -> list[int]:
    return [round(n * 1e9 / 30) for n in numbers]


def test_at_30_hz_every_sixth_frame_is_estimated_and_delivered_six_frames_later() -> None:
    stamps = [round(round(i / 30, 6) * 1e9) for i in range(61)]  # as data.txt states them
    assert late_deliveries(stamps) == tuple((i, i + 6 if i + 6 <= 60 else None) for i in range(0, 61, 6))


def test_with_every_fifth_frame_the_newest_fed_frame_is_estimated() -> None:
    # Fed at 0, 167, 333, 500, 667 ms; due at 0, 200, 400, 600 ms.
    deliveries = late_deliveries(at_30_hz(0, 5, 10, 15, 20))
    assert deliveries == ((0, 2), (1, 3), (2, 4), (3, None))


def test_frames_further_apart_than_a_period_are_estimated_once() -> None:
    assert late_deliveries(at_30_hz(0, 10, 20)) == ((0, 1), (1, 2))


def test_uneven_timestamps_are_scheduled() -> None:
    stamps = [ms * 1_000_000 for ms in (1000, 1048, 1190, 1230, 1399, 1420, 1610)]
    # Due at 1000, 1200, 1400 (within a millisecond of 1399), 1600.
    assert late_deliveries(stamps) == ((0, 3), (2, 4), (4, 6), (5, None))


def test_every_counts_from_the_first_number() -> None:
    assert fed_images([7, 8, 9, 11, 12, 17], 5) == (7, 12, 17)
    assert fed_images([7, 8], 1) == (7, 8)
    with pytest.raises(InputError, match="--every"):
        fed_images([1], 0)
