"""The environment: PettingZoo's own tests, observations against the readable state, errors."""

import pickle
import subprocess
import sys

import numpy as np
import pytest
from pettingzoo.test import parallel_api_test, parallel_seed_test

from models.errors import InputError
from models.game.env import MODES, TokenGame
from models.game.env_views import PLANES, Views
from models.game.human import HumanPlayer
from models.game.layout import Layout, packaged
from models.game.parameters import GameParameters
from models.game.record import record, replay
from models.game.robot import RobotPlayer
from models.game.round import Round
from models.game.state import PLAYERS, READY, TICK

SHORT = GameParameters(round_ticks=60, trap_tick=10)


def sampled(env, observations=None):
    masks = {a: None if observations is None else observations[a]["action_mask"] for a in env.agents}
    return {agent: env.action_space(agent).sample(mask=masks[agent]) for agent in env.agents}


def seeded(**arguments):
    env = TokenGame(**arguments)
    for i, agent in enumerate(PLAYERS):
        env.action_space(agent).seed(i)
    return env


def played_rounds():
    """Rounds at every tick, of simulated players, all kinds."""
    parameters = GameParameters(round_ticks=900)
    for named in PLAYERS:
        for acts in (False, True):
            game, human, robot = (
                Round(None, parameters, named, acts, seed=5),
                HumanPlayer(willing=True),
                RobotPlayer(),
            )
            while not game.done:
                yield game
                game.step(human.move(game), robot.move(game))


# -- conformance -----------------------------------------------------------------------------------
WIDE = Layout.from_text("\n".join(line[:8] + line[7:] for line in packaged().lines), "wide")
"""The middle corridor two cells wide: neither square nor symmetric."""


@pytest.mark.parametrize(
    "arguments", [{}, {"layout": WIDE}, {"trapped": "human", "acts": False, "reward": "team", "ticks_a_step": 7}]
)
def test_pettingzoo_api(arguments, capsys):
    parallel_api_test(TokenGame(**arguments), num_cycles=1000)
    assert "Passed" in capsys.readouterr().out


def test_pettingzoo_seeds():
    parallel_seed_test(TokenGame, num_cycles=400)
    parallel_seed_test(lambda: TokenGame(ticks_a_step=5, reward="team"), num_cycles=400)


def test_observations_are_in_their_spaces_which_are_always_the_same():
    env = seeded(ticks_a_step=3)
    spaces = [env.observation_space(a) for a in PLAYERS]
    for _ in range(3):
        observations, _ = env.reset()
        while env.agents:
            for agent in PLAYERS:
                assert env.observation_space(agent).contains(observations[agent])
            observations, *_ = env.step(sampled(env, observations))
        assert all(env.observation_space(a).contains(observations[a]) for a in PLAYERS)
    assert all(a is env.observation_space(b) for a, b in zip(spaces, PLAYERS, strict=True))


# -- what is seen ----------------------------------------------------------------------------------
def expected_planes(view, layout, player):
    """The planes from the readable state, cell by cell."""
    me, other = PLAYERS[player], PLAYERS[1 - player]
    passes = {"red": "human", "blue": "robot"}
    shown = dict.fromkeys(PLANES, ())
    shown["walls"] = [(r, c) for r, line in enumerate(layout.lines) for c, x in enumerate(line) if x == "#"]
    shown["doors that let one pass"] = [cell for cell, colour in view.doors if passes[colour] == me]
    shown["doors that let the other pass"] = [cell for cell, colour in view.doors if passes[colour] == other]
    shown["oneself"], shown["the other"] = [getattr(view, me)], [getattr(view, other)]
    shown["own tokens"] = getattr(view, f"{me}_tokens")
    shown["tokens of the other"] = getattr(view, f"{other}_tokens")
    for plane, room in (
        ("inside of the room in which somebody is trapped", view.trapped_room),
        ("inside of the room that flashes", view.flashing_room),
    ):
        shown[plane] = layout.inside(room) if room else ()
    out = np.zeros((len(PLANES), layout.height, layout.width), dtype=np.int8)
    for plane, name in enumerate(PLANES):
        for cell in shown[name]:
            out[plane][cell] = 1
    return out


