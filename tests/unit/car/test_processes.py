"""The processes of a car: what they import, what they are told by a program and by the command line, how they end."""

import json
import math
import subprocess
import sys
from typing import Any

import pytest

from steerkit.car import processes
from tests.support.command_lines import run

KIT = "dbw-kit.toml"


def test_no_process_of_the_car_imports_a_learner() -> None:
    """Nor a command line: it is up sooner, and what is not there cannot fail. The bus is refused, after all imports."""
    how = json.dumps({"config": KIT, "channel": "socketcan:none"})
    code = "import sys\nfrom steerkit.car.processes import main\n"
    for command in ("server", "simulate"):
        code += f"try: main({[command, how]!r})\nexcept BaseException as error: print(error, file=sys.stderr)\n"
    code += "print(*sorted(sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60.0)
    names = done.stdout.splitlines()[-1].split()
    assert {"steerkit.car.config", "can"} <= {*names}, done.stderr
    ours = ("learning", "scenario", "paths.importers", "cli")
    others = (*(f"steerkit.{name}" for name in ours), "typer", "pydantic", "rich")
    assert [n for n in names if n.startswith(others)] == []


@pytest.mark.parametrize(
    ("command", "told", "says"),
    [
        ("server", {"time_scale": 2.0}, "--time-scale 2 on slcan:/dev/ttyACM0: a real car has real time; use"),
        ("simulate", {"channel": "socketcan:can0", "time_scale": 2.0}, "on socketcan:can0: a real car has real time"),
        ("server", {"config": "mine.toml"}, "mine.toml: no such file, beside the configuration or shipped; shipped: "),
        ("server", {"channel": "nowhere:x"}, "[bus] interface 'nowhere' is not known; valid: slcan, socketcan, "),
    ],
)
def test_a_mistake_is_one_line_and_exit_code_2(
    command: str, told: dict[str, Any], says: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert processes.main([command, json.dumps({"config": KIT} | told)]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert says in line


def test_the_command_line_tells_the_same_in_si(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[dict[str, Any]] = []

    def ends_with(code: int) -> Any:
        return lambda config, **told: asked.append({"config": config, **told}) or code

    monkeypatch.setattr(processes, "simulate", ends_with(0))
    monkeypatch.setattr(processes, "server", ends_with(1))
    car = {"channel": "virtual:x", "time_scale": 2.0, "ratio": 1.1, "delay": 0.2, "lag": 0.15}
    car |= {"seed": 3, "v_min": 4.5, "v_max": 5.5, "log": "heard.jsonl"}
    words = [f"--{name.replace('_', '-')}={value}" for name, value in car.items()]
    assert run("car", "simulate", *words, "--offset-deg=90", monkeypatch=monkeypatch) == 0
    assert asked.pop() == {"config": KIT, "offset": pytest.approx(math.pi / 2.0), **car}
    bus = {"socket": "here", "recording": "drive.mcap", "channel": "virtual:x", "time_scale": 2.0, "linger": 5.0}
    words = [f"--{name}={value}" for name, value in bus.items() if name != "time_scale"]
    assert run("car", "server", *words, "--time-scale=2", "--realtime", monkeypatch=monkeypatch) == 1
    assert asked.pop() == {"config": KIT, "realtime": True, **bus}
