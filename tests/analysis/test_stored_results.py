"""Results found again: equal bit for bit, never of other code, other arguments or a damaged file."""

import json
import os
import time
import warnings
from dataclasses import dataclass, field
from enum import Enum
from fractions import Fraction
from functools import cached_property, partial
from pathlib import Path
from types import MappingProxyType
from typing import NamedTuple

import hypothesis.extra.numpy as arrays_of
import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import sparse

from analysis import fits, result_content, source_digest, stored_results
from analysis.datasets import log_digest
from analysis.fits_inventory import entries, remove, to_clear
from analysis.kept_chains import NotKeptWarning
from analysis.report.build import build_report
from analysis.report.drawings import Drawings
from analysis.report.effort import Effort
from analysis.report.fitting import fit_models
from analysis.report.registry import SECTIONS
from analysis.report.section import Figure, Origin
from analysis.result_content import Given, NotContent, to_content
from analysis.result_reading import from_content
from analysis.stored_results import found_or_made, read_about, stored_result
from models.nuts import NutsSettings
from models.planning.schedule import Schedule
from models.protocol import PUBLISHED
from models.reward import Reward
from models.simulation import simulate_responses
from tests.analysis.report_cases import data_set, little_effort, random_log
from tests.models.test_recovery import truth, varied_design


@pytest.fixture(autouse=True)
def store(tmp_path, monkeypatch):
    monkeypatch.setattr(fits, "store_folder", lambda: tmp_path / "fits")
    # The classes and functions of this file stand for some of the checkout.
    monkeypatch.setattr(result_content, "PACKAGES", ("models", "analysis", "tests"))
    monkeypatch.setattr("analysis.result_reading.PACKAGES", ("models", "analysis", "tests"))
    monkeypatch.setattr(source_digest, "PACKAGES", ("models", "analysis", "tests"))
    return tmp_path / "fits"


class Mood(Enum):
    HELPFUL = 1
    BUSY = 2


class Pair(NamedTuple):
    low: float
    high: float


@dataclass(frozen=True)
class Study:
    draws: np.ndarray
    table: pd.DataFrame
    parts: tuple = ()
    settings: dict = field(default_factory=dict)

    @cached_property
    def mean(self):
        return self.draws.mean()


class Plain:
    __slots__ = ("left", "right")

    def __init__(self):
        self.left, self.right = [1, 2], self


CALLS = []


def study_of(draws, scale, progress=None, executor=None):
    CALLS.append(scale)
    return Study(draws, pd.DataFrame({"x": draws * scale}), (draws,), {"scale": scale})


class Odd(np.ndarray):
    """An array of another class."""


OTHER = np.arange(3.0).view(Odd)


def np_generator(seed):
    return np.random.default_rng(seed)


def there_and_back(value, source=None):
    source = source or Given({})
    content, arrays = to_content(value, source)
    return from_content(json.loads(json.dumps(content)), arrays, source)


def digest(value):
    return Given({"value": value}).digest


# -- content ---------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    "value",
    [
        None, True, 3, -0.0, 0.1 + 0.2, 5e-324, float("inf"), "é\u2212\n", 10**40, b"\x00\xff", (), (1, (2.0, "x")),
        [None, [True]], {"a": 1, 2: (3,), (4, None): "b"}, {1, 2}, frozenset({"a", "b"}), Fraction(-1, 3),
        Path("a/b"), Mood.BUSY, Pair(0.1, 0.2), np.float32(0.1), np.int8(-3), np.bool_(True), np.str_("é"),
        MappingProxyType({"a": 1}), partial(study_of, scale=2.0), study_of, Study, float, Pair(1, 2)._asdict(),
    ],
)  # fmt: skip
def test_values_come_back_as_they_were(value):
    again = there_and_back(value)
    assert type(again) is type(value)
    if isinstance(value, partial):
        assert (again.func, again.args, again.keywords) == (value.func, value.args, value.keywords)
    else:
        assert again == value
        assert repr(again) == repr(value)


