"""The tracker's hypotheses as a message, for the viewer and recordings."""

from __future__ import annotations

from huepose.tracking import Tracker
from huepose.tracking.hypothesis import shares
from huepose_protos.messages import FrameHeader, HeldHypothesis, HeldObject, HypothesesMessage
from huepose_services.convert import to_wire


def held(tracker: Tracker, header: FrameHeader, publish_ns: int) -> HypothesesMessage:
    """All hypotheses of a tracker at the frame of a header. Raises ValueError for an invalid pose."""
    objects = []
    for name, instance in tracker.instances:
        opinions = tracker.hypotheses(name, instance)
        hypotheses = [
            to_wire(HeldHypothesis, opinion, share=share)
            for opinion, share in zip(opinions, shares(opinions), strict=True)
        ]
        objects.append(HeldObject(object=name, instance=instance, hypotheses=hypotheses))
    return HypothesesMessage(
        publish_ns=publish_ns,
        camera_epoch=header.camera_epoch,
        frame_id=header.frame_id,
        capture_ns=header.capture_ns,
        objects=objects,
    )
