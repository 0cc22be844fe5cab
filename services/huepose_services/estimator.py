"""The estimator worker: poses of the objects whose masks and pixels arrive."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from huepose.estimation import Estimator, ObjectQuery
from huepose.estimation.apparent_size import apparent_size
from huepose.estimation.frame_offset import frame_offset
from huepose.estimation.types import PoseEstimate, PosePrior
from huepose.geometry import RgbdFrame
from huepose.geometry.arrays import Float64
from huepose.geometry.picture_faults import why_nothing_is_found
from huepose.model import ReferenceModel
from huepose.profiles import profile
from huepose_protos import WireError
from huepose_protos.buffers import mask_of
from huepose_protos.messages import EstimatedObject, Estimates, MaskedObject, Masks
from huepose_services import models
from huepose_services.convert import box_from_wire, frame_from_wire, prior_from_wire, to_wire
from huepose_services.following import Follower
from huepose_services.runtime.bus import Bus
from huepose_services.runtime.clock import SECOND, now_ns
from huepose_services.runtime.config import Config
from huepose_services.runtime.work import Work

LOOKS, FEWEST_LOOKS, LOOK_EVERY_NS = 12, 3, SECOND
"""Looks at the size of objects in the picture: how many of an epoch of the camera, how many are asked for a
warning, and their distance in time. One takes some 30 ms of a processor."""

OFFSET_EVERY_NS = 5 * SECOND
"""While nothing is found, so long from one look at the offset of depth to the next."""

WAY_OUT = "No pose is TRACKING for it. If all three are right, set estimator.check_sizes: false."


def make(bus: Bus, config: Config) -> EstimatorWork:
    """The estimator worker's work, with its kernels compiled."""
    settings = replace(
        profile(config.profile).estimator,
        method=config.estimator.method,
        threads=config.estimator.threads,
    )
    estimator = Estimator(models.load(config), settings)
    estimator.warm_up()
    follower = Follower(bus, lambda name: models.load_one(config, name), estimator.objects)
    return EstimatorWork(bus, estimator, follower, SizesSeen(LOOKS if config.estimator.check_sizes else 0))


class SizesSeen:
    """Whether objects are as large in the pictures of a camera as its matrix says: a few looks at sure poses,
    some time apart, since none of them is worth much alone."""

    def __init__(self, most: int = LOOKS) -> None:
        self._most, self._epoch, self._next_ns = most, -1, 0
        self._looks: list[Float64] = []
        self.doubt = ""  # what is wrong in the epoch that was asked about last

    def wanted(self, epoch: int, at_ns: int) -> bool:
        """Whether to look now, at a picture of that epoch of the camera."""
        if epoch != self._epoch:
            self._epoch, self._looks, self.doubt = epoch, [], ""
        return len(self._looks) < self._most and at_ns >= self._next_ns

    def add(self, frame: RgbdFrame, looks: Sequence[Float64], at_ns: int) -> None:
        """Take what was seen in a frame."""
        self._looks += looks
        if looks:
            self._next_ns = at_ns + LOOK_EVERY_NS
        size = apparent_size(self._looks)
        clear = len(self._looks) >= FEWEST_LOOKS and size.clear
        self.doubt = size.said(frame.camera) if clear else ""


class EstimatorWork(Work):
    """Answers the newest masks."""

    def __init__(
        self,
        bus: Bus,
        estimator: Estimator,
        objects: Follower[ReferenceModel],
        sizes: SizesSeen | None = None,
    ) -> None:
        self._bus, self._estimator, self._objects = bus, estimator, objects
        self._masks = bus.inbox.ring(bus.keys.masks)
        self._sizes = sizes or SizesSeen()
        self._blames_picture = False
        self._offset: tuple[int, str | None] = (0, None)  # when it was looked for, and what is wrong

    def step(self) -> None:
        """Estimate what is in the newest masks."""
        for change in self._objects.changes():
            if change.removed:
                self._estimator.remove_object(change.entry.object)
            elif change.added is not None:
                self._estimator.add_object(change.added)
        taken = self._bus.take_with_payload(self._masks, Masks)
        if taken is None:
            return
        started = now_ns()
        message, payload = taken
        known = set(self._estimator.objects)
        objects = [item for item in message.objects if item.detection.request.object in known]
        # One that was just added may be asked for before its model is here.
        self._bus.health.count("unknown_objects", len(message.objects) - len(objects))
        try:
            frame = frame_from_wire(message.frame, payload)
            size = (frame.camera.height, frame.camera.width)
            queries = [self._query(item, frame.stamp_ns, size) for item in objects]
        except WireError as error:
            self._bus.refuse(self._bus.keys.masks, error)
            return
        answers = self._estimator.estimate(frame, queries)
        estimates = [
            to_wire(EstimatedObject, answer, instance=item.detection.request.instance)
            for answer, item in zip(answers, objects, strict=True)
        ]
        picture = self._fault(frame, answers)
        look = self._sizes.wanted(frame.epoch, started)
        self._bus.put_control(
            self._bus.keys.estimates,
            Estimates(
                publish_ns=now_ns(),
                request_seq=message.request_seq,
                camera_epoch=frame.epoch,
                frame_id=frame.frame_id,
                capture_ns=frame.stamp_ns,
                estimates=estimates,
                picture=picture,
                sizes=self._sizes.doubt,
            ),
        )
        health = self._bus.health
        health.count("estimates", len(estimates))
        health.count("found", sum(e.found for e in estimates))
        health.worked_on(started, message.frame)
        sure = [answer for answer in answers if answer.state == "TRACKING"]
        if sure and look:
            # One of them, so that the next request waits no longer than for an estimate.
            looks = self._estimator.sizes_seen(frame, [sure[message.request_seq % len(sure)]])
            self._sizes.add(frame, looks, started)
        warning = f"{self._sizes.doubt} {WAY_OUT}" if self._sizes.doubt else None
        health.warn_while("size", warning)
        if warning:
            self._bus.log.seldom("size", warning)

    def _fault(self, frame: RgbdFrame, answers: Sequence[PoseEstimate]) -> str:
        """What is wrong with a frame in which nothing was found; empty where nothing is."""
        found = any(answer.found for answer in answers)
        text = None
        if not found:
            text = why_nothing_is_found(frame, self._estimator.diameters_m) or self._offset_of(frame)
        self._bus.health.warn_while("picture", text)
        if (text is not None) != self._blames_picture:
            # `status` says it as soon as the log, not with the next sign of life.
            self._blames_picture = text is not None
            self._bus.say_health()
        if text is not None:
            self._bus.log.seldom("picture", f"nothing is found: {text}")
        return text or ""

    def _offset_of(self, frame: RgbdFrame) -> str | None:
        """How depth lies beside the colours, looked for now and then, because it takes 50 ms."""
        due_ns, text = self._offset
        if (now := now_ns()) >= due_ns:
            offset = frame_offset(frame)
            text = None if offset is None else offset.said()
            self._offset = (now + OFFSET_EVERY_NS, text)
        return text

    def _query(self, item: MaskedObject, stamp_ns: int, size: tuple[int, int]) -> ObjectQuery:
        request = item.detection.request
        prior = None
        if request.prior is not None:
            tracked = prior_from_wire(request.prior)
            prior = PosePrior(tracked.predicted(stamp_ns), tracked.covariance)
        masks = tuple(mask_of(runs, size) for runs in item.masks)
        return ObjectQuery(
            request.object,
            box=box_from_wire(item.detection.box),
            masks=masks,
            prior=prior,
            instance=-1 if request.instance is None else request.instance,
        )
