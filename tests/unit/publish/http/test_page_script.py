"""The page's link to the unit, run by Node.js: it knows nothing that was not said within the last seconds.

The network and the clock are the test's; a browser shows the page in tests/system/publish/http.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from support.page_in_node import Driven

from altd.status.measurement_json import as_object_now
from tools.pages.example import AGE_S, MEASURED

STATUS_PATH, MEASUREMENT_PATH = "api/v1/status", "api/v1/measurement"
HERE = Path(__file__).parent

SESSION = "5C1E90A7"


def sent(message: int, clock_ms: int, **other: Any) -> dict[str, Any]:
    """The measurement as it is sent as this message, when the unit's clock shows so many milliseconds."""
    proof = {"session": SESSION, "message": message, "clock_ms": clock_ms}
    return {**as_object_now(MEASURED, AGE_S), **proof, **other}


VALID = sent(1, 345_000)
STATUS = {
    "serial": "ALT-0007",
    "components": {
        "camera rear": {"state": "degraded", "message": "no frame for 0.3 s", "for_s": 0.1, "frames": 120},
        "http": {"state": "ok", "message": "port 80", "for_s": 9.0},
    },
}
WELL = {STATUS_PATH: STATUS, MEASUREMENT_PATH: VALID}
WELL_LATER = {STATUS_PATH: STATUS, MEASUREMENT_PATH: sent(9, 349_000)}
NOTHING = {"x_mm": "\N{EN DASH}", "sigma_x_mm": "", "sequence": None, "components": []}
NO_VALUES = {"x_mm": "\N{EN DASH}", "sigma_x_mm": "", "sequence": None}


def named(mean: str, now: str, end: str = "") -> str:
    return f"±\u00a0{mean} (mean), ±\u00a0{now} now{end}"


class Page(Driven):
    """The page's link."""

    def measuring(self) -> dict[str, Any]:
        """Ask once, and open the stream, with one measurement and a look at the components."""
        self.do(answers=WELL, tick=True)
        self.do(opened=True, message=sent(2, 345_000))
        return self.do(tick=True)


@pytest.fixture
def page(tmp_path: Path) -> Iterator[Page]:
    with Page.driven(HERE / "page_in_node.mjs", tmp_path, "link", "words") as page:
        yield page


def test_it_shows_what_the_unit_says(page: Page) -> None:
    shown = page.measuring()
    assert (shown["verdict"], shown["kind"], shown["x_mm"]) == ("valid", "good", "10.012")
    # now: √(0.004² + 0.0102² + (0.0512 · 0.52)²) mm
    assert shown["sigma_x_mm"] == named("0.004", "0.029", ", moving")
    assert shown["sigma_of_a_place"] == "±\u00a00.004"  # an instrument that estimates no motion
    # now: 1000 (tan(1.7184° + 0.00161°) − tan 1.7184°), near enough
    assert shown["sigma_pitch_mm_per_m"] == named("0.0192", "0.028")
    assert shown["components"] == ["camera rear", "http"]
    assert shown["sequence"] == 160
    assert shown["asked"] == [STATUS_PATH]  # the stream tells the rest


def test_a_moving_beam_has_both_sigmas_and_its_own_digits(page: Page) -> None:
    sigma, now = VALID["sigma"] | {"x_mm": 0.0141}, VALID["sigma_now"] | {"x_mm": 0.3942}
    page.measuring()
    shown = page.do(pass_ms=50, message=sent(3, 345_050, sigma=sigma, sigma_now=now))
    assert shown["sigma_x_mm"] == named("0.014", "0.39", ", moving")
    rates = VALID["rates"] | {"x_mm_per_s": 0.0}
    shown = page.do(pass_ms=50, message=sent(4, 345_100, sigma=sigma, sigma_now=now, rates=rates))
    assert shown["sigma_x_mm"] == named("0.014", "0.39")


