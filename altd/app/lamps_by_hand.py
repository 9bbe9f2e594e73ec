"""Switching of lamps without the daemon: for a technician's tests, and for systemd after the daemon ended."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

from altd.ports import Indicator, Indicators, Lamps, LampsError

LIT_INTERVAL_S = 1.0
"""Duration for which each lamp is lit in the test."""


class LampsByHand:
    """The lamps of one config; None: it has none of that kind. ``fitted``: the indicators that have a line.

    Every method may raise LampsError; ``light_in_turn`` and ``light_until`` darken all lamps at the end.
    """

    def __init__(
        self,
        lamps: Lamps | None,
        indicators: Indicators | None,
        fitted: Sequence[Indicator],
        report: Callable[[str], None],
    ) -> None:
        self._lamps = lamps
        self._indicators = indicators
        self._fitted = fitted
        self._report = report

    def leave_lit(self, lit: frozenset[Indicator]) -> None:
        """Light only these indicators, and leave them lit at exit if the chip can; darken the frame LEDs.

        A failure of one kind of lamps does not prevent the switching of the other.
        """
        complaints = []
        try:
            if self._indicators is not None:
                self._indicators.open()
                self._indicators.show(lit)
        except LampsError as error:
            complaints.append(str(error))
        try:
            if self._lamps is not None:
                self._lamps.open()
                self._lamps.close()
        except LampsError as error:
            complaints.append(str(error))
        if complaints:
            raise LampsError("; ".join(complaints))

    def light_in_turn(self) -> None:
        """Light each lamp for ``LIT_INTERVAL_S`` and report its name; then darken all."""
        with self._opened():
            if self._indicators is not None:
                for indicator in self._fitted:
                    self._report(f"indicator {indicator}")
                    self._indicators.show(frozenset({indicator}))
                    time.sleep(LIT_INTERVAL_S)
                self._indicators.show(frozenset())
            if self._lamps is not None:
                self._report("frame LEDs")
                self._lamps.switch(True)
                time.sleep(LIT_INTERVAL_S)

    def light_until(self, interrupted: Callable[[], object]) -> None:
        """Light all lamps; darken them when ``interrupted`` returns or raises."""
        with self._opened():
            if self._indicators is not None:
                self._indicators.show(frozenset(Indicator))
            if self._lamps is not None:
                self._lamps.switch(True)
            self._report("all are lit; Ctrl-C darkens them")
            interrupted()

    @contextmanager
    def _opened(self) -> Iterator[None]:
        try:
            for driver in (self._indicators, self._lamps):
                if driver is not None:
                    driver.open()
            yield
        finally:
            for driver in (self._indicators, self._lamps):
                if driver is not None:
                    driver.close()
