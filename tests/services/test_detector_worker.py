"""What the detector worker reports while it finds nothing."""

import threading
import time
from dataclasses import replace
from types import SimpleNamespace

import msgspec
import numpy as np

from huepose.geometry import Box
from huepose.perception.exchanged import ChannelOrder
from huepose.perception.view_detector import ViewDetector
from huepose_protos import decode, encode
from huepose_protos.examples import GOLDEN, example
from huepose_protos.messages import (
    Detections,
    FrameHeader,
    ObjectsMessage,
    PerceptionRequest,
    RequestedObject,
)
from huepose_services import detector as worker
from huepose_services import models
from huepose_services.boxes import SearchedBoxes, detected
from huepose_services.detector import ASK_EVERY_NS, DetectorWork
from huepose_services.following import Follower, reading_text
from huepose_services.models import outline
from huepose_services.runtime.config import Config
from tests.services.fake_bus import FakeBus, listed, sent


def test_images_with_red_and_blue_exchanged_are_reported(monkeypatch, tea_box, box_frame):
    now = [10 * ASK_EVERY_NS]
    monkeypatch.setattr(worker, "now_ns", lambda: now[0])
    bus = FakeBus("detector")
    finder = SearchedBoxes({"tea_box": outline(tea_box)}, ViewDetector({"tea_box": tea_box}))
    work = DetectorWork(bus, finder, SimpleNamespace(changes=lambda: [], reading=frozenset()))
    wanted = [RequestedObject(object="tea_box", instance=None)]
    request = msgspec.structs.replace(example(PerceptionRequest), objects=wanted)

    def warned(color):
        shot = replace(box_frame, color=np.ascontiguousarray(color))
        arriving = sent(shot, 0.0002, capture_ns=now[0])
        bus.arriving |= {FrameHeader: [arriving], PerceptionRequest: [request]}
        work.step()
        return bus.health.message().warnings

    assert warned(box_frame.color[:, :, ::-1]) == []  # it has only just begun
    assert bus.said[-1].objects == [] or max(box.score for box in bus.said[-1].objects) < 0.7
    now[0] += ASK_EVERY_NS
    (said,) = warned(box_frame.color[:, :, ::-1])
    assert said.startswith("With red and blue exchanged, tea_box is found in the image")
    assert bus.logged["colours"] == [said]
    warned(box_frame.color[:, :, ::-1])
    assert bus.said[-1].camera == said, "it is sent on with the boxes, up to every pose"
    now[0] += ASK_EVERY_NS
    assert warned(box_frame.color) == []
    assert [box.request.object for box in bus.said[-1].objects] == ["tea_box"]


def test_the_order_of_the_colours_is_checked_a_limited_number_of_times(monkeypatch):
    """Also if something is found, which may be wrong; not for ever: a check takes as long as a search."""
    now, asked = [10 * ASK_EVERY_NS], []
    monkeypatch.setattr(worker, "now_ns", lambda: now[0])
    finder = SearchedBoxes({}, ViewDetector({}))
    order = ChannelOrder()

    def ask(frame, names, seen):
        asked.append(now[0])
        return order

    finder.order_of_channels = ask
    finder.find = lambda *asked: []
    bus = FakeBus("detector")
    work = DetectorWork(bus, finder, SimpleNamespace(changes=lambda: [], reading=frozenset()))
    header = example(FrameHeader)
    followed = example(PerceptionRequest)
    assert followed.objects[0].prior is not None

    def asks_in(seconds, epoch):
        before = len(asked)
        for _ in range(seconds):
            now[0] += ASK_EVERY_NS // 2
            frame = msgspec.structs.replace(header, camera_epoch=epoch)
            pixels = (GOLDEN / "frame_payload.bin").read_bytes()
            bus.arriving |= {FrameHeader: [(frame, pixels)], PerceptionRequest: [followed]}
            work.step()
        return len(asked) - before

    assert [asks_in(12, epoch) for epoch in (1, 1, 2, 2)] == [worker.FIRST_ASKS, 0, worker.FIRST_ASKS, 0]
    order = ChannelOrder(right=True)
    assert [asks_in(12, epoch) for epoch in (3, 3, 4)] == [1, 0, 1], "an object shows that it is right"


