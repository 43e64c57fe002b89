"""Arguments, exit codes and error lines of the `cablejax` command."""

import argparse
import importlib
import warnings
from collections.abc import Sequence

from cablejax import __version__
from cablejax.cli import app, exports, folder, gage, schema
from cablejax.cli.errors import NoResultError
from cablejax.cli.streams import put_out, settle_streams, tell, warn_plainly
from cablejax.jax_sums import WrongSumsError, check_sums
from cablejax.optional import MissingPackageError
from cablejax.runtime import set_up_jax

EXIT_OK, EXIT_NO_RESULT = 0, 1
INTERRUPTED = 130

UNITS = ("um", "mm", "cm", "dm", "m", "km", "in", "ft")

EPILOG = """\
exit codes: 0 a result, 1 no result (one line on stderr says why), 2 wrong usage
examples:
  cablejax measure scan.ply --unit mm --catalogue 8.7/15 --report scan.html
  cablejax measure scans/ --unit mm --csv all.csv --report reports/
  cablejax denoise scan.ply clean.ply --unit mm
  cablejax register a.ply b.ply c.ply --unit mm --voxels 4 2 --output all.ply
  cablejax simulate scan.ply --size 240 --arc 180
"""


def _scan_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "scan",
        help="point file, or for info, measure and denoise a folder of them: PLY, PCD, XYZ, TXT, CSV, PTS, PTX, OBJ, LAS, LAZ "
        "or E57, gzipped or not",
    )
    parser.add_argument(
        "--unit", choices=UNITS, help="unit of the file's coordinates (default: mm or m by the extent, with a warning)"
    )
    _columns(parser)


def _columns(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--columns", metavar="NAMES", help="what the columns of a text table are, such as index,x,y,z,intensity"
    )


def _info(sub: argparse._SubParsersAction) -> None:
    parser = sub.add_parser("info", help="what a point file holds: points, extent, spacing, invalid returns")
    _scan_arguments(parser)
    folder.add_arguments(parser)


def _measure(sub: argparse._SubParsersAction) -> None:
    parser = sub.add_parser(
        "measure",
        help="diameter, ovality, length and bend radius of the cable in a scan, with their uncertainty",
        description="Find the cable in a scan and measure it. The diameter comes with a 95 %% interval and its budget.",
    )
    _scan_arguments(parser)
    parser.add_argument(
        "--report", metavar="FILE.html", help="write a self-contained report; a folder for a folder of scans"
    )
    scene = parser.add_argument_group("scenes of several cables")
    scene.add_argument("--all", action="store_true", help="measure every cable of the scan, each with a number")
    scene.add_argument("--expect", type=int, metavar="N", help="with --all: say so where another number is found")
    scene.add_argument("--picture", metavar="FILE.png", help="with --all: draw the scan with the cables' numbers")
    _measure_options(parser)
    exports.add_arguments(parser)
    folder.add_arguments(parser)


def _report(sub: argparse._SubParsersAction) -> None:
    parser = sub.add_parser("report", help="measure a scan and write its self-contained HTML report")
    _scan_arguments(parser)
    parser.add_argument("report", metavar="report.html", help="file to write")
    parser.set_defaults(csv=None, jsonl=None, scheduler=None, all=False, expect=None, picture=None)
    exports.add_arguments(parser)
    _measure_options(parser)


def _gage(sub: argparse._SubParsersAction) -> None:
    parser = sub.add_parser(
        "gage", help="how well repeated scans agree: repeatability and reproducibility after AIAG MSA"
    )
    gage.add_arguments(parser)
    parser.add_argument("--unit", choices=UNITS, help="unit of the files' coordinates")
    _columns(parser)
    parser.set_defaults(all=False, expect=None, picture=None)
    _measure_options(parser)
    folder.add_arguments(parser)


