"""The fault suite: the whole daemon on a clock that is set, disturbed, and judged on every interface."""
