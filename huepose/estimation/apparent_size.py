"""Does an object have the size in the image that its depth implies?

Depth gives the distance of a pose; with the camera matrix it gives the size of the object in the image. If
the image shows the object clearly larger or smaller, one of three is wrong by this share: the focal length,
the unit of depth, or the size of the mesh. Poses fit all the same, because they keep their depth and match
texture as well as possible. So no pose reveals the error by itself.

Two cues are compared with each size: the image's edges, where the outline would lie, and its colours, where
the texture would lie. A single look may be misled by a neighbour of the same colour or by an occluder, so
looks at several objects and frames are added up. The size of a single object is clear only if it is also
clear without any quarter of the object: what misleads lies on one side.

Is the camera wrong, or one object? With a wrong camera matrix or unit of depth, all objects look larger, or
all smaller, by the same share. If other objects fit, an object that does not fit differs from its mesh: it is
the same product in another size, or its mesh is too large or too small. With a single object, this cannot be
decided; then the camera is doubted, and the message names the mesh as well.
"""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import cv2
import numpy as np

from huepose.estimation.outlines import (
    BORDER_PX,
    FEWEST,
    RELATED_PX,
    edges_across,
    free_outline,
    smoothed,
)
from huepose.estimation.types import PoseEstimate
from huepose.geometry.arrays import Bool, Float32, Float64
from huepose.geometry.camera import Camera
from huepose.geometry.frame import RgbdFrame
from huepose.judge.silhouette import projected_box
from huepose.model.types import ReferenceModel
from huepose.rendering.render import Rendering, render

SCALES = np.arange(-0.3, 0.301, 0.01)
"""Sizes that are compared: by how much larger than expected (share) the object is, for each entry of the
support."""

USUAL = 0.045
"""Errors of size up to this share are usual for depth cameras and scanned models (YCB-Video: 2 to 4 %) and
are not reported."""

LEAST_OF_ONE = 0.06
"""The size of a single object counts against the camera from this share on, because its mesh may be wrong,
too. Of 49 right poses in recorded and path-traced frames, two were clearly off by 5 %, none by more. With fx
and fy wrong by 8 or 10 %, 85 of 174 are detected, instead of 93."""

CLEAR, CLEAR_OF_ONE = 10.0, 3.0
"""Least gain of the support, as a natural logarithm, over sizes that are usual: of all objects together, and
of one, without any quarter of it (odds of 20)."""

MOSTLY_SEEN = 0.7
"""A pose is compared if at least this share of its pixels is visible: an occluder has an outline, too."""

SHIFT_PX = 2.0
"""Largest shift of a pose in the image that is tried at each size."""

PATCH_PX = 5.0
"""Correlation length of colours, pixels: nearer ones are not independent."""

QUARTERS = 4
"""Parts of the visible area of an object; each is left out once (jackknife)."""

SAMPLES = 600
"""Most pixels whose colours are compared."""

_SHIFTS = np.stack(np.meshgrid(*[np.arange(-SHIFT_PX, SHIFT_PX + 0.5)] * 2), axis=-1).reshape(-1, 2)


@dataclass(frozen=True)
class ApparentSize:
    """larger: share by which the image shows objects larger than their depth implies, negative for smaller;
    gain: how clearly that exceeds the usual errors of cameras and models, as a natural logarithm."""

    larger: float
    gain: float

    @property
    def clear(self) -> bool:
        """Whether the size clearly exceeds the usual errors of cameras and models."""
        return self.gain >= CLEAR

    def said(self, camera: Camera) -> str:
        """What may be wrong, in a sentence."""
        way, focal, unit, mesh = (
            ("larger", "small", "large", "small")
            if self.larger > 0
            else ("smaller", "large", "small", "large")
        )
        return (
            f"The image shows objects {100 * abs(self.larger):.0f} % {way} than their depth says: fx and "
            f"fy ({camera.fx:.0f}, {camera.fy:.0f}) are too {focal}, the depth scale is too {unit}, or the "
            f"mesh is too {mesh}."
        )

    def said_of_one(self) -> str:
        """What may be wrong where it is the size of one object, while others fit."""
        way, mesh = ("larger", "small") if self.larger > 0 else ("smaller", "large")
        return (
            f"The image shows it about {100 * abs(self.larger):.0f} % {way} than its mesh, while other "
            f"objects fit: it is the same thing in another size, or the mesh is too {mesh}."
        )


