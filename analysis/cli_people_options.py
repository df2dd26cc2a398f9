"""Options of the commands that can fit the hierarchical version, where people differ."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from models.person_offset import PersonOffset

PeopleDifferOption = Annotated[
    bool, typer.Option("--people-differ", help="Hierarchical: each person has an offset on the helping log-odds.")
]
PersonScaleOption = Annotated[
    float | None, typer.Option(metavar="1.5", help="Prior scale of the offsets' standard deviation, log-odds.")
]
PersonNodesOption = Annotated[
    int | None, typer.Option(metavar="N", help="Quadrature nodes over the offsets; by the data if not given.")
]


def person_offset(people_differ: bool, scale: float | None, nodes: int | None = None) -> PersonOffset | None:
    """The offset these options ask for, None where people do not differ.

    Raises
    ------
    InputError
        On a scale or nodes without ``--people-differ``.
    """
    from models.person_offset import PersonOffset

    refuse_without(people_differ, "--people-differ", {"--person-scale": scale, "--person-nodes": nodes})
    if not people_differ:
        return None
    return PersonOffset(PersonOffset.scale if scale is None else scale, nodes)


def refuse_without(condition: bool, wanted: str, given: dict[str, float | None]) -> None:
    """Refuse options that mean nothing without another one; `given` maps their names to their values."""
    from models.errors import located

    for option, value in given.items():
        if value is not None and not condition:
            raise located(option, value, f"{wanted} with it: it means nothing otherwise")
