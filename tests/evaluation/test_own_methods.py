"""Scoring methods, maps and metrics of one's own."""

from __future__ import annotations

import csv
from types import SimpleNamespace

import numpy as np
import pytest
import scipy.io
import torch

from homolog.core.errors import ArgumentError, DataError
from homolog.core.files import write_csv
from homolog.datasets import ShapeFolder
from homolog.evaluation import MapsFolder, Protocol, evaluate, plot_pck
from homolog.matching import Match, Matcher
from homolog.pairs import MatcherSettings
from homolog.shapes import Shape, write_shape

N, UNUSED = 162, 50


@pytest.fixture
def folder(tmp_path, make) -> ShapeFolder:
    """Three shapes that are numbered alike, stretched otherwise, all of whose vertices are common points."""
    root, blob = tmp_path / "data", make.blob(2)
    (root / "off").mkdir(parents=True)
    (root / "corres").mkdir()
    for number, name in enumerate("abc"):
        write_shape(root / "off" / f"{name}.off", Shape(blob.points * [1, 1 + 0.2 * number, 1], blob.faces))
        (root / "corres" / f"{name}.vts").write_text("".join(f"{i + 1}\n" for i in range(N)))
    (root / "pairs.txt").write_text("a,b\nb,c\na,a\n")
    return ShapeFolder.open(root)


def with_unused_points(folder: ShapeFolder) -> ShapeFolder:
    """All shapes with points before their own that no face uses, which the ground truth does not name."""
    for file in (folder.root / "off").iterdir():
        shape = folder.shape(file.stem)
        stray = np.random.default_rng(0).normal(size=(UNUSED, 3))
        write_shape(file, Shape(np.concatenate([stray, shape.points]), shape.faces + UNUSED))
        (folder.root / "corres" / f"{file.stem}.vts").write_text("".join(f"{i + UNUSED + 1}\n" for i in range(N)))
    return ShapeFolder.open(folder.root)


ALL = Protocol(split="all")


def identity(source: Shape, target: Shape) -> np.ndarray:
    return np.arange(target.n_points)


def test_indices_are_those_of_the_files(folder):
    """The shapes are given as they are, unused points included, and so are the indices."""
    folder, sizes = with_unused_points(folder), []

    def method(source, target):
        sizes.append((source.n_points, target.n_points))
        return identity(source, target)

    found = evaluate(None, folder, ALL, match=method)
    assert sizes == [(N + UNUSED, N + UNUSED)] * 3
    assert len(found.errors) == 3 * N
    assert not found.errors.any()
    assert found.method == "method"
    assert found.to_dict()["mean_geodesic_error"] == 0
    # The same by a match, and one point on is no longer right.
    as_match = evaluate(None, folder, ALL, match=lambda s, t: Match(s, t, identity(t, s), identity(s, t)))
    assert not as_match.errors.any()
    shifted = evaluate(None, folder, ALL, match=lambda s, t: (np.arange(t.n_points) + 1) % t.n_points)
    assert np.mean(shifted.errors > 0) > 0.9


@pytest.mark.parametrize("size", [N - 1, N + 1])
def test_maps_of_another_length_name_the_pair(folder, size):
    with pytest.raises(ArgumentError, match=rf"a - b: target_to_source has shape \({size},\).* \({N},\)") as caught:
        evaluate(None, folder, ALL, match=lambda s, t: np.zeros(size, int))
    assert "\n" not in str(caught.value)

    def of_others(source, target):
        other = Shape(np.random.default_rng(0).normal(size=(size, 3)))
        return Match(source, other, np.zeros(N, int), np.zeros(size, int))

    with pytest.raises(ArgumentError, match=rf"a - b: the match has {size} target points, but must have {N}"):
        evaluate(None, folder, ALL, match=of_others)


@pytest.mark.parametrize(
    ("values", "said"),
    [
        (np.full(N, N), f"a - b: target_to_source holds {N}, but"),
        (np.zeros(N), "a - b: target_to_source holds float64"),
    ],
)
def test_maps_that_hold_other_things_name_the_pair(folder, values, said):
    with pytest.raises(ArgumentError, match=said):
        evaluate(None, folder, ALL, match=lambda s, t: values)


