"""The sensor model: noise of colour, and depth as an active stereo pair measures it.

Depth is that of the left view of a stereo pair, with disparity d = fx * baseline / Z pixels. Effects, in this
order: ragged edges (the matching window takes one of the two surfaces, more often the nearer one); no depth
to the left of foreground objects (occluded for the right camera); flying pixels between two surfaces;
disparity noise that is correlated over the matching window; steps of 1/32 px; holes. So the RMS of Z on a
smooth surface is Z^2 * subpixel / (fx * baseline), as manufacturers state it. In bad light, depth is lost in
blobs where the image is too dark or too bright to match.
"""

from __future__ import annotations

import cv2
import numpy as np
from scipy.special import ndtr, ndtri

from huepose.geometry.arrays import Bool, Float32, Rng, UInt8
from huepose.geometry.camera import Camera
from huepose.scenes.camera import ColorSensor, StereoSensor
from huepose.support.jit import jit

# sRGB of light whose square root is k / 4095: nearly linear in k, so dark tones keep fine steps.
_TO_SRGB: UInt8 = np.rint(255.0 * (np.arange(4096) / 4095.0) ** (2 / 2.2)).astype(np.uint8)


# The normal distribution: 65536 quantiles at equal steps, and the cumulative distribution from -5 to 5.
_NORMAL: Float32 = ndtri((np.arange(65536) + 0.5) / 65536).astype(np.float32)
_NORMAL_SHARE: Float32 = ndtr(np.arange(-320, 321) / 64.0).astype(np.float32)


DARK, GLARE = 14.0, 250.0
"""Grey levels below and above which a stereo camera finds no match."""

LOST_SHARE = 0.6
"""Share of these pixels that have no depth, in blobs."""


def gaussian(rng: Rng, shape: tuple[int, ...]) -> Float32:
    """Normal noise of RMS 1, from a table of 16-bit steps: four times as fast as exact noise."""
    codes = np.frombuffer(rng.bytes(2 * int(np.prod(shape))), np.uint16)
    return np.asarray(_NORMAL[codes].reshape(shape), np.float32)


def expose(linear: Float32, sensor: ColorSensor, rng: Rng) -> UInt8:
    """Image (H, W, 3) uint8 sRGB of linear light (H, W, 3), 1 = white."""
    light: Float32 = cv2.GaussianBlur(linear, (0, 0), sensor.blur_px).astype(np.float32)
    return _develop(light, gaussian(rng, light.shape), 1.0 / sensor.full_well, sensor.read_noise**2, _TO_SRGB)


@jit
def _develop(light: Float32, noise: Float32, photon: float, read: float, to_srgb: UInt8) -> UInt8:
    out: UInt8 = np.empty(light.shape, np.uint8)
    height, width = light.shape[:2]
    for row in range(height):
        for column in range(width):
            for k in range(3):
                signal = np.float64(light[row, column, k])
                signal += np.float64(noise[row, column, k]) * np.sqrt(max(signal, 0.0) * photon + read)
                root = np.sqrt(min(max(signal, 0.0), 1.0))
                out[row, column, k] = to_srgb[int(root * 4095.0 + 0.5)]
    return out


def stereo_depth(
    depth: Float32, normals_cam: Float32, camera: Camera, sensor: StereoSensor, rng: Rng
) -> Float32:
    """Depth (H, W) as the sensor measures it, 0 = none, from true depth (H, W) and normals (H, W, 3)."""
    shape = depth.shape
    intrinsics = (camera.fx, camera.fy, camera.cx, camera.cy)
    unit = camera.fx * sensor.baseline_m
    d = np.divide(unit, depth, out=np.zeros_like(depth), where=depth > 0).astype(np.float32)
    near, far, edge = _around_edges(d)

    # Around an edge, the window takes one of the two surfaces: at random, but the same within a patch.
    choice = patches(rng, shape, 2.2)
    seen = np.where(edge & (choice > 0.75), far, np.where(edge & (choice < 0.45), near, d)).astype(np.float32)
    known = (seen > 0) & ~_occluded(d)
    flying = edge & (rng.random(shape, dtype=np.float32) < sensor.flying)
    mix = rng.random(shape, dtype=np.float32)
    seen = np.where(flying, far + mix * (near - far), seen).astype(np.float32)

    window = sensor.window_px
    white, blotches = gaussian(rng, shape), cv2.blur(gaussian(rng, shape), (window, window))
    noise = sensor.subpixel * (np.sqrt(0.8) * window * blotches + np.sqrt(0.2) * white)
    measured = np.rint((seen + noise) * 32) / 32

    lost = np.minimum(0.002 + sensor.holes * depth**2 + 0.7 * _grazing(normals_cam, *intrinsics), 0.95)
    known &= patches(rng, shape, 3.5) >= lost
    known &= ~(edge & (patches(rng, shape, 1.2) < sensor.edge_holes))
    known &= measured > 0.5
    out = np.divide(unit, measured, out=np.zeros(shape, np.float32), where=known)
    return np.asarray(out, np.float32)


