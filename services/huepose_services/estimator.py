"""The estimator worker: estimates the poses of objects from their masks and the frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from huepose.estimation import Estimator, ObjectQuery
from huepose.estimation.types import PoseEstimate
from huepose.geometry import Box, RgbdFrame
from huepose.geometry.image_faults import why_nothing_is_found
from huepose.model import ReferenceModel
from huepose.profiles import profile
from huepose.reinit.looking import query_of
from huepose_protos import WireError
from huepose_protos.buffers import mask_of
from huepose_protos.messages import EstimatedObject, Estimates, MaskedObject, Masks
from huepose_services import models
from huepose_services.camera_doubts import WAY_OUT, CameraDoubts
from huepose_services.convert import frame_from_wire, requested_from_wire, to_wire
from huepose_services.following import Follower
from huepose_services.runtime.bus import Bus
from huepose_services.runtime.clock import now_ns
from huepose_services.runtime.config import Config
from huepose_services.runtime.work import Work


def make(bus: Bus, config: Config) -> EstimatorWork:
    """The estimator worker's work, with its kernels compiled."""
    settings = replace(
        profile(config.profile).estimator, method=config.estimator.method, threads=config.estimator.threads
    )
    estimator = Estimator(models.load(config), settings)
    estimator.warm_up()
    follower = Follower(bus, lambda name: models.load_one(config, name), estimator.objects)
    return EstimatorWork(bus, estimator, follower, config.camera.check)


class EstimatorWork(Work):
    """Answers the newest masks."""

    def __init__(
        self, bus: Bus, estimator: Estimator, objects: Follower[ReferenceModel], check_camera: bool = True
    ) -> None:
        self._bus, self._estimator, self._objects = bus, estimator, objects
        self._masks = bus.inbox.ring(bus.keys.masks)
        self._doubts = CameraDoubts(estimator.sizes_seen) if check_camera else None
        self._image_has_fault = False

    def step(self) -> None:
        """Estimate the objects of the newest masks."""
        for change in self._objects.changes():
            if self._doubts is not None:
                self._doubts.forget(change.entry.object)
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
        # An object that was just added may be requested before its model is loaded here.
        self._bus.health.count("unknown_objects", len(message.objects) - len(objects))
        try:
            frame = frame_from_wire(message.frame, payload)
            size = (frame.camera.height, frame.camera.width)
            queries = [self._query(item, frame.stamp_ns, size) for item in objects]
        except WireError as error:
            self._bus.refuse(self._bus.keys.masks, error)
            return
        answers = self._estimator.estimate(frame, queries)
        if self._doubts is not None:
            self._doubts.look(frame, answers, started)
        estimates = [
            self._estimated(answer, item.detection.request.instance)
            for answer, item in zip(answers, objects, strict=True)
        ]
        # Health shows these doubts, whatever the detector reports about the camera.
        doubted = self._doubted()
        picture, camera = self._fault(frame, answers), message.camera or doubted
        if self._doubts is not None and not any(answer.found for answer in answers):
            picture = picture or self._doubts.offset
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
                camera=camera,
            ),
        )
        health = self._bus.health
        health.count("estimates", len(estimates))
        health.count("found", sum(e.found for e in estimates))
        health.worked_on(started, message.frame)

    def _doubted(self) -> str:
        """The doubt about the camera, empty if there is none. Warns of it, and of doubts about objects, in
        health and log."""
        doubt = "" if self._doubts is None else self._doubts.text
        of_objects = {} if self._doubts is None else self._doubts.objects
        sizes = [f"{name}/{number}: {text}" for (name, number), text in sorted(of_objects.items())]
        for what, text in (("camera", doubt), ("sizes", " ".join(sizes))):
            warning = f"{text} {WAY_OUT}" if text else None
            self._bus.health.warn_while(what, warning)
            if warning:
                self._bus.log.seldom(what, warning)
        return doubt

    def _estimated(self, answer: PoseEstimate, instance: int | None) -> EstimatedObject:
        doubt = self._doubts.of(answer.object, instance) if self._doubts and answer.found else ""
        return to_wire(EstimatedObject, answer, instance=instance, reason=doubt or answer.reason)

    def _fault(self, frame: RgbdFrame, answers: Sequence[PoseEstimate]) -> str:
        """What is wrong with a frame in which nothing was found; empty if nothing is, or something was
        found."""
        found = any(answer.found for answer in answers)
        text = None if found else why_nothing_is_found(frame, self._estimator.diameters_m)
        self._bus.health.warn_while("picture", text)
        if (text is not None) != self._image_has_fault:
            # At once, so that `huepose status` shows it as soon as the log does.
            self._image_has_fault = text is not None
            self._bus.say_health()
        if text is not None:
            self._bus.log.seldom("picture", f"nothing is found: {text}")
        return text or ""

    def _query(self, item: MaskedObject, stamp_ns: int, size: tuple[int, int]) -> ObjectQuery:
        masks = tuple(mask_of(runs, size) for runs in item.masks)
        asked = requested_from_wire(item.detection.request)
        middle_obj = self._estimator.middle_obj(asked.object)
        return query_of(asked, Box(*item.detection.box), stamp_ns, middle_obj, masks)