def test_planes_show_what_the_readable_state_says():
    layout = packaged()
    views = Views(layout, 900)
    flashed = caged = 0
    for game in played_rounds():
        for player in (0, 1):
            seen = views.observation(game.array, player)
            assert np.array_equal(seen["planes"], expected_planes(game.view, layout, player))
            assert seen["trapped"].tolist() == [
                game.trapped == PLAYERS[player],
                game.trapped == PLAYERS[1 - player],
            ]
            assert seen["collected"].tolist() == [game.collected[PLAYERS[p]] for p in (player, 1 - player)]
            assert seen["time_left"][0] == pytest.approx(1 - game.tick / 900)
        flashed += game.flashing_room is not None
        caged += game.trapped is not None
    assert caged > flashed > 0


def test_the_mask_says_which_moves_change_something():
    views, rng = Views(packaged(), 900), np.random.default_rng(1)
    closed = 0
    for game in played_rounds():
        if rng.random() < 0.9:
            continue
        for player in (0, 1):
            mask = views.open_moves(game.array, player)
            assert mask[0] == 1
            for move in range(1, 5):
                other = Round(None, game.parameters, game.named, game.acts, seed=5)
                other.array[:] = game.array
                other.array[READY : READY + 2] = 0  # nobody has to wait
                other.step(*((move, 0) if player == 0 else (0, move)))
                before, after = (getattr(g, PLAYERS[player]) for g in (game, other))
                assert (before != after) == mask[move]
                closed += not mask[move]
    assert closed > 100


def test_waiting_is_shown():
    env = TokenGame()
    env.reset(seed=1)
    seen, *_ = env.step({"human": 4, "robot": 0})
    assert seen["human"]["wait"].tolist() == [4, 0]
    assert seen["robot"]["wait"].tolist() == [0, 4]


def test_state_is_the_human_view_without_the_seed():
    env = TokenGame(trapped="robot", acts=True)
    one, _ = env.reset(options={"round_seed": 3})
    vector = env.state()
    assert vector.dtype == np.float32
    assert len(vector) == sum(part.size for part in one["human"].values())


