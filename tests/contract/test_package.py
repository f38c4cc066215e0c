"""What is shipped: the wheel holds every file of the package, what says what it is agrees, and from the wheel alone, in
an empty folder, each page for users leads to its last line."""

import contextlib
import json
import re
import subprocess
import sys
import tempfile
import tomllib
import zipfile
from pathlib import Path
from typing import Any

import pytest

import steerkit
from benchmarks.run.sources import source
from tests.contract.test_commands import Shell, bin_folder, carried_out, learned, make
from tests.support import programs
from tests.support.compilers import optimising
from tests.support.places import ROOT, SUPPORT
from tests.support.shell_lines import DOORS, FITTED, blocks, lines_in, step, table

__all__ = ["bin_folder", "learned"]  # fixtures

PACKAGES = ("steerkit", "benchmarks")
OTHERS = ("paths/courses/LICENSE.genesis", "logs/drives/LICENSE.genesis", "vehicles/LICENSE.opendbc")
"""Licences of what others recorded or wrote."""
sources = pytest.mark.skipif(not (ROOT / "steerkit").is_dir(), reason="runs on the sources; here steerkit is installed")


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The wheel of the sources, built from links in a temporary directory, so that nothing is left in the tree."""
    place = tmp_path_factory.mktemp("wheel")
    for name in ("pyproject.toml", "README.md", "LICENSE", "MANIFEST.in", *PACKAGES):
        (place / name).symlink_to(ROOT / name)
    code = "from setuptools.build_meta import build_wheel; print(build_wheel('.'))"
    done = subprocess.run([sys.executable, "-c", code], cwd=place, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return place / done.stdout.splitlines()[-1]


@sources
def test_the_wheel_holds_every_file_of_the_package_and_nothing_else(wheel: Path) -> None:
    files = [file for package in PACKAGES for file in (ROOT / package).rglob("*") if file.is_file()]
    here = {str(file.relative_to(ROOT)) for file in files if "__pycache__" not in file.parts}
    inside = {name for name in zipfile.ZipFile(wheel).namelist() if ".dist-info/" not in name}
    assert inside == here
    assert {"steerkit/py.typed", "steerkit/paths/courses/genesis.csv", "benchmarks/report/report.html.j2"} <= inside


@sources
def test_the_library_and_its_pages_stay_small() -> None:
    """Whoever adds to them takes something out (CONTRIBUTING)."""
    modules, pages = (ROOT / "steerkit").rglob("*.py"), [ROOT / "README.md", *(ROOT / "docs").rglob("*.md")]
    assert sum(len(file.read_text(encoding="utf-8").splitlines()) for file in modules) < 40_000
    assert sum(len(file.read_text(encoding="utf-8").split()) for file in pages) <= 30_000


@sources
def test_the_wheel_has_the_sources_of_the_checkout(wheel: Path, tmp_path: Path) -> None:
    """As benchmarks see it: a machine with the wheel may work for one with the checkout."""
    zipfile.ZipFile(wheel).extractall(tmp_path)
    assert source(tmp_path) == source(ROOT)


@sources
def test_the_wheel_says_what_it_is(wheel: Path) -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    archive = zipfile.ZipFile(wheel)
    info = {name.split("/", 1)[1]: name for name in archive.namelist() if ".dist-info/" in name}
    assert {"licenses/LICENSE", *(f"licenses/steerkit/{name}" for name in OTHERS)} <= info.keys()
    assert "steerkit = steerkit.cli.app:main" in archive.read(info["entry_points.txt"]).decode()
    metadata = archive.read(info["METADATA"]).decode()
    assert f"Version: {project['version']}\n" in metadata
    assert "Requires-Python: >=3.11" in metadata


def test_the_citation_names_version_and_paper() -> None:
    yaml = pytest.importorskip("yaml", reason="comes with the extra docs")
    cited = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert cited["cff-version"] == "1.2.0"
    assert (cited["version"], cited["license"]) == (project["version"], project["license"])
    assert steerkit.__version__ in (project["version"], "0+unknown")
    assert {"message", "title", "authors"} <= cited.keys()
    assert cited["references"][0]["doi"] == "10.1109/FBIT.2007.37"


def test_the_oldest_python_is_the_same_everywhere() -> None:
    """For installers, the style checker and the type checker."""
    said = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    assert said["project"]["requires-python"] == ">=3.11"
    assert said["tool"]["ruff"]["target-version"] == "py311"
    assert said["tool"]["mypy"]["python_version"] == "3.11"


def test_the_hooks_are_the_tools_of_make_lint() -> None:
    yaml = pytest.importorskip("yaml", reason="comes with the extra docs")
    hooks = yaml.safe_load((ROOT / ".pre-commit-config.yaml").read_text(encoding="utf-8"))["repos"][0]["hooks"]
    entries = {hook["entry"].removeprefix(".venv/bin/").replace(" --force-exclude", "") for hook in hooks}
    lint = (ROOT / "Makefile").read_text(encoding="utf-8").split("\nlint:")[1].split("\n\n")[0]
    assert entries == {line.strip().removeprefix("$(BIN)/") for line in lint.splitlines()[1:]}


def test_the_demo_installs_no_tools_of_development() -> None:
    """`make demo` on a fresh machine: the package and what it needs; the tools come with what uses them."""
    rules = (ROOT / "Makefile").read_text(encoding="utf-8")
    needs = dict(re.findall(r"^([a-z-]+|\$\([A-Z]+\)): (.*?)(?:  ##.*)?$", rules, re.MULTILINE))
    installed = dict(re.findall(r"^(\$\([A-Z]+\)): .*\n(?:\t.*\n)*?\t.* -e (\S+)$", rules, re.MULTILINE))
    assert needs["demo"] == "$(USE)"
    assert installed["$(USE)"] == "."
    assert installed["$(BENCH)"] == "'.[bench]'"
    assert {needs[target] for target in ("test", "lint", "docs", "mutants", "setup")} == {"$(READY)"}
    assert installed["$(READY)"] == "'.[dev]'"
    assert needs["$(READY)"] == needs["$(BENCH)"] == "$(USE)"
    assert needs["$(USE)"] == "pyproject.toml constraints.txt"


# ---- the pages for users --------------------------------------------------------------------------------------------

INSTALLING = 2
"""Commands from a wheel to an environment: make one, install."""
MOST = 12
"""Commands that a page for users may take."""
PROMPT = """
import json, pathlib, runpy, sys
names, programs = {"__name__": "__main__"}, runpy.run_path(sys.argv[1])
for line in sys.stdin:
    match json.loads(line):
        case str(code):
            exec(compile(code, "page", "exec"), names)
        case words, folder, how:
            done = programs["python"](*words, folder=pathlib.Path(folder), **how)
            print(json.dumps([done.returncode, done.stdout, done.stderr]))
    print("done", flush=True)
