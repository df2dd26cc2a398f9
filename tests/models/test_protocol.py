"""Protocols: the letters trap, the TOML round trip, and a message for everything that can be wrong."""

import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from models.errors import InputError
from models.protocol import PUBLISHED, Action, Mode, Protocol, Response

THREE = Protocol(
    "three of each",
    (
        Mode("teach", "T", (Action("wait"), Action("show", 2.5)), "wait", False),
        Mode("ask", "A", (Action("silent"), Action("hint", 1.0), Action("plead", 4.0)), "silent", True),
        Mode("praise", "P", (Action("nod"),), "nod", True),
    ),
    (Response("refuse", -1.0), Response("later", 0.0), Response("accept", 2.0)),
)


# -- letters -------------------------------------------------------------------------------------------
def test_the_letter_names_the_helper_and_the_mode_the_one_in_need():
    """The paper: '"H" indicates a round in which the human had an opportunity to help the robot, and "R" indicates
    a round in which the robot had an opportunity to help the human.'
    """
    human_may_help, robot_may_help = PUBLISHED.modes_from_letters("HR")
    assert human_may_help.name == "robot_needs_help"
    assert human_may_help.shows_response
    assert [a.name for a in human_may_help.actions] == ["no_signal", "signal"]
    assert robot_may_help.name == "human_needs_help"
    assert not robot_may_help.shows_response
    assert [a.name for a in robot_may_help.actions] == ["no_help", "help"]


def test_the_paper_still_says_so(shared):
    text = " ".join((shared / "paper" / "paper.tex").read_text(encoding="utf-8").split())
    assert '``H" indicates a round in which the human had an opportunity to help the robot' in text
    assert '``R" indicates a round in which the robot had an opportunity to help the human' in text


@pytest.mark.parametrize("schedule", ["RRHHH", "HRRHH", "HHRRH", "RHRHH", "HRHRH", "RHHRH"])
def test_published_schedules_there_and_back(schedule):
    modes = PUBLISHED.modes_from_letters(schedule)
    assert [m.shows_response for m in modes].count(True) == 3
    assert PUBLISHED.letters_from_modes([m.name for m in modes]) == schedule


@pytest.mark.parametrize(
    ("schedule", "message"),
    [
        ("", "schedule: found '', wanted letters from R, H"),
        ("HRX", "schedule 'HRX', letter 3: found 'X', wanted one of R, H"),
        ("hr", "schedule 'hr', letter 1: found 'h', wanted one of R, H"),
    ],
)
def test_unknown_letters_are_refused_with_their_position(schedule, message):
    with pytest.raises(InputError, match=f"^{re.escape(message)}$"):
        PUBLISHED.modes_from_letters(schedule)


# -- sizes and lookups ------------------------------------------------------------------------------------
def test_published_sizes():
    assert PUBLISHED.action_names == ("no_help", "help", "no_signal", "signal")
    assert PUBLISHED.mode_of_action == (0, 0, 1, 1)
    assert PUBLISHED.emission_actions == ("no_signal", "signal")
    assert PUBLISHED.emission_index == (-1, -1, 0, 1)
    assert PUBLISHED.response_names == ("no_help", "help")
    assert PUBLISHED.scores == (0.0, 1.0)
    assert PUBLISHED.costs == {"no_help": 0.0, "help": 15.0, "no_signal": 0.0, "signal": 15.0}
    assert [m.null_action for m in PUBLISHED.modes] == ["no_help", "no_signal"]


def test_three_modes_three_responses():
    assert (THREE.n_actions, THREE.n_responses) == (6, 3)
    assert THREE.mode_of_action == (0, 0, 1, 1, 1, 2)
    assert THREE.emission_actions == ("silent", "hint", "plead", "nod")
    assert THREE.emission_index == (-1, -1, 0, 1, 2, 3)
    assert THREE.scores == (-1.0, 0.0, 2.0)
    assert THREE.action("plead") == 4
    assert THREE.mode("praise").letter == "P"
    assert [m.name for m in THREE.modes_from_letters("PAT")] == ["praise", "ask", "teach"]


@pytest.mark.parametrize(
    ("lookup", "message"),
    [
        (lambda: THREE.action("help"), "action: found 'help', wanted one of wait, show, silent, hint, plead, nod"),
        (lambda: THREE.mode("T"), "mode: found 'T', wanted one of teach, ask, praise"),
        (lambda: THREE.letters_from_modes(["ask", "x"]), "mode: found 'x', wanted one of teach, ask, praise"),
    ],
)
def test_unknown_names_are_refused(lookup, message):
    with pytest.raises(InputError, match=re.escape(f"protocol 'three of each', {message}")):
        lookup()


