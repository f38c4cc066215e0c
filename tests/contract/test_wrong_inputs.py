"""Wrong inputs, of those that people give: each is refused at once, in words that say where, what and what to do.

They stand in tests/support/wrong_inputs.toml.
"""

import math
import shlex
import textwrap
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import steerkit
from steerkit.compiled.trace import TraceError
from steerkit.diagram import maths as m
from steerkit.diagram.block import Block
from steerkit.diagram.loop import Loop
from steerkit.gym import Task, TrackSteering, TrackSteeringVector, from_stable_baselines
from steerkit.paths.importers import course_of, read_course
from steerkit.plants.speed_driver import ConstantSpeed
from steerkit.scenario import Scenario
from tests.support.command_lines import run
from tests.support.places import SUPPORT

TABLE = tomllib.loads((SUPPORT / "wrong_inputs.toml").read_text(encoding="utf-8"))["wrong"]
ON_PURPOSE = (ValueError, TypeError, KeyError, TraceError)
"""What the library raises for a mistake of its user's; WiringError is a ValueError."""

PASSAT, PATH = steerkit.vehicle("vw-passat"), steerkit.course("circle")
CAR = steerkit.placed(steerkit.NonlinearSingleTrack(vehicle=PASSAT, v0=5.0), PATH)
HUMAN = ConstantSpeed(speed=5.0)


def loop_of(controller: Block) -> Loop:
    """A car on a circle."""
    return steerkit.steering_loop(car=CAR, path=PATH, driver=HUMAN, controller=controller)


NAMES: dict[str, Any] = {
    **{name: getattr(steerkit, name) for name in steerkit.__all__},
    "ConstantSpeed": ConstantSpeed,
    "Scenario": Scenario,
    **{one.__name__: one for one in (Task, TrackSteering, TrackSteeringVector, from_stable_baselines)},
    **{one.__name__: one for one in (course_of, read_course)},
    "dataclass": dataclass,
    "math": math,
    "m": m,
    "np": np,
    "passat": PASSAT,
    "path": PATH,
    "car": CAR,
    "driver": HUMAN,
    "loop_of": loop_of,
    "__name__": "wrong",
}
"""What the table's code finds without importing it."""
MINE = """
@dataclass(frozen=True, eq=False, kw_only=True)
class Mine(Block):
    e = In("m")
    delta_sw = Out("rad")
{body}

simulate(loop_of(Mine()), 0.2, batch={cars})
"""


def code_of(entry: dict[str, Any]) -> str:
    """The Python of an entry."""
    if "block" in entry:
        return MINE.format(body=textwrap.indent(entry["block"], "    "), cars=entry.get("cars"))
    return str(entry["code"])


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty folder to be in."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


def write(files: dict[str, str], encoding: str, folder: Path) -> None:
    for name, text in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(text.encode(encoding))


def contents(folder: Path) -> dict[str, bytes]:
    return {str(f.relative_to(folder)): f.read_bytes() for f in sorted(folder.rglob("*")) if f.is_file()}


@pytest.mark.parametrize("entry", TABLE, ids=[entry["what"] for entry in TABLE])
def test_a_wrong_input_is_refused_in_words(
    entry: dict[str, Any], folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    write(entry.get("files", {}), entry.get("encoding", "utf-8"), folder)
    before = contents(folder)
    if "command" in entry:
        assert run(*shlex.split(entry["command"]), monkeypatch=monkeypatch) == 2
        answer = capsys.readouterr().err.strip()
        assert len(answer.splitlines()) == 1
        assert answer.startswith("steerkit: ")
    else:
        with pytest.raises(ON_PURPOSE) as caught:
            exec(compile(code_of(entry), "mine.py", "exec", dont_inherit=True), dict(NAMES))
        answer = str(caught.value)
    assert not [words for words in entry["says"] if words not in answer], answer
    assert contents(folder) == before
