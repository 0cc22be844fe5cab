"""An object of the same print in another size is doubted alone; if all objects look wrong, the camera is."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from huepose.estimation import Estimator, ObjectQuery
from huepose.estimation.apparent_size import (
    CLEAR_OF_ONE,
    INDEPENDENT,
    QUARTERS,
    SCALES,
    doubted_camera,
    doubted_in,
    doubted_objects,
)
from huepose.estimation.types import PoseEstimate
from huepose.geometry import RgbdFrame
from huepose.geometry.arrays import Float64
from huepose.model.types import ReferenceModel
from huepose.perception.view_detector import ViewDetector


def look(larger: float, gain: float) -> Float64:
    """A look that is evidence for one size alone, whatever part of the object is left out."""
    return np.tile(np.where(np.isclose(SCALES, larger), gain, 0.0), (1 + QUARTERS, 1))


LARGE, FITS = look(0.12, 30.0), look(0.0, 60.0)


def test_with_a_single_object_the_camera_is_doubted() -> None:
    camera = doubted_camera({"can": [LARGE]})
    assert camera is not None
    assert camera.larger == pytest.approx(0.12)
    assert doubted_objects({"can": [LARGE], "carton": []}) == {}


def test_with_a_single_object_five_percent_may_come_from_its_mesh() -> None:
    assert doubted_camera({"can": [look(0.05, 30.0)]}) is None
    assert doubted_camera({"can": [look(0.06, 30.0)]}) is not None
    assert doubted_camera({"can": [look(0.05, 30.0)], "carton": [look(0.05, 30.0)]}) is not None


@pytest.mark.parametrize("fits", [FITS, look(0.0, 12.0), look(0.0, 4.0)])
def test_while_another_fits_only_the_object_is_doubted(fits: Float64) -> None:
    """Also if its evidence is stronger than that of the one that fits, which alone would not be clear."""
    seen = {"can": [LARGE], "carton": [fits]}
    assert doubted_camera(seen) is None
    assert list(doubted_objects(seen)) == ["can"]


def test_an_object_without_evidence_does_not_clear_the_camera() -> None:
    assert doubted_camera({"can": [LARGE], "packet": [np.zeros_like(LARGE)]}) is not None


def test_a_size_that_all_but_a_few_share_comes_from_the_camera() -> None:
    seen = {name: [LARGE] for name in "abc"}
    assert doubted_camera(seen | {"d": [look(0.0, 12.0)]}) is not None
    assert doubted_camera({name: [LARGE] for name in "ab"} | {"d": [look(0.0, 12.0)]}) is None


def test_larger_and_smaller_sizes_are_the_objects_own() -> None:
    seen = {"can": [LARGE], "carton": [look(-0.12, 25.0)]}
    assert doubted_camera(seen) is None
    assert set(doubted_objects(seen)) == {"can", "carton"}


def test_an_object_near_the_common_size_is_not_doubted() -> None:
    """A camera that shows all 4 % smaller shows one of them 7 % smaller."""
    smaller, own = look(-0.04, 60.0), look(-0.07, 30.0)
    assert doubted_objects({"a": [smaller], "b": [own]}) == {}
    assert list(doubted_objects({"a": [FITS], "b": [own]})) == ["b"]
    large = look(0.15, 200.0)
    assert list(doubted_objects({"a": [smaller], "b": [own], "c": [smaller], "d": [large]})) == ["d"]


def test_looks_at_a_static_object_add_up_to_few() -> None:
    weak = look(0.12, 0.9)
    assert doubted_objects({"can": [weak] * 12, "carton": [FITS]}) == {}
    assert INDEPENDENT * 1.1 > CLEAR_OF_ONE
    assert list(doubted_objects({"can": [look(0.12, 1.1)] * 3, "carton": [FITS]})) == ["can"]


def test_the_evidence_of_one_side_alone_is_no_size() -> None:
    """It may be a neighbour's edge, or an occluder at a corner."""
    one_sided = LARGE.copy()
    one_sided[2] = look(0.0, 5.0)[0]
    assert doubted_objects({"can": [one_sided], "carton": [FITS]}) == {}
    assert list(doubted_objects({"can": [LARGE], "carton": [FITS]})) == ["can"]


def test_a_doubt_waits_for_as_many_looks_as_are_asked_for() -> None:
    assert doubted_camera({"can": [LARGE] * 2}, 3) is None
    assert doubted_objects({"can": [LARGE] * 2, "carton": [FITS]}, 3) == {}
    assert list(doubted_objects({"can": [LARGE] * 3, "carton": [FITS]}, 3)) == ["can"]


def answers_about(frame: RgbdFrame, models: dict[str, ReferenceModel]) -> list[PoseEstimate]:
    """The answers about the objects that the detector finds in a frame."""
    places = ViewDetector(models).detect(frame, sorted(models))
    best = {place.object: place.box for place in places[::-1]}
    return Estimator(models).estimate(frame, [ObjectQuery(name, best[name]) for name in sorted(models)])


@pytest.mark.parametrize("times", [0.87, 1.15])
def test_in_a_frame_the_object_of_another_size_is_doubted(
    times: float, box_and_can: dict[str, ReferenceModel], larger_box: Callable[[float], RgbdFrame]
) -> None:
    frame = larger_box(times)
    answers = answers_about(frame, box_and_can)
    camera, objects = doubted_in(frame, box_and_can, answers)
    assert camera is None
    ((which, size),) = objects.items()
    assert answers[which].object == "tea_box"
    # A nearer or farther pose explains a part of it.
    assert 0.4 < size.larger / (times - 1.0) < 1.2
    assert (
        f"{'larger' if times > 1.0 else 'smaller'} than its mesh, while other objects fit"
        in size.said_of_one()
    )


def test_with_a_wrong_camera_matrix_the_camera_is_doubted_and_no_object(
    box_and_can: dict[str, ReferenceModel], larger_box: Callable[[float], RgbdFrame]
) -> None:
    frame = larger_box(1.0)
    assert doubted_in(frame, box_and_can, answers_about(frame, box_and_can)) == (None, {})
    camera = replace(frame.camera, fx=0.9 * frame.camera.fx, fy=0.9 * frame.camera.fy)
    frame = replace(frame, camera=camera)
    size, objects = doubted_in(frame, box_and_can, answers_about(frame, box_and_can))
    assert size is not None
    assert 0.045 < size.larger < 0.15
    assert objects == {}
