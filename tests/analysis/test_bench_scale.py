"""The benchmark of scale: files as promised, rows with their targets."""

import pytest

from analysis.bench import scale
from analysis.datasets import log_digest
from analysis.event_files import read_events


@pytest.mark.parametrize("suffix", ["csv", "parquet"])
def test_large_files_are_studies_one_after_the_other(tmp_path, monkeypatch, suffix):
    monkeypatch.setattr(scale, "PART", 50)
    path, mixed = tmp_path / f"a.{suffix}", tmp_path / "b.parquet"
    n = scale.write_large(path, 2_000)
    log = read_events(path).log
    assert 2_000 <= n == log.n_events < 2_000 + 50 * 5
    assert log.n_participants == log.participant.max()
    assert scale.write_large(mixed, 2_000, shuffled=True) == n
    other = read_events(mixed).log
    assert sorted(other.response) == sorted(log.response)
    again = tmp_path / f"c.{suffix}"
    scale.write_large(again, 2_000)
    assert log_digest(read_events(again).log) == log_digest(log)


@pytest.mark.slow
def test_rows(monkeypatch):
    monkeypatch.setattr(scale, "QUICK_EVENTS", 20_000)
    rows = {row.name: row for row in scale.run(quick=True)}
    assert len(rows) == 3 * 2 + 2
    assert rows["the Parquet and the CSV file have one digest"].met
    peaks = [row for name, row in rows.items() if name.startswith("peak memory")]
    assert all(row.met and 50 < row.ours < 2048 for row in peaks)
    assert all(row.ours > 0 for row in rows.values())


@pytest.mark.slow
@pytest.mark.parametrize("shuffled", [False, True])
def test_memory_does_not_grow_with_the_file(tmp_path, shuffled):
    warm, path = tmp_path / "warm.parquet", tmp_path / "a.parquet"
    scale.write_large(warm, 1_000, shuffled=True)
    peaks = []
    for events in (300_000, 3_000_000):
        scale.write_large(path, events, shuffled=shuffled)
        # Small enough that even the smaller file is sorted in several segments.
        found = scale.measured(path, warm, memory=32 << 20)
        assert found["events"] == events
        assert found["resorted"] == shuffled
        peaks.append(found["peak"])
    # Ten times the rows held would be 300 MiB more.
    assert peaks[1] - peaks[0] < 100 * 2**20
