import json
import re
import sys
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pandas as pd
import pytest

from analysis import datasets, fits
from analysis.figures.style import axes
from analysis.report import build
from analysis.report.build import build_report
from analysis.report.effort import Effort
from analysis.report.pdf import available, to_pdf
from analysis.report.registry import SECTIONS, Entry
from analysis.report.section import Figure, NotSupported, Origin, Table, Text
from analysis.report.sections import learned, learned_tables
from models.errors import InputError
from models.protocol import PUBLISHED
from tests.analysis.command import run_captured as run
from tests.analysis.event_text import text as event_text
from tests.analysis.report_cases import CORRIDOR, data_set, little_effort, log_of, random_log, real_effort

DATE = "2026-01-31"
WATERMARK = "QUICK: fewer restarts, not for citation"
ALL_SECTIONS = [
    "provenance", "study", "flow", "states", "model", "uncertainty", "comparison", "people", "held-out",
    "regression", "anova", "power", "reward", "plan", "robust", "sensitivity", "safeguards", "study2", "paper",
    "evidence", "limits", "appendix",
]  # fmt: skip
VOID = {"meta", "br", "path", "use", "rect", "img", "hr"}


class Page(HTMLParser):
    """What the tests want to know of a page."""

    def __init__(self, text):
        super().__init__()
        self.tags, self.ids, self.links, self.badges = [], [], [], []
        self.headings, self.stack, self.captions = [], [], []
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        attrs = dict(attrs)
        self.tags.append((tag, attrs))
        if "id" in attrs:
            self.ids.append(attrs["id"])
        self.links += [v for k, v in attrs.items() if k in ("src", "href", "xlink:href", "data", "action")]
        if re.fullmatch(r"h[1-6]", tag):
            self.headings.append(int(tag[1]))
        if tag == "figcaption" or attrs.get("class") == "caption":
            self.captions.append([])
        if "badge" in attrs.get("class", "").split() and self.captions:
            self.captions[-1].append(attrs["class"].split()[-1])


@pytest.fixture(scope="module", autouse=True)
def own_store(tmp_path_factory):
    """Posteriors of these small studies are nobody else's, and short."""
    folder = tmp_path_factory.mktemp("store")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(fits, "store_folder", lambda: folder)
        little_effort(patch)
        yield


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


@pytest.fixture
def small():
    return data_set(random_log(PUBLISHED, people=20), kind="simulated")


def limits_of(result):
    (section,) = [s for s in result.sections if s.key == "limits"]
    return section


# -- the page --------------------------------------------------------------------------------------
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


def test_watermark_is_in_quick_reports_only(page, general):
    full = general.html.read_text(encoding="utf-8")
    assert page.count(WATERMARK) == 2
    assert "<title>QUICK" in page
    assert "QUICK" not in full
    assert "not for citation" not in full


def test_estimates_outside_their_own_interval_are_called_undetermined(small, tmp_path):
    def elsewhere(context):
        bootstrap = context.study.bootstraps[context.study.best_by_bic]
        moved = replace(bootstrap, emission=bootstrap.emission[:, :, ::-1])
        study = replace(context.study, bootstraps={context.study.best_by_bic: moved})
        return learned.make(replace(context, study=study))

    people = data_set(random_log(PUBLISHED, people=150), kind="simulated")
    made = build_report(people, states="2", quick=True, out=tmp_path, sections=[Entry("x", "X", elsewhere)])
    assert any("estimates lie outside their own interval" in s for s in made.sections[0].sentences)


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


# -- other studies ---------------------------------------------------------------------------------
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


def test_random_run_lengths_are_no_dropout(small, tmp_path):
    dataset = data_set(random_log(PUBLISHED, people=20, stop=0.3), run_length="random")
    only = [e for e in SECTIONS if e.key == "flow"]
    made = build_report(dataset, states="1", quick=True, out=tmp_path, sections=only)
    text = made.html.read_text(encoding="utf-8")
    assert "random by design" in text
    assert "runs cut short" not in text


