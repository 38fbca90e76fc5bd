"""``homolog doctor``: what is installed, and where things are kept."""

from __future__ import annotations

import os

import torch
import typer

from homolog.core.memory import get_working_memory
from homolog.core.versions import version_of, versions
from homolog.features import pretrained_weights
from homolog.geometry import OperatorCache

_EXTRAS = {
    "vtk": ("vtk",),
    "pcd": ("pypcd4",),
    "train": ("lightning-fabric", "tensorboard", "filelock"),
    "synth": ("anny",),
    "transfer": ("pillow", "xatlas"),
    "volumes": ("SimpleITK", "scikit-image", "fast-simplification"),
    "picture": ("pillow",),
    "serve": ("anyio", "filelock", "starlette", "uvicorn"),
    "collection": ("h5py", "matplotlib", "pillow"),
    "docs": ("mkdocs-material", "mkdocstrings"),
}


def doctor() -> None:
    """Print versions, devices, optional parts, and the cache's place and size.

    Example:
      homolog doctor
    """
    for name, version in versions().items():
        _row(name, version)
    _row("processors", f"{os.cpu_count()}, {torch.get_num_threads()} threads used")
    _row("CUDA devices", ", ".join(_cuda_devices()) or "none")
    for extra, packages in _EXTRAS.items():
        found = {package: version_of(package) for package in packages}
        missing = [package for package in packages if not found[package]]
        there = ", ".join(f"{package} {version}" for package, version in found.items())
        _row(f"extra '{extra}'", f"{', '.join(missing)} missing: pip install 'homolog[{extra}]'" if missing else there)
    _row("shipped weights", ", ".join(pretrained_weights()) or "none")
    cache = OperatorCache.default()
    entries, size = cache.size()
    _row(
        "cache",
        f"{cache.folder} (HOMOLOG_CACHE): {entries} shapes, {size / 2**20:.0f} MB of at most "
        f"{cache.max_bytes / 2**20:.0f} (HOMOLOG_CACHE_GB)",
    )
    _row("working memory", f"{get_working_memory():.0f} MB")


def _row(name: str, value: str) -> None:
    typer.echo(f"{name:<18} {value}")


def _cuda_devices() -> list[str]:
    return [torch.cuda.get_device_name(number) for number in range(torch.cuda.device_count())]