def test_a_sigma_now_of_an_earlier_second_is_never_shown(page: Page) -> None:
    """Each measurement brings its own, or none; a value that is gone leaves no uncertainty behind."""
    assert page.measuring()["sigma_x_mm"] == named("0.004", "0.029", ", moving")
    none = dict.fromkeys(VALID["sigma"])
    shown = page.do(pass_ms=50, message=sent(3, 345_050, sigma_now=none, rates={**none, "sigma": none}))
    assert shown["sigma_x_mm"] == "±\u00a00.004 (mean), now not known"
    invalid = {"valid": False, "status": ["front_spot_missing"], "x_mm": None}
    shown = page.do(pass_ms=50, message=sent(4, 345_100, **invalid, sigma=none, sigma_now=none))
    assert (shown["verdict"], shown["sigma_x_mm"]) == ("not valid", "")
    shown = page.do(pass_ms=50, message=sent(5, 345_150, **invalid))  # even if sigmas were sent
    assert (shown["x_mm"], shown["sigma_x_mm"]) == ("\N{EN DASH}", "")


@pytest.mark.parametrize(
    ("status", "verdict"),
    [
        (["simulated", "rehearsal"], "SIMULATED"),
        (["playback", "rehearsal"], "PLAYBACK"),
        (["rehearsal"], "REHEARSAL"),
    ],
)
def test_values_that_are_not_from_cameras_are_named_for_their_origin(
    page: Page, status: list[str], verdict: str
) -> None:
    shown = page.do(answers={**WELL, MEASUREMENT_PATH: sent(1, 345_000, status=status)}, tick=True)
    assert (shown["verdict"], shown["kind"]) == (verdict, "warned")


@pytest.mark.parametrize(
    ("orders", "verdict"),
    [
        ([{"answers": {}, "pass_ms": 1000, "tick": True}], "no connection to the unit"),
        (
            [
                {"answers": {STATUS_PATH: "silent"}, "pass_ms": 1000, "tick": True},
                {"pass_ms": 1500, "give_up": True},
            ],
            "no connection to the unit",
        ),
        (
            [{"answers": {STATUS_PATH: "silent"}, "pass_ms": 3_600_000, "tick": True}],
            "no data from the unit",
        ),
    ],
    ids=["refused", "a cable that was cut: nothing fails, nothing comes", "the page slept"],
)
def test_with_the_connection_all_goes_that_is_not_known_any_more(
    page: Page, orders: list[dict[str, Any]], verdict: str
) -> None:
    page.measuring()
    for order in orders:
        shown = page.do(**order)
    assert (shown["verdict"], shown["kind"]) == (verdict, "unknown")
    assert shown.items() >= NOTHING.items()


def test_a_late_answer_shows_a_slow_link_and_what_the_state_was(page: Page) -> None:
    """It is no connection only if none comes; nothing of a late answer is shown as current."""
    page.measuring()
    late = {"after_ms": 3000, "document": {**STATUS, "serial": "ALT-0008"}}
    page.do(answers={**WELL, STATUS_PATH: late}, pass_ms=1000, tick=True)
    shown = page.do(pass_ms=1500, tick=True)
    assert (shown["verdict"], shown["last"]["status"]["serial"]) == ("no data from the unit", "ALT-0007")
    shown = page.do(pass_ms=1500)
    assert (shown["verdict"], shown["last"]["status"]["serial"]) == ("link too slow", "ALT-0008")
    assert shown.items() >= NOTHING.items()
    page.do(tick=True)
    assert page.do(pass_ms=1500, tick=True)["verdict"] == "link too slow"
    page.do(pass_ms=2000)
    assert page.do(answers=WELL_LATER, pass_ms=500, tick=True)["verdict"] == "valid"


def test_values_that_would_only_flash_are_not_shown(page: Page) -> None:
    """Each answer takes 0.7 s, and the stream is behind: a value would be too old after a moment."""
    page.measuring()
    for second in range(3, 7):
        clock_ms = 343_000 + 2000 * second
        slow = {"after_ms": 700, "document": sent(10 * second, clock_ms)}
        page.do(
            answers={STATUS_PATH: {"after_ms": 700, "document": STATUS}, MEASUREMENT_PATH: slow}, tick=True
        )
        page.do(pass_ms=700)
        shown = page.do(pass_ms=700)
        assert second == 3 or (shown["verdict"], shown["knows_status"]) == ("link too slow", False)
        shown = page.do(pass_ms=600, message=sent(10 * second - 9, clock_ms - 2000), tick=True)
        assert (shown["verdict"], shown["x_mm"]) == ("link too slow", "\N{EN DASH}")


