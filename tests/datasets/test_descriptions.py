"""What the descriptions that ship say, and what can be wrong with one's own."""

import itertools
import re
from pathlib import Path

import pytest

from homolog.core.errors import ArgumentError, DataError
from homolog.datasets import DatasetDescription, ShapeFolder, builtin_descriptions, read_description

# Shapes, for training, for testing, and pairs of the test, as the field's tables have them.
PUBLISHED = {
    "faust_r": (100, 80, 20, 400),
    "faust_a": (100, 80, 20, 400),
    "scape_r": (71, 51, 20, 400),
    "scape_a": (71, 51, 20, 400),
    "smal_r": (49, 32, 17, 289),
    "shrec19": (44, 0, 44, 407),
    "surreal_5k": (5000, 5000, 0, 0),
    "lungs": (48, 32, 16, 256),
}
MADE_HERE = {"own", "views", "view_pairs", "lung_slices"}
WANTED = {*PUBLISHED, *MADE_HERE, "shrec19_maps", "shrec16_cuts", "shrec16_holes", "tosca", "surreal_pv", "luna16"}


def empty(root, description):
    """A folder with all files of shapes and truth, but nothing in them."""
    names = description.expected_names or [f"shape{number:04d}" for number in range(description.expected_shapes)]
    patterns = [description.shapes]
    patterns += [description.truth_files] if description.truth == "template-correspondence" else []
    for pattern, name in itertools.product(patterns, names):
        path = root / pattern.replace("*", name)
        path.parent.mkdir(parents=True, exist_ok=True)
        path.touch()
    if description.split == "listed":
        (root / "train.txt").write_text("\n".join(names[: description.n_train]))
        (root / "test.txt").write_text("\n".join(names[description.n_train :]))
    return names


def test_all_are_there_and_say_where_to_get_what_on_which_terms():
    found = builtin_descriptions()
    assert {one.name for one in found} == WANTED
    for one in found:
        assert all([one.title, one.citation, one.source, one.terms]), one.name
        assert one.name in {*MADE_HERE, "lungs"} or "https://" in one.source or "http://" in one.source
        assert read_description(one.name) == read_description(one.name.upper()) == one


def test_the_table_for_people_has_every_set():
    table = (Path(__file__).parents[2] / "docs" / "data.md").read_text(encoding="utf-8")
    assert {one.name for one in builtin_descriptions()} <= set(re.findall(r"`(\w+)`", table))


@pytest.mark.parametrize("name", PUBLISHED)
def test_splits_and_pairs_are_the_published_ones(tmp_path, name):
    description, (n_shapes, n_train, n_test, n_pairs) = read_description(name), PUBLISHED[name]
    names = empty(tmp_path, description)
    if name == "shrec19":
        others = [pair for pair in itertools.product(names, repeat=2) if "40" not in pair][:407]
        lines = [("40", other) for other in names[:23]] + others
        (tmp_path / "pairs.txt").write_text("\n".join(map(",".join, lines)))
    folder = ShapeFolder.open(tmp_path, description)
    assert len(folder.names) == n_shapes == description.expected_shapes
    for split, count in (("train", n_train), ("test", n_test)):
        if count:
            assert len(folder.split(split)) == count
        else:
            with pytest.raises(DataError, match=f"no shapes in split '{split}'"):
                folder.split(split)
    if n_test:
        pairs = folder.pairs("test")
        assert len(pairs) == n_pairs == description.n_pairs
        assert not any("40" in pair for pair in pairs) or name != "shrec19"
    if name == "shrec19":
        assert len(folder.pairs("all")) == 430


def test_faust_is_split_in_the_order_of_names(tmp_path):
    description = read_description("faust_r")
    empty(tmp_path, description)
    folder = ShapeFolder.open(tmp_path, description)
    assert folder.split("train")[-1] == "tr_reg_079"
    assert folder.split("test") == tuple(f"tr_reg_{number:03d}" for number in range(80, 100))
    (tmp_path / "pairs.txt").write_text("tr_reg_000,tr_reg_001\n")  # of one's own, and none of the benchmark's
    assert len(folder.pairs("test")) == 400


def test_names_with_ranges():
    described = DatasetDescription(names=("a{08..11}", "b", "{1..2}"))
    assert described.expected_names == ("a08", "a09", "a10", "a11", "b", "1", "2")
    assert described.expected_shapes == 7
    assert "mesh051" not in read_description("scape_r").expected_names


