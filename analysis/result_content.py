"""Results as plain content: arrays and JSON. No pickle, and nothing in it is ever run when it is read back.

Known are numbers, text, arrays, tables, lists, mappings, enumerations and the objects of this house, by their
fields. What an object worked out for later use (`functools.cached_property`) is left out. Whatever a result shares
with what it was computed from is a reference to that, so that a study of some draws does not hold them again.
"""

from __future__ import annotations

import enum
import hashlib
import json
import sys
import types
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable
from fractions import Fraction
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from analysis.source_digest import PACKAGES

type Node = Any
"""A JSON value: None, a truth value, a number, a text, or a list whose first element says what it is."""

type Steps = tuple[tuple[str, Any], ...] | None
"""The way from what a result is computed from to an object in it: attributes, items, values of mappings by number.

None where there is no such way, as to the keys of a mapping."""

POSTERIOR = "models.posterior:Posterior"
"""Told by its arrays and settings, however it came into memory."""


class NotContent(TypeError):
    """Something that cannot be written as content; the message says where it is and what."""


def name_of(thing: Any, place: str) -> str:
    """Name by which a class or function of this house is found again.

    Raises
    ------
    NotContent
        If it is somebody else's, made within a function, or not what its name leads to.
    """
    module, name = thing.__module__, thing.__qualname__
    found: Any = sys.modules.get(module)
    for part in name.split("."):
        found = getattr(found, part, None)
    if found is not thing or (module.partition(".")[0] not in PACKAGES and thing not in PLAIN_TYPES):
        raise NotContent(f"{place}: {module}.{name} cannot be found by its name")
    return f"{module}:{name}"


BUILT_IN = (str, bytes, int, float, complex, list, dict, set, frozenset, np.ndarray, BaseException)
"""Classes whose descendants hold more than their attributes."""

PLAIN_TYPES = (bool, int, float, str, bytes, tuple, list, dict)
"""Classes of Python that content may name."""


def kept_attributes(value: Any) -> dict[str, Any]:
    """Attributes of an object by name, without what it worked out for later."""
    kind = type(value)
    later = {n for c in kind.__mro__ for n, a in vars(c).items() if isinstance(a, cached_property)}
    slots = [s for c in reversed(kind.__mro__) for s in _slots(c) if hasattr(value, s)]
    own = {s: getattr(value, s) for s in slots} | getattr(value, "__dict__", {})
    return {name: attribute for name, attribute in own.items() if name not in later}


def _slots(kind: type) -> list[str]:
    slots = vars(kind).get("__slots__", ())
    names = [slots] if isinstance(slots, str) else list(slots)
    return [n for n in names if n not in ("__dict__", "__weakref__")]


def _is_shared(value: Any) -> bool:
    """Whether it matters that the same object comes back, rather than an equal one."""
    if isinstance(value, np.ndarray | pd.DataFrame | pd.Series | pd.Index | dict | list):
        return True
    if isinstance(value, type | types.FunctionType | enum.Enum | tuple | np.generic):
        return False
    return type(value).__module__.partition(".")[0] in PACKAGES


