"""Logs read in parts: the same tree, digest and problems as logs read at once, whatever the size of the parts."""

import gzip

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from analysis import event_stream
from analysis.datasets import log_digest
from analysis.event_files import log_table, read_events, write_events
from analysis.event_sorting import KEYS, EventSorter, record_type
from analysis.event_stream import Sizes, compress_events
from analysis.simulate import simulate_study1
from models.errors import InputError
from models.event_rules import COLUMNS, Problems
from models.events import EventLog, EventLogError
from models.identification import constant_actions, strictly_alternating
from models.protocol import PUBLISHED
from tests.analysis.event_text import HEADER, text


def same_tree(found, wanted):
    for one, other in zip(found.arrays, wanted.arrays, strict=True):
        assert one.dtype == other.dtype
        assert np.array_equal(one, other)
    assert np.array_equal(found.parent, wanted.parent)
    assert np.array_equal(found.terminals, wanted.terminals)
    assert np.array_equal(found.depth, wanted.depth)
    assert (found.n_runs, found.n_histories) == (wanted.n_runs, wanted.n_histories)


def same_study(found, log):
    same_tree(found.tree(), log.tree())
    for name in (
        "study",
        "conditions",
        "n_events",
        "n_runs",
        "n_participants",
        "n_responses_recorded",
        "n_missing",
    ):
        assert getattr(found, name) == getattr(log, name), name
    assert np.array_equal(found.emission_weights, log.emission_weights)
    for one, other in zip(found.design, log.design, strict=True):
        assert np.array_equal(one, other)
    for name in log.conditions:
        part = log.select(conditions=[name])
        row = [part.n_events, part.n_runs, part.n_participants, part.n_responses_recorded, part.n_missing]
        assert found.counts.loc[name].tolist() == row


def rows_of(rng, people, tokens):
    """Rows of a valid log, sorted; a person may have several runs, in several conditions."""
    rows = []
    for person in rng.choice(50, size=people, replace=False):
        for sequence in rng.choice(9, size=rng.integers(1, 4), replace=False):
            condition = rng.choice(["help", "signal", "none, at all"])
            for k in range(rng.integers(1, 6)):
                mode = PUBLISHED.modes[rng.integers(len(PUBLISHED.modes))]
                seen = rng.choice(["missing", *PUBLISHED.response_names]) if mode.shows_response else "none"
                action = rng.choice([a.name for a in mode.actions])
                more = [round(float(rng.random()), 3)] if tokens else []
                rows.append(["pilot", int(person), condition, int(sequence), k, mode.name, action, seen, *more])
    return sorted(rows, key=lambda row: (row[1], row[3], row[4]))


def damage(rng, rows):
    """Break up to five rules, or none: a value that is unknown, negative, of another row, or a row twice."""
    for _ in range(rng.integers(0, 6)):
        row = rows[rng.integers(len(rows))]
        column = rng.integers(1, 8)
        if column in (1, 3, 4):
            row[column] = int(rng.integers(-2, 6))
        else:
            row[column] = rng.choice([rows[rng.integers(len(rows))][column], "odd", " "])
    if rng.random() < 0.3:
        rows.insert(int(rng.integers(len(rows))), list(rows[rng.integers(len(rows))]))
    if rng.random() < 0.2:
        rows[rng.integers(len(rows))][0] = rng.choice(["other", " "])


def write(path, rows, tokens):
    names = [*COLUMNS, *(["team_tokens"] if tokens else [])]
    if path.suffix == ".csv":
        lines = [",".join(f'"{v}"' if isinstance(v, str) and "," in v else str(v) for v in row) for row in rows]
        path.write_text("\n\n".join([",".join(names), *lines]) + "\n")
    else:
        columns = {name: [row[i] for row in rows] for i, name in enumerate(names)}
        pq.write_table(pa.table(columns), path, row_group_size=3)


def outcome(read):
    """The result, or the error as it is told."""
    try:
        return read()
    except EventLogError as error:
        return str(error), error.problems, error.total
    except InputError as error:
        return str(error)


