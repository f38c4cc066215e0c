"""Every Python block in README and docs runs, what is shown as output is what comes out, and every picture and file
that they name is there. Their shell lines: test_commands.py."""

import ast
import codeop
import importlib.util
import pkgutil
import re
import runpy
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from steerkit.cli.app import COMMANDS
from tests.support import programs
from tests.support.compilers import optimising
from tests.support.house import modules
from tests.support.places import ROOT
from tests.support.shell_lines import BLOCK, DOORS, FITTED, PAGES, blocks

GALLERY = ROOT / "docs" / "gallery.md"

ROW = re.compile(r"^\| .* \| (?:yes|no) \| .*\|$", re.M)
"""Of `steerkit.scenario.drive.comparison`; a learner's row differs from machine to machine."""


def name_of(page: Path) -> str:
    return str(page.relative_to(ROOT))


# the gallery's page is made of its scripts, which run below
CODE = [
    page
    for page in PAGES
    if page not in (GALLERY, *DOORS) and any(language == "python" for language, _ in blocks(page))
]


BEFORE = """    "Stanley": drive(scenario, Stanley.of(passat)),
    "Stanley, textbook": drive(scenario, Stanley.textbook(passat)),
}"""
SHORTER = {
    "looking": {"fps=5": "fps=1"},
    "tutorial": {
        "minutes=0.75": "minutes=0.1",
        "doe=run.experiment.setting.element(passat)": "doe=run.experiment.setting.element(passat), rounds=0.1",
        "Mine(k=4.0)),\n" + BEFORE: "Mine(k=4.0)),\n    **dict(list(logs.items())[1:]),\n}",  # driven above
    },
}
"""What makes a page's blocks take less time, by its name; nothing that is printed and shown depends on it."""


