"""`models` knows nothing of `analysis`, imports nothing heavy by itself, and is this checkout's."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

import models

ROOT = Path(__file__).resolve().parents[1]
SOURCES = sorted((ROOT / "models").rglob("*.py"))


def imported(tree):
    """Top-level package of every import statement, wherever it stands."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name.partition(".")[0] for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"line {node.lineno}: write the path of the package out"
            yield node.module.partition(".")[0]


@pytest.mark.parametrize("path", SOURCES, ids=lambda p: p.relative_to(ROOT).as_posix())
def test_models_imports_neither_analysis_nor_anything_for_plots_and_commands(path):
    found = set(imported(ast.parse(path.read_text(encoding="utf-8"))))
    assert not found & {"analysis", "matplotlib", "typer", "rich", "jinja2", "pooch", "rdata", "tests"}


def test_the_sources_are_found():
    assert {"protocol.py", "events.py", "forward_backward.py"} <= {p.name for p in SOURCES}


def test_importing_models_loads_nothing_heavy():
    code = (
        "import sys; import models\n"
        "print(*sorted({'numpy', 'numba', 'pandas', 'scipy', 'matplotlib', 'pymc'} & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT)
    assert done.stdout.split() == []


def test_protocols_need_no_compiler():
    code = "import sys; import models.protocol\nprint(*sorted({'numpy', 'numba', 'pandas'} & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT)
    assert done.stdout.split() == []


def test_models_is_the_one_of_this_checkout():
    assert Path(models.__file__).resolve() == ROOT / "models" / "__init__.py"
