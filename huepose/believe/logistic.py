"""Probabilities: each is the logistic function of a constant plus a factor times each named term. All fitted
numbers are in one file, each with its origin.

`fits.json` has one entry for each question: `quality` (is the pose of a single frame right? by method),
`frame` (is a tracked pose right in this frame?), `presence` (is the object there at all?) and `place` (the
same for a rough pose). An entry has the `fit` and its `origin`: the command that writes it, the data and
their seeds."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from math import exp
from pathlib import Path
from typing import Any, Literal

import numpy as np

from huepose.geometry.arrays import Float64

MOST_LOG_ODDS = 30.0
"""Beyond it a probability is practically 0 or 1."""


@dataclass(frozen=True)
class Logistic:
    """constant: the log-odds where all terms are 0; factors: what a unit of each named term adds.

    >>> fair = Logistic(-2.0, {"depth": 4.0})
    >>> fair.log_odds({"depth": 0.5, "not asked": 9.0}), fair({"depth": 0.5})
    (0.0, 0.5)
    """

    constant: float
    factors: Mapping[str, float]

    def log_odds(self, known: Mapping[str, float]) -> float:
        """Log-odds for terms by name; terms without a factor do not count."""
        return self.constant + sum(factor * known[name] for name, factor in self.factors.items())

    def __call__(self, known: Mapping[str, float]) -> float:
        """The probability, 0..1."""
        return probability(self.log_odds(known))


def probability(log_odds: float) -> float:
    """The probability of log-odds, 0..1.

    >>> round(probability(np.log(3.0)), 2)
    0.75
    """
    return 1.0 / (1.0 + exp(-min(max(log_odds, -MOST_LOG_ODDS), MOST_LOG_ODDS)))


def probabilities(log_odds: Float64) -> Float64:
    """The probabilities of log-odds of any shape."""
    return np.asarray(1.0 / (1.0 + np.exp(-np.clip(log_odds, -MOST_LOG_ODDS, MOST_LOG_ODDS))))


Question = Literal["quality", "frame", "presence", "place"]

PATH = Path(__file__).with_name("fits.json")


@cache
def _entries() -> dict[str, Any]:
    return dict(json.loads(PATH.read_text()))


def fitted(question: Question) -> Mapping[str, Any]:
    """The fit for a question, as `write_fit` wrote it."""
    return dict(_entries()[question]["fit"])


@cache
def belief(question: Question) -> Logistic:
    """The fit for a question with one logistic: all but `quality`."""
    return Logistic(**fitted(question))


def write_fit(question: Question, fit: Mapping[str, Any]) -> None:
    """Write a fit into the package; its origin stays as written. For the commands of `studies`."""
    entries = json.loads(PATH.read_text())
    entries[question]["fit"] = fit
    PATH.write_text(json.dumps(entries, indent=1) + "\n")
