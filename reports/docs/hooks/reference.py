"""The API reference: a page a group of modules, each module with its line of ARCHITECTURE.md and its docstrings.

Docstrings are read from the source; nothing is imported. A module belongs to the first group with a pattern that
it matches. The last pattern of either folder takes whatever is left, so that no module is ever missing.
"""

from __future__ import annotations

import re
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any, NamedTuple

from mkdocs.structure.files import File, Files

ROOT = Path(__file__).resolve().parents[3]
ROW = re.compile(r"^\| `((?:models|analysis)/[\w/]+\.py)` \| (.*) \|$", flags=re.MULTILINE)


class Group(NamedTuple):
    """Modules that share a page."""

    slug: str
    title: str
    patterns: str
    """File names, with `*` for any text, separated by spaces."""


GROUPS = (
    Group(
        "models_planning_formats", "Planning: problem files",
        "models/planning/formats/* models/planning/problems/*",
    ),
    Group(
        "models_planning_policies", "Planning: policies and what they are worth",
        "models/planning/*polic* models/planning/baselines* models/planning/belief_model* "
        "models/planning/controller* models/planning/evaluation* models/planning/rollouts* "
        "models/planning/explanation* models/planning/finite_memory* models/planning/schedule* "
        "models/planning/history* models/planning/exact* models/planning/summed* models/planning/tail* "
        "models/planning/budget*",
    ),
    Group("models_planning", "Planning without a horizon", "models/planning/*"),
    Group(
        "models_robust_pools", "Planning under doubt: without a horizon",
        "models/robust/*controller* models/robust/elimination* models/robust/pool* "
        "models/robust/belief_stability* models/robust/history_stability* models/robust/wider*",
    ),
    Group(
        "models_robust_information", "Planning under doubt: what knowledge is worth",
        "models/robust/*information* models/robust/many_weights* models/robust/weights* models/robust/draw_* "
        "models/robust/block* models/robust/*study* models/robust/design* models/robust/people*",
    ),
    Group("models_robust", "Planning under doubt: plans", "models/robust/*"),
    Group("models_sensitivity", "Sensitivity", "models/sensitivity/*"),
    Group(
        "models_safeguards", "Safeguards and the robot's side",
        "models/safeguards/* models/runtime* models/file_lock*",
    ),
    Group("models_game", "The token game", "models/game/*"),
    Group("models_glmm_slopes", "The mixed model: random slopes", "models/glmm_slope*"),
    Group(
        "models_glmm_results", "The mixed model: results",
        "models/glmm_comparison* models/glmm_functions* models/glmm_in[ft]* models/glmm_marginal* "
        "models/glmm_no* models/glmm_one* models/glmm_po[s]* models/glmm_predict* models/glmm_profile* "
        "models/glmm_re[s]* models/glmm_robust* models/glmm_s[eiu][pm]* models/glmm_variance* "
        "models/glmm_warnings* models/glmm_wrapper*",
    ),
    Group("models_glmm", "The mixed model: fitting", "models/glmm*"),
    Group(
        "models_baum_welch", "Baum-Welch and identification",
        "models/baum_welch* models/em_* models/standard_errors* models/identification* models/bootstrap*",
    ),
    Group(
        "models_comparison", "Comparing models",
        "models/rivals* models/smc* models/people_folds* models/joint_predictive* models/mixed_predictive*",
    ),
    Group(
        "models_bayes_engines", "The Bayesian model: sampling",
        "models/nuts* models/chains* models/pymc_engine* models/work_clock* models/quiet* models/draw_kernels* "
        "models/likelihood_op* models/simplex_op* models/hmm_density* models/study_density* models/edited* "
        "models/added* models/model_digest*",
    ),
    Group(
        "models_bayes", "The Bayesian model",
        "models/bayes* models/groups* models/people_* models/person* models/population* models/predictive* "
        "models/fit_tree* models/relabel* models/gate* models/posterior* models/entries*",
    ),
    Group("models", "The model, events and histories", "models/*"),
    Group("analysis_figures", "Figures", "analysis/figures/*"),
    Group("analysis_report_sections", "The report's sections", "analysis/report/sections/*"),
    Group("analysis_report", "The report", "analysis/report/*"),
    Group("analysis_play", "The game for people", "analysis/play/* analysis/game*"),
    Group("analysis_bench", "Benchmarks", "analysis/bench/*"),
    Group("analysis_cli", "The command line", "analysis/cli*"),
    Group(
        "analysis_data", "Data",
        "analysis/file_source* analysis/csv_* analysis/event_files* analysis/datasets* analysis/frd2012* "
        "analysis/column_map* analysis/event_import* analysis/problem_causes* analysis/table_files* "
        "analysis/study_selection* analysis/grouping* analysis/design* analysis/simulate* "
        "analysis/participant_flow* analysis/response_rates*",
    ),
    Group("analysis_paper", "The paper's numbers", "analysis/paper_*"),
    Group(
        "analysis_statistics", "Statistics of both studies",
        "analysis/anova* analysis/*anova* analysis/dunnett* analysis/posthoc* analysis/power* "
        "analysis/regression* analysis/printed_regression* analysis/mixed_model* analysis/bayes_twin* "
        "analysis/interval* analysis/quadrature* analysis/repeated* analysis/sphericity* "
        "analysis/first_and_last* analysis/signal_by*",
    ),
    Group("analysis_study2", "Study 2", "analysis/study2* analysis/printed_study2*"),
    Group(
        "analysis_plans", "Plans, sensitivity, safeguards",
        "analysis/*polic* analysis/*robust* analysis/endless* analysis/next_studies* analysis/draws_source* "
        "analysis/reward_options* analysis/stated_reward* analysis/state_scores* analysis/own_sensitivity* "
        "analysis/sensitivity* analysis/safeguard* analysis/session* "
        "analysis/plan_replicates*",
    ),
    Group("analysis_held_out", "Predicting what was left out", "analysis/held_out* analysis/forecasters*"),
    Group(
        "analysis_evidence", "Can the method be trusted?",
        "analysis/calibration* analysis/recovery* analysis/replicates* analysis/evidence* analysis/rank_* "
        "analysis/predictive_checks* analysis/kappa*",
    ),
    Group("analysis", "Learning and comparing", "analysis/*"),
)  # fmt: skip


