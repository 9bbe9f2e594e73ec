"""``python -m altd.publish.opcua DESCRIPTOR DAEMON``: the process of the server, which ends with the daemon.

It is bound to the daemon, by the number of its process, before it imports anything large.
"""

from __future__ import annotations

import ctypes
import os
import signal
import sys

_PR_SET_PDEATHSIG = 1


def main() -> int:
    """Serve; return the exit status."""
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != int(sys.argv[2]):  # the daemon has ended before this: no signal will come
        return 0
    from altd.publish.opcua.process import run

    return run(int(sys.argv[1]))


if __name__ == "__main__":
    sys.exit(main())
