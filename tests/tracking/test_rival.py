"""What distinguishes a plain face from a floor, and the orientations of a plain object from each other."""

from collections.abc import Callable, Sequence
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
    lead_to_turn,
    reached,
)
from huepose.tracking.refined import best_of
from huepose.tracking.rival import best_rival
from huepose.tracking.subject import Subject
from huepose.tracking.types import Doubt, Verdict
from huepose.tracking.uncertainty import uncertainty

CAMERA = Camera(420.0, 420.0, 159.5, 119.5, 320, 240)
FLOOR_M = 0.8
VIEW = np.array([0.0, 0.0, 1.0])
HALF_TURN = se3.make(np.diag([-1.0, -1.0, 1.0]), np.zeros(3))


def floor_frame(mesh: Mesh | None, T_cam_obj: np.ndarray, floor: tuple[int, int, int]) -> RgbdFrame:
    """A plain floor seen from straight above, and a mesh in front of it."""
    ground = sheet(3.0, 3.0, np.full((8, 8, 3), floor, np.uint8))
    scene = [(ground, se3.make(np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.0, FLOOR_M])))]
    seen = render([*scene, *([] if mesh is None else [(mesh, T_cam_obj)])], CAMERA)
    return RgbdFrame(seen.color, seen.depth, CAMERA)


def lying(model: ReferenceModel, x: float = 0.0) -> np.ndarray:
    """T_cam_obj of the object on the floor; its upper face is 6 cm above the floor."""
    R = se3.rotation_exp(np.array([np.pi / 2, 0.0, 0.0]))
    top = float((model.mesh.vertices @ R.T)[:, 2].max())
    return se3.make(R, np.array([x, 0.0, FLOOR_M - top]))


def test_a_box_ends_at_its_outline_and_a_floor_continues(plain_box: ReferenceModel) -> None:
    contours, T = Contours(plain_box.mesh, PreparedSurface.of(plain_box)), lying(plain_box)
    assert continued(contours, T, floor_frame(plain_box.mesh, T, (90, 130, 160))) < 0.05
    sunk = T.copy()
    front = float((plain_box.mesh.vertices @ T[:3, :3].T)[:, 2].min())
    sunk[2, 3] = FLOOR_M - front  # its upper face in the plane of the bare floor
    assert continued(contours, sunk, floor_frame(None, T, (90, 130, 160))) > 0.8


def test_the_surface_continues_beyond_the_outline_of_a_shifted_pose(plain_box: ReferenceModel) -> None:
    contours, T = Contours(plain_box.mesh, PreparedSurface.of(plain_box)), lying(plain_box)
    frame = floor_frame(plain_box.mesh, T, (170, 120, 90))
    assert continued(contours, lying(plain_box, 0.03), frame) > 0.15
    assert continued(contours, T, frame) < 0.05


def test_the_outline_of_a_plain_box_fixes_its_position_along_its_face(plain_box: ReferenceModel) -> None:
    subject, T = Subject.of(plain_box), lying(plain_box)
    frame, floor = floor_frame(plain_box.mesh, T, (90, 130, 160)), floor_frame(None, T, (90, 130, 160))
    known = held(subject.contours, T, frame)
    across, along = np.sqrt(1.0 / np.diag(known)[:2])
    assert across == pytest.approx(0.0023, rel=0.3)
    assert along == pytest.approx(0.0023, rel=0.3)
    assert known[2, 2] < 0.01 * known[0, 0], "it does not constrain the distance"
    assert not held(subject.contours, T, floor).any()
    # With one face in view, depth fixes its distance and its tilt.
    by_depth = Hypothesis(T, replace(NOTHING, outside=0.0), np.diag([0.0, 0.0, 1e9, 1e6, 1e6, 0.0]), "still")
    assert is_loose(uncertainty(subject, by_depth)[1])
    assert is_loose(uncertainty(subject, by_depth, floor)[1])
    assert not is_loose(uncertainty(subject, by_depth, frame)[1])


def test_a_plain_box_has_an_equally_good_rival_and_a_printed_box_has_none(
    plain_box: ReferenceModel, tea_box: ReferenceModel
) -> None:
    margins = []
    for model in (plain_box, tea_box):
        subject, T = Subject.of(model), lying(model)
        assert len(subject.other_turns)
        frame = floor_frame(model.mesh, T, (90, 130, 160))
        first = best_of(subject.surface, frame, [(T, "still")])
        rival = best_rival(subject, first, subject.other_turns, frame, None)
        assert isinstance(rival, Hypothesis)
        margins.append(first.terms.total - rival.terms.total)
    assert abs(margins[0]) < 0.03
    assert margins[1] > 0.3


def test_only_rotations_within_reach_are_rivals() -> None:
    turns, T = HALF_TURN[None], se3.make(np.eye(3), np.array([0.0, 0.0, 0.6]))
    assert not reached(turns, T, T, np.radians(30.0)).any()
    assert reached(turns, T, T, np.pi).all()
    half_way = se3.make(se3.rotation_exp(np.array([0.0, 0.0, np.radians(95.0)])), T[:3, 3])
    assert reached(turns, T, half_way, np.radians(30.0)).all(), (
        "nearer to the other orientation than to this one"
    )
    assert alike(turns, T, T @ HALF_TURN).all()
    assert not alike(turns, T, half_way).any()


