"""Simulation and logs: batches equal single runs, logs keep names, units and shapes through every file format."""

import math
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from steerkit.diagram.block import Block, In, Out
from steerkit.diagram.loop import Loop, Sample
from steerkit.diagram.simulation import Log, NonFiniteError, check_finite, joined, simulate
from tests.support.parts import Count, Delay, Gain, Pair, Sum, Wave


def loop_of() -> Loop:
    wave, gain, slow, total, pair = Wave(), Gain(k=2.0), Delay(dt=0.1), Sum(), Pair()
    wires = [(wave.v, gain.u), (gain.y, slow.u), (slow.y, total.u), (gain.y, pair.u)]
    return Loop(blocks={"wave": wave, "gain": gain, "slow": slow, "total": total, "pair": pair}, wires=wires)


LOOP = loop_of()


# ---- running ------------------------------------------------------------------------------------------------------


def test_the_signals_are_those_of_the_equations() -> None:
    log = simulate(LOOP, 5.0)
    assert len(log.t) == 100
    np.testing.assert_allclose(log.t, 0.05 * np.arange(100), rtol=1e-15)
    np.testing.assert_allclose(log["wave.v"], np.sin(0.7 * log.t), atol=1e-13)
    np.testing.assert_array_equal(log["gain.y"], 2.0 * log["wave.v"])
    np.testing.assert_array_equal(log["pair.both"], np.column_stack((log["gain.y"], 2.0 * log["gain.y"])))


def test_every_keeps_one_tick_in_so_many() -> None:
    whole, few = simulate(LOOP, 2.0), simulate(LOOP, 2.0, every=7)
    np.testing.assert_array_equal(few.t, whole.t[::7])
    for name in whole:
        np.testing.assert_array_equal(few[name], whole[name][::7])
    assert few.state == whole.state
    state = simulate(LOOP, 0.15).state  # three ticks: it does not matter where a run began
    assert simulate(LOOP, 0.5, state=state, every=5).t == pytest.approx([0.25, 0.5])


def test_until_ends_after_the_first_sample_that_it_accepts() -> None:
    seen: list[float] = []

    def until(sample: Sample) -> bool:
        seen.append(sample["wave.v"])
        return bool(sample["wave.v"] > 0.5)

    log = simulate(LOOP, 100.0, until=until)
    assert log["wave.v"].tolist() == seen
    assert (log["wave.v"][:-1] <= 0.5).all()
    assert log["wave.v"][-1] > 0.5
    assert log.state is not None
    assert log.state.k == len(log.t)
    after = simulate(LOOP, 0.05, state=log.state)
    assert after.t[0] == pytest.approx(log.t[-1] + 0.05)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"duration": -1.0}, "duration = -1.0 s"),
        ({"duration": math.nan}, "duration = nan s"),
        ({"duration": math.inf}, "duration = inf s"),
        ({"duration": 1.0, "every": 0}, "every = 0, expected a whole number >= 1"),
        ({"duration": 1.0, "batch": 2, "state": LOOP.init()}, "give state or batch, not both"),
    ],
)
def test_bad_arguments(arguments: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=re.escape(message)):
        simulate(LOOP, **arguments)


@dataclass(frozen=True, eq=False, kw_only=True)
class Breaks(Block):
    """Passes u on until `at`, then NaN or an exception."""

    u = In("m")
    y = Out("m")
    at: float = 0.5
    how: str = "nan"

    def output(self, t: Any, x: Any, u: Any) -> Any:
        if t < self.at - 1e-9:
            return self.Y(u.u)
        if self.how == "raise":
            raise RuntimeError("the sensor fell off")
        return self.Y(float(self.how))


def breaking(**parameters: Any) -> Loop:
    count, breaks, total = Count(), Breaks(**parameters), Sum()
    wires = [(count.n, breaks.u), (breaks.y, total.u)]
    return Loop(blocks={"total": total, "breaks": breaks, "count": count}, wires=wires)


@pytest.mark.parametrize("how", ["nan", "inf"])
def test_the_first_non_finite_signal_is_named_and_the_run_is_kept(how: str) -> None:
    with pytest.raises(NonFiniteError, match=rf"breaks.y \[m\] is {how} at t = 0.5 s, first of all signals") as caught:
        simulate(breaking(how=how), 1.0)
    assert len(caught.value.log.t) == 20
    assert caught.value.log["breaks.y"][:10].tolist() == list(range(10))
    log = simulate(breaking(how=how), 1.0, allow_nonfinite=True)
    assert np.isfinite(log["total.total"][:11]).all()
    assert not np.isfinite(log["total.total"][11:]).any()


def test_an_exception_says_when_and_where() -> None:
    with pytest.raises(RuntimeError, match="the sensor fell off") as caught:
        simulate(breaking(how="raise"), 1.0)
    assert caught.value.__notes__[:1] == ["in tick 10, t = 0.5 s, of Loop(total, breaks, count; 2 wires; dt = 0.05 s)"]


def test_of_many_cars_the_first_that_became_nan_are_named_and_how_many_did() -> None:
    lost = np.arange(1000) % 100 == 7
    log = Log(np.array([0.0, 0.1]), {"car.e": np.stack([np.zeros(1000), np.where(lost, -np.inf, 0.0)])}, {"car.e": "m"})
    with pytest.raises(NonFiniteError) as caught:
        check_finite(log)
    said = "car.e [m] is -inf for 10 of 1000 (7, 107, 207, 307, 407, ...) at t = 0.1 s, first of all signals"
    assert str(caught.value).startswith(said)


# ---- logs ---------------------------------------------------------------------------------------------------------


