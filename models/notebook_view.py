"""How a result shows itself in a notebook: warnings first, its sentence, and the first rows of its table.

One view for all results. Colours are those of the page, so that it reads on light and dark grounds; everything is
escaped; numbers are rounded for reading, and the caption says where all of them are.
"""

from __future__ import annotations

import html
import inspect
import math
import re
import textwrap
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, fields, is_dataclass, replace
from typing import TYPE_CHECKING, Any, ClassVar

from models.cautions import BEGINS, caution_line, cautions_of, repeating, together, uncautioned

if TYPE_CHECKING:
    import pandas as pd

MOST_ROWS, MOST_COLUMNS, MOST_LETTERS = 20, 14, 60
"""Rows and columns of a table, and letters of a cell, that are shown."""

MADE_FROM = ("draws", "schedule", "batch", "problem", "solution", "plan", "learned_plan")
"""Fields of a result whose cautions are its own."""

REPR_LETTERS = 240
"""Letters of the plain representation."""

UNITS: Mapping[str, str] = {
    "log_likelihood": "nats", "elpd": "nats", "elpd_diff": "nats", "kfold_diff": "nats", "dse": "nats",
    "kfold_dse": "nats", "value": "reward units", "lost": "reward units", "worth": "reward units",
    "regret": "reward units", "cvar": "reward units", "seconds": "s", "tokens": "tokens",
}  # fmt: skip
"""Units of columns that mean the same in every table; a class adds its own as `_units`."""

WORTHS = tuple(name for name, unit in UNITS.items() if unit == "reward units")
"""Columns that are in the unit of the reward, whatever it is called (`unit_of`)."""

WHOSE: Mapping[str, str] = {
    "real": "real people", "simulated": "simulated: nobody took part", "unstated": "supplied file of unknown kind",
    "printed": "printed in the paper", "definition": "definition: no data",
}  # fmt: skip
"""What is said of where numbers come from."""

_STYLE = (
    "<style>.prosocial-view{max-width:60rem;line-height:1.45}.prosocial-view p{margin:.3em 0}"
    ".prosocial-view .warning{border-left:.3em solid #c2571a;padding:.2em .7em;font-weight:600}"
    ".prosocial-view .faint{opacity:.75;font-size:.9em}.prosocial-view .scroll{overflow-x:auto}"
    ".prosocial-view table{border-collapse:collapse;font-variant-numeric:tabular-nums;margin:.4em 0}"
    ".prosocial-view caption{text-align:left;opacity:.75;font-size:.9em;padding:.2em 0}"
    ".prosocial-view :is(th,td){padding:.15em .7em;text-align:right;border-bottom:1px solid rgba(128,128,128,.35)}"
    ".prosocial-view :is(th,td).text{text-align:left}.prosocial-view thead th{vertical-align:bottom}</style>"
)


@dataclass(frozen=True)
class Rows:
    """A table of a view.

    Attributes
    ----------
    frame : DataFrame
        At least its first rows.
    total : int
        Rows that there are.
    where : str
        Where all of them are, as it is written in code.
    title : str
    """

    frame: pd.DataFrame
    total: int
    where: str = ""
    title: str = ""


@dataclass(frozen=True)
class View:
    """What is shown of a result.

    Attributes
    ----------
    heading : str
    whose : str
        A key of `WHOSE`, or empty where nobody knows.
    warnings : tuple of str
        Why not to trust it; shown first.
    notes : tuple of str
        What must be known before it is read; shown next.
    sentences : tuple of str
    tables : tuple of Rows
    units : mapping of column to unit
        Beside `UNITS`.
    """

    heading: str
    whose: str = ""
    warnings: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    sentences: tuple[str, ...] = ()
    tables: tuple[Rows, ...] = ()
    units: Mapping[str, str] = field(default_factory=dict)


