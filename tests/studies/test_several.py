"""All of a kind are found, and nothing is taken for one more."""

from __future__ import annotations

import numpy as np

from huepose.geometry import se3
from studies import several
from studies.several import Row, report, watched


def test_all_of_a_kind_are_found_and_no_more(tea_box, take_picture, standing, monkeypatch) -> None:
    """Three stand side by side, 3 mm apart."""
    monkeypatch.setattr(several, "SECONDS", 2)
    sides = np.ptp(tea_box.mesh.bounds, axis=0)
    apart = np.where(sides == sides.min(), sides + 0.003, 0.0)
    truths = [standing @ se3.make(np.eye(3), apart * (k - 1)) for k in range(3)]
    frame = take_picture([(tea_box.mesh, T) for T in truths])
    first, right, wrong, twice = watched(frame, tea_box, truths, {0, 1, 2}, 2, np.random.default_rng(0))
    assert set(first) == {0, 1, 2}
    assert right > 50, "of 90"
    assert wrong == twice == 0


def test_the_report_counts_instances_and_poses() -> None:
    done = [
        Row("1", 0, "mug", 3, 2, (0.4, 1.0), 60, 80, 1, 0),
        Row("1", 1, "can", 2, 2, (0.2, 0.4), 60, 90, 0, 4),
    ]
    assert report(done) == (
        "found 4 of 5 instances, after (median, 90 %) 0.4 s, 0.8 s; "
        "TRACKING: 170 right, 1 wrong, 4 on one that has a pose"
    )
