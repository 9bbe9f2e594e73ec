"""A clock that a test moves, a board and health."""

from support.status_fixtures import board, clock, health, published

__all__ = ["board", "clock", "health", "published"]