def apparent_size(supports: Sequence[Float64], others: float = 0.0) -> ApparentSize:
    """The size that all supports (P, S) of `support` favour together; its gain is the smallest of the rows P.
    others: share by which other objects look larger; sizes near it count as usual, too. If the best size is
    at an end of SCALES, the gain is 0."""
    total = np.sum(supports, axis=0) if len(supports) else np.zeros((1, len(SCALES)))
    best = int(np.argmax(total[0]))
    if best in (0, len(SCALES) - 1):
        return ApparentSize(float(SCALES[best]), 0.0)
    usual = np.minimum(np.abs(SCALES), np.abs(SCALES - others)) <= USUAL
    gains = total[:, _alike(SCALES[best])].max(1) - total[:, usual].max(1)
    return ApparentSize(float(SCALES[best]), float(gains.min()))


def looks(
    frame: RgbdFrame, models: Mapping[str, ReferenceModel], answers: Sequence[PoseEstimate]
) -> list[Float64]:
    """The support from each estimate of a frame whose object is mostly visible."""
    out = []
    for answer in answers:
        if answer.T_cam_obj is not None and answer.mask is not None:
            out += [support(frame, models[answer.object], answer.T_cam_obj, answer.mask)]
    return [one for one in out if one is not None]


def support(frame: RgbdFrame, model: ReferenceModel, T_cam_obj: Float64, mask: Bool) -> Float64 | None:
    """How well each of SCALES agrees with the image at a pose (4, 4) that was fitted to depth: (1 + QUARTERS,
    S), natural logarithms up to a constant. First row: the whole visible area; the others: without one
    quarter, counted as if it were the whole. None if too little is visible. mask (H, W): its visible
    pixels."""
    box = projected_box(model, frame, T_cam_obj)
    if box is None:
        return None
    # As far as a larger outline would reach.
    rows, columns = box.grown(0.5 * SCALES[-1], 2 * BORDER_PX).slices(frame.camera.width, frame.camera.height)
    height, width = mask[rows, columns].shape
    window = replace(
        frame,
        color=np.ascontiguousarray(frame.color[rows, columns]),
        depth=np.ascontiguousarray(frame.depth[rows, columns]),
        camera=frame.camera.cropped(columns.start, rows.start, width, height),
    )
    view, seen = render([(model.mesh, T_cam_obj)], window.camera), mask[rows, columns]
    if seen.sum() < MOSTLY_SEEN * (view.depth > 0).sum():
        return None
    picture = smoothed(window.color)
    of_outline = _by_outline(window, model, T_cam_obj, picture)
    of_texture = _by_texture(view, seen, picture)
    if of_outline is None or of_texture is None:
        return None
    return np.asarray(of_outline + of_texture)


def _by_outline(
    frame: RgbdFrame, model: ReferenceModel, T_cam_obj: Float64, picture: Float32
) -> Float64 | None:
    pixels, normals = free_outline(model, frame, T_cam_obj)
    if len(pixels) < FEWEST:
        return None
    arms = pixels - pixels.mean(0)
    reach_px = float(SCALES[-1] * np.linalg.norm(arms, axis=1).max()) + 2 * SHIFT_PX
    edges = edges_across(picture, pixels, normals, reach_px)
    outwards, aside = (arms * normals).sum(1), normals @ _SHIFTS.T  # (N,), (N, shifts)
    parts = _parts(pixels)
    mean = (parts / np.maximum(parts.sum(1, keepdims=True), 1)).T
    strength = np.array([(edges.at(scale * outwards + aside.T) @ mean).max(0) for scale in SCALES])
    return np.asarray(strength.T * len(pixels) / RELATED_PX)


