"""A car, looked at while it drives: what it says is shown under the names of a drive, and it is only asked."""

from __future__ import annotations

from typing import Any

import pytest

from steerkit.car.client import CarLost, ReplayLink
from steerkit.car.panel import stream
from steerkit.car.protocol import Snapshot
from steerkit.car.state_machine import Mode
from steerkit.logs import foxglove


class Shown:
    """In the place of a `Server`."""

    def __init__(self) -> None:
        self.names: list[str] = []
        self.rows: list[tuple[float, list[float]]] = []
        self.words: list[tuple[str, Any]] = []

    def begin(self, names: list[str]) -> None:
        self.names = names

    def show(self, t: float, values: list[float]) -> None:
        self.rows.append((t, values))

    def note(self, topic: str, words: Any, t: float) -> None:
        self.words.append((topic, words))


def test_snapshots_are_shown_under_the_names_of_the_layouts() -> None:
    one = Snapshot(t=7.0, x=1.0, y=2.0, psi=0.1, v=5.0, r=0.2, delta_sw=0.3, e=0.04, psi_e=0.05, command=0.6)
    link, server = ReplayLink([one, one, one._replace(t=7.1, mode=Mode.ENGAGED, text="key e")]), Shown()
    with pytest.raises(CarLost, match="has ended"):
        stream(link, server, rate=200.0)  # type: ignore[arg-type]
    assert [t for t, _ in server.rows] == [7.0, 7.1]
    now = dict(zip(server.names, server.rows[0][1], strict=True))
    shown = {name: now[source] for name, source in foxglove.shown_as(server.names).items()}
    wanted = {"/car/x": 1.0, "/car/y": 2.0, "/car/psi": 0.1, "/car/v": 5.0, "/car/r": 0.2, "/path/e": 0.04}
    wanted |= {"/path/psi_e": 0.05, "/wheel/delta_sw": 0.3, "/wheel/delta_sw_cmd": 0.6}
    assert {name: shown[name] for name in wanted} == wanted
    assert server.words == [("/state", {"mode": "OFF", "text": ""}), ("/state", {"mode": "ENGAGED", "text": "key e"})]
    assert link.requests == []


@pytest.mark.parametrize("rate", [0.0, -1.0, float("nan"), 1000.0])
def test_a_rate_that_would_be_a_burden_is_refused(rate: float) -> None:
    with pytest.raises(ValueError, match="expected more than 0, up to 200"):
        stream(ReplayLink([]), Shown(), rate=rate)  # type: ignore[arg-type]
