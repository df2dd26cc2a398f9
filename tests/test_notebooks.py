"""Notebooks: what is stored is up to date, clean and small, and the runner refuses what it should."""

import ast
import re
import subprocess
import sys

import pytest

from analysis import notebooks

LARGEST, LARGEST_MEAN = 1_000_000, 667_000
LONGEST_CELL = 12
# Put together from pieces, so that this file does not hold what it looks for.
HOSTS = [r"\.".join(parts) for parts in (("pypi", "org"), ("python" + "hosted", "org"), ("anaconda", "org"))]
MACHINE = re.compile("|".join([*HOSTS, *(rf"(?<![\w.~])/{f}/" for f in ("work", "root", "home", "Users", "tmp"))]))
SCRIPTS = notebooks.scripts()
NAMES = [path.stem for path in SCRIPTS]


def stored(script):
    import nbformat

    return nbformat.read(script.with_suffix(".ipynb"), as_version=4)


# -- what is stored --------------------------------------------------------------------------------
def test_there_are_notebooks_and_each_has_its_pair():
    assert NAMES
    assert sorted(p.stem for p in notebooks.FOLDER.glob("*.ipynb")) == NAMES


@pytest.mark.parametrize("script", SCRIPTS, ids=NAMES)
def test_stored_notebook_is_its_script_executed(script):
    notebooks.check(script)


@pytest.mark.parametrize("script", SCRIPTS, ids=NAMES)
def test_outputs_are_clean(script):
    kinds = set()
    for cell in stored(script).cells:
        assert not cell.metadata.keys() - {"tags"}
        for output in cell.get("outputs", []):
            kinds.add(output.output_type)
            assert output.output_type != "error"
            assert output.get("name") != "stderr"
            assert notebooks.ABSENT not in output.get("text", "")
    assert kinds


@pytest.mark.parametrize("script", SCRIPTS, ids=NAMES)
def test_every_figure_says_whose_data_it_shows(script):
    figures = 0
    for cell in stored(script).cells:
        outputs = cell.get("outputs", [])
        kinds = [next(iter(set(o.get("data", {})) - {"text/plain"}), "") for o in outputs]
        assert "image/png" not in kinds
        for kind, following in zip(kinds, [*outputs[1:], None], strict=False):
            if kind == "image/svg+xml":
                figures += 1
                caption = following.data["text/markdown"]
                assert re.match(r"\*(Simulated|Simulated truth|Real people|Definition)\.\* \S", caption)
    assert figures


@pytest.mark.parametrize("script", SCRIPTS, ids=NAMES)
def test_nothing_of_the_machine_is_stored(script):
    text = script.with_suffix(".ipynb").read_text(encoding="utf-8").replace("\\n", "\n")
    assert not [hit[0] for hit in MACHINE.finditer(text)]
    metadata = stored(script).metadata
    assert metadata.keys() == {"jupytext", "kernelspec", "language_info"}
    assert "version" not in metadata.language_info


def test_the_search_finds_what_it_looks_for():
    assert MACHINE.search('"/ro' + 'ot/x"')
    assert MACHINE.search("files." + "python" + "hosted.org/x")
    assert not MACHINE.search("../work/x data/home/x")


def test_sizes():
    sizes = [script.with_suffix(".ipynb").stat().st_size for script in SCRIPTS]
    assert max(sizes) < LARGEST
    assert sum(sizes) < LARGEST_MEAN * len(sizes)


def code_of(script):
    return [c.source for c in notebooks.read_script(script).cells if c.cell_type == "code"]


def prose_of(script):
    return [c.source for c in notebooks.read_script(script).cells if c.cell_type == "markdown"]


def lines_of_work(source):
    """Lines of code, without those that import, that are blank or a comment, or that continue a text."""
    skipped = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import | ast.ImportFrom):
            skipped |= set(range(node.lineno, node.end_lineno + 1))
        elif isinstance(node, ast.Constant) and isinstance(node.value, str) and "\n" in node.value:
            skipped |= set(range(node.lineno + 1, node.end_lineno + 1))
    lines = enumerate(source.split("\n"), start=1)
    return sum(n not in skipped and line.strip() != "" and not line.strip().startswith("#") for n, line in lines)


def test_lines_of_work_are_counted():
    assert lines_of_work('import a\nfrom b import (\n    c,\n)\nx = """\n1\n2\n"""\n\n# why\ny = 1\n') == 2


@pytest.mark.parametrize("script", SCRIPTS, ids=NAMES)
def test_cells_are_short(script):
    for source in code_of(script):
        assert lines_of_work(source) <= LONGEST_CELL, source
        assert not re.search(r"^ *def .*(\n +.*){6,}", source, flags=re.MULTILINE)


