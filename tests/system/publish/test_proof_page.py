"""The code on the page about checking, against what the unit sends and its errors."""

import random
import re
import struct
import subprocess
from dataclasses import replace
from datetime import UTC, datetime

import pytest
from support import proof_code
from support.clock import FakeClock
from support.foreign import need_program
from support.measurements import measurement
from support.places import DOCS
from support.scripted_unit import SESSION, UNIT, block, flipped

from altd.publish.modbus.checked_block import ROWS, CheckedBlock
from altd.publish.serial.telegram import PROOF, encode, with_proof
from altd.reasons import Reason
from altd.status.board import Board
from altd.status.measurement_json import PROOF_KEYS, checked_line
from altd.status.proof import Identity, Stamp
from tools.pages import proof as page
from tools.pages.example import view_of

LIMIT_MS = 500
MEASURED = measurement()


def judge(said: list[tuple[int, bytes]]) -> list[str]:
    """The faults of blocks that came at these ms of the reader's clock."""
    page = proof_code.python()
    check = page.Check(UNIT, LIMIT_MS / 1000)
    return [check.fault(page.from_block(sent), now_ms / 1000) for now_ms, sent in said]


def test_the_page_in_docs_is_the_generated_one() -> None:
    assert (DOCS / "proof.md").read_text() == page.page(), "run: make pages"


def test_the_page_names_every_register_field_and_key() -> None:
    text = page.page()
    for row in ROWS:
        assert re.search(rf"^\|.*\b{row.address}\b.*\|.*`{row.name}`", text, re.MULTILINE)
    assert all(f"`{field.name}`" in text for field in PROOF.fields)
    assert all(f"`{key}`" in text for key in PROOF_KEYS)


def test_each_error_is_told_and_what_follows_is_good_again() -> None:
    said = [
        (0, block(1), ""),
        (100, block(1), "not newer"),
        (200, block(3), ""),
        (250, block(2), "not newer"),
        (300, flipped(block(4), 491), "corrupt"),
        (310, bytes(160), "corrupt"),
        (320, b"\xff" * 160, "corrupt"),
        (400, block(5, unit=UNIT + 1), "foreign"),
        (500, block(6, session=SESSION + 1), "restarted"),
        (600, block(1, 20, session=SESSION + 1), "restarted"),
        (700, block(7, age_ms=501), "late"),
        (800, block(8, age_ms=None, of=None), "not valid"),
        (900, block(9, of=measurement(160, 0, Reason.SPOT_MISSING)), "not valid"),
        (1000, block(10, of=measurement(160, 0, Reason.PLAYBACK)), "not valid"),
        (1100, block(11, of=measurement(160, 0, Reason.SIMULATED)), "not valid"),
        (1200, block(12, 8200), ""),
    ]
    assert judge([(now_ms, sent) for now_ms, sent, _ in said]) == [fault for _, _, fault in said]


def test_what_a_queue_holds_back_is_late_until_the_queue_is_empty() -> None:
    """A gateway that begins to hand out each answer five polls late: fresh by its age, old by the clocks."""
    said = [(100 * n, block(n)) for n in range(1, 11)]
    said += [(100 * n, block(n - 5)) for n in range(16, 30)]
    said += [(100 * n, block(n)) for n in range(30, 33)]
    assert judge(said) == [""] * 10 + ["late"] * 14 + [""] * 3


def test_clocks_that_differ_by_100_ppm_make_nothing_late_in_a_day() -> None:
    for ppm in (100, -100):
        said = [
            (n * 60_000, block(n, round(n * 60_000 * (1 + ppm * 1e-6)), 490)) for n in range(1, 1440, 180)
        ]
        assert set(judge(said)) == {""}


def test_counters_wrap() -> None:
    top = 0xFFFF_FFFE
    said = [
        (top - 1000 + n * 500, block((top - 2 + n) % (top + 1), (top - 900 + n * 500) % (top + 1)))
        for n in range(6)
    ]
    assert judge(said) == [""] * 6


def test_any_corruption_of_a_block_is_found() -> None:
    chance = random.Random(1)
    good = block(2)
    said = [(0, block(1))]
    for _ in range(30):
        places = chance.sample(range(1280), chance.choice((1, 1, 2, 3, 9, 600)))
        said.append((100, flipped(good, *places)))
    assert judge([*said, (100, good)]) == ["", *["corrupt"] * 30, ""]


