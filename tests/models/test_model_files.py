"""Model files: exact round trip, the shorthand, and messages that name file and place."""

import json
import re
import stat

import numpy as np
import pytest
from hypothesis import given

from models.errors import InputError
from models.lspomdp import LatentStatePOMDP
from models.model_files import (
    model_from_dict,
    model_to_dict,
    read_json,
    read_model,
    write_bytes,
    write_model,
    write_text,
)
from models.protocol import PUBLISHED
from models.reward import Reward
from tests.models.test_protocol import THREE
from tests.random_cases import cases, random_tables


def model(n_states=3, protocol=PUBLISHED, **more):
    return LatentStatePOMDP(*random_tables(np.random.default_rng(7), protocol, n_states), protocol, **more)


def assert_same_bits(one, two):
    for name in ("initial", "transition", "emission"):
        assert getattr(one, name).tobytes() == getattr(two, name).tobytes(), name
    assert one.protocol == two.protocol
    assert one.state_names == two.state_names
    assert one.reward == two.reward


@given(cases(max_paths=10**9))
def test_json_round_trip_keeps_every_bit(case):
    original = LatentStatePOMDP(*case.tables, case.protocol)
    text = json.dumps(model_to_dict(original))
    assert_same_bits(model_from_dict(json.loads(text)), original)


def test_file_round_trip_keeps_names_reward_and_protocol(tmp_path):
    original = model(
        3, THREE, state_names=("low", "mittel", "höch"), reward=Reward((1.1, 2.2, 3.3), 0.1, {"hint": 0.3})
    )
    write_model(original, tmp_path / "below" / "model.json")
    assert_same_bits(read_model(tmp_path / "below" / "model.json"), original)


def content(**changes):
    out = model_to_dict(model(2))
    out.update(changes)
    return {k: v for k, v in out.items() if v is not ...}


def test_help_probability_is_shorthand_for_two_responses():
    entry = content(emission=..., help_probability={"no_signal": [0.25, 0.75], "signal": [0.5, 1.0]})
    found = model_from_dict(entry).emission
    assert found.tolist() == [[[0.75, 0.25], [0.25, 0.75]], [[0.5, 0.5], [0.0, 1.0]]]


def test_the_shorthand_means_the_response_with_the_higher_score():
    protocol = PUBLISHED.to_dict() | {"responses": {"helps": 1.0, "refuses": 0.0}}
    entry = content(
        emission=..., protocol=protocol, help_probability={"no_signal": [0.25, 0.75], "signal": [0.5, 1]}
    )
    assert model_from_dict(entry).emission[0].tolist() == [[0.25, 0.75], [0.75, 0.25]]


def test_the_shorthand_is_not_accepted_for_three_responses():
    entry = model_to_dict(model(2, THREE))
    del entry["emission"]
    entry["help_probability"] = {a: [0.5, 0.5] for a in THREE.emission_actions}
    with pytest.raises(InputError, match=r"neither emission nor \(for two responses\) help_probability"):
        model_from_dict(entry)


def test_a_published_model_also_states_the_shorthand_and_it_agrees():
    entry = model_to_dict(model(2))
    again = model_from_dict({k: v for k, v in entry.items() if k != "emission"})
    np.testing.assert_allclose(again.emission, model(2).emission, atol=1e-15)
    assert "help_probability" not in model_to_dict(model(2, THREE))


def test_unknown_keys_are_allowed():
    assert_same_bits(model_from_dict(content(note="by hand", expected={"x": 1})), model(2))


def test_the_published_protocol_is_the_default():
    assert model_from_dict(content(protocol=...)).protocol == PUBLISHED


def test_protocol_in_use_and_in_the_file_must_agree():
    with pytest.raises(
        InputError, match="protocol: found 'published', wanted the protocol in use, 'three of each'"
    ):
        model_from_dict(content(), protocol=THREE)


