"""Path tracing with Mitsuba; the caller sets its variant first."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from huepose.geometry import Camera, Mesh, se3
from huepose.geometry.arrays import Float32, Float64, Rng
from huepose.rendering.render import corner_normals

SAMPLES, BOUNCES = {"independent": 40, "multijitter": 9}, 7
"""Samples of a pixel by Mitsuba's sampler (single frames use the first, films the second, which needs fewer),
and length of a path."""


def kelvin(temperature: float) -> Float64:
    """Linear colour (3,) of a lamp of a colour temperature: Planck's law at three wavelengths, green 1."""
    waves = np.array([610e-9, 550e-9, 465e-9])
    power = waves**-5.0 / (np.exp(0.014388 / (waves * temperature)) - 1.0)
    white = waves**-5.0 / (np.exp(0.014388 / (waves * 6500.0)) - 1.0)
    out = power / white
    return np.asarray(out / out[1])


def traced(
    rng: Rng,
    noise: Rng,
    scene: Sequence[tuple[Mesh, Float64, float]],
    camera: Camera,
    T_world_cam: Float64,
    sampler: str,
) -> Float32:
    """Linear light (H, W, 3) of meshes with poses (4, 4) and gloss, 0..1, under one to three lamps and a
    uniform sky, white-balanced for most of the colour of the first lamp."""
    import mitsuba as mi

    parts: dict[str, Any] = {}
    for k, (mesh, T, gloss) in enumerate(scene):
        parts[f"mesh{k}"] = _part(
            mi, mesh, T, rng.uniform(0.12, 0.7) + 0.25 * (1.0 - gloss), rng.uniform(0.2, 0.6)
        )
    first = rng.uniform(2700, 7000)
    sky = kelvin(rng.uniform(3000, 7500)) * rng.uniform(0.05, 0.6)
    parts["sky"] = {"type": "constant", "radiance": {"type": "rgb", "value": sky.tolist()}}
    to = mi.ScalarTransform4f
    for k in range(int(rng.integers(1, 4))):
        angle, away, side = rng.uniform(0, 2 * np.pi), rng.uniform(0.2, 1.1), float(rng.uniform(0.04, 0.4))
        place = [away * np.cos(angle), away * np.sin(angle), rng.uniform(0.8, 1.8)]
        light = (
            kelvin(first if rng.uniform() < 0.6 else rng.uniform(2500, 8000))
            * rng.uniform(0.5, 1.5)
            / side**2
        )
        parts[f"lamp{k}"] = {
            "type": "rectangle",
            "to_world": to().look_at(origin=place, target=[0, 0, 0], up=[0.3, 1, 0.1])
            @ to().scale([side, side, 1]),
            "emitter": {"type": "area", "radiance": {"type": "rgb", "value": light.tolist()}},
        }
    # Mitsuba's camera has x to the left and y up.
    T_world_sensor = T_world_cam @ np.diag([-1.0, -1.0, 1.0, 1.0])
    parts["sensor"] = {
        "type": "perspective",
        "fov": float(np.degrees(2 * np.arctan(camera.width / 2 / camera.fx))),
        "principal_point_offset_x": -(camera.cx - (camera.width - 1) / 2) / camera.width,
        "principal_point_offset_y": -(camera.cy - (camera.height - 1) / 2) / camera.height,
        "to_world": to(T_world_sensor.tolist()),
        "sampler": {"type": sampler},
        "film": {
            "type": "hdrfilm",
            "width": camera.width,
            "height": camera.height,
            "rfilter": {"type": "box"},
        },
    }
    whole = mi.load_dict({"type": "scene", "integrator": {"type": "path", "max_depth": BOUNCES}, **parts})
    seed: Any = int(noise.integers(1 << 30))
    light = np.array(mi.render(whole, spp=SAMPLES[sampler], seed=seed))[..., :3]
    return np.asarray(
        np.minimum(light, 1.5 * np.quantile(light, 0.997)) / kelvin(first) ** rng.uniform(0.4, 1.0),
        np.float32,
    )


def _part(mi: Any, mesh: Mesh, T: Float64, roughness: float, specular: float) -> Any:
    """A mesh for Mitsuba; faces share no vertices, so that each corner has its own normal and texture
    coordinates."""
    material = {
        "type": "principled",
        "base_color": {"type": "bitmap", "bitmap": mi.Bitmap(np.ascontiguousarray(mesh.texture))},
        "roughness": float(np.clip(roughness, 0.1, 0.95)),
        "specular": float(specular),
    }
    properties = mi.Properties()
    properties["bsdf"] = mi.load_dict({"type": "twosided", "material": material})
    corners = se3.apply(T, mesh.vertices[mesh.faces].reshape(-1, 3))
    out = mi.Mesh(
        "mesh",
        len(corners),
        len(mesh.faces),
        has_vertex_normals=True,
        has_vertex_texcoords=True,
        props=properties,
    )
    values = mi.traverse(out)
    values["vertex_positions"] = corners.astype(np.float32).ravel()
    values["vertex_normals"] = (corner_normals(mesh).reshape(-1, 3) @ T[:3, :3].T).astype(np.float32).ravel()
    values["vertex_texcoords"] = mesh.uv.astype(np.float32).ravel()
    values["faces"] = np.arange(len(corners), dtype=np.uint32)
    values.update()
    return out
