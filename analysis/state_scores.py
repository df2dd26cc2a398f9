"""What a round is worth by hidden state, measured: mean tokens of the team, weighted by the smoothed states.

The paper scores its states this way (x = 45, 48, 56, 67 tokens a round). For a study with a measure of its own the
result goes into `models.reward.Reward.of_values`.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from models.errors import located
from models.events import EventLog
from models.inference import smoothed
from models.lspomdp import LatentStatePOMDP


def state_scores(model: LatentStatePOMDP, log: EventLog) -> NDArray[np.float64]:
    r"""Mean team tokens a round by state, rounds weighted by the smoothed state probabilities.

    .. math:: x_s = \sum_k p(s_k = s \mid \text{run}) \, y_k \Big/ \sum_k p(s_k = s \mid \text{run})

    over all events, with the tokens :math:`y_k` of event k.

    Parameters
    ----------
    model : LatentStatePOMDP
    log : EventLog
        With the column ``team_tokens``, whatever its unit.

    Returns
    -------
    float64[s]
        In the unit of the column.

    Raises
    ------
    InputError
        If the log has no token column, or not for every event.
    """
    if "team_tokens" not in log.tokens or np.isnan(log.tokens["team_tokens"]).any():
        raise located(f"study {log.study!r}, team_tokens", sorted(log.tokens), "the team's tokens at every event")
    weight = smoothed(model, log)
    return (weight * log.tokens["team_tokens"][:, None]).sum(axis=0) / weight.sum(axis=0)
