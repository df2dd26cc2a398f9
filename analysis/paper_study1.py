"""Study 1 in the paper's numbers: its design, its people, its game, its power analysis."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from typing import Any

import numpy as np

from analysis.paper_agreement import Agreement, concluded, counted, follows, unchecked, written
from analysis.paper_numbers import Basis, Check, Ours, PaperNumber
from analysis.power_printed import PrintedSizes, printed_sizes
from models.game.layout import ROOMS
from models.game.parameters import TICKS_A_SECOND, GameParameters
from models.game.state import GROUP_SIZE

TOPIC = "Study 1: design, people, game"
HUMAN_SUBJECTS, DESIGN = "Sec. IV-A, Human Subjects", "Sec. IV-A, Experimental Design"


def study1_numbers(ours: Ours) -> list[PaperNumber]:
    """Rows on design, people, game and power of study 1."""
    return [
        *_design(ours),
        *_people(ours),
        *_game(ours),
        *power_rows(ours.published, "study1", HUMAN_SUBJECTS, TOPIC),
    ]


def _of_log(ours: Ours, printed: object, found: object, told: str) -> Check:
    """A count in the data; where they were drawn to the printed design, equality is no finding."""
    return Check(told, Basis.DATA, counted(printed, found, taken_over=ours.simulated), "study")


def _design(ours: Ours) -> list[PaperNumber]:
    study, log = ours.published["study1"], ours.log
    conditions = study["conditions"]
    rows = []
    summed, told = sum(conditions.values()), study["demographics"]
    people = log.n_participants
    rows.append(
        PaperNumber(
            TOPIC, DESIGN, "participants", str(study["participants"]),
            (
                Check(f"{summed}, sum of the conditions", Basis.PRINTED,
                      follows(study["participants"], summed), "study"),
                Check(f"{told['male'] + told['female']}, men and women", Basis.PRINTED,
                      follows(study["participants"], told["male"] + told["female"]), "study"),
                _of_log(ours, study["participants"], people, f"{people:,}"),
            ),
        )
    )  # fmt: skip
    for name, printed in conditions.items():
        found = len(np.unique(log.participant[log.condition == log.conditions.index(name)]))
        rows.append(
            PaperNumber(TOPIC, HUMAN_SUBJECTS, f"people, {name}", str(printed),
                        (_of_log(ours, printed, found, f"{found:,}"),))
        )  # fmt: skip
    lengths = sorted({int(n) for n in np.diff(log.offsets)})
    found_rounds = lengths[0] if len(lengths) == 1 else tuple(lengths)
    rows.append(
        PaperNumber(TOPIC, DESIGN, "rounds", str(study["rounds"]),
                    (_of_log(ours, study["rounds"], found_rounds, " or ".join(map(str, lengths))),))
    )  # fmt: skip
    found_schedules = sorted(set(log.schedules()))
    rows.append(
        PaperNumber(TOPIC, DESIGN, f"{len(study['sequences'])} sequences", ", ".join(study["sequences"]),
                    (_of_log(ours, sorted(study["sequences"]), found_schedules, ", ".join(found_schedules)),))
    )  # fmt: skip
    return rows


def _people(ours: Ours) -> list[PaperNumber]:
    study = ours.published["study1"]
    told = study["demographics"]
    rows = []
    for sex, other in (("male", "female"), ("female", "male")):
        left = study["participants"] - told[other]
        rows.append(
            PaperNumber(
                TOPIC, HUMAN_SUBJECTS, f"people who identify as {sex}", str(told[sex]),
                (Check(f"{left}, the others", Basis.PRINTED, follows(told[sex], left), "study"),), "men and women",
            )
        )  # fmt: skip
    return rows + [not_recorded(TOPIC, HUMAN_SUBJECTS, name, text) for name, text in ages_and_payment(told)]


def ages_and_payment(told: Mapping[str, Any]) -> list[tuple[str, str]]:
    """What is printed of people and is in no data here: quantity and printed number."""
    names = {"age_min": "youngest, years", "age_max": "oldest, years", "age_mean": "mean age, years",
             "age_sd": "standard deviation of age, years"}  # fmt: skip
    out = [(name, f"{told[key]:g}") for key, name in names.items() if key in told]
    return [*out, ("payment", f"${told['payment_usd']:g}")]


def not_recorded(topic: str, place: str, quantity: str, printed: str) -> PaperNumber:
    """A row on what no data here hold."""
    reason = unchecked("not recorded here")
    return PaperNumber(topic, place, quantity, printed, (Check("–", Basis.DATA, reason, "provenance"),))


def _game(ours: Ours) -> list[PaperNumber]:
    printed, own = ours.published["study1"]["game"], GameParameters()
    entries = {
        "rooms": ("rooms", ROOMS, ""),
        "tokens_per_group": ("tokens in a group", GROUP_SIZE, ""),
        "robot_cells_per_second": ("speed of the robot", TICKS_A_SECOND / own.robot_step_ticks, " cells a second"),
        "trap_seconds": ("trap after", own.trap_tick / TICKS_A_SECOND, " s"),
        "robot_help_delay_seconds": ("a helping robot sets off after", own.robot_help_delay / TICKS_A_SECOND, " s"),
    }
    rows = []
    for key, (name, value, unit) in entries.items():
        check = Check(f"{value:g}{unit}", Basis.PROJECT, counted(printed[key], value, taken_over=True), "study2")
        rows.append(PaperNumber(TOPIC, DESIGN, name, f"{printed[key]:g}{unit}", (check,)))
    reason = unchecked("it has no numbers")
    rows.append(
        PaperNumber(TOPIC, "Fig. 2", "the game", "picture",
                    (Check("a map of this project", Basis.PROJECT, reason, "study2"),))
    )  # fmt: skip
    return rows


@cache
def _sizes() -> PrintedSizes:
    """The comparison with formulas; it takes no data."""
    return printed_sizes()


def power_rows(published: Mapping[str, Any], study: str, place: str, topic: str) -> list[PaperNumber]:
    """Rows on a study's power analysis, by the formulas for the tests that it could have meant.

    The printed minimum agrees if one of them asks for exactly as many; otherwise it cannot be checked, since test,
    correlation and sphericity are not printed.
    """
    printed = published[study]["power"]
    found = _sizes()
    given = found.settings.set_index("study").loc[study]
    table = found.table[found.table["study"] == study]
    names = {"f": "effect size f", "alpha": "α", "power": "power wanted"}
    rows = [
        PaperNumber(
            topic, place, f"power analysis, {name}", f"{printed[key]:g}",
            (Check(f"{given[key]:g}", Basis.PROJECT, counted(printed[key], given[key], taken_over=True), "power"),),
        )
        for key, name in names.items()
    ]  # fmt: skip
    sizes = sorted(int(n) for n in table["n"])
    exact = [f"ρ = {r:.2f}" for r in table["matching_rho"].dropna()]
    agreement: Agreement = counted(printed["minimum_n"], printed["minimum_n"])
    if printed["minimum_n"] not in sizes:
        hint = f"; one asks for exactly as many at {exact[0]}" if exact else ""
        agreement = unchecked(f"test and correlation are not printed{hint}")
    told = f"{sizes[0]} to {sizes[-1]} by {len(sizes)} usual tests"
    rows.append(
        PaperNumber(topic, place, "power analysis, people needed", f"at least {printed['minimum_n']}",
                    (Check(told, Basis.PRINTED, agreement, "power"),))
    )  # fmt: skip
    return rows


def _enough(published: Mapping[str, Any], study: str) -> PaperNumber:
    """Whether as many as took part give the power wanted, in every test that could be meant."""
    table, wanted = _sizes().table, published[study]["power"]["power"]
    table = table[table["study"] == study]
    people, least = published[study]["participants"], float(table["power_at_participants"].min())
    enough = concluded(least >= wanted, f"one test has {written(least, 3)}")
    check = Check(f"power of at least {written(least, 3)}", Basis.PRINTED, enough, "power")
    return PaperNumber(TOPIC, HUMAN_SUBJECTS, "adequately powered for medium effects",
                       f"{people} for a power of {wanted:g}", (check,))  # fmt: skip