class NotebookView:
    """A result that shows itself in notebooks (HTML) and prints as one line.

    By default it shows `warnings` (or `warning`), `notes`, `sentence` (or `sentences`, `text`) and `table` (a
    frame; or `summary()`, or `rows()`), whichever the class has. A class with more to say overrides `_view`. With
    ``plain=True`` as class argument it keeps its own plain representation, as settings do.

    What was made from doubtful draws says so without any doing of its class: the view warns, and `sentence` ends
    with the line of the `cautions`.
    """

    __slots__ = ()
    _heading: ClassVar[str] = ""
    _whose: str = ""
    _units: ClassVar[Mapping[str, str]] = {}

    def __init_subclass__(cls, *, plain: bool = False, **others: Any) -> None:
        super().__init_subclass__(**others)
        if not plain and "__repr__" not in cls.__dict__:
            # In the class itself, or the dataclass decorator would write one that dumps every array.
            cls.__repr__ = NotebookView.__repr__  # type: ignore[method-assign]
        said = cls.__dict__.get("sentence")
        if isinstance(said, property) and said.fget is not None:
            setattr(cls, "sentence", property(repeating(said.fget)))  # noqa: B010

    @property
    def cautions(self) -> tuple[str, ...]:
        """Why not to trust what this was made from (`models.cautions`); empty where nothing is known against it."""
        own = getattr(type(self), "__dataclass_fields__", {})
        return together(*(cautions_of(getattr(self, name)) for name in MADE_FROM if name in own))

    def _view(self) -> View:
        return default_view(self)

    def _repr_html_(self) -> str:
        return view_html(_cautious_view(self), unit_of(self))

    def __repr__(self) -> str:
        """One line: the kind of result, whether there are warnings, and its sentence."""
        view = self._view()
        said = uncautioned(" ".join(view.sentences or view.warnings), self.cautions)
        warned = f"{len(view.warnings)} warning{'s' * (len(view.warnings) > 1)}; " if view.warnings else ""
        line = f"{caution_line(self.cautions)} " if self.cautions else ""
        text = textwrap.shorten(f"{line}{warned}{said}", REPR_LETTERS, placeholder=" ...")
        return f"<{type(self).__name__}: {text}>"


def _cautious_view(result: Any) -> View:
    """The view of a result, its cautions above everything else and nowhere a second time."""
    view: View = result._view()
    if not result.cautions:
        return view
    told = tuple(uncautioned(text, result.cautions) for text in view.sentences)
    line = caution_line(result.cautions).removeprefix(BEGINS)
    return replace(view, warnings=(line, *view.warnings), sentences=told)


def default_view(result: Any) -> View:
    """The view of a result by the names that results of this house have in common."""
    warnings, notes = _texts(result, "warnings", "warning"), _texts(result, "notes")
    said = _texts(result, "sentence", "sentences", "text")
    if not said and not warnings:
        held = ", ".join(facts(result).values())
        said = [f"{held}."] if held else []
    return View(
        heading_of(result), result._whose, tuple(warnings), tuple(notes), tuple(said), tuple(_tables(result)),
        result._units,
    )  # fmt: skip


def heading_of(result: Any) -> str:
    """What a result is, in words.

    Examples
    --------
    >>> class PlanList(NotebookView): pass
    >>> heading_of(PlanList())
    'Plan list'
    """
    words = re.findall(r"[A-Z]+(?=[A-Z][a-z])|[A-Z][a-z0-9]*|\d+", type(result).__name__)
    return str(result._heading or " ".join(words).capitalize())


def unit_of(result: Any) -> str | None:
    """What a result's values are in: its own `unit`, else that of what it was made from; None where nothing says.

    Examples
    --------
    >>> from models.reward import Reward
    >>> @dataclass
    ... class Made:
    ...     plan: object
    >>> unit_of(Made(Made(Reward((0.0, 1.0), unit="points")))), unit_of(Made("HRH"))
    ('points', None)
    """
    unit = getattr(result, "unit", None)
    if isinstance(unit, str):
        return unit
    own = getattr(type(result), "__dataclass_fields__", {})
    found = (unit_of(getattr(result, name)) for name in (*MADE_FROM, "reward") if name in own)
    return next((unit for unit in found if unit is not None), None)


