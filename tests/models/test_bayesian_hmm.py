"""The PyMC model is the compiled density, term by term; the Op is the kernel, in every mode of PyTensor."""

from dataclasses import replace

import numpy as np
import pymc as pm
import pytensor
import pytensor.tensor as pt
import pytest
from pymc.distributions.transforms import LogOddsTransform, SimplexTransform
from scipy import stats

from analysis.simulate import simulate_study1
from models.bayesian_hmm import build_model
from models.errors import InputError
from models.forward_backward import log_likelihood_and_gradient
from models.groups import Groups
from models.hmm_density import HmmDensity
from models.likelihood_op import HistoryLogLikelihood, log_likelihood
from models.parameters import STICKY, DirichletPrior, Layout, checked_pins
from models.person_offset import PersonOffset
from models.protocol import PUBLISHED
from models.study_density import ModelSpec, StudyDensity
from tests.models.test_protocol import THREE
from tests.models.test_simulation import design_of
from tests.random_cases import random_run, random_tables
from tests.reference import recursions

PRIOR = DirichletPrior(initial=1.5, transition=1.2, emission=2.0, stay=1.0)
SWAP = {"help": np.array([[0.2, 0.8], [0.8, 0.2]])}


def random_log(protocol, n=30, seed=3):
    rng = np.random.default_rng(seed)
    return design_of([random_run(rng, protocol, int(k), 0.2) for k in rng.integers(1, 7, size=n)], protocol)


def density_of(log, states, prior=STICKY, pins=None):
    layout = Layout(log.protocol, states)
    return HmmDensity(log.tree(), layout, 1 + prior.pseudo_counts(layout), checked_pins(layout, pins or {}))


def split(model, x):
    """The coordinates of `HmmDensity` as PyMC's value variables, which come in the same order."""
    point, at = {}, 0
    for name, start in model.initial_point().items():
        point[name] = x[at : at + start.size].reshape(start.shape)
        at += start.size
    assert at == len(x)
    return point


CASES = {
    "two states": (PUBLISHED, 2, STICKY, {}),
    "three states, another prior": (PUBLISHED, 3, PRIOR, {}),
    "one state": (PUBLISHED, 1, STICKY, {}),
    "one table held": (PUBLISHED, 3, STICKY, {"signal": None}),
    "two tables held": (PUBLISHED, 2, PRIOR, {"no_signal": None, **SWAP}),
    "all tables held": (PUBLISHED, 2, STICKY, dict.fromkeys(PUBLISHED.action_names)),
    "three modes, three responses": (THREE, 2, PRIOR, {}),
    "three modes, three responses, one held": (THREE, 3, STICKY, {"show": None}),
}


STRUCTURED = {
    "people differ": (PUBLISHED, (), PersonOffset(0.7, 9), {}),
    "people differ, three responses": (THREE, (), PersonOffset(2.0, 7), {"show": None}),
    "starts differ": (PUBLISHED, ("initial",), None, {}),
    "moves differ, one table held": (PUBLISHED, ("transition",), None, {"no_signal": None}),
    "moves and starts differ, all tables held": (
        PUBLISHED, ("transition", "initial"), None, dict.fromkeys(PUBLISHED.action_names)
    ),
    "responses differ, and people": (PUBLISHED, ("emission", "initial"), PersonOffset(1.0, 7), {}),
    "three responses differ": (THREE, ("emission",), None, {}),
}  # fmt: skip


PYTHON = pytensor.compile.mode.Mode(linker="py", optimizer="fast_compile")
"""Evaluates the graph without compiling it, the Op by its `perform`."""


