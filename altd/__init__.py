"""The measuring daemon of an Active Laser Target."""

__version__ = "0.1.0"
