"""Fitting an articulated model with shape parameters to points, by damped least squares.

Levenberg's and Marquardt's method, with robust weights after S. Geman and D. McClure (1987). Rotations of bones are
updated by small rotations about their posed heads, for which derivatives of linear blend skinning have a closed form;
those by shape parameters are differences.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple, Protocol

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial.transform import Rotation

# The step by which derivatives by shape parameters are taken, of their range from 0 to 1.
_STEP = 1e-2
# The largest turn of a bone in one step, in radians.
_MOST_TURN = 0.7
_DAMPING, _LEAST_DAMPING, _MOST_DAMPING = 1e-3, 1e-7, 1e3
# Of the priors of shape parameters and of the scale: they decide what the points leave open.
_BUILD_PRIOR, _SCALE_PRIOR = 1e-8, 1e-8
# A step that lowers the cost by less than this share is the last one.
_SETTLED = 1e-4


class Pose(NamedTuple):
    """A model in a pose; lengths are metres.

    Args:
        points: of its surface, some or all (r, 3).
        carried: for each point and bone, where the bone alone would carry the point, times its share (r, b, 3).
        heads: the posed origin of each bone (b, 3).
        turns: how each bone is rotated with all above it (b, 3, 3).
    """

    points: Float[np.ndarray, "r 3"]
    carried: Float[np.ndarray, "r b 3"]
    heads: Float[np.ndarray, "b 3"]
    turns: Float[np.ndarray, "b 3 3"]


class ArticulatedModel(Protocol):
    """A surface with shape parameters from 0 to 1, and bones that move it by linear blend skinning."""

    @property
    def parameters(self) -> Sequence[str]:
        """The names of the shape parameters."""

    @property
    def bones(self) -> Sequence[str]:
        """The names of all bones; those above come first."""

    @property
    def parents(self) -> Int[np.ndarray, " b"]:
        """The bone above each, -1 for the root."""

    @property
    def turning(self) -> Int[np.ndarray, " k"]:
        """The bones that are turned in fitting."""

    @property
    def firmness(self) -> Float[np.ndarray, " k"]:
        """How much stiffer than others each bone that turns is."""

    @property
    def shares(self) -> Float[np.ndarray, "n b"]:
        """The share of each bone in moving each point."""

    def pose(
        self,
        build: Float[np.ndarray, " p"],
        rotations: Float[np.ndarray, "b 3 3"],
        rows: Int[np.ndarray, " r"] | None = None,
    ) -> Pose:
        """The surface for shape parameters and rotations of the bones relative to the ones above; or some points."""

    def points(
        self, builds: Float[np.ndarray, "q p"], rotations: Float[np.ndarray, "b 3 3"]
    ) -> Float[np.ndarray, "q n 3"]:
        """The surface for several shapes in one pose."""


@dataclass(frozen=True, eq=False)
class Fit:
    """Parameters of an articulated model.

    Args:
        build: shape parameters from 0 to 1 (p,).
        rotations: of all bones, about the axes of the model at rest (b, 3, 3).
        shift: of the whole, in metres (3,).
        scale: of the whole.
    """

    build: Float[np.ndarray, " p"]
    rotations: Float[np.ndarray, "b 3 3"]
    shift: Float[np.ndarray, " 3"]
    scale: float = 1.0

    @classmethod
    def at_rest(cls, model: ArticulatedModel) -> Fit:
        """The mean shape in the rest pose."""
        count = len(model.bones)
        return cls(np.full(len(model.parameters), 0.5), np.tile(np.eye(3), (count, 1, 1)), np.zeros(3))

    def points(self, model: ArticulatedModel) -> Float[np.ndarray, "n 3"]:
        """The model's surface, in metres."""
        return np.asarray(self.scale * model.points(self.build[None], self.rotations)[0] + self.shift)


class Goal(NamedTuple):
    """Where points of a model belong.

    Args:
        rows: the points (r,).
        positions: where they belong, in metres (r, 3).
        weights: of each (r,).
        normals: of the surface there, along which distances count in full; None where they count in all directions.
        sliding: the share of distances along the surface where there are normals.
        reach: in metres; a point farther from its goal than this counts a quarter, and less the farther it is.
        stiffness: of the prior that bones stay as they are at rest, in square metres for a radian.
    """

    rows: Int[np.ndarray, " r"]
    positions: Float[np.ndarray, "r 3"]
    weights: Float[np.ndarray, " r"]
    normals: Float[np.ndarray, "r 3"] | None = None
    sliding: float = 0.2
    reach: float = 0.1
    stiffness: float = 1e-5