@given(arrays_of.arrays(
    st.sampled_from(["f8", "f4", "i8", "i1", "u2", "?", "<U3", "c16", "M8[s]"]),
    arrays_of.array_shapes(min_dims=0, max_dims=4, min_side=0, max_side=4),
), st.randoms())  # fmt: skip
def test_arrays_come_back_bit_for_bit_and_lie_in_memory_as_they_did(array, random):
    axes = list(range(array.ndim))
    random.shuffle(axes)
    array = array.transpose(axes)
    again = there_and_back(array)
    assert (again.dtype, again.shape, again.tobytes()) == (array.dtype, array.shape, array.tobytes())
    assert again.flags.writeable == array.flags.writeable
    if array.size:
        assert np.argsort(np.abs(again.strides)).tolist() == np.argsort(np.abs(array.copy("K").strides)).tolist()


def test_a_sum_of_what_came_back_is_the_same_bit_for_bit():
    array = np.random.default_rng(1).lognormal(0, 9, (301, 77)).T
    assert there_and_back(array).sum() == array.sum()
    assert (there_and_back(array).sum(axis=0) == array.sum(axis=0)).all()


@pytest.mark.parametrize(
    "table",
    [
        pd.DataFrame({"x": [0.1, np.nan], "n": [1, 2], "word": ["a", None], "yes": [True, False]}),
        pd.DataFrame({"o": np.array([1, "a"], dtype=object), "c": pd.Categorical(["b", "a"], ["b", "a"], True)}),
        pd.DataFrame({("a", 1): [1.0], ("b", 2): [2.0]}),
        pd.DataFrame([[1, 2.0], [3, 4.0]], columns=["same", "same"], index=pd.Index(["r", "s"], name="row")),
        pd.DataFrame({"x": [1.0, 2.0]}, index=pd.MultiIndex.from_tuples([("a", 1), ("a", 2)], names=["p", None])),
        pd.DataFrame(columns=["nothing"]), pd.DataFrame(index=[3, 4]),
        pd.DataFrame({"old": np.array(["a", "b"], dtype=object)}),
    ],
)  # fmt: skip
def test_tables_come_back(table):
    again = there_and_back(table)
    pd.testing.assert_frame_equal(again, table, check_exact=True)
    assert [c.dtype for _, c in again.items()] == [c.dtype for _, c in table.items()]
    assert type(again.index) is type(table.index)
    for name in dict.fromkeys(table.columns):
        if isinstance(table[name], pd.Series):
            pd.testing.assert_series_equal(there_and_back(table[name]), table[name], check_exact=True)


def test_sparse_arrays_come_back_with_their_own_types():
    made = sparse.csr_array(np.array([[0.0, 2.0], [3.0, 0.0]]))
    made.indices = made.indices.astype(np.int64)
    again = there_and_back(made)
    assert again.indices.dtype == np.int64
    assert (again.toarray() == made.toarray()).all()


def test_objects_that_lead_back_to_themselves_and_shared_parts():
    plain = there_and_back(Plain())
    assert plain.right is plain
    shared = np.arange(3.0)
    study = there_and_back(Study(shared, pd.DataFrame({"x": shared}), (shared, [shared])))
    assert study.parts[0] is study.draws
    assert study.parts[1][0] is study.draws


def test_what_was_worked_out_for_later_is_left_out_and_determines_nothing():
    study = Study(np.arange(3.0), pd.DataFrame())
    before = digest(study)
    assert study.mean == 1.0
    assert digest(study) == before
    assert "mean" not in vars(there_and_back(study))


def test_parts_of_what_a_result_is_computed_from_are_not_kept_again():
    draws = np.arange(1e5)
    source = Given({"args": ([Pair(1.0, 2.0), {"deep": (draws,)}],)})
    content, arrays = to_content(Study(draws, pd.DataFrame()), source)
    assert sum(a.nbytes for a in arrays) == 0
    other = Given({"args": ([Pair(1.0, 2.0), {"deep": (draws.copy(),)}],)})
    assert other.digest == source.digest
    assert from_content(content, arrays, other).draws is other.value["args"][0][1]["deep"][0]


