import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from analysis import cli, cli_data
from analysis.cli import main
from analysis.event_files import read_events
from tests.analysis.command import run_captured as run
from tests.analysis.event_text import ROWS, text
from tests.analysis.test_event_import import EXAMPLE, RAW

BUNDLED = Path(__file__).parents[2] / "data" / "simulated" / "simulated_study1.csv.gz"


COMMANDS = (
    (), ("data",), ("data", "list"), ("data", "card"), ("data", "check"), ("data", "import"), ("simulate",),
    ("simulate", "study1"),
)  # fmt: skip


@pytest.mark.parametrize("command", COMMANDS)
def test_every_help_carries_an_example(capsys, command):
    status, out, _ = run(capsys, *command, "--help")
    assert status == 0
    assert "Example: prosocial" in " ".join(out.split())


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_takes_the_shared_options(capsys, command):
    _, out, _ = run(capsys, *command, "--help")
    if "[ARGS]" not in out:
        for option in ("--json", "--seed", "--quiet"):
            assert option in out


def test_list(capsys):
    status, out, _ = run(capsys, "data", "list", "--json", "-")
    content = json.loads(out)
    assert status == 0
    assert [d["name"] for d in content["datasets"]] == ["simulated_study1", "frd2012"]
    for entry in content["datasets"]:
        assert entry.keys() >= {"rows", "participants", "sequences", "problems"}
    assert content["rows"] == 2_700 + 24_716


def test_card(capsys, tmp_path):
    status, out, _ = run(capsys, "data", "card", "frd2012", "--json", tmp_path / "card.json")
    content = json.loads((tmp_path / "card.json").read_text())
    assert (status, content["participants"], content["problems"]) == (0, 384, [])
    assert "not randomised" in out
    status, _, err = run(capsys, "data", "card", "frd")
    assert (status, err) == (2, "prosocial: data set: found 'frd', wanted one of simulated_study1, frd2012\n")


@pytest.mark.parametrize("what", ["simulated_study1", str(BUNDLED)])
def test_check_of_good_data(capsys, what):
    status, out, err = run(capsys, "data", "check", what, "--json", "-")
    content = json.loads(out)
    assert status == 0
    assert (content["rows"], content["participants"], content["sequences"]) == (2_700, 540, 540)
    assert content["problems"] == []
    assert "no problems" in err


def test_check_of_bad_data_prints_every_problem_and_writes_them(capsys, tmp_path):
    path = tmp_path / "bad.csv"
    path.write_text(text(*(row.replace("pilot,", "pilot,x") for row in ROWS)))
    status, out, err = run(capsys, "data", "check", path, "--json", "-")
    content = json.loads(out)
    assert status == 2
    assert [p["line"] for p in content["problems"]] == [2, 3, 4, 5, 6]
    assert content["problems"][0]["message"] == "line 2, column participant: found 'x1', wanted an integer"
    assert err.startswith(f"prosocial: {path}: 5 problems\n  line 2, column participant: found 'x1'")
    assert "line 6" in err


def test_check_of_a_missing_file_still_writes_json(capsys, tmp_path):
    status, _, err = run(capsys, "data", "check", tmp_path / "no.csv", "--json", tmp_path / "out.json")
    content = json.loads((tmp_path / "out.json").read_text())
    assert (status, content["rows"]) == (2, None)
    assert content["problems"][0]["message"] == f"{tmp_path / 'no.csv'}: no such file"
    assert err == f"prosocial: {tmp_path / 'no.csv'}: no such file\n"


def test_check_never_overwrites_what_it_reads(capsys, tmp_path):
    path = tmp_path / "log.csv"
    path.write_text(text())
    status, _, err = run(capsys, "data", "check", path, "--json", path)
    assert (status, err) == (2, f"prosocial: --json: found '{path}', wanted another file than DATA\n")
    assert path.read_text() == text()


def test_check_under_another_protocol(capsys, tmp_path):
    from models.protocol import PUBLISHED

    toml = tmp_path / "p.toml"
    toml.write_text(PUBLISHED.to_toml().replace("robot_needs_help", "robot_stuck"))
    status, _, err = run(capsys, "data", "check", "simulated_study1", "--protocol", toml)
    assert status == 2
    assert "1,620 problems of 1 kind" in err
    assert "column mode: 1,620 lines, found 'robot_needs_help', wanted one of human_needs_help, robot_stuck" in err


