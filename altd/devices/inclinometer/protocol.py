"""A question over Modbus RTU and its answer, as bytes; what is no answer is named for what it is. No I/O.

pymodbus builds the request, computes the CRC and reads the answer; ``docs/decisions/0035-inclinometer.md``
says why its client is not used.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from pymodbus.framer import FramerRTU
from pymodbus.pdu import DecodePDU, ModbusPDU
from pymodbus.pdu.register_message import ReadHoldingRegistersRequest, ReadInputRegistersRequest

from altd.devices.inclinometer.registers import HOLDING, INPUT
from altd.ports import InclinometerDisturbedError, InclinometerTimeoutError, InclinometerWrongError

_EXCEPTION = 0x80
_FRAME_BYTES = 5
"""Of an answer without its registers: address, function, count of bytes, CRC. An exception is as long."""

_REQUESTS: dict[int, Callable[..., ModbusPDU]] = {
    HOLDING: ReadHoldingRegistersRequest,
    INPUT: ReadInputRegistersRequest,
}
_DECODER = DecodePDU(False)


@dataclass(frozen=True, slots=True)
class Question:
    """For ``count`` registers from ``first`` on of the sensor at a Modbus address."""

    address: int
    function: int
    first: int
    count: int

    @property
    def frame(self) -> bytes:
        """The question as it is sent."""
        request = _REQUESTS[self.function](address=self.first, count=self.count)
        frame = bytes([self.address, self.function]) + request.encode()
        return frame + FramerRTU.compute_CRC(frame).to_bytes(2, "big")

    @property
    def answer_bytes(self) -> int:
        """How long its answer is."""
        return _FRAME_BYTES + 2 * self.count

    def registers(self, heard: bytes, place: str) -> list[int]:
        """The registers in all that was heard after the question, up to the next silence.

        An adapter that hears what it sends puts the question before the answer. Raises
        InclinometerTimeoutError, …DisturbedError or …WrongError that names ``place``.
        """
        answer = heard.removeprefix(self.frame)
        if not answer:
            why = "the line gives back what is sent, and no sensor answers" if heard else "no answer"
            raise InclinometerTimeoutError(f"{why}: {place}")
        if len(answer) < _FRAME_BYTES or not _has_good_crc(answer):
            raise InclinometerDisturbedError(f"damaged answer (CRC), {len(answer)} bytes: {place}")
        if answer[0] != self.address:
            raise InclinometerDisturbedError(f"address {answer[0]} answers in place of {place}")
        if answer[1] == self.function | _EXCEPTION and len(answer) == _FRAME_BYTES:
            what = f"refuses function {self.function}, register {self.first} (exception {answer[2]})"
            raise InclinometerWrongError(f"it is another sensor: it {what}: {place}")
        if answer[1:3] != bytes([self.function, 2 * self.count]) or len(answer) != self.answer_bytes:
            raise InclinometerDisturbedError(f"an answer to another question: {place}")
        return list(getattr(_DECODER.decode(answer[1:-2]), "registers"))  # noqa: B009  of its subclasses


def _has_good_crc(frame: bytes) -> bool:
    return FramerRTU.check_CRC(frame[:-2], int.from_bytes(frame[-2:], "big"))
