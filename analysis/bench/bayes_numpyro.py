"""The Bayesian model in NumPyro: JAX on the CPU in double precision, compiled by XLA."""

# Only the environment of the benchmarks has JAX and NumPyro.
# mypy: disable-error-code="import-not-found"

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from analysis.bench.bayes_peers import distinct, help_name, unrolled
from models.events import EventLog
from models.histories import UNSEEN
from models.parameters import DirichletPrior, Layout


def numpyro_model(log: EventLog, states: int, prior: DirichletPrior) -> Callable[[], None]:
    """Variables, priors and likelihood of `analysis.bench.bayes_peers.unrolled_model`."""
    import jax.numpy as jnp
    import numpyro
    import numpyro.distributions as dist

    action, response, counts = distinct(log)
    layout = Layout(log.protocol, states)
    a_initial, a_transition, a_emission = layout.unpack(1.0 + prior.pseudo_counts(layout))
    top = int(np.argmax(log.protocol.scores))
    seen = response != UNSEEN
    table = np.where(seen, np.asarray(log.protocol.emission_index)[action], 0)

    def model() -> None:
        initial = numpyro.sample("initial", dist.Dirichlet(a_initial))
        transition = numpyro.sample("transition", dist.Dirichlet(a_transition).to_event(2))
        high = numpyro.sample(
            help_name(log), dist.Beta(a_emission[..., top], a_emission[..., 1 - top]).to_event(2)
        )  # fmt: skip
        evidence = jnp.where((response == top)[..., None], high[table], 1.0 - high[table])
        shown = jnp.where(seen[..., None], evidence, 1.0)
        likelihood = unrolled(jnp, initial, transition, shown, action)
        numpyro.factor("log_likelihood", jnp.sum(counts * jnp.log(likelihood)))

    return model


def sample_numpyro(
    log: EventLog, states: int, prior: DirichletPrior, draws: int, tune: int, chains: int, seed: int
) -> tuple[dict[str, NDArray[np.float64]], dict[str, NDArray[Any]]]:
    """Posterior draws by variable, ``[chain, draw, ...]``, and the statistics `diverging` and `n_steps`.

    NUTS with NumPyro's defaults, chains one after the other: in one batch every chain would wait for the longest
    trajectory, and in parallel XLA would divide the processor into as many devices.
    """
    import jax
    from numpyro.infer import MCMC, NUTS

    jax.config.update("jax_enable_x64", True)
    jax.config.update("jax_platforms", "cpu")
    mcmc = MCMC(
        NUTS(numpyro_model(log, states, prior)), num_warmup=tune, num_samples=draws, num_chains=chains,
        chain_method="sequential", progress_bar=False,
    )  # fmt: skip
    mcmc.run(jax.random.PRNGKey(seed), extra_fields=("num_steps",))
    drawn = {name: np.asarray(values) for name, values in mcmc.get_samples(group_by_chain=True).items()}
    extra = mcmc.get_extra_fields(group_by_chain=True)
    return drawn, {"diverging": np.asarray(extra["diverging"]), "n_steps": np.asarray(extra["num_steps"])}
