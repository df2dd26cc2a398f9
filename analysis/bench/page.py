"""The page of benchmarks in the documentation, made from the stored results: missed targets first."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from html import escape
from typing import Any

from analysis.bench.cost_figures import cost_figures
from analysis.bench.cost_model import BEYOND, DRIFT, LEVEL, WORDS, fit_all
from analysis.bench.cost_prediction import amount, interval, predictions
from analysis.bench.curves import AXES
from analysis.bench.halves import judge_halves
from analysis.bench.results import SUITES, judged, points_of
from analysis.bench.timing import PEERS
from analysis.figures.style import to_svg

EXAMPLES: tuple[dict[str, float], ...] = (
    {"people": 1e6, "rounds": 20, "states": 4}, {"people": 1e8, "rounds": 20, "states": 4},
    {"people": 1e4, "rounds": 1_000, "states": 6}, {"draws": 1e6, "horizon": 9, "states": 4},
    {"game_rounds": 1e6},
)  # fmt: skip
"""Work whose predicted cost the page shows."""


def page(content: Mapping[str, Any]) -> tuple[str, dict[str, str]]:
    """The page in Markdown, and its figures as SVG by file name.

    Parameters
    ----------
    content : mapping
        Of `analysis.bench.results.read_results`.
    """
    parts = [_head(content), *_targets(content), *_rows(content)]
    points = points_of(content)
    figures: dict[str, str] = {}
    if points:
        more, figures = _curves(points)
        parts += more
    parts += _machine(content)
    return "\n\n".join(parts) + "\n", figures


# -- sections --------------------------------------------------------------------------------------
def _head(content: Mapping[str, Any]) -> str:
    missing = [f"{name} ({words})" for name, words in SUITES.items() if name not in content["suites"]]
    runs = table(
        ("suite", "what it is about", "command", "measured on", "load before and after", "processors", "took"),
        [
            (
                f"[{name}](#{name.replace('_', '-')})", SUITES.get(name, ""), f"`{suite['command']}`",
                suite["date"],
                " and ".join("?" if x is None else f"{x:g}" for x in suite["load"]), suite["processors"],
                f"{suite['seconds']:,.0f} s",
            )
            for name, suite in content["suites"].items()
        ],
    )  # fmt: skip
    return "\n\n".join(
        (
            "# Benchmarks",
            f"{content['sentence']} This page is made from the stored results (`reports/evidence/bench.json`) "
            "whenever the documentation is built. `make bench` measures anew; with "
            '`ARGS="all --out reports/evidence/bench.json"` it replaces what is shown here.',
            "Ours and the peer's calls are timed in turn in one run. Times are CPU seconds unless a unit says "
            "*wall*; what other work a machine has to do bears on them less than on the clock, but it does "
            "(caches, memory), so the load is beside every suite. Cells hold the median, the smallest and largest "
            "value, and how many were measured. A suite whose command says `--quick` was measured with fewer "
            "repeats and smaller sizes.",
            runs,
            *([f"No results are stored of: {', '.join(missing)}."] if missing else []),
        )
    )


def _targets(content: Mapping[str, Any]) -> list[str]:
    found = judged(content)
    words = {
        "missed": "Targets that were missed", "not judged": "Targets that could not be judged",
        "met": "Targets that were met",
    }  # fmt: skip
    parts = []
    for key, title in words.items():
        rows = found[key]
        if not rows:
            parts += [f"## {title}", "None."]
            continue
        parts += [f"## {title}", _row_table(rows, with_target=True)]
    return parts


def _row_table(rows: Sequence[tuple[str, Mapping[str, Any]]], *, with_target: bool) -> str:
    head = ("what", "target", "measured", "ours", "peer", "ratio", "note")
    lines = []
    for suite, row in rows:
        name = f"{row['name']} ({suite})" if with_target else row["name"]
        target = f"{row['target']}{_goal(row)}"
        lines.append(
            (
                plain(name), plain(target), _measured(row), f"{_side(row, 'ours')} {plain(row['unit'])}",
                _peer(row), "" if row["ratio"] is None else f"{row['ratio']:.3g}", plain(row["note"]),
            )
        )  # fmt: skip
    keep = [i for i, name in enumerate(head) if with_target or name not in ("measured",)]
    return table([head[i] for i in keep], [[line[i] for i in keep] for line in lines])


def _goal(row: Mapping[str, Any]) -> str:
    goal = row.get("goal")
    if not goal:
        return ""
    words = [] if goal["of"] in ("ours", "ratio") else [f"{goal['of']} {goal['sense']} {goal['number']:g}"]
    words += [f"and {goal['also']}"] if goal["also"] else []
    return f" ({', '.join(words)})" if words else ""


def _measured(row: Mapping[str, Any]) -> str:
    value = row.get("measured")
    return "n/a" if value is None else f"**{value:.4g}**"


def _side(row: Mapping[str, Any], side: str) -> str:
    span, times = row.get(f"{side}_range"), row.get("repeats" if side == "ours" else "peer_repeats", 0)
    text = f"{row[side]:.4g}"
    if span and times and times > 1:
        text += f" ({span[0]:.3g} to {span[1]:.3g}, {times} times)"
    elif times == 1:
        text += " (once)"
    return text


def _peer(row: Mapping[str, Any]) -> str:
    if row["peer"] is not None:
        return f"{plain(row['peer_name'])}: {_side(row, 'peer')}"
    return f"{plain(row['peer_name'])}: n/a (see the note)" if row["peer_name"] else ""


def _rows(content: Mapping[str, Any]) -> list[str]:
    parts = []
    for name, suite in content["suites"].items():
        parts.append(f"## {name} {{ #{name.replace('_', '-')} }}")
        words = SUITES.get(name, "")
        parts.append(f"{words[:1].upper()}{words[1:]}; `{suite['command']}`.")
        if suite["rows"]:
            parts.append(_row_table([(name, row) for row in suite["rows"]], with_target=False))
        if suite.get("points"):
            parts.append(f"{len(suite['points'])} points, shown under [Cost curves](#cost-curves).")
    return parts


def _curves(points: Sequence[Mapping[str, Any]]) -> tuple[list[str], dict[str, str]]:
    parts = [
        "## Cost curves",
        "Every point is measured in a fresh process; memory is the most that the process held, interpreter and "
        "libraries included. *All different* are people who toss coins, so that hardly any history comes twice: "
        "the worst case. Dots are medians with their ranges, lines the fitted model below, bands its "
        f"{LEVEL:.0%} intervals.",
    ]
    figures: dict[str, str] = {}
    for name, (title, drawn) in cost_figures(points).items():
        file = f"benchmarks-{name}.svg"
        figures[file] = to_svg(drawn) + "\n"
        parts.append(f'<img class="figure" loading="lazy" src="{file}" alt="{escape(title, quote=True)}">')
    parts += _not_measured(points)
    models = fit_all(points)
    parts += [
        "## Cost model",
        "Fitted to all points by least squares of logarithms. `nodes` are events of distinct histories (beginnings "
        "in common count once), `branches` histories that the exact plan walks over. *Scatter* is the standard "
        "deviation of measured over fitted, as a share.",
        table(
            ("operation", "of", "fitted curve (seconds, bytes)", "points", "scatter", "measured from and to"),
            [
                (
                    WORDS[operation], quantity, f"`{model.formula}`", len(model.residuals), f"{model.scatter:.0%}",
                    "; ".join(f"{d} {low:.3g} to {high:.3g}" for d, (low, high) in model.ranges.items()),
                )
                for operation, forms in models.items()
                for quantity, model in forms.items()
            ],
        ),
        _halves(points),
        "### What larger work will cost",
        f"`prosocial bench predict --people 1e8 --rounds 20 --states 4` says the same for other sizes. More than "
        f"{BEYOND:g} times beyond the largest measured size, a prediction is called extrapolated, and its interval "
        f"allows for exponents that change there (by {DRIFT:g}, one standard deviation).",
        _examples(points),
    ]  # fmt: skip
    return parts, figures


def _not_measured(points: Sequence[Mapping[str, Any]]) -> list[str]:
    """Sizes that the whole suite measures and this one did not."""
    left = []
    for axis in AXES:
        known = {p[axis.driver] for p in points if p["axis"] == axis.name}
        missing = [size for size in axis.sizes if size not in known]
        if missing:
            left.append(f"{axis.name} {', '.join(f'{size:,}' for size in missing)}")
    return [f"Sizes that were not measured in this run: {'; '.join(left)}."] if left else []


def _halves(points: Sequence[Mapping[str, Any]]) -> str:
    found = judge_halves(points)
    inside = sum(f.inside for f in found)
    text = (
        f"Fitted to the smaller half of every curve alone, the model's {LEVEL:.0%} intervals hold {inside} of the "
        f"{len(found)} points of the larger halves."
    )
    out = [f for f in found if not f.inside]
    if out:
        text += " Outside: " + "; ".join(
            f"{WORDS[f.operation]}, {f.axis} {f.size:,.0f} ({f.quantity}: measured "
            f"{amount(f.measured, f.quantity)}, predicted {amount(f.predicted.value, f.quantity)})"
            for f in out
        ) + "."  # fmt: skip
    return text


def _examples(points: Sequence[Mapping[str, Any]]) -> str:
    known = {str(p["operation"]) for p in points}
    lines = []
    for sizes in EXAMPLES:
        needs = {"people": "em", "draws": "plan", "game_rounds": "game"}
        if not {needs[name] for name in sizes if name in needs} <= known:
            continue
        words = ", ".join(f"{value:,.0f} {name.replace('_', ' ')}" for name, value in sizes.items())
        for row in predictions(points, **sizes):
            costs = [f"{amount(row[q]['value'], q)} {interval(row[q], q)}" for q in ("seconds", "memory")]
            lines.append((words, WORDS[row["operation"]], *costs, row["words"]))
    return table(("work", "operation", "time", "memory", "how sure"), lines)


def _machine(content: Mapping[str, Any]) -> list[str]:
    suites = content["suites"]
    names = list(dict.fromkeys(key for suite in suites.values() for key in suite["environment"]))
    rows = []
    for name in names:
        values: dict[str, list[str]] = {}
        for suite, found in suites.items():
            values.setdefault(found["environment"].get(name, "not recorded"), []).append(suite)
        if len(values) == 1:
            text = plain(next(iter(values)))
        else:
            text = "; ".join(f"{plain(value)} ({', '.join(own)})" for value, own in values.items())
        rows.append((f"{name} (peer)" if name in PEERS else name, text))
    return ["## Machine, versions and peers", table(("", ""), rows)]


# -- Markdown --------------------------------------------------------------------------------------
def plain(text: object) -> str:
    r"""Text that Markdown leaves alone, inside a table.

    Examples
    --------
    >>> print(plain("a | b_c <d>"))
    a &#124; b\_c &lt;d&gt;
    """
    safe = str(text).replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;").replace("|", "&#124;")
    return re.sub(r"([_*\[\]`])", r"\\\1", safe)


def table(head: Sequence[object], rows: Sequence[Sequence[object]]) -> str:
    """A table in Markdown; cells are used as they are."""
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(str(cell) for cell in line) + " |" for line in lines)