def facts(result: Any) -> dict[str, str]:
    """Numbers and names that a result holds, and the shapes of its arrays, as ``name = value``."""
    out = {}
    for own in fields(result) if is_dataclass(result) else ():
        value = getattr(result, own.name)
        if getattr(value, "ndim", 0) and hasattr(value, "dtype"):
            out[own.name] = f"{own.name}[{', '.join(map(str, value.shape))}]"
        elif isinstance(_plain(value), bool | int | float | str):
            out[own.name] = f"{own.name} = {cell(value)}"
    return out


def frame_rows(rows: Iterable[Mapping[str, Any]], where: str = "", title: str = "") -> Rows:
    """A table of rows that are mappings."""
    import pandas as pd

    every = list(rows)
    return Rows(pd.DataFrame(every), len(every), where, title)


def table_rows(frame: pd.DataFrame, where: str = "", title: str = "") -> Rows:
    """A table of a whole data frame."""
    return Rows(frame, len(frame), where, title)


def _texts(result: Any, *names: str) -> list[str]:
    """The first of some attributes that has something to say."""
    for name in names:
        found = _asked(result, name)
        found = [found] if isinstance(found, str) else found
        if isinstance(found, list | tuple) and found:
            texts = [str(getattr(own, "text", own)) for own in found]
            if any(texts):
                return [text for text in texts if text]
    return []


def _tables(result: Any) -> list[Rows]:
    import pandas as pd

    for name in ("table", "summary", "rows"):
        found = _asked(result, name)
        called = f".{name}()" if callable(getattr(type(result), name, None)) else f".{name}"
        if isinstance(found, pd.DataFrame):
            return [table_rows(found, called)]
        if isinstance(found, list) and found and all(isinstance(own, Mapping) for own in found):
            return [frame_rows(found, called)]
    return []


def _asked(result: Any, name: str) -> Any:
    """An attribute, or what a method returns that needs no argument."""
    found = getattr(result, name, None)
    if not callable(found):
        return found
    needed = [p for p in inspect.signature(found).parameters.values() if p.default is p.empty]
    return None if needed else found()


# -- numbers and cells ---------------------------------------------------------------------------------
def decimals_of(values: Iterable[float]) -> int | None:
    """Decimals of a column: three digits of its largest number or more; None where all are tiny.

    Examples
    --------
    >>> decimals_of([0.25, 0.5]), decimals_of([-813.2, 12.0]), decimals_of([3e-6, 2e-5]), decimals_of([25_000.4])
    (3, 2, None, 1)
    """
    size = [abs(v) for v in values if math.isfinite(v) and v]
    if not size:
        return 3
    largest = max(size)
    if largest < 0.01:
        return None
    return 1 if largest >= 10_000 else 2 if largest >= 10 else 3


def cell(value: Any, decimals: int | None = 3) -> str:
    """A cell as plain text.

    Examples
    --------
    >>> [cell(v) for v in (1234567, -0.25, float("nan"), float("inf"), True, None, "help")]
    ['1,234,567', '\N{MINUS SIGN}0.250', '\N{EN DASH}', '\N{INFINITY}', 'yes', '\N{EN DASH}', 'help']
    """
    if value is None:
        return "\N{EN DASH}"
    value = _plain(value)
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, int):
        return f"{int(value):,}".replace("-", "\N{MINUS SIGN}")
    if isinstance(value, float):
        if math.isnan(value):
            return "\N{EN DASH}"
        if math.isinf(value):
            return "\N{INFINITY}" if value > 0 else "\N{MINUS SIGN}\N{INFINITY}"
        if decimals is not None and 0 < value < 0.5 * 10.0**-decimals:
            return f"<{10.0**-decimals:.{decimals}f}"
        text = f"{float(value):.3g}" if decimals is None else f"{float(value):,.{decimals}f}"
        return re.sub(r"^-(?=0(\.0*)?$)", "", text).replace("-", "\N{MINUS SIGN}")
    if isinstance(value, list | tuple):
        value = ", ".join(map(str, value))
    text = str(value)
    return text if len(text) <= MOST_LETTERS else f"{text[: MOST_LETTERS - 3]}..."


