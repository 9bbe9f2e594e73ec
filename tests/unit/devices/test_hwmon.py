"""A thermometer of the kernel: files as Documentation/hwmon/sysfs-interface has them."""

from pathlib import Path

import pytest

from altd.devices.hwmon import HwmonThermometer, HwmonThermometerSettings
from altd.ports import ThermometerError


def chip(root: Path, number: int, name: str, **files: str) -> Path:
    folder = root / f"hwmon{number}"
    folder.mkdir()
    (folder / "name").write_text(f"{name}\n")
    for file, text in files.items():
        (folder / file).write_text(text)
    return folder


def thermometer(root: Path, channel: int = 1) -> HwmonThermometer:
    settings = HwmonThermometerSettings(driver="hwmon", name="housing", chip="tmp102", channel=channel)
    return HwmonThermometer(settings, root)


@pytest.mark.parametrize(
    ("text", "celsius"), [("23125\n", 23.125), ("-10250\n", -10.25), ("0\n", 0.0), ("60000\n", 60.0)]
)
def test_reads_thousandths_of_a_degree(tmp_path: Path, text: str, celsius: float) -> None:
    chip(tmp_path, 0, "cpu_thermal", temp1_input="81000\n")
    chip(tmp_path, 1, "tmp102", temp1_input=text)
    assert thermometer(tmp_path).celsius() == pytest.approx(celsius)


def test_finds_its_chip_again_under_another_number_and_reads_its_channel(tmp_path: Path) -> None:
    folder = chip(tmp_path, 0, "tmp102", temp1_input="1000\n", temp2_input="2000\n")
    second = thermometer(tmp_path, channel=2)
    assert second.celsius() == 2.0
    folder.rename(tmp_path / "hwmon7")
    assert second.celsius() == 2.0


@pytest.mark.parametrize("text", ["", "warm\n", "1e3\n", "\x00\xff", "12.5\n", "20_000\n"])
def test_what_is_no_temperature_is_refused_with_its_place(tmp_path: Path, text: str) -> None:
    chip(tmp_path, 0, "tmp102", temp1_input=text)
    with pytest.raises(ThermometerError, match="is not a temperature"):
        thermometer(tmp_path).celsius()


def test_a_chip_that_is_missing_or_there_twice_and_a_broken_sensor_are_named(tmp_path: Path) -> None:
    with pytest.raises(ThermometerError, match="not found: no hwmon chip 'tmp102'"):
        thermometer(tmp_path / "nowhere").celsius()
    first = chip(tmp_path, 0, "tmp102", temp1_input="20000", temp1_fault="1\n")
    with pytest.raises(ThermometerError, match="reports a broken sensor"):
        thermometer(tmp_path).celsius()
    (first / "temp1_input").unlink()
    (first / "temp1_fault").unlink()
    with pytest.raises(ThermometerError, match="cannot be read"):
        thermometer(tmp_path).celsius()
    chip(tmp_path, 1, "tmp102")
    with pytest.raises(ThermometerError, match="2 hwmon chips have the name 'tmp102'"):
        thermometer(tmp_path).celsius()
