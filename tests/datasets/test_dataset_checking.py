"""Checking a folder: what is found in good ones, and the line that each fault gives."""

import subprocess
from dataclasses import replace

import numpy as np
import pytest

from homolog.datasets import DatasetDescription, check_dataset, read_description
from homolog.shapes import write_shape
from homolog.synthesis import ViewSettings, write_view_dataset


@pytest.fixture
def own(tmp_path, make):
    """Four shapes of 42 to 642 points with template points, and lists."""
    root = tmp_path / "own"
    (root / "off").mkdir(parents=True)
    (root / "corres").mkdir()
    for number, name in enumerate("abcd"):
        write_shape(root / "off" / f"{name}.off", make.sphere(1 + number // 2))
        (root / "corres" / f"{name}.vts").write_text("1\n42\n7\n")
    (root / "train.txt").write_text("a\nb\nc\n")
    (root / "test.txt").write_text("d\nc\n")
    return root


LISTED = DatasetDescription(
    name="own",
    names=("a", "b", "c", "d"),
    split="listed",
    n_train=3,
    n_test=2,
    n_pairs=4,
    n_points=(42, 162),
    n_truth=3,
)


def test_a_set_as_it_should_be(own):
    told = []
    found = check_dataset(own, LISTED, progress=lambda *state: told.append(state))
    assert found.findings == []
    assert (found.n_shapes, found.n_full, found.n_points, found.n_truth) == (4, 0, (42, 162), (3, 3))
    assert found.splits == {"train": 3, "test": 2, "all": 4}
    assert found.pairs == {"train": 9, "test": 4, "all": 16}
    assert told == [(number, 4, name) for number, name in enumerate("abcd")]


def test_the_checksum_is_that_of_sha256sum(own):
    command = "sha256sum $(find corres off -type f | LC_ALL=C sort) | sha256sum"
    said = subprocess.run(command, shell=True, cwd=own, capture_output=True, text=True, check=True).stdout
    checksum = check_dataset(own, LISTED).sha256
    assert checksum == said.split()[0]
    assert check_dataset(own, replace(LISTED, sha256=checksum)).findings == []
    (own / "corres" / "a.vts").write_text("1\n42\n8\n")
    (finding,) = check_dataset(own, replace(LISTED, sha256=checksum)).findings
    assert finding.endswith(f", but the dataset's is {checksum}")


def without(place):
    return lambda root: (root / place).unlink()


def writing(place, text):
    return lambda root: (root / place).write_text(text)


CLOUD = "OFF\n5 0 0\n0 0 0\n1 0 0\n0 1 0\n0 0 1\n1 1 1\n"
FAULTS = {
    "shape": (without("off/b.off"), ["put b.off at ROOT/off/b.off", "train.txt names 'b'"]),
    "truth": (without("corres/a.vts"), ["put a.vts at ROOT/corres/a.vts"]),
    "split": (without("test.txt"), ["put test.txt at ROOT/test.txt", "ROOT/test.txt cannot be read"]),
    "other shape": (writing("off/e.off", CLOUD), ["take ROOT/off/e.off away", "put e.vts at", "e.off has no faces"]),
    "cloud": (
        writing("off/a.off", CLOUD),
        ["ROOT/off/a.off has no faces", "5 to 162 points, but those of the dataset have 42"],
    ),
    "damaged": (writing("off/d.off", "OFF\n1 2"), ["ROOT/off/d.off"]),
    "range": (writing("corres/d.vts", "163\n1\n1\n"), ["ROOT/corres/d.vts names vertex 163, but the shape has 162"]),
    "first": (writing("corres/a.vts", "43\n1\n1\n"), ["ROOT/corres/a.vts names vertex 43, but the shape has 42"]),
    "malformed": (writing("corres/c.vts", "one\n"), ["ROOT/corres/c.vts must hold a vertex number a line"]),
    "lines": (writing("corres/c.vts", "1\n2\n"), ["a has 3 template points and c 2"]),
    "fewer in the split": (
        writing("train.txt", "a\nb\n"),
        ["split 'train' has 2 shapes, but that of the dataset has 3"],
    ),
    "more in the test": (
        writing("test.txt", "a\nb\nc\n"),
        [
            "split 'test' has 3 shapes, but that of the dataset has 2",
            "split 'test' has 9 pairs, but that of the dataset has 4",
        ],
    ),
    "unknown in the split": (writing("train.txt", "a\nb\nx\n"), ["ROOT/train.txt names 'x'"]),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_each_fault_is_a_line(own, fault):
    spoil, wanted = FAULTS[fault]
    spoil(own)
    findings = check_dataset(own, LISTED).findings
    for words in wanted:
        assert any(words.replace("ROOT", str(own)) in finding for finding in findings), findings
    assert not any("\n" in finding for finding in findings)
    assert len(findings) == len(wanted) + (fault in ("other shape", "cloud")) * (len(findings) - len(wanted))


def test_counts_where_names_are_not_known(own):
    described = replace(LISTED, names=(), n_shapes=6)
    assert check_dataset(own, described).findings == [f"put the 2 missing of 6 shapes at {own / 'off' / 'NAME.off'}"]
    described = replace(LISTED, names=(), n_shapes=3)
    assert check_dataset(own, described).findings == [
        f"take 1 of the 4 shapes at {own / 'off' / 'NAME.off'} away; the dataset has 3"
    ]


def test_a_folder_of_one_s_own_needs_no_counts(own):
    (own / "train.txt").unlink()
    (own / "test.txt").unlink()
    found = check_dataset(own, DatasetDescription())
    assert found.findings == []
    assert found.splits == {"test": 4, "all": 4}


def test_no_folder_and_an_empty_one(tmp_path):
    (finding,) = check_dataset(tmp_path / "gone", read_description("faust_r")).findings
    assert finding.startswith(
        f"there is no folder {tmp_path / 'gone'}; put the dataset there; get it from the link FAUST"
    )
    (tmp_path / "empty").mkdir()
    assert check_dataset(tmp_path / "empty", DatasetDescription()).findings == [
        f"put the shapes at {tmp_path / 'empty' / 'off' / 'NAME.off'}"
    ]
    assert len(check_dataset(tmp_path / "empty", read_description("faust_r")).findings) == 100


def test_parts(parts_set):
    root, _ = parts_set
    described = replace(read_description("shrec16_cuts"), full_names=("cat", "dog"))
    found = check_dataset(root, described)
    assert found.findings == []
    assert (found.n_shapes, found.n_full) == (3, 2)
    assert found.n_truth == (40, 90)
    assert found.pairs["test"] == 3
    assert len(check_dataset(root, read_description("shrec16_cuts")).findings) == 6  # the other complete shapes
    path = root / "cuts" / "cuts_dog_2.baryc_gt"
    path.write_text("321 1 0 0\n" * 40)
    assert check_dataset(root, described).findings == [f"{path} names triangle 321, but dog.off has 320"]
    (root / "null" / "dog.off").unlink()
    findings = check_dataset(root, described).findings
    assert f"put dog.off at {root / 'null' / 'dog.off'}" in findings
    assert any("cuts_dog_2: no full shape" in finding for finding in findings)


def test_clouds(clouds_set):
    root, _ = clouds_set
    small = {"split": "test", "n_shapes": 3, "n_train": 0, "n_test": 0, "n_pairs": 9, "n_points": (50, 50)}
    described = replace(read_description("lungs"), **small)
    assert check_dataset(root, described).findings == []
    with (root / "landmarksC.csv").open("a") as file:
        file.write("1,2,3\n")
    findings = check_dataset(root, described).findings
    assert any("A has 50 points and C 51" in finding for finding in findings)
    assert any("50 to 51 points, but those of the dataset have 50" in finding for finding in findings)


def test_clouds_of_views(tmp_path, make):
    (tmp_path / "in" / "off").mkdir(parents=True)
    (tmp_path / "in" / "corres").mkdir()
    for name in "abcde":
        write_shape(tmp_path / "in" / "off" / f"{name}.off", make.blob())
        vertices = (str(i + 1) for i in range(make.blob().n_points))
        (tmp_path / "in" / "corres" / f"{name}.vts").write_text("\n".join(vertices))
    root, described = tmp_path / "out", read_description("views")
    write_view_dataset(tmp_path / "in", root, views=5, seed=0, settings=ViewSettings(pixels=(24, 18)))
    assert check_dataset(root, described).findings == []
    path = root / "truth" / "view_000003.npz"
    with np.load(path) as arrays:
        changed = {**arrays, "cloud_to_full": arrays["cloud_to_full"] + 10_000}
    np.savez(path, **changed)
    (finding,) = check_dataset(root, described).findings
    assert finding.startswith(f"{path} names point 1")
    np.savez_compressed(path, cloud_to_full=np.arange(1000))
    whole = path.read_bytes()
    for damaged in (b"no arrays", whole[:80] + b"\xff" * 40 + whole[120:]):
        path.write_bytes(damaged)
        (finding,) = check_dataset(root, described).findings
        assert finding.startswith(f"{path} must hold cloud_to_full")


def test_volumes(tmp_path):
    place = tmp_path / "seg-lungs-LUNA16"
    place.mkdir()
    for name in "ab":
        (place / f"{name}.mhd").write_text(f"NDims = 3\nElementDataFile = {name}.zraw\n")
        (place / f"{name}.zraw").write_bytes(b"0")
    described = replace(read_description("luna16"), n_shapes=2)
    found = check_dataset(tmp_path, described)
    assert (found.findings, found.n_shapes) == ([], 2)
    (place / "b.zraw").unlink()
    (place / "a.mhd").write_bytes(b"\xff\xfe")
    findings = check_dataset(tmp_path, described).findings
    assert findings == [
        f"{place / 'a.mhd'} is no MetaImage header that names its ElementDataFile; get it again",
        f"put b.zraw at {place / 'b.zraw'}",
    ]


def test_maps_that_do_not_fit(tmp_path, make):
    (tmp_path / "off").mkdir()
    (tmp_path / "corres").mkdir()
    for name in "12":
        write_shape(tmp_path / "off" / f"{name}.off", make.sphere(1))
    (tmp_path / "corres" / "1_2.map").write_text("".join(f"{number}\n" for number in range(1, 43)))
    described = replace(read_description("shrec19_maps"), names=("1", "2"), n_pairs=1)
    found = check_dataset(tmp_path, described)
    assert (found.findings, found.n_truth) == ([], (42, 42))
    (tmp_path / "corres" / "2_1.map").write_text("43\n" * 42)
    findings = check_dataset(tmp_path, described).findings
    assert f"{tmp_path / 'corres' / '2_1.map'} names vertex 43, but the shape has 42" in findings
    assert any("has 2 pairs, but that of the dataset has 1" in finding for finding in findings)


def test_every_missing_file_of_a_list_is_named_and_the_others_are_read(own):
    (own / "train.txt").write_text("a\nx\nb\ny\n")
    (own / "pairs.txt").write_text("a,z\nc,w\n")
    (own / "corres" / "c.vts").write_text("1\n2\n")
    findings = check_dataset(own, DatasetDescription()).findings
    for name, listed in (("x", "train.txt"), ("y", "train.txt"), ("w", "pairs.txt"), ("z", "pairs.txt")):
        assert f"{own / listed} names '{name}', but {own / 'off'} has no {name}.off; put it there" in findings
    assert any("template points" in finding for finding in findings)


@pytest.mark.reference
@pytest.mark.parametrize(
    ("folder", "name", "n_shapes", "n_pairs"),
    [
        ("SMAL_r", "smal_r", 49, 289),
        ("SHREC16", "shrec16_holes", 55, 55),
        ("LUNGS", "lungs", 48, 256),
    ],
)
def test_the_real_files(benchmark_set, folder, name, n_shapes, n_pairs):
    found = check_dataset(benchmark_set(folder), read_description(name))
    assert found.findings == []
    assert (found.n_shapes, found.pairs["test"]) == (n_shapes, n_pairs)


@pytest.mark.reference
def test_a_part_of_the_real_files(benchmark_set):
    root = benchmark_set("SHREC19_sample")
    found = check_dataset(root, read_description("shrec19"))
    assert found.n_truth == (6890, 6890)
    assert f"put 40.off at {root / 'off' / '40.off'}" in found.findings
    assert len(found.findings) == 41 + 1 and "has 2 pairs, but that of the dataset has 407" in found.findings[-1]
