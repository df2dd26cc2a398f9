"""The store of fits: found again, resumed after an interruption, never confused."""

import json
import subprocess
import sys
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pymc as pm
import pytensor.tensor as pt
import pytest

from analysis import fits, kept_chains
from analysis.datasets import log_digest
from analysis.fits_inventory import entries, to_clear
from analysis.kept_chains import ABOUT, KeptChains, NotKeptWarning
from analysis.source_digest import reached_sources, source_digest
from models import chains, nuts
from models.bayesian_fit import EDITED
from models.bayesian_hmm import build_model
from models.chains import STATS, Chain
from models.errors import InputError
from models.groups import Groups, SmallGroupWarning
from models.model_digest import model_digest
from models.nuts import NutsSettings
from models.parameters import STICKY, DirichletPrior
from models.posterior import TABLES
from models.posterior_files import read_posterior
from models.simulation import simulate_responses
from models.study_density import ModelSpec, StudyDensity
from tests.models.test_recovery import truth, varied_design

ROOT = Path(__file__).resolve().parents[2]
SHORT = NutsSettings(40, 60, 3)


@pytest.fixture(scope="module")
def log():
    rng = np.random.default_rng(2)
    return simulate_responses(truth(), varied_design(60, 4, rng), rng)[0]


@pytest.fixture(autouse=True)
def own_store(tmp_path, monkeypatch):
    # Kernels stay where they are compiled; only the store moves.
    monkeypatch.setattr(fits, "store_folder", lambda: tmp_path / "fits")
    return tmp_path / "fits"


def test_a_fit_is_found_again_and_is_the_same(log):
    first = fits.stored_fit(log, log_digest(log), 2, sampler=SHORT)
    again = fits.stored_fit(log, log_digest(log), 2, sampler=SHORT)
    assert (first.reused, again.reused) == (False, True)
    for name in TABLES:
        assert np.array_equal(first.posterior.table(name), again.posterior.table(name))


def test_every_setting_has_its_own_key(log):
    digest = log_digest(log)
    base = {"states": 2, "prior": vars(DirichletPrior()), "engine": "direct", "sampler": vars(SHORT), "pins": {}}
    changed = [
        {"states": 3}, {"prior": vars(DirichletPrior(stay=1.0))}, {"engine": "pymc"}, {"pins": {"help": None}},
        {"sampler": vars(NutsSettings(40, 60, 3, seed=2))},
    ]  # fmt: skip
    keys = {fits.fit_key(digest, base), fits.fit_key("other", base)}
    keys |= {fits.fit_key(digest, {**base, **change}) for change in changed}
    assert len(keys) == 2 + len(changed)


class Restless(DirichletPrior):
    """Another prior with the same parameters."""

    def pseudo_counts(self, layout):
        return super().pseudo_counts(layout) + 1.0


def test_priors_of_different_classes_are_not_confused(log):
    plain, own = (
        fits.stored_fit(log, log_digest(log), 2, prior=prior, sampler=SHORT)
        for prior in (DirichletPrior(), Restless())
    )
    assert plain.key != own.key
    assert not own.reused


@pytest.mark.parametrize("engine", ["direct", pytest.param("pymc", marks=pytest.mark.slow)])
def test_an_interrupted_run_keeps_complete_chains_and_goes_on(engine, log, own_store, monkeypatch):
    digest = log_digest(log)
    whole = fits.stored_fit(log, digest, 2, engine=engine, sampler=SHORT)
    whole.path.unlink()
    calls = []
    original = chains.sample_chain

    def interrupted(target, chain, *rest):
        calls.append(chain)
        if chain == 1:
            raise KeyboardInterrupt
        return original(target, chain, *rest)

    monkeypatch.setattr(chains, "sample_chain", interrupted)
    monkeypatch.setattr("os.cpu_count", lambda: 1)
    with pytest.raises(KeyboardInterrupt):
        fits.stored_fit(log, digest, 2, engine=engine, sampler=SHORT)
    kept = sorted(p.name for p in own_store.rglob("*.npz"))
    assert kept == ["0.npz"]
    assert not list(own_store.glob("*.nc"))

    calls.clear()

    def counted(target, chain, *rest):
        calls.append(chain)
        return original(target, chain, *rest)

    monkeypatch.setattr(chains, "sample_chain", counted)
    resumed = fits.stored_fit(log, digest, 2, engine=engine, sampler=SHORT)
    assert sorted(calls) == [1, 2]
    for name in TABLES:
        assert np.array_equal(resumed.posterior.table(name), whole.posterior.table(name))
    assert not list(own_store.rglob("*.npz"))


