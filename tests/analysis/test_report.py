"""The report: a quick one on the bundled study, and a full one on people under another protocol."""

import re
from dataclasses import replace

import pytest

from analysis import datasets, fits
from analysis.report.build import build_report
from analysis.report.effort import Effort
from analysis.report.section import Origin, Question
from analysis.report.summary import summarised
from analysis.uncertainty import KNOWN, PARTLY
from tests.analysis.report_cases import CORRIDOR, data_set, random_log, real_effort, small_study, some
from tests.analysis.report_page import ALL_SECTIONS, Page

pytestmark = pytest.mark.usefixtures("short_reports")
DATE = "2026-01-31"
WATERMARK = "QUICK: fewer restarts, not for citation"


@pytest.fixture(scope="module")
def bundled(tmp_path_factory):
    out = tmp_path_factory.mktemp("bundled")
    return build_report(datasets.load("simulated_study1"), states=(2, 4), quick=True, out=out, date=DATE)


@pytest.fixture(scope="module")
def page(bundled):
    return bundled.html.read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def general(tmp_path_factory):
    """A full report on a study with three modes and three responses, some of whose people leave."""
    return general_report(tmp_path_factory.mktemp("general"))


def general_report(out):
    log = random_log(CORRIDOR, people=50, stop=0.08)
    return build_report(data_set(log, run_length="fixed"), states="1,2", out=out, date=DATE)


def limits_of(result):
    (section,) = [s for s in result.sections if s.key == "limits"]
    return section


def test_every_section_is_there_in_order(bundled, page):
    assert [s.key for s in bundled.sections] == ALL_SECTIONS
    places = [page.index(f'<section id="{key}"') for key in ALL_SECTIONS]
    assert places == sorted(places)
    assert all(f'href="#{key}"' in page for key in ALL_SECTIONS)
    assert [s.key for s in bundled.sections if s.omitted] == ["people", "held-out"]  # minutes of work


@pytest.mark.parametrize("which", ["bundled", "general"])
def test_page_is_self_contained(which, request):
    text = request.getfixturevalue(which).html.read_text(encoding="utf-8")
    parsed = Page(text)
    assert all(link.startswith("#") for link in parsed.links)
    assert {link[1:] for link in parsed.links} <= set(parsed.ids)
    assert not [tag for tag, _ in parsed.tags if tag in ("script", "img", "link", "iframe", "object", "image")]
    assert not re.search(r"url\((?!#)|@import", text)
    assert "default-src 'none'" in text
    assert len(text.encode()) < 4_000_000


@pytest.mark.parametrize("which", ["bundled", "general"])
def test_page_is_accessible(which, request):
    parsed = Page(request.getfixturevalue(which).html.read_text(encoding="utf-8"))
    assert len(parsed.ids) == len(set(parsed.ids))
    assert ("html", {"lang": "en"}) in parsed.tags
    assert parsed.headings[0] == 1
    assert parsed.headings.count(1) == 1
    assert all(b - a <= 1 for a, b in zip(parsed.headings, parsed.headings[1:], strict=False))
    elements = [attrs for tag, attrs in parsed.tags if tag == "svg"]
    drawings = [attrs for attrs in elements if attrs.get("aria-hidden") != "true"]
    assert len(drawings) == len(elements) - 1, "one element is not seen, the letters that all drawings share"
    assert drawings
    assert all(a["role"] == "img" and len(a["aria-label"]) > 20 for a in drawings)


@pytest.mark.parametrize("which", ["bundled", "general"])
def test_every_figure_and_table_states_its_origin(which, request):
    result = request.getfixturevalue(which)
    parsed = Page(result.html.read_text(encoding="utf-8"))
    shown = [b for s in result.sections for b in (*s.figures, *s.tables)]
    assert len(parsed.captions) == len(shown) > 10
    known = {f"badge-{o.key}" for o in Origin}
    assert all(badges and set(badges) <= known for badges in parsed.captions)
    other = {"badge-real", "badge-unstated" if which == "bundled" else "badge-simulated"}
    assert not other & {b for badges in parsed.captions for b in badges}


def test_printed_numbers_stand_apart(bundled, page):
    cells = re.findall(r"<t[dh]([^>]*)>([^<]*)</t[dh]>", page)
    found = [attrs for attrs, text in cells if text == "−560.23"]
    assert found.count(' class="number printed"') == 1
    assert set(found) == {' class="number printed"', ' class="printed"'}
    columns = [t for s in bundled.sections for t in s.tables if t.printed]
    assert {t.key for t in columns if not t.key.startswith("paper-")} == {
        "conditions", "criteria", "reward-values", "regression-sources", "anova-printed", "anova-printed-tukey",
        "power-sizes", "study2-anova", "study2-claims-table", "study2-tukey-team-performance",
        "study2-tukey-observation", "study2-game-table", "sensitivity-findings-2", "sensitivity-findings-4",
    }  # fmt: skip
    assert all(Origin.PRINTED in t.origin for t in columns)


def test_simulated_people_are_called_so_everywhere(bundled, page):
    assert "nobody took part" in page
    assert "nothing here says anything about people" in " ".join(limits_of(bundled).sentences)
    for item in datasets.card("simulated_study1").what_not:
        assert item in limits_of(bundled).sentences


def test_provenance_names_everything(bundled, page):
    text = page[page.index('<section id="provenance"') : page.index('<section id="study"')]
    text += page[page.index('<section id="appendix"') :]
    dataset = datasets.load("simulated_study1")
    for wanted in (dataset.digest, dataset.card.licence, DATE, "numpy", "SQUAREM", "20,000 maps", "1e-08"):
        assert wanted in text


