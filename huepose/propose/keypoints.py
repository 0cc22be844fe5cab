"""Pose hypotheses from keypoints: match the model's features with the image's, then fit poses by RANSAC.

Each model keypoint is matched with the most similar image feature, if that passes Lowe's ratio test. Three
matches whose mutual distances are the same on the object and in space give a pose (Kabsch). The pose with
the most inliers is refitted to them; the search then repeats on the remaining matches. If most matches have
no depth, one pose comes from the pixels alone (P3P and RANSAC, OpenCV).
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.distance import cdist

from huepose.geometry import kabsch, se3
from huepose.geometry.arrays import Bool, Float32, Float64, Int64
from huepose.geometry.camera import FLOOR_M, STEREO_NOISE_PER_M, Camera
from huepose.model.types import Keypoints
from huepose.propose.features import Features, distinct
from huepose.propose.products import product

SAME_SPOT_PX, SPOT_NEIGHBOURS = 5.0, 6
"""Features within this radius are at the same spot and are no rivals in the ratio test; at most this many
neighbours of a feature are looked up, itself included."""

MAX_POSES = 3
"""Most poses proposed for one object in one image."""

MIN_INLIERS = 4
"""Least distinct inliers of an accepted pose: one more than the three that define it."""

TRIALS = 150
"""RANSAC trials: sampled triples of matches."""

MIN_SIDE_M = 0.012
"""Least distance between two points of a triple: closer ones do not determine a rotation."""

TOLERANCE_M, DEPTH_SIGMAS = 0.004, 2.0
"""A match is an inlier up to this residual plus this many standard deviations of the depth noise."""

CELL_PX = 2.0
"""Inliers within one cell of this side in the image, or of TOLERANCE_M on the surface, count once."""

REPROJECTION_PX, MIN_INLIERS_2D = 3.0, 7
"""Without depth: largest reprojection error of an inlier, and least distinct inliers of an accepted
pose."""


@dataclass(frozen=True, eq=False)
class ImageFeatures:
    """The features of an image, with their neighbours: near (N, K) indices of the features at the same
    spot, the feature itself included (and repeated if there are fewer than K)."""

    features: Features
    near: Int64

    @staticmethod
    def of(features: Features) -> ImageFeatures:
        """Look up the neighbours of each feature."""
        n = len(features)
        if not n:
            return ImageFeatures(features, np.zeros((0, SPOT_NEIGHBOURS), np.int64))
        tree = cKDTree(features.pixels)
        near = tree.query(features.pixels, SPOT_NEIGHBOURS, distance_upper_bound=SAME_SPOT_PX)[1]
        return ImageFeatures(features, np.where(near == n, np.arange(n)[:, None], near))


@dataclass(frozen=True, eq=False)
class ModelKeypoints:
    """A model's keypoints, ready for matching: points, normals (N, 3) in the object's frame, metres;
    descriptors (N, D) float32 of unit length."""

    points: Float64
    normals: Float64
    descriptors: Float32

    @staticmethod
    def of(keypoints: Keypoints) -> ModelKeypoints:
        """Convert stored keypoints (bytes) to unit descriptors."""
        descriptors = keypoints.descriptors.astype(np.float32)
        descriptors /= np.linalg.norm(descriptors, axis=1, keepdims=True)
        return ModelKeypoints(
            keypoints.points.astype(np.float64), keypoints.normals.astype(np.float64), descriptors
        )


@dataclass(frozen=True, eq=False)
class Matches:
    """Putative matches: points, normals (N, 3) of model keypoints in the object's frame, and the pixels (N,
    2) they were matched with."""

    points: Float64
    normals: Float64
    pixels: Float64

    def __len__(self) -> int:
        return len(self.points)

    def __getitem__(self, index: np.ndarray) -> Matches:
        return Matches(self.points[index], self.normals[index], self.pixels[index])


@dataclass(frozen=True, eq=False)
class ConsensusPoses:
    """Poses T_cam_obj (K, 4, 4) with their counts of distinct inliers (K,), in the order they were found."""

    poses: Float64
    inliers: Int64

    @staticmethod
    def none() -> ConsensusPoses:
        """No pose."""
        return ConsensusPoses(np.zeros((0, 4, 4)), np.zeros(0, np.int64))


def match(model: ModelKeypoints, image: ImageFeatures) -> Matches:
    """Putative matches of a model's keypoints in an image, by the ratio test; many of them are wrong."""
    if not len(model.descriptors) or not len(image.features):
        return Matches(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros((0, 2)))
    similarity = product(model.descriptors, image.features.descriptors.T)
    rows = np.arange(len(similarity))
    best = similarity.argmax(1)
    most = similarity[rows, best]
    similarity[rows[:, None], image.near[best]] = 0.0
    found = distinct(most, similarity.max(1))
    pixels = image.features.pixels[best[found]].astype(np.float64)
    return Matches(model.points[found], model.normals[found], pixels)


