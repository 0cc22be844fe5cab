"""Bad bytes give WireError with a reason, and nothing else."""

import math

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from huepose_protos import WireError, decode, encode
from huepose_protos.buffers import frame_images, mask_of, pack, runs_of, unpack
from huepose_protos.examples import images, messages
from huepose_protos.keys import Keys
from huepose_protos.messages import (
    MESSAGES,
    BufferSpec,
    Detections,
    FrameHeader,
    Look,
    MaskRuns,
    Masks,
    PerceptionRequest,
    PoseMessage,
)

EXAMPLES = {type(m): m for m in messages()}
POSE = EXAMPLES[PoseMessage]


def _altered(message, **changes):
    return msgspec.msgpack.encode({**msgspec.to_builtins(message), **changes})


@settings(max_examples=300, deadline=None)
@given(st.binary(max_size=300), st.sampled_from(MESSAGES))
def test_garbage_is_a_wire_error(data, kind):
    with pytest.raises(WireError):
        decode(data, kind)


@settings(max_examples=300, deadline=None)
@given(st.data(), st.sampled_from(MESSAGES))
def test_truncated_bytes_are_a_wire_error(data, kind):
    whole = encode(EXAMPLES[kind])
    cut = data.draw(st.integers(0, len(whole) - 1))
    with pytest.raises(WireError):
        decode(whole[:cut], kind)


@pytest.mark.parametrize("byte", [b"\x91", b"\x81\xa1x", b"\xdd\xff\xff\xff\xff", b"\xdf\xff\xff\xff\xff"])
def test_deep_nesting_and_huge_lengths_are_wire_errors(byte):
    for kind in MESSAGES:
        with pytest.raises(WireError):
            decode(b"\x81\xa3foo" + byte * (kind.max_bytes // len(byte) // 2), kind)


def test_messages_of_the_largest_request_are_within_their_size_limits():
    """As many objects as a request may name, each with as many instances as a configuration may ask for; all
    but one instance are TRACKING."""
    replace = msgspec.structs.replace
    asked = next(one for one in EXAMPLES[PerceptionRequest].objects if one.prior is not None)
    asked = replace(asked, instance=None, prior=None, others=[asked.prior] * 15)
    request = replace(EXAMPLES[PerceptionRequest], objects=[asked] * 64)
    boxed = replace(EXAMPLES[Detections].objects[0], request=asked)
    masked = replace(EXAMPLES[Masks].objects[0], detection=boxed)
    for message in (
        request,
        replace(EXAMPLES[Look], request=request),
        replace(EXAMPLES[Detections], objects=[boxed] * 64),
        replace(EXAMPLES[Masks], objects=[masked] * 64),
    ):
        assert decode(encode(message), type(message)) == message


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"translation": [math.nan, 0.0, 1.0]}, "not finite"),
        ({"translation": [0.0, 0.0, math.inf]}, "not finite"),
        ({"quaternion": [0.0, 0.0, 0.0, 0.9]}, "unit length"),
        ({"quaternion": [0.0, 0.0, 0.0, 0.0]}, "unit length"),
        ({"quaternion": [0.0, 0.0, 1.0]}, "quaternion"),
        ({"quaternion": None}, "together"),
        ({"translation": None, "quaternion": None}, "does not go with the state TRACKING"),
        ({"state": "LOST"}, "does not go with the state LOST"),
        ({"state": "tracking"}, "$.state"),
        ({"covariance": [0.0] * 35}, "$.covariance"),
        ({"covariance": [-1.0] + [0.0] * 35}, "negative variance"),
        ({"covariance": [math.nan] * 36}, "not finite"),
        ({"quality": 1.5}, "$.quality"),
        ({"quality": math.nan}, "quality"),
        ({"object": "Mustard Bottle"}, "$.object"),
        ({"object": "mustard\n"}, "$.object"),
        ({"frame_id": -1}, "$.frame_id"),
        ({"capture_ns": 2**63}, "$.capture_ns"),
        ({"version": "2.0"}, "foreign version 2.0"),
        ({"version": "2.0", "translation": "elsewhere"}, "foreign version 2.0"),
        ({"version": 1}, "$.version"),
    ],
)
def test_a_bad_pose_is_refused_with_its_reason(changes, reason):
    with pytest.raises(WireError) as error:
        decode(_altered(POSE, **changes), PoseMessage)
    assert reason in str(error.value)


@pytest.mark.parametrize("number", [math.nan, math.inf, -math.inf])
def test_a_number_that_is_not_finite_is_refused_everywhere(number):
    def poisoned(value):
        """All copies of the value in which one float is replaced by that number."""
        if isinstance(value, float):
            yield number
        elif isinstance(value, dict):
            for key, inner in value.items():
                for bad in poisoned(inner):
                    yield {**value, key: bad}
        elif isinstance(value, list | tuple):
            for i, inner in enumerate(value):
                for bad in poisoned(inner):
                    yield [*value[:i], bad, *value[i + 1 :]]

    tried = 0
    for kind, example in EXAMPLES.items():
        for bad in poisoned(msgspec.to_builtins(example)):
            tried += 1
            with pytest.raises(WireError):
                decode(msgspec.msgpack.encode(bad), kind)
    assert tried > 100