def test_shrec16_is_partial_in_place_and_z_up():
    for kind in ("cuts", "holes"):
        found = read_description(f"shrec16_{kind}")
        assert (found.up, found.partial, found.pre_aligned, found.truth) == ("z", True, True, "barycentric")
        assert found.folders == ("null", kind)


def test_one_s_own_description(tmp_path):
    (tmp_path / "teeth.toml").write_text('title = "Teeth"\nshapes = "scans/tooth_*.ply"\nup = "z"\ntruth = "none"\n')
    found = read_description(tmp_path / "teeth.toml")
    assert (found.name, found.title, found.up) == ("teeth", "Teeth", "z")
    (tmp_path / "scans").mkdir()
    (tmp_path / "scans" / "tooth_12.ply").touch()
    (tmp_path / "scans" / ".tooth_13.ply").touch()
    folder = ShapeFolder.open(tmp_path, tmp_path / "teeth.toml")
    assert folder.names == ("12",)
    assert folder.file("12") == tmp_path / "scans" / "tooth_12.ply"
    assert folder.up == "z" and ShapeFolder.open(tmp_path, found, up="x").up == "x"


def test_ranges_are_bounded_together():
    assert len(DatasetDescription(names=("a{1..60000}", "b{1..40000}")).expected_names) == 100_000
    with pytest.raises(ArgumentError, match=r"names holds the range \{1\.\.40001\}, but .* at most 100000 names"):
        DatasetDescription(names=("a{1..60000}", "b{1..40001}"))


MISTAKES = {
    'names = ["{1..1000000000}"]': r"names holds the range \{1\.\.1000000000\}, but all .* at most 100000 names",
    'names = ["a{7..6}"]': r"names holds the range \{7\.\.6\}, but a range must begin with its least number",
    'full_names = ["{1..%s}"]' % ("9" * 5000): r"full_names holds the range .*, but numbers .* at most 18 digits",
    'full_names = ["{%s1..2}"]' % ("0" * 5000): r"full_names holds the range .*, but numbers .* at most 18 digits",
    'titel = "x"': r"has an unknown key 'titel'; did you mean 'title'\?",
    'up = "w"': "up is 'w', but must be one of x, y, z",
    'truth = "template-correspondances"': "truth is .*, but must be one of .*did you mean 'template-correspondence'",
    'shapes = "off/a.off"': r"shapes is 'off/a.off', but must have one star, for a shape's name",
    'truth_files = "*/*.vts"': "truth_files is .* must have one star",
    "pre_aligned = true": "pre_aligned is true, which needs partial to be true",
    "shuffled = true": "shuffled is true, which needs truth to be 'same-numbering'",
    'truth = "barycentric"': "truth is 'barycentric', which needs pairs to be 'partial'",
    'pairs = "partial"\npartial = true': "full and pairs = 'partial' belong together",
    'full = "null/*.off"': "full and pairs = 'partial' belong together",
    'split = "last"': "n_test is 0, but split = 'last' needs at least 1",
    'holds = "volumes"': "holds is 'volumes', which needs truth to be 'none'",
    'n_points = "many"': "n_points is 'many', but must be a list of 2, each of them a whole number",
    "= 3": "is not valid TOML",
}


@pytest.mark.parametrize("text", MISTAKES)
def test_a_description_that_makes_no_sense_is_one_line_with_its_file(tmp_path, text):
    path = tmp_path / "mine.toml"
    path.write_text(text)
    with pytest.raises(ArgumentError, match=MISTAKES[text]) as caught:
        read_description(path)
    assert "\n" not in str(caught.value) and str(caught.value).startswith(str(path))


def test_a_set_that_is_not_known():
    with pytest.raises(
        ArgumentError, match=r"set is 'faust', .*did you mean 'faust_[ar]'\?; or give the path of a TOML"
    ):
        read_description("faust")
    with pytest.raises(ArgumentError, match=r"gone\.toml cannot be read"):
        read_description("gone.toml")


def test_volumes_are_no_shapes(tmp_path):
    with pytest.raises(DataError, match="holds volumes; make surfaces of them with homolog volume surface"):
        ShapeFolder.open(tmp_path, "luna16")


def test_shapes_that_are_not_all_of_the_set_are_warned_of(tmp_path, caplog):
    description = read_description("scape_r")
    empty(tmp_path, description)
    ShapeFolder.open(tmp_path, description)
    assert not caplog.records
    (tmp_path / "off" / "mesh007.off").unlink()
    ShapeFolder.open(tmp_path, description)
    assert re.search("has 70 shapes, but scape_r has 71; homolog data check scape_r", caplog.text)