class _Walk(ABC):
    """Visits everything that a value is made of; arrays, and objects met again, are up to subclasses."""

    def node(self, value: Any, steps: Steps = None) -> Node:
        """Content of a value that stands where `steps` lead."""
        if value is None or type(value) in (bool, int, float, str):
            return value
        return self.met(value, steps, partial(self._made, value, steps))

    @abstractmethod
    def met(self, value: Any, steps: Steps, make: Callable[[], Node]) -> Node:
        """What becomes of anything but numbers and text."""

    @abstractmethod
    def array(self, value: np.ndarray) -> Node:
        """What becomes of an array of numbers or text."""

    def _items(self, values: Iterable[Any], steps: Steps) -> list[Node]:
        return [self.node(v, further(steps, "item", i)) for i, v in enumerate(values)]

    def _made(self, value: Any, steps: Steps) -> Node:
        kind, place = type(value), told(steps)
        if isinstance(value, enum.Enum):
            return ["member", name_of(kind, place), value.name]
        if isinstance(value, np.generic):
            return ["scalar", value.dtype.str, value.tobytes().hex()]
        if kind is np.ndarray:
            if value.dtype.hasobject:
                return ["objects", list(value.shape), [self.node(v) for v in value.ravel().tolist()]]
            return self.array(value)
        if kind is bytes:
            return ["bytes", self.array(np.frombuffer(value, dtype=np.uint8))]
        if kind in (tuple, list):
            return [kind.__name__, self._items(value, steps)]
        if kind is dict:
            pairs = enumerate(value.items())
            return ["dict", [[self.node(k), self.node(v, further(steps, "value", i))] for i, (k, v) in pairs]]
        if kind is types.MappingProxyType:
            return ["proxy", self.node(dict(value))]
        if kind in (set, frozenset):
            return [kind.__name__, [self.node(v) for v in sorted(value, key=repr)]]
        if kind is partial:
            names = ("func", "args", "keywords")
            return ["partial", *(self.node(getattr(value, n), further(steps, "attribute", n)) for n in names)]
        if isinstance(value, types.MethodType):
            return ["method", self.node(value.__self__, further(steps, "attribute", "__self__")), value.__name__]
        if isinstance(value, type | types.FunctionType):
            return ["named", name_of(value, place)]
        if isinstance(value, Path):
            return ["path", str(value)]
        if kind is Fraction:
            return ["fraction", value.numerator, value.denominator]
        if kind.__module__.partition(".")[0] == "pandas":
            return self._pandas(value, place)
        if kind.__module__.startswith("scipy.sparse.") and value.format in ("csr", "csc"):
            parts = (value.data, value.indices, value.indptr)
            return ["sparse", kind.__name__, list(value.shape), *(self.node(v) for v in parts)]
        if isinstance(value, tuple):  # a named one
            return ["row", name_of(kind, place), self._items(value, steps)]
        if isinstance(value, BUILT_IN):  # what it holds beside its attributes would be lost
            raise NotContent(f"{place}: {kind.__qualname__} holds more than its attributes")
        own = kept_attributes(value).items()
        return ["object", name_of(kind, place), [[n, self.node(v, further(steps, "attribute", n))] for n, v in own]]

    def _pandas(self, value: Any, place: str) -> Node:
        if type(value) is pd.DataFrame:
            columns = [self.node(value.iloc[:, i].array) for i in range(value.shape[1])]
            return ["frame", self.node(value.index), self.node(value.columns), columns, self.node(value.attrs)]
        if type(value) is pd.Series:
            return ["series", self.node(value.index), self.node(value.array), self.node(value.name)]
        if type(value) is pd.RangeIndex:
            return ["range", value.start, value.stop, value.step, self.node(value.name)]
        if type(value) is pd.MultiIndex:
            codes = [np.asarray(c) for c in value.codes]
            return ["levels", *(self.node(v) for v in (list(value.levels), codes, list(value.names)))]
        if type(value) in (pd.Index, pd.CategoricalIndex):
            return ["index", self.node(value.array), self.node(value.name)]
        if isinstance(value, pd.arrays.NumpyExtensionArray):
            return ["plain", self.node(value.to_numpy())]
        if isinstance(value, pd.Categorical):
            return ["categorical", self.node(value.codes), self.node(value.categories), bool(value.ordered)]
        if isinstance(getattr(value, "dtype", None), pd.StringDtype):
            words = [None if pd.isna(w) else str(w) for w in value]
            return ["words", value.dtype.storage, value.dtype.na_value is pd.NA, words]
        raise NotContent(f"{place}: {type(value).__name__} of {getattr(value, 'dtype', 'pandas')}")


def further(steps: Steps, how: str, which: Any) -> Steps:
    """One step further on a way, if there is one."""
    return None if steps is None else (*steps, (how, which))


def told(steps: Steps) -> str:
    """A way in words."""
    if steps is None:
        return "in a mapping or table"
    return "".join(f".{name}" if how == "attribute" else f"[{name}]" for how, name in steps) or "the whole"


