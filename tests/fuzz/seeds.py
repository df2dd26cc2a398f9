"""Valid files of every kind, which are damaged."""

from __future__ import annotations

import gzip
import io
import json
from collections.abc import Callable
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pyarrow.csv
import pyarrow.parquet as pq

from analysis import stored_results
from analysis.event_files import write_events
from analysis.play.event_rows import HEADER as ROWS_HEADER
from analysis.play.study_setup import text_digest
from analysis.result_content import Given, to_content
from analysis.simulate import simulate_study1
from models.chains import Chain
from models.game.layout import packaged, packaged_names
from models.game.parameters import GameParameters
from models.game.record import record, write_records
from models.game.round import Round
from models.model_files import model_to_dict
from models.planning.formats import write_problem
from models.planning.policy_files import policy_to_dict
from models.protocol import PUBLISHED
from tests.analysis.draws_cases import fit_file
from tests.analysis.draws_cases import people as some_models
from tests.analysis.event_text import text as event_text
from tests.models.session_cases import KINDS, make, written
from tests.planning_cases import dense_problem, latent_case, modal_problem

WHOLE = Path(__file__).parent / "whole"


DATA = Path(__file__).resolve().parents[2] / "data"


def csv_logs(folder: Path) -> list[bytes]:
    study = folder / "study.csv"
    write_events(simulate_study1(participants=6), study)
    tokens = "\n".join(
        f"{line},{'team_tokens' if i == 0 else i}" for i, line in enumerate(event_text().splitlines())
    )
    return [event_text().encode(), study.read_bytes()[:3000].rsplit(b"\n", 1)[0] + b"\n", tokens.encode(),
            "\ufeff".encode() + event_text().replace("\n", "\r\n").encode()]  # fmt: skip


def parquet_logs(folder: Path) -> list[bytes]:
    out = []
    for content in csv_logs(folder):
        table = pyarrow.csv.read_csv(io.BytesIO(content))
        sink = io.BytesIO()
        pq.write_table(table, sink, compression="zstd")
        out.append(sink.getvalue())
    return out


def maps(_: Path) -> list[bytes]:
    own = (DATA / "maps" / "osf_study1_example.toml").read_bytes()
    return [
        own,
        b"\n".join(line for line in own.splitlines() if line and not line.startswith(b"#")),
        PLAIN_MAP.encode(),
    ]


PLAIN_MAP = """study = "s"
first_round = 1
[columns]
participant = "id"
condition = ["a", "b"]
k = "round"
mode = "opportunity"
observation = "helped"
action = "act"
team_tokens = "team"
[values]
mode = "letters"
observation = {1 = "help", 0 = "no_help"}
"""


RAW = """id,a,b,round,opportunity,helped,act,team,more
x1,1,0,1,R,,help,3,
x1,1,0,2,H,1,signal,4,
x2,0,"1",1,H,0,no_signal,,"a, b"
x2,0,1,2,R,,no_help,5,
"""


MEASURES = "id,policy,round,tokens\n" + "".join(
    f"p{i},{'ab'[i % 2]},{k},{(i * 7 + k * 3) % 11}\n" for i in range(6) for k in (1, 2)
)


def table_parquet(_: Path) -> list[bytes]:
    sink = io.BytesIO()
    pq.write_table(pyarrow.csv.read_csv(io.BytesIO(MEASURES.encode())), sink)
    return [sink.getvalue()]


def as_json(value: object) -> bytes:
    return json.dumps(value).encode()


def models_of(_: Path) -> list[bytes]:
    own = [model_to_dict(m) for m in some_models(2)]
    short = {k: v for k, v in own[0].items() if k not in ("emission", "protocol", "schema")}
    return [(DATA / "simulated" / "calibrated_truth.json").read_bytes(), as_json(own[0]), as_json(short)]


def draws(_: Path) -> list[bytes]:
    own = [model_to_dict(m) for m in some_models(3)]
    return [
        as_json(own),
        as_json([{**m, "weight": w} for m, w in zip(own, (0.2, 0.3, 0.5), strict=True)]),
        as_json(own[0]),
    ]


def policies(_: Path) -> list[bytes]:
    doubtful = policy_to_dict(make("by_mode"), ["the posterior failed its convergence gate"])
    return [*(as_json(policy_to_dict(make(kind))) for kind in KINDS), as_json(doubtful)]


