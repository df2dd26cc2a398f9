"""The executed notebooks as pages: prose and code as Markdown, outputs as they were stored, nothing run.

Figures become files of their own beside the page; tables and other HTML are put in as they are, without their
styles. Scripts outside a page are refused: a notebook's interactive parts carry all they need.
"""

from __future__ import annotations

import json
import re
from base64 import b64decode
from html import escape
from pathlib import Path
from typing import Any

from mkdocs.exceptions import PluginError
from mkdocs.structure.files import File, Files

ROOT = Path(__file__).resolve().parents[3]
FOLDER = ROOT / "notebooks"

STYLE = re.compile(r"<style scoped>.*?</style>\s*", flags=re.DOTALL)
OUTSIDE = re.compile(r"<(?:script|link|img|iframe)\b[^>]*(?:src|href)=[\"']?(?:https?:)?//", flags=re.IGNORECASE)
CONTROL = re.compile(r"\x1b\[[0-9;]*[A-Za-z]")
LINK = re.compile(r"\]\((?:\./)?(\w+)\.ipynb(#[\w-]+)?\)")
WIDTH = re.compile(r'<svg[^>]*\bwidth="([\d.]+)pt"')
PLACE = re.compile(r'<div data-output="(\d+)"></div>')

_outputs: dict[str, list[str]] = {}
"""HTML of the outputs by page: put in after Markdown is done with the rest."""


def text(field: str | list[str]) -> str:
    """A field of a notebook, which may be a list of lines."""
    return field if isinstance(field, str) else "".join(field)


class Conversion:
    """One notebook on its way to a page.

    Attributes
    ----------
    markdown : list of str
    outputs : list of str
        HTML for the places that `markdown` leaves open.
    pictures : dict of str to bytes
        Files beside the page.
    """

    def __init__(self, stem: str, notebook: dict[str, Any]) -> None:
        self.stem = stem
        self.markdown: list[str] = []
        self.outputs: list[str] = []
        self.pictures: dict[str, bytes] = {}
        for cell in notebook["cells"]:
            if cell["cell_type"] == "markdown":
                self.markdown.append(LINK.sub(r"](\1.md\2)", text(cell["source"])))
            elif cell["cell_type"] == "code" and text(cell["source"]).strip():
                self.markdown.append(f"```python\n{text(cell['source']).rstrip()}\n```")
                self._put(cell.get("outputs", []))

    def _place(self, content: str) -> None:
        self.markdown.append(f'<div data-output="{len(self.outputs)}"></div>')
        self.outputs.append(content)

    def _put(self, outputs: list[dict[str, Any]]) -> None:
        for i, output in enumerate(outputs):
            kind = output["output_type"]
            if kind == "stream":
                self._place(f'<pre class="output">{escape(CONTROL.sub("", text(output["text"])))}</pre>')
            elif kind in ("display_data", "execute_result"):
                following = outputs[i + 1].get("data", {}) if i + 1 < len(outputs) else {}
                self._data(output["data"], text(following.get("text/markdown", "")))
            else:
                raise PluginError(f"notebook {self.stem}: an output of type {kind!r}; run the notebooks anew")

    def _data(self, data: dict[str, Any], caption: str) -> None:
        if "image/svg+xml" in data:
            self._picture("svg", text(data["image/svg+xml"]).encode(), caption)
        elif "image/png" in data:
            self._picture("png", b64decode(text(data["image/png"])), caption)
        elif "text/html" in data:
            found = STYLE.sub("", text(data["text/html"]))
            if OUTSIDE.search(found):
                raise PluginError(f"notebook {self.stem}: an output loads something from outside")
            self._place(f'<div class="output">{found}</div>')
        elif "text/markdown" in data:
            self.markdown.append(text(data["text/markdown"]))
        else:
            self._place(f'<pre class="output">{escape(text(data["text/plain"]))}</pre>')

    def _picture(self, ending: str, content: bytes, caption: str) -> None:
        name = f"{self.stem}_{len(self.pictures) + 1}.{ending}"
        self.pictures[name] = content
        words = escape(re.sub(r"[*_`$]", "", caption).strip() or "figure", quote=True)
        wide = WIDTH.search(content[:2000].decode(errors="ignore")) if ending == "svg" else None
        # On a narrow screen a wide figure scrolls rather than shrinks to nothing.
        least = f' style="min-width: min(34rem, {wide[1]}pt)"' if wide else ""
        self._place(
            f'<div class="output"><img class="figure" loading="lazy" src="{name}" alt="{words}"{least}></div>'
        )


def stems() -> list[str]:
    """Notebooks in order."""
    return sorted(path.stem for path in FOLDER.glob("[0-9]*.ipynb"))


def title(notebook: dict[str, Any]) -> str:
    """The first heading up to its colon."""
    (first,) = re.findall(r"^# (.+)$", text(notebook["cells"][0]["source"]), flags=re.MULTILINE)[:1]
    return str(first).split(":")[0]


def read(stem: str) -> dict[str, Any]:
    """One notebook."""
    content: dict[str, Any] = json.loads((FOLDER / f"{stem}.ipynb").read_text(encoding="utf-8"))
    return content


def index() -> str:
    """The page that lists the notebooks."""
    lines = [
        "# Notebooks", "",
        "Executed essays, each with a question, the data, the model in symbols, figures with how to read them, and "
        "what not to conclude. They are in the folder `notebooks/`; `make notebooks` runs them anew. Below they "
        "stand as they were stored.", "",
    ]  # fmt: skip
    for stem in stems():
        notebook = read(stem)
        (heading,) = re.findall(r"^# (.+)$", text(notebook["cells"][0]["source"]), flags=re.MULTILINE)[:1]
        lines.append(f"1. [{heading}]({stem}.md)")
    return "\n".join(lines) + "\n"


def on_config(config: Any, **_: Any) -> Any:
    """Put the pages into the navigation."""
    for entry in config.nav:
        if entry.get("Notebooks") == "notebooks/":
            pages = [{f"{int(s[:2])} {title(read(s))}": f"notebooks/{s}.md"} for s in stems()]
            entry["Notebooks"] = ["notebooks/index.md", *pages]
    return config


def on_files(files: Files, config: Any, **_: Any) -> Files:
    """Add pages and pictures."""
    files.append(File.generated(config, "notebooks/index.md", content=index()))
    for stem in stems():
        made = Conversion(stem, read(stem))
        _outputs[f"notebooks/{stem}.md"] = made.outputs
        files.append(File.generated(config, f"notebooks/{stem}.md", content="\n\n".join(made.markdown) + "\n"))
        for name, content in made.pictures.items():
            files.append(File.generated(config, f"notebooks/{name}", content=content))
    return files


def on_page_content(html: str, page: Any, **_: Any) -> str:
    """Put the outputs into their places."""
    outputs = _outputs.get(page.file.src_uri)
    return html if outputs is None else PLACE.sub(lambda found: outputs[int(found[1])], html)