def consensus_poses(matches: Matches, depth: Float32, camera: Camera) -> ConsensusPoses:
    """Up to three poses that explain the matches, each with at least MIN_INLIERS; deterministic.

    depth (h, w): float32 metres, 0 = unknown."""
    u, v = np.clip(np.rint(matches.pixels), 0, [camera.width - 1, camera.height - 1]).astype(int).T
    z = depth[v, u].astype(np.float64)
    if np.count_nonzero(z) < 0.5 * len(z):
        return _pnp_pose(matches, camera)
    matches, z = matches[z > 0], z[z > 0]
    left = _Matches3D(
        matches.points,
        matches.normals,
        camera.backproject(matches.pixels, z),
        TOLERANCE_M + DEPTH_SIGMAS * (FLOOR_M + STEREO_NOISE_PER_M * z**2),
        _cell_ids(matches.points / TOLERANCE_M),
        _cell_ids(matches.pixels / CELL_PX),
    )
    rng = np.random.default_rng(0)
    poses: list[Float64] = []
    counts: list[int] = []
    while len(poses) < MAX_POSES and (best := _best_pose(left, rng)) is not None:
        T_cam_obj, inliers = best
        poses.append(T_cam_obj)
        counts.append(int(left.distinct_count(inliers[None])[0]))
        left = left[~inliers]
    return ConsensusPoses(np.array(poses).reshape(-1, 4, 4), np.array(counts, np.int64))


@dataclass(frozen=True, eq=False)
class _Matches3D:
    """N matches with depth: points and normals (N, 3) of the model; measured (N, 3): the measured points,
    camera axes; tolerance (N,) metres; surface_cells, image_cells (N,): ids of the cells that they fall
    into."""

    points: Float64
    normals: Float64
    measured: Float64
    tolerance: Float64
    surface_cells: Int64
    image_cells: Int64

    def __getitem__(self, index: np.ndarray) -> _Matches3D:
        return _Matches3D(*(x[index] for x in vars(self).values()))

    def inliers(self, R: Float64, t: Float64) -> Bool:
        """Which matches are inliers (K, N) of rotations (K, 3, 3) and translations (K, 3): within tolerance,
        and on a surface that faces the camera."""
        rotations = R.reshape(-1, 3)
        at = (rotations @ self.points.T).reshape(len(R), 3, -1) + t[:, :, None]
        near = ((at - self.measured.T) ** 2).sum(1) < self.tolerance**2
        facing = ((rotations @ self.normals.T).reshape(at.shape) * at).sum(1) < 0
        return np.asarray(near & facing)

    def distinct_count(self, inliers: Bool) -> Int64:
        """Distinct inliers (K,) of masks (K, N): the smaller count of occupied cells of surface and
        image."""
        counts = []
        for ids in (self.surface_cells, self.image_cells):
            occupied = np.zeros((len(ids), ids.max(initial=-1) + 1), np.float32)
            occupied[np.arange(len(ids)), ids] = 1
            counts.append((inliers.astype(np.float32) @ occupied > 0).sum(1))
        return np.asarray(np.minimum(*counts), np.int64)


