"""Two sides compared: numbers against plain computation, tests that hold their level, the page, its errors."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from analysis import datasets, fits
from analysis.entry_differences import entry_differences
from analysis.pair_differences import (
    cross_prediction,
    plan_exchange,
    pooled,
    rate_differences,
    same_model_test,
)
from analysis.report import compared_people, compared_plans, compared_sides
from analysis.report.compare import compare_report
from analysis.report.compared_context import Comparison
from analysis.report.effort import Effort
from analysis.report.section import NotSupported, Text
from analysis.side_by_side import Side, shared_states
from models.baum_welch import BaumWelch
from models.errors import InputError
from models.inference import run_log_likelihoods
from models.lspomdp import LatentStatePOMDP
from models.model_draws import ModelDraws
from models.planning.evaluation import evaluate_schedule
from models.planning.exact import solve_schedule
from models.planning.plan_policy import PlanPolicy
from models.planning.schedule import Schedule
from models.posterior_files import write_posterior
from models.protocol import PUBLISHED
from models.reward import Reward
from tests.analysis.command import result_of, run
from tests.analysis.report_cases import CORRIDOR, little_effort, random_log
from tests.random_cases import random_tables

DATE = "2026-01-31"


@pytest.fixture(scope="module", autouse=True)
def own_store(tmp_path_factory):
    folder = tmp_path_factory.mktemp("store")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(fits, "store_folder", lambda: folder)
        little_effort(patch)
        patch.setattr(Effort, "replicates_for", lambda *_: 20)
        yield


def random_model(rng, states=2):
    return LatentStatePOMDP(
        rng.dirichlet(np.ones(states)), rng.dirichlet(np.ones(states), (4, states)),
        rng.dirichlet(np.ones(2), (2, states)),
    )  # fmt: skip


def side(label, rng, log=None, draws=5):
    models = [random_model(rng) for _ in range(draws)]
    weight = rng.dirichlet(np.ones(draws))
    return Side(
        label, label.lower(), f"Side {label}", "simulated", "", {}, {2: models[0]},
        {2: ModelDraws.from_models(models, weight)}, "draws", log,
    )  # fmt: skip


@pytest.fixture
def sides():
    rng = np.random.default_rng(4)
    return side("A", rng, random_log(PUBLISHED, people=30, seed=1)), side(
        "B", rng, random_log(PUBLISHED, people=20)
    )


# -- numbers ---------------------------------------------------------------------------------------
def test_rates_are_those_of_a_count_and_differences_are_centred(sides):
    a, b = (s.log for s in sides)
    table = rate_differences(a, b)
    assert len(table)
    for log, side_name in ((a, "a"), (b, "b")):
        frame = log.to_frame()
        for row in table.itertuples():
            seen = frame[(frame["k"] == row.k) & (frame["action"] == row.action)]["observation"]
            seen = seen[seen.isin(PUBLISHED.response_names)]
            assert getattr(row, f"rate_{side_name}") == pytest.approx((seen == "help").mean())
            assert getattr(row, f"responses_{side_name}") == len(seen)
    np.testing.assert_allclose(table["difference"], table["rate_b"] - table["rate_a"])
    back = rate_differences(b, a)
    np.testing.assert_allclose(back["low"], -table["high"])
    assert (table["low"] <= table["difference"]).all()
    assert (table["difference"] <= table["high"]).all()


def test_the_same_data_twice_differ_nowhere(sides):
    log = sides[0].log
    table = rate_differences(log, log)
    assert (table["difference"] == 0).all()
    assert ((table["low"] < 0) & (table["high"] > 0)).all()


def test_chances_of_entries_are_those_of_all_pairs(sides):
    a, b = sides
    table = entry_differences(a, b, 2).table.set_index("entry")
    left, right = (s.draws[2] for s in sides)
    for name, values in {
        "initial[s1]": lambda d: d.initial[:, 1],
        "transition[signal,s0,s1]": lambda d: d.transition[:, 3, 0, 1],
        "help_probability[no_signal,s1]": lambda d: d.emission[:, 0, 1, PUBLISHED.response_names.index("help")],
    }.items():
        higher = values(right)[:, None] > values(left)[None]
        exact = np.einsum("i,j,ij->", right.weight, left.weight, higher)
        assert table.loc[name, "higher"] == pytest.approx(exact, abs=0.04)  # 4,000 pairs
        assert table.loc[name, "a"] == values(left)[0]
        assert table.loc[name, "difference"] == pytest.approx(values(right)[0] - values(left)[0])
    assert (table["apart"] == ((table["low"] > 0) | (table["high"] < 0))).all()


def test_equal_draws_are_not_apart(sides):
    found = entry_differences(sides[0], sides[0], 2)
    assert not found.table["apart"].any()
    assert len(found.table) == 22
    assert "0 of 13 independent entries" in found.sentence


def test_losses_of_prediction_are_differences_of_scores(sides):
    a, b = sides
    table = cross_prediction(a, b, 2).set_index(["people", "model"])
    own = run_log_likelihoods(a.estimates[2], a.log)
    other = run_log_likelihoods(b.estimates[2], a.log)
    n = a.log.n_responses_recorded
    assert table.loc[("A", "B"), "loss"] == pytest.approx((own - other).sum() / n)
    assert table.loc[("A", "B"), "per_response"] == pytest.approx(other.sum() / n)
    half = 1.96 * (own - other).std(ddof=1) * np.sqrt(len(own)) / n  # one run a person
    assert table.loc[("A", "B"), "high"] - table.loc[("A", "B"), "loss"] == pytest.approx(half)


def test_a_model_that_gives_people_no_chance_loses_infinitely_and_it_is_said(sides):
    a, b = sides
    never = LatentStatePOMDP([0.5, 0.5], np.full((4, 2, 2), 0.5), np.tile([1.0, 0.0], (2, 2, 1)))  # nobody helps
    seen = a.log.to_frame()
    helpers = seen[seen["observation"] == "help"]["participant"].nunique()
    assert 1 < helpers < a.log.n_participants
    b = replace(b, estimates={2: never})
    table = cross_prediction(a, b, 2).set_index(["people", "model"])
    assert table.loc[("A", "B"), "per_response"] == -np.inf
    assert table.loc[("A", "B"), "loss"] == np.inf
    assert table.loc[("A", "B"), ["low", "high"]].isna().all()
    assert table.loc[("A", "B"), "no_chance"] == helpers
    assert table.loc[("A", "A"), "no_chance"] == 0
    blocks = compared_people.prediction(Comparison((a, b), (2,), Effort.of(True), 1, None, None))
    told = [b.text for b in blocks if isinstance(b, Text) and "no chance" in b.text]
    assert told[0] == (
        f"Under the model of B with 2 states, what {helpers} of the 30 people of A did has no chance at all: its "
        "loss there is infinite, and has no interval."
    )
    assert not any("nan" in text for text in told)


def test_pooled_people_stay_apart(sides):
    a, b = (s.log for s in sides)
    both = pooled(a, b)
    assert both.n_participants == a.n_participants + b.n_participants
    assert both.n_responses_recorded == a.n_responses_recorded + b.n_responses_recorded
    model = sides[0].estimates[2]
    total = sum(run_log_likelihoods(model, log).sum() for log in (a, b))
    assert run_log_likelihoods(model, both).sum() == pytest.approx(total)
    with pytest.raises(InputError, match="protocol"):
        pooled(a, random_log(CORRIDOR, people=5))


SETTINGS = BaumWelch(1, restarts=2, finalists=1, max_maps=200, tolerance=1e-9)


def test_with_one_state_the_statistic_is_the_textbook_one():
    rng = np.random.default_rng(1)
    logs = []
    for help_rate in (0.3, 0.8):
        model = LatentStatePOMDP([1.0], np.ones((4, 1, 1)), np.tile([1 - help_rate, help_rate], (2, 1, 1)))
        design = random_log(PUBLISHED, people=40, seed=int(10 * help_rate))
        from models.simulation import simulate_responses

        logs.append(simulate_responses(model, design, rng)[0])
    test = same_model_test(*logs, 1, SETTINGS, replicates=19)
    counts = []
    for log in logs:
        frame = log.to_frame()
        seen = frame[frame["observation"].isin(PUBLISHED.response_names)]
        counts.append(seen.groupby("action")["observation"].agg([lambda o: (o == "help").sum(), "size"]).to_numpy())

    def height(table):
        y, n = table[:, 0], table[:, 1]
        p = np.clip(y / n, 1e-12, 1 - 1e-12)
        return (y * np.log(p) + (n - y) * np.log(1 - p)).sum()

    expected = 2 * (height(counts[0]) + height(counts[1]) - height(counts[0] + counts[1]))
    assert test.statistic == pytest.approx(expected, rel=1e-6)
    assert test.p_value == 0.05
    assert len(test.null) == 19


@pytest.mark.slow
def test_the_test_of_one_model_holds_its_level():
    from models.simulation import simulate_responses

    model = random_model(np.random.default_rng(9))
    designs = [random_log(PUBLISHED, people=40, seed=s) for s in (1, 2)]
    settings = BaumWelch(2, restarts=6, finalists=2, max_maps=300, tolerance=1e-6)
    p = []
    for i in range(60):
        rng = np.random.default_rng(i)
        logs = [simulate_responses(model, d, rng)[0] for d in designs]
        p.append(same_model_test(*logs, 2, settings, replicates=19).p_value)
    assert np.mean(np.array(p) <= 0.1) <= 0.1 + 3 * np.sqrt(0.1 * 0.9 / 60)
    assert 0.35 < np.mean(p) < 0.65


def test_plans_are_valued_in_both_worlds(sides):
    a, b = sides
    table = plan_exchange(a, b, 2, "RHRH").set_index(["plan", "world"])
    plan = PlanPolicy.of(solve_schedule(Schedule.of(a.estimates[2], "RHRH")))
    assert table.loc[("A", "B"), "value"] == pytest.approx(evaluate_schedule(plan, b.estimates[2], "RHRH").value)
    assert table.loc[("A", "A"), "loss"] == 0
    assert table.loc[("A", "B"), "loss"] >= -1e-9
    values = evaluate_schedule(plan, b.draws[2], "RHRH").values
    assert table.loc[("A", "B"), "low"] == pytest.approx(values.min())  # five draws: the ends are the extremes
    assert table.loc[("A", "B"), "high"] == pytest.approx(values.max())


def test_sides_without_shared_states_or_protocol_are_refused(sides):
    a, b = sides
    other = Side("B", "b", "B", "real", "", {}, {3: random_model(np.random.default_rng(0), 3)}, {}, "draws")
    with pytest.raises(InputError, match="2 in a, 3 in b"):
        shared_states(a, other)
    assert shared_states(a, b) == (2,)


# -- the page --------------------------------------------------------------------------------------
@pytest.fixture(scope="module")
def files(tmp_path_factory):
    from analysis.event_files import write_events

    folder = tmp_path_factory.mktemp("files")
    out = []
    for i in (1, 2):
        path = folder / f"{i}.csv"
        write_events(random_log(PUBLISHED, people=30, seed=i), path)
        out.append(path)
    return out


def test_two_data_sets(files, tmp_path, capsys):
    words = ("report", "--compare", *files, "--states", "1,2", "--quick", "--out", tmp_path)
    content = result_of(capsys, *words)
    assert content["states"] == [1, 2]
    assert [s["key"] for s in content["sections"]] == [
        "what", "responses", "tables", "one-model", "prediction", "plans", "limits"
    ]  # fmt: skip
    assert not any(s["omitted"] for s in content["sections"])
    page = (tmp_path / "comparison.html").read_text(encoding="utf-8")
    assert "not for citation" in page
    assert "different currencies" in page
    table = pd.read_csv(next((tmp_path / "comparison_parts").glob("table-*-entry-differences-2.csv")))
    assert len(table) == 22
    index = pd.read_csv(tmp_path / "comparison_parts" / "index.csv")
    assert set(index["section"]) <= {s["key"] for s in content["sections"]}
    assert index["made_by"].notna().all()


def test_same_seed_same_page(files, tmp_path):
    pages = [
        compare_report(*map(str, files), states="2", quick=True, out=tmp_path / str(i), date=DATE).html.read_text()
        for i in range(2)
    ]
    assert pages[0] == pages[1]


def test_a_fit_and_a_data_set(files, tmp_path, capsys):
    log = datasets.load(str(files[0])).log
    fit = fits.stored_fit(log, "digest", 2, sampler=Effort.of(True).sampler(1)).posterior
    write_posterior(fit, tmp_path / "fit.nc")
    words = ("report", "--compare", tmp_path / "fit.nc", files[1], "--quick", "--out", tmp_path)
    content = result_of(capsys, *words)
    assert content["states"] == [2]  # the fit's number decides
    left_out = {s["key"]: s["omitted"] for s in content["sections"] if s["omitted"]}
    assert set(left_out) == {"responses", "one-model", "prediction"}
    assert content["sides"][0]["doubt"] == "posterior"
    page = (tmp_path / "comparison.html").read_text(encoding="utf-8")
    assert fit.gate.passed or "failed its gate" in page
    assert run(*words, "--states", "3") == 2
    assert "--states" in capsys.readouterr().err


def test_other_protocols_are_refused(files, tmp_path, capsys):
    assert run("report", "--compare", files[0], files[0], "--quick", "--out", tmp_path) == 2
    assert "another file than --compare, A" in capsys.readouterr().err
    assert run("report", "--compare", files[0], tmp_path / "none.csv", "--quick", "--out", tmp_path) == 2
    assert "none.csv" in capsys.readouterr().err
    assert run("report", "--compare", *files, "--pdf", "--out", tmp_path) == 2
    assert "--pdf" in capsys.readouterr().err
    assert run("report", "--schedule", "HR", "--quick", "--out", tmp_path) == 2
    assert "--schedule" in capsys.readouterr().err
    assert (
        run("report", "--compare", *files, "--schedule", "HX", "--states", "1", "--quick", "--out", tmp_path) == 2
    )
    assert "X" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def corridor_side(label, seed, reward=None):
    model = LatentStatePOMDP(*random_tables(np.random.default_rng(seed), CORRIDOR, 2), CORRIDOR, reward=reward)
    return Side(
        label, label.lower(), label, "unstated", "", {}, {2: model}, {2: ModelDraws.from_models([model])}, "x"
    )


def test_plans_of_another_protocol_need_rewards_of_their_own():
    own = Reward.of_values([0.0, 8.0])
    for rewards in ((None, None), (own, None)):
        pair = tuple(corridor_side(name, i, r) for i, (name, r) in enumerate(zip("AB", rewards, strict=True)))
        with pytest.raises(NotSupported, match="what a round is worth is not known for protocol 'corridor'"):
            compared_plans.make(Comparison(pair, (2,), Effort.of(True), 1, None, None))
    pair = (corridor_side("A", 1, own), corridor_side("B", 2, own))
    (part,) = compared_plans.make(Comparison(pair, (2,), Effort.of(True), 1, None, None))
    assert part.key == "plans-2"
    said = part.blocks[0].text
    assert said.startswith("With 2 states, over SPDSPDSPD, ")
    assert "plan of A in A" not in said
    assert "plan of B in B" not in said


def test_a_plan_that_loses_nothing_is_said_to(sides):
    a, _ = sides
    pair = (a, replace(a, label="B"))
    (part,) = compared_plans.make(Comparison(pair, (2,), Effort.of(True), 1, "RH", None))
    assert "nothing is lost by acting on the other side's model" in part.blocks[0].text
    assert "95%" not in part.blocks[0].text


def test_the_same_data_on_both_sides_are_said_to_be(sides):
    a, b = (replace(s, digest="abc") for s in sides)
    told = [
        compared_sides.make(Comparison(pair, (2,), Effort.of(True), 1, None, None))[0] for pair in ((a, b), sides)
    ]
    assert "Both rest on the same data" in told[0].text
    assert not hasattr(told[1], "text")


def test_prediction_warns_that_the_own_model_has_seen_its_people(sides):
    warning = compared_people.prediction(Comparison(sides, (2,), Effort.of(True), 1, None, None))[0]
    assert warning.kind == "warning"
    assert "loses even where nothing differs" in warning.text


def test_what_cannot_be_a_side_is_named(files, tmp_path, capsys):
    model = tmp_path / "model.json"
    model.write_text("{}")
    for name, words in ((model, "wanted a data set, an event file or a fit (.nc)"), ("nosuch", "data: found")):
        assert (
            run("report", "--compare", files[0], name, "--states", "1", "--quick", "--out", tmp_path / "out") == 2
        )
        said = capsys.readouterr().err
        assert "--compare, B: " in said
        assert words in said


def test_sides_of_another_protocol(tmp_path):
    rng = np.random.default_rng(1)
    a = side("A", rng)
    log = random_log(CORRIDOR, people=10)
    fit = BaumWelch(2, restarts=2, finalists=1, max_maps=20).fit(log)
    b = Side("B", "b", "B", "unstated", "", {}, {2: fit.model}, {}, "x", log)
    with pytest.raises(InputError, match="follows the protocol"):
        shared_states(a, b)


def test_data_sets_are_taken_as_they_are(tmp_path):
    """The same page content as of the files that they were read from."""
    from analysis.datasets import load
    from analysis.event_files import write_events
    from tests.analysis.report_cases import data_set

    logs = [random_log(PUBLISHED, people=30, rounds=4, seed=seed) for seed in (1, 2)]
    names = [str(tmp_path / f"{name}.csv") for name in "ab"]
    for log, name in zip(logs, names, strict=True):
        write_events(log, name)
    options = {"states": "1", "quick": True, "date": DATE}
    files = compare_report(*names, out=tmp_path / "files", **options)
    given = compare_report(*map(load, names), out=tmp_path / "given", **options)
    for one, other in zip(files.sections[1:], given.sections[1:], strict=True):
        assert (one.omitted, one.sentences) == (other.omitted, other.sentences)
        for table, again in zip(one.tables, other.tables, strict=True):
            pd.testing.assert_frame_equal(table.frame, again.frame)
    named = data_set(logs[0], title="Our pilot", kind="simulated")
    mixed = compare_report(named, names[1], out=tmp_path / "mixed", **options)
    assert [s.title for s in mixed.sides] == ["Our pilot", "b.csv"]
    assert mixed.sides[0].kind == "simulated"
    with pytest.raises(InputError, match="found 'small' twice"):
        compare_report(named, named, out=tmp_path, **options)
    with pytest.raises(InputError, match="--compare, A, protocol: found 'corridor'"):
        compare_report(named, names[1], out=tmp_path, protocol=CORRIDOR, **options)
