"""The names that notebooks write: where they live, that nothing is loaded early, that none is left over."""

import ast
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import pytest

import analysis.workbench as wb
from analysis import notebooks
from analysis.source_digest import PACKAGES, reached_sources

ROOT = Path(wb.__file__).resolve().parents[1]


def asked_of(path):
    """Names that a script asks of the workbench."""
    nodes = [n for n in ast.walk(ast.parse(path.read_text(encoding="utf-8"))) if isinstance(n, ast.Attribute)]
    return {n.attr for n in nodes if isinstance(n.value, ast.Name) and n.value.id == "wb"}


def test_every_name_is_the_object_at_its_home():
    for name, (module, own) in wb.homes().items():
        assert module.split(".")[0] in PACKAGES
        assert getattr(wb, name) is getattr(import_module(module), own), name


def test_it_holds_what_the_notebooks_ask_for_and_nothing_else():
    asked = set().union(*map(asked_of, notebooks.scripts()))
    assert set(wb.homes()) == asked


def test_type_checkers_read_the_same_names():
    source = (ROOT / "analysis" / "workbench.pyi").read_text(encoding="utf-8")
    for node in ast.parse(source).body:
        if isinstance(node, ast.ImportFrom):
            # A stub hands a name on only if it is imported as itself.
            assert [(a.name, a.asname) for a in node.names] == [(a.name, a.name) for a in node.names]
    assert dir(wb) == sorted(wb.homes())


def test_a_name_that_it_lacks():
    with pytest.raises(
        AttributeError,
        match=r"^module 'analysis.workbench' has no attribute 'BaumWelsh'; did you mean 'BaumWelch'\?",
    ):
        _ = wb.BaumWelsh
    assert not hasattr(wb, "__wrapped__")


@pytest.mark.parametrize(
    ("name", "meant"), [("Postrior", "posterior_checks"), ("baumwelch", "BaumWelch"), ("schedule", "Schedule")]
)
def test_a_name_that_it_lacks_and_may_have_meant(name, meant):
    with pytest.raises(AttributeError) as error:
        getattr(wb, name)
    assert f"did you mean {meant!r}? dir() of the module and workbench.pyi list its names" in str(error.value)
    assert error.value.name == name


def test_a_name_like_none_points_to_the_list_only_and_machinery_is_answered_shortly():
    with pytest.raises(
        AttributeError, match=r"'qqqqzzzz'; dir\(\) of the module and workbench\.pyi list its names$"
    ):
        _ = wb.qqqqzzzz
    with pytest.raises(AttributeError, match=r"has no attribute '__wrapped__'$"):
        _ = wb.__wrapped__


def test_importing_it_loads_nothing_and_a_name_loads_its_home_only():
    code = (
        "import sys, analysis.workbench as wb\n"
        "house = lambda: sorted(m for m in sys.modules if m.startswith(('models.', 'analysis.')))\n"
        "print(house()); wb.PUBLISHED; print('models.protocol' in house(), 'models.baum_welch' in house())\n"
        "print([m for m in ('numba', 'pymc', 'matplotlib') if m in sys.modules], 'PUBLISHED' in vars(wb))"
    )
    ran = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, check=True, text=True)
    assert ran.stdout.splitlines() == ["['analysis.workbench']", "True False", "[] True"]


def test_no_module_of_the_house_rests_on_it():
    """Digests of code follow imports of sources, and would lose their way here."""
    for folder in PACKAGES:
        for path in (ROOT / folder).rglob("*.py"):
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
                names = [a.name for a in node.names] if isinstance(node, ast.Import) else []
                if isinstance(node, ast.ImportFrom):
                    names = [node.module, *(f"{node.module}.{a.name}" for a in node.names)]
                assert "analysis.workbench" not in names, path
    assert reached_sources(["analysis.workbench"]) == [ROOT / "analysis" / "workbench.py"]


@pytest.mark.parametrize("script", notebooks.scripts(), ids=lambda path: path.stem)
def test_a_notebook_begins_with_few_imports_and_none_of_the_house_but_this(script):
    tree = ast.parse(script.read_text(encoding="utf-8"))
    lines = [n for n in ast.walk(tree) if isinstance(n, ast.Import | ast.ImportFrom)]
    assert sum(n.end_lineno - n.lineno + 1 for n in lines) <= 12
    named = {a.name for n in lines if isinstance(n, ast.Import) for a in n.names}
    named |= {n.module for n in lines if isinstance(n, ast.ImportFrom)}
    assert {n for n in named if n.split(".")[0] in PACKAGES} == {"analysis.workbench"}
