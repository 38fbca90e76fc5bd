"""An orienter that is lent to new weights: that of weights which know the training shapes already. New here.

An orienter that saw the few dozens of shapes of a training confuses front and back of new ones; one that saw thousands
of the same kind does not. What it knows is where such shapes stand in its own training. How that is turned against the
shapes of this one is the mean of the rotations that it finds of them.
"""

from __future__ import annotations

import logging
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from scipy.spatial.transform import Rotation

from homolog.core.errors import ArgumentError
from homolog.core.pretrained import KINDS, OF_PARTS
from homolog.core.progress import Progress, ignore
from homolog.features import NetworkFeatures, Orienter, load_weights
from homolog.geometry import Operators
from homolog.maps import rotation_angle
from homolog.pairs import ChoiceSettings
from homolog.training.settings import AUTO_LENDER, NO_LENDER, Recipe
from homolog.training.store import ShapeStore

_log = logging.getLogger(__name__)

# Shapes that are looked at, at most; all but a tenth of them must be known, and found to stand as the others do.
_MOST_SHAPES, _SHARE, _ALIKE = 40, 0.9, 60.0


@dataclass(frozen=True, eq=False)
class LentOrienter:
    """An orienter of other weights, turned to where the shapes of a training stand.

    Args:
        orienter: to be stored with the new weights.
        lender: name of the weights that it is from.
        licence: of these.
        misfit: which nine of ten of the training shapes have at most; see ``homolog.features.Orientation``.
        alike: share of them that it finds to stand within 60 degrees of their mean.
        turned: the angle between how its own training shapes stood and these do, in degrees.
    """

    orienter: Orienter
    lender: str
    licence: str
    misfit: float
    alike: float
    turned: float

    def described(self) -> dict[str, float | str]:
        """What a report says of it."""
        return {
            "lender": self.lender,
            "licence": self.licence,
            "misfit": self.misfit,
            "alike": self.alike,
            "turned_degrees": self.turned,
        }


def lender_of(recipe: Recipe) -> NetworkFeatures | None:
    """The weights that a recipe names to lend their orienter, if it names any.

    Raises:
        ArgumentError: if they have no orienter.
        WeightsError: if there are no such weights.
    """
    if recipe.orienter.lender in (AUTO_LENDER, NO_LENDER):
        return None
    found = load_weights(recipe.orienter.lender)
    if found.orienter is None:
        raise ArgumentError(
            f"[orienter] lender is {recipe.orienter.lender!r}, which has no orienter; "
            f"give other weights, {AUTO_LENDER!r}, or {NO_LENDER!r} to train one"
        )
    return found


@torch.no_grad()
def lent_orienter(store: ShapeStore, names: Sequence[str], *, progress: Progress = ignore) -> LentOrienter | None:
    """The orienter of the weights that the recipe names, or of the pretrained ones that know the training shapes.

    Pretrained weights know them as ``homolog.matching.choose`` judges it: where nine of ten misfits of their orienter
    are below the limit, and as many shapes are found to stand as the others do. Of partial shapes, the full ones
    tell, and only weights that know parts lend.

    Args:
        store: gives the shapes, of which some 40 are looked at.
        names: of the shapes to train on.
        progress: told of each shape.

    Returns:
        The orienter; None where the recipe wants none lent, or no pretrained weights know the shapes.

    Raises:
        ArgumentError: if the weights that the recipe names have no orienter.
        WeightsError: if there are no such weights.
    """
    if store.recipe.orienter.lender == NO_LENDER:
        return None
    named = lender_of(store.recipe)
    looked_at = _some_full(store, names)
    shapes = list[Operators]()
    for done, name in enumerate(looked_at, 1):
        shapes.append(store.mesh_operators(name))
        progress(done, len(looked_at), "looking for an orienter that knows the shapes")
    if named is not None:
        return _lent(named, shapes)
    best = _best_of(OF_PARTS if store.recipe.partial is not None else KINDS, shapes)
    if best is not None and best.alike < _SHARE:
        _log.warning(
            "The weights %r know the shapes, but find %d %% of them to stand otherwise than the others do, and lend no "
            "orienter; look at the shapes, or set [data] align = true.",
            *(best.lender, round(100 * (1 - best.alike))),
        )
        return None
    return best


def _best_of(names: Iterable[str], shapes: Sequence[Operators]) -> LentOrienter | None:
    """The orienter of those weights that know the shapes best, if any do; the first that know them well are taken."""
    settings, known = ChoiceSettings(), list[LentOrienter]()
    for lender in map(load_weights, names):
        lent = _lent(lender, shapes)
        if lent.misfit <= lender.info.limit(settings.known_best):
            known.append(lent)
            if lent.misfit <= settings.known:
                break
    return min(known, key=lambda lent: lent.misfit, default=None)


def _some_full(store: ShapeStore, names: Sequence[str]) -> list[str]:
    """Some of the shapes, of a training on partial ones those with the larger areas of the pairs."""
    full = sorted({max(pair, key=lambda name: store.frame(name).scale) for pair in store.shapes.pairs})
    known = full if store.recipe.partial is not None and full else list(names)
    return known[:: -(-len(known) // _MOST_SHAPES)]


def _lent(lender: NetworkFeatures, shapes: Sequence[Operators]) -> LentOrienter:
    """The orienter of some weights as it sees shapes."""
    assert lender.orienter is not None
    orienter = lender.orienter.to(shapes[0].points.device)
    best = [orienter(operators)[0] for operators in shapes]
    rotations = torch.stack([orientation.rotation for orientation in best])
    mean = torch.from_numpy(Rotation.from_matrix(rotations.cpu().numpy()).mean().as_matrix()).to(rotations)
    alike = rotation_angle(rotations @ mean.T) < _ALIKE
    return LentOrienter(
        orienter.turned(mean),
        lender.info.name,
        lender.info.licence,
        float(np.quantile([orientation.misfit for orientation in best], _SHARE)),
        float(alike.float().mean()),
        float(rotation_angle(mean)),
    )
