"""Every printed number beside ours: that none is missing, and that the words follow from the numbers."""

import copy
import re
from dataclasses import replace

import pytest
from scipy.stats import f as f_distribution

from analysis import fits
from analysis.datasets import load
from analysis.design import published
from analysis.em_study import run_em
from analysis.evidence import Evidence, read_evidence
from analysis.paper_agreement import Agreement, Word, as_printed
from analysis.paper_inconsistencies import inconsistencies
from analysis.paper_model import em_numbers, reward_numbers
from analysis.paper_numbers import (
    NO_EVIDENCE,
    Basis,
    Check,
    Estimate,
    Ours,
    PaperNumber,
    counts,
    estimates,
    paper_numbers,
)
from analysis.paper_regression import regression_numbers
from analysis.paper_study1 import study1_numbers
from analysis.paper_study2 import study2_numbers
from analysis.paper_study2_claims import study2_claims
from analysis.printed_anova import MEASURES
from analysis.report.build import build_report
from analysis.report.registry import SECTIONS
from analysis.report.section import Origin
from analysis.simulate import calibrated_truth
from models.baum_welch import BaumWelch
from models.errors import InputError
from models.protocol import PUBLISHED
from tests.analysis.report_cases import CORRIDOR, data_set, little_effort, random_log

ONLY = [entry for entry in SECTIONS if entry.key == "paper"]

NOT_NUMBERS = {"source", "sequence_letters", "formula", "policies", "claims", "inconsistencies_noted", "reported",
               "columns", "modes", "p", "interaction", "prior", "initial_belief", "form", "sequence"}  # fmt: skip


def study_of(log, states=(4, 5)):
    return run_em(log, states, settings=lambda k: BaumWelch(k, restarts=8, finalists=3, rounds=1, max_maps=300))


@pytest.fixture(scope="module")
def ours():
    study = study_of(load("simulated_study1").log)
    return Ours(published(), replace(study, paper_fits=study.fits), True, calibrated_truth())


@pytest.fixture(scope="module")
def rows(ours):
    return paper_numbers(ours)


def row_of(rows, quantity):
    (row,) = [r for r in rows if r.quantity == quantity]
    return row


def changed(ours, path, value):
    """The same with another printed number."""
    content = copy.deepcopy(dict(ours.published))
    place = content
    for key in path[:-1]:
        place = place[key]
    place[path[-1]] = value
    return replace(ours, published=content)


QUICK = (study1_numbers, regression_numbers, em_numbers, reward_numbers)


def numbers(ours, makers=QUICK):
    """Rows of some topics: Table II and the sensitivity analysis take most of the time."""
    return [row for make in makers for row in make(ours)]


def word_of(ours, quantity, basis=None, makers=QUICK):
    row = row_of(numbers(ours, makers), quantity)
    if basis is None:
        return row.agreement.word
    return next(c.agreement.word for c in row.checks if c.basis is basis)


# -- completeness ----------------------------------------------------------------------------------
def leaves(content, path=()):
    if isinstance(content, dict):
        for key, value in content.items():
            if key not in NOT_NUMBERS:
                yield from leaves(value, (*path, key))
    elif isinstance(content, list):
        for value in content:
            yield from leaves(value, path)
    elif isinstance(content, int | float):
        yield path, content


def test_every_published_number_is_in_a_row(rows):
    told = " ".join(f"{r.quantity} {r.printed}" for r in rows)
    tokens = set(re.findall(r"−?\d+(?:\.\d+)?", told.replace("%", "")))
    numbers = {float(t.replace("−", "-")) for t in tokens}
    missing = [
        (path, value) for path, value in leaves(published())
        if value not in numbers and round(100 * value, 6) not in numbers
    ]  # fmt: skip
    assert not missing


def test_every_claim_condition_policy_and_figure_is_in_a_row(rows):
    printed = [r.printed for r in rows]
    for claim in published()["claims"]:
        assert claim in printed
    told = " ".join(f"{r.quantity} {r.printed}" for r in rows)
    study1, study2 = published()["study1"], published()["study2"]
    for name in (*study1["conditions"], *study1["sequences"], *study2["policies"], study2["sequence"]):
        assert name in told
    assert {f"Fig. {n}" for n in range(1, 6)} | {"Table I", "Table II"} <= {r.place for r in rows}


def test_names_are_unique_where_numbers_are_printed(rows):
    numbers = [(r.topic, r.quantity) for r in rows if r.quantity not in ("conclusion", "finding", "statement")]
    assert len(numbers) == len(set(numbers))


