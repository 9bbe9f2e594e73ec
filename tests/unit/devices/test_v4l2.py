"""Structures of V4L2 against the kernel's own headers, as a C compiler reads them; its exposures and images.

With the kernel's test drivers: ``tests/system/devices/v4l2``.
"""

import ctypes
import errno
import re
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from support.foreign import need, need_program

from altd.devices.pixels import PIXEL_FORMATS
from altd.devices.v4l2 import PIXEL_FORMAT_NAMES, V4l2CameraSettings, abi, find_cameras
from altd.devices.v4l2.camera import ExposureTime, V4l2Camera
from altd.devices.v4l2.controls import Control, automatic_modes, switch_off
from altd.devices.v4l2.image import Layout, Stamp, code, middle_of_exposure_ns
from altd.ports import CameraLostError, CameraNotFoundError, CameraRefusedError, ExposureRange
from altd.process.machine import Machine

NEWER_FORMATS = {"Y12P"}
"""Not yet in the headers of Debian 12."""
HEADER = Path("/usr/include/linux/videodev2.h")
CONSTANTS = {name: value for name, value in vars(abi).items() if name.startswith(("V4L2_", "VIDIOC_"))}
STRUCTURES = {
    name: kind
    for name, kind in vars(abi).items()
    if isinstance(kind, type) and issubclass(kind, ctypes.Structure)
}


def fields(kind: Any, path: str = "", begin: int = 0) -> Iterator[tuple[str, int, Any]]:
    """Path, begin and type of each field that has the kernel's name."""
    for name, field_kind in kind._fields_:
        offset = begin + getattr(kind, name).offset
        compound = issubclass(field_kind, ctypes.Structure | ctypes.Union)
        if name in getattr(kind, "_anonymous_", ()):
            yield from fields(field_kind, path, offset)
        elif not name.startswith("_"):
            yield f"{path}{name}", offset, field_kind
            if compound:
                yield from fields(field_kind, f"{path}{name}.", offset)


def ours() -> dict[str, int]:
    """Each fact of ``abi``, by the C expression of it."""
    facts = dict(CONSTANTS)
    for name, kind in STRUCTURES.items():
        facts[f"sizeof(struct {name})"] = ctypes.sizeof(kind)
        for path, offset, field_kind in fields(kind):
            field = f"((struct {name} *)0)->{path}"
            facts[f"offsetof(struct {name}, {path})"] = offset
            facts[f"sizeof({field})"] = ctypes.sizeof(field_kind)
            is_number = not issubclass(field_kind, ctypes.Structure | ctypes.Union | ctypes.Array)
            if is_number and hasattr(field_kind, "value"):  # no pointer
                facts[f"(__typeof__({field}))-1 < 0"] = int(field_kind(-1).value < 0)
    for name in sorted({*PIXEL_FORMAT_NAMES} - NEWER_FORMATS):
        facts[f"V4L2_PIX_FMT_{'MJPEG' if name == 'MJPG' else name}"] = code(name)
    return facts


@pytest.fixture(scope="module")
def kernels(tmp_path_factory: pytest.TempPathFactory) -> dict[str, int]:
    """The same facts by the headers."""
    gcc = need_program("gcc")
    need(HEADER.exists(), f"{HEADER} is not there (Debian package linux-libc-dev)")
    program = tmp_path_factory.mktemp("abi") / "facts"
    lines = [f'printf("%llu\\n", (unsigned long long)({expression}));' for expression in ours()]
    headers = [f"#include <{name}.h>" for name in ("linux/videodev2", "stddef", "stdio")]
    source = "\n".join([*headers, "int main(void) {", *lines, "return 0; }", ""])
    compile_it = [gcc, "-x", "c", "-", "-o", program]
    compiled = subprocess.run(compile_it, input=source, capture_output=True, text=True, check=False)
    assert compiled.returncode == 0, compiled.stderr
    said = subprocess.run([program], capture_output=True, text=True, check=True).stdout.split()
    return dict(zip(ours(), map(int, said), strict=True))


