"""The GigE Vision driver with cameras that run, fail and come back."""

import struct
import time
from pathlib import Path

import numpy as np
import pytest
from support.gige import HOME, Cameras, Grabbed, driver, register, wait_for

from altd.devices.trigger_times import TriggerTimes
from altd.ports import (
    CameraBusyError,
    CameraLostError,
    CameraNotFoundError,
    CameraRefusedError,
    CameraTimeoutError,
)
from altd.records import CameraIdentity, Origin

PFNC = {"Mono10": 0x01100003, "Mono12": 0x01100005, "Mono12Packed": 0x010C0006}
"""Numbers of the pixel formats (GigE Vision 2.0, 26.1)."""

pytestmark = [pytest.mark.own_network, pytest.mark.real_time]

PRIVILEGE = 0xA00
EXPOSURE_US, GAIN, PIXEL_FORMAT = 0x120, 0x110, 0x128
OFFSET_X, OFFSET_Y = 0x130, 0x134
LINES = """
<Enumeration Name="LineSelector"><EnumEntry Name="Line0"><Value>0</Value></EnumEntry>
  <EnumEntry Name="Line1"><Value>1</Value></EnumEntry><pValue>R0</pValue></Enumeration>
<Enumeration Name="LineMode"><EnumEntry Name="Input"><Value>0</Value></EnumEntry>
  <EnumEntry Name="Output"><Value>1</Value></EnumEntry><pValue>R1</pValue></Enumeration>
<Enumeration Name="LineSource"><EnumEntry Name="Off"><Value>0</Value></EnumEntry>
  <EnumEntry Name="UserOutput0"><Value>2</Value></EnumEntry>
  <EnumEntry Name="UserOutput1"><Value>3</Value></EnumEntry><pValue>R2</pValue></Enumeration>
<Enumeration Name="UserOutputSelector"><EnumEntry Name="UserOutput0"><Value>0</Value></EnumEntry>
  <EnumEntry Name="UserOutput1"><Value>1</Value></EnumEntry><pValue>R3</pValue></Enumeration>
<Boolean Name="UserOutputValue"><pValue>R4</pValue><OnValue>1</OnValue><OffValue>0</OffValue></Boolean>
""" + "".join(
    f'<IntReg Name="R{n}"><Address>{0x4000 + 4 * n}</Address><Length>4</Length><AccessMode>RW</AccessMode>'
    "<pPort>Device</pPort><Sign>Unsigned</Sign><Endianess>BigEndian</Endianess></IntReg>"
    for n in range(5)
)
LINE_REGISTERS = range(0x4000, 0x4014, 4)
TEMPERATURE = 0x4020
THERMOMETER = (
    f'<FloatReg Name="DeviceTemperature"><Address>{TEMPERATURE}</Address><Length>4</Length>'
    "<AccessMode>RO</AccessMode><pPort>Device</pPort><Endianess>BigEndian</Endianess></FloatReg>"
)

WHITE_BALANCE = (
    '<Enumeration Name="BalanceWhiteAuto"><EnumEntry Name="Continuous"><Value>0</Value></EnumEntry>'
    '<EnumEntry Name="Off"><Value>1</Value></EnumEntry><pValue>R5</pValue></Enumeration>'
    '<IntReg Name="R5"><Address>0x4030</Address><Length>4</Length><AccessMode>RO</AccessMode>'
    "<pPort>Device</pPort><Sign>Unsigned</Sign><Endianess>BigEndian</Endianess></IntReg>"
)


class TestAutomaticModes:
    def test_are_switched_off_and_those_that_stay_on_are_named(
        self, cameras: Cameras, tmp_path: Path
    ) -> None:
        cameras.start_with(WHITE_BALANCE, tmp_path)
        camera = driver(features={"GainAuto": "Continuous"})
        camera.open()
        assert camera.automatic == ("BalanceWhiteAuto",)
        assert camera.next_frame(2.0).gain_db is not None
        camera.close()


