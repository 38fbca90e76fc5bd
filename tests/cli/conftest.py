"""Running the command line within the test process, files to run it on, and a network to run it with."""

import re
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
import torch

from homolog.cli.main import main
from homolog.features import DiffusionNet, FeatureInfo, NetworkSettings, save_weights
from homolog.shapes import Shape, write_shape


@dataclass(frozen=True)
class Ended:
    """How a command ended."""

    code: int
    out: str
    err: str

    def is_one_line_of_complaint(self):
        return (
            self.code == 2
            and self.out == ""
            and self.err.startswith("Error: ")
            and self.err.endswith("\n")
            and self.err.count("\n") == 1
            and "Traceback" not in self.err
        )


def plain(text):
    """Without colours."""
    return re.sub(r"\x1b\[[0-9;]*m", "", text)


@pytest.fixture
def homolog(monkeypatch, capfd):
    """Call ``homolog`` with arguments, as a shell would."""

    def run(*arguments):
        arguments = [str(argument) for argument in arguments]
        capfd.readouterr()
        with monkeypatch.context() as patch:
            patch.setattr(sys, "argv", ["homolog", *arguments])
            patch.setattr("homolog.cli.main.signal.signal", lambda *given: None)
            patch.setenv("COLUMNS", "200")
            with pytest.raises(SystemExit) as ended:
                main()
        code = ended.value.code
        shown = capfd.readouterr()
        return Ended(0 if code is None else code, plain(shown.out), plain(shown.err))

    return run


@dataclass(frozen=True)
class Files:
    """Files that every test may read and none may change."""

    mesh: Path
    other: Path
    cloud: Path
    dirty: Path
    rubbish: Path
    weights: Path
    upright: Shape
    order: np.ndarray


@pytest.fixture(scope="session")
def files(tmp_path_factory, make):
    """A blob of 162 points; a relabelled and stretched one, also as a cloud; one in need of repair."""
    root = tmp_path_factory.mktemp("inputs")
    blob = make.blob(2)
    order = np.random.default_rng(0).permutation(blob.n_points)
    other = make.relabelled(blob, order)
    other = Shape(other.points * [1, 1.1, 1], other.faces)
    write_shape(root / "mesh.off", blob)
    write_shape(root / "other.obj", other)
    write_shape(root / "cloud.xyz", other.as_cloud())
    points = np.concatenate([blob.points, blob.points[:2], [[9, 9, 9]]])
    write_shape(root / "dirty.ply", Shape(points, np.concatenate([blob.faces, blob.faces[:1]])))
    (root / "rubbish.ply").write_bytes(bytes(range(256)) * 20)
    torch.manual_seed(0)
    network = DiffusionNet(NetworkSettings(width=64, blocks=2, out_channels=64)).eval()
    info = FeatureInfo(name="untrained", licence="none", upright=False, map_eigenpairs=20)
    save_weights(root / "untrained.safetensors", network, info)
    return Files(
        mesh=root / "mesh.off",
        other=root / "other.obj",
        cloud=root / "cloud.xyz",
        dirty=root / "dirty.ply",
        rubbish=root / "rubbish.ply",
        weights=root / "untrained.safetensors",
        upright=blob,
        order=order,
    )
