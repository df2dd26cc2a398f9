"""Events of some conditions, picked from those that come in parts, as `EventLog.select` picks them at once."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from models.event_flow import CodedEvents


class SelectedEvents:
    """Picks events of some conditions.

    Parameters
    ----------
    conditions : sequence of str
        Names; their codes in what is picked are their places in the sorted list, `names`.
    """

    def __init__(self, conditions: Sequence[str]) -> None:
        self.names = sorted(set(conditions))

    def of(self, events: CodedEvents, names: Sequence[str]) -> CodedEvents:
        """The events among these that belong to the conditions; a run may go on from those given before.

        Parameters
        ----------
        events : CodedEvents
        names : sequence of str
            Conditions by the codes of `events`.
        """
        place = {name: i for i, name in enumerate(self.names)}
        code = np.array([place.get(name, -1) for name in names], dtype=np.int32)[events.condition]
        kept = code >= 0
        starts = events.starts[kept[events.starts]]
        return CodedEvents(
            np.cumsum(kept)[starts] - 1 if len(starts) else starts, events.participant[kept],
            events.sequence[kept], code[kept], events.action[kept], events.response[kept],
            {name: values[kept] for name, values in events.tokens.items()},
        )  # fmt: skip
