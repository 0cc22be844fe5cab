"""Estimate how much older depth is than colour, from moving objects.

Colour shows a moving object where it is now; older depth shows it where it was. So colour edges are displaced
from depth steps by the object's image velocity times the delay. This displacement grows with the speed and
reverses with the motion; an error of registration does neither. One lag is the displacement along an outline.
Many lags, at several velocities, give the delay with its standard error.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from huepose.colorpair.opponents import opponents_of_bytes
from huepose.estimation.outlines import FAINT, EdgesAcross
from huepose.geometry.arrays import Bool, Float32, Float64
from huepose.geometry.camera import NEAR_M
from huepose.geometry.frame import RgbdFrame
from huepose.judge.borders import Contours

SLOWEST_PX_S = 40.0
"""Image speed under which a lag says too little: 33 ms are 1.3 pixels."""

REACH_PX = 20
"""Search distance for colour edges, pixels along the object's motion: 66 ms at 300 px/s."""

FEWEST = 8
"""Least number of outline points at which depth has a step."""

STEP_M, GAP_PX = 0.03, 3
"""Least depth step from an object to its background, metres, and the most pixels over which it may extend."""

LEAST_LAGS, LEAST_BLOCKS = 8, 4
"""Least numbers of lags, and of blocks with lags, for an estimate."""

FITS_PX, USUAL_SHIFT_PX = 1.5, 3.0
"""Usual distance of lags from the line that fits them, and usual common shift of all lags by registration."""

MAJORITY = 0.5
"""Least share of lags within two FITS_PX of that line."""

CLEAR_SIGMAS, TOGETHER_SIGMAS = 4.0, 2.0
"""A delay is reported if it is CLEAR_SIGMAS standard errors more than TOLERATED_S; the report is withdrawn if
it is TOGETHER_SIGMAS standard errors less."""

TOLERATED_S = 0.008
"""Largest time between the middles of the two exposures of a correct camera, seconds."""

_STARTS_S = np.array([0.0, -0.033, 0.033, -0.066, 0.066])
_STEPS = 8
_WIDTH_PX = REACH_PX + 4
_PLACES = np.arange(-_WIDTH_PX, _WIDTH_PX + 1.0)
_SHIFTS = np.arange(-REACH_PX, REACH_PX + 1.0)

EdgeLag = tuple[float, float, float, float]
"""The lag of one object in one frame: speed, px/s; right, down: mean direction of its outline's motion, of
length 1 if all points move alike; displacement of the colour edges from the depth steps, along the motion of
each point, px."""


@dataclass(frozen=True)
class DepthDelay:
    """seconds: by which depth is older than colour; error_s: its standard error; share: of the lags that
    agree."""

    seconds: float
    error_s: float
    share: float

    @property
    def clear(self) -> bool:
        """Whether depth is clearly older or newer than colour."""
        return self._sure and abs(self.seconds) > TOLERATED_S + CLEAR_SIGMAS * self.error_s

    @property
    def none(self) -> bool:
        """Whether depth and colour are clearly of the same time."""
        return self._sure and abs(self.seconds) < TOLERATED_S - TOGETHER_SIGMAS * self.error_s

    @property
    def _sure(self) -> bool:
        return self.share >= MAJORITY

    def said(self) -> str:
        """The delay and its consequence, in a sentence."""
        way, ms = "older" if self.seconds > 0 else "newer", 5 * round(abs(self.seconds) / 0.005)
        return f"Depth is about {ms} ms {way} than colour: what moves is not where its pose has it."


def edge_lag(contours: Contours, T_cam_obj: Float64, velocity: Float64, frame: RgbdFrame) -> EdgeLag | None:
    """The lag of the edges of an object with a pose (4, 4) and a velocity (6,), a twist per second about its
    origin in camera axes; None if it is too slow, or if depth has a step at too little of its outline."""
    points, out = (one[::2] for one in contours.at(T_cam_obj))
    p = points.astype(np.float64) @ T_cam_obj[:3, :3].T + T_cam_obj[:3, 3]
    if len(p) < FEWEST or p[:, 2].min() < NEAR_M:
        return None
    pixels = frame.camera.project(p)
    moving = velocity[:3] + np.cross(velocity[3:], p - T_cam_obj[:3, 3])
    flow = (frame.camera.project(p + 1e-3 * moving) - pixels) / 1e-3
    speed = float(np.sqrt((flow**2).sum(1).mean()))
    if not speed >= SLOWEST_PX_S:
        return None
    across = frame.camera.project(p + 1e-3 * (out @ T_cam_obj[:3, :3].T)) - pixels
    across /= np.linalg.norm(across, axis=1, keepdims=True) + 1e-12
    last = np.array([frame.camera.width - 1.0, frame.camera.height - 1.0])
    inside = ((pixels >= _WIDTH_PX + 2) & (pixels <= last - _WIDTH_PX - 2)).all(1)
    pixels, across, flow, far = pixels[inside], across[inside], flow[inside] / speed, p[inside, 2]
    x = pixels[:, :1] + _PLACES * across[:, :1]
    y = pixels[:, 1:] + _PLACES * across[:, 1:]
    depth = frame.depth[np.rint(y).astype(np.intp), np.rint(x).astype(np.intp)]
    at, found = _steps_of_depth(depth, far)
    if np.count_nonzero(found) < FEWEST:
        return None
    edges = _edges(frame, x[found].astype(np.float32), y[found].astype(np.float32))
    along = (across[found] * flow[found]).sum(1)
    fit = edges.at(at[found] + _SHIFTS[:, None] * along).mean(1)
    best = int(np.argmax(fit))
    right, down = flow.mean(0)
    return speed, float(right), float(down), float(_SHIFTS[best])


