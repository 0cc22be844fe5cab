"""What tells a plain face from a floor, and which way round a plain object is."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from huepose.believe.state import State
from huepose.evaluation import metrics
from huepose.geometry import Camera, Mesh, RgbdFrame, se3
from huepose.judge.borders import Contours, continued, held
from huepose.judge.open_region import PreparedSurface
from huepose.judge.terms import NOTHING
from huepose.model import ReferenceModel
from huepose.rendering import render
from huepose.scenes.room import sheet
from huepose.select.distinct import RIGHT
from huepose.tracking import Correction, Tracker
from huepose.tracking.config import TrackerConfig
from huepose.tracking.evidence import is_loose
from huepose.tracking.hypothesis import Anchor, Hypothesis
from huepose.tracking.orientation import (
    NEW_VIEW,
    SETTLED,
    SHARPNESS,
    Facing,
    Orientation,
    alike,
    another_opinion,
    best_rival,
    lead_to_turn,
    reached,
)
from huepose.tracking.refined import best_of
from huepose.tracking.subject import Subject
from huepose.tracking.types import Doubt, Verdict
from huepose.tracking.uncertainty import uncertainty

CAMERA = Camera(420.0, 420.0, 159.5, 119.5, 320, 240)
FLOOR_M = 0.8
VIEW = np.array([0.0, 0.0, 1.0])
HALF_TURN = se3.make(np.diag([-1.0, -1.0, 1.0]), np.zeros(3))


def picture(mesh: Mesh | None, T_cam_obj: np.ndarray, floor: tuple[int, int, int]) -> RgbdFrame:
    """A plain floor that is looked at from straight above, and a mesh before it."""
    ground = sheet(3.0, 3.0, np.full((8, 8, 3), floor, np.uint8))
    scene = [(ground, se3.make(np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.0, FLOOR_M])))]
    seen = render([*scene, *([] if mesh is None else [(mesh, T_cam_obj)])], CAMERA)
    return RgbdFrame(seen.color, seen.depth, CAMERA)


def lying(model: ReferenceModel, x: float = 0.0) -> np.ndarray:
    """On the floor with one face up, which is 6 cm above it."""
    R = se3.rotation_exp(np.array([np.pi / 2, 0.0, 0.0]))
    top = float((model.mesh.vertices @ R.T)[:, 2].max())
    return se3.make(R, np.array([x, 0.0, FLOOR_M - top]))


def test_a_box_ends_where_its_outline_says_and_a_floor_does_not(plain_box: ReferenceModel) -> None:
    contours, T = Contours(plain_box.mesh, PreparedSurface.of(plain_box)), lying(plain_box)
    assert continued(contours, T, picture(plain_box.mesh, T, (90, 130, 160))) < 0.05
    sunk = T.copy()
    front = float((plain_box.mesh.vertices @ T[:3, :3].T)[:, 2].min())
    sunk[2, 3] = FLOOR_M - front  # its upper face in the plane of the bare floor
    assert continued(contours, sunk, picture(None, T, (90, 130, 160))) > 0.8


def test_what_is_moved_along_its_own_face_goes_on_on_one_side(plain_box: ReferenceModel) -> None:
    contours, T = Contours(plain_box.mesh, PreparedSurface.of(plain_box)), lying(plain_box)
    frame = picture(plain_box.mesh, T, (170, 120, 90))
    assert continued(contours, lying(plain_box, 0.03), frame) > 0.15
    assert continued(contours, T, frame) < 0.05


def test_where_a_plain_box_ends_fixes_how_it_lies_along_its_face(plain_box: ReferenceModel) -> None:
    subject, T = Subject.of(plain_box), lying(plain_box)
    frame, floor = picture(plain_box.mesh, T, (90, 130, 160)), picture(None, T, (90, 130, 160))
    known = held(subject.contours, T, frame)
    across, along = np.sqrt(1.0 / np.diag(known)[:2])
    assert across == pytest.approx(0.0023, rel=0.3)
    assert along == pytest.approx(0.0023, rel=0.3)
    assert known[2, 2] < 0.01 * known[0, 0], "nothing of the distance"
    assert not held(subject.contours, T, floor).any()
    # One face in view: depth fixes how far away it is, and how it is tilted.
    by_depth = Hypothesis(T, replace(NOTHING, outside=0.0), np.diag([0.0, 0.0, 1e9, 1e6, 1e6, 0.0]), "still")
    assert is_loose(uncertainty(subject, by_depth)[1])
    assert is_loose(uncertainty(subject, by_depth, floor)[1])
    assert not is_loose(uncertainty(subject, by_depth, frame)[1])


def test_a_plain_box_has_a_rival_as_good_as_itself_and_a_printed_one_has_not(
    plain_box: ReferenceModel, tea_box: ReferenceModel
) -> None:
    margins = []
    for model in (plain_box, tea_box):
        subject, T = Subject.of(model), lying(model)
        assert len(subject.other_turns)
        frame = picture(model.mesh, T, (90, 130, 160))
        first = best_of(subject.surface, frame, [(T, "still")])
        rival = best_rival(subject, first, subject.other_turns, frame, None)
        assert isinstance(rival, Hypothesis)
        margins.append(first.terms.total - rival.terms.total)
    assert abs(margins[0]) < 0.03
    assert margins[1] > 0.3


def test_only_turns_that_it_can_have_made_are_rivals() -> None:
    turns, T = HALF_TURN[None], se3.make(np.eye(3), np.array([0.0, 0.0, 0.6]))
    assert not reached(turns, T, T, np.radians(30.0)).any()
    assert reached(turns, T, T, np.pi).all()
    half_way = se3.make(se3.rotation_exp(np.array([0.0, 0.0, np.radians(95.0)])), T[:3, 3])
    assert reached(turns, T, half_way, np.radians(30.0)).all(), "nearer to the other than to this"
    assert alike(turns, T, T @ HALF_TURN).all()
    assert not alike(turns, T, half_way).any()


def test_what_the_image_tells_of_one_view_counts_once() -> None:
    facing = Facing.of(0.5, VIEW, 2)
    for _ in range(9):
        facing = facing.compared(0.1, VIEW)
    assert facing.value == pytest.approx(0.1 * SHARPNESS)
    aside = se3.rotation_exp(np.array([1.1 * NEW_VIEW, 0.0, 0.0])) @ VIEW
    assert facing.compared(0.1, aside).value == pytest.approx(0.2 * SHARPNESS)
    assert not facing.open(VIEW)
    assert facing.open(aside)
    assert facing.compared(1.0, aside).value > SETTLED
    assert facing.compared(1.0, aside).jumped(aside, facing.doubted).probability == pytest.approx(0.5)


def test_a_label_that_went_out_of_sight_is_not_forgotten() -> None:
    seen = Facing.of(0.9, VIEW, 2).compared(-0.3, VIEW)
    assert seen.value < -1.0
    little_aside = se3.rotation_exp(np.array([0.5 * NEW_VIEW, 0.0, 0.0])) @ VIEW
    assert seen.compared(0.02, little_aside).value == seen.value, "a plain side says nothing"
    assert seen.compared(0.5, little_aside).value > SETTLED


def test_a_turn_that_was_ruled_out_stays_so_when_another_is_doubted() -> None:
    one, other = np.array([True, False]), np.array([False, True])
    settled = Facing.of(1.0, VIEW, 2)
    assert settled.settled
    assert settled.jumped(VIEW, one).doubted.tolist() == [True, False]
    assert settled.jumped(VIEW, one).jumped(VIEW, other).doubted.all()


def spinning(number: int) -> np.ndarray:
    """Upright before the camera, turned about its axis by 9 degrees a frame, now faster and now slower."""
    turned = 0.15 * number + 0.6 * np.sin(number / 5.0)
    R = se3.rotation_exp(np.array([1.5, 0.1, 0.05])) @ se3.rotation_exp(np.array([0.0, 0.0, turned]))
    return se3.make(R, np.array([0.03 * np.sin(number / 9.0), 0.0, 0.5]))


def test_a_can_whose_label_is_behind_is_not_believed(half_plain_can: ReferenceModel) -> None:
    tracker, rng, states = Tracker({"half_plain_can": half_plain_can}), np.random.default_rng(4), []
    tiles = rng.integers(40, 200, (15, 20, 3)).astype(np.uint8)
    wall = np.repeat(np.repeat(tiles, 16, 0), 16, 1)
    for number in range(70):
        T = spinning(number)
        seen = render([(half_plain_can.mesh, T)], CAMERA)
        there = seen.depth > 0
        color = np.where(there[..., None], seen.color, wall) + rng.normal(0.0, 2.0, wall.shape)
        depth = np.where(there, seen.depth, np.float32(1.1))
        shown = np.clip(np.round(color), 0, 255).astype(np.uint8)
        frame = RgbdFrame(shown, depth, CAMERA, number, number * 33_333_333, 1)
        if number == 0:
            tracker.correct(Correction.first("half_plain_can", T, frame, 1.0))
        (pose,) = tracker.step(frame)
        states.append(pose.state)
        if pose.state is State.TRACKING:
            assert pose.T_cam_obj is not None
            error_m = metrics.add(half_plain_can.eval_points, pose.T_cam_obj, T)
            assert error_m < RIGHT * half_plain_can.diameter_m, number
    assert states.count(State.TRACKING) >= 10, "while the label is seen"


def test_an_object_half_covered_after_its_start_may_have_turned_since_the_start(
    plain_box: ReferenceModel,
) -> None:
    tracker, T, seconds = Tracker({"plain_box": plain_box}), lying(plain_box), 7 / 30
    free = picture(plain_box.mesh, T, (90, 130, 160))
    color, depth = free.color.copy(), free.depth.copy()
    color[:, :184], depth[:, :184] = 30, 0.4
    covered = replace(free, color=color, depth=depth)
    states, doubts = [], []
    for number, seen in enumerate((free, covered, free, free, free)):
        frame = replace(seen, frame_id=number, stamp_ns=int(1e9 * seconds * number), epoch=1)
        if number == 0:
            tracker.correct(Correction.first("plain_box", T, frame, 1.0))
        (pose,) = tracker.step(frame)
        states.append(pose.state)
        doubts.append(tracker.doubt("plain_box", 0))
    # In twice 0.23 s it can have been put down the other way round, which no picture from above shows.
    assert states == [State.TRACKING, *(State.SUSPECT,) * 4]
    assert doubts == [None, None, *(Doubt.TURN,) * 3], "while it is covered the pose does not fit at all"


def states_of(model: ReferenceModel, poses: Sequence[np.ndarray], apart_s: float) -> list[State]:
    """Of a tracker that is given the first of these poses, and sees the object in each, so far apart."""
    tracker, states = Tracker({model.name: model}), []
    for number, T in enumerate(poses):
        seen = picture(model.mesh, T, (90, 130, 160))
        frame = replace(seen, frame_id=number, stamp_ns=int(1e9 * apart_s * number), epoch=1)
        if number == 0:
            tracker.correct(Correction.first(model.name, T, frame, 1.0))
        (pose,) = tracker.step(frame)
        states.append(pose.state)
    return states


@pytest.mark.parametrize(("moved_m", "state"), [(0.0, State.TRACKING), (0.02, State.SUSPECT)])
def test_what_rests_between_few_pictures_has_not_turned_unseen(
    plain_box: ReferenceModel, moved_m: float, state: State
) -> None:
    """In half a second it can be turned the other way round, which no picture from above shows; but what lies
    where it did was not touched."""
    states = states_of(plain_box, [lying(plain_box, moved_m * number) for number in range(5)], 0.48)
    assert states == [State.TRACKING, *(state,) * 4]


def test_what_turned_farther_than_things_turn_may_have_turned_otherwise(plain_box: ReferenceModel) -> None:
    """By 50 degrees more than its velocity says, in a sixth of a second, the limit being 38: what else it may
    have done no picture from above shows."""
    poses = []
    for degrees in (0.0, 10.0, 20.0, 80.0, 90.0, 100.0):
        spun = se3.rotation_exp(np.array([0.0, 0.0, np.radians(degrees)]))
        T = lying(plain_box)
        T[:3, :3] = spun @ T[:3, :3]
        poses.append(T)
    states = states_of(plain_box, poses, 1 / 6)
    assert states == [*(State.TRACKING,) * 3, *(State.SUSPECT,) * 3]


def test_only_what_is_round_can_be_slid_in_small_steps(plain_box, half_plain_can) -> None:
    assert len(Subject.of(plain_box).small_turns) == 0
    small = Subject.of(half_plain_can).small_turns
    assert len(small) >= 2
    assert all(se3.rotation_angle(turn, np.eye(4)) < np.radians(46.0) for turn in small)


def test_a_claim_of_nine_in_ten_does_not_settle_which_way_round_it_is(plain_box: ReferenceModel) -> None:
    """Of a turn that the picture cannot tell, one claim leaves it in doubt; a small lead, or a surer claim,
    does not."""
    config = TrackerConfig()
    orientation = Orientation(Subject.of(plain_box), config)

    def after(claim: float, lead: float = 0.0) -> float:
        orientation.begin(claim, VIEW)
        assert orientation.facing is not None
        return orientation.facing.compared(lead, VIEW).probability

    assert after(0.9, 0.02) < config.confirmed_turn < after(0.9, 0.04)
    assert after(config.confirmed_identity) > config.confirmed_turn
    assert after(0.6) == pytest.approx(0.6)


def test_a_view_is_new_where_the_object_moved_and_not_where_the_opinion_changed(
    tea_box: ReferenceModel,
) -> None:
    subject = Subject.of(tea_box)

    def found(T_cam_obj: np.ndarray, jump: float = 0.0) -> Hypothesis:
        return Hypothesis(T_cam_obj, NOTHING, np.eye(6), "search", jump=jump)

    T = lying(tea_box)
    turned, oblique = (
        T @ se3.make(se3.rotation_exp(np.array(r)), np.zeros(3)) for r in ([0.1, 0, 0], [0.5, 0.4, 0.3])
    )
    over = T @ subject.other_turns[0]
    assert not another_opinion(subject, found(T), found(turned)), "much the same view"
    assert not another_opinion(subject, found(T), found(oblique)), "a motion"
    assert another_opinion(subject, found(T), found(oblique, jump=-1.0)), "no motion leads there"
    assert another_opinion(subject, found(T), found(over)), "it looks nearly the same this way round"


class TestDenied:
    """Perception says that the object is turned another way."""

    def test_its_surest_answers_for_and_against_weigh_the_same(self) -> None:
        facing = Facing.of(0.99, VIEW, 2)
        assert facing.denied(0.99).probability == pytest.approx(0.5)
        assert facing.denied(0.9).probability == pytest.approx(0.917, abs=0.001)
        again = facing.denied(0.99).denied(0.95).denied(0.99)
        assert again.probability == pytest.approx(0.5), "it errs alike in every look from there"

    def test_a_later_agreement_does_not_undo_it(self) -> None:
        assert Facing.of(0.9, VIEW, 2).denied(0.99).assured(0.99).probability == pytest.approx(0.5)

    def test_it_says_nothing_of_another_view(self) -> None:
        denied = Facing.of(0.9, VIEW, 2).denied(0.99)
        aside = se3.rotation_exp(np.array([1.01 * NEW_VIEW, 0.0, 0.0])) @ VIEW
        seen = denied.compared(0.3, aside).assured(0.99)
        assert seen.probability > 0.98

    def test_a_track_is_suspect_then(self, soup_can: ReferenceModel) -> None:
        T = se3.make(se3.rotation_exp(np.array([1.3, 0.2, 0.1])), np.array([0.0, 0.0, 0.5]))
        tracker = Tracker({soup_can.name: soup_can})
        frames = [
            replace(picture(soup_can.mesh, T, (90, 130, 160)), frame_id=k, stamp_ns=k * 10**8)
            for k in range(4)
        ]
        tracker.correct(Correction.first(soup_can.name, T, frames[0], 0.99))
        states = [tracker.step(frame)[0].state for frame in frames[:3]]
        assert states[-1] is State.TRACKING
        first = Correction.first(soup_can.name, T, frames[2], 0.999)
        tracker.correct(replace(first, verdict=Verdict.REJECT, seq=2))
        (pose,) = tracker.step(frames[3])
        assert pose.state is State.SUSPECT
        assert tracker.doubt(soup_can.name, 0) is Doubt.TURN


def test_between_the_turns_of_a_round_object_others_are_tried(soup_can: ReferenceModel) -> None:
    subject = Subject.of(soup_can)
    closer = subject.closer(subject.small_turns)
    assert len(closer) == 2 * len(subject.small_turns)
    half = [
        se3.rotation_angle(T, other)
        for T, other in zip(subject.small_turns, closer[len(subject.small_turns) :], strict=True)
    ]
    assert np.degrees(half) == pytest.approx(7.5, abs=0.1)


def test_what_rests_is_turned_only_by_what_outweighs_the_belief_in_its_turn(soup_can: ReferenceModel) -> None:
    subject = Subject.of(soup_can)
    T = se3.make(np.eye(3), np.array([0.0, 0.0, 0.5]))
    first = Hypothesis(T, replace(NOTHING, total=1.0), np.zeros((6, 6)), "still")
    anchor = Anchor((first,), picture(soup_can.mesh, T, (90, 130, 160)), turn_odds=4.8)
    least = lead_to_turn(subject, anchor, T, 0.1)
    assert least == pytest.approx(4.8 / SHARPNESS)
    moved = T.copy()
    moved[0, 3] += 0.1 * soup_can.diameter_m
    assert lead_to_turn(subject, anchor, moved, 0.1) == 0.0
    assert lead_to_turn(subject, anchor, T, 1.0) == 0.0
    assert lead_to_turn(subject, replace(anchor, turn_odds=-1.0), T, 0.1) == 0.0
    orientation = Orientation(subject, TrackerConfig())
    orientation.begin(0.9, VIEW)
    for gain, cannot in ((0.19, True), (0.21, False)):
        turned = replace(
            first, T_cam_obj=T @ subject.other_turns[3], terms=replace(NOTHING, total=1.0 + gain)
        )
        assert orientation.impossible(turned, first, 0.1, least) is cannot
        assert not orientation.impossible(turned, first, 0.1, 0.0)


def test_what_rests_has_not_slid_since_perception_judged_it(soup_can: ReferenceModel) -> None:
    def after(rests: bool, *margins: float) -> float:
        orientation = Orientation(Subject.of(soup_can), TrackerConfig())
        orientation.begin(0.99, VIEW)
        for margin in margins:
            orientation.slide(margin, VIEW, rests)
        return orientation.probability

    assert after(True, -0.02, -0.03) == pytest.approx(0.99)
    assert after(True, -0.02, -0.05) <= 0.5, "another turn is nearer than it was"
    assert after(False, -0.02) <= 0.5


def test_a_rival_that_was_as_near_before_is_no_new_doubt() -> None:
    facing = Facing.of(0.99, VIEW, 2).compared(-0.03, VIEW)
    assert facing.knows(-0.05, VIEW)
    assert not facing.knows(-0.06, VIEW)
    assert not facing.knows(-0.03, se3.rotation_exp(np.array([0.2, 0.0, 0.0])) @ VIEW)
    assert not Facing.of(0.99, VIEW, 2).knows(0.0, VIEW), "it was not judged yet"
