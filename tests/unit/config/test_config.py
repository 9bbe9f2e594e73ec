import importlib
import pkgutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any, get_args

import pytest
from pydantic import ValidationError
from support.places import ROOT
from support.unit_toml import played_toml

import altd.devices
from altd.config import Config, Measuring, Table, load_config
from altd.devices.settings import DeviceTable
from altd.errors import BadInputError
from altd.records import CameraIdentity

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


@pytest.mark.parametrize("kind", ["machine", "desk"])
def test_the_shipped_configs_are_good(kind: str) -> None:
    config = load_config(ROOT / "config" / ("live.toml" if kind == "machine" else "desk.toml"))
    assert [target.name for target in config.targets] == ["front", "rear"]
    assert config.measuring.pair_by == "time"
    assert config.unit.kind == kind


def test_cameras_of_one_serial_number_are_told_apart_by_their_ports(tmp_path: Path) -> None:
    """Makers of webcams give many the same number; the answer to two tables with it names the way out."""
    cameras = "".join(
        f'[cameras.{name}]\ndriver = "v4l2"\ndevice = "/dev/v4l/by-path/usb-{port}"\nserial = "0001"\n'
        for port, name in enumerate(("front", "rear"))
    )
    head = GOOD[: GOOD.index("[cameras")]
    said = complaint(write(tmp_path, head + cameras))
    assert '"0001" is already the serial of camera "front"' in said
    assert said.endswith("or leave serial out of both: device below /dev/v4l/by-path is one port")
    config = load_config(write(tmp_path, head + cameras.replace('serial = "0001"\n', "")))
    assert [camera.serial for camera in config.cameras.values()] == [None, None]
    sent = CameraIdentity("0001", "Webcam", "v4l2")
    assert not sent.difference_from(CameraIdentity(None, "Webcam", "v4l2")), "none is refused for lacking one"


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
    assert "port 802 is already used by [modbus_tcp]" in complaint(
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
        ("[unit]", "", "unit: this table is missing"),
        (
            "[cameras.rear]",
            '[lamps]\ndriver = "camera"\ncameras = ["rear"]\n[cameras.rear]',
            'lamps.cameras.0: "rear" has no output; possible: a camera with driver "aravis"',
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


def test_a_stage_needs_no_more_than_its_port(tmp_path: Path) -> None:
    config = load_config(write(tmp_path, f'{GOOD}[stage]\ndriver = "grbl"\ndevice = "/dev/ttyS0"\n'))
    assert config.stage is not None
    assert (config.stage.start, config.stage.baud) == ("home", 115200)
    assert (config.scan.columns, config.scan.rows, config.scan.pitch_mm) == (6, 5, 28.0)


def test_a_missing_file_and_a_binary_one_are_named(tmp_path: Path) -> None:
    assert "No such file or directory" in complaint(tmp_path / "none.toml")
    (tmp_path / "binary.toml").write_bytes(b"\xff\x00")
    assert "line 1, column 1: is not UTF-8 text" in complaint(tmp_path / "binary.toml")


def test_a_file_that_every_user_may_write_is_refused(tmp_path: Path) -> None:
    path = write(tmp_path, GOOD)
    path.chmod(0o666)
    remedy = f"others than its owner may write it (mode 0666): chmod o-w {path}"
    assert complaint(path) == f"{path}: {remedy}"
    path.chmod(0o664)
    load_config(path)


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
trigger = "free"

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


def test_live_cameras_are_paired_by_time_only(tmp_path: Path) -> None:
    assert load_config(write(tmp_path, live(""))).measuring.pair_by == "time"
    assert 'measuring.pair_by: "sequence" is for recordings; possible: "time"' in complaint(
        write(tmp_path, live('pair_by = "sequence"\n'))
    )


def test_software_triggers_all_cameras_or_none(tmp_path: Path) -> None:
    software = live("").replace('"free"', '"software"')
    assert 'cameras.front.trigger: "software" does not go with camera "rear"' in complaint(
        write(tmp_path, software)
    )
    rear = 'driver = "aravis"\ndevice = "192.0.2.2"\ntrigger = "software"\n'
    both = software.replace('driver = "v4l2"\ndevice = "/dev/video0"\npixel_format = "Y12"\n', rear)
    assert load_config(write(tmp_path, both)).cameras["rear"].driver == "aravis"
    short = both.replace("[measuring]", "[measuring]\nsilent_after_s = 0.07")
    assert (
        "measuring.silent_after_s: 0.07 is shorter than a frame interval; possible: above 0.075"
        in complaint(write(tmp_path, short))
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
    "key",
    ["max_skew_ms", "max_lag_ms", "max_sigma_mm", "max_sigma_mm_per_m", "silent_after_s", "stale_after_s"],
)
def test_a_limit_of_the_measuring_is_above_zero(key: str) -> None:
    """With zero nothing would be valid, or everything stale at once."""
    with pytest.raises(ValidationError) as caught:
        Measuring.model_validate({key: 0.0})
    assert caught.value.errors()[0]["type"] == "greater_than"
    assert getattr(Measuring.model_validate({key: 0.001}), key) == 0.001


@pytest.mark.parametrize(
    ("mqtt", "keeps"),
    [("", False), ("[mqtt]\n", False), ("[mqtt]\nstore_and_forward = true\n", True)],
)
def test_seconds_are_kept_for_an_ingest_where_a_broker_shall_have_them(
    tmp_path: Path, mqtt: str, keeps: bool
) -> None:
    text = mqtt.replace("[mqtt]", '[mqtt]\nhost = "broker"\ncredentials = "mqtt"')
    (tmp_path / "mqtt").touch(0o600)
    assert load_config(write(tmp_path, f"{GOOD}\n{text}")).has_outbox is keeps


def test_every_driver_is_in_the_table_of_drivers() -> None:
    packages = (f"altd.devices.{module.name}" for module in pkgutil.iter_modules(altd.devices.__path__))
    found = {
        value
        for package in packages
        for value in vars(importlib.import_module(package)).values()
        if isinstance(value, type) and issubclass(value, DeviceTable) and "driver" in value.model_fields
    }
    used = {part for field in Config.model_fields.values() for part in within(field.annotation)}
    assert found == used & found
    assert len(found) >= 10


def test_points_of_the_machine_need_a_roll(tmp_path: Path) -> None:
    point = '[[machine.points]]\nname = "shield"\nx_mm = 0\ny_mm = 0\nz_mm = 900\nsigma_mm = 1\n'
    said = complaint(write(tmp_path, f"{GOOD}\n[machine]\nmount_sigma_deg = 0.05\n{point}"))
    assert "machine.roll_deg: the points need a roll; possible: roll_deg, or a table [inclinometer]" in said
    machine = "[machine]\nroll_deg = 0.5\nroll_sigma_deg = 0.02\nmount_sigma_deg = 0.05\n"
    assert load_config(write(tmp_path, f"{GOOD}\n{machine}{point}")).machine is not None
    for key, about in (
        ("roll_sigma_deg = 0.02\n", "roll_deg: its"),
        ("mount_sigma_deg = 0.05\n", "points: the"),
    ):
        said = complaint(write(tmp_path, f"{GOOD}\n{machine.replace(key, '')}{point}"))
        assert f"machine.{about} uncertainty" in said