def test_import(capsys, tmp_path):
    (tmp_path / "raw.csv").write_text(RAW)
    arguments = ("data", "import", tmp_path / "raw.csv", "--map", EXAMPLE, "--out", tmp_path / "log.csv.gz")
    status, out, err = run(capsys, *arguments, "--json", "-", "--quiet")
    content = json.loads(out)
    assert (status, err) == (0, "")
    assert (content["rows"], content["participants"], content["sequences"]) == (5, 2, 2)
    assert content["problems"] == []
    assert read_events(tmp_path / "log.csv.gz").log.n_events == 5
    assert sorted(p.name for p in tmp_path.iterdir()) == ["log.csv.gz", "raw.csv"]
    assert run(capsys, *arguments, "--key", tmp_path / "key.csv")[0] == 0
    assert (tmp_path / "key.csv").read_text().endswith("2,09bc\n")


def test_import_never_overwrites_what_it_reads(capsys, tmp_path):
    raw = tmp_path / "raw.csv"
    raw.write_text(RAW)
    status, _, err = run(capsys, "data", "import", raw, "--map", EXAMPLE, "--out", raw)
    assert (status, err) == (2, f"prosocial: --out: found '{raw}', wanted another file than FILE\n")
    assert raw.read_text() == RAW


def test_simulate_study1(capsys, tmp_path):
    out_path = tmp_path / "study.csv.gz"
    status, out, _ = run(capsys, "simulate", "study1", "--out", out_path, "--json", "-", "--quiet")
    assert status == 0
    content = json.loads(out)
    assert (content["participants"], content["events"], content["seed"]) == (540, 2_700, 1)
    assert read_events(out_path).log.n_participants == 540
    run(capsys, "simulate", "study1", "--out", tmp_path / "b.parquet", "--participants", "7", "--seed", "2")
    assert read_events(tmp_path / "b.parquet").log.n_events == 35


def test_simulate_study1_in_the_game(capsys, tmp_path):
    """The file is the game's log, its responses those of the direct simulation."""
    from analysis.game_study import play_study1

    options = ("--participants", "20", "--seed", "2", "--json", "-", "--quiet")
    status, out, _ = run(capsys, "simulate", "study1", "--game", "--out", tmp_path / "game.csv.gz", *options)
    assert status == 0
    log, expected = read_events(tmp_path / "game.csv.gz").log, play_study1(participants=20, seed=2).log
    assert log.study == "simulated_study1_in_game"
    assert set(log.tokens) == {"team_tokens", "human_tokens", "robot_tokens"}
    for name, values in expected.tokens.items():
        assert (log.tokens[name] == values).all()
    content = json.loads(out)
    assert content["game"] is True
    assert content["mean_tokens"]["team_tokens"] == pytest.approx(expected.tokens["team_tokens"].mean())
    _, out, _ = run(capsys, "simulate", "study1", "--out", tmp_path / "direct.csv.gz", *options)
    direct = read_events(tmp_path / "direct.csv.gz").log
    assert (direct.response == log.response).all()
    content = json.loads(out)
    assert (content["game"], content["mean_tokens"]) == (False, {})


def test_simulate_with_another_truth(capsys, tmp_path):
    from analysis.simulate import CALIBRATED_TRUTH

    truth = json.loads(CALIBRATED_TRUTH.read_text())
    truth["help_probability"] = {"no_signal": [0.0] * 4, "signal": [0.0] * 4}
    (tmp_path / "truth.json").write_text(json.dumps(truth))
    run(capsys, "simulate", "study1", "--out", tmp_path / "a.csv", "--truth", tmp_path / "truth.json")
    log = read_events(tmp_path / "a.csv").log
    assert set(log.response.tolist()) == {-1, 0}


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("data", "check"), "Missing argument 'DATA'"),
        (("data", "chekc"), "No such command 'chekc'"),
        (("data", "list", "--nope"), "No such option: --nope"),
        (("data", "list", "--seed", "x"), "Invalid value for '--seed'"),
        (("data", "list", "--seed", "-1"), "Invalid value for '--seed'"),
        (("simulate", "study1"), "Missing option '--out'"),
        (("simulate", "study1", "--out", "a.csv", "--participants", "0"), "Invalid value for '--participants'"),
        (("simulate", "study1", "--out", "a.txt"), "output file: found 'a.txt', wanted a name that ends in"),
        (("simulate", "study1", "--out", "/"), "--out /: found a folder, wanted the name of a file"),
        (("simulate", "study1", "--out", "/dev/null/a.csv"), "wanted a folder to write into"),
        (("simulate", "study1", "--out", "a.csv", "--truth", "no.json"), "no.json: no such file"),
        (("simulate", "study1", "--out", ""), "--out: found '', wanted the name of a file"),
        (("simulate", "study1", "--out", "/proc/no/a.csv"), "/proc, where no file can be made"),
        (("data", "list", "--json", "/dev/null"), "--json /dev/null: found a device or pipe, wanted the name of"),
        (("data", "list", "--json", "/"), "--json /: found a folder, wanted the name of a file"),
        (("data", "check", "x", "--protocol", "no.toml"), "no.toml: no such protocol file"),
        (("data", "import", "x", "--map", "no.toml", "--out", "a.csv"), "no.toml: no such map file"),
    ],
)
def test_unusable_arguments_exit_with_2(capsys, tmp_path, monkeypatch, arguments, message):
    monkeypatch.chdir(tmp_path)
    status, out, err = run(capsys, *arguments)
    assert (status, out) == (2, "")
    assert message in err
    assert "Traceback" not in err
    assert list(tmp_path.iterdir()) == []