"""


class Prompt:
    """A Python that is given the blocks of a page, one after the other, and programs to run in forks of it.

    alone: one that starts from nothing, else a fork of this process.
    """

    def __init__(self, shell: Shell, *, alone: bool):
        how = {"cwd": shell.folder, "env": shell.environment, "text": True}
        self.errors = (shell.folder / "errors.txt").open("w+")
        words = [sys.executable, "-c", PROMPT, str(SUPPORT / "programs.py")]
        start: Any = subprocess.Popen if alone else programs.Forked
        self.process = start(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=self.errors, **how)

    def run(self, code: str) -> str:
        """What is wrong; empty: nothing."""
        return "" if self.printed(code) else self.fault(code)

    def fork(self, *words: str, folder: Path, **how: Any) -> subprocess.CompletedProcess[str]:
        """As `tests.support.programs.python` does it here."""
        lines = self.printed([words, str(folder), how])
        assert lines, self.fault(words)
        return subprocess.CompletedProcess(words, *json.loads(lines[-2]))

    def printed(self, task: Any) -> list[str]:
        """The lines that it prints, "done" the last; none: it ended."""
        assert self.process.stdin
        assert self.process.stdout
        self.process.stdin.write(json.dumps(task) + "\n")
        self.process.stdin.flush()
        lines = []
        for line in self.process.stdout:
            lines.append(line)
            if line == "done\n":
                return lines
        return []

    def fault(self, task: Any) -> str:
        """What it said at its end."""
        self.process.wait()
        self.errors.seek(0)
        return f"{task}\n{self.errors.read()}"

    def close(self) -> None:
        """End it."""
        self.process.kill()
        self.process.communicate()
        self.errors.close()


@sources
@pytest.mark.parametrize("page", DOORS, ids=lambda page: page.stem)
def test_a_page_for_users_leads_from_a_wheel_to_its_last_line(
    page: Path, wheel: Path, bin_folder: Path, request: pytest.FixtureRequest, tmp_path: Path
) -> None:
    """Every Python block and shell line in its order, the long ones in the short forms of shell_lines.toml; the first
    page with nothing but the wheel, the others with the checkout, as all programs start faster there."""
    if alone := page == DOORS[0]:
        zipfile.ZipFile(wheel).extractall(tmp_path)
    steps, reasons = table()
    faults, count = [], INSTALLING
    with tempfile.TemporaryDirectory(prefix="steerkit-") as name, contextlib.ExitStack() as stack:
        folder = Path(name)
        shell = stack.enter_context(contextlib.closing(Shell(folder, bin_folder)))
        if alone:
            shell.environment["PYTHONPATH"] = str(tmp_path)
            del shell.environment["CHECKOUT"]
        if page.stem in FITTED:
            shell.environment["CC"] = optimising()
        prompt = stack.enter_context(contextlib.closing(Prompt(shell, alone=alone)))
        if alone:
            shell.fork = prompt.fork
        place = str(tmp_path if alone else ROOT)
        here = f"import steerkit; assert steerkit.__file__.startswith({place!r}), steerkit.__file__"
        assert prompt.run(here) == ""
        for language, text in blocks(page):
            if language == "python":
                count += 1
                faults.append(prompt.run(text))
            for line in lines_in(text) if language == "sh" else ():
                count += 1
                assert line not in reasons
                now = steps.get(line, step(line))
                for file in now.needs:
                    if not (folder / file).exists():
                        make(file, folder, request.getfixturevalue("learned"))
                faults.append(carried_out(now, shell) if now.possible else "")
    assert not any(faults), "\n\n".join(filter(None, faults))
    assert count <= MOST
