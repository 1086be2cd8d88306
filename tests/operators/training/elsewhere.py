"""A fake device: tensors that claim another device and are computed on the CPU.

An operation on tensors of both devices raises, as it would with a GPU. The device must be one that
torch knows and that is otherwise unused: `meta`, whose tensors otherwise hold no numbers.
"""

# mypy: disallow-subclassing-any=False
from collections.abc import Mapping, Sequence
from typing import Any

import torch
from torch import Tensor
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_leaves, tree_map

PLACE = torch.device("meta")
MOVES = {torch.ops.aten._to_copy.default, torch.ops.aten.copy_.default}


class Elsewhere(Tensor):
    """A tensor on the fake device; `held` has its values on the CPU."""

    @staticmethod
    def __new__(cls, held: Tensor) -> "Elsewhere":
        return Tensor._make_wrapper_subclass(
            cls,
            held.shape,
            strides=held.stride(),
            storage_offset=held.storage_offset(),
            dtype=held.dtype,
            device=PLACE,
        )

    def __init__(self, held: Tensor) -> None:
        self.held = held

    def tolist(self) -> Any:
        """Return the values; torch's own method does not support subclasses."""
        return self.held.tolist()

    @classmethod
    def __torch_dispatch__(
        cls,
        operation: Any,
        types: object,
        args: Sequence[Any] = (),
        kwargs: Mapping[str, Any] | None = None,
    ) -> Any:
        return computed(operation, args, kwargs or {})


class pretended(TorchDispatchMode):  # noqa: N801 - used as a context
    """A context in which tensors made on or moved to `PLACE` hold numbers."""

    def __torch_dispatch__(
        self,
        operation: Any,
        types: object,
        args: Sequence[Any] = (),
        kwargs: Mapping[str, Any] | None = None,
    ) -> Any:
        return computed(operation, args, kwargs or {})


def computed(operation: Any, args: Sequence[Any], kwargs: Mapping[str, Any]) -> Any:
    """Run an operation on the held values; raises `RuntimeError` for tensors of both devices."""
    tensors = [each for each in tree_leaves((args, dict(kwargs))) if isinstance(each, Tensor)]
    there = {id(each.held): each for each in tensors if isinstance(each, Elsewhere)}
    # a single number on the CPU may be used with any device, as with CUDA
    here = [each for each in tensors if not isinstance(each, Elsewhere) and each.ndim]
    if there and here and operation not in MOVES:
        raise RuntimeError(f"{operation}: some tensors are here, others elsewhere")
    named = kwargs.get("device")
    goes = bool(there) if named is None else torch.device(named) == PLACE
    words = dict(kwargs) | ({} if named is None else {"device": torch.device("cpu")})

    def held(each: Any) -> Any:
        return each.held if isinstance(each, Elsewhere) else each

    def back(each: Any) -> Any:
        if id(each) in there:  # changed in place
            return there[id(each)]
        return Elsewhere(each) if goes and isinstance(each, Tensor) else each

    found = operation(*tree_map(held, args), **tree_map(held, words))
    if operation is torch.ops.aten.copy_.default:
        return args[0]
    return tree_map(back, found)
