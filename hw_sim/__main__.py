"""``python -m hw_sim``: the simulator's commands."""

import sys
from collections.abc import Sequence

from altd.cli.arguments import Parser
from altd.process.endings import run_to_end
from hw_sim import demo, desk, flat, measure, planar, planar_demo, plate, scan
from hw_sim.gige import command as gige
from hw_sim.row import command as row
from hw_sim.row import demo as row_demo

COMMANDS = {
    "scan": (scan, "record a calibration scan of a simulated unit"),
    "flat": (flat, "record the evenly lit targets, for a flat field"),
    "plate": (plate, "record a calibration plate with LEDs"),
    "demo": (demo, "run the daemon on a simulated unit; show values and truth"),
    "gige": (gige, "serve the cameras of a simulated unit by GigE Vision"),
    "measure": (measure, "record poses of the beam, and write their truth"),
    "planar": (planar_demo, "run the daemon on a plate that a machine moves; show values and truth"),
    "planar-recording": (planar, "record a plate with LEDs that moves in its plane"),
    "chain-demo": (row_demo, "run the daemon on a row of glass targets; show values and truth"),
    "desk": (desk, "record a unit of two webcams: screen plates, beams and their truth"),
    "chain": (row, "record a row of switched glass targets: scans, rounds, settings"),
}
"""Modules of the commands; each has ``add_arguments(parser)`` and ``run(arguments) -> exit status``."""


FIRST_STEPS = """first steps:
  python -m hw_sim demo            run the daemon on a simulated unit
  python -m hw_sim scan -o DIR     record a calibration scan, for altd calibrate
  python -m hw_sim COMMAND --help  list the options of a command
"""


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command; return the exit status, 2 for an error of the caller."""
    parser = command_parser()

    def work() -> int:
        arguments = parser.parse_command(argv)
        if arguments is None:
            return 2
        status: int = arguments.run(arguments)
        return status

    return run_to_end(work, lambda: "hw_sim")


def command_parser() -> Parser:
    """Parser of all commands."""
    parser = Parser(
        prog="python -m hw_sim", description="A simulated Active Laser Target.", epilog=FIRST_STEPS
    )
    commands = parser.add_subparsers(dest="command", metavar="COMMAND", title="commands")
    for name, (module, summary) in COMMANDS.items():
        command = commands.add_parser(name, help=summary, description=summary)
        module.add_arguments(command)
        command.set_defaults(run=module.run)
    return parser


if __name__ == "__main__":
    sys.exit(main())
