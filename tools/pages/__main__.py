"""The generated pages and drawings of docs: write those that changed, or check that all are up to date."""

import argparse
import sys
from collections.abc import Callable
from pathlib import Path

from tools.licences import licence_page
from tools.licences.installed import NotAsLockedError, run_time_packages
from tools.pages import (
    architecture,
    clients,
    commands,
    config,
    console,
    coordinates,
    decisions,
    desk,
    http,
    modbus,
    mqtt,
    mqtt_schema,
    opcua,
    proof,
    reasons,
    sparkplug,
    states_picture,
    tables,
    telegram,
)

FOLDER = Path(__file__).resolve().parents[2] / "docs"
PAGES: dict[str, Callable[[], str]] = {
    "architecture.svg": architecture.picture,
    "clients.md": clients.page,
    "commands.md": commands.page,
    "config.md": config.page,
    "console.md": console.page,
    "coordinates.svg": coordinates.picture,
    "decisions/README.md": decisions.page,
    "desk-dots.svg": desk.dots,
    "desk.svg": desk.picture,
    "http.md": http.page,
    "licences.md": lambda: licence_page.page(run_time_packages(FOLDER.parent)),
    "modbus.md": modbus.page,
    "mqtt.asyncapi.json": mqtt_schema.asyncapi,
    "mqtt.md": mqtt.page,
    "mqtt.schema.json": mqtt_schema.page,
    "opcua.md": opcua.page,
    "proof.md": proof.page,
    "reasons.md": reasons.page,
    "sparkplug.md": sparkplug.page,
    "states.svg": states_picture.picture,
    "tables.md": tables.page,
    "telegram.md": telegram.page,
}


def main(arguments: list[str] | None = None, folder: Path = FOLDER) -> int:
    """Write or check all pages; the exit status is 1 if one cannot be made, or is out of date."""
    parser = argparse.ArgumentParser(prog="python -m tools.pages", description=__doc__)
    parser.add_argument("--check", action="store_true", help="write nothing, name the pages to be written")
    is_check = parser.parse_args(arguments).check
    stale, failed = [], False
    for name, page in PAGES.items():
        path = folder / name
        try:
            text = page()
        except (ValueError, NotAsLockedError) as error:
            print(f"docs/{name} cannot be made: {error}", file=sys.stderr)
            failed = True
            continue
        if not path.is_file() or path.read_text(encoding="utf-8") != text:
            stale.append(f"docs/{name}")
            if not is_check:
                path.write_text(text, encoding="utf-8")
    if is_check and stale:
        print(f"out of date (make pages): {', '.join(stale)}", file=sys.stderr)
    elif stale:
        print(f"written: {', '.join(stale)}")
    elif not failed:
        print(f"all {len(PAGES)} generated pages are up to date")
    return int(failed or (is_check and bool(stale)))


if __name__ == "__main__":
    sys.exit(main())
