"""The server of a page: a few routes and one kind of socket, which answers one question at a time and takes no orders.

The page asks for what is newer than what it has, and is told when there is something: a page that stalls asks for nothing, and nothing is
sent to it. No question changes what the filter does. Nothing is written to a log, so that no token is.
"""

import asyncio
import json
import logging
import socket
import threading
import time
from collections import deque
from collections.abc import Awaitable, Callable
from importlib.resources import files
from typing import Any

from motes.core.checks import need
from motes.watch.answers import Answers
from motes.watch.guard import Guard
from motes.watch.quiet import is_waiting, protocols

PAGES, CONNECTIONS = 64, 256
"""Sockets, of which the oldest is closed for one more; and connections of any kind."""
ASKED, SENT = 1_024, 1 << 16
"""Bytes of the longest question; bytes that wait to be sent."""
SILENT = 10.0
"""Seconds that a connection may take to ask."""
QUICKEST, QUIET = 1 / 40, 0.1
"""Seconds between two looks at the slot, with a page and with none."""
SHARE = 0.25
"""Share of a processor that looking may take."""
LOOKS = 20
"""Last looks, the quickest of which tells what one costs."""
PER_PAGE = 8e-3
"""Seconds between looks that one more page adds."""
BEAT = 1.0
"""Seconds after which a question is answered though nothing is new."""
OFTEN = 1 / 80
"""Seconds between two answers to one page, at the least."""

LOG = logging.getLogger(__name__)
FILES = {"page.js": "text/javascript", "page.css": "text/css", "cloud.js": "text/javascript", "uPlot.iife.min.js": "text/javascript",
         "uPlot.min.css": "text/css", "colors.css": "text/css"}  # fmt: skip
FOLDERS = {"cloud.js": "motes.report", "colors.css": "motes.report",
           "uPlot.iife.min.js": "motes.report/uplot", "uPlot.min.css": "motes.report/uplot"}  # fmt: skip
REFUSED = "Open the link with its token, as it was printed: the page is its owner's.\n"


def read(name: str) -> str:
    """Return a file of the page."""
    package, *folders = FOLDERS.get(name, "motes.watch/static").split("/")
    return files(package).joinpath(*folders, name).read_text("utf-8")