def test_javascript_computes_the_crc_of_the_object_as_the_page_says(board: Board) -> None:
    board.publish(MEASURED)
    line = checked_line(board, MEASURED, Stamp(Identity(UNIT, SESSION), 5, 120))
    covered = 'text.slice(0, text.lastIndexOf(\', "crc32": "\'))'
    assert f"`{covered}`" in page.page()
    script = f"""
        const text = require("fs").readFileSync(0, "ascii");
        let crc = 0xFFFFFFFF;
        for (const sign of {covered}) {{
          crc ^= sign.charCodeAt(0);
          for (let bit = 0; bit < 8; bit++) crc = (crc >>> 1) ^ (crc & 1 ? 0xEDB88320 : 0);
        }}
        console.log((~crc >>> 0).toString(16).toUpperCase().padStart(8, "0") === JSON.parse(text).crc32);
    """
    command = [need_program("node", "nodejs"), "-e", script]
    told = subprocess.run(command, input=line, check=True, capture_output=True, text=True, timeout=20)
    assert told.stdout == "true\n"


class TestPython:
    """The cases that only the Python of the page reads."""

    now = datetime(2026, 11, 20, 8, 15, 30, 125_000, UTC)
    measured = replace(MEASURED, time=now)

    def test_the_three_wires_say_the_same_of_one_measurement(self, clock: FakeClock, board: Board) -> None:
        code = proof_code.python()
        board.publish(replace(self.measured, t_ns=clock.now_ns))
        clock.now_ns += 120_000_000
        stamp = Stamp(Identity(UNIT, SESSION), 5, 120)
        told = [
            code.from_block(struct.pack(">80H", *CheckedBlock().at(view_of(self.measured, 0.12, 1, stamp)))),
            code.from_telegram(with_proof(encode(self.measured), self.measured, stamp, 0.12)),
            code.from_json(checked_line(board, self.measured, stamp).encode()),
        ]
        for message in told:
            assert (message["unit"], message["message"], message["clock_ms"]) == (UNIT, 5, 120)
            assert message["utc_s"] == pytest.approx(self.now.timestamp(), abs=1e-6)
            assert (message["age_s"], message["valid"]) == (0.12, True)

    def test_what_is_not_live_is_not_valid_on_any_wire(self, board: Board) -> None:
        code = proof_code.python()
        stamp = Stamp(Identity(UNIT, SESSION), 5, 120)
        for reason in (Reason.PLAYBACK, Reason.SIMULATED, Reason.SPOT_MISSING):
            shown = measurement(160, 8_000_000_000, reason)
            board.publish(shown)
            assert not code.from_telegram(with_proof(encode(shown), shown, stamp, 0.12))["valid"]
            assert not code.from_json(checked_line(board, shown, stamp).encode())["valid"]

    @pytest.mark.parametrize("wire", ["telegram", "json"])
    def test_one_wrong_bit_anywhere_is_found(self, wire: str, board: Board) -> None:
        code = proof_code.python()
        board.publish(self.measured)
        stamp = Stamp(Identity(UNIT, SESSION), 5, 120)
        if wire == "telegram":
            good, read = with_proof(encode(self.measured), self.measured, stamp, 0.12), code.from_telegram
        else:
            good, read = checked_line(board, self.measured, stamp).encode(), code.from_json
        assert read(good) is not None
        for bit in range(8 * len(good)):
            spoilt = bytearray(good)
            spoilt[bit // 8] ^= 1 << bit % 8
            assert read(bytes(spoilt)) is None
        for length in range(len(good)):
            assert read(good[:length]) is None

    def test_before_the_first_measurement_and_without_its_sentence_nothing_passes(self) -> None:
        code = proof_code.python()
        check = code.Check(UNIT, 0.5)
        stamp = Stamp(Identity(UNIT, SESSION), 5, 120)
        unmeasured = with_proof(encode(None), None, stamp, None)
        assert check.fault(code.from_telegram(unmeasured), 0.0) == "not valid"
        assert check.fault(code.from_telegram(encode(self.measured)), 0.0) == "corrupt"

    @pytest.mark.parametrize(("late_s", "fault"), [(0.4, ""), (0.6, "late"), (-0.05, ""), (-0.2, "late")])
    def test_a_synchronised_reader_finds_what_was_late_from_the_first_message_on(
        self, late_s: float, fault: str
    ) -> None:
        code = proof_code.python()
        message = code.from_block(block(1, 0, 0, of=self.measured))
        assert code.Check(UNIT, 0.5).fault(message, 0.0, self.now.timestamp() + late_s) == fault

    def test_a_synchronised_reader_takes_nothing_without_time(self) -> None:
        code = proof_code.python()
        message = code.from_block(block(1, 0, 0, of=replace(MEASURED, time=None)))
        assert code.Check(UNIT, 0.5).fault(message, 0.0, self.now.timestamp()) == "late"
        assert code.Check(UNIT, 0.5).fault(message, 0.0) == ""

    def test_lost_messages_are_counted(self) -> None:
        code = proof_code.python()
        check = code.Check(UNIT, 0.5)
        lost = []
        for message in (1, 2, 5, 6):
            telegram = with_proof(encode(MEASURED), MEASURED, Stamp(Identity(UNIT, 7), message, message), 0.1)
            assert check.fault(code.from_telegram(telegram), message / 1000) == ""
            lost.append(check.lost)
        assert lost == [0, 0, 2, 0]
