"""The recordings of the tests of identification."""

from __future__ import annotations

from tests.unit.identification.conftest import clean, found

__all__ = ["clean", "found"]
