"""altd as it is, but that what the pins are is noted after each setting and before letting go."""

import json
import os
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import gpiod
from support.gpio_sim import levels_of

from altd.cli.main import main

NOTES = Path(os.environ["PIN_NOTES"])
lock = threading.Lock()
LABEL, LINES = os.environ["PIN_CHIP"], os.environ["PIN_LINES"].split()


def note(what: str) -> None:
    with lock:  # of the threads of lamps and indicators: notes are in the order of reading
        try:
            levels = dict(zip(LINES, levels_of(LABEL, LINES), strict=True))
        except FileNotFoundError:
            return  # the chip is unplugged
        with NOTES.open("a") as notes:
            notes.write(json.dumps([what, levels]) + "\n")


def noted_after(what: str, call: Callable[..., Any]) -> Callable[..., Any]:
    def noted(*arguments: Any, **named: Any) -> Any:
        result = call(*arguments, **named)
        note(what)
        return result

    return noted


def noted_before(what: str, call: Callable[..., Any]) -> Callable[..., Any]:
    def noted(*arguments: Any, **named: Any) -> Any:
        note(what)
        return call(*arguments, **named)

    return noted


gpiod.request_lines = noted_after("opened", gpiod.request_lines)
gpiod.LineRequest.set_values = noted_after("set", gpiod.LineRequest.set_values)
gpiod.LineRequest.release = noted_before("let go", gpiod.LineRequest.release)
sys.exit(main())