# -- what a protocol must be ------------------------------------------------------------------------------
def build(**changes):
    mode = {
        "name": "m",
        "letter": "M",
        "actions": (Action("a"), Action("b")),
        "null_action": "a",
        "shows_response": True,
    }
    responses = changes.pop("responses", (Response("no", 0.0), Response("yes", 1.0)))
    modes = changes.pop("modes", None)
    return Protocol("p", (Mode(**(mode | changes)),) if modes is None else modes, responses)


SILENT = Mode("s", "S", (Action("c"),), "c", False)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"modes": ()}, "protocol 'p': declares no mode"),
        ({"modes": (SILENT, SILENT)}, "protocol 'p', modes: 's' is declared twice; names must be unique"),
        (
            {"modes": (SILENT, Mode("t", "S", (Action("d"),), "d", True))},
            "protocol 'p', letters: 'S' is declared twice; names must be unique",
        ),
        (
            {"modes": (SILENT, Mode("t", "T", (Action("c"),), "c", True))},
            "protocol 'p', actions: 'c' is declared twice; names must be unique",
        ),
        ({"name": ""}, "protocol 'p', modes: an empty name"),
        ({"actions": (Action(""),), "null_action": ""}, "protocol 'p', actions: an empty name"),
        ({"letter": "MM"}, "protocol 'p', mode 'm', letter: found 'MM', wanted one letter"),
        ({"letter": "1"}, "protocol 'p', mode 'm', letter: found '1', wanted one letter"),
        ({"letter": ""}, "protocol 'p', letters: an empty name"),
        ({"actions": ()}, "protocol 'p', mode 'm': declares no action"),
        ({"null_action": "z"}, "protocol 'p', mode 'm', null_action: found 'z', wanted one of its actions: a, b"),
        (
            {"actions": (Action("a", float("nan")),)},
            "protocol 'p', mode 'm', cost of a: found nan, wanted a finite number",
        ),
        (
            {"actions": (Action("a", float("inf")),)},
            "protocol 'p', mode 'm', cost of a: found inf, wanted a finite number",
        ),
        ({"modes": (SILENT,)}, "protocol 'p': no mode shows a response, so nothing can be learned"),
        ({"responses": (Response("yes", 1.0),)}, "protocol 'p', responses: found 1, wanted at least two"),
        ({"responses": ()}, "protocol 'p', responses: found 0, wanted at least two"),
        (
            {"responses": (Response("yes", 1.0), Response("yes", 0.0))},
            "protocol 'p', responses: 'yes' is declared twice; names must be unique",
        ),
        (
            {"responses": (Response("none", 1.0), Response("yes", 0.0))},
            "protocol 'p', responses: found 'none', wanted a name other than ('none', 'missing')",
        ),
        (
            {"responses": (Response("yes", 1.0), Response("missing", 0.0))},
            "protocol 'p', responses: found 'missing', wanted a name other than ('none', 'missing')",
        ),
        (
            {"responses": (Response("yes", 1.0), Response("no", float("nan")))},
            "protocol 'p', score of no: found nan, wanted a finite number",
        ),
        (
            {"responses": (Response("yes", 1.0), Response("no", 1.0))},
            "protocol 'p': all responses have the same score, so states cannot be ordered",
        ),
    ],
)
def test_every_broken_rule_has_its_message(changes, message):
    with pytest.raises(InputError, match=f"^{re.escape(message)}$"):
        build(**changes)


def test_an_action_may_share_its_name_with_a_response():
    assert "no_help" in PUBLISHED.action_names
    assert "no_help" in PUBLISHED.response_names


# -- files ------------------------------------------------------------------------------------------------
texts = st.text(st.characters(exclude_categories=["Cs"]), min_size=1, max_size=12)
numbers = st.floats(allow_nan=False, allow_infinity=False)


@st.composite
def any_protocol(draw):
    n_modes = draw(st.integers(1, 3))
    letters = draw(
        st.lists(st.characters(categories=["Lu", "Ll"]), min_size=n_modes, max_size=n_modes, unique=True)
    )
    names = draw(st.lists(texts, min_size=n_modes, max_size=n_modes, unique=True))
    actions = iter(draw(st.lists(texts, min_size=3 * n_modes, max_size=3 * n_modes, unique=True)))
    modes = []
    for i in range(n_modes):
        own = tuple(Action(next(actions), draw(numbers)) for _ in range(draw(st.integers(1, 3))))
        show = draw(st.booleans()) or i == 0
        modes.append(Mode(names[i], letters[i], own, draw(st.sampled_from(own)).name, show))
    usable = texts.filter(lambda t: t not in ("none", "missing"))
    responses = draw(st.lists(usable, min_size=2, max_size=4, unique=True))
    scores = draw(st.lists(numbers, min_size=len(responses), max_size=len(responses), unique=True))
    pairs = tuple(Response(r, s) for r, s in zip(responses, scores, strict=True))
    return Protocol(draw(texts), tuple(modes), pairs)


