"""The event log: round trip, sorting, and a message with line number for every broken rule."""

import re

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from models.errors import InputError
from models.event_rules import Problems, check_columns
from models.event_scan import scan_sorted
from models.events import COLUMNS, Coded, EventLog, EventLogError
from models.histories import UNSEEN
from models.protocol import PUBLISHED
from tests.models.test_protocol import THREE
from tests.random_cases import protocols, random_run

HEADER = ("study", "participant", "condition", "sequence", "k", "mode", "action", "observation")
ROWS = [  # lines 2..9 of the file
    ("pilot", 1, "S+", 0, 0, "human_needs_help", "help", "none"),
    ("pilot", 1, "S+", 0, 1, "robot_needs_help", "signal", "help"),
    ("pilot", 1, "S+", 0, 2, "robot_needs_help", "signal", "missing"),
    ("pilot", 1, "S-", 1, 0, "robot_needs_help", "no_signal", "no_help"),
    ("pilot", 4, "S-", 0, 0, "robot_needs_help", "no_signal", "help"),
    ("pilot", 4, "S-", 0, 1, "human_needs_help", "no_help", "none"),
    ("pilot", 7, "control", 2, 0, "human_needs_help", "no_help", "none"),
    ("pilot", 7, "control", 2, 1, "robot_needs_help", "no_signal", "missing"),
]


def frame(rows=ROWS):
    return pd.DataFrame(rows, columns=list(HEADER))


def changed(*changes):
    """The rows with cells ``(line, column, value)`` replaced."""
    rows = [list(row) for row in ROWS]
    for line, column, value in changes:
        rows[line - 2][HEADER.index(column)] = value
    return frame(rows)


def assert_same_log(one, two):
    assert one.protocol == two.protocol
    assert (one.study, one.conditions) == (two.study, two.conditions)
    for name in ("offsets", "participant", "sequence", "condition", "action", "response"):
        array, twin = getattr(one, name), getattr(two, name)
        assert np.array_equal(array, twin), name
        assert array.dtype == twin.dtype, name
    assert set(one.tokens) == set(two.tokens)
    for name, values in one.tokens.items():
        assert np.array_equal(values, two.tokens[name], equal_nan=True)


# -- reading ---------------------------------------------------------------------------------------------
def test_a_small_log_as_coded():
    log = EventLog.from_frame(frame())
    assert log.study == "pilot"
    assert log.offsets.tolist() == [0, 3, 4, 6, 8]
    assert log.participant.tolist() == [1, 1, 4, 7]
    assert log.sequence.tolist() == [0, 1, 0, 2]
    assert log.conditions == ("S+", "S-", "control")
    assert log.condition.tolist() == [0, 1, 1, 2]
    assert log.action.tolist() == [1, 3, 3, 2, 2, 0, 0, 2]
    assert log.response.tolist() == [UNSEEN, 1, UNSEEN, 0, 1, UNSEEN, UNSEEN, UNSEEN]
    assert (log.n_events, log.n_runs, log.n_participants) == (8, 4, 3)
    assert (log.n_responses_recorded, log.n_missing) == (3, 2)
    assert log.emission_weights.tolist() == [2.0, 1.0]
    assert log.shows.tolist() == [False, True, True, True, True, False, False, True]
    assert log.k.tolist() == [0, 1, 2, 0, 0, 1, 0, 1]
    assert log.run_of_event.tolist() == [0, 0, 0, 1, 2, 2, 3, 3]
    assert log.schedules().tolist() == ["RHH", "H", "HR", "RH"]
    assert "3 people, 4 runs, 8 events, 3 responses, 3 conditions" in repr(log)


def test_from_frame_and_back():
    log = EventLog.from_frame(frame())
    again = log.to_frame()
    assert list(again.columns) == list(COLUMNS) == list(HEADER)
    pd.testing.assert_frame_equal(again.astype(frame().dtypes), frame())
    assert_same_log(EventLog.from_frame(again), log)


