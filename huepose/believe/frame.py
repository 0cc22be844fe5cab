"""The probability that a pose in a frame is right: a logistic of the judge's terms, without any mask, lowered
where hardly any of the surface is found, or where its colour is one that no light explains.

The weights are fitted on poses that tracking reached in rendered sequences (`believe.logistic`).
"""

from __future__ import annotations

from math import log1p

from huepose.believe.logistic import belief
from huepose.colorpair.opponents import SCALE
from huepose.geometry.arrays import Float64
from huepose.judge.color_correlation import PLAIN
from huepose.judge.kernel import MARGIN, SEEN_IN_COLOR
from huepose.judge.open_region import BLIND
from huepose.judge.terms import Terms
from huepose.judge.weights import DEFAULT_WEIGHTS

SLACK, HIDDEN_SLACK = 0.25, 0.3
"""In units of the judge's total: how far below the usual total is normal, and how much more per occluded
share of the surface."""

FEW = 0.1
"""Share of the surface visible in colour that counts half."""


LEAST_THERE, ABSENT = 0.1, 5.0
"""If less than LEAST_THERE of the surface is found, nothing supports the pose: its log-odds fall, by ABSENT
if none is found."""


MOST_LIGHT = 2.0
"""Natural logarithms: neither light nor a camera's white balance makes one channel seven times as strong as
another. Of 285 labelled objects in real and path-traced frames, some under coloured lamps, the most is 1.7. A
larger difference is another colour, not another light."""

LIGHT_STEP = 0.5
"""Natural logarithms beyond MOST_LIGHT at which another colour is certain. Such a difference counts as
another colour beside an outline as well (`judge.borders`)."""


def unread(terms: Terms) -> float:
    """In 0..1: how much of the evidence of the colours is missing, since the image is overexposed where depth
    shows the surface, and the rest is too little.

    >>> from dataclasses import replace
    >>> from huepose.judge.terms import NOTHING
    >>> [round(unread(replace(NOTHING, seen=0.9, colored=c)), 2) for c in (0.9, 0.4, 0.1, 0.0)]
    [0.0, 0.11, 0.44, 1.0]
    """
    bright = 1.0 - min(terms.colored / terms.seen, 1.0) if terms.seen > 0.0 else 0.0
    return bright * (1.0 - _color_weight(terms))


def features(
    terms: Terms,
    baseline: float | None,
    goes_on: float,
    light: Float64 | None = None,
    unread: float = 0.0,
) -> dict[str, float]:
    """The evidence for a pose by name; the larger, the better. baseline: its usual total, or None; goes_on:
    share of the outline beyond which surface and colour go on; light (3,): the known offset of the light in
    opponent colours, or None; unread: the share of its colours that is assumed unchanged (`unread`)."""
    # Without visible colour it is not known how much contrast there would be.
    possible = terms.contrast / (terms.contrast + PLAIN) if terms.colored > SEEN_IN_COLOR else 1.0
    drop = 0.0
    if baseline is not None:
        missed = DEFAULT_WEIGHTS.color * unread
        drop = max(0.0, baseline - terms.total - SLACK - HIDDEN_SLACK * terms.hidden - missed)
    other_light = 0.0
    if light is not None:
        other_light = float(max(abs(terms.light_rg - light[1]), abs(terms.light_yb - light[2])))
    there = _found_share(terms)
    through = terms.through * (terms.seen + MARGIN) / max(1.0 - terms.through, 1e-6)
    return {
        "explained": there / (there + through + MARGIN),
        "color": -max(possible - _color_weight(terms) * terms.color, 0.0) * (1.0 - unread),
        "no_drop": -drop,
        "ends": -goes_on,
        "texture": _color_weight(terms) * terms.color * log1p(terms.contrast),
        "light": -_color_weight(terms) * other_light,
    }


def log_odds(
    terms: Terms,
    baseline: float | None,
    goes_on: float,
    light: Float64 | None = None,
    unread: float = 0.0,
) -> float:
    """Log-odds that the pose is right, without a prior. Arguments as in `features`."""
    x = belief("frame").log_odds(features(terms, baseline, goes_on, light, unread))
    return x - ABSENT * max(1.0 - min(_found_share(terms) / LEAST_THERE, 1.0), _of_another_color(terms))


def _found_share(terms: Terms) -> float:
    """Share of the surface that depth confirms, or colour where there is no depth."""
    return terms.seen + BLIND * terms.blind


def _color_weight(terms: Terms) -> float:
    """In 0..1: the weight of the colours."""
    return terms.colored / (terms.colored + FEW)


def _of_another_color(terms: Terms) -> float:
    """In 0..1: whether the image has a colour that no light makes of the texture, where enough of it is
    visible."""
    light = max(abs(terms.light_rg), abs(terms.light_yb)) / SCALE
    return _color_weight(terms) * min(max((light - MOST_LIGHT) / LIGHT_STEP, 0.0), 1.0)
