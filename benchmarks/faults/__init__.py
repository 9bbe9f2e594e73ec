"""The fault suite: the whole daemon on a stepped clock, disturbed, and judged on every interface."""
