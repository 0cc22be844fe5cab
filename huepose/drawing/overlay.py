"""Poses, masks, boxes and colour pairs drawn over an image. Every function returns a new picture.

Images are (H, W, 3) uint8 RGB, colours RGB triples, pixels (u, v) with integer coordinates at pixel centres.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import cv2
import numpy as np

from huepose.drawing.canvas import FONT, Colour
from huepose.geometry.arrays import Bool, Float, UInt8
from huepose.geometry.box import Box
from huepose.geometry.camera import Camera
from huepose.geometry.mesh import Mesh
from huepose.geometry.se3 import apply

AXES: tuple[Colour, Colour, Colour] = ((230, 60, 50), (60, 190, 70), (60, 110, 240))  # x, y, z
STATE_COLOURS: dict[str, Colour] = {"TRACKING": (60, 220, 60), "SUSPECT": (255, 190, 40)}
"""Colours of poses that may be acted on, and of those that may not."""

LABEL_SCALE = 0.5
_SUBPIXEL_BITS = 4
_LETTER_PX = 8.0  # distance of an axis's letter from its tip


def silhouette(mesh: Mesh, T_cam_obj: Float, camera: Camera) -> Bool:
    """Mask (H, W) of the pixels that a mesh covers at a pose; faces that reach behind the camera are left
    out."""
    mask: UInt8 = np.zeros((camera.height, camera.width), np.uint8)
    corners = camera.project(apply(T_cam_obj, mesh.vertices))[mesh.faces]
    a, b = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    size = np.array([camera.width, camera.height])
    with np.errstate(invalid="ignore"):
        shown = np.isfinite(corners).all((1, 2)) & (np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]) > 1e-3)
        shown &= (corners.max(1) > -1).all(1) & (corners.min(1) < size).all(1)
        shown &= (np.abs(corners) < 30000).all((1, 2))
    for triangle in np.rint(corners[shown] * 2**_SUBPIXEL_BITS).astype(np.int32):
        cv2.fillConvexPoly(mask, triangle, 1, cv2.LINE_8, _SUBPIXEL_BITS)
    return mask > 0


class Body(NamedTuple):
    """A mesh at a pose, the colour of its outline, and its label."""

    mesh: Mesh
    T_cam_obj: Float
    color: Colour
    label: str = ""


def draw_poses(image: UInt8, camera: Camera, bodies: Iterable[Body]) -> UInt8:
    """The outlines of meshes at poses, their axes at their origins, and on top their labels, which do not
    overlap if there is room."""
    picture, labelled = image, []
    for body in bodies:
        mask = silhouette(body.mesh, body.T_cam_obj, camera)
        picture = draw_mask_outline(picture, mask, body.color)
        extent = np.ptp(body.mesh.vertices, axis=0)
        picture = draw_axes(picture, camera, body.T_cam_obj, 0.6 * float(extent.max()))
        box = Box.of_mask(mask)
        if body.label and box is not None:
            labelled.append((body, box))
    taken: list[Box] = []
    for body, box in labelled:
        high = _plate(picture, body.label, (0, 0), LABEL_SCALE).h
        bottoms = [box.y - 6, box.y + box.h + 6 + high, *(box.y - 6 - k * high for k in range(1, 4))]
        plates = [_plate(picture, body.label, (box.x, y), LABEL_SCALE) for y in bottoms]
        plate = next((p for p in plates if not any(p.iou(other) > 0 for other in taken)), plates[0])
        taken.append(plate)
        picture = draw_label(picture, body.label, (plate.x, plate.y + plate.h), body.color)
    return picture


def draw_mask_outline(image: UInt8, mask: Bool, color: Colour, thickness: int = 2) -> UInt8:
    """The outline of a mask (H, W), with those of its holes."""
    picture = image.copy()
    outline, _ = cv2.findContours(mask.astype(np.uint8), cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
    cv2.drawContours(picture, outline, -1, color, thickness, cv2.LINE_AA)
    return picture


def tint(image: UInt8, mask: Bool, color: Colour, strength: float = 0.45) -> UInt8:
    """The pixels of a mask (H, W) mixed with a colour; strength: its share, 0 to 1."""
    picture = image.copy()
    picture[mask] = np.rint((1 - strength) * image[mask] + strength * np.array(color)).astype(np.uint8)
    return picture


def draw_axes(
    image: UInt8, camera: Camera, T_cam_obj: Float, length_m: float, letters: bool = False
) -> UInt8:
    """Axes x red, y green, z blue from the object's origin, each `length_m` long, the farthest tip drawn
    first. letters: names the axes at their tips, or where they leave the image, except those along the line
    of sight."""
    picture = image.copy()
    tips = apply(T_cam_obj, np.vstack([np.zeros(3), length_m * np.eye(3)]))
    pixels = camera.project(tips)
    for k in np.argsort(-tips[1:, 2]):
        line = pixels[[0, k + 1]]
        if np.isfinite(line).all() and (np.abs(line) < 30000).all():
            start, end = (tuple(int(v) for v in np.rint(p * 16)) for p in line)
            cv2.line(picture, start, end, AXES[k], 2, cv2.LINE_AA, 4)
            along = line[1] - line[0]
            length_px = float(np.linalg.norm(along))
            seen, _, tip = cv2.clipLine(
                (0, 0, camera.width, camera.height), *np.rint(line).astype(int).tolist()
            )
            if letters and seen and length_px > _LETTER_PX:
                at = tip + _LETTER_PX * along / length_px + (-4.0, 4.0)
                _put_inside(picture, "xyz"[k], at)
    return picture


def draw_way_out(image: UInt8, towards: Float, text: str) -> UInt8:
    """An arrow to the image border in a direction (2,) of pixels, and in a corner a text that says what is
    there."""
    picture = image.copy()
    size = np.array(image.shape[1::-1], np.float64)
    way = np.asarray(towards, np.float64) / np.linalg.norm(towards)
    reach = float(np.min(0.5 * size / np.maximum(np.abs(way), 1e-9)))
    start, end = (np.rint(0.5 * size + share * reach * way).astype(int).tolist() for share in (0.75, 0.97))
    cv2.arrowedLine(picture, start, end, (20, 20, 20), 2, cv2.LINE_AA, tipLength=0.5)
    return draw_label(picture, text, (0.0, 0.0 if way[1] > 0.0 else size[1]), (250, 250, 250))


def _put_inside(picture: UInt8, letter: str, at: Float) -> None:
    """A letter with its lower left corner at a pixel (2,), moved so that it lies inside the image."""
    (width, height), base = cv2.getTextSize(letter, FONT, LABEL_SCALE, 1)
    low, high = (1, height + 1), (picture.shape[1] - width - 1, picture.shape[0] - base - 1)
    x, y = np.rint(np.clip(at, low, high)).astype(int).tolist()
    cv2.putText(picture, letter, (x, y), FONT, LABEL_SCALE, (20, 20, 20), 1, cv2.LINE_AA)


def draw_label(
    image: UInt8, text: str, at: tuple[float, float], color: Colour, scale: float = LABEL_SCALE
) -> UInt8:
    """Text on a filled box of `color` with its lower left corner `at`, moved so that it lies inside the
    image."""
    picture = image.copy()
    x, y, width, height = (int(v) for v in _plate(image, text, at, scale))
    cv2.rectangle(picture, (x, y), (x + width - 1, y + height - 1), color, -1)
    ink = (15, 15, 15) if np.dot(color, (0.3, 0.59, 0.11)) > 120 else (250, 250, 250)
    base = cv2.getTextSize(text, FONT, scale, 1)[1]
    cv2.putText(picture, text, (x + 4, y + height - base - 3), FONT, scale, ink, 1, cv2.LINE_AA)
    return picture


def _plate(image: UInt8, text: str, at: tuple[float, float], scale: float) -> Box:
    """The filled box of a label, in whole pixels inside the image."""
    (width, height), base = cv2.getTextSize(text, FONT, scale, 1)
    width, height = width + 8, height + base + 6
    x = int(np.clip(at[0], 0, max(0, image.shape[1] - width)))
    y = int(np.clip(at[1], height, max(height, image.shape[0])))
    return Box(x, y - height, width, height)
