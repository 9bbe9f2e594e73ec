"""A clock that a test moves, and a board and health that tell its time."""

from support.status_fixtures import board, clock, health, published

__all__ = ["board", "clock", "health", "published"]