def test_a_stream_that_breaks_takes_its_values_along_and_the_state_is_asked_at_once(page: Page) -> None:
    page.measuring()
    shown = page.do(answers={}, broken=2)
    assert shown["asked"] == [STATUS_PATH]
    assert shown.items() >= NOTHING.items()


def test_where_the_stream_is_silent_the_measurement_is_asked_for(page: Page) -> None:
    """Behind a proxy that holds the stream back, or where measurements are far between."""
    page.measuring()
    stale = sent(3, 346_000, valid=False, status=["stale"], x_mm=None)
    stale["sigma"] = stale["sigma_now"] = dict.fromkeys(VALID["sigma"])
    shown = page.do(answers={**WELL, MEASUREMENT_PATH: stale}, pass_ms=1000, tick=True)
    assert shown["asked"] == [STATUS_PATH, MEASUREMENT_PATH]
    assert (shown["verdict"], shown["x_mm"]) == ("not valid", "\N{EN DASH}")


def test_before_the_first_measurement_it_says_so(page: Page) -> None:
    answers = {STATUS_PATH: STATUS, MEASUREMENT_PATH: {"error": "nothing", "status": ["warming_up"]}}
    shown = page.do(answers=answers, opened=True, pass_ms=1000, tick=True)
    assert (shown["verdict"], shown["kind"], shown["sequence"]) == ("nothing measured yet", "unknown", None)


def test_a_unit_that_is_back_is_shown_again_with_one_stream(page: Page) -> None:
    page.measuring()
    page.do(answers={}, pass_ms=1000, tick=True)
    shown = page.do(answers={**WELL, MEASUREMENT_PATH: sent(3, 347_000)}, pass_ms=1000, tick=True)
    assert shown["verdict"] == "valid"
    streams = shown["streams"]
    shown = page.do(opened=True, message=sent(4, 347_050, sequence=161))
    assert shown["sequence"] == 161
    assert page.do(pass_ms=300, tick=True)["streams"] == streams


def test_where_all_streams_are_taken_the_values_are_asked_for_and_stay(page: Page) -> None:
    page.do(answers=WELL, broken=2)
    for second in range(1, 4):
        answers = {**WELL, MEASUREMENT_PATH: sent(second, 345_000 + 1000 * second)}
        assert page.do(answers=answers, pass_ms=1000, tick=True)["x_mm"] == "10.012"
        assert page.do(broken=2)["x_mm"] == "10.012"


def test_what_a_slow_line_or_a_proxy_held_back_is_not_shown_as_new(page: Page) -> None:
    """The stream comes 3 s late and without a gap: each number is one of 3 s ago."""
    page.measuring()
    page.do(answers={**WELL, MEASUREMENT_PATH: "silent"}, pass_ms=3000, tick=True)
    for number in range(30):
        shown = page.do(pass_ms=50, message=sent(3 + number, 345_050 + 50 * number))
        assert shown.items() >= NO_VALUES.items()
    answers = {**WELL, MEASUREMENT_PATH: sent(90, 349_500, sequence=230)}
    page.do(answers=answers, give_up=True)
    shown = page.do(tick=True, message=sent(33, 346_550))
    assert (shown["verdict"], shown["sequence"]) == ("valid", 230)  # asked for, and not of the stream


def test_an_answer_that_took_long_once_does_not_make_all_that_follows_late(page: Page) -> None:
    """It took a second on its way back: so far the clocks may be apart, until an answer is quick."""
    late = {"after_ms": 1000, "document": sent(1, 346_000)}
    page.do(answers={**WELL, MEASUREMENT_PATH: late}, opened=True, tick=True)
    page.do(pass_ms=1000)
    for number in range(1, 41):
        clock_ms = 346_000 + 100 * number
        quick = sent(2 * number + 3, clock_ms, sequence=number)
        news = sent(2 * number + 2, clock_ms, sequence=number)
        answers = {**WELL, MEASUREMENT_PATH: quick}
        shown = page.do(answers=answers, pass_ms=100, message=news, tick=number % 5 == 0)
        assert (shown["verdict"], shown["sequence"]) == ("valid", number)
        assert shown["asked"] in ([], [STATUS_PATH]) or number < 10
    assert page.do(pass_ms=1300, answers={**WELL, MEASUREMENT_PATH: "silent"}, tick=True)["sequence"] == 40


