"""Weighted draws: shapes, constructors, thinning."""

import re

import numpy as np
import pytest

from models.errors import InputError
from models.lspomdp import LatentStatePOMDP
from models.model_draws import ModelDraws
from models.model_files import model_to_dict
from models.protocol import PUBLISHED
from models.reward import Reward
from tests.models.test_protocol import THREE
from tests.random_cases import random_tables


def many(n, n_states=2, protocol=PUBLISHED):
    rng = np.random.default_rng(3)
    return [LatentStatePOMDP(*random_tables(rng, protocol, n_states), protocol) for _ in range(n)]


def test_models_there_and_back():
    models = many(3)
    draws = ModelDraws.from_models(models, provenance={"seed": 1})
    assert (draws.n_draws, len(draws), draws.n_states) == (3, 3, 2)
    assert draws.weight.tolist() == [1 / 3] * 3
    assert draws.provenance == {"seed": 1}
    for draw, model in zip(draws, models, strict=True):
        for name in ("initial", "transition", "emission"):
            assert np.array_equal(getattr(draw, name), getattr(model, name))
    assert np.array_equal(draws.model(2).transition, models[2].transition)


def test_weights_are_kept():
    draws = ModelDraws.from_models(many(2), np.array([0.25, 0.75]))
    assert draws.weight.tolist() == [0.25, 0.75]


@pytest.mark.parametrize(
    ("weight", "found"), [([0.5, 0.4], "0.9"), ([1.5, -0.5], "1.0"), ([np.nan, 1.0], "nan"), ([np.inf, 0.0], "inf")]
)
def test_unusable_weights_are_refused(weight, found):
    message = f"model draws, sum of weights: found {found}, wanted non-negative weights that sum to 1"
    with pytest.raises(InputError, match=re.escape(message)):
        ModelDraws.from_models(many(2), np.array(weight))


def arrays(n=2):
    draws = ModelDraws.from_models(many(n))
    return {name: getattr(draws, name).copy() for name in ("initial", "transition", "emission", "weight")}


@pytest.mark.parametrize(
    ("name", "shape", "message"),
    [
        ("initial", (2,), "model draws, initial: found (2,), wanted shape [draw, state]"),
        ("initial", (0, 2), "model draws, initial: found (0, 2), wanted shape [draw, state]"),
        ("transition", (2, 3, 2, 2), "model draws, shape of transition: found (2, 3, 2, 2), wanted (2, 4, 2, 2)"),
        ("emission", (2, 2, 3, 2), "model draws, shape of emission: found (2, 2, 3, 2), wanted (2, 2, 2, 2)"),
        ("weight", (3,), "model draws, shape of weight: found (3,), wanted (2,)"),
    ],
)
def test_shapes_that_do_not_fit_are_refused(name, shape, message):
    with pytest.raises(InputError, match=f"^{re.escape(message)}$"):
        ModelDraws(PUBLISHED, **(arrays() | {name: np.zeros(shape)}))


def test_a_row_that_is_no_distribution_is_named_by_draw():
    broken = arrays(3)
    broken["transition"][2, 1, 0] = [0.5, 0.48]  # row 1 * 2 + 0 of draw 2
    message = "model, transition, draw 2, row 2, sum of the row: found '0.98', wanted 1 within 1e-9"
    with pytest.raises(InputError, match=re.escape(message)):
        ModelDraws(PUBLISHED, **broken)


def test_models_of_different_kinds_do_not_mix():
    with pytest.raises(InputError, match=r"draw 2: found 3 states, protocol .*published.*, wanted 2 states"):
        ModelDraws.from_models([*many(2), *many(1, 3)])
    with pytest.raises(InputError, match=r"draw 1: found 2 states, protocol .*three of each.*, wanted 2 states"):
        ModelDraws.from_models([*many(1), *many(1, 2, THREE)])
    with pytest.raises(InputError, match="model draws: found 0, wanted at least one model"):
        ModelDraws.from_models([])


