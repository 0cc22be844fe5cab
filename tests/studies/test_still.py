"""Present objects are TRACKING soon, all instances of them; absent objects never."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from huepose.geometry import se3
from studies.live import HZ
from studies.still import Outcome, Row, likely, report, watched


def outcome_of(frame, model, instances, wanted: int, count: int, rng: np.random.Generator) -> Outcome:
    """The outcome of an object whose model is the only one."""
    (outcome,) = watched(frame, {model.name: model}, {model.name: instances}, wanted, count, rng).values()
    return outcome


def test_a_present_object_is_found_and_an_absent_one_is_not(tea_box, take_picture, standing) -> None:
    frame = take_picture([(tea_box.mesh, standing)])
    rng = np.random.default_rng(0)
    found_s, right, wrong, twice, posed = outcome_of(frame, tea_box, [(standing, True)], 1, HZ, rng)
    assert right == HZ - round(found_s[0] * HZ) > 0
    assert wrong == twice == 0
    assert right <= posed <= HZ
    moved = standing.copy()
    moved[0, 3] += 0.3 * tea_box.diameter_m
    found_s, right, wrong, *_ = outcome_of(frame, tea_box, [(moved, True)], 1, HZ, rng)
    assert (found_s, right) == ((), 0), "TRACKING, but not at the labelled position"
    assert wrong > 0
    texture = np.ascontiguousarray(tea_box.mesh.texture[::-1, ::-1, ::-1])
    other = take_picture([(replace(tea_box.mesh, texture=texture), standing)])
    assert outcome_of(other, tea_box, [], 1, HZ, rng)[:4] == ((), 0, 0, 0)
    assert likely(frame, tea_box)
    assert not likely(take_picture([]), tea_box)


def test_all_instances_of_an_object_are_found_and_no_more(tea_box, take_picture, standing) -> None:
    """Three instances side by side, 3 mm apart."""
    sides = np.ptp(tea_box.mesh.bounds, axis=0)
    apart = np.where(sides == sides.min(), sides + 0.003, 0.0)
    truths = [standing @ se3.make(np.eye(3), apart * (k - 1)) for k in range(3)]
    frame = take_picture([(tea_box.mesh, T) for T in truths])
    instances = [(T, True) for T in truths]
    rng = np.random.default_rng(0)
    found_s, right, wrong, twice, _ = outcome_of(frame, tea_box, instances, 5, 2 * HZ, rng)
    assert len(found_s) == 3
    assert right > 50, "of 90"
    assert wrong == twice == 0


def test_of_several_objects_only_the_present_ones_are_found(
    tea_box, soup_can, take_picture, standing
) -> None:
    frame, models = take_picture([(tea_box.mesh, standing)]), {"tea_box": tea_box, "soup_can": soup_can}
    outcomes = watched(frame, models, {"tea_box": [(standing, True)]}, 1, HZ, np.random.default_rng(0))
    found_s, right, wrong, twice, _ = outcomes["tea_box"]
    assert right == HZ - round(found_s[0] * HZ) > 0
    assert wrong == twice == 0
    assert outcomes["soup_can"] == ((), 0, 0, 0, 0)


def test_the_report_counts_instances_and_films() -> None:
    done = [
        Row("1", 0, "mug", 1, 90, (0.4,), 80, 0, 0, 85),
        Row("1", 0, "can", 3, 90, (3.0, 4.0), 100, 5, 2, 170),
        Row("1", 0, "box", 0, 90, (), 0, 20, 0, 24),
        Row("1", 0, "jar", 0, 90, (), 0, 0, 0, 0),
    ]
    assert report(done) == (
        "there: 3 of 4 instances TRACKING and right, 1 within 2 s, (median, 90 %) 3.0 s, 3.8 s; "
        "right in 180 of 360 frames, wrong in 5, 2 on an instance with another pose\n"
        "absent: false TRACKING in 20 of 180 frames, of 1 of 2 objects; "
        "a pose of any state in 24 frames, of 1 objects"
    )
