"""A study of short rounds."""

import pytest

from analysis.play.settings import PlaySettings
from analysis.play.study import Study
from models.game.parameters import GameParameters
from models.planning.baselines import Reciprocal, always, never
from models.protocol import PUBLISHED

SHORT = GameParameters(
    round_ticks=150,
    trap_tick=10,
    human_step_ticks=2,
    robot_step_ticks=1,
    human_notice_ticks=1,
    human_notice_spread=0,
    human_lapse=0.01,
    human_lapse_ticks=10,
    human_wander=0.1,
    robot_help_delay=50,
)  # fmt: skip


@pytest.fixture
def settings():
    """Three rounds of 150 ticks that last a moment; the robot answers help with help."""
    return PlaySettings(
        (Reciprocal(PUBLISHED),), "HRH", parameters=SHORT, study="test", countdown=0.0, tick_seconds=0.001
    )


@pytest.fixture
def two_policies(settings):
    return settings.with_(policies=(always(PUBLISHED), never(PUBLISHED)))


@pytest.fixture
def opened(tmp_path):
    """Opens studies, and closes them at the end."""
    studies = []

    def make(settings, name="log.csv"):
        studies.append(Study(settings, tmp_path / name))
        return studies[-1]

    yield make
    for study in studies:
        study.close()
