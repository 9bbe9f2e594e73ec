"""The doctor on chips of the kernel."""

from pathlib import Path

from support.guest import run_in_guest


def test_a_real_gpio_chip_by_its_label_its_name_and_its_path(tmp_path: Path) -> None:
    found = run_in_guest(tmp_path, "doctor_gpio.py").results
    for chip in ("lamp-board", "gpiochip0", "/dev/gpiochip0"):
        assert [finding["verdict"] for finding in found[chip]] == ["good"]
    (finding,) = found["other-board"]
    assert finding["verdict"] == "ERROR"
    assert "existing: /dev/gpiochip0" in finding["text"]
