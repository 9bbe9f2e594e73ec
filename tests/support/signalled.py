"""Runs a command line in this process and sends it a signal in the middle of its work.

    python -m support.signalled SIGTERM altd.recording.reader:Recording.frame 5 altd.cli calibrate …

When the named function is called for the fifth time the process gets the signal, from itself: at the same
place on a fast and on a slow computer.
"""

import importlib
import os
import signal
import sys
from collections.abc import Callable
from typing import Any


def main() -> int:
    name, place, count, module, *arguments = sys.argv[1:]
    number = signal.Signals[name]
    where, path = place.split(":")
    owner: Any = importlib.import_module(where)
    *outer, last = path.split(".")
    for attribute in outer:
        owner = getattr(owner, attribute)
    function: Callable[..., Any] = getattr(owner, last)
    calls = 0

    def signalled(*args: Any, **more: Any) -> Any:
        nonlocal calls
        calls += 1
        if calls == int(count):
            os.kill(os.getpid(), number)
        return function(*args, **more)

    setattr(owner, last, signalled)
    for user in list(sys.modules.values()):  # one that imported the function by name before
        if vars(user).get(last) is function:
            setattr(user, last, signalled)
    status: int = importlib.import_module(f"{module}.__main__").main(arguments)
    return status


if __name__ == "__main__":
    sys.exit(main())