@pytest.mark.parametrize(
    "value", [lambda: 1, np.random.default_rng(1), open, (i for i in ()), {"deep": [object()]}, json.JSONEncoder()]
)
def test_what_has_no_content_is_refused_by_its_place(value):
    with pytest.raises(NotContent):
        to_content(value, Given({}))
    with pytest.raises(NotContent, match=r"\.draws"):
        to_content(Study(value, pd.DataFrame()), Given({}))


def test_names_outside_the_checkout_are_not_followed(monkeypatch):
    for name in ("os:system", "subprocess:Popen", "builtins:eval"):
        with pytest.raises((ValueError, StopIteration)):
            from_content(["named", name], [], Given({}))
    for content in (
        ["system", "x"],
        ["array", 7, [], True],
        ["given", [["attribute", "no"]]],
        ["again", 9],
        ["__init__"],
    ):
        with pytest.raises(ValueError, match="no content of a result"):
            from_content(content, [], Given({}))


def test_digests_tell_values_apart_and_not_how_they_lie_in_memory():
    values = [1, 1.0, True, "1", (1,), [1], {1: 1}, {1}, np.int64(1), np.array(1), np.array([1]), np.array([1.0]),
              None, "", (), Mood.HELPFUL, Reward((0.0, 1.0)), Reward((0.0, 2.0)), Pair(1, 1), {"a": 1, "b": 2},
              {"b": 2, "a": 1}, b"1", Fraction(1), study_of, there_and_back]  # fmt: skip
    assert len({digest(v) for v in values}) == len(values)
    array = np.arange(6.0).reshape(2, 3)
    assert digest(array) == digest(np.asfortranarray(array)) == digest(array[:, ::-1][:, ::-1])


# -- source code -----------------------------------------------------------------------------------
@pytest.fixture
def checkout_of_two(tmp_path, monkeypatch):
    """A checkout in which a module imports another one, within a function, which reads a file."""
    (tmp_path / "models").mkdir()
    (tmp_path / "data").mkdir()
    (tmp_path / "models/a.py").write_text("def f():\n    from models import (\n        b,\n    )\n")
    (tmp_path / "models/b.py").write_text("import models.c as c\n")
    (tmp_path / "models/c.py").write_text("X = 1\n")
    (tmp_path / "models/apart.py").write_text("Y = 1\n")
    (tmp_path / "data/printed.json").write_text("1")
    monkeypatch.setattr(source_digest, "_ROOT", tmp_path)
    monkeypatch.setattr(source_digest, "READS", {"models/c.py": "data"})
    yield tmp_path
    forget()


def forget():
    for kept in (source_digest.source_digest, source_digest._text, source_digest._source, source_digest._imported):
        kept.cache_clear()


def fresh_digest(*modules):
    forget()
    return source_digest.source_digest(*modules)


@pytest.mark.parametrize("edited", ["models/a.py", "models/b.py", "models/c.py", "data/printed.json"])
def test_an_edit_anywhere_within_reach_is_other_code(edited, checkout_of_two):
    before = fresh_digest("models.a")
    (checkout_of_two / "models/apart.py").write_text("Y = 2\n")
    assert fresh_digest("models.a") == before
    (checkout_of_two / edited).write_text((checkout_of_two / edited).read_text() + " ")
    assert fresh_digest("models.a") != before
    with pytest.raises(ModuleNotFoundError):
        fresh_digest("models.none")
    with pytest.raises(ValueError, match="no module"):
        fresh_digest()


def test_code_edited_under_a_running_process_shares_no_key_with_others(checkout_of_two, monkeypatch):
    """A notebook's kernel goes on with the old formula after the file has the new one."""
    monkeypatch.setattr(source_digest, "BEGAN", time.time() + 60)
    plain = fresh_digest("models.a")
    monkeypatch.setattr(source_digest, "_THIS_PROCESS", b"another process")
    assert fresh_digest("models.a") == plain
    os.utime(checkout_of_two / "models/c.py", (0, time.time() + 120))
    own = fresh_digest("models.a")
    assert own != plain
    monkeypatch.setattr(source_digest, "_THIS_PROCESS", b"one more")
    assert fresh_digest("models.a") not in (own, plain)
    assert fresh_digest("models.apart") == fresh_digest("models.apart")