def test_abstaining_does_not_pay(folder):
    """A map that leaves out the half that it gets wrong has a larger mean, not a smaller one."""

    def half_wrong(source, target):
        wrong = np.roll(np.arange(N), 20)
        return np.where(np.arange(N) < N // 2, np.arange(N), wrong)

    def abstaining(source, target):
        return np.where(np.arange(N) < N // 2, np.arange(N), -1)

    whole, partly = (evaluate(None, folder, ALL, match=each).to_dict() for each in (half_wrong, abstaining))
    assert partly["mean_geodesic_error"] > whole["mean_geodesic_error"] > 0
    assert partly["mean_geodesic_error_of_matched_points"] == 0
    assert partly["unmatched_points"] == 3 * (N - N // 2)
    assert partly["pck_auc"] <= whole["pck_auc"]
    assert "unmatched_points" in whole and whole["unmatched_points"] == 0


def test_neither_a_matcher_nor_a_method(folder):
    with pytest.raises(ArgumentError, match="matcher is None, but maps must come from a matcher or from match"):
        evaluate(None, folder, ALL)


def test_a_method_that_gives_two_maps_is_told_which_one_is_wanted(folder):
    with pytest.raises(ArgumentError, match=rf"gave two values, but must give a Match, or one map: .*, \({N},\)$"):
        evaluate(None, folder, ALL, match=lambda source, target: (np.arange(N), np.arange(N)))
    with pytest.raises(ArgumentError, match=rf"target_to_source is a list that is no array, but .* \({N},\)$"):
        evaluate(None, folder, ALL, match=lambda source, target: [[1, 2], [3]])


def test_what_lacks_anything_of_a_matcher_is_refused_at_once(folder):
    lacking = SimpleNamespace(preprocess=None, paired=None, find=None)
    with pytest.raises(ArgumentError, match="matcher is a SimpleNamespace, but must be a Matcher; make one"):
        evaluate(lacking, folder, ALL)


def test_two_files_of_one_pair_are_refused(tmp_path):
    for name in ("a_b.txt", "a_b.vts"):
        (tmp_path / name).write_text("1\n")
    with pytest.raises(DataError, match=r"has several maps of a and b, a_b\.txt and a_b\.vts; keep one$"):
        MapsFolder(tmp_path).file("a", "b")


def test_clouds_reach_a_method_without_faces(folder):
    given = []

    def method(source, target):
        given.append((source, target))
        return identity(source, target)

    found = evaluate(None, folder, Protocol(split="all", modality="mesh-to-cloud", noise=0.01), match=method)
    assert not found.errors.any()
    for source, target in given:
        assert source.faces is not None and target.faces is None
    true = folder.shape("b").points
    assert 0 < np.abs(given[0][1].points - true).max() < 0.2
    np.testing.assert_array_equal(given[0][0].points, folder.shape("a").points)


# ---- maps of other programs


@pytest.mark.parametrize(
    ("name", "base"),
    [("{}_{}.txt", 0), ("{}-{}.vts", 1), ("{}__{}.map", 1), ("{}_{}.txt", 1)],
)
def test_a_folder_of_maps_is_scored_without_weights(folder, tmp_path, name, base):
    (tmp_path / "maps").mkdir()
    for source, target in folder.pairs("all"):
        np.savetxt(tmp_path / "maps" / name.format(source, target), np.arange(N) + base, fmt="%d")
    given = None if name != "{}_{}.txt" or base == 0 else base
    found = evaluate(None, folder, ALL, match=MapsFolder(tmp_path / "maps", base=given))
    assert not found.errors.any() and len(found.pairs) == 3
    assert found.method == "maps"


def test_matches_that_were_saved_are_scored_as_they_are(folder, tmp_path, make):
    answer = np.where(np.arange(N) % 5 == 0, -1, np.roll(np.arange(N), 7))
    for suffix in (".npz", ".mat"):
        (tmp_path / suffix).mkdir()
        for source, target in folder.pairs("all"):
            shapes = folder.shape(source), folder.shape(target)
            Match(*shapes, np.zeros(N, int), answer).save(tmp_path / suffix / f"{source}_{target}{suffix}")
        found = evaluate(None, folder, ALL, match=MapsFolder(tmp_path / suffix))
        expected = evaluate(None, folder, ALL, match=lambda s, t: answer)
        np.testing.assert_array_equal(found.errors, expected.errors)


def test_a_map_that_is_missing_is_named(folder, tmp_path):
    (tmp_path / "maps").mkdir()
    with pytest.raises(DataError, match="has no map of a and b; it must be called a_b"):
        evaluate(None, folder, ALL, match=MapsFolder(tmp_path / "maps"))
    identical = Protocol(split="all", pairs_file=str(tmp_path / "pairs.csv"))
    (tmp_path / "pairs.csv").write_text("a,a\n")
    with pytest.raises(
        DataError, match=r"no map of a and a; .*, --pairs FILE: without it each shape is matched with its"
    ):
        evaluate(None, folder, identical, match=MapsFolder(tmp_path / "maps"))
    with pytest.raises(DataError, match="nowhere is not a folder"):
        MapsFolder(tmp_path / "nowhere")


# ---- what is made of it


def shifted(source: Shape, target: Shape) -> np.ndarray:
    return np.where(np.arange(N) == 3, -1, np.roll(np.arange(N), 1))


def test_metrics_of_ones_own(folder, tmp_path):
    seen = []

    def unmatched(scored):
        seen.append(scored)
        return np.mean(scored.match.target_to_source < 0)

    def exact(scored):
        return np.mean(scored.match.target_to_source[scored.truth.target] == scored.truth.source)

    found = evaluate(None, folder, ALL, match=shifted, metrics={"unmatched": unmatched, "exact": exact})
    assert found.to_dict()["metrics"] == pytest.approx({"unmatched": 1 / N, "exact": 0})
    assert [pair.metrics["exact"] for pair in found.pairs] == [0, 0, 0]
    for scored, pair in zip(seen, found.pairs, strict=True):
        np.testing.assert_array_equal(scored.errors, pair.errors)
        assert scored.match.source.name == f"{pair.pair[0]}.off"


def test_a_table_of_pairs(folder, tmp_path):
    found = evaluate(None, folder, ALL, match=shifted, metrics={"two": lambda scored: 2})
    write_csv(tmp_path / "pairs.csv", found.rows())
    with (tmp_path / "pairs.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [(row["source"], row["target"]) for row in rows] == [("a", "b"), ("b", "c"), ("a", "a")]
    for row, pair in zip(rows, found.pairs, strict=True):
        assert (int(row["points"]), int(row["unmatched"])) == (N, 1)
        assert float(row["mean_geodesic_error"]) == pytest.approx(100 * pair.errors.mean())
        assert float(row["two"]) == 2 and row["coverage"] == ""
    assert repr(found).startswith("Evaluation(3 pairs by shifted: mean geodesic error ")


@pytest.mark.parametrize(
    ("suffix", "begins"), [(".png", b"\x89PNG\r\n"), (".svg", b"<?xml"), (".pdf", b"%PDF"), (".PNG", b"\x89PNG\r\n")]
)
def test_the_curve_as_a_picture(folder, tmp_path, suffix, begins):
    pytest.importorskip("matplotlib", reason="matplotlib is missing; pip install 'homolog[plot]'")
    found = evaluate(None, folder, ALL, match=shifted)
    plot_pck(tmp_path / f"curve{suffix}", {"mine": found, "theirs": found})
    content = (tmp_path / f"curve{suffix}").read_bytes()
    assert content.startswith(begins) and len(content) > 2000
    assert [path.name for path in tmp_path.glob("curve*")] == [f"curve{suffix}"]
    with pytest.raises(ArgumentError, match=r"^/.*jpg has the suffix '\.jpg', but .* \.png, \.pdf, \.svg$"):
        plot_pck(tmp_path / "curve.jpg", {"mine": found})


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ({"split": "foo"}, "split is 'foo', but must be one of train, test, all"),
        ({"modality": "clod"}, "modality is 'clod', but must be one of mesh, cloud, .*; did you mean 'cloud'"),
        ({"noise": "x"}, "noise is 'x', but must be a number of at least 0, in units of sqrt"),
        ({"n_pairs": 0}, "n_pairs is 0, but must be a whole number of at least 1, or None"),
        ({"seed": -1}, "seed is -1, but must be a whole number of at least 0"),
        ({"partial": "yes"}, "partial holds 'yes', but must be true or false, or 'both'"),
        ({"pairs_file": 5}, "pairs_file is 5, but must be a text"),
    ],
)
def test_a_protocol_that_cannot_be_is_refused_as_it_is_made(values, said):
    with pytest.raises(ArgumentError, match=f"^{said}") as caught:
        Protocol(**values)
    assert "\n" not in str(caught.value)


def write_maps(folder, root, name, indices):
    root.mkdir()
    for source, target in folder.pairs("all"):
        if name.endswith(".mat"):
            scipy.io.savemat(root / name.format(source, target), {"matches": indices})
        else:
            np.savetxt(root / name.format(source, target), indices, fmt="%d")
    return root


FROM_ZERO = np.roll(np.arange(N), 3)


@pytest.mark.parametrize(
    ("name", "indices", "said", "base"),
    [
        ("{}_{}.vts", FROM_ZERO, f"holds 0, and {N - 1} at most: its indices seem to count from 0", 0),
        ("{}_{}.map", np.minimum(FROM_ZERO, 5), "holds 0, and 5 at most: its indices seem to count from 0", 0),
        ("{}_{}.mat", FROM_ZERO, f"count from 1, to {N}; give base=0, or base=1 if 0 stands for a point without", 0),
        ("{}_{}.vts", np.where(FROM_ZERO == 2, -1, FROM_ZERO), "holds -1, but must hold indices from 1, or 0 for", 0),
        ("{}_{}.txt", FROM_ZERO + 1, f"holds {N}, but must hold indices from 0 to {N - 1}; give base=1", 1),
        ("{}_{}.txt", np.where(FROM_ZERO == 2, 0, FROM_ZERO + 1), f"holds {N}, but must hold indices from 0", 1),
    ],
)
def test_maps_that_count_from_another_index_are_noticed(folder, tmp_path, name, indices, said, base):
    maps = write_maps(folder, tmp_path / "maps", name, indices)
    with pytest.raises(DataError, match=said) as caught:
        evaluate(None, folder, ALL, match=MapsFolder(maps))
    assert f"base={base}" in str(caught.value) and "\n" not in str(caught.value)
    found = evaluate(None, folder, ALL, match=MapsFolder(maps, base=base))
    expected = evaluate(None, folder, ALL, match=lambda source, target: indices - base)
    np.testing.assert_array_equal(found.errors, expected.errors)


def test_zero_for_none_is_no_mistake_where_the_last_point_is_there(folder, tmp_path):
    indices = np.where(FROM_ZERO == 2, 0, FROM_ZERO + 1)
    found = evaluate(None, folder, ALL, match=MapsFolder(write_maps(folder, tmp_path / "maps", "{}_{}.vts", indices)))
    assert sum((~pair.matched).sum() for pair in found.pairs) == 3


MATCHER = Matcher(settings=MatcherSettings(method="registration"), device="cpu")


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (
            lambda folder: evaluate(MATCHER, str(folder.root)),
            "folder is a str, but must be a ShapeFolder; open one with",
        ),
        (lambda folder: evaluate(MATCHER, None), "folder is None, but must be a ShapeFolder"),
        (
            lambda folder: evaluate(identity, folder),
            "matcher is the function identity, but must be a Matcher; give None",
        ),
        (lambda folder: evaluate("people", folder), "matcher is a str, but must be a Matcher; make one with"),
        (lambda folder: evaluate(folder, MATCHER), "matcher is a ShapeFolder, but must be a Matcher"),
        (lambda folder: evaluate(MATCHER, folder, "all"), "protocol is a str, but must be a Protocol"),
        (lambda folder: evaluate(None, folder, match="maps"), "match is 'maps', but must be a function"),
        (lambda folder: evaluate(MATCHER, folder, match_pair=3), "match_pair is 3, but must be a function"),
        (
            lambda folder: evaluate(MATCHER, folder, match=identity, match_pair=identity),
            "match and match_pair are both",
        ),
        (
            lambda folder: evaluate(MATCHER, folder, match_pair=lambda pair: 3),
            "what match_pair gave is an int, but must",
        ),
        (lambda folder: evaluate(None, folder, match=identity, metrics=[len]), "metrics is .*, but must be a table of"),
        (
            lambda folder: evaluate(None, folder, match=identity, metrics={"one": 1}),
            r"metrics\['one'\] is 1, but must be",
        ),
        (lambda folder: evaluate(None, folder, match=identity, metrics={1: len}), r"metrics\[1\] is .*, under a name"),
        *(
            (
                lambda folder, figure=figure: evaluate(
                    None, folder, ALL, match=identity, metrics={"mine": lambda scored: figure}
                ),
                f"the metric 'mine' of a - b is {said}, but must be a finite number",
            )
            for figure, said in (
                (None, "None"),
                ("much", "'much'"),
                (np.zeros(2), r"array\(.*\)"),
                (np.nan, "nan"),
                (np.inf, "inf"),
                (True, "True"),
                (np.True_, r"(np\.)?True_?"),
                (torch.tensor(False), r"tensor\(False\)"),
                (1j, "1j"),
            )
        ),
    ],
)
def test_what_evaluate_cannot_use_is_one_line(folder, call, said):
    with pytest.raises(ArgumentError, match=said) as caught:
        call(folder)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("figure", [np.float32(2), torch.tensor(2.0), np.array(2), np.int8(1)])
def test_figures_may_be_numbers_of_any_kind(folder, figure):
    found = evaluate(None, folder, ALL, match=identity, metrics={"mine": lambda scored: figure})
    assert found.to_dict()["metrics"]["mine"] == float(figure)


def failing(*given):
    return 1 / 0


def test_truth_whose_points_no_face_uses_is_a_fault_of_the_data(folder):
    folder = with_unused_points(folder)
    for file in (folder.root / "corres").iterdir():
        file.write_text("1\n2\n")
    with pytest.raises(DataError, match="no pair has a common point that could be matched"):
        evaluate(None, folder, ALL, match=lambda source, target: np.full(target.n_points, -1))


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ({"match": failing}, "match 'failing' failed on a -> b: ZeroDivisionError: division by zero"),
        (
            {"match": identity, "metrics": {"mine": failing}},
            "the metric 'mine' failed on a -> b: ZeroDivisionError: div",
        ),
    ],
)
def test_functions_that_fail_are_named_with_the_pair(folder, words, said):
    with pytest.raises(ArgumentError, match=said) as caught:
        evaluate(None, folder, ALL, **words)
    assert isinstance(caught.value.__cause__, ZeroDivisionError)
