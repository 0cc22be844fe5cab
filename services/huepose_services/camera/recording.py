"""A recording of `huepose record` as a camera."""

from __future__ import annotations

from pathlib import Path

from huepose.datasets.types import GroundTruth, Scene
from huepose.geometry import RgbdFrame
from huepose.support.errors import InputError
from huepose_protos import WireError
from huepose_protos.keys import tail_of
from huepose_protos.messages import FrameHeader, TruthMessage
from huepose_services.convert import frame_from_wire, frame_key, from_wire
from huepose_services.recording.parts import GIVEN
from huepose_services.recording.read import Recording
from huepose_services.runtime.config import Config

_Key = tuple[int, int]


def open_source(config: Config) -> Scene:
    """The frames of the file `camera.path`."""
    assert config.camera.path is not None  # the configuration was checked
    return RecordedScene(Path(config.camera.path))


class RecordedScene:
    """The frames of a recording, numbered from 0; a frame that was published again counts once. Raises
    InputError for a file without frames."""

    def __init__(self, path: Path) -> None:
        self.name = path.stem
        self._recording = Recording(path)
        self._frames: list[FrameHeader] = []
        self._places: list[int] = []
        self._truths: dict[_Key, TruthMessage] = {}
        self._near: dict[_Key, RgbdFrame] = {}
        seen: set[_Key] = set()
        for place, chunk in self._recording.chunks():
            for event in self._recording.inside(chunk, pixels=False):
                message = event.message
                if tail_of(event.key) == GIVEN:
                    continue
                if isinstance(message, FrameHeader) and frame_key(message) not in seen:
                    seen.add(frame_key(message))
                    self._frames.append(message)
                    self._places.append(place)
                elif isinstance(message, TruthMessage):
                    self._truths[frame_key(message)] = message
        if not self._frames:
            raise InputError(path, found="no frame", expected="a recording with frames")
        self.image_ids = tuple(range(len(self._frames)))

    def stamp_ns(self, image: int) -> int:
        """The capture time of a frame."""
        return self._frames[image].capture_ns

    def frame(self, image: int) -> RgbdFrame:
        """A frame: colour and depth."""
        key = frame_key(self._frames[image])
        if key not in self._near:
            chunk = self._recording.chunk(self._places[image])
            try:
                self._near = {
                    frame_key(event.message): frame_from_wire(event.message, event.payload)
                    for event in self._recording.inside(chunk)
                    if isinstance(event.message, FrameHeader)
                }
            except WireError as error:
                raise InputError(self._recording.path, found=str(error)) from None
            if key not in self._near:
                raise self._recording.changed()
        return self._near[key]

    def truths(self, image: int) -> tuple[GroundTruth, ...]:
        """The ground truth of a frame, as recorded; empty if there is none."""
        truth = self._truths.get(frame_key(self._frames[image]))
        return tuple(from_wire(GroundTruth, o) for o in ([] if truth is None else truth.objects))
