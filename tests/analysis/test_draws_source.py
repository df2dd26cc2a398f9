"""What draws are planned with: fits and lists of models, actions without evidence, refusals."""

import json

import numpy as np
import pytest

from analysis import datasets
from analysis.draws_source import read_draws
from analysis.event_files import write_events
from models.errors import InputError
from models.model_files import model_to_dict
from models.protocol import PUBLISHED
from models.unseen import EVIDENCE
from tests.analysis.draws_cases import failed, fit_file, json_file, people

ALL_SEEN = {EVIDENCE: dict.fromkeys(PUBLISHED.action_names, 9)}
NO_SIGNAL = {EVIDENCE: {"no_help": 5, "help": 5, "no_signal": 5, "signal": 0}}


# -- lists of models -------------------------------------------------------------------------------
def test_weighted_models(tmp_path):
    models = people()
    path = json_file(tmp_path / "m.json", models, [0.1, 0.2, 0.3, 0.4])
    found = read_draws(path, r=0.05, costs={"help": 7.0, "signal": None})
    np.testing.assert_array_equal(found.draws.weight, [0.1, 0.2, 0.3, 0.4])
    np.testing.assert_allclose(found.draws.transition[2], models[2].transition)
    assert found.draws.reward.r == 0.05
    assert found.draws.reward.costs["help"] == 7
    assert found.unseen is None
    assert found.warnings == []
    assert found.to_dict()["gate"] is None
    assert found.to_dict()["reward"]["costs"] == {"no_help": 0, "help": 7, "no_signal": 0, "signal": 15}
    thinned = read_draws(path, draws=2)
    assert thinned.draws.n_draws == 2
    assert thinned.draws.weight.sum() == pytest.approx(1)
    assert "2 draws of 4, evenly spaced" in thinned.sentence


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda c: [{**e, "weight": 0.3} for e in c], "sum of weights: found 1.2, wanted non-negative weights"),
        (lambda c: [{**c[0], "weight": 1.0}, *c[1:]], "model 1 has no weight although others have one"),
        (lambda c: [{**e, "weight": "much"} for e in c], "weight: found"),
        (lambda c: [*c[:3], model_to_dict(people(1, 2)[0])], "draw 3: found 2 states"),
        (lambda c: [*c[:3], {**c[3], "states": ["a", "b", "c"]}], "draw 3: its reward or state names differ"),
        (lambda c: [*c[:3], {**c[3], "reward": {"r": 0.1}}], "draw 3: its reward or state names differ"),
        (lambda c: [*c[:3], {**c[3], "initial": [0.5, 0.5, 0.5]}], "model 3"),
        (lambda c: [], "found an empty list"),
        (lambda c: {"states": 3}, "states"),
    ],
)
def test_models_that_do_not_fit(tmp_path, change, words):
    path = tmp_path / "m.json"
    path.write_text(json.dumps(change([model_to_dict(m) for m in people()])))
    with pytest.raises(InputError) as caught:
        read_draws(path)
    assert str(caught.value).startswith(str(path))
    assert words in str(caught.value)


def test_options_of_fits_only(tmp_path):
    path = json_file(tmp_path / "m.json", people())
    for option in ({"group": "older"}, {"person": 0.0}):
        with pytest.raises(InputError, match=r"wanted no value: .* holds models, not a fit"):
            read_draws(path, **option)
    with pytest.raises(InputError, match="cost of dance: found action dance"):
        read_draws(path, costs={"dance": 1.0})
    with pytest.raises(InputError, match="--draws: found 0"):
        read_draws(path, draws=0)
    with pytest.raises(InputError, match="no such file"):
        read_draws(tmp_path / "none.nc")
    with pytest.raises(InputError, match="cannot be read"):
        read_draws(tmp_path)


# -- fits ------------------------------------------------------------------------------------------
def test_a_fit(tmp_path):
    models = people(6)
    found = read_draws(fit_file(tmp_path / "f.nc", models, ALL_SEEN), draws=3)
    assert found.available == 6
    np.testing.assert_array_equal(found.draws.initial, [models[i].initial for i in (1, 3, 5)])
    assert found.unseen == ()
    assert found.left_out == ()
    assert found.warnings == []
    assert found.to_dict()["gate"] == {"passed": True, "reasons": [], "forced": False}


def test_a_failed_gate_is_refused_unless_forced(tmp_path):
    path = fit_file(tmp_path / "f.nc", people(), ALL_SEEN, failed())
    with pytest.raises(InputError, match=r"a fit that failed its gate .3 divergent.* or --force"):
        read_draws(path)
    found = read_draws(path, force=True)
    assert found.forced
    assert "used although" in found.warnings[0]