def test_a_resumed_run_counts_the_cpu_time_of_chains_that_were_kept(log, own_store):
    digest = log_digest(log)
    plain = fits.stored_fit(log, digest, 2, sampler=SHORT)
    plain.path.unlink()
    keep = KeptChains(own_store / f"{plain.key}.chains", {}).keep
    for number in range(2):
        made = nuts.sample_chain(StudyDensity(log, ModelSpec(2, STICKY)).density, number, SHORT)
        keep(number, replace(made, cpu_seconds=1000.0))
    resumed = fits.stored_fit(log, digest, 2, sampler=SHORT)
    assert 2000 < resumed.posterior.cpu_seconds < 2060
    assert np.array_equal(resumed.posterior.flat(), plain.posterior.flat())


INTERRUPTED = """
import os, signal, sys, threading, time
from pathlib import Path
from analysis import fits
from models import chains
folder = Path(sys.argv[1])
fits.store_folder = lambda: folder
original = chains.sample_chain

def told(target, chain, *rest):
    sys.stdout.write(f"{chain}\\n")
    return original(target, chain, *rest)

def watch():
    while not list(folder.rglob("*.npz")):
        time.sleep(0.02)
    os.kill(os.getpid(), signal.SIGINT)

chains.sample_chain = told
if not list(folder.rglob("*.npz")):
    threading.Thread(target=watch, daemon=True).start()
from analysis.cli import main
main(["bayes", "simulated_study1", "--states", "2", "--engine", sys.argv[2], *sys.argv[3:]])
"""


@pytest.mark.slow
@pytest.mark.parametrize("engine", ["direct", "pymc"])
def test_ctrl_c_keeps_complete_chains_of_either_engine(engine, tmp_path):
    """A real signal to a real process, after its first chain; the same command then makes only the others."""
    size = ["--draws", "1500", "--tune", "300", "--chains", "6"]
    command = [sys.executable, "-c", INTERRUPTED, str(tmp_path), engine, *size, "--quiet"]
    stopped = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=300)
    assert stopped.returncode == 130, stopped.stderr
    assert "interrupted; completed chains are kept, the same command goes on" in stopped.stderr
    assert "Traceback" not in stopped.stderr
    (folder,) = tmp_path.glob("*.chains")
    kept = {int(path.stem) for path in folder.glob("*.npz")}
    assert 1 <= len(kept) < 6
    assert not list(tmp_path.glob("*.nc"))
    again = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=300)
    assert again.returncode == 0, again.stderr
    assert sorted(again.stdout.split()) == sorted(str(c) for c in range(6) if c not in kept)
    assert [path.suffix for path in tmp_path.iterdir()] == [".nc"]


def test_a_kappa_and_pins_spelled_differently_are_the_same_fit(log):
    digest = log_digest(log)
    first = fits.stored_fit(log, digest, 2, prior=DirichletPrior(stay=2), pins={"help": None}, sampler=SHORT)
    spellings = [
        {"help": np.eye(2)}, {"help": [[1, 0], [0, 1]]}, {"help": np.eye(2, dtype=np.int64)},
        {"help": ((1.0, 0.0), (0.0, 1.0))},
    ]  # fmt: skip
    for pins in spellings:
        again = fits.stored_fit(log, digest, 2, prior=DirichletPrior(stay=2.0), pins=pins, sampler=SHORT)
        assert (again.key, again.reused) == (first.key, True)
    both = [{"help": None, "signal": None}, {"signal": np.eye(2), "help": np.eye(2)}]
    keys = {fits.stored_fit(log, digest, 2, pins=pins, sampler=SHORT).key for pins in both}
    assert len(keys) == 1
    assert keys != {first.key}


