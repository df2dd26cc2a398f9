"""Malformed files: each is refused with a message that says where, what was found and what was wanted."""

from __future__ import annotations

import copy
import gzip
import json

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from analysis.design import DATA_FOLDER
from analysis.event_files import read_events, write_events
from analysis.simulate import simulate_study1
from models.errors import InputError
from models.model_files import read_json, read_model
from models.protocol import PUBLISHED, Protocol
from tests.analysis.event_text import HEADER, ROWS, text, with_field, with_row

CONTENT = text().encode()
PACKED = gzip.compress(CONTENT * 50, mtime=0)
CORRUPT = PACKED[:40] + bytes(b ^ 0xFF for b in PACKED[40:44]) + PACKED[44:]

FILES = {
    "empty": (b"", ": the file is empty"),
    "empty gzip": (gzip.compress(b""), ": the gzipped file holds nothing"),
    "header only": ((HEADER + "\n").encode(), ": found no events, wanted at least one row below the header"),
    "empty first line": (b"\n" + CONTENT, ", line 1: found '', wanted a header with the names of the columns"),
    "missing column": (
        text(*(r.rsplit(",", 1)[0] for r in ROWS), header=HEADER.rsplit(",", 1)[0]).encode(),
        ", line 1, columns: found 'study, participant, condition, sequence, k, mode, action', wanted also",
    ),
    "duplicated column": (
        text(*(r + ",1" for r in ROWS), header=HEADER + ",k").encode(),
        ", line 1, column k: found '2 columns of that name', wanted one",
    ),
    "semicolons": (CONTENT.replace(b",", b";"), ", line 1, separator: found 'semicolons', wanted commas"),
    "tabs": (CONTENT.replace(b",", b"\t"), ", line 1, separator: found 'tabs', wanted commas"),
    "null bytes": (
        b"\x7fELF\x02\x01\x01\0\0\0",
        ": not a text file: binary data (a null byte at 7), a CSV event log was wanted",
    ),
    "binary without null": (
        b"\x80\x81\x82\x83" * 9,
        ", line 1: not UTF-8 text (byte 0x80 at position 1), a CSV event log in UTF-8 was wanted",
    ),
    "zip": (
        b"PK\x03\x04rest",
        ": a zip archive or spreadsheet (.zip, .xlsx), a CSV event log was wanted",
    ),
    "UTF-16": (
        text().encode("utf-16"),
        ": the text is encoded as UTF-16, UTF-8 was wanted; save it as UTF-8",
    ),
    "Latin-1": (
        with_field(4, "condition", "hélp").encode("latin-1"),
        ", line 4: not UTF-8 text (byte 0xe9 at position 10); save the file as UTF-8",
    ),
    "null byte in a later line": (
        with_field(3, "participant", "\0").encode() + b"x" * 70_000,
        ": not a text file: binary data (a null byte at 120), a CSV event log was wanted",
    ),
    "truncated gzip": (PACKED[:-20], ": truncated gzip file: it ends in the middle of the data"),
    "corrupt gzip": (CORRUPT, ": corrupt gzip file: "),
    "gzip with a wrong checksum": (PACKED[:-8] + b"12345678", ": corrupt gzip file: CRC check failed"),
    "gzip that is not CSV": (
        gzip.compress(b"\x7fELF\0\0"),
        ": gzip that is not CSV: inside is binary data (a null byte at 4), a CSV event log was wanted",
    ),
    "text id": (
        with_field(3, "participant", "abc").encode(),
        ", line 3, column participant: found 'abc', wanted an integer",
    ),
    "float id": (with_field(5, "k", "0.5").encode(), ", line 5, column k: found '0.5', wanted an integer"),
    "empty id": (
        with_field(2, "sequence", "").encode(),
        ", line 2, column sequence: found '', wanted an integer",
    ),
    "NA as id": (
        with_field(2, "sequence", "NA").encode(),
        ", line 2, column sequence: found 'NA', wanted an integer",
    ),
    "huge id": (
        with_field(6, "participant", "9" * 19).encode(),
        ", line 6, column participant: found '9999999999999999999', wanted an integer below 2^63",
    ),
    "enormous id": (
        with_field(6, "participant", "9" * 5000).encode(),
        ", line 6, column participant: found '999",
    ),
    "line break in a text field": (
        with_field(3, "condition", '"help+\nsignal"').encode(),
        ", column condition: found 'help+\\nsignal', wanted text without line breaks",
    ),
    "negative id": (
        with_field(6, "participant", "-2").encode(),
        ", line 6, column participant: found -2, wanted an integer of at least 0",
    ),
    "too few fields": (
        with_row(4, "pilot,1,help+signal,0,2").encode(),
        ", line 4: found 5 fields, wanted 8, as many as the header has",
    ),
    "too many fields": (
        with_row(4, ROWS[2] + ",oh").encode(),
        ", line 4: found 9 fields, wanted 8, as many as the header has",
    ),
    "broken quotes": (with_row(4, 'pilot,1,"help"x,0').encode(), ", line 4: broken quotes: "),
    "unknown mode": (
        with_field(2, "mode", "H").encode(),
        ", line 2, column mode: found 'H', wanted one of human_needs_help, robot_needs_help",
    ),
    "unknown action": (
        with_field(2, "action", "hug").encode(),
        ", line 2, column action: found 'hug', wanted one of no_help, help, no_signal, signal",
    ),
    "action of the other mode": (
        with_field(3, "action", "help").encode(),
        ", line 3, column action: found 'help', wanted an action of mode robot_needs_help: one of no_signal",
    ),
    "response in a silent mode": (
        with_field(2, "observation", "help").encode(),
        ", line 2, column observation: found 'help', wanted 'none', since this mode shows no response",
    ),
    "no response where one shows": (
        with_field(3, "observation", "none").encode(),
        ", line 3, column observation: found 'none', wanted one of no_help, help, or 'missing'",
    ),
    "gap in k": (
        with_field(4, "k", "3").encode(),
        ", line 4, column k: found 3, wanted 2: events of a run (participant 1, sequence 0) are numbered",
    ),
    "duplicate event": (
        with_field(4, "k", "1").encode(),
        ", line 4, column k: found 1, wanted each event once: participant 1, sequence 0 already has an event 1",
    ),
    "condition changes in a run": (
        with_field(3, "condition", "other").encode(),
        ", line 3, column condition: found 'other', wanted the condition of its run",
    ),
    "two studies": (
        with_field(6, "study", "other").encode(),
        ", line 6, column study: found 'other', wanted one study a file, here 'pilot'",
    ),
    "empty condition": (
        with_field(6, "condition", " ").encode(),
        ", line 6, column condition: found ' ', wanted a condition name",
    ),
    "tokens that are no number": (
        text(*(r + ",many" for r in ROWS), header=HEADER + ",team_tokens").encode(),
        ", line 2, column team_tokens: found 'many', wanted a number of at least 0, or empty",
    ),
    "negative tokens": (
        text(*(r + ",-1" for r in ROWS), header=HEADER + ",team_tokens").encode(),
        ", line 2, column team_tokens: found -1.0, wanted a number of at least 0, or empty",
    ),
}


