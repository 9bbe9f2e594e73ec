"""Trust in a release: the commands of docs/install.md, with the real ssh-keygen."""

import re
import shutil
import subprocess
from pathlib import Path

import pytest
from support.foreign import need
from support.places import ROOT

PAGE = (ROOT / "docs" / "install.md").read_text()
ARCHIVE = "altd_0.1.0_amd64.deb"


def command(beginning: str) -> str:
    """The one command of the page that begins so, with the lines that continue it."""
    (found,) = re.findall(rf"^    ({re.escape(beginning)}(?:.*\\\n)*.*)$", PAGE, re.MULTILINE)
    return str(found)


def run(folder: Path, line: str) -> subprocess.CompletedProcess[str]:
    line = line.replace("~/.ssh", str(folder))
    return subprocess.run(["bash", "-c", line], cwd=folder, capture_output=True, text=True, check=False)


@pytest.fixture
def release(tmp_path: Path) -> Path:
    """A folder with a key, a package and its signature, made as the page says."""
    need(shutil.which("ssh-keygen") is not None, "ssh-keygen (openssh-client) is not there")
    (tmp_path / "dist").mkdir()
    (tmp_path / "dist" / ARCHIVE).write_bytes(b"a release")
    for line in (
        command("ssh-keygen -t ") + " -N '' -q",  # for the test without a passphrase
        command('echo "altd-release '),
        command("ssh-keygen -Y sign"),
    ):
        done = run(tmp_path, line)
        assert done.returncode == 0, done.stderr
    for file in (tmp_path / "dist").iterdir():
        file.rename(tmp_path / file.name)
    return tmp_path


def test_the_archive_that_was_signed_is_good(release: Path) -> None:
    done = run(release, command("ssh-keygen -Y verify"))
    assert (done.returncode, done.stdout[:31]) == (0, 'Good "altd-release" signature f')


def test_a_changed_archive_is_refused(release: Path) -> None:
    (release / ARCHIVE).write_bytes(b"another release")
    done = run(release, command("ssh-keygen -Y verify"))
    assert done.returncode != 0
    assert "Good" not in done.stdout


def test_the_signature_of_another_key_is_refused(release: Path) -> None:
    for name in ("altd-release", "altd-release.pub", f"{ARCHIVE}.sig"):
        (release / name).unlink()
    for line in (command("ssh-keygen -t ") + " -N '' -q", command("ssh-keygen -Y sign").replace("dist/", "")):
        assert run(release, line).returncode == 0
    done = run(release, command("ssh-keygen -Y verify"))
    assert done.returncode != 0
    assert "Good" not in done.stdout
