"""Levelling of a simulated inclinometer with axes askew, and roll and pitch with it afterwards."""

import json
import math
import random
from collections.abc import Iterator
from pathlib import Path

import pytest
from support.cli import altd_here, refusal
from support.inclinometer import FINE, settings
from support.unit_toml import played_toml

from altd.acquisition.inclination.alignment import Alignment
from altd.acquisition.inclination.judging import InclinationJudge
from altd.app.level import alignment_of, report, save_level, take_level
from altd.app.parts import check_files, missing_files
from altd.config import InclinometerSettings, load_config
from altd.errors import BadInputError
from altd.files.documents import checksum_of
from hw_sim.inclinometer import Inclinometer

PLAN = ((0.0, 0.0, 0.0), (0.0, 0.0, 180.0), (10.0, 0.0, 0.0), (0.0, 10.0, 0.0))
PLATE_DEG = 0.005


def of(sensor: Inclinometer, **more: object) -> InclinometerSettings:
    return settings(sensor.device, "modbus", sensor=FINE, interval_s=0.05, **more)


def aligned(table: InclinometerSettings) -> Alignment:
    alignment = alignment_of(table, "TEST-1")
    assert alignment is not None
    return alignment


def level(sensor: Inclinometer, path: Path, seed: int = 1) -> None:
    """Level it on plates whose tilt is known to PLATE_DEG."""
    errors = random.Random(seed)
    plates = {place[:2]: [errors.gauss(0.0, PLATE_DEG) for _ in "rp"] for place in PLAN}

    def put(number: int) -> None:
        roll_deg, pitch_deg, turned_deg = PLAN[number]
        sign = -1.0 if turned_deg else 1.0
        error = plates[roll_deg, pitch_deg]
        sensor.roll_deg, sensor.pitch_deg = sign * (roll_deg + error[0]), sign * (pitch_deg + error[1])

    of_sensor = of(sensor)
    found = take_level(
        of_sensor.inclinometer(), of_sensor, "TEST-1", PLAN, PLATE_DEG, "A. Surveyor", put, lambda _: None
    )
    save_level(found, path)


@pytest.fixture(scope="module")
def levelled(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Inclinometer, Path]]:
    """A sensor with axes askew by 1°, zeros of 1.2° and -0.8°, and the file of its levelling at 20 °C."""
    path = tmp_path_factory.mktemp("level") / "level.json"
    with Inclinometer.fine() as sensor, pytest.MonkeyPatch.context() as patch:
        patch.setattr("altd.app.level.READINGS", 12)
        askew = [math.radians(of_deg) for of_deg in (1.2, 1.0, -1.0, -0.8)]
        sensor.axes = ((1.0, askew[0], askew[1]), (askew[2], askew[3], 1.0))
        sensor.temperature_c, sensor.deg_per_k = 20.0, 0.0005
        level(sensor, path)
        yield sensor, path


def test_roll_and_pitch_of_a_levelled_sensor_err_as_sigma_says(levelled: tuple[Inclinometer, Path]) -> None:
    """20 K warmer than at the levelling; without the turn of its axes roll would be off by 0.1°."""
    sensor, path = levelled
    table = of(sensor, level=path)
    driver = table.inclinometer()
    sensor.temperature_c = 40.0
    driver.open()
    for roll_deg, pitch_deg in ((0.0, 0.0), (5.0, -6.0), (-4.0, 6.0)):
        sensor.roll_deg, sensor.pitch_deg = roll_deg, pitch_deg
        judge = InclinationJudge(table, driver.accuracy, aligned(table))
        said = [judge.roll(driver.read()) for _ in range(8)][-1]
        assert said.value is not None
        assert said.sigma is not None
        tilt = judge.credible[-1].tilt
        assert abs(said.value - roll_deg) < 2.5 * said.sigma <= 0.05
        assert abs(tilt.pitch_deg - pitch_deg) < 2.5 * tilt.sigma_pitch_deg <= 0.05
    driver.close()


def test_the_report_and_the_file(levelled: tuple[Inclinometer, Path]) -> None:
    sensor, path = levelled
    lines = list(report(aligned(of(sensor, level=path))))
    assert lines[0].startswith("zero of roll +1.2")
    assert " of pitch -0.8" in lines[0]
    assert lines[1].startswith("turn of the axes: roll +1.0")
    assert len(lines) == 4
    assert json.loads(path.read_bytes())["made_by"] == "A. Surveyor"


