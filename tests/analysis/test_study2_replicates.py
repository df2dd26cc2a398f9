"""Replicates of study 2: what a world holds, that workers do not matter, errors of shares, stored evidence."""

import json
from concurrent.futures import CancelledError, ThreadPoolExecutor
from threading import Event

import numpy as np
import pytest

from analysis.cli_options import plain
from analysis.design import published
from analysis.evidence import read_evidence
from analysis.simulate import calibrated_truth
from analysis.study2_claims import CLAIMS
from analysis.study2_evidence import (
    Study2Evidence,
    game_settings,
    reworded,
    sentence_of,
    shown_claims,
    study2_evidence,
)
from analysis.study2_learning import EM, TRUTH
from analysis.study2_policies import LS_POMDP, MORE, PAPER
from analysis.study2_replicates import Study2Replicates, WorldResult, quantities, replicate_study2, run_world
from models.errors import InputError
from models.game.rounds import play_rounds
from models.nuts import NutsSettings
from tests.analysis.study2_cases import instant_rounds
from tests.models.planning.policy_cases import person

TINY = Study2Replicates(
    person(), replicates=6, worlds=2, people=6, study1=60, states=2, sampler=NutsSettings(50, 50, 2), seed=3
)


@pytest.fixture(scope="module", autouse=True)
def instant():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("models.game.rounds.play_rounds", instant_rounds())
        yield


@pytest.fixture(scope="module")
def evidence():
    with ThreadPoolExecutor(1) as pool:
        return study2_evidence(TINY, published(), executor=pool)


def test_a_world_holds_every_planner(evidence):
    for kind, planners in ((EM, (LS_POMDP, *MORE)), (TRUTH, (LS_POMDP, MORE[0]))):
        for world in evidence.worlds[kind]:
            assert tuple(world.claims) == planners
            for planner in planners:
                assert world.claims[planner].shape == (3, len(CLAIMS))
                assert world.numbers[planner].shape == (3, len(evidence.printed))
            assert world.means["costly_actions"].shape == (len(evidence.settings[kind].policies),)


def test_a_world_depends_on_its_index_only(evidence):
    for kind in (EM, TRUTH):
        again = run_world(evidence.settings[kind], 1)
        for planner, held in evidence.worlds[kind][1].claims.items():
            assert np.array_equal(again.claims[planner], held)
            assert np.array_equal(again.numbers[planner], evidence.worlds[kind][1].numbers[planner], equal_nan=True)
    assert not np.array_equal(
        evidence.worlds[EM][0].numbers[LS_POMDP], evidence.worlds[EM][1].numbers[LS_POMDP], equal_nan=True
    )


def test_workers_do_not_matter(evidence):
    found = replicate_study2(evidence.settings[TRUTH])
    for one, other in zip(found, evidence.worlds[TRUTH], strict=True):
        assert np.array_equal(one.claims[LS_POMDP], other.claims[LS_POMDP])
        assert one.means["reward"] == pytest.approx(other.means["reward"], abs=0)


def test_learning_differs_between_worlds_and_what_the_robot_knows_does_not(evidence):
    never = TINY.policies.index("never")
    for kind in (EM, TRUTH):
        assert all(w.means["costly_actions"][never] == 0 for w in evidence.worlds[kind])
    # With the truth known the means of a world differ by chance only, and every world has the same policies.
    assert len({tuple(w.claims) for w in evidence.worlds[TRUTH]}) == 1


def test_giving_up_is_heard():
    stop = Event()
    stop.set()
    with pytest.raises(CancelledError):
        run_world(TINY, 0, stop=stop)


def made_up(holds):
    """Evidence whose claims are given: ``[world, study]`` for every one of them."""
    worlds, studies = holds.shape
    settings = Study2Replicates(person(), replicates=worlds * studies, worlds=worlds)
    result = [
        WorldResult(
            {p: np.repeat(h[:, None], len(CLAIMS), axis=1) for p in settings.planners},
            {p: np.zeros((studies, 17)) for p in settings.planners},
            {"observation": np.zeros(8), "costly_actions": np.zeros(8)}, 0, (),
        )
        for h in holds
    ]  # fmt: skip
    return Study2Evidence({EM: settings}, {EM: tuple(result)}, quantities(published()))


def test_the_stored_words_are_those_of_the_code():
    """Names, remarks and sentence of the stored file follow from its numbers; no number is said elsewhere."""
    stored = read_evidence("study2").content
    assert reworded(stored) == stored
    printed = {r["claim"]: r["printed"] for r in stored["claims"]}
    assert printed["team-reactive"] == "in the text; .01 in the table"
    assert printed["team"] == "in the text; reactive .01 in the table"
    assert printed["all"] != "yes"


def test_what_the_fit_decides_has_no_share(evidence):
    content = plain(evidence.to_dict())
    rows = shown_claims(content).set_index(["learning", "planner", "claim"])
    for planner in (LS_POMDP, *MORE):
        own = rows.loc[(EM, planner, "belief")]
        assert np.isnan(own[["share", "se", "low", "high"]].astype(float)).all()
        assert own["name"] == "belief rises faster (not decidable)"
    assert rows.loc[(TRUTH, LS_POMDP, "belief"), "share"] == evidence.share(TRUTH, LS_POMDP, "belief")
    assert rows["share"].isna().sum() == len((LS_POMDP, *MORE))
    shares = [
        world.claims[LS_POMDP].mean(axis=0)[content["claim_keys"].index("belief")] for world in evidence.worlds[EM]
    ]
    none, every = shares.count(0.0), shares.count(1.0)
    assert f"of 2 such robots {none} lead to it in no study and {every} in every one" in evidence.sentence
    assert "belief rises faster (not decidable)" in evidence.sentence


