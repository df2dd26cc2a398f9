"""Problems of a file by cause: one message for rows that are wrong alike, and no row lost."""

import json

import pytest

from analysis.event_import import import_events
from analysis.problem_causes import causes, told
from models.event_rules import Problem
from models.events import EventLogError
from tests.analysis.command import run_captured
from tests.analysis.test_event_import import EXAMPLE

PEOPLE = 30


@pytest.fixture
def export(tmp_path):
    """Everybody's third round was never played; two rows came twice; one response is no word."""
    rows = ["prolific_id,help_arm,signal_arm,round,opportunity,robot_helped,robot_signalled,human_helped"]
    for n in range(PEOPLE):
        rows += [f"p{n},help,signal,1,R,1,,", f"p{n},help,signal,2,H,,1,1", f"p{n},help,signal,3,R,,,"]
    rows[2] = rows[2][:-1] + "perhaps"
    raw, column_map = tmp_path / "raw.csv", tmp_path / "map.toml"
    raw.write_text("\n".join(rows) + "\n")
    column_map.write_text(EXAMPLE.read_text())
    return raw, column_map


def test_one_message_a_cause_and_every_row_counted(export, capsys, tmp_path):
    raw, column_map = export
    out = tmp_path / "log.csv"
    status, _, err = run_captured(capsys, "data", "import", raw, "--map", column_map, "--out", out)
    lines = err.splitlines()
    assert status == 2
    assert lines[0] == (
        f"prosocial: {raw}: {PEOPLE + 1} problems of 2 kinds (--all lists every line; so does --json FILE)"
    )
    assert len(lines) == 3
    assert lines[1].startswith("  line 3, column human_helped: found 'perhaps', wanted a value mapped in ")
    assert lines[2].startswith(f"  column robot_helped: {PEOPLE} lines, found '', wanted a value mapped in ")
    assert lines[2].endswith(f"(lines 4, 7, 10, 13, 16 and {PEOPLE - 5} more)")
    assert not out.exists()


def test_nothing_is_lost(export, capsys, tmp_path):
    raw, column_map = export
    words = ("data", "import", raw, "--map", column_map, "--out", tmp_path / "log.csv")
    status, out, err = run_captured(capsys, *words, "--all", "--json", "-")
    content = json.loads(out)
    assert status == 2
    assert len(err.splitlines()) == 1 + PEOPLE + 1
    assert [p["line"] for p in content["problems"]] == [3, *range(4, 3 * PEOPLE + 2, 3)]
    assert [c["count"] for c in content["causes"]] == [1, PEOPLE]
    assert sorted(n for c in content["causes"] for n in c["lines"]) == [p["line"] for p in content["problems"]]
    assert content["total_problems"] == PEOPLE + 1


def test_rules_that_name_their_row_are_one_cause(export):
    raw, column_map = export
    text = raw.read_text().splitlines()
    whole = [text[0], *(line for line in text[1:] if ",3,R," not in line)]
    whole[2] = whole[2].replace("perhaps", "1")
    raw.write_text("\n".join([*whole, whole[1], whole[3]]) + "\n")
    with pytest.raises(EventLogError) as caught:
        import_events(raw, column_map)
    (cause,) = causes(caught.value.problems)
    assert cause.column in ("k", "round")
    assert [p.line for p in cause.problems] == [p.line for p in caught.value.problems]
    assert "each event once" in cause.sentence


def test_values_and_what_was_not_kept():
    rows = [Problem(n, "mode", repr("abcdef"[n % 6]), "one of H, R") for n in range(2, 20)]
    (cause,) = causes(rows)
    assert sum(cause.values.values()) == 18
    assert "and 2 other values" in cause.sentence
    assert told("f.csv", rows, 30).endswith("  and 12 more like these, not kept")
    assert told("f.csv", rows[:1], 1) == "f.csv: 1 problem\n  line 2, column mode: found 'c', wanted one of H, R"
