"""One defect for each package of altd, each a plausible programming mistake in one line."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Defect:
    """A defect and the text that it replaces in a file."""

    what: str
    file: str
    old: str
    new: str

    @property
    def room(self) -> str:
        """Package or module of altd that contains the defect."""
        return self.file.split("/")[1].removesuffix(".py")


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
        "        self._messages += 1\n",
        "        self._messages |= 1\n",
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
        "        backoff_s *= 2\n",
        "        backoff_s *= 1\n",
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
)
