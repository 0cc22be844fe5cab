"""That a pose in a frame is right: one logistic in what the judge sees at it, without any mask.

`frame_fit.json` holds the weights, as fitted on poses that tracking reached on drawn sequences.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib import resources

from huepose.judge.terms import Terms

SLACK, HIDDEN_SLACK = 0.25, 0.3
"""Of the judge's total: so much less than its baseline is usual, and more where something is in front."""

PLAIN = 4.0
"""Contrast (opponent units) at which half of the colour that there could be is texture."""

FEW = 0.1
"""Share of the surface seen in colour that counts half."""


def features(terms: Terms, hue: float, goes_on: float, baseline: float | None) -> dict[str, float]:
    """What speaks for a pose (the larger, the more), by name; where it is not seen, nothing."""
    heard = terms.colored / (terms.colored + FEW)
    possible = terms.contrast / (terms.contrast + PLAIN)
    drop = 0.0
    if baseline is not None:
        drop = max(0.0, baseline - terms.total - SLACK - HIDDEN_SLACK * terms.hidden)
    return {
        "depth_fit": terms.depth_fit,
        "not_through": 1.0 - terms.through,
        "color": heard * terms.color,
        "color_there": heard * min(terms.color - possible, 0.0),
        "hue": heard * hue,
        "ends": 1.0 - goes_on,
        "seen": min(terms.seen, 0.5),
        "not_outside": 1.0 - terms.outside,
        "no_drop": -drop,
    }


@dataclass(frozen=True)
class FrameFit:
    """constant, factors: of the log-odds, a factor for each of `features`."""

    constant: float
    factors: Mapping[str, float]

    def log_odds(self, terms: Terms, hue: float, goes_on: float, baseline: float | None) -> float:
        """That the pose is right, with nothing known beforehand."""
        known = features(terms, hue, goes_on, baseline)
        return self.constant + sum(factor * known[name] for name, factor in self.factors.items())


@cache
def frame_fit() -> FrameFit:
    """The calibrated weights."""
    text = resources.files("huepose.believe").joinpath("frame_fit.json").read_text()
    return FrameFit(**json.loads(text))
