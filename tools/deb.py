"""Builds the Debian package of a unit into ``dist/``: ``python -m tools.deb [EXTRA ...]`` (``make deb``).

The package is for the Python of this process and for this machine's processor: built under Python 3.11 for
Debian 12, under 3.13 for Debian 13. Decision 0054 describes its content.
"""

import gzip
import os
import re
import shutil
import subprocess
import sys
import tempfile
import tomllib
from collections.abc import Sequence
from datetime import UTC, datetime
from email.utils import format_datetime
from hashlib import md5
from importlib.metadata import distribution
from pathlib import Path

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from altd import __version__
from tools.licences.installed import run_time_packages
from tools.manual import completion, man_page

ROOT = Path(__file__).parent.parent
DEBIAN, SYSTEMD = ROOT / "debian", ROOT / "systemd"
HOME = "/usr/lib/altd"
"""Folder of all installed versions, one subfolder each; the package installs ``package`` (decision 0054)."""
MAINTAINER = "altd maintainers <maintainers@altd.invalid>"
_PYTHON = f"python{sys.version_info.major}.{sys.version_info.minor}"
_NEEDLESS = (
    *("**/*.pyi", "**/*.pxd", "**/*.pyx", "**/*.h", "**/*.hpp", "**/*.a", "**/*.c", "**/tests", "**/RECORD"),
    *(
        "numpy/f2py",
        "numpy/distutils",
        "numpy/testing",
        "numpy/_core/_simd.*",
        "numpy/_core/*_tests.*",
        "pydantic/v1",
    ),
)
"""Files that altd never imports: types, headers, sources of compiled code, tests, build tools."""
_IMPORTED = """
import importlib, pkgutil, sys
import altd
for module in pkgutil.walk_packages(altd.__path__, "altd."):
    try:
        importlib.import_module(module.name)
    except ImportError as error:
        if not any(name in str(error) for name in sys.argv[2:]):
            raise
    except SystemExit:
        pass
for name in ("anyio._backends._asyncio", "uvicorn.lifespan.on", "uvicorn.protocols.http.h11_impl"):
    importlib.import_module(name)
files = {module.__file__ for module in sys.modules.values() if getattr(module, "__file__", None)}
print(*(file for file in files if file.startswith(sys.argv[1]) and file.endswith(".py")), sep="\\n")
"""
"""Program that prints the files of all modules altd imports; imports named in further arguments may fail."""
_MAY_MISS = ("gi", "matplotlib", "asyncua", "psycopg", "pyarrow", "libkernel")
_STUBS = {
    "libopenblasp": "ABORT", "libavcodec": "ABORT", "libavformat": "ABORT", "libavutil": "ABORT",
    "libswscale": "ABORT", "libaom": "FAIL",
}  # fmt: skip
"""Behaviour of the stub functions of OpenCV's libraries for LAPACK, video and AV1, by library.

altd calls no OpenCV function that needs them. With their dependencies they take 80 MB. A picture in AVIF is
then unreadable.
"""
_STUB = """#include <stdlib.h>
#include <unistd.h>
#define SAID(name) "altd: left out: " #name "\\n"
#define ABORT(name) int name(void) { (void)!write(2, SAID(name), sizeof SAID(name) - 1); abort(); }
#define FAIL(name) int name(void) { return -1; }
"""


