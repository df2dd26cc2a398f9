"""A round in play: keys, what the log says of it, what the page is told."""

import json

import numpy as np
import pytest

from analysis.cli import main
from analysis.play.journal import TOO_LATE, UNTRAPPED
from analysis.play.live_round import LiveRound
from analysis.play.robot_mind import Decision, RobotMind, policy_by_name
from analysis.simulate import calibrated_truth
from models.game.round import Round
from models.planning.baselines import always
from models.protocol import PUBLISHED
from tests.analysis.play.cases import play_to_the_end
from tests.analysis.play.conftest import SHORT


def test_a_key_between_two_ticks_is_not_lost():
    game = Round(parameters=SHORT, seed=1)
    live = LiveRound(game, 0, "signal")
    live.key(4, True)
    live.key(0, False)
    live.tick()
    assert game.human == (1, 2)
    live.key(4, True)
    live.key(0, False)
    live.tick()
    assert game.human == (1, 2), "two ticks a step"
    live.tick()
    assert game.human == (1, 3), "the tap waited for the step to end"
    live.tick()
    live.tick()
    assert game.human == (1, 3), "and counted once"


def test_a_held_key_goes_on_and_a_tap_comes_first():
    game = Round(parameters=SHORT, seed=1)
    live = LiveRound(game, 0, "signal")
    live.key(4, True)
    for _ in range(5):
        live.tick()
    assert game.human == (1, 4)
    live.key(3, True)
    live.key(4, False)
    for _ in range(2):
        live.tick()
    assert game.human == (1, 3)
    live.release()
    for _ in range(4):
        live.tick()
    assert game.human == (1, 3)


def test_who_never_saw_the_robot_trapped_did_not_refuse():
    never = SHORT.from_dict({**SHORT.to_dict(), "trap_tick": SHORT.round_ticks - 1})
    live = LiveRound(Round(parameters=never, trapped="robot", seed=1), 0, "signal")
    play_to_the_end(live, True)
    assert (live.odd, live.shown, live.observation) == (UNTRAPPED, "no_signal", "missing")
    live = LiveRound(Round(parameters=never, trapped="human", seed=1), 0, "help")
    play_to_the_end(live, True)
    assert (live.odd, live.shown, live.observation) == (UNTRAPPED, "no_help", "none")
    live = LiveRound(Round(parameters=never, trapped="human", acts=False, seed=1), 0, "no_help")
    play_to_the_end(live, True)
    assert (live.odd, live.shown) == (UNTRAPPED, "no_help"), "noted all the same: nothing was refused"


def ends_after(trapped, ticks_left):
    """A round that is over so many ticks after its trap, as long as nobody acts upon the trap."""
    whole = play_to_the_end(LiveRound(Round(parameters=SHORT, trapped=trapped, seed=1), 0, "signal"), False)
    last = int(whole.game.view.trapped_tick) + ticks_left
    parameters = SHORT.from_dict({**SHORT.to_dict(), "round_ticks": last})
    return LiveRound(Round(parameters=parameters, trapped=trapped, seed=1), 0, MODE_ACTIONS[trapped])


MODE_ACTIONS = {"human": "help", "robot": "signal"}


def test_a_round_that_ends_right_after_the_trap_refuses_nobody():
    live = play_to_the_end(ends_after("robot", 2), False)
    assert live.game.sprung
    assert (live.odd, live.shown, live.observation) == (TOO_LATE, "signal", "missing"), "the signal was seen"
    live = play_to_the_end(ends_after("robot", 60), False)
    assert (live.odd, live.shown, live.observation) == ("", "signal", "no_help"), "there was time"
    live = play_to_the_end(ends_after("human", 20), True)
    assert live.game.sprung
    assert (live.odd, live.shown, live.observation) == (TOO_LATE, "no_help", "none"), "help begins after 5 s"


