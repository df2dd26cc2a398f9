"""Damaged files: hundreds for every reader, and all that ever got another answer than a result or a refusal."""

from pathlib import Path
from random import Random

import pytest

from models.errors import InputError
from tests.fuzz.readers import READERS
from tests.fuzz.sites import SITES, reading_modules
from tests.fuzz.watch import outcome
from tests.fuzz.worker import smaller

CASES = sorted((Path(__file__).parent / "cases").glob("*__*"))


@pytest.mark.parametrize("name", READERS)
def test_damaged_files_are_read_or_refused(name, tmp_path):
    reader, rng = READERS[name], Random(f"default suite, {name}")
    (tmp_path / "seeds").mkdir()
    seeds = list(reader.seeds(tmp_path / "seeds"))
    path = tmp_path / reader.file
    for content in seeds:
        path.write_bytes(content)
        assert outcome(reader.read, path).kind == "read"
    kinds = set()
    for _ in range(reader.cheap):
        content = reader.damage(rng.choice(seeds), seeds, rng)
        path.write_bytes(content)
        answer = outcome(reader.read, path)
        assert answer.kind != "finding", f"{answer.what}\n{answer.told}\n{content[:500]!r}"
        kinds.add(answer.kind)
    assert kinds == {"read", "refused"} or name in ("fit-listed", "kept-chain", "session-log"), (
        "they say it otherwise"
    )


@pytest.mark.parametrize("case", CASES, ids=lambda path: path.name)
def test_what_was_found_before(case, tmp_path):
    reader = READERS[case.name.partition("__")[0]]
    path = tmp_path / reader.file
    path.write_bytes(case.read_bytes())
    answer = outcome(reader.read, path)
    assert answer.kind != "finding", f"{answer.what}\n{answer.told}"


def test_every_module_that_opens_files_is_accounted_for():
    assert reading_modules() == set(SITES)
    named = {name for told in SITES.values() for name in told.readers}
    assert named == set(READERS)
    assert all(told.readers or told.why for told in SITES.values())


# -- the judge ---------------------------------------------------------------------------------------
def _hangs(path):
    while True:
        pass


def _hoards(path):
    return bytearray(1 << 40)


def _forgets(path):
    raise InputError("something is wrong")


def _breaks(path):
    return {}["key"]


@pytest.mark.parametrize(
    ("read", "what"),
    [(_hangs, "TooLong"), (_hoards, "MemoryError"), (_forgets, "no file named"), (_breaks, "KeyError")],
)
def test_other_answers_are_findings(read, what, tmp_path):
    path = tmp_path / "given.txt"
    path.write_text("x")
    answer = outcome(read, path, seconds=0.2)
    assert answer.kind == "finding"
    assert what in answer.what


def test_findings_are_made_small(tmp_path):
    def read(path):
        if b"bad" in path.read_bytes():
            raise KeyError

    reader = READERS["layout"].__class__("x", ".txt", read, lambda _: [b""], lambda c, _o, _r: c)
    path = tmp_path / "given.txt"
    path.write_bytes(b"x" * 100 + b"bad" + b"y" * 99)
    wanted = outcome(read, path)
    assert smaller(reader, path.read_bytes(), wanted, path) == b"bad"


def test_damage_depends_on_the_seed_alone(tmp_path):
    for name in ("events-csv", "protocol", "model", "pomdp-gz", "session-log", "round-record"):
        reader = READERS[name]
        (tmp_path / name).mkdir()
        seeds = list(reader.seeds(tmp_path / name))
        one, other = ([reader.damage(seeds[0], seeds, rng) for _ in range(5)] for rng in (Random(5), Random(5)))
        assert one == other
