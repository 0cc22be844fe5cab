"""For which frame perception has answered all that it can about an object, so that it is not requested for
that frame again: a stopped camera costs no work."""

from __future__ import annotations

from collections.abc import Iterable

from huepose.reinit.types import Request, RequestedObject
from huepose.tracking.types import TrackedPose

Frame = tuple[int, int]
"""Camera epoch and number."""


class Answered:
    """The newest answered frame of each requested object."""

    def __init__(self) -> None:
        self._newest: dict[tuple[str, int | None], tuple[Frame, int]] = {}

    def note(self, objects: Iterable[RequestedObject], frame: Frame) -> None:
        """Note that a request for these objects was answered for that frame."""
        for asked in objects:
            before, times = self._newest.get(_key(asked), (frame, 0))
            self._newest[_key(asked)] = (frame, times + 1 if before == frame else 1)

    def seen(self, objects: Iterable[RequestedObject], turns: int) -> Frame | None:
        """The frame for which another answer for all of these objects would be no news; None without one.
        turns: number of answers until each missing object was searched for everywhere; for a tracked instance
        the first answer is enough."""
        frames = set()
        for asked in objects:
            frame, times = self._newest.get(_key(asked), (None, 0))
            frames.add(frame if times >= (turns if asked.instance is None else 1) else None)
        return frames.pop() if len(frames) == 1 else None

    def forget(self, name: str) -> None:
        """Forget the answers about an object."""
        self._newest = {key: answer for key, answer in self._newest.items() if key[0] != name}


def held(request: Request, tracks: Iterable[TrackedPose], frame: Frame | None) -> bool:
    """Whether a request has no answer because no new frame came, as far as the tracks and the camera's newest
    frame tell."""
    known = [(track.epoch, track.frame_id) for track in tracks] + ([] if frame is None else [frame])
    seen = request.seen
    return seen is not None and all(epoch == seen[0] and number <= seen[1] for epoch, number in known)


def _key(asked: RequestedObject) -> tuple[str, int | None]:
    return asked.object, asked.instance
