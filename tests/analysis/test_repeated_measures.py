"""Tables of repeated measures: what is read, what is left out by name, what is refused."""

import gzip

import numpy as np
import pandas as pd
import pytest

from analysis.repeated_measures import RepeatedMeasures
from analysis.table_files import read_table
from models.errors import InputError
from tests.analysis.anova_cases import COLUMNS, measures, study

ROWS = [
    "1,a,start,3",
    "1,a,final,5",
    "2,a,start,4",
    "2,a,final,4",
    "3,b,start,1",
    "3,b,final,7",
    "4,b,start,2",
    "4,b,final,2",
]
HEADER = "id,policy,time,score"


def from_text(tmp_path, rows=ROWS, header=HEADER, **options):
    path = tmp_path / "t.csv"
    path.write_text("\n".join([header, *rows]) + "\n", encoding="utf-8")
    frame = read_table(path, list(COLUMNS.values()))
    return RepeatedMeasures.from_frame(frame, **{**COLUMNS, "place": "t.csv", **options})


def changed(line, text):
    return [text if i == line else row for i, row in enumerate(ROWS)]


def test_matrix_and_labels(tmp_path):
    data = from_text(tmp_path)
    assert data.score.tolist() == [[3, 5], [4, 4], [1, 7], [2, 2]]
    assert (data.people, data.groups, data.times) == (("1", "2", "3", "4"), ("a", "b"), ("start", "final"))
    assert data.group.tolist() == [0, 0, 1, 1]
    assert data.balanced
    assert not data.binary
    assert data.notes == (
        "Values of time are words and were taken in the order in which they first appear: start, final. Where that "
        "is not their order in time, name them in order (times=..., --times at the command line).",
    )


def test_numbers_are_ordered_by_value_and_words_by_appearance():
    frame = study((2, 2), 3).assign(time=lambda t: t["time"].map({0: "10", 1: "2", 2: "1.5"}))
    assert measures(frame).times == ("1.5", "2", "10")
    words = frame.assign(time=frame["time"].map({"10": "late", "2": "mid", "1.5": "early"}))
    assert measures(words).times == tuple(dict.fromkeys(words["time"]))
    ordered = words.assign(time=pd.Categorical(words["time"], ["early", "mid", "late", "never"]))
    assert measures(ordered).times == ("early", "mid", "late")
    asked = measures(words, times=["early", "mid", "late"])
    assert asked.times == ("early", "mid", "late")
    assert [measures(f).times_by for f in (frame, words, ordered)] == ["value", "appearance", "category"]
    assert asked.times_by == "asked"
    assert [len(m.notes) for m in (measures(frame), measures(words), measures(ordered), asked)] == [0, 1, 0, 0]


def test_chosen_times_are_used_in_the_order_asked_for():
    frame = study((3, 4), 4)
    data = measures(frame, times=["3", "0"])
    assert data.times == ("3", "0")
    assert data.unused_rows == 14
    assert data.score == pytest.approx(
        measures(frame).score[:, [3, 0]][np.argsort(order_of(frame))][order_of_used(frame)]
    )
    assert data.notes == ("14 rows at other times not used.",)
    with pytest.raises(InputError, match="column time: found 0, 1, 2, 3, wanted also '7', as asked for"):
        measures(frame, times=["0", "7"])
    with pytest.raises(InputError, match="times: found 0, 0, wanted different times"):
        measures(frame, times=["0", "0"])


def order_of(frame):
    return np.array([int(i) for i in measures(frame).people])


def order_of_used(frame):
    return np.array([int(i) for i in measures(frame, times=["3", "0"]).people])


def test_people_with_a_missing_time_are_left_out_and_named(tmp_path):
    rows = [*ROWS, "5,b,start,9", "6,a,start,", "6,a,final,3"]
    data = from_text(tmp_path, rows)
    assert data.left_out == ("5", "6")
    assert data.people == ("1", "2", "3", "4")
    assert data.notes[0] == "Left out: 2 people without a value at some time (5, 6)."
    with pytest.raises(InputError, match=r"t\.csv, id 5: found no score at time final, .*\(2 people lack one\)"):
        from_text(tmp_path, rows, missing="refuse")
    for spelling in ("NA", "nan", " "):
        assert from_text(tmp_path, [*ROWS, f"6,a,start,{spelling}", "6,a,final,3"]).left_out == ("6",)


def test_many_who_are_left_out_are_counted():
    frame = study((15, 15), 2)
    gone = frame[(frame["time"] == 0) | (frame["id"] % 2 == 0)]
    assert "and 5 more" in measures(gone).notes[0]


