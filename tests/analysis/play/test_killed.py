"""A real server that is killed, and one that is ended: what stands in the files."""

import contextlib
import json
import os
import signal
import time

import pytest

from analysis.cli import main
from analysis.event_files import read_events
from models.game.record import read_records, replay
from tests.analysis.play.cases import Server

websockets = pytest.importorskip("websockets.sync.client", reason="the optional extra game is not installed")

SHORT = {"round_ticks": 4, "trap_tick": 1}


class Player:
    """A page on a real connection."""

    def __init__(self, server, token=None):
        self.kept = contextlib.ExitStack()
        talk = websockets.connect(f"ws://{server.host}/play", origin=server.address)
        self.socket = self.kept.enter_context(talk)
        self.say("hello", token=token)
        self.welcome = self.hear("welcome")

    def say(self, kind, **fields):
        self.socket.send(json.dumps({"type": kind, **fields}))

    def hear(self, kind):
        while (message := json.loads(self.socket.recv(timeout=20)))["type"] != kind:
            pass
        return message


# A server takes seconds to start, so everything that needs a real one is in one story.
def test_killed_restarted_ended(tmp_path):
    log = tmp_path / "log.csv"
    options = ("--schedule", "HR", "--policy", "always", "--countdown", "0.2")
    with Server(tmp_path, *options, parameters=SHORT) as server:
        first, second = Player(server), Player(server)
        for player in (first, second):
            player.say("consent")
            player.token = player.hear("session")["token"]
            player.say("start")
        for player in (first, second):
            player.hear("over")
        second.say("start")
        second.hear("round")
        server.kill()
        for player in (first, second):
            player.kept.close()
    assert read_events(log).log.n_events == 2, "finished rounds are on the disk"
    for participant in (1, 2):
        (kept,) = read_records(tmp_path / "log_rounds" / f"participant-{participant}" / "round-0.jsonl")
        assert list(replay(kept))[-1].done

    told = tmp_path / "told.json"
    with Server(tmp_path, *options, "--json", str(told), parameters=SHORT) as server:
        assert "2 rounds of 2 people so far" in server.said
        again = Player(server, second.token)
        session = again.hear("session")
        assert (session["k"], session["of"], session["paused"]) == (1, 2, False)
        again.say("start")
        assert again.hear("over")["k"] == 1
        # Twice, as impatient people do.
        server.process.send_signal(signal.SIGINT)
        time.sleep(0.05)
        server.process.send_signal(signal.SIGINT)
        rest, _ = server.process.communicate(timeout=30)
        assert server.process.returncode == 0, rest
    again.kept.close()
    assert "1 round played" in rest
    assert "nobody got trapped in 3 rounds; the log says" in rest, "four ticks are too few for it"
    assert "Traceback" not in rest
    found = json.loads(told.read_text())
    assert (found["rounds"], found["people"], found["finished"]) == (3, 2, 1)
    assert found["policies"] == ["always"]
    assert found["seed"] == 1
    assert (found["played"], found["untrapped"], found["too_late"]) == (1, 3, 0)
    lines = log.read_text().splitlines()
    assert lines[0].startswith("study,participant,condition,sequence,k,mode,action,observation,team_tokens")
    assert lines[3].startswith("token_game,2,always,0,1,human_needs_help,no_help,none,")
    assert read_events(log).log.n_events == 3
    with pytest.raises(SystemExit) as checked:
        main(["data", "check", str(log), "--quiet"])
    assert not checked.value.code
    assert not [name for name in os.listdir(tmp_path) if name.startswith(".")]
