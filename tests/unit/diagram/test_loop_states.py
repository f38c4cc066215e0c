"""States of a loop in files: saved and loaded bit for bit; foreign ones are refused."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from steerkit.compiled.graph import Graph, Symbol
from steerkit.diagram.block import Block, Out
from steerkit.diagram.loop import Loop
from steerkit.diagram.simulation import simulate
from tests.support.parts import Count, Delay, Gain, Pair, Wave, chain


def wavy() -> Loop:
    wave, slow, gain, pair = Wave(), Delay(dt=0.15), Gain(k=0.3), Pair()
    wires = [(wave.v, slow.u), (slow.y, gain.u), (gain.y, pair.u)]
    return Loop(blocks={"wave": wave, "slow": slow, "gain": gain, "pair": pair}, wires=wires)


@pytest.mark.parametrize("batch", [None, 3])
def test_a_saved_state_goes_on_bit_for_bit(tmp_path: Path, batch: int | None) -> None:
    loop = wavy()
    whole = simulate(loop, 3.0, batch=batch)
    first = simulate(loop, 1.0, batch=batch)  # 20 ticks: in the middle of the slow block's hold
    assert first.state is not None
    loop.save_state(first.state, tmp_path / "state")
    loaded = wavy().load_state(tmp_path / "state")
    assert loaded.k == 20
    rest = simulate(loop, 2.0, state=loaded)
    for name in whole:
        np.testing.assert_array_equal(np.concatenate([first[name], rest[name]]), whole[name])
    np.testing.assert_array_equal(np.concatenate([first.t, rest.t]), whole.t)
    if batch is None:
        assert loaded == first.state
        assert {type(v) for x in loaded.x for v in x} == {float}


@dataclass(frozen=True, eq=False, kw_only=True)
class Mixed(Block):
    """One state a car, one for all of them."""

    a = Out("m", direct=())

    def init(self, batch: tuple[int, ...] = ()) -> Any:
        return (np.arange(3.0), 1.0)

    def output(self, t: Any, x: Any, u: Any) -> Any:
        return self.Y(x[0] + x[1])


def test_a_state_shared_by_all_cars_is_saved_too(tmp_path: Path) -> None:
    loop = Loop(blocks={"mixed": Mixed()}, wires=[])
    loop.save_state(loop.init(batch=3), tmp_path / "state.npz")
    sample = loop.step(loop.load_state(tmp_path / "state.npz"))[1]
    np.testing.assert_array_equal(sample["mixed.a"], [1.0, 2.0, 3.0])


def test_a_loop_starts_from_symbols_as_it_does_from_numbers() -> None:
    loop, graph = wavy(), Graph()
    numbers = [block.init() for block in loop.blocks.values()]
    state = loop.init(x=[tuple(map(graph.input, range(len(x)))) for x in numbers])
    assert [len(x) for x in state.x] == [len(x) for x in numbers]
    assert all(type(value) is Symbol for x in state.x for value in x)


def test_foreign_state_files_are_refused(tmp_path: Path) -> None:
    loop, file = wavy(), tmp_path / "state.npz"
    loop.save_state(loop.init(), file)
    np.savez(tmp_path / "other.npz", a=np.zeros(3))
    with pytest.raises(ValueError, match=r"other.npz lacks k; it is no state of Loop\(wave, slow, gain, pair"):
        loop.load_state(tmp_path / "other.npz")
    with pytest.raises(ValueError, match=r"lacks count.0; it is no state of Loop\(count"):
        chain().load_state(file)
    wave = Wave()
    with pytest.raises(ValueError, match=r"holds gain.y; it is no state of Loop\(wave;"):
        Loop(blocks={"wave": wave}, wires=[]).load_state(file)
    longer = Loop(blocks={"wave": Count()}, wires=[])
    longer.save_state(longer.init(), file)
    with pytest.raises(ValueError, match=r"lacks wave.1"):
        Loop(blocks={"wave": wave}, wires=[]).load_state(file)
    two, turned = (Loop(blocks={name: Count() for name in names}, wires=[]) for names in ("ab", "ba"))
    two.save_state(two.init(), file)
    with pytest.raises(ValueError, match="holds the same names in another order or number"):
        turned.load_state(file)
