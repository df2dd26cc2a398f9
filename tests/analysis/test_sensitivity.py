"""What the plan depends on: the facts of the calibrated truth, the printed findings, variants, figures."""

from dataclasses import replace

import numpy as np
import pytest

from analysis.design import published
from analysis.figures.sensitivity import action_map, action_panel, critical_values, initials, share_map, share_panel
from analysis.figures.style import to_svg
from analysis.sensitivity import READINGS, SensitivityEffort, decider_of, discounts_of, sensitivity_study
from analysis.sensitivity_findings import check_findings
from analysis.sensitivity_variants import Beside, game_scores
from analysis.simulate import calibrated_truth
from models.errors import InputError
from models.model_draws import ModelDraws
from models.sensitivity.few_steps import FewSteps
from models.sensitivity.reward_grid import PRINTED_COSTS, PRINTED_R, RewardGrid, decide_grid
from models.unseen import without_actions
from tests.analysis.draws_cases import people

LITTLE = SensitivityEffort(3, 2, 2, 2, few_critical=4, scan=9, endless_scan=5, moved=False)


@pytest.fixture(scope="module")
def truth():
    draws = ModelDraws.from_models([calibrated_truth()])
    return sensitivity_study(draws, scores=game_scores(4), effort=SensitivityEffort(moved=False))


@pytest.fixture(scope="module")
def posterior():
    draws = ModelDraws.from_models(people(6, 3, seed=4))
    return sensitivity_study(
        draws, beside=[Beside("other", ModelDraws.from_models(people(2, 2, seed=1)))], effort=LITTLE
    )


def actions(study, reading, k, **where):
    return {
        row["r"]: row["action"]
        for row in study.rows()
        if row["reading"] == reading and row["k"] == k and all(row[key] == v for key, v in where.items())
    }


def test_the_grid_is_the_printed_one():
    printed = published()["sensitivity"]
    assert tuple(printed["r"]) == PRINTED_R
    assert PRINTED_COSTS == tuple(printed["cost_help"]) == tuple(printed["cost_signal"])


def test_where_helping_starts_at_the_published_costs(truth):
    for reading, first in (("infinite", 0.06), ("two-step", 0.08), ("two-step-terminal", 0.06)):
        found = actions(truth, reading, 0, cost_help=15.0, cost_signal=15.0)
        assert min(r for r, action in found.items() if action == "help") == first
        assert all((action == "help") == (r >= first) for r, action in found.items())


def test_two_steps_without_reward_after_them_never_signal(truth):
    rows = [r for r in truth.rows() if r["reading"] == "two-step" and r["k"] == 1]
    assert {r["action"] for r in rows} == {"no_signal"}
    assert {r["action"] for r in truth.rows() if r["reading"] == "two-step-terminal" and r["k"] == 1} == {
        "no_signal", "signal"
    }  # fmt: skip


def test_every_cell_without_a_horizon_is_proven(truth):
    for row in truth.rows():
        assert row["share"] == 1
        others = [high for name, (_, high) in row["values"].items() if name != row["action"]]
        if row["reading"] == "infinite":
            assert row["values"][row["action"]][0] > max(others)


def test_critical_values_agree_with_the_grid(truth):
    for reading in READINGS:
        for k in range(2):
            (flips,) = [f for f in truth.flips(reading, "r") if f.step == k]
            found = actions(truth, reading, k, cost_help=15.0, cost_signal=15.0)
            for r, action in found.items():
                passed = int((flips.high <= r).sum())
                assert passed + int((flips.low >= r).sum()) == len(flips.draw)
                assert (action in ("help", "signal")) == bool(passed)


def test_findings_of_the_truth(truth):
    found = {(f.key, f.reading): f.verdict for f in truth.findings}
    assert found == {
        ("helping", "infinite"): "does not hold", ("helping", "two-step"): "holds",
        ("helping", "two-step-terminal"): "does not hold", ("signalling", "infinite"): "holds",
        ("signalling", "two-step"): "does not hold", ("signalling", "two-step-terminal"): "holds",
        ("contrast", "infinite"): "holds", ("contrast", "two-step"): "does not hold",
        ("contrast", "two-step-terminal"): "holds",
    }  # fmt: skip
    printed = published()["claims"]
    assert any(claim.startswith("signalling is more state- and cost-sensitive") for claim in printed)
    assert any("helping dominant only for r >= 0.08" in claim for claim in printed)


def made_up(truth, helps, signals):
    """The two-step map of the truth with other decisions: functions of r and the two costs."""
    found = truth.maps["two-step"]
    choice = np.array([[helps(r, *c), signals(r, *c)] for r, c in found.grid.cells], dtype=np.int8)
    return replace(found, answers=replace(found.answers, choice=choice))


def verdicts(found, certain=None):
    flat = [np.zeros((2, 20, 1))] * 2 if certain is None else certain
    return {f.key: f for f in check_findings({"two-step": found}, {"two-step": flat})}


def test_dominant_means_more_than_half_of_the_cells(truth):
    only = made_up(truth, lambda r, h, s: r >= 0.08, lambda r, h, s: False)
    assert verdicts(only)["helping"].verdict == "holds"
    assert verdicts(only)["helping"].share == 1
    half = made_up(truth, lambda r, h, s: r >= 0.08 or h <= 5, lambda r, h, s: False)
    assert verdicts(half)["helping"].verdict == "holds"
    more = made_up(truth, lambda r, h, s: r >= 0.08 or h <= 15, lambda r, h, s: False)
    assert verdicts(more)["helping"].verdict == "does not hold"