@pytest.mark.parametrize("page", CODE, ids=name_of)
def test_python_blocks_run_in_their_order_and_print_what_is_shown(
    page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A `text` block right after a `python` block is its output."""
    if page.stem in FITTED:
        monkeypatch.setenv("CC", optimising())
    fenced = blocks(page)
    monkeypatch.setenv("MPLBACKEND", "agg")
    monkeypatch.setenv("COLUMNS", "120")
    code = "\n".join(text for language, text in fenced if language == "python")
    for long, short in SHORTER.get(page.stem, {}).items():
        assert code.count(long) == 1
        code = code.replace(long, short)
    done = programs.python("-c", code, folder=tmp_path)
    assert done.returncode == 0, done.stderr
    written = page.read_text(encoding="utf-8")
    between = BLOCK.split(written)[::3]
    printed = re.sub(r" *[│|] *", "|", done.stdout)
    for row in ROW.findall(written):  # a table of drives, which is printed with other lines around it
        assert row.startswith("| learned") or re.sub(r" *[|] *", "|", row) in printed, row
    for k, (language, shown) in enumerate(fenced):
        if language == "text" and k and fenced[k - 1][0] == "python" and not between[k].strip():
            assert shown.strip() in done.stdout


def typed(text: str) -> list[ast.stmt]:
    """The statements that Python's prompt makes of a block's lines, as `code.InteractiveConsole` does, and an Enter."""
    compiler = codeop.CommandCompiler()
    waiting: list[str] = []
    found: list[ast.stmt] = []
    for line in [*text.splitlines(), ""]:
        waiting.append(line)
        if compiler("\n".join(waiting), "<prompt>", "single") is not None:
            found += ast.parse("\n".join(waiting)).body
            waiting = []
    assert not waiting, "the last statement is not complete"
    return found


IN_A_FILE = [ROOT / "docs" / "howto" / f"{name}.md" for name in ("controller", "doe", "plant")]
"""Pages of classes that one writes into a file: lines are left blank between their methods."""


@pytest.mark.parametrize("page", [p for p in [*CODE, GALLERY] if p not in IN_A_FILE], ids=name_of)
def test_python_blocks_can_be_pasted_at_the_prompt(page: Path) -> None:
    """A blank line in a class ends it there, and a line right after a loop is a mistake: not one statement differs."""
    for language, text in blocks(page):
        if language == "python":
            assert [ast.dump(s) for s in typed(text)] == [ast.dump(s) for s in ast.parse(text).body]


def test_every_extra_that_is_named_is_there_and_stands_under_install() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    extras = project["optional-dependencies"]
    sources = [file for package in ("steerkit", "benchmarks") for file in (ROOT / package).rglob("*.py")]
    words = "\n".join(file.read_text(encoding="utf-8") for file in [*PAGES, *sources])
    assert set(re.findall(r"steerkit-control\[(\w+)\]", words)) <= extras.keys()
    install = (ROOT / "docs" / "index.md").read_text(encoding="utf-8").split("## Install")[1]
    assert set(re.findall(r"`(\w+)`", install)) >= extras.keys()
    assert any("moviepy" in package for package in extras["film"]), "gymnasium.wrappers.RecordVideo needs it"
    assert "download.pytorch.org/whl/cpu" in install
    assert f"steerkit_control-{project['version']}-py3-none-any.whl" in install


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_links_lead_somewhere(page: Path) -> None:
    for target in re.findall(r"\]\((?!https?:|#)([^)#]+)", BLOCK.sub("", page.read_text(encoding="utf-8"))):
        assert (page.parent / target).exists(), target


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_files_and_names_of_the_package_that_are_named_are_there(page: Path) -> None:
    for code in re.findall(r"`([^`\n]+)`", page.read_text(encoding="utf-8")):
        file = re.fullmatch(r"(steerkit|benchmarks|tests|docs|examples)/[\w./-]+", code)
        if file and not re.search("NAME|/X/", code):
            assert (ROOT / code.partition("::")[0]).exists(), code
        if name := re.match(r"(steerkit(?:\.\w+)+)(?:\(|$)", code):
            assert found_in_the_package(name[1]), code


def found_in_the_package(dotted: str) -> bool:
    """Is it a module, or a name in one?"""
    try:
        return pkgutil.resolve_name(dotted) is not None
    except (ImportError, AttributeError):
        return False


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
    shown = [ast.dump(ast.parse(text)) for language, text in blocks(GALLERY) if language == "python"]
    # all of a script but its docstring
    whole = [ast.parse((maker.SCRIPTS / f"{name}.py").read_text("utf-8")) for name in maker.ORDER]
    assert shown == [ast.dump(ast.Module(tree.body[1:], [])) for tree in whole], "not all, but its docstring"
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
    assert any("steerkit._support.errors is on no page of the reference" in message for message in caplog.messages)


@pytest.mark.usefixtures("without_layout")
@pytest.mark.parametrize("script", sorted((ROOT / "examples" / "gallery").glob("*.py")), ids=lambda script: script.stem)
def test_gallery(
    script: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """It runs (here, since the imports are the larger part), says something, and its picture is not empty.

    What learns does so for 6 s, on a circle: `python docs/tools/make_gallery.py` runs all in full.
    """
    from matplotlib.image import imread

    monkeypatch.chdir(tmp_path)
    code = re.sub(r"minutes=[\d./ ]+", "minutes=0.1", script.read_text(encoding="utf-8"))
    quick = tmp_path / script.name
    quick.write_text(code.replace('"paper"', '"circle"').replace("rounds=0.43", "rounds=0.1"), encoding="utf-8")
    runpy.run_path(str(quick), run_name="__main__")
    assert capsys.readouterr().out.strip()
    picture = imread(tmp_path / f"{script.stem}.png")
    assert min(picture.shape[:2]) > 200
    assert len(np.unique(np.rint(255 * picture[..., :3]) @ (1, 256, 65536))) > 50, "colours"


def test_every_command_is_explained_on_one_page() -> None:
    """The table of docs/howto/command-line.md has each command once, and the page that it leads to shows it."""
    here = ROOT / "docs" / "howto" / "command-line.md"
    rows = re.findall(r"^\| (`[^|]+`) \| \[[\w-]+\]\(([\w./-]+)\) \|$", here.read_text(encoding="utf-8"), re.M)
    pages = {command: target for commands, target in rows for command in re.findall(r"`(\w+)`", commands)}
    assert sorted(pages) == sorted(COMMANDS)
    assert sum(len(re.findall(r"`(\w+)`", commands)) for commands, _ in rows) == len(COMMANDS)
    for command, target in pages.items():
        text = (here.parent / target).read_text(encoding="utf-8")
        assert re.search(rf"(steerkit|make|python -m benchmarks)\s+{command}\b", text), command
