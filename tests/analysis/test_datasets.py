import gzip
import json

import numpy as np
import pytest

from analysis import datasets, frd2012
from analysis.design import DATA_FOLDER
from analysis.event_files import csv_bytes, read_events, write_events
from analysis.simulate import simulate_study1
from models.errors import InputError
from models.events import EventLog

BUNDLED = DATA_FOLDER / "simulated" / "simulated_study1.csv.gz"


@pytest.fixture
def real(shared):
    folder = shared / "data" / "real"
    if not folder.is_dir():
        pytest.skip(f"{folder} is absent: the real data are not part of the project")
    return folder


def test_the_bundled_study_is_made_again_byte_for_byte(tmp_path):
    made = tmp_path / "again.csv.gz"
    write_events(simulate_study1(), made)
    assert gzip.decompress(made.read_bytes()) == gzip.decompress(BUNDLED.read_bytes())
    # The compressed bytes also depend on the machine's zlib, which may be another implementation.
    if gzip.compress(gzip.decompress(BUNDLED.read_bytes()), 9, mtime=0) == BUNDLED.read_bytes():
        assert made.read_bytes() == BUNDLED.read_bytes()


def test_the_bundled_study_says_it_is_simulated():
    data = datasets.load("simulated_study1")
    assert data.card.kind == "simulated"
    assert "SIMULATED" in data.card.title
    assert data.log.study == "simulated_study1"
    assert data.digest == data.card.digest


@pytest.mark.parametrize("name", datasets.names())
def test_cards_are_complete(name):
    card = datasets.card(name)
    assert card.name == name
    assert card.kind in ("real", "simulated")
    for part in (card.title, card.source, card.licence, card.what, card.what_not, card.references, card.digest):
        assert part
    assert set(card.columns) == {
        "study", "participant", "condition", "sequence", "k", "mode", "action", "observation",
    }  # fmt: skip
    assert min(card.rows, card.participants, card.sequences) > 0


def test_card_of_the_real_data_says_what_it_is_not():
    card = datasets.card("frd2012")
    said = " ".join(card.what_not)
    for words in ("another person", "no signalling arm", "not randomised", "hold out people", "not settled"):
        assert words in said
    assert card.defaults["condition"] == "bc4_e8"
    assert card.defaults["pins"] == ["no_signal"]
    assert "not randomised" in card.text()


def test_sizes_on_the_card_are_those_of_the_bundled_log():
    data = datasets.load("simulated_study1")
    sizes = (data.log.n_events, data.log.n_participants, data.log.n_runs)
    assert sizes == (data.card.rows, data.card.participants, data.card.sequences)


def test_digest_ignores_format_and_order_but_not_content():
    log = simulate_study1(participants=30)
    frame = log.to_frame()
    shuffled = EventLog.from_frame(frame.sample(frac=1, random_state=1))
    assert datasets.log_digest(shuffled) == datasets.log_digest(log)
    response = log.response.copy()
    seen = int(np.flatnonzero(response >= 0)[0])
    response[seen] = 1 - response[seen]
    assert datasets.log_digest(log.with_responses(response)) != datasets.log_digest(log)


def test_a_file_of_ones_own_gets_a_bare_card(tmp_path):
    path = tmp_path / "mine.csv"
    write_events(simulate_study1(participants=5), path)
    data = datasets.load(path)
    assert (data.card.name, data.card.kind, data.card.digest) == (str(path), "unstated", "")


def test_unknown_names_are_told_what_there_is():
    with pytest.raises(InputError) as caught:
        datasets.load("frd2013")
    assert str(caught.value) == (
        "data: found 'frd2013', wanted a file, or a registered data set: simulated_study1, frd2012"
    )
    with pytest.raises(InputError, match="data set: found 'x', wanted one of simulated_study1, frd2012"):
        datasets.card("x")


# -- real people -----------------------------------------------------------------------------------
def test_conversion_is_identical_with_the_reference(real):
    ours = frd2012.read_frd2012(real / frd2012.FILE_NAME)
    reference = read_events(real / frd2012.EVENTS_NAME).log
    assert csv_bytes(ours) == csv_bytes(reference)
    assert (ours.n_events, ours.n_participants, ours.n_runs) == (24_716, 384, 1_536)
    chosen = ours.select(conditions=["bc4_e8"])
    assert (chosen.n_runs, chosen.n_responses_recorded) == (360, 3_076)


