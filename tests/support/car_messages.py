"""The shipped car's configuration, and any message to its core."""

from functools import cache

from hypothesis import strategies as st

from steerkit.car.config import CarConfig, load
from steerkit.car.protocol import ESTIMATES, VERSION, Adapted, Beat, Command, Estimates, Filtered, Hello, Query, Request
from steerkit.car.state_machine import Order


@cache
def config() -> CarConfig:
    return load("dbw-kit.toml")


messages = st.one_of(
    st.builds(Hello, st.booleans(), st.just(VERSION), st.text(max_size=8), st.text(max_size=8)),
    st.just(Beat()),
    st.just(Query()),
    st.builds(Command, st.sampled_from(Order)),
    st.builds(Request, st.floats(), st.floats(), st.integers(0, 2**32 - 1)),
    st.builds(Adapted, *[st.floats()] * 2),
    st.builds(Filtered, *[st.floats()] * 7),
    st.builds(Estimates, st.tuples(*[st.floats()] * (3 * len(ESTIMATES)))),
)
