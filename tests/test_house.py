"""The house itself: what its documents, lock files and boundaries promise."""

import ast
import re
import runpy
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
import yaml
from packaging.requirements import Requirement

import models
from analysis import datasets

ROOT = Path(__file__).resolve().parents[1]
LOCKS = ("requirements.lock", "requirements-bench.lock")
PYPROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
ARCHITECTURE = (ROOT / "ARCHITECTURE.md").read_text(encoding="utf-8")


def modules(folder):
    return {p.relative_to(ROOT).as_posix() for p in (ROOT / folder).rglob("*.py") if p.name != "__init__.py"}


def git_files():
    """Files that are tracked or would be by `git add`."""
    listed = subprocess.run(
        ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"],
        cwd=ROOT, capture_output=True, check=True, text=True,
    ).stdout  # fmt: skip
    return [ROOT / name for name in listed.split("\0") if name and (ROOT / name).is_file()]


# -- boundaries ------------------------------------------------------------------------------------
def test_models_never_imports_analysis():
    for path in (ROOT / "models").rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            names = [a.name for a in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            assert not [n for n in names if n.split(".")[0] == "analysis"], f"{path.name}, line {node.lineno}"


def test_models_is_the_one_of_this_checkout():
    assert Path(models.__file__).resolve() == ROOT / "models" / "__init__.py"


def test_importing_models_imports_nothing_heavy():
    code = "import sys, models; print([m for m in ('numpy', 'pandas', 'numba', 'scipy') if m in sys.modules])"
    ran = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, check=True, text=True)
    assert ran.stdout.strip() == "[]"


# -- ARCHITECTURE.md -------------------------------------------------------------------------------
def test_architecture_names_every_module_and_no_other():
    rows = re.findall(r"^\| `((?:models|analysis)/[\w/]+\.py)` \| \S", ARCHITECTURE, flags=re.MULTILINE)
    assert len(rows) == len(set(rows))
    assert set(rows) == modules("models") | modules("analysis")


def test_architecture_mentions_only_files_that_exist():
    mentioned = set(re.findall(r"\b(?:models|analysis|tests|notebooks)/[\w/]+\.py\b", ARCHITECTURE))
    assert not [name for name in mentioned if not (ROOT / name).is_file()]


def recipes():
    """Code blocks of each recipe: language, file name (none for Python), text."""
    chapter = ARCHITECTURE.split("\n## Recipes\n")[1].split("\n## ")[0]
    fence = re.compile(r"^```(\w+) ?([\w./]*)\n(.*?)^```$", flags=re.MULTILINE | re.DOTALL)
    found = {s.split("\n", 1)[0]: fence.findall(s) for s in chapter.split("\n### ")[1:]}
    return {title: blocks for title, blocks in found.items() if blocks}


