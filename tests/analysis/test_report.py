import json
import re
import sys
from dataclasses import replace
from html.parser import HTMLParser

import pandas as pd
import pytest

from analysis import datasets
from analysis.cli import main
from analysis.figures.style import axes
from analysis.report.build import build_report
from analysis.report.pdf import available, to_pdf
from analysis.report.registry import SECTIONS, Entry
from analysis.report.section import Figure, NotSupported, Origin, Table, Text
from analysis.report.sections import learned
from models.errors import InputError
from models.protocol import PUBLISHED
from tests.analysis.report_cases import CORRIDOR, data_set, random_log

DATE = "2026-01-31"
WATERMARK = "QUICK: fewer restarts, not for citation"
ALL_SECTIONS = ["provenance", "study", "flow", "states", "model", "reward", "limits"]
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
    log = random_log(CORRIDOR, people=50, stop=0.08)
    out = tmp_path_factory.mktemp("general")
    return build_report(data_set(log), states="1,2", out=out, date=DATE)


@pytest.fixture
def small():
    return data_set(random_log(PUBLISHED, people=20), kind="simulated")


# -- the page --------------------------------------------------------------------------------------
def test_every_section_is_there_in_order(bundled, page):
    assert [s.key for s in bundled.sections] == ALL_SECTIONS
    places = [page.index(f'<section id="{key}"') for key in ALL_SECTIONS]
    assert places == sorted(places)
    assert all(f'href="#{key}"' in page for key in ALL_SECTIONS)
    assert not [s.key for s in bundled.sections if s.omitted]


@pytest.mark.parametrize("which", ["bundled", "general"])
def test_page_is_self_contained(which, request):
    text = request.getfixturevalue(which).html.read_text(encoding="utf-8")
    parsed = Page(text)
    assert all(link.startswith("#") for link in parsed.links)
    assert {link[1:] for link in parsed.links} <= set(parsed.ids)
    assert not [tag for tag, _ in parsed.tags if tag in ("script", "img", "link", "iframe", "object", "image")]
    assert not re.search(r"url\((?!#)|@import", text)
    assert "default-src 'none'" in text
    assert len(text.encode()) < 5_000_000


@pytest.mark.parametrize("which", ["bundled", "general"])
def test_page_is_accessible(which, request):
    parsed = Page(request.getfixturevalue(which).html.read_text(encoding="utf-8"))
    assert len(parsed.ids) == len(set(parsed.ids))
    assert ("html", {"lang": "en"}) in parsed.tags
    assert parsed.headings[0] == 1
    assert parsed.headings.count(1) == 1
    assert all(b - a <= 1 for a, b in zip(parsed.headings, parsed.headings[1:], strict=False))
    drawings = [attrs for tag, attrs in parsed.tags if tag == "svg"]
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
    assert [attrs for attrs, text in cells if text == "−560.23"] == [' class="number printed"']
    columns = [t for s in bundled.sections for t in s.tables if t.printed]
    assert {t.key for t in columns} == {"conditions", "criteria", "reward-values"}
    assert all(Origin.PRINTED in t.origin for t in columns)


def test_simulated_people_are_called_so_everywhere(bundled, page):
    assert "nobody took part" in page
    assert "nothing here says anything about people" in " ".join(bundled.sections[-1].sentences)
    for item in datasets.card("simulated_study1").what_not:
        assert item in bundled.sections[-1].sentences


def test_provenance_names_everything(bundled, page):
    text = page[page.index('<section id="provenance"') : page.index('<section id="study"')]
    dataset = datasets.load("simulated_study1")
    for wanted in (dataset.digest, dataset.card.licence, DATE, "numpy", "SQUAREM", "20,000 maps", "1e-08"):
        assert wanted in text


def test_models_of_shown_states_are_open_and_limits_follow(bundled, page):
    assert '<section class="part" id="model-4">' in page
    assert "4 states (the paper's number)" in " ".join(page.replace("&#39;", "'").split())
    for k, found in bundled.study.identifications.items():
        assert set(found.sentences()) <= set(bundled.sections[-1].sentences), k
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


# -- other studies ---------------------------------------------------------------------------------
def test_general_protocol(general):
    text = general.html.read_text(encoding="utf-8")
    assert "mean response score" in text
    assert "help rate" not in text
    assert {s.key: s.omitted for s in general.sections if s.omitted}.keys() == {"reward"}
    assert "This section is left out." in text
    assert "protocol &#39;corridor&#39; has others" in text
    assert "with one state there is nothing to move between" in text
    assert "560.23" not in text
    assert general.study.bootstraps[general.study.best_by_bic].replicates == 200


def test_dropout_is_tested_where_there_is_any(general, bundled):
    flow = next(s for s in general.sections if s.key == "flow")
    assert "dropout" in [t.key for t in flow.tables]
    assert "chi-squared" in " ".join(flow.sentences)
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
    made = build_report(small, states="1", quick=True, out=tmp_path, sections=[*SECTIONS, extra])
    text = made.html.read_text(encoding="utf-8")
    assert [s.key for s in made.sections] == [*ALL_SECTIONS, "extra"]
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


def test_same_seed_same_bytes_apart_from_the_date(small, tmp_path):
    pages = []
    for i, date in enumerate((DATE, DATE, "2027-02-01")):
        made = build_report(small, states="2", quick=True, out=tmp_path / str(i), date=date)
        pages.append(made.html.read_text(encoding="utf-8"))
    assert pages[0] == pages[1]
    assert pages[0] == pages[2].replace("2027-02-01", DATE)


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
def run(capsys, *arguments):
    with pytest.raises(SystemExit) as caught:
        main([str(a) for a in arguments])
    captured = capsys.readouterr()
    return caught.value.code or 0, captured.out, captured.err


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


def test_a_folder_that_cannot_be_one_is_refused_before_any_work(capsys, tmp_path):
    (tmp_path / "file").write_text("x")
    status, _, err = run(capsys, "report", "--quick", "--out", tmp_path / "file")
    assert status == 2
    assert "--out" in err
