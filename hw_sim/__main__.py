"""``python -m hw_sim``: the simulator's commands."""

from __future__ import annotations

import sys
from collections.abc import Sequence

from altd.cli.arguments import Parser
from altd.process.endings import run_to_end
from hw_sim import demo, flat, measure, plate, scan
from hw_sim.gige import command as gige

COMMANDS = {
    "scan": (scan, "record a calibration scan"),
    "flat": (flat, "record the flat field: the targets in even light"),
    "plate": (plate, "record a calibration plate of LEDs"),
    "demo": (demo, "run the whole unit, simulated, and watch it"),
    "gige": (gige, "serve the unit's cameras on the network, by GigE Vision"),
    "measure": (measure, "record poses of the beam, with their truth"),
}
"""Each command is a module with ``add_arguments(parser)`` and ``run(arguments) -> exit status``."""


FIRST_STEPS = """first steps:
  python -m hw_sim demo            a simulated unit, measured: values and truth in the terminal
  python -m hw_sim scan -o DIR     a calibration scan, for altd calibrate
  python -m hw_sim COMMAND --help  what a command takes
"""


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command; the exit status, 2 for what the caller did wrong."""
    prog = "python -m hw_sim"
    parser = Parser(prog=prog, description="A simulated Active Laser Target.", epilog=FIRST_STEPS)
    commands = parser.add_subparsers(dest="command", metavar="COMMAND", title="commands")
    for name, (module, summary) in COMMANDS.items():
        command = commands.add_parser(name, help=summary, description=summary)
        module.add_arguments(command)
        command.set_defaults(run=module.run)

    def work() -> int:
        arguments = parser.parse_command(argv)
        if arguments is None:
            return 2
        status: int = arguments.run(arguments)
        return status

    return run_to_end(work, lambda: "hw_sim")


if __name__ == "__main__":
    sys.exit(main())
