"""The way of a command: quanta, dead band, delays of its own."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from steerkit.plants.steering_link import SteeringLink
from tests.support.stepped import run

commands = st.lists(st.floats(-9.0, 9.0), min_size=1, max_size=50)


def sent(link: SteeringLink, given: list[float]) -> np.ndarray:
    return np.array([y.delta_sw for y in run(link, [(command,) for command in given])[0]])


@given(given=commands, quantum=st.sampled_from([0.001, 0.1, 0.7]))
def test_a_command_is_rounded_to_the_nearest_quantum(given: list[float], quantum: float) -> None:
    out = sent(SteeringLink(quantum=quantum), given)
    assert (abs(out - given) <= 0.5 * quantum * (1.0 + 1e-9)).all()
    np.testing.assert_allclose(out / quantum, np.round(out / quantum), atol=1e-6)


@given(given=commands, dead_band=st.floats(0.0, 0.9))
def test_what_is_kept_is_within_the_dead_band_and_what_is_new_is_the_command(given, dead_band) -> None:
    out = sent(SteeringLink(dead_band=dead_band), given)
    assert (abs(out - given) <= dead_band).all()
    changed = np.flatnonzero(np.diff(out)) + 1
    assert (out[changed] == np.array(given)[changed]).all()
    assert (abs(np.diff(out))[changed - 1] > dead_band).all()


def test_a_slow_ramp_becomes_steps_of_the_dead_band() -> None:
    out = sent(SteeringLink(dead_band=0.125), (np.arange(1024) / 1024).tolist())
    steps = np.diff(out)[np.diff(out) > 0.0]
    assert steps == pytest.approx([0.125 + 1 / 1024] * 7, abs=1e-15)


@given(given=commands)
def test_off_it_is_not_there(given: list[float]) -> None:
    assert (sent(SteeringLink(), given) == given).all()


def arrivals(link: SteeringLink, count: int) -> np.ndarray:
    """How many samples after it was given each of `count` commands arrives: command k is k, given for `every`."""
    hold = round(link.every / link.dt)
    out = sent(link, np.repeat(np.arange(count, dtype=float), hold).tolist())
    assert (np.diff(out) >= 0.0).all(), "a command overtook another"
    return np.array([np.argmax(out >= k) - k * hold for k in range(1, count - 10)])


def test_each_command_takes_a_time_of_its_own() -> None:
    """Uniform over 0 to 4 samples where that is less than the time between commands."""
    found = np.bincount(arrivals(SteeringLink(jitter=0.04, seed=5), 2000), minlength=5)
    assert len(found) == 5
    assert found == pytest.approx([398] * 5, abs=4.0 * np.sqrt(400))


def test_none_is_overtaken_where_the_jitter_is_longer_than_the_time_between_commands() -> None:
    late = arrivals(SteeringLink(jitter=0.1, every=0.02, seed=5), 2000)
    assert late.min() == 0
    assert late.max() > 2  # later than the next command was given
    assert late.max() <= 10


def test_seeds_draw_other_delays_and_a_batch_those_of_its_cars() -> None:
    one, other = (arrivals(SteeringLink(jitter=0.04, seed=seed), 50) for seed in (5, 6))
    assert (one != other).any()
    link = SteeringLink(jitter=0.04, seed=5)
    given = np.repeat(np.arange(50.0), 5)
    together = np.array([y.delta_sw for y in run(link, [(np.full(2, g),) for g in given], x=link.init((2,)))[0]])
    for car in (0, 1):
        assert (together[:, car] == sent(SteeringLink(jitter=0.04, seed=5 + car), given.tolist())).all()


def test_the_state_grows_only_with_jitter() -> None:
    assert len(SteeringLink(quantum=0.1, dead_band=0.1).init()) == 1
    assert len(SteeringLink(jitter=0.03).init()) == 10 + 3


@pytest.mark.parametrize(
    ("field", "value", "says"),
    [
        ("jitter", 0.015, "multiple of dt"),
        ("quantum", -1.0, "expected 0 to 1"),
        ("dead_band", 3.0, "expected 0 to 1"),
        ("every", 0.0, "every = 0.0"),
        ("seed", -1, "seed = -1"),
    ],
)
def test_parameters_out_of_range(field: str, value: float, says: str) -> None:
    with pytest.raises(ValueError, match=says):
        SteeringLink(**{field: value})
