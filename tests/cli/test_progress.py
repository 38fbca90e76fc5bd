"""Progress where there is no terminal: lines for a log, and messages for programs."""

import json

from homolog.cli.progress import Lines, progress_bar


class Clock:
    def __init__(self):
        self.now = 100.0

    def __call__(self):
        return self.now


def test_a_line_in_half_a_minute_with_the_time_left(capfd):
    clock = Clock()
    lines = Lines(clock)
    for done in range(101):
        clock.now = 100.0 + done
        lines(done, 1000, "training")
    said = capfd.readouterr().err.splitlines()
    assert said == [
        "training: 30 of 1000, about 0:16:10 left",
        "training: 60 of 1000, about 0:15:40 left",
        "training: 90 of 1000, about 0:15:10 left",
    ]


def test_another_part_of_the_work_has_a_speed_of_its_own(capfd):
    clock = Clock()
    lines = Lines(clock)
    clock.now += 1000
    lines(5, 10, "operators")
    clock.now += 1
    lines(20, 50, "training")  # where it goes on from
    clock.now += 60
    lines(30, 50, "training")
    said = capfd.readouterr().err.splitlines()
    assert said == ["operators: 5 of 10", "training: 30 of 50, about 0:02:00 left"]


def test_short_work_says_nothing_and_quiet_work_neither(capfd):
    with progress_bar(quiet=False) as report:
        report(1, 2, "work")
        assert isinstance(report, Lines)
    with progress_bar(quiet=True) as report:
        report(1, 2, "work")
        assert not isinstance(report, Lines)
    assert capfd.readouterr().err == ""


def test_json_for_programs_even_if_quiet(homolog, files, tmp_path, capfd):
    with progress_bar(quiet=True, form="json") as report:
        report(1, 2, "work")
    assert json.loads(capfd.readouterr().err) == {"step": "work", "side": None, "done": 1, "total": 2}
    arguments = ("match", files.mesh, files.other, "-o", tmp_path / "result", "--method", "axiomatic", "-q")
    ended = homolog(*arguments, "--progress=json")
    messages = [json.loads(line) for line in ended.err.splitlines()]
    assert ended.code == 0 and [message["done"] for message in messages] == list(range(len(messages)))
    assert [message["step"] for message in messages][:2] == ["read source", "read target"]
    assert [message["side"] for message in messages][:2] == ["source", "target"]
    assert len({message["total"] for message in messages}) == 1


def test_errors_are_json_for_programs(homolog, files, tmp_path):
    """Whether the command has begun or its arguments are wrong."""
    for arguments, said in (
        ([files.mesh, files.rubbish, "--progress", "json"], "rubbish.ply"),
        ([files.mesh, files.other, "--progress=json", "--method", "magic"], "magic"),
        ([files.mesh, files.other, "--progress=json", "--html", tmp_path / "absent" / "page.html"], "create it first"),
    ):
        ended = homolog("match", *arguments, "-o", tmp_path / "result")
        assert ended.code == 2 and ended.out == ""
        message = json.loads(ended.err.splitlines()[-1])
        assert list(message) == ["error"] and said in message["error"]
    assert homolog("match", "--help").out.count("--progress") == 0


def test_what_a_server_shows_says_nothing_of_where_its_weights_lie(homolog, files, tmp_path):
    words = ("--weights", files.weights, "--method", "nearest-features", "--progress=json")
    assert homolog("match", files.mesh, files.other, "-o", tmp_path, *words).code == 0
    assert "file" not in json.loads((tmp_path / "report.json").read_text())["features"]
