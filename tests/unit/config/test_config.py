from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any, get_args

import pytest
from pydantic import ValidationError
from support.places import ROOT
from support.unit_toml import played_toml

from altd.config import Config, Measuring, Table, load_config
from altd.errors import BadInputError

GOOD = played_toml("cal.json", "rec")


def write(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "altd.toml"
    path.write_text(text)
    return path


def complaint(path: Path) -> str:
    with pytest.raises(BadInputError) as caught:
        load_config(path)
    assert all("\n" not in line for line in caught.value.lines)
    return "\n".join(caught.value.lines)


def test_paths_are_relative_to_the_config_file(tmp_path: Path) -> None:
    config = load_config(write(tmp_path, GOOD))
    assert config.unit.calibration == tmp_path / "cal.json"
    assert config.cameras["rear"].path == tmp_path / "rec"


def test_the_shipped_config_is_good() -> None:
    config = load_config(ROOT / "config" / "live.toml")
    assert [target.name for target in config.targets] == ["front", "rear"]
    assert config.measuring.pair_by == "time"


def test_modbus_has_the_port_of_its_specification_and_its_files_lie_beside_the_config(tmp_path: Path) -> None:
    plain = load_config(write(tmp_path, f"{GOOD}\n[modbus_tcp]\n")).modbus_tcp
    assert plain is not None
    assert plain.port_or_default == 502
    files = 'certificate = "u.pem"\nkey = "u.key"\nclient_ca = "ca.pem"\n'
    secured = load_config(write(tmp_path, f"{GOOD}\n[modbus_tcp]\n{files}")).modbus_tcp
    assert secured is not None
    assert secured.port_or_default == 802
    assert (secured.certificate, secured.client_ca) == (tmp_path / "u.pem", tmp_path / "ca.pem")
    http = "[http]\nport = 802\n"
    assert "802 is the port of [modbus_tcp] too" in complaint(
        write(tmp_path, f"{GOOD}\n{http}[modbus_tcp]\n{files}")
    )


@pytest.mark.parametrize("host", ["0.0.0.0", "192.168.7.2", "::", "::1", "fe80::1%eth0", "localhost"])
def test_a_face_listens_on_an_address(tmp_path: Path, host: str) -> None:
    config = load_config(write(tmp_path, f'{GOOD}\n[http]\nhost = "{host}"\n[modbus_tcp]\nhost = "{host}"\n'))
    assert config.http is not None
    assert config.modbus_tcp is not None
    assert config.http.host == config.modbus_tcp.host == host


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (
            'serial = "TEST-1"',
            'serial = "TEST-1"\ncolour = 3',
            "unit.colour: there is no such key; possible: calibration, instrument, serial",
        ),
        (
            "z_mm = 280.0",
            'z_mm = "far"',
            'targets.1.z_mm: "far" is not a number; possible: number from -100000 to 100000',
        ),
        ("z_mm = 280.0", "", "targets.1.z_mm: this key is missing; possible: number"),
        (
            'driver = "recording"',
            'driver = "magic"',
            'cameras.front.driver: "magic" is not possible; possible: "recording" or "v4l2"',
        ),
        (
            'camera = "rear"',
            'camera = "third"',
            'targets.1.camera: there is no table [cameras.third]; possible: "front", "rear"',
        ),
        (
            'name = "rear"',
            'name = "front"',
            'targets.1.name: "front" is the name of targets.0 too',
        ),
        ("[unit]", "[unit", "not TOML: the ] after the name of a table is missing"),
        (
            "[cameras.rear]",
            "[http]\nport = 70000\n[cameras.rear]",
            "http.port: 70000 is too large; possible: whole number from 0 to 65535",
        ),
        *(
            (
                "[cameras.rear]",
                f"[{face}]\nhost = {host!r}\n[cameras.rear]",
                f'{face}.host: "{host}" is not an IP address; possible: an IP address of',
            )
            for face in ("http", "modbus_tcp")
            for host in ("", " ", "unit.example", "1.2.3", "300.1.1.1", "0.0.0.0:80", "*")
        ),
        ("[unit]", "", "unit: this table is missing"),
        (
            'driver = "recording"',
            "",
            'cameras.front.driver: this key is missing; possible: "recording"',
        ),
        (
            'driver = "recording"',
            'driver = "v4l2"',
            "cameras.front.device: this key is missing; possible: path",
        ),
        (
            "[cameras.rear]",
            '[lamps]\ndriver = "gpiod"\nchip = "a"\nlines = []\n[cameras.rear]',
            "lamps.lines: a list has too few elements; possible: list of 1 or more",
        ),
        (
            "[cameras.rear]",
            '[lamps]\ndriver = "camera"\ncameras = ["rear"]\n[cameras.rear]',
            'lamps.cameras.0: "rear" has no output; possible: a camera with driver "aravis"',
        ),
        (
            "[cameras.rear]",
            '[indicators]\ndriver = "gpiod"\nchip = "a"\nok = "x"\nerror = "x"\n[cameras.rear]',
            'indicators.ok: "x" is the line of indicators.error too',
        ),
        (
            "[cameras.rear]",
            '[indicators]\ndriver = "gpiod"\nchip = "a"\n[cameras.rear]',
            "indicators: no lamp has a line; possible: data, error, power, ok",
        ),
        (
            "window = 4",
            'pair_by = "time"\n[lamps]\ndriver = "camera"\ncameras = ["top"]\n'
            '[cameras.top]\ndriver = "aravis"\ndevice = "1"\n',
            'lamps.cameras.0: "top" has no target and is not opened',
        ),
    ],
)
def test_a_mistake_is_named_with_its_place(tmp_path: Path, old: str, new: str, message: str) -> None:
    path = write(tmp_path, GOOD.replace(old, new, 1))
    assert complaint(path).startswith(f"{path}: ")
    assert message in complaint(path)


