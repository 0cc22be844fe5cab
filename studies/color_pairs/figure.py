"""The picture of the paper's first figure for our objects: how pairs and surfaces are classified.

One row an object: the real picture, its pairs by class (each half of a disc is the class of that side), the
surface classified by the nearest points of the classified cloud; then the same three for the model rendered
at the labelled pose.
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from scipy.spatial import cKDTree

from huepose.colorpair.extract import bounds
from huepose.drawing.contact_sheet import contact_sheet
from huepose.drawing.overlay import draw_color_pairs
from huepose.geometry.arrays import Bool, Float64, UInt8
from huepose.geometry.frame import RgbdFrame
from huepose.model.pairs import reference_pairs
from huepose.model.types import ReferenceModel
from huepose.paper.classes import ClassConfig, classify
from huepose.paper.extended.hypotheses import HypothesesConfig, Reading, read_scene
from huepose.paper.scene import extract_at_model_scale
from huepose.paper.tables import tables_of
from huepose.rendering.render import render

PALETTE: UInt8 = np.array(
    [
        (230, 60, 50),
        (60, 140, 240),
        (250, 200, 40),
        (50, 180, 90),
        (190, 90, 210),
        (250, 140, 40),
        (60, 210, 210),
        (150, 110, 70),
    ],
    np.uint8,
)
"""Of the classes: told apart, not their own colours."""

REACH = 0.06
"""Diameters from a classified point within which the surface is painted in its class."""

SIDE_PX = 300
TITLES = (
    "picture",
    "pairs by class",
    "classified surface",
    "rendered",
    "pairs by class",
    "classified surface",
)


def class_row(model: ReferenceModel, frame: RgbdFrame, mask: Bool, T_cam_obj: Float64) -> list[UInt8]:
    """The six pictures of one object in one frame: of the frame, and of the model at the same pose."""
    rendered = render([(model.mesh, T_cam_obj)], frame.camera)
    shown = np.where(mask[..., None] & (rendered.depth > 0)[..., None], rendered.color, 255).astype(np.uint8)
    twin = RgbdFrame(shown, np.where(mask, rendered.depth, 0).astype(np.float32), frame.camera)
    return [*_triple(model, frame, mask), *_triple(model, twin, mask & (rendered.depth > 0))]


def class_figure(rows: Sequence[tuple[str, Sequence[UInt8]]]) -> UInt8:
    """Rows (object's name, six pictures) on one page."""
    labels = [f"{name}: {t}" if k == 0 else t for name, row in rows for k, t in enumerate(TITLES[: len(row)])]
    return contact_sheet([p for _, row in rows for p in row], len(TITLES), labels, (SIDE_PX, SIDE_PX))


def _triple(model: ReferenceModel, frame: RgbdFrame, mask: Bool) -> list[UInt8]:
    left, top, right, bottom = bounds(mask, 6)
    cut = (slice(top, bottom), slice(left, right))
    factor = SIDE_PX / max(right - left, bottom - top, 1)
    size = (max(round((right - left) * factor), 1), max(round((bottom - top) * factor), 1))
    picture = np.asarray(cv2.resize(frame.color[cut], size, interpolation=cv2.INTER_CUBIC), np.uint8)
    faded = np.rint(0.35 * picture + 0.65 * 255).astype(np.uint8)
    pairs = extract_at_model_scale(model.pairs, frame, mask)
    rng = np.random.default_rng(0)
    readings = read_scene(model, pairs, frame, mask, HypothesesConfig(scene_pairs=2000), rng)
    if not readings:
        return [picture, faded, faded]
    reading = readings[0]
    classes, confidence = _classes(model, reading)
    sure = confidence >= ClassConfig().least
    places = (frame.camera.project(reading.pairs.points[sure]) - (left, top) + 0.5) * factor - 0.5
    discs = draw_color_pairs(faded, places, PALETTE[classes[sure] % len(PALETTE)], 4)
    surface = _painted(frame, mask, reading, REACH * model.diameter_m)[cut]
    return [picture, discs, np.asarray(cv2.resize(surface, size, interpolation=cv2.INTER_NEAREST), np.uint8)]


def _classes(model: ReferenceModel, reading: Reading) -> tuple[UInt8, np.ndarray]:
    reference = reference_pairs(model.pairs)
    tables = tables_of(model)
    return classify(reading.pairs.colors, reference.colors, tables.side_classes, len(tables.centers))


def _painted(frame: RgbdFrame, mask: Bool, reading: Reading, reach_m: float) -> UInt8:
    """The frame (H, W, 3), pale, with the surface near classified points in the colour of their class."""
    page: UInt8 = np.rint(0.2 * frame.color + 0.8 * 255).astype(np.uint8)
    v, u = np.nonzero(mask & (frame.depth > 0))
    if not len(v) or not len(reading.cloud):
        return page
    points = frame.camera.backproject(np.stack([u, v], 1).astype(np.float64), frame.depth[v, u])
    distance, nearest = cKDTree(reading.cloud.points).query(points, distance_upper_bound=reach_m)
    near = np.isfinite(distance)
    page[v[near], u[near]] = PALETTE[reading.cloud.classes[nearest[near]] % len(PALETTE)]
    return page
