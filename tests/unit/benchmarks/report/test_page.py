"""The report: its numbers are those of the results, it asks nothing of the network, and a real browser likes it."""

from __future__ import annotations

import html
import json
import re
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks.report import conditions, learning, parts
from benchmarks.report.page import main, write_report
from benchmarks.run.results import Case, Results, load_results
from steerkit.metrics import metric, paired
from tests.support.report_results import CONTROLLERS, SEEDS, write

BROWSER = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome", "chrome"))), None)
PHONE, DESK = (390, 844), (1360, 900)


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> Results:
    return write(tmp_path_factory.mktemp("bench") / "results")


@pytest.fixture(scope="module")
def page(results: Results) -> str:
    return write_report(results, results.place / "sub" / "page.html").read_text(encoding="utf-8")


def test_the_leaderboard_has_the_medians_of_the_cases(results: Results) -> None:
    cases = [c for c in results.cases if c.suite == "tracking"]
    columns, rows = parts.leaderboard(cases)
    assert [row.controller for row in rows] == [*CONTROLLERS, "mpc", "sac"]
    place = 2 + [m.name for m in columns].index("rms_e")
    for row in rows[:3]:
        here = [c for c in cases if c.controller == row.controller]
        seeds = [np.median([c.metrics["rms_e"] for c in here if c.seed == seed]) for seed in SEEDS]
        assert row.cells[place].value == pytest.approx(np.median(seeds))
        assert row.cells[0].text == "12"
        assert row.cells[1].text == "100 %"
    assert [row.cells[place].best for row in rows] == [True, False, False, False, False]
    assert rows[0].cells[2 + [m.name for m in columns].index("max_a_y")].beyond
    assert rows[3].note == "1 ended in an error"
    assert (rows[3].cells[1].text, rows[3].cells[place].text) == ("0 %", "–")
    assert rows[4].note == "not installed"


def test_a_case_without_a_value_counts_as_worst(results: Results) -> None:
    cases = [c for c in results.cases if c.suite == "tracking"]
    assert parts.of_metric(cases, metric("rms_e"))[-2] == np.inf
    assert parts.of_metric(cases, metric("share_within_5cm"))[-2] == -np.inf


def test_the_comparison_is_paired_by_seed(results: Results) -> None:
    cases = [c for c in results.cases if c.suite == "tracking"]
    found = {(v.controller, v.metric.name): v for v in parts.against(cases, "stanley")}

    def seeds(name: str) -> list[float]:
        return [np.mean([c.metrics["rms_e"] for c in cases if (c.controller, c.seed) == (name, s)]) for s in SEEDS]

    ours = found["pure-pursuit", "rms_e_front"]
    expected = paired(seeds("pure-pursuit"), seeds("stanley"))
    assert ours.difference == expected.difference
    assert (ours.p, ours.verdict) == (pytest.approx(2.0 / 2**6), "worse")
    assert (ours.seeds, ours.scenarios) == (6, 2)
    assert found["pure-pursuit", "max_a_y"].verdict == "open"
    assert ("mpc", "rms_e_front") not in found
    assert ("pure-pursuit", "rms_e") not in found, "at one point of the car, where that was measured"


def test_a_drive_that_was_not_held_counts_as_worst_and_one_without_chance_for_every_seed(results: Results) -> None:
    case = next(c for c in results.cases if c.suite == "tracking")
    lost = replace(case, metrics={**case.metrics, "held": 0.0})
    assert parts.of_metric([case, lost], metric("rms_e")).tolist() == [case.metrics["rms_e"], np.inf]
    assert parts.of_metric([lost], metric("step_p50_us"))[0] == case.metrics["step_p50_us"]

    def made(scenario: str, seed: int, rms_e: float) -> Case:
        return Case(suite="s", scenario=scenario, controller="c", seed=seed, metrics={"rms_e": rms_e})

    cases = [made("chance", 0, 1.0), made("chance", 1, 2.0), made("none", 0, 5.0)]
    np.testing.assert_allclose(parts.by_seed(cases, metric("rms_e")), [3.0, 3.5])
    others = [replace(c, controller="d", metrics={"rms_e": c.metrics["rms_e"] + 1.0}) for c in cases]
    (found,) = parts.against([*cases, *others], "c")
    assert (found.difference.value, found.seeds, found.scenarios) == (1.0, 2, 2)


