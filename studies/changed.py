"""The same scenes as another camera, or another light, would have recorded them: are the results the same?

    .venv/bin/python -m studies.changed --bop SCENE... --out DIR
    huepose eval perception --bop DIR/warm/* --bundles bundles --json warm.json

Writes copies of each scene in BOP's layout to DIR/FORM/SCENE. Poses, labels and boxes stay; colour or depth
is changed. Nothing is fitted on such frames: they are only for measurements.
"""

from __future__ import annotations

import argparse
import json
import shutil
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np

from huepose.datasets.bop import BopScene
from huepose.datasets.bop_writer import DEPTH_SCALE_MM, depth_steps
from huepose.geometry.arrays import Float32, UInt8
from huepose.support.progress import progress

FARTHEST_M = np.float32(1000.0)
"""Farther than any depth reading."""

GAMMA = 2.2
"""Gamma of the images: light is color ** GAMMA."""


def _in_light(change: Callable[[Float32], Float32]) -> Callable[[UInt8], UInt8]:
    """From a change of linear light (H, W, 3), 0..1, to a change of an image."""

    def changed(color: UInt8) -> UInt8:
        light = change((color.astype(np.float32) / 255.0) ** GAMMA)
        return _whole(255.0 * np.clip(light, 0.0, 1.0) ** (1.0 / GAMMA))

    return changed


def _whole(color: Float32) -> UInt8:
    return np.clip(np.rint(color), 0, 255).astype(np.uint8)


def _gains(*rgb: float) -> Callable[[UInt8], UInt8]:
    return _in_light(lambda light: light * np.array(rgb, np.float32))


def _pale(light: Float32) -> Float32:
    grey = (light @ np.array([0.2126, 0.7152, 0.0722], np.float32))[..., None]
    return grey + 0.55 * (light - grey)


def _blurred(color: UInt8, sigma_px: float) -> UInt8:
    return np.asarray(cv2.GaussianBlur(color, (0, 0), sigma_px), np.uint8)


def _sharpened(color: UInt8) -> UInt8:
    return _whole(np.float32(2.5) * color - np.float32(1.5) * _blurred(color, 1.5))


def _noisy(color: UInt8) -> UInt8:
    noise = np.random.default_rng(7).normal(0.0, 12.0, color.shape)
    return _whole(color.astype(np.float32) + noise.astype(np.float32))


def _compressed(color: UInt8) -> UInt8:
    _, data = cv2.imencode(".jpg", color, [cv2.IMWRITE_JPEG_QUALITY, 25])
    return np.asarray(cv2.imdecode(data, cv2.IMREAD_COLOR), np.uint8)


COLORS: dict[str, Callable[[UInt8], UInt8]] = {
    "dark": _gains(0.3, 0.3, 0.3),
    "bright": _gains(1.9, 1.9, 1.9),
    "warm": _gains(1.3, 1.0, 0.65),
    "cool": _gains(0.7, 1.0, 1.35),
    "pale": _in_light(_pale),
    "hazy": _in_light(lambda light: 0.75 * light + 0.12),
    "blurred": lambda color: _blurred(color, 2.0),
    "sharpened": _sharpened,
    "noisy": _noisy,
    "compressed": _compressed,
}
"""Changes of an image (H, W, 3) RGB."""


def _patches(depth: Float32, per_px: int, seed: int) -> Float32:
    """A smooth random field (H, W): standard deviation 1 at its nodes, which are `per_px` pixels apart."""
    height, width = depth.shape
    nodes = np.random.default_rng(seed).normal(size=(height // per_px, width // per_px)).astype(np.float32)
    return np.asarray(cv2.resize(nodes, (width, height), interpolation=cv2.INTER_CUBIC), np.float32)


def _stereo(depth: Float32) -> Float32:
    return np.where(depth > 0.0, depth + 0.006 * depth**2 * _patches(depth, 6, 7), 0.0).astype(np.float32)


def _grown(depth: Float32) -> Float32:
    near = cv2.erode(np.where(depth > 0.0, depth, FARTHEST_M), np.ones((9, 9), np.uint8))
    return np.where(near < FARTHEST_M, near, 0.0).astype(np.float32)


DEPTHS: dict[str, Callable[[Float32], Float32]] = {
    "stereo": _stereo,
    "grown": _grown,
    "holes": lambda depth: np.where(_patches(depth, 16, 8) > 1.0, np.float32(0.0), depth),
    "beside": lambda depth: np.roll(depth, 3, axis=1),
}
"""Changes of depth (H, W), metres: smooth noise that grows with the square of the depth; near surfaces that
are four pixels wider; holes; a shift of three pixels against the colours."""

FORMS = (*COLORS, *DEPTHS)


def write_changed(scene: BopScene, form: str, out: Path) -> None:
    """Write the copy of a scene in a form (one of FORMS) to a folder, which is replaced."""
    shutil.rmtree(out, ignore_errors=True)
    shutil.copytree(scene.path, out, ignore=shutil.ignore_patterns("rgb", "depth", "scene_camera.json"))
    cameras = json.loads((scene.path / "scene_camera.json").read_text())
    for part in ("rgb", "depth"):
        (out / part).mkdir()
    for image in scene.image_ids:
        frame, name = scene.frame(image), f"{image:06d}.png"
        color = COLORS[form](frame.color) if form in COLORS else frame.color
        depth = DEPTHS[form](frame.depth) if form in DEPTHS else frame.depth
        cv2.imwrite(str(out / "rgb" / name), np.ascontiguousarray(color[..., ::-1]))
        cv2.imwrite(str(out / "depth" / name), depth_steps(depth))
        cameras[str(image)]["depth_scale"] = DEPTH_SCALE_MM
    (out / "scene_camera.json").write_text(json.dumps(cameras))


def main() -> None:
    """Write all forms of all scenes."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--bop", type=Path, nargs="+", required=True, metavar="SCENE_DIR")
    parser.add_argument("--out", type=Path, required=True, metavar="DIR")
    arguments = parser.parse_args()
    scenes = [BopScene(path) for path in arguments.bop]
    jobs = [(scene, form) for form in FORMS for scene in scenes]
    for scene, form in progress(jobs, "scenes"):
        write_changed(scene, form, arguments.out / form / f"{scene.path.parent.name}_{scene.name}")


if __name__ == "__main__":
    main()
