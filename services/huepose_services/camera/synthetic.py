"""A scene that code draws as a camera: its loop, played for ever."""

from __future__ import annotations

from pathlib import Path

from huepose.datasets.types import GroundTruth, Scene
from huepose.geometry import RgbdFrame
from huepose.model import load_models
from huepose.scenes.builtin import SyntheticScene
from huepose_services.runtime.config import Config


def open_source(config: Config) -> Scene:
    """The scene of `camera.seed`, computed first where it is not in the cache folder: with the objects of
    `bundles`, or without that, with its own. Raises InputError where they do not fit into one."""
    if config.bundles is None:
        return Synthetic(SyntheticScene(config.camera.seed))
    names = [item.name for item in config.objects] or None
    meshes = {name: model.mesh for name, model in load_models(Path(config.bundles), names).items()}
    return Synthetic(SyntheticScene(config.camera.seed, objects=meshes))


class Synthetic:
    """The loop as the readers of recordings give theirs."""

    def __init__(self, scene: SyntheticScene) -> None:
        self._scene = scene
        self.name = f"synthetic-{scene.seed}"
        self.image_ids = tuple(range(len(scene)))

    def stamp_ns(self, image: int) -> int:
        """When it was captured, from the start of the loop."""
        return self._scene.frame(image).stamp_ns

    def frame(self, image: int) -> RgbdFrame:
        """Colour and depth."""
        return self._scene.frame(image)

    def truths(self, image: int) -> tuple[GroundTruth, ...]:
        """Where everything is."""
        return tuple(self._scene.truth(image))