def test_a_request_that_comes_before_the_first_frame_waits_for_it():
    finder = SearchedBoxes({}, ViewDetector({}))
    finder.find = lambda *asked: []
    bus = FakeBus("detector")
    work = DetectorWork(bus, finder, SimpleNamespace(changes=lambda: [], reading=frozenset()))
    request, header = example(PerceptionRequest), example(FrameHeader)
    bus.arriving[PerceptionRequest] = [request]
    assert work.due_ns() is None
    work.step()
    assert not bus.said
    assert work.due_ns() is not None, "a frame does not wake the loop"
    bus.arriving[FrameHeader] = [(header, (GOLDEN / "frame_payload.bin").read_bytes())]
    work.step()
    assert [(m.request_seq, m.frame) for m in bus.said] == [(request.seq, header)]


def test_an_object_that_was_removed_during_the_check_raises_no_error(tea_box, box_frame):
    finder = SearchedBoxes({"tea_box": outline(tea_box)}, ViewDetector({"tea_box": tea_box}))
    assert finder.order_of_channels(box_frame, ["removed", "tea_box"], {"removed": 0.0, "tea_box": 1.0}).right
    finder.remove("tea_box")
    assert finder.order_of_channels(box_frame, ["tea_box"], {"tea_box": 0.0}) == ChannelOrder()


def test_a_request_about_a_frame_that_was_answered_waits_for_the_next_one():
    finder = SearchedBoxes({}, ViewDetector({}))
    finder.find = lambda *asked: []
    bus = FakeBus("detector")
    work = DetectorWork(bus, finder, SimpleNamespace(changes=lambda: [], reading=frozenset()))
    header, payload = example(FrameHeader), (GOLDEN / "frame_payload.bin").read_bytes()
    seen = msgspec.structs.replace(example(PerceptionRequest), seen=(header.camera_epoch, header.frame_id))
    bus.arriving |= {FrameHeader: [(header, payload)], PerceptionRequest: [seen]}
    for _ in range(3):
        work.step()
    assert bus.said == []
    assert work.due_ns() is not None, "it looks for a newer one soon"
    newer = msgspec.structs.replace(header, frame_id=header.frame_id + 1)
    bus.arriving[FrameHeader] = [(newer, payload)]
    for _ in range(3):
        work.step()
    assert [(said.frame.frame_id, said.request_seq) for said in bus.said] == [(newer.frame_id, seen.seq)]
    assert work.due_ns() is None


def test_the_views_of_an_added_object_are_prepared_while_it_is_loaded(tea_box, monkeypatch):
    prepared = []
    monkeypatch.setattr(worker, "window_table", prepared.append)
    monkeypatch.setattr(models, "load", lambda config: {})
    monkeypatch.setattr(models, "load_one", lambda config, name: tea_box)
    work = worker.make(FakeBus("detector"), Config())
    assert work._objects._load("tea_box") is tea_box
    assert prepared == [tea_box]


def test_while_the_model_of_an_added_object_is_read_a_warning_says_so():
    go_on = threading.Event()
    bus = FakeBus("detector")
    finder = SearchedBoxes({}, ViewDetector({}))
    finder.add = lambda model: None
    follower = Follower(bus, lambda name: go_on.wait(5.0), [])
    work = DetectorWork(bus, finder, follower)
    bus.arriving[ObjectsMessage] = [listed("mug")]
    work.step()
    assert bus.health.message().warnings == [reading_text("mug")]
    go_on.set()
    until = time.monotonic() + 5.0
    while bus.health.message().warnings and time.monotonic() < until:
        work.step()
    assert bus.health.message().warnings == []


def test_more_boxes_than_a_message_can_have_are_left_out_last_of_each_object_first():
    wanted = [RequestedObject(object=name, instance=None, wanted=40) for name in ("cup", "box")]
    wanted.append(RequestedObject(object="can", instance=0))
    request = msgspec.structs.replace(example(PerceptionRequest), objects=wanted)
    finder = SearchedBoxes({}, ViewDetector({}))
    finder.find = lambda *asked: [
        detected(one, Box(k, 0.0, 1.0, 1.0)) for one in wanted for k in range(one.wanted)
    ]
    bus = FakeBus("detector")
    work = DetectorWork(
        bus, finder, SimpleNamespace(changes=lambda: [], reading=frozenset()), check_camera=False
    )
    pixels = (GOLDEN / "frame_payload.bin").read_bytes()
    bus.arriving |= {FrameHeader: [(example(FrameHeader), pixels)], PerceptionRequest: [request]}
    work.step()
    boxes = decode(encode(bus.said[-1]), Detections).objects
    left = {name: [b.box[0] for b in boxes if b.request.object == name] for name in ("cup", "box", "can")}
    assert left == {"cup": list(range(32)), "box": list(range(31)), "can": [0]}