def test_thin_groups_are_told_also_of_a_stored_fit(log):
    group = np.arange(log.n_runs) % 2
    group[log.participant <= 3] = 2
    groups = Groups("age", ("old", "young", "rare"), group)
    for reused in (False, True):
        with pytest.warns(SmallGroupWarning, match=r"groups by age: fewer than 10 people in rare \(4\)"):
            assert fits.stored_fit(log, log_digest(log), 2, groups=groups, sampler=SHORT).reused is reused


def test_a_fit_of_an_edited_model_is_kept_and_not_mistaken(log, own_store):
    plain = fits.stored_fit(log, log_digest(log), 2, sampler=SHORT)
    with pytest.raises(InputError, match="found a model that was not edited, wanted one of fit_model"):
        fits.keep_edited(plain.posterior, log, log_digest(log))
    settings = {**plain.posterior.settings, "prior": {"class": EDITED, "model": "initial ~ Dirichlet"}}
    kept = fits.keep_edited(replace(plain.posterior, settings=settings), log, log_digest(log))
    assert kept.key != plain.key
    found = {entry.key: entry for entry in entries()}
    assert (found[kept.key].status, found[plain.key].status) == ("kept", "ready")
    assert kept.key not in [entry.key for entry in to_clear(found.values())]
    assert np.array_equal(read_posterior(kept.path).flat(), plain.posterior.flat())


def made_chain(draws=40, columns=13, **changes):
    """A chain as a run of `SHORT` at two states keeps it (13 unconstrained coordinates), or with a fault."""
    stats = {name: np.zeros(draws) for name in STATS}
    return replace(Chain(np.zeros((draws, columns)), stats, 1.0), **changes)


def half(path):
    path.write_bytes(b"PK\x03\x04 half a file")


def written(chain, number=None):
    def write(path):
        KeptChains(path.parent, {}).keep(int(path.stem), chain)

    return write


DAMAGED = {
    "half a file": (half, "cannot be read"),
    "a folder": (lambda path: (path / "inside").mkdir(parents=True), "cannot be read"),
    "other draws": (written(made_chain(draws=39)), r"draws of shape \(39, 13\), wanted 40 x 13"),
    "other columns": (written(made_chain(columns=12)), r"draws of shape \(40, 12\), wanted 40 x 13"),
    "not finite": (written(made_chain(x=np.full((40, 13), np.nan))), "draws that are not finite"),
    "statistics missing": (written(made_chain(stats={"lp": np.zeros(40)})), "statistics lp, wanted acceptance"),
    "statistics of another length": (
        written(made_chain(stats={name: np.zeros(39) for name in STATS})), r"statistic \w+ of shape \(39,\), "
    ),
    "no time": (written(made_chain(cpu_seconds=float("nan"))), "no CPU time"),
}  # fmt: skip


@pytest.mark.parametrize("kind", DAMAGED)
def test_a_chain_this_run_cannot_have_made_is_told_and_sampled_again(kind, log, own_store):
    digest = log_digest(log)
    first = fits.stored_fit(log, digest, 2, sampler=SHORT)
    first.path.unlink()
    folder = own_store / f"{first.key}.chains"
    folder.mkdir()
    damage, words = DAMAGED[kind]
    damage(folder / "0.npz")
    settings = {**first.posterior.settings, "study": "x", "made_by": fits.maker()}
    (folder / ABOUT).write_text(json.dumps(settings))
    if kind != "other columns":  # that takes the data to tell
        assert [entry.status for entry in entries()] == ["damaged"]
    with pytest.warns(NotKeptWarning, match=rf"0\.npz: not used, this chain is sampled again: {words}"):
        again = fits.stored_fit(log, digest, 2, sampler=SHORT)
    assert np.array_equal(first.posterior.table("initial"), again.posterior.table("initial"))
    assert not folder.exists()


