"""The recordings of the tests of identification."""

from tests.unit.identification.conftest import clean, found

__all__ = ["clean", "found"]
