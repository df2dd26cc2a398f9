"""How results show themselves in notebooks, and in one line."""

import importlib
import pkgutil
import re
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pandas as pd
import pytest

import analysis
import models
from analysis import datasets, simulate
from analysis.anova import mixed_anova
from analysis.participant_flow import dropout_after_response
from analysis.policy_study import STUDY2, policy_study
from analysis.posthoc import PersonValues, tukey
from analysis.power_printed import printed_sizes
from analysis.repeated_measures import RepeatedMeasures
from analysis.sensitivity import decider_of
from models import notebook_view
from models.baum_welch import BaumWelch
from models.bootstrap import bootstrap_fit
from models.gate import Gate
from models.glmm import LogisticMixedModel
from models.glmm_warnings import MixedModelWarning
from models.identification import identification
from models.lspomdp import LatentStatePOMDP
from models.model_draws import ModelDraws
from models.notebook_view import MOST_ROWS, NotebookView, Rows, View, view_html
from models.planning.evaluation import evaluate_schedule
from models.planning.exact import solve_schedule
from models.planning.latent import latent_problem
from models.planning.plan_policy import PlanPolicy
from models.planning.schedule import Schedule
from models.planning.solver import solve
from models.protocol import PUBLISHED, Action, Mode, Protocol, Response
from models.reward import Reward
from models.robust.candidates import standard_candidates
from models.robust.pricing import price
from models.robust.stability import decision_stability
from models.sensitivity.reward_grid import RewardGrid, decide_grid
from models.standard_errors import standard_errors
from tests.analysis.anova_cases import COLUMNS, study
from tests.analysis.draws_cases import failed, fit_of, people
from tests.analysis.report_cases import CORRIDOR, data_set, log_of, random_log
from tests.planning_cases import sticky_draws

VOID = ("br", "hr", "img", "meta")
EVIL = '<script>alert("x")</script>'


class Balance(HTMLParser):
    """Reads HTML and refuses tags that are not closed in order; keeps text, tags and attributes."""

    def __init__(self):
        super().__init__()
        self.open, self.text, self.tags = [], [], []

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open, f"</{tag}> closes nothing"
        assert self.open.pop() == tag

    def handle_data(self, data):
        if "style" not in self.open:
            self.text.append(data)


def read(page):
    parser = Balance()
    parser.feed(page)
    parser.close()
    assert not parser.open
    return parser


@pytest.fixture(scope="module")
def made():
    """A result of every kind that is quickly made, by name."""
    log = random_log(PUBLISHED, people=60)
    short = BaumWelch(2, restarts=2, finalists=1, screening_maps=2, max_maps=3).fit(log)
    fit = BaumWelch(2, restarts=4, finalists=2).fit(log)
    schedule = Schedule.of(sticky_draws(6, 1), "HRHR")
    plan = solve_schedule(schedule)
    rng = np.random.default_rng(1)
    rows = pd.DataFrame({"who": np.repeat(np.arange(80), 6), "x": rng.normal(size=480)})
    rows["y"] = (rows["x"] + np.repeat(rng.normal(size=80), 6) + rng.logistic(size=480) > 0).astype(int)
    truth = simulate.calibrated_truth()
    one = ModelDraws.from_models([truth])
    grid = RewardGrid.of(one, (0.06, 0.08), (0.0, 15.0))
    table = RepeatedMeasures.from_frame(study(), **COLUMNS)
    out = {
        "event log": log, "data": data_set(log, kind="simulated"), "bundled": datasets.load("simulated_study1"),
        "corridor": random_log(CORRIDOR), "fit": fit, "not converged": short,
        "identification": identification(fit, log), "standard errors": standard_errors(fit, log),
        "bootstrap": bootstrap_fit(fit, log, 3), "model": fit.model, "draws": fit.draws(),
        "posterior": fit_of(people()), "failed posterior": fit_of(people(), gate=failed()), "failed gate": failed(),
        "gate": Gate(0, 1.0, 900.0, 900.0, "initial[s0]", 4, 500),
        "protocol": PUBLISHED, "reward": Reward((45.0, 67.0)), "plan": plan,
        "value": evaluate_schedule(PlanPolicy.of(plan), schedule),
        "prices": price(schedule, standard_candidates(schedule)),
        "stability": decision_stability(schedule, plan), "solution": solve(latent_problem(truth), precision=1e-2),
        "unsolved": replace(solve(latent_problem(truth), precision=1e-2), status="time limit"),
        "policy study": policy_study(truth, STUDY2), "printed": printed_sizes(),
        "regression": LogisticMixedModel.from_formula("y ~ x + (1 | who)", rows).fit(),
        "drop-out": dropout_after_response(random_log(PUBLISHED, stop=0.2)), "anova": mixed_anova(table),
        "tukey": tukey(PersonValues.mean(table)),
        "grid": decide_grid(decider_of("two-step-terminal", one), grid, 1.0),
    }  # fmt: skip
    separated = rows.assign(x=rows["y"] * 1.0)
    with pytest.warns(MixedModelWarning):
        out["separated"] = LogisticMixedModel.from_formula("y ~ x + (1 | who)", separated).fit()
    return out


