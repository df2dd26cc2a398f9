"""What a mixed model warns of: one named warning each, so that a study can silence one and keep the others."""

from __future__ import annotations


class MixedModelWarning(UserWarning):
    """A fit that must not be read without a second look."""


class SeparationWarning(MixedModelWarning):
    """Covariates predict the outcome perfectly, or within every group: parameters run off to infinity."""


class DroppedRowsWarning(MixedModelWarning):
    """A term of the formula is no number in rows whose values are all there, and they were left out."""


class FlatLikelihoodWarning(MixedModelWarning):
    """The likelihood at infinity is within reach of an interval, though lower than at the estimate."""


class CeilingWarning(MixedModelWarning):
    """A cell of the design has only successes or only failures."""


class BoundaryWarning(MixedModelWarning):
    """The standard deviation of the intercept is estimated at zero."""


class QuadratureWarning(MixedModelWarning):
    """The estimate depends on the number of quadrature nodes."""


class SeveralMaximaWarning(MixedModelWarning):
    """The likelihood has several maxima; the best one found is reported."""


class ConvergenceWarning(MixedModelWarning):
    """The search for the maximum did not end at one."""
