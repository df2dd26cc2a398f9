"""Fits of the same data in the store, to stand beside one: other numbers of states, other priors."""

from __future__ import annotations

from typing import TYPE_CHECKING

from analysis import fits_inventory
from analysis.kappa_sensitivity import KAPPAS
from analysis.sensitivity_variants import Beside
from analysis.wording import counted
from models.errors import InputError
from models.parameters import STICKY
from models.unseen import without_actions

if TYPE_CHECKING:
    from models.posterior import Posterior

STATES = (2, 3, 4, 5)


def stored_beside(
    fit: Posterior, left_out: tuple[str, ...] = (), draws: int | None = None
) -> tuple[list[Beside], list[str]]:
    """Fits of the same data that lie in the store: 2 to 5 states, and the other priors for the fit's own number.

    Nothing is sampled. Of several the one with most draws is taken; fits that failed their gate are not.

    Parameters
    ----------
    fit : Posterior
        Whose settings say what it learned from.
    left_out : tuple of str
        Actions to leave out of them too.
    draws : int, optional
        So many evenly spaced draws of each.

    Returns
    -------
    list of Beside
    list of str
        Fits of the same data that are left aside because all there are failed their gate.
    """
    from models.posterior_files import read_posterior

    digest = fit.settings.get("provenance", {}).get("data_digest")
    pins = sorted(fit.settings.get("pins") or {})
    own = (fit.n_states, _kappa(fit))
    found: dict[tuple[int, float], Beside] = {}
    failed: dict[tuple[int, float], str] = {}
    entries = [
        e for e in fits_inventory.entries()
        if e.status == "ready" and not e.about.get("hierarchical")
        and e.about.get("groups") is None and e.about.get("pins", []) == pins and e.about.get("kappa") is not None
    ]  # fmt: skip
    for entry in sorted(entries, key=lambda e: -e.about["chains"] * e.about["draws"]):
        key = (int(entry.about["states"]), float(entry.about["kappa"]))
        wanted = (key[0] in STATES and key[1] == own[1]) or (key[0] == own[0] and key[1] in KAPPAS)
        if digest is None or key == own or key in found or not wanted:
            continue
        try:
            other = read_posterior(entry.path)
        except InputError:
            continue
        if other.settings.get("provenance", {}).get("data_digest") != digest or other.protocol != fit.protocol:
            continue
        if not other.gate.passed:
            failed[key] = f"{counted(key[0], 'state')}, kappa {key[1]:g}"
        else:
            table = without_actions(other.draws(), left_out)
            found[key] = Beside(f"kappa {key[1]:g}", table if draws is None else table.thin(draws))
    return [found[key] for key in sorted(found)], [failed[key] for key in sorted(failed) if key not in found]


def _kappa(fit: Posterior) -> float:
    return float((fit.settings.get("prior") or {}).get("stay", STICKY.stay))
