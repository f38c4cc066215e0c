"""What studies show: three digits, a row a result, no tables in tables."""

from dataclasses import dataclass, field
from typing import Any

import pytest

from benchmarks.tables import as_line, cell, show, show_figures


@dataclass(frozen=True)
class Drive:
    rms_e: float = 0.012345
    by: str = "lqr"
    told: dict[str, float] = field(default_factory=lambda: {"lag": 0.2})


@pytest.mark.parametrize(("value", "text"), [(0.012345, "0.0123"), (7, "7"), (None, "None"), (float("inf"), "inf")])
def test_a_figure_has_three_digits(value: Any, text: str) -> None:
    assert cell(value) == text


def test_dataclasses_and_mappings_are_shown_alike_without_what_is_nested(capsys: pytest.CaptureFixture[str]) -> None:
    assert as_line(Drive()) == as_line({"rms_e": 0.012345, "by": "lqr", "told": {}}) == "rms_e 0.0123, by lqr"
    show("drives", [Drive(), Drive(by="[mpc]")])
    shown = capsys.readouterr().out
    assert "rms e" in shown
    assert "[mpc]" in shown
    assert "told" not in shown
    show_figures({"good": 3, "rows": [1, 2], "worst": 0.5, "table": {}})
    assert [line.split() for line in capsys.readouterr().out.splitlines()] == [["good", "3"], ["worst", "0.5"]]