class Server:
    """Serves a page in a thread of its own until it is closed."""

    def __init__(self, listener: socket.socket, guard: Guard, answers: Answers):
        """Take a socket that listens, who may look, and what is told."""
        uvicorn = need("uvicorn", "dashboard")
        self.guard, self.answers = guard, answers
        self.framed = False
        self._pages: dict[Any, None] = {}
        self._seen: dict[int, float] = {}
        self._cost = 0.0
        self._news = asyncio.Event()
        requests, sockets = protocols()
        config = uvicorn.Config(
            self._checked, interface="asgi3", http=requests, ws=sockets, loop="asyncio", lifespan="off", log_config=None,
            proxy_headers=False, server_header=False, timeout_graceful_shutdown=1,
            ws_per_message_deflate=False, ws_max_size=ASKED, ws_max_queue=4, limit_concurrency=CONNECTIONS,
            h11_max_incomplete_event_size=1 << 14,
        )  # fmt: skip
        self._server = uvicorn.Server(config)
        self._routes = self._app()
        self._listener = listener
        self._thread = threading.Thread(target=self._run, name="watch", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """End it; what was asked last is still answered."""
        self._server.should_exit = True
        self._thread.join(5)

    def _run(self) -> None:
        async def main() -> None:
            looking = asyncio.create_task(self._look())
            await self._server.serve(sockets=[self._listener])
            looking.cancel()

        asyncio.run(main())

    async def _look(self) -> None:
        """Look at the slot now and then, so seldom that the filter does not feel it, and tell the pages."""
        swept = time.monotonic()
        costs: deque[float] = deque(maxlen=LOOKS)
        while True:
            began, found = time.perf_counter(), True
            try:
                found = self.answers.recorder.turn()
            except Exception:
                LOG.exception("a step could not be looked at")
            if found:
                self._news.set()
                self._news = asyncio.Event()
            taken = time.perf_counter() - began
            if found:
                costs.append(taken)
            if time.monotonic() - swept > 1:
                self._sweep()
                swept = time.monotonic()
            least = QUICKEST + PER_PAGE * len(self._pages) if self._pages else QUIET
            # where others compute, most of what a look takes is waiting for them: the least of a few is what it costs
            await asyncio.sleep(max(least - taken, min(costs) / SHARE if found else 0.0))

    def _sweep(self) -> None:
        """Close connections that ask nothing: they are neither sockets that were accepted nor about to be answered."""
        there = {id(one): one for one in self._server.server_state.connections}
        now = time.monotonic()
        self._seen = {key: self._seen.get(key, now) for key in there}
        for key, one in there.items():
            if is_waiting(one) and now - self._seen[key] > SILENT and getattr(one, "transport", None) is not None:
                one.transport.abort()

    async def _checked(self, scope: Any, receive: Any, send: Any) -> None:
        """Answer what passes the checks; everything is refused before it is looked at any closer."""
        from starlette.datastructures import Headers
        from starlette.responses import PlainTextResponse

        headers = Headers(scope=scope)
        wrong = None
        if not self.guard.knows_host(headers):
            wrong = PlainTextResponse("Host: expected the address that this page listens at.\n", 403)
        elif scope["type"] == "websocket" and not self.guard.knows_origin(headers):
            wrong = PlainTextResponse("Origin: expected the page itself.\n", 403)
        elif not self.guard.is_known(headers) and not _brings_token(scope):
            wrong = PlainTextResponse(REFUSED, 401)
        if wrong is None:
            await self._routes(scope, receive, self._with_policy(send, headers["host"]))
        elif scope["type"] == "websocket":
            from starlette.websockets import WebSocket

            await WebSocket(scope, receive, send).send_denial_response(wrong)
        else:
            await wrong(scope, receive, self._with_policy(send, ""))

    def _with_policy(self, send: Callable[[Any], Awaitable[None]], host: str) -> Callable[[Any], Awaitable[None]]:
        frames = "http://localhost:* http://127.0.0.1:* http://[::1]:*" if self.framed else "'none'"
        policy = ("default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob: data:; base-uri 'none'; "
                  f"form-action 'none'; connect-src 'self' ws://{host}; frame-ancestors {frames}")  # fmt: skip
        more = [(b"content-security-policy", policy.encode()), (b"referrer-policy", b"no-referrer"), (b"cache-control", b"no-store"),
                (b"x-content-type-options", b"nosniff"), (b"cross-origin-resource-policy", b"same-origin")]  # fmt: skip

        async def sent(message: Any) -> None:
            if message["type"] == "http.response.start":
                given = {name for name, _ in message["headers"]}
                message["headers"] = [*message["headers"], *((name, value) for name, value in more if name not in given)]
            await send(message)

        return sent

    def _app(self) -> Any:
        from starlette.applications import Starlette
        from starlette.responses import HTMLResponse, PlainTextResponse, Response
        from starlette.routing import Route, WebSocketRoute

        async def page(request: Any) -> Response:
            token = request.query_params.get("token")
            if token is None:
                return HTMLResponse(read("page.html"))
            session = self.guard.takes(token)
            if session is None:
                return PlainTextResponse("token: wrong. " + REFUSED, 401)
            # the page goes on by itself: a cookie of this kind does not come along on the way from another site
            found = HTMLResponse('<!DOCTYPE html><meta charset="utf-8"><link rel="icon" href="data:,"><title>motes</title>'
                                 '<meta http-equiv="refresh" content="0; url=/">')  # fmt: skip
            found.set_cookie(self.guard.cookie, session, httponly=True, samesite="strict", path="/")
            return found

        async def file(request: Any) -> Response:
            name = request.path_params["name"]
            return Response(read(name), media_type=FILES[name]) if name in FILES else PlainTextResponse("nothing here\n", 404)

        async def scene(request: Any) -> Response:
            return Response(json.dumps(self.answers.described(), allow_nan=False), media_type="application/json")

        async def picture(request: Any) -> Response:
            found = self.answers.picture()
            return PlainTextResponse("nothing here\n", 404) if found is None else Response(found, media_type="image/png")

        async def told(request: Any) -> Response:
            found = self.answers.report
            if found is None:
                return PlainTextResponse("The report is there when the run has ended.\n", 404)
            # it knows its own scripts by digest, and says so itself
            return HTMLResponse(found, headers={"content-security-policy": "frame-ancestors 'none'"})

        return Starlette(routes=[
            Route("/", page, methods=["GET"]), Route("/file/{name}", file, methods=["GET"]), Route("/scene", scene, methods=["GET"]),
            Route("/picture", picture, methods=["GET"]), Route("/report", told, methods=["GET"]), WebSocketRoute("/live", self._live),
        ])  # fmt: skip

    async def _live(self, page: Any) -> None:
        """Answer the questions of a page, one by one."""
        from starlette.websockets import WebSocketDisconnect

        await page.accept()
        self._pages[page] = None
        for oldest in list(self._pages)[: max(0, len(self._pages) - PAGES)]:
            self._pages.pop(oldest, None)
            asyncio.ensure_future(_closed(oldest))
        try:
            while True:
                asked = self.answers.understood(await page.receive_text())
                if asked is None:
                    await page.close(1008)
                    return
                began = time.monotonic()
                news = self._news
                while not self.answers.has_news(asked) and time.monotonic() - began < BEAT:
                    try:
                        await asyncio.wait_for(news.wait(), BEAT)
                    except TimeoutError:
                        break
                    news = self._news
                await page.send_bytes(self.answers.to(asked))
                await asyncio.sleep(max(0.0, OFTEN - (time.monotonic() - began)))
        except (WebSocketDisconnect, RuntimeError, KeyError):
            return
        finally:
            self._pages.pop(page, None)


def _brings_token(scope: Any) -> bool:
    return scope["type"] == "http" and scope["path"] == "/" and scope["query_string"].startswith(b"token=")


async def _closed(page: Any) -> None:
    try:
        await page.close(1013)
    except RuntimeError:
        return
