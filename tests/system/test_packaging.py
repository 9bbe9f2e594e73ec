"""Promises of the lock, the Makefile and the wheel."""

import importlib.util
import re
import subprocess
import sys
import tomllib
import zipfile
from importlib.metadata import entry_points, version

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from support.cli import altd
from support.foreign import need
from support.places import ROOT

import altd as package

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
LOCKS = {name: (ROOT / name).read_text() for name in ("requirements.lock", "aravis.lock")}


def locked(lock: str = "requirements.lock") -> dict[str, str]:
    return dict(re.findall(r"^(\S+)==(\S+)", LOCKS[lock], re.MULTILINE))


def required() -> list[tuple[str, str]]:
    """Each lock with a line of pyproject.toml that it must fulfil."""
    project = PROJECT["project"]
    extras = project["optional-dependencies"]
    product = [
        *project["dependencies"],
        *(line for extra in extras if extra != "aravis" for line in extras[extra]),
        *PROJECT["build-system"]["requires"],
    ]
    return [
        *(("requirements.lock", line) for line in product if not line.startswith("altd[")),
        *(("aravis.lock", line) for line in extras["aravis"]),
    ]


class TestLock:
    @pytest.mark.parametrize("lock", LOCKS)
    def test_names_no_registry_and_no_place(self, lock: str) -> None:
        said = [line for line in LOCKS[lock].splitlines() if not line.startswith("#")]
        expected = re.compile(r"[a-z0-9.-]+==\S+( ; [^#]+)? \\|    --hash=sha256:[0-9a-f]{64}( \\)?")
        assert [line for line in said if not expected.fullmatch(line)] == []
        assert not re.search(r"https?:|file:|/", LOCKS[lock])

    @pytest.mark.parametrize(("lock", "line"), required())
    def test_has_what_the_project_asks_for(self, lock: str, line: str) -> None:
        wanted = Requirement(line)
        assert wanted.specifier.contains(locked(lock)[canonicalize_name(wanted.name)])

    def test_of_an_extra_has_the_versions_that_the_product_runs_on(self) -> None:
        product, extra = locked(), locked("aravis.lock")
        assert {name: extra[name] for name in product.keys() & extra.keys()} == {
            name: product[name] for name in product.keys() & extra.keys()
        }

    def test_is_what_these_tests_run_with(self) -> None:
        """Else they prove nothing about it; ``make test`` sees to that."""
        assert {name: version(name) for name in locked()} == locked()

    def test_is_what_gige_vision_is_tested_with(self) -> None:
        need(importlib.util.find_spec("gi") is not None, "PyGObject is not in .venv: make programs venv")
        assert {name: version(name) for name in locked("aravis.lock")} == locked("aravis.lock")


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    """The names of the files in the wheel."""
    folder = tmp_path_factory.mktemp("wheel")
    build = [sys.executable, "-m", "pip", "wheel", "-qq", "--no-deps", "--no-build-isolation", "--no-index"]
    subprocess.run([*build, "--wheel-dir", folder, ROOT], check=True)
    (path,) = folder.glob("*.whl")
    with zipfile.ZipFile(path) as archive:
        return archive.namelist()


class TestWheel:
    def test_has_the_daemon_with_all_that_it_reads(self, wheel: list[str]) -> None:
        sources = {str(path.relative_to(ROOT)) for path in (ROOT / "altd").rglob("*") if path.is_file()}
        assert {name for name in sources if "__pycache__" not in name} <= set(wheel)
        assert {"altd/py.typed", "altd/publish/http/page_files/index.html"} <= set(wheel)

    def test_has_nothing_else(self, wheel: list[str]) -> None:
        assert {name.split("/")[0] for name in wheel} == {"altd", f"altd-{package.__version__}.dist-info"}


class TestInstalled:
    def test_the_command_says_the_version(self) -> None:
        assert altd("--version").out == f"altd {package.__version__}\n"
        assert version("altd") == package.__version__

    @pytest.mark.parametrize("name", PROJECT["project"]["scripts"])
    def test_each_command_is_there(self, name: str) -> None:
        (command,) = entry_points(group="console_scripts", name=name)
        assert callable(command.load())


class TestMakefile:
    def test_alone_it_says_what_there_is(self) -> None:
        said = subprocess.run(["make", "-C", ROOT], capture_output=True, text=True, check=True).stdout
        for target in ("demo", "test", "check", "bench", "pages", "pictures"):
            assert f"make {target} " in said
