"""The file for the controls challenge, run as that runs one, gives the block's commands."""

import dataclasses
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest

from steerkit.compiled.trace import TraceError
from steerkit.controllers.lateral import PREVIEW, ChallengeController, LateralMpc
from steerkit.controllers.stanley import Stanley
from steerkit.diagram.block import Block
from steerkit.export.car import controls_challenge
from steerkit.plants.speed_driver import Playback
from steerkit.scenario.lateral import LateralTarget
from steerkit.vehicles import VW_PASSAT

TOLD = LateralMpc.told(0.4, 0.1)


def controller(text: str, monkeypatch: pytest.MonkeyPatch) -> Any:
    """The class in a file of the challenge's package `controllers`; nothing of ours is there."""
    package, module = ModuleType("controllers"), ModuleType("controllers.mine")
    package.BaseController = type("BaseController", (), {})  # type: ignore[attr-defined]
    module.__package__ = "controllers"
    monkeypatch.setitem(sys.modules, "controllers", package)
    exec(compile(text, "mine.py", "exec"), vars(module))
    return vars(module)["Controller"]


@pytest.mark.parametrize("moves", [1, 10])
def test_it_gives_the_commands_of_the_block(moves: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Over noise and large targets, up to the end of the data, where fewer samples are ahead."""
    block = LateralMpc(response=TOLD, moves=moves)
    text = controls_challenge(block)
    assert "steerkit" not in text.partition('"""\n')[2]
    theirs = controller(text, monkeypatch)()
    rng, n = np.random.default_rng(0), 120
    target, roll, a_y = 3.0 * rng.normal(size=n).cumsum() / 10.0, 0.1 * rng.normal(size=n), rng.normal(size=n)
    x, commands = block.init(), []
    for k in range(n):
        last = np.minimum(np.arange(k + 1, k + 1 + PREVIEW), n - 1)
        u = block.U(a_y[k], roll[k], tuple(target[last].tolist()), tuple(roll[last].tolist()))
        y = block.output(0.0, x, u)
        x = block.update(0.0, x, u, y)
        commands.append(y.a_y_cmd)
        plan = SimpleNamespace(
            lataccel=target[k + 1 : k + PREVIEW + 1].tolist(),
            roll_lataccel=roll[k + 1 : k + PREVIEW + 1].tolist(),
            v_ego=[],
            a_ego=[],
        )
        state = SimpleNamespace(roll_lataccel=roll[k], v_ego=20.0, a_ego=0.0)
        assert theirs.update(target[k], a_y[k], state, plan) == pytest.approx(y.a_y_cmd, abs=1e-9)
    assert max(map(abs, commands)) == 2.0


def test_tables_go_along(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a block that is nothing but one: the target at each sample since the start."""
    from steerkit.diagram.block import In, Out

    @dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
    class Tabled(Block):
        a_y = In("m/s^2")
        a_y_cmd = Out("m/s^2")
        target: LateralTarget

        def init(self, batch: tuple[int, ...] = ()) -> Any:
            return (0.0,)

        def output(self, t: Any, x: Any, u: Any) -> Any:
            return self.Y(self.target.table(x[0])[0] - u.a_y)

        def update(self, t: Any, x: Any, u: Any, y: Any) -> Any:
            return (x[0] + 1.0,)

    text = controls_challenge(Tabled(target=LateralTarget.of([0.5, -0.25, 1.0], 10.0)))
    theirs = controller(text, monkeypatch)()
    plan, state = (
        SimpleNamespace(lataccel=[], roll_lataccel=[], v_ego=[], a_ego=[]),
        SimpleNamespace(roll_lataccel=0.0, v_ego=10.0, a_ego=0.0),
    )
    assert [theirs.update(0.0, 0.1, state, plan) for _ in range(3)] == pytest.approx([0.4, -0.35, 0.9])


def test_it_drives_here_too(tmp_path: Path) -> None:
    file = tmp_path / "ours.py"
    file.write_text(controls_challenge(LateralMpc(response=TOLD)))
    assert ChallengeController.load(f"{file}:Controller").make().x[-4] == 1.0


def test_what_no_file_can_hold_is_said() -> None:
    with pytest.raises(ValueError, match="controls_challenge: Stanley: input"):
        controls_challenge(Stanley.of(VW_PASSAT))
    with pytest.raises(ValueError, match="controls_challenge: Playback: output"):
        controls_challenge(Playback(angles=(0.0, 0.5), speeds=(4.0, 5.0)))
    with pytest.raises(TraceError, match="cannot be run on symbols"):
        controls_challenge(ChallengeController(make=object))
