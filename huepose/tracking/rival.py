"""The best near-symmetric rotation of a pose in a frame, and by how much the pose leads it."""

from __future__ import annotations

import numpy as np

from huepose.geometry.arrays import Float64
from huepose.geometry.box import Box
from huepose.geometry.frame import RgbdFrame
from huepose.judge.decisive import decisive_balance
from huepose.judge.implied_light import implied_lights, shading_gains
from huepose.judge.open_region import PreparedSurface
from huepose.refine.photometric import COARSE, refine_all
from huepose.select.distinct import RIGHT
from huepose.select.shade import beyond_chance
from huepose.tracking.hypothesis import Hypothesis, same_pose
from huepose.tracking.refined import best_of, ranked, region_of
from huepose.tracking.subject import Subject

DECIDES, CONFIRMS = 0.3, 0.08
"""In units of a total: what it counts if all pixels that only one of two poses explains are on its side (7
log-odds), and the largest lead that they give. By 364 comparisons of a pose with its best near-symmetric
rotation (docs/tracking_measured.md). Alone and from one viewpoint they confirm no orientation: the other one
may be wrong as well."""

COARSELY, TRIES = 8, 3
"""The COARSELY best of the rotated poses are refined coarsely. Of those that do not converge to the pose
itself at most TRIES are refined fully, until one stays apart."""


def best_rival(
    subject: Subject, first: Hypothesis, turns: Float64, frame: RgbdFrame, light: Float64 | None
) -> Hypothesis | None:
    """The best of the pose's near-symmetric rotations `turns` (M, 4, 4), after refinement; None if the best
    of them converge to the pose itself."""
    surface = subject.surface
    region = region_of(surface, frame, first.T_cam_obj, light) if len(turns) else None
    if region is None:
        return None
    poses = ranked(surface, region, first.T_cam_obj @ subject.closer(turns))[0][:COARSELY]
    near = refine_all(surface, region, poses, COARSE, float(surface.centre_cam(first.T_cam_obj)[2]))
    apart = [T for T in near if not same_pose(subject, T, first.T_cam_obj, RIGHT)]
    for T in ranked(surface, region, np.array(apart))[0][:TRIES] if apart else ():
        found = best_of(surface, frame, [(T, "turn")], light, 0)
        if not same_pose(subject, found.T_cam_obj, first.T_cam_obj, RIGHT):
            return found
    return None


def lead(
    surface: PreparedSurface, first: Hypothesis, rival: Hypothesis, frame: RgbdFrame, decisive: float = 0.0
) -> float:
    """By how much of a total a pose is more probable than a near-symmetric rotation of it: the difference of
    their totals, each in the light that it implies, and `decisive` (`by_decisive_pixels`)."""
    gains = np.zeros(2)
    for k, pose in enumerate((first, rival)):
        region = region_of(surface, frame, pose.T_cam_obj, None)
        if region is not None:
            at = pose.T_cam_obj[None]
            lights = implied_lights(surface.arrays, region.arrays, at)
            gains[k] = shading_gains(surface.arrays, region.arrays, at, lights)[0]
    more = beyond_chance(gains[:1] - gains[1:])
    leads = float(first.terms.total - rival.terms.total + more[0])
    limit = max(abs(leads), CONFIRMS)
    return min(max(leads + decisive, -limit), limit)


def by_decisive_pixels(subject: Subject, first: Hypothesis, rival: Hypothesis, frame: RgbdFrame) -> float:
    """What the pixels that only one of two poses explains say for the first, in units of a total."""
    poses = first.T_cam_obj, rival.T_cam_obj
    around = [box for T in poses if (box := subject.surface.box(T, frame.camera)) is not None]
    if not around:
        return 0.0
    return DECIDES * decisive_balance(subject.mesh, *poses, Box.around(*around), frame)
