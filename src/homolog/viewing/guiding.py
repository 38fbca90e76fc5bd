"""Landmarks on the page of a match: those that guided it, and how to match again with others."""

from __future__ import annotations

import re
import shlex
from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import PurePath
from typing import Any

import numpy as np
from scipy.spatial import KDTree

from homolog.core.choices import System
from homolog.core.method_names import AUTO
from homolog.core.pretrained import pretrained_weights
from homolog.geometry import MASKED
from homolog.matching import Match, matched_name
from homolog.pairs import MASK_SUFFIXES, SIDES, LandmarkPairs, PairOptions, Side

_FILE = "{}-landmarks.mrk.json"
# Folder and page of the match that the page proposes.
_AGAIN = "guided"
# What a shell or a browser may take for something else than a part of a name.
_SPECIAL = re.compile(r"[^\w.-]+|^[.-]+")


@dataclass(frozen=True)
class Guide:
    """What a page needs to know to take landmarks.

    Args:
        files: the names under which landmarks of the source and of the target are saved.
        systems: the anatomical axes that these files state.
        known: landmarks that are there to begin with: their name, empty where they have none, and their points.
        command: which matches again with these files.
    """

    files: tuple[str, str]
    systems: tuple[System, System]
    known: tuple[tuple[str, int, int], ...]
    command: str


def guide_of(match: Match, *, alternatives: int = 1) -> Guide:
    """The guide of a match, by its report.

    Args:
        match: whose landmarks are there to begin with.
        alternatives: so many maps are to be made again.
    """
    files = _file_names(match)
    # Files of landmarks are taken to be in LPS where the shapes' files state no system.
    source, target = (match.report.get("inputs", {}).get(side, {}).get("space") for side in SIDES)
    systems: tuple[System, System] = source or "LPS", target or "LPS"
    command = _command(match, alternatives, files)
    return Guide(files, systems, tuple(_known(match, systems)), shlex.join(command))


def _file_names(match: Match) -> tuple[str, str]:
    stems = [PurePath(matched_name(match.report, side, otherwise=getattr(match, side).name)).stem for side in SIDES]
    plain = [_SPECIAL.sub("_", stem) for stem in stems]
    first, second = SIDES if plain[0] == plain[1] else plain
    return _FILE.format(first), _FILE.format(second)


def _known(match: Match, systems: tuple[System, System]) -> list[tuple[str, int, int]]:
    """The landmarks that guided the match, at the nearest points."""
    given = match.report.get("options", {}).get("landmarks")
    if not given:
        return []
    pairs = LandmarkPairs(**given) if isinstance(given, Mapping) else given
    source, target = (
        [_nearest(match, side, place) for place in pairs.on(side, axes)]
        for side, axes in zip(SIDES, systems, strict=True)
    )
    # Numbers are names of those that have none; and a page can have no name twice.
    named = len({*pairs.names}) == len(pairs) and not all(name.isdecimal() for name in pairs.names)
    names = ["" if name.isdecimal() or not named else name for name in pairs.names]
    return [found for found in zip(names, source, target, strict=True) if min(found[1:]) >= 0]


def _nearest(match: Match, side: Side, place: int | tuple[float, float, float]) -> int:
    """The point of a shape at a landmark; -1 for an index that is none of a point's."""
    points = getattr(match, side).points
    if isinstance(place, int):
        return place if place < len(points) else -1
    there = np.flatnonzero(np.isfinite(points).all(axis=1))
    return int(there[KDTree(points[there]).query(place)[1]])


def _command(match: Match, alternatives: int, landmarks: tuple[str, str]) -> list[str]:
    """The words of a command that matches as before, but by these landmarks, and writes elsewhere."""
    inputs = match.report.get("inputs", {})
    files = [str(inputs.get(side, {}).get("file", getattr(match, side).name)) for side in SIDES]
    words = ["homolog", "match", *files, "--landmarks", *landmarks, *_made_with(match.report), *_options(match.report)]
    if alternatives > 1:
        words += ["--alternatives", str(alternatives)]
    return [*words, "-o", _AGAIN, "--html", f"{_AGAIN}.html"]


def _made_with(report: Mapping[str, Any]) -> list[str]:
    """Method and weights, where they were not chosen for the pair."""
    words, method = list[str](), report.get("settings", {}).get("method", AUTO)
    if method != AUTO:
        words += ["--method", method]
    features = report.get("features") or {}
    if features.get("sha256") and not report.get("choice"):
        known = features["name"] in pretrained_weights()
        words += ["--weights", features.get("file", features["name"] if known else "FILE")]
    if report.get("adapt"):
        words += ["--adapt", str(report["adapt"])]
    return words


def _options(report: Mapping[str, Any]) -> list[str]:
    """What was said of the pair, but for its landmarks; of masks that came from no file, none is known."""
    given, words = report.get("options", {}), list[str]()
    for field in fields(PairOptions):
        value = given.get(field.name, field.default)
        if value == field.default or field.name == "landmarks":
            continue
        words += [f"--{field.name.replace('_', '-')}", *([] if value is True else [str(value)])]
    for side in SIDES:
        told = report.get("inputs", {}).get(side, {})
        name = told.get("mask", "")
        if PurePath(name).suffix.lower() in MASK_SUFFIXES:
            words += [f"--{side}-mask", name]
        elif name or any(finding["rule"] == MASKED for finding in told.get("findings", [])):
            words += [f"--{side}-mask", "FILE"]
    return words