def test_the_evidence_of_one_view_counts_once() -> None:
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
    assert seen.compared(0.02, little_aside).value == seen.value, "a plain side adds nothing"
    assert seen.compared(0.5, little_aside).value > SETTLED


def test_a_rotation_that_was_ruled_out_stays_so_when_another_is_doubted() -> None:
    one, other = np.array([True, False]), np.array([False, True])
    settled = Facing.of(1.0, VIEW, 2)
    assert settled.settled
    assert settled.jumped(VIEW, one).doubted.tolist() == [True, False]
    assert settled.jumped(VIEW, one).jumped(VIEW, other).doubted.all()


def spinning(number: int) -> np.ndarray:
    """Upright in front of the camera, rotated about its axis by 9 degrees per frame, at a varying speed."""
    turned = 0.15 * number + 0.6 * np.sin(number / 5.0)
    R = se3.rotation_exp(np.array([1.5, 0.1, 0.05])) @ se3.rotation_exp(np.array([0.0, 0.0, turned]))
    return se3.make(R, np.array([0.03 * np.sin(number / 9.0), 0.0, 0.5]))


def test_a_can_whose_label_is_out_of_view_is_not_believed(half_plain_can: ReferenceModel) -> None:
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
    assert states.count(State.TRACKING) >= 10, "while the label is visible"


def test_an_object_half_occluded_after_its_start_may_have_rotated_since_then(
    plain_box: ReferenceModel,
) -> None:
    tracker, T, seconds = Tracker({"plain_box": plain_box}), lying(plain_box), 7 / 30
    free = floor_frame(plain_box.mesh, T, (90, 130, 160))
    color, depth = free.color.copy(), free.depth.copy()
    color[:, :184], depth[:, :184] = 30, 0.4
    occluded = replace(free, color=color, depth=depth)
    states, doubts = [], []
    for number, seen in enumerate((free, occluded, free, free, free)):
        frame = replace(seen, frame_id=number, stamp_ns=int(1e9 * seconds * number), epoch=1)
        if number == 0:
            tracker.correct(Correction.first("plain_box", T, frame, 1.0))
        (pose,) = tracker.step(frame)
        states.append(pose.state)
        doubts.append(tracker.doubt("plain_box", 0))
    # In twice 0.23 s it can have been rotated by half a turn, which no image from above shows.
    assert states == [State.TRACKING, *(State.SUSPECT,) * 4]
    assert doubts == [None, None, *(Doubt.TURN,) * 3], "while it is occluded the pose does not fit at all"


def states_of(model: ReferenceModel, poses: Sequence[np.ndarray], apart_s: float) -> list[State]:
    """The states of a tracker that starts from the first of these poses and gets a frame of each, apart_s
    apart."""
    tracker, states = Tracker({model.name: model}), []
    for number, T in enumerate(poses):
        seen = floor_frame(model.mesh, T, (90, 130, 160))
        frame = replace(seen, frame_id=number, stamp_ns=int(1e9 * apart_s * number), epoch=1)
        if number == 0:
            tracker.correct(Correction.first(model.name, T, frame, 1.0))
        (pose,) = tracker.step(frame)
        states.append(pose.state)
    return states


@pytest.mark.parametrize(("moved_m", "state"), [(0.0, State.TRACKING), (0.02, State.SUSPECT)])
def test_a_static_object_has_not_rotated_between_two_frames(
    plain_box: ReferenceModel, moved_m: float, state: State
) -> None:
    """In half a second it can be rotated by half a turn, which no image from above shows; but an object
    that is still in its position was not touched."""
    states = states_of(plain_box, [lying(plain_box, moved_m * number) for number in range(5)], 0.48)
    assert states == [State.TRACKING, *(state,) * 4]


def test_after_an_implausible_rotation_the_orientation_is_in_doubt(plain_box: ReferenceModel) -> None:
    """It rotates by 50 degrees more than its velocity predicts, in a sixth of a second; the limit is 38. No
    image from above shows how else it may have rotated."""
    poses = []
    for degrees in (0.0, 10.0, 20.0, 80.0, 90.0, 100.0):
        spun = se3.rotation_exp(np.array([0.0, 0.0, np.radians(degrees)]))
        T = lying(plain_box)
        T[:3, :3] = spun @ T[:3, :3]
        poses.append(T)
    states = states_of(plain_box, poses, 1 / 6)
    assert states == [*(State.TRACKING,) * 3, *(State.SUSPECT,) * 3]


def test_only_round_objects_have_small_near_symmetric_rotations(plain_box, half_plain_can) -> None:
    assert len(Subject.of(plain_box).small_turns) == 0
    small = Subject.of(half_plain_can).small_turns
    assert len(small) >= 2
    assert all(se3.rotation_angle(turn, np.eye(4)) < np.radians(46.0) for turn in small)


