from __future__ import annotations

import asyncio
from dataclasses import replace
from itertools import pairwise

import pytest
from support.clock import FakeClock, settle, stop
from support.measurements import measurement

from altd.ports import Indicator
from altd.records import Fault, Measurement, Reason
from altd.service.board import Board
from altd.service.health import Health, State
from altd.service.indicators import TICK_S, DataFlash, IndicatorPanel

DARK, STEADY, BLINKS = 0.0, 1.0, 0.5