def test_every_number_is_the_kernel_s(kernels: dict[str, int]) -> None:
    assert ours() == kernels


def test_what_is_compared_is_all_that_there_is() -> None:
    """Else a name spelled in another way would be compared with nothing."""
    compared = {*CONSTANTS, *STRUCTURES, "v4l2_fourcc"}
    own = {name for name, value in vars(abi).items() if getattr(value, "__module__", "") == abi.__name__}
    numbers = {name for name, value in vars(abi).items() if isinstance(value, int)}
    assert {name for name in own | numbers if not name.startswith("_")} <= compared
    assert {"V4L2_BUF_FLAG_ERROR", "VIDIOC_DQBUF"} <= CONSTANTS.keys()
    facts = ours()
    assert facts["offsetof(struct v4l2_buffer, timestamp.tv_usec)"]
    assert facts["offsetof(struct v4l2_frmivalenum, stepwise.max.denominator)"]


def test_a_text_of_the_kernel_s_ends_at_its_first_nul() -> None:
    raw = b"vivid\0rubbish".ljust(16, b"x") + b"y" * 32 + bytes(32 + 6 * 4)
    about = abi.v4l2_capability.from_buffer_copy(raw)
    assert (about.driver, about.card) == (b"vivid", b"y" * 32)


def camera(device: Path) -> V4l2Camera:
    return V4l2Camera("front", V4l2CameraSettings(driver="v4l2", device=device))


def test_a_camera_that_is_not_there_is_not_found(tmp_path: Path) -> None:
    with pytest.raises(CameraNotFoundError, match="none: there is no such camera now"):
        camera(tmp_path / "none").open()


@pytest.mark.parametrize("device", ["/dev/null", "/dev", "a file"])
def test_what_is_no_camera_is_refused(device: str, tmp_path: Path) -> None:
    path = tmp_path / device  # "/dev/null" and "/dev" stay themselves
    if device == "a file":
        path.touch()
    with pytest.raises(CameraRefusedError, match=f"^{path}: is not a Video4Linux device"):
        camera(path).open()


def test_a_camera_that_is_not_open_gives_no_frame_and_is_closed_without_harm() -> None:
    closed = camera(Path("/dev/null"))
    closed.close()
    with pytest.raises(CameraLostError, match="not open"):
        closed.next_frame(0.1)
    assert closed.exposure_range is None


V4L2_CID_EXPOSURE, V4L2_CID_GAIN = 0x0098_0911, 0x0098_0913  # of <linux/v4l2-controls.h>; altd uses neither


def control(number: int, smallest: int, largest: int, step: int = 1, writes: bool = True) -> Control:
    """A control as the kernel describes it; what a UVC camera's says is in the kernel's uvc_ctrl.c."""
    return Control(number, "a control", "integer", smallest, largest, step, smallest, True, writes)


UVC_TIME = control(abi.V4L2_CID_EXPOSURE_ABSOLUTE, 3, 2047)
UVC_AUTO = control(abi.V4L2_CID_EXPOSURE_AUTO, 0, 3)


def test_a_uvc_camera_exposes_in_units_of_100_us() -> None:
    exposure = ExposureTime.of([UVC_AUTO, UVC_TIME])
    assert exposure.range == ExposureRange(pytest.approx(0.3), pytest.approx(204.7), 0.0, 0.0)
    assert exposure.units(2.04) == 20


def test_a_camera_that_counts_lines_or_has_but_a_gain_has_no_exposure_that_altd_could_set() -> None:
    lines, gain = control(V4L2_CID_EXPOSURE, 4, 1100), control(V4L2_CID_GAIN, 0, 255)
    assert ExposureTime.of([lines, gain]) is None


def test_an_exposure_that_can_only_be_read_is_none_to_set() -> None:
    assert ExposureTime.of([control(abi.V4L2_CID_EXPOSURE_ABSOLUTE, 3, 2047, writes=False)]) is None