def test_the_failure_map_is_the_grid_that_was_driven(results: Results) -> None:
    cases = [c for c in results.cases if c.suite == "robustness"]
    (grid,) = conditions.grids(cases, results.protocol)
    assert {grid.x, grid.y} == {"v", "delay"}
    assert (grid.xs, grid.ys) == ((4.0, 6.0, 9.0), (0.3, 0.2, 0.1, 0.0))
    for name, shares in grid.shares.items():
        for i, delay in enumerate(grid.ys):
            for j, v in enumerate(grid.xs):
                here = [c for c in cases if c.controller == name and c.scenario == f"delay {delay:g} v {v:g}"]
                assert shares[i, j] == np.mean([c.metrics["held"] for c in here])
    assert grid.shares["pure-pursuit"][0, 2] == 0.0
    assert conditions.sweeps(cases, results.protocol) == [], "what is on a map is not drawn again"
    assert conditions.grids([c for c in results.cases if c.suite == "tracking"], results.protocol) == []


def test_one_condition_alone_is_a_sweep_and_no_map(results: Results) -> None:
    cases = [c for c in results.cases if c.scenario.endswith(" v 6")]
    assert conditions.grids(cases, results.protocol) == []
    (sweep,) = conditions.sweeps(cases, results.protocol)
    assert (sweep.x, sweep.xs) == ("delay", (0.0, 0.1, 0.2, 0.3))
    assert [len(group) for group in sweep.cases["stanley"]] == [2, 2, 2, 2]


def test_the_learning_curve_is_the_share_of_seeds_that_are_good_by_then(results: Results) -> None:
    """Seed k is good from minute 1 + k/2 on, the last one never."""
    (curves,) = learning.learning(results, results.cases, points=59)
    good, low, high = curves.good["nfq-idoe"]
    for minute, share in ((0.5, 0.0), (1.3, 1.0 / 6.0), (2.3, 0.5), (4.8, 5.0 / 6.0)):
        at = int(np.searchsorted(curves.x, minute))
        assert good[at] == pytest.approx(share)
        assert low[at] <= good[at] <= high[at]
    rms_e = curves.rms_e["nfq-idoe"][0]
    assert rms_e[0] == np.inf
    assert rms_e[-1] == 0.02


def test_numbers_are_written_for_people() -> None:
    written = [parts.number(v) for v in (0.01234, 1.0, 12.34, 1234.5, 0.0, np.inf, np.nan, 1e-9)]
    assert written == ["0.0123", "1.00", "12.3", "1,234", "0", "never", "–", "1.00e-09"]


def test_the_page_holds_everything(page: str) -> None:
    for words in (
        "Leaderboard",
        "Where they fail",
        "Learning curves",
        "On the map",
        "The paper beside ours",
        "Metric by metric",
        "Protocol",
        "Provenance",
        "no car was driven",
    ):
        assert words in page, words
    assert "solver &lt;failed&gt;" in page
    assert "solver <failed>" not in page
    assert "tracking--paper--mpc--s1" in page, "a planned case that did not finish is named"
    assert page.count("<svg ") == page.count("</svg>") > 40
    ids = re.findall(r'\bid="([^"]+)"', page)
    assert len(ids) == len(set(ids))
    assert set(re.findall(r'(?:href="|url\()#([^")]+)', page)) <= set(ids)
    assert "nan" not in re.sub(r"<[^>]*>", " ", page).lower().split()


def test_the_page_asks_nothing_of_the_network(page: str) -> None:
    assert set(re.findall(r"https?://[^\"'\s)]+", page)) <= {"http://www.w3.org/2000/svg"}
    assert not re.search(r"<(?:link|script|img|iframe)[^>]*(?:src|href)=\"(?!data:)", page)
    assert "default-src 'none'" in page


def test_the_verdict_is_on_the_page_as_html(page: str) -> None:
    section = re.search(r'<section id="verdict">(.*?)</section>', page, re.S)
    assert section
    assert "<h3>nfq-idoe</h3>" in section[1]
    assert "<table>" in section[1]
    assert "against the best analytic controller" in section[1]
    assert not re.search(r"^#|\*\*|\|---", section[1], re.M), "no Markdown is left"


