"""What is there is TRACKING soon, what is not there never."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from studies import still
from studies.still import Row, likely, report, watched


def test_what_is_there_is_found_and_what_is_not_there_is_not(
    tea_box, take_picture, standing, monkeypatch
) -> None:
    monkeypatch.setattr(still, "SECONDS", 1)
    frame = take_picture([(tea_box.mesh, standing)])
    rng = np.random.default_rng(0)
    there = watched(frame, tea_box, standing, rng)
    assert there[-1] == 1
    assert -1 not in there
    moved = standing.copy()
    moved[0, 3] += 0.3 * tea_box.diameter_m
    assert watched(frame, tea_box, moved, rng)[-1] == -1, "TRACKING, but not where it is said to be"
    texture = np.ascontiguousarray(tea_box.mesh.texture[::-1, ::-1, ::-1])
    other = take_picture([(replace(tea_box.mesh, texture=texture), standing)])
    assert set(watched(other, tea_box, None, rng)) == {0}
    assert likely(frame, tea_box)
    assert not likely(take_picture([]), tea_box)


def test_the_report_counts_frames_and_films() -> None:
    done = [
        Row("1", 0, "mug", True, 90, 80, 0, 0.4),
        Row("1", 0, "can", True, 90, 10, 5, 3.0),
        Row("1", 0, "box", False, 90, 0, 20, None),
        Row("1", 0, "jar", False, 90, 0, 0, None),
    ]
    assert report(done) == (
        "there: 1 of 2 TRACKING and right within 2 s; right in 90 of 180 frames, wrong in 5\n"
        "not there: false TRACKING in 20 of 180 frames, in 1 of 2 films"
    )
