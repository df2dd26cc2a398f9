"""Fits of the same data in the store that stand beside one."""

from dataclasses import replace

import pytest

from analysis import fits_inventory, sensitivity_stored
from analysis.fits_inventory import StoreEntry
from models.posterior_files import read_posterior
from tests.analysis.draws_cases import failed, fit_file, people


@pytest.fixture
def store(tmp_path, monkeypatch):
    """Fits by number of states and kappa: the asked one, two beside it, another data set's, and a failed one."""
    entries = []

    def add(name, states, kappa, digest="abc", gate=None, **about):
        settings = {"prior": {"stay": kappa}}
        path = fit_file(tmp_path / f"{name}.nc", people(4, states), settings, gate, {"data_digest": digest})
        known = {
            "states": states, "kappa": kappa, "gate": gate is None, "chains": 1, "draws": 4, "pins": [],
            "hierarchical": False, **about,
        }  # fmt: skip
        entries.append(StoreEntry(path, name, "ready", 1, 0.0, known))
        return path

    own = add("own", 3, 2.0)
    add("fewer", 2, 2.0)
    add("prior", 3, 5.0)
    add("elsewhere", 4, 2.0, digest="other")
    add("failed", 3, 0.0, gate=failed())
    add("people", 5, 2.0, hierarchical=True)
    add("strange", 2, 5.0)
    entries.append(replace(entries[1], key="old", status="outdated"))
    monkeypatch.setattr(fits_inventory, "entries", lambda: entries)
    return own


def test_other_states_and_other_priors_of_the_same_data(store):
    found, aside = sensitivity_stored.stored_beside(read_posterior(store))
    assert [(b.name, b.draws.n_states) for b in found] == [("kappa 2", 2), ("kappa 5", 3)]
    assert aside == ["3 states, kappa 0"]


def test_draws_are_thinned_and_actions_left_out(store):
    found, _ = sensitivity_stored.stored_beside(read_posterior(store), ("signal",), 2)
    for other in found:
        assert other.draws.n_draws == 2
        assert "signal" not in other.draws.protocol.action_names


def test_nothing_is_found_for_unknown_data(store, monkeypatch):
    monkeypatch.setattr(fits_inventory, "entries", list)
    assert sensitivity_stored.stored_beside(read_posterior(store)) == ([], [])
