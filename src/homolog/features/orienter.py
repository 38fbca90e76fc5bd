"""Which way round a shape is, told by a network from the shape alone. New here.

The network gets the positions of a shape in any pose of the whole, and says where each point would lie if the shape
stood as those did that it was trained on. The rotation that takes one to the other is the answer; turned by it, the
network is asked again. From several starts it may end in several answers, such as facing forward and backward: the one
that the network's own answer contradicts least is the best. Wang et al. regress positions in a normalised space for
objects ("Normalized object coordinate space", CVPR 2019), Scarvelis et al. orient shapes by several candidates
("Orient Anything", 2024).
"""

from __future__ import annotations

import copy
from collections.abc import Iterable
from dataclasses import dataclass, replace

import torch
from jaxtyping import Float
from torch import Tensor

from homolog.features.diffusion_net import DiffusionNet, NetworkSettings
from homolog.geometry import Basis, Operators, some_points
from homolog.maps import Similarity, best_rotation, best_similarity, cube_rotations, distinct_rotations

ORIENTER_NETWORK = NetworkSettings(in_channels=3, out_channels=3, width=64, blocks=4, dropout=0.1)
"""The architecture of an orienter: small, as it tells one thing about a shape."""
ORIENTER_EIGENPAIRS = 64
"""Eigenpairs that it is computed with."""
ORIENTER_SAMPLES = 400
"""Points of a shape that it is trained at, and looks for possible answers at."""
ORIENTER_RADIUS = 0.5
"""Root-mean-square distance of a shape's points from their centre, in the network's units. That of a person is some 0.5
sqrt(area), but noise changes the area that is estimated of a cloud, and a part has less of it than the full shape."""
# After so many steps from a start the answer hardly changes.
_STEPS = 3
# Points that it decides at. With fewer, it depends on which ones they are where a cloud is noisy: of 39 trials with
# noise of 0.01 sqrt(area), 33 faced the right way with 400 points, and 36 with 1,500; more change nothing.
_LAST_SAMPLES = 1500


@dataclass(frozen=True, eq=False)
class Orientation:
    """A rotation that may stand a shape as it is expected to.

    Args:
        rotation: takes the positions p of the shape to ``p @ rotation.T`` (3, 3).
        misfit: how much speaks against it, of an orienter the mean distance between the turned points and where the
            network puts them, where the shape has the radius ``ORIENTER_RADIUS``.
        upright: takes the positions of the shape to where the orienter puts them on an upright full shape of that
            radius; of a partial shape it tells size and place, too. None of what no orienter found.
    """

    rotation: Float[Tensor, "3 3"]
    misfit: float
    upright: Similarity | None = None


