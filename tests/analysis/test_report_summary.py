"""The report's first screen: which sections answer, what is set before answers, and whose the numbers are."""

import math
import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from analysis.em_study import EmStudy
from analysis.report.build import build_report
from analysis.report.drawings import Drawings
from analysis.report.pdf import available, to_pdf
from analysis.report.registry import Entry
from analysis.report.render import PageHead, render
from analysis.report.section import Headline, NotSupported, Omitted, Origin, Part, Question, Section, Text
from analysis.report.sections import plan_headlines, regression, states
from analysis.report.summary import ANSWERED_BY, summarised
from analysis.report.units import in_unit
from analysis.robust_study import robust_study
from models.gate import convergence_gate
from models.lspomdp import LatentStatePOMDP
from models.model_draws import ModelDraws
from models.planning.evaluation import evaluate_schedule
from models.planning.plan_policy import PlanPolicy
from models.planning.schedule import Schedule
from models.protocol import PUBLISHED
from tests.analysis.report_cases import CORRIDOR, data_set, log_of, random_log, some
from tests.models.planning.policy_cases import person

pytestmark = pytest.mark.usefixtures("short_reports")
HEAD = PageHead("A study", (Origin.REAL,), ("0" * 64,), 1, "2026-01-31", "", False)


def said(question, text="It is 3 (1 to 5).", kind="plain", origin=(Origin.REAL,), about=""):
    return Headline(text=text, kind=kind, question=question, origin=origin, about=about)


# -- which section answers -------------------------------------------------------------------------
def test_the_section_that_knows_best_answers_wherever_it_stands():
    plan = Section("Plan", "plan", (said(Question.PLAN, "by the estimate"),))
    robust = Section("Doubt", "robust", (said(Question.PLAN, "under doubt"),))
    for order in ((plan, robust), (robust, plan)):
        (answer,) = [a for a in summarised(order) if a.question is Question.PLAN]
        assert (answer.text, answer.key, answer.title) == ("under doubt", "robust", "Doubt")
    left_out = replace(robust, blocks=(), omitted="no draws")
    (answer,) = summarised((plan, left_out))
    assert answer.text == "by the estimate"


def test_a_section_added_to_a_report_answers_after_those_that_are_known():
    mine = Section("Mine", "mine", (said(Question.PLAN, "mine"),))
    assert [a.text for a in summarised((mine,))] == ["mine"]
    plan = Section("Plan", "plan", (said(Question.PLAN, "plan"),))
    assert [a.text for a in summarised((mine, plan))] == ["plan"]


def test_answers_come_in_the_order_of_the_questions():
    sections = [Section(q.value, ANSWERED_BY[q][0], (said(q),)) for q in reversed(Question)]
    assert [a.question for a in summarised(sections)] == list(Question)


def test_the_reason_is_given_where_no_section_answers():
    study = Section("Study", "study", (said(Question.PEOPLE),))
    robust = Section("Doubt", "robust", (Part("2 states", "robust-2", (Omitted("plans", "nothing to decide"),)),))
    plan = Section("Plan", "plan", omitted="no reward")
    answers = summarised((study, plan, robust))
    assert [a.question for a in answers] == [Question.PEOPLE, Question.PLAN]
    assert answers[1].text == "Nothing is said here: nothing to decide."
    assert answers[1].origin == ()
    assert [a.text for a in summarised((study, plan))][1] == "Nothing is said here: no reward."


def test_reports_without_a_headline_have_no_summary():
    sections = (Section("Plan", "plan", (Text("x"),)), Section("Paper", "paper", omitted="other people"))
    assert summarised(sections) == ()
    assert "In short" not in render(sections, HEAD, Drawings())


def test_an_answer_leads_to_the_innermost_part_that_is_open():
    inner = Part("inner", "inner", (said(Question.KNOWN),), folded=True)
    section = Section("Sure", "uncertainty", (Part("4 states", "sure-4", (Text("x"), inner)),))
    assert summarised((section,))[0].key == "sure-4"