def test_other_failures_are_not_hidden(monkeypatch):
    monkeypatch.setattr(cli_data, "Report", lambda *_: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        main(["data", "list"])


def test_ctrl_c_exits_with_130(capsys, monkeypatch):
    def interrupted(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(cli_data, "Report", interrupted)
    assert run(capsys, "data", "list")[0] == 130


def test_ctrl_c_while_starting_up_exits_with_130(capsys, monkeypatch):
    monkeypatch.setattr(cli, "command_line", lambda: (_ for _ in ()).throw(KeyboardInterrupt))
    assert run(capsys, "data", "list") == (130, "", "prosocial: interrupted\n")


def test_nothing_but_the_standard_library_is_loaded_before_a_ctrl_c_is_met():
    code = "import sys, analysis.cli\nprint([m for m in ('typer', 'click', 'analysis.cli_em') if m in sys.modules])"
    root = cli.__file__.rsplit("/", 2)[0]
    ran = subprocess.run([sys.executable, "-c", code], cwd=root, capture_output=True, check=True, text=True)
    assert ran.stdout.strip() == "[]"


def test_a_line_of_another_width_has_no_column(capsys, tmp_path):
    path = tmp_path / "bad.csv"
    path.write_text(text(ROWS[0], ROWS[1] + ",oh"))
    status, out, err = run(capsys, "data", "check", path, "--json", "-")
    (problem,) = json.loads(out)["problems"]
    assert (status, problem["line"], problem["column"]) == (2, 3, None)
    assert "line 3: found 9 fields, wanted 8, as many as the header has" in err


def test_interrupting_leaves_no_half_written_file(tmp_path):
    code = (
        "import analysis.event_files as e, analysis.cli as c, time\n"
        "slow = e.csv_bytes\n"
        "def csv_bytes(log):\n print('writing', flush=True); time.sleep(30); return slow(log)\n"
        "e.csv_bytes = csv_bytes\n"
        f"c.main(['simulate', 'study1', '--out', {str(tmp_path / 'a.csv')!r}])\n"
    )
    with subprocess.Popen(
        [sys.executable, "-c", code], cwd=cli.__file__.rsplit("/", 2)[0], stdout=subprocess.PIPE,
        stderr=subprocess.PIPE, text=True,
    ) as process:  # fmt: skip
        assert process.stdout.readline() == "writing\n"
        time.sleep(0.05)
        os.kill(process.pid, signal.SIGINT)
        _, err = process.communicate(timeout=20)
    assert process.returncode == 130
    assert "Traceback" not in err
    assert list(tmp_path.iterdir()) == []


def test_help_waits_for_nothing_heavy():
    code = (
        "import sys, analysis.cli\nanalysis.cli.command_line()\n"
        "print([m for m in ('numpy', 'pandas', 'numba', 'pyarrow', 'scipy') if m in sys.modules])"
    )
    root = cli.__file__.rsplit("/", 2)[0]
    ran = subprocess.run([sys.executable, "-c", code], cwd=root, capture_output=True, check=True, text=True)
    assert ran.stdout.strip() == "[]"


def test_plain_json_is_strict():
    import numpy as np

    from analysis.cli_options import plain

    value = {"a": np.float64("nan"), "b": np.arange(2), "c": (np.int64(3), Path("x")), "d": float("inf")}
    assert json.dumps(plain(value), allow_nan=False) == '{"a": null, "b": [0, 1], "c": [3, "x"], "d": null}'
