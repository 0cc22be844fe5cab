"""The usual total and light of a tracked object, learnt from frames that support its pose. An object that
fits worse than usual, or has another colour, may be another one."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import log

import numpy as np

from huepose.geometry.arrays import Float64
from huepose.judge.terms import Terms
from huepose.tracking.evidence import LEAST_SEEN, OPEN
from huepose.tracking.looks import LOOK_S, share

BASELINE_SHARE, LIGHT_SHARE = 0.15, 0.2
"""Weights of a look in the running means of the usual total and of the light."""

FORGOTTEN_PER_S = 0.25
"""How fast the total required of a returning object falls, per second: the light may have changed."""

SAME_LIGHT, OTHER_LIGHT, OTHER_THING = 2.0, 10.0, 25.0
"""Standard deviations of a change of the offset in the two chromatic opponent channels: of an object in the
same light, of an object in another light, and of another object. Origin: true poses in pairs of frames,
recorded ones in one light (0.2 to 4) and path-traced or rendered ones in changed light (5 to 15); what was
taken for an object (15 to 50)."""

LIGHT_CHANGES = 0.2
"""Probability that the light changed while the object was not followed. Assumed."""


@dataclass(frozen=True, eq=False)
class Usual:
    """baseline: the usual total; light (3,): the light's offset in opponent colours; sure_light (3,): the
    light when the object was last TRACKING. None if not known."""

    baseline: float | None = None
    light: Float64 | None = None
    sure_light: Float64 | None = None

    def after(self, terms: Terms, sure: bool = False, apart_s: float = LOOK_S) -> Usual:
        """After a frame with these terms that supports the pose, `apart_s` seconds after the last one; sure:
        the object is TRACKING in it. The total of an occluded or overexposed object never lowers the usual
        total."""
        baseline, light = self.baseline, self.light
        if baseline is None:
            baseline = terms.total
        elif (terms.hidden < OPEN and terms.colored >= LEAST_SEEN) or terms.total > baseline:
            baseline += share(BASELINE_SHARE, apart_s) * (terms.total - baseline)
        if terms.colored >= LEAST_SEEN:
            seen = np.array(terms.light)
            light = seen if light is None else light + share(LIGHT_SHARE, apart_s) * (seen - light)
        return Usual(baseline, light, light if sure else self.sure_light)

    def confirmed(self, terms: Terms) -> Usual:
        """After perception agreed with the pose of a frame with these terms: their total is the usual one,
        unless the object is occluded."""
        return replace(self, baseline=terms.total) if terms.hidden < OPEN else self

    def remembered(self, seconds: float) -> Usual:
        """`seconds` after the object was last seen: a lower total is required."""
        if self.baseline is None:
            return self
        return replace(self, baseline=self.baseline - FORGOTTEN_PER_S * max(0.0, seconds))

    def same_color(self, terms: Terms) -> float:
        """Log-odds, 0 at most, that this is the object whose light was known before, not another one, by the
        change of that light.

        >>> from dataclasses import replace
        >>> from huepose.judge.terms import NOTHING
        >>> seen, known = replace(NOTHING, colored=0.8, light_rg=40.0), Usual(sure_light=np.zeros(3))
        >>> known.same_color(seen) < -6.0, known.same_color(replace(seen, light_rg=5.0))
        (True, 0.0)
        >>> Usual().same_color(seen)
        0.0
        """
        light = self.sure_light
        if light is None or terms.colored < LEAST_SEEN:
            return 0.0
        square = float((terms.light_rg - light[1]) ** 2 + (terms.light_yb - light[2]) ** 2)

        def log_density(sigma: float, share: float) -> float:
            return log(share) - 2.0 * log(sigma) - 0.5 * square / sigma**2

        stays, changes = log_density(SAME_LIGHT, 1.0 - LIGHT_CHANGES), log_density(OTHER_LIGHT, LIGHT_CHANGES)
        return min(float(np.logaddexp(stays, changes)) - log_density(OTHER_THING, 1.0), 0.0)
