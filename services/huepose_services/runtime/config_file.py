"""pipeline.yaml, read and checked once, when a process starts."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import msgspec

from huepose.support.errors import InputError
from huepose_services.runtime.config import CHAIN, Config
from huepose_services.runtime.config_errors import explain, read_yaml
from huepose_services.runtime.config_parts import (
    check_hosts,
    check_listeners,
    check_ports,
    check_ros2,
    of_cameras,
)
from huepose_services.runtime.config_perception import (
    DRAWN_SOURCES,
    Refuse,
    absolute,
    check_camera,
    check_detector,
    check_segmenter,
)

DEFAULT_FILE = "pipeline.yaml"
_MAX_BYTES = 1024 * 1024
_NO_FILE: dict[type[Exception], str] = {
    FileNotFoundError: "no such file",
    IsADirectoryError: "a folder",
    UnicodeDecodeError: "no text",
}


def load(path: Path, camera: str | None = None) -> Config:
    """The configuration of a file; of the named camera, if the file has several. Raises InputError that names
    the key, the value and what is allowed."""
    configs = load_all(path)
    of_camera = [config for config in configs if config.camera.name == camera]
    if len(configs) == 1 or of_camera:
        return (of_camera or configs)[0]
    names = ", ".join(config.camera.name for config in configs)
    raise InputError(
        f"{path}: cameras" if camera is None else f"{path}: camera {camera}",
        found=f"the cameras {names}",
        expected="one camera" if camera is None else "one of them",
        fix="Name one: with --pipeline or --camera, or as CAMERA.WORKER; else give a file with one `camera`.",
    )


def load_all(path: Path) -> list[Config]:
    """The configurations of a file: one for each camera. Raises InputError as `load` does."""
    return parse_all(text_of(path), path)


def text_of(path: Path) -> str:
    """The text of a file. Raises InputError if it cannot be read, or is too long."""
    try:
        with path.open("rb") as file:
            data = file.read(_MAX_BYTES + 1)
        if len(data) > _MAX_BYTES:
            raise ValueError(f"over {_MAX_BYTES} bytes")
        return data.decode()
    except (OSError, ValueError) as error:
        found = _NO_FILE.get(type(error)) or getattr(error, "strerror", None) or str(error)[:200]
        inside = path / DEFAULT_FILE
        fix = "Give the path of one, as in: huepose up PIPELINE.yaml; `huepose new` makes one."
        raise InputError(
            f"configuration {path}",
            found=found,
            expected="a YAML file that describes a pipeline",
            fix=f"Did you mean {inside}?" if inside.is_file() else fix,
        ) from None


def parse_all(text: str, path: Path) -> list[Config]:
    """The configurations in a text, one for each camera; `path` names it in errors, and relative paths are
    relative to its folder."""
    data = read_yaml(text, path)
    return for_each_camera(as_written(data, path), data, path)


def for_each_camera(written: Config, data: Any, path: Path) -> list[Config]:
    """The checked configurations of a file, one for each camera. written: `as_written` of `data`. Raises
    InputError."""

    def refuse(key: str, found: str, expected: str, fix: str) -> None:
        raise InputError(f"{path}: {key}", found=found, expected=expected, fix=fix)

    of_each = of_cameras(written, isinstance(data, dict) and "camera" in data, refuse)
    try:
        configs = [absolute(one, path.absolute().parent) for one in of_each]
    except (RuntimeError, ValueError) as error:
        raise InputError(f"{path}: a path in it", found=str(error)[:200], expected="a path") from None
    for one in configs:
        _check(one, refuse)
    check_listeners(configs, refuse)
    return configs


def as_written(data: Any, path: Path) -> Config:
    """The values of a file as they are written: before each camera gets ports of its own, and paths become
    absolute. Raises InputError for a key or a value that is wrong by itself."""
    try:
        return msgspec.convert(data if data is not None else {}, Config)
    except msgspec.ValidationError as error:
        raise explain(error, data, Config, path) from None
    except RecursionError:
        raise InputError(f"configuration {path}", found="values that are nested too deeply") from None


def _check(config: Config, refuse: Refuse) -> None:
    """Check keys against each other."""
    names = [o.name for o in config.objects]
    camera, detector = config.camera, config.detector
    if len(set(names)) != len(names):
        refuse("objects", ", ".join(names), "every name once", "Use max_instances for several of a kind.")
    if not config.workers:
        fix = f"Name one, or leave `workers` out: then {', '.join(CHAIN)} are started."
        refuse("workers", "none", "one worker or more", fix)
    if len(set(config.workers)) != len(config.workers):
        refuse("workers", ", ".join(config.workers), "each worker at most once", "Name each once.")
    check_hosts(config, refuse)
    check_ports(config, refuse)
    check_ros2(config, refuse)
    check_camera(camera, config.workers, refuse)
    if (
        camera.source not in DRAWN_SOURCES
        and config.bundles is None
        and (config.uses_models or config.objects)
    ):
        expected = f"the folder of your reference models (the source {camera.source} brings none)"
        refuse("bundles", "null", expected, "Make them: huepose onboard MESH --name NAME --out DIR.")
    check_detector(detector, names, refuse)
    check_segmenter(config.segmenter, refuse)
