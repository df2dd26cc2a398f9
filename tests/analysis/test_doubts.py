"""What is said of fits that cannot be relied on, of flat likelihoods, and of people who played for no tokens."""

import json
from dataclasses import replace

import pytest

from analysis import datasets
from analysis.report.build import build_report
from analysis.report.doubts import told_above
from analysis.report.registry import SECTIONS
from analysis.report.section import Figure, Origin, Part, Points, Text
from analysis.report.sections import robust, robust_endless, safeguards, sensitivity
from analysis.result_content import Given, to_content
from analysis.result_reading import from_content
from analysis.sensitivity import SensitivityEffort
from analysis.stakes import other_stakes, stakes_of_fit
from models.baum_welch import BaumWelch
from models.cautions import BEGINS, caution_line
from models.identification import identification
from models.model_files import model_to_dict
from models.planning.baselines import never
from models.planning.evaluation import evaluate_schedule
from models.planning.schedule import Schedule
from models.protocol import PUBLISHED
from models.robust.candidates import standard_candidates
from models.robust.contested import flip_points
from models.robust.pricing import price
from tests.analysis.command import result_of, run
from tests.analysis.draws_cases import failed, fit_file, fit_of, people
from tests.analysis.report_cases import data_set, little_effort, log_of, random_log
from tests.models.planning.policy_cases import person

PLANNING = ("plan", "robust", "sensitivity", "safeguards")
MONEY = "money in a prisoner's dilemma, in which nobody collected a token"


def two_rounds(people=24):
    """People with one response each, after one act of help or none."""
    runs = []
    for i in range(people):
        events = [("help" if i % 2 else "no_help", "none"), ("no_signal", "help" if i % 3 else "no_help")]
        runs.append((i, 0, "helped" if i % 2 else "not helped", events))
    return log_of(runs)


def sections_of(out, log, keys, states=(2,), **card):
    made = build_report(
        data_set(log, kind="simulated", **card), states=states, quick=True, out=out, date="2026-01-31",
        sections=[e for e in SECTIONS if e.key in keys],
    )  # fmt: skip
    return made, {s.key: s for s in made.sections}


def warnings_of(blocks):
    return [b.text for b in blocks if isinstance(b, Text) and b.kind == "warning"]


@pytest.fixture(scope="module")
def doubtful(tmp_path_factory):
    """Sections that plan, of people who played for money, with a posterior and a search that are not done."""
    with pytest.MonkeyPatch.context() as patch:
        little_effort(patch)
        for module, name, few in (
            (robust, "QUICK_DRAWS", 20), (robust, "QUICK_REPLICATES", 4), (robust_endless, "QUICK_DRAWS", 4),
            (safeguards, "QUICK_DRAWS", 6),
        ):  # fmt: skip
            patch.setattr(module, name, few)
        few_draws = SensitivityEffort(
            endless_draws=2, endless_variants=2, endless_critical=1, endless_certain=1, few_draws=20,
            few_critical=10, scan=5, endless_scan=3, moved=False,
        )  # fmt: skip
        patch.setattr(sensitivity, "QUICK", few_draws)
        plain = BaumWelch.fit

        def short(self, *args, **options):
            return plain(replace(self, max_maps=2, screening_maps=1), *args, **options)

        patch.setattr(BaumWelch, "fit", short)
        log = random_log(PUBLISHED, people=40)
        made, found = sections_of(tmp_path_factory.mktemp("doubt"), log, PLANNING, (2, 3), stakes=MONEY)
        assert not any(fit.converged for fit in made.study.fits.values())
        yield made, found