PLANNED = [(i, 0, "c", [("signal", "help" if i % 2 else "no_help")] * (1 + i % 3)) for i in range(24)]


@pytest.mark.parametrize(
    ("run_length", "dropout"),
    [
        ("unstated", "run lengths differ by what may be design; say so on the data card or with --run-length"),
        ("random", "run lengths are random by design"),
        ("fixed", None),
    ],
)
def test_run_lengths_that_may_be_design_are_not_called_dropout(tmp_path, run_length, dropout):
    only = [e for e in SECTIONS if e.key == "flow"]
    dataset = data_set(log_of(PLANNED), run_length=run_length)
    made = build_report(dataset, states="1", quick=True, out=tmp_path, sections=only)
    text = made.html.read_text(encoding="utf-8")
    assert ("runs cut short" in text) == ("Mantel-Haenszel" in text) == (dropout is None)
    if dropout:
        assert dropout in " ".join(text.split())


def test_run_length_of_the_command_line_goes_before_the_card(capsys, tmp_path, monkeypatch):
    seen = []

    def stop(dataset, **options):
        seen.append((dataset.card.run_length, options["command"]))
        raise InputError("enough")

    monkeypatch.setattr(build, "build_report", stop)
    for given in ((), ("--run-length", "random")):
        assert run(capsys, "report", "--out", tmp_path, *given)[0] == 2
    assert [length for length, _ in seen] == ["unstated", "random"]
    assert "--run-length random" in seen[1][1]


def test_one_of_each_is_said_in_the_singular(tmp_path):
    only = [e for e in SECTIONS if e.key in ("provenance", "study", "flow", "states", "model", "limits")]
    log = log_of([(0, 0, "c", [("signal", "help")])])
    made = build_report(data_set(log), states="1", quick=True, out=tmp_path, sections=only)
    text = " ".join(made.html.read_text(encoding="utf-8").split())
    for wanted in ("1 person in 1 condition, 1 run and 1 event", "1 person and 1 run.", "every run has 1 event,"):
        assert wanted in text
    assert not re.search(r"\b1 (people|runs|events|states|responses|rounds)\b", text)


def test_the_printed_value_stands_beside_its_own_design_only(tmp_path):
    only = [e for e in SECTIONS if e.key == "states"]
    people = data_set(random_log(PUBLISHED, people=20), kind="simulated")
    made = build_report(people, states="1,4", quick=True, out=tmp_path, sections=only)
    assert "560.23" not in made.html.read_text(encoding="utf-8")
    (criteria,) = [t for t in made.sections[0].tables if t.key == "criteria"]
    assert "printed" not in criteria.frame


def test_what_a_chain_that_falls_apart_does_in_the_long_run_is_left_open(tmp_path):
    def pinned(context):
        return learned_tables.states(context, 2)

    people = data_set(random_log(PUBLISHED, people=40))
    made = build_report(
        people, states="2", quick=True, pins=["help"], out=tmp_path, sections=[Entry("x", "X", pinned)]
    )
    (table,) = made.sections[0].tables
    assert table.frame["stationary help"].isna().all()
    assert "not unique under" in table.caption
    assert "the chain falls apart" in table.caption


def test_dwell_times_at_the_edge_are_not_ranked():
    assert learned_tables.dwell_order(np.array([1.0, 2.0])) is None
    assert learned_tables.dwell_order(np.array([5.0, np.inf])) is None
    assert learned_tables.dwell_order(np.array([5.0, 1e9])) is None
    assert learned_tables.dwell_order(np.array([5.0, 1.2, 2.0])).tolist() == [1, 2, 0]


def test_real_people(shared, tmp_path, monkeypatch):
    monkeypatch.setenv("PROSOCIAL_DATA", str(shared / "data" / "real"))
    made = build_report(datasets.load("frd2012"), states="1,2", quick=True, out=tmp_path)
    text = made.html.read_text(encoding="utf-8")
    parsed = Page(text)
    assert "These data are REAL" in text
    assert "badge-simulated" not in {b for badges in parsed.captions for b in badges}
    assert "condition bc4_e8: 90 of 384 people" in text
    assert "random by design" in text
    assert "held fixed" in text
    assert "no evidence" in text
    assert made.study.fits[2].log_likelihood == pytest.approx(-1122.61, abs=0.01)
    # The printed log-likelihood belongs to four states, which were not asked for.
    assert "560.23" not in text


