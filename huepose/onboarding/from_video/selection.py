"""Segment the object in the first frame: the surface above the ground plane at a click or inside a box."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from huepose.geometry.arrays import Bool, Float64
from huepose.geometry.box import Box, given_box
from huepose.geometry.frame import RgbdFrame
from huepose.geometry.lifting import EDGE_M, EDGE_SHARE
from huepose.onboarding.from_video.views import tolerance_m
from huepose.support.errors import InputError

REACH_M = 0.5
"""Radius around the object in which the ground plane is searched for, metres."""

NARROWEST_M = 0.15
"""Least width of a ground plane, metres: fingers and arms are narrower."""

LARGEST_SHARE = 0.4
"""Largest share of the image that an object may cover: a larger surface is the room."""

FEWEST_PX = 300
"""Fewest pixels of an object: with fewer, its shape cannot be separated from noise."""

_SHARE_OF_GROUND = 0.2  # least share of the readings around the object; less is a coincidence


@dataclass(frozen=True)
class Selection:
    """The user's selection in the first frame: a box, or one pixel (column, row)."""

    box: Box | None = None
    click: tuple[float, float] | None = None


def first_mask(frame: RgbdFrame, selection: Selection) -> tuple[Bool, Bool, Float64 | None]:
    """Pixels (H, W) of the object; pixels (H, W) that may be the object (also others in the box; for a
    click, the same); and the ground (4,): normal towards the camera and offset, camera axes, None if there
    is none. Raises InputError that says what to select instead."""
    depth, (rows, columns) = frame.depth, np.indices(frame.depth.shape)
    size = (depth.shape[1], depth.shape[0])
    box = None if selection.box is None else given_box(selection.box, size)
    where = (
        f"--{'click' if box is None else 'box'} {' '.join(f'{x:g}' for x in box or selection.click or ())}"
    )
    inside = np.ones(depth.shape, bool)
    if box is not None:
        inside[:] = False
        inside[box.slices(*depth.shape[::-1])] = True
        middle = (box.x + box.w / 2, box.y + box.h / 2)
        central = inside.copy()
        central[:] = False
        central[box.grown(-0.3).slices(*depth.shape[::-1])] = True
    else:
        assert selection.click is not None
        middle = selection.click
        if not (0 <= middle[0] < size[0] and 0 <= middle[1] < size[1]):
            raise InputError(where, expected="X Y (left, top) in the image of {} x {}".format(*size))
        central = np.hypot(columns - middle[0], rows - middle[1]) < 4
    seeds = central & (depth > 0)
    if seeds.sum() < 0.2 * max(int(central.sum()), 1) or not seeds.any():
        raise InputError(
            where,
            found="no depth there in the first frame",
            expected="an object that the depth camera can measure",
            fix="Move the object into the camera's range; glass and mirrors give no depth.",
        )
    near_m = float(np.median(depth[seeds]))
    seed_cam = frame.camera.backproject(np.array([middle]), np.array([near_m]))[0]
    ground = _ground(frame, seed_cam, ~inside if box is not None else np.ones(depth.shape, bool))
    standing = depth > 0
    if ground is not None:
        standing &= ~on_ground(frame, ground)
        if not (seeds & standing).any():
            raise InputError(where, found="the ground there", expected="the object")
        near_m = float(np.median(depth[seeds & standing]))
    number, parts = connected_surfaces(depth, standing & inside)
    chosen = seeds & standing & (np.abs(depth - near_m) < EDGE_M + tolerance_m(near_m))
    counts = np.bincount(parts[chosen], minlength=number)
    counts[0] = 0
    mask = parts == int(np.argmax(counts)) if counts.any() else np.zeros(depth.shape, bool)
    mask = cv2.morphologyEx(mask.astype(np.uint8), cv2.MORPH_CLOSE, np.ones((5, 5), np.uint8)) > 0
    mask &= standing
    if mask.sum() < FEWEST_PX:
        raise InputError(
            where,
            found=f"a surface of {int(mask.sum())} pixels",
            expected=f"an object of {FEWEST_PX} or more",
            fix="Record it from a shorter distance.",
        )
    if mask.mean() > LARGEST_SHARE:
        raise InputError(
            where,
            found=f"a surface over {100 * mask.mean():.0f} % of the image",
            expected="one object",
            fix="Point at the object, or mark it with --box X Y W H.",
        )
    return mask, mask | (standing & inside) if box is not None else mask, ground


def on_ground(frame: RgbdFrame, ground: Float64) -> Bool:
    """Pixels (H, W) whose reading lies on the ground."""
    return np.asarray((frame.depth > 0) & (np.abs(_height(frame, ground)) < tolerance_m(frame.depth)))


def _height(frame: RgbdFrame, ground: Float64) -> Float64:
    """Heights (H, W) of the readings above the ground, metres."""
    rows, columns = np.indices(frame.depth.shape)
    points = frame.camera.backproject(np.stack([columns, rows], -1), frame.depth)
    return np.asarray(points @ ground[:3] + ground[3])


def _ground(frame: RgbdFrame, seed_cam: Float64, beside: Bool) -> Float64 | None:
    """The largest plane around a point (3,) of the object that does not contain the point: a plane that
    does is a face of the object. beside (H, W): pixels that may show the ground."""
    import open3d as o3d

    rows, columns = np.nonzero((frame.depth > 0) & beside)
    points = frame.camera.backproject(np.stack([columns, rows], 1), frame.depth[rows, columns])
    around = points[np.linalg.norm(points - seed_cam, axis=1) < REACH_M]
    around = around[:: max(1, len(around) // 20_000)]
    slack, fewest = float(tolerance_m(seed_cam[2])), max(FEWEST_PX, int(_SHARE_OF_GROUND * len(around)))
    o3d.utility.random.seed(0)
    while len(around) > fewest:
        cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(around))
        found, inliers = cloud.segment_plane(slack / 2, 3, 1000)
        if len(inliers) < fewest:
            return None
        spread = around[inliers] - around[inliers].mean(0)
        across = np.ptp(spread @ np.linalg.eigh(spread.T @ spread)[1][:, 1])
        plane = np.asarray(found) / np.linalg.norm(found[:3])
        plane = plane if plane[3] > 0 else -plane  # the camera is above it
        if across > NARROWEST_M and seed_cam @ plane[:3] + plane[3] > slack:
            return np.asarray(plane, np.float64)
        around = np.delete(around, inliers, axis=0)
    return None


def connected_surfaces(depth: np.ndarray, allowed: Bool) -> tuple[int, np.ndarray]:
    """Connected surfaces of a depth image: number of labels, and label (H, W) of each pixel, 0 for none."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    index = np.arange(depth.size).reshape(depth.shape)
    pairs = []
    for a, b in ((np.s_[:, :-1], np.s_[:, 1:]), (np.s_[:-1], np.s_[1:])):
        step = np.abs(depth[a] - depth[b]) < EDGE_M + EDGE_SHARE * depth[a]
        joined = allowed[a] & allowed[b] & step
        pairs.append((index[a][joined], index[b][joined]))
    i, j = (np.concatenate(p) for p in zip(*pairs, strict=True))
    graph = coo_matrix((np.ones(len(i), bool), (i, j)), shape=(depth.size,) * 2)
    count, parts = connected_components(graph, directed=False)
    return count + 1, np.where(allowed, parts.reshape(depth.shape) + 1, 0)