# -- rewards, end, infos ---------------------------------------------------------------------------
@pytest.mark.parametrize("ticks", [1, 7])
@pytest.mark.parametrize("reward", ["own", "team"])
def test_rewards_are_tokens_and_rounds_end(reward, ticks):
    long = GameParameters(round_ticks=900)
    env = TokenGame(parameters=long, reward=reward, ticks_a_step=ticks, trapped="human")
    human, robot = HumanPlayer(), RobotPlayer()
    _, infos = env.reset(seed=2)
    total, steps = dict.fromkeys(PLAYERS, 0.0), 0
    while env.agents:
        assert infos["human"]["tick"] == steps * ticks
        _, rewards, ended, cut, infos = env.step({"human": human.move(env.round), "robot": robot.move(env.round)})
        total = {a: total[a] + rewards[a] for a in PLAYERS}
        steps += 1
        assert set(ended.values()) == {env.round.done}
        assert not any(cut.values())
    assert steps == -(-900 // ticks)
    collected = env.round.collected
    assert total == (collected if reward == "own" else dict.fromkeys(PLAYERS, sum(collected.values())))
    assert infos["human"]["tick"] == 900
    assert env.step({}) == ({}, {}, {}, {}, {})


def test_infos_say_what_an_event_log_would():
    for named, acts in (("human", True), ("robot", False), ("robot", True)):
        env, human, robot = TokenGame(trapped=named, acts=acts), HumanPlayer(willing=True), RobotPlayer()
        _, infos = env.reset()
        assert infos["human"] == infos["robot"]
        assert (infos["human"]["mode"], infos["human"]["acts"]) == (MODES[named], acts)
        assert not infos["human"]["sprung"]
        while env.agents:
            *_, infos = env.step({"human": human.move(env.round), "robot": robot.move(env.round)})
        assert infos["robot"]["sprung"]
        assert infos["robot"]["helped"]
        assert infos["robot"]["response"] == ("help" if named == "robot" else "none")


def test_a_round_of_the_environment_has_a_record():
    env = seeded(parameters=SHORT)
    observations, _ = env.reset(seed=4)
    while env.agents:
        observations, *_ = env.step(sampled(env, observations))
    *_, last = replay(record(env.round))
    assert last == env.round.view


def test_copies_and_pickles_go_on_by_themselves():
    env = seeded(parameters=SHORT, render_mode="rgb_array")
    env.reset(seed=4)
    env.render()
    other = pickle.loads(pickle.dumps(env))
    for _ in range(20):
        env.step(sampled(env))
    assert (env.round.tick, other.round.tick) == (20, 0)
    assert rounds_of(other, 3) == rounds_of(env, 3)


# -- seeds and options -----------------------------------------------------------------------------
def rounds_of(env, n, **first):
    """Seeds, modes and acts of some rounds; the first with arguments of its own."""
    infos = [env.reset(**(first if i == 0 else {}))[1]["human"] for i in range(n)]
    return [(info["round_seed"], info["mode"], info["acts"]) for info in infos]


def test_seeds_decide_all_rounds_and_the_default_is_one():
    wanted = rounds_of(TokenGame(), 6, seed=1)
    assert rounds_of(TokenGame(), 6) == wanted
    assert rounds_of(TokenGame(seed=3), 6, seed=1) == wanted
    assert rounds_of(TokenGame(), 6, seed=2) != wanted
    assert len({mode for _, mode, _ in wanted}) == len({acts for *_, acts in wanted}) == 2
    assert len({seed for seed, *_ in wanted}) == 6


def test_options_decide_one_round_and_leave_the_later_ones_alone():
    plain = rounds_of(TokenGame(), 4, seed=1)
    chosen = rounds_of(TokenGame(), 4, seed=1, options={"trapped": "robot", "acts": False, "round_seed": 9})
    assert chosen == [(9, "robot_needs_help", False), *plain[1:]]
    assert rounds_of(TokenGame(trapped="human", acts=True), 1, options={"trapped": "robot", "acts": False})[0][
        1:
    ] == (
        "robot_needs_help",
        False,
    )


# -- pictures --------------------------------------------------------------------------------------
def test_render_modes():
    env = TokenGame(render_mode="rgb_array", ticks_a_step=2)
    assert env.metadata["render_fps"] == 5
    assert TokenGame.metadata["render_fps"] == 10
    env.reset()
    first = env.render()
    assert (first.dtype, first.ndim, first.shape[2]) == (np.uint8, 3, 3)
    env.step({"human": 4, "robot": 3})
    assert not np.array_equal(first, env.render())
    text = TokenGame(parameters=SHORT, render_mode="ansi")
    text.reset()
    assert text.render().splitlines()[0] == "0:06  human 0  robot 0"
    wide = TokenGame(WIDE, render_mode="rgb_array")
    wide.reset()
    assert wide.render().shape[1] == first.shape[1] * 16 // 15
    plain = TokenGame()
    plain.reset()
    assert plain.render() is None
    plain.close()


# -- what is refused -------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("arguments", "wanted"),
    [
        ({"trapped": "nobody"}, "argument trapped: found 'nobody', wanted one of human, robot"),
        ({"acts": "yes"}, "argument acts: found 'yes', wanted true or false"),
        ({"reward": "mine"}, "reward: found 'mine', wanted one of own, team"),
        ({"ticks_a_step": 0}, "ticks_a_step: found 0, wanted a whole number, at least 1"),
        ({"render_mode": "human"}, "render_mode: found 'human', wanted one of rgb_array, ansi, or None"),
        ({"seed": -1}, "seed: found -1, wanted a whole number, at least 0"),
    ],
)
def test_unusable_arguments(arguments, wanted):
    with pytest.raises(InputError, match=f"^token game, {wanted}$"):
        TokenGame(**arguments)


def test_unusable_options_actions_and_order():
    env = TokenGame()
    with pytest.raises(InputError, match=r"token game, step: found no round, wanted reset\(\) first"):
        env.step({})
    with pytest.raises(InputError, match="token game, option: found 'trap', wanted one of trapped"):
        env.reset(options={"trap": "human"})
    with pytest.raises(InputError, match="option trapped: found 3"):
        env.reset(options={"trapped": 3})
    with pytest.raises(InputError, match="round, seed: found -2"):
        env.reset(options={"round_seed": -2})
    env.reset()
    with pytest.raises(InputError, match="actions: found none of the robot, wanted one of each player"):
        env.step({"human": 0})
    with pytest.raises(InputError, match="actions: found 'dog', wanted only human and robot"):
        env.step({"human": 0, "robot": 0, "dog": 1})
    with pytest.raises(InputError, match="move of the human: found 5"):
        env.step({"human": 5, "robot": 0})
    assert env.round.array[TICK] == 0


@pytest.mark.parametrize("missing", ["pettingzoo", "gymnasium"])
def test_without_the_optional_packages(missing):
    code = (
        f"import sys; sys.modules[{missing!r}] = None\nimport models.game.round\n"
        "try:\n    import models.game.env\nexcept ValueError as error:\n    print(error)\n"
    )
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert ran.stdout == (
        f"models.game.env: found no package {missing}, wanted the optional packages of the extra 'game'\n"
    )