def _classify(sub: argparse._SubParsersAction) -> None:
    parser = sub.add_parser("classify", help="the nominal size that a trained network sees in a scan")
    _scan_arguments(parser)
    network = parser.add_mutually_exclusive_group()
    network.add_argument(
        "--network", default="adgcnn_fit", metavar="NAME", help="one that comes with the package (default: adgcnn_fit)"
    )
    network.add_argument("--checkpoint", metavar="FOLDER", help="of a run of experiments.train, whose network to take")
    parser.add_argument("--seed", type=int, default=0, help="of the samples that the network sees (default: 0)")


def _app(sub: argparse._SubParsersAction) -> None:
    parser = sub.add_parser("app", help="a page of this machine: drop scans, see them, measure, hand on the report")
    app.add_arguments(parser, UNITS)


def _completion(sub: argparse._SubParsersAction) -> None:
    parser = sub.add_parser("completion", help="a script for the shell: source <(cablejax completion bash)")
    parser.add_argument("shell", choices=("bash", "zsh"))


def _schema(sub: argparse._SubParsersAction) -> None:
    parser = sub.add_parser("schema", help="the JSON Schema of what a command prints with --json")
    parser.add_argument("name", choices=schema.VERSIONS, metavar="name", help=", ".join(schema.VERSIONS))


def _measure_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--catalogue", metavar="KV", help="tell the nominal size, by rated voltage U0/U: 8.7/15")
    parser.add_argument(
        "--tolerance",
        type=float,
        nargs=2,
        metavar=("LOW", "HIGH"),
        help="limits of the diameter in mm: pass, fail or undecided",
    )
    parser.add_argument(
        "--checkpoint",
        metavar="FOLDER",
        help="of a run of experiments.parts: its network labels the points, and the cable's alone are measured",
    )
    parser.add_argument(
        "--scanner",
        metavar="NAME|NUMBERS",
        help="a preset of the simulator (line-laser), or what is known at the cable's distance: "
        "range_std_mm=1.2,footprint_mm=1 (optional: incidence_power, lateral_std_mm)",
    )
    parser.add_argument(
        "--stations",
        type=int,
        metavar="N",
        help="scanner positions, if known: 1 for a single view, which needs no alignment",
    )
    limits = parser.add_argument_group("what is known of the cable, in mm and in the scan's coordinates")
    limits.add_argument(
        "--diameter", type=float, nargs=2, metavar=("LOW", "HIGH"), help="its diameter is between these"
    )
    limits.add_argument("--near", type=float, nargs=3, metavar=("X", "Y", "Z"), help="the cable nearest to this point")
    limits.add_argument(
        "--axis", type=float, nargs=3, metavar=("X", "Y", "Z"), help="it runs along this, within 20 degrees"
    )
    limits.add_argument(
        "--box",
        type=float,
        nargs=6,
        metavar=("X0", "Y0", "Z0", "X1", "Y1", "Z1"),
        help="look at no point outside this box",
    )
    parser.add_argument("--section", type=float, metavar="MM", help="distance between sections (default: D/4)")
    parser.add_argument("--registration-std", type=float, default=0.0, metavar="MM", help="of the stations' alignment")
    parser.add_argument(
        "--scale-std", type=float, default=0.0, metavar="RATIO", help="of the scanner's scale, 1e-4 say"
    )
    parser.add_argument("--maker-std", type=float, default=0.0, metavar="MM", help="of makers' diameters about nominal")
    parser.add_argument("--seed", type=int, default=0, help="of the random samples in the search (default: 0)")


def _denoise(sub: argparse._SubParsersAction) -> None:
    parser = sub.add_parser("denoise", help="remove outliers, smooth with the adaptive filter, write the cloud")
    _scan_arguments(parser)
    parser.add_argument(
        "output", help="file to write: .ply, .pcd, .xyz, .csv, .las or .laz; a folder for a folder of scans"
    )
    parser.add_argument("--neighbors", type=int, default=100, metavar="K", help="of the filter (default: 100)")
    parser.add_argument(
        "--order", type=int, choices=(0, 1, 2), default=2,
        help="local surface: 0 the mean of the paper's eq. (8), which shrinks a cable; 1 plane; 2 quadric (default)",
    )  # fmt: skip
    parser.add_argument("--std-ratio", type=float, default=2.0, help="outliers beyond so many deviations (default: 2)")
    parser.add_argument("--no-filter", action="store_true", help="remove outliers alone")
    parser.add_argument(
        "--tile", type=int, metavar="POINTS",
        help="work in tiles of so many points, for files larger than memory; the result is the same, and a killed run "
        "goes on when called again (default: 262144 for files from 256 MB, else none)",
    )  # fmt: skip
    folder.add_arguments(parser)


