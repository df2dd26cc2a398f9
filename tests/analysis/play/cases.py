"""A real server in a process of its own, and people who play by a rule."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[3]

# The command by itself, so that nothing depends on the other commands.
COMMAND = """
import typer
from analysis.cli_play import play_command
app = typer.Typer(pretty_exceptions_enable=False)
app.command("play")(play_command)
app()
"""


class Server:
    """``prosocial play`` with some options; `address` is where its page is."""

    def __init__(self, folder, *options, parameters=None):
        given = []
        if parameters is not None:
            (folder / "parameters.json").write_text(json.dumps(parameters))
            given = ["--parameters", str(folder / "parameters.json")]
        self.process = subprocess.Popen(
            [sys.executable, "-c", COMMAND, "--port", "0", "--out", str(folder / "log.csv"), *given, *options],
            cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
            env={**os.environ, "PYTHONUNBUFFERED": "1"},
        )  # fmt: skip
        self.said = ""
        for line in self.process.stdout:
            self.said += line
            found = re.search(r"play at (http://([\d.]+:\d+))/", line)
            if found:
                self.address, self.host = found[1], found[2]
                return
        raise AssertionError(f"the server did not start:\n{self.said}")

    def kill(self):
        """As kill -9."""
        self.process.kill()
        self.process.communicate(timeout=30)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        if self.process.poll() is None:
            self.kill()


def play_to_the_end(live, willing):
    """Play a live round with a simulated person."""
    from models.game.human import HumanPlayer

    person = HumanPlayer(willing)
    while not live.done:
        live.key(person.move(live.game), True)
        live.tick()
    return live
