"""Results read from their content: objects are put together from their fields, and no code of theirs runs."""

from __future__ import annotations

import importlib
import types
from collections.abc import Iterable, Sequence
from fractions import Fraction
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from analysis.result_content import PLAIN_TYPES, Given, Node
from analysis.source_digest import PACKAGES


def from_content(node: Node, arrays: Sequence[np.ndarray], given: Given) -> Any:
    """The result again, equal to what it was bit for bit.

    Parameters
    ----------
    node, arrays
        As `analysis.result_content.to_content` made them.
    given : Given
        Equal to what it was computed from: what the result shares with that are objects of this one.

    Raises
    ------
    ValueError
        If it is no content.
    """
    try:
        return _Reader(arrays, given).read(node)
    except (LookupError, AttributeError, TypeError, ImportError) as error:
        raise ValueError(f"no content of a result ({type(error).__name__}: {error})") from error


def found(name: str) -> Any:
    """Class or function of this house by its name."""
    module, _, inside = name.partition(":")
    if module == "builtins":
        return next(t for t in PLAIN_TYPES if t.__name__ == inside)
    if module.partition(".")[0] not in PACKAGES:
        raise ValueError(f"{name} is not of this checkout")
    thing: Any = importlib.import_module(module)
    for part in inside.split("."):
        thing = getattr(thing, part)
        if str(getattr(thing, "__module__", "")).partition(".")[0] not in PACKAGES:
            # What a module of ours imports is not ours: `models.model_files:os.system` must lead nowhere.
            raise ValueError(f"{name} is not of this checkout")
    return thing


class _Reader:
    """One method for every kind of content."""

    def __init__(self, arrays: Sequence[np.ndarray], given: Given) -> None:
        self._arrays, self._from = arrays, given
        self._objects: dict[int, Any] = {}

    def read(self, node: Node) -> Any:
        if not isinstance(node, list):
            return node
        kind, *rest = node
        return getattr(self, f"read_{kind}")(*rest)

    def all(self, nodes: Iterable[Node]) -> list[Any]:
        return [self.read(n) for n in nodes]

    # -- objects that are met more than once -------------------------------------------------------
    def read_first(self, number: int, node: Node) -> Any:
        if node[0] == "object":
            # Known before its fields are, for these may lead back to it.
            self._objects[number] = made = object.__new__(found(node[1]))
            return self._filled(made, node[2])
        self._objects[number] = made = self.read(node)
        return made

    def read_again(self, number: int) -> Any:
        return self._objects[number]

    def read_given(self, steps: list[list[Any]]) -> Any:
        value = self._from.value
        for how, name in steps:
            if how == "attribute":
                value = getattr(value, name)
            else:
                value = value[name] if how == "item" else list(value.values())[name]
        return value

    def read_object(self, name: str, fields: list[list[Any]]) -> Any:
        return self._filled(object.__new__(found(name)), fields)

    def _filled(self, made: Any, fields: list[list[Any]]) -> Any:
        for name, node in fields:
            object.__setattr__(made, name, self.read(node))  # frozen objects, too
        return made

    def read_row(self, name: str, nodes: list[Node]) -> Any:
        return tuple.__new__(found(name), self.all(nodes))

    # -- what has a name ---------------------------------------------------------------------------
    def read_member(self, name: str, member: str) -> Any:
        return found(name)[member]

    def read_named(self, name: str) -> Any:
        return found(name)

    def read_method(self, owner: Node, name: str) -> Any:
        return getattr(self.read(owner), name)

    def read_partial(self, function: Node, args: Node, keywords: Node) -> Any:
        return partial(self.read(function), *self.read(args), **self.read(keywords))

    # -- containers --------------------------------------------------------------------------------
    def read_tuple(self, nodes: list[Node]) -> Any:
        return tuple(self.all(nodes))

    def read_list(self, nodes: list[Node]) -> Any:
        return self.all(nodes)

    def read_dict(self, pairs: list[list[Node]]) -> Any:
        return {self.read(k): self.read(v) for k, v in pairs}

    def read_proxy(self, node: Node) -> Any:
        return types.MappingProxyType(self.read(node))

    def read_set(self, nodes: list[Node]) -> Any:
        return set(self.all(nodes))

    def read_frozenset(self, nodes: list[Node]) -> Any:
        return frozenset(self.all(nodes))

    # -- numbers and text --------------------------------------------------------------------------
    def read_array(self, number: int, axes: list[int], writeable: bool) -> Any:
        array = self._arrays[number].transpose(np.argsort(axes))
        array.flags.writeable = writeable
        return array

    def read_scalar(self, dtype: str, content: str) -> Any:
        return np.frombuffer(bytes.fromhex(content), dtype=np.dtype(dtype))[0]

    def read_sparse(self, name: str, shape: list[int], *parts: Node) -> Any:
        if name not in ("csr_array", "csc_array"):
            raise ValueError(f"a sparse array of an unknown kind, {name}")
        from scipy import sparse

        made = getattr(sparse, name)(tuple(shape))
        made.data, made.indices, made.indptr = self.all(parts)  # of the types that they were
        return made

    def read_objects(self, shape: list[int], nodes: list[Node]) -> Any:
        array = np.empty(len(nodes), dtype=object)
        for i, node in enumerate(nodes):
            array[i] = self.read(node)
        return array.reshape(shape)

    def read_bytes(self, node: Node) -> Any:
        return self.read(node).tobytes()

    def read_fraction(self, numerator: int, denominator: int) -> Any:
        return Fraction(numerator, denominator)

    def read_path(self, text: str) -> Any:
        return Path(text)

    # -- tables ------------------------------------------------------------------------------------
    def read_frame(self, index: Node, columns: Node, content: list[Node], attrs: Node) -> Any:
        rows = self.read(index)
        made = pd.DataFrame(
            {i: pd.Series(a, index=rows, dtype=a.dtype) for i, a in enumerate(self.all(content))}, index=rows
        )
        made.columns = self.read(columns)
        made.attrs = self.read(attrs)
        return made

    def read_series(self, index: Node, content: Node, name: Node) -> Any:
        values = self.read(content)
        return pd.Series(values, index=self.read(index), dtype=values.dtype, name=self.read(name))

    def read_range(self, start: int, stop: int, step: int, name: Node) -> Any:
        return pd.RangeIndex(start, stop, step, name=self.read(name))

    def read_levels(self, levels: Node, codes: Node, names: Node) -> Any:
        return pd.MultiIndex(self.read(levels), self.read(codes), names=self.read(names), verify_integrity=False)

    def read_index(self, content: Node, name: Node) -> Any:
        values = self.read(content)
        return pd.Index(values, dtype=values.dtype, name=self.read(name))

    def read_plain(self, node: Node) -> Any:
        return self.read(node)

    def read_categorical(self, codes: Node, categories: Node, ordered: bool) -> Any:
        return pd.Categorical.from_codes(self.read(codes), self.read(categories), ordered=ordered)

    def read_words(self, storage: str, has_na: bool, words: list[str | None]) -> Any:
        missing = pd.NA if has_na else np.nan
        dtype = pd.StringDtype(storage, na_value=missing)
        return pd.array([missing if w is None else w for w in words], dtype=dtype)
