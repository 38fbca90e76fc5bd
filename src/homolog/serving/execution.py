"""The command that makes a match, run for a job: its progress as events, its end as a result or a refusal."""

from __future__ import annotations

import logging
import zipfile
from collections import deque
from pathlib import Path

from homolog.matching import FIRST_ALTERNATIVE, RESULT_FILES, alternative_folder
from homolog.pairs import SIDES, Side
from homolog.serving.command import PAGE, MatchCommand, public_error, read_message
from homolog.serving.job import Job
from homolog.serving.limits import Limits
from homolog.serving.process import LimitExceededError, run_limited
from homolog.serving.upload import RefusedError

_log = logging.getLogger(__name__)

ARCHIVE = "result.zip"
"""The whole result, in a match's folder once it is done."""

ALTERNATIVE_ARCHIVE = "result-{}.zip"
"""One of the maps of other ways round, by its number."""

UNKNOWN_ERROR = "the match failed, for a reason that is not known; tell whoever runs this page"

# Of what the command writes, for the log of the server, should it end in no way that is foreseen.
_LAST_LINES = 30


async def run_match(job: Job, command: MatchCommand, limits: Limits) -> None:
    """Run the command on the files of a job; each of its steps is an event.

    Raises:
        RefusedError: if it fails, or exceeds a limit.
    """
    lines, error, side = deque[str](maxlen=_LAST_LINES), "", None

    def read_line(line: str) -> None:
        nonlocal error, side
        lines.append(line)
        message = read_message(line)
        if "step" in message:
            side = message.get("side")
            job.publish("step", step=message["step"], done=message["done"], total=message["total"])
        error = message.get("error", error)

    names: dict[Side, str] = {side: job.upload.names[side] for side in SIDES}
    try:
        code = await run_limited(
            command.line(names, job.request),
            folder=job.folder,
            environment=command.environment(job.folder / "temporary", limits.threads),
            limits=limits,
            on_line=read_line,
        )
    except LimitExceededError as excess:
        raise RefusedError(422, f"the match {excess}, the limit here, and was stopped; use smaller shapes") from None
    if side is None:  # files are looked at before the first step
        side = next((one for one in SIDES if error.startswith(str(Path(one, names[one])))), None)
    if code and error:
        raise RefusedError(422, public_error(error, job.folder, names, side), side)
    if code:
        _log.error("a match ended with code %d:\n%s", code, "\n".join(lines))
        killed = f"the match broke off, most likely as it needed more than {limits.memory_gb:g} GB of memory"
        raise RefusedError(422, killed if code < 0 else UNKNOWN_ERROR)


def pack_result(folder: Path) -> int:
    """Pack the result of a match, and its page, into an archive in its folder; its alternatives into one more each.

    Returns:
        How many maps there are.
    """
    result, others = folder / "result", list[Path]()
    while (other := alternative_folder(result, FIRST_ALTERNATIVE + len(others))).is_dir():
        others.append(other)
    of_others = [other / name for other in others for name in RESULT_FILES]
    _pack(folder / ARCHIVE, result, [*(result / name for name in (*RESULT_FILES, PAGE)), *of_others])
    for number, other in enumerate(others, FIRST_ALTERNATIVE):
        _pack(folder / ALTERNATIVE_ARCHIVE.format(number), other, [other / name for name in RESULT_FILES])
    return 1 + len(others)


def _pack(target: Path, root: Path, files: list[Path]) -> None:
    with zipfile.ZipFile(target, "w", zipfile.ZIP_DEFLATED) as archive:
        for file in files:
            archive.write(file, str(Path("homolog-result") / file.relative_to(root)))