def problems(suffix: str) -> Callable[[Path], list[bytes]]:
    def seeds(folder: Path) -> list[bytes]:
        out = [] if "x" in suffix else [(WHOLE / "tiger.pomdp").read_bytes()]
        cases = (
            [dense_problem(1)]
            if suffix.startswith(".pomdp.") or suffix == ".pomdp"
            else [modal_problem(1), latent_case(1)]
        )
        for problem in cases:
            path = folder / f"p{suffix.removesuffix('.gz')}"
            write_problem(problem, path)
            out.append(path.read_bytes())
        if not suffix.startswith(".pomdp.") and suffix != ".pomdp":
            out.append((WHOLE / "diagram.pomdpx").read_bytes())
        return [gzip.compress(c, mtime=0) for c in out] if suffix.endswith(".gz") else out

    return seeds


@cache
def fit() -> bytes:
    with TemporaryDirectory() as folder:
        path = Path(folder) / "fit.nc"
        fit_file(path, some_models(4), {"seed": 1, "sampler": {"chains": 1, "draws": 4}})
        return path.read_bytes()


def chains(_: Path) -> list[bytes]:
    from models.chains import STATS

    sink = io.BytesIO()
    chain = Chain(np.zeros((5, 3)), {k: np.zeros(5) for k in STATS}, 1.0)
    np.savez(sink, x=chain.x, cpu_seconds=np.float64(1.0), **chain.stats)
    return [sink.getvalue()]


GIVEN = Given({"a": 1})


def results(_: Path) -> list[bytes]:
    content, arrays = to_content({"x": np.arange(3.0), "name": "n", "t": (1, 2.5), "p": PUBLISHED}, GIVEN)
    about = {"schema": stored_results.SCHEMA, "what": "w", "function": "f", "kind": "result", "made_by": {}}
    return [stored_results._file(about, content, arrays)]


def logs(folder: Path) -> list[bytes]:
    kinds = ("alpha", "by_mode", "guarded", "mixed", "reactive")
    return [
        written(kind, 3, folder, events=4, withdraw=3 if kind == "alpha" else None).read_bytes() for kind in kinds
    ]


def records(folder: Path) -> list[bytes]:
    out = []
    for seed in (1, 2):
        game = Round(packaged(), GameParameters(round_ticks=40), "human", True, seed)
        for tick in range(40):
            game.step(tick % 5, (tick + 1) % 5)
        write_records([record(game)] * 2, folder / "r.jsonl")
        out.append((folder / "r.jsonl").read_bytes())
    return out


def layouts(_: Path) -> list[bytes]:
    return [packaged(name).text.encode() for name in packaged_names()]


@cache
def played() -> str:
    rows = [["s", 1, "always", 0, k, "human_needs_help", "help", "none", 3, 1, 2] for k in range(3)]
    return "\n".join(",".join(map(str, row)) for row in (ROWS_HEADER, *rows)) + "\n"


PEOPLE_LINES = b"".join(
    as_json(e) + b"\n"
    for e in (
        {"event": "consent", "participant": 1, "token": "ab" * 32, "condition": "always", "setup": {"seed": 1}},
        {"event": "interrupted", "participant": 1, "k": 2},
        {"event": "nobody trapped", "participant": 1, "k": 2},
        {"event": "finished", "participant": 1},
        {"event": "withdrawn", "participant": 1, "rounds": 3, "rule": "delete", "time": "2026-01-01T00:00:00"},
    )
)


SETUP_FILE = as_json(
    {"withdrawal": "delete", "consent": "yes", "consent_sha256": text_digest("yes"),
     "robots": {"always": {"name": "", "sha256": "", "file": None}}}
)  # fmt: skip


MESSAGES = [
    b'{"type":"hello","token":null}', b'{"type":"key","move":3,"pressed":true}', b'{"type":"start"}',
    b'{"type":"hello","token":"abcdefghijklmnopqrstuvwxyz012345"}',
]  # fmt: skip


PLAN = b"""title = "Helping, study 3"
date = 2026-03-01
where = "https://example.org"
[[planned]]
results = ["regression", "criteria"]
why = "H1"
[[planned]]
results = ["a"]
why = "H2"
"""


def evidence(_: Path) -> list[bytes]:
    return [as_json({
        "what": "w", "command": "c", "date": "2026-01-01", "seed": 1, "modules": ["models.smc"],
        "kernel_digest": "x", "versions": {"numpy": "2"}, "sentence": "s", "result": [{"a": 1.5}],
    })]  # fmt: skip


def gzipped_logs(folder: Path) -> list[bytes]:
    return [gzip.compress(content, mtime=0) for content in csv_logs(folder)]


def people(_: Path) -> list[bytes]:
    return [PEOPLE_LINES]


def setups(_: Path) -> list[bytes]:
    return [SETUP_FILE]


GROUPS = [b"participant,kind\n1,a\n2,b\n", b'kind,participant\n"a, b",1\nc,2\n']
VALUES = [b"[1, 2, 4]", b'{"values": [1, 2], "costs": {"help": 1}, "unit": "x"}', b'[{"values": [1, 2]}]']
