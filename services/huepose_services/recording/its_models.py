"""The reference models of a recording's objects, where the pipeline that was recorded had them."""

from __future__ import annotations

import shlex
from pathlib import Path

import msgspec

from huepose.model import ReferenceModel
from huepose.support.errors import InputError
from huepose_protos.messages import MemoryMessage
from huepose_services import models
from huepose_services.recording.read import Recording
from huepose_services.runtime.config import Config
from huepose_services.runtime.config_perception import CameraConfig


class _Camera(msgspec.Struct):
    seed: int = 0


class _Recorded(msgspec.Struct):
    """Of a recorded configuration where the models are; it may have keys that this version does not know."""

    bundles: str | None = None
    camera: _Camera = msgspec.field(default_factory=_Camera)


class ItsModels:
    """Looks once into a recording for where they are. Used by one thread at a time."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._config: Config | None = None

    def load_one(self, name: str) -> ReferenceModel:
        """The model of an object; of a recording that does not say where they are, as one without frames, a
        built-in object. Raises InputError where it is not there."""
        try:
            self._config = self._config or _config_of(Recording(self._path))
            return models.load_one(self._config, name)
        except InputError as error:
            raise InputError(
                error.what,
                found=error.found,
                expected=error.expected,
                fix="Play it with the configuration that names the folder of its model: "
                f"huepose replay {shlex.quote(str(self._path))} --config PIPELINE.yaml.",
            ) from None


def _config_of(recording: Recording) -> Config:
    """As much of the configuration with which it was recorded as models are found by."""
    for _, chunk in recording.chunks():
        for event in recording.inside(chunk, pixels=False):
            if isinstance(event.message, MemoryMessage):
                found = _decoded(event.message.config, recording.path)
                return Config(bundles=found.bundles, camera=CameraConfig(seed=found.camera.seed))
    return Config()


def _decoded(config: str, path: Path) -> _Recorded:
    try:
        return msgspec.json.decode(config, type=_Recorded)
    except (msgspec.MsgspecError, RecursionError) as error:
        raise InputError(f"the configuration in {path}", found=str(error)[:200]) from None
