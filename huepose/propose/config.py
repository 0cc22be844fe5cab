"""Settings of the view templates and of the crop they are compared with."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class RetrievalConfig:
    """How many templates reach each stage of the view retrieval (`propose.views`).

    views: hypotheses returned for all masks together. closer: templates per mask that get the close look.
    closest: best of these per mask, which are also tried one cell to each side. Both chosen by recall in
    piles (`huepose eval estimate`): 700 and 80, with fewer poses searched, lose three points there.
    quick_weight: weight of the quick look's score, added to the close look's. Chosen. ranked: best templates
    per mask that may become hypotheses. apart_deg: least angle between the rotations of two hypotheses.
    Template directions are 16 degrees apart, so that neighbours count as the same view.
    """

    views: int = 30
    closer: int = 1500
    closest: int = 200
    quick_weight: float = 0.5
    ranked: int = 300
    apart_deg: float = 18.0


@dataclass(frozen=True)
class EvidenceConfig:
    """How candidate masks are weighted, and how the crop is cut (`propose.evidence`).

    fitting_iou: IoU of a mask's bounds and the box from which the mask gets full weight. A true mask reaches
    it in a box that is shifted and scaled by a tenth. Chosen. least_trust: weight of a mask that does not
    overlap the box at all. Chosen. mask_points, box_points: surface points sampled for registration from each
    mask and from the whole box. reach: margin of the crop around a mask, in object diameters at the mask's
    depth, so that the whole object lies in the crop. A mask of only one end of a thin object would need 1.0.
    Chosen.
    """

    fitting_iou: float = 0.75
    least_trust: float = 0.05
    mask_points: int = 400
    box_points: int = 800
    reach: float = 0.7