def test_details_are_sections_of_the_report(rows, ours):
    keys = {entry.key for entry in SECTIONS}
    assert {check.detail for row in rows for check in row.checks} <= keys
    assert {row.detail for row in inconsistencies(ours)} <= keys


# -- words follow from numbers ---------------------------------------------------------------------
def test_printed_numbers_that_contradict_each_other(rows):
    found = {r.quantity for r in rows if r.agreement.word is Word.CONTRADICTS}
    assert found == {"the robot's helping: z", "helping against the null: ΔAIC"}


@pytest.mark.parametrize(
    ("path", "value", "quantity", "word"),
    [
        (("study1", "glmm", "help_vs_null", "delta_aic"), -41.87, "helping against the null: ΔAIC", Word.ROUNDING),
        (("study1", "glmm", "help", "z"), 6.41, "the robot's helping: z", Word.ROUNDING),
        (("study1", "glmm", "help", "ci95"), [5.09, 23.0], "the robot's helping: 95% interval of the odds ratio",
         Word.CONTRADICTS),
        (("study1", "glmm", "signal", "p"), "<0.05", "signalling: p", Word.CONTRADICTS),
        (("study1", "conditions", "help+signal"), 165, "participants", Word.CONTRADICTS),
        (("study1", "demographics", "male"), 310, "people who identify as male", Word.CONTRADICTS),
        (("study2", "mixed_anova", "observation", "policy", "p"), 0.0163, "observed help, policy: p",
         Word.CONTRADICTS),
        (("study2", "mixed_anova", "observation", "policy", "df"), 5, "degrees of freedom, policy",
         Word.CONTRADICTS),
        (("study2", "tukey_minus_lspomdp", "observation", "reactive"), [-0.044, 0.2],
         "observed help, reactive less ls-POMDP: adjusted p", Word.CONTRADICTS),
        (("study2", "rounds"), 8, "rounds", Word.CONTRADICTS),
    ],
)  # fmt: skip
def test_printed_checks_see_a_changed_number(ours, path, value, quantity, word):
    found = numbers(changed(ours, path, value), QUICK if path[0] == "study1" else (study2_numbers,))
    (check,) = [
        c for r in found if r.quantity == quantity and (quantity != "rounds" or r.topic.startswith("Study 2"))
        for c in r.checks if c.basis is Basis.PRINTED and "men and women" not in c.ours
    ]  # fmt: skip
    assert check.agreement.word is word


def test_p_values_of_table_1_against_another_tail_function(rows):
    for r in rows:
        if r.quantity.endswith(": p") and r.place == "Table I":
            (check,) = r.checks
            f = float(row_of(rows, r.quantity[:-1] + "F").printed)
            df1 = 1 if ", time" in r.quantity else 4
            assert float(check.ours.split(",")[0].replace("−", "-")) == pytest.approx(
                f_distribution.sf(f, df1, 95), rel=0.06
            )


def test_own_numbers_printed_agree_within_rounding(ours):
    own = ours.regression.odds_ratios.loc["robot_help"]
    value = round(float(own["estimate"]), 2)
    found = changed(ours, ("study1", "glmm", "help", "odds_ratio"), value)
    assert word_of(found, "the robot's helping: odds ratio") is Word.ROUNDING
    assert word_of(
        changed(ours, ("study1", "glmm", "help", "odds_ratio"), 0.1), "the robot's helping: odds ratio"
    ) is (Word.DIFFERS)
    best = ours.study.fits[4].log_likelihood
    quantity = "log-likelihood with 4 states"
    for value, word in ((round(best, 2), Word.ROUNDING), (best - 400, Word.DIFFERS)):
        moved = changed(ours, ("em", "log_likelihood_4_states"), value)
        assert word_of(moved, quantity, Basis.DATA) is word


def test_simulated_designs_are_taken_over_and_others_agree(ours):
    quantity = "people, help+signal"
    assert word_of(ours, quantity) is Word.TAKEN
    assert word_of(replace(ours, simulated=False), quantity) is Word.AGREES
    assert word_of(changed(ours, ("study1", "conditions", "help+signal"), 165), quantity) is Word.DIFFERS


def test_sums_over_people_do_not_compare_between_sizes(ours):
    found = numbers(changed(ours, ("study1", "participants"), 541))
    for quantity in ("signalling: z", "log-likelihood with 4 states"):
        (check,) = [c for c in row_of(found, quantity).checks if c.basis is Basis.DATA]
        assert "grows with the number of people, 540 here and 541" in check.agreement.why


