"""The page's own small web server.

Everything lies below a secret word in the address, which other users of the machine, and other pages open in the same
browser, do not know.
"""

import json
import re
import secrets
import shutil
import threading
import urllib.parse
from collections.abc import Callable
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import IO, Any

from cablejax.app.desk import Desk

PAGE = Path(__file__).parent / "page"
KINDS = {".html": "text/html; charset=utf-8", ".css": "text/css", ".js": "text/javascript", ".svg": "image/svg+xml"}
HEADERS = {
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; "
    "img-src 'self' data:; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cache-Control": "no-store",
    "Cross-Origin-Resource-Policy": "same-origin",
}
PIECE = 1 << 20
MOST_JSON = 1 << 20
LOOPBACK = "127.0.0.1"


class Refused(Exception):
    """A request that cannot be met: the status, and why in one sentence."""

    def __init__(self, status: HTTPStatus, why: str):
        super().__init__(why)
        self.status = status


class PageServer(ThreadingHTTPServer):
    """Serves the page of a desk.

    Attributes:
        url: Where it is.
    """

    daemon_threads = True
    ended = False

    def __init__(self, desk: Desk, about: dict[str, Any], *, host: str, port: int):
        self.desk, self.about, self.key = desk, about, secrets.token_urlsafe(18)
        if ":" in host:
            import socket

            self.address_family = socket.AF_INET6
        super().__init__((host, port), _Handler)
        self.url = f"http://{f'[{host}]' if ':' in host else host}:{self.server_address[1]}/{self.key}/"

    def server_bind(self) -> None:
        """Bind without looking up the host's name, which may take seconds."""
        import socketserver

        socketserver.TCPServer.server_bind(self)
        self.server_name, self.server_port = str(self.server_address[0]), int(self.server_address[1])

    def shutdown(self) -> None:
        """End, on connections that browsers keep open as well."""
        self.ended = True
        super().shutdown()

    def handle_error(self, request: Any, client_address: Any) -> None:
        """A browser that goes away in the middle is none of our troubles."""


def serve(desk: Desk, about: dict[str, Any], *, host: str = LOOPBACK, port: int = 0) -> PageServer:
    """Start serving the page of a desk, in a thread; `shutdown` and `server_close` end it.

    Args:
        desk: The scans.
        about: What the page offers: `units`, `voltages`, `version`.
        host: Address to listen at; by default one that only this machine reaches.
        port: Of it; 0 for any that is free.

    Raises:
        OSError: If the address cannot be had.
    """
    server = PageServer(desk, about, host=host, port=port)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    return server


class _Handler(BaseHTTPRequestHandler):
    """One request: routes, and what they answer."""

    server: PageServer  # pyright: ignore[reportIncompatibleVariableOverride]
    protocol_version = "HTTP/1.1"
    server_version, sys_version = "cablejax", ""

    def do_GET(self) -> None:
        """Answer what changes nothing."""
        self._answered(GETS)

    def do_POST(self) -> None:
        """Answer what does."""
        self._answered(POSTS)

    def log_message(self, format: str, *args: Any) -> None:
        """Nothing: the terminal is for what matters."""

    def _answered(self, routes: "list[tuple[str, Callable[..., None]]]") -> None:
        try:
            if self.server.ended:
                raise ConnectionError("the page has ended")
            route, groups = self._route(routes)
            route(self, *groups)
        except Refused as refused:
            self.close_connection = True  # what was sent with it may be unread
            self.send_json({"error": str(refused)}, refused.status)
        except (KeyError, FileNotFoundError):
            self.close_connection = True
            self.send_json({"error": "there is no such thing here"}, HTTPStatus.NOT_FOUND)
        except ConnectionError:
            self.close_connection = True

    def _route(self, routes: "list[tuple[str, Callable[..., None]]]") -> "tuple[Callable[..., None], tuple[str, ...]]":
        parts = urllib.parse.urlsplit(self.path)
        head, slash, rest = parts.path.removeprefix("/").partition("/")
        if not slash or not secrets.compare_digest(head.encode(), self.server.key.encode()):
            raise Refused(HTTPStatus.FORBIDDEN, "the address lacks the word that the program printed; open that one")
        self.query = dict(urllib.parse.parse_qsl(parts.query))
        for pattern, route in routes:
            if (match := re.fullmatch(pattern, rest)) is not None:
                return route, match.groups()
        raise KeyError(rest)

    def number(self, name: str) -> float:
        """A number of the query."""
        try:
            return float(self.query[name])
        except (KeyError, ValueError):
            raise Refused(HTTPStatus.BAD_REQUEST, f"{name}: expected a number") from None

    def length(self) -> int:
        """How much is sent."""
        text = self.headers.get("Content-Length", "")
        if not text.isdecimal():
            raise Refused(HTTPStatus.LENGTH_REQUIRED, "expected the length of what is sent")
        return int(text)

    def settings(self) -> dict[str, Any]:
        """Settings that are sent."""
        length = self.length()
        if length > MOST_JSON:
            raise Refused(HTTPStatus.REQUEST_ENTITY_TOO_LARGE, "expected settings, got too much")
        return parsed(self.rfile.read(length).decode(errors="replace"))

    def send_json(self, value: Any, status: HTTPStatus = HTTPStatus.OK) -> None:
        """Answer with a value."""
        self.send_bytes(json.dumps(value).encode(), "application/json", status=status)

    def send_bytes(self, content: bytes, kind: str, *, status: HTTPStatus = HTTPStatus.OK) -> None:
        """Answer with bytes."""
        self._head(status, kind, len(content))
        self.wfile.write(content)

    def send_file(self, path: Path, kind: str, *, save_as: str | None = None) -> None:
        """Answer with a file, to be shown or to be saved under a name."""
        with path.open("rb") as file:
            self._head(HTTPStatus.OK, kind, path.stat().st_size, save_as)
            shutil.copyfileobj(file, self.wfile, PIECE)

    def _head(self, status: HTTPStatus, kind: str, length: int, save_as: str | None = None) -> None:
        self.send_response(status)
        for name, value in HEADERS.items():
            self.send_header(name, value)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(length))
        if save_as is not None:
            quoted = urllib.parse.quote(save_as, safe="")
            self.send_header("Content-Disposition", f"attachment; filename*=UTF-8''{quoted}")
        self.end_headers()


