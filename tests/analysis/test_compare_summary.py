"""A comparison's first screen, which of its estimates are counted, and whose word says what its people are."""

from dataclasses import replace

import numpy as np
import pytest

from analysis import datasets
from analysis.entry_differences import entry_differences
from analysis.event_files import write_events
from analysis.report import compared_plans, compared_tables
from analysis.report.compare import SECTIONS, compare_report
from analysis.report.compared_context import Comparison
from analysis.report.effort import Effort
from analysis.report.output_map import output_map
from analysis.report.section import Compared, Headline, Question, Section, Table
from analysis.report.summary import ANSWERED_BY, summarised
from analysis.side_by_side import Side, fit_side, stated_kinds
from models.errors import InputError
from models.lspomdp import LatentStatePOMDP
from models.model_draws import ModelDraws
from models.protocol import PUBLISHED
from models.reward import Reward
from tests.analysis.command import result_of, run
from tests.analysis.draws_cases import failed, fit_file, people
from tests.analysis.report_cases import CORRIDOR, data_set, random_log
from tests.random_cases import random_tables

DATE = "2026-01-31"


@pytest.fixture(scope="module", autouse=True)
def few_replicates(short_reports):
    short_reports.setattr(Effort, "replicates_for", lambda *_: 20)


def side(label, *models, **more):
    """A side whose draws are all the same, so that whatever differs at all differs clearly."""
    return Side(
        label, label.lower(), f"Side {label}", "simulated", "", {}, {models[0].n_states: models[0]},
        {models[0].n_states: ModelDraws.from_models(models)}, "draws", **more,
    )  # fmt: skip


def model(states=2, protocol=PUBLISHED, seed=0, **more):
    return LatentStatePOMDP(*random_tables(np.random.default_rng(seed), protocol, states), protocol, **more)


def of(a, b, **more):
    return Comparison((a, b), tuple(a.estimates), Effort.of(True), 1, more.pop("schedule", None), None)


def headlines(blocks):
    section = Section("Section", "section", tuple(blocks))
    return [block for block in section.flat() if isinstance(block, Headline)]


# -- what is counted -------------------------------------------------------------------------------
@pytest.mark.parametrize(("protocol", "states"), [(PUBLISHED, 2), (PUBLISHED, 3), (CORRIDOR, 2), (CORRIDOR, 4)])
def test_as_many_entries_are_counted_as_a_model_has_free_parameters(protocol, states):
    found = entry_differences(
        side("A", model(states, protocol)), side("B", model(states, protocol, seed=1)), states
    )  # fmt: skip
    p = protocol
    free = states - 1 + p.n_actions * states * (states - 1) + len(p.emission_actions) * states * (p.n_responses - 1)
    assert found.n == free
    assert found.table["apart"].all()  # no doubt on either side, and everything differs
    assert found.n_apart == free
    assert found.by_chance == pytest.approx(0.05 * free)
    assert f", {free} of {free} independent entries differ" in found.sentence
    assert f"The table has {len(found.table)} entries" in found.sentence


def test_both_entries_of_a_row_of_two_are_one_difference():
    a = model()
    transition = a.transition.copy()
    transition[0, 1] = transition[0, 1, ::-1]
    other = replace(a, transition=transition)
    found = entry_differences(side("A", a), side("B", other), 2)
    row = found.table[found.table["entry"].str.startswith(f"transition[{PUBLISHED.action_names[0]},s1")]
    assert row["apart"].tolist() == [True, True]
    assert row["difference"].sum() == pytest.approx(0)
    assert found.table["apart"].sum() == 2
    assert found.n_apart == 1
    assert found.largest["entry"] == f"transition[{PUBLISHED.action_names[0]},s1,s1]"


def test_of_entries_that_differ_clearly_the_largest_is_told():
    """A difference that is larger and nothing but doubt is not the one that differs most."""
    a = replace(model(), initial=[0.9, 0.1], emission=np.full((2, 2, 2), 0.5))
    emission = a.emission.copy()
    emission[0, 0], emission[1, 1] = [0.4, 0.6], [0.3, 0.7]
    b, doubt = replace(a, initial=[0.1, 0.9], emission=emission), [[0.95, 0.05], [0.05, 0.95]]
    draws = ModelDraws.from_models([replace(b, initial=initial) for initial in doubt])
    found = entry_differences(side("A", a), replace(side("B", b), draws={2: draws}), 2)
    assert found.table.loc[found.table["difference"].idxmax(), "entry"] == "initial[s1]"
    assert found.n_apart == 2
    assert found.largest["entry"] == f"help_probability[{PUBLISHED.emission_actions[1]},s1]"


