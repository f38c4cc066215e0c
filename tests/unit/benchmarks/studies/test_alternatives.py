"""Other ways to learn from the same drive: that each is what its name says."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from benchmarks.studies.alternatives import (
    Actor,
    InFlight,
    _delayed_step,
    acted,
    against_aligned,
    waiting_record,
    with_waiting,
)
from steerkit.controllers.delay_compensator import PREVIEW, DelayCompensator
from steerkit.controllers.nfq_policy import NfqPolicy
from steerkit.controllers.policy import COLUMNS, DOE, E_DOT, PSI_E
from steerkit.learning.data.transitions import Transitions
from steerkit.learning.nfq.iterate import action_values
from steerkit.learning.nfq.model import CarModel
from steerkit.learning.nfq.network import new_net
from steerkit.learning.settings import DEFAULT

PLAIN = replace(DEFAULT.description(), scaled_from=np.inf)
MODEL = CarModel(held=1.0, pushed=1.0, now=0.02, before=0.01, earlier=0.005, back=0.5, yaw=0.4, limit=9.0)
SEEN = dict(e=0.1, e_dot=-0.2, v=6.0, psi_e=0.03, r_e=-0.02, doe=0.4)


def test_the_angles_on_their_way_are_inputs_of_the_net() -> None:
    wide = with_waiting(PLAIN, 3)
    nets = tuple(new_net((len(wide.names) + 1, 10, 10, 1), [k]) for k in range(4))
    policy = InFlight(nets=nets, description=wide, setting=DEFAULT, straight=0.05)
    x = (0.1, 0.2, 0.3)
    y = policy.output(0.0, x, policy.D(**SEEN))
    s = np.array([[*list(SEEN.values())[:DOE], 0.35, 0.25, 0.15, 0.05]])  # newest first, from going straight on
    q = action_values(nets, s, DEFAULT.actions, wide)[:, 0]
    assert y.q == pytest.approx(float(q.min()), abs=1e-6)
    best = DEFAULT.actions[int(q.argmin())]
    assert abs(y.action - best) <= 0.5 * max(abs(a - best) for a in DEFAULT.actions)
    assert policy.update(0.0, x, policy.U(**SEEN), y) == (0.2, 0.3, 0.4)
    assert policy.settle(0.0, policy.init(), policy.D(**SEEN)) == (0.4, 0.4, 0.4)


def test_a_delayed_car_does_what_the_car_does_later() -> None:
    """Three samples on their way: the motion is that of the car without dead time, three samples later."""
    n, rng = 3, np.random.default_rng(0)
    actions = rng.normal(0.0, 0.1, 12)
    now = np.array([[0.1, -0.2, 6.0, 0.03, -0.02, 0.4]])
    earlier, prompt = np.array([0.4]), [now]
    for a in actions:
        s = prompt[-1]
        prompt.append(MODEL.step(s, np.array([a]), earlier))
        earlier = s[:, DOE]
    angles = [0.4] * (n + 1)
    late, before = np.column_stack([now, [angles[1:]]]), np.array([0.4])
    for a in actions:
        acts = late[:, DOE + n]
        late = _delayed_step(MODEL, late, np.array([a]), before, np.zeros((1, len(COLUMNS))), n)
        before = acts
    # while the first command was on its way the car went on under the angle that acted
    wait = now
    for _ in range(n):
        wait = MODEL.step(wait, np.zeros(1), np.array([0.4]))
    earlier = np.array([0.4])
    for a in actions[: len(actions) - n]:
        wait, earlier = MODEL.step(wait, np.array([a]), earlier), wait[:, DOE]
    assert late[:, :DOE] == pytest.approx(wait[:, :DOE], abs=1e-12)
    assert late[0, DOE] == pytest.approx(0.4 + actions.sum())


def test_a_records_waiting_angles_are_those_before_it() -> None:
    record = Transitions(COLUMNS)
    s = np.zeros((8, len(COLUMNS)))
    s[:, DOE] = np.arange(8.0)
    s_next = s.copy()
    s_next[:, DOE] += 1.0
    record.extend(s, np.ones(8), s_next, np.repeat([0, 1], 4))
    whole = waiting_record(record, 2, 0.5, with_waiting(PLAIN, 2))
    assert whole.s[:, DOE:].tolist() == [[1.5, 0.5, -0.5], [2.5, 1.5, 0.5], [5.5, 4.5, 3.5], [6.5, 5.5, 4.5]]
    assert whole.s_next[:, DOE:].tolist() == [[2.5, 1.5, 0.5], [3.5, 2.5, 1.5], [6.5, 5.5, 4.5], [7.5, 6.5, 5.5]]


def test_an_actor_is_the_same_in_the_mirror_and_sees_the_forecast_state() -> None:
    net = new_net((len(COLUMNS), 10, 10, 1), [1])
    s = np.array([list(SEEN.values())])
    assert acted(net, s, PLAIN) == pytest.approx(-acted(net, s * np.array(PLAIN.mirror_signs), PLAIN), abs=1e-7)
    numbers: dict[str, Any] = {name: getattr(MODEL, name) for name in ("now", "before", "earlier", "back", "yaw")}
    forecast = DelayCompensator(samples=4, **numbers)
    actor = Actor(nets=(net,), description=PLAIN, reach=0.4, forecast=forecast)
    greedy = NfqPolicy(description=PLAIN, preview_points=PREVIEW, forecast=forecast)
    u = actor.D(**SEEN, preview=(0.0,) * PREVIEW)
    x = actor.settle(0.0, actor.init(), u)
    assert x == greedy.settle(0.0, greedy.init(), u)
    ahead = np.array([forecast.ahead(x, u)])
    assert abs(ahead[0, E_DOT] - SEEN["e_dot"]) > 0.01
    assert abs(ahead[0, PSI_E] - SEEN["psi_e"]) > 0.001
    assert actor.output(0.0, x, u).action == pytest.approx(0.4 * acted(net, ahead, PLAIN)[0])


def test_ratios_are_of_drives_that_were_held_by_both() -> None:
    def driven(way: str, seed: int, held: bool, rms: float) -> dict[str, Any]:
        return {"delay_s": 0.2, "seed": seed, "way": way, "held": held, "rms_e_m": rms, "wheel_deg_s": 10.0 * rms}

    rows = [driven(way, 0, True, rms) for way, rms in (("default", 1.0), ("aligned", 2.0), ("in flight", 3.0))]
    rows += [driven("actor", 0, False, 9.0), driven("in flight", 1, True, 9.0), driven("aligned", 1, False, 1.0)]
    figures = against_aligned(rows)
    assert (figures["in_flight_rms_x"], figures["default_wheel_x"]) == (1.5, 0.5)
    assert (figures["in_flight_held_share"], figures["aligned_held_share"], figures["actor_held_share"]) == (
        1.0,
        0.5,
        0.0,
    )
    assert "actor_rms_x" not in figures
