"""The command line: complete help, --version, exit codes, NO_COLOR, completion; mistakes are one line."""

import errno
import os
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from rich import markup

import steerkit
from steerkit.cli import WORDS, learn
from steerkit.cli import app as command_line
from steerkit.diagram.loop import Loop
from steerkit.diagram.simulation import simulate
from steerkit.learning.experiment import Experiment
from steerkit.scenario import Scenario
from tests.support import programs
from tests.support.command_lines import parsed, run
from tests.support.parts import Count
from tests.support.short_run import FAST

CAR = ("--car", "dbw-kit.toml")


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (("learn", "--config", "/does/not/exist.toml"), "cannot be read"),
        (("drive",), "with which controller? valid: stanley"),
        (("drive", "stanley", "--controller", "nfq"), "two controllers, 'stanley' and --controller nfq"),
        (("drive", "nfq", "--course", "circle"), "there is no runs/default-circle-clean-seed0"),
        (("drive", "stanley", "stanley"), "a controller stands twice"),
        (("drive", "stanley", "lqr", "--animate", "a.gif"), "films one controller"),
        (("drive", "stanley", "lqr", *CAR), "2 controllers (stanley, lqr), expected one on a car"),
        (("drive", "stanley", "--minutes", "2"), "--minutes is for a car; name its file: --car dbw-kit.toml"),
        (("learn", "--simulated"), "--simulated is for a car"),
        (("drive", "stanley", *CAR, "--rounds", "2"), "--rounds is for simulations: say --minutes"),
        (("learn", *CAR, "--course", "paper"), "the car's file names the course, under [course]"),
        (("learn", *CAR, "--conditions", "hard"), "a car brings its own noise"),
        (("learn", *CAR, "--live"), "--live is for simulations: the panel shows it"),
        (("drive", *CAR), "with which controller? valid: stanley"),
        (("drive", "stanly", *CAR), "nor a place with a trained policy; valid: stanley"),
        (("drive", "nfq", *CAR), "no net in runs/car; learn one first: steerkit learn --car FILE"),
        (("drive", "stanley", *CAR, "--recovery", "prayer"), "--recovery 'prayer' is not known; valid: auto, adaptive"),
        (("drive", "stanley", *CAR, "--time-scale", "2"), "a real car has real time; use --simulated"),
        (("drive", "stanley", *CAR, "--time-scale", "2", "--channel", "/dev/ttyUSB0"), "a real car has real time; use"),
        (("drive", "stanley", *CAR, "--simulated", "--channel", "/dev/x"), "leave --channel out"),
        (("drive", "stanley", *CAR, "--recording", "there.mcap"), "recordings are not overwritten"),
        (("log", "a.csv", "--plot", "a.txt"), "--plot a.txt: expected a name that ends in .png, .pdf, .svg"),
        (("export", "drive.npz", "--csv", "a.xlsx"), "--csv a.xlsx: expected a name that ends in .csv, .parquet"),
        (("new", "course", "--out", "a.txt"), "a course's file ends in .csv"),
        (("export", "/", "--onnx", "p.onnx"), "no run directory"),
        (("identify", "genesis", "--column", "v=speed"), "column for v 'speed' is not known"),
        (("vehicles", "trabant"), "no name has 'trabant' in it"),
        (("drive", "mpc", "--target", "drawn-7", "--rounds", "1"), "leave --rounds out"),
        (("drive", "mpc", "--target", "drawn-7", "--course", "genesis"), "leave --course out"),
        (("drive", "mpc", "--target", "drawn-7", "--v-max", "9"), "leave --v-max out"),
        (("drive", "mpc", "--target", "drawn-7", *CAR), "--target is for simulations: a car is driven along a course"),
        (("prove", "step-stear"), "did you mean 'step-steer'"),
        (("prove", "sine", "step-steer", "--report", "one.html"), "one page is of one manoeuvre"),
        (("prove", "sine", "--report", "one.pdf"), "expected FILE.html, or a folder"),
        (("prove", "lane-change-1", "--a-y", "2"), "driven on a course"),
        (("prove", "sine", "--speed", "0"), "v = 0.0 [m/s]"),
        (("prove", "sine", *CAR, "--yes"), "a person consents"),
        (("prove", "sine", *CAR, "--simulated"), "cannot be driven with this car"),
        (("car", "check", "mine.toml"), "shipped: dbw-kit.toml"),
        (("car", "order", "GO"), "valid: ARM, ENGAGE, DISENGAGE, ACKNOWLEDGE, OFF"),
        (("car", "order", "ENGAGE", "--socket", "/nowhere/socket"), "no car server answers there"),
        (("car", "check", "/dev/zero"), "/dev/zero: is a device or a pipe, expected a file"),
        (("car", "server", "--channel", "spy:///dev/ttyS0?file=X"), "'spy:///dev/ttyS0?file=X': expected a serial"),
        (("car", "simulate", "--ratio", "9"), "steer_ratio = 140.4 [1], expected 1 to 50"),
        (("car", "calibrate", "--out", "mine.csv"), "a vehicle file ends in .toml"),
        (("car", "calibrate", "--minutes", "0"), "expected 0.1 to 60 of driving"),
        (("car", "calibrate", "--controller", "mcp"), "valid: stanley"),
        (("car", "calibrate", "--from", "none.mcap"), "No such file"),
        (("car", "calibrate", "--from", __file__), "no recording of steerkit"),
    ],
)
def test_mistakes_are_one_line(words: tuple[str, ...], says: str, tmp_path: Path, monkeypatch: Any, cli: Any) -> None:
    """And exit code 2."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "there.mcap").touch()
    (tmp_path / "a.csv").write_text("t,v\n" + "".join(f"{k},1\n" for k in range(50)))
    simulate(Loop(blocks={"car": Count()}, wires=[]), 1.0).save(tmp_path / "drive.npz")
    error = cli(*words, code=2).err.strip()
    assert says in error
    assert len(error.splitlines()) == 1
    assert sorted(file.name for file in tmp_path.iterdir()) == ["a.csv", "drive.npz", "there.mcap"]


@pytest.mark.parametrize(
    ("error", "code", "says"),
    [
        (
            OSError(errno.ENOSPC, "No space left on device", "s.npz"),
            1,
            "s.npz: No space left on device; the run is kept",
        ),
        (KeyboardInterrupt(), 130, "interrupted"),
    ],
)
def test_a_run_that_ends_early_says_how_to_go_on(
    error: BaseException, code: int, says: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, cli: Any
) -> None:
    def ended(*_: Any, **__: Any) -> None:
        (tmp_path / "run").mkdir()
        (tmp_path / "run" / "run.json").touch()
        raise error

    monkeypatch.setattr("steerkit.learning.report.learn_with_progress", ended)
    said = cli("learn", "--out", tmp_path / "run", "-q", code=code).err
    assert says in said
    assert f"the same with --out {tmp_path}/run goes on from the" in said


def test_the_demonstration_names_the_car_and_the_time_in_every_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    programs.forking(monkeypatch.setattr)
    setting = replace(FAST, retrain_every_m=0.0)
    short = Experiment(
        setting=setting, scenario=Scenario(course={"name": "circle", "rounds": 0.1}), minutes=3.0, rounds=1
    )
    cars = {"one, round": short, "two": replace(short, minutes=0.05), "three [b]": replace(short, minutes=0.05)}
    monkeypatch.setattr(learn, "EXPERIMENTS", cars)
    monkeypatch.setenv("COLUMNS", "110")
    assert run("demo", "--out", str(tmp_path), monkeypatch=monkeypatch) == 0
    first, *lines = capfd.readouterr().out.splitlines()
    assert first.startswith("Three cars learn to steer from nothing: one, round; two; three [b].")
    lines = lines[: next(k for k, line in enumerate(lines) if "3 runs" in line)]
    told = [re.fullmatch(r" *\d+ s  (one, round|two|three \[b\]): (.+)", line) for line in lines]
    assert all(told), lines
    said = [(match[1], match[2].partition(":")[0]) for match in told if match]
    assert ("one, round", "round") in said
    for name in cars:
        assert [what for who, what in said if who == name][:1] == ["begins to learn"]
        assert (name, "has learned") in said


def test_the_version_and_an_option_that_is_not_there(cli: Any) -> None:
    assert cli("--version").out == f"steerkit {steerkit.__version__}\n"
    out, error = cli("new", "--bogus", code=2)
    assert "No such option: --bogus" in error
    assert out == ""


def test_help_is_complete(cli: Any) -> None:
    """Every command and every option says what it is for, nothing of it is taken for a colour's name in brackets and
    left out, and the first page has examples and exit codes."""
    page = cli("--help").out
    assert all(word in page for word in ("Examples", "Exit codes", "NO_COLOR", "--install-completion", "--version"))

    def all_of(command: Any, name: str) -> None:
        assert command.help, f"{name}: no help"
        assert markup.render(command.help).plain == command.help
        for parameter in command.params:
            assert parameter.help, f"{name}: no help for {parameter.name}"
            assert markup.render(parameter.help).plain == parameter.help
        for below, inner in getattr(command, "commands", {}).items():
            all_of(inner, f"{name} {below}")

    all_of(command_line.command(), "steerkit")
    for name, (_, about) in command_line.COMMANDS.items():
        all_of(command_line.loaded(name), name)
        assert about in page.replace("│", " ") or about[:40] in page, f"{name}: not on the first page"


def test_the_examples_of_the_help_page_are_valid_commands() -> None:
    lines = [
        re.split("  +", line.strip())[0].split()[1:]
        for line in command_line.EPILOG.splitlines()
        if "  steerkit" in line
    ]
    assert len(lines) == 7
    for words in lines:
        parsed(words)


def test_completion_for_bash() -> None:
    words = {"_STEERKIT_COMPLETE": "complete_bash", "COMP_WORDS": "steerkit dr", "COMP_CWORD": "1"}
    code = "import sys; sys.argv = ['steerkit']; from steerkit.cli.app import main; main()"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env={**os.environ, **words})
    assert done.stdout.split() == ["drive"]


def test_an_interrupt_inside_code_made_from_text_ends_with_130_too(tmp_path: Path) -> None:
    text = (
        "import os, signal as s; s.signal(2, s.default_int_handler); os.kill(os.getpid(), 2)\nfor _ in range(9): pass"
    )
    (tmp_path / "mine.py").write_text(f"def make(belief):\n    exec({text!r})\n")
    words = ("-m", "steerkit", "drive", "mine.py:make", "--course", "circle", "-q")
    done = programs.python(*words, folder=tmp_path)
    assert done.returncode == 130, done.stderr
    assert "Traceback" not in done.stderr


def test_each_option_that_a_car_has_no_use_for_is_one_of_a_simulation() -> None:
    simulated = {
        parameter.name
        for name in ("drive", "learn")
        for parameter in command_line.loaded(name).params
        if getattr(parameter, "rich_help_panel", None) == "In simulation"
    }
    assert WORDS["not_on_a_car"].keys() <= simulated
