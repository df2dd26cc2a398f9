"""The page on untrusted files: every claim names a test that exists, every limit a constant that exists."""

import ast
import re
from importlib import import_module
from pathlib import Path

ROOT = Path(__file__).parents[1]
PAGE = (ROOT / "reports" / "docs" / "pages" / "threats.md").read_text(encoding="utf-8")


def test_named_tests_exist():
    named = re.findall(r"`(tests/[\w/]+\.py)::(\w+)`", PAGE)
    assert len(named) > 30
    for file, name in named:
        tree = ast.parse((ROOT / file).read_text(encoding="utf-8"))
        assert name in {n.name for n in tree.body if isinstance(n, ast.FunctionDef)}, f"{file}::{name}"


def test_named_constants_exist():
    named = re.findall(r"`((?:models|analysis)\.[\w.]+)\.([A-Z_]+)`", PAGE)
    assert len(named) > 10
    for module, name in named:
        assert isinstance(getattr(import_module(module), name), int | float), f"{module}.{name}"


def test_every_row_has_a_test_and_every_section_a_test_or_the_word():
    rows = [line for line in PAGE.splitlines() if line.startswith("|")]
    for line in rows:
        if not re.match(r"\| ?(claim|file|where)|\|[-|]+$", line):
            assert "`tests/" in line, line
    for part in PAGE.split("\n## ")[1:]:
        assert "`tests/" in part or "*Not defended" in part or "examined" in part, part[:40]
