"""Pictures of the demos, their pages and the report: demo.svg and .png files in ``docs``."""

from __future__ import annotations

import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

import cv2
import numpy as np

from altd.process.endings import run_to_end
from tools.pictures.animation import Still, animated_svg
from tools.pictures.browser import screenshot
from tools.pictures.planar import draw_planar
from tools.pictures.terminal import Terminal, terminal

_COLUMNS, _ROWS = 84, 14
_STILL_S = 0.5
_FOLDER = Path("docs")
_TITLE = (
    "make demo: measured x, y, yaw and pitch beside the truth; the beam is blocked, the measurement is not "
    "valid, and valid again when the beam is back"
)


def main() -> int:
    """Make all pictures; raises CalledProcessError or TimeoutError if a program fails."""
    draw_planar(_FOLDER / "planar.png")
    with terminal(f"{sys.executable} -m hw_sim planar", _COLUMNS, _ROWS) as demo:
        demo.await_text("http://127.0.0.1", timeout_s=120.0)
        (address,) = re.findall(r"http://127\.0\.0\.1:\d+", demo.text())
        screenshot(address, _FOLDER / "planar-page.png", 640, 900, after_s=6.0)
    with terminal(f"{sys.executable} -m hw_sim chain-demo", 2 * _COLUMNS, _ROWS) as demo:
        demo.await_text("alarm_displacement", timeout_s=120.0)
        (address,) = re.findall(r"http://127\.0\.0\.1:\d+", demo.text())
        screenshot(address, _FOLDER / "chain-page.png", 900, 1300, after_s=4.0)
    with (
        tempfile.TemporaryDirectory(prefix="altd-pictures-") as folder,
        terminal(f"{sys.executable} -m hw_sim demo", _COLUMNS, 32) as demo,
    ):
        demo.await_text("VALID, mean of 20", timeout_s=180.0)
        stills = list(_record_demo(demo))
        (_FOLDER / "demo.svg").write_text(animated_svg(stills, _COLUMNS, _ROWS, _TITLE))
        (address,) = re.findall(r"http://127\.0\.0\.1:\d+/", demo.text().split("browser")[1].split("\n")[0])
        screenshot(address, _FOLDER / "page.png", 1280, 970, after_s=6.0)
        demo.press("q")
        _draw_report(Path(folder), _FOLDER / "report.png")
    return 0


def _record_demo(demo: Terminal) -> Iterator[Still]:
    """Yield screens of the demo: the beam moves, is blocked, and returns."""
    for key, seconds in (("", 5.0), ("b", 4.0), ("c", 7.0)):
        if key:
            demo.press(key)
        for _ in range(round(seconds / _STILL_S)):
            began_s = time.monotonic()
            yield Still(demo.screen()[:_ROWS], _STILL_S)
            time.sleep(max(began_s + _STILL_S - time.monotonic(), 0.0))


def _draw_report(folder: Path, picture: Path) -> None:
    """Draw the first two sheets of the report on a simulated unit with a flat, side by side."""
    simulator, altd = [sys.executable, "-m", "hw_sim"], [sys.executable, "-m", "altd.cli"]
    scan, flat, report = folder / "scan", folder / "flat", folder / "report"
    _run([*simulator, "scan", "-o", scan, "--seed", "1"])
    _run([*simulator, "flat", "-o", flat, "--seed", "1"])
    _run([*altd, "calibrate", scan, "--flat", flat, "-o", folder / "calibration.json", "--report", report])
    _run(["pdftoppm", "-r", "70", "-l", "2", "-png", report / "calibration.pdf", folder / "sheet"])
    sheets = [np.asarray(cv2.imread(str(path))) for path in sorted(folder.glob("sheet*.png"))]
    edge = np.full((sheets[0].shape[0], 8, 3), 200, np.uint8)
    cv2.imwrite(str(picture), np.hstack([sheets[0], edge, sheets[1]]), [cv2.IMWRITE_PNG_COMPRESSION, 9])


def _run(command: Sequence[str | Path]) -> None:
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)  # noqa: S603


if __name__ == "__main__":
    sys.exit(run_to_end(main, lambda: "tools.pictures"))
