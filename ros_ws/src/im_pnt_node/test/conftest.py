"""Net files of the tests."""

from support.fixtures import data

__all__ = ["data"]
