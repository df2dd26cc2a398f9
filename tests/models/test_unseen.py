"""Actions without evidence: counted in the log, left out of the draws, nothing else changed."""

from dataclasses import replace

import numpy as np
import pytest

from models.errors import InputError
from models.events import EventLog
from models.identification import identification
from models.planning.baselines import never
from models.planning.latent import LatentBatch
from models.protocol import PUBLISHED
from models.reward import Reward, default_x
from models.robust.controller_values import value_matrix
from models.robust.named_controllers import policy_controller
from models.unseen import EVIDENCE, evidence_of_actions, recorded_evidence, unseen_actions, without_actions
from tests.models.robust.endless_cases import solved


def log_of(*runs):
    """Runs of (action, response); a response of None was not recorded or cannot be."""
    action, response = zip(*(event for run in runs for event in run), strict=True)
    offsets = np.cumsum([0, *map(len, runs)])
    names = PUBLISHED.response_names
    return EventLog(
        PUBLISHED, "made", offsets, np.arange(len(runs)), np.zeros(len(runs), dtype=np.int64),
        np.zeros(len(runs), dtype=np.int32), ("all",),
        np.array([PUBLISHED.action(a) for a in action], dtype=np.int8),
        np.array([-1 if r is None else names.index(r) for r in response], dtype=np.int8), {},
    )  # fmt: skip


def test_only_what_is_followed_is_evidence():
    log = log_of(
        [("no_signal", "help"), ("no_help", None), ("no_signal", "no_help"), ("help", None)],
        [("no_help", None), ("signal", None), ("no_signal", "help")],
    )
    found = evidence_of_actions(log)
    # help only ends a run; signal is followed, but no response to it was recorded.
    assert found == {"no_help": 2, "help": 0, "no_signal": 2, "signal": 0}
    assert unseen_actions(found, PUBLISHED) == ("help", "signal")
    assert evidence_of_actions(log, ["help"])["help"] == 1
    assert unseen_actions({"help": 1}, PUBLISHED) == ("no_help", "no_signal", "signal")


def test_as_the_report_of_a_fit_sees_it():
    from models.baum_welch import BaumWelch

    log = log_of(*[[("no_signal", "help"), ("no_help", None), ("no_signal", "no_help"), ("help", None)]] * 5)
    fit = BaumWelch(2, restarts=2, finalists=1).fit(log)
    silent = identification(fit, log)
    expected = {*silent.silent_transitions, *silent.silent_emissions}
    assert set(unseen_actions(evidence_of_actions(log), PUBLISHED)) == expected == {"help", "signal"}


def test_what_a_fit_recorded():
    assert recorded_evidence({}, PUBLISHED) is None
    assert recorded_evidence({EVIDENCE: {"help": 3}}, PUBLISHED) == {"help": 3}
    for wrong in ({"dance": 3}, {"help": -1}, {"help": "x"}, 7):
        with pytest.raises(InputError, match=r"settings, evidence_of_actions: found .*, wanted a count"):
            recorded_evidence({EVIDENCE: wrong}, PUBLISHED)


def test_a_robot_without_an_action():
    draws = solved().batch.draws
    own = Reward(default_x(3), costs={"signal": 3.0, "help": 4.0})
    smaller = without_actions(draws, ["signal"])
    assert smaller.protocol.action_names == ("no_help", "help", "no_signal")
    assert "without signal" in smaller.protocol.name
    np.testing.assert_array_equal(smaller.transition, draws.transition[:, :3])
    np.testing.assert_array_equal(smaller.emission, draws.emission[:, :1])
    assert without_actions(draws, []) is draws
    costed = without_actions(replace(draws, reward=own), ["signal"])
    assert costed.reward.costs == {"help": 4.0}


def test_policies_that_never_used_it_are_worth_the_same():
    batch = solved().batch
    smaller = LatentBatch(without_actions(batch.draws, ["signal", "help"]), batch.process, batch.discount)
    full = value_matrix(batch, [policy_controller(batch, never(PUBLISHED))]).values
    less = value_matrix(smaller, [policy_controller(smaller, never(smaller.draws.protocol))]).values
    np.testing.assert_allclose(full, less, rtol=1e-12)


def test_null_actions_stay():
    with pytest.raises(InputError, match="no_help, the null action of human_needs_help"):
        without_actions(solved().batch.draws, ["no_help"])
    with pytest.raises(InputError, match="action: found 'dance'"):
        without_actions(solved().batch.draws, ["dance"])
