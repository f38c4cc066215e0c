"""PufferLib's face is the vector environment, in the buffers it is given."""

from __future__ import annotations

from types import SimpleNamespace

import gymnasium
import numpy as np
import pytest

from steerkit._support import native
from steerkit.gym import PufferSteering, TrackSteeringVector

pytestmark = pytest.mark.skipif(native.compiler() is None, reason="C needs a compiler")
CARS = 19


def test_in_place_it_is_the_vector_environment() -> None:
    buffers = SimpleNamespace(
        observations=np.zeros((CARS, 6), np.float32),
        rewards=np.zeros(CARS, np.float32),
        terminals=np.zeros(CARS, bool),
        truncations=np.zeros(CARS, bool),
        masks=np.zeros(CARS, bool),
        actions=np.zeros(CARS, np.int64),
    )
    puffer = PufferSteering(CARS, buf=buffers, seed=5, log_interval=40, duration=0.8)
    vector = TrackSteeringVector(CARS, backend="c", autoreset_mode="SameStep", duration=0.8)
    puffer.async_reset()
    observation, _ = vector.reset(seed=5)
    assert np.array_equal(puffer.recv()[0], observation)
    returns = np.zeros(CARS)
    ended, failures = [], 0
    for actions in np.random.default_rng(1).integers(0, 5, (40, CARS)):
        puffer.send(actions)
        observation, reward, terminated, truncated, _ = vector.step(actions)
        assert np.array_equal(buffers.observations, observation)
        assert np.array_equal(buffers.rewards, reward.astype(np.float32))
        assert np.array_equal(buffers.terminals, terminated)
        assert np.array_equal(buffers.truncations, truncated)
        returns += reward
        over = terminated | truncated
        ended += returns[over].tolist()
        failures += int(terminated.sum())
        returns[over] = 0.0
    (info,), numbers, masks = puffer.recv()[4:]
    assert info["episode_return"] == pytest.approx(np.mean(ended))
    assert info["failures"] == failures / len(ended)
    assert numbers.tolist() == [*range(CARS)]
    assert masks.all()


def test_before_the_first_reset_nothing_is_driven() -> None:
    with pytest.raises(gymnasium.error.ResetNeeded, match="call reset"):
        PufferSteering(4).step(np.full(4, 2))


def test_a_buffer_of_another_shape_is_refused() -> None:
    with pytest.raises(ValueError, match=r"buf.observations of shape \(3, 6\), expected \(4, 6\)"):
        PufferSteering(4, buf=SimpleNamespace(observations=np.zeros((3, 6), np.float32)))
