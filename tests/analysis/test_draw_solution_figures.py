"""Plots of many draws solved: they show the numbers, and write the same bytes every time."""

import numpy as np
import pytest

from analysis.figures.draw_solutions import (
    active_share,
    stability_along,
    stability_map,
    stability_walk,
    value_distribution,
)
from analysis.figures.style import to_svg
from models.errors import InputError
from models.planning.baselines import never
from models.protocol import PUBLISHED
from models.robust.belief_stability import belief_stability, edge_walk
from models.robust.candidates import posterior_mean
from models.robust.controller_pool import controller_pool
from models.robust.history_stability import history_stability
from models.robust.named_controllers import baseline_controllers
from models.robust.wider_solution import widened
from models.unseen import without_actions
from tests.models.robust.endless_cases import solved


@pytest.fixture(scope="module")
def pool():
    s = solved()
    return controller_pool(s, baseline_controllers(s.batch, posterior_mean(s.batch.draws)), size=6)


def test_map_has_a_triangle_for_every_face_and_mode():
    three = stability_map(widened(solved()), points=4)
    four = stability_map(widened(solved(6, 4)), points=3)
    five = stability_map(widened(solved(4, 5)), points=3)
    panels = [sum(ax.get_label() != "<colorbar>" for ax in f.axes) for f in (three, four, five)]
    assert panels == [2, 8, 2]
    words = {t.get_text() for ax in four.axes for t in ax.texts}
    assert {"s0 non", "s3 high"} <= words
    assert to_svg(three) == to_svg(stability_map(widened(solved()), points=4))


@pytest.mark.parametrize("draw", [stability_map, stability_walk])
def test_solutions_from_the_start_only_are_refused(draw):
    with pytest.raises(InputError, match="widened"):
        draw(solved())


def test_a_dot_for_every_history():
    found = history_stability(widened(solved()), "HRHR", never(PUBLISHED))
    ax = stability_along(found)
    dots = [len(c.get_offsets()) for c in ax.collections]
    assert sorted(dots) == sorted(len(e.histories) for e in found.events)
    for e, x, y in zip(found.events[::2], *ax.lines[0].get_data(), strict=True):
        p = e.probability / e.probability.sum()
        assert x == e.event + 1
        assert y == pytest.approx(p @ active_share(e.stability, "no_signal"))
    assert [t.get_text() for t in ax.get_xticklabels()] == ["1\nH", "2\nR", "3\nH", "4\nR"]


def test_active_share_splits_undecided_draws():
    s = solved()
    found = belief_stability(s, np.array([[0.2, 0.3, 0.5]]), 0)
    expected = found.share[0, 1] + found.undecided[0] / 2
    assert active_share(found, "no_help")[0] == pytest.approx(expected)


def test_walk_shows_shares_and_losses():
    s = widened(solved())
    figure = stability_walk(s, points=5)
    walk = edge_walk(3, 5)
    for x, (above, below) in enumerate(zip(figure.axes[:2], figure.axes[2:], strict=True)):
        found = belief_stability(s, walk, x)
        np.testing.assert_allclose(above.lines[0].get_ydata(), found.share[:, 1])
        for c in range(2):
            np.testing.assert_allclose(below.lines[c].get_ydata(), found.loss[:, c])
        low, high = below.get_ylim()
        assert low == 0
        assert high >= found.loss.max()
    assert to_svg(figure) == to_svg(stability_walk(s, points=5))


def test_modes_without_a_choice_are_not_drawn():
    from dataclasses import replace

    from models.planning.batch import solve_draws

    s = solved(4)
    one = widened(solve_draws(replace(s.batch, draws=without_actions(s.batch.draws, ["signal"]))))
    assert len(stability_walk(one, points=3).axes) == 2


def test_distribution(pool):
    ax = value_distribution(pool)
    labels = [text.get_text() for text in ax.get_legend().get_texts()]
    assert labels[0] == f"optimum of each draw, upper bound: {pool.ceiling:.4g}"
    assert labels[1] == f"{pool.names[pool.best]} (best in the mean): {pool.means[pool.best]:.4g}"
    assert any(label.startswith("never") for label in labels)
    curve = ax.lines[0]
    order = np.argsort(pool.upper)
    np.testing.assert_array_equal(curve.get_xdata(), pool.upper[order])
    np.testing.assert_allclose(curve.get_ydata(), np.cumsum(pool.weight[order]))
    some = value_distribution(pool, ["random"])
    assert len(some.get_legend().get_texts()) == 2