def test_all_numbers_of_states_are_told_those_not_to_be_relied_on_last():
    parts = [
        Part(f"{k} states", f"sure-{k}", (said(Question.KNOWN, f"text {k}", kind, about=f"{k} states"),))
        for k, kind in ((4, "warning"), (3, "open"), (2, "plain"))
    ]
    section = Section("Sure", "uncertainty", tuple(parts))
    answers = summarised((section,))
    assert [(a.about, a.key) for a in answers] == [
        ("3 states", "sure-3"), ("2 states", "sure-2"), ("4 states", "sure-4"),
    ]  # fmt: skip
    page = render((section,), HEAD, Drawings())
    short = page[page.index('class="short"') : page.index("</header>")]
    assert short.count("<li>") == 1
    assert short.count("<p>") == 3
    assert answers[2].line == (
        "What is known of the model [real people]: 4 states: NOT TO BE RELIED ON: text 4 (section Sure)"
    )


@pytest.mark.parametrize("wrong", [{"text": ""}, {"origin": ()}, {"kind": "note"}])
def test_headlines_have_text_origin_and_a_known_kind(wrong):
    with pytest.raises(ValueError, match="headline"):
        said(Question.PLAN, **wrong)


# -- the page --------------------------------------------------------------------------------------
def test_the_page_shows_verdict_and_badge_and_the_section_does_not_repeat_it():
    sections = (
        Section("Plan", "plan", (said(Question.PLAN, "It gains -3 (-5 to 1).", "open", (Origin.SIMULATED,)),)),
        Section("Sure", "uncertainty", (said(Question.KNOWN, "Nothing is <sure>.", "warning"), Text("At length."))),
    )
    page = render(sections, HEAD, Drawings())
    short = page[page.index('class="short"') : page.index("</header>")]
    assert page.count("It gains −3 (−5 to 1).") == short.count("It gains −3 (−5 to 1).") == 1
    assert 'href="#plan">What the robot should do</a>' in short
    known, plan = re.findall(r"<li>.*?</li>", short, flags=re.DOTALL)
    assert "not to be relied on" in known
    assert "badge-real" in known
    assert "Nothing is &lt;sure&gt;." in known
    assert "not decidable" in plan
    assert "badge-simulated" in plan
    assert sections[1].sentences == ["At length."]


def test_a_stated_unit_reaches_the_summary():
    plan = Section("Plan", "plan", (said(Question.PLAN, "It gains 3 reward units."),))
    assert summarised(in_unit((plan,), "points"))[0].text == "It gains 3 points."


def test_the_first_pages_of_the_pdf_begin_with_the_summary():
    if not available():
        pytest.skip("WeasyPrint, an optional extra, is not installed")
    sections = (Section("Plan", "plan", (said(Question.PLAN),)),)
    assert to_pdf(render(sections, HEAD, Drawings())).startswith(b"%PDF-")


# -- any file --------------------------------------------------------------------------------------
TWO_ROUNDS = [
    (i, 0, "a" if i % 2 else "b", [("help" if i % 2 else "no_help", "none"),
                                   ("signal" if i % 4 < 2 else "no_signal", "help" if i % 3 else "no_help")])
    for i in range(24)
]  # fmt: skip
ONE_ARM = [(i, 0, "a", [("no_help", "none"), ("no_signal", "help" if i % 3 else "no_help")] * 2) for i in range(30)]


