"""Everything that decides how a study on the page runs."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from analysis.play.study_setup import RobotSource, text_digest
from analysis.policy_study import STUDY2
from models.errors import Phrase, located
from models.game.layout import Layout, packaged
from models.game.parameters import TICKS_A_SECOND, GameParameters
from models.planning.policies import Policy
from models.protocol import PUBLISHED

MODES = {"human_needs_help": "human", "robot_needs_help": "robot"}
"""Whom the game traps in each mode of the published protocol."""

DELETE, KEEP = "delete", "keep"
WITHDRAWAL = (DELETE, KEEP)
"""What becomes of the finished rounds of somebody who withdraws."""

MOST_ROUNDS = 200
MOST_COUNTDOWN = 60.0
MOST_CONSENT = 20_000
"""Characters of a consent text."""

CONSENT = """You are invited to take part in a study of how people and robots act side by side.

You will play {rounds} of a simple game, about {minutes} in all, next to a robot that a computer program steers.

What is recorded: a number that stands for you, the keys you press while a round runs, what happens in the round,
and the times at which you agreed, ended a round or left in the middle of one, and finished or withdrew. Your name,
address, browser and network address are not recorded. Nothing is recorded before you agree.

Taking part is voluntary. You can stop at any moment, without a reason, with the button “Withdraw” at the top of the
page. {withdrawal} If you only close the page, the rounds you have finished are kept, and you can go on later with
the same browser."""
"""Shown unless the study has a text of its own; an ethics board will want one."""

_TASK = 2202
"""First number of the spawn keys of this package's random streams."""
_ASSIGNMENT, _ROUND, _POLICY = 0, 1, 2


