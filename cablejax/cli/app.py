"""`cablejax app`: a page of this machine on which scans are dropped, looked at and measured."""

import argparse
import signal
import tempfile
import threading
import webbrowser
from pathlib import Path
from typing import Any

from cablejax import __version__
from cablejax.cli.arguments import UNITS
from cablejax.cli.errors import NoResultError
from cablejax.cli.scans import rows, say
from cablejax.cli.streams import put_out, tell
from cablejax.optional import require

STAGES = "cablejax.cli.app_stages:stage"
LOOPBACK = ("127.0.0.1", "::1", "localhost")


HELP = "a page of this machine: drop scans, see them, measure, hand on the report"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of the command."""
    parser.add_argument(
        "scans", nargs="*", metavar="scan", help="point files to open at once; others are dropped on the page"
    )
    parser.add_argument(
        "--unit", choices=UNITS, help="unit of these files' coordinates (the page asks for the others')"
    )
    parser.add_argument(
        "--host", default=LOOPBACK[0], metavar="ADDRESS",
        help="listen at another address than 127.0.0.1, which this machine alone reaches: whoever has the page's address sees "
        "the scans and can upload files",
    )  # fmt: skip
    parser.add_argument("--port", type=int, default=0, help="default: any that is free")
    parser.add_argument("--browser", action=argparse.BooleanOptionalAction, default=True, help="open it in a browser")


def run(options: argparse.Namespace) -> dict[str, Any]:
    """Serve the page until Ctrl-C or SIGTERM."""
    require("jinja2", "plotly", "matplotlib", why="the page's reports")
    from cablejax.app import Desk, serve

    if not 0 <= options.port < 65536:
        raise NoResultError(f"--port: expected 0 to 65535, got {options.port}")
    files = [Path(name).resolve() for name in options.scans]
    for name, path in zip(options.scans, files, strict=True):
        if path.is_dir():
            raise NoResultError(
                f"{name}: is a folder; open its scans one by one, or measure all with `cablejax measure`"
            )
        if not path.exists():
            raise NoResultError(f"{name}: does not exist")
    ended = threading.Event()
    with tempfile.TemporaryDirectory(prefix="cablejax-app-", ignore_cleanup_errors=True) as folder:
        desk = Desk(STAGES, Path(folder))
        try:
            server = serve(desk, _offered(), host=options.host, port=options.port)
        except OSError as error:
            desk.close()
            raise NoResultError(f"--host {options.host} --port {options.port}: {error.strerror or error}") from None
        settings = {} if options.unit is None else {"unit": options.unit}
        try:
            _tell_where(options, server.url)
            for path in files:
                desk.add(path, settings)
            signal.signal(signal.SIGTERM, lambda *_: ended.set())
            ended.wait()
        except KeyboardInterrupt:
            pass
        finally:
            server.shutdown()
            server.server_close()
            found = [_as_result(one) for one in desk.scans()]
            desk.close()
    return {"url": server.url, "scans": found}


def _offered() -> dict[str, Any]:
    """What the page lets one choose among."""
    from cablejax.simulate.nominal import XLPE_MM

    return {"units": list(UNITS), "voltages": list(XLPE_MM), "version": __version__}


def _tell_where(options: argparse.Namespace, url: str) -> None:
    """Print the address and open a browser there."""
    if options.host not in LOOPBACK:
        tell(
            f"cablejax: warning: whoever in the network has this address sees the scans and can upload files: {options.host}"
        )
    if options.json:
        tell(url)  # standard output is for the JSON at the end
    else:
        put_out(url)
    say(options, "Ctrl-C ends it")
    if options.browser:
        webbrowser.open(url)


def _as_result(scan: dict[str, Any]) -> dict[str, Any]:
    return {"file": scan["name"], "error": scan["error"], "cables": scan["cables"]}


def table(result: dict[str, Any]) -> str:
    """What was measured meanwhile."""
    told = []
    for scan in result["scans"]:
        found = [f"{one['diameter_mm']:.3f} mm" for one in scan["cables"]]
        told.append((scan["file"], ", ".join(found) or scan["error"] or "not measured"))
    return rows(told) if told else "  nothing was measured"
