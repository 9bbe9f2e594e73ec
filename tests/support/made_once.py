"""Parts that take seconds are made once: the first process makes one, others and later runs find it.

They are kept by a digest of all that can change them.
"""

import atexit
import fcntl
import functools
import hashlib
import inspect
import json
import pickle
import platform
import shutil
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import TypeVar

from support.places import CACHE

Made = TypeVar("Made")

_TREES = (
    *(Path(str(find_spec(package).origin)).parent for package in ("altd", "hw_sim", "studies")),
    Path(__file__).parent,
)
"""The code that makes them, as it is imported, with the compiled kernel; besides the file that asks."""
_KEPT_DIGESTS = 3
"""Of the last runs, and those in use: a made unit takes 40 MB."""


def made_once(name: str, make: Callable[[Path], object], data: Path | None = None) -> Path:
    """A folder that ``make``, a function or a partial one, has filled; no test changes it.

    ``name`` is one in the file of ``make``; ``data`` are the files outside the project that it reads.
    """
    return _made(name, make, make, data)


def loaded_once(name: str, make: Callable[[], Made], data: Path | None = None) -> Made:
    """The object that ``make`` returns, or an equal one that was kept."""

    def fill(folder: Path) -> None:
        (folder / "made.pickle").write_bytes(pickle.dumps(make()))

    found: Made = pickle.loads((_made(name, make, fill, data) / "made.pickle").read_bytes())
    return found


def _made(name: str, asked: Callable[..., object], fill: Callable[[Path], object], data: Path | None) -> Path:
    own = asked.func if isinstance(asked, functools.partial) else asked
    asking = Path(inspect.getfile(own))
    of_part = hashlib.sha256(f"{asking} {_hash([asking])} {data and _hash([data])}".encode())
    part = _base() / f"{name}-{of_part.hexdigest()[:12]}"
    if asking.stat().st_mtime > _STARTED_S:  # edited since it was loaded
        return _filled(part, fill)
    found = _found(part)
    if found is None:
        with part.with_suffix(".lock").open("w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)  # until another process has made it
            found = _found(part)
            if found is None:
                found = _filled(part, fill)
                if digest() == AT_START:  # nothing was edited meanwhile
                    _keep(part, found)
    return found


def _filled(part: Path, fill: Callable[[Path], object]) -> Path:
    folder = Path(tempfile.mkdtemp(dir=part.parent, prefix=f"{part.name}-"))
    try:
        fill(folder)
    except BaseException:
        shutil.rmtree(folder)
        raise
    return folder


def _keep(part: Path, folder: Path) -> None:
    written = folder.with_suffix(".json")
    written.write_text(json.dumps([folder.name, _hash([folder])]))
    written.rename(part.with_suffix(".made"))
    _whole.add(folder)


_whole: set[Path] = set()
"""Those of this process that were read to their end."""


def _found(part: Path) -> Path | None:
    """None: it is not there, or was changed or cut off since it was made."""
    try:
        name, of_content = json.loads(part.with_suffix(".made").read_text())
    except (FileNotFoundError, ValueError):
        return None
    folder = part.parent / name
    if folder not in _whole and _hash([folder]) != of_content:
        return None
    _whole.add(folder)
    return folder


@functools.cache
def _base() -> Path:
    """The folder of today's sources, which no other process removes while this one runs."""
    cache = CACHE / "made-once"
    try:
        cache.mkdir(parents=True, exist_ok=True)
    except OSError:  # no home to write to
        cache = Path(tempfile.mkdtemp(prefix="altd-"))
        atexit.register(shutil.rmtree, cache, ignore_errors=True)
    with (cache / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        used = (cache / f"{AT_START}.used").open("w")  # which dates it, too
        fcntl.flock(used, fcntl.LOCK_SH)
        atexit.register(used.close)
        remove_old(cache)
        (cache / AT_START).mkdir(exist_ok=True)
    return cache / AT_START


def remove_old(cache: Path) -> None:
    """Those of digests that were not used lately and are not in use."""
    for mark in sorted(cache.glob("*.used"), key=lambda mark: mark.stat().st_mtime_ns)[:-_KEPT_DIGESTS]:
        with mark.open() as used:
            try:
                fcntl.flock(used, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                continue
            shutil.rmtree(mark.with_suffix(""), ignore_errors=True)
            mark.unlink()


def digest() -> str:
    """Of all that can change what is made."""
    return hashlib.sha256("\n".join([_hash(_TREES), *_machine()]).encode()).hexdigest()[:16]


def _machine() -> Iterator[str]:
    """Other things on which numbers depend: Python, the libraries' versions, the processor."""
    yield sys.version
    for place in sys.path:
        if Path(place).is_dir():
            yield from sorted(path.name for path in Path(place).glob("*.dist-info"))
    yield from platform.uname()[4:]
    if (processor := Path("/proc/cpuinfo")).exists():
        yield from sorted({line for line in processor.read_text().splitlines() if line.startswith("flags")})


def _hash(places: Iterable[Path]) -> str:
    """Of the files' contents and names."""
    found = hashlib.sha256()
    for place in places:
        for path in sorted(place.rglob("*")) if place.is_dir() else [place]:
            if path.is_file() and "__pycache__" not in path.parts:
                content = path.read_bytes()
                found.update(f"{path.relative_to(place)}\0{len(content)}\0".encode() + content)
    return found.hexdigest()


_STARTED_S = time.time()
AT_START = digest()
"""Before the code that makes is loaded."""
