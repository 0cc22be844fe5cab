"""Places of colour pairs: on a clear view all of them find the pose; figures are those of hand-made rows."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from huepose.estimation.config import FullPathConfig
from huepose.estimation.evidence import gather
from huepose.estimation.prepared import PreparedModels
from huepose.evaluation.colorpairs.place_study import PlaceRow, figures_of, place_lines
from huepose.evaluation.colorpairs.places import Shared, places_of
from huepose.geometry import Box, RgbdFrame
from huepose.model.types import ReferenceModel
from huepose.rendering.render import render_depth


def test_every_place_finds_a_box_in_plain_sight_and_costs_what_it_shares(
    tea_box: ReferenceModel, take_picture: Callable[..., RgbdFrame], standing: np.ndarray
) -> None:
    frame = take_picture([(tea_box.mesh, standing)], light=(0.9, 0.8, 0.7))
    mask = render_depth(tea_box.mesh, standing, frame.camera) > 0
    box = Box.of_mask(mask)
    assert box is not None
    evidence = gather(frame, [mask], box, tea_box.diameter_m)
    assert evidence is not None
    table = PreparedModels({"tea_box": tea_box}).prepared("tea_box").table
    shared = Shared(tea_box, table, evidence, FullPathConfig(), (0,))
    places = places_of(shared)
    assert next(iter(places)) == "full"
    for place, answer in places.items():
        assert np.linalg.norm(answer.poses[0][:3, 3] - standing[:3, 3]) < 0.003, place
    assert not shared.in_doubt
    full = places["full"].seconds
    assert places["few hypotheses in doubt"].seconds == full
    assert places["hypotheses"].seconds > shared.spent("whole proposed")
    assert places["judgement 0.2"].seconds > full


def test_differences_are_taken_question_by_question() -> None:
    def row(place: str, image: int, add_mm: float) -> PlaceRow:
        return PlaceRow(place, "scene", image, 0, "box", 0, 1e-3 * add_mm, 1e-3 * add_mm, 0.1, 0.02)

    # two of four are right; the other place mends one of the wrong ones, and comes 2 mm nearer in another
    errors = {"full": (4.0, 6.0, 30.0, 60.0), "other": (4.0, 4.0, 30.0, 5.0)}
    rows = [row(place, image, e) for place, many in errors.items() for image, e in enumerate(many)]
    full, other = figures_of(rows[:4] + rows[:3:-1])
    assert (full.recall_add, other.recall_add) == (50.0, 75.0)
    assert (full.more_add, full.more_add95) == (0.0, (0.0, 0.0))
    assert other.more_add == 25.0
    assert other.more_add95[0] >= 0.0
    assert other.more_auc == pytest.approx((2.0 + 55.0) / 4)
    assert other.ms == pytest.approx(20.0)
    assert "other" in place_lines([full, other])
