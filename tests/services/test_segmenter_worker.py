"""What the segmenter worker sends on if all its masks are too much for one message."""

from types import SimpleNamespace

import msgspec
import numpy as np
import pytest

from huepose_protos import decode, encode, parts
from huepose_protos.examples import GOLDEN, example
from huepose_protos.messages import Detections, Masks
from huepose_services.segmenter import SegmenterWork
from tests.services.fake_bus import FakeBus


@pytest.mark.parametrize(("most_pixels", "sent"), [(6 * 8, 2), (6 * 8 - 1, 1), (3 * 8 - 1, 0)])
def test_masks_that_are_too_many_for_a_message_are_left_out(monkeypatch, most_pixels, sent):
    monkeypatch.setattr(parts, "MAX_CANDIDATE_PIXELS", most_pixels)
    detections = example(Detections)  # its image has 4 x 2 pixels
    (box, *_) = detections.objects
    bus = FakeBus("segmenter")
    bus.arriving[Detections] = [
        (msgspec.structs.replace(detections, objects=3 * [box]), (GOLDEN / "frame_payload.bin").read_bytes())
    ]
    segmenter = SimpleNamespace(segment=lambda *_: 2 * [np.ones((2, 4), bool)])
    outlines = {box.request.object: SimpleNamespace(diameter_m=0.1)}
    work = SegmenterWork(bus, segmenter, outlines, SimpleNamespace(keep_up=lambda outlines: None))
    work.step()
    (message,) = bus.said
    assert [len(one.masks) for one in decode(encode(message), Masks).objects] == 3 * [sent]
