"""Robust kernels: the weight in 0..1 of a residual, by its square in units of the kernel's scale.

Iteratively reweighted least squares (Holland and Welsch 1977): weights are taken at the present pose.
"""

from __future__ import annotations

from huepose.support.jit import jit


@jit
def tukey(square: float) -> float:
    """Tukey's biweight: nothing beyond the gate, so outliers have no say. square: (residual / gate)**2.

    >>> [tukey(s) for s in (0.0, 0.25, 1.0, 9.0)]
    [1.0, 0.5625, 0.0, 0.0]
    """
    return (1.0 - square) ** 2 if square < 1.0 else 0.0


@jit
def cauchy(square: float) -> float:
    """Cauchy's: a say for every residual, ever smaller. square: (residual / scale)**2.

    >>> [cauchy(s) for s in (0.0, 1.0, 9.0)]
    [1.0, 0.5, 0.1]
    """
    return 1.0 / (1.0 + square)
