"""Which versions are at work, for reports."""

from __future__ import annotations

import platform
from importlib import metadata

_PACKAGES = ("homolog", "torch", "numpy", "scipy", "robust-laplacian", "trimesh", "safetensors")


def version_of(package: str) -> str | None:
    """The installed version of a distribution, or None if it is not installed."""
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return None


def versions() -> dict[str, str]:
    """Versions of Python, of Homolog and of the packages that its results depend on."""
    found = {package: version_of(package) for package in _PACKAGES}
    known = {package: version for package, version in found.items() if version is not None}
    return {"python": platform.python_version(), "platform": platform.platform(), **known}
