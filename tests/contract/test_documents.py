"""Every code block in README and docs runs or is a command that exists, what is shown as output is what comes out, and
every picture and file they name is there."""

from __future__ import annotations

import importlib.util
import os
import re
import runpy
import shlex
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.support.command_lines import parsed
from tests.support.places import ROOT

GALLERY = ROOT / "docs" / "gallery.md"
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").glob("**/*.md"))]
BLOCK = re.compile(r"^```(\w*)\n(.*?)^```$", re.M | re.S)

ROW = re.compile(r"^\| .* \| (?:yes|no) \| .*\|$", re.M)
"""Of `steerkit.learning.report.comparison`; a learner's row differs from machine to machine."""


def name_of(page: Path) -> str:
    return str(page.relative_to(ROOT))


def blocks(page: Path) -> list[tuple[str, str]]:
    """(language, text) of the fenced blocks."""
    return BLOCK.findall(page.read_text(encoding="utf-8"))


def python_in(folder: Path, *words: str) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, "MPLBACKEND": "agg", "COLUMNS": "120"}
    return subprocess.run([sys.executable, *words], cwd=folder, capture_output=True, text=True, env=environment)


# the gallery's page is made of its scripts, which run below
CODE = [page for page in PAGES if page != GALLERY and any(language == "python" for language, _ in blocks(page))]


@pytest.mark.parametrize("page", CODE, ids=name_of)
def test_python_blocks_run_in_their_order_and_print_what_is_shown(page: Path, tmp_path: Path) -> None:
    """A `text` block right after a `python` block is its output."""
    found = blocks(page)
    done = python_in(tmp_path, "-c", "\n".join(text for language, text in found if language == "python"))
    assert done.returncode == 0, done.stderr
    written = page.read_text(encoding="utf-8")
    between = BLOCK.split(written)[::3]
    printed = re.sub(r" *[│|] *", "|", done.stdout)
    for row in ROW.findall(written):  # a table of drives, which is printed with other lines around it
        assert row.startswith("| learned") or re.sub(r" *[|] *", "|", row) in printed, row
    for k, (language, shown) in enumerate(found):
        if language == "text" and k and found[k - 1][0] == "python" and not between[k].strip():
            assert shown.strip() in done.stdout


def test_a_wrong_output_would_be_found() -> None:
    """The test above compares something: there are pages with shown output."""
    shown = [page for page in CODE if re.search(r"^```\n\n```text\n", page.read_text(encoding="utf-8"), re.M)]
    assert len(shown) >= 4


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_commands_are_valid(page: Path) -> None:
    """`steerkit ...` parses; a script named after `python` is there and knows the options given to it."""
    lines = [
        line
        for language, text in blocks(page)
        if language in ("", "sh")
        for line in text.replace("\\\n", " ").splitlines()
    ]
    inline = re.findall(
        r"`((?:steerkit|python benchmarks/|python examples/|python docs/)[^`]*)`", page.read_text("utf-8")
    )
    for line in (*lines, *inline):
        words = shlex.split(line.split("|")[0], comments=True)
        words = [word for word in words if word not in ("...", "…")]
        if words[:1] == ["steerkit"] and len(words) > 1 and not words[1].startswith("-"):
            if re.search(r"<|\b[A-Z]{3,}\b", line) or "--help" in words:  # a placeholder such as RUN
                continue
            parsed([*words[1:], *(["--help"] if line in inline else [])])  # in running text, arguments may be missing
        elif words[:1] == ["python"] and words[1:2] and words[1].endswith(".py") and "/" in words[1]:
            source = (ROOT / words[1]).read_text(encoding="utf-8")
            for option in (word.split("=")[0] for word in words[2:] if word.startswith("--")):
                assert f'"{option}"' in source, f"{words[1]} has no {option}"


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_links_lead_somewhere(page: Path) -> None:
    for target in re.findall(r"\]\((?!https?:|#)([^)#]+)", BLOCK.sub("", page.read_text(encoding="utf-8"))):
        assert (page.parent / target).exists(), target


@pytest.mark.parametrize("script", sorted((ROOT / "examples").glob("*.py")), ids=lambda script: script.name)
def test_examples_run(script: Path, tmp_path: Path) -> None:
    done = python_in(tmp_path, str(script))
    if "stable_baselines3" in script.name and not importlib.util.find_spec("stable_baselines3"):
        assert done.returncode == 1
        assert done.stderr == "this example needs stable-baselines3; pip install 'steerkit-control[peers]'\n"
        pytest.skip("needs stable-baselines3: make test-all")
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip()


def make_gallery() -> Any:
    spec = importlib.util.spec_from_file_location("make_gallery", ROOT / "docs" / "tools" / "make_gallery.py")
    assert spec
    assert spec.loader
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_gallery_page_is_made_of_the_scripts_and_no_script_is_left_out() -> None:
    tool = make_gallery()
    assert GALLERY.read_text(encoding="utf-8") == tool.page(), "run python docs/tools/make_gallery.py"
    scripts = {script.stem for script in tool.SCRIPTS.glob("*.py")}
    assert scripts == set(tool.ORDER) == {picture.stem for picture in tool.PICTURES.glob("*.png")}
    assert all(len((tool.SCRIPTS / f"{name}.py").read_text("utf-8").splitlines()) <= 45 for name in scripts)


@pytest.mark.parametrize("script", sorted((ROOT / "examples" / "gallery").glob("*.py")), ids=lambda script: script.stem)
def test_gallery(
    script: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """It runs (here, since the imports are the larger part), says something, and its picture is not empty."""
    from matplotlib.image import imread

    monkeypatch.chdir(tmp_path)
    runpy.run_path(str(script), run_name="__main__")
    assert capsys.readouterr().out.strip()
    picture = imread(tmp_path / f"{script.stem}.png")
    assert min(picture.shape[:2]) > 200
    assert len(np.unique(picture.reshape(-1, picture.shape[2]), axis=0)) > 50
