"""`altd watch` in real terminals: what the screen shows of a real daemon, and that it is left as it was."""

import contextlib
import math
import os
import pty
import re
import select
import shlex
import signal
import subprocess
import sys
import termios
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from support.cli import altd
from support.foreign import need_program
from support.local_daemon import LocalDaemon, local_daemon
from support.played_unit import PlayedUnit

from tools.pictures.terminal import Terminal, terminal

GONE = "NO CONNECTION: nothing is known of the unit now"
PATIENCE_S = math.inf
"""For what is no claim of how soon: pytest ends what hangs."""


@pytest.fixture(scope="module")
def unit(played_unit: PlayedUnit, tmp_path_factory: pytest.TempPathFactory) -> Iterator[LocalDaemon]:
    with local_daemon(played_unit, tmp_path_factory.mktemp("unit")) as daemon:
        yield daemon


def watch(path: Path) -> list[str]:
    return [sys.executable, "-m", "altd.cli", "watch", "--socket", str(path)]


@contextlib.contextmanager
def watching(path: Path, columns: int = 80, rows: int = 24) -> Iterator[Terminal]:
    need_program("tmux")
    stale = "LINES=24 COLUMNS=80"  # as a shell exports them
    command = f"env LC_ALL=C.UTF-8 {stale} {shlex.join(watch(path))}; echo ended with $?; sleep 100"
    with terminal(command, columns, rows) as screen:
        yield screen


def await_lines(screen: Terminal, hold: Callable[[list[str]], object]) -> None:
    """Wait until the text on the screen is so; while it is drawn, one part is there before another."""
    deadline = time.monotonic() + PATIENCE_S
    while not hold(lines := screen.text().split("\n")):
        assert time.monotonic() < deadline, "\n".join(lines)
        time.sleep(0.05)


def filled(columns: int, rows: int) -> Callable[[list[str]], bool]:
    """A page to its last line, or how small it is where no page fits."""
    line, wanted = (rows - 1, "tab, arrows") if rows >= 16 else (2, "make the window larger"[:columns])
    return lambda lines: len(lines) > line and wanted in lines[line]


class TestScreen:
    @pytest.mark.parametrize(("columns", "rows"), [(80, 24), (200, 50)])
    def test_it_shows_the_unit(self, unit: LocalDaemon, columns: int, rows: int) -> None:
        with watching(unit.socket, columns, rows) as screen:
            await_lines(screen, lambda lines: self.is_the_unit(unit, lines, columns, rows))

    @staticmethod
    def is_the_unit(unit: LocalDaemon, lines: list[str], columns: int, rows: int) -> bool:
        text, measured = "\n".join(lines), unit.daemon.measurement()
        xs_mm = [float(line.split()[1]) for line in lines if re.match(r"x +-?\d", line)]
        assert max(map(len, lines)) <= columns
        return (
            lines[0].startswith("TEST-1  ")
            and lines[rows - 1].startswith("tab, arrows: [targets] trends causes parts")
            and all(part in text for part in ("PLAYBACK, 0.", "PLAYBACK of a recording", "front: x "))
            and xs_mm == [pytest.approx(measured["x_mm"], abs=0.1)]
            and sum(line.count("O") for line in lines[3 : rows - 10]) == 2  # a spot on each target
        )

    def test_keys_turn_pages_and_q_ends_it(self, unit: LocalDaemon) -> None:
        with watching(unit.socket) as screen:
            screen.await_text("front: x ", PATIENCE_S)
            for key, shown in (
                ("Tab", "[trends]"),
                ("Right", "[causes]"),
                ("Right", "camera front"),
                ("Left", "[causes]"),
                ("h", "this help; any key leaves it"),
                ("x", "[causes]"),
            ):
                screen.press(key)
                screen.await_text(shown, PATIENCE_S)
            screen.press("q")
            screen.await_text("ended with 0", PATIENCE_S)
            assert "TEST-1" not in screen.text(), "the screen is as it was"

    def test_another_size_is_filled_at_once(self, unit: LocalDaemon) -> None:
        with watching(unit.socket) as screen:
            screen.await_text("front: x ", PATIENCE_S)
            for columns, rows in ((120, 40), (60, 16), (30, 8), (80, 24)):
                screen.resize(columns, rows)
                await_lines(screen, filled(columns, rows))