def test_a_chain_of_a_longer_run_is_not_used(log, own_store):
    first = fits.stored_fit(log, log_digest(log), 2, sampler=SHORT)
    first.path.unlink()
    KeptChains(own_store / f"{first.key}.chains", {}).keep(3, made_chain())
    with pytest.warns(NotKeptWarning, match="chain 3 of a run of 3"):
        fits.stored_fit(log, log_digest(log), 2, sampler=SHORT)


def test_a_damaged_fit_in_the_store_is_told_and_made_anew(log):
    stored = fits.stored_fit(log, log_digest(log), 2, sampler=SHORT)
    stored.path.write_bytes(stored.path.read_bytes()[:3000])
    with pytest.warns(
        NotKeptWarning, match=rf"{stored.key}\.nc: (not a read|damaged).*; sampled anew in its place"
    ):
        again = fits.stored_fit(log, log_digest(log), 2, sampler=SHORT)
    assert not again.reused
    assert np.array_equal(again.posterior.flat(), stored.posterior.flat())
    assert fits.stored_fit(log, log_digest(log), 2, sampler=SHORT).reused


def test_a_store_that_cannot_be_written_does_not_cost_the_result(log, own_store):
    own_store.write_text("a file where the folder should be")
    with pytest.warns(NotKeptWarning) as told:
        stored = fits.stored_fit(log, log_digest(log), 2, sampler=SHORT)
    assert "could not be kept" in str(told[0].message)
    assert "the result is not in the store" in str(told[-1].message)
    assert len(told) == 2
    assert stored.posterior.flat().shape[:2] == (3, 40)


CUT_SHORT = """
import resource, signal, sys, warnings
from pathlib import Path
import numpy as np
from analysis.kept_chains import KeptChains
from models.chains import Chain
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (4096, resource.RLIM_INFINITY))
keep = KeptChains(Path(sys.argv[1]), {"study": "x"}).keep
with warnings.catch_warnings(record=True) as told:
    warnings.simplefilter("always")
    for number in range(3):
        keep(number, Chain(np.zeros((5000, 2)), {"diverging": np.zeros(5000)}))
print(*(w.message for w in told), sep="\\n")
"""


