r"""Alpha vectors over product modes as a policy on plain modes: the belief moves by itself, whatever happens.

The belief is over the draw and the state together, :math:`b(i, s)`, and one set of vectors belongs to every product
mode (event, budget left). What an action is worth is one step of look-ahead on the vectors,

.. math:: Q(x, b, a) = \sum_{i, s} b(i, s) R(s, a) + g \sum_{m'} P(m' \mid x) \sum_o
   \max_{\alpha \in \Gamma_{x'(x, a, m')}} \sum_{i, s'} b'_{a, o}(i, s')\, \alpha(i, s')

and the vectors that attain the maxima are the plan that the policy is committed to afterwards: given draw `i`, the
same sum over that draw alone is what the action is worth there.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from models.errors import Phrase, located
from models.lspomdp import LatentStatePOMDP
from models.model_draws import ModelDraws
from models.planning.belief_check import IMPOSSIBLE
from models.planning.draw_beliefs import DrawBeliefs
from models.planning.explanation import Explanation, explain
from models.planning.policies import Policy, certain, grouped
from models.planning.policy_graph import PolicyGraph
from models.planning.product_modes import OVER, ProductModes

if TYPE_CHECKING:
    from models.planning.alpha_policy import AlphaPolicy
    from models.planning.belief_model import Impossible

Array = NDArray[np.float64]
Index = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class ProductMemory:
    """Plain mode, product mode, and belief ``[s, d]`` over state and draw."""

    mode: int
    product: int
    belief: Array


@dataclass(frozen=True, eq=False)
class ProductMemories:
    """Of many runs: product mode ``[run]`` and belief ``[run, s, d]``."""

    product: Index
    belief: Array


class ProductPolicy(Policy):
    """A policy given by alpha vectors over product modes.

    Parameters
    ----------
    beliefs : DrawBeliefs
        The models that may be true.
    product : ProductModes
    alpha : float64[k, s, d]
        Vectors.
    mode : int64[k]
        Product mode of each.
    discount : float
    name : str
    graph : PolicyGraph, optional
        Where known: files then hold it in place of the vectors.
    terminal : float64[s], optional
        Worth of the state where nothing is left to decide, with a graph.

    Attributes
    ----------
    n_draws : int
        Number of draws.

    Raises
    ------
    InputError
        On arrays that do not fit together, or a product mode without a vector.
    """

    def __init__(
        self, beliefs: DrawBeliefs, product: ProductModes, alpha: Array, mode: ArrayLike, discount: float,
        name: str = "exact plan by belief", *, graph: PolicyGraph | None = None, terminal: Array | None = None,
    ) -> None:  # fmt: skip
        self.beliefs, self.product, self.name, self.discount = beliefs, product, name, float(discount)
        self.alpha, self.mode = np.asarray(alpha, dtype=np.float64), np.asarray(mode, dtype=np.int64)
        self.graph, self.terminal = graph, terminal
        self.vocabulary = beliefs.vocabulary
        place = f"policy {name}"
        product.check(f"{place}, product", self.vocabulary)
        if not 0 <= self.discount <= 1:
            raise located(f"{place}, discount", discount, "a number from 0 to 1")
        shape = (len(self.mode), *beliefs.start.shape)
        if self.alpha.shape != shape or not np.isfinite(self.alpha).all():
            raise located(f"{place}, alpha, shape", self.alpha.shape, f"finite numbers {shape}")
        for x in range(len(product)):
            if not np.any(self.mode == x):
                raise located(f"{place}, product mode {product.names[x]}, vectors", 0, "at least one")
        flat = self.alpha.reshape(len(self.alpha), -1)
        self._vectors = [np.ascontiguousarray(flat[self.mode == x]) for x in range(len(product))]

    @classmethod
    def of(
        cls, policy: AlphaPolicy, product: ProductModes, model: LatentStatePOMDP, name: str = "",
        impossible: Impossible = "error",
    ) -> ProductPolicy:  # fmt: skip
        """A policy that `solve` found for a product problem, run on plain modes.

        Parameters
        ----------
        policy : AlphaPolicy
            Of the problem, such as ``solve(problem).policy``.
        product : ProductModes
            Of the problem.
        model : LatentStatePOMDP
            What the problem was made from.
        name : str
        impossible : {"error", "keep", "reset"}
        """
        beliefs = DrawBeliefs(ModelDraws.from_models([model]), impossible)
        alpha = policy.alpha[:, : model.n_states, None]
        return cls(beliefs, product, alpha, policy.mode, policy.model.discount, name or policy.name)

    @property
    def n_draws(self) -> int:
        """Number of draws."""
        return self.beliefs.draws.n_draws

    # -- what is believed --------------------------------------------------------------------------
    def belief_of(self, memory: ProductMemory) -> Array:
        """Belief over the states, whatever the draw, shape ``[s]``."""
        return np.asarray(memory.belief.sum(axis=1))

    def weights_of(self, memory: ProductMemory) -> Array:
        """Probability of each draw after what was seen, shape ``[d]``."""
        return np.asarray(memory.belief.sum(axis=0))

    def draw_beliefs(self, memory: ProductMemory) -> Array:
        """Belief over the states given the draw, shape ``[d, s]``; zeros for draws that are ruled out."""
        weight = memory.belief.sum(axis=0)
        return np.divide(memory.belief, weight, out=np.zeros(memory.belief.shape), where=weight > 0).T

    def left_of(self, memory: ProductMemory) -> float:
        """Budget left, as far as it can matter; infinite without a budget."""
        return float("inf") if self.product.left is None else float(self.product.left[memory.product])

    # -- what actions are worth --------------------------------------------------------------------
    def action_values(self, memory: ProductMemory) -> Array:
        """What each action is worth, shape ``[a]``: actions of the mode; nan where one cannot be paid for.

        Raises
        ------
        InputError
            When the schedule is over.
        """
        return np.asarray(self._worth(memory.product, memory.belief[None])[0])

    def draw_action_values(self, memory: ProductMemory) -> Array:
        """What each action is worth in each draw, shape ``[d, a]``, with the committed plan after it.

        The mean by `weights_of` is `action_values`. Nan where an action cannot be paid for, zero for draws that are
        ruled out.

        Raises
        ------
        InputError
            When the schedule is over.
        """
        x, b = memory.product, memory.belief
        m = self._decided(x)
        s, d = b.shape
        ahead = self.beliefs.ahead(m, b)
        reward = self.beliefs.rewards[m]
        outcomes = self.beliefs.outcomes(m)
        out = reward @ b
        for chance, y, choices in self._steps(x):
            z = np.concatenate([np.arange(c * outcomes, (c + 1) * outcomes) for c in choices])
            reached, vectors = ahead[z], self._vectors[y]
            best = (vectors @ reached.reshape(len(z), -1).T).argmax(axis=0)
            worth = (vectors[best].reshape(-1, s, d) * reached).sum(axis=1).reshape(len(choices), outcomes, d)
            out[choices] += self.discount * chance * worth.sum(axis=1)
        weight = b.sum(axis=0)
        out = np.divide(out, weight, out=np.zeros_like(out), where=weight > 0)
        out[~self.product.allowed[x, : len(out)]] = np.nan
        return out.T

    def _worth(self, x: int, beliefs: Array) -> Array:
        """Values at beliefs ``[n, s, d]``, shape ``[n, c]``."""
        m = self._decided(x)
        n = len(beliefs)
        ahead = self.beliefs.ahead(m, beliefs[0])[None] if n == 1 else self.beliefs.ahead_many(m, beliefs)
        outcomes = self.beliefs.outcomes(m)
        out = beliefs.sum(axis=2) @ self.beliefs.rewards[m].T
        parts = ahead.reshape(n, out.shape[1], outcomes, -1)
        for chance, y, choices in self._steps(x):
            reached = parts if len(choices) == out.shape[1] else parts[:, choices]
            best = (reached.reshape(-1, reached.shape[-1]) @ self._vectors[y].T).max(axis=1)
            out[:, choices] += self.discount * chance * best.reshape(n, len(choices), outcomes).sum(axis=2)
        out[:, ~self.product.allowed[x, : out.shape[1]]] = np.nan
        return np.asarray(out)

    def _steps(self, x: int) -> list[tuple[float, int, list[int]]]:
        """Product modes that may follow: probability of the mode, product mode, choices that lead there."""
        kept = self.__dict__.setdefault("_following", {})
        if x not in kept:
            found: dict[tuple[int, int], list[int]] = {}
            for c in np.flatnonzero(self.product.allowed[x]).tolist():
                for m in np.flatnonzero(self.product.chance[x] > 0).tolist():
                    found.setdefault((m, int(self.product.follow[x, c, m])), []).append(c)
            kept[x] = [(float(self.product.chance[x, m]), y, choices) for (m, y), choices in found.items()]
        return kept[x]

    def _decided(self, x: int) -> int:
        m = int(self.product.mode[x])
        if m == OVER:
            found = Phrase(self.product.names[x])
            raise located(f"policy {self.name}", found, "an event of the schedule: it is over")
        return m

    def why(self, memory: ProductMemory) -> Explanation:
        """Why it does what it does; shifts of belief keep what each state says of the draws.

        Raises
        ------
        InputError
            When the schedule is over.
        """
        x = memory.product
        m = self._decided(x)
        belief = self.belief_of(memory)
        rows = belief[:, None] > 0
        given = np.where(rows, memory.belief / np.where(rows, belief[:, None], 1.0), self.weights_of(memory))
        can = np.flatnonzero(self.product.allowed[x])
        names = [self.vocabulary.actions[m][c] for c in can]

        def values_at(beliefs: Array) -> Array:
            return self._worth(x, given * beliefs[:, :, None])[:, can]

        return explain(values_at, belief, self.beliefs.state_names, names, self.product.names[x])

    # -- the interface -----------------------------------------------------------------------------
    def begin(self, mode: int) -> ProductMemory:
        """Memory before anything has happened.

        Raises
        ------
        InputError
            If the policy cannot start in this mode.
        """
        m = self.vocabulary.mode(mode)
        if self.product.start[m] < 0:
            starts = [name for i, name in enumerate(self.vocabulary.modes) if self.product.start[i] >= 0]
            raise located(f"policy {self.name}, first mode", self.vocabulary.modes[m], " or ".join(starts))
        return ProductMemory(m, int(self.product.start[m]), self.beliefs.start)

    def mode_of(self, memory: ProductMemory) -> int:
        """The mode that a memory is about."""
        return memory.mode

    def probabilities(self, memory: ProductMemory) -> Array:
        """One at the best action that can be paid for; the lowest of equals."""
        values = self.action_values(memory)
        return certain(int(np.nanargmax(values)), len(values))

    def observe(
        self, memory: ProductMemory, choice: int, observation: int | None, next_mode: int
    ) -> ProductMemory:  # fmt: skip
        """The belief moves on, and the product mode.

        Any action may have been done, also one that could not be paid for: nothing is left then.

        Raises
        ------
        InputError
            On a mode that cannot follow, or an observation that cannot be.
        """
        m, x = self._decided(memory.product), memory.product
        if not (0 <= choice < len(self.vocabulary.actions[m]) and 0 <= next_mode < len(self.vocabulary.modes)):
            self.check_step(memory, choice, observation, next_mode)
        self.vocabulary.observation(observation)
        y = self._next(x, choice, next_mode)
        return ProductMemory(int(next_mode), y, self.beliefs.moved(m, memory.belief, choice, observation))

    def _next(self, x: int, choice: int, next_mode: int) -> int:
        y = int(self.product.follow[x, choice, next_mode])
        if y < 0:
            can = [n for m, n in enumerate(self.vocabulary.modes) if self.product.follow[x, choice, m] >= 0]
            found, place = (
                self.vocabulary.modes[next_mode],
                f"policy {self.name}, mode after {self.product.names[x]}",
            )
            raise located(place, found, " or ".join(can))
        return y

    def reason(self, memory: ProductMemory) -> str:
        """What it does and why, in one sentence."""
        left = self.left_of(memory)
        text = self.why(memory).sentence
        return text if np.isinf(left) else f"{text[:-1]}; {left:g} of the budget can still be spent."

    # -- many runs at once -------------------------------------------------------------------------
    def begin_many(self, modes: Index) -> ProductMemories:
        """The initial belief of every run."""
        for m in np.unique(modes):
            self.begin(int(m))
        start = self.beliefs.start
        return ProductMemories(self.product.start[modes], np.broadcast_to(start, (len(modes), *start.shape)))

    def probabilities_many(self, memories: ProductMemories) -> Array:
        """One at the choice of every run."""
        out = np.zeros((len(memories.product), max(map(len, self.vocabulary.actions))))
        for x in np.unique(memories.product).tolist():
            runs = np.flatnonzero(memories.product == x)
            out[runs, np.nanargmax(self._worth(x, memories.belief[runs]), axis=1)] = 1.0
        return out

    def observe_many(
        self, memories: ProductMemories, choices: Index, observations: Index, next_modes: Index
    ) -> ProductMemories:  # fmt: skip
        """Every belief moves on; steps of probability zero one by one, as `observe` treats them."""
        product, belief = np.empty_like(memories.product), np.empty(memories.belief.shape)
        for x, c, o, after, runs in grouped(memories.product, choices, observations, next_modes):
            m = self._decided(x)
            product[runs] = self._next(x, c, after)
            seen = self.beliefs.seen(m, o)
            table = self.beliefs.joint[m][:, c, seen]
            moved = np.einsum("nsd,std->ntd", memories.belief[runs], table)
            total = moved.sum(axis=(1, 2))
            for i in np.flatnonzero(total <= IMPOSSIBLE):
                moved[i], total[i] = self.beliefs.moved(m, memories.belief[runs[i]], c, o), 1.0
            belief[runs] = moved / total[:, None, None]
        return ProductMemories(product, belief)

    # -- files -------------------------------------------------------------------------------------
    def to_dict(self) -> dict[str, Any]:
        """Plain content of the policy; vectors as a graph where there is one."""
        content: dict[str, Any] = {
            "kind": "product", "name": self.name, "models": self.beliefs.to_dict(), "discount": self.discount,
            "product": self.product.to_dict(), "mode": self.mode.tolist(),
        }  # fmt: skip
        if self.graph is None:
            return {**content, "alpha": self.alpha.tolist()}
        return {
            **content, "choice": self.graph.choice.tolist(), "follow": self.graph.follow.tolist(),
            "terminal": None if self.terminal is None else self.terminal.tolist(),
        }  # fmt: skip
