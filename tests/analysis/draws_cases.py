"""Files with draws to plan with: small fits and lists of models."""

import json
from dataclasses import replace

import numpy as np
import xarray as xr

from models.gate import Gate
from models.model_files import model_to_dict
from models.posterior_files import write_posterior
from tests.analysis.posterior_cases import posterior_of
from tests.planning_cases import sticky_model


def people(count=4, states=3, seed=0):
    rng = np.random.default_rng(seed)
    return [sticky_model(rng, states) for _ in range(count)]


def fit_of(models, settings=None, gate=None):
    """A fit whose draws are given models."""
    fit = posterior_of(models)
    names = list(models[0].state_names)
    sizes = {
        "state": names,
        "state_next": names,
        "action": list(fit.protocol.action_names),
        "emission_action": list(fit.protocol.emission_actions),
        "response": list(fit.protocol.response_names),
    }
    groups = {}
    for name, node in fit.data.children.items():
        dataset = node.to_dataset()
        groups[name] = dataset.assign_coords({k: v for k, v in sizes.items() if k in dataset.dims})
    settings = {"states": len(names), "pins": {}, **(settings or {})}
    return replace(fit, data=xr.DataTree.from_dict(groups), settings=settings, gate=gate or fit.gate)


def fit_file(path, models, settings=None, gate=None, provenance=None):
    write_posterior(fit_of(models, settings, gate), path, provenance)
    return path


def failed():
    return Gate(3, 1.2, 40.0, 30.0, "initial[s0]")


def json_file(path, models, weights=None):
    content = [model_to_dict(m) for m in models]
    if weights is not None:
        content = [{**c, "weight": w} for c, w in zip(content, weights, strict=True)]
    path.write_text(json.dumps(content))
    return path
