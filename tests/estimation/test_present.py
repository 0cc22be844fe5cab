"""Presence of the object of an answer."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from huepose.believe.quality import features, quality_fits
from huepose.estimation import Estimator, ObjectQuery
from huepose.estimation.accepted import PRESENT
from huepose.estimation.present import OTHER_TEXTURE, PresenceIn
from huepose.estimation.types import PoseEstimate
from tests.boxes import box_of


def test_an_answer_is_no_more_likely_than_its_object_is_present(tea_box, box_frame, standing) -> None:
    models = {"tea_box": tea_box}
    box = box_of(box_frame, tea_box, standing)
    (there,) = Estimator(models).estimate(box_frame, [ObjectQuery("tea_box", box)])
    beside = standing.copy()
    beside[0, 3] += 0.5 * tea_box.diameter_m
    other = beside.copy()
    claimed = replace(there, T_cam_obj=beside, alternatives=((other, 0.1),))
    presence = PresenceIn(box_frame, models, "full")
    right, wrong, none = (presence.with_presence(a) for a in (there, claimed, PoseEstimate("tea_box")))
    assert there.present is None
    assert right.present > 0.9
    assert (right.quality, right.state) == (there.quality, "TRACKING")
    # However sure the answer claims to be, no pose is more probable than the presence of the object.
    assert wrong.present < 0.5 * PRESENT
    assert wrong.quality == pytest.approx(wrong.present)
    assert wrong.alternatives[0][1] == pytest.approx(0.1 * wrong.present / there.quality)
    assert wrong.state == "SUSPECT"
    assert (none.present, none.found, none.state) == (0.0, False, "LOST")


def test_presence_is_judged_only_for_what_a_search_proposed(tea_box, box_frame, standing) -> None:
    box = box_of(box_frame, tea_box, standing)
    queries = [ObjectQuery("tea_box", box), ObjectQuery("tea_box", box, searched=True)]
    estimator = Estimator({"tea_box": tea_box})
    given, searched = (estimator.estimate(box_frame, [query])[0] for query in queries)
    assert given.present is None
    asked = PresenceIn(box_frame, {"tea_box": tea_box}, "full").with_presence(given)
    assert searched.present == pytest.approx(asked.present)
    assert np.array_equal(given.T_cam_obj, searched.T_cam_obj)


def test_a_fitness_is_unchanged(tea_box, box_frame, standing) -> None:
    """The quality of the paper's method is no probability."""
    fit = PoseEstimate("tea_box", found=True, T_cam_obj=standing, quality=0.7, state="SUSPECT")
    asked = PresenceIn(box_frame, {"tea_box": tea_box}, "paper").with_presence(fit)
    assert asked.present > 0.9
    assert asked.quality == 0.7


def test_a_shape_in_another_texture_is_another_object(tea_box, take_picture, standing) -> None:
    models = {"tea_box": tea_box}
    texture = np.ascontiguousarray(tea_box.mesh.texture[::-1, ::-1, ::-1])
    frame = take_picture([(replace(tea_box.mesh, texture=texture), standing)])
    box = box_of(frame, tea_box, standing)
    (answer,) = Estimator(models).estimate(frame, [ObjectQuery("tea_box", box)])
    there = PresenceIn(frame, models, "full").with_presence(replace(answer, T_cam_obj=standing))
    assert there.present < 0.5


def test_another_texture_is_judged_by_the_method_that_answered(tea_box, box_frame, standing) -> None:
    """Contrasts that disagree lower the presence by as much as the fit of the answer's method says."""
    models = {"tea_box": tea_box}
    box = box_of(box_frame, tea_box, standing)
    (answer,) = Estimator(models).estimate(box_frame, [ObjectQuery("tea_box", box)])
    lacking = replace(answer, terms=replace(answer.terms, turned=0.5, otherwise=0.9, agreed=0.0))
    left = {}
    for method in ("full", "colorpair"):
        presence = PresenceIn(box_frame, models, method)
        own, other = (presence.with_presence(a).present for a in (answer, lacking))
        chance = quality_fits()[method].this_texture(features(lacking.terms))
        left[method] = other / own
        assert left[method] == pytest.approx(min(1.0, OTHER_TEXTURE * chance / (1.0 - chance)), rel=1e-6)
        assert left[method] < 0.5
    assert left["full"] != pytest.approx(left["colorpair"], rel=0.05)
