"""``.ci/lanes``: which tests are due for a commit; ``.ci/tests``: all parts run, whatever fails."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from support.places import ROOT

DAY_S = 24 * 3600
TURNS = ("workshop", "package", "python", "simulator")
MARKS = ("real_time", "waits", "alone", "own_network", "long")


class Project:
    """A repository with the script and a file in each folder; its first commit is in 2024."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._now_s = 20_000 * DAY_S
        self.commits = 0
        (folder / ".ci").mkdir(parents=True)
        shutil.copy(ROOT / ".ci" / "lanes", folder / ".ci")
        self._run("git", "init", "-q")
        for touched in ("benchmarks", "systemd", "hw_sim", "altd"):
            (folder / touched).mkdir()
            (folder / touched / "a_file").write_text("")
        (folder / "requirements.lock").write_text("")
        self._run("git", "add", "-A")
        self.commit(after_s=0)

    def commit(self, count: int = 1, *, after_s: int = DAY_S) -> None:
        for _ in range(count):
            self._now_s += after_s
            self.commits += 1
            name = ["-c", "user.name=a", "-c", "user.email=a@example.org"]
            self._run("git", *name, "commit", "-qam", "a change", "--allow-empty")

    def touch(self, file: str) -> None:
        (self.folder / file).write_text(f"{self.commits}")

    def due(self, *words: str) -> list[str]:
        return self._run(".ci/lanes", *words).splitlines()

    def _run(self, *command: str) -> str:
        dates = dict.fromkeys(("GIT_COMMITTER_DATE", "GIT_AUTHOR_DATE"), f"@{self._now_s} +0000")
        environment = {**os.environ, **dates}
        done = subprocess.run(
            command, cwd=self.folder, env=environment, capture_output=True, text=True, check=True
        )
        return done.stdout


@pytest.fixture
def project(tmp_path: Path) -> Project:
    """With a history of 64 commits, in which nothing was touched for long."""
    project = Project(tmp_path / "project")
    project.commit(63)
    return project


def test_without_a_touched_folder_four_successive_commits_run_each_lane_once(project: Project) -> None:
    ran = []
    for _ in TURNS:
        (due,) = project.due()
        assert due == TURNS[project.commits % 4]
        later = project.due("later")
        assert len(later) == 3
        ran.append(due)
        project.commit()
        assert f"{project.due()[0]} (at {project.commits} commits)" in later
    assert sorted(ran) == sorted(TURNS)


@pytest.mark.parametrize(
    ("file", "lanes"),
    [
        ("benchmarks/a_file", {"workshop"}),
        ("systemd/a_file", {"package"}),
        ("hw_sim/a_file", {"simulator"}),
        ("requirements.lock", {"package", "python"}),
        ("altd/a_file", set()),
    ],
)
def test_a_lane_is_due_for_sixty_commits_after_a_change(project: Project, file: str, lanes: set[str]) -> None:
    project.touch(file)
    project.commit(60)
    assert set(project.due()) == lanes | {TURNS[project.commits % 4]}
    project.commit(1)
    assert set(project.due()) == {TURNS[project.commits % 4]}


def test_in_a_clone_without_its_history_all_are_due(project: Project, tmp_path: Path) -> None:
    clone = tmp_path / "clone"
    source = project.folder.as_uri()
    subprocess.run(["git", "clone", "-q", "--depth", "20", source, clone], check=True)
    lanes = subprocess.run([clone / ".ci" / "lanes"], capture_output=True, text=True, check=True).stdout
    assert lanes.split() == list(TURNS)


def test_all_parts_run_after_a_failure_and_a_test_that_fails_once_is_listed(tmp_path: Path) -> None:
    (tmp_path / ".ci").mkdir()
    shutil.copy(ROOT / ".ci" / "tests", tmp_path / ".ci")
    (tmp_path / "tests" / "unit").mkdir(parents=True)
    (tmp_path / "tests" / "system").mkdir()
    markers = "".join(f"    {mark}: a mark\n" for mark in MARKS)
    (tmp_path / "pytest.ini").write_text(f"[pytest]\nmarkers =\n{markers}")
    ran = tmp_path / "ran"
    stat, number = tmp_path / "stat", f"len(open({str(ran)!r}).read()) * 10**6"
    stat.write_text("cpu  0 0 0 0 0 0 0 0 0 0\n")
    steal = f"open({str(stat)!r}, 'w').write('cpu  0 0 0 0 0 0 0 %d 0 0' % ({number}))"
    note = f"def note(name):\n    open({str(ran)!r}, 'a').write(name + ' ')\n"
    (tmp_path / "tests" / "unit" / "test_unit.py").write_text(
        f"{note}def test_bad():\n    note('unit')\n    assert False\n"
    )
    (tmp_path / "tests" / "system" / "test_system.py").write_text(
        f"import pytest\n{note}"
        "@pytest.mark.real_time\ndef test_late():\n    note('real_time')\n"
        f"    assert open({str(ran)!r}).read().count('real_time') == 2\n"
        "@pytest.mark.waits\ndef test_waits():\n    note('waits')\n"
        f"@pytest.mark.alone\ndef test_alone():\n    note('alone')\n    {steal}\n    assert False\n"
    )
    done = subprocess.run(
        [tmp_path / ".ci" / "tests"],
        env=os.environ
        | {
            "VENV": sys.prefix,
            "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1",
            "PYTEST_ADDOPTS": "-p xdist",
            "TURN": "",
            "STAT": str(stat),
        },
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 1
    assert sorted(ran.read_text().split()) == [*4 * ["alone"], "real_time", "real_time", "unit", "waits"]
    assert done.stdout.count("% of the processors away") == 3
    assert "altd: tests failed: core alone\n" in done.stderr
    listed = done.stdout.partition("altd: failed at the first try, and repeated:\n")[2].split()
    assert listed == ["tests/system/test_system.py::test_late", "tests/system/test_system.py::test_alone"]


def test_a_lane_that_does_not_exist_is_one_line() -> None:
    done = subprocess.run([ROOT / ".ci" / "tests", "simulater"], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr == "altd: .ci/tests: there is no lane simulater\n"
