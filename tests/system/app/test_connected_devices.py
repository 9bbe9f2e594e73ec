"""``altd devices``: what it prints can be written into ``altd.toml`` unchanged."""

import tomllib
from pathlib import Path

from support.cli import altd
from support.gige_unit import served
from support.guest import run_in_guest


def section(out: str, heading: str) -> list[str]:
    """The lines below a heading, without their indents."""
    [below] = [part for part in out.split("\n\n") if part.startswith(heading)]
    return [line.strip() for line in below.splitlines()[1:]]


def test_a_camera_a_chip_and_a_port_are_told_in_the_words_of_the_config(tmp_path: Path) -> None:
    seen = run_in_guest(tmp_path, "altd_devices.py", kernel_arguments=("vivid.n_devs=1",)).results
    assert (seen["status"], seen["err"]) == (0, "")
    out = seen["out"]
    cameras = section(out, 'Cameras: [cameras.NAME], driver = "v4l2"')
    assert cameras[0] == 'device = "/dev/v4l/by-path/pci-0000:00:14.0-usb-0:2:1.0-video-index0"'
    assert cameras[1] == "vivid, kernel driver vivid"
    assert cameras[2] == "no serial number: known by its port, the device above"
    assert 'pixel_format = "GREY": 320 × 180, 640 × 360, 640 × 480' in cameras[3]
    assert "brightness 0 to 255, contrast 0 to 255, saturation 0 to 255, hue -128 to 128" in " ".join(cameras)
    chips = section(out, "GPIO chips: [lamps], [indicators]")
    assert chips == [
        'chip = "unit"',
        "/dev/gpiochip0, 3 lines",
        'lines: "LED_A", "1", "DOOR" (used by doorbell)',
    ]
    ports = section(out, "Serial ports: [[serial]], [inclinometer], [stage]")
    at = ports.index('device = "/dev/serial/by-id/usb-wires-if00"')
    assert ports[at + 1].endswith("now /dev/ttyACM0")


def test_cameras_on_the_network_are_told_by_their_serial_numbers() -> None:
    with served("--seed", "41") as unit:
        cameras = section(altd("devices").out, 'Cameras: [cameras.NAME], driver = "aravis"')
        for name, address in (("front", unit.front), ("rear", unit.rear)):
            at = cameras.index(f'device = "SIM-41-{name}"')
            assert tomllib.loads(cameras[at]) == {"device": f"SIM-41-{name}"}
            assert f" at {address}; " in cameras[at + 1]
            assert cameras[at + 2] == 'pixel_format = "Mono8" or "Mono10" or "Mono12" or "Mono16"'
