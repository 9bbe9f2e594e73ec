"""The lamps without the daemon: for a technician who tries them, and for systemd once the daemon ended."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

from altd.ports import Indicator, Indicators, Lamps, LampsError

LIT_INTERVAL_S = 1.0
"""Duration of each lamp of the test."""


class LampsByHand:
    """The lamps of one config; None: it has none of that kind. ``fitted``: the indicators that have a line.

    Every method raises LampsError; what is lit then is dark again.
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
        """Only these lit, left so when the process ends, as far as the chip keeps it; the frame LEDs dark.

        What cannot be had does not keep the rest from it.
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
        """Each lamp for a second, with its name; then all dark."""
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
        """All lit; dark again once ``interrupted`` returns, or a signal is raised."""
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
