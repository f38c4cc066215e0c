"""What a notebook shows of blocks, logs and loops."""

import subprocess
import sys

import numpy as np

from steerkit import simulate
from steerkit.diagram.block import Block
from steerkit.diagram.simulation import Log
from steerkit.doe import Integrator
from steerkit.plants.linear_single_track import LinearSingleTrack
from steerkit.plants.speed_driver import RecordedSpeed
from tests.support.straight_road import PASSAT

PNG = b"\x89PNG"


def test_a_block_shows_its_parameters_and_ports() -> None:
    html = Integrator()._repr_html_()
    for words in ("<b>Integrator</b>", "limit", "9.07571", "applied", "rad", "seen by update only", "of the state"):
        assert words in html
    assert html.count("<table>") == html.count("</table>") == 2
    assert "&lt;" not in html.split("<table>")[0]


def test_long_and_odd_parameters_are_cut_and_escaped() -> None:
    driver = RecordedSpeed(speeds=tuple(np.linspace(1.0, 2.0, 500).tolist()), spacing=0.1)
    assert "1.0140280561122244, ...)" in driver._repr_html_()
    html = LinearSingleTrack(vehicle=PASSAT)._repr_html_()
    assert "..." in html  # the vehicle
    named = LinearSingleTrack(vehicle=type(PASSAT)(**{**vars(PASSAT), "name": "<script>"}))._repr_html_()
    assert "<script>" not in named


def test_every_shipped_block_can_be_shown(log: Log) -> None:
    assert log.loop is not None
    for block in log.loop.blocks.values():
        assert isinstance(block, Block)
        assert type(block).__name__ in block._repr_html_()


def test_a_log_shows_ranges_and_a_picture(log: Log) -> None:
    html = log._repr_html_()
    for words in ("<b>Log</b>", "path.e", "rad/s", "data:image/png;base64,iVBOR"):
        assert words in html
    assert f"{log['car.x'].max():.4g}" in html
    one = Log(np.zeros(1), {"a.b": np.zeros(1)}, {"a.b": "1"})
    assert "<img" not in one._repr_html_()
    assert "no time" in Log(np.zeros(0), {}, {})._repr_html_()


def test_a_batch_is_shown(log: Log) -> None:
    assert log.loop is not None
    many = simulate(log.loop, 0.5, batch=3)
    assert "<td style='text-align:left'>3</td>" in many._repr_html_()


def test_a_loop_shows_its_diagram(log: Log) -> None:
    assert log.loop is not None
    assert log.loop._repr_png_()[:4] == PNG


def test_matplotlib_is_loaded_when_a_log_is_shown_and_not_before() -> None:
    code = """
import sys
import steerkit.plots.notebook, steerkit.plots.animation
from steerkit import Integrator
Integrator()._repr_html_()
assert "matplotlib" not in sys.modules
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