@pytest.mark.slow
@pytest.mark.parametrize("key", PLANNING)
def test_doubt_stands_beside_the_first_numbers_and_once(doubtful, key):
    _, found = doubtful
    shown = found[key]
    assert shown.omitted is None
    part = next(b for b in shown.blocks if isinstance(b, Part))
    first = [b for b in part.blocks if isinstance(b, Text)][:2]
    said = " ".join(b.text for b in first if b.kind == "warning")
    assert ("Convergence gate FAILED" in said) == (key != "plan")
    assert ("Baum-Welch did not converge within 2 EM maps" in said) == (key != "safeguards")
    assert BEGINS not in " ".join(shown.sentences + [text for f in shown.figures for text in f.alt])


@pytest.mark.slow
def test_other_priors_and_other_numbers_of_states_are_doubted_too(doubtful):
    _, found = doubtful
    said = " ".join(warnings_of(found["sensitivity"].flat()))
    assert "With 2 and 3 states Baum-Welch did not converge: do not rely on these rows." in said
    assert "The convergence gate FAILED at kappa 0" in said


@pytest.mark.slow
@pytest.mark.parametrize("key", PLANNING)
def test_who_played_for_money_is_said_at_the_head(doubtful, key):
    _, found = doubtful
    head = [b.text for b in found[key].blocks if isinstance(b, Text)]
    assert sum(text.startswith(f"These people played for {MONEY}.") for text in head) == 1


def test_actions_that_nobody_assigned_are_warned_of_at_the_head(tmp_path, monkeypatch):
    little_effort(monkeypatch)
    monkeypatch.setattr("analysis.report.sections.plan.planned_states", lambda context: ())
    played = {
        "assigned": ([("help", "none"), ("signal", "help")], [("no_help", "none"), ("signal", "no_help")]),
        "observed": ([("help", "none"), ("no_help", "none"), ("signal", "help")],
                     [("no_help", "none"), ("help", "none"), ("signal", "no_help")]),
    }  # fmt: skip
    for name, (one, other) in played.items():
        people = [(i, 0, "a" if i < 6 else "b", one if i < 6 else other) for i in range(12)]
        _, found = sections_of(tmp_path / name, log_of(people), ("plan",), states=(2,))
        warned = [text for text in warnings_of(found["plan"].blocks) if text.startswith("NOT RANDOMISED")]
        assert len(warned) == (name == "observed")
        if warned:
            assert "mode h" in warned[0].lower()
            assert "no effect of acting" in warned[0]


def test_flat_likelihoods_are_warned_of_where_tables_are_shown(tmp_path, monkeypatch):
    little_effort(monkeypatch)
    log = two_rounds()
    made, found = sections_of(tmp_path, log, ("model", "limits"), states=(2, 3))
    own = made.study.identifications[2]
    assert own.mostly_flat
    assert f"along {own.deficiency} directions the likelihood is flat" in own.flat_sentence
    shown = found["model"]
    assert isinstance(shown.blocks[0], Text)
    heads = warnings_of(shown.blocks)
    assert heads[0].endswith(own.flat_sentence)
    assert len(heads) == len([b for b in shown.blocks if isinstance(b, Part) and not b.folded])
    for part in (b for b in shown.blocks if isinstance(b, Part) and b.folded):
        assert "the likelihood is flat" in warnings_of(part.blocks)[0]
    assert own.flat_sentence in found["limits"].sentences


def test_a_study_that_tells_its_tables_apart_is_not_warned_of(tmp_path, monkeypatch):
    little_effort(monkeypatch)
    log = random_log(PUBLISHED, people=80)
    own = identification(BaumWelch(2, restarts=2, finalists=1).fit(log), log)
    assert not own.mostly_flat
    assert (own.flat_sentence == "") == (own.deficiency == 0)
    _, found = sections_of(tmp_path, log, ("model",))
    assert not any("flat" in text for text in warnings_of(found["model"].blocks))


def test_what_stands_above_is_not_repeated_below():
    line = caution_line(("x",))
    text = f"Worth 3. {line}"
    figure = Figure("f", (lambda: None,), "a caption", (text,), (Origin.SIMULATED,))
    part = Part("part", "p", (Text(text, "note"), Points((text, "other"), "lead"), figure))
    (clean,) = told_above((part,), ("x",))
    note, points, drawn = clean.blocks
    assert (note.text, note.kind) == ("Worth 3.", "note")
    assert points.items == ("Worth 3.", "other")
    assert drawn.alt == ("Worth 3.",)
    assert told_above((part,), ()) == (part,)


