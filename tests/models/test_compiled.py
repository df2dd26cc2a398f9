"""Digests of compiled code: they see exactly what a module may run, and numba's cache follows them."""

import ast
import importlib
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numba
import pytest

from models import compiled
from models.compiled import cache_folder, kernel_digest, kernel_sources

ROOT = Path(compiled.__file__).resolve().parents[1]
MODULES = [
    ".".join(path.relative_to(ROOT).with_suffix("").parts)
    for folder in ("models", "analysis")
    for path in sorted((ROOT / folder).rglob("*.py"))
    if path.name != "__init__.py"
]


def names(paths):
    return {path.stem for path in paths}


# -- what is reached -------------------------------------------------------------------------------------
def parsed_imports(path):
    out = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            out |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            out |= {node.module, *(f"{node.module}.{alias.name}" for alias in node.names)}
    return out


def test_reading_lines_finds_every_import_that_parsing_finds():
    for module in MODULES:
        path = ROOT.joinpath(*module.split(".")).with_suffix(".py")
        found = {name for name in compiled._imported(path) if compiled._source(name)}
        wanted = {name for name in parsed_imports(path) if compiled._source(name)}
        assert wanted <= found, module


def test_every_kernel_sees_the_kernels_it_calls_and_the_constants_it_holds():
    """Compiled in, both of them: a cache that does not notice their change would be wrong."""
    checked = 0
    for path in kernel_sources():
        module = importlib.import_module(".".join(path.relative_to(ROOT).with_suffix("").parts))
        seen = kernel_sources(module.__name__)
        origin = {}
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ImportFrom):
                origin |= {alias.asname or alias.name: node.module for alias in node.names}
        for own in vars(module).values():
            if not isinstance(own, numba.core.registry.CPUDispatcher) or own.__module__ != module.__name__:
                continue
            for name in own.py_func.__code__.co_names:
                value = vars(module).get(name)
                if isinstance(value, numba.core.registry.CPUDispatcher):
                    assert Path(value.py_func.__code__.co_filename).resolve() in seen, (path.name, name)
                    checked += 1
                elif isinstance(value, int | float | tuple) and name in origin:
                    assert compiled._source(origin[name]) in seen, (path.name, name)
                    checked += 1
    assert checked > 20


def test_a_kernel_that_is_not_reached_does_not_matter():
    engine = names(kernel_sources("models.bayesian_fit"))
    assert {"forward_backward", "hmm_density", "people_kernel", "nuts"} <= engine
    assert not [name for name in engine if name.startswith("glmm")]
    assert names(kernel_sources("models.forward_backward")) <= engine
    assert engine < names(kernel_sources())
    assert names(kernel_sources("models.protocol")) == set()
    assert kernel_digest("models.bayesian_fit") != kernel_digest("models.forward_backward") != kernel_digest()
    assert cache_folder("models.forward_backward").name == kernel_digest("models.forward_backward")


def test_how_kernels_are_compiled_counts_too(monkeypatch):
    before = kernel_digest("models.forward_backward")
    monkeypatch.setitem(compiled.SETTINGS, "fastmath", True)
    assert kernel_digest.__wrapped__("models.forward_backward") != before


def test_a_module_that_does_not_exist_is_refused():
    with pytest.raises(ModuleNotFoundError, match=r"models\.nothing is not in this checkout"):
        kernel_digest("models.nothing")


# -- a small checkout of its own -------------------------------------------------------------------------
KERNEL = "from models.compiled import kernel\n"
FILES = {
    "__init__": "",
    "inner": KERNEL + "@kernel\ndef inner(x):\n    return x + 1\n",
    "between": "from models.inner import (  # through a file without kernels\n    inner,\n)\n",
    "outer": KERNEL + "from models.between import inner\n@kernel\ndef outer(x):\n    return 10 * inner(x)\n",
    "other": KERNEL + "@kernel\ndef other(x):\n    return -x\n",
    "lazy": "def late():\n    from models import other\n    return other.other\n",
}
RUN = (
    "from models.compiled import kernel_digest as d\n"
    "from models.outer import outer; from models.other import other\n"
    "print(outer(1), other(1), d('models.outer'), d('models.other'), d('models.lazy'), d())\n"
    "hits = lambda f: sum(f.stats.cache_hits.values()); print(hits(outer), hits(other))"
)


@pytest.fixture
def checkout(tmp_path):
    folder = tmp_path / "models"
    folder.mkdir()
    shutil.copy(compiled.__file__, folder / "compiled.py")
    for name, text in FILES.items():
        (folder / f"{name}.py").write_text(text)

    def run():
        done = subprocess.run(
            [sys.executable, "-c", RUN], capture_output=True, text=True, check=True, cwd=tmp_path,
            env={**os.environ, "PROSOCIAL_CACHE": str(tmp_path / "cache"), "PYTHONPATH": str(tmp_path)},
        )  # fmt: skip
        return done.stdout.split()

    return folder, run


def test_an_edited_kernel_is_compiled_anew_with_its_callers_and_nothing_else(checkout):
    folder, run = checkout
    ten, minus, outer, other, lazy, every, *hits = run()
    assert (ten, minus) == ("20", "-1")
    assert hits == ["0", "0"]
    assert lazy == other  # the same kernels, though imported inside a function
    assert run()[-2:] == ["1", "1"]
    (folder / "inner.py").write_text(FILES["inner"].replace("x + 1", "x + 2"))
    ten, minus, outer_now, other_now, lazy_now, every_now, *hits = run()
    assert (ten, minus) == ("30", "-1")
    assert hits == ["0", "1"]
    assert outer_now != outer
    assert every_now != every
    assert (other_now, lazy_now) == (other, lazy)
    (folder / "between.py").write_text(FILES["between"] + "\n")
    assert run()[2] == outer_now  # a file without kernels is a way to them, and nothing compiled