@pytest.mark.real_time
class TestLoss:
    @staticmethod
    def says_nothing(lines: list[str]) -> bool:
        text = "\n".join(lines)
        return GONE in text and not re.search("VALID|PLAYBACK", text)

    def test_nothing_is_shown_2_s_after_the_daemon_hangs_or_dies(
        self, played_unit: PlayedUnit, tmp_path: Path
    ) -> None:
        with local_daemon(played_unit, tmp_path) as unit, watching(unit.socket) as screen:
            screen.await_text("front: x ", PATIENCE_S)
            unit.daemon.process.send_signal(signal.SIGSTOP)
            stopped = time.monotonic()
            await_lines(screen, self.says_nothing)
            assert time.monotonic() - stopped <= 2.0
            unit.daemon.process.send_signal(signal.SIGCONT)
            screen.await_text("front: x ", PATIENCE_S)
            unit.daemon.process.kill()
            killed = time.monotonic()
            await_lines(screen, self.says_nothing)
            assert time.monotonic() - killed <= 2.0
            screen.await_text("the daemon is not running", PATIENCE_S)
            unit.daemon.process.wait()
            with local_daemon(played_unit, tmp_path):
                screen.await_text("PLAYBACK, ", PATIENCE_S)
                screen.await_text("front: x ", PATIENCE_S)

    def test_who_begins_before_the_daemon_waits_for_it(self, played_unit: PlayedUnit, tmp_path: Path) -> None:
        with watching(tmp_path / "altd.sock") as screen:
            screen.await_text("there is no socket", PATIENCE_S)
            with local_daemon(played_unit, tmp_path):
                screen.await_text("front: x ", PATIENCE_S)


class Line:
    """A pseudo terminal with a process on it that leads its session."""

    def __init__(self, *command: str) -> None:
        self.far, self.near = pty.openpty()
        self.before = termios.tcgetattr(self.near)
        self.shown = b""
        self.process = subprocess.Popen(
            command,
            stdin=self.near,
            stdout=self.near,
            stderr=self.near,
            env={**os.environ, "TERM": "xterm", "LC_ALL": "C.UTF-8"},
            start_new_session=True,
            preexec_fn=_take_terminal,
        )

    def await_shown(self, wanted: bytes, timeout_s: float = PATIENCE_S) -> None:
        deadline = time.monotonic() + timeout_s
        while wanted not in self.shown:
            assert time.monotonic() < deadline, self.shown[-2000:]
            if select.select([self.far], [], [], 0.1)[0]:
                self.shown += os.read(self.far, 65536)

    def end(self) -> int:
        deadline = time.monotonic() + PATIENCE_S
        while self.process.poll() is None:
            assert time.monotonic() < deadline, "it does not end"
            if select.select([self.far], [], [], 0.05)[0]:
                self.shown += os.read(self.far, 65536)
        while select.select([self.far], [], [], 0.1)[0]:
            self.shown += os.read(self.far, 65536)
        return self.process.returncode

    def close(self) -> None:
        self.process.kill()
        self.process.wait()
        for end in (self.far, self.near):
            with contextlib.suppress(OSError):
                os.close(end)


def _take_terminal() -> None:
    import fcntl

    fcntl.ioctl(0, termios.TIOCSCTTY, 0)


@contextlib.contextmanager
def on_a_line(*command: str) -> Iterator[Line]:
    line = Line(*command)
    try:
        yield line
    finally:
        line.close()


