"""The table of metrics names each once, and the document holds it."""

from __future__ import annotations

import pytest

from steerkit import metrics
from steerkit.metrics.table import as_markdown
from tests.support.places import ROOT


def test_the_table_names_each_metric_once_and_the_document_holds_it() -> None:
    names = [m.name for m in metrics.TABLE]
    assert len(set(names)) == len(names)
    page = ROOT / "docs" / "metrics.md"
    assert as_markdown() in page.read_text(encoding="utf-8"), "python -c 'from steerkit.metrics.table import ...'"
    with pytest.raises(KeyError, match="metric 'rms' is not known; valid: rms_e, "):
        metrics.metric("rms")
