"""``python -m altd.cli``."""

from __future__ import annotations

import sys

from altd.cli.main import main

if __name__ == "__main__":
    sys.exit(main())
