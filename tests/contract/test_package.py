"""What is shipped: the wheel holds every file of the package, what says what it is agrees, and each page for users
leads, in an empty folder, to its last line."""

import contextlib
import subprocess
import sys
import tempfile
import tomllib
import zipfile
from pathlib import Path

import pytest

import steerkit
from benchmarks.run.sources import source
from tests.contract.test_commands import Shell, bin_folder, carried_out, learned, make
from tests.support import programs
from tests.support.compilers import optimising
from tests.support.places import ROOT
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


def test_the_hooks_are_the_tools_of_make_lint() -> None:
    yaml = pytest.importorskip("yaml", reason="comes with the extra docs")
    hooks = yaml.safe_load((ROOT / ".pre-commit-config.yaml").read_text(encoding="utf-8"))["repos"][0]["hooks"]
    entries = {hook["entry"].removeprefix(".venv/bin/").replace(" --force-exclude", "") for hook in hooks}
    lint = (ROOT / "Makefile").read_text(encoding="utf-8").split("\nlint:")[1].split("\n\n")[0]
    assert entries == {line.strip().removeprefix("$(BIN)/") for line in lint.splitlines()[1:]}


# ---- the pages for users --------------------------------------------------------------------------------------------

INSTALLING = 2
"""Commands from a wheel to an environment: make one, install."""
MOST = 12
"""Commands that a page for users may take."""


def follow(*given: str) -> None:
    """Every Python block and shell line of a page in its order, in one process; the long lines in their short forms."""
    page, folder, bin_folder, learned = map(Path, given)
    steps, _ = table()
    names = {"__name__": "__main__"}
    with contextlib.closing(Shell(folder, bin_folder)) as shell:
        for language, text in blocks(page):
            if language == "python":
                exec(compile(text, page, "exec"), names)
            for line in lines_in(text) if language == "sh" else ():
                now = steps.get(line, step(line))
                for file in now.needs:
                    if not (folder / file).exists():
                        make(file, folder, learned)
                if now.possible and (fault := carried_out(now, shell)):
                    sys.exit(fault)


@pytest.mark.parametrize("page", DOORS, ids=lambda page: page.stem)
def test_a_page_for_users_leads_to_its_last_line(
    page: Path, bin_folder: Path, learned: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """`make dist` runs this with what the wheel has installed."""
    monkeypatch.setenv("MPLBACKEND", "agg")
    if page.stem in FITTED:
        monkeypatch.setenv("CC", optimising())
    lines = [line for language, text in blocks(page) if language == "sh" for line in lines_in(text)]
    assert not table()[1].keys() & set(lines), "each of them can be run"
    assert INSTALLING + len(lines) + sum(language == "python" for language, _ in blocks(page)) <= MOST
    with tempfile.TemporaryDirectory(prefix="steerkit-") as name:
        given = [str(page), name, str(bin_folder), str(learned)]
        code = f"from tests.contract.test_package import follow; follow(*{given})"
        done = programs.python("-c", code, folder=Path(name))
    assert done.returncode == 0, done.stderr
