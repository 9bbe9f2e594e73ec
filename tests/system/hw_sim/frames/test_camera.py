import threading
import time
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from altd.ports import Camera, CameraError, CameraTimeoutError
from altd.records import Frame, Origin
from hw_sim.camera import SimulatedCamera, make_cameras
from hw_sim.faults import Fault
from hw_sim.unit import EXPOSURES_MS, FRONT, REAR, Unit

PERIOD_NS = 20_000_000
"""Of the unit in these tests, 50 exposures a second."""


def opened(unit: Unit, *, real_time: bool) -> tuple[SimulatedCamera, ...]:
    cameras = make_cameras(unit, real_time=real_time)
    for camera in cameras:
        camera.open()
    return cameras


def test_the_cameras_stand_behind_the_port(unit: Unit) -> None:
    front, rear = make_cameras(unit)
    as_port: list[Camera] = [front, rear]
    assert [camera.name for camera in as_port] == [FRONT, REAR]
    assert {camera.origin for camera in as_port} == {Origin.SIMULATED}
    assert not front.waits


def test_without_a_clock_every_exposure_waits_to_be_taken(unit: Unit) -> None:
    front, rear = opened(unit, real_time=False)
    assert front.waits
    taken = [front.next_frame(1.0) for _ in range(4)]
    others = [rear.next_frame(1.0) for _ in range(4)]
    assert [(f.sequence, f.t_ns) for f in taken] == [(k, k * PERIOD_NS) for k in range(4)]
    assert [(f.sequence, f.t_ns) for f in others] == [(f.sequence, f.t_ns) for f in taken]


def test_a_frame_tells_what_it_was_exposed_with(unit: Unit) -> None:
    front, rear = opened(unit, real_time=False)
    front.set_exposure(0.8, 6.0)
    frames = front.next_frame(1.0), rear.next_frame(1.0)
    told = [(taken.exposure_ms, pytest.approx(taken.gain_db)) for taken in frames]
    assert told == [(0.8, 6.0), (EXPOSURES_MS[REAR], 0.0)]
    counts = [float(taken.pixels.max()) for taken in frames]
    assert min(counts) > 0


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


@pytest.mark.parametrize("real_time", [True, False])
def test_a_silent_camera_times_out_and_the_other_goes_on(unit: Unit, real_time: bool) -> None:
    front, rear = opened(unit, real_time=real_time)
    unit.inject(Fault.FRONT_SILENT)
    started = time.monotonic()
    with pytest.raises(CameraTimeoutError, match="front"):
        front.next_frame(0.1)
    assert time.monotonic() - started >= 0.09
    assert rear.next_frame(1.0).camera == REAR
    unit.clear()
    assert front.next_frame(1.0).camera == FRONT


def test_cameras_out_of_step_differ_by_half_a_period(unit: Unit) -> None:
    unit.inject(Fault.OUT_OF_STEP)
    front, rear = opened(unit, real_time=False)
    assert rear.next_frame(1.0).t_ns - front.next_frame(1.0).t_ns == PERIOD_NS // 2


def test_dropped_frames_leave_gaps_that_differ_between_the_cameras(unit: Unit) -> None:
    unit.inject(Fault.DROPPED_FRAMES)
    front, rear = (
        [camera.next_frame(1.0).sequence for _ in range(60)] for camera in opened(unit, real_time=False)
    )
    assert 65 < front[-1] < 95
    assert front != rear
    assert np.all(np.diff(front) > 0)


def test_a_camera_that_is_not_open_says_so(unit: Unit) -> None:
    front, _ = make_cameras(unit)
    with pytest.raises(CameraError, match="front: the camera is not open"):
        front.next_frame(0.1)
    front.close()


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
