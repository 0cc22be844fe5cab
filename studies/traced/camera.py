"""A camera: its pose or path, and its colour and depth from light and exact depth."""

from __future__ import annotations

import cv2
import numpy as np

from huepose.geometry import Camera, se3
from huepose.geometry.arrays import Float32, Float64, Rng, UInt8
from huepose.scenes.textures import clouds
from studies.traced.world import HZ

WIDTH, HEIGHT = 640, 480
WALK_M_S, SWAY_M, SWAY_RAD = (0.15, 0.5), 0.006, 0.012
"""Speed of a carried camera around its target; scales of its deviation from the path."""


def camera_at(rng: Rng, target: Float64) -> tuple[Camera, Float64]:
    """A camera and T_world_cam (4, 4): it looks roughly at `target` (3,) from 0.5 to 1.5 m, depending on its
    focal length."""
    focal = float(rng.choice([540.0, 615.0, 1066.0]))
    cx, cy = (np.array([WIDTH, HEIGHT]) - 1) / 2 + rng.normal(0, 6, 2)
    away = rng.uniform(0.55, 1.05) * (focal / 615.0) ** 0.6
    up, round_ = np.radians(rng.uniform(22, 68)), rng.uniform(0, 2 * np.pi)
    eye = target + away * np.array([np.cos(up) * np.cos(round_), np.cos(up) * np.sin(round_), np.sin(up)])
    z = target + rng.normal(0, 0.04, 3) - eye
    z /= np.linalg.norm(z)
    x = np.cross(z, [0, 0, 1]) / np.linalg.norm(np.cross(z, [0, 0, 1]))
    roll = se3.rotation_exp(np.array([0, 0, np.radians(rng.normal(0, 6))]))
    R = np.stack([x, np.cross(z, x), z], 1) @ roll
    return Camera(focal, focal, float(cx), float(cy), WIDTH, HEIGHT), se3.make(R, eye)


def carried(rng: Rng, target: Float64, T_world_cam: Float64, frames: int) -> list[Float64]:
    """The poses (4, 4) of a camera that an unsteady hand carries around its target."""
    away = np.linalg.norm(T_world_cam[:3, 3] - target)
    about = np.array([rng.normal(0, 0.3), rng.normal(0, 0.3), rng.choice([-1.0, 1.0])])
    about *= rng.uniform(*WALK_M_S) / away / np.linalg.norm(about)
    sway = [np.stack([clouds(rng, 4, frames, 20.0, 2)[0] - 0.5 for _ in range(3)], 1) for _ in range(2)]
    out = []
    for k in range(frames):
        R = se3.rotation_exp(about * (k / HZ))
        eye = target + R @ (T_world_cam[:3, 3] - target) + SWAY_M * sway[0][k]
        out.append(se3.make(R @ T_world_cam[:3, :3] @ se3.rotation_exp(SWAY_RAD * sway[1][k]), eye))
    return out


def photographed(rng: Rng, noise: Rng, light: Float32) -> UInt8:
    """An image (H, W, 3) of light: exposure, white balance, saturation, contrast, blur, sharpening, noise."""
    level = np.quantile(light.mean(-1), rng.uniform(0.5, 0.8))
    out = light * (rng.uniform(0.28, 0.5) / max(float(level), 1e-6)) * np.exp(rng.normal(0, 0.06, 3))
    grey = out.mean(-1, keepdims=True)
    out = np.maximum(grey + (out - grey) * rng.uniform(0.85, 1.25), 0.0)
    out = np.clip(
        np.where(out <= 0.0031308, 12.92 * out, 1.055 * np.maximum(out, 1e-6) ** (1 / 2.4) - 0.055), 0, 1
    )
    out = out + rng.uniform(0.0, 0.6) * out * (1 - out) * (2 * out - 1)
    out = cv2.GaussianBlur(out.astype(np.float32), (0, 0), rng.uniform(0.35, 0.9))
    out = out + rng.uniform(0.0, 0.9) * (out - cv2.GaussianBlur(out, (0, 0), 1.2))
    out = out + noise.normal(size=out.shape) * rng.uniform(0.003, 0.014)
    return np.asarray(np.clip(255.0 * out, 0, 255), np.uint8)


def measured(rng: Rng, noise: Rng, depth: Float32, focal: float) -> Float32:
    """Depth (H, W) as a stereo camera measures it: smooth noise of disparity, smeared borders, no reading
    where the view of the other camera is occluded, and holes."""
    baseline_m = rng.uniform(0.045, 0.08)
    disparity = np.where(depth > 0, focal * baseline_m / np.maximum(depth, 1e-3), 0.0).astype(np.float32)
    height, width = depth.shape
    rows, columns = np.mgrid[:height, :width]
    other = np.clip(np.rint(columns - disparity).astype(int) + 200, 0, width + 199)
    nearest = np.zeros((height, width + 200), np.float32)
    np.maximum.at(nearest, (rows, other), disparity)
    lost = nearest[rows, other] > disparity + 1.0
    error = cv2.GaussianBlur(noise.normal(size=depth.shape).astype(np.float32), (0, 0), rng.uniform(0.8, 2.2))
    grown = cv2.medianBlur(disparity, 5) if rng.uniform() < 0.6 else disparity
    disparity = grown + error / error.std() * np.float32(rng.uniform(0.06, 0.2))
    edge = cv2.morphologyEx(disparity, cv2.MORPH_GRADIENT, np.ones((3, 3))) > 1.5
    lost |= edge & (noise.uniform(size=depth.shape) < 0.4)
    lost |= clouds(noise, height, width, 40.0, 4) > rng.uniform(0.85, 1.0)
    out = np.where(
        (disparity > 0.5) & ~lost & (depth > 0), focal * baseline_m / np.maximum(disparity, 0.5), 0.0
    )
    return np.where(out < 6.0, out, 0.0).astype(np.float32)
