"""What an evaluation found: errors of all points of all pairs, and figures that sum them up."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from statistics import fmean
from typing import Any, get_args

import numpy as np
from jaxtyping import Bool, Float
from scipy.stats import spearmanr

from homolog.datasets import Pair
from homolog.evaluation.exchanges import Exchange
from homolog.evaluation.metrics import PCK_THRESHOLD, Detection, area_under_pck, least_confident_share, pck_curve
from homolog.matching import MEASURES, MapQuality

# Of fewer pairs, rank correlations mean little.
_PAIRS_TO_RANK = 10


@dataclass(frozen=True, eq=False)
class PairErrors:
    """Errors of one pair.

    Args:
        pair: names of source and target.
        errors: of each point with a known counterpart (p,): geodesic, in units of sqrt(area), or Euclidean in the
            files' unit where the dataset is of clouds. A point that was mapped to none counts as the source's diameter.
        matched: which of these points were mapped to some point (p,).
        confidences: of the map there (p,).
        missing: how well points of the source that a partial shape lacks are found; None where that is not known.
        overlap: how well points of two parts that have a counterpart are found, of both parts together; None where that
            is not known, or not both are parts.
        clutter: how well points that do not belong to the shapes are found; None where none were added.
        quality: what the maps tell of themselves, without the truth; None if whoever made them does not say.
        doubtful: whether the match had a warning of low confidence; None where it has no confidences of its own.
        metrics: figures of one's own.
        exchanged: what the map exchanges; None where that is not looked for.
        chosen: the features, or the method without any, that were chosen among several; None where there was no choice.
        adaptation: what came of adapting a network to the pair, see ``homolog.pairs.PairAdaptation``; None where that
            was not asked for.
    """

    pair: Pair
    errors: Float[np.ndarray, " p"]
    matched: Bool[np.ndarray, " p"]
    confidences: Float[np.ndarray, " p"]
    missing: Detection | None = None
    overlap: Detection | None = None
    clutter: Detection | None = None
    quality: MapQuality | None = None
    doubtful: bool | None = None
    metrics: Mapping[str, float] = field(default_factory=dict)
    exchanged: Exchange | None = None
    chosen: str | None = None
    adaptation: Mapping[str, Any] | None = None

    @property
    def adapted(self) -> bool | None:
        """Whether the map is that of an adapted network; None where none was asked for."""
        return None if self.adaptation is None else self.adaptation["kept"]


@dataclass(frozen=True, eq=False, repr=False)
class Evaluation:
    """The errors of all pairs, and where the time went.

    Args:
        pairs: in the order of the folder.
        method: by which shapes of these modalities are matched.
        seconds: per part of the work.
        euclidean_unit: of Euclidean errors, where the dataset is of clouds; None for geodesic ones.
    """

    pairs: tuple[PairErrors, ...]
    method: str
    seconds: Mapping[str, float]
    euclidean_unit: str | None = None

    @property
    def errors(self) -> Float[np.ndarray, " p"]:
        """Errors of all points of all pairs together."""
        return np.concatenate([pair.errors for pair in self.pairs])

    @property
    def errors_without_self_pairs(self) -> Float[np.ndarray, " q"] | None:
        """Errors of all points of pairs of different shapes; None if there are no such pairs.

        Published scores are means over all pairs, those of a shape with itself included, which nearly every map gets
        right.
        """
        others = [pair.errors for pair in self.pairs if pair.pair[0] != pair.pair[1]]
        return np.concatenate(others) if others else None

    @property
    def has_self_pairs(self) -> bool:
        """Whether a shape is matched with itself."""
        return any(pair.pair[0] == pair.pair[1] for pair in self.pairs)

    @property
    def matched(self) -> Bool[np.ndarray, " p"]:
        """Which of these points were mapped to some point."""
        return np.concatenate([pair.matched for pair in self.pairs])

    @property
    def n_doubtful(self) -> int | None:
        """How many matches had a warning of low confidence; None where none has confidences of its own."""
        told = [pair.doubtful for pair in self.pairs if pair.doubtful is not None]
        return sum(told) if told else None

    @property
    def exchanges(self) -> dict[Exchange, int] | None:
        """How many pairs are exchanged in which way, or not; None if that is not known of any."""
        known = Counter(pair.exchanged for pair in self.pairs if pair.exchanged is not None)
        return {way: known[way] for way in get_args(Exchange)} if known else None

    @property
    def choices(self) -> dict[str, int]:
        """How many pairs were matched by which features or method; {} where there was no choice."""
        return dict(Counter(pair.chosen for pair in self.pairs if pair.chosen is not None))

    @property
    def n_adapted(self) -> int | None:
        """How many maps are those of adapted networks; None where none were asked for."""
        known = [pair.adapted for pair in self.pairs if pair.adapted is not None]
        return sum(known) if known else None

    @property
    def missing(self) -> Detection | None:
        """How well points of full shapes that partial ones lack are found, in all pairs together; None if not known."""
        return _pooled([pair.missing for pair in self.pairs])

    @property
    def overlap(self) -> Detection | None:
        """How well points of two parts that have a counterpart are found, in all pairs together; None if not known."""
        return _pooled([pair.overlap for pair in self.pairs])

    @property
    def overlap_iou(self) -> float | None:
        """The mean over pairs of the intersection over union of the overlap as it was found and as it is."""
        known = [pair.overlap.iou for pair in self.pairs if pair.overlap is not None]
        found = [iou for iou in known if iou is not None]
        return fmean(found) if found else None

    @property
    def clutter(self) -> Detection | None:
        """How well points that were added to the shapes are found, in all pairs together; None if there are none."""
        return _pooled([pair.clutter for pair in self.pairs])

    @property
    def rank_correlations(self) -> dict[str, float | None]:
        """Spearman's rank correlation, over pairs, of each figure of ``Quality`` with the mean error; {} of few pairs.

        None for figures that are not known of all pairs, or the same for all.
        """
        known = [pair for pair in self.pairs if pair.quality is not None and len(pair.errors)]
        if len(known) < _PAIRS_TO_RANK:
            return {}
        errors = [float(pair.errors.mean()) for pair in known]
        figures = [pair.quality.mean for pair in known if pair.quality is not None]
        return {name: _rank_correlation([getattr(each, name) for each in figures], errors) for name in MEASURES}

    @property
    def error_kind(self) -> str:
        """Whether errors are ``"geodesic"`` or ``"euclidean"``."""
        return "geodesic" if self.euclidean_unit is None else "euclidean"

    def shown(self, error: float) -> float:
        """An error as tables show it: geodesic ones are multiplied by 100."""
        return float(error) * (100 if self.euclidean_unit is None else 1)

    def to_dict(self) -> dict[str, Any]:
        """Figures for JSON; geodesic errors are multiplied by 100, as tables in the field show them."""
        errors, matched, kind = self.errors, self.matched, self.error_kind
        confidences = np.concatenate([pair.confidences for pair in self.pairs])
        ranks = matched.any() and np.ptp(confidences[matched]) > 0
        share = least_confident_share(errors[matched], confidences[matched]) if ranks else np.nan
        names = sorted({name for pair in self.pairs for name in pair.metrics})
        metrics = {name: float(np.mean([pair.metrics[name] for pair in self.pairs])) for name in names}
        missing, overlap, clutter = self.missing, self.overlap, self.clutter
        others = self.errors_without_self_pairs
        without_self_pairs = None if others is None or not len(others) else self.shown(others.mean())
        return {
            f"mean_{kind}_error": self.shown(errors.mean()),
            f"median_{kind}_error": self.shown(np.median(errors)),
            **({f"mean_{kind}_error_without_self_pairs": without_self_pairs} if self.has_self_pairs else {}),
            f"mean_{kind}_error_of_matched_points": self.shown(errors[matched].mean()) if matched.any() else None,
            "unit": "sqrt(area) / 100" if self.euclidean_unit is None else self.euclidean_unit,
            **(self._curve(errors) if self.euclidean_unit is None else {}),
            # JSON has no NaN, which stands for no error at all.
            "least_confident_fifth_error_share": share if np.isfinite(share) else None,
            **({} if missing is None else {"without_counterpart": missing.to_dict()}),
            **({} if overlap is None else {"overlap": {"mean_iou": self.overlap_iou, **overlap.to_dict()}}),
            **({} if clutter is None else {"clutter": clutter.to_dict()}),
            **({"quality_rank_correlations": self.rank_correlations} if self.rank_correlations else {}),
            **({"metrics": metrics} if metrics else {}),
            "method": self.method,
            **({"chosen": self.choices} if self.choices else {}),
            **({} if self.n_adapted is None else {"adapted_pairs": self.n_adapted}),
            "unmatched_points": int((~matched).sum()),
            "doubtful_pairs": self.n_doubtful,
            **({} if self.exchanges is None else {"exchanged_pairs": self.exchanges}),
            "pairs": [self._pair(pair) for pair in self.pairs],
            "seconds": dict(self.seconds),
        }

    def rows(self) -> list[list[Any]]:
        """A table of pairs, its header first: names, points, errors, figures of quality, doubts, exchanges,
        choices, adaptations, metrics.
        """
        metrics = sorted({name for pair in self.pairs for name in pair.metrics})
        error = f"mean_{self.error_kind}_error"
        header = ["source", "target", "points", "unmatched", error, *MEASURES, "doubtful"]
        header += ["exchanged", "chosen", "adapted"]
        return [[*header, *metrics], *([*self._row(pair), *map(pair.metrics.get, metrics)] for pair in self.pairs)]

    def _row(self, pair: PairErrors) -> list[Any]:
        figures = None if pair.quality is None else pair.quality.mean
        quality = [None if figures is None else getattr(figures, name) for name in MEASURES]
        error = self.shown(pair.errors.mean()) if len(pair.errors) else None
        return [
            *pair.pair,
            len(pair.errors),
            int((~pair.matched).sum()),
            error,
            *quality,
            pair.doubtful,
            pair.exchanged,
            pair.chosen,
            pair.adapted,
        ]

    def _curve(self, errors: Float[np.ndarray, " p"]) -> dict[str, Any]:
        thresholds, shares = pck_curve(errors)
        return {
            "pck_auc": area_under_pck(errors),
            "pck_threshold": PCK_THRESHOLD,
            "pck": {"thresholds": thresholds.tolist(), "shares": shares.tolist()},
        }

    def _pair(self, pair: PairErrors) -> dict[str, Any]:
        return {
            "source": pair.pair[0],
            "target": pair.pair[1],
            "points": len(pair.errors),
            f"mean_{self.error_kind}_error": self.shown(pair.errors.mean()) if len(pair.errors) else None,
            "doubtful": pair.doubtful,
            **({} if pair.exchanged is None else {"exchanged": pair.exchanged}),
            **({} if pair.chosen is None else {"chosen": pair.chosen}),
            **({} if pair.adaptation is None else {"adaptation": dict(pair.adaptation)}),
            **({} if pair.missing is None else {"without_counterpart": pair.missing.to_dict()}),
            **({} if pair.overlap is None else {"overlap": {"iou": pair.overlap.iou, **pair.overlap.to_dict()}}),
            **({} if pair.clutter is None else {"clutter": pair.clutter.to_dict()}),
            **({} if pair.quality is None else {"quality": pair.quality.to_dict()}),
            **({"metrics": dict(pair.metrics)} if pair.metrics else {}),
        }

    def __repr__(self) -> str:
        mean, unit = self.shown(self.errors.mean()), self.euclidean_unit or "x100"
        return f"Evaluation({len(self.pairs)} pairs by {self.method}: mean {self.error_kind} error {mean:.2f} {unit})"


def _pooled(each: list[Detection | None]) -> Detection | None:
    known = [detection for detection in each if detection is not None]
    return sum(known[1:], known[0]) if known else None


def _rank_correlation(figures: list[float | None], errors: list[float]) -> float | None:
    known = [figure for figure in figures if figure is not None]
    if len(known) < len(errors) or len(set(known)) < 2 or len(set(errors)) < 2:
        return None
    return float(spearmanr(known, errors).statistic)