def _numeric(values: Iterable[Any]) -> bool:
    plain = [_plain(v) for v in values]
    return all(v is None or (isinstance(v, int | float) and not isinstance(v, bool)) for v in plain)


def _plain(value: Any) -> Any:
    """A number of numpy's as one of Python's; numpy itself is not loaded here, which settings have no need of."""
    return value.item() if hasattr(value, "dtype") and not getattr(value, "ndim", 1) else value


# -- HTML ----------------------------------------------------------------------------------------------
def view_html(view: View, unit: str | None = None) -> str:
    """A view as one element of HTML, with nothing in it that is not escaped.

    Parameters
    ----------
    view : View
    unit : str, optional
        What values are in, where it is not reward units.
    """
    units = {**UNITS, **dict.fromkeys(WORTHS if unit else (), unit or ""), **view.units}
    whose = f' <span class="faint">({html.escape(WHOSE.get(view.whose, view.whose))})</span>' if view.whose else ""
    parts = [f"<p><strong>{html.escape(view.heading)}</strong>{whose}</p>"]
    parts += [f'<p class="warning" role="note">Warning: {html.escape(text)}</p>' for text in view.warnings]
    parts += [f'<p class="faint" role="note">Note: {html.escape(text)}</p>' for text in view.notes]
    parts += [f"<p>{html.escape(text)}</p>" for text in view.sentences]
    parts += [_table_html(rows, units) for rows in view.tables if len(rows.frame.columns)]
    return f'<div class="prosocial-view">{_STYLE}{"".join(parts)}</div>'


def _table_html(rows: Rows, units: Mapping[str, str]) -> str:
    import pandas as pd

    frame = rows.frame
    named = not isinstance(frame.index, pd.RangeIndex)
    shown = frame.iloc[:MOST_ROWS, :MOST_COLUMNS]
    columns = [shown.iloc[:, i].tolist() for i in range(shown.shape[1])]
    if named:
        columns.insert(0, [", ".join(map(str, v)) if isinstance(v, tuple) else v for v in shown.index])
    heads = [*([", ".join(str(n) for n in frame.index.names if n is not None)] if named else []), *shown.columns]
    number = [_numeric(values) for values in columns]
    places = [
        decimals_of(float(v) for v in values if v is not None) if ok else 3
        for values, ok in zip(columns, number, strict=True)
    ]
    # What names a row is the index, or a first column of words.
    first = named or (bool(columns) and not number[0])
    head = "".join(_heading_html(str(name), ok, units) for name, ok in zip(heads, number, strict=True))
    body = []
    for i in range(len(shown)):
        cells = []
        for j, values in enumerate(columns):
            text = html.escape(cell(values[i], places[j]))
            kind = "" if number[j] else ' class="text"'
            cells.append(f'<th scope="row"{kind}>{text}</th>' if j == 0 and first else f"<td{kind}>{text}</td>")
        body.append(f"<tr>{''.join(cells)}</tr>")
    left = [
        f"{rows.total - len(shown):,} more row{'s' * (rows.total - len(shown) > 1)}" * (rows.total > len(shown)),
        f"{frame.shape[1] - shown.shape[1]} more columns" * (frame.shape[1] > shown.shape[1]),
    ]
    more = " and ".join(text for text in left if text)
    where = html.escape(rows.where)
    note = f"{more} in <code>{where}</code>" if more and where else more
    note = note or (f"rounded; as computed in <code>{where}</code>" if where else "rounded")
    title = f"{html.escape(rows.title)}; " if rows.title else ""
    return (
        f'<div class="scroll"><table><caption>{title}{note}</caption><thead><tr>{head}</tr></thead>'
        f"<tbody>{''.join(body)}</tbody></table></div>"
    )


def _heading_html(name: str, number: bool, units: Mapping[str, str]) -> str:
    unit = f' <span class="faint">({html.escape(units[name])})</span>' if name in units else ""
    kind = "" if number else ' class="text"'
    return f'<th scope="col"{kind}>{html.escape(name)}{unit}</th>'