class TestFrames:
    def test_are_the_cameras_own(self, cameras: Cameras) -> None:
        """The simulated camera draws a ramp that moves by one grey value a frame."""
        cameras.start()
        with Grabbed(driver(width=640, height=400)) as grabbed:
            grabbed.await_frames(5)
        first, second = (frame for _, frame in grabbed.frames[:2])
        x, y = np.meshgrid(np.arange(640), np.arange(400))
        number = int(first.pixels[0, 0])
        assert first.pixels.dtype == np.uint8
        assert np.array_equal(first.pixels, (x + y + number) % 255)
        assert np.array_equal(second.pixels, (x + y + number + 1) % 255)
        assert not first.pixels.flags.writeable
        assert (first.camera, first.bits, second.sequence) == ("front", 8, 1)
        assert grabbed.camera.origin is Origin.SIMULATED
        assert grabbed.camera.identity == CameraIdentity("T1", "Fake", "aravis")

    def test_of_16_bits_have_their_bytes_in_order(self, cameras: Cameras) -> None:
        cameras.start()
        with Grabbed(driver(pixel_format="Mono16")) as grabbed:
            grabbed.await_frames(2)
        frame = grabbed.frames[0][1]
        x, y = np.meshgrid(np.arange(752), np.arange(480))
        ramps = ((256 * (x + y + number)) % 65535 for number in range(65401, 65536))
        assert (frame.bits, frame.full_scale) == (16, 65535)
        assert any(np.array_equal(frame.pixels, ramp) for ramp in ramps)

    @pytest.mark.parametrize(("pixel_format", "bits"), [("Mono10", 10), ("Mono12", 12), ("Mono12Packed", 12)])
    def test_of_10_and_12_bits_come_in_words(
        self, cameras: Cameras, tmp_path: Path, pixel_format: str, bits: int
    ) -> None:
        cameras.start_with("", tmp_path)
        camera = driver(pixel_format=pixel_format)
        camera.open()
        try:
            frame = camera.next_frame(2)
            assert register(HOME, PIXEL_FORMAT) == PFNC[pixel_format]
            assert (frame.bits, frame.pixels.dtype, frame.pixels.shape) == (bits, np.uint16, (480, 752))
        finally:
            camera.close()

    def test_are_stamped_with_the_middle_of_their_exposure(self, cameras: Cameras) -> None:
        """The simulated camera sends a frame at multiples of its period on UTC, when its exposure is over."""
        cameras.start()
        with Grabbed(driver(features={"ExposureTimeAbs": 40_000.0})) as grabbed:
            grabbed.await_frames(30)
        utc_ns = time.time_ns() - time.monotonic_ns()
        into_period_ms = [(frame.t_ns + utc_ns) % 50_000_000 * 1e-6 for _, frame in grabbed.frames[5:]]
        exposure_ms = grabbed.frames[5][1].exposure_ms
        assert exposure_ms == 40.0
        assert np.median(into_period_ms) == pytest.approx(50 - exposure_ms / 2, abs=8)

    def test_are_counted_over_the_wrap_of_their_number(self, cameras: Cameras) -> None:
        """It begins with 65400, so that the wrap comes soon."""
        cameras.start()
        with Grabbed(driver(fps=200)) as grabbed:
            grabbed.await_frames(200)
        sequences = [frame.sequence for _, frame in grabbed.frames]
        times_ms = np.diff([frame.t_ns for _, frame in grabbed.frames]) * 1e-6
        assert sequences[0] == 0
        assert np.all(np.diff(sequences) >= 1)
        assert sequences[-1] <= times_ms.sum() / 5 + 2

    def test_that_lost_packets_are_gaps(self, cameras: Cameras) -> None:
        cameras.start(HOME, "T1", "-r", "1")  # 0.1 % of the packets, of which a frame has 266
        with Grabbed(driver(fps=50, resend=False)) as grabbed:
            grabbed.await_frames(60, 10)
        sequences = np.array([frame.sequence for _, frame in grabbed.frames])
        assert np.diff(sequences).max() > 1
        assert not grabbed.errors
        for _, frame in grabbed.frames:
            x = np.arange(752)
            assert np.array_equal(frame.pixels[400], (x + 400 + int(frame.pixels[0, 0])) % 255)

    def test_come_when_software_triggers_them(self, cameras: Cameras) -> None:
        """At the common instants. The simulated camera looks each 40 ms whether it was triggered, and now
        and then oversleeps by 100 ms (docs/decisions/0014-gige.md)."""
        cameras.start()
        with Grabbed(driver(trigger="software", fps=4)) as grabbed:
            grabbed.await_frames(12)
        frames = [frame for _, frame in grabbed.frames]
        assert np.diff([frame.sequence for frame in frames]).tolist() == [1] * (len(frames) - 1)
        triggers, since_ns = TriggerTimes(250_000_000, 0), frames[0].t_ns - 2_000_000_000
        instants_ns = [since_ns]
        while instants_ns[-1] < frames[-1].t_ns + 1_000_000_000:
            instants_ns.append(triggers.after(instants_ns[-1]))
        begins_ns = [frame.t_ns - round(0.5e6 * frame.exposure_ms) for frame in frames]
        after_ms = [min(ns - at for at in instants_ns if at <= ns + 2_000_000) * 1e-6 for ns in begins_ns]
        assert np.median(after_ms) < 45
        assert np.diff(begins_ns).std() * 1e-6 > 30

    def test_that_no_signal_triggers_are_waited_for(self, cameras: Cameras) -> None:
        cameras.start()
        camera = driver(trigger="line", trigger_line="Line0")
        camera.open()
        try:
            until = time.monotonic() + 2.5
            while time.monotonic() < until:
                with pytest.raises(CameraTimeoutError):
                    camera.next_frame(0.25)
        finally:
            camera.close()


