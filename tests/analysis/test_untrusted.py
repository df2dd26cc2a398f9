"""Files from strangers: nothing in them is run, none of them grows beyond a limit, none shows as more than text."""

import ast
import gzip
import json
import os
import re
import zipfile
from pathlib import Path

import h5py
import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import xarray as xr

from analysis import event_files, file_source, table_files
from analysis.array_archive import read_arrays
from analysis.cli import main
from analysis.event_files import read_events
from analysis.event_import import import_events
from analysis.figures.style import to_svg
from analysis.report.build import build_report
from analysis.report.latex import escaped, latex
from analysis.report.parts import no_formula
from analysis.report.registry import SECTIONS
from analysis.report.render import PageHead, render
from analysis.report.section import Figure, Omitted, Origin, Part, Points, Section, Table, Text
from analysis.result_content import Given
from analysis.result_reading import from_content
from analysis.table_files import read_table
from models import compiled, text_files
from models.errors import LONGEST_MESSAGE, InputError, located, printable
from models.events import EventLog
from models.hdf5_check import check_hdf5
from models.model_files import read_json
from models.planning.formats import read_problem, source
from models.planning.policy_files import read_policy
from models.posterior_files import content_digest, read_posterior
from models.protocol import PUBLISHED, Protocol
from models.text_files import limited_bytes, text_of, toml_of
from tests.analysis.draws_cases import fit_file, people
from tests.analysis.event_text import text
from tests.analysis.report_cases import data_set, random_log
from tests.analysis.test_bad_input import small_table
from tests.fuzz.seeds import PLAIN_MAP, RAW, policies

ROOT = Path(__file__).resolve().parents[2]
EVIL = "<script>alert(1)</script>"
PICKLES = {"pickle", "cPickle", "cloudpickle", "dill", "joblib", "marshal", "shelve", "_pickle"}


