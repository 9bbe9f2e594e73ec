"""The calibration scan: the stage moves the beam from node to node, and the cameras' frames are kept.

A flat made with the laser (``calibration.laser_flat``) is a scan in steps smaller than the spot, which also
covers a margin around the grid: there the spot may be incomplete.
"""

from __future__ import annotations

import asyncio
import math
from collections.abc import AsyncIterator, Callable, Mapping, Sequence
from contextlib import asynccontextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal, Protocol, TypeVar

from altd.acquisition.frame_sets import FrameSets
from altd.acquisition.scan.folder import DoneNode, ScanFolder
from altd.acquisition.scan.leds import KnownUnit, ScanLeds
from altd.acquisition.scan.plan import (
    Node,
    NodeSpots,
    Raster,
    SpotPx,
    fingerprint,
    judge,
    nodes_of,
)
from altd.config import Config
from altd.config.unit import target_headers, unit_header
from altd.errors import BadInputError
from altd.mapping.grid import GridPart
from altd.measuring.pairing import Pair
from altd.ports import CameraError, Lamps, LampsError, Stage, StageError, StageNotFoundError, Switches
from altd.recording.header import SelfCheckHeader, note_of
from altd.records import Frame
from altd.selfcheck.records import Verdict

Result = TypeVar("Result")

MAX_SHIFT_PX = 1.0
"""Maximum shift of a spot when a resumed scan exposes its last node again. After a larger shift, stage, laser
or cameras are no longer as before."""
MAX_LOST_IN_A_ROW = 10
"""Consecutive refused nodes that stop a flat: it can omit single nodes, but this many have another cause."""
_NODES_PER_COMMIT = 64
"""Nodes of a flat per commit: its state is long, and writing it each time takes longer than exposing."""


class ScanStoppedError(Exception):
    """The scan cannot continue; finished nodes are kept, and the message names the place and the reason."""


@dataclass(frozen=True, slots=True)
class ScanResult:
    """A finished scan: its exposures, and the nodes that it omits, each with the reason."""

    exposures: int
    refused: tuple[str, ...]


class ProgressReporter(Protocol):
    """Receives the progress of the scan."""

    def report(self, line: str) -> None:
        """Report a message to be kept after the scan."""

    def progress(self, done: int, total: int, doing: str) -> None:
        """Report the finished nodes, the total of nodes, and the current step."""


