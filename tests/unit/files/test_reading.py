import contextlib
import os
import pwd
import re
import socket
import struct
import threading
import time
from pathlib import Path

import cv2
import numpy as np
import pytest
from support.pngs import chunk, png

from altd.errors import BadInputError
from altd.files.documents import parse_json, parse_toml
from altd.files.picture import decode_png, read_picture
from altd.files.reading import read_file, read_head


def complaint(path: Path, largest_bytes: int = 1000) -> str:
    with pytest.raises(BadInputError) as caught:
        read_file(path, largest_bytes)
    assert "\n" not in str(caught.value)
    return caught.value.message


def test_a_file_is_read_up_to_its_bound(tmp_path: Path) -> None:
    path = tmp_path / "file"
    path.write_bytes(b"x" * 1000)
    assert read_file(path, 1000) == b"x" * 1000
    assert read_head(path, 3) == b"xxx"
    assert complaint(path, 999) == "is 1000 bytes long, more than 999"


def test_a_missing_permission_names_user_owner_mode_and_remedy(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    closed = tmp_path / "closed"
    (closed / "folder").mkdir(parents=True, mode=0o700)
    path = closed / "folder" / "file"
    path.touch(0o600)
    user = pwd.getpwuid(os.geteuid()).pw_name

    def refuse(*_arguments: object, **_names: object) -> int:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(os, "open", refuse)
    remedy = "; use sudo, or chmod and chgrp"
    said = f"Permission denied: this is user {user}, "
    assert complaint(path) == f"{said}the file belongs to {user}, mode 0600{remedy}"
    with monkeypatch.context() as inner:
        stat = os.stat
        inner.setattr(os, "stat", lambda place, **names: refuse() if place == path else stat(place, **names))
        assert complaint(path) == f"{said}the folder {path.parent} belongs to {user}, mode 0700{remedy}"


def test_a_file_of_a_terabyte_is_refused_by_its_size(tmp_path: Path) -> None:
    path = tmp_path / "sparse"
    with path.open("wb") as file:
        file.truncate(1 << 40)
    assert complaint(path) == f"is {1 << 40} bytes long, more than 1000"
    assert read_head(path, 2) == b"\0\0"


def test_a_pipe_a_device_a_socket_and_a_folder_are_not_opened(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    with socket.socket(socket.AF_UNIX) as listening:
        listening.bind(str(tmp_path / "socket"))
        assert complaint(tmp_path / "socket") == "is a socket, not a file"
    assert complaint(tmp_path / "pipe") == "is a pipe, not a file"  # without a writer: it does not wait
    assert complaint(tmp_path) == "is a folder, not a file"
    assert complaint(Path("/dev/zero")) == "is a device, not a file"
    (tmp_path / "link").symlink_to("/dev/zero")
    assert complaint(tmp_path / "link") == "is a device, not a file"


def test_a_path_that_leads_nowhere_is_named(tmp_path: Path) -> None:
    (tmp_path / "loop").symlink_to("loop")
    assert complaint(tmp_path / "loop") == "Too many levels of symbolic links"
    assert complaint(tmp_path / "none") == "No such file or directory"
    assert complaint(tmp_path / ("x" * 300)) == "File name too long"
    assert complaint(Path("a\0b")) == "is not a path"
    assert complaint(Path("\ud800")) == "is not a path"


def test_a_file_of_proc_has_no_size_and_is_bounded_all_the_same() -> None:
    assert len(read_file(Path("/proc/self/stat"), 10_000)) > 50
    assert complaint(Path("/proc/self/stat"), 20) == "is more than 20 bytes long"


def test_a_file_that_grows_while_it_is_read_is_refused(tmp_path: Path) -> None:
    path, done = tmp_path / "file", threading.Event()
    path.write_bytes(b"x" * (4 << 20))

    def grow() -> None:
        with path.open("ab", buffering=0) as file:
            while not done.is_set():
                file.write(b"y")

    growing = threading.Thread(target=grow)
    growing.start()
    try:
        complaints = set[str]()
        deadline_s = time.monotonic() + 20
        while not complaints and time.monotonic() < deadline_s:  # it may get no turn for a while
            try:
                read_file(path, 1 << 30)
            except BadInputError as error:
                complaints.add(error.message)
        assert complaints == {"was changed while it was read"}
    finally:
        done.set()
        growing.join()


PIXELS = np.random.default_rng(1).integers(0, 255, (48, 64)).astype(np.uint8)
GOOD = cv2.imencode(".png", PIXELS)[1].tobytes()


def png_complaint(data: bytes, width: int = 64, height: int = 48, bits: int = 8) -> str:
    try:
        decode_png(data, width, height, bits)
    except ValueError as error:
        return str(error)
    pytest.fail("it was decoded")


def test_a_png_is_decoded_whatever_else_is_in_it() -> None:
    assert np.array_equal(decode_png(GOOD, 64, 48, 8), PIXELS)
    comment = chunk(b"tEXt", b"Comment\0x") + chunk(b"gAMA", b"\0\0\0\0")
    assert np.array_equal(decode_png(GOOD[:33] + comment + GOOD[33:], 64, 48, 8), PIXELS)


def test_a_png_of_another_size_is_not_decoded() -> None:
    assert png_complaint(png(40_000, 40_000)) == "is 40000 × 40000, expected 64 × 48"
    assert "more than 268435456 pixels" in png_complaint(png(40_000, 40_000), 40_000, 40_000)


def test_a_torn_or_damaged_png_is_refused_and_libpng_says_nothing(capfd: pytest.CaptureFixture[str]) -> None:
    flipped = bytearray(GOOD)
    flipped[len(GOOD) // 2] ^= 1
    for damaged in (GOOD[:-12], GOOD[: len(GOOD) // 2], bytes(flipped), GOOD[:33] + GOOD[8:]):
        assert png_complaint(damaged) == "cannot be decoded as a frame: it is torn or damaged"
    assert capfd.readouterr().err == ""


def tiff(
    order: str = "<", orientation: int = 1, following: int = 0, bits: int = 8, photometric: int = 1
) -> bytes:
    """An uncompressed grey TIFF of PIXELS, its directory at the end (TIFF 6.0, sections 2 and 4)."""
    rows, columns = PIXELS.shape[0], PIXELS.shape[1] * 8 // bits
    fields = {256: columns, 257: rows, 258: bits, 259: 1, 262: photometric, 273: 8, 274: orientation, 277: 1}
    fields |= {278: rows, 279: PIXELS.size}
    entries = b"".join(struct.pack(order + "HHIHH", tag, 3, 1, value, 0) for tag, value in fields.items())
    head = (b"II" if order == "<" else b"MM") + struct.pack(order + "HI", 42, 8 + PIXELS.size)
    count = struct.pack(order + "H", len(fields))
    return head + PIXELS.tobytes() + count + entries + struct.pack(order + "I", following)


@pytest.mark.parametrize("order", ["<", ">"])
def test_a_tiff_is_read_as_it_is_stored(order: str, tmp_path: Path) -> None:
    (tmp_path / "picture").write_bytes(tiff(order))
    pixels, bits = read_picture(tmp_path / "picture")
    assert (pixels == PIXELS).all()
    assert bits == 8
    (tmp_path / "picture").write_bytes(tiff(order, photometric=0))
    assert (read_picture(tmp_path / "picture")[0] == 255 - PIXELS).all()


@pytest.mark.parametrize(("largest", "bits"), [(255, 8), (199, 8), (1023, 10), (4095, 12), (65535, 16)])
def test_a_pgm_has_the_bits_of_the_largest_value_that_it_states(
    largest: int, bits: int, tmp_path: Path
) -> None:
    pixels = PIXELS % 200 if largest < 256 else PIXELS.astype(">u2")
    head = f"P5 # of a camera\n{PIXELS.shape[1]}\n# with {bits} bits\n{PIXELS.shape[0]} {largest}\n"
    (tmp_path / "picture").write_bytes(head.encode() + pixels.tobytes())
    read, found = read_picture(tmp_path / "picture")
    assert (read == pixels).all()
    assert found == bits


@pytest.mark.parametrize(
    ("data", "why"),
    [
        (png(40_000, 40_000), "it is 40000 × 40000, more than 268435456 pixels"),
        (png(65_536, 16_385), "it is 65536 × 16385, more than"),  # beyond 2³⁰, where OpenCV raises
        (png(2**31, 1), "more than"),
        (png(0, 5), "its header is not that of a PNG"),
        (png(64, 64, depth=9), "its header is not that of a PNG"),
        (png(64, 64), "Not enough image data"),
        (png(64, 64, data=b"\x09" * 65 * 64), "bad adaptive filter value"),
        (GOOD[:100], "it is torn or damaged"),
        (b"", "of up to"),
        (b"P5\n60000 60000\n255\n" + bytes(100), "of up to"),
        (cv2.imencode(".jpg", PIXELS)[1].tobytes()[:1500] + b"\xff\xd9", "Corrupt JPEG data"),
        (cv2.imencode(".png", np.zeros((64, 64, 3), np.uint8))[1].tobytes(), "is not an 8- or 16-bit grey"),
        (cv2.imencode(".png", np.zeros((16, 64), np.uint8))[1].tobytes(), "is only 64 × 16 pixels"),
        (tiff(orientation=6), "its orientation tag is 6"),
        (tiff(order=">", orientation=3), "its orientation tag is 3"),
        (tiff(following=8), "it has several pages"),
        (tiff(bits=16, photometric=0), "its zero is white"),
        (tiff()[:200], "it is torn or damaged"),
    ],
)
def test_a_picture_that_cannot_be_used_is_refused_in_one_line(
    data: bytes, why: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "picture"
    path.write_bytes(data)
    with pytest.raises(BadInputError) as caught:
        read_picture(path)
    assert why in str(caught.value)
    assert str(caught.value).isprintable()
    assert "libpng" not in capfd.readouterr().err


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"x = " + b"9" * 5000, "not TOML: a number with too many digits"),
        (b"x = " + b"[" * 5000, "is nested too deeply"),
        (b"x = " + b"{a=" * 5000, "is nested too deeply"),
        (b"x = 0x" + b"f" * 20_000, "has more than 64 bits"),
        (b"x = 9223372036854775808", "has more than 64 bits"),
        (b"x = -9223372036854775809", "has more than 64 bits"),
        (b'a.b = [{c = "x\\u0000y"}]', "has a NUL"),
        (b"a = 1\na = 2", "not TOML: this key is defined twice"),
        (b"x = 1\r\ny = \r\n", "not TOML: no value"),
        (b"\xef\xbb\xbfx = 1", "begins with a byte order mark: save the file as UTF-8"),
        (b"x = \xff", "is not UTF-8 text"),
        (b"x = \0", "not TOML: no value"),
        (b"# " + b"." * 99 + b"\n" + b"a." * 65 + b"a = 1", "more than 64 dots in a line"),
        (b'x = """', "not TOML: "),
    ],
)
def test_toml_that_is_none_is_refused(content: bytes, message: str) -> None:
    with pytest.raises(ValueError, match=re.escape(message)):
        parse_toml(content)


def test_toml_is_read() -> None:
    assert parse_toml(b"# " + b"." * 500 + b"\nx.y = [1, 0.5]\r\n") == {"x": {"y": [1, 0.5]}}
    whole = {"least": -9223372036854775808, "most": 9223372036854775807}
    assert parse_toml(b"least = -9223372036854775808\nmost = 9223372036854775807") == whole


def test_no_toml_of_a_config_s_size_takes_long() -> None:
    """A key of 30,000 parts takes tomllib 9 s."""
    line = b".".join([b"a"] * 60)
    tables = b"\n".join(b"[%s.b%d]\n%s = 1" % (line, n, line) for n in range(250))
    for content in (b".".join([b"a"] * 30_000) + b" = 1", tables, b"\n" * 60_000 + b"x = 1", b" " * 60_000):
        began = time.process_time()
        with contextlib.suppress(ValueError):
            parse_toml(content)
        assert time.process_time() - began < 5  # computing time, which a busy computer does not add to


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b'{"a": 1, "b": 2, "a": 1}', "is not JSON: the key 'a' occurs twice in one object"),
        (b"[" * 100_000, "is nested too deeply"),
        (b'{"a":' * 100_000, "is nested too deeply"),
        (b"[" + b"9" * 5000 + b"]", "has 5000 digits"),
        (b"[-" + b"9" * 40 + b"]", "has 41 digits"),
        (b'{"a": 1', "is not JSON: Expecting"),
        (b'["\xff"]', "is not JSON: 'utf-8' codec"),
        (b"", "is not JSON: Expecting value"),
    ],
)
def test_json_that_is_none_is_refused(content: bytes, message: str) -> None:
    with pytest.raises(ValueError, match=re.escape(message)):
        parse_json(content)


def test_json_is_read() -> None:
    assert parse_json(b'\xef\xbb\xbf{"a": [1, 0.5, {"b": null}]}') == {"a": [1, 0.5, {"b": None}]}
