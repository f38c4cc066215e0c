"""A clean recording, and what is identified from a noisy one."""

from collections.abc import Iterator
from typing import Any

import pytest

from steerkit.identification import Drive, identify
from steerkit.identification.fit import Identified
from tests.support.compilers import optimised
from tests.support.recorded_cars import BASE, driven, noisy


@pytest.fixture(scope="package", autouse=True)
def quick_code() -> Iterator[None]:
    """A fit drives for hours."""
    with optimised():
        yield


@pytest.fixture(scope="session")
def clean() -> dict[str, Any]:
    return driven()


@pytest.fixture(scope="session")
def found(clean: dict[str, Any]) -> Identified:
    with optimised():
        return identify(Drive.of(noisy(clean, 0), name="lap"), BASE, name="my-car")
