import json
import re

from support.places import ROOT

from tools.licences.installed import run_time_packages
from tools.sbom import sbom


def test_has_what_a_unit_runs_on_with_the_hashes_of_the_lock() -> None:
    document = sbom(ROOT)
    assert document == sbom(ROOT), "the same bytes again"
    components = {component["bom-ref"]: component for component in document["components"]}
    assert len(components) == len(document["components"])
    assert {(each["name"], each["version"]) for each in components.values()} == {
        (package.name, package.version) for package in run_time_packages(ROOT)
    }
    assert all(each["licenses"] for each in components.values())
    lock = (ROOT / "requirements.lock").read_text()
    (entry,) = re.findall(r"^numpy==\S+ \\\n((?:    --hash=\S+(?: \\\n|\n))+)", lock, re.MULTILINE)
    (numpy,) = [each for each in components.values() if each["name"] == "numpy"]
    (files,) = numpy["externalReferences"]
    assert [each["content"] for each in files["hashes"]] == re.findall(r"sha256:(\w+)", entry)


def test_every_part_is_reached_from_altd() -> None:
    document = sbom(ROOT)
    needs = {each["ref"]: each["dependsOn"] for each in document["dependencies"]}
    reached, waiting = set(), ["altd"]
    while waiting:
        if (name := waiting.pop()) not in reached:
            reached.add(name)
            waiting += needs[name]
    assert reached == {"altd", *(component["bom-ref"] for component in document["components"])}
    assert not re.search(r"https?:", json.dumps(document))
