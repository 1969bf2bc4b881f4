"""The server of the console: no request is served without the token, from another site or by another name."""

import http.client
import json
import threading

import pytest

from hil.console.web_server import Reply, Server, as_json

COOKIE = "hil_test=secret"
AS_JSON = {"Content-Type": "application/json"}


@pytest.fixture(scope="module")
def server():
    def broken(request):
        raise RuntimeError("out of order")

    routes = {
        ("GET", "/"): lambda request: Reply(b"home"),
        ("GET", "/below/"): lambda request: as_json({"path": request.path}),
        ("GET", "/broken"): broken,
        ("POST", "/change"): lambda request: as_json({"body": dict(request.body)}),
    }
    server = Server(0, "secret", "hil_test", routes, "default-src 'self'")
    threading.Thread(target=server.serve_forever, args=(0.01,), daemon=True).start()
    yield server
    server.shutdown()
    server.server_close()


@pytest.fixture
def ask(server):
    def of(method, path, body=None, **headers):
        connection = http.client.HTTPConnection("127.0.0.1", server.port, timeout=10)
        try:
            connection.request(method, path, body, {k.replace("_", "-"): v for k, v in headers.items()})
            reply = connection.getresponse()
            return reply.status, reply.read().decode(), reply.headers
        finally:
            connection.close()

    return of


def test_the_token_of_the_address_becomes_a_cookie_and_leaves_the_address(ask):
    status, _, headers = ask("GET", "/?token=secret")
    assert (status, headers["Location"]) == (303, "/")
    assert headers["Set-Cookie"].startswith(COOKIE)
    assert "HttpOnly" in headers["Set-Cookie"]
    assert ask("GET", "/", Cookie=f"other=1; {COOKIE}")[:2] == (200, "home")
    assert ask("GET", "/", Authorization="Bearer secret")[0] == 200


@pytest.mark.parametrize("path", ["/", "/absent", "/?token=wrong", "/below/x?token=secret"])
@pytest.mark.parametrize("cookie", ["", "hil_test=wrong", "other=secret"])
def test_without_the_token_nothing_is_served(ask, path, cookie):
    status, text, _ = ask("GET", path, Cookie=cookie)
    assert status == 403
    assert "token" in text


@pytest.mark.parametrize("host", ["evil.example:{port}", "127.0.0.1:1", ""])
def test_another_name_of_this_host_is_refused(ask, server, host):
    assert ask("GET", "/", Cookie=COOKIE, Host=host.format(port=server.port))[0] == 403


def test_a_change_comes_from_a_page_of_the_console_only(ask, server):
    own = {"Origin": f"http://127.0.0.1:{server.port}", "Cookie": COOKIE}
    assert ask("POST", "/change", '{"a": 1}', **own, **AS_JSON)[:2] == (200, '{"body": {"a": 1}}')
    assert ask("POST", "/change", "{}", Cookie=COOKIE, **AS_JSON)[0] == 200  # a program has no origin
    for other in ("null", "http://evil.example", "http://127.0.0.1:1", f"https://127.0.0.1:{server.port}"):
        assert ask("POST", "/change", "{}", **{**own, "Origin": other}, **AS_JSON)[0] == 403
    assert ask("POST", "/change", "a=1", **own)[0] == 415


@pytest.mark.parametrize(
    ("body", "headers", "status"),
    [
        ("[]", {}, 400),
        ("[" * 9000, {}, 400),
        ("", {"Content-Length": "-1"}, 413),
        ("", {"Content-Length": str(1 << 30)}, 413),
    ],
)
def test_what_is_no_small_object_is_refused(ask, body, headers, status):
    assert ask("POST", "/change", body, Cookie=COOKIE, **AS_JSON, **headers)[0] == status


def test_a_route_may_serve_all_below_it_and_one_that_fails_says_so(ask):
    assert json.loads(ask("GET", "/below/a%20b/c", Cookie=COOKIE)[1]) == {"path": "/below/a b/c"}
    assert ask("GET", "/absent", Cookie=COOKIE)[0] == 404
    status, text, headers = ask("GET", "/broken", Cookie=COOKIE, Accept="text/html")
    assert (status, text) == (500, "RuntimeError: out of order\n")
    assert headers["Content-Security-Policy"] == "default-src 'self'"
