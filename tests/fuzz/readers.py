"""Every reader of a file that somebody else may have made: its function, valid files, and how they are damaged."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from itertools import islice
from pathlib import Path
from tempfile import TemporaryDirectory

from analysis import kept_chains, stored_results
from analysis.column_map import read_map
from analysis.draws_source import read_draws
from analysis.event_files import read_events
from analysis.event_import import import_events
from analysis.event_stream import Sizes, compress_events
from analysis.evidence import read_evidence
from analysis.fits_inventory import _entry
from analysis.grouping import from_file
from analysis.mixed_model_table import typed_table
from analysis.play import messages
from analysis.play.event_rows import EventRows
from analysis.play.journal import FILE as PEOPLE
from analysis.play.journal import Journal
from analysis.play.log_lock import LogLock
from analysis.play.study_setup import FILE as SETUP
from analysis.play.study_setup import SetupFile
from analysis.repeated_measures import RepeatedMeasures
from analysis.report.analysis_plan import read_analysis_plan
from analysis.stated_reward import read_values
from models.errors import InputError
from models.game.layout import Layout
from models.game.parameters import GameParameters
from models.game.record import read_records, replay
from models.model_files import read_json, read_model
from models.planning.formats import read_problem
from models.planning.policy_files import read_policy
from models.protocol import PUBLISHED, Protocol
from models.runtime import Session
from models.safeguards.replay import verify
from tests.analysis.event_text import text as event_text
from tests.fuzz import seeds
from tests.fuzz.binary import some_arrays, some_log, some_netcdf, some_parquet, some_record
from tests.fuzz.mutations import JSON, TABLE, TEXT, Damage, any_of, lines_of, packed


@dataclass(frozen=True)
class Reader:
    """One way by which a file comes in.

    Attributes
    ----------
    name, suffix : str
    read : callable
        Of a path; also uses what was read as the commands do first.
    seeds : callable
        Valid files, as bytes, made in a folder.
    damage : callable
    cheap : int
        Damaged files in the default suite.
    """

    name: str
    suffix: str
    read: Callable[[Path], object]
    seeds: Callable[[Path], Sequence[bytes]]
    damage: Damage
    cheap: int = 200

    @property
    def file(self) -> str:
        """Name of a file for it."""
        return f"given{self.suffix}"


def _streamed(path: Path) -> object:
    """In parts of a few rows, so that runs cross from part to part."""
    return compress_events(path, PUBLISHED, sizes=Sizes(rows=2))


def _raw(path: Path) -> object:
    column_map = path.with_name("map.toml")
    column_map.write_text(seeds.PLAIN_MAP)
    return import_events(path, column_map)


def _group_file(path: Path) -> object:
    return from_file(path, "kind", ("emission",), _log())


@cache
def _log():
    with TemporaryDirectory() as folder:
        path = Path(folder) / "e.csv"
        path.write_text(event_text())
        return read_events(path).log


def _table(path: Path) -> object:
    frame = typed_table(path, "tokens ~ round + (1|id)")
    measures = {"dv": "tokens", "between": "policy", "within": "round", "subject": "id"}
    from analysis.repeated_measures import check_columns
    from analysis.table_files import read_table

    raw = read_table(path, list(measures.values()))
    check_columns(raw, {f"--{role}": name for role, name in measures.items()}, str(path))
    return frame, RepeatedMeasures.from_frame(raw, **measures, place=str(path))


def _policy(path: Path) -> object:
    policy, told = read_policy(path), []
    for mode in range(len(policy.vocabulary.modes)):
        with suppress(InputError):  # plans begin in some modes only: that is for use, not for reading
            told.append(policy.probabilities(policy.begin(mode)).sum())
    return told


_ABOUT = {"sampler": {"chains": 4, "draws": 5}}


def _chain(path: Path) -> object:
    own = path.with_name("1.npz")
    shutil.copy(path, own)
    return kept_chains.read_chain(own, _ABOUT)


def _result(path: Path) -> object:
    try:
        return stored_results.read_result(path, seeds.GIVEN), stored_results.read_about(path)
    except stored_results.UNREADABLE as error:
        raise InputError(f"{path}: {error}") from None


def _restored(path: Path) -> object:
    session = Session.restore(path)
    session.close()
    return session


def _replayed(path: Path) -> object:
    return [list(islice(replay(r, str(path)), 5_000)) for r in read_records(path)]


def _in_study(path: Path, name: str, use: Callable[[LogLock], object]) -> object:
    """A file in the folder of a study of its own."""
    folder = path.parent / "study_rounds"
    folder.mkdir(exist_ok=True)
    shutil.copy(path, folder / name)
    lock = LogLock(path.parent / "study.csv")
    try:
        return use(lock)
    except InputError as error:
        raise InputError(str(error).replace(name, f"{name} ({path.name})")) from None
    finally:
        lock.close()


def _setup(path: Path) -> object:
    return _in_study(path, SETUP, lambda lock: SetupFile(lock.folder))


def _message(path: Path) -> object:
    try:
        return messages.parse(path.read_bytes().decode("utf-8", "replace"))
    except messages.BadMessage as error:
        raise InputError(f"{path}: {error}") from None


def _evidence(path: Path) -> object:
    found = read_evidence(path.stem, path.parent)
    return None if found is None else (found.sentence, found.changes, found.stale, found.provenance)


def _values(path: Path) -> object:
    return read_values([str(path)], PUBLISHED)


_ALL = (
    Reader("events-csv", ".csv", read_events, seeds.csv_logs, TABLE),
    Reader("events-gz", ".csv.gz", read_events, seeds.gzipped_logs, packed(TABLE)),
    Reader("events-parquet", ".parquet", read_events, seeds.parquet_logs, some_parquet, 80),
    Reader("events-stream", ".csv", _streamed, seeds.csv_logs, TABLE, 60),
    Reader("events-stream-parquet", ".parquet", _streamed, seeds.parquet_logs, some_parquet, 60),
    Reader("column-map", ".toml", lambda p: read_map(p, PUBLISHED), seeds.maps, TEXT),
    Reader("raw-export", ".csv", _raw, lambda _: [seeds.RAW.encode()], TABLE, 100),
    Reader("groups", ".csv", _group_file, lambda _: seeds.GROUPS, TABLE),
    Reader("table-csv", ".csv", _table, lambda _: [seeds.MEASURES.encode()], TABLE, 40),
    Reader("table-parquet", ".parquet", _table, seeds.table_parquet, some_parquet, 40),
    Reader("protocol", ".toml", Protocol.from_toml, lambda _: [PUBLISHED.to_toml().encode()], TEXT),
    Reader("analysis-plan", ".toml", read_analysis_plan, lambda _: [seeds.PLAN], TEXT),
    Reader("model", ".json", read_model, seeds.models_of, JSON),
    Reader("draws", ".json", lambda p: read_draws(p, draws=2), seeds.draws, JSON),
    Reader("values", ".json", _values, lambda _: seeds.VALUES, JSON),
    Reader("policy", ".json", _policy, seeds.policies, JSON, 120),
    Reader("pomdp", ".pomdp", read_problem, seeds.problems(".pomdp"), TEXT, 120),
    Reader("pomdp-gz", ".pomdp.gz", read_problem, seeds.problems(".pomdp.gz"), packed(TEXT), 60),
    Reader("pomdpx", ".pomdpx", read_problem, seeds.problems(".pomdpx"), TEXT, 100),
    Reader("pomdpx-gz", ".pomdpx.gz", read_problem, seeds.problems(".pomdpx.gz"), packed(TEXT), 60),
    Reader("posterior", ".nc", lambda p: read_draws(p, draws=2), lambda _: [seeds.fit()], some_netcdf, 6),
    Reader("fit-listed", ".nc", _entry, lambda _: [seeds.fit()], some_netcdf, 5),
    Reader("kept-chain", ".npz", _chain, seeds.chains, some_arrays),
    Reader("stored-result", ".npz", _result, seeds.results, some_arrays),
    Reader("session-log", ".log", verify, seeds.logs, any_of(some_log, lines_of(JSON)), 100),
    Reader("session-restored", ".log", _restored, seeds.logs, any_of(some_log, lines_of(JSON)), 100),
    Reader("round-record", ".jsonl", _replayed, seeds.records, lines_of(any_of(some_record, JSON)), 60),
    Reader("layout", ".txt", Layout.from_file, seeds.layouts, TEXT),
    Reader("game-parameters", ".json", lambda p: GameParameters.from_dict(read_json(p), str(p)),
           lambda _: [seeds.as_json(GameParameters().to_dict())], JSON),
    Reader("evidence", ".json", _evidence, seeds.evidence, JSON, 100),
    Reader("played-rows", ".csv", lambda p: EventRows(p, "s"), lambda _: [seeds.played().encode()], TABLE),
    Reader("people", ".jsonl", lambda p: _in_study(p, PEOPLE, Journal), seeds.people, lines_of(JSON)),
    Reader("study-setup", ".json", _setup, seeds.setups, JSON),
    Reader("page-message", ".txt", _message, lambda _: seeds.MESSAGES, JSON),
)  # fmt: skip


READERS = {reader.name: reader for reader in _ALL}