BAD = {
    "no number": (changed(3, "2,a,final,x"), r"t\.csv, line 5, column score: found 'x', wanted a finite number"),
    "infinity": (changed(0, "1,a,start,inf"), r"line 2, column score: found 'inf', wanted a finite number"),
    "duplicate": (
        [*ROWS, "2,a,final,4"],
        r"line 10: found id 2 at time final again, wanted one row a id and time \(the first is line 5\)",
    ),
    "two groups": (changed(3, "2,b,final,4"), r"line 5, column policy: found 'b', wanted 'a', as before for id 2"),
    "one group": ([r.replace(",b,", ",a,") for r in ROWS], r"column policy: found one level \(a\), wanted at "),
    "one time": ([r for r in ROWS if "start" in r], r"column time: found one level \(start\), wanted at least two"),
    "constant": (
        [r.rsplit(",", 1)[0] + ",3" for r in ROWS], r"column score: found 3 in every row, wanted values that",
    ),
    "no group": (changed(4, "3,,start,1"), r"line 6, column policy: found no value, wanted a label"),
    "no person": (changed(4, "NA,b,start,1"), r"line 6, column id: found no value, wanted a label"),
    "empty group": ([*ROWS[:4], "3,b,start,1", "4,b,start,2"], r"policy b: found nobody with a value at"),
    "too few people": ([ROWS[0], ROWS[1], ROWS[4], ROWS[5]], r"t\.csv: found 2 people in 2 groups, wanted more"),
    "huge": (changed(0, "1,a,start,1e300"), r"column score: found 1e\+300, wanted smaller values"),
}  # fmt: skip


@pytest.mark.parametrize("name", list(BAD))
def test_unusable_tables_are_refused(tmp_path, name):
    rows, message = BAD[name]
    with pytest.raises(InputError, match=message):
        from_text(tmp_path, rows)


def test_roles_and_options_are_checked():
    frame = study()
    with pytest.raises(
        InputError, match=r"table, columns: found id, policy, time, score, wanted also 'tokens' \(dv\)"
    ):
        measures(frame, dv="tokens")
    with pytest.raises(InputError, match="table, within: found 'policy', wanted another column than between"):
        measures(frame, within="policy")
    with pytest.raises(InputError, match="missing: found 'guess', wanted 'drop' or 'refuse'"):
        measures(frame, missing="guess")
    with pytest.raises(InputError, match="table: found no rows"):
        measures(frame.iloc[:0])


# -- files ----------------------------------------------------------------------------------------------------
def test_compressed_and_parquet_files_are_the_same_table(tmp_path):
    text = "\n".join([HEADER, *ROWS])
    (tmp_path / "a.csv").write_text(text)
    (tmp_path / "b.gz").write_bytes(gzip.compress(text.encode()))
    pd.read_csv(tmp_path / "a.csv").to_parquet(tmp_path / "c.parquet")
    wanted = measures(read_table(tmp_path / "a.csv", list(COLUMNS.values())))
    for name in ("b.gz", "c.parquet"):
        other = measures(read_table(tmp_path / name, list(COLUMNS.values())))
        assert other.score.tolist() == wanted.score.tolist()
        assert (other.people, other.groups, other.times) == (wanted.people, wanted.groups, wanted.times)


FILES = {
    "empty": (b"", "the file is empty"),
    "header only": (HEADER.encode(), "found no rows, wanted at least one row below the header"),
    "missing column": (b"id,policy,time\n1,a,2\n", "found id, policy, time, wanted also 'score'"),
    "twice": (b"id,policy,time,score,id\n1,a,2,3,4\n", "column id: found several columns of that name, wanted one"),
    "binary": (b"PK\x00\x01", "found binary data, wanted a CSV table"),
    "latin": (f"{HEADER}\n1,h\xe9lp,2,3\n".encode("latin-1"), "found byte 0xe9, wanted text in UTF-8"),
    "ragged": (f"{HEADER}\n1,a,2,3,4,5\n".encode(), "no CSV table: "),
    "damaged parquet": (b"PAR1xxxx", "damaged Parquet file"),
}


@pytest.mark.parametrize("name", list(FILES))
def test_unusable_files_are_refused(tmp_path, name):
    content, message = FILES[name]
    path = tmp_path / "t.csv"
    path.write_bytes(content)
    with pytest.raises(InputError, match=message):
        read_table(path, list(COLUMNS.values()))


def test_blank_lines_at_the_end_are_no_rows(tmp_path):
    assert from_text(tmp_path, [*ROWS, "", ""]).score.shape == (4, 2)
    with pytest.raises(InputError, match="line 6, column time: found no value"):
        from_text(tmp_path, [*ROWS[:4], "", *ROWS[4:]])
