"""What studies would be worth, in a table and in words."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from models.errors import located
from models.event_rules import one_of
from models.notebook_view import NotebookView
from models.planning.schedule import Array
from models.reward import UNIT
from models.robust.draw_error import controlled_mean

FEWEST_EFFECTIVE = 100.0
"""Effective draws below which what is believed after the data is told by too few of them. With a third of this the
two estimates for 540 people, at four states, lay at 2.6 and 1.4; with 120 at 2.4 and 2.2."""


FEWEST_TOLD = 20.0
"""Effective draws below which no number is said at all: one or two draws then decide it."""


class Simulated(NamedTuple):
    """One number a simulated data set, in arrays of one shape.

    Attributes
    ----------
    gain : float64[...]
        Of the best plan after the data over today's, by what is then believed.
    ceiling : float64[...]
        What perfect knowledge would gain.
    held_out, held_out_ceiling : float64[...]
        The same with the plan chosen without some of the draws, scored by those.
    effective : float64[...]
        Effective number of draws after the data.
    """

    gain: Array
    ceiling: Array
    held_out: Array
    held_out_ceiling: Array
    effective: Array


@dataclass(frozen=True)
class StudyWorth(NotebookView):
    """One study of one size.

    Attributes
    ----------
    study : str
    people : int
        Participants.
    worth : float
        Expected gain over today's plan, in `unit` a person served: `pathwise` less what the luck of the
        simulated data sets has put on it, from 0 to EVPI.
    se : float
        Its standard error over simulated data sets. That there are finitely many draws adds to it; see `enough`.
    held_out, held_out_se : float
        The same for plans chosen without some of the draws and scored by those: the value of a rule that could be
        used, if anything too low; NaN with so few draws that none is held out.
    pathwise, pathwise_se : float
        The plain mean over data sets, without bias and never negative, and its standard error.
    perfect : float
        What perfect knowledge would add to today's plan, averaged over the same data sets: `pathwise` is no more.
    evpi : float
        The same by what is believed today, exactly.
    effective : float
        Median over data sets of the effective number of draws after them.
    changed : float
        Share of the data sets after which another plan than today's is better.
    silent : bool
        Whether nobody would show a response, so that there is nothing to learn.
    served : float or None
        People that the plan will serve.
    cost : float
        Of one participant.
    sampled : bool
        Whether the draws are a sample of what is believed, and not all of it.
    unit : str
        What worths and costs are in: the word of the reward.
    cautions : tuple of str
        Those of the draws (`models.cautions`).
    """

    study: str
    people: int
    worth: float
    se: float
    held_out: float
    held_out_se: float
    pathwise: float
    pathwise_se: float
    perfect: float
    evpi: float
    effective: float
    changed: float
    silent: bool = False
    served: float | None = None
    cost: float = 0.0
    sampled: bool = True
    unit: str = UNIT
    cautions: tuple[str, ...] = ()

    @classmethod
    def of(
        cls, study: str, people: int, simulated: Simulated, evpi: float, silent: bool, cut: bool,
        served: float | None, cost: float, sampled: bool = True, unit: str = UNIT,
        cautions: tuple[str, ...] = (),
    ) -> StudyWorth:  # fmt: skip
        """From one number a simulated data set; `cut`: some draws were held out.

        What perfect knowledge adds after the data has the mean EVPI, and goes up and down with the gain: a control
        variate, which halves the standard error.
        """
        gain = simulated.gain
        mean, se = controlled_mean(gain, (simulated.ceiling - evpi)[:, None])
        held_out, held_out_se = float("nan"), float("nan")
        if cut:
            held_out, held_out_se = controlled_mean(
                simulated.held_out, (simulated.held_out_ceiling - evpi)[:, None] * (not silent)
            )
        plain = float(gain.std(ddof=1) / np.sqrt(len(gain)))
        return cls(
            study, people, float(np.clip(mean, 0.0, evpi)), se, held_out, held_out_se, float(gain.mean()), plain,
            float(simulated.ceiling.mean()), evpi, float(np.median(simulated.effective)),
            float(np.mean(gain > 0)), silent, served, cost, sampled, unit, cautions,
        )  # fmt: skip

    @property
    def enough(self) -> bool:
        """Whether enough draws remain after the data to say what would be believed; all there are always do."""
        return not self.sampled or self.effective >= FEWEST_EFFECTIVE

    @property
    def sayable(self) -> bool:
        """Whether a number can be said, if with a warning: not with fewer effective draws than `FEWEST_TOLD`.

        That nothing can be gained, by silence or for want of doubt, can always be said.
        """
        return self.silent or self.evpi == 0 or not self.sampled or self.effective >= FEWEST_TOLD

    @property
    def sure(self) -> float:
        """The smaller of `worth` and `held_out`: what headlines and net benefits rest on."""
        return self.worth if np.isnan(self.held_out) else float(np.clip(self.held_out, 0.0, self.worth))

    @property
    def net(self) -> float:
        """What is `sure` to all people served (one, if not given) less what the participants cost."""
        return self.sure * (1.0 if self.served is None else self.served) - self.cost * self.people

    def share_of(self, doubt: float) -> str:
        """What the study takes away of what doubt costs in all, from what is `sure` to `worth`, in words.

        Examples
        --------
        >>> StudyWorth("one", 5, 0.5, 0.1, 0.4, 0.1, 0.5, 0.1, 2.0, 2.0, 500.0, 0.3).share_of(2.0)
        '20% to 25%'
        """
        low, high = (v / doubt if doubt > 0 else 0.0 for v in (self.sure, self.worth))
        return f"{low:.0%}" if f"{low:.0%}" == f"{high:.0%}" else f"{low:.0%} to {high:.0%}"

    @property
    def warning(self) -> str:
        """What stands against believing the number; empty if nothing does."""
        if self.enough:
            return ""
        return f"{self.left_words}, {FEWEST_EFFECTIVE:.0f} wanted: too few to say; take more draws"

    @property
    def left_words(self) -> str:
        """How many effective draws are left after such data, in words."""
        left = f"{self.effective:.0f}"
        return f"{left} effective draw{' is' if left == '1' else 's are'} left after such data"

    @property
    def words(self) -> str:
        """The study, as it is spoken of."""
        return f"{self.people:,} more {'person' if self.people == 1 else 'people'} under {self.study}"

    @property
    def sentence(self) -> str:
        """The result in one sentence."""
        if self.silent:
            return f"{self.words} would be worth nothing: nobody shows a response in this design."
        if not self.sayable:
            return (
                f"What {self.words} would be worth cannot be said from these draws: {self.left_words}, "
                f"{FEWEST_EFFECTIVE:.0f} wanted; take more draws."
            )
        out = f"{self.words} would be worth {self.worth:.2g} {self.unit} a person (standard error {self.se:.1g})"
        if not np.isnan(self.held_out):
            out += f", {max(self.held_out, 0.0):.2g} for plans scored on draws that did not choose them"
        out += f", of {self.evpi:.2g} that perfect knowledge would be worth"
        if self.served is not None:
            sign = "gains" if self.net >= 0 else "loses"
            cost = f" at a cost of {self.cost:g} a participant" if self.cost else ""
            out += f"; with {self.served:,.0f} people served{cost}, the study {sign} {abs(self.net):,.3g} in all"
        return out + (f" ({self.warning})." if self.warning else ".")


@dataclass(frozen=True)
class SampleInformation(NotebookView):
    """What several studies of several sizes would be worth.

    Attributes
    ----------
    rows : tuple of StudyWorth
        Study by study, sizes rising.
    gains, ceilings : float64[replicate, study, size]
        Gain after each simulated data set, and what perfect knowledge would have gained; replicates share truths
        and luck across studies and sizes.
    studies : tuple of str
    sizes : tuple of int
    perfect : float
        EVPI by what is believed today.
    letters : str
        Schedule that people are served with.
    seed : int
    exact : bool
        Whether the best plan after the data was looked for among all plans; else among a pool, and `worth` is a
        lower bound.
    unit : str
        What worths are in: the word of the reward.
    cautions : tuple of str
        Those of the draws (`models.cautions`).
    """

    rows: tuple[StudyWorth, ...]
    gains: Array
    ceilings: Array
    studies: tuple[str, ...]
    sizes: tuple[int, ...]
    perfect: float
    letters: str
    seed: int
    exact: bool
    unit: str = UNIT
    cautions: tuple[str, ...] = ()

    def row(self, study: str, people: int) -> StudyWorth:
        """One study of one size.

        Raises
        ------
        InputError
            If it was not looked at.
        """
        j, i = self._place(study, people)
        return self.rows[j * len(self.sizes) + i]

    def difference(self, study: str, other: str, people: int) -> tuple[float, float]:
        """How much more one study is worth than another one of the same size, and the standard error of that.

        Both saw the same truths and luck, so this is surer than their two standard errors suggest.
        """
        (a, i), (b, _) = self._place(study, people), self._place(other, people)
        controls = np.column_stack([self.ceilings[:, a, i], self.ceilings[:, b, i]]) - self.perfect
        return controlled_mean(self.gains[:, a, i] - self.gains[:, b, i], controls)

    @property
    def best(self) -> StudyWorth:
        """The study and size with the largest net benefit, the smallest of equals.

        Those that leave too few draws to tell count only if nothing can be said for any other.
        """
        shown = [r for r in self.rows if not r.silent] or list(self.rows)
        enough = [r for r in shown if r.enough]
        told = [r for r in shown if r.sayable] or shown
        return max(enough if any(r.sure > 0 for r in enough) else told, key=lambda r: (r.net, -r.people))

    @property
    def table(self) -> Any:
        """One row a study and size, as a data frame."""
        import pandas as pd

        columns = (
            "study",
            "people",
            "worth",
            "se",
            "held_out",
            "held_out_se",
            "pathwise",
            "pathwise_se",
            "perfect",
            "effective",
            "enough",
            "changed",
            "net",
        )
        return pd.DataFrame([{c: getattr(r, c) for c in columns} for r in self.rows])

    @property
    def told(self) -> list[StudyWorth]:
        """Each study with its largest size that the draws can tell of, else its smallest."""
        out = []
        for j in range(len(self.studies)):
            own = self.rows[j * len(self.sizes) : (j + 1) * len(self.sizes)]
            out.append(([r for r in own if r.enough] or [own[0]])[-1])
        return out

    @property
    def sentences(self) -> list[str]:
        """One sentence a study, for its largest size that the draws can tell of."""
        return [row.sentence for row in self.told]

    @property
    def sentence(self) -> str:
        """Which study is worth most, in one sentence."""
        best = self.best
        if all(r.silent for r in self.rows):
            return "None of these studies would be worth anything: nobody shows a response in them."
        shown = [r for r in self.rows if not r.silent]
        if not any(r.sayable for r in shown):
            most = max(shown, key=lambda r: r.effective)
            return (
                f"What these studies would be worth cannot be said from these draws: at most {most.left_words}, "
                f"{FEWEST_EFFECTIVE:.0f} wanted; take more draws."
            )
        if all(r.worth == 0 for r in self.rows if r.sayable):
            if all(r.sayable for r in shown):
                return "None of these studies would change the plan: more data of this kind are worth nothing."
            return "None of these studies would change the plan, as far as these draws can say; take more draws."
        if best.net <= 0:
            return f"None of these studies is worth its cost; the least bad: {best.sentence}"
        least = "" if self.exact else "at least "
        return (
            f"The best of these studies, by what is sure of it, takes away {least}{best.share_of(self.perfect)} of "
            f"what doubt costs: {best.sentence}"
        )

    def _place(self, study: str, people: int) -> tuple[int, int]:
        if study not in self.studies:
            raise located("study", study, one_of(self.studies))
        if people not in self.sizes:
            raise located("participants of a study", people, one_of([str(n) for n in self.sizes]))
        return self.studies.index(study), self.sizes.index(people)