@pytest.mark.parametrize("case", FILES)
def test_event_files(case, tmp_path):
    content, message = FILES[case]
    path = tmp_path / "events.csv"
    path.write_bytes(content)
    with pytest.raises(InputError) as caught:
        read_events(path)
    assert str(caught.value).startswith(f"{path}{message}")


def test_lines_are_counted_right_behind_a_line_break_in_a_column_that_is_not_read(tmp_path):
    path = tmp_path / "events.csv"
    rows = [f'{row},"said\nnothing"' for row in ROWS]
    path.write_text(text(*rows[:3], rows[3].replace("no_signal", "hug"), rows[4], header=HEADER + ",comment"))
    with pytest.raises(InputError) as caught:
        read_events(path)
    assert ", line 8, column action: found 'hug'" in str(caught.value)


def test_no_file_a_folder_and_a_name_that_cannot_be(tmp_path):
    for path, message in (
        (tmp_path / "nothing.csv", ": no such file"),
        (tmp_path, ": is a folder, a data file was wanted"),
    ):
        with pytest.raises(InputError) as caught:
            read_events(path)
        assert str(caught.value) == f"{path}{message}"
    with pytest.raises(InputError, match="wanted a path without null characters"):
        read_events("a\0b")


# -- Parquet -----------------------------------------------------------------------------------------
def small_table():
    fields = [row.split(",") for row in ROWS]
    columns = {name: [row[i] for row in fields] for i, name in enumerate(HEADER.split(","))}
    return {n: list(map(int, v)) if n in ("participant", "sequence", "k") else v for n, v in columns.items()}