class _Digest(_Walk):
    """Content as a digest, and on the way the place of every object."""

    def __init__(self) -> None:
        self.where: dict[int, tuple[tuple[str, Any], ...]] = {}
        self.modules: set[str] = set()
        self._known: dict[int, str] = {}
        self._alive: list[Any] = []

    def met(self, value: Any, steps: Steps, make: Callable[[], Node]) -> Node:
        known = self._known.get(id(value))
        if known is None:
            self._alive.append(value)  # for as long as it lives its number is nobody else's
            self._known[id(value)] = "met within itself"
            module = (value if isinstance(value, type | types.FunctionType) else type(value)).__module__
            if module.partition(".")[0] in PACKAGES:
                self.modules.add(module)
            if steps is not None and _is_shared(value):
                self.where[id(value)] = steps
            text = json.dumps(_posterior(value) or make(), separators=(",", ":"))
            known = self._known[id(value)] = hashlib.sha256(text.encode()).hexdigest()
        return ["content", known]

    def array(self, value: np.ndarray) -> Node:
        little = np.ascontiguousarray(value, dtype=value.dtype.newbyteorder("<"))
        return ["array", little.dtype.str, list(value.shape), hashlib.sha256(little.tobytes()).hexdigest()]


def _posterior(value: Any) -> Node:
    """Digest of a posterior, whether it was sampled or read; None for anything else."""
    kind = type(value)
    if f"{kind.__module__}:{kind.__qualname__}" != POSTERIOR:
        return None
    from models.posterior_files import SEALED, content_digest

    said = {
        "protocol": value.protocol.to_dict(), "gate": vars(value.gate), "settings": dict(value.settings),
        "emission_weights": value.emission_weights.tolist(),
    }  # fmt: skip
    sealed = {name: json.dumps(content) for name, content in said.items()}
    # How long sampling took is sealed in its file too, and determines nothing.
    return ["posterior", content_digest(value.data, dict.fromkeys(SEALED, 0.0) | sealed)]


class Given:
    """What a result is computed from: its digest, and the place of every object in it.

    Parameters
    ----------
    value : object
        Usually a mapping of names to arguments.

    Attributes
    ----------
    digest : str
    where : dict of int to steps
        The way to every object, by its `id`.
    modules : set of str
        Where the functions and the classes of the objects in it come from: their code may determine a result, too.

    Raises
    ------
    NotContent
        If something in it has no content, such as a function made within a function.
    """

    def __init__(self, value: Any) -> None:
        walk = _Digest()
        self.value = value
        self.digest = hashlib.sha256(json.dumps(walk.node(value, ())).encode()).hexdigest()
        self.where, self.modules = walk.where, walk.modules
        self._walk = walk


class _Writer(_Walk):
    def __init__(self, given: Given) -> None:
        self.arrays: list[np.ndarray] = []
        self._given = given
        self._seen: dict[int, int] = {}
        self._alive: list[Any] = []

    def met(self, value: Any, steps: Steps, make: Callable[[], Node]) -> Node:
        if not _is_shared(value):
            return make()
        if id(value) in self._given.where:
            return ["given", [list(step) for step in self._given.where[id(value)]]]
        if id(value) in self._seen:
            return ["again", self._seen[id(value)]]
        self._alive.append(value)
        self._seen[id(value)] = len(self._seen)
        return ["first", self._seen[id(value)], make()]

    def array(self, value: np.ndarray) -> Node:
        # Sums depend on how axes lie in memory: the array that comes back lies as this one does.
        axes = sorted(range(value.ndim), key=lambda i: -abs(value.strides[i]))
        self.arrays.append(np.ascontiguousarray(value.transpose(axes)).reshape([value.shape[i] for i in axes]))
        return ["array", len(self.arrays) - 1, axes, bool(value.flags.writeable)]


def to_content(value: Any, given: Given) -> tuple[Node, list[np.ndarray]]:
    """Content of a result, and the arrays that it speaks of by number (`analysis.result_reading` reads it).

    Raises
    ------
    NotContent
        If there is something in it that has no content.
    """
    writer = _Writer(given)
    return writer.node(value, ()), writer.arrays
