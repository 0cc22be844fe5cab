"""The detector worker: for a request it takes the newest frame, and sends boxes and pixels on together."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from functools import cache, partial

from huepose.geometry import Box
from huepose.model import ReferenceModel
from huepose.perception.view_detector import ViewDetector
from huepose.perception.window_table import window_table
from huepose.profiles import profile
from huepose_protos import WireError
from huepose_protos.messages import (
    MOST_BOXES,
    DetectedObject,
    Detections,
    FrameHeader,
    PerceptionRequest,
)
from huepose_services import models, networks
from huepose_services.boxes import BoxFinder, Hints, Pixels, SearchedBoxes, SeenBoxes
from huepose_services.convert import frame_from_wire
from huepose_services.following import Follower, reading_text
from huepose_services.runtime.bus import Bus
from huepose_services.runtime.clock import SECOND, now_ns
from huepose_services.runtime.config import Config
from huepose_services.runtime.work import Requests, Work

ASK_EVERY_NS = 2 * SECOND
"""How often the order of the colour channels is checked, which takes as long as two searches for one
object."""

FIRST_ASKS = 5
"""The first checks in a camera epoch, with one object after another, are made although objects are tracked:
a false positive may have started a track."""


def make(bus: Bus, config: Config) -> DetectorWork:
    """The detector worker's work."""
    known = models.load(config)
    outlines = {name: models.outline(model) for name, model in known.items()}
    load_one = partial(models.load_one, config)
    if config.detector.kind == "yolo":
        follower = Follower(bus, load_one, outlines)
        detector, network = networks.yolo(config)
        bus.log.say(f"YOLO of layout {detector.layout} on {network.provider}: {network.path.name}")
        bus.health.count(f"provider_{network.provider}")
        return DetectorWork(bus, SeenBoxes(outlines, detector), follower, config.camera.check)
    follower = Follower(bus, lambda name: _with_views(load_one(name)), outlines)
    settings = profile(config.profile).detector
    settings = replace(settings, threads=config.detector.threads, remembering=True)
    searcher = ViewDetector(known, settings)
    searcher.warm_up()
    return DetectorWork(bus, SearchedBoxes(outlines, searcher), follower, config.camera.check)


def _with_views(model: ReferenceModel) -> ReferenceModel:
    """The same model, its views in the cache: if many objects are added, to compute them in a search takes
    longer than a worker may be silent."""
    window_table(model)
    return model


class DetectorWork(Work):
    """Answers the newest request."""

    def __init__(
        self,
        bus: Bus,
        finder: BoxFinder,
        objects: Follower[ReferenceModel],
        check_camera: bool = True,
    ) -> None:
        self._bus, self._finder, self._objects = bus, finder, objects
        self._hints = Hints()
        self._reading: frozenset[str] = frozenset()
        self._warn_of_classes()
        self._requests = Requests(bus, looks=True)
        self._check_camera, self._colours = check_camera, ""
        self._ask_ns = now_ns() + ASK_EVERY_NS
        # Camera epoch, how often the order of its colours was checked, and whether it is known to be right.
        self._asked = (-1, 0, False)

    def due_ns(self) -> int | None:
        """Soon, while a request waits for a newer frame."""
        return self._requests.due_ns()

    def step(self) -> None:
        """Answer the newest request."""
        self._follow()
        if (asked := self._requests.take()) is not None:
            self._answer(*asked)

    def _follow(self) -> None:
        """Apply changes of the object list, and take boxes that a user gave."""
        for change in self._objects.changes():
            entry = change.entry
            if change.removed:
                self._finder.remove(entry.object)
            elif change.added is not None:
                self._finder.add(change.added)
            if entry.box is not None:
                self._hints.point(entry.object, Box(*entry.box), now_ns(), entry.retired)
            self._warn_of_classes()
        reading = self._objects.reading
        for name in reading ^ self._reading:
            text = reading_text(name) if name in reading else None
            self._bus.health.warn_while(f"reading {name}", text)
        self._reading = reading

    def _warn_of_classes(self) -> None:
        self._bus.health.warn_while("classes", self._finder.lacks() or None)

    def _answer(self, request: PerceptionRequest, header: FrameHeader, payload: bytes) -> None:
        started, health = now_ns(), self._bus.health
        pixels = cache(partial(frame_from_wire, header, payload))
        try:
            found = self._finder.find(header, request, pixels)
        except WireError as error:
            self._bus.refuse(self._bus.keys.frame, error)
            return
        found = best_of_each(self._hints.applied(found, header, request, started))
        message = Detections(
            publish_ns=now_ns(),
            request_seq=request.seq,
            request_ns=request.publish_ns,
            frame=header,
            objects=found,
            camera=self._colours,
        )
        self._bus.put_pixels(self._bus.keys.detections, message, payload)
        health.count("requests")
        health.count("boxes", len(found))
        health.worked_on(started, header)
        if self._check_camera:
            self._doubt_colours(header.camera_epoch, request, found, pixels)

    def _doubt_colours(
        self, epoch: int, request: PerceptionRequest, found: Sequence[DetectedObject], pixels: Pixels
    ) -> None:
        """Check every two seconds whether red and blue are exchanged, until an object shows that they are
        not: at the beginning of a camera epoch, and as long as none of the requested objects is tracked."""
        names = [wanted.object for wanted in request.objects]
        asks, known = self._asked[1:] if epoch == self._asked[0] else (0, False)
        enough = known or (asks >= FIRST_ASKS and any(w.prior is not None for w in request.objects))
        if not names or now_ns() < self._ask_ns or (enough and not self._colours):
            return
        seen = {wanted.object: 0.0 for wanted in request.objects if wanted.prior is None}
        for box in found:
            if box.request.prior is None:
                seen[box.request.object] = max(seen.get(box.request.object, 0.0), box.score)
        order = self._finder.order_of_channels(pixels(), names, seen)
        self._asked, self._ask_ns = (epoch, asks + 1, order.right), now_ns() + ASK_EVERY_NS
        if order.right or order.exchanged:
            self._colours = order.exchanged
            self._bus.health.warn_while("colours", order.exchanged or None)
            if order.exchanged:
                self._bus.log.seldom("colours", order.exchanged)


def best_of_each(found: Sequence[DetectedObject]) -> list[DetectedObject]:
    """At most MOST_BOXES of some boxes, which are best first for each requested object: the first of each,
    then the second of each, and so on."""
    before: Counter[int] = Counter()
    places = []
    for box in found:
        places.append(before[id(box.request)])
        before[id(box.request)] += 1
    kept = sorted(range(len(found)), key=places.__getitem__)[:MOST_BOXES]
    return [found[k] for k in sorted(kept)]
