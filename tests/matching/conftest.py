"""Two blobs in correspondence, sampled apart, and a small network that tells their points apart without training."""

from collections.abc import Callable
from dataclasses import dataclass

import fast_simplification
import numpy as np
import pytest
import torch
from scipy.spatial import ConvexHull, KDTree

from homolog.features import DiffusionNet, FeatureInfo, NetworkSettings, save_weights
from homolog.geometry import OperatorCache, compute_operators
from homolog.matching import Matcher
from homolog.pairs import MatcherSettings
from homolog.shapes import Shape, repair

# Both stand alike. Features without an axis up and without an orienter leave it to the search to find that.
INFO = FeatureInfo(name="blobs", licence="none", upright=False, map_eigenpairs=40)


def _sphere(n: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Evenly spread points on the unit sphere, shaken a little, and outward faces."""
    steps = np.arange(n) + 0.5
    height, turn = 1 - 2 * steps / n, np.pi * (1 + 5**0.5) * steps
    ring = np.sqrt(1 - height**2)
    points = np.stack([np.cos(turn) * ring, height, np.sin(turn) * ring], axis=1)
    points += 0.15 * np.random.default_rng(seed).standard_normal(points.shape) / np.sqrt(n)
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    faces = ConvexHull(points).simplices
    a, b, c = (points[faces[:, corner]] for corner in range(3))
    inward = np.einsum("ij,ij->i", np.cross(b - a, c - a), a + b + c) < 0
    faces[inward] = faces[inward][:, ::-1]
    return points, faces


def _blob(sphere: np.ndarray, bend: float) -> np.ndarray:
    """A smooth surface without symmetry, a function of the sphere's points; bent along its length."""
    x, y, z = sphere.T
    radius = 1 + 0.25 * x * y + 0.2 * np.sin(2 * z + 0.4) + 0.15 * np.cos(3 * x + y + 0.7) + 0.1 * np.sin(2 * x - z)
    points = sphere * radius[:, None] * np.array([1.0, 1.8, 0.8])
    points[:, 0] += bend * points[:, 1] ** 2
    return points


@dataclass(frozen=True)
class Blobs:
    """Two meshes of 480 and 560 points, and for each point of one the nearest true counterpart on the other."""

    source: Shape
    target: Shape
    source_to_target: np.ndarray
    target_to_source: np.ndarray

    def of(self, modality: str) -> tuple[Shape, Shape]:
        """The two as meshes (m) or clouds (c): "mm", "cc", "mc" or "cm"."""
        return as_modality(self.source, modality[0]), as_modality(self.target, modality[1])


def as_modality(shape: Shape, letter: str) -> Shape:
    return shape if letter == "m" else shape.as_cloud()


@pytest.fixture(scope="session")
def blobs() -> Blobs:
    points, faces = _sphere(480, seed=1)
    others, other_faces = _sphere(560, seed=2)
    turn = np.linalg.qr(np.random.default_rng(5).standard_normal((3, 3)))[0]
    others = others @ (turn * np.sign(np.linalg.det(turn))).T
    return Blobs(
        Shape(_blob(points, 0.0), faces, name="source"),
        Shape(_blob(others, 0.12), other_faces, name="target"),
        KDTree(others).query(points)[1],
        KDTree(points).query(others)[1],
    )


@pytest.fixture(scope="session")
def network(blobs: Blobs) -> DiffusionNet:
    """Random weights, the last layer made such that features vary about zero, alike in all directions.

    The features of an untrained network all point nearly the same way; these tell neighbours apart.
    """
    torch.manual_seed(0)
    network = DiffusionNet(NetworkSettings(width=64, blocks=2, out_channels=64)).eval()
    with torch.no_grad():
        for block in network.blocks:
            block.times.copy_(torch.logspace(-3, -0.5, 64))
        operators = [compute_operators(shape) for shape in (blobs.source, blobs.target)]
        features = torch.cat([network(each.points, each) for each in operators])
        mean = features.mean(dim=0)
        _, strengths, directions = torch.linalg.svd(features - mean, full_matrices=False)
        levelled = directions.T / (strengths + 0.01 * strengths[0]) * len(features) ** 0.5 @ directions
        network.last.bias.copy_(levelled.T @ (network.last.bias - mean))
        network.last.weight.copy_(levelled.T @ network.last.weight)
    return network


@pytest.fixture(scope="session")
def weights(network: DiffusionNet, tmp_path_factory: pytest.TempPathFactory):
    """The network as a file."""
    path = tmp_path_factory.mktemp("weights") / "blobs.safetensors"
    save_weights(path, network, INFO)
    return path


Build = Callable[..., Matcher]


@pytest.fixture(scope="session")
def build(network: DiffusionNet, tmp_path_factory: pytest.TempPathFactory) -> Build:
    """Make a matcher for a method; operators are kept between tests unless others are given."""
    cache = OperatorCache(tmp_path_factory.mktemp("operators"))

    def build(method="auto", *, with_network=True, info=INFO, operators=cache.operators):
        given = (network, info) if with_network else ()
        return Matcher(*given, settings=MatcherSettings(method=method), device="cpu", operators=operators)

    return build


@pytest.fixture(scope="session")
def coarse_body(demo) -> Callable[[int], Shape]:
    """``coarse_body(n)`` is a demo body of about so many triangles, half as many points: bodies take long."""

    def build(n_faces: int) -> Shape:
        points, faces = demo.amber.points.astype(np.float32), demo.amber.faces.astype(np.int32)
        points, faces = fast_simplification.simplify(points, faces, target_count=n_faces)
        return repair(Shape(points, faces, name="body")).shape

    return build


@pytest.fixture(scope="session")
def samples_of_a_blob():
    """Points on the sphere, their faces, and where they lie on the blob, by their number: each its own sample."""

    def build(n: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        points, faces = _sphere(n, seed=n)
        return points, faces, _blob(points, 0.0)

    return build