@pytest.mark.parametrize("title", list(recipes()))
def test_recipe_works_as_printed(title, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(datasets, "DATA_FOLDER", tmp_path / "data")
    monkeypatch.setattr(datasets, "REGISTRY", tmp_path / "data" / "registry.json")
    datasets._registry.cache_clear()
    for language, name, text in recipes()[title]:
        path = tmp_path / (name or "recipe.py")
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
        if language == "python":
            runpy.run_path(str(path))
    datasets._registry.cache_clear()


def test_recipes_cover_what_is_added_often():
    assert recipes().keys() >= {"Add a protocol", "Add a data source", "Add a prior"}


# -- Makefile --------------------------------------------------------------------------------------
def test_make_alone_lists_every_target():
    shown = subprocess.run(["make"], cwd=ROOT, capture_output=True, check=True, text=True).stdout
    listed = set(re.findall(r"^  make ([a-z-]+) +\S", shown, flags=re.MULTILINE))
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    assert listed == set(re.search(r"^\.PHONY: (.*)$", makefile, flags=re.MULTILINE)[1].split())
    assert listed >= {"help", "env", "report", "notebooks", "test", "test-all", "lint", "bench", "lock", "clean"}


# -- lock files ------------------------------------------------------------------------------------
def pins(lock):
    """Pinned requirement lines of a lock file, each with its hashes."""
    text = (ROOT / lock).read_text(encoding="utf-8").replace("\\\n", " ")
    lines = [line for line in text.splitlines() if line.strip() and not line.lstrip().startswith("#")]
    return {Requirement(line.split("--hash")[0].strip()): line.split("--hash=")[1:] for line in lines}


def test_locks_pin_everything_by_hash_and_name_no_address():
    for lock in LOCKS:
        assert "://" not in (ROOT / lock).read_text(encoding="utf-8"), lock
        for requirement, hashes in pins(lock).items():
            assert re.fullmatch(r"==[^,*]+", str(requirement.specifier)), requirement
            assert hashes, requirement
            assert all(re.fullmatch(r"sha256:[0-9a-f]{64}\s*", value) for value in hashes), requirement


def test_locks_satisfy_what_the_project_asks_for():
    groups = PYPROJECT["dependency-groups"]
    plain = {name: [r for r in wanted if isinstance(r, str)] for name, wanted in groups.items()}
    asked = list(PYPROJECT["project"]["dependencies"])
    ours = [r for name, wanted in plain.items() if name != "bench" for r in wanted]
    # The Bayesian twin brings a plotting stack along and is installed by whoever wants it.
    optional = PYPROJECT["project"]["optional-dependencies"]
    extras = [r for name, wanted in optional.items() if name != "bayes-twin" for r in wanted]
    for lock, wanted in (
        ("requirements.lock", [*asked, *ours, *extras, *PYPROJECT["build-system"]["requires"]]),
        ("requirements-bench.lock", [*asked, *plain["build"], *plain["bench"]]),
    ):
        versions = {r.name: str(r.specifier).removeprefix("==") for r in pins(lock)}
        for requirement in map(Requirement, wanted):
            assert requirement.name in versions, f"{requirement} is not in {lock}: run `make lock`"
            assert versions[requirement.name] in requirement.specifier, f"{requirement} in {lock}: run `make lock`"


def test_benchmarks_run_on_the_same_versions():
    ours, shared = ({(r.name, str(r.specifier)) for r in pins(lock)} for lock in LOCKS)
    names = {name for name, _ in ours}
    assert {pin for pin in shared if pin[0] in names} <= ours
    assert any(name == "numpy" for name, _ in shared)


# -- what may not be in the tree -------------------------------------------------------------------
# Put together from pieces, so that this file does not hold what it looks for.
ENDINGS = {"pypi": "org", "python" + "hosted": "org", "npmjs": "org", "deb": "debian", "anaconda": "org"}
HOSTS = "|".join(rf"{name}\.{ending}" for name, ending in ENDINGS.items())
FOLDERS = "|".join(("work", "farm", "root", "home", "Users", "mnt"))
FORBIDDEN = re.compile(rf"{HOSTS}|(?<![\w.~/$}}-])/(?:{FOLDERS})/", flags=re.MULTILINE)


def test_no_tracked_file_holds_a_package_host_or_a_path_of_one_machine():
    found = []
    for path in git_files():
        content = path.read_bytes()
        if b"\0" in content[:8000] or content[:2] == b"\x1f\x8b":
            continue
        # Line ends inside JSON strings (notebooks) would hide a path from the look behind.
        text = content.decode("utf-8").replace("\\n", "\n")
        found += [f"{path.relative_to(ROOT)}: {hit[0]}" for hit in FORBIDDEN.finditer(text)]
    assert not found


def test_the_search_finds_what_it_looks_for():
    for folder in FOLDERS.split("|"):
        assert FORBIDDEN.search(f'"/{folder}/someone/x.py"')
    for host in HOSTS.replace("\\", "").split("|"):
        assert FORBIDDEN.search(f"//files.{host}/x")
    assert not FORBIDDEN.search("reports/home/x ../work/x ~/home/x")


def test_the_only_locks_are_ours():
    assert sorted(p.name for p in git_files() if p.suffix == ".lock") == sorted(LOCKS)


# -- metadata --------------------------------------------------------------------------------------
def test_the_project_is_not_for_upload():
    assert "Private :: Do Not Upload" in PYPROJECT["project"]["classifiers"]


def test_citation_names_the_workbench_and_the_article():
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    assert {"cff-version", "message", "title", "authors"} <= citation.keys()
    assert citation["cff-version"] == "1.2.0"
    assert citation["version"] == PYPROJECT["project"]["version"]
    assert citation["license"] == PYPROJECT["project"]["license"]
    (article,) = citation["references"]
    assert {"type", "title", "authors", "journal", "year"} <= article.keys()
    assert article["doi"] == "10.1109/LRA.2026.3668141"
    assert [a["family-names"] for a in article["authors"]] == ["Zahedi", "Hu", "Mehrotra", "Steyvers", "Akash"]
