"""The suitability of an object from trials, and a self-test of an object that suits."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from huepose.evaluation import suitability
from huepose.evaluation.suitability import (
    Trial,
    in_words,
    judge,
    seen_in_part,
    self_test,
    sheet,
    suitability_of,
)
from huepose.geometry import Mesh, se3
from huepose.model import ReferenceModel
from huepose.scenes.rendered import SceneRanges
from tests.onboarding import solids

CROP = np.zeros((20, 30, 3), np.uint8)


def trial(right: bool, size_px: float = 100.0, *, state: str = "TRACKING", shape: bool = True) -> Trial:
    turn = None if right or not shape else np.array([0.0, 0.0, np.pi])
    return Trial(61.4 / size_px, size_px, state, 0.9, right, right or shape, CROP, turn)


def test_an_object_that_is_always_right_suits_without_reasons(tea_box: ReferenceModel) -> None:
    found = suitability_of(tea_box, [trial(True, size) for size in (50.0, 80.0, 120.0)])
    assert (found.verdict, found.right, found.tracking, found.smallest_px) == ("suits", 1.0, 1.0, 50.0)
    assert found.reasons == ()


@pytest.mark.parametrize(("state", "verdict"), [("SUSPECT", "suits"), ("TRACKING", "suits with limits")])
def test_an_object_with_a_wrong_tracking_pose_suits_with_limits_at_best(
    tea_box: ReferenceModel, state: str, verdict: str
) -> None:
    found = suitability_of(tea_box, [*[trial(True)] * 15, trial(False, state=state, shape=False)])
    assert found.verdict == verdict
    said = "In 1 of 16 scenes a wrong pose was TRACKING."
    assert (said in found.reasons) == (state == "TRACKING")


@pytest.mark.parametrize(("wrong", "verdict"), [(1, "suits with limits"), (2, "does not suit")])
def test_an_object_with_several_wrong_tracking_poses_does_not_suit(
    tea_box: ReferenceModel, wrong: int, verdict: str
) -> None:
    found = suitability_of(tea_box, [*[trial(True)] * (16 - wrong), *[trial(False, shape=False)] * wrong])
    assert found.verdict == verdict
    assert found.reasons[0] == f"In {wrong} of 16 scenes a wrong pose was TRACKING."


@pytest.mark.parametrize(("sure", "verdict"), [(3, "does not suit"), (4, "suits")])
def test_an_object_that_is_seldom_right_and_tracking_does_not_suit(
    tea_box: ReferenceModel, sure: int, verdict: str
) -> None:
    found = suitability_of(tea_box, [*[trial(True)] * sure, *[trial(True, state="SUSPECT")] * (16 - sure)])
    assert (found.verdict, found.right) == (verdict, 1.0)
    said = "In 3 of 16 scenes its pose is right and TRACKING: a pipeline would seldom have"
    assert found.reasons[0].startswith(said) == (verdict == "does not suit")


def test_image_size_is_no_reason_if_smaller_images_are_right(tea_box: ReferenceModel) -> None:
    """For example a jar from above: its rotation is ambiguous at any distance."""
    wrong = [trial(False, size, state="SUSPECT") for size in (138.0, 120.0, 70.0)]
    found = suitability_of(tea_box, [*wrong, *(trial(True, 50.0 + 10.0 * k) for k in range(12))])
    assert found.smallest_px == 50.0
    assert not any("pixels large" in reason for reason in found.reasons)


def test_wrong_rotations_and_small_images_are_reported(tea_box: ReferenceModel) -> None:
    trials = [*(trial(True, 100.0 + k) for k in range(9)), *(trial(False, 30.0 + k) for k in range(4))]
    found = suitability_of(tea_box, trials)
    assert found.verdict == "does not suit"
    assert found.false_tracking == 4
    # Nine right poses and then one wrong pose are 90 %.
    assert found.smallest_px == 33.0
    assert found.turned == 4
    assert any(
        reason.startswith(
            "4 of 13 poses have the right position and a wrong rotation: 4 about its z axis by 180 deg."
        )
        for reason in found.reasons
    )
    said = in_words(tea_box, found)
    assert said.startswith("tea_box does not suit: wrong and TRACKING in 31 % of 13 rendered scenes, ")
    assert "right in 69 %, right and TRACKING in 69 %, wrong rotation in 31 %; 9.0 x 6.0 x 15.0 cm.\n" in said
    (size,) = [reason for reason in found.reasons if "33 pixels" in reason]
    assert size.endswith(
        "up to 1.9 m with this camera: 9 of 10 poses are right there, and 0 of 3 farther away."
    )


def test_right_poses_beyond_the_recommended_distance_are_counted(tea_box: ReferenceModel) -> None:
    """The sheet names their number beside the recommended distance."""
    near, far = [trial(True, 60.0 + k) for k in range(9)], [trial(k == 2, 40.0 + k) for k in range(5)]
    (size,) = [
        reason for reason in suitability_of(tea_box, [*near, *far]).reasons if "pixels large" in reason
    ]
    assert size.endswith(
        "up to 1.4 m with this camera: 9 of 10 poses are right there, and 1 of 4 farther away."
    )


def about_z(degrees: float) -> np.ndarray:
    return se3.make(se3.rotation_exp(np.array([0.0, 0.0, np.radians(degrees)])), np.zeros(3))


@pytest.mark.parametrize(
    ("diameter_m", "verdict", "said"),
    [
        (0.015, "does not suit", "Wherever it is, a pipeline never calls a pose of it TRACKING."),
        (0.022, "suits with limits", "Farther away than 0.7 m a pipeline never calls a pose of it TRACKING."),
        (0.04, "suits", None),
    ],
)
def test_objects_too_small_for_the_depth_noise_are_reported(
    tea_box: ReferenceModel, diameter_m: float, verdict: str, said: str | None
) -> None:
    scale = diameter_m / tea_box.diameter_m
    surface = replace(tea_box.surface, points=tea_box.surface.points * np.float32(scale))
    mesh = replace(tea_box.mesh, vertices=tea_box.mesh.vertices * scale)
    found = suitability_of(
        replace(tea_box, mesh=mesh, surface=surface, diameter_m=diameter_m), [trial(True)] * 16
    )
    assert found.verdict == verdict
    assert [reason[reason.index(said) :] for reason in found.reasons if said] == ([said] if said else [])


def test_a_rotated_pose_is_wrong(tea_box: ReferenceModel, standing: np.ndarray) -> None:
    right, shape_right, turn = judge(tea_box, standing @ about_z(180.0), standing)
    assert (right, shape_right) == (False, True)
    assert turn is not None
    np.testing.assert_allclose(np.abs(turn), [0.0, 0.0, np.pi], atol=1e-6)
    assert judge(tea_box, standing @ about_z(5.0), standing) == (True, True, None)
    beside = standing.copy()
    beside[0, 3] += 0.1
    assert judge(tea_box, beside, standing) == (False, False, None)


def test_a_rod_rotated_about_its_axis_is_wrong_unless_it_looks_the_same(
    tea_box: ReferenceModel, standing: np.ndarray
) -> None:
    """A rod of 15 cm length and 4 mm thickness: a rotation by 90 degrees moves no point by more than 6 mm."""
    rod = replace(tea_box, eval_points=tea_box.eval_points * np.array([0.03, 0.03, 1.0], np.float32))
    right, shape_right, turn = judge(rod, standing @ about_z(90.0), standing)
    assert (right, shape_right) == (False, True)
    assert turn is not None
    alike = replace(rod, equivalents=np.stack([np.eye(4), about_z(90.0)]))
    assert judge(alike, standing @ about_z(90.0), standing) == (True, True, None)


def test_an_object_whose_poses_are_wrong_does_not_suit(tea_box: ReferenceModel) -> None:
    found = suitability_of(tea_box, [trial(False, shape=False, state="LOST")] * 5)
    assert (found.verdict, found.smallest_px, found.false_tracking) == ("does not suit", None, 0)
    assert found.reasons


def test_an_object_of_one_colour_suits_with_limits(tea_box: ReferenceModel) -> None:
    grey = replace(tea_box.surface, lab=np.full_like(tea_box.surface.lab, 50.0))
    found = suitability_of(replace(tea_box, surface=grey), [trial(True)])
    assert found.reasons[0].startswith("It is of one colour (its colours differ by 0.0")
    assert found.verdict == "suits with limits"


def test_a_model_of_a_part_suits_with_limits_at_best(tea_box: ReferenceModel) -> None:
    found = seen_in_part(suitability_of(tea_box, [trial(True)]), 0.37)
    assert (found.verdict, found.right) == ("suits with limits", 1.0)
    assert found.reasons[0].startswith("Only 37 % of its surface was seen")
    wrong = suitability_of(tea_box, [trial(False, shape=False, state="LOST")])
    assert seen_in_part(wrong, 0.37).verdict == "does not suit"


def test_the_self_test_and_its_sheet(tea_box: ReferenceModel) -> None:
    found = self_test(tea_box, count=3)
    assert found.right == 1.0
    assert 0 < len(found.trials) <= 3
    assert in_words(tea_box, found).startswith("tea_box suits: 9.0 x 6.0 x 15.0 cm, right in 100 %")
    assert sheet(tea_box, found).shape[2] == 3


def test_views_of_a_grey_part_show_its_edges(tea_box: ReferenceModel) -> None:
    """A small grey box on a large one, from above: their tops differ only by the edge between them."""
    low, high = solids.box((0.12, 0.1, 0.04)), solids.box((0.05, 0.04, 0.08))
    part = Mesh(
        np.vstack([low.vertices, high.vertices]),
        np.vstack([low.faces, high.faces + len(low.vertices)]),
        np.concatenate([low.uv, high.uv]),
        low.texture,
    )
    model = replace(tea_box, mesh=part)
    above = suitability._view(model, suitability._sides(model)[2])[0]
    grey = above[(above == above[..., :1]).all(2)]
    levels, counts = np.unique(grey[grey[:, 0] < 200, 0], return_counts=True)
    assert levels[counts.argmax()] == 128
    assert counts[levels < 100].sum() > 100


def test_views_show_the_direction_to_an_origin_outside_them(tea_box: ReferenceModel) -> None:
    """The origin is 42 m away along x: beside the object in four views, behind and in front of it in two."""

    def ink(away_m: float) -> list[np.ndarray]:
        moved = replace(tea_box.mesh, vertices=tea_box.mesh.vertices + np.float32([away_m, 0.0, 0.0]))
        points = tea_box.pairs.points + np.float32([away_m, 0.0, 0.0])
        model = replace(tea_box, mesh=moved, pairs=replace(tea_box.pairs, points=points))
        pictures = [suitability._view(model, k)[0] for k in suitability._sides(model)]
        return [np.argwhere((picture != bare).any(2)) for picture, bare in zip(pictures, plain, strict=True)]

    with pytest.MonkeyPatch.context() as patch:
        for name in ("draw_axes", "draw_way_out", "draw_label"):
            patch.setattr(suitability, name, lambda picture, *_, **__: picture)
        plain = [suitability._view(tea_box, k)[0] for k in suitability._sides(tea_box)]
    assert all(len(where) for where in ink(0.0))
    far = ink(42.0)
    assert all(len(where) for where in far)
    # From +y, the x axis points left. The origin lies in the direction -x, so to the right.
    assert (far[1][:, 1] > 0.9 * suitability.VIEW_PX).any()
    assert (far[4][:, 1] > 0.9 * suitability.VIEW_PX).sum() == 0


def test_without_a_pose_the_sheet_shows_the_true_outline(
    tea_box: ReferenceModel, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(suitability, "RANGES", SceneRanges(distance_m=(9.0, 9.4)))
    (lost,) = self_test(tea_box, count=1).trials
    assert lost.state == "LOST"
    outline = np.abs(lost.crop.astype(int) - suitability.BLUE).sum(2) < 60
    rows, columns = np.nonzero(outline)
    # The outline is in the middle of the crop.
    assert abs(np.mean([rows.min(), rows.max()]) - lost.crop.shape[0] / 2) < 0.1 * lost.crop.shape[0]
    assert abs(np.mean([columns.min(), columns.max()]) - lost.crop.shape[1] / 2) < 0.1 * lost.crop.shape[1]


def test_the_same_seed_gives_the_same_trials(tea_box: ReferenceModel) -> None:
    one, two = (self_test(tea_box, count=1, seed=4) for _ in range(2))
    assert [(t.distance_m, t.quality) for t in one.trials] == [(t.distance_m, t.quality) for t in two.trials]


def test_an_object_too_large_for_the_table_is_refused(tea_box: ReferenceModel) -> None:
    large = replace(tea_box.mesh, vertices=tea_box.mesh.vertices * np.float32(10.0))
    with pytest.raises(ValueError, match="largest side") as refused:
        self_test(replace(tea_box, mesh=large), count=1)
    assert str(refused.value).endswith("made anyway. If it is smaller, its mesh has another unit (--unit).")
