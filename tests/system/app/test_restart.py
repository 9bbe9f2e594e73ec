"""A daemon that is started again reports it, on every wire that a reader checks."""

import json
import subprocess
import time
import urllib.request
import zlib
from pathlib import Path

from support import proof_code
from support.block_clients import TcpClient
from support.played_unit import PlayedUnit, PlayingDaemon, playing


def _said(daemon: PlayingDaemon) -> tuple[bytes, bytes, dict[str, object]]:
    daemon.wait_until_valid()
    client = TcpClient(daemon.modbus)
    block = client.ask(5.0)
    client.close()
    assert block is not None
    at = f"http://127.0.0.1:{daemon.http}/api"
    with urllib.request.urlopen(f"{at}/measurement", timeout=5) as answer:
        line = answer.read()
    with urllib.request.urlopen(f"{at}/status", timeout=5) as answer:
        return block, line, json.load(answer)


def test_after_a_restart_the_reader_is_told_until_it_begins_anew(
    played_unit: PlayedUnit, tmp_path: Path
) -> None:
    said = []
    for _ in range(2):
        with playing(played_unit, tmp_path, subprocess.DEVNULL) as daemon:
            said.append(_said(daemon))
    code = proof_code.python()
    unit = zlib.crc32(str(said[0][2]["serial"]).encode())
    assert [status["unit_number"] for _, _, status in said] == [f"{unit:08X}"] * 2
    blocks = [code.from_block(block) for block, _, _ in said]
    objects = [code.from_json(line) for _, line, _ in said]
    for messages in (blocks, objects):
        check, now_s = code.Check(unit, 60.0), time.monotonic()
        faults = [check.fault(message, now_s) for message in (messages[0], messages[1], messages[1])]
        assert faults == ["not valid", "restarted", "restarted"], "a recording is played"
        assert code.Check(unit, 60.0).fault(messages[1], now_s) == "not valid"
    assert [f"{block['session']:08X}" for block in blocks] == [told["session"] for told in objects]
