"""``python -m studies``: see ``studies.command``."""

import sys
from collections.abc import Sequence

from altd.cli.arguments import Parser
from altd.process.endings import run_to_end
from studies import command


def main(argv: Sequence[str] | None = None) -> int:
    """Run the studies; the exit status, 2 for what the caller did wrong."""
    summary = "repeat the thesis' experiments on simulated units; its figures beside ours"
    parser = Parser(prog="python -m studies", description=summary)
    command.add_arguments(parser)
    return run_to_end(lambda: command.run(parser.parse_args(argv)), lambda: "studies")


if __name__ == "__main__":
    sys.exit(main())
