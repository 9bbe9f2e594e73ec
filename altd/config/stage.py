"""The xy stage and the grid of `altd scan`."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from altd.config.table import Device, StageMillimetres, Table


class GrblStageSettings(Table):
    """The xy stage of `altd scan`: a Grbl 1.1 controller on a serial port.

    In the controller's coordinates the stage is sent to sign · position + offset.
    """

    driver: Literal["grbl"]
    """The only driver of this release."""
    device: Device
    """The port, best by its stable name, such as /dev/serial/by-id/…"""
    baud: Literal[9600, 19200, 38400, 57600, 115200, 230400] = 115200
    """Bits per second."""
    start: Literal["home", "unlock"] = "home"
    """``home`` runs to the limit switches each time (`$H`); ``unlock`` takes the position that the controller
    has (`$X` when it is locked), for a stage without switches whose zero was set by hand."""
    coordinates: Literal["work", "machine"] = "work"
    """Whose zero counts: that of the work coordinates in use (G54) or the machine's."""
    sign_x: Literal[-1, 1] = 1
    """-1 where the stage's axis runs against the unit's, or the stage carries the unit and not the laser."""
    sign_y: Literal[-1, 1] = 1
    offset_x_mm: StageMillimetres = 0.0
    """The controller's x where the beam meets x = 0 of the unit frame."""
    offset_y_mm: StageMillimetres = 0.0
    feed_mm_per_min: Annotated[float, Field(gt=0, le=100_000)] = 1000.0
    """Speed; the controller keeps its own limits."""
    answer_within_s: Annotated[float, Field(ge=0.1, le=60)] = 2.0
    """A command that is not answered for this long is sent again, twice."""
    home_within_s: Annotated[float, Field(ge=1, le=3600)] = 120.0
    """Longest time that homing may take."""


class Scan(Table):
    """The grid of `altd scan` and what is exposed at its nodes."""

    columns: Annotated[int, Field(ge=4, le=64)] = 6
    """Nodes along x."""
    rows: Annotated[int, Field(ge=4, le=64)] = 5
    """Nodes along y."""
    pitch_mm: Annotated[float, Field(ge=1, le=1000)] = 28.0
    """Distance from node to node. 6 × 5 nodes at 28 mm hold the 140 × 110 mm that the unit measures."""
    centre_x_mm: StageMillimetres = 0.0
    """The middle of the grid in the unit frame."""
    centre_y_mm: StageMillimetres = 0.0
    order: Literal["serpentine", "rows"] = "serpentine"
    """``serpentine`` runs to and fro, the shortest way; ``rows`` begins each row at the smallest x, so that a
    stage with play comes to every node from the same side."""
    exposures: Annotated[int, Field(ge=1, le=100)] = 2
    """Exposures a node."""
    settle_s: Annotated[float, Field(ge=0, le=60)] = 0.5
    """Time from standstill, or from switching the LEDs, until exposures count."""
    led_pairs: Annotated[int, Field(ge=0, le=100)] = 2
    """LED reference pairs (off, on) before the grid, and as many after it. Those before it are a self-check
    against the calibration so far."""
    when_bad: Literal["stop", "warning"] = "stop"
    """What follows where that self-check is bad; ``warning`` calibrates the unit as it stands now."""
    retries: Annotated[int, Field(ge=0, le=100)] = 2
    """How often a node with a bad spot is exposed again before it is refused."""