def test_a_file_that_does_not_say_so_is_neither_real_nor_simulated(general):
    text = general.html.read_text(encoding="utf-8")
    assert "nothing states whether its people are real or simulated" in text


# -- failure ---------------------------------------------------------------------------------------
def entry(*blocks):
    return Entry("extra", "Extra", lambda context: blocks)


def figure(draw):
    return Figure("mine", (draw,), "A caption", ("An alternative text",), (Origin.DEFINITION,))


def test_a_failing_figure_fails_the_report_and_leaves_the_last_one(small, tmp_path):
    def broken():
        raise ZeroDivisionError("no ink")

    (tmp_path / "report.html").write_text("the last good one")
    with pytest.raises(ZeroDivisionError, match="no ink") as caught:
        build_report(small, states="1", quick=True, out=tmp_path, sections=[entry(figure(broken))])
    assert "figure 'mine'" in caught.value.__notes__[0]
    assert [p.name for p in tmp_path.iterdir()] == ["report.html"]
    assert (tmp_path / "report.html").read_text() == "the last good one"


def test_a_failing_section_fails_the_report(small, tmp_path):
    def broken(context):
        raise KeyError("no such thing")

    with pytest.raises(KeyError) as caught:
        build_report(small, states="1", quick=True, out=tmp_path, sections=[Entry("extra", "Extra", broken)])
    assert "section 'extra'" in caught.value.__notes__[0]


def test_a_reason_is_printed_for_what_is_left_out(small, tmp_path):
    def unsupported(context):
        raise NotSupported("the moon is <full>")

    made = build_report(small, states="1", quick=True, out=tmp_path, sections=[Entry("x", "Extra", unsupported)])
    assert made.sections[0].omitted == "the moon is <full>"
    assert "Reason: the moon is &lt;full&gt;." in made.html.read_text(encoding="utf-8")


def test_adding_a_section_is_one_function_and_one_line(small, tmp_path):
    extra = entry(Text("A finding of -3.5 nats."), figure(lambda: axes()))
    some = [e for e in SECTIONS if e.key in ("provenance", "states", "limits")]
    made = build_report(small, states="1", quick=True, out=tmp_path, sections=[*some, extra])
    text = made.html.read_text(encoding="utf-8")
    assert [s.key for s in made.sections] == ["provenance", "states", "limits", "extra", "appendix"]
    assert "A finding of −3.5 nats." in text


def test_two_figures_with_one_key_are_a_mistake(small, tmp_path):
    twice = entry(figure(lambda: axes()), figure(lambda: axes()))
    with pytest.raises(ValueError, match="same key"):
        build_report(small, states="1", quick=True, out=tmp_path, sections=[twice])


def test_parts_without_origin_or_text_cannot_be_made():
    with pytest.raises(ValueError, match="origin"):
        Figure("a", (lambda: axes(),), "caption", ("alt",), ())
    with pytest.raises(ValueError, match="alternative texts"):
        Figure("a", (lambda: axes(),), "caption", (), (Origin.REAL,))
    frame = pd.DataFrame({"x": [1]})
    with pytest.raises(ValueError, match="origin"):
        Table("a", frame, "caption", ())
    with pytest.raises(ValueError, match="printed columns"):
        Table("a", frame, "caption", (Origin.REAL,), printed=("x",))
    with pytest.raises(ValueError, match="no column y"):
        Table("a", frame, "caption", (Origin.REAL,), formats={"y": "d"})


def test_text_of_a_card_is_escaped(small, tmp_path):
    dataset = replace(small, card=replace(small.card, title="<script>alert(1)</script> & more"))
    only = [e for e in SECTIONS if e.key in ("provenance", "limits")]
    made = build_report(dataset, states="1", quick=True, out=tmp_path, sections=only)
    assert "<script" not in made.html.read_text(encoding="utf-8")