def test_tokens_are_kept_beside_their_events():
    tokens = frame().assign(team_tokens=np.arange(8.0), human_tokens=[np.nan, 1, 2, 3, 4, 5, 6, 7])
    log = EventLog.from_frame(tokens.iloc[::-1])
    assert set(log.tokens) == {"team_tokens", "human_tokens"}
    assert log.tokens["team_tokens"].tolist() == list(range(8))
    assert np.isnan(log.tokens["human_tokens"][0])
    assert_same_log(EventLog.from_frame(log.to_frame()), log)


@given(st.permutations(range(len(ROWS))))
def test_the_order_of_rows_does_not_matter(order):
    assert_same_log(EventLog.from_frame(frame().iloc[list(order)]), EventLog.from_frame(frame()))


@st.composite
def logs(draw):
    """A random log as a frame in run order, with its protocol."""
    protocol = draw(protocols())
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    rows = []
    for participant in np.flatnonzero(rng.random(8) < 0.6).tolist() or [3]:
        for sequence in range(rng.integers(1, 3)):
            run = random_run(rng, protocol, int(rng.integers(1, 5)), 0.3)
            condition = str(rng.choice(["a", "b", "ü c"]))
            for k, (a, o) in enumerate(run):
                mode = protocol.modes[protocol.mode_of_action[a]]
                seen = protocol.response_names[o] if o >= 0 else "missing" if mode.shows_response else "none"
                rows.append(
                    ("s", participant, condition, 2 * sequence, k, mode.name, protocol.action_names[a], seen)
                )
    return frame(rows), protocol


@given(logs(), st.randoms(use_true_random=False))
def test_any_log_goes_to_a_frame_and_back_in_any_order(drawn, random):
    rows, protocol = drawn
    log = EventLog.from_frame(rows, protocol)
    pd.testing.assert_frame_equal(log.to_frame().astype(rows.dtypes), rows)
    shuffled = rows.iloc[random.sample(range(len(rows)), len(rows))]
    assert_same_log(EventLog.from_frame(shuffled, protocol), log)
    assert log.tree().n_runs == log.n_runs


def test_a_three_mode_log():
    rows = [
        ("s", 0, "c", 0, 0, "teach", "show", "none"),
        ("s", 0, "c", 0, 1, "ask", "plead", "later"),
        ("s", 0, "c", 0, 2, "praise", "nod", "refuse"),
        ("s", 0, "c", 0, 3, "ask", "hint", "missing"),
    ]
    log = EventLog.from_frame(frame(rows), THREE)
    assert log.action.tolist() == [1, 4, 5, 3]
    assert log.response.tolist() == [-1, 1, 0, -1]
    assert log.emission_weights.tolist() == [0, 0, 1, 1]
    assert log.schedules().tolist() == ["TAPA"]


def test_text_and_float_integers_are_understood():
    text = frame().astype({"participant": str, "k": float})
    assert_same_log(EventLog.from_frame(text), EventLog.from_frame(frame()))


