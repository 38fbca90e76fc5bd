"""Options that several commands share. What they may be is known without loading PyTorch."""

from __future__ import annotations

import json
import logging
import os
import stat
from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typing_extensions import TypedDict  # before Python 3.12 pydantic takes no other

import homolog
from homolog.cli.lazy import OTHER
from homolog.core.choices import PICTURE_WIDTHS, Device, KeepClutter, Orient, Up, UseProxy
from homolog.core.errors import ArgumentError, bad_choice, bad_value
from homolog.core.files import expanded, refuse_overwriting_inputs, resolved, write_json
from homolog.core.pretrained import AUTO_WEIGHTS, weights_file
from homolog.core.records import read_record, record
from homolog.core.settings import read_toml, toml_value
from homolog.methods import AUTO, method_names

if TYPE_CHECKING:
    from homolog.core.cluster import Cluster
    from homolog.core.cluster import Processes as AnyProcesses
    from homolog.matching import Matcher


@record
class _Told(TypedDict):
    """A report, as far as its settings are read."""

    settings: dict[str, Any]


# The groups that options stand in.
INPUT, METHOD, PARTIAL, OUTPUT = "Input", "Method", "Partial shapes", "Output"

Weights = Annotated[
    str | None,
    typer.Option(
        "--weights",
        metavar="NAME|FILE",
        help="Trained weights: the name of pretrained ones, a .safetensors file, or a .pth that the paper's authors "
        "released. auto: those that know the two shapes, of people or parts of them, animals, hands or heads, or none.",
        show_default=AUTO_WEIGHTS,
        rich_help_panel=METHOD,
    ),
]


SettingsFile = Annotated[
    Path | None,
    typer.Option(
        "--settings",
        metavar="FILE",
        help="Make maps with these settings: a TOML file with fields of MatcherSettings, or the report.json of a "
        "result. Options that are given as well win.",
        show_default=False,
        rich_help_panel=METHOD,
    ),
]


def _checked_method(name: str) -> str:
    if name not in method_names():
        raise bad_choice("--method", name, method_names())
    return name


