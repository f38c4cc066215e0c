"""Every command that the project shows is run, as a process: the shell lines of README, CONTRIBUTING and docs (in the
short forms of tests/support/shell_lines.toml) and the scripts under examples/; the studies in test_studies.py."""

import contextlib
import json
import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from steerkit.controllers.network_policy import Network, PolicyBlock
from tests.support import programs
from tests.support.command_lines import parsed
from tests.support.compilers import optimising
from tests.support.places import ROOT
from tests.support.shell_lines import DOORS, EXAMPLE, EXAMPLES, FITTED, PAGES, Step, blocks, lines_of, steps_of, table

OTHER_PACKAGES = {"train_with_stable_baselines3.py": "stable_baselines3"}
"""What an example needs beyond the extra `dev`."""
SHORTER = {"train_with_stable_baselines3.py": " --course circle"}
"""What makes its drives short: a round of the circle is a quarter of the paper's."""
PATIENCE = 300.0
"""A program that takes longer than this hangs [s]; the machine may be busy."""


@pytest.fixture(scope="session")
def bin_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with `python` and `steerkit`, which run this interpreter: what a virtual environment has."""
    folder = tmp_path_factory.mktemp("bin")
    (folder / "python").write_text(f'#!/bin/sh\nexec {sys.executable} "$@"\n')
    # guarded as pip writes it: a training process imports it again
    guarded = 'from steerkit.cli.app import main\nif __name__ == "__main__":\n    main()\n'
    (folder / "steerkit").write_text(f"#!{sys.executable}\n{guarded}")
    for name in ("python", "steerkit"):
        (folder / name).chmod(0o755)
    return folder


class Shell:
    """A bash in a folder of its own, and the programs that it has left running."""

    def __init__(self, folder: Path, bin_folder: Path):
        self.folder, self.programs = folder, bin_folder
        self.values: dict[str, str] = {}
        """What lines have printed and later lines need, by name."""
        self.running: list[subprocess.Popen[str]] = []
        self.environment = {
            **os.environ,
            "PATH": f"{self.programs}{os.pathsep}{os.environ['PATH']}",
            "PYTHONPATH": os.pathsep.join(filter(None, (str(ROOT), os.environ.get("PYTHONPATH")))),
            "CHECKOUT": str(ROOT),
            "XDG_RUNTIME_DIR": str(folder),
            "MINARI_DATASETS_PATH": str(folder / "minari"),
            "MPLBACKEND": "agg",
            "COLUMNS": "120",
            "OMP_NUM_THREADS": "1",
        }

    def start(self, line: str, log: Path) -> subprocess.Popen[str]:
        """Start a command, in a fork; its output goes to a file."""
        name, *words = shlex.split(line)
        assert name == "steerkit", line
        with log.open("w") as output:
            return programs.Forked(
                [sys.executable, "-m", name, *words],
                cwd=self.folder,
                env=self.environment,
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=output,
                text=True,
                start_new_session=True,
            )

    def run(self, line: str, given: str = "") -> subprocess.CompletedProcess[str]:
        """Run a line to its end: commands in forks, any other line (or for completion) in bash. given: its input."""
        first, pipe, rest = line.partition(" | python ")
        if pipe:
            done = self.run(first)
            return done if done.returncode else self.run(f"python {rest}", given=done.stdout)
        first, then, rest = line.rpartition(" && ")
        if then and rest.startswith("python ") and not re.search(r"[$&|]", first):
            done = self.run(first)
            return done if done.returncode else self.run(rest)
        command = re.match("steerkit |python ", line)
        if command and not re.search(r"[|;&<>$*`]|-completion", line):
            name, *words = shlex.split(line)
            words = [str(self.programs / "steerkit"), *words] if name == "steerkit" else words
            return programs.python(*words, folder=self.folder, environment=self.environment, seconds=PATIENCE)
        return subprocess.run(
            ["bash", "-c", f"set -o pipefail; {line}\nexit $?"],  # bash stays: a program may ask which shell it is in
            cwd=self.folder,
            env=self.environment,
            input=given,
            capture_output=True,
            text=True,
            timeout=PATIENCE,
            check=False,
        )

    def close(self) -> None:
        """Stop what is running, the last first."""
        while self.running:
            process = self.running.pop()
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGTERM)
            process.wait(PATIENCE)


@pytest.fixture
def shell(bin_folder: Path) -> Iterator[Shell]:
    """A shell in an empty folder whose path is short enough for a socket."""
    with (
        tempfile.TemporaryDirectory(prefix="steerkit-") as folder,
        contextlib.closing(Shell(Path(folder), bin_folder)) as it,
    ):
        yield it


# ---- what the text has the reader make ------------------------------------------------------------------------------


SHORT_DRIVES = "scenario.course = {name = 'circle', rounds = 0.1}\nsetting.warm_up_seconds = 0.0\n"
"""An experiment whose test drives, of which a run has two and `show` as many again, end after a tenth of a round; the
first net, drawn at random, steers at once."""


@pytest.fixture(scope="session")
def learned(bin_folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A short learning run's directory."""
    folder = tmp_path_factory.mktemp("learned")
    (folder / "short.toml").write_text(SHORT_DRIVES)
    words = "--config short.toml --seed 3 --minutes 0.1 --with fit.epochs=20 --quiet --out run"
    done = Shell(folder, bin_folder).run(f"steerkit learn {words}")
    assert done.returncode == 0, done.stderr
    return folder / "run"


