"""Arguments, exit codes and error lines of the `cablejax` command."""

import argparse
import warnings
from collections.abc import Sequence
from types import ModuleType

from cablejax import __version__
from cablejax.cli import (
    app,
    classify,
    completion,
    denoise,
    gage,
    info,
    measure,
    register,
    report,
    schema,
    simulate,
)
from cablejax.cli.arguments import add_output
from cablejax.cli.errors import NoResultError
from cablejax.cli.streams import put_out, settle_streams, tell, warn_plainly
from cablejax.jax_sums import WrongSumsError
from cablejax.optional import MissingPackageError
from cablejax.runtime import set_up_jax_when_used

EXIT_OK, EXIT_NO_RESULT = 0, 1
INTERRUPTED = 130

EPILOG = """\
exit codes: 0 a result, 1 no result (one line on stderr says why), 2 wrong usage
examples:
  cablejax measure scan.ply --unit mm --catalogue 8.7/15 --report scan.html
  cablejax measure scans/ --unit mm --csv all.csv --report reports/
  cablejax denoise scan.ply clean.ply --unit mm
  cablejax register a.ply b.ply c.ply --unit mm --voxels 4 2 --output all.ply
  cablejax simulate scan.ply --size 240 --arc 180
"""


COMMANDS: dict[str, ModuleType] = {
    module.__name__.rpartition(".")[2]: module
    for module in (info, measure, report, denoise, register, gage, classify, simulate, app, schema, completion)
}


def build_parser() -> argparse.ArgumentParser:
    """The command's arguments."""
    parser = argparse.ArgumentParser(
        prog="cablejax",
        description="Cable scans: clean, register, measure and simulate them.",
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="version", version=f"cablejax {__version__}")
    sub = parser.add_subparsers(dest="command", required=True, metavar="command")
    for name, command in COMMANDS.items():
        choice = sub.add_parser(name, help=command.HELP, description=getattr(command, "DESCRIPTION", None))
        command.add_arguments(choice)
        add_output(choice)
    sub.choices["completion"].set_defaults(completed=parser)
    return parser


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command and return its exit code: 0 a result, 1 no result, 2 wrong usage.

    Errors that a user can do something about are one line on stderr; a traceback means a defect of this program.
    """
    settle_streams()
    try:
        options = build_parser().parse_args(arguments)
    except SystemExit as usage:  # after --help or --version, too, the disk may be full
        raise SystemExit(usage.code if usage.code or put_out() else EXIT_NO_RESULT) from None
    with warnings.catch_warnings():
        warnings.showwarning = warn_plainly
        try:
            set_up_jax_when_used()
            module = COMMANDS[options.command]
            result = module.run(options)
            text = schema.as_json(options.command, result) if options.json else module.table(result)
            return EXIT_OK if put_out(text) else EXIT_NO_RESULT
        except (NoResultError, MissingPackageError, WrongSumsError) as error:
            tell(f"cablejax: {error}")
        except KeyboardInterrupt:
            tell("cablejax: interrupted")
            return INTERRUPTED
        except OSError as error:
            tell(f"cablejax: {error.filename or 'the system'}: {error.strerror or error}")
    return EXIT_NO_RESULT