def test_what_a_side_did_not_learn_is_not_counted():
    a, b = model(), model(seed=1)
    held = {2: ("transition[help]", "emission[signal]")}
    found = entry_differences(side("A", a, not_learned=held), side("B", b), 2)
    names = found.table[~found.table["counted"]]["entry"]
    assert found.n == 13 - 2 - 2
    assert {"transition[help,s0,s1]", "help_probability[signal,s1]"} <= set(names)
    assert "Not counted, as not learned on both sides: transition[help], emission[signal]." in found.sentence
    assert "Not counted" not in entry_differences(side("A", a), side("B", b), 2).sentence


def test_actions_that_one_side_never_took_are_not_learned_there(tmp_path):
    with_all = random_log(PUBLISHED, people=40)
    control = datasets.load("simulated_study1").log.select(conditions=["no-help+no-signal"])
    options = {"states": "2", "quick": True, "out": tmp_path, "date": DATE}
    made = compare_report(data_set(with_all, name="all"), data_set(control, name="control"), **options)
    assert made.sides[0].not_learned == {2: ()}
    assert made.sides[1].not_learned == {2: ("transition[help]", "transition[signal]", "emission[signal]")}
    pinned = compare_report(
        data_set(with_all, name="all"), data_set(with_all, name="again"), pins=["help"], **options
    )
    assert [s.not_learned for s in pinned.sides] == [{2: ("transition[help]",)}] * 2


# -- the first screen ------------------------------------------------------------------------------
@pytest.fixture(scope="module")
def files(tmp_path_factory):
    folder = tmp_path_factory.mktemp("files")
    out = []
    for name, kind in (("a", 1), ("b", 2)):
        out.append(folder / f"{name}.csv")
        write_events(random_log(PUBLISHED, people=30, seed=kind), out[-1])
    return out


@pytest.fixture(scope="module")
def made(files, tmp_path_factory):
    out = tmp_path_factory.mktemp("out")
    return compare_report(*map(str, files), states="1,2", quick=True, out=out, parts=True, date=DATE)


def test_the_first_screen_tells_what_the_sections_found(made):
    answers = summarised(made.sections)
    assert list(dict.fromkeys(a.question for a in answers)) == list(Compared)
    page = made.html.read_text(encoding="utf-8")
    short = page[page.index('id="in-short"') : page.index("<nav")]
    for answer in answers:
        assert answer.question.value in short
    told = {a.question: a for a in answers}
    for log, s in zip("AB", made.sides, strict=True):
        words = f"{log}: {s.title} (supplied file, 30 people, {s.log.n_responses_recorded} recorded responses"
        assert words in told[Compared.SIDES].text
    assert "models with 1 and 2 states" in told[Compared.SIDES].text
    table = next(t for s in made.sections for t in s.tables if t.key == "rate-differences").frame
    apart = (table["low"] > 0) | (table["high"] < 0)
    assert f"clearly in {apart.sum()} of {len(table)} pairs" in told[Compared.RESPONSES].text
    lines = (made.parts.folder / "summary.txt").read_text(encoding="utf-8").splitlines()
    assert len(lines) == len(answers)


def test_estimates_and_the_number_of_those_that_differ_are_those_of_the_table(made):
    answers = [a for a in summarised(made.sections) if a.question is Compared.ENTRIES]
    assert answers
    for answer in answers:
        k = int(answer.about.split()[0])
        table = next(t for s in made.sections for t in s.tables if t.key == f"entry-differences-{k}").frame
        own = table[table["counted"]]
        apart = (own["low"] > 0) | (own["high"] < 0)
        assert answer.text.startswith(f"{apart.sum()} of {len(own)} independent estimates differ clearly")
        most = (own[apart] if apart.any() else own).pipe(lambda t: t.loc[t["difference"].abs().idxmax()])
        assert f"{most['entry']}: {most['a']:.2f} in A, {most['b']:.2f} in B" in answer.text
        assert (answer.verdict == "") == (apart.sum() > 0.05 * len(own))


def test_every_question_is_answered_by_a_section():
    keys = {key for key, _, _ in SECTIONS}
    assert all(set(ANSWERED_BY[q]) <= keys for q in Compared)
    assert not keys & {key for q in Question for key in ANSWERED_BY[q]}


def test_models_that_are_not_to_be_relied_on_say_so_in_the_summary_and_on_every_part(tmp_path):
    doubtful = side("B", model(seed=1, cautions=("the posterior failed its convergence gate",)))
    told = "B: the posterior failed its convergence gate"
    comparison = of(side("A", model()), doubtful, schedule="HR")
    for blocks in (compared_tables.make(comparison), compared_plans.make(comparison)):
        (headline,) = headlines(blocks)
        assert headline.kind == "warning"
        assert told in headline.text
        outputs = output_map([Section("Section", "section", blocks)], {})
        assert outputs
        assert {o.mark for o in outputs} == {f"CAUTION: {told}; do not rely on these numbers."}
    fine = of(side("A", model()), side("B", model(seed=1)), schedule="HR")
    for blocks in (compared_tables.make(fine), compared_plans.make(fine)):
        assert all(h.kind != "warning" for h in headlines(blocks))
        assert {o.mark for o in output_map([Section("Section", "section", blocks)], {})} == {""}