def test_a_chain_the_disk_has_no_room_for_is_told_once_and_leaves_no_half_file(tmp_path):
    folder = tmp_path / "key.chains"
    done = subprocess.run(
        [sys.executable, "-c", CUT_SHORT, str(folder)], cwd=ROOT, capture_output=True, text=True, timeout=120
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.splitlines() == [
        f"chain 0 could not be kept: {folder}: File too large; an interruption would lose it"
    ]
    assert [p.name for p in folder.iterdir()] == [ABOUT]


def test_a_run_whose_chains_cannot_be_kept_ends_well(log, own_store, monkeypatch):
    def full(path, content):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(kept_chains, "write_bytes", full)
    with pytest.warns(
        UserWarning, match=r"chain \d could not be kept: .*No space left on device; an inter"
    ) as told:
        stored = fits.stored_fit(log, log_digest(log), 2, sampler=SHORT)
    assert len(told) == 1
    assert [p.name for p in own_store.iterdir()] == [stored.path.name]


def test_clearing_away_chains_somebody_else_clears_away_too(tmp_path, monkeypatch):
    folder = tmp_path / "key.chains"
    chain = made_chain()
    kept = KeptChains(folder, {})
    keep, forget = kept.keep, kept.forget
    forget()  # nothing was ever kept
    keep(0, chain)
    first = Path.unlink

    def raced(self, missing_ok=False):
        first(self)
        return first(self, missing_ok=missing_ok)

    monkeypatch.setattr(Path, "unlink", raced)
    forget()
    assert not folder.exists()
    forget()

    monkeypatch.undo()
    keep(0, chain)
    rmdir = Path.rmdir

    def written_into(self):
        (self / "1.npz").write_bytes(b"of another run")
        rmdir(self)

    monkeypatch.setattr(Path, "rmdir", written_into)
    forget()
    assert [p.name for p in folder.iterdir()] == ["1.npz"]


def test_a_kept_chain_comes_back_bit_for_bit(tmp_path):
    rng = np.random.default_rng(3)
    chain = made_chain(x=rng.normal(size=(40, 2)), stats={name: rng.normal(size=40) for name in STATS})
    kept = KeptChains(tmp_path / "key.chains", {"sampler": vars(NutsSettings(40, 60, 5))}, lambda: 2)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        kept.keep(4, chain)
        done = kept.found()
    assert list(done) == [4]
    assert np.array_equal(done[4].x, chain.x)
    assert {k: v.tolist() for k, v in done[4].stats.items()} == {k: v.tolist() for k, v in chain.stats.items()}


# -- edited models ---------------------------------------------------------------------------------------
def informed(log, scale=1.0):
    """A concentration that is learned, and a term."""
    with build_model(log, 2) as model:
        spread = pm.HalfNormal("spread", scale)
        pm.Potential("around", spread * pt.log(model["initial"]).sum())
    return model


def test_a_model_built_again_has_the_same_digest_and_an_edit_another(log):
    assert model_digest(informed(log)) == model_digest(informed(log))
    models = [
        informed(log), informed(log, 2.0), build_model(log, 2), build_model(log, 3),
        build_model(log, 2, DirichletPrior(stay=3)), build_model(log, 2, pins={"help": None}),
        pm.do(build_model(log, 2), {"initial": np.array([0.5, 0.5])}),
    ]  # fmt: skip
    assert len({model_digest(model) for model in models}) == len(models)


@pytest.mark.slow
def test_an_edited_model_is_found_again_and_goes_on(log, own_store, monkeypatch):
    digest = log_digest(log)
    whole = fits.stored_fit_model(informed(log), log, digest, 2, sampler=SHORT)
    assert fits.stored_fit_model(informed(log), log, digest, 2, sampler=SHORT).reused
    assert [entry.status for entry in entries()] == ["kept"]
    whole.path.unlink()
    original = chains.sample_chain

    def interrupted(target, chain, *rest):
        if chain == 1:
            raise KeyboardInterrupt
        return original(target, chain, *rest)

    monkeypatch.setattr(chains, "sample_chain", interrupted)
    monkeypatch.setattr("os.cpu_count", lambda: 1)
    with pytest.raises(KeyboardInterrupt):
        fits.stored_fit_model(informed(log), log, digest, 2, sampler=SHORT)
    assert [(e.status, e.about["chains_done"]) for e in entries()] == [("interrupted", 1)]
    calls = []

    def counted(target, chain, *rest):
        calls.append(chain)
        return original(target, chain, *rest)

    monkeypatch.setattr(chains, "sample_chain", counted)
    resumed = fits.stored_fit_model(informed(log), log, digest, 2, sampler=SHORT)
    assert 0 not in calls[: calls.index(2) + 1]  # the prior with its term is sampled after that
    assert np.array_equal(resumed.posterior.flat(), whole.posterior.flat())
    assert fits.stored_fit_model(informed(log, 2.0), log, digest, 2, sampler=SHORT).key != whole.key


def test_a_fit_depends_on_all_code_that_makes_it():
    """Priors, layouts, starting points and labels are no kernels, and decide a posterior all the same."""
    reached = {path.name for path in reached_sources([fits.ENGINE])}
    assert reached >= {"parameters.py", "study_density.py", "chains.py", "posterior.py", "gate.py", "protocol.py"}
    assert fits.maker()["sources"] == source_digest(fits.ENGINE)
