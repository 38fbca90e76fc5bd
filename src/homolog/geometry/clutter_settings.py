"""Where the bounds lie between a shape and what does not belong to it."""

from __future__ import annotations

from dataclasses import dataclass

from homolog.core.settings import Positive, Settings, Share


@dataclass(frozen=True, kw_only=True)
class ClutterSettings(Settings):
    """What is set apart as outliers, background planes and other objects. Chosen on training shapes of FAUST_r.

    Lengths of outliers are in units of the distance from a point to its near neighbours, if not said otherwise. Clean
    surfaces, also with noise, hold no points beyond the first three bounds. They hold some beyond the others, though
    fewer than ``suspicious_share``: those count only where more points are beyond them.

    Args:
        clear_residual: distance from the plane through the neighbours beyond which a single point is an outlier.
        clear_sparsity: distance to a near neighbour, in its median over the cloud, beyond which one is that lies on no
            thin surface.
        ever_sparse: the same on any surface.
        suspicious_share: share of the points beyond these bounds or the next from which on all of them are outliers.
        residual: distance from the plane, beyond the neighbours' own, that is suspicious.
        residual_noisy: the same where the surface has noise.
        residual_once_sure: the same once there are more than the share.
        sparsity: distance to a near neighbour, in its median, that is suspicious.
        sparsity_noisy: the same where the surface has noise.
        sparsity_alone: the same whatever lies around.
        sparser_than_near: how many times as sparse as the densest of its neighbours a suspicious point is.
        thick: share of the variance around a point that lies across its plane: more is no thin surface.
        least_noise: the least distance from robust planes that means noise.
        link: up to this distance neighbours hang together.
        least_clustered: share of the points on none of the large pieces from which on clusters are looked for.
        least_plane: a background holds at least this share of the surface.
        most_beside: beside a plane, within as much again, are fewer points than this share of its own: a curved
            surface has as many there.
        most_behind: share of the object that may lie behind a background.
        floor_beyond: how many times as large as the object's shadow on it a floor is.
        wall_beyond: the same of planes in any other direction.
        gap: how far away from the shape another object lies, in units of sqrt(area).
        smaller_object: of which share of the shape's size it is at most.
        most_apart: where more than this share would be set apart, nothing is: what the object is cannot be told.

    Examples:
        >>> import homolog
        >>> from homolog.geometry import ClutterSettings
        >>> homolog.MatcherSettings(clutter=ClutterSettings(gap=0.2)).clutter.gap
        0.2
    """

    clear_residual: Positive = 4.0
    clear_sparsity: Positive = 4.0
    ever_sparse: Positive = 8.0
    suspicious_share: Share = 0.006
    residual: Positive = 0.3
    residual_noisy: Positive = 0.8
    residual_once_sure: Positive = 0.1
    sparsity: Positive = 2.0
    sparsity_noisy: Positive = 3.0
    sparsity_alone: Positive = 3.5
    sparser_than_near: Positive = 2.0
    thick: Share = 0.06
    least_noise: Positive = 0.05
    link: Positive = 1.3
    least_clustered: Share = 0.004
    least_plane: Share = 0.15
    most_beside: Positive = 0.25
    most_behind: Share = 0.02
    floor_beyond: Positive = 1.5
    wall_beyond: Positive = 2.5
    gap: Positive = 0.1
    smaller_object: Share = 1 / 3
    most_apart: Share = 0.9