WRITTEN_BY = {"yard-smooth.csv": ("courses.md", "yard"), "yard.xodr": ("courses.md", "write_text")}
"""Files that Python blocks of a page write: the page under docs, and a word that only those blocks have."""


def python_of(page: str, word: str) -> list[str]:
    """The Python blocks of a page under docs that have this word."""
    return [code for language, code in blocks(ROOT / "docs" / page) if language == "python" and word in code]


def make(name: str, folder: Path, learned: Path) -> None:
    """Make a file that a line needs."""
    if name in ("runs/default-paper-clean-seed3", "runs/mine", "runs/car", "my-run"):
        shutil.copytree(learned, folder / name)
    elif name == "short.toml":
        (folder / name).write_text(SHORT_DRIVES)
    elif name == "my-car.toml":  # "copy the shipped dbw-kit.toml"
        from steerkit import car as real_car

        shutil.copy(Path(real_car.__path__[0]) / "kits" / "dbw-kit.toml", folder / name)
    elif name == "my_controller.py":  # "save this as my_controller.py"
        (code,) = python_of("tutorial.md", "A controller of my own")
        (folder / name).write_text(code.replace('"paper"', '"circle"'), encoding="utf-8")  # a quarter as long
    elif name == "my_doe.py":  # "save the imports and the class as my_doe.py"
        (code,) = python_of("howto/doe.md", "class GearedIntegrator")
        (folder / name).write_text(code.partition("\ndoe = ")[0], encoding="utf-8")
    elif name in WRITTEN_BY:
        codes = python_of(*WRITTEN_BY[name])
        environment = {**os.environ, "MPLBACKEND": "agg"}
        programs.python("-c", "\n".join(codes), folder=folder, environment=environment).check_returncode()
    elif name in ("examples", "can.log.gz"):
        (folder / name).symlink_to(ROOT / {"can.log.gz": "tests/support/rav4/can.log.gz"}.get(name, name))
    elif name.startswith("agent-"):  # where there is no Stable-Baselines3 to train it
        law = Network(layers=((np.array([[-0.6, -1.0, 0.0, 0.0, -0.3, 0.0]]), np.zeros(1)),), head="clip")
        PolicyBlock(policy=law).save(folder / name)
    elif name == "drive.npz":
        drive = ("drive", "stanley", "--course", "circle", "--rounds", "0.05", "--quiet", "--out", "d")
        programs.python("-m", "steerkit", *drive, folder=folder).check_returncode()
        (folder / "d" / name).rename(folder / name)
    else:
        raise ValueError(f"nobody makes {name}; an earlier line of the page should have")


