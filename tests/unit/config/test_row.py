"""The rules of switched targets, of a row and of a beam: each fault at its key, and nothing but it."""

from pathlib import Path

import pytest

from altd.app.settings import settings_of
from altd.config import Config
from altd.config.loading import config_of
from altd.devices.camera_lamps import CameraSwitchesSettings
from altd.devices.gpio import GpiodSwitchesSettings
from altd.errors import BadInputError

GPIOD = '[switches]\ndriver = "gpiod"\nchip = "pinctrl-bcm2711"\nlines = ["GLASS_1", "GLASS_2"]\n'
CAMERA = '[switches]\ndriver = "camera"\nline = "Line2"\n'
ROW = """\
[unit]
serial = "ROW-1"
calibration = "chain.json"
instrument = "chain"

[chain]
stable = ["t1"]
baseline = "baseline.json"

[[targets]]
name = "t1"
z_mm = 0.0
camera = "near"

[[targets]]
name = "t2"
z_mm = 15000.0
camera = "far"

[cameras.near]
driver = "aravis"
device = "192.168.77.20"
width = 640
height = 480
[cameras.near.exposure]
control = "fixed"

[cameras.far]
driver = "aravis"
device = "192.168.77.21"
width = 640
height = 480
[cameras.far.exposure]
control = "fixed"

"""


def loaded(text: str) -> Config:
    return config_of(text.encode(), Path("/etc/altd/altd.toml"))


def test_a_row_with_each_kind_of_switches() -> None:
    by_lines, by_cameras = loaded(ROW + GPIOD), loaded(ROW + CAMERA)
    assert isinstance(by_lines.switches, GpiodSwitchesSettings)
    assert by_cameras.switches == CameraSwitchesSettings(driver="camera", line="Line2")
    assert by_lines.chain is not None
    assert by_lines.chain.baseline == Path("/etc/altd/baseline.json")
    played = ROW.replace('driver = "aravis"', 'driver = "recording"\npath = "rounds"')
    for key in ("device", "width", "height", "[cameras.near.exposure]", "[cameras.far.exposure]", "control"):
        played = "\n".join(line for line in played.splitlines() if not line.startswith(key))
    assert loaded(played).switches is None


BEAM = (
    ROW.replace('instrument = "chain"\n\n[chain]\nstable = ["t1"]\nbaseline = "baseline.json"\n', "")
    .replace('"t1"\nz_mm = 0.0\n', '"front"\nz_mm = 0.0\nswitched = true\n')
    .replace('"t2"\nz_mm = 15000.0', '"rear"\nz_mm = 280.0')
)
ONE_LINE = GPIOD.replace(', "GLASS_2"', "")


@pytest.mark.parametrize("switches", [ONE_LINE + "exposures = 8\nsettle_s = 0.3\n", CAMERA])
def test_a_beam_with_a_switched_front_target(switches: str) -> None:
    config = loaded(BEAM + switches)
    assert [target.name for target in config.switched_targets] == ["front"]
    assert loaded(BEAM.replace("switched = true\n", "")).switched_targets == ()


def test_only_the_camera_of_a_switched_target_needs_an_output() -> None:
    far = '[cameras.far]\ndriver = "aravis"\ndevice = "192.168.77.21"'
    other = BEAM.replace(far, '[cameras.far]\ndriver = "v4l2"\ndevice = "/dev/video1"')
    assert loaded(other + CAMERA).switches is not None


def test_a_row_may_have_every_interface() -> None:
    others = '[opcua]\nport = 4841\n[http]\n[modbus_tcp]\n[mqtt]\nhost = "broker"\n'
    others += '[[serial]]\ndevice = "/dev/ttyS1"\nspeaks = "telegram"\n'
    of_row = loaded(ROW + GPIOD + others)
    assert of_row.opcua is not None
    assert of_row.opcua.port == 4841


@pytest.mark.parametrize(("baud", "is_refused"), [(9600, False), (1200, True)])
def test_the_interval_of_a_row_has_room_for_a_sentence_of_each_target(baud: int, is_refused: bool) -> None:
    """Three sentences of 82 characters take 2.05 s at 1200 baud, two take 1.37 s."""
    port = f'[[serial]]\ndevice = "/dev/ttyS1"\nspeaks = "telegram"\nbaud = {baud}\ninterval_s = 1.5\n'
    content = (ROW + GPIOD + port).encode()
    if not is_refused:
        settings_of(content, Path("/etc/altd/altd.toml"))
        return
    with pytest.raises(BadInputError, match=r"1.5 is too short at 1200 baud; possible: from 2.05"):
        settings_of(content, Path("/etc/altd/altd.toml"))