@pytest.mark.parametrize(
    ("change", "unit", "sign", "said"),
    [
        (
            {"unit": "TEST-2"},
            "TEST-1",
            1,
            "was made with unit 'TEST-2', not 'TEST-1': level again, altd level",
        ),
        ({"sensor": "other"}, "TEST-1", 1, "was made with sensor 'other', not 'fine'"),
        ({}, "TEST-1", -1, "was made with sign_roll 1, not -1"),
        ({"format": "altd-level/2"}, "TEST-1", 1, "is no altd-level/1"),
        ({"plate_sigma_deg": 0}, "TEST-1", 1, "plate_sigma_deg: Input should be greater than 0"),
        ({"positions": []}, "TEST-1", 1, "positions: Tuple should have at least 2 items"),
        ({"checksum": "sha256:0"}, "TEST-1", 1, "checksum does not match"),
    ],
)
def test_a_file_that_is_not_of_this_sensor_is_refused(
    levelled: tuple[Inclinometer, Path],
    tmp_path: Path,
    change: dict[str, object],
    unit: str,
    sign: int,
    said: str,
) -> None:
    sensor, good = levelled
    path = tmp_path / "level.json"
    document = json.loads(good.read_bytes())
    del document["checksum"]
    document |= change
    document.setdefault("checksum", checksum_of(document))
    path.write_text(json.dumps(document))
    with pytest.raises(BadInputError, match=r"level\.json: ") as caught:
        alignment_of(of(sensor, level=path, sign_roll=sign), unit)
    assert said in str(caught.value)


def test_positions_that_contradict_each_other_are_refused(
    levelled: tuple[Inclinometer, Path], tmp_path: Path
) -> None:
    """The plate was tilted the other way."""
    sensor, good = levelled
    path = tmp_path / "level.json"
    document = json.loads(good.read_bytes())
    del document["checksum"]
    document["positions"][2]["plate_deg"] = [-10.0, 0.0]
    document["checksum"] = checksum_of(document)
    path.write_text(json.dumps(document))
    with pytest.raises(BadInputError, match="contradict each other"):
        aligned(of(sensor, level=path))


def test_the_command_guides_and_writes_nothing_when_its_input_ends(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("altd.app.level.READINGS", 12)
    with Inclinometer.fine() as sensor:
        place, output = tmp_path / "altd.toml", tmp_path / "level.json"
        sheet = ", ".join(f"{key} = {json.dumps(value)}" for key, value in FINE.items() if key != "registers")
        rows = ", ".join(
            "{" + ", ".join(f"{key} = {json.dumps(value)}" for key, value in row.items()) + "}"
            for row in FINE["registers"]
        )
        table = f'[inclinometer]\ndriver = "modbus"\ndevice = "{sensor.device}"\ninterval_s = 0.05\n'
        more = f'{table}level = "level.json"\nsensor = {{ {sheet}, registers = [{rows}] }}\n'
        place.write_text(played_toml("cal.json", "recording", more))
        arguments = ["level", "--config", str(place), "-o", str(output), "--sigma-deg", "0.01"]
        ended = altd_here(*arguments, stdin="\n")
        asked = "altd level: position 1 of 2: roll 0 deg, pitch 0 deg, turned by 0 deg; Enter when it rests"
        assert ended.err.splitlines()[0] == asked
        said = "standard input: ended before all positions were read; nothing is written"
        assert ended.err.splitlines()[-1] == f"altd level: {said}"
        assert (ended.status, ended.out, output.exists()) == (2, "", False)
        whole = altd_here(*arguments, stdin="\n\n")
        assert (whole.status, whole.out.split(" ")[:3]) == (0, ["zero", "of", "roll"])
        config = load_config(place)
        assert config.inclinometer is not None
        aligned(config.inclinometer)
        checked = check_files(config)[1]
        assert checked == []
        output.write_text(output.read_text().replace("TEST-1", "TEST-2"))
        assert [str(error) for error in check_files(config)[1]] == [
            f"{output}: checksum does not match: the file is damaged or was edited"
        ]
        output.unlink()
        assert "inclinometer.level" in [file.keys for file in missing_files(config)]
        for wrong, said in (
            (["--at", "0,0"], "--at: 1 positions are not possible"),
            (["--sigma-deg", "0"], "above 0"),
        ):
            assert said in refusal(altd_here(*arguments, *wrong))
        for text in ("0", "nan,0", "0,0,0,0", "50,0", "x,0"):
            assert altd_here(*arguments, "--at", text).status == 2


def test_a_file_of_another_data_sheet_is_refused(levelled: tuple[Inclinometer, Path]) -> None:
    """The same name with a reversed axis would be off by twice the zero."""
    sensor, path = levelled
    for change in (
        {"roll_is": "rotation"},
        {"registers": [FINE["registers"][0] | {"scale": -1.0}, *FINE["registers"][1:]]},
    ):
        table = settings(sensor.device, "modbus", sensor=FINE | change, level=path)
        with pytest.raises(BadInputError, match=r"another \[inclinometer.sensor\]: level again"):
            alignment_of(table, "TEST-1")