# -- every rule ----------------------------------------------------------------------------------------------
RULES = [
    ([(3, "participant", -1)], "line 3, column participant: found -1, wanted an integer of at least 0"),
    ([(5, "sequence", -2)], "line 5, column sequence: found -2, wanted an integer of at least 0"),
    ([(4, "study", "other")], "line 4, column study: found 'other', wanted one study a file, here 'pilot'"),
    ([(n, "study", " ") for n in range(2, 10)], "line 2, column study: found ' ', wanted a study name"),
    ([(n, "condition", "") for n in (8, 9)], "line 8, column condition: found '', wanted a condition name"),
    ([(n, "condition", None) for n in (8, 9)], "line 8, column condition: found '', wanted a condition name"),
    (
        [(4, "mode", "human")],
        "line 4, column mode: found 'human', wanted one of human_needs_help, robot_needs_help",
    ),
    ([(4, "mode", None)], "line 4, column mode: found '', wanted one of human_needs_help, robot_needs_help"),
    (
        [(4, "action", "Signal")],
        "line 4, column action: found 'Signal', wanted one of no_help, help, no_signal, signal",
    ),
    (
        [(4, "action", "help")],
        "line 4, column action: found 'help', wanted an action of mode robot_needs_help: one of no_signal, signal",
    ),
    (
        [(4, "observation", "yes")],
        "line 4, column observation: found 'yes', wanted one of no_help, help, none, missing",
    ),
    (
        [(4, "observation", np.nan)],
        "line 4, column observation: found '', wanted one of no_help, help, none, missing",
    ),
    (
        [(2, "observation", "help")],
        "line 2, column observation: found 'help', wanted 'none', since this mode shows no response",
    ),
    (
        [(2, "observation", "missing")],
        "line 2, column observation: found 'missing', wanted 'none', since this mode shows no response",
    ),
    (
        [(3, "observation", "none")],
        "line 3, column observation: found 'none', wanted one of no_help, help, or 'missing' where it was not "
        "recorded: this mode shows the response",
    ),
    (
        [(4, "k", 3)],
        "line 4, column k: found 3, wanted 2: events of a run (participant 1, sequence 0) are numbered 0, 1, 2, "
        "... without gaps",
    ),
    (
        [(6, "k", 1), (7, "k", 2)],
        "line 6, column k: found 1, wanted 0: events of a run (participant 4, sequence 0) are numbered 0, 1, 2, "
        "... without gaps",
    ),
    (
        [(4, "k", 1)],
        "line 4, column k: found 1, wanted each event once: participant 1, sequence 0 already has an event 1",
    ),
    (
        [(4, "condition", "S-")],
        "line 4, column condition: found 'S-', wanted the condition of its run (participant 1, sequence 0), 'S+'",
    ),
]


@pytest.mark.parametrize(("changes", "message"), RULES)
def test_every_broken_rule_has_its_message(changes, message):
    with pytest.raises(EventLogError) as caught:
        EventLog.from_frame(changed(*changes), place="pilot.csv")
    assert caught.value.place == "pilot.csv"
    assert message in [str(p) for p in caught.value.problems]
    first = caught.value.problems[0]
    assert str(caught.value).startswith(f"pilot.csv, {first}")


@pytest.mark.parametrize(("changes", "message"), RULES)
def test_line_numbers_are_those_of_the_file_as_it_was_not_as_sorted(changes, message):
    """The same rows in reverse: line n becomes line 11 - n."""
    line = int(re.match(r"line (\d+)", message)[1])
    with pytest.raises(EventLogError) as caught:
        EventLog.from_frame(changed(*changes).iloc[::-1])
    lines = {(p.line, p.column) for p in caught.value.problems}
    column = re.search(r"column (\w+)", message)[1]
    if "each event once" in message:  # which of the two copies comes second has changed
        assert lines == {(11 - line + 1, column)} or lines == {(11 - line, column)}
    elif len(changes) == 1 or column != "study":
        assert (11 - line, column) in lines


def test_all_problems_are_collected_in_order_of_their_lines():
    broken = changed((8, "mode", "x"), (3, "observation", "y"), (5, "action", "z"))
    with pytest.raises(EventLogError) as caught:
        EventLog.from_frame(broken, place="f.csv")
    error = caught.value
    assert [(p.line, p.column, p.value) for p in error.problems] == [
        (3, "observation", "'y'"),
        (5, "action", "'z'"),
        (8, "mode", "'x'"),
    ]
    assert error.total == 3
    assert str(error).endswith("(3 problems in all; `prosocial data check` lists them)")


def test_one_problem_is_not_counted_aloud():
    with pytest.raises(EventLogError) as caught:
        EventLog.from_frame(changed((4, "mode", "x")))
    assert caught.value.total == 1
    assert "problems in all" not in str(caught.value)


def test_thousands_of_problems_are_counted_and_some_kept(monkeypatch):
    monkeypatch.setattr(Problems, "KEEP", 200)
    rows = [("s", i, "c", 0, 0, "robot_needs_help", "wave", "help") for i in range(1000)]
    with pytest.raises(EventLogError) as caught:
        EventLog.from_frame(frame(rows))
    assert caught.value.total == 1000
    assert len(caught.value.problems) == 200
    assert caught.value.problems[-1].line == 201