PARQUET = {
    "text ids": ({"participant": list("abcde")}, ", column participant, type: found 'string', wanted an integer"),
    "float ids": ({"k": [0.0] * 5}, ", column k, type: found 'double', wanted an integer type"),
    "null id": ({"k": [0, 1, None, 0, 1]}, ", row 3, column k: found 'nothing', wanted an integer"),
    "id beyond int64": (
        {"participant": pa.array([2**63 + 1] * 5, pa.uint64())}, ", column participant: Integer value",
    ),
    "coded action": ({"action": [0, 1, 2, 3, 0]}, ", column action, type: found 'int64', wanted text"),
    "null text": ({"condition": [None] * 5}, ", column condition, type: found 'null', wanted text"),
    "text tokens": (
        {"team_tokens": list("abcde")}, ", column team_tokens, type: found 'string', wanted a number type",
    ),
    "missing text": (
        {"observation": [*[r.split(",")[-1] for r in ROWS[:4]], None]},
        ", line 6, column observation: found '', wanted one of no_help, help, none, missing",
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", PARQUET)
def test_parquet_columns(case, tmp_path):
    change, message = PARQUET[case]
    path = tmp_path / "events.parquet"
    pq.write_table(pa.table(small_table() | change), path)
    with pytest.raises(InputError) as caught:
        read_events(path)
    assert str(caught.value).startswith(f"{path}{message}")


def test_damaged_parquet(tmp_path):
    path = tmp_path / "events.parquet"
    write_events(simulate_study1(participants=9), path)
    content = path.read_bytes()
    for damaged in (content[:-30], b"text", b"PAR1" + content[40:], content[:4] + b"PAR1"):
        path.write_bytes(damaged)
        with pytest.raises(InputError, match="corrupt or not a Parquet file"):
            read_events(path)
    pq.write_table(pa.table({"a": [1]}), path)
    with pytest.raises(InputError, match="columns: found 'a', wanted also study, participant"):
        read_events(path)


@pytest.mark.parametrize("name", ["events.txt", "events", "events.csv.zip"])
def test_output_names(name, tmp_path):
    with pytest.raises(InputError, match=r"wanted a name that ends in \.csv, \.csv\.gz or \.parquet"):
        write_events(simulate_study1(participants=2), tmp_path / name)


# -- model files -------------------------------------------------------------------------------------
TRUTH = json.loads((DATA_FOLDER / "simulated" / "calibrated_truth.json").read_text())


def model(*keys, value):
    changed = copy.deepcopy(TRUTH)
    at = changed
    for key in keys[:-1]:
        at = at[key]
    at[keys[-1]] = value
    return changed


def without(*keys):
    changed = copy.deepcopy(TRUTH)
    at = changed
    for key in keys[:-1]:
        at = at[key]
    del at[keys[-1]]
    return changed


MODELS = {
    "row sums to .98": (
        model("transition", "help", 1, value=[0.04, 0.36, 0.47, 0.11]),
        ": model, transition, action help, state low-prosocial, sum of the row: found '0.98', wanted 1 within 1e-9",
    ),
    "initial sums to .98": (
        model("initial", value=[0.07, 0.127, 0.219, 0.564]),
        ": model, initial, sum of the row: found '0.98', wanted 1 within 1e-9",
    ),
    "negative probability": (
        model("transition", "signal", 0, value=[1.1, -0.1, 0.0, 0.0]),
        ": model, transition, action signal, state non-prosocial: found [1.1, -0.1, 0.0, 0.0], wanted prob",
    ),
    "help probability above one": (
        model("help_probability", "signal", 2, value=1.2),
        ", help_probability, action signal, state mid-prosocial: found 1.2, wanted a probability between 0 and 1",
    ),
    "NaN": (
        model("transition", "help", 0, 0, value=float("nan")),
        ": model, transition, action help, state non-prosocial: found [nan, 0.301, 0.117, 0.033], wanted prob",
    ),
    "missing action": (without("transition", "signal"), ", transition: no entry for action 'signal'"),
    "unknown action": (
        model("transition", "hug", value=[]),
        ", transition, key: found 'hug', wanted one of no_help, help, no_signal, signal",
    ),
    "wrong shape": (
        model("transition", "help", value=[[1.0]]),
        ", transition, action help, shape: found (1, 1), wanted numbers of shape 4 x 4",
    ),
    "ragged": (model("transition", "help", value=[[1.0], [0.5, 0.5]]), ", transition, action help: found [["),
    "text for numbers": (
        model("initial", value="uniform"),
        ", initial: found 'uniform', wanted numbers of shape 4",
    ),
    "no emission": (without("help_probability"), ": has neither emission nor (for two responses) help_probability"),
    "no states": (without("states"), ", key states: found None, wanted a list of state names"),
    "states twice": (
        model("states", value=["a", "a", "b", "c"]),
        ": model, state names: found ['a', 'a', 'b', 'c']",
    ),
    "a list": ([1, 2], ": found 'list', wanted a JSON object"),
}


@pytest.mark.parametrize("case", MODELS)
def test_model_files(case, tmp_path):
    content, message = MODELS[case]
    path = tmp_path / "model.json"
    path.write_text(json.dumps(content))
    with pytest.raises(InputError) as caught:
        read_model(path)
    assert str(caught.value).startswith(f"{path}{message}")


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b'{"states": [1,\n 2,,]}', ", line 2, column 4: not valid JSON: "),
        (b"\xff\xfe", ": not UTF-8 text (invalid start byte at byte 0)"),
    ],
)
def test_json(content, message, tmp_path):
    path = tmp_path / "model.json"
    path.write_bytes(content)
    with pytest.raises(InputError) as caught:
        read_json(path)
    assert str(caught.value).startswith(f"{path}{message}")
    with pytest.raises(InputError, match="no such file"):
        read_json(tmp_path / "other.json")
    path.write_text("[" * 500_000)
    with pytest.raises(InputError, match=r"model\.json: JSON nested too deeply to be read"):
        read_json(path)
    with pytest.raises(InputError, match="is a folder, a JSON file was wanted"):
        read_json(tmp_path)


