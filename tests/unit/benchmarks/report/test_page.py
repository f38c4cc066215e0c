"""The report: its numbers are those of the results, it asks nothing of the network, and a real browser likes it."""

import re
from pathlib import Path
from typing import Any

import pytest
from matplotlib.figure import Figure

from benchmarks.report.page import write_report
from benchmarks.run.results import Results
from tests.support.browser import BROWSER, FRAME, FRAME_JS, shown
from tests.support.places import SUPPORT
from tests.support.report_results import CONTROLLERS

PHONE, DESK = (390, 844), (1360, 900)
needs_browser = pytest.mark.skipif(BROWSER is None, reason="no Chromium or Chrome: the page was not tried in a browser")


@pytest.fixture(scope="module")
def page(known: Results) -> str:
    """With figures whose layout tests/unit/benchmarks/report/test_figures.py sees."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Figure, "get_layout_engine", lambda _: None)
        return write_report(known, known.place / "sub" / "page.html").read_text(encoding="utf-8")


def test_the_page_holds_everything(page: str) -> None:
    titles = "Leaderboard|Where they fail|Learning curves|On the map|The paper beside ours"
    for words in f"{titles}|Protocol|Provenance|no car was driven".split("|"):
        assert words in page, words
    assert "solver &lt;failed&gt;" in page
    assert "solver <failed>" not in page
    assert "tracking--paper--mpc--s1" in page, "a planned case that did not finish is named"
    assert page.count("<svg ") == page.count("</svg>") > 5
    ids = re.findall(r'\bid="([^"]+)"', page)
    assert len(ids) == len(set(ids))
    assert set(re.findall(r'(?:href="|url\()#([^")]+)', page)) <= set(ids)
    assert "nan" not in re.sub(r"<[^>]*>", " ", page).lower().split()


def test_the_page_asks_nothing_of_the_network(page: str) -> None:
    assert set(re.findall(r"https?://[^\"'\s)]+", page)) <= {"http://www.w3.org/2000/svg"}
    assert not re.search(r"<(?:link|script|img|iframe)[^>]*(?:src|href)=\"(?!data:)", page)
    assert "default-src 'none'" in page


def test_no_results_are_refused(known: Results, tmp_path: Path) -> None:
    empty = Results(tmp_path, known.provenance, ())
    with pytest.raises(ValueError, match="no case has finished, so there is nothing to report"):
        write_report(empty, tmp_path / "page.html")


PROBE = (SUPPORT / "probe.html").read_text(encoding="utf-8")


def browsed(page: str, size: tuple[int, int], tmp_path: Path) -> dict[str, Any]:
    """What a real browser, showing the page in a frame of this size, says of it: no window is as narrow as a phone."""
    probed = page.replace('<meta charset="utf-8">', f'<meta charset="utf-8">{PROBE}', 1)
    (tmp_path / "probed.html").write_text(probed, encoding="utf-8")
    file = tmp_path / "frame.html"
    file.write_text(FRAME % ("frame.js", "probed.html", *size), encoding="utf-8")
    (tmp_path / "frame.js").write_text(FRAME_JS, encoding="utf-8")
    return shown(file.as_uri(), tmp_path)


@needs_browser
@pytest.mark.parametrize("size", [PHONE, DESK], ids=["phone", "desk"])
def test_a_browser_shows_the_page_without_errors_and_nothing_sticks_out(
    page: str, size: tuple[int, int], tmp_path: Path
) -> None:
    found = browsed(page, size, tmp_path)
    assert found["seen"] == []
    assert found["console"] == []
    assert found["requests"] == []
    assert found["width"] == size[0]
    assert found["scroll"] <= size[0], f"wider than the screen: {found['wide'][:5]}"
    assert found["wide"] == []
    assert found["thin"] == 0
    orders = found["orders"]
    assert orders["start"] == [*CONTROLLERS, "mpc", "sac"]
    assert orders["up"] == ["stanley", "nfq-idoe", "pure-pursuit", "mpc", "sac"]
    assert orders["down"] == ["pure-pursuit", "nfq-idoe", "stanley", "mpc", "sac"]
    assert orders["aria"] == "descending"