def parsed(text: str) -> dict[str, Any]:
    """Settings from JSON.

    Raises:
        Refused: If it is none.
    """
    try:
        value = json.loads(text)
    except ValueError:
        value = None
    if not isinstance(value, dict):
        raise Refused(HTTPStatus.BAD_REQUEST, "settings: expected a JSON object")
    return value


def _page(request: _Handler, name: str) -> None:
    path = PAGE / (name or "index.html")
    request.send_file(path, KINDS[path.suffix])


def _state(request: _Handler) -> None:
    request.send_json({"scans": request.server.desk.scans(), **request.server.about})


def _scan(request: _Handler, number: str) -> None:
    request.send_json(request.server.desk.scan(int(number)))


def _cloud(request: _Handler, number: str) -> None:
    path, _ = request.server.desk.file(int(number), "cloud.bin")
    request.send_file(path, "application/octet-stream")


def _section(request: _Handler, number: str, cable: str) -> None:
    request.send_json(request.server.desk.section(int(number), int(cable), request.number("at")))


def _report(request: _Handler, number: str, which: str) -> None:
    path, name = request.server.desk.file(int(number), f"report-{which}.html")
    ending = "" if which == "all" else f"-cable-{which}"
    request.send_file(path, KINDS[".html"], save_as=f"{Path(name).stem}{ending}.html")


def _upload(request: _Handler) -> None:
    name = clean_name(request.query.get("name", ""))
    settings = parsed(request.query.get("settings", "{}"))
    desk, length = request.server.desk, request.length()
    place = desk.place()
    try:
        with (place / name).open("wb") as file:
            _receive(request.rfile, file, length)  # pyright: ignore[reportArgumentType] a stream of bytes by another name
        number = desk.add(place / name, settings, own=True)
    except BaseException as error:
        shutil.rmtree(place, ignore_errors=True)
        if isinstance(error, ValueError):
            raise Refused(HTTPStatus.BAD_REQUEST, str(error)) from None
        if isinstance(error, OSError) and not isinstance(error, ConnectionError):
            why = f"{name}: cannot be kept on this machine ({error.strerror})"
            raise Refused(HTTPStatus.INSUFFICIENT_STORAGE, why) from None
        raise
    request.send_json({"number": number})


def _receive(source: IO[bytes], file: IO[bytes], length: int) -> None:
    left = length
    while left:
        data = source.read(min(PIECE, left))
        if not data:
            raise ConnectionError("the browser broke off")
        file.write(data)
        left -= len(data)


def clean_name(name: str) -> str:
    """The name of an uploaded file, without folders.

    Raises:
        Refused: If nothing is left of it.

    Example:
        >>> clean_name("../up/scan one.ply"), clean_name(r"C:\\scan.ply")
        ('scan one.ply', 'scan.ply')
    """
    last = re.split(r"[/\\]", name)[-1].replace("\0", "")
    if last in ("", ".", ".."):
        raise Refused(HTTPStatus.BAD_REQUEST, f"name: expected that of a file, got {name!r}")
    return last


def _again(request: _Handler, number: str) -> None:
    try:
        request.server.desk.again(int(number), request.settings())
    except ValueError as error:
        raise Refused(HTTPStatus.BAD_REQUEST, str(error)) from None
    request.send_json({})


def _stop(request: _Handler, number: str) -> None:
    request.settings()
    request.server.desk.stop(int(number))
    request.send_json({})


def _remove(request: _Handler, number: str) -> None:
    request.settings()
    request.server.desk.remove(int(number))
    request.send_json({})


GETS: list[tuple[str, Callable[..., None]]] = [
    (r"((?:[a-z]+\.(?:html|css|js|svg))?)", _page),
    (r"state", _state),
    (r"scans/(\d+)", _scan),
    (r"scans/(\d+)/cloud", _cloud),
    (r"scans/(\d+)/cables/(\d+)/section", _section),
    (r"scans/(\d+)/report-(all|\d+)", _report),
]
POSTS: list[tuple[str, Callable[..., None]]] = [
    (r"scans", _upload),
    (r"scans/(\d+)/measure", _again),
    (r"scans/(\d+)/stop", _stop),
    (r"scans/(\d+)/remove", _remove),
]
