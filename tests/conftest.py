"""Fixtures for every test, and remains that no test may leave."""

import asyncio
import functools
import inspect
import os
import pickle
import signal
import threading
import time
from collections.abc import Awaitable, Callable, Iterator
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # both as altd itself, before numpy and OpenCV are there
os.environ.setdefault("OPENCV_IO_MAX_IMAGE_PIXELS", str(1 << 28))

import cv2
import hypothesis
import pytest
from support import own_network
from support.foreign import need
from support.longest_first import LongestFirst
from support.made_once import loaded_once, made_once
from support.places import SHARED_DATA
from support.played_unit import PlayedUnit
from support.recordings import quiet
from support.simulated_unit import scan_and_calibrate
from support.wire import Wire

from altd.calibration.calibrating import calibrate
from altd.calibration.file import load_calibration, save_calibration
from altd.calibration.result import CalibrationResult
from altd.measuring.calibration import Calibration
from altd.recording.reader import open_recording
from altd.runtime.threads import DeviceThread
from hw_sim.flat import record_flat
from hw_sim.unit import Unit, UnitConfig

# The same inputs in every run, and no limit of time for one: `make fuzz` is where new inputs are tried.
hypothesis.settings.register_profile("suite", derandomize=True, database=None, deadline=None)
hypothesis.settings.register_profile("explore", max_examples=1000, deadline=None, print_blob=True)
hypothesis.settings.load_profile("suite")

_PATIENCE = 10.0
"""On a busy machine a thread may wait for seconds until it runs; tests of a limit set a short one."""
_END_TIMEOUT_S = 20.0


def _patient(call: Callable[..., Awaitable[object]]) -> Callable[..., Awaitable[object]]:
    @functools.wraps(call)
    async def patient(*arguments: object, within_s: float, **more: object) -> object:
        has_fake_time = "time" in vars(asyncio.get_running_loop())  # FakeClock.of_loop
        return await call(*arguments, within_s=within_s if has_fake_time else _PATIENCE * within_s, **more)

    return patient


pytest.MonkeyPatch().setattr(DeviceThread, "call", _patient(DeviceThread.call))

cv2.setNumThreads(1)  # as altd itself: the other cores run other tests

# A shell ignores SIGINT for its background jobs, nohup(1) SIGHUP; programs that tests start inherit it.
for number, handler in ((signal.SIGINT, signal.default_int_handler), (signal.SIGHUP, signal.SIG_DFL)):
    if signal.getsignal(number) is signal.SIG_IGN:
        signal.signal(number, handler)


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """The recordings and photographs that this project did not make."""
    need(SHARED_DATA.is_dir(), "../shared/data is not there")
    return SHARED_DATA


@pytest.fixture
def wire() -> Iterator[Wire]:
    """A serial line; the unit opens its ``device``."""
    wire = Wire.laid()
    yield wire
    wire.hang_up()


@pytest.fixture(scope="session")
def simulated_unit() -> Callable[[int], Path]:
    """``scan`` and ``cal.json`` of the simulated unit with a seed, as a technician makes them."""
    return lambda seed: made_once(f"unit-{seed}", functools.partial(scan_and_calibrate, seed))


@pytest.fixture(scope="session")
def unit_a(shared_data: Path) -> Path:
    """``cal.json`` and ``result.pickle``, the calibration of the unit that this project did not make."""
    scan = shared_data / "unit-a" / "scan"

    def make(folder: Path) -> None:
        result = calibrate([open_recording(scan)])
        save_calibration(result.calibration, folder / "cal.json")
        (folder / "result.pickle").write_bytes(pickle.dumps(result))

    return made_once("unit-a", make, scan)


@pytest.fixture(scope="session")
def unit_3(simulated_unit: Callable[[int], Path]) -> Path:
    """The simulated unit with seed 3."""
    return simulated_unit(3)


@pytest.fixture(scope="session")
def calibration_of_unit_3(unit_3: Path) -> Calibration:
    """The calibration of the simulated unit with seed 3."""
    return load_calibration(unit_3 / "cal.json")


@pytest.fixture(scope="session")
def flat_of_unit_3() -> Path:
    """A recording of eight dark and eight even pictures of the simulated unit with seed 3."""

    def make(folder: Path) -> None:
        record_flat(folder / "flat", Unit(UnitConfig(seed=3)), 8, quiet)

    return made_once("flat-3", make) / "flat"


@pytest.fixture(scope="session")
def unit_3_with_flat(unit_3: Path, flat_of_unit_3: Path) -> CalibrationResult:
    """The calibration of the simulated unit with seed 3 by its scan and its flat."""
    paths = unit_3 / "scan", flat_of_unit_3

    def make() -> CalibrationResult:
        scan, flat = map(open_recording, paths)
        return calibrate([scan], flat)

    return loaded_once("unit-3-with-flat", make)


@pytest.fixture(scope="session")
def played_unit() -> PlayedUnit:
    """A calibrated unit that plays a recording."""
    return PlayedUnit(made_once("played-unit", PlayedUnit.made))


@pytest.fixture(autouse=True)
def no_thread_is_left() -> Iterator[None]:
    """A test that leaks a thread fails."""
    before = set(threading.enumerate())
    yield
    deadline = time.monotonic() + _END_TIMEOUT_S
    while leaked := [t for t in threading.enumerate() if t not in before and t.is_alive()]:
        if all(t.name.startswith(("asyncio_", "aravis-release")) for t in leaked):
            return  # the loop's own executor, joined when the loop closes; a dead camera's release
        if time.monotonic() > deadline:
            pytest.fail(f"threads left behind: {[t.name for t in leaked]}")
        time.sleep(0.01)


def pytest_configure(config: pytest.Config) -> None:
    if not own_network.inside():
        config.pluginmanager.register(LongestFirst.of(config))


@pytest.hookimpl(tryfirst=True)
def pytest_pyfunc_call(pyfuncitem: pytest.Function) -> bool | None:
    if own_network.inside() or pyfuncitem.get_closest_marker(own_network.MARKER) is None:
        return None
    own_network.run_inside(pyfuncitem)
    return True


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    if own_network.inside():
        own_network.note(report)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """A test that leaks a task fails; the first of those in an own network waits for all of its file."""
    for item in items:
        if isinstance(item, pytest.Function) and inspect.iscoroutinefunction(item.obj):
            item.obj = _leaving_no_task(item.obj)
        if item.get_closest_marker(own_network.MARKER) is not None and not own_network.inside():
            item.add_marker(pytest.mark.timeout(own_network.FILE_TIMEOUT_S + 20))


def _leaving_no_task(test: Callable[..., Awaitable[None]]) -> Callable[..., Awaitable[None]]:
    @functools.wraps(test)
    async def checked(*arguments: object, **named: object) -> None:
        before = asyncio.all_tasks()
        await test(*arguments, **named)
        # by the computer's clock: a test may drive that of the loop
        deadline_s = time.monotonic() + _END_TIMEOUT_S
        while leaked := [task for task in asyncio.all_tasks() - before if not task.done()]:
            if time.monotonic() > deadline_s:
                pytest.fail(f"tasks left behind: {[task.get_name() for task in leaked]}")
            await asyncio.sleep(0)

    return checked