def fitted(model: ArticulatedModel, start: Fit, goal: Goal, *, steps: int = 10, free_scale: bool = False) -> Fit:
    """Fit an articulated model to points.

    Args:
        model: with shape parameters and bones.
        start: where to begin.
        goal: where its points belong.
        steps: at most so many.
        free_scale: whether the scale is fitted, too.

    Returns:
        The fit; the cost of none is above that of the start.
    """
    problem = _Problem(model, goal, free_scale)
    now, damping = start, _DAMPING
    for _ in range(steps):
        equations = problem.equations(now)
        while True:
            then = problem.moved(now, equations, damping)
            after = problem.cost(then, equations.trust)
            if after < equations.cost or damping > _MOST_DAMPING:
                break
            damping *= 10.0
        if after >= equations.cost:
            break
        now, damping = then, max(damping / 5.0, _LEAST_DAMPING)
        if after > (1.0 - _SETTLED) * equations.cost:
            break
    return now


class _Equations(NamedTuple):
    """The normal equations at a state; unknowns are turns, shape parameters, shift and scale."""

    matrix: Float[np.ndarray, "u u"]
    right: Float[np.ndarray, " u"]
    cost: float
    trust: Float[np.ndarray, " r"]
    turns: Float[np.ndarray, "b 3 3"]


