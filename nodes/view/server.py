"""Serve the page and its stream on one local port: files, a WebSocket, token, same origin.

The URL is ``http://127.0.0.1:PORT/TOKEN/``; everything the page loads is below it, so nothing can
be reached without the token. A slow browser delays nobody: its next data is built only after it
received the previous. A page may send a recording, which is then shown in place of what it showed.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import mimetypes
import secrets
import time
from collections.abc import Callable
from http import HTTPStatus
from pathlib import Path
from typing import Any, Protocol
from urllib.parse import urlsplit

import msgspec
from websockets.asyncio.server import Server, ServerConnection, serve
from websockets.datastructures import Headers
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request, Response

from messages.errors import Remedy
from nodes.view.address import ADDRESS, LOCAL
from nodes.view.bundle import bundle
from nodes.view.commands import CommandError
from nodes.view.upload import Upload

SEND_PERIOD = 1.0 / 50.0  # pause between two messages to a page [s]
FAR = 1e6  # limit of a hand's target [m]
MAX_REQUEST = 1 << 18  # limit of a request: a law of thousands of taps fits [bytes]
MAX_PAGES = 16  # limit of open pages
MAX_WAITING = 8  # limit of pending requests per page
# Longest time that a first picture has for itself, from the start of the server or the request of
# a page [s]; the page tells when it is drawn.
PICTURE_FIRST = 1.0
_HEADERS = {
    "Cache-Control": "no-store",
    "Content-Security-Policy": (
        "default-src 'self'; style-src 'self' 'unsafe-inline'; frame-ancestors 'none'"
    ),
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
}


class Page(Protocol):
    """Interface of an open page: data to send, and requests."""

    def news(self) -> list[str | bytes]:
        """Return everything not sent yet."""

    async def due(self) -> None:
        """Wait until there may be news; at least `SEND_PERIOD` if nothing tells."""

    def hand(self, target: list[float] | None) -> str:
        """Move the hand's target; return an error or an empty string."""

    async def ask(self, request: dict[str, Any]) -> Any:
        """Execute a request."""

    def close(self) -> None:
        """Release the page's resources."""


def _one(request: Request, name: str) -> str | None:
    """Return a header's value; ``"several"``, never a valid host or origin, if repeated."""
    found = request.headers.get_all(name)
    return found[0] if len(found) == 1 else "several" if found else None


def _hostname(host: str) -> str:
    """Return the name in a Host header; empty if invalid."""
    try:
        return urlsplit(f"//{host}").hostname or ""
    except ValueError:
        return ""


def _files() -> dict[str, tuple[str, bytes]]:
    """Read the page's files; scripts are bundled, because each file costs a connection."""
    web = Path(__file__).with_name("web")
    found: dict[str, tuple[str, bytes]] = {}
    for path in filter(Path.is_file, web.rglob("*")):
        kind = mimetypes.guess_type(path.name)[0] or "text/plain"
        found[path.relative_to(web).as_posix()] = (
            f"{kind}; charset=utf-8",
            path.read_bytes(),
        )
    kind = found["main.js"][0]
    modules = {
        name: body.decode() for name, (_, body) in found.items() if name.endswith(".js")
    }
    found["main.js"] = kind, bundle(modules, "main").encode()
    return found


def _text(status: HTTPStatus, text: str) -> Response:
    return _response(status, "text/plain; charset=utf-8", text.encode())


def _response(status: HTTPStatus, kind: str, body: bytes) -> Response:
    headers = Headers(
        {
            **_HEADERS,
            "Content-Type": kind,
            "Content-Length": str(len(body)),
            "Connection": "close",
        }
    )
    return Response(status.value, status.phrase, headers, body)