class TestRestored:
    """xterm: ?1049h is the other screen, ?1049l the one before; ?25l hides the cursor, ?12l?25h shows it."""

    @pytest.mark.parametrize(
        ("how", "status"),
        [("q", 0), ("ctrl-c", 130), (signal.SIGTERM, 143), (signal.SIGHUP, 129), (signal.SIGINT, 130)],
    )
    def test_after_any_end(self, unit: LocalDaemon, how: str | signal.Signals, status: int) -> None:
        with on_a_line(*watch(unit.socket)) as line:
            line.await_shown(b"TEST-1")
            assert b"\x1b[?1049h" in line.shown
            if isinstance(how, signal.Signals):
                line.process.send_signal(how)
            else:
                os.write(line.far, b"q" if how == "q" else b"\x03")
            assert line.end() == status
            assert_left_as_it_was(line)

    def test_after_a_defect(self, unit: LocalDaemon) -> None:
        code = (
            "import sys, altd.terminal.screen as screen\n"
            "real, calls = screen.draw, []\n"
            "def draw(*given):\n"
            "    calls.append(1)\n"
            "    if len(calls) > 5: raise RuntimeError('a defect')\n"
            "    return real(*given)\n"
            "screen.draw = draw\n"
            "from altd.cli.main import main\n"
            f"sys.exit(main(['watch', '--socket', '{unit.socket}']))\n"
        )
        with on_a_line(sys.executable, "-c", code) as line:
            line.await_shown(b"a defect")
            assert line.end() == 1
            assert_left_as_it_was(line)

    def test_so_does_one_whose_hang_up_is_ignored_and_without_a_traceback(
        self, unit: LocalDaemon, tmp_path: Path
    ) -> None:
        errors = tmp_path / "errors"
        with on_a_line("sh", "-c", f"trap '' HUP; exec {shlex.join(watch(unit.socket))} 2>{errors}") as line:
            line.await_shown(b"TEST-1")
            os.close(line.near)
            os.close(line.far)
            assert line.process.wait(PATIENCE_S) == 1
        assert errors.read_text() == ""


def assert_left_as_it_was(line: Line) -> None:
    assert termios.tcgetattr(line.near) == line.before
    assert line.shown.rindex(b"\x1b[?1049l") > line.shown.rindex(b"\x1b[?1049h")
    assert line.shown.rindex(b"\x1b[?25h") > line.shown.rindex(b"\x1b[?25l")


class TestNoTerminal:
    @pytest.mark.parametrize(
        ("kind", "said"),
        [
            ("dumb", "TERM: 'dumb' is a terminal without cursor addressing"),
            ("", "TERM: '' is a terminal without cursor addressing"),
            ("no-such", "TERM: unknown terminal type 'no-such'"),
        ],
    )
    def test_a_terminal_that_cannot_is_one_line(self, unit: LocalDaemon, kind: str, said: str) -> None:
        with on_a_line("env", f"TERM={kind}", *watch(unit.socket)) as line:
            assert line.end() == 2
            assert line.shown.decode().strip().removeprefix("\x1b[K") == (
                f"altd watch: {said}; `altd status` needs no terminal"
            )

    def test_a_pipe_is_one_line(self, unit: LocalDaemon) -> None:
        said = altd("watch", "--socket", unit.socket)
        assert (said.status, said.out) == (2, "")
        assert said.err == "altd watch: standard input: is not a terminal; `altd status` needs no terminal\n"

    @pytest.mark.parametrize("kind", ["vt100", "linux", "xterm", "screen-256color"])
    def test_the_usual_ones_can(self, unit: LocalDaemon, kind: str) -> None:
        with on_a_line("env", f"TERM={kind}", *watch(unit.socket)) as line:
            line.await_shown(b"TEST-1")
            os.write(line.far, b"q")
            assert line.end() == 0
            assert termios.tcgetattr(line.near) == line.before