def test_every_source_that_reads_a_file_of_the_checkout_says_so(checkout):
    fresh_digest("models.protocol")
    makes_pages = {"analysis/report/render.py", "analysis/figures/reward_slider.py", "analysis/game_player.py",
                   "analysis/play/server.py", "analysis/notebooks.py", "analysis/belief_explorer.py"}  # fmt: skip
    keeps_things = {"analysis/fits.py", "models/compiled.py", "analysis/source_digest.py"}
    given_as_arguments = {"analysis/evidence.py"}
    for_notebooks_only = {"analysis/workbench.py"}
    sources = [
        path
        for folder in ("models", "analysis")
        for path in (checkout / folder).rglob("*.py")
        if path.parent.name != "bench"
    ]
    words = ("__file__", "DATA_FOLDER", "importlib.resources")
    places = {p.relative_to(checkout).as_posix() for p in sources if any(w in p.read_text() for w in words)}
    assert places <= {*source_digest.READS} | makes_pages | keeps_things | given_as_arguments | for_notebooks_only
    for source, read in source_digest.READS.items():
        assert (checkout / source).is_file()
        assert (checkout / read).exists()


# -- the store -------------------------------------------------------------------------------------
def test_a_result_is_found_again_and_is_the_same(store):
    CALLS.clear()
    draws = np.random.default_rng(1).random((5, 3))[:, 0]
    first = stored_result("a study", study_of, draws, 2.0, progress=print)
    again = stored_result("a study", study_of, draws.copy(), 2.0)
    assert (first.reused, again.reused, CALLS) == (False, True, [2.0])
    assert digest(first.value) == digest(again.value)
    assert first.value.draws is draws
    assert first.path == again.path
    assert read_about(first.path)["what"] == "a study"


def test_every_argument_has_its_own_key_and_neither_progress_nor_executor():
    CALLS.clear()
    draws = np.arange(3.0)
    stored_result("a study", study_of, draws, 2.0)
    assert stored_result("in other words", study_of, draws, 2.0, progress=print, executor=object()).reused
    for other in ((draws, 3.0), (draws, 2), (draws + 1, 2.0), (draws.astype("f4"), 2.0)):
        assert not stored_result("a study", study_of, *other).reused


def test_other_code_and_other_versions_are_not_found_again(monkeypatch):
    draws = np.arange(3.0)
    stored_result("a study", study_of, draws, 2.0)
    with monkeypatch.context() as patch:
        patch.setattr(stored_results, "source_digest", lambda *modules: "of other code")
        assert not stored_result("a study", study_of, draws, 2.0).reused
    with monkeypatch.context() as patch:
        patch.setattr(stored_results, "_versions", lambda: {"numpy": "0"})
        assert not stored_result("a study", study_of, draws, 2.0).reused
    assert stored_result("a study", study_of, draws, 2.0).reused


def test_the_code_of_what_is_given_counts(monkeypatch):
    seen = []
    monkeypatch.setattr(stored_results, "source_digest", lambda *modules: seen.append(modules) or "code")
    found_or_made("x", lambda: 1, study_of, {"reward": Reward((0.0, 1.0)), "how": partial(digest, 1)})
    assert set(seen[0]) == {__name__, "models.reward"}