class PageServer:
    """Serves pages; `token` is the URL's token, empty for a new one."""

    def __init__(
        self,
        open_page: Callable[[], Page],
        token: str = "",
        opened: Callable[[Path, str, Page, bool], Page] | None = None,
    ) -> None:
        self.token = token or secrets.token_urlsafe(12)  # token in the URL
        self.port = 0  # port once started
        self.pages = 0  # open pages
        self.turned_away = 0  # requests without the token, or from another origin
        self._first_until = 0.0  # until when a first picture is awaited
        self._open_page = open_page
        # The page of a file that a page sent, by path and name; None if it accepts none.
        self._opened = opened
        self._files = _files()
        self._server: Server | None = None

    @property
    def url(self) -> str:
        """Return the URL of the page."""
        return f"http://{ADDRESS}:{self.port}/{self.token}/"

    @property
    def draws_first(self) -> bool:
        """Whether a page is coming that has no picture yet; heavy work waits for it."""
        return time.monotonic() < self._first_until

    async def start(self, port: int = 0) -> None:
        """Start serving."""
        quiet = logging.getLogger("nodes.view.server")
        # Browsers open connections that they never use; do not log them.
        quiet.addHandler(logging.NullHandler())
        quiet.propagate = False
        self._server = await serve(
            self._page,
            ADDRESS,
            port,
            process_request=self._request,
            compression=None,
            max_size=MAX_REQUEST,
            max_queue=64,
            ping_interval=5.0,
            ping_timeout=15.0,
            close_timeout=1.0,
            server_header=None,
            logger=quiet,
        )
        self.port = next(iter(self._server.sockets)).getsockname()[1]
        self._first_until = time.monotonic() + PICTURE_FIRST

    async def stop(self) -> None:
        """Close all pages and stop serving."""
        if self._server is not None:
            self._server.close(code=1001, reason="the run has ended")
            await self._server.wait_closed()

    def _request(
        self, _connection: ServerConnection, request: Request
    ) -> Response | None:
        host = _one(request, "Host") or ""
        origin = _one(request, "Origin")
        token, slash, name = request.path.partition("?")[0].lstrip("/").partition("/")
        refused = ""
        if _hostname(host) not in LOCAL:
            # A foreign name that resolves to this address: DNS rebinding.
            refused = f"haptic view is served to {ADDRESS} only, not to {host[:100]}\n"
        elif origin is not None and origin != f"http://{host}":
            refused = f"haptic view accepts no requests from {origin[:100]}\n"
        elif not secrets.compare_digest(token.encode(), self.token.encode()):
            refused = (
                "Wrong or missing token: open the complete URL that haptic printed.\n"
            )
        if refused:
            self.turned_away += 1
            return _text(HTTPStatus.FORBIDDEN, refused)
        if not slash:
            moved = _text(HTTPStatus.PERMANENT_REDIRECT, "")
            moved.headers["Location"] = f"/{self.token}/"
            return moved
        if name == "live":
            if self.pages >= MAX_PAGES:
                return _text(
                    HTTPStatus.SERVICE_UNAVAILABLE,
                    f"{MAX_PAGES} pages are already open; close one.\n",
                )
            return None
        found = self._files.get(name or "index.html")
        if found is None:
            return _text(HTTPStatus.NOT_FOUND, f"There is no {name[:100]}.\n")
        if not name:
            self._first_until = time.monotonic() + PICTURE_FIRST
        return _response(HTTPStatus.OK, *found)

    async def _page(self, connection: ServerConnection) -> None:
        self.pages += 1
        shown = Shown(self._open_page(), self._opened)
        waiting: set[asyncio.Task[None]] = set()
        sender = asyncio.create_task(self._send(connection, shown))
        try:
            async for text in connection:
                if isinstance(text, bytes) and shown.upload.add(text):
                    continue
                request = _decoded(text)
                if request is None:
                    await connection.close(1003, "a request is a JSON object")
                elif request.get("op") == "hand":
                    refused = _moved(shown.page, request.get("target"))
                    if refused:
                        await _answer(connection, request, error=refused)
                elif request.get("op") == "drawn":
                    self._first_until = 0.0
                elif len(waiting) >= MAX_WAITING and request.get("op") != "seen":
                    # A page that is seen again would stay without news.
                    await _answer(
                        connection,
                        request,
                        error=f"{MAX_WAITING} requests are already waiting; try again",
                    )
                else:
                    task = asyncio.create_task(_do(connection, shown, request))
                    waiting.add(task)
                    task.add_done_callback(waiting.discard)
        except ConnectionClosed:
            # Browsers close connections without notice.
            pass
        finally:
            sender.cancel()
            self.pages -= 1
            with contextlib.suppress(asyncio.CancelledError):
                await sender
            if waiting:
                await asyncio.wait(waiting)
            shown.close()

    async def _send(self, connection: ServerConnection, shown: Shown) -> None:
        with contextlib.suppress(ConnectionClosed):
            while True:
                for item in shown.page.news():
                    await connection.send(item)
                await shown.page.due()


class Shown:
    """What a connection shows: a page, until a file that it sends replaces it."""

    def __init__(
        self, page: Page, opened: Callable[[Path, str, Page, bool], Page] | None
    ) -> None:
        self.page = page
        self.upload = Upload()
        self._opened = opened

    async def ask(self, request: dict[str, Any]) -> Any:
        """Execute a request of the page, or open the file that it sends."""
        op = request.get("op")
        if self._opened is None or op not in ("open", "opened"):
            return await self.page.ask(request)
        if op == "open":
            self.upload.begin(request)
            return {}
        before = self.page
        name = self.upload.name
        over = self.upload.over
        opened = self._opened
        page = await asyncio.to_thread(
            self.upload.open, lambda path: opened(path, name, before, over)
        )
        if page is not before:
            self.page = page
            before.close()
        return {"name": name}

    def close(self) -> None:
        """Release the page's resources, and delete a file that is not complete."""
        self.upload.close()
        self.page.close()


def _decoded(text: str | bytes) -> dict[str, Any] | None:
    try:
        request = msgspec.json.decode(text)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError):
        return None
    return request if isinstance(request, dict) else None


def _moved(page: Page, target: Any) -> str:
    fits = isinstance(target, list) and len(target) == 3
    if target is not None and not (
        fits
        and all(isinstance(part, int | float) and abs(part) < FAR for part in target)
    ):
        return f"hand: the target is three numbers [m] below {FAR:g}, or null to let go"
    return page.hand(target)


async def _do(
    connection: ServerConnection, page: Shown, request: dict[str, Any]
) -> None:
    try:
        result = await page.ask(request)
    except CommandError as error:
        remedies = error.remedies
        await _answer(connection, request, error=str(error), remedies=remedies)
    else:
        await _answer(connection, request, result=result)


async def _answer(
    connection: ServerConnection,
    request: dict[str, Any],
    result: Any = None,
    error: str = "",
    remedies: tuple[Remedy, ...] = (),
) -> None:
    known = {"id": request.get("id"), "op": request.get("op")}
    answer = {
        "type": "answer",
        **known,
        "ok": not error,
        "result": result,
        "error": error,
        "remedies": remedies,
    }
    with contextlib.suppress(ConnectionClosed):
        await connection.send(msgspec.json.encode(answer).decode())
