"""A scene that code draws as a camera: its loop, played for ever."""

from __future__ import annotations

from pathlib import Path

from huepose.geometry import Mesh
from huepose.model import load_models
from huepose.scenes.builtin import SyntheticScene, check_scene
from huepose_services.runtime.config import Config


def open_source(config: Config) -> SyntheticScene:
    """The scene of `camera.seed`, computed first where it is not in the cache folder: with the objects of
    `bundles`, or without that, with its own. Raises InputError where they do not fit into one."""
    if config.bundles is None:
        return SyntheticScene(config.camera.seed)
    return SyntheticScene(config.camera.seed, objects=_meshes(config, config.bundles))


def check_source(config: Config) -> None:
    """Raises InputError where `open_source` does because its objects do not fit, without drawing anything."""
    if config.bundles is not None:
        check_scene(_meshes(config, config.bundles), config.camera.seed)


def _meshes(config: Config, bundles: str) -> dict[str, Mesh]:
    """Of the objects, by name: the same ones are the same scene, in whichever order they are listed."""
    names = [item.name for item in config.objects] or None
    models = load_models(Path(bundles), names)
    return {name: models[name].mesh for name in sorted(models)}
