"""The demo's cameras as hardware: ``hw_sim gige`` in a separate process, and altd's settings for it."""

import asyncio
import contextlib
import sys
from collections.abc import AsyncIterator, Mapping
from typing import Any

from altd.config import AravisCameraSettings, CameraLampsSettings, ExposureSettings, Measuring
from altd.errors import BadInputError
from hw_sim.faults import Fault
from hw_sim.unit import EXPOSURES_MS, Unit

_POLL_INTERVAL_S = 0.05


class Hardware:
    """Process that serves the cameras at ``addresses``, by camera name."""

    def __init__(self, process: asyncio.subprocess.Process, addresses: Mapping[str, str]) -> None:
        self._process = process
        self._addresses = addresses

    @property
    def tables(self) -> dict[str, Any]:
        """Tables of ``altd.toml`` for these cameras."""
        cameras = {
            name: AravisCameraSettings(
                driver="aravis",
                device=address,
                exposure=ExposureSettings(exposure_ms=EXPOSURES_MS[name]),  # as in the scan
            )
            for name, address in self._addresses.items()
        }
        lamps = CameraLampsSettings(driver="camera", cameras=tuple(cameras))
        return {"cameras": cameras, "lamps": lamps, "measuring": Measuring(pair_by="time")}

    async def follow(self, unit: Unit) -> None:
        """Apply the faults of ``unit`` to the cameras; raises BadInputError when the process ends."""
        sent: frozenset[Fault] = frozenset()
        while self._process.returncode is None:
            if (faults := unit.faults) != sent and self._process.stdin is not None:
                self._process.stdin.write(f"{','.join(faults)}\n".encode())
                sent = faults
            await asyncio.sleep(_POLL_INTERVAL_S)
        raise BadInputError("hw_sim gige", f"ended with status {self._process.returncode}")


@contextlib.asynccontextmanager
async def served(seed: int, addresses: Mapping[str, str]) -> AsyncIterator[Hardware]:
    """Serve the cameras of a unit on its path; raises BadInputError if they are not ready in time.

    The process prints the cause on standard error.
    """
    where = [part for name, address in addresses.items() for part in (f"--{name}", address)]
    process = await asyncio.create_subprocess_exec(
        *(sys.executable, "-m", "hw_sim", "gige", "--seed", str(seed), "--drive", "--listen", *where),
        stdin=asyncio.subprocess.PIPE,
        stdout=asyncio.subprocess.PIPE,
        start_new_session=True,  # Ctrl-C goes to the demo alone, which ends the process
    )
    try:
        assert process.stdout is not None  # noqa: S101  a pipe, as requested
        if not await process.stdout.readline():
            raise BadInputError("hw_sim gige", f"ended with status {await process.wait()}")
        yield Hardware(process, addresses)
    finally:
        if process.returncode is None:
            process.terminate()
        output, _ = await process.communicate()
        print(f"Cameras: {output.decode().strip()}", flush=True)
