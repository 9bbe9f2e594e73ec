import json
import re
from datetime import date
from pathlib import Path
from typing import Any

import pytest
from packaging.version import Version
from support.places import ROOT

from tools.audit import LIST, faults, locked, main, updated


def advisory(*events: dict[str, str], versions: tuple[str, ...] = ()) -> dict[str, Any]:
    package = {"ecosystem": "PyPI", "name": "Some_Package"}
    ranges = [{"type": "ECOSYSTEM", "events": list(events)}] if events else []
    affected = {"package": package, "ranges": ranges, "versions": list(versions)}
    return {"id": "A-1", "modified": "2026-01-01T00:00:00Z", "affected": [affected]}


@pytest.mark.parametrize(
    ("record", "affected"),
    [
        (advisory({"introduced": "0"}, {"fixed": "2.0"}), ["1.0", "2.0rc1"]),
        (advisory({"fixed": "2.0"}, {"introduced": "1.5"}), ["2.0rc1"]),
        (advisory({"introduced": "2.0"}), ["2.0", "2.1", "10.0"]),
        (advisory({"introduced": "0"}, {"last_affected": "2.0"}), ["1.0", "2.0rc1", "2.0"]),
        (
            advisory({"introduced": "0"}, {"fixed": "1.0"}, {"introduced": "2.1"}, {"fixed": "3"}),
            ["2.1"],
        ),
        (advisory(versions=("2.0.0", "10.0")), ["2.0", "10.0"]),
    ],
)
def test_the_ranges_are_those_of_the_osv_schema(record: dict[str, Any], affected: list[str]) -> None:
    packages = {"some-package": {Version(text) for text in ("1.0", "2.0rc1", "2.0", "2.1", "10.0")}}
    assert list(faults(packages, [record])) == [f"some-package {each}: A-1" for each in affected]
    assert list(faults({"another": {Version("1.0")}}, [record])) == []


def test_the_locked_packages_are_in_no_stored_advisory_and_older_ones_are(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(ROOT)
    monkeypatch.setattr("sys.argv", ["audit"])
    assert main() == 0
    for lock in ("requirements.lock", "aravis.lock"):
        text = (ROOT / lock).read_text()
        (tmp_path / lock).write_text(re.sub(r"^h11==\S+", "h11==0.15.0", text, flags=re.MULTILINE))
    monkeypatch.chdir(tmp_path)
    assert main() == 1
    said = capsys.readouterr()
    assert said.err == "audit: h11 0.15.0: CVE-2025-43859\n"
    assert "a list of" in said.out


def test_an_update_keeps_what_is_locked_and_not_withdrawn(tmp_path: Path) -> None:
    record = advisory({"introduced": "0"}) | {"details": "long text"}
    other = {"package": {"ecosystem": "npm", "name": "some-package"}}
    for name, content in {
        "a": record,
        "b": record | {"withdrawn": "2026-01-02T00:00:00Z"},
        "c": record | {"affected": [other]},
    }.items():
        (tmp_path / f"{name}.json").write_text(json.dumps(content))
    made = updated(tmp_path, {"some-package": {Version("1")}}, "an export", date(2026, 11, 26))
    assert made["advisories"] == [{key: record[key] for key in ("id", "modified", "affected")}]
    assert (made["date"], made["source"]) == ("2026-11-26", "an export")
    assert updated(tmp_path, locked(ROOT), "", date.today())["advisories"] == []


def test_the_list_states_its_date_and_source() -> None:
    stored = json.loads(LIST.read_text())
    assert date.fromisoformat(stored["date"]) <= date.today()
    assert stored["source"]
