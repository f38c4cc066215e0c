"""The recordings of the tests of identification."""

from tests.unit.identification.test_fit import clean, found

__all__ = ["clean", "found"]
