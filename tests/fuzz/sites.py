"""Where the project opens files for reading, and which reader of the registry comes by there."""

from __future__ import annotations

import ast
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[2]

CALLS = {
    "read_text", "read_bytes", "read_csv", "read_parquet", "ParquetFile", "open_datatree", "open_dataset",
    "read_rda", "loads", "GzipFile", "ParserCreate", "decompress", "decompressobj", "readline", "memory_map",
    "OSFile", "open", "fdopen", "File", "ZipFile", "read_arrays", "limited_bytes", "text_of", "toml_of", "json_of",
}  # fmt: skip
"""Names of functions that open or parse."""


class Site(NamedTuple):
    """Readers that come by a module; or why nothing of a stranger does."""

    readers: tuple[str, ...] = ()
    why: str = ""


OWN = Site(why="files of this checkout only")

SITES: dict[str, Site] = {
    "models/compiled.py": OWN,
    "models/file_lock.py": Site(why="an empty file of its own, locked and never read"),
    "models/game/layout.py": Site(("layout",)),
    "models/game/record.py": Site(("round-record",)),
    "models/hdf5_check.py": Site(("posterior",)),
    "models/model_files.py": Site(("model", "draws", "values", "policy", "game-parameters")),
    "models/planning/formats/pomdpx_xml.py": Site(("pomdpx", "pomdpx-gz")),
    "models/planning/formats/source.py": Site(("pomdp", "pomdp-gz", "pomdpx", "pomdpx-gz")),
    "models/posterior_files.py": Site(("posterior",)),
    "models/protocol.py": Site(("protocol",)),
    "models/runtime_content.py": Site(("session-log", "session-restored")),
    "models/runtime_log.py": Site(("session-restored",)),
    "models/safeguards/audit.py": Site(("session-log", "session-restored")),
    "models/safeguards/replay.py": Site(("session-log",)),
    "models/text_files.py": Site(("model", "protocol", "column-map", "analysis-plan", "evidence", "round-record")),
    "analysis/array_archive.py": Site(("kept-chain", "stored-result")),
    "analysis/belief_explorer.py": OWN,
    "analysis/cli_play.py": Site(why="the consent text, as it is; maps and parameters by their own readers"),
    "analysis/cli_session.py": Site(why="lines of standard input, each answered or refused (tests of the command)"),
    "analysis/column_map.py": Site(("column-map",)),
    "analysis/csv_problems.py": Site(("events-csv", "raw-export")),
    "analysis/datasets.py": OWN,
    "analysis/design.py": OWN,
    "analysis/draws_source.py": Site(("draws", "posterior")),
    "analysis/event_chunks.py": Site(("events-stream", "events-stream-parquet")),
    "analysis/event_files.py": Site(("events-csv", "events-gz", "events-parquet")),
    "analysis/event_sorting.py": Site(why="files that the stream itself has just written"),
    "analysis/event_stream.py": Site(("events-stream", "events-stream-parquet")),
    "analysis/evidence.py": Site(("evidence",)),
    "analysis/figures/reward_slider.py": OWN,
    "analysis/file_source.py": Site(("events-csv", "events-gz", "raw-export", "table-csv")),
    "analysis/fits_inventory.py": Site(("fit-listed",)),
    "analysis/frd2012.py": Site(why="one file, told by its SHA-256 before anything of it is read"),
    "analysis/game_film.py": Site(why="what the film encoder has just written"),
    "analysis/game_player.py": OWN,
    "analysis/workbench.py": OWN,
    "analysis/grouping.py": Site(("groups",)),
    "analysis/kept_chains.py": Site(("kept-chain",)),
    "analysis/log_spool.py": Site(why="files that the stream itself has just written"),
    "analysis/play/event_rows.py": Site(("played-rows",)),
    "analysis/play/journal.py": Site(("people",)),
    "analysis/play/log_lock.py": Site(("people", "study-setup")),
    "analysis/play/messages.py": Site(("page-message",)),
    "analysis/play/study_setup.py": Site(("study-setup",)),
    "analysis/report/analysis_plan.py": Site(("analysis-plan",)),
    "analysis/report/drawings.py": Site(("stored-result",)),
    "analysis/report/render.py": OWN,
    "analysis/side_by_side.py": Site(("posterior",)),
    "analysis/source_digest.py": OWN,
    "analysis/stored_results.py": Site(("stored-result",)),
    "analysis/table_files.py": Site(("table-csv", "table-parquet")),
}
"""Every module that opens or parses files."""

BENCHMARKS = "analysis/bench/"
"""Measures with files that it writes itself."""


def reading_modules() -> set[str]:
    """Modules in which a function of `CALLS` is called."""
    out = set()
    for folder in ("models", "analysis"):
        for path in (ROOT / folder).rglob("*.py"):
            name = path.relative_to(ROOT).as_posix()
            calls = (n.func for n in ast.walk(ast.parse(path.read_text())) if isinstance(n, ast.Call))
            named = {f.attr if isinstance(f, ast.Attribute) else getattr(f, "id", "") for f in calls}
            if named & CALLS and not name.startswith(BENCHMARKS):
                out.add(name)
    return out
