"""Landmarks on the page of a match: which are there, the files they are saved in, and how to match again by them."""

import shlex
from dataclasses import replace

import numpy as np
import pytest

from homolog.matching import Match
from homolog.pairs import LandmarkPairs, PairOptions
from homolog.shapes import Shape
from homolog.viewing import guide_of, scene_of


def told(match, options=None, **report):
    """The match with options and other entries in its report."""
    given = {} if options is None else {"options": options.to_dict()}
    return replace(match, report={**match.report, **given, **report})


def test_landmarks_that_guided_are_there_at_the_nearest_points(known):
    near = known.target.points[[7, 9]] + 1e-4
    pairs = LandmarkPairs([4, 5], near, names=["nose", "tail"])
    assert guide_of(told(known, PairOptions(landmarks=pairs))).known == (("nose", 4, 7), ("tail", 5, 9))
    assert guide_of(known).known == ()


def test_positions_in_other_axes_are_found(known):
    """Files of Slicer may be in RAS, where the shapes are taken to be in LPS."""
    flipped = known.target.points[[7]] * [-1, -1, 1]
    pairs = replace(LandmarkPairs([4], flipped), axes=(None, "RAS"))
    assert guide_of(told(known, PairOptions(landmarks=pairs))).known == (("", 4, 7),)
    inputs = {side: {**known.report["inputs"][side], "space": "RAS"} for side in ("source", "target")}
    guide = guide_of(told(known, PairOptions(landmarks=LandmarkPairs([4], known.target.points[[7]])), inputs=inputs))
    assert guide.systems == ("RAS", "RAS") and guide.known == (("", 4, 7),)


@pytest.mark.parametrize(("names", "shown"), [(["1", "2"], ["", ""]), (["a", "2"], ["a", ""]), (["a", "a"], ["", ""])])
def test_names_that_a_file_can_hold(known, names, shown):
    """Numbers are counted anew as landmarks go and come, and no name stands there twice."""
    guide = guide_of(told(known, PairOptions(landmarks=LandmarkPairs([1, 2], [3, 4], names=names))))
    assert [name for name, *_ in guide.known] == shown


def test_names_of_files(known):
    assert guide_of(known).files == ("a_blob-landmarks.mrk.json", "other-landmarks.mrk.json")
    alike = {"source": {"file": "one/-scan.ply"}, "target": {"file": "two/-scan.ply"}}
    assert guide_of(told(known, inputs=alike)).files == ("source-landmarks.mrk.json", "target-landmarks.mrk.json")


def test_the_command_says_what_was_said(known):
    words = shlex.split(guide_of(known).command)
    assert words[:4] == ["homolog", "match", "/data/a blob.off", "other.off"]
    assert words[4:] == ["--landmarks", *guide_of(known).files, "-o", "guided", "--html", "guided.html"]
    options = PairOptions(partial="source", partial_scale=0.5, pre_aligned=True, source_up="z", landmarks=([1], [2]))
    match = told(known, options, settings={"method": "axiomatic"}, adapt=3)
    given = shlex.split(guide_of(match, alternatives=3).command)[7:-4]
    assert given == [
        *("--method", "axiomatic", "--adapt", "3", "--partial", "source", "--partial-scale", "0.5"),
        *("--pre-aligned", "--source-up", "z", "--alternatives", "3"),
    ]


def test_weights_and_masks_of_which_the_file_is_not_known(known):
    masked = {"source": {"findings": [{"rule": "points outside the mask"}]}}
    for name, choice, said in (("people", [], "people"), ("mine", [], "FILE"), ("people", [{"name": "people"}], None)):
        match = told(known, features={"name": name, "sha256": "0"}, choice=choice, inputs=masked)
        words = shlex.split(guide_of(match).command)
        assert words[words.index("--source-mask") + 1] == "FILE" and "--target-mask" not in words
        assert (words[words.index("--weights") + 1] if "--weights" in words else None) == said


def test_weights_that_came_from_a_file_are_named_even_if_they_are_called_as_pretrained_ones(known):
    features = {"name": "people", "sha256": "0", "file": "my weights/people.safetensors"}
    words = shlex.split(guide_of(told(known, features=features)).command)
    assert words[words.index("--weights") + 1] == "my weights/people.safetensors"


def test_a_mask_that_came_from_a_file_is_named(known):
    inputs = {"source": {"mask": "masks/no feet.npy"}, "target": {"mask": "target_mask"}}
    words = shlex.split(guide_of(told(known, inputs=inputs)).command)
    assert words[words.index("--source-mask") + 1] == "masks/no feet.npy"
    assert words[words.index("--target-mask") + 1] == "FILE"


def test_places_go_back_to_the_coordinates_of_the_files(make):
    """However they stand, and in whatever unit they are."""
    blob = make.blob(1)
    far = Shape(1000 * blob.points @ make.rotation(0) + [5, -3, 9], blob.faces)
    match = Match(blob, far, np.arange(42), np.arange(42), report={"options": {"source_up": "z", "target_up": "x"}})
    for side, body in scene_of(match).bodies.items():
        places = np.concatenate([body.points, np.ones((42, 1))], axis=1) @ body.to_file
        np.testing.assert_allclose(places, getattr(match, side).points, rtol=1e-9, atol=1e-9)