def test_what_came_late_is_gone_the_sooner(page: Page) -> None:
    """Sent 1.2 s before it came, it is shown for 0.2 s: nothing that is shown was sent 1.5 s ago."""
    page.measuring()
    answers = {**WELL, MEASUREMENT_PATH: "silent"}
    shown = page.do(answers=answers, pass_ms=1250, message=sent(3, 345_050, sequence=161))
    assert shown["sequence"] == 161
    assert page.do(pass_ms=150, tick=True)["sequence"] == 161
    assert page.do(pass_ms=100, tick=True).items() >= NO_VALUES.items()


def test_what_waited_while_the_computer_slept_is_not_shown(page: Page) -> None:
    page.measuring()
    answers = {STATUS_PATH: STATUS, MEASUREMENT_PATH: "silent"}
    shown = page.do(answers=answers, pass_ms=3_600_000, message=sent(3, 345_050), tick=True)
    assert shown.items() >= NO_VALUES.items()


def test_an_answer_that_is_repeated_is_no_news(page: Page) -> None:
    """A proxy that caches against ``no-store``: the same valid measurement, again and again."""
    page.measuring()
    page.do(broken=2)
    for _ in range(4):
        shown = page.do(answers=WELL, pass_ms=500, tick=True)  # message 1, and 2 was seen
    assert shown.items() >= NO_VALUES.items()


def test_a_unit_that_was_restarted_is_asked_before_its_stream_is_believed(page: Page) -> None:
    page.measuring()
    new = {"session": "0000BEEF", "sequence": 7}
    answers = {**WELL, MEASUREMENT_PATH: {**sent(1, 60), **new}}
    page.do(answers=answers, pass_ms=600, message={**sent(1, 40), **new}, tick=True)
    shown = page.do(pass_ms=50, message={**sent(2, 110), **new, "sequence": 8})
    assert (shown["verdict"], shown["sequence"]) == ("valid", 8)


def test_a_refusal_says_nothing_of_the_unit(page: Page) -> None:
    """A client that asks too often is refused: neither is nothing wrong then, nor was nothing measured."""
    page.measuring()
    refused = {"error": "too many requests; wait 1 s"}
    answers = {STATUS_PATH: refused, MEASUREMENT_PATH: refused}
    assert page.do(answers=answers, pass_ms=500, tick=True)["knows_status"] is False
    for _ in range(3):
        shown = page.do(pass_ms=500, tick=True)
    assert (shown["verdict"], shown["knows_status"]) == ("no data from the unit", False)
    assert page.do(answers=WELL_LATER, pass_ms=500, tick=True)["verdict"] == "valid"


@pytest.mark.parametrize("step_ms", [-3_600_000, 3_600_000])
def test_a_browser_whose_clock_is_set_goes_on(page: Page, step_ms: int) -> None:
    page.measuring()
    answers = {**WELL, MEASUREMENT_PATH: sent(4, 345_100)}
    page.do(answers=answers, pass_ms=step_ms, message=sent(3, 345_050), tick=True)
    shown = page.do(pass_ms=50, message=sent(5, 345_150, sequence=163))
    assert (shown["verdict"], shown["sequence"]) == ("valid", 163)


def test_numbers_and_clocks_that_begin_anew_after_32_bits_are_no_repetition(page: Page) -> None:
    last = 0xFFFF_FFFE
    page.do(answers={**WELL, MEASUREMENT_PATH: sent(last, last)}, tick=True)
    page.do(opened=True)
    shown = page.do(pass_ms=50, message=sent(0, 49, sequence=161))
    assert (shown["verdict"], shown["sequence"]) == ("valid", 161)


@pytest.mark.parametrize("rate", [0.97, 1.03])
def test_clocks_that_drift_apart_are_kept_together(page: Page, rate: float) -> None:
    """By 3 s in the end, and the page shows a late number at no time, nor nothing."""
    page.measuring()
    for number in range(1, 1001):
        message, clock_ms = 2 * number + 1, 345_000 + round(100 * number * rate)
        answers = {**WELL, MEASUREMENT_PATH: sent(message + 1, clock_ms, sequence=number)}
        news = sent(message, clock_ms, sequence=number)
        shown = page.do(answers=answers, pass_ms=100, message=news, tick=number % 5 == 0)
        assert shown["verdict"] == "valid"
        assert number - shown["sequence"] <= 10