class TestExposure:
    def test_is_set_and_told(self, cameras: Cameras) -> None:
        cameras.start()
        camera = driver()
        camera.open()
        try:
            able = camera.exposure_range
            assert able is not None
            assert (able.shortest_ms, able.longest_ms) == (0.01, 10_000)
            assert (able.smallest_gain_db, able.largest_gain_db) == (0, 10)
            camera.next_frame(1)
            camera.set_exposure(4.0, 3.0)
            assert (register(HOME, EXPOSURE_US), register(HOME, GAIN)) == (4000, 3)
            frames = [camera.next_frame(1) for _ in range(30)]
            assert not frames[-1].changing
            assert (frames[-1].exposure_ms, frames[-1].gain_db) == (4.0, 3.0)
            with pytest.raises(CameraRefusedError, match="exposure"):
                camera.set_exposure(1e6, 0)
            assert camera.next_frame(1).exposure_ms == 4.0
        finally:
            camera.close()

    def test_marks_frames_of_which_nobody_knows(self, cameras: Cameras) -> None:
        cameras.start()
        camera = driver()
        camera.open()
        try:
            assert not camera.next_frame(1).changing
            camera.set_exposure(4.0, 0.0)
            wait_for(lambda: camera.next_frame(1).changing, 1)  # those before were exposed before
            wait_for(lambda: not camera.next_frame(1).changing, 1)
        finally:
            camera.close()


class TestRefusals:
    @pytest.mark.parametrize(
        ("settings", "message"),
        [
            ({"pixel_format": "Mono12"}, "pixel_format Mono12: the camera offers Mono8, Mono16"),
            ({"width": 4000}, "4000 x 480 at 0, 0: the camera offers 1 to 2048 x 1 to 2048"),
            ({"features": {"AcquisitionFrameRate": 1e9}}, "AcquisitionFrameRate: "),
            (
                {"trigger": "line", "trigger_line": "Line7"},
                "trigger from Line7: the camera offers Line0, Software",
            ),
            ({"features": {"Gamma": 1.0}}, "Gamma: the camera has no such feature"),
            ({"features": {"OffsetX": "left"}}, "OffsetX: "),
        ],
        ids=["format", "size", "feature's value", "trigger", "feature", "feature's kind"],
    )
    def test_say_what_the_camera_offers(
        self, cameras: Cameras, settings: dict[str, object], message: str
    ) -> None:
        cameras.start()
        camera = driver(**settings)
        with pytest.raises(CameraRefusedError) as refusal:
            camera.open()
        camera.close()
        assert message in str(refusal.value)
        wait_for(lambda: register(HOME, PRIVILEGE) == 0)

    def test_the_offset_counts(self, cameras: Cameras) -> None:
        cameras.start()
        with Grabbed(driver(offset_x_px=16, offset_y_px=32)) as grabbed:
            grabbed.await_frames(1)
            assert (register(HOME, OFFSET_X), register(HOME, OFFSET_Y)) == (16, 32)

    def test_no_camera(self) -> None:
        camera = driver()
        with pytest.raises(CameraNotFoundError, match="no GigE Vision camera answers there"):
            camera.open()
        camera.close()

    def test_another_camera(self, cameras: Cameras) -> None:
        cameras.start(HOME, "T7")
        with pytest.raises(CameraNotFoundError, match=r"no camera T1 answers, only T7 at 127\.0\.0\.1"):
            driver(device="T1").open()

    def test_a_camera_in_use(self, cameras: Cameras) -> None:
        cameras.start()
        with Grabbed(driver()) as grabbed:
            grabbed.await_frames(3)
            with pytest.raises(CameraBusyError, match="another program controls it"):
                driver("rear").open()
            grabbed.await_frames(5)
            assert not grabbed.errors

    def test_nothing_is_open(self) -> None:
        camera = driver()
        for call in (lambda: camera.next_frame(0.1), lambda: camera.set_exposure(1, 0)):
            with pytest.raises(CameraLostError, match="not open"):
                call()
        camera.close()