def _cell_ids(places: Float64) -> Int64:
    """Ids (N,) of the unit cells that positions (N, D) fall into."""
    if not len(places):
        return np.zeros(0, np.int64)
    return np.unique(np.floor(places).astype(np.int64), axis=0, return_inverse=True)[1].reshape(-1)


def _best_pose(matches: _Matches3D, rng: np.random.Generator) -> tuple[Float64, Bool] | None:
    """The pose T_cam_obj (4, 4) with most distinct inliers and their mask (N,), or None below MIN_INLIERS."""
    R, t = _triple_poses(matches, rng)
    if not len(R):
        return None
    agree = matches.inliers(R, t)
    count = matches.distinct_count(agree)
    best = int(count.argmax())
    if count[best] < MIN_INLIERS:
        return None
    found, inliers, most = se3.make(R[best], t[best]), agree[best], count[best]
    for _ in range(3):
        fitted = kabsch.fit(matches.points[inliers], matches.measured[inliers])
        again = matches.inliers(fitted[None, :3, :3], fitted[None, :3, 3])
        if matches.distinct_count(again)[0] < most:
            break
        found, inliers, most = fitted, again[0], matches.distinct_count(again)[0]
    return found, inliers


def _triple_poses(matches: _Matches3D, rng: np.random.Generator) -> tuple[Float64, Float64]:
    """RANSAC minimal samples: rotations (K, 3, 3) and translations (K, 3) fitted to triples of matches whose
    mutual distances agree on the object and in space."""
    none = np.zeros((0, 3, 3)), np.zeros((0, 3))
    on_object, in_space = cdist(matches.points, matches.points), cdist(matches.measured, matches.measured)
    fits = np.abs(on_object - in_space) < matches.tolerance[:, None] + matches.tolerance
    fits &= np.minimum(on_object, in_space) > MIN_SIDE_M
    partners = fits.sum(1)
    if not (partners >= 2).any():
        return none
    first = rng.choice(len(fits), TRIALS, p=partners / partners.sum())
    second = (fits[first] * rng.random((TRIALS, len(fits)))).argmax(1)
    both = fits[first] & fits[second]
    third = (both * rng.random(both.shape)).argmax(1)
    three = np.stack([first, second, third], 1)[both.any(1)]
    if not len(three):
        return none
    R, t = kabsch.fit_triples(matches.points[three], matches.measured[three])
    off = matches.points[three] @ R.transpose(0, 2, 1) + t[:, None] - matches.measured[three]
    close = ((off**2).sum(2) < matches.tolerance[three] ** 2).all(1)
    return R[close], t[close]


def _pnp_pose(matches: Matches, camera: Camera) -> ConsensusPoses:
    """One pose from pixels alone, by P3P and RANSAC, or none."""
    if len(matches) < MIN_INLIERS_2D:
        return ConsensusPoses.none()
    cv2.setRNGSeed(0)
    ok, rotation, t, agree = cv2.solvePnPRansac(
        matches.points, matches.pixels, camera.K, None, reprojectionError=REPROJECTION_PX,
        iterationsCount=TRIALS, flags=cv2.SOLVEPNP_AP3P,
    )  # fmt: skip
    if not ok or agree is None or t[2, 0] <= 0:
        return ConsensusPoses.none()
    inliers = matches[agree.ravel()]
    count = min(_cell_ids(x).max() + 1 for x in (inliers.points / TOLERANCE_M, inliers.pixels / CELL_PX))
    if count < MIN_INLIERS_2D:
        return ConsensusPoses.none()
    R = np.asarray(cv2.Rodrigues(rotation)[0], np.float64)
    return ConsensusPoses(se3.make(R, np.asarray(t, np.float64).ravel())[None], np.array([count], np.int64))
