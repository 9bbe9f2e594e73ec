"""Defects chosen by hand, each a plausible mistake; and which drawn ones no unit test needs to catch."""

import json
from pathlib import Path

from tools.defects.defect import Defect

DEFECTS = (
    Defect(
        "the centre of a moment lies half a pixel off: the patch's corner counts from pixel edges",
        "altd/vision/profile.py",
        "Centre(patch.left + u, patch.top + v, sigma_px)",
        "Centre(patch.left + u + 0.5, patch.top + v, sigma_px)",
    ),
    Defect(
        "the inverse map lets points through that lie outside what was calibrated",
        "altd/mapping/inverse.py",
        "return (x, y) if known else (math.nan, math.nan), inverse_jacobian, covariance",
        "return (x, y), inverse_jacobian, covariance",
    ),
    Defect(
        "outliers of a window are kept",
        "altd/measuring/averaging.py",
        "_OUTLIER_SIGMAS = 6.0",
        "_OUTLIER_SIGMAS = 6e6",
    ),
    Defect(
        "pitch has the wrong sign",
        "altd/instruments/beam/solver.py",
        "pitch_deg=math.degrees(math.atan(slope_y))",
        "pitch_deg=-math.degrees(math.atan(slope_y))",
    ),
    Defect(
        "what is old is not called stale",
        "altd/status/board.py",
        "if now_ns - since_ns <= self.stale_after_s * 1e9:",
        "if now_ns - since_ns <= 2 * self.stale_after_s * 1e9:",
    ),
    Defect(
        "a calibration with a wrong checksum is taken",
        "altd/calibration/file.py",
        "if checksum != checksum_of(document):",
        "if checksum is None:",
    ),
    Defect(
        "frames under the frame LEDs are taken for frames without",
        "altd/recording/frames_table.py",
        'leds_on, opaque = text["leds"] == "on"',
        'leds_on, opaque = text["leds"] == "lit"',
    ),
    Defect(
        "a limit of the config may be zero",
        "altd/config/measuring.py",
        "max_sigma_mm: Annotated[float, Field(gt=0, le=1000)]",
        "max_sigma_mm: Annotated[float, Field(ge=0, le=1000)]",
    ),
    Defect(
        "the words of a Modbus register are in the wrong order",
        "altd/publish/modbus/registers.py",
        'return struct.unpack(f">{self.words}H", packed)',
        'return struct.unpack(f">{self.words}H", packed)[::-1]',
    ),
    Defect(
        "two messages of an interface have the same number",
        "altd/status/proof.py",
        "self._running.messages[self._interface] += 1",
        "self._running.messages[self._interface] |= 1",
    ),
    Defect(
        "the CRC of the checked block leaves out the last register before it",
        "altd/publish/modbus/checked_block.py",
        "crc32(checked)",
        "crc32(checked[:-2])",
    ),
    Defect(
        "a failed part is started again without waiting longer each time",
        "altd/runtime/supervision.py",
        "wait_s = min(2 * wait_s, limits.longest_s)",
        "wait_s = min(wait_s, limits.longest_s)",
    ),
    Defect(
        "frames that were not taken in time are not counted",
        "altd/acquisition/frame_pairs.py",
        "            self.dropped[frame.camera] += 1\n",
        "            self.dropped[frame.camera] += 0\n",
    ),
    Defect(
        "a driver dates a frame by the end of its exposure",
        "altd/devices/v4l2/image.py",
        "return stamp_ns + half_ns if source is Stamp.START_OF_EXPOSURE else stamp_ns - half_ns",
        "return stamp_ns + half_ns if source is Stamp.START_OF_EXPOSURE else stamp_ns",
    ),
    Defect(
        "a file that cannot be written whole replaces the older one",
        "altd/files/writing.py",
        "        temporary.replace(path)\n    except BaseException:\n        temporary.unlink()\n",
        "        temporary.replace(path)\n    except BaseException:\n",
    ),
    Defect(
        "the variance of a row's baseline is left out",
        "altd/instruments/row/displacement.py",
        "return Displacement(epoch.place.t_ns, mm, random + baseline + lasting, random, lasting)",
        "return Displacement(epoch.place.t_ns, mm, random + lasting, random, lasting)",
    ),
    Defect(
        "the sigma of an LED's place leaves out the alignment to the pixel raster",
        "altd/selfcheck/drift.py",
        "sigma = np.sqrt(in_check**2 + claimed**2 + _RASTER_PX**2)",
        "sigma = np.sqrt(in_check**2 + claimed**2)",
    ),
    Defect(
        "light that one spot does not explain is left out of the covariance of a mean",
        "altd/measuring/averaging.py",
        "covariance_px2=covariance_px2 + np.diag(np.repeat(mean[:, _EXCESS2], 2)) + of_delays_px2,",
        "covariance_px2=covariance_px2 + of_delays_px2,",
    ),
)

_FILE = Path(__file__).with_name("explained.json")
EXPLAINED: dict[str, str] = json.loads(_FILE.read_text(encoding="utf-8"))
"""Drawn defects that no unit test needs to catch, each with the reason."""