def test_signalling_in_part(truth):
    region = made_up(truth, lambda r, h, s: r >= 0.06, lambda r, h, s: r >= 0.06 and s <= 15)
    found = verdicts(region)["signalling"]
    assert [m.holds for m in found.measures if m.decides] == [True, True, False]
    assert found.verdict == "holds in part"
    never = made_up(truth, lambda r, h, s: False, lambda r, h, s: True)
    assert verdicts(never)["signalling"].verdict == "cannot be told"


def test_sensitive_means_that_the_action_moves(truth):
    cost = made_up(truth, lambda r, h, s: r >= 0.06, lambda r, h, s: s <= 5)
    still, moves = np.zeros((2, 20, 1)), np.stack([np.zeros((20, 1)), np.ones((20, 1))])
    assert verdicts(cost, [still, moves])["contrast"].verdict == "holds"
    assert verdicts(cost, [still, still])["contrast"].verdict == "holds in part"
    assert verdicts(cost, [moves, still])["contrast"].share == 0


def test_other_robots_are_asked_no_printed_findings():
    fewer = without_actions(ModelDraws.from_models(people(1, 3)), ["signal"])
    study = sensitivity_study(fewer, readings=("two-step",), effort=LITTLE)
    assert study.findings == ()
    assert {row["action"] for row in study.rows() if row["k"] == 1} == {"no_signal"}
    assert "cost_signal" not in study.rows()[0]


def test_shares_over_draws(posterior):
    for row in posterior.rows():
        assert sum(row["shares"].values()) == pytest.approx(1)
        assert row["draws"] == (3 if row["reading"] == "infinite" else 6)
    assert all(0 <= f.share <= 1 for f in posterior.findings if f.share is not None)
    kinds = posterior.variants
    assert {row["states"] for row in kinds["beside"]} == {2, 3}
    assert "other (2 states)" in {row["variant"] for row in kinds["beside"]}
    assert {row["discount"] for row in kinds["discount"] if row["reading"] == "infinite"} < {
        row["discount"] for row in kinds["discount"] if row["reading"] == "two-step"
    }
    own = [row for row in kinds["belief"] if row["variant"] == "own"]
    assert own == [{**row, "variant": "own"} for row in kinds["x"] if row["variant"] == "as given"]


def test_variants_name_what_moved(truth):
    names = [row["variant"] for row in truth.variants["x"]]
    assert {"as given", "x_0 -2", "x_3 +2", "evenly spread", "measured in the token game"} <= set(names)
    moved = next(row for row in truth.variants["x"] if row["variant"] == "x_2 -2")
    assert moved["x"] == [45.0, 48.0, 54.0, 67.0]
    assert game_scores(3) == {}


def test_figures(truth, posterior):
    for study in (truth, posterior):
        found = study.maps["infinite"]
        for drawn in (
            action_map(found),
            share_map(found),
            action_panel(found, 1, 0.06),
            share_panel(found, 0, 0.08),
        ):
            assert to_svg(drawn).startswith("<svg")
        ax = critical_values([study.flips(r, "r")[0] for r in READINGS])
        assert "steepness" in ax.get_xlabel()
        assert to_svg(ax).startswith("<svg")
    letters = {t.get_text() for t in action_map(truth.maps["infinite"]).texts}
    assert {"N", "H", "S"} <= letters
    numbers = {t.get_text() for t in share_map(truth.maps["two-step"]).texts}
    assert {"0", "100"} <= numbers
    with pytest.raises(InputError, match="one number and one step"):
        critical_values([*truth.flips("infinite", "r")])
    with pytest.raises(InputError, match="map of a grid, r"):
        action_panel(truth.maps["infinite"], 0, 0.07)
    assert initials(["halt", "help"]) == {"halt": "HA", "help": "HE"}


@pytest.mark.parametrize(
    ("asked", "words"),
    [
        ({"readings": ("three-step",)}, "reading: found 'three-step'"), ({"readings": ()}, "readings: found 0"),
        ({"discount": 1.0}, "below 1 for the reading infinite"), ({"discount": -0.1}, "discount: found -0.1"),
        ({"scores": {"short": (1.0, 2.0)}}, "scores of the states, short"),
    ],
)  # fmt: skip
def test_refused(asked, words):
    draws = ModelDraws.from_models(people(1, 3))
    with pytest.raises(InputError, match=words):
        sensitivity_study(draws, effort=LITTLE, **asked)


def test_one_state_is_refused():
    with pytest.raises(InputError, match="with one state"):
        sensitivity_study(ModelDraws.from_models(people(1, 1)), effort=LITTLE)


def test_discounts_by_reading():
    assert discounts_of(READINGS, None) == {"infinite": 0.95, "two-step": 1.0, "two-step-terminal": 1.0}
    assert discounts_of(("two-step",), 1.0) == {"two-step": 1.0}
    with pytest.raises(InputError, match="reading"):
        decider_of("none", ModelDraws.from_models(people(1, 2)))
    with pytest.raises(InputError, match="at least 1"):
        SensitivityEffort(endless_draws=0)


@pytest.mark.slow
def test_four_thousand_draws_are_asked_exactly():
    draws = ModelDraws.from_models(people(4000, 4, seed=3))
    found = decide_grid(FewSteps(draws, True), RewardGrid.of(draws), 1.0)
    assert found.shares(0).shape == (80, 3)
    assert found.n_draws == 4000
