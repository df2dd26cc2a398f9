"""Studies 2 for tests: a game that takes no time, and studies with made-up outcomes."""

from types import SimpleNamespace

import numpy as np

from analysis.study2 import Study2
from analysis.study2_policies import PAPER, Learned, make_policies
from models.histories import UNSEEN
from models.planning.mode_process import schedule_modes
from models.protocol import PUBLISHED
from tests.models.planning.policy_cases import person

TOKENS = {(0, 0): 40, (0, 1): 50, (1, 0): 41, (1, 1): 51}
"""Team tokens by who was trapped and whether somebody came."""


def instant_rounds(late=0.0):
    """Rounds whose outcome follows at once from who acts and who is willing; some of the willing come too late."""

    def play(layout, parameters, trapped, acts, willing, seed, threads=None):
        trapped, chance = np.asarray(trapped), np.asarray(seed, dtype=np.uint64) % np.uint64(1000) / 1000.0
        came = np.where(trapped == 0, acts, willing & (chance >= late))
        team = np.array([TOKENS[int(t), int(c)] for t, c in zip(trapped, came, strict=True)])
        human = team // 2 + (np.asarray(seed, dtype=np.uint64) % np.uint64(3)).astype(int)
        return SimpleNamespace(helped=came.astype(bool), human_tokens=human, robot_tokens=team - team // 2)

    return play


def knowing(model=None):
    """A robot that knows the truth."""
    return Learned(model or person(), None, "the truth itself")


def policies(names=PAPER, learned=None):
    return make_policies(learned or knowing(), names)


def made_up(team, helped, believed=None, names=PAPER, letters="HRHRHRHRH", costly=None):
    """A study with given outcomes.

    Parameters
    ----------
    team : int[person, round]
        Policies take turns: person i is under policy i modulo their number.
    helped : bool[person, shown round]
    believed : float[person, round], optional
        Probability of the better of two states.
    costly : sequence of int, optional
        Costly actions a person, by policy.
    """
    n, k = team.shape
    modes = schedule_modes(PUBLISHED, letters)
    null = [PUBLISHED.action(m.null_action) for m in PUBLISHED.modes]
    policy = np.arange(n) % len(names)
    action = np.tile([null[m] for m in modes], (n, 1)).astype(np.int8)
    for p, number in enumerate(costly or [0] * len(names)):
        action[policy == p, :number] += 1
    shows = np.array([PUBLISHED.modes[m].shows_response for m in modes])
    response = np.full((n, k), UNSEEN, dtype=np.int8)
    response[:, shows] = np.where(helped, int(np.argmax(PUBLISHED.scores)), int(np.argmin(PUBLISHED.scores)))
    top = np.full((n, k), 0.5) if believed is None else believed
    belief = np.stack([1 - top, top], axis=-1)
    model = two_states()
    return Study2(
        tuple(names), letters, model, model, policy, action, response, team // 2, team - team // 2,
        np.zeros((n, k + 1), dtype=np.int64), np.zeros((n, k), dtype=bool),
        np.concatenate([np.full((n, 1, 2), 0.5), belief], axis=1), 1,
    )  # fmt: skip


def two_states():
    """Any model of two states."""
    from models.lspomdp import LatentStatePOMDP

    return LatentStatePOMDP([0.5, 0.5], [[[0.9, 0.1], [0.1, 0.9]]] * 4, [[[0.8, 0.2], [0.2, 0.8]]] * 2)


def random_study(seed, each=20, names=PAPER):
    """A study whose policies differ at random."""
    rng = np.random.default_rng(seed)
    n = each * len(names)
    level = rng.normal(size=len(names)) * 3
    growth = rng.normal(size=len(names)) * 0.4
    policy = np.arange(n) % len(names)
    team = 55 + level[policy][:, None] + growth[policy][:, None] * np.arange(9) + rng.normal(size=(n, 9)) * 4
    rate = rng.uniform(0.4, 0.97, size=len(names))
    helped = rng.random((n, 5)) < rate[policy][:, None] + np.linspace(-0.1, 0.1, 5)
    believed = np.clip(
        rng.uniform(0.2, 0.8, size=len(names))[policy][:, None] + 0.1 * rng.normal(size=(n, 9)), 0, 1
    )
    return made_up(
        team.round().astype(int), helped, believed, names, costly=rng.integers(0, 9, len(names)).tolist()
    )