class Scanner:
    """One scan. The caller chooses the cameras of ``frame_sets``, ``stage``, ``leds`` and ``switches``.

    The cameras' exposure stays constant from node to node. With ``switches`` each target is shown in turn at
    each node, and only its own camera's frames are kept.
    """

    def __init__(  # noqa: PLR0913  the parts of a scan
        self,
        config: Config,
        output: Path,
        frame_sets: FrameSets,
        stage: Stage,
        leds: ScanLeds | None,
        progress: ProgressReporter,
        switches: Switches | None = None,
    ) -> None:
        """Raises BadInputError if ``output`` is in use or contains the beginning of another scan."""
        self._config = config.scan
        self._raster = config.scan if isinstance(config.scan, Raster) else None
        self._lost_in_a_row = 0
        self._stage = stage
        self._leds = leds
        self._switches = switches
        self._targets = config.targets
        self._glass_settle_s = config.switches.settle_s if config.switches else 0.0
        self._clock = frame_sets.clock
        self._progress = progress
        self._nodes = nodes_of(config.scan)
        self._unit = unit_header(config.unit.serial, config.targets)
        self._cameras = frame_sets.cameras
        self._folder = ScanFolder(
            output,
            fingerprint(config),
            self._clock.utc,
            self._cameras,
            target_headers(config.targets),
            config.scan,
        )
        self._frame_sets = frame_sets
        self._doing = "getting ready"

    async def run(self) -> ScanResult:
        """Scan to the end, or resume an interrupted scan.

        Cancellation stops the stage; nodes kept until then remain. Raises ScanStoppedError, BadInputError
        for a missing stage, and a camera driver's own failure.
        """
        try:
            lamps = self._leds.lamps if self._leds else None
            async with (
                self._frame_sets,
                self._ready_stage(),
                self._ready("lamps", lamps),
                self._ready("switches", self._switches),
            ):
                await self._scan()
                return self._finished()
        except StageNotFoundError as error:
            raise BadInputError("[stage] device", str(error)) from error
        except (StageError, CameraError, LampsError) as error:
            raise ScanStoppedError(f"{self._doing}: {error}") from error
        except OSError as error:
            raise ScanStoppedError(f"{self._folder.path}: {error.strerror or error}") from error
        finally:
            self._folder.close()

    async def _scan(self) -> None:
        state = self._folder.state
        if self._leds is None and self._config.led_pairs:
            self._progress.report("no lamps are configured: the scan has no LED reference pairs")
        if self._folder.resumed:
            self._progress.report(
                f"going on with {self._folder.path}: {len(state.nodes)} of {len(self._nodes)} nodes are done"
            )
            state.refused.clear()  # they are tried again
            await self._check_nothing_moved()
        await self._led_pairs("before")
        for node in self._nodes:
            if _key(node) not in state.nodes:
                await self._expose(node)
        await self._led_pairs("after")

    @asynccontextmanager
    async def _ready_stage(self) -> AsyncIterator[None]:
        """Wait for the cameras, then open and home the stage; release it at the end."""
        self._show_progress("waiting for the cameras")
        await self._frame_sets.after(self._clock.monotonic_ns(), 1)
        try:
            self._show_progress("opening the stage")
            await self._in_thread(self._stage.open)
            self._show_progress("homing the stage")
            await self._in_thread(self._stage.home)
            yield
        finally:
            await asyncio.shield(asyncio.to_thread(self._stage.close))

    @asynccontextmanager
    async def _ready(self, name: str, lamps: Lamps | Switches | None) -> AsyncIterator[None]:
        """Open lamps or switches without voltage; release them without voltage at the end."""
        if lamps is None:
            yield
            return
        try:
            self._show_progress(f"opening the {name}")
            await self._in_thread(lamps.open)
            yield
        finally:
            await asyncio.shield(asyncio.to_thread(lamps.close))

    async def _expose(self, node: Node) -> None:
        """Move to a node and keep its exposures, or refuse it after the configured retries."""
        self._show_progress(f"node {node}")
        await self._go(node.x_mm, node.y_mm)
        position_mm = await self._in_thread(self._stage.position)
        state, raster, complaint = self._folder.state, self._raster, ""
        for _ in range(1 + self._config.retries):
            exposures = await self._of_all_targets(self._config.exposures)
            judged = judge(exposures)
            if isinstance(judged, NodeSpots) or (raster is not None and raster.is_margin(node)):
                self._folder.keep(exposures, self._unit, note_of("altd scan", self._cameras), position_mm)
                spots_px = dict(judged.px) if isinstance(judged, NodeSpots) else {}
                state.nodes[_key(node)] = DoneNode(position_mm=position_mm, spots_px=spots_px)
                state.refused.pop(_key(node), None)
                self._lost_in_a_row = 0 if spots_px else self._lost_in_a_row
                if raster is None or len(state.nodes) % _NODES_PER_COMMIT == 0:
                    self._folder.commit()
                return
            complaint = judged.complaint
        state.refused[_key(node)] = complaint
        self._folder.commit()
        self._progress.report(f"node {node} refused: {complaint}")
        self._lost_in_a_row += 1
        if raster is None:
            self._check_sufficient(node, complaint)
        elif self._lost_in_a_row >= MAX_LOST_IN_A_ROW:
            raise ScanStoppedError(
                f"{self._lost_in_a_row} nodes in a row are refused; the last one, {node}: {complaint}"
            )

    def _check_sufficient(self, node: Node, complaint: str) -> None:
        """Raise ScanStoppedError if the nodes that are not refused cannot suffice."""
        state = self._folder.state
        refused = [n for n in self._nodes if _key(n) in state.refused and _key(n) not in state.nodes]
        left = GridPart.within(*([(n.column, n.row) for n in nodes] for nodes in (self._nodes, refused)))
        if not left.is_sufficient:
            raise ScanStoppedError(
                f"{len(refused)} of {len(self._nodes)} nodes are refused, the others do not form a "
                f"sufficient grid; the last one, {node}: {complaint}"
            )

    async def _led_pairs(self, when: Literal["before", "after"]) -> None:
        """Record reference exposures with the beam at the grid's centre, LEDs off and on in turn.

        The pairs before the grid are a self-check; raises ScanStoppedError if it forbids the scan.
        """
        leds, state = self._leds, self._folder.state
        if leds is None or not self._config.led_pairs or when in state.led_pairs:
            return
        self._show_progress(f"LED reference {when} the grid")
        await self._go(self._config.centre_x_mm, self._config.centre_y_mm)
        kept: list[Pair[Frame]] = []
        try:
            for on in (False, True) * self._config.led_pairs:
                await self._in_thread(leds.lamps.switch, on)
                (pair,) = await self._settled(1)
                lit = {name: replace(frame, leds_on=on) for name, frame in pair.items.items()}
                kept.append(replace(pair, items=lit))
        finally:
            await asyncio.shield(asyncio.to_thread(leds.lamps.switch, False))
        if when == "before":
            await self._self_check(leds.known, kept)
        self._folder.keep(kept, self._unit, note_of("altd scan", self._cameras), None)
        state.led_pairs.append(when)
        self._folder.commit()

    async def _self_check(self, known: KnownUnit | str, pairs: Sequence[Pair[Frame]]) -> None:
        """Report the self-check; raise ScanStoppedError for a bad verdict with ``when_bad = "stop"``."""
        if isinstance(known, str):
            self._progress.report(f"no self-check: {known}")
            return
        check = await asyncio.to_thread(known.check, pairs, self._cameras)
        if check.verdict is Verdict.BAD and self._config.when_bad == "stop":
            raise ScanStoppedError(
                f"the self-check is {check.sentence}. Put right what has moved; to calibrate the unit as it "
                'is now, set [scan] when_bad = "warning"'
            )
        self._progress.report(f"self-check: {check.sentence}")
        self._folder.state.self_check = SelfCheckHeader(
            verdict=check.verdict.value, reasons=check.reasons, notes=check.notes
        )

    async def _check_nothing_moved(self) -> None:
        """Raise ScanStoppedError if the spots of the last node with spots have moved."""
        done = {key: node for key, node in self._folder.state.nodes.items() if node.spots_px}
        if not done:
            return
        node = next(n for n in self._nodes if _key(n) == list(done)[-1])
        self._show_progress(f"looking at node {node} again")
        await self._go(node.x_mm, node.y_mm)
        judged = judge(await self._of_all_targets(self._config.exposures))
        if not isinstance(judged, NodeSpots):
            raise ScanStoppedError(f"node {node}, which was good, is not any more: {judged.complaint}")
        shift_px, camera = _largest_shift(done[_key(node)].spots_px, judged.px)
        if shift_px > MAX_SHIFT_PX:
            raise ScanStoppedError(
                f"node {node}: the {camera} spot lies {shift_px:.1f} px from where it was before the "
                f"interruption; the stage has another zero, or something was moved. Put it right, or remove "
                f"{self._folder.path} to scan again"
            )

    async def _go(self, x_mm: float, y_mm: float) -> None:
        await self._in_thread(self._stage.move_to, x_mm, y_mm)

    async def _of_all_targets(self, count: int) -> list[Pair[Frame]]:
        """Return ``count`` exposures of each target: all at once, or with switches one target at a time."""
        if self._switches is None:
            return await self._settled(count)
        exposures: list[Pair[Frame]] = []
        for target in self._targets:
            await self._in_thread(self._switches.show, target.name)
            await self._clock.sleep(self._glass_settle_s)
            of_target = await self._settled(count)
            exposures += [
                replace(pair, items={target.camera: pair.items[target.camera]}) for pair in of_target
            ]
        return exposures

    async def _settled(self, count: int) -> list[Pair[Frame]]:
        """Return ``count`` exposures that begin after stage and lamps have settled."""
        await self._clock.sleep(self._config.settle_s)
        return await self._frame_sets.after(self._clock.monotonic_ns(), count)

    def _finished(self) -> ScanResult:
        state = self._folder.state
        self._folder.finish()
        refused = {_key(node): node for node in self._nodes if _key(node) not in state.nodes}
        return ScanResult(
            state.exposures, tuple(f"node {node}: {state.refused[key]}" for key, node in refused.items())
        )

    def _show_progress(self, doing: str) -> None:
        self._doing = doing
        self._progress.progress(len(self._folder.state.nodes), len(self._nodes), doing)

    async def _in_thread(self, call: Callable[..., Result], *arguments: object) -> Result:
        """Make a blocking call; cancellation stops the stage and waits until the call has ended."""
        work = asyncio.ensure_future(asyncio.to_thread(call, *arguments))
        try:
            return await asyncio.shield(work)
        except asyncio.CancelledError:
            self._stage.stop()
            await asyncio.wait({work})
            work.exception()  # retrieve the failure that the stop caused
            raise


def _key(node: Node) -> str:
    """Return the name of a node in ``scan.json``."""
    return f"{node.column},{node.row}"


def _largest_shift(before: Mapping[str, SpotPx], now: Mapping[str, SpotPx]) -> tuple[float, str]:
    """Return the largest shift between two measurements of the same spots, px, and its camera."""
    return max((math.dist(before[camera], now[camera]), camera) for camera in before)