KINDS = (
    "event log", "data", "bundled", "corridor", "fit", "not converged", "identification", "standard errors",
    "bootstrap", "model", "draws", "posterior", "failed posterior", "failed gate", "gate", "protocol", "reward",
    "plan", "value", "prices", "stability", "solution", "unsolved", "policy study", "printed", "regression",
    "drop-out", "anova", "tukey", "grid", "separated",
)  # fmt: skip


def test_all_kinds_are_looked_at(made):
    assert set(KINDS) == set(made)


@pytest.mark.parametrize("kind", KINDS)
def test_the_page_is_whole_short_and_says_what_the_result_says(made, kind):
    result = made[kind]
    page = result._repr_html_()
    assert len(page) < 50_000
    read_page = read(page)
    text = " ".join(read_page.text)
    view = result._view() if hasattr(result, "_view") else result._results._view()
    assert all(said in text for said in (view.heading, *view.sentences, *view.warnings, *view.notes))
    assert view.sentences or view.warnings
    sentence = getattr(type(result), "sentence", None)
    if isinstance(sentence, property):
        assert result.sentence.partition(". WARNING")[0].rstrip(".") in text
    cells = [attributes for tag, attributes in read_page.tags if tag == "th"]
    assert all(own.get("scope") in ("col", "row") for own in cells)
    assert not [tag for tag, _ in read_page.tags if tag in ("script", "img", "link")]
    assert "color:#" not in page.replace("border-left:.3em solid #", "")


@pytest.mark.parametrize("kind", KINDS)
def test_the_plain_form_is_one_short_line(made, kind):
    line = repr(made[kind])
    if isinstance(made[kind], Protocol | Reward):
        assert line.startswith(f"{type(made[kind]).__name__}(")  # settings: what would make them again
        return
    assert "\n" not in line
    assert len(line) < 320
    assert "array(" not in line


@pytest.mark.parametrize(
    ("kind", "words"),
    [
        ("not converged", "did not converge within 3 EM maps"), ("failed posterior", "3 divergent transitions"),
        ("failed gate", "largest r-hat 1.2"), ("unsolved", "time limit"), ("separated", "SeparationWarning"),
        ("bootstrap", "fewer than 100 replicates"),
    ],
)  # fmt: skip
def test_warnings_come_first(made, kind, words):
    page = made[kind]._repr_html_()
    first = page.index('class="warning"')
    assert words in page
    assert first < page.index("<table") if "<table" in page else first
    paragraphs = re.findall(r"<p[^>]*>", page)
    assert 'class="warning"' in paragraphs[1]
    assert "warning" in repr(made[kind])