@pytest.mark.parametrize("damage", ["truncated", "empty", "flipped", "other arrays", "of another kind"])
def test_a_damaged_result_is_told_and_computed_anew(damage):
    CALLS.clear()
    draws = np.arange(300.0)
    first = stored_result("a study", study_of, draws, 2.0)
    whole = first.path.read_bytes()
    if damage == "of another kind":
        np.savez(first.path, x=np.arange(3))
    elif damage == "other arrays":  # a sound file whose content is not what its seal says
        with np.load(first.path) as file:
            content = {name: file[name] for name in file.files}
        content["array_0"] = content["array_0"] + 1
        np.savez(first.path, **content)
    else:
        middle = len(whole) // 2
        flipped = whole[:middle] + bytes([whole[middle] ^ 1]) + whole[middle + 1 :]
        first.path.write_bytes({"truncated": whole[:-40], "empty": b"", "flipped": flipped}[damage])
    with pytest.warns(NotKeptWarning, match=r"damaged .*computed anew in its place"):
        again = stored_result("a study", study_of, draws, 2.0)
    assert (again.reused, CALLS) == (False, [2.0, 2.0])
    assert first.path.read_bytes() == whole
    assert stored_result("a study", study_of, draws, 2.0).reused


def test_a_store_that_cannot_be_written_does_not_cost_the_result(store):
    store.write_text("a file where the folder belongs")
    with pytest.warns(NotKeptWarning, match="cannot be written"):
        made = stored_result("a study", study_of, np.arange(3.0), 2.0)
    assert made.value.settings == {"scale": 2.0}


def test_what_cannot_be_kept_is_told_and_returned(store):
    with pytest.warns(NotKeptWarning, match=r"a study: cannot be kept \(\[0\]\[0\]: Odd holds more"):
        made = stored_result("a study", study_of, OTHER, 2.0)
    assert (made.reused, made.path, made.value.draws) == (False, None, OTHER)
    with pytest.warns(NotKeptWarning, match=r"a study: cannot be kept \(.*Generator"):
        assert isinstance(stored_result("a study", np_generator, 1).value, np.random.Generator)
    assert not list(store.glob("*"))


def test_a_computation_that_fails_leaves_nothing(store):
    with pytest.raises(TypeError):
        stored_result("a study", study_of, "no draws", 2.0)
    assert not list(store.glob("*"))


def test_results_unused_for_longest_make_room(monkeypatch, store):
    monkeypatch.setattr(stored_results, "MOST_BYTES", 25_000)
    monkeypatch.setattr(stored_results, "_since_cleared", 0)
    (store / "x.chains").mkdir(parents=True)
    (store / "mine.nc").write_bytes(bytes(50_000))
    made = []
    for i in range(6):
        made.append(found_or_made(str(i), lambda: np.arange(1000.0), study_of, {"i": i}).path)
        for age, path in enumerate(reversed(made)):
            if path.is_file():
                times = 1e9 - age
                stored_results.os.utime(path, (times, times))
    assert [path.is_file() for path in made] == [False] * 4 + [True] * 2
    assert (store / "mine.nc").is_file()
    assert (store / "x.chains").is_dir()


def test_results_are_listed_and_cleared_with_the_fits(store, monkeypatch):
    draws = np.arange(3.0)
    stored_result("a study", study_of, draws, 2.0)
    found_or_made("figure x", lambda: (b"svg", None), study_of, {}, kind="drawing")
    with monkeypatch.context() as patch:
        patch.setattr(stored_results, "source_digest", lambda *modules: "of other code")
        stored_result("an old study", study_of, draws, 2.0)
    (store / "damaged.npz").write_bytes(b"PK")
    (store / ".dead.npz.x1.npz").write_bytes(b"half")
    stored_results.os.utime(store / ".dead.npz.x1.npz", (0, 0))
    (store / ".alive.npz.x2.npz").write_bytes(b"being written")
    found = {(e.kind, e.status, e.about.get("what")) for e in entries()}
    assert found == {
        ("result", "ready", "a study"), ("drawing", "ready", "figure x"), ("result", "outdated", "an old study"),
        ("result", "damaged", None), ("result", "left over", None),
    }  # fmt: skip
    for entry in to_clear(entries()):
        remove(entry)
    assert {e.status for e in entries()} == {"ready"}
    assert (store / ".alive.npz.x2.npz").exists()


