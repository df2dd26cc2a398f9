"""The report as PDF."""

import sys

import pytest

from analysis.report.build import build_report
from analysis.report.pdf import available, to_pdf
from models.errors import InputError
from tests.analysis.report_cases import small_study, some

pytestmark = pytest.mark.usefixtures("short_reports")


@pytest.fixture
def small():
    return small_study()


def test_pdf_without_weasyprint_is_a_plain_message(monkeypatch):
    monkeypatch.setitem(sys.modules, "weasyprint", None)
    with pytest.raises(InputError, match="install the extra `pdf`"):
        to_pdf("<p>x</p>")


def test_pdf(small, tmp_path):
    if not available():
        pytest.skip("WeasyPrint, an optional extra, is not installed")
    only = some("provenance", "flow")
    made = build_report(small, states="1", quick=True, out=tmp_path, sections=only, pdf=True)
    assert made.pdf.read_bytes().startswith(b"%PDF-")
