"""Which versions are at work, and on which machine, for reports."""

from __future__ import annotations

import os
import platform
import re
import shutil
import subprocess
from functools import cache
from importlib import metadata
from pathlib import Path

_PACKAGES = ("homolog", "torch", "numpy", "scipy", "robust-laplacian", "trimesh", "safetensors")


@cache
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


@cache
def commit() -> str | None:
    """The commit of the checkout that this code is run from, with ``-dirty`` if files differ; None if it is none."""
    root, git = Path(__file__).parents[3], shutil.which("git")
    if git is None or not (root / ".git").exists():
        return None
    command = [git, "-C", str(root), "describe", "--always", "--dirty", "--exclude=*", "--abbrev=10"]
    told = subprocess.run(command, capture_output=True, text=True, check=False)
    return told.stdout.strip() or None


@cache
def machine() -> str:
    """Processor and number of cores."""
    told = Path("/proc/cpuinfo")
    named = re.search(r"^model name\s*:\s*(.+)$", told.read_text(), re.MULTILINE) if told.is_file() else None
    name = named[1].strip() if named else platform.processor() or platform.machine()
    return f"{name}, {os.cpu_count()} cores"
