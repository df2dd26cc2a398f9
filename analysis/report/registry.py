"""The sections of the report, in order. Adding one is a file in `sections/` and a line here."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from analysis.report.context import ReportContext
from analysis.report.section import Block, NotSupported, Section
from analysis.report.sections import (
    anova,
    comparison,
    evidence,
    flow,
    held_out,
    learned,
    limits,
    paper,
    people,
    plan,
    power,
    provenance,
    regression,
    reward,
    robust,
    safeguards,
    sensitivity,
    states,
    study,
    uncertainty,
)
from analysis.report.sections import study2 as study2_section

Make = Callable[[ReportContext], tuple[Block, ...]]


@dataclass(frozen=True)
class Entry:
    """A section to be made: `make` may raise `NotSupported`; any other exception fails the report."""

    key: str
    title: str
    make: Make

    def section(self, context: ReportContext) -> Section:
        """Make the section."""
        try:
            return Section(self.title, self.key, self.make(context))
        except NotSupported as error:
            return Section(self.title, self.key, omitted=error.reason)
        except Exception as error:
            error.add_note(f"while making section {self.key!r} of the report")
            raise


SECTIONS: tuple[Entry, ...] = (
    Entry("provenance", "Where these numbers come from", provenance.make),
    Entry("study", "The study: who responded how, and when", study.make),
    Entry("flow", "Participant flow", flow.make),
    Entry("states", "How many states?", states.make),
    Entry("model", "The learned model", learned.make),
    Entry("uncertainty", "How sure are we?", uncertainty.make),
    Entry("comparison", "Which model?", comparison.make),
    Entry("people", "Do people differ?", people.make),
    Entry("held-out", "What a model says of conditions it has not seen", held_out.make),
    Entry("regression", "The regression", regression.make),
    Entry("anova", "Analysis of variance", anova.make),
    Entry("power", "How many people?", power.make),
    Entry("reward", "The reward", reward.make),
    Entry("plan", "What the robot should do", plan.make),
    Entry("robust", "What the robot should do, given the doubt", robust.make),
    Entry("sensitivity", "What decisions depend on", sensitivity.make),
    Entry("safeguards", "What safeguards change, and who is influenced", safeguards.make),
    Entry("study2", "Study 2, run again in the game", study2_section.make),
    Entry("paper", "The paper's numbers beside ours", paper.make),
    Entry("evidence", "Can the method be trusted?", evidence.make),
    Entry("limits", "What this does not show", limits.make),
)
