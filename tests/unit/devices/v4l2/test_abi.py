"""Our structures, call numbers and constants against the kernel's own headers, as a C compiler reads them."""

from __future__ import annotations

import ctypes
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from support.foreign import need, need_program

from altd.devices.v4l2 import abi
from altd.devices.v4l2.image import PIXEL_FORMATS

HEADER = Path("/usr/include/linux/videodev2.h")
CONSTANTS = {name: value for name, value in vars(abi).items() if name.startswith(("V4L2_", "VIDIOC_"))}
STRUCTURES = {
    name: kind
    for name, kind in vars(abi).items()
    if isinstance(kind, type) and issubclass(kind, ctypes.Structure)
}


def fields(kind: Any, path: str = "", begin: int = 0) -> Iterator[tuple[str, int, Any]]:
    """Path, begin and type of each field that has the kernel's name."""
    for name, field_kind in kind._fields_:
        offset = begin + getattr(kind, name).offset
        compound = issubclass(field_kind, ctypes.Structure | ctypes.Union)
        if name in getattr(kind, "_anonymous_", ()):
            yield from fields(field_kind, path, offset)
        elif not name.startswith("_"):
            yield f"{path}{name}", offset, field_kind
            if compound:
                yield from fields(field_kind, f"{path}{name}.", offset)


def ours() -> dict[str, int]:
    """Each fact of ``abi``, by the C expression of it."""
    facts = dict(CONSTANTS)
    for name, kind in STRUCTURES.items():
        facts[f"sizeof(struct {name})"] = ctypes.sizeof(kind)
        for path, offset, field_kind in fields(kind):
            field = f"((struct {name} *)0)->{path}"
            facts[f"offsetof(struct {name}, {path})"] = offset
            facts[f"sizeof({field})"] = ctypes.sizeof(field_kind)
            if not issubclass(field_kind, ctypes.Structure | ctypes.Union | ctypes.Array):
                facts[f"(__typeof__({field}))-1 < 0"] = int(field_kind(-1).value < 0)
    for pixel_format in PIXEL_FORMATS.values():
        facts[f"V4L2_PIX_FMT_{pixel_format.name}"] = abi.v4l2_fourcc(pixel_format.fourcc)
    return facts


@pytest.fixture(scope="module")
def kernels(tmp_path_factory: pytest.TempPathFactory) -> dict[str, int]:
    """The same facts by the headers."""
    gcc = need_program("gcc")
    need(HEADER.exists(), f"{HEADER} is not there (Debian package linux-libc-dev)")
    program = tmp_path_factory.mktemp("abi") / "facts"
    lines = [f'printf("%llu\\n", (unsigned long long)({expression}));' for expression in ours()]
    headers = [f"#include <{name}.h>" for name in ("linux/videodev2", "stddef", "stdio")]
    source = "\n".join([*headers, "int main(void) {", *lines, "return 0; }", ""])
    compile_it = [gcc, "-x", "c", "-", "-o", program]
    compiled = subprocess.run(compile_it, input=source, capture_output=True, text=True, check=False)
    assert compiled.returncode == 0, compiled.stderr
    said = subprocess.run([program], capture_output=True, text=True, check=True).stdout.split()
    return dict(zip(ours(), map(int, said), strict=True))


def test_every_number_is_the_kernel_s(kernels: dict[str, int]) -> None:
    assert ours() == kernels


def test_what_is_compared_is_all_that_there_is() -> None:
    """Else a name spelled in another way would be compared with nothing."""
    compared = {*CONSTANTS, *STRUCTURES, "v4l2_fourcc"}
    own = {name for name, value in vars(abi).items() if getattr(value, "__module__", "") == abi.__name__}
    numbers = {name for name, value in vars(abi).items() if isinstance(value, int)}
    assert {name for name in own | numbers if not name.startswith("_")} <= compared
    assert {"V4L2_BUF_FLAG_ERROR", "VIDIOC_DQBUF"} <= CONSTANTS.keys()
    facts = ours()
    assert facts["offsetof(struct v4l2_buffer, timestamp.tv_usec)"]
    assert facts["offsetof(struct v4l2_frmivalenum, stepwise.max.denominator)"]


def test_a_text_of_the_kernel_s_ends_at_its_first_nul() -> None:
    raw = b"vivid\0rubbish".ljust(16, b"x") + b"y" * 32 + bytes(32 + 6 * 4)
    about = abi.v4l2_capability.from_buffer_copy(raw)
    assert (about.driver, about.card) == (b"vivid", b"y" * 32)