def test_a_newer_minor_version_with_more_fields_is_read():
    assert decode(_altered(POSE, version="1.9", colour="yellow"), PoseMessage).translation == POSE.translation


def test_a_pose_may_have_no_reason_and_has_a_centre():
    pose = msgspec.msgpack.decode(encode(POSE))
    assert pose["centre"] == [0.0, -0.015625, 0.09375]
    del pose["reason"]
    assert decode(msgspec.msgpack.encode(pose), PoseMessage).reason == ""
    del pose["centre"]
    with pytest.raises(WireError, match="centre"):
        decode(msgspec.msgpack.encode(pose), PoseMessage)


def test_a_message_over_its_size_limit_is_refused_by_sender_and_receiver():
    with pytest.raises(WireError, match="over 4096"):
        decode(encode(POSE) + b"\0" * 5000, PoseMessage)
    with pytest.raises(WireError, match="over 65536"):
        encode(msgspec.structs.replace(EXAMPLES[FrameHeader], buffers=[], frame="x" * 70_000))


@pytest.mark.parametrize("site", ["", "a/b", "**", "Lab", "lab\n", "x" * 65])
def test_a_key_with_an_invalid_site_is_refused(site):
    with pytest.raises(WireError):
        Keys(site, "cam0")


@given(st.integers(1, 12), st.integers(1, 12), st.data())
def test_run_lengths_give_the_mask_back(height, width, data):
    bits = data.draw(st.lists(st.booleans(), min_size=height * width, max_size=height * width))
    mask = np.array(bits).reshape(height, width)
    assert (mask_of(runs_of(mask)) == mask).all()


def test_run_lengths_that_do_not_fit_are_refused():
    with pytest.raises(ValueError, match="add up"):
        MaskRuns(width=4, height=2, runs=[9])


class TestBuffers:
    header = EXAMPLES[FrameHeader]

    def test_arrays_come_back(self):
        arrays = {
            "a": np.arange(6, dtype=np.float32).reshape(2, 3),
            "b": np.zeros((0, 4), np.uint8),
            "c": np.arange(5, dtype=">u2"),
        }
        back = unpack(*pack(arrays))
        assert list(back) == list(arrays)
        for name, array in arrays.items():
            assert (back[name] == array).all()
            assert back[name].dtype.itemsize == array.dtype.itemsize

    @pytest.mark.parametrize("payload", [b"", b"x", pack(images())[1][:-1], pack(images())[1] + b"x"])
    def test_a_payload_of_the_wrong_size_is_refused(self, payload):
        with pytest.raises(WireError):
            frame_images(self.header, payload)

    @pytest.mark.parametrize(
        "arrays",
        [
            {"color": images()["color"]},
            {"color": images()["color"], "depth": images()["depth"].T},
            {"color": images()["color"], "depth": images()["depth"].astype(np.float32)},
            {"color": images()["depth"], "depth": images()["depth"]},
        ],
    )
    def test_images_that_do_not_fit_the_intrinsics_are_refused(self, arrays):
        specs, payload = pack(arrays)
        with pytest.raises(WireError):
            frame_images(msgspec.structs.replace(self.header, buffers=specs), payload)

    @pytest.mark.parametrize("offset", [1, 2**40])
    def test_overlapping_or_far_buffers_are_refused(self, offset):
        specs, payload = pack(images())
        moved = [specs[0], msgspec.structs.replace(specs[1], offset=offset)]
        with pytest.raises(WireError):
            unpack(moved, payload)


@pytest.mark.parametrize(
    ("kind", "few_bytes"),
    [
        (MaskRuns, {"width": 16384, "height": 16384, "runs": [16384 * 16384]}),
        (MaskRuns, {"width": 16384, "height": 820, "runs": [16384 * 820]}),
    ],
)
def test_a_mask_of_more_pixels_than_a_frame_may_have_is_refused(kind, few_bytes):
    with pytest.raises(msgspec.ValidationError, match="more pixels than a frame may have"):
        msgspec.convert(few_bytes, kind)


def test_many_masks_in_a_few_bytes_are_refused_before_memory_is_taken():
    large = MaskRuns(width=4096, height=3200, runs=[4096 * 3200])
    example = EXAMPLES[Masks]
    item = msgspec.structs.replace(example.objects[0], masks=[large] * 8)
    many = msgspec.to_builtins(msgspec.structs.replace(example, objects=[item]))
    many["objects"] *= 8
    data = msgspec.msgpack.encode(many)
    assert len(data) < 10_000
    with pytest.raises(WireError, match="pixels together"):
        decode(data, Masks)


def test_a_mask_of_another_size_than_its_frame_is_refused():
    mask = MaskRuns(width=4096, height=3200, runs=[4096 * 3200])
    with pytest.raises(WireError, match="has not the size of its frame"):
        mask_of(mask, (480, 640))
    assert mask_of(MaskRuns(width=3, height=2, runs=[6]), (2, 3)).shape == (2, 3)


@pytest.mark.parametrize("shape", [[2**24, 2**24, 2**24, 0], [0, 2**24, 2**24, 2**24]])
def test_shapes_that_no_array_can_have_are_refused(shape):
    with pytest.raises(WireError, match="buffer color"):
        unpack([BufferSpec(name="color", dtype="uint8", shape=shape, offset=0)], b"")
