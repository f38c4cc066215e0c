"""Every Python block in README and docs runs, what is shown as output is what comes out, and every picture and file
that they name is there. Their shell lines: test_commands.py."""

from __future__ import annotations

import importlib.util
import os
import re
import runpy
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.support.house import modules
from tests.support.places import ROOT
from tests.support.shell_lines import BLOCK, PAGES, blocks

GALLERY = ROOT / "docs" / "gallery.md"

ROW = re.compile(r"^\| .* \| (?:yes|no) \| .*\|$", re.M)
"""Of `steerkit.learning.report.comparison`; a learner's row differs from machine to machine."""


def name_of(page: Path) -> str:
    return str(page.relative_to(ROOT))


def python_in(folder: Path, *words: str) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, "MPLBACKEND": "agg", "COLUMNS": "120"}
    return subprocess.run([sys.executable, *words], cwd=folder, capture_output=True, text=True, env=environment)


# the gallery's page is made of its scripts, which run below
CODE = [page for page in PAGES if page != GALLERY and any(language == "python" for language, _ in blocks(page))]


@pytest.mark.parametrize("page", CODE, ids=name_of)
def test_python_blocks_run_in_their_order_and_print_what_is_shown(page: Path, tmp_path: Path) -> None:
    """A `text` block right after a `python` block is its output."""
    fenced = blocks(page)
    done = python_in(tmp_path, "-c", "\n".join(text for language, text in fenced if language == "python"))
    assert done.returncode == 0, done.stderr
    written = page.read_text(encoding="utf-8")
    between = BLOCK.split(written)[::3]
    printed = re.sub(r" *[│|] *", "|", done.stdout)
    for row in ROW.findall(written):  # a table of drives, which is printed with other lines around it
        assert row.startswith("| learned") or re.sub(r" *[|] *", "|", row) in printed, row
    for k, (language, shown) in enumerate(fenced):
        if language == "text" and k and fenced[k - 1][0] == "python" and not between[k].strip():
            assert shown.strip() in done.stdout


def test_a_wrong_output_would_be_found() -> None:
    """The test above compares something: there are pages with shown output."""
    shown = [page for page in CODE if re.search(r"^```\n\n```text\n", page.read_text(encoding="utf-8"), re.M)]
    assert len(shown) >= 4


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_links_lead_somewhere(page: Path) -> None:
    for target in re.findall(r"\]\((?!https?:|#)([^)#]+)", BLOCK.sub("", page.read_text(encoding="utf-8"))):
        assert (page.parent / target).exists(), target


def tool(name: str) -> Any:
    """A module under docs/tools."""
    spec = importlib.util.spec_from_file_location(name, ROOT / "docs" / "tools" / f"{name}.py")
    assert spec
    assert spec.loader
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_gallery_page_is_made_of_the_scripts_and_no_script_is_left_out() -> None:
    maker = tool("make_gallery")
    assert GALLERY.read_text(encoding="utf-8") == maker.page(), "run python docs/tools/make_gallery.py"
    scripts = {script.stem for script in maker.SCRIPTS.glob("*.py")}
    assert scripts == set(maker.ORDER) == {picture.stem for picture in maker.PICTURES.glob("*.png")}
    assert all(len((maker.SCRIPTS / f"{name}.py").read_text("utf-8").splitlines()) <= 45 for name in scripts)


def test_every_module_has_its_page_of_the_reference(
    caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("mkdocs")
    site = tool("site")
    pages = site.modules()
    assert caplog.messages == []
    assert list(pages) == list(site.GROUPS)
    documented = sorted(name for names in pages.values() for name in names)
    assert len(documented) == len(set(documented)) > 100
    packages = {"steerkit." + name for name in documented}
    assert packages <= modules(ROOT, "steerkit").keys()
    monkeypatch.setattr(site, "GROUPS", {"Blocks and loops": site.GROUPS["Blocks and loops"]})
    site.modules()
    assert any("steerkit.errors is on no page of the reference" in message for message in caplog.messages)


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