@pytest.mark.parametrize("name", [frd2012.FILE_NAME, frd2012.EVENTS_NAME])
def test_the_folder_a_user_names_is_used(real, tmp_path, monkeypatch, name):
    (tmp_path / name).symlink_to(real / name)
    monkeypatch.setenv("PROSOCIAL_DATA", str(tmp_path))
    data = datasets.load("frd2012")
    assert data.digest == data.card.digest
    assert (data.log.n_events, data.log.n_participants, data.log.n_runs) == (
        data.card.rows, data.card.participants, data.card.sequences,
    )  # fmt: skip


def test_choice_is_intended_and_last_choice_realised(real):
    import rdata

    constructors = dict(rdata.conversion.DEFAULT_CLASS_MAP)
    constructors["stratEst.data"] = rdata.conversion.dataframe_constructor
    periods = rdata.read_rda(real / frd2012.FILE_NAME, constructor_dict=constructors)["data.FRD2012"]
    periods = periods.sort_values(["id", "game", "period"]).astype(str)
    later = (periods["period"].astype(int) > 1).to_numpy()[1:]
    flipped = periods["choice"].to_numpy()[:-1] != periods["last.choice"].to_numpy()[1:]
    error = periods["error"].astype(float).to_numpy()[:-1]
    for rate in (0.0, 0.0625, 0.125):
        assert flipped[later & (error == rate)].mean() == pytest.approx(rate, abs=0.015)


def test_another_file_under_the_name_is_refused(tmp_path, monkeypatch):
    (tmp_path / frd2012.FILE_NAME).write_bytes(b"something else")
    monkeypatch.setenv("PROSOCIAL_DATA", str(tmp_path))
    with pytest.raises(InputError, match=r"data\.FRD2012\.rda, SHA-256: found '.*', wanted 094caa.*not the pinned"):
        datasets.load("frd2012")


def test_another_log_under_the_name_is_refused(tmp_path, monkeypatch):
    write_events(simulate_study1(participants=5), tmp_path / frd2012.EVENTS_NAME)
    monkeypatch.setenv("PROSOCIAL_DATA", str(tmp_path))
    with pytest.raises(InputError, match=r"digest of its events: found '.*this is not frd2012"):
        datasets.load("frd2012")


def test_a_folder_that_does_not_exist_is_named(monkeypatch):
    monkeypatch.setenv("PROSOCIAL_DATA", "/no/such/folder")
    with pytest.raises(InputError, match="variable PROSOCIAL_DATA: found '/no/such/folder', wanted an existing"):
        datasets.load("frd2012")


def test_a_folder_without_the_file_is_named_and_nothing_is_fetched(tmp_path, monkeypatch):
    import pooch

    monkeypatch.setattr(pooch, "retrieve", lambda *_, **__: pytest.fail("went to the network"))
    monkeypatch.setenv("PROSOCIAL_DATA", str(tmp_path))
    with pytest.raises(InputError) as caught:
        datasets.load("frd2012")
    for wanted in (str(tmp_path), frd2012.FILE_NAME, frd2012.EVENTS_NAME):
        assert wanted in str(caught.value)


@pytest.mark.parametrize("failure", [ConnectionError("no route"), ValueError("SHA256 hash does not match")])
def test_without_a_connection_the_error_says_what_to_do(monkeypatch, failure):
    import pooch

    def fail(*_arguments, **_options):
        raise failure

    monkeypatch.setattr(pooch, "retrieve", fail)
    monkeypatch.delenv("PROSOCIAL_DATA", raising=False)
    with pytest.raises(
        InputError, match=r"not bundled, and fetching it failed .* set PROSOCIAL_DATA to that folder"
    ):
        datasets.load("frd2012")


def test_registry_and_cards_name_each_other():
    registry = json.loads((DATA_FOLDER / "registry.json").read_text())
    assert {e["card"] for e in registry.values()} == {f"cards/{p.name}" for p in (DATA_FOLDER / "cards").iterdir()}
