"""Making a dataset of synthetic bodies, each body independently of the others."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from typing import Any, get_args

from homolog.core.arguments import check_choice, check_count, is_real
from homolog.core.choices import Bone, HandSides, Poses, Turn
from homolog.core.cluster import Processes
from homolog.core.errors import bad_value
from homolog.core.files import expanded, sha256
from homolog.core.progress import Progress, ignore
from homolog.core.tasks import check_processes, run_tasks
from homolog.geometry.surface import BarycentricPoints
from homolog.synthesis.animals import Animals
from homolog.synthesis.bodies import BodySettings, Kind, make_body
from homolog.synthesis.body_folder import BodyFolder
from homolog.synthesis.body_model import BodyModel
from homolog.synthesis.bones import Bones
from homolog.synthesis.hands import Hands
from homolog.synthesis.heads import Heads
from homolog.synthesis.organs import Organs
from homolog.synthesis.people import People
from homolog.synthesis.template import sample_evenly

TEMPLATE_POINTS = 5000
"""The number of template points that carry the ground truth."""


def synthesize_people(
    output: str | Path,
    n: int,
    settings: BodySettings | None = None,
    *,
    poses: Poses = "natural",
    processes: Processes = 1,
    progress: Progress = ignore,
) -> BodyFolder:
    """Write a dataset of synthetic people: the first ``n`` bodies of an endless sequence, as far as they are missing.

    Args:
        output: the folder; it may hold bodies made with the same settings, which are kept.
        n: number of bodies.
        settings: seed and meshing.
        poses: ``"natural"``, or ``"wide"`` for those of gymnasts and of people who lie, crawl or fall.
        processes: number of worker processes, or a cluster; the bodies do not depend on it.
        progress: called with the number of finished bodies, their total and the current body's name.

    Returns:
        The folder, which ``ShapeFolder`` reads.

    Raises:
        ArgumentError: if an argument is out of range, or the folder holds something else or cannot be written to.
        MissingExtraError: if the package anny is not installed.

    Examples:
        >>> synthesize_people("people", 500, BodySettings(seed=1), processes=4)  # doctest: +SKIP
    """
    check_choice("poses", poses, get_args(Poses))
    return _synthesize(partial(_of_model, People, poses), output, n, settings, processes=processes, progress=progress)


def synthesize_animals(
    output: str | Path,
    n: int,
    settings: BodySettings | None = None,
    *,
    processes: Processes = 1,
    progress: Progress = ignore,
) -> BodyFolder:
    """Write a dataset of synthetic animals with four legs, as ``synthesize_people`` writes people.

    Four bodies in a row are one individual in different poses.

    Args:
        output: the folder; it may hold bodies made with the same settings, which are kept.
        n: number of bodies.
        settings: seed and meshing.
        processes: number of worker processes, or a cluster; the bodies do not depend on it.
        progress: called with the number of finished bodies, their total and the current body's name.

    Returns:
        The folder, which ``ShapeFolder`` reads.

    Raises:
        ArgumentError: if an argument is out of range, or the folder holds something else or cannot be written to.

    Examples:
        >>> synthesize_animals("animals", 400, BodySettings(seed=1), processes=4)  # doctest: +SKIP
    """
    return _synthesize(Animals, output, n, settings, processes=processes, progress=progress)


def synthesize_hands(
    output: str | Path,
    n: int,
    settings: BodySettings | None = None,
    *,
    sides: HandSides = "both",
    processes: Processes = 1,
    progress: Progress = ignore,
) -> BodyFolder:
    """Write a dataset of synthetic hands, as ``synthesize_people`` writes people.

    Four bodies in a row are one individual in different poses; every second one is open at the wrist.

    Args:
        output: the folder; it may hold hands made with the same settings, which are kept.
        n: number of hands.
        settings: seed and meshing.
        sides: ``"left"``, ``"right"``, or ``"both"``: individuals of which every second one is a right hand.
        processes: number of worker processes, or a cluster; the hands do not depend on it.
        progress: called with the number of finished hands, their total and the current hand's name.

    Returns:
        The folder, which ``ShapeFolder`` reads.

    Raises:
        ArgumentError: if an argument is out of range, or the folder holds something else or cannot be written to.
        MissingExtraError: if the package anny is not installed.

    Examples:
        >>> synthesize_hands("hands", 400, BodySettings(seed=1), processes=4)  # doctest: +SKIP
    """
    check_choice("sides", sides, get_args(HandSides))
    return _synthesize(
        partial(_of_model, Hands, sides, details=True), output, n, settings, processes=processes, progress=progress
    )


def synthesize_heads(
    output: str | Path,
    n: int,
    settings: BodySettings | None = None,
    *,
    processes: Processes = 1,
    progress: Progress = ignore,
) -> BodyFolder:
    """Write a dataset of synthetic heads, as ``synthesize_people`` writes people.

    Four bodies in a row are one individual with different expressions; every second one is open at the neck.

    Args:
        output: the folder; it may hold heads made with the same settings, which are kept.
        n: number of heads.
        settings: seed and meshing.
        processes: number of worker processes, or a cluster; the heads do not depend on it.
        progress: called with the number of finished heads, their total and the current head's name.

    Returns:
        The folder, which ``ShapeFolder`` reads.

    Raises:
        ArgumentError: if an argument is out of range, or the folder holds something else or cannot be written to.
        MissingExtraError: if the package anny is not installed.

    Examples:
        >>> synthesize_heads("heads", 400, BodySettings(seed=1), processes=4)  # doctest: +SKIP
    """
    return _synthesize(
        partial(_of_model, Heads, details=True), output, n, settings, processes=processes, progress=progress
    )


def synthesize_bones(
    output: str | Path,
    n: int,
    settings: BodySettings | None = None,
    *,
    bone: Bone = "femur",
    turn: Turn = "any",
    processes: Processes = 1,
    progress: Progress = ignore,
) -> BodyFolder:
    """Write a dataset of synthetic bones of one kind, each of another person, as ``synthesize_people`` writes people.

    They are samples of a statistical model of the bones of 26 people, in millimetres.

    Args:
        output: the folder; it may hold bones made with the same settings, which are kept.
        n: number of bones.
        settings: seed and meshing.
        bone: which bone.
        turn: how bones are turned: ``"none"``, about the ``"vertical"``, or ``"any"`` way round.
        processes: number of worker processes, or a cluster; the bones do not depend on it.
        progress: called with the number of finished bones, their total and the current bone's name.

    Returns:
        The folder, which ``ShapeFolder`` reads.

    Raises:
        ArgumentError: if an argument is out of range, or the folder holds something else or cannot be written to.
        MissingExtraError: if the package musculoskeletal-models is not installed.
        DataError: if it is of another version.

    Examples:
        >>> synthesize_bones("hips", 100, BodySettings(seed=1), bone="hip", processes=4)  # doctest: +SKIP
    """
    check_choice("bone", bone, get_args(Bone))
    check_choice("turn", turn, get_args(Turn))
    kind = partial(_kept, Bones, "", bone, turn)
    return _synthesize(kind, output, n, settings, processes=processes, progress=progress)


def synthesize_organs(
    file: str | Path,
    output: str | Path,
    n: int,
    settings: BodySettings | None = None,
    *,
    strength: float = 1.0,
    turn: Turn = "any",
    processes: Processes = 1,
    progress: Progress = ignore,
) -> BodyFolder:
    """Write a dataset of variants of one shape of one's own, as ``synthesize_people`` writes people.

    Each variant is a smooth warp of the shape, which stretches it unevenly and folds nothing, with a mesh of its own.

    Args:
        file: a mesh that is one closed surface; it may have holes through it.
        output: the folder; it may hold variants of the same file made with the same settings, which are kept.
        n: number of variants.
        settings: seed and meshing.
        strength: how much variants differ from the shape, from 0 to 2.
        turn: how variants are turned: ``"none"``, about the ``"vertical"``, or ``"any"`` way round.
        processes: number of worker processes; the variants do not depend on it.
        progress: called with the number of finished variants, their total and the current one's name.

    Returns:
        The folder, which ``ShapeFolder`` reads.

    Raises:
        ArgumentError: if an argument is out of range, the file cannot be opened, or the folder holds something else or
            cannot be written to.
        ShapeError: if it does not hold one closed surface.

    Examples:
        >>> synthesize_organs("liver.ply", "livers", 100, BodySettings(seed=1))  # doctest: +SKIP
    """
    if not is_real(strength) or not 0.0 <= strength <= 2.0:
        raise bad_value("strength", strength, "a number from 0 to 2")
    check_choice("turn", turn, get_args(Turn))
    kind = partial(_kept, Organs, sha256(expanded(file)), expanded(file), strength=float(strength), turn=turn)
    return _synthesize(kind, output, n, settings, processes=processes, progress=progress)


def _synthesize(
    kind_of_process: Callable[[], Kind],
    output: str | Path,
    n: int,
    settings: BodySettings | None,
    *,
    processes: Processes,
    progress: Progress,
) -> BodyFolder:
    check_count("n", n)
    check_processes(processes)
    settings = settings or BodySettings()
    kind = kind_of_process()
    template = kind.template
    folder = BodyFolder.prepare(output, kind, settings)
    names = [folder.name(index) for index in range(n)]
    progress(0, n, "checking the existing files")
    missing = [index for index, name in enumerate(names) if not folder.has_all_files(name)]
    if missing or not folder.has_template():
        points = sample_evenly(template.rest, TEMPLATE_POINTS, without=template.lid)
        folder.write_template(template.rest, points)
    if missing:
        make = _Making(kind_of_process, points, settings, folder)
        tasks = [(names[index], partial(make, index)) for index in missing]
        there = n - len(missing)
        run_tasks(
            [tasks],
            processes=processes,
            progress=lambda done, _, what: progress(there + done, n, what),
            writes=folder.root,
        )
    while folder.has_all_files(folder.name(len(names))):  # of a larger dataset that was made before
        names.append(folder.name(len(names)))
    folder.write_manifest(kind, settings, names)
    return folder


@dataclass(frozen=True)
class _Making:
    """Makes and writes the body with a given number; picklable, for worker processes."""

    kind_of_process: Callable[[], Kind]
    points: BarycentricPoints
    settings: BodySettings
    folder: BodyFolder

    def __call__(self, index: int) -> None:
        body = make_body(self.kind_of_process(), self.points, self.settings, index)
        self.folder.write_body(self.folder.name(index), body)


def _of_model(kind: Callable[..., Kind], *how: str, details: bool = False) -> Kind:
    """Bodies of a kind, made of the body model of this process."""
    return kind(_body_model(details=details), *how)


@cache
def _body_model(*, details: bool) -> BodyModel:
    """The body model of this process; loading it takes seconds."""
    return BodyModel(details=details)


@cache
def _kept(kind: Callable[..., Kind], version: str, *how: Any, **more: Any) -> Kind:
    """A kind of bodies that is made once in a process, as long as what it is made from has this version."""
    return kind(*how, **more)
