"""Whether all that altd runs on goes with its own licence, Apache-2.0: ``python -m tools.licences``."""