MethodOption = Annotated[
    str,
    typer.Option(
        "--method",
        metavar="METHOD",
        callback=_checked_method,
        autocompletion=lambda: list(method_names()),
        help="functional-map: functional maps, for two meshes. nearest-features: the most similar features, for clouds "
        "and for shapes that stretch. registration: fits the source to the target, for shapes in the same pose, such "
        "as organs; needs no weights. axiomatic: wave kernel signatures; needs no weights. auto: functional-map for "
        "two meshes, nearest-features otherwise; with --weights auto, registration or axiomatic where no weights know "
        "the shapes. Installed packages may offer others.",
        rich_help_panel=METHOD,
    ),
]
DeviceOption = Annotated[
    Device, typer.Option("--device", help="Where to compute; auto: on a GPU if there is one.", rich_help_panel=OTHER)
]
Adapt = Annotated[
    int,
    typer.Option(
        "--adapt",
        metavar="STEPS",
        help="Train a copy of the weights on each pair for so many steps, and match with it where the map then "
        "contradicts itself less; 0 for none.",
        min=0,
        rich_help_panel=METHOD,
    ),
]
OrientOption = Annotated[
    Orient,
    typer.Option(
        "--orient",
        help="auto: find which way round the shapes are. given: trust their coordinates.",
        rich_help_panel=INPUT,
    ),
]
ClutterOption = Annotated[
    KeepClutter,
    typer.Option(
        "--clutter",
        help="remove: set apart outliers, a floor or a wall, other objects, and what only one of two full shapes has; "
        "their points get no counterpart. keep: take them for parts of the shapes.",
        rich_help_panel=INPUT,
    ),
]
UseProxyOption = Annotated[
    UseProxy,
    typer.Option(
        "--proxy",
        help="auto: match one closed surface around a mesh in loose shells, in its place. never: match the meshes "
        "themselves. always: match such a surface around each.",
        rich_help_panel=INPUT,
    ),
]
PreAligned = Annotated[
    bool,
    typer.Option(
        "--pre-aligned",
        help="The partial shape lies in the full one's coordinates, about where it belongs, like a registered scan. "
        "Without it the partial shape is aligned to the full one first.",
        rich_help_panel=PARTIAL,
    ),
]
DatasetOption = Annotated[
    str | None,
    typer.Option(
        "--dataset",
        metavar="NAME|FILE",
        help="The dataset that DATA holds: a name from homolog data list, or a TOML file. Without it, DATA is a folder "
        "of your own.",
        show_default=False,
        rich_help_panel=INPUT,
    ),
]
Changes = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        metavar="SECTION.KEY=VALUE",
        help="Use this value instead of the recipe's, such as training.steps=2000; may be given several times.",
        show_default=False,
    ),
]
ResultFolder = Annotated[
    Path, typer.Argument(metavar="RESULT", help="A folder that homolog match wrote.", show_default=False)
]
ResultOutput = Annotated[
    Path, typer.Option("--output", "-o", metavar="DIR", help="Folder for the result.", rich_help_panel=OUTPUT)
]
ResumedOutput = Annotated[
    Path,
    typer.Option("--output", "-o", metavar="DIR", help="A new folder, or one to resume.", rich_help_panel=OUTPUT),
]
UpOfAll = Annotated[Up, typer.Option("--up", help="The axis that points up in all files.", rich_help_panel=INPUT)]
Json = Annotated[
    Path | None,
    typer.Option(
        "--json",
        metavar="FILE",
        help="Write all figures as JSON; - for standard output, in place of the table.",
        rich_help_panel=OUTPUT,
    ),
]
Seed = Annotated[
    int, typer.Option("--seed", metavar="N", help="Seed of all random choices.", min=0, rich_help_panel=OTHER)
]
Processes = Annotated[
    int | None,
    typer.Option(
        "--processes",
        metavar="N",
        help="How many processes work at once.",
        min=1,
        show_default="one per core",
        rich_help_panel=OTHER,
    ),
]
ClusterOption = Annotated[
    str | None,
    typer.Option(
        "--cluster",
        metavar="ray|ADDRESS",
        help="ray: work in a Ray of this machine, which begins and ends with the command. ADDRESS: in the Ray cluster "
        "there, such as HOST:6379 or auto, whose machines all see the same folders. Needs the extra cluster.",
        show_default="processes of this machine",
        rich_help_panel=OTHER,
    ),
]
Page = Annotated[
    Path | None,
    typer.Option(
        "--html",
        metavar="FILE.html",
        help="Write one page that shows both shapes; it opens from disk, without network.",
        rich_help_panel=OUTPUT,
    ),
]
Picture = Annotated[
    Path | None,
    typer.Option(
        "--picture",
        metavar="FILE.png",
        help="Write one image of both shapes; no screen needed.",
        rich_help_panel=OUTPUT,
    ),
]
PICTURE_WIDTH = 2000
Lines = Annotated[
    int,
    typer.Option(
        "--lines",
        metavar="N",
        help="Draw so many lines between corresponding points in the picture.",
        min=0,
        rich_help_panel=OUTPUT,
    ),
]
PictureWidth = Annotated[
    int,
    typer.Option(
        "--picture-width",
        metavar="PIXELS",
        help="Width of the picture, twice its height.",
        min=PICTURE_WIDTHS[0],
        max=PICTURE_WIDTHS[1],
        rich_help_panel=OUTPUT,
    ),
]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Print errors only.", rich_help_panel=OTHER)]
Verbose = Annotated[
    bool,
    typer.Option("--verbose", "-v", help="Also print each step, its time and its memory.", rich_help_panel=OTHER),
]
NoCache = Annotated[
    bool, typer.Option("--no-cache", help="Neither read nor write cached operators.", rich_help_panel=OTHER)
]