def test_an_exposure_of_nothing_is_not_offered() -> None:
    exposure = ExposureTime.of([control(abi.V4L2_CID_EXPOSURE_ABSOLUTE, 0, 100)])
    assert exposure.range.shortest_ms == pytest.approx(0.1)
    assert exposure.units(0.0) == 1


@pytest.mark.parametrize(
    ("exposure_ms", "units"), [(0.01, 5), (0.9, 10), (1.1, 10), (1.3, 15), (99.0, 95), (9.4, 95)]
)
def test_an_exposure_is_the_nearest_that_steps_and_range_allow(exposure_ms: float, units: int) -> None:
    exposure = ExposureTime.of([control(abi.V4L2_CID_EXPOSURE_ABSOLUTE, 5, 98, step=5)])
    assert exposure.units(exposure_ms) == units


class WebcamNode:
    """The calls of a kernel driver for controls: name, value, and whether the value can be changed."""

    def __init__(self, controls: dict[int, tuple[bytes, int, bool]]) -> None:
        self.controls = controls

    def call(self, request: int, argument: Any) -> Any:
        if request == abi.VIDIOC_QUERY_EXT_CTRL:
            after = argument.id & ~abi.V4L2_CTRL_FLAG_NEXT_CTRL
            number = min((number for number in self.controls if number > after), default=None)
            if number is None:
                raise OSError(errno.EINVAL, "no further control")
            argument.id, argument.type = number, abi.V4L2_CTRL_TYPE_INTEGER
            argument.name, argument.maximum = self.controls[number][0], 3
            return argument
        name, value, changes = self.controls[argument.id]
        if request == abi.VIDIOC_S_CTRL:
            if not changes:
                raise OSError(errno.EBUSY, "grabbed")
            self.controls[argument.id] = name, argument.value, changes
        else:
            argument.value = value
        return argument

    def close(self) -> None: ...


def webcam() -> WebcamNode:
    """With the kernel's numbers and names (v4l2-controls.h, v4l2-ctrls-defs.c); 3: aperture priority."""
    return WebcamNode(
        {
            0x0098_0900: (b"Brightness", 3, True),
            0x0098_090C: (b"White Balance, Automatic", 1, True),
            0x0098_0912: (b"Gain, Automatic", 1, False),
            0x009A_0901: (b"Auto Exposure", 3, True),
            0x009A_0903: (b"Exposure, Dynamic Framerate", 1, True),
            0x009A_090C: (b"Focus, Automatic Continuous", 1, True),
        }
    )


@pytest.mark.parametrize(
    ("settings", "off", "on"),
    [
        (
            {},
            {0x0098_090C: 0, 0x009A_0901: 1, 0x009A_0903: 0, 0x009A_090C: 0},
            ["gain_automatic"],
        ),
        (
            {"controls": {"gain_automatic": 1, "white_balance_automatic": 1}},
            {0x009A_0901: 1, 0x009A_0903: 0, 0x009A_090C: 0},
            [],
        ),
        ({"exposure": {"control": "camera"}}, {0x0098_090C: 0, 0x009A_090C: 0}, []),
    ],
    ids=["all", "some are accepted", "the camera controls its exposure"],
)
def test_automatic_modes_are_switched_off_unless_the_config_accepts_them(
    settings: dict[str, Any], off: dict[int, int], on: list[str]
) -> None:
    node: Any = webcam()
    table = V4l2CameraSettings.model_validate({"driver": "v4l2", "device": "/dev/video0", **settings})
    for mode in list(automatic_modes(node, table)):
        switch_off(node, mode)
    values = {number: value for number, (_, value, _) in webcam().controls.items()}
    assert {number: value for number, (_, value, _) in node.controls.items()} == values | off
    assert [mode.name for mode in automatic_modes(node, table)] == on


