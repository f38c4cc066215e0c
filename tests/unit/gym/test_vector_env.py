"""Many cars as one environment are the single ones, through ends and starts."""

from typing import Any

import gymnasium
import numpy as np
import pytest

from steerkit._support import native
from steerkit.diagram import maths as m
from steerkit.diagram.block import Block
from steerkit.gym import TrackSteeringVector
from steerkit.paths.path import Path
from steerkit.scenario import Scenario
from tests.support.straight_road import recorded_speed

ID = "steerkit/TrackSteering-v0"
CONTINUOUS = "steerkit/TrackSteeringContinuous-v0"
needs_compiler = pytest.mark.skipif(native.compiler() is None, reason="C needs a compiler")
backends = pytest.mark.parametrize("backend", ["python", pytest.param("c", marks=needs_compiler)])


def rolled(env: Any, actions: np.ndarray, seed: int) -> list[tuple[Any, ...]]:
    observation, info = env.reset(seed=seed)
    rows: list[tuple[Any, ...]] = [(observation.copy(), info["e"], info["x"])]
    for action in actions:
        observation, reward, terminated, truncated, info = env.step(action)
        rows.append((observation.copy(), reward.copy(), terminated.copy(), truncated.copy(), info["e"], info["x"]))
    return rows


@backends
@pytest.mark.parametrize(("name", "conditions"), [(ID, "hard"), (CONTINUOUS, "clean")])
def test_many_cars_are_the_single_ones_through_ends_and_starts(name: str, conditions: str, backend: str) -> None:
    rng = np.random.default_rng(0)
    wide = rng.integers(0, 5, (65, 3)) if name == ID else rng.uniform(-0.4, 0.4, (65, 3, 1)).astype(np.float32)
    options: dict[str, Any] = {"conditions": conditions, "duration": 3.0}
    one_by_one = rolled(gymnasium.make_vec(name, 3, vectorization_mode="sync", **options), wide, 11)
    together = rolled(gymnasium.make_vec(name, 3, backend=backend, **options), wide, 11)
    assert sum(row[2].sum() + row[3].sum() for row in together[1:]) >= 3
    for single, many in zip(one_by_one, together):
        for a, b in zip(single, many):
            np.testing.assert_allclose(np.asarray(b, float), np.asarray(a, float), atol=1e-9)


def test_without_a_compiler_the_error_names_the_other_backend(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CC", "no-such-compiler")
    for make in (lambda: gymnasium.make_vec(ID, 2), lambda: gymnasium.make(ID, backend="c")):
        with pytest.raises(native.NoCompilerError, match=r"no C compiler found .*; or go without: backend='python'"):
            make()


@backends
@pytest.mark.filterwarnings("ignore:invalid value:RuntimeWarning")
@pytest.mark.parametrize("cars", [1, 3])
def test_a_cost_that_is_no_number_any_more_is_named(cars: int, backend: Any) -> None:
    def root(s: Any, a: Any, s_next: Any) -> Any:
        return m.sqrt(0.02 - s_next[:, 0] * s_next[:, 0]), m.absolute(s_next[:, 0]) > 0.5

    env = TrackSteeringVector(cars, backend=backend, cost=root, course="straight")
    env.reset(seed=0)
    left = np.full((100, cars), 4)
    with pytest.raises(FloatingPointError, match=r"the cost of car \d is -?nan after \d+ steps"):
        [env.step(action) for action in left]


FAIL = np.full(2, 4)  # 60 degrees to the left until it fails


def until_an_end(mode: str) -> tuple[Any, ...]:
    """An environment of two cars, and what the step brings in which the first of them fails."""
    env = gymnasium.make_vec(ID, 2, backend="python", course="straight", autoreset_mode=mode)
    env.reset(seed=0)
    while True:
        observation, reward, over, _, info = env.step(FAIL)
        if over.any():
            return env, observation, reward, over, info


def test_an_ended_car_goes_on_in_the_next_step() -> None:
    env, observation, _, over, info = until_an_end("NextStep")
    assert abs(observation[over, 0]) == pytest.approx(abs(info["e"][over]), rel=1e-5)
    assert abs(info["e"][over]) > 0.5
    _, reward, terminated, _, info = env.step(FAIL)
    assert (reward[over], info["t"][over], terminated[over]) == (0.0, 0.0, False)
    assert abs(info["e"][over]) <= 0.1


def test_an_ended_car_goes_on_in_the_same_step() -> None:
    _, _, reward, over, info = until_an_end("SameStep")
    assert abs(info["e"][over]) <= 0.1
    assert reward[over] == -1.0
    (car,) = np.flatnonzero(over)
    assert abs(info["final_obs"][car][0]) > 0.5
    assert abs(info["final_info"]["e"][car]) > 0.5
    assert info["_final_info"].tolist() == over.tolist()


def test_an_ended_car_waits_for_its_reset() -> None:
    env, _, _, over, info = until_an_end("Disabled")
    with pytest.raises(gymnasium.error.ResetNeeded):
        env.step(FAIL)
    _, info = env.reset(options={"reset_mask": over})
    assert abs(info["e"][over]) <= 0.1
    env.step(FAIL)


@needs_compiler
def test_a_loop_that_asks_for_the_time_is_not_compiled_for_many() -> None:
    class Recorded(Scenario):
        def blocks(self, path: Path, s: float = 0.0, seed: int = 0) -> dict[str, Block | None]:
            return super().blocks(path, s, seed) | {"driver": recorded_speed((4.0, 6.0, 5.0), spacing=1.0)}

    with pytest.raises(ValueError, match="depends on the time t"):
        TrackSteeringVector(2, scenario=Recorded())
    wide = np.random.default_rng(0).integers(0, 5, (50, 2))
    options: dict[str, Any] = {"scenario": Recorded(), "duration": 1.0}
    together = rolled(TrackSteeringVector(2, backend="python", **options), wide, 1)
    one_by_one = rolled(gymnasium.make_vec(ID, 2, vectorization_mode="sync", **options), wide, 1)
    for single, many in zip(one_by_one, together):
        np.testing.assert_allclose(many[-1], single[-1], atol=1e-9)
