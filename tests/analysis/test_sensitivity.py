"""What the plan depends on: the facts of the calibrated truth, the printed findings, variants, figures."""

from dataclasses import replace

import numpy as np
import pytest

from analysis.design import published
from analysis.figures.sensitivity import action_map, action_panel, critical_values, initials, share_map, share_panel
from analysis.figures.style import to_svg
from analysis.sensitivity import READINGS, SensitivityEffort, decider_of, discounts_of, sensitivity_study
from analysis.sensitivity_findings import Finding, Measure, check_findings
from analysis.sensitivity_variants import Beside, game_scores
from analysis.simulate import calibrated_truth
from models.errors import InputError
from models.lspomdp import LatentStatePOMDP
from models.model_draws import ModelDraws
from models.protocol import Action, Mode, Protocol, Response
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


def test_what_is_free_does_not_make_it_sensitive_unsaid(truth):
    """Helping moves with what it costs, signalling mostly by being free: beside the verdict stands the rest."""
    free = made_up(truth, lambda r, h, s: h <= 5, lambda r, h, s: s == 0 or (s == 5 and r > 0.05))
    moves = np.stack([np.zeros((20, 1)), np.ones((20, 1))])
    found = verdicts(free, [np.zeros((2, 20, 1)), moves])["contrast"]
    costs, paid, _ = found.measures
    assert (costs.value, costs.decides) == (pytest.approx(0.0), True)
    # Of 5 x 4 lines without the free cell helping changes on all, signalling on those of three r.
    assert (paid.value, paid.decides) == (pytest.approx(0.6 - 1.0), False)


def test_signalling_after_helping_is_compared_at_the_same_r_too(truth):
    """Steep r makes both pay: over the grid they go together, at the same r and cost a signal follows no help."""
    steep = made_up(
        truth, lambda r, h, s: r >= 0.08 or (r >= 0.06 and h <= 5),
        lambda r, h, s: r >= 0.08 or (r >= 0.06 and h > 5),
    )  # fmt: skip
    found = verdicts(steep)["signalling"]
    assert found.measures[0].value > 0
    assert "cells of the grid in which it helped" in found.measures[0].name
    alike = found.measures[-1]
    assert "at the same r" in alike.name
    assert (alike.value, alike.holds, alike.decides) == (pytest.approx(-1.0), False, False)


def test_the_draws_decide_by_their_share_not_by_their_mean(truth):
    def finding(share, draws, of_mean=True):
        measure = Measure("m", "w", 0.503, of_mean, share)
        return Finding("helping", "p", "two-step", (measure,), share, draws)

    assert finding(0.99, 200, of_mean=False).over_draws == "holds"
    assert (
        finding(0.99, 200, of_mean=False).sentence == "holds in 99% of 200 draws. Means over the draws: m: 0.503."
    )
    assert finding(0.32, 200).over_draws == "open"
    assert finding(0.03, 200).over_draws == "does not hold"
    assert finding(0.5, 2).over_draws == finding(1.0, 58).over_draws == "too few draws"
    assert finding(0.5, 2).sentence.startswith("holds in 1 of 2 draws")
    assert finding(1.0, 1).sentence == "holds: m: 0.503."
    told = finding(0.99, 200, of_mean=False).to_dict()
    assert (told["verdict"], told["verdict_of_mean"], told["holds"]) == ("holds", "does not hold", True)
    assert finding(0.32, 200).to_dict()["holds"] is None


def test_undecided_cells_that_might_turn_a_verdict_leave_none(truth):
    whole = made_up(truth, lambda r, h, s: r >= 0.08, lambda r, h, s: False)
    choice = whole.answers.choice.copy()
    costs = np.array([c for _, c in whole.grid.cells])[:, 0]
    steep = np.array([r for r, _ in whole.grid.cells])
    few, many = choice.copy(), choice.copy()
    few[(steep == 0.06) & (costs == 0), 0] = -1
    many[(steep == 0.06) & (costs <= 15), 0] = -1
    for changed, wanted in ((few, "holds"), (many, "cannot be told")):
        found = verdicts(replace(whole, answers=replace(whole.answers, choice=changed)))["helping"]
        assert found.verdict == found.over_draws == wanted
        assert "Undecided cells count half." in found.sentence
    assert "Undecided" not in verdicts(whole)["helping"].sentence


def test_variants_keep_costs_of_one_mode_apart():
    """Two costly actions in one mode: what stays is the reward as given, not the first one's cost for both."""
    modes = (
        Mode("stuck", "S", (Action("wait"), Action("ask", 5.0), Action("trade", 8.0)), "wait", True),
        Mode("helping", "P", (Action("pass_by"), Action("assist", 15.0)), "pass_by", False),
    )
    protocol = Protocol("corridor", modes, (Response("refused", 0.0), Response("helped", 1.0)))
    moved = np.array([0.0, 0.17, 0.2, 0.0, 0.0])
    # At r .06 a person in the upper state is worth 40.8: asking brings 1.9 and trading .2, were it 5 as well 3.2.
    transition = np.stack([[[1 - m, m], [0.0, 1.0]] for m in moved])
    model = LatentStatePOMDP(np.array([1.0, 0.0]), transition, np.full((3, 2, 2), 0.5), protocol)
    draws = ModelDraws.from_models([model])
    beside = [Beside("the same", draws)]
    study = sensitivity_study(draws, readings=("two-step",), beside=beside, effort=LITTLE)
    told = {
        row["action"] for kind in ("belief", "x", "beside") for row in study.variants[kind]
        if row["variant"] in ("own", "as given", "the same") and row["k"] == 0
    }  # fmt: skip
    assert told == {"ask"}
    assert study.flips("two-step", "r")[0].before[0] == 0


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
    # As many draws as the grid where that is cheap: the same question has the same answer.
    assert {row["draws"] for row in kinds["belief"] if row["reading"] != "infinite"} == {6}
    cell = {
        (row["reading"], row["k"]): row["share"] for row in posterior.rows()
        if (row["r"], row["cost_help"], row["cost_signal"]) == (0.06, 15, 15) and row["reading"] != "infinite"
    }  # fmt: skip
    assert (
        cell.items()
        <= {(row["reading"], row["k"]): row["share"] for row in kinds["belief"] if row["variant"] == "own"}.items()
    )
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
    legend = [t.get_text() for t in action_map(truth.maps["infinite"]).get_legend().get_texts()]
    assert legend == ["N: no help, no signal", "H: help", "S: signal"]


def test_figures_of_few_draws_count_them(posterior):
    found = posterior.maps["infinite"]
    ax = share_map(found)
    assert ax.get_legend().get_title().get_text() == "how many of 3 draws act"
    assert {t.get_text() for t in ax.texts if t.get_text().isdigit()} <= {"0", "1", "2", "3"}
    assert not any("toss" in t.get_text() for t in ax.get_legend().get_texts())
    many = decide_grid(FewSteps(ModelDraws.from_models(people(20, 3)), True), RewardGrid.of(posterior.draws), 1.0)
    ax = share_map(many)
    assert ax.get_legend().get_title().get_text() == "percent of 20 draws"
    assert any("toss" in t.get_text() for t in ax.get_legend().get_texts())
    assert "(3 draws): step 0" in posterior.sentence
    assert "toss" not in posterior.sentence


def test_figures_refuse(truth):
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