@dataclass(frozen=True, eq=False)
class Orienter:
    """A network that tells the orientations of a shape.

    Args:
        network: takes positions in any pose to those of the same points on the upright shape.

    Examples:
        >>> import homolog
        >>> orienter = homolog.load_weights("people").orienter
        >>> source, _ = homolog.demo_shapes()
        >>> from homolog.maps import rotation_angle
        >>> best = orienter(homolog.compute_operators(source))[0]
        >>> float(rotation_angle(best.rotation)) < 30  # it stands upright already
        True
    """

    network: DiffusionNet

    @torch.no_grad()
    def __call__(self, operators: Operators) -> tuple[Orientation, ...]:
        """Orientations that may be right, farther than 30 degrees from each other, the best first."""
        basis = operators.basis.truncated(ORIENTER_EIGENPAIRS)
        counts = ORIENTER_SAMPLES, _LAST_SAMPLES
        coarse, sampled = (basis.sampled(some_points(basis.n_points, n).to(basis.points.device)) for n in counts)
        few, seen = as_oriented(coarse), as_oriented(sampled)
        found = self._distinct(self._step(few, cube_rotations().to(few.points)))
        for _ in range(_STEPS - 1):
            found = self._step(seen, torch.stack([orientation.rotation for orientation in found]))
        distinct = self._distinct(found)
        rotations = torch.stack([orientation.rotation for orientation in distinct])
        answers = self._answers(seen, seen.points @ rotations.mT)
        return tuple(
            replace(orientation, upright=best_similarity(sampled.points, answer, seen.mass))
            for orientation, answer in zip(distinct, answers, strict=True)
        )

    def _step(self, basis: Basis, rotations: Float[Tensor, "s 3 3"]) -> list[Orientation]:
        """The rotations that the network answers to poses, and by how much its points differ there from the answers."""
        points = basis.points @ rotations.mT
        answers = torch.stack(self._answers(basis, points))
        further = best_rotation(points, answers, basis.mass.expand(len(rotations), -1))
        distances = (points @ further.mT - answers).norm(dim=2)
        misfits = (distances @ basis.mass / basis.mass.sum()).tolist()
        return [Orientation(rotation, misfit) for rotation, misfit in zip(further @ rotations, misfits, strict=True)]

    def _answers(self, basis: Basis, points: Float[Tensor, "s n 3"]) -> list[Float[Tensor, "n 3"]]:
        """Where the network puts the points of a shape in several poses."""
        return self.network.several(list(points), [basis] * len(points))

    @staticmethod
    def _distinct(orientations: Iterable[Orientation]) -> list[Orientation]:
        ranked = sorted(orientations, key=lambda orientation: orientation.misfit)
        return [ranked[number] for number in distinct_rotations(found.rotation for found in ranked)]

    @torch.no_grad()
    def turned(self, rotation: Float[Tensor, "3 3"]) -> Orienter:
        """An orienter that stands shapes otherwise: so that ``points @ rotation.T`` stand as by this one.

        Its network is the same but for its first and its last layer, which turn what goes in and what comes out.

        Args:
            rotation: takes positions as the new orienter stands shapes to those by this one (3, 3).

        Examples:
            >>> import homolog
            >>> from homolog.maps import cube_rotations, rotation_angle
            >>> orienter, turn = homolog.load_weights("people").orienter, cube_rotations()[5]
            >>> operators = homolog.compute_operators(homolog.demo_shapes()[0])
            >>> one, other = (each(operators)[0].rotation for each in (orienter, orienter.turned(turn)))
            >>> float(rotation_angle(turn @ other @ one.T)) < 1
            True
        """
        network = copy.deepcopy(self.network)
        network.first.weight.copy_(network.first.weight @ rotation)
        network.last.weight.copy_(rotation.T @ network.last.weight)
        network.last.bias.copy_(rotation.T @ network.last.bias)
        return replace(self, network=network)

    def to(self, device: torch.device) -> Orienter:
        """The same on a device, in evaluation mode."""
        return replace(self, network=copy.deepcopy(self.network).to(device).eval())


def orienter_frame(basis: Basis) -> Similarity:
    """What takes the positions of a shape about its centre, to the radius ``ORIENTER_RADIUS``; it turns nothing."""
    shares = (basis.mass / basis.mass.sum())[:, None]
    centre = (shares * basis.points).sum(dim=0)
    scale = ORIENTER_RADIUS / float((shares * (basis.points - centre).square()).sum().sqrt())
    return Similarity(torch.eye(3).to(centre), scale, -scale * centre)


def as_oriented(basis: Basis) -> Basis:
    """The basis as an orienter gets it: about the shape's centre, of its radius, with tangent frames whose normals
    point away from the centre.

    Normals of clouds have either sign, and some meshes are inside out. The network's gradients know the sign, which
    must not depend on how a shape was sampled or stands.
    """
    frame = orienter_frame(basis)
    sized = basis.scaled(frame.scale).moved(frame.shift)
    along = torch.einsum("njk,kc->njc", sized.gradients, sized.coefficients(sized.points))
    normals = torch.linalg.cross(along[:, 0], along[:, 1])
    inward = (normals * sized.points).sum(dim=1) < 0
    gradients = sized.gradients.clone()
    gradients[inward, 1] *= -1
    return replace(sized, gradients=gradients)
