"""The paper's conclusions as functions of one study: they hold of studies like the paper's, and of no others."""

import numpy as np
import pytest

from analysis.anova import mixed_anova
from analysis.design import published
from analysis.posthoc import tukey
from analysis.study2_claims import CLAIMS, MEASURED, Facts, as_printed, check_claims, tukey_t
from analysis.study2_outcomes import OBSERVED, TEAM, first_and_last, person_values
from analysis.study2_policies import EXACT, LS_POMDP, PAPER
from tests.analysis.study2_cases import made_up, random_study

TEXT = {c.key: c for c in CLAIMS}


def like_the_papers(seed, each=20, **change):
    """A study that has what the paper reports: policies differ from the start, and everybody grows alike."""
    rng = np.random.default_rng(seed)
    policy = np.arange(5 * each) % 5
    level = np.array(change.get("level", [60, 60, 47, 54, 55]))[policy][:, None]
    team = level + np.linspace(-4, 4, 9) + rng.normal(size=(5 * each, 9)) * 2.5
    rates = np.array(change.get("rates", [0.99, 0.95, 0.66, 0.64, 0.97]))[policy][:, None]
    helped = rng.random((5 * each, 5)) < np.clip(rates + np.linspace(-0.12, 0.12, 5), 0, 1)
    believed = np.array(change.get("believed", [0.8, 0.7, 0.3, 0.3, 0.5]))[policy][:, None]
    believed = np.clip(believed + 0.05 * rng.normal(size=(5 * each, 9)), 0, 1)
    return made_up(team.round().astype(int), helped, believed, costly=change.get("costly", [4, 9, 0, 0, 4]))


def holding(key, tries=200, **change):
    """Whether some study of this kind leads to a conclusion."""
    return any(check_claims(like_the_papers(seed, **change))[key] for seed in range(tries))


def test_a_study_like_the_papers_leads_to_its_conclusions():
    """Each sentence comes out of some such study; chance decides of the conclusions about "not significantly"."""
    for claim in CLAIMS:
        assert holding(claim.key), claim.key


@pytest.mark.parametrize(
    ("key", "change"),
    [
        ("team-never", {"level": [50, 50, 50, 50, 50]}),
        ("team-reactive", {"level": [60, 60, 47, 54, 66]}),
        ("team-always", {"level": [50, 60, 47, 54, 55]}),
        ("team", {"level": [60, 60, 60, 54, 55]}),
        ("myopic-never", {"level": [60, 60, 54, 47, 55]}),
        ("help-never", {"rates": [0.6, 0.95, 0.66, 0.64, 0.97]}),
        ("help-always", {"rates": [0.6, 0.95, 0.66, 0.64, 0.97]}),
        ("help", {"rates": [0.6, 0.95, 0.66, 0.64, 0.97]}),
        ("belief", {"believed": [0.3, 0.7, 0.3, 0.3, 0.5]}),
        ("costly", {"costly": [9, 9, 0, 0, 4]}),
        ("policy-team_performance", {"level": [50, 50, 50, 50, 50]}),
    ],
)
def test_a_study_unlike_it_does_not(key, change):
    assert np.mean([check_claims(like_the_papers(seed, **change))[key] for seed in range(20)]) <= 0.1


def test_interactions_of_the_team_spoil_the_one_that_is_claimed():
    study = like_the_papers(1)
    tilted = study.team + 3 * (study.policy[:, None] == 0) * np.linspace(-2, 2, 9)
    other = made_up(tilted.round().astype(int), study.helped, costly=[4, 9, 0, 0, 4])
    held = check_claims(other)
    assert not held["interaction-no-team_performance"]
    assert not held["interaction"]


@pytest.mark.parametrize("seed", [1, 2, 2624])
def test_facts_are_those_of_the_tests_that_are_shown(seed):
    """The same means and tests as are shown, at the levels of the conclusions; the last study has an F of zero."""
    study = random_study(seed)
    facts = Facts.of(study)
    for key in MEASURED:
        for row in mixed_anova(first_and_last(study, key)).table.itertuples():
            assert facts.f[key, row.effect] == max(row.f, 0.0)
            assert facts.p[key, row.effect] == (row.p if row.f > 0 else 1.0)
    for key in (TEAM, OBSERVED):
        for row in tukey(person_values(study, key)).table.itertuples():
            assert facts.difference(key, row.reference, row.group) == pytest.approx(row.difference, abs=1e-12)
            for level in (0.05, 0.01, 0.001):
                assert facts.differs(key, row.reference, level, row.group) == (row.p < level)
                above = row.p < level and row.difference > 0
                assert facts.above(key, row.reference, level, row.group) == above


def test_cells_that_differ_by_nothing_have_no_effect():
    assert Facts.of(random_study(2624)).p[OBSERVED, "policy:time"] == 1.0


def test_a_whole_sentence_is_all_of_its_parts():
    for seed in range(30):
        held = check_claims(like_the_papers(seed))
        team = [held[f"team-{p}"] for p in ("never", "reactive", "myopic", "always")]
        assert held["team"] == all(team)
        helped = [held[f"help-{p}"] for p in ("never", "myopic", "always", "reactive")]
        assert held["help"] == all(helped)
        mains = [held[f"{e}-{k}"] for k in MEASURED for e in ("policy", "time")]
        assert held["main-effects"] == all(mains)


def test_where_nobody_differs_nothing_is_significant():
    flat = made_up(np.full((50, 9), 50), np.ones((50, 5)), costly=[4, 9, 0, 0, 4])
    held = check_claims(flat)
    assert held["costly"]
    assert not any(held[c.key] for c in CLAIMS if c.key.startswith(("policy", "time", "interaction")))
    assert not held["team-never"]
    assert held["team-always"]


def test_another_planner_takes_the_place_of_the_papers():
    rng = np.random.default_rng(5)
    names = (*PAPER, EXACT)
    study = made_up(
        rng.integers(40, 60, (60, 9)) + 20 * (np.arange(60) % 6 == 5)[:, None], rng.random((60, 5)) < 0.7,
        names=names, costly=[9, 9, 0, 0, 4, 3],
    )  # fmt: skip
    assert not check_claims(study)["team-never"]
    assert check_claims(study, EXACT)["team-never"]
    assert not check_claims(study)["costly"]
    assert check_claims(study, EXACT)["costly"]
    assert as_printed(study, EXACT).n_people == 50
    assert Facts.of(as_printed(study), LS_POMDP).costly.keys() == set(PAPER)


def test_the_conclusions_belong_to_the_papers_sentences():
    sentences = published()["claims"]
    words = {2: "team performance", 3: "observed help", 4: "costly actions", 5: "belief", 6: "main effects",
             7: "interaction"}  # fmt: skip
    assert len(TEXT) == len(CLAIMS)
    assert {c.sentence for c in CLAIMS if c.whole} == set(words)
    for claim in CLAIMS:
        assert words[claim.sentence] in sentences[claim.sentence]


def test_critical_values_are_those_of_tukeys_distribution():
    assert tukey_t(0.05, 5, 95) * np.sqrt(2) == pytest.approx(3.9327, abs=1e-4)  # R: qtukey(.95, 5, 95)
