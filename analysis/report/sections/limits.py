"""Section: what the report does not show, from the data card and from what the likelihood cannot tell."""

from __future__ import annotations

from analysis.report.context import ReportContext
from analysis.report.section import Block, Origin, Part, Points, Text
from analysis.wording import counted


def make(context: ReportContext) -> tuple[Block, ...]:
    """Limits of the data, of the method, and of every fitted model."""
    blocks: list[Block] = []
    if context.data.card.what_not:
        blocks.append(Points(context.data.card.what_not, "What the data set is not, according to its card"))
    blocks.append(Points(tuple(_standing(context)), "What holds for every report of this kind"))
    study = context.study
    shown = context.shown_states
    for k in sorted(study.states, key=lambda k: (k not in shown, -k)):
        title = f"The model with {counted(k, 'state')}"
        sentences = tuple(study.identifications[k].sentences())
        body: Block = (
            Points(sentences) if sentences else Text("Nothing was found to be wrong with its identification.")
        )
        blocks.append(Part(title, f"limits-{k}", (body,), folded=k not in shown))
    return tuple(blocks)


def _standing(context: ReportContext) -> list[str]:
    out = []
    if context.origin is Origin.SIMULATED:
        out.append(
            "The data are simulated: nothing here says anything about people. What can be judged is whether the "
            "method finds again what was put in."
        )
    elif context.origin is Origin.UNSTATED:
        out.append(
            "Nothing states whether these people are real, so nothing here may be quoted as a finding about people."
        )
    else:
        out.append(
            "The people are those of one study. Latent states summarise how their responses hang together; they "
            "are not measured traits, and calling one of them prosocial is an interpretation."
        )
    out.append(
        "The authors' raw data are not part of this project. Numbers marked as printed in the paper are of other "
        "data and stand beside for orientation; agreement with them is no replication."
    )
    out.append(
        "Baum-Welch gives one point estimate. Its bootstrap intervals assume that the model and its number of "
        "states are right, so they are a lower bound of the doubt."
    )
    out.append(
        "AIC and BIC compare models on the data they were fitted to, and count responses as if each came from "
        "somebody else. How well people are predicted who were left out is the stronger test."
    )
    if context.pins:
        out.append(
            "Holding a transition table fixed leaves the fit to the responses as it was wherever the table cannot "
            "be told from the others, but it changes what plans are worth."
        )
    if context.effort.quick:
        out.append(
            "This is a quick report: fewer restarts, fewer bootstrap replicates. Optima may have been missed; it "
            "is not for citation."
        )
    return out