@pytest.mark.parametrize("column", ["participant", "sequence", "k"])
@pytest.mark.parametrize(
    ("value", "shown"),
    [
        ("seven", "'seven'"),
        (1.5, "1.5"),
        (None, "None"),
        (float("nan"), "nan"),
        (float("inf"), "inf"),
        (1e300, "1e+300"),
    ],
)
def test_ids_that_are_no_integers_are_refused(column, value, shown):
    rows = frame().astype({column: object})
    rows.loc[3, column] = value
    with pytest.raises(
        EventLogError, match=re.escape(f"line 5, column {column}: found {shown}, wanted an integer")
    ):
        EventLog.from_frame(rows)


@pytest.mark.parametrize("value", [1.5, np.nan, np.inf, 1e300])
def test_float_ids_that_are_no_integers_are_refused(value):
    rows = frame().astype({"participant": float})
    rows.loc[3, "participant"] = value
    message = f"line 5, column participant: found {value}, wanted an integer"
    with pytest.raises(EventLogError, match=re.escape(message)):
        EventLog.from_frame(rows)


@pytest.mark.parametrize("value", [-1.0, np.inf, -np.inf])
def test_impossible_token_counts_are_refused(value):
    rows = frame().assign(robot_tokens=1.0)
    rows.loc[5, "robot_tokens"] = value
    message = f"line 7, column robot_tokens: found {value}, wanted a number of at least 0, or empty"
    with pytest.raises(EventLogError, match=re.escape(message)):
        EventLog.from_frame(rows)


def test_token_counts_that_are_no_numbers_are_refused():
    rows = frame().assign(robot_tokens=["1", "2", "3", "many", "5", "6", "7", "8"])
    message = "line 5, column robot_tokens: found 'many', wanted a number of at least 0, or empty"
    with pytest.raises(EventLogError, match=re.escape(message)):
        EventLog.from_frame(rows)


def test_empty_and_textual_token_counts_are_understood():
    rows = frame().assign(robot_tokens=["1", None, "2.5", *"45678"])
    tokens = EventLog.from_frame(rows).tokens["robot_tokens"]
    assert np.array_equal(tokens, [1, np.nan, 2.5, 4, 5, 6, 7, 8], equal_nan=True)


def test_long_ids_keep_every_digit():
    """Two people whose ids differ only beyond the digits of a float."""
    ids = [str(2**53 + 1)] * 4 + [str(2**53)] * 4
    rows = frame([("s", p, "c", 0, k % 4, "human_needs_help", "help", "none") for k, p in enumerate(ids)])
    log = EventLog.from_frame(rows)
    assert log.participant.tolist() == [2**53, 2**53 + 1]
    with pytest.raises(
        EventLogError, match=r"line 2, column participant: found 9007199254740992\.0, wanted an integer"
    ):
        EventLog.from_frame(rows.astype({"participant": float}))


def test_missing_columns_and_empty_logs_are_refused():
    with pytest.raises(InputError, match=r"^x\.csv, columns: found \[.*\], wanted also condition, k$"):
        EventLog.from_frame(frame().drop(columns=["k", "condition"]), place="x.csv")
    with pytest.raises(InputError, match=r"^x\.csv: found no events, wanted at least one row below the header$"):
        EventLog.from_frame(frame().iloc[:0], place="x.csv")


# -- the compiled pass and the rules agree -------------------------------------------------------------------
def columns_of(rows, tokens=False):
    out = {}
    for name in HEADER:
        if name in ("participant", "sequence", "k"):
            out[name] = rows[name].to_numpy(dtype=np.int64)
        else:
            codes, labels = pd.factorize(rows[name].astype(object))
            out[name] = Coded(codes, list(labels))
    return out


BROKEN = {
    "study": ["pilot", "other", " ", None],
    "participant": [-1, 0, 1, 2, 9],
    "condition": ["a", "b", "", None],
    "sequence": [-1, 0, 1, 2, 5],
    "k": [-1, 0, 1, 2, 7],
    "mode": ["mode0", "mode1", "x", None],
    "action": ["act00", "act01", "act10", "y", None],
    "observation": ["none", "missing", "r0", "r1", "z", None],
}


