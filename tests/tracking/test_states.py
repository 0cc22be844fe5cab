"""From evidence to quality to states, and what identity and competition add."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from huepose.believe.logistic import probability
from huepose.believe.state import State
from huepose.evaluation.ablation import visible_within
from huepose.geometry import Box, Camera, Mesh, se3
from huepose.geometry.se3 import grown
from huepose.judge.open_region import PreparedSurface
from huepose.judge.silhouette import silhouette_iou
from huepose.judge.terms import NOTHING, Terms
from huepose.tracking import TrackerConfig
from huepose.tracking.competition import Claim, losers
from huepose.tracking.evidence import (
    Identity,
    TrackState,
    bounded,
    log_odds,
    next_state,
    odds_of,
    one_sense,
    scarce,
)
from huepose.tracking.uncertainty import covariance
from huepose.tracking.usual import Usual

GOOD = Terms(
    total=1.5, depth_fit=0.85, coverage=0.0, violation=0.0, color=0.7, occluded=0.0, seen=0.9, box_iou=0.0,
    through=0.0, hidden=0.0, blind=0.05, outside=0.0, contrast=30.0,
    light_l=-3.0, light_rg=1.0, light_yb=1.0, colored=0.85,
)  # fmt: skip
CONFIG = TrackerConfig()


def run(
    qualities: list[float], confirmed: bool = True, start: State = State.TRACKING, apart_s: float = 1 / 30
) -> list[State]:
    track_state, out = TrackState(start), []
    for q in qualities:
        track_state = next_state(track_state, q, confirmed, CONFIG, apart_s)
        out.append(track_state.state)
    return out


def test_good_and_bad_evidence() -> None:
    assert probability(log_odds(GOOD, None, 0.0)) > 0.9
    assert probability(log_odds(NOTHING, None, 3.0)) < 0.05
    untextured = probability(log_odds(replace(GOOD, color=0.0, seen=0.5), None, 0.0))
    assert untextured < CONFIG.lost_quality, "gives no support"
    assert log_odds(GOOD, None, 2.0) > log_odds(GOOD, None, 0.0), "right a frame ago"
    assert log_odds(GOOD, None, 20.0) < log_odds(GOOD, None, 0.0) + 3.0, (
        "earlier evidence does not outweigh the image"
    )


def test_another_color_counts_against_the_object_and_the_same_color_counts_for_nothing() -> None:
    known = np.array(GOOD.light)

    def odds(terms: Terms, *offset: float) -> float:
        return Usual(sure_light=known + np.array(offset)).same_color(terms)

    shifts = [odds(GOOD, 0.0, x, 0.0) for x in (0.0, 5.0, 15.0, 25.0, 40.0)]
    assert shifts == sorted(shifts, reverse=True)
    assert shifts[1] == 0.0, "a small shift may come from the camera"
    assert -1.5 < shifts[2] < 0.0, "this shift may come from another light"
    assert shifts[3] < -2.0
    assert shifts[4] < -6.0
    assert odds(GOOD, 40.0, 0.0, 0.0) == 0.0, "lightness is shading"
    assert odds(replace(GOOD, colored=0.1), 40.0, 40.0, 40.0) == 0.0, "too little colour is visible"


def test_earlier_evidence_does_not_save_a_pose_that_jumped() -> None:
    here = log_odds(GOOD, None, 6.0)
    assert log_odds(GOOD, None, 6.0, jump=-1.0) == pytest.approx(here - 1.0)
    assert log_odds(GOOD, None, 6.0, jump=-4.0) < log_odds(GOOD, None, 0.0) - 1.0


def test_each_piece_of_evidence_counts() -> None:
    base = replace(GOOD, color=0.3)
    x = log_odds(base, None, 0.0)
    for worse in (replace(base, seen=0.2), replace(base, through=0.2), replace(base, color=0.1)):
        assert log_odds(worse, None, 0.0) < x


def test_colours_of_few_pixels_count_little() -> None:
    """On an overexposed floor a few samples correlate by chance."""
    lucky = replace(GOOD, colored=0.03, color=0.8)
    assert log_odds(lucky, None, 0.0) < log_odds(GOOD, None, 0.0) - 1.0
    assert one_sense(lucky)


def test_a_sudden_drop_under_the_baseline_counts() -> None:
    terms = replace(GOOD, total=0.8, color=0.35)
    assert log_odds(terms, 1.6, 1.0) < log_odds(terms, 0.9, 1.0)


def test_depth_alone_or_colour_alone_is_one_sense() -> None:
    assert one_sense(replace(GOOD, seen=0.0, depth_fit=0.0, blind=0.95))
    assert one_sense(replace(GOOD, colored=0.0))
    assert not one_sense(GOOD)


def test_odds_and_probabilities() -> None:
    assert probability(odds_of(0.8)) == pytest.approx(0.8)
    assert probability(odds_of(1.0)) == pytest.approx(0.99), "nothing is certain"


def test_a_barely_visible_object_is_tracked_only_briefly() -> None:
    strip = replace(GOOD, seen=0.1, hidden=0.8)
    assert scarce(strip)
    assert not scarce(replace(GOOD, seen=0.3, hidden=0.8))
    assert not scarce(replace(GOOD, seen=0.1, hidden=0.0, blind=0.9)), "missing depth is no occlusion"
    trust = [bounded(0.9, k) for k in range(12)]
    assert trust[0] == 0.9
    assert CONFIG.lost_quality < trust[5] < CONFIG.suspect_quality
    assert trust[11] < CONFIG.lost_quality


def test_bad_frames_make_a_track_suspect_at_once_and_lost_soon() -> None:
    suspect = [State.SUSPECT] * (CONFIG.lost_after - 1)
    assert run([0.9] + [0.1] * 6) == [State.TRACKING, *suspect, State.LOST, State.LOST]
    assert CONFIG.lost_after <= 5


def test_suspect_returns_after_two_supported_frames() -> None:
    assert run([0.4, 0.9, 0.9]) == [State.SUSPECT, State.SUSPECT, State.TRACKING]


@pytest.mark.parametrize(("rate_hz", "needed"), [(240, 12), (90, 5), (60, 3), (30, 2), (5, 2)])
def test_suspect_returns_no_sooner_at_more_than_30_frames_per_second(rate_hz: int, needed: int) -> None:
    assert run([0.4] + [0.9] * 20, apart_s=1.0 / rate_hz).index(State.TRACKING) == needed


def test_what_was_found_after_a_loss_has_to_fit_for_a_look_at_any_rate() -> None:
    def frames(rate_hz: int) -> int:
        track_state, count = TrackState(State.SUSPECT, found=1.0), 0
        while track_state.state is not State.TRACKING:
            track_state, count = next_state(track_state, 0.99, True, CONFIG, 1.0 / rate_hz), count + 1
        return count

    assert (frames(240), frames(90), frames(30), frames(5)) == (9, 4, 2, 2)


@pytest.mark.parametrize(("rate_hz", "lost"), [(90, 14), (60, 9), (30, 5), (6, 5)])
def test_a_track_is_lost_no_sooner_at_more_than_30_frames_per_second(rate_hz: int, lost: int) -> None:
    assert run([0.1] * 20, apart_s=1.0 / rate_hz).index(State.LOST) == lost - 1


def test_a_single_good_frame_restarts_the_count_to_lost() -> None:
    assert State.LOST not in run([0.1, 0.1, 0.1, 0.7, 0.1, 0.1, 0.1])


def test_doubtful_but_not_unsupported_is_never_lost() -> None:
    assert set(run([0.4] * 50)) == {State.SUSPECT}


def test_unconfirmed_is_never_tracking() -> None:
    assert set(run([0.95] * 10, confirmed=False)) == {State.SUSPECT}


@pytest.mark.parametrize("start", [State.LOST, State.SEARCHING])
def test_only_a_correction_ends_lost_and_searching(start: State) -> None:
    assert set(run([0.99] * 10, start=start)) == {start}


def test_baseline_and_light_follow_slowly() -> None:
    first = Usual().after(replace(GOOD, total=1.4))
    assert first.baseline == 1.4
    assert first.light is not None
    assert first.light.tolist() == [-3.0, 1.0, 1.0]
    assert first.sure_light is None
    later = first.after(replace(GOOD, total=1.6, light_l=7.0), sure=True)
    assert later.baseline is not None
    assert 1.4 < later.baseline < 1.45
    assert later.light is not None
    assert later.light.tolist() == [-1.0, 1.0, 1.0]
    assert later.sure_light is later.light
    assert later.after(replace(GOOD, colored=0.0)).light is later.light, "no colour was visible"


def test_occlusion_never_lowers_the_baseline() -> None:
    known = Usual(1.4)
    occluded = replace(GOOD, total=1.0, hidden=0.5)
    assert known.after(occluded, sure=True).baseline == 1.4
    assert known.confirmed(occluded).baseline == 1.4
    assert known.confirmed(replace(GOOD, total=1.0)).baseline == 1.0
    better = known.after(replace(occluded, total=1.5)).baseline
    assert better is not None
    assert better > 1.4, "in full view it would be even higher"


def test_the_usual_values_follow_as_fast_at_90_hz_as_at_30() -> None:
    once, often = (Usual(1.4, np.zeros(3)) for _ in range(2))
    once = once.after(GOOD, apart_s=0.033)
    for _ in range(3):
        often = often.after(GOOD, apart_s=0.011)
    assert often.baseline == pytest.approx(once.baseline)
    np.testing.assert_allclose(often.light, once.light)
    assert Usual(1.4).after(GOOD, apart_s=0.3).baseline == pytest.approx(once.baseline), (
        "a frame after a gap counts as one"
    )


def test_the_baseline_is_lower_after_a_long_absence() -> None:
    known = Usual(1.4, np.ones(3))
    assert known.remembered(2.0).baseline == pytest.approx(0.9)
    assert known.remembered(-1.0).baseline == 1.4
    assert known.remembered(2.0).light is known.light
    assert Usual().remembered(2.0).baseline is None


def test_identity_grows_with_agreement_and_new_viewpoints() -> None:
    front, side = np.array([1.0, 0, 0]), np.array([0, 1.0, 0])
    doubtful = Identity.of(0.6, front)
    assert doubtful.agreed(0.5, front).value == pytest.approx(0.8)
    assert doubtful.agreed(0.8, front).value == pytest.approx(0.8), "one viewpoint repeats its mistakes"
    assert doubtful.agreed(0.95, front).value == pytest.approx(0.95)
    assert doubtful.agreed(0.8, side).value == pytest.approx(0.92)
    assert doubtful.carried(GOOD, front) is doubtful, "the same side adds nothing"
    assert doubtful.carried(replace(GOOD, color=0.2), side) is doubtful, "nor does a side without texture"
    carried = doubtful.carried(GOOD, side)
    assert carried.value == pytest.approx(0.8)
    assert carried.carried(GOOD, side) is carried
    assert carried.carried(GOOD, front).value == pytest.approx(0.9)
    assert Identity.of(1.0, front).value < 1.0


def test_answers_from_one_viewpoint_leave_a_quarter_of_the_doubt_of_the_surest() -> None:
    front, side = np.array([1.0, 0, 0]), np.array([0, 1.0, 0])
    known = Identity.of(0.6, front)
    for _ in range(9):
        known = known.agreed(0.6, front)
    assert known.value == pytest.approx(0.9), "a quarter of the doubt of 0.6"
    surer = known.agreed(0.8, front).agreed(0.6, front)
    assert surer.value == pytest.approx(0.95), "a quarter of the doubt of 0.8"
    assert surer.agreed(0.7, side).value == pytest.approx(0.985), "another viewpoint is independent evidence"
    elsewhere = surer.agreed(0.7, side)
    for _ in range(9):
        elsewhere = elsewhere.agreed(0.7, side)
    assert elsewhere.value == pytest.approx(0.995)
    carried = known.carried(GOOD, side)
    assert carried.value == pytest.approx(0.95), "it was tracked to another side"
    assert carried.agreed(0.6, side).value == pytest.approx(0.975)


def test_an_answer_that_is_more_likely_wrong_than_right_confirms_nothing() -> None:
    front, side = np.array([1.0, 0, 0]), np.array([0, 1.0, 0])
    doubtful = Identity.of(0.6, front)
    assert doubtful.agreed(0.3, front) is doubtful
    assert doubtful.agreed(0.3, side) is doubtful
    sure = Identity.of(0.98, front)
    assert sure.agreed(0.3, front) is sure, "an object that was tracked without a break keeps its identity"


def _looks(identity: Identity, likely: list[float]) -> Identity:
    for one in likely:
        identity = identity.looked_at(one)
    return identity


def test_identity_after_a_loss_follows_the_image_until_perception_answers() -> None:
    front, side = np.array([1.0, 0, 0]), np.array([0, 1.0, 0])
    found = Identity.of(0.98, front).found_elsewhere(0.7, side, 0.0)
    assert (found.value, found.lost) == (0.7, 0.98)
    assert 0.6 < found.looked_at(0.6).value < 0.7 < found.looked_at(0.9).value < 0.9
    assert _looks(found, [0.9] * 20).value == pytest.approx(0.9, abs=0.01)
    assert _looks(found, [0.999] * 3).value > 0.95
    assert _looks(found, [0.999] * 20).value == 0.98, "no surer than before the loss"
    assert _looks(found, [0.5, 0.97, 0.6, 0.96, 0.8]).value < 0.9, "its fit varies"
    assert _looks(found.found_elsewhere(0.5, front, 0.0), [0.999] * 20).value == 0.98, (
        "however often it is lost"
    )
    assert found.agreed(0.8, side).value == pytest.approx(0.8)
    like = Identity.of(0.98, front).found_elsewhere(0.97, side, 0.0)
    assert like.agreed(0.5, side).value == pytest.approx(0.75), "however well it fits"
    assert like.agreed(0.96, side).value == pytest.approx(0.97)
    assert like.agreed(0.3, side).value == 0.3
    thrice = found
    for _ in range(3):
        thrice = thrice.looked_at(0.95, 0.011)
    assert thrice.value == pytest.approx(found.looked_at(0.95).value), "at 90 Hz and at 30"
    denied = found.looked_at(0.95).agreed(0.3, side)
    assert denied.value == 0.3
    assert denied.looked_at(0.99) is denied, "perception doubts it, so the image alone is not enough"


def test_a_view_that_changes_with_the_hypothesis_is_no_new_view() -> None:
    front, side = np.array([1.0, 0, 0]), np.array([0, 1.0, 0])
    leapt = Identity.of(0.6, front).leapt(side)
    assert leapt.carried(GOOD, side) is leapt
    assert leapt.carried(GOOD, front).value == pytest.approx(0.8)


def test_the_weaker_of_two_poses_on_one_surface_loses(tea_box, shoot, path) -> None:
    surface = PreparedSurface.of(tea_box)
    beside = se3.make(path(0)[:3, :3], path(0)[:3, 3] + [0.15, 0.0, 0.0])
    frame = shoot([(tea_box.mesh, path(0)), (tea_box.mesh, beside)])
    good, same = Claim(surface, path(0), 1.6), Claim(surface, se3.perturb(path(0), np.full(6, 0.003)), 1.2)
    other = Claim(surface, beside, 0.9)
    assert losers([good, same, other], frame.depth, frame.camera) == [1]
    assert losers([same, good, other], frame.depth, frame.camera) == [0]
    assert losers([good, other], frame.depth, frame.camera) == []
    assert losers([good], frame.depth, frame.camera) == []
    assert losers([], frame.depth, frame.camera) == []


def test_a_mask_holds_the_visible_pixels_of_the_object(tea_box, soup_can, shoot, path) -> None:
    surface = PreparedSurface.of(tea_box)
    box = surface.box(path(0), shoot([]).camera)
    assert box is not None
    alone = visible_within(tea_box.mesh, path(0), shoot([(tea_box.mesh, path(0))]), box)
    near = se3.make(np.eye(3), path(0)[:3, 3] * 0.7)
    occluded = visible_within(
        tea_box.mesh, path(0), shoot([(tea_box.mesh, path(0)), (soup_can.mesh, near)]), box
    )
    assert alone.sum() > 3000
    assert occluded.sum() < 0.8 * alone.sum()
    assert not (occluded & ~alone).any()
    assert visible_within(tea_box.mesh, path(0), shoot([]), box).sum() == 0


def test_overlap_of_outlines(tea_box, path) -> None:
    camera = Camera(420.0, 420.0, 159.5, 119.5, 320, 240)
    surface, T = PreparedSurface.of(tea_box), path(0)

    def iou(other: np.ndarray) -> float:
        return silhouette_iou(
            tea_box.mesh, T, other, surface.box(T, camera), surface.box(other, camera), camera
        )

    assert iou(T) == 1.0
    assert iou(T @ se3.make(np.diag([-1.0, -1.0, 1.0]), np.zeros(3))) > 0.97, "half a turn of a box"
    assert 0.6 < iou(se3.perturb(T, np.array([0.01, 0, 0, 0, 0, 0]))) < 0.95
    assert iou(se3.perturb(T, np.array([0.3, 0, 0, 0, 0, 0]))) == 0.0
    assert silhouette_iou(tea_box.mesh, T, T, None, None, camera) == 0.0


def test_the_outline_of_a_long_board_seen_on_its_edge_overlaps_with_itself() -> None:
    """Scaled down, the long flat image of the board still has a row of pixels."""
    corners = np.array([[-0.5, -0.002, 0], [0.5, -0.002, 0], [0.5, 0.002, 0], [-0.5, 0.002, 0]], np.float32)
    faces = np.array([[0, 1, 2], [0, 2, 3]], np.int32)
    board = Mesh(corners, faces, np.zeros((2, 3, 2), np.float32), np.zeros((2, 2, 3), np.uint8))
    camera = Camera(900.0, 900.0, 639.5, 399.5, 1280, 800)
    T = se3.make(np.eye(3), np.array([0.0, 0.0, 0.7]))
    box = Box.of_pixels(camera.project(se3.apply(T, corners)))
    assert silhouette_iou(board, T, T, box, box, camera) == 1.0


def test_covariance_follows_information_and_grows_with_time() -> None:
    strong = covariance(np.diag([1e9] * 3 + [1e6] * 3), 0.6)
    weak = covariance(np.diag([1e9] * 3 + [1e6, 1e6, 10.0]), 0.6)
    assert np.sqrt(strong[0, 0]) < 0.001
    assert np.sqrt(strong[5, 5]) < 0.01
    assert np.sqrt(weak[5, 5]) > 0.2, "a rotation that nothing constrains"
    assert covariance(np.zeros((6, 6)), 0.6)[0, 0] == pytest.approx(0.05**2, rel=1e-2)
    assert strong[2, 2] < covariance(np.diag([1e9] * 3 + [1e6] * 3), 1.5)[2, 2], (
        "a far object is less certain"
    )
    later = grown(strong, 0.2)
    assert (np.diag(later) > np.diag(strong)).all()
    assert np.linalg.eigvalsh(later).min() > 0
