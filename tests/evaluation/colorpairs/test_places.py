"""Places of colour pairs: on a clear view all of them find the pose; figures are those of hand-made rows;
what was answered is not asked again."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from huepose.datasets.types import GroundTruth
from huepose.estimation.prepared import PreparedModels
from huepose.evaluation.colorpairs.place_answers import shared_of
from huepose.evaluation.colorpairs.place_figures import (
    ALL,
    figures_of,
    place_lines,
    question_entry,
    question_of,
)
from huepose.evaluation.colorpairs.place_study import PlaceRow, Question, StudySet, study_places
from huepose.evaluation.colorpairs.places import SHIPPED, places_of
from huepose.evaluation.targets import Targets
from huepose.geometry import Box, RgbdFrame
from huepose.geometry.arrays import Bool
from huepose.model.types import ReferenceModel
from huepose.rendering.render import render_depth


class _TrueMask:
    """A segmenter that knows the answer."""

    def __init__(self, mask: Bool) -> None:
        self._mask = mask

    def segment(self, frame: RgbdFrame, box: Box, diameter_m: float) -> list[Bool]:
        return [self._mask]


def test_every_place_finds_a_box_in_plain_sight_and_costs_what_it_shares(
    tea_box: ReferenceModel, take_picture: Callable[..., RgbdFrame], standing: np.ndarray
) -> None:
    frame = take_picture([(tea_box.mesh, standing)], light=(0.9, 0.8, 0.7))
    mask = render_depth(tea_box.mesh, standing, frame.camera) > 0
    box = Box.of_mask(mask)
    assert box is not None
    table = PreparedModels({"tea_box": tea_box}).prepared("tea_box").table
    shared = shared_of(frame, box, tea_box, table, _TrueMask(mask), (0,))
    assert shared is not None
    places = places_of(shared)
    assert next(iter(places)) == SHIPPED
    for place, found in places.items():
        ended = shared.ended(found.poses, found.totals, found.weight, found.method, found.edges)
        assert ended.T_cam_obj is not None, place
        assert np.linalg.norm(ended.T_cam_obj[:3, 3] - standing[:3, 3]) < 0.003, place
    assert not shared.in_doubt
    shipped = places[SHIPPED].seconds
    assert places["few hypotheses, in doubt"].seconds == shipped
    assert places["hypotheses, always"].seconds > shared.spent("whole proposed")
    assert places["refinement by semantic ICP"].seconds > shared.spent("slid")


def _question(image: int, set_name: str = "set", **add_mm: float) -> Question:
    rows = {place: PlaceRow(1e-3 * e, 1e-3 * e, 0.5, 0.02) for place, e in add_mm.items()}
    shipped = rows.pop("shipped")
    return Question(set_name, "scene", image, 0, "box", 0, 0.1, {SHIPPED: shipped, **rows})


def test_differences_are_taken_question_by_question() -> None:
    # two of four are right; the other place mends one of the wrong ones, and comes 2 mm nearer in another
    errors = [(4.0, 4.0), (6.0, 4.0), (30.0, 30.0), (60.0, 5.0)]
    questions = [_question(image, shipped=a, other=b) for image, (a, b) in enumerate(errors)]
    shipped, other = figures_of(questions)
    assert (shipped.recall_add, other.recall_add) == (50.0, 75.0)
    assert (shipped.more_add, shipped.more_add95) == (0.0, (0.0, 0.0))
    assert (other.more_add, other.mended, other.spoiled) == (25.0, 1, 0)
    assert other.more_add95[0] >= 0.0
    assert other.more_auc == pytest.approx((2.0 + 55.0) / 4)
    assert other.ms == pytest.approx(20.0)
    more = figures_of([*questions, _question(0, "another", shipped=1.0, other=np.inf)])
    assert [f.set for f in more] == ["set", "set", "another", "another", ALL, ALL]
    assert (more[3].recall_add, more[3].spoiled, more[5].recall_add) == (0.0, 1, 60.0)
    assert "other" in place_lines(more)


def test_a_question_comes_back_from_json() -> None:
    entry = question_entry(_question(3, shipped=4.0))
    entry["answers"][SHIPPED]["add_m"] = None  # as JSON has inf
    assert question_of(entry).answers[SHIPPED] == PlaceRow(np.inf, 0.004, 0.5, 0.02)
    assert question_of(entry).key == ("set", "scene", 3, 0, 0)


class _OneBox:
    """A scene of two images of which each shows the box; counts the pictures that are read."""

    name, image_ids = "scene", (0, 1)

    def __init__(self, frame: RgbdFrame, T: np.ndarray) -> None:
        self._frame, self._T, self.read = frame, T, 0

    def frame(self, image: int) -> RgbdFrame:
        self.read += 1
        return self._frame

    def truths(self, image: int) -> tuple[GroundTruth, ...]:
        return (GroundTruth(0, self._T, object="tea_box"),)


@pytest.fixture
def one_box(tea_box: ReferenceModel, take_picture: Callable[..., RgbdFrame], standing: np.ndarray) -> _OneBox:
    return _OneBox(take_picture([(tea_box.mesh, standing)]), standing)


def test_what_was_answered_is_not_asked_again(tea_box: ReferenceModel, one_box: _OneBox) -> None:
    one = StudySet("set", [one_box], Targets({"tea_box": tea_box}))  # type: ignore[list-item]
    kept: list[int] = []
    first = study_places([one], 0.3, ["edges"], [], lambda questions: kept.append(len(questions)))
    assert kept == [1, 2]
    assert [q.key for q in first] == [("set", "scene", image, 0, 0) for image in (0, 1)]
    assert set(first[0].answers) == {SHIPPED, "no edges in the end", "no pairs at all"}
    assert first[0].answers[SHIPPED].add_m < 0.003
    assert one_box.read == 2
    again = study_places([one], 0.3, ["edges"], first[:1])
    assert one_box.read == 3  # only the second image
    assert [q.key for q in again] == [q.key for q in first]
