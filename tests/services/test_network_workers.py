"""Detector and segmenter with networks of known answers, on a real bus: a request in, the known mask out."""

from dataclasses import replace

import msgspec
import numpy as np
import pytest
import zenoh

from huepose.geometry import Box, Camera, RgbdFrame
from huepose.model import load_models, save_model
from huepose_protos.buffers import mask_of
from huepose_protos.messages import Detections, FrameHeader, Masks, PerceptionRequest, RequestedObject
from huepose_services import detector, segmenter
from huepose_services.camera.publish import packed
from huepose_services.runtime.bus import Bus
from huepose_services.runtime.clock import SECOND, now_ns, this_clock
from huepose_services.runtime.config import ObjectConfig
from huepose_services.runtime.session import open_reader_session, zenoh_config
from tests.perception import networks
from tests.services.conftest import parse
from tests.services.sessions import close_bus

BOX = Box(200.0, 120.0, 160.0, 200.0)
TEXT = """
        workers: [detector, segmenter]
        bundles: bundles
        objects: [{name: tea_box}]
        detector: {kind: yolo, model: yolo.onnx, classes: {tea_box: 1}}
        segmenter: {kind: sam, encoder: encoder.onnx, decoder: decoder.onnx}
"""


@pytest.fixture
def config(tmp_path, tea_box, base_port):
    """Two workers whose networks detect a tea box in BOX, and segment the box that they get."""
    save_model(tea_box, tmp_path / "bundles" / "tea_box.huepose")
    networks.sam_encoder(tmp_path / "encoder.onnx")
    networks.sam_decoder(tmp_path / "decoder.onnx")
    rows = np.zeros((20, 6), np.float32)
    # 640 x 480 in 64 x 64: a tenth, 8 rows from the top.
    rows[4] = [BOX.x / 10, BOX.y / 10 + 8, BOX.x1 / 10, BOX.y1 / 10 + 8, 0.8, 1]
    networks.constant_output(tmp_path / "yolo.onnx", rows[None])
    return parse(TEXT + f"\n        bus: {{base_port: {base_port}}}", tmp_path / "pipeline.yaml")


@pytest.fixture
def buses(config):
    """One bus for the worker, one for all others."""
    endpoint = config.endpoint("detector")
    sessions = zenoh.open(zenoh_config([endpoint], [])), open_reader_session([endpoint])
    made = [Bus(session, config.keys, "test") for session in sessions]
    yield made
    for bus in made:
        close_bus(bus)


def _frame():
    camera = Camera(600.0, 600.0, 320.0, 240.0, 640, 480)
    color = np.full((480, 640, 3), 90, np.uint8)
    return packed(RgbdFrame(color, np.ones((480, 640), np.float32), camera), 0.0001)


def _answer(ask, work, bus, place, kind, wait_until):
    """Requests and steps the worker until its answer is there: subscriptions take a moment to be known."""

    def answered():
        ask()
        work.step()
        return bus.take_with_payload(place, kind)

    return wait_until(answered)


def test_an_object_without_a_class_of_the_network_is_reported_from_the_start(
    config, buses, tmp_path, printed
):
    """By validate and by the worker's health, until it has a class or is not searched for any more."""
    known = load_models(config.bundles, ["tea_box"])["tea_box"]
    save_model(replace(known, name="can"), tmp_path / "bundles" / "can.huepose")
    objects = [ObjectConfig(name="tea_box"), ObjectConfig(name="can")]
    file = tmp_path / "pipeline.yaml"
    text = TEXT.replace("[{name: tea_box}]", "[{name: tea_box}, {name: can}]")
    file.write_text(text + "\n        camera: {source: realsense}")
    said = "The detector's network has no class for can, so it never gives a box"
    assert f"NOTE     {said}" in printed(["validate", file])
    file.write_text(
        text.replace("tea_box: 1", "tea_box: 1, can: 0") + "\n        camera: {source: realsense}"
    )
    assert "never gives a box" not in printed(["validate", file])
    worker, _ = buses
    detector.make(worker, msgspec.structs.replace(config, objects=objects))
    assert [w for w in worker.health.message().warnings if w.startswith(said)]
    detector.make(worker, config)
    assert not [w for w in worker.health.message().warnings if "never gives a box" in w]


def test_the_segmenter_segments_what_the_detector_finds(config, buses, wait_until):
    worker, other = buses
    keys = config.keys
    boxes, masks = other.inbox.ring(keys.detections), other.inbox.ring(keys.masks)
    finding = detector.make(worker, config)
    outlining = segmenter.make(worker, config)
    assert worker.health.counters["provider_cpu"] == 2
    packed_frame, now = _frame(), now_ns()
    header = FrameHeader(
        publish_ns=now,
        camera_epoch=1,
        frame_id=7,
        capture_ns=now,
        clock=this_clock(),
        frame="cam0_color_optical",
        intrinsics=packed_frame.intrinsics,
        buffers=packed_frame.buffers,
    )
    wanted = RequestedObject(object="tea_box", instance=None)
    request = PerceptionRequest(
        publish_ns=now, seq=3, camera_epoch=1, deadline_ns=now + SECOND, objects=[wanted]
    )

    def ask_for_boxes():
        other.put_pixels(keys.frame, header, packed_frame.payload)
        other.put_control(keys.request, request)

    found, payload = _answer(ask_for_boxes, finding, other, boxes, Detections, wait_until)
    assert payload == packed_frame.payload
    assert found.objects[0].box == pytest.approx(BOX, abs=0.01)
    assert found.objects[0].score == pytest.approx(0.8)

    def ask_for_masks():
        other.put_pixels(keys.detections, found, payload)

    outlined, _ = _answer(ask_for_masks, outlining, other, masks, Masks, wait_until)
    (mask,) = outlined.objects[0].masks
    assert Box.of_mask(mask_of(mask)).iou(BOX) > 0.98