def workers(processes: int | None, cluster: str | None, *, usually: int | None = None) -> AnyProcesses:
    """Where the tasks of a command are done: what ``--processes`` and ``--cluster`` ask for, or one process per core.

    Args:
        processes: how many.
        cluster: of Ray.
        usually: how many processes of this machine, where another number than one per core.

    Raises:
        ArgumentError: if ``--cluster`` is empty.
        MissingExtraError: if it is given without the extra ``cluster``.
    """
    return cluster_of(cluster, processes) or processes or usually or os.cpu_count() or 1


def cluster_of(address: str | None, workers: int | None = None) -> Cluster | None:
    """The cluster that ``--cluster`` asks for; None without it. One of this machine has one worker per core."""
    if address is None:
        return None
    from homolog.core.cluster import LOCAL, Cluster

    return Cluster(address, (workers or os.cpu_count() or 1) if address == LOCAL else workers)


def device_of(device: Device, cluster: str | None) -> Device:
    """The device that tasks compute on: the workers of a cluster compute on processors alone."""
    if cluster is None:
        return device
    if device == "cuda":
        raise ArgumentError("--device is 'cuda', but the workers of a --cluster compute on processors; leave one out")
    return "cpu"


def changes_of(given: list[str] | None) -> dict[str, Any]:
    """What ``--set`` asks for, by name; a value is TOML, or else a text.

    Raises:
        ArgumentError: if one is no ``SECTION.KEY=VALUE``.
    """
    changes = {}
    for each in given or ():
        name, is_set, value = (part.strip() for part in each.partition("="))
        if not (name and is_set and value):
            raise bad_value("--set", each, "SECTION.KEY=VALUE, such as training.steps=2000")
        changes[name] = toml_value(value)
    return changes


def build_matcher(
    weights: str | None,
    method: str,
    device: Device,
    *,
    no_cache: bool,
    told: Mapping[str, Any] | None = None,
    stages: Mapping[str, bool | None] | None = None,
    file_told: bool = True,
) -> Matcher:
    """The matcher that the shared options ask for; some methods need no weights.

    ``told`` has the settings of ``--settings``, but for the method; see ``settings_and_method``.
    ``stages`` says which stages to leave out, or not, in whatever way the settings have them.
    ``file_told`` is whether reports say which file the weights came from: what a server shows, tells nothing of its
    folders.
    """
    from homolog.features import NetworkFeatures
    from homolog.geometry import OperatorCache, compute_operators
    from homolog.matching import Matcher, features_of_weights
    from homolog.pairs import MatcherSettings

    operators = compute_operators if no_cache else OperatorCache.default().operators
    settings = MatcherSettings.from_dict({**(told or {}), "method": method}, where="--settings")
    for stage, kept in (stages or {}).items():
        if kept is not None and kept != (getattr(settings, stage) is not None):
            changes: dict[str, Any] = {stage: getattr(MatcherSettings(), stage) if kept else None}
            settings = replace(settings, **changes)
    features: Any = features_of_weights(weights, settings)
    if not file_told and isinstance(features, NetworkFeatures):
        features = replace(features, file="")
    return Matcher(features, settings=settings, device=device, operators=operators)


def read_settings_file(file: Path | None) -> dict[str, Any] | None:
    """The settings in a TOML file, or in the report of a result or of an evaluation; None without one.

    Their names are checked as they are used: they are known where PyTorch is loaded.

    Raises:
        ArgumentError: if it cannot be read.
        DataError: if it is a report without settings.
    """
    if file is None:
        return None
    if file.suffix.lower() != ".json":
        return read_toml(file)
    settings: dict[str, Any] = read_record(file, _Told, instead="give the report.json of a result, or a TOML file")[
        "settings"
    ]
    return settings


def settings_and_method(context: typer.Context, file: Path | None, method: str) -> tuple[dict[str, Any] | None, str]:
    """What ``--settings`` tells, and its method, unless ``--method`` is given, be it with its usual value."""
    told, source = read_settings_file(file), context.get_parameter_source("method")
    given = source is not None and source.name == "COMMANDLINE"
    return told, method if told is None or given else told.get("method", AUTO)


