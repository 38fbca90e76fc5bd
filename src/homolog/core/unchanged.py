"""Tensors that are lent to functions of users, and must come back as they were."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager

import torch
from torch import Tensor

from homolog.core.errors import ArgumentError

# Sums of the same numbers differ by this share at most, in whatever order threads add them.
_SAME = 1e-9


@contextmanager
def left_unchanged(who: str, lent: Mapping[str, Tensor]) -> Iterator[None]:
    """Around a call of a function of a user's: refuse it if it has written into tensors that it was lent.

    Others go on with these, and would fail or be wrong without a word. A write is told by torch's count of writes, and
    by the sum of a tensor, which also changes if it is written to by an array of NumPy that shares its memory.

    Args:
        who: what is called, for the message.
        lent: tensors by their names.

    Raises:
        ArgumentError: naming what was called and the tensor.

    Examples:
        >>> import torch
        >>> points = torch.ones(3)
        >>> with left_unchanged("method 'mine'", {"points": points}):
        ...     points.zero_()
        Traceback (most recent call last):
        homolog.core.errors.ArgumentError: method 'mine' changed points in place, which other steps need; work on a copy
    """
    before = {name: _state(tensor) for name, tensor in lent.items()}
    yield
    for name, (writes, total) in before.items():
        writes_after, total_after = _state(lent[name])
        if writes != writes_after or not torch.isclose(total, total_after, rtol=_SAME, atol=0, equal_nan=True):
            raise ArgumentError(f"{who} changed {name} in place, which other steps need; work on a copy")


def _state(tensor: Tensor) -> tuple[int, Tensor]:
    """How often a tensor was written to, as far as torch counts that, and its sum."""
    held = tensor.detach() if tensor.layout == torch.strided else tensor.detach().values()
    return 0 if tensor.is_inference() else tensor._version, held.sum(dtype=torch.float64)