def test_one_serial_port_is_given_out_once(tmp_path: Path) -> None:
    port = '[[serial]]\ndevice = "/dev/ttyS0"\nspeaks = "telegram"\n'
    assert 'serial.1.device: "/dev/ttyS0" is the port of serial.0 too' in complaint(
        write(tmp_path, GOOD + port + port)
    )


STAGE = '[stage]\ndriver = "grbl"\ndevice = "/dev/ttyS0"\n'


def test_a_stage_needs_no_more_than_its_port(tmp_path: Path) -> None:
    config = load_config(write(tmp_path, GOOD + STAGE))
    assert config.stage is not None
    assert (config.stage.start, config.stage.baud) == ("home", 115200)
    assert (config.scan.columns, config.scan.rows, config.scan.pitch_mm) == (6, 5, 28.0)


@pytest.mark.parametrize(
    ("more", "message"),
    [
        (STAGE + "speed = 3", "stage.speed: there is no such key"),
        (STAGE + "sign_x = 0", "stage.sign_x: 0 is not possible; possible: -1 or 1"),
        (
            "[scan]\ncolumns = 3",
            "scan.columns: 3 is too small; possible: whole number from 4 to 64",
        ),
        (
            '[scan]\norder = "spiral"',
            'scan.order: "spiral" is not possible; possible: "serpentine" or "rows"',
        ),
        (
            '[[serial]]\ndevice = "/dev/ttyS0"\nspeaks = "telegram"\n' + STAGE,
            'stage.device: "/dev/ttyS0" is the port of serial.0 too',
        ),
    ],
)
def test_a_mistake_about_the_stage_is_named(tmp_path: Path, more: str, message: str) -> None:
    assert message in complaint(write(tmp_path, GOOD + more))


def test_a_missing_file_and_a_binary_one_are_named(tmp_path: Path) -> None:
    assert "No such file or directory" in complaint(tmp_path / "none.toml")
    (tmp_path / "binary.toml").write_bytes(b"\xff\x00")
    assert "line 1, column 1: is not UTF-8 text" in complaint(tmp_path / "binary.toml")


def test_a_text_of_another_encoding_is_answered_by_what_to_save_it_as(tmp_path: Path) -> None:
    path = tmp_path / "altd.toml"
    for encoding, answer in (
        ("utf-8-sig", "line 1, column 1: is text that begins with a byte order mark: save the file as UTF-8"),
        ("utf-16", "line 1, column 1: is UTF-16: save the file as UTF-8"),
        ("latin-1", "line 1, column 5: is not UTF-8 text: save the file as UTF-8"),
    ):
        path.write_bytes("# Prüfstand\n[unit]\n".encode(encoding))
        assert complaint(path) == f"{path}: {answer}"


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
    assert load_config(write(tmp_path, live(""))).measuring.pair_by == "time"
    assert 'measuring.pair_by: "sequence" is for recordings; possible: "time"' in complaint(
        write(tmp_path, live('pair_by = "sequence"\n'))
    )


def test_automatic_exposure_begins_within_its_limits(tmp_path: Path) -> None:
    text = live('pair_by = "time"\n').replace('control = "fixed"\nexposure_ms = 1.5', "exposure_ms = 100")
    assert "cameras.front.exposure.exposure_ms: 100 is not where auto may begin" in complaint(
        write(tmp_path, text)
    )


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
        "ExposureSettings.exposure_ms",
        "AravisCameraSettings.features",
        "GrblStageSettings.offset_y_mm",
        "Scan.centre_x_mm",
        "Measuring.max_sigma_mm",
    } <= asked


@pytest.mark.parametrize(
    ("more", "message"),
    [
        (
            "[installation]\noffset_x_mm = nan",
            "installation.offset_x_mm: nan is not a finite number",
        ),
        (
            "[installation]\nreference_plane_mm = inf",
            "reference_plane_mm: inf is not a finite number",
        ),
        (
            "[installation]\noffset_y_mm = 1e200",
            "offset_y_mm: 1e+200 is too large; possible: number from -100000 to 100000",
        ),
        (
            "[installation]\noffset_yaw_deg = 90.0",
            "offset_yaw_deg: 90.0 is too large; possible: number from -45 to 45",
        ),
    ],
)
def test_a_number_that_is_none_is_named_with_its_key_and_value(
    tmp_path: Path, more: str, message: str
) -> None:
    assert message in complaint(write(tmp_path, GOOD + more))


@pytest.mark.parametrize(
    "key",
    ["max_skew_ms", "max_lag_ms", "max_sigma_mm", "max_sigma_mm_per_m", "silent_after_s", "stale_after_s"],
)
def test_a_limit_of_the_measuring_is_above_zero(key: str) -> None:
    """With zero nothing would be valid, or everything stale at once."""
    with pytest.raises(ValidationError) as caught:
        Measuring.model_validate({key: 0.0})
    assert caught.value.errors()[0]["type"] == "greater_than"
    assert getattr(Measuring.model_validate({key: 0.001}), key) == 0.001
