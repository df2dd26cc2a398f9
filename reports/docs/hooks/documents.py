"""Documents of the repository as pages, and sections of the README inside pages: each word has one home.

``<!-- README: Limits -->`` on a line of its own stands for that section of README.md, without its heading;
``<!-- README -->`` for what precedes its first section. Links between documents become links between pages.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from mkdocs.exceptions import PluginError
from mkdocs.structure.files import File, Files

ROOT = Path(__file__).resolve().parents[3]

DOCUMENTS = {
    "architecture.md": "ARCHITECTURE.md",
    "contributing.md": "CONTRIBUTING.md",
    "data.md": "data/README.md",
    "reports.md": "reports/README.md",
}
"""Page and the document it shows."""

PLACE = re.compile(r"^<!-- README(?:: (.+?))? -->$", flags=re.MULTILINE)
LINK = re.compile(r"(\]\()((?!\w+:|#)[^)\s]+)(\))")
MODULES = re.compile(r"^\| module \|.*?(?=^\S(?<!\|))", flags=re.MULTILINE | re.DOTALL)
FENCE = re.compile(r"^```(\w+) ([\w./]+)$", flags=re.MULTILINE)


def section(readme: str, title: str | None) -> str:
    """A section of the README; without a title what precedes the first.

    Raises
    ------
    PluginError
        If there is no such section.
    """
    first, *others = re.split(r"^## ", readme, flags=re.MULTILINE)
    if title is None:
        return first.split("\n", 1)[1].strip()
    for part in others:
        heading, _, body = part.partition("\n")
        if heading == title:
            return body.strip()
    raise PluginError(f"README.md has no section {title!r}")


def linked(markdown: str, folder: str) -> str:
    """Links of a document in `folder` of the repository as links of a page at the top of the site."""

    def target(found: re.Match[str]) -> str:
        name, _, anchor = found[2].partition("#")
        path = (ROOT / folder / name).resolve().relative_to(ROOT).as_posix()
        pages = {document: page for page, document in DOCUMENTS.items()}
        if path in pages:
            page = pages[path]
        elif path.startswith("reports/docs/pages/"):
            page = path.removeprefix("reports/docs/pages/")
        elif path.endswith(".ipynb"):
            page = path.removesuffix(".ipynb") + ".md"
        else:
            # Not part of the site: the name stays, without a link that leads nowhere.
            return f"]({found[2]}){{ .outside }}"
        return f"{found[1]}{page}{'#' * bool(anchor)}{anchor}{found[3]}"

    markdown = LINK.sub(target, markdown)
    return re.sub(r"\[([^\]]+)\]\([^)]*\)\{ \.outside \}", r"\1", markdown)


def document(name: str) -> str:
    """A document as a page. The module table of ARCHITECTURE.md is the index of the reference already."""
    content = (ROOT / name).read_text(encoding="utf-8")
    content = linked(FENCE.sub(r'```\1 title="\2"', content), Path(name).parent.as_posix())
    if name == "ARCHITECTURE.md":
        content = MODULES.sub("The [API reference](reference/index.md) lists them.\n\n", content)
    return content


def on_files(files: Files, config: Any, **_: Any) -> Files:
    """Add the documents."""
    for page, name in DOCUMENTS.items():
        files.append(File.generated(config, page, content=document(name)))
    return files


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Put sections of the README into their places."""
    if page.file.src_uri in DOCUMENTS or not PLACE.search(markdown):
        return markdown
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    return PLACE.sub(lambda found: linked(section(readme, found[1]), "."), markdown)