def test_parameters_that_nothing_identifies_are_named():
    log = log_of([(i, 0, "all", [("help", "none"), ("signal", "help"), ("help", "none")]) for i in range(12)])
    fit = BaumWelch(2, restarts=2, finalists=1).fit(log)
    page = identification(fit, log)._repr_html_()
    assert "The data say nothing about how the state moves after" in page
    assert page.count('class="warning"') >= 3


def test_whose_numbers_they_are(made):
    assert "simulated: nobody took part" in made["data"]._repr_html_()
    assert "printed in the paper" in made["printed"]._repr_html_()
    assert "real people" in data_set(random_log(PUBLISHED), kind="real")._repr_html_()


def test_long_tables_say_how_many_rows_are_left(made):
    log = made["bundled"].log
    page = log._repr_html_()
    assert page.count("<tr>") == MOST_ROWS + 1
    assert f"{log.n_events - MOST_ROWS:,} more rows in <code>.to_frame()</code>" in page


def test_nothing_of_a_label_becomes_a_tag():
    modes = (Mode(EVIL, "H", (Action(f"a{EVIL}"), Action("b", 1.0)), "b", True),)
    protocol = Protocol(f"p{EVIL}", modes, (Response(f"no{EVIL}", 0.0), Response("yes", 1.0)))
    tables = np.array([0.5, 0.5]), np.full((2, 2, 2), 0.5), np.full((2, 2, 2), 0.5)
    model = LatentStatePOMDP(*tables, protocol, (f"s{EVIL}", "t"))
    card = data_set(random_log(PUBLISHED), title=EVIL, what=EVIL, what_not=(EVIL,))
    table = Rows(pd.DataFrame({EVIL: [EVIL]}), 1, EVIL, EVIL)
    view = View(EVIL, EVIL, (EVIL,), (EVIL,), (EVIL,), (table,), {EVIL: EVIL})
    for page in (protocol._repr_html_(), model._repr_html_(), card._repr_html_(), view_html(view)):
        assert "<script" not in page
        assert "&lt;script&gt;" in page
        read(page)


def test_numbers_are_rounded_by_column_and_tiny_ones_keep_their_digits():
    frame = pd.DataFrame({"log_likelihood": [-1234.5678, 2.0], "p": [1e-5, 2e-6], "share": [0.12345, np.nan]})
    page = view_html(View("x", tables=(Rows(frame, 2),)))
    cells = re.findall(r"<td>(.*?)</td>", page)
    assert cells == ["\N{MINUS SIGN}1,234.57", "1e\N{MINUS SIGN}05", "0.123", "2.00", "2e\N{MINUS SIGN}06",
                     "\N{EN DASH}"]  # fmt: skip
    assert 'log_likelihood <span class="faint">(nats)</span>' in page


def every_class():
    found = {}
    for package in (models, analysis):
        for module in pkgutil.walk_packages(package.__path__, f"{package.__name__}."):
            if ".docs" not in module.name:
                importlib.import_module(module.name)
    left = [NotebookView]
    while left:
        for own in left.pop().__subclasses__():
            if own.__module__.startswith(("models.", "analysis.")):
                found[f"{own.__module__}.{own.__qualname__}"] = own
                left.append(own)
    return found


def test_every_class_has_something_to_show_and_one_home():
    shown = {"table", "summary", "rows", "sentence", "sentences", "text"}
    classes = every_class()
    assert len(classes) > 80
    for name, own in classes.items():
        assert own._repr_html_ is NotebookView._repr_html_, name
        fields = getattr(own, "__dataclass_fields__", {})
        assert "_view" in vars(own) or shown & {*dir(own), *fields}, name
        assert "table" not in fields or "_whose" not in fields


def test_a_result_without_words_shows_its_numbers():
    class Small(NotebookView):
        __slots__ = ()

    assert read(Small()._repr_html_()).text == ["Small"]
    assert repr(Small()) == "<Small: >"
    assert notebook_view.facts(Small()) == {}
