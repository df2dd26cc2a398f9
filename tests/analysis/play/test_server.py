"""The web server: protocol, foreign pages, bad messages, two players, coming back."""

import time
from itertools import pairwise

import pytest
from starlette.testclient import TestClient
from starlette.websockets import WebSocketDisconnect

from analysis.event_files import read_events
from analysis.play.messages import BURST
from analysis.play.server import application

NAME = "127.0.0.1:8000"
OWN = {"host": NAME, "origin": f"http://{NAME}"}


@pytest.fixture
def study(opened, settings):
    return opened(settings)


@pytest.fixture
def client(study):
    with TestClient(application(study), base_url=f"http://{NAME}") as own:
        yield own


@pytest.fixture
def visit(client):
    """Opens pages, and leaves them at the end: the test client waits for those that are open."""
    pages = []

    def make(token=None, of=client):
        pages.append(Page(of, token))
        return pages[-1]

    yield make
    for page in pages:
        page.leave()


class Page:
    """A page that talks as ours does."""

    def __init__(self, client, token=None):
        self.left = False
        self.socket = client.websocket_connect("/play", headers=OWN)
        self.talk = self.socket.__enter__()
        self.say("hello", token=token)
        self.welcome = self.hear("welcome")
        self.token = token

    def say(self, kind, **fields):
        self.talk.send_json({"type": kind, **fields})

    def hear(self, kind):
        """The next message of a kind; ticks in between are passed over."""
        while (message := self.talk.receive_json())["type"] != kind:
            assert message["type"] == "tick", message
        return message

    def agree(self):
        self.say("consent")
        session = self.hear("session")
        self.token = session["token"]
        return session

    def play(self):
        self.say("start")
        self.hear("round")
        return self.hear("over")

    def closed(self):
        try:
            while True:
                self.talk.receive_json()
        except WebSocketDisconnect as end:
            return end.code

    def leave(self):
        if not self.left:
            self.left = True
            self.socket.__exit__(None, None, None)


# -- the page's files ------------------------------------------------------------------------------
def test_pages_come_with_their_policy(client):
    for path in ("/", "/main.js", "/style.css", "/icon.svg", "/nowhere"):
        answer = client.get(path)
        assert answer.status_code == (404 if path == "/nowhere" else 200)
        policy = answer.headers["content-security-policy"]
        assert "default-src 'none'" in policy
        assert "unsafe" not in policy
        assert "*" not in policy
        assert answer.headers["x-content-type-options"] == "nosniff"
    assert client.get("/../settings.py").status_code == 404
    assert client.get("/%2e%2e/settings.py").status_code == 404
    assert client.post("/").status_code == 405


def test_pages_load_nothing_from_elsewhere(client):
    for path in ("/", "/main.js", "/board.js", "/keys.js", "/motion.js", "/words.js", "/style.css"):
        text = client.get(path).text.replace("http://www.w3.org/2000/svg", "")
        assert "http:" not in text
        assert "https://" not in text
    page = client.get("/").text
    assert "style=" not in page
    assert "onclick" not in page


@pytest.mark.parametrize("host", ["evil.example", "127.0.0.1.evil.example:8000", "", "localhost.evil.example"])
def test_requests_under_foreign_names_are_refused(client, host):
    assert client.get("/", headers={"host": host}).status_code == 421
    with (
        pytest.raises(WebSocketDisconnect),
        client.websocket_connect("/play", headers={"host": host, "origin": f"http://{host}"}),
    ):
        pass


@pytest.mark.parametrize("host", ["localhost:8000", "127.0.0.1:8000", "[::1]:8000", "192.168.1.7:8000"])
def test_own_names_are_answered(client, host):
    assert client.get("/", headers={"host": host}).status_code == 200
    with client.websocket_connect("/play", headers={"host": host, "origin": f"http://{host}"}) as talk:
        talk.send_json({"type": "hello", "token": None})
        assert talk.receive_json()["type"] == "welcome"


@pytest.mark.parametrize(
    "headers",
    [{}, {"origin": "http://evil.example"}, {"origin": "null"}, {"origin": "http://127.0.0.1:9"},
     {"origin": f"https://{NAME}"}],
)  # fmt: skip
def test_websockets_of_foreign_pages_are_refused(client, headers):
    with pytest.raises(WebSocketDisconnect), client.websocket_connect("/play", headers={"host": NAME, **headers}):
        pass


def test_a_public_address(opened, settings):
    app = application(opened(settings), site="https://Study.example.org/")
    with TestClient(app, base_url="http://study.example.org") as client:
        assert client.get("/").status_code == 200
        headers = {"host": "study.example.org", "origin": "https://study.example.org"}
        with client.websocket_connect("/play", headers=headers) as talk:
            talk.send_json({"type": "hello", "token": None})
            assert talk.receive_json()["type"] == "welcome"


# -- conversations ---------------------------------------------------------------------------------
def test_from_consent_to_the_end(visit, study):
    page = visit()
    assert page.welcome["rounds"] == 3
    assert page.welcome["consent"]
    assert not study.journal.path.exists(), "nothing is kept before consent"
    session = page.agree()
    assert (session["k"], session["of"], session["paused"]) == (0, 3, False)
    for k in range(3):
        over = page.play()
        assert over["k"] == k
        log = read_events(study.out).log
        assert log.n_events == k + 1, "written before the page is told"
    assert over["totals"][1] == int(log.tokens["robot_tokens"].sum())
    page.say("start")
    page.leave()
    assert read_events(study.out).log.n_events == 3
    assert visit(page.token).hear("session")["k"] == 3