@pytest.mark.parametrize(
    ("log", "wanted"),
    [
        (random_log(CORRIDOR, people=30), set(Question) - {Question.PAPER, Question.PLAN}),
        (log_of(TWO_ROUNDS), {Question.PEOPLE, Question.STATES, Question.KNOWN}),
        (log_of(ONE_ARM), {Question.PEOPLE, Question.STATES, Question.KNOWN}),
    ],
    ids=["three responses", "two rounds a person", "one arm"],
)
def test_other_files_are_summed_up_as_far_as_they_go(log, wanted, tmp_path):
    chosen = some("study", "states", "uncertainty", "regression", "plan", "paper")
    made = build_report(data_set(log), states="1,2", quick=True, out=tmp_path, sections=chosen)
    answers = summarised(made.sections)
    assert wanted <= {a.question for a in answers if a.origin}
    for answer in answers:
        assert "nan" not in answer.text
        assert answer.origin or answer.text.startswith("Nothing is said here: ")
    assert "In short" in made.html.read_text(encoding="utf-8")


def test_a_report_of_a_few_sections_says_what_these_know(tmp_path):
    small = data_set(random_log(PUBLISHED, people=20))
    made = build_report(small, states="1", quick=True, out=tmp_path, sections=some("provenance", "states"))
    (answer,) = summarised(made.sections)
    assert answer.verdict == "not decidable"
    assert "Only models with 1 state were fitted" in answer.text

    def nothing(context):
        raise NotSupported("the moon is full")

    empty = Entry("plan", "Plan", nothing)
    made = build_report(small, states="1", quick=True, out=tmp_path, sections=(*some("states"), empty))
    assert [a.text for a in summarised(made.sections)][1] == "Nothing is said here: the moon is full."


# -- the rules behind a verdict --------------------------------------------------------------------
def of_states(likelihoods, parameters, converged=True, responses=1000):
    """Fits of so many states as there are likelihoods, from one on, as far as a headline asks."""
    found = {
        k: SimpleNamespace(
            log_likelihood=ll, converged=converged, aic=2 * p - 2 * ll,
            bic=p * math.log(responses) - 2 * ll,
        )
        for k, (ll, p) in enumerate(zip(likelihoods, parameters, strict=True), 1)
    }  # fmt: skip
    return states._headline(SimpleNamespace(study=EmStudy(None, found), origin=Origin.REAL))


def test_the_number_of_states_is_open_unless_criteria_agree_clearly():
    assert of_states([-600.0, -500.0, -499.9], [1, 5, 11]).kind == "plain"
    assert of_states([-600.0, -500.0, -490.0], [1, 5, 11]).kind == "open"  # AIC prefers three
    near = of_states([-516.0, -500.0], [1, 5])
    assert near.kind == "open"
    assert "by 4.4 before 1" in near.text
    flat = of_states([-35.81, -35.81, -35.8], [1, 5, 11])
    assert flat.kind == "open"
    assert "merely counts parameters" in flat.text
    missed = of_states([-600.0, -500.0], [1, 5], converged=False)
    assert missed.kind == "warning"
    assert "did NOT converge at 1 and 2" in missed.text


def of_regression(rows, notes=(), randomised=True):
    marginal = {
        name: SimpleNamespace(difference=SimpleNamespace(value=v, lower=a, upper=b)) for name, v, a, b in rows
    }
    table = SimpleNamespace(outcome="help", randomised=randomised)
    main = SimpleNamespace(notes=[SimpleNamespace(text=text) for text in notes])
    found = SimpleNamespace(terms=list(marginal), marginal=marginal, table=table, main=main)
    return regression._headline(SimpleNamespace(origin=Origin.REAL), found)


def test_the_sign_of_an_effect_is_open_where_its_interval_holds_zero():
    rng = np.random.default_rng(1)
    for _ in range(200):
        low, high = np.sort(rng.normal(0.05, 0.1, 2))
        found = of_regression([("help", (low + high) / 2, low, high)])
        assert (found.kind == "open") == (low <= 0 <= high) == ("not decidable" in found.text)
    mixed = of_regression([("robot_help", 0.2, 0.1, 0.3), ("signal", 0.02, -0.03, 0.07)])
    assert mixed.kind == "plain"
    assert "+2.0 with 'signal' (95% interval -3.0 to +7.0: sign not decidable)" in mixed.text
    assert "points: +20.0 with 'robot help' (95% interval +10.0 to +30.0);" in mixed.text
    lost = of_regression([("signal", 0.02, math.nan, math.nan)], notes=["the search did not end"])
    assert lost.kind == "warning"
    assert "(no interval: sign not decidable)" in lost.text
    assert "Caution: the search did not end." in lost.text
    assigned = of_regression([("signal", 0.2, 0.1, 0.3)], randomised=False)
    assert assigned.kind == "open"
    assert "Not randomised" in assigned.text


