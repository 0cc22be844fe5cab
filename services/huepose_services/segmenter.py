"""The segmenter worker: makes candidate masks in the detector's boxes, and sends them on with the
pixels."""

from __future__ import annotations

import msgspec
import numpy as np

from huepose.geometry import Box, Camera, RgbdFrame
from huepose.perception.embedded import DepthSegmenter
from huepose.perception.types import Segmenter
from huepose_protos import WireError
from huepose_protos.buffers import runs_of
from huepose_protos.messages import DetectedObject, Detections, MaskedObject, Masks
from huepose_services import models, networks
from huepose_services.convert import frame_from_wire
from huepose_services.following import Follower
from huepose_services.models import Outline
from huepose_services.runtime.bus import Bus
from huepose_services.runtime.clock import now_ns
from huepose_services.runtime.config import Config
from huepose_services.runtime.work import Work

# A ragged mask with more runs than this would leave no room in the header for the others: it is left out.
_MAX_RUNS = 6000
_MOST_MASKS = 8


def make(bus: Bus, config: Config) -> SegmenterWork:
    """The segmenter worker's work, with its kernels compiled."""
    outlines = models.outlines(config)
    follower = Follower(bus, lambda name: models.outline(models.load_one(config, name)), outlines)
    segmenter: Segmenter = DepthSegmenter()
    if config.segmenter.kind == "sam":
        segmenter, encoder = networks.sam(config)
        bus.log.say(f"SAM on {encoder.provider}: {encoder.path.name}")
        bus.health.count(f"provider_{encoder.provider}")
    work = SegmenterWork(bus, segmenter, outlines, follower)
    work.warm_up()
    return work


class SegmenterWork(Work):
    """Makes candidate masks for every object of the newest detections."""

    def __init__(
        self, bus: Bus, segmenter: Segmenter, outlines: dict[str, Outline], objects: Follower[Outline]
    ) -> None:
        self._bus, self._outlines, self._objects = bus, outlines, objects
        self._segmenter = segmenter
        self._detections = bus.inbox.ring(bus.keys.detections)

    def warm_up(self) -> None:
        """Segment a made-up image of a block before a wall, so that the first request is answered in
        time."""
        color = np.full((120, 160, 3), 90, np.uint8)
        depth = np.full((120, 160), 0.9, np.float32)
        color[40:80, 60:100] = (200, 40, 40)
        depth[40:80, 60:100] = 0.7
        frame = RgbdFrame(color, depth, Camera(150.0, 150.0, 79.5, 59.5, 160, 120))
        self._segmenter.segment(frame, Box(58.0, 38.0, 44.0, 44.0), 0.25)

    def step(self) -> None:
        """Segment the objects of the newest detections."""
        self._objects.keep_up(self._outlines)
        taken = self._bus.take_with_payload(self._detections, Detections)
        if taken is None:
            return
        started = now_ns()
        message, payload = taken
        try:
            frame = frame_from_wire(message.frame, payload)
        except WireError as error:
            self._bus.refuse(self._bus.keys.detections, error)
            return
        masked = [self._masked(frame, detection) for detection in message.objects]
        self._publish(message, masked, payload)
        health = self._bus.health
        health.count("boxes", len(masked))
        health.count("masks", sum(len(m.masks) for m in masked))
        health.worked_on(started, message.frame)

    def _masked(self, frame: RgbdFrame, detection: DetectedObject) -> MaskedObject:
        outline = self._outlines.get(detection.request.object)
        if outline is None:
            self._bus.health.count("unknown_objects")
            return MaskedObject(detection=detection, masks=[])
        masks = self._segmenter.segment(frame, Box(*detection.box), outline.diameter_m)
        runs = [runs_of(mask) for mask in masks if mask.any()]
        return MaskedObject(
            detection=detection, masks=[m for m in runs if len(m.runs) <= _MAX_RUNS][:_MOST_MASKS]
        )

    def _publish(self, detections: Detections, masked: list[MaskedObject], payload: bytes) -> None:
        # If all masks are too much for one message: the first of each object, the most likely one, or none.
        for most in (_MOST_MASKS, 1, 0):
            objects = [msgspec.structs.replace(m, masks=m.masks[:most]) for m in masked]
            try:
                message = Masks(
                    publish_ns=now_ns(),
                    request_seq=detections.request_seq,
                    request_ns=detections.request_ns,
                    frame=detections.frame,
                    objects=objects,
                    camera=detections.camera,
                )
                self._bus.put_pixels(self._bus.keys.masks, message, payload)
                return
            except ValueError:  # too many pixels, or (WireError) too many bytes
                if not most:
                    raise
                self._bus.health.count("masks_left_out")