def test_keys_move_the_player(visit):
    page = visit()
    page.agree()
    page.say("start")
    first = page.hear("round")["state"]
    page.say("key", move=4, pressed=True)
    seen = [page.hear("tick")["you"] for _ in range(40)]
    assert first["you"] == [1, 1]
    assert seen[-1][1] > 5
    assert all(abs(b[1] - a[1]) <= 1 for a, b in pairwise(seen))
    page.leave()


def test_two_players_do_not_disturb_each_other(visit, study):
    pages = [visit() for _ in range(2)]
    for page in pages:
        page.agree()
    for page in pages:
        page.say("start")
    for page in pages:
        page.hear("round")
    pages[0].say("key", move=4, pressed=True)
    pages[1].say("key", move=2, pressed=True)
    last = []
    for page in pages:
        last += [page.hear("tick")["you"] for _ in range(20)]
    assert last[19][0] == 1
    assert last[19][1] > 3
    assert last[39][1] == 1
    assert last[39][0] > 3
    for page in pages:
        page.hear("over")
    for _ in range(2):
        for page in pages:
            page.play()
    log = read_events(study.out).log
    assert (log.n_participants, log.n_events) == (2, 6)
    assert log.schedules().tolist() == ["HRH", "HRH"]
    for page in pages:
        page.leave()


def test_a_closed_tab_loses_nothing(visit, study, settings):
    page = visit()
    page.agree()
    page.play()
    page.say("start")
    page.hear("round")
    for _ in range(5):
        page.hear("tick")
    page.leave()
    again = visit(page.token)
    session = again.hear("session")
    assert (session["k"], session["paused"]) == (1, True)
    assert again.token == page.token
    again.say("start")
    tick = again.hear("round")["state"]["tick"]
    assert tick >= 5, "the round goes on where it was left"
    over = again.hear("over")
    assert over["k"] == 1
    assert read_events(study.out).log.n_events == 2
    again.leave()


def test_a_second_window_takes_over(visit):
    first = visit()
    first.agree()
    second = visit(first.token)
    assert second.hear("session")["k"] == 0
    assert first.closed() == 4001
    assert second.play()["k"] == 0
    second.leave()


def test_withdrawal_deletes(visit, study):
    page = visit()
    page.agree()
    page.play()
    page.say("start")
    page.hear("round")
    page.say("withdraw")
    assert page.hear("withdrawn")["words"] == "delete"
    assert study.out.read_text().count("\n") == 1
    page.leave()
    stranger = visit(page.token)
    assert stranger.hear("sorry")["anew"]
    stranger.say("start")
    assert stranger.closed() == 1008


def test_an_unknown_token_is_told_so(visit):
    page = visit("x" * 32)
    assert page.hear("sorry")["anew"]
    page.agree()
    assert page.play()["k"] == 0
    page.leave()


@pytest.mark.parametrize(
    "text",
    ["{", '{"type": "start"}', '{"type": "key", "move": 9, "pressed": true}', '{"type": "hello", "token": null}',
     '{"type": "hello", "token": "' + "x" * 500 + '"}',
     '{"type": "hello", "token": "\\ud800"}'],
)  # fmt: skip
def test_bad_messages_end_the_conversation(visit, study, text):
    page = visit()
    page.talk.send_text(text)
    assert page.closed() == 1008
    assert not study.journal.path.exists()


def test_hello_comes_first_and_text_only(client):
    for send in ("send_text", "send_bytes"):
        with client.websocket_connect("/play", headers=OWN) as talk:
            getattr(talk, send)('{"type": "consent"}' if send == "send_text" else b"\0")
            with pytest.raises(WebSocketDisconnect) as caught:
                talk.receive_json()
            assert caught.value.code == 1008


def test_too_many_messages(visit):
    page = visit()
    page.agree()
    for _ in range(2 * BURST):
        page.say("key", move=1, pressed=True)
    assert page.closed() == 1008


def test_a_flood_of_one_does_not_stop_another(visit):
    good, bad = visit(), visit()
    good.agree()
    for _ in range(2 * BURST):
        bad.say("key", move=1, pressed=True)
    bad.closed()
    assert good.play()["k"] == 0
    good.leave()


def test_the_clock_keeps_time(opened, settings):
    """150 ticks of 4 ms last 0.6 s: no drift, whatever a tick costs."""
    study = opened(settings.with_(tick_seconds=0.004))
    with TestClient(application(study), base_url=f"http://{NAME}") as client:
        page = Page(client)
        page.agree()
        page.say("start")
        page.hear("round")
        began = time.perf_counter()
        page.hear("over")
        lasted = time.perf_counter() - began
        page.leave()
    assert 0.55 < lasted < 1.5


def test_a_round_that_cannot_be_stored(visit, study, monkeypatch, capsys):
    page = visit()
    page.agree()

    def full(row):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(study.log, "append", full)
    page.say("start")
    page.hear("round")
    assert "could not be stored" in page.hear("sorry")["words"]
    assert "No space left" in capsys.readouterr().err
    monkeypatch.undo()
    page.leave()
    again = visit(page.token)
    assert again.hear("session")["paused"]
    again.say("start")
    again.hear("round")
    assert again.hear("over")["k"] == 0
    again.leave()


def test_trouble_with_files_is_told_to_both_sides(visit, study, monkeypatch, capsys):
    page = visit()

    def full(*_, **__):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(study.journal, "agree", full)
    page.say("consent")
    assert "could not be stored" in page.hear("sorry")["words"]
    assert "somebody new: [Errno 28] No space left" in capsys.readouterr().err