def test_worlds_with_warnings_are_counted(evidence):
    many = sum(bool(w.notes) for w in evidence.worlds[EM])
    assert many, "so few draws fail their gate"
    assert f"In {many} of 2 worlds something that was learned carries a warning" in evidence.sentence
    assert "Only Bayes-adaptive and cautious rest on posteriors" in evidence.sentence
    content = evidence.to_dict()
    assert "warning" not in sentence_of({**content, "worlds_with_notes": {EM: 0, TRUTH: 0}})


def test_errors_are_those_of_means_over_worlds():
    holds = np.random.default_rng(1).random((10, 20)) < np.linspace(0.1, 0.9, 10)[:, None]
    row = made_up(holds).claim_rows()[0]
    assert row["share"] == holds.mean()
    assert row["se"] == pytest.approx(holds.mean(axis=1).std(ddof=1) / np.sqrt(10))
    assert row["low"] < row["share"] < row["high"]
    # Far wider than if the studies were independent.
    assert row["high"] - row["low"] > 2 * 1.96 * np.sqrt(0.25 / 200)


@pytest.mark.parametrize("share", [0.0, 1.0])
def test_studies_that_all_agree_are_as_many_as_their_worlds(share):
    row = made_up(np.full((10, 20), bool(share))).claim_rows()[0]
    assert (row["share"], row["se"]) == (share, 0.0)
    assert row["high"] - row["low"] == pytest.approx(0.2775, abs=1e-3)  # Wilson, none of 10


def test_rows_say_what_they_are_of(evidence):
    rows = evidence.claim_rows()
    assert len(rows) == (4 + 2) * (len(CLAIMS) + 1)
    for row in rows[: len(CLAIMS)]:
        assert row["share"] == evidence.share(EM, LS_POMDP, row["claim"])
    together = next(r for r in rows if r["claim"] == "all")
    parts = [r["share"] for r in rows[: len(CLAIMS)] if r["whole"]]
    assert together["share"] <= min(parts)
    numbers = {(r["learning"], r["planner"], r["number"]): r for r in evidence.number_rows()}
    row = numbers[TRUTH, LS_POMDP, "difference team_performance, never"]
    assert row["printed"] == -12.96
    assert row["q05"] <= row["q50"] <= row["q95"]
    means = {(r["learning"], r["policy"], r["measure"]): r for r in evidence.mean_rows()}
    assert means[EM, "always", "costly_actions"]["mean"] == 9
    assert len({p for k, p, _ in means if k == TRUTH}) == len(PAPER) + 1


def test_the_printed_quantities_are_the_papers():
    found = quantities(published())
    assert len(found) == 9 + 8
    assert found["F team_performance, policy"] == 9.8314
    assert found["F cumulative_tokens, policy:time"] == 5.039
    assert found["difference observation, myopic"] == -0.18


def test_the_result_goes_into_a_file(evidence):
    content = json.loads(json.dumps(plain(evidence.to_dict()), allow_nan=False))
    assert content["settings"][EM]["worlds"] == 2
    assert content["game"] == plain(game_settings())
    assert np.array(content["by_world"][TRUTH][LS_POMDP]).shape == (2, len(CLAIMS))
    assert "simulated studies 2" in content["sentence"]
    assert content["missed"] == {EM: 0, TRUTH: 0}


@pytest.mark.parametrize(
    ("change", "match"),
    [
        ({"kind": "guess"}, "kind of learning: found 'guess'"),
        ({"replicates": 7}, "replicates: found 7, wanted a multiple of 2 worlds"),
        ({"worlds": 1}, "worlds: found 1"),
        ({"people": 1}, "people: found 1"),
        ({"seed": -1}, "seed: found -1"),
    ],
)
def test_settings_that_are_none(change, match):
    values = {"replicates": 6, "worlds": 2, **change}
    with pytest.raises(InputError, match=match):
        Study2Replicates(person(), **values)


@pytest.mark.slow
def test_stored_evidence_can_be_repeated(monkeypatch):
    """One world of it, where present code and game made it."""
    monkeypatch.setattr("models.game.rounds.play_rounds", play_rounds)
    found = read_evidence("study2")
    if found is None:
        pytest.skip("no evidence of study 2 is stored")
    if found.stale or found.content["game"] != plain(game_settings()):
        pytest.skip("stored evidence is stale: the report says so")
    own = found.content["settings"][TRUTH]
    settings = Study2Replicates(
        calibrated_truth(), TRUTH, own["replicates"], own["worlds"], own["people"], seed=found.content["seed"]
    )
    again = run_world(settings, 0)
    for planner, held in again.claims.items():
        assert held.mean(axis=0).tolist() == pytest.approx(found.content["by_world"][TRUTH][planner][0], abs=1e-12)
