"""MRG32k3a: the published numbers; moments; independence of seeds and streams."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from steerkit._support.random import normals, seed_state, uniform


def draws(state, n, draw=uniform):
    numbers = []
    for _ in range(n):
        *u, state = draw(state)
        numbers.append(u)
    return np.array(numbers), state


def test_published_numbers():
    numbers, _ = draws((12345.0,) * 6, 5)  # L'Ecuyer's RngStreams, the default seed
    published = "0.12701112204657714 0.3185275653967945 0.3091860155832701 0.8258468629271136 0.2216299157820229"
    assert numbers[:, 0].tolist() == [float(number) for number in published.split()]


@given(seed=st.integers(0, 2**63 - 1), stream=st.integers(0, 9))
def test_arithmetic_is_exact(seed, stream):
    """Whole-number arithmetic gives the same states."""
    state = seed_state(seed, stream=stream)
    a, b, c, d, e, f = map(int, state)
    for _ in range(20):
        u, state = uniform(state)
        a, b, c = b, c, (1403580 * b - 810728 * a) % 4294967087
        d, e, f = e, f, (527612 * f - 1370589 * d) % 4294944443
        assert tuple(map(int, state)) == (a, b, c, d, e, f)
        assert u == ((c - f) % 4294967087 or 4294967087) * 2.328306549295727688e-10
        assert 0.0 < u < 1.0


def test_moments():
    n = 40_000
    u = draws(seed_state(0, (n,)), 3)[0][:, 0]
    assert u.mean(axis=1) == pytest.approx(np.full(3, 0.5), abs=4.0 / np.sqrt(12.0 * n))
    assert u.var(axis=1) == pytest.approx(np.full(3, 1.0 / 12.0), rel=0.02)
    z = draws(seed_state(0, (n,)), 2, normals)[0].reshape(4, n)
    assert z.mean(axis=1) == pytest.approx(np.zeros(4), abs=4.0 / np.sqrt(n))
    assert np.cov(z) == pytest.approx(np.eye(4), abs=0.03)
    assert (z**4).mean(axis=1) == pytest.approx(np.full(4, 3.0), rel=0.07)


def test_neighbouring_seeds_and_streams_are_unrelated():
    first = np.array(seed_state(1, (20_000,)))
    second = np.array(seed_state(1, (20_000,), stream=1))
    assert abs(np.corrcoef(np.vstack([first, second, np.roll(first, 1)])) - np.eye(18)).max() < 0.03


@pytest.mark.parametrize("seed", [-1, 1.5, True, 2**63, "1", None])
def test_bad_seeds(seed):
    with pytest.raises(ValueError, match=r"seed_state: seed = .*whole number"):
        seed_state(seed)