class TestOutputLine:
    def test_is_switched_beside_the_frames(self, cameras: Cameras, tmp_path: Path) -> None:
        cameras.start_with(LINES, tmp_path)
        with Grabbed(driver()) as grabbed:
            grabbed.await_frames(3)
            grabbed.camera.switch_output("Line1", True)
            assert [register(HOME, number) for number in LINE_REGISTERS] == [1, 1, 3, 1, 1]
            grabbed.camera.switch_output("Line1", False)
            assert register(HOME, LINE_REGISTERS[-1]) == 0
            grabbed.await_frames(3)
            assert not grabbed.errors

    def test_is_set_again_in_a_camera_that_started_anew(self, cameras: Cameras, tmp_path: Path) -> None:
        cameras.start_with(LINES, tmp_path)
        with Grabbed(driver()) as grabbed:
            grabbed.await_frames(3)
            grabbed.camera.switch_output("Line0", True)
            cameras.kill()
            cameras.start(HOME, "T1", "-g", str(tmp_path / "camera.xml"))
            assert register(HOME, LINE_REGISTERS[-1]) == 0
            grabbed.back_after_s(time.monotonic_ns())
            assert register(HOME, LINE_REGISTERS[-1]) == 1

    def test_that_is_not_there_is_refused(self, cameras: Cameras, tmp_path: Path) -> None:
        cameras.start_with(LINES, tmp_path)
        with Grabbed(driver()) as grabbed:
            grabbed.await_frames(1)
            with pytest.raises(
                CameraRefusedError, match="LineSelector Line5: the camera offers Line0, Line1"
            ):
                grabbed.camera.switch_output("Line5", True)
            grabbed.await_frames(3)

    def test_of_a_camera_that_was_closed_meanwhile_is_an_error(self, cameras: Cameras) -> None:
        cameras.start()
        camera = driver()
        camera.open()
        opened = camera._opened  # noqa: SLF001  as a second thread still has it
        camera.close()
        assert opened is not None
        with pytest.raises(CameraLostError, match="closed"):
            opened.switch_output("Line1", True)

    def test_of_a_camera_without_any_is_refused(self, cameras: Cameras) -> None:
        cameras.start()
        with Grabbed(driver()) as grabbed:
            grabbed.await_frames(1)
            with pytest.raises(CameraRefusedError, match="no UserOutputValue"):
                grabbed.camera.switch_output("Line1", True)


class TestTemperature:
    @staticmethod
    def warm(celsius: float) -> None:
        register(HOME, TEMPERATURE, int.from_bytes(struct.pack(">f", celsius)))

    def test_is_told_beside_the_frames(self, cameras: Cameras, tmp_path: Path) -> None:
        cameras.start_with(THERMOMETER, tmp_path)
        for celsius in (-12.5, 61.25):
            self.warm(celsius)
            with Grabbed(driver()) as grabbed:
                grabbed.await_frames(3)
                assert grabbed.camera.celsius() == celsius

    def test_asked_without_end_costs_no_frame(self, cameras: Cameras, tmp_path: Path) -> None:
        cameras.start_with(THERMOMETER, tmp_path)
        with Grabbed(driver(fps=50)) as grabbed:
            grabbed.await_frames(3)
            began, asked = len(grabbed.frames), 0
            until = time.monotonic() + 2
            while time.monotonic() < until:
                assert grabbed.camera.celsius() is not None
                asked += 1
            sequences = [frame.sequence for _, frame in grabbed.frames[began:]]
            assert not grabbed.errors
        assert asked > 100
        assert len(sequences) > 80
        assert len(sequences) > 0.95 * (sequences[-1] - sequences[0] + 1)  # a busy machine may be late

    def test_that_the_camera_does_not_measure_is_none_and_no_error(self, cameras: Cameras) -> None:
        cameras.start()
        with Grabbed(driver()) as grabbed:
            grabbed.await_frames(1)
            assert grabbed.camera.celsius() is None
            grabbed.await_frames(2)
            assert not grabbed.errors

    def test_of_a_camera_that_went_away_is_not_waited_for(self, cameras: Cameras, tmp_path: Path) -> None:
        cameras.start_with(THERMOMETER, tmp_path)
        with Grabbed(driver()) as grabbed:
            grabbed.await_frames(3)
            cameras.stop()
            time.sleep(0.5)
            asked_s = time.monotonic()
            with pytest.raises(CameraLostError):
                grabbed.camera.celsius()
            assert time.monotonic() - asked_s < 0.1
            cameras.go_on()
        with pytest.raises(CameraLostError, match="not open"):
            grabbed.camera.celsius()
