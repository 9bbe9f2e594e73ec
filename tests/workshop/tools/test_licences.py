"""The check of licences, on packages made up for it, and on those that altd runs on."""

import ctypes
import importlib.metadata
import json
import subprocess
import sys
from dataclasses import dataclass, field
from pathlib import Path

import pytest
from PIL import features
from support.foreign import need
from support.places import ROOT

from tools.licences import installed
from tools.licences.check import faults
from tools.licences.installed import Component, NotAsLockedError, run_time_packages
from tools.licences.licence_page import page

GPL = "License :: OSI Approved :: GNU General Public License v3 (GPLv3)"
GPL_TITLE = "GNU GENERAL PUBLIC LICENSE"
MIT = "License :: OSI Approved :: MIT License"


@dataclass
class Project:
    """A project that asks for one package, ``fake``, and the folder in which that one is installed."""

    folder: Path
    site: Path
    depends: str = "fake"
    lock: list[str] = field(default_factory=list)

    def install(
        self, *lines: str, name: str = "fake", version: str = "1.0", files: dict[str, str] | None = None
    ) -> None:
        """A package whose metadata have these lines, and the files by their paths."""
        about = [f"Metadata-Version: 2.4\nName: {name}\nVersion: {version}", *lines]
        files = {f"{name}-{version}.dist-info/METADATA": "\n".join(about) + "\n", **(files or {})}
        for path, text in files.items():
            (self.site / path).parent.mkdir(parents=True, exist_ok=True)
            (self.site / path).write_text(text)
        (self.site / f"{name}-{version}.dist-info/RECORD").write_text("".join(f"{one},,\n" for one in files))
        self.lock.append(f"{name}=={version} \\")

    def write(self) -> Path:
        extras = 'test = ["only-for-tests"]'
        (self.folder / "pyproject.toml").write_text(
            f'[project]\nname = "altd"\ndependencies = ["{self.depends}"]\n'
            f"[project.optional-dependencies]\n{extras}\n"
        )
        (self.folder / "requirements.lock").write_text("\n".join(self.lock) + "\n")
        (self.folder / "aravis.lock").write_text("")
        return self.folder

    def faults(self) -> list[str]:
        found = faults(run_time_packages(self.write()))
        return [fault for fault in found if not fault.endswith("nothing says what altd needs it for")]


