"""What the server answers: the page, and what the page asks for."""

from __future__ import annotations

import json
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress
from typing import cast

import anyio
from starlette.applications import Starlette
from starlette.exceptions import HTTPException
from starlette.middleware import Middleware
from starlette.requests import ClientDisconnect, Request
from starlette.responses import FileResponse, HTMLResponse, JSONResponse, Response, StreamingResponse
from starlette.routing import Route

from homolog.core.errors import HomologError
from homolog.matching import Side
from homolog.serving.command import VIEW, Wishes
from homolog.serving.guard import MATCH_PAGE_POLICY, HostNames
from homolog.serving.jobs import ARCHIVE, Job, Jobs, RefusedError
from homolog.serving.middleware import Guard
from homolog.serving.page import Page

_LONGEST_REQUEST = 4096
_LONGEST_REQUEST_SECONDS = 20.0
# Milliseconds after which a browser that lost the connection tries again.
_RETRY = "retry: 1000\n\n"
# A proxy would gather what is told, and pass it on when all is over; nginx asks the answer.
_AT_ONCE = {"X-Accel-Buffering": "no"}


def make_app(jobs: Jobs, page: Page, names: HostNames) -> Starlette:
    """The server as an application.

    Args:
        jobs: the matches.
        page: what is shown first.
        names: by which browsers may call the server.
    """
    answers = _Answers(jobs, page)

    @asynccontextmanager
    async def lifespan(app: Starlette) -> AsyncIterator[None]:
        async with jobs.working():
            yield

    return Starlette(
        routes=[
            Route("/", answers.page),
            Route("/jobs", answers.open, methods=["POST"]),
            Route("/jobs/{key}", answers.cancel, methods=["DELETE"]),
            Route("/jobs/{key}/events", answers.events),
            Route(f"/jobs/{{key}}/{VIEW}", answers.view),
            Route(f"/jobs/{{key}}/{ARCHIVE}", answers.archive),
            Route("/jobs/{key}/{side}", answers.receive, methods=["PUT"]),
        ],
        middleware=[Middleware(Guard, names=names)],
        exception_handlers={RefusedError: _refused, HomologError: _mistaken, HTTPException: _unknown},
        lifespan=lifespan,
    )


class _Answers:
    def __init__(self, jobs: Jobs, page: Page) -> None:
        self._jobs, self._page = jobs, page

    async def page(self, request: Request) -> Response:
        return HTMLResponse(self._page.text, headers={"Content-Security-Policy": self._page.policy})

    async def open(self, request: Request) -> Response:
        try:
            wishes = Wishes.of(json.loads(await _small_body(request)))
        except (ValueError, RecursionError) as error:
            raise RefusedError(400, str(error) if isinstance(error, HomologError) else "that is no JSON") from None
        host = request.client.host if request.client else ""
        return JSONResponse({"id": self._jobs.open(wishes, host)}, 201)

    async def receive(self, request: Request) -> Response:
        job, side = self._job(request), request.path_params["side"]
        if side not in ("source", "target"):
            raise RefusedError(404, "a match has a source and a target")
        name, size = request.query_params.get("name", ""), request.headers.get("content-length", "")
        declared = int(size) if size.isdecimal() else None
        try:
            await self._jobs.receive(job, cast(Side, side), name, declared, request.stream())
        except ClientDisconnect:
            return Response(status_code=400)  # heard by no one
        return Response(status_code=204)

    async def events(self, request: Request) -> Response:
        job, last = self._job(request), request.headers.get("last-event-id", "")
        begin = int(last) + 1 if last.isdecimal() and len(last) < 10 else 0
        return StreamingResponse(_stream(job, begin), media_type="text/event-stream", headers=_AT_ONCE)

    async def view(self, request: Request) -> Response:
        path = self._done(request).folder / "result" / VIEW
        return FileResponse(path, headers={"Content-Security-Policy": MATCH_PAGE_POLICY})

    async def archive(self, request: Request) -> Response:
        return FileResponse(self._done(request).folder / ARCHIVE, filename=ARCHIVE)

    async def cancel(self, request: Request) -> Response:
        with suppress(RefusedError):  # what is gone already need not be cancelled
            self._job(request).life.cancel()
        return Response(status_code=204)

    def _job(self, request: Request) -> Job:
        return self._jobs.find(request.path_params["key"])

    def _done(self, request: Request) -> Job:
        job = self._job(request)
        if not job.done:
            raise RefusedError(404, "this match is not done as yet")
        return job


async def _small_body(request: Request) -> bytes:
    body = b""
    with anyio.move_on_after(_LONGEST_REQUEST_SECONDS):
        async for part in request.stream():
            body += part
            if len(body) > _LONGEST_REQUEST:
                raise RefusedError(413, "that is too much for a request")
        return body
    raise RefusedError(408, "the request did not come to its end; try again")


async def _stream(job: Job, begin: int) -> AsyncIterator[str]:
    """Server-sent events; numbered, so that a browser that lost the connection goes on where it was."""
    yield _RETRY
    async for number, news in job.listen(begin):
        yield f"id: {number}\nevent: {news.kind}\ndata: {json.dumps(news.told)}\n\n"


async def _refused(request: Request, error: Exception) -> Response:
    assert isinstance(error, RefusedError)
    return JSONResponse(error.told, error.status)


async def _mistaken(request: Request, error: Exception) -> Response:
    return JSONResponse({"error": str(error)}, 400)


async def _unknown(request: Request, error: Exception) -> Response:
    assert isinstance(error, HTTPException)
    return JSONResponse({"error": error.detail}, error.status_code, headers=error.headers)