@given(any_protocol())
def test_toml_reads_back_as_the_same_protocol(tmp_path_factory, protocol):
    path = tmp_path_factory.getbasetemp() / "round_trip.toml"
    path.write_text(protocol.to_toml(), encoding="utf-8", newline="")
    assert Protocol.from_toml(path) == protocol


@given(any_protocol())
def test_mapping_reads_back_as_the_same_protocol(protocol):
    assert Protocol.from_dict(protocol.to_dict()) == protocol


def test_names_with_line_breaks_and_quotes_survive(tmp_path):
    protocol = build(name='a "quoted"\\name\nwith\ttabs\r, \x00 and \x7f')
    path = tmp_path / "odd.toml"
    path.write_text(protocol.to_toml(), encoding="utf-8", newline="")
    assert Protocol.from_toml(path) == protocol


def test_numpy_numbers_are_written_as_numbers(tmp_path):
    protocol = build(actions=(Action("a", np.float64(1.5)), Action("b", 3)))
    path = tmp_path / "numpy.toml"
    path.write_text(protocol.to_toml(), encoding="utf-8")
    assert Protocol.from_toml(path) == protocol


def test_a_file_written_by_hand(tmp_path):
    path = tmp_path / "own.toml"
    path.write_text(
        'name = "own"\n'
        '[modes.quiet]\nletter = "Q"\nnull_action = "wait"\nshows_response = false\n'
        "actions = { wait = 0, act = 2 }\n"
        '[modes.open]\nletter = "O"\nnull_action = "ask"\nshows_response = true\nactions = { ask = 0.5 }\n'
        "[responses]\nno = 0\nyes = 1\n",
        encoding="utf-8",
    )
    protocol = Protocol.from_toml(path)
    assert protocol.action_names == ("wait", "act", "ask")
    assert protocol.costs == {"wait": 0.0, "act": 2.0, "ask": 0.5}
    assert protocol.emission_actions == ("ask",)


@pytest.mark.parametrize(
    ("line", "replacement", "message"),
    [
        ('name = "published"', "", "key name: found None, wanted text"),
        ('name = "published"', "name = 3", "key name: found 3, wanted text"),
        ('letter = "R"', 'letter = ["R"]', "mode 'human_needs_help', key letter: found ['R'], wanted text"),
        (
            "shows_response = false", 'shows_response = "no"',
            "mode 'human_needs_help', key shows_response: found 'no', wanted true or false",
        ),
        (
            "shows_response = false", "",
            "mode 'human_needs_help', key shows_response: found None, wanted true or false",
        ),
        (
            'actions = {"no_help" = 0.0, "help" = 15.0}', 'actions = ["no_help"]',
            "mode 'human_needs_help', key actions: found ['no_help'], wanted a table",
        ),
        (
            '"help" = 15.0', '"help" = "15"', "mode 'human_needs_help', cost of help: found '15', wanted a number",
        ),
        ('"help" = 1.0', '"help" = true', "score of help: found True, wanted a number"),
    ],
)  # fmt: skip
def test_a_wrong_file_is_refused_with_its_name(tmp_path, line, replacement, message):
    path = tmp_path / "protocol.toml"
    text = PUBLISHED.to_toml()
    assert line in text
    path.write_text(text.replace(line, replacement, 1), encoding="utf-8")
    with pytest.raises(InputError, match=f"^{re.escape(f'{path}, {message}')}$"):
        Protocol.from_toml(path)


def test_a_mode_that_is_no_table_is_refused(tmp_path):
    path = tmp_path / "protocol.toml"
    path.write_text('name = "x"\nmodes = { a = 3 }\nresponses = { no = 0, yes = 1 }\n', encoding="utf-8")
    with pytest.raises(InputError, match=re.escape(f"{path}, mode 'a': found 3, wanted a table")):
        Protocol.from_toml(path)


@pytest.mark.parametrize("content", ["published", 3, None, ["a"]])
def test_a_protocol_that_is_no_table_is_refused(content):
    with pytest.raises(InputError, match=r"^model\.json, protocol: found .*, wanted a table$"):
        Protocol.from_dict(content, "model.json, protocol")


def test_unreadable_files_are_refused(tmp_path):
    with pytest.raises(InputError, match=r"absent\.toml: no such protocol file$"):
        Protocol.from_toml(tmp_path / "absent.toml")
    broken = tmp_path / "broken.toml"
    broken.write_text('name = "x"\nmodes = \n', encoding="utf-8")
    with pytest.raises(InputError, match=r"broken\.toml: not valid TOML: .*line 2"):
        Protocol.from_toml(broken)
    binary = tmp_path / "binary.toml"
    binary.write_bytes(b'name = "\xff"')
    with pytest.raises(InputError, match=r"binary\.toml: not UTF-8 text \(invalid start byte at byte 8\)"):
        Protocol.from_toml(binary)
