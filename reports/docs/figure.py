"""The figure of the README and the first page: ``python reports/docs/figure.py`` (some minutes the first time).

Three panels, drawn by the package's own functions from the bundled, simulated study: what helping changes, which
tables are knowledge, and what plans are worth given the doubt.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from analysis.causal import causal_effects
from analysis.datasets import load, log_digest
from analysis.figures.contraction import contraction_dots
from analysis.figures.effects import effect_by_round
from analysis.figures.notebook import panels
from analysis.figures.robust import plan_comparison
from analysis.figures.style import to_svg
from analysis.fits import stored_fit
from analysis.policy_study import STUDY2
from analysis.uncertainty import KNOWN, PARTLY, contraction
from models.baum_welch import BaumWelch
from models.nuts import NutsSettings
from models.planning.schedule import Schedule
from models.robust.candidates import standard_candidates
from models.robust.own_plans import own_plans
from models.robust.pricing import price

OUT = Path(__file__).parent / "pages" / "workbench.svg"
STATES = 4


def draw(sampler: NutsSettings, restarts: int = 200) -> str:
    """The figure as SVG.

    Parameters
    ----------
    sampler : NutsSettings
    restarts : int
        Of Baum-Welch, whose estimate is the plan "plug-in".
    """
    data = load("simulated_study1")
    posterior = stored_fit(data.log, log_digest(data.log), STATES, sampler=sampler).posterior
    effects = causal_effects(posterior, data.log, kind=data.card.kind)
    study = Schedule.of(posterior.draws(), STUDY2)
    estimate = BaumWelch(STATES, restarts=restarts).fit(data.log).model
    prices = price(
        study, standard_candidates(study, plug_in=estimate), optima=own_plans(study).values,
        chains=posterior.gate.chains,
    )  # fmt: skip
    left, middle, right = panels(3.7, 3.7, 4.9, height=3.5)
    effect_by_round(effects.of("help"), scale=effects.scale, unit=effects.unit, limits=(-15, 35), ax=left)
    contraction_dots(contraction(posterior).table, known=KNOWN, partly=PARTLY, ax=middle)
    plan_comparison(prices, ax=right)
    figure = left.get_figure(root=True)
    assert figure is not None
    figure.suptitle("SIMULATED people", x=0.995, ha="right", fontsize=8, color="#5b6470")
    middle.set_ylabel("")
    for ax, words in (
        (left, "What does a robot that always helps change?"),
        (middle, "Which entries of the model are knowledge?"),
        (right, "What is each plan worth, given the doubt?"),
    ):
        ax.set_title(words, fontsize=9.5, fontweight="bold", loc="left", pad=36)
    return to_svg(left)


if __name__ == "__main__":
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--out", type=Path, default=OUT, help="file to write")
    options.add_argument("--fast", action="store_true", help="few draws, to see that it works")
    chosen = options.parse_args()
    settings = NutsSettings(draws=200, tune=200, chains=2) if chosen.fast else NutsSettings()
    chosen.out.write_text(draw(settings, 20 if chosen.fast else 200) + "\n", encoding="utf-8")
