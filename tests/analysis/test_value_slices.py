"""The map of a policy shows what the policy does, which is not always what its best vector starts with."""

from dataclasses import replace

import numpy as np
from matplotlib.colors import to_rgba
from matplotlib.patches import Rectangle

from analysis.figures.planning import _look, value_slices
from models.planning.problems import tiger
from models.planning.solver import solve


def test_the_strip_is_what_the_policy_does():
    """One vector, listen for ever: one step ahead it is better to open the door once one is sure."""
    solution = solve(tiger(), 1e-2)
    listening = replace(
        solution, alpha=np.full((1, 2), -20.0), mode=np.zeros(1, np.int64), choice=np.zeros(1, np.int64),
        follow=np.zeros((1, 2), np.int32),
    )  # fmt: skip
    [ax] = value_slices(listening, points=50).axes
    bars = [p for p in ax.patches if isinstance(p, Rectangle)]
    done = []
    for bar in bars:
        middle = bar.get_x() + bar.get_width() / 2
        action = listening.policy.action([1 - middle, middle], 0)
        done.append(action)
        number = [c.action for c in listening.problem.choices[0]].index(action)
        assert bar.get_facecolor() == to_rgba(_look(number)["facecolor"])
    assert done == ["open-right", "listen", "open-left"]
    assert {t.get_text() for t in ax.get_legend().get_texts()} == {"listen", "open-left", "open-right"}
