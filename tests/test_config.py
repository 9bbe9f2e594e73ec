from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any, get_args

import pytest
from pydantic import ValidationError
from support.cli import CONFIG

from altd.config import Config, Table, load_config
from altd.errors import BadInputError

GOOD = CONFIG.format(calibration="cal.json", recording="rec")


def write(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "altd.toml"
    path.write_text(text)
    return path


def complaint(path: Path) -> str:
    with pytest.raises(BadInputError) as caught:
        load_config(path)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_paths_are_relative_to_the_config_file(tmp_path: Path) -> None:
    config = load_config(write(tmp_path, GOOD))
    assert config.unit.calibration == tmp_path / "cal.json"
    assert config.cameras["rear"].path == tmp_path / "rec"


def test_the_shipped_config_is_good() -> None:
    shipped = Path(__file__).resolve().parents[1] / "config" / "altd.toml"
    config = load_config(shipped)
    assert [target.name for target in config.targets] == ["front", "rear"]


@pytest.mark.parametrize("host", ["0.0.0.0", "192.168.7.2", "::", "::1", "fe80::1%eth0", "localhost"])
def test_a_face_listens_on_an_address(tmp_path: Path, host: str) -> None:
    config = load_config(write(tmp_path, f'{GOOD}\n[http]\nhost = "{host}"\n[modbus_tcp]\nhost = "{host}"\n'))
    assert config.http is not None
    assert config.modbus_tcp is not None
    assert config.http.host == config.modbus_tcp.host == host


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('serial = "TEST-1"', 'serial = "TEST-1"\ncolour = 3', "unit.colour: unknown key"),
        ("z_mm = 280.0", 'z_mm = "far"', "targets.1.z_mm: Input should be a valid number"),
        ("z_mm = 280.0", "", "targets.1.z_mm: Field required"),
        ('driver = "recording"', 'driver = "magic"', "cameras.front.driver: 'magic' is none of"),
        ('camera = "rear"', 'camera = "third"', "targets: no [cameras.third] for camera 'third'"),
        ('name = "rear"', 'name = "front"', "targets: two targets have the same name"),
        ("[unit]", "[unit", "not TOML"),
        ("[cameras.rear]", "[http]\nport = 70000\n[cameras.rear]", "http.port: Input should be less than or"),
        *(
            (
                "[cameras.rear]",
                f"[{face}]\nhost = {host!r}\n[cameras.rear]",
                f"{face}.host: {host!r} is no IP",
            )
            for face in ("http", "modbus_tcp")
            for host in ("", " ", "unit.example", "1.2.3", "0.0.0.0:80", "*")
        ),
        ("[unit]", "", "unit: Field required"),
        ('driver = "recording"', "", "cameras.front.driver: Field required"),
        ('driver = "recording"', 'driver = "v4l2"', "cameras.front.device: Field required"),
        (
            "[cameras.rear]",
            '[lamps]\ndriver = "gpiod"\nchip = "a"\nlines = []\n[cameras.rear]',
            "lamps.lines: Tuple should have at least 1 item",
        ),
        (
            "[cameras.rear]",
            '[lamps]\ndriver = "camera"\ncameras = ["rear"]\n[cameras.rear]',
            "lamps: camera 'rear' is no camera with driver",
        ),
        (
            "[cameras.rear]",
            '[indicators]\ndriver = "gpiod"\nchip = "a"\nok = "x"\nerror = "x"\n[cameras.rear]',
            "lamps, indicators: two lamps are on the same line",
        ),
        (
            "[cameras.rear]",
            '[indicators]\ndriver = "gpiod"\nchip = "a"\n[cameras.rear]',
            "indicators: no line: give data, error, power or ok",
        ),
        (
            "window = 4",
            'pair_by = "time"\n[lamps]\ndriver = "camera"\ncameras = ["top"]\n'
            '[cameras.top]\ndriver = "aravis"\ndevice = "1"\n',
            "lamps: camera 'top' looks at no target and is not opened",
        ),
    ],
)
def test_a_mistake_is_named_with_its_place(tmp_path: Path, old: str, new: str, message: str) -> None:
    path = write(tmp_path, GOOD.replace(old, new, 1))
    assert complaint(path).startswith(f"{path}: ")
    assert message in complaint(path)


def test_one_serial_port_is_given_out_once(tmp_path: Path) -> None:
    port = '[[serial]]\ndevice = "/dev/ttyS0"\nspeaks = "telegram"\n'
    assert "serial: two ports have the same device" in complaint(write(tmp_path, GOOD + port + port))


STAGE = '[stage]\ndriver = "grbl"\ndevice = "/dev/ttyS0"\n'


def test_a_stage_needs_no_more_than_its_port(tmp_path: Path) -> None:
    config = load_config(write(tmp_path, GOOD + STAGE))
    assert config.stage is not None
    assert (config.stage.start, config.stage.baud) == ("home", 115200)
    assert (config.scan.columns, config.scan.rows, config.scan.pitch_mm) == (6, 5, 28.0)