# -- one book --------------------------------------------------------------------------------------
@pytest.mark.parametrize("script", SCRIPTS, ids=NAMES)
def test_every_notebook_is_an_essay_of_the_same_shape(script):
    first, *_, last = prose_of(script)
    heads = [first.index(f"\n**The {part}.** ") for part in ("question", "data", "model")]
    assert heads == sorted(heads)
    assert "$$" in first[heads[-1] :]
    before, end = re.split(r"^## ", last, flags=re.MULTILINE)[-2:]
    assert before.startswith("What to take along\n")
    assert before.count("\n| ") >= 4
    assert end.startswith("What not to conclude\n")
    assert end.count("\n- ") >= 2
    following = NAMES[(NAMES.index(script.stem) + 1) % len(NAMES)]
    assert re.search(rf"Next: .*\]\({following}\.ipynb\)", end.split("\n\n")[-1], flags=re.DOTALL)


@pytest.mark.parametrize("script", SCRIPTS, ids=NAMES)
def test_figures_are_followed_by_how_to_read_them(script):
    """After a figure, before the next heading, somebody says how to read it and what not to conclude."""
    waiting = None
    for cell in notebooks.read_script(script).cells:
        if cell.cell_type == "code":
            waiting = cell.source if re.search(r"\bshow(_\w+)?\(", cell.source) else waiting
        elif waiting is not None:
            before = re.split(r"^#+ ", cell.source, flags=re.MULTILINE)[0]
            if "**How to read" in before:
                waiting = None
            else:
                assert before == cell.source, waiting  # a heading before any reading
    assert waiting is None


@pytest.mark.parametrize("script", SCRIPTS, ids=NAMES)
def test_other_notebooks_are_named_alike_and_are_there(script):
    for text in prose_of(script):
        for target in re.findall(r"\]\(([\w./]+)\.ipynb\)", text):
            assert target in NAMES
        assert not re.search(r"[Nn]otebook \d\b", text)
    for before, number, after in re.findall(r"(\[?)[Nn]otebook (\d\d)(\]?)", "\n".join(prose_of(script))):
        assert any(name.startswith(number) for name in NAMES)
        assert (before, after) == ("[", "]")


def test_the_contents_list_every_notebook_with_its_title():
    contents = (notebooks.FOLDER / "README.md").read_text(encoding="utf-8")
    rows = re.findall(
        r"^\| \[(.+)\]\((\w+)\.ipynb\) \| .+ \| [\d.]+ (?:s|min) \| [\d.]+ s \|$", contents, re.MULTILINE
    )
    assert [stem for _, stem in rows] == NAMES
    for (words, _), script in zip(rows, SCRIPTS, strict=True):
        (title,) = re.findall(r"^# (.+)$", prose_of(script)[0], flags=re.MULTILINE)[:1]
        assert words == f"{script.stem[:2]} {title}"


def test_what_is_to_be_played_with_is_there():
    kinds = {"06": "belief-explorer", "08": "token-game", "09": "reward-slider"}
    for script in SCRIPTS:
        wanted = kinds.get(script.stem[:2])
        pages = [
            "".join(o.get("data", {}).get("text/html", ""))
            for c in stored(script).cells
            for o in c.get("outputs", [])
        ]
        found = [p for p in pages if "<script" in p]
        assert [bool(re.match(rf'<div class="{wanted}"', p)) for p in found] == [True] * (wanted is not None)
        for page in found:
            assert not re.search(r"<script[^>]+src|https?:(?!//www\.w3\.org/2000/svg)", page)


# -- the runner ------------------------------------------------------------------------------------
HEAD = '# %% [markdown]\n# # A notebook\n\n# %% tags=["parameters"]\nFAST = False\nSEED = 1\n'


def script_with(folder, *cells):
    path = folder / "01_made_up.py"
    path.write_text(HEAD + "".join(f"\n# %%\n{cell}\n" for cell in cells), encoding="utf-8")
    return path


def printed(path):
    return [o.text for c in stored(path).cells for o in c.get("outputs", []) if o.output_type == "stream"]


def test_a_run_is_stored_and_a_second_one_changes_nothing(tmp_path):
    path = script_with(tmp_path, "import os\nprint(FAST, SEED, os.listdir())", "1 + 1")
    notebooks.run(path, root=tmp_path)
    assert printed(path) == ["False 1 ['01_made_up.py']\n"]
    notebooks.check(path)
    first = path.with_suffix(".ipynb").read_bytes()
    path.with_suffix(".ipynb").unlink()
    notebooks.run(path, root=tmp_path)
    assert path.with_suffix(".ipynb").read_bytes() == first


def test_prints_are_one_output_up_to_what_is_displayed_between_them(tmp_path):
    slow = "import time\nfor i in range(3):\n    print(i, flush=True)\n    time.sleep(0.4)"
    path = script_with(tmp_path, f"{slow}\ndisplay('between')\nprint('after')")
    notebooks.run(path, root=tmp_path)
    assert printed(path) == ["0\n1\n2\n", "after\n"]


def test_a_fast_run_overrides_parameters_and_stores_nothing(tmp_path):
    path = script_with(tmp_path, "assert FAST is True\nassert SEED == 1")
    notebooks.run(path, fast=True, root=tmp_path)
    assert [p.name for p in tmp_path.iterdir()] == [path.name]


