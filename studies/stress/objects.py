"""Procedural objects that are hard to track: plain ones, ones with plain sides or repeated labels."""

from __future__ import annotations

import hashlib
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from huepose.geometry import Mesh
from huepose.geometry.arrays import Rng, UInt8
from huepose.model import ReferenceModel, load_model, save_model
from huepose.onboarding import onboard_mesh
from huepose.scenes import textures
from huepose.scenes.charts import OPEN_TOP, blocks, revolved
from huepose.scenes.shapes import demo_objects, printed
from huepose.scenes.textures import Art, Palette
from huepose.scenes.unseen.objects import unseen_objects
from huepose.training.household import household_object
from huepose.training.shapes import random_object


def builtin_meshes(seed: int) -> dict[str, Mesh]:
    """Twelve objects of 9 to 19 cm, in metres; another seed gives other colours, pictures and texts."""
    rng = np.random.default_rng([seed, 21])

    def drawn(charts: Sequence, arts: Sequence[Art], hue: float) -> Mesh:
        return printed(charts, arts, textures.palette(hue, rng), rng, 512)

    box = blocks([-0.05, 0.05], [-0.032, 0.032], [-0.07, 0.07], np.ones((1, 1, 1), bool))
    slab = blocks([-0.06, 0.06], [-0.045, 0.045], [-0.016, 0.016], np.ones((1, 1, 1), bool))
    corner = blocks(
        [-0.06, -0.03, 0.06], [-0.03, 0.03], [-0.05, -0.02, 0.05], np.array([[[1, 1]], [[1, 0]]], bool)
    )
    tray = blocks([-0.07, -0.05, 0.05, 0.07], [-0.05, -0.035, 0.035, 0.05], [-0.03, -0.02, 0.03], OPEN_TOP)
    can = revolved([_lid(-1), [(0.04, z) for z in np.linspace(-0.05, 0.05, 8)], _lid(1)])
    hues = rng.uniform() + np.arange(7) / 7.0
    front = textures.front("BRAND", "plain sides", "NEW")
    own = {
        "half_printed_box": drawn(
            box, [_plain, _plain, front, _plain, textures.blocks("LOT 41"), _plain], hues[0]
        ),
        "plain_slab": drawn(slab, [_plain] * (len(slab) - 1) + [front], hues[1]),
        "plain_bracket": drawn(corner, [_plain] * len(corner), hues[2]),
        "plain_tray": drawn(tray, [_plain] * (len(tray) - 1) + [textures.sticker("NO 7", 1)], hues[3]),
        "repeated_can": drawn(can, [textures.lid("BASE"), _repeated, textures.lid("PULL")], hues[4]),
        "half_plain_can": drawn(can, [textures.lid("BASE"), _one_label, textures.lid("TOP")], hues[5]),
        "plain_box": drawn(box, [_plain] * 5 + [textures.sticker("THIS WAY", 2)], hues[6]),
    }
    return {**demo_objects(seed), **own}


def household_meshes(seed: int) -> dict[str, Mesh]:
    """Random objects of 9 to 20 cm, three quarters of them bowls, mugs, tools and fruit of few colours."""

    def made(number: int) -> Mesh:
        rng = np.random.default_rng([seed, number, 977])
        make = household_object if number % 4 else random_object
        return make(rng, float(rng.uniform(0.09, 0.2)))

    return {f"house{number:02d}": made(number) for number in range(24)}


def unseen_meshes(seed: int) -> dict[str, Mesh]:
    """The shapes of `scenes.unseen`, with the textures of a seed."""
    return {one.name: one.mesh for one in unseen_objects(seed)}


def look_alike(mesh: Mesh) -> Mesh | None:
    """The same shape in other colours; None if the object is too grey for a visible difference."""
    other = np.ascontiguousarray(mesh.texture[..., [1, 2, 0]])
    differs = np.abs(other.astype(int) - mesh.texture).mean()
    return Mesh(mesh.vertices, mesh.faces, mesh.uv, other) if differs > LEAST_DIFFERENCE else None


LEAST_DIFFERENCE = 25.0
"""Least mean difference over the texture, of 255: clearly visible."""


def onboarded(meshes: Mapping[str, Mesh], cache: Path) -> dict[str, ReferenceModel]:
    """Reference models of meshes, from the cache if they were made before."""
    out = {}
    for name, mesh in meshes.items():
        digest = hashlib.sha256(mesh.vertices.tobytes() + mesh.texture.tobytes()).hexdigest()[:12]
        path = cache / f"{name}-{digest}.huepose"
        if not path.exists():
            print(f"onboarding {name}", file=sys.stderr)
            cache.mkdir(parents=True, exist_ok=True)
            save_model(onboard_mesh(mesh, name), path)
        out[name] = load_model(path)
    return out


def _plain(rng: Rng, height: int, width: int, p: Palette) -> UInt8:
    return textures.plain(height, width, p.base)


def _repeated(rng: Rng, height: int, width: int, p: Palette) -> UInt8:
    """Three equal labels, as on many cans."""
    once = textures.wrapper("SOUP", "daily", "1")(rng, height, max(8, width // 3), p)
    return np.ascontiguousarray(np.tile(once, (1, 4, 1))[:, :width])


def _one_label(rng: Rng, height: int, width: int, p: Palette) -> UInt8:
    """A label on a third of the circumference, the rest plain."""
    image, part = textures.plain(height, width, p.base), width // 3
    image[:, :part] = textures.front("OIL", "cold pressed", "BIO")(rng, height, part, p)
    return image


def _lid(side: int) -> list[tuple[float, float]]:
    profile = [(0.0, side * 0.05), (0.02, side * 0.05), (0.04, side * 0.05)]
    return profile if side < 0 else profile[::-1]
