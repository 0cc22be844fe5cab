"""Presence of the objects of a frame's answers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from huepose.believe.quality import features, quality_fits
from huepose.estimation import Estimator, ObjectQuery
from huepose.estimation.config import StandingConfig
from huepose.estimation.present import presences_of
from huepose.estimation.types import PoseEstimate
from huepose.geometry import Box
from huepose.rendering.render import render_depth


def test_an_answer_is_as_likely_as_its_object_is_there(tea_box, take_picture, standing) -> None:
    models = {"tea_box": tea_box}
    frame = take_picture([(tea_box.mesh, standing)])
    box = Box.of_mask(render_depth(tea_box.mesh, standing, frame.camera) > 0)
    (there,) = Estimator(models).estimate(frame, [ObjectQuery("tea_box", box)])
    beside = standing.copy()
    beside[0, 3] += 0.5 * tea_box.diameter_m
    answers = [there, replace(there, T_cam_obj=beside), PoseEstimate("tea_box")]
    chances = presences_of(frame, models, answers, "full")
    assert chances[0] > 0.9
    assert chances[1] < 0.5 * StandingConfig().present  # for all that it claims to be sure
    assert chances[2] == 0.0


def test_a_shape_in_another_texture_is_another_thing(tea_box, take_picture, standing) -> None:
    models = {"tea_box": tea_box}
    texture = np.ascontiguousarray(tea_box.mesh.texture[::-1, ::-1, ::-1])
    frame = take_picture([(replace(tea_box.mesh, texture=texture), standing)])
    box = Box.of_mask(render_depth(tea_box.mesh, standing, frame.camera) > 0)
    (answer,) = Estimator(models).estimate(frame, [ObjectQuery("tea_box", box)])
    assert presences_of(frame, models, [replace(answer, T_cam_obj=standing)], "full")[0] < 0.5


def test_another_texture_is_judged_by_the_method_that_answered(tea_box, take_picture, standing) -> None:
    """Contrasts that point elsewhere speak against an answer by as much as its method's own fit says."""
    models = {"tea_box": tea_box}
    frame = take_picture([(tea_box.mesh, standing)])
    box = Box.of_mask(render_depth(tea_box.mesh, standing, frame.camera) > 0)
    (answer,) = Estimator(models).estimate(frame, [ObjectQuery("tea_box", box)])
    lacking = replace(answer, terms=replace(answer.terms, turned=0.5, otherwise=0.9, agreed=0.0))
    left = {}
    for method in ("full", "colorpair"):
        own, other = (presences_of(frame, models, [a], method)[0] for a in (answer, lacking))
        chance = quality_fits()[method].this_texture(features(lacking.terms))
        left[method] = other / own
        assert left[method] == pytest.approx(
            min(1.0, StandingConfig().other_texture * chance / (1.0 - chance)), rel=1e-6
        )
        assert left[method] < 0.5
    assert left["full"] != pytest.approx(left["colorpair"], rel=0.05)