def _around_edges(d: Float32) -> tuple[Float32, Float32, Bool]:
    """The largest and smallest disparity within 2 px, and the pixels within 1 px of a jump.

    A jump is a second difference of over 1 px: zero on any plane, however steep.
    """
    bend = np.array([[1, -2, 1]], np.float32)
    across, down = cv2.filter2D(d, -1, bend), cv2.filter2D(d, -1, bend.T)
    jump = (np.maximum(np.abs(across), np.abs(down)) > 1.0).astype(np.uint8)
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (5, 5))
    near, far = cv2.dilate(d, disc).astype(np.float32), cv2.erode(d, disc).astype(np.float32)
    return near, far, cv2.dilate(jump, np.ones((3, 3), np.uint8)) > 0


def patches(rng: Rng, shape: tuple[int, ...], sigma_px: float) -> Float32:
    """A random field, uniform in 0..1 and smooth over about `sigma_px`. Its values below p cover the share
    p of the pixels, in blobs."""
    height, width = shape
    step = 1 if sigma_px < 2 else 2
    small = gaussian(rng, (height // step + 1, width // step + 1))
    field = cv2.resize(cv2.GaussianBlur(small, (0, 0), sigma_px / step), (width, height)).astype(np.float32)
    place = field * np.float32(64.0 / field.std()) + np.float32(320.5)
    return np.asarray(_NORMAL_SHARE[np.clip(place, 0, 640).astype(np.int16)], np.float32)


@jit
def _occluded(d: Float32) -> Bool:
    """Pixels that a nearer surface occludes in the right view. Their position there is d px to the left; the
    nearer surface lies farther right in the same row of the left view."""
    height, width = d.shape
    out: Bool = np.zeros(d.shape, np.bool_)
    for row in range(height):
        reached = np.float32(1e9)
        for column in range(width - 1, -1, -1):
            if d[row, column] <= 0:
                continue
            place = column - d[row, column]
            if place > reached + 0.5:
                out[row, column] = True
            else:
                reached = min(reached, place)
    return out


@jit
def _grazing(normals: Float32, fx: float, fy: float, cx: float, cy: float) -> Float32:
    """0 where a surface is viewed at up to 60 degrees from its normal, rising to 1 at 85 degrees."""
    height, width = normals.shape[:2]
    out: Float32 = np.zeros((height, width), np.float32)
    for row in range(height):
        y = (row - cy) / fy
        for column in range(width):
            x = (column - cx) / fx
            facing = -(normals[row, column, 0] * x + normals[row, column, 1] * y + normals[row, column, 2])
            cos = facing / np.sqrt(x * x + y * y + 1.0)
            if cos < 0.5:
                out[row, column] = min((60.0 - np.degrees(np.arccos(max(cos, 0.0)))) / -25.0, 1.0)
    return out


def lost_in_bad_light(depth: Float32, color: UInt8, rng: Rng) -> Float32:
    """Depth (H, W) with blobs set to 0 where the image (H, W, 3) is too dark or too bright."""
    grey = cv2.GaussianBlur(color.max(2).astype(np.float32), (0, 0), 2.0)
    bad = (grey < DARK) | (grey > GLARE)
    return np.where(bad & (patches(rng, depth.shape, 4.0) < LOST_SHARE), np.float32(0.0), depth)


def shifted(depth: Float32, right_px: int, down_px: int) -> Float32:
    """Depth (H, W) shifted against colour by these pixels; 0 at the border, where depth is then unknown."""
    height, width = depth.shape
    move = np.array([[1, 0, right_px], [0, 1, down_px]], np.float64)
    return np.asarray(cv2.warpAffine(depth, move, (width, height), flags=cv2.INTER_NEAREST), np.float32)
