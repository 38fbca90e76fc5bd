"""How the points of a cloud are spread over its surface: in lines or everywhere, and the area that each stands for."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from scipy.spatial import KDTree

# The nearest points that tell a line from a surface. Their variances across are less than this share of those along:
# contours of slices have 0.03 at most, scattered points 0.27 or more.
_FEW, _MOST_ACROSS = 4, 0.1
# The nearest points that reach other lines as well.
_MANY = 40


def lies_in_lines(points: Float[np.ndarray, "n 3"]) -> bool:
    """Whether most points of a cloud lie in lines with empty space between them, as the contours of slices do.

    By the variances (principal components) of each point and its nearest ones. New here.

    Args:
        points: positions (n, 3).

    Examples:
        >>> import numpy as np
        >>> from homolog.geometry import lies_in_lines
        >>> circle = np.exp(1j * np.linspace(0, 2 * np.pi, 100, endpoint=False))
        >>> rings = [[z.real, z.imag, height] for z in circle for height in range(10)]
        >>> lies_in_lines(np.array(rings)), lies_in_lines(np.random.default_rng(0).random((1000, 3)))
        (True, False)
    """
    if len(points) <= _FEW:
        return False
    around = points[KDTree(points).query(points, k=_FEW + 1, workers=-1)[1]]
    sizes = np.linalg.svd(around - around.mean(axis=1, keepdims=True), compute_uv=False)
    return bool((sizes[:, 1] ** 2 < _MOST_ACROSS * sizes[:, 0] ** 2).mean() > 0.5)


def areas_by_density(points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"]:
    """The area that each point of a cloud stands for, up to a common factor: the square of how far many points reach.

    It does not depend on how points lie beside their nearest ones, which of contours are all in one line. Where points
    are spread over the surface, ``Operators.mass`` is more exact.

    Args:
        points: positions (n, 3).

    Examples:
        >>> import numpy as np
        >>> from homolog.geometry import areas_by_density
        >>> sheet = np.c_[np.random.default_rng(0).random((4000, 2)), np.zeros(4000)]
        >>> sheet[:, 0] **= 2  # dense on the left
        >>> areas = areas_by_density(sheet)
        >>> float(areas[sheet[:, 0] > 0.5].sum() / areas.sum()).__round__(1)
        0.5
    """
    reach: np.ndarray = KDTree(points).query(points, k=[min(_MANY + 1, len(points))], workers=-1)[0][:, 0]
    areas: np.ndarray = np.square(reach)
    return areas
