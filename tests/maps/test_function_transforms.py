"""torch.func's grad, jacrev and vmap on functions with derivatives of their own, against the readable references."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor
from torch.func import grad, jacrev, vmap

from homolog.maps import functional_map, reference
from homolog.maps.sinkhorn import carried_over


def random(*shape: int, seed: int = 0) -> Tensor:
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


# Arguments of the functional map: coefficients of x and of y, and a mask; of the soft map: features of y and of x.
MAP = random(4, 6), random(3, 6, seed=1), random(3, 4, seed=2).abs()
SOFT = random(7, 3), random(6, 3, seed=1)
FUNCTIONS = random(6, 2, seed=3)


def own_map(*given: Tensor) -> Tensor:
    return functional_map(*given, regularisation=0.7)


def slow_map(*given: Tensor) -> Tensor:
    return reference.functional_map(*given, regularisation=0.7)


def own_soft(*given: Tensor) -> Tensor:
    return carried_over(*given, FUNCTIONS)


def slow_soft(*given: Tensor) -> Tensor:
    return reference.soft_map(*given) @ FUNCTIONS


BOTH = {"functional map": (own_map, slow_map, MAP), "soft map": (own_soft, slow_soft, SOFT)}
EACH = [(name, number) for name, (_, _, given) in BOTH.items() for number in range(len(given))]


def summed(function):
    return lambda *given: function(*given).square().sum()


def batch(tensor: Tensor, at: int) -> Tensor:
    """Three of a kind, and where the batch's dimension is."""
    return torch.stack([tensor, 2 * tensor, tensor + 0.5], dim=at)


@pytest.mark.parametrize(("name", "number"), EACH)
def test_gradients_and_jacobians(name: str, number: int) -> None:
    own, slow, given = BOTH[name]
    for transform in (lambda f: grad(summed(f), argnums=number), lambda f: jacrev(f, argnums=number)):
        torch.testing.assert_close(transform(own)(*given), transform(slow)(*given))


@pytest.mark.parametrize(("name", "number"), EACH)
@pytest.mark.parametrize("at", [0, 1, 2])
def test_batches_of_one_argument(name: str, number: int, at: int) -> None:
    own, slow, given = BOTH[name]
    given, dims = list(given), [None] * len(given)
    given[number], dims[number] = batch(given[number], at), at
    torch.testing.assert_close(vmap(own, in_dims=tuple(dims))(*given), vmap(slow, in_dims=tuple(dims))(*given))
    of_each = [vmap(grad(summed(f), argnums=number), in_dims=tuple(dims))(*given) for f in (own, slow)]
    torch.testing.assert_close(*of_each)
    through = [grad(summed(vmap(f, in_dims=tuple(dims))), argnums=number)(*given) for f in (own, slow)]
    torch.testing.assert_close(*through)


def test_a_batch_of_masks_for_a_batch_of_features() -> None:
    a, b, masks = random(2, 4, 6), random(2, 3, 6, seed=1), random(5, 3, 4, seed=2).abs()
    found = vmap(lambda mask: own_map(a, b, mask))(masks)
    assert found.shape == (5, 2, 3, 4)
    torch.testing.assert_close(found[3, 1], own_map(a[1], b[1], masks[3]))


def test_second_derivatives_are_right_or_refused() -> None:
    second = [
        grad(lambda *given, f=f: grad(summed(f))(*given).square().sum(), argnums=2)(*MAP) for f in (own_map, slow_map)
    ]
    torch.testing.assert_close(*second)
    with pytest.raises(NotImplementedError, match=r"homolog\.maps\.reference\.soft_map"):
        grad(lambda *given: grad(summed(own_soft))(*given).square().sum())(*SOFT)
    y = SOFT[0].clone().requires_grad_()
    (first,) = torch.autograd.grad(own_soft(y, SOFT[1]).square().sum(), y, create_graph=True)
    with pytest.raises(NotImplementedError, match="derived once"):
        first.sum().backward()
