"""Answers of a Grbl controller, line by line."""

import pytest
from support.grbl_conversation import CONVERSATION

from altd.devices.grbl import protocol


@pytest.mark.parametrize(
    ("line", "reply"),
    [
        ("ok", protocol.Ok()),
        ("error:9", protocol.Refusal(9)),
        ("ALARM:2", protocol.Alarm(2)),
        ("Grbl 1.1h ['$' for help]", protocol.Welcome((1, 1), "Grbl 1.1h ['$' for help]")),
        ("$13=0", protocol.GrblSetting(13, 0.0)),
        ("[MSG:Caution: Unlocked]", protocol.Message("[MSG:Caution: Unlocked]")),
        (">G54G20:ok", protocol.Message(">G54G20:ok")),
        (
            "<Idle|MPos:0.000,-10.000,5.000|FS:0.0,0|Pn:XYZ|WCO:0.000,1.551,5.664>",
            protocol.StatusReport("Idle", (0.0, -10.0), None, (0.0, 1.551)),
        ),
        (
            "<Hold:1|WPos:-2.500,0.000,11.000|Bf:15,128|Ov:100,100,100|A:SFM>",
            protocol.StatusReport("Hold", None, (-2.5, 0.0)),
        ),
        ("<Idle|MPos:0.000,-10.000,5.000|FS:0.0,0", None),
        ("<Idle|MPos:0.0x0,-10.000,5.000|FS:0.0,0>", None),
        ("<Idle|FS:0.0,0>", None),
        ("<Idel|MPos:0.000,-10.000,5.000>", None),
        ("oj", None),
        ("error:", None),
        ("", None),
        (f"$110={'9' * 400}", None),
        (f"<Idle|MPos:{'9' * 400}.000,0.000,0.000>", None),
        (f"Grbl {'1' * 4301}.1 ['$' for help]", None),
    ],
)  # fmt: skip
def test_what_grbl_says_is_understood_and_noise_is_not(line: str, reply: protocol.Reply | None) -> None:
    assert protocol.parse(line) == reply


def test_every_line_that_grbl_has_said_is_understood() -> None:
    lines = {line.replace("*", "1.500,-2.000,0.000") for _, _, lines in CONVERSATION for line in lines}
    assert len(lines) > 20
    assert [line for line in lines if protocol.parse(line) is None] == []