# -- what reports keep -----------------------------------------------------------------------------
def test_a_search_and_its_bootstraps_come_back_bit_for_bit():
    rng = np.random.default_rng(2)
    log = simulate_responses(truth(), varied_design(60, 4, rng), rng)[0]
    effort = Effort(True, 6, 3, 20)
    plain = fit_models(log, (1, 2), effort, pins={}, seed=1)
    first, again = (stored_result("search", fit_models, log, (1, 2), effort, pins={}, seed=1) for _ in range(2))
    assert (first.reused, again.reused) == (False, True)
    assert digest(first.value) == digest(again.value)
    assert again.value.log is log
    for k in (1, 2):
        assert digest(plain.fits[k]) == digest(again.value.fits[k])
    assert digest(plain.bootstraps) == digest(again.value.bootstraps)
    assert not stored_result("search", fit_models, log, (1, 2), effort, pins={}, seed=2).reused


def test_what_follows_from_a_posterior_has_one_key_whether_it_was_sampled_or_read():
    rng = np.random.default_rng(2)
    log = simulate_responses(truth(), varied_design(60, 4, rng), rng)[0]
    first, again = (fits.stored_fit(log, log_digest(log), 2, sampler=NutsSettings(40, 60, 2)) for _ in range(2))
    assert (first.reused, again.reused) == (False, True)
    assert digest(first.posterior) == digest(again.posterior)
    assert digest(first.posterior.draws()) == digest(again.posterior.draws())


def test_a_study_of_a_schedule_does_not_hold_its_draws_again():
    from analysis.safeguard_study import safeguard_study
    from models.model_draws import ModelDraws

    schedule = Schedule.of(ModelDraws.from_models([truth()] * 3), "HRH")
    first, again = (stored_result("safeguards", safeguard_study, schedule) for _ in range(2))
    assert (first.reused, again.reused) == (False, True)
    assert again.value.schedule is schedule
    assert digest(first.value) == digest(again.value)
    assert again.value.sentences == safeguard_study(schedule).sentences


def drawn(heights, colour="k"):
    from analysis.figures.style import axes

    made = axes()
    made.bar(range(len(heights)), heights, color=colour)
    return made


def figure(panel):
    return Figure("x", (panel,), "Heights.", ("Bars.",), (Origin.DEFINITION,))


def test_a_figure_is_drawn_once_for_the_same_numbers():
    once, again, other = (Drawings(pictures=True) for _ in range(3))
    first = once.of(figure(partial(drawn, np.array([1.0, 2.0]))))
    assert again.of(figure(partial(drawn, np.array([1.0, 2.0])))) == first
    assert other.of(figure(partial(drawn, np.array([1.0, 2.5])))) != first
    assert [d.found["x"] for d in (once, again, other)] == [False, True, False]
    without = Drawings()
    assert without.of(figure(partial(drawn, np.array([1.0, 2.0]))))[0].png is None
    assert not without.found["x"]


def test_a_figure_of_a_nameless_function_is_drawn_and_not_kept(store):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        panels = [Drawings().of(figure(lambda: drawn([1.0])))[0] for _ in range(2)]
    assert panels[0] == panels[1]
    assert not list(store.glob("*"))


def test_a_report_from_the_store_is_the_same_to_the_byte(tmp_path, monkeypatch):
    little_effort(monkeypatch)
    some = [entry for entry in SECTIONS if entry.key in ("states", "plan")]
    folders = tmp_path / "computed", tmp_path / "found"
    made = [
        build_report(
            data_set(random_log(PUBLISHED)), states="2", quick=True, out=folder, parts=True, sections=some,
            date="2026-01-31",
        )
        for folder in folders
    ]  # fmt: skip
    assert len(made[0].found) == 2
    assert [set(r.found.values()) | set(r.drawn_before.values()) for r in made] == [{False}, {True}]
    files = [{p.relative_to(f): p.read_bytes() for p in f.rglob("*") if p.is_file()} for f in folders]
    assert len(files[0]) > 10
    assert files[0] == files[1]
