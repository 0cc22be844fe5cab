"""Hypotheses by keypoints: features of the model that are found in the picture, and poses they agree on.

Each keypoint of the model is matched with what looks most like it in the picture, unless something elsewhere
looks nearly as much like it (Lowe's ratio test). Three matches whose distances on the object and in space are
the same give a pose; the one that most matches agree on is fitted to these, and the others are asked again.
Where depth is missing at most of the matches, pictures alone tell (P3P and RANSAC).
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
from huepose.propose.features import Features

RATIO = 0.85
"""What is elsewhere looks so much farther off. Wrong matches are many, and told by their distances."""

ELSEWHERE_PX, AT_ONE_SPOT = 5.0, 6
"""Features nearer than this are at one spot, where there are hardly more than so many."""

POSES = 3
"""Of an object, in a picture."""

LEAST = 4
"""Points that agree, of which a pose is made: three always do."""

TRIPLES = 150
APART_M = 0.012
"""Two points of a triple are at least this far apart."""

SLACK_M, NOISE = 0.004, 2.0
"""Matches agree with a pose up to this and so many deviations of depth."""

SPOT_PX = 2.0
"""Points of so much of the picture, or of SLACK_M of the surface, count once."""

PIXEL_ERROR, LEAST_IN_PICTURE = 3.0, 7
"""Of a match, and points that agree, where there is no depth to agree with."""


@dataclass(frozen=True, eq=False)
class Spots:
    """The features of a picture; near (N, K): of each those at the same spot, itself among them."""

    features: Features
    near: Int64

    @staticmethod
    def of(features: Features) -> Spots:
        """With what is near found."""
        n = len(features)
        if not n:
            return Spots(features, np.zeros((0, AT_ONE_SPOT), np.int64))
        tree = cKDTree(features.pixels)
        near = tree.query(features.pixels, AT_ONE_SPOT, distance_upper_bound=ELSEWHERE_PX)[1]
        return Spots(features, np.where(near == n, np.arange(n)[:, None], near))


@dataclass(frozen=True, eq=False)
class Sought:
    """The keypoints of a model as they are compared: points, normals (N, 3); looks (N, D) float32 of unit
    length."""

    points: Float64
    normals: Float64
    looks: Float32

    @staticmethod
    def of(keypoints: Keypoints) -> Sought:
        """Laid out."""
        looks = keypoints.descriptors.astype(np.float32)
        looks /= np.linalg.norm(looks, axis=1, keepdims=True)
        return Sought(keypoints.points.astype(np.float64), keypoints.normals.astype(np.float64), looks)


@dataclass(frozen=True, eq=False)
class Matches:
    """points, normals (N, 3): of keypoints of the model; pixels (N, 2): where they seem to be."""

    points: Float64
    normals: Float64
    pixels: Float64

    def __len__(self) -> int:
        return len(self.points)

    def __getitem__(self, index: np.ndarray) -> Matches:
        return Matches(self.points[index], self.normals[index], self.pixels[index])


@dataclass(frozen=True, eq=False)
class Agreed:
    """Poses T_cam_obj (K, 4, 4) that matches agree on, and how many different points (K,), most first."""

    poses: Float64
    points: Int64

    @staticmethod
    def none() -> Agreed:
        """No pose."""
        return Agreed(np.zeros((0, 4, 4)), np.zeros(0, np.int64))


def match(sought: Sought, spots: Spots) -> Matches:
    """The keypoints of a model that are found in a picture, many of them wrongly."""
    if not len(sought.looks) or not len(spots.features):
        return Matches(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros((0, 2)))
    alike = sought.looks @ spots.features.descriptors.T
    rows = np.arange(len(alike))
    best = alike.argmax(1)
    most = alike[rows, best]
    alike[rows[:, None], spots.near[best]] = 0.0
    found = 1.0 - most < RATIO**2 * (1.0 - alike.max(1))
    pixels = spots.features.pixels[best[found]].astype(np.float64)
    return Matches(sought.points[found], sought.normals[found], pixels)


def agreed(matches: Matches, depth: Float32, camera: Camera) -> Agreed:
    """Poses that matches in a picture with depth (h, w) metres, 0 = none, agree on."""
    u, v = np.clip(np.rint(matches.pixels), 0, [camera.width - 1, camera.height - 1]).astype(int).T
    z = depth[v, u].astype(np.float64)
    if np.count_nonzero(z) < 0.5 * len(z):
        return _agreed_in_picture(matches, camera)
    matches, z = matches[z > 0], z[z > 0]
    pairs = _Pairs(
        matches.points,
        matches.normals,
        camera.backproject(matches.pixels, z),
        SLACK_M + NOISE * (FLOOR_M + STEREO_NOISE_PER_M * z**2),
        _numbered(matches.points / SLACK_M),
        _numbered(matches.pixels / SPOT_PX),
    )
    rng = np.random.default_rng(0)
    poses: list[Float64] = []
    points: list[int] = []
    while len(poses) < POSES and (best := _most_agreed(pairs, rng)) is not None:
        T_cam_obj, agree = best
        poses.append(T_cam_obj)
        points.append(int(pairs.different(agree[None])[0]))
        pairs = pairs[~agree]
    return Agreed(np.array(poses).reshape(-1, 4, 4), np.array(points, np.int64))


@dataclass(frozen=True, eq=False)
class _Pairs:
    """N matches with depth: points and normals of the model, points in space, how far these may be off (N,),
    numbers of the piece of surface and of the spot in the picture."""

    points: Float64
    normals: Float64
    seen: Float64
    slack: Float64
    cells: Int64
    spots: Int64

    def __getitem__(self, index: np.ndarray) -> _Pairs:
        return _Pairs(*(x[index] for x in vars(self).values()))

    def agree(self, R: Float64, t: Float64) -> Bool:
        """Which pairs agree (K, N) with rotations (K, 3, 3) and translations (K, 3): near enough, and the
        surface is turned to the camera."""
        turns = R.reshape(-1, 3)
        at = (turns @ self.points.T).reshape(len(R), 3, -1) + t[:, :, None]
        near = ((at - self.seen.T) ** 2).sum(1) < self.slack**2
        facing = ((turns @ self.normals.T).reshape(at.shape) * at).sum(1) < 0
        return np.asarray(near & facing)

    def different(self, agree: Bool) -> Int64:
        """How many different points (K,) of both surface and picture agree."""
        counts = []
        for numbers in (self.cells, self.spots):
            kinds = np.zeros((len(numbers), numbers.max(initial=-1) + 1), np.float32)
            kinds[np.arange(len(numbers)), numbers] = 1
            counts.append((agree.astype(np.float32) @ kinds > 0).sum(1))
        return np.asarray(np.minimum(*counts), np.int64)


def _numbered(places: Float64) -> Int64:
    """One number (N,) for all places (N, D) of the same cell."""
    if not len(places):
        return np.zeros(0, np.int64)
    return np.unique(np.floor(places).astype(np.int64), axis=0, return_inverse=True)[1].reshape(-1)


def _most_agreed(pairs: _Pairs, rng: np.random.Generator) -> tuple[Float64, Bool] | None:
    """The pose T_cam_obj (4, 4) that most pairs agree with, and which (N,) do; None where too few do."""
    R, t = _triples(pairs, rng)
    if not len(R):
        return None
    agree = pairs.agree(R, t)
    count = pairs.different(agree)
    best = int(count.argmax())
    if count[best] < LEAST:
        return None
    found, mine, most = se3.make(R[best], t[best]), agree[best], count[best]
    for _ in range(3):
        fitted = kabsch.fit(pairs.points[mine], pairs.seen[mine])
        again = pairs.agree(fitted[None, :3, :3], fitted[None, :3, 3])
        if pairs.different(again)[0] < most:
            break
        found, mine, most = fitted, again[0], pairs.different(again)[0]
    return found, mine


def _triples(pairs: _Pairs, rng: np.random.Generator) -> tuple[Float64, Float64]:
    """Poses, rotations (K, 3, 3) and translations (K, 3), of three pairs that agree with each other."""
    none = np.zeros((0, 3, 3)), np.zeros((0, 3))
    on_object, in_space = cdist(pairs.points, pairs.points), cdist(pairs.seen, pairs.seen)
    fits = np.abs(on_object - in_space) < pairs.slack[:, None] + pairs.slack
    fits &= np.minimum(on_object, in_space) > APART_M
    partners = fits.sum(1)
    if not (partners >= 2).any():
        return none
    first = rng.choice(len(fits), TRIPLES, p=partners / partners.sum())
    second = (fits[first] * rng.random((TRIPLES, len(fits)))).argmax(1)
    both = fits[first] & fits[second]
    third = (both * rng.random(both.shape)).argmax(1)
    three = np.stack([first, second, third], 1)[both.any(1)]
    if not len(three):
        return none
    R, t = kabsch.fit_triples(pairs.points[three], pairs.seen[three])
    off = pairs.points[three] @ R.transpose(0, 2, 1) + t[:, None] - pairs.seen[three]
    close = ((off**2).sum(2) < pairs.slack[three] ** 2).all(1)
    return R[close], t[close]


def _agreed_in_picture(matches: Matches, camera: Camera) -> Agreed:
    """The pose that most matches agree on by their pixels alone."""
    if len(matches) < LEAST_IN_PICTURE:
        return Agreed.none()
    cv2.setRNGSeed(0)
    ok, rotation, t, agree = cv2.solvePnPRansac(
        matches.points, matches.pixels, camera.K, None, reprojectionError=PIXEL_ERROR,
        iterationsCount=TRIPLES, flags=cv2.SOLVEPNP_AP3P,
    )  # fmt: skip
    if not ok or agree is None or t[2, 0] <= 0:
        return Agreed.none()
    mine = matches[agree.ravel()]
    count = min(_numbered(x).max() + 1 for x in (mine.points / SLACK_M, mine.pixels / SPOT_PX))
    if count < LEAST_IN_PICTURE:
        return Agreed.none()
    R = np.asarray(cv2.Rodrigues(rotation)[0], np.float64)
    return Agreed(se3.make(R, np.asarray(t, np.float64).ravel())[None], np.array([count], np.int64))
