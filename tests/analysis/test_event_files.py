import gzip

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given
from hypothesis import strategies as st

from analysis.datasets import log_digest
from analysis.event_files import csv_bytes, read_events, write_events
from analysis.simulate import simulate_study1
from models.errors import InputError
from models.event_rules import check_columns
from models.event_scan import scan_sorted
from models.events import COLUMNS, Coded, EventLog, EventLogError
from models.protocol import PUBLISHED, Action, Mode, Protocol, Response
from tests.analysis.event_text import HEADER, ROWS, text


@pytest.fixture
def log():
    return simulate_study1(participants=40)


@pytest.mark.parametrize("name", ["a.csv", "a.csv.gz", "a.parquet"])
def test_every_format_reads_back(log, tmp_path, name):
    write_events(log, tmp_path / name)
    back = read_events(tmp_path / name)
    assert log_digest(back.log) == log_digest(log)
    assert back.notes == ()


def test_same_log_same_bytes_and_the_gzip_header_names_no_time_and_no_file(log, tmp_path):
    for name in ("a.csv.gz", "b.csv.gz"):
        write_events(log, tmp_path / name)
    first, second = (tmp_path / "a.csv.gz").read_bytes(), (tmp_path / "b.csv.gz").read_bytes()
    assert first == second
    assert first[3] == 0  # no flags, so no name
    assert first[4:8] == b"\0\0\0\0"


def test_gzipped_parquet_and_a_name_that_lies(log, tmp_path):
    write_events(log, tmp_path / "a.parquet")
    packed = tmp_path / "packed.parquet.gz"
    packed.write_bytes(gzip.compress((tmp_path / "a.parquet").read_bytes()))
    assert log_digest(read_events(packed).log) == log_digest(log)
    lies = tmp_path / "plain.csv.gz"
    lies.write_bytes(csv_bytes(log))
    read = read_events(lies)
    assert log_digest(read.log) == log_digest(log)
    assert read.notes == (f"{lies}: named .gz but not compressed; read as it is",)


def test_tokens_quotes_and_names_with_commas_survive(tmp_path):
    rows = [row + f",{i}.5,," for i, row in enumerate(ROWS)]
    rows = [row.replace("none at all", '"a, ""b"""') for row in rows]
    path = tmp_path / "a.csv"
    path.write_text(text(*rows, header=HEADER + ",team_tokens,human_tokens,robot_tokens"))
    log = read_events(path).log
    assert log.conditions == ('a, "b"', "help+signal")
    assert log.tokens["team_tokens"].tolist() == [0.5, 1.5, 2.5, 3.5, 4.5]
    assert np.isnan(log.tokens["human_tokens"]).all()
    for name in ("b.csv", "b.parquet"):
        write_events(log, tmp_path / name)
        assert log_digest(read_events(tmp_path / name).log) == log_digest(log)


def test_bom_crlf_empty_lines_any_order_of_rows_and_columns(tmp_path):
    plain, odd = tmp_path / "a.csv", tmp_path / "b.csv"
    plain.write_text(text())
    turned = [",".join(row.split(",")[::-1]) for row in (HEADER, *ROWS[::-1])]
    odd.write_bytes(b"\xef\xbb\xbf" + "\r\n\r\n".join(turned).encode())
    assert log_digest(read_events(odd).log) == log_digest(read_events(plain).log)


def test_unknown_columns_are_reported(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text(text(*(row + ",x,1" for row in ROWS), header=HEADER + ",mood,age"))
    wanted = f"{path}: columns not read, since the schema has none of that name: mood, age"
    assert read_events(path).notes == (wanted,)


def test_lines_in_errors_count_empty_lines(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text(text(ROWS[0], "", "", ROWS[1].replace(",signal,", ",help,")))
    with pytest.raises(EventLogError, match="line 5, column action: found 'help', wanted an action of mode"):
        read_events(path)


def test_all_problems_are_kept_with_their_lines(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text(text(*(row.replace("pilot,", "pilot,x") for row in ROWS)))
    with pytest.raises(EventLogError) as caught:
        read_events(path)
    assert [p.line for p in caught.value.problems] == [2, 3, 4, 5, 6]
    assert caught.value.total == 5


def test_zip_bomb_is_stopped(tmp_path):
    path = tmp_path / "bomb.csv.gz"
    path.write_bytes(gzip.compress((HEADER + "\n" + (ROWS[0] + "\n") * 40_000).encode()))
    with pytest.raises(InputError, match="decompressed size: found more than 1000000 bytes, wanted at most"):
        read_events(path, limit=1_000_000)


def test_parquet_with_narrow_integers_plain_text_and_extra_columns(log, tmp_path):
    write_events(log, tmp_path / "a.parquet")
    table = pq.read_table(tmp_path / "a.parquet")
    plain = pa.table(
        {
            name: table[name].cast(pa.large_string() if pa.types.is_dictionary(table[name].type) else pa.int16())
            for name in COLUMNS
        }
        | {"mood": table["k"]}
    )
    pq.write_table(plain, tmp_path / "b.parquet")
    read = read_events(tmp_path / "b.parquet")
    assert log_digest(read.log) == log_digest(log)
    assert read.notes[0].endswith("mood")


def test_another_protocol(tmp_path):
    protocol = Protocol(
        "corridor",
        (Mode("meet", "M", (Action("wait"), Action("go")), "wait", True),),
        (Response("yield", 1.0), Response("stop", 0.5), Response("push", 0.0)),
    )
    path = tmp_path / "a.csv"
    rows = ("s,1,c,0,0,meet,go,stop", "s,1,c,0,1,meet,wait,push")
    path.write_text(text(*rows))
    log = read_events(path, protocol).log
    assert log.response.tolist() == [1, 2]
    with pytest.raises(EventLogError, match="found 'meet', wanted one of human_needs_help, robot_needs_help"):
        read_events(path)


# -- the compiled pass and the rules agree -----------------------------------------------------------
def columns_of(log):
    frame = log.to_frame()
    return {
        name: Coded(frame[name].cat.codes.to_numpy(), list(frame[name].cat.categories))
        if hasattr(frame[name], "cat")
        else frame[name].to_numpy()
        for name in COLUMNS
    }


CHANGES = st.lists(
    st.tuples(st.sampled_from(COLUMNS), st.integers(0, 99), st.integers(-1, 6)), min_size=0, max_size=3
)


@given(CHANGES, st.booleans())
def test_compiled_pass_accepts_only_what_the_rules_accept(changes, shuffled):
    columns = columns_of(simulate_study1(participants=20))
    for name, row, value in changes:
        if isinstance(columns[name], Coded):
            columns[name].codes.flags.writeable = True
            columns[name].codes[row] = min(value, len(columns[name].labels) - 1)
        else:
            columns[name] = columns[name].copy()
            columns[name][row] = value
    if shuffled:
        order = np.random.default_rng(1).permutation(100)
        columns = {
            n: Coded(c.codes[order], c.labels) if isinstance(c, Coded) else c[order] for n, c in columns.items()
        }
    scanned = scan_sorted(columns, PUBLISHED)
    try:
        checked = check_columns(columns, PUBLISHED, "log")
    except EventLogError:
        assert scanned is None
        return
    assert scanned is not None or shuffled or changes
    if scanned is not None:
        assert np.array_equal(scanned.offsets, checked.offsets)
        assert np.array_equal(scanned.action, checked.action)
        assert np.array_equal(scanned.response, np.maximum(checked.response - 2, -1))
    assert EventLog.from_columns(columns).n_events == 100