# ---- the lines ------------------------------------------------------------------------------------------------------


def wanting(step: Step, text: str, folder: Path) -> str:
    """What a step has not done; empty: nothing."""
    if step.prints and not re.search(step.prints, text, re.M):
        return f"printed nothing like {step.prints!r}"
    missing = [pattern for pattern in step.files if not list(folder.glob(pattern))]
    return f"did not make {', '.join(missing)}" if missing else ""


def carried_out(step: Step, shell: Shell) -> str:
    """Run a step; what went wrong, empty: nothing."""
    line = step.run
    for name, value in shell.values.items():
        line = line.replace(f"{{{name}}}", value)
    if step.stays:
        return started(step, line, shell)
    done = shell.run(line)
    wrong = wanting(step, done.stdout, shell.folder)
    if done.returncode not in step.codes:
        wrong = f"exit code {done.returncode}, expected {step.codes}"
    elif not wrong and line.endswith("--json"):
        try:
            wrong = "" if json.loads(done.stdout.strip().splitlines()[-1]) else "an empty JSON object"
        except (ValueError, IndexError):
            wrong = "the last line is not JSON"
    return f"{line}\n{wrong}\n{done.stdout[-2000:]}{done.stderr[-2000:]}" if wrong else ""


def started(step: Step, line: str, shell: Shell) -> str:
    """Start a program that stays, and wait until it is up; what went wrong, empty: nothing."""
    log = shell.folder / f"background-{step.shown.replace('/', '-')}.log"
    process = shell.start(line, log)
    shell.running.append(process)
    end = time.monotonic() + PATIENCE
    while (wrong := wanting(step, log.read_text(), shell.folder)) and process.poll() is None and time.monotonic() < end:
        time.sleep(0.05)
    if wrong:
        return f"{line}\n{wrong}\n{log.read_text()}"
    if match := re.search(step.prints, log.read_text(), re.M):
        shell.values |= match.groupdict()
    return ""


@pytest.mark.parametrize(
    "page",
    [page for page in PAGES if page not in DOORS and any(steps_of(page))],
    ids=lambda page: str(page.relative_to(ROOT)),
)
def test_the_shell_lines_of_a_page_run_in_their_order(page: Path, shell: Shell, request: pytest.FixtureRequest) -> None:
    if page.stem in FITTED:
        shell.environment["CC"] = optimising()
    faults = []
    for step in steps_of(page):
        if not step.possible:
            continue
        for name in step.needs:
            if not (shell.folder / name).exists():
                make(name, shell.folder, request.getfixturevalue("learned"))
        faults.append(carried_out(step, shell))
        if step.ends:
            shell.close()
    assert not any(faults), "\n\n".join(filter(None, faults))


def test_the_table_names_only_lines_that_a_page_shows() -> None:
    shown = {line for page in PAGES for line in lines_of(page)}
    steps, reasons = table()
    assert not {*steps, *reasons} - shown


def test_every_line_of_steerkit_as_it_is_shown_is_a_valid_command() -> None:
    """Whatever its short form: its command, options, arguments and their kinds are there. A command that is only named
    has no arguments."""
    lines = {line for page in PAGES for line in lines_of(page) if line.startswith("steerkit ")}
    whole = sorted(
        line for line in lines if not re.search(r"[|;&<>$*]|completion|--help|^steerkit [a-z]+( [a-z]+)?$", line)
    )
    assert len(whole) > 90
    for line in whole:
        parsed(shlex.split(line)[1:])


# ---- examples -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("script", EXAMPLES)
def test_an_example_has_a_quick_form(script: str, shell: Shell) -> None:
    if script in OTHER_PACKAGES:
        pytest.importorskip(OTHER_PACKAGES[script])
    make("examples", shell.folder, Path())
    assert carried_out(Step(shown="", run=EXAMPLE.format(script) + SHORTER.get(script, ""), prints="."), shell) == ""
