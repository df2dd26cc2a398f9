"""The documentation site: builds without a warning, needs nothing from outside, and holds what it should."""

from __future__ import annotations

import importlib.util
import json
import os
import re
import runpy
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from analysis.cli import main
from analysis.report.analysis_plan import read_analysis_plan

ROOT = Path(__file__).resolve().parents[1]
DOCS = ROOT / "reports" / "docs"
PAGES = DOCS / "pages"
NOTEBOOK_LIMIT = 2_000_000
NEEDED = ("mkdocs", "material", "mkdocstrings", "mkdocstrings_handlers.python", "latex2mathml")


def missing() -> list[str]:
    """Packages of the group `docs` that are not installed."""
    out = []
    for name in NEEDED:
        try:
            found = importlib.util.find_spec(name)
        except ModuleNotFoundError:
            found = None
        out += [] if found else [name]
    return out


needs_mkdocs = pytest.mark.skipif(bool(missing()), reason=f"not installed: {', '.join(missing())} (group `docs`)")


def hook(name: str) -> ModuleType:
    """One of the site's hooks as a module."""
    spec = importlib.util.spec_from_file_location(f"docs_{name}", DOCS / "hooks" / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


# -- the page of the command line ------------------------------------------------------------------
def test_the_command_page_is_not_stale() -> None:
    made = runpy.run_path(str(DOCS / "commands.py"))["page"]()
    stored = (PAGES / "commands.md").read_text(encoding="utf-8")
    assert stored == made, "run `python reports/docs/commands.py`"


def test_the_command_page_has_every_command() -> None:
    page = (PAGES / "commands.md").read_text(encoding="utf-8")
    headings = re.findall(r"^## prosocial (.+)$", page, flags=re.MULTILINE)
    assert {"em", "bayes", "data check", "report", "audit verify", "replicate plans"} <= set(headings)
    assert len(headings) == len(set(headings))


def shown_commands() -> list[tuple[str, str]]:
    """Commands in the code blocks of the pages that people write."""
    found = []
    for path in sorted(PAGES.rglob("*.md")):
        if path.name == "commands.md":
            continue
        for block in re.findall(r"```sh\n(.*?)```", path.read_text(encoding="utf-8"), flags=re.DOTALL):
            found += [(path.name, line) for line in block.splitlines() if line.startswith("prosocial ")]
    return found


@pytest.mark.parametrize(("page", "command"), shown_commands())
def test_commands_on_pages_exist_with_their_options(
    page: str, command: str, capsys: pytest.CaptureFixture[str]
) -> None:
    words = command.split("#")[0].split()[1:]
    depth = 2 if words[0] in ("data", "simulate", "fits", "power", "replicate", "audit") else 1
    with pytest.raises(SystemExit) as stopped:
        main([*words[:depth], "--help"])
    assert not stopped.value.code
    out = capsys.readouterr().out
    assert [w for w in words if w.startswith("--") and w not in out] == []


def test_minimal_file_of_the_first_hour_is_a_valid_log(tmp_path: Path) -> None:
    page = (PAGES / "first_hour.md").read_text(encoding="utf-8")
    (text,) = re.findall(r"```text\n(study,participant.*?)```", page, flags=re.DOTALL)
    (tmp_path / "pilot.csv").write_text(text, encoding="utf-8")
    with pytest.raises(SystemExit) as stopped:
        main(["data", "check", str(tmp_path / "pilot.csv"), "--quiet"])
    assert not stopped.value.code


def test_plan_of_the_first_hour_is_a_valid_analysis_plan(tmp_path: Path) -> None:
    page = (PAGES / "first_hour.md").read_text(encoding="utf-8")
    (text,) = re.findall(r"```toml\n(title.*?)```", page, flags=re.DOTALL)
    (tmp_path / "plan.toml").write_text(text, encoding="utf-8")
    assert read_analysis_plan(tmp_path / "plan.toml").planned[0].results == ("regression", "criteria")


# -- the figure ------------------------------------------------------------------------------------
def test_the_figure_is_small_and_says_whose_data_it_shows() -> None:
    svg = (PAGES / "workbench.svg").read_text(encoding="utf-8")
    assert len(svg) < 300_000
    assert svg.startswith("<svg")
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    (words,) = re.findall(r"!\[([^\]]+)\]\(reports/docs/pages/workbench\.svg\)", readme)
    assert "simulated" in words


@pytest.mark.slow
def test_the_figure_can_be_made_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PROSOCIAL_CACHE", str(tmp_path / "cache"))
    subprocess.run(
        [sys.executable, str(DOCS / "figure.py"), "--fast", "--out", str(tmp_path / "figure.svg")],
        cwd=ROOT, check=True, env=os.environ | {"PYTHONPATH": str(ROOT)},
    )  # fmt: skip
    assert (tmp_path / "figure.svg").read_text(encoding="utf-8").startswith("<svg")


# -- hooks -----------------------------------------------------------------------------------------
@needs_mkdocs
def test_docstrings_become_markdown() -> None:
    markdown = hook("docstrings").markdown
    assert markdown("The score :math:`x_s`\nof a state.") == "The score $x_s$\nof a state."
    assert markdown(".. math:: a = b\n\nNext.").split() == ["$$", "a", "=", "b", "$$", "Next."]
    several = markdown("Before\n\n.. math::\n   a &= b \\\\\n   c &= d\n\nAfter, `models.protocol`.")
    assert "$$\na &= b \\\\\nc &= d\n$$" in several
    assert '<autoref identifier="models.protocol" optional>' in several
    literal = markdown("As JSON::\n\n    {1}\n\nAfter.")
    assert literal == "As JSON:\n\n```text\n{1}\n```\n\nAfter."


@needs_mkdocs
def test_equations_become_mathml_and_unknown_commands_are_refused() -> None:
    from mkdocs.exceptions import PluginError

    equations = hook("equations")
    made = equations.converted('<p><span class="arithmatex">\\(a &lt; b\\)</span></p>')
    assert made.startswith("<p><math")
    assert '<annotation encoding="application/x-tex">a &lt; b</annotation>' in made
    assert "<mtable" in equations.mathml("a &= b \\\\ c &= d", True)
    with pytest.raises(PluginError, match="nosuchcommand"):
        equations.mathml(r"\nosuchcommand{x}", False)


def notebook_of(output: dict[str, object]) -> dict[str, object]:
    return {"cells": [{"cell_type": "code", "source": ["1"], "outputs": [output]}]}


@needs_mkdocs
def test_notebook_outputs_are_kept_and_outside_scripts_refused() -> None:
    from mkdocs.exceptions import PluginError

    made = hook("notebooks").Conversion
    kept = made("a", notebook_of({"output_type": "stream", "text": ["\x1b[1mx < y\x1b[0m"]}))
    assert kept.outputs == ['<pre class="output">x &lt; y</pre>']
    assert kept.markdown == ["```python\n1\n```", '<div data-output="0"></div>']
    for html in ('<script src="https://example.org/x.js"></script>', "<img src=//example.org/x.png>"):
        with pytest.raises(PluginError, match="from outside"):
            made("a", notebook_of({"output_type": "display_data", "data": {"text/html": html}}))
    with pytest.raises(PluginError, match="error"):
        made("a", notebook_of({"output_type": "error", "ename": "ValueError"}))


@needs_mkdocs
def test_every_module_has_one_place_in_the_reference() -> None:
    reference = hook("reference")
    groups, lines = reference.everything()
    placed = [path for members in groups.values() for path in members]
    assert len(placed) == len(set(placed))
    assert set(lines) <= set(placed)
    assert set(placed) == {
        p.relative_to(ROOT).as_posix()
        for folder in ("models", "analysis")
        for p in (ROOT / folder).rglob("*.py")
        if p.name != "__init__.py"
    }


# -- the built site --------------------------------------------------------------------------------
class Sources(HTMLParser):
    """What a page loads by itself, and its anchors."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.loaded: list[str] = []
        self.anchors: set[str] = set()
        self.feed(page)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        found = dict(attrs)
        self.anchors.add(found.get("id") or "")
        if tag in ("script", "img", "iframe", "source", "video", "audio", "embed", "object"):
            self.loaded += [found.get(name) or "" for name in ("src", "srcset", "data") if found.get(name)]
        if tag == "link" and "canonical" not in (found.get("rel") or ""):
            self.loaded.append(found.get("href") or "")


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The site, built strictly."""
    if missing():
        pytest.skip(f"not installed: {', '.join(missing())} (group `docs`)")
    out = tmp_path_factory.mktemp("docs") / "site"
    command = ["-m", "mkdocs", "build", "--strict", "--quiet", "-f", str(DOCS / "mkdocs.yml"), "-d", str(out)]
    done = subprocess.run(
        [sys.executable, *command], capture_output=True, text=True, env=os.environ | {"NO_MKDOCS_2_WARNING": "1"}
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return out


@pytest.fixture(scope="module")
def pages(site: Path) -> dict[str, str]:
    """All pages, by their place."""
    return {p.relative_to(site).as_posix(): p.read_text(encoding="utf-8") for p in site.rglob("*.html")}


def test_nothing_comes_from_outside(site: Path, pages: dict[str, str]) -> None:
    outside = re.compile(r"^(?:[a-z]+:)?//", flags=re.IGNORECASE)
    found = [(name, s) for name, page in pages.items() for s in Sources(page).loaded if outside.match(s)]
    assert found == []
    for sheet in site.rglob("*.css"):
        text = sheet.read_text(encoding="utf-8")
        assert not re.search(r"(?:@import|url\()\s*[\"']?(?:https?:)?//", text), sheet.name


def test_everything_that_is_loaded_is_there(site: Path, pages: dict[str, str]) -> None:
    for name, page in pages.items():
        if name == "404.html":  # its addresses start at the root of a server
            continue
        for source in Sources(page).loaded:
            if not source.startswith("data:"):
                assert ((site / name).parent / source.split("?")[0].split("#")[0]).exists(), (name, source)


def test_the_reference_has_every_module_of_the_architecture(pages: dict[str, str]) -> None:
    table = (ROOT / "ARCHITECTURE.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| `((?:models|analysis)/[\w/]+)\.py` \|", table, flags=re.MULTILINE)
    assert len(rows) > 300
    anchors = set().union(*(Sources(p).anchors for n, p in pages.items() if n.startswith("reference/")))
    assert [r for r in rows if r.replace("/", ".") not in anchors] == []
    for name in (
        "models.baum_welch.BaumWelch.fit",
        "models.robust.cautious.cautious_plan",
        "analysis.datasets.load",
    ):
        assert name in anchors


def test_no_equation_is_left_unwritten(pages: dict[str, str]) -> None:
    for name, page in pages.items():
        assert 'class="arithmatex"' not in page, name
        assert ":math:`" not in page, name
        assert "<autoref" not in page, name
        assert "<!-- README" not in page, name
        assert not re.search(r'md-ellipsis">[^<]*\\\(', page), name
    assert pages["method/model.html"].count("<math") > 10


def test_notebooks_are_whole_and_small(site: Path, pages: dict[str, str]) -> None:
    paths = sorted((ROOT / "notebooks").glob("[0-9]*.ipynb"))
    assert len(paths) >= 8
    for path in paths:
        name = f"notebooks/{path.stem}.html"
        page = pages[name]
        assert len(page) < NOTEBOOK_LIMIT, name
        assert "data-output=" not in page
        cells = json.loads(path.read_text(encoding="utf-8"))["cells"]
        data = [o.get("data", {}) for c in cells for o in c.get("outputs", [])]
        figures = [d for d in data if "image/svg+xml" in d or "image/png" in d]
        assert page.count('<img class="figure"') == len(figures)
        assert page.count("<table") >= sum("<table" in "".join(d.get("text/html", "")) for d in data)


def test_search_works_from_a_folder_without_a_network(browser: Any, site: Path) -> None:
    asked: list[str] = []
    errors: list[str] = []
    context = browser.new_context(viewport={"width": 390, "height": 844}, offline=True)
    page = context.new_page()
    page.on("request", lambda request: asked.append(request.url))
    page.on("pageerror", lambda error: errors.append(str(error)))
    for name in ("index.html", "method/planning.html", "compare.html", "commands.html"):
        page.goto((site / name).as_uri())
        wide = page.evaluate("document.documentElement.scrollWidth - document.documentElement.clientWidth")
        assert wide <= 0, f"{name} is wider than a phone"
    page.set_viewport_size({"width": 1280, "height": 800})
    page.goto((site / "index.html").as_uri())
    page.wait_for_function("typeof __index !== 'undefined'")
    page.click("input[name=query]")
    page.keyboard.type("identification")  # it listens to keys
    page.wait_for_selector(".md-search-result__link", state="attached", timeout=60_000)
    assert "matching" in (page.text_content(".md-search-result__meta") or "")
    context.close()
    assert errors == []
    assert [url for url in asked if not url.startswith(("file:", "data:", "blob:", "about:"))] == []