# -- protocol files ----------------------------------------------------------------------------------
TOML = PUBLISHED.to_toml()
PROTOCOLS = {
    "not TOML": ("name = \n", ": not valid TOML: Invalid value (at line 1, column 8)"),
    "no modes": ('name = "x"\n', ", key modes: found None, wanted a table"),
    "no letter": (
        TOML.replace('letter = "R"\n', ""),
        ", mode 'human_needs_help', key letter: found None, wanted text",
    ),
    "cost is text": (
        TOML.replace('"help" = 15.0', '"help" = "dear"'),
        ", mode 'human_needs_help', cost of help: found 'dear', wanted a number",
    ),
    "endless cost": (
        TOML.replace('"help" = 15.0', '"help" = inf'),
        "protocol 'published', mode 'human_needs_help', cost of help: found inf, wanted a finite number",
    ),
    "unknown null action": (
        TOML.replace('null_action = "no_help"', 'null_action = "rest"'),
        "protocol 'published', mode 'human_needs_help', null_action: found 'rest', wanted one of its actions",
    ),
    "long letter": (
        TOML.replace('letter = "R"', 'letter = "RR"'),
        "protocol 'published', mode 'human_needs_help', letter: found 'RR', wanted one letter",
    ),
    "letter twice": (
        TOML.replace('letter = "R"', 'letter = "H"'),
        "protocol 'published', letters: 'H' is declared twice; names must be unique",
    ),
    "reserved response": (
        TOML.replace('"no_help" = 0.0\n', '"none" = 0.0\n'),
        "protocol 'published', responses: found 'none', wanted a name other than",
    ),
    "equal scores": (
        TOML.replace('"help" = 1.0', '"help" = 0.0'),
        "protocol 'published': all responses have the same score, so states cannot be ordered",
    ),
    "no response shows": (
        TOML.replace("shows_response = true", "shows_response = false"),
        "protocol 'published': no mode shows a response, so nothing can be learned",
    ),
}


@pytest.mark.parametrize("case", PROTOCOLS)
def test_protocol_files(case, tmp_path):
    content, message = PROTOCOLS[case]
    path = tmp_path / "protocol.toml"
    assert content != TOML
    path.write_text(content)
    with pytest.raises(InputError) as caught:
        Protocol.from_toml(path)
    assert message in str(caught.value)