def delay(lags: Sequence[EdgeLag], blocks: Sequence[str]) -> DepthDelay | None:
    """The delay on which lags agree; a common shift by registration is estimated with it. blocks: of each
    lag; errors within a block are correlated. None if there are too few."""
    number = len(set(blocks))
    if len(lags) < LEAST_LAGS or number < LEAST_BLOCKS:
        return None
    rows = np.array(lags)
    A, y = rows[:, :3], rows[:, 3]
    usual = np.diag([0.0, 1.0, 1.0]) * (FITS_PX / USUAL_SHIFT_PX) ** 2
    x = np.zeros((len(_STARTS_S), 3))
    x[:, 0] = _STARTS_S
    # Cauchy weights: a lag that is far off counts little, so the fit starts from several values.
    for _ in range(_STEPS):
        weight = 1.0 / (1.0 + ((y - x @ A.T) / FITS_PX) ** 2)
        weighted = weight[:, :, None] * A
        x = np.linalg.solve(A.T @ weighted + usual, (weighted * y[:, None]).sum(1)[..., None])[..., 0]
    off = (y - x @ A.T) / FITS_PX
    cost = np.log1p(off**2).sum(1) + 0.5 * ((x @ usual) * x).sum(1) / FITS_PX**2
    best = int(np.argmin(cost))
    r = off[best]
    bend = (1.0 - r**2) / (1.0 + r**2) ** 2
    hessian = (A * bend[:, None]).T @ A + usual
    if np.linalg.eigvalsh(hessian)[0] <= 0.0:
        return None
    pull = A * (FITS_PX * r / (1.0 + r**2))[:, None]
    _, which = np.unique(np.asarray(blocks), return_inverse=True)
    together = np.zeros((number, 3))
    np.add.at(together, which, pull)
    inverse = np.linalg.inv(hessian)
    covariance = inverse @ (together.T @ together) @ inverse * number / (number - 3)
    # The error on one side of an outline persists for a while: a block is worth one lag.
    alone = np.linalg.inv((A * weight[best][:, None]).T @ A * (number / len(A)) + usual) * FITS_PX**2
    error_s = float(np.sqrt(max(covariance[0, 0], alone[0, 0])))
    return DepthDelay(float(x[best, 0]), error_s, float((np.abs(r) <= 2.0).mean()))


def _steps_of_depth(depth: Float32, far: Float64) -> tuple[Float64, Bool]:
    """For lines (N, K) of depth that run from inside to outside, with the object at distance (N,): position
    (N,) of the depth step nearest to the pose's outline, px, and whether there is one (N,)."""
    at, found = np.full(len(depth), np.inf), np.zeros(len(depth), bool)
    own = (depth > 0.0) & (np.abs(depth - far[:, None]) < STEP_M)
    for gap in range(1, GAP_PX + 1):
        step = own[:, :-gap] & (depth[:, gap:] > depth[:, :-gap] + STEP_M)
        for k in range(1, gap):
            step &= depth[:, k : k - gap] <= 0.0
        place = _PLACES[:-gap] + 0.5 * gap
        nearest = np.where(step, np.abs(place), np.inf).argmin(1)
        better = step.any(1) & (np.abs(place[nearest]) < np.abs(at))
        at, found = np.where(better, place[nearest], at), found | better
    return at, found


def _edges(frame: RgbdFrame, x: Float32, y: Float32) -> EdgesAcross:
    """Strength of the colour edges at positions (N, K) along lines."""
    left, top = int(x.min()) - 2, int(y.min()) - 2
    part = frame.color[top : int(y.max()) + 4, left : int(x.max()) + 4]
    smooth = cv2.GaussianBlur(part, (3, 3), 0.8)
    colors = cv2.remap(smooth, x - left, y - top, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    values = opponents_of_bytes(np.asarray(colors, np.uint8))
    strength = np.zeros(x.shape, np.float32)
    strength[:, 1:-1] = np.linalg.norm(values[:, 2:] - values[:, :-2], axis=2)
    strength /= strength.mean(1, keepdims=True) + FAINT
    return EdgesAcross(strength.astype(np.float64), _WIDTH_PX, 1.0)
