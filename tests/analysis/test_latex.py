"""Tables as LaTeX: nothing runs off the page, and a document that compiles them agrees."""

import re
import shutil
import subprocess

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from analysis.report.latex import BREAK, PAGE, SIZES, breakable, ems, laid_out, latex, shared
from analysis.report.section import Origin, Table

DIGEST = "3c9e7a51d0b24f86a1c58e7732f09ab4d6e15f0887c2b3a94e6d1f50c7a8b912"
LONG = (
    "a sentence that goes on, says how a number was made and from what, and would not stop at the edge of a page "
)


def made(frame, **options):
    return Table("made-up", pd.DataFrame(frame), "A caption.", (Origin.SIMULATED,), **options)


TABLES = {
    "numbers": made({"state": ["s0", "s1"], "value": [1.25, -20.5]}, formats={"value": ".2f"}),
    "facts": made({"item": ["digest", "why"], "value": [DIGEST, LONG * 4]}, facts=True),
    "sentences": made({"check": ["a", "b"], "ours": [0.5, 1e9], "what": [LONG * 3, "x"]}, formats={"ours": ",.3f"}),
    "wide": made(
        {f"a heading of column {i}": [f"analysis.report.sections.module_{i}", "-0.123456"] for i in range(9)}
    ),
    "grouped": made(
        {c: [0.5, 0.25] for c in "abcd"}, formats=dict.fromkeys("abcd", ".3f"),
        groups=(("", 1), ("a heading much wider than what is below it", 2), ("as it was printed", 1)),
    ),
    "long": made({"k": list(range(120)), "said": ["no help \N{RIGHTWARDS ARROW} help"] * 120}, formats={"k": "d"}),
    "turned": made({i: np.full(60, -1234.56789) for i in "abcdefghij"}, formats=dict.fromkeys("abcdefghij", ".5f")),
}  # fmt: skip


def columns_of(text):
    return re.search(r"\\begin\{(?:tabular|longtable)\}\{(.*)\}\n", text)[1]


@pytest.mark.parametrize("name", TABLES)
def test_the_first_line_names_the_packages_that_are_needed(name):
    text = latex(TABLES[name])
    first, *rest = text.splitlines()
    named = re.fullmatch(r"% Needs \\usepackage\{([a-z,]+)\}\.", first)[1].split(",")
    body = "\n".join(rest)
    needed = {
        "booktabs": r"\toprule", "array": r"\arraybackslash", "longtable": r"{longtable}", "lscape": r"{landscape}"
    }  # fmt: skip
    assert named == [package for package, mark in needed.items() if mark in body]
    assert r"\caption{[simulated] A caption.}\label{tab:made-up}" in text


@pytest.mark.parametrize("name", TABLES)
def test_a_mark_ends_the_caption_and_the_first_line_and_changes_nothing_else(name):
    mark = "QUICK: 50% not for citation."
    text, plain = latex(TABLES[name], mark), latex(TABLES[name])
    said = r" QUICK: 50\% not for citation."
    assert text.splitlines()[0] == plain.splitlines()[0] + said
    assert rf"\caption{{[simulated] A caption.{said}}}\label{{tab:made-up}}" in text
    assert text.replace(said, "") == plain


def test_numbers_stand_right_and_text_that_fits_is_left_alone():
    assert columns_of(latex(TABLES["numbers"])) == "lr"
    assert columns_of(latex(TABLES["long"])) == "rl"


def test_long_text_wraps_and_numbers_beside_it_stand_right():
    widths = re.fullmatch(
        r">\{\\raggedright\\arraybackslash\}p\{(0\.\d+)\\linewidth\}"
        r">\{\\raggedleft\\arraybackslash\}p\{(0\.\d+)\\linewidth\}"
        r">\{\\raggedright\\arraybackslash\}p\{(0\.\d+)\\linewidth\}", columns_of(latex(TABLES["sentences"]))
    )  # fmt: skip
    one, two, three = map(float, widths.groups())
    assert max(one, two) < 0.3 < three < one + two + three <= 1


def test_digests_break_and_are_whole_without_the_breaks():
    text = latex(TABLES["facts"])
    assert DIGEST not in text
    assert DIGEST in text.replace(r"\allowbreak{}", "")
    longest = max(re.split(rf"[\s{BREAK}]", breakable(DIGEST)), key=len)
    assert len(longest) < 12


def test_long_tables_go_on_and_say_their_columns_again():
    text = latex(TABLES["long"])
    assert text.count("k & said") == 2
    assert r"\begin{table}" not in text
    assert text.count(r"\begin{landscape}") == 0 < latex(TABLES["turned"]).count(r"\begin{landscape}")


cells = st.text(st.sampled_from("abcMW01.-/_ \N{MINUS SIGN}%"), max_size=90)


@given(
    st.integers(1, 12).flatmap(lambda n: st.lists(st.lists(cells, min_size=n, max_size=n), min_size=1, max_size=5))
)
def test_no_table_is_wider_than_the_page_and_no_word_than_its_column(texts):
    texts = [[breakable(text) for text in row] for row in texts]
    n = len(texts[0])
    found = laid_out(texts, n)
    em = SIZES[found.size]
    whole = [max([1.0, *(ems(row[j]) for row in texts)]) * em for j in range(n)]
    if found.shares == (None,) * n:
        assert sum(whole) + found.gap * n <= found.page + 1e-9
        return
    assert sum(found.shares) * found.page + found.gap * n <= found.page + 1e-9
    pieces = [[w for row in texts for w in re.split(rf"[\s{BREAK}]+", row[j])] for j in range(n)]
    words = [max([1.0, *map(ems, own)]) for own in pieces]
    if sum(words) * em + found.gap * n <= found.page:
        for share, word in zip(found.shares, words, strict=True):
            assert share * found.page >= word * em - found.page / 1000 - 1e-9
    if found.page == PAGE:
        assert found.size in SIZES


@given(st.lists(st.tuples(st.floats(1, 400), st.floats(0.5, 12)), min_size=1, max_size=12), st.floats(20, 200))
def test_widths_are_shared_out(columns, room):
    whole, least = [max(w, n) for w, n in columns], [n for _, n in columns]
    found = shared(whole, least, room)
    assert sum(found) <= room + 1e-6
    if sum(least) <= room:
        assert all(w >= n - 1e-6 for w, n in zip(found, least, strict=True))
        assert sum(found) == pytest.approx(min(room, sum(whole)), rel=1e-6)


@pytest.mark.skipif(shutil.which("pdflatex") is None, reason="no LaTeX on this machine")
def test_a_document_of_them_compiles_and_nothing_runs_off_the_page(tmp_path):
    body = ""
    for name, table in TABLES.items():
        (tmp_path / f"{name}.tex").write_text(latex(table), encoding="ascii")
        body += rf"\input{{{name}}}\clearpage" + "\n"
    head = r"\documentclass{article}\usepackage{booktabs,array,longtable,lscape}"
    (tmp_path / "all.tex").write_text(rf"{head}\begin{{document}}{body}\end{{document}}", encoding="ascii")
    ran = subprocess.run(
        ["pdflatex", "-interaction=nonstopmode", "-halt-on-error", "all.tex"],
        cwd=tmp_path, capture_output=True, text=True, timeout=60,
    )  # fmt: skip
    assert ran.returncode == 0, ran.stdout[-2000:]
    over = [float(x) for x in re.findall(r"Overfull \\hbox \(([\d.]+)pt", ran.stdout)]
    assert max(over, default=0.0) < 1.5
    assert "Float too large" not in ran.stdout