@pytest.fixture
def project(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Project:
    folder, site = tmp_path / "project", tmp_path / "site"
    folder.mkdir()
    site.mkdir()
    monkeypatch.syspath_prepend(str(site))
    return Project(folder, site)


class TestPackages:
    @pytest.mark.parametrize(
        "lines",
        [
            ["License-Expression: MIT"],
            ["License: MIT"],
            [f"Classifier: {MIT}"],
            ["License-Expression: Apache-2.0 OR GPL-3.0-only"],
            ["License: BSD-3-Clause", "Classifier: License :: OSI Approved :: BSD License"],
        ],
    )
    def test_one_that_goes(self, project: Project, lines: list[str]) -> None:
        project.install(*lines)
        assert project.faults() == []

    @pytest.mark.parametrize(
        ("lines", "words"),
        [
            (
                ["License-Expression: GPL-3.0-or-later"],
                "fake 1.0 is GPL-3.0-or-later, which does not go with",
            ),
            (["License: GPL-3.0-only"], "fake 1.0 is GPL-3.0-only, which does not go"),
            (["License-Expression: LGPL-2.1-or-later"], "fake 1.0 is LGPL-2.1-or-later, which does not go"),
            (["License-Expression: MIT AND AGPL-3.0-only"], "is MIT AND AGPL-3.0-only, which does not go"),
            ([f"Classifier: {GPL}"], "does not say its licence as one SPDX expression"),
            (["License: GNU GPL 3"], "does not say its licence as one SPDX expression: 'GNU GPL 3'"),
            ([], "does not say its licence as one SPDX expression: 'nothing'"),
            (
                ["License: MIT", f"Classifier: {GPL}"],
                "does not say its licence as one SPDX expression: 'MIT; GNU",
            ),
            ([f"Classifier: {MIT}", f"Classifier: {GPL}"], "does not say its licence as one SPDX expression"),
            (["License: MIT", "        but for the parts under the GPL"], "'MIT …'"),
            (["Classifier: License :: OSI Approved :: BSD License"], "does not say its licence as one SPDX"),
        ],
    )
    def test_one_that_does_not(self, project: Project, lines: list[str], words: str) -> None:
        project.install(*lines)
        (fault,) = project.faults()
        assert words in fault

    def test_one_that_another_needs(self, project: Project) -> None:
        project.install("License-Expression: MIT", "Requires-Dist: middle")
        project.install(
            "License-Expression: MIT", "Requires-Dist: under", "Requires-Dist: fake", name="middle"
        )
        project.install("License-Expression: GPL-2.0-only", name="under")
        expected = "under 1.0 is GPL-2.0-only, which does not go with Apache-2.0 (needed by middle)"
        assert project.faults() == [expected]

    def test_one_of_an_extra_that_is_asked_for(self, project: Project) -> None:
        project.depends = "fake[fast]"
        project.install("License-Expression: MIT", "Requires-Dist: under; extra == 'fast'")
        project.install("License-Expression: GPL-2.0-only", name="under")
        assert "(needed by fake)" in project.faults()[0]

    def test_one_of_another_system_python_or_extra_is_none(self, project: Project) -> None:
        markers = ("sys_platform == 'win32'", "python_version < '3.11'", "extra == 'slow'")
        project.install(
            "License-Expression: MIT", *(f"Requires-Dist: absent; {marker}" for marker in markers)
        )
        assert project.faults() == []

    def test_one_that_altd_needs_for_nothing_known(self, project: Project) -> None:
        project.install("License-Expression: MIT")
        assert list(faults(run_time_packages(project.write()))) == [
            "fake 1.0: nothing says what altd needs it for"
        ]

    def test_one_that_was_read_by_hand_and_says_something_else_now(self, project: Project) -> None:
        project.depends = "pyserial"
        project.install("License: Server Side Public License", name="pyserial", version="9.0")
        (fault,) = project.faults()
        assert fault.startswith(
            "pyserial 9.0 says 'Server Side Public License', no longer 'BSD; BSD License'"
        )


class TestEnvironment:
    def test_that_lacks_a_package(self, project: Project) -> None:
        project.lock.append("fake==1.0 \\")
        with pytest.raises(NotAsLockedError, match=r"fake 1\.0 is not installed: make venv"):
            project.faults()

    def test_with_another_version(self, project: Project) -> None:
        project.install("License-Expression: MIT")
        project.lock = ["fake==1.1 \\"]
        with pytest.raises(NotAsLockedError, match=r"fake 1\.0 is installed, the lock has 1\.1"):
            project.faults()

    def test_a_lock_that_lacks_a_package(self, project: Project) -> None:
        with pytest.raises(NotAsLockedError, match="fake is in no lock"):
            project.faults()


def cyclonedx(*components: dict[str, object]) -> dict[str, str]:
    return {"fake-1.0.dist-info/sboms/parts.json": json.dumps({"components": components})}


class TestBroughtAlong:
    @pytest.mark.parametrize(
        ("files", "words"),
        [
            (
                cyclonedx({"name": "quant", "licenses": [{"license": {"id": "GPL-3.0-or-later"}}]}),
                "quant in fake 1.0 is GPL-3.0-or-later, which does not go with Apache-2.0",
            ),
            (
                cyclonedx(
                    {
                        "name": "one",
                        "licenses": [{"expression": "MIT OR X11"}, {"expression": "GPL-2.0-only"}],
                    }
                ),
                "one in fake 1.0 is (MIT OR X11) AND GPL-2.0-only, which",
            ),
            (cyclonedx({"name": "one"}), "one in fake 1.0 is of no stated licence, which does not go"),
            (
                {"fake-1.0.dist-info/LICENSE": "MIT\n\nName: solver\nLicense: GPL-2.0-only\n  text\n"},
                "solver in fake 1.0 is GPL-2.0-only, which does not go",
            ),
            (
                {"fake-1.0.dist-info/licenses/a/b.txt": f"Parts:\n\n  {GPL_TITLE}\n   Version 2, 1991\n"},
                "fake 1.0 has a whole licence text, GPL, of an unknown part",
            ),
            (
                {"fake/solver/LICENSE.txt": f"{GPL_TITLE}\nVersion 3, 29 June 2007\n"},
                "fake 1.0 has a whole licence text, GPL, of an unknown part",
            ),
            (
                {"fake-1.0.dist-info/COPYING": "# GNU Affero General Public License\n\n_Version 3_, 2007\n"},
                "fake 1.0 has a whole licence text, AGPL, of an unknown part",
            ),
            (
                {"fake.libs/libgpl-12345678.so.1": ""},
                "brings fake.libs/libgpl-12345678.so.1 along, whose licence",
            ),
        ],
    )
    def test_a_part_that_does_not_go(self, project: Project, files: dict[str, str], words: str) -> None:
        project.install("License-Expression: MIT", files=files)
        (fault,) = project.faults()
        assert words in fault

    @pytest.mark.parametrize(
        "files",
        [
            cyclonedx({"name": "one", "licenses": [{"license": {"id": "MIT"}}]}),
            cyclonedx({"name": "libfoo", "purl": "pkg:rpm/almalinux/libfoo@1"}),
            {"fake-1.0.dist-info/LICENSE": "It goes with the GNU General Public License\nversion 2 too.\n"},
            {"fake/licence.py": '"""\nGNU GENERAL PUBLIC LICENSE\nVersion 2\n"""\n'},
        ],
    )
    def test_a_part_that_goes(self, project: Project, files: dict[str, str]) -> None:
        project.install("License-Expression: MIT", files=files)
        assert project.faults() == []


class TestThisProject:
    def test_linuxpy_would_be_refused(self, project: Project) -> None:
        """It was asked for until 2026-11: this is what its metadata say."""
        named = "linuxpy 0.25.0"
        lines = [
            "Metadata-Version: 2.4\nName: linuxpy\nVersion: 0.25.0",
            "License-Expression: GPL-3.0-or-later",
            "License-File: LICENSE",
        ]
        dist_info = project.site / "linuxpy-0.25.0.dist-info"
        dist_info.mkdir()
        (dist_info / "METADATA").write_text("\n".join(lines) + "\n")
        for name in ("pyproject.toml", "requirements.lock", "aravis.lock"):
            text = (ROOT / name).read_text()
            if name == "requirements.lock":
                text += "linuxpy==0.25.0 \\\n"
            (project.folder / name).write_text(
                text.replace("dependencies = [\n", 'dependencies = [\n    "linuxpy>=0.25",\n', 1)
            )
        ended = subprocess.run(
            [sys.executable, "-m", "tools.licences", project.folder],
            cwd=ROOT,
            env={"PYTHONPATH": str(project.site)},
            capture_output=True,
            text=True,
            check=False,
        )
        assert ended.returncode == 1
        assert ended.stdout == ""
        refused, unknown = ended.stderr.splitlines()
        assert (
            refused
            == f"licences: {named} is GPL-3.0-or-later, which does not go with Apache-2.0 (needed by altd)"
        )
        assert unknown == f"licences: {named}: nothing says what altd needs it for"

    def test_all_that_altd_runs_on_goes(self) -> None:
        packages = run_time_packages(ROOT)
        assert list(faults(packages)) == []
        assert {"numpy", "pydantic-core", "matplotlib", "pygobject", "pycairo"} <= {
            one.name for one in packages
        }
        assert not {"pytest", "hypothesis", "scipy", "linuxpy"} & {one.name for one in packages}

    def test_a_part_that_was_read_and_has_another_licence_now(self) -> None:
        (numpy,) = (one for one in run_time_packages(ROOT) if one.name == "numpy")
        numpy.components = tuple(
            Component(one.name, "GPL-3.0-only" if one.name == "OpenBLAS" else one.licence)
            for one in numpy.components
        )
        (fault,) = faults([numpy])
        assert fault.startswith("OpenBLAS in numpy ")
        assert fault.endswith("is GPL-3.0-only, no longer BSD-3-Clause: read it again")

    @pytest.mark.parametrize("machine", ["x86_64", "aarch64"])
    def test_a_part_that_is_gone_is_told_where_it_was_read(
        self, monkeypatch: pytest.MonkeyPatch, machine: str
    ) -> None:
        monkeypatch.setattr("platform.machine", lambda: machine)
        (numpy,) = (one for one in run_time_packages(ROOT) if one.name == "numpy")
        numpy.libraries = ()
        gone = [fault.split(" does not bring ")[1] for fault in faults([numpy])]
        names_of_parts = ["OpenBLAS", "libgfortran", "libquadmath"] if machine == "x86_64" else []
        assert gone == [f"{name} along any more" for name in names_of_parts]

    def test_the_page_is_the_same_where_pygobject_is_not_compiled(
        self, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        need(
            all(one.is_installed for one in run_time_packages(ROOT)),
            "PyGObject is not in .venv: make programs venv",
        )
        there = page(run_time_packages(ROOT))

        def without(name: str) -> importlib.metadata.Distribution:
            if name in ("pygobject", "pycairo"):
                raise importlib.metadata.PackageNotFoundError(name)
            return importlib.metadata.distribution(name)

        monkeypatch.setattr(installed, "distribution", without)
        packages = run_time_packages(ROOT)
        assert page(packages) == there
        assert list(faults(packages)) == []

    def test_ffmpeg_says_that_it_was_built_without_its_gpl_parts(self) -> None:
        files = importlib.metadata.files("opencv-python-headless") or []
        libraries = [
            one for one in files if one.name.startswith(("libavcodec-", "libavformat-", "libavutil-"))
        ]
        assert len(libraries) == 3
        for library in libraries:
            licence = getattr(ctypes.CDLL(str(library.locate())), library.name.split("-")[0][3:] + "_license")
            licence.restype = ctypes.c_char_p
            assert licence() == b"LGPL version 2.1 or later"

    def test_pillow_says_that_libimagequant_is_not_in_it(self) -> None:
        assert features.check("libimagequant") is False
        assert features.check("webp") is True