def test_parameters_are_injected_behind_their_cell(tmp_path):
    notebook = notebooks.read_script(script_with(tmp_path, "FAST"))
    sources = [c.source for c in notebooks.with_parameters(notebook, {"FAST": True, "SEED": 2}).cells]
    assert sources == ["# A notebook", "FAST = False\nSEED = 1", "FAST = True\nSEED = 2", "FAST"]
    assert len(notebook.cells) == 3


def test_an_error_names_notebook_and_cell(tmp_path):
    path = script_with(tmp_path, "1 + 1", "x = 1 / 0")
    wanted = r"^01_made_up\.ipynb, code cell 3 \('x = 1 / 0'\): ZeroDivisionError: division by zero$"
    with pytest.raises(notebooks.NotebookError, match=wanted):
        notebooks.run(path, root=tmp_path)
    assert not path.with_suffix(".ipynb").exists()


def test_a_warning_is_refused(tmp_path):
    path = script_with(tmp_path, "import warnings\nwarnings.warn('beware')")
    with pytest.raises(
        notebooks.NotebookError, match=r"code cell 2 \('import warnings'\): wrote to stderr.*beware"
    ):
        notebooks.run(path, root=tmp_path)
    assert not path.with_suffix(".ipynb").exists()


def test_a_run_without_its_data_is_not_stored(tmp_path):
    path = script_with(tmp_path, f"print('{notebooks.ABSENT}: no')")
    with pytest.raises(notebooks.NotebookError, match=r"not stored.*PROSOCIAL_DATA"):
        notebooks.run(path, root=tmp_path)
    assert not path.with_suffix(".ipynb").exists()
    notebooks.run(path, fast=True, root=tmp_path)


def executed(path):
    """Store a notebook as if it had been run."""
    import nbformat

    notebook = notebooks.read_script(path)
    for i, cell in enumerate((c for c in notebook.cells if c.cell_type == "code"), start=1):
        cell.execution_count = i
        cell.outputs = [nbformat.v4.new_output("stream", text="1")]
    nbformat.write(notebook, path.with_suffix(".ipynb"))
    return notebook


@pytest.mark.parametrize(
    ("change", "wanted"),
    [
        (lambda n: setattr(n.cells[2], "source", "2"), "cell 3: differs from 01_made_up.py"),
        (lambda n: n.cells.pop(), "found 2 cells, wanted 3"),
        (lambda n: setattr(n.cells[2], "execution_count", None), "code cell 2: found no output"),
        (lambda n: [c.outputs.clear() for c in n.cells[1:]], "has no output"),
    ],
)
def test_check_names_what_is_out_of_date(tmp_path, change, wanted):
    import nbformat

    path = script_with(tmp_path, "1")
    with pytest.raises(notebooks.NotebookError, match="is not there"):
        notebooks.check(path)
    notebook = executed(path)
    notebooks.check(path)
    change(notebook)
    nbformat.write(notebook, path.with_suffix(".ipynb"))
    with pytest.raises(notebooks.NotebookError, match=wanted):
        notebooks.check(path)


def test_a_script_without_parameters_is_refused(tmp_path):
    path = tmp_path / "01_made_up.py"
    path.write_text("# %%\nFAST = False\n", encoding="utf-8")
    with pytest.raises(notebooks.NotebookError, match="not tagged 'parameters'"):
        notebooks.read_script(path)


def test_cell_ids_survive_an_insertion(tmp_path):
    before = [c.id for c in notebooks.read_script(script_with(tmp_path, "1", "1", "2")).cells]
    after = [c.id for c in notebooks.read_script(script_with(tmp_path, "0", "1", "1", "2")).cells]
    assert len(set(before)) == len(before)
    assert [i for i in after if i in before] == before


def test_command_line(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(notebooks, "scripts", lambda names: [script_with(tmp_path, "1")])
    assert notebooks.main(["--check"]) == 1
    assert "FAILED 01_made_up.ipynb: is not there" in capsys.readouterr().err
    executed(tmp_path / "01_made_up.py")
    assert notebooks.main(["--check"]) == 0
    assert "01_made_up: good" in capsys.readouterr().out


def test_an_unknown_name_lists_the_known_ones(capsys):
    assert notebooks.main(["99_nothing", "--check"]) == 2
    assert NAMES[0] in capsys.readouterr().err
    assert [p.stem for p in notebooks.scripts(["01"])] == NAMES[:1]


def test_listing_the_scripts_builds_no_grammars():
    code = "import sys, analysis.notebooks as n; n.scripts(); print({'jupytext', 'nbformat'} & {*sys.modules})"
    command = [sys.executable, "-c", code]
    done = subprocess.run(command, cwd=notebooks.ROOT, capture_output=True, text=True, timeout=60)
    assert (done.stdout.strip(), done.stderr) == ("set()", "")
