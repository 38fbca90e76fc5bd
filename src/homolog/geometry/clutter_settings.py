"""Where the bounds lie between a shape and what does not belong to it."""

from __future__ import annotations

from dataclasses import dataclass

from homolog.core.settings import Positive, Settings, Share


@dataclass(frozen=True, kw_only=True)
class ClutterSettings(Settings):
    """What is set apart as outliers, background planes and other objects. Chosen on training shapes of FAUST_r.

    Lengths of outliers are in widths: the distance from a point to its near neighbours, some 1.6 spacings. Two bounds
    are given for a clean surface and a noisy one; between these they follow the noise. Clean surfaces hold points
    beyond the bounds, though fewer than ``least_share``: those count only where more points are beyond them.

    Args:
        slab: up to this distance from a plane, fitted robustly, points lie in it.
        slab_noisy: the same where the surface has noise.
        support: the share of the neighbours in the plane of a point from which on it is sure to be on a surface.
        support_noisy: the same where the surface has noise.
        link: up to this distance such points hang together.
        step: up to this distance from them the surface goes on.
        near: up to this distance from its planes, besides their own thickness.
        near_noisy: the same where the surface has noise.
        doubtful: so much farther from its planes points may be on a clean surface.
        least_share: share of the points that are farther still from which on all outliers count.
        least_share_noisy: the same where the surface has noise.
        many: share from which on doubtful points are outliers, too.
        sparse_noisy: of a noisy surface, distance to a near neighbour, in its median, up to which a point can be sure.
        clear: distance from the surface and from its planes beyond which an outlier counts however few there are.
        least_noise: distance of neighbours from robust planes up to which a surface is clean.
        most_noise: the same from which on the bounds are those for noise.
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

    slab: Positive = 0.25
    slab_noisy: Positive = 0.5
    support: Share = 0.75
    support_noisy: Share = 0.65
    link: Positive = 1.3
    step: Positive = 1.2
    near: Positive = 0.2
    near_noisy: Positive = 0.8
    doubtful: Positive = 0.15
    least_share: Share = 0.003
    least_share_noisy: Share = 0.02
    many: Share = 0.03
    sparse_noisy: Positive = 2.5
    clear: Positive = 2.5
    least_noise: Positive = 0.045
    most_noise: Positive = 0.09
    least_plane: Share = 0.15
    most_beside: Positive = 0.25
    most_behind: Share = 0.02
    floor_beyond: Positive = 1.5
    wall_beyond: Positive = 2.5
    gap: Positive = 0.1
    smaller_object: Share = 1 / 3
    most_apart: Share = 0.9
