"""End of work, and its result, in this process; whole commands: ``tests/system/process``."""

import asyncio
import os
import signal
import sys
from collections.abc import Callable, Iterator

import pytest

from altd.errors import BadInputError
from altd.process.endings import EndedBySignal, hangups, run_to_end, until_signal

SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


@pytest.fixture(autouse=True)
def heeded() -> Iterator[None]:
    """No signal is ignored, as they may be where the tests run in the background or under nohup."""
    before = {number: signal.signal(number, signal.SIG_DFL) for number in SIGNALS}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


def ended(work: Callable[[], int]) -> int:
    return run_to_end(work, lambda: "altd test")


def test_the_status_is_that_of_the_work(capsys: pytest.CaptureFixture[str]) -> None:
    assert [ended(lambda: 0), ended(lambda: 1)] == [0, 1]
    assert capsys.readouterr() == ("", "")


def test_bad_input_is_a_line_and_status_2(capsys: pytest.CaptureFixture[str]) -> None:
    def refuse() -> int:
        raise BadInputError("a.toml", "line 3: no")

    assert ended(refuse) == 2
    assert capsys.readouterr() == ("", "altd test: a.toml: line 3: no\n")


def test_a_missing_package_is_a_line_that_names_the_interpreter(capsys: pytest.CaptureFixture[str]) -> None:
    def work() -> int:
        raise ModuleNotFoundError(name="cv2")

    assert run_to_end(work, lambda: "altd doctor") == 1
    line = f"altd doctor: the Python package 'cv2' is missing in {sys.executable}: start the `altd` that was "
    assert capsys.readouterr().err.startswith(line)


@pytest.mark.parametrize("number", SIGNALS)
def test_a_signal_lets_the_work_clean_up_and_is_the_status(
    number: signal.Signals, capsys: pytest.CaptureFixture[str]
) -> None:
    said: list[str] = []

    def work() -> int:
        try:
            os.kill(os.getpid(), number)
            said.append("went on")
        except Exception:  # nothing takes a signal for an error
            said.append("took it")
        finally:
            said.append("cleaned up")
        return 0

    before = [signal.getsignal(each) for each in SIGNALS]
    assert ended(work) == 128 + number
    assert said == ["cleaned up"]
    assert [signal.getsignal(each) for each in SIGNALS] == before
    assert capsys.readouterr() == ("", "")


def test_a_signal_that_is_ignored_ends_nothing() -> None:
    """As nohup(1) starts a command."""
    signal.signal(signal.SIGHUP, signal.SIG_IGN)

    def work() -> int:
        os.kill(os.getpid(), signal.SIGHUP)
        return 0

    assert ended(work) == 0


def test_an_answer_that_standard_output_did_not_take_is_a_line_and_status_1(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    with open("/dev/full", "w") as full:  # noqa: PTH123  a device
        monkeypatch.setattr("sys.stdout", full)

        def work() -> int:
            print("an answer")
            return 0

        assert ended(work) == 1
        monkeypatch.undo()
    assert capsys.readouterr().err == "altd test: standard output: No space left on device\n"


@pytest.mark.parametrize("number", SIGNALS)
async def test_work_on_a_loop_ends_cleaned_up_by_a_signal(number: signal.Signals) -> None:
    said: list[str] = []

    async def work() -> None:
        try:
            os.kill(os.getpid(), number)
            await asyncio.sleep(20)
        finally:
            said.append("cleaned up")

    with pytest.raises(EndedBySignal) as end:
        await until_signal(work())
    assert end.value.status == 128 + number
    assert said == ["cleaned up"]


async def test_a_cancellation_is_no_signal() -> None:
    task = asyncio.ensure_future(until_signal(asyncio.sleep(20)))
    await asyncio.sleep(0)
    task.cancel()
    with pytest.raises(asyncio.CancelledError):
        await task


async def test_a_hang_up_without_a_terminal_is_a_request_at_any_time(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("altd.process.endings._has_terminal", lambda: False)
    hangup = hangups()
    assert hangup is not None
    os.kill(os.getpid(), signal.SIGHUP)
    assert hangup.is_set()
    hangup.clear()

    async def work() -> str:
        os.kill(os.getpid(), signal.SIGHUP)
        await hangup.wait()
        return "done"

    assert await until_signal(work(), hangup) == "done"
    monkeypatch.setattr("altd.process.endings._has_terminal", lambda: True)
    assert hangups() is None