@settings(max_examples=60)
@given(
    seed=st.integers(0, 2**32 - 1), suffix=st.sampled_from([".csv", ".parquet"]), shuffled=st.booleans(),
    broken=st.booleans(), rows=st.integers(1, 9), segment=st.integers(1, 9), most=st.integers(2, 4),
)  # fmt: skip
def test_same_log_or_same_problems_as_read_at_once(
    tmp_path_factory, seed, suffix, shuffled, broken, rows, segment, most
):
    rng = np.random.default_rng(seed)
    path = tmp_path_factory.getbasetemp() / f"stream{suffix}"
    tokens = bool(rng.integers(2))
    table = rows_of(rng, rng.integers(1, 7), tokens)
    if broken:
        damage(rng, table)
    if shuffled:
        table = [table[i] for i in rng.permutation(len(table))]
    write(path, table, tokens)
    sizes = Sizes(rows, segment, most)
    wanted = outcome(lambda: read_events(path).log)
    found = outcome(lambda: compress_events(path, sizes=sizes, keep_runs=bool(seed % 2)).log)
    if not isinstance(wanted, EventLog):
        assert found == wanted
        return
    same_study(found, wanted)
    assert found.digest == log_digest(wanted)
    if seed % 2:
        assert np.array_equal(found.tree().run_node, wanted.tree().run_node)


@pytest.mark.parametrize("name", ["a.csv", "a.csv.gz", "a.parquet", "a.parquet.gz"])
def test_every_format_and_one_pass_where_the_file_is_sorted(tmp_path, name):
    log = simulate_study1(participants=200)
    path = tmp_path / name
    if name == "a.parquet.gz":
        write_events(log, tmp_path / "a.parquet")
        path.write_bytes(gzip.compress((tmp_path / "a.parquet").read_bytes()))
    else:
        write_events(log, path)
    seen = []
    found = compress_events(path, sizes=Sizes(rows=100), progress=lambda *state: seen.append(state))
    assert not found.resorted
    same_study(found.log, log)
    assert found.log.digest == log_digest(log)
    assert {label for label, *_ in seen} == {event_stream.SORTED}
    assert all(0 <= done <= total for _, done, total in seen)


def test_chosen_conditions_only(tmp_path):
    log = simulate_study1(participants=300)
    path = tmp_path / "a.parquet"
    order = np.random.default_rng(1).permutation(log.n_events)
    pq.write_table(log_table(log).take(order), path)
    chosen = log.conditions[1:3]
    found = compress_events(path, conditions=chosen)
    assert found.resorted
    part = log.select(conditions=chosen)
    same_tree(found.log.tree(), part.tree())
    assert found.log.n_participants == part.n_participants
    assert found.log.whole == (log.n_events, log.n_participants, log.n_runs)
    assert found.log.digest == log_digest(log)
    for one, other in zip(found.log.design, part.design, strict=True):
        assert np.array_equal(one, other)
    with pytest.raises(InputError, match="condition: found 'nowhere', wanted one of "):
        compress_events(path, conditions=["nowhere"])


