"""Check that the licences of all packages fit altd's, Apache-2.0: ``python -m tools.licences``."""