@pytest.mark.parametrize(
    ("more", "message"),
    [
        (STAGE + "speed = 3", "stage.speed: unknown key"),
        (STAGE + "sign_x = 0", "stage.sign_x: Input should be -1 or 1"),
        ("[scan]\ncolumns = 3", "scan.columns: Input should be greater than or equal to 4"),
        ('[scan]\norder = "spiral"', "scan.order: Input should be 'serpentine' or 'rows'"),
        (
            '[[serial]]\ndevice = "/dev/ttyS0"\nspeaks = "telegram"\n' + STAGE,
            "stage: a [[serial]] port has the same device",
        ),
    ],
)
def test_a_mistake_about_the_stage_is_named(tmp_path: Path, more: str, message: str) -> None:
    assert message in complaint(write(tmp_path, GOOD + more))


def test_a_missing_file_and_a_binary_one_are_named(tmp_path: Path) -> None:
    assert "No such file or directory" in complaint(tmp_path / "none.toml")
    (tmp_path / "binary.toml").write_bytes(b"\xff\xfe\x00")
    assert "is not UTF-8 text" in complaint(tmp_path / "binary.toml")


LIVE = """
[cameras.front]
driver = "aravis"
device = "192.0.2.1"
trigger = "software"

[cameras.front.exposure]
control = "fixed"
exposure_ms = 1.5

[cameras.rear]
driver = "v4l2"
device = "/dev/video0"
pixel_format = "Y12"
"""


def live(more: str) -> str:
    head, _, tail = GOOD.partition("[cameras.front]")
    return head + LIVE + tail[tail.index("[measuring]") :] + more


def test_cameras_of_several_drivers_stand_side_by_side(tmp_path: Path) -> None:
    config = load_config(write(tmp_path, live('pair_by = "time"\n')))
    assert [camera.driver for camera in config.cameras.values()] == ["aravis", "v4l2"]


def test_live_cameras_are_paired_by_time_only(tmp_path: Path) -> None:
    assert 'measuring.pair_by: must be "time"' in complaint(write(tmp_path, live("")))


def test_automatic_exposure_begins_within_its_limits(tmp_path: Path) -> None:
    text = live('pair_by = "time"\n').replace('control = "fixed"\nexposure_ms = 1.5', "exposure_ms = 100")
    assert "exposure: exposure_ms: not between" in complaint(write(tmp_path, text))


def within(annotation: Any) -> Iterator[Any]:
    yield annotation
    for part in get_args(annotation):
        yield from within(part)


def floats(model: type[Table], place: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], type[Table]]]:
    """Every key that takes a number with a fraction, by the tables that lead to it."""
    for name, field in model.model_fields.items():
        parts = list(within(field.annotation))
        if float in parts:
            yield (*place, name), model
        for part in parts:
            if isinstance(part, type) and issubclass(part, Table):
                yield from floats(part, (*place, name))


EVERY_FLOAT = sorted(
    {(model, key[-1]) for key, model in floats(Config)}, key=lambda at: (at[0].__name__, at[1])
)


@pytest.mark.parametrize(("model", "key"), EVERY_FLOAT, ids=lambda at: getattr(at, "__name__", at))
@pytest.mark.parametrize("value", [float("nan"), float("inf"), float("-inf"), 1e300, -1e300])
def test_no_number_that_is_none_or_absurd_enters(model: type[Table], key: str, value: float) -> None:
    given = {"GenICamName": value} if key == "features" else value
    if key == "features" and abs(value) == 1e300:
        return  # a camera's own feature: its driver asks the camera what it takes
    with pytest.raises(ValidationError) as caught:
        model.model_validate({key: given})
    assert key in {str(error["loc"][0]) for error in caught.value.errors()}


def test_every_quantity_of_the_config_was_asked_for() -> None:
    asked = {f"{model.__name__}.{key}" for model, key in EVERY_FLOAT}
    assert {
        "Target.z_mm",
        "Installation.offset_x_mm",
        "Installation.reference_plane_mm",
        "ExposureControl.exposure_ms",
        "AravisCamera.features",
        "GrblStage.offset_y_mm",
        "Scan.centre_x_mm",
        "Measuring.max_sigma_mm",
    } <= asked


@pytest.mark.parametrize(
    ("more", "message"),
    [
        ("[installation]\noffset_x_mm = nan", "installation.offset_x_mm: Input should be a finite number"),
        ("[installation]\nreference_plane_mm = inf", "reference_plane_mm: Input should be a finite number"),
        ("[installation]\noffset_y_mm = 1e200", "equal to 100000, not 1e+200"),
        ("[installation]\noffset_yaw_deg = 90.0", "offset_yaw_deg: Input should be less than or equal to 45"),
    ],
)
def test_a_number_that_is_none_is_named_with_its_key_and_value(
    tmp_path: Path, more: str, message: str
) -> None:
    assert message in complaint(write(tmp_path, GOOD + more))
