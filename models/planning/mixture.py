r"""A mixture of policies: one is drawn before the first event and followed for ever.

As `models.planning.mixed_policy` for plans of a schedule, in the form that draws at each event with the chances of
the policies that would have done what was done so far (Kuhn's theorem).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from models.cautions import together
from models.errors import located
from models.planning.policies import Array, Policy


class MixtureMemory(NamedTuple):
    """The mode, the memory of every policy, and those that may be the one that was drawn."""

    mode: int
    memories: tuple[Any, ...]
    possible: tuple[int, ...]


class Mixture(Policy):
    """Policies that do not randomise themselves, drawn by shares.

    After an action that none of the possible ones takes (somebody has overruled them), all remain possible.

    Parameters
    ----------
    policies : sequence of Policy
        Of the same modes, actions and observations.
    share : float64[p]
    name : str

    Raises
    ------
    InputError
        On policies that randomise or differ in their vocabulary, or shares that are no probabilities.
    """

    def __init__(self, policies: Sequence[Policy], share: ArrayLike, name: str = "mixture") -> None:
        self.policies, self.name = tuple(policies), name
        self.cautions = together(*(p.cautions for p in self.policies))
        self.share = np.asarray(share, dtype=np.float64)
        good = self.share.shape == (len(self.policies),) and np.all(self.share >= 0)
        if not self.policies or not good or abs(self.share.sum() - 1) > 1e-9:
            wanted = f"{len(self.policies)} probabilities that sum to one"
            raise located(f"policy {name}, shares", self.share.tolist(), wanted)
        self.vocabulary = self.policies[0].vocabulary
        for p in self.policies:
            if p.vocabulary != self.vocabulary:
                place = f"policy {name}, modes, actions and observations of {p.name}"
                raise located(place, p.vocabulary, f"{self.vocabulary}")
            if p.randomised:
                raise located(f"policy {name}, {p.name}", "a policy that randomises", "one that does not")

    @property
    def randomised(self) -> bool:
        """Whether more than one policy may be followed."""
        return int(np.count_nonzero(self.share)) > 1

    def begin(self, mode: int) -> MixtureMemory:
        """Memory before anything has happened."""
        own = tuple(p.begin(mode) for p in self.policies)
        return MixtureMemory(self.vocabulary.mode(mode), own, tuple(np.flatnonzero(self.share > 0).tolist()))

    def mode_of(self, memory: MixtureMemory) -> int:
        """The mode that a memory is about."""
        return memory.mode

    def probabilities(self, memory: MixtureMemory) -> Array:
        """Shares of the policies that are still possible, by what they do next."""
        out = np.zeros(len(self.vocabulary.actions[memory.mode]))
        for p in memory.possible:
            out[self.policies[p].act(memory.memories[p])] += self.share[p]
        return out / out.sum()

    def observe(
        self, memory: MixtureMemory, choice: int, observation: int | None, next_mode: int
    ) -> MixtureMemory:  # fmt: skip
        """Every policy learns of the step; those that would have done otherwise are no longer possible."""
        self.check_step(memory, choice, observation, next_mode)
        possible = tuple(p for p in memory.possible if self.policies[p].act(memory.memories[p]) == choice)
        possible = possible or memory.possible
        # Those ruled out are never asked again. Their memory stands still, so that what acts alike is equal.
        own = tuple(
            p.observe(m, choice, observation, next_mode) if i in possible else m
            for i, (p, m) in enumerate(zip(self.policies, memory.memories, strict=True))
        )
        return MixtureMemory(int(next_mode), own, possible)

    def forget(self) -> None:
        """Forget histories that policies have worked on."""
        for p in self.policies:
            p.forget()

    def to_dict(self) -> dict[str, Any]:
        """Plain content of the policy."""
        return {
            "kind": "mixture", "name": self.name, "share": self.share.tolist(),
            "policies": [dict(p.to_dict()) for p in self.policies],
        }  # fmt: skip


def read_mixture(place: str, content: Mapping[str, Any], name: str) -> Mixture:
    """Build the policy from the content of a file.

    Raises
    ------
    InputError
        Names the entry, what was found and what was wanted.
    """
    from models.planning.policy_files import SCHEMA, policy_from_dict

    given = content.get("policies")
    if not isinstance(given, list) or not given or not all(isinstance(p, Mapping) for p in given):
        raise located(f"{place}, policies", given, "a list of policies")
    own = [policy_from_dict({"schema": SCHEMA, **p}, f"{place}, policy {i}") for i, p in enumerate(given)]
    share = content.get("share")
    good = isinstance(share, list) and all(isinstance(v, int | float) and not isinstance(v, bool) for v in share)
    if not good:
        raise located(f"{place}, share", share, "a list of probabilities")
    return Mixture(own, np.asarray(share, dtype=np.float64), name)