# -- thinning -----------------------------------------------------------------------------------------------
def test_thinning_takes_evenly_spaced_draws():
    n = 1000
    draws = ModelDraws.from_models(many(n))
    thin = draws.thin(10)
    kept = [int(np.flatnonzero((draws.initial == row).all(axis=1))[0]) for row in thin.initial]
    assert kept == [50, 150, 250, 350, 450, 550, 650, 750, 850, 950]
    np.testing.assert_allclose(thin.weight, np.full(10, 0.1))
    assert draws.thin(n) is draws
    assert draws.thin(n + 5) is draws
    assert draws.thin(1).n_draws == 1


def test_thinning_never_takes_a_draw_twice():
    draws = ModelDraws.from_models(many(7))
    for n in range(1, 7):
        assert len(np.unique(draws.thin(n).initial, axis=0)) == n


def test_thinned_weights_keep_their_proportions():
    weight = np.array([0.1, 0.2, 0.3, 0.4])
    thin = ModelDraws.from_models(many(4), weight).thin(2)  # draws 1 and 3
    np.testing.assert_allclose(thin.weight, [1 / 3, 2 / 3])


def test_thinning_to_nothing_is_refused():
    with pytest.raises(InputError, match="thin, n: found 0, wanted at least 1"):
        ModelDraws.from_models(many(2)).thin(0)


# -- JSON ---------------------------------------------------------------------------------------------------
def test_from_json_takes_one_model_or_a_list():
    models = many(2)
    one = ModelDraws.from_json(model_to_dict(models[0]), "one.json")
    assert one.n_draws == 1
    assert one.weight.tolist() == [1.0]
    assert one.provenance == {"source": "one.json"}
    two = ModelDraws.from_json([model_to_dict(m) for m in models])
    assert np.array_equal(two.transition, np.stack([m.transition for m in models]))
    assert two.weight.tolist() == [0.5, 0.5]


def test_from_json_takes_weights_from_all_models_or_none():
    entries = [model_to_dict(m) for m in many(2)]
    entries[0]["weight"] = 0.25
    with pytest.raises(InputError, match=r"^x: model 1 has no weight although others have one$"):
        ModelDraws.from_json(entries, "x")
    entries[1]["weight"] = 0.75
    assert ModelDraws.from_json(entries).weight.tolist() == [0.25, 0.75]
    entries[1]["weight"] = "much"
    with pytest.raises(InputError, match=r"^x, model 1, weight: found 'much', wanted a number of at least 0$"):
        ModelDraws.from_json(entries, "x")


def test_from_json_names_the_model_at_fault():
    entries = [model_to_dict(m) for m in many(2)]
    entries[1]["initial"] = [0.5, 0.6]
    with pytest.raises(InputError, match=r"^x, model 1: model, initial, sum of the row: found '1\.1'"):
        ModelDraws.from_json(entries, "x")
    with pytest.raises(InputError, match=r"^x: found an empty list, wanted at least one model object$"):
        ModelDraws.from_json([], "x")
    with pytest.raises(InputError, match=r"^x, model 0: found 'str', wanted a JSON object$"):
        ModelDraws.from_json("model", "x")


def test_reward_and_state_names_travel_with_the_draws():
    tables = random_tables(np.random.default_rng(3), PUBLISHED, 2)
    names, reward = ("cold", "warm"), Reward((1.0, 2.0), 0.5, {"help": 3.0})
    own = LatentStatePOMDP(*tables, PUBLISHED, names, reward)
    draws = ModelDraws.from_models([own, own, own]).thin(2)
    assert draws.model(1).state_names == names
    assert draws.model(1).reward == reward
    other = LatentStatePOMDP(*tables, PUBLISHED, names)
    with pytest.raises(InputError, match="draw 1: its reward or state names differ from those of draw 0"):
        ModelDraws.from_models([own, other])
