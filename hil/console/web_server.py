"""A small web server for this computer only: loopback, a token, no other site's pages; no library needed.

A route is a function of a `Request` that returns a `Reply`. Nothing reaches it without the token, which comes
once in the address that is printed and from then on as a cookie. The name of the host is checked, so that no
name of another site leads here, and whatever changes something must come from a page of this console.
"""

import hmac
import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any
from urllib.parse import parse_qsl, unquote, urlsplit

HOST = "127.0.0.1"
NAMES = (HOST, "localhost")
_MOST_BODY_BYTES = 1 << 18
_TIMEOUT_S = 30.0


class Refused(Exception):
    """Error that is answered with an HTTP status and a sentence."""

    def __init__(self, status: HTTPStatus, text: str) -> None:
        self.status = status
        super().__init__(text)


@dataclass(frozen=True)
class Request:
    """An HTTP request: path without query, decoded; query; JSON body of a POST; name of the host."""

    path: str
    query: Mapping[str, str]
    body: Mapping[str, Any]
    host: str


@dataclass(frozen=True)
class Reply:
    """The answer to a request."""

    content: bytes
    kind: str = "text/html; charset=utf-8"
    status: HTTPStatus = HTTPStatus.OK
    headers: Mapping[str, str] = field(default_factory=dict)


def as_json(tree: object, status: HTTPStatus = HTTPStatus.OK) -> Reply:
    """A reply of plain values."""
    return Reply(json.dumps(tree, allow_nan=False).encode(), "application/json", status)


Route = Callable[[Request], Reply]


class Server(ThreadingHTTPServer):
    """Serves routes by method and path; a route whose path ends with `/` takes all below it.

    Args:
        port: TCP port of this computer; 0 for any that is free.
        token: secret without which nothing is served.
        cookie: name under which browsers keep the token.
        routes: functions that answer requests, by `(method, path)`.
        policy: content security policy of every reply that has none of its own.

    Raises:
        OSError: the port is taken.
    """

    daemon_threads = True
    allow_reuse_address = True

    def __init__(
        self, port: int, token: str, cookie: str, routes: Mapping[tuple[str, str], Route], policy: str
    ) -> None:
        self.token, self.cookie, self.routes, self.policy = token, cookie, routes, policy
        super().__init__((HOST, port), _Handler)

    @property
    def port(self) -> int:
        """Port on which it listens."""
        return int(self.server_address[1])

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Print nothing: usually the browser has closed the connection."""


class _Handler(BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"
    server_version = "hil"
    sys_version = ""
    timeout = _TIMEOUT_S
    server: Server

    def do_GET(self) -> None:
        self._serve("GET")

    def do_POST(self) -> None:
        self._serve("POST")

    def _serve(self, method: str) -> None:
        try:
            reply = self._reply(method)
        except Refused as refused:
            self.close_connection = True  # its body may be unread
            reply = self._refusal(refused.status, str(refused))
        except Exception as error:
            reply = self._refusal(HTTPStatus.INTERNAL_SERVER_ERROR, f"{type(error).__name__}: {error}")
        self.send_response(reply.status)
        reported = {
            "Content-Type": reply.kind,
            "Content-Length": str(len(reply.content)),
            "Cache-Control": "no-store",
            "X-Content-Type-Options": "nosniff",
            "Referrer-Policy": "no-referrer",
            "Content-Security-Policy": self.server.policy,
            **reply.headers,
        }
        for name, value in reported.items():
            self.send_header(name, value)
        self.end_headers()
        self.wfile.write(reply.content)

    def _reply(self, method: str) -> Reply:
        parts = urlsplit(self.path)
        query = dict(parse_qsl(parts.query))
        host = self._known_host()
        if method == "GET" and parts.path == "/" and self._right(query.get("token", "")):
            cookie = f"{self.server.cookie}={self.server.token}; HttpOnly; SameSite=Lax; Path=/"
            return Reply(b"", status=HTTPStatus.SEE_OTHER, headers={"Location": "/", "Set-Cookie": cookie})
        if not self._right(self._cookie()):
            raise Refused(
                HTTPStatus.FORBIDDEN, "open the address that hil console printed: the token is missing"
            )
        if method == "POST":
            self._from_this_console(host)
        path = unquote(parts.path)
        route = self.server.routes.get((method, path)) or self._above(method, path)
        if route is None:
            raise Refused(HTTPStatus.NOT_FOUND, "there is no such page")
        return route(Request(path, query, self._body() if method == "POST" else {}, host))

    def _above(self, method: str, path: str) -> Route | None:
        above = [
            (p, r) for (m, p), r in self.server.routes.items() if m == method and p != "/" and p.endswith("/")
        ]
        return next((route for place, route in above if path.startswith(place)), None)

    def _known_host(self) -> str:
        name, _, port = self.headers.get("Host", "").rpartition(":")
        if name not in NAMES or port != str(self.server.port):
            raise Refused(HTTPStatus.FORBIDDEN, f"this host is called {HOST}")
        return name

    def _right(self, token: str) -> bool:
        return hmac.compare_digest(token.encode(), self.server.token.encode())

    def _cookie(self) -> str:
        """The token of a browser's cookie, or of a program's header `Authorization: Bearer`."""
        bearer = self.headers.get("Authorization", "").removeprefix("Bearer ")
        pairs = (part.strip().partition("=") for part in self.headers.get("Cookie", "").split(";"))
        return next((value for name, _, value in pairs if name == self.server.cookie), bearer)

    def _from_this_console(self, host: str) -> None:
        origin = self.headers.get("Origin")
        if origin is not None and origin != f"http://{host}:{self.server.port}":
            raise Refused(HTTPStatus.FORBIDDEN, "that came from a page of another site")
        if self.headers.get_content_type() != "application/json":
            raise Refused(HTTPStatus.UNSUPPORTED_MEDIA_TYPE, "expected application/json")

    def _body(self) -> Mapping[str, Any]:
        try:
            length = int(self.headers.get("Content-Length", "0"))
        except ValueError:
            length = -1
        if not 0 <= length <= _MOST_BODY_BYTES:
            raise Refused(HTTPStatus.REQUEST_ENTITY_TOO_LARGE, "that is too much")
        try:
            tree = json.loads(self.rfile.read(length) or b"{}")
        except (ValueError, RecursionError):
            tree = None
        if not isinstance(tree, dict):
            raise Refused(HTTPStatus.BAD_REQUEST, "expected a JSON object")
        return tree

    def _refusal(self, status: HTTPStatus, text: str) -> Reply:
        """Reply with a sentence: plain text for a browser that opens an address, else JSON."""
        if "text/html" in self.headers.get("Accept", ""):
            return Reply(f"{text}\n".encode(), "text/plain; charset=utf-8", status)
        return as_json({"error": text}, status)

    def log_message(self, format: str, *args: object) -> None:
        """Print nothing: the terminal is for important messages."""