def described(matcher: Matcher, *, warnings: str = "warnings") -> dict[str, Any]:
    """What maps were made with, for reports; ``warnings`` names the entry of those that hold for every pair."""
    return {warnings: list(matcher.warnings), **matcher.describe()}


def check_inputs(*shapes: Path, weights: str | None = None) -> None:
    """Refuse files that are not there, or that no shape is read from, before PyTorch is loaded."""
    if weights not in (None, AUTO_WEIGHTS):
        weights_file(weights)
    for file in shapes:
        homolog.shapes.files_of_shape(file)
        homolog.shapes.check_suffix(file)


def check_json(output: Path | None) -> None:
    """Refuse a JSON file that cannot be written, or would replace an input."""
    if output is not None and not on_stdout(output):
        check_file(output)


def on_stdout(output: Path | None) -> bool:
    """Whether ``--json -`` is given."""
    return output is not None and str(output) == "-"


def write_figures(output: Path | None, figures: Any) -> None:
    """Write what ``--json`` asks for."""
    if output is None:
        return
    if on_stdout(output):
        typer.echo(json.dumps(figures, indent=1, allow_nan=False))
    else:
        write_json(output, figures)


def set_verbosity(*, quiet: bool, verbose: bool) -> None:
    """Let the library's log through as the options ask."""
    level = logging.ERROR if quiet else logging.INFO if verbose else logging.WARNING
    logging.getLogger("homolog").setLevel(level)


def check_folder(output: Path, *, names: Iterable[str] = ()) -> None:
    """Refuse a result folder that cannot be made, or where a file of such a name would replace an input or is a folder.

    Before any work is done; nothing is made or changed.
    """
    folder = expanded(output)
    nearest = next(path for path in (folder, *folder.absolute().parents) if path.exists())
    if not nearest.is_dir():
        raise ArgumentError(f"{output} cannot be made a folder, {nearest} is a file; give another -o")
    if not os.access(nearest, os.W_OK):
        raise ArgumentError(f"{output} cannot be written to: {nearest} is read-only; give another -o")
    names = list(names)
    refuse_overwriting_inputs([folder / name for name in names])
    for name in names:
        if (folder / name).is_dir():
            raise ArgumentError(f"{folder / name} is a folder, where a result file belongs; give another -o")


def check_file(output: Path) -> None:
    """Refuse a result file that cannot be written, or would replace an input, before any work is done for it.

    Nothing is made or changed.
    """
    refuse_overwriting_inputs([output])
    if fault := _fault(resolved(output)):
        raise ArgumentError(f"{output} cannot be written: {fault}")


def check_files(*outputs: Path | None) -> None:
    """Refuse result files as ``check_file`` does; those that are not wanted are None."""
    for output in outputs:
        if output is not None:
            check_file(output)


def check_page_file(output: Path | None) -> None:
    """Refuse a page that cannot be written, before any work."""
    if output is not None:
        check_file(output)
        homolog.viewing.check_page(output)


def check_picture_file(output: Path | None, lines: int, width: int) -> None:
    """Refuse a picture that cannot be written, or what says how to draw one that is not wanted, before any work."""
    if output is not None:
        check_file(output)
        homolog.viewing.check_picture(output)
    elif lines or width != PICTURE_WIDTH:
        option = "--lines" if lines else "--picture-width"
        raise ArgumentError(f"{option} is about a picture, but none is to be written; add --picture FILE.png")


def _fault(file: Path) -> str:
    """Why a file cannot be written, if so."""
    if not file.parent.is_dir():
        return f"the folder {file.parent} does not exist; create it first"
    if not os.access(file.parent, os.W_OK | os.X_OK):
        return f"{file.parent} is read-only; give a file in another folder"
    try:
        return "" if stat.S_ISREG(file.stat().st_mode) else "it is no ordinary file; give a file name"
    except FileNotFoundError:
        return ""
    except OSError as error:
        return str(error.strerror)
