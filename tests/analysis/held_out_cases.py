"""Small studies and forecasters for the tests of what was left out."""

from __future__ import annotations

from functools import cache

from analysis.held_out_latent import LatentForecaster
from analysis.held_out_rivals import rivals
from analysis.simulate import simulate_study1
from models.model_draws import ModelDraws
from models.nuts import NutsSettings
from models.parameters import STICKY
from tests.analysis.posterior_cases import posterior_of

SHORT = NutsSettings(150, 150, 2)


@cache
def study():
    return simulate_study1(participants=160, seed=3)


def forecaster_of(models, rest, pins=None):
    """A forecaster whose draws are given models."""
    return LatentForecaster(
        posterior_of(models), rest, ModelDraws.from_models(models), STICKY, pins or {}
    )  # fmt: skip


def learned(log, kind, draws=2000):
    """A counting rival that has learned from a log."""
    return next(c for c in rivals(1.0, draws, 1) if c.kind == kind).learn(log)
