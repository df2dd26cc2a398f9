"""Every dependency has its reason on a page, is used, and everything that is imported is declared."""

import re
import sys
import tomllib
from functools import cache
from importlib import metadata
from pathlib import Path

import pytest
from packaging.requirements import Requirement

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "reports" / "docs" / "pages" / "dependencies.md"
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
GROUPS = PROJECT["dependency-groups"]
OWN = {"models", "analysis", "tests", "commands", "figure", "hooks"}
IMPORTED_AS = {
    "pyyaml": "yaml", "pillow": "PIL", "ipython": "IPython", "griffelib": "griffe",
}  # fmt: skip
"""Packages whose module has another name."""


IMPORT = re.compile(
    r"^\s*from\s+([\w.]+)\s+import\s|^\s*import\s+([\w.]+)(?:\s+as\s+\w+)?\s*(?:#.*)?$"
    r"|(?:import_module|importorskip)\(\s*\"([\w.]+)\"",
    re.MULTILINE,
)
"""An import; parsing every file would take ten seconds."""
WHERE_INSTALLED = {"atheris"}
"""Used only by who has it and asks for it: fuzzing guided by branches."""


def names(requirements):
    return {Requirement(r).name for r in requirements if isinstance(r, str)}


DECLARED = {
    "Needed to run": names(PROJECT["project"]["dependencies"]),
    "Extras": set().union(*map(names, PROJECT["project"]["optional-dependencies"].values())),
    "Development": set().union(*(names(GROUPS[g]) for g in GROUPS if g not in ("dev", "bench"))),
    "Peers": names(GROUPS["bench"]),
}


def table(title):
    """Rows of a table of the page, by their first cell."""
    part = re.search(rf"^## {title}\n(.*?)(?=^## |\Z)", PAGE.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)[
        1
    ]
    rows = [[c.strip() for c in line.strip("|").split("|")] for line in part.splitlines() if line.startswith("|")]
    assert len({len(row) for row in rows}) == 1
    return {row[0]: row for row in rows[2:]}


@cache
def imports(*folders):
    """Third-party modules by the files that import them, inside functions and by name, too."""
    out = {}
    for folder in folders:
        for path in (ROOT / folder).rglob("*.py"):
            found = {a or b or c for a, b, c in IMPORT.findall(path.read_text(encoding="utf-8"))}
            siblings = {p.stem for p in path.parent.glob("*.py")}
            for top in {name.partition(".")[0] for name in found if name[0] != "."} - OWN - siblings:
                if top not in sys.stdlib_module_names:
                    out.setdefault(top, set()).add(path.relative_to(ROOT).as_posix())
    return out


def module_of(package):
    return IMPORTED_AS.get(package, package.replace("-", "_"))


@pytest.mark.parametrize("title", DECLARED)
def test_the_page_lists_what_is_declared(title):
    rows = table(title)
    assert set(rows) == DECLARED[title]
    for name, (_, purpose, _, without, licence, size) in rows.items():
        assert purpose, name
        assert without, name
        assert licence, name
        assert float(size) >= 1, name


@pytest.mark.parametrize("title", DECLARED)
def test_the_page_says_where_each_is_imported(title):
    where = imports("models", "analysis", "tests", "reports/docs")
    for name, row in table(title).items():
        files = re.findall(r"`([\w./]+\.py)`", row[2])
        if "by name" in row[2] or "when asked for" in row[2]:
            for file in files:
                assert module_of(name) in (ROOT / file).read_text(encoding="utf-8"), (name, file)
        elif files:
            assert set(files) <= where.get(module_of(name), set()), name
        else:
            assert row[2].startswith("("), name


def test_what_is_needed_to_run_is_imported_by_what_runs():
    where = imports("models", "analysis")
    for name in DECLARED["Needed to run"]:
        assert where.get(module_of(name)) or name == "h5netcdf", name
    assert 'engine="h5netcdf"' in (ROOT / "models" / "posterior_files.py").read_text()


def test_everything_that_is_imported_is_declared():
    brought = table("Imported, and brought by another package")
    runtime = {module_of(n) for n in DECLARED["Needed to run"] | DECLARED["Extras"]}
    everything = runtime | {module_of(n) for n in DECLARED["Development"] | DECLARED["Peers"]}
    for module, files in imports("models", "analysis", "tests", "reports/docs").items():
        if module.lstrip("_") in everything or module in WHERE_INSTALLED:
            continue
        assert module in brought, f"{module} is imported in {sorted(files)[:3]}, and declared nowhere"
        assert re.search(r"`([^`]+)`", brought[module][2])[1] in files
    parents = {module_of(n) for n in DECLARED["Development"] | DECLARED["Peers"]} | runtime
    for module, (_, parent, _) in brought.items():
        assert module not in everything, f"{module} is declared by now"
        assert parent in parents
        try:
            needs = {Requirement(r).name.lower().replace("-", "_") for r in metadata.requires(parent) or ()}
        except metadata.PackageNotFoundError:
            continue
        assert any(module.lower() in need for need in needs) or parent in ("mkdocstrings", "ipykernel"), module
