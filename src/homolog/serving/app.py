"""The endpoints of the server: the page, and what the page asks for."""

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
from homolog.pairs import SIDES, Side
from homolog.serving.command import PAGE, MatchRequest
from homolog.serving.execution import ALTERNATIVE_ARCHIVE, ARCHIVE
from homolog.serving.guard import MATCH_PAGE_POLICY, HostNames
from homolog.serving.job import Job
from homolog.serving.jobs import Jobs
from homolog.serving.middleware import Guard
from homolog.serving.page import Page
from homolog.serving.upload import RefusedError

_LONGEST_REQUEST = 4096
_LONGEST_REQUEST_SECONDS = 20.0
# Milliseconds after which a browser that lost the connection reconnects.
_RETRY = "retry: 1000\n\n"
# A proxy would collect the events and pass them on at the end; nginx reads this header.
_UNBUFFERED = {"X-Accel-Buffering": "no"}


def make_app(jobs: Jobs, page: Page, names: HostNames) -> Starlette:
    """The server as an application.

    Args:
        jobs: the matches.
        page: what is shown first.
        names: by which browsers may call the server.
    """
    endpoints = _Endpoints(jobs, page)

    @asynccontextmanager
    async def lifespan(app: Starlette) -> AsyncIterator[None]:
        async with jobs.running():
            yield

    return Starlette(
        routes=[
            Route("/", endpoints.page),
            Route("/jobs", endpoints.open, methods=["POST"]),
            Route("/jobs/{key}", endpoints.cancel, methods=["DELETE"]),
            Route("/jobs/{key}/events", endpoints.events),
            Route(f"/jobs/{{key}}/{PAGE}", endpoints.view),
            Route(f"/jobs/{{key}}/{ARCHIVE}", endpoints.archive),
            Route(f"/jobs/{{key}}/{ALTERNATIVE_ARCHIVE.format('{number:int}')}", endpoints.alternative),
            Route("/jobs/{key}/{side}", endpoints.receive, methods=["PUT"]),
        ],
        middleware=[Middleware(Guard, names=names)],
        exception_handlers=dict.fromkeys((RefusedError, HomologError, HTTPException), _error_response),
        lifespan=lifespan,
    )


class _Endpoints:
    def __init__(self, jobs: Jobs, page: Page) -> None:
        self._jobs, self._page = jobs, page

    async def page(self, request: Request) -> Response:
        return HTMLResponse(self._page.text, headers={"Content-Security-Policy": self._page.policy})

    async def open(self, request: Request) -> Response:
        try:
            match_request = MatchRequest.of(json.loads(await _small_body(request)))
        except (ValueError, RecursionError) as error:
            raise RefusedError(400, str(error) if isinstance(error, HomologError) else "that is no JSON") from None
        host = request.client.host if request.client else ""
        return JSONResponse({"id": self._jobs.open(match_request, host)}, 201)

    async def receive(self, request: Request) -> Response:
        job, side = self._job(request), request.path_params["side"]
        if side not in SIDES:
            raise RefusedError(404, "a match has a source and a target")
        name, size = request.query_params.get("name", ""), request.headers.get("content-length", "")
        declared = int(size) if size.isdecimal() else None
        try:
            await job.receive(cast(Side, side), name, declared, request.stream())
        except ClientDisconnect:
            return Response(status_code=400)  # no one reads it
        return Response(status_code=204)

    async def events(self, request: Request) -> Response:
        job, last = self._job(request), request.headers.get("last-event-id", "")
        begin = int(last) + 1 if last.isdecimal() and len(last) < 10 else 0
        return StreamingResponse(_server_sent(job, begin), media_type="text/event-stream", headers=_UNBUFFERED)

    async def view(self, request: Request) -> Response:
        path = self._done(request).folder / "result" / PAGE
        return FileResponse(path, headers={"Content-Security-Policy": MATCH_PAGE_POLICY})

    async def archive(self, request: Request) -> Response:
        return FileResponse(self._done(request).folder / ARCHIVE, filename=ARCHIVE)

    async def alternative(self, request: Request) -> Response:
        path = self._done(request).folder / ALTERNATIVE_ARCHIVE.format(request.path_params["number"])
        if not path.is_file():
            raise RefusedError(404, "this match has no such map")
        return FileResponse(path, filename=path.name)

    async def cancel(self, request: Request) -> Response:
        with suppress(RefusedError):  # it may have ended already
            self._job(request).scope.cancel()
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


async def _server_sent(job: Job, begin: int) -> AsyncIterator[str]:
    """Server-sent events; numbered, so that a browser that lost the connection goes on where it was."""
    yield _RETRY
    async for number, event in job.follow(begin):
        yield f"id: {number}\nevent: {event.kind}\ndata: {json.dumps(event.data)}\n\n"


async def _error_response(request: Request, error: Exception) -> Response:
    if isinstance(error, RefusedError):
        return JSONResponse(error.data, error.status)
    if isinstance(error, HTTPException):
        return JSONResponse({"error": error.detail}, error.status_code, headers=error.headers)
    return JSONResponse({"error": str(error)}, 400)