def test_losses_are_in_the_unit_of_the_reward():
    points = Reward.of_values([0.0, 9.0], unit="points")
    pair = [model(reward=points), model(seed=1, reward=points)]
    (part,) = compared_plans.make(of(side("A", pair[0]), side("B", pair[1]), schedule="HR"))
    (table,) = (b for b in part.blocks if isinstance(b, Table))
    said = [*(h.text for h in headlines([part])), table.caption, part.blocks[0].text]
    assert not any("reward units" in text for text in said)
    assert "in numbers, points;" in table.caption
    svgs = [svg for figure in Section("S", "s", (part,)).figures for svg in figure.svgs()]
    assert svgs
    assert all("reward units" not in svg for svg in svgs)
    other = model(seed=1, reward=Reward.of_values([0.0, 9.0], unit="euros"))
    (mixed,) = compared_plans.make(of(side("A", pair[0]), side("B", other), schedule="HR"))
    (table,) = (b for b in mixed.blocks if isinstance(b, Table))
    assert "in numbers, points in A; euros in B;" in table.caption


# -- what the people are ---------------------------------------------------------------------------
def test_one_kind_is_for_every_side_that_has_no_card(files):
    a, b = map(str, files)
    assert stated_kinds(a, b, []) == (None, None)
    assert stated_kinds(a, b, ["real"]) == ("real", "real")
    assert stated_kinds(a, b, ["real", "simulated"]) == ("real", "simulated")
    assert stated_kinds("simulated_study1", b, ["real"]) == (None, "real")
    assert stated_kinds(a, "simulated_study1", ["real"]) == ("real", None)
    named = data_set(random_log(PUBLISHED, people=5), kind="real")
    assert stated_kinds(named, b, ["simulated"]) == (None, "simulated")
    assert stated_kinds(replace(named, card=replace(named.card, kind="unstated")), b, ["real"]) == ("real", "real")


@pytest.mark.parametrize(
    ("sources", "kinds", "told"),
    [
        (("a.csv", "b.csv"), ["imagined"], "--kind: found 'imagined', wanted real or simulated"),
        (("a.csv", "b.csv"), ["real"] * 3, "--kind: found 'real, real, real', wanted one for both sides, or two"),
        (("simulated_study1", "b.csv"), ["real", "real"], "one value, for the other side: A, simulated_study1, is"),
        (
            ("simulated_study1", "frd2012"),
            ["real"],
            "wanted no value: A, simulated_study1, is simulated by its card",
        ),
    ],
)
def test_a_kind_that_a_card_states_or_nobody_knows_is_refused(sources, kinds, told):
    with pytest.raises(InputError) as error:
        stated_kinds(*sources, kinds)
    assert told in str(error.value)


def test_fits_of_unregistered_data_take_the_kind_too(tmp_path):
    mine = fit_file(tmp_path / "mine.nc", people(3), provenance={"data": "mine.csv"})
    known = fit_file(tmp_path / "known.nc", people(3), provenance={"data": "simulated_study1"})
    assert stated_kinds(str(mine), str(known), ["real"]) == ("real", None)
    stated = fit_side("A", str(mine), kind="real")
    assert stated.kind == "real"
    assert any("is the word of whoever made this report (--kind)" in text for text in stated.warnings)
    assert fit_side("A", str(mine)).kind == "unstated"
    assert fit_side("B", str(known)).kind == "simulated"


def test_a_fit_that_missed_its_gate_is_doubted(tmp_path):
    doubtful = fit_side("A", str(fit_file(tmp_path / "a.nc", people(3), gate=failed())))
    assert doubtful.cautions(3) == ("the posterior failed its convergence gate",)


def test_the_command_states_the_kind_of_files(files, tmp_path, capsys):
    words = ("report", "--compare", *files, "--states", "1", "--quick", "--no-parts", "--out", tmp_path)
    content = result_of(capsys, *words, "--kind", "real", "--kind", "simulated")
    assert [s["kind"] for s in content["sides"]] == ["real", "simulated"]
    assert content["summary"][0].startswith("What is compared [real people, simulated]: ")
    page = (tmp_path / "comparison.html").read_text(encoding="utf-8")
    assert "--kind real --kind simulated" in page
    for kind, label in (("real", "A"), ("simulated", "B")):
        assert f"{label}: That these people are {kind} is the word of whoever made this report (--kind)." in page
    assert run(*words, "--kind", "imagined") == 2
    assert "--kind: found 'imagined'" in capsys.readouterr().err
    assert run("report", "--data", files[0], "--kind", "real", "--kind", "real", "--out", tmp_path / "one") == 2
    assert "--kind: found 'real, real', wanted one value, without --compare" in capsys.readouterr().err