FAULTS = (
    (ROW, "", "", "switches: the glasses cannot be switched; possible: a table with driver"),
    (ROW + GPIOD, '"GLASS_1", ', "", "switches.lines: 1 line for 2 targets; possible: one for each"),
    (
        ROW + GPIOD,
        '"GLASS_2"',
        '"GLASS_1"',
        'switches.lines.1: "GLASS_1" is already the line of switches.lines.0',
    ),
    (
        ROW + CAMERA,
        '[cameras.far]\ndriver = "aravis"\ndevice = "192.168.77.21"',
        '[cameras.far]\ndriver = "v4l2"\ndevice = "/dev/video1"',
        'switches.driver: "far" has no output; possible: cameras with driver "aravis", or driver "gpiod"',
    ),
    (
        ROW + CAMERA,
        "[cameras.far.exposure]",
        'trigger = "line"\ntrigger_line = "Line2"\n[cameras.far.exposure]',
        'switches.line: "Line2" triggers camera "far"; possible: another line',
    ),
    (
        ROW + GPIOD,
        '[cameras.far.exposure]\ncontrol = "fixed"',
        '[cameras.far.exposure]\ncontrol = "auto"',
        'cameras.far.exposure.control: "auto" follows a spot; possible: "fixed", "camera"',
    ),
    (
        ROW + GPIOD,
        "[chain]",
        '[measuring]\noutput = "now"\n\n[chain]',
        'measuring.output: "now" is for a beam',
    ),
    (
        ROW + GPIOD,
        "[chain]",
        '[lamps]\ndriver = "gpiod"\nchip = "x"\nlines = ["A"]\n\n[chain]',
        "lamps: is for a beam; possible: no table",
    ),
    (
        ROW + GPIOD,
        "[chain]",
        '[[serial]]\ndevice = "/dev/ttyS1"\nspeaks = "telegram"\nsigma_now = true\n\n[chain]',
        "serial.0.sigma_now: true is for a beam; possible: false",
    ),
    (
        ROW + GPIOD,
        'stable = ["t1"]',
        'stable = ["t22"]',
        'chain.stable.0: there is no target "t22"; did you mean `t2`?; possible: "t1", "t2"',
    ),
    (ROW + GPIOD, 'stable = ["t1"]', 'stable = ["t1", "t1"]', 'chain.stable.1: "t1" is in the list twice'),
    (ROW + GPIOD, 'instrument = "chain"\n', "", 'chain: is for instrument = "chain"'),
    (
        ROW + GPIOD,
        "[switches]",
        "[switches]\nsettle_s = 1.0",
        "switches.settle_s: is for a beam with a switched target; possible: the same key in [chain]",
    ),
    (BEAM + ONE_LINE, "switched = true\n", "", "switches: no target has switched = true; possible: with one"),
    (BEAM + GPIOD, "", "", "switches.lines: 2 lines for 1 switched target; possible: one for each"),
    (BEAM, "", "", "switches: the glasses cannot be switched; possible: a table with driver"),
    (
        BEAM + ONE_LINE,
        "z_mm = 280.0",
        "z_mm = 280.0\nswitched = true",
        "targets.1.switched: true, and no target is behind it; possible: false",
    ),
    (
        BEAM + CAMERA,
        "[switches]",
        '[lamps]\ndriver = "camera"\ncameras = ["near"]\nline = "Line2"\n\n[switches]',
        'switches.line: "Line2" of camera "near" switches the frame LEDs; possible: another line',
    ),
    (
        BEAM + ONE_LINE,
        "[switches]",
        '[lamps]\ndriver = "gpiod"\nchip = "pinctrl-bcm2711"\nlines = ["GLASS_1"]\n\n[switches]',
        'switches.lines.0: "GLASS_1" is already the line of lamps.lines.0; choose another',
    ),
)


@pytest.mark.parametrize(("text", "old", "new", "said"), FAULTS, ids=[said for *_, said in FAULTS])
def test_a_fault_is_named_at_its_key(text: str, old: str, new: str, said: str) -> None:
    assert old in text
    with pytest.raises(BadInputError) as refused:
        loaded(text.replace(old, new, 1))
    assert said in str(refused.value)


def test_glasses_of_a_recording_are_not_switched_again() -> None:
    played = '[cameras.far]\ndriver = "recording"\npath = "rounds"\n'
    text = ROW[: ROW.index("[cameras.near]")] + played + played.replace("far", "near") + GPIOD
    with pytest.raises(BadInputError, match="switches: glasses of a recording cannot be switched again"):
        loaded(text)