def test_files_that_cannot_be_read_are_refused_in_the_same_words(tmp_path):
    header = ",".join(COLUMNS)
    good = "pilot,1,c,0,0,human_needs_help,help,none"
    later = [good.replace(",0,0,", f",0,{k},") for k in range(1, 30)]
    contents = {
        "header.csv": header + "\n",
        "width.csv": text(good, *later, "pilot,1,c,0,30"),
        "number.csv": text(good, *later, good.replace(",0,0,", ",0,x,")),
        "empty.csv": text(good, *later, good.replace(",0,0,", ",0,,")),
        "break.csv": text(good, good.replace(",c,", ',"c\nd",')),
        "columns.csv": text(header=HEADER.replace("mode", "modus")),
        "latin.csv": text(good, "caf\xe9," + good[6:]).encode("latin-1"),
        "nothing.csv": "",
    }
    rows = {name: [good.split(",")[i]] * 7 for i, name in enumerate(COLUMNS)}
    for name in ("participant", "sequence", "k"):
        rows[name] = [0] * 7
    rows["k"] = list(range(7))
    tables = {
        "gap.parquet": pa.table(rows | {"k": [0, 1, 2, 3, None, 5, 6]}),
        "large.parquet": pa.table(rows | {"k": pa.array([0, 1, 2, 3, 2**64 - 1, 5, 6], pa.uint64())}),
        "text.parquet": pa.table(rows | {"k": list("0123456")}),
        # The gap comes first, since its column does, although the type of the other is known at once.
        "both.parquet": pa.table(rows | {"participant": [0, 0, 0, None, 0, 0, 0], "k": list("0123456")}),
        "missing.parquet": pa.table({name: rows[name] for name in COLUMNS[1:]}),
        "empty.parquet": pa.table(rows).slice(0, 0),
        "line.parquet": pa.table(rows | {"condition": ["c", "d\n"] + ["c"] * 5}),
    }
    for name, content in contents.items():
        data = content if isinstance(content, bytes) else content.encode()
        (tmp_path / name).write_bytes(data)
    for name, table in tables.items():
        pq.write_table(table, tmp_path / name)
    (tmp_path / "cut.csv.gz").write_bytes(gzip.compress(text(good, *later).encode())[:-20])
    whole = (tmp_path / "gap.parquet").read_bytes()
    (tmp_path / "cut.parquet").write_bytes(whole[: len(whole) // 2])
    for path in sorted(tmp_path.iterdir()):
        wanted = outcome(lambda path=path: read_events(path))
        assert isinstance(wanted, str | tuple), path.name
        assert outcome(lambda path=path: compress_events(path, sizes=Sizes(rows=2))) == wanted, path.name


def test_problems_beyond_what_is_kept_are_counted(tmp_path, monkeypatch):
    monkeypatch.setattr(Problems, "KEEP", 3)
    good = "pilot,{},c,0,{},human_needs_help,{},none"
    rows = [good.format(person, 1 - k, "odd" if k else "help") for person in range(6) for k in (0, 1)]
    path = tmp_path / "a.csv"
    path.write_text(text(*rows))
    wanted = outcome(lambda: read_events(path))
    assert wanted[2] > len(wanted[1])
    assert outcome(lambda: compress_events(path, sizes=Sizes(2, 2, 2))) == wanted


def test_bounds_of_memory_and_disk(tmp_path):
    rng = np.random.default_rng(3)
    rows = [f"p,1,c,0,{k},human_needs_help,{rng.choice(['help', 'no_help'])},none" for k in range(9_000)]
    path = tmp_path / "long.csv"
    path.write_text(text(*rows))
    assert compress_events(path).log.tree().n_nodes == 9_001
    with pytest.raises(InputError, match="prefix tree, nodes: found more than 4,096, wanted at most 4,096"):
        compress_events(path, memory=1)
    path.write_text(text(*rows[::-1]))
    assert compress_events(path, sizes=Sizes(segment=1000, most_segments=3)).log.n_events == 9_000
    with pytest.raises(InputError, match="rows out of order, bytes of temporary files: found more than 1,000"):
        compress_events(path, disk=1_000, sizes=Sizes(segment=1000))


def test_nothing_stays_behind(tmp_path):
    scratch = tmp_path / "scratch"
    scratch.mkdir()
    path = tmp_path / "a.csv"
    path.write_text(text())
    compress_events(path, folder=scratch)
    path.write_text(text("pilot,1,c,0,3,human_needs_help,help,none"))
    with pytest.raises(EventLogError):
        compress_events(path, folder=scratch)
    assert not list(scratch.iterdir())
    with pytest.raises(InputError, match="temporary files: no folder can be made in "):
        compress_events(path, folder=tmp_path / "nowhere")


@settings(max_examples=25)
@given(st.integers(0, 2**32 - 1), st.integers(1, 400), st.integers(1, 60), st.integers(2, 5))
def test_sorting_outside_of_memory(tmp_path_factory, seed, n, rows, most):
    rng = np.random.default_rng(seed)
    folder = tmp_path_factory.getbasetemp()
    records = np.zeros(n, record_type(()))
    for name in KEYS[:3]:
        records[name] = rng.integers(0, 4, n)
    records["row"] = np.arange(n)
    sorter = EventSorter(folder, records.dtype, 1 << 20, 1 << 30, "events", rows, most)
    for part in np.array_split(records, 7):
        sorter.add(part)
    parts = list(sorter.sorted())
    assert np.array_equal(np.concatenate(parts), np.sort(records, order=KEYS))
    assert sorter.written == 0
    assert not list(folder.glob("segment*"))
    # A part never holds more than a portion of every segment that is merged at a time, and what is left of it.
    assert max(map(len, parts)) <= max(rows, most * max(1, rows // (2 * most)))


def test_what_identification_asks_of_a_design_by_its_words(tmp_path):
    log = simulate_study1(participants=60)
    write_events(log, tmp_path / "a.parquet")
    found = compress_events(tmp_path / "a.parquet").log
    mode = np.asarray(log.protocol.mode_of_action)[log.action]
    frame = log.to_frame()
    met = frame.groupby(["participant", "mode"], observed=True)["action"].nunique()
    assert constant_actions(found) == constant_actions(log) == bool((met == 1).all())
    inside = np.diff(log.run_of_event) == 0
    repeated = bool(np.any(inside & (np.diff(mode) == 0)))
    assert strictly_alternating(found) == strictly_alternating(log)
    assert not (repeated and strictly_alternating(log))
