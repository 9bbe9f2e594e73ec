"""``altd watch``: shows the unit live on a terminal."""

from __future__ import annotations

import argparse
import time

from altd.cli.arguments import add_socket, socket_of

SUMMARY = "show the running daemon live: targets, values, trends, causes and remedies"

_TIMEOUT_S = 1.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    add_socket(parser)


def run(options: argparse.Namespace) -> int:
    """Show the unit until ``q`` or a signal; return 0, or 1 if the terminal was closed."""
    from altd.app.ask_daemon import Follower, RunningDaemon
    from altd.cli.watch_terminal import Gone, Terminal, check_terminal, in_terminal
    from altd.terminal.knowledge import Knowledge
    from altd.terminal.screen import ScreenView, draw

    path = socket_of(options)
    check_terminal()

    def show(terminal: Terminal) -> None:
        knowledge, view = Knowledge(), ScreenView()
        with Follower(RunningDaemon(path, _TIMEOUT_S)) as follower:
            while True:
                follower.update(knowledge)
                canvas = terminal.canvas()
                view = draw(knowledge, time.monotonic(), view, canvas)
                terminal.show(canvas)
                for key in terminal.pressed():
                    if key == "q":
                        return
                    view = view.pressed(key)

    try:
        in_terminal(show)
    except Gone:
        return 1
    return 0