def test_the_doctor_names_an_automatic_mode_that_altd_could_not_switch_off(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    table = V4l2CameraSettings(driver="v4l2", device=Path("/dev/video0"), exposure={"control": "camera"})
    monkeypatch.setattr(find_cameras, "VideoNode", lambda _: webcam())
    texts = []
    for runs_daemon in (False, True):
        monkeypatch.setattr(Machine, "runs_daemon", lambda _, runs=runs_daemon: runs)
        found = find_cameras.check({"front": table}, Machine(tmp_path))
        texts.append([f"{finding.text}; {finding.remedy}" for finding in found if "stays on" in finding.text])
    assert texts[0] == []
    (text,) = texts[1]
    assert text.startswith("white_balance_automatic, focus_automatic_continuous: stays on, so the picture")
    assert "controls = { white_balance_automatic = 1, focus_automatic_continuous = 1 }" in text


NOW_NS = 5_000_000_000_000


def test_a_frame_is_read_only_and_stays_when_its_buffer_is_filled_again() -> None:
    buffer = bytearray(range(6))
    pixels = Layout(3, 2, 3, PIXEL_FORMATS["GREY"]).pixels(memoryview(buffer))
    buffer[:] = bytes(6)
    assert pixels.tolist() == [[0, 1, 2], [3, 4, 5]]
    assert not pixels.flags.writeable


def test_the_last_line_may_come_without_its_padding() -> None:
    layout = Layout(3, 2, 4, PIXEL_FORMATS["GREY"])
    assert layout.frame_bytes == 7
    assert layout.pixels(memoryview(bytes([1, 2, 3, 99, 4, 5, 6]))).tolist() == [[1, 2, 3], [4, 5, 6]]
    with pytest.raises((TypeError, ValueError)):
        layout.pixels(memoryview(bytes(6)))


@pytest.mark.parametrize(
    ("source", "exposure_ms", "middle_ns"),
    [
        (Stamp.START_OF_EXPOSURE, 4.0, NOW_NS + 2_000_000),
        (Stamp.END_OF_FRAME, 4.0, NOW_NS - 2_000_000),
        (Stamp.START_OF_EXPOSURE, None, NOW_NS),
        (Stamp.END_OF_FRAME, None, NOW_NS),
    ],
)
def test_half_lies_between_stamp_and_middle(source: Stamp, exposure_ms: float | None, middle_ns: int) -> None:
    assert middle_of_exposure_ns(NOW_NS, "monotonic", source, exposure_ms, NOW_NS + 1) == middle_ns


@pytest.mark.parametrize(
    ("clock", "stamp_ns", "taken_ns"),
    [
        ("unknown", NOW_NS - 30_000_000, NOW_NS - 30_000_000),  # v4l2loopback: it is the monotonic clock
        ("unknown", 0, NOW_NS),
        ("unknown", 1_790_000_000_000_000_000, NOW_NS),  # the time of day
        ("monotonic", NOW_NS - 3_000_000_000, NOW_NS - 3_000_000_000),  # waited long to be taken
    ],
)
def test_a_stamp_of_an_unknown_clock_counts_only_when_it_can_be_the_monotonic_one(
    clock: str, stamp_ns: int, taken_ns: int
) -> None:
    assert middle_of_exposure_ns(stamp_ns, clock, Stamp.END_OF_FRAME, None, NOW_NS) == taken_ns


def test_cameras_that_no_serial_number_tells_apart_are_listed_without_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A copied `serial` of two cameras would be refused."""
    serials = "0001", "0001", None, "A7"
    cameras = [
        find_cameras.FoundCamera(Path(f"/dev/v4l/by-path/{n}"), "Webcam", "uvcvideo", serial, {}, ())
        for n, serial in enumerate(serials)
    ]
    monkeypatch.setattr(find_cameras, "find_cameras", lambda: iter(cameras))
    said = "\n".join(find_cameras.lines())
    assert re.findall(r'serial = "(.*)"', said) == ["A7"]
    assert said.count("known by its port") == 3