def compare(case, mode):
    if case in CASES:
        protocol, states, prior, pins = CASES[case]
        log = random_log(protocol)
        density = density_of(log, states, prior, pins)
        model = build_model(log, states, prior, pins)
    else:
        protocol, differ, people, pins = STRUCTURED[case]
        log = random_log(protocol)
        log = replace(log, participant=np.arange(log.n_runs) // 2)  # two runs a person
        groups = Groups("age", ("old", "young"), np.arange(log.n_runs) % 2, differ) if differ else None
        density = StudyDensity(log, ModelSpec(2, PRIOR, pins, groups, people)).density
        model = build_model(log, 2, PRIOR, pins, groups, people)
    logp, dlogp = model.compile_logp(mode=mode), model.compile_dlogp(mode=mode)
    rng = np.random.default_rng(1)
    for scale in (0.5, 2.0, 6.0):
        x = scale * rng.normal(size=density.dimension)
        point = split(model, x)
        value, gradient = density(x)
        assert float(logp(point)) == pytest.approx(value, rel=1e-9, abs=1e-9)
        np.testing.assert_allclose(dlogp(point), gradient, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("case", [*CASES, *STRUCTURED])
def test_density_and_gradient_equal_the_direct_engines(case):
    compare(case, PYTHON)


@pytest.mark.slow
@pytest.mark.parametrize("case", [*CASES, *STRUCTURED])
def test_compiled_density_and_gradient_equal_the_direct_engines(case):
    """PyTensor's default, numba: half a minute of compiling a model."""
    compare(case, "NUMBA")


def test_variables_carry_the_protocols_names():
    model = build_model(random_log(PUBLISHED), 3)
    assert [v.name for v in model.free_RVs] == ["initial", "transition", "help_probability"]
    assert [p.name for p in model.potentials] == ["log_likelihood"]
    assert model.coords["action"] == ("no_help", "help", "no_signal", "signal")
    assert model.named_vars_to_dims["help_probability"] == ("emission_action", "state")
    assert isinstance(model.rvs_to_transforms[model["transition"]], SimplexTransform)
    assert isinstance(model.rvs_to_transforms[model["help_probability"]], LogOddsTransform)
    held = build_model(random_log(PUBLISHED), 2, pins={"help": None})
    assert [v.name for v in held.free_RVs] == ["initial", "transition_learned", "help_probability"]
    assert held.coords["learned_action"] == ("no_help", "no_signal", "signal")
    table = held["transition"].eval(mode=PYTHON)
    assert np.array_equal(table[1], np.eye(2))
    three = build_model(random_log(THREE), 2)
    assert [v.name for v in three.free_RVs] == ["initial", "transition", "emission"]


def test_refusals():
    with pytest.raises(InputError, match="recorded responses: found 0"):
        build_model(design_of([[(0, -1)]]), 2)
    with pytest.raises(InputError, match=r"pinned table of help, shape: found \(2, 2\)"):
        build_model(random_log(PUBLISHED), 3, pins=SWAP)


def test_an_analyst_swaps_the_priors():
    """A model of one's own around the likelihood: logit-normal help probabilities that share a mean."""
    log = random_log(PUBLISHED)
    layout = Layout(PUBLISHED, 2)
    with pm.Model() as own:
        mean = pm.Normal("mean", 0, 1)
        logit = pm.Normal("logit", mean, 0.5, shape=(2, 2))
        initial = pm.Dirichlet("initial", np.ones(2))
        transition = pm.Dirichlet("transition", np.ones((4, 2, 2)))
        high = pm.math.sigmoid(logit)
        emission = pt.stack([1 - high, high], axis=-1)
        pm.Potential("log_likelihood", log_likelihood(log.tree(), layout, initial, transition, emission))
    point = own.initial_point()
    rng = np.random.default_rng(4)
    point = {k: v + 0.3 * rng.normal(size=v.shape) for k, v in point.items()}
    p = 1 / (1 + np.exp(-point["logit"]))
    rows = {k: point[f"{k}_simplex__"] for k in ("initial", "transition")}
    softmaxes = {}
    for k, z in rows.items():
        both = np.concatenate([z, -z.sum(-1, keepdims=True)], axis=-1)
        softmaxes[k] = np.exp(both) / np.exp(both).sum(-1, keepdims=True)
    tables = (softmaxes["initial"], softmaxes["transition"], np.stack([1 - p, p], axis=-1))
    wanted = log_likelihood_and_gradient(log.tree(), *tables, layout.emission_index)[0]
    wanted += stats.norm.logpdf(point["mean"]) + stats.norm.logpdf(point["logit"], point["mean"], 0.5).sum()
    wanted += sum(np.sum(np.log(2) + np.log(t).sum(-1)) for t in softmaxes.values())
    assert own.compile_logp(mode=PYTHON)(point) == pytest.approx(wanted, rel=1e-9)
    gradient = own.compile_dlogp(mode=PYTHON)(point)
    assert gradient.shape == (sum(v.size for v in point.values()),)
    assert np.all(np.isfinite(gradient))


def test_priors_of_the_built_model_can_be_replaced():
    """`pm.do` holds a variable, `pm.observe` conditions on it: it is a plain model."""
    log = random_log(PUBLISHED)
    tables = random_tables(np.random.default_rng(2), PUBLISHED, 2)
    model = pm.do(build_model(log, 2), {"transition": tables[1], "initial": tables[0]})
    assert [v.name for v in model.free_RVs] == ["help_probability"]
    help_logit = np.zeros((2, 2))
    wanted = log_likelihood_and_gradient(
        log.tree(), *tables[:2], np.full((2, 2, 2), 0.5), Layout(PUBLISHED, 2).emission_index
    )[0]
    value = model.compile_logp(mode=PYTHON)({"help_probability_logodds__": help_logit})
    assert value == pytest.approx(wanted + 8 * np.log(0.5), rel=1e-9)


# -- the Op ----------------------------------------------------------------------------------------------
def op_function(log, states, mode, outputs):
    symbols = pt.vector("i"), pt.tensor3("t"), pt.tensor3("e")
    value = log_likelihood(log.tree(), Layout(log.protocol, states), *symbols)
    wanted = [value, *(pytensor.grad(value, list(symbols)) if outputs == "gradient" else [])]
    return pytensor.function(list(symbols), wanted, mode=mode)


@pytest.mark.parametrize("protocol", [PUBLISHED, THREE])
def test_python_and_compiled_modes_agree_with_the_specification(protocol):
    log = random_log(protocol)
    tables = random_tables(np.random.default_rng(5), protocol, 3)
    python = op_function(log, 3, PYTHON, "gradient")(*tables)
    fast = op_function(log, 3, "NUMBA", "gradient")(*tables)
    for one, other in zip(python, fast, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-13, atol=1e-13)
    runs = [
        list(zip(log.action[b:e].tolist(), log.response[b:e].tolist(), strict=True))
        for b, e in zip(log.offsets, log.offsets[1:], strict=False)
    ]
    index = Layout(protocol, 3).emission_index
    wanted = sum(recursions.log_likelihood(run, *tables, index) for run in runs)
    assert fast[0] == pytest.approx(wanted, rel=1e-10)
    weights = np.ones(len(runs))
    for which, gradient in enumerate(fast[1:]):
        for position in list(np.ndindex(gradient.shape))[::5]:
            exact = recursions.gradient_entry(runs, weights, tables, index, which, position)
            assert gradient[position] == pytest.approx(exact, rel=1e-9, abs=1e-9)


def test_the_pullback_by_finite_differences():
    log = random_log(PUBLISHED)
    layout = Layout(PUBLISHED, 2)
    tables = random_tables(np.random.default_rng(6), PUBLISHED, 2)

    def value(*symbols):
        return log_likelihood(log.tree(), layout, *symbols)

    pytensor.gradient.verify_grad(
        value, list(tables), rng=np.random.default_rng(7), eps=1e-6, rel_tol=1e-5, mode=PYTHON
    )


def test_one_compiled_function_serves_every_study():
    """The tree is an input, so another study of the same shape compiles nothing."""
    logs = [random_log(PUBLISHED, seed=s) for s in (1, 2)]
    layout = Layout(PUBLISHED, 2)
    tables = random_tables(np.random.default_rng(5), PUBLISHED, 2)
    arrays = [pt.vector(dtype="int64") for _ in range(5)] + [pt.vector(dtype="float64")]
    symbols = [pt.matrix(), pt.tensor3(), pt.tensor3()]
    outputs = HistoryLogLikelihood().make_node(*symbols, *arrays).outputs
    function = pytensor.function([*symbols, *arrays], outputs[0], mode="NUMBA")
    for log in logs:
        wanted = log_likelihood_and_gradient(log.tree(), *tables, layout.emission_index)[0]
        assert float(function(tables[0][None], *tables[1:], layout.emission_index, *log.tree().arrays)) == wanted


def test_impossible_responses_are_minus_infinity_not_an_error():
    log = design_of([[(2, 1)]])
    tables = (np.array([1.0, 0.0]), np.tile(np.eye(2), (4, 1, 1)), np.tile([[1.0, 0.0], [0.5, 0.5]], (2, 1, 1)))
    assert op_function(log, 2, "NUMBA", "value")(*tables)[0] == -np.inf


def test_second_derivatives_and_wrong_ranks_are_refused():
    log = random_log(PUBLISHED)
    symbols = pt.vector("i"), pt.tensor3("t"), pt.tensor3("e")
    value = log_likelihood(log.tree(), Layout(PUBLISHED, 2), *symbols)
    slope = pytensor.grad(value, symbols[0])
    with pytest.raises(NotImplementedError, match="second derivatives"):
        pytensor.grad(slope.sum(), symbols[0])
    with pytest.raises(TypeError, match="wants inputs of ranks"):
        HistoryLogLikelihood().make_node(*[symbols[0]] * 9)


# -- against somebody else's marginalisation -------------------------------------------------------------
def test_equals_the_marginalised_chain_of_pymc_extras():
    """People as a batch of Markov chains with one transition table a round, summed out by somebody else."""
    pmx = pytest.importorskip("pymc_extras", reason="pymc-extras is no dependency: it asks for an older PyMC")
    if tuple(map(int, pmx.__version__.split(".")[:2])) < (0, 15):
        pytest.skip("pymc-extras before 0.15 has no chains whose tables change with the round")
    log = simulate_study1(participants=30)
    tables = random_tables(np.random.default_rng(9), PUBLISHED, 3)
    wanted = log_likelihood_and_gradient(log.tree(), *tables, Layout(PUBLISHED, 3).emission_index)[0]
    assert marginalised_by_pymc_extras(pmx, log, tables) == pytest.approx(wanted, rel=1e-9)


def marginalised_by_pymc_extras(pmx, log, tables):
    initial, transition, emission = tables
    runs, rounds = log.n_runs, int(log.offsets[1])
    action, response = log.action.reshape(runs, rounds), log.response.reshape(runs, rounds)
    index = np.asarray(PUBLISHED.emission_index)
    seen = response >= 0
    with pm.Model() as model:
        states = pmx.DiscreteMarkovChain(
            "states", P=transition[action[:, :-1]], init_dist=pm.Categorical.dist(p=initial), time_varying_P=True,
            shape=(runs, rounds),
        )  # fmt: skip
        # Where nothing was seen, helping is certain in every state and "observed".
        help_by_state = np.where(seen[..., None], emission[np.maximum(index[action], 0), :, 1], 1.0)
        p = help_by_state[..., 0]
        for s in range(1, len(initial)):
            p = pt.where(pt.eq(states, s), help_by_state[..., s], p)
        pm.Bernoulli("responses", p=p, observed=np.where(seen, response, 1))
    marginal = pmx.marginalize(model, [states])
    return float(marginal.compile_logp(mode=PYTHON)({}))