# -- stored evidence -------------------------------------------------------------------------------
def test_without_evidence_replications_cannot_be_checked(ours):
    found = numbers(replace(ours, evidence=lambda name: None), (*QUICK, study2_numbers, study2_claims))
    checks = [c for r in found for c in r.checks if c.basis is Basis.REPLICATIONS]
    assert len(checks) > 20
    assert {c.agreement.word for c in checks} == {Word.UNCHECKED}
    assert any(c.agreement.why == NO_EVIDENCE for c in checks)


@pytest.mark.parametrize("name", ["recovery", "game", "study2"])
def test_replications_of_other_sizes_are_not_compared(ours, name):
    assert ours.stored(name) is not None
    study = "study2" if name == "study2" else "study1"
    assert changed(ours, (study, "participants"), 77).stored(name) is None


def test_printed_numbers_are_held_against_the_quantiles_of_replications(ours):
    stored = read_evidence("study2")
    number = next(
        r for r in stored.content["numbers"]
        if r["learning"] == "em" and r["planner"] == "ls-POMDP" and r["number"] == "F observation, policy"
    )  # fmt: skip
    for q05, q50, q95, word in ((2.0, 2.5, 3.0, Word.COMPATIBLE), (3.0, 3.5, 4.0, Word.DIFFERS)):
        moved = [{**r, "q05": q05, "q50": q50, "q95": q95} if r is number else r for r in stored.content["numbers"]]
        content = {**stored.content, "numbers": moved}
        found = replace(
            ours, evidence=lambda name, c=content: Evidence(stored.path, c) if name == "study2" else None
        )
        assert word_of(found, "observed help, policy: F", makers=(study2_numbers,)) is word


# -- inconsistencies -------------------------------------------------------------------------------
def test_every_inconsistency_is_shown_and_its_check_can_fail(ours):
    noted = inconsistencies(ours)
    assert [row.noted for row in noted] == published()["inconsistencies_noted"]
    assert [row.word for row in noted] == ["shown"] * len(noted)
    mended = {
        0: (("study2", "mixed_anova", "observation", "policy", "p"), 0.0163),
        1: (("study2", "tukey_minus_lspomdp", "team_performance", "reactive"), [-5.19, 0.004]),
        2: (("study2", "tukey_minus_lspomdp", "team_performance", "always"), [-0.027, 1.0]),
        3: (("study2", "sequence"), "HRHRHRHR"),
        4: (("study1", "glmm", "help", "odds_ratio"), 1.05),
        5: (("study1", "glmm", "help", "odds_ratio"), 1),
    }
    for i, (path, value) in mended.items():
        assert inconsistencies(changed(ours, path, value))[i].shown is False
    with pytest.raises(InputError, match="one for each check"):
        inconsistencies(changed(ours, ("inconsistencies_noted",), ["one"]))


def test_actions_that_vary_within_a_person_are_counted(ours):
    log = random_log(PUBLISHED, people=30)
    found = inconsistencies(replace(ours, study=replace(ours.study, log=log)))[-1]
    assert found.shown is False
    assert not found.check.startswith("0 of")


# -- the section -----------------------------------------------------------------------------------
def made_of(dataset, folder, states):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(fits, "store_folder", lambda: folder)
        little_effort(patch)
        return build_report(dataset, states=states, quick=True, out=folder / "out", sections=ONLY).sections[0]


@pytest.fixture(scope="module")
def section(tmp_path_factory):
    return made_of(load("simulated_study1"), tmp_path_factory.mktemp("store"), (2, 4))


def test_the_section_counts_what_its_tables_hold(section):
    tables = {t.key: t for t in section.tables}
    first = re.findall(r"\d+", section.sentences[0])
    printed, total, agree, rounded, alike, differ, contradict, open_, unchecked, taken = map(int, first[:10])
    assert total == agree + alike + differ + contradict + open_ + unchecked + taken
    assert rounded <= agree
    assert total < printed
    frame = tables["paper-differs"].frame
    contradicting = frame["agreement"].str.startswith("printed numbers contradict")
    assert int(contradicting.sum()) == contradict
    assert int(frame["agreement"].str.startswith("differs").sum()) == differ
    assert contradicting.to_list() == sorted(contradicting, reverse=True)
    topics = [t.frame for key, t in tables.items() if key.startswith("paper-topic")]
    everything = sum(len(f.drop_duplicates(["quantity", "printed"])) for f in topics)
    assert everything >= printed


def test_every_table_says_what_its_numbers_are(section):
    for table in section.tables:
        assert Origin.PRINTED in table.origin
        kinds = {"printed": Origin.DEFINITION, "project": Origin.DEFINITION, "truth": Origin.DEFINITION,
                 "data": Origin.SIMULATED, "replications": Origin.SIMULATED}  # fmt: skip
        if table.key.startswith("paper-topic"):
            assert set(table.origin) == {Origin.PRINTED, kinds[table.key.rsplit("-", 1)[1]]}
    assert "nothing about people" in " ".join(section.sentences)