def closure(extras: Sequence[str]) -> set[str]:
    """Names of the packages that altd imports with these extras, from the metadata in this environment."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    lines = [*project["dependencies"]]
    for extra in extras:
        lines += project["optional-dependencies"][extra]
    found: set[str] = set()
    wanted = [Requirement(line) for line in lines]
    while wanted:
        one = wanted.pop()
        name = canonicalize_name(one.name)
        if name in found and not one.extras:
            continue
        found.add(name)
        for line in distribution(name).requires or ():
            further = Requirement(line)
            marker = further.marker
            if marker is None or any(marker.evaluate({"extra": extra}) for extra in ("", *one.extras)):
                wanted.append(further)
    return found


def locked(names: set[str]) -> str:
    """Lines of the lock for these packages, with their hashes."""
    parts = re.findall(
        r"^([a-z0-9.-]+)(==.*?)(?=^\S|\Z)", (ROOT / "requirements.lock").read_text(), re.M | re.S
    )
    return "".join(name + line for name, line in parts if name in names)


def run(*command: str | Path, **environment: str) -> str:
    """Run a program and return its standard output; raises CalledProcessError."""
    done = subprocess.run(  # noqa: S603  programs of the builder's machine
        command, check=True, stdout=subprocess.PIPE, text=True, env={**os.environ, **environment}
    )
    return done.stdout


def install(site: Path, extras: Sequence[str]) -> None:
    """Install altd and its dependencies into ``site``, from wheels that match the lock."""
    pip = (sys.executable, "-m", "pip", "--disable-pip-version-check", "-qq")
    target = ("--target", site, "--no-compile", "--no-deps")
    with tempfile.TemporaryDirectory() as folder:
        lock = Path(folder, "lock")
        lock.write_text(locked(closure(extras)))
        run(*pip, "install", *target, "--require-hashes", "--only-binary=:all:", "-r", lock)
        run(*pip, "wheel", "--no-deps", "--no-build-isolation", "--no-index", "-w", folder, ROOT)
        (wheel,) = Path(folder).glob("altd-*.whl")
        run(*pip, "install", *target, "--no-index", wheel)
    shutil.rmtree(site / "bin", ignore_errors=True)
    for leftover in site.glob("*.dist-info/direct_url.json"):  # contains a path of the build machine
        leftover.unlink()


def slim(site: Path, place: str) -> None:
    """Remove unused files and compile the imported modules, with ``place`` on the unit as their path."""
    for pattern in _NEEDLESS:
        for path in list(site.glob(pattern)):
            if path.is_dir():
                shutil.rmtree(path)
            elif "altd" not in path.relative_to(site).parts:
                path.unlink()
    stub_opencv(site)
    kernel = (
        site / "altd" / "vision" / "libkernel.so"
    )  # only this file: strip would destroy auditwheel's changes in the wheels' libraries
    run("strip", "--strip-unneeded", kernel)
    isolated = (sys.executable, "-S", "-B", "-c", _IMPORTED, str(site), *_MAY_MISS)
    imported = run(*isolated, PYTHONPATH=str(site)).split()
    # never validated against the source's time, which dpkg, cp and tar preserve differently
    compiled = (
        "-m",
        "compileall",
        "-q",
        "--invalidation-mode",
        "unchecked-hash",
        "-s",
        str(site),
        "-p",
        place,
    )
    files = sorted({*imported, *map(str, (site / "altd").rglob("*.py"))})
    run(sys.executable, *compiled, *files, PYTHONHASHSEED="0")


def stub_opencv(site: Path) -> None:
    """Replace each library of ``_STUBS`` by a stub, and remove the libraries that only these need."""
    folder = site / "opencv_python_headless.libs"
    users, wanted, kept = [site / "cv2" / "cv2.abi3.so"], [site / "cv2" / "cv2.abi3.so"], set[Path]()
    stubs: dict[Path, str] = {}
    while wanted:
        for name in re.findall(r"\(NEEDED\).*\[(.+)\]", run("readelf", "-d", wanted.pop())):
            library = folder / name
            if not library.exists() or library in kept:
                continue
            kept.add(library)
            if (how := _STUBS.get(name.partition("-")[0])) is not None:
                stubs[library] = how
            else:
                users.append(library)
                wanted.append(library)
    missing = {
        line.split("@")[0].split()[-1] for user in users for line in _symbols(user, "--undefined-only")
    }
    for library, how in stubs.items():
        kinds = {
            words[2].split("@")[0]: words[1]
            for line in _symbols(library, "--defined-only")
            if (words := line.split())
        }
        used = sorted(missing & kinds.keys())
        if data := [name for name in used if kinds[name] not in "TWi"]:
            raise SystemExit(f"{library.name} cannot be left out: {data[0]} is no function")
        source = library.with_suffix(".c")
        source.write_text(_STUB + "".join(f"{how}({name})\n" for name in used))
        run(
            "gcc",
            "-shared",
            "-fPIC",
            "-O1",
            "-fno-builtin",
            "-w",
            f"-Wl,-soname,{library.name}",
            "-o",
            library,
            source,
        )
        source.unlink()
    for library in set(folder.iterdir()) - kept:
        library.unlink()


def _symbols(library: Path, which: str) -> list[str]:
    return run("nm", "-D", which, library).splitlines()


def environment(tree: Path, version: str, extras: Sequence[str]) -> None:
    """Build a virtual environment for ``HOME/version`` in ``tree``, with its unit files."""
    place = f"lib/{_PYTHON}/site-packages"
    site = tree / place
    site.mkdir(parents=True)
    install(site, extras)
    slim(site, f"{HOME}/{version}/{place}")
    (tree / "pyvenv.cfg").write_text(
        f"home = /usr/bin\ninclude-system-site-packages = true\nversion = {sys.version.split()[0]}\n"
    )
    (tree / "bin").mkdir()
    (tree / "bin" / "python3").symlink_to(f"../../../../bin/{_PYTHON}")
    script = (
        f"#!{HOME}/{version}/bin/python3 -s\nimport sys\nfrom altd.cli.main import main\n\nsys.exit(main())\n"
    )
    _write(tree / "bin" / "altd", script)
    for name, text in units().items():
        _write(tree / "systemd" / name, text)


def units() -> dict[str, str]:
    """Unit file of the service, and the template for several units on one computer."""
    service = (SYSTEMD / "altd.service").read_text()
    template = service.replace("/etc/altd/altd.toml", "/etc/altd/%i.toml")
    for key in ("StateDirectory", "RuntimeDirectory"):
        template = template.replace(f"\n{key}=altd\n", f"\n{key}=altd-%i\n")
    template = template.replace("of the Active Laser Target", "of the Active Laser Target %i")
    return {"altd.service": service, "altd@.service": template}


def package(root: Path, version: str, extras: Sequence[str], made: datetime) -> None:
    """Write the files of the package and its control files below ``root``."""
    environment(root / HOME[1:] / "package", version, extras)
    usr = root / "usr"
    for name, text in units().items():
        _write(usr / "lib" / "systemd" / "system" / name, text)
    (usr / "bin").mkdir()
    (usr / "bin" / "altd").symlink_to("../lib/altd/current/bin/altd")
    _write(usr / "lib" / "altd" / "switch", (DEBIAN / "switch").read_text())
    for source, place in {
        SYSTEMD / "60-altd.rules": "udev/rules.d/60-altd.rules",
        SYSTEMD / "altd.sysctl": "sysctl.d/60-altd.conf",
        SYSTEMD / "altd.sysusers": "sysusers.d/altd.conf",
    }.items():
        _write(usr / "lib" / place, source.read_text())
    share = usr / "share"
    _write(share / "man" / "man1" / "altd.1.gz", gzip.compress(man_page(made).encode(), mtime=0))
    _write(share / "bash-completion" / "completions" / "altd", completion())
    doc = share / "doc" / "altd"
    signed = f" -- {MAINTAINER}  {format_datetime(made)}\n"
    entry = f"altd ({version}) stable; urgency=medium\n\n  * CHANGELOG.md.gz\n\n{signed}"
    _write(doc / "changelog.gz", gzip.compress(entry.encode(), mtime=0))
    _write(doc / "CHANGELOG.md.gz", gzip.compress((ROOT / "CHANGELOG.md").read_bytes(), mtime=0))
    _write(doc / "copyright", (DEBIAN / "copyright").read_text() + _licences(extras))
    for name in ("live.toml", "desk.toml"):
        _write(doc / "examples" / name, (ROOT / "config" / name).read_text())
    _write(share / "lintian" / "overrides" / "altd", (DEBIAN / "lintian-overrides").read_text())
    size_kib = sum(-(-path.lstat().st_size // 1024) for path in root.rglob("*") if not path.is_dir())
    fields = {
        "@VERSION@": version,
        "@MAINTAINER@": MAINTAINER,
        "@ARCHITECTURE@": run("dpkg", "--print-architecture").strip(),
        "@SIZE@": str(size_kib),
        "@PYTHON@": f"python3 (>= 3.{sys.version_info.minor}), python3 (<< 3.{sys.version_info.minor + 1})",
    }
    for name in ("control", "postinst", "prerm", "postrm"):
        text = (DEBIAN / name).read_text()
        for field, value in fields.items():
            text = text.replace(field, value)
        _write(root / "DEBIAN" / name, text)
    sums = [
        f"{md5(path.read_bytes(), usedforsecurity=False).hexdigest()}  {path.relative_to(root)}\n"
        for path in sorted(usr.rglob("*"))
        if path.is_file() and not path.is_symlink()
    ]
    _write(root / "DEBIAN" / "md5sums", "".join(sums))


def _licences(extras: Sequence[str]) -> str:
    names = closure(extras)
    packages = (one for one in run_time_packages(ROOT) if one.name in names)
    return "".join(f"  {one.name} {one.version}: {one.declared}\n" for one in packages)


def _write(path: Path, content: str | bytes) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(content.encode() if isinstance(content, str) else content)


def main(extras: Sequence[str]) -> None:
    """Build the package; equal sources give equal bytes."""
    os.umask(0o022)
    epoch = os.environ.get("SOURCE_DATE_EPOCH") or run("git", "-C", ROOT, "log", "-1", "--format=%ct").strip()
    os.environ["SOURCE_DATE_EPOCH"] = epoch
    version = "+".join([__version__, *sorted(extras)])
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder, "root")
        root.mkdir(mode=0o755)
        package(root, version, extras, datetime.fromtimestamp(int(epoch), UTC))
        home = root / HOME[1:]
        programs = {home / "switch", home / "package" / "bin" / "altd", *(root / "DEBIAN").glob("p*")}
        for path in root.rglob("*"):
            if not path.is_symlink():
                path.chmod(0o755 if path.is_dir() or path in programs else 0o644)
        (ROOT / "dist").mkdir(exist_ok=True)
        print(run("dpkg-deb", "--root-owner-group", "-Zxz", "-z1", "--build", root, ROOT / "dist").strip())


if __name__ == "__main__":
    main([extra for extra in sys.argv[1:] if extra])
