import pytest

from analysis.design import DATA_FOLDER
from analysis.event_import import import_events, key_text
from models.errors import InputError
from models.protocol import PUBLISHED

EXAMPLE = DATA_FOLDER / "maps" / "osf_study1_example.toml"

RAW = """prolific_id,help_arm,signal_arm,round,opportunity,robot_helped,robot_signalled,human_helped,browser
5f3a,help,no-signal,1,R,1,,,firefox
5f3a,help,no-signal,2,H,,0,1,firefox
5f3a,help,no-signal,3,H,,0,NA,firefox
09bc,no-help,signal,2,R,0,,0,safari
09bc,no-help,signal,1,H,,1,0,safari
"""


@pytest.fixture
def files(tmp_path):
    raw, column_map = tmp_path / "raw.csv", tmp_path / "map.toml"
    raw.write_text(RAW)
    column_map.write_text(EXAMPLE.read_text())
    return raw, column_map


def test_the_example_map_reads_a_made_up_export(files):
    imported = import_events(*files)
    log = imported.log
    assert log.study == "zahedi2026_study1"
    assert log.participant.tolist() == [1, 2]
    assert imported.key == ("5f3a", "09bc")
    assert [log.conditions[c] for c in log.condition] == ["help+no-signal", "no-help+signal"]
    assert log.schedules().tolist() == ["RHH", "HR"]
    frame = log.to_frame()
    assert frame["k"].tolist() == [0, 1, 2, 0, 1]
    assert frame["action"].tolist() == ["help", "no_signal", "no_signal", "signal", "no_help"]
    assert frame["observation"].tolist() == ["none", "help", "missing", "no_help", "none"]
    assert imported.notes == (f"{files[0]}: columns the map does not use: browser",)


def test_personal_ids_stay_out_of_the_log(files):
    log = import_events(*files).log
    assert "5f3a" not in log.to_frame().to_csv()
    assert key_text(import_events(*files).key) == "participant,raw_id\n1,5f3a\n2,09bc\n"


def test_semicolons_one_action_column_mode_names_and_tokens(tmp_path):
    raw, column_map = tmp_path / "raw.csv", tmp_path / "map.toml"
    raw.write_text("who;arm;run;k;trapped;did;saw;team\nx;A;7;0;robot;yes;no_help;3.5\nx;A;7;1;human;yes;;\n")
    column_map.write_text(
        """
study = "s"
separator = ";"
[columns]
participant = "who"
condition = "arm"
sequence = "run"
k = "k"
mode = "trapped"
action = "did"
observation = "saw"
team_tokens = "team"
[values]
mode = {robot = "robot_needs_help", human = "human_needs_help"}
condition = {A = "first"}
[values.action]
robot_needs_help = {yes = "signal"}
human_needs_help = {yes = "help"}
"""
    )
    log = import_events(raw, column_map).log
    frame = log.to_frame()
    assert (log.conditions, log.sequence.tolist()) == (("first",), [7])
    assert frame["action"].tolist() == ["signal", "help"]
    assert frame["team_tokens"].tolist()[0] == 3.5


MAPS = {
    "unknown key": ('study = "', 'studdy = "', ", key: found 'studdy', wanted one of study, sequence, separator"),
    "unknown column": ('k = "round"', 'rnd = "round"', ", [columns], key: found 'rnd', wanted one of participant"),
    "no column": ('k = "round"\n', "", ", [columns]: found no entry for k, wanted the raw column it comes from"),
    "wrong kind": ('k = "round"', "k = 3", ", [columns], key k: found 3, wanted the name of a raw column"),
    "unknown mode": (
        'human_needs_help = "robot_helped"', 'nobody = "robot_helped"',
        ", [columns], key action, key: found 'nobody', wanted one of human_needs_help, robot_needs_help",
    ),
    "unknown target": (
        '1 = "signal"', '1 = "wave"',
        ", [values.action.robot_needs_help], key 1: found 'wave', wanted one of no_signal, signal",
    ),
    "action of the other mode": (
        '1 = "signal"', '1 = "help"',
        ", [values.action.robot_needs_help], key 1: found 'help', wanted one of no_signal, signal",
    ),
    "mode": ('mode = "letters"', 'mode = "words"', ", [values.mode]: found 'words', wanted a table"),
    "separator": ('separator = ","', 'separator = ",,"', ", key separator: found ',,', wanted one character"),
    "first round": ("first_round = 1", "first_round = true", ", key first_round: found True, wanted an integer"),
    "empty study": ('"zahedi2026_study1"', '" "', ", key study: found ' ', wanted the name of the study"),
    "not TOML": ("[columns]", "[columns", ": not valid TOML: Expected ']'"),
}  # fmt: skip


@pytest.mark.parametrize("case", MAPS)
def test_maps_that_cannot_be_used(case, files):
    before, after, message = MAPS[case]
    raw, column_map = files
    content = column_map.read_text()
    assert before in content
    column_map.write_text(content.replace(before, after))
    with pytest.raises(InputError) as caught:
        import_events(raw, column_map)
    assert str(caught.value).startswith(f"{column_map}{message}")


RAWS = {
    "no such column": ("round,", "runde,", ", line 1, columns: found 'prolific_id, help_arm, signal_arm, runde"),
    "letter": ("2,H,,0,1", "2,X,,0,1", ", line 3, column opportunity: found 'X', wanted one of the letters H, R"),
    "response": ("2,H,,0,1", "2,H,,0,yes", ", line 3, column human_helped: found 'yes', wanted a value mapped in "),
    "action": ("1,R,1,", "1,R,,", ", line 2, column robot_helped: found '', wanted a value mapped in "),
    "round": ("2,H,,0,1", "two,H,,0,1", ", line 3, column round: found 'two', wanted an integer"),
    "id": (
        "\n5f3a,help,no-signal,2",
        "\n,help,no-signal,2",
        ", line 3, column prolific_id: found '', wanted an id",
    ),
    "gap": ("3,H,,0,NA", "5,H,,0,NA", " (as mapped by "),
    "ragged": (",NA,firefox", ",NA", ", line 4: found 8 fields, wanted 9, as many as the header has"),
}


@pytest.mark.parametrize("case", RAWS)
def test_exports_that_do_not_fit_their_map(case, files):
    before, after, message = RAWS[case]
    raw, column_map = files
    assert before in RAW
    raw.write_text(RAW.replace(before, after, 1))
    with pytest.raises(InputError) as caught:
        import_events(raw, column_map)
    assert str(caught.value).startswith(f"{raw}{message}")


def test_missing_files_are_named(files, tmp_path):
    with pytest.raises(InputError, match="no such map file"):
        import_events(files[0], tmp_path / "none.toml")
    with pytest.raises(InputError, match="no such file"):
        import_events(tmp_path / "none.csv", files[1])


def test_the_letters_go_through_the_one_converter(files):
    modes = [m.name for m in PUBLISHED.modes_from_letters("RHH")]
    log = import_events(*files).log
    assert log.to_frame()["mode"].tolist()[:3] == modes
