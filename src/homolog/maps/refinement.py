"""Spectral refinement of maps."""

from __future__ import annotations

import torch
from jaxtyping import Float, Int
from torch import Tensor

from homolog.arguments import check_count
from homolog.arrays import takes_arrays
from homolog.maps.functional_map import check_fits, functional_map_from_point_map, point_map_from_functional_map

# Points of each shape that take part in the refinement; more change the map little and cost in proportion.
_SAMPLES = 2000


@takes_arrays
def zoom_out(
    c_xy: Float[Tensor, "k_y k_x"],
    eigenvectors_x: Float[Tensor, "n_x m_x"],
    eigenvectors_y: Float[Tensor, "n_y m_y"],
    *,
    step: int = 20,
    largest: int | None = None,
) -> Float[Tensor, "m m"]:
    """Refine a functional map by alternating with its point map, in a growing basis.

    Melzi, Ren, Rodola, Sharma, Wonka and Ovsjanikov, "ZoomOut: spectral upsampling for efficient shape
    correspondence", SIGGRAPH Asia 2019.

    Args:
        c_xy: the map to start from; its size is where the growth begins.
        eigenvectors_x: at least as many eigenvectors as the size to reach.
        eigenvectors_y: likewise.
        step: eigenvectors added per round.
        largest: size to reach; by default all eigenvectors that both shapes have.

    Raises:
        ArgumentError: if there are fewer eigenvectors than ``c_xy`` is for, it is not finite, or ``step`` or
            ``largest`` is no whole number of at least 1.
    """
    check_count("step", step)
    if largest is not None:
        check_count("largest", largest)
    check_fits(c_xy, eigenvectors_x, eigenvectors_y)
    largest = min(largest or eigenvectors_x.shape[1], eigenvectors_x.shape[1], eigenvectors_y.shape[1])
    x, y = eigenvectors_x[_samples(eigenvectors_x)], eigenvectors_y[_samples(eigenvectors_y)]
    for size in range(c_xy.shape[0] + step, largest + step, step):
        if size > largest - 2 * step:
            # In the last two rounds: only among all points does a sample find its very counterpart.
            size, x = min(size, largest), eigenvectors_x
        y_to_x = point_map_from_functional_map(c_xy, x, y)
        c_xy = _fitted(x[y_to_x, :size], y[:, :size])
    return c_xy


@takes_arrays
def refined_point_map(
    y_to_x: Int[Tensor, " n_y"],
    eigenvectors_x: Float[Tensor, "n_x m_x"],
    eigenvectors_y: Float[Tensor, "n_y m_y"],
    mass_y: Float[Tensor, " n_y"],
    *,
    smallest: int = 20,
    largest: int = 100,
    step: int = 20,
) -> Int[Tensor, " n_y"]:
    """Smooth a point map between complete shapes: its coarse functional map, refined by ``zoom_out``, as a point map.

    Matches of single points scatter; what neighbours agree on survives in the lowest eigenfunctions.
    """
    coarse_x, coarse_y = eigenvectors_x[:, :smallest], eigenvectors_y[:, :smallest]
    c_xy = functional_map_from_point_map(y_to_x, coarse_x, coarse_y, mass_y)
    c_xy = zoom_out(c_xy, eigenvectors_x, eigenvectors_y, step=step, largest=largest)
    return point_map_from_functional_map(c_xy, eigenvectors_x, eigenvectors_y)


def _fitted(pulled_back: Float[Tensor, "n k"], eigenvectors_y: Float[Tensor, "n k"]) -> Float[Tensor, "k k"]:
    """The least-squares C with Phi_y C = Pi Phi_x on the samples; sampled eigenvectors stay nearly orthogonal."""
    gram, right = (eigenvectors_y.T @ eigenvectors_y).double(), (eigenvectors_y.T @ pulled_back).double()
    # An eigenvector that is zero on all samples must not make the system singular.
    ridge = 1e-6 * gram.diagonal().mean() * torch.eye(len(gram), dtype=gram.dtype, device=gram.device)
    solution: Tensor = torch.linalg.solve(gram + ridge, right).to(pulled_back.dtype)
    return solution


def _samples(eigenvectors: Float[Tensor, "n m"]) -> Int[Tensor, " s"]:
    n = len(eigenvectors)
    shuffled = torch.randperm(n, generator=torch.Generator().manual_seed(0))
    return shuffled[:_SAMPLES].sort().values.to(eigenvectors.device)
