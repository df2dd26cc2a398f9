"""The benchmark of the token game."""

import pytest

from analysis.bench import game


@pytest.fixture
def small(monkeypatch):
    monkeypatch.setattr(game, "ROUNDS", 2_000)
    monkeypatch.setattr(game, "REPEATS", 2)


def test_rows(small):
    said = []
    rows = {row.name: row for row in game.run(quick=True, progress=said.append)}
    assert said == ["rounds", "ticks from Python", "routes"]
    assert list(rows) == [
        "whole rounds a second, 2 threads on free processors", "a whole round", "a tick from Python, both players",
        "a route by A*, called from Python",
    ]  # fmt: skip
    assert rows["whole rounds a second, 2 threads on free processors"].met
    route = rows["a route by A*, called from Python"]
    assert route.peer_name == "networkx"
    assert route.ratio > 3
    assert "all of the same length" in route.note
    assert "NOT" not in route.note


def test_without_the_peer(small, monkeypatch):
    monkeypatch.setattr(game, "find_spec", lambda name: None)
    *_, row = game.run(quick=True)
    assert row.peer is None
    assert row.note == "networkx is not installed"
