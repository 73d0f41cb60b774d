"""Operations on dataclasses of tensors with one row per example: select, move and join."""

from collections.abc import Sequence
from dataclasses import fields
from typing import Any, TypeVar

import torch
from jaxtyping import Int
from torch import Tensor

Rows = TypeVar("Rows")


def rows_of(batch: Rows, which: Int[Tensor, " chosen"]) -> Rows:
    """Return some of the examples, in the given order."""
    return _changed(
        batch, lambda values: rows_of(values, which), lambda one: one.index_select(0, which)
    )


def on_device(batch: Rows, device: str) -> Rows:
    """Return the batch on another device."""
    return _changed(batch, lambda values: on_device(values, device), lambda one: one.to(device))


def joined_rows(batches: Sequence[Rows]) -> Rows:
    """Return all examples of several batches, in order."""
    names = [one.name for one in fields(batches[0])]
    return type(batches[0])(
        **{name: torch.cat([getattr(one, name) for one in batches]) for name in names}
    )


def _changed(batch: Rows, inner: Any, change: Any) -> Rows:
    """Return the dataclass with every tensor changed, including those of nested dataclasses."""
    values = {one.name: getattr(batch, one.name) for one in fields(batch)}
    return type(batch)(
        **{
            name: change(value) if isinstance(value, Tensor) else inner(value)
            for name, value in values.items()
        }
    )