def _register(sub: argparse._SubParsersAction) -> None:
    parser = sub.add_parser(
        "register",
        help="the rigid motions that bring scans together",
        description="Bring scans into the frame of the last one: two by one registration, more by a pose graph.",
    )
    parser.add_argument("scans", nargs="+", metavar="scan", help="point files, two or more; the last one stays")
    parser.add_argument("--unit", choices=UNITS, help="unit of all files (default: mm, with a warning)")
    _columns(parser)
    parser.add_argument(
        "--output", metavar="FILE", help="write the moved source, or all scans together if more than two"
    )
    parser.add_argument("--method", choices=("point", "plane", "gicp"), default="gicp", help="default: gicp")
    parser.add_argument("--kernel", choices=("none", "huber", "cauchy", "tukey"), default="none", help="default: none")
    parser.add_argument(
        "--max-distance",
        type=float,
        metavar="MM",
        help="register once, from where the scans lie, with corresponding points no further apart",
    )
    parser.add_argument(
        "--voxels",
        type=float,
        nargs="+",
        metavar="MM",
        help="from coarse to fine: 500 250 125, corresponding points within 4 voxels (2 for more than two scans); two scans "
        "find their own",
    )
    parser.add_argument(
        "--start",
        choices=("given", "features"),
        help="with --voxels: given, the scans lie near each other as they are (default), or features, nothing is known of the "
        "pose; without, several starts are compared",
    )


def _simulate(sub: argparse._SubParsersAction) -> None:
    parser = sub.add_parser("simulate", help="write a simulated scan of a catalogue cable, its true diameter beside it")
    parser.add_argument("output", help="file to write: .ply, .pcd, .xyz, .csv, .las or .laz")
    parser.add_argument("--size", type=float, default=240, metavar="MM2", help="conductor cross-section (default: 240)")
    parser.add_argument("--voltage", default="8.7/15", metavar="KV", help="rated voltage U0/U (default: 8.7/15)")
    parser.add_argument("--points", type=int, default=53_135, help="default: 53135")
    parser.add_argument("--preset", default="line-laser", help="scanner (default: line-laser)")
    parser.add_argument(
        "--shape",
        default="straight",
        help="line, sheath or accessory, surrounding: bend, corrugated+tray (default: straight)",
    )
    parser.add_argument("--bend-radius", type=float, metavar="MM", help="default: 15 diameters")
    parser.add_argument("--finish", default="matte", help="matte, dark, glossy or dark-glossy (default: matte)")
    parser.add_argument("--length", type=float, default=400.0, metavar="MM", help="default: 400")
    parser.add_argument("--arc", type=float, default=360.0, metavar="DEG", help="circumference seen (default: 360)")
    parser.add_argument("--outliers", type=float, default=0.02, metavar="SHARE", help="default: 0.02")
    parser.add_argument("--seed", type=int, default=0, help="default: 0")
    parser.add_argument(
        "--picture", metavar="PNG", help="also draw the scan, coloured by its distance to the true surface"
    )


COMMANDS = {
    "info": _info,
    "measure": _measure,
    "report": _report,
    "denoise": _denoise,
    "register": _register,
    "gage": _gage,
    "classify": _classify,
    "simulate": _simulate,
    "app": _app,
    "schema": _schema,
    "completion": _completion,
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
    for add in COMMANDS.values():
        add(sub)
    for choice in sub.choices.values():
        choice.add_argument("--json", action="store_true", help="print the result as JSON instead of a table")
        choice.add_argument("--quiet", action="store_true", help="no progress on stderr")
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
            if options.command not in ("completion", "schema"):
                set_up_jax()
                check_sums()
            module = importlib.import_module(f"cablejax.cli.{options.command}")
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
