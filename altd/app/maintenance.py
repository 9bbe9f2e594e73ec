"""Monitors of the daemon that request maintenance before a failure."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping

from altd.acquisition.temperatures import CameraThermometer, watch_temperature
from altd.app.parts import AnyCalibration
from altd.config import Config
from altd.ports import Camera, Clock, TemperatureCamera, Thermometer
from altd.status.health import Health
from altd.status.maintenance import CalibrationAge, SpotTrends, TemperatureLimits, Temperatures
from altd.status.state import Watch


class MaintenanceWatches:
    """The watches of one unit's state, and their data sources."""

    def __init__(
        self,
        config: Config,
        calibration: AnyCalibration,
        cameras: Mapping[str, Camera],
        health: Health,
        clock: Clock,
    ) -> None:
        self._health = health
        self._thermometer_of_frame = config.installation.thermometer
        self._clock = clock
        self._thermometers: list[Thermometer] = []
        limits: dict[str, TemperatureLimits] = {}
        for settings in config.thermometers:
            self._thermometers.append(settings.thermometer())
            limits[settings.name] = TemperatureLimits(settings.min_celsius, settings.max_celsius)
        for name, camera in cameras.items():
            of_camera = config.cameras.get(name)
            within = None if of_camera is None else of_camera.celsius_limits
            if isinstance(camera, TemperatureCamera) and within is not None:
                inside = CameraThermometer(camera)
                self._thermometers.append(inside)
                limits[inside.name] = TemperatureLimits(*within)
        self.trends = SpotTrends(
            {target.camera: target.name for target in config.targets}, config.maintenance
        )
        self.watches: tuple[Watch, ...] = (
            CalibrationAge(calibration.created, config.maintenance.calibration_due_days, clock.utc),
            Temperatures(limits, health.component),
            self.trends,
        )

    def frame_celsius(self) -> float | None:
        """Return the temperature of the frame, °C; None: not known."""
        if self._thermometer_of_frame is None:
            return None
        celsius = self._health.component(f"temperature {self._thermometer_of_frame}").figures.get("celsius")
        return celsius if isinstance(celsius, float) else None

    def start(self, tasks: asyncio.TaskGroup) -> None:
        """Read the thermometers until cancelled."""
        for thermometer in self._thermometers:
            component = self._health.component(f"temperature {thermometer.name}")
            watching = watch_temperature(thermometer, component, self._clock)
            tasks.create_task(watching, name=component.name)
