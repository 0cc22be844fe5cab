"""Poses, priors, corrections, estimates and depth are unchanged after encoding and decoding."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace as replace_fields

from huepose.believe.state import State
from huepose.estimation.types import PoseEstimate
from huepose.geometry import Box, se3
from huepose.reinit.types import Prior, Request, RequestedObject
from huepose.tracking.types import Correction, TrackedPose, Verdict
from huepose_protos import WireError, decode, encode
from huepose_protos.buffers import pack
from huepose_protos.examples import example, images
from huepose_protos.messages import (
    CorrectionMessage,
    EstimatedObject,
    Estimates,
    FrameHeader,
    PerceptionRequest,
    PoseMessage,
)
from huepose_services.convert import (
    depth_to_wire,
    frame_from_wire,
    from_wire,
    pose_from_wire,
    pose_to_wire,
    prior_from_wire,
    request_to_wire,
    to_wire,
    tracked_to_wire,
)
from huepose_services.reinit import reasons_not_seen, result_from_wire

T = se3.make(se3.rotation_exp(np.array([0.4, -1.2, 0.3])), np.array([0.1, -0.05, 0.8]))
VELOCITY = np.array([0.1, 0.2, -0.3, 1.0, -2.0, 0.5])
COVARIANCE = np.diag([1e-6, 2e-6, 3e-6, 1e-4, 2e-4, 3e-4])
MASK = np.zeros((48, 64), bool)
MASK[10:20, 30:40] = True
HEADER = example(FrameHeader)

finite = st.floats(-3.0, 3.0)


def _through(message):
    return decode(encode(message), type(message))


@given(st.tuples(finite, finite, finite), st.tuples(finite, finite, finite))
def test_any_pose_is_decoded_unchanged(rotation, translation):
    pose = se3.make(se3.rotation_exp(np.array(rotation)), np.array(translation))
    assert np.allclose(pose_from_wire(*pose_to_wire(pose)), pose, atol=1e-12)


def test_a_tracked_pose_is_decoded_unchanged():
    pose = TrackedPose("thing", 2, 5, 9, 123, State.SUSPECT, T, VELOCITY, 0.5, COVARIANCE, 7)
    message = _through(tracked_to_wire(pose, HEADER, 456, np.zeros(3)))
    assert isinstance(message, PoseMessage)
    assert message.publish_ns == 456
    back = from_wire(TrackedPose, message)
    for name in ("object", "instance", "epoch", "frame_id", "stamp_ns", "state", "quality"):
        assert getattr(back, name) == getattr(pose, name)
    assert back.applied_correction_seq == 7
    assert np.allclose(back.T_cam_obj, T)
    assert (back.velocity == VELOCITY).all()
    assert (back.covariance == COVARIANCE).all()
    assert (message.frame, message.clock_id) == (HEADER.frame, HEADER.clock.clock_id)


@pytest.mark.parametrize("state", [State.LOST, State.SEARCHING])
def test_without_a_pose_all_its_fields_are_null(state):
    pose = TrackedPose("thing", 2, 5, 9, 123, state, None, None, 0.0, None, 0)
    message = _through(tracked_to_wire(pose, HEADER, 456, np.zeros(3)))
    assert message.translation is message.quaternion is message.covariance is None
    assert from_wire(TrackedPose, message).T_cam_obj is None


def test_an_invalid_pose_is_never_sent():
    broken = T.copy()
    broken[0, 3] = np.nan
    pose = TrackedPose("thing", 2, 5, 9, 123, State.TRACKING, broken, None, 0.9, None, 0)
    with pytest.raises(ValueError, match="not finite"):
        tracked_to_wire(pose, HEADER, 456, np.zeros(3))


def test_a_correction_is_decoded_unchanged_without_its_mask():
    correction = Correction("thing", 1, 5, 9, 123, T, 0.9, Verdict.ACQUIRE, 3, MASK, present=0.95)
    message = _through(to_wire(CorrectionMessage, correction, publish_ns=1))
    assert isinstance(message, CorrectionMessage)
    back = from_wire(Correction, message)
    assert np.allclose(back.T_cam_obj, T)
    assert back.mask is None
    assert (back.verdict, back.seq, back.stamp_ns, back.present) == (Verdict.ACQUIRE, 3, 123, 0.95)


def test_a_request_and_its_priors_are_decoded_unchanged():
    prior = Prior(T, VELOCITY, COVARIANCE, 1_000_000_000)
    asked = (RequestedObject("thing", 4, prior), RequestedObject("other", None, None, 2))
    message = _through(request_to_wire(Request(8, None, 20, asked), 1008))
    assert isinstance(message, PerceptionRequest)
    assert (message.seq, message.camera_epoch, message.deadline_ns) == (1008, None, 20)
    known, new = message.objects
    assert (new.object, new.instance, new.wanted) == ("other", None, 2)
    back, middle = prior_from_wire(known.prior), np.array([0.01, 0.0, 0.2])
    assert np.allclose(back.predicted(1_100_000_000, middle), prior.predicted(1_100_000_000, middle))


@pytest.mark.parametrize("instance", [None, 3])
def test_estimates_are_decoded_unchanged(instance):
    found = PoseEstimate(
        "thing",
        -1,
        True,
        T,
        quality=0.9,
        state=State.TRACKING,
        score=1.5,
        margin=0.2,
        covariance=COVARIANCE,
        mask=MASK,
        box=Box(1, 2, 3, 4),
        prior_score=1.4,
        prior_T_cam_obj=T,
        present=0.96,
    )
    lost = PoseEstimate("thing", -1, score=0.1, reason="Hidden.")
    message = Estimates(
        publish_ns=1,
        request_seq=8,
        camera_epoch=5,
        frame_id=9,
        capture_ns=123,
        estimates=[
            to_wire(EstimatedObject, found, instance=instance),
            to_wire(EstimatedObject, lost, instance=instance),
        ],
    )
    result = result_from_wire(_through(message), 8)
    assert (result.request, result.epoch, result.frame_id, result.stamp_ns) == (8, 5, 9, 123)
    back, nothing = result.estimates
    assert back.instance == (-1 if instance is None else instance)
    assert np.allclose(back.T_cam_obj, T)
    assert np.allclose(back.prior_T_cam_obj, T)
    assert back.mask is None
    assert (back.score, back.prior_score, back.margin, back.quality) == (1.5, 1.4, 0.2, 0.9)
    assert not nothing.found
    assert nothing.T_cam_obj is None
    assert (back.present, nothing.present) == (0.96, None)
    assert (back.reason, nothing.reason) == ("", "Hidden.")


def test_the_reasons_why_objects_are_not_found():
    def seen(name, quality, reason="", instance=None):
        T_found = None if reason else T
        pose = PoseEstimate(
            name, -1, not reason, T_found, quality, "SUSPECT", 1.0, 0.0, None, None, None, None, None, (), 0.1
        )
        return to_wire(EstimatedObject, replace(pose, reason=reason), instance=instance)

    answer = Estimates(
        publish_ns=1,
        request_seq=8,
        camera_epoch=5,
        frame_id=9,
        capture_ns=123,
        estimates=[seen("mug", 0.0, "Hidden."), seen("jar", 0.62), seen("can", 0.9, instance=2)],
    )
    assert reasons_not_seen(["mug", "jar", "can"], answer) == {
        "mug": "Hidden.",
        "jar": "Something like it is visible, too doubtful to track (quality 0.62).",
        "can": "No place in the image looks like the object.",
    }
    unconfirmed = {"jar": "Something was found, but the tracker has not confirmed it."}
    assert reasons_not_seen(["jar"], answer, {"jar"}) == unconfirmed
    # A second jar is searched for: the one that is found, well or not, is the tracked one.
    of_two = {"jar": "No second instance is visible."}
    assert reasons_not_seen(["jar"], answer, (), {"jar"}) == of_two


def test_depth_is_rounded_to_its_unit_and_values_out_of_range_are_no_reading():
    depth = np.array([[0.0, 0.50004, 6.5534, 6.5535, 6.6, -1.0, np.nan, np.inf]], np.float32)
    assert depth_to_wire(depth, 1e-4).tolist() == [[0, 5000, 65534, 0, 0, 0, 0, 0]]


def test_a_frame_with_impossible_intrinsics_or_size_is_refused():
    specs, payload = pack(images())
    far_off = replace_fields(HEADER.intrinsics, cx=1.5e308, cy=1.5e308)
    header = _through(replace_fields(HEADER, intrinsics=far_off, buffers=specs))
    with pytest.raises(WireError, match="principal point"):
        frame_from_wire(header, payload)
    specs, payload = pack({name: pixels[:, :1] for name, pixels in images().items()})
    thin = replace_fields(HEADER.intrinsics, width=1)
    header = _through(replace_fields(HEADER, intrinsics=thin, buffers=specs))
    with pytest.raises(WireError, match="sides of 2 pixels"):
        frame_from_wire(header, payload)