def test_the_figure_draws_what_has_a_distance(section):
    assert [figure.key for figure in section.figures] == ["paper-distances-study1", "paper-distances-study2"]
    for figure in section.figures:
        (panel,) = figure.drawn()
        labels = [t.get_text() for t in panel.get_yticklabels()]
        assert len(labels) > 10
        assert all(label in figure.alt[0] for label in labels)


@pytest.mark.parametrize(
    ("log", "reason"),
    [
        (random_log(CORRIDOR, people=20), "protocol 'corridor' has others"),
        (random_log(PUBLISHED, people=20), "these data have others"),
    ],
)
def test_other_studies_have_no_such_section(log, reason, tmp_path):
    made = build_report(data_set(log), states="1", quick=True, out=tmp_path, sections=ONLY)
    assert reason in made.sections[0].omitted


@pytest.mark.parametrize(
    ("kind", "words"),
    [("simulated", "a model that does not come with them"), ("real", "Other people can be compatible within")],
)
def test_other_people_of_the_same_design(kind, words, tmp_path):
    """Somebody's own study 1: its design is a finding unless simulated, and no truth is known."""
    bundled = load("simulated_study1")
    section = made_of(replace(bundled, card=replace(bundled.card, name="mine", kind=kind)), tmp_path, (2,))
    assert words in section.sentences[1]
    tables = {t.key: t for t in section.tables}
    assert not [key for key in tables if key.endswith("-truth")]
    design = tables["paper-topic-1-data"]
    assert design.origin == (Origin.REAL if kind == "real" else Origin.SIMULATED, Origin.PRINTED)[::-1]
    word = design.frame.set_index("quantity").loc["people, help+signal (Sec. IV-A)", "agreement"]
    assert word == ("agrees" if kind == "real" else "taken over")
    unfitted = tables["paper-topic-9-data"].frame["agreement"]
    assert unfitted.str.startswith("cannot be checked").all()


# -- estimates -------------------------------------------------------------------------------------
def test_an_estimate_is_counted_once_however_often_it_is_printed(rows):
    found = estimates(rows)
    together = [one for one in found if len(one.rows) > 1]
    names = {one.rows[0].estimate: [row.quantity for row in one.rows] for one in together}
    assert len(names["the robot's helping"]) == 7
    assert [q.rpartition(": ")[2] for q in names["signalling"]] == [
        "odds ratio", "95% interval of the odds ratio", "z", "p", "trend",
    ]  # fmt: skip
    tests = [one for one in together if one.rows[0].place in ("Table I", "Table II")]
    study2 = published()["study2"]
    effects = [(k, e) for k, own in study2["mixed_anova"].items() for e in own]
    compared = [(k, p) for k, own in study2["tukey_minus_lspomdp"].items() for p in own if k in MEASURES]
    assert len(tests) == len(effects) + len(compared)
    assert all(len(one.rows) == 2 for one in tests)
    assert [row for one in found for row in one.rows if len(one.rows) == 1] == [r for r in rows if not r.estimate]


def test_the_worst_row_speaks_for_an_estimate():
    def row(quantity, *words, estimate="e", topic="t"):
        checks = tuple(Check("1", Basis.DATA, Agreement(word), "study") for word in words)
        return PaperNumber(topic, "p", quantity, "1", checks, estimate)

    rows = [
        row("a: x", Word.COMPATIBLE), row("alone", Word.AGREES, estimate=""),
        row("a: y", Word.AGREES, Word.CONTRADICTS), row("b: y", Word.UNCHECKED),
        row("elsewhere", Word.AGREES, topic="u"), row("alone", Word.DIFFERS, estimate=""),
    ]  # fmt: skip
    found = estimates(rows)
    assert [one.agreement.word for one in found] == [
        Word.CONTRADICTS, Word.AGREES, Word.AGREES, Word.DIFFERS,
    ]  # fmt: skip
    assert found[0] == Estimate((rows[0], rows[2], rows[3]))
    assert found[0].deciding is rows[2]
    assert found[0].others == "x: compatible; b: y: cannot be checked"
    assert found[1].others == ""


def test_counts_add_up(rows):
    assert sum(counts(estimates(rows)).values()) == len(estimates(rows)) < len(rows)
    assert as_printed(published()["em"]["log_likelihood_4_states"]) in {r.printed for r in rows}