@given(logs(), st.data())
def test_scan_accepts_exactly_the_sorted_logs_that_keep_every_rule(drawn, data):
    rows, protocol = drawn
    rows = rows.astype(object)
    for _ in range(data.draw(st.integers(0, 2))):
        line = data.draw(st.integers(0, len(rows) - 1))
        column = data.draw(st.sampled_from(HEADER))
        rows.loc[line, column] = data.draw(st.sampled_from(BROKEN[column]))
    columns = columns_of(rows)
    scanned = scan_sorted(columns, protocol)
    try:
        checked = check_columns(columns, protocol, "x")
    except EventLogError:
        assert scanned is None
        return
    keys = list(zip(rows["participant"], rows["sequence"], rows["k"], strict=True))
    assert (scanned is not None) == (keys == sorted(keys))
    if scanned is not None:
        assert np.array_equal(scanned.offsets, checked.offsets)
        assert np.array_equal(scanned.action, checked.action)
        assert np.array_equal(scanned.response, np.maximum(checked.response - 2, UNSEEN))


# -- parts of a log ------------------------------------------------------------------------------------------
LOG = EventLog.from_frame(frame().assign(team_tokens=np.arange(8.0)))


def test_select_by_condition():
    part = LOG.select(conditions=["S-", "control"])
    assert part.conditions == ("S-", "control")
    assert part.condition.tolist() == [0, 0, 1]
    assert part.participant.tolist() == [1, 4, 7]
    assert part.offsets.tolist() == [0, 1, 3, 5]
    assert part.action.tolist() == [2, 2, 0, 0, 2]
    assert part.response.tolist() == [0, 1, -1, -1, -1]
    assert part.tokens["team_tokens"].tolist() == [3, 4, 5, 6, 7]


@pytest.mark.parametrize("runs", [np.array([2, 0]), np.array([True, False, True, False])])
def test_select_by_run_keeps_the_order_of_the_log(runs):
    part = LOG.select(runs=runs)
    assert part.participant.tolist() == [1, 4]
    assert part.tokens["team_tokens"].tolist() == [0, 1, 2, 4, 5]


def test_select_by_several_criteria():
    part = LOG.select(conditions=["S-"], participants=np.array([1, 7]))
    assert list(zip(part.participant.tolist(), part.sequence.tolist(), strict=True)) == [(1, 1)]
    assert part.n_participants == 1


def test_selecting_everything_changes_nothing():
    assert_same_log(LOG.select(), LOG)


def test_select_equals_filtering_the_frame():
    rows = LOG.to_frame()
    kept = rows[rows["participant"].isin([1, 7]) & (rows["condition"] != "S+")]
    assert_same_log(
        LOG.select(participants=np.array([1, 7]), conditions=["S-", "control"]), EventLog.from_frame(kept)
    )


def test_selections_that_find_nothing_are_refused():
    with pytest.raises(InputError, match=r"condition: found 'S', wanted one of S\+, S-, control"):
        LOG.select(conditions=["S"])
    with pytest.raises(InputError, match="selection: found no runs, wanted at least one run of the log"):
        LOG.select(participants=np.array([2]))


def test_other_responses_keep_the_design_and_drop_the_tokens():
    other = LOG.with_responses(np.array([-1, 0, -1, 1, 0, -1, -1, -1], dtype=np.int8))
    assert other.response.tolist() == [-1, 0, -1, 1, 0, -1, -1, -1]
    assert np.array_equal(other.action, LOG.action)
    assert other.tokens == {}
    assert LOG.response.tolist()[:2] == [-1, 1]


def test_the_tree_of_a_log():
    tree = LOG.tree()
    assert tree.n_runs == 4
    assert [int(tree.depth[n]) for n in tree.run_node] == [3, 1, 2, 2]
    assert tree.n_actions == PUBLISHED.n_actions
