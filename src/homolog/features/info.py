"""What one must know of features to use them rightly."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

from homolog.core.settings import Count, Positive, Settings
from homolog.geometry import CLOUD_NEIGHBOURS, LaplacianKind

NetworkInput = Literal["xyz", "xyz+wks", "wks", "hks", "operators"]
"""What features are computed from: positions, wave or heat kernel signatures, both, or whatever a function takes."""


@dataclass(frozen=True, kw_only=True)
class FeatureInfo(Settings):
    """What a feature extractor expects of shapes, and how its features are to be compared.

    Weight files carry it in their header. It is explicit: nothing of it is derived from how a network was trained.

    Args:
        name: a short name, or the file's.
        licence: the terms of the weights.
        input: what features are computed from: ``"xyz"`` for positions, so that features follow the pose;
            ``"xyz+wks"`` for positions and wave kernel signatures; ``"wks"`` or ``"hks"`` for wave or heat kernel
            signatures alone, and ``"operators"`` for a function of one's own, which do not.
        upright: whether shapes must stand as those trained on did: +y up, facing +z.
        n_eigenpairs: eigenpairs of the operators that features are computed from.
        laplacian: the Laplacian of meshes that they were trained with.
        n_neighbours: points that each point of a cloud is connected to in its operators.
        map_eigenpairs: size of the functional map that fits the features.
        partial: whether a network was trained on partial shapes with their full ones.
        near_isometric: whether surfaces are taken to bend without stretching much: maps between meshes are then
            functional maps, and all maps are refined as such. Where not, features alone say what goes where.
        temperature: of the soft map between features that were brought to unit norm.
        most_misfit: misfit of the orienter up to which it may know a shape, see ``homolog.pairs.ChoiceSettings``. Heads
            have 0.05 by the weights for heads, and anything like an egg 0.11.
        lender: name of the weights whose orienter these hold; empty where theirs was trained with them, or is none.
        sha256: hash of the file; empty before it is saved.

    Raises:
        ArgumentError: if one of them is of another kind or size.

    Examples:
        >>> from homolog.features import FeatureInfo
        >>> FeatureInfo(name="mine", upright=False).near_isometric
        True
    """

    name: str = "untitled"
    licence: str = "unknown"
    input: NetworkInput = "xyz"
    upright: bool = True
    n_eigenpairs: Count = 128
    laplacian: LaplacianKind = "robust"
    n_neighbours: Count = CLOUD_NEIGHBOURS
    map_eigenpairs: Count = 80
    partial: bool = False
    near_isometric: bool = True
    temperature: Positive = 0.1
    most_misfit: Positive = 1.0
    lender: str = ""
    sha256: str = field(default="", compare=False)

    @property
    def follows_pose(self) -> bool:
        """Whether features change when a shape is turned."""
        return self.input in ("xyz", "xyz+wks")

    def limit(self, usual: float) -> float:
        """Misfit of the orienter up to which these features know a shape: the usual limit, or their own if less.

        Examples:
            >>> from homolog.features import FeatureInfo
            >>> FeatureInfo(name="mine", most_misfit=0.08).limit(0.1)
            0.08
        """
        return min(usual, self.most_misfit)