def _by_texture(view: Rendering, mask: Bool, picture: Float32) -> Float64 | None:
    inner = cv2.erode((mask & (view.depth > 0)).astype(np.uint8), np.ones((5, 5), np.uint8))
    rows, columns = np.nonzero(inner)
    every = max(1, -(-len(rows) // SAMPLES))
    if len(rows) < FEWEST * PATCH_PX:
        return None
    pixels = np.stack([columns, rows], axis=-1)[::every].astype(np.float32)
    expected = smoothed(view.color)[rows[::every], columns[::every]]
    centre, shifts, parts = pixels.mean(0), _SHIFTS.astype(np.float32), _parts(pixels)
    best = np.zeros((len(parts), len(SCALES)))
    for k, scale in enumerate(SCALES):
        places = centre + np.float32(1.0 + scale) * (pixels - centre)
        x, y = (places[:, axis] + shifts[:, axis, None] for axis in (0, 1))
        seen = cv2.remap(picture, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        for p, part in enumerate(parts):
            best[p, k] = _correlation(np.asarray(seen[:, part], np.float32), expected[part])
    independent = len(rows) / PATCH_PX**2
    return np.asarray(-0.5 * independent * np.log(1.0 - np.clip(best, 0.0, 0.99) ** 2))


def _parts(pixels: Float32 | Float64) -> Bool:
    """Which pixels (N, 2) belong to all of them, and to all without each quarter (1 + QUARTERS, N)."""
    right, low = (pixels > np.median(pixels, axis=0)).T
    quarter = right + 2 * low
    return np.stack([np.ones(len(pixels), bool), *(quarter != k for k in range(QUARTERS))])


def _correlation(seen: Float32, expected: Float32) -> float:
    """The best correlation of colours (M, N, 3) with the expected ones (N, 3), without their means."""
    if not len(expected):
        return 0.0
    wanted = (expected - expected.mean(0)).ravel()
    seen = (seen - seen.mean(1, keepdims=True)).reshape(len(seen), -1)
    power = np.einsum("sn,sn->s", seen, seen) * float(wanted @ wanted)
    return float((seen @ wanted / np.sqrt(power + 1e-9)).max())


K = TypeVar("K", bound=Hashable)

INDEPENDENT = 3
"""Looks at one object count as at most this many: those at a static object repeat each other."""

OUTNUMBERED = 3
"""For each object that clearly has its usual size, this many must clearly contradict the camera."""

LIKELY = 0.2
"""Least quality of a pose that is compared although it is not sure: with less, the background is often taken
for an object of another size. As `ReinitConfig.least_quality`."""

AGAINST = 3.0
"""The camera is doubted only if all objects together, without the one that favours the wrong size most, are
against that size by at most this, as a natural logarithm: odds of 20."""

ALIKE = 0.02
"""Scanned models differ by this share in the size that they give for one camera."""

_IS_USUAL = np.abs(SCALES) <= USUAL
_USUAL = SCALES[_IS_USUAL]


def doubted_camera(seen: Mapping[K, Sequence[Float64]], fewest: int = 1) -> ApparentSize | None:
    """The common size of all objects, if it shows that the camera is wrong; else None. seen: by name or
    instance, the `support` (P, S) of each look at an object; fewest: number of looks, at all objects, that is
    needed."""
    every = [one for mine in seen.values() for one in mine]
    together = apparent_size([one[:1] for one in every])
    if not together.clear or len(every) < fewest:
        return None
    if len(seen) == 1 and abs(together.larger) < LEAST_OF_ONE - 1e-9:
        return None
    totals = _totals(seen)
    against = {key: _against(total[0], together.larger) for key, total in totals.items()}
    fit = sum(gain >= CLEAR for gain in against.values())
    if OUTNUMBERED * fit > sum(gain <= -CLEAR for gain in against.values()):
        return None
    quieter = sorted(against, key=lambda key: against[key])[1:]
    total = np.sum([totals[key][0] for key in quieter] or [np.zeros(len(SCALES))], axis=0)
    return together if _against(total, together.larger) <= AGAINST else None


def doubted_objects(seen: Mapping[K, Sequence[Float64]], fewest: int = 1) -> dict[K, ApparentSize]:
    """The size of each object that clearly differs from usual sizes and from the common size of the others,
    when the camera is not doubted. seen: as for `doubted_camera`; fewest: number of looks at an object that
    is needed."""
    totals = _totals(seen)
    out: dict[K, ApparentSize] = {}
    usual = {key: _USUAL[np.argmax(total[0, _IS_USUAL])] for key, total in totals.items()}
    for key, total in totals.items():
        # The median, since one of the others may be of another size itself.
        others = [size for name, size in usual.items() if name != key]
        if others and len(seen[key]) >= fewest:
            size = apparent_size([total], float(np.median(others)))
            out |= {key: size} if size.gain >= CLEAR_OF_ONE else {}
    return out


def doubted_in(
    frame: RgbdFrame, models: Mapping[str, ReferenceModel], answers: Sequence[PoseEstimate]
) -> tuple[ApparentSize | None, dict[int, ApparentSize]]:
    """The evidence of one frame against its camera; if there is none, against objects, by the index of their
    estimates."""
    sure = [k for k, answer in enumerate(answers) if answer.state == "TRACKING"]
    likely = [k for k, answer in enumerate(answers) if answer.found and answer.quality >= LIKELY]
    seen = {k: looks(frame, models, [answers[k]]) for k in sorted({*sure, *likely})}
    # Unsure poses are used against the camera only if none is sure.
    camera = doubted_camera({k: seen[k] for k in sure or likely})
    return camera, {} if camera else doubted_objects(seen)


def _totals(seen: Mapping[K, Sequence[Float64]]) -> dict[K, Float64]:
    return {k: np.mean(mine, 0) * min(len(mine), INDEPENDENT) for k, mine in seen.items() if len(mine)}


def _against(total: Float64, larger: float) -> float:
    """By how much the support (S,) is greater for a usual size, or one that differs the other way, than for
    that share."""
    other = np.sign(larger) * SCALES <= USUAL
    return float(total[other].max() - total[_alike(larger)].max())


def _alike(larger: float) -> Bool:
    """Which of SCALES (S,) are that share, within ALIKE."""
    return np.asarray(np.abs(SCALES - larger) <= ALIKE + 1e-9)
