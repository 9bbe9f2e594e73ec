import threading
import time
from concurrent.futures import ThreadPoolExecutor

import pytest

from altd.ports import CameraError
from altd.records import Frame
from hw_sim.camera import SimulatedCamera, make_cameras
from hw_sim.faults import Fault
from hw_sim.unit import Unit

PERIOD_NS = 20_000_000
"""Of the unit in these tests, 50 exposures a second."""


def opened(unit: Unit, *, real_time: bool) -> tuple[SimulatedCamera, ...]:
    cameras = make_cameras(unit, real_time=real_time)
    for camera in cameras:
        camera.open()
    return cameras


@pytest.mark.real_time
def test_two_readers_in_threads_share_sequence_and_time(unit: Unit) -> None:
    cameras = opened(unit, real_time=True)

    def read(camera: SimulatedCamera) -> list[Frame]:
        return [camera.next_frame(1.0) for _ in range(10)]

    with ThreadPoolExecutor(2) as threads:
        front, rear = threads.map(read, cameras)
    front_times, rear_times = ({f.sequence: f.t_ns for f in frames} for frames in (front, rear))
    shared = set(front_times) & set(rear_times)
    assert len(shared) >= 7
    assert all(front_times[k] == rear_times[k] for k in shared)


@pytest.mark.real_time
def test_in_real_time_a_frame_comes_after_its_exposure_and_before_the_next(unit: Unit) -> None:
    front, _ = opened(unit, real_time=True)
    ages_ns = []
    for _ in range(8):
        frame = front.next_frame(1.0)
        ages_ns.append(time.monotonic_ns() - frame.t_ns)
    assert min(ages_ns) >= 0
    assert sorted(ages_ns)[len(ages_ns) // 2] < PERIOD_NS


@pytest.mark.real_time
def test_a_late_reader_gets_the_newest_and_the_sequence_jumps(unit: Unit) -> None:
    front, _ = opened(unit, real_time=True)
    before = front.next_frame(1.0)
    time.sleep(5.5 * PERIOD_NS * 1e-9)
    late = front.next_frame(1.0)
    assert late.sequence >= before.sequence + 5
    assert late.t_ns == before.t_ns + (late.sequence - before.sequence) * PERIOD_NS
    assert time.monotonic_ns() - late.t_ns < 2 * PERIOD_NS


@pytest.mark.real_time
def test_closing_ends_a_call_that_waits(unit: Unit) -> None:
    front, _ = opened(unit, real_time=True)
    unit.inject(Fault.FRONT_SILENT)
    closer = threading.Timer(0.05, front.close)
    closer.start()
    started = time.monotonic()
    with pytest.raises(CameraError):
        front.next_frame(10.0)
    assert time.monotonic() - started < 2.0
    closer.join()
