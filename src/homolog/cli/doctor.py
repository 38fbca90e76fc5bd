"""``homolog doctor``: what is installed, and where things are kept."""

from __future__ import annotations

import os
from typing import Annotated

import typer

import homolog
from homolog.core.caches import CacheFolder
from homolog.core.pretrained import pretrained_weights
from homolog.core.versions import version_of, versions

_EXTRAS = {
    "vtk": ("vtk",),
    "pcd": ("pypcd4",),
    "train": ("lightning-fabric", "tensorboard", "filelock"),
    "synth": ("anny", "musculoskeletal-models"),
    "transfer": ("pillow", "xatlas"),
    "volumes": ("SimpleITK", "scikit-image", "fast-simplification"),
    "picture": ("pillow",),
    "plot": ("matplotlib",),
    "geodesics": ("potpourri3d",),
    "serve": ("anyio", "filelock", "starlette", "uvicorn"),
    "collection": ("h5py", "matplotlib", "pillow"),
    "cluster": ("ray",),
    "docs": ("mkdocs-material", "mkdocstrings"),
}


def doctor(
    torch: Annotated[
        bool, typer.Option("--torch", help="Also start PyTorch, and print the devices and threads that it uses.")
    ] = False,
) -> None:
    """Print versions, extras, pretrained weights, and the operator cache's folder and size.

    Examples:
      homolog doctor

      homolog doctor --torch
    """
    for name, version in versions().items():
        _row(name, version)
    _row("processors", str(os.cpu_count()))
    if torch:
        _devices()
    for extra, packages in _EXTRAS.items():
        found = {package: version_of(package) for package in packages}
        missing = [package for package in packages if not found[package]]
        there = ", ".join(f"{package} {version}" for package, version in found.items())
        _row(f"extra '{extra}'", f"{', '.join(missing)} missing: pip install 'homolog[{extra}]'" if missing else there)
    _row("pretrained weights", ", ".join(pretrained_weights()) or "none")
    cache = CacheFolder.default()
    entries, size = cache.size()
    _row(
        "cache",
        f"{cache.folder} (HOMOLOG_CACHE): {entries} shapes, {size / 2**20:.0f} MB of at most "
        f"{cache.max_bytes / 2**20:.0f} (HOMOLOG_CACHE_GB)",
    )
    _row("working memory", f"{homolog.get_working_memory():.0f} MB")


def _row(name: str, value: str) -> None:
    typer.echo(f"{name:<18} {value}")


def _devices() -> None:
    import torch

    names = [torch.cuda.get_device_name(number) for number in range(torch.cuda.device_count())]
    _row("threads used", str(torch.get_num_threads()))
    _row("CUDA devices", ", ".join(names) or "none")
