"""The reference models of a deployment, whole or only what a worker needs of them; and onboarding's verdict
on whether an object suits, kept beside its model as `BUNDLES/NAME.verdict.json`."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from huepose.datasets.files import read_bytes
from huepose.geometry import Box, Camera, se3
from huepose.geometry.arrays import Float, Float32, Float64
from huepose.model import ReferenceModel, load_models
from huepose.model.io import model_path
from huepose.support.errors import InputError
from huepose.support.files import write_text
from huepose.support.words import did_you_mean
from huepose_services.runtime.config import Config

_OUTLINE_POINTS = 1500


@dataclass(frozen=True, eq=False)
class Outline:
    """What detector and segmenter need of an object: points (N, 3) float32 of its surface, and its
    diameter."""

    points_obj: Float32
    diameter_m: float

    @cached_property
    def middle_obj(self) -> Float64:
        """The middle (3,) of its bounding box, object axes; the origin may be far from it."""
        low, high = self.points_obj.min(0), self.points_obj.max(0)
        return np.asarray(0.5 * (low + high), np.float64)

    def box(self, T_cam_obj: Float, camera: Camera) -> Box | None:
        """The box of the object at a pose, cut to the image; None if it is outside, or a part is behind the
        camera."""
        pixels = camera.project(se3.apply(T_cam_obj, self.points_obj))
        if np.isnan(pixels).any():
            return None
        box = Box.of_pixels(pixels).clipped(camera.width, camera.height)
        return box if box.w >= 1.0 and box.h >= 1.0 else None


def bundles_folder(config: Config) -> Path:
    """The folder of the reference models; those of the built-in scene are made at their first use."""
    if config.bundles is not None:
        return Path(config.bundles)
    from huepose_services.builtin import builtin_bundles

    return builtin_bundles(config.camera.seed, config.estimator.method != "full")


def load(config: Config) -> dict[str, ReferenceModel]:
    """The models of the objects to search for; all in the folder if none is named."""
    return load_models(bundles_folder(config), [item.name for item in config.objects] or None)


def load_one(config: Config, name: str) -> ReferenceModel:
    """The model of one object, configured or not. Raises InputError, which lists the existing ones, if
    there is none. For an unknown name no built-in object is onboarded."""
    if config.bundles is None:
        from huepose_services.builtin import builtin_names

        if name not in (known := builtin_names(config.camera.seed)):
            raise InputError(
                f"object '{name}'",
                found="no such built-in object, and no `bundles`",
                expected=f"one of {', '.join(known)}",
                fix=did_you_mean(name, known) or "Name the folder of its reference model: `bundles`.",
            )
    return load_models(bundles_folder(config), [name])[name]


def digests(config: Config, names: Iterable[str]) -> dict[str, str]:
    """SHA-256 of the files of these reference models. Raises InputError for a missing one."""
    folder = bundles_folder(config)
    return {name: hashlib.sha256(read_bytes(model_path(folder, name))).hexdigest() for name in names}


def outline(model: ReferenceModel) -> Outline:
    """The outline of a model; it copies the points, so that the model can be freed."""
    return Outline(model.surface.points[:_OUTLINE_POINTS].copy(), model.diameter_m)


def outlines(config: Config) -> dict[str, Outline]:
    """The outlines of the objects to search for."""
    return {name: outline(model) for name, model in load(config).items()}


def _verdict_path(bundles: Path, name: str) -> Path:
    """The file of the verdict on the object of that name."""
    return bundles / f"{name}.verdict.json"


def sheet_path(bundles: Path, name: str) -> Path:
    """The file of the self-test's picture for the object of that name. It is not NAME.png, which the texture
    of the mesh often is, and the mesh may be in the same folder."""
    return bundles / f"{name}.verdict.png"


def keep_verdict(bundles: Path, model: ReferenceModel, verdict: str, words: str) -> None:
    """Write the verdict on a model and the line of text about it. Raises InputError if it cannot be
    written."""
    kept = {"model": model.digest, "verdict": verdict, "words": words}
    write_text(_verdict_path(bundles, model.name), json.dumps(kept, indent=1) + "\n")


def forget_verdict(bundles: Path, name: str) -> None:
    """Remove the verdict on a model that was removed, and the picture of its self-test."""
    path = _verdict_path(bundles, name)
    if path.is_file():
        sheet_path(bundles, name).unlink(missing_ok=True)
        path.unlink()


def limits(bundles: Path, model: ReferenceModel) -> str:
    """The line about an object that does not suit, or suits with limits; empty if it suits, if the verdict
    is on another model of that name, or if there is none."""
    try:
        kept = json.loads(_verdict_path(bundles, model.name).read_text(encoding="utf-8"))
        of_it = kept["model"] == model.digest and kept["verdict"] != "suits"
        return str(kept["words"]) if of_it else ""
    except (OSError, ValueError, KeyError, TypeError):
        return ""
