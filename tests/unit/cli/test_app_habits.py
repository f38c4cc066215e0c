"""What a user expects of any command line: complete help, --version, --json, exit codes, NO_COLOR, completion."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from rich import markup

import steerkit
from steerkit.cli import app as cli
from steerkit.diagram.units import radians_of
from steerkit.paths.courses import names
from steerkit.vehicles import VEHICLES, fleet
from tests.support.command_lines import parsed, run


def finished(*words: str, **extra: str) -> subprocess.CompletedProcess[str]:
    """`python -m steerkit` in a process of its own."""
    environment = {**os.environ, "COLUMNS": "100", **extra}
    return subprocess.run([sys.executable, "-m", "steerkit", *words], capture_output=True, text=True, env=environment)


def test_python_m_steerkit_version_and_exit_codes() -> None:
    done = finished("--version")
    assert (done.returncode, done.stdout) == (0, f"steerkit {steerkit.__version__}\n")
    asked = finished("learn", "--bogus")
    assert asked.returncode == 2
    assert "No such option: --bogus" in asked.stderr
    assert asked.stdout == ""


def test_help_is_complete(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    """Every command and every option says what it is for, nothing of it is taken for a colour's name in brackets and
    left out, and the first page has examples and exit codes."""
    assert run("--help", monkeypatch=monkeypatch) == 0
    page = capsys.readouterr().out
    assert all(word in page for word in ("Examples", "Exit codes", "NO_COLOR", "--install-completion", "--version"))

    def all_of(command: Any, name: str) -> None:
        assert command.help, f"{name}: no help"
        assert markup.render(command.help).plain == command.help
        for parameter in command.params:
            assert parameter.help, f"{name}: no help for {parameter.name}"
            assert markup.render(parameter.help).plain == parameter.help
        for below, inner in getattr(command, "commands", {}).items():
            all_of(inner, f"{name} {below}")

    all_of(cli.command(), "steerkit")


def test_the_examples_of_the_help_page_are_valid_commands() -> None:
    lines = [re.split("  +", line.strip())[0].split()[1:] for line in cli.EPILOG.splitlines() if "  steerkit" in line]
    assert len(lines) == 7
    for words in lines:
        parsed(words)


def test_no_color_leaves_out_colours() -> None:
    """FORCE_COLOR asks rich for a terminal's output; colour codes are ESC[3x, ESC[9x and ESC[38;..., bold is ESC[1."""
    colour = re.compile(r"\x1b\[(?:[0-9;]*;)?(?:3[0-8]|9[0-7])")
    assert colour.search(finished("--help", FORCE_COLOR="1").stdout)
    assert not colour.search(finished("--help", FORCE_COLOR="1", NO_COLOR="1").stdout)


def test_completion_for_bash() -> None:
    words = {"_STEERKIT_COMPLETE": "complete_bash", "COMP_WORDS": "steerkit dr", "COMP_CWORD": "1"}
    code = "import sys; sys.argv = ['steerkit']; from steerkit.cli.app import main; main()"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env={**os.environ, **words})
    assert done.stdout.split() == ["drive"]


def test_courses_and_car_check_as_json(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("courses", "--json", monkeypatch=monkeypatch) == 0
    rows = {row["course"]: row for row in json.loads(capsys.readouterr().out)["courses"]}
    assert tuple(rows) == names()
    assert rows["circle"]["tightest_radius_m"] == pytest.approx(30.0)
    assert rows["straight"]["tightest_radius_m"] is None
    assert run("car", "check", "--json", monkeypatch=monkeypatch) == 0
    facts = json.loads(capsys.readouterr().out)
    assert facts["vehicle"] == "vw-passat"
    assert facts["limits"]["rate_max"] == pytest.approx(radians_of(550.0))
    assert facts["read"]["v_kit"] == {"unit": "m/s", "signal": "VEH_VEL", "gain": pytest.approx(1 / 3.6), "offset": 0.0}


def test_vehicles_as_a_table_and_as_json(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("vehicles", "--json", monkeypatch=monkeypatch) == 0
    rows = {row["vehicle"]: row for row in json.loads(capsys.readouterr().out)["vehicles"]}
    assert set(rows) == {*VEHICLES, *fleet()}
    assert (rows["kia-ceed"]["steer_delay_s"], rows["kia-ceed"]["interface"]) == (0.1, "torque")
    assert rows["kia-ceed"]["mass_kg"] == fleet()["kia-ceed"].vehicle.m
    assert rows["vw-passat"]["steer_delay_s"] is None
    assert run("vehicles", "RAV4", monkeypatch=monkeypatch) == 0
    printed = capsys.readouterr().out
    assert "toyota-rav4-prime" in printed
    assert "kia" not in printed
    for columns in ("80", "40"):
        monkeypatch.setenv("COLUMNS", columns)
        assert run("vehicles", monkeypatch=monkeypatch) == 0
        printed = capsys.readouterr().out
        assert max(map(len, (*VEHICLES, *fleet()))) > 30
        assert all(name in printed for name in (*VEHICLES, *fleet(), "wheel-", "steer", "torque", "(m/s)"))
        assert "…" not in printed
        assert max(map(len, printed.splitlines())) <= 80
    assert run("vehicles", "trabant", monkeypatch=monkeypatch) == 2
    assert "no name has 'trabant' in it" in capsys.readouterr().err


def test_an_interrupt_inside_code_made_from_text_ends_with_130_too(tmp_path: Path) -> None:
    text = (
        "import os, signal as s; s.signal(2, s.default_int_handler); os.kill(os.getpid(), 2)\nfor _ in range(9): pass"
    )
    (tmp_path / "mine.py").write_text(f"def make(belief):\n    exec({text!r})\n")
    words = [sys.executable, "-m", "steerkit", "drive", "mine.py:make", "--course", "circle", "-q"]
    done = subprocess.run(words, cwd=tmp_path, capture_output=True, text=True, check=False, timeout=120.0)
    assert done.returncode == 130, done.stderr
    assert "Traceback" not in done.stderr


def test_an_interrupted_run_says_how_to_go_on_and_ends_with_130(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def interrupted(*_: Any, **__: Any) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("steerkit.learning.report.learn_with_progress", interrupted)
    assert run("learn", "--out", str(tmp_path), monkeypatch=monkeypatch) == 130
    assert f"the same with --out {tmp_path} goes on" in capsys.readouterr().err
