"""Engine `pymc`: chains of the PyMC model, one at a time, from the same starts as the direct engine's."""

import numpy as np
import pymc as pm
import pytest

from analysis.simulate import simulate_study1
from models.bayesian_hmm import model_of
from models.chains import STATS, NutsSettings, sample, sample_chain
from models.person_offset import PersonOffset
from models.pymc_engine import ModelTarget
from models.study_density import ModelSpec, StudyDensity

SHORT = NutsSettings(draws=30, tune=60, chains=3, seed=5)


def study_of(**options):
    return StudyDensity(simulate_study1(participants=80), ModelSpec(2, **options))


@pytest.fixture(scope="module")
def target():
    made = ModelTarget.of(study_of())
    made.prepare()
    return made


@pytest.mark.slow
def test_a_chain_depends_on_seed_and_number_only(target):
    together = sample(target, SHORT)
    alone = sample_chain(target, 2, SHORT)
    assert np.array_equal(alone.x, together[2].x)
    assert set(alone.stats) == set(STATS)
    assert alone.x.shape == (30, target.study.layout.size)
    assert not np.array_equal(together[0].x, together[1].x)
    np.testing.assert_allclose(alone.x[:, target.study.layout.rows[0]].sum(axis=1), 1)


@pytest.mark.slow
def test_an_interrupted_run_goes_on(target):
    together = sample(target, SHORT)
    handed, seen = {}, []
    rest = sample(
        target, SHORT, done={1: together[1]}, finished=handed.__setitem__, progress=lambda *now: seen.append(now)
    )
    assert sorted(handed) == [0, 2]
    assert rest[1] is together[1]
    assert all(np.array_equal(rest[c].x, together[c].x) for c in range(3))
    assert all(label == "sampling" and total == 3 * 90 for label, _, total in seen)


@pytest.mark.slow
@pytest.mark.parametrize(
    "options", [{}, {"pins": {"help": None}}, {"people": PersonOffset(1.0, 7)}], ids=["plain", "held", "people"]
)
def test_chains_start_where_the_direct_engines_do(options, target):
    """Nutpie's own coordinates, put back in the density's order, are the density's starting point."""
    study = study_of(**options)
    own = target if not options else ModelTarget.of(study)
    compiled = own.nutpie_model()
    x = compiled.initial_point_func(17)
    built = model_of(study)
    names, places, _ = compiled.shape_info
    place = dict(zip(names, places, strict=True))
    ordered = np.concatenate([x[place[built.rvs_to_values[v].name]] for v in built.free_RVs])
    np.testing.assert_array_equal(ordered, study.density.starting_point(17))


@pytest.mark.slow
def test_what_an_analyst_added_starts_where_pymc_says():
    study = study_of()
    model = model_of(study)
    with model:
        pm.Normal("more", 3.0, 0.1, initval=3.25)
    compiled = ModelTarget(study, model).nutpie_model()
    x = compiled.initial_point_func(17)
    assert len(x) == study.density.dimension + 1
    where = compiled.shape_info[1][compiled.shape_info[0].index("more")]
    assert abs(x[where] - 3.25) <= 1  # PyMC's jitter
    assert set(study.density.starting_point(17)) == set(np.delete(x, where))
