"""``homolog fit``, with a stand-in for the body model."""

from articulated_stand_in import Worm, faulty_maps, scan_of, wormlike

from homolog.fitting import FIT_FILES
from homolog.matching import Match
from homolog.shapes import write_shape


class _Matched:
    """In place of a matcher: the maps are known."""

    def __init__(self, found):
        self.match = lambda template, scan, *, timings, **options: found


def test_the_command(homolog, make, monkeypatch, tmp_path):
    worm = Worm(make.blob(3))
    shape, order = scan_of(worm, wormlike())
    write_shape(tmp_path / "scan.ply", shape)
    inputs = {side: {"file": str(tmp_path / "scan.ply")} for side in ("source", "target")}
    found = Match(worm.template, shape, *faulty_maps(order), method="a", report={"inputs": inputs})
    monkeypatch.setattr("homolog.fitting.PeopleModel", lambda: worm)
    monkeypatch.setattr("homolog.cli.fit.build_matcher", lambda *_, **__: _Matched(found))
    ended = homolog("fit", tmp_path / "scan.ply", "-o", tmp_path / "out")
    assert ended.code == 0 and "the scan is in cm" in ended.err and "height 0.3" in ended.err
    assert ended.out.split() == [str(tmp_path / "out" / name) for name in FIT_FILES]
    for arguments, told in (
        ([tmp_path / "none.ply"], "none.ply"),
        ([tmp_path / "scan.ply", "--unit", "ell"], "ell"),
        ([tmp_path / "scan.ply", "--model", "dogs"], "dogs"),
    ):
        ended = homolog("fit", *arguments, "-o", tmp_path / "other")
        assert ended.is_one_line_of_complaint() and told in ended.err, ended.err
    assert not (tmp_path / "other").exists()
