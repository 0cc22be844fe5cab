"""Is an object as large in the picture as it has to be at its depth?

Depth says how far away a pose is; the camera matrix then says how large the object is in the picture. Where
the picture shows it clearly larger or smaller, one of three is wrong by so much: the focal length, the unit
of depth, or the size of the mesh. Poses fit all the same, because their depth is kept and their texture is
matched as well as it goes, so no pose says so by itself.

Two cues are asked how well they agree with each size: the picture's edges, where the outline would lie, and
its colours, where the texture would. A single look may be misled, by a neighbour of the same colour or by
what hides a part; looks of several objects and frames are added up. Of one object a size is clear only if it
is without any quarter of it, too: what misleads lies on one side.

Is it the camera then, or one object? A wrong camera matrix or unit of depth shows all objects larger, or all
smaller, by the same share. Where others fit, an object that does not is not what its mesh says: the same
product in another size, or a mesh that is too large or too small. Of an object alone nobody can tell; then
the camera is doubted, and its sentence names the mesh as well.
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
"""By how much larger than expected (share) each entry of the support supposes the object to be."""

USUAL = 0.045
"""Depth cameras and scanned models leave sizes wrong by so much (YCB-Video: 2 to 4 %): nothing to report."""

LEAST_OF_ONE = 0.06
"""What one object alone says against the camera counts from here on, since its mesh may err, too. Of 49 right
poses in recorded and path-traced frames two were clearly off by 5 %, none by more; with fx and fy wrong by 8
or 10 % 85 of 174 are found out, instead of 93."""

CLEAR, CLEAR_OF_ONE = 10.0, 3.0
"""Least gain of the support, as a natural logarithm, over sizes that are usual: of all objects together, and
of one, without any quarter of it (odds of 20)."""

MOSTLY_SEEN = 0.7
"""Least share of its pixels that a pose that is looked at explains: what hides a part has an outline, too."""

SHIFT_PX = 2.0
"""How far a pose may lie aside in the picture at each size."""

PATCH_PX = 5.0
"""Correlation length of colours, pixels: nearer ones are not independent."""

QUARTERS = 4
"""Parts of what is seen of an object; each is left out once, for a standard error (jackknife)."""

SAMPLES = 600
"""Most pixels whose colours are compared."""

_SHIFTS = np.stack(np.meshgrid(*[np.arange(-SHIFT_PX, SHIFT_PX + 0.5)] * 2), axis=-1).reshape(-1, 2)


@dataclass(frozen=True)
class ApparentSize:
    """larger: share by which the picture shows objects larger than they would be at their depth, negative for
    smaller; gain: how clearly that is more than cameras and models usually err, as a natural logarithm."""

    larger: float
    gain: float

    @property
    def clear(self) -> bool:
        """Whether it is more than cameras and models usually err, beyond doubt."""
        return self.gain >= CLEAR

    def said(self, camera: Camera) -> str:
        """What may be wrong, in a sentence."""
        way, focal, unit, mesh = (
            ("larger", "small", "large", "small")
            if self.larger > 0
            else ("smaller", "large", "small", "large")
        )
        return (
            f"The picture shows objects {100 * abs(self.larger):.0f} % {way} than their depth says: fx and "
            f"fy ({camera.fx:.0f}, {camera.fy:.0f}) are too {focal}, the depth scale is too {unit}, or the "
            f"mesh is too {mesh}."
        )

    def said_of_one(self) -> str:
        """What may be wrong where it is the size of one object, while others fit."""
        way, mesh = ("larger", "small") if self.larger > 0 else ("smaller", "large")
        return (
            f"The picture shows it about {100 * abs(self.larger):.0f} % {way} than its mesh, while other "
            f"objects fit: it is the same thing in another size, or the mesh is too {mesh}."
        )


def apparent_size(supports: Sequence[Float64], others: float = 0.0) -> ApparentSize:
    """The size that looks (P, S) of `support` speak for together; it gains as much as in the row that says
    the least for it. others: what the camera shows other objects larger by (share); what is usual beside that
    is usual, too. The best at an end of SCALES is no size, and gains nothing."""
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
    """The support by each answer of a frame that is mostly in view."""
    out = []
    for answer in answers:
        if answer.T_cam_obj is not None and answer.mask is not None:
            out += [support(frame, models[answer.object], answer.T_cam_obj, answer.mask)]
    return [one for one in out if one is not None]


def support(frame: RgbdFrame, model: ReferenceModel, T_cam_obj: Float64, mask: Bool) -> Float64 | None:
    """How well each of SCALES (1 + QUARTERS, S) agrees with what is seen of a pose (4, 4) that was fitted to
    depth, as a natural logarithm up to a constant: of all of it, and without each quarter, counted as if it
    were all; None where too little is seen. mask (H, W): its visible pixels."""
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
    """The best correlation of pictures (M, N, 3) with the expected one (N, 3), without their mean colours."""
    if not len(expected):
        return 0.0
    wanted = (expected - expected.mean(0)).ravel()
    seen = (seen - seen.mean(1, keepdims=True)).reshape(len(seen), -1)
    power = np.einsum("sn,sn->s", seen, seen) * float(wanted @ wanted)
    return float((seen @ wanted / np.sqrt(power + 1e-9)).max())


K = TypeVar("K", bound=Hashable)

INDEPENDENT = 3
"""Looks at one object count as so many at most: of a thing that stands still they repeat each other."""

OUTNUMBERED = 3
"""So many objects must clearly speak against the camera for each that clearly has its usual size."""

LIKELY = 0.2
"""Least quality of a pose that is asked though it is not sure: where nothing is, the background is often
taken for an object of another size. As `ReinitConfig.least_quality`."""

AGAINST = 3.0
"""What all objects but the loudest may have against its share together, as a natural logarithm, before the
camera is not doubted for it: odds of 20."""

ALIKE = 0.02
"""By such a share scanned models differ in what they say of one camera."""

_IS_USUAL = np.abs(SCALES) <= USUAL
_USUAL = SCALES[_IS_USUAL]


def doubted_camera(seen: Mapping[K, Sequence[Float64]], fewest: int = 1) -> ApparentSize | None:
    """The size that objects have in common where it speaks against the camera. seen: by name or instance, the
    `support` (P, S) of each look at an object; fewest: so many, of all objects, are asked for."""
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
    """The size of each object that clearly differs from what is usual and from what the others have in
    common, where the camera is not doubted. seen: as there; fewest: so many looks at an object are asked
    for."""
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
    """What one frame says against its camera; if nothing, against objects, by their place in its answers."""
    sure = [k for k, answer in enumerate(answers) if answer.state == "TRACKING"]
    likely = [k for k, answer in enumerate(answers) if answer.found and answer.quality >= LIKELY]
    seen = {k: looks(frame, models, [answers[k]]) for k in sorted({*sure, *likely})}
    # Of those that are not sure the camera is asked where none is.
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
    """Which of SCALES (S,) are that share, as far as models can tell."""
    return np.asarray(np.abs(SCALES - larger) <= ALIKE + 1e-9)
