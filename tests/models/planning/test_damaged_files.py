"""Names that are no problem files, and files damaged at random: nothing but an `InputError` ever comes out."""

from contextlib import suppress

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from models.errors import InputError
from models.planning.formats import read_problem, write_problem
from models.planning.problems import tiger
from tests.models.planning.test_malformed_pomdp import POMDP
from tests.models.planning.test_malformed_pomdpx import POMDPX


@pytest.mark.parametrize("name", ["a.txt", "a.pomdp.zip", "pomdp"])
def test_other_endings(name, tmp_path):
    with pytest.raises(InputError, match=r"wanted a name that ends in \.pomdp, \.pomdpx"):
        read_problem(tmp_path / name)
    with pytest.raises(InputError, match=r"wanted a name that ends in \.pomdp, \.pomdpx"):
        write_problem(tiger(), tmp_path / name)


@pytest.mark.parametrize("suffix", [".pomdp", ".pomdpx", ".pomdp.gz"])
def test_absent_files_and_folders(suffix, tmp_path):
    with pytest.raises(InputError, match="no such file"):
        read_problem(tmp_path / f"a{suffix}")
    (tmp_path / f"b{suffix}").mkdir()
    with pytest.raises(InputError, match="is a folder"):
        read_problem(tmp_path / f"b{suffix}")


def test_names_that_are_no_archive(tmp_path):
    (tmp_path / "a.pomdp.gz").write_text(POMDP)
    with pytest.raises(InputError, match="not a readable gzip archive"):
        read_problem(tmp_path / "a.pomdp.gz")


# -- anything at all -----------------------------------------------------------------------------------
WORDS = [
    b"*", b":", b"-", b" ", b"\n", b"#", b"0", b"1e9", b"-1", b"T", b"O:", b"R :", b"states", b"reset", b"<", b"/>",
    b"<Entry>", b"uniform", b"identity", b"start include", b"\xff", b"\x00", b"&b;", b"99999", b'"',
]  # fmt: skip


@st.composite
def mutated(draw, text):
    data = bytearray(text.encode())
    for _ in range(draw(st.integers(1, 6))):
        at = draw(st.integers(0, len(data)))
        kind = draw(st.sampled_from(["byte", "word", "cut", "copy", "drop"]))
        end = min(len(data), at + draw(st.integers(1, 40)))
        if kind == "byte" and at < len(data):
            data[at] = draw(st.integers(0, 255))
        elif kind == "word":
            data[at:at] = draw(st.sampled_from(WORDS))
        elif kind == "cut":
            data = data[:at]
        elif kind == "copy":
            data[at:at] = data[at:end]
        else:
            del data[at:end]
    return bytes(data)


def only_input_errors(path, data):
    path.write_bytes(data)
    with suppress(InputError):
        read_problem(path)


@settings(max_examples=300)
@given(data=mutated(POMDP))
def test_damaged_pomdp(data, tmp_path_factory):
    only_input_errors(tmp_path_factory.getbasetemp() / "damaged.pomdp", data)


@settings(max_examples=300)
@given(data=mutated(POMDPX))
def test_damaged_pomdpx(data, tmp_path_factory):
    only_input_errors(tmp_path_factory.getbasetemp() / "damaged.pomdpx", data)