@pytest.mark.parametrize("seed", range(8))
def test_too_late_is_said_only_of_what_nobody_could_have_done(seed):
    """A person who sets off at once, attentively, never helps in a round that counts as out of reach."""
    whole = play_to_the_end(LiveRound(Round(parameters=SHORT, trapped="robot", seed=seed), 0, "signal"), False)
    sprung = whole.game.view.trapped_tick
    quick = {**SHORT.to_dict(), "human_notice_ticks": 0, "human_lapse": 0.0}
    called, helped = [], []
    for left in range(1, 60, 3):
        parameters = SHORT.from_dict({**quick, "round_ticks": sprung + left})
        for willing, said in ((False, called), (True, helped)):
            live = LiveRound(Round(parameters=parameters, trapped="robot", seed=seed), 0, "signal")
            play_to_the_end(live, willing)
            if live.game.view.trapped_tick == sprung:
                said.append((left, live.odd == TOO_LATE if not willing else live.observation == "help"))
    out_of_reach = {left for left, flag in called if flag}
    in_time = {left for left, flag in helped if flag}
    assert not out_of_reach & in_time
    assert 1 in out_of_reach
    assert in_time
    assert min(in_time) - max(out_of_reach) < 60, "the two are not far apart"


def test_the_log_says_what_was_shown(opened, settings, tmp_path):
    """Nobody trapped, whatever the robot chose: no help, no signal, nothing learned of either, and a note."""
    never = SHORT.from_dict({**SHORT.to_dict(), "trap_tick": SHORT.round_ticks - 1})
    with_help = settings.with_(policies=(always(PUBLISHED),), parameters=never)
    study = opened(with_help)
    token, person = study.agree()
    for _ in range(2):
        assert play_to_the_end(study.begin(person), True).action in ("signal", "help")
        study.finish(person)
    said = [(r.action, r.observation) for r in study.rows(person)]
    assert said == [("no_signal", "missing"), ("no_help", "none")]
    noted = [e for e in map(json.loads, study.journal.path.read_text().splitlines()) if e["event"] == UNTRAPPED]
    assert [(e["participant"], e["k"], e["chosen"]) for e in noted] == [(1, 0, "signal"), (1, 1, "help")]
    assert study.summary["untrapped"] == 2
    study.close()
    with pytest.raises(SystemExit) as checked:
        main(["data", "check", str(study.out), "--quiet"])
    assert not checked.value.code
    again = opened(with_help)
    assert again.summary["untrapped"] == 2, "read from the file"
    again.withdraw(again.find(token))
    assert again.summary["untrapped"] == 0
    assert UNTRAPPED not in again.journal.path.read_text()


def test_a_belief_is_not_moved_by_help_that_nobody_saw(opened, settings):
    """The robot's own memory, and one made again from the log, are those after `no_help`."""
    policy, _ = policy_by_name("myopic", calibrated_truth(), "RHR")
    never = SHORT.from_dict({**SHORT.to_dict(), "trap_tick": SHORT.round_ticks - 1})
    study = opened(settings.with_(policies=(policy,), schedule="RHR", parameters=never))
    token, person = study.agree()
    helping = LiveRound(Round(parameters=never, trapped="human", acts=True, seed=1), 0, "help")
    person.live = play_to_the_end(helping, True)
    study.finish(person)
    wanted, other = (
        RobotMind(policy, study.settings.modes, [Decision(action, "none")]) for action in ("no_help", "help")
    )
    study.close()
    again = opened(study.settings).find(token)
    for mind in (person.mind, again.mind):
        assert np.array_equal(mind._memory.belief, wanted._memory.belief)
        assert not np.array_equal(mind._memory.belief, other._memory.belief)


def test_the_page_is_not_told_what_cannot_be_seen():
    live = LiveRound(Round(parameters=SHORT, trapped="robot", acts=False, seed=1), 0, "no_signal")
    while not live.done:
        live.tick()
        said = json.dumps(live.state())
        assert "trap" not in said
        assert live.state()["flash"] is None
    assert live.game.sprung
    assert not {"mode", "action", "acts", "trapped", "seed"} & set(live.start(3, 0.0, 0.1))