def test_same_seed_same_bytes_apart_from_the_date(small, tmp_path, monkeypatch):
    pages = []
    for i, date in enumerate((DATE, "2027-02-01")):
        # Computed twice, not found in the store.
        monkeypatch.setattr(fits, "store_folder", lambda i=i: tmp_path / f"store{i}")
        made = build_report(small, states="2", quick=True, out=tmp_path / str(i), date=date)
        pages.append(made.html.read_text(encoding="utf-8"))
    assert pages[0] != pages[1]
    assert pages[0] == pages[1].replace("2027-02-01", DATE)


# -- PDF -------------------------------------------------------------------------------------------
def test_pdf_without_weasyprint_is_a_plain_message(monkeypatch):
    monkeypatch.setitem(sys.modules, "weasyprint", None)
    with pytest.raises(InputError, match="install the extra `pdf`"):
        to_pdf("<p>x</p>")


def test_pdf(small, tmp_path):
    if not available():
        pytest.skip("WeasyPrint, an optional extra, is not installed")
    only = [e for e in SECTIONS if e.key in ("provenance", "flow")]
    made = build_report(small, states="1", quick=True, out=tmp_path, sections=only, pdf=True)
    assert made.pdf.read_bytes().startswith(b"%PDF-")


# -- command line ----------------------------------------------------------------------------------
def test_command(capsys, tmp_path):
    status, out, err = run(
        capsys, "report", "--states", "2", "--condition", "help+signal", "--quick", "--out", tmp_path, "--seed",
        "3", "--json", "-",
    )  # fmt: skip
    assert status == 0, err
    content = json.loads(out)
    assert content.keys() >= {"html", "pdf", "sections", "seconds"}
    assert content["pdf"] is None
    assert [s["key"] for s in content["sections"]] == ALL_SECTIONS
    assert content["quick"] is True
    assert content["states"] == [2]
    text = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "prosocial report --quick --data simulated_study1 --condition help+signal --states 2 --seed 3" in text
    assert "condition help+signal: 164 of 540 people" in text
    assert "not for citation" in err


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--data", "nonsense"), "registered data set"),
        (("--condition", "nonsense"), "--condition"),
        (("--states", "two"), "--states"),
        (("--pin", "dance"), "--pin"),
    ],
)
def test_unusable_arguments(capsys, tmp_path, arguments, message):
    status, _, err = run(capsys, "report", "--quick", "--out", tmp_path / "new", *arguments)
    assert status == 2
    assert message in err
    assert "Traceback" not in err
    assert not (tmp_path / "new").exists()


def test_what_is_read_is_never_overwritten(capsys, tmp_path):
    path = tmp_path / "two.csv"
    path.write_text(event_text())
    status, _, err = run(capsys, "report", "--data", path, "--json", path, "--out", tmp_path / "new")
    assert (status, err) == (2, f"prosocial: --json: found '{path}', wanted another file than --data\n")
    page = tmp_path / "report.html"
    page.write_text(event_text())
    status, _, err = run(capsys, "report", "--data", page, "--out", tmp_path)
    assert status == 2
    assert "--out, report.html: found" in err
    status, _, err = run(capsys, "report", "--protocol", page, "--out", tmp_path)
    assert "wanted another file than --protocol" in err
    assert path.read_text() == page.read_text() == event_text()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--out", ""), "--out: found '', wanted the name of a folder"),
        (("--out", "/proc/new"), "/proc, where no file can be made"),
        (("--run-length", "long"), "--run-length: found 'long', wanted random or fixed"),
    ],
)
def test_options_are_checked_before_any_work(capsys, arguments, message):
    status, _, err = run(capsys, "report", "--quick", *arguments)
    assert status == 2
    assert message in err


def test_a_folder_that_cannot_be_one_is_refused_before_any_work(capsys, tmp_path):
    (tmp_path / "file").write_text("x")
    status, _, err = run(capsys, "report", "--quick", "--out", tmp_path / "file")
    assert status == 2
    assert "--out" in err
