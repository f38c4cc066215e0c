"""The loop on a car: what controllers are told, which net drives, and who hears of a missed deadline."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from steerkit.car import loop as loops
from steerkit.car.client import ReplayLink
from steerkit.controllers.nfq_policy import NfqPolicy
from steerkit.controllers.stanley import Stanley
from steerkit.learning.nfq import iterate as nfq
from steerkit.learning.settings import setting
from tests.support.car_world import setup

CONFIG, COURSE = setup()


def test_controllers_are_told_the_kits_delay_and_lag_and_the_lower_of_two_stops() -> None:
    config = replace(CONFIG, delay=0.07, lag=0.31, gate=replace(CONFIG.gate, delta_sw_max=5.0, rate_max=3.0))
    design_model = loops.design_model_of(config)
    assert (design_model.delay, design_model.lag) == (0.07, 0.31)
    assert design_model.rate_limit == 3.0
    assert design_model.vehicle.delta_sw_max == 5.0
    car = replace(config.vehicle, delta_sw_max=4.0)
    assert loops.design_model_of(replace(config, vehicle=car)).vehicle.delta_sw_max == 4.0


def test_foresight_reckons_with_every_limit_of_the_gate() -> None:
    gate = replace(CONFIG.gate, a_y_max=2.5, jerk_max=4.5, rate_max=8.0, delta_sw_max=8.5, v_floor=1.5, quantum=0.002)
    assert loops.foresight(replace(CONFIG, gate=gate)).gate.limits == gate


@pytest.mark.parametrize("name", ["mpc", "mpc-adaptive"])
def test_a_solver_has_its_budget_on_the_road_and_all_the_time_it_needs_in_a_replay(name: str) -> None:
    def solvers(block: Any) -> list[Any]:
        if hasattr(block, "budget"):
            return [block]
        return [solver for inner in getattr(block, "blocks", None) or (block.block,) for solver in solvers(inner)]

    for in_time, budget in ((False, loops.MPC_BUDGET), (True, None)):
        found = solvers(loops.controller_named(name, CONFIG, in_time=in_time).block)
        assert {solver.budget for solver in found} == {budget}
        assert all((solver.clock is None) is in_time for solver in found)


def test_e_is_measured_at_the_front_axle() -> None:
    loop = loops.car_loop(CONFIG, COURSE, ReplayLink([]), Stanley.of(CONFIG.vehicle))
    tracker: Any = loop.blocks["path"]
    assert tracker.reference == CONFIG.vehicle.l_f
    assert loop.inputs_of("controller")["e"] == "path.e"


def test_the_newest_net_of_a_run_drives_but_not_the_one_before_any_learning(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(loops, "element_of", lambda place: setting("default").doe)
    how = setting("default")
    (tmp_path / "nets").mkdir()

    def write(number: int) -> None:
        nets = nfq.fresh_nets(how.fit, how.description(), seed=number)
        policy = NfqPolicy(nets=nets, actions=how.actions, description=how.description())
        policy.save(tmp_path / "nets" / f"net-{number:04d}.npz")

    write(0)
    with pytest.raises(ValueError, match="is not known, nor a place with a trained policy"):
        loops.controller_named(str(tmp_path), CONFIG)
    for number in (3, 1, 2):
        write(number)
    steers = loops.controller_named(str(tmp_path), CONFIG).steers
    assert Path(steers.name).name == "net-0003.npz"


def test_missed_deadlines_go_out_with_the_next_request() -> None:
    link: Any = SimpleNamespace(misses=0)
    run: Any = SimpleNamespace(timing=SimpleNamespace(misses=3))
    loops.count_misses(run, link)
    assert link.misses == 3