@dataclass(frozen=True)
class PlaySettings:
    """A study as it is played.

    Attributes
    ----------
    policies : tuple of Policy
        What drives the robot; people are assigned to them in random blocks, so that groups stay equally large.
    schedule : str
        Letters of the rounds (`models.protocol.Protocol.modes_from_letters`).
    layout : Layout
    parameters : GameParameters
    study : str
        The study column of the log.
    seed : int
        Of who gets which policy, of token places, and of policies that randomise.
    first_participant : int
        Number of the first person; numbers that were given away already are passed over.
    consent : str
        Text of the consent page, paragraphs separated by empty lines; `CONSENT` if empty.
    withdrawal : {"delete", "keep"}
    countdown : float
        Seconds before a round starts.
    tick_seconds : float
        A tenth of a second; tests are in a hurry.
    robots : mapping of str to RobotSource
        Where policies come from, by their names.

    Raises
    ------
    InputError
        Naming the setting, its value and what was wanted.
    """

    policies: tuple[Policy, ...]
    schedule: str = STUDY2
    layout: Layout = field(default_factory=packaged)
    parameters: GameParameters = field(default_factory=GameParameters)
    study: str = "token_game"
    seed: int = 1
    first_participant: int = 1
    consent: str = ""
    withdrawal: str = DELETE
    countdown: float = 3.0
    tick_seconds: float = 1 / TICKS_A_SECOND
    robots: Mapping[str, RobotSource] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if not self.policies:
            raise located("policies", Phrase("none"), "at least one")
        names = self.policy_names
        for i, name in enumerate(names):
            if name in names[:i]:
                raise located("policies", Phrase(f"{name} twice"), "different names: they are the conditions")
            _column_text("name of the policy", name)
        _column_text("name of the study", self.study)
        rounds = PUBLISHED.modes_from_letters(self.schedule)
        if len(rounds) > MOST_ROUNDS:
            raise located("schedule, rounds", len(rounds), f"at most {MOST_ROUNDS}")
        if self.seed < 0:
            raise located("seed", self.seed, "at least 0")
        if not 0 <= self.first_participant < 2**53:
            raise located("participant", self.first_participant, "a whole number from 0 to 2^53 - 1")
        if self.withdrawal not in WITHDRAWAL:
            raise located("withdrawal", self.withdrawal, f"one of {', '.join(WITHDRAWAL)}")
        if not 0 <= self.countdown <= MOST_COUNTDOWN:
            raise located("countdown", self.countdown, f"0 to {MOST_COUNTDOWN:g} seconds")
        if self.parameters.trap_tick >= self.parameters.round_ticks:
            wanted = f"less than round_ticks, {self.parameters.round_ticks}: nobody could ever be trapped"
            raise located("game parameters, trap_tick", self.parameters.trap_tick, wanted)
        if len(self.consent) > MOST_CONSENT:
            raise located("consent, characters", len(self.consent), f"at most {MOST_CONSENT}")

    # -- what follows from them --------------------------------------------------------------------
    @property
    def policy_names(self) -> tuple[str, ...]:
        """Names of the policies: the conditions."""
        return tuple(p.name for p in self.policies)

    @property
    def modes(self) -> tuple[str, ...]:
        """Mode of each round."""
        return tuple(m.name for m in PUBLISHED.modes_from_letters(self.schedule))

    @property
    def n_rounds(self) -> int:
        """Number of rounds."""
        return len(self.schedule)

    def policy(self, name: str) -> Policy:
        """A policy by its name."""
        return self.policies[self.policy_names.index(name)]

    def assigned(self, before: int) -> str:
        """Name of the policy that somebody meets: each block of as many people as policies meets all of them.

        Parameters
        ----------
        before : int
            People who agreed before, withdrawn ones included: blocks begin with the first, whatever their numbers.

        Examples
        --------
        >>> from models.planning.baselines import always, never
        >>> from models.protocol import PUBLISHED
        >>> study = PlaySettings((always(PUBLISHED), never(PUBLISHED)))
        >>> sorted(study.assigned(n) for n in (0, 1))
        ['always', 'never']
        """
        block, place = divmod(before, len(self.policies))
        order = np.random.default_rng(self._stream(_ASSIGNMENT, block)).permutation(len(self.policies))
        return self.policy_names[int(order[place])]

    def round_seed(self, participant: int, k: int) -> int:
        """Seed of a person's round, the same if it has to be begun again."""
        return int(self._stream(_ROUND, participant, k).generate_state(1, np.uint64)[0])

    def policy_rng(self, participant: int, k: int) -> np.random.Generator:
        """Luck of a policy that randomises in a person's round."""
        return np.random.default_rng(self._stream(_POLICY, participant, k))

    def _stream(self, *key: int) -> np.random.SeedSequence:
        return np.random.SeedSequence(self.seed, spawn_key=(_TASK, *key))

    def setup(self, condition: str) -> dict[str, object]:
        """What must stay the same for a person of a condition from the first round to the last, for files."""
        return {
            "study": self.study, "schedule": self.schedule, "seed": self.seed, "map": self.layout.name,
            "map_digest": self.layout.digest, "parameters": self.parameters.to_dict(),
            "withdrawal": self.withdrawal, "consent_sha256": text_digest(self.consent_text),
            "robot_sha256": self.robots.get(condition, RobotSource()).sha256,
        }  # fmt: skip

    @property
    def withdrawal_words(self) -> str:
        """The rule as people read it."""
        if self.withdrawal == DELETE:
            return (
                "If you withdraw, everything that was recorded of your rounds is deleted at once; all that stays "
                "is your number and after how many rounds you withdrew."
            )
        return "If you withdraw, the rounds you have finished are kept without your name, and nothing is added."

    @property
    def consent_paragraphs(self) -> tuple[str, ...]:
        """The consent page."""
        text = self.consent.strip()
        if not text:
            minutes = max(1, round(self.n_rounds * (self.parameters.seconds + 15) / 60))
            text = CONSENT.format(
                rounds="one round" if self.n_rounds == 1 else f"{self.n_rounds} rounds",
                minutes="one minute" if minutes == 1 else f"{minutes} minutes", withdrawal=self.withdrawal_words,
            )  # fmt: skip
        paragraphs = (" ".join(part.split()) for part in text.replace("\r\n", "\n").split("\n\n"))
        return tuple(p for p in paragraphs if p)

    @property
    def consent_text(self) -> str:
        """The consent page as one text, paragraphs separated by empty lines."""
        return "\n\n".join(self.consent_paragraphs)

    def with_(self, **changes: object) -> PlaySettings:
        """A copy with other settings."""
        return dataclasses.replace(self, **changes)  # type: ignore[arg-type]


def _column_text(place: str, text: str) -> None:
    if not text.strip() or not text.isprintable() or len(text) > 200:
        raise located(place, text, "1 to 200 printable characters: it is written into the log")