def test_the_command_writes_the_page_and_refuses_no_results(
    results: Results, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit):
        main([str(tmp_path / "none")])
    assert "there are no such results; make some with" in capsys.readouterr().err
    empty = Results(tmp_path, results.provenance, ())
    with pytest.raises(ValueError, match="no case has finished, so there is nothing to report"):
        write_report(empty, tmp_path / "page.html")
    assert len(load_results(results.place).cases) == len(results.cases)


PROBE = """<script>
window.seen = [];
addEventListener("error", event => seen.push("error: " + event.message));
addEventListener("securitypolicyviolation", event => seen.push("blocked: " + event.blockedURI));
for (const kind of ["error", "warn"]) console[kind] = (...words) => seen.push(kind + ": " + words.join(" "));
addEventListener("load", () => {
  const board = document.querySelector("table.board");
  const order = () => [...board.tBodies[0].rows].map(row => row.cells[0].innerText.split("\\n")[0].trim());
  const buttons = [...board.querySelectorAll("th button")];
  const rms = buttons.findIndex(b => b.innerText.startsWith("RMS e"));
  const orders = {start: order()};
  buttons[rms].click(); orders.up = order();
  buttons[rms].click(); orders.down = order();
  orders.aria = buttons[rms].closest("th").getAttribute("aria-sort");
  for (const fold of document.querySelectorAll("details")) fold.open = true;
  const wide = [...document.body.querySelectorAll("*")].filter(e => e.getBoundingClientRect().right > innerWidth + 1
    && !e.closest(".scroll, nav > div, svg, figure > div")).map(e => e.tagName + "." + e.className);
  const text = [...document.querySelectorAll("figure svg")].filter(s => s.getBoundingClientRect().width < 100).length;
  const probe = {width: innerWidth, scroll: document.documentElement.scrollWidth, seen, orders, wide, thin: text,
    requests: performance.getEntriesByType("resource").map(r => r.name).filter(n => !n.startsWith("data:"))};
  parent.postMessage(JSON.stringify(probe), "*");
});
</script>"""
FRAME = """<!doctype html><pre id="probe"></pre><script>
addEventListener("message", event => { document.querySelector("pre").textContent = event.data; });
</script><iframe src="probed.html" style="width: %dpx; height: %dpx; border: 0"></iframe>"""


def browsed(page: str, size: tuple[int, int], tmp_path: Path) -> dict[str, Any]:
    """What a real browser, showing the page in a frame of this size, says of it: no window is as narrow as a phone."""
    assert BROWSER is not None
    probed = page.replace('<meta charset="utf-8">', f'<meta charset="utf-8">{PROBE}', 1)
    (tmp_path / "probed.html").write_text(probed, encoding="utf-8")
    file = tmp_path / "frame.html"
    file.write_text(FRAME % size, encoding="utf-8")
    done = subprocess.run(
        [
            BROWSER,
            "--headless",
            "--no-sandbox",
            "--disable-gpu",
            "--disable-quic",
            "--no-first-run",
            "--disable-background-networking",
            "--disable-component-update",
            "--disable-sync",
            "--disable-dev-shm-usage",
            f"--user-data-dir={tmp_path / 'profile'}",
            "--window-size=1500,1000",
            "--enable-logging=stderr",
            "--virtual-time-budget=10000",
            "--dump-dom",
            file.as_uri(),
        ],
        capture_output=True,
        text=True,
        timeout=120,
    )
    found = re.search(r'<pre id="probe">(.+?)</pre>', done.stdout, re.S)
    assert found, done.stderr[-2000:]
    said = [line for line in done.stderr.splitlines() if "CONSOLE" in line]
    return json.loads(html.unescape(found[1])) | {"console": said}


@pytest.mark.skipif(
    BROWSER is None, reason="no Chromium or Chrome is installed, so the page was not tried in a browser"
)
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


@pytest.mark.skipif(
    BROWSER is None, reason="no Chromium or Chrome is installed, so the page was not tried in a browser"
)
def test_the_browser_test_sees_an_error_and_an_overflow(page: str, tmp_path: Path) -> None:
    broken = page.replace("</main>", '<div style="width: 3000px">.</div><script>nothing.there()</script></main>', 1)
    found = browsed(broken, PHONE, tmp_path)
    assert any("nothing is not defined" in line for line in found["seen"])
    assert found["scroll"] > PHONE[0]
    assert found["wide"]