def test_a_claim_of_90_percent_does_not_settle_the_orientation(plain_box: ReferenceModel) -> None:
    """If the image cannot tell the orientation, one such claim leaves it in doubt. A small lead in the
    image, or a surer claim, does not."""
    config = TrackerConfig()
    orientation = Orientation(Subject.of(plain_box), config)

    def after(claim: float, lead: float = 0.0) -> float:
        orientation.begin(claim, VIEW)
        assert orientation.facing is not None
        return orientation.facing.compared(lead, VIEW).probability

    assert after(0.9, 0.02) < config.confirmed_turn < after(0.9, 0.04)
    assert after(config.confirmed_identity) > config.confirmed_turn
    assert after(0.6) == pytest.approx(0.6)


def test_a_view_is_new_if_the_object_moved_and_not_if_the_hypothesis_changed(
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
    assert another_opinion(subject, found(T), found(over)), "it looks nearly the same in this orientation"


class TestDenied:
    """Perception says that the object has another orientation."""

    def test_its_surest_answers_for_and_against_weigh_the_same(self) -> None:
        facing = Facing.of(0.99, VIEW, 2)
        assert facing.denied(0.99).probability == pytest.approx(0.5)
        assert facing.denied(0.9).probability == pytest.approx(0.917, abs=0.001)
        again = facing.denied(0.99).denied(0.95).denied(0.99)
        assert again.probability == pytest.approx(0.5), "one viewpoint repeats its errors"

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
            replace(floor_frame(soup_can.mesh, T, (90, 130, 160)), frame_id=k, stamp_ns=k * 10**8)
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


def test_rotations_between_those_of_a_round_object_are_tried(soup_can: ReferenceModel) -> None:
    subject = Subject.of(soup_can)
    closer = subject.closer(subject.small_turns)
    assert len(closer) == 2 * len(subject.small_turns)
    half = [
        se3.rotation_angle(T, other)
        for T, other in zip(subject.small_turns, closer[len(subject.small_turns) :], strict=True)
    ]
    assert np.degrees(half) == pytest.approx(7.5, abs=0.1)


def test_a_static_object_is_rotated_only_if_the_image_outweighs_its_orientation(
    soup_can: ReferenceModel,
) -> None:
    subject = Subject.of(soup_can)
    T = se3.make(np.eye(3), np.array([0.0, 0.0, 0.5]))
    first = Hypothesis(T, replace(NOTHING, total=1.0), np.zeros((6, 6)), "still")
    anchor = Anchor((first,), floor_frame(soup_can.mesh, T, (90, 130, 160)), turn_odds=4.8)
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


def test_a_static_object_has_not_slid_since_perception_judged_it(soup_can: ReferenceModel) -> None:
    def after(rests: bool, *margins: float) -> float:
        orientation = Orientation(Subject.of(soup_can), TrackerConfig())
        orientation.begin(0.99, VIEW)
        for margin in margins:
            orientation.slide(margin, VIEW, rests)
        return orientation.probability

    assert after(True, -0.02, -0.03) == pytest.approx(0.99)
    assert after(True, -0.02, -0.05) <= 0.5, "another rotation is closer than it was"
    assert after(False, -0.02) <= 0.5


def test_a_rival_that_was_as_near_before_is_no_new_doubt() -> None:
    facing = Facing.of(0.99, VIEW, 2).compared(-0.03, VIEW)
    assert facing.knows(-0.05, VIEW)
    assert not facing.knows(-0.06, VIEW)
    assert not facing.knows(-0.03, se3.rotation_exp(np.array([0.2, 0.0, 0.0])) @ VIEW)
    assert not Facing.of(0.99, VIEW, 2).knows(0.0, VIEW), "it was not judged yet"


def test_an_orientation_that_a_new_view_shows_to_be_wrong_is_left(
    plain_bracket: ReferenceModel, shoot: Callable[..., RgbdFrame]
) -> None:
    """A bracket of one colour begins nearly turned over, which from this side looks about the same. When it
    has rotated by some degrees, the other orientation explains more of the depth, and is followed."""
    (turn,) = Subject.of(plain_bracket).other_turns

    def path(number: int) -> np.ndarray:
        R = se3.rotation_exp(np.array([np.radians(-4.0 * number), 0.0, 0.0])) @ se3.rotation_exp(
            np.array([np.pi / 2, 0.0, 0.0])
        )
        return se3.make(R, np.array([0.0, 0.0, 0.55]) - R @ plain_bracket.mesh.centre)

    frames = [shoot([(plain_bracket.mesh, path(number))], number) for number in range(20)]
    tracker = Tracker({plain_bracket.name: plain_bracket})
    tracker.correct(Correction.first(plain_bracket.name, path(0) @ turn, frames[0], 0.97))
    poses = [tracker.step(frame)[0] for frame in frames]
    errors = [
        metrics.add(plain_bracket.eval_points, pose.T_cam_obj, path(number)) / plain_bracket.diameter_m
        for number, pose in enumerate(poses)
    ]
    assert errors[0] > 0.5, "at first nothing contradicts the wrong orientation"
    assert max(errors[14:]) < 0.05
    assert poses[-1].state is State.TRACKING
