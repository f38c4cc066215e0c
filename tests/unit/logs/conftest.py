"""The recordings of the tests of identification."""

from tests.unit.identification.test_fit import clean

__all__ = ["clean"]