def rows(architecture: str) -> dict[str, str]:
    """Every module in one line: path to what it is, in the order of the table."""
    return dict(ROW.findall(architecture))


def modules(root: Path = ROOT) -> list[str]:
    """Paths of all modules of both folders; packages count where their own file says something."""
    return [
        path.relative_to(root).as_posix()
        for folder in ("models", "analysis")
        for path in sorted((root / folder).rglob("*.py"))
        if path.name != "__init__.py" and "__pycache__" not in path.parts
    ]


def grouped(paths: list[str], order: list[str]) -> dict[Group, list[str]]:
    """Modules by group, both as ARCHITECTURE.md has them; what it does not name yet comes last."""
    rank = {path: i for i, path in enumerate(order)}
    found: dict[Group, list[str]] = {group: [] for group in GROUPS}
    for path in sorted(paths, key=lambda p: (rank.get(p, len(rank)), p)):
        group = next(g for g in GROUPS if any(fnmatchcase(path, pattern) for pattern in g.patterns.split()))
        found[group].append(path)
    return {group: members for group, members in found.items() if members}


def dotted(path: str) -> str:
    """Name under which a module is imported."""
    return path.removesuffix(".py").replace("/", ".")


def page(group: Group, members: list[str], lines: dict[str, str]) -> str:
    """The page of a group in Markdown."""
    parts = [f"# {group.title}", ""]
    for path in members:
        name = dotted(path)
        # The anchor is the one that mkdocstrings would set, so that names in docstrings lead here.
        parts += [f"## `{name}` {{ #{name} }}", ""]
        parts += [f"*{lines[path]}*{{ .what }}", ""] if path in lines else []
        parts += [f"::: {name}", ""]
    return "\n".join(parts)


def index(groups: dict[Group, list[str]], lines: dict[str, str]) -> str:
    """The page that lists all modules."""
    parts = [
        "# API reference", "",
        "`models` is what the world is and how to act in it: arrays in, arrays out. `analysis` is what we ask of "
        "it. Everything below is made from the docstrings of the source; private names are left out.", "",
    ]  # fmt: skip
    ordered = sorted(groups, key=lambda g: g.slug.startswith("analysis"))
    for folder in ("models", "analysis"):
        parts += [f"## {folder}", ""]
        for group in (g for g in ordered if g.slug.split("_")[0] == folder):
            parts += [f"### [{group.title}]({group.slug}.md)", ""]
            for path in groups[group]:
                parts.append(f"- [`{dotted(path)}`]({group.slug}.md#{dotted(path)}): {lines.get(path, '')}")
            parts.append("")
    return "\n".join(parts)


def everything() -> tuple[dict[Group, list[str]], dict[str, str]]:
    """Groups with their modules, and what each module is."""
    lines = rows((ROOT / "ARCHITECTURE.md").read_text(encoding="utf-8"))
    return grouped(modules(), list(lines)), lines


def on_config(config: Any, **_: Any) -> Any:
    """Put the pages into the navigation."""
    groups, _lines = everything()
    for entry in config.nav:
        if entry.get("API") == "reference/":
            entry["API"] = ["reference/index.md"]
            for folder in ("models", "analysis"):
                own = [g for g in reversed(GROUPS) if g in groups and g.slug.split("_")[0] == folder]
                entry["API"].append({folder: [{g.title: f"reference/{g.slug}.md"} for g in own]})
    return config


def on_files(files: Files, config: Any, **_: Any) -> Files:
    """Add the pages."""
    groups, lines = everything()
    texts = {"index": index(groups, lines)} | {g.slug: page(g, members, lines) for g, members in groups.items()}
    for slug, text in texts.items():
        files.append(File.generated(config, f"reference/{slug}.md", content=text))
    return files