class _Problem:
    """The least-squares problem of a goal."""

    def __init__(self, model: ArticulatedModel, goal: Goal, free_scale: bool) -> None:
        self.model, self.goal, self.free_scale = model, goal, free_scale
        self.below = _below(model.parents)[model.turning].astype(float)
        self.shares = model.shares[goal.rows] @ self.below.T
        self.weights = goal.weights / goal.weights.sum()
        self.metric = None
        if goal.normals is not None:
            along = goal.normals[:, :, None] * goal.normals[:, None, :]
            self.metric = goal.sliding * np.eye(3) + (1 - goal.sliding) * along

    def equations(self, now: Fit) -> _Equations:
        """Linearise at a state."""
        pose = self.model.pose(now.build, now.rotations, self.goal.rows)
        away = self._away(now, pose.points)
        trust = 1.0 / (1.0 + (away**2).sum(axis=1) / self.goal.reach**2) ** 2
        jacobian = self._jacobian(now, pose)
        roots = np.sqrt(self.weights * trust)
        rows = (roots[:, None, None] * self._measured(jacobian)).reshape(-1, jacobian.shape[2])
        residuals = (roots[:, None] * self._measured(away[:, :, None])[:, :, 0]).ravel()
        scales, values = self._priors(now, pose.turns)
        matrix = rows.T @ rows + np.diag(scales)
        return _Equations(matrix, -(rows.T @ residuals + scales * values), self.cost(now, trust), trust, pose.turns)

    def cost(self, now: Fit, trust: Float[np.ndarray, " r"]) -> float:
        """Weighted squared distances in square metres, and priors."""
        points = self.model.points(now.build[None], now.rotations)[0, self.goal.rows]
        away = self._measured(self._away(now, points)[:, :, None])[:, :, 0]
        scales, values = self._priors(now)
        return float((self.weights * trust * (away**2).sum(axis=1)).sum() + (scales * values**2).sum())

    def moved(self, now: Fit, equations: _Equations, damping: float) -> Fit:
        """The state after one damped step; shape parameters stay within their range."""
        free = np.ones(len(equations.right), dtype=bool)
        n_turns, n_build = 3 * len(self.model.turning), len(now.build)
        build = slice(n_turns, n_turns + n_build)
        for _ in range(2):
            step = np.zeros(len(free))
            matrix = equations.matrix[free][:, free]
            damped = matrix + np.diag(damping * np.diag(matrix) + 1e-12)
            step[free] = np.linalg.solve(damped, equations.right[free])
            # What would leave its range stays at its bound, and the others are solved for again.
            then = now.build + step[build]
            free[build] &= (then >= 0) & (then <= 1)
        turns = step[:n_turns].reshape(-1, 3)
        sizes = np.linalg.norm(turns, axis=1, keepdims=True)
        turns = turns * np.minimum(1.0, _MOST_TURN / np.maximum(sizes, 1e-12))
        rest = step[n_turns + n_build :]
        scale = now.scale * float(np.exp(rest[3])) if self.free_scale else now.scale
        moved = replace(now, rotations=self._turned(now.rotations, equations.turns, turns), scale=scale)
        return replace(moved, build=np.clip(then, 0.0, 1.0), shift=now.shift + rest[:3])

    def _turned(
        self, rotations: Float[np.ndarray, "b 3 3"], turns: Float[np.ndarray, "b 3 3"], steps: Float[np.ndarray, "k 3"]
    ) -> Float[np.ndarray, "b 3 3"]:
        """Rotations relative to the bones above, once the bones are turned about the axes of the whole."""
        which, found = self.model.turning, rotations.copy()
        parents = self.model.parents[which]
        above = np.where((parents < 0)[:, None, None], np.eye(3), turns[parents])
        found[which] = above.transpose(0, 2, 1) @ Rotation.from_rotvec(steps).as_matrix() @ turns[which]
        return found

    def _away(self, now: Fit, points: Float[np.ndarray, "r 3"]) -> Float[np.ndarray, "r 3"]:
        return np.asarray(now.scale * points + now.shift - self.goal.positions)

    def _measured(self, rows: Float[np.ndarray, "r 3 u"]) -> Float[np.ndarray, "r 3 u"]:
        return rows if self.metric is None else np.asarray(self.metric @ rows)

    def _jacobian(self, now: Fit, pose: Pose) -> Float[np.ndarray, "r 3 u"]:
        """Derivatives of the points by turns, shape parameters, shift and scale."""
        count, model = len(pose.points), self.model
        # What a bone and all below it carry of a point, from the bone's head.
        arms = self.below @ pose.carried - self.shares[:, :, None] * pose.heads[model.turning]
        x, y, z = np.moveaxis(now.scale * arms, 2, 0)
        zero = np.zeros_like(x)
        turning = np.stack([np.stack(row, axis=2) for row in ((zero, z, -y), (-z, zero, x), (y, -x, zero))], axis=1)
        steps = np.where(now.build < 0.5, _STEP, -_STEP)
        others = model.points(now.build + np.diag(steps), now.rotations)[:, self.goal.rows]
        shape = now.scale * np.moveaxis((others - pose.points) / steps[:, None, None], 0, 2)
        parts = [turning.reshape(count, 3, -1), shape, np.tile(np.eye(3), (count, 1, 1))]
        if self.free_scale:
            parts.append(now.scale * pose.points[:, :, None])
        return np.concatenate(parts, axis=2)

    def _priors(
        self, now: Fit, turns: Float[np.ndarray, "b 3 3"] | None = None
    ) -> tuple[Float[np.ndarray, " u"], Float[np.ndarray, " u"]]:
        """The weight and the value of the prior of each unknown: bones are at rest, the shape is the mean one.

        With ``turns`` the rotations of bones are about the axes of the whole, as the unknowns are.
        """
        which = self.model.turning
        parents = self.model.parents[which]
        bent = Rotation.from_matrix(now.rotations[which]).as_rotvec()
        if turns is not None:
            bent = np.where((parents < 0)[:, None], bent, np.einsum("kij,kj->ki", turns[parents], bent))
        stiffness = np.where(parents < 0, 0.0, self.goal.stiffness * self.model.firmness)
        scales = [np.repeat(stiffness, 3), np.full(len(now.build), _BUILD_PRIOR), np.zeros(3)]
        values = [bent.ravel(), now.build - 0.5, np.zeros(3)]
        if self.free_scale:
            scales.append(np.array([_SCALE_PRIOR]))
            values.append(np.array([np.log(now.scale)]))
        return np.concatenate(scales), np.concatenate(values)


def _below(parents: Int[np.ndarray, " b"]) -> Bool[np.ndarray, "b b"]:
    """For each bone which bones move with it: itself, and all below it."""
    found = np.eye(len(parents), dtype=bool)
    for bone, parent in enumerate(parents.tolist()):
        if parent >= 0:
            found[:, bone] |= found[:, parent]
    return found
