"""Section of a comparison: what it does not show, and its methods."""

from __future__ import annotations

from analysis.report.compared_context import Comparison
from analysis.report.section import Block, Part, Points, Text


def make(comparison: Comparison) -> tuple[Block, ...]:
    """What not to conclude, and the paragraph on methods."""
    items = [
        "A difference between two data sets is a difference between studies: who took part, how they were "
        "recruited, what was asked of them. Nothing here says which of these made it.",
        "Many differences are looked at at once and none is corrected for; the number expected by chance "
        "stands beside the number found.",
        "Bootstrap intervals assume that the model and its number of states are right; posterior intervals, "
        "that the prior is. Where a study hardly informs an entry, no difference will be found in it.",
    ]
    if comparison.effort.quick:
        items.append("This is a quick report: fewer restarts and replicates. It is not for citation.")
    methods = Part("Methods, ready to quote", "methods", (Text(comparison.methods, "quote"),))
    return (Points(tuple(items)), methods)
