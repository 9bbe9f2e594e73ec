import shutil
import threading
from pathlib import Path

import pytest
from support.clock import FakeClock
from support.recordings import write_beams

from altd.devices.playback.player import Playback, PlaybackCamera
from altd.errors import BadInputError
from altd.ports import CameraEndedError, CameraError, CameraTimeoutError, Stop
from altd.recording.reader import open_recording


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_beams(tmp_path_factory.mktemp("playback") / "rec", [(0, 0, 0, 0), (5, 5, 0, 0)], exposures=4)


class Clock(FakeClock):
    """Time passes at once for a thread that waits."""

    def wait(self, stop: Stop, seconds: float) -> None:
        self.now_ns += round(seconds * 1e9)


def cameras(
    recording: Path, realtime: bool = False, repeat: bool = False, clock: FakeClock | None = None
) -> list[PlaybackCamera]:
    playback = Playback(open_recording(recording), clock or FakeClock(), realtime, repeat)
    return [PlaybackCamera(name, playback) for name in ("front", "rear")]


def test_both_cameras_deliver_every_frame_with_one_time_and_number(recording: Path) -> None:
    front, rear = cameras(recording)
    for number in range(8):
        one, other = front.next_frame(1.0), rear.next_frame(1.0)
        assert one.sequence == other.sequence == number
        assert one.t_ns == other.t_ns
    for camera in (front, rear):
        with pytest.raises(CameraEndedError, match="at its end"):
            camera.next_frame(1.0)


def test_at_the_fast_pace_no_camera_runs_ahead_of_a_slow_one(recording: Path) -> None:
    front, rear = cameras(recording, repeat=True)
    taken: list[tuple[str, int]] = []

    def take(camera: PlaybackCamera, pause_s: float) -> None:
        pause = threading.Event()
        while len(taken) < 60:
            try:
                frame = camera.next_frame(0.05)
            except CameraTimeoutError:
                continue
            taken.append((frame.camera, frame.sequence))
            pause.wait(pause_s)

    threads = [threading.Thread(target=take, args=arguments) for arguments in ((front, 0.0), (rear, 0.005))]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    latest = {"front": -1, "rear": -1}
    for name, sequence in taken:
        assert sequence == latest[name] + 1
        latest[name] = sequence
        assert abs(latest["front"] - latest["rear"]) <= 2  # one exposure, and one on its way into the list


def test_a_camera_whose_partner_is_not_taken_times_out(recording: Path) -> None:
    front, _ = cameras(recording)
    front.next_frame(1.0)
    with pytest.raises(CameraTimeoutError, match="another camera's frames are not taken"):
        front.next_frame(0.05)


def test_in_real_time_frames_come_at_their_times(recording: Path) -> None:
    front, _ = cameras(recording, realtime=True, clock=(clock := Clock(10**9)))
    for number in range(4):
        assert front.next_frame(1.0).t_ns == clock.now_ns == 10**9 + number * 50_000_000
    with pytest.raises(CameraTimeoutError, match="not due yet"):
        front.next_frame(0.02)
    assert front.next_frame(1.0).t_ns == clock.now_ns == 10**9 + 4 * 50_000_000


def test_repeating_goes_on_counting(recording: Path) -> None:
    front, rear = cameras(recording, repeat=True)
    frames = []
    for _ in range(17):
        frames.append(front.next_frame(1.0))
        rear.next_frame(1.0)
    assert [frame.sequence for frame in frames] == list(range(17))
    assert frames[16].t_ns - frames[0].t_ns == 16 * 50_000_000


def test_a_camera_that_the_recording_does_not_have_is_refused(recording: Path) -> None:
    with pytest.raises(BadInputError, match="has no frames of camera 'side'"):
        PlaybackCamera("side", Playback(open_recording(recording), FakeClock(), True, False))


def test_in_real_time_what_is_overdue_is_left_out(recording: Path) -> None:
    front, _ = cameras(recording, realtime=True, repeat=True, clock=(clock := Clock(10**9)))
    assert front.next_frame(1.0).sequence == 0
    clock.now_ns += 1_210_000_000  # as when the process was held
    frame = front.next_frame(1.0)
    assert (frame.sequence, frame.t_ns) == (15, 10**9 + 15 * 50_000_000)  # half a second is not overdue


def test_each_turn_through_a_recording_is_a_playthrough_of_its_own(recording: Path) -> None:
    front, rear = cameras(recording, repeat=True)
    turns = []
    for _ in range(17):
        turns.append(front.next_frame(1.0).playthrough)
        rear.next_frame(1.0)
    assert turns == [0] * 8 + [1] * 8 + [2]


def test_a_table_that_is_changed_meanwhile_is_played_no_further(recording: Path, tmp_path: Path) -> None:
    """The frames that it names now were not checked. It is a camera that fails, and stays failed."""
    copy = tmp_path / "rec"
    shutil.copytree(recording, copy)
    front, rear = cameras(copy, repeat=True)
    assert front.next_frame(1.0).sequence == rear.next_frame(1.0).sequence == 0
    table = copy / "frames.csv"
    table.write_text(table.read_text().replace("front0003", "front0002"))
    for number in range(1, 8):  # frames read before the change
        assert front.next_frame(1.0).sequence == rear.next_frame(1.0).sequence == number
    for camera in (front, rear, front):
        with pytest.raises(CameraError, match="was changed after it was checked"):
            camera.next_frame(1.0)