GOOD = [[0.5, 0.5], [0.5, 0.5]]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"states": ...}, "key states: found None, wanted a list of state names"),
        ({"states": []}, "key states: found [], wanted a list of state names"),
        ({"states": [1, 2]}, "key states: found [1, 2], wanted a list of state names"),
        ({"initial": ...}, "initial, shape: found (), wanted numbers of shape 2"),
        ({"initial": [1.0]}, "initial, shape: found (1,), wanted numbers of shape 2"),
        ({"initial": ["a", "b"]}, "initial: found ['a', 'b'], wanted numbers of shape 2"),
        (
            {"transition": ...},
            "transition: found None, wanted an object with keys no_help, help, no_signal, signal",
        ),
        (
            {"transition": {"no_help": GOOD, "help": GOOD, "no_signal": GOOD}},
            "transition: no entry for action 'signal'",
        ),
        (
            {"transition": {"wave": GOOD}},
            "transition, key: found 'wave', wanted one of no_help, help, no_signal, signal",
        ),
        (
            {"transition": {"no_help": GOOD, "help": GOOD, "no_signal": GOOD, "signal": [[1.0]]}},
            "transition, action signal, shape: found (1, 1), wanted numbers of shape 2 x 2",
        ),
        ({"emission": {"help": GOOD}}, "emission, key: found 'help', wanted one of no_signal, signal"),
        (
            {"emission": ..., "help_probability": ...},
            "has neither emission nor (for two responses) help_probability",
        ),
        (
            {"emission": ..., "help_probability": {"no_signal": [0.5, 0.5], "signal": [0.5, 1.5]}},
            "help_probability, action signal, state s1: found 1.5, wanted a probability between 0 and 1",
        ),
        ({"initial": [0.5, 0.48]}, "model, initial, sum of the row: found '0.98', wanted 1 within 1e-9"),
        ({"reward": [1]}, "reward: found [1], wanted an object with x, r and costs"),
        ({"reward": {"x": [1, 2, 3]}}, "reward, x, shape: found (3,), wanted numbers of shape 2"),
        ({"reward": {"r": "steep"}}, "reward, r: found 'steep', wanted numbers of shape "),
        ({"reward": {"costs": 15}}, "reward, costs: found 15, wanted an object of action costs"),
        ({"reward": {"costs": {"help": "x"}}}, "reward, cost of help: found 'x', wanted numbers of shape "),
        ({"protocol": "published"}, "protocol: found 'published', wanted a table"),
    ],
)
def test_a_wrong_file_is_refused_with_its_name_and_place(tmp_path, changes, message):
    path = tmp_path / "model.json"
    path.write_text(json.dumps(content(**changes)), encoding="utf-8")
    with pytest.raises(InputError) as caught:
        read_model(path)
    text = str(caught.value)
    assert text.startswith(str(path))
    assert message in text


def test_content_that_is_no_object_is_refused():
    with pytest.raises(InputError, match=r"^x: found 'list', wanted a JSON object$"):
        model_from_dict([], "x")


def test_unreadable_files_are_refused(tmp_path):
    with pytest.raises(InputError, match=r"absent\.json: no such file$"):
        read_json(tmp_path / "absent.json")
    with pytest.raises(InputError, match=re.escape(f"{tmp_path}: is a folder, a JSON file was wanted")):
        read_json(tmp_path)
    (tmp_path / "big.json").write_text("1" * 5000)
    with pytest.raises(InputError, match=r"big\.json: holds a number of more digits than can be read"):
        read_json(tmp_path / "big.json")
    broken = tmp_path / "broken.json"
    broken.write_text('{"a": 1,\n "b" 2}', encoding="utf-8")
    with pytest.raises(
        InputError, match=r"broken\.json, line 2, column 6: not valid JSON: Expecting ':' delimiter"
    ):
        read_json(broken)
    broken.write_bytes(b'"\xff"')
    with pytest.raises(InputError, match=r"broken\.json: not UTF-8 text"):
        read_json(broken)


def test_writing_leaves_either_the_old_file_or_the_new(tmp_path, monkeypatch):
    path = tmp_path / "file.txt"
    write_text(path, "old\n")
    assert path.read_bytes() == b"old\n"
    assert stat.S_IMODE(path.stat().st_mode) & 0o600 == 0o600

    def interrupted(self, target):
        raise KeyboardInterrupt

    monkeypatch.setattr("pathlib.Path.replace", interrupted)
    with pytest.raises(KeyboardInterrupt):
        write_bytes(path, b"new\n")
    assert path.read_bytes() == b"old\n"
    assert [p.name for p in tmp_path.iterdir()] == ["file.txt"]


def test_the_calibrated_truth_reads(shared):
    truth = read_model(shared / "data" / "calibrated_truth.json")
    assert truth.n_states == 4
    assert truth.emission[1, :, 1].tolist() == [0.068, 0.687, 0.94, 0.996]
    assert truth.transition[1, 0].tolist() == [0.549, 0.301, 0.117, 0.033]


def test_a_shorthand_that_contradicts_the_table_is_refused():
    content = model_to_dict(model())
    model_from_dict(content)
    content["help_probability"]["signal"][2] = 0.123
    with pytest.raises(
        InputError, match=r"^m\.json, help_probability, action signal, state s2: found 0\.123, wanted"
    ):
        model_from_dict(content, "m.json")
