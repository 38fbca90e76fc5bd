"""Progress where there is no terminal: lines for a log."""

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