def test_models_of_shown_states_are_open_and_limits_follow(bundled, page):
    assert '<section class="part" id="model-4">' in page
    assert "4 states (the paper's number)" in " ".join(page.replace("&#39;", "'").split())
    for k, found in bundled.study.identifications.items():
        assert set(found.sentences()) <= set(limits_of(bundled).sentences), k
    assert bundled.study.bootstraps[4].replicates == 20
    assert "20 replicates" in page


def test_a_report_answers_every_question_with_a_number_and_how_sure_it_is(bundled):
    answers = summarised(bundled.sections)
    assert list(dict.fromkeys(a.question for a in answers)) == list(Question)
    for answer in answers:
        assert Origin.SIMULATED in answer.origin
        assert len(re.findall(r"\d+(?:\.\d+)?", answer.text)) >= 2, answer.question
        assert len(answer.text) < 420
    page = bundled.html.read_text(encoding="utf-8")
    ids = set(re.findall(r' id="([^"]+)"', page))
    assert {a.key for a in answers} <= ids
    assert page.index("In short") < page.index("<nav") < page.index('<section id="study"')
    assert page.count('class="badge badge-simulated"', 0, page.index("<nav")) == 1 + len(answers)


def test_numbers_of_the_summary_are_those_of_the_tables(bundled):
    # Without the sections that know better than these what states and plans are worth.
    known = [s for s in bundled.sections if s.key not in ("comparison", "robust")]
    answers = {a.question: a.text for a in summarised(known) if a.about in ("", "4 states")}
    tables = {t.key: t.frame for s in bundled.sections for t in s.tables}
    criteria = tables["criteria"].set_index("states")
    lead = criteria["bic"].sort_values()
    told = f"BIC is lowest at {lead.index[0]} states, by {lead.iloc[1] - lead.iloc[0]:.1f}"
    assert told in answers[Question.STATES]
    odds = tables["regression-odds"].set_index("term")
    for term, row in odds.iterrows():
        difference = 100 * (row["with"] - row["without"])
        assert f"{difference:+.1f} with '{term.replace('_', ' ')}' (95% interval" in answers[Question.EFFECT]
    learned = tables["posterior-4"]["contraction"].dropna()
    sure, prior = int((learned > KNOWN).sum()), int((learned < PARTLY).sum())
    told = f"Of {len(learned)} entries of the tables {sure} are known from the data and {prior} mostly prior"
    assert told in answers[Question.KNOWN]
    values = tables["plan-values-4"].set_index("policy")["value"]
    assert f"worth {values['best plan']:.4g} " in answers[Question.PLAN]
    differs = int(tables["paper-differs"]["agreement"].str.startswith("differs").sum())
    assert f"{differs} differ and" in answers[Question.PAPER]


def test_watermark_is_in_quick_reports_only(page, general):
    full = general.html.read_text(encoding="utf-8")
    assert page.count(WATERMARK) == 2
    assert "<title>QUICK" in page
    assert "QUICK" not in full
    assert "not for citation" not in full


def test_text_of_a_card_is_escaped(tmp_path):
    small = small_study()
    dataset = replace(small, card=replace(small.card, title="<script>alert(1)</script> & more"))
    only = some("provenance", "limits")
    made = build_report(dataset, states="1", quick=True, out=tmp_path, sections=only)
    assert "<script" not in made.html.read_text(encoding="utf-8")


def test_a_quick_report_takes_no_more_of_anything(monkeypatch):
    real_effort(monkeypatch)
    quick, full = (vars(Effort.of(is_quick)) for is_quick in (True, False))
    assert all(quick[name] <= full[name] for name in full if name != "quick")
    assert quick != {**full, "quick": True}


@pytest.mark.slow
def test_reports_of_real_effort_have_every_section_too(tmp_path, monkeypatch):
    """The tests above take little effort: here is as much as every report takes."""
    real_effort(monkeypatch)
    monkeypatch.setattr(fits, "store_folder", lambda: tmp_path / "store")
    quick = build_report(
        datasets.load("simulated_study1"), states=(2, 4), quick=True, out=tmp_path / "quick", date=DATE
    )
    assert [s.key for s in quick.sections if s.omitted] == ["people", "held-out"]
    full = general_report(tmp_path / "full")
    assert {s.key for s in full.sections if s.omitted} == {
        "reward",
        "plan",
        "robust",
        "sensitivity",
        "safeguards",
        "study2",
        "paper",
        "evidence",
        "regression",
        "power",
    }
    assert WATERMARK not in full.html.read_text(encoding="utf-8")
    assert full.study.bootstraps[full.study.best_by_bic].replicates == 200


def test_general_protocol(general):
    text = general.html.read_text(encoding="utf-8")
    assert "mean response score" in text
    assert "help rate" not in text
    assert {s.key: s.omitted for s in general.sections if s.omitted}.keys() == {
        "reward",
        "plan",
        "robust",
        "sensitivity",
        "safeguards",
        "study2",
        "paper",
        "evidence",
        "regression",
        "power",
    }
    assert "This section is left out." in text
    assert "protocol &#39;corridor&#39; has others" in text
    assert "with one state there is nothing to move between" in text
    assert "560.23" not in text
    assert general.study.bootstraps[general.study.best_by_bic].replicates == 200


def test_dropout_is_tested_where_there_is_any(general, bundled):
    flow = next(s for s in general.sections if s.key == "flow")
    assert "dropout" in [t.key for t in flow.tables]
    assert "generalised Mantel-Haenszel test" in " ".join(flow.sentences)
    assert "still-going" in [f.key for f in flow.figures]
    text = bundled.html.read_text(encoding="utf-8")
    assert "every run has 5 events" in text
    assert "no run was cut short" in text


def test_a_file_that_does_not_say_so_is_neither_real_nor_simulated(general):
    text = general.html.read_text(encoding="utf-8")
    assert "nothing states whether its people are real or simulated" in text
