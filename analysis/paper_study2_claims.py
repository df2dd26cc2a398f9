"""What the paper concludes from study 2, beside how often simulated studies lead to it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from analysis.paper_agreement import concluded, mostly, unchecked
from analysis.paper_numbers import NO_EVIDENCE, Basis, Check, Ours, PaperNumber
from analysis.printed_anova import MEASURES
from analysis.study2_claims import CLAIMS, MEASURED, Claim
from analysis.study2_evidence import decidable
from analysis.study2_learning import EM, TRUTH
from analysis.study2_policies import LS_POMDP, PAPER

TOPIC = "Study 2: conclusions"
PLACE, FIGURE = "Sec. V-A", "Fig. 4"
SECTION = "study2"

IN_ALL = "our policy achieves higher performance in all metrics … than all baselines"
"""What is said of the figure."""


def study2_claims(ours: Ours) -> list[PaperNumber]:
    """Rows on the conclusions, and on the figure they are read off."""
    content = ours.stored("study2")
    rows = [
        PaperNumber(TOPIC, PLACE, "conclusion", ours.published["claims"][claim.sentence], (_share(content, claim),))
        for claim in CLAIMS
        if claim.whole
    ]
    reason = unchecked("its values are not printed")
    return [
        *rows,
        PaperNumber(TOPIC, FIGURE, "what is said of it", IN_ALL, (_in_all(content),)),
        PaperNumber(TOPIC, FIGURE, "outcomes over nine rounds", "picture",
                    (Check("–", Basis.REPLICATIONS, reason, SECTION),)),
    ]  # fmt: skip


def _share(content: Mapping[str, Any] | None, claim: Claim) -> Check:
    """How many studies lead to a conclusion where the robot had learned from a study 1, as in the paper."""
    rows = {} if content is None else {
        r["learning"]: r for r in content["claims"] if r["planner"] == LS_POMDP and r["claim"] == claim.key
    }  # fmt: skip
    if content is None or EM not in rows:
        return Check("–", Basis.REPLICATIONS, unchecked(NO_EVIDENCE), SECTION)
    known = f"truth known: {rows[TRUTH]['share']:.1%} of studies" if TRUTH in rows else ""
    if not decidable(EM, claim):
        reason = unchecked("belief is on the scale of the robot's own model, so its fit decides")
        return Check(known or "–", Basis.REPLICATIONS, reason, SECTION)
    own = rows[EM]
    text = f"in {own['share']:.1%} of {content['settings'][EM]['replicates']:,} studies ({own['low']:.1%} to "
    text += f"{own['high']:.1%})" + (f"; {known}" if known else "")
    return Check(text, Basis.REPLICATIONS, mostly(own["share"], own["low"], own["high"]), SECTION)


def _in_all(content: Mapping[str, Any] | None) -> Check:
    """In which outcomes the policy's mean over all simulated people is the highest of the paper's five."""
    if content is None:
        return Check("–", Basis.REPLICATIONS, unchecked(NO_EVIDENCE), SECTION)
    mean = {(r["measure"], r["policy"]): r["mean"] for r in content["means"] if r["learning"] == EM}
    best = {key: max(PAPER, key=lambda policy: mean[key, policy]) for key in MEASURED}
    highest = [key for key, policy in best.items() if policy == LS_POMDP]
    told = "; ".join(f"{MEASURES[key]}: highest under {policy}" for key, policy in best.items())
    agreement = concluded(len(highest) == len(best), f"highest in {len(highest)} of {len(best)}")
    return Check(f"{told}, over all simulated people", Basis.REPLICATIONS, agreement, SECTION)