def test_results_are_kept_with_their_cautions():
    draws = fit_of(people(4), gate=failed()).draws()
    schedule = Schedule.of(draws, "HR")
    results = {
        "prices": price(schedule, standard_candidates(schedule)), "flips": flip_points(schedule),
        "value": evaluate_schedule(never(PUBLISHED), schedule),
    }  # fmt: skip
    given = Given({"schedule": schedule})
    node, arrays = to_content(results, given)
    again = from_content(json.loads(json.dumps(node)), arrays, given)
    assert again["prices"].sentence == results["prices"].sentence
    assert again["prices"].cautions == again["value"].cautions == again["flips"][0].cautions == draws.cautions != ()
    # The same numbers from draws that can be relied on are another computation.
    sure = Schedule.of(replace(draws, cautions=()), "HR")
    assert Given({"schedule": sure}).digest != given.digest
    assert Given({"schedule": Schedule.of(draws, "HR")}).digest == given.digest


def test_only_cards_that_say_so_are_about_something_else_than_tokens():
    assert MONEY in other_stakes(datasets.card("frd2012"))
    assert other_stakes(datasets.card("simulated_study1")) == ""
    assert other_stakes(data_set(two_rounds()).card) == ""
    assert stakes_of_fit({"data": "frd2012"}) == other_stakes(datasets.card("frd2012"))
    for unknown in (None, {}, {"data": "mine.csv"}, {"data": ["frd2012"]}, "frd2012"):
        assert stakes_of_fit(unknown) == ""


def test_the_console_says_what_people_played_for(tmp_path, capsys):
    fit = fit_file(tmp_path / "fit.nc", people(4, 2), provenance={"data": "frd2012"})
    for command in ("robust", "safeguard"):
        assert run(command, fit, "--schedule", "HR") == 0
        assert capsys.readouterr().out.count(f"states. These people played for {MONEY}. Values here are in") == 1
    model = tmp_path / "model.json"
    content = model_to_dict(person()) | {"provenance": {"data": "frd2012"}}
    model.write_text(json.dumps(content))
    for way in (("--schedule", "HR"), ("--infinite",)):
        assert run("plan", model, *way) == 0
        assert capsys.readouterr().out.count(MONEY) == 1
    assert result_of(capsys, "plan", model, "--schedule", "HR")["stakes"].startswith("These people played for")
    # A reward of somebody's own is not the paper's.
    content["reward"] = {"x": [0.0, 0.5, 1.0], "r": 1.0}
    model.write_text(json.dumps(content))
    assert result_of(capsys, "plan", model, "--schedule", "HR")["stakes"] == ""


def test_the_console_repeats_cautions_once(tmp_path, capsys):
    line = caution_line(("the posterior failed its convergence gate",))
    fit = fit_file(tmp_path / "fit.nc", people(4, 2), gate=failed())
    for command in ("robust", "safeguard"):
        assert run(command, fit, "--force", "--schedule", "HR") == 0
        assert capsys.readouterr().out.count(line) == 1
    found = result_of(capsys, "robust", fit, "--force", "--schedule", "HR")
    assert found["cautions"] == ["the posterior failed its convergence gate"]
    model = tmp_path / "model.json"
    model.write_text(json.dumps(model_to_dict(person()) | {"cautions": ["it is a guess"]}))
    for way in (("--schedule", "HR"), ("--infinite",)):
        assert run("plan", model, *way) == 0
        assert capsys.readouterr().out.count("CAUTION: it is a guess; do not rely on these numbers.") == 1
    assert result_of(capsys, "plan", model, "--schedule", "HR")["cautions"] == ["it is a guess"]