def test_a_log_is_asked_by_name_or_by_port() -> None:
    log = simulate(LOOP, 1.0)
    assert log[LOOP.blocks["gain"].y] is log["gain.y"]
    assert list(log) == ["wave.v", "gain.y", "slow.y", "total.total", "pair.both"]
    assert len(log) == 5
    assert log.units == dict.fromkeys(log, "m")
    assert repr(log).startswith("Log(20 samples, t = 0 to 0.95 s; wave.v, ")
    with pytest.raises(KeyError, match=r"no signal 'gain.z' in the log; recorded: wave.v, gain.y, "):
        log["gain.z"]
    with pytest.raises(KeyError, match=r"a block that is not in this loop"):
        log[Gain().y]


def test_pandas_has_a_column_a_number() -> None:
    log = simulate(LOOP, 1.0)
    frame = log.to_pandas()
    assert frame.index.name == "t"
    assert list(frame.columns) == ["wave.v", "gain.y", "slow.y", "total.total", "pair.both[0]", "pair.both[1]"]
    np.testing.assert_array_equal(frame.index, log.t)
    np.testing.assert_array_equal(frame["pair.both[1]"], log["pair.both"][:, 1])
    assert frame.attrs["units"] == log.units
    batch = simulate(LOOP, 1.0, batch=2)
    assert batch.to_pandas().shape == (20, 2 * 4 + 4)
    np.testing.assert_array_equal(batch.columns()["wave.v[1]"], batch["wave.v"][:, 1])
    np.testing.assert_array_equal(batch.columns()["pair.both[3]"], batch["pair.both"][:, 1, 1])


def test_parquet_keeps_columns_and_units(tmp_path: Path) -> None:
    import pyarrow.parquet as pq

    log = simulate(LOOP, 1.0)
    log.save(tmp_path / "log.parquet")
    table = pq.read_table(tmp_path / "log.parquet")
    assert table.column_names == list(log.columns())
    for name, values in log.columns().items():
        np.testing.assert_array_equal(table[name].to_numpy(), values)
    assert {f.name: f.metadata[b"unit"] for f in table.schema} == {
        name: b"s" if name == "t" else b"m" for name in log.columns()
    }


@pytest.mark.parametrize("batch", [None, 3])
def test_a_saved_log_comes_back(tmp_path: Path, batch: int | None) -> None:
    log = simulate(LOOP, 1.0, batch=batch)
    log.save(tmp_path / "log.npz")
    back = Log.load(tmp_path / "log.npz")
    assert list(back) == list(log)
    assert back.units == log.units
    np.testing.assert_array_equal(back.t, log.t)
    for name in log:
        np.testing.assert_array_equal(back[name], log[name])
    with pytest.raises(KeyError, match=re.escape("Gain.y [m]: this log was loaded from a file; ask by name")):
        back[LOOP.blocks["gain"].y]


def test_a_foreign_file_is_refused(tmp_path: Path) -> None:
    np.savez(tmp_path / "other.npz", t=np.zeros(3))
    with pytest.raises(ValueError, match=r"other.npz was not written by Log.save; it holds t"):
        Log.load(tmp_path / "other.npz")


def test_logs_are_joined_in_order_and_empty_ones_do_not_matter() -> None:
    state = simulate(LOOP, 0.05).state
    empty, full = simulate(LOOP, 0.05, state=state, every=100), simulate(LOOP, 0.5)
    assert joined([empty, full, empty]).t.tolist() == full.t.tolist()
    assert len(joined([empty]).t) == 0
    with pytest.raises(ValueError, match="joined: no logs to join"):
        joined([])


@pytest.mark.parametrize(("duration", "ticks"), [(0.05, 1), (0.15, 3), (0.3, 6), (0.35, 7), (0.01, 1)])
def test_a_duration_is_so_many_ticks_however_it_rounds(duration: float, ticks: int) -> None:
    count = Count()
    assert len(simulate(Loop(blocks={"count": count}, wires=[]), duration).t) == ticks


@dataclass(frozen=True, eq=False, kw_only=True)
class Parting(Block):
    """One number for all cars at first, then one for each."""

    y = Out("m", direct=())

    def init(self, batch: tuple[int, ...] = ()) -> Any:
        return (0.0,)

    def output(self, t: Any, x: Any, u: Any) -> Any:
        return self.Y(x[0])

    def update(self, t: Any, x: Any, u: Any, y: Any) -> Any:
        return (x[0] + np.array([1.0, 2.0]),)


def test_cars_that_part_later_are_recorded_from_the_first_sample() -> None:
    log = simulate(Loop(blocks={"parting": Parting()}, wires=[]), 0.15, batch=2)
    assert log["parting.y"].tolist() == [[0.0, 0.0], [1.0, 2.0], [2.0, 4.0]]


def test_a_log_is_saved_as_its_name_says(tmp_path: Path) -> None:
    log = simulate(LOOP, 1.0)
    log.save(tmp_path / "log.csv")
    head, first, *rest = (tmp_path / "log.csv").read_text().splitlines()
    assert head.split(",")[0] == "t [s]"
    assert all(cell.endswith("]") for cell in head.split(","))
    table = np.array([[float(cell) for cell in line.split(",")] for line in (first, *rest)])
    np.testing.assert_array_equal(table, np.column_stack(list(log.columns().values())))
    for name in ("log.xlsx", "log"):
        with pytest.raises(ValueError, match=r"Log.save: .*log.*, expected .npz, .csv or .parquet at its end"):
            log.save(tmp_path / name)
    assert len([*tmp_path.iterdir()]) == 1
