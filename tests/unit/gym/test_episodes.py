"""Episodes of many cars are those of single ones, in Python and in C, however they go on."""

from dataclasses import dataclass
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

from steerkit._support import native
from steerkit.gym import TrackSteeringVector
from steerkit.gym.episodes import Episodes, episode_code
from steerkit.gym.task import Task

pytestmark = pytest.mark.skipif(native.compiler() is None, reason="C needs a compiler")
ID = "steerkit/TrackSteering-v0"
CARS = 19  # more than two groups of lanes, and not a whole number of them


@dataclass(frozen=True)
class Sorting:
    """A cost that no symbol can be asked for."""

    goal: float = 0.05

    def __call__(self, s: Any, a: Any, s_next: Any) -> Any:
        return np.sort(np.abs(s_next[:, 0])), s_next[:, 0] > 0.5


def rolled(env: Any, mode: AutoresetMode = AutoresetMode.NEXT_STEP) -> list[Any]:
    """What two seconds of random actions bring."""
    rows: list[Any] = [*env.reset(seed=5)]
    over = np.zeros(CARS, dtype=bool)
    for actions in np.random.default_rng(1).integers(0, 5, (40, CARS)):
        if mode is AutoresetMode.DISABLED and over.any():
            rows += [*env.reset(options={"reset_mask": over})]
        rows += [*env.step(actions)]
        over = rows[-3] | rows[-2]
    return rows


def made(backend: str, mode: AutoresetMode = AutoresetMode.NEXT_STEP, **options: Any) -> Any:
    return TrackSteeringVector(CARS, backend=backend, autoreset_mode=mode, duration=0.8, **options)  # type: ignore[arg-type]


def same(a: Any, b: Any) -> None:
    if isinstance(a, dict):
        assert a.keys() == b.keys()
        for key in a:
            same(a[key], b[key])
    elif isinstance(a, np.ndarray) and a.dtype == object:
        for x, y in zip(a, b, strict=True):
            assert (x is None) == (y is None)
            if x is not None:
                same(x, y)
    else:
        np.testing.assert_allclose(np.asarray(b, float), np.asarray(a, float), atol=1e-9)


@pytest.mark.parametrize("mode", AutoresetMode)
def test_in_each_way_to_go_on_they_are_those_of_single_cars(mode: AutoresetMode) -> None:
    """Which Gymnasium drives one by one."""
    how: dict[str, Any] = {"vectorization_mode": "sync", "vector_kwargs": {"autoreset_mode": mode}}
    single = rolled(gymnasium.make_vec(ID, CARS, duration=0.8, conditions="hard", **how), mode)
    by_python, in_c = (made(backend, mode, conditions="hard") for backend in ("python", "c"))
    assert isinstance(in_c._cars, Episodes)
    for env in (by_python, in_c):
        for a, b in zip(single, rolled(env, mode), strict=True):
            same(a, b)
    ends = [int(flags.sum()) for flags in single if isinstance(flags, np.ndarray) and flags.dtype.kind == "b"]
    assert sum(ends) > CARS
    for a, b in zip(by_python.np_random, in_c.np_random):
        assert a.bit_generator.state == b.bit_generator.state


def test_however_many_threads_it_is_the_same_to_the_bit() -> None:
    one, three = (rolled(made("c", AutoresetMode.SAME_STEP, threads=threads)) for threads in (1, 3))
    for a, b in zip(one, three, strict=True):
        if isinstance(a, np.ndarray):
            assert np.array_equal(a, b)


def test_what_was_given_is_not_written_over() -> None:
    env = TrackSteeringVector(2, backend="c")
    first, _ = env.reset(seed=0)
    before = first.copy()
    second, *_ = env.step([4, 4])
    assert np.array_equal(first, before)
    assert not np.array_equal(second, before)


def test_a_cost_that_cannot_be_compiled_is_computed_in_python_and_that_is_said() -> None:
    with pytest.warns(UserWarning, match="the cost cannot be run on symbols.*computed in Python"):
        compiled = made("c", cost=Sorting())
    for a, b in zip(rolled(made("python", cost=Sorting())), rolled(compiled), strict=True):
        same(a, b)


def test_what_is_no_number_any_more_is_told_with_the_car_and_the_signal() -> None:
    task = Task()
    episodes = Episodes(task, CARS, AutoresetMode.NEXT_STEP)
    generators = [np.random.default_rng(i) for i in range(CARS)]
    episodes.draw_from(generators)
    episodes.start(np.arange(CARS), [task.draw(generator) for generator in generators])
    actions = np.zeros(CARS)
    actions[17] = np.nan
    with pytest.raises(FloatingPointError, match="of car 17 is nan after 1 steps"):
        episodes.step(actions)


def test_arguments_are_checked() -> None:
    with pytest.raises(ValueError, match=r"threads = 0, expected a whole number >= 1"):
        TrackSteeringVector(2, backend="c", threads=0)
    env = TrackSteeringVector(2, backend="c")
    with pytest.raises(gymnasium.error.ResetNeeded):
        env.step([2, 2])


def test_the_streams_of_random_numbers_are_those_of_the_blocks() -> None:
    """Of a clean car the human's alone; under hard conditions the sensors' two as well: noise and faults."""
    codes = [episode_code(Task(conditions=conditions))[0] for conditions in ("clean", "hard")]
    streams = [line for code in codes for line in code.splitlines() if line.startswith("#define STREAMS")]
    assert [line.count(",") for line in streams] == [0, 2]
