"""Which function makes which figure and table: every output of a report with its number, origin and maker."""

from __future__ import annotations

import functools
import inspect
import types
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from analysis.report.section import Block, Figure, Part, Points, Section, Table, Text
from analysis.report.units import original

PLOTS = "analysis.figures."
"""Where plot functions live."""

NO_PLOTS = ("analysis.figures.style",)


@dataclass(frozen=True)
class Output:
    """A figure or a table of a report.

    Attributes
    ----------
    block : Figure or Table
    number : int
        As on the page.
    section : str
        Key of its section.
    above : tuple of str
        Keys of its section and of the parts it stands in.
    maker : str
        The plot functions of a figure; of a table the module of its section.
    status : str
        ``planned``, ``exploratory``, or nothing without an analysis plan.
    mark : str
        Marks of the warnings that stand beside it or above it (`analysis.report.section.Text`, `Points`).
    """

    block: Figure | Table
    number: int
    section: str
    above: tuple[str, ...]
    maker: str
    status: str = ""
    mark: str = ""

    @property
    def name(self) -> str:
        """Figure or table, with its number."""
        return f"{type(self.block).__name__} {self.number}"

    def row(self) -> dict[str, str]:
        """The output as a row of a table."""
        return {
            "output": self.name, "key": self.block.key, "section": self.section,
            "origin": ", ".join(o.label for o in self.block.origin), "made_by": self.maker, "status": self.status,
        }  # fmt: skip


def output_map(
    sections: Sequence[Section], modules: Mapping[str, str], status: Callable[[tuple[str, ...]], str] | None = None
) -> tuple[Output, ...]:
    """Every figure and table of a report, in order.

    Parameters
    ----------
    sections : sequence of Section
    modules : mapping of str to str
        By key of a section, the module that makes it.
    status : callable, optional
        From the keys above an output and its own to ``planned`` or ``exploratory``.
    """
    counts = {Figure: 0, Table: 0}
    out = []
    for section in sections:
        for block, above, marks in _walk(section.blocks, (section.key,)):
            kind = Figure if isinstance(block, Figure) else Table
            counts[kind] += 1
            module = modules.get(section.key, "")
            maker = ", ".join(plot_functions(block)) if isinstance(block, Figure) else ""
            what = status((*above, block.key)) if status is not None else ""
            mark = " ".join(marks)
            out.append(Output(block, counts[kind], section.key, above, maker or module, what, mark))
    return tuple(out)


def numbers(sections: Sequence[Section]) -> dict[str, int]:
    """Number of every figure and table, by key."""
    return {output.block.key: output.number for output in output_map(sections, {})}


def plot_functions(figure: Figure) -> list[str]:
    """Plot functions that the panels of a figure call, as ``module.function`` below `analysis.figures`.

    They are read off the panels' code, not off a list that somebody has to keep.
    """
    found: dict[str, None] = {}
    for panel in map(original, figure.panels):
        for name in _called(panel, set(), _root(panel)):
            found.setdefault(name)
    return list(found)


def _walk(
    blocks: Sequence[Block], above: tuple[str, ...], marks: tuple[str, ...] = ()
) -> Iterator[tuple[Figure | Table, tuple[str, ...], tuple[str, ...]]]:
    own = [block.mark for block in blocks if isinstance(block, Text | Points) and block.mark]
    marks = tuple(dict.fromkeys((*marks, *own)))
    for block in blocks:
        if isinstance(block, Part):
            yield from _walk(block.blocks, (*above, block.key), marks)
        elif isinstance(block, Figure | Table):
            yield block, above, marks


def _root(panel: Any) -> str:
    """First name of the module that a panel is from; only code from there is looked through."""
    while isinstance(panel, functools.partial):
        panel = panel.func
    return str(getattr(panel, "__module__", "")).partition(".")[0]


def _called(function: Any, seen: set[int], root: str) -> Iterator[str]:
    while isinstance(function, functools.partial):
        function = function.func
    if id(function) in seen:
        return
    seen.add(id(function))
    if _is_plot(function):
        yield f"{function.__module__}.{function.__qualname__}"
        return
    if not isinstance(function, types.FunctionType) or function.__module__.partition(".")[0] != root:
        return
    enclosed = inspect.getclosurevars(function).nonlocals
    yield from _named(function.__code__, {**function.__globals__, **enclosed}, seen, root)


def _named(code: types.CodeType, scope: Mapping[str, Any], seen: set[int], root: str) -> Iterator[str]:
    for name in (*code.co_names, *code.co_freevars):
        value = scope.get(name)
        if isinstance(value, types.ModuleType):
            for inner in code.co_names:
                if _is_plot(own := getattr(value, inner, None)) and own.__module__ == value.__name__:
                    yield from _called(own, seen, root)
        elif callable(value):
            yield from _called(value, seen, root)
    for constant in code.co_consts:
        if isinstance(constant, types.CodeType):
            yield from _named(constant, scope, seen, root)


def _is_plot(value: Any) -> bool:
    module = getattr(value, "__module__", None) or ""
    return isinstance(value, types.FunctionType) and module.startswith(PLOTS) and module not in NO_PLOTS
