"""About which frame perception has answered all that it can for an object, so that it is not asked about that
one again: a camera that gives no new frame costs no work."""

from __future__ import annotations

from collections.abc import Iterable

from huepose.reinit.types import Request, RequestedObject
from huepose.tracking.types import TrackedPose

Frame = tuple[int, int]
"""Camera epoch and number."""


class Answered:
    """What was answered about the newest frame of each requested object."""

    def __init__(self) -> None:
        self._newest: dict[tuple[str, int | None], tuple[Frame, int]] = {}

    def note(self, objects: Iterable[RequestedObject], frame: Frame) -> None:
        """A request for these objects was answered on that frame."""
        for asked in objects:
            before, times = self._newest.get(_key(asked), (frame, 0))
            self._newest[_key(asked)] = (frame, times + 1 if before == frame else 1)

    def seen(self, objects: Iterable[RequestedObject], turns: int) -> Frame | None:
        """The frame about which another answer for all of these objects would say nothing new; None where
        there is none. turns: answers that it takes until each missing object was searched for everywhere; of
        one that is tracked the first says all."""
        frames = set()
        for asked in objects:
            frame, times = self._newest.get(_key(asked), (None, 0))
            frames.add(frame if times >= (turns if asked.instance is None else 1) else None)
        return frames.pop() if len(frames) == 1 else None

    def forget(self, name: str) -> None:
        """Answers about an object count no more."""
        self._newest = {key: said for key, said in self._newest.items() if key[0] != name}


def held(request: Request, tracks: Iterable[TrackedPose], frame: Frame | None) -> bool:
    """Whether a request has no answer because no frame came that it could be answered on, as far as tracks
    and the camera's newest frame tell."""
    known = [(track.epoch, track.frame_id) for track in tracks] + ([] if frame is None else [frame])
    seen = request.seen
    return seen is not None and all(epoch == seen[0] and number <= seen[1] for epoch, number in known)


def _key(asked: RequestedObject) -> tuple[str, int | None]:
    return asked.object, asked.instance
