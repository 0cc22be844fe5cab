"""The reference models of a recording's objects, from where the recorded pipeline had them."""

from __future__ import annotations

import shlex
from functools import cache
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
    """The keys of a recorded configuration that say where the models are; the configuration may have keys
    that this version does not know."""

    bundles: str | None = None
    camera: _Camera = msgspec.field(default_factory=_Camera)


def load_one(path: Path, name: str) -> ReferenceModel:
    """The reference model of an object of a recording; if the recording does not say where the models are, as
    one without frames, a built-in object. Raises InputError if it is missing."""
    try:
        return models.load_one(_config_of(path), name)
    except InputError as error:
        raise InputError(
            error.what,
            found=error.found,
            expected=error.expected,
            fix="Play it with the configuration that names the folder of its model: "
            f"huepose replay {shlex.quote(str(path))} --config PIPELINE.yaml.",
        ) from None


@cache
def _config_of(path: Path) -> Config:
    """A configuration with those recorded values by which models are found."""
    recording = Recording(path)
    for _, chunk in recording.chunks():
        for event in recording.inside(chunk, pixels=False):
            if isinstance(event.message, MemoryMessage):
                found = _decoded(event.message.config, path)
                return Config(bundles=found.bundles, camera=CameraConfig(seed=found.camera.seed))
    return Config()


def _decoded(config: str, path: Path) -> _Recorded:
    try:
        return msgspec.json.decode(config, type=_Recorded)
    except (msgspec.MsgspecError, RecursionError) as error:
        raise InputError(f"the configuration in {path}", found=str(error)[:200]) from None