@pytest.fixture(scope="module")
def doubt():
    """Two draws of one person, and what is planned for both."""
    one = person()
    colder = LatentStatePOMDP(one.initial[::-1], one.transition, one.emission)
    return robust_study(Schedule.of(ModelDraws.from_models([one, colder]), "HRH"), sampled=False)


def test_how_often_the_plan_acts_is_what_following_it_says():
    """With one draw, the decisions weighted by how probable they are must come to what evaluation counts."""
    one = person()
    study = robust_study(Schedule.of(ModelDraws.from_models([one]), "HRHRH"), sampled=False)
    value = evaluate_schedule(PlanPolicy.of(study.plan, "plan"), one, "HRHRH")
    often = {name: float(n) for name, n in re.findall(r"'([^']+)' (\d+\.\d) times", plan_headlines._acts(study))}
    assert set(often) == {"help", "signal"}
    assert value.costly_actions > 0.5
    assert sum(often.values()) == pytest.approx(value.costly_actions, abs=0.1)


def gates():
    rng = np.random.default_rng(1)
    good, bad = rng.normal(size=(4, 500, 1)), rng.normal(size=(4, 500, 1))
    bad[0] += 5.0
    return convergence_gate(good, ["x"], 0), convergence_gate(bad, ["x"], 0)


def test_plans_under_doubt_say_gain_and_gate(doubt):
    card = SimpleNamespace(stakes="")
    assigned = log_of([(0, 0, "c", [("help", "none"), ("signal", "help"), ("help", "none")])])
    observed = log_of([(0, 0, "c", [("help", "none"), ("signal", "help"), ("no_help", "none")])])
    context = SimpleNamespace(stated=None, origin=Origin.REAL, data=SimpleNamespace(card=card), log=assigned)
    good, bad = gates()
    best = doubt.prices["Bayes-adaptive"]
    for gain, low, high, kind in ((5.0, 2.0, 8.0, "plain"), (5.0, -2.0, 8.0, "open"), (0.0, 0.0, 0.0, "plain")):
        moved = replace(best, gain_mean=gain, gain_q05=low, gain_q95=high)
        prices = replace(doubt.prices, prices=tuple(moved if p is best else p for p in doubt.prices.prices))
        found = plan_headlines.under_doubt(context, replace(doubt, prices=prices), good)
        assert found.kind == kind
        assert ("not decidable" in found.text) == (kind == "open")
        assert ("than never acting, worth" in found.text) == (high == 0.0)
        failed = plan_headlines.under_doubt(context, replace(doubt, prices=prices), bad)
        assert failed.kind == "warning"
        assert "convergence gate FAILED" in failed.text
        # What nobody assigned has no effect to gain from, however sure the draws are.
        context.log = observed
        unsure = plan_headlines.under_doubt(context, replace(doubt, prices=prices), good)
        assert unsure.kind == "open"
        assert unsure.text.endswith("NOT RANDOMISED, so no gain is an effect of acting.")
        assert "RANDOMISED" not in found.text
        context.log = assigned


def test_the_row_of_all_responses_has_an_interval_or_says_that_it_has_none(tmp_path):
    log = log_of([(0, 0, "c", [("signal", "help")])])
    made = build_report(data_set(log), states="1", quick=True, out=tmp_path, sections=some("study"))
    (answer,) = summarised(made.sections)
    assert "1 person in 1 condition, 1 recorded response" in answer.text
    assert "interval" in answer.text