def test_unseen_actions_are_left_out(tmp_path):
    path = fit_file(tmp_path / "f.nc", people(), NO_SIGNAL)
    found = read_draws(path, costs={"signal": 3.0})
    assert found.left_out == found.unseen == ("signal",)
    assert found.draws.protocol.action_names == ("no_help", "help", "no_signal")
    assert "left out signal" in found.warnings[0]
    assert "--allow-unseen" in found.warnings[0]
    kept = read_draws(path, allow_unseen=True)
    assert kept.left_out == ()
    assert kept.draws.protocol == PUBLISHED
    assert "no evidence on signal" in kept.warnings[0]


def test_a_null_action_without_evidence(tmp_path):
    path = fit_file(tmp_path / "f.nc", people(), {EVIDENCE: {"help": 1, "no_signal": 1, "signal": 1}})
    with pytest.raises(InputError, match=r"no_help, the null action .*--allow-unseen"):
        read_draws(path)


def test_evidence_is_counted_in_the_data_a_fit_names(tmp_path):
    """A fit that recorded none: its data are looked at, if they are the same."""
    log = datasets.load("simulated_study1").log
    part = log.select(conditions=[c for c in log.conditions if c.endswith("no-signal")])
    events = tmp_path / "part.csv"
    write_events(part, events)
    loaded = datasets.load(str(events))
    path = tmp_path / "f.nc"
    fit_file(path, people(), provenance={"data": str(events), "data_digest": loaded.digest})
    assert read_draws(path).left_out == ("signal",)
    fit_file(path, people(), provenance={"data": "simulated_study1", "data_digest": "another"})
    unknown = read_draws(path)
    assert unknown.unseen is None
    assert "is not known" in unknown.warnings[0]
    fit_file(path, people())
    assert read_draws(path).unseen is None


def test_evidence_of_a_fit_of_some_conditions(tmp_path):
    """What a fit names of its data are the runs; the digest says whether they were understood."""
    import xarray as xr

    from models.posterior_files import write_posterior
    from tests.analysis.draws_cases import fit_of

    log = datasets.load("simulated_study1").log
    part = log.select(conditions=["help+no-signal"])
    seen = part.response >= 0
    run = part.run_of_event[seen]
    coords = {"participant": ("event", part.participant[run]), "sequence": ("event", part.sequence[run]),
              "k": ("event", part.k[seen])}  # fmt: skip
    fit = fit_of(people())
    fit.data["observed_data"] = xr.DataTree(xr.Dataset({"response": ("event", part.response[seen])}, coords=coords))
    path = tmp_path / "f.nc"
    write_posterior(fit, path, {"data": "simulated_study1", "data_digest": datasets.log_digest(part)})
    with pytest.raises(InputError, match="no_help, the null action"):
        read_draws(path)
    found = read_draws(path, allow_unseen=True)
    assert found.unseen == ("no_help", "signal")


def test_groups_and_people_are_named(tmp_path):
    from dataclasses import replace

    import xarray as xr

    from models.entries import SPREAD
    from models.posterior_files import write_posterior
    from tests.analysis.draws_cases import fit_of

    fit = fit_of(people(), ALL_SEEN)
    own = fit.data["posterior"].to_dataset()
    groups = {"posterior": own.assign(initial=own["initial"].expand_dims({"group": ["old", "young"]}, 2)),
              "prior": own.assign(initial=own["initial"].expand_dims({"group": ["old", "young"]}, 2))}  # fmt: skip
    path = tmp_path / "g.nc"
    write_posterior(replace(fit, data=xr.DataTree.from_dict(groups)), path)
    with pytest.raises(InputError, match="--group: found none, wanted one of old, young"):
        read_draws(path)
    with pytest.raises(InputError, match="--group: group: found 'x'"):
        read_draws(path, group="x")
    assert read_draws(path, group="old").draws.n_draws == 4
    spread = own.assign({SPREAD: (("chain", "draw"), np.full((1, 4), 0.7))})
    path = tmp_path / "p.nc"
    write_posterior(replace(fit, data=xr.DataTree.from_dict({"posterior": spread, "prior": spread})), path)
    with pytest.raises(InputError, match=r"--person: found none, wanted a person.*for one kind of person"):
        read_draws(path)
    helpful, median = read_draws(path, person=2.0).draws, read_draws(path, person=0.0).draws
    assert np.all(helpful.emission[..., 1] >= median.emission[..., 1])
    with pytest.raises(InputError, match="--person: found nan"):
        read_draws(path, person=float("nan"))
    with pytest.raises(InputError, match=r"--person: found 0\.0, wanted no value"):
        read_draws(fit_file(tmp_path / "f.nc", people(), ALL_SEEN), person=0.0)


def test_another_protocol(tmp_path):
    from dataclasses import replace

    path = fit_file(tmp_path / "f.nc", people(), ALL_SEEN)
    assert read_draws(path, protocol=PUBLISHED).draws.protocol == PUBLISHED
    with pytest.raises(InputError, match="--protocol: found 'other', wanted none"):
        read_draws(path, protocol=replace(PUBLISHED, name="other"))
