"""Exported C compiles without a warning, runs clean under sanitizers and replays its log."""

import re
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from steerkit.controllers.nfq_policy import NfqPolicy
from steerkit.controllers.stanley import Stanley
from steerkit.controllers.supervisor import Supervisor
from steerkit.diagram.block import Block
from steerkit.diagram.loop import Loop
from steerkit.doe import Integrator, LowPass
from steerkit.export.c import export_c
from steerkit.paths.courses import circle
from steerkit.plants.sensors import Sensors
from steerkit.plants.single_track import LinearSingleTrack
from steerkit.plants.speed_driver import ConstantSpeed
from steerkit.plants.steering_actuator import SteeringActuator
from steerkit.scenario.assembly import placed, steering_loop
from steerkit.vehicles import VW_PASSAT as CAR

STRICT = ["-std=c99", "-Wall", "-Wextra", "-Wconversion", "-Wpedantic", "-Werror", "-ffp-contract=off"]
SANITIZED = ["-O1", "-fsanitize=address,undefined", "-fno-sanitize-recover=all"]
needs_gcc = pytest.mark.skipif(shutil.which("gcc") is None, reason="exported C is compiled with gcc")


def policy() -> NfqPolicy:
    rng = np.random.default_rng(7)
    shapes = ((10, 7), (10,), (10, 10), (10,), (1, 10), (1,))
    return NfqPolicy(nets=(tuple(rng.uniform(-0.5, 0.5, shape) for shape in shapes),))


def learner_loop() -> Loop:
    path = circle()
    car = placed(LinearSingleTrack(vehicle=CAR), path, e=0.05)
    who = dict(controller=policy(), doe=Integrator(), recovery=Stanley.of(CAR), driver=ConstantSpeed(speed=6.0))
    return steering_loop(car=car, path=path, actuator=SteeringActuator(delay=0.1), sensors=Sensors.hard(1), **who)


def built(folder: Path, name: str, flags: list[str]) -> subprocess.CompletedProcess[str]:
    program = folder / "replay"
    sources = [str(folder / f"{name}.c"), str(folder / f"{name}_test.c")]
    done = subprocess.run(["gcc", *STRICT, *flags, *sources, "-o", str(program), "-lm"], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    return subprocess.run([str(program)], capture_output=True, text=True)


@needs_gcc
@pytest.mark.parametrize(
    "block",
    [
        Stanley.of(CAR),
        Supervisor(),
        Integrator(),
        LowPass(),
        replace(policy(), ready_from=3.0),  # knows the time: ready after 60 of the 200 samples
        SteeringActuator(delay=0.1),
    ],
    ids=lambda block: type(block).__name__,
)
def test_a_block_replays_its_log_under_sanitizers(block: Block, tmp_path: Path) -> None:
    export_c(block, tmp_path, name="part")
    done = built(tmp_path, "part", SANITIZED)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "200 samples agree" in done.stdout


@needs_gcc
@pytest.mark.parametrize(
    "blocks",
    [
        ("controller", "doe", "recovery", "supervisor"),
        ("recovery_path", "recovery"),
        ("controller", "doe", "supervisor", "actuator"),  # of two rates: the actuator's five samples to one
    ],
)
def test_a_part_of_a_loop_replays_the_simulation(blocks: tuple[str, ...], tmp_path: Path) -> None:
    """Whose policy, ready from 1 s on, has to know the time."""
    export_c(learner_loop().with_block("controller", replace(policy(), ready_from=1.0)), tmp_path, blocks=blocks)
    done = built(tmp_path, "controller", SANITIZED)
    assert done.returncode == 0, done.stdout + done.stderr


@needs_gcc
@pytest.mark.parametrize(("gain", "says"), [("NAN", "is -?nan"), ("2.6", "delta_sw is")])
def test_the_replay_notices_a_changed_gain(gain: str, says: str, tmp_path: Path) -> None:
    export_c(Stanley.of(CAR), tmp_path, name="stanley")
    text = (tmp_path / "stanley.c").read_text()
    assert "= NUMBER(2.5);" in text
    (tmp_path / "stanley.c").write_text(text.replace("= NUMBER(2.5);", f"= NUMBER({gain});"))
    done = built(tmp_path, "stanley", ["-O2"])
    assert done.returncode == 1
    assert re.search(says, done.stdout)


def test_the_code_needs_nothing_but_math_h(tmp_path: Path) -> None:
    export_c(learner_loop(), tmp_path, blocks=("controller", "doe", "recovery", "supervisor"), name="ecu")
    code = (tmp_path / "ecu.c").read_text()
    included = [line for line in code.splitlines() if line.startswith("#include")]
    assert included == ["#include <math.h>", '#include "ecu.h"']
    assert "malloc" not in code


def test_bad_requests_name_the_choices(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"which blocks .*driver, car"):
        export_c(learner_loop(), tmp_path)
    with pytest.raises(ValueError, match=r"block of the loop .controler.*valid: driver"):
        export_c(learner_loop(), tmp_path, blocks=("controler",))
    with pytest.raises(ValueError, match="C identifier"):
        export_c(Supervisor(), tmp_path, name="2 fast")
