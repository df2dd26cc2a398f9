"""Options of the commands that plan: what rounds are worth, and the draws that plans under doubt are made from."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Annotated

import typer

from analysis.cli_options import load_protocol
from models.errors import located

if TYPE_CHECKING:
    from analysis.draws_source import DrawsSource

# -- what rounds are worth ---------------------------------------------------------------------------
RewardSteepness = Annotated[
    float | None, typer.Option("--r", help="Steepness of the reward; the model's own, or .06, by default.")
]
CostOption = Annotated[
    list[str] | None,
    typer.Option("--cost", metavar="ACTION=X", help="Cost of an action, in the unit of the reward."),
]
CostHelpOption = Annotated[float | None, typer.Option("--cost-help", help="Cost of helping; 15 by default.")]
CostSignalOption = Annotated[float | None, typer.Option("--cost-signal", help="Cost of a signal; 15 by default.")]
PrecisionOption = Annotated[
    float, typer.Option("--precision", help="Relative gap between the bounds at which solving stops.")
]

# -- draws -------------------------------------------------------------------------------------------
FitArgument = Annotated[
    str, typer.Argument(metavar="FIT", help="A fit (.nc), or JSON: a list of models, each with a weight.")
]
DrawsOption = Annotated[
    int | None, typer.Option("--draws", metavar="N", help="So many evenly spaced draws; all by default.")
]
AllowUnseenOption = Annotated[
    bool, typer.Option("--allow-unseen", help="Keep actions that the data hold no evidence on.")
]
ForceOption = Annotated[bool, typer.Option("--force", help="Use a fit that failed its convergence gate.")]
GroupOption = Annotated[
    str | None, typer.Option("--group", metavar="LABEL", help="Where tables differ between groups: whose.")
]
PersonOption = Annotated[
    float | None,
    typer.Option("--person", metavar="Z", help="Where people differ: whom, in standard deviations; 0 the median."),
]


def costs_of(options: list[str] | None, named: dict[str, float | None] | None = None) -> dict[str, float | None]:
    """Costs by action from ``ACTION=X`` options, beside those that have an option of their own.

    Raises
    ------
    InputError
        On what is no ``ACTION=X``, or an action whose cost is given twice.
    """
    out = {name: value for name, value in (named or {}).items() if value is not None}
    for option in options or ():
        name, sign, text = option.partition("=")
        try:
            value = float(text)
        except ValueError:
            sign = ""
        if not sign or not name:
            raise located("--cost", option, "ACTION=X, such as help=10")
        if name in out:
            raise located("--cost", option, f"the cost of {name} once")
        out[name] = value
    return dict(out)


def check_tail(alpha: float) -> None:
    """Refuse a share of the draws that is none.

    Raises
    ------
    InputError
        On anything but a number above 0 and up to 1.
    """
    if not 0 < alpha <= 1:
        raise located("--alpha", alpha, "a share of the draws above 0 (1: all of them)")


def draws_asked(
    fit: str, *, draws: int | None, allow_unseen: bool, force: bool, group: str | None, person: float | None,
    people: bool, r: float | None, cost_help: float | None, cost_signal: float | None, cost: list[str] | None,
    protocol: str | None,
) -> DrawsSource:  # fmt: skip
    """The draws that a command's options ask for; what a reader has to know of them goes to standard error.

    Parameters
    ----------
    fit, draws, allow_unseen, force, group, person, r, cost_help, cost_signal, cost, protocol
        As the options say.
    people : bool
        Whether the command takes all kinds of people together where people differ and no person is named.
    """
    from analysis.draws_source import read_draws

    source = read_draws(
        fit, draws=draws, allow_unseen=allow_unseen, force=force, group=group, person=person, people=people, r=r,
        costs=costs_of(cost, {"help": cost_help, "signal": cost_signal}),
        protocol=load_protocol(protocol) if protocol else None,
    )  # fmt: skip
    for warning in source.warnings:
        print(f"prosocial: {warning}", file=sys.stderr)
    return source