# -- nothing is run ----------------------------------------------------------------------------------
def test_no_module_reads_pickles():
    """But benchmarks, which hand their own log to their own processes."""
    for path in [*(ROOT / "models").rglob("*.py"), *(ROOT / "analysis").rglob("*.py")]:
        if path.is_relative_to(ROOT / "analysis" / "bench"):
            continue
        for node in ast.walk(ast.parse(path.read_text())):
            named = (
                [a.name for a in node.names] if isinstance(node, ast.Import)
                else [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            )  # fmt: skip
            assert not PICKLES & {name.partition(".")[0] for name in named}, path
            if isinstance(node, ast.Call):
                called = ast.unparse(node.func)
                assert called not in ("np.load", "numpy.load", "pd.read_pickle", "exec"), path
                assert "allow_pickle=True" not in ast.unparse(node), path


def test_archives_of_arrays_hold_numbers_only(tmp_path):
    path = tmp_path / "a.npz"
    np.savez(path, x=np.arange(6.0).reshape(2, 3), name=np.array("text"))
    found = read_arrays(path)
    assert found["x"].tolist() == [[0, 1, 2], [3, 4, 5]]
    assert str(found["name"]) == "text"
    assert list(read_arrays(path, ("x",))) == ["x"]
    np.savez(path, x=np.array([{"run": "me"}], dtype=object))
    with pytest.raises(ValueError, match="an array of objects"):
        read_arrays(path)


def _npy(head):
    text = str(head).ljust(117) + "\n"
    return b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little") + text.encode() + bytes(8)


@pytest.mark.parametrize("shape", [(10**15,), (-1,), (2, 2), (10**400,)])
def test_archives_of_arrays_promise_what_they_hold(shape, tmp_path):
    path = tmp_path / "a.npz"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("x.npy", _npy({"descr": "<f8", "fortran_order": False, "shape": shape}))
    with pytest.raises(ValueError, match=r"is not what its head says|no archive"):
        read_arrays(path)


def test_archives_of_arrays_are_not_unpacked(tmp_path):
    path = tmp_path / "a.npz"
    np.savez_compressed(path, x=np.zeros(10**6))
    with pytest.raises(ValueError, match="is compressed"):
        read_arrays(path)


@pytest.mark.parametrize(
    "name", ["os:system", "models.model_files:os.system", "builtins:eval", "analysis.stored_results:io.open"]
)
def test_stored_results_lead_to_code_of_this_checkout_only(name):
    for node in (["named", name], ["partial", ["named", name], ["tuple", []], ["dict", []]]):
        with pytest.raises((ValueError, StopIteration)):
            from_content(node, [], Given({}))


@pytest.mark.skipif(os.name != "posix", reason="permissions of POSIX")
def test_compiled_code_is_not_run_from_a_folder_that_anybody_may_write_into(tmp_path):
    folder = tmp_path / "numba"
    folder.mkdir()
    assert compiled._writable(folder)
    folder.chmod(0o777)
    compiled._writable.cache_clear()
    compiled._TOLD.clear()
    with pytest.warns(compiled.UncachedWarning, match="others may write there"):
        assert not compiled._writable(folder)
    compiled._writable.cache_clear()


# -- limits ------------------------------------------------------------------------------------------
def test_text_files_are_read_up_to_a_limit(tmp_path):
    path = tmp_path / "a.json"
    path.write_bytes(b" " * 1000)
    assert len(limited_bytes(path, 1000)) == 1000
    with pytest.raises(InputError, match="found more than 999 bytes, wanted at most 999"):
        limited_bytes(path, 999)
    with pytest.raises(InputError, match="a path without null characters"):
        text_of("a\0b")


@pytest.mark.skipif(not Path("/dev/zero").exists(), reason="no endless file")
def test_endless_files_end(monkeypatch):
    monkeypatch.setattr(text_files, "LARGEST_SETTINGS", 1 << 16)
    with pytest.raises(InputError, match="/dev/zero: found more than 65536 bytes"):
        toml_of("/dev/zero", "file")


@pytest.mark.parametrize(
    ("content", "told"),
    [
        ("a = " + "[" * 5000, "TOML nested too deeply"),
        ("a = " + "9" * 5000, "holds a value that cannot be read"),
        ("a = ", "not valid TOML"),
        ("a = 2026-13-01", "not valid TOML|holds a value"),
    ],
)
def test_toml(content, told, tmp_path):
    path = tmp_path / "a.toml"
    path.write_text(content)
    with pytest.raises(InputError, match=told):
        Protocol.from_toml(path)


def test_json_nested_without_end(tmp_path):
    path = tmp_path / "a.json"
    path.write_text("[" * 100_000)
    with pytest.raises(InputError, match="nested too deeply"):
        read_json(path)


def test_gzip_bombs_of_events_and_tables(tmp_path, monkeypatch):
    path = tmp_path / "events.csv.gz"
    path.write_bytes(gzip.compress(text().encode() + b"\n" * 10**6))
    with pytest.raises(InputError, match="decompressed size: found more than 100000 bytes"):
        read_events(path, limit=100_000)
    monkeypatch.setattr(table_files, "LARGEST_TABLE", 100_000)
    with pytest.raises(InputError, match="decompressed size: found more than 100000 bytes"):
        read_table(path)
    assert file_source.DECOMPRESSED_LIMIT == 8 << 30


def test_gzip_bombs_of_problems(tmp_path, monkeypatch):
    monkeypatch.setattr(source, "LARGEST", 10_000)
    path = tmp_path / "p.pomdp.gz"
    path.write_bytes(gzip.compress(b" " * 10**6))
    with pytest.raises(InputError, match="more than 10000 bytes"):
        read_problem(path)


def test_parquet_bombs(tmp_path, monkeypatch):
    path = tmp_path / "events.parquet"
    table = pa.table(small_table())
    pq.write_table(pa.concat_tables([table] * 100), path)
    with pytest.raises(InputError, match="rows: found 500, wanted at most 156"):
        read_events(path, limit=10_000)
    monkeypatch.setattr(table_files, "LARGEST_TABLE", 1000)
    with pytest.raises(InputError, match="cells: found 4000, wanted at most 125"):
        read_table(path)
    packed = tmp_path / "packed.parquet"
    packed.write_bytes(gzip.compress(path.read_bytes()))
    monkeypatch.setattr(event_files, "PACKED_PARQUET", 100)
    with pytest.raises(InputError, match="decompressed size"):
        read_events(packed)


def test_codes_without_a_label_never_reach_compiled_code(monkeypatch):
    labels = pa.array(["a", "b"])
    bad = pa.DictionaryArray.from_arrays(pa.array([0, 7], pa.int32()), labels, safe=False)
    with pytest.raises(InputError, match="stand for no text"):
        event_files.labels_of("events.parquet, column mode", bad)


def test_parquet_files_are_not_mapped_into_memory(tmp_path, monkeypatch):
    monkeypatch.setattr(pa, "memory_map", None)
    path = tmp_path / "events.parquet"
    pq.write_table(pa.table(small_table()), path)
    assert read_events(path).log.n_events == 5
    for name in ("event_files", "event_chunks", "table_files"):
        assert "memory_map=True" not in (ROOT / "analysis" / f"{name}.py").read_text()


def _fit(folder):
    path = folder / "fit.nc"
    fit_file(path, people(3))
    return path


def test_netcdf_bombs_and_links(tmp_path):
    def in_file(name, do, told):
        path = tmp_path / f"{name}.nc"
        path.write_bytes(whole)
        with h5py.File(path, "r+") as file:
            do(file)
        with pytest.raises(InputError, match=f"{name}.nc.*{told}"):
            read_posterior(path)

    whole = _fit(tmp_path).read_bytes()
    in_file("outside", lambda f: f.__setitem__("x", h5py.ExternalLink("/etc/passwd", "/")), "a link")
    in_file("soft", lambda f: f.__setitem__("x", h5py.SoftLink("/posterior")), "a link")
    in_file("loop", lambda f: f.__setitem__("x", f["/"]), "several names|deep")
    chunks = {"shape": (10**6, 10**6), "dtype": "f8", "chunks": (1000, 1000)}
    in_file("large", lambda f: f.create_dataset("x", **chunks), "8000000000000 bytes so far")
    layout = h5py.VirtualLayout((2,), "f8")
    layout[:] = h5py.VirtualSource("other.h5", "x", shape=(2,))
    in_file("virtual", lambda f: f.create_virtual_dataset("x", layout), "in another file")
    raw = [("/etc/passwd", 0, 16)]
    in_file("external", lambda f: f.create_dataset("x", (2,), "f8", external=raw), "in another file")
    in_file("many", lambda f: [f.create_group(f"g{i}") for i in range(3000)], "more objects")
    check_hdf5(tmp_path / "fit.nc")


@pytest.mark.parametrize("change", [{"divergences": [1]}, {"max_rhat": "1"}, {"worst": 3}, {"draws": True}])
def test_what_a_fit_says_of_itself_is_of_its_kind(change, tmp_path):
    path = _fit(tmp_path)
    with xr.open_datatree(path, engine="h5netcdf") as stored:
        data = stored.load()
    attributes = dict(data.attrs)
    attributes["gate"] = json.dumps({**json.loads(attributes["gate"]), **change})
    attributes["content_digest"] = content_digest(data, attributes)
    data.attrs.update(attributes)
    data.to_netcdf(path, engine="h5netcdf")
    with pytest.raises(InputError, match=r"damaged: attribute gate cannot be read"):
        read_posterior(path)


# -- names are text ----------------------------------------------------------------------------------
def test_messages_hold_nothing_that_a_terminal_obeys():
    message = str(located("a.csv, column \x1b]0;x\x07", "\x1b[2J\u202e", "text" + "x" * 10_000))
    assert message.isprintable()
    assert len(message) <= LONGEST_MESSAGE
    assert printable("é – ☃\tok\n") == "é – ☃\tok\n"


def _filled(origin):
    def draw():
        from matplotlib.figure import Figure as Drawing

        figure = Drawing(figsize=(2, 2))
        axes = figure.subplots()
        axes.set_title(EVIL)
        axes.plot([1, 2], label=EVIL)
        axes.set_xticks([1, 2], [EVIL, EVIL])
        axes.legend(title=EVIL)
        return figure

    frame = pd.DataFrame({EVIL: [EVIL, "b"], "n": [1.0, 2.0]})
    table = Table("t", frame, EVIL, origin, headings={"n": EVIL}, groups=((EVIL, 2),), row_headings=1)
    return (
        Text(EVIL), Points((EVIL,), EVIL), Omitted(EVIL, EVIL), table, Figure("f", (draw,), EVIL, (EVIL,), origin),
    )  # fmt: skip


def test_the_report_shows_names_as_text(tmp_path):
    origin = (next(iter(Origin)),)
    blocks = _filled(origin)
    page = render(
        [Section(EVIL, "s", (*blocks[:3], Part(EVIL, "p", blocks[3:])))],
        PageHead(EVIL, origin, (EVIL,), 1, EVIL, EVIL, False, (EVIL,)),
    )
    body = re.sub(r"<style>.*?</style>", "", page, flags=re.DOTALL)
    assert EVIL not in body
    assert "alert(1)</" not in body
    assert body.count("&lt;script&gt;alert(1)&lt;/script&gt;") >= 10
    assert "<script" not in body


def test_drawings_hold_no_markup_of_names():
    from matplotlib.figure import Figure as Drawing

    figure = Drawing(figsize=(2, 2))
    figure.subplots().set_title(EVIL, gid=EVIL, url="javascript:alert(1)")
    assert EVIL not in to_svg(figure)


@pytest.mark.parametrize("text", ["=1+1", "+1+1", "-1+1", "@SUM(A1)", "\t=1", '=HYPERLINK("x")', "- x"])
def test_spreadsheets_run_no_cell(text):
    assert no_formula(text) == f"'{text}"


def test_numbers_and_names_stay_as_they_are():
    for value in ("-1.5", "+2", "1e-3", "help", "", -1.5, None, True):
        assert no_formula(value) is value


def test_latex_runs_no_cell():
    frame = pd.DataFrame({"a": [r"\input{/etc/passwd}", "[3em] x", "50% {b} $x$ a_b^c & ~"]})
    out = latex(Table("t", frame, r"\write18{x}", (next(iter(Origin)),)))
    commands = set(re.findall(r"\\[a-zA-Z]+", out))
    assert not commands & {r"\input", r"\write"}
    assert "\n{}[3em]" in out
    assert r"50\% \{b\} \$x\$ a\_b\textasciicircum{}c \& \textasciitilde{}" in out
    assert escaped("a\n%b") == r"a \%b"


def test_a_whole_report_shows_names_as_text(tmp_path):
    frame = random_log(PUBLISHED, people=20).to_frame()
    frame["condition"] = frame["condition"].map({"plain": EVIL, "other": "=1+1 & <b>\x1b[2J"})
    log = EventLog.from_frame(frame.assign(study=f"{EVIL}, a study"), PUBLISHED)
    only = [e for e in SECTIONS if e.key in ("provenance", "study", "flow", "limits")]
    made = build_report(data_set(log), states="1", quick=True, out=tmp_path / "out", sections=only, parts=True)
    page = made.html.read_text(encoding="utf-8")
    assert "<script" not in page
    assert "<b>" not in page
    assert "&lt;script&gt;" in page
    tables = [pd.read_csv(p, dtype=str) for p in (tmp_path / "out").rglob("*.csv")]
    assert tables
    cells = [str(c) for table in tables for c in (*table.columns, *table.to_numpy().ravel())]
    assert any(cell.startswith("'=1+1") for cell in cells)
    assert not any(cell.startswith(("=", "@")) for cell in cells)
    for path in (tmp_path / "out").rglob("*.svg"):
        assert "<script" not in path.read_text(encoding="utf-8")


def test_what_commands_print_holds_nothing_that_a_terminal_obeys(tmp_path, capsys):
    path = tmp_path / "events.csv"
    path.write_text(text().replace("help+signal", "\x1b[2J\x07"))
    with pytest.raises(SystemExit):
        main(["data", "check", str(path)])
    out = "".join(capsys.readouterr())
    assert "\x1b" not in out
    assert "\x07" not in out
    assert str(path) in out


@pytest.mark.parametrize("number", ["9007199254740993", "9" * 400, "1_0", "\u0661", "1.0"])
def test_rounds_of_an_export_are_numbers_that_stay_what_they_are(number, tmp_path):
    (tmp_path / "map.toml").write_text(PLAIN_MAP)
    (tmp_path / "raw.csv").write_text(RAW.replace("x1,1,0,2,", f"x1,1,0,{number},"))
    with pytest.raises(InputError, match=r"raw\.csv.*, line 3, column round: .* wanted an integer between"):
        import_events(tmp_path / "raw.csv", tmp_path / "map.toml")


def test_pairs_of_a_policy_are_pairs(tmp_path):
    content = json.loads(next(c for c in policies(tmp_path) if b'"alpha"' in c))
    row = next(keys for mode in content["outcomes"] for keys in mode if keys)
    row[:] = [[*row[0], *row[0]]]
    (tmp_path / "policy.json").write_text(json.dumps(content))
    with pytest.raises(InputError, match=r"policy\.json, outcomes: .* wanted pairs of whole numbers"):
        read_policy(tmp_path / "policy.json")
