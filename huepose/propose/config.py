"""How much is spent on proposing poses by view."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class RetrievalConfig:
    """Which views are looked at, and how closely.

    views: different views that a frame's masks give together. closer: templates a mask that get the close
    look; closest: of these, how many are tried a cell to each side as well. Origin: chosen by recall in piles
    (`huepose eval estimate`): 700 and 80 of them, with fewer poses searched, lose three points there.

    quick_weight: what the score of the quick look counts beside that of the close look. Origin: chosen.

    ranked: templates a mask that may become views. apart_deg: rotations of two views differ by this much at
    least: the directions of the templates are 16 degrees apart, so a neighbour is the same view.
    """

    views: int = 30
    closer: int = 1500
    closest: int = 200
    quick_weight: float = 0.5
    ranked: int = 300
    apart_deg: float = 18.0


@dataclass(frozen=True)
class EvidenceConfig:
    """How candidate masks are believed, and how many points are taken from them.

    fitting_iou: a mask whose bounds overlap the box by this IoU fits as well as can be expected: a true mask
    does so in a box that is shifted and scaled by a tenth. least_trust: of a mask that does not fit at all.
    Origin: chosen.

    mask_points, box_points: surface points for registration, of a mask and of the whole box.

    reach: how far the crop goes beyond a mask, in diameters at the mask's depth, so that the object lies in
    it whole; an end of a thin object alone would need 1.0. Origin: chosen.
    """

    fitting_iou: float = 0.75
    least_trust: float = 0.05
    mask_points: int = 400
    box_points: int = 800
    reach: float = 0.7
